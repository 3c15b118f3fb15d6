#include "grids/level_set.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/error.h"
#include "grids/winding_number.h"
#include "tests/support/shapes.h"

namespace sekitei {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr double kVoxel = 0.25;
const Progress kQuiet;

Domain domain_of(Coord dims, double voxel = kVoxel, Vec3d origin = {-3, 2, 5})
{
    return {dims, {origin, voxel}};
}

/// Volume by the share of each voxel below the surface, for voxels cut by a nearly flat one.
double volume_of(const FloatGrid& grid)
{
    const double h = grid.transform().voxel;
    double sum = 0;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) sum += std::clamp(0.5 - grid.at(leaf, o) / h, 0.0, 1.0);
    return sum * h * h * h;
}

/// Largest deviation, in voxels, of voxels whose exact distance is below `within` voxels.
template <class Exact>
double worst_error(const FloatGrid& grid, const Domain& domain, double within, Exact&& exact)
{
    double worst = 0;
    for (int x = -8; x < domain.dims.x + 8; ++x)
        for (int y = -8; y < domain.dims.y + 8; ++y)
            for (int z = -8; z < domain.dims.z + 8; ++z) {
                const double d = exact(centre_of({x, y, z}));
                const double v = grid.value({x, y, z}) / domain.transform.voxel;
                if (std::fabs(d) < within)
                    worst = std::max(worst, std::fabs(v - d));
                else  // far voxels keep their side and never claim to be near
                    worst = std::max(worst, d * v > 0 && std::fabs(v) > within - 0.5 ? 0.0 : 99.0);
            }
    return worst;
}

bool same(const FloatGrid& a, const FloatGrid& b)
{
    if (a.topology()->origins() != b.topology()->origins()) return false;
    for (std::size_t leaf = 0; leaf < a.leaf_count(); ++leaf) {
        if (!(a.mask(leaf) == b.mask(leaf)) || a.is_constant(leaf) != b.is_constant(leaf))
            return false;
        for (int o = 0; o < kLeafSize; ++o)
            if (a.at(leaf, o) != b.at(leaf, o)) return false;
    }
    return true;
}

TEST(LevelSet, TiltedPlaneIsExactWhateverTheFunctionsSlope)
{
    const Domain domain = domain_of({37, 22, 30});
    const Vec3d n = normalized(Vec3d(2, -1, 3));
    auto plane = [&](Vec3d p) { return dot(n, p) - 14.3; };
    const FloatGrid grid = level_set_from_function(
        domain, [&](Vec3d p) { return 7 * plane(p); }, kQuiet);
    EXPECT_LT(worst_error(grid, domain, 3.9, plane), 1e-5);
    EXPECT_FLOAT_EQ(grid.background(), static_cast<float>(kBandVoxels * kVoxel));
}

TEST(LevelSet, QuadricOfABallGivesItsDistanceInAndBeyondTheBox)
{
    const Domain domain = domain_of({33, 40, 26});  // the ball sticks out of the box
    const Vec3d centre{15.2, 21.7, 9.9};
    const double radius = 14.6;
    const FloatGrid grid = level_set_from_function(
        domain, [&](Vec3d p) { return dot(p - centre, p - centre) - radius * radius; }, kQuiet);
    EXPECT_LT(worst_error(grid, domain, 3.5, [&](Vec3d p) { return length(p - centre) - radius; }),
              0.03);
    EXPECT_LT(worst_error(grid, domain, 1.5,
                          [&](Vec3d p) {
                              const double d = length(p - centre) - radius;
                              return std::fabs(d) < 1.5 ? d : d * 3;
                          }),
              0.03);
}

