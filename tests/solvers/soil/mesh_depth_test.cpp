#include "solvers/soil/mesh_depth.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/parallel.h"
#include "solvers/soil/soil.h"
#include "tests/core/meshes.h"
#include "tests/support/shapes.h"

namespace sekitei::soil {
namespace {

using testing::Each;

struct Found {
    MeshSites sites;
    MeshDepth depth;
};

Found look(const TriMesh& mesh, double edge)
{
    Found found{mesh_sites(mesh, edge, Progress()), {}};
    found.depth = mesh_depth(found.sites, Progress());
    return found;
}

/// The nearest crossing of a ray straight down, by looking at every site in double.
double first_below(const MeshSites& sites, std::size_t from, bool up, std::size_t* hit = nullptr)
{
    double nearest = std::numeric_limits<double>::infinity();
    const Vec3d p(sites.position[from]);
    for (std::size_t t = 0; t < sites.size(); ++t) {
        if (t == from || (up ? sites.normal[t].z <= 0 : sites.normal[t].z >= 0)) continue;
        const auto& [i, j, k] = sites.mesh.triangles[t];
        const auto& v = sites.mesh.vertices;
        const Vec3d a(v[i]), b(v[j]), c(v[k]);
        const auto turn = [&](Vec3d q, Vec3d r) {
            return (q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x);
        };
        const double wa = turn(b, c), wb = turn(c, a), wc = turn(a, b);
        if ((wa < 0 || wb < 0 || wc < 0) && (wa > 0 || wb > 0 || wc > 0)) continue;
        const double z = (wa * a.z + wb * b.z + wc * c.z) / (wa + wb + wc);
        if (p.z - z >= -1e-9 && p.z - z < nearest) {
            nearest = p.z - z;
            if (hit) *hit = t;
        }
    }
    return nearest;
}

TEST(MeshDepth, ASlabIsAsDeepAsItIsThick)
{
    const Found slab = look(shapes::box({-1, 2, 0.4}, {1, 3.5, 0.7}), 0.2);
    for (std::size_t i = 0; i < slab.sites.size(); ++i)
        EXPECT_NEAR(slab.depth.depth[i], slab.sites.normal[i].z > 0.5F ? 300 : 1, 1e-3);
    EXPECT_THAT(slab.depth.drop_target, Each(-1));
    // Deeper than a metre counts as a metre; thinner than a millimetre as a millimetre.
    const Found block = look(shapes::box({0, 0, 0}, {1, 1, 3}), 0.5);
    const Found leaf = look(shapes::box({0, 0, 2}, {1, 1, 2.0001}), 0.5);
    for (std::size_t i = 0; i < block.sites.size(); ++i)
        EXPECT_EQ(block.depth.depth[i], block.sites.normal[i].z > 0.5F ? 1000 : 1);
    EXPECT_THAT(leaf.depth.depth, Each(1));
}

TEST(MeshDepth, ASheetIsGroundWithoutABottomAndItsBackIsNoSoil)
{
    TriMesh sheet;
    sheet.vertices = {{0, 0, 0.3F}, {1, 0, 0.3F}, {1, 1, 0.4F}, {0, 1, 0.4F}};
    sheet.triangles = {{0, 1, 2}, {0, 2, 3}};
    EXPECT_THAT(look(sheet, 0.3).depth.depth, Each(1000));
    EXPECT_THAT(look(shapes::inverted(sheet), 0.3).depth.depth, Each(1));
    EXPECT_THAT(look(shapes::inverted(sheet), 0.3).depth.drop_target, Each(-1));
    // Modelled from both sides it is a leaf without thickness.
    TriMesh both = sheet;
    meshes::append(both, sheet, true);
    EXPECT_THAT(look(both, 0.3).depth.depth, Each(1));
    // One sheet over another: between them is air.
    TriMesh upper = sheet, stack = sheet;
    for (Vec3f& v : upper.vertices) v.z += 0.2F;
    meshes::append(stack, upper);
    EXPECT_THAT(look(stack, 0.3).depth.depth, Each(1000));
}

TEST(MeshDepth, SlopesSteeperThanAWallHoldNothing)
{
    for (const double slope : {0.09, 0.11}) {
        // A wedge whose face has n.z = slope.
        TriMesh mesh = shapes::box({0, 0, 0}, {1, 1, 1});
        const double run = slope / std::sqrt(1 - slope * slope);
        for (Vec3f& v : mesh.vertices)
            if (v.z > 0.5F && v.x > 0.5F) v.x = static_cast<float>(1 - run);
        const Found wedge = look(mesh, 0.1);
        for (std::size_t i = 0; i < wedge.sites.size(); ++i) {
            if (std::abs(double(wedge.sites.normal[i].z) - slope) > 1e-4) continue;
            const double height = double(wedge.sites.position[i].z);
            EXPECT_NEAR(wedge.depth.depth[i], slope > 0.1 ? 1000 * height : 1.0, 1e-2);
        }
    }
}

TEST(MeshDepth, ABallIsAsDeepAsItsChords)
{
    const double r = 0.3;
    const Found ball = look(shapes::ball({1, -2, 5}, r, 5), 0.05);
    for (std::size_t i = 0; i < ball.sites.size(); ++i) {
        if (ball.sites.normal[i].z <= 0.2F) continue;
        const Vec3d p = Vec3d(ball.sites.position[i]) - Vec3d(1, -2, 5);
        EXPECT_NEAR(ball.depth.depth[i], 2000 * std::sqrt(r * r - p.x * p.x - p.y * p.y), 5);
        EXPECT_NEAR(ball.depth.depth[i], 1000 * first_below(ball.sites, i, false), 1e-3);
    }
}

TEST(MeshDepth, StonesThatStandOnEachOtherEndWhereTheyTouch)
{
    TriMesh mesh = shapes::box({0, 0, 0}, {1, 1, 0.25});
    meshes::append(mesh, shapes::box({0.25, 0.25, 0.25}, {0.75, 0.75, 0.75}));
    const Found found = look(mesh, 0.1);
    for (std::size_t i = 0; i < found.sites.size(); ++i)
        if (found.sites.normal[i].z > 0.5F && found.sites.position[i].z > 0.5F) {
            EXPECT_EQ(found.depth.depth[i], 500);
        }
    // The lower stone around the upper one.
    for (std::size_t i = 0; i < found.sites.size(); ++i)
        if (found.sites.normal[i].z > 0.5F && found.sites.position[i].x < 0.2F) {
            EXPECT_EQ(found.depth.depth[i], 250);
        }
}

TEST(MeshDepth, DropsFallOnWhatLiesBelow)
{
    // A roof over a floor over a lower floor; beside the floor there is nothing.
    TriMesh mesh = shapes::box({0, 0, 2}, {2, 1, 2.1});
    meshes::append(mesh, shapes::box({0, 0, 0.9}, {1, 1, 1}));
    meshes::append(mesh, shapes::box({0, 0, 0}, {1, 1, 0.1}));
    const Found found = look(mesh, 0.15);
    const MeshSites& sites = found.sites;
    std::size_t drops = 0;
    for (std::size_t i = 0; i < sites.size(); ++i) {
        const std::int32_t target = found.depth.drop_target[i];
        std::size_t expected = 0;
        if (sites.normal[i].z > -0.5F || !std::isfinite(first_below(sites, i, true, &expected))) {
            EXPECT_EQ(target, -1);
            continue;
        }
        ++drops;
        ASSERT_GE(target, 0);
        const auto t = static_cast<std::size_t>(target);
        // Where the drop falls on an edge, either site will do.
        EXPECT_NEAR(sites.position[t].z, sites.position[expected].z, 1e-6);
        EXPECT_LT(length(sites.position[t] - sites.position[expected]), 0.15F);
        EXPECT_GT(sites.normal[t].z, 0.5F);
        EXPECT_NEAR(sites.position[t].z, sites.position[i].z > 1.5F ? 1.0 : 0.1, 1e-6);
    }
    EXPECT_GT(drops, 100u);
    // What the runoff asks of them: targets below their sites.
    std::vector<Vec3d> position;
    std::vector<float> up;
    for (std::size_t i = 0; i < sites.size(); ++i) {
        position.emplace_back(sites.position[i]);
        up.push_back(sites.normal[i].z);
    }
    EXPECT_NO_THROW(runoff_paths(
        {position, up, sites.area, sites.neighbour_begin, sites.neighbour, found.depth.drop_target},
        Progress()));
}

TEST(MeshDepth, TheBackOfASheetCatchesDropsForNobody)
{
    TriMesh mesh = shapes::box({0, 0, 2}, {1, 1, 2.1});
    meshes::append(mesh, shapes::box({0, 0, 0}, {1, 1, 0.1}));
    TriMesh sheet;
    sheet.vertices = {{0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
    sheet.triangles = {{0, 1, 2}, {0, 2, 3}};
    meshes::append(mesh, sheet, true);
    const Found found = look(mesh, 0.3);
    for (std::size_t i = 0; i < found.sites.size(); ++i) {
        if (found.sites.normal[i].z > -0.5F) continue;
        const bool from_sheet = found.sites.position[i].z == 1;
        EXPECT_EQ(found.depth.drop_target[i] >= 0, from_sheet);
    }
}

TEST(MeshDepth, IsBitIdenticalForAnyNumberOfThreads)
{
    TriMesh mesh = meshes::torus(40, 20);
    meshes::append(mesh, shapes::ball({3, 0, 6}, 1.5, 3));
    auto on_threads = [&](std::size_t n) {
        const ThreadLimit limit(n);
        return look(mesh, 0.3).depth;
    };
    const MeshDepth one = on_threads(1), four = on_threads(4);
    EXPECT_EQ(one.depth, four.depth);
    EXPECT_EQ(one.drop_target, four.drop_target);
    EXPECT_TRUE(std::ranges::any_of(one.drop_target, [](std::int32_t t) { return t >= 0; }));
}

TEST(MeshDepth, CanBeStopped)
{
    const MeshSites sites = mesh_sites(meshes::torus(40, 20), 1, Progress());
    const std::atomic<bool> wish = true;
    EXPECT_THROW(mesh_depth(sites, Progress(nullptr, &wish)), Cancelled);
}

}  // namespace
}  // namespace sekitei::soil
