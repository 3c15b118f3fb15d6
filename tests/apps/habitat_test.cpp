#include "apps/habitat.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <cstring>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "tests/apps/mesh_scenes.h"
#include "tests/support/stopped.h"

namespace sekitei::apps {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;
using namespace apps::testing;

const std::string kThree = "bryum,hypnum,polytrichum";

Sky moist(double light)
{
    return {.celsius = 14,
            .humidity = 88,
            .rain = 4,
            .sunshine = 4,
            .global = light,
            .diffuse = 0.6 * light};
}

// ---- Moss where its causes are ----------------------------------------------------------------

TEST(HabitatRealism, NoMossInFullSunAndMuchUnderACloth)
{
    Habitat habitat;
    for (const bool cloth : {false, true}) {
        SCOPED_TRACE(cloth);
        Scene scene = plane();
        habitat.light(scene, weather_csv(120, [&](int) { return moist(cloth ? 20 : 200); }));
        run(scene, "moss", {{"species", kThree}}, habitat.context());
        if (cloth)
            EXPECT_GT(cover(scene), 0.3);
        else
            EXPECT_EQ(cover(scene), 0);
    }
}

TEST(HabitatRealism, CoverHasOneMaximumWithinTheRangeOfLight)
{
    Habitat habitat;
    const double lights[] = {0, 1, 3, 10, 30, 60, 90, 140};
    std::vector<double> covers;
    for (const double light : lights) {
        Scene scene = plane();
        habitat.light(scene, weather_csv(40, [&](int) { return moist(light); }));
        run(scene, "moss", {{"species", "bryum"}, {"growth_rate", 0.4}}, habitat.context());
        covers.push_back(cover(scene));
    }
    const auto top = std::size_t(std::max_element(covers.begin(), covers.end()) - covers.begin());
    EXPECT_GT(lights[top], 0);
    EXPECT_LT(lights[top], 60);
    for (std::size_t k = 0; k + 1 < covers.size(); ++k) {
        SCOPED_TRACE(
            fmt::format("S {}: {}, S {}: {}", lights[k], covers[k], lights[k + 1], covers[k + 1]));
        if (k < top)
            EXPECT_LE(covers[k], covers[k + 1]);
        else
            EXPECT_GE(covers[k], covers[k + 1]);
    }
    EXPECT_EQ(covers.front(), 0);
    EXPECT_EQ(covers.back(), 0);
}

TEST(HabitatRealism, WithoutLightWaterOrAFitTemperatureThereIsNoMoss)
{
    Habitat habitat;
    auto grown = [&](const Sky& sky, double water) {
        Scene scene = plane(0.05);
        habitat.light(scene, weather_csv(60, [&](int) { return sky; }));
        run(scene, "soil", {{"initial_water", water}}, habitat.context());
        run(scene, "moss", {{"species", kThree + ",grimmia"}}, habitat.context());
        return cover(scene);
    };
    const Sky good = moist(25);
    Sky dark = moist(0), dry = good, hot = good, cold = good;
    dry.rain = 0;
    dry.humidity = 25;
    dry.global = 60;
    hot.celsius = 55;
    cold.celsius = -40;
    EXPECT_GT(grown(good, 0.5), 0.3);
    EXPECT_EQ(grown(dark, 0.5), 0);
    EXPECT_EQ(grown(dry, 0), 0);
    EXPECT_EQ(grown(hot, 0.5), 0);
    EXPECT_EQ(grown(cold, 0.5), 0);
}

// ---- The day by hand --------------------------------------------------------------------------

TEST(HabitatChain, SuitabilityOnAWallIsTheMeanOfFitnessByHand)
{
    Habitat habitat;
    Scene scene = body(0.05, {-0.5, -0.5, 0}, {1, 1, 1}, [](Vec3d p) {
        return box_distance(p, {0.01, 0.01, 0.2}, {0.3, 0.25, 0.5});
    });
    constexpr int kDays = 25;
    habitat.light(scene, weather_csv(kDays, [](int d) {
                      return Sky{.celsius = 6.0 + 0.7 * d,
                                 .humidity = 60.0 + d,
                                 .rain = d % 3 ? 0.0 : 5.0,
                                 .wind = 1 + 0.1 * d,
                                 .sunshine = 0.3 * d,
                                 .global = 40 + 4.0 * d,
                                 .diffuse = 30 + 2.0 * d};
                  }));
    run(scene, "soil", {{"runoff", false}}, habitat.context());
    scene.grids.erase("soil_water");  // begin anew
    run(scene, "moss",
        {{"species", "bryum,hypnum"}, {"initial_count", 0}, {"external_interval", 0}},
        habitat.context());
    const SurfaceCells cells = cells_of(scene);
    std::size_t wall = 0;
    for (std::size_t i = 0; i < cells.size(); ++i)
        if (cells.normal[i].y > 0.999f && std::abs(cells.position[i].z - 0.4) < 0.03 &&
            std::abs(cells.position[i].x) < 0.03)
            wall = i;
    ASSERT_GT(wall, 0u);

    const Weather weather = weather_of(scene);
    const light::Coefficients c = coefficients_of(scene, cells);
    std::vector<Vec3d> origin;
    for (std::size_t i = 0; i < cells.size(); ++i) origin.push_back(cells.ray_origin(i));
    double water = 0.12, mean[2] = {0, 0}, humidity = 0;
    for (const WeatherDay& w : weather.days) {
        const auto moments = sun::moments_of_day(w.year, w.month, w.day, *weather.site);
        const float light = light::day(c, {origin, cells.normal, cells.area}, moments,
                                       sun::radiation(w, *weather.site, moments))
                                .total[wall];
        const soil::Day day =
            soil::day({.light = double(light),
                       .temperature = w.temperature,
                       .humidity = w.humidity,
                       .rain = w.precipitation * double(c.rain_exposure[wall]),
                       .wind = w.wind_speed,
                       .sky_view = double(c.sky_view[wall]),
                       .depth = 20,
                       .water = water},
                      {.sunshine = w.sunshine / w.possible_sunshine, .pressure = w.pressure},
                      soil::preset_soils()[2], {});
        water = day.water;
        humidity += day.humidity / kDays;
        for (int s = 0; s < 2; ++s)
            mean[s] += moss::fitness(moss::preset_species()[std::size_t(s)], {}, day.temperature,
                                     day.humidity, double(light))
                           .total() /
                       kDays;
    }
    auto at = [&](const char* name) {
        return double(cells.from_grid(scene.floats(name), -1)[wall]);
    };
    EXPECT_NEAR(at("suit_bryum"), mean[0], 1e-5);
    EXPECT_NEAR(at("suit_hypnum"), mean[1], 1e-5);
    EXPECT_NEAR(at("soil_rh"), humidity, 1e-6);
    EXPECT_NEAR(at("soil_water"), water, 1e-6);
    EXPECT_GT(mean[0], 0.05);
}

// ---- The same bytes ---------------------------------------------------------------------------

const Json kQuickWind{
    {"garden_spacing", 1}, {"object_spacing", 0.1}, {"settle", 1}, {"duration", 1}};

Scene lantern_chain(Habitat& habitat, const std::string& layout, const Json& moss,
                    StageContext context)
{
    Scene scene;
    run(scene, "lantern", {{"layout", layout}, {"cell", 0.05}}, context);
    habitat.light(scene, weather_csv(20, [](int d) {
                      Sky sky = moist(60);
                      sky.direction = 45.0 * (3 * d % 8);
                      return sky;
                  }));
    run(scene, "wind", kQuickWind, context);
    run(scene, "soil", {}, context);
    run(scene, "moss", moss, context);
    return scene;
}

TEST(HabitatChain, GivesTheSameBytesOnOneAndTwoThreads)
{
    Habitat habitat;
    std::map<std::string, std::string> first;
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        const Scene scene =
            lantern_chain(habitat, "pond", {{"species", kThree}}, habitat.context());
        if (threads == 1)
            first = hashes_of(scene);
        else
            EXPECT_EQ(hashes_of(scene), first);
        EXPECT_GT(cover(scene), 0.01);
    }
    EXPECT_GT(first.size(), 40u);
}

