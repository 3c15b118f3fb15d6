#include "solvers/moss/landing.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/parallel.h"

namespace sekitei::moss {
namespace {

constexpr double kFar = 1e9;  // [voxels]; farther out, numbers would not fit an integer

// Adhesion up to here [voxels]: level sets know distances to a little farther.
constexpr int kReach = 3;

Coord voxel_of(Vec3d p)
{
    return {static_cast<std::int32_t>(std::floor(p.x)), static_cast<std::int32_t>(std::floor(p.y)),
            static_cast<std::int32_t>(std::floor(p.z))};
}

}  // namespace

Surface surface_of(const SurfaceCells& cells)
{
    return {.position = cells.position,
            .offset = cells.sdf,
            .normal = cells.normal,
            .area = cells.area,
            .neighbour_begin = cells.neighbour_begin,
            .neighbour = cells.neighbour,
            .spacing = cells.transform.voxel};
}

CellLanding::CellLanding(const FloatGrid& surface, const SurfaceCells& cells)
    : surface_(&surface), cells_(&cells)
{
    if (!(surface.transform() == cells.transform))
        throw InvalidInput("moss: the surface cells belong to another level set");
    if (surface.leaf_count()) lower_ = upper_ = surface.origin(0);
    for (const Coord& o : surface.topology()->origins()) {
        lower_ = min(lower_, o);
        upper_ = max(upper_, o + Coord(kLeafEdge));
    }
    solid_.resize(surface.leaf_count());
    index_leaf_.resize(surface.leaf_count());
    parallel_for(
        surface.leaf_count(),
        [&](std::size_t leaf) {
            index_leaf_[leaf] = cells.index.topology()->find(surface.origin(leaf));
            const float* v = surface.values(leaf);
            if (!v && surface.constant(leaf) < 0) solid_[leaf] = LeafMask::full();
            if (!v) return;
            for (int o = 0; o < kLeafSize; ++o)
                if (v[o] < 0) solid_[leaf].set(o);
        },
        64);
}

double CellLanding::reach() const
{
    return kReach * surface_->transform().voxel;
}

void CellLanding::land(std::span<const Flight> seeds, double adhesion,
                       std::span<std::int32_t> site) const
{
    for (std::size_t i = 0; i < seeds.size(); ++i) site[i] = land_one(seeds[i], adhesion);
}

std::int32_t CellLanding::land_one(const Flight& seed, double adhesion) const
{
    const Vec3d at = surface_->transform().voxels(seed.at);
    for (int axis = 0; axis < 3; ++axis)
        if (!(std::abs(at[axis]) < kFar)) return kLost;
    const double distance = sample(at);
    if (std::abs(distance) <= adhesion) return nearest(at);
    if (distance < 0) return kLost;
    return seed.fall.x == 0 && seed.fall.y == 0 ? drop(voxel_of(at)) : drift(at, seed.fall);
}

/// GridReader::sample(), the same bits; most points have their eight voxels in one leaf, which is
/// then looked up once.
double CellLanding::sample(Vec3d p) const
{
    const Vec3d u = p - Vec3d(0.5);
    const Coord c = voxel_of(u);
    if ((c.x & 7) == 7 || (c.y & 7) == 7 || (c.z & 7) == 7)
        return double(GridReader<float>(*surface_).sample(p));
    const std::uint32_t leaf = surface_->topology()->find(leaf_origin(c));
    if (leaf == kNoLeaf) return double(surface_->background());
    const float* v = surface_->values(leaf);
    if (!v) return double(surface_->constant(leaf));
    v += leaf_offset(c);
    auto mix = [](float a, float b, double t) {
        return a * static_cast<float>(1 - t) + b * static_cast<float>(t);
    };
    const Vec3d f = u - Vec3d(c);
    const float near = mix(mix(v[0], v[1], f.z), mix(v[8], v[9], f.z), f.y);
    const float far = mix(mix(v[64], v[65], f.z), mix(v[72], v[73], f.z), f.y);
    return double(mix(near, far, f.x));
}

/// The cell whose centre is nearest to `at`, looked for in growing cubes.
std::int32_t CellLanding::nearest(Vec3d at) const
{
    GridReader<std::int32_t> index(cells_->index);
    const Coord centre = voxel_of(at);
    std::int32_t best = kLost;
    double best_distance = std::numeric_limits<double>::infinity();
    auto look = [&](Coord c) {
        const std::int32_t cell = index.value(c);
        if (cell < 0) return;
        const Vec3d d = centre_of(c) - at;
        const double distance = dot(d, d);
        if (distance < best_distance || (distance == best_distance && cell < best))
            best = cell, best_distance = distance;
    };
    for (int r = 1; r <= kReach + 2; ++r) {
        // The cube without the one before; the first includes its middle.
        for (int x = -r; x <= r; ++x)
            for (int y = -r; y <= r; ++y) {
                const bool side = r == 1 || std::abs(x) == r || std::abs(y) == r;
                for (int z = -r; z <= r; z += side ? 1 : 2 * r) look(centre + Coord(x, y, z));
            }
        // All centres within r + 1/2 have been seen.
        if (best_distance <= (r + 0.5) * (r + 0.5)) break;
    }
    return best;
}

/// The number of the cell at a voxel of a leaf of the surface, or kLost.
std::int32_t CellLanding::cell(std::size_t leaf, int offset) const
{
    const std::uint32_t index = index_leaf_[leaf];
    return index == kNoLeaf ? kLost : cells_->index.at(index, offset);
}

/// Straight down. Leaves are sorted by x, y, z: the one before, if in the same column, is the next
/// below, however wide the gap. A leaf's column is one byte of its mask.
std::int32_t CellLanding::drop(Coord c) const
{
    const std::vector<Coord>& origins = surface_->topology()->origins();
    const Coord origin = leaf_origin(c);
    std::size_t leaf = surface_->topology()->find(origin);
    if (leaf == kNoLeaf) {
        const auto above = std::ranges::upper_bound(origins, origin);
        if (above == origins.begin()) return kLost;
        leaf = static_cast<std::size_t>(above - origins.begin()) - 1;
    } else if (solid_[leaf].test(leaf_offset(c)))
        return nearest(centre_of(c));  // a seed at a sharp edge
    const int word = c.x & 7, shift = 8 * (c.y & 7);
    for (;; --leaf) {
        const Coord o = origins[leaf];
        if (o.x != origin.x || o.y != origin.y) return kLost;
        auto column =
            static_cast<unsigned>(solid_[leaf].words[static_cast<std::size_t>(word)] >> shift) &
            0xFFu;
        if (o.z == origin.z) column &= (2u << (c.z & 7)) - 1;
        if (column)
            return cell(leaf,
                        leaf_offset({c.x, c.y, static_cast<int>(std::bit_width(column)) - 1}));
        if (leaf == 0) return kLost;
    }
}

/// Along a slanted way: face by face through the voxels of leaves near the surface, in one step
/// through the others.
std::int32_t CellLanding::drift(Vec3d from, Vec3d way) const
{
    double t = 0;
    // Parameter at which the way leaves a box, and the axis through which.
    auto exit = [&](Vec3d low, Vec3d high, int& axis) {
        double first = std::numeric_limits<double>::infinity();
        for (int k = 0; k < 3; ++k) {
            if (way[k] == 0) continue;
            const double end = ((way[k] > 0 ? high[k] : low[k]) - from[k]) / way[k];
            if (end < first) first = end, axis = k;
        }
        return first;
    };
    Coord c = voxel_of(from);
    // Fall to the height of the highest leaf.
    if (c.z >= upper_.z) {
        t = (from.z - upper_.z) / -way.z;
        const Vec3d at = from + way * t;
        if (!(std::abs(at.x) < kFar && std::abs(at.y) < kFar)) return kLost;
        c = voxel_of(at);
        c.z = upper_.z - 1;
    }
    if (surface_->value(c) < 0) return nearest(centre_of(c));  // a seed at a sharp edge
    auto gone = [&] {
        if (c.z < lower_.z) return true;
        for (int k = 0; k < 2; ++k)
            if ((c[k] < lower_[k] && way[k] <= 0) || (c[k] >= upper_[k] && way[k] >= 0))
                return true;
        return false;
    };
    while (!gone()) {
        const Coord origin = leaf_origin(c);
        const std::uint32_t leaf = surface_->topology()->find(origin);
        int axis = 2;
        if (leaf != kNoLeaf && !solid_[leaf].none()) {
            while (leaf_origin(c) == origin) {
                const int offset = leaf_offset(c);
                if (solid_[leaf].test(offset)) return cell(leaf, offset);
                exit(Vec3d(c), Vec3d(c + Coord(1)), axis);
                c[axis] += way[axis] > 0 ? 1 : -1;
            }
            continue;
        }
        t = std::max(t, exit(Vec3d(origin), Vec3d(origin + Coord(kLeafEdge)), axis));
        const Coord next = voxel_of(from + way * t);
        for (int k = 0; k < 3; ++k)  // rounding must not lead back, or out through a second face
            c[k] = k == axis ? (way[k] > 0 ? origin[k] + kLeafEdge : origin[k] - 1)
                             : std::clamp(next[k], origin[k], origin[k] + kLeafEdge - 1);
    }
    return kLost;
}

}  // namespace sekitei::moss
