#include "solvers/moss/population.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <numeric>

#include "core/error.h"
#include "core/parallel.h"
#include "tests/solvers/moss/sites.h"

namespace sekitei::moss {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

const Rules kPaper{.light_gate = false};

using Fields = std::vector<std::vector<float>>;

Fields everywhere(std::size_t species, std::size_t sites, float g)
{
    return Fields(species, std::vector<float>(sites, g));
}

/// A patchy world: each species has its own good and bad places, which change from day to day.
Fields patches(const Sheet& sheet, std::size_t species, double day)
{
    Fields g = everywhere(species, sheet.size(), 0);
    for (std::size_t k = 0; k < species; ++k)
        for (std::size_t i = 0; i < sheet.size(); ++i) {
            const Vec3d p = sheet.position[i];
            const double wave = std::sin(p.x * 7 + double(k)) * std::cos(p.y * 5 - double(k));
            g[k][i] =
                static_cast<float>(std::clamp(0.5 + 1.5 * wave * std::cos(day * 0.15), 0.0, 1.0));
        }
    return g;
}

/// One site whose seeds go nowhere.
struct Pot {
    Sheet sheet{1, 1};
    OneLanding landing;
    std::vector<Species> species;
    Community community;
    Population population{1};

    explicit Pot(std::vector<Species> s) : species(std::move(s))
    {
        community = {species, kPaper, {.external_interval = 0}, 5};
    }
    void sow(Seed seed, std::uint8_t which = 1, std::size_t site = 0)
    {
        population.seed_kind[site] = seed == Seed::Gemma ? 1 : 2;
        population.seed_species[site] = which;
        population.seed_born[site] = population.day;
        population.seed_id[site] = population.next_id++;
    }
    SpeciesDay live(float g) { return live(everywhere(species.size(), sheet.size(), g)); }
    SpeciesDay live(const Fields& g)
    {
        return day(population, community, sheet.surface(), landing, {g, {}, {}}, {}).species[0];
    }
};

TEST(MossPopulation, ALifeInGoodConditionsShedsGemmaeThenSpores)
{
    Pot pot({kind("bryum")});
    pot.sow(Seed::Gemma);
    std::int64_t gemmae = 0, spores = 0;
    int first_gemma = 0, first_spore = 0;
    for (int d = 1; d <= 12; ++d) {
        const SpeciesDay s = pot.live(.8F);
        EXPECT_EQ(s.germinated, d == 1);
        EXPECT_EQ(s.living, 1);
        if (s.gemmae && !gemmae) first_gemma = d;
        if (s.spores && !spores) first_spore = d;
        gemmae += s.gemmae;
        spores += s.spores;
    }
    EXPECT_EQ(first_gemma, 3);
    EXPECT_EQ(first_spore, 10);
    EXPECT_EQ(gemmae, 5);
    EXPECT_EQ(spores, 3);
    EXPECT_NEAR(pot.population.growth[0], 2.52, 1e-5);
    EXPECT_EQ(moss_age(pot.population)[0], 11);
    EXPECT_EQ(pot.population.id[0], 1u);  // that of its seed
}

TEST(MossPopulation, ALifeThatLosesItsPlaceShrinksAndDies)
{
    Pot pot({kind("hypnum")});
    pot.sow(Seed::Gemma);
    std::int64_t gemmae = 0;
    for (int d = 1; d <= 6; ++d) gemmae += pot.live(.87F).gemmae;
    EXPECT_NEAR(pot.population.growth_max[0], 1.155, 1e-6);
    int died = 0;
    for (int d = 7; d <= 60; ++d) {
        const SpeciesDay s = pot.live(0);
        gemmae += s.gemmae;
        if (s.died) died = d;
        EXPECT_EQ(s.living, died ? 0 : 1);
    }
    EXPECT_EQ(died, 47);
    EXPECT_EQ(gemmae, 2);
    EXPECT_NEAR(pot.population.growth_max[0], 0, 0);
}

TEST(MossPopulation, AMossThatRegrowsDoesNotRepeatItsGemmae)
{
    Pot pot({kind("bryum")});
    pot.sow(Seed::Gemma);
    std::int64_t gemmae = 0;
    for (int round = 0; round < 4; ++round) {
        for (int d = 0; d < 6; ++d) gemmae += pot.live(.8F).gemmae;  // + 1.26
        for (int d = 0; d < 30; ++d) gemmae += pot.live(0).gemmae;   // - 0.9
    }
    EXPECT_NEAR(pot.population.growth_max[0], 3 * .36 + 1.26, 1e-4);
    EXPECT_EQ(gemmae, 4);  // 0.5, 1, 1.5, 2
}

/// The day on which a seed germinates if its place is good from day `from` on, else 0; and when it
/// was removed.
std::pair<int, int> germination(const char* name, Seed seed, float g, int from)
{
    Pot pot({kind(name)});
    pot.sow(seed);
    for (int d = 1; d < 500; ++d) {
        const SpeciesDay s = pot.live(d < from ? 0 : g);
        if (s.germinated) return {d, 0};
        if (s.expired) {
            EXPECT_EQ(s.seeds, 0);
            return {0, d};
        }
        EXPECT_EQ(s.seeds, 1);
    }
    return {0, 0};
}

TEST(MossPopulation, SeedsGerminateInTheirWindowAndThenGo)
{
    using Days = std::pair<int, int>;
    EXPECT_EQ(germination("bryum", Seed::Gemma, 1, 0), Days(1, 0));
    EXPECT_EQ(germination("bryum", Seed::Gemma, 1, 68), Days(68, 0));
    EXPECT_EQ(germination("bryum", Seed::Gemma, 1, 69), Days(0, 69));
    EXPECT_EQ(germination("bryum", Seed::Spore, 1, 0), Days(38, 0));
    EXPECT_EQ(germination("bryum", Seed::Spore, 1, 387), Days(387, 0));
    EXPECT_EQ(germination("bryum", Seed::Spore, 1, 388), Days(0, 388));
    EXPECT_EQ(germination("hypnum", Seed::Spore, .6F, 0), Days(79, 0));
    EXPECT_EQ(germination("polytrichum", Seed::Gemma, .37F, 0).first, 0);
}

TEST(MossPopulation, ASeedWaitsUnderAMossUntilItDies)
{
    Pot pot({kind("bryum")});
    pot.sow(Seed::Gemma);
    pot.live(.8F);
    pot.sow(Seed::Gemma);
    for (int d = 0; d < 5; ++d) {
        const SpeciesDay s = pot.live(.8F);
        EXPECT_EQ(s.germinated, 0);
        EXPECT_EQ(s.seeds, 1);
    }
    std::int64_t died = 0;
    while (!died) died = pot.live(0).died;
    const SpeciesDay s = pot.live(.8F);
    EXPECT_EQ(s.germinated, 1);
    EXPECT_EQ(s.living, 1);
    EXPECT_EQ(s.seeds, 0);
    EXPECT_EQ(pot.population.id[0], 2u);
}

TEST(MossPopulation, HigherPriorityDisplacesWhatHasGrownLess)
{
    Species strong = kind("hypnum");
    strong.priority = 1;
    for (const bool late : {false, true}) {
        Pot pot({kind("bryum"), strong});
        pot.sow(Seed::Gemma);
        for (int d = 0; d < (late ? 6 : 4); ++d) pot.live(.8F);  // growth 0.84, 1.26
        pot.sow(Seed::Gemma, 2);
        const Population before = pot.population;
        const Fields g = everywhere(2, 1, .8F);
        const DayStatistics now =
            day(pot.population, pot.community, pot.sheet.surface(), pot.landing, {g, {}, {}}, {});
        EXPECT_EQ(now.species[0].displaced, late ? 0 : 1);
        EXPECT_EQ(now.species[1].germinated, late ? 0 : 1);
        EXPECT_EQ(now.species[0].living, late ? 1 : 0);
        EXPECT_EQ(pot.population.species[0], late ? 1 : 2);
        EXPECT_EQ(pot.population.id[0], late ? before.id[0] : before.seed_id[0]);
    }
}

/// Keeps all flights.
struct Recorder : Landing {
    mutable std::mutex mutex;
    mutable std::vector<Flight> flights;
    void land(std::span<const Flight> seeds, double, std::span<std::int32_t> site) const override
    {
        const std::lock_guard lock(mutex);
        flights.insert(flights.end(), seeds.begin(), seeds.end());
        std::fill_n(site.begin(), seeds.size(), kLost);
    }
};

/// A day on which every site of a sheet sheds its 19 first gemmae and a spore. Positions and
/// normals of the parents are all the same.
std::vector<Flight> shed(Sheet& sheet, const Community& community, Conditions conditions = {})
{
    std::fill(sheet.position.begin(), sheet.position.end(), Vec3d(3, -2, 5));
    Population p(sheet.size());
    for (std::size_t i = 0; i < sheet.size(); ++i) {
        p.species[i] = 1;
        p.id[i] = p.next_id++;
        p.growth[i] = p.growth_max[i] = 0.6F;
    }
    const Fields g = everywhere(1, sheet.size(), 1);
    conditions.fitness = g;
    Recorder recorder;
    const DayStatistics s = day(p, community, sheet.surface(), recorder, conditions, {});
    EXPECT_EQ(recorder.flights.size(),
              static_cast<std::size_t>(s.species[0].gemmae + s.species[0].spores));
    return recorder.flights;
}

const std::vector<Species> kBryum{kind("bryum")};
const Rules kFast{.light_gate = false, .growth_rate = 100};

TEST(MossPopulation, GemmaeFlyUniformlyInAllDirections)
{
    Sheet sheet(50, 40);
    // No spores.
    Community community{kBryum, kFast, {.gemma_throw = 0.07, .external_interval = 0}, 11};
    community.rules.spore_threshold = 99;
    const std::vector<Flight> flights = shed(sheet, community);
    ASSERT_EQ(flights.size(), 2000u * 19);
    const double n = static_cast<double>(flights.size());
    Vec3d sum;
    double second[3] = {}, mixed[3] = {};
    std::vector<double> heights(20);
    for (const Flight& f : flights) {
        const Vec3d v = (f.at - Vec3d(3, -2, 5)) / 0.07;
        ASSERT_NEAR(length(v), 1, 1e-9);
        ASSERT_EQ(f.fall, Vec3d(0, 0, -1));
        sum += v;
        for (int k = 0; k < 3; ++k) {
            second[k] += v[k] * v[k] / n;
            mixed[k] += v[k] * v[(k + 1) % 3] / n;
        }
        heights[static_cast<std::size_t>(std::min(19.0, (v.z + 1) * 10))] += 1;
    }
    const double sigma = 1 / std::sqrt(3 * n);
    for (int k = 0; k < 3; ++k) {
        EXPECT_NEAR(sum[k] / n, 0, 3.5 * sigma);
        EXPECT_NEAR(second[k], 1.0 / 3, 3.5 * std::sqrt(4.0 / 45 / n));
        EXPECT_NEAR(mixed[k], 0, 3.5 * std::sqrt(1.0 / 15 / n));
    }
    double chi_squared = 0;
    for (const double h : heights) chi_squared += std::pow(h - n / 20, 2) / (n / 20);
    EXPECT_LT(chi_squared, 43.8);  // 19 degrees of freedom, 0.1 %
}

TEST(MossPopulation, SporesFlyUniformlyWithinACone)
{
    for (const Vec3d n : {Vec3d(0, 0, 1), Vec3d(0, 0, -1), normalized(Vec3d(0.5, -2, 0.3)),
                          normalized(Vec3d(1e-4, 0, -1))}) {
        Sheet sheet(100, 100, 0.03, Vec3f(n));
        Community community{kBryum, kFast, {.spore_throw = 0.4, .external_interval = 0}, 11};
        community.rules.gemma_step = 1000;
        const std::vector<Flight> flights = shed(sheet, community);
        ASSERT_EQ(flights.size(), 10000u);
        const double count = 10000;
        double cosine = 0, sine = 0;
        Vec3d across;
        for (const Flight& f : flights) {
            const Vec3d v = (f.at - Vec3d(3, -2, 5)) / 0.4;
            ASSERT_NEAR(length(v), 1, 1e-6);
            const double c = dot(v, n);
            ASSERT_GT(c, std::sqrt(0.5) - 1e-6);
            cosine += c / count;
            sine += length(cross(v, n)) / count;
            across += (v - n * c) / count;
        }
        // The cosine is uniform in 0.7071 .. 1.
        EXPECT_NEAR(cosine, 0.853553, 3.5 * (1 - std::sqrt(.5)) / std::sqrt(12 * count));
        EXPECT_NEAR(sine, 0.487205, 0.006);
        EXPECT_LT(length(across), 0.02);
    }
}

TEST(MossPopulation, SporesFlyToBothSidesAndDriftWhenAsked)
{
    Sheet sheet(100, 100);
    Community community{kBryum, kFast, {.spore_cone = SporeCone::Both, .external_interval = 0}, 3};
    community.rules.gemma_step = 1000;
    int up = 0;
    for (const Flight& f : shed(sheet, community)) {
        EXPECT_GT(std::abs(f.at.z - 5), 0.3 * std::sqrt(0.5) - 1e-6);
        up += f.at.z > 5;
    }
    EXPECT_NEAR(up, 5000, 3.5 * 50);

    community.propagation = {.spore_wind = true, .settling_speed = 0.05, .external_interval = 0};
    const std::vector<float> wind(sheet.size(), 0.4F);
    for (const Flight& f : shed(sheet, community, {{}, wind, {0.6, -0.8, 0}}))
        ASSERT_LT(length(f.fall - Vec3d(4.8, -6.4, -1)), 1e-6);
}

TEST(MossPopulation, DrawsDifferByDayAndIndividualButNotByPlace)
{
    Sheet sheet(3, 1);
    std::fill(sheet.position.begin(), sheet.position.end(), Vec3d(0, 0, 0));
    const Community community{kBryum, kPaper, {.external_interval = 0}, 3};
    Population p(3);
    for (std::size_t i = 0; i < 3; ++i) p.species[i] = 1, p.growth[i] = p.growth_max[i] = 3.1F;
    p.id = {4, 9, 4};
    const Fields g = everywhere(1, 3, .2F);
    Recorder one, two;
    day(p, community, sheet.surface(), one, {g, {}, {}}, {});
    day(p, community, sheet.surface(), two, {g, {}, {}}, {});
    ASSERT_EQ(one.flights.size(), 3u);
    EXPECT_EQ(one.flights[0].at, one.flights[2].at);
    EXPECT_NE(one.flights[0].at, one.flights[1].at);
    EXPECT_NE(one.flights[0].at, two.flights[0].at);
}

TEST(MossPopulation, ThreeQuartersOfTheGemmaeSurviveOnAFloor)
{
    const Ground g({53, 57, 31}, [](Vec3d p) { return p.z - 13.4; });
    Sheet sheet(40, 30, 0.02);
    Community community{kBryum, kFast, {.external_interval = 0}, 17};
    community.rules.spore_threshold = 99;
    std::vector<Flight> flights = shed(sheet, community);
    const Vec3d middle = g.box.transform.world({26.3, 28.4, 13.4});
    for (Flight& f : flights) f.at += middle - Vec3d(3, -2, 5);
    std::vector<std::int32_t> site(flights.size());
    g.landing.land(flights, adhesion(community.propagation, 0.02), site);
    double landed = 0, way = 0;
    for (std::size_t i = 0; i < site.size(); ++i) {
        if (site[i] < 0) continue;
        landed += 1;
        way += std::hypot(flights[i].at.x - middle.x, flights[i].at.y - middle.y);
    }
    const double n = static_cast<double>(site.size());
    EXPECT_NEAR(landed / n, 0.75, 3.5 * std::sqrt(.75 * .25 / n));
    EXPECT_NEAR(way / landed / 0.03, 0.842469, 0.005);
}

/// Mosses on sites 1 ..., all about to shed a spore, a free site 0 where everything lands.
struct Contest {
    Sheet sheet{6, 1};
    std::vector<Species> species;
    Population population{6};
    Community community;

