// Maps, species, edits and lists of trees from files.
#include "apps/forest_maps.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <set>

#include "apps/forest_edits.h"
#include "apps/forest_species.h"
#include "apps/trees.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "grids/level_set.h"
#include "grids/vdb_file.h"
#include "tests/support/temporary_folder.h"

namespace sekitei::apps {
namespace {

using forest::DensityMap;
using forest::Edit;
using forest::Raster;
using forest::Region;
using testing::AllOf;
using testing::HasSubstr;
using testing::Property;
using testing::StartsWith;
using testing::Throws;
using testing::ThrowsMessage;

/// What is thrown names the exit code and all of these words.
template <class... Words>
auto fails(ExitCode code, Words... words)
{
    return Throws<Error>(AllOf(Property("code", &Error::code, code),
                               Property("what", &Error::what, AllOf(HasSubstr(words)...))));
}

class ForestMaps : public testing::Test {
protected:
    ForestMaps()
    {
        context.folder = folder.path();
        log::set_sink([this](log::Level, const std::string& line) { told.push_back(line); });
    }
    ~ForestMaps() override { log::set_sink({}); }

    std::string file(const std::string& name) const { return (folder / name).string(); }
    void write(const std::string& name, const std::string& bytes) const
    {
        std::ofstream(folder / name, std::ios::binary) << bytes;
    }
    std::vector<DensityMap> density(const std::string& text, int bands = 5) const
    {
        return read_density(text, bands, frame, context);
    }
    Raster<float> terrain(const TerrainParams& params) const
    {
        return read_terrain(params, frame, context);
    }
    ForestWords words() const { return {frame, 5, forest::table_species(), 3}; }
    std::vector<Edit> edits(const std::string& text) const
    {
        write("edits.toml", text);
        return read_edits(folder / "edits.toml", words());
    }
    TreeList list(const std::string& text) const
    {
        return parse_tree_list(text, "trees.csv", words());
    }

    TemporaryFolder folder;
    StageContext context;
    // Not square and not of 1 m, so that mixed up axes and pixels show.
    ForestFrame frame{6, 4, 2.0, {100, 200, 30}, false};
    std::vector<std::string> told;
};

/// Grey 1000 * column + 100 * row from the top.
Image16 ramp(int width, int height)
{
    Image16 image(width, height, 1);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) image.at(x, y) = std::uint16_t(1000 * x + 100 * y);
    return image;
}

/// Layers of voxels of 2 m at (0, 0, 0), all active.
template <class F>
FloatGrid layers(Coord dims, F&& value, double voxel = 2)
{
    auto grid =
        FloatGrid::uninitialised(box_topology(Coord(0), dims), {{100, 200, 30}, voxel}, 0.0f);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int k = 0; k < kLeafSize; ++k) {
            const Coord c = leaf_coord(grid.origin(leaf), k);
            const bool in = c.x < dims.x && c.y < dims.y && c.z < dims.z;
            grid.values(leaf)[k] = in ? float(value(c)) : 0.0f;
            if (in) grid.mask(leaf).set(k);
        }
    return grid;
}

TEST_F(ForestMaps, PictureHasNorthUpAndItsGreysComeBack)
{
    write_png(folder / "a.png", ramp(6, 4));
    const auto maps = density("a.png");
    ASSERT_EQ(maps.size(), 5u);
    EXPECT_EQ(maps[4].at(5, 3), 5000);  // the top right is the north-east
    EXPECT_EQ(maps[4].at(5, 0), 5300);
    EXPECT_EQ(maps[4].at(0, 1), 200);
    EXPECT_EQ(map_image(maps[0]).pixels, ramp(6, 4).pixels);
}

TEST_F(ForestMaps, EightBitGreysSpanTheWholeRange)
{
    Image8 image(6, 4, 1);
    image.at(0, 3) = 255;
    image.at(1, 3) = 100;
    write_png(folder / "a.png", image);
    const auto maps = density("a.png");
    EXPECT_EQ(maps[0].at(0, 0), 65535);
    EXPECT_EQ(maps[0].at(1, 0), 25700);
    EXPECT_EQ(maps[0].at(0, 3), 0);
}

TEST_F(ForestMaps, OneMapABandOrOneForAll)
{
    write_png(folder / "a.png", ramp(6, 4));
    const auto maps = density("0.5, a.png,1", 3);
    EXPECT_EQ(maps[0].at(2, 2), 32768);
    EXPECT_EQ(maps[1].at(2, 2), 2100);
    EXPECT_EQ(maps[2].at(2, 2), 65535);
    for (const DensityMap& map : density("0.4")) EXPECT_EQ(map.at(1, 1), 26214);
    for (const DensityMap& map : density("")) EXPECT_EQ(map.at(1, 1), 65535);
    EXPECT_THAT([&] { density("1,1"); }, fails(ExitCode::Usage, "2 maps", "must be 5"));
    EXPECT_THAT([&] { density("1,1,1,1,1,1"); }, fails(ExitCode::Usage, "6 maps"));
    EXPECT_THAT([&] { density("1.5"); }, fails(ExitCode::Usage, "density = 1.5", "0 to 1"));
    EXPECT_THAT([&] { density("nan"); }, fails(ExitCode::Usage, "nan"));
    EXPECT_THAT([&] { density("a.jpg"); }, fails(ExitCode::Usage, "a.jpg", ".png"));
    EXPECT_THAT([&] { density("a.png[0..2]"); }, fails(ExitCode::Usage, "range"));
    EXPECT_THAT([&] { density("b.png"); }, fails(ExitCode::BadInput, "b.png"));
}

