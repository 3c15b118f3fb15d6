#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>

#include "apps/forest.h"
#include "apps/stages/stages.h"
#include "core/error.h"

namespace sekitei::apps {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;
using Colour = std::array<int, 3>;

constexpr Colour kWhite{255, 255, 255}, kGreen{0, 128, 0};

struct Stem {
    double x, y, height;
    int species;
};

/// A forest of 200 m x 100 m whose south-western corner is far from the origin.
Scene forest_of(const std::vector<Stem>& stems)
{
    ForestRecord record;
    record.width = 200;
    record.depth = 100;
    record.corner = {1000, -500, 30};
    record.species = forest::table_species();
    Scene scene;
    Grid& grid = scene.grids["canopy_height"];
    grid.values = FloatGrid();
    grid.extra[kForestSettings] = forest_settings(record);
    Points points;
    std::vector<float> height, radius;
    std::vector<std::int32_t> species;
    for (const Stem& s : stems) {
        points.position.push_back(record.corner + Vec3d{s.x, s.y, 0});
        height.push_back(float(s.height));
        radius.push_back(
            float(s.height * forest::slope_of(record.species[std::size_t(s.species)], {})));
        species.push_back(s.species);
    }
    points.attributes["height"] = height;
    points.attributes["cone_radius"] = radius;
    points.attributes["species"] = species;
    scene.points["forest_instances"] = points;
    return scene;
}

Image8 drawn(const std::vector<Stem>& stems, const Json& params = Json::object())
{
    const auto stage = make_distribution();
    for (const auto& [name, value] : params.items()) find_param(stage->params(), name)->set(value);
    stage->validate();
    Scene scene = forest_of(stems);
    stage->run(scene, {});
    return stage->picture;
}

Colour at(const Image8& image, int x, int y)
{
    return {image.at(x, y, 0), image.at(x, y, 1), image.at(x, y, 2)};
}

/// Ink in pixels: 1 for one without white.
double inked(const Image8& image)
{
    double sum = 0;
    for (std::size_t i = 0; i < image.pixels.size(); i += 3) sum += 1 - image.pixels[i] / 255.0;
    return sum;
}

TEST(Distribution, ATreeStandsWhereItGrowsNorthUp)
{
    const Image8 image = drawn({{50.2, 80.1, 20, 0}}, {{"px", 800}});
    EXPECT_EQ(image.width, 800);
    EXPECT_EQ(image.height, 400);
    // r = 20 tan(.5) = 10.93 m, 4 pixels a metre.
    const int x = 200, y = 80;
    EXPECT_EQ(at(image, x, y), kGreen);
    EXPECT_EQ(at(image, x + 38, y), kGreen);
    EXPECT_EQ(at(image, x, y - 38), kGreen);
    EXPECT_EQ(at(image, x + 47, y), kWhite);
    EXPECT_EQ(at(image, x - 47, y), kWhite);
    EXPECT_EQ(at(image, x, y + 47), kWhite);
    // The rim is darker than the inside.
    EXPECT_LT(at(image, x + 42, y)[1], 100);
    EXPECT_EQ(at(image, 600, 300), kWhite);
}

TEST(Distribution, SmallTreesLieOverLargeOnesWhateverTheirOrder)
{
    const Stem large{60, 50, 20, 0}, small{62, 50, 5, 1};
    const Image8 a = drawn({large, small}, {{"px", 800}}), b = drawn({small, large}, {{"px", 800}});
    EXPECT_EQ(a.pixels, b.pixels);
    const Colour blue = at(a, 248, 200);
    EXPECT_GT(blue[2], 150);
    EXPECT_LT(blue[1], 120);
    EXPECT_EQ(at(a, 225, 200), kGreen);
}

TEST(Distribution, CirclesHaveTheirAreaAtAnySize)
{
    for (const double height : {20.0, 6.0, 2.0, 1.0, 0.7}) {
        const Image8 image = drawn({{97.3, 50.6, height, 0}}, {{"px", 200}});
        const double r = height * forest::slope_of(forest::table_species()[0], {});
        EXPECT_NEAR(inked(image) / (3.14159265 * r * r), 1, r > 1 ? 0.01 : 0.1) << height;
    }
}

TEST(Distribution, ShowsOneLayer)
{
    const std::vector<Stem> stems{{40, 50, 18, 0}, {100, 50, 6, 2}, {160, 50, 1.5, 4}};
    const Image8 image = drawn(stems, {{"px", 400}, {"min_height", 3}, {"max_height", 12}});
    EXPECT_EQ(at(image, 80, 100), kWhite);
    EXPECT_EQ(at(image, 320, 100), kWhite);
    EXPECT_NE(at(image, 200, 100), kWhite);
}

TEST(Distribution, SeedlingsOfTheLastStepAreShownOnlyIfAskedFor)
{
    Scene scene = forest_of({{50, 50, 1, 0}, {150, 50, 1, 0}});
    scene.points["forest_instances"].attributes["id"] = std::vector<std::int64_t>{7, -9};
    std::vector<forest::Tree> trees(2);
    trees[0].uid = unsigned_bits(-9);
    trees[1].uid = 7;
    trees[1].age = 1;
    put_forest_trees(scene, trees);
    for (const bool shown : {false, true}) {
        const auto stage = make_distribution();
        find_param(stage->params(), "seedlings")->set(shown);
        stage->validate();
        stage->run(scene, {});
        EXPECT_NE(at(stage->picture, 128, 128), kWhite);
        EXPECT_EQ(at(stage->picture, 384, 128) == kWhite, !shown);
    }
}

TEST(Distribution, ASectionShowsTheConesOfAStrip)
{
    const std::vector<Stem> stems{{50, 10, 20, 0}, {100, 30, 20, 1}};
    const Image8 image =
        drawn(stems, {{"px", 400}, {"view", "side"}, {"window", {40.0, 0.0, 80.0, 20.0}}});
    EXPECT_EQ(image.width, 400);
    EXPECT_EQ(image.height, 210);  // 20 m and 1 m of sky, 10 pixels a metre
    // Half as wide at half its height, apex at the foot; the other one stands behind the strip.
    const double r = 20 * forest::slope_of(forest::table_species()[0], {});
    EXPECT_NE(at(image, int(100 + 9 * r), 15), kWhite);
    EXPECT_EQ(at(image, int(100 + 9 * r), 110), kWhite);
    EXPECT_NE(at(image, int(100 + 4.5 * r), 110), kWhite);
    EXPECT_EQ(at(image, int(100 + 4.5 * r), 200), kWhite);
    EXPECT_EQ(at(image, 330, 100), kWhite);
    EXPECT_EQ(at(image, 100, 5), kWhite);
}

TEST(Distribution, AWindowIsDrawnLarger)
{
    const Image8 image =
        drawn({{50, 50, 20, 0}}, {{"px", 400}, {"window", {40.0, 40.0, 80.0, 80.0}}});
    EXPECT_EQ(image.height, 400);
    EXPECT_EQ(at(image, 100, 300), kGreen);
    EXPECT_EQ(at(image, 300, 100), kWhite);
    EXPECT_THAT(
        [] {
            drawn({}, {{"window", {1.0, 2.0, 1.0, 4.0}}});
        },
        ThrowsMessage<InvalidParameter>(HasSubstr("west < east")));
}

TEST(Distribution, BirdsSeeTallTreesOverSmallOnes)
{
    const Image8 image =
        drawn({{60, 50, 20, 0}, {62, 50, 5, 1}}, {{"px", 800}, {"above", "large"}});
    EXPECT_EQ(at(image, 248, 200), kGreen);
}

TEST(Distribution, AnEmptyForestIsWhite)
{
    const Image8 image = drawn({});
    EXPECT_EQ(image.width, 512);
    EXPECT_EQ(image.height, 256);
    EXPECT_TRUE(std::all_of(image.pixels.begin(), image.pixels.end(),
                            [](std::uint8_t v) { return v == 255; }));
}

TEST(Distribution, SeveralForestsLieBesideEachOther)
{
    const auto stage = make_distribution();
    find_param(stage->params(), "px")->set(256);
    stage->validate();
    stage->run_many({{"a", forest_of({{100, 50, 20, 0}})}, {"b", forest_of({})}}, {});
    const Image8& image = stage->picture;
    EXPECT_EQ(image.width, 2 * 256 + 3 * 4);
    EXPECT_EQ(at(image, 4 + 128, 4 + 64), kGreen);
    EXPECT_EQ(at(image, 4 + 260 + 128, 4 + 64), kWhite);
}

TEST(Distribution, LabelsAddAStripBelow)
{
    const Image8 bare = drawn({{100, 50, 20, 0}}),
                 named = drawn({{100, 50, 20, 0}}, {{"labels", true}});
    EXPECT_EQ(named.width, bare.width);
    EXPECT_GT(named.height, bare.height + 30);
    EXPECT_TRUE(std::equal(bare.pixels.begin(), bare.pixels.end(), named.pixels.begin()));
}

TEST(Distribution, MistakesAreNamed)
{
    EXPECT_THAT(
        [] {
            drawn({}, {{"min_height", 9}, {"max_height", 8}});
        },
        ThrowsMessage<InvalidParameter>(HasSubstr("min_height = 9 m")));
    EXPECT_THAT(
        [] {
            drawn({{1, 1, 1, 0}}, {{"px", 3}});
        },
        ThrowsMessage<InvalidParameter>(HasSubstr("px")));
    const auto stage = make_distribution();
    Scene bare;
    EXPECT_THAT([&] { stage->run(bare, {}); }, ThrowsMessage<InvalidInput>(HasSubstr("forest")));
    Scene odd = forest_of({{1, 1, 1, 0}});
    odd.points["forest_instances"].attributes["species"] = std::vector<std::int32_t>{6};
    EXPECT_THAT(
        [&] {
            stage->run_many({{"wood", odd}}, {});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("wood: forest_instances: tree 0 is of species 6")));
}

}  // namespace
}  // namespace sekitei::apps
