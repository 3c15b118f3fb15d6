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

constexpr double kObstacleVoxel = 0.05, kAirVoxel = 0.25, kWaterVoxel = 0.05;  // [m]

/// Part of a crown: an ellipsoid of leaves.
struct Lump {
    Vec3d centre;
    double radius, height;

    bool contains(Vec3d p) const
    {
        const Vec3d d = p - centre;
        const double h = d.z / (height / 2);
        return (d.x * d.x + d.y * d.y) / (radius * radius) + h * h < 1;
    }
};

/// A tree as wind and light meet it.
struct Tree {
    Vec3d foot;
    double trunk_radius, trunk_height;
    std::vector<Lump> crown;
};

/// Trees stand beyond the pond from the east over the south to the west.
std::vector<Tree> trees(double distance, std::uint64_t seed)
{
    constexpr Stream kShape("garden tree");
    constexpr int kCount = 9, kLumps = 7;
    std::vector<Tree> list;
    for (int i = 0; i < kCount; ++i) {
        auto draw = [&, n = 0u](double low, double high) mutable {
            return low + (high - low) * uniform01(seed, kShape, std::uint64_t(i), n++);
        };
        // Azimuths from 70 (east-north-east) to 290 degrees, clockwise from north.
        const double azimuth = (70 + 220 * (i + draw(0.2, 0.8)) / kCount) * math::kPi / 180;
        const double away = distance + draw(0.8, 3.0);
        Tree tree{{away * math::sin(azimuth), away * math::cos(azimuth), 0},
                  draw(0.08, 0.13),
                  draw(2.0, 2.8),
                  {}};
        const double spread = draw(0.7, 1.1);
        for (int k = 0; k < kLumps; ++k) {
            const double angle = 2 * math::kPi * (k + draw(0, 0.7)) / (kLumps - 1);
            const double out = k == 0 ? 0 : spread * draw(0.7, 1.1);
            const double rise = k == 0 ? draw(0.9, 1.3) : draw(-0.2, 0.7);
            tree.crown.push_back({tree.foot + Vec3d(out * math::cos(angle), out * math::sin(angle),
                                                    tree.trunk_height + rise),
                                  draw(0.55, 0.95), draw(0.8, 1.3)});
        }
        list.push_back(std::move(tree));
    }
    return list;
}

/// A tapering trunk with twelve sides.
TriMesh trunk(const Tree& tree)
{
    constexpr std::uint32_t kSides = 12;
    TriMesh mesh;
    for (const bool top : {false, true})
        for (std::uint32_t k = 0; k < kSides; ++k) {
            const double angle = 2 * math::kPi * k / kSides;
            const double r = tree.trunk_radius * (top ? 0.6 : 1.15);
            mesh.vertices.push_back(
                Vec3f(tree.foot + Vec3d(r * math::cos(angle), r * math::sin(angle),
                                        top ? tree.trunk_height + 0.8 : -0.3)));
        }
    for (std::uint32_t k = 0; k < kSides; ++k) {
        const std::uint32_t n = (k + 1) % kSides;
        mesh.triangles.push_back({k, n, kSides + n});
        mesh.triangles.push_back({k, kSides + n, kSides + k});
        if (k > 0 && n != 0) {
            mesh.triangles.push_back({0, n, k});
            mesh.triangles.push_back({kSides, kSides + k, kSides + n});
        }
    }
    return mesh;
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
    const Transform transform{{}, kWaterVoxel};
    return grid_of<std::int32_t>(transform, {-reach, -reach, -kWaterVoxel}, {reach, reach, 0}, 0,
                                 [&](Coord c) {
                                     const Vec3d w = transform.world(centre_of(c));
                                     return c.z == -1 && inside(w.x, w.y) ? 1 : 0;
                                 });
}

/// Square clusters of leaves, most of them near the crown's skin where leaves get light.
Points leaves_of(const std::vector<Tree>& list, std::uint64_t seed)
{
    constexpr Stream kLeaf("garden leaf");
    constexpr std::uint64_t kLeaves = 800;  // of a lump
    Points points;
    std::vector<Vec3f> normals;
    std::vector<float> sizes;
    std::uint64_t id = 0;
    for (const Tree& tree : list)
        for (const Lump& lump : tree.crown)
            for (std::uint64_t k = 0; k < kLeaves; ++k, ++id) {
                auto draw = [&](std::uint64_t n) { return uniform01(seed, kLeaf, id, n); };
                const double z = 2 * draw(0) - 1, angle = 2 * math::kPi * draw(1);
                const double flat = std::sqrt(1 - z * z);
                const Vec3d way{flat * math::cos(angle), flat * math::sin(angle), z};
                const double depth = 0.5 + 0.55 * std::sqrt(draw(2));
                points.position.push_back(lump.centre + Vec3d(way.x * lump.radius * depth,
                                                              way.y * lump.radius * depth,
                                                              way.z * lump.height / 2 * depth));
                const Vec3d tilt = way * 0.5 + Vec3d(1.4 * (draw(3) - 0.5), 1.4 * (draw(4) - 0.5),
                                                     0.3 + 0.6 * draw(6));
                normals.push_back(Vec3f(tilt / length(tilt)));
                sizes.push_back(float(0.022 + 0.028 * draw(5)));
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
    // The box begins at the ground: below it the base goes on and has no cells.
    // A quarter of a cell apart from the lantern's planes, most of which lie on multiples of 1 cm:
    // a plane through cell centres would be inside or outside by rounding.
    const Transform transform{{-v * std::ceil(kLanternRadius / v + 6) - v / 4,
                               -v * std::ceil(kLanternRadius / v + 6) - v / 4, -v / 4},
                              v};
    const double width = 2 * (kLanternRadius / v + 6), height = kLanternHeight / v + 6;
    scene.domain = {{int(std::ceil(width)) + 1, int(std::ceil(width)) + 1, int(std::ceil(height))},
                    transform};
    scene.put("surface_sdf", level_set_from_mesh(lantern(6 * v), transform, progress.slice(0, 0.5)),
              "m", "lantern", GridClass::LevelSet);

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
            append(obstacles, trunk(tree));
            for (const Lump& lump : tree.crown)
                outer = std::max({outer, std::abs(lump.centre.x) + lump.radius,
                                  std::abs(lump.centre.y) + lump.radius});
        }
        const Transform air{{}, kAirVoxel};
        scene.put("canopy_RU",
                  grid_of<float>(air, {-outer, -outer, 0}, {outer, outer, 5}, 0.0f,
                                 [&](Coord c) {
                                     const Vec3d w = air.world(centre_of(c));
                                     for (const Tree& tree : grove)
                                         for (const Lump& lump : tree.crown)
                                             if (lump.contains(w)) return float(p.canopy_drag);
                                     return 0.0f;
                                 }),
                  "1/m", "lantern", GridClass::FogVolume);
        scene.points["leaves"] = leaves_of(grove, seed);
    }
    if (!obstacles.triangles.empty()) {
        // Planes on multiples of 10 cm would run through cell centres; see above.
        const Transform coarse{{kObstacleVoxel / 4, kObstacleVoxel / 4, kObstacleVoxel / 4},
                               kObstacleVoxel};
        scene.put("obstacle_sdf", level_set_from_mesh(obstacles, coarse, progress.slice(0.5, 1)),
                  "m", "lantern", GridClass::LevelSet);
    }
    if (pond) {
        const double islet = p.pond_distance;
        IntGrid surface = p.layout == Layout::Garden
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
