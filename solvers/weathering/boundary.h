#pragma once

#include <vector>

#include "solvers/weathering/pieces.h"

/// Where rock ends: the anti-aliased density and the class of the surface.
namespace sekitei::weathering {

struct BoundaryResult {
    FloatGrid density;
    IntGrid surface;
    double removed_voxels = 0, lava_voxels = 0;
    double leaves_touched_share = 0;
};

/// @param component  of component_grid(), for the same pieces
/// @param terrain    null unless the cuts are horizontal
BoundaryResult find_boundary(const Inputs& inputs, const Params& params, const IntGrid& component,
                             const Pieces& pieces, const PolylineIndex& index,
                             const std::vector<double>& arcs, const Terrain* terrain,
                             const Progress& progress);

}  // namespace sekitei::weathering
