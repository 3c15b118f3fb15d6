#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "core/random.h"
#include "grids/nearest_polyline.h"
#include "solvers/weathering/weathering.h"
#include "tests/solvers/presets/chain.h"
#include "tests/support/shapes.h"

/// What the paper's figure 11 shows of its four families, at the paper's size.
namespace sekitei::presets {
namespace {

constexpr double kTop = 1 - 3.0 / 32;  // of the lava, share of the box's height

TEST(Chevron, HasTwoVerticalSetsThatMeetAtMidHeight)
{
    const Body body(lava::Preset::Chevron);
    ASSERT_EQ(body.lava.domain.dims, Coord(250, 250, 250));
    const std::vector<Vec3d> seeds = body.seeds();
    const Polylines lines = body.lines(seeds);
    ASSERT_EQ(lines.count(), 800u);
    std::size_t upper = 0;
    for (std::size_t i = 0; i < lines.count(); ++i) {
        EXPECT_EQ(lines.stop[i], StopReason::Flat) << i;
        for (std::size_t k = 0; k < lines.size(i); ++k)
            EXPECT_LT(std::hypot(lines.line(i)[k].x - seeds[i].x, lines.line(i)[k].y - seeds[i].y),
                      1e-6);
        // The plateau of four cells of 7.8 voxels, less the half cell in which directions fade.
        const bool above = seeds[i].z > 125;
        EXPECT_NEAR(end_of(lines, i).z, above ? 125 + 12.1 : 125 - 12.1, 0.5);
        upper += above;
    }
    EXPECT_NEAR(static_cast<double>(upper), 400, 20);

    // Columns change once on the way up.
    const PolylineIndex index(lines);
    auto is_upper = [&](Vec3d p) {
        return seeds[static_cast<std::size_t>(index.nearest(p).line)].z > 125;
    };
    for (std::uint64_t k = 0; k < 400; ++k) {
        const double x = 250 * uniform01(3, Stream{"x"}, k), y = 250 * uniform01(3, Stream{"y"}, k);
        for (double z = 24; z < 122; z += 1) {
            EXPECT_FALSE(is_upper({x, y, z}));
            EXPECT_TRUE(is_upper({x, y, 250 - z}));
        }
        int changes = 0;
        for (double z = 122; z < 128; z += 0.5)
            changes += is_upper({x, y, z}) != is_upper({x, y, z + 0.5});
        EXPECT_EQ(changes, 1);
    }
}

/// Largest and mean angle between the lines that reach the slow part and its normal [degrees].
struct Angles {
    std::size_t count = 0;
    double worst = 0, mean = 0;
};
template <class Normal, class Chosen>
Angles angles_at_the_slow_part(const Polylines& lines, Normal&& normal, Chosen&& chosen)
{
    Angles angles;
    for (std::size_t i = 0; i < lines.count(); ++i) {
        if (lines.stop[i] != StopReason::LeftLava || !chosen(end_of(lines, i))) continue;
        const double angle = degrees(dot(last_direction(lines, i), normal(end_of(lines, i))));
        angles.worst = std::max(angles.worst, angle);
        angles.mean += angle;
        ++angles.count;
    }
    angles.mean /= static_cast<double>(angles.count);
    return angles;
}

TEST(Rosette, LinesBendAndEndOnTheVentAtRightAngles)
{
    const Body body(lava::Preset::Rosette);
    const std::vector<Vec3d> seeds = body.seeds();
    const Polylines lines = body.lines(seeds);
    const Vec3d centre(125, 125, 125);
    EXPECT_EQ(std::count(lines.stop.begin(), lines.stop.end(), StopReason::LeftLava), 800);
    for (std::size_t i = 0; i < lines.count(); ++i)
        EXPECT_NEAR(length(end_of(lines, i) - centre), 37.5, 0.02);
    const Angles angles = angles_at_the_slow_part(
        lines, [&](Vec3d p) { return normalized(centre - p); }, [](Vec3d) { return true; });
    EXPECT_EQ(angles.count, 800u);
    EXPECT_LT(angles.worst, 15);
    EXPECT_LT(angles.mean, 5);
    // They set out straight down or up.
    for (std::size_t i = 0; i < lines.count(); ++i) {
        const Vec3d first = normalized(lines.line(i)[1] - lines.line(i)[0]);
        EXPECT_GT(std::abs(first.z), 0.9);
    }
}

TEST(Fan, LinesSpreadToMeetTheValleyWallAtRightAngles)
{
    const Body body(lava::Preset::Fan);
    const std::vector<Vec3d> seeds = body.seeds();
    const Polylines lines = body.lines(seeds);
    EXPECT_GE(std::count(lines.stop.begin(), lines.stop.end(), StopReason::LeftLava), 395);
    auto from_axis = [](Vec3d p) { return p.x / 250 - .5; };
    for (std::size_t i = 0; i < lines.count(); ++i) {
        const Vec3d end = end_of(lines, i);
        if (lines.stop[i] != StopReason::LeftLava) continue;
        EXPECT_NEAR(end.z / 250, .12 + 1.6 * from_axis(end) * from_axis(end), 1e-4);
        EXPECT_NEAR(end.y, seeds[i].y, 1e-6);
        if (std::abs(from_axis(seeds[i])) > .02) {
            EXPECT_GT(from_axis(end) / from_axis(seeds[i]), 1);
        }
    }
    // Nearer the sides of the box, which let no heat through, lines cannot.
    const Angles angles = angles_at_the_slow_part(
        lines, [&](Vec3d p) { return normalized(Vec3d(3.2 * from_axis(p), 0, -1)); },
        [&](Vec3d p) { return std::abs(from_axis(p)) < .45; });
    EXPECT_GT(angles.count, 250u);
    EXPECT_LT(angles.worst, 15);
    EXPECT_LT(angles.mean, 7);
}

/// A slice of the basin, as thick as two heat cells, and lines of it that start `radii` voxels from
/// the edge of the hot half.
struct BasinSlice {
    std::vector<double> radii;
    Polylines lines;