TEST_F(ForestMaps, AnotherSizeIsRefusedOrStretched)
{
    write_png(folder / "a.png", ramp(3, 12));
    EXPECT_THAT([&] { density("a.png"); },
                fails(ExitCode::BadInput, "a.png", "3 x 12", "6 x 4", "--fit"));
    frame.fit = true;
    const auto maps = density("a.png");
    // Pixel (i, j) is the nearest of half as many columns and three times as many rows.
    EXPECT_EQ(maps[0].at(0, 3), 100);
    EXPECT_EQ(maps[0].at(1, 3), 100);
    EXPECT_EQ(maps[0].at(2, 3), 1100);
    EXPECT_EQ(maps[0].at(5, 0), 3000);
}

TEST_F(ForestMaps, VolumeHasABandInEachLayer)
{
    Scene scene;
    scene.put("forest_density", layers({6, 4, 5}, [](Coord c) { return c.x / 8.0 + c.z / 64.0; }),
              "", "forest");
    scene.put("other", layers({6, 4, 1}, [](Coord c) { return c.y / 4.0; }), "", "");
    write_vdb(folder / "a.vdb", scene);
    const auto maps = density("a.vdb");
    ASSERT_EQ(maps.size(), 5u);
    EXPECT_EQ(maps[3].at(4, 1), forest::density_value(4 / 8.0 + 3 / 64.0));
    EXPECT_EQ(density("a.vdb:other")[2].at(0, 3), forest::density_value(0.75));
    EXPECT_EQ(density("1,a.vdb:other", 2)[1].at(0, 2), forest::density_value(0.5));
    EXPECT_THAT([&] { density("a.vdb", 4); }, fails(ExitCode::Usage, "5 maps", "4"));
    EXPECT_THAT([&] { density("a.vdb,1", 2); }, fails(ExitCode::Usage, "5 maps"));
    EXPECT_THAT([&] { density("a.vdb:othre"); },
                fails(ExitCode::BadInput, "othre", "forest_density, other"));
}

TEST_F(ForestMaps, VolumeOfAnotherForestIsRefused)
{
    auto refused = [&](FloatGrid grid, auto... parts) {
        Scene scene;
        scene.put("a", std::move(grid), "", "");
        write_vdb(folder / "a.vdb", scene);
        EXPECT_THAT([&] { density("a.vdb"); }, fails(ExitCode::BadInput, "a.vdb", parts...));
    };
    auto half = [](Coord) { return 0.5; };
    refused(layers({6, 4, 1}, [](Coord c) { return c.x == 2 && c.y == 1 ? 1.25 : 0.5; }), "1.25",
            "pixel (2, 1)", "0 to 1");
    refused(layers({6, 4, 1}, [](Coord c) { return c.x == 2 ? -0.25 : 0.5; }), "-0.25");
    refused(layers({6, 4, 1}, [](Coord c) { return c.x == 2 ? NAN : 0.5; }), "nan");
    refused(layers({7, 4, 1}, half), "7 x 4", "6 x 4", "--fit");
    refused(layers({5, 3, 1}, half), "5 x 3", "6 x 4");
    refused(layers({6, 4, 1}, half, 1.0), "1 m", "2 m");
    frame.fit = true;
    EXPECT_EQ(density("a.vdb")[0].at(5, 3), 32768);
}

TEST_F(ForestMaps, SparseVolumeHasItsBackgroundElsewhere)
{
    FloatGrid grid(box_topology(Coord(0), Coord(6, 4, 1)), {{100, 200, 30}, 2.0}, 0.25f);
    grid.expand();
    grid.values(0)[leaf_offset({1, 2, 0})] = 0.75f;
    grid.values(0)[leaf_offset({4, 1, 0})] = 0.5f;
    grid.mask(0).set(leaf_offset({1, 2, 0}));
    grid.mask(0).set(leaf_offset({4, 1, 0}));
    Scene scene;
    scene.put("a", std::move(grid), "", "");
    write_vdb(folder / "a.vdb", scene);
    const auto maps = density("a.vdb");
    EXPECT_EQ(maps[0].at(1, 2), forest::density_value(0.75));
    EXPECT_EQ(maps[0].at(4, 1), forest::density_value(0.5));
    EXPECT_EQ(maps[0].at(5, 3), forest::density_value(0.25));
    // But a voxel outside the forest belongs to another one.
    scene.put("a", layers({8, 4, 1}, [](Coord) { return 0.5; }), "", "");
    std::get<FloatGrid>(scene.grids.at("a").values).mask(0).reset(leaf_offset({0, 0, 0}));
    write_vdb(folder / "a.vdb", scene);
    EXPECT_THAT([&] { density("a.vdb"); }, fails(ExitCode::BadInput, "8 x 4", "6 x 4"));
}

