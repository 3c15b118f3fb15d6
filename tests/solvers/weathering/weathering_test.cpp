#include "solvers/weathering/weathering.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <set>

#include "core/error.h"
#include "core/parallel.h"
#include "grids/marching_tetrahedra.h"
#include "grids/nearest_polyline.h"
#include "grids/surface_attributes.h"
#include "solvers/weathering/pieces.h"
#include "tests/support/mesh_check.h"

namespace sekitei::weathering {
namespace {

using ::testing::DoubleNear;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pointwise;
using ::testing::ThrowsMessage;

constexpr double kVoxel = 0.25;  // [m]; not 1, so that a forgotten edge shows

/// A hand-made scene: regions by function, columns by brute force.
struct Rock {
    Domain domain;
    IntGrid region, column;
    FloatGrid body, slow;
    Polylines lines;

    /// @param body  [voxels], negative in lava and slow part
    /// @param slow  [voxels], negative in the slow part; null for none
    Rock(Coord dims, const std::vector<std::vector<Vec3d>>& polylines,
         const std::function<double(Vec3d)>& body_at, const std::function<double(Vec3d)>& slow_at)
        : domain{dims, {{3, -7, 11}, kVoxel}}
    {
        for (const auto& points : polylines) lines.add(points, StopReason::Flat);
        const PolylineIndex index(lines);
        const TopologyPtr topology = box_topology({0, 0, 0}, dims);
        region = IntGrid::uninitialised(topology, domain.transform, 1);
        column = IntGrid::uninitialised(topology, domain.transform, -1);
        body = FloatGrid::uninitialised(topology, domain.transform, 4 * kVoxel);
        slow = FloatGrid::uninitialised(slow_at ? topology : LeafTopology::build({}),
                                        domain.transform, 4 * kVoxel);
        for (std::size_t i = 0; i < topology->size(); ++i)
            for (int o = 0; o < kLeafSize; ++o) {
                const Coord c = leaf_coord(topology->origin(i), o);
                const Vec3d p = centre_of(c);
                const double b = body_at(p), s = slow_at ? slow_at(p) : 9;
                body.values(i)[o] = static_cast<float>(std::clamp(b, -4.0, 4.0) * kVoxel);
                if (slow_at)
                    slow.values(i)[o] = static_cast<float>(std::clamp(s, -4.0, 4.0) * kVoxel);
                const bool in = domain.contains(c) && b < 0;
                region.values(i)[o] = in ? (s < 0 ? 2 : 0) : 1;
                column.values(i)[o] = in && s >= 0 ? index.nearest_brute_force(p).line : -1;
                if (in) region.mask(i).set(o);
                if (in && s >= 0) column.mask(i).set(o);
            }
        region.compress();
        column.compress();
        body.compress();
        slow.compress();
    }

    Inputs inputs() const
    {
        return {.region = region,
                .column = column,
                .body_sdf = body,
                .slow_sdf = slow,
                .lines = lines,
                .domain = domain};
    }
    Result weathered(const Params& params, std::uint64_t seed = 5) const
    {
        return run(inputs(), params, seed, Progress());
    }
    /// The surface in voxel units.
    TriMesh mesh(const Result& result, double density = 1) const
    {
        TriMesh m = marching_tetrahedra(result.density, density / 2, Progress());
        for (Vec3f& v : m.vertices) v = Vec3f(domain.transform.voxels(Vec3d(v)));
        return m;
    }
};

double everywhere(Vec3d)
{
    return -9;
}

/// Two straight columns 12.5 voxels apart about a centre, the second one removed: the wall between
/// them should be the plane half way.
struct Wall {
    Vec3d centre{20.3, 19.6, 20.1}, normal = normalized(Vec3d(.48, .64, .6));

    Rock rock() const
    {
        const Vec3d d0(.7, -.5, .3);
        const Vec3d d = normalized(d0 - normal * dot(d0, normal));
        std::vector<std::vector<Vec3d>> lines;
        for (const double side : {-6.25, 6.25}) {
            const Vec3d foot = centre + normal * side;
            lines.push_back({foot - d * 60, foot + d * 60});
        }
        return Rock({40, 40, 40}, lines, everywhere, nullptr);
    }

