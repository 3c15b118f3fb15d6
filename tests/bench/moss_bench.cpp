// A day of moss on the cells of a rough slope: fitness of three species, germination, growth,
// death, seeds in flight, landings, cover. Three states: a few settlers, a half-grown population,
// and every cell bearing a ripe moss, the most work there can be. Prints: case, sites, threads,
// seconds, bytes a site, seeds thrown, hash.

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <string>
#include <vector>

#include "core/hash.h"
#include "core/parallel.h"
#include "core/random.h"
#include "grids/level_set.h"
#include "solvers/moss/landing.h"
#include "solvers/moss/population.h"
#include "tests/bench/measure.h"

namespace {

using namespace sekitei;
using bench::seconds_of;

struct Case {
    std::string name;
    moss::Population start;
};

}  // namespace

/// Arguments: width and depth in cells; 310 290.
int main(int argc, char** argv)
{
    const int width = argc > 2 ? std::atoi(argv[1]) : 310,
              depth = argc > 2 ? std::atoi(argv[2]) : 290;
    const Domain box{{width, depth, 40 + width / 6}, {{1, 2, 3}, 0.02}};
    const FloatGrid level_set = level_set_from_function(
        box,
        [](Vec3d p) {
            return 0.8 * (p.z - 25 - 0.12 * p.x - 3 * std::sin(p.x * 0.2) * std::cos(p.y * 0.17));
        },
        {}, {.steepness = 1.3, .is_distance = true});
    const SurfaceCells cells = surface_cells(level_set, {}, box);
    const moss::Surface surface = moss::surface_of(cells);
    const moss::CellLanding landing(level_set, cells);
    const std::size_t sites = cells.size();

    const std::vector<moss::Species> species(moss::preset_species().begin(),
                                             moss::preset_species().begin() + 3);
    const moss::Community community{species, {}, {}, 7};
    std::vector<float> temperature, humidity, light;
    for (std::size_t i = 0; i < sites; ++i) {
        auto draw = [&](const char* name) {
            return static_cast<float>(uniform01(1, Stream(name), i));
        };
        temperature.push_back(280 + 10 * draw("T"));
        humidity.push_back(0.85F + 0.15F * draw("rh"));
        light.push_back(10 + 60 * draw("S"));
    }
    std::vector<std::vector<float>> fitness(3, std::vector<float>(sites));
    auto evaluate = [&] {
        for (std::size_t k = 0; k < 3; ++k)
            moss::fitness(species[k], community.rules, temperature, humidity, light, fitness[k],
                          {});
    };
    auto live = [&](moss::Population& p) {
        return moss::day(p, community, surface, landing, {fitness, {}, {}}, {});
    };

    evaluate();
    moss::Population few = moss::first_settlers(community, surface), half = few, full = few;
    for (int d = 0; d < 60; ++d) live(half);
    for (std::size_t i = 0; i < sites; ++i) {
        full.species[i] = static_cast<std::uint8_t>(1 + i % 3);
        full.id[i] = full.next_id++;
        full.growth[i] = full.growth_max[i] = 3;
    }
    moss::Population resting = full;
    for (int d = 0; d < 20; ++d) live(resting);

    const std::vector<Case> cases = {{"few settlers", few},
                                     {"after 60 days", half},
                                     {"all ripe, no seed rests yet", full},
                                     {"all ripe", resting}};
    constexpr std::size_t kRounds = 5;
    const std::size_t bytes = sizeof(std::uint8_t) * 3 + 4 * 5 + 8 * 2;
    struct Row {
        std::vector<double> all, day;
        std::string hash;
        std::int64_t thrown = 0;
    };
    std::vector<Row> rows(2 * cases.size());
    for (std::size_t round = 0; round < kRounds; ++round)
        for (std::size_t c = 0; c < cases.size(); ++c)
            for (const std::size_t threads : {1u, 2u}) {
                const ThreadLimit limit(threads);
                Row& row = rows[2 * c + threads - 1];
                moss::Population p = cases[c].start;
                moss::DayStatistics s;
                const double g = seconds_of(evaluate);
                row.day.push_back(seconds_of([&] { s = live(p); }));
                row.all.push_back(g + row.day.back());
                row.hash = hash_hex(moss::encode({7, "", p, {}})).substr(0, 16);
                row.thrown = 0;
                for (const auto& k : s.species) row.thrown += k.gemmae + k.spores;
            }
    for (std::size_t k = 0; k < rows.size(); ++k) {
        Row& row = rows[k];
        std::ranges::sort(row.all);
        std::ranges::sort(row.day);
        fmt::print("{}, {}, {}, {:.5f} with fitness, {:.5f} without, {} bytes, {} thrown, {}\n",
                   cases[k / 2].name, sites, k % 2 + 1, row.all[kRounds / 2], row.day[kRounds / 2],
                   bytes, row.thrown, row.hash);
    }
}
