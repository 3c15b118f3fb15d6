#include "solvers/forest/edits.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/error.h"

namespace sekitei::forest {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

constexpr double kPixel = 0.5;  // [m]
constexpr int kWidth = 150, kDepth = 100;

std::vector<DensityMap> maps(std::uint16_t value = 40000)
{
    return {3, DensityMap(kWidth, kDepth, value)};
}

/// Pixels of a map that differ from `value`.
int changed(const DensityMap& map, std::uint16_t value = 40000)
{
    int n = 0;
    for (int j = 0; j < map.depth(); ++j)
        for (int i = 0; i < map.width(); ++i) n += map.at(i, j) != value;
    return n;
}

Region disc(double x, double y, double r)
{
    Region region;
    region.kind = Region::Kind::Disc;
    region.x = x;
    region.y = y;
    region.radius = r;
    return region;
}

Region polygon(std::vector<std::array<double, 2>> corners)
{
    Region region;
    region.kind = Region::Kind::Polygon;
    region.corners = std::move(corners);
    return region;
}

Edit edit(Edit::Kind kind, double value, Region region = {}, int map = 1)
{
    Edit e;
    e.kind = kind;
    e.value = value;
    e.region = std::move(region);
    e.map = map;
    return e;
}

TEST(DensityValue, RoundsAndRefusesWhatIsNoShare)
{
    EXPECT_EQ(density_value(0), 0);
    EXPECT_EQ(density_value(1), 65535);
    EXPECT_EQ(density_value(0.4), 26214);
    EXPECT_EQ(density_value(0.5), 32768);
    EXPECT_THROW(density_value(1.0001), InvalidInput);
    EXPECT_THROW(density_value(-1e-9), InvalidInput);
    EXPECT_THROW(density_value(std::nan("")), InvalidInput);
}

TEST(Region, DiscHasItsBorder)
{
    const Region region = disc(10, 20, 5);
    EXPECT_TRUE(region.contains(10, 20));
    EXPECT_TRUE(region.contains(13, 24));
    EXPECT_FALSE(region.contains(13, 24.001));
}

TEST(Region, PolygonIsEvenOddAndKnowsItsHoles)
{
    // An L, listed once around.
    const Region l = polygon({{0, 0}, {4, 0}, {4, 1}, {1, 1}, {1, 3}, {0, 3}});
    EXPECT_TRUE(l.contains(0.5, 2.5));
    EXPECT_TRUE(l.contains(3.5, 0.5));
    EXPECT_FALSE(l.contains(2, 2));
    // A star whose middle is wound around twice.
    std::vector<std::array<double, 2>> star;
    for (int k = 0; k < 5; ++k) {
        const double angle = 2 * std::numbers::pi * 2 * k / 5;
        star.push_back({std::cos(angle), std::sin(angle)});
    }
    EXPECT_FALSE(polygon(star).contains(0, 0));
    EXPECT_TRUE(polygon(star).contains(0.9, 0));
    EXPECT_FALSE(polygon({}).contains(0, 0));
    // Neighbours share no point and leave none out.
    const Region left = polygon({{0, 0}, {1, 0}, {1, 1}, {0, 1}}),
                 right = polygon({{1, 0}, {2, 0}, {2, 1}, {1, 1}});
    for (const double y : {0.0, 0.25, 0.5})
        EXPECT_EQ(int(left.contains(1, y)) + int(right.contains(1, y)), 1) << y;
}

TEST(Region, MaskIsLookedUpByPixel)
{
    Region region;
    region.kind = Region::Kind::Mask;
    region.pixel = kPixel;
    region.mask = {4, 3, 0};
    region.mask.set(2, 1, 255);
    EXPECT_TRUE(region.contains(1.0, 0.5));
    EXPECT_TRUE(region.contains(1.49, 0.99));
    EXPECT_FALSE(region.contains(1.5, 0.5));
    EXPECT_FALSE(region.contains(-1, 0.5));
    EXPECT_FALSE(region.contains(100, 100));
}

TEST(Edits, SetADiscInOneMapAlone)
{
    auto m = maps();
    apply(edit(Edit::Kind::Set, 0.25, disc(30, 20, 10)), m, kPixel);
    EXPECT_EQ(changed(m[0]), 0);
    EXPECT_EQ(changed(m[2]), 0);
    EXPECT_NEAR(changed(m[1]), std::numbers::pi * 100 / (kPixel * kPixel), 15);
    EXPECT_EQ(m[1].at(60, 40), 16384);
    EXPECT_EQ(m[1].at(60, 59), 16384);
    EXPECT_EQ(m[1].at(60, 60), 40000);
}

TEST(Edits, OfARegionAreThoseOfEachPixelCentre)
{
    const std::vector<Region> regions{disc(-3, 20, 10),
                                      disc(9.25, 9.25, 1),
                                      disc(74, 49, 4),
                                      disc(500, 500, 3),
                                      polygon({{-9, 3.2}, {80, 7.7}, {33.3, 90}}),
                                      polygon({})};
    for (const Region& region : regions) {
        auto m = maps();
        apply(edit(Edit::Kind::Multiply, 0.5, region, 2), m, kPixel);
        for (int j = 0; j < kDepth; ++j)
            for (int i = 0; i < kWidth; ++i)
                ASSERT_EQ(m[2].at(i, j),
                          region.contains((i + 0.5) * kPixel, (j + 0.5) * kPixel) ? 20000 : 40000);
    }
}

TEST(Edits, MultiplyRoundsAndStopsAtOne)
{
    auto m = maps(10001);
    apply(edit(Edit::Kind::Multiply, 0.5), m, kPixel);
    EXPECT_EQ(m[1].at(3, 3), 5001);
    apply(edit(Edit::Kind::Multiply, 1e9), m, kPixel);
    EXPECT_EQ(m[1].at(3, 3), 65535);
    apply(edit(Edit::Kind::Multiply, 0), m, kPixel);
    EXPECT_EQ(m[1].at(3, 3), 0);
}

TEST(Edits, WholeMapsTakeNoMemoryOfTheirPixels)
{
    auto m = maps();
    const std::size_t bare = m[1].memory_bytes();
    apply(edit(Edit::Kind::Multiply, 0.5), m, kPixel);
    EXPECT_EQ(m[1].memory_bytes(), bare);
    apply(edit(Edit::Kind::Set, 0.5, disc(10, 10, 1)), m, kPixel);
    EXPECT_GT(m[1].memory_bytes(), bare);
    apply(edit(Edit::Kind::Set, 0), m, kPixel);
    EXPECT_EQ(m[1].memory_bytes(), bare);
    EXPECT_EQ(changed(m[1], 0), 0);
}

TEST(Edits, ImageReplacesWhatLiesInTheRegion)
{
    auto m = maps();
    Edit e = edit(Edit::Kind::Image, 0, polygon({{0, 0}, {10, 0}, {10, 50}, {0, 50}}));
    e.image = {kWidth, kDepth, 0};
    for (int j = 0; j < kDepth; ++j)
        for (int i = 0; i < kWidth; ++i) e.image.set(i, j, std::uint16_t(i + 1000 * (j % 7)));
    apply(e, m, kPixel);
    EXPECT_EQ(m[1].at(19, 8), 1019);
    EXPECT_EQ(m[1].at(20, 8), 40000);
    e.region = {};
    apply(e, m, kPixel);
    EXPECT_EQ(m[1].at(149, 13), 6149);
}

TEST(Edits, NameWhatDoesNotFit)
{
    auto m = maps();
    Edit e = edit(Edit::Kind::Image, 0);
    e.step = 7;
    e.image = {10, 20, 0};
    EXPECT_THAT([&] { apply(e, m, kPixel); },
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("step 7"), HasSubstr("10 x 20"), HasSubstr("150 x 100"))));
    EXPECT_THAT([&] { apply(edit(Edit::Kind::Set, 1, {}, 3), m, kPixel); },
                ThrowsMessage<InvalidInput>(HasSubstr("map = 4, must be 1 to 3")));
    EXPECT_THROW(apply(edit(Edit::Kind::Multiply, -1), m, kPixel), InvalidInput);
    EXPECT_THROW(apply(edit(Edit::Kind::Set, 2), m, kPixel), InvalidInput);
}

TEST(Edits, FellingAndPlantingLeaveMapsAlone)
{
    auto m = maps();
    apply(edit(Edit::Kind::Fell, 0, {}, 99), m, kPixel);
    apply(edit(Edit::Kind::Plant, 0, {}, 99), m, kPixel);
    for (const DensityMap& map : m) EXPECT_EQ(changed(map), 0);
}

}  // namespace
}  // namespace sekitei::forest
