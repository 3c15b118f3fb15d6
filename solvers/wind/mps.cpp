#include "solvers/wind/mps.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::wind::mps {
namespace {

constexpr double kRadius = 2.1;  ///< re of density, gradient and divergence / l0
constexpr double kSkin = 0.2;    ///< by which lists reach farther / l0
constexpr int kLayers = 4;       ///< of every boundary: two with a pressure, two dummies
constexpr int kPressureLayers = 2;
/// At which fluid collides with a boundary in 3-D / l0. The gaps between four particles of a wall
/// reach 0.71 l0 from each, so that a single particle would slip through at the usual distance.
constexpr double kWallCollision = 0.85;
constexpr double kSmallestTimeStep = 1e-6;  // [s]
constexpr double kAggregate = 4;            ///< edge of the coarse cubes / l0
constexpr std::size_t kGrain = 256;
constexpr std::size_t kMostBoxes = 32;

bool has_pressure(Kind kind)
{
    return kind != Kind::WallDummy && kind != Kind::InflowDummy && kind != Kind::RowDummy;
}

bool is_wall(Kind kind)
{
    return kind == Kind::Wall || kind == Kind::WallDummy;
}

bool is_air(Kind kind)
{
    return kind == Kind::Fluid || kind == Kind::Inflow || kind == Kind::InflowDummy ||
           kind == Kind::Outflow;
}

/// Whether the source of the Poisson equation is measured; elsewhere it is zero.
bool has_source(Kind kind)
{
    return kind == Kind::Fluid || kind == Kind::Wall;
}

Kind behind(Kind kind, int layer)
{
    if (layer <= kPressureLayers) return kind;
    return kind == Kind::Wall ? Kind::WallDummy : Kind::RowDummy;
}

/// Number of particles along an edge.
int whole(double length, double spacing, const char* name)
{
    const double n = length / spacing;
    if (!(n >= 0.5 && n < 1e6) || std::abs(n - std::round(n)) > 1e-6 * n)
        throw InvalidInput(fmt::format(
            "mps: {} of the box = {:.6g} m, must be a positive multiple of the spacing {:.6g} m",
            name, length, spacing));
    return int(std::round(n));
}

template <class T>
void reorder(std::vector<T>& values, const std::vector<std::uint32_t>& order)
{
    std::vector<T> moved(order.size());
    parallel_for(
        order.size(), [&](std::size_t i) { moved[i] = values[order[i]]; }, 4096);
    values.swap(moved);
}

}  // namespace

Settings Settings::air(int dimension, double spacing, double speed)
{
    Settings s;
    s.dimension = dimension;
    s.spacing = spacing;
    s.viscosity = 0.013 * speed * spacing;
    s.laplacian_radius = dimension == 2 ? 3.1 : 2.1;
    s.largest_time_step = 0.2 * spacing / speed;
    return s;
}

Settings Settings::water(int dimension, double spacing)
{
    Settings s;
    s.dimension = dimension;
    s.spacing = spacing;
    s.density = 1000;
    s.viscosity = 1e-6;
    s.gravity = {0, 0, -9.81};
    s.gamma = 0.2;
    s.compressibility = 0.45e-9;
    s.divergence_source = false;
    s.empty_ratio = 0.97;
    s.collision_distance = 0.5;
    s.laplacian_radius = dimension == 2 ? 3.1 : 2.1;
    s.largest_time_step = 1e-3;
    return s;
}

