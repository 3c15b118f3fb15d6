#pragma once

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "apps/forest.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "grids/level_set.h"
#include "grids/scene.h"
#include "grids/surface_cells.h"

/// Scenes with much to export, made in a moment.
namespace sekitei::exchange {

/// Any unit quaternion.
inline std::array<float, 4> turn(double a, double b, double c)
{
    const double u = 2 * math::kPi * b, v = 2 * math::kPi * c, s = std::sqrt(1 - a),
                 t = std::sqrt(a);
    return {static_cast<float>(s * math::sin(u)), static_cast<float>(s * math::cos(u)),
            static_cast<float>(t * math::sin(v)), static_cast<float>(t * math::cos(v))};
}

/// Moss on a ball of radius 1 around (2, 3, 1), with what plants on meshes know.
inline Points moss(std::size_t count)
{
    constexpr Stream kAny{"test.exchange.moss"};
    Points points;
    points.stage = "moss";
    points.position.resize(count);
    std::vector<Vec3f> normal(count);
    std::vector<std::array<float, 4>> orient(count);
    std::vector<float> pscale(count), growth(count), wetness(count);
    std::vector<std::int32_t> species(count), age(count);
    std::vector<std::int64_t> id(count);
    parallel_for(
        count,
        [&](std::size_t i) {
            std::uint64_t k = 0;
            auto u = [&] { return uniform01(1, kAny, i, k++); };
            const double z = 2 * u() - 1, turned = 2 * math::kPi * u(), r = std::sqrt(1 - z * z);
            const Vec3d n(r * math::cos(turned), r * math::sin(turned), z);
            points.position[i] = Vec3d(2, 3, 1) + n;
            normal[i] = Vec3f(n);
            orient[i] = turn(u(), u(), u());
            growth[i] = static_cast<float>(2.4 * u());
            pscale[i] = std::min(1.0f, growth[i] / 2);
            wetness[i] = static_cast<float>(u());
            species[i] = static_cast<std::int32_t>(4 * u());
            age[i] = static_cast<std::int32_t>(1000 * u());
            id[i] = static_cast<std::int64_t>((i + 1) << 20 ^ i);
        },
        4096);
    points.attributes = {{"N", std::move(normal)},        {"orient", std::move(orient)},
                         {"pscale", std::move(pscale)},   {"growth", std::move(growth)},
                         {"wetness", std::move(wetness)}, {"species", std::move(species)},
                         {"age", std::move(age)},         {"id", std::move(id)}};
    return points;
}

/// Leaves as lanterns' crowns and trees have them.
inline Points leaves(std::size_t count, bool turned)
{
    constexpr Stream kAny{"test.exchange.leaves"};
    Points points;
    std::vector<Vec3f> normal;
    std::vector<std::array<float, 4>> orient;
    std::vector<float> pscale;
    for (std::size_t i = 0; i < count; ++i) {
        std::uint64_t k = 0;
        auto u = [&] { return uniform01(1, kAny, i, k++); };
        points.position.emplace_back(4 * u(), 4 * u(), 2 + 3 * u());
        normal.push_back(Vec3f(normalized(Vec3d(u() - 0.5, u() - 0.5, u()))));
        orient.push_back(turn(u(), u(), u()));
        pscale.push_back(static_cast<float>(0.02 + 0.02 * u()));
    }
    points.attributes = {{"N", std::move(normal)}, {"pscale", std::move(pscale)}};
    if (turned) points.attributes["orient"] = std::move(orient);
    return points;
}

/// A forest of young beeches and pines.
inline void put_forest(Scene& scene, std::size_t count)
{
    constexpr Stream kAny{"test.exchange.forest"};
    apps::ForestRecord record;
    record.width = record.depth = 1000;
    record.species.resize(1);
    record.models.kinds = {"beech", "pine"};
    record.models.variants = 1;
    record.models.generations = {8, 12};
    FloatGrid height(LeafTopology::build({Coord(0, 0, 0)}), {{}, 4.0}, 0);
    height.mask(0).set(0);
    scene.put("canopy_height", std::move(height), "m", "forest");
    scene.grids.at("canopy_height").extra[apps::kForestSettings] = apps::forest_settings(record);
    Points points;
    points.stage = "forest";
    points.position.resize(count);
    std::vector<std::array<float, 4>> orient(count);
    std::vector<Vec3f> scale(count);
    std::vector<float> tall(count), pscale(count, 1);
    std::vector<std::int32_t> model(count), species(count), age(count);
    std::vector<std::int64_t> id(count);
    parallel_for(
        count,
        [&](std::size_t i) {
            std::uint64_t k = 0;
            auto u = [&] { return uniform01(1, kAny, i, k++); };
            points.position[i] = {1000 * u(), 1000 * u(), 0};
            const double half = math::kPi * u();
            orient[i] = {0, 0, static_cast<float>(math::sin(half)),
                         static_cast<float>(math::cos(half))};
            tall[i] = static_cast<float>(4 + 12 * u());
            scale[i] = {0.9f * tall[i], 0.9f * tall[i], tall[i]};
            model[i] = static_cast<std::int32_t>(4 * u());
            species[i] = 0;
            age[i] = static_cast<std::int32_t>(40 * u());
            id[i] = static_cast<std::int64_t>(hash2(7, i));
        },
        4096);
    points.attributes = {{"orient", std::move(orient)}, {"scale", std::move(scale)},
                         {"pscale", std::move(pscale)}, {"height", std::move(tall)},
                         {"model", std::move(model)},   {"species", std::move(species)},
                         {"age", std::move(age)},       {"id", std::move(id)}};
    scene.points["forest_instances"] = std::move(points);
}

/// The ball as a level set with fields on its surface cells: `level` = z of their centres [m],
/// `upper` (int32) = 1 above the middle, and `patch`, which is known on the eastern half alone.
inline Scene ball(double voxel = 0.1)
{
    Scene scene;
    scene.domain.transform = {{0.5, 1.5, -0.5}, voxel};
    const int n = static_cast<int>(std::lround(3 / voxel));
    scene.domain.dims = {n, n, n};
    const Transform lattice = scene.domain.transform;
    scene.put(
        "surface_sdf",
        level_set_from_function(
            scene.domain,
            [&](Vec3d p) { return (length(lattice.world(p) - Vec3d(2, 3, 1)) - 1) / voxel; }, {}),
        "m", "test", GridClass::LevelSet);
    const SurfaceCells cells = surface_cells(scene.floats("surface_sdf"), {});
    std::vector<float> height, patch;
    std::vector<std::int32_t> upper;
    for (const Vec3d& p : cells.position) {
        height.push_back(static_cast<float>(p.z));
        upper.push_back(p.z > 1);
        patch.push_back(static_cast<float>(p.y));
    }
    scene.put("surf_area", cells.to_grid(cells.area), "m^2", "test");
    scene.put("level", cells.to_grid(height), "m", "test");
    scene.put("upper", cells.to_grid(upper), "test");
    FloatGrid half = cells.to_grid(patch);
    for (std::size_t leaf = 0; leaf < half.leaf_count(); ++leaf) {
        const LeafMask mask = half.mask(leaf);
        mask.for_each([&](int offset) {
            const Vec3d at = lattice.world(centre_of(leaf_coord(half.origin(leaf), offset)));
            if (at.x < 2) half.mask(leaf).reset(offset);
        });
    }
    scene.put("patch", std::move(half), "K", "test");
    return scene;
}

}  // namespace sekitei::exchange
