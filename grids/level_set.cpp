#include "grids/level_set.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace sekitei {
namespace {

constexpr Coord kHalo(8, 8, 8);  // one leaf

/// Calls f(i) for i in [0, count) in parallel, a batch at a time, so that progress is told and
/// interruption is noticed between batches.
template <class F>
void in_batches(std::size_t count, std::size_t batch, const Progress& progress, F&& f)
{
    for (std::size_t begin = 0; begin < count; begin += batch) {
        progress.update(static_cast<double>(begin) / static_cast<double>(count));
        const std::size_t n = std::min(batch, count - begin);
        parallel_for(
            n, [&](std::size_t i) { f(begin + i); }, 8);
    }
    progress.update(1);
}

/// Origins of all leaves that meet [lower, upper), in the order of LeafTopology.
std::vector<Coord> box_leaves(Coord lower, Coord upper)
{
    const Coord first = leaf_origin(lower);
    std::vector<Coord> origins;
    for (int x = first.x; x < upper.x; x += kLeafEdge)
        for (int y = first.y; y < upper.y; y += kLeafEdge)
            for (int z = first.z; z < upper.z; z += kLeafEdge) origins.emplace_back(x, y, z);
    return origins;
}

/// Stores a distance and marks it active when it lies within the band.
void put(float* values, LeafMask& mask, int offset, double distance, float background)
{
    const float v = std::clamp(static_cast<float>(distance), -background, background);
    values[offset] = v;
    if (std::fabs(v) < background) mask.set(offset);
}

// --- implicit functions ---

using Function = std::function<double(Vec3d)>;

Vec3d gradient_at(const Function& f, Vec3d p)
{
    constexpr double h = 0.5;
    return {(f({p.x + h, p.y, p.z}) - f({p.x - h, p.y, p.z})) / (2 * h),
            (f({p.x, p.y + h, p.z}) - f({p.x, p.y - h, p.z})) / (2 * h),
            (f({p.x, p.y, p.z + h}) - f({p.x, p.y, p.z - h})) / (2 * h)};
}

/// Signed distance from p to the tangent plane of the zero set at the foot of one Newton step along
/// the gradient g. Second order in the distance; the first-order f / |g| is what remains where the
/// function is too rough for more.
double distance_to_zero(const Function& f, Vec3d p, double value, Vec3d g)
{
    const double steep = length(g);
    if (value == 0) return 0;
    if (!(steep > 0)) return value > 0 ? 2 * kBandVoxels : -2 * kBandVoxels;
    const double first = value / steep;
    if (std::fabs(first) > 2 * kBandVoxels) return first;
    const Vec3d foot = p - g * (first / steep);
    const Vec3d foot_gradient = gradient_at(f, foot);
    const double foot_steep = length(foot_gradient);
    if (!(foot_steep > 0)) return first;
    const double second = dot(p - foot, foot_gradient) / foot_steep + f(foot) / foot_steep;
    const bool same_side = (second > 0) == (value > 0) && second != 0;
    return same_side && std::fabs(second) < 2 * std::fabs(first) ? second : first;
}

void fill_leaf(const Function& f, Coord origin, double voxel, float background, bool is_distance,
               float* values, LeafMask& mask)
{
    if (is_distance) {
        for (int o = 0; o < kLeafSize; ++o)
            put(values, mask, o, f(centre_of(leaf_coord(origin, o))) * voxel, background);
        return;
    }
    // f on the leaf and one voxel around it serves all central differences.
    std::vector<double> table(1000);
    auto at = [&](int x, int y, int z) -> double& {
        return table[static_cast<std::size_t>(((x + 1) * 10 + y + 1) * 10 + z + 1)];
    };
    for (int x = -1; x <= 8; ++x)
        for (int y = -1; y <= 8; ++y)
            for (int z = -1; z <= 8; ++z) at(x, y, z) = f(centre_of(origin + Coord(x, y, z)));
    for (int o = 0; o < kLeafSize; ++o) {
        const Coord c = leaf_coord({0, 0, 0}, o);
        const Vec3d g{(at(c.x + 1, c.y, c.z) - at(c.x - 1, c.y, c.z)) / 2,
                      (at(c.x, c.y + 1, c.z) - at(c.x, c.y - 1, c.z)) / 2,
                      (at(c.x, c.y, c.z + 1) - at(c.x, c.y, c.z - 1)) / 2};
        const double d = distance_to_zero(f, centre_of(origin + c), at(c.x, c.y, c.z), g);
        put(values, mask, o, d * voxel, background);
    }
}

// --- distances from the sides of voxels ---

/// Which voxels of a set of leaves are inside; all others are outside.
struct Sides {
    TopologyPtr topology;
    std::vector<LeafMask> inside;
};

/// Sides of the voxels of `topology` under `is_inside`; voxels outside [lower, upper) have the side
/// of the nearest one within.
template <class T, class IsInside>
Sides sides_of(const LeafGrid<T>& grid, const TopologyPtr& topology, Coord lower, Coord upper,
               IsInside&& is_inside)
{
    Sides sides{topology, std::vector<LeafMask>(topology->size())};
    parallel_for(
        topology->size(),
        [&](std::size_t leaf) {
            const Coord o = topology->origin(leaf);
            LeafMask& mask = sides.inside[leaf];
            const bool whole = o.x >= lower.x && o.y >= lower.y && o.z >= lower.z &&
                               o.x + 8 <= upper.x && o.y + 8 <= upper.y && o.z + 8 <= upper.z;
            if (whole) {
                const std::uint32_t own = grid.topology()->find(o);
                if (own == kNoLeaf) return;
                for (int i = 0; i < kLeafSize; ++i)
                    if (is_inside(grid.at(own, i), grid.mask(own).test(i))) mask.set(i);
                return;
            }
            GridReader<T> reader(grid);
            for (int i = 0; i < kLeafSize; ++i) {
                const Coord c = max(lower, min(upper - Coord(1, 1, 1), leaf_coord(o, i)));
                const bool active = reader.active(c);
                if (is_inside(reader.value(c), active)) mask.set(i);
            }
        },
        64);
    return sides;
}

/// Squared distance from the middle of an 11-bit window to its nearest set bit; 1000 if none.
struct NearestBit {
    std::array<std::int16_t, 2048> squared{};
    constexpr NearestBit()
    {
        for (int window = 0; window < 2048; ++window) {
            int best = 1000;
            for (int i = 0; i < 11; ++i)
                if ((window >> i) & 1 && (i - 5) * (i - 5) < best) best = (i - 5) * (i - 5);
            squared[static_cast<std::size_t>(window)] = static_cast<std::int16_t>(best);
        }
    }
};
constexpr NearestBit kNearestBit;
constexpr int kReach = 5;          // voxels; one more than the band, for the half voxel subtracted
constexpr float kBeyond = 4.599f;  // sqrt(5^2 + 1) - 1/2, the least distance out of reach

/// Signed distance [voxels] of the leaf's voxels and `Margin` around it to the nearest voxel centre
/// of the other side, less half a voxel; kBeyond when that is out of reach. Exact, axis by axis.
template <int Margin>
struct BlockDistance {
    static constexpr int kCore = 8 + 2 * Margin, kEdge = kCore + 2 * kReach;
    std::array<float, std::size_t(kCore* kCore* kCore)> distance;