void validate(const Settings& s)
{
    const auto check = [](const char* name, double value, const char* unit, bool good,
                          const char* range) {
        if (!good)
            throw InvalidParameter(fmt::format("mps: {} = {:.6g}{}{}, must be {}", name, value,
                                               *unit ? " " : "", unit, range));
    };
    const auto finite = [](double x) { return std::isfinite(x); };
    check("dimension", s.dimension, "", s.dimension == 2 || s.dimension == 3, "2 or 3");
    check("spacing", s.spacing, "m", finite(s.spacing) && s.spacing > 0, "> 0");
    check("density", s.density, "kg/m^3", finite(s.density) && s.density > 0, "> 0");
    check("viscosity", s.viscosity, "m^2/s", finite(s.viscosity) && s.viscosity >= 0, ">= 0");
    check("smagorinsky", s.smagorinsky, "", finite(s.smagorinsky) && s.smagorinsky >= 0, ">= 0");
    for (int axis = 0; axis < 3; ++axis)
        check("gravity", s.gravity[axis], "m/s^2", finite(s.gravity[axis]), "finite");
    if (s.dimension == 2)
        check("gravity along y", s.gravity.y, "m/s^2", s.gravity.y == 0, "0 in 2-D");
    check("gamma", s.gamma, "", s.gamma >= 0 && s.gamma <= 1, "0 to 1");
    check("compressibility", s.compressibility, "1/Pa",
          finite(s.compressibility) && s.compressibility >= 0, ">= 0");
    check("empty_ratio", s.empty_ratio, "", s.empty_ratio >= 0 && s.empty_ratio <= 1, "0 to 1");
    check("laplacian_radius", s.laplacian_radius, "l0",
          s.laplacian_radius >= kRadius && s.laplacian_radius <= kLayers, "2.1 to 4");
    check("collision_distance", s.collision_distance, "l0",
          s.collision_distance >= 0 && s.collision_distance <= 1, "0 to 1");
    check("restitution", s.restitution, "", s.restitution >= 0 && s.restitution <= 1, "0 to 1");
    check("courant", s.courant, "", s.courant > 0 && s.courant <= 0.5, "> 0 to 0.5");
    check("largest_time_step", s.largest_time_step, "s",
          finite(s.largest_time_step) && s.largest_time_step > 0, "> 0");
    check("tolerance", s.tolerance, "", s.tolerance > 0 && s.tolerance < 1, "> 0, < 1");
    check("largest_iteration_count", s.largest_iteration_count, "", s.largest_iteration_count > 0,
          "> 0");
}

void Particles::add(Kind k, Vec3d place, Vec3d motion, double p)
{
    position.push_back(place);
    u.push_back(motion.x), v.push_back(motion.y), w.push_back(motion.z);
    pressure.push_back(p);
    density.push_back(0);
    touch.push_back(0);
    probed.push_back(0);
    column.push_back(0);
    kind.push_back(k);
    id.push_back(id.size());
}

Particles tank(const Settings& settings, Vec3d lower, Vec3d size,
               const std::function<bool(Vec3d)>& fluid)
{
    validate(settings);
    const double l0 = settings.spacing;
    const bool flat = settings.dimension == 2;
    const Coord n(whole(size.x, l0, "x"), flat ? 1 : whole(size.y, l0, "y"),
                  whole(size.z, l0, "z"));
    const int side = flat ? 0 : kLayers;
    Particles all;
    for (int i = -kLayers; i < n.x + kLayers; ++i)
        for (int j = -side; j < n.y + side; ++j)
            for (int k = -kLayers; k < n.z; ++k) {
                const Vec3d p(lower.x + (i + 0.5) * l0, lower.y + (flat ? 0 : (j + 0.5) * l0),
                              lower.z + (k + 0.5) * l0);
                const int layer = std::max({-i, i - n.x + 1, -j, j - n.y + 1, -k});
                if (layer > 0)
                    all.add(behind(Kind::Wall, layer), p);
                else if (fluid(p))
                    all.add(Kind::Fluid, p);
            }
    return all;
}

Vec3d canopy_drag(Vec3d velocity, double drag, double dt)
{
    return velocity * math::exp(-drag * length(velocity) * dt);
}

Simulation::Simulation(const Settings& settings, Particles particles, const Bounds& domain)
    : settings_(settings), domain_(domain), particles_(std::move(particles))
{
    validate(settings_);
    if (particles_.size() == 0) throw InvalidInput("mps: there are no particles");
    prepare();
}

Simulation::Simulation(const Settings& settings, const WindTunnel& tunnel)
    : settings_(settings), tunnel_(tunnel), open_(true)
{
    validate(settings_);
    if (!(tunnel.speed > 0) || !std::isfinite(tunnel.speed))
        throw InvalidInput(
            fmt::format("mps: speed of the stream = {:.6g} m/s, must be > 0", tunnel.speed));
    fill_tunnel();
    prepare();
}

