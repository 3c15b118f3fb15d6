#include "apps/climate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "apps/habitat.h"
#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "tests/apps/climate_scenes.h"

namespace sekitei::apps {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;
using namespace apps::testing;

const ClimateParams kFull;

std::vector<float> at_cells(const Scene& scene, const std::string& name)
{
    return cells_of(scene).from_grid(scene.floats(name), -1);
}

/// Area-weighted mean over the cells that `chosen` takes.
double mean_over(const SurfaceCells& cells, const std::vector<float>& values,
                 const std::function<bool(std::size_t)>& chosen)
{
    double sum = 0, area = 0;
    for (std::size_t i = 0; i < cells.size(); ++i)
        if (chosen(i)) {
            sum += double(cells.area[i]) * double(values[i]);
            area += double(cells.area[i]);
        }
    EXPECT_GT(area, 0) << "no cell was chosen";
    return sum / area;
}

// ---- What the scene carries -------------------------------------------------------------------

TEST(Climate, AWeatherSurvivesItsPoints)
{
    Weather weather;
    weather.site = Site{0.7, -2.1};
    for (int d = 0; d < 5; ++d) {
        WeatherDay day;
        day.year = 2023, day.month = 2, day.day = 24 + d;
        day.temperature = 280.125 + d;
        day.humidity = 0.1 * d;
        day.precipitation = d == 2 ? 0 : 7.3 * d;
        day.wind_speed = 0.3 + d;
        day.wind_direction = d + 3;
        day.possible_sunshine = 11.5;
        day.sunshine = 2.25 * d;
        day.pressure = 990 + d;
        if (d % 2) day.global_radiation = 0;  // measured, and none
        if (d == 3) day.diffuse_radiation = 31.5;
        if (d == 4) day.longwave = 301.25;
        weather.days.push_back(day);
    }
    Scene scene;
    scene.points["weather"] = weather_points(weather);
    const Weather back = weather_of(scene);
    ASSERT_EQ(back.days.size(), 5u);
    EXPECT_EQ(back.site->latitude, 0.7);
    EXPECT_EQ(back.site->longitude, -2.1);
    for (std::size_t d = 0; d < 5; ++d) {
        const WeatherDay &a = weather.days[d], &b = back.days[d];
        EXPECT_EQ(std::tie(a.year, a.month, a.day, a.wind_direction),
                  std::tie(b.year, b.month, b.day, b.wind_direction));
        EXPECT_EQ(std::tie(a.temperature, a.humidity, a.precipitation, a.wind_speed, a.pressure),
                  std::tie(b.temperature, b.humidity, b.precipitation, b.wind_speed, b.pressure));
        EXPECT_EQ(std::tie(a.possible_sunshine, a.sunshine),
                  std::tie(b.possible_sunshine, b.sunshine));
        EXPECT_EQ(a.global_radiation, b.global_radiation);
        EXPECT_EQ(a.diffuse_radiation, b.diffuse_radiation);
        EXPECT_EQ(a.longwave, b.longwave);
    }
}

TEST(Climate, WeatherPointsThatAreNoneAreNamed)
{
    Weather weather;
    weather.site = Site{0.7, 0};
    weather.days.resize(3);
    weather.days[0].year = weather.days[1].year = weather.days[2].year = 2023;
    Scene scene;
    EXPECT_THROW(weather_of(scene), InvalidInput);
    auto expect = [&](auto&& change, const char* words) {
        scene.points["weather"] = weather_points(weather);
        change(scene.points["weather"]);
        EXPECT_THAT([&] { weather_of(scene); }, ThrowsMessage<InvalidInput>(HasSubstr(words)));
    };
    expect([](Points& p) { p.attributes.erase("humidity"); }, "humidity");
    expect([](Points& p) { p.attributes["pressure"] = std::vector<float>(3); }, "pressure");
    expect(
        [](Points& p) {
            std::get<std::vector<std::int32_t>>(p.attributes["wind_direction"])[1] = 8;
        },
        "wind_direction 8");
    expect([](Points& p) { std::get<std::vector<std::int32_t>>(p.attributes["month"])[2] = 13; },
           "2023-13-1");
    expect([](Points& p) { p.position.clear(); }, "empty");

    for (WeatherDay& day : weather.days) day.temperature = 280;
    scene.points["weather"] = weather_points(weather);
    EXPECT_NO_THROW(weather_of(scene));
    auto tampered = [&](const char* name, double value, const char* words) {
        expect([&](Points& p) { std::get<std::vector<double>>(p.attributes[name])[1] = value; },
               words);
    };
    const double nan = std::numeric_limits<double>::quiet_NaN();
    tampered("temperature", 15, "temperature = 15 on day 1, must be 180 to 340");
    tampered("temperature", nan, "temperature = nan on day 1");
    tampered("humidity", 1.3, "humidity = 1.3 on day 1, must be 0 to 1");
    tampered("wind_speed", -1, "wind_speed = -1 on day 1");
    tampered("precipitation", -0.5, "precipitation = -0.5 on day 1");
    tampered("pressure", 1, "pressure = 1 on day 1");
    tampered("sunshine", 25, "sunshine = 25 on day 1");
    tampered("longwave", nan, "longwave = nan on day 1");
    tampered("global_radiation", -2, "global_radiation = -2 on day 1");
    expect([](Points& p) { std::get<std::vector<double>>(p.attributes["latitude"])[0] = 91; },
           "latitude [rad] = 91");
}

TEST(Climate, AirTablesSurviveTheirPoints)
{
    wind::AirTables tables;
    for (std::size_t k = 0; k < 8; ++k) {
        tables.speed[k] = 0.25 + double(k);
        tables.temperature[k] = 1.5 * double(k);
        tables.humidity[k] = 1.5 * double(k) + 1e-9;
        tables.direction[k] = 0.1 * double(k);
    }
    for (int layer = 0; layer < 3; ++layer) {
        tables.layers.emplace_back();
        tables.layers.back().fill(layer + 0.5);
    }
    tables.layer_base = 1.25;
    tables.layer_height = 0.75;
    Scene scene;
    scene.points["air_tables"] = table_points(tables);
    const wind::AirTables back = tables_of(scene);
    EXPECT_EQ(back.speed, tables.speed);
    EXPECT_EQ(back.temperature, tables.temperature);
    EXPECT_EQ(back.humidity, tables.humidity);
    EXPECT_EQ(back.direction, tables.direction);
    EXPECT_EQ(back.layers, tables.layers);
    EXPECT_EQ(back.layer_base, tables.layer_base);
    EXPECT_EQ(back.layer_height, tables.layer_height);
    scene.points["air_tables"].attributes["A_T"] = std::vector<double>{0, 0, 0, -1, 0, 0, 0, 0};
    EXPECT_THAT([&] { tables_of(scene); }, ThrowsMessage<InvalidInput>(HasSubstr("A_T = -1")));
    scene.points["air_tables"].position.resize(7);
    EXPECT_THAT([&] { tables_of(scene); }, ThrowsMessage<InvalidInput>(HasSubstr("are 7")));
}

TEST(Climate, DaylightSurvivesItsPoints)
{
    Habitat habitat;
    Scene scene = plane(0.1);
    habitat.light(scene, weather_csv(2, [](int) { return Sky{}; }),
                  {{"links", 5}, {"sun_rows", 9}});
    const SurfaceCells cells = cells_of(scene);
    const light::Coefficients c = coefficients_of(scene, cells);
    EXPECT_EQ(c.params.links, 5);
    EXPECT_EQ(c.params.sun_rows, 9);
    EXPECT_EQ(c.sites, cells.size());
    EXPECT_EQ(c.links.size(), 5 * cells.size());
    EXPECT_NEAR(c.latitude, 39.7 * math::kPi / 180, 1e-12);
    Points again = daylight_points(c, cells);
    EXPECT_EQ(content_hash(again), content_hash(scene.points_of("daylight")));

    scene.points["daylight"].position.pop_back();
    EXPECT_THAT([&] { coefficients_of(scene, cells); },
                ThrowsMessage<InvalidInput>(HasSubstr("daylight")));
    auto expect = [&](auto&& change, const char* words) {
        scene.points["daylight"] = daylight_points(c, cells);
        change(scene.points["daylight"]);
        EXPECT_THAT([&] { coefficients_of(scene, cells); },
                    ThrowsMessage<InvalidInput>(HasSubstr(words)));
    };
    expect([](Points& p) { p.position[7].y += 0.06; }, "point 7 lies at");
    auto link = [](std::int32_t code) {
        return [code](Points& p) {
            std::get<std::vector<std::int32_t>>(p.attributes["link_03"])[2] = code;
        };
    };
    expect(link(static_cast<std::int32_t>(cells.size())), "link_03");
    expect(link(std::numeric_limits<std::int32_t>::max()), "no cell of this surface");
    expect(link(-57), "link_03 = -57 at point 2");
    expect([](Points& p) { p.attributes.erase("bits_00"); }, "bits_00");
    scene.points["daylight"] = daylight_points(c, cells);
    scene.history.clear();
    EXPECT_THAT([&] { coefficients_of(scene, cells); },
                ThrowsMessage<InvalidInput>(HasSubstr("sekitei light")));
}

// ---- One day, put together by hand ------------------------------------------------------------

/// A block with a roof over its foot: walls, undersides, shelter.
Scene shelter(double cell = 0.05)
{
    return body(cell, {-0.5, -0.45, 0}, {1.0, 0.9, 1.2}, [](Vec3d p) {
        return std::min({p.z - 0.125, box_distance(p, {0.02, 0.03, 0.3}, {0.2, 0.15, 0.4}),
                         box_distance(p, {0.02, 0.03, 0.85}, {0.4, 0.3, 0.075})});
    });
}

struct Switches {
    Json params;
    bool exact, view, shelter, runoff;
};

class ClimateSwitches : public ::testing::TestWithParam<int> {};

TEST_P(ClimateSwitches, DayIsLightAirRainAndSoilComposedByHand)
{
    const Switches all[] = {
        {{}, true, true, true, true},
        {{{"profile", "paper"}}, false, false, false, false},
        {{{"profile", "paper"}, {"balance", "exact"}, {"sky_view", true}},
         true,
         true,
         false,
         false},
        {{{"sky_view", false}, {"rain_shelter", false}}, true, false, false, true},
        {{{"runoff", false}, {"balance", "linear"}}, false, true, true, false}};
    const Switches s = all[GetParam()];
    Habitat habitat;
    Scene scene = shelter();
    habitat.light(scene, weather_csv(4, [](int d) {
                      return Sky{.celsius = 8.0 + 3 * d,
                                 .rain = d == 1 ? 0 : 4.5,
                                 .wind = 0.4 + d,
                                 .direction = 90.0 * d};
                  }));
    ClimateParams params;
    for (const Param& p : describe(params))
        if (s.params.contains(p.name)) p.set(s.params[p.name]);
    validate(params);
    const Climate climate(scene, params, {}, {});
    const SurfaceCells& cells = climate.cells();
    const light::Coefficients& c = climate.coefficients();
    std::vector<double> water = climate.ground().initial_water();
    for (const double w : water) ASSERT_NEAR(w, 0.12, 1e-12);  // half of 20 mm of rock
    std::vector<float> cover(cells.size());
    for (std::size_t i = 0; i < cells.size(); ++i) cover[i] = float(i % 5) / 4;

    std::vector<Vec3d> origin;
    for (std::size_t i = 0; i < cells.size(); ++i) origin.push_back(cells.ray_origin(i));
    soil::Params ground;
    ground.balance = s.exact ? soil::Balance::Exact : soil::Balance::Linear;
    ClimateDay day;
    int sheltered = 0, wetted = 0;
    for (std::size_t d = 0; d < 4; ++d) {
        const WeatherDay& w = climate.weather().days[d];
        const Site site = *climate.weather().site;
        const auto moments = sun::moments_of_day(w.year, w.month, w.day, site);
        const light::Light light = light::day(c, {origin, cells.normal, cells.area}, moments,
                                              sun::radiation(w, site, moments));
        const std::vector<double> before = water;
        climate.advance(d, water, cover, day, {});
        EXPECT_EQ(day.weather.precipitation, w.precipitation);
        double rainfall = 0, supply = 0;
        for (std::size_t i = 0; i < cells.size(); ++i) {
            const double rain = w.precipitation * (s.shelter ? double(c.rain_exposure[i]) : 1.0);
            rainfall += rain * double(cells.area[i]);
            supply += day.rain.supply[i] * double(cells.area[i]);
            if (s.shelter && c.rain_exposure[i] < 0.1f) ++sheltered;
            if (s.runoff) {
                ASSERT_GE(day.rain.supply[i], rain - 1e-12);
                wetted += day.rain.supply[i] > rain + 1e-9;
            } else
                ASSERT_EQ(day.rain.supply[i], rain);
            const soil::Day expected =
                soil::day({.light = double(light.total[i]),
                           .temperature = double(float(w.temperature)),
                           .humidity = double(float(w.humidity)),
                           .rain = day.rain.supply[i],
                           .wind = double(float(w.wind_speed)),
                           .sky_view = s.view ? double(c.sky_view[i]) : 1.0,
                           .cover = double(cover[i]),
                           .depth = 20,
                           .water = before[i]},
                          {.sunshine = w.sunshine / w.possible_sunshine, .pressure = w.pressure},
                          soil::preset_soils()[2], ground);
            ASSERT_EQ(day.ground.temperature[i], float(expected.temperature));
            ASSERT_EQ(day.ground.humidity[i], float(expected.humidity));
            ASSERT_EQ(water[i], expected.water);
            ASSERT_EQ(day.ground.evaporation[i], expected.evaporation);
        }
        EXPECT_NEAR(day.rainfall, rainfall, 1e-12 * (1 + rainfall));
        EXPECT_NEAR(day.inflow, supply - rainfall, 1e-12 * (1 + supply));
        EXPECT_LT(std::abs(day.balance_error), 1e-9);
    }
    if (s.shelter) {
        EXPECT_GT(sheltered, 100);
    }
    if (s.runoff) {
        EXPECT_GT(wetted, 100);
    }
}

INSTANTIATE_TEST_SUITE_P(Profiles, ClimateSwitches, ::testing::Range(0, 5));

TEST(Climate, WindAndPondReachEachCell)
{
    Habitat habitat;
    Scene scene = shelter(0.1);
    habitat.light(scene, weather_csv(8, [](int d) {
                      return Sky{.celsius = 4, .wind = 2.5, .direction = 45.0 * d};
                  }));
    const SurfaceCells cells = cells_of(scene);
    wind::AirTables tables;
    tables.layers.resize(3);
    for (std::size_t k = 0; k < 8; ++k) {
        std::vector<float> ratio(cells.size());
        for (std::size_t i = 0; i < cells.size(); ++i)
            ratio[i] = float(0.1 * double(k + 1) + 1e-3 * double(i));
        scene.put("wind_ratio_" + std::to_string(k), cells.to_grid(ratio), "", "wind");
        tables.speed[k] = 0.5 + 0.05 * double(k);
        tables.temperature[k] = tables.humidity[k] = double(k);
        for (std::size_t layer = 0; layer < 3; ++layer)
            tables.layers[layer][k] = double(k) * (1.5 - 0.5 * double(layer));
    }
    scene.points["air_tables"] = table_points(tables);
    const Climate climate(scene, kFull, {}, {});
    ASSERT_TRUE(climate.ground().has_wind());
    std::vector<double> water = climate.ground().initial_water();
    ClimateDay day;
    for (std::size_t d = 0; d < 8; ++d) {
        climate.advance(d, water, {}, day, {});
        const WeatherDay& w = climate.weather().days[d];
        EXPECT_EQ(w.wind_direction, int(d));
        const double pond =
            288.15 - 5 * math::cos(2 * math::kPi * (31 + 28 + double(d) + 1 - 30) / 365);
        for (std::size_t i = 0; i < cells.size(); ++i) {
            const double ratio = 0.1 * double(d + 1) + 1e-3 * double(i);
            ASSERT_NEAR(day.wind[i], 2.5 * tables.speed[d] * ratio, 1e-5);
            const auto layer = std::min<std::size_t>(2, std::size_t(cells.position[i].z / 0.5));
            const double f = 1 - std::exp(-tables.layers[layer][d] * 0.02107012 / std::sqrt(2.5));
            ASSERT_NEAR(day.air_temperature[i], 277.15 + f * (pond - 277.15), 1e-4);
        }
    }
}

// ---- Water ------------------------------------------------------------------------------------

TEST(Climate, OverAYearNoCellEvaporatesMoreThanItGot)
{
    Habitat habitat;
    Scene scene;
    run(scene, "lantern", {{"cell", 0.05}}, habitat.context());
    run(scene, "light", {{"weather", SEKITEI_DATA "/weather/morioka-normals.csv"}},
        habitat.context());
    const Climate climate(scene, kFull, {}, {});
    const std::size_t n = climate.cells().size();
    std::vector<double> water = climate.ground().initial_water(), first = water;
    std::vector<double> supply(n), evaporated(n), dew(n);
    ClimateDay day;
    double worst = 0;
    for (std::size_t d = 0; d < 365; ++d) {
        climate.advance(d, water, {}, day, {});
        worst = std::max(worst, std::abs(day.balance_error));
        for (std::size_t i = 0; i < n; ++i) {
            supply[i] += day.rain.supply[i];
            evaporated[i] += std::max(0.0, day.ground.evaporation[i]);
            dew[i] += std::max(0.0, -day.ground.evaporation[i]);
            ASSERT_TRUE(water[i] >= 0 && water[i] <= 0.24 + 1e-9);
        }
    }
    EXPECT_LT(worst, 1e-9);
    double most = 0;
    for (std::size_t i = 0; i < n; ++i) {
        EXPECT_LE(evaporated[i], supply[i] + dew[i] + first[i] + 1e-9) << i;
        most = std::max(most, evaporated[i]);
    }
    EXPECT_GT(most, 10);
}

TEST(Climate, WaterDripsInALineUnderARoofsEdge)
{
    // A slab that leans to -x over level ground; its box goes on in y.
    Habitat habitat;
    constexpr double kCell = 0.04;
    Scene scene = body(kCell, {0, 0, 0}, {1.6, 0.6, 1.2}, [](Vec3d p) {
        const double c = math::cos(0.3), s = math::sin(0.3);
        const double u = (p.x - 0.8) * c + (p.z - 0.8) * s, v = -(p.x - 0.8) * s + (p.z - 0.8) * c;
        const double x = std::abs(u) - 0.42, z = std::abs(v) - 0.07;
        const double roof =
            length(Vec3d(std::max(x, 0.0), std::max(z, 0.0), 0)) + std::min(0.0, std::max(x, z));
        return std::min(p.z - 0.3, roof);
    });
    // A calm rain every third day: between them the thin store dries.
    habitat.light(scene, weather_csv(30, [](int d) {
                      return Sky{.humidity = 60, .rain = d % 3 ? 0.0 : 12.0, .wind = 0.2};
                  }));
    run(scene, "soil", {}, habitat.context());
    EXPECT_LT(*std::max_element(column(scene, "balance_error").begin(),
                                column(scene, "balance_error").end()),
              1e-9);
    const SurfaceCells cells = cells_of(scene);
    const auto theta = at_cells(scene, "soil_theta"), exposure = at_cells(scene, "rain_exposure");
    std::map<int, std::pair<double, int>> column_of;  // by x
    double sheltered = 0;
    int count = 0;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        const Vec3d p = cells.position[i];
        if (p.z > 0.32 || std::min(p.y, 0.6 - p.y) < 0.1) continue;
        if (p.x > 0.3 && p.x < 0.55) {
            auto& [sum, number] = column_of[cells.voxel[i].x];
            sum += double(theta[i]);
            ++number;
        }
        if (p.x > 0.6 && p.x < 1.0 && exposure[i] < 0.1f) {
            sheltered += double(theta[i]);
            ++count;
        }
    }
    ASSERT_GT(count, 30);
    double line = 0;
    for (const auto& [x, c] : column_of) line = std::max(line, c.first / c.second);
    EXPECT_GE(line, 2 * sheltered / count);

