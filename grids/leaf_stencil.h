#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/progress.h"
#include "grids/leaf_grid.h"

/// Stencils over the leaf pool: masks of neighbours, the 7-point heat step and the Sobel gradient.
namespace sekitei {

/// For each leaf, bit v of the result is bit v + sign * axis of `masks`; 0 where there is no leaf.
/// @param axis  0 = x, 1 = y, 2 = z
/// @param sign  1 or -1
std::vector<LeafMask> shifted_masks(const LeafTopology& topology,
                                    const std::vector<LeafMask>& masks, int axis, int sign);

/// The voxels of `masks` and their 26 neighbours, as far as the topology has leaves for them.
std::vector<LeafMask> dilated_masks(const LeafTopology& topology,
                                    const std::vector<LeafMask>& masks);

/// Offsets of the leaf at `origin` that lie inside the domain.
LeafMask domain_mask(const Domain& domain, Coord origin);

/// A body that exchanges heat with air instead of touching voxels of a held temperature.
struct Convection {
    struct Voxel {
        std::uint32_t leaf;
        std::uint16_t offset;
        std::uint16_t faces;  ///< how many of its six faces the air touches
    };
    std::vector<Voxel> voxels;  ///< free ones, by leaf and offset
    double air_temperature = 0;
    double conductance = 1;  ///< of one such face; a face between two voxels has 1
};

/// dT/dt = laplacian(T) on voxels: what changes, what is held, what lies around.
///
/// One step is T' = T + alpha (sum of the six face neighbours - 6 T) [Ito2004, eq. 2] in free
/// voxels; the others keep their value. Outside the domain a neighbour has the voxel's own value
/// (no flux); inside it but outside all leaves it has the background value.
struct HeatProblem {
    Domain domain;
    LeafGrid<double> temperature;  ///< at the start; masks are not used
    std::vector<LeafMask>
        free;          ///< for each leaf of `temperature`; voxels outside the domain are held
    double alpha = 0;  ///< mesh Fourier number kappa dt / h^2
    Convection convection;
};

/// Explicit steps of one HeatProblem. Bit-identical for any number of threads.
class HeatSolver {
public:
    virtual ~HeatSolver() = default;

    /// Takes `count` steps. When it throws, the state is that of the last completed step.
    /// @throws Cancelled
    virtual void advance(int count, const Progress& progress) = 0;

    /// Takes one step; returns the largest change of a voxel.
    virtual double step(const Progress& progress) = 0;

    /// Steps taken since construction.
    virtual int steps() const = 0;

    /// Values of the free voxels by leaf and offset, and back: all that a continuation needs.
    virtual std::vector<double> free_values() const = 0;
    virtual void set_free_values(const std::vector<double>& values) = 0;
};

/// One array over the whole box: for small ones.
std::unique_ptr<HeatSolver> dense_heat_solver(const HeatProblem& problem);

/// Only leaves that hold a free voxel, in two pools of doubles. Leaves whose surroundings are still
/// exactly uniform are passed over. Gives the same bits as the dense one.
std::unique_ptr<HeatSolver> sparse_heat_solver(const HeatProblem& problem);

/// The problem's temperature with other values in its free voxels.
LeafGrid<double> with_free_values(const HeatProblem& problem, const std::vector<double>& values);

/// 3-D Sobel gradient of T on the active voxels of `where`, zero on its other voxels
/// [units per voxel edge]: [-1 0 1] along the axis, [1 2 1] along the others, / 32; exact for
/// linear fields. Outside `domain` the nearest voxel inside.
/// @return a grid with the topology, masks and transform of `where`
LeafGrid<Vec3d> sobel_gradient(const LeafGrid<double>& temperature,
                               const LeafGrid<std::int32_t>& where, const Domain& domain);

}  // namespace sekitei
