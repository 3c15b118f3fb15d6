#pragma once

#include <memory>
#include <span>
#include <vector>

#include "core/progress.h"
#include "solvers/tree/crown_light.h"

namespace sekitei::tree {

/// The shade of balls as extinction on a sparse grid, for stands of a million balls and more.
///
/// A ball is a cloud of extinction kappa = -ln tau / (4 r / 3), which lets tau pass along its mean
/// chord. Half-lines sum it up; what the looker's own ball and those with |d| <= 2 r add is taken
/// out again along their chords, and the latter shade by the rule instead.
class ExtinctionGrid {
public:
    /// @param transmission  tau, > 0
    /// @throws LimitExceeded  the crowns need more than 4 GiB
    ExtinctionGrid(const SkyPatches& sky, const Balls& balls, double transmission,
                   Occlusion occlusion, const Progress& progress);
    ~ExtinctionGrid();
    ExtinctionGrid(const ExtinctionGrid&) = delete;
    ExtinctionGrid& operator=(const ExtinctionGrid&) = delete;

    /// Share of light that reaches a place from the middle of each patch. From any number of
    /// threads.
    /// @param own    the ball that does not shade it, or Lookers::kNoBall
    /// @param share  one for each patch
    void shade(Vec3d at, std::uint32_t own, std::span<double> share) const;

private:
    struct Bricks;
    struct Near;
    std::vector<std::unique_ptr<Bricks>>
        bricks_;  ///< each of voxels twice as wide; far ones coarse
    std::unique_ptr<Near> near_;
};

}  // namespace sekitei::tree
