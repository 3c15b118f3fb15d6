#include "apps/garden/garden.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "apps/garden/lantern.h"
#include "core/math.h"
#include "core/random.h"
#include "grids/level_set.h"

namespace sekitei::garden {
namespace {

constexpr double kObstacleVoxel = 0.05, kAirVoxel = 0.25;  // [m]

/// A tree as wind and light meet it: a trunk and an ellipsoid of leaves.
struct Tree {
    Vec3d foot;
    double trunk_radius, crown_radius, crown_height, crown_centre;

    /// < 1 inside the crown.
    double crown(Vec3d p) const
    {
        const Vec3d d = p - foot;
        const double h = (d.z - crown_centre) / (crown_height / 2);
        return (d.x * d.x + d.y * d.y) / (crown_radius * crown_radius) + h * h;
    }
};

/// Trees stand beyond the pond from the east over the south to the west.
std::vector<Tree> trees(double distance, std::uint64_t seed)
{
    constexpr Stream kShape("garden tree");
    constexpr int kCount = 8;
    std::vector<Tree> list;
    for (int i = 0; i < kCount; ++i) {
        auto draw = [&, n = 0u](double low, double high) mutable {
            return low + (high - low) * uniform01(seed, kShape, std::uint64_t(i), n++);
        };
        // Azimuths from 70 (east-north-east) to 290 degrees, clockwise from north.
        const double azimuth = (70 + 220 * (i + draw(0.25, 0.75)) / kCount) * math::kPi / 180;
        const double away = distance + draw(0.8, 2.2);
        list.push_back({{away * math::sin(azimuth), away * math::cos(azimuth), 0},
                        draw(0.10, 0.16),
                        draw(1.1, 1.7),
                        draw(2.0, 3.0),
                        draw(2.6, 3.4)});
    }
    return list;
}

template <class T, class F>
LeafGrid<T> grid_of(const Transform& transform, Vec3d lower, Vec3d upper, T background, F&& value)
{
    const Vec3d a = transform.voxels(lower), b = transform.voxels(upper);
    std::vector<Coord> origins;
    auto first = [](double x) { return static_cast<int>(std::floor(x / kLeafEdge)) * kLeafEdge; };
    for (int x = first(a.x); x < b.x; x += kLeafEdge)
        for (int y = first(a.y); y < b.y; y += kLeafEdge)
            for (int z = first(a.z); z < b.z; z += kLeafEdge) origins.push_back({x, y, z});
    auto grid =
        LeafGrid<T>::uninitialised(LeafTopology::build(std::move(origins)), transform, background);
    parallel_for(grid.leaf_count(), [&](std::size_t leaf) {
        T* values = grid.values(leaf);
        for (int offset = 0; offset < kLeafSize; ++offset) {
            values[offset] = value(leaf_coord(grid.origin(leaf), offset));
            if (values[offset] != background) grid.mask(leaf).set(offset);
        }
    });
    grid.compress();
    return grid;
}

/// Water up to z = 0 where `inside` says so.
IntGrid water(const std::function<bool(double, double)>& inside, double reach)
{
    const Transform transform{{}, kAirVoxel};
    return grid_of<std::int32_t>(
        transform, {-reach, -reach, -kAirVoxel}, {reach, reach, 0}, 0, [&](Coord c) {
            const Vec3d w = transform.world(centre_of(c));
            return c.z == -1 && inside(w.x, w.y) ? 1 : 0;
        });
}

/// Square clusters of leaves, even in the crown's outer half where leaves get light.
Points leaves_of(const std::vector<Tree>& list, std::uint64_t seed)
{
    constexpr Stream kLeaf("garden leaf");
    constexpr int kLeaves = 1800;
    Points points;
    std::vector<Vec3f> normals;
    std::vector<float> sizes;
    for (std::size_t t = 0; t < list.size(); ++t)
        for (std::uint64_t k = 0; k < kLeaves; ++k) {
            auto draw = [&](std::uint64_t n) {
                return uniform01(seed, kLeaf, t * kLeaves + k, n);
            };
            const double z = 2 * draw(0) - 1, angle = 2 * math::kPi * draw(1);
            const double flat = std::sqrt(1 - z * z);
            const Vec3d way{flat * math::cos(angle), flat * math::sin(angle), z};
            const double depth = 0.55 + 0.45 * std::sqrt(draw(2));
            points.position.push_back(list[t].foot + Vec3d(0, 0, list[t].crown_centre) +
                                      Vec3d(way.x * list[t].crown_radius * depth,
                                            way.y * list[t].crown_radius * depth,
                                            way.z * list[t].crown_height / 2 * depth));
            const Vec3d tilt{draw(3) - 0.5, draw(4) - 0.5, 0.7};
            normals.push_back(Vec3f(tilt / length(tilt)));
            sizes.push_back(float(0.05 + 0.05 * draw(5)));
        }
    points.attributes["N"] = std::move(normals);
    points.attributes["pscale"] = std::move(sizes);
    points.stage = "lantern";
    return points;
}

}  // namespace

void validate(const Params& params)
{
    validate_described("lantern", params);
}

Scene make(const Params& p, std::uint64_t seed, const Progress& progress)
{
    Scene scene;
    const double v = p.cell;
    // A quarter of a cell apart from the lantern's planes, most of which lie on multiples of 1 cm:
    // a plane through cell centres would be inside or outside by rounding.
    const Transform transform{
        {-v * std::ceil(kLanternRadius / v + 6) - v / 4,
         -v * std::ceil(kLanternRadius / v + 6) - v / 4, -v * 10.25},
        v};
    const double width = 2 * (kLanternRadius / v + 6), height = kLanternHeight / v + 18;
    scene.domain = {{int(std::ceil(width)) + 1, int(std::ceil(width)) + 1, int(std::ceil(height))},
                    transform};
    scene.put("surface_sdf",
              level_set_from_mesh(lantern(6 * v), transform, progress.slice(0, 0.5)), "m",
              "lantern", GridClass::LevelSet);

    const bool pond = p.layout == Layout::Pond || p.layout == Layout::Garden;
    const double reach = p.layout == Layout::Garden ? p.pond_distance + p.pond_width : 0;
    TriMesh obstacles;
    if (p.layout == Layout::Fence || p.layout == Layout::SouthFence) {
        const double sign = p.layout == Layout::Fence ? 1 : -1;
        const double near = sign * p.fence_distance,
                     far = sign * (p.fence_distance + p.fence_thickness);
        append(obstacles, box({-p.fence_length / 2, std::min(near, far), -0.3},
                              {p.fence_length / 2, std::max(near, far), p.fence_height}));
    }
    if (p.layout == Layout::Garden) {
        const std::vector<Tree> grove = trees(reach, seed);
        double outer = 0;
        for (const Tree& tree : grove) {
            const double r = tree.trunk_radius;
            append(obstacles, box(tree.foot + Vec3d(-r, -r, -0.3),
                                  tree.foot + Vec3d(r, r, tree.crown_centre)));
            outer = std::max({outer, std::abs(tree.foot.x) + tree.crown_radius,
                              std::abs(tree.foot.y) + tree.crown_radius});
        }
        const Transform air{{}, kAirVoxel};
        scene.put("canopy_RU",
                  grid_of<float>(air, {-outer, -outer, 0}, {outer, outer, 5}, 0.0f,
                                 [&](Coord c) {
                                     const Vec3d w = air.world(centre_of(c));
                                     for (const Tree& tree : grove)
                                         if (tree.crown(w) < 1) return float(p.canopy_drag);
                                     return 0.0f;
                                 }),
                  "1/m", "lantern", GridClass::FogVolume);
        scene.points["leaves"] = leaves_of(grove, seed);
    }
    if (!obstacles.triangles.empty()) {
        // Planes on multiples of 10 cm would run through cell centres; see above.
        const Transform coarse{{kObstacleVoxel / 4, kObstacleVoxel / 4, kObstacleVoxel / 4},
                               kObstacleVoxel};
        scene.put("obstacle_sdf",
                  level_set_from_mesh(obstacles, coarse, progress.slice(0.5, 1)), "m", "lantern",
                  GridClass::LevelSet);
    }
    if (pond) {
        const double islet = p.pond_distance;
        IntGrid surface =
            p.layout == Layout::Garden
                ? water(
                        [&](double x, double y) {
                            const double r = std::sqrt(x * x + y * y);
                            return r > islet && r < reach;
                        },
                        reach + 1)
                : water(
                        [&](double x, double y) {
                            return x < -islet && x > -islet - p.pond_width &&
                                   std::abs(y) < p.pond_length / 2;
                        },
                        islet + p.pond_width + p.pond_length);
        scene.put("water_surface", std::move(surface), "lantern");
    }
    return scene;
}

}  // namespace sekitei::garden
