// The reference runs in three dimensions, which take minutes.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "solvers/wind/mps.h"

namespace sekitei::wind::mps {
namespace {

struct Behind {
    double speed, along, balance;
};

Behind behind(bool fence)
{
    WindTunnel tunnel;
    tunnel.size = {30, 4, 10};
    tunnel.speed = 3;
    if (fence) tunnel.solid = [](Vec3d p) { return p.x > 11 && p.x < 11.5 && p.z < 2; };
    Simulation wind(Settings::air(3, 0.5, 3), tunnel);
    wind.run_until(8);
    const std::size_t in = wind.entered(), out = wind.left();
    Vec3d velocity{};
    double speed = 0, time = 0;
    while (wind.time() < 16) {
        const double dt = wind.step().time_step;
        for (const double y : {1.0, 2.0, 3.0}) {
            const auto s = wind.sample({13.25, y, 1.5}, 1.05);
            velocity += s.velocity * dt, speed += s.speed * dt, time += dt;
        }
    }
    return {speed / time, velocity.x / time,
            double(wind.entered() - in) / double(wind.left() - out)};
}

TEST(MpsValidation, AFenceAcrossTheWholeStreamSheltersInThreeDimensions)
{
    const Behind open = behind(false), fence = behind(true);
    RecordProperty("open", std::to_string(open.speed));
    RecordProperty("ratio", std::to_string(fence.speed / open.speed));
    RecordProperty("along", std::to_string(fence.along));
    RecordProperty("balance", std::to_string(fence.balance));
    EXPECT_GE(fence.speed / open.speed, 0.15);
    EXPECT_LE(fence.speed / open.speed, 0.45);
    EXPECT_NEAR(fence.balance, 1, 0.03);
    EXPECT_NEAR(open.balance, 1, 0.03);
}

TEST(MpsValidation, WaterInATankPressesWithItsDepthInThreeDimensions)
{
    constexpr double l0 = 0.02, depth = 0.2;
    const Settings settings = Settings::water(3, l0);
    const Particles water =
        tank(settings, {}, {0.2, 0.12, 0.3}, [](Vec3d p) { return p.z < depth; });
    Bounds domain;
    domain.add(Vec3d(-l0));
    domain.add({0.2 + l0, 0.12 + l0, 0.4});
    Simulation run(settings, water, domain);
    double n = 0, sz = 0, szz = 0, sp = 0, szp = 0;
    while (run.time() < 1) {
        run.step();
        if (run.time() < 0.5) continue;
        const Particles& q = run.particles();
        for (std::size_t i = 0; i < q.size(); ++i) {
            if (q.kind[i] != Kind::Fluid) continue;
            const double below = depth - q.position.z[i];
            n += 1, sz += below, szz += below * below, sp += q.pressure[i];
            szp += below * q.pressure[i];
        }
    }
    const double slope = (n * szp - sz * sp) / (n * szz - sz * sz) / (1000 * 9.81);
    RecordProperty("slope", std::to_string(slope));
    EXPECT_NEAR(slope, 1, 0.05);
}

TEST(MpsValidation, ADamBreaksInThreeDimensions)
{
    constexpr double a = 0.146, l0 = a / 12;
    const Settings settings = Settings::water(3, l0);
    const Particles water =
        tank(settings, {}, {4 * a, 6 * l0, 3 * a}, [](Vec3d p) { return p.x < a && p.z < 2 * a; });
    Bounds domain;
    domain.add(Vec3d(-l0));
    domain.add({4 * a + l0, 7 * l0, 6 * a});
    Simulation run(settings, water, domain);
    const double scale = std::sqrt(2 * 9.81 / a);
    std::vector<std::pair<double, double>> front;
    while (run.time() * scale < 3.4) {
        run.step();
        const Particles& q = run.particles();
        std::vector<Vec3d> fluid;
        for (std::size_t i = 0; i < q.size(); ++i)
            if (q.kind[i] == Kind::Fluid) fluid.push_back(q.position.at(i));
        double farthest = 0;
        for (const Vec3d& p : fluid) {
            if (p.x < farthest) continue;
            int near = 0;
            for (const Vec3d& r : fluid) near += length(p - r) < 2.1 * l0;
            if (near > 3) farthest = p.x;
        }
        front.emplace_back(run.time() * scale, (farthest + 0.5 * l0) / a);
    }
    const auto time_of = [&](double z) {
        for (const auto& [T, Z] : front)
            if (Z >= z) return T;
        return INFINITY * 1.0;
    };
    const double speed = 2 / (time_of(3.5) - time_of(1.5));
    RecordProperty("speed", std::to_string(speed));
    EXPECT_GE(speed, 1.05);
    EXPECT_LE(speed, 1.40);
}

/// The garden of the wind's first stage: a fence of 10 m across a stream of 16 m.
TEST(MpsValidation, AFenceSheltersWhatStandsBehindItInAGarden)
{
    WindTunnel tunnel;
    tunnel.size = {24, 16, 8};
    tunnel.speed = 3;
    tunnel.solid = [](Vec3d p) {
        return p.x > 11.5 && p.x < 12 && std::abs(p.y - 8) < 5 && p.z < 2;
    };
    Simulation wind(Settings::air(3, 0.5, 3), tunnel);
    wind.run_until(12);
    Bounds probe;
    probe.add({13.1, 7.1, 0});
    probe.add({14.9, 8.9, 2});
    wind.start_statistics({probe});
    const std::size_t in = wind.entered(), out = wind.left();
    wind.run_until(20);
    const BoxMeans means = wind.box_means(0);
    const double balance = double(wind.entered() - in) / double(wind.left() - out);
    RecordProperty("A_U", std::to_string(means.speed / 3));
    RecordProperty("along", std::to_string(means.velocity.x));
    RecordProperty("balance", std::to_string(balance));
    EXPECT_GT(means.particles, 20u);
    EXPECT_LE(means.speed / 3, 0.45);
    EXPECT_NEAR(balance, 1, 0.03);
}

/// The box of the second stage: a post with a roof, particles of 5 cm.
TEST(MpsValidation, AirPassesAStoneLantern)
{
    WindTunnel tunnel;
    tunnel.lower = {-0.8, -0.8, 0};
    tunnel.size = {1.6, 1.6, 1.9};
    tunnel.speed = 3;
    tunnel.solid = [](Vec3d p) {
        const double r = std::hypot(p.x, p.y), side = std::max(std::abs(p.x), std::abs(p.y));
        return (side < 0.25 && p.z < 0.15) || (r < 0.12 && p.z < 0.75) ||
               (side < 0.22 && p.z > 0.75 && p.z < 1.13) ||
               (p.z > 1.13 && p.z < 1.35 && side < 0.36 - 1.27 * (p.z - 1.13)) ||
               length(p - Vec3d(0, 0, 1.425)) < 0.075;
    };
    Simulation wind(Settings::air(3, 0.05, 3), tunnel);
    const std::size_t at_first = wind.count(Kind::Fluid);  // the box without the lantern's own room
    wind.run_until(1);
    const Vec3d front(-0.30, 0, 0.45), behind(0.30, 0, 0.95), beside(0, 0.45, 0.45);
    wind.start_statistics({}, {front, behind, beside}, 0.1);
    wind.run_until(2);
    const auto means = wind.point_means();
    RecordProperty("front", std::to_string(means[0]));
    RecordProperty("behind", std::to_string(means[1]));
    RecordProperty("beside", std::to_string(means[2]));
    EXPECT_GT(means[2], 0.9 * 3);
    EXPECT_LT(means[1], 0.6 * 3);
    EXPECT_GT(double(wind.count(Kind::Fluid)), 0.97 * double(at_first));
}

}  // namespace
}  // namespace sekitei::wind::mps
