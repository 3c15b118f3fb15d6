// The reference runs in three dimensions, which take minutes.
#include <gtest/gtest.h>

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
        if (wind.time() >= 16) break;
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

}  // namespace
}  // namespace sekitei::wind::mps
