#include "solvers/moss/growth.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"
#include "core/solar_day.h"
#include "solvers/soil/soil.h"
#include "solvers/sun/sun.h"

namespace sekitei::moss {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;

const Species& kind(std::string_view name)
{
    for (const Species& s : preset_species())
        if (s.name == name) return s;
    throw std::out_of_range("no such species");
}

const Rules kPaper{.light_gate = false};

double total(const char* species, double light, double temperature, double humidity,
             const Rules& rules = kPaper)
{
    return fitness(kind(species), rules, temperature, humidity, light).total();
}

TEST(MossGrowth, ResponseIsOneHalfAtBothEndsAndOneInTheMiddle)
{
    for (const double n : {0.25, 0.5, 0.8, 1.0}) {
        EXPECT_NEAR(response(3, 3, 7, n, Response::Normalised), 0.5, 1e-6);
        EXPECT_NEAR(response(7, 3, 7, n, Response::Normalised), 0.5, 1e-6);
        EXPECT_NEAR(response(5, 3, 7, n, Response::Normalised), 1, 1e-12);
        EXPECT_NEAR(response(60, 3, 7, n, Response::Normalised), 0, 1e-12);
    }
}

TEST(MossGrowth, ResponseMatchesTheTableInBothForms)
{
    struct Row {
        double n, x, normalised, printed;
    };
    for (const Row r :
         {Row{.5, -.5, .032293, -.161438}, Row{.5, .25, .912854, 1.083863},
          Row{.5, .5, 1, 1.207107}, Row{.5, 1.25, .119359, -.038308}, Row{1, -.5, .0625, .0625},
          Row{1, .25, .840896, .840896}, Row{1, 1.25, .210224, .210224}}) {
        EXPECT_NEAR(response(r.x, 0, 1, r.n, Response::Normalised), r.normalised, 1e-6);
        EXPECT_NEAR(response(r.x, 0, 1, r.n, Response::Printed), std::max(0.0, r.printed), 1e-6);
    }
    // Softness between the two takes the general power.
    EXPECT_NEAR(response(.25, 0, 1, .7, Response::Normalised), .5 + .5 * std::pow(2 * .340896, .7),
                1e-6);
}

TEST(MossGrowth, FitnessAndGrowthMatchTheTable)
{
    const Fitness f = fitness(kind("bryum"), kPaper, 284.15, .95, 30);
    EXPECT_NEAR(f.temperature, .972655, 1e-6);
    EXPECT_NEAR(f.humidity, .978332, 1e-6);
    EXPECT_NEAR(f.light, 1, 1e-12);
    EXPECT_NEAR(f.total(), .951580, 1e-6);
    EXPECT_NEAR(daily_growth(kind("bryum"), kPaper, f.total()), .255474, 1e-6);
    const Rules printed{.response = Response::Printed, .light_gate = false};
    EXPECT_NEAR(total("bryum", 30, 284.15, .95, printed), 1.144293, 1e-6);

    const double end = total("bryum", 60, 288.15, .80);
    EXPECT_NEAR(end, .247517, 1e-5);  // both ends: rounding of 1/2 goes through a square root
    EXPECT_NEAR(daily_growth(kind("bryum"), kPaper, end), .044255, 1e-5);
    EXPECT_NEAR(total("hypnum", 10, 285.65, 1), .840896, 1e-6);
    EXPECT_NEAR(daily_growth(kind("hypnum"), kPaper, .840896), .185224, 1e-6);
    EXPECT_NEAR(total("hypnum", 10, 285.65, 1, {}), .839826, 1e-6);
    EXPECT_NEAR(total("polytrichum", 5, 290.15, .93), .525940, 1e-6);
    EXPECT_NEAR(daily_growth(kind("polytrichum"), kPaper, .525940), .135282, 1e-6);
    EXPECT_NEAR(total("polytrichum", 5, 290.15, .93, {}), .507178, 1e-6);
    EXPECT_NEAR(total("hypnum", 100, 298.15, .70), 4.49e-9, 0.01e-9);
    EXPECT_NEAR(daily_growth(kind("hypnum"), kPaper, 4.49e-9), -.025, 1e-8);
}

TEST(MossGrowth, NothingGrowsInTheDarkWithTheGate)
{
    for (const Species& s : preset_species()) {
        EXPECT_EQ(fitness(s, {}, 285, 1, 0).total(), 0);
        EXPECT_GT(fitness(s, kPaper, 285, 1, 0).total(), 0.3);
        EXPECT_LT(daily_growth(s, {}, 0), 0);
    }
}

TEST(MossGrowth, HumidityAboveSaturationCountsAsSaturation)
{
    EXPECT_EQ(total("bryum", 30, 285, 1.07), total("bryum", 30, 285, 1));
}

// Deep humus over a day of weak light: what the sky's share does to temperature and fitness.
TEST(MossGrowth, SkyViewDecidesOnAShadedFloor)
{
    struct Row {
        const char* species;
        double sky_view, cool, warm;
    };
    for (const Row& r : {Row{"bryum", 0, .7170, .5854}, Row{"bryum", .5, .6781, .7339},
                         Row{"bryum", 1, .4080, .6005}, Row{"hypnum", 0, .7713, .5043},
                         Row{"hypnum", .5, .7751, .8256}, Row{"hypnum", 1, .3597, .6526}}) {
        auto found = [&](double temperature) {
            const soil::Day d = soil::day({.light = 10,
                                           .temperature = temperature,
                                           .humidity = .73,
                                           .wind = .2,
                                           .sky_view = r.sky_view,
                                           .depth = 300,
                                           .water = 73.5},
                                          {.sunshine = .75}, soil::preset_soils()[0], {});
            return total(r.species, 10, d.temperature, d.humidity);
        };
        EXPECT_NEAR(found(288.15), r.cool, 1e-4) << r.species << " V " << r.sky_view;
        EXPECT_NEAR(found(293.15), r.warm, 1e-4) << r.species << " V " << r.sky_view;
    }
}

struct Life {
    double growth = 0, largest = 0;
    int gemmae = 0, spores = 0, first_gemma = 0, first_spore = 0, died = 0, day = 0;

