#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "apps/forest.h"
#include "apps/render/text.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/parallel.h"

namespace sekitei::apps {
namespace {

using render::Rgb;

enum class View { Top, Side };
constexpr std::array<std::string_view, 2> choice_names(View)
{
    return {"top", "side"};
}
/// What lies over what where circles meet.
enum class Above { Small, Large };
constexpr std::array<std::string_view, 2> choice_names(Above)
{
    return {"small", "large"};
}

struct DistributionParams {
    int px = 512;
    View view = View::Top;
    Above above = Above::Small;
    std::vector<double> window;
    double min_height = 0, max_height = 100;
    int columns = 0;
    bool seedlings = false, labels = false;

    static void describe(auto&& field)
    {
        field("px", &DistributionParams::px, "", between(16, 16384), "width of a map in pixels");
        field("view", &DistributionParams::view,
              "from above, or a section from the south: the spaces that trees claim");
        field("above", &DistributionParams::above,
              "small trees over large ones, so that all are seen, or as birds see them");
        field("window", &DistributionParams::window, "m", kAny,
              "west, south, east and north of the part that is drawn; empty: all");
        field("min_height", &DistributionParams::min_height, "m", kNotNegative,
              "trees lower than this are left out");
        field("max_height", &DistributionParams::max_height, "m", kPositive,
              "trees higher than this are left out");
        field("columns", &DistributionParams::columns, "", between(0, 100),
              "of several scenes: maps beside each other; 0: up to four");
        field("seedlings", &DistributionParams::seedlings,
              "also those of the last step, which no step has judged; statistics count without "
              "them");
        field("labels", &DistributionParams::labels,
              "names of scenes, a scale bar and species with their numbers, below each map");
    }
};

Rgb colour_of(const forest::Species& species)
{
    auto channel = [&](std::size_t k) {
        return static_cast<std::uint8_t>(
            std::stoi(species.colour.substr(1 + 2 * k, 2), nullptr, 16));
    };
    return {channel(0), channel(1), channel(2)};
}

/// Part of a picture that circles are drawn into, and where the forest lies in it.
class Map {
public:
    Map(Image8& image, int left, int top, int width, int height, double scale)
        : image_(image), left_(left), top_(top), width_(width), height_(height), scale_(scale)
    {
    }

    /// Draws a disc, north up, with a darker rim where it is large enough to have one.
    /// @param x, y, radius  [m], from the south-western corner
    /// @param y0, y1        rows that may be drawn, from the map's upper end
    void disc(double x, double y, double radius, Rgb colour, int y0, int y1)
    {
        // What is smaller than a pixel fades instead. An edge that fades over a pixel adds pi / 12
        // to the area of a disc.
        const double wanted = radius * scale_, least = std::max(wanted, 0.5),
                     r = std::sqrt(least * least - 1.0 / 12),
                     ink = std::min(1.0, std::pow(wanted / least, 2)),
                     rim = 0.6 * std::clamp((r - 1.2) / 3, 0.0, 1.0),
                     half = std::clamp(r * 0.06, 0.5, 2.0);
        const double cx = x * scale_, cy = height_ - y * scale_, reach = r + 0.5;
        const int first = std::max(y0, int(std::floor(cy - reach))),
                  last = std::min(y1 - 1, int(std::ceil(cy + reach)));
        for (int j = first; j <= last; ++j) {
            const double dy = j + 0.5 - cy, chord = reach * reach - dy * dy;
            if (chord <= 0) continue;
            const double wide = std::sqrt(chord);
            row(j, cx - wide, cx + wide, colour, [&](double at) {
                const double dx = at - cx, inside = r - std::sqrt(dx * dx + dy * dy);
                return std::pair(ink * inside_share(inside), rim * rim_share(inside, half));
            });
        }
    }

