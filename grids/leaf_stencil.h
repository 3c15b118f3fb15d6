#pragma once

#include <cstdint>
#include <vector>

#include "core/progress.h"
#include "grids/leaf_grid.h"

/// Stencils over the leaf pool: the 7-point heat step and the Sobel gradient.
namespace sekitei {

/// Explicit heat steps on a sparse region: T' = T + c * (sum of six neighbours - 6 T), where the
/// coefficient c is alpha in free voxels and 0 in fixed ones. Voxels outside all leaves, and
/// outside `domain`, act as the voxel's own value (zero gradient) unless the leaf next door exists.
/// Two buffers; bit-identical for any number of threads.
class HeatPool {
public:
    /// @param free         mask of voxels that change; others of the same leaves are fixed
    /// @param temperature  initial values, all leaves dense or constant
    HeatPool(const Domain& domain, const LeafGrid<double>& temperature,
             const std::vector<LeafMask>& free, double alpha);
    ~HeatPool();

    /// Advances one step; returns the largest change.
    double step();
    LeafGrid<double> temperature() const;

private:
    struct State;
    std::unique_ptr<State> state_;
};

/// 3-D Sobel gradient of T on the active voxels of `where` [units per voxel edge]: [-1 0 1] along
/// the axis, [1 2 1] along the others, / 32; exact for linear fields. Outside `domain` the nearest
/// voxel inside.
LeafGrid<Vec3d> sobel_gradient(const LeafGrid<double>& temperature,
                               const LeafGrid<std::int32_t>& where, const Domain& domain);

}  // namespace sekitei
