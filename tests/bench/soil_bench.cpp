// A day of many sites: soil (exact, linear), fitness of three species, runoff. The same work
// through the function of one site is the peer. Prints: case, sites, threads, seconds, millions of
// site days a second, hash.

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include "core/parallel.h"
#include "core/random.h"
#include "solvers/moss/growth.h"
#include "solvers/soil/soil.h"
#include "tests/bench/measure.h"
#include "tests/bench/soil_sites.h"

namespace {

using namespace sekitei;
using bench::hash_of;
using bench::median;

constexpr std::size_t kSites = 200000;

struct Ground : bench::SoilSites {
    std::vector<double> capacity;
    std::vector<float> temperature, humidity;

    Ground()
    {
        for (std::size_t i = 0; i < kSites; ++i) {
            auto draw = [&](const char* name) {
                return static_cast<float>(uniform01(1, Stream(name), i));
            };
            light.push_back(150 * draw("S"));
            temperature.push_back(288 + 2 * draw("T"));
            humidity.push_back(0.7F + 0.2F * draw("rh"));
            wind.push_back(3 * draw("U"));
            sky.push_back(draw("V"));
            cover.push_back(draw("c"));
            depth.push_back(i % 2 ? 20.0F : 300.0F);
            capacity.push_back(depth.back() * soil::preset_soils()[0].porosity);
            water.push_back(capacity.back() * draw("O"));
            rain.push_back(10 * draw("P"));
        }
    }
    soil::Inputs inputs(bool air_per_site) const
    {
        soil::Inputs in = SoilSites::inputs();
        if (air_per_site) in.temperature = temperature, in.humidity = humidity;
        return in;
    }
};

struct Case {
    std::string name;
    std::function<void()> work;
    std::function<std::string()> hash;
    int rounds = 5;
};

}  // namespace

int main()
{
    const Ground ground;
    soil::Params exact, linear;
    linear.balance = soil::Balance::Linear;
    soil::Result result;
    std::vector<float> fitness(kSites);
    auto species = [&] {
        for (std::size_t k = 0; k < 3; ++k)
            moss::fitness(moss::preset_species()[k], {}, result.temperature, result.humidity,
                          ground.light, fitness, {});
    };

    // A rough slope 400 by 500 for the runoff.
    std::vector<Vec3d> position;
    std::vector<std::uint32_t> begin{0}, neighbour;
    for (int y = 0; y < 500; ++y)
        for (int x = 0; x < 400; ++x) {
            const auto i = position.size();
            position.emplace_back(0.02 * x, 0.02 * y,
                                  0.01 * y + 0.02 * uniform01(2, Stream("z"), i));
            for (int dy = -1; dy <= 1; ++dy)
                for (int dx = -1; dx <= 1; ++dx)
                    if ((dx || dy) && x + dx >= 0 && x + dx < 400 && y + dy >= 0 && y + dy < 500)
                        neighbour.push_back(static_cast<std::uint32_t>(x + dx + 400 * (y + dy)));
            begin.push_back(static_cast<std::uint32_t>(neighbour.size()));
        }
    const std::vector<float> up(kSites, 0.9F), area(kSites, 4e-4F);
    soil::Paths paths;
    soil::Runoff runoff;

    const std::vector<Case> cases = {
        {"one site at a time, exact (peer)",
         [&] {
             result.water.resize(kSites);
             const soil::Inputs in = ground.inputs(true);
             parallel_for(
                 kSites,
                 [&](std::size_t i) {
                     result.water[i] = soil::day({in.light[i], in.temperature[i], in.humidity[i],
                                                  in.rain[i], in.wind[i], in.sky_view[i],
                                                  in.cover[i], in.depth[i], in.water[i]},
                                                 in.air, in.soils[0], exact)
                                           .water;
                 },
                 4096);
         },
         [&] { return hash_of(result.water); }},
        {"exact, air per site", [&] { soil::run(ground.inputs(true), exact, result, {}); },
         [&] { return hash_of(result.water); }},
        {"exact, one air", [&] { soil::run(ground.inputs(false), exact, result, {}); },
         [&] { return hash_of(result.water); }},
        {"exact, air per site, 3 species",
         [&] {
             soil::run(ground.inputs(true), exact, result, {});
             species();
         },
         [&] { return hash_of(fitness); }},
        {"linear, one air", [&] { soil::run(ground.inputs(false), linear, result, {}); },
         [&] { return hash_of(result.water); }},
        {"linear, one air, 3 species",
         [&] {
             soil::run(ground.inputs(false), linear, result, {});
             species();
         },
         [&] { return hash_of(fitness); }},
        {"runoff paths",
         [&] {
             paths = soil::runoff_paths({position, up, area, begin, neighbour, {}}, {});
         },
         [&] { return hash_of(paths.share); }},
        {"runoff of a day",
         [&] { soil::route_rain(paths, area, ground.capacity, ground.water, ground.rain, runoff); },
         [&] { return hash_of(runoff.supply); }},
    };

    const std::vector<bench::Rounds> rounds = bench::in_turn(cases);
    for (std::size_t k = 0; k < rounds.size(); ++k) {
        const double seconds = median(rounds[k].seconds);
        fmt::print("{}, {}, {}, {:.4f} (best {:.4f}), {:.2f} M/s, {}\n", cases[k / 2].name, kSites,
                   k % 2 + 1, seconds, std::ranges::min(rounds[k].seconds), kSites / seconds / 1e6,
                   rounds[k].hash);
    }
}