    float at(int x, int y, int z) const  // relative to the leaf
    {
        return distance[index(x + Margin, y + Margin, z + Margin)];
    }

    void compute(const Sides& sides, const LeafTopology::Neighbours& around)
    {
        // Rows along z as 24 bits: the leaf's own eight and those of its neighbours.
        std::array<std::uint32_t, std::size_t(kEdge * kEdge)> rows;
        for (int x = 0; x < kEdge; ++x)
            for (int y = 0; y < kEdge; ++y) {
                const int lx = x - kReach - Margin, ly = y - kReach - Margin;
                std::uint32_t row = 0;
                for (int dz = -1; dz <= 1; ++dz) {
                    const std::uint32_t leaf = around[static_cast<std::size_t>(
                        neighbour_index(lx < 0 ? -1 : lx > 7, ly < 0 ? -1 : ly > 7, dz))];
                    if (leaf == kNoLeaf) continue;
                    const std::uint64_t word =
                        sides.inside[leaf].words[static_cast<std::size_t>(lx & 7)];
                    row |= static_cast<std::uint32_t>((word >> ((ly & 7) * 8)) & 0xff)
                           << ((dz + 1) * 8);
                }
                rows[static_cast<std::size_t>(x * kEdge + y)] = row;
            }
        std::array<std::int16_t, std::size_t(kCore * kCore * kCore)> to_inside, to_outside;
        nearest(rows, 0, to_inside);
        nearest(rows, 0xffffff, to_outside);
        for (int x = 0; x < kCore; ++x)
            for (int y = 0; y < kCore; ++y)
                for (int z = 0; z < kCore; ++z) {
                    const std::uint32_t row =
                        rows[static_cast<std::size_t>((x + kReach) * kEdge + y + kReach)];
                    const bool in = (row >> (z - Margin + 8)) & 1;
                    const std::size_t i = index(x, y, z);
                    const int squared = in ? to_outside[i] : to_inside[i];
                    const float d = squared > kReach * kReach
                                        ? kBeyond
                                        : std::sqrt(static_cast<float>(squared)) - 0.5f;
                    distance[i] = in ? -d : d;
                }
    }

private:
    static constexpr std::size_t index(int x, int y, int z)
    {
        return static_cast<std::size_t>((x * kCore + y) * kCore + z);
    }