TEST(HabitatChain, TheSeedMovesMossButNotClimate)
{
    Habitat habitat;
    Scene scene = plane(0.05);
    habitat.light(scene, weather_csv(15, [](int) { return moist(25); }));
    Scene other = scene;
    run(scene, "moss", {{"species", "bryum"}}, habitat.context(1));
    run(other, "moss", {{"species", "bryum"}}, habitat.context(2));
    EXPECT_NE(content_hash(scene.grids.at("moss_species")),
              content_hash(other.grids.at("moss_species")));
    EXPECT_EQ(content_hash(scene.points.at("daylight")), content_hash(other.points.at("daylight")));
}

// ---- Checkpoints ------------------------------------------------------------------------------

class MossCheckpoint : public ::testing::Test {
protected:
    MossCheckpoint()
    {
        start = plane(0.05);
        habitat.light(start, weather_csv(75, [](int d) { return moist(20.0 + d % 7); }));
        run(start, "soil", {}, habitat.context());
    }
    Json params(const std::string& file, double rate = 1) const
    {
        return {{"species", kThree}, {"growth_rate", rate}, {"checkpoint", file}};
    }
    /// A checkpoint of day 60, left by a run that was stopped.
    std::string interrupted(std::uint64_t seed = 7)
    {
        Scene scene = start;
        Stopped stopped(habitat.context(seed), 0.92);
        EXPECT_THROW(run(scene, "moss", params("moss.checkpoint"), stopped.context), Cancelled);
        EXPECT_TRUE(std::filesystem::exists(habitat.folder / "moss.checkpoint"));
        return read_file(habitat.folder / "moss.checkpoint");
    }

