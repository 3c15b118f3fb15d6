#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "apps/climate.h"
#include "apps/stages/compare_lines.h"
#include "apps/trees.h"
#include "core/error.h"

namespace sekitei::apps {
namespace {

/// Mean of a grid over the surface cells, by their area; NaN where there is none.
double mean_of(const Scene& scene, const char* name)
{
    if (!scene.has(name) || !scene.has("surf_area")) return NAN;
    const FloatGrid &values = scene.floats(name), &area = scene.floats("surf_area");
    GridReader<float> reader(values);
    double sum = 0, all = 0;
    for (std::size_t leaf = 0; leaf < area.leaf_count(); ++leaf)
        area.mask(leaf).for_each([&](int offset) {
            const double a = double(area.at(leaf, offset));
            sum += a * double(reader.value(leaf_coord(area.origin(leaf), offset)));
            all += a;
        });
    return all > 0 ? sum / all : NAN;
}

double mean_of(const wind::AirTables::Table& table)
{
    return std::accumulate(table.begin(), table.end(), 0.0) / double(table.size());
}

/// The mean light of all the children that single trees ever had, before death chose among them,
/// and how many tips live in the end.
struct Crowns {
    double light = NAN, tips = NAN;
};
Crowns crowns_of(const Scene& scene)
{
    if (!scene.points.contains("tree_growth")) return {};
    const std::vector<tree::GenerationStatistics> rows = growth_of(scene);
    if (rows.empty()) return {};
    double light = 0, births = 0;
    for (const tree::GenerationStatistics& row : rows) {
        light += row.mean_light * double(row.births);
        births += double(row.births);
    }
    return {births > 0 ? light / births : NAN, double(rows.back().tips)};
}

/// What a scene has that the other may lack.
bool has_leaves(const Scene& scene)
{
    return scene.has("canopy_lad") || scene.points.contains("leaves");
}

}  // namespace

std::vector<Line> garden_lines(const std::vector<std::pair<std::string, Scene>>& scenes)
{
    constexpr double kAny = std::numeric_limits<double>::infinity();
    LineList lines;
    const std::string& first_name = scenes.front().first;
    const Scene& first = scenes.front().second;
    const std::optional<wind::AirTables> air =
        first.points.contains("air_tables") ? std::optional(tables_of(first)) : std::nullopt;
    if (air && first.has("water_surface"))
        lines.bound("air that touched water before the garden, mean of 8 winds (A_T)", first_name,
                    mean_of(air->temperature), 0.01, kAny);
    for (std::size_t k = 1; k < scenes.size(); ++k) {
        const std::string& name = scenes[k].first;
        const Scene& other = scenes[k].second;
        auto beside = [&](const std::string& measure, double with, double without, double lower,
                          double upper) {
            if (std::isfinite(with) && std::isfinite(without))
                lines.ratio(measure, fmt::format("{} / {}", first_name, name), with, without, lower,
                            upper);
        };
        const bool bare = has_leaves(first) && !has_leaves(other);
        const bool dry = first.has("water_surface") && !other.has("water_surface");
        const std::optional<wind::AirTables> theirs =
            other.points.contains("air_tables") ? std::optional(tables_of(other)) : std::nullopt;
        if (bare) {
            beside("light on ground and stones [W/m2]: leaves shade them",
                   mean_of(first, "light_S"), mean_of(other, "light_S"), -kAny, 0.95);
            if (air && theirs)
                beside("wind before the garden, mean of 8 (A_U): leaves slow it",
                       mean_of(air->speed), mean_of(theirs->speed), -kAny, 0.95);
        }
        if (dry) {
            if (theirs)
                lines.bound("air that touched water, without a pond (A_T)", name,
                            mean_of(theirs->temperature), 0, 0);
            beside("humidity of the ground: the pond moistens the air", mean_of(first, "soil_rh"),
                   mean_of(other, "soil_rh"), 1, kAny);
        }
        if (!bare && !dry) {
            // Other stones: those of the ground's level set count.
            const Crowns here = crowns_of(first), there = crowns_of(other);
            beside("light of the trees' leaves: stones take some", here.light, there.light, -kAny,
                   0.98);
            beside("living tips of the trees", here.tips, there.tips, -kAny, kAny);
        }
        beside("water of the ground, share of what it holds", mean_of(first, "soil_theta"),
               mean_of(other, "soil_theta"), -kAny, kAny);
        beside("humidity of the ground", mean_of(first, "soil_rh"), mean_of(other, "soil_rh"),
               -kAny, kAny);
        beside("living moss, share of the surface", mean_of(first, "moss_cover"),
               mean_of(other, "moss_cover"), -kAny, kAny);
    }
    if (lines.list.empty())
        throw InvalidInput(
            "compare: with coupling: the scenes have nothing to compare; give what `light`, "
            "`wind`, `soil`, `moss` or `tree` made");
    return std::move(lines.list);
}

}  // namespace sekitei::apps