TEST_F(ForestMaps, EnvironmentHasNamesRangesAndNumbers)
{
    Image16 image(6, 4, 1);
    image.at(2, 0) = 65535;
    image.at(3, 0) = 13107;
    write_png(folder / "heat.png", image);
    Scene scene;
    scene.put("water", layers({6, 4, 1}, [](Coord c) { return c.x + 10 * c.y; }), "", "");
    scene.put("wind", layers({6, 4, 1}, [](Coord) { return 3; }), "", "");
    write_vdb(folder / "wet.vdb", scene);
    const auto all = read_environment(
        "temperature=heat.png[-5..25], water=wet.vdb,light=0.8, grey=heat.png", frame, context);
    ASSERT_EQ(all.size(), 4u);
    EXPECT_EQ(all[0].name, "temperature");
    EXPECT_FLOAT_EQ(float(all[0].at(2, 3)), 25);
    EXPECT_FLOAT_EQ(float(all[0].at(3, 3)), 1);
    EXPECT_FLOAT_EQ(float(all[0].at(0, 0)), -5);
    EXPECT_FLOAT_EQ(float(all[1].at(4, 3)), 34);
    EXPECT_FLOAT_EQ(float(all[2].at(4, 3)), 0.8f);
    EXPECT_FLOAT_EQ(float(all[3].at(3, 3)), 0.2f);
    auto read = [&](const char* text) {
        return [this, text] { read_environment(text, frame, context); };
    };
    EXPECT_THAT(read("heat.png"), fails(ExitCode::Usage, "NAME=MAP"));
    EXPECT_THAT(read("a=1,a=2"), fails(ExitCode::Usage, "'a' is given twice"));
    EXPECT_THAT(read("a=heat.png[1]"), fails(ExitCode::Usage, "black and white"));
    EXPECT_THAT(read("a=wet.vdb[0..1]"), fails(ExitCode::Usage, "brackets"));
    EXPECT_THAT(read("a=wet.vdb"), fails(ExitCode::BadInput, "water, wind"));
}

TEST_F(ForestMaps, MasksAndBlockedHeights)
{
    Image8 image(6, 4, 1);
    image.at(2, 0) = 1;
    image.at(3, 0) = 255;
    write_png(folder / "m.png", image);
    const auto mask = read_mask("plantable", "m.png", frame, context);
    EXPECT_EQ(mask.at(2, 3), 1);
    EXPECT_EQ(mask.at(3, 3), 1);
    EXPECT_EQ(mask.at(4, 3), 0);
    Image16 faint(6, 4, 1);
    faint.at(1, 3) = 1;
    EXPECT_EQ(image_mask(faint, "faint", frame).at(1, 0), 1);
    EXPECT_EQ(image_mask(faint, "faint", frame).at(0, 0), 0);
    const auto rocks = read_map("blocked_height", "m.png[0..8.5]", frame, context);
    EXPECT_FLOAT_EQ(rocks.at(3, 3), 8.5f);
    EXPECT_THAT([&] { read_map("blocked_height", "1,2", frame, context); },
                fails(ExitCode::Usage, "blocked_height", "2 maps"));
}

TEST_F(ForestMaps, TerrainPictureIsBilinearAtItsOwnScale)
{
    // A plane that rises eastwards by 4 m a pixel of 3 m and northwards by 1 m a pixel.
    Image16 image(5, 3, 1);
    for (int y = 0; y < 3; ++y)
        for (int x = 0; x < 5; ++x) image.at(x, y) = std::uint16_t(4000 * x + 1000 * (2 - y));
    write_png(folder / "hill.png", image);
    const double black = 10, white = 10 + 65.535;
    const TerrainParams params{"hill.png", 3.0, black, white};
    frame.depth = 4;
    const auto ground = terrain(params);
    for (int j = 1; j < 3; ++j)
        for (int i = 1; i < 6; ++i)
            EXPECT_NEAR(ground.at(i, j),
                        10 + 4 * ((i + 0.5) * 2 / 3 - 0.5) + ((j + 0.5) * 2 / 3 - 0.5), 1e-4);
    EXPECT_TRUE(terrain({}).empty());
    frame.width = 9;
    EXPECT_THAT([&] { terrain(params); },
                fails(ExitCode::BadInput, "15 x 9 m", "18 x 8 m", "hill.png"));
    EXPECT_THAT(
        [&] {
            terrain({"hill.png", std::nullopt, black, white});
        },
        fails(ExitCode::BadInput, "5 x 3", "9 x 4", "metres_per_pixel", "--fit"));
    frame.fit = true;
    EXPECT_NEAR(terrain({"hill.png", std::nullopt, black, white}).at(4, 2),
                10 + 4 * 2 + (2.5 * 3 / 4 - 0.5), 1e-4);
    EXPECT_THAT(
        [&] {
            terrain({"hill.png", 3.0, {}, {}});
        },
        fails(ExitCode::Usage, "height_low", "height_high"));
    EXPECT_THAT([&] { terrain({"", 3.0, {}, {}}); }, fails(ExitCode::Usage, "metres_per_pixel"));
    EXPECT_THAT([&] { terrain({"a.vdb", {}, 1.0, {}}); }, fails(ExitCode::Usage, "pictures"));
}