    Habitat habitat;
    Scene start;
};

TEST_F(MossCheckpoint, AnInterruptedRunGoesOnToTheSameBytes)
{
    Scene whole = start, resumed = start;
    run(whole, "moss", params(""), habitat.context());
    interrupted();
    int reports = 0;
    StageContext context = habitat.context();
    std::atomic<bool> never = false;
    context.progress = Progress([&](const std::string&, double) { ++reports; }, &never);
    run(resumed, "moss", params("moss.checkpoint"), context);
    EXPECT_EQ(hashes_of(resumed), hashes_of(whole));
    EXPECT_LT(reports, 40) << "it lived all 75 days once more";
}

TEST_F(MossCheckpoint, ARecipesOwnIsRemovedOnceTheResultIsThere)
{
    Scene scene = start;
    StageContext context = habitat.context();
    context.checkpoint = habitat.folder / "own.checkpoint";
    {
        Stopped stopped(context, 0.6);
        EXPECT_THROW(run(scene, "moss", params(""), stopped.context), Cancelled);
    }
    EXPECT_TRUE(std::filesystem::exists(context.checkpoint));
    Scene resumed = start, whole = start;
    run(resumed, "moss", params(""), context);
    EXPECT_FALSE(std::filesystem::exists(context.checkpoint));
    run(whole, "moss", params(""), habitat.context());
    EXPECT_EQ(hashes_of(resumed), hashes_of(whole));
}

TEST_F(MossCheckpoint, OfAnotherRunIsRefusedAndSaysWhatDiffers)
{
    const std::string bytes = interrupted();
    auto refused = [&](const Scene& from, const Json& values, std::uint64_t seed,
                       const ::testing::Matcher<std::string>& words) {
        Scene scene = from;
        const auto before = hashes_of(scene);
        EXPECT_THAT([&] { run(scene, "moss", values, habitat.context(seed)); },
                    ThrowsMessage<InvalidInput>(words));
        EXPECT_EQ(hashes_of(scene), before);
    };
    const Json same = params("moss.checkpoint");
    refused(start, same, 8,
            AllOf(HasSubstr("seed 7"), HasSubstr("8"), HasSubstr("moss.checkpoint")));
    refused(start, params("moss.checkpoint", 0.5), 7, HasSubstr("growth_rate"));
    Scene other = start;
    habitat.light(other, weather_csv(75, [](int d) { return moist(21.0 + d % 7); }));
    run(other, "soil", {}, habitat.context());
    refused(other, same, 7, HasSubstr("weather"));
    // What a wind stage would say of the cells is part of it.
    Scene windy = start;
    const SurfaceCells cells = cells_of(windy);
    for (int k = 0; k < 8; ++k)
        windy.put("wind_ratio_" + std::to_string(k),
                  cells.to_grid(std::vector<float>(cells.size(), 0.5f)), "", "wind");
    windy.points["air_tables"] = table_points({});
    refused(windy, same, 7, HasSubstr("wind"));
    Scene wet = start;
    wet.put("soil_water", cells.to_grid(std::vector<float>(cells.size(), 0.2f)), "mm", "soil");
    refused(wet, same, 7, HasSubstr("soil_water"));

    for (const std::size_t at : {bytes.size() / 3, bytes.size() - 40}) {
        std::string damaged = bytes;
        damaged[at] = char(damaged[at] ^ 4);
        write_file(habitat.folder / "moss.checkpoint", damaged);
        refused(start, same, 7, HasSubstr("moss.checkpoint"));
    }
    write_file(habitat.folder / "moss.checkpoint", bytes.substr(0, bytes.size() / 2));
    refused(start, same, 7, HasSubstr("moss.checkpoint"));
    write_file(habitat.folder / "moss.checkpoint", "a text");
    refused(start, same, 7, HasSubstr("not a checkpoint"));
}

