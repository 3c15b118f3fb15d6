#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/error.h"
#include "core/machine.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/tree/leaf_lists.h"
#include "solvers/tree/wood.h"

namespace sekitei::tree {
namespace {

using math::kPi;

// Streams of a branch's key.
constexpr std::uint64_t kYaw = 0x60, kVariant = 0x61;

/// Balls of a grove in metres.
struct Foliage {
    std::vector<std::uint32_t> branch;
    std::vector<Vec3d> centre;
    std::vector<double> radius, area;  ///< of leaves [m^2]

    explicit Foliage(const Grove& grove) : branch(grove.foliage())
    {
        const Balls balls = grove.balls();
        const double unit = grove.params().unit_length;
        for (std::size_t i = 0; i < branch.size(); ++i) {
            centre.push_back(balls.centre[i] * unit);
            radius.push_back(balls.radius[i] * unit);
            area.push_back(leaf_area(radius[i], grove.params().transmission,
                                     grove.species_of(branch[i]).leaf_projection));
        }
    }
    std::size_t size() const { return branch.size(); }
};

/// Unit vector at `angle` from u, turned about it by `azimuth`.
Vec3d aslant(Vec3d u, double cosine, double sine, double azimuth)
{
    const Vec3d h = fork_axis(u), k = cross(u, h);
    return normalized(u * cosine + (h * math::cos(azimuth) + k * math::sin(azimuth)) * sine);
}

/// Inclination whose density is 2 / pi (1 + cos 2 theta): leaves that mostly lie flat [deWit1965].
double planophile_angle(double share)
{
    double low = 0, high = kPi / 2;
    for (int i = 0; i < 40; ++i) {
        const double middle = (low + high) / 2;
        ((2 * middle + math::sin(2 * middle)) < kPi * share ? low : high) = middle;
    }
    return (low + high) / 2;
}

/// The rotation that brings x, y, z to these axes: x y z w.
std::array<float, 4> quaternion(Vec3d x, Vec3d y, Vec3d z)
{
    const double trace = x.x + y.y + z.z;
    std::array<double, 4> q{};
    if (trace > 0) {
        const double s = 2 * std::sqrt(1 + trace);
        q = {(y.z - z.y) / s, (z.x - x.z) / s, (x.y - y.x) / s, s / 4};
    } else if (x.x > y.y && x.x > z.z) {
        const double s = 2 * std::sqrt(1 + x.x - y.y - z.z);
        q = {s / 4, (y.x + x.y) / s, (z.x + x.z) / s, (y.z - z.y) / s};
    } else if (y.y > z.z) {
        const double s = 2 * std::sqrt(1 + y.y - x.x - z.z);
        q = {(y.x + x.y) / s, s / 4, (z.y + y.z) / s, (z.x - x.z) / s};
    } else {
        const double s = 2 * std::sqrt(1 + z.z - x.x - y.y);
        q = {(z.x + x.z) / s, (z.y + y.z) / s, s / 4, (x.y - y.x) / s};
    }
    return {static_cast<float>(q[0]), static_cast<float>(q[1]), static_cast<float>(q[2]),
            static_cast<float>(q[3])};
}

double fraction(double x)
{
    return x - std::floor(x);
}

}  // namespace

double leaf_area(double radius, double transmission, double projection)
{
    if (!(transmission > 0 && transmission <= 1))
        throw InvalidParameter(
            fmt::format("tree: transmission = {}, must be > 0 and at most 1 for leaves: nothing "
                        "less than infinitely many are opaque",
                        transmission));
    if (!(projection > 0 && projection <= 1))
        throw InvalidParameter(
            fmt::format("tree: leaf_projection = {}, must be > 0 and at most 1", projection));
    if (!(radius > 0 && std::isfinite(radius)))
        throw InvalidParameter(fmt::format("tree: radius of leaves = {} m, must be > 0", radius));
    return transmission == 1 ? 0 : kPi * radius * radius * -math::log(transmission) / projection;
}

Leaves leaves(const Grove& grove, std::uint64_t seed)
{
    const Foliage foliage(grove);
    const std::size_t n = foliage.size();
    std::vector<std::size_t> counts(n);
    double all = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const double size = grove.species_of(foliage.branch[i]).leaf_size;
        const double count = foliage.area[i] / (kLeafShape * size * size);
        if (foliage.area[i] > 0) all += std::max(1.0, std::floor(count + 0.5));
    }
    constexpr double kBytes = 3 * 8 + 3 * 4 + 4 * 4 + 5 * 4;
    if (all * kBytes > physical_memory() || all > 0x7FFFFFFF)
        throw LimitExceeded(fmt::format("tree: {} leaves ({}), {} are there; raise leaf_size",
                                        count_text(all), bytes_text(all * kBytes),
                                        bytes_text(physical_memory())));
    for (std::size_t i = 0; i < n; ++i) {
        const double size = grove.species_of(foliage.branch[i]).leaf_size;
        const double count = foliage.area[i] / (kLeafShape * size * size);
        if (foliage.area[i] > 0)
            counts[i] = static_cast<std::size_t>(std::max(1.0, std::floor(count + 0.5)));
    }
    const std::vector<std::size_t> first = prefix_sum(counts);
    Leaves list;
    list.position.resize(first.back());
    list.normal.resize(first.back());
    list.orient.resize(first.back());
    for (auto* floats : {&list.pscale, &list.area}) floats->resize(first.back());
    for (auto* ints : {&list.ball, &list.species, &list.tree}) ints->resize(first.back());

