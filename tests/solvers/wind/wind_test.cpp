#include "solvers/wind/wind.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <set>
#include <vector>

#include "core/error.h"
#include "core/parallel.h"
#include "grids/level_set.h"
#include "grids/surface_cells.h"
#include "solvers/wind/tunnel_scene.h"
#include "tests/support/lantern.h"

namespace sekitei::wind {
namespace {

constexpr Vec3d kAxis{3.3, -2.7, 0};  // where the object stands

/// A level set of what `distance` says within a box.
FloatGrid level_set(Vec3d lower, Vec3d upper, double voxel,
                    const std::function<double(Vec3d)>& distance)
{
    const Vec3d n = (upper - lower) / voxel;
    const Domain domain{
        {int(std::ceil(n.x - 1e-6)), int(std::ceil(n.y - 1e-6)), int(std::ceil(n.z - 1e-6))},
        {lower, voxel}};
    return level_set_from_function(domain,
                                   [&](Vec3d p) { return distance(lower + p * voxel) / voxel; }, {},
                                   {.steepness = 1, .is_distance = true});
}

/// Turned by quarter turns counterclockwise round the axis, exactly.
Vec3d turned(Vec3d p, int quarters)
{
    Vec3d d = p - kAxis;
    for (int i = 0; i < quarters; ++i) d = {-d.y, d.x, d.z};
    return kAxis + d;
}

FloatGrid block(Vec3d centre, Vec3d half, double voxel, int quarters)
{
    Bounds box;
    box.add(turned(centre - half - Vec3d(6 * voxel), quarters));
    box.add(turned(centre + half + Vec3d(6 * voxel), quarters));
    return level_set(box.lower, box.upper, voxel,
                     [=](Vec3d p) { return lantern::box(turned(p, 4 - quarters), centre, half); });
}

template <class T>
LeafGrid<T> filled(Vec3d lower, Vec3d upper, double voxel, T value)
{
    const Transform transform{kAxis, voxel};  // so that quarter turns keep the voxels
    const auto corner = [&](Vec3d p) {
        const Vec3d v = transform.voxels(p);
        return Coord(int(std::round(v.x)), int(std::round(v.y)), int(std::round(v.z)));
    };
    const Coord a = corner(lower), b = corner(upper);
    std::vector<Coord> leaves;
    for (int i = a.x; i < b.x; ++i)
        for (int j = a.y; j < b.y; ++j)
            for (int k = a.z; k < b.z; ++k) leaves.push_back(leaf_origin({i, j, k}));
    LeafGrid<T> grid(LeafTopology::build(leaves), transform, T{});
    grid.expand();
    for (int i = a.x; i < b.x; ++i)
        for (int j = a.y; j < b.y; ++j)
            for (int k = a.z; k < b.z; ++k) {
                const std::size_t leaf = grid.topology()->find(leaf_origin({i, j, k}));
                grid.values(leaf)[leaf_offset({i, j, k})] = value;
                grid.mask(leaf).set(leaf_offset({i, j, k}));
            }
    return grid;
}

/// A slim stone with a fence to its north, a pond to its west and bushes.
struct Garden {
    FloatGrid stone, fence, bush;
    IntGrid pond;
    std::vector<Vec3d> cells;

