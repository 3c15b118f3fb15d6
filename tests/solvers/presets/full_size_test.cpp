#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>

#include "tests/solvers/presets/chain.h"
#include "tests/solvers/presets/solid.h"

/// Long checks: the delivered recipes at their own size, and nature.
namespace sekitei::presets {
namespace {

class FullSizeRock : public testing::TestWithParam<const char*> {};

TEST_P(FullSizeRock, IsASolidOfTheVolumeOfItsDensity)
{
    expect_solid(run_recipe(GetParam(), {}));
}

INSTANTIATE_TEST_SUITE_P(Recipes, FullSizeRock,
                         testing::Values("cliff", "tower", "coast", "chevron", "rosette", "fan",
                                         "basin", "laccolith", "figure-12a", "figure-13a"),
                         [](const auto& recipe) {
                             std::string name = recipe.param;
                             std::replace(name.begin(), name.end(), '-', '_');
                             return name;
                         });

/// Columns of a level flow, counted as in the field: sides longer than 0.15 sqrt(mean area), on a
/// slice across them, against the 400 columns of Devils Postpile.
TEST(Realism, OfAFlowOfSixteenHundredColumnsIsThatOfDevilsPostpile)
{
    const Body body({.preset = lava::Preset::Slab, .size = Vec3d(40, 40, 2.56), .voxel = 0.04}, {},
                    {});
    for (const std::uint64_t seed : {1, 2}) {
        const joints::Result joints =
            joints::run(body.joint_inputs(), {.spacing = 0.9, .arc = false}, seed, {});
        constexpr int kSide = 1000, kHeight = 32;
        ASSERT_EQ(body.lava.domain.dims, Coord(kSide, kSide, 64));
        std::vector<std::int32_t> slice(kSide * kSide);
        GridReader<std::int32_t> reader(joints.column);
        for (int x = 0; x < kSide; ++x)
            for (int y = 0; y < kSide; ++y)
                slice[static_cast<std::size_t>(x * kSide + y)] = reader.value({x, y, kHeight});

        // A wall of the length l shows as many voxel faces along x and along y as it is long there.
        std::map<std::pair<int, int>, std::array<double, 2>> walls;
        std::vector<double> area(joints.lines.count(), 0);
        std::set<int> rim;
        for (int x = 0; x < kSide; ++x)
            for (int y = 0; y < kSide; ++y) {
                const auto at = static_cast<std::size_t>(x * kSide + y);
                const int own = slice[at];
                ASSERT_GE(own, 0);
                ++area[static_cast<std::size_t>(own)];
                if (x == 0 || y == 0 || x == kSide - 1 || y == kSide - 1) rim.insert(own);
                if (x + 1 < kSide && slice[at + kSide] != own)
                    ++walls[std::minmax(own, int(slice[at + kSide]))][0];
                if (y + 1 < kSide && slice[at + 1] != own)
                    ++walls[std::minmax(own, int(slice[at + 1]))][1];
            }
        double sum = 0;
        std::size_t cells = 0;
        for (std::size_t i = 0; i < area.size(); ++i)
            if (!rim.contains(static_cast<int>(i))) {
                sum += area[i];
                ++cells;
            }
        ASSERT_GE(cells, 1600u);
        const double least = 0.15 * std::sqrt(sum / double(cells));
        std::vector<std::size_t> sides(area.size(), 0);
        for (const auto& [pair, faces] : walls)
            if (std::hypot(faces[0], faces[1]) > least) {
                ++sides[static_cast<std::size_t>(pair.first)];
                ++sides[static_cast<std::size_t>(pair.second)];
            }
        std::array<double, 12> share{};
        double mean = 0;
        for (std::size_t i = 0; i < sides.size(); ++i) {
            if (rim.contains(static_cast<int>(i))) continue;
            share[std::min<std::size_t>(sides[i], 11)] += 100.0 / double(cells);
            mean += double(sides[i]) / double(cells);
        }
        constexpr std::array<double, 12> kPostpile{0, 0, 0, 0.5, 9.5, 37.5, 44.5, 8.0, 0, 0, 0, 0};
        double distance = 0;
        for (std::size_t k = 0; k < 12; ++k) distance += std::abs(share[k] - kPostpile[k]) / 2;
        std::printf(
            "%zu columns: %.1f %.1f %.1f %.1f %.1f %.1f %% of 3 to 8 sides, mean %.2f, TV %.1f\n",
            cells, share[3], share[4], share[5], share[6], share[7], share[8], mean, distance);
        EXPECT_LE(distance, 9);
        EXPECT_GE(mean, 5.5);
        EXPECT_LE(mean, 5.75);
        EXPECT_EQ(std::max_element(share.begin(), share.end()) - share.begin(), 6);
        EXPECT_LE(share[3], 1);
    }
}

}  // namespace
}  // namespace sekitei::presets
