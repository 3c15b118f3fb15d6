#include "solvers/wind/grid_wind.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/clones.h"
#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "solvers/wind/air.h"

namespace sekitei::wind::grid {
namespace {

constexpr double kSmallestTimeStep = 1e-6;  // [s]
constexpr double kLeastOutflow = 0.2;       // of U0: with what air comes back in at the end

int whole(double length, double spacing, const char* name)
{
    const double n = length / spacing;
    if (!(n >= 0.5 && n < 1e5) || std::abs(n - std::round(n)) > 1e-6 * n)
        throw InvalidInput(fmt::format(
            "wind: {} of the box = {:.6g} m, must be a positive multiple of the spacing {:.6g} m",
            name, length, spacing));
    return int(std::round(n));
}

/// Flow of phi through the faces between phi[k - s] and phi[k], friction included.
///
/// @param speed, across  the carrying velocity is the mean of speed[k - across] and speed[k]
/// @param friction       nu / l0
SEKITEI_CLONES
void flux_row(const double* phi, std::ptrdiff_t s, const double* speed, std::ptrdiff_t across,
              double sharpness, double courant, double friction, double* flux, std::ptrdiff_t n)
{
    for (std::ptrdiff_t k = 0; k < n; ++k) {
        const double u = 0.5 * (speed[k - across] + speed[k]);
        const double before = phi[k - s] - phi[k - 2 * s], here = phi[k] - phi[k - s];
        const double after = phi[k + s] - phi[k];
        const double upwind = u >= 0 ? before : after;
        const double product = upwind * here;
        const double slope = 2 * (product > 0 ? product : 0) / (product > 0 ? upwind + here : 1.0);
        const double way = 0.5 * sharpness * (1 - std::abs(u) * courant) * slope;
        const double carried = u >= 0 ? phi[k - s] + way : phi[k] - way;
        flux[k] = u * carried - friction * here;
    }
}

SEKITEI_CLONES
void update_row(const double* phi, const double* fx, const double* fy, const double* fz,
                const float* open, std::ptrdiff_t sx, std::ptrdiff_t sy, double ratio, double* to,
                std::ptrdiff_t n)
{
    for (std::ptrdiff_t k = 0; k < n; ++k)
        to[k] =
            double(open[k]) *
            (phi[k] - ratio * ((fx[k + sx] - fx[k]) + (fy[k + sy] - fy[k]) + (fz[k + 1] - fz[k])));
}

SEKITEI_CLONES
double fastest_row(const double* u, const double* v, const double* w, std::ptrdiff_t sx,
                   std::ptrdiff_t sy, std::ptrdiff_t n)
{
    double most = 0;
    for (std::ptrdiff_t k = 0; k < n; ++k) {
        const double x = std::max(std::abs(u[k]), std::abs(u[k + sx]));
        const double y = std::max(std::abs(v[k]), std::abs(v[k + sy]));
        const double z = std::max(std::abs(w[k]), std::abs(w[k + 1]));
        const double sum = x + y + z;
        most = sum <= most ? most : sum;  // takes what is not a number
    }
    return most;
}

}  // namespace

Settings Settings::air(double spacing, double speed)
{
    Settings s;
    s.spacing = spacing;
    s.viscosity = 0.013 * speed * spacing;
    return s;
}

void validate(const Settings& s)
{
    const auto check = [](const char* name, double value, const char* unit, bool good,
                          const char* range) {
        if (!good || !std::isfinite(value))
            throw InvalidParameter(fmt::format("wind: {} = {:.6g}{}{}, must be {}", name, value,
                                               *unit ? " " : "", unit, range));
    };
    check("spacing", s.spacing, "m", s.spacing > 0, "> 0");
    check("density", s.density, "kg/m^3", s.density > 0, "> 0");
    check("viscosity", s.viscosity, "m^2/s", s.viscosity >= 0, ">= 0");
    check("courant", s.courant, "", s.courant > 0 && s.courant <= 1, "> 0 to 1");
    check("sharpness", s.sharpness, "", s.sharpness >= 0 && s.sharpness <= 1, "0 to 1");
    check("tolerance", s.tolerance, "", s.tolerance > 0, "> 0");
    check("largest_iteration_count", s.largest_iteration_count, "", s.largest_iteration_count > 0,
          "> 0");
}

Simulation::Simulation(const Settings& settings, const WindTunnel& tunnel)
    : settings_(settings), tunnel_(tunnel)
{
    validate(settings_);
    if (!(tunnel.speed > 0) || !std::isfinite(tunnel.speed))
        throw InvalidInput(
            fmt::format("wind: speed of the stream = {:.6g} m/s, must be > 0", tunnel.speed));
    const double l0 = settings_.spacing;
    lattice_.n = {whole(tunnel.size.x, l0, "x"), whole(tunnel.size.y, l0, "y"),
                  whole(tunnel.size.z, l0, "z")};
    const Coord n = lattice_.n;
    const std::size_t size = lattice_.size(), sx = lattice_.stride_x(), sy = lattice_.stride_y();
    mark_air();
    for (int a = 0; a < 3; ++a) {
        velocity_[a].assign(size, 0);
        open_[a].assign(size, 0);
        flux_[a].assign(size, 0);
    }
    touch_.assign(size, 0), rhs_.assign(size, 0), potential_.assign(size, 0);
    inside_.assign(size, 0);

    // Beyond the top and the sides, and below a moving ground, all goes at U0.
    constexpr int m = Lattice::kMargin;
    for (int i = -m; i < n.x + m; ++i)
        for (int j = -m; j < n.y + m; ++j)
            for (int k = -m; k < n.z + m; ++k) {
                const bool beside = j < 0 || j >= n.y || k >= n.z;
                if (beside ? k >= 0 || tunnel.moving_ground : k < 0 && tunnel.moving_ground)
                    velocity_[0][lattice_.at(i, j, k)] = tunnel.speed;
            }
    for (int i = -m; i < n.x + m; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                const std::size_t c = lattice_.at(i, j, k);
                const std::size_t end = lattice_.at(std::clamp(i, 0, n.x - 1), j, k);
                if (!air_[end]) continue;
                // At the inflow, and wherever both sides are air.
                if (i <= 0 || i > n.x - 1 || air_[c - sx]) velocity_[0][c] = tunnel.speed;
                if (i > 0) open_[0][c] = i >= n.x || air_[c - sx];
                if (i < 0) continue;
                inside_[c] = i < n.x;
                open_[1][c] = j > 0 && air_[end - sy];
                open_[2][c] = k > 0 && air_[end - 1];
            }
    for (int a = 0; a < 3; ++a) moved_[a] = velocity_[a];
    moved_touch_ = touch_;
    find_water_and_plants();
    pressure_ = std::make_unique<PressureSolver>(lattice_, air_);
    potential_step_ = settings_.spacing / tunnel_.speed;
    project(potential_step_);
    fill_outflow();
}

/// Cells whose centre is in no obstacle and that are connected to the outflow.
void Simulation::mark_air()
{
    const Coord n = lattice_.n;
    const double l0 = settings_.spacing;
    air_.assign(lattice_.size(), 0);
    constexpr std::uint8_t kUnknown = 2;
    for (int i = 0; i < n.x; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                const Vec3d centre = tunnel_.lower + Vec3d(i + 0.5, j + 0.5, k + 0.5) * l0;
                if (!tunnel_.solid || !tunnel_.solid(centre)) air_[lattice_.at(i, j, k)] = kUnknown;
            }
    std::vector<std::size_t> front;
    const auto reach = [&](std::size_t c) {
        if (air_[c] != kUnknown) return;
        air_[c] = 1;
        front.push_back(c);
        ++air_cells_;
    };
    for (int j = 0; j < n.y; ++j)
        for (int k = 0; k < n.z; ++k) reach(lattice_.at(n.x - 1, j, k));
    while (!front.empty()) {
        const std::size_t c = front.back();
        front.pop_back();
        for (const std::size_t s : {lattice_.stride_x(), lattice_.stride_y(), std::size_t(1)})
            reach(c - s), reach(c + s);
    }
    if (air_cells_ == 0)
        throw InvalidInput(
            "wind: no air of the box reaches its downstream end; make the box larger or the "
            "obstacle smaller");
    for (std::uint8_t& a : air_) a = a == 1;
}

void Simulation::find_water_and_plants()
{
    const Coord n = lattice_.n;
    const double l0 = settings_.spacing;
    if (tunnel_.canopy) drag_.assign(lattice_.size(), 0);
    for (int i = 0; i < n.x; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                const std::size_t c = lattice_.at(i, j, k);
                if (!air_[c]) continue;
                const Vec3d p = tunnel_.lower + Vec3d(i + 0.5, j + 0.5, k + 0.5) * l0;
                if (tunnel_.canopy) drag_[c] = float(tunnel_.canopy(p));
                if (!tunnel_.water_level) continue;
                if (std::abs(p.z - tunnel_.water_level(p.x, p.y)) <= l0)
                    water_.push_back(std::uint32_t(c));
            }
}

double Simulation::time_step() const
{
    const Coord n = lattice_.n;
    const auto sx = std::ptrdiff_t(lattice_.stride_x()), sy = std::ptrdiff_t(lattice_.stride_y());
    const auto larger = [](double a, double b) { return b <= a ? a : b; };
    const double fastest = parallel_fold(
        std::size_t(n.x), 4, tunnel_.speed,
        [&](std::size_t begin, std::size_t end) {
            double most = 0;
            for (std::size_t i = begin; i < end; ++i)
                for (int j = 0; j < n.y; ++j) {
                    const std::size_t c = lattice_.at(int(i), j, 0);
                    most = larger(most, fastest_row(&velocity_[0][c], &velocity_[1][c],
                                                    &velocity_[2][c], sx, sy, n.z));
                }
            return most;
        },
        larger);
    const double l0 = settings_.spacing;
    double dt = settings_.courant * l0 / fastest;
    if (settings_.viscosity > 0) dt = std::min(dt, l0 * l0 / (12 * settings_.viscosity));
    if (!(dt >= kSmallestTimeStep))
        throw NumericalError(fmt::format(
            "wind: step {}: time step = {:.3g} s, must be >= {:.0e} s; the fastest air moves at "
            "{:.4g} m/s",
            steps_, dt, kSmallestTimeStep, fastest));
    return dt;
}

void Simulation::transport(int axis, const std::vector<double>& from,
                           const std::vector<float>& open, double dt, std::vector<double>& to)
{
    const Coord n = lattice_.n;
    const std::ptrdiff_t strides[] = {std::ptrdiff_t(lattice_.stride_x()),
                                      std::ptrdiff_t(lattice_.stride_y()), 1};
    const double ratio = dt / settings_.spacing;
    const std::ptrdiff_t across = axis < 0 ? 0 : strides[axis];
    // Water's exchange is carried without friction, as particles carry it.
    const double friction = axis < 0 ? 0 : settings_.viscosity / settings_.spacing;
    const auto columns = std::size_t(n.y) + 1;
    parallel_for_range(
        (std::size_t(n.x) + 2) * columns,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t row = begin; row < end; ++row) {
                const std::size_t f = lattice_.at(int(row / columns), int(row % columns), 0);
                for (int b = 0; b < 3; ++b)
                    flux_row(&from[f], strides[b], &velocity_[b][f], across, settings_.sharpness,
                             ratio, friction, &flux_[b][f], n.z + 1);
            }
        },
        64);
    const int first_x = axis == 0, last_x = n.x + (axis == 0);
    parallel_for_range(
        std::size_t(last_x - first_x) * std::size_t(n.y),
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t row = begin; row < end; ++row) {
                const std::size_t f = lattice_.at(first_x + int(row / std::size_t(n.y)),
                                                  int(row % std::size_t(n.y)), 0);
                update_row(&from[f], &flux_[0][f], &flux_[1][f], &flux_[2][f], &open[f], strides[0],
                           strides[1], ratio, &to[f], n.z);
            }
        },
        64);
}