TEST_F(ForestMaps, HeightsOfMaungaWhauAreThoseOfTheMap)
{
    frame = {61, 87, 10.0, {}, false};
    TerrainParams params{SEKITEI_DATA "/terrain/maunga-whau.png", {}, 94.0, 195.0};
    const auto coarse = terrain(params);
    EXPECT_NEAR(coarse.at(30, 86 - 67), 195, 0.01);
    frame = {305, 435, 2.0, {}, false};
    params.metres_per_pixel = 10;
    EXPECT_NEAR(terrain(params).at(30 * 5 + 2, (86 - 67) * 5 + 2), 195, 0.01);
}

TEST_F(ForestMaps, GroundIsTheHighestSurfaceOfARock)
{
    // A ball of radius 3 m whose centre lies in the middle of the forest, 1 m above its corner, and
    // a roof above one half of it.
    const Vec3d centre{106, 204, 31};
    auto distance = [&](Vec3d p) { return length(p - centre) - 3; };
    const Domain domain{{80, 60, 60}, {{98, 199, 27}, 0.2}};
    for (const bool density : {false, true}) {
        FloatGrid grid = level_set_from_function(
            domain, [&](Vec3d v) { return distance(domain.transform.world(v)) / 0.2; }, {},
            {.steepness = 1, .is_distance = true});
        Scene scene;
        if (density) {
            FloatGrid fog(box_topology(Coord(0), domain.dims), domain.transform, 0.0f);
            fog.expand();
            for (std::size_t leaf = 0; leaf < fog.leaf_count(); ++leaf)
                for (int k = 0; k < kLeafSize; ++k) {
                    const Vec3d p =
                        domain.transform.world(centre_of(leaf_coord(fog.origin(leaf), k)));
                    const double d = std::clamp(0.5 - distance(p) / 0.4, 0.0, 1.0);
                    fog.values(leaf)[k] = float(d);
                    if (d > 0) fog.mask(leaf).set(k);
                }
            fog.compress();
            scene.put("density", std::move(fog), "", "", GridClass::FogVolume);
        } else {
            scene.put("body_sdf", std::move(grid), "m", "", GridClass::LevelSet);
        }
        write_vdb(folder / "rock.vdb", scene);
        const auto ground = terrain({"rock.vdb", {}, {}, {}});
        // Pixel (2, 1) is x 104..106, y 202..204; its highest column is next to the centre.
        EXPECT_NEAR(ground.at(2, 1), 1 + std::sqrt(9 - 0.02), 0.02) << density;
        EXPECT_NEAR(ground.at(3, 2), 1 + std::sqrt(9 - 0.02), 0.02) << density;
        // Pixel (1, 1): x 102..104, so the highest column is 2.1 m west of the centre.
        EXPECT_NEAR(ground.at(1, 1), 1 + std::sqrt(9 - 2.1 * 2.1 - 0.01), 0.05) << density;
        EXPECT_EQ(ground.at(0, 0), 0) << density;
        frame.corner.x = 1000;
        EXPECT_THAT(
            [&] {
                terrain({"rock.vdb", {}, {}, {}});
            },
            fails(ExitCode::BadInput, "no surface", "corner"));
        frame.corner.x = 100;
    }
}

TEST_F(ForestMaps, FineForestOnACoarseRockTakesTheColumnItStandsOn)
{
    frame.pixel = 0.5;
    const Domain domain{{8, 8, 8}, {{100, 200, 30}, 1.5}};
    Scene scene;
    scene.put("surface_sdf",
              level_set_from_function(domain,
                                      [&](Vec3d v) {
                                          const Vec3d p = domain.transform.world(v);
                                          return (p.z - 33 - 0.5 * (p.x - 100)) / std::sqrt(1.25) /
                                                 1.5;
                                      },
                                      {}, {.steepness = 1, .is_distance = true}),
              "m", "", GridClass::LevelSet);
    write_vdb(folder / "rock.vdb", scene);
    const auto ground = terrain({"rock.vdb", {}, {}, {}});
    EXPECT_NEAR(ground.at(1, 1), 3 + 0.5 * 0.75, 0.02);
    EXPECT_EQ(ground.at(0, 0), ground.at(2, 0));
    EXPECT_NEAR(ground.at(4, 1), 3 + 0.5 * 2.25, 0.02);
}

