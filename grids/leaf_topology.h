#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "core/vec.h"

/// Which 8^3 blocks ("leaves") of space a sparse grid covers, and which block is whose neighbour.
namespace sekitei {

inline constexpr int kLeafEdge = 8;
inline constexpr int kLeafSize = 512;
inline constexpr std::uint32_t kNoLeaf = 0xFFFFFFFFu;

/// The leaf that holds voxel c, named by its lowest voxel.
constexpr Coord leaf_origin(Coord c)
{
    return {c.x & ~7, c.y & ~7, c.z & ~7};
}
/// Index of voxel c within its leaf: z fastest, as in OpenVDB.
constexpr int leaf_offset(Coord c)
{
    return ((c.x & 7) << 6) | ((c.y & 7) << 3) | (c.z & 7);
}
/// The voxel at `offset` of the leaf at `origin`.
constexpr Coord leaf_coord(Coord origin, int offset)
{
    return {origin.x + (offset >> 6), origin.y + ((offset >> 3) & 7), origin.z + (offset & 7)};
}

/// Neighbour (dx, dy, dz) in {-1, 0, 1}^3 as an index 0..26; 13 is the leaf itself.
constexpr int neighbour_index(int dx, int dy, int dz)
{
    return (dx + 1) * 9 + (dy + 1) * 3 + dz + 1;
}

/// An immutable, sorted set of leaves, shared by all grids of one shape.
class LeafTopology {
public:
    using Neighbours = std::array<std::uint32_t, 27>;

    /// @param origins  in any order, repeats allowed; each a multiple of 8
    static std::shared_ptr<const LeafTopology> build(std::vector<Coord> origins);

    std::size_t size() const { return origins_.size(); }
    const std::vector<Coord>& origins() const { return origins_; }
    Coord origin(std::size_t leaf) const { return origins_[leaf]; }

    /// Index of the leaf at this origin, or kNoLeaf. O(1).
    std::uint32_t find(Coord origin) const;

    /// The 27 leaves around each leaf, kNoLeaf where there is none. Built on first use, 108 bytes a
    /// leaf.
    const std::vector<Neighbours>& neighbours() const;

    /// The topology grown by one leaf in all 26 directions, cut to leaves that meet [lower, upper).
    std::shared_ptr<const LeafTopology> dilated(Coord lower, Coord upper) const;

private:
    std::vector<Coord> origins_;        // sorted by x, y, z
    std::vector<std::uint32_t> table_;  // open addressing by hash of the origin
    mutable std::once_flag neighbours_once_;
    mutable std::vector<Neighbours> neighbours_;
};

using TopologyPtr = std::shared_ptr<const LeafTopology>;

/// All leaves that meet the voxels [lower, upper).
TopologyPtr box_topology(Coord lower, Coord upper);

/// Asks for large pages under a block, where the system has them: first touches cost a tenth. A
/// hint; whether it is followed changes nothing but time and the granularity of memory.
void prefer_large_pages(void* block, std::size_t bytes);

}  // namespace sekitei
