#pragma once

#include "core/vec.h"

namespace sekitei {

/// Where a grid of cubes lies in the world.
///
/// "Voxel units" measure from the grid's origin in edges: voxel a spans [a, a+1) and its centre is
/// a + 0.5. In a VDB file this is scale(voxel) followed by translate(origin + voxel / 2), so that
/// the integer index is the centre.
struct Transform {
    Vec3d origin;      ///< world position of the lower corner of voxel (0, 0, 0) [m]
    double voxel = 1;  ///< edge [m]

    Vec3d world(Vec3d voxel_units) const { return origin + voxel_units * voxel; }
    Vec3d voxels(Vec3d world_position) const { return (world_position - origin) / voxel; }
    friend bool operator==(const Transform&, const Transform&) = default;
};

/// The centre of a voxel in voxel units.
constexpr Vec3d centre_of(Coord c)
{
    return {c.x + 0.5, c.y + 0.5, c.z + 0.5};
}

/// The box of voxels a scene is computed in: indices [0, dims).
struct Domain {
    Coord dims{0, 0, 0};
    Transform transform;

    bool contains(Coord c) const
    {
        return c.x >= 0 && c.y >= 0 && c.z >= 0 && c.x < dims.x && c.y < dims.y && c.z < dims.z;
    }
    double voxel_count() const { return double(dims.x) * double(dims.y) * double(dims.z); }
    friend bool operator==(const Domain&, const Domain&) = default;
};

}  // namespace sekitei
