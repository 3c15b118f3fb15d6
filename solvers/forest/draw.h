#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "solvers/forest/forest.h"

/// Cones drawn into columns of slices. Not for use outside solvers/forest.
namespace sekitei::forest {

/// A tree that reaches into a tile, or its image across a border that wraps.
struct Claim {
    double height = 0, x = 0, y = 0;  ///< [m]
    int trunk_i = 0, trunk_j = 0;     ///< pixel of the trunk
    const Tree* tree = nullptr;
};

/// What a claim got within a tile.
struct Gain {
    std::uint64_t kept = 0;  ///< of its space, weighted by the density, in 1 / 65535
    std::uint32_t cone = 0;  ///< pixels of its space
};

/// What drawing needs to know of the forest.
struct Canvas {
    const Params& params;
    const Land& land;
    const std::vector<DensityMap>& density;
    const std::vector<double>& slope;        ///< r / z by species
    std::vector<std::vector<double>> reach;  ///< (k slope)^2 by species and slice
    int nx = 0, ny = 0;

    Canvas(const Params& params, const Land& land, const std::vector<DensityMap>& density,
           const std::vector<double>& slope, int nx, int ny);
    /// Largest distance from the trunk at which a tree can own a pixel's centre [m].
    double radius(const Tree& tree) const;
    /// Highest slice of a tree on its own ground.
    int top(double height) const;
};

/// Draws claims, the biggest first, into the pixels [i0, i1) x [j0, j1): gains[c] of claims[c].
/// @param bounds  i0, i1, j0, j1
void draw_columns(const Canvas& canvas, const std::array<int, 4>& bounds,
                  const std::vector<Claim>& claims, std::vector<Gain>& gains);
/// The same order; calls f with what each keeps.
void visit_columns(const Canvas& canvas, const std::array<int, 4>& bounds,
                   const std::vector<Claim>& claims, const OwnedVisitor& f);

/// Rank (from 1, the place in `claims`, biggest first) that owns [slice][j][i], by drawing circles
/// from small to large; kBlocked where rock is.
inline constexpr std::uint32_t kBlocked = 0xFFFFFFFFu;
std::vector<std::uint32_t> paint(const Canvas& canvas, const std::vector<Claim>& claims);
/// Gains by counting what was painted.
/// @param ranked  trees in the order of their ranks; several claims of one tree may lie beside it
void count_painted(const Canvas& canvas, const std::vector<std::uint32_t>& image,
                   const std::vector<Claim>& claims, std::vector<Gain>& gains);

}  // namespace sekitei::forest
