#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>

#include "apps/forest.h"
#include "apps/stages/compare_lines.h"
#include "core/error.h"
#include "core/math.h"

namespace sekitei::apps {
namespace {

constexpr double kAny = std::numeric_limits<double>::infinity();
constexpr std::array<int, 8> kFigures{48, 49, 51, 52, 54, 55, 56, 57};

/// Radii of the clearing of figures 4.8 and 4.9: its maps change within 64 m of the middle.
constexpr double kInner = 50, kOuter = 60;  // [m]

struct Stand {
    ForestRecord record;
    std::vector<forest::StepStatistics> rows;
    std::vector<forest::Tree> trees;  ///< that have competed: seedlings of the last step are not
    double density = NAN;             ///< where it is one number
    double hectares = 1;

    Stand(const Scene& scene)
        : record(forest_record(scene)),
          rows(forest_growth_of(scene)),
          trees(forest_trees_of(scene)),
          hectares(record.width * record.depth / 1e4)
    {
        if (rows.empty()) throw InvalidInput("its forest has not grown a step");
        std::erase_if(trees, [](const forest::Tree& tree) { return tree.age == 0; });
        for (const forest::Tree& tree : trees)
            if (tree.species >= record.species.size())
                throw InvalidInput(fmt::format("forest_trees: a tree is of species {} of {}",
                                               tree.species + 1, record.species.size()));
    }

    /// @throws InvalidInput
    const forest::StepStatistics& at(int step) const
    {
        for (const forest::StepStatistics& row : rows)
            if (row.step == step) return row;
        throw InvalidInput(fmt::format("its forest has no step {}, only {} to {}", step,
                                       rows.front().step, rows.back().step));
    }
    int step() const { return rows.back().step; }
    double total() const { return double(rows.back().trees); }
    double of_class(int k) const { return double(rows.back().of_class(k)); }
    double of_species(std::size_t s) const
    {
        return count([&](const forest::Tree& tree) { return tree.species == s; });
    }
    template <class F>
    double count(F&& f) const
    {
        return double(std::count_if(trees.begin(), trees.end(), f));
    }
    double from_middle(const forest::Tree& tree) const
    {
        return std::hypot(tree.x - record.width / 2, tree.y - record.depth / 2);
    }
    double within(double radius, double min_height = 0) const
    {
        return count([&](const forest::Tree& tree) {
            return from_middle(tree) <= radius && tree.height >= min_height;
        });
    }
    double innermost() const
    {
        double least = kAny;
        for (const forest::Tree& tree : trees) least = std::min(least, from_middle(tree));
        return least;
    }
    double lowest() const
    {
        double least = kAny;
        for (const forest::Tree& tree : trees) least = std::min(least, tree.height);
        return least;
    }

