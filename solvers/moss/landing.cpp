#include "solvers/moss/landing.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.h"

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
    const double distance = double(GridReader<float>(*surface_).sample(at));
    if (std::abs(distance) <= adhesion) return nearest(at);
    if (distance < 0) return kLost;
    return seed.fall.x == 0 && seed.fall.y == 0 ? drop(voxel_of(at)) : drift(at, seed.fall);
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

/// Straight down a column; a column of a leaf is contiguous.
std::int32_t CellLanding::drop(Coord c) const
{
    if (c.x < lower_.x || c.x >= upper_.x || c.y < lower_.y || c.y >= upper_.y) return kLost;
    c.z = std::min(c.z, upper_.z - 1);
    if (surface_->value(c) < 0) return nearest(centre_of(c));  // a seed at a sharp edge
    while (c.z >= lower_.z) {
        const Coord origin = leaf_origin(c);
        const std::uint32_t leaf = surface_->topology()->find(origin);
        if (leaf != kNoLeaf) {
            if (const float* v = surface_->values(leaf)) {
                const float* column = v + leaf_offset({c.x, c.y, 0});
                for (int z = c.z - origin.z; z >= 0; --z)
                    if (column[z] < 0) return cells_->index.value({c.x, c.y, origin.z + z});
            } else if (surface_->constant(leaf) < 0)
                return cells_->index.value(c);
        }
        c.z = origin.z - 1;
    }
    return kLost;
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
    if (surface_->value(c) < 0) return nearest(centre_of(c));
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
        const float* values = leaf == kNoLeaf ? nullptr : surface_->values(leaf);
        if (!values && leaf != kNoLeaf && surface_->constant(leaf) < 0)
            return cells_->index.value(c);
        int axis = 2;
        if (values) {
            while (leaf_origin(c) == origin) {
                if (values[leaf_offset(c)] < 0) return cells_->index.value(c);
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
