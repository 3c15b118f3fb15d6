#pragma once

#include <cmath>
#include <string_view>
#include <vector>

#include "core/mesh_sites.h"
#include "solvers/moss/colony.h"
#include "solvers/moss/flight.h"
#include "solvers/moss/individuals.h"
#include "tests/support/shapes.h"

/// Meshes to live on.
namespace sekitei::moss {

/// A mesh, its sites and how seeds land on them.
struct Land {
    MeshSites sites;
    MeshSurface surface;

    explicit Land(const TriMesh& mesh, double edge = 0.02)
        : sites(mesh_sites(mesh, edge, {})), surface(sites)
    {
    }
};

/// Two triangles that look up.
inline TriMesh floor_mesh(double width, double depth, double z = 0.7)
{
    TriMesh mesh;
    for (const auto& [x, y] : {std::pair{0.0, 0.0}, {width, 0.0}, {width, depth}, {0.0, depth}})
        mesh.vertices.emplace_back(Vec3d(x, y, z));
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    return mesh;
}

/// A closed ball of stone with bumps.
inline TriMesh boulder(double radius, int levels)
{
    TriMesh mesh = shapes::ball({}, 1, levels);
    for (Vec3f& v : mesh.vertices) {
        const Vec3d p(v);
        const double bump =
            0.15 * std::sin(5 * p.x + 1) * std::cos(4 * p.y) + 0.1 * std::sin(7 * p.z);
        v = Vec3f(p * (radius * (1 + bump)) + Vec3d(1.5, -2, 0.3));
    }
    return mesh;
}

/// Stands a plant somewhere.
inline void plant(Colony& colony, Vec3d foot, double growth, Vec3d normal = {0, 0, 1},
                  std::uint8_t species = 0, std::uint32_t site = 0)
{
    append(colony.plants, {.foot = Vec3f(foot), .normal = Vec3f(normal), .site = site}, species,
           colony.next_id++, colony.day);
    colony.plants.growth.push_back(static_cast<float>(growth));
    colony.plants.growth_max.push_back(static_cast<float>(growth));
    colony.plants.born.push_back(colony.day);
}

/// Lays a seed somewhere.
inline void sow(Colony& colony, Vec3d foot, Seed kind, std::uint8_t species = 0)
{
    append(colony.seeds, {.foot = Vec3f(foot), .normal = {0, 0, 1}}, species, colony.next_id++,
           colony.day);
    colony.seeds.kind.push_back(kind == Seed::Gemma ? kGemma : kSpore);
}

inline Species species_called(std::string_view name)
{
    for (const Species& s : preset_species())
        if (s.name == name) return s;
    throw std::out_of_range("no such species");
}

/// Feet of R rings of hexagons around a point of the plane z.
inline std::vector<Vec3d> hexagon(int rings, double spacing, Vec3d middle)
{
    std::vector<Vec3d> feet;
    for (int a = -rings; a <= rings; ++a)
        for (int b = -rings; b <= rings; ++b)
            if (std::abs(a + b) <= rings)
                feet.push_back(middle + Vec3d(a + b * 0.5, b * std::sqrt(0.75), 0) * spacing);
    return feet;
}

}  // namespace sekitei::moss
