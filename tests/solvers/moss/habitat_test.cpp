#include <gtest/gtest.h>

#include <cmath>

#include "solvers/soil/soil.h"
#include "tests/solvers/moss/sites.h"

// Soil and moss together, as a garden would show it.
namespace sekitei::moss {
namespace {

const std::vector<Species> kThree{kind("bryum"), kind("hypnum"), kind("polytrichum")};

/// Mean cover and the number of living of each species on a moist lawn after some days of light S
/// [W/m^2] and rain every other day or so; wet = false: no rain on dry rock, and air too dry for
/// dew (which is enough for moss in humid air).
struct Lawn {
    double cover = 0;
    std::vector<double> living;
};

Lawn lawn(double light, int days, bool wet = true, double temperature = 288.15)
{
    const Sheet sheet(40, 36, 0.02);
    const std::size_t n = sheet.size();
    const Community community{kThree, {}, {}, 12};
    Population p = first_settlers(community, sheet.surface());
    soil::Result ground;
    ground.water.assign(n, wet ? 73.5 : 0);
    std::vector<std::vector<float>> g(3, std::vector<float>(n));
    const std::vector<float> s(n, static_cast<float>(light));
    for (int d = 1; d <= days; ++d) {
        const bool rain = wet && std::floor(180 * d / 365.) > std::floor(180 * (d - 1) / 365.);
        const std::vector<double> water = ground.water;
        soil::run({.water = water,
                   .light = s,
                   .temperature = static_cast<float>(temperature),
                   .humidity = wet ? 0.73F : 0.4F,
                   .rain = rain ? 10.34 : 0,
                   .wind = 0.2F,
                   .sky_view = 0.5F,
                   .cover = p.cover,
                   .depth = wet ? 300.F : 20.F,
                   .soil = {},
                   .soils = std::span(soil::preset_soils()).subspan(wet ? 0 : 2, 1),
                   .air = {0.75, 1013, {}}},
                  {}, ground, {});
        for (std::size_t k = 0; k < 3; ++k)
            fitness(kThree[k], community.rules, ground.temperature, ground.humidity, s, g[k], {});
        day(p, community, sheet.surface(), SheetLanding(sheet), {g, {}, {}}, {});
    }
    Lawn result;
    for (const float c : p.cover) result.cover += double(c) / static_cast<double>(n);
    for (const SpeciesDay& k : count(p, community, sheet.surface()).species)
        result.living.push_back(static_cast<double>(k.living));
    return result;
}

TEST(MossHabitat, FullSunKeepsALawnBareAndAShadeClothTurnsItGreen)
{
    EXPECT_EQ(lawn(150, 120).cover, 0);
    EXPECT_GT(lawn(15, 120).cover, 0.3);
}

TEST(MossHabitat, CoverAgainstLightHasOneMaximumWithinTheSpeciesRange)
{
    std::vector<double> cover;
    for (const double light : {0.0, 1.0, 5.0, 15.0, 30.0, 60.0, 90.0, 120.0, 150.0})
        cover.push_back(lawn(light, 45).cover);
    const auto top = static_cast<std::size_t>(std::ranges::max_element(cover) - cover.begin());
    EXPECT_GE(top, 2u);
    EXPECT_LE(top, 5u);
    for (std::size_t k = 1; k < cover.size(); ++k)
        EXPECT_TRUE(k <= top ? cover[k] >= cover[k - 1] : cover[k] <= cover[k - 1]) << k;
    EXPECT_EQ(cover.front(), 0);
    EXPECT_EQ(cover.back(), 0);
}

TEST(MossHabitat, WithoutLightWaterOrWarmthThereIsNoMoss)
{
    EXPECT_EQ(lawn(0, 60).cover, 0);
    EXPECT_EQ(lawn(15, 60, false).cover, 0);
    EXPECT_EQ(lawn(15, 60, true, 250).cover, 0);
    EXPECT_EQ(lawn(15, 60, true, 330).cover, 0);
    EXPECT_GT(lawn(15, 60).cover, 0.3);
}

}  // namespace
}  // namespace sekitei::moss