Vec3d Simulation::centre_velocity(std::size_t c) const
{
    return {0.5 * (velocity_[0][c] + velocity_[0][c + lattice_.stride_x()]),
            0.5 * (velocity_[1][c] + velocity_[1][c + lattice_.stride_y()]),
            0.5 * (velocity_[2][c] + velocity_[2][c + 1])};
}

/// A face loses the mean of what its two cells take.
void Simulation::brake(double dt)
{
    const Coord n = lattice_.n;
    const std::size_t strides[] = {lattice_.stride_x(), lattice_.stride_y(), 1};
    for (int i = 0; i < n.x; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                const std::size_t c = lattice_.at(i, j, k);
                rhs_[c] = drag_[c] > 0
                              ? math::exp(-double(drag_[c]) * length(centre_velocity(c)) * dt)
                              : 1;
            }
    for (int a = 0; a < 3; ++a)
        for (int i = a == 0; i < n.x; ++i)
            for (int j = a == 1; j < n.y; ++j)
                for (int k = a == 2; k < n.z; ++k) {
                    const std::size_t c = lattice_.at(i, j, k);
                    if (open_[a][c] > 0) moved_[a][c] *= 0.5 * (rhs_[c] + rhs_[c - strides[a]]);
                }
}

/// Takes away the divergence of velocity_. The unknown is dt P / (rho l0).
Convergence Simulation::project(double dt)
{
    const Coord n = lattice_.n;
    const std::size_t sx = lattice_.stride_x(), sy = lattice_.stride_y();
    auto &u = velocity_[0], &v = velocity_[1], &w = velocity_[2];
    const double scale = dt / potential_step_;
    potential_step_ = dt;
    parallel_for(
        std::size_t(n.x),
        [&](std::size_t i) {
            for (int j = 0; j < n.y; ++j) {
                const std::size_t row = lattice_.at(int(i), j, 0);
                for (std::size_t c = row; c < row + std::size_t(n.z); ++c) {
                    potential_[c] *= scale;
                    rhs_[c] = air_[c]
                                  ? -((u[c + sx] - u[c]) + (v[c + sy] - v[c]) + (w[c + 1] - w[c]))
                                  : 0;
                }
            }
        },
        4);
    const Convergence report = pressure_->solve(rhs_, settings_.tolerance * tunnel_.speed,
                                                settings_.largest_iteration_count, potential_);
    if (!report.converged)
        throw NumericalError(fmt::format(
            "wind: step {}: ppe_no_convergence: residual = {:.3g} m/s after {} iterations, must "
            "be <= {:.1e} m/s",
            steps_, report.residual, report.iterations, settings_.tolerance * tunnel_.speed));
    parallel_for(
        std::size_t(n.x),
        [&](std::size_t i) {
            for (int j = 0; j < n.y; ++j) {
                const std::size_t row = lattice_.at(int(i), j, 0);
                for (std::size_t c = row; c < row + std::size_t(n.z); ++c) {
                    u[c] -= double(open_[0][c]) * (potential_[c] - potential_[c - sx]);
                    v[c] -= double(open_[1][c]) * (potential_[c] - potential_[c - sy]);
                    w[c] -= double(open_[2][c]) * (potential_[c] - potential_[c - 1]);
                    if (int(i) == n.x - 1 && air_[c]) u[c + sx] += 2 * potential_[c];
                }
            }
        },
        4);
    return report;
}