TEST(LevelSet, SkippingLeavesByTheSlopeBoundChangesNothing)
{
    const Domain domain = domain_of({70, 41, 56});
    auto ripple = [](Vec3d p) { return p.z - 25 - 4 * std::sin(p.x / 5) * std::sin(p.y / 6); };
    const FloatGrid slow = level_set_from_function(domain, ripple, kQuiet);
    const FloatGrid fast = level_set_from_function(domain, ripple, kQuiet, {.steepness = 1.5});
    std::size_t differing = 0;
    for (int x = -8; x < 78; ++x)
        for (int y = -8; y < 49; ++y)
            for (int z = -8; z < 64; ++z)
                differing += slow.value({x, y, z}) != fast.value({x, y, z}) ||
                             slow.active({x, y, z}) != fast.active({x, y, z});
    EXPECT_EQ(differing, 0u);
    EXPECT_LT(fast.dense_leaf_count(), fast.leaf_count());
}

TEST(LevelSet, BallMeshHasTheVolumeOfItsTrianglesToSecondOrder)
{
    const TriMesh mesh = shapes::ball({1.3, -0.7, 2.2}, 2.9, 5);
    auto error = [&](double voxel) {
        const FloatGrid grid = level_set_from_mesh(mesh, {{-4, -5, -3}, voxel}, kQuiet);
        return std::fabs(volume_of(grid) / mesh.signed_volume() - 1);
    };
    EXPECT_LT(error(0.1), 5e-4);
    EXPECT_GT(error(0.4) / error(0.1), 8.0);  // 16 for second order, less the noise of the lattice
}

TEST(LevelSet, BoxMeshHasItsVolumeAndItsDistances)
{
    const Vec3d lower{-1.03, 2.61, 5.37}, upper{2.29, 4.93, 9.11};
    const Domain domain = domain_of({36, 24, 40}, 0.17, {-2.1, 1.7, 4.1});
    const FloatGrid grid = level_set_from_mesh(shapes::box(lower, upper), domain.transform, kQuiet);
    const Vec3d size = upper - lower;
    EXPECT_NEAR(volume_of(grid) / (size.x * size.y * size.z), 1, 5e-3);
    auto exact = [&](Vec3d voxel) {
        const Vec3d p = domain.transform.world(voxel);
        const Vec3d out = max(lower - p, p - upper);
        const double inside = std::max({out.x, out.y, out.z});
        return (inside <= 0 ? inside : length(max(out, Vec3d{}))) / 0.17;
    };
    EXPECT_LT(worst_error(grid, domain, 1, exact), 1e-4);
    EXPECT_LT(worst_error(grid, domain, 3.9, exact), 0.6);
}

TEST(LevelSet, InteriorLeavesOfAMeshAreConstant)
{
    const FloatGrid grid =
        level_set_from_mesh(shapes::ball({0, 0, 0}, 20, 5), {{-24, -24, -24}, 0.5}, kQuiet);
    EXPECT_LT(grid.value({48, 48, 48}), 0);
    EXPECT_EQ(grid.value({48, 48, 48}), -grid.background());
    EXPECT_FALSE(grid.active({48, 48, 48}));
    const std::uint32_t leaf = grid.topology()->find({48, 48, 48});
    ASSERT_NE(leaf, kNoLeaf);
    EXPECT_TRUE(grid.is_constant(leaf));
}

TEST(LevelSet, WindingOfTheTrianglesDoesNotMatter)
{
    const TriMesh mesh = shapes::ball({1, 2, 3}, 3.1, 4);
    const Transform transform{{-3, -2, -1}, 0.2};
    EXPECT_TRUE(same(level_set_from_mesh(mesh, transform, kQuiet),
                     level_set_from_mesh(shapes::inverted(mesh), transform, kQuiet)));
}

