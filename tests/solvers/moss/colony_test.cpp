#include "solvers/moss/colony.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <map>
#include <numeric>
#include <set>

#include "core/error.h"
#include "core/parallel.h"
#include "core/point_search.h"
#include "tests/solvers/moss/land.h"

namespace sekitei::moss {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

const Rules kPaper{.light_gate = false};
const std::vector<Species> kThree{species_called("bryum"), species_called("hypnum"),
                                  species_called("polytrichum")};
const ColonyParams kParams;

/// Nothing comes from outside, and no seed meets anything.
constexpr Propagation kAlone{.spore_throw = 50, .external_interval = 0};

/// G of all plants and seeds.
struct Everywhere {
    std::vector<float> plants, seeds;
    Everywhere(const Colony& colony, float g)
        : plants(colony.plants.size(), g), seeds(colony.seeds.size(), g)
    {
    }
    ColonyConditions conditions() const { return {plants, seeds, {}, {}}; }
};

DayStatistics live(Colony& colony, const Community& community, const Land& land, float g,
                   const ColonyParams& params = kParams)
{
    const Everywhere at(colony, g);
    return day(colony, community, params, land.surface, at.conditions(), {});
}

/// Good and bad places that change from day to day.
DayStatistics live_in_patches(Colony& colony, const Community& community, const Land& land,
                              const ColonyParams& params = kParams)
{
    auto g = [&](Vec3f p, std::uint8_t k) {
        const double wave = std::sin(double(p.x) * 17 + k) * std::cos(double(p.y) * 15 - k);
        return static_cast<float>(
            std::clamp(0.55 + 1.2 * wave * std::cos(colony.day * 0.1), 0.0, 1.0));
    };
    Everywhere at(colony, 0);
    for (std::size_t i = 0; i < at.plants.size(); ++i)
        at.plants[i] = g(colony.plants.foot[i], colony.plants.species[i]);
    for (std::size_t i = 0; i < at.seeds.size(); ++i)
        at.seeds[i] = g(colony.seeds.foot[i], colony.seeds.species[i]);
    return day(colony, community, params, land.surface, at.conditions(), {});
}

/// A dish far below which nothing catches seeds.
const Land& dish()
{
    static const Land land(floor_mesh(0.1, 0.1), 0.05);
    return land;
}

// Life --------------------------------------------------------------------------------------------

TEST(Colony, ALifeInGoodConditionsShedsGemmaeThenSpores)
{
    const Community community{std::span(kThree).first(1), kPaper, kAlone, 5};
    Colony colony;
    sow(colony, {0.05, 0.05, 0.7}, Seed::Gemma);
    std::int64_t gemmae = 0, spores = 0;
    int first_gemma = 0, first_spore = 0;
    for (int d = 1; d <= 12; ++d) {
        // Seeds that came down rest on poor ground.
        Everywhere at(colony, 0.8F);
        if (d > 1) std::ranges::fill(at.seeds, 0.0F);
        const SpeciesDay s =
            day(colony, community, kParams, dish().surface, at.conditions(), {}).species[0];
        EXPECT_EQ(s.germinated, d == 1);
        ASSERT_EQ(s.living, 1);
        if (s.gemmae && !gemmae) first_gemma = d;
        if (s.spores && !spores) first_spore = d;
        gemmae += s.gemmae, spores += s.spores;
    }
    EXPECT_EQ(first_gemma, 3);
    EXPECT_EQ(first_spore, 10);
    EXPECT_EQ(gemmae, 5);
    EXPECT_EQ(spores, 3);
    EXPECT_NEAR(colony.plants.growth[0], 2.52, 1e-6);
    EXPECT_EQ(colony.plants.born[0], 1);
    EXPECT_EQ(colony.plants.landed[0], 0);
    EXPECT_EQ(colony.plants.id[0], 1u);
}

TEST(Colony, ALifeThatLosesItsPlaceShrinksAndDies)
{
    const Community community{std::span(kThree).subspan(1, 1), kPaper, kAlone, 5};
    Colony colony;
    sow(colony, {0.05, 0.05, 0.7}, Seed::Gemma);
    float most = 0;
    std::int64_t gemmae = 0;
    int died = 0;
    for (int d = 1; d <= 60 && !died; ++d) {
        Everywhere at(colony, d <= 6 ? 0.87F : 0.0F);
        if (d > 1) std::ranges::fill(at.seeds, 0.0F);
        const SpeciesDay s =
            day(colony, community, kParams, dish().surface, at.conditions(), {}).species[0];
        gemmae += s.gemmae;
        if (s.died) died = d;
        if (colony.plants.size()) most = std::max(most, colony.plants.growth[0]);
    }
    EXPECT_NEAR(most, 1.155, 1e-3);
    EXPECT_EQ(gemmae, 2);
    EXPECT_EQ(died, 47);
    EXPECT_EQ(colony.plants.size(), 0u);
}

TEST(Colony, AMossThatRegrowsDoesNotRepeatItsGemmae)
{
    const Community community{std::span(kThree).first(1), kPaper, kAlone, 5};
    Colony colony;
    plant(colony, {0.05, 0.05, 0.7}, 0.9);
    auto gemmae_over = [&](float g, int days) {
        std::int64_t n = 0;
        for (int d = 0; d < days; ++d) {
            Everywhere at(colony, g);
            std::ranges::fill(at.seeds, 0.0F);
            n += day(colony, community, kParams, dish().surface, at.conditions(), {})
                     .species[0]
                     .gemmae;
        }
        return n;
    };
    EXPECT_EQ(gemmae_over(0.8F, 1), 1);  // 1.11
    EXPECT_EQ(gemmae_over(0, 6), 0);     // 0.93
    EXPECT_EQ(gemmae_over(0.8F, 2), 0);  // 1.35
    EXPECT_EQ(gemmae_over(0.8F, 1), 1);  // 1.56
}

TEST(Colony, SeedsGerminateInTheirWindowAndThenGo)
{
    const Community community{std::span(kThree).first(1), kPaper, kAlone, 5};
    for (const auto& [kind, first, last] :
         {std::tuple{Seed::Gemma, 1, 68}, {Seed::Spore, 38, 387}}) {
        // Perfect from the start; perfect on the last day only; on the day after.
        for (const int good_from : {1, last, last + 1}) {
            Colony colony;
            sow(colony, {0.05, 0.05, 0.7}, kind);
            int germinated = 0, expired = 0;
            for (int d = 1; d <= last + 3 && !germinated && !expired; ++d) {
                const SpeciesDay s =
                    live(colony, community, dish(), d >= good_from ? 1.0F : 0.0F).species[0];
                if (s.germinated) germinated = d;
                if (s.expired) expired = d;
            }
            EXPECT_EQ(germinated, good_from > last ? 0 : std::max(first, good_from));
            EXPECT_EQ(expired, good_from > last ? last + 1 : 0);
        }
    }
}

TEST(Colony, LightThatASeedKnowsIsItsPlants)
{
    const Community community{std::span(kThree).first(1), kPaper, kAlone, 5};
    Colony colony;
    sow(colony, {0.05, 0.05, 0.7}, Seed::Gemma);
    colony.seeds.light[0] = 31;
    colony.seeds.light_area[0] = 0.02F;
    live(colony, community, dish(), 1);
    EXPECT_EQ(colony.plants.light[0], 31);
    EXPECT_EQ(colony.plants.light_area[0], 0.02F);
    EXPECT_EQ(colony.seeds.size(), 0u);
}

TEST(Colony, FitnessIsThatOfTheOwnLightAndTheSitesAir)
{
    const Community community{kThree, {}, {}, 5};
    Colony colony;
    std::vector<float> temperature, humidity;
    for (std::uint32_t i = 0; i < 60; ++i) {
        plant(colony, {0, 0, 0}, 1, {0, 0, 1}, static_cast<std::uint8_t>(i % 3), (i * 7) % 60);
        colony.plants.light[i] = static_cast<float>(2 * i);
        temperature.push_back(275 + 0.3F * static_cast<float>(i));
        humidity.push_back(0.7F + 0.005F * static_cast<float>(i));
    }
    const auto g = fitness(colony.plants, community, temperature, humidity, {});
    for (std::uint32_t i = 0; i < 60; ++i) {
        const std::size_t site = (i * 7) % 60;
        EXPECT_NEAR(g[i],
                    fitness(kThree[i % 3], community.rules, double(temperature[site]),
                            double(humidity[site]), 2.0 * i)
                        .total(),
                    1e-6);
    }
    humidity.resize(50);
    EXPECT_THAT([&] { fitness(colony.plants, community, temperature, humidity, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("humidity of 50")));
}

TEST(Colony, SporesAreAsManyADayAsAskedAndFlyApart)
{
    const Land land(floor_mesh(2, 2), 0.5);
    const Community community{std::span(kThree).first(1), kPaper, {.external_interval = 0}, 5};
    Colony colony;
    plant(colony, {1, 1, 0.7}, 4.1);
    const SpeciesDay s = live(colony, community, land, 0.8F, {.spores_per_day = 5}).species[0];
    EXPECT_EQ(s.spores, 5);
    EXPECT_EQ(s.settled + s.collided, 5);
    EXPECT_GE(s.settled, 4);
    for (const std::uint8_t k : colony.seeds.kind) EXPECT_EQ(k, kSpore);
}

TEST(Colony, SporesDriftWithTheWindOfTheirSite)
{
    const Land land(floor_mesh(20, 20), 4);
    const Community community{
        std::span(kThree).first(1), kPaper, {.spore_wind = true, .external_interval = 0}, 5};
    Colony colony;
    std::vector<float> wind(land.sites.size(), 0.0F);
    for (int i = 0; i < 40; ++i)
        plant(colony, {1 + 0.1 * i, 10, 0.7}, 4.1, {0, 0, 1}, 0,
              land.surface.closest({1 + 0.1 * i, 10, 0.7}, 0.01)->site);
    for (const std::uint32_t site : colony.plants.site) wind[site] = 0.4F;
    const Everywhere at(colony, 0.8F);
    const SpeciesDay s =
        day(colony, community, kParams, land.surface, {at.plants, at.seeds, wind, {0, 1, 0}}, {})
            .species[0];
    EXPECT_EQ(s.settled, 40);
    // From a height of 0.21 to 0.30 m, at 0.02 m/s against 0.4 m/s.
    double mean = 0;
    for (const Vec3f& p : colony.seeds.foot) {
        EXPECT_GT(p.y, 10 + 20 * 0.212 - 0.22);
        EXPECT_LT(p.y, 10 + 20 * 0.3 + 0.22);
        mean += double(p.y) / 40;
    }
    EXPECT_NEAR(mean, 10 + 20 * 0.3 * 0.853553, 0.3);
}

// Room --------------------------------------------------------------------------------------------

TEST(Colony, OfAHexagonalPatchAllButTheRimIsInterior)
{
    for (const int rings : {1, 2, 5}) {
        // On the floor, and on a slope.
        for (const Vec3d normal : {Vec3d(0, 0, 1), normalized(Vec3d(0.4, -0.7, 0.2))}) {
            Colony colony;
            for (const Vec3d& p : hexagon(rings, kParams.size, {}))
                plant(colony, about(normal, p) + Vec3d(3, 1, 2), 2, normal);
            const auto inner = interior(colony.plants, kParams);
            EXPECT_EQ(inner.size(), static_cast<std::size_t>(3 * rings * (rings + 1) + 1));
            EXPECT_EQ(std::accumulate(inner.begin(), inner.end(), 0), 3 * rings * (rings - 1) + 1);
            for (std::size_t i = 0; i < inner.size(); ++i)
                if (length(Vec3d(colony.plants.foot[i]) - Vec3d(3, 1, 2)) <
                    kParams.size * (rings - 0.99)) {
                    EXPECT_TRUE(inner[i]);
                }
        }
    }
}

TEST(Colony, FiveAroundEncloseUnlessTheyLeaveAGap)
{
    auto enclosed = [](std::vector<double> degrees, double distance = 0.012) {
        Colony colony;
        plant(colony, {0, 0, 0}, 1);
        for (const double a : degrees)
            plant(colony,
                  Vec3d(std::cos(a * math::kPi / 180), std::sin(a * math::kPi / 180), 0) * distance,
                  1);
        return interior(colony.plants, kParams)[0] == 1;
    };
    EXPECT_TRUE(enclosed({10, 82, 154, 226, 298}));
    EXPECT_FALSE(enclosed({0, 90, 180, 270}));                // four
    EXPECT_TRUE(enclosed({0, 119, 150, 180, 241}));           // gaps of 119
    EXPECT_FALSE(enclosed({0, 121, 150, 180, 241}));          // one of 121
    EXPECT_FALSE(enclosed({0, 30, 60, 90, 120, 150, 170}));   // one of 190
    EXPECT_FALSE(enclosed({0, 20, 40, 60, 80, 100}));         // one of 260
    EXPECT_FALSE(enclosed({10, 82, 154, 226, 298}, 0.0131));  // too far
}

TEST(Colony, TheInteriorMakesNoGemmaeButSpores)
{
    const Community community{std::span(kThree).first(1), kPaper, kAlone, 5};
    Colony colony;
    for (const Vec3d& p : hexagon(5, kParams.size, {0.05, 0.05, 0.7})) plant(colony, p, 2.4);
    const SpeciesDay s = live(colony, community, dish(), 0.8F).species[0];  // 2.61
    EXPECT_EQ(s.gemmae, 91 - 61);
    EXPECT_EQ(s.spores, 91);
    for (const float high : colony.plants.growth_max) EXPECT_GT(high, 2.6);
}

TEST(Colony, CoverIsTheShareOfTheDensestPacking)
{
    const Land land(floor_mesh(0.4, 0.4), 0.004);
    const auto capacity = cover_capacity(kParams, land.sites);
    std::size_t middle = 0, corner = 0;
    for (std::size_t i = 0; i < land.sites.size(); ++i) {
        const Vec3d p(land.sites.position[i]);
        if (length(p - Vec3d(0.2, 0.2, 0.7)) <
            length(Vec3d(land.sites.position[middle]) - Vec3d(0.2, 0.2, 0.7)))
            middle = i;
        if (length(p - Vec3d(0, 0, 0.7)) <
            length(Vec3d(land.sites.position[corner]) - Vec3d(0, 0, 0.7)))
            corner = i;
    }
    EXPECT_NEAR(capacity[middle], 22.67, 0.5);
    EXPECT_NEAR(capacity[corner], 22.67 / 4, 1);
    Colony colony;
    for (const Vec3d& p : hexagon(3, 0.02, {0.2, 0.2, 0.7})) plant(colony, p, 1);
    plant(colony, {0.2, 0.2, 0.695}, 1, {0, 0, -1});  // of the other side
    const auto c = cover(colony.plants, kParams, land.sites, capacity);
    EXPECT_NEAR(c[middle], 7 / 22.67, 0.01);  // itself and six around
    EXPECT_EQ(c[corner], 0);
    // Packed beyond measure.
    for (const Vec3d& p : hexagon(8, 0.005, {0.2, 0.2, 0.7})) plant(colony, p, 1);
    EXPECT_EQ(cover(colony.plants, kParams, land.sites, capacity)[middle], 1);
}

TEST(Colony, OnTheBoxsEdgeEachFaceCountsItsOwn)
{
    const Land land(shapes::box({0, 0, 0}, {0.2, 0.2, 0.2}), 0.005);
    const auto capacity = cover_capacity(kParams, land.sites);
    Colony colony;
    for (int k = 0; k < 40; ++k) {
        plant(colony, {0.198, 0.005 + 0.005 * k, 0.2}, 1, {0, 0, 1});
        plant(colony, {0.2, 0.005 + 0.005 * k, 0.198}, 1, {1, 0, 0}, 1);
    }
    const auto c = cover(colony.plants, kParams, land.sites, capacity);
    int rim = 0;
    for (std::size_t i = 0; i < land.sites.size(); ++i) {
        const Vec3f p = land.sites.position[i], n = land.sites.normal[i];
        if (p.y < 0.05F || p.y > 0.15F || std::max(n.x, n.z) < 0.5F) continue;
        int feet = 0;
        for (std::size_t k = 0; k < colony.plants.size(); ++k)
            feet += colony.plants.normal[k] == n &&
                    squared_distance(p, colony.plants.foot[k]) <= 0.025F * 0.025F;
        EXPECT_FLOAT_EQ(c[i], std::min(1.0F, static_cast<float>(feet) / capacity[i]));
        if (std::min(p.x, p.z) < 0.197F) continue;
        ++rim;
        EXPECT_NEAR(capacity[i], 22.67 / 2, 2.5);
        EXPECT_NEAR(feet, 10, 1);
    }
    EXPECT_GT(rim, 50);
}

TEST(Colony, BallsRestOnTheirFeetAlongTheirAxis)
{
    Colony colony;
    plant(colony, {1, 2, 3}, 2);
    plant(colony, {1, 2, 3}, 5);
    plant(colony, {1, 2, 3}, 0.5, {1, 0, 0});
    plant(colony, {1, 2, 3}, 2, {0, 0, -1});
    const auto balls = spheres(colony.plants, kParams);
    EXPECT_EQ(balls[0].radius, 0.005F);
    EXPECT_EQ(balls[0].centre, Vec3f(1, 2, 3.005F));
    EXPECT_EQ(balls[1].radius, 0.005F);
    EXPECT_EQ(balls[2].radius, 0.0025F);
    const double half = 0.0025 * std::sqrt(0.5);
    EXPECT_LT(length(Vec3d(balls[2].centre) - Vec3d(1 + half, 2, 3 + half)), 1e-6);
    EXPECT_LT(length(Vec3d(balls[3].centre) - Vec3d(1, 2, 2.995)), 1e-6);
}

// Settling ----------------------------------------------------------------------------------------

TEST(Colony, FirstSettlersAreAsManyAsAskedUniformOnTheLand)
{
    const Land land(shapes::box({0, 0, 0}, {2, 1, 0.5}), 0.3);
    const Community community{kThree, {}, {.initial_count = 2000}, 31};
    const Colony colony = first_settlers(community, kParams, land.sites);
    ASSERT_EQ(colony.plants.size(), 6000u);
    EXPECT_EQ(colony.next_id, 6001u);
    const DayStatistics s = count(colony, community, kParams);
    std::map<std::string, int> faces;
    double x = 0, xx = 0, within = 0;
    for (std::size_t i = 0; i < colony.plants.size(); ++i) {
        const Vec3f p = colony.plants.foot[i], n = colony.plants.normal[i];
        ++faces[n.z > 0 ? "top" : n.z < 0 ? "bottom" : n.x ? "x" : "y"];
        EXPECT_EQ(n, land.sites.normal[colony.plants.site[i]]);
        const auto on = land.surface.closest(Vec3d(p), 1e-6);
        ASSERT_TRUE(on);
        if (n.z > 0) x += double(p.x), xx += double(p.x * p.x), ++within;
        EXPECT_EQ(colony.plants.growth[i], 0.2F);
        EXPECT_EQ(colony.plants.host[i], 0u);
    }
    const double area = 2 * (2 * 1 + 2 * 0.5 + 1 * 0.5);
    for (const auto& [face, share] :
         {std::pair{"top", 2 / area}, {"bottom", 2 / area}, {"x", 1 / area}, {"y", 2 / area}})
        EXPECT_NEAR(faces[face], 6000 * share, 3 * std::sqrt(6000 * share * (1 - share))) << face;
    EXPECT_NEAR(x / within, 1, 3 * std::sqrt(4.0 / 12 / within));
    EXPECT_NEAR(xx / within, 4.0 / 3, 0.1);
    for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(s.species[k].living, 2000);
    for (std::size_t i = 0; i < 6000; ++i)
        for (std::size_t j = 0; j < i; ++j)
            ASSERT_GE(length(colony.plants.foot[i] - colony.plants.foot[j]), 0.0049999F);
}

TEST(Colony, WithinALargeTriangleSettlersAreUniformToo)
{
    MeshSites one = mesh_sites(floor_mesh(2, 1), 3, {});
    ASSERT_EQ(one.size(), 2u);
    one.area[1] = 0;  // leaves the triangle (0, 0), (2, 0), (2, 1)
    const Community community{std::span(kThree).first(1), {}, {.initial_count = 4000}, 34};
    const Colony colony = first_settlers(community, {.size = 1e-4}, one);
    ASSERT_EQ(colony.plants.size(), 4000u);
    double x = 0, y = 0, xy = 0;
    for (const Vec3f& p : colony.plants.foot) {
        EXPECT_LE(p.y, p.x / 2 + 1e-6F);
        x += double(p.x) / 4000, y += double(p.y) / 4000, xy += double(p.x * p.y) / 4000;
    }
    EXPECT_NEAR(x, 4.0 / 3, 3 * std::sqrt(4.0 / 18 / 4000));
    EXPECT_NEAR(y, 1.0 / 3, 3 * std::sqrt(1.0 / 18 / 4000));
    EXPECT_NEAR(xy, 0.5, 0.02);
}

TEST(Colony, FirstSettlersAreFewerWhereThereIsNoRoomOrACap)
{
    const Community community{kThree, {}, {.initial_count = 2000}, 31};
    const Land small(floor_mesh(0.05, 0.05), 0.05);
    const Colony crowded = first_settlers(community, kParams, small.sites);
    EXPECT_GT(crowded.plants.size(), 60u);
    EXPECT_LT(crowded.plants.size(), 145u);  // discs of 5 mm, randomly packed, with a rim
    const Land large(floor_mesh(2, 2), 0.5);
    const Colony capped = first_settlers(community, {.cap = 100}, large.sites);
    EXPECT_EQ(capped.plants.size(), 100u);
    const DayStatistics s = count(capped, community, kParams);
    EXPECT_EQ(s.species[0].living, 34);
    EXPECT_EQ(s.species[1].living, 33);
}

TEST(Colony, ASporeFromOutsideComesEveryTenDaysOfEachSpeciesInTurn)
{
    const Land land(floor_mesh(2, 2), 0.5);
    const Community community{kThree, kPaper, {}, 32};
    Colony colony;
    for (int d = 1; d <= 60; ++d) {
        const DayStatistics s = live(colony, community, land, 0);
        for (std::size_t k = 0; k < 3; ++k)
            EXPECT_EQ(s.species[k].arrived,
                      d % 10 == 0 && static_cast<std::size_t>(d / 10 - 1) % 3 == k);
    }
    ASSERT_EQ(colony.seeds.size(), 6u);
    EXPECT_EQ(colony.arrivals, 6u);
    for (std::size_t i = 0; i < 6; ++i) {
        EXPECT_EQ(colony.seeds.species[i], i % 3);
        EXPECT_EQ(colony.seeds.kind[i], kSpore);
        EXPECT_EQ(colony.seeds.landed[i], static_cast<int>(10 * (i + 1)));
        EXPECT_EQ(colony.seeds.id[i], i + 1);
    }
}

/// Everybody of a colony, for an exhaustive search.
struct Somebody {
    Vec3f foot;
    std::uint8_t species;
    double growth;
    bool plant, here;
    std::uint64_t id;
};

TEST(Colony, CollisionsAreThoseOfAnExhaustiveSearchInTheOrderOfIds)
{
    const Land land(floor_mesh(0.6, 0.6), 0.1);
    std::vector<Species> species = kThree;
    species[1].priority = 1.5;  // beats bryum below 1.5 and all its seeds
    species[2].priority = 3.5;
    const Propagation propagation{.spore_throw = 0.1, .external_interval = 1};
    const Community community{species, kPaper, propagation, 33};
    Colony colony;
    // Ripe mosses that stand in an order that is not that of their ids.
    for (int i = 0; i < 400; ++i)
        plant(colony, Vec3d(0.03 * (i % 20) + 0.015, 0.03 * (i / 20) + 0.015, 0.7), 0.5 + i % 3,
              {0, 0, 1}, static_cast<std::uint8_t>(i % 3));
    for (std::size_t i = 0; i < 400; ++i) colony.plants.id[i] = 1 + (i * 149) % 400;
    for (int i = 0; i < 400; ++i)
        sow(colony, Vec3d(0.03 * (i % 20) + 0.004, 0.03 * (i / 20) + 0.003, 0.7), Seed::Spore,
            static_cast<std::uint8_t>((i / 3) % 3));
    const Colony before = colony;
    const DayStatistics s = live(colony, community, land, 0.9F, {.spores_per_day = 3});

    // Those that were there, grown.
    std::vector<Somebody> all;
    for (std::size_t i = 0; i < 400; ++i) {
        float growth = before.plants.growth[i], most = growth;
        live_a_day(species[before.plants.species[i]], kPaper, double(0.9F), growth, most);
        all.push_back({before.plants.foot[i], before.plants.species[i], growth, true, true,
                       before.plants.id[i]});
    }
    for (std::size_t i = 0; i < 400; ++i)
        all.push_back(
            {before.seeds.foot[i], before.seeds.species[i], 0, false, true, before.seeds.id[i]});
    Colony grown = before;
    for (std::size_t i = 0; i < 400; ++i)
        grown.plants.growth[i] = static_cast<float>(all[i].growth);

    // Their seeds, gemmae first, then by the parent's id.
    std::map<std::tuple<int, std::uint64_t, int>, std::pair<Flight, std::uint8_t>> thrown;
    for (std::size_t i = 0; i < 400; ++i) {
        const Parent parent{before.plants.id[i], 1, Vec3d(before.plants.foot[i]),
                            Vec3d(before.plants.normal[i])};
        float growth = before.plants.growth[i], most = growth;
        const std::uint8_t k = before.plants.species[i];
        const DayOfLife today = live_a_day(species[k], kPaper, double(0.9F), growth, most);
        for (int n = 0; n < today.gemmae; ++n)
            thrown[{1, parent.id, n}] = {
                throw_gemma(community, parent, 0.015, static_cast<std::uint64_t>(n)), k};
        for (int n = 0; today.spore && n < 3; ++n)
            thrown[{2, parent.id, n}] = {
                throw_spore(community, parent, static_cast<std::uint64_t>(n), 0, {}), k};
    }
    std::int64_t displaced = 0, replaced = 0, collided = 0, settled = 0;
    std::uint64_t next_id = before.next_id;
    auto settle = [&](const Landed& at, std::uint8_t k) {
        if (at.where != Landed::Where::Land && at.where != Landed::Where::Moss) return;
        std::vector<Somebody*> close;
        for (Somebody& other : all)
            if (other.here && squared_distance(other.foot, at.foot) < 0.005F * 0.005F)
                close.push_back(&other);
        for (const Somebody* other : close)
            if (species[other->species].priority + other->growth >= species[k].priority) {
                ++collided;
                return;
            }
        for (Somebody* other : close) {
            other->here = false;
            ++(other->plant ? displaced : replaced);
        }
        ++settled;
        all.push_back({at.foot, k, 0, false, true, next_id++});
    };
    for (const auto& [name, seed] : thrown)
        settle(
            moss::land(std::span(&seed.first, 1), grown.plants, kParams, land.surface, 0.0075)[0],
            seed.second);
    // The one from outside is drawn where the colony drew it.
    if (colony.seeds.id.back() == next_id) {
        Landed arrived{.where = Landed::Where::Land, .foot = colony.seeds.foot.back()};
        settle(arrived, 0);
    }

    SpeciesDay sum;
    for (const SpeciesDay& k : s.species) add(sum, k);
    EXPECT_EQ(sum.displaced, displaced);
    EXPECT_EQ(sum.replaced, replaced);
    EXPECT_EQ(sum.settled, settled);
    EXPECT_GE(sum.collided, collided);
    EXPECT_LE(sum.collided, collided + 1);
    EXPECT_GT(displaced, 3);
    EXPECT_GT(replaced, 10);
    EXPECT_GT(collided, 20);
    std::vector<std::uint64_t> plants, seeds;
    for (const Somebody& one : all)
        if (one.here) (one.plant ? plants : seeds).push_back(one.id);
    EXPECT_EQ(colony.plants.id, plants);
    EXPECT_EQ(colony.seeds.id, seeds);
    EXPECT_TRUE(std::ranges::is_sorted(colony.seeds.id));
}

TEST(Colony, ASeedNeverDisplacesAPlantOfEqualPriorityAndGivesWayToTheOlderSeed)
{
    const Community community{kThree, kPaper, kAlone, 5};
    const Land land(floor_mesh(0.1, 0.1), 0.05);
    Colony colony;
    for (const Vec3d& p : hexagon(8, 0.0049, {0.05, 0.05, 0.7})) plant(colony, p, 0.49);
    const SpeciesDay s = live(colony, community, land, 0.8F).species[0];
    EXPECT_GT(s.gemmae, 10);
    EXPECT_EQ(s.displaced, 0);
    EXPECT_EQ(s.replaced, 0);
    EXPECT_GT(s.collided, 5);
}

TEST(Colony, BeyondTheCapGerminationIsRefusedInTheOrderOfIds)
{
    const Community community{kThree, kPaper, kAlone, 5};
    Colony colony;
    for (int i = 0; i < 10; ++i) plant(colony, {0.05 + 0.001 * i, 0.02, 0.7}, 1);
    for (int i = 0; i < 10; ++i) sow(colony, {0.05 + 0.001 * i, 0.06, 0.7}, Seed::Gemma);
    Everywhere at(colony, 0.9F);
    std::ranges::fill(at.plants, 0.12F);  // grow a little, shed nothing
    at.seeds[2] = 0;
    const SpeciesDay s =
        day(colony, community, {.cap = 14}, dish().surface, at.conditions(), {}).species[0];
    EXPECT_EQ(s.germinated, 4);
    EXPECT_EQ(s.refused, 5);
    EXPECT_EQ(s.living, 14);
    EXPECT_EQ(s.seeds, 6);
    EXPECT_EQ((std::vector(colony.plants.id.begin() + 10, colony.plants.id.end())),
              (std::vector<std::uint64_t>{11, 12, 14, 15}));
    EXPECT_EQ(colony.seeds.id, (std::vector<std::uint64_t>{13, 16, 17, 18, 19, 20}));
}

TEST(Colony, BeyondFourCapsTheOldestSeedsAreDropped)
{
    const Community community{kThree, kPaper, kAlone, 5};
    Colony colony;
    for (int i = 0; i < 23; ++i)
        sow(colony, {0.01 * i, 0.06, 0.7}, Seed::Spore, static_cast<std::uint8_t>(i < 2));
    const DayStatistics s = live(colony, community, dish(), 0, {.cap = 5});
    EXPECT_EQ(s.species[1].dropped, 2);
    EXPECT_EQ(s.species[0].dropped, 1);
    EXPECT_EQ(colony.seeds.size(), 20u);
    EXPECT_EQ(colony.seeds.id.front(), 4u);
}

// Together ----------------------------------------------------------------------------------------

struct World {
    Land land{boulder(0.12, 4), 0.03};
    std::vector<Species> species = kThree;
    Community community;
    ColonyParams params{.cap = 3000};
    World()
    {
        species[1].priority = 0.4;
        community = {species, kPaper, {.spore_throw = 0.06, .external_interval = 3}, 44};
    }
};

const World& world()
{
    static const World w;
    return w;
}

TEST(Colony, MossesAndSeedsAreConserved)
{
    const World& w = world();
    Colony colony = first_settlers(w.community, w.params, w.land.sites);
    DayStatistics before = count(colony, w.community, w.params);
    SpeciesDay all;
    for (int d = 1; d <= 100; ++d) {
        const DayStatistics now = live_in_patches(colony, w.community, w.land, w.params);
        EXPECT_EQ(now.day, d);
        for (std::size_t k = 0; k < 3; ++k) {
            const SpeciesDay &a = before.species[k], &b = now.species[k];
            EXPECT_EQ(b.living, a.living + b.germinated - b.died - b.displaced) << d;
            EXPECT_EQ(b.seeds,
                      a.seeds + b.settled - b.germinated - b.expired - b.replaced - b.dropped)
                << d;
            EXPECT_EQ(b.settled, b.gemmae + b.spores + b.arrived - b.back_face - b.no_hit -
                                     b.too_high - b.collided)
                << d;
            add(all, b);
        }
        const DayStatistics counted = count(colony, w.community, w.params);
        for (std::size_t k = 0; k < 3; ++k) {
            EXPECT_EQ(counted.species[k].living, now.species[k].living);
            EXPECT_EQ(counted.species[k].seeds, now.species[k].seeds);
        }
        ASSERT_LE(colony.plants.size(), 3000u);
        ASSERT_LE(colony.seeds.size(), 12000u);
        before = now;
    }
    // The test is one of all that can happen.
    for (const auto& [what, many] : {std::pair{"germinated", all.germinated},
                                     {"died", all.died},
                                     {"displaced", all.displaced},
                                     {"gemmae", all.gemmae},
                                     {"spores", all.spores},
                                     {"settled", all.settled},
                                     {"replaced", all.replaced},
                                     {"back face", all.back_face},
                                     {"no hit", all.no_hit},
                                     {"collided", all.collided},
                                     {"refused", all.refused},
                                     {"expired", all.expired}})
        EXPECT_GT(many, 5) << what;
    EXPECT_GT(std::ranges::count_if(colony.plants.host, [](auto h) { return h > 0; }), 5);
    // Nobody is closer than half a size to another.
    std::vector<Vec3f> feet(colony.plants.foot);
    feet.insert(feet.end(), colony.seeds.foot.begin(), colony.seeds.foot.end());
    for (std::size_t i = 0; i < feet.size(); ++i)
        for (std::size_t j = 0; j < i; ++j)
            ASSERT_GE(squared_distance(feet[i], feet[j]), 0.005F * 0.005F);
    std::set<std::uint64_t> ids(colony.plants.id.begin(), colony.plants.id.end());
    ids.insert(colony.seeds.id.begin(), colony.seeds.id.end());
    EXPECT_EQ(ids.size(), feet.size());
}

TEST(Colony, IsTheSameOnAnyNumberOfThreads)
{
    const World& w = world();
    auto run = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        Colony colony = first_settlers(w.community, w.params, w.land.sites);
        std::vector<DayStatistics> days;
        for (int d = 0; d < 30; ++d)
            days.push_back(live_in_patches(colony, w.community, w.land, w.params));
        return std::pair(colony, days);
    };
    const auto one = run(1), four = run(4);
    EXPECT_EQ(one.first, four.first);
    EXPECT_EQ(one.second, four.second);
    EXPECT_GT(one.first.plants.size(), 300u);
    EXPECT_EQ(interior(one.first.plants, w.params), interior(four.first.plants, w.params));
}

TEST(Colony, WhereNothingThrivesAllDieAndNoneGerminates)
{
    const World& w = world();
    Colony colony = first_settlers(w.community, w.params, w.land.sites);
    for (int d = 0; d < 60; ++d) {
        const DayStatistics s = live(colony, w.community, w.land, 0);
        for (const SpeciesDay& k : s.species) EXPECT_EQ(k.germinated + k.gemmae + k.spores, 0);
    }
    EXPECT_EQ(colony.plants.size(), 0u);
    live(colony, w.community, w.land, 0);  // and a day without any
}

TEST(Colony, AColonyClimbsOntoItself)
{
    const Land land(floor_mesh(0.3, 0.3), 0.05);
    const Community community{std::span(kThree).first(1), kPaper, {.external_interval = 0}, 9};
    Colony colony;
    plant(colony, {0.15, 0.15, 0.7}, 2.2);
    float highest = 0;
    for (int d = 0; d < 60; ++d) {
        live(colony, community, land, 0.8F);
        for (std::size_t i = 0; i < colony.plants.size(); ++i)
            highest = std::max(highest, colony.plants.height[i]);
    }
    EXPECT_GT(colony.plants.size(), 300u);
    EXPECT_GT(highest, 0.015F);
    EXPECT_LE(highest, 0.03F);
    for (std::size_t i = 0; i < colony.plants.size(); ++i)
        if (colony.plants.host[i] == 0) {
            EXPECT_EQ(colony.plants.height[i], 0);
        }
}

// Bad input ---------------------------------------------------------------------------------------

TEST(Colony, BadInputIsNamedAndNothingChanges)
{
    const World& w = world();
    EXPECT_THAT([] { validate(ColonyParams{.size = 0}); },
                ThrowsMessage<InvalidParameter>("moss: size = 0 m, must be 0.001 to 1"));
    EXPECT_THAT([] { validate(ColonyParams{.cap = 0}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("moss: cap = 0")));
    EXPECT_THAT([] { validate(ColonyParams{.spores_per_day = -1}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("moss: spores_per_day = -1")));
    EXPECT_THAT([&] { first_settlers(w.community, {}, MeshSites{}); },
                ThrowsMessage<InvalidInput>(HasSubstr("no sites")));

    const Colony start = first_settlers(w.community, w.params, w.land.sites);
    auto refused = [&](const std::string& message, auto&& spoil) {
        Colony colony = start;
        Everywhere at(colony, 0.5F);
        ColonyConditions conditions = at.conditions();
        spoil(colony, at, conditions);
        const Colony before = colony;
        try {
            day(colony, w.community, w.params, w.land.surface, conditions, {});
            ADD_FAILURE() << "accepted: " << message;
        } catch (const Error& e) {
            EXPECT_THAT(e.what(), HasSubstr(message));
        }
        EXPECT_EQ(colony, before);
    };
    refused("fitness of 149 plants, must be of 150",
            [](Colony&, Everywhere& at, ColonyConditions& c) {
                c.plants = std::span(at.plants).first(149);
            });
    refused("fitness of bryum = nan at (",
            [](Colony&, Everywhere& at, ColonyConditions&) { at.plants[9] = NAN; });
    refused("fitness of hypnum = -0.1 at (",
            [](Colony&, Everywhere& at, ColonyConditions&) { at.plants[10] = -0.1F; });
    refused(
        "150 plants, of which 149 values are known",
        [](Colony& colony, Everywhere&, ColonyConditions&) { colony.plants.growth.pop_back(); });
    refused("plants 4: species 3",
            [](Colony& colony, Everywhere&, ColonyConditions&) { colony.plants.species[4] = 3; });
    refused("site 4000000000", [](Colony& colony, Everywhere&, ColonyConditions&) {
        colony.plants.site[4] = 4000000000u;
    });
    const std::vector<float> wind(5, 1.0F);
    refused("wind at 5 sites", [&](Colony&, Everywhere&, ColonyConditions& c) { c.wind = wind; });
    const std::atomic<bool> stop{true};
    const Progress cancelled({}, &stop);
    Colony colony = start;
    const Everywhere at(colony, 0.5F);
    EXPECT_THROW(day(colony, w.community, w.params, w.land.surface, at.conditions(), cancelled),
                 Cancelled);
}

TEST(Colony, MoreSeedsThanMemoryHoldsAreRefused)
{
    Community community{std::span(kThree).first(1), kPaper, kAlone, 5};
    community.rules.gemma_step = 1e-6;
    Colony colony;
    for (int i = 0; i < 300; ++i) plant(colony, {0.05, 0.05, 0.7 + i}, 1);
    const Colony before = colony;
    EXPECT_THAT([&] { live(colony, community, dish(), 0.9F); },
                ThrowsMessage<LimitExceeded>(HasSubstr("raise gemma_step")));
    EXPECT_EQ(colony, before);
}

}  // namespace
}  // namespace sekitei::moss