    /// Trees up to 5 m whose trunk stands under the cone of one of 15 m or more, per hectare.
    double sheltered() const
    {
        std::vector<double> slopes;
        for (const forest::Species& s : record.species)
            slopes.push_back(forest::slope_of(s, record.params.spread_mode));
        double widest = 1;
        for (const forest::Tree& tree : trees)
            if (tree.height >= 15) widest = std::max(widest, slopes[tree.species] * tree.height);
        const double cell = std::max(widest, record.width / 2000);
        const int across = int(record.width / cell) + 1, down = int(record.depth / cell) + 1;
        std::vector<std::vector<const forest::Tree*>> tall(std::size_t(across) * std::size_t(down));
        auto column = [&](double x) { return std::clamp(int(x / cell), 0, across - 1); };
        auto row = [&](double y) { return std::clamp(int(y / cell), 0, down - 1); };
        for (const forest::Tree& tree : trees)
            if (tree.height >= 15)
                tall[std::size_t(row(tree.y) * across + column(tree.x))].push_back(&tree);
        auto covered = [&](const forest::Tree& small) {
            for (int j = std::max(0, row(small.y) - 1); j <= std::min(down - 1, row(small.y) + 1);
                 ++j)
                for (int i = std::max(0, column(small.x) - 1);
                     i <= std::min(across - 1, column(small.x) + 1); ++i)
                    for (const forest::Tree* tree : tall[std::size_t(j * across + i)])
                        if (std::hypot(tree->x - small.x, tree->y - small.y) <=
                            slopes[tree->species] * tree->height)
                            return true;
            return false;
        };
        return count([&](const forest::Tree& t) { return t.height <= 5 && covered(t); }) / hectares;
    }
};

class Lines : public LineList {
public:
    Lines(int figure, const std::vector<std::pair<std::string, Scene>>& scenes) : figure_(figure)
    {
        for (const auto& [name, scene] : scenes) {
            try {
                Stand stand(scene);
                if (figure == 52) stand.density = forest_density(scene);
                stands_.emplace(scene_key(name), std::move(stand));
            } catch (const InvalidInput& error) {
                throw InvalidInput(name + ": " + error.what());
            }
        }
    }
    const Stand& stand(const std::string& key) const
    {
        const auto found = stands_.find(key);
        if (found != stands_.end()) return found->second;
        std::vector<std::string> there;
        for (const auto& [name, stand] : stands_) there.push_back(name);
        throw InvalidInput(
            fmt::format("compare: figure = {}: there is no scene '{}' (or fig{}_{}) among {}",
                        figure_, key, figure_, key, fmt::join(there, ", ")));
    }
    const std::map<std::string, Stand>& stands() const { return stands_; }
    bool has(const std::string& key) const { return stands_.contains(key); }

private:
    int figure_;
    std::map<std::string, Stand> stands_;
};

void felling(Lines& lines)  // figure 4.8
{
    const Stand& before = lines.stand("before");
    lines.info("trees of 16 m and more within 50 m", "before", before.within(kInner, 16));
    for (const auto& [key, stand] : lines.stands()) {
        if (key == "before") continue;
        lines.bound("trees of 16 m and more within 50 m", key, stand.within(kInner, 16), 0, 0);
        lines.ratio("trees within 50 m, beside before", key, stand.within(kInner),
                    before.within(kInner), 0.9, kAny);
    }
}

void filling(Lines& lines)  // figure 4.9
{
    lines.bound("trunks within 60 m", "before", lines.stand("before").within(kOuter), 0, 0);
    std::vector<std::pair<int, std::string>> order;
    for (const auto& [key, stand] : lines.stands())
        if (key != "before") order.emplace_back(stand.step(), key);
    std::sort(order.begin(), order.end());
    const Stand* last = nullptr;
    for (const auto& [step, key] : order) {
        const Stand& now = lines.stand(key);
        const std::string count = "trees within 50 m", near = "innermost trunk [m]";
        if (!last) {
            lines.info(count, key, now.within(kInner));
            lines.info(near, key, now.innermost());
        } else {
            lines.after(count, key, now.within(kInner), last->within(kInner), 1);
            lines.after(near, key, now.innermost(), last->innermost(), -1);
            lines.bound("innermost trunk, nearer in a step [m]", key,
                        (last->innermost() - now.innermost()) / (now.step() - last->step()), -kAny,
                        30);
        }
        last = &now;
    }
}

void settling(Lines& lines)  // figure 5.1
{
    for (const auto& [key, stand] : lines.stands()) {
        const double n40 = double(stand.at(40).trees), n50 = double(stand.at(50).trees);
        const double tall = double(stand.at(50).of_class(3));
        lines.bound("trees at 50 per hectare", key, n50 / stand.hectares, 0.97 * 4387, 1.03 * 4387);
        lines.bound("trees, change from 40 to 50", key, std::abs(n50 - n40) / n50, -kAny, 0.05);
        lines.bound("trees above 12 m, change from 40 to 50", key,
                    std::abs(tall - double(stand.at(40).of_class(3))) / tall, -kAny, 0.02);
        if (stand.step() > 50)
            lines.ratio(fmt::format("trees at {} / at 50", stand.step()), key, stand.total(), n50,
                        0.85, 1.15);
    }
}

void densities(Lines& lines)  // figure 5.2
{
    std::vector<std::pair<double, std::string>> order;
    for (const auto& [key, stand] : lines.stands()) order.emplace_back(stand.density, key);
    std::sort(order.begin(), order.end());
    std::vector<double> total;
    double before = 0;
    for (const auto& [density, key] : order) {
        const Stand& stand = lines.stand(key);
        const std::string measure = fmt::format("trees above 12 m, density {:g}", density);
        const double tall = stand.of_class(3);
        // Trees of 1 m and more die wherever R cannot reach r1; those of r2 stand still.
        if (density < stand.record.params.r2)
            lines.bound(measure, key, tall, 0, 0);
        else if (before == 0)
            lines.bound(measure, key, tall, 1, kAny);
        else
            lines.after(measure, key, tall, before, 1);
        before = tall;
        total.push_back(stand.total());
    }
    for (std::size_t k = 0; k < order.size(); ++k)
        lines.info(fmt::format("trees, density {:g}", order[k].first), order[k].second, total[k]);
    // Spearman's coefficient; equal numbers share the mean of their ranks.
    if (const double n = double(total.size()); n >= 3) {
        double mean = (n + 1) / 2, product = 0, squares = 0, line = 0;
        for (std::size_t k = 0; k < total.size(); ++k) {
            double rank = 0.5;
            for (const double other : total)
                rank += other < total[k] ? 1 : other == total[k] ? 0.5 : 0;
            product += (rank - mean) * (double(k + 1) - mean);
            squares += (rank - mean) * (rank - mean);
            line += (double(k + 1) - mean) * (double(k + 1) - mean);
        }
        lines.bound("rank correlation of trees and density", "all",
                    squares > 0 ? product / std::sqrt(squares * line) : 0, 0.8, kAny);
    }
    auto at = [&](double density) -> const Stand* {
        for (const auto& [d, key] : order)
            if (std::abs(d - density) < 1e-9) return &lines.stand(key);
        return nullptr;
    };
    if (const Stand* full = at(1), *less = at(0.4); full && less)
        lines.ratio("trees, density 1 / 0.4", "all", full->total(), less->total(), 1.1, kAny);
}

void layers(Lines& lines)  // figure 5.4
{
    const Stand& plain = lines.stand("inverted");
    static constexpr std::array<const char*, 4> kNames{"up to 3 m", "3 to 8 m", "8 to 12 m",
                                                       "above 12 m"};
    for (int k = 0; k < 4; ++k) {
        const std::string measure = std::string("trees ") + kNames[std::size_t(k)];
        if (k == 0)
            lines.bound(measure, "inverted", plain.of_class(k), 1, kAny);
        else
            lines.after(measure, "inverted", plain.of_class(k), plain.of_class(k - 1), -1);
    }
    lines.bound("trees above 12 m, at least one", "inverted", plain.of_class(3), 1, kAny);
    const std::string under = "trees <= 5 m under crowns of trees >= 15 m, per ha";
    lines.bound(under, "inverted", plain.sheltered(), 1000, kAny);
    for (const std::string key : {"upright", "flat"})
        if (lines.has(key)) lines.bound(under, key, lines.stand(key).sheltered(), 0, 100);
}

void thinning(Lines& lines)  // figure 5.5
{
    const Stand &dense = lines.stand("dense"), &thin = lines.stand("thin");
    lines.ratio("trees above 12 m, thin / dense", "thin", thin.of_class(3), dense.of_class(3), 0.35,
                0.65);
    lines.ratio("trees, thin / dense", "thin", thin.total(), dense.total(), 0.75, 0.95);
}

void path(Lines& lines)  // figure 5.6
{
    const Stand& plain = lines.stand("plain");
    for (const auto& [key, stand] : lines.stands()) {
        if (key == "plain") continue;
        const double trunks = stand.count([](const forest::Tree& tree) {
            return std::abs(tree.x - 256 - 64 * math::sin(2 * std::numbers::pi * tree.y / 512)) < 4;
        });
        lines.bound(fmt::format("trunks on the path after step {}", stand.step()), key, trunks, 0,
                    0);
        // Later the forest is the plain one but for its path.
        if (stand.step() == plain.step())
            lines.ratio("trees, with the path / without", key, stand.total(), plain.total(), 0.95,
                        1.05);
    }
}

void clearing(Lines& lines)  // figure 5.7
{
    const Stand &before = lines.stand("before"), &after = lines.stand("after");
    auto tall = [](const Stand& stand) {
        return stand.count([](const forest::Tree& tree) { return tree.height > 16; });
    };
    for (std::size_t s = 0; s < before.record.species.size(); ++s)
        if (before.record.species[s].max_height < 5) {
            const std::string measure = "trees of " + before.record.species[s].name;
            lines.info(measure, "before", before.of_species(s));
            lines.bound(measure, "after", after.of_species(s), 0, 0);
        }
    lines.bound("lowest tree [m]", "after", after.lowest(), 5, kAny);
    lines.ratio("trees above 16 m, after / before", "after", tall(after), tall(before), 0.98, kAny);
    double least = kAny, most = 0;
    for (const forest::StepStatistics& row : after.rows)
        if (row.step >= 40) {
            least = std::min(least, double(row.trees));
            most = std::max(most, double(row.trees));
        }
    lines.bound(fmt::format("trees, most less fewest of steps 40 to {}", after.step()), "after",
                most - least, 0, 0);
}

}  // namespace

bool is_forest_figure(int figure)
{
    return std::find(kFigures.begin(), kFigures.end(), figure) != kFigures.end();
}

std::string forest_figures()
{
    return fmt::format("{}", fmt::join(kFigures, ", "));
}

std::vector<Line> forest_lines(int figure, const std::vector<std::pair<std::string, Scene>>& scenes)
{
    Lines lines(figure, scenes);
    switch (figure) {
        case 48:
            felling(lines);
            break;
        case 49:
            filling(lines);
            break;
        case 51:
            settling(lines);
            break;
        case 52:
            densities(lines);
            break;
        case 54:
            layers(lines);
            break;
        case 55:
            thinning(lines);
            break;
        case 56:
            path(lines);
            break;
        case 57:
            clearing(lines);
            break;
        default:
            throw InvalidParameter(
                fmt::format("compare: figure = {}, must be one of {}", figure, forest_figures()));
    }
    return lines.list;
}

}  // namespace sekitei::apps
