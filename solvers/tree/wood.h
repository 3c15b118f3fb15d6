#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "solvers/tree/grove.h"

/// From branches to wood and leaves. All in metres.
namespace sekitei::tree {

/// Pipe model: a = r^e is tip_radius^e at tips, else the sum over the children plus what dead tips
/// left, pipe_memory tip_radius^e each [Shinozaki1964].
/// Dead wood adds nothing to what lives and bears it (what its tips left is counted already), and
/// is at most as thick as that.
/// @return r of each branch [m]; never less than that of what it bears
/// @throws InvalidInput  a tree or species that does not exist, a parent that does not come first
std::vector<double> thickness(const Branches& branches, std::span<const Species> species,
                              std::span<const Plant> plants);
/// The same on a bare graph, for tests and others: parents before children.
std::vector<double> thickness(std::span<const std::int32_t> parent,
                              std::span<const std::int32_t> dead_tips, double tip_radius,
                              double exponent, double memory);

struct BarkParams {
    double edge = 0.02;  ///< aimed-at length of edges around a branch [m]
    int least_sides = 4, most_sides = 32;
};
/// Tubes of bark: one closed, outward, 2-manifold generalised cylinder for each chain of branches
/// (a parent and its thickest child go on as one), its rings at planes that halve the bends, turned
/// without twist along it; the bends of thick limbs are rounded between the joints. Where branches
/// join, a limb has the geometric mean of their radii; tips run out to half. Rings have as many
/// corners as their radius asks for, and may have fewer than the ring below. Side limbs begin on
/// their parent's axis, within it, with a flare; ends are capped. Sharp bends are pinched rather
/// than folded; kinks shorter than 0.7 radii are left out.
///
/// Vertex attributes `normal` (Vec3f), `radius` [m]; face attributes `branch_id` (index), `tree`,
/// and `uv_0`, `uv_1`, `uv_2` (Vec3f: metres around, metres along, 0) of the three corners, with
/// the seam at half a turn from 0: OBJ and PLY take them as texture coordinates (core/mesh_io.h).
/// @param radius  of each branch [m], as of thickness()
/// @throws InvalidInput      another number of radii, what is not finite or not above 0
/// @throws InvalidParameter  params, unit_length
///
/// Bit-identical for any number of threads. No branches: no triangles.
TriMesh bark_tubes(const Branches& branches, std::span<const double> radius, double unit_length,
                   const BarkParams& params, const Progress& progress);

/// Level set of the wood: tapered capsules with the radii of bark_tubes(), a limb's joined by the
/// minimum, those of limbs that meet by a smooth one, 0.7 radii of the thinner limb wide. Band of
/// kBandVoxels, negative inside [m]; voxels count from (0, 0, 0) on, from a place at a multiple of
/// 8 voxels.
///
/// Branches thinner than a voxel are left out, but for trees' first ones: as thick as voxels
/// they would make a crown of their own. The others have at least half a voxel's diagonal
/// for a radius, so that what is left of a tree hangs together once it is meshed.
/// @param voxel  [m]
/// @throws InvalidInput, InvalidParameter  as bark_tubes()
/// @throws LimitExceeded  estimated before anything is allocated
///
/// Bit-identical for any number of threads.
FloatGrid wood_level_set(const Branches& branches, std::span<const double> radius,
                         double unit_length, double voxel, const Progress& progress);

/// Leaf area of a ball, pi r^2 (-ln tau) / G: Beer's law over the mean chord 4r/3 gives tau [m^2].
/// @throws InvalidParameter  transmission 0: opaque balls have no number of leaves
double leaf_area(double radius, double transmission, double projection);

/// Area of a leaf by its length squared: an ellipse half as wide as long.
inline constexpr double kLeafShape = 0.39269908169872414;

struct Leaves {
    std::vector<Vec3d> position;  ///< [m]
    std::vector<Vec3f> normal;    ///< unit
    std::vector<std::array<float, 4>>
        orient;                 ///< quaternion x y z w: +y along the leaf, +z its normal
    std::vector<float> pscale;  ///< half the edge of a square of its area [m]
    std::vector<float> area;    ///< [m^2]
    std::vector<std::int32_t> ball, species, tree;
};
/// Leaves of all balls (Grove::foliage()): as many of leaf_size as come nearest to leaf_area(), and
/// so large that they add up to it. Spread evenly in the ball; normals any, or about light_vector
/// with de Wit's planophile density; both of them keyed by the branch.
/// @throws InvalidParameter  transmission 0
/// @throws LimitExceeded     estimated before anything is allocated
///
/// Bit-identical for any number of threads.
Leaves leaves(const Grove& grove, std::uint64_t seed);

struct Canopy {
    FloatGrid leaf_area_density;  ///< `canopy_lad` [m^2/m^3]; its integral is the leaf area
    FloatGrid drag;               ///< `canopy_RU`, Cd times that [1/m]
    FloatGrid light;              ///< `tree_light`, L of the brightest ball over a voxel
};
/// Leaves as fog: each ball's area spread evenly over the voxels it covers, those at its rim in
/// part; the integral is exact up to rounding. Voxels as of wood_level_set().
/// @param voxel  [m]; balls smaller than one go into one to four
/// @throws InvalidParameter  voxel, transmission 0
/// @throws LimitExceeded     estimated before anything is allocated
///
/// Bit-identical for any number of threads.
Canopy canopy(const Grove& grove, double voxel, const Progress& progress);

/// Cd of canopies, drag by leaf area density.
inline constexpr double kCanopyDrag = 0.2;

}  // namespace sekitei::tree
