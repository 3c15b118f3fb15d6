#pragma once

#include <cstddef>
#include <functional>

#include "core/vec.h"

/// What both wind solvers, particles and grid, are given and give back.
namespace sekitei::wind {

/// A box of air that flows along +x. Behind the inflow face, and on every other face, lies what
/// carries the boundary condition; the box holds whole numbers of l0, the solver's spacing.
struct WindTunnel {
    Vec3d lower{};               ///< corner of the box [m]; in 2-D y is the plane of the particles
    Vec3d size{};                ///< [m]; multiples of l0; y is ignored in 2-D
    double speed = 3;            ///< U0 [m/s], > 0
    bool moving_ground = false;  ///< else no-slip
    /// Whether a point is inside an obstacle; asked at the centres of the cubes of edge l0 that
    /// fill the box, so whatever is thinner than l0 must be made as thick as that. Of particles,
    /// two layers of walls and two of dummies; deeper sites stay empty.
    std::function<bool(Vec3d)> solid;
    /// Drag of porous plants, R_U [1/m] at a point; asked by many threads at once.
    std::function<double(Vec3d)> canopy;
    /// z of the water's surface at (x, y), NaN where there is none.
    std::function<double(double x, double y)> water_level;

    /// Whether there is a water's surface in a box, asked at points l0 apart.
    bool holds_water(const Bounds& box, double l0) const;

    /// P_b = 2 rho U0^2: what the pressure is far from obstacles, so that wakes fill.
    double background_pressure(double density) const { return 2 * density * speed * speed; }
};

/// Means over all steps since start_statistics().
struct BoxMeans {
    double speed = 0;  ///< mean of |u| over air and time [m/s]; 0 without air
    Vec3d velocity{};  ///< mean of u [m/s]
    /// A_T = A_q: mean of `touch` over the air that came in, or where there is water in the box
    /// over all its air, since that touches it there.
    double touch = 0;
    std::size_t particles = 0;  ///< that have been in the box; of a grid: cells of air in it
};

}  // namespace sekitei::wind