void Simulation::fill_tunnel()
{
    const double l0 = settings_.spacing;
    const bool flat = settings_.dimension == 2;
    const Coord n(whole(tunnel_.size.x, l0, "x"), flat ? 1 : whole(tunnel_.size.y, l0, "y"),
                  whole(tunnel_.size.z, l0, "z"));
    if (flat) tunnel_.size.y = 0;
    const Vec3d lower = tunnel_.lower;
    const Vec3d flow(tunnel_.speed, 0, 0);
    const double background = tunnel_.background_pressure(settings_.density);
    const auto centre = [&](int i, int j, int k) {
        return Vec3d(lower.x + (i + 0.5) * l0, lower.y + (flat ? 0 : (j + 0.5) * l0),
                     lower.z + (k + 0.5) * l0);
    };

    // How deep each site lies in an obstacle: 0 in air, else steps to the nearest air, up to five.
    const auto site = [&](int i, int j, int k) {
        return (std::size_t(i) * std::size_t(n.y) + std::size_t(j)) * std::size_t(n.z) +
               std::size_t(k);
    };
    std::vector<std::uint8_t> depth(std::size_t(n.x) * std::size_t(n.y) * std::size_t(n.z), 0);
    if (tunnel_.solid) {
        for (int i = 0; i < n.x; ++i)
            for (int j = 0; j < n.y; ++j)
                for (int k = 0; k < n.z; ++k)
                    if (tunnel_.solid(centre(i, j, k))) depth[site(i, j, k)] = kLayers + 1;
        for (int layer = 1; layer <= kLayers; ++layer)
            for (int i = 0; i < n.x; ++i)
                for (int j = 0; j < n.y; ++j)
                    for (int k = 0; k < n.z; ++k) {
                        if (depth[site(i, j, k)] <= layer) continue;
                        bool near = false;
                        for (int a = std::max(i - 1, 0); a <= std::min(i + 1, n.x - 1); ++a)
                            for (int b = std::max(j - 1, 0); b <= std::min(j + 1, n.y - 1); ++b)
                                for (int c = std::max(k - 1, 0); c <= std::min(k + 1, n.z - 1); ++c)
                                    near |= depth[site(a, b, c)] == layer - 1;
                        if (near) depth[site(i, j, k)] = std::uint8_t(layer);
                    }
    }

    const int side = flat ? 0 : kLayers;
    std::size_t air = 0;
    for (int i = -kLayers; i < n.x + kLayers; ++i)
        for (int j = -side; j < n.y + side; ++j)
            for (int k = -kLayers; k < n.z + kLayers; ++k) {
                const Vec3d p = centre(i, j, k);
                const int down = -k, beside = std::max({-j, j - n.y + 1, k - n.z + 1});
                if (down > 0) {
                    const Kind kind = tunnel_.moving_ground ? Kind::Row : Kind::Wall;
                    particles_.add(behind(kind, std::max(down, beside)), p,
                                   tunnel_.moving_ground ? flow : Vec3d{}, background);
                } else if (beside > 0) {
                    particles_.add(behind(Kind::Row, beside), p, flow, background);
                } else {
                    // Obstacles that touch the ends of the box go on beyond them.
                    const int inside = depth[site(std::clamp(i, 0, n.x - 1), j, k)];
                    if (inside > kLayers) continue;
                    if (inside > 0) {
                        particles_.add(behind(Kind::Wall, inside), p, {}, background);
                        continue;
                    }
                    const Kind kind = i < 0 ? Kind::Inflow : i < n.x ? Kind::Fluid : Kind::Outflow;
                    particles_.add(kind, p, flow, background);
                    air += kind == Kind::Fluid;
                    if (kind == Kind::Inflow) particles_.column.back() = -1 - i;
                    if (i == -kLayers) inflow_sites_.push_back(p);
                }
            }
    if (air == 0) throw InvalidInput("mps: the box is solid throughout, there is no air to move");
    for (std::size_t i = 0; i < particles_.size(); ++i)
        if (particles_.kind[i] == Kind::Inflow && particles_.column[i] >= kPressureLayers)
            particles_.kind[i] = Kind::InflowDummy;
    next_column_ = kLayers;
    domain_.add(lower);
    domain_.add(lower + tunnel_.size);
    // Fluid that gets behind the first layer of a boundary has leaked.
    domain_.lower -= Vec3d(l0);
    domain_.upper += Vec3d(l0);
}

void Simulation::prepare()
{
    const double l0 = settings_.spacing;
    radius_ = kRadius * l0;
    laplacian_radius_ = settings_.laplacian_radius * l0;
    skin_ = kSkin * l0;
    lattice_ = lattice_constants(settings_.dimension, l0, radius_);
    laplacian_lattice_ = lattice_constants(settings_.dimension, l0, laplacian_radius_);
    next_id_ = particles_.size();
    for (std::size_t i = 0; i < particles_.size(); ++i) particles_.id[i] = i;

    Bounds all = domain_;
    for (std::size_t i = 0; i < particles_.size(); ++i)
        if (particles_.kind[i] != Kind::Fluid) all.add(particles_.position.at(i));
    if (!std::isfinite(length(all.size())))
        throw InvalidInput("mps: the domain, or the place of a particle, is not finite");
    if (settings_.dimension == 2) all.lower.y = all.upper.y = particles_.position.y[0];
    cells_ = Cells(all, std::max(radius_, laplacian_radius_) + skin_);
    check_domain();
    refresh_neighbours();
}

