#include "solvers/soil/soil.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"

namespace sekitei::soil {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;

const Soil& kind(std::string_view name)
{
    for (const Soil& s : preset_soils())
        if (s.name == name) return s;
    throw std::out_of_range("no such soil");
}

constexpr double kPressure = 1013;

void expect_relative(double found, double expected, double tolerance, const std::string& what)
{
    EXPECT_NEAR(found, expected, tolerance * std::abs(expected)) << what;
}

// Reference values of an independent evaluation of the formulas in the header.
TEST(Soil, SaturationFollowsTheTetensFormulaAndItsDerivative)
{
    struct Row {
        double t, e, q, slope;
    };
    for (const Row r : {Row{263.15, 2.8570932, 1.7561783e-3, 1.3944652e-4},
                        Row{278.15, 8.7227139, 5.3733910e-3, 3.7629824e-4},
                        Row{288.15, 17.052284, 1.0537455e-2, 6.8272877e-4},
                        Row{298.15, 31.674893, 1.9681573e-2, 1.1863193e-3}}) {
        expect_relative(vapour_pressure(r.t), r.e, 1e-6, "e");
        expect_relative(saturation_humidity(r.t, kPressure), r.q, 1e-6, "q");
        expect_relative(saturation_slope(r.t, kPressure), r.slope, 1e-6, "slope");
        const double h = 1e-3;
        const double centred =
            (saturation_humidity(r.t + h, kPressure) - saturation_humidity(r.t - h, kPressure)) /
            (2 * h);
        expect_relative(saturation_slope(r.t, kPressure), centred, 1e-7, "difference quotient");
        EXPECT_NEAR(dew_point(r.q, kPressure), r.t, 1e-5);
    }
}

TEST(Soil, BetaRisesWithWaterAndFallsWithWind)
{
    const double bare = Params{}.exchange_bare;
    const double wind[] = {0.2, 1, 3};
    struct Row {
        double theta, beta[3];
    };
    for (const Row& r : {Row{0, {.3294, .0895, .0317}}, Row{.1, {.8280, .4906, .2430}},
                         Row{.2, {.9894, .9491, .8613}}, Row{.3, {.9998, .9992, .9977}}})
        for (int i = 0; i < 3; ++i)
            EXPECT_NEAR(evaporation_share(kind("humus"), r.theta, bare, wind[i]), r.beta[i], 5e-5);
    for (const Soil& s : preset_soils()) EXPECT_EQ(evaporation_share(s, s.porosity, bare, 1), 1);
    EXPECT_EQ(evaporation_share(kind("asphalt_printed"), 0, bare, 3), 1);
}

TEST(Soil, CloudFactorIsTheCubicOfSunshine)
{
    EXPECT_DOUBLE_EQ(cloud_factor(0), 0.298);
    EXPECT_DOUBLE_EQ(cloud_factor(0.25), 0.51753125);
    EXPECT_DOUBLE_EQ(cloud_factor(0.75), 0.80359375);
    EXPECT_DOUBLE_EQ(cloud_factor(1), 1.025);
}

struct Oracle {
    Site site;
    double sunshine;
    const char* soil;
    double temperature[2], humidity[2], evaporation[2], water[2], beta[2], runoff;
    bool limited = false;
};

const Oracle kOracles[] = {
    {{30, 288.15, .73, 0, .2, 1, 0, 300, 73.5},
     .75,
     "humus",
     {278.062, 278.735},
     {1, 1},
     {-0.0731563, -0.111443},
     {73.5732, 73.6114},
     {1, 1},
     0},
    {{30, 288.15, .73, 0, .2, 0, 0, 300, 73.5},
     .75,
     "humus",
     {291.434, 291.513},
     {0.99919, 0.999205},
     {0.164838, 0.159592},
     {73.3352, 73.3404},
     {0.998016, 0.998016},
     0},
    {{150, 288.15, .73, 0, .2, 1, 0, 300, 23.52},
     .75,
     "sand",
     {293.575, 293.791},
     {0.980151, 0.980864},
     {0.214127, 0.199726},
     {23.3059, 23.3203},
     {0.958883, 0.958883},
     0},
    {{150, 293.15, .73, 10.34, 3, 1, .5, 20, 2},
     .75,
     "humus",
     {291.697, 291.731},
     {1, 1},
     {1.8532, 1.83872},
     {7.9468, 7.96128},
     {1, 1},
     2.54},
    {{40, 288.15, .60, 0, 3, .5, 0, 20, .24},
     .5,
     "rock",
     {287.379, 287.381},
     {0.682151, 0.682861},
     {0.24, 0.24},
     {0, 0},
     {0.139026, 0.139418},
     0,
     true},
    {{80, 288.15, .60, 0, 3, .5, 1, 20, .05},
     .5,
     "rock",
     {289.924, 289.929},
     {0.539806, 0.542544},
     {0.05, 0.05},
     {0, 0},
     {0.00976151, 0.00986869},
     0,
     true},
    {{0, 283.15, .80, 0, 1, 1, 0, 300, 40},
     1,
     "humus",
     {270.477, 271.884},
     {1, 1},
     {-0.462382, -0.65776},
     {40.4624, 40.6578},
     {1, 1},
     0},
    {{100, 303.15, .50, 0, 2, 1, 0, 20, 3},
     1,
     "sand",
     {295.273, 296.177},
     {0.998853, 0.99909},
     {1.01574, 0.766277},
     {1.98426, 2.23372},
     {0.994229, 0.994229},
     0},
};

TEST(Soil, EightDaysMatchTheIndependentSolution)
{
    int number = 0;
    for (const Oracle& o : kOracles) {
        ++number;
        for (const int linear : {0, 1}) {
            Params params;
            params.balance = linear ? Balance::Linear : Balance::Exact;
            const Day d = day(o.site, {.sunshine = o.sunshine}, kind(o.soil), params);
            const std::string what =
                "day " + std::to_string(number) + (linear ? " linear" : " exact");
            // Half a unit of the last printed digit comes on top of 1e-4 K and 1e-5.
            EXPECT_NEAR(d.temperature, o.temperature[linear], 6e-4) << what;
            expect_relative(d.humidity, o.humidity[linear], 1e-5, what);
            expect_relative(d.evaporation, o.evaporation[linear], 1e-5, what);
            EXPECT_NEAR(d.water, o.water[linear], 1e-5 * o.water[linear]) << what;
            expect_relative(d.beta, o.beta[linear], 1e-5, what);
            EXPECT_NEAR(d.runoff, o.runoff, 1e-12) << what;
        }
    }
}

TEST(Soil, ThirtyDaysOfRainAndSunMatchTheIndependentSolution)
{
    struct Row {
        int d;
        double temperature, humidity, evaporation, water;
    };
    const Row rows[] = {
        {1, 287.92125, 0.995952, 0.657580, 4.242420}, {2, 288.85908, 0.986565, 0.658261, 3.584160},
        {3, 289.57324, 1, 0.703925, 9.096075},        {5, 290.80272, 1, 0.732240, 9.067760},
        {8, 291.37097, 1, 0.745340, 8.309321},        {13, 288.77385, 1, 0.685559, 9.114441},
        {21, 282.78943, 1, 0.550974, 9.249026},       {30, 286.97954, 1, 0.644561, 8.531652}};
    double water = 4.9, rained = 0, evaporated = 0, ran = 0;
    const Row* row = rows;
    for (int d = 1; d <= 30; ++d) {
        const bool wet = 180 * d / 365 > 180 * (d - 1) / 365;
        const Site site{.light = 60,
                        .temperature = 288.15 + 5 * std::sin(2 * std::numbers::pi * d / 30),
                        .humidity = .73,
                        .rain = wet ? 1861.2 / 180 : 0,
                        .wind = 2,
                        .sky_view = .6,
                        .depth = 20,
                        .water = water};
        const Day result = day(site, {.sunshine = .5}, kind("humus"), {});
        water = result.water;
        rained += site.rain;
        evaporated += result.evaporation;
        ran += result.runoff;
        if (d != row->d) continue;
        EXPECT_NEAR(result.temperature, row->temperature, 1e-4);
        expect_relative(result.humidity, row->humidity, 1e-5, "rh_s");
        expect_relative(result.evaporation, row->evaporation, 1e-5, "E");
        expect_relative(result.water, row->water, 1e-5, "O");
        ++row;
    }
    EXPECT_NEAR(rained, 144.76, 1e-9);
    EXPECT_NEAR(evaporated, 19.324538, 1e-5);
    EXPECT_NEAR(ran, 121.80381, 1e-4);
    EXPECT_NEAR(rained + 4.9 - evaporated - ran - water, 0, 1e-12);
}

/// A random but plausible site; extremes included.
Site random_site(std::uint64_t i)
{
    auto draw = [&](const char* name) { return uniform01(5, Stream(name), i); };
    return {.light = 400 * draw("S") * draw("S2"),
            .temperature = 230 + 90 * draw("T"),
            .humidity = draw("rh"),
            .rain = draw("wet") < 0.4 ? 30 * draw("P") : 0,
            .wind = 12 * draw("U") * draw("U2"),
            .sky_view = draw("V"),
            .cover = draw("c"),
            .depth = 1 + 400 * draw("h") * draw("h2"),
            .water = 0};
}

TEST(Soil, EnergyAndWaterBalanceOnTenThousandRandomSites)
{
    int limited = 0, dewy = 0;
    for (const Balance balance : {Balance::Exact, Balance::Linear})
        for (std::uint64_t i = 0; i < 10000; ++i) {
            Params params;
            params.balance = balance;
            params.moss_blocks_evaporation = i % 2 == 0;
            params.longwave = i % 3 == 0 ? Longwave::Brutsaert : Longwave::Paper;
            const Soil& soil = preset_soils()[i % preset_soils().size()];
            Site site = random_site(i);
            site.water = site.depth * soil.porosity * uniform01(6, Stream("O"), i);
            const Air air{.sunshine = uniform01(7, Stream("A"), i), .pressure = 950};
            const Day d = day(site, air, soil, params);
            ASSERT_TRUE(std::isfinite(d.temperature));
            // Water: nothing made, nothing lost, never below zero or over the brim.
            ASSERT_NEAR(site.water + site.rain, d.water + d.evaporation + d.runoff, 1e-9);
            ASSERT_GE(d.water, 0);
            ASSERT_LE(d.water, site.depth * soil.porosity * (1 + 1e-15));
            ASSERT_GT(d.humidity, 0);
            ASSERT_LE(d.humidity, 1 + 1e-12);
            ASSERT_GE(d.beta, 0);
            ASSERT_LE(d.beta, 1);
            // Energy.
            const double t = site.temperature, rise = d.temperature - t;
            const double out =
                balance == Balance::Exact
                    ? kStefanBoltzmann * std::pow(d.temperature, 4)
                    : kStefanBoltzmann * (std::pow(t, 4) + 4 * std::pow(t, 3) * rise);
            ASSERT_NEAR(d.absorbed, out + d.sensible + d.latent, 1e-8)
                << "site " << i << " T " << t << " Ts " << d.temperature;
            ASSERT_NEAR(d.latent, kLatentHeat * d.evaporation / kDaySeconds, 1e-8);
            limited += d.water == 0 && d.evaporation > 0;
            dewy += d.evaporation < 0;
        }
    EXPECT_GT(limited, 100);
    EXPECT_GT(dewy, 100);
}

TEST(Soil, LinearBalanceApproachesTheExactOneForSmallRises)
{
    // Without net radiation or dryness the surface keeps the temperature of the air; nearby, the
    // difference between the two balances is of second order in the rise.
    auto difference = [](double light) {
        const Site site{.light = light,
                        .temperature = 288.15,
                        .humidity = 1,
                        .wind = 2,
                        .sky_view = 0,
                        .depth = 300,
                        .water = 147};
        Params linear;
        linear.balance = Balance::Linear;
        const Air air{.sunshine = .5};
        return day(site, air, kind("humus"), linear).temperature -
               day(site, air, kind("humus"), {}).temperature;
    };
    EXPECT_NEAR(difference(0), 0, 1e-9);
    EXPECT_NEAR(std::log2(difference(20) / difference(10)), 2, 0.05);
}

TEST(Soil, MeasuredLongwaveReplacesTheFormula)
{
    const Site site{.light = 50,
                    .temperature = 288.15,
                    .humidity = .7,
                    .wind = 2,
                    .sky_view = .6,
                    .depth = 20,
                    .water = 1};
    const Air air{.sunshine = .5, .longwave = 300.0};
    const double black = kStefanBoltzmann * std::pow(288.15, 4);
    EXPECT_NEAR(day(site, air, kind("rock"), {}).absorbed, .8 * 50 + .6 * 300 + .4 * black, 1e-9);
}

TEST(Soil, BrutsaertSkyWarmsWithVapour)
{
    const Site site{.temperature = 288.15, .humidity = .73, .wind = 2, .depth = 20, .water = 1};
    Params params;
    params.longwave = Longwave::Brutsaert;
    // [Brutsaert1975] gives a clear-sky emissivity of 0.79 for this vapour; C(1) = 1.025.
    const double black = kStefanBoltzmann * std::pow(288.15, 4);
    EXPECT_NEAR(day(site, {.sunshine = 1}, kind("rock"), params).absorbed / black,
                1 - (1 - 0.79) * 1.025, 0.003);
    EXPECT_NEAR(day(site, {.sunshine = 1}, kind("rock"), {}).absorbed / black, 1 - 0.26 * 1.025,
                1e-12);
}

TEST(Soil, MossRaisesEvaporationUnlessItBlocksIt)
{
    Site site{.light = 200,
              .temperature = 288.15,
              .humidity = .73,
              .wind = 1,
              .depth = 300,
              .water = 147};
    const Air air{.sunshine = .75};
    Params blocking;
    blocking.moss_blocks_evaporation = true;
    const double bare = day(site, air, kind("humus"), {}).evaporation;
    site.cover = 1;
    EXPECT_GT(day(site, air, kind("humus"), {}).evaporation, bare);
    EXPECT_NEAR(day(site, air, kind("humus"), blocking).evaporation / bare, 0.91, 0.01);
    const Day full = day(site, air, kind("humus"), {});
    site.cover = 3;
    EXPECT_EQ(day(site, air, kind("humus"), {}).evaporation, full.evaporation);
}

struct Garden {
    std::vector<double> water, rain;
    std::vector<float> light, temperature, humidity, wind, sky, cover, depth;
    std::vector<std::uint8_t> soil;

