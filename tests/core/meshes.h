#pragma once

#include <cmath>
#include <numbers>

#include "core/mesh.h"

/// Small surfaces with known measures, wound counter-clockwise from outside.
namespace sekitei::meshes {

/// Corners (0,0,0), (3,0,0), (0,4,0), (0,0,5), moved: volume 10.
inline TriMesh tetrahedron(Vec3f at = {7, -2, 11})
{
    TriMesh mesh;
    mesh.vertices = {at, at + Vec3f(3, 0, 0), at + Vec3f(0, 4, 0), at + Vec3f(0, 0, 5)};
    mesh.triangles = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    return mesh;
}

/// A box of the given size with its lower corner at `at`.
inline TriMesh box(Vec3f at, Vec3f size)
{
    TriMesh mesh;
    for (int i = 0; i < 8; ++i)
        mesh.vertices.push_back(at +
                                Vec3f(i & 1 ? size.x : 0, i & 2 ? size.y : 0, i & 4 ? size.z : 0));
    mesh.triangles = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                      {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
    return mesh;
}

/// A ring of n x m quads around the z axis, large radius 5, small radius 2.
inline TriMesh torus(std::uint32_t n, std::uint32_t m)
{
    TriMesh mesh;
    for (std::uint32_t i = 0; i < n; ++i)
        for (std::uint32_t j = 0; j < m; ++j) {
            const double u = 2 * std::numbers::pi * i / n, v = 2 * std::numbers::pi * j / m;
            const double r = 5 + 2 * std::cos(v);
            mesh.vertices.emplace_back(Vec3d(r * std::cos(u), r * std::sin(u), 2 * std::sin(v)));
        }
    for (std::uint32_t i = 0; i < n; ++i)
        for (std::uint32_t j = 0; j < m; ++j) {
            const std::uint32_t i1 = (i + 1) % n, j1 = (j + 1) % m;
            const std::uint32_t a = i * m + j, b = i1 * m + j, c = i1 * m + j1, d = i * m + j1;
            mesh.triangles.push_back({a, b, c});
            mesh.triangles.push_back({a, c, d});
        }
    return mesh;
}

inline void append(TriMesh& mesh, const TriMesh& other, bool inverted = false)
{
    const auto base = static_cast<std::uint32_t>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), other.vertices.begin(), other.vertices.end());
    for (const auto& [a, b, c] : other.triangles)
        mesh.triangles.push_back(inverted
                                     ? std::array<std::uint32_t, 3>{base + a, base + c, base + b}
                                     : std::array<std::uint32_t, 3>{base + a, base + b, base + c});
}

}  // namespace sekitei::meshes