TEST(WindCheckpoint, AnInterruptedRunGoesOnToTheSameBytes)
{
    Habitat habitat;
    Scene start;
    run(start, "lantern", {{"layout", "fence"}, {"cell", 0.05}}, habitat.context());
    habitat.light(start, weather_csv(1, [](int) { return moist(20); }));
    StageContext context = habitat.context();
    context.checkpoint = habitat.folder / "wind.checkpoint";
    Scene whole = start, resumed = start, stopped_scene = start;
    run(whole, "wind", kQuickWind, habitat.context());
    {
        Stopped stopped(context, 0.7);
        EXPECT_THROW(run(stopped_scene, "wind", kQuickWind, stopped.context), Cancelled);
    }
    ASSERT_TRUE(std::filesystem::exists(context.checkpoint));
    const std::string bytes = read_file(context.checkpoint);
    run(resumed, "wind", kQuickWind, context);
    EXPECT_EQ(hashes_of(resumed), hashes_of(whole));
    EXPECT_FALSE(std::filesystem::exists(context.checkpoint));

    // One that is damaged, or of other parameters, is refused.
    std::string damaged = bytes;
    damaged[damaged.size() / 2] ^= 1;
    write_file(context.checkpoint, damaged);
    Scene again = start;
    EXPECT_THAT([&] { run(again, "wind", kQuickWind, context); },
                ThrowsMessage<InvalidInput>(HasSubstr("wind.checkpoint: a damaged checkpoint")));
    write_file(context.checkpoint, bytes);
    Json other = kQuickWind;
    other["speed"] = 4;
    EXPECT_THAT([&] { run(again, "wind", other, context); },
                ThrowsMessage<InvalidInput>(HasSubstr("of other parameters")));
    Scene without_fence = start;
    without_fence.grids.erase("obstacle_sdf");
    EXPECT_THAT([&] { run(without_fence, "wind", kQuickWind, context); },
                ThrowsMessage<InvalidInput>(HasSubstr("of another scene")));
    EXPECT_EQ(read_file(context.checkpoint), bytes);
}

// ---- What is written --------------------------------------------------------------------------

std::vector<std::vector<std::string>> rows_of(const std::string& csv)
{
    std::vector<std::vector<std::string>> rows(1, {""});
    bool quoted = false;
    for (const char c : csv) {
        if (c == '"')
            quoted = !quoted;
        else if (quoted)
            rows.back().back() += c;
        else if (c == '\n')
            rows.push_back({""});
        else if (c == ',')
            rows.back().push_back("");
        else
            rows.back().back() += c;
    }
    rows.pop_back();
    return rows;
}

