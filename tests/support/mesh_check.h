#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "core/mesh.h"

/// A slow look at a mesh by its definition, independent of what it checks.
namespace sekitei::testing_support {

struct MeshFacts {
    bool each_edge_twice = true;  ///< every directed edge once and its reverse once
    bool all_used = true;         ///< no vertex without a triangle
    bool one_fan = true;          ///< the triangles around each vertex are connected through edges
    std::int64_t euler = 0;
    double volume = 0, area = 0, least_area = INFINITY;
};

inline MeshFacts look_at(const TriMesh& mesh)
{
    MeshFacts facts;
    std::vector<std::pair<std::uint32_t, std::uint32_t>> edges;
    std::vector<std::uint32_t> degree(mesh.vertices.size(), 0);
    // Opposite edges around each vertex: (vertex, from, to).
    std::vector<std::array<std::uint32_t, 3>> links;
    for (const auto& t : mesh.triangles) {
        const Vec3d a(mesh.vertices[t[0]]), b(mesh.vertices[t[1]]), c(mesh.vertices[t[2]]);
        const double area = 0.5 * length(cross(b - a, c - a));
        facts.area += area;
        facts.least_area = std::min(facts.least_area, area);
        facts.volume += dot(a, cross(b, c)) / 6;
        for (std::size_t k = 0; k < 3; ++k) {
            edges.emplace_back(t[k], t[(k + 1) % 3]);
            links.push_back({t[k], t[(k + 1) % 3], t[(k + 2) % 3]});
            ++degree[t[k]];
        }
    }
    std::sort(edges.begin(), edges.end());
    if (std::adjacent_find(edges.begin(), edges.end()) != edges.end())
        facts.each_edge_twice = false;
    for (const auto& [a, b] : edges)
        if (!std::binary_search(edges.begin(), edges.end(), std::pair{b, a}))
            facts.each_edge_twice = false;
    facts.all_used =
        std::all_of(degree.begin(), degree.end(), [](std::uint32_t d) { return d > 0; });
    facts.euler = static_cast<std::int64_t>(mesh.vertices.size()) -
                  static_cast<std::int64_t>(edges.size() / 2) +
                  static_cast<std::int64_t>(mesh.triangles.size());
    // Around a manifold vertex the opposite edges form one ring.
    std::sort(links.begin(), links.end());
    for (std::size_t i = 0; i < links.size();) {
        std::size_t end = i;
        while (end < links.size() && links[end][0] == links[i][0]) ++end;
        std::size_t steps = 0;
        std::uint32_t at = links[i][1];
        do {
            auto next = std::find_if(links.begin() + static_cast<std::ptrdiff_t>(i),
                                     links.begin() + static_cast<std::ptrdiff_t>(end),
                                     [&](const auto& l) { return l[1] == at; });
            if (next == links.begin() + static_cast<std::ptrdiff_t>(end)) break;
            at = (*next)[2];
            ++steps;
        } while (at != links[i][1] && steps <= end - i);
        if (steps != end - i) facts.one_fan = false;
        i = end;
    }
    return facts;
}

}  // namespace sekitei::testing_support
