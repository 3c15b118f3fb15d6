#include "apps/render/plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "apps/render/text.h"
#include "core/error.h"

namespace sekitei::render {
namespace {

constexpr Rgb kInk{40, 40, 40}, kRule{226, 226, 226};
constexpr std::array<Rgb, 8> kColours{{{0, 114, 178},
                                       {213, 94, 0},
                                       {0, 158, 115},
                                       {204, 121, 167},
                                       {230, 159, 0},
                                       {86, 180, 233},
                                       {0, 0, 0},
                                       {190, 175, 20}}};

struct Span {
    double low = INFINITY, high = -INFINITY;
    void add(double v)
    {
        low = std::min(low, v);
        high = std::max(high, v);
    }
    /// Room around a single value.
    void widen()
    {
        if (high > low) return;
        const double room = std::max(1e-9, std::abs(low) * 0.05);
        low -= room;
        high += room;
    }
};

/// The part of the picture that values may mark, and where they fall.
struct Frame {
    int left, top, right, bottom;  // pixels of the axes
    Span x, y;
    double column(double v) const { return left + (v - x.low) / (x.high - x.low) * (right - left); }
    double row(double v) const { return bottom - (v - y.low) / (y.high - y.low) * (bottom - top); }
};

void fill(Image8& image, int x0, int y0, int x1, int y1, Rgb colour)
{
    for (int y = std::max(0, y0); y <= std::min(image.height - 1, y1); ++y)
        for (int x = std::max(0, x0); x <= std::min(image.width - 1, x1); ++x)
            for (int c = 0; c < 3; ++c) image.at(x, y, c) = colour[c];
}

/// How much of each pixel a stroke covers; strokes of one series join without seams.
class Ink {
public:
    Ink(const Frame& frame, double half_width)
        : frame_(frame),
          half_(half_width),
          wide_(frame.right - frame.left + 1),
          cover_(static_cast<std::size_t>(wide_) *
                 static_cast<std::size_t>(frame.bottom - frame.top + 1))
    {
    }

    /// A stroke between two points in pixels, clipped to the frame.
    void stroke(double ax, double ay, double bx, double by)
    {
        const double reach = half_ + 1, dx = bx - ax, dy = by - ay, squared = dx * dx + dy * dy;
        const int y0 = row(std::min(ay, by) - reach), y1 = row(std::max(ay, by) + reach);
        for (int y = y0; y <= y1; ++y) {
            // Only the columns that the stroke can touch in this row.
            double low = std::min(ax, bx), high = std::max(ax, bx);
            if (std::abs(dy) > 1e-9) {
                const double t0 = (y - reach - ay) / dy, t1 = (y + reach - ay) / dy;
                const double s0 = std::clamp(std::min(t0, t1), 0.0, 1.0),
                             s1 = std::clamp(std::max(t0, t1), 0.0, 1.0);
                low = std::min(ax + s0 * dx, ax + s1 * dx);
                high = std::max(ax + s0 * dx, ax + s1 * dx);
            }
            for (int x = column(low - reach); x <= column(high + reach); ++x) {
                const double t =
                    squared > 0 ? std::clamp(((x - ax) * dx + (y - ay) * dy) / squared, 0.0, 1.0)
                                : 0;
                const double ex = x - ax - t * dx, ey = y - ay - t * dy;
                const double cover = half_ + 0.5 - std::sqrt(ex * ex + ey * ey);
                float& c = cover_[static_cast<std::size_t>(y - frame_.top) *
                                      static_cast<std::size_t>(wide_) +
                                  static_cast<std::size_t>(x - frame_.left)];
                c = std::max(c, static_cast<float>(std::clamp(cover, 0.0, 1.0)));
            }
        }
    }

    void spread(Image8& image, Rgb colour) const
    {
        for (int y = frame_.top; y <= frame_.bottom; ++y)
            for (int x = frame_.left; x <= frame_.right; ++x) {
                const float c = cover_[static_cast<std::size_t>(y - frame_.top) *
                                           static_cast<std::size_t>(wide_) +
                                       static_cast<std::size_t>(x - frame_.left)];
                for (int k = 0; k < 3 && c > 0; ++k) {
                    auto& pixel = image.at(x, y, k);
                    pixel = static_cast<std::uint8_t>(static_cast<float>(pixel) * (1 - c) +
                                                      static_cast<float>(colour[k]) * c + 0.5f);
                }
            }
    }

private:
    int row(double y) const { return inside(y, frame_.top, frame_.bottom); }
    int column(double x) const { return inside(x, frame_.left, frame_.right); }
    static int inside(double v, int low, int high)
    {
        return static_cast<int>(std::clamp(v, static_cast<double>(low), static_cast<double>(high)));
    }