/// Behind the end everything goes on as it left; air that comes back in comes slowly.
void Simulation::fill_outflow()
{
    const Coord n = lattice_.n;
    const std::size_t sx = lattice_.stride_x();
    for (int j = 0; j < n.y; ++j)
        for (int k = 0; k < n.z; ++k) {
            const std::size_t last = lattice_.at(n.x - 1, j, k);
            if (!air_[last]) continue;
            for (std::size_t m = 1; m <= Lattice::kMargin; ++m) {
                velocity_[1][last + m * sx] = velocity_[1][last];
                velocity_[2][last + m * sx] = velocity_[2][last];
                touch_[last + m * sx] = touch_[last];
                if (m > 1)
                    velocity_[0][last + m * sx] =
                        std::max(velocity_[0][last + sx], kLeastOutflow * tunnel_.speed);
            }
        }
}

void Simulation::touch_water(double dt)
{
    for (const std::uint32_t c : water_)
        touch_[c] += water_touch(length(centre_velocity(c)), dt, tunnel_.speed, settings_.spacing);
}

StepReport Simulation::step()
{
    StepReport report;
    const double dt = report.time_step = time_step();
    if (!water_.empty()) {
        transport(-1, touch_, inside_, dt, moved_touch_);
        touch_.swap(moved_touch_);
    }
    for (int a = 0; a < 3; ++a) transport(a, velocity_[a], open_[a], dt, moved_[a]);
    if (!drag_.empty()) brake(dt);
    for (int a = 0; a < 3; ++a) velocity_[a].swap(moved_[a]);
    report.convergence = project(dt);
    fill_outflow();
    touch_water(dt);
    time_ += dt;
    take_statistics(dt);
    ++steps_;
    return report;
}