TEST_F(ForestMaps, HeightsInALayerAreThoseOfTheWorld)
{
    Scene scene;
    scene.put("terrain_height", layers({6, 4, 1}, [](Coord c) { return 30 + c.x - 0.5 * c.y; }),
              "m", "forest");
    scene.put("canopy_height", layers({6, 4, 1}, [](Coord) { return 39; }), "m", "forest");
    write_vdb(folder / "a.vdb", scene);
    EXPECT_FLOAT_EQ(terrain({"a.vdb", {}, {}, {}}).at(5, 2), 4);
    EXPECT_FLOAT_EQ(terrain({"a.vdb:canopy_height", {}, {}, {}}).at(5, 2), 9);
}

// --- painting while it grows ---

TEST_F(ForestMaps, WatcherSeesOnlyMapsThatChanged)
{
    Image16 image = ramp(6, 4);
    write_png(folder / "a.png", image);
    write_png(folder / "b.png", image);
    MapWatcher watcher("a.png,0.5,b.png", 3, frame, context);
    EXPECT_TRUE(watcher.changes(1).empty());
    image.at(0, 0) = 7;
    write_png(folder / "b.png", image);
    const auto edits = watcher.changes(2);
    ASSERT_EQ(edits.size(), 1u);
    EXPECT_EQ(edits[0].step, 2);
    EXPECT_EQ(edits[0].map, 2);
    EXPECT_EQ(edits[0].kind, Edit::Kind::Image);
    EXPECT_EQ(edits[0].image.at(0, 3), 7);
    EXPECT_TRUE(watcher.changes(3).empty());
    // The same picture, written in another way.
    Image8 other(6, 4, 3);
    write_png(folder / "a.png", Image16(6, 4, 1));
    EXPECT_EQ(watcher.changes(4).size(), 1u);
    write_png(folder / "a.png", other);
    EXPECT_TRUE(watcher.changes(5).empty());
    EXPECT_TRUE(told.empty());
}

TEST_F(ForestMaps, WatcherKeepsAMapWhoseFileIsHalfWritten)
{
    Image16 image = ramp(6, 4);
    write_png(folder / "a.png", image);
    MapWatcher watcher("a.png", 2, frame, context);
    image.at(3, 3) = 9;
    const std::string bytes = encode_png(image);
    for (const std::size_t part : {bytes.size() / 2, bytes.size() - 3}) {
        write("a.png", bytes.substr(0, part));
        EXPECT_TRUE(watcher.changes(2).empty());
    }
    std::filesystem::remove(folder / "a.png");
    EXPECT_TRUE(watcher.changes(3).empty());
    EXPECT_TRUE(watcher.changes(4).empty());
    // Each fault is told, once.
    ASSERT_EQ(told.size(), 3u);
    EXPECT_THAT(told[0], AllOf(HasSubstr("step 2"), HasSubstr("a.png")));
    EXPECT_THAT(told[2], AllOf(HasSubstr("step 3"), HasSubstr("a.png")));
    write("a.png", bytes);
    EXPECT_EQ(watcher.changes(4).size(), 2u);
    EXPECT_EQ(watcher.maps()[1].at(3, 0), 9);
    write_png(folder / "a.png", ramp(7, 7));
    EXPECT_TRUE(watcher.changes(5).empty());
    EXPECT_EQ(told.size(), 4u);
}

// --- species ---

TEST(ForestSpecies, TheFileOfTheTableIsTheTable)
{
    const auto read =
        read_forest_species(SEKITEI_DATA "/forest/table-5.1.toml", forest::SpreadMode::ApexAngle);
    const auto& table = forest::table_species();
    ASSERT_EQ(read.size(), table.size());
    for (std::size_t s = 0; s < table.size(); ++s) {
        forest::Species a = read[s], b = table[s];
        EXPECT_EQ(params_json(describe_params(a)), params_json(describe_params(b)));
        EXPECT_TRUE(a.limits.empty());
    }
}

TEST(ForestSpecies, OfTheTableStandForKindsOfTreesWithALeaderOrForks)
{
    for (const auto& species : forest::table_species())
        EXPECT_NE(find_tree(species.tree, {}).model, tree::Model::Shoot) << species.tree;
}

TEST(ForestSpecies, OfTheHillsKnowSlopeWarmthAndWater)
{
    const auto species =
        read_forest_species(SEKITEI_DATA "/forest/hills.toml", forest::SpreadMode::ApexAngle);
    ASSERT_GE(species.size(), 4u);
    std::set<std::string> factors;
    for (const auto& s : species)
        for (const auto& limits : s.limits) factors.insert(limits.factor);
    EXPECT_EQ(factors, (std::set<std::string>{"slope", "temperature", "water"}));
}