    const Frame& frame_;
    double half_;
    int wide_;
    std::vector<float> cover_;
};

void check(const std::vector<Series>& series, const PlotParams& params)
{
    if (params.width < 200 || params.width > 16384 || params.height < 120 || params.height > 16384)
        throw InvalidParameter(
            fmt::format("plot: size = {} x {}, must be 200 x 120 to 16384 x 16384 pixels",
                        params.width, params.height));
    if (params.low && params.high && !(*params.low < *params.high))
        throw InvalidParameter(fmt::format("plot: low = {:.6g}, must be below high = {:.6g}",
                                           *params.low, *params.high));
    for (const Series& s : series)
        if (s.x.size() != s.y.size())
            throw InvalidParameter(fmt::format("plot: series {} has {} x and {} y, must be as many",
                                               s.name, s.x.size(), s.y.size()));
}

bool shown(const Series& s, std::size_t i)
{
    return std::isfinite(s.x[i]) && std::isfinite(s.y[i]);
}

}  // namespace

Image8 plot(const std::vector<Series>& series, const PlotParams& params)
{
    check(series, params);
    Frame frame{};
    for (const Series& s : series)
        for (std::size_t i = 0; i < s.x.size(); ++i)
            if (shown(s, i)) {
                frame.x.add(s.x[i]);
                frame.y.add(s.y[i]);
            }
    if (!(frame.x.low <= frame.x.high))
        throw InvalidInput("plot: the series have no finite point, must have one to show");
    if (params.from_zero) frame.y.add(0);
    frame.x.widen();
    frame.y.widen();
    // Ends of the y axis on ticks, where they are free.
    {
        const Ticks t = ticks(frame.y.low, frame.y.high, 6);
        if (t.values.size() >= 2) {
            const double step = t.values[1] - t.values[0];
            frame.y.low = std::floor(frame.y.low / step + 1e-9) * step;
            frame.y.high = std::ceil(frame.y.high / step - 1e-9) * step;
        }
    }
    frame.y.low = params.low.value_or(frame.y.low);
    frame.y.high = params.high.value_or(frame.y.high);
    if (!(frame.y.high > frame.y.low)) frame.y.high = frame.y.low + 1;
    const Ticks x_ticks = ticks(frame.x.low, frame.x.high, params.width / 110),
                y_ticks = ticks(frame.y.low, frame.y.high, std::max(2, params.height / 70));

    // Lay out: title, name of y; numbers at the left; numbers and name of x below; legend right.
    const int text = params.width >= 700 ? 2 : 1, margin = 6 * text;
    int numbers = 0, legend = 0;
    for (const double v : y_ticks.values)
        numbers = std::max(numbers, text_width(tick_text(v, y_ticks), text));
    for (const Series& s : series)
        if (!s.name.empty()) legend = std::max(legend, text_width(s.name, text) + 24 * text);
    const int title = params.title.empty() ? 0 : 13 * text;
    frame.left = margin + numbers + 6 * text;
    frame.top = margin + title + (params.y_name.empty() ? 4 * text : 14 * text);
    frame.right =
        std::max(frame.left + 40, params.width - 1 - 3 * margin - (legend ? legend + margin : 0));
    frame.bottom = std::max(frame.top + 20, params.height - 1 - margin - 12 * text -
                                                (params.x_name.empty() ? 0 : 13 * text));

    Image8 image(params.width, params.height, 3);
    std::fill(image.pixels.begin(), image.pixels.end(), std::uint8_t{255});
    draw_text(image, margin, margin, params.title, text, kInk);
    draw_text(image, margin, margin + title, params.y_name, text, kInk);
    for (const double v : y_ticks.values) {
        const int y = static_cast<int>(std::lround(frame.row(v)));
        const std::string label = tick_text(v, y_ticks);
        fill(image, frame.left, y, frame.right, y, kRule);
        fill(image, frame.left - 3 * text, y, frame.left, y, kInk);
        draw_text(image, frame.left - 5 * text - text_width(label, text), y - 3 * text, label, text,
                  kInk);
    }
    for (const double v : x_ticks.values) {
        const int x = static_cast<int>(std::lround(frame.column(v)));
        const std::string label = tick_text(v, x_ticks);
        fill(image, x, frame.top, x, frame.bottom, kRule);
        fill(image, x, frame.bottom, x, frame.bottom + 3 * text, kInk);
        draw_text(image, x - text_width(label, text) / 2, frame.bottom + 5 * text, label, text,
                  kInk);
    }
    draw_text(image, frame.left + (frame.right - frame.left - text_width(params.x_name, text)) / 2,
              frame.bottom + 17 * text, params.x_name, text, kInk);
    fill(image, frame.left, frame.top, frame.left, frame.bottom, kInk);
    fill(image, frame.left, frame.bottom, frame.right, frame.bottom, kInk);

    int line = 0;
    for (std::size_t k = 0; k < series.size(); ++k) {
        const Series& s = series[k];
        const Rgb colour = kColours[k % kColours.size()];
        Ink ink(frame, 0.6 * text);
        for (std::size_t i = 0; i < s.x.size(); ++i) {
            if (!shown(s, i)) continue;
            const bool after = i > 0 && shown(s, i - 1);
            const bool alone = !after && (i + 1 == s.x.size() || !shown(s, i + 1));
            const double x = frame.column(s.x[i]), y = frame.row(s.y[i]);
            if (after) ink.stroke(frame.column(s.x[i - 1]), frame.row(s.y[i - 1]), x, y);
            if (alone) ink.stroke(x - text, y, x + text, y);
        }
        ink.spread(image, colour);
        if (s.name.empty()) continue;
        const int y = frame.top + 12 * text * line++;
        const int x = frame.right + 2 * margin;
        fill(image, x, y + 3 * text - text / 2, x + 14 * text, y + 3 * text + (text - 1) / 2,
             colour);
        draw_text(image, x + 19 * text, y, s.name, text, kInk);
    }
    return image;
}

}  // namespace sekitei::render