    explicit Contest(std::vector<Species> s) : species(std::move(s))
    {
        community = {species, kPaper, {.external_interval = 0}, 5};
        population.next_id = 100;
    }
    void parent(std::size_t site, std::uint8_t kind_, std::uint64_t id, float growth = 2.9F)
    {
        population.species[site] = kind_;
        population.id[site] = id;
        population.growth[site] = population.growth_max[site] = growth;
    }
    DayStatistics live()
    {
        const Fields g = everywhere(species.size(), 6, .4F);  // bryum grows by 0.09
        return day(population, community, sheet.surface(), OneLanding(0), {g, {}, {}}, {});
    }
};

TEST(MossPopulation, AmongEqualSeedsOfADayTheElderParentsWins)
{
    Contest c({kind("bryum"), kind("hypnum"), kind("polytrichum")});
    c.parent(1, 1, 30, 3.1F), c.parent(3, 2, 20, 3.1F), c.parent(4, 3, 40, 3.1F);
    const DayStatistics s = c.live();
    EXPECT_EQ(c.population.seed_species[0], 2);
    EXPECT_EQ(c.population.seed_kind[0], 2);
    EXPECT_EQ(c.population.seed_id[0], 100u);
    EXPECT_EQ(c.population.seed_born[0], 1);
    EXPECT_EQ(c.population.next_id, 101u);
    EXPECT_EQ(s.species[1].settled, 1);
    EXPECT_EQ(s.species[0].settled + s.species[2].settled, 0);
    EXPECT_EQ(s.species[0].spores + s.species[1].spores + s.species[2].spores, 3);
}

TEST(MossPopulation, GemmaeComeBeforeSpores)
{
    Contest c({kind("bryum"), kind("hypnum")});
    c.parent(1, 2, 10, 3.1F), c.parent(2, 1, 30, 1.45F);
    c.live();
    EXPECT_EQ(c.population.seed_species[0], 1);
    EXPECT_EQ(c.population.seed_kind[0], 1);
}

TEST(MossPopulation, AmongSeedsOfADayHigherPriorityWins)
{
    Species strong = kind("polytrichum");
    strong.priority = 0.5;
    Contest c({kind("bryum"), kind("hypnum"), strong});
    c.parent(1, 2, 10, 3.1F), c.parent(4, 3, 50, 3.1F), c.parent(5, 1, 20, 1.45F);
    c.live();
    EXPECT_EQ(c.population.seed_species[0], 3);
}

TEST(MossPopulation, ARestingSeedGivesWayToHigherPriorityOnly)
{
    Species strong = kind("polytrichum");
    strong.priority = 0.5;
    for (const bool contested : {false, true}) {
        Contest c({kind("bryum"), kind("hypnum"), strong});
        c.population.seed_kind[0] = 2;
        c.population.seed_species[0] = 1;
        c.population.seed_id[0] = 77;
        c.parent(1, 2, 10, 3.1F);
        if (contested) c.parent(2, 3, 50, 3.1F);
        const DayStatistics s = c.live();
        EXPECT_EQ(c.population.seed_species[0], contested ? 3 : 1);
        EXPECT_EQ(c.population.seed_id[0], contested ? 100u : 77u);
        EXPECT_EQ(s.species[0].replaced, contested);
        EXPECT_EQ(s.species[2].settled, contested);
        EXPECT_EQ(s.species[1].settled, 0);
    }
}

const std::vector<Species> kThree{kind("bryum"), kind("hypnum"), kind("polytrichum")};

TEST(MossPopulation, FirstSettlersAreAsManyAsAskedDrawnByArea)
{
    Sheet sheet(170, 110);
    for (std::size_t i = 0; i < sheet.size(); i += 2) sheet.area[i] *= 3;
    const Community community{kThree, {}, {.initial_count = 400, .initial_growth = 0.3}, 8};
    const Population p = first_settlers(community, sheet.surface());
    const DayStatistics s = count(p, community, sheet.surface());
    int large = 0;
    double x = 0, y = 0;
    std::vector<std::uint64_t> ids;
    for (std::size_t i = 0; i < p.size(); ++i) {
        if (!p.species[i]) continue;
        large += i % 2 == 0;
        x += sheet.position[i].x / 1200 / (170 * 0.03);
        y += sheet.position[i].y / 1200 / (110 * 0.03);
        ids.push_back(p.id[i]);
        EXPECT_EQ(p.growth[i], 0.3F);
        EXPECT_EQ(p.growth_max[i], 0.3F);
    }
    std::ranges::sort(ids);
    for (std::size_t k = 0; k < ids.size(); ++k) ASSERT_EQ(ids[k], k + 1);
    for (int k = 0; k < 3; ++k) EXPECT_EQ(s.species[static_cast<std::size_t>(k)].living, 400);
    EXPECT_NEAR(large / 1200.0, 0.75, 0.045);
    EXPECT_NEAR(x, 0.5, 3.5 / std::sqrt(12 * 1200.0));
    EXPECT_NEAR(y, 0.5, 3.5 / std::sqrt(12 * 1200.0));
    Community other = community;
    other.seed = 9;
    EXPECT_NE(first_settlers(other, sheet.surface()).species, p.species);

    const Sheet small(7, 1);
    const Population full = first_settlers(community, small.surface());
    EXPECT_EQ(count(full, community, small.surface()).species[0].living, 7);
    EXPECT_EQ(full.cover, std::vector<float>(7, 1.0F));
}

TEST(MossPopulation, ASporeFromOutsideComesEveryTenDaysOfEachSpeciesInTurn)
{
    Sheet sheet(40, 30);
    const Community community{kThree, {}, {.initial_count = 0}, 8};
    Population p = first_settlers(community, sheet.surface());
    const Fields g = everywhere(3, sheet.size(), 0);
    std::vector<std::int64_t> settled(3);
    for (int d = 1; d <= 90; ++d) {
        const DayStatistics s = day(p, community, sheet.surface(), OneLanding(), {g, {}, {}}, {});
        for (std::size_t k = 0; k < 3; ++k) {
            EXPECT_EQ(s.species[k].settled, d % 10 == 0 && (d / 10 - 1) % 3 == static_cast<int>(k));
            settled[k] += s.species[k].settled;
        }
    }
    EXPECT_EQ(settled, std::vector<std::int64_t>(3, 3));
    EXPECT_EQ(p.arrivals, 9u);
}

/// The population after some days on a patchy sheet, whose patches move `pace` times as fast.
Population history(const Sheet& sheet, const Community& community, int days,
                   std::vector<DayStatistics>* all = nullptr, double pace = 1)
{
    Population p = first_settlers(community, sheet.surface());
    if (all) all->push_back(count(p, community, sheet.surface()));
    for (int d = 1; d <= days; ++d) {
        const Fields g = patches(sheet, community.species.size(), d * pace);
        const DayStatistics s =
            day(p, community, sheet.surface(), SheetLanding(sheet), {g, {}, {}}, {});
        if (all) all->push_back(s);
    }
    return p;
}

TEST(MossPopulation, IsTheSameOnAnyNumberOfThreads)
{
    const Sheet sheet(90, 70);
    const Community community{kThree, {}, {}, 21};
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        std::vector<DayStatistics> all;
        return std::pair(history(sheet, community, 60, &all), all);
    };
    const auto one = on(1), four = on(4);
    EXPECT_EQ(one.first, four.first);
    EXPECT_EQ(one.second, four.second);
    std::int64_t spores = 0;
    for (const DayStatistics& s : one.second) spores += s.species[0].spores;
    EXPECT_GT(spores, 1000);
}

