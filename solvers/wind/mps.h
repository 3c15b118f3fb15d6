#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <utility>
#include <vector>

#include "core/vec.h"
#include "solvers/wind/mps_kernel.h"
#include "solvers/wind/mps_neighbours.h"
#include "solvers/wind/mps_pressure.h"
#include "solvers/wind/tunnel.h"

/// The Moving Particle Semi-implicit method [Koshizuka1996] for air among obstacles and for water
/// with a free surface, in two dimensions (the plane x, z) or three.
namespace sekitei::wind::mps {

struct Settings {
    int dimension = 3;           ///< 2 (x and z; y never changes) or 3
    double spacing = 0.5;        ///< l0, the distance of particles at rest [m], > 0
    double density = 1.2;        ///< rho [kg/m^3], > 0
    double viscosity = 0;        ///< kinematic, nu [m^2/s], >= 0
    double smagorinsky = 0;      ///< C_s of the eddy viscosity (C_s l0)^2 |S|, >= 0; 0.15 is usual
    Vec3d gravity{};             ///< [m/s^2]
    double gamma = 0.1;          ///< how fast the density returns to n0, 0 to 1
    double compressibility = 0;  ///< alpha [1/Pa], >= 0
    bool divergence_source = true;       ///< the Poisson source contains -div(u*) / dt
    double empty_ratio = 0.75;           ///< P = 0 where n* < this * n0, 0 to 1
    double laplacian_radius = 2.1;       ///< re of the Laplacian / l0, 2.1 to 4
    double collision_distance = 0.6;     ///< / l0, 0 to 1
    double restitution = 0.2;            ///< of a collision, 0 to 1
    double courant = 0.2;                ///< way of the fastest particle in a step / l0, > 0 to 0.5
    double largest_time_step = 0.1;      ///< [s], > 0
    double tolerance = 1e-8;             ///< relative residual of the Poisson equation, > 0
    int largest_iteration_count = 1000;  ///< of the Poisson equation

    /// Air in a stream of `speed` [m/s]: nu = 0.013 speed l0 [Ogasawara2003], no gravity.
    /// Everything scales with the speed, so that ratios of speeds do not depend on it.
    static Settings air(int dimension, double spacing, double speed);
    /// Water under gravity with a free surface.
    static Settings water(int dimension, double spacing);
};

/// @throws InvalidParameter naming the first field out of its range
void validate(const Settings& settings);

enum class Kind : std::uint8_t {
    Fluid,
    Wall,         ///< at rest, has a pressure
    WallDummy,    ///< at rest behind walls, counts for density and friction only
    Inflow,       ///< moves with the stream, has a pressure
    InflowDummy,  ///< behind the inflow
    Row,          ///< top, side or moving ground: moves with the stream, has a pressure
    RowDummy,     ///< behind a row
    Outflow       ///< has left the box: keeps its velocity, P = the background pressure
};

/// The particles, one array for each quantity. The order changes from step to step; `id` does not.
struct Particles {
    Positions position;                 ///< [m]
    std::vector<double> u, v, w;        ///< velocity [m/s]
    std::vector<double> pressure;       ///< [Pa]
    std::vector<double> density;        ///< n* / n0 of fluid and walls in the last step, else 0
    std::vector<double> touch;          ///< water touched since the inflow: sum of k_i / C(U0)
    std::vector<std::uint32_t> probed;  ///< bit b: has been in probe box b
    std::vector<std::int32_t> column;   ///< of inflow particles: 0, 1, ... in order of arrival
    std::vector<Kind> kind;
    std::vector<std::uint64_t> id;