    /// Draws the space of a tree from the side, half transparent.
    /// @param foot  height of its foot above the lower edge [m]
    void cone(double x, double foot, double height, double radius, forest::Orientation orientation,
              Rgb colour, int y0, int y1)
    {
        const double cx = x * scale_, base = height_ - foot * scale_, top = base - height * scale_,
                     wide = radius * scale_, high = height * scale_;
        const double upright = high / std::sqrt(high * high + wide * wide),
                     half = std::clamp(wide * 0.04, 0.5, 1.5);
        const int first = std::max(y0, int(std::floor(top - 1))),
                  last = std::min(y1 - 1, int(std::ceil(base)));
        for (int j = first; j <= last; ++j) {
            const double y = j + 0.5, up = std::clamp((base - y) / high, 0.0, 1.0);
            const bool flat = orientation == forest::Orientation::Flat;
            const double edge = wide * (flat                                          ? 1
                                        : orientation == forest::Orientation::Upright ? 1 - up
                                                                                      : up);
            row(j, cx - edge - 2, cx + edge + 2, colour, [&](double at) {
                const double inside = std::min(
                    {(edge - std::abs(at - cx)) * (flat ? 1 : upright), y - top, base - y});
                const double trunk = std::clamp(half + 0.5 - std::abs(at - cx), 0.0, 1.0);
                return std::pair(0.7 * inside_share(inside),
                                 std::max(0.6 * rim_share(inside, half), 0.7 * trunk));
            });
        }
    }

private:
    static double inside_share(double inside) { return std::clamp(inside + 0.5, 0.0, 1.0); }
    /// The rim lies inside the edge.
    static double rim_share(double inside, double half)
    {
        return std::clamp(half + 0.5 - std::abs(inside - half), 0.0, 1.0);
    }

    /// Blends pixels of one row; `ink` gives how much of a pixel is covered and how dark.
    template <class F>
    void row(int j, double from, double to, Rgb colour, F&& ink)
    {
        const int last = std::min(width_ - 1, int(std::ceil(to)));
        for (int i = std::max(0, int(std::floor(from))); i <= last; ++i) {
            const auto [cover, dark] = ink(i + 0.5);
            if (cover <= 0) continue;
            std::uint8_t* pixel = &image_.at(left_ + i, top_ + j);
            for (std::size_t c = 0; c < 3; ++c)
                pixel[c] = static_cast<std::uint8_t>(pixel[c] * (1 - cover) +
                                                     colour[int(c)] * (1 - dark) * cover + 0.5);
        }
    }

    Image8& image_;
    int left_, top_, width_, height_;
    double scale_;  // pixels a metre
};

struct Circle {
    float x, y, radius;  ///< from the window's south-western corner
    float foot, height;
    int species;
};

/// What is drawn of one scene.
struct Sheet {
    std::string name;
    double width = 0, depth = 0;  // of the window; of a section: its height [m]
    forest::Orientation orientation{};
    std::vector<forest::Species> species;
    std::vector<std::size_t> counts;  // by species
    std::vector<Circle> circles;      // in the order they are drawn
};

class DistributionStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{"distribution",
                                     "1",
                                     "draw a forest from above, each tree a circle as wide as its "
                                     "cone in the colour of its species, or a section through it",
                                     OutputKind::Picture,
                                     true,
                                     {"forest_instances", "canopy_height"},
                                     {},
                                     true};
        return kInfo;
    }
    std::vector<std::string> uses() override
    {
        if (params_.seedlings) return {};
        return {"forest_trees"};
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        validate_described("distribution", params_);
        if (params_.min_height > params_.max_height)
            throw InvalidParameter(
                fmt::format("distribution: min_height = {} m, must be at most max_height = {} m",
                            params_.min_height, params_.max_height));
        const auto& w = params_.window;
        if (!w.empty() && (w.size() != 4 || !(w[0] < w[2]) || !(w[1] < w[3])))
            throw InvalidParameter(
                "distribution: window: must be west, south, east and north in metres, west < east "
                "and south < north");
    }
    Need estimate(SceneOutline&, const StageContext&) override
    {
        return {0, 6.0 * params_.px * params_.px, 1e6};
    }
    Json run(Scene& scene, const StageContext& context) override
    {
        return run_many({{"", scene}}, context);
    }

