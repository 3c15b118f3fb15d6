#pragma once

#include <functional>
#include <optional>

#include "core/params.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "solvers/forest/forest.h"

/// What moss, wind and other trees feel of a forest: its leaves as fog.
///
/// Voxels are cubes of one pixel, 1 m. Slice k, which covers k - 1 to k metres above the ground, is
/// index z = k over flat ground at 0: the grid's origin lies one voxel below the ground, so that a
/// tree of 20 m ends 20 m above it. On terrain each column of voxels is shifted by whole voxels to
/// its pixel's ground, which keeps the leaf area.
namespace sekitei::forest {

struct CanopyParams {
    double extinction = 0.5, drag = 0.2;
    std::optional<Vec3d> sun;
    bool occupancy = true;

    static void describe(auto&& field)
    {
        field("extinction", &CanopyParams::extinction, "", between(0, 10),
              "share of a leaf area that is its shadow");
        field("drag", &CanopyParams::drag, "", between(0, 10),
              "drag coefficient of leaves: canopy_RU over canopy_lad");
        field("sun", &CanopyParams::sun, "", kAny,
              "x,y,z towards the sun, along which transmittance is worked out; auto: upwards");
        field("occupancy", &CanopyParams::occupancy, "the grids forest_occupancy, forest_density");
    }
};
/// @throws InvalidParameter  also where the sun is less than 3 degrees high
void validate(const CanopyParams& params);

struct Canopy {
    FloatGrid leaf_area_density;     ///< `canopy_lad` [m^2/m^3], in voxels that trees own
    FloatGrid drag;                  ///< `canopy_RU`, Cd times that [1/m]
    FloatGrid transmittance;         ///< `canopy_transmittance`, 1 outside
    FloatGrid height;                ///< `canopy_height`, 2-D [m]
    FloatGrid ground_transmittance;  ///< 2-D, at the ground; 1 outside
    FloatGrid terrain;               ///< `terrain_height`, 2-D, world z [m]; empty where flat
    IntGrid owner;                   ///< `forest_occupancy`, rank from 1; 0 nobody
    FloatGrid density;               ///< `forest_density`, index z = band
    double leaf_area = 0;            ///< of all trees [m^2]
};

/// The leaves of a forest by the space that its trees keep now.
///
/// A slice k of a tree is crown where k >= crown_base H. The tree's leaf area, LAI pi (t H)^2, over
/// the crown voxels of its own cone within the domain is the leaf area density of those it owns.
/// Transmittance is exp(-extinction integral LAD dl) from a voxel's centre upwards (or towards the
/// sun), ground_transmittance that from the ground at a pixel's centre. Terrain casts no shadow;
/// with Border::Wrap the canopy goes on beyond the border.
///
/// 2-D grids have one layer, index z = 0, that begins at the forest's corner. `height` is the
/// height above its foot of the tree that owns the uppermost slice of a pixel. `density` holds
/// bands, which are cubes there; 1 outside.
/// @param corner    world position of the domain's corner (0, 0, 0) [m]
/// @param leafless  trees that keep their space, but whose leaves are left out; may be empty
/// @throws InvalidParameter  pixels that are not 1 m, params
/// @throws Cancelled
///
/// Bit-identical for any size of tiles and any number of threads.
Canopy canopy(const Forest& forest, const CanopyParams& params, Vec3d corner = {},
              const std::function<bool(const Tree&)>& leafless = {}, const Progress& progress = {});

/// Light from above through leaves that lie in the voxels of a forest.
struct Shade {
    FloatGrid transmittance;         ///< as Canopy::transmittance
    FloatGrid ground_transmittance;  ///< as Canopy::ground_transmittance
};
/// @param ground  whole voxels by which pixel (i, j) is shifted; asked outside the domain too where
///                leaves are there
Shade shade_of(const FloatGrid& leaf_area_density, const std::function<int(int i, int j)>& ground,
               double extinction);

/// Leaf area densities of both, on the voxels of the first: each voxel of `more` is shared out by
/// the volume that it has in each of them, so that no leaf area is lost.
FloatGrid with_leaves(const FloatGrid& leaf_area_density, const FloatGrid& more);

/// Bytes of all that canopy() makes, at the most.
double canopy_memory(const Inputs& inputs, const CanopyParams& params);

}  // namespace sekitei::forest
