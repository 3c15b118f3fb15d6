#pragma once

#include <algorithm>
#include <cmath>

#include "grids/level_set.h"
#include "grids/marching_tetrahedra.h"
#include "grids/surface_cells.h"

/// The stone lantern of the habitat experiments [Ogasawara2003]: 1.5 m high, axis at the origin, on
/// the ground z = 0.
namespace sekitei::lantern {

inline double box(Vec3d p, Vec3d centre, Vec3d half)
{
    const Vec3d q = max(p - centre, centre - p) - half;
    const double out = length(max(q, Vec3d(0)));
    return out + std::min(0.0, std::max({q.x, q.y, q.z}));
}

/// A lower bound of the distance outside, exact at the surface [m].
inline double distance(Vec3d p)
{
    const double r = std::sqrt(p.x * p.x + p.y * p.y);
    double d = box(p, {0, 0, 0.075}, {0.25, 0.25, 0.075});
    d = std::min(d, std::max(r - 0.12, std::abs(p.z - 0.45) - 0.30));
    d = std::min(d, box(p, {0, 0, 0.80}, {0.22, 0.22, 0.05}));
    // Fire box with four windows.
    double fire = box(p, {0, 0, 0.99}, {0.16, 0.16, 0.14});
    fire = std::max(fire, -box(p, {0, 0, 0.99}, {0.5, 0.07, 0.07}));
    fire = std::max(fire, -box(p, {0, 0, 0.99}, {0.07, 0.5, 0.07}));
    d = std::min(d, fire);
    // Roof: a frustum from half width 0.36 to 0.08.
    const double run = 0.28, rise = 0.22, slope = std::sqrt(run * run + rise * rise);
    const double half = std::max(std::abs(p.x), std::abs(p.y));
    const double side = ((half - 0.36) * rise + (p.z - 1.13) * run) / slope;
    d = std::min(d, std::max(side, std::abs(p.z - 1.24) - 0.11));
    return std::min(d, length(p - Vec3d(0, 0, 1.425)) - 0.075);
}

inline Domain domain(double voxel)
{
    const double half = 0.36 + 4 * voxel;
    const int across = static_cast<int>(std::ceil(2 * half / voxel));
    const int up = static_cast<int>(std::ceil((1.5 + 4 * voxel) / voxel));
    return {{across, across, up}, {{-half, -half, 0}, voxel}};
}

inline FloatGrid level_set(double voxel)
{
    const Domain d = domain(voxel);
    return level_set_from_function(
        d,
        [&](Vec3d p) {
            const Vec3d q = d.transform.world(p);
            return distance({q.x, q.y, std::max(q.z, 0.5 * voxel)}) / voxel;
        },
        {}, {.steepness = 1, .is_distance = true});
}

/// A surface with its cells as sites for light.
struct Body {
    FloatGrid surface;
    SurfaceCells cells;
    TriMesh mesh;
    std::vector<Vec3d> origins;

    Body(FloatGrid grid, const Domain& box)
        : surface(std::move(grid)),
          cells(surface_cells(surface, {}, box)),
          mesh(marching_tetrahedra(surface, 0, {}))
    {
        for (std::size_t i = 0; i < cells.size(); ++i) origins.push_back(cells.ray_origin(i));
    }
    explicit Body(double voxel) : Body(level_set(voxel), domain(voxel)) {}
};

}  // namespace sekitei::lantern
