// What light and wind meet of a forest, and trees grown in place in it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numeric>

#include "apps/forest.h"
#include "apps/forest_instances.h"
#include "core/error.h"
#include "solvers/forest/canopy.h"
#include "solvers/wind/wind.h"
#include "tests/apps/climate_scenes.h"

namespace sekitei::apps {
namespace {

using namespace sekitei::apps::testing;

/// The canopy of a grown stand, which stands on `ground` [m] around the origin.
forest::Canopy stand(double ground)
{
    forest::Inputs inputs;
    inputs.width = inputs.depth = 64;
    inputs.species = forest::table_species();
    forest::Forest forest(inputs);
    forest.sow({20, 20, 20, 20, 20, 20});
    for (int n = 0; n < 12; ++n) forest.advance();
    return forest::canopy(forest, {}, {-32, -32, ground});
}

double mean_of(const Scene& scene, const std::string& name)
{
    const SurfaceCells cells = cells_of(scene);
    const std::vector<float> values = cells.from_grid(scene.floats(name), 0);
    return std::accumulate(values.begin(), values.end(), 0.0) / double(values.size());
}

TEST(ForestFields, LeavesShadeTheGround)
{
    Habitat habitat;
    // 6 m x 5 m of ground at z = 0.5 in the middle of the stand.
    const auto ground = [] {
        return body(0.25, {-3, -2.5, 0}, {6, 5, 1}, [](Vec3d p) { return p.z - 0.5; });
    };
    const std::string weather =
        weather_csv(10, [](int) { return Sky{.global = 200, .diffuse = 90}; });
    Scene open = ground(), shaded = ground(), ignored = ground();
    const forest::Canopy canopy = stand(0.5);
    for (Scene* scene : {&shaded, &ignored})
        scene->put("canopy_lad", canopy.leaf_area_density, "1/m", "forest", GridClass::FogVolume);
    habitat.light(open, weather);
    habitat.light(shaded, weather);
    habitat.light(ignored, weather, {{"canopy_extinction", 0}});
    EXPECT_EQ(content_hash(ignored.grids.at("light_S")), content_hash(open.grids.at("light_S")));
    EXPECT_EQ(content_hash(ignored.points.at("daylight")),
              content_hash(open.points.at("daylight")));

    // Sky from all around comes a longer way than straight down.
    double down = 0;
    for (int i = -3; i < 3; ++i)
        for (int j = -2; j < 3; ++j)
            down += double(canopy.ground_transmittance.value({32 + i, 32 + j, 0})) / 30;
    ASSERT_LT(down, 0.5);
    const double view = mean_of(shaded, "sky_view");
    EXPECT_GT(view, 0.2 * down);
    EXPECT_LT(view, down + 0.05);
    EXPECT_NEAR(mean_of(shaded, "light_sky") / mean_of(open, "light_sky"), view, 1e-3);
    const double sun = mean_of(shaded, "light_direct") / mean_of(open, "light_direct");
    EXPECT_GT(sun, 0);
    EXPECT_LT(sun, down + 0.05);
    EXPECT_LT(mean_of(shaded, "light_S"), 0.6 * mean_of(open, "light_S"));
    EXPECT_NEAR(mean_of(shaded, "rain_exposure"), mean_of(open, "rain_exposure"), 1e-6);
}

TEST(ForestFields, SingleLeavesShadeInTheirOwnWay)
{
    // The fog of leaves that are there one by one is not taken for more of them.
    Habitat habitat;
    const std::string weather = weather_csv(2, [](int) { return Sky{}; });
    Scene bare = plane(), both = plane();
    Points leaves;
    leaves.position = {{0.8, 0.2, 0.9}};
    leaves.attributes["N"] = std::vector<Vec3f>{{0, 0, 1}};
    leaves.attributes["pscale"] = std::vector<float>{0.2f};
    for (Scene* scene : {&bare, &both}) scene->points["leaves"] = leaves;
    const forest::Canopy canopy = stand(0.5);
    both.put("canopy_lad", canopy.leaf_area_density, "1/m", "tree", GridClass::FogVolume);
    habitat.light(bare, weather);
    habitat.light(both, weather);
    EXPECT_EQ(content_hash(both.grids.at("light_S")), content_hash(bare.grids.at("light_S")));
    // Those of single trees in a forest are part of its fog.
    both.put("canopy_height", canopy.height, "m", "forest");
    habitat.light(both, weather);
    EXPECT_LT(mean_of(both, "sky_view"), 0.7 * mean_of(bare, "sky_view"));
}

TEST(ForestFields, TheWindHasAWayOverTheTrees)
{
    const Scene rock = body(0.25, {-2, -2, 0}, {4, 4, 3}, [](Vec3d p) {
        return box_distance(p, {0, 0, 0.5}, {0.6, 0.6, 0.6});
    });
    const forest::Canopy canopy = stand(0);
    const std::vector<Vec3d> cells{{-0.6, 0, 0.1}, {0.6, 0, 1.1}};
    wind::Inputs inputs{.object = &rock.floats("surface_sdf"), .cells = cells};
    const Vec3d open = wind::plan(inputs, {.ground = 0.0}).garden_size;
    EXPECT_EQ(open, Vec3d(24, 16, 8));
    inputs.canopy = &canopy.drag;
    double top = 0;
    for (int i = 0; i < 64; ++i)
        for (int j = 0; j < 64; ++j) top = std::max(top, double(canopy.height.value({i, j, 0})));
    ASSERT_GT(top, 15);
    const wind::Plan plan = wind::plan(inputs, {.ground = 0.0});
    EXPECT_GT(plan.garden_size.z, 1.8 * top);
    EXPECT_LT(plan.garden_size.z, 2.2 * top + 1);
    EXPECT_GT(plan.garden_size.x, plan.garden_size.y);
    // What is asked for stays; bushes are no trees.
    EXPECT_EQ(wind::plan(inputs, {.garden_size = Vec3d(30, 20, 10), .ground = 0.0}).garden_size,
              Vec3d(30, 20, 10));
    FloatGrid bush(LeafTopology::build({{0, 0, 0}}), {{3, 3, 0}, 0.5}, 0);
    bush.set_constant(0, 0.5f);
    bush.mask(0) = LeafMask::full();
    inputs.canopy = &bush;
    EXPECT_EQ(wind::plan(inputs, {.ground = 0.0}).garden_size, open);
}

double sum_of(const FloatGrid& grid)
{
    double sum = 0;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.mask(leaf).for_each([&](int o) { sum += double(grid.at(leaf, o)); });
    return sum * std::pow(grid.transform().voxel, 3);
}

/// A stand whose two highest trees are not grown yet.
Scene wood(Habitat& habitat, std::string heroes = "")
{
    Scene scene;
    if (heroes.empty()) {
        // Where they are, that of all of it tells.
        scene = wood(habitat, "100.5,50.2");
        std::vector<forest::Instance> all =
            instances_of(scene.points_of("forest_instances"), "forest_instances");
        std::ranges::sort(all, [](const auto& a, const auto& b) { return a.height > b.height; });
        for (const auto& t : {all[0], all[1]})
            heroes += fmt::format("{},{};", t.position.x, t.position.y);
        scene = {};
    }
    run(scene, "forest",
        {{"size", {40, 48}},
         {"corner", {100.3, 50, 8}},
         {"steps", 8},
         {"initial", "20"},
         {"ages", {6, 12}},
         {"variants", 1},
         {"heroes", heroes}},
        habitat.context());
    return scene;
}

TEST(ForestFields, SingleTreesGrowInPlace)
{
    Habitat habitat;
    Scene scene = wood(habitat);
    const Points heroes = scene.points_of("forest_heroes");
    ASSERT_EQ(heroes.position.size(), 2u);
    const FloatGrid others = scene.floats("canopy_lad");
    const std::string settings = forest_settings(forest_record(scene));
    const Json summary = run(scene, "tree", {{"generations", 16}}, habitat.context());

    // Each where it stood, and about as high.
    const Points& trees = scene.points_of("trees");
    ASSERT_EQ(trees.position.size(), 2u);
    const auto& wanted = *heroes.values<float>("height");
    const auto& found = *trees.values<float>("height");
    for (std::size_t k = 0; k < 2; ++k) {
        EXPECT_LT(length(trees.position[k] - heroes.position[k]), 1e-9);
        EXPECT_GT(found[k], 0.5 * double(wanted[k]));
        EXPECT_LT(found[k], 1.15 * double(wanted[k]));
    }
    EXPECT_EQ(summary["heroes"], 2);
    EXPECT_EQ(summary["generation"], 16);

    // Their leaves are part of the forest's, on its voxels; nothing else of it changes.
    const FloatGrid& lad = scene.floats("canopy_lad");
    EXPECT_EQ(lad.transform(), others.transform());
    const double leaves = summary["leaf_area_m2"].get<double>();
    ASSERT_GT(leaves, 1);
    EXPECT_NEAR(sum_of(lad) - sum_of(others), leaves, 0.01 * leaves);
    EXPECT_EQ(content_hash(Grid{others, {}, {}, {}, {}, {}}),
              content_hash(Grid{scene.floats("forest_lad"), {}, {}, {}, {}, {}}));
    EXPECT_EQ(forest_settings(forest_record(scene)), settings);
    const FloatGrid &drag = scene.floats("canopy_RU"),
                    &through = scene.floats("canopy_transmittance"),
                    &ground = scene.floats("ground_transmittance");
    EXPECT_EQ(drag.active_count(), lad.active_count());
    for (int i = 0; i < 40; ++i)
        for (int j = 0; j < 48; ++j) {
            double depth = 0;
            for (int z = 24; z > 0; --z) {
                const double here = double(lad.value({i, j, z}));
                ASSERT_EQ(drag.value({i, j, z}), float(0.2 * here));
                ASSERT_NEAR(double(through.value({i, j, z})), std::exp(-0.5 * (depth + here / 2)),
                            1e-6);
                depth += here;
            }
            ASSERT_NEAR(double(ground.value({i, j, 0})), std::exp(-0.5 * depth), 1e-6);
        }

    // Growing on replaces their leaves and does not add them once more.
    run(scene, "tree", {{"generations", 1}, {"leaves", false}}, habitat.context());
    EXPECT_EQ(scene.points_of("trees").position.size(), 2u);
    EXPECT_LT(sum_of(scene.floats("canopy_lad")) - sum_of(others), 1.5 * leaves);
    EXPECT_EQ(content_hash(Grid{others, {}, {}, {}, {}, {}}),
              content_hash(Grid{scene.floats("forest_lad"), {}, {}, {}, {}, {}}));
}

TEST(ForestFields, LowerTreesBeginLater)
{
    Habitat habitat;
    Scene scene = wood(habitat);
    // In the open, so that none dies.
    const FloatGrid none(LeafTopology::build({}), scene.floats("canopy_lad").transform(), 0);
    scene.put("canopy_lad", none, "1/m", "forest", GridClass::FogVolume);
    auto& wanted =
        std::get<std::vector<float>>(scene.points.at("forest_heroes").attributes.at("height"));
    wanted = {12, 5};
    run(scene, "tree", {{"generations", 20}}, habitat.context());
    const Points& trees = scene.points_of("trees");
    const auto& from = *trees.values<std::int32_t>("from");
    EXPECT_LT(from[0], 4);
    EXPECT_GT(from[1], 8);
    for (std::size_t k = 0; k < 2; ++k)
        EXPECT_NEAR((*trees.values<float>("height"))[k] / wanted[k], 1, 0.15);
}

TEST(ForestFields, OtherTreesShadeThem)
{
    Habitat habitat;
    Scene shaded = wood(habitat);
    Scene bright = shaded;
    // Without the others' leaves.
    FloatGrid none(LeafTopology::build({}), bright.floats("canopy_lad").transform(), 0);
    bright.put("canopy_lad", none, "1/m", "forest", GridClass::FogVolume);
    const Json a = run(shaded, "tree", {{"generations", 14}}, habitat.context()),
               b = run(bright, "tree", {{"generations", 14}}, habitat.context());
    EXPECT_NE(a["tips"], b["tips"]);
    // heroes = false leaves them alone.
    Scene empty = wood(habitat);
    const Json c =
        run(empty, "tree", {{"generations", 2}, {"heroes", false}, {"origin", "105m,60m,8m"}},
            habitat.context());
    EXPECT_EQ(c["trees"], 1);
    EXPECT_FALSE(c.contains("heroes"));
}

TEST(ForestFields, DamagedHeroesAreNamed)
{
    Habitat habitat;
    const Scene scene = wood(habitat);
    auto broken = [&](auto&& change, const char* word) {
        Scene other = scene;
        change(other.points.at("forest_heroes").attributes);
        EXPECT_THAT(
            [&] {
                run(other, "tree", {{"generations", 4}}, habitat.context());
            },
            ::testing::ThrowsMessage<InvalidInput>(::testing::HasSubstr(word)));
    };
    broken([](auto& a) { std::get<std::vector<std::int32_t>>(a.at("model"))[0] = 99; },
           "has the model 99");
    broken([](auto& a) { std::get<std::vector<float>>(a.at("height"))[0] = -2; }, "is -2 m high");
    broken([](auto& a) { a.erase("id"); }, "no attribute 'id'");
}

}  // namespace
}  // namespace sekitei::apps
