#pragma once

#include <array>
#include <string>
#include <vector>

#include "core/mesh_sites.h"
#include "tests/support/shapes.h"

namespace sekitei::roof {

/// Several bodies as one mesh.
inline TriMesh joined(const std::vector<TriMesh>& parts)
{
    TriMesh all;
    for (const TriMesh& part : parts) {
        const auto first = static_cast<std::uint32_t>(all.vertices.size());
        all.vertices.insert(all.vertices.end(), part.vertices.begin(), part.vertices.end());
        for (const auto& t : part.triangles)
            all.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
    }
    return all;
}

/// A floor of 2 x 2 m, a wall of 1.5 m on its north side and a roof over the northern half.
inline TriMesh mesh()
{
    return joined({shapes::box({0, -2, -0.3}, {2, 0, 0}), shapes::box({0, 0, 0}, {2, 0.1, 1.5}),
                   shapes::box({0, -1, 1.4}, {2, 0, 1.5})});
}

enum Zone { FrontFloor, BackFloor, Wall, Underside, RoofTop, Elsewhere };
inline constexpr std::array<const char*, 5> kZoneNames{"front floor", "back floor", "wall",
                                                       "underside", "roof top"};
inline constexpr std::array<double, 5> kZoneArea{2, 2, 2.8, 2, 2};  // [m^2]

inline Zone zone_of(Vec3f p, Vec3f n)
{
    if (n.z > 0.5f && std::abs(p.z) < 1e-4f) return p.y < -1 ? FrontFloor : BackFloor;
    if (n.y < -0.5f && std::abs(p.y) < 1e-4f && p.z > 0 && p.z < 1.4f) return Wall;
    if (n.z < -0.5f && std::abs(p.z - 1.4f) < 1e-4f) return Underside;
    if (n.z > 0.5f && std::abs(p.z - 1.5f) < 1e-4f && p.y < 0) return RoofTop;
    return Elsewhere;
}

struct Scene {
    MeshSites sites;
    std::vector<Zone> zone;

    explicit Scene(double longest_edge) : sites(mesh_sites(mesh(), longest_edge, {}))
    {
        for (std::size_t i = 0; i < sites.size(); ++i)
            zone.push_back(zone_of(sites.position[i], sites.normal[i]));
    }
    std::vector<float> albedo(float value) const { return std::vector<float>(sites.size(), value); }
    /// Means of values at sites, by area.
    std::array<double, 5> means(const std::vector<float>& values) const
    {
        std::array<double, 6> sum{}, area{};
        for (std::size_t i = 0; i < values.size(); ++i) {
            sum[zone[i]] += static_cast<double>(values[i]) * sites.area[i];
            area[zone[i]] += sites.area[i];
        }
        std::array<double, 5> mean{};
        for (std::size_t z = 0; z < 5; ++z) mean[z] = sum[z] / area[z];
        return mean;
    }
};

}  // namespace sekitei::roof