void Simulation::run_until(double end)
{
    while (time_ < end) step();
}

Vec3d Simulation::velocity(Coord cell) const
{
    return centre_velocity(lattice_.at(cell.x, cell.y, cell.z));
}

double Simulation::touch(Coord cell) const
{
    return touch_[lattice_.at(cell.x, cell.y, cell.z)];
}

double Simulation::pressure(Coord cell) const
{
    return potential_[lattice_.at(cell.x, cell.y, cell.z)] * settings_.density * settings_.spacing /
           potential_step_;
}

double Simulation::largest_divergence() const
{
    const Coord n = lattice_.n;
    double most = 0;
    for (int i = 0; i < n.x; ++i)
        for (int j = 0; j < n.y; ++j)
            for (int k = 0; k < n.z; ++k) {
                const std::size_t c = lattice_.at(i, j, k);
                if (!air_[c]) continue;
                const double out = (velocity_[0][c + lattice_.stride_x()] - velocity_[0][c]) +
                                   (velocity_[1][c + lattice_.stride_y()] - velocity_[1][c]) +
                                   (velocity_[2][c + 1] - velocity_[2][c]);
                most = std::max(most, std::abs(out) / settings_.spacing);
            }
    return most;
}

double Simulation::flow(int i) const
{
    double sum = 0;
    for (int j = 0; j < lattice_.n.y; ++j)
        for (int k = 0; k < lattice_.n.z; ++k) {
            const std::size_t c = lattice_.at(i, j, k);
            const bool open = i == 0 ? air_[c] != 0 : open_[0][c] > 0;
            if (open) sum += velocity_[0][c];
        }
    return sum * settings_.spacing * settings_.spacing;
}

