#include "solvers/tree/leaf_lists.h"

#include <fmt/format.h>

#include <cmath>

#include "core/error.h"
#include "core/machine.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::tree {
namespace {

constexpr double kLargest = 1e9;  // [voxels]

double distance_to_segment(Vec3d p, Vec3d a, Vec3d b)
{
    const Vec3d ab = b - a;
    const double all = dot(ab, ab);
    const double t = all > 0 ? std::clamp(dot(p - a, ab) / all, 0.0, 1.0) : 0;
    return length(p - a - ab * t);
}

/// Calls f(origin) for the leaves that an extent reaches into, slab by slab along its longest axis.
template <class F>
void for_each_leaf(const Extent& extent, F&& f)
{
    const Vec3d a = extent.from, b = extent.to, d = b - a;
    const double r = extent.radius;
    const int k = std::abs(d.x) >= std::abs(d.y) && std::abs(d.x) >= std::abs(d.z) ? 0
                  : std::abs(d.y) >= std::abs(d.z)                                 ? 1
                                                                                   : 2;
    const int l = (k + 1) % 3, m = (k + 2) % 3;
    // Voxel v has its centre at v + 1/2; a leaf reaches from its first to its last centre.
    auto leaf = [](double x) { return static_cast<std::int32_t>(std::floor(x / kLeafEdge)); };
    const std::int32_t first = leaf(std::min(a[k], b[k]) - r - 0.5);
    const std::int32_t last = leaf(std::max(a[k], b[k]) + r + 0.5);
    for (std::int32_t i = first; i <= last; ++i) {
        double s0 = 0, s1 = 1;
        if (d[k] != 0) {
            s0 = (i * kLeafEdge - r - a[k]) / d[k];
            s1 = ((i + 1) * kLeafEdge + r - a[k]) / d[k];
            if (s0 > s1) std::swap(s0, s1);
            s0 = std::clamp(s0, 0.0, 1.0);
            s1 = std::clamp(s1, 0.0, 1.0);
        }
        const Vec3d p = a + d * s0, q = a + d * s1;
        const Coord low(0, leaf(std::min(p[l], q[l]) - r - 0.5),
                        leaf(std::min(p[m], q[m]) - r - 0.5));
        const Coord high(0, leaf(std::max(p[l], q[l]) + r + 0.5),
                         leaf(std::max(p[m], q[m]) + r + 0.5));
        for (std::int32_t y = low.y; y <= high.y; ++y)
            for (std::int32_t z = low.z; z <= high.z; ++z) {
                Coord origin;
                origin[k] = i * kLeafEdge;
                origin[l] = y * kLeafEdge;
                origin[m] = z * kLeafEdge;
                constexpr double kHalfDiagonal = 3.5 * 1.7320508075688772;
                const Vec3d centre = Vec3d(origin) + Vec3d(kLeafEdge / 2.0);
                if (distance_to_segment(centre, a, b) <= r + kHalfDiagonal) f(origin);
            }
    }
}

void check_memory(double bytes, const std::string& who)
{
    const double there = physical_memory();
    if (bytes > there)
        throw LimitExceeded(fmt::format("{}: needs {}, {} are there; use a larger voxel", who,
                                        bytes_text(bytes), bytes_text(there)));
}

}  // namespace

LeafLists leaf_lists(std::span<const Extent> extents, double bytes_a_leaf, const std::string& who,
                     const Progress& progress)
{
    // As many leaves as capsules would hold that are half a diagonal wider.
    double most = 0;
    for (const Extent& e : extents) {
        const double r = e.radius + 0.87 * kLeafEdge, size = length(e.to - e.from);
        const double far = std::max({std::abs(e.from.x), std::abs(e.from.y), std::abs(e.from.z),
                                     std::abs(e.to.x), std::abs(e.to.y), std::abs(e.to.z)}) +
                           e.radius;
        if (!(far < kLargest))
            throw LimitExceeded(fmt::format(
                "{}: reaches {:.3g} voxels far, must be less than 1e9; use a larger voxel", who,
                far));
        most += math::kPi * r * r * (size + 4.0 / 3 * r) / kLeafSize;
    }
    struct Pair {
        Coord leaf;
        std::uint32_t thing;
    };
    check_memory(most * sizeof(Pair) * 2, who);

    std::vector<std::uint64_t> counts(extents.size());
    parallel_for(
        extents.size(),
        [&](std::size_t i) {
            progress.check();
            for_each_leaf(extents[i], [&](Coord) { ++counts[i]; });
        },
        64);
    const auto first = prefix_sum(counts);
    check_memory(double(first.back()) * sizeof(Pair) * 2, who);
    std::vector<Pair> pairs(first.back());
    parallel_for(
        extents.size(),
        [&](std::size_t i) {
            std::uint64_t k = first[i];
            for_each_leaf(extents[i], [&](Coord origin) {
                pairs[k++] = {origin, static_cast<std::uint32_t>(i)};
            });
        },
        64);
    progress.update(0.3);

    LeafLists lists;
    std::vector<Coord> origins(pairs.size());
    for (std::size_t k = 0; k < pairs.size(); ++k) origins[k] = pairs[k].leaf;
    lists.topology = LeafTopology::build(std::move(origins));
    check_memory(double(lists.topology->size()) * bytes_a_leaf, who);

    // Into their leaves in order: pairs come by thing.
    std::vector<std::uint32_t> leaf(pairs.size());
    parallel_for(
        pairs.size(), [&](std::size_t k) { leaf[k] = lists.topology->find(pairs[k].leaf); }, 4096);
    lists.begin.assign(lists.topology->size() + 1, 0);
    for (const std::uint32_t l : leaf) ++lists.begin[l + 1];
    for (std::size_t l = 0; l + 1 < lists.begin.size(); ++l) lists.begin[l + 1] += lists.begin[l];
    lists.thing.resize(pairs.size());
    std::vector<std::uint64_t> next(lists.begin.begin(), lists.begin.end() - 1);
    for (std::size_t k = 0; k < pairs.size(); ++k) lists.thing[next[leaf[k]]++] = pairs[k].thing;
    progress.update(1);
    return lists;
}

}  // namespace sekitei::tree