/// The sheet with its sites in another order.
struct Shuffled {
    Sheet sheet;
    std::vector<std::uint32_t> from, to;  // old number of each new site, and the reverse

    explicit Shuffled(const Sheet& old) : sheet(old), from(old.size()), to(old.size())
    {
        std::iota(from.begin(), from.end(), 0u);
        std::ranges::sort(from, {}, [](std::uint32_t i) { return mix64(i); });
        for (std::uint32_t k = 0; k < from.size(); ++k) to[from[k]] = k;
        sheet.begin = {0};
        sheet.neighbour.clear();
        for (std::size_t k = 0; k < from.size(); ++k) {
            sheet.position[k] = old.position[from[k]];
            for (std::uint32_t j = old.begin[from[k]]; j < old.begin[from[k] + 1]; ++j)
                sheet.neighbour.push_back(to[old.neighbour[j]]);
            sheet.begin.push_back(static_cast<std::uint32_t>(sheet.neighbour.size()));
        }
    }
    template <class T>
    void apply(std::vector<T>& v) const
    {
        const std::vector<T> old = v;
        for (std::size_t k = 0; k < v.size(); ++k) v[k] = old[from[k]];
    }
    void apply(Population& p) const
    {
        apply(p.species), apply(p.growth), apply(p.growth_max), apply(p.born), apply(p.id);
        apply(p.seed_kind), apply(p.seed_species), apply(p.seed_born), apply(p.seed_id);
        apply(p.cover);
    }
};