TEST_F(ForestMaps, SpeciesAreChosenByNameOrNumber)
{
    auto names = [&](const std::string& text) {
        std::vector<std::string> list;
        for (const auto& s :
             find_forest_species(text, folder.path(), forest::SpreadMode::ApexAngle))
            list.push_back(s.name);
        return list;
    };
    EXPECT_EQ(names("table-5.1").size(), 6u);
    EXPECT_EQ(names("table-5.1:shrub,1"), (std::vector<std::string>{"shrub", "tall"}));
    write("own.toml", "[[species]]\nname = \"fir\"\n[[species]]\nname = \"oak\"\n");
    EXPECT_EQ(names("own.toml"), (std::vector<std::string>{"fir", "oak"}));
    EXPECT_EQ(names("own.toml:2"), (std::vector<std::string>{"oak"}));
    EXPECT_EQ(forest_species_file("own.toml:2"), "own.toml");
    EXPECT_EQ(forest_species_file("table-5.1:2"), "");
    EXPECT_THAT([&] { names("table-5.2"); }, fails(ExitCode::Usage, "did you mean 'table-5.1'"));
    EXPECT_THAT([&] { names("table-5.1:srub"); },
                fails(ExitCode::Usage, "srub", "did you mean 'shrub'"));
    EXPECT_THAT([&] { names("table-5.1:7"); }, fails(ExitCode::Usage, "1 to 6"));
    EXPECT_THAT([&] { names("table-5.1:1,tall"); }, fails(ExitCode::Usage, "twice"));
    EXPECT_THAT([&] { names("table-5.1:"); }, fails(ExitCode::Usage, "nothing"));
    EXPECT_THAT([&] { names("none.toml"); }, fails(ExitCode::Usage, "none.toml"));
}

TEST_F(ForestMaps, AllMistakesOfSpeciesAreNamedAtTheirPlaces)
{
    write("bad.toml", R"(sekitei = 1
[[species]]
name = "fir"
sprea = 1.0
max_height = "2 furlongs"
[[species]]
name = "oak"
spread = 3.5
[[species]]
name = "elm"
limits = { water = [0.2, 0.1, 0.4, 0.6, 0.7, 0.8] }
[[species]]
name = "box"
tree = "bonsai"
limits = { water = [0.2, 0.1] }
[[species]]
max_slope = "45deg"
[[species]]
name = "yew"
tree = "zelkva"
[[species]]
name = "yew"
)");
    const std::string at = file("bad.toml");
    EXPECT_THAT([&] { read_forest_species(folder / "bad.toml", forest::SpreadMode::ApexAngle); },
                fails(ExitCode::Usage, at + ":1:1: sekitei: unknown key",
                      at + ":4:1: sprea: unknown key, did you mean 'spread'?",
                      at + ":5:14: max_height", at + ":8:10: species 'oak': spread = 3.5",
                      at + ":11:20: species 'elm': limits.water: stands_below = 0.1",
                      at + ":15:20: limits.water: expected six numbers",
                      at + ":16:1: name: missing", at + ":20:8: tree = zelkva",
                      "did you mean 'zelkova'?", at + ":22:8: name: there are two species 'yew'"));
}

// --- edits ---

TEST_F(ForestMaps, EditsAreReadInTheOrderOfTheirSteps)
{
    Image8 mask(6, 4, 1);
    mask.at(5, 0) = 1;
    write_png(folder / "m.png", mask);
    write_png(folder / "a.png", ramp(6, 4));
    const auto all = edits(R"(
[[edit]]
step = 31
map = [3, 5]
value = 0
disc = [5, 4, 2.5]
[[edit]]
step = 7
map = 1
multiply = 0.5
polygon = [[0, 0], [4, 0], [4, 4]]
[[edit]]
step = 31
fell = true
min_height = 16
mask = "m.png"
[[edit]]
step = 8
map = 2
image = "a.png"
[[edit]]
step = 40
plant = [["low", 1.5, 2.5, 3], [1, 2, 2, 30.0, "0x1139fd5694aac492"]]
)");
    ASSERT_EQ(all.size(), 6u);
    EXPECT_EQ(all[0].kind, Edit::Kind::Multiply);
    EXPECT_EQ(all[0].region.corners.size(), 3u);
    EXPECT_EQ(all[1].image.at(4, 3), 4000);
    EXPECT_EQ(all[2].map, 2);
    EXPECT_EQ(all[3].map, 4);
    EXPECT_EQ(all[3].region.radius, 2.5);
    EXPECT_EQ(all[4].min_height, 16);
    EXPECT_TRUE(all[4].region.contains(11, 7));
    EXPECT_FALSE(all[4].region.contains(9, 7));
    ASSERT_EQ(all[5].trees.size(), 2u);
    EXPECT_EQ(all[5].trees[0].species, 3);
    EXPECT_EQ(all[5].trees[0].height, 3);
    EXPECT_EQ(all[5].trees[1].uid, 0x1139fd5694aac492u);
    EXPECT_EQ(all[5].trees[1].height, 20);
    ASSERT_EQ(told.size(), 1u);
    EXPECT_THAT(told[0], HasSubstr("1 trees to plant"));
    EXPECT_EQ(edit_files(folder / "edits.toml").size(), 2u);
}

