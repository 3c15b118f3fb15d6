#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>
#include <vector>

#include "core/mesh.h"
#include "grids/scene.h"

namespace sekitei::presets {

/// Fans of triangles around the vertices of a mesh whose edges are used twice: one a vertex on a
/// 2-manifold.
inline std::size_t fans(const TriMesh& mesh)
{
    struct Edge {
        std::uint32_t low, high, corner_low, corner_high;
        bool operator<(const Edge& b) const
        {
            return std::tie(low, high) < std::tie(b.low, b.high);
        }
    };
    std::vector<Edge> edges;
    edges.reserve(mesh.triangles.size() * 3);
    for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t)
        for (std::uint32_t k = 0; k < 3; ++k) {
            const std::uint32_t next = (k + 1) % 3, a = mesh.triangles[t][k],
                                b = mesh.triangles[t][next], ca = 3 * t + k, cb = 3 * t + next;
            edges.push_back(a < b ? Edge{a, b, ca, cb} : Edge{b, a, cb, ca});
        }
    std::sort(edges.begin(), edges.end());
    // Corners that share a vertex and an edge belong to one fan.
    std::vector<std::uint32_t> parent(edges.size());
    std::iota(parent.begin(), parent.end(), 0u);
    auto root = [&](std::uint32_t i) {
        while (parent[i] != i) i = parent[i] = parent[parent[i]];
        return i;
    };
    std::size_t count = edges.size();
    auto join = [&](std::uint32_t a, std::uint32_t b) {
        a = root(a);
        b = root(b);
        if (a == b) return;
        parent[a] = b;
        --count;
    };
    for (std::size_t i = 1; i < edges.size(); ++i) {
        if (edges[i - 1] < edges[i]) continue;
        join(edges[i - 1].corner_low, edges[i].corner_low);
        join(edges[i - 1].corner_high, edges[i].corner_high);
    }
    return count;
}

/// The exported rock is closed, 2-manifold, without empty triangles, and encloses what the density
/// says within 1 %.
inline void expect_solid(const Scene& scene)
{
    const TriMesh& mesh = scene.meshes.at("rock");
    const MeshReport report = inspect(mesh);
    EXPECT_TRUE(report.closed());
    EXPECT_EQ(report.open_edges, 0u);
    EXPECT_EQ(report.non_manifold_edges, 0u);
    EXPECT_EQ(report.misoriented_edges, 0u);
    EXPECT_EQ(report.zero_area, 0u);
    EXPECT_EQ(report.isolated_vertices, 0u);
    EXPECT_EQ(report.bad_vertices, 0u);
    EXPECT_GT(report.least_area, 0);
    EXPECT_EQ(fans(mesh), mesh.vertices.size());
    const FloatGrid& density = scene.floats("density");
    double sum = 0;
    for (std::size_t i = 0; i < density.leaf_count(); ++i)
        for (int o = 0; o < kLeafSize; ++o) sum += density.at(i, o);
    const double h = density.transform().voxel, voxels = sum * h * h * h;
    EXPECT_NEAR(report.volume, voxels, 0.01 * voxels);
}

}  // namespace sekitei::presets
