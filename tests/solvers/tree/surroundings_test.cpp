#include "solvers/tree/surroundings.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/mesh_io.h"
#include "core/parallel.h"
#include "core/random.h"
#include "grids/level_set.h"
#include "tests/support/shapes.h"

namespace sekitei::tree {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr double kVoxel = 0.07;
const Vec3d kCentre{1.3, -0.4, 2.1};
constexpr double kRadius = 0.9;

Vec3d unit(double u, double v)
{
    const double z = 2 * u - 1, r = std::sqrt(1 - z * z), a = 2 * std::numbers::pi * v;
    return {r * std::cos(a), r * std::sin(a), z};
}
Vec3d random_unit(std::uint64_t key)
{
    return unit(uniform_of_key(key, 1), uniform_of_key(key, 2));
}
Vec3d random_place(std::uint64_t key, Vec3d lower, Vec3d upper)
{
    Vec3d p;
    for (int k = 0; k < 3; ++k)
        p[k] = lower[k] + (upper[k] - lower[k]) * uniform_of_key(key, std::uint64_t(10 + k));
    return p;
}

FloatGrid ball_grid()
{
    const Domain domain{Coord(40),
                        {kCentre - Vec3d(20 * kVoxel) + Vec3d(0.01, 0.02, 0.03), kVoxel}};
    return level_set_from_function(
        domain,
        [&](Vec3d p) { return (length(domain.transform.world(p) - kCentre) - kRadius) / kVoxel; },
        {}, {.steepness = 1, .is_distance = true});
}

/// How far a half-line stays from a place.
double passes_at(Vec3d from, Vec3d direction, Vec3d place)
{
    const double along = std::max(0.0, dot(place - from, direction));
    return length(from + direction * along - place);
}

void expect_ball(const Obstacle& ball, double tolerance)
{
    for (std::uint64_t i = 0; i < 2000; ++i) {
        const Vec3d at = random_place(i, kCentre - Vec3d(2), kCentre + Vec3d(2));
        const Vec3d way = random_unit(i);
        const double nearest = passes_at(at, way, kCentre);
        if (std::abs(nearest - kRadius) > tolerance) {
            EXPECT_EQ(ball.blocks(at, way), nearest < kRadius) << i << " at " << nearest;
        }
        const double distance = length(at - kCentre) - kRadius, said = ball.distance(at);
        if (std::abs(distance) < ball.reach()) {
            EXPECT_NEAR(said, distance, tolerance);
            EXPECT_GT(dot(ball.away(at), normalized(at - kCentre)), 0.99);
        } else {
            EXPECT_EQ(said < 0, distance < 0);
            EXPECT_GE(std::abs(said), ball.reach() - tolerance);
        }
    }
}

TEST(Surroundings, ALevelSetBlocksWhatABallBlocks)
{
    const FloatGrid grid = ball_grid();
    const auto ball = level_set_obstacle(grid);
    EXPECT_NEAR(ball->reach(), 2.25 * kVoxel, 1e-6);
    expect_ball(*ball, 0.02 * kVoxel + 0.002);
}

TEST(Surroundings, AMeshBlocksWhatABallBlocks)
{
    const TriMesh mesh = shapes::ball(kCentre, kRadius, 6);
    expect_ball(*mesh_obstacle(mesh, 0.4, {}), 1e-3);
    expect_ball(*mesh_obstacle(shapes::inverted(mesh), 0.4, {}), 1e-3);
}

TEST(Surroundings, RaysAlongAxesAndThroughVoxelCornersAreSeen)
{
    const FloatGrid grid = ball_grid();
    const auto ball = level_set_obstacle(grid);
    for (int k = 0; k < 3; ++k)
        for (const double sign : {-1.0, 1.0}) {
            Vec3d way;
            way[k] = sign;
            // From afar, from a node and from inside; and away from the ball.
            EXPECT_TRUE(ball->blocks(kCentre - way * 500, way));
            EXPECT_TRUE(ball->blocks(grid.transform().world(centre_of(Coord(20))), way));
            EXPECT_FALSE(ball->blocks(kCentre - way * 500, -way));
            EXPECT_FALSE(ball->blocks(kCentre + way * 1.0, way));
            Vec3d aside;
            aside[(k + 1) % 3] = kRadius + 0.01;
            EXPECT_FALSE(ball->blocks(kCentre - way * 5 + aside, way));
        }
}

TEST(Surroundings, GrazingRaysAreSeen)
{
    const FloatGrid grid = ball_grid();
    const auto ball = level_set_obstacle(grid);
    for (std::uint64_t i = 0; i < 2000; ++i) {
        const Vec3d way = random_unit(i), side = normalized(cross(way, random_unit(i + 9999)));
        const Vec3d from = kCentre - way * 3;
        EXPECT_TRUE(ball->blocks(from + side * (kRadius - 0.03 * kVoxel), way)) << i;
        EXPECT_FALSE(ball->blocks(from + side * (kRadius + 0.03 * kVoxel), way)) << i;
    }
}

TEST(Surroundings, SharpEdgesHaveTheirInside)
{
    // Near edges and corners the nearest triangle alone does not tell the side.
    const Vec3d lower(-0.3, 0.2, 0.1), upper(0.9, 0.7, 2);
    const auto box = mesh_obstacle(shapes::box(lower, upper), 0.5, {});
    for (std::uint64_t i = 0; i < 3000; ++i) {
        const Vec3d at = random_place(i, lower - Vec3d(0.4), upper + Vec3d(0.4));
        const Vec3d out = max(max(lower - at, at - upper), Vec3d(0));
        const Vec3d in = min(at - lower, upper - at);
        const double inside = std::min({in.x, in.y, in.z});
        if (std::abs(inside) < 1e-6) continue;
        const double exact = inside > 0 ? -inside : length(out);
        if (exact < 0.5) {
            EXPECT_NEAR(box->distance(at), exact, 1e-6) << i;
        }
    }
}

TEST(Surroundings, PartsOfAMeshMayOverlap)
{
    TriMesh mesh = shapes::box({0, 0, 0}, {2, 1, 1});
    const TriMesh other = shapes::box({1, 0.25, 0.25}, {3, 0.75, 0.75});
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), other.vertices.begin(), other.vertices.end());
    for (const auto& t : other.triangles)
        mesh.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
    const auto both = mesh_obstacle(mesh, 0.2, {});
    EXPECT_LT(both->distance({1.9, 0.5, 0.5}), 0);  // inside both, by a wall of the first
    EXPECT_LT(both->distance({1.1, 0.9, 0.5}), 0);
    EXPECT_NEAR(both->distance({2.5, 0.5, 0.85}), 0.1, 1e-6);
}