std::size_t Simulation::count(Kind kind) const
{
    return std::size_t(std::count(particles_.kind.begin(), particles_.kind.end(), kind));
}

void Simulation::check_domain() const
{
    const Positions& at = particles_.position;
    const double y_plane = settings_.dimension == 2 ? at.y[0] : 0;
    for (std::size_t i = 0; i < particles_.size(); ++i) {
        if (particles_.kind[i] != Kind::Fluid) continue;
        const Vec3d p = at.at(i);
        const bool across = settings_.dimension == 2
                                ? p.y == y_plane
                                : p.y >= domain_.lower.y && p.y <= domain_.upper.y;
        if (p.x >= domain_.lower.x && p.x <= domain_.upper.x && across && p.z >= domain_.lower.z &&
            p.z <= domain_.upper.z)
            continue;
        throw NumericalError(fmt::format(
            "mps: step {}: particle {} outside the domain at ({:.6g}, {:.6g}, {:.6g}) m, must be "
            "in ({:.6g}, {:.6g}, {:.6g}) to ({:.6g}, {:.6g}, {:.6g}); take smaller time steps or "
            "close the gap in the wall",
            steps_, particles_.id[i], p.x, p.y, p.z, domain_.lower.x, domain_.lower.y,
            domain_.lower.z, domain_.upper.x, domain_.upper.y, domain_.upper.z));
    }
}

void Simulation::permute(const std::vector<std::uint32_t>& order)
{
    Particles& q = particles_;
    reorder(q.position.x, order), reorder(q.position.y, order), reorder(q.position.z, order);
    reorder(q.u, order), reorder(q.v, order), reorder(q.w, order);
    reorder(q.pressure, order), reorder(q.density, order), reorder(q.touch, order);
    reorder(q.probed, order), reorder(q.column, order), reorder(q.kind, order);
    reorder(q.id, order);
}

/// Sorts and lists anew once any two particles may have come nearer by more than the skin.
void Simulation::refresh_neighbours()
{
    const Positions& at = particles_.position;
    if (!stale_) {
        const double farthest = parallel_fold(
            at.size(), 4096, 0.0,
            [&](std::size_t begin, std::size_t end) {
                double most = 0;
                for (std::size_t i = begin; i < end; ++i) {
                    const Vec3d d = at.at(i) - listed_.at(i);
                    most = std::max(most, dot(d, d));
                }
                return most;
            },
            [](double a, double b) { return std::max(a, b); });
        if (4 * farthest <= skin_ * skin_) return;
    }
    permute(cells_.sort(at));
    std::vector<std::uint8_t> wanted(at.size());
    for (std::size_t i = 0; i < at.size(); ++i)
        wanted[i] = has_pressure(particles_.kind[i]) && particles_.kind[i] != Kind::Outflow;
    lists_.build(cells_, at, wanted, std::max(radius_, laplacian_radius_) + skin_);
    listed_ = at;
    stale_ = false;
}

double Simulation::time_step() const
{
    double fastest = open_ ? tunnel_.speed * tunnel_.speed : 0;
    for (std::size_t i = 0; i < particles_.size(); ++i)
        if (particles_.kind[i] == Kind::Fluid) {
            const Vec3d u = particles_.velocity(i);
            fastest = std::max(fastest, dot(u, u));
        }
    fastest = std::sqrt(fastest);
    const double l0 = settings_.spacing;
    double dt = settings_.largest_time_step;
    if (fastest > 0) dt = std::min(dt, settings_.courant * l0 / fastest);
    double nu = settings_.viscosity;
    for (const double eddy : eddy_) nu = std::max(nu, settings_.viscosity + eddy);
    if (nu > 0) dt = std::min(dt, 0.25 * l0 * l0 / (settings_.dimension * nu));
    if (!(dt >= kSmallestTimeStep))
        throw NumericalError(fmt::format(
            "mps: step {}: time step = {:.3g} s, must be >= {:.0e} s; the fastest particle moves "
            "at {:.4g} m/s",
            steps_, dt, kSmallestTimeStep, fastest));
    return dt;
}

