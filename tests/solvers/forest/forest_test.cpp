#include "solvers/forest/forest.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <numeric>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/forest/draw.h"

namespace sekitei::forest {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

Inputs setup_of(double width, double depth)
{
    Inputs setup;
    setup.width = width;
    setup.depth = depth;
    setup.species = table_species();
    return setup;
}

Inputs still(double width, double depth)
{
    Inputs setup = setup_of(width, depth);
    setup.params.seeds_per_step = 0;
    return setup;
}

/// V / 65535 and Vmax of every tree, by uid, with the heights given.
std::map<std::uint64_t, std::pair<double, double>> shares(Inputs setup,
                                                          const std::vector<NewTree>& trees)
{
    // Trees that die keep no record: none does with these thresholds.
    setup.params.r1 = 0;
    setup.params.r2 = 1;
    Forest forest(std::move(setup));
    forest.plant(trees);
    forest.advance();
    std::map<std::uint64_t, std::pair<double, double>> found;
    for (const Tree& tree : forest.trees())
        found[tree.uid] = {double(tree.kept) / 65535, double(tree.cone)};
    return found;
}

std::vector<int> circles(const Inputs& setup, const NewTree& tree)
{
    Forest forest(setup);
    Tree t;
    t.x = tree.x, t.y = tree.y, t.height = tree.height;
    t.species = static_cast<std::uint8_t>(tree.species);
    std::vector<int> list;
    for (const std::uint32_t n : forest.footprint(t))
        if (n > 0) list.push_back(int(n));
    return list;
}

// Oracle: the specification's table of footprints.
TEST(Forest, CirclesCoverThePixelsTheyShould)
{
    const Inputs setup = still(66, 66);
    using V = std::vector<int>;
    EXPECT_EQ(circles(setup, {1, 0, 16.5, 16.5, 5}), (V{1, 5, 9, 13, 21}));
    EXPECT_EQ(circles(setup, {1, 3, 16.5, 16.5, 5}), (V{1, 9, 21, 45, 69}));
    EXPECT_EQ(circles(setup, {1, 0, 16.2, 16.9, 5}), (V{1, 4, 9, 14, 25}));
    EXPECT_EQ(
        circles(setup, {1, 0, 32.5, 32.5, 20}),
        (V{1, 5, 9, 13, 21, 37, 45, 61, 69, 97, 113, 137, 161, 185, 213, 241, 277, 293, 341, 373}));
    // A seedling's circle may cover no centre: it has its trunk's pixel.
    EXPECT_EQ(circles(setup, {1, 0, 16.02, 16.98, 1}), (V{1}));
}

struct Pair {
    NewTree first, second;
    std::array<std::array<double, 4>, 3> expected;  // V1, Vmax1, V2, Vmax2 by orientation
};

// Oracle: pairs of trees, for each orientation.
TEST(Forest, TheBiggerOfTwoTreesKeepsWhatBothClaim)
{
    const std::vector<Pair> pairs{
        {{1, 0, 16.5, 16.5, 10},
         {2, 0, 20.5, 16.5, 6},
         {{{358, 358, 71, 86}, {262, 262, 26, 50}, {970, 970, 60, 222}}}},
        {{1, 0, 16.5, 16.5, 8},
         {2, 0, 19.5, 16.5, 8},
         {{{192, 192, 110, 192}, {132, 132, 84, 132}, {488, 488, 216, 488}}}},
        {{1, 0, 16.5, 16.5, 20}, {2, 4, 18.5, 16.5, 2}, {{{2692, 2692, 9, 10}, {}, {}}}},
        {{1, 0, 0.5, 16.5, 10},
         {2, 5, 32.5, 0.5, 1},
         {{{209, 209, 1, 1}, {156, 156, 1, 1}, {540, 540, 1, 1}}}},
    };
    for (const Pair& pair : pairs)
        for (const Method method : {Method::Columns, Method::Painter})
            for (int o = 0; o < 3; ++o) {
                Inputs setup = still(33, 33);
                setup.params.orientation = Orientation(o);
                setup.params.method = method;
                const auto found = shares(setup, {pair.first, pair.second});
                const auto& e = pair.expected[std::size_t(o)];
                if (e[1] == 0) {  // the small one is left nothing
                    EXPECT_EQ(found.at(2).first, 0) << o;
                    continue;
                }
                EXPECT_EQ(found.at(1), (std::pair{e[0], e[1]})) << o << ' ' << pair.first.height;
                if (pair.second.species != 5) {
                    EXPECT_EQ(found.at(2), (std::pair{e[2], e[3]})) << o;
                }
            }
}

TEST(Forest, DensityMapsWeighTheSlicesOfTheirBand)
{
    auto lone = [](std::array<double, 5> values) {
        Inputs setup = still(64, 64);
        for (const double v : values) setup.density.emplace_back(64, 64, density_value(v));
        return shares(setup, {{1, 0, 32.5, 32.5, 20}}).at(1);
    };
    const auto rising = lone({0, .2, .4, .6, 1});
    EXPECT_NEAR(rising.first, 1963.2, 1e-9);
    EXPECT_NEAR(rising.first / rising.second, .729271917, 1e-9);
    const auto low = lone({1, 1, 0, 0, 0});
    EXPECT_EQ(low.first, 192);
    EXPECT_EQ(low.second, 2692);
    // The last one would die of it.
    Inputs setup = still(64, 64);
    for (const double v : {1, 1, 0, 0, 0}) setup.density.emplace_back(64, 64, density_value(v));
    Forest forest(setup);
    forest.plant(std::vector<NewTree>{{1, 0, 32.5, 32.5, 20}});
    const StepStatistics row = forest.advance();
    EXPECT_EQ(row.deaths[std::size_t(Cause::Competition)], 1u);
    EXPECT_EQ(forest.size(), 0u);
}

// Numbers that a tree's position is made of, given by the specification.
TEST(Forest, InitialTreesStandWhereTheirNumbersSay)
{
    EXPECT_EQ(hash2(11, 3), 0x1139fd5694aac492u);
    EXPECT_EQ(uniform_of_key(hash2(11, 3), 0xFFFF), .9861486267863013);
    EXPECT_EQ(hash2(hash2(11, 3), 0), 0x64f61b841102a1b8u);
    Forest forest(setup_of(512, 512));
    forest.sow({1, 0, 0, 0, 0, 0});
    const Tree tree = forest.trees().at(0);
    EXPECT_EQ(tree.uid, 0x210aee97dce61845u);
    EXPECT_NEAR(tree.x, 225.508178293, 1e-9);
    EXPECT_NEAR(tree.y, 397.590518737, 1e-9);
    EXPECT_NEAR(tree.height, 2.372289514, 1e-9);
}

const std::vector<NewTree> kFive{{11, 0, 20.3, 20.4, 3},
                                 {12, 0, 22.1, 19.7, 2.6},
                                 {13, 1, 21.7, 24.9, 2.8},
                                 {14, 3, 20.2, 22.3, 2.2},
                                 {15, 2, 19.1, 19.5, 2.4}};

std::map<std::uint64_t, Tree> by_uid(const Forest& forest)
{
    std::map<std::uint64_t, Tree> found;
    for (const Tree& tree : forest.trees()) found[tree.uid] = tree;
    return found;
}

// Oracle: R used in a step and the height after it.
TEST(Forest, FiveTreesGrowAsTheOracleSays)
{
    struct Row {
        std::array<double, 4> share, height;
    };
    const std::vector<Row> table{
        {{1, 1, .928571, .8}, {5.6, 5.8, 3.592857, 3.6}},
        {{.584906, .962264, .684211, .692308}, {7.354717, 8.686792, 4.619173, 4.638462}},
        {{.414815, .797927, .543210, .517241}, {8.599161, 11.080575, 5, 5.414324}},
        {{.352332, .640919, .418919, .433962}, {9.656156, 13.003331, 5, 6.065267}},
        {{.315985, .561608, .418919, .364706}, {10.604112, 14.688155, 5, 6.612326}},
        {{.284932, .526151, .418919, .364706}, {11.458906, 16.266607, 5, 7.159385}},
        {{.252610, .469751, .418919, .325581}, {12.216735, 17.675860, 5, 7.647757}},
        {{.230016, .445639, .418919, .325581}, {12.216735, 18, 5, 8.136129}}};
    const std::array<double, 8> first{6, 9, 12, 15, 18, 20, 20, 20};
    for (const Method method : {Method::Columns, Method::Painter}) {
        Inputs setup = still(48, 48);
        setup.params.method = method;
        Forest forest(setup);
        forest.plant(kFive);
        for (std::size_t n = 0; n < table.size(); ++n) {
            forest.advance();
            const auto now = by_uid(forest);
            ASSERT_EQ(now.size(), 5u);
            EXPECT_EQ(now.at(11).share(), 1);
            EXPECT_NEAR(now.at(11).height, first[n], 1e-6);
            for (std::uint64_t uid = 12; uid <= 15; ++uid) {
                EXPECT_NEAR(now.at(uid).share(), table[n].share[uid - 12], 1e-6) << n << uid;
                EXPECT_NEAR(now.at(uid).height, table[n].height[uid - 12], 1e-6) << n << uid;
            }
        }
    }
}

TEST(Forest, TreesBetweenTheThresholdsStandStill)
{
    Inputs setup = still(48, 48);
    setup.params.r1 = .35;
    setup.params.r2 = .45;
    Forest forest(setup);
    forest.plant(kFive);
    for (int n = 1; n <= 8; ++n) {
        forest.advance();
        const auto now = by_uid(forest);
        ASSERT_EQ(now.size(), 5u);
        EXPECT_TRUE(n < 3 || std::abs(now.at(12).height - 7.354717) < 1e-6) << n;
        EXPECT_TRUE(n < 4 || std::abs(now.at(15).height - 5.414324) < 1e-6) << n;
    }
}

TEST(Forest, LowMapsSlowGrowthToo)
{
    Inputs setup = still(48, 48);
    for (int b = 0; b < 5; ++b) setup.density.emplace_back(48, 48, density_value(.4));
    Forest forest(setup);
    forest.plant(kFive);
    for (int n = 1; n <= 6; ++n) forest.advance();
    const std::array<double, 5> expected{10.2, 5.557143, 9.425361, 4.135338, 4.190769};
    const auto now = by_uid(forest);
    for (std::uint64_t uid = 11; uid <= 15; ++uid)
        EXPECT_NEAR(now.at(uid).height, expected[uid - 11], 1e-6) << uid;
}

TEST(Forest, SeedlingsComeInTheOraclesNumbers)
{
    Forest forest(setup_of(48, 48));
    forest.plant(kFive);
    std::vector<std::uint64_t> counts;
    std::uint64_t deaths = 0;
    for (int n = 1; n <= 12; ++n) {
        for (const std::uint64_t d : forest.advance().deaths) deaths += d;
        counts.push_back(forest.size());
    }
    EXPECT_THAT(counts, testing::ElementsAre(5, 6, 6, 6, 7, 8, 9, 11, 13, 15, 19, 21));
    EXPECT_EQ(deaths, 0u);
}

Forest grown(Inputs setup, std::uint64_t each, int steps)
{
    Forest forest(std::move(setup));
    forest.sow(std::vector<std::uint64_t>(6, each));
    for (int n = 0; n < steps; ++n) forest.advance();
    return forest;
}

std::string bytes_of(const Forest& forest)
{
    const std::vector<Tree> trees = forest.trees();
    return {reinterpret_cast<const char*>(trees.data()), trees.size() * sizeof(Tree)};
}

// R9: the masks of columns against circles that are painted and counted.
TEST(Forest, ColumnsGiveExactlyWhatThePainterGives)
{
    for (int kind = 0; kind < 6; ++kind) {
        auto with = [&](Method method) {
            Inputs setup = setup_of(150, 110);
            setup.params.method = method;
            setup.params.tile = 64;
            if (kind == 1) setup.params.orientation = Orientation::Upright;
            if (kind == 2) setup.params.orientation = Orientation::Flat;
            if (kind == 3) setup.params.border = Border::Wrap;
            if (kind == 4) {  // a slope with steps, upright cones, a rock
                setup.params.slice_frame = SliceFrame::Absolute;
                setup.land.ground = Raster<float>(150, 110, 0);
                setup.land.blocked_height = Raster<float>(150, 110, 0);
                for (int j = 0; j < 110; ++j)
                    for (int i = 0; i < 150; ++i) {
                        setup.land.ground.set(i, j, 0.31f * float(i) + float(j / 20));
                        if (std::abs(i - 70) < 6 && std::abs(j - 50) < 9)
                            setup.land.blocked_height.set(i, j, 4.5f);
                    }
                for (Species& s : setup.species) s.max_slope = 1.5;
            }
            if (kind == 5) {  // painted maps
                for (int b = 0; b < 5; ++b) {
                    DensityMap& map = setup.density.emplace_back(150, 110, 65535);
                    for (int j = 0; j < 110; ++j)
                        for (int i = 0; i < 150; ++i)
                            map.set(i, j,
                                    static_cast<std::uint16_t>(
                                        mix64(std::uint64_t(b * 100000 + j * 150 + i)) >> 48));
                }
            }
            return grown(std::move(setup), 90, 10);
        };
        const Forest columns = with(Method::Columns), painter = with(Method::Painter);
        EXPECT_GT(columns.size(), 150u) << kind;
        EXPECT_EQ(bytes_of(columns), bytes_of(painter)) << kind;
        EXPECT_EQ(columns.occupancy(Method::Columns), columns.occupancy(Method::Painter)) << kind;
    }
}

/// Rows in memory.
class MemoryStore : public RowStore {
public:
    std::string load(int step, int row) override
    {
        const auto found = rows.find({step, row});
        if (found == rows.end()) throw InvalidInput("no such row");
        return found->second;
    }
    void save(int step, int row, const std::string& bytes) override
    {
        if (left-- == 0) throw Cancelled();
        rows[{step, row}] = bytes;
    }
    void complete(int step) override
    {
        done = step;
        std::erase_if(rows, [&](const auto& entry) { return entry.first.first < step; });
    }
    std::map<std::pair<int, int>, std::string> rows;
    int done = -1;
    int left = -1;  ///< saves until it is interrupted; below 0: never
};

// R10, smaller than in validation.
TEST(Forest, TilesThreadsAndRowsOutOfCoreChangeNothing)
{
    auto setup = [](int tile) {
        Inputs s = setup_of(300, 260);
        s.params.tile = tile;
        for (int b = 0; b < 5; ++b) {
            DensityMap& map = s.density.emplace_back(300, 260, 65535);
            for (int j = 60; j < 120; ++j)
                for (int i = 0; i < 200; ++i) map.set(i, j, static_cast<std::uint16_t>(9000 * b));
        }
        Edit fell;
        fell.kind = Edit::Kind::Fell;
        fell.step = 6;
        fell.min_height = 5;
        fell.region.kind = Region::Kind::Disc;
        fell.region.x = 150, fell.region.y = 130, fell.region.radius = 50;
        s.edits.push_back(fell);
        Edit plant;
        plant.kind = Edit::Kind::Plant;
        plant.step = 7;
        for (std::uint64_t k = 0; k < 50; ++k)
            plant.trees.push_back({k, 1, 120 + double(k), 131, 2});
        s.edits.push_back(plant);
        return s;
    };
    const std::string expected = bytes_of(grown(setup(1000), 150, 10));
    ASSERT_GT(expected.size(), 2000 * sizeof(Tree));
    for (const int tile : {16, 64, 128, 256}) {
        const ThreadLimit limit(tile == 64 ? 1 : 2);
        EXPECT_EQ(bytes_of(grown(setup(tile), 150, 10)), expected) << tile;
    }
    for (const int tile : {16, 64, 128, 1000}) {
        MemoryStore store;
        Forest forest(setup(tile), store);
        forest.sow(std::vector<std::uint64_t>(6, 150));
        for (int n = 0; n < 10; ++n) forest.advance();
        EXPECT_EQ(bytes_of(forest), expected) << tile;
        EXPECT_EQ(store.done, 10);
    }
}

TEST(Forest, AnInterruptedRunOutOfCoreGoesOnToTheSameBytes)
{
    Inputs setup = setup_of(200, 200);
    setup.params.tile = 32;
    const std::string expected = bytes_of(grown(setup, 80, 8));
    for (int interruptions = 3; interruptions < 40; interruptions += 9) {
        MemoryStore store;
        store.left = 7 + interruptions;
        try {
            Forest forest(setup, store);
            forest.sow(std::vector<std::uint64_t>(6, 80));
            for (int n = 0; n < 8; ++n) forest.advance();
            FAIL() << "was not interrupted";
        } catch (const Cancelled&) {
        }
        store.left = -1;
        Forest again(setup, store);
        again.resume(store.done);
        while (again.step() < 8) again.advance();
        EXPECT_EQ(bytes_of(again), expected) << interruptions;
    }
}

TEST(Forest, DamagedRowsAreNamed)
{
    Inputs setup = setup_of(64, 64);
    MemoryStore store;
    Forest forest(setup, store);
    forest.sow(std::vector<std::uint64_t>(6, 20));
    forest.advance();
    std::string& bytes = store.rows.at({1, 0});
    const std::string whole = bytes;
    for (const std::size_t cut : {std::size_t{0}, std::size_t{20}, whole.size() - 1}) {
        bytes = whole.substr(0, cut);
        EXPECT_THAT([&] { Forest(setup, store).resume(1); },
                    ThrowsMessage<InvalidInput>(HasSubstr("row 0 of step 1")));
    }
    bytes = whole;
    bytes[whole.size() / 2] = static_cast<char>(bytes[whole.size() / 2] ^ 1);
    EXPECT_THAT([&] { Forest(setup, store).resume(1); },
                ThrowsMessage<InvalidInput>(HasSubstr("damaged")));
    bytes = whole;
    EXPECT_NO_THROW(Forest(setup, store).resume(1));
}

// Moving a wrapping forest by whole pixels across its border changes nothing but positions.
TEST(Forest, AWrappingForestHasNoBorder)
{
    auto at = [](double shift) {
        Inputs setup = still(64, 64);
        setup.params.border = Border::Wrap;
        std::vector<NewTree> trees;
        for (std::uint64_t k = 0; k < 60; ++k)
            trees.push_back({k, int(k % 6), std::fmod(64 * uniform_of_key(7, k) + shift, 64),
                             64 * uniform_of_key(8, k), 1 + 0.9 * uniform_of_key(9, k)});
        Forest forest(setup);
        forest.plant(trees);
        for (int n = 0; n < 6; ++n) forest.advance();
        std::map<std::uint64_t, double> heights;
        for (const Tree& tree : forest.trees()) heights[tree.uid] = tree.height;
        return heights;
    };
    // Shifts of powers of two keep the fractions' bits.
    const auto here = at(0), there = at(32);
    ASSERT_GT(here.size(), 20u);
    ASSERT_EQ(here.size(), there.size());
    for (const auto& [uid, height] : here) EXPECT_NEAR(there.at(uid), height, 1e-9) << uid;
}

TEST(Forest, AbsoluteSlicesOnFlatGroundAreThoseOfTheGround)
{
    auto on = [](SliceFrame frame, double height) {
        Inputs setup = setup_of(128, 96);
        setup.params.slice_frame = frame;
        setup.params.seedling_height = 0.7;
        setup.land.ground = Raster<float>(128, 96, float(height));
        return bytes_of(grown(std::move(setup), 60, 12));
    };
    EXPECT_EQ(on(SliceFrame::Ground, 0), on(SliceFrame::Absolute, 123.4));
}

// R12: upright cones on a slope and a cliff.
TEST(Forest, NothingGrowsOnACliff)
{
    Inputs setup = setup_of(120, 120);
    setup.params.slice_frame = SliceFrame::Absolute;
    setup.land.ground = Raster<float>(120, 120, 0);
    const double t30 = std::tan(30 * 3.14159265358979 / 180), t60 = std::sqrt(3.0);
    auto ground = [&](double x) {
        return x < 50 ? x * t30 : x < 70 ? 50 * t30 + (x - 50) * t60 : 50 * t30 + 20 * t60;
    };
    for (int j = 0; j < 120; ++j)
        for (int i = 0; i < 120; ++i) setup.land.ground.set(i, j, float(ground(i + 0.5)));
    const Forest forest = grown(std::move(setup), 100, 25);
    std::array<int, 3> count{};
    for (const Tree& tree : forest.trees()) ++count[tree.x < 50 ? 0 : tree.x < 70 ? 1 : 2];
    EXPECT_GT(count[0], 500);
    EXPECT_EQ(count[1], 0);
    EXPECT_GT(count[2], 500);
}

// R11: too little and too much water.
TEST(Forest, ASpeciesKeepsToItsWater)
{
    Inputs setup = setup_of(300, 120);
    Factor water{"water", Raster<float>(300, 120, 0)};
    for (int j = 0; j < 120; ++j)
        for (int i = 0; i < 300; ++i) water.value.set(i, j, (float(i) + 0.5f) / 300);
    setup.land.factors.push_back(std::move(water));
    setup.species[0].limits = {{"water", .2, .3, .4, .6, .7, .8}};
    Forest forest(std::move(setup));
    forest.sow({400, 400, 400, 400, 400, 400});
    std::map<std::uint64_t, double> start;
    for (const Tree& tree : forest.trees()) start[tree.uid] = tree.height;
    int tall = 0, tall_within = 0;
    for (int n = 1; n <= 30; ++n) {
        forest.advance();
        for (const Tree& tree : forest.trees()) {
            if (tree.species != 0) continue;
            const double water_there = (std::floor(tree.x) + 0.5) / 300;
            EXPECT_GE(water_there, .2);
            EXPECT_LE(water_there, .8);
            if (water_there < .3 || water_there > .7) {
                const auto sown = start.find(tree.uid);
                EXPECT_EQ(tree.height, sown == start.end() ? 1.0 : sown->second);
            }
            if (n == 30 && tree.height > 12) {
                ++tall;
                tall_within += water_there >= .3 && water_there <= .7;
            }
        }
        if (HasFailure()) return;
    }
    EXPECT_GT(tall, 50);
    EXPECT_GE(tall_within, 0.9 * tall);
}

TEST(Forest, TreesDieOfAgeAndWindAndTheFallenAreTold)
{
    Inputs setup = still(64, 64);
    for (Species& s : setup.species) s.max_age = 5;
    Forest old(setup);
    old.plant(kFive);
    for (int n = 1; n <= 5; ++n) {
        old.advance();
        EXPECT_EQ(old.size(), 5u);
    }
    EXPECT_EQ(old.advance().deaths[std::size_t(Cause::Age)], 5u);

    // Heights of 20 m, half the reference's wind: a quarter of the probability.
    Inputs windy = still(2000, 2000);
    windy.params.windthrow = 0.4;
    windy.wind = [](double, double, double) { return Vec3d(0, 10, 3); };
    Forest forest(windy);
    std::vector<NewTree> trees;
    for (std::uint64_t k = 0; k < 1600; ++k)
        trees.push_back({k, 0, 25 + 50 * double(k % 40), 25 + 50 * double(k / 40), 20});
    forest.plant(trees);
    const StepStatistics row = forest.advance();
    const auto thrown = row.deaths[std::size_t(Cause::Wind)];
    EXPECT_NEAR(double(thrown), 160, 4 * std::sqrt(160 * .9));
    ASSERT_EQ(forest.fallen().size(), thrown);
    for (const Fallen& log : forest.fallen()) {
        EXPECT_NEAR(log.azimuth, 1.5707963267948966, 1e-12);
        EXPECT_EQ(log.length, 20);
        EXPECT_EQ(log.step, 1);
    }
}

TEST(Forest, EditsActBeforeAnythingElseInTheirStep)
{
    Inputs setup = still(48, 48);
    Edit fell;
    fell.kind = Edit::Kind::Fell;
    fell.step = 2;
    fell.min_height = 5.7;
    setup.edits.push_back(fell);
    Edit plant;
    plant.kind = Edit::Kind::Plant;
    plant.step = 3;
    plant.trees = {{77, 0, 40.5, 40.5, 2}};
    setup.edits.push_back(plant);
    Forest forest(setup);
    forest.plant(kFive);
    forest.advance();  // 11 is 6 m high, 13 is 5.8 m, the others lower
    EXPECT_EQ(forest.advance().deaths[std::size_t(Cause::Felled)], 2u);
    EXPECT_FALSE(by_uid(forest).contains(11));
    EXPECT_FALSE(by_uid(forest).contains(13));
    forest.advance();
    EXPECT_EQ(by_uid(forest).at(77).height, 5);  // grown in the same step
}

TEST(Forest, MistakesAreNamed)
{
    auto make = [](auto&& change) {
        Inputs setup = setup_of(64, 64);
        change(setup);
        Forest forest(std::move(setup));
    };
    EXPECT_THAT([&] { make([](Inputs& s) { s.params.r1 = .5; }); },
                ThrowsMessage<InvalidParameter>(HasSubstr("r1 = 0.5")));
    EXPECT_THAT([&] { make([](Inputs& s) { s.params.slices = 65; }); },
                ThrowsMessage<InvalidParameter>(HasSubstr("slices = 65")));
    EXPECT_THAT([&] { make([](Inputs& s) { s.width = 64.5; }); },
                ThrowsMessage<InvalidParameter>(HasSubstr("64.5")));
    EXPECT_THAT([&] { make([](Inputs& s) { s.width = -1; }); },
                ThrowsMessage<InvalidParameter>(HasSubstr("-1")));
    EXPECT_THAT([&] { make([](Inputs& s) { s.density.resize(4, DensityMap(64, 64, 1)); }); },
                ThrowsMessage<InvalidParameter>(HasSubstr("4 density maps")));
    EXPECT_THAT([&] { make([](Inputs& s) { s.density.resize(5, DensityMap(60, 64, 1)); }); },
                ThrowsMessage<InvalidInput>(HasSubstr("60 x 64")));
    EXPECT_THAT([&] { make([](Inputs& s) { s.params.windthrow = .1; }); },
                ThrowsMessage<InvalidParameter>(HasSubstr("wind")));
    EXPECT_THAT(
        [&] {
            make([](Inputs& s) {
                s.params.border = Border::Wrap;
                s.width = s.depth = 20;
            });
        },
        ThrowsMessage<InvalidParameter>(HasSubstr("wrap")));
    Forest forest(setup_of(64, 64));
    EXPECT_THAT(
        [&] {
            forest.plant(std::vector<NewTree>{{5, 0, 1, 1, 1}, {5, 0, 9, 9, 1}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("0000000000000005")));
    EXPECT_THAT(
        [&] {
            forest.plant(std::vector<NewTree>{{5, 6, 1, 1, 1}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("species 7")));
    EXPECT_THAT(
        [&] {
            forest.plant(std::vector<NewTree>{{5, 0, 1, 1, NAN}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("nan")));
    EXPECT_EQ(forest.plant(std::vector<NewTree>{{5, 0, 64, 1, 1}, {6, 0, 63, 1, 1}}), 1u);
    EXPECT_EQ(forest.size(), 1u);
}

TEST(Forest, AnEmptyForestGoesOn)
{
    Forest forest(setup_of(64, 64));
    const StepStatistics row = forest.advance();
    EXPECT_EQ(row.trees, 0u);
    EXPECT_EQ(row.mean_share, 0);
    EXPECT_TRUE(forest.trees().empty());
}

}  // namespace
}  // namespace sekitei::forest
