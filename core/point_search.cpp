#include "core/point_search.h"

#include <fmt/format.h>

#include <bit>

#include "core/error.h"
#include "core/parallel.h"

namespace sekitei {
namespace {

constexpr std::size_t kMostPoints = std::size_t{1} << 31;
constexpr std::uint32_t kLeafPoints = 8;

/// Where the points are; throws where one is not finite.
Bounds bounds_of(std::span<const Vec3f> points)
{
    if (points.size() >= kMostPoints)
        throw LimitExceeded(fmt::format("point search: {} points, must be fewer than {}",
                                        points.size(), kMostPoints));
    return parallel_fold(
        points.size(), 16384, Bounds{},
        [&](std::size_t begin, std::size_t end) {
            Bounds part;
            for (std::size_t i = begin; i < end; ++i) {
                const Vec3f p = points[i];
                if (!(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z)))
                    throw InvalidInput(
                        fmt::format("point search: point {} is ({}, {}, {}), must be finite", i,
                                    p.x, p.y, p.z));
                part.add(Vec3d(p));
            }
            return part;
        },
        [](Bounds a, const Bounds& b) {
            if (!b.empty()) {
                a.add(b.lower);
                a.add(b.upper);
            }
            return a;
        });
}

}  // namespace

KdTree::KdTree(std::span<const Vec3f> points)
{
    bounds_of(points);
    const auto n = static_cast<std::uint32_t>(points.size());
    points_.resize(n);
    parallel_for(
        n,
        [&](std::size_t i) {
            points_[i] = {points[i], static_cast<std::uint32_t>(i)};
        },
        16384);

    // As many levels as leave a few points in each leaf.
    const std::uint32_t nodes = n > kLeafPoints ? std::bit_ceil(n / kLeafPoints) : 1;
    planes_.resize(nodes);
    struct Part {
        std::uint32_t begin, end;
    };
    std::vector<Part> level{{0, n}}, below;
    for (std::uint32_t first = 1; first < nodes; first *= 2) {
        below.resize(2 * level.size());
        parallel_for(level.size(), [&](std::size_t i) {
            const auto [begin, end] = level[i];
            const std::uint32_t middle = begin + (end - begin) / 2;
            // Cut across the longest side of what is there.
            Vec3f lower(INFINITY), upper(-INFINITY);
            for (std::uint32_t p = begin; p < end; ++p) {
                lower = min(lower, points_[p].at);
                upper = max(upper, points_[p].at);
            }
            const Vec3f size = upper - lower;
            const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
            const auto start = points_.begin();
            std::nth_element(start + begin, start + middle, start + end,
                             [axis](const NumberedPoint& a, const NumberedPoint& b) {
                                 const float p = a.at[axis], q = b.at[axis];
                                 return p < q || (p == q && a.index < b.index);
                             });
            planes_[first + i] = {points_[middle].at[axis], static_cast<std::uint32_t>(axis)};
            below[2 * i] = {begin, middle};
            below[2 * i + 1] = {middle, end};
        });
        level.swap(below);
    }
    // nth_element leaves an order within halves that is a library's own: sort leaves by index.
    parallel_for(
        level.size(),
        [&](std::size_t i) {
            std::sort(
                points_.begin() + level[i].begin, points_.begin() + level[i].end,
                [](const NumberedPoint& a, const NumberedPoint& b) { return a.index < b.index; });
        },
        256);
}

CellIndex::CellIndex(std::span<const Vec3f> points, float edge) : edge_(edge), per_metre_(1 / edge_)
{
    if (!(edge > 0 && std::isfinite(edge)))
        throw InvalidParameter(fmt::format("point search: edge = {} m, must be > 0", edge));
    const Bounds bounds = bounds_of(points);
    lower_ = bounds.lower;
    upper_ = bounds.upper;
    const std::size_t n = points.size();
    if (n == 0) {
        start_.assign(2, 0);
        return;
    }

    // A table of about two places a point.
    const double most = std::max(4096.0, 2.0 * static_cast<double>(n));
    std::array<double, 3> wanted;
    for (int k = 0; k < 3; ++k) {
        // Cells beyond 2^53 could not be told apart.
        const double span = (upper_[k] - lower_[k]) * per_metre_;
        if (!(span < 0x1p53))
            throw InvalidParameter(
                fmt::format("point search: edge = {} m is too small for points {} m apart", edge,
                            upper_[k] - lower_[k]));
        wanted[static_cast<std::size_t>(k)] = std::floor(span) + 1;
    }
    while (wanted[0] * wanted[1] * wanted[2] > most) {
        double& largest = *std::ranges::max_element(wanted);
        largest = std::ceil(largest / 2);
    }
    for (std::size_t k = 0; k < 3; ++k) cells_[k] = static_cast<std::uint32_t>(wanted[k]);
    const std::uint32_t cells = cells_[0] * cells_[1] * cells_[2];

    // Sort by cell, stable, in two steps: groups of neighbouring cells, then the cells of a group.
    constexpr std::size_t kGroups = 256, kChunk = 16384;
    const auto in_group = static_cast<std::uint32_t>((cells + kGroups - 1) / kGroups);
    const std::size_t chunks = (n + kChunk - 1) / kChunk;
    std::vector<std::uint32_t> key(n);
    std::vector<std::array<std::uint32_t, kGroups>> place(chunks);
    parallel_for(chunks, [&](std::size_t c) {
        place[c].fill(0);
        for (std::size_t i = c * kChunk; i < std::min(n, (c + 1) * kChunk); ++i) {
            std::uint32_t number = 0;
            for (int k = 0; k < 3; ++k) {
                const std::uint32_t many = cells_[static_cast<std::size_t>(k)];
                number = number * many + static_cast<std::uint32_t>(cell(points[i][k], k) % many);
            }
            key[i] = number;
            ++place[c][number / in_group];
        }
    });
    std::array<std::uint32_t, kGroups + 1> group_start{};
    std::uint32_t sum = 0;
    for (std::size_t g = 0; g < kGroups; ++g) {
        group_start[g] = sum;
        for (std::size_t c = 0; c < chunks; ++c) {
            const std::uint32_t count = place[c][g];
            place[c][g] = sum;
            sum += count;
        }
    }
    group_start[kGroups] = sum;
    struct Keyed {
        std::uint32_t key, index;
    };
    std::vector<Keyed> sorted(n);
    parallel_for(chunks, [&](std::size_t c) {
        for (std::size_t i = c * kChunk; i < std::min(n, (c + 1) * kChunk); ++i)
            sorted[place[c][key[i] / in_group]++] = {key[i], static_cast<std::uint32_t>(i)};
    });
    points_.resize(n);
    start_.assign(cells + 1, static_cast<std::uint32_t>(n));
    parallel_for(kGroups, [&](std::size_t g) {
        const std::size_t first = std::min<std::size_t>(g * in_group, cells);
        const std::size_t last = std::min<std::size_t>(first + in_group, cells);
        if (first == last) return;
        std::vector<std::uint32_t> count(last - first + 1, 0);
        for (std::size_t s = group_start[g]; s < group_start[g + 1]; ++s)
            ++count[sorted[s].key - first];
        std::uint32_t slot = group_start[g];
        for (std::size_t c = first; c < last; ++c) {
            start_[c] = slot;
            slot += count[c - first];
            count[c - first] = start_[c];
        }
        for (std::size_t s = group_start[g]; s < group_start[g + 1]; ++s)
            points_[count[sorted[s].key - first]++] = {points[sorted[s].index], sorted[s].index};
    });
}

}  // namespace sekitei