TEST(LevelSet, OverlappingPartsGiveTheirUnionWithoutInnerFaces)
{
    TriMesh two = shapes::box({-2.03, -1.98, -2.07}, {1.01, 1.96, 2.11});
    const TriMesh other = shapes::box({-0.52, -1.98, -2.07}, {3.04, 1.96, 2.11});
    for (const auto& t : other.triangles) two.triangles.push_back({t[0] + 8, t[1] + 8, t[2] + 8});
    two.vertices.insert(two.vertices.end(), other.vertices.begin(), other.vertices.end());
    const Domain domain{{50, 46, 46}, {{-3.1, -3, -3}, 0.13}};
    const FloatGrid grid = level_set_from_mesh(two, domain.transform, kQuiet);
    const FloatGrid whole = level_set_from_mesh(
        shapes::box({-2.03, -1.98, -2.07}, {3.04, 1.96, 2.11}), domain.transform, kQuiet);
    EXPECT_EQ(inside_voxels(grid, domain), inside_voxels(whole, domain));
    double worst = 0;
    for (int x = 0; x < 50; ++x)
        for (int y = 0; y < 46; ++y)
            for (int z = 0; z < 46; ++z)
                worst = std::max(worst,
                                 std::fabs(double(grid.value({x, y, z})) - whole.value({x, y, z})));
    EXPECT_LT(worst / 0.13, 1.6);
}

TEST(LevelSet, HolesAreClosedByThePlaneOfTheirRim)
{
    // A box without its two top triangles; a planar rim has a planar patch.
    const Vec3d lower{0.31, 0.42, 0.53}, upper{4.37, 5.11, 3.49};
    TriMesh open = shapes::box(lower, upper);
    open.triangles.resize(10);
    const Domain domain{{40, 44, 36}, {{-1, -1, -1}, 0.17}};
    const FloatGrid whole =
        level_set_from_mesh(shapes::box(lower, upper), domain.transform, kQuiet);
    for (const TriMesh& mesh : {open, shapes::inverted(open)}) {
        const FloatGrid grid = level_set_from_open_mesh(mesh, domain, kQuiet);
        EXPECT_EQ(inside_voxels(grid, domain), inside_voxels(whole, domain));
        double worst = 0;
        for (int x = 0; x < 40; ++x)
            for (int y = 0; y < 44; ++y)
                for (int z = 0; z < 36; ++z)
                    worst = std::max(
                        worst, std::fabs(double(grid.value({x, y, z})) - whole.value({x, y, z})));
        EXPECT_LT(worst / 0.17, 1.25);
    }
}

TEST(LevelSet, ABallWithoutItsCapLosesNoMoreThanTheCap)
{
    const double radius = 3, cut = 2;  // the cap above z = 2 is missing
    TriMesh open = shapes::ball({0, 0, 0}, radius, 5);
    std::erase_if(open.triangles, [&](const auto& t) {
        return open.vertices[t[0]].z > cut && open.vertices[t[1]].z > cut &&
               open.vertices[t[2]].z > cut;
    });
    const Domain domain{{80, 80, 80}, {{-4, -4, -4}, 0.1}};
    const FloatGrid grid = level_set_from_open_mesh(open, domain, kQuiet);
    const double cap = radius - cut, pi = std::numbers::pi;
    const double volume = 4 * pi / 3 * 27 - pi * cap * cap * (3 * radius - cap) / 3;
    EXPECT_NEAR(inside_voxels(grid, domain) * 1e-3 / volume, 1, 0.01);
}

TEST(WindingNumber, AgreesWithTheSumOverAllTriangles)
{
    TriMesh open = shapes::ball({1, 0, -2}, 2.5, 4);
    open.triangles.resize(open.triangles.size() * 3 / 4);
    const WindingNumber winding(open);
    double worst = 0;
    for (int i = 0; i < 500; ++i) {
        const Vec3d p{-3 + 0.016 * i, 2.5 * std::sin(0.37 * i), -2 + 2.7 * std::cos(0.23 * i)};
        double angle = 0;
        for (const auto& t : open.triangles) {
            const Vec3d a = Vec3d(open.vertices[t[0]]) - p, b = Vec3d(open.vertices[t[1]]) - p,
                        c = Vec3d(open.vertices[t[2]]) - p;
            angle += 2 * std::atan2(dot(a, cross(b, c)),
                                    length(a) * length(b) * length(c) + dot(a, b) * length(c) +
                                        dot(b, c) * length(a) + dot(c, a) * length(b));
        }
        worst = std::max(worst, std::fabs(winding(p) - angle / (4 * std::numbers::pi)));
    }
    EXPECT_LT(worst, 0.02);
    EXPECT_GT(worst, 0);
}

