#pragma once

#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <utility>

#include "core/mesh.h"

/// Closed meshes whose volume is known.
namespace sekitei::shapes {

/// An axis-aligned box, wound outwards: faces -x +x -y +y -z +z, two triangles each.
inline TriMesh box(Vec3d lower, Vec3d upper)
{
    TriMesh mesh;
    for (int i = 0; i < 8; ++i)
        mesh.vertices.emplace_back(
            Vec3d(i & 1 ? upper.x : lower.x, i & 2 ? upper.y : lower.y, i & 4 ? upper.z : lower.z));
    const std::uint32_t quads[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                                       {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
    for (const auto& q : quads) {
        mesh.triangles.push_back({q[0], q[1], q[2]});
        mesh.triangles.push_back({q[0], q[2], q[3]});
    }
    return mesh;
}

/// An octahedron subdivided `levels` times onto the sphere.
inline TriMesh ball(Vec3d centre, double radius, int levels)
{
    std::vector<Vec3d> points{{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    TriMesh mesh;
    for (const std::uint32_t z : {4u, 5u})
        for (int k = 0; k < 4; ++k) {
            const std::uint32_t ring[4] = {0, 2, 1, 3};
            std::uint32_t a = ring[k], b = ring[(k + 1) % 4];
            if (z == 5) std::swap(a, b);
            mesh.triangles.push_back({a, b, z});
        }
    for (int level = 0; level < levels; ++level) {
        std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
        auto middle = [&](std::uint32_t a, std::uint32_t b) {
            const auto key = std::minmax(a, b);
            const auto found = middles.find(key);
            if (found != middles.end()) return found->second;
            points.push_back(normalized(points[a] + points[b]));
            return middles[key] = static_cast<std::uint32_t>(points.size() - 1);
        };
        std::vector<std::array<std::uint32_t, 3>> finer;
        for (const auto& [a, b, c] : mesh.triangles) {
            const std::uint32_t ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
            finer.push_back({a, ab, ca});
            finer.push_back({b, bc, ab});
            finer.push_back({c, ca, bc});
            finer.push_back({ab, bc, ca});
        }
        mesh.triangles = std::move(finer);
    }
    for (const Vec3d& p : points) mesh.vertices.emplace_back(centre + p * radius);
    return mesh;
}

inline TriMesh inverted(TriMesh mesh)
{
    for (auto& t : mesh.triangles) std::swap(t[1], t[2]);
    return mesh;
}

}  // namespace sekitei::shapes