    // It is the roof's water that falls there: more than the open sky's on any cell.
    const Climate climate(scene, kFull, {}, {});
    std::vector<double> water = climate.ground().initial_water();
    ClimateDay day;
    climate.advance(0, water, {}, day, {});
    double most = 0;
    for (std::size_t i = 0; i < cells.size(); ++i)
        if (cells.position[i].z < 0.32 && exposure[i] < 0.5f) {
            most = std::max(most, day.rain.supply[i]);
        }
    EXPECT_GT(most, 3 * 12);
}

TEST(Climate, AVerticalCrackGathersItsWallsWater)
{
    // A wall that leans back by 8 degrees, with a crack down its middle.
    Habitat habitat;
    constexpr double kLean = 0.14;
    Scene wall = body(0.04, {0, 0, 0}, {0.9, 0.8, 2.0}, [](Vec3d p) {
        const double crack = std::max(0.0, 0.10 - std::abs(p.y - 0.4)) * 1.2;
        return std::max(0.7 * (0.3 + kLean * p.z + crack - p.x), p.z - 1.9);
    });
    habitat.light(wall,
                  weather_csv(3, [](int) { return Sky{.rain = 10, .wind = 4, .direction = 270}; }));
    const Climate climate(wall, kFull, {}, {});
    std::vector<double> water = climate.ground().initial_water();
    ClimateDay day;
    climate.advance(0, water, {}, day, {});
    const SurfaceCells& cells = climate.cells();
    double got = 0, own = 0, beside = 0, beside_own = 0;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        const Vec3d p = cells.position[i];
        if (p.z > 1.0 || cells.normal[i].z > 0.6f) continue;
        const double rain = 10 * double(climate.coefficients().rain_exposure[i]);
        const double away = std::abs(p.y - 0.4);
        if (away < 0.021) got += day.rain.supply[i], own += rain;
        if (away > 0.2 && away < 0.35) beside += day.rain.supply[i], beside_own += rain;
    }
    ASSERT_GT(own, 0);
    EXPECT_GE(got / own, 3);
    EXPECT_GE(got / own, 2 * beside / beside_own);
    EXPECT_LT(std::abs(day.balance_error), 1e-9);
}

