#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/mesh_sites.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "grids/surface_cells.h"

/// Fields between the two kinds of surface: voxels that carry it and faces of a mesh.
namespace sekitei {

/// Each target's value as a weighted mean over sources: found once, used for any number of fields.
struct SurfaceTransfer {
    /// Target i takes from source[begin[i] .. begin[i + 1]), ascending; the weights sum to 1.
    std::vector<std::uint32_t> begin, source;
    std::vector<float> weight;

    std::size_t size() const { return begin.empty() ? 0 : begin.size() - 1; }
    /// Targets without sources.
    std::size_t missing() const;
    /// One value a target; `missing` where a target has no sources.
    /// @throws InvalidInput  fewer values than the transfer names
    std::vector<float> apply(std::span<const float> values, float missing) const;
};

/// From cells to sites: the mean of the cells whose surface points lie within 1.5 voxels and whose
/// normals agree (n.n > 0), weighted by nearness and by that product, and corrected so that fields
/// linear along the surface come out exactly where that needs no negative weight. Else the nearest
/// agreeing cell within 4 voxels.
SurfaceTransfer cells_to_sites(const SurfaceCells& cells, const MeshSites& sites,
                               const Progress& progress);

/// From sites to cells: the mean over the pieces of sites that lie nearest to the cell, by area;
/// where no piece does, the nearest agreeing site within 4 voxels.
///
/// Sites are cut into pieces of half a voxel for this, so that sum(value area) of the cells is that
/// of the sites within a few per cent, whatever the ratio of their sizes.
SurfaceTransfer sites_to_cells(const MeshSites& sites, const SurfaceCells& cells,
                               const Progress& progress);

/// A grid between voxel centres (trilinear) at points [m]; inactive voxels count with the value
/// they hold.
std::vector<float> sample_grid(const FloatGrid& grid, std::span<const Vec3f> points);

}  // namespace sekitei