struct ShuffledLanding : Landing {
    SheetLanding landing;
    const Shuffled& shuffled;
    ShuffledLanding(const Sheet& old, const Shuffled& s) : landing(old), shuffled(s) {}
    void land(std::span<const Flight> seeds, double adhesion,
              std::span<std::int32_t> site) const override
    {
        landing.land(seeds, adhesion, site);
        for (std::size_t i = 0; i < seeds.size(); ++i)
            if (site[i] >= 0)
                site[i] = static_cast<std::int32_t>(shuffled.to[static_cast<std::size_t>(site[i])]);
    }
};

TEST(MossPopulation, DoesNotDependOnTheOrderOfSites)
{
    const Sheet sheet(60, 50);
    const Shuffled shuffled(sheet);
    const Community community{kThree, {}, {.external_interval = 0}, 21};
    Population p = first_settlers(community, sheet.surface()), q = p;
    shuffled.apply(q);
    for (int d = 1; d <= 60; ++d) {
        Fields g = patches(sheet, 3, d);
        day(p, community, sheet.surface(), SheetLanding(sheet), {g, {}, {}}, {});
        for (auto& v : g) shuffled.apply(v);
        day(q, community, shuffled.sheet.surface(), ShuffledLanding(sheet, shuffled), {g, {}, {}},
            {});
    }
    EXPECT_GT(p.next_id, 2000u);
    shuffled.apply(p);
    EXPECT_EQ(p, q);
}

