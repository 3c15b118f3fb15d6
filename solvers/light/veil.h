#pragma once

#include "grids/leaf_grid.h"

namespace sekitei::light {

/// Leaves that let some light through: exp(-extinction integral LAD dl) along half-lines.
class Veil {
public:
    /// @param leaf_area_density  `canopy_lad` [1/m], the same all over a voxel, 0 outside; must
    ///                           outlive this
    /// @param extinction         share of a leaf area that is its shadow
    /// @throws InvalidInput      a density below 0 or not finite, or a background that is not 0
    /// @throws InvalidParameter  extinction < 0
    Veil(const FloatGrid& leaf_area_density, double extinction);

    /// Share of light that arrives at a place from a direction. Exact up to rounding; below 1e-9 it
    /// is 0. From any number of threads.
    /// @param direction  unit, towards where the light comes from
    double transmittance(Vec3d from, Vec3d direction) const;

private:
    const FloatGrid* grid_;
    double extinction_;
    Vec3d lower_, upper_;  ///< box of all leaves, in voxels
};

}  // namespace sekitei::light