    explicit Garden(int quarters = 0)
        : stone(block(kAxis + Vec3d(0, 0, 0.45), {0.22, 0.31, 0.45}, 0.05, quarters)),
          fence(block(kAxis + Vec3d(0.7, 2.13, 0.9), {3.1, 0.1, 0.9}, 0.1, quarters)),
          bush(filled<float>({}, {}, 0.25, 0)),
          pond(filled<std::int32_t>({}, {}, 0.25, 0))
    {
        cells = surface_cells(stone, {}).position;
        const auto box = [&](Vec3d lower, Vec3d upper) {
            Bounds b;
            b.add(turned(kAxis + lower, quarters)), b.add(turned(kAxis + upper, quarters));
            return b;
        };
        const Bounds green = box({1.25, -4, 0}, {4, -2.25, 1.5});
        bush = filled<float>(green.lower, green.upper, 0.25, 0.7f);
        const Bounds water = box({-4.5, -2.25, -0.25}, {-1, 2, 0});
        pond = filled<std::int32_t>(water.lower, water.upper, 0.25, 1);
    }
    Inputs inputs() const { return {&stone, &fence, &pond, &bush, cells}; }
};

/// Coarse and short: what is wanted here is not the wind itself.
Params quick()
{
    Params params;
    params.garden_size = Vec3d(15, 12, 5);
    params.garden_spacing = 0.5;
    params.object_spacing = 0.15;
    params.settle = 1;
    params.duration = 1;
    params.per_layer = true;
    params.ground = 0;
    return params;
}

void expect_same(const Result& a, const Result& b)
{
    EXPECT_EQ(a.tables.speed, b.tables.speed);
    EXPECT_EQ(a.tables.temperature, b.tables.temperature);
    EXPECT_EQ(a.tables.humidity, b.tables.humidity);
    EXPECT_EQ(a.tables.direction, b.tables.direction);
    EXPECT_EQ(a.tables.layers, b.tables.layers);
    EXPECT_EQ(a.arrival, b.arrival);
    for (std::size_t k = 0; k < 8; ++k) EXPECT_EQ(a.ratio[k], b.ratio[k]);
    EXPECT_EQ(a.notes, b.notes);
}

// ---------------------------------------------------------------- scenes in a tunnel

TEST(TunnelScene, TheTunnelPointsWhereTheWindGoes)
{
    const double azimuth[] = {0, 45, 90, 135, 180, 225, 270, 315};
    for (int k = 0; k < 8; ++k) {
        const Heading way = Heading::from(k, kAxis);
        const double a = azimuth[k] * M_PI / 180;
        EXPECT_NEAR(way.along.x, -std::sin(a), 1e-15);
        EXPECT_NEAR(way.along.y, -std::cos(a), 1e-15);
        EXPECT_LT(length(cross(way.along, way.across) - Vec3d(0, 0, 1)), 1e-15);
        EXPECT_LT(length(way.world(way.tunnel({1, 2, 3})) - Vec3d(1, 2, 3)), 1e-14);
    }
}

/// The cubes that are solid in a tunnel of 12 x 10 x 4 m round the axis.
struct Cubes {
    static constexpr double kEdge = 0.5;
    WindTunnel tunnel;
    Coord n{24, 20, 8};

