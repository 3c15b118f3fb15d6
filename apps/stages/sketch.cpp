#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/render/text.h"
#include "apps/stages/stages.h"
#include "apps/trees.h"
#include "core/error.h"
#include "core/log.h"

namespace sekitei::apps {
namespace {

/// Drawings of one scale for all scenes or for those of a row, or each as large as its column.
enum class Scale { Shared, Row, Own };
constexpr std::array<std::string_view, 3> choice_names(Scale)
{
    return {"shared", "row", "own"};
}
enum class View { Both, Side, Top };
constexpr std::array<std::string_view, 3> choice_names(View)
{
    return {"both", "side", "top"};
}

struct SketchParams {
    int size = 320;
    int columns = 0;
    std::vector<double> rows;
    View view = View::Both;
    Scale scale = Scale::Shared;
    bool balls = true, labels = true;

    static void describe(auto&& field)
    {
        field("size", &SketchParams::size, "", between(64, 4096), "width of a column in pixels");
        field("columns", &SketchParams::columns, "", between(0, 100),
              "drawings beside each other; 0: up to six");
        field("rows", &SketchParams::rows, "", between(1, 100),
              "how many drawings each row has; empty: as many as columns");
        field("view", &SketchParams::view, "from the side (south), from the top, or both");
        field("scale", &SketchParams::scale,
              "shared by all drawings or by those of a row, or own for each");
        field("balls", &SketchParams::balls, "the leaves of tips as circles in the top view");
        field("labels", &SketchParams::labels, "names of the scenes and numbers of tips");
    }
};

/// A white sheet that dark strokes are drawn on; crossing ones do not add up.
class Sheet {
public:
    Sheet(int width, int height)
        : width_(width), height_(height), light_(std::size_t(width) * std::size_t(height), 1.0f)
    {
    }

    void stroke(double ax, double ay, double bx, double by, double width, double grey)
    {
        // Hairlines fade instead of getting thinner than a pixel.
        const double half = std::max(width, 1.0) / 2, ink = (1 - grey) * std::min(1.0, width);
        const double dx = bx - ax, dy = by - ay, squared = dx * dx + dy * dy;
        each(std::min(ax, bx) - half, std::min(ay, by) - half, std::max(ax, bx) + half,
             std::max(ay, by) + half, [&](double x, double y) {
                 const double t =
                     squared > 0 ? std::clamp(((x - ax) * dx + (y - ay) * dy) / squared, 0.0, 1.0)
                                 : 0;
                 const double ex = x - ax - t * dx, ey = y - ay - t * dy;
                 return ink * std::clamp(half + 0.5 - std::sqrt(ex * ex + ey * ey), 0.0, 1.0);
             });
    }

    void circle(double cx, double cy, double radius, double width, double grey)
    {
        const double half = std::max(width, 1.0) / 2, ink = (1 - grey) * std::min(1.0, width);
        const double reach = radius + half;
        each(cx - reach, cy - reach, cx + reach, cy + reach, [&](double x, double y) {
            const double dx = x - cx, dy = y - cy,
                         off = std::abs(std::sqrt(dx * dx + dy * dy) - radius);
            return ink * std::clamp(half + 0.5 - off, 0.0, 1.0);
        });
    }

    Image8 picture() const
    {
        Image8 image(width_, height_, 3);
        for (std::size_t i = 0; i < light_.size(); ++i)
            for (std::size_t c = 0; c < 3; ++c)
                image.pixels[3 * i + c] = static_cast<std::uint8_t>(light_[i] * 255 + 0.5f);
        return image;
    }

private:
    template <class F>
    void each(double left, double top, double right, double bottom, F&& ink)
    {
        const int x0 = std::max(0, int(std::floor(left)) - 1),
                  x1 = std::min(width_ - 1, int(std::ceil(right)) + 1),
                  y0 = std::max(0, int(std::floor(top)) - 1),
                  y1 = std::min(height_ - 1, int(std::ceil(bottom)) + 1);
        for (int y = y0; y <= y1; ++y)
            for (int x = x0; x <= x1; ++x) {
                float& light = light_[std::size_t(y) * std::size_t(width_) + std::size_t(x)];
                light = std::min(light, static_cast<float>(1 - ink(x + 0.5, y + 0.5)));
            }
    }

