#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/mesh.h"

namespace sekitei {

/// One side of a triangle as part of an edge. Not for use outside core/.
struct TriangleSide {
    std::uint64_t edge;  ///< lower vertex << 32 | higher vertex
    std::uint32_t triangle;
    bool rising;  ///< the triangle runs from the lower vertex to the higher
};

inline void append_sides(const TriMesh& mesh, std::uint32_t triangle,
                         std::vector<TriangleSide>& sides)
{
    const auto& corners = mesh.triangles[triangle];
    for (std::size_t k = 0; k < 3; ++k) {
        const std::uint64_t from = corners[k], to = corners[(k + 1) % 3];
        sides.push_back({std::min(from, to) << 32 | std::max(from, to), triangle, from < to});
    }
}

/// Sides of one edge come together, in the order of their triangles.
inline void sort_by_edge(std::vector<TriangleSide>& sides)
{
    std::sort(sides.begin(), sides.end(), [](const TriangleSide& a, const TriangleSide& b) {
        return a.edge != b.edge ? a.edge < b.edge : a.triangle < b.triangle;
    });
}

}  // namespace sekitei
