#include "grids/leaf_topology.h"

#include <algorithm>
#include <bit>
#include <cstdint>

#ifdef __linux__
#include <sys/mman.h>
#endif

#include "core/parallel.h"
#include "core/random.h"

namespace sekitei {
namespace {

std::size_t bucket_of(Coord origin)
{
    const auto x = static_cast<std::uint64_t>(static_cast<std::uint32_t>(origin.x) >> 3);
    const auto y = static_cast<std::uint64_t>(static_cast<std::uint32_t>(origin.y) >> 3);
    const auto z = static_cast<std::uint64_t>(static_cast<std::uint32_t>(origin.z) >> 3);
    return static_cast<std::size_t>(mix64(x ^ (y << 21) ^ (z << 42)));
}

}  // namespace

TopologyPtr LeafTopology::build(std::vector<Coord> origins)
{
    auto topology = std::make_shared<LeafTopology>();
    std::sort(origins.begin(), origins.end());
    origins.erase(std::unique(origins.begin(), origins.end()), origins.end());
    topology->origins_ = std::move(origins);
    const auto& sorted = topology->origins_;
    topology->table_.assign(std::bit_ceil(2 * sorted.size() + 1), kNoLeaf);
    const std::size_t mask = topology->table_.size() - 1;
    for (std::size_t i = 0; i < sorted.size(); ++i) {
        std::size_t bucket = bucket_of(sorted[i]) & mask;
        while (topology->table_[bucket] != kNoLeaf) bucket = (bucket + 1) & mask;
        topology->table_[bucket] = static_cast<std::uint32_t>(i);
    }
    return topology;
}

std::uint32_t LeafTopology::find(Coord origin) const
{
    if (table_.empty()) return kNoLeaf;
    const std::size_t mask = table_.size() - 1;
    for (std::size_t bucket = bucket_of(origin) & mask;; bucket = (bucket + 1) & mask) {
        const std::uint32_t leaf = table_[bucket];
        if (leaf == kNoLeaf || origins_[leaf] == origin) return leaf;
    }
}

const std::vector<LeafTopology::Neighbours>& LeafTopology::neighbours() const
{
    std::call_once(neighbours_once_, [this] {
        neighbours_.resize(size());
        parallel_for(
            size(),
            [this](std::size_t i) {
                for (int dx = -1; dx <= 1; ++dx)
                    for (int dy = -1; dy <= 1; ++dy)
                        for (int dz = -1; dz <= 1; ++dz)
                            neighbours_[i][static_cast<std::size_t>(neighbour_index(dx, dy, dz))] =
                                find(origins_[i] + Coord(dx, dy, dz) * kLeafEdge);
            },
            256);
    });
    return neighbours_;
}

TopologyPtr LeafTopology::dilated(Coord lower, Coord upper) const
{
    std::vector<Coord> grown;
    grown.reserve(size() * 2);
    for (const Coord& o : origins_) {
        for (int dx = -8; dx <= 8; dx += 8)
            for (int dy = -8; dy <= 8; dy += 8)
                for (int dz = -8; dz <= 8; dz += 8) {
                    const Coord n = o + Coord(dx, dy, dz);
                    const bool centre = dx == 0 && dy == 0 && dz == 0;
                    const bool inside = n.x + 8 > lower.x && n.y + 8 > lower.y &&
                                        n.z + 8 > lower.z && n.x < upper.x && n.y < upper.y &&
                                        n.z < upper.z;
                    if (inside && (centre || find(n) == kNoLeaf)) grown.push_back(n);
                }
    }
    return build(std::move(grown));
}

TopologyPtr box_topology(Coord lower, Coord upper)
{
    std::vector<Coord> origins;
    const Coord first = leaf_origin(lower);
    for (int x = first.x; x < upper.x; x += 8)
        for (int y = first.y; y < upper.y; y += 8)
            for (int z = first.z; z < upper.z; z += 8) origins.push_back({x, y, z});
    return LeafTopology::build(std::move(origins));
}

void prefer_large_pages([[maybe_unused]] void* block, [[maybe_unused]] std::size_t bytes)
{
#ifdef MADV_HUGEPAGE
    constexpr std::uintptr_t kPage = std::uintptr_t(1) << 21;
    const auto address = reinterpret_cast<std::uintptr_t>(block);
    const auto begin = (address + kPage - 1) & ~(kPage - 1), end = (address + bytes) & ~(kPage - 1);
    // Small blocks stay as they are: half a page unused would be felt there.
    if (end > begin && end - begin >= 4 * kPage)
        madvise(static_cast<char*>(block) + (begin - address), end - begin, MADV_HUGEPAGE);
#endif
}

}  // namespace sekitei