    explicit Garden(std::size_t n)
    {
        for (std::size_t i = 0; i < n; ++i) {
            const Site s = random_site(i);
            soil.push_back(static_cast<std::uint8_t>(i % 3));
            water.push_back(s.depth * preset_soils()[i % 3].porosity / 2);
            rain.push_back(s.rain);
            light.push_back(static_cast<float>(s.light));
            temperature.push_back(static_cast<float>(s.temperature));
            humidity.push_back(static_cast<float>(s.humidity));
            wind.push_back(static_cast<float>(s.wind));
            sky.push_back(static_cast<float>(s.sky_view));
            cover.push_back(static_cast<float>(s.cover));
            depth.push_back(static_cast<float>(s.depth));
        }
    }
    Inputs inputs() const
    {
        return {.water = water,
                .light = light,
                .temperature = temperature,
                .humidity = humidity,
                .rain = rain,
                .wind = wind,
                .sky_view = sky,
                .cover = cover,
                .depth = depth,
                .soil = soil,
                .soils = preset_soils(),
                .air = {.sunshine = .4}};
    }
};

TEST(Soil, ManySitesEqualOneSiteAtATimeOnAnyNumberOfThreads)
{
    const Garden garden(20011);
    Result one, many;
    {
        const ThreadLimit limit(1);
        run(garden.inputs(), {}, one, {});
    }
    {
        const ThreadLimit limit(4);
        run(garden.inputs(), {}, many, {});
    }
    EXPECT_EQ(one.water, many.water);
    EXPECT_EQ(one.evaporation, many.evaporation);
    EXPECT_EQ(one.runoff, many.runoff);
    EXPECT_EQ(one.temperature, many.temperature);
    EXPECT_EQ(one.humidity, many.humidity);
    EXPECT_EQ(one.beta, many.beta);
    for (std::size_t i = 0; i < garden.water.size(); i += 97) {
        const Day d = day({.light = garden.light[i],
                           .temperature = garden.temperature[i],
                           .humidity = garden.humidity[i],
                           .rain = garden.rain[i],
                           .wind = garden.wind[i],
                           .sky_view = garden.sky[i],
                           .cover = garden.cover[i],
                           .depth = garden.depth[i],
                           .water = garden.water[i]},
                          {.sunshine = .4}, preset_soils()[garden.soil[i]], {});
        ASSERT_EQ(d.water, one.water[i]);
        ASSERT_EQ(static_cast<float>(d.temperature), one.temperature[i]);
        ASSERT_EQ(static_cast<float>(d.humidity), one.humidity[i]);
    }
}

TEST(Soil, OneValueForAllSitesEqualsThatValueForEach)
{
    Garden garden(7);
    garden.temperature.assign(7, 287.5F);
    Inputs all = garden.inputs();
    all.temperature = 287.5F;
    Result a, b;
    run(garden.inputs(), {}, a, {});
    run(all, {}, b, {});
    EXPECT_EQ(a.temperature, b.temperature);
    EXPECT_EQ(a.water, b.water);
    // Sites of one temperature but different humidity keep their own air.
    all.light = 30.0F, all.rain = 0.0, all.wind = 1.0F, all.sky_view = 0.5F;
    run(all, {}, a, {});
    for (std::size_t i = 0; i < 7; ++i) {
        const Site site{30,
                        287.5,
                        garden.humidity[i],
                        0,
                        1,
                        0.5,
                        garden.cover[i],
                        garden.depth[i],
                        garden.water[i]};
        EXPECT_EQ(a.water[i], day(site, all.air, all.soils[garden.soil[i]], {}).water);
    }
}

TEST(Soil, NoSitesNeedNoWork)
{
    Result r;
    run(Garden(0).inputs(), {}, r, {});
    EXPECT_TRUE(r.water.empty());
}

TEST(Soil, NamesTheSiteTheFieldAndTheRange)
{
    Garden garden(20);
    garden.humidity[13] = 1.3F;
    garden.wind[17] = -1;
    Result r;
    r.water = {4.5};
    EXPECT_THAT([&] { run(garden.inputs(), {}, r, {}); },
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("site 13"), HasSubstr("humidity = 1.3"), HasSubstr("0 to 1"))));
    EXPECT_EQ(r.water, std::vector<double>{4.5});  // nothing written
    garden.humidity[13] = 0.5F;
    EXPECT_THAT(
        [&] { run(garden.inputs(), {}, r, {}); },
        ThrowsMessage<InvalidInput>(AllOf(HasSubstr("site 17"), HasSubstr("wind = -1 m/s"))));
    garden.wind[17] = 1;
    garden.soil[3] = 9;
    EXPECT_THAT([&] { run(garden.inputs(), {}, r, {}); },
                ThrowsMessage<InvalidInput>(AllOf(HasSubstr("site 3"), HasSubstr("soil = 9"))));
    garden.soil[3] = 0;
    garden.depth.pop_back();
    EXPECT_THAT([&] { run(garden.inputs(), {}, r, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("depth")));
}

