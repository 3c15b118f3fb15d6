#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "solvers/tree/grove.h"

/// Branches as chains: what is one limb to the eye.
namespace sekitei::tree {

/// A parent and its thickest child (the first of equals) go on as one chain. Chains in the order of
/// their first branches; branches of chain c: branch[begin[c]] to branch[begin[c + 1]).
struct Chains {
    static constexpr std::uint32_t kNone = 0xFFFFFFFFu;
    std::vector<std::uint32_t> begin, branch;
    std::vector<std::uint32_t> next;  ///< of each branch, in its chain; kNone at the end

    std::size_t size() const { return begin.size() - 1; }
    std::span<const std::uint32_t> operator[](std::size_t c) const
    {
        return {branch.data() + begin[c], branch.data() + begin[c + 1]};
    }
};

/// @param radius  of each branch [m]
/// @throws InvalidInput      another number of radii; parents that do not come first; places,
///                           lengths or radii that are not finite or not above 0
/// @throws InvalidParameter  unit_length
Chains chains_of(const Branches& branches, std::span<const double> radius, double unit_length);

/// Radius where a branch ends [m]: the geometric mean of its own and that of its chain's next one,
/// so that limbs are as thick as their branches in the middle of each, and forks are wider than
/// either arm. Tips run out to half.
double end_radius(const Branches& branches, std::span<const double> radius, const Chains& chains,
                  std::size_t branch);

}  // namespace sekitei::tree