TEST(MossPopulation, MossesAndSeedsAreConserved)
{
    std::vector<Species> species = kThree;
    species[1].priority = 0.4;  // displaces and replaces
    const Sheet sheet(60, 50);
    const Community community{species, {.growth_cap = 2.3}, {}, 4};
    std::vector<DayStatistics> all;
    history(sheet, community, 450, &all, 0.15);
    SpeciesDay sum;
    for (std::size_t d = 1; d < all.size(); ++d)
        for (std::size_t k = 0; k < 3; ++k) {
            const SpeciesDay &a = all[d - 1].species[k], &b = all[d].species[k];
            ASSERT_EQ(all[d].day, static_cast<int>(d));
            ASSERT_EQ(b.living, a.living + b.germinated - b.died - b.displaced);
            ASSERT_EQ(b.seeds, a.seeds + b.settled - b.germinated - b.expired - b.replaced);
            ASSERT_NEAR(b.area, static_cast<double>(b.living) * 9e-4, 1e-6);
            sum.germinated += b.germinated, sum.died += b.died, sum.displaced += b.displaced;
            sum.settled += b.settled, sum.expired += b.expired, sum.replaced += b.replaced;
        }
    EXPECT_GT(sum.germinated, 1000);
    EXPECT_GT(sum.died, 500);
    EXPECT_GT(sum.displaced, 5);
    EXPECT_GT(sum.expired, 10);
    EXPECT_GT(sum.replaced, 10);
}

