#pragma once

#include <cstdint>

#include "core/mesh.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"

namespace sekitei {

/// Column and component of rock that belongs to no column: the slow part.
inline constexpr std::int32_t kMassiveRock = -2;

/// The grids that a rock's surface takes its attributes from, all on the lattice of `density`.
struct SurfaceGrids {
    const FloatGrid& density;
    double iso = 0.5;
    const IntGrid& column;
    const IntGrid& component;
    const IntGrid& surface;
    const FloatGrid* arc = nullptr;         ///< [m]
    const FloatGrid* weathering = nullptr;  ///< W
};

/// Gives each vertex and face of marching_tetrahedra(density, iso) the int32 attributes `column`,
/// `component` and `surface`, and the float attributes `arc` and `weathering` where those grids are
/// given, of the nearest voxel on the solid side (density >= iso) among the eight around it; on a
/// tie the voxel lower in x, then y, then z. Massive rock has column and component kMassiveRock.
/// Attributes of these names are replaced. Bit-identical for any number of threads.
void add_surface_attributes(TriMesh& mesh, const SurfaceGrids& grids, const Progress& progress);

}  // namespace sekitei
