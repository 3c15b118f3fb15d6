#include "core/mesh_intersections.h"

#include <gtest/gtest.h>

#include <atomic>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"
#include "tests/core/meshes.h"

namespace sekitei {
namespace {

using meshes::append;
using meshes::box;
using meshes::tetrahedron;
using meshes::torus;

constexpr std::uint64_t kAll = 1'000'000;

TEST(MeshIntersections, SurfacesThatDoNotMeetHaveNone)
{
    EXPECT_EQ(count_self_intersections(torus(40, 30), kAll), 0u);
    TriMesh mesh = box({0, 0, 0}, {2, 3, 4});
    append(mesh, box({0.5f, 0.5f, 0.5f}, {1, 1, 1}));  // one inside the other
    append(mesh, tetrahedron({2.001f, 0, 0}));
    EXPECT_EQ(count_self_intersections(mesh, kAll), 0u);
    EXPECT_EQ(count_self_intersections(TriMesh{}, kAll), 0u);
}

TEST(MeshIntersections, ASpikeThroughATriangleIsOnePairForEachOfItsSidesThatPass)
{
    TriMesh mesh;
    mesh.vertices = {{0, 0, 0}, {9, 0, 0}, {0, 9, 0}};
    mesh.triangles = {{0, 1, 2}};
    append(mesh, tetrahedron({2, 2, -1}));  // its tip and its three standing sides pass
    EXPECT_EQ(count_self_intersections(mesh, kAll), 3u);
}

TEST(MeshIntersections, BoxesThatOverlapAreFoundAlsoWhereEdgesMeetDiagonals)
{
    for (const Vec3f offset : {Vec3f(1, 1, 1), Vec3f(0.7f, 1.1f, 1.3f), Vec3f(-1, 1, 0.5f)}) {
        TriMesh mesh = box({0, 0, 0}, {2, 2, 2});
        append(mesh, box(offset, {2, 2, 2}));
        EXPECT_GE(count_self_intersections(mesh, kAll), 6u) << offset.x;
    }
}

/// Triangles strewn at random: whether two meet is found without a tree, from the edge that
/// enters the other triangle, by solving for the point of the plane.
TEST(MeshIntersections, ATreeFindsWhatAllPairsDo)
{
    constexpr Stream kPlace{"test.place"};
    TriMesh mesh;
    for (std::uint32_t i = 0; i < 300; ++i) {
        auto draw = [&](std::uint64_t k) { return uniform01(5, kPlace, i, k); };
        const Vec3d centre(draw(0) * 5, draw(1) * 3, draw(2) * 4);
        for (std::uint64_t k = 0; k < 3; ++k)
            mesh.vertices.emplace_back(
                centre + Vec3d(draw(3 + 3 * k), draw(4 + 3 * k), draw(5 + 3 * k)) * 0.9);
        mesh.triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    auto corner = [&](std::size_t t, std::size_t k) {
        return Vec3d(mesh.vertices[mesh.triangles[t][k % 3]]);
    };
    auto enters = [&](std::size_t s, std::size_t t) {
        const Vec3d a = corner(t, 0), u = corner(t, 1) - a, v = corner(t, 2) - a, n = cross(u, v);
        for (std::size_t k = 0; k < 3; ++k) {
            const Vec3d from = corner(s, k), d = corner(s, k + 1) - from;
            const double at = dot(a - from, n) / dot(d, n);
            const Vec3d p = from + d * at - a;
            const double x = dot(cross(p, v), n) / dot(n, n), y = dot(cross(u, p), n) / dot(n, n);
            if (at > 0 && at < 1 && x > 0 && y > 0 && x + y < 1) return true;
        }
        return false;
    };
    std::uint64_t expected = 0;
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i)
        for (std::size_t j = i + 1; j < mesh.triangles.size(); ++j)
            if (enters(i, j) || enters(j, i)) ++expected;
    ASSERT_GT(expected, 50u);
    for (const std::size_t threads : {1u, 5u}) {
        const ThreadLimit limit(threads);
        EXPECT_EQ(count_self_intersections(mesh, kAll), expected);
        EXPECT_EQ(count_self_intersections(mesh, 20), 21u) << "stops counting";
    }
}

TEST(MeshIntersections, StopsWhenAsked)
{
    const std::atomic<bool> stop{true};
    EXPECT_THROW(count_self_intersections(torus(9, 9), kAll, Progress({}, &stop)), Cancelled);
}

}  // namespace
}  // namespace sekitei
