#include "solvers/forest/canopy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <numbers>

#include "core/error.h"
#include "core/parallel.h"
#include "grids/scene.h"

namespace sekitei::forest {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

constexpr Vec3d kCorner{100, -30, 7};

Inputs inputs_of(double width, double depth)
{
    Inputs inputs;
    inputs.width = width;
    inputs.depth = depth;
    inputs.species = table_species();
    inputs.seed = 5;
    return inputs;
}

Forest lone_tree()
{
    Forest forest(inputs_of(65, 65));
    forest.plant(
        std::vector<NewTree>{{.uid = 9, .species = 0, .x = 32.5, .y = 32.5, .height = 20}});
    return forest;
}

Forest grown(Inputs inputs, int steps)
{
    Forest forest(std::move(inputs));
    forest.sow({30, 30, 30, 30, 30, 30});
    for (int n = 0; n < steps; ++n) forest.advance();
    return forest;
}

std::vector<std::string> hashes(const Canopy& c)
{
    std::vector<std::string> list;
    for (const FloatGrid* g : {&c.leaf_area_density, &c.drag, &c.transmittance, &c.height,
                               &c.ground_transmittance, &c.terrain, &c.density})
        list.push_back(content_hash(Grid{*g}));
    list.push_back(content_hash(Grid{c.owner}));
    return list;
}

double sum_of(const FloatGrid& grid)
{
    double sum = 0;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.mask(leaf).for_each([&](int o) { sum += double(grid.at(leaf, o)); });
    return sum;
}

/// exp(-0.5 integral LAD dl) in small steps; `repeat` gives the place in a domain that repeats.
double marched(const FloatGrid& lad, Vec3d p, Vec3d sun, Coord size, bool wrap)
{
    constexpr double kStep = 1.0 / 64;
    double depth = 0;
    for (p += sun * (kStep / 2); p.z < 34; p += sun * kStep) {
        Coord c(int(std::floor(p.x)), int(std::floor(p.y)), int(std::floor(p.z)));
        if (wrap) {
            c.x = (c.x % size.x + size.x) % size.x;
            c.y = (c.y % size.y + size.y) % size.y;
        }
        depth += kStep * double(lad.value(c));
    }
    return std::exp(-0.5 * depth);
}

TEST(Canopy, OfALoneTreeHasTheDensityOfItsLeafArea)
{
    const Canopy c = canopy(lone_tree(), {}, kCorner);
    EXPECT_EQ(c.leaf_area_density.active_count(), 2431u);
    EXPECT_NEAR(double(c.leaf_area_density.value({32, 32, 20})), 0.617093904, 1e-7);
    EXPECT_NEAR(c.leaf_area, 1500.155281, 1e-4);
    EXPECT_NEAR(sum_of(c.leaf_area_density), 1500.155281, 1e-4);
    EXPECT_NEAR(double(c.drag.value({32, 32, 20})), 0.123418781, 1e-8);
    EXPECT_EQ(c.drag.active_count(), 2431u);
    EXPECT_NEAR(double(c.ground_transmittance.value({32, 32, 0})), 0.033573558, 1e-8);
    EXPECT_NEAR(double(c.ground_transmittance.value({37, 32, 0})), 0.033573558, 1e-8);
    EXPECT_EQ(c.ground_transmittance.value({43, 32, 0}), 1.0f);
    // In the middle of the highest voxel half of its own leaves are above.
    EXPECT_NEAR(double(c.transmittance.value({32, 32, 20})), std::exp(-0.25 * 0.617093904), 1e-7);
    EXPECT_NEAR(double(c.transmittance.value({32, 32, 10})), std::exp(-0.5 * 10.5 * 0.617093904),
                1e-7);
    EXPECT_NEAR(double(c.transmittance.value({32, 32, 1})), 0.033573558, 1e-8);
}

TEST(Canopy, StandsOnTheGroundAndEndsAtTheTreesHeight)
{
    const Canopy c = canopy(lone_tree(), {}, kCorner);
    // Leaves from slice 10 on: 9 to 20 m above the ground at the corner's height.
    EXPECT_EQ(c.leaf_area_density.value({32, 32, 9}), 0.0f);
    EXPECT_GT(c.leaf_area_density.value({32, 32, 10}), 0.0f);
    EXPECT_EQ(c.leaf_area_density.value({32, 32, 21}), 0.0f);
    EXPECT_EQ(c.leaf_area_density.transform().world({32, 32, 21}), kCorner + Vec3d(32, 32, 20));
    EXPECT_EQ(c.height.transform().world({0, 0, 0}), kCorner);
    EXPECT_EQ(c.height.value({32, 32, 0}), 20.0f);
    EXPECT_FALSE(c.height.active({32 + 12, 32, 0}));
    EXPECT_EQ(c.terrain.value({3, 3, 0}), 7.0f);
    EXPECT_EQ(c.transmittance.value({32, 32, 0}), 1.0f);
}

TEST(Canopy, HoldsTheShareOfItsLeavesThatATreeOwns)
{
    const Forest forest = grown(inputs_of(90, 75), 12);
    const Canopy c = canopy(forest, {});
    // By the painter's volume of owners.
    const std::vector<std::uint32_t> owner = forest.occupancy(Method::Painter);
    const std::vector<Tree> ranked = forest.ranked();
    std::map<std::uint32_t, double> owned, crown;
    for (std::size_t k = 0; k < 20; ++k)
        for (std::size_t p = 0; p < 90 * 75; ++p) {
            const std::uint32_t rank = owner[k * 90 * 75 + p];
            EXPECT_EQ(c.owner.value({int(p % 90), int(p / 90), int(k) + 1}), std::int32_t(rank));
            if (rank == 0) continue;
            const Tree& tree = ranked[rank - 1];
            const Species& s = forest.inputs().species[tree.species];
            if (double(k + 1) >= s.crown_base * tree.height - 1e-9) owned[rank] += 1;
        }
    for (std::size_t p = 0; p < 90 * 75; ++p) {
        double height = 0;
        for (std::size_t k = 0; k < 20; ++k)
            if (const std::uint32_t rank = owner[k * 90 * 75 + p]) height = ranked[rank - 1].height;
        EXPECT_EQ(c.height.value({int(p % 90), int(p / 90), 0}), float(height));
    }
    double expected = 0;
    for (const auto& [rank, count] : owned) {
        const Tree& tree = ranked[rank - 1];
        const Species& s = forest.inputs().species[tree.species];
        const std::vector<std::uint32_t> own = forest.footprint(tree);
        double all = 0;
        for (std::size_t k = 1; k <= own.size(); ++k)
            if (double(k) >= s.crown_base * tree.height - 1e-9) all += own[k - 1];
        const double radius = std::tan(s.spread / 2) * tree.height;
        expected += s.leaf_area_index * std::numbers::pi * radius * radius * count / all;
    }
    ASSERT_GT(expected, 1000);
    EXPECT_NEAR(sum_of(c.leaf_area_density) / expected, 1, 1e-6);
    EXPECT_NEAR(c.leaf_area / expected, 1, 1e-6);
}

TEST(Canopy, DragIsProportionalToLeafArea)
{
    const Canopy c = canopy(grown(inputs_of(40, 50), 8), {.drag = 0.35});
    ASSERT_GT(c.drag.active_count(), 1000u);
    ASSERT_EQ(c.drag.active_count(), c.leaf_area_density.active_count());
    for (std::size_t leaf = 0; leaf < c.drag.leaf_count(); ++leaf)
        c.drag.mask(leaf).for_each([&](int o) {
            EXPECT_EQ(c.drag.at(leaf, o), float(0.35 * double(c.leaf_area_density.at(leaf, o))));
        });
}

TEST(Canopy, DoesNotDependOnTilesOrThreads)
{
    auto made = [](int tile, std::size_t threads, bool slanted) {
        const ThreadLimit limit(threads);
        Inputs inputs = inputs_of(100, 70);
        inputs.params.tile = tile;
        inputs.land.ground = {100, 70, 0.0f};
        for (int j = 0; j < 70; ++j)
            for (int i = 0; i < 100; ++i) inputs.land.ground.set(i, j, float(0.2 * i - 0.4 * j));
        inputs.density.assign(5, DensityMap(100, 70, density_value(0.75)));
        CanopyParams params;
        if (slanted) params.sun = Vec3d(1, -0.4, 0.8);
        return hashes(canopy(grown(std::move(inputs), 6), params, kCorner));
    };
    for (const bool slanted : {false, true}) {
        const auto first = made(256, 1, slanted);
        for (const int tile : {16, 37, 64}) EXPECT_EQ(made(tile, 4, slanted), first) << tile;
    }
}

TEST(Canopy, FollowsTheGroundByWholeVoxels)
{
    Inputs flat = inputs_of(60, 44), hilly = flat;
    hilly.land.ground = {60, 44, 0.0f};
    for (int j = 0; j < 44; ++j)
        for (int i = 0; i < 60; ++i)
            hilly.land.ground.set(i, j, float(6 * std::sin(0.1 * i) + 0.3 * j - 12.2));
    const Canopy a = canopy(grown(flat, 9), {}, kCorner);
    const Forest forest = grown(hilly, 9);
    const Canopy b = canopy(forest, {}, kCorner);
    EXPECT_DOUBLE_EQ(a.leaf_area, b.leaf_area);
    EXPECT_EQ(a.leaf_area_density.active_count(), b.leaf_area_density.active_count());
    EXPECT_EQ(a.transmittance.active_count(), b.transmittance.active_count());
    for (int j = 0; j < 44; ++j)
        for (int i = 0; i < 60; ++i) {
            const int up = int(std::lround(forest.inputs().land.height(i, j)));
            for (int k = 0; k <= 21; ++k) {
                ASSERT_EQ(a.leaf_area_density.value({i, j, k}),
                          b.leaf_area_density.value({i, j, k + up}));
                ASSERT_EQ(a.transmittance.value({i, j, k}), b.transmittance.value({i, j, k + up}));
            }
            ASSERT_EQ(a.height.value({i, j, 0}), b.height.value({i, j, 0}));
            ASSERT_EQ(a.ground_transmittance.value({i, j, 0}),
                      b.ground_transmittance.value({i, j, 0}));
            ASSERT_FLOAT_EQ(b.terrain.value({i, j, 0}),
                            float(kCorner.z + forest.inputs().land.height(i, j)));
        }
}

TEST(Canopy, UnderASunOverheadIsAsUnderNone)
{
    const Forest forest = grown(inputs_of(50, 40), 6);
    EXPECT_EQ(hashes(canopy(forest, {.sun = Vec3d(0, 0, 3)})), hashes(canopy(forest, {})));
    // A little off, every ray has nearly the same way.
    const Canopy a = canopy(forest, {}), b = canopy(forest, {.sun = Vec3d(1e-9, -1e-9, 1)});
    for (int i = 0; i < 50; ++i)
        for (int z = 1; z <= 20; ++z)
            EXPECT_NEAR(double(a.transmittance.value({i, 17, z})),
                        double(b.transmittance.value({i, 17, z})), 1e-6);
}

TEST(Canopy, ShadowsFallAwayFromTheSun)
{
    // Low in the west: the shadow of the crown, 10 to 20 m high, lies 17 to 35 m to the east.
    const Canopy c = canopy(lone_tree(), {.sun = Vec3d(-std::sqrt(3.0), 0, 1)});
    EXPECT_EQ(c.ground_transmittance.value({20, 32, 0}), 1.0f);
    EXPECT_LT(c.ground_transmittance.value({56, 32, 0}), 0.2f);
    EXPECT_FALSE(c.ground_transmittance.active({20, 32, 0}));
    EXPECT_EQ(c.transmittance.value({10, 32, 15}), 1.0f);
    EXPECT_LT(c.transmittance.value({50, 32, 6}), 0.5f);
    // Wherever it falls, all of it is there.
    for (int n = 0; n < 8; ++n) {
        const double turn = n * std::numbers::pi / 4 + 0.2;
        const Vec3d sun = normalized(Vec3d(std::cos(turn), std::sin(turn), 1));
        const Canopy round = canopy(lone_tree(), {.sun = sun});
        for (int i = 0; i < 65; i += 2)
            for (int j = 0; j < 65; j += 2)
                ASSERT_NEAR(double(round.ground_transmittance.value({i, j, 0})),
                            marched(round.leaf_area_density, {i + 0.5, j + 0.5, 1}, sun,
                                    {65, 65, 0}, false),
                            0.1)
                    << n << " " << i << " " << j;
    }
}

TEST(Canopy, TransmittanceIsTheIntegralAlongTheRay)
{
    for (const Border border : {Border::Clip, Border::Wrap}) {
        Inputs inputs = inputs_of(45, 37);  // no multiples of 8
        inputs.params.border = border;
        inputs.land.ground = {45, 37, 0.0f};
        for (int j = 0; j < 37; ++j)
            for (int i = 0; i < 45; ++i) inputs.land.ground.set(i, j, i < 20 ? 3.0f : 11.0f);
        const Forest forest = grown(std::move(inputs), 7);
        for (const Vec3d sun : {Vec3d(0.7, 0.5, 0.6), Vec3d(-0.9, 0.3, 0.3)}) {
            const Canopy c = canopy(forest, {.sun = sun});
            const Vec3d to = normalized(sun);
            int dark = 0;
            for (int n = 0; n < 300; ++n) {
                const int i = n * 7 % 45, j = n * 11 % 37, up = i < 20 ? 3 : 11,
                          z = up + 1 + n * 5 % 20;
                const double all = marched(c.leaf_area_density, centre_of({i, j, z}), to,
                                           {45, 37, 0}, border == Border::Wrap);
                ASSERT_NEAR(double(c.transmittance.value({i, j, z})), all, 0.03)
                    << i << " " << j << " " << z;
                ASSERT_NEAR(double(c.ground_transmittance.value({i, j, 0})),
                            marched(c.leaf_area_density, {i + 0.5, j + 0.5, double(up) + 1}, to,
                                    {45, 37, 0}, border == Border::Wrap),
                            0.03);
                dark += all < 0.5;
            }
            EXPECT_GT(dark, 30);
        }
    }
}

TEST(Canopy, OfThinForestsLetsMoreLightThrough)
{
    auto mean = [](double density) {
        Inputs inputs = inputs_of(96, 96);
        if (density < 1) inputs.density.assign(5, DensityMap(96, 96, density_value(density)));
        const Canopy c = canopy(grown(std::move(inputs), 25), {});
        double sum = 0;
        for (int j = 0; j < 96; ++j)
            for (int i = 0; i < 96; ++i) sum += double(c.ground_transmittance.value({i, j, 0}));
        return sum / (96 * 96);
    };
    EXPECT_LT(mean(1), 0.98 * mean(0.4));
}

TEST(Canopy, LeavesOfSomeTreesMayBeLeftOut)
{
    Inputs inputs = inputs_of(60, 60);
    Forest forest(inputs);
    forest.plant(std::vector<NewTree>{{.uid = 1, .species = 0, .x = 20.5, .y = 30.5, .height = 20},
                                      {.uid = 2, .species = 2, .x = 45.5, .y = 30.5, .height = 9}});
    const Canopy all = canopy(forest, {});
    const Canopy c = canopy(forest, {}, {}, [](const Tree& t) { return t.uid == 1; });
    EXPECT_EQ(c.leaf_area_density.value({20, 30, 15}), 0.0f);
    EXPECT_EQ(c.transmittance.value({20, 30, 3}), 1.0f);
    EXPECT_EQ(c.ground_transmittance.value({20, 30, 0}), 1.0f);
    EXPECT_EQ(c.height.value({20, 30, 0}), 20.0f);
    EXPECT_EQ(c.owner.value({20, 30, 15}), 1);
    EXPECT_EQ(c.leaf_area_density.value({45, 30, 8}), all.leaf_area_density.value({45, 30, 8}));
    EXPECT_GT(c.leaf_area_density.value({45, 30, 8}), 0.0f);
}

TEST(Canopy, TellsDensityMapsOfAllBands)
{
    Inputs inputs = inputs_of(40, 24);
    inputs.density.assign(5, DensityMap(40, 24, density_value(1)));
    for (int i = 16; i < 21; ++i) inputs.density[3].set(i, 9, density_value(0.4));
    const Canopy c = canopy(Forest(inputs), {}, kCorner);
    EXPECT_NEAR(double(c.density.value({16, 9, 3})), 0.4, 1e-5);
    EXPECT_EQ(c.density.value({16, 9, 2}), 1.0f);
    EXPECT_EQ(c.density.value({15, 9, 3}), 1.0f);
    EXPECT_EQ(c.density.active_count(), 40u * 24 * 5);
    EXPECT_EQ(canopy(Forest(inputs_of(40, 24)), {}).density.active_count(), 40u * 24 * 5);
}

TEST(Canopy, OfNoTreesIsOpenSky)
{
    const Canopy c = canopy(Forest(inputs_of(32, 16)), {.sun = Vec3d(1, 0, 1)});
    for (const FloatGrid* g :
         {&c.leaf_area_density, &c.drag, &c.transmittance, &c.height, &c.ground_transmittance})
        EXPECT_EQ(g->active_count(), 0u);
    EXPECT_EQ(c.transmittance.background(), 1.0f);
    EXPECT_EQ(c.ground_transmittance.background(), 1.0f);
    EXPECT_EQ(c.leaf_area, 0);
}

TEST(Canopy, CanDoWithoutOwners)
{
    const Canopy c = canopy(lone_tree(), {.occupancy = false});
    EXPECT_EQ(c.owner.leaf_count(), 0u);
    EXPECT_EQ(c.leaf_area_density.active_count(), 2431u);
}

/// Fog of finer voxels that fit nowhere.
FloatGrid fine_leaves(double voxel)
{
    FloatGrid fine(LeafTopology::build({{0, 0, 0}, {8, 0, 0}, {-8, 16, 8}}),
                   {Vec3d(30.37, 21.11, 3.3), voxel}, 0);
    for (std::size_t leaf = 0; leaf < 3; ++leaf) {
        fine.expand({leaf});
        for (int o = 0; o < kLeafSize; o += 3) {
            fine.values(leaf)[o] = float(0.1 + 0.01 * (o % 17));
            fine.mask(leaf).set(o);
        }
    }
    return fine;
}

TEST(Canopy, TakesInLeavesOfAnyVoxels)
{
    const Canopy c = canopy(grown(inputs_of(50, 40), 6), {});
    for (const double voxel : {0.23, 1.0, 1.7}) {
        const FloatGrid fine = fine_leaves(voxel);
        const FloatGrid both = with_leaves(c.leaf_area_density, fine);
        EXPECT_EQ(both.transform(), c.leaf_area_density.transform());
        EXPECT_NEAR(sum_of(both),
                    sum_of(c.leaf_area_density) + sum_of(fine) * voxel * voxel * voxel, 1e-2)
            << voxel;
        // Their middle is where it was.
        auto moment = [](const FloatGrid& g) {
            Vec3d sum;
            const double volume = std::pow(g.transform().voxel, 3);
            for (std::size_t leaf = 0; leaf < g.leaf_count(); ++leaf)
                g.mask(leaf).for_each([&](int o) {
                    sum += g.transform().world(centre_of(leaf_coord(g.origin(leaf), o))) *
                           (volume * double(g.at(leaf, o)));
                });
            return sum;
        };
        const Vec3d off = moment(both) - moment(c.leaf_area_density) - moment(fine);
        EXPECT_LT(length(off), 1e-5 * length(moment(both)));
    }
    const FloatGrid none;
    EXPECT_EQ(hashes({.leaf_area_density = with_leaves(c.leaf_area_density, none)})[0],
              hashes({.leaf_area_density = c.leaf_area_density})[0]);
}

TEST(Canopy, ShadesAgainAsItDid)
{
    Inputs inputs = inputs_of(60, 44);
    inputs.land.ground = {60, 44, 0.0f};
    for (int j = 0; j < 44; ++j)
        for (int i = 0; i < 60; ++i) inputs.land.ground.set(i, j, float(0.4 * i - 0.3 * j));
    const Land land = inputs.land;
    const Canopy c = canopy(grown(std::move(inputs), 9), {}, kCorner);
    // As it comes out of a file: without leaves that hold nothing.
    std::vector<Coord> there;
    for (std::size_t leaf = 0; leaf < c.leaf_area_density.leaf_count(); ++leaf)
        if (!c.leaf_area_density.mask(leaf).none())
            there.push_back(c.leaf_area_density.origin(leaf));
    FloatGrid lad(LeafTopology::build(there), c.leaf_area_density.transform(), 0);
    lad.expand();
    for (std::size_t leaf = 0; leaf < lad.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o)
            lad.values(leaf)[o] = c.leaf_area_density.value(leaf_coord(lad.origin(leaf), o));
    const Shade again = shade_of(
        lad,
        [&](int i, int j) {
            return int(std::lround(land.height(std::clamp(i, 0, 59), std::clamp(j, 0, 43))));
        },
        0.5);
    EXPECT_EQ(again.ground_transmittance.transform(), c.ground_transmittance.transform());
    for (int j = 0; j < 44; ++j)
        for (int i = 0; i < 60; ++i) {
            ASSERT_EQ(again.ground_transmittance.value({i, j, 0}),
                      c.ground_transmittance.value({i, j, 0}));
            for (int z = -15; z < 45; ++z)
                ASSERT_EQ(again.transmittance.value({i, j, z}), c.transmittance.value({i, j, z}));
        }
    EXPECT_EQ(again.transmittance.active_count(), c.transmittance.active_count());
}

TEST(Canopy, NamesWhatDoesNotFit)
{
    Inputs coarse = inputs_of(64, 64);
    coarse.params.pixel = 2;
    EXPECT_THAT([&] { canopy(Forest(coarse), {}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("pixel = 2 m, must be 1 m")));
    EXPECT_THAT([] { validate(CanopyParams{.extinction = -1}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("extinction = -1")));
    for (const Vec3d sun : {Vec3d(0, 0, 0), Vec3d(1, 0, 0.01), Vec3d(0, 0, -1)})
        EXPECT_THAT([&] { validate(CanopyParams{.sun = sun}); },
                    ThrowsMessage<InvalidParameter>(HasSubstr("must point upwards")));
}

}  // namespace
}  // namespace sekitei::forest
