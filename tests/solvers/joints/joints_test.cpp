#include "solvers/joints/joints.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <functional>

#include "core/error.h"
#include "core/random.h"
#include "grids/nearest_polyline.h"

namespace sekitei::joints {
namespace {

constexpr double kH = 0.037;             // [m]; not 1, so that a forgotten h shows
const Vec3d kOrigin{-12.5, 3.25, 40.0};  // [m]
constexpr Coord kDims{72, 48, 40};       // [voxels]
constexpr std::int32_t kLava = 0, kCold = 1, kSlow = 2;

template <class T, class F>
LeafGrid<T> grid_of(const TopologyPtr& topology, const Transform& transform, T background, F&& f)
{
    auto grid = LeafGrid<T>::uninitialised(topology, transform, background);
    for (std::size_t i = 0; i < grid.leaf_count(); ++i)
        for (int k = 0; k < kLeafSize; ++k) {
            const Coord c = leaf_coord(grid.origin(i), k);
            grid.values(i)[k] = f(c);
            if (!(grid.values(i)[k] == background)) grid.mask(i).set(k);
        }
    grid.compress();
    return grid;
}

/// A body from implicit functions [voxels, negative inside] and a direction field.
struct Body {
    Domain domain, heat_domain;
    IntGrid region;
    FloatGrid body_sdf, slow_sdf;
    VectorGrid gradient;

    using Function = std::function<double(Vec3d)>;

    Body(Coord dims, const Function& body, const Function& slow,
         const std::function<Vec3d(Vec3d)>& direction)
    {
        domain = {dims, {kOrigin, kH}};
        heat_domain = {Coord(dims.x / 8, dims.y / 8, dims.z / 8), {kOrigin, 8 * kH}};
        const Coord margin(8, 8, 8);
        const TopologyPtr wide = box_topology(Coord() - margin, dims + margin);
        const auto band = static_cast<float>(4 * kH);
        auto level_set = [&](const Function& f) {
            return grid_of<float>(wide, domain.transform, band, [&](Coord c) {
                return static_cast<float>(std::clamp(f(centre_of(c)), -4.0, 4.0) * kH);
            });
        };
        body_sdf = level_set(body);
        if (slow) slow_sdf = level_set(slow);
        region = grid_of<std::int32_t>(box_topology({0, 0, 0}, dims), domain.transform, kCold,
                                       [&](Coord c) {
                                           const Vec3d p = centre_of(c);
                                           if (!domain.contains(c) || body(p) >= 0) return kCold;
                                           return slow && slow(p) <= 0 ? kSlow : kLava;
                                       });
        gradient = grid_of<Vec3f>(box_topology({0, 0, 0}, heat_domain.dims), heat_domain.transform,
                                  Vec3f(), [&](Coord c) {
                                      return heat_domain.contains(c)
                                                 ? Vec3f(normalized(direction(centre_of(c) * 8.0)))
                                                 : Vec3f();
                                  });
    }