    void live(const Species& s, double fitness, int days)
    {
        for (int i = 0; i < days && !died; ++i) {
            ++day;
            const double d = daily_growth(s, kPaper, fitness);
            growth = grown(kPaper, growth, d);
            if (dies(s, growth, d)) died = day;
            const double before = largest;
            largest = std::max(largest, growth);
            const int shed = gemmae_shed(kPaper, before, largest);
            if (shed && !gemmae) first_gemma = day;
            gemmae += shed;
            if (!spore_shed(kPaper, growth, d)) continue;
            if (!spores++) first_spore = day;
        }
    }
};

TEST(MossGrowth, ALifeInGoodConditionsShedsGemmaeThenSpores)
{
    Life bryum;
    bryum.live(kind("bryum"), .8, 12);
    EXPECT_EQ(bryum.first_gemma, 3);
    EXPECT_EQ(bryum.first_spore, 10);
    EXPECT_NEAR(bryum.growth, 2.52, 1e-12);
    EXPECT_EQ(bryum.gemmae, 5);
    EXPECT_EQ(bryum.spores, 3);
    EXPECT_EQ(bryum.died, 0);
}

TEST(MossGrowth, ALifeThatLosesItsPlaceShrinksAndDies)
{
    Life hypnum;
    hypnum.live(kind("hypnum"), .87, 6);
    EXPECT_NEAR(hypnum.largest, 1.155, 1e-12);
    hypnum.live(kind("hypnum"), 0, 100);
    EXPECT_EQ(hypnum.gemmae, 2);
    EXPECT_EQ(hypnum.died, 47);
}

TEST(MossGrowth, GrowthStaysBetweenZeroAndItsCap)
{
    EXPECT_EQ(grown({}, 9.9, 0.3), 10);
    EXPECT_EQ(grown({}, 0.01, -0.03), 0);
    EXPECT_FALSE(dies(kind("bryum"), 0, 0.1));  // a seedling survives its first day
    EXPECT_TRUE(dies(kind("bryum"), 0.09, -0.01));
    EXPECT_FALSE(dies(kind("bryum"), 0.11, -0.01));
    EXPECT_EQ(gemmae_shed({}, 0.2, 1.7), 3);
    EXPECT_EQ(gemmae_shed({}, 1.7, 1.7), 0);
    EXPECT_FALSE(spore_shed({}, 3, -0.1));
}

TEST(MossGrowth, GerminationWindowsMatchTheTable)
{
    auto window = [](const char* name, Seed seed, double g) {
        std::pair<int, int> days{-1, 0};
        for (int age = 0; age < 1000; ++age)
            if (germinates(kind(name), seed, {}, age, g)) {
                if (days.first < 0) days.first = age;
                days.second = age;
            }
        return days;
    };
    using Window = std::pair<int, int>;
    EXPECT_EQ(window("bryum", Seed::Gemma, 1), Window(1, 68));
    EXPECT_EQ(window("bryum", Seed::Spore, 1), Window(38, 387));
    EXPECT_EQ(window("hypnum", Seed::Spore, .6), Window(79, 346));
    EXPECT_EQ(window("polytrichum", Seed::Gemma, .37), Window(-1, 0));
    for (const Species& s : preset_species())
        for (const Seed seed : {Seed::Gemma, Seed::Spore})
            EXPECT_EQ(last_germination_age(s, seed, {}), window(s.name.c_str(), seed, 1).second);
}

TEST(MossGrowth, ManySitesEqualOneAtATimeOnAnyNumberOfThreads)
{
    const std::size_t n = 30011;
    std::vector<float> t(n), rh(n), light(n), one(n), four(n);
    for (std::size_t i = 0; i < n; ++i) {
        t[i] = static_cast<float>(260 + 45 * uniform01(1, Stream("T"), i));
        rh[i] = static_cast<float>(uniform01(1, Stream("rh"), i));
        light[i] = static_cast<float>(200 * uniform01(1, Stream("S"), i));
    }
    {
        const ThreadLimit limit(1);
        fitness(kind("polytrichum"), {}, t, rh, light, one, {});
    }
    {
        const ThreadLimit limit(4);
        fitness(kind("polytrichum"), {}, t, rh, light, four, {});
    }
    EXPECT_EQ(one, four);
    for (std::size_t i = 0; i < n; i += 101)
        ASSERT_EQ(one[i], static_cast<float>(
                              fitness(kind("polytrichum"), {}, t[i], rh[i], light[i]).total()));
    EXPECT_THAT([&] { fitness(kind("bryum"), {}, t, rh, std::span(light).first(9), one, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("9 lights for 30011 sites")));
}

TEST(MossGrowth, NamesTheBadParameter)
{
    auto rejects = [](auto change, const char* expected) {
        Species s = kind("bryum");
        change(s);
        EXPECT_THAT([&] { validate(s); }, ThrowsMessage<InvalidParameter>(AllOf(
                                              HasSubstr("species bryum"), HasSubstr(expected))));
    };
    rejects([](Species& s) { s.temperature_high = 270; },
            "temperature_high = 270 K, must be > temperature_low = 274.15 K");
    rejects([](Species& s) { s.humidity_high = s.humidity_low; }, "humidity_high");
    rejects([](Species& s) { s.light_high = -1; }, "light_high");
    rejects([](Species& s) { s.light_low = std::nan(""); }, "light_low");
    rejects([](Species& s) { s.temperature_softness = 0; }, "temperature_softness = 0");
    rejects([](Species& s) { s.light_softness = 1.1; }, "light_softness = 1.1");
    rejects([](Species& s) { s.growth_rate = 1; }, "growth_rate = 1");
    rejects([](Species& s) { s.growth_threshold = 0; }, "growth_threshold = 0");
    rejects([](Species& s) { s.germination_threshold = 1; }, "germination_threshold = 1");
    rejects([](Species& s) { s.death_threshold = -0.1; }, "death_threshold = -0.1");
    for (const Species& s : preset_species()) EXPECT_NO_THROW(validate(s));
    EXPECT_THAT([] { validate(Rules{.gemma_step = 0}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("gemma_step = 0")));
    EXPECT_THAT([] { validate(Rules{.spore_age_low = 400}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("spore_age_high = 365 d")));
}

/// The lines `key = value` of a small TOML file, set through the description.
template <class T>
T from_file(const std::filesystem::path& path)
{
    T object;
    const ParamList params = describe_params(object);
    std::ifstream file(path);
    EXPECT_TRUE(file) << path;
    std::size_t set = 0;
    for (std::string line; std::getline(file, line);) {
        const auto equals = line.find(" = ");
        if (line.starts_with('#') || equals == std::string::npos) continue;
        std::string value = line.substr(equals + 3);
        std::erase(value, '"');
        const Param* param = find_param(params, line.substr(0, equals));
        EXPECT_NE(param, nullptr) << path << ": " << line;
        if (param) param->set_text(value);
        ++set;
    }
    EXPECT_EQ(set, params.size()) << path;
    return object;
}

TEST(MossGrowth, PresetsAreTheFilesThatUsersCopy)
{
    const std::filesystem::path data = SEKITEI_DATA;
    for (Species s : preset_species()) {
        Species read = from_file<Species>(data / "species" / (s.name + ".toml"));
        EXPECT_EQ(params_json(describe_params(read)), params_json(describe_params(s)));
    }
    for (soil::Soil s : soil::preset_soils()) {
        soil::Soil read = from_file<soil::Soil>(data / "soils" / (s.name + ".toml"));
        EXPECT_EQ(params_json(describe_params(read)), params_json(describe_params(s)));
    }
}

/// Mean fitness over a year of monthly normals on a vertical wall, west-wind days apart.
struct Year {
    double mean = 0, west = 0;
};

enum class Garden { Open, Fence, Pond };

Year year_on_a_wall(const Species& species, double shade, Garden garden)
{
    constexpr double kPi = std::numbers::pi;
    const double temperature[] = {-1.6, -.9, 2.6, 8.7, 14.5, 18.8, 22.4, 23.5, 19.3, 12.6, 6.2, .8};
    const double humidity[] = {.74, .71, .67, .64, .68, .75, .80, .79, .80, .77, .75, .76};
    const double wind[] = {2.9, 3.1, 3.4, 3.4, 3.0, 2.6, 2.5, 2.4, 2.4, 2.5, 2.7, 2.8};
    const double sunshine[] = {3.7, 4.4, 5.1, 5.7, 6.2, 5.3, 4.2, 4.7, 4.1, 4.5, 4.0, 3.3};
    const double fence[] = {.3, .5, .95, .6, .65, .6, .95, .5}, pond[] = {0, 0, 0, 0, 0, 4, 10, 4};
    const Site morioka{39.70 * kPi / 180, 141.15 * kPi / 180};

    Year year;
    int west_days = 0;
    double water = 0;
    for (int d = 1; d <= 365; ++d) {
        const Date date = date_of(day_number(2023, 1, 1) + d - 1);
        const auto m = static_cast<std::size_t>(date.month - 1);
        WeatherDay day;
        day.year = 2023, day.month = date.month, day.day = 15;
        day.sunshine = sunshine[m];
        day.possible_sunshine =
            possible_sunshine(morioka.latitude, day_of_year(2023, date.month, 15));
        const auto moments = sun::moments_of_day(2023, date.month, 15, morioka, 144);
        const double light = shade * sun::light_on_plane({0, 1, 0}, moments,
                                                         sun::radiation(day, morioka, moments), .2)
                                         .total();
        const bool wet = 165 * d / 365 > 165 * (d - 1) / 365;
        const auto direction = static_cast<std::size_t>(3 * d % 8);
        double t = temperature[m] + 273.15, u = wind[m];
        double rh = wet ? std::min(1.0, humidity[m] * 1.1) : humidity[m] * .93;
        if (garden == Garden::Fence) u *= fence[direction];
        if (garden == Garden::Pond) {
            const double f = 1 - std::exp(-pond[direction] * .02107012 / std::sqrt(u));
            const double tw = 288.15 - 5 * std::cos(2 * kPi * (d - 30) / 365);
            const double q = soil::saturation_humidity(t, 1013) * rh;
            const double qd = q + f * (soil::saturation_humidity(tw, 1013) - q);
            t += f * (tw - t);
            rh = std::min(1.0, qd / soil::saturation_humidity(t, 1013));
        }
        const soil::Day result = soil::day({.light = light,
                                            .temperature = t,
                                            .humidity = rh,
                                            .rain = wet ? .3 * 1271 / 165 : 0,
                                            .wind = u,
                                            .sky_view = .5,
                                            .depth = 20,
                                            .water = water},
                                           {.sunshine = day.sunshine / day.possible_sunshine},
                                           soil::preset_soils()[2], {});
        water = result.water;
        const double g =
            fitness(species, kPaper, result.temperature, result.humidity, light).total();
        year.mean += g / 365;
        if (direction != 6) continue;
        year.west += g;
        ++west_days;
    }
    year.west /= west_days;
    return year;
}

TEST(MossGrowth, AYearOnANorthWallGainsByFenceAndPond)
{
    struct Row {
        const char* species;
        double shade, open, fence, pond, west;
    };
    for (const Row& r : {Row{"bryum", .5, .297286, .356946, .325328, 1.388},
                         Row{"hypnum", .25, .263346, .344497, .292133, 1.379}}) {
        const Year open = year_on_a_wall(kind(r.species), r.shade, Garden::Open);
        const Year pond = year_on_a_wall(kind(r.species), r.shade, Garden::Pond);
        EXPECT_NEAR(open.mean / r.open, 1, 0.01);
        EXPECT_NEAR(year_on_a_wall(kind(r.species), r.shade, Garden::Fence).mean / r.fence, 1,
                    0.01);
        EXPECT_NEAR(pond.mean / r.pond, 1, 0.01);
        EXPECT_NEAR(pond.west / open.west / r.west, 1, 0.01);
    }
}

}  // namespace
}  // namespace sekitei::moss
