#include "solvers/wind/air.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/error.h"

namespace sekitei::wind {
namespace {

WeatherDay day_of(double temperature, double humidity, double speed, int from = 6)
{
    WeatherDay day;
    day.temperature = temperature;
    day.humidity = humidity;
    day.wind_speed = speed;
    day.wind_direction = from;
    return day;
}

AirTables tables_of(double touched)
{
    AirTables tables;
    tables.temperature[6] = tables.humidity[6] = touched;
    tables.speed[6] = 0.6;
    return tables;
}

// The numbers were found by an independent evaluation of the equations.

TEST(Air, ExchangeOverWaterFollowsThePlate)
{
    const double speeds[] = {0.5, 3, 8};
    const double laminar[] = {0.029798, 0.012165, 0.007449};
    const double piecewise[] = {0.032634, 0.012165, 0.007560};
    for (int i = 0; i < 3; ++i) {
        EXPECT_NEAR(exchange_coefficient(speeds[i], ExchangeLaw::Laminar), laminar[i], 6e-7);
        EXPECT_NEAR(exchange_coefficient(speeds[i], ExchangeLaw::Piecewise), piecewise[i], 6e-7);
    }
    EXPECT_NEAR(exchange_coefficient(1, ExchangeLaw::Laminar), 0.02107012, 1e-8);
}

TEST(Air, PiecesOfTheExchangeMeetWithinAThird)
{
    const double per_speed = 0.03 / 1.51e-5;
    const double bounds[] = {2.5e3, 1.5e4, 6.5e6};
    const double jumps[] = {0.0014, 0.0026, 0.0031};
    for (int i = 0; i < 3; ++i) {
        const double u = bounds[i] / per_speed;
        const double below = exchange_coefficient(u * (1 - 1e-9), ExchangeLaw::Piecewise);
        const double above = exchange_coefficient(u * (1 + 1e-9), ExchangeLaw::Piecewise);
        EXPECT_NEAR(std::abs(above / below - 1), jumps[i], 6e-5) << bounds[i];
    }
}

TEST(Air, CalmDoesNotMakeTheExchangeInfinite)
{
    EXPECT_EQ(exchange_coefficient(0, ExchangeLaw::Laminar),
              exchange_coefficient(0.05, ExchangeLaw::Laminar));
}

TEST(Air, TouchesAddUpToTheFetchOverTheDepth)
{
    const double c = exchange_coefficient(3, ExchangeLaw::Laminar);
    EXPECT_NEAR(water_touch(3, 0.03 / 3, 3, 0.5) * c, 0.00072989, 6e-9);
    double fetch = 0, slowed = 0;
    for (int i = 0; i < 500; ++i) fetch += water_touch(3, 5.0 / 3 / 500, 3, 0.5);
    for (int i = 0; i < 500; ++i) slowed += water_touch(3, 2.0 / 3 / 500, 3, 0.5);
    for (int i = 0; i < 500; ++i) slowed += water_touch(1.5, 3.0 / 1.5 / 500, 3, 0.5);
    EXPECT_NEAR(fetch, 10.0, 1e-11);
    EXPECT_NEAR(fetch * c, 0.121648, 6e-7);
    EXPECT_NEAR(slowed, 12.485281, 6e-7);
    EXPECT_NEAR(slowed * c, 0.151881, 6e-7);
}

TEST(Air, IsDrawnTowardsTheWatersState)
{
    const AirTables tables = tables_of(10);
    const Exchange bounded, linear{.bounded = false};
    const Air winter = air_before(day_of(275.15, 0.60, 3), 283.15, tables, bounded);
    EXPECT_NEAR(winter.temperature, 276.06632, 6e-6);
    EXPECT_NEAR(winter.humidity, 0.684639, 6e-7);
    EXPECT_DOUBLE_EQ(winter.speed, 0.6 * 3);
    const Air straight = air_before(day_of(275.15, 0.60, 3), 283.15, tables, linear);
    EXPECT_NEAR(straight.temperature, 276.12319, 6e-6);
    EXPECT_NEAR(straight.humidity, 0.689455, 6e-7);
    const Air summer = air_before(day_of(301.15, 0.65, 3), 293.15, tables, bounded);
    EXPECT_NEAR(summer.temperature, 300.23368, 6e-6);
    EXPECT_NEAR(summer.humidity, 0.682057, 6e-7);
    const Air calm = air_before(day_of(288.15, 0.70, 0.2), 283.15, tables, bounded);
    EXPECT_NEAR(calm.temperature, 286.27144, 6e-6);
    EXPECT_NEAR(calm.humidity, 0.799265, 6e-7);
    const Air calm_linear = air_before(day_of(288.15, 0.70, 0.2), 283.15, tables, linear);
    EXPECT_NEAR(calm_linear.temperature, 285.79429, 6e-6);
    EXPECT_NEAR(calm_linear.humidity, 0.826864, 6e-7);
}

TEST(Air, IsTheWeatherWhereNoWaterWasTouched)
{
    const AirTables tables = tables_of(10);
    const Air air = air_before(day_of(290.15, 0.55, 0, 2), 283.15, tables, {});
    EXPECT_EQ(air.temperature, 290.15);
    EXPECT_NEAR(air.humidity, 0.55, 1e-15);
    EXPECT_EQ(air.speed, 0);
}

TEST(Air, NeverPassesTheWatersTemperatureNorSaturation)
{
    const Air air = air_before(day_of(263.15, 1.0, 0.01), 293.15, tables_of(1e4), {});
    EXPECT_NEAR(air.temperature, 293.15, 1e-9);
    EXPECT_LE(air.humidity, 1.0);
}

TEST(Air, EachLayerHasItsOwnTouch)
{
    AirTables tables = tables_of(2.5);
    tables.layers.resize(4);
    tables.layers[0][6] = 10;
    tables.layer_base = -0.25;
    const WeatherDay day = day_of(301.15, 0.65, 3);
    const std::vector<Air> air = air_by_layer(day, 293.15, tables, {});
    ASSERT_EQ(air.size(), 4u);
    EXPECT_NEAR(air[0].temperature, 300.23368, 6e-6);
    EXPECT_EQ(air[3].temperature, 301.15);
    EXPECT_EQ(tables.layer_at(-3), 0u);
    EXPECT_EQ(tables.layer_at(0.24), 0u);
    EXPECT_EQ(tables.layer_at(0.26), 1u);
    EXPECT_EQ(tables.layer_at(50), 3u);
    EXPECT_TRUE(air_by_layer(day, 293.15, tables_of(1), {}).empty());
}

TEST(Air, HeatAndVapourMayDiffer)
{
    AirTables tables = tables_of(10);
    tables.humidity[6] = 0;
    const Air air = air_before(day_of(301.15, 0.65, 3), 293.15, tables, {});
    EXPECT_NEAR(air.temperature, 300.23368, 6e-6);
    EXPECT_GT(air.humidity, 0.65);  // the same vapour in colder air
    EXPECT_LT(air.humidity, 0.70);
}

TEST(Air, PondsAreColdInWinterAndWarmInSummer)
{
    EXPECT_NEAR(water_temperature(30), 283.15, 1e-12);
    EXPECT_NEAR(water_temperature(212), 293.15, 1e-3);
    EXPECT_NEAR(water_temperature(121), 288.15, 0.05);
}

TEST(Air, NearestDirectionGoesRound)
{
    const double octant = M_PI / 4;
    for (int k = 0; k < 8; ++k) {
        EXPECT_EQ(nearest_direction(k * octant), k);
        EXPECT_EQ(nearest_direction((k + 0.4) * octant), k);
        EXPECT_EQ(nearest_direction((k - 0.4) * octant), k);
        EXPECT_EQ(nearest_direction((k - 8) * octant), k);
        EXPECT_NEAR(AirTables{}.direction[std::size_t(k)], k * octant, 1e-15);
    }
}

TEST(Air, NamesWhatIsOutOfRange)
{
    const auto message = [](const WeatherDay& day, double water) {
        try {
            air_before(day, water, {}, {});
        } catch (const InvalidInput& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    EXPECT_EQ(message(day_of(100, 0.5, 1), 283), "wind: temperature = 100 K, must be 180 to 340");
    EXPECT_EQ(message(day_of(283, 1.5, 1), 283), "wind: humidity = 1.5, must be 0 to 1");
    EXPECT_EQ(message(day_of(283, NAN, 1), 283), "wind: humidity = nan, must be 0 to 1");
    EXPECT_EQ(message(day_of(283, 0.5, -1), 283), "wind: wind speed = -1 m/s, must be >= 0");
    EXPECT_EQ(message(day_of(283, 0.5, 1), 20),
              "wind: water temperature = 20 K, must be 180 to 340");
    EXPECT_EQ(message(day_of(283, 0.5, 1, 8), 283),
              "wind: wind direction = 8, must be 0 to 7 (N NE E SE S SW W NW)");
}

}  // namespace
}  // namespace sekitei::wind