TEST(HabitatStatistics, TableHasARowForEachDayAndSpeciesWithUnits)
{
    Habitat habitat;
    Scene scene = body(0.05, {-0.5, -0.5, 0}, {1, 1, 1.2}, [](Vec3d p) {
        return box_distance(p, {0.01, 0.01, 0.3}, {0.3, 0.3, 0.6});
    });
    habitat.light(scene, weather_csv(12, [](int d) {
                      Sky sky = moist(60);
                      sky.direction = 45.0 * (d % 8);
                      return sky;
                  }));
    Scene bare = scene;
    run(scene, "moss", {{"species", "hypnum,bryum"}}, habitat.context());
    std::unique_ptr<Stage> stage;
    run(scene, "statistics", {}, habitat.context(), &stage);
    const auto rows = rows_of(stage->table);
    ASSERT_EQ(rows.size(), 1u + 12 * 2);
    std::map<std::string, std::size_t> at;
    for (std::size_t c = 0; c < rows[0].size(); ++c) at[rows[0][c]] = c;
    for (const char* name : {"day",
                             "species",
                             "wind_direction",
                             "living",
                             "seeds",
                             "germinated",
                             "died",
                             "cover [m^2]",
                             "fitness",
                             "fitness_shade",
                             "fitness_low",
                             "cover_low [m^2]",
                             "light [W/m^2]",
                             "temperature [K]",
                             "humidity",
                             "humidity_north",
                             "theta",
                             "evaporation [mm]",
                             "precipitation [mm]",
                             "runoff [mm]",
                             "balance_error"})
        EXPECT_TRUE(at.contains(name)) << name;
    const SurfaceCells cells = cells_of(scene);
    for (std::size_t r = 1; r < rows.size(); ++r) {
        ASSERT_EQ(rows[r].size(), rows[0].size());
        EXPECT_EQ(rows[r][at["day"]], std::to_string((r - 1) / 2 + 1));
        EXPECT_EQ(rows[r][at["species"]], r % 2 ? "hypnum" : "bryum");
        EXPECT_EQ(rows[r][at["wind_direction"]], std::to_string((r - 1) / 2 % 8));
        EXPECT_LT(std::abs(std::stod(rows[r][at["balance_error"]])), 1e-9);
    }
    // The last day's numbers against the grids.
    const auto moss = cells.from_grid(scene.ints("moss_species"), 0);
    const auto seeds = cells.from_grid(scene.ints("seed_species"), 0);
    const auto shade = cells.from_grid(scene.floats("light_S"), 0);
    for (int s = 1; s <= 2; ++s) {
        const auto& row = rows[rows.size() - 3 + std::size_t(s)];
        int living = 0, resting = 0;
        double area = 0, low = 0;
        for (std::size_t i = 0; i < cells.size(); ++i) {
            resting += seeds[i] == s;
            if (moss[i] != s) continue;
            ++living;
            area += double(cells.area[i]);
            if (cells.position[i].z < 0.5) low += double(cells.area[i]);
        }
        EXPECT_EQ(row[at["living"]], std::to_string(living));
        EXPECT_EQ(row[at["seeds"]], std::to_string(resting));
        EXPECT_NEAR(std::stod(row[at["cover [m^2]"]]), area, 1e-6);
        EXPECT_NEAR(std::stod(row[at["cover_low [m^2]"]]), low, 1e-6);
        EXPECT_GT(low, 0);
        EXPECT_LT(low, area);
    }
    // Means over days of what the grids keep as means.
    auto mean_of = [&](const char* name) {
        double sum = 0;
        for (const double v : column(scene, name)) sum += v / (12 * 2);
        return sum;
    };
    auto mean_over = [&](const std::vector<float>& values, auto&& chosen) {
        double sum = 0, area = 0;
        for (std::size_t i = 0; i < cells.size(); ++i)
            if (chosen(i)) {
                sum += double(cells.area[i]) * double(values[i]);
                area += double(cells.area[i]);
            }
        return sum / area;
    };
    auto all = [](std::size_t) { return true; };
    const auto rh = cells.from_grid(scene.floats("soil_rh"), 0);
    EXPECT_NEAR(mean_of("humidity"), mean_over(rh, all), 1e-6);
    EXPECT_NEAR(mean_of("humidity_north"),
                mean_over(rh, [&](std::size_t i) { return cells.normal[i].y > 0.5f; }), 1e-6);
    EXPECT_NEAR(mean_of("light"), mean_over(shade, all), 1e-4);
    EXPECT_NEAR(mean_of("temperature"), mean_over(cells.from_grid(scene.floats("soil_Ts"), 0), all),
                1e-4);
    EXPECT_NEAR(mean_of("evaporation"), mean_over(cells.from_grid(scene.floats("soil_E"), 0), all),
                1e-6);
    EXPECT_NEAR(mean_of("theta"), mean_over(cells.from_grid(scene.floats("soil_theta"), 0), all),
                1e-7);
    const auto g = cells.from_grid(scene.floats("suit_hypnum"), 0);
    double fitness_shade = 0, fitness_low = 0;
    for (std::size_t r = 0; r < 24; r += 2) {
        fitness_shade += column(scene, "fitness_shade")[r] / 12;
        fitness_low += column(scene, "fitness_low")[r] / 12;
    }
    EXPECT_NEAR(fitness_shade, mean_over(g, [&](std::size_t i) { return shade[i] < 80; }), 1e-6);
    EXPECT_NEAR(
        fitness_low,
        mean_over(g, [&](std::size_t i) { return shade[i] < 80 && cells.position[i].z < 0.5; }),
        1e-6);

    run(bare, "soil", {}, habitat.context());
    run(bare, "statistics", {}, habitat.context(), &stage);
    const auto ground = rows_of(stage->table);
    ASSERT_EQ(ground.size(), 13u);
    EXPECT_EQ(ground[1][1], "ground");
    bare.points["statistics"].attributes.erase("theta");
    EXPECT_THAT([&] { run(bare, "statistics", {}, habitat.context()); },
                ThrowsMessage<InvalidInput>(HasSubstr("theta")));
}