    Json run_many(const std::vector<std::pair<std::string, Scene>>& scenes,
                  const StageContext& context) override
    {
        if (scenes.empty()) throw InvalidParameter("distribution: needs a scene with a forest");
        std::vector<Sheet> sheets;
        for (const auto& [name, scene] : scenes) sheets.push_back(sheet_of(name, scene));
        const int count = int(sheets.size());
        const int across = std::min(count, params_.columns > 0 ? params_.columns : 4);
        const int text = std::max(1, params_.px / 500), line = (render::kGlyphHeight + 4) * text;
        const int gap = count > 1 ? std::max(4, params_.px / 64) : 0;
        int high = 0;
        std::size_t kinds = 0;
        for (const Sheet& sheet : sheets) {
            high = std::max(high, height_of(sheet));
            kinds = std::max(kinds, sheet.species.size());
        }
        const int words = params_.labels ? line * (1 + int(kinds + 2) / 3) + 4 * text : 0;
        const int rows = (count + across - 1) / across;
        const int width = across * (params_.px + gap) + gap,
                  height = rows * (high + words + gap) + gap;
        if (double(width) * double(height) > 268435456.0)
            throw LimitExceeded(fmt::format(
                "distribution: {} x {} pixels, the limit is 2^28; make px smaller", width, height));
        picture = Image8(width, height, 3);
        // Between maps, which are white where no tree stands.
        std::fill(picture.pixels.begin(), picture.pixels.end(),
                  static_cast<std::uint8_t>(gap > 0 || params_.labels ? 238 : 255));
        std::size_t drawn = 0;
        for (int k = 0; k < count; ++k) {
            const Sheet& sheet = sheets[std::size_t(k)];
            const int left = gap + k % across * (params_.px + gap),
                      top = gap + k / across * (high + words + gap);
            draw(sheet, left, top, context);
            if (params_.labels) label(sheet, left, top + height_of(sheet), text, line);
            for (const std::size_t n : sheet.counts) drawn += n;
            context.progress.update(double(k + 1) / count);
        }
        return {{"trees", drawn}, {"width", picture.width}, {"height", picture.height}};
    }

private:
    int height_of(const Sheet& sheet) const
    {
        return std::clamp(int(std::lround(params_.px * sheet.depth / sheet.width)), 1, 65536);
    }

    Sheet sheet_of(const std::string& name, const Scene& scene) const
    {
        Sheet sheet;
        sheet.name = name;
        try {
            const ForestRecord record = forest_record(scene);
            const std::vector<double> window =
                params_.window.empty() ? std::vector<double>{0, 0, record.width, record.depth}
                                       : params_.window;
            sheet.width = window[2] - window[0];
            sheet.depth = window[3] - window[1];
            sheet.orientation = record.params.orientation;
            sheet.species = record.species;
            sheet.counts.resize(record.species.size());
            const Points& trees = scene.points_of("forest_instances");
            const auto* height = trees.values<float>("height");
            const auto* radius = trees.values<float>("cone_radius");
            const auto* species = trees.values<std::int32_t>("species");
            if (!height || !radius || !species)
                throw InvalidInput(
                    "forest_instances has no height, cone_radius or species; it is not from "
                    "`sekitei forest`");
            const std::vector<std::int64_t> young = seedlings_of(scene);
            const auto* id = trees.values<std::int64_t>("id");
            for (std::size_t i = 0; i < trees.position.size(); ++i) {
                if (id && std::binary_search(young.begin(), young.end(), (*id)[i])) continue;
                const int s = (*species)[i];
                if (s < 0 || s >= int(record.species.size()))
                    throw InvalidInput(
                        fmt::format("forest_instances: tree {} is of species {}, there are {}", i,
                                    s, record.species.size()));
                const double h = double((*height)[i]);
                if (!(h >= params_.min_height && h <= params_.max_height)) continue;
                const Vec3d at = trees.position[i] - record.corner - Vec3d(window[0], window[1], 0);
                const double r = double((*radius)[i]);
                const bool stands =
                    at.x >= 0 && at.x < sheet.width && at.y >= 0 && at.y < sheet.depth;
                sheet.counts[std::size_t(s)] += stands;
                const bool seen =
                    params_.view == View::Side
                        ? at.x > -r && at.x < sheet.width + r && at.y >= 0 && at.y < sheet.depth
                        : at.x > -r && at.x < sheet.width + r && at.y > -r &&
                              at.y < sheet.depth + r;
                if (seen)
                    sheet.circles.push_back(
                        {float(at.x), float(at.y), (*radius)[i], float(at.z), float(h), s});
            }
            if (params_.view == View::Side) {
                float low = 0, high = 1;
                for (std::size_t k = 0; k < sheet.circles.size(); ++k) {
                    const Circle& c = sheet.circles[k];
                    low = k == 0 ? c.foot : std::min(low, c.foot);
                    high = k == 0 ? c.foot + c.height : std::max(high, c.foot + c.height);
                }
                for (Circle& c : sheet.circles) c.foot -= low;
                sheet.depth = double(high - low) + 1;
            }
        } catch (const InvalidInput& error) {
            throw named_after(name, error);
        }
        std::stable_sort(
            sheet.circles.begin(), sheet.circles.end(), [&](const Circle& a, const Circle& b) {
                return params_.above == Above::Small ? a.radius > b.radius : a.radius < b.radius;
            });
        return sheet;
    }