IntGrid voxels_where(const Domain& domain, const std::function<bool(Vec3d)>& inside)
{
    IntGrid grid(box_topology({0, 0, 0}, domain.dims), domain.transform, 1);
    grid.expand();
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) {
            const Coord c = leaf_coord(grid.origin(leaf), o);
            if (!domain.contains(c) || !inside(centre_of(c))) continue;
            grid.values(leaf)[o] = 0;
            grid.mask(leaf).set(o);
        }
    grid.compress();
    return grid;
}

TEST(LevelSet, VoxelsOfASlabGiveTheExactPlaneAndNoBoxWalls)
{
    const Domain domain = domain_of({21, 35, 30});
    const IntGrid region = voxels_where(domain, [](Vec3d p) { return p.z < 13; });
    const FloatGrid grid = level_set_from_voxels(region, 0, domain, kQuiet);
    EXPECT_LT(worst_error(grid, domain, 3.9, [](Vec3d p) { return p.z - 13; }), 1e-5);
}

TEST(LevelSet, VoxelsOfABallGiveItsDistanceAndKeepTheirSides)
{
    const Domain domain = domain_of({44, 40, 42});
    const Vec3d centre{21.3, 19.8, 20.4};
    auto exact = [&](Vec3d p) { return length(p - centre) - 15.2; };
    const IntGrid region = voxels_where(domain, [&](Vec3d p) { return exact(p) < 0; });
    const FloatGrid grid = level_set_from_voxels(region, 0, domain, kQuiet);
    EXPECT_LT(worst_error(grid, domain, 3.2, exact), 0.6);
    EXPECT_EQ(inside_voxels(grid, domain), static_cast<double>(region.active_count()));
    EXPECT_NEAR(volume_of(grid) / (4 * std::numbers::pi / 3 * std::pow(15.2 * kVoxel, 3)), 1, 0.01);
}

TEST(LevelSet, ASheetOfOneVoxelSurvives)
{
    const Domain domain = domain_of({24, 17, 20});
    const IntGrid region = voxels_where(domain, [](Vec3d p) { return p.x > 11 && p.x < 12; });
    EXPECT_EQ(inside_voxels(level_set_from_voxels(region, 0, domain, kQuiet), domain), 17.0 * 20);
}

TEST(LevelSet, TouchingBodiesJoinWithoutASeam)
{
    const Domain domain = domain_of({40, 30, 34});
    auto slab = [](double low, double high) {
        return [=](Vec3d p) { return std::max(low - p.z, p.z - high); };
    };
    const ImplicitBounds bounds{.steepness = 1, .is_distance = true};
    const FloatGrid a = level_set_from_function(domain, slab(6, 17), kQuiet, bounds);
    const FloatGrid b = level_set_from_function(domain, slab(17, 29), kQuiet, bounds);
    const FloatGrid seam = csg_union(a, b), joined = mend_distances(seam, domain, kQuiet);
    EXPECT_NEAR(seam.value({20, 15, 17}), -0.5 * kVoxel, 1e-6);
    EXPECT_LT(worst_error(joined, domain, 3, slab(6, 29)), 1e-5);
}

TEST(LevelSet, SetOperationsAgreeWithTheirFormulas)
{
    const Domain domain = domain_of({36, 33, 40});
    auto ball = [](Vec3d c, double r) { return [=](Vec3d p) { return length(p - c) - r; }; };
    const auto fa = ball({14, 15, 17}, 10.3), fb = ball({22, 17, 21}, 9.1);
    const ImplicitBounds bounds{.steepness = 1, .is_distance = true};
    const FloatGrid a = level_set_from_function(domain, fa, kQuiet, bounds),
                    b = level_set_from_function(domain, fb, kQuiet, bounds);
    EXPECT_LT(
        worst_error(csg_union(a, b), domain, 3.9, [&](Vec3d p) { return std::min(fa(p), fb(p)); }),
        1e-5);
    EXPECT_LT(worst_error(csg_intersection(a, b), domain, 3.9,
                          [&](Vec3d p) { return std::max(fa(p), fb(p)); }),
              1e-5);
    EXPECT_LT(worst_error(csg_difference(a, b), domain, 3.9,
                          [&](Vec3d p) { return std::max(fa(p), -fb(p)); }),
              1e-5);
}