TEST(Soil, RejectsEveryFieldOutOfRange)
{
    const Site good{.light = 10,
                    .temperature = 288,
                    .humidity = .5,
                    .rain = 1,
                    .wind = 1,
                    .sky_view = .5,
                    .cover = 0,
                    .depth = 20,
                    .water = .1};
    const double nan = std::nan("");
    EXPECT_NO_THROW(day(good, {.sunshine = .5}, kind("rock"), {}));
    auto rejects = [&](double Site::*field, double value, const char* name) {
        Site bad = good;
        bad.*field = value;
        EXPECT_THAT([&] { day(bad, {.sunshine = .5}, kind("rock"), {}); },
                    ThrowsMessage<InvalidInput>(HasSubstr(name)))
            << name << " " << value;
    };
    for (const double value : {-1.0, nan}) {
        rejects(&Site::light, value, "light");
        rejects(&Site::rain, value, "rain");
        rejects(&Site::wind, value, "wind");
        rejects(&Site::depth, value, "depth");
        rejects(&Site::water, value, "water");
        rejects(&Site::cover, value, "cover");
        rejects(&Site::sky_view, value, "sky_view");
        rejects(&Site::humidity, value, "humidity");
    }
    for (const double value : {179.0, 341.0, nan})
        rejects(&Site::temperature, value, "temperature");
    rejects(&Site::humidity, 1.01, "humidity");
    auto rejects_air = [&](const Air& air, const char* name) {
        EXPECT_THAT([&] { day(good, air, kind("rock"), {}); },
                    ThrowsMessage<InvalidInput>(HasSubstr(name)));
    };
    rejects_air({.sunshine = 1.03}, "sunshine = 1.03");
    rejects_air({.sunshine = nan}, "sunshine");
    rejects_air({.sunshine = .5, .pressure = 5}, "pressure = 5 hPa");
    rejects_air({.sunshine = .5, .longwave = -1.0}, "longwave");
    // Up to 2 % above 1 is rounding of tables.
    EXPECT_EQ(day(good, {.sunshine = 1.02}, kind("rock"), {}).temperature,
              day(good, {.sunshine = 1}, kind("rock"), {}).temperature);
    EXPECT_THAT([] { validate(Soil{.porosity = -0.1}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("porosity")));
    EXPECT_THAT([] { validate(Params{.albedo = 1.1}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("albedo")));
}

TEST(Soil, ExtremesOfLightAndColdStillBalance)
{
    for (const Site& site :
         {Site{.light = 1361, .temperature = 340, .humidity = 0, .wind = 0, .depth = 1, .water = 0},
          Site{.light = 0, .temperature = 180, .humidity = 1, .wind = 40, .depth = 1, .water = 0},
          Site{.light = 5000,
          .temperature = 288,
          .humidity = 1,
          .wind = 0,
          .depth = 1000,
          .water = 400}}) {
        const Day d = day(site, {.sunshine = 1}, kind("humus"), {.albedo = 0});
        EXPECT_NEAR(d.absorbed,
                    kStefanBoltzmann * std::pow(d.temperature, 4) + d.sensible + d.latent, 1e-7);
    }
    // No sky radiation at all over nearly still air: far more than 80 K below the air.
    const Day d = day({.temperature = 288, .humidity = 0, .wind = 0, .depth = 1}, {.longwave = 0.0},
                      kind("rock"), {});
    EXPECT_LT(d.temperature, 200);
    EXPECT_NEAR(d.absorbed, kStefanBoltzmann * std::pow(d.temperature, 4) + d.sensible + d.latent,
                1e-8);
}

}  // namespace
}  // namespace sekitei::soil