    BasinSlice(double heat_cell, const cooling::Params& cooling)
    {
        const lava::Result lava = lava::run({},
                                            {.preset = lava::Preset::Basin,
                                             .size = Vec3d(10, 0.625, 10),
                                             .voxel = 0.04,
                                             .heat_cell = heat_cell,
                                             .noise_amplitude = 0.0},
                                            1, {});
        const auto defaults = lava::preset_defaults(lava::Preset::Basin);
        const cooling::Result heat = cooling::run(
            {lava.region_coarse, lava.heat_domain, defaults.heat_steps, defaults.plateau_share},
            cooling, {}, {});
        std::vector<Vec3d> seeds;
        for (double r = 12; r <= 50; r += 2) {
            radii.push_back(r);
            seeds.push_back({125 - r, 7.3, 250 * kTop});
        }
        lines = joints::trace({lava.region,
                               lava.body_sdf,
                               lava.slow_sdf,
                               heat.gradient,
                               lava.domain,
                               lava.heat_domain,
                               {},
                               {}},
                              {}, seeds, {});
    }

    Vec3d from_edge(Vec3d p) const { return {p.x - 125, 0, p.z - 250 * kTop}; }
};

TEST(Basin, LinesNearTheEdgeAreNestedArcsThatEndInTheSlowSlab)
{
    const Body body(lava::Preset::Basin);
    const std::vector<Vec3d> seeds = body.seeds();
    const Polylines lines = body.lines(seeds);
    std::vector<std::pair<double, double>> arcs;  // where they begin and end, from the edge
    for (std::size_t i = 0; i < lines.count(); ++i) {
        EXPECT_LT(seeds[i].x, 125);
        if (125 - seeds[i].x >= 50) continue;
        ASSERT_EQ(lines.stop[i], StopReason::LeftLava) << i;
        const Vec3d end = end_of(lines, i);
        EXPECT_GT(end.x, 125);
        EXPECT_NEAR(end.z, 250 * kTop, 0.01);
        arcs.emplace_back(125 - seeds[i].x, end.x - 125);
        // Down, then up, in a plane across the edge.
        int turns = 0;
        for (std::size_t k = 1; k < lines.size(i); ++k) {
            const Vec3d* p = lines.line(i) + k;
            EXPECT_NEAR(p->y, seeds[i].y, 1e-6);
            EXPECT_GT(p->x, (p - 1)->x - 0.05);
            if (k > 1) turns += (p->z > (p - 1)->z) != ((p - 1)->z > (p - 2)->z);
        }
        EXPECT_EQ(turns, 1) << i;
    }
    EXPECT_GT(arcs.size(), 140u);
    std::sort(arcs.begin(), arcs.end());
    for (std::size_t k = 1; k < arcs.size(); ++k)
        EXPECT_GE(arcs[k].second, arcs[k - 1].second - 0.02);
}

/// In a half-space whose surface is cold on one side of an edge and hot on the other, isotherms are
/// half-planes through the edge. Within .2 of the edge the box is that half-space to 1.5 voxels,
/// and the heat grid blurs the edge by half a cell of 7.8 voxels.
TEST(Basin, LinesAreCirclesAboutTheEdgeOnceTheHeatFlowsSteadily)
{
    for (const double heat_cell : {0.3125, 0.15625}) {
        const BasinSlice slice(
            heat_cell,
            {.steps = 200000, .stop = cooling::Stop::Steady, .steady_change = 1e-4 * heat_cell});
        const double cell = heat_cell / 0.04;
        double worst = 0;
        for (std::size_t i = 0; i < slice.radii.size(); ++i) {
            ASSERT_EQ(slice.lines.stop[i], StopReason::LeftLava);
            EXPECT_NEAR(slice.from_edge(end_of(slice.lines, i)).x, slice.radii[i], 0.1);
            for (std::size_t k = 0; k < slice.lines.size(i); ++k)
                worst = std::max(worst, std::abs(length(slice.from_edge(slice.lines.line(i)[k])) -
                                                 slice.radii[i]));
        }
        EXPECT_LT(worst, 0.5 * cell);
    }
}

/// While the hot body still cools the far ends spread; they do so as on a grid of half the cell.
TEST(Basin, ArcsOfThePresetAreThoseOfAFinerHeatGrid)
{
    const BasinSlice preset(0.3125, {}), finer(0.15625, {.steps = 4 * 3000});
    for (std::size_t i = 0; i < preset.radii.size(); ++i)
        EXPECT_LT(length(end_of(preset.lines, i) - end_of(finer.lines, i)), 1.5) << i;
}

TEST(CentreLines, EndAtTheSamePlacesWithAQuarterOfTheStep)
{
    for (const lava::Preset preset : {lava::Preset::Rosette, lava::Preset::Fan}) {
        const Body body(preset);
        const std::vector<Vec3d> seeds = body.seeds();
        const Polylines coarse = body.lines(seeds), fine = body.lines(seeds, 0.25);
        // A voxel and a half would do; Euler's method is within that, too.
        for (std::size_t i = 0; i < seeds.size(); ++i) {
            EXPECT_LE(length(end_of(coarse, i) - end_of(fine, i)), 0.05) << i;
            EXPECT_GT(fine.size(i), 3 * coarse.size(i));
        }
    }
}

TEST(Ball, OfAMeshHasItsRadiiAsCentreLines)
{
    const Vec3d centre(3, -2, 7);  // [m]
    constexpr double kRadius = 0.42 * 250;
    lava::Inputs inputs;
    inputs.mesh = shapes::ball(centre, kRadius * 0.04, 6);
    const Body body({.preset = lava::Preset::Mesh, .voxel = 0.04, .margin = 0.8}, inputs, 150);
    ASSERT_EQ(body.lava.domain.dims, Coord(250, 250, 250));
    ASSERT_EQ(body.lava.heat_domain.dims, Coord(32, 32, 32));
    const Vec3d middle = body.lava.domain.transform.voxels(centre);
    const std::vector<Vec3d> seeds = body.seeds();
    const Polylines lines = body.lines(seeds);
    ASSERT_EQ(lines.count(), 400u);
    for (std::size_t i = 0; i < lines.count(); ++i) {
        EXPECT_NEAR(length(seeds[i] - middle), kRadius, 0.1);
        const Vec3d axis = normalized(seeds[i] - middle), end = end_of(lines, i) - middle;
        EXPECT_LE(length(end - axis * dot(end, axis)), 0.5) << i;
        EXPECT_LT(length(end), 10);  // the hot centre, within little more than a heat cell
    }
}

/// Nearest point of one polyline, segment by segment.
Vec3d nearest_on(const Polylines& lines, std::size_t i, Vec3d x)
{
    Vec3d best = lines.line(i)[0];
    for (std::size_t k = 0; k + 1 < lines.size(i); ++k) {
        const Vec3d a = lines.line(i)[k], d = lines.line(i)[k + 1] - a;
        const double l2 = dot(d, d);
        const Vec3d p = a + d * (l2 > 0 ? std::clamp(dot(x - a, d) / l2, 0.0, 1.0) : 0.0);
        if (length(x - p) < length(x - best)) best = p;
    }
    return best;
}

TEST(Rosette, ColumnsAreStarShapedTowardsTheirLines)
{
    const Body body(lava::Preset::Rosette);
    const joints::Result joints = joints::run(body.joint_inputs(), {.arc = false}, 1, {});
    const PolylineIndex index(joints.lines);
    std::size_t voxels = 0, passed = 0, others = 0;
    for (std::uint64_t k = 0; voxels < 20000; ++k) {
        const Coord v(int(250 * uniform01(1, Stream{"x"}, k)),
                      int(250 * uniform01(1, Stream{"y"}, k)),
                      int(250 * uniform01(1, Stream{"z"}, k)));
        if (!joints.column.active(v)) continue;
        ++voxels;
        const std::int32_t own = joints.column.value(v);
        const Vec3d x = centre_of(v);
        const Vec3d way[2] = {x, nearest_on(joints.lines, static_cast<std::size_t>(own), x)};
        for (const weathering::WalkStep& step : weathering::walk(way, 2)) {
            if (!joints.column.active(step.voxel)) continue;
            ++passed;
            const std::int32_t there = joints.column.value(step.voxel);
            if (there == own) continue;
            // A wall lies between the way, all of which is nearest to the own line, and the voxel's
            // centre, which another line is nearer to.
            ++others;
            const double along = (step.arc + step.length / 2) / length(way[1] - way[0]);
            const Vec3d q = way[0] + (way[1] - way[0]) * along, centre = centre_of(step.voxel);
            EXPECT_LE(length(q - centre), std::sqrt(3.0) / 2);
            EXPECT_EQ(index.nearest(q).line, own);
            EXPECT_EQ(index.nearest(centre).line, there);
        }
    }
    EXPECT_LT(others, passed / 5);
}

/// Temperatures only scale the field: a + b T has the directions of T.
TEST(Families, BendTheSameAtTheTemperaturesOfBasalt)
{
    using lava::Preset;
    std::vector<std::pair<Preset, std::optional<int>>> cases{
        {Preset::Chevron, {}}, {Preset::Rosette, {}}, {Preset::Fan, {}}, {Preset::Basin, {}}};
    // The rim of the plateau, where the gradient fades, passes through many values.
    for (int steps = 8; steps < 60; steps += 4) cases.emplace_back(Preset::Chevron, steps);
    for (const auto& [preset, steps] : cases) {
        const lava::Result lava = lava::run({},
                                            {.preset = preset,
                                             .size = Vec3d(10),
                                             .voxel = 0.16,
                                             .heat_cell = 0.3125,
                                             .noise_amplitude = 0.0},
                                            1, {});
        const auto defaults = lava::preset_defaults(preset);
        const cooling::Inputs inputs{lava.region_coarse, lava.heat_domain, defaults.heat_steps,
                                     defaults.plateau_share};
        cooling::Params virtual_degrees{.steps = steps}, basalt{.steps = steps};
        apps::apply_params_file(SEKITEI_DATA "/materials/basalt.toml", describe_params(basalt));
        EXPECT_NEAR(basalt.lava_temperature, 1433.15, 1e-9);
        EXPECT_EQ(basalt.steps, steps);
        const cooling::Result a = cooling::run(inputs, virtual_degrees, {}, {}),
                              b = cooling::run(inputs, basalt, {}, {});
        EXPECT_LT(b.temperature.value({16, 16, 16}), 1500);
        std::size_t cells = 0;
        for (int x = 0; x < 32; ++x)
            for (int y = 0; y < 32; ++y)
                for (int z = 0; z < 32; ++z) {
                    const Coord c(x, y, z);
                    ASSERT_EQ(a.gradient.active(c), b.gradient.active(c));
                    ASSERT_LT(length(a.gradient.value(c) - b.gradient.value(c)), 1e-5);
                    cells += a.gradient.active(c);
                }
        EXPECT_GT(cells, steps ? 5000u : 20000u);
    }
}

}  // namespace
}  // namespace sekitei::presets