    int width_, height_;
    std::vector<float> light_;
};

/// What is drawn of one scene [m].
struct Drawing {
    std::string name;
    GroveRecord record;
    std::vector<double> radius;  ///< of branches
    double unit = 0.2;
    Vec3d middle;      ///< of the feet
    double reach = 0;  ///< farthest from the middle, horizontally
    double low = 0, high = 0;
};

class SketchStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{"sketch",
                                     "1",
                                     "draw the branches of trees as lines, from the side and from "
                                     "the top, one scene beside the other",
                                     OutputKind::Picture,
                                     true,
                                     {"tree_skeleton", "trees", "canopy_lad"},
                                     {},
                                     true,
                                     {"tree"}};
        return kInfo;
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override { validate_described("sketch", params_); }
    Need estimate(SceneOutline&, const StageContext&) override { return {0, 3e8, 1e6}; }
    Json run(Scene& scene, const StageContext& context) override
    {
        return run_many({{"", scene}}, context);
    }

    Json run_many(const std::vector<std::pair<std::string, Scene>>& scenes,
                  const StageContext& context) override
    {
        if (scenes.empty()) throw InvalidParameter("sketch: needs a scene with trees");
        std::vector<Drawing> drawings;
        for (const auto& [name, scene] : scenes) drawings.push_back(drawing_of(name, scene));
        const int count = int(drawings.size());
        std::vector<Row> rows = rows_of(count);
        const int text = std::max(1, params_.size / 260), margin = std::max(4, params_.size / 32);
        const int words = params_.labels ? (2 * render::kGlyphHeight + 6) * text : 0;
        const bool has_side = params_.view != View::Top, has_top = params_.view != View::Side;
        const double room = params_.size - 2.0 * margin;
        if (params_.scale == Scale::Shared) share(drawings, 0, count);
        int width = 0, height = 0;
        for (Row& row : rows) {
            if (params_.scale == Scale::Row) share(drawings, row.first, row.last);
            row.top = height;
            // As high as the highest, but no tower.
            for (int k = row.first; k < row.last; ++k) {
                const Drawing& d = drawings[std::size_t(k)];
                row.side = std::max(
                    row.side,
                    int(std::ceil(std::min((d.high - d.low) * room / (2 * d.reach), 2 * room))));
            }
            height += margin + (has_side ? row.side + margin : 0) +
                      (has_top ? int(room) + margin : 0) + words;
            row.words = height - words;
            width = std::max(width, (row.last - row.first) * params_.size);
        }
        if (double(width) * double(height) > 268435456.0)
            throw LimitExceeded(fmt::format(
                "sketch: {} x {} pixels, the limit is 2^28; make size smaller", width, height));
        Sheet sheet(width, height);
        for (const Row& row : rows)
            for (int k = row.first; k < row.last; ++k) {
                context.progress.check();
                const Drawing& d = drawings[std::size_t(k)];
                const double scale = std::min(room / (2 * d.reach), row.side / (d.high - d.low));
                const double x = (k - row.first) * params_.size + params_.size / 2.0;
                double y = row.top + margin;
                if (has_side) {
                    draw_side(sheet, d, x, y + row.side, scale);
                    y += row.side + margin;
                }
                if (has_top) draw_top(sheet, d, x, y + room / 2, scale);
                context.progress.update(double(k + 1) / count);
            }
        picture = sheet.picture();
        for (const Row& row : rows)
            for (int k = row.first; k < row.last && params_.labels; ++k) {
                const Drawing& d = drawings[std::size_t(k)];
                const int left = (k - row.first) * params_.size + margin;
                render::draw_text(picture, left, row.words, d.name, text, {20, 20, 20});
                render::draw_text(
                    picture, left, row.words + (render::kGlyphHeight + 2) * text,
                    fmt::format("{} tips, {:.1f} m", d.record.state.tips.size(), height_of(d)),
                    text, {110, 110, 110});
            }
        return {{"drawings", count}, {"width", picture.width}, {"height", picture.height}};
    }

private:
    struct Row {
        int first = 0, last = 0;           // drawings
        int top = 0, side = 0, words = 0;  // pixels
    };