/// (C_s l0)^2 |S| with the strain rate S from the gradient of each component of the velocity.
void Simulation::find_eddy_viscosity()
{
    if (settings_.smagorinsky == 0) return;
    const Particles& q = particles_;
    const double mixing = settings_.smagorinsky * settings_.spacing;
    eddy_.assign(q.size(), 0);
    parallel_for(
        q.size(),
        [&](std::size_t i) {
            if (q.kind[i] != Kind::Fluid) return;
            Vec3d gradient[3];  // of u, v and w
            const Vec3d here = q.position.at(i), u = q.velocity(i);
            const std::uint32_t* list = lists_.of(i);
            for (std::size_t k = 0; k < lists_.count(i); ++k) {
                const Vec3d d = q.position.at(list[k]) - here;
                const double squared = dot(d, d), w = weight(std::sqrt(squared), radius_);
                if (w == 0) continue;
                const Vec3d du = q.velocity(list[k]) - u;
                for (int c = 0; c < 3; ++c) gradient[c] += d * (du[c] * w / squared);
            }
            const double factor = settings_.dimension / lattice_.n0;
            double strain = 0;  // 2 S : S
            for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b) {
                    const double s = 0.5 * factor * (gradient[a][b] + gradient[b][a]);
                    strain += 2 * s * s;
                }
            eddy_[i] = mixing * mixing * std::sqrt(strain);
        },
        kGrain);
}

/// Friction, gravity and drag give u*, which moves the particles to r*.
void Simulation::predict(double dt)
{
    Particles& q = particles_;
    change_.assign(q.size(), Vec3d{});
    const double factor =
        2 * settings_.dimension / (laplacian_lattice_.lambda * laplacian_lattice_.n0);
    const bool friction = settings_.viscosity > 0 || !eddy_.empty();
    parallel_for(
        q.size(),
        [&](std::size_t i) {
            if (q.kind[i] != Kind::Fluid) return;
            Vec3d sum{};
            const Vec3d here = q.position.at(i), u = q.velocity(i);
            if (friction) {
                const std::uint32_t* list = lists_.of(i);
                for (std::size_t k = 0; k < lists_.count(i); ++k) {
                    const std::size_t j = list[k];
                    const Vec3d d = q.position.at(j) - here;
                    const double w = weight(std::sqrt(dot(d, d)), laplacian_radius_);
                    if (w == 0) continue;
                    double nu = settings_.viscosity;
                    if (!eddy_.empty())
                        nu += q.kind[j] == Kind::Fluid ? 0.5 * (eddy_[i] + eddy_[j]) : eddy_[i];
                    sum += (q.velocity(j) - u) * (nu * w);
                }
            }
            Vec3d moved = u + (sum * factor + settings_.gravity) * dt;
            if (tunnel_.canopy) {
                const double drag = tunnel_.canopy(here);
                if (drag > 0) moved = canopy_drag(moved, drag, dt);
            }
            change_[i] = moved - u;
        },
        kGrain);
    for (std::size_t i = 0; i < q.size(); ++i) {
        if (is_wall(q.kind[i])) continue;
        const Vec3d u = q.velocity(i) + change_[i];
        q.set_velocity(i, u);
        q.position.set(i, q.position.at(i) + u * dt);
    }
}

/// What enters, leaves and goes round: the open ends of the box.
void Simulation::move_boundaries(double dt)
{
    if (!open_) return;
    Particles& q = particles_;
    const double l0 = settings_.spacing, begin = tunnel_.lower.x, end = begin + tunnel_.size.x;
    const double period = tunnel_.size.x + 2 * kLayers * l0;
    std::int32_t front = std::numeric_limits<std::int32_t>::max();
    for (std::size_t i = 0; i < q.size(); ++i) {
        double& x = q.position.x[i];
        switch (q.kind[i]) {
            case Kind::Inflow:
            case Kind::InflowDummy:
                if (x >= begin) {
                    q.kind[i] = Kind::Fluid;
                    ++entered_;
                    stale_ = true;
                } else {
                    front = std::min(front, q.column[i]);
                }
                break;
            case Kind::Row:
            case Kind::RowDummy:
                if (x >= end + kLayers * l0) x -= period;
                break;
            case Kind::Fluid:
                if (x > end) {
                    q.kind[i] = Kind::Outflow;
                    q.u[i] = std::max(q.u[i], 0.2 * tunnel_.speed);
                    q.pressure[i] = tunnel_.background_pressure(settings_.density);
                    ++left_;
                    stale_ = true;
                }
                break;
            default:
                break;
        }
    }
    for (std::size_t i = 0; i < q.size(); ++i)
        if (q.kind[i] == Kind::InflowDummy && q.column[i] < front + kPressureLayers) {
            q.kind[i] = Kind::Inflow;
            stale_ = true;
        }
    remove_gone();

    // Follow the last column, and put a fresh one behind it when there is room.
    for (Vec3d& p : inflow_sites_) p.x += tunnel_.speed * dt;
    if (!inflow_sites_.empty() && inflow_sites_[0].x >= begin - (kLayers - 1.5) * l0) {
        for (Vec3d& p : inflow_sites_) {
            p.x -= l0;
            q.add(Kind::InflowDummy, p, {tunnel_.speed, 0, 0},
                  tunnel_.background_pressure(settings_.density));
            q.column.back() = next_column_;
            q.id.back() = next_id_++;
        }
        ++next_column_;
        stale_ = true;
    }
}