TEST(Surroundings, LevelSetAndMeshOfARockAgree)
{
    const TriMesh rock = read_mesh(SEKITEI_DATA "/meshes/boulder.ply");
    const Bounds box = rock.bounds();
    const double voxel = 0.015;
    const Transform transform{box.lower - Vec3d(8 * voxel), voxel};
    const FloatGrid grid = level_set_from_mesh(rock, transform, {});
    const auto by_grid = level_set_obstacle(grid);
    const auto by_mesh = mesh_obstacle(rock, by_grid->reach(), {});
    // Tips around the rock as a tree beside it has them, not nearer than a voxel, and patches of
    // the sky by rows of 16.
    std::size_t asked = 0, differ = 0, hit = 0;
    for (std::uint64_t tip = 0; asked < 2000 * 128; ++tip) {
        const Vec3d at =
            random_place(tip, box.lower - Vec3d(0.1), box.upper + Vec3d(0.1, 0.1, 0.7));
        const double distance = by_mesh->distance(at);
        const double other = by_grid->distance(at);
        // Inside, walls of one part lie within the other.
        if (distance > 0 && distance < by_grid->reach()) {
            EXPECT_NEAR(other, distance, voxel) << at.x << " " << at.y << " " << at.z;
        }
        if (distance < voxel) continue;
        for (int v = 0; v < 8; ++v)
            for (int h = 0; h < 16; ++h) {
                const double t = (v + 0.5) * std::numbers::pi / 8;
                const double a = (h + 0.5) * 2 * std::numbers::pi / 16;
                const Vec3d way{std::sin(t) * std::cos(a), std::sin(t) * std::sin(a), std::cos(t)};
                const bool one = by_grid->blocks(at, way), two = by_mesh->blocks(at, way);
                ++asked;
                differ += one != two;
                hit += two;
            }
    }
    EXPECT_GT(hit, asked / 10);
    EXPECT_LT(hit, asked * 9 / 10);
    EXPECT_LE(double(differ), 0.005 * double(asked));
    RecordProperty("differ", std::to_string(double(differ) / double(asked)));
}