    struct Error {
        double rms = 0, degrees = 0;
        std::size_t vertices = 0;
    };
    Error measure(AntiAliasing mode) const
    {
        const Rock r = rock();
        Params params;
        params.anti_aliasing = mode;
        params.remove_columns = {1};
        const TriMesh mesh = r.mesh(r.weathered(params));
        Error e;
        for (const Vec3f& v : mesh.vertices) {
            const Vec3d x = Vec3d(v) - centre;
            if (length(x) > 9) continue;
            e.rms += dot(x, normal) * dot(x, normal);
            ++e.vertices;
        }
        e.rms = std::sqrt(e.rms / static_cast<double>(e.vertices));
        double area = 0;  // the mean is over the surface
        for (const auto& t : mesh.triangles) {
            const Vec3d a(mesh.vertices[t[0]]), b(mesh.vertices[t[1]]), c(mesh.vertices[t[2]]);
            if (std::max({length(a - centre), length(b - centre), length(c - centre)}) > 9)
                continue;
            const Vec3d n = cross(b - a, c - a);
            const double cosine = std::clamp(dot(normalized(n), normal), -1.0, 1.0);
            e.degrees += std::acos(cosine) * 57.29577951 * length(n);
            area += length(n);
        }
        e.degrees /= area;
        return e;
    }
};

TEST(Ratios, AreTheClosedFormOfTheEquationAndSumToOne)
{
    const auto near = [](double x) { return DoubleNear(x, 5e-6); };
    EXPECT_THAT(literal_ratios({3, 3.4}), ElementsAre(near(.7), near(.3)));
    EXPECT_THAT(literal_ratios({3, 3.4, 4.5}),
                ElementsAre(near(.966667), near(.566667), near(-.533333)));
    EXPECT_THAT(literal_ratios({4, 6}), ElementsAre(near(1.5), near(-.5)));
    EXPECT_THAT(literal_ratios({3, 3.05, 3.1, 3.3}),
                ElementsAre(near(.3625), near(.3125), near(.2625), near(.0625)));
    EXPECT_THAT(literal_ratios({6.2, 6.2, 7.9}), ElementsAre(near(.9), near(.9), near(-.8)));
}

TEST(Ratios, ProjectedOntoTheSimplexIgnoreFarColumns)
{
    const auto near = [](double x) { return DoubleNear(x, 1e-12); };
    EXPECT_THAT(simplex_ratios({3, 3.4}), ElementsAre(near(.7), near(.3)));
    EXPECT_THAT(simplex_ratios({3, 3.4, 4.5}), ElementsAre(near(.7), near(.3), 0));
    EXPECT_THAT(simplex_ratios({4, 6}), ElementsAre(1, 0));
    EXPECT_THAT(simplex_ratios({3, 3.05, 3.1, 3.3}),
                ElementsAre(near(.3625), near(.3125), near(.2625), near(.0625)));
    EXPECT_THAT(simplex_ratios({6.2, 6.2, 7.9}), ElementsAre(near(.5), near(.5), 0));
    EXPECT_THAT(simplex_ratios({7.9, 6.2, 6.2}), ElementsAre(0, near(.5), near(.5)));
}

TEST(Walk, PassesTheVoxelsInOrder)
{
    const Vec3d line[] = {{.5, .5, .5}, {10.2, 4.7, 7.9}};
    const std::vector<WalkStep> steps = walk(line, 2);
    ASSERT_EQ(steps.size(), 22u);
    EXPECT_EQ(steps[0].voxel, Coord(0, 0, 0));
    EXPECT_EQ(steps[1].voxel, Coord(1, 0, 0));
    EXPECT_EQ(steps[20].voxel, Coord(9, 4, 7));
    EXPECT_EQ(steps[21].voxel, Coord(10, 4, 7));
}

TEST(Walk, LengthsAddUpAlongABentLineInAnyDirection)
{
    const std::vector<Vec3d> line{{5.13, 4.21, 0.5}, {-3.2, 6.05, 11.7}, {2, 6.05, 3}, {2, 1, 3}};
    double whole = 0;
    for (std::size_t k = 1; k < line.size(); ++k) whole += length(line[k] - line[k - 1]);
    const std::vector<WalkStep> steps = walk(line.data(), line.size());
    double sum = 0;
    for (std::size_t k = 0; k < steps.size(); ++k) {
        EXPECT_NEAR(steps[k].arc, sum, 1e-9);
        EXPECT_LE(steps[k].length, std::sqrt(3.0) * 2);  // a bend may lie in the voxel
        if (k > 0) {
            const Coord d = steps[k].voxel - steps[k - 1].voxel;
            EXPECT_LE(std::max({std::abs(d.x), std::abs(d.y), std::abs(d.z)}), 1);
            EXPECT_FALSE(d == Coord(0, 0, 0));
        }
        sum += steps[k].length;
    }
    EXPECT_NEAR(sum, whole, 1e-9);
}

TEST(Walk, OfAPointIsItsVoxel)
{
    const Vec3d point(2.5, -0.5, 7);
    ASSERT_EQ(walk(&point, 1).size(), 1u);
    EXPECT_EQ(walk(&point, 1)[0].voxel, Coord(2, -1, 7));
    EXPECT_TRUE(walk(&point, 0).empty());
}

TEST(Cuts, StartAPieceWhereTheDrawIsBelowTheProneness)
{
    const std::vector<double> w{.1, .8, .3, .55, .9, .7, .2, .05},
        u{.01, .4, .6, .2, .95, .1, .5, .2};
    const std::vector<int> component = cut_components(w, u);
    EXPECT_THAT(component, ElementsAre(0, 1, 1, 2, 2, 3, 3, 3));
    EXPECT_THAT(piece_means(w, component),
                Pointwise(DoubleNear(1e-6), std::vector<double>{.1, .55, .725, .316667}));
}

TEST(Terrain, CutsALineWhereItMeetsThePlane)
{
    const Vec3d line[] = {{4, 5, 0}, {10, 9, 30}};
    const auto crossings =
        terrain_crossings(line, 2, [](Vec3d p) { return p.z - (11 + .3 * p.x - .2 * p.y); });
    ASSERT_EQ(crossings.size(), 1u);
    EXPECT_NEAR(crossings[0].point.x, 6.317241, 1e-6);
    EXPECT_NEAR(crossings[0].point.y, 6.544828, 1e-6);
    EXPECT_NEAR(crossings[0].point.z, 11.586207, 1e-6);
    EXPECT_NEAR(crossings[0].arc, length(crossings[0].point - line[0]), 1e-9);
    EXPECT_EQ(crossings[0].direction, 1);
}

TEST(Density, OfPlaneModeReproducesAnObliqueWallExactly)
{
    const Wall::Error e = Wall().measure(AntiAliasing::Plane);
    EXPECT_GT(e.vertices, 300u);
    EXPECT_LT(e.rms, 1e-4);
    EXPECT_LT(e.degrees, 0.2);
}

// Errors of the paper's shares, from an independent implementation.
TEST(Density, OfLiteralAndSimplexModeIsAsRoughAsThePapersEquations)
{
    for (const AntiAliasing mode : {AntiAliasing::Literal, AntiAliasing::Simplex}) {
        const Wall::Error e = Wall().measure(mode);
        EXPECT_NEAR(e.rms, .1215, .004);
        EXPECT_NEAR(e.degrees, 29.0, .5);
    }
}

TEST(Density, ClosesTheBoxWithExactlyPlaneCaps)
{
    const Coord n(19, 24, 13);  // 24: a wall on a leaf's side
    const Rock rock(n, {{{9, 12, 1}, {9, 12, 12}}}, everywhere, nullptr);
    const Result result = rock.weathered({});
    const TriMesh mesh = rock.mesh(result);
    const auto facts = testing_support::look_at(mesh);
    EXPECT_TRUE(facts.each_edge_twice);
    EXPECT_EQ(facts.euler, 2);
    // The lattice bevels every other edge of the box: a triangle with legs of half a voxel.
    EXPECT_NEAR(facts.volume, n.x * n.y * n.z - 0.5 * 0.125 * 4 * (n.x + n.y + n.z), 1);
    for (const Vec3f& v : mesh.vertices)
        EXPECT_NEAR(std::min({v.x, v.y, v.z, float(n.x) - v.x, float(n.y) - v.y, float(n.z) - v.z}),
                    0, 1e-3);
    EXPECT_EQ(result.surface.value({0, 11, 5}), static_cast<int>(Surface::DomainCap));
    EXPECT_EQ(result.surface.value({-1, 11, 5}), static_cast<int>(Surface::DomainCap));
    EXPECT_EQ(result.surface.value({5, 11, 5}), -1);
    EXPECT_EQ(result.lava_voxels, n.x * n.y * n.z);
}

TEST(Density, PutsTheCoolingContactOnTheBodysSurface)
{
    const Vec3d centre(15.3, 14.8, 16.1);
    auto ball = [&](Vec3d p) { return length(p - centre) - 11.4; };
    const Rock rock({31, 30, 33}, {{centre, centre + Vec3d(1, 0, 0)}}, ball, nullptr);
    for (const double density : {1.0, 2.7}) {
        Params params;
        params.density = density;
        const Result result = rock.weathered(params);
        double worst = 0;
        for (const Vec3f& v : rock.mesh(result, density).vertices)
            worst = std::max(worst, std::abs(ball(Vec3d(v))));
        EXPECT_LT(worst, 0.05);
        EXPECT_EQ(result.surface.value({15, 14, 27}), static_cast<int>(Surface::CoolingContact));
        EXPECT_FLOAT_EQ(result.density.value({15, 14, 16}), static_cast<float>(density));
    }
}

/// Columns on a jittered lattice through a box whose top is cold and whose bottom is slow.
Rock layered(Coord n, double spacing = 5.5, double lean = 0.1)
{
    std::vector<std::vector<Vec3d>> lines;
    const double top = n.z - 3.3, bottom = 4.6;
    std::uint64_t k = 0;
    for (double x = spacing / 2; x < n.x; x += spacing)
        for (double y = spacing / 2; y < n.y; y += spacing, k += 2) {
            const Vec3d a(x + uniform01(1, Stream("x"), k), y + uniform01(1, Stream("x"), k + 1),
                          top - 0.5);
            const Vec3d middle = a + Vec3d(lean * 3, -lean * 5, -(top - bottom) / 2);
            lines.push_back({a, middle, middle + Vec3d(lean * 7, lean * 2, bottom - middle.z)});
        }
    return Rock(
        n, lines, [=](Vec3d p) { return p.z - top; }, [=](Vec3d p) { return p.z - bottom; });
}

std::uint64_t same(const Result& a, const Result& b)
{
    std::uint64_t differ = a.component.leaf_count() != b.component.leaf_count() ||
                           a.density.leaf_count() != b.density.leaf_count() ||
                           a.weathering.leaf_count() != b.weathering.leaf_count();
    auto compare = [&](const auto& x, const auto& y) {
        for (std::size_t i = 0; i < x.leaf_count(); ++i) {
            differ += !(x.mask(i) == y.mask(i)) || x.is_constant(i) != y.is_constant(i);
            for (int o = 0; o < kLeafSize; ++o) differ += x.at(i, o) != y.at(i, o);
        }
    };
    compare(a.component, b.component);
    compare(a.density, b.density);
    compare(a.surface, b.surface);
    compare(a.weathering, b.weathering);
    return differ;
}

TEST(Weathering, IsBitIdenticalForAnyNumberOfThreads)
{
    const Rock rock = layered({37, 42, 51});
    for (const Cut cut : {Cut::Perpendicular, Cut::Horizontal}) {
        Params params;
        params.cut = cut;
        auto on_threads = [&](std::size_t n) {
            const ThreadLimit limit(n);
            return rock.weathered(params);
        };
        const Result one = on_threads(1);
        EXPECT_GT(one.removed_pieces, 0u);
        EXPECT_LT(one.removed_pieces, one.pieces);
        EXPECT_EQ(same(one, on_threads(2)), 0u);
        EXPECT_EQ(same(one, on_threads(7)), 0u);
    }
}

TEST(Weathering, GivesEachLavaVoxelToOnePieceOfItsOwnColumn)
{
    const Rock rock = layered({37, 42, 51});
    for (const Cut cut : {Cut::None, Cut::Perpendicular, Cut::Horizontal}) {
        Params params;
        params.cut = cut;
        const Result result = rock.weathered(params);
        double voxels = 0;
        std::map<int, std::set<int>> columns_of;
        for (int x = 0; x < 37; ++x)
            for (int y = 0; y < 42; ++y)
                for (int z = 0; z < 51; ++z) {
                    const Coord c(x, y, z);
                    const int piece = result.component.value(c);
                    EXPECT_EQ(piece >= 0, rock.region.value(c) == 0);
                    EXPECT_EQ(result.component.active(c), piece >= 0);
                    if (piece < 0) continue;
                    ++voxels;
                    EXPECT_LT(piece, static_cast<int>(result.pieces));
                    columns_of[piece].insert(rock.column.value(c));
                }
        EXPECT_EQ(voxels, result.lava_voxels);
        for (const auto& [piece, columns] : columns_of) EXPECT_EQ(columns.size(), 1u) << piece;
    }
}

TEST(Weathering, CutsAsOftenAsTheProneness)
{
    // A line of m voxels with constant W falls into 1 + (m - 1) W pieces on average.
    const Rock rock = layered({64, 64, 51}, 4, 0);
    const FloatGrid w(LeafTopology::build({}), rock.domain.transform, 0.3f);
    Inputs inputs = rock.inputs();
    inputs.weathering = &w;
    Params params;
    params.cut = Cut::Perpendicular;
    auto pieces_per_line = [&] {
        return static_cast<double>(run(inputs, params, 9, Progress()).pieces) /
               static_cast<double>(rock.lines.count());
    };
    double voxels = 0;
    for (std::size_t i = 0; i < rock.lines.count(); ++i)
        voxels += static_cast<double>(walk(rock.lines.line(i), rock.lines.size(i)).size());
    voxels /= static_cast<double>(rock.lines.count());
    const double deviation = std::sqrt(voxels * .21 / static_cast<double>(rock.lines.count()));
    EXPECT_NEAR(pieces_per_line(), 1 + (voxels - 1) * .3, 4 * deviation);
    // On the scale of a reference length the chance depends on length, not on voxels.
    params.cut_ref_length = 3 * kVoxel;
    const double p = 1 - std::pow(.7, 1 / 3.);
    EXPECT_NEAR(pieces_per_line(), 1 + (voxels - 1) * p, 5 * deviation);
}

/// Rock whose W is 1 above a height and 0 below.
struct Capped {
    Rock rock = layered({30, 30, 41}, 30, 0.8);  // one oblique, bent column
    FloatGrid w;
    double height = 14;

