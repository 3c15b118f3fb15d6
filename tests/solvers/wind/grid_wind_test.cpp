#include "solvers/wind/grid_wind.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"

namespace sekitei::wind::grid {
namespace {

/// A small stream with nothing in it.
WindTunnel stream(double speed = 2.5)
{
    WindTunnel tunnel;
    tunnel.lower = {-1, 2, 0.5};
    tunnel.size = {8.0, 4.8, 3.2};
    tunnel.speed = speed;
    return tunnel;
}
constexpr double kSpacing = 0.4;

/// A wall across part of the stream, and a bush.
WindTunnel with_wall(double speed = 2.5, bool mirrored = false)
{
    WindTunnel tunnel = stream(speed);
    const double middle = 2 + 2.4;
    const auto across = [=](double y) { return mirrored ? middle - y : y - middle; };
    tunnel.solid = [=](Vec3d p) {
        return std::abs(p.x - 1.6) < 0.2 && across(p.y) < 0.7 && across(p.y) > -1.7 && p.z < 1.7;
    };
    tunnel.canopy = [=](Vec3d p) { return p.x > 3 && across(p.y) > 0.3 && p.z < 1.5 ? 0.5 : 0.0; };
    tunnel.water_level = [=](double x, double y) {
        return x > -0.5 && x < 3.5 && across(y) < 1 ? 0.5 : NAN;
    };
    return tunnel;
}

TEST(GridWind, AUniformStreamStaysUniform)
{
    WindTunnel tunnel = stream();
    tunnel.moving_ground = true;
    Simulation wind(Settings::air(kSpacing, tunnel.speed), tunnel);
    wind.run_until(6);
    const Coord n = wind.size();
    EXPECT_EQ(n, Coord(20, 12, 8));
    for (int i = 0; i < n.x; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                const Vec3d off = wind.velocity({i, j, k}) - Vec3d(tunnel.speed, 0, 0);
                ASSERT_LT(length(off), 1e-6 * tunnel.speed);
                ASSERT_NEAR(wind.pressure({i, j, k}), 0, 1e-6);
            }
}

TEST(GridWind, AirNeitherVanishesNorAppears)
{
    const WindTunnel tunnel = with_wall();
    Simulation wind(Settings::air(kSpacing, tunnel.speed), tunnel);
    for (int s = 0; s < 60; ++s) {
        wind.step();
        ASSERT_LT(wind.largest_divergence(), 1e-6 * tunnel.speed / kSpacing);
    }
    for (int i = 1; i <= wind.size().x; ++i)
        ASSERT_NEAR(wind.flow(i), wind.flow(0), 1e-5 * wind.flow(0));
    EXPECT_NEAR(wind.flow(0), 2.5 * 4.8 * 3.2, 1e-12);
}

TEST(GridWind, AMirroredSceneHasMirroredWind)
{
    Simulation wind(Settings::air(kSpacing, 2.5), with_wall());
    Simulation other(Settings::air(kSpacing, 2.5), with_wall(2.5, true));
    // Air comes into this box, behind the wall, from its sides.
    Bounds box, mirrored;
    box.add({1.9, 3.1, 0.5}), box.add({3.5, 4.5, 1.9});
    mirrored.add({1.9, 5.7, 0.5}), mirrored.add({3.5, 4.3, 1.9});
    wind.start_statistics({box}), other.start_statistics({mirrored});
    wind.run_until(4), other.run_until(4);
    EXPECT_GT(wind.box_means(0).touch, 0.5);
    EXPECT_NEAR(wind.box_means(0).touch, other.box_means(0).touch, 1e-4);
    EXPECT_NEAR(wind.box_means(0).velocity.y, -other.box_means(0).velocity.y, 1e-4);
    const Coord n = wind.size();
    double sideways = 0;
    for (int i = 0; i < n.x; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                const Vec3d a = wind.velocity({i, j, k});
                const Vec3d b = other.velocity({i, n.y - 1 - j, k});
                ASSERT_LT(length(a - Vec3d(b.x, -b.y, b.z)), 1e-5 * 2.5);
                ASSERT_NEAR(wind.touch({i, j, k}), other.touch({i, n.y - 1 - j, k}), 1e-4);
                sideways = std::max(sideways, std::abs(a.y));
            }
    EXPECT_GT(sideways, 0.1);
}

TEST(GridWind, EverythingScalesWithTheStream)
{
    Simulation wind(Settings::air(kSpacing, 2.5), with_wall(2.5));
    Simulation faster(Settings::air(kSpacing, 5), with_wall(5));
    for (int s = 0; s < 50; ++s) {
        wind.step(), faster.step();
        ASSERT_EQ(wind.time(), 2 * faster.time());
    }
    const Coord n = wind.size();
    for (int i = 0; i < n.x; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                ASSERT_EQ(wind.velocity({i, j, k}) * 2, faster.velocity({i, j, k}));
                ASSERT_EQ(wind.touch({i, j, k}), faster.touch({i, j, k}));
            }
}

TEST(GridWind, IsBitIdenticalForAnyNumberOfThreads)
{
    const auto on = [](std::size_t threads) {
        const ThreadLimit limit(threads);
        Settings settings = Settings::air(kSpacing, 2.5);
        settings.sharpness = 0.5;
        Simulation wind(settings, with_wall());
        Bounds box;
        box.add({2, 3, 0.5}), box.add({4, 6, 2.5});
        wind.start_statistics({box}, {{1.2, 4, 1}, {2.1, 4.5, 1.2}}, 0.9);
        wind.run_until(3);
        const BoxMeans means = wind.box_means(0);
        std::vector<double> all = wind.point_means();
        all.insert(all.end(), {means.speed, means.velocity.y, means.touch, double(wind.steps())});
        const Coord n = wind.size();
        for (int i = 0; i < n.x; ++i)
            for (int j = 0; j < n.y; ++j)
                for (int k = 0; k < n.z; ++k) {
                    const Vec3d u = wind.velocity({i, j, k});
                    all.insert(all.end(), {u.x, u.y, u.z, wind.touch({i, j, k})});
                }
        return all;
    };
    const std::vector<double> one = on(1);
    EXPECT_EQ(one, on(2));
    EXPECT_EQ(one, on(3));
}

TEST(GridWind, PlantsCostThePressureThatTheirDragSays)
{
    WindTunnel tunnel = stream();
    tunnel.moving_ground = true;
    const double drag = 0.5;
    tunnel.canopy = [=](Vec3d p) { return p.x > 1 && p.x < 5 ? drag : 0.0; };
    Simulation wind(Settings::air(kSpacing, tunnel.speed), tunnel);
    StepReport last;
    for (int s = 0; s < 50; ++s) last = wind.step();
    // The whole section is planted, so the air can only go on; a face loses u (1 - e^(-R u dt)) a
    // step, which the pressure gives back.
    const double dt = last.time_step, u = tunnel.speed;
    const double per_metre = 1.2 * u * (1 - std::exp(-drag * u * dt)) / dt;
    EXPECT_NEAR(wind.velocity({10, 6, 4}).x, u, 1e-6 * u);
    EXPECT_NEAR(wind.pressure({6, 6, 4}) - wind.pressure({13, 6, 4}), per_metre * 7 * kSpacing,
                1e-4 * per_metre);
    EXPECT_NEAR(per_metre, 1.2 * drag * u * u, 0.07 * per_metre);
}

TEST(GridWind, PlantsSlowTheAirAndSendItRound)
{
    WindTunnel tunnel = stream();
    tunnel.moving_ground = true;
    tunnel.canopy = [](Vec3d p) {
        return p.x > 1 && p.x < 5 && std::abs(p.y - 4.4) < 1 && p.z < 2 ? 0.5 : 0.0;
    };
    Simulation wind(Settings::air(kSpacing, tunnel.speed), tunnel);
    wind.run_until(8);
    // Air that cannot turn aside would keep its speed, free air would fall to e^-2.
    EXPECT_LT(wind.velocity({15, 6, 0}).x, 0.75 * tunnel.speed);
    EXPECT_GT(wind.velocity({15, 6, 0}).x, std::exp(-2) * tunnel.speed);
    EXPECT_GT(wind.velocity({12, 1, 1}).x, 1.05 * tunnel.speed);
}

TEST(GridWind, FrictionBalancesThePressureInALongDuct)
{
    WindTunnel tunnel;
    tunnel.size = {6, 1.0, 0.8};
    tunnel.speed = 1;
    Settings settings = Settings::air(0.2, 1);
    settings.viscosity = 0.5;
    Simulation wind(settings, tunnel);
    wind.run_until(3);
    const Coord n = wind.size();
    const auto u = [&](int j, int k) {
        if (k < 0) return 0.0;                          // the ground
        if (j < 0 || j >= n.y || k >= n.z) return 1.0;  // what moves with the stream
        return wind.velocity({20, j, k}).x;
    };
    const double slope =
        (wind.pressure({21, 2, 2}) - wind.pressure({19, 2, 2})) / (2 * settings.spacing);
    EXPECT_LT(slope, -1);
    for (int j = 0; j < n.y; ++j)
        for (int k = 0; k < n.z; ++k) {
            const double laplacian =
                (u(j - 1, k) + u(j + 1, k) + u(j, k - 1) + u(j, k + 1) - 4 * u(j, k)) / (0.2 * 0.2);
            EXPECT_NEAR(settings.density * settings.viscosity * laplacian, slope,
                        2e-3 * std::abs(slope));
        }
}

TEST(GridWind, AirOverWaterTouchesTheFetchOverTheDepth)
{
    WindTunnel tunnel = stream(3);
    tunnel.moving_ground = true;
    tunnel.water_level = [](double x, double) { return x > -0.2 && x < 5 ? 0.5 : NAN; };
    Simulation wind(Settings::air(kSpacing, 3), tunnel);
    wind.run_until(8);
    EXPECT_NEAR(wind.touch({18, 6, 0}), 5.2 / kSpacing, 1e-4);
    EXPECT_NEAR(wind.touch({18, 6, 1}), 0, 1e-4);
    EXPECT_NEAR(wind.touch({8, 6, 0}), 2.8 / kSpacing, 1e-4);  // x = 2.2 to 2.6
    Bounds box;
    box.add({6, 3, 0.5}), box.add({6.8, 6, 2.1});  // four layers, of which one has touched
    wind.start_statistics({box});
    wind.step();
    EXPECT_NEAR(wind.box_means(0).touch, 5.2 / kSpacing / 4, 1e-4);
    // Over the water itself all air counts, not what comes in: on the way it touches half of it.
    Bounds pond;
    pond.add({-0.2, 3, 0.5}), pond.add({5, 6, 0.9});
    wind.start_statistics({pond});
    wind.step();
    EXPECT_NEAR(wind.box_means(0).touch, (5.2 + kSpacing) / 2 / kSpacing, 1e-3);
}

TEST(GridWind, MeansWeighAirNearAPointLikeAKernel)
{
    const WindTunnel tunnel = with_wall();
    Simulation wind(Settings::air(kSpacing, tunnel.speed), tunnel);
    wind.run_until(3);
    const Vec3d points[] = {{2.13, 4.2, 0.9}, {1.6, 4.4, 0.9}, {-5, 4, 1}};
    const double radius = 0.9;
    wind.start_statistics({}, {points[0], points[1], points[2]}, radius);
    wind.step();
    double weight = 0, speed = 0;
    const Coord n = wind.size();
    for (int i = 0; i < n.x; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                if (!wind.air({i, j, k})) continue;
                const Vec3d centre = tunnel.lower + Vec3d(i + 0.5, j + 0.5, k + 0.5) * kSpacing;
                const double r = length(centre - points[0]);
                if (r >= radius) continue;
                weight += radius / r - 1;
                speed += (radius / r - 1) * length(wind.velocity({i, j, k}));
            }
    const std::vector<double> means = wind.point_means();
    EXPECT_NEAR(means[0], speed / weight, 1e-12);
    EXPECT_GT(means[1], 0);
    EXPECT_EQ(means[2], 0);  // far outside
}

TEST(GridWind, APocketWithoutAWayOutIsStill)
{
    WindTunnel tunnel = stream();
    tunnel.solid = [](Vec3d p) {
        const Vec3d d = p - Vec3d(2, 4, 1.5);
        const double r = std::max({std::abs(d.x), std::abs(d.y), std::abs(d.z)});
        return r > 0.5 && r < 1;
    };
    Simulation wind(Settings::air(kSpacing, tunnel.speed), tunnel);
    wind.run_until(1);
    EXPECT_FALSE(wind.air({7, 5, 2}));
    EXPECT_LT(wind.largest_divergence(), 1e-6 * tunnel.speed / kSpacing);
}

/// The garden of the wind's first stage: the object would stand at x = 14 m, y = 8 m.
struct Garden {
    double speed = 0, touch = 0;
    std::vector<double> layers;
};

Garden garden(const std::function<bool(Vec3d)>& solid,
              const std::function<double(double, double)>& water = {})
{
    WindTunnel tunnel;
    tunnel.size = {24, 16, 8};
    tunnel.solid = solid;
    tunnel.water_level = water;
    Simulation wind(Settings::air(0.5, 3), tunnel);
    wind.run_until(12);
    std::vector<Bounds> boxes(5);
    for (int b = 0; b < 5; ++b) {
        boxes[std::size_t(b)].add({13.14, 7.14, b == 0 ? 0 : 0.5 * (b - 1)});
        boxes[std::size_t(b)].add({14.86, 8.86, b == 0 ? 2 : 0.5 * b});
    }
    wind.start_statistics(boxes);
    wind.run_until(18);
    Garden found{wind.box_means(0).speed / 3, wind.box_means(0).touch, {}};
    for (std::size_t b = 1; b < 5; ++b) found.layers.push_back(wind.box_means(b).touch);
    return found;
}

// The numbers of the particle method for the same boxes and times; see README.md.

TEST(GridWind, AFenceSheltersAsMuchAsOfParticles)
{
    const auto fence = [](double begin) {
        return [=](Vec3d p) {
            return p.x > begin && p.x < begin + 0.5 && std::abs(p.y - 8) < 5 && p.z < 2;
        };
    };
    const double none = garden({}).speed;
    EXPECT_NEAR(none, 0.930, 0.05);
    const double before = garden(fence(11.5)).speed, behind = garden(fence(16)).speed;
    EXPECT_NEAR(before, 0.311, 0.10);
    EXPECT_NEAR(behind, 0.576, 0.10);
    EXPECT_LE(before / none, 0.45);
    EXPECT_LE(behind / none, 0.85);
    const double beside = garden([](Vec3d p) {
                              return std::abs(p.x - 14) < 5 && p.y > 10 && p.y < 10.5 && p.z < 2;
                          }).speed;
    EXPECT_NEAR(beside / none, 1, 0.15);
}

TEST(GridWind, APondIsTouchedLikeByParticles)
{
    const auto pond = [](double begin) {
        return [=](double x, double y) {
            return x > begin && x < begin + 5 && std::abs(y - 8) < 3.5 ? 0.0 : NAN;
        };
    };
    const Garden west = garden({}, pond(8)), east = garden({}, pond(15));
    EXPECT_GT(west.touch, 1.5);
    EXPECT_LT(west.touch, 5);
    EXPECT_NEAR(west.touch, 2.83, 0.6);
    EXPECT_NEAR(west.layers[0], 11.0, 1);
    EXPECT_GT(west.layers[0], 5 * west.layers[1]);
    EXPECT_EQ(east.touch, 0);
}

TEST(GridWind, NamesWhatIsWrong)
{
    const auto message = [](const Settings& settings, const WindTunnel& tunnel) {
        try {
            Simulation wind(settings, tunnel);
        } catch (const InvalidInput& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    Settings s = Settings::air(kSpacing, 2.5);
    s.courant = 1.5;
    EXPECT_EQ(message(s, stream()), "wind: courant = 1.5, must be > 0 to 1");
    s = Settings::air(kSpacing, 2.5);
    s.viscosity = NAN;
    EXPECT_EQ(message(s, stream()), "wind: viscosity = nan m^2/s, must be >= 0");
    s = Settings::air(kSpacing, 2.5);
    WindTunnel tunnel = stream();
    tunnel.size.y = 1.3;
    EXPECT_EQ(message(s, tunnel),
              "wind: y of the box = 1.3 m, must be a positive multiple of the spacing 0.4 m");
    EXPECT_EQ(message(s, stream(0)), "wind: speed of the stream = 0 m/s, must be > 0");
    tunnel = stream();
    tunnel.solid = [](Vec3d p) { return p.x > 5; };
    EXPECT_THAT(message(s, tunnel), testing::HasSubstr("no air of the box reaches"));
}

// ---------------------------------------------------------------- the Poisson equation

TEST(GridPressure, FindsAKnownPressureBetweenThinWalls)
{
    constexpr Stream kPressure{"test.pressure"};
    for (const Coord n : {Coord(13, 9, 7), Coord(48, 32, 16), Coord(2, 40, 3)}) {
        const Lattice lattice{n};
        std::vector<std::uint8_t> air(lattice.size(), 0);
        std::vector<double> exact(lattice.size(), 0), b(lattice.size(), 0), x(lattice.size(), 0);
        for (int i = 0; i < n.x; ++i)
            for (int j = 0; j < n.y; ++j)
                for (int k = 0; k < n.z; ++k) {
                    const std::size_t c = lattice.at(i, j, k);
                    const bool wall = i % 6 == 3 && j > 0 && k < n.z - 1;
                    air[c] = !wall;
                    if (!wall) exact[c] = uniform01(3, kPressure, c);
                }
        for (int i = 0; i < n.x; ++i)
            for (int j = 0; j < n.y; ++j)
                for (int k = 0; k < n.z; ++k) {
                    const std::size_t c = lattice.at(i, j, k);
                    if (!air[c]) continue;
                    for (const std::size_t s :
                         {lattice.stride_x(), lattice.stride_y(), std::size_t(1)}) {
                        if (air[c - s]) b[c] += exact[c] - exact[c - s];
                        if (air[c + s]) b[c] += exact[c] - exact[c + s];
                    }
                    if (i == n.x - 1) b[c] += 2 * exact[c];
                }
        PressureSolver solver(lattice, air);
        const Convergence report = solver.solve(b, 1e-10, 60, x);
        EXPECT_TRUE(report.converged) << n.x;
        EXPECT_LT(report.iterations, 40) << n.x;
        double worst = 0;
        for (std::size_t c = 0; c < x.size(); ++c)
            worst = std::max(worst, std::abs(x[c] - exact[c]));
        EXPECT_LT(worst, 1e-6) << n.x;
    }
}

}  // namespace
}  // namespace sekitei::wind::grid
