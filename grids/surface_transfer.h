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
    std::size_t sources = 0;  ///< how many there are
    /// Target i takes from source[begin[i] .. begin[i + 1]), ascending; the weights, none of them
    /// negative, sum to 1.
    std::vector<std::uint32_t> begin, source;
    std::vector<float> weight;

    std::size_t size() const { return begin.empty() ? 0 : begin.size() - 1; }
    std::size_t missing() const;  ///< targets without sources
    /// One value a target, `missing` where a target has no sources; a constant field stays as it
    /// is.
    /// @throws InvalidInput  not one value for each source
    std::vector<float> apply(std::span<const float> values, float missing) const;
};

/// From cells to sites: the mean of the cells whose surface points (p - sdf n) lie within 1.5
/// voxels and whose normals agree (n.n > 0), weighted by nearness and by that product, then shifted
/// so that fields linear along the surface come out exactly, as far as that needs no negative
/// weight. Where there is none, the nearest agreeing cell within 4 voxels.
/// @throws LimitExceeded  more than 2^32 weights
SurfaceTransfer cells_to_sites(const SurfaceCells& cells, const MeshSites& sites,
                               const Progress& progress);

/// From sites to cells: the mean by area over the pieces of sites whose nearest agreeing cell,
/// within 1.5 voxels, is this one. Where there is none, what the nearest agreeing cell within 4
/// voxels has.
///
/// Pieces are no longer than a voxel, so that sum(value area) over cells is that over sites within
/// a few per cent, whatever the ratio of their sizes.
/// @throws LimitExceeded  more than 2^32 weights
SurfaceTransfer sites_to_cells(const MeshSites& sites, const SurfaceCells& cells,
                               const Progress& progress);

/// A grid between its voxels' centres (trilinear) at points [m]; inactive voxels count with the
/// value they hold.
std::vector<float> sample_grid(const FloatGrid& grid, std::span<const Vec3f> points);

}  // namespace sekitei
