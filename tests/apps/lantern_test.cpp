// The lantern's experiments [Ogasawara2003, section 5] with three seeds, each of their ratios.

#include <gtest/gtest.h>

#include <cmath>

#include "apps/habitat.h"
#include "core/math.h"
#include "tests/apps/climate_scenes.h"

namespace sekitei::apps {
namespace {

using namespace apps::testing;

constexpr std::uint64_t kSeeds[] = {3, 11, 42};

/// What a year on one lantern comes to.
struct Year {
    wind::AirTables tables;
    double humidity_north = 0, fitness_shade = 0, fitness_shade_west = 0, fitness_low = 0,
           fitness_low_west = 0;
    /// At the year's end, by seed [m^2]: with 50 settlers of each species, and with 1000, of whom
    /// enough are near the limit of what they bear for small changes of the climate to show.
    double cover[2][3] = {}, cover_low[2][3] = {};
};

/// Runs a layout up to the moss once, and the moss with each seed.
Year year_of(const std::string& layout)
{
    Habitat habitat;
    Scene scene;
    run(scene, "lantern", {{"layout", layout}}, habitat.context());
    run(scene, "light", {{"weather", SEKITEI_DATA "/weather/morioka-normals.csv"}},
        habitat.context());
    run(scene, "wind", {{"per_layer", true}}, habitat.context());
    run(scene, "soil", {}, habitat.context());
    Year year;
    year.tables = tables_of(scene);
    for (std::size_t run_number = 0; run_number < 6; ++run_number) {
        const std::size_t k = run_number % 3, many = run_number / 3;
        Scene mossy = scene;
        run(mossy, "moss",
            {{"species", "bryum,hypnum,polytrichum"},
             {"growth_rate", 0.02},
             {"initial_count", many ? 1000 : 50}},
            habitat.context(kSeeds[k]));
        const auto &day = column(mossy, "day"), &from = column(mossy, "wind_direction");
        for (std::size_t r = 0; r < day.size(); ++r)
            if (day[r] == 365) {
                year.cover[many][k] += column(mossy, "cover")[r];
                year.cover_low[many][k] += column(mossy, "cover_low")[r];
            }
        if (run_number > 0) continue;  // a little moss changes the climate little
        double west = 0;
        const double n = double(day.size());
        for (std::size_t r = 0; r < day.size(); ++r) {
            year.humidity_north += column(mossy, "humidity_north")[r] / n;
            year.fitness_shade += column(mossy, "fitness_shade")[r] / n;
            year.fitness_low += column(mossy, "fitness_low")[r] / n;
            if (from[r] != 6) continue;
            ++west;
            year.fitness_shade_west += column(mossy, "fitness_shade")[r];
            year.fitness_low_west += column(mossy, "fitness_low")[r];
        }
        year.fitness_shade_west /= west;
        year.fitness_low_west /= west;
    }
    return year;
}

const Year& year(const std::string& layout)
{
    static std::map<std::string, Year> known;
    const auto found = known.find(layout);
    return found != known.end() ? found->second
                                : known.emplace(layout, year_of(layout)).first->second;
}

void print(const char* measure, double value)
{
    std::printf("    %-44s %.4f\n", measure, value);
}

void expect_cover(const char* what, const Year& year, const Year& open, double few, double many)
{
    for (int m = 0; m < 2; ++m) {
        double mean = 0, square = 0;
        for (int k = 0; k < 3; ++k) {
            const double ratio = year.cover[m][k] / open.cover[m][k];
            std::printf("    %s, %d settlers, cover, seed %d: %.4f m2 / %.4f m2 = %.3f\n", what,
                        m ? 1000 : 50, int(kSeeds[k]), year.cover[m][k], open.cover[m][k], ratio);
            EXPECT_GE(ratio, m ? many : few) << what << ", seed " << kSeeds[k];
            mean += ratio / 3;
            square += ratio * ratio / 3;
        }
        std::printf("    %s, cover ratio: mean %.3f, deviation between seeds %.3f\n", what, mean,
                    std::sqrt(std::max(0.0, square - mean * mean)));
    }
}

void fence_in_the_north_shelters_from_its_side()
{
    const Year &open = year("nothing"), &fence = year("fence");
    auto ratio = [&](int k) {
        return fence.tables.speed[std::size_t(k)] / open.tables.speed[std::size_t(k)];
    };
    const char* names[] = {"N", "NE", "E", "SE", "S", "SW", "W", "NW"};
    for (int k = 0; k < 8; ++k)
        print((std::string("A_U fence/none ") + names[k]).c_str(), ratio(k));
    EXPECT_LE(ratio(0), 0.45);
    EXPECT_LE(ratio(4), 0.85);
    for (const int k : {2, 6}) {
        EXPECT_GE(ratio(k), 0.85);
        EXPECT_LE(ratio(k), 1.15);
    }
}

void pond_in_the_west_gives_its_water_to_west_winds()
{
    const wind::AirTables& pond = year("pond").tables;
    print("A_T W", pond.temperature[6]);
    EXPECT_GE(pond.temperature[6], 1.5);
    EXPECT_LE(pond.temperature[6], 5);
    EXPECT_EQ(pond.temperature[2], 0);
    for (std::size_t k = 0; k < 8; ++k) {
        EXPECT_NEAR(pond.temperature[k], pond.humidity[k], 1e-6);
        EXPECT_EQ(year("nothing").tables.temperature[k], 0);
    }
}

void fence_makes_shady_cells_moister_and_mossier()
{
    const Year &open = year("nothing"), &fence = year("fence");
    print("rh_s of north cells, none", open.humidity_north);
    print("rh_s of north cells, fence", fence.humidity_north);
    print("G of shady cells, fence/none", fence.fitness_shade / open.fitness_shade);
    EXPECT_GT(fence.humidity_north, open.humidity_north);
    EXPECT_GE(fence.fitness_shade / open.fitness_shade, 1.05);
    expect_cover("fence", fence, open, 1.05, 1.05);
}

void pond_makes_shady_cells_moister_and_mossier()
{
    const Year &open = year("nothing"), &pond = year("pond");
    print("rh_s of north cells, pond", pond.humidity_north);
    print("G of shady cells, pond/none", pond.fitness_shade / open.fitness_shade);
    print("the same, west wind", pond.fitness_shade_west / open.fitness_shade_west);
    EXPECT_GT(pond.humidity_north, open.humidity_north);
    EXPECT_GE(pond.fitness_shade / open.fitness_shade, 1.01);
    EXPECT_GE(pond.fitness_shade_west / open.fitness_shade_west, 1.04);
    // Of 50 settlers some two dozen live, the same ones with the pond.
    expect_cover("pond", pond, open, 1, 1.01);
}

void pond_gives_most_to_the_lowest_half_metre()
{
    const Year &open = year("nothing"), &pond = year("pond");
    ASSERT_FALSE(pond.tables.layers.empty());
    for (std::size_t k = 0; k < pond.tables.layers.size(); ++k)
        print(("A_T W, layer " + std::to_string(k)).c_str(), pond.tables.layers[k][6]);
    print("G of low shady cells, pond/none", pond.fitness_low / open.fitness_low);
    print("the same, west wind", pond.fitness_low_west / open.fitness_low_west);
    EXPECT_GE(pond.fitness_low / open.fitness_low, 1.05);
    EXPECT_GE(pond.fitness_low_west / open.fitness_low_west, 1.15);
    // More cover low than high: in ratio to the lantern alone.
    for (int k = 0; k < 3; ++k) {
        const double low = pond.cover_low[1][k] / open.cover_low[1][k];
        const double high =
            (pond.cover[1][k] - pond.cover_low[1][k]) / (open.cover[1][k] - open.cover_low[1][k]);
        std::printf("    pond/none cover, seed %d: low %.3f, high %.3f\n", int(kSeeds[k]), low,
                    high);
        EXPECT_GT(low, high) << kSeeds[k];
    }
}

void a_fence_in_the_south_shelters_and_shades()
{
    const Year &open = year("nothing"), &fence = year("south_fence");
    print("A_U fence/none S", fence.tables.speed[4] / open.tables.speed[4]);
    print("A_U fence/none N", fence.tables.speed[0] / open.tables.speed[0]);
    print("rh_s of north cells, south fence", fence.humidity_north);
    print("G of shady cells, south fence/none", fence.fitness_shade / open.fitness_shade);
    EXPECT_LE(fence.tables.speed[4] / open.tables.speed[4], 0.45);
    EXPECT_LE(fence.tables.speed[0] / open.tables.speed[0], 0.85);
    // What shade adds counts for more than the shelter, and not by the air's humidity.
    EXPECT_GE(fence.fitness_shade / open.fitness_shade, 1.05);
    expect_cover("south fence", fence, open, 1.05, 1.05);
}

// One test, since all of it shares four winds and twelve years.
TEST(LanternExperiments, EveryRatioIsWithinItsBound)
{
    fence_in_the_north_shelters_from_its_side();
    pond_in_the_west_gives_its_water_to_west_winds();
    fence_makes_shady_cells_moister_and_mossier();
    pond_makes_shady_cells_moister_and_mossier();
    pond_gives_most_to_the_lowest_half_metre();
    a_fence_in_the_south_shelters_and_shades();
}

}  // namespace
}  // namespace sekitei::apps
