#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "apps/render/tufts.h"
#include "core/math.h"
#include "core/mesh.h"
#include "core/random.h"

/// Moss to draw, and level ground under it.
namespace sekitei::render::testing {

inline const std::vector<std::string> kSpecies{"bryum", "hypnum", "polytrichum", "grimmia"};

/// A level square of edge 2 `half` around the z axis.
inline TriMesh plane(float half, float z)
{
    TriMesh mesh;
    mesh.vertices = {{-half, -half, z}, {half, -half, z}, {half, half, z}, {-half, half, z}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    return mesh;
}

/// Turns +y to +z, then about z.
inline std::array<float, 4> upright(double yaw)
{
    const double s = math::sin(yaw / 2), c = math::cos(yaw / 2), h = std::sqrt(0.5);
    return {static_cast<float>(h * c), static_cast<float>(h * s), static_cast<float>(h * s),
            static_cast<float>(h * c)};
}

/// Plants of all species on 0.3 x 0.2 m at z = 0.7.
inline std::vector<Tuft> scattered(int count)
{
    std::vector<Tuft> tufts;
    constexpr Stream kWhere{"test.where"};
    for (int i = 0; i < count; ++i) {
        const auto k = static_cast<std::uint64_t>(i);
        tufts.push_back(
            {Vec3d(0.3 * uniform01(1, kWhere, k, 0), 0.2 * uniform01(1, kWhere, k, 1), 0.7),
             upright(6.28 * uniform01(1, kWhere, k, 2)),
             static_cast<float>(0.4 + 0.6 * uniform01(1, kWhere, k, 3)), 1 + i % 4});
    }
    return tufts;
}

}  // namespace sekitei::render::testing
