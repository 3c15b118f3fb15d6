#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <map>

#include "apps/stages/compare_lines.h"
#include "apps/trees.h"
#include "core/error.h"
#include "solvers/tree/shape.h"

namespace sekitei::apps {
namespace {

constexpr double kAny = std::numeric_limits<double>::infinity();
constexpr std::array<int, 9> kFigures{1, 5, 6, 10, 11, 12, 13, 14, 16};

struct Form {
    tree::Grove grove;
    tree::Shape shape;
    std::vector<tree::GenerationStatistics> growth;

    double tips() const { return double(shape.tips); }
    /// Of one tree.
    tree::Shape of(int tree) const { return tree::shape_of(grove, tree); }

    /// Largest part of a direction that differs from its parent's.
    double crookedness() const
    {
        const tree::Branches& b = grove.branches();
        double most = 0;
        for (std::size_t i = 0; i < b.size(); ++i)
            if (b.parent[i] >= 0)
                most =
                    std::max(most, length(b.direction[i] - b.direction[std::size_t(b.parent[i])]));
        return most;
    }
    /// Where the lowest living bough of a conifer begins, above its origin.
    double lowest_bough() const
    {
        const tree::Branches& b = grove.branches();
        double low = kAny;
        for (std::size_t i = 0; i < b.size(); ++i)
            if (b.order[i] == 1 && b.alive(i) && b.parent[i] >= 0 &&
                b.order[std::size_t(b.parent[i])] == 0)
                low = std::min(low, b.start[i].z - grove.plants()[std::size_t(b.tree[i])].origin.z);
        return low;
    }
    /// Mean sprouts of the last generations.
    double sprouts(std::size_t last) const
    {
        double sum = 0;
        const std::size_t n = std::min(last, growth.size());
        for (std::size_t k = growth.size() - n; k < growth.size(); ++k)
            sum += double(growth[k].sprouts);
        return n > 0 ? sum / double(n) : 0;
    }
};

class Lines : public LineList {
public:
    Lines(int figure, const std::vector<std::pair<std::string, Scene>>& scenes) : figure_(figure)
    {
        for (const auto& [name, scene] : scenes) {
            try {
                GroveRecord record = grove_record(scene);
                tree::Grove grove(record.params, record.species, std::move(record.state));
                const tree::Shape shape = tree::shape_of(grove);
                forms_.emplace(scene_key(name), Form{std::move(grove), shape, growth_of(scene)});
            } catch (const InvalidInput& error) {
                throw InvalidInput(name + ": " + error.what());
            }
        }
    }
    const Form& form(const std::string& key) const
    {
        const auto found = forms_.find(key);
        if (found == forms_.end()) {
            std::vector<std::string> there;
            for (const auto& [name, form] : forms_) there.push_back(name);
            throw InvalidInput(
                fmt::format("compare: figure = {}: there is no scene '{}' (or fig{:02}{}) among {}",
                            figure_, key, figure_, key, fmt::join(there, ", ")));
        }
        return found->second;
    }

