#include "solvers/sun/sun.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/solar_day.h"

namespace sekitei::sun {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr double kDegree = std::numbers::pi / 180;
const Site kMorioka{39.70 * kDegree, 141.15 * kDegree};

Radiation half_sunny(int year, int month, int day, const std::vector<Moment>& moments)
{
    WeatherDay weather;
    weather.year = year, weather.month = month, weather.day = day;
    weather.possible_sunshine = possible_sunshine(kMorioka.latitude, day_of_year(year, month, day));
    weather.sunshine = weather.possible_sunshine / 2;
    return radiation(weather, kMorioka, moments);
}

void expect_position(const Position& p, double elevation_deg, double azimuth_deg)
{
    EXPECT_NEAR(p.elevation / kDegree, elevation_deg, 0.05);
    EXPECT_NEAR(p.azimuth / kDegree, azimuth_deg, 0.05);
}

// The first case is the worked example of [Reda2004] without its refraction.
TEST(Sun, StandsWhereTheReferencesPutIt)
{
    const Site golden{39.742476 * kDegree, -105.1786 * kDegree};
    expect_position(position(julian_day(2003, 10, 17, 19.5 + 30 / 3600.0), golden), 39.872,
                    194.343);
    expect_position(position(julian_day(2024, 6, 21, 3), kMorioka), 73.041, 198.169);
    expect_position(position(julian_day(2024, 12, 21, 2.5), kMorioka), 26.856, 179.094);
}

TEST(Sun, IsOverheadAtTheSubsolarPointAndRisesInTheEast)
{
    // Equinox 2024-03-20 03:06 UTC: declination 0; the sun is over the equator near longitude
    // (12 - 3.1) 15 deg + equation of time.
    const double jd = julian_day(2024, 3, 20, 3.1);
    double best = -1;
    for (int lon = 120; lon <= 150; ++lon)
        best = std::max(best, position(jd, {0, lon * kDegree}).elevation);
    EXPECT_GT(best / kDegree, 89.4);
    const auto day = moments_of_day(2024, 3, 20, {0.6, 1.1}, 960);
    EXPECT_NEAR(direction({0, day.front().to_sun.x > 0 ? 90 * kDegree : 0}).x, 1, 1e-12);
    EXPECT_GT(day.front().to_sun.x, 0.99);
    EXPECT_LT(day.back().to_sun.x, -0.99);
}

TEST(Sun, DirectionHasUnitLengthAndTheAnglesItCameFrom)
{
    const Vec3d d = direction({30 * kDegree, 120 * kDegree});
    EXPECT_NEAR(d.x, std::cos(30 * kDegree) * std::sin(120 * kDegree), 1e-15);
    EXPECT_NEAR(d.y, -0.5 * std::cos(30 * kDegree), 1e-15);
    EXPECT_NEAR(d.z, 0.5, 1e-15);
}

TEST(Sun, ExtraterrestrialLightAndDayLengthFollowFao56)
{
    // Example 8 of [Allen1998]: 20 S, 3 September.
    const int september = day_of_year(2023, 9, 3);
    EXPECT_EQ(september, 246);
    EXPECT_NEAR(extraterrestrial_radiation(-20 * kDegree, 246) * 0.0864, 32.194, 0.032);
    EXPECT_NEAR(possible_sunshine(-20 * kDegree, 246), 11.666, 0.0117);
    EXPECT_NEAR(extraterrestrial_radiation(39.7 * kDegree, 172), 484.54, 0.48);
    EXPECT_NEAR(possible_sunshine(39.7 * kDegree, 172), 14.812, 0.0148);
    EXPECT_NEAR(extraterrestrial_radiation(39.7 * kDegree, 355), 158.62, 0.16);
    EXPECT_NEAR(possible_sunshine(39.7 * kDegree, 355), 9.188, 0.0092);
}

TEST(Sun, PolarNightIsDarkAndPolarDayHasNoEnd)
{
    const double pole = 89 * kDegree;
    EXPECT_EQ(possible_sunshine(pole, 355), 0);
    EXPECT_EQ(extraterrestrial_radiation(pole, 355), 0);
    EXPECT_NEAR(possible_sunshine(pole, 172), 24, 1e-12);
    const Site north{pole, 0.3};
    const auto night = moments_of_day(2023, 12, 21, north, 96);
    EXPECT_TRUE(night.empty());
    WeatherDay weather;
    weather.year = 2023, weather.month = 12, weather.day = 21;
    const Radiation r = radiation(weather, north, night);
    EXPECT_EQ(r.global, 0);
    EXPECT_EQ(r.beam_normal, 0);
    EXPECT_EQ(light_on_plane({0, 0, 1}, night, r, 0.2).total(), 0);
    EXPECT_EQ(moments_of_day(2023, 6, 21, north, 96).size(), 96u);
}

TEST(Sun, UnshadedPlanesGetTheLightOfTheOracle)
{
    const auto june = moments_of_day(2024, 6, 21, kMorioka, 288);
    const Radiation r = half_sunny(2024, 6, 21, june);
    EXPECT_NEAR(r.global, 242.2, 2.4);
    EXPECT_NEAR(light_on_plane({0, 0, 1}, june, r, 0.2).total(), 242.2, 2.4);
    const PlaneLight north = light_on_plane({0, 1, 0}, june, r, 0.2);
    EXPECT_NEAR(north.total(), 117.2, 1.17);
    EXPECT_NEAR(north.direct, 19.3, 0.2);
    EXPECT_NEAR(north.sky, 73.7, 0.74);
    EXPECT_NEAR(north.ground, 24.2, 0.24);
    const PlaneLight south = light_on_plane({0, -1, 0}, june, r, 0.2);
    EXPECT_NEAR(south.total(), 113.3, 1.13);
    EXPECT_NEAR(south.direct, 15.4, 0.2);

    const auto december = moments_of_day(2024, 12, 21, kMorioka, 288);
    const Radiation w = half_sunny(2024, 12, 21, december);
    EXPECT_NEAR(light_on_plane({0, -1, 0}, december, w, 0.2).total(), 119.2, 1.2);
    EXPECT_NEAR(light_on_plane({0, -1, 0}, december, w, 0.2).direct, 88.7, 0.9);
}

TEST(Sun, BeamOfTheMomentsAddsUpToTheDaysBeam)
{
    for (const std::size_t count : {24u, 96u, 1440u}) {
        const auto moments = moments_of_day(2023, 4, 2, kMorioka, count);
        const Radiation r = half_sunny(2023, 4, 2, moments);
        EXPECT_NEAR(light_on_plane({0, 0, 1}, moments, r, 0).direct, r.beam, 1e-10 * r.beam);
        EXPECT_NEAR(r.beam + r.diffuse, r.global, 1e-12 * r.global);
    }
    // A quadrature of 96 moments is within 0.2 % of 1440 on every wall.
    const auto coarse = moments_of_day(2023, 4, 2, kMorioka, 96);
    const auto fine = moments_of_day(2023, 4, 2, kMorioka, 1440);
    const Radiation rc = half_sunny(2023, 4, 2, coarse);
    const Radiation rf = half_sunny(2023, 4, 2, fine);
    for (const Vec3d wall : {Vec3d{1, 0, 0}, Vec3d{-1, 0, 0}, Vec3d{0, -1, 0}})
        EXPECT_NEAR(light_on_plane(wall, coarse, rc, 0).direct,
                    light_on_plane(wall, fine, rf, 0).direct, 0.002 * rf.beam);
}

TEST(Sun, EastAndWestWallsAreMirrorsOnASymmetricDay)
{
    const auto moments = moments_of_day(2023, 6, 13, kMorioka, 960);  // equation of time near 0
    const Radiation r = half_sunny(2023, 6, 13, moments);
    EXPECT_NEAR(light_on_plane({1, 0, 0}, moments, r, 0).direct,
                light_on_plane({-1, 0, 0}, moments, r, 0).direct, 0.5);
}

TEST(Sun, MirroredHemisphereSwapsNorthAndSouth)
{
    // Half a year later the other hemisphere sees the same sun, but for the orbit's ellipse.
    const Site south{-kMorioka.latitude, kMorioka.longitude};
    const auto here = moments_of_day(2023, 9, 23, kMorioka, 960);
    const auto there = moments_of_day(2023, 9, 23, south, 960);
    double north = 0, mirrored = 0;
    for (const Moment& m : here) north += m.to_sun.y;
    for (const Moment& m : there) mirrored -= m.to_sun.y;
    EXPECT_NEAR(north / static_cast<double>(here.size()),
                mirrored / static_cast<double>(there.size()), 0.01);
}

TEST(Sun, MeasuredLightReplacesTheFormulas)
{
    const auto moments = moments_of_day(2023, 4, 2, kMorioka);
    WeatherDay day;
    day.year = 2023, day.month = 4, day.day = 2;
    day.global_radiation = 180;
    day.diffuse_radiation = 70;
    const Radiation r = radiation(day, kMorioka, moments);
    EXPECT_EQ(r.global, 180);
    EXPECT_EQ(r.diffuse, 70);
    EXPECT_EQ(r.beam, 110);
    day.diffuse_radiation = 200;  // a sensor's error cannot make the beam negative
    EXPECT_EQ(radiation(day, kMorioka, moments).beam, 0);
}

TEST(Sun, DiffuseShareJoinsTheOvercastAndTheClearEnd)
{
    EXPECT_EQ(diffuse_share(0, 1.5), 1);
    EXPECT_EQ(diffuse_share(0.9, 1.5), 0.175);
    EXPECT_EQ(diffuse_share(0.9, 1.3), 0.143);
    EXPECT_NEAR(diffuse_share(0.722 - 1e-9, 1.5), 0.175, 0.02);
    EXPECT_NEAR(diffuse_share(0.715 - 1e-9, 1.3), 0.143, 0.02);
    EXPECT_NEAR(diffuse_share(0.5, 1.5), 0.608275, 1e-12);
}

TEST(Sun, NamesTheBadParameter)
{
    EXPECT_THAT(
        [] {
            position(2451545, {91 * kDegree, 0});
        },
        testing::ThrowsMessage<InvalidParameter>(
            AllOf(HasSubstr("latitude = 91 deg"), HasSubstr("-90 to 90"))));
    EXPECT_THAT([] { julian_day(2023, 2, 30, 0); },
                testing::ThrowsMessage<InvalidParameter>(HasSubstr("2023-02-30")));
    EXPECT_THAT([] { moments_of_day(2023, 2, 3, {}, 0); },
                testing::ThrowsMessage<InvalidParameter>(HasSubstr("moments")));
}

TEST(SolarDay, CountsDaysThroughLeapYears)
{
    EXPECT_TRUE(date_exists(2024, 2, 29));
    EXPECT_FALSE(date_exists(2023, 2, 29));
    EXPECT_FALSE(date_exists(1900, 2, 29));
    EXPECT_EQ(day_of_year(2024, 12, 31), 366);
    EXPECT_EQ(day_number(2012, 3, 1) - day_number(2012, 2, 28), 2);
    EXPECT_EQ(date_of(day_number(2015, 7, 9)), (Date{2015, 7, 9}));
}

}  // namespace
}  // namespace sekitei::sun