    std::vector<Row> rows_of(int count) const
    {
        const int across = params_.columns > 0 ? params_.columns : 6;
        std::vector<Row> rows;
        for (int first = 0; first < count;) {
            const std::size_t k = rows.size();
            const int many = k < params_.rows.size() ? int(params_.rows[k]) : across;
            rows.push_back({first, std::min(count, first + many)});
            first += many;
        }
        return rows;
    }

    static void share(std::vector<Drawing>& drawings, int first, int last)
    {
        double reach = 0, low = 0, high = 0;
        for (int k = first; k < last; ++k) {
            const Drawing& d = drawings[std::size_t(k)];
            reach = std::max(reach, d.reach);
            low = std::min(low, d.low);
            high = std::max(high, d.high);
        }
        for (int k = first; k < last; ++k) {
            Drawing& d = drawings[std::size_t(k)];
            d.reach = reach, d.low = low, d.high = high;
        }
    }

    static double height_of(const Drawing& d)
    {
        double most = 0;
        for (std::size_t i = 0; i < d.record.state.branches.size(); ++i)
            most = std::max(most, d.record.state.branches.end(i).z * d.unit - d.middle.z);
        return most;
    }

    static Drawing drawing_of(const std::string& name, const Scene& scene)
    {
        Drawing d;
        d.name = name;
        try {
            d.record = grove_record(scene);
            d.radius = skeleton_of(scene).radius;
        } catch (const InvalidInput& error) {
            throw named_after(name, error);
        }
        d.unit = d.record.params.unit_length;
        const tree::Branches& b = d.record.state.branches;
        // Felled trees count, so that those left stand where they stood.
        for (const tree::Plant& plant : d.record.state.plants) d.middle += plant.origin * d.unit;
        if (!d.record.state.plants.empty())
            d.middle = d.middle / double(d.record.state.plants.size());
        for (std::size_t i = 0; i < b.size(); ++i)
            for (const Vec3d end : {b.start[i] * d.unit, b.end(i) * d.unit}) {
                const Vec3d at = end - d.middle;
                d.reach = std::max({d.reach, std::abs(at.x), std::abs(at.y)});
                d.low = std::min(d.low, at.z);
                d.high = std::max(d.high, at.z);
            }
        double ball = 0;
        for (const tree::Species& s : d.record.species) ball = std::max(ball, s.ball_radius);
        d.reach += ball * d.unit;
        d.high = std::max(d.high, d.low + d.unit);
        return d;
    }

    static double grey_of(const tree::Branches& b, std::size_t i)
    {
        return b.alive(i) ? 0.05 : 0.68;
    }

    void draw_side(Sheet& sheet, const Drawing& d, double x, double foot, double scale) const
    {
        const tree::Branches& b = d.record.state.branches;
        for (const bool alive : {false, true})  // the living in front
            for (std::size_t i = 0; i < b.size(); ++i) {
                if (b.alive(i) != alive) continue;
                const Vec3d from = b.start[i] * d.unit - d.middle,
                            to = b.end(i) * d.unit - d.middle;
                sheet.stroke(x + from.x * scale, foot - (from.z - d.low) * scale, x + to.x * scale,
                             foot - (to.z - d.low) * scale, std::max(0.8, 2 * d.radius[i] * scale),
                             grey_of(b, i));
            }
    }

    void draw_top(Sheet& sheet, const Drawing& d, double x, double y, double scale) const
    {
        const tree::Branches& b = d.record.state.branches;
        if (params_.balls)
            for (const std::uint32_t i : d.record.state.tips) {
                const Vec3d at = b.end(i) * d.unit - d.middle;
                const auto& plant = d.record.state.plants[std::size_t(b.tree[i])];
                sheet.circle(
                    x + at.x * scale, y - at.y * scale,
                    d.record.species[std::size_t(plant.species)].ball_radius * d.unit * scale, 0.7,
                    0.45);
            }
        for (std::size_t i = 0; i < b.size(); ++i) {
            const Vec3d from = b.start[i] * d.unit - d.middle, to = b.end(i) * d.unit - d.middle;
            sheet.stroke(x + from.x * scale, y - from.y * scale, x + to.x * scale, y - to.y * scale,
                         std::max(0.8, 2 * d.radius[i] * scale), grey_of(b, i));
        }
    }

    SketchParams params_;
};

}  // namespace

std::unique_ptr<Stage> make_sketch()
{
    return std::make_unique<SketchStage>();
}

}  // namespace sekitei::apps
