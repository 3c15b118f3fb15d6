#pragma once

#include <cstdint>
#include <vector>

#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "solvers/wind/tunnel.h"

/// A scene of voxels as a wind tunnel sees it.
namespace sekitei::wind {

/// A tunnel in the world: its +x is the way the air flows, its +z is up.
struct Heading {
    Vec3d origin;           ///< world position of the tunnel's (0, 0, 0)
    Vec3d along{1, 0, 0};   ///< unit vector of the tunnel's +x
    Vec3d across{0, 1, 0};  ///< of its +y

    /// Wind that blows from direction 0..7 = N NE E SE S SW W NW, round `axis`. Quarter turns are
    /// exact.
    static Heading from(int direction, Vec3d axis);
    Vec3d world(Vec3d p) const { return origin + along * p.x + across * p.y + Vec3d(0, 0, p.z); }
    Vec3d tunnel(Vec3d world_position) const
    {
        const Vec3d d = world_position - origin;
        return {dot(d, along), dot(d, across), d.z};
    }
};

/// What may stand in a tunnel; null where there is none.
struct TunnelContents {
    std::vector<const FloatGrid*> solids;  ///< level sets [m], negative inside
    const IntGrid* water = nullptr;  ///< active voxels; the upper face of the top one is the level
    const FloatGrid* canopy = nullptr;  ///< R_U [1/m]
};

/// Voxels as cubes of edge l0 that fill a tunnel.
///
/// A cube is solid if at least half of it is, by samples at the voxels' spacing (at most 8 an
/// edge), or if a wall thinner than l0 has its middle in it along at least half of the lines
/// through the cube along some axis: fences become one cube thick, and stay tight at any angle.
/// Posts thinner than half a cube vanish. Air below a water level is solid. Sideways and
/// downwards a level set that is cut off inside a solid goes on as its last voxels.
/// @param tunnel  lower, size and speed; what else it has is replaced
/// @throws Cancelled  from progress
WindTunnel fill_tunnel(const WindTunnel& tunnel, double l0, const Heading& heading,
                       const TunnelContents& contents, const Progress& progress);

/// Where a level set is known: its leaves' active and inner voxels [m]; empty if there are none.
Bounds known_bounds(const FloatGrid& level_set);

}  // namespace sekitei::wind
