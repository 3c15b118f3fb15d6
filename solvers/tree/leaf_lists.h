#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/progress.h"
#include "grids/leaf_topology.h"

/// Which things matter in which leaf of a grid.
namespace sekitei::tree {

/// Things of leaf i, ascending: thing[begin[i]] to thing[begin[i + 1]).
struct LeafLists {
    TopologyPtr topology;
    std::vector<std::uint64_t> begin;
    std::vector<std::uint32_t> thing;

    std::span<const std::uint32_t> operator[](std::size_t leaf) const
    {
        return {thing.data() + begin[leaf], thing.data() + begin[leaf + 1]};
    }
};

/// What lies within `radius` of a line, in voxel units.
struct Extent {
    Vec3d from, to;
    double radius = 0;
};

/// Leaves that extents reach into.
/// @param bytes_a_leaf  that the caller will want for each
/// @param who           for messages
/// @throws LimitExceeded  the lists or the caller's grids would not fit into memory; estimated
///                        before they are allocated
/// @throws Cancelled
LeafLists leaf_lists(std::span<const Extent> extents, double bytes_a_leaf, const std::string& who,
                     const Progress& progress);

}  // namespace sekitei::tree