    Inputs inputs() const
    {
        return {region, body_sdf, slow_sdf, gradient, domain, heat_domain, {}, {}};
    }
};

constexpr double kTop = 34.6;  // height of the flat cooling surface [voxels]

/// Cold above z = kTop, gradient straight down.
Body slab()
{
    return Body(
        kDims, [](Vec3d p) { return p.z - kTop; }, nullptr, [](Vec3d) { return Vec3d(0, 0, -1); });
}

double area_of(const TriMesh& mesh)
{
    double area = 0;
    for (const auto& t : mesh.triangles) {
        const Vec3d a(mesh.vertices[t[0]]), b(mesh.vertices[t[1]]), c(mesh.vertices[t[2]]);
        area += 0.5 * length(cross(b - a, c - a));
    }
    return area;
}

// Lines

Params with(Integrator integrator)
{
    Params params;
    params.integrator = integrator;
    return params;
}

bool everywhere(Vec3d)
{
    return true;
}

// Counts, distances and radii in this group are those of an independent script.
TEST(CentreLines, FollowARadialFieldToItsCentreInUnitSteps)
{
    const Vec3d centre{30, 40, 50};
    const Path path = follow(
        {3.2, 11.7, 90.4}, {100, 100, 100}, [&](Vec3d p) { return normalized(centre - p); },
        everywhere, with(Integrator::Euler));
    EXPECT_EQ(path.points.size(), 57u);
    EXPECT_NEAR(length(path.points.back() - centre), 0.136352, 1e-6);
    EXPECT_EQ(path.stop, StopReason::Reversal);
}

TEST(CentreLines, KeepTheRadiusOfACircleWithRk4AndSpiralOutWithEuler)
{
    auto tangent = [](Vec3d p) { return normalized(Vec3d(50 - p.y, p.x - 50, 0)); };
    for (const Integrator integrator : {Integrator::Euler, Integrator::Rk4}) {
        const Path path =
            follow({70, 50, 20}, {100, 100, 40}, tangent, everywhere, with(integrator));
        ASSERT_GT(path.points.size(), 64u);
        const double r = std::hypot(path.points[63].x - 50, path.points[63].y - 50);
        EXPECT_NEAR(r, integrator == Integrator::Euler ? 21.517435 : 20.0,
                    integrator == Integrator::Euler ? 1e-6 : 1e-3);
    }
}

TEST(CentreLines, ReachAHotCentreThroughTheCoarseGradient)
{
    // T = -100 distance on 32^3, its Sobel gradient, followed on 128^3.
    constexpr int kN = 32;
    const Vec3d centre{16.3, 15.8, 16.1};
    auto temperature = [&](Coord c) {
        const Coord k = min(max(c, Coord(0, 0, 0)), Coord(kN - 1, kN - 1, kN - 1));
        return -100 * length(centre_of(k) - centre);
    };
    auto sobel = [&](Coord c) {
        Vec3d g;
        for (int i = -1; i <= 1; ++i)
            for (int j = -1; j <= 1; ++j)
                for (int k = -1; k <= 1; ++k) {
                    const double t = temperature(c + Coord(i, j, k));
                    g += Vec3d(i * (2 - std::abs(j)) * (2 - std::abs(k)),
                               j * (2 - std::abs(i)) * (2 - std::abs(k)),
                               k * (2 - std::abs(i)) * (2 - std::abs(j))) *
                         (t / 32);
                }
        return g;
    };
    Body body(
        {128, 128, 128}, [](Vec3d) { return -4.0; }, nullptr, [](Vec3d) { return Vec3d(0, 0, 1); });
    body.heat_domain = {{kN, kN, kN}, {kOrigin, 4 * kH}};
    body.gradient =
        grid_of<Vec3f>(box_topology({0, 0, 0}, {kN, kN, kN}), body.heat_domain.transform, Vec3f(),
                       [&](Coord c) { return Vec3f(normalized(sobel(c))); });
    const Polylines lines = trace(body.inputs(), with(Integrator::Euler),
                                  {{.5, 20, 30}, {100, .5, 90}, {64, 64, 127.5}}, {});
    const std::array<double, 3> expected{86, 78, 64};
    for (std::size_t i = 0; i < 3; ++i) {
        EXPECT_NEAR(double(lines.size(i)), expected[i], 2);
        const Vec3d end = lines.line(i)[lines.size(i) - 1];
        EXPECT_LT(length(end - centre * 4.0), 1.2);
    }
}

TEST(CentreLines, AlignCoarseAndFineCentresInWorldSpace)
{
    const Domain fine{{250, 250, 250}, {kOrigin, kH}},
        coarse{{32, 32, 32}, {kOrigin, kH * 250 / 32}};
    auto at = [&](int i) { return coarse_index(Vec3d(i + 0.5), fine, coarse).x; };
    EXPECT_EQ(at(0), 0);  // -0.436, held within the lattice
    EXPECT_NEAR(at(4), 0.076, 1e-9);
    EXPECT_NEAR(at(100), 12.364, 1e-9);
    EXPECT_NEAR(at(124), 15.436, 1e-9);
    EXPECT_EQ(at(249), 31);
    const Domain shifted{coarse.dims, {kOrigin - Vec3d(kH, 0, 0), coarse.transform.voxel}};
    EXPECT_NEAR(coarse_index(Vec3d(100.5), fine, shifted).x, 12.364 + 0.128, 1e-9);
}

TEST(CentreLines, StopForTheFirstReasonThatHolds)
{
    const Coord dims{40, 50, 60};
    auto down = [](Vec3d) { return Vec3d(0, 0, -1); };
    const Params params;
    const Path out = follow({10.25, 20, 30}, dims, down, everywhere, params);
    EXPECT_EQ(out.stop, StopReason::OutOfDomain);
    EXPECT_EQ(out.points.back(), Vec3d(10.25, 20, 0));

    const Path left = follow(
        {10.25, 20, 30}, dims, down, [](Vec3d p) { return p.z > 7.3; }, params);
    EXPECT_EQ(left.stop, StopReason::LeftLava);
    EXPECT_NEAR(left.points.back().z, 7.3, 1e-3);

    const Path flat = follow(
        {10.25, 20, 30}, dims, [](Vec3d p) { return Vec3d(0, 0, -std::max(0.0, (p.z - 10) / 20)); },
        everywhere, params);
    EXPECT_EQ(flat.stop, StopReason::Flat);
    EXPECT_NEAR(flat.points.back().z, 12, 1.0);

    const Path ridge = follow(
        {10.25, 20, 30.3}, dims, [](Vec3d p) { return Vec3d(0, 0, p.z > 15 ? -1 : 1); }, everywhere,
        params);
    EXPECT_EQ(ridge.stop, StopReason::Reversal);
    EXPECT_NEAR(ridge.points.back().z, 15.3, 1e-12);

    const Path circle = follow(
        {30, 25, 30}, dims, [](Vec3d p) { return normalized(Vec3d(25 - p.y, p.x - 20, 0)); },
        everywhere, params);
    EXPECT_EQ(circle.stop, StopReason::TooLong);
    EXPECT_EQ(circle.points.size(), 1501u);

    const Path none = follow(
        {10, 20, 30}, dims, down, [](Vec3d) { return false; }, params);
    EXPECT_EQ(none.stop, StopReason::NoStep);
    EXPECT_EQ(none.points.size(), 1u);
}

TEST(CentreLines, StartHalfAVoxelInsideAndEndOnTheSlowPart)
{
    // Slow ball below a flat cold top; directions towards its centre.
    const Vec3d ball{36, 24, 6};
    const Body body(
        kDims, [](Vec3d p) { return p.z - kTop; }, [&](Vec3d p) { return length(p - ball) - 8.5; },
        [&](Vec3d p) { return ball - p; });
    const std::vector<Vec3d> seeds{{36, 24, kTop}, {20, 30, kTop}, {60, 10, kTop}};
    const Polylines lines = trace(body.inputs(), {}, seeds, {});
    ASSERT_EQ(lines.count(), 3u);
    for (std::size_t i = 0; i < 3; ++i) {
        EXPECT_NEAR(length(lines.line(i)[0] - seeds[i]), 0.5, 1e-9);
        EXPECT_EQ(lines.stop[i], StopReason::LeftLava);
        EXPECT_NEAR(length(lines.line(i)[lines.size(i) - 1] - ball), 8.5, 0.05);
    }
}

TEST(CentreLines, EndAtTheSamePlaceWithAQuarterOfTheStep)
{
    // Field lines bend from a flat top towards a valley along y.
    auto valley = [](Vec3d p) { return p.z - (5 + 0.012 * (p.x - 36) * (p.x - 36)); };
    const Body body(
        kDims, [](Vec3d p) { return p.z - kTop; }, valley,
        [](Vec3d p) {
            const double t = (kTop - p.z) / kTop;
            return Vec3d(1.2 * t * (p.x - 36) / 36, 0, -1);
        });
    std::vector<Vec3d> seeds;
    for (int i = 0; i < 30; ++i) seeds.push_back({8 + 56 * i / 29.0, 20.5, kTop});
    Params fine;
    fine.step = 0.25;
    const Polylines a = trace(body.inputs(), {}, seeds, {}),
                    b = trace(body.inputs(), fine, seeds, {});
    for (std::size_t i = 0; i < seeds.size(); ++i)
        EXPECT_LT(length(a.line(i)[a.size(i) - 1] - b.line(i)[b.size(i) - 1]), 1.5);
}

TEST(CentreLines, SimplifyKeepsEveryPointWithinTheTolerance)
{
    std::vector<Vec3d> spiral;
    for (int k = 0; k < 200; ++k)
        spiral.push_back({30 + 20 * std::cos(k * 0.01), 30 + 20 * std::sin(k * 0.01), 0.06 * k});
    Polylines lines;
    lines.add(spiral, StopReason::Flat);
    lines.add({{1, 2, 3}}, StopReason::NoStep);
    lines.add({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}}, StopReason::OutOfDomain);
    const Polylines simple = simplify(lines, 0.02);
    EXPECT_EQ(simple.stop, lines.stop);
    EXPECT_LT(simple.size(0), 60u);
    EXPECT_EQ(simple.size(1), 1u);
    EXPECT_EQ(simple.size(2), 2u);
    Polylines only;
    only.add({simple.line(0), simple.line(0) + simple.size(0)}, StopReason::Flat);
    const PolylineIndex index(only);
    for (const Vec3d& p : spiral) EXPECT_LE(std::sqrt(index.nearest(p).distance2), 0.02 + 1e-12);
    EXPECT_EQ(simplify(lines, 0).size(0), 200u);
}

// The cooling surface

TEST(CoolingSurface, IsTheWholeFlatTopAndNoWallOfTheBox)
{
    const Body body = slab();
    const TriMesh surface = cooling_surface(body.inputs(), {});
    EXPECT_NEAR(area_of(surface), double(kDims.x) * kDims.y, 0.02);
    for (const Vec3f& v : surface.vertices) EXPECT_NEAR(v.z, kTop, 1e-3);
    for (const auto& t : surface.triangles) {
        const Vec3d a(surface.vertices[t[0]]), b(surface.vertices[t[1]]), c(surface.vertices[t[2]]);
        EXPECT_GT(cross(b - a, c - a).z, 0);  // seen from the cold side
    }
}

TEST(CoolingSurface, LeavesOutTheContactOfSlowPartAndCold)
{
    // A slow slab stands on the right half, up to the top of the box: only the left half cools.
    auto slow = [](Vec3d p) { return std::max(36.25 - p.x, kTop - p.z); };
    const Body body(
        kDims, [&](Vec3d p) { return std::min(p.z - kTop, slow(p)); }, slow,
        [](Vec3d) { return Vec3d(0, 0, -1); });
    const TriMesh surface = cooling_surface(body.inputs(), {});
    EXPECT_NEAR(area_of(surface), 36.25 * kDims.y, 1.5 * kDims.y);
    for (const Vec3f& v : surface.vertices) EXPECT_LT(v.x, 37.5);
}

TEST(CoolingSurface, IsEmptyWhenNothingIsCold)
{
    const Body body(
        kDims, [](Vec3d) { return -4.0; }, nullptr, [](Vec3d) { return Vec3d(0, 0, -1); });
    EXPECT_TRUE(cooling_surface(body.inputs(), {}).triangles.empty());
}

// Columns

/// Random crooked lines in a box.
Polylines random_lines(std::uint64_t seed, int count, int points, Vec3d box)
{
    constexpr Stream kPoint{"test.point"};
    Polylines lines;
    std::uint64_t k = 0;
    for (int i = 0; i < count; ++i) {
        std::vector<Vec3d> line;
        for (int j = 0; j < 1 + (i * 7) % points; ++j, ++k)
            line.push_back(on_line_lattice({uniform01(seed, kPoint, k, 0) * box.x,
                                            uniform01(seed, kPoint, k, 1) * box.y,
                                            uniform01(seed, kPoint, k, 2) * box.z}));
        lines.add(line, StopReason::Flat);
    }
    return lines;
}

/// A ball of lava around a slow core, in a box that does not begin at a leaf.
IntGrid ball_region()
{
    return grid_of<std::int32_t>(
        box_topology({-16, 0, 0}, {48, 40, 32}), {kOrigin, kH}, kCold, [](Coord c) {
            const double r = length(centre_of(c) - Vec3d(16.2, 20.7, 15.1));
            return r < 5 ? kSlow : r < 21.5 ? kLava : kCold;
        });
}

TEST(Partition, LabelsEveryLavaVoxelAsBruteForceDoesAndNoOther)
{
    const IntGrid region = ball_region();
    for (const std::uint64_t seed : {1, 2, 3}) {
        const Polylines lines =
            random_lines(seed, seed == 2 ? 7 : 60, seed == 1 ? 1 : 9, {36, 40, 30});
        const PolylineIndex index(lines);
        IntGrid column;
        FloatGrid arc;
        partition(region, lines, kH, column, &arc, {});
        std::uint64_t lava = 0;
        for (std::size_t i = 0; i < region.leaf_count(); ++i)
            for (int k = 0; k < kLeafSize; ++k) {
                const Coord c = leaf_coord(region.origin(i), k);
                const bool is_lava = region.mask(i).test(k) && region.at(i, k) == kLava;
                lava += is_lava;
                ASSERT_EQ(column.active(c), is_lava);
                ASSERT_EQ(arc.active(c), is_lava);
                if (!is_lava) {
                    ASSERT_EQ(column.value(c), -1);
                    continue;
                }
                const NearestPoint exact = index.nearest_brute_force(centre_of(c));
                ASSERT_EQ(column.value(c), exact.line);
                ASSERT_EQ(arc.value(c), static_cast<float>(exact.arc * kH));
            }
        EXPECT_EQ(column.active_count(), lava);
        IntGrid without_arc;
        partition(region, lines, kH, without_arc, nullptr, {});
        for (std::size_t i = 0; i < column.leaf_count(); ++i)
            for (int k = 0; k < kLeafSize; ++k) ASSERT_EQ(without_arc.at(i, k), column.at(i, k));
    }
}

TEST(Partition, StoresBlocksInsideOneColumnAsConstants)
{
    const IntGrid region = grid_of<std::int32_t>(box_topology({0, 0, 0}, {64, 64, 64}), {}, kCold,
                                                 [](Coord) { return kLava; });
    Polylines lines;
    lines.add({{10, 32, 0}, {10, 32, 64}}, StopReason::Flat);
    lines.add({{50.3, 32, 0}, {50.3, 32, 64}}, StopReason::Flat);
    IntGrid column;
    partition(region, lines, 1, column, nullptr, {});
    EXPECT_EQ(column.dense_leaf_count(), 64u);  // the wall at x = 30.15 cuts one layer of leaves
    EXPECT_EQ(column.active_count(), 64u * 64u * 64u);
}

TEST(Partition, ColumnsAreStarShapedTowardsTheirLine)
{
    const IntGrid region = ball_region();
    const Polylines lines = random_lines(9, 25, 4, {36, 40, 30});
    const PolylineIndex index(lines);
    IntGrid column;
    partition(region, lines, kH, column, nullptr, {});
    for (std::size_t i = 0; i < column.leaf_count(); ++i)
        for (int k = 0; k < kLeafSize; k += 7) {
            if (!column.mask(i).test(k)) continue;
            const Vec3d x = centre_of(leaf_coord(column.origin(i), k));
            const NearestPoint own = index.nearest(x);
            for (double t = 0; t < 1; t += 0.1) {
                const Vec3d q = x + (own.point - x) * t;
                const Coord c(int(std::floor(q.x)), int(std::floor(q.y)), int(std::floor(q.z)));
                if (!column.active(c) || column.value(c) == own.line) continue;
                // Then a wall passes within half a voxel diagonal of the voxel's centre.
                const double mine = length(centre_of(c) - own.point);
                const double nearest = std::sqrt(index.nearest(centre_of(c)).distance2);
                ASSERT_LT(mine - nearest, std::sqrt(3.0));
            }
        }
}

// The whole stage

template <class T>
bool same(const LeafGrid<T>& a, const LeafGrid<T>& b)
{
    if (a.leaf_count() != b.leaf_count()) return false;
    for (std::size_t i = 0; i < a.leaf_count(); ++i) {
        if (!(a.mask(i) == b.mask(i)) || a.is_constant(i) != b.is_constant(i)) return false;
        for (int k = 0; k < kLeafSize; ++k)
            if (const T x = a.at(i, k), y = b.at(i, k); std::memcmp(&x, &y, sizeof x) != 0)
                return false;
    }
    return true;
}

TEST(Joints, AreTheSameOnAnyNumberOfThreads)
{
    const Body body(
        kDims, [](Vec3d p) { return p.z - kTop - 2 * std::sin(p.x / 9); },
        [](Vec3d p) { return length(p - Vec3d(36, 24, 2)) - 9.3; },
        [](Vec3d p) { return Vec3d(36, 24, 2) - p + Vec3d(0, p.z - 5, 0); });
    Params params;
    params.count = 40;
    auto on_threads = [&](std::size_t n) {
        const ThreadLimit limit(n);
        return run(body.inputs(), params, 7, {});
    };
    const Result one = on_threads(1);
    for (const std::size_t n : {2, 7}) {
        const Result many = on_threads(n);
        EXPECT_EQ(one.seeds, many.seeds);
        EXPECT_EQ(one.lines.points, many.lines.points);
        EXPECT_EQ(one.lines.stop, many.lines.stop);
        EXPECT_TRUE(same(one.column, many.column));
        EXPECT_TRUE(same(one.arc, many.arc));
    }
    const Polylines read =
        to_polylines(to_points(one.lines, body.domain.transform), body.domain.transform);
    EXPECT_EQ(read.points, one.lines.points);
    EXPECT_NE(run(body.inputs(), params, 8, {}).seeds, one.seeds);
}

TEST(Joints, MakeStraightColumnsBelowAFlatTop)
{
    const Body body = slab();
    Params params;
    params.spacing = 10 * kH;
    const Result result = run(body.inputs(), params, 3, {});
    EXPECT_EQ(result.lines.count(), 35u);  // 72 * 48 / 100, rounded
    for (std::size_t i = 0; i < result.lines.count(); ++i) {
        EXPECT_EQ(result.lines.stop[i], StopReason::OutOfDomain);
        EXPECT_EQ(result.lines.size(i), 2u);
        EXPECT_NEAR(result.seeds[i].z, kOrigin.z + kTop * kH, 1e-5);
    }
    // Each vertical row of voxels belongs to one column; arc grows downwards from 0.5 voxel.
    const Coord c{30, 20, 20};
    EXPECT_EQ(result.column.value(c), result.column.value(c + Coord(0, 0, 10)));
    EXPECT_NEAR(result.arc.value(c), (kTop - 0.5 - 20.5) * kH, 1e-5);
    EXPECT_EQ(result.column.active_count(), std::uint64_t(72 * 48 * 35));
}

TEST(Joints, TakeTheCountFromThePresetOnlyWhenNothingElseIsGiven)
{
    const Body body = slab();
    Inputs inputs = body.inputs();
    EXPECT_EQ(run(inputs, {}, 1, {}).lines.count(), 22u);  // spacing 12.5 voxels
    inputs.default_count = 31;
    EXPECT_EQ(run(inputs, {}, 1, {}).lines.count(), 31u);
    Params params;
    params.spacing = 10 * kH;
    EXPECT_EQ(run(inputs, params, 1, {}).lines.count(), 35u);
    params.spacing.reset();
    params.count = 12;
    EXPECT_EQ(run(inputs, params, 1, {}).lines.count(), 12u);
    inputs.explicit_seeds = {body.domain.transform.world({20, 20, kTop}),
                             body.domain.transform.world({50, 30, kTop})};
    const Result given = run(inputs, params, 1, {});
    EXPECT_EQ(given.lines.count(), 2u);
    EXPECT_NEAR(length(given.lines.line(1)[0] - Vec3d(50, 30, kTop - 0.5)), 0, 1e-5);
}

TEST(Joints, AreUnchangedWhenTheWorldIsTenTimesLarger)
{
    const Body body = slab();
    Body large = body;
    for (Domain* d : {&large.domain, &large.heat_domain}) d->transform.voxel *= 10;
    large.region.set_transform(large.domain.transform);
    Params small_params, large_params;
    small_params.spacing = 9 * kH;
    large_params.spacing = 90 * kH;
    EXPECT_TRUE(same(run(body.inputs(), small_params, 5, {}).column,
                     run(large.inputs(), large_params, 5, {}).column));
}

template <class E, class F>
void expect_error(F&& f, const std::vector<std::string>& words)
{
    try {
        f();
        FAIL() << "no error";
    } catch (const E& error) {
        for (const std::string& w : words) EXPECT_THAT(error.what(), testing::HasSubstr(w));
    }
}

TEST(Joints, NameWhatDoesNotFit)
{
    const Body body = slab();
    auto with_params = [&](auto&& set) {
        Params params;
        set(params);
        return [&body, params] { run(body.inputs(), params, 1, {}); };
    };
    expect_error<InvalidParameter>(with_params([](Params& p) { p.seed_radius = -1; }),
                                   {"seed_radius = -1", "must be > 0"});
    expect_error<InvalidParameter>(with_params([](Params& p) { p.spacing = 100; }),
                                   {"spacing = 100 m", "2.17"});
    expect_error<InvalidParameter>(with_params([](Params& p) {
                                       p.count = 400;
                                       p.seed_radius = 5 * kH;
                                   }),
                                   {"of 400 seeds", "seed_radius = 0.185 m", "about 96"});
    expect_error<InvalidParameter>(with_params([](Params& p) {
                                       p.count = 40000000;
                                       p.seed_radius = 5 * kH;
                                   }),
                                   {"count = 40000000", "voxels wide", "at least 2"});
    expect_error<InvalidParameter>(with_params([](Params& p) { p.spacing = 1.5 * kH; }),
                                   {"spacing = 0.0555 m", "1.5 voxels wide", "spacing = 0.074"});
    expect_error<InvalidParameter>(with_params([](Params& p) {
                                       p.count = 400;
                                       p.spacing = 0.3;
                                   }),
                                   {"spacing = 0.3 m", "count = 400"});
}

TEST(Joints, SayThatIsothermalLavaHasNoColumns)
{
    Body body = slab();
    body.gradient = VectorGrid(body.gradient.topology(), body.gradient.transform(), Vec3f());
    expect_error<InvalidInput>([&] { run(body.inputs(), {}, 1, {}); },
                               {"no cooling surface: no columns possible", "zero"});
    const Body buried(
        kDims, [](Vec3d) { return -4.0; }, nullptr, [](Vec3d) { return Vec3d(0, 0, -1); });
    expect_error<InvalidInput>([&] { run(buried.inputs(), {}, 1, {}); },
                               {"no cooling surface: no columns possible"});
    Inputs outside = buried.inputs();
    outside.explicit_seeds = {{0, 0, 0}};
    expect_error<InvalidInput>([&] { run(outside, {}, 1, {}); }, {"seed 0", "outside the box"});
}

TEST(Joints, StopWhenAsked)
{
    const std::atomic<bool> cancel{true};
    const Progress progress([](const std::string&, double) {}, &cancel);
    EXPECT_THROW(run(slab().inputs(), {}, 1, progress), Cancelled);
    const TriMesh surface = cooling_surface(slab().inputs(), {});
    EXPECT_THROW(poisson_disk(surface, 100, 2, 1, progress), Cancelled);
    EXPECT_THROW(poisson_disk_plane(surface, 100, 2, 1, progress), Cancelled);
}

}  // namespace
}  // namespace sekitei::joints
