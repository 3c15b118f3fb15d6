#include "grids/scene.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "core/error.h"

namespace sekitei {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

constexpr Transform kPlace{.origin = {0.3, -1, 2}, .voxel = 0.04};

FloatGrid ramp()
{
    FloatGrid grid(box_topology({-8, 0, 0}, {16, 8, 8}), kPlace, 1.0f);
    grid.expand();
    for (std::size_t i = 0; i < grid.leaf_count(); ++i)
        for (int v = 0; v < kLeafSize; ++v) {
            grid.values(i)[v] = i == 0 ? 5.0f : static_cast<float>(v);
            if (i == 0 || v % 2) grid.mask(i).set(v);
        }
    return grid;
}

std::string hash_of(const FloatGrid& grid)
{
    Scene scene;
    scene.put("g", grid, "K", "cool");
    return content_hash(scene.grids.at("g"));
}

TEST(Scene, GridsAreFoundByNameAndType)
{
    Scene scene;
    scene.put("temperature", ramp(), "K", "cool");
    scene.put("column", IntGrid(box_topology({0, 0, 0}, {8, 8, 8}), kPlace, -1), "joint");
    scene.points["centre_lines"] = Points{};
    EXPECT_EQ(scene.floats("temperature").value({3, 0, 1}), 193.0f);
    EXPECT_EQ(scene.grids.at("column").type_name(), "int32");
    EXPECT_EQ(scene.grids.at("temperature").active_count(), 512u + 2 * 256);
    EXPECT_THAT([&] { scene.floats("density"); },
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("density"),
                          HasSubstr("present: column, temperature, centre_lines (points)"))));
    EXPECT_THAT(
        [&] { scene.vectors("column"); },
        ThrowsMessage<InvalidInput>(HasSubstr("grid column has type int32, expected vec3s")));
    EXPECT_THAT([&] { scene.ints("centre_lines"); },
                ThrowsMessage<InvalidInput>(HasSubstr("holds points")));
    EXPECT_THAT([&] { scene.points_of("column"); },
                ThrowsMessage<InvalidInput>(HasSubstr("has type int32, expected points")));
    EXPECT_THAT([] { Scene{}.points_of("moss"); },
                ThrowsMessage<InvalidInput>(HasSubstr("there are none")));
}

TEST(ContentHash, DoesNotDependOnHowLeavesAreKept)
{
    FloatGrid grid = ramp();
    const std::string hash = hash_of(grid);
    grid.compress();
    ASSERT_LT(grid.dense_leaf_count(), grid.leaf_count());
    EXPECT_EQ(hash_of(grid), hash);

    // Leaves of inactive background are as good as none.
    FloatGrid wide(box_topology({-24, -8, 0}, {32, 16, 24}), kPlace, 1.0f);
    wide.expand();
    for (std::size_t i = 0; i < grid.leaf_count(); ++i) {
        const std::uint32_t leaf = wide.topology()->find(grid.origin(i));
        for (int v = 0; v < kLeafSize; ++v) wide.values(leaf)[v] = grid.at(i, v);
        wide.mask(leaf) = grid.mask(i);
    }
    EXPECT_EQ(hash_of(wide), hash);
}

TEST(ContentHash, SeesEveryValueMaskAndPlace)
{
    const std::string hash = hash_of(ramp());
    std::vector<FloatGrid> changed(7, ramp());
    changed[0].values(2)[1] += 0.001f;  // an active value
    changed[1].values(2)[2] += 0.001f;  // an inactive one
    changed[2].mask(1).reset(3);
    changed[3].set_background(1.5f);
    changed[4].set_transform({.origin = kPlace.origin, .voxel = 0.05});
    changed[5].set_transform({.origin = {0.3, -1, 2.001}, .voxel = kPlace.voxel});
    changed[6] = FloatGrid(box_topology({-8, 0, 8}, {16, 8, 16}), kPlace, 1.0f);
    std::set<std::string> hashes{hash};
    for (const FloatGrid& grid : changed) hashes.insert(hash_of(grid));
    EXPECT_EQ(hashes.size(), 8u);
}

TEST(ContentHash, IsTheSameOnAnyNumberOfThreads)
{
    auto on = [](std::size_t threads) {
        const ThreadLimit limit(threads);
        return hash_of(ramp());
    };
    EXPECT_EQ(on(1), on(2));
    EXPECT_EQ(on(1), on(7));
}

TEST(ContentHash, OfPointsSeesPositionsNamesAndTypes)
{
    Points p;
    p.position = {{1, 2, 3}, {4, 5, 6}};
    p.attributes["a"] = std::vector<float>{1, 2};
    std::set<std::string> hashes{content_hash(p)};
    Points q = p;
    q.position[1].z = std::nextafter(6.0, 7.0);
    hashes.insert(content_hash(q));
    q = p;
    q.attributes["a"] = std::vector<float>{1, 3};
    hashes.insert(content_hash(q));
    q = p;
    q.attributes["b"] = q.attributes["a"];
    hashes.insert(content_hash(q));
    q.attributes.erase("a");
    hashes.insert(content_hash(q));
    q.attributes["b"] = std::vector<std::int32_t>{0x3F800000, 0x40000000};  // the same bits
    hashes.insert(content_hash(q));
    EXPECT_EQ(hashes.size(), 6u);
}

}  // namespace
}  // namespace sekitei