TEST(Surroundings, AnswersAreTheSameOnAnyNumberOfThreads)
{
    const FloatGrid grid = ball_grid();
    const auto ball = level_set_obstacle(grid);
    const auto mesh = mesh_obstacle(shapes::ball(kCentre, kRadius, 3), 0.3, {});
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        std::vector<double> found(4000);
        parallel_for(found.size(), [&](std::size_t i) {
            const Vec3d at = random_place(i, kCentre - Vec3d(2), kCentre + Vec3d(2));
            found[i] = ball->distance(at) + mesh->distance(at) + mesh->away(at).x +
                       (ball->blocks(at, random_unit(i)) ? 7 : 0);
        });
        return found;
    };
    EXPECT_EQ(on(1), on(4));
}

TEST(Surroundings, TheNearestObstacleIsFound)
{
    Surroundings around;
    EXPECT_TRUE(around.empty());
    double distance = 0;
    EXPECT_EQ(around.nearest({0, 0, 0}, distance), nullptr);
    around.obstacles.push_back(mesh_obstacle(shapes::box({0, 0, 0}, {1, 1, 1}), 1, {}));
    around.obstacles.push_back(mesh_obstacle(shapes::box({3, 0, 0}, {4, 1, 1}), 1, {}));
    EXPECT_EQ(around.nearest({2.5, 0.5, 0.5}, distance), around.obstacles[1].get());
    EXPECT_NEAR(distance, 0.5, 1e-6);
    EXPECT_EQ(around.nearest({1.5, 0.5, 9}, distance), nullptr);
    EXPECT_TRUE(around.blocks({2, 0.5, 0.5}, {-1, 0, 0}));
    EXPECT_TRUE(around.blocks({2, 0.5, 0.5}, {1, 0, 0}));
    EXPECT_FALSE(around.blocks({2, 0.5, 0.5}, {0, 0, 1}));
}

TEST(Surroundings, WhatIsNoLevelSetIsRefused)
{
    const auto topology = box_topology(Coord(0), Coord(16));
    FloatGrid empty(topology, {{}, 0.1}, 0.3f);
    EXPECT_THAT([&] { level_set_obstacle(empty); },
                ThrowsMessage<InvalidInput>(HasSubstr("no active voxels")));
    FloatGrid outside = empty;
    outside.mask(0) = LeafMask::full();
    EXPECT_THAT([&] { level_set_obstacle(outside); },
                ThrowsMessage<InvalidInput>(HasSubstr("nothing is inside")));
    FloatGrid fog = outside;
    fog.set_background(0);
    EXPECT_THAT([&] { level_set_obstacle(fog); },
                ThrowsMessage<InvalidInput>(HasSubstr("background = 0 m")));
    FloatGrid broken = outside;
    broken.set_constant(0, NAN);
    EXPECT_THAT([&] { level_set_obstacle(broken); }, ThrowsMessage<InvalidInput>(HasSubstr("NaN")));
    EXPECT_THROW(level_set_obstacle(FloatGrid{}), InvalidInput);
    EXPECT_THROW(mesh_obstacle({}, 1, {}), InvalidInput);
    EXPECT_THAT([] { mesh_obstacle(shapes::box({}, Vec3d(1)), 0, {}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("reach")));
    TriMesh nan = shapes::box({}, Vec3d(1));
    nan.vertices[3].y = NAN;
    EXPECT_THROW(mesh_obstacle(nan, 1, {}), InvalidInput);
}

/// Density by f(voxel index) in [0, n)^3.
template <class F>
FloatGrid fog(int n, const Transform& transform, F&& f)
{
    FloatGrid grid = FloatGrid::uninitialised(box_topology(Coord(0), Coord(n)), transform, 0);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) {
            const Coord c = leaf_coord(grid.origin(leaf), o);
            const bool in = c.x < n && c.y < n && c.z < n;
            grid.values(leaf)[o] = in ? static_cast<float>(f(c)) : 0;
            if (in) grid.mask(leaf).set(o);
        }
    return grid;
}

TEST(BackgroundShade, OfAnEvenCanopyFollowsBeersLaw)
{
    const double density = 0.3, voxel = 0.25;
    FloatGrid grid = fog(48, {{2, 3, 4}, voxel}, [&](Coord) { return density; });
    for (const bool packed : {false, true}) {
        if (packed) grid.compress();
        const BackgroundShade shade(grid, 0.5);
        const Vec3d from{-1, 8.9, 9.1}, way = normalized(Vec3d(1, 0.2, 0.3));
        // From x = 2 to x = 14; at each wall the density falls to 0 within half a voxel either way.
        const double path = 12 / way.x;
        EXPECT_NEAR(shade.transmittance(from, way), std::exp(-0.5 * density * path), 1e-6);
        EXPECT_EQ(shade.transmittance(from, -way), 1);
        EXPECT_NEAR(shade.transmittance({8, 9, 10}, {0, 0, 1}), std::exp(-0.5 * density * 6), 1e-6);
        EXPECT_EQ(shade.transmittance({8, 9, 17}, {0, 0, 1}), 1);
    }
}

