// Particles against the grid in the gardens of the first stage, which takes minutes.
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "solvers/wind/grid_wind.h"
#include "solvers/wind/mps.h"

namespace sekitei::wind {
namespace {

/// The garden of 24 x 16 x 8 m; the probe of a lantern at x = 14 m.
WindTunnel garden()
{
    WindTunnel tunnel;
    tunnel.size = {24, 16, 8};
    return tunnel;
}

WindTunnel with_fence(double begin)
{
    WindTunnel tunnel = garden();
    tunnel.solid = [=](Vec3d p) {
        return p.x > begin && p.x < begin + 0.5 && std::abs(p.y - 8) < 5 && p.z < 2;
    };
    return tunnel;
}

template <class Simulation>
BoxMeans probe(Simulation wind)
{
    wind.run_until(12);
    Bounds box;
    box.add({13.14, 7.14, 0}), box.add({14.86, 8.86, 2});
    wind.start_statistics({box});
    wind.run_until(18);
    return wind.box_means(0);
}

struct Both {
    BoxMeans particles, grid;
};

Both both(const WindTunnel& tunnel)
{
    const Both found{probe(mps::Simulation(mps::Settings::air(3, 0.5, 3), tunnel)),
                     probe(grid::Simulation(grid::Settings::air(0.5, 3), tunnel))};
    testing::Test::RecordProperty("A_U_particles", std::to_string(found.particles.speed / 3));
    testing::Test::RecordProperty("A_U_grid", std::to_string(found.grid.speed / 3));
    testing::Test::RecordProperty("A_T_particles", std::to_string(found.particles.touch));
    testing::Test::RecordProperty("A_T_grid", std::to_string(found.grid.touch));
    return found;
}

TEST(WindValidation, PondTouchesAirOfBothSolversAlike)
{
    WindTunnel tunnel = garden();
    tunnel.water_level = [](double x, double y) {
        return x > 8 && x < 13 && std::abs(y - 8) < 3.5 ? 0.0 : NAN;
    };
    const Both found = both(tunnel);
    EXPECT_NEAR(found.particles.speed / 3, found.grid.speed / 3, 0.15);
    EXPECT_GT(found.particles.touch, 1.5);
    EXPECT_LT(found.particles.touch, 5);
    EXPECT_NEAR(found.particles.touch / found.grid.touch, 1, 0.3);
}

TEST(WindValidation, BothSolversFindTheSameShelterBehindAFence)
{
    const Both found = both(with_fence(11.5));
    EXPECT_NEAR(found.particles.speed / 3, found.grid.speed / 3, 0.15);
    EXPECT_LE(found.particles.speed / 3, 0.45);
    EXPECT_LT(found.particles.velocity.x, 0);
    EXPECT_LT(found.grid.velocity.x, 0);
}

TEST(WindValidation, BothSolversFindTheSameShelterBeforeAFence)
{
    const Both found = both(with_fence(16));
    EXPECT_NEAR(found.particles.speed / 3, found.grid.speed / 3, 0.15);
    EXPECT_LE(found.particles.speed / 3, 0.85);
}

}  // namespace
}  // namespace sekitei::wind