TEST(Climate, CrevicesAreWetterThanRidges)
{
    // Furrows: narrow ones, whose floors see little sky.
    Habitat habitat;
    Scene scene = body(0.03, {0, 0, 0}, {0.72, 0.6, 0.9}, [](Vec3d p) {
        const double phase = p.x / 0.24 - std::floor(p.x / 0.24) - 0.5;
        return 0.3 * (p.z - 0.3 - 1.5 * 0.24 * 2 * (0.5 - std::abs(phase)));
    });
    habitat.light(scene, weather_csv(60, [](int d) {
                      return Sky{.celsius = 16,
                                 .humidity = 70,
                                 .rain = d % 4 ? 0.0 : 8.0,
                                 .global = 170,
                                 .diffuse = 90};
                  }));
    run(scene, "soil", {}, habitat.context());
    const SurfaceCells cells = cells_of(scene);
    const auto humidity = at_cells(scene, "soil_rh"), view = at_cells(scene, "sky_view");
    const double deep = mean_over(cells, humidity, [&](std::size_t i) { return view[i] < 0.4f; });
    const double high = mean_over(cells, humidity, [&](std::size_t i) { return view[i] > 0.7f; });
    EXPECT_GT(deep, high + 0.01);
}

TEST(Climate, SoilsOfTheSceneGoBeforeTheParameter)
{
    Habitat habitat;
    Scene scene = plane(0.1);
    habitat.light(scene, weather_csv(1, [](int) { return Sky{}; }));
    const SurfaceCells cells = cells_of(scene);
    std::vector<std::int32_t> geology(cells.size());
    std::vector<float> depth(cells.size());
    for (std::size_t i = 0; i < cells.size(); ++i) {
        geology[i] = int(i % 3);  // 0: the parameter, humus, sand
        depth[i] = float(10 + i);
    }
    scene.put("geology", cells.to_grid(geology), "test");
    scene.put("soil_h", cells.to_grid(depth), "mm", "test");
    const Climate climate(scene, kFull, {}, {});
    const std::vector<double> water = climate.ground().initial_water();
    for (std::size_t i = 0; i < cells.size(); ++i) {
        const double porosity = i % 3 == 0 ? 0.012 : i % 3 == 1 ? 0.490 : 0.392;
        EXPECT_NEAR(water[i], 0.5 * porosity * double(10 + i), 1e-9);
        EXPECT_EQ(climate.ground().geology()[i], i % 3 == 0 ? 3 : int(i % 3));
    }
    geology[2] = 17;
    scene.put("geology", cells.to_grid(geology), "test");
    EXPECT_THAT([&] { Climate(scene, kFull, {}, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("geology: 17")));
    geology[2] = 1;
    depth[4] = -3;
    scene.put("geology", cells.to_grid(geology), "test");
    scene.put("soil_h", cells.to_grid(depth), "mm", "test");
    EXPECT_THAT([&] { Climate(scene, kFull, {}, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("soil_h: -3 mm")));
}

TEST(Climate, DepthOfSoilIsTheSolidsThicknessBelow)
{
    // A table of 0.25 m on a leg that goes down for ever: thin at the rim, 1 m at most; walls 1 mm.
    Habitat habitat;
    Scene scene = body(0.05, {-0.5, -0.5, 0}, {1, 1, 2}, [](Vec3d p) {
        return std::min(box_distance(p, {0.01, 0.02, 1.5}, {0.42, 0.42, 0.115}),
                        box_distance(p, {0.01, 0.02, 0}, {0.12, 0.12, 1.5}));
    });
    habitat.light(scene, weather_csv(1, [](int) { return Sky{}; }));
    ClimateParams params;
    params.soil = "humus";
    const Climate climate(scene, params, {}, {});
    const SurfaceCells& cells = climate.cells();
    int rim = 0, middle = 0, walls = 0;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        const Vec3d p = cells.position[i] - Vec3d(0.01, 0.02, 0);
        const float h = climate.ground().depth()[i];
        const double out = std::max(std::abs(p.x), std::abs(p.y));
        if (cells.normal[i].z <= 0.1f) {
            EXPECT_EQ(h, 1);
            ++walls;
        } else if (p.z > 1.5 && out > 0.2 && out < 0.35 && cells.normal[i].z > 0.99f) {
            EXPECT_NEAR(h, 230, 3);
            ++rim;
        } else if (p.z > 1.5 && out < 0.07) {
            EXPECT_EQ(h, 1000);
            ++middle;
        }
    }
    EXPECT_GT(rim, 50);
    EXPECT_GT(middle, 4);
    EXPECT_GT(walls, 100);
}

// ---- Light ------------------------------------------------------------------------------------

TEST(Climate, OverAYearSouthWallsGetMostLightAndNorthWallsLeast)
{
    Habitat habitat;
    Scene scene = body(0.05, {-0.5, -0.5, 0}, {1, 1, 1.2}, [](Vec3d p) {
        return box_distance(p, {0.01, 0.01, 0.3}, {0.3, 0.3, 0.6});
    });
    run(scene, "light", {{"weather", SEKITEI_DATA "/weather/morioka-normals.csv"}},
        habitat.context());
    const SurfaceCells cells = cells_of(scene);
    const auto light = at_cells(scene, "light_S");
    auto wall = [&](Vec3f to) {
        return mean_over(cells, light,
                         [&](std::size_t i) { return dot(cells.normal[i], to) > 0.99f; });
    };
    const double north = wall({0, 1, 0}), south = wall({0, -1, 0}), east = wall({1, 0, 0}),
                 west = wall({-1, 0, 0});
    EXPECT_GT(south, 1.05 * east);
    EXPECT_GT(east, 1.1 * north);
    EXPECT_NEAR(east / west, 1, 0.02);
}

TEST(Climate, RainBeatsTheWallItsWindComesFrom)
{
    Habitat habitat;
    Scene scene = body(0.05, {-0.5, -0.5, 0}, {1, 1, 1.2}, [](Vec3d p) {
        return box_distance(p, {0.01, 0.01, 0.3}, {0.3, 0.3, 0.6});
    });
    // West wind, but rain from the east.
    habitat.light(scene, weather_csv(10, [](int d) {
                      return Sky{
                          .rain = d % 5 ? 0.0 : 9.0, .wind = 4, .direction = d % 5 ? 270.0 : 90.0};
                  }));
    const SurfaceCells cells = cells_of(scene);
    const auto exposure = at_cells(scene, "rain_exposure");
    auto wall = [&](Vec3f to) {
        return mean_over(cells, exposure,
                         [&](std::size_t i) { return dot(cells.normal[i], to) > 0.99f; });
    };
    EXPECT_NEAR(wall({1, 0, 0}), 4.0 / 6, 0.1);  // wind over the drops' fall
    EXPECT_LT(wall({-1, 0, 0}), 0.05);
    EXPECT_NEAR(wall({0, 0, 1}), 1, 0.05);
}

TEST(Climate, TheSouthernHemisphereIsTheNorthernMirrored)
{
    // A bench with a wall in the north, at 40 N in late June; and its mirror image at 40 S at the
    // same declination of the sun's other turn. The light is measured, so that only paths differ.
    Habitat habitat;
    auto bench = [](double side) {
        return body(0.05, {-0.5, -0.5, 0}, {1, 1, 1}, [side](Vec3d p) {
            const Vec3d q{p.x, p.y * side, p.z};
            return std::min(q.z - 0.22, box_distance(q, {0.01, 0.23, 0.4}, {0.3, 0.08, 0.4}));
        });
    };
    auto sky = [](int) { return Sky{.sunshine = 5, .global = 120, .diffuse = 50}; };
    using namespace std::chrono;
    Scene north = bench(1), south = bench(-1);
    habitat.light(north, weather_csv(6, sky, year{2021} / June / 18, 40));
    habitat.light(south, weather_csv(6, sky, year{2021} / December / 18, -40));
    for (Scene* scene : {&north, &south}) {
        run(*scene, "soil", {}, habitat.context());
        run(*scene, "moss", {{"species", "bryum"}, {"initial_count", 0}}, habitat.context());
    }
    const SurfaceCells a = cells_of(north), b = cells_of(south);
    ASSERT_EQ(a.size(), b.size());
    std::map<Coord, std::size_t> at;
    for (std::size_t i = 0; i < b.size(); ++i) at[b.voxel[i]] = i;
    for (const char* name : {"light_S", "sky_view", "suit_bryum", "soil_Ts"}) {
        SCOPED_TRACE(name);
        const auto x = at_cells(north, name), y = at_cells(south, name);
        double difference = 0, same = 0, scale = 0, mean = 0;
        for (const float v : x) mean += double(v) / double(x.size());
        for (std::size_t i = 0; i < a.size(); ++i) {
            const Coord mirrored{a.voxel[i].x, 19 - a.voxel[i].y, a.voxel[i].z};
            ASSERT_TRUE(at.contains(mirrored));
            difference += std::abs(double(x[i]) - double(y[at.at(mirrored)]));
            same += std::abs(double(x[i]) - double(y[i < b.size() ? i : 0]));
            scale += std::abs(double(x[i]) - mean);
        }
        EXPECT_LT(difference, 0.06 * scale);
        EXPECT_GT(same, 5 * difference);  // it is the mirror that makes them alike
    }
}

}  // namespace
}  // namespace sekitei::apps