void Simulation::remove_gone()
{
    const double end = tunnel_.lower.x + tunnel_.size.x + kLayers * settings_.spacing;
    std::vector<std::uint32_t> kept;
    kept.reserve(particles_.size());
    for (std::size_t i = 0; i < particles_.size(); ++i)
        if (particles_.kind[i] != Kind::Outflow || particles_.position.x[i] <= end)
            kept.push_back(std::uint32_t(i));
    if (kept.size() == particles_.size()) return;
    permute(kept);
    stale_ = true;
}

/// Inelastic impulses between pairs that are too close and still approach, in sorted order.
void Simulation::collide(double dt)
{
    Particles& q = particles_;
    const double least = settings_.collision_distance * settings_.spacing;
    if (least == 0) return;
    const double to_wall =
        settings_.dimension == 3 ? std::max(least, kWallCollision * settings_.spacing) : least;
    using Pair = std::pair<std::uint32_t, std::uint32_t>;
    const std::vector<Pair> pairs = parallel_fold(
        q.size(), 1024, std::vector<Pair>{},
        [&](std::size_t begin, std::size_t end) {
            std::vector<Pair> found;
            for (std::size_t i = begin; i < end; ++i) {
                if (q.kind[i] != Kind::Fluid) continue;
                const Vec3d here = q.position.at(i);
                const std::uint32_t* list = lists_.of(i);
                for (std::size_t k = 0; k < lists_.count(i); ++k) {
                    const std::uint32_t j = list[k];
                    const bool fluid = q.kind[j] == Kind::Fluid;
                    if (fluid && j < i) continue;
                    const Vec3d d = q.position.at(j) - here;
                    const double near = fluid ? least : to_wall;
                    if (dot(d, d) < near * near) found.emplace_back(std::uint32_t(i), j);
                }
            }
            return found;
        },
        [](std::vector<Pair> a, const std::vector<Pair>& b) {
            a.insert(a.end(), b.begin(), b.end());
            return a;
        });
    const auto push = [&](std::size_t i, Vec3d du) {
        q.set_velocity(i, q.velocity(i) + du);
        q.position.set(i, q.position.at(i) + du * dt);
    };
    for (const auto& [i, j] : pairs) {
        const Vec3d along = normalized(q.position.at(j) - q.position.at(i));
        const double closing = dot(q.velocity(i) - q.velocity(j), along);
        if (closing <= 0) continue;
        const Vec3d impulse = along * ((1 + settings_.restitution) * closing);
        if (q.kind[j] == Kind::Fluid) {
            push(i, impulse * -0.5);
            push(j, impulse * 0.5);
        } else {
            push(i, -impulse);
        }
    }
}

/// n* and the source of the Poisson equation at r*.
void Simulation::measure(double dt)
{
    Particles& q = particles_;
    source_.assign(q.size(), 0);
    parallel_for(
        q.size(),
        [&](std::size_t i) {
            q.density[i] = 0;
            if (!has_source(q.kind[i])) return;
            const Vec3d here = q.position.at(i), u = q.velocity(i);
            double n = 0, divergence = 0;
            const std::uint32_t* list = lists_.of(i);
            for (std::size_t k = 0; k < lists_.count(i); ++k) {
                const Vec3d d = q.position.at(list[k]) - here;
                const double squared = dot(d, d), w = weight(std::sqrt(squared), radius_);
                if (w == 0) continue;
                n += w;
                divergence += dot(q.velocity(list[k]) - u, d) * (w / squared);
            }
            q.density[i] = n / lattice_.n0;
            source_[i] = settings_.gamma * (q.density[i] - 1) / (dt * dt);
            if (settings_.divergence_source)
                source_[i] -= settings_.dimension / lattice_.n0 * divergence / dt;
        },
        kGrain);
}

