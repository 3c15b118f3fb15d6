#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/progress.h"
#include "grids/leaf_grid.h"

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
    /// At the centre [m], from -dx to 0: with air beside it a cell cannot lie deeper, whatever a
    /// level set says where it is no distance (slabs of one voxel).
    std::vector<float> sdf;
    std::vector<float> area;  ///< dx^2 / max |n_k| [m^2], exact for planes
    IntGrid index;            ///< cell number at each surface voxel, background -1

    std::size_t size() const { return voxel.size(); }
    /// Where rays start: p - sdf n + dx / 4 n.
    Vec3d ray_origin(std::size_t cell) const;

    /// Cells in the 26-neighbourhood of each: neighbours [begin[i], begin[i + 1]), ascending.
    std::vector<std::uint32_t> neighbour_begin, neighbour;

    /// A grid that is active exactly on the cells; background 0.
    /// @throws InvalidInput  another number of values than cells
    FloatGrid to_grid(const std::vector<float>& values) const;
    IntGrid to_grid(const std::vector<std::int32_t>& values) const;
    VectorGrid to_grid(const std::vector<Vec3f>& values) const;
    /// Values of a grid at the cells; `missing` where it is not active.
    /// @throws InvalidInput  a grid on another lattice
    std::vector<float> from_grid(const FloatGrid& grid, float missing) const;
    std::vector<std::int32_t> from_grid(const IntGrid& grid, std::int32_t missing) const;
};

/// Finds the cells of a surface; parallel over leaves.
///
/// A body that is cut by the box it was computed in (a cliff) ends there only in name: it goes on.
/// With `box`, voxels outside it are not cells and a neighbour outside it exposes nothing, so that
/// cuts, a cut underside included, carry no climate. Within two voxels of a cut that closes the
/// level set, depth and normal come from the air side, which the cut does not disturb.
///
/// @param surface  level set [m], negative inside
/// @param box      on the lattice of `surface`
/// @throws InvalidInput  no_surface_cells; not a level set; a box on another lattice
SurfaceCells surface_cells(const FloatGrid& surface, const Progress& progress,
                           const std::optional<Domain>& box = {});

/// The cells that an earlier search left in a scene as grids: active voxels of `area`.
/// @throws InvalidInput  no cells, other lattices, an area or a normal that is none
SurfaceCells surface_cells(const FloatGrid& surface, const VectorGrid& normal,
                           const FloatGrid& area, const Progress& progress);

}  // namespace sekitei