    static void nearest(const std::array<std::uint32_t, std::size_t(kEdge* kEdge)>& rows,
                        std::uint32_t flip,
                        std::array<std::int16_t, std::size_t(kCore* kCore* kCore)>& result)
    {
        std::array<std::int16_t, std::size_t(kEdge * kEdge * kCore)> along_z;
        for (int r = 0; r < kEdge * kEdge; ++r)
            for (int z = 0; z < kCore; ++z)
                along_z[static_cast<std::size_t>(r * kCore + z)] =
                    kNearestBit.squared[((rows[static_cast<std::size_t>(r)] ^ flip) >>
                                         (z - Margin + 8 - kReach)) &
                                        0x7ff];
        std::array<std::int16_t, std::size_t(kEdge * kCore * kCore)> along_y;
        for (int x = 0; x < kEdge; ++x)
            for (int y = 0; y < kCore; ++y) {
                std::int16_t* best = &along_y[static_cast<std::size_t>((x * kCore + y) * kCore)];
                std::fill_n(best, kCore, std::int16_t{1000});
                for (int k = 0; k <= 2 * kReach; ++k)
                    lower_to(best, &along_z[static_cast<std::size_t>((x * kEdge + y + k) * kCore)],
                             k - kReach, kCore);
            }
        for (int x = 0; x < kCore; ++x) {
            std::int16_t* best = &result[index(x, 0, 0)];
            std::fill_n(best, kCore * kCore, std::int16_t{1000});
            for (int k = 0; k <= 2 * kReach; ++k)
                lower_to(best, &along_y[static_cast<std::size_t>((x + k) * kCore * kCore)],
                         k - kReach, kCore * kCore);
        }
    }
    /// best[i] = min(best[i], from[i] + k^2).
    static void lower_to(std::int16_t* best, const std::int16_t* from, int k, int count)
    {
        const auto add = static_cast<std::int16_t>(k * k);
        for (int i = 0; i < count; ++i)
            best[i] = std::min(best[i], static_cast<std::int16_t>(from[i] + add));
    }
};

/// Whether the 27 leaves around are all inside (-1), all outside (1) or mixed (0).
int uniform_side(const Sides& sides, const LeafTopology::Neighbours& around)
{
    const bool in = sides.inside[around[13]].all();
    for (const std::uint32_t n : around) {
        const bool same = n == kNoLeaf ? !in : in ? sides.inside[n].all() : sides.inside[n].none();
        if (!same) return 0;
    }
    return in ? -1 : 1;
}

/// A level set on the leaves of `sides` that meet [lower, upper); fill(leaf of sides, origin,
/// values, mask) writes the leaves that are near a change of side.
template <class Fill>
FloatGrid band_of(const Sides& sides, const Transform& transform, Coord lower, Coord upper,
                  const Progress& progress, Fill&& fill)
{
    const auto background = static_cast<float>(kBandVoxels * transform.voxel);
    const std::vector<LeafTopology::Neighbours>& around = sides.topology->neighbours();
    std::vector<signed char> side(sides.topology->size());
    parallel_for(
        side.size(),
        [&](std::size_t leaf) {
            const Coord o = sides.topology->origin(leaf);
            const bool covered = o.x + 8 > lower.x && o.y + 8 > lower.y && o.z + 8 > lower.z &&
                                 o.x < upper.x && o.y < upper.y && o.z < upper.z;
            side[leaf] = covered ? static_cast<signed char>(uniform_side(sides, around[leaf]))
                                 : static_cast<signed char>(1);
        },
        64);
    std::vector<Coord> origins;
    std::vector<std::size_t> near_leaves, sources;
    for (std::size_t leaf = 0; leaf < side.size(); ++leaf) {
        if (side[leaf] == 1) continue;
        if (side[leaf] == 0) {
            near_leaves.push_back(origins.size());
            sources.push_back(leaf);
        }
        origins.push_back(sides.topology->origin(leaf));
    }
    FloatGrid grid(LeafTopology::build(std::move(origins)), transform, background);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.set_constant(leaf, -background);
    grid.expand(near_leaves);
    in_batches(near_leaves.size(), 4096, progress, [&](std::size_t k) {
        const std::size_t leaf = near_leaves[k];
        fill(sources[k], grid.origin(leaf), grid.values(leaf), grid.mask(leaf));
    });
    grid.compress();
    return grid;
}

/// mend_distances() on the leaves that meet [lower, upper).
FloatGrid mended(const FloatGrid& field, Coord lower, Coord upper, const Progress& progress)
{
    const TopologyPtr grown = field.topology()
                                  ->dilated(lower - kHalo, upper + kHalo)
                                  ->dilated(lower - kHalo, upper + kHalo);
    const Sides sides =
        sides_of(field, grown, leaf_origin(lower), leaf_origin(upper + Coord(7, 7, 7)),
                 [](float v, bool) { return v <= 0; });
    const double voxel = field.transform().voxel;
    const auto background = static_cast<float>(kBandVoxels * voxel);
    const auto& around = sides.topology->neighbours();
    return band_of(sides, field.transform(), lower, upper, progress,
                   [&](std::size_t source, Coord origin, float* values, LeafMask& mask) {
                       BlockDistance<0> block;
                       block.compute(sides, around[source]);
                       const std::uint32_t own = field.topology()->find(origin);
                       for (int o = 0; o < kLeafSize; ++o) {
                           const Coord c = leaf_coord({0, 0, 0}, o);
                           const double counted = double(block.at(c.x, c.y, c.z)) * voxel;
                           const double given =
                               own == kNoLeaf ? field.background() : field.at(own, o);
                           // The nearest voxel centre across the surface lies between the distance
                           // itself and a
                           // voxel's diagonal more.
                           const double excess = (std::fabs(given) - std::fabs(counted)) / voxel;
                           const bool plausible = excess <= 0.51 && excess >= 0.49 - std::sqrt(3.0);
                           put(values, mask, o, plausible ? given : counted, background);
                       }
                   });
}

template <class Combine>
FloatGrid combined(const FloatGrid& a, const FloatGrid& b, Combine&& combine)
{
    const float background = std::max(a.background(), b.background());
    std::vector<Coord> origins = a.topology()->origins();
    origins.insert(origins.end(), b.topology()->origins().begin(), b.topology()->origins().end());
    FloatGrid result(LeafTopology::build(std::move(origins)), a.transform(), background);
    std::vector<std::uint32_t> in_a(result.leaf_count()), in_b(result.leaf_count());
    std::vector<std::size_t> dense;
    for (std::size_t leaf = 0; leaf < result.leaf_count(); ++leaf) {
        in_a[leaf] = a.topology()->find(result.origin(leaf));
        in_b[leaf] = b.topology()->find(result.origin(leaf));
        const bool flat_a = in_a[leaf] == kNoLeaf || a.is_constant(in_a[leaf]);
        const bool flat_b = in_b[leaf] == kNoLeaf || b.is_constant(in_b[leaf]);
        if (flat_a && flat_b)
            result.set_constant(
                leaf, combine(in_a[leaf] == kNoLeaf ? background : a.constant(in_a[leaf]),
                              in_b[leaf] == kNoLeaf ? background : b.constant(in_b[leaf])));
        else
            dense.push_back(leaf);
    }
    result.expand(dense);
    parallel_for(
        dense.size(),
        [&](std::size_t k) {
            const std::size_t leaf = dense[k];
            for (int o = 0; o < kLeafSize; ++o)
                put(result.values(leaf), result.mask(leaf), o,
                    combine(in_a[leaf] == kNoLeaf ? background : a.at(in_a[leaf], o),
                            in_b[leaf] == kNoLeaf ? background : b.at(in_b[leaf], o)),
                    background);
        },
        64);
    result.compress();
    return result;
}

}  // namespace