/// A scene with numbers of its own choice, as compare sees it.
Scene numbers(const std::string& layout, double fitness, double cover_area, double humidity = 0.7)
{
    Scene scene;
    scene.history.push_back({"lantern", "1", Json{{"layout", layout}}, 1});
    Points points;
    points.position.assign(4, Vec3d());
    for (const Column& c : Statistics::columns())
        points.attributes[c.name] = std::vector<double>(4);
    auto set = [&](const char* name, std::vector<double> values) {
        points.attributes[name] = std::move(values);
    };
    set("day", {1, 1, 2, 2});
    set("species", {0, 1, 0, 1});
    set("wind_direction", {6, 6, 2, 2});
    for (const char* name : {"fitness_shade", "fitness_low"})
        set(name, {fitness, fitness, fitness / 2, fitness / 2});
    set("humidity_north", std::vector<double>(4, humidity));
    set("cover", {9, 9, cover_area / 4, cover_area * 3 / 4});  // the last day's count
    scene.points["statistics"] = points;
    return scene;
}

TEST(HabitatCompare, HoldsLinesWithinTheirBoundsAndSaysWhichMiss)
{
    Habitat habitat;
    auto table = [&](const Scene& first, const Scene& second, Json* summary = nullptr) {
        const auto stage = make_stage("compare");
        stage->validate();
        const Json s = stage->run_many({{"first", first}, {"second", second}}, habitat.context());
        if (summary) *summary = s;
        std::map<std::string, std::vector<std::string>> lines;
        for (const auto& row : rows_of(stage->table)) {
            EXPECT_EQ(row.size(), 7u) << row[0];
            EXPECT_TRUE(lines.emplace(row[0], row).second) << "two lines " << row[0];
        }
        return lines;
    };
    Json summary;
    auto lines = table(numbers("nothing", 0.4, 0.5), numbers("fence", 0.44, 0.5, 0.8), &summary);
    EXPECT_THAT(lines["measure"],
                ElementsAre("measure", "scene", "value", "first", "ratio", "expected", "holds"));
    EXPECT_THAT(lines["humidity, cells facing north"],
                ElementsAre("humidity, cells facing north", "second", "0.8", "0.7", "1.143", ">= 1",
                            "holds"));
    EXPECT_THAT(lines["fitness G, S < 80 W/m2"],
                ElementsAre("fitness G, S < 80 W/m2", "second", "0.33", "0.3", "1.100", ">= 1.05",
                            "holds"));
    EXPECT_THAT(
        lines["fitness G, S < 80 W/m2, west wind"],
        ElementsAre("fitness G, S < 80 W/m2, west wind", "second", "0.44", "0.4", "1.100", "", ""));
    EXPECT_THAT(lines["living cover [m2]"], ElementsAre("living cover [m2]", "second", "0.5", "0.5",
                                                        "1.000", ">= 1.05", "MISSED"));
    EXPECT_EQ(summary["expectations"], 3);
    EXPECT_EQ(summary["held"], 2);

    // Other bounds for a pond, and none for what the paper does not show.
    lines = table(numbers("nothing", 0.4, 0.5), numbers("pond", 0.41, 0.506));
    EXPECT_EQ(lines["living cover [m2]"][5], ">= 1.01");
    EXPECT_EQ(lines["living cover [m2]"][6], "holds");
    EXPECT_EQ(lines["fitness G, S < 80 W/m2, west wind"][5], ">= 1.04");
    EXPECT_EQ(lines["fitness G, S < 80 W/m2, west wind"][6], "MISSED");
    lines = table(numbers("nothing", 0.4, 0.5), numbers("garden", 0.2, 0.1), &summary);
    EXPECT_EQ(summary["expectations"], 0);
    EXPECT_EQ(lines["living cover [m2]"][6], "");
    // Nothing to compare with is no success.
    lines = table(numbers("nothing", 0.4, 0), numbers("fence", 0.5, 0));
    EXPECT_EQ(lines["living cover [m2]"][6], "MISSED");
    EXPECT_EQ(lines["living cover [m2]"][4], "");
    EXPECT_THROW(
        make_stage("compare")->run_many({{"first", numbers("nothing", 1, 1)}}, habitat.context()),
        InvalidParameter);
}

