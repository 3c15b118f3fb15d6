#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "grids/scene.h"

namespace sekitei {

/// The voxels that carry a surface's climate: centre solid (sdf < 0) with at least one 6-neighbour
/// where sdf >= 0.
///
/// Structure of arrays in the order of the index grid's leaves and offsets: the order is a function
/// of the geometry alone.
struct SurfaceCells {
    Transform transform;
    std::vector<Coord> voxel;
    std::vector<Vec3d> position;  ///< centres, world [m]
    std::vector<Vec3f> normal;    ///< normalised sdf gradient, outwards
    std::vector<float> sdf;       ///< at the centre [m], negative
    std::vector<float> area;      ///< dx^2 / max |n_k| [m^2], exact for planes
    IntGrid index;                ///< cell number at each surface voxel, background -1

    std::size_t size() const { return voxel.size(); }
    /// Where rays start: p - sdf n + dx / 4 n.
    Vec3d ray_origin(std::size_t cell) const;

    /// Cells in the 26-neighbourhood of each: neighbours [begin[i], begin[i + 1]), ascending.
    std::vector<std::uint32_t> neighbour_begin, neighbour;

    /// A grid that is active exactly on the cells.
    FloatGrid to_grid(const std::vector<float>& values) const;
    IntGrid to_grid(const std::vector<std::int32_t>& values) const;
    VectorGrid to_grid(const std::vector<Vec3f>& values) const;
    /// Values of a grid at the cells; `missing` where it is not active.
    std::vector<float> from_grid(const FloatGrid& grid, float missing) const;
    std::vector<std::int32_t> from_grid(const IntGrid& grid, std::int32_t missing) const;
};

/// @param surface  level set [m], negative inside
/// @throws InvalidInput  no surface cells; not a level set
SurfaceCells surface_cells(const FloatGrid& surface, const Progress& progress);

}  // namespace sekitei