    const Branches& branches = grove.branches();
    parallel_for(
        n,
        [&](std::size_t i) {
            const std::uint32_t b = foliage.branch[i];
            const auto tree = std::size_t(branches.tree[b]);
            const bool flat = grove.species_of(b).leaf_orientation == LeafOrientation::Planophile;
            Vec3d up = normalized(branches.light_vector[b]);
            if (up == Vec3d{}) up = {0, 0, 1};
            const std::uint64_t key = hash2(seed, branches.key[b]);
            const std::uint64_t yaws = hash2(key, kYaw), others = hash2(key, kVariant);
            const double area = foliage.area[i] / double(counts[i]);
            for (std::size_t j = 0; j < counts[i]; ++j) {
                // Additive steps by powers of 1/1.2207 (of x^4 = x + 1) fill a cube evenly; the
                // cube is laid into the ball.
                constexpr double kSteps[3] = {0.8191725133961645, 0.6710436067037893,
                                              0.5497004779019703};
                std::array<double, 3> u{};
                for (std::size_t k = 0; k < 3; ++k)
                    u[k] = fraction(uniform_of_key(others, k) + double(j + 1) * kSteps[k]);
                auto on_sphere = [](double s, double t) {
                    const double z = 2 * s - 1, r = std::sqrt(std::max(0.0, 1 - z * z));
                    return Vec3d(r * math::cos(2 * kPi * t), r * math::sin(2 * kPi * t), z);
                };
                const std::uint64_t own = hash2(others, 16 + j);
                const double s = uniform_of_key(own, 0), t = uniform_of_key(own, 1);
                Vec3d normal;
                if (flat) {
                    const double a = planophile_angle(s);
                    normal = aslant(up, math::cos(a), math::sin(a), 2 * kPi * t);
                } else
                    normal = on_sphere(s, t);
                const Vec3d along = aslant(normal, 0, 1, 2 * kPi * uniform_of_key(yaws, j));
                const std::size_t leaf = first[i] + j;
                list.position[leaf] =
                    foliage.centre[i] +
                    on_sphere(u[0], u[1]) * (foliage.radius[i] * math::pow(u[2], 1.0 / 3));
                list.normal[leaf] = Vec3f(normal);
                list.orient[leaf] = quaternion(cross(along, normal), along, normal);
                list.pscale[leaf] = static_cast<float>(std::sqrt(area) / 2);
                list.area[leaf] = static_cast<float>(area);
                list.ball[leaf] = static_cast<std::int32_t>(i);
                list.species[leaf] = grove.plants()[tree].species;
                list.tree[leaf] = static_cast<std::int32_t>(tree);
            }
        },
        16);
    return list;
}