TEST(HabitatCompare, BoundsTheWindBeforeTheObject)
{
    Habitat habitat;
    Scene open = numbers("nothing", 0.4, 0.5);
    open.points["air_tables"] = table_points({});
    auto verdicts = [&](const std::string& layout, const wind::AirTables& tables) {
        Scene scene = numbers(layout, 0.4, 0.5);
        scene.points["air_tables"] = table_points(tables);
        const auto stage = make_stage("compare");
        stage->validate();
        stage->run_many({{"open", open}, {"other", scene}}, habitat.context());
        std::string text;
        for (const auto& row : rows_of(stage->table))
            if (row[0].starts_with("wind before") || row[0].find("A_") != std::string::npos)
                text += row[6].empty() ? '-' : row[6][0];
        return text;
    };
    wind::AirTables tables;
    tables.speed = {0.3, 0.5, 1.1, 0.6, 0.8, 0.6, 0.9, 0.5};
    EXPECT_EQ(verdicts("fence", tables), "hhhh");  // N, E, S, W
    tables.speed = {0.46, 0.5, 1.16, 0.6, 0.86, 0.6, 0.84, 0.5};
    EXPECT_EQ(verdicts("fence", tables), "MMMM");
    tables.speed = {0.8, 0.5, 1, 0.6, 0.3, 0.6, 1, 0.5};
    EXPECT_EQ(verdicts("south_fence", tables), "hhhh");
    EXPECT_EQ(verdicts("fence", tables), "Mhhh");
    tables = {};
    tables.temperature[6] = tables.humidity[6] = 3;
    EXPECT_EQ(verdicts("pond", tables), "----hhh");  // winds; water W, E, A_q - A_T
    tables.temperature[6] = 5.5;
    tables.temperature[2] = 0.01;
    EXPECT_EQ(verdicts("pond", tables), "----MMM");
}

TEST(HabitatFrames, AreScenesAtTheirDays)
{
    Habitat habitat;
    Scene start = plane(0.05);
    habitat.light(start, weather_csv(25, [](int) { return moist(25); }));
    std::map<int, std::map<std::string, std::string>> frames;
    StageContext context = habitat.context();
    context.frame = [&](int number, const Scene& scene) {
        EXPECT_TRUE(frames.emplace(number, hashes_of(scene)).second);
    };
    Scene scene = start;
    run(scene, "moss", {{"species", "bryum"}, {"every", 10}}, context);
    std::vector<int> days;
    for (const auto& [day, frame] : frames) days.push_back(day);
    EXPECT_THAT(days, ElementsAre(10, 20, 25));
    EXPECT_EQ(frames.at(25), hashes_of(scene));
    Scene shorter = start;
    run(shorter, "moss", {{"species", "bryum"}, {"days", 20}}, habitat.context());
    EXPECT_EQ(frames.at(20), hashes_of(shorter));
    EXPECT_NE(frames.at(10), frames.at(20));
}