StepReport Simulation::solve_pressure(double dt)
{
    Particles& q = particles_;
    constexpr std::uint32_t kKnown = ~0u;
    unknown_.assign(q.size(), kKnown);
    std::vector<std::uint32_t> rows;
    for (std::size_t i = 0; i < q.size(); ++i) {
        if (!has_pressure(q.kind[i]) || q.kind[i] == Kind::Outflow) continue;
        if (has_source(q.kind[i]) && q.density[i] < settings_.empty_ratio) {
            q.pressure[i] = 0;
            continue;
        }
        unknown_[i] = std::uint32_t(rows.size());
        rows.push_back(std::uint32_t(i));
    }

    // Divide the equation by c = 2d / (lambda n0 rho), so that the weights are those of the kernel.
    const double c = 2 * settings_.dimension /
                     (laplacian_lattice_.lambda * laplacian_lattice_.n0 * settings_.density);
    const double elastic = settings_.compressibility / (dt * dt) / c;
    system_.resize(rows.size(), lists_.stride());
    solution_.resize(rows.size());
    parallel_for(
        rows.size(),
        [&](std::size_t row) {
            const std::size_t i = rows[row];
            const Vec3d here = q.position.at(i);
            const std::uint32_t* list = lists_.of(i);
            std::uint32_t* columns = system_.columns.data() + row * system_.stride;
            float* weights = system_.weights.data() + row * system_.stride;
            double diagonal = elastic, rhs = source_[i] / c;
            std::uint32_t entries = 0;
            for (std::size_t k = 0; k < lists_.count(i); ++k) {
                const std::uint32_t j = list[k];
                if (!has_pressure(q.kind[j])) continue;
                const Vec3d d = q.position.at(j) - here;
                const float w = float(weight(std::sqrt(dot(d, d)), laplacian_radius_));
                if (w == 0) continue;
                diagonal += double(w);
                if (unknown_[j] == kKnown) {
                    rhs += double(w) * q.pressure[j];
                } else {
                    columns[entries] = unknown_[j];
                    weights[entries++] = w;
                }
            }
            // A particle without neighbours: P = 0.
            if (diagonal == 0) diagonal = 1, rhs = 0;
            system_.count[row] = entries;
            system_.diagonal[row] = diagonal;
            system_.rhs[row] = rhs;
            system_.place[row] = here;
            solution_[row] = q.pressure[i];
        },
        kGrain);
    StepReport report{dt, {}, rows.size()};
    report.convergence = solve(system_, kAggregate * settings_.spacing, settings_.tolerance,
                               settings_.largest_iteration_count, solution_);
    if (!report.convergence.converged)
        throw NumericalError(fmt::format(
            "mps: step {}: ppe_no_convergence: residual = {:.3g} after {} iterations, must be <= "
            "{:.1e}; take smaller time steps or allow more iterations",
            steps_, report.convergence.residual, report.convergence.iterations,
            settings_.tolerance));
    for (std::size_t row = 0; row < rows.size(); ++row)
        q.pressure[rows[row]] = std::max(solution_[row], 0.0);
    return report;
}

/// The gradient of the pressure takes what divergence is left out of u* and r*.
void Simulation::correct(double dt)
{
    Particles& q = particles_;
    const double factor = settings_.dimension / lattice_.n0 * dt / settings_.density;
    change_.assign(q.size(), Vec3d{});
    parallel_for(
        q.size(),
        [&](std::size_t i) {
            if (q.kind[i] != Kind::Fluid) return;
            const Vec3d here = q.position.at(i);
            const std::uint32_t* list = lists_.of(i);
            // Sum P_j and 1 apart, since the least pressure is known only at the end.
            double least = q.pressure[i];
            Vec3d with_pressure{}, alone{};
            for (std::size_t k = 0; k < lists_.count(i); ++k) {
                const std::size_t j = list[k];
                if (!has_pressure(q.kind[j])) continue;
                const Vec3d d = q.position.at(j) - here;
                const double squared = dot(d, d), w = weight(std::sqrt(squared), radius_);
                if (w == 0) continue;
                const Vec3d arm = d * (w / squared);
                alone += arm;
                with_pressure += arm * (q.pressure[j] - q.pressure[i]);
                least = std::min(least, q.pressure[j]);
            }
            change_[i] = (with_pressure + alone * (q.pressure[i] - least)) * -factor;
        },
        kGrain);
    for (std::size_t i = 0; i < q.size(); ++i) {
        if (q.kind[i] != Kind::Fluid) continue;
        q.set_velocity(i, q.velocity(i) + change_[i]);
        q.position.set(i, q.position.at(i) + change_[i] * dt);
    }
}