    /// Ids of those to leave out, ascending.
    std::vector<std::int64_t> seedlings_of(const Scene& scene) const
    {
        std::vector<std::int64_t> ids;
        if (params_.seedlings || !scene.points.contains("forest_trees")) return ids;
        for (const forest::Tree& tree : forest_trees_of(scene))
            if (tree.age == 0) ids.push_back(signed_bits(tree.uid));
        std::sort(ids.begin(), ids.end());
        return ids;
    }

    void draw(const Sheet& sheet, int left, int top, const StageContext& context)
    {
        const int high = height_of(sheet);
        const double scale = params_.px / sheet.width;
        for (int y = 0; y < high; ++y)
            std::fill_n(&picture.at(left, top + y), 3 * params_.px, std::uint8_t(255));
        std::vector<Rgb> colours;
        for (const forest::Species& s : sheet.species) colours.push_back(colour_of(s));
        Map map(picture, left, top, params_.px, high, scale);
        // Bands of rows, each with all circles in their order.
        constexpr int kBand = 64;
        parallel_for(std::size_t((high + kBand - 1) / kBand), [&](std::size_t band) {
            context.progress.check();
            const int y0 = int(band) * kBand, y1 = std::min(high, y0 + kBand);
            const double north = (high - y0 + 1) / scale, south = (high - y1 - 1) / scale;
            if (params_.view == View::Side) {
                for (const Circle& c : sheet.circles)
                    map.cone(double(c.x), double(c.foot), double(c.height), double(c.radius),
                             sheet.orientation, colours[std::size_t(c.species)], y0, y1);
                return;
            }
            for (const Circle& c : sheet.circles)
                if (double(c.y + c.radius) > south && double(c.y - c.radius) < north)
                    map.disc(double(c.x), double(c.y), double(c.radius),
                             colours[std::size_t(c.species)], y0, y1);
        });
    }

    void label(const Sheet& sheet, int left, int top, int text, int line)
    {
        constexpr Rgb kInk{40, 40, 40}, kPale{110, 110, 110};
        const double scale = params_.px / sheet.width;
        int y = top + 4 * text;
        if (!sheet.name.empty())
            render::draw_text(picture, left + 2 * text, y, sheet.name, text, kInk);
        // A bar of 1, 2 or 5 times a power of ten, at most a third of the map.
        double metres = 1;
        while (metres * 10 <= sheet.width / 3) metres *= 10;
        while (metres > sheet.width / 3) metres /= 10;
        for (const double more : {5.0, 2.0})
            if (metres * more <= sheet.width / 3) {
                metres *= more;
                break;
            }
        const int bar = std::max(1, int(std::lround(metres * scale)));
        const int right = left + params_.px - 2 * text;
        const std::string size = fmt::format("{:g} m", metres);
        for (int x = right - bar; x < right; ++x)
            for (int k = 0; k < 2 * text; ++k)
                for (int c = 0; c < 3; ++c) picture.at(x, y + 3 * text + k, c) = kInk[c];
        render::draw_text(picture, right - bar - render::text_width(size, text) - 3 * text, y, size,
                          text, kInk);
        y += line;
        const int third = params_.px / 3;
        for (std::size_t s = 0; s < sheet.species.size(); ++s) {
            const int x = left + int(s % 3) * third, row = y + int(s / 3) * line;
            const int side = 7 * text;
            Map(picture, x + 2 * text, row, side + 1, side + 1, 1)
                .disc(side / 2.0 + 0.5, side / 2.0 + 0.5, side / 2.0, colour_of(sheet.species[s]),
                      0, side + 1);
            render::draw_text(picture, x + side + 6 * text, row, sheet.species[s].name, text, kInk);
            render::draw_text(
                picture, x + side + 10 * text + render::text_width(sheet.species[s].name, text),
                row, fmt::format("{}", sheet.counts[s]), text, kPale);
        }
    }

    DistributionParams params_;
};

}  // namespace

std::unique_ptr<Stage> make_distribution()
{
    return std::make_unique<DistributionStage>();
}

}  // namespace sekitei::apps