void Simulation::start_statistics(std::vector<Bounds> boxes, std::vector<Vec3d> points,
                                  double radius)
{
    if (!points.empty() && !(radius > 0))
        throw InvalidInput(
            fmt::format("wind: radius of the probes = {:.6g} m, must be > 0", radius));
    boxes_.clear();
    for (const Bounds& bounds : boxes) {
        Box box;
        for (int a = 0; a < 3; ++a) {
            // Cells whose centre is in the box.
            const auto index = [&](double x) {
                const double cells = (x - tunnel_.lower[a]) / settings_.spacing - 0.5;
                return int(std::ceil(std::clamp(cells, 0.0, double(lattice_.n[a]))));
            };
            box.begin[a] = index(bounds.lower[a]);
            box.end[a] = std::max(box.begin[a], index(bounds.upper[a]));
        }
        for (int i = box.begin.x; i < box.end.x; ++i)
            for (int j = box.begin.y; j < box.end.y; ++j)
                for (int k = box.begin.z; k < box.end.z; ++k)
                    box.cells += air_[lattice_.at(i, j, k)];
        box.wet = tunnel_.holds_water(bounds, settings_.spacing);
        boxes_.push_back(box);
    }
    points_ = std::move(points);
    point_radius_ = radius;
    statistics_time_ = 0;
    speed_sum_.assign(points_.empty() ? 0 : lattice_.size(), 0);
}