FloatGrid level_set_from_function(const Domain& domain, const std::function<double(Vec3d)>& f,
                                  const Progress& progress, ImplicitBounds bounds)
{
    const double voxel = domain.transform.voxel;
    const auto background = static_cast<float>(kBandVoxels * voxel);

    // A leaf is uniform when the surface lies farther from its centre than its corner voxels and
    // the band together.
    const std::vector<Coord> all = box_leaves(Coord() - kHalo, domain.dims + kHalo);
    const double clear = bounds.steepness * (3.5 * std::sqrt(3.0) + kBandVoxels + 1e-3);
    std::vector<signed char> side(all.size());
    if (std::isfinite(clear))
        in_batches(all.size(), 1 << 18, progress.slice(0, 0.1), [&](std::size_t i) {
            const double value = f(Vec3d(all[i]) + Vec3d(4));
            side[i] = static_cast<signed char>(value > clear ? 1 : value < -clear ? -1 : 0);
        });

    std::vector<Coord> origins;
    std::vector<std::size_t> near_leaves;
    for (std::size_t i = 0; i < all.size(); ++i) {
        if (side[i] == 1) continue;
        if (side[i] == 0) near_leaves.push_back(origins.size());
        origins.push_back(all[i]);
    }
    FloatGrid grid(LeafTopology::build(std::move(origins)), domain.transform, background);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.set_constant(leaf, -background);
    grid.expand(near_leaves);
    in_batches(near_leaves.size(), 2048, progress.slice(0.1, 1), [&](std::size_t k) {
        const std::size_t leaf = near_leaves[k];
        fill_leaf(f, grid.origin(leaf), voxel, background, bounds.is_distance, grid.values(leaf),
                  grid.mask(leaf));
    });
    grid.compress();
    return grid;
}