    /// Each next one's value above (sign 1) or below (-1) the one before.
    template <class F>
    void strictly(const std::string& measure, const std::vector<std::string>& keys, int sign,
                  F&& value)
    {
        for (std::size_t k = 0; k < keys.size(); ++k) {
            const double now = value(form(keys[k]));
            if (k == 0) {
                info(measure, keys[k], now);
                continue;
            }
            after(measure, keys[k], now, value(form(keys[k - 1])), sign);
        }
    }

private:
    int figure_;
    std::map<std::string, Form> forms_;
};

void buds(Lines& lines)  // figure 5
{
    const Form& straight = lines.form("a");
    lines.bound("turn from branch to branch", "a", straight.crookedness(), -kAny, 1e-12);
    lines.info("tips that point up", "a", straight.shape.upward);
    lines.ratio("nearest tips, st.dev. / mean, beside c", "a", straight.shape.spacing_cv,
                lines.form("c").shape.spacing_cv, 1.5, kAny);
    for (const std::string key : {"b", "c"}) {
        const tree::Shape& s = lines.form(key).shape;
        lines.bound("tips that point up", key, s.upward, 1 - 1e-9, kAny);
        lines.bound("lowest tip over the buds' centre", key, s.lowest, 0, kAny);
        lines.bound("nearest tips, st.dev. / mean", key, s.spacing_cv, -kAny,
                    key == "b" ? 0.30 : 0.20);
        if (key == "c")
            lines.bound("sphericity", key, s.sphericity, 0.88, kAny);
        else
            lines.info("sphericity", key, s.sphericity);
    }
}

void clusters(Lines& lines)  // figure 6
{
    for (const std::string key : {"a", "b"}) {
        const tree::Shape& s = lines.form(key).shape;
        lines.bound("largest / mean distance of nearest tips", key, s.spacing_gap, -kAny, 1.9);
        lines.bound("sphericity", key, s.sphericity, 0.83, kAny);
        lines.bound("nearest tips, st.dev. / mean", key, s.spacing_cv, -kAny, 0.25);
    }
    const tree::Shape& s = lines.form("c").shape;
    lines.bound("tips that point up", "c", s.upward, 1 - 1e-9, kAny);
    lines.bound("lowest tip over the buds' foot", "c", s.lowest, 0, kAny);
    lines.bound("nearest tips, st.dev. / mean", "c", s.spacing_cv, -kAny, 0.20);
    lines.bound("sphericity", "c", s.sphericity, 0.85, kAny);
    lines.ratio("height of the crown / its width", "c", s.highest - s.lowest, s.width, 1, kAny);
}

void tropism(Lines& lines)  // figure 10
{
    const tree::Shape &a = lines.form("a").shape, &b = lines.form("b").shape;
    lines.bound("holes in the top view", "a", a.hole_cv, 1, kAny);
    lines.bound("difference of the tips' heights", "b", b.highest - b.lowest, -kAny, 1e-9);
    lines.bound("weeping", "b", b.weeping, 0, 0);
    lines.bound("tips", "b", double(b.tips), 183, 210);
    lines.strictly("tips", {"b", "c", "d", "e", "f"}, 1, [](const Form& f) { return f.tips(); });
    lines.strictly("weeping", {"c", "d", "e", "f"}, 1,
                   [](const Form& f) { return f.shape.weeping; });
    for (const std::string key : {"c", "d", "e", "f"})
        lines.bound("holes in the top view", key, lines.form(key).shape.hole_cv, -kAny,
                    std::min(0.55, a.hole_cv / 2));
}

void neighbours(Lines& lines)  // figure 11
{
    // The tree on the right is number 1.
    const double before = lines.form("before").of(1).lean.x;
    lines.bound("lean of the right tree, two trees", "before", before, 0.2, kAny);
    lines.ratio("its lean later, left tree felled", "removed", lines.form("removed").of(1).lean.x,
                before, -kAny, 0.5);
    lines.ratio("its lean later, left tree kept", "kept", lines.form("kept").of(1).lean.x, before,
                0.6, kAny);
    lines.info("largest / mean distance of nearest tips", "kept",
               lines.form("kept").shape.spacing_gap);
    lines.info("sphericity of both", "kept", lines.form("kept").shape.sphericity);
}

void radius(Lines& lines)  // figure 12
{
    const std::vector<std::string> keys{"a", "b", "c", "d", "e"};
    lines.strictly("tips", keys, 1, [](const Form& f) { return f.tips(); });
    auto spread = [&](const std::string& measure, double most, auto&& value) {
        double low = kAny, high = -kAny;
        for (const std::string& key : keys) {
            const double v = value(lines.form(key));
            low = std::min(low, v);
            high = std::max(high, v);
        }
        lines.ratio(measure + ", largest / smallest", "a to e", high, low, 1, most);
    };
    spread("tips R^2", 1.6, [](const Form& f) {
        const double r = f.grove.species().front().ball_radius;
        return f.tips() * r * r;
    });
    spread("radius of the crown", 1.1, [](const Form& f) { return f.shape.radius_max; });
    spread("height", 1.1, [](const Form& f) { return f.shape.highest; });
}

void threshold(Lines& lines)  // figure 13
{
    const std::vector<std::string> keys{"a", "b", "c"};
    lines.strictly("tips", keys, 1, [](const Form& f) { return f.tips(); });
    lines.strictly("lowest tip", keys, -1, [](const Form& f) { return f.shape.lowest; });
    lines.strictly("weeping", keys, 1, [](const Form& f) { return f.shape.weeping; });
}

void light_ratio(Lines& lines)  // figure 14
{
    const std::vector<std::string> keys{"a", "b", "c", "d"};
    lines.strictly("radius of the crown", keys, -1,
                   [](const Form& f) { return f.shape.radius_max; });
    lines.strictly("mean height of tips", keys, 1,
                   [](const Form& f) { return f.shape.mean_height; });
}

void conifer(Lines& lines)  // figure 16, 17
{
    const Form &a = lines.form("a"), &b = lines.form("b");
    lines.bound("R2 of a straight profile", "a", tree::profile_r2(a.grove, 0.6), 0.95, kAny);
    lines.bound("start of the lowest living bough", "a", a.lowest_bough(), -kAny, 2);
    lines.bound("start of the lowest living bough, shedding", "b", b.lowest_bough(), 18, kAny);
}

void pollard(Lines& lines)  // figure 1, 17
{
    lines.info("tips before the cut", "before", lines.form("before").tips());
    lines.bound("tips without latent buds", "bare", lines.form("bare").tips(), 0, 0);
    lines.bound("tips with latent buds", "pollard", lines.form("pollard").tips(), 180, kAny);
    lines.bound("sprouts in each of the last 5 generations", "pollard",
                lines.form("pollard").sprouts(5), -kAny, 3);
}

}  // namespace

bool is_tree_figure(int figure)
{
    return std::find(kFigures.begin(), kFigures.end(), figure) != kFigures.end();
}

std::string tree_figures()
{
    return fmt::format("{}", fmt::join(kFigures, ", "));
}

std::vector<Line> tree_lines(int figure, const std::vector<std::pair<std::string, Scene>>& scenes)
{
    Lines lines(figure, scenes);
    switch (figure) {
        case 1:
            pollard(lines);
            break;
        case 5:
            buds(lines);
            break;
        case 6:
            clusters(lines);
            break;
        case 10:
            tropism(lines);
            break;
        case 11:
            neighbours(lines);
            break;
        case 12:
            radius(lines);
            break;
        case 13:
            threshold(lines);
            break;
        case 14:
            light_ratio(lines);
            break;
        case 16:
            conifer(lines);
            break;
        default:
            throw InvalidParameter(
                fmt::format("compare: figure = {}, must be one of {}", figure, tree_figures()));
    }
    return lines.list;
}

}  // namespace sekitei::apps
