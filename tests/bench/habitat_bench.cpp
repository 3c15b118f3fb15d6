// A day of a habitat: light, air, rain that runs on, soil, fitness of three species, mosses and the
// numbers kept of them, on the cells of a rough slope; then the lantern's year; then what a run
// holds. Prints: case, cells, threads, seconds a day or in all, hash; parts of a day; bytes a cell.
//
// Arguments: width and depth of the slope in cells (320 310) and, to run a slope for so many days
// once instead, days.

#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "apps/habitat.h"
#include "apps/stage.h"
#include "core/hash.h"
#include "core/log.h"
#include "core/parallel.h"
#include "grids/level_set.h"
#include "solvers/moss/landing.h"
#include "tests/bench/measure.h"

namespace {

using namespace sekitei;
using bench::median;
using bench::seconds_of;
using namespace sekitei::apps;

void run(Scene& scene, const std::string& name, const Json& values)
{
    const auto stage = make_stage(name);
    const ParamList params = stage->params();
    for (const auto& [key, value] : values.items()) find_param(params, key)->set(value);
    stage->validate();
    StageContext context;
    context.seed = 7;
    const HistoryEntry entry = history_of(*stage, context);
    stage->run(scene, context);
    scene.history.push_back(entry);
}

const Json kWeather{{"weather", SEKITEI_DATA "/weather/morioka-normals.csv"}};

Scene slope(int width, int depth)
{
    Scene scene;
    scene.domain = {{width, depth, 60 + width / 6}, {{1, 2, 3}, 0.02}};
    scene.put("surface_sdf",
              level_set_from_function(scene.domain,
                                      [](Vec3d p) {
                                          return 0.8 *
                                                 (p.z - 35 - 0.12 * p.x -
                                                  3 * std::sin(p.x * 0.2) * std::cos(p.y * 0.17));
                                      },
                                      {}, {.steepness = 1.3, .is_distance = true}),
              "m", "bench", GridClass::LevelSet);
    run(scene, "light", kWeather);
    // Winds as a wind stage leaves them; their values do not change the time.
    const SurfaceCells cells = surface_cells(
        scene.floats("surface_sdf"), scene.vectors("surf_normal"), scene.floats("surf_area"), {});
    wind::AirTables tables;
    tables.temperature = tables.humidity = {0, 0, 0, 0, 0, 2, 4, 2};
    for (int k = 0; k < 8; ++k)
        scene.put(fmt::format("wind_ratio_{}", k),
                  cells.to_grid(std::vector<float>(cells.size(), 0.4f + 0.05f * float(k))), "",
                  "bench");
    scene.points["air_tables"] = table_points(tables);
    return scene;
}

/// What the moss stage holds from day to day.
struct Habitat {
    explicit Habitat(const Scene& scene)
        : climate(scene, {}, {}, {}),
          cells(climate.cells()),
          surface(moss::surface_of(cells)),
          landing(scene.floats("surface_sdf"), cells),
          population(moss::first_settlers(community, surface)),
          water(climate.ground().initial_water()),
          means(climate.ground()),
          fitness(3, std::vector<float>(cells.size())),
          mean_fitness(fitness)
    {
        statistics.choose(cells, cells.from_grid(scene.floats("light_S"), 0), 0);
    }

    void live(std::map<std::string, double>* parts = nullptr)
    {
        auto part = [&](const char* name, const std::function<void()>& work) {
            if (parts)
                (*parts)[name] += seconds_of(work);
            else
                work();
        };
        const auto d = static_cast<std::size_t>(population.day);
        part("climate", [&] { climate.advance(d % 365, water, population.cover, day, {}); });
        part("fitness", [&] {
            for (std::size_t s = 0; s < 3; ++s) {
                moss::fitness(species[s], community.rules, day.ground.temperature,
                              day.ground.humidity, day.light.total, fitness[s], {});
                add_to_mean(mean_fitness[s], d + 1, [&](std::size_t i) { return fitness[s][i]; });
            }
        });
        moss::DayStatistics numbers;
        part("moss", [&] {
            numbers = moss::day(population, community, surface, landing,
                                {fitness, day.wind, {0, 1, 0}}, {});
        });
        part("means", [&] { means.add(day, water); });
        part("statistics", [&] {
            statistics.add(int(d) + 1, climate.ground(), day, day.light.total, water,
                           {&numbers, population.species, fitness});
        });
    }

