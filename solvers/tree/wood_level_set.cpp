#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/error.h"
#include "core/log.h"
#include "core/parallel.h"
#include "grids/level_set.h"
#include "solvers/tree/chains.h"
#include "solvers/tree/leaf_lists.h"
#include "solvers/tree/wood.h"

namespace sekitei::tree {
namespace {

constexpr double kBlend = 0.7;      // width of the smooth minimum, in radii of the thinner limb
constexpr double kThinnest = 0.5;   // radius below which limbs are left out [voxels]
constexpr double kUnbroken = 0.87;  // least radius of the others: half a voxel's diagonal [voxels]

/// All that two balls and the cones between them hold; voxel units.
struct Capsule {
    Vec3d a, b;
    double ra = 0, rb = 0;
    std::uint32_t chain = 0;
};

/// Signed distance to a capsule, and its radius where it is nearest.
struct Near {
    double distance = 0, radius = 0;
};
Near near(const Capsule& c, Vec3d p)
{
    const Vec3d ab = c.b - c.a, ap = p - c.a;
    const double l2 = dot(ab, ab), l = std::sqrt(l2), taper = c.ra - c.rb;
    if (std::abs(taper) >= l)  // one ball holds the other
        return c.ra >= c.rb ? Near{length(ap) - c.ra, c.ra} : Near{length(p - c.b) - c.rb, c.rb};
    const double y = dot(ap, ab) / l, x = std::sqrt(std::max(0.0, dot(ap, ap) - y * y));
    // The side leans by the taper, and so do the lines that come to it at right angles.
    const double sine = taper / l, cosine = std::sqrt(1 - sine * sine);
    const double foot = (y - x * sine / cosine) / l;
    if (foot <= 0) return {length(ap) - c.ra, c.ra};
    if (foot >= 1) return {length(p - c.b) - c.rb, c.rb};
    return {x * cosine + y * sine - c.ra, c.ra - taper * foot};
}

/// Distance to several limbs, with hollows filled where they meet.
class Union {
public:
    explicit Union(const std::vector<Capsule>& capsules) : capsules_(capsules) {}