TEST(HabitatExport, WritesTheLivingAsAPlyThatReadsBack)
{
    Habitat habitat;
    Scene scene = body(0.05, {-0.5, -0.5, 0}, {1, 1, 1},
                       [](Vec3d p) { return length(p - Vec3d(0.01, 0.02, 0.4)) - 0.33; });
    habitat.light(scene, weather_csv(30, [](int) { return moist(50); }));
    run(scene, "moss", {{"species", kThree}}, habitat.context());
    std::unique_ptr<Stage> stage;
    const Json summary = run(scene, "export", {}, habitat.context(), &stage);
    const Points& points = scene.points_of("moss");
    const double living = [&] {
        const auto& l = column(scene, "living");
        return l[l.size() - 1] + l[l.size() - 2] + l[l.size() - 3];
    }();
    ASSERT_EQ(double(points.position.size()), living);
    EXPECT_EQ(summary["points"], points.position.size());
    const std::string& ply = stage->table;

    std::map<std::string, std::vector<double>> values;
    std::vector<std::pair<std::string, int>> fields;  // name, bytes; floats 4, doubles 8, ints -4
    std::size_t at = 0;
    std::size_t count = 0;
    for (std::string line; line != "end_header";) {
        const std::size_t end = ply.find('\n', at);
        ASSERT_NE(end, std::string::npos);
        line = ply.substr(at, end - at);
        at = end + 1;
        if (line.starts_with("element vertex ")) count = std::stoul(line.substr(15));
        if (!line.starts_with("property ")) continue;
        const std::size_t blank = line.find(' ', 9);
        const std::string type = line.substr(9, blank - 9);
        ASSERT_TRUE(type == "float" || type == "double" || type == "int") << type;
        fields.emplace_back(line.substr(blank + 1), type == "float" ? 4 : type == "int" ? -4 : 8);
    }
    ASSERT_EQ(count, points.position.size());
    for (std::size_t i = 0; i < count; ++i)
        for (const auto& [name, bytes] : fields) {
            double d;
            float f;
            std::int32_t n;
            if (bytes == 8)
                std::memcpy(&d, ply.data() + at, 8);
            else if (bytes == 4)
                std::memcpy(&f, ply.data() + at, 4), d = double(f);
            else
                std::memcpy(&n, ply.data() + at, 4), d = n;
            at += std::size_t(std::abs(bytes));
            values[name].push_back(d);
        }
    EXPECT_EQ(at, ply.size());
    for (const char* name : {"x", "y", "z", "nx", "ny", "nz", "orient_x", "orient_y", "orient_z",
                             "orient_w", "pscale", "species", "age", "id", "wetness"})
        ASSERT_TRUE(values.contains(name)) << name;
    GridReader<float> sdf(scene.floats("surface_sdf"));
    for (std::size_t i = 0; i < count; ++i) {
        const Vec3d p{values["x"][i], values["y"][i], values["z"][i]};
        EXPECT_EQ(p, points.position[i]);
        EXPECT_LT(std::abs(sdf.sample((p - scene.domain.transform.origin) / 0.05)), 0.1 * 0.05);
        const Vec3d n{values["nx"][i], values["ny"][i], values["nz"][i]};
        EXPECT_NEAR(length(n), 1, 1e-5);
        EXPECT_GT(dot(n, p - Vec3d(0.01, 0.02, 0.4)), 0.3);
        const Vec3d q{values["orient_x"][i], values["orient_y"][i], values["orient_z"][i]};
        const double w = values["orient_w"][i];
        EXPECT_NEAR(dot(q, q) + w * w, 1, 1e-5);
        const Vec3d y{0, 1, 0}, axis = y + cross(q, cross(q, y) + y * w) * 2.0;
        EXPECT_GT(dot(axis, n), 0.8);
        EXPECT_TRUE(values["pscale"][i] > 0 && values["pscale"][i] <= 1);
        EXPECT_TRUE(values["wetness"][i] > 0 && values["wetness"][i] <= 1);
        EXPECT_EQ(values["id"][i],
                  double(std::get<std::vector<std::int64_t>>(points.attributes.at("id"))[i]));
    }
    EXPECT_THROW(run(scene, "export", {{"points", "fungi"}}, habitat.context()), InvalidInput);
}

}  // namespace
}  // namespace sekitei::apps
