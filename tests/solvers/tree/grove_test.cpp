#include "solvers/tree/grove.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/log.h"
#include "core/parallel.h"

namespace sekitei::tree {
namespace {

using std::numbers::pi;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

GroveParams open_air()
{
    GroveParams params;
    params.ground = false;
    return params;
}

Grove table_1(std::uint64_t seed, const Species& species = {}, GroveParams params = open_air())
{
    return {std::move(params), {species}, {{{0, 0, 0}, 0, 0}}, seed};
}

void expect_near(Vec3d found, Vec3d expected, double tolerance)
{
    EXPECT_NEAR(found.x, expected.x, tolerance);
    EXPECT_NEAR(found.y, expected.y, tolerance);
    EXPECT_NEAR(found.z, expected.z, tolerance);
}

// Numbers below without a derivation come from an independent prototype in double precision.

TEST(Bend, TurnsByAShareOfTheAngle)
{
    auto bent = [](Vec3d p, Vec3d u) { return bend(p, u, 0.4, fork_axis(p)); };
    const double r3 = std::sqrt(3.0) / 2;
    expect_near(bent({0, 0, 1}, {1, 0, 0}), {0.587785252, 0, 0.809016994}, 1e-9);
    expect_near(bent({1, 0, 0}, {-0.5, 0, r3}), {0.669130606, 0, 0.743144825}, 1e-9);
    // Opposite: in the plane in which the branch forks.
    expect_near(bent({0, 0, 1}, {0, 0, -1}), {0.951056516, 0, 0.309016994}, 1e-9);
    expect_near(bent({0.6, 0, -0.8}, {-0.6, 0, 0.8}), {0.185410197, 0.951056516, -0.247213595},
                1e-9);
    // Parallel, or no light at all: no turn.
    expect_near(bent({0, 0, 1}, {0, 0, 1}), {0, 0, 1}, 0);
    expect_near(bent({0, 0.6, 0.8}, {0, 0, 0}), {0, 0.6, 0.8}, 0);
    for (const double share : {0.0, 0.3, 1.0}) {
        const Vec3d way = bend({0, 0, 1}, {0.6, 0, -0.8}, share, {1, 0, 0});
        EXPECT_NEAR(std::acos(way.z), share * std::acos(-0.8), 1e-12);
    }
}

TEST(Grove, WithoutLightForksLikeAMortar)
{
    Species species;
    species.tropism = 0;
    species.death_threshold = -1;
    Grove grove = table_1(1, species);
    grove.grow(6);
    double z = 15;
    for (int k = 1; k <= 6; ++k) z += std::pow(std::cos(10 * pi / 180), k);
    ASSERT_EQ(grove.tips(), 64u);
    Vec3d mean;
    double squares = 0, most = 0;
    for (const auto tip : grove.tip_list()) {
        const Vec3d end = grove.branches().end(tip);
        EXPECT_NEAR(end.z, z, 1e-12);
        mean += end / 64.0;
        squares += (end.x * end.x + end.y * end.y) / 64;
        most = std::max(most, std::hypot(end.x, end.y));
    }
    expect_near(mean, {0, 0, z}, 1e-12);
    EXPECT_NEAR(std::sqrt(squares), 1.608959004, 1e-9);
    EXPECT_NEAR(most, 1.766685524, 1e-9);
    auto tip = [&](std::size_t i) { return grove.branches().end(grove.tip_list()[i]); };
    expect_near(tip(0), {-0.4198949, 1.1343460, z}, 1e-7);
    expect_near(tip(1), {-0.1944854, 1.3985529, z}, 1e-7);
    expect_near(tip(2), {0.1586588, 1.5418446, z}, 1e-7);
    expect_near(tip(31), {-0.4198949, -1.1343460, z}, 1e-7);
    expect_near(tip(63), {0.4198949, 1.1343460, z}, 1e-7);
}

struct Grown {
    std::uint64_t seed;
    double tropism;
    Occlusion occlusion;
    std::vector<std::size_t> tips;
    double rms, lowest, highest;
    Vec3d first;
};

TEST(Grove, GrowsTheTreesOfThePrototype)
{
    for (const Grown& expected : {Grown{1,
                                        0.4,
                                        Occlusion::Ahead,
                                        {2, 4, 5, 8, 14, 15, 20, 20, 27, 41},
                                        5.0748389,
                                        21.5852779,
                                        23.9165199,
                                        {2.1160688, 5.9460082, 21.5852779}},
                                  Grown{2,
                                        0.4,
                                        Occlusion::Ahead,
                                        {2, 4, 5, 9, 11, 15, 23, 21, 23, 28},
                                        5.5059289,
                                        21.7834252,
                                        23.5409530,
                                        {5.6728127, 1.5363581, 22.4923663}},
                                  Grown{1,
                                        0,
                                        Occlusion::Ahead,
                                        {2, 4, 5, 7, 7, 6, 7, 10, 11, 17},
                                        3.0344895,
                                        24.2013763,
                                        24.2013763,
                                        {0.7362221, 2.8890477, 24.2013763}},
                                  Grown{1,
                                        0.4,
                                        Occlusion::Full,
                                        {2, 2, 2, 4, 3, 3, 4, 1, 2, 3},
                                        0.4494139,
                                        24.9196394,
                                        24.9196394,
                                        {0.3988065, -0.2540222, 24.9196394}}}) {
        Species species;
        species.tropism = expected.tropism;
        GroveParams params = open_air();
        params.occlusion = expected.occlusion;
        for (const Method method : {Method::Naive, Method::Sweep}) {
            params.method = method;
            Grove grove = table_1(expected.seed, species, params);
            GenerationStatistics last;
            std::vector<std::size_t> tips;
            grove.grow(10, {}, [&](const GenerationStatistics& s) {
                tips.push_back(s.tips);
                last = s;
            });
            EXPECT_EQ(tips, expected.tips);
            EXPECT_NEAR(last.rms_radius, expected.rms, 1e-6);
            EXPECT_NEAR(last.lowest, expected.lowest, 1e-6);
            EXPECT_NEAR(last.highest, expected.highest, 1e-6);
            expect_near(grove.branches().end(grove.tip_list()[0]), expected.first, 1e-6);
        }
    }
    Grove grove = table_1(1);
    std::vector<std::size_t> tips;
    grove.grow(20, {}, [&](const GenerationStatistics& s) { tips.push_back(s.tips); });
    tips.erase(tips.begin(), tips.begin() + 10);
    EXPECT_EQ(tips, (std::vector<std::size_t>{41, 48, 56, 65, 79, 101, 109, 122, 133, 147}));
}

TEST(Grove, ShootsGrowFromTheirBuds)
{
    for (const double tropism : {0.0, 0.4}) {
        Species species;
        species.model = Model::Shoot;
        species.tropism = tropism;
        species.buds = 5;
        species.stagger = 3;
        species.death_threshold = -1;
        Grove grove = table_1(1, species);
        std::vector<std::size_t> tips;
        grove.grow(6, {}, [&](const GenerationStatistics& s) { tips.push_back(s.tips); });
        EXPECT_EQ(tips, (std::vector<std::size_t>{3, 3, 5, 5, 5, 5}));
        std::vector<Vec3d> ends;
        for (const auto tip : grove.tip_list()) ends.push_back(grove.branches().end(tip));
        auto holds = [&](Vec3d place) {
            return std::ranges::any_of(ends, [&](Vec3d e) { return length(e - place) < 2e-7; });
        };
        EXPECT_TRUE(holds(tropism == 0 ? Vec3d(0.0254452, -2.7804697, 4.2386229)
                                       : Vec3d(-2.4257865, 0.2834993, 8.2144803)));
        EXPECT_TRUE(holds(tropism == 0 ? Vec3d(-0.2424371, -4.9175928, -3.1358003)
                                       : Vec3d(-0.2376952, -5.2488974, 2.5215995)));
    }
}

/// Parents before children, ends on starts, unit directions, tips and counts in agreement.
void expect_whole(const Grove& grove)
{
    const Branches& b = grove.branches();
    std::vector<int> children(b.size());
    for (std::size_t i = 0; i < b.size(); ++i) {
        EXPECT_NEAR(length(b.direction[i]), 1, 1e-14);
        if (b.parent[i] < 0) continue;
        const auto p = static_cast<std::size_t>(b.parent[i]);
        ASSERT_LT(p, i);
        EXPECT_EQ(b.start[i], b.end(p));
        EXPECT_EQ(b.tree[i], b.tree[p]);
        EXPECT_TRUE(!b.alive(i) || b.alive(p));
        children[p] += b.alive(i);
    }
    std::size_t tips = 0;
    for (std::size_t i = 0; i < b.size(); ++i) {
        if (!b.alive(i)) continue;
        tips += b.is(i, Branches::kTip);
        EXPECT_TRUE(b.is(i, Branches::kTip) || b.is(i, Branches::kCut) || children[i] > 0) << i;
    }
    EXPECT_EQ(tips, grove.tips());
    for (const auto tip : grove.tip_list()) EXPECT_TRUE(b.is(tip, Branches::kTip));
}

TEST(Grove, IsWholeAfterEveryGenerationOfEveryModel)
{
    for (const Model model : {Model::Dichotomy, Model::Shoot, Model::Conifer}) {
        Species species;
        species.model = model;
        species.latent_share = 0.7;
        species.dead_persist = 5;
        species.leaf_retention = 2;
        if (model == Model::Conifer) {
            species.ball_radius = 1;
            species.death_threshold = 0.45;
            species.active_period = 6;
            species.shed_delay = 2;
            species.strong_boughs = 2;
        }
        Grove grove = table_1(3, species);
        for (int g = 0; g < 14; ++g) {
            grove.step();
            expect_whole(grove);
        }
        EXPECT_GT(grove.tips(), 10u);
        EXPECT_GT(grove.prune([](const Branches& b, std::size_t i) { return b.end(i).z > 12; }),
                  0u);
        expect_whole(grove);
        for (int g = 0; g < 4; ++g) grove.step();
        expect_whole(grove);
    }
}

TEST(Grove, IsTheSameOnAnyNumberOfThreads)
{
    auto on_threads = [](std::size_t n) {
        const ThreadLimit limit(n);
        Grove grove = table_1(4);
        grove.grow(25);
        return grove.branches();
    };
    EXPECT_EQ(on_threads(1), on_threads(3));
}

TEST(Grove, GoesOnFromItsStateToTheSameBits)
{
    Species species;
    species.latent_share = 1;
    species.dead_persist = 4;
    Species shoots = species;
    shoots.model = Model::Shoot;
    shoots.buds = 8;
    const std::vector<Plant> plants{{{0, 0, 0}, 0, 0}, {{9, 0, 0}, 1, 0}, {{-9, 2, 0}, 0, 7}};
    Grove once(open_air(), {species, shoots}, plants, 5);
    once.grow(18);
    Grove first(open_air(), {species, shoots}, plants, 5);
    first.grow(9);
    Grove second(open_air(), {species, shoots}, first.state());
    second.grow(9);
    EXPECT_EQ(second.branches(), once.branches());
    EXPECT_EQ(second.tip_list(), once.tip_list());
    // The third tree's first branch stands from generation 7 on.
    int oldest = 100;
    for (std::size_t i = 0; i < once.branches().size(); ++i)
        if (once.branches().tree[i] == 2) oldest = std::min(oldest, once.branches().generation[i]);
    EXPECT_EQ(oldest, 7);
}

TEST(Grove, TreesFarApartGrowAsIfAloneAndNearOnesDoNot)
{
    // Keys differ by number, so the second tree of two is compared with the second of two others.
    auto second_at = [](double x) {
        Grove grove(open_air(), {Species{}}, {{{0, 0, 0}, 0, 0}, {{x, 0, 0}, 0, 0}}, 6);
        grove.grow(16);
        std::vector<Vec3d> ends;
        for (const auto tip : grove.tip_list())
            if (grove.branches().tree[tip] == 1)
                ends.push_back(grove.branches().end(tip) - Vec3d(x, 0, 0));
        return ends;
    };
    // Nothing within a patch's axis: far below and above.
    const auto alone = second_at(1e6), near = second_at(4);
    ASSERT_FALSE(alone.empty());
    const auto other = second_at(2e6);
    ASSERT_EQ(alone.size(), other.size());
    for (std::size_t i = 0; i < alone.size(); ++i) expect_near(alone[i], other[i], 1e-6);
    EXPECT_NE(alone.size(), near.size());
}

TEST(Grove, FelledNeighboursLeaveTheOthersAsTheyWere)
{
    Grove grove(open_air(), {Species{}}, {{{-6, 0, 0}, 0, 0}, {{6, 0, 0}, 0, 0}}, 1);
    grove.grow(12);
    const Branches before = grove.branches();
    grove.remove_tree(0);
    expect_whole(grove);
    std::vector<Vec3d> kept;
    for (std::size_t i = 0; i < before.size(); ++i)
        if (before.tree[i] == 1) kept.push_back(before.end(i));
    ASSERT_EQ(grove.branches().size(), kept.size());
    for (std::size_t i = 0; i < kept.size(); ++i) EXPECT_EQ(grove.branches().end(i), kept[i]);
    EXPECT_THAT([&] { grove.remove_tree(2); },
                ThrowsMessage<InvalidParameter>(HasSubstr("0 to 1")));
    EXPECT_THAT([&] { grove.remove_tree(0); }, ThrowsMessage<InvalidParameter>(HasSubstr("gone")));
    EXPECT_THROW(grove.remove_tree(-1), InvalidParameter);
    grove.remove_tree(1);
    EXPECT_EQ(grove.status(), Status::Extinct);
}

TEST(Grove, ACutTreeLivesOnlyByItsBuds)
{
    for (const double share : {0.0, 1.0}) {
        Species species;
        species.latent_share = share;
        Grove grove = table_1(2, species);
        grove.grow(12);
        const Branches before = grove.branches();
        grove.prune([](const Branches& b, std::size_t i) { return b.generation[i] > 5; });
        EXPECT_EQ(grove.tips(), 0u);
        for (const int g : grove.branches().generation) EXPECT_LE(g, 5);
        grove.grow(10);
        if (share == 0)
            EXPECT_EQ(grove.tips(), 0u);
        else
            EXPECT_GT(grove.tips(), 10u);
        expect_whole(grove);
    }
}

TEST(Grove, DeadWoodChangesNothingThatLives)
{
    auto living = [](double persist, double& dead) {
        Species species;
        species.dead_persist = persist;
        Grove grove = table_1(3, species);
        grove.grow(25);
        const Branches& b = grove.branches();
        std::vector<std::pair<std::uint64_t, Vec3d>> list;
        for (std::size_t i = 0; i < b.size(); ++i)
            if (b.alive(i)) list.emplace_back(b.key[i], b.end(i));
        dead = static_cast<double>(b.size() - list.size());
        return list;
    };
    double none = 0, some = 0, more = 0;
    const auto without = living(0, none);
    EXPECT_EQ(without, living(3, some));
    EXPECT_EQ(without, living(30, more));
    EXPECT_EQ(none, 0);
    EXPECT_GT(some, 0);
    EXPECT_GT(more, 1.5 * some);
}

TEST(Grove, BoughsRestThenFall)
{
    Species species;
    species.model = Model::Conifer;
    species.death_threshold = -1;
    species.ball_radius = 1;
    species.first_length = 1;
    species.active_period = 4;
    species.shed_delay = 3;
    Grove grove = table_1(1, species);
    for (int g = 1; g <= 16; ++g) {
        grove.step();
        const Branches& b = grove.branches();
        int laterals = 0;
        for (std::size_t i = 0; i < b.size(); ++i) {
            if (b.bough[i] < 0) continue;
            EXPECT_LT(g - b.bough[i], 7);                // fallen otherwise
            EXPECT_LE(b.generation[i] - b.bough[i], 4);  // bore nothing later
            laterals += b.order[i] == 1 && b.generation[i] == b.bough[i];
        }
        EXPECT_EQ(laterals, 5 * std::min(g, 7));
    }
    // The thickest two last twice as long.
    species.strong_boughs = 2;
    species.shed_delay = 0;
    Grove strong = table_1(1, species);
    strong.grow(16);
    int old = 0;
    for (std::size_t i = 0; i < strong.branches().size(); ++i)
        old += strong.branches().generation[i] == strong.branches().bough[i] &&
               16 - strong.branches().bough[i] >= 4;
    EXPECT_GE(old, 2);
    EXPECT_LE(old, 8);
}

TEST(Grove, TheGroundIsAnObstacleThatTipsPassAlong)
{
    Species species;
    species.death_threshold = 0.5;
    species.first_length = 3;
    GroveParams params;
    Grove with(params, {species}, {{{0, 0, 7}, 0, 0}}, 1);
    with.grow(34);
    double lowest = 1e9;
    for (const auto tip : with.tip_list()) lowest = std::min(lowest, with.branches().end(tip).z);
    EXPECT_GE(lowest, 7.25 - 1e-9);
    params.ground = false;
    Grove without(params, {species}, {{{0, 0, 7}, 0, 0}}, 1);
    without.grow(34);
    lowest = 1e9;
    for (const auto tip : without.tip_list())
        lowest = std::min(lowest, without.branches().end(tip).z);
    EXPECT_LT(lowest, 6);
}

TEST(Grove, RatiosOfLightMatterAloneAndOpaqueLeavesAreAllowed)
{
    auto grown = [](double upper, double lower, double transmission) {
        GroveParams params = open_air();
        params.light_ratio_upper = upper;
        params.light_ratio_lower = lower;
        params.transmission = transmission;
        Grove grove = table_1(1, {}, params);
        grove.grow(8);
        std::vector<std::uint64_t> keys;
        for (const auto tip : grove.tip_list()) keys.push_back(grove.branches().key[tip]);
        return keys;
    };
    EXPECT_EQ(grown(3, 2, 0.9), grown(1.5, 1, 0.9));
    EXPECT_FALSE(grown(1, 0, 0.9).empty());
    grown(3, 2, 0);  // may die out
    std::string said;
    log::set_sink([&](log::Level, const std::string& line) { said = line; });
    EXPECT_GT(grown(3, 2, 1).size(), grown(3, 2, 0.9).size());
    log::set_sink({});
}

TEST(Grove, StopsWhenItDiesOutOrGrowsTooLarge)
{
    Species dying;
    dying.death_threshold = 5;
    Grove dead = table_1(1, dying);
    EXPECT_EQ(dead.grow(10), Status::Extinct);
    EXPECT_EQ(dead.generation(), 1);
    EXPECT_EQ(dead.branches().size(), 0u);
    GroveParams params = open_air();
    params.max_tips = 20;
    Grove large = table_1(1, {}, params);
    EXPECT_EQ(large.grow(40), Status::Limit);
    EXPECT_EQ(large.generation(), 9);  // 27 tips
    const std::atomic<bool> stop{true};
    Grove cancelled = table_1(1);
    EXPECT_THROW(cancelled.grow(3, Progress({}, &stop)), Cancelled);
}

TEST(Grove, NamesWhatIsWrong)
{
    auto refused = [](auto&& change, const char* words) {
        GroveParams params = open_air();
        Species species;
        std::vector<Plant> plants{{{0, 0, 0}, 0, 0}};
        change(params, species, plants);
        EXPECT_THAT([&] { Grove(params, {species}, plants, 1); },
                    ThrowsMessage<InvalidParameter>(HasSubstr(words)));
    };
    using P = GroveParams;
    using S = Species;
    using L = std::vector<Plant>;
    refused([](P& p, S&, L&) { p.patch_rows = 7; }, "patch_rows = 7, must be even");
    refused([](P& p, S&, L&) { p.patch_columns = 2; }, "patch_columns = 2");
    refused([](P& p, S&, L&) { p.transmission = 1.5; }, "transmission = 1.5");
    refused([](P& p, S&, L&) { p.light_ratio_upper = p.light_ratio_lower = 0; }, "no light");
    refused([](P& p, S&, L&) { p.transmission = 0, p.method = Method::Grid; }, "sweep");
    refused([](P&, S& s, L&) { s.ball_radius = 0; }, "ball_radius = 0");
    refused([](P&, S& s, L&) { s.tropism = NAN; }, "tropism");
    refused([](P&, S& s, L&) { s.branch_angle = 90; }, "branch_angle = 90");
    refused([](P&, S& s, L&) { s.first_length = 0; }, "first_length = 0");
    refused([](P&, S&, L& l) { l.clear(); }, "origin");
    refused([](P&, S&, L& l) { l.push_back(l[0]); }, "origins 0 and 1");
    refused([](P&, S&, L& l) { l[0].species = 1; }, "species 1, there are 1");
    refused([](P&, S&, L& l) { l[0].origin.x = INFINITY; }, "not finite");
}

}  // namespace
}  // namespace sekitei::tree