FloatGrid level_set_from_voxels(const IntGrid& region, std::int32_t inside_value,
                                const Domain& domain, const Progress& progress)
{
    const Coord lower = Coord() - kHalo * 2, upper = domain.dims + kHalo * 2;
    const TopologyPtr grown = region.topology()->dilated(lower, upper)->dilated(lower, upper);
    const Sides sides =
        sides_of(region, grown, {0, 0, 0}, domain.dims,
                 [&](std::int32_t v, bool active) { return active && v == inside_value; });
    const double voxel = domain.transform.voxel;
    const auto background = static_cast<float>(kBandVoxels * voxel);
    const auto& around = sides.topology->neighbours();
    return band_of(sides, domain.transform, Coord() - kHalo, domain.dims + kHalo, progress,
                   [&](std::size_t source, Coord, float* values, LeafMask& mask) {
                       BlockDistance<1> block;
                       block.compute(sides, around[source]);
                       for (int o = 0; o < kLeafSize; ++o) {
                           // [1 6 1] / 8 along each axis: a standard deviation of half a voxel.
                           const Coord c = leaf_coord({0, 0, 0}, o);
                           double smooth = 0;
                           for (int dx = -1; dx <= 1; ++dx)
                               for (int dy = -1; dy <= 1; ++dy)
                                   for (int dz = -1; dz <= 1; ++dz)
                                       smooth += (dx ? 1 : 6) * (dy ? 1 : 6) * (dz ? 1 : 6) *
                                                 double(block.at(c.x + dx, c.y + dy, c.z + dz));
                           smooth /= 512;
                           // No voxel changes sides: a thin sheet keeps a tenth of a voxel.
                           const double d = block.at(c.x, c.y, c.z) < 0 ? std::min(smooth, -0.1)
                                                                        : std::max(smooth, 0.1);
                           put(values, mask, o, d * voxel, background);
                       }
                   });
}

FloatGrid mend_distances(const FloatGrid& field, const Domain& domain, const Progress& progress)
{
    return mended(field, Coord() - kHalo, domain.dims + kHalo, progress);
}

FloatGrid mend_distances(const FloatGrid& field, const Progress& progress)
{
    if (field.leaf_count() == 0) return field;
    Coord lower(INT32_MAX), upper(INT32_MIN);
    for (const Coord& o : field.topology()->origins()) {
        lower = min(lower, o);
        upper = max(upper, o + kHalo);
    }
    return mended(field, lower - kHalo, upper + kHalo, progress);
}

FloatGrid csg_intersection(const FloatGrid& a, const FloatGrid& b)
{
    return combined(a, b, [](float x, float y) { return std::max(x, y); });
}

FloatGrid csg_union(const FloatGrid& a, const FloatGrid& b)
{
    return combined(a, b, [](float x, float y) { return std::min(x, y); });
}

FloatGrid csg_difference(const FloatGrid& a, const FloatGrid& b)
{
    return combined(a, b, [](float x, float y) { return std::max(x, -y); });
}

double inside_voxels(const FloatGrid& level_set, const Domain& domain)
{
    return parallel_sum(
        level_set.leaf_count(),
        [&](std::size_t leaf) {
            const Coord o = level_set.origin(leaf);
            double count = 0;
            for (int i = 0; i < kLeafSize; ++i)
                if (domain.contains(leaf_coord(o, i)) && level_set.at(leaf, i) <= 0) ++count;
            return count;
        },
        256);
}

}  // namespace sekitei
