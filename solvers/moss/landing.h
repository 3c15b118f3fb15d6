#pragma once

#include "grids/leaf_grid.h"
#include "grids/surface_cells.h"
#include "solvers/moss/population.h"

namespace sekitei::moss {

/// The cells as sites; views `cells`.
Surface surface_of(const SurfaceCells& cells);

/// Landing on the surface cells of a level set.
///
/// A seed no farther than `adhesion` from the surface sticks to the cell whose centre is nearest
/// (ties: the lower number); one deeper inside dies. Others fall voxel by voxel: the first voxel
/// with sdf < 0 that they enter from one with sdf >= 0 is a surface cell by definition, so no wall
/// of one voxel is passed. Where the way leaves all leaves, or the voxel is no cell, they are lost.
class CellLanding final : public Landing {
public:
    /// Both must outlive this.
    CellLanding(const FloatGrid& surface, const SurfaceCells& cells);
    double reach() const override;
    void land(std::span<const Flight> seeds, double adhesion,
              std::span<std::int32_t> site) const override;

private:
    std::int32_t land_one(const Flight& seed, double adhesion) const;
    double sample(Vec3d voxels) const;
    std::int32_t nearest(Vec3d at) const;
    std::int32_t cell(std::size_t leaf, int offset) const;
    std::int32_t drop(Coord from) const;
    std::int32_t drift(Vec3d from, Vec3d way) const;

    const FloatGrid* surface_;
    const SurfaceCells* cells_;
    Coord lower_, upper_;                    // of all leaves
    std::vector<LeafMask> solid_;            // sdf < 0, of each leaf
    std::vector<std::uint32_t> index_leaf_;  // of cells_->index at each leaf
};

}  // namespace sekitei::moss
