#include "grids/marching_tetrahedra.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "core/noise.h"
#include "tests/support/mesh_check.h"

namespace sekitei {
namespace {

using testing_support::look_at;
using testing_support::MeshFacts;

/// f at the voxels [lower, upper), in full leaves; elsewhere the background.
FloatGrid sampled(Coord lower, Coord upper, const Transform& transform, float background,
                  const std::function<double(Coord)>& f)
{
    const TopologyPtr topology = box_topology(lower, upper);
    auto grid = FloatGrid::uninitialised(topology, transform, background);
    for (std::size_t i = 0; i < grid.leaf_count(); ++i)
        for (int o = 0; o < kLeafSize; ++o) {
            const Coord c = leaf_coord(grid.origin(i), o);
            const bool inside = c.x >= lower.x && c.y >= lower.y && c.z >= lower.z &&
                                c.x < upper.x && c.y < upper.y && c.z < upper.z;
            grid.values(i)[o] = inside ? static_cast<float>(f(c)) : background;
            grid.mask(i).set(o);
        }
    grid.compress();
    return grid;
}

TriMesh extract(const FloatGrid& grid, double iso)
{
    return marching_tetrahedra(grid, iso, Progress());
}

void expect_closed(const MeshFacts& facts)
{
    EXPECT_TRUE(facts.each_edge_twice);
    EXPECT_TRUE(facts.all_used);
    EXPECT_TRUE(facts.one_fan);
    EXPECT_GT(facts.least_area, 0);
}

/// The ball of radius .37 about (.503, .491, .517), on (n + 1)^3 nodes of the unit cube.
TriMesh ball(int n)
{
    const double h = 1.0 / n;
    const Transform transform{Vec3d(-0.5 * h), h};
    return extract(sampled({0, 0, 0}, Coord(n + 1), transform, -1.0f,
                           [&](Coord c) {
                               const Vec3d p = transform.world(centre_of(c));
                               return 0.37 - length(p - Vec3d(0.503, 0.491, 0.517));
                           }),
                   0);
}

struct BallCase {
    int n;
    std::size_t vertices, triangles;
    double volume, area;
};

// Counts, volumes and areas from an independent implementation of the same definition.
TEST(MarchingTetrahedra, TurnsTheBallIntoTheExpectedClosedMesh)
{
    for (const BallCase& expected : {BallCase{16, 1944, 3884, .2091469, 1.7076728},
                                     BallCase{32, 7910, 15816, .2114168, 1.7171757},
                                     BallCase{64, 31622, 63240, .2119856, 1.7195473}}) {
        const TriMesh mesh = ball(expected.n);
        const MeshFacts facts = look_at(mesh);
        EXPECT_EQ(mesh.vertices.size(), expected.vertices);
        EXPECT_EQ(mesh.triangles.size(), expected.triangles);
        EXPECT_NEAR(facts.volume, expected.volume, 2e-7);
        EXPECT_NEAR(facts.area, expected.area, 1e-6);
        EXPECT_EQ(facts.euler, 2);
        expect_closed(facts);
    }
}

TEST(MarchingTetrahedra, ConvergesToTheBallsVolumeAtSecondOrder)
{
    const double exact = 4.0 / 3 * 3.14159265358979 * .37 * .37 * .37;
    const double coarse = exact - look_at(ball(16)).volume,
                 middle = exact - look_at(ball(32)).volume, fine = exact - look_at(ball(64)).volume;
    EXPECT_GT(coarse / middle, 3.7);
    EXPECT_LT(coarse / middle, 4.3);
    EXPECT_GT(middle / fine, 3.7);
    EXPECT_LT(middle / fine, 4.3);
}

struct NodeCase {
    std::vector<Coord> ones;
    std::size_t vertices, triangles;
    double volume, area;
    std::int64_t euler;
};

TEST(MarchingTetrahedra, WrapsSingleNodesAsTheLatticeDemands)
{
    const std::vector<NodeCase> cases{{{{4, 3, 5}}, 14, 24, .5, 3.62132, 2},
                                      {{{2, 2, 2}, {3, 3, 3}}, 26, 48, 1.25, 7.863961, 2},
                                      {{{3, 2, 2}, {2, 3, 2}}, 28, 48, 1.0, 7.242641, 4}};
    // Shifts put the same nodes inside a leaf, across faces, edges and corners of leaves.
    for (const Coord shift : {Coord(0, 0, 0), Coord(5, 0, 0), Coord(0, 4, 5), Coord(5, 5, 5),
                              Coord(-3, -11, 6), Coord(4, 3, 2)})
        for (const NodeCase& expected : cases) {
            auto one = [&](Coord c) {
                for (const Coord& o : expected.ones)
                    if (c == o + shift) return 1.0;
                return 0.0;
            };
            const TriMesh mesh = extract(sampled(shift, shift + Coord(8), {}, 0.0f, one), 0.5);
            const MeshFacts facts = look_at(mesh);
            EXPECT_EQ(mesh.vertices.size(), expected.vertices);
            EXPECT_EQ(mesh.triangles.size(), expected.triangles);
            EXPECT_NEAR(facts.volume, expected.volume, 1e-5);
            EXPECT_NEAR(facts.area, expected.area, 1e-4);
            EXPECT_EQ(facts.euler, expected.euler);
            expect_closed(facts);
        }
}

TEST(MarchingTetrahedra, ReproducesALinearFieldsPlaneExactly)
{
    const Transform transform{{3, -7, 11}, 0.3};
    const Vec3d normal = normalized(Vec3d(.48, -.64, .6));
    const Vec3d middle = transform.world({11, 9, 13});
    const FloatGrid grid = sampled({0, 0, 0}, {22, 18, 26}, transform, -100.0f, [&](Coord c) {
        return -dot(transform.world(centre_of(c)) - middle, normal);
    });
    const TriMesh mesh = extract(grid, 0);
    std::size_t seen = 0;
    for (const auto& t : mesh.triangles) {
        const Vec3d a(mesh.vertices[t[0]]), b(mesh.vertices[t[1]]), c(mesh.vertices[t[2]]);
        if (length(a - middle) > 2) continue;  // the caps of the box lie farther away
        ++seen;
        EXPECT_NEAR(dot(a - middle, normal), 0, 1e-5);
        EXPECT_GT(dot(cross(b - a, c - a), normal), 0);  // faces lower values
    }
    EXPECT_GT(seen, 100u);
}

TEST(MarchingTetrahedra, ClosesConstantLeavesAgainstTheBackground)
{
    // Whole leaves of ones: nothing is stored but constants.
    FloatGrid grid(LeafTopology::build({{0, 0, 0}, {8, 0, 0}, {8, 8, 0}, {16, 16, 8}}),
                   {{1, 2, 3}, 0.5}, 0.0f);
    for (std::size_t i = 0; i < grid.leaf_count(); ++i) {
        grid.set_constant(i, 1.0f);
        grid.mask(i) = LeafMask::full();
    }
    const TriMesh mesh = extract(grid, 0.5);
    const MeshFacts facts = look_at(mesh);
    expect_closed(facts);
    // Leaves that touch at the corner (16, 16, 8) are joined along the lattice's diagonal.
    EXPECT_EQ(facts.euler, 2);
    EXPECT_NEAR(facts.volume, 4 * 512 * .125, 0.15 * 4 * 512 * .125);

    FloatGrid expanded = grid;
    expanded.expand();
    const TriMesh same = extract(expanded, 0.5);
    EXPECT_EQ(same.vertices, mesh.vertices);
    EXPECT_EQ(same.triangles, mesh.triangles);
}

TEST(MarchingTetrahedra, ClosesRandomFieldsOnAnyTopology)
{
    for (std::uint64_t seed = 0; seed < 6; ++seed) {
        std::vector<Coord> origins;
        for (int i = 0; i < 64; ++i)
            if (uniform01(seed, Stream("leaf"), static_cast<std::uint64_t>(i)) < 0.6)
                origins.push_back(Coord(i / 16 - 2, (i / 4) % 4, i % 4 - 1) * 8);
        const float background = seed % 2 ? 1.0f : 0.0f;  // hollow worlds as well
        FloatGrid grid =
            FloatGrid::uninitialised(LeafTopology::build(origins), {{}, 0.7}, background);
        for (std::size_t i = 0; i < grid.leaf_count(); ++i)
            for (int o = 0; o < kLeafSize; ++o) {
                const Coord c = leaf_coord(grid.origin(i), o);
                const auto key =
                    static_cast<std::uint64_t>((c.x + 99) * 40000 + (c.y + 99) * 200 + c.z + 99);
                const double u = uniform01(seed, Stream("value"), key);
                grid.values(i)[o] = i % 5 == 0 ? 1.0f : static_cast<float>(u);
            }
        expect_closed(look_at(extract(grid, 0.5)));
    }
}

TEST(MarchingTetrahedra, KeepsTheMeshClosedWhenValuesEqualIsoOrAreNotFinite)
{
    const FloatGrid grid = sampled({0, 0, 0}, {9, 10, 11}, {}, 0.0f, [](Coord c) {
        const int k = (c.x * 7 + c.y * 5 + c.z * 3) % 11;
        return k == 0 ? 0.5 : k == 1 ? INFINITY : k == 2 ? -INFINITY : k == 3 ? NAN : k / 10.0;
    });
    const TriMesh mesh = extract(grid, 0.5);
    expect_closed(look_at(mesh));
    for (const Vec3f& v : mesh.vertices) EXPECT_TRUE(std::isfinite(v.x + v.y + v.z));
}

TEST(MarchingTetrahedra, IsBitIdenticalForAnyNumberOfThreads)
{
    const FractalNoise noise{.seed = 3, .frequency = 0.09, .octaves = 3};
    const FloatGrid grid = sampled({-13, 5, 0}, {40, 61, 37}, {{}, 0.25}, 0.0f,
                                   [&](Coord c) { return 0.5 + noise(centre_of(c)); });
    auto on_threads = [&](std::size_t n) {
        const ThreadLimit limit(n);
        return extract(grid, 0.5);
    };
    const TriMesh one = on_threads(1);
    EXPECT_GT(one.triangles.size(), 1000u);
    for (const std::size_t n : {2u, 7u}) {
        const TriMesh many = on_threads(n);
        EXPECT_EQ(one.vertices, many.vertices);
        EXPECT_EQ(one.triangles, many.triangles);
    }
}

TEST(MarchingTetrahedra, MakesNothingOfNothing)
{
    EXPECT_TRUE(extract(FloatGrid(), 0.5).vertices.empty());
    const FloatGrid empty(box_topology({0, 0, 0}, {20, 20, 20}), {}, 0.0f);
    EXPECT_TRUE(extract(empty, 0.5).triangles.empty());
}

}  // namespace
}  // namespace sekitei
