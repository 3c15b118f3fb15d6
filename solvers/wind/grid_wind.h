#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/vec.h"
#include "solvers/wind/grid_pressure.h"
#include "solvers/wind/tunnel.h"

/// Air among obstacles on a fixed grid: the quick companion of the particle method (mps.h), with
/// the same tunnel, the same eddy viscosity and the same measurements.
namespace sekitei::wind::grid {

struct Settings {
    double spacing = 0.5;  ///< l0, edge of a cell [m], > 0
    double density = 1.2;  ///< rho [kg/m^3], > 0
    double viscosity = 0;  ///< kinematic, nu [m^2/s], >= 0
    double courant = 0.6;  ///< largest dt (|u| + |v| + |w|) / l0, > 0 to 1
    /// 1: flow and water's exchange are carried at second order where they are smooth; 0: by the
    /// donor cell, which mixes about as much as particles do.
    double sharpness = 0;
    double tolerance = 1e-7;  ///< largest flow into or out of a cell after a step / (U0 l0^2), > 0
    int largest_iteration_count = 200;  ///< of the Poisson equation, > 0

    /// Air in a stream of `speed` [m/s]: nu = 0.013 speed l0 [Ogasawara2003].
    static Settings air(double spacing, double speed);
};

/// @throws InvalidParameter naming the first field out of its range
void validate(const Settings& settings);

struct StepReport {
    double time_step = 0;  ///< [s]
    Convergence convergence;
};

/// Incompressible flow on a staggered grid [Harlow1965] by projection [Chorin1968].
///
/// A step: momentum and `touch` are carried in conservation form by the donor cell, with limited
/// Lax-Wendroff fluxes [vanLeer1974] as far as `sharpness` says; friction is explicit; plants take
/// exp(-R_U |u| dt); then a pressure makes the velocity free of divergence. Inflow at U0; behind
/// the outflow P = 0; top and sides are walls that move at U0, the ground is no-slip or moves.
/// Walls rub as if they lay one l0 from the first air, where particles have theirs. Cells whose
/// centre is inside an obstacle are solid, and so are pockets that are cut off from the outflow.
///
/// Results are the same on any number of threads, and scale with U0.
class Simulation {
public:
    /// @throws InvalidParameter  from validate()
    /// @throws InvalidInput  the box is empty, not a multiple of l0, or no air reaches its end
    Simulation(const Settings& settings, const WindTunnel& tunnel);

    /// @throws NumericalError  Poisson equation not converged, a velocity that is not finite, a
    ///         time step below 1e-6 s; names the step
    StepReport step();
    /// Steps until time() >= end.
    void run_until(double end);

    const Settings& settings() const { return settings_; }
    double time() const { return time_; }
    std::size_t steps() const { return steps_; }
    std::size_t air_cells() const { return air_cells_; }
    Coord size() const { return lattice_.n; }

    bool air(Coord cell) const { return air_[lattice_.at(cell.x, cell.y, cell.z)] != 0; }
    Vec3d velocity(Coord cell) const;   ///< at its centre [m/s]
    double touch(Coord cell) const;     ///< water touched since the inflow: sum of k_i / C(U0)
    double pressure(Coord cell) const;  ///< over that behind the outflow [Pa]
    double largest_divergence() const;  ///< [1/s]
    double flow(int i) const;           ///< through the plane of faces x = lower.x + i l0 [m^3/s]

    /// What is measured from now on: air in boxes, and near points.
    void start_statistics(std::vector<Bounds> boxes, std::vector<Vec3d> points = {},
                          double radius = 0);
    /// `touch` is the mean over the air that flows into the box.
    BoxMeans box_means(std::size_t box) const;
    /// Mean speed of the cells within `radius` of each point, weighted by radius / r - 1 [m/s]; 0
    /// where there is no air.
    std::vector<double> point_means() const;

private:
    struct Box {
        Coord begin, end;  ///< cells [begin, end)
        double speed = 0, time = 0, inflow = 0, touch = 0, air_touch = 0;
        Vec3d velocity{};
        std::size_t cells = 0;
        bool wet = false;  ///< with water in it
    };
    void mark_air();
    void find_water_and_plants();
    double time_step() const;
    /// Carries `from` with the flow into `to`. @param axis  of a component, -1: a scalar of cells
    void transport(int axis, const std::vector<double>& from, const std::vector<float>& open,
                   double dt, std::vector<double>& to);
    void brake(double dt);
    Convergence project(double dt);
    void fill_outflow();
    void touch_water(double dt);
    void take_statistics(double dt);
    Vec3d centre_velocity(std::size_t c) const;

    Settings settings_;
    WindTunnel tunnel_;
    Lattice lattice_;
    std::size_t air_cells_ = 0, steps_ = 0;
    double time_ = 0;

    std::vector<std::uint8_t> air_;
    /// Component a at the face of a cell towards smaller a; 1 where that face is open.
    std::vector<double> velocity_[3], moved_[3];
    std::vector<float> open_[3], inside_;
    std::vector<double> flux_[3];
    std::vector<double> touch_, moved_touch_, rhs_, potential_;
    double potential_step_ = 0;         ///< time step that potential_ belongs to
    std::vector<std::uint32_t> water_;  ///< cells that touch it
    std::vector<float> drag_;           ///< R_U of cells; empty without plants
    std::unique_ptr<PressureSolver> pressure_;

    std::vector<Box> boxes_;
    std::vector<Vec3d> points_;
    double point_radius_ = 0, statistics_time_ = 0;
    std::vector<double> speed_sum_;
};

}  // namespace sekitei::wind::grid
