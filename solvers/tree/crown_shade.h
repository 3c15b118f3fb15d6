#pragma once

#include <memory>

#include "core/progress.h"
#include "solvers/tree/crown_light.h"

namespace sekitei::tree {

/// The shade of balls as extinction on a sparse grid, for a million balls and more.
///
/// A ball stands for a cloud of extinction kappa = -ln tau / (4 r / 3), the value whose mean over
/// all chords is tau. Half-lines sum it up; what balls nearer than 2 r and the looker's own add is
/// taken out again by their chords, and those near ones count exactly.
class ExtinctionGrid {
public:
    /// @param transmission  tau, > 0
    /// @throws InvalidParameter  transmission = 0
    /// @throws LimitExceeded     the crowns need more than 4 GiB
    ExtinctionGrid(const SkyPatches& sky, const Balls& balls, double transmission,
                   Occlusion occlusion, const Progress& progress);
    ~ExtinctionGrid();
    ExtinctionGrid(const ExtinctionGrid&) = delete;
    ExtinctionGrid& operator=(const ExtinctionGrid&) = delete;

    /// Share of light that reaches a place from the middle of each patch.
    /// @param own    the ball that does not shade it, or Lookers::kNoBall
    /// @param shade  one for each patch
    void shade(Vec3d at, std::uint32_t own, std::span<double> share) const;

private:
    struct Cells;
    std::unique_ptr<Cells> cells_;
};

}  // namespace sekitei::tree
