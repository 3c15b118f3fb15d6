// Trees in scenes: what growth goes on from, files of it, and criteria.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "apps/stage.h"
#include "apps/stages/compare_lines.h"
#include "apps/stages/scenery.h"
#include "apps/trees.h"
#include "core/error.h"
#include "grids/level_set.h"
#include "grids/vdb_file.h"
#include "solvers/tree/wood.h"
#include "tests/support/shapes.h"
#include "tests/support/temporary_folder.h"

namespace sekitei::apps {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

/// A scene that the stage made.
Scene grown(std::initializer_list<std::pair<const char*, Json>> params, std::uint64_t seed = 4,
            Scene scene = {})
{
    const auto stage = make_stage("tree");
    const ParamList list = stage->params();
    for (const auto& [name, value] : params) find_param(list, name)->set(value);
    stage->validate();
    StageContext context;
    context.seed = seed;
    stage->run(scene, context);
    scene.history.push_back(history_of(*stage, context));
    return scene;
}

void expect_equal(const GroveRecord& a, const GroveRecord& b)
{
    EXPECT_EQ(a.state.generation, b.state.generation);
    EXPECT_EQ(a.state.seed, b.state.seed);
    EXPECT_EQ(a.state.next_root, b.state.next_root);
    EXPECT_TRUE(a.state.branches == b.state.branches);
    EXPECT_EQ(a.state.tips, b.state.tips);
    EXPECT_TRUE(a.state.buds == b.state.buds);
    ASSERT_EQ(a.state.plants.size(), b.state.plants.size());
    for (std::size_t k = 0; k < a.state.plants.size(); ++k) {
        EXPECT_EQ(a.state.plants[k].origin, b.state.plants[k].origin);
        EXPECT_EQ(a.state.plants[k].species, b.state.plants[k].species);
        EXPECT_EQ(a.state.plants[k].from, b.state.plants[k].from);
    }
}

TEST(TreeStage, EveryBitOfAGroveComesBackFromItsScene)
{
    tree::GroveParams params;
    params.unit_length = 0.13;  // no power of two: metres are rounded
    params.keep_tips = {3, 5};
    std::vector<tree::Species> species{preset_trees()[0], preset_trees()[0]};
    species[0].latent_share = 0.5;
    species[0].dead_persist = 5;
    species[1].model = tree::Model::Shoot;
    species[1].buds = 9;
    species[1].stagger = 12;
    params.keep_tips.clear();
    tree::Grove grove(params, species, {{{0.1, 0.2, 0}, 0, 2}, {{7, 1, 0.3}, 1, 0}}, 77);
    grove.grow(7);
    ASSERT_FALSE(grove.state().buds.empty());
    const std::vector<double> radius =
        tree::thickness(grove.branches(), grove.species(), grove.plants());
    Scene scene;
    put_grove(scene, grove, radius);
    scene.put("canopy_lad", tree::canopy(grove, 0.1, {}).leaf_area_density, "1/m", "tree",
              GridClass::FogVolume);
    scene.grids.at("canopy_lad").extra["tree"] = grove_settings(grove);
    const TemporaryFolder folder;
    write_vdb(folder.path() / "t.vdb", scene);
    const GroveRecord back = grove_record(read_vdb(folder.path() / "t.vdb"));
    expect_equal(back, {params, species, grove.state()});
    EXPECT_EQ(back.params.unit_length, 0.13);
    EXPECT_EQ(back.species[1].stagger, 12);
    EXPECT_EQ(back.species[0].dead_persist, 5);
    // And goes on to the same bits.
    tree::Grove other(back.params, back.species, back.state);
    other.grow(6);
    grove.grow(6);
    EXPECT_TRUE(other.branches() == grove.branches());
}

TEST(TreeStage, ScenesThatAreNoGroveAreRefused)
{
    const Scene scene = grown({{"generations", 6}});
    EXPECT_NO_THROW(grove_record(scene));
    auto broken = [&](auto&& change, const char* word) {
        Scene other = scene;
        change(other);
        EXPECT_THAT([&] { grove_record(other); }, ThrowsMessage<InvalidInput>(HasSubstr(word)));
    };
    auto ints = [](Scene& s, const char* set, const char* name) -> std::vector<std::int32_t>& {
        return std::get<std::vector<std::int32_t>>(s.points.at(set).attributes.at(name));
    };
    broken([](Scene& s) { s.grids.erase("canopy_lad"); }, "canopy_lad");
    broken([](Scene& s) { s.grids.at("canopy_lad").extra["tree"] = "{"; }, "damaged");
    broken([](Scene& s) { s.points.at("tree_skeleton").attributes.erase("key"); }, "key");
    broken([&](Scene& s) { ints(s, "tree_skeleton", "parent")[3] = 3; }, "parent");
    broken([&](Scene& s) { ints(s, "tree_skeleton", "tree")[2] = 5; }, "tree 5");
    broken([&](Scene& s) { ints(s, "trees", "species")[0] = 1; }, "species");
    broken([&](Scene& s) { ints(s, "tree_skeleton", "tip").back() = 1000; }, "tips");
}

TEST(TreeStage, WhatIsGivenLaterReplacesWhatTheTreesGrewWith)
{
    const Scene young = grown({{"generations", 8}, {"tropism", 0.1}, {"species", "oak"}}, 9);
    const GroveRecord kept = grove_record(grown({{"generations", 3}}, 1, young));
    EXPECT_EQ(kept.species[0].tropism, 0.1);
    EXPECT_EQ(kept.species[0].branch_angle, 16);
    EXPECT_EQ(kept.state.seed, 9u);
    EXPECT_EQ(kept.state.generation, 11);
    const GroveRecord turned = grove_record(
        grown({{"generations", 3}, {"tropism", 0.9}, {"transmission", 0.8}}, 1, young));
    EXPECT_EQ(turned.species[0].tropism, 0.9);
    EXPECT_EQ(turned.species[0].branch_angle, 16);
    EXPECT_EQ(turned.params.transmission, 0.8);
    const GroveRecord joined = grove_record(
        grown({{"generations", 3}, {"origin", "3m,0m,0m"}, {"species", "pine"}}, 1, young));
    ASSERT_EQ(joined.species.size(), 2u);
    EXPECT_EQ(joined.species[1].model, tree::Model::Conifer);
    EXPECT_EQ(joined.state.plants[1].species, 1);
}

TEST(TreeStage, OriginsAreMetresAndTreesTellTheirSize)
{
    const Scene scene =
        grown({{"generations", 10}, {"origin", "150cm,2m,0; -1,0,0.5m"}, {"unit_length", 0.1}});
    const Points& plants = scene.points.at("trees");
    EXPECT_NEAR(plants.position[0].x, 1.5, 1e-12);
    EXPECT_NEAR(plants.position[1].z, 0.5, 1e-12);
    const auto& height = *plants.values<float>("height");
    const auto& wide = *plants.values<float>("crown_radius");
    EXPECT_GT(height[0], 1.5f);  // a first branch of 15 units
    EXPECT_LT(height[0], 2.5f);
    EXPECT_GT(wide[0], 0.2f);
    EXPECT_LT(wide[0], 1.2f);
    // Leaves hold the area that light says they have: 0.0265 m^2 for a ball of 0.2 m.
    double area = 0;
    for (const float a : *scene.points.at("leaves").values<float>("area")) area += double(a);
    const auto tips = grove_record(scene).state.tips.size();
    EXPECT_NEAR(area, double(tips) * tree::leaf_area(0.2, 0.9, 0.5), 1e-3 * area);
}

TEST(TreeStage, LeavesAreDrawnWithTheirArea)
{
    const Scene scene =
        grown({{"generations", 8}, {"species", "pine,beech"}, {"origin", "0,0,0; 5,0,0"}});
    const std::vector<Crown> list = crowns(scene);
    ASSERT_EQ(list.size(), 2u);
    EXPECT_TRUE(list[0].needles);
    EXPECT_EQ(list[1].species, "beech");
    double drawn = 0, wanted = 0;
    for (const Crown& crown : list) {
        drawn += crown.leaves.area();
        EXPECT_EQ(crown.leaves.triangles.size(), crown.leaves.vertices.size() / 6 * 4);
    }
    for (const float a : *scene.points.at("leaves").values<float>("area")) wanted += double(a);
    EXPECT_GT(drawn, wanted);  // bent a little
    EXPECT_LT(drawn, 1.25 * wanted);
    EXPECT_NEAR(leaf_mesh(scene).area(), drawn, 1e-3 * drawn);
    double larger = 0;
    for (const Crown& crown : crowns(scene, 2)) larger += crown.leaves.area();
    EXPECT_NEAR(larger, 4 * drawn, 1e-3 * larger);
    EXPECT_TRUE(inspect(bark_mesh(scene, {})).closed());
}

TEST(TreeStage, SketchesShowTheDeadInGreyAndOneScaleForAll)
{
    const Scene small = grown({{"generations", 6}}), large = grown({{"generations", 24}});
    auto ink = [](const Image8& image, int from, int to) {
        double sum = 0;
        for (int y = 0; y < image.height; ++y)
            for (int x = from; x < to; ++x) sum += 255 - image.at(x, y, 0);
        return sum;
    };
    const auto stage = make_stage("sketch");
    find_param(stage->params(), "size")->set(120);
    find_param(stage->params(), "labels")->set(false);
    stage->run_many({{"small", small}, {"large", large}}, {});
    ASSERT_EQ(stage->picture.width, 240);
    EXPECT_LT(ink(stage->picture, 0, 120), 0.5 * ink(stage->picture, 120, 240));
    find_param(stage->params(), "rows")->set(Json::array({1, 1}));
    stage->run_many({{"small", small}, {"large", large}}, {});
    EXPECT_EQ(stage->picture.width, 120);
    EXPECT_THAT(
        [&] {
            stage->run_many({{"bare", Scene{}}}, {});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("bare")));
}

TEST(TreeStage, CriteriaNameTheSceneThatIsMissing)
{
    std::vector<std::pair<std::string, Scene>> scenes;
    const std::pair<const char*, double> thresholds[] = {
        {"fig13a", 0.7}, {"fig13b", 0.6}, {"fig13c", 0.5}};
    for (const auto& [name, threshold] : thresholds)
        scenes.emplace_back(
            name, grown({{"death_threshold", threshold}, {"ground", false}, {"leaves", false}}, 1));
    const std::vector<Line> lines = tree_lines(13, scenes);
    std::size_t bounded = 0;
    for (const Line& line : lines)
        if (line.bounded()) {
            ++bounded;
            EXPECT_TRUE(line.holds()) << line.measure << " " << line.scene;
        }
    EXPECT_EQ(bounded, 6u);
    // The other way round none of them does.
    std::swap(scenes[0].first, scenes[2].first);
    for (const Line& line : tree_lines(13, scenes))
        if (line.bounded()) {
            EXPECT_FALSE(line.holds()) << line.measure << " " << line.scene;
        }
    scenes.pop_back();
    EXPECT_THAT([&] { tree_lines(13, scenes); }, ThrowsMessage<InvalidInput>(HasSubstr("fig13a")));
    EXPECT_THROW(tree_lines(2, scenes), InvalidParameter);
}

TEST(TreeStage, PresetsAreTheFilesOfTheDataFolder)
{
    for (tree::Species preset : preset_trees()) {
        tree::Species file = find_tree(preset.name + ".toml", SEKITEI_DATA "/trees");
        EXPECT_EQ(params_json(describe_params(file)), params_json(describe_params(preset)))
            << preset.name;
    }
    EXPECT_THAT([] { find_tree("oka", {}); }, ThrowsMessage<InvalidParameter>(HasSubstr("'oak'")));
}

/// A wall's distance from a place, for walls of x in [1, 1.4].
double from_wall(Vec3d at)
{
    const Vec3d low(1, -2.2, -0.5), high(1.4, 2.2, 4.5);
    Vec3d out;
    for (int axis = 0; axis < 3; ++axis)
        out[axis] = std::max({low[axis] - at[axis], at[axis] - high[axis], 0.0});
    return length(out);
}

TEST(TreeStage, TipsKeepClearOfThinBandsToo)
{
    // Bands of voxels of 1.5 cm tell 3.4 cm, the clearance is 10 cm.
    for (const double voxel : {0.015, 0.1}) {
        Scene scene;
        const Vec3d lower(0.6, -2.6, -0.9);
        scene.put(
            "obstacle_sdf",
            level_set_from_mesh(shapes::box({1, -2.2, -0.5}, {1.4, 2.2, 4.5}), {lower, voxel}, {}),
            "m", "lantern", GridClass::LevelSet);
        const Scene made = grown({{"generations", 30},
                                  {"clearance", 0.5},
                                  {"obstacle_albedo", 1.0},
                                  {"leaves", false},
                                  {"first_length", 5}},
                                 4, std::move(scene));
        const Points& ends = made.points_of("tree_skeleton");
        std::size_t near = 0;
        for (const Vec3d& end : ends.position) {
            EXPECT_GE(from_wall(end), 0.1 - 0.5 * voxel - 1e-3);
            near += from_wall(end) < 0.35;
        }
        EXPECT_GT(near, 0u) << ends.position.size();
    }
}

}  // namespace
}  // namespace sekitei::apps