TEST(MossPopulation, WhereNothingThrivesAllDieAndNoneGerminates)
{
    const Sheet sheet(60, 50);
    const Community community{kThree, {}, {}, 4};
    Population p = first_settlers(community, sheet.surface());
    const Fields g = everywhere(3, sheet.size(), 0);
    std::int64_t died = 0;
    for (int d = 1; d <= 30; ++d)
        for (const SpeciesDay& s :
             day(p, community, sheet.surface(), SheetLanding(sheet), {g, {}, {}}, {}).species) {
            EXPECT_EQ(s.germinated + s.gemmae + s.spores, 0);
            died += s.died;
        }
    EXPECT_EQ(died, 150);
    EXPECT_EQ(p.species, std::vector<std::uint8_t>(sheet.size()));
    EXPECT_EQ(p.growth, std::vector<float>(sheet.size()));
    EXPECT_EQ(p.cover, std::vector<float>(sheet.size()));
}

TEST(MossPopulation, APatchGrowsOutwardsFromOnePlant)
{
    const Ground ground({83, 83, 24}, [](Vec3d p) { return p.z - 11.3; });
    const Surface surface = ground.surface();
    Community community{kBryum, kPaper, {.external_interval = 0}, 6};
    community.rules.spore_threshold =
        99;  // gemmae only: they reach 1.5 cells, and 0.5 for the cell
    Population p(surface.size());
    const auto first = static_cast<std::size_t>(ground.cells.index.value({41, 41, 10}));
    ASSERT_LT(first, p.size());
    p.species[first] = 1;
    p.growth[first] = 0.2F;
    p.id[first] = p.next_id++;
    const Fields g = everywhere(1, p.size(), 0.9F);
    std::vector<double> radius;
    std::vector<int> counts;
    int quadrant[4] = {};
    for (int d = 1; d <= 60; ++d) {
        day(p, community, surface, ground.landing, {g, {}, {}}, {});
        if (d % 15) continue;
        double far = 0;
        counts.push_back(0);
        std::fill_n(quadrant, 4, 0);
        for (std::size_t i = 0; i < p.size(); ++i) {
            if (!p.species[i]) continue;
            const Coord off = ground.cells.voxel[i] - Coord(41, 41, 10);
            far = std::max(far, std::hypot(off.x, off.y));
            ++counts.back();
            if (off.x && off.y) ++quadrant[(off.x > 0) + 2 * (off.y > 0)];
        }
        radius.push_back(far);
        // A generation takes three days at the least, and a gemma its first day.
        EXPECT_LE(far, 2.3 * (d / 3.0));
    }
    for (std::size_t k = 1; k < radius.size(); ++k) {
        EXPECT_GT(radius[k], radius[k - 1]);
        EXPECT_GT(counts[k], counts[k - 1]);
    }
    EXPECT_GT(radius[3], 8);
    EXPECT_LT(counts[3], 3.2 * radius[3] * radius[3]);
    EXPECT_GT(counts[3], 0.5 * radius[3] * radius[3]);
    for (const int q : quadrant) EXPECT_NEAR(q, counts[3] / 4.0, 0.35 * counts[3] / 4.0);
}

