#include "apps/scene_items.h"

#include <gmock/gmock.h>

#include <map>
#include <set>

#include "core/mesh_io.h"

namespace sekitei::apps {
namespace {

using Values = std::map<std::string, Json>;

/// Lets a stage work on a scene with a few values other than the defaults.
void work(Scene& scene, const std::string& name, const Values& values, bool on_mesh = false)
{
    const auto stage = make_stage(name);
    stage->meets_mesh(on_mesh);
    for (const auto& [key, value] : values) find_param(stage->params(), key)->set(value);
    stage->validate();
    StageContext context;
    context.seed = 3;
    context.folder = std::filesystem::path(SEKITEI_DATA) / "recipes";
    stage->check_files(context);
    SceneOutline outline;
    stage->estimate(outline, context);
    const HistoryEntry entry = history_of(*stage, context);
    stage->run(scene, context);
    scene.history.push_back(entry);
}

Scene rock()
{
    Scene scene;
    work(scene, "lava",
         {{"preset", "slab"},
          {"size", {1.6, 1.6, 1.6}},
          {"voxel", 0.04},
          {"heat_cell", 0.16},
          {"noise_amplitude", 0}});
    work(scene, "cool", {{"steps", 40}});
    work(scene, "joint", {{"spacing", 0.4}});
    work(scene, "weather", {{"cut", "perpendicular"}});
    work(scene, "mesh", {});
    return scene;
}

const char* const kMorioka = "../weather/morioka-normals.csv";

Scene garden()
{
    Scene scene;
    work(scene, "lantern", {{"cell", 0.1}});
    work(scene, "light", {{"weather", kMorioka}, {"days", 2}});
    work(scene, "wind",
         {{"per_layer", true},
          {"settle", 1},
          {"duration", 1},
          {"garden_spacing", 1},
          {"object_spacing", 0.2}});
    work(scene, "soil", {});
    work(scene, "moss", {{"species", "bryum,hypnum"}});
    // Wind around all that stands in a garden takes too long for a test.
    work(scene, "lantern", {{"layout", "garden"}, {"cell", 0.1}});
    return scene;
}

Scene boulder()
{
    Scene scene;
    scene.meshes["rock"] =
        read_mesh(std::filesystem::path(SEKITEI_DATA) / "meshes" / "boulder.ply");
    auto& zone = scene.meshes["rock"].face_attributes["zone"];
    zone = std::vector<std::int32_t>(scene.meshes["rock"].triangles.size(), 1);
    work(scene, "light", {{"photons", 2000}, {"keep_photons", true}, {"site", 0.2}, {"cell", 0.2}},
         true);
    Scene fresh;
    fresh.meshes["rock"] = scene.meshes["rock"];
    work(fresh, "moss",
         {{"weather", kMorioka}, {"days", 3}, {"photons", 2000}, {"site", 0.2}, {"cell", 0.2}},
         true);
    fresh.points["photons"] = scene.points.at("photons");
    return fresh;
}

Scene forest()
{
    Scene scene;
    work(scene, "forest",
         {{"size", "40m"},
          {"initial", "30"},
          {"steps", 6},
          {"heroes", "20,20"},
          {"windthrow", 0.5},
          {"wind_speed", 40},
          {"occupancy", true},
          {"terrain", "../terrain/maunga-whau.png"},
          {"metres_per_pixel", 1},
          {"height_low", 0},
          {"height_high", 5}});
    work(scene, "tree", {{"generations", 6}, {"wood", true}});
    return scene;
}

/// What of a scene the table does not describe, or describes as something else.
std::vector<std::string> wrong_in(const Scene& scene)
{
    std::vector<std::string> wrong;
    auto describe = [&](const std::string& name, SceneItem::Kind kind) -> const SceneItem* {
        const SceneItem* item = find_scene_item(name);
        if (item && item->kind == kind) return item;
        wrong.push_back(name + ": not described");
        return nullptr;
    };
    auto compare = [&](const std::string& name, const std::string& is, const std::string& said) {
        if (is != said) wrong.push_back(name + " is '" + is + "', described as '" + said + "'");
    };
    for (const auto& [name, grid] : scene.grids)
        if (const SceneItem* item = describe(name, SceneItem::Kind::Grid)) {
            compare(name, grid.type_name(), item->type);
            compare(name + "'s unit", grid.unit, item->unit);
            if (grid.grid_class != item->grid_class) wrong.push_back(name + ": another class");
        }
    for (const auto& [name, points] : scene.points)
        if (const SceneItem* item = describe(name, SceneItem::Kind::Points))
            for (const auto& [key, values] : points.attributes) {
                constexpr const char* kTypes[] = {"float", "double", "int32",
                                                  "int64", "vec3f",  "quatf"};
                if (const auto* attribute = find_attribute(*item, key))
                    compare(name + "." + key, kTypes[values.index()], attribute->type);
                else
                    wrong.push_back(name + "." + key + ": not described");
            }
    for (const auto& [name, mesh] : scene.meshes)
        if (const SceneItem* item = describe(name, SceneItem::Kind::Mesh))
            for (const auto& [key, values] : mesh.face_attributes)
                if (!find_attribute(*item, key))
                    wrong.push_back(name + "." + key + ": not described");
    return wrong;
}

TEST(SceneItems, DescribeEveryNameThatAnyStageReadsOrMakes)
{
    std::set<std::string> made;
    for (const StageInfo& info : stage_infos()) {
        const StageItems items = items_of_stage(info.name);
        for (const auto* names : {&items.needs, &items.uses, &items.makes})
            for (const std::string& name : *names)
                EXPECT_NE(find_scene_item(name), nullptr) << info.name << ": " << name;
        for (const std::string& name : items.makes)
            if (const SceneItem* item = find_scene_item(name)) made.insert(item->name);
    }
    // And nothing that there is no more; `vel` comes from other programs.
    for (const SceneItem& item : scene_items())
        EXPECT_TRUE(item.name == "vel" || made.contains(item.name)) << item.name;
}

TEST(SceneItems, HaveAMeaningAndOneDescriptionEach)
{
    std::set<std::string> names;
    for (const SceneItem& item : scene_items()) {
        EXPECT_FALSE(item.meaning.empty()) << item.name;
        EXPECT_TRUE(names.insert(item.name).second) << item.name;
        EXPECT_EQ(find_scene_item(item.name), &item) << "hidden behind another pattern";
    }
}

TEST(SceneItems, StandForNamesWithPartsThatVary)
{
    ASSERT_NE(find_scene_item("suit_hypnum"), nullptr);
    EXPECT_EQ(find_scene_item("suit_hypnum")->name, "suit_<species>");
    EXPECT_EQ(find_scene_item("suit_"), nullptr);
    EXPECT_EQ(find_scene_item("unsuitable_hypnum"), nullptr);
    const SceneItem& growth = *find_scene_item("forest_growth");
    EXPECT_NE(find_attribute(growth, "count_0_3"), nullptr);
    EXPECT_EQ(find_attribute(growth, "count_0"), nullptr);
    EXPECT_EQ(find_attribute(growth, "light_S"), nullptr);
    EXPECT_EQ(find_attribute(*find_scene_item("rock"), "light_S")->unit, "W/m^2");
}

TEST(SceneItems, AreWhatScenesHold)
{
    EXPECT_THAT(wrong_in(rock()), testing::IsEmpty());
    EXPECT_THAT(wrong_in(garden()), testing::IsEmpty());
    EXPECT_THAT(wrong_in(boulder()), testing::IsEmpty());
    EXPECT_THAT(wrong_in(forest()), testing::IsEmpty());
}

}  // namespace
}  // namespace sekitei::apps