TEST(LevelSet, IsTheSameOnAnyNumberOfThreads)
{
    const Domain domain{{60, 60, 60}, {{-4, -4, -4}, 0.13}};
    TriMesh open = shapes::ball({0, 0, 0}, 3, 4);
    open.triangles.resize(open.triangles.size() - 20);
    auto all = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        std::vector<FloatGrid> grids;
        grids.push_back(
            level_set_from_mesh(shapes::ball({0.1, 0, 0}, 3, 5), domain.transform, kQuiet));
        grids.push_back(level_set_from_open_mesh(open, domain, kQuiet));
        grids.push_back(distance_to_mesh(open, domain.transform, 9, kQuiet));
        grids.push_back(level_set_from_function(
            domain, [](Vec3d p) { return p.z - 20 - 3 * std::sin(p.x * 0.3); }, kQuiet));
        grids.push_back(level_set_from_voxels(
            voxels_where(domain, [](Vec3d p) { return p.z < 20 + 5 * std::sin(p.x); }), 0, domain,
            kQuiet));
        return grids;
    };
    const auto one = all(1);
    for (const std::size_t threads : {2u, 7u}) {
        const auto many = all(threads);
        for (std::size_t i = 0; i < one.size(); ++i) EXPECT_TRUE(same(one[i], many[i])) << i;
    }
}

TEST(LevelSet, NamesWhatIsWrongWithAMesh)
{
    const Transform transform{{0, 0, 0}, 0.5};
    auto convert = [&](TriMesh mesh) {
        return [mesh, transform] { level_set_from_mesh(mesh, transform, kQuiet); };
    };
    TriMesh points;
    points.vertices.resize(7);
    EXPECT_THAT(convert(points),
                ThrowsMessage<InvalidInput>(HasSubstr("7 vertices and no triangles")));
    TriMesh broken = shapes::box({0, 0, 0}, {3, 4, 5});
    broken.vertices[5].y = NAN;
    EXPECT_THAT(convert(broken), ThrowsMessage<InvalidInput>(HasSubstr("number 5")));
    TriMesh dangling = shapes::box({0, 0, 0}, {3, 4, 5});
    dangling.triangles[2][1] = 8;
    EXPECT_THAT(convert(dangling),
                ThrowsMessage<InvalidInput>(HasSubstr("triangle 2 names vertex 8")));
    EXPECT_THAT(convert(shapes::box({0.01, 0.01, 0.01}, {0.02, 0.02, 0.02})),
                ThrowsMessage<InvalidInput>(HasSubstr("hold no voxel of 0.5 m")));
    TriMesh lone = shapes::box({0, 0, 0}, {3, 4, 5});
    lone.triangles.resize(1);
    EXPECT_THAT(
        [&] {
            level_set_from_open_mesh(lone, {{20, 20, 20}, transform}, kQuiet);
        },
        ThrowsMessage<InvalidInput>(HasSubstr("close its holes")));
}

TEST(LevelSet, StopsWhenAsked)
{
    const std::atomic<bool> stop{true};
    const Progress progress({}, &stop);
    EXPECT_THROW(level_set_from_mesh(shapes::ball({0, 0, 0}, 3, 3), {{-4, -4, -4}, 0.1}, progress),
                 Cancelled);
    EXPECT_THROW(level_set_from_function(
                     domain_of({50, 50, 50}), [](Vec3d p) { return p.z - 9; }, progress),
                 Cancelled);
}

}  // namespace
}  // namespace sekitei