    std::size_t size() const { return kind.size(); }
    Vec3d velocity(std::size_t i) const { return {u[i], v[i], w[i]}; }
    void set_velocity(std::size_t i, Vec3d a) { u[i] = a.x, v[i] = a.y, w[i] = a.z; }
    /// At rest unless a velocity is given.
    void add(Kind kind, Vec3d position, Vec3d velocity = {}, double pressure = 0);
};

using wind::BoxMeans;
using wind::WindTunnel;

/// A box with walls (two layers, and two of dummies behind them) at its sides and ground, open at
/// the top, with fluid where `fluid` says so; asked at the centres of the cubes of edge l0.
Particles tank(const Settings& settings, Vec3d lower, Vec3d size,
               const std::function<bool(Vec3d)>& fluid);

/// Speed after dt in porous plants: u exp(-R_U |u| dt) [Ogasawara2003, eq. 22]. Where the particle
/// moves on by |u| dt, speed falls with the way as exactly exp(-R_U x) for any dt.
Vec3d canopy_drag(Vec3d velocity, double drag, double dt);

struct StepReport {
    double time_step = 0;     ///< [s]
    Convergence convergence;  ///< of the Poisson equation
    std::size_t unknowns = 0;
};

class Simulation {
public:
    /// Particles in a domain that nothing enters or leaves.
    /// @throws InvalidParameter  from validate()
    /// @throws InvalidInput  no particles, or some outside the domain
    Simulation(const Settings& settings, Particles particles, const Bounds& domain);
    /// @throws InvalidInput  the box is empty, all solid, or not a multiple of l0
    Simulation(const Settings& settings, const WindTunnel& tunnel);

    /// Replaces the drag of porous plants; see WindTunnel::canopy.
    void set_canopy(std::function<double(Vec3d)> drag) { tunnel_.canopy = std::move(drag); }

    /// One step: explicit friction, gravity and drag, collisions, then pressure.
    /// @throws NumericalError  a fluid particle outside the domain or not a number, the Poisson
    ///         equation not converged, the time step below 1e-6 s; names the step
    StepReport step();
    /// Steps until time() >= end.
    void run_until(double end);

    const Settings& settings() const { return settings_; }
    const Particles& particles() const { return particles_; }
    double time() const { return time_; }
    std::size_t steps() const { return steps_; }
    std::size_t count(Kind kind) const;
    std::size_t entered() const { return entered_; }  ///< particles that became fluid at the inflow
    std::size_t left() const { return left_; }        ///< that ceased to be fluid at the outflow

    /// Mean velocity and speed of the air within `radius` of a point, weighted by w(r, radius).
    struct Sample {
        Vec3d velocity{};
        double speed = 0, weight = 0;  ///< all 0 where there is no air
    };
    Sample sample(Vec3d point, double radius) const;

    /// What is measured from now on: fluid in boxes (at most 32), air near points.
    /// @throws InvalidInput  more than 32 boxes
    void start_statistics(std::vector<Bounds> boxes, std::vector<Vec3d> points = {},
                          double radius = 0);
    BoxMeans box_means(std::size_t box) const;
    /// Time mean of the kernel-weighted speed near each point [m/s]; 0 where there never was air.
    std::vector<double> point_means() const;

private:
    struct BoxSums {
        double speed = 0, time = 0, touch = 0, air_touch = 0;
        Vec3d velocity{};
        std::size_t particles = 0;
        bool wet = false;  ///< with water in it
    };
    void fill_tunnel();
    void prepare();
    double time_step() const;
    void find_eddy_viscosity();
    void predict(double dt);
    void move_boundaries(double dt);
    void check_domain() const;
    void refresh_neighbours();
    void remove_gone();
    void permute(const std::vector<std::uint32_t>& order);
    void collide(double dt);
    void measure(double dt);
    StepReport solve_pressure(double dt);
    void correct(double dt);
    void touch_water(double dt);
    void take_statistics(double dt);

    Settings settings_;
    WindTunnel tunnel_;
    bool open_ = false;  ///< there is a stream
    Bounds domain_;      ///< where fluid may be
    double radius_ = 0, laplacian_radius_ = 0, skin_ = 0;
    LatticeConstants lattice_, laplacian_lattice_;

    Particles particles_;
    std::uint64_t next_id_ = 0;
    std::int32_t next_column_ = 0;
    std::vector<Vec3d> inflow_sites_;  ///< of one column; x is that of the last column added
    std::size_t steps_ = 0, entered_ = 0, left_ = 0;
    double time_ = 0;

    Cells cells_;
    NeighbourLists lists_;
    Positions listed_;   ///< positions when the lists were built
    bool stale_ = true;  ///< particles have come or changed their kind since
    std::vector<double> eddy_, source_;
    std::vector<Vec3d> change_;
    std::vector<std::uint32_t> unknown_;
    std::vector<double> solution_;
    PressureSystem system_;

    std::vector<Bounds> boxes_;
    std::vector<BoxSums> box_sums_;
    std::vector<Vec3d> points_;
    double point_radius_ = 0;
    std::vector<double> point_speed_, point_time_;
};

}  // namespace sekitei::wind::mps