    Cubes(const TunnelContents& contents, int direction)
    {
        tunnel.lower = {-6, -5, 0};
        tunnel.size = {12, 10, 4};
        tunnel = fill_tunnel(tunnel, kEdge, Heading::from(direction, kAxis), contents, {});
    }
    Vec3d centre(Coord c) const { return tunnel.lower + (Vec3d(c) + Vec3d(0.5)) * kEdge; }
    bool solid(Coord c) const { return tunnel.solid(centre(c)); }
    int count() const
    {
        int found = 0;
        for (int i = 0; i < n.x; ++i)
            for (int j = 0; j < n.y; ++j)
                for (int k = 0; k < n.z; ++k) found += solid({i, j, k});
        return found;
    }
};

TEST(TunnelScene, ABlockFillsItsVolume)
{
    const Vec3d half(1.7, 0.9, 1.1);
    const FloatGrid stone = block(kAxis + Vec3d(0, 0, 1.1), half, 0.1, 0);
    const double volume = 3.4 * 1.8 * 2.2;
    for (int k = 0; k < 8; ++k)
        EXPECT_NEAR(Cubes({.solids = {&stone}}, k).count() * 0.125, volume, 0.2 * volume) << k;
}

TEST(TunnelScene, AFenceIsOneCubeThickAndTightAtAnyAngle)
{
    // Across the whole tunnel, 0.2 m thick, 1.8 m high.
    const FloatGrid fence = block(kAxis + Vec3d(0, 0.13, 0.9), {9, 0.1, 0.9}, 0.1, 0);
    for (int k = 0; k < 8; ++k) {
        const Cubes cubes({.solids = {&fence}}, k);
        if (k % 4 == 0) {
            EXPECT_EQ(cubes.count(), 20 * 4);  // a row of 20, 4 high
        }
        for (int j = 0; j < cubes.n.y; ++j) EXPECT_FALSE(cubes.solid({12, j, 4}));
        if (k % 4 == 2) continue;  // along the wind
        // Air at the ground cannot go from end to end.
        std::set<Coord> reached;
        std::vector<Coord> front;
        const auto reach = [&](Coord c) {
            if (c.x < 0 || c.y < 0 || c.z < 0 || c.x >= cubes.n.x || c.y >= cubes.n.y || c.z > 2)
                return;
            if (!cubes.solid(c) && reached.insert(c).second) front.push_back(c);
        };
        // From the corner on the fence's far side, which at any angle lies upstream.
        const int j = k % 4 == 1 ? 0 : k % 4 == 3 ? cubes.n.y - 1 : 10;
        reach(k < 2 || k > 6 ? Coord(0, j, 0) : Coord(0, cubes.n.y - 1 - j, 0));
        while (!front.empty()) {
            const Coord c = front.back();
            front.pop_back();
            for (int a = 0; a < 3; ++a)
                for (const int s : {-1, 1}) {
                    Coord next = c;
                    next[a] += s;
                    reach(next);
                }
        }
        const double side = k < 2 || k > 6 ? 1 : -1;  // north of it, or south
        for (const Coord& c : reached) {
            const Vec3d p = Heading::from(k, kAxis).world(cubes.centre(c));
            ASSERT_GT(side * (p.y - kAxis.y - 0.13), -0.4) << "direction " << k;
        }
        EXPECT_GT(reached.size(), 100u) << k;
    }
}

TEST(TunnelScene, ARockThatIsCutOffGoesOnSidewaysAndOneThatIsWholeDoesNot)
{
    const auto shelf = [](Vec3d p) { return p.z - 1.2; };
    const Vec3d lower = kAxis + Vec3d(-1, -1, -0.4), upper = kAxis + Vec3d(1, 1, 2.4);
    const FloatGrid cut = level_set(lower, upper, 0.1, shelf);
    EXPECT_EQ(Cubes({.solids = {&cut}}, 1).count(), 24 * 20 * 2);
    const FloatGrid whole = block(kAxis + Vec3d(0, 0, 1), Vec3d(1), 0.1, 0);
    EXPECT_EQ(Cubes({.solids = {&whole}}, 0).count(), 64);
}

TEST(TunnelScene, WaterLiesWhereItsVoxelsAre)
{
    const Garden garden;
    const Heading way = Heading::from(7, kAxis);
    const WindTunnel tunnel = Cubes({.water = &garden.pond}, 7).tunnel;
    const auto level = [&](Vec3d p) {
        const Vec3d t = way.tunnel(kAxis + p);
        return tunnel.water_level(t.x, t.y);
    };
    EXPECT_NEAR(level({-3, 0.1, 0}), 0, 1e-12);
    EXPECT_NEAR(level({-4.4, 1.9, 0}), 0, 1e-12);
    EXPECT_TRUE(std::isnan(level({-0.9, 0, 0})));
    EXPECT_TRUE(std::isnan(level({-3, 2.1, 0})));
    // A pond whose surface is a metre up fills what is below.
    const IntGrid high =
        filled<std::int32_t>(kAxis + Vec3d(-2, -2, 0.75), kAxis + Vec3d(2, 2, 1), 0.25, 1);
    const Cubes cubes({.water = &high}, 0);
    EXPECT_NEAR(cubes.count(), 8 * 8 * 2, 16);
    EXPECT_TRUE(cubes.solid({12, 10, 1}));
    EXPECT_FALSE(cubes.solid({12, 10, 2}));
}

TEST(TunnelScene, PlantsKeepTheirDragInWhole)
{
    const Garden garden;
    for (int k = 0; k < 8; ++k) {
        if (k % 4 == 1) continue;  // a corner of it is outside
        const Cubes cubes({.canopy = &garden.bush}, k);
        double sum = 0, most = 0;
        for (int i = 0; i < cubes.n.x; ++i)
            for (int j = 0; j < cubes.n.y; ++j)
                for (int l = 0; l < cubes.n.z; ++l) {
                    const double drag = cubes.tunnel.canopy(cubes.centre({i, j, l}));
                    sum += drag * 0.125, most = std::max(most, drag);
                }
        EXPECT_NEAR(sum, 0.7 * 2.75 * 1.75 * 1.5, 0.05 * 5) << k;
        EXPECT_NEAR(most, 0.7, 1e-6) << k;
    }
    EXPECT_FALSE(Cubes({}, 0).tunnel.canopy);
}

// ---------------------------------------------------------------- both stages

TEST(Wind, TurningTheSceneTurnsTheTables)
{
    const Garden garden(0), turned(3);  // three turns to the left are one to the right: N to E
    const Result a = run(garden.inputs(), quick(), {}), b = run(turned.inputs(), quick(), {});
    double spread = 0;
    for (std::size_t k = 0; k < 8; ++k) {
        const std::size_t to = (k + 2) % 8;
        EXPECT_NEAR(a.tables.speed[k], b.tables.speed[to], 1e-3) << k;
        EXPECT_NEAR(a.tables.temperature[k], b.tables.temperature[to], 0.01) << k;
        const double difference = b.tables.direction[to] - a.tables.direction[k] - M_PI / 2;
        EXPECT_NEAR(std::remainder(difference, 2 * M_PI), 0, 0.01) << k;
        spread = std::max(spread, std::abs(a.tables.speed[k] - a.tables.speed[to]));
    }
    EXPECT_GT(spread, 0.2);
}

TEST(Wind, AFencePondAndBushDoWhatTheyShould)
{
    const Garden garden;
    const Params params = quick();
    const Result r = run(garden.inputs(), params, {});
    enum { N, NE, E, SE, S, SW, W, NW };
    EXPECT_LT(r.tables.speed[N], 0.45);
    EXPECT_LT(r.tables.speed[N], r.tables.speed[S]);
    EXPECT_GT(r.tables.speed[W], 0.8);
    EXPECT_GT(r.tables.temperature[W], 1);
    EXPECT_EQ(r.tables.temperature[E], 0);
    EXPECT_EQ(r.tables.temperature, r.tables.humidity);
    ASSERT_EQ(r.tables.layers.size(), 3u);  // 0.9 m and a margin of 0.5 m
    EXPECT_GT(r.tables.layers[0][W], 4 * r.tables.layers[1][W]);
    // What meets the fence at an angle goes along it.
    EXPECT_GT(r.tables.direction[NE], 1.15 * M_PI / 4);
    EXPECT_LT(r.tables.direction[NW], 6.85 * M_PI / 4);
    // Behind the fence the air comes back.
    EXPECT_EQ(r.arrival[N], S);
    EXPECT_EQ(r.arrival[W], W);
    EXPECT_EQ(r.ratio[N], r.ratio[S]);

    // With wind from the west, the west face is met head on, the south and north are passed by.
    double west = 0, east = 0, top = 0;
    int wests = 0, easts = 0, tops = 0;
    for (std::size_t i = 0; i < garden.cells.size(); ++i) {
        const Vec3d p = garden.cells[i] - kAxis;
        const float ratio = r.ratio[W][i];
        ASSERT_GE(ratio, 0);
        ASSERT_LT(ratio, 2);
        if (p.x < -0.18 && p.z > 0.2 && p.z < 0.7) west += ratio, ++wests;
        if (p.x > 0.18 && p.z > 0.2 && p.z < 0.7) east += ratio, ++easts;
        if (p.z > 0.86) top += ratio, ++tops;
    }
    EXPECT_LT(east / easts, west / wests);
    EXPECT_GT(top / tops, west / wests);
}

TEST(Wind, AnInterruptedRunEndsLikeAnotherOnAnyNumberOfThreads)
{
    const Garden garden;
    Params params = quick();
    params.settle = params.duration = 0.3;
    int saved = 0;
    std::vector<State> states;
    const Result whole = run(garden.inputs(), params, {}, {}, [&](const State& state) {
        ++saved;
        if (saved == 3 || saved == 10) states.push_back(state);
    });
    std::set<int> arrivals(whole.arrival.begin(), whole.arrival.end());
    EXPECT_EQ(saved, 8 + int(arrivals.size()));
    ASSERT_EQ(states.size(), 2u);
    for (const State& state : states) {
        const ThreadLimit limit(state.object[0] ? 3 : 1);
        int rest = 0;
        expect_same(run(garden.inputs(), params, {}, state, [&](const State&) { ++rest; }), whole);
        EXPECT_EQ(rest, saved - (&state == &states[0] ? 3 : 10));
    }
    State other = states[1];
    for (auto& ratios : other.arrival) ratios.resize(ratios.size() / 2);
    EXPECT_THROW(run(garden.inputs(), params, {}, other), InvalidInput);
}

TEST(Wind, StopsWhenAskedAndTellsHowFarItIs)
{
    const Garden garden;
    std::atomic<bool> cancel = false;
    double last = -1;
    const Progress progress(
        [&](const std::string&, double fraction) {
            EXPECT_GE(fraction, last);
            last = fraction;
            if (fraction > 0.1) cancel = true;
        },
        &cancel);
    EXPECT_THROW(run(garden.inputs(), quick(), progress), Cancelled);
    EXPECT_GT(last, 0.1);
    EXPECT_LT(last, 0.2);
}

TEST(Wind, BothSolversTakeTheSameTunnel)
{
    const Garden garden;
    Params params = quick();
    params.garden_size = Vec3d(9, 6, 4);
    params.object_spacing = 0.3;
    params.settle = params.duration = 0.5;
    State done;  // one direction of each stage is enough
    for (std::size_t k = 1; k < 8; ++k) {
        done.garden[k] = done.object[k] = true;
        done.arrival[k].assign(garden.cells.size(), 0);
    }
    done.tables.layers.resize(3);
    const Result grid = run(garden.inputs(), params, {}, done);
    params.solver = Solver::Mps;
    const Result particles = run(garden.inputs(), params, {}, done);
    EXPECT_NEAR(grid.tables.speed[0], particles.tables.speed[0], 0.3);
    EXPECT_GT(particles.tables.speed[0], 0.02);
}

TEST(Wind, WhereNoAirComesIsSaid)
{
    Garden garden;
    const FloatGrid shelf = level_set(kAxis + Vec3d(-2, -2, -1), kAxis + Vec3d(2, 2, 3), 0.2,
                                      [](Vec3d p) { return p.z - 40; });
    Inputs inputs = garden.inputs();
    inputs.obstacle = &shelf;
    const Result buried = run(inputs, quick(), {});
    EXPECT_EQ(buried.tables.speed[3], 0);
    EXPECT_EQ(buried.tables.temperature[3], 0);
    EXPECT_THAT(buried.notes,
                testing::Contains("wind from SE: no air reaches the object's place; A_U = 0"));
    inputs = garden.inputs();
    inputs.object = &shelf;
    const Result inside = run(inputs, quick(), {});
    EXPECT_THAT(inside.notes, testing::Contains(testing::HasSubstr("no air passes it")));
    EXPECT_EQ(*std::max_element(inside.ratio[2].begin(), inside.ratio[2].end()), 0);
}

TEST(Wind, TheLanternsBoxesAreThePapers)
{
    const lantern::Body body(0.02);
    const Plan boxes = plan({.object = &body.surface, .cells = body.cells.position}, {});
    EXPECT_EQ(boxes.garden_size, Vec3d(24, 16, 8));
    EXPECT_EQ(boxes.place, 14);
    EXPECT_EQ(boxes.garden_spacing, 0.5);
    EXPECT_EQ(boxes.object_spacing, 0.05);
    EXPECT_EQ(boxes.object_margin, 0.4);
    EXPECT_EQ(boxes.sample_radius, 0.1);
    EXPECT_LT(length(boxes.axis), 1e-9);
    EXPECT_EQ(boxes.garden_count, 48 * 32 * 16);
    EXPECT_TRUE(boxes.notes.empty());
    EXPECT_LT(boxes.bytes, 30e6);
}

TEST(Wind, ACliffGetsCoarserBoxesAndSaysSo)
{
    const FloatGrid cliff = block(kAxis + Vec3d(0, 0, 3), {6, 4, 3}, 0.25, 0);
    const std::vector<Vec3d> cells = surface_cells(cliff, {}).position;
    const Inputs inputs{.object = &cliff, .cells = cells};
    Params params;
    const Plan boxes = plan(inputs, params);
    EXPECT_LE(boxes.object_count, 1.1 * params.largest_count);
    EXPECT_LE(boxes.garden_count, 1.1 * params.largest_count);
    EXPECT_GT(boxes.garden_size.x, 30);
    EXPECT_EQ(boxes.object_margin, 3);
    EXPECT_EQ(boxes.sample_radius, 2 * boxes.object_spacing);
    EXPECT_EQ(boxes.notes.size(), 2u);
    EXPECT_THAT(boxes.notes[1], testing::HasSubstr("m instead of 0.05 m: its box would hold"));
    params.object_spacing = 0.02;
    EXPECT_THROW(plan(inputs, params), LimitExceeded);
}

TEST(Wind, NamesWhatIsWrong)
{
    const Garden garden;
    const auto message = [&](const Inputs& inputs, const Params& params) {
        try {
            plan(inputs, params);
        } catch (const InvalidInput& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    EXPECT_THAT(message({}, {}), testing::HasSubstr("no_surface_cells"));
    Params params;
    params.speed = 0;
    EXPECT_THAT(message(garden.inputs(), params), testing::HasSubstr("wind: speed = 0"));
    params = {};
    params.garden_size = Vec3d(8, 1.5, 4);
    EXPECT_THAT(message(garden.inputs(), params),
                testing::HasSubstr("wind: garden_size = 8 x 1.5 x 4 m, must hold the probe"));
}

}  // namespace
}  // namespace sekitei::wind
