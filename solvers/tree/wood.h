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
/// @return r of each branch [m]; dead wood counts like living
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
/// (a parent and its thickest child go on as one), rings turned without twist along it; ends are
/// capped, and side chains begin inside their parent. Vertex attributes `uv` (Vec3f: metres around,
/// metres along, 0), `radius`; face attributes `branch` (index), `tree`.
TriMesh bark_tubes(const Branches& branches, std::span<const double> radius, double unit_length,
                   const BarkParams& params, const Progress& progress);

/// Level set of the wood: union of tapered capsules, joined by a smooth minimum; 3-voxel band at
/// least, negative inside [m].
/// @throws LimitExceeded  estimated before anything is allocated
FloatGrid wood_level_set(const Branches& branches, std::span<const double> radius,
                         double unit_length, double voxel, const Progress& progress);

/// Leaf area of a ball, pi r^2 (-ln tau) / G: Beer's law over the mean chord 4r/3 gives tau [m^2].
double leaf_area(double radius, double transmission, double projection);

struct Leaves {
    std::vector<Vec3d> position;  ///< [m]
    std::vector<Vec3f> normal;    ///< unit
    std::vector<std::array<float, 4>>
        orient;                 ///< quaternion x y z w: +y along the leaf, +z its normal
    std::vector<float> pscale;  ///< half the edge of a square of its area [m]
    std::vector<float> area;    ///< [m^2]
    std::vector<std::int32_t> ball, species, tree;
};
/// Leaves of all living tips' balls: so many of leaf_size that areas add up, stratified in the
/// ball.
Leaves leaves(const Grove& grove, std::uint64_t seed);

struct Canopy {
    FloatGrid leaf_area_density;  ///< `canopy_lad` [m^2/m^3]; its integral is the leaf area
    FloatGrid drag;               ///< `canopy_RU`, Cd times that [1/m]
    FloatGrid light;              ///< `tree_light`, L of the brightest ball over a voxel
};
/// @param voxel  [m]
Canopy canopy(const Grove& grove, double voxel, const Progress& progress);

/// Cd of canopies, drag by leaf area density.
inline constexpr double kCanopyDrag = 0.2;

}  // namespace sekitei::tree
