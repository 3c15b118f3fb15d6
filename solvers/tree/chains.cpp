#include "solvers/tree/chains.h"

#include <fmt/format.h>

#include <cmath>

#include "core/error.h"

namespace sekitei::tree {

Chains chains_of(const Branches& branches, std::span<const double> radius, double unit_length)
{
    const std::size_t n = branches.size();
    if (!(unit_length > 0 && std::isfinite(unit_length)))
        throw InvalidParameter(
            fmt::format("tree: unit_length = {} m, must be > 0 and finite", unit_length));
    if (radius.size() != n)
        throw InvalidInput(
            fmt::format("tree: {} branches with {} radii, must be as many", n, radius.size()));
    for (const std::size_t other :
         {branches.parent.size(), branches.tree.size(), branches.flags.size(),
          branches.start.size(), branches.direction.size(), branches.length.size()})
        if (other != n)
            throw InvalidInput(
                fmt::format("tree: arrays of {} and {} branches, must be as many", n, other));
    for (std::size_t i = 0; i < n; ++i) {
        if (branches.parent[i] >= static_cast<std::int32_t>(i))
            throw InvalidInput(fmt::format(
                "tree: branch {} has the parent {}, must be one before it", i, branches.parent[i]));
        const Vec3d sum = branches.start[i] + branches.end(i);
        if (!(branches.length[i] > 0 && radius[i] > 0 &&
              std::isfinite(sum.x + sum.y + sum.z + branches.length[i] + radius[i])))
            throw InvalidInput(fmt::format(
                "tree: branch {} starts at ({}, {}, {}), has a length of {} and a radius of {} m; "
                "expected finite numbers, lengths and radii > 0",
                i, branches.start[i].x, branches.start[i].y, branches.start[i].z,
                branches.length[i], radius[i]));
    }
    Chains chains;
    chains.next.assign(n, Chains::kNone);
    for (std::size_t i = 0; i < n; ++i) {
        if (branches.parent[i] < 0) continue;
        std::uint32_t& next = chains.next[std::size_t(branches.parent[i])];
        if (next == Chains::kNone || radius[i] > radius[next]) next = static_cast<std::uint32_t>(i);
    }
    chains.branch.reserve(n);
    for (std::size_t i = 0; i < n; ++i) {
        const std::int32_t parent = branches.parent[i];
        if (parent >= 0 && chains.next[std::size_t(parent)] == i) continue;
        chains.begin.push_back(static_cast<std::uint32_t>(chains.branch.size()));
        for (auto k = static_cast<std::uint32_t>(i); k != Chains::kNone; k = chains.next[k])
            chains.branch.push_back(k);
    }
    chains.begin.push_back(static_cast<std::uint32_t>(chains.branch.size()));
    return chains;
}

double end_radius(const Branches& branches, std::span<const double> radius, const Chains& chains,
                  std::size_t branch)
{
    const std::uint32_t next = chains.next[branch];
    if (next != Chains::kNone) return std::sqrt(radius[branch] * radius[next]);
    return branches.is(branch, Branches::kTip) ? radius[branch] / 2 : radius[branch];
}

}  // namespace sekitei::tree