TEST_F(ForestMaps, EditsComeBackFromTheirLog)
{
    std::vector<Edit> all;
    auto add = [&](Edit::Kind kind, int step, int map, double value) -> Edit& {
        Edit edit;
        edit.kind = kind;
        edit.step = step;
        edit.map = map;
        edit.value = value;
        all.push_back(edit);
        return all.back();
    };
    add(Edit::Kind::Set, 3, 4, 1.0 / 3);
    add(Edit::Kind::Multiply, 3, 0, 1e-7);
    Edit& disc = add(Edit::Kind::Set, 5, 2, 0);
    disc.region.kind = Region::Kind::Disc;
    disc.region.x = 0.1;
    disc.region.y = -7;
    disc.region.radius = 2.0 / 3;
    for (const int shift : {0, 5}) {  // two of one step and map
        Edit& image = add(Edit::Kind::Image, 9, 1, 0);
        image.image = {6, 4, 0};
        for (int j = 0; j < 4; ++j)
            for (int i = 0; i < 6; ++i)
                image.image.set(i, j, std::uint16_t(257 * i + 31 * j + shift));
        image.region.kind = Region::Kind::Polygon;
        image.region.corners = {{0, 0}, {1.0 / 7, 0}, {3, 1e-3}};
    }
    Edit& fell = add(Edit::Kind::Fell, 12, 0, 0);
    fell.min_height = 0.7;
    fell.region.kind = Region::Kind::Mask;
    fell.region.pixel = frame.pixel;
    fell.region.mask = {6, 4, 0};
    fell.region.mask.set(5, 1, 1);
    fell.region.mask.set(0, 3, 200);
    Edit& plant = add(Edit::Kind::Plant, 13, 0, 0);
    plant.trees = {{~std::uint64_t(0), 5, 1.0 / 9, 7.25, 1.1}, {1, 0, 11.75, 0, 20}};

    const auto files = encode_edits(all, forest::table_species(), "log");
    ASSERT_EQ(files.size(), 4u);
    EXPECT_EQ(files[0].first, "log.toml");
    EXPECT_EQ(files[1].first, "log_step0009_map2.png");
    EXPECT_EQ(files[2].first, "log_step0009_map2_2.png");
    EXPECT_EQ(files[3].first, "log_step0012_fell_mask.png");
    for (const auto& [name, bytes] : files) write(name, bytes);
    const auto back = read_edits(folder / "log.toml", words());
    ASSERT_EQ(back.size(), all.size());
    for (std::size_t k = 0; k < all.size(); ++k) EXPECT_TRUE(back[k] == all[k]) << k;
    EXPECT_EQ(encode_edits(back, forest::table_species(), "log"), files);
}

TEST_F(ForestMaps, AllMistakesOfEditsAreNamedAtTheirPlaces)
{
    const std::string at = file("edits.toml");
    EXPECT_THAT(
        [&] {
            edits(R"(title = "x"
[[edit]]
step = 0
map = 6
value = 1.5
dics = [1, 2, 3]
[[edit]]
map = 1
value = 1
multiply = 2
disc = [1, 2, 3]
polygon = [[1, 2], [2, 3]]
[[edit]]
step = 2
value = 0.5
min_height = 3
[[edit]]
step = 2.5
plant = [["talll", 1, 2, 3], [1, 2, 3], [1, 2, 3, 0], [1, 1, 1, 1, "0xg"]]
mask = "none.png"
[[edit]]
step = 1
)");
        },
        fails(ExitCode::Usage, at + ":1:1: title: unknown key", at + ":3:8: step = 0, must be 1",
              at + ":4:7: map = 6, must be 1 to 5", at + ":5:9: value = 1.5, must be 0 to 1",
              at + ":6:1: dics: unknown key, did you mean 'disc'?", at + ":7:1: step: missing",
              at + ":7:1: edit: 2 of value", at + ":7:1: edit: 2 regions",
              at + ":12:11: polygon: expected at least three", at + ":13:1: map: missing",
              at + ":16:14: min_height: goes with fell",
              at + ":18:8: step: expected a whole number", "did you mean 'tall'?",
              at + ":19:30: plant: expected [species",
              at + ":19:41: plant: height = 0, must be > 0", at + ":19:55: plant: uid",
              at + ":20:8: mask", "none.png", at + ":21:1: edit: none of value"));
}