Canopy canopy(const Grove& grove, double voxel, const Progress& progress)
{
    if (!(voxel > 0 && std::isfinite(voxel)))
        throw InvalidParameter(fmt::format("tree: voxel of the canopy = {} m, must be > 0", voxel));
    const Foliage foliage(grove);
    const std::size_t n = foliage.size();

    // In voxels, from the lowest leaf. Balls hold the centre of one voxel at least.
    std::vector<Extent> extents(n);
    Bounds box;
    for (std::size_t i = 0; i < n; ++i) {
        const double r = std::max(foliage.radius[i] / voxel, 0.87);
        const Vec3d at = foliage.centre[i] / voxel;
        extents[i] = {at, at, r + 0.5};
        box.add(at - Vec3d(r + 1));
    }
    Vec3d lowest;
    if (n > 0)
        for (int k = 0; k < 3; ++k) lowest[k] = kLeafEdge * std::floor(box.lower[k] / kLeafEdge);
    for (Extent& e : extents) e.from -= lowest, e.to -= lowest;
    constexpr double kBytes = 3 * (4 * kLeafSize + 4 + sizeof(LeafMask) + 3 * sizeof(Coord));
    const LeafLists lists = leaf_lists(extents, kBytes, "tree: canopy", progress.slice(0, 0.2));

    // Share of a voxel that a ball covers, and so much that the leaves in all of them add up.
    auto cover = [&](std::size_t i, Coord c) {
        return std::clamp(extents[i].radius - length(centre_of(c) - extents[i].from), 0.0, 1.0);
    };
    std::vector<double> density(n);
    parallel_for(
        n,
        [&](std::size_t i) {
            progress.check();
            const Vec3d at = extents[i].from;
            Coord low, high;
            for (int k = 0; k < 3; ++k) {
                low[k] = static_cast<std::int32_t>(std::floor(at[k] - extents[i].radius));
                high[k] = static_cast<std::int32_t>(std::ceil(at[k] + extents[i].radius));
            }
            double sum = 0;
            for (std::int32_t x = low.x; x < high.x; ++x) {
                progress.check();
                for (std::int32_t y = low.y; y < high.y; ++y)
                    for (std::int32_t z = low.z; z < high.z; ++z) sum += cover(i, Coord(x, y, z));
            }
            density[i] = foliage.area[i] / (sum * voxel * voxel * voxel);
        },
        16);
    progress.update(0.4);

    const Transform transform{lowest * voxel, voxel};
    auto grid = [&] { return FloatGrid::uninitialised(lists.topology, transform, 0); };
    Canopy canopy{grid(), grid(), grid()};
    parallel_for(
        lists.topology->size(),
        [&](std::size_t leaf) {
            progress.check();
            std::array<double, kLeafSize> sum{}, light{};
            for (const std::uint32_t i : lists[leaf])
                for (int o = 0; o < kLeafSize; ++o) {
                    const double c = cover(i, leaf_coord(lists.topology->origin(leaf), o));
                    const auto k = static_cast<std::size_t>(o);
                    sum[k] += c * density[i];
                    if (c >= 0.5)
                        light[k] = std::max(light[k], grove.branches().light[foliage.branch[i]]);
                }
            for (int o = 0; o < kLeafSize; ++o) {
                const auto k = static_cast<std::size_t>(o);
                const auto lad = static_cast<float>(sum[k]);
                canopy.leaf_area_density.values(leaf)[o] = lad;
                canopy.drag.values(leaf)[o] = static_cast<float>(kCanopyDrag * double(lad));
                canopy.light.values(leaf)[o] = static_cast<float>(light[k]);
                if (lad > 0) {
                    canopy.leaf_area_density.mask(leaf).set(o);
                    canopy.drag.mask(leaf).set(o);
                }
                if (light[k] > 0) canopy.light.mask(leaf).set(o);
            }
        },
        4);
    for (FloatGrid* g : {&canopy.leaf_area_density, &canopy.drag, &canopy.light}) g->compress();
    progress.update(1);
    return canopy;
}

}  // namespace sekitei::tree