    /// @param list  ascending, so that those of one limb stand together
    double operator()(std::span<const std::uint32_t> list, Vec3d p)
    {
        limbs_.clear();
        std::uint32_t chain = Chains::kNone;
        std::size_t nearest = 0;
        for (const std::uint32_t i : list) {
            const Capsule& c = capsules_[i];
            const Near found = near(c, p);
            if (c.chain != chain) {
                chain = c.chain;
                limbs_.push_back(found);
            } else if (found.distance < limbs_.back().distance)
                limbs_.back() = found;
            if (limbs_.back().distance < limbs_[nearest].distance) nearest = limbs_.size() - 1;
        }
        const Near first = limbs_[nearest];
        double d = first.distance;
        for (std::size_t k = 0; k < limbs_.size(); ++k) {
            if (k == nearest) continue;
            const double width = kBlend * std::min(first.radius, limbs_[k].radius);
            const double h = 1 - (limbs_[k].distance - first.distance) / width;
            if (h > 0) d -= h * h * width / 4;
        }
        return d;
    }

private:
    const std::vector<Capsule>& capsules_;
    std::vector<Near> limbs_;
};

}  // namespace

FloatGrid wood_level_set(const Branches& branches, std::span<const double> radius,
                         double unit_length, double voxel, const Progress& progress)
{
    if (!(voxel > 0 && std::isfinite(voxel)))
        throw InvalidParameter(fmt::format("tree: voxel of the wood = {} m, must be > 0", voxel));
    const Chains chains = chains_of(branches, radius, unit_length);
    const double band = kBandVoxels;

    std::vector<Capsule> capsules;
    std::size_t thin = 0;
    const double scale = unit_length / voxel;
    for (std::size_t c = 0; c < chains.size(); ++c) {
        std::uint32_t before = Chains::kNone;
        for (const std::uint32_t b : chains[c]) {
            if (radius[b] < kThinnest * voxel && branches.parent[b] >= 0) {
                ++thin;
                continue;
            }
            const Vec3d from = before == Chains::kNone ? branches.start[b] : branches.end(before);
            auto in_voxels = [&](double r) { return std::max(r / voxel, kUnbroken); };
            auto joint = [&](std::uint32_t k) { return end_radius(branches, radius, chains, k); };
            capsules.push_back({from * scale, branches.end(b) * scale,
                                in_voxels(before == Chains::kNone ? radius[b] : joint(before)),
                                in_voxels(joint(b)), static_cast<std::uint32_t>(c)});
            before = b;
        }
    }
    if (thin > 0)
        log::info("tree: {} of {} branches are thinner than a voxel of {} m and left out", thin,
                  branches.size(), voxel);
    if (capsules.empty())
        return FloatGrid(LeafTopology::build({}), {{}, voxel}, static_cast<float>(band * voxel));

    // Count voxels from the lowest leaf; grids of one voxel share a lattice all the same.
    Bounds box;
    for (const Capsule& c : capsules) {
        const Vec3d reach(std::max(c.ra, c.rb) + band + 1);
        for (const Vec3d p : {c.a, c.b}) box.add(p - reach), box.add(p + reach);
    }
    Vec3d lowest;
    for (int k = 0; k < 3; ++k) lowest[k] = kLeafEdge * std::floor(box.lower[k] / kLeafEdge);
    std::vector<Extent> extents(capsules.size());
    for (std::size_t i = 0; i < capsules.size(); ++i) {
        Capsule& c = capsules[i];
        c.a -= lowest;
        c.b -= lowest;
        // As far as it can change a value within the band.
        const double r = std::max(c.ra, c.rb);
        extents[i] = {c.a, c.b, r * (1 + 1.25 * kBlend) + band};
    }
    constexpr double kBytes = 4 * kLeafSize + 4 + sizeof(LeafMask) + 3 * sizeof(Coord);
    const LeafLists lists =
        leaf_lists(extents, kBytes, "tree: wood level set", progress.slice(0, 0.2));

    // Leaves all inside or all beyond the band have one value.
    const std::size_t leaves = lists.topology->size();
    std::vector<std::uint8_t> dense(leaves), inside(leaves);
    parallel_for(
        leaves,
        [&](std::size_t leaf) {
            constexpr double kHalfDiagonal = 3.5 * 1.7320508075688772;
            const Vec3d centre = Vec3d(lists.topology->origin(leaf)) + Vec3d(kLeafEdge / 2.0);
            double least = std::numeric_limits<double>::infinity(), blend = 0;
            for (const std::uint32_t i : lists[leaf]) {
                least = std::min(least, near(capsules[i], centre).distance);
                blend += kBlend / 4 * std::max(capsules[i].ra, capsules[i].rb);
            }
            inside[leaf] = least < -band - kHalfDiagonal;
            dense[leaf] = !inside[leaf] && least - blend < band + kHalfDiagonal;
        },
        64);
    const auto background = static_cast<float>(band * voxel);
    FloatGrid grid =
        FloatGrid::partly_dense(lists.topology, {lowest * voxel, voxel}, background, dense);
    parallel_for_range(
        leaves,
        [&](std::size_t begin, std::size_t end) {
            Union wood(capsules);
            for (std::size_t leaf = begin; leaf != end; ++leaf) {
                progress.check();
                if (inside[leaf]) grid.set_constant(leaf, -background);
                float* values = grid.values(leaf);
                if (!values) continue;
                const Coord origin = grid.origin(leaf);
                for (int o = 0; o < kLeafSize; ++o) {
                    const double d = wood(lists[leaf], centre_of(leaf_coord(origin, o)));
                    if (std::abs(d) < band) {
                        values[o] = static_cast<float>(d * voxel);
                        grid.mask(leaf).set(o);
                    } else
                        values[o] = d < 0 ? -background : background;
                }
            }
        },
        8);
    grid.compress();
    progress.update(1);
    return grid;
}

}  // namespace sekitei::tree