TEST(BackgroundShade, IsExactForTheTrilinearField)
{
    const double voxel = 0.3;
    const FloatGrid grid = fog(19, {{-1, 0.5, 2}, voxel}, [](Coord c) {
        return uniform_of_key(5, std::uint64_t(c.x * 361 + c.y * 19 + c.z));
    });
    const BackgroundShade shade(grid, 0.7);
    for (std::uint64_t i = 0; i < 20; ++i) {
        const Vec3d from = random_place(i, {-2, 0, 1}, {5, 6, 8}), way = random_unit(i);
        GridReader<float> reader(grid);
        const int steps = 40000;
        const double step = 20.0 / steps;
        double depth = 0;
        for (int k = 0; k < steps; ++k)
            depth +=
                step *
                double(reader.sample(grid.transform().voxels(from + way * ((k + 0.5) * step))));
        EXPECT_NEAR(shade.transmittance(from, way), std::exp(-0.7 * depth), 2e-5) << i;
    }
}

TEST(BackgroundShade, GrowsUpWithTheTrees)
{
    // 8 m of leaves from 4 m above a foot on; half as high they are twice as dense.
    const double density = 0.25;
    const FloatGrid grid =
        fog(64, {{-32, -32, 14}, 1}, [&](Coord c) { return c.z < 8 ? density : 0; });
    BackgroundShade shade(grid, 0.5);
    shade.set_growth(0.5, {{3, 3, 10}, {900, 0, 500}});
    for (const Vec3d way : {Vec3d(0, 0, 1), {0.3, -0.2, 1}}) {
        const Vec3d d = normalized(way);
        const double all = 0.5 * density * 8 / d.z;
        EXPECT_NEAR(shade.transmittance({0, 0, 10}, d), std::exp(-all), 1e-9);
        EXPECT_NEAR(shade.transmittance({0, 0, 14}, d), std::exp(-all / 2), 1e-9);
        EXPECT_EQ(shade.transmittance({0, 0, 16.6}, d), 1);
        EXPECT_NEAR(shade.transmittance({0, 0, 17}, -d), std::exp(-all), 1e-9);
    }
    shade.set_lit_from_below(true);
    EXPECT_EQ(shade.transmittance({0, 0, 17}, {0, 0, -1}), 1);
    EXPECT_NEAR(shade.transmittance({0, 0, 10}, {0, 0, 1}), std::exp(-0.5 * density * 8), 1e-9);
    EXPECT_THROW(shade.set_growth(0, {{0, 0, 0}}), InvalidParameter);
    EXPECT_THROW(shade.set_growth(0.5, {}), InvalidParameter);
}

TEST(BackgroundShade, OpaqueAndEmptyCanopies)
{
    const FloatGrid thick = fog(16, {{}, 1}, [](Coord) { return 1e4; });
    EXPECT_EQ(BackgroundShade(thick, 1).transmittance({-5, 8, 8}, {1, 0, 0}), 0);
    EXPECT_EQ(BackgroundShade(thick, 0).transmittance({-5, 8, 8}, {1, 0, 0}), 1);
    const FloatGrid none(LeafTopology::build({}), {{}, 1}, 0);
    EXPECT_EQ(BackgroundShade(none, 1).transmittance({}, {1, 0, 0}), 1);
}

TEST(BackgroundShade, RefusesWhatIsNoDensity)
{
    const FloatGrid negative = fog(8, {{}, 1}, [](Coord) { return -1; });
    EXPECT_THAT([&] { BackgroundShade(negative, 0.5); },
                ThrowsMessage<InvalidInput>(HasSubstr("below 0")));
    FloatGrid good = fog(8, {{}, 1}, [](Coord) { return 1; });
    EXPECT_THAT([&] { BackgroundShade(good, 1.5); },
                ThrowsMessage<InvalidParameter>(HasSubstr("leaf_projection = 1.5")));
    good.set_background(3);
    EXPECT_THAT([&] { BackgroundShade(good, 0.5); },
                ThrowsMessage<InvalidInput>(HasSubstr("background of canopy_lad = 3")));
}

}  // namespace
}  // namespace sekitei::tree