    Capped() : w(FloatGrid::uninitialised(rock.region.topology(), rock.domain.transform, 0.0f))
    {
        for (std::size_t i = 0; i < w.leaf_count(); ++i)
            for (int o = 0; o < kLeafSize; ++o)
                w.values(i)[o] = leaf_coord(w.origin(i), o).z >= height ? 1.0f : 0.0f;
    }
    Result result() const
    {
        Inputs inputs = rock.inputs();
        inputs.weathering = &w;
        Params params;
        params.cut = Cut::Perpendicular;
        return run(inputs, params, 3, Progress());
    }
};

TEST(Weathering, LeavesAFlatFacePerpendicularToTheLine)
{
    const Capped capped;
    const Result result = capped.result();
    const Vec3d* line = capped.rock.lines.line(0);
    // The line runs down; its last voxel at or above the height is the last that is cut off.
    const auto steps = walk(line, 3);
    double arc = 0;
    for (const WalkStep& s : steps)
        if (s.voxel.z >= capped.height) arc = s.arc;
    const Vec3d along = normalized(line[2] - line[1]);
    const double bend = length(line[1] - line[0]);
    ASSERT_GT(arc, bend);
    const Vec3d foot = line[1] + along * (arc - bend);
    double worst = 0;
    std::size_t seen = 0;
    for (const Vec3f& v : capped.rock.mesh(result).vertices) {
        if (length(Vec3d(v) - foot) > 5) continue;
        worst = std::max(worst, std::abs(dot(Vec3d(v) - foot, along)));
        ++seen;
    }
    EXPECT_GT(seen, 100u);
    EXPECT_LT(worst, 1e-3);
    const Vec3d below = foot + along * 0.4;
    EXPECT_EQ(result.surface.value(Coord(int(below.x), int(below.y), int(below.z))),
              static_cast<int>(Surface::CutFace));
}

TEST(Weathering, LevelCutsMakeOneFlatStepPerColumn)
{
    const Rock rock = layered({40, 40, 60}, 9);
    Params params;
    params.cut = Cut::Horizontal;
    params.terrain_base = .3;
    params.terrain_slope_x = .4;
    params.terrain_amplitude = 0;
    const Result result = rock.weathered(params);
    std::map<int, double> height;
    for (std::size_t i = 0; i < rock.lines.count(); ++i) {
        const auto crossings =
            terrain_crossings(rock.lines.line(i), rock.lines.size(i),
                              [](Vec3d p) { return p.z - (.3 + .4 * p.x / 40) * 60; });
        ASSERT_EQ(crossings.size(), 1u);
        EXPECT_EQ(crossings[0].direction, -1);
        height[static_cast<int>(i)] = crossings[0].point.z;
    }
    for (int x = 0; x < 40; ++x)
        for (int y = 0; y < 40; ++y)
            for (int z = 0; z < 60; ++z) {
                const Coord c(x, y, z);
                const int column = rock.column.value(c);
                if (column < 0) continue;
                EXPECT_EQ(result.density.value(c) >= .5f, z + .5 < height[column]);
            }
    // Away from walls the top of the first column lies exactly at its height.
    const Vec3d start = rock.lines.line(0)[0];
    std::size_t seen = 0;
    for (const Vec3f& v : rock.mesh(result).vertices) {
        if (std::abs(v.z - height[0]) > 1 || std::hypot(v.x - start.x, v.y - start.y) > 3) continue;
        EXPECT_NEAR(v.z, height[0], 1e-4);
        ++seen;
    }
    EXPECT_GT(seen, 20u);
    EXPECT_EQ(result.surface.value(Coord(int(start.x), int(start.y), int(height[0]))),
              static_cast<int>(Surface::TerrainCut));
}

TEST(Weathering, KeepsOrDropsTheSlowPartAsAsked)
{
    const Rock rock = layered({24, 27, 30}, 8);
    Params params;
    const Result filled = rock.weathered(params);
    params.slow_fill = SlowFill::Empty;
    const Result hollow = rock.weathered(params);
    const auto whole = testing_support::look_at(rock.mesh(filled));
    const auto upper = testing_support::look_at(rock.mesh(hollow));
    EXPECT_NEAR(whole.volume, 24 * 27 * 26.7, 0.004 * whole.volume);  // rounded edges
    EXPECT_NEAR(upper.volume, 24 * 27 * (26.7 - 4.6), 0.004 * upper.volume);
    EXPECT_EQ(hollow.surface.value({12, 12, 4}), static_cast<int>(Surface::SlowContact));
    EXPECT_EQ(filled.surface.value({12, 12, 4}), -1);
    EXPECT_EQ(filled.surface.value({12, 12, 26}), static_cast<int>(Surface::CoolingContact));
}

TEST(Weathering, BaresTheSlowRockUnderRemovedColumns)
{
    const Rock rock = layered({24, 27, 30}, 8);
    Params params;
    params.remove_box = {0, 0, 0, 1, 1, 1};
    const Result result = rock.weathered(params);
    EXPECT_EQ(result.removed_voxels, result.lava_voxels);
    const TriMesh mesh = rock.mesh(result);
    EXPECT_NEAR(testing_support::look_at(mesh).volume, 24 * 27 * 4.6, 0.01 * 24 * 27 * 4.6);
    for (const Vec3f& v : mesh.vertices)
        if (v.x > 2 && v.y > 2 && v.x < 22 && v.y < 25 && v.z > 1) {
            EXPECT_NEAR(v.z, 4.6, 1e-4);
        }
    EXPECT_EQ(result.surface.value({12, 12, 4}), static_cast<int>(Surface::SlowContact));
}

TEST(Weathering, RemovesTheColumnsThatAreNamed)
{
    const Rock rock = layered({24, 27, 30}, 8);
    Params params;
    params.remove_columns = {2};
    params.remove_box = {.6, .6, 0, 1, 1, 1, 0, 0, 0, .3, .25, 1};
    const Result result = rock.weathered(params);
    std::set<int> gone{2};
    for (std::size_t i = 0; i < rock.lines.count(); ++i)
        if ((rock.lines.line(i)[0].x > .6 * 24 && rock.lines.line(i)[0].y > .6 * 27) ||
            (rock.lines.line(i)[0].x < .3 * 24 && rock.lines.line(i)[0].y < .25 * 27))
            gone.insert(static_cast<int>(i));
    EXPECT_GT(gone.size(), 1u);
    EXPECT_EQ(result.removed_pieces, gone.size());
    for (int x = 0; x < 24; ++x)
        for (int y = 0; y < 27; ++y)
            for (int z = 6; z < 25; ++z) {
                const int column = rock.column.value({x, y, z});
                EXPECT_EQ(result.density.value({x, y, z}) < .5f, gone.contains(column));
                EXPECT_GE(result.component.value({x, y, z}), 0);  // ids stay
            }
}

TEST(Falling, TakesWeakPiecesThatTouchAirThroughOthersOfTheirKind)
{
    // 0-1-2 in a row, 2 in the air; 3-4 hidden.
    Falling falling(6);
    falling.touch(0, 1);
    falling.touch(3, 4);
    falling.expose(2);
    falling.touch(2, 1);
    for (const std::uint32_t piece : {0u, 1u, 2u}) EXPECT_TRUE(falling.falls(piece));
    for (const std::uint32_t piece : {3u, 4u, 5u}) EXPECT_FALSE(falling.falls(piece));
}

/// Compares what has fallen with the definition: remove weak pieces with a face on air until
/// nothing changes.
/// @param wall  of the box, open to the air: 2 * axis + (1 for the upper side), or -1
void expect_the_fixed_point(const Rock& rock, Params params, int wall)
{
    if (wall >= 0) {
        Vec3d outwards(0.1, -0.1, 0.1);  // not quite along the axis
        outwards[wall / 2] = wall % 2 ? 0.8 : -0.8;
        params.open_face = outwards;
    }
    const Result result = rock.weathered(params);
    params.collapse = Collapse::All;
    const Result weak = rock.weathered(params);
    EXPECT_GT(weak.removed_pieces, result.removed_pieces);

    auto stands = [&](const Result& r, Coord c) {  // by the side of the ramp
        return r.density.value(c) >= .5f;
    };
    std::set<int> is_weak, gone;
    std::set<std::pair<int, int>> faces;
    const Coord n = rock.domain.dims;
    auto open = [&](Coord c) {
        if (wall < 0) return false;
        return wall % 2 ? c[wall / 2] >= n[wall / 2] : c[wall / 2] < 0;
    };
    for (int x = 0; x < n.x; ++x)
        for (int y = 0; y < n.y; ++y)
            for (int z = 0; z < n.z; ++z) {
                const Coord c(x, y, z);
                const int piece = result.component.value(c);
                if (piece < 0) continue;
                if (!stands(weak, c)) is_weak.insert(piece);
                for (int axis = 0; axis < 3; ++axis)
                    for (int side = -1; side <= 1; side += 2) {
                        Coord d = c;
                        d[axis] += side;
                        const int other = result.component.value(d);
                        const bool air =
                            rock.domain.contains(d) ? rock.region.value(d) == 1 : open(d);
                        if (air) faces.insert({piece, -1});
                        if (other >= 0 && other != piece) faces.insert({piece, other});
                    }
            }
    for (bool changed = true; changed;) {
        changed = false;
        for (const auto& [piece, other] : faces)
            if (is_weak.contains(piece) && !gone.contains(piece) &&
                (other == -1 || gone.contains(other))) {
                gone.insert(piece);
                changed = true;
            }
    }
    std::size_t removed = 0;
    for (int x = 0; x < n.x; ++x)
        for (int y = 0; y < n.y; ++y)
            for (int z = 0; z < n.z; ++z) {
                const int piece = result.component.value({x, y, z});
                if (piece < 0) continue;
                const bool fell = gone.contains(piece);
                removed += fell;
                ASSERT_EQ(stands(result, {x, y, z}), !fell);
            }
    EXPECT_GT(removed, 0u);
    EXPECT_EQ(static_cast<double>(removed), result.removed_voxels);
}

Params prone()
{
    Params params;
    params.cut = Cut::Perpendicular;
    params.noise_weight = 0.9;
    params.noise_wavelength = 9;
    return params;
}

TEST(Collapse, ToAFixedPointIsWhatRepeatedInspectionFinds)
{
    for (const int wall : {-1, 2}) expect_the_fixed_point(layered({37, 42, 51}), prone(), wall);
}

TEST(Collapse, StartsAtWhicheverWallIsOpen)
{
    // Lava from wall to wall: nothing else is air. One side ends with a leaf, the others inside
    // one.
    const Coord n(40, 27, 34);
    std::vector<std::vector<Vec3d>> lines;
    for (double x = 3; x < n.x; x += 6)
        for (double y = 2; y < n.y; y += 5)
            lines.push_back({{x, y, 34}, {x + 1, y + 2, 17}, {x + 2, y + 1, 0}});
    const Rock rock(n, lines, everywhere, nullptr);
    for (int wall = 0; wall < 6; ++wall) {
        SCOPED_TRACE("wall " + std::to_string(wall));
        expect_the_fixed_point(rock, prone(), wall);
    }
}

TEST(Weathering, MeshesOfAllModesAreClosed)
{
    const Rock rock = layered({37, 42, 51});
    for (const Cut cut : {Cut::Perpendicular, Cut::Horizontal})
        for (const AntiAliasing mode :
             {AntiAliasing::Plane, AntiAliasing::Simplex, AntiAliasing::Literal}) {
            Params params;
            params.cut = cut;
            params.anti_aliasing = mode;
            const auto facts = testing_support::look_at(rock.mesh(rock.weathered(params)));
            EXPECT_TRUE(facts.each_edge_twice);
            EXPECT_TRUE(facts.one_fan);
            EXPECT_GT(facts.volume, 0);
        }
}

TEST(Weathering, ProneFollowsTheFormulaInTheScenesRamps)
{
    const Rock rock = layered({40, 50, 60}, 7);
    Params params;
    params.cut = Cut::Perpendicular;
    params.noise_weight = 0;
    params.ramp = Ramp::Cliff;
    params.open_face = Vec3d(0, -1, 0);
    params.depth = 6 * kVoxel;
    const Result result = rock.weathered(params);
    std::size_t seen = 0;
    for (std::size_t i = 0; i < result.weathering.leaf_count(); ++i)
        result.weathering.mask(i).for_each([&](int o) {
            const Vec3d p = centre_of(leaf_coord(result.weathering.origin(i), o));
            const double w = .6 * (1 - p.x / 40) * (1 - p.z / 60) + .3 * std::exp(-p.y / 6);
            EXPECT_NEAR(result.weathering.at(i, o), w, 1e-6);
            ++seen;
        });
    EXPECT_GT(seen, 1000u);

    // Without an open face the depth counts from the cold contact, also beyond the narrow band.
    params.open_face.reset();
    params.ramp = Ramp::Tower;
    const Result deep = rock.weathered(params);
    for (std::size_t i = 0; i < deep.weathering.leaf_count(); ++i)
        deep.weathering.mask(i).for_each([&](int o) {
            const Vec3d p = centre_of(leaf_coord(deep.weathering.origin(i), o));
            const double r = std::hypot(p.x / 40 - .5, p.y / 50 - .5);
            const double w = .6 * std::clamp((r - .25) / .1, 0., 1.) +
                             .3 * std::exp(-std::max(0., 56.7 - p.z) / 6);
            EXPECT_NEAR(deep.weathering.at(i, o), std::min(1., w), 4e-3);
        });
}

TEST(Weathering, ReadsATerrainLevelSet)
{
    const Rock rock = layered({24, 27, 40}, 8);
    auto sdf = FloatGrid::uninitialised(rock.region.topology(), rock.domain.transform, 1.0f);
    for (std::size_t i = 0; i < sdf.leaf_count(); ++i)
        for (int o = 0; o < kLeafSize; ++o)
            sdf.values(i)[o] = static_cast<float>(
                std::clamp(leaf_coord(sdf.origin(i), o).z + .5 - 21.3, -4., 4.) * kVoxel);
    Inputs inputs = rock.inputs();
    inputs.terrain = &sdf;
    Params params;
    params.cut = Cut::Horizontal;
    const Result result = run(inputs, params, 1, Progress());
    const TriMesh mesh = rock.mesh(result);
    EXPECT_NEAR(testing_support::look_at(mesh).volume, 24 * 27 * 21.3, 0.005 * 24 * 27 * 21.3);
    for (const Vec3f& v : mesh.vertices)
        if (v.x > 2 && v.y > 2 && v.x < 22 && v.y < 25 && v.z > 1) {
            EXPECT_NEAR(v.z, 21.3, 1e-4);
        }
}

TEST(Weathering, NamesWhatIsWrong)
{
    const Rock rock = layered({20, 20, 20}, 10);
    auto expect = [&](const Params& params, const char* text) {
        EXPECT_THAT([&] { rock.weathered(params); }, ThrowsMessage<InvalidInput>(HasSubstr(text)));
    };
    Params params;
    params.holding_limit = 2;
    expect(params, "holding_limit");
    params = {};
    params.remove_columns = {4};
    expect(params, "remove_columns = 4, must be below the number of columns, 4");
    params.remove_columns = {1.5};
    expect(params, "remove_columns = 1.5, must be whole numbers");
    params = {};
    params.remove_box = {0, 0, 0, 1, 1};
    expect(params, "remove_box has 5 numbers");
    params = {};
    params.open_face = Vec3d(0, 0, 0);
    expect(params, "open_face");

    Rock broken = rock;
    broken.column = IntGrid(rock.region.topology(), rock.domain.transform, -1);
    for (std::size_t i = 0; i < broken.column.leaf_count(); ++i) broken.column.set_constant(i, 9);
    EXPECT_THAT([&] { broken.weathered({}); },
                ThrowsMessage<InvalidInput>(HasSubstr("column = 9 at lava voxel (0, 0, 5)")));
    broken = rock;
    broken.column.set_transform({{0, 0, 0}, kVoxel});
    EXPECT_THAT([&] { broken.weathered({}); }, ThrowsMessage<InvalidInput>(HasSubstr("`column`")));
}

TEST(SurfaceAttributes, TellColumnPieceAndKindOfEachFace)
{
    const Rock rock = layered({24, 27, 30}, 8);
    Params params;
    params.remove_columns = {4};
    const Result result = rock.weathered(params);
    TriMesh mesh = marching_tetrahedra(result.density, 0.5, Progress());
    const SurfaceGrids grids{.density = result.density,
                             .column = rock.column,
                             .component = result.component,
                             .surface = result.surface,
                             .weathering = &result.weathering};
    add_surface_attributes(mesh, grids, Progress());
    const auto& column = std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("column"));
    const auto& piece = std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("component"));
    const auto& kind = std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("surface"));
    ASSERT_EQ(column.size(), mesh.triangles.size());
    EXPECT_EQ(mesh.vertex_attributes.at("weathering").index(), 0u);
    EXPECT_FALSE(mesh.face_attributes.contains("arc"));
    std::map<int, std::size_t> kinds;
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
        const auto& t = mesh.triangles[i];
        Vec3d p;
        for (const std::uint32_t v : t)
            p += rock.domain.transform.voxels(Vec3d(mesh.vertices[v])) / 3.0;
        EXPECT_NE(column[i], 4);  // it is not there
        EXPECT_EQ(column[i], piece[i]);
        if (p.z < 3.5) {
            EXPECT_EQ(column[i], kMassiveRock);
        }
        if (p.z > 5.6) {
            EXPECT_GE(column[i], 0);
        }
        const auto is = static_cast<Surface>(kind[i]);
        const double wall = std::min({p.x, p.y, 24 - p.x, 27 - p.y});
        if (p.z > 1 && p.z < 25 && wall < 0.01) {
            EXPECT_EQ(is, Surface::DomainCap);
        }
        if (p.z > 26 && wall > 1) {
            EXPECT_TRUE(is == Surface::CoolingContact || is == Surface::JointWall);
        }
        if (wall > 1.5 && p.z > 6.5 && p.z < 25) {
            EXPECT_EQ(is, Surface::JointWall);
        }
        ++kinds[kind[i]];
    }
    EXPECT_GT(kinds[static_cast<int>(Surface::JointWall)], 100u);
    EXPECT_GT(kinds[static_cast<int>(Surface::CoolingContact)], 100u);
    EXPECT_GT(kinds[static_cast<int>(Surface::SlowContact)], 20u);  // the floor of the gap
    EXPECT_EQ(kinds.count(-1), 0u);
}

TEST(Weathering, StopsWhenAsked)
{
    const Rock rock = layered({20, 20, 20}, 10);
    const std::atomic<bool> stop{true};
    const Progress progress([](const std::string&, double) {}, &stop);
    EXPECT_THROW(run(rock.inputs(), {}, 1, progress), Cancelled);
}

}  // namespace
}  // namespace sekitei::weathering