StepReport Simulation::step()
{
    find_eddy_viscosity();
    const double dt = time_step();
    predict(dt);
    move_boundaries(dt);
    check_domain();
    refresh_neighbours();
    collide(dt);
    refresh_neighbours();
    measure(dt);
    const StepReport report = solve_pressure(dt);
    correct(dt);
    check_domain();
    refresh_neighbours();
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

/// One touch weighs k_i / C(U0) = (U0 dt / d) (U_i / U0)^(1/2), with d = l0 [Ogasawara2003].
void Simulation::touch_water(double dt)
{
    if (!tunnel_.water_level) return;
    Particles& q = particles_;
    const double d = settings_.spacing, speed = tunnel_.speed;
    parallel_for(
        q.size(),
        [&](std::size_t i) {
            if (q.kind[i] != Kind::Fluid) return;
            const double level = tunnel_.water_level(q.position.x[i], q.position.y[i]);
            if (!(std::abs(q.position.z[i] - level) <= d)) return;
            q.touch[i] += speed * dt / d * std::sqrt(length(q.velocity(i)) / speed);
        },
        kGrain);
}

Simulation::Sample Simulation::sample(Vec3d point, double radius) const
{
    const Particles& q = particles_;
    Sample sum;
    // Particles may have moved by half a skin since they were sorted.
    cells_.for_each_run(point, radius + skin_, [&](std::size_t begin, std::size_t end) {
        for (std::size_t j = begin; j < end; ++j) {
            if (!is_air(q.kind[j])) continue;
            const double r = length(q.position.at(j) - point);
            const double w = weight(std::max(r, 1e-6 * radius), radius);
            sum.weight += w;
            sum.velocity += q.velocity(j) * w;
            sum.speed += length(q.velocity(j)) * w;
        }
    });
    if (sum.weight > 0) {
        sum.velocity = sum.velocity / sum.weight;
        sum.speed /= sum.weight;
    }
    return sum;
}

void Simulation::start_statistics(std::vector<Bounds> boxes, std::vector<Vec3d> points,
                                  double radius)
{
    if (boxes.size() > kMostBoxes)
        throw InvalidInput(
            fmt::format("mps: {} probe boxes, must be at most {}", boxes.size(), kMostBoxes));
    if (!points.empty() && !(radius > 0))
        throw InvalidInput(
            fmt::format("mps: radius of the probes = {:.6g} m, must be > 0", radius));
    boxes_ = std::move(boxes);
    box_sums_.assign(boxes_.size(), {});
    for (std::size_t b = 0; b < boxes_.size(); ++b)
        box_sums_[b].wet = tunnel_.holds_water(boxes_[b], settings_.spacing);
    points_ = std::move(points);
    point_radius_ = radius;
    point_speed_.assign(points_.size(), 0);
    point_time_.assign(points_.size(), 0);
    std::fill(particles_.probed.begin(), particles_.probed.end(), 0u);
}

void Simulation::take_statistics(double dt)
{
    Particles& q = particles_;
    for (std::size_t b = 0; b < boxes_.size(); ++b) {
        const Bounds& box = boxes_[b];
        BoxSums& sums = box_sums_[b];
        for (std::size_t i = 0; i < q.size(); ++i) {
            if (q.kind[i] != Kind::Fluid) continue;
            const Vec3d p = q.position.at(i);
            if (p.x < box.lower.x || p.x > box.upper.x || p.z < box.lower.z || p.z > box.upper.z)
                continue;
            if (settings_.dimension == 3 && (p.y < box.lower.y || p.y > box.upper.y)) continue;
            sums.time += dt;
            sums.velocity += q.velocity(i) * dt;
            sums.speed += length(q.velocity(i)) * dt;
            sums.air_touch += q.touch[i] * dt;
            if (q.probed[i] & (1u << b)) continue;
            q.probed[i] |= 1u << b;
            sums.touch += q.touch[i];
            ++sums.particles;
        }
    }
    parallel_for(
        points_.size(),
        [&](std::size_t i) {
            const Sample s = sample(points_[i], point_radius_);
            if (s.weight == 0) return;
            point_speed_[i] += s.speed * dt;
            point_time_[i] += dt;
        },
        64);
}

BoxMeans Simulation::box_means(std::size_t box) const
{
    const BoxSums& sums = box_sums_.at(box);
    BoxMeans means;
    if (sums.particles == 0) return means;
    means.speed = sums.speed / sums.time;
    means.velocity = sums.velocity / sums.time;
    means.touch = sums.wet ? sums.air_touch / sums.time : sums.touch / double(sums.particles);
    means.particles = sums.particles;
    return means;
}

std::vector<double> Simulation::point_means() const
{
    std::vector<double> means(points_.size(), 0);
    for (std::size_t i = 0; i < means.size(); ++i)
        if (point_time_[i] > 0) means[i] = point_speed_[i] / point_time_[i];
    return means;
}

}  // namespace sekitei::wind::mps