TEST_F(ForestMaps, OneUidForTwoTreesIsNamedAtBoth)
{
    const std::string at = file("edits.toml");
    EXPECT_THAT(
        [&] {
            edits(R"([[edit]]
step = 1
plant = [[1, 1, 1, 1, 77]]
[[edit]]
step = 2
plant = [[1, 1, 1, 1, 78], [1, 1, 1, 1, "0x4d"]]
)");
        },
        fails(ExitCode::BadInput, at + ":6:28", "0x000000000000004d", at + ":3:10"));
    EXPECT_THAT([&] { edits("[[edit]]\nstep = 1\nfell = true\nmask = \"none.png\"\n"); },
                fails(ExitCode::BadInput, at + ":4:8: mask", "none.png"));
}

TEST_F(ForestMaps, TreesWithoutUidsGetTheirOwn)
{
    const char* text = "[[edit]]\nstep = 1\nplant = [[1, 1, 1, 1], [1, 1, 1, 1]]\n";
    const auto a = edits(text)[0].trees, b = edits(text)[0].trees;
    EXPECT_NE(a[0].uid, a[1].uid);
    EXPECT_EQ(a, b);
}

TEST_F(ForestMaps, LogOfManyPlantedTreesComesBack)
{
    Edit edit;
    edit.kind = Edit::Kind::Plant;
    for (std::uint64_t k = 0; k < 80000; ++k)
        edit.trees.push_back({k, int(k % 6), 1.0 / 3, double(k) / 7e4, 2});
    const auto files = encode_edits({edit}, forest::table_species(), "log");
    EXPECT_GT(files[0].second.size(), 4u << 20);
    write("log.toml", files[0].second);
    const auto back = read_edits(folder / "log.toml", words());
    ASSERT_EQ(back.size(), 1u);
    EXPECT_TRUE(back[0] == edit);
}

// --- lists of trees ---

TEST_F(ForestMaps, ListOfTreesIsReadByItsHeader)
{
    const auto read = list(
        "# a comment\nheight, y,species,x,uid\r\n"
        "3.5,1,tall,11.5,0xff\n\n2,7.5,5,0,-1\n1,2,shrub_2,3,\n");
    ASSERT_EQ(read.trees.size(), 3u);
    EXPECT_EQ(read.trees[0], (forest::NewTree{0xff, 0, 11.5, 1, 3.5}));
    EXPECT_EQ(read.trees[1], (forest::NewTree{~std::uint64_t(0), 4, 0, 7.5, 2}));
    EXPECT_EQ(read.trees[2].species, 5);
    EXPECT_TRUE(told.empty());
}

TEST_F(ForestMaps, ListLeavesOutTreesOutsideAndClampsHighOnes)
{
    const auto read = list(
        "species,x,y,height\n1,12,1,1\n1,1,8,1\n1,-0.1,1,1\n1,1,-0.1,1\n1,11.99,7.99,1\n"
        "1,0,0,20.5\nshrub,1,1,2.5\n");
    EXPECT_EQ(read.outside, 4u);
    EXPECT_EQ(read.clamped, 2u);
    ASSERT_EQ(read.trees.size(), 3u);
    EXPECT_EQ(read.trees[1].height, 20);
    EXPECT_EQ(read.trees[2].height, 2);
    ASSERT_EQ(told.size(), 2u);
    EXPECT_THAT(told[0], HasSubstr("4 of 7"));
    EXPECT_THAT(told[1], HasSubstr("2 trees"));
}

TEST_F(ForestMaps, AllMistakesOfAListAreNamedAtTheirPlaces)
{
    EXPECT_THAT(
        [&] {
            list(
                "species,x,y,height,uid\n1,1,1,0,1\n1,1,1,nan,2\ntal,1,1,1,3\n1,1,1,1,4\n"
                "2,1,1,1,0x4\n1,1,1\n1,1,east,-2,9x\n");
        },
        fails(ExitCode::BadInput, "trees.csv:2:7: height = 0, must be > 0",
              "trees.csv:3:7: height = 'nan'", "trees.csv:4:1: species = tal",
              "trees.csv:6:9: uid = 0x0000000000000004", "line 5",
              "trees.csv:7:1: 3 cells, expected 5", "trees.csv:8:5: y = 'east'",
              "trees.csv:8:10: height = -2", "trees.csv:8:13: uid = '9x'"));
    EXPECT_THAT([&] { list("species,x,hight\n"); },
                fails(ExitCode::BadInput, "trees.csv:1:11", "did you mean 'height'",
                      "y: this column is missing"));
    EXPECT_THAT([&] { list("# nothing\n"); }, fails(ExitCode::BadInput, "no header"));
    EXPECT_EQ(list("species,x,y,height\n").trees.size(), 0u);
}

}  // namespace
}  // namespace sekitei::apps