TEST(MossPopulation, CoverIsTheOccupiedShareOfTheBlockAround)
{
    const Ground ground({33, 37, 31}, bumpy);
    const Surface surface = ground.surface();
    const Community community{kThree, {}, {.initial_count = 150}, 2};
    Population p = first_settlers(community, surface);
    const Fields g = everywhere(3, p.size(), 0.7F);
    for (int d = 0; d < 12; ++d) day(p, community, surface, ground.landing, {g, {}, {}}, {});
    for (std::size_t i = 0; i < p.size(); ++i) {
        int cells = 0, occupied = 0;
        for (int x = -1; x <= 1; ++x)
            for (int y = -1; y <= 1; ++y)
                for (int z = -1; z <= 1; ++z) {
                    const std::int32_t c =
                        ground.cells.index.value(ground.cells.voxel[i] + Coord(x, y, z));
                    if (c < 0) continue;
                    ++cells;
                    occupied += p.species[static_cast<std::size_t>(c)] != 0;
                }
        ASSERT_EQ(p.cover[i], static_cast<float>(occupied) / static_cast<float>(cells));
    }
}

TEST(MossPopulation, BadInputIsNamedAndNothingChanges)
{
    Sheet sheet(5, 4);
    const Community community{kThree, {}, {.initial_count = 3}, 2};
    Population p = first_settlers(community, sheet.surface());
    const Population before = p;
    auto refuses = [&](const Fields& g, const Surface& surface, std::span<const float> wind,
                       const char* expected) {
        EXPECT_THAT(
            [&] {
                day(p, community, surface, OneLanding(), {g, wind, {}}, {});
            },
            ThrowsMessage<Error>(HasSubstr(expected)));
        EXPECT_EQ(p, before);
    };
    const Surface good = sheet.surface();
    Fields g = everywhere(3, 20, .5F);
    g[1][13] = std::nanf("");
    refuses(g, good, {}, "day 1: fitness of hypnum = nan at site 13 (0.105, 0.075, 0.7)");
    g[1][13] = -0.1F;
    refuses(g, good, {}, "fitness of hypnum = -0.1 at site 13");
    g[1].resize(19);
    refuses(g, good, {}, "fitness of hypnum at 19 sites, must be at 20");
    g.resize(1);
    refuses(g, good, {}, "fitness of 1 species, must be of 3");
    const std::vector<float> wind(7);
    refuses(everywhere(3, 20, .5F), good, wind, "wind at 7 sites, must be at 20");
    const Sheet other(5, 5);
    refuses(everywhere(3, 25, .5F), other.surface(), {},
            "a population on 20 sites, a surface of 25");
    Surface bad = good;
    bad.area = bad.area.first(3);
    refuses(everywhere(3, 20, .5F), bad, {}, "3 areas for 20 sites");
    bad = good;
    bad.spacing = 0;
    refuses(everywhere(3, 20, .5F), bad, {}, "site spacing = 0 m");

    struct Near : OneLanding {
        double reach() const override { return 0.01; }
    };
    const Fields bright = everywhere(3, 20, .5F);
    EXPECT_THAT(
        [&] {
            day(p, community, good, Near(), {bright, {}, {}}, {});
        },
        ThrowsMessage<InvalidParameter>(HasSubstr("adhesion = 0.0225 m, must be at most 0.01 m")));
    EXPECT_EQ(p, before);

    Population broken = before;
    broken.seed_species[4] = 9;
    const Fields fine = everywhere(3, 20, .5F);
    EXPECT_THAT(
        [&] {
            day(broken, community, good, OneLanding(), {fine, {}, {}}, {});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("site 4")));

    const std::atomic<bool> cancel{true};
    const Progress progress({}, &cancel);
    EXPECT_THROW(day(p, community, good, OneLanding(), {fine, {}, {}}, progress), Cancelled);
    EXPECT_EQ(p, before);

    EXPECT_THAT([] { validate(Propagation{.spore_throw = -1}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("spore_throw = -1 m, must be > 0")));
    EXPECT_THAT([] { validate(Propagation{.gemma_throw = 0}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("gemma_throw = 0 m")));
    const std::vector<Species> twins{kind("bryum"), kind("bryum")};
    EXPECT_THAT(
        [&] {
            validate(Community{twins, {}, {}, 0});
        },
        ThrowsMessage<InvalidParameter>(HasSubstr("two species are called bryum")));
    EXPECT_THAT([&] { validate(Community{}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("0 species, must be 1 to 255")));
    EXPECT_NO_THROW(validate(community));
}

TEST(MossPopulation, NoSitesAreNoTrouble)
{
    const Sheet none(0, 0);
    const Community community{kThree, {}, {}, 2};
    Population p = first_settlers(community, none.surface());
    for (int d = 0; d < 20; ++d)
        EXPECT_EQ(day(p, community, none.surface(), OneLanding(), {everywhere(3, 0, 0), {}, {}}, {})
                      .species[0]
                      .living,
                  0);
}

}  // namespace
}  // namespace sekitei::moss