    // One that lives in the sun among them.
    std::vector<moss::Species> species{moss::preset_species()[0], moss::preset_species()[1],
                                       moss::preset_species()[3]};
    moss::Propagation propagation = [] {
        moss::Propagation many;
        many.initial_count = 12000;
        return many;
    }();
    moss::Community community{species, {}, propagation, 7};
    Climate climate;
    const SurfaceCells& cells;
    moss::Surface surface;
    moss::CellLanding landing;
    moss::Population population;
    std::vector<double> water;
    GroundMeans means;
    Statistics statistics{3};
    std::vector<std::vector<float>> fitness, mean_fitness;
    ClimateDay day;
};

template <class T>
double bytes_of(const std::vector<T>& v)
{
    return double(v.capacity() * sizeof(T));
}

void print_bytes(const Scene& scene, const Habitat& h)
{
    const double n = double(h.cells.size());
    double whole = 0;
    auto line = [&](const char* name, double bytes) {
        whole += bytes;
        fmt::print("  bytes a cell, {}: {:.1f}\n", name, bytes / n);
    };
    const SurfaceCells& c = h.cells;
    line("cells: voxel, position, normal, sdf, area", bytes_of(c.voxel) + bytes_of(c.position) +
                                                          bytes_of(c.normal) + bytes_of(c.sdf) +
                                                          bytes_of(c.area));
    line("cells: neighbours", bytes_of(c.neighbour_begin) + bytes_of(c.neighbour));
    line("cells: index grid", double(c.index.memory_bytes()));
    const light::Coefficients& k = h.climate.coefficients();
    line("daylight: bits", bytes_of(k.bits));
    line("daylight: links, sky_view, rain_exposure",
         bytes_of(k.links) + bytes_of(k.sky_view) + bytes_of(k.rain_exposure));
    line("climate: soil, wind ratios, paths of the water", double(h.climate.ground().bytes()));
    const ClimateDay& d = h.day;
    line("day: light", bytes_of(d.light.total) + bytes_of(d.light.direct) + bytes_of(d.light.sky) +
                           bytes_of(d.light.reflected));
    line("day: air, rain, ground", bytes_of(d.wind) + bytes_of(d.air_temperature) +
                                       bytes_of(d.air_humidity) + bytes_of(d.rain.supply) +
                                       bytes_of(d.rain.run) + bytes_of(d.ground.water) +
                                       bytes_of(d.ground.evaporation) + bytes_of(d.ground.runoff) +
                                       bytes_of(d.ground.temperature) +
                                       bytes_of(d.ground.humidity) + bytes_of(d.ground.beta));
    const moss::Population& p = h.population;
    line("population", bytes_of(p.species) + bytes_of(p.growth) + bytes_of(p.growth_max) +
                           bytes_of(p.born) + bytes_of(p.id) + bytes_of(p.seed_kind) +
                           bytes_of(p.seed_species) + bytes_of(p.seed_born) + bytes_of(p.seed_id) +
                           bytes_of(p.cover));
    line("water, means, fitness", bytes_of(h.water) + n * 6 * sizeof(float) + n + 6 * n * 4);
    fmt::print("  bytes a cell, a moss run without the scene: {:.1f}\n", whole / n);
    double grids = 0;
    for (const auto& [name, grid] : scene.grids)
        grids += std::visit(
            [](const auto& g) {
                if constexpr (requires { g.memory_bytes(); })
                    return double(g.memory_bytes());
                else
                    return 0.0;
            },
            grid.values);
    fmt::print("  bytes a cell, the scene's {} grids: {:.1f}, its points daylight: {:.1f}\n",
               scene.grids.size(), grids / n,
               24.0 + 4.0 * double(scene.points_of("daylight").attributes.size()));
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    fmt::print("  peak of this process: {:.0f} MB\n", double(usage.ru_maxrss) / 1024);
}

std::string hash_of(const Habitat& h)
{
    return hash_hex(moss::encode({7, "", h.population, {{"water", h.water}}})).substr(0, 16);
}

}  // namespace

int main(int argc, char** argv)
{
    log::set_level(log::Level::Quiet);
    const int width = argc > 2 ? std::atoi(argv[1]) : 320,
              depth = argc > 2 ? std::atoi(argv[2]) : 310, days = argc > 3 ? std::atoi(argv[3]) : 0;
    {
        Scene scene;
        const double made = seconds_of([&] { scene = slope(width, depth); });
        if (days > 0) {
            fmt::print("slope and its light, {:.1f} s\n", made);
            const double lived = seconds_of([&] {
                run(scene, "moss",
                    {{"species", "bryum,hypnum,grimmia"}, {"days", days}, {"repeat_year", true}});
            });
            rusage usage{};
            getrusage(RUSAGE_SELF, &usage);
            fmt::print("moss stage, {} cells, {} days, {:.1f} s, peak {:.0f} MB\n",
                       scene.floats("surf_area").active_count(), days, lived,
                       double(usage.ru_maxrss) / 1024);
            return 0;
        }
        Habitat start(scene);
        for (int d = 0; d < 60; ++d) start.live();
        constexpr int kRounds = 5;
        std::vector<double> seconds[2];
        std::map<std::string, double> parts[2];
        std::string hash[2];
        moss::Population population = start.population;
        const std::vector<double> water = start.water;
        for (int round = 0; round < kRounds; ++round)
            for (const std::size_t threads : {1u, 2u}) {
                const ThreadLimit limit(threads);
                start.population = population;
                start.water = water;
                seconds[threads - 1].push_back(
                    seconds_of([&] { start.live(&parts[threads - 1]); }));
                hash[threads - 1] = hash_of(start);
            }
        for (std::size_t k = 0; k < 2; ++k) {
            fmt::print("a habitat's day, {} ({} mosses), {}, {:.4f}, {}\n", start.cells.size(),
                       std::ranges::count_if(start.population.species,
                                             [](std::uint8_t s) { return s > 0; }),
                       k + 1, median(seconds[k]), hash[k]);
            for (const auto& [name, time] : parts[k])
                fmt::print("  {}: {:.4f}\n", name, time / kRounds);
        }
        print_bytes(scene, start);
    }
    Scene lantern;
    run(lantern, "lantern", Json::object());
    run(lantern, "light", kWeather);
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        Scene scene = lantern;
        const double lived = seconds_of([&] { run(scene, "moss", {{"growth_rate", 0.02}}); });
        fmt::print("the lantern's 365 days, {}, {}, {:.2f}, {}\n",
                   scene.floats("surf_area").active_count(), threads, lived,
                   content_hash(scene.points_of("moss")).substr(0, 16));
    }
}
