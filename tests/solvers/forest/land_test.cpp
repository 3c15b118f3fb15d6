#include "solvers/forest/land.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <set>

#include "core/error.h"
#include "solvers/forest/species.h"

namespace sekitei::forest {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

using ::testing::ThrowsMessage;

constexpr double kPixel = 2.5;  // [m]; not 1, so that a forgotten pixel shows
constexpr int kWidth = 70, kDepth = 9;

/// Ground that rises by `east` and `north` [m/m].
Land plane(double east, double north)
{
    Land land;
    land.pixel = kPixel;
    land.ground = {kWidth, kDepth, 0.0f};
    for (int j = 0; j < kDepth; ++j)
        for (int i = 0; i < kWidth; ++i)
            land.ground.set(i, j,
                            float(100 + east * (i + 0.5) * kPixel + north * (j + 0.5) * kPixel));
    return land;
}

Factor along_x(const std::string& name)
{
    Factor factor{name, {kWidth, kDepth, 0.0f}};
    for (int j = 0; j < kDepth; ++j)
        for (int i = 0; i < kWidth; ++i) factor.value.set(i, j, float(i) / (kWidth - 1));
    return factor;
}

TEST(ForestSpecies, ConesOpenAsTheTableSays)
{
    const auto& table = table_species();
    ASSERT_EQ(table.size(), 6u);
    EXPECT_NEAR(slope_of(table[0], SpreadMode::ApexAngle), 0.546302, 1e-6);
    EXPECT_NEAR(slope_of(table[3], SpreadMode::ApexAngle), 0.931596, 1e-6);
    EXPECT_DOUBLE_EQ(slope_of(table[3], SpreadMode::DiameterRatio), 0.75);
    EXPECT_DOUBLE_EQ(slope_of(table[3], SpreadMode::RadiusRatio), 1.5);
    EXPECT_NEAR(slope_of(table[3], SpreadMode::HalfAngle), std::tan(1.5), 1e-9);
}

TEST(ForestSpecies, OfTheTableAreValidAndToldApart)
{
    std::set<std::string> names, colours;
    for (const Species& species : table_species()) {
        EXPECT_NO_THROW(validate(species, SpreadMode::ApexAngle)) << species.name;
        names.insert(species.name);
        colours.insert(species.colour);
    }
    EXPECT_EQ(names.size(), 6u);
    EXPECT_EQ(colours.size(), 6u);
}

TEST(ForestSpecies, NameWhatIsOutOfRange)
{
    auto told = [](Species species, SpreadMode mode = SpreadMode::ApexAngle) {
        species.name = "fir";
        return [species, mode] { validate(species, mode); };
    };
    EXPECT_THAT(told({.spread = 0}),
                ThrowsMessage<InvalidParameter>(AllOf(HasSubstr("fir"), HasSubstr("spread = 0"))));
    EXPECT_THAT(told({.spread = 3.2}), ThrowsMessage<InvalidParameter>(
                                           AllOf(HasSubstr("fir"), HasSubstr("spread = 3.2"))));
    EXPECT_NO_THROW(told({.spread = 3.2}, SpreadMode::RadiusRatio)());
    EXPECT_THAT(told({.spread = 1.6}, SpreadMode::HalfAngle),
                ThrowsMessage<InvalidParameter>(HasSubstr("half_angle")));
    EXPECT_THAT(told({.max_height = -1}),
                ThrowsMessage<InvalidParameter>(HasSubstr("max_height = -1")));
    EXPECT_THAT(told({.max_height = std::numeric_limits<double>::quiet_NaN()}),
                ThrowsMessage<InvalidParameter>(HasSubstr("max_height")));
    EXPECT_THAT(told({.colour = "green"}),
                ThrowsMessage<InvalidParameter>(HasSubstr("colour = green")));
    EXPECT_THAT(told({.limits = {{"water", 0.2, 0.1, 0.4, 0.6, 0.7, 0.8}}}),
                ThrowsMessage<InvalidParameter>(AllOf(HasSubstr("limits.water"),
                                                      HasSubstr("stands_below = 0.1"),
                                                      HasSubstr("dies_below = 0.2"))));
    EXPECT_THAT(told({.limits = {{"water"}, {"water"}}}),
                ThrowsMessage<InvalidParameter>(HasSubstr("given twice")));
}

TEST(Response, RisesAndFallsBetweenItsSixLimits)
{
    const Limits limits{"water", 0.1, 0.2, 0.3, 0.6, 0.8, 0.95};
    EXPECT_LT(response(limits, 0.05), 0);
    EXPECT_EQ(response(limits, 0.15), 0);
    EXPECT_NEAR(response(limits, 0.25), 0.5, 1e-12);
    EXPECT_EQ(response(limits, 0.4), 1);
    EXPECT_NEAR(response(limits, 0.7), 0.5, 1e-12);
    EXPECT_NEAR(response(limits, 0.65), 0.75, 1e-12);
    EXPECT_EQ(response(limits, 0.9), 0);
    EXPECT_LT(response(limits, 0.97), 0);
    EXPECT_LT(response(limits, std::numeric_limits<double>::quiet_NaN()), 0);
}

TEST(Response, IsAThresholdWhereLimitsMeet)
{
    const Limits limits{"water", 0.1, 0.3, 0.3, 0.6, 0.6, 0.9};
    EXPECT_EQ(response(limits, 0.3), 1);
    EXPECT_EQ(response(limits, 0.3 - 1e-9), 0);
    EXPECT_EQ(response(limits, 0.6), 1);
    EXPECT_EQ(response(limits, 0.6 + 1e-9), 0);
    EXPECT_EQ(response(limits, 0.1), 0);
    EXPECT_EQ(response(limits, 0.9), 0);
}

TEST(Land, SlopeOfAPlaneIsItsAngleAtBordersToo)
{
    const double angle = 30 * std::numbers::pi / 180;
    const Land land = plane(std::tan(angle) * 0.6, std::tan(angle) * 0.8);
    for (const int i : {0, 1, 35, kWidth - 1})
        for (const int j : {0, 4, kDepth - 1}) EXPECT_NEAR(land.slope(i, j), angle, 1e-4);
    EXPECT_EQ(Land().slope(3, 4), 0);
}

TEST(Land, HeightIsExactBetweenPixelsOfAPlane)
{
    const Land land = plane(0.3, -0.7);
    EXPECT_NEAR(land.height_at(17.3, 11.9), 100 + 0.3 * 17.3 - 0.7 * 11.9, 1e-4);
    // Beyond the outer pixel centres the border's height goes on.
    EXPECT_NEAR(land.height_at(0, 1.25), land.height(0, 0), 1e-9);
    EXPECT_NEAR(land.height_at(1e9, 1e9), land.height(kWidth - 1, kDepth - 1), 1e-9);
    EXPECT_EQ(Land().height_at(3, 4), 0);
}

TEST(Land, AirCoolsWithHeight)
{
    Land land = plane(0.4, 0);
    land.add_temperature(15, 100);
    ASSERT_TRUE(land.has_factor("temperature"));
    EXPECT_NEAR(land.factors[0].at(10, 2), 15 - 0.0065 * 0.4 * 10.5 * kPixel, 1e-5);
    land.add_temperature(30, 100);
    EXPECT_EQ(land.factors.size(), 1u);

    Land flat;
    flat.add_temperature(15, -200);
    EXPECT_NEAR(flat.factors[0].at(0, 0), 15 - 0.0065 * 200, 1e-5);
}

TEST(Land, KillsStopsAndFeedsAlongAGradientOfWater)
{
    Land land;
    land.factors.push_back(along_x("water"));
    land.bind({{.limits = {{"water", 0.2, 0.3, 0.4, 0.6, 0.7, 0.8}}}, {}});
    for (int i = 0; i < kWidth; ++i) {
        const double e = land.factors[0].at(i, 3), f = land.vigour(0, i, 3);
        EXPECT_EQ(f < 0, e < 0.2 || e > 0.8) << e;
        EXPECT_EQ(land.admits(0, i, 3), e >= 0.2 && e <= 0.8) << e;
        if (e >= 0.2 && e <= 0.3) {
            EXPECT_EQ(f, 0) << e;
        }
        if (e >= 0.4 && e <= 0.6) {
            EXPECT_EQ(f, 1) << e;
        }
        EXPECT_EQ(land.vigour(1, i, 3), 1);
    }
}

TEST(Land, TheScarcestFactorLimitsOrAllMultiply)
{
    Land land;
    land.factors.push_back({"water", {}, 0.25f});
    land.factors.push_back({"light", {}, 0.5f});
    const Limits water{"water", 0, 0, 1, 1, 1, 1}, light{"light", 0, 0, 1, 1, 1, 1};
    land.bind({{.limits = {water, light}}});
    EXPECT_DOUBLE_EQ(land.vigour(0, 0, 0), 0.25);
    land.combine = Combine::Product;
    EXPECT_DOUBLE_EQ(land.vigour(0, 0, 0), 0.125);
    // Nothing makes good for a factor that kills.
    land.factors[1].constant = 1.5f;
    EXPECT_LT(land.vigour(0, 0, 0), 0);
    land.factors[0].constant = -1;
    EXPECT_LT(land.vigour(0, 0, 0), 0);
}

TEST(Land, AdmitsNoSeedlingOnSteepForbiddenOrRockyGround)
{
    Land land = plane(std::tan(0.5), 0);
    land.bind({{.max_slope = 0.49}, {.max_slope = 0.51}});
    EXPECT_FALSE(land.admits(0, 5, 5));
    EXPECT_TRUE(land.admits(1, 5, 5));
    land.plantable = {kWidth, kDepth, 1};
    land.plantable.set(5, 5, 0);
    EXPECT_FALSE(land.admits(1, 5, 5));
    EXPECT_TRUE(land.admits(1, 5, 6));
    land.blocked_height = {kWidth, kDepth, 0.0f};
    land.blocked_height.set(5, 6, 0.25f);
    EXPECT_FALSE(land.admits(1, 5, 6));
    EXPECT_TRUE(land.admits(1, 6, 6));
}

TEST(Land, NoneStandsOnACliffOfSixtyDegrees)
{
    Land land = plane(0, 0);
    for (int j = 0; j < kDepth; ++j)
        for (int i = 0; i < kWidth; ++i) {
            const double x = (i + 0.5) * kPixel, foot = 20 * kPixel, top = 30 * kPixel;
            const double thirty = std::tan(std::numbers::pi / 6), sixty = std::sqrt(3.0);
            land.ground.set(i, j,
                            float(x < foot  ? x * thirty
                                  : x < top ? foot * thirty + (x - foot) * sixty
                                            : foot * thirty + (top - foot) * sixty));
        }
    land.bind({{}});
    for (int i = 0; i < kWidth; ++i) {
        const bool cliff = i >= 20 && i < 30, edge = i == 19 || i == 20 || i == 29 || i == 30;
        if (!edge) {
            EXPECT_EQ(land.admits(0, i, 4), !cliff) << i;
        }
    }
}

TEST(Land, NamesTheMapThatASpeciesMisses)
{
    Land land;
    land.factors.push_back({"water", {}, 0.5f});
    EXPECT_THAT([&] { land.bind({{.name = "fir", .limits = {{"watr"}}}}); },
                ThrowsMessage<InvalidParameter>(
                    AllOf(HasSubstr("fir"), HasSubstr("'watr'"), HasSubstr("'water'"))));
}

TEST(Raster, KeepsValuesAcrossBlocksAndForgetsEqualOnes)
{
    Raster<float> raster(130, 70, 2.0f);
    const std::size_t bare = raster.memory_bytes();
    raster.set(129, 69, 5.0f);
    raster.set(64, 0, 7.0f);
    EXPECT_EQ(raster.at(129, 69), 5);
    EXPECT_EQ(raster.at(64, 0), 7);
    EXPECT_EQ(raster.at(63, 0), 2);
    EXPECT_EQ(raster.at(128, 69), 2);
    float value = 0;
    EXPECT_FALSE(raster.constant(0, 130, 0, 70, value));
    EXPECT_TRUE(raster.constant(0, 64, 0, 70, value));
    EXPECT_EQ(value, 2);
    EXPECT_FALSE(raster.constant(60, 65, 60, 64, value));
    raster.set(129, 69, 2.0f);
    raster.set(64, 0, 2.0f);
    EXPECT_GT(raster.memory_bytes(), bare);
    raster.compress();
    EXPECT_EQ(raster.memory_bytes(), bare);
    // The corner's block reaches beyond the raster.
    for (int j = 64; j < 70; ++j)
        for (int i = 128; i < 130; ++i) raster.set(i, j, 9.0f);
    raster.compress();
    EXPECT_EQ(raster.memory_bytes(), bare);
    EXPECT_EQ(raster.at(129, 69), 9);
}

}  // namespace
}  // namespace sekitei::forest