void Simulation::take_statistics(double dt)
{
    statistics_time_ += dt;
    const std::size_t strides[] = {lattice_.stride_x(), lattice_.stride_y(), 1};
    for (Box& box : boxes_) {
        for (int i = box.begin.x; i < box.end.x; ++i)
            for (int j = box.begin.y; j < box.end.y; ++j)
                for (int k = box.begin.z; k < box.end.z; ++k) {
                    const std::size_t c = lattice_.at(i, j, k);
                    if (!air_[c]) continue;
                    const Vec3d u = centre_velocity(c);
                    box.velocity += u * dt;
                    box.speed += length(u) * dt;
                    box.air_touch += touch_[c] * dt;
                    box.time += dt;
                    // What comes in through the faces on the box's own sides.
                    const Coord cell(i, j, k);
                    for (int a = 0; a < 3; ++a) {
                        const double low = velocity_[a][c], high = velocity_[a][c + strides[a]];
                        if (cell[a] == box.begin[a] && low > 0) {
                            box.inflow += low * dt;
                            box.touch += low * dt * touch_[c - strides[a]];
                        }
                        if (cell[a] == box.end[a] - 1 && high < 0) {
                            box.inflow -= high * dt;
                            box.touch -= high * dt * touch_[c + strides[a]];
                        }
                    }
                }
    }
    if (speed_sum_.empty()) return;
    const Coord n = lattice_.n;
    parallel_for(
        std::size_t(n.x),
        [&](std::size_t i) {
            for (int j = 0; j < n.y; ++j)
                for (int k = 0; k < n.z; ++k) {
                    const std::size_t c = lattice_.at(int(i), j, k);
                    speed_sum_[c] += length(centre_velocity(c)) * dt;
                }
        },
        2);
}

BoxMeans Simulation::box_means(std::size_t box) const
{
    const Box& sums = boxes_.at(box);
    BoxMeans means;
    means.particles = sums.cells;
    if (sums.time == 0) return means;
    means.speed = sums.speed / sums.time;
    means.velocity = sums.velocity / sums.time;
    means.touch =
        sums.inflow > 0 && !sums.wet ? sums.touch / sums.inflow : sums.air_touch / sums.time;
    return means;
}

std::vector<double> Simulation::point_means() const
{
    std::vector<double> means(points_.size(), 0);
    if (statistics_time_ == 0) return means;
    const double l0 = settings_.spacing;
    parallel_for(
        points_.size(),
        [&](std::size_t p) {
            const Vec3d at = (points_[p] - tunnel_.lower) / l0;
            const double reach = point_radius_ / l0;
            Coord first, last;
            for (int a = 0; a < 3; ++a) {
                first[a] =
                    int(std::clamp(std::floor(at[a] - reach - 0.5), 0.0, double(lattice_.n[a])));
                last[a] =
                    int(std::clamp(std::ceil(at[a] + reach + 0.5), 0.0, double(lattice_.n[a])));
            }
            double weight = 0, speed = 0;
            for (int i = first.x; i < last.x; ++i)
                for (int j = first.y; j < last.y; ++j)
                    for (int k = first.z; k < last.z; ++k) {
                        const std::size_t c = lattice_.at(i, j, k);
                        if (!air_[c]) continue;
                        const double r = length(Vec3d(i + 0.5, j + 0.5, k + 0.5) - at);
                        if (r >= reach) continue;
                        const double w = reach / std::max(r, 1e-6 * reach) - 1;
                        weight += w;
                        speed += w * speed_sum_[c];
                    }
            if (weight > 0) means[p] = speed / weight / statistics_time_;
        },
        64);
    return means;
}

}  // namespace sekitei::wind::grid
