#include "solvers/wind/wind.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/log.h"
#include "core/math.h"
#include "solvers/wind/grid_wind.h"
#include "solvers/wind/mps.h"
#include "solvers/wind/tunnel_scene.h"

namespace sekitei::wind {
namespace {

constexpr std::size_t kDirections = 8;
constexpr std::array<std::string_view, kDirections> kNames{"N", "NE", "E", "SE",
                                                           "S", "SW", "W", "NW"};
constexpr double kMostCells = 5e7;
constexpr double kLayer = 0.5;           // [m]
constexpr std::size_t kMostLayers = 31;  // with the whole probe, what particles can tell apart
constexpr double kReferenceSpeed = 3, kReferenceSpacing = 0.5;  // of settle and duration
constexpr Vec3d kGarden{24, 16, 8};
constexpr double kPlace = 14.0 / 24;  // of the object along the garden
constexpr double kGardenRadius = 2;   // of the largest object that the usual garden is for [m]
constexpr double kBytesPerParticle = 2700, kBytesPerCell = 350;  // of the usual garden, measured

/// The least multiple of `step` that is not less than x.
double round_up(double x, double step)
{
    return std::ceil(x / step - 1e-9) * step;
}

double volume(Vec3d size)
{
    return size.x * size.y * size.z;
}

/// The object as it stands across the wind from a direction: its cells' box in the tunnel.
Bounds extent(std::span<const Vec3d> cells, const Heading& heading, double half_voxel)
{
    Bounds box;
    for (const Vec3d& cell : cells) box.add(heading.tunnel(cell));
    box.lower -= Vec3d(half_voxel);
    box.upper += Vec3d(half_voxel);
    box.lower.z = std::max(box.lower.z, 0.0);
    box.upper.z = std::max(box.upper.z, 0.0);
    return box;
}

struct Measured {
    std::vector<BoxMeans> boxes;
    std::vector<double> points;
};

/// Runs until the flow has settled, then measures.
template <class Simulation>
Measured measure(Simulation wind, const WindTunnel& tunnel, double scale, const Params& params,
                 std::vector<Bounds> boxes, std::vector<Vec3d> points, double radius,
                 const Progress& progress)
{
    const double slow = kReferenceSpeed / tunnel.speed;
    const double begin = tunnel.size.x / tunnel.speed + params.settle * slow * scale;
    const double end = begin + params.duration * slow * scale;
    const auto run_until = [&](double time) {
        while (wind.time() < time) {
            wind.step();
            progress.update(std::min(1.0, wind.time() / end));
        }
    };
    run_until(begin);
    const std::size_t count = boxes.size();
    wind.start_statistics(std::move(boxes), std::move(points), radius);
    run_until(end);
    Measured measured;
    for (std::size_t b = 0; b < count; ++b) measured.boxes.push_back(wind.box_means(b));
    measured.points = wind.point_means();
    return measured;
}

Measured measure(const WindTunnel& tunnel, double l0, const Params& params,
                 std::vector<Bounds> boxes, std::vector<Vec3d> points, double radius,
                 const Progress& progress)
{
    const double scale = l0 / kReferenceSpacing;
    if (params.solver == Solver::Mps)
        return measure(mps::Simulation(mps::Settings::air(3, l0, tunnel.speed), tunnel), tunnel,
                       scale, params, std::move(boxes), std::move(points), radius, progress);
    return measure(grid::Simulation(grid::Settings::air(l0, tunnel.speed), tunnel), tunnel, scale,
                   params, std::move(boxes), std::move(points), radius, progress);
}

/// Whether air can come in and go out.
bool passable(const WindTunnel& tunnel, double l0)
{
    const int ny = int(std::round(tunnel.size.y / l0)), nz = int(std::round(tunnel.size.z / l0));
    bool in = false, out = false;
    for (int j = 0; j < ny; ++j)
        for (int k = 0; k < nz; ++k) {
            const Vec3d p = tunnel.lower + Vec3d(0.5, j + 0.5, k + 0.5) * l0;
            in |= !tunnel.solid(p);
            out |= !tunnel.solid(p + Vec3d(tunnel.size.x - l0, 0, 0));
        }
    return in && out;
}

/// The direction [rad] from which a flow comes.
double comes_from(Vec3d flow)
{
    const double azimuth = math::atan2(-flow.x, -flow.y);
    return azimuth < 0 ? azimuth + 2 * math::kPi : azimuth;
}

struct Stage {
    const Inputs& inputs;
    const Params& params;
    const Plan& boxes;

    Heading heading(std::size_t direction) const
    {
        return Heading::from(int(direction), boxes.axis);
    }
    double half_voxel() const { return 0.5 * inputs.object->transform().voxel; }
    std::size_t layer_count(double height) const
    {
        return std::size_t(
            std::clamp(std::ceil(height / layer_height(height) - 1e-9), 1.0, double(kMostLayers)));
    }
    double layer_height(double height) const
    {
        return std::max({kLayer, boxes.garden_spacing, height / double(kMostLayers)});
    }

    /// The garden without the object.
    void garden(std::size_t k, const Progress& progress, State& state) const
    {
        const Heading way = heading(k);
        const double l0 = boxes.garden_spacing, margin = params.probe_margin;
        WindTunnel tunnel;
        tunnel.size = boxes.garden_size;
        tunnel.lower = {-boxes.place, -0.5 * tunnel.size.y, 0};
        tunnel.speed = params.speed;
        TunnelContents contents;
        if (inputs.obstacle) contents.solids.push_back(inputs.obstacle);
        contents.water = inputs.water;
        contents.canopy = inputs.canopy;
        tunnel = fill_tunnel(tunnel, l0, way, contents, progress);

        Bounds probe = extent(inputs.cells, way, half_voxel());
        probe.lower -= Vec3d(margin);
        probe.upper += Vec3d(margin);
        probe.lower.z = 0;
        std::vector<Bounds> probes{probe};
        const double height = layer_height(probe.upper.z);
        if (params.per_layer)
            for (std::size_t layer = 0; layer < layer_count(probe.upper.z); ++layer) {
                Bounds part = probe;
                part.lower.z = double(layer) * height;
                part.upper.z = std::min(probe.upper.z, double(layer + 1) * height);
                probes.push_back(part);
            }
        std::vector<BoxMeans> means(probes.size());
        if (passable(tunnel, l0))
            means = measure(tunnel, l0, params, probes, {}, 0, progress).boxes;

        AirTables& tables = state.tables;
        const BoxMeans& whole = means[0];
        if (whole.particles == 0)
            state.warnings.push_back(
                fmt::format("wind from {}: no air reaches the object's place; A_U = 0", kNames[k]));
        tables.speed[k] = whole.speed / params.speed;
        tables.temperature[k] = tables.humidity[k] = whole.touch;
        const Vec3d flow = way.along * whole.velocity.x + way.across * whole.velocity.y;
        tables.direction[k] = length(flow) > 0 ? comes_from(flow) : AirTables::straight()[k];
        if (params.per_layer) {
            tables.layers.resize(means.size() - 1);
            tables.layer_base = boxes.axis.z;
            tables.layer_height = height;
            for (std::size_t layer = 1; layer < means.size(); ++layer)
                tables.layers[layer - 1][k] = means[layer].touch;
        }
        state.garden[k] = true;
    }

    /// The object alone, in air that arrives from a direction.
    void object(std::size_t arrival, const Progress& progress, State& state) const
    {
        const Heading way = heading(arrival);
        const double l0 = boxes.object_spacing;
        WindTunnel tunnel = object_box(arrival);
        tunnel.speed = params.speed;
        tunnel = fill_tunnel(tunnel, l0, way, {.solids = {inputs.object}}, progress);
        std::vector<float>& ratio = state.arrival[arrival];
        ratio.assign(inputs.cells.size(), 0);
        if (passable(tunnel, l0)) {
            std::vector<Vec3d> points;
            points.reserve(inputs.cells.size());
            for (const Vec3d& cell : inputs.cells) points.push_back(way.tunnel(cell));
            const Measured measured =
                measure(tunnel, l0, params, {}, std::move(points), boxes.sample_radius, progress);
            for (std::size_t i = 0; i < ratio.size(); ++i)
                ratio[i] = float(measured.points[i] / params.speed);
        } else {
            state.warnings.push_back(
                fmt::format("air from {}: the rock fills the box from end to end, no air passes "
                            "it; its ratios are 0",
                            kNames[arrival]));
        }
        state.object[arrival] = true;
    }

    WindTunnel object_box(std::size_t arrival) const
    {
        const Bounds body = extent(inputs.cells, heading(arrival), half_voxel());
        const double l0 = boxes.object_spacing, margin = boxes.object_margin;
        WindTunnel tunnel;
        const Vec3d size = body.size() + Vec3d(2 * margin);
        tunnel.size = {round_up(size.x, l0), round_up(size.y, l0),
                       round_up(body.upper.z + margin, l0)};
        tunnel.lower = body.centre() - tunnel.size * 0.5;
        tunnel.lower.z = 0;
        return tunnel;
    }
};

void check(const Inputs& inputs)
{
    if (!inputs.object || inputs.cells.empty())
        throw InvalidInput("wind: no_surface_cells: there is no object, must have cells");
}

/// The default spacing, or a coarser one that makes no more than `most` cells in steps of `step`.
double bounded_spacing(double spacing, double step, double room, double most)
{
    const double least = std::cbrt(room / most);
    return least <= spacing ? spacing : round_up(least, step);
}

/// Height of the leaves around the object where they are trees; a low box would leave the wind no
/// way but through them.
double tall_canopy(const Inputs& inputs, Vec3d axis)
{
    constexpr double kAround = 32, kLow = 6;  // [m]
    if (!inputs.canopy) return 0;
    const FloatGrid& canopy = *inputs.canopy;
    const Transform& transform = canopy.transform();
    const double half = 0.5 * kLeafEdge * transform.voxel;
    double top = 0;
    for (std::size_t leaf = 0; leaf < canopy.leaf_count(); ++leaf) {
        const Vec3d at = transform.world(Vec3d(canopy.origin(leaf))) + Vec3d(half) - axis;
        if (std::max(std::abs(at.x), std::abs(at.y)) > kAround || at.z + half <= top) continue;
        canopy.mask(leaf).for_each([&](int o) {
            if (canopy.at(leaf, o) > 0)
                top = std::max(top, at.z - half + ((o & 7) + 1) * transform.voxel);
        });
    }
    return top > kLow ? top : 0;
}

void check_count(const char* what, double count, double spacing)
{
    if (count > kMostCells)
        throw LimitExceeded(fmt::format(
            "wind: {} = {:.6g} m makes {} cells, must be at most {}; give a larger one, or leave "
            "it auto",
            what, spacing, count_text(count), count_text(kMostCells)));
}

}  // namespace

void validate(const Params& params)
{
    validate_described("wind", params);
}

Plan plan(const Inputs& inputs, const Params& params)
{
    validate(params);
    check(inputs);
    Bounds body;
    for (const Vec3d& cell : inputs.cells) body.add(cell);
    const double half_voxel = 0.5 * inputs.object->transform().voxel;
    body.lower -= Vec3d(half_voxel);
    body.upper += Vec3d(half_voxel);
    Plan found;
    found.axis = body.centre();
    found.axis.z = params.ground.value_or(body.lower.z);
    const double height = std::max(0.0, body.upper.z - found.axis.z);

    // The garden grows with objects that its usual probe could not hold.
    double radius = 0;
    for (const Vec3d& cell : inputs.cells)
        radius = std::max(
            radius, length(Vec3d(cell.x - found.axis.x, cell.y - found.axis.y, 0)) + half_voxel);
    const double more = 2 * std::max(0.0, std::ceil(radius - kGardenRadius));
    found.garden_size = params.garden_size.value_or(
        max(kGarden + Vec3d(1.5 * more, more, std::max(0.0, std::ceil(2 * height - 4))),
            Vec3d(3, 2, 2) * std::ceil(tall_canopy(inputs, found.axis))));
    double& l0 = found.garden_spacing;
    l0 = params.garden_spacing.value_or(
        bounded_spacing(kReferenceSpacing, 0.05, volume(found.garden_size), params.largest_count));
    Vec3d& size = found.garden_size;
    size = {round_up(size.x, l0), round_up(size.y, l0), round_up(size.z, l0)};
    found.place = std::round(kPlace * size.x / l0) * l0;
    found.garden_count = volume(size) / (l0 * l0 * l0);
    if (!params.garden_spacing && l0 > kReferenceSpacing)
        found.notes.push_back(fmt::format(
            "garden at {:.2f} m instead of {:.2f} m: its box of {:.0f} x {:.0f} x {:.0f} m would "
            "hold more than {}",
            l0, kReferenceSpacing, size.x, size.y, size.z, count_text(params.largest_count)));
    check_count("garden_spacing", found.garden_count, l0);
    const double reach = radius + params.probe_margin, top = height + params.probe_margin;
    if (reach > found.place || found.place + reach > size.x || reach > 0.5 * size.y || top > size.z)
        throw InvalidParameter(fmt::format(
            "wind: garden_size = {:.6g} x {:.6g} x {:.6g} m, must hold the probe, {:.6g} m around "
            "the object at {:.6g} m and {:.6g} m high; leave it auto or give more",
            size.x, size.y, size.z, reach, found.place, top));

    const Vec3d box = body.size();
    const double longest = std::max({box.x, box.y, height});
    found.object_margin = params.object_margin.value_or(std::max(0.4, 0.25 * longest));
    const double fine = std::min(0.05, longest / 10);
    const Stage stage{inputs, params, found};
    found.object_spacing = fine;  // with which boxes are measured for the number that follows
    double room = 0;
    for (std::size_t k = 0; k < kDirections; ++k)
        room = std::max(room, volume(stage.object_box(k).size));
    found.object_spacing =
        params.object_spacing.value_or(bounded_spacing(fine, 0.01, room, params.largest_count));
    const double s = found.object_spacing;
    check_count("object_spacing", room / (s * s * s), s);
    for (std::size_t k = 0; k < kDirections; ++k)
        found.object_count =
            std::max(found.object_count, volume(stage.object_box(k).size) / (s * s * s));
    found.sample_radius = std::max(params.sample_radius, 2 * s);
    if (!params.object_spacing && s > fine)
        found.notes.push_back(fmt::format(
            "wind around the object at {:.2f} m instead of {:.2f} m: its box would hold {} cells, "
            "more than {}",
            s, fine, count_text(room / (fine * fine * fine)), count_text(params.largest_count)));
    found.bytes = std::max(found.garden_count, found.object_count) *
                      (params.solver == Solver::Mps ? kBytesPerParticle : kBytesPerCell) +
                  double(inputs.cells.size()) * (8 * sizeof(float) * 2 + 2 * sizeof(Vec3d));
    return found;
}

Result run(const Inputs& inputs, const Params& params, const Progress& progress, State before,
           const std::function<void(const State&)>& save)
{
    const Plan boxes = plan(inputs, params);
    const Stage stage{inputs, params, boxes};
    State state = std::move(before);
    for (std::size_t k = 0; k < kDirections; ++k)
        if (state.object[k] && state.arrival[k].size() != inputs.cells.size())
            throw InvalidInput(
                fmt::format("wind: the earlier part of this run has {} cells, must have {}",
                            state.arrival[k].size(), inputs.cells.size()));
    log::info("wind: garden of {:.0f} cells of {:.3g} m, object of {:.0f} cells of {:.3g} m",
              boxes.garden_count, boxes.garden_spacing, boxes.object_count, boxes.object_spacing);

    for (std::size_t k = 0; k < kDirections; ++k) {
        if (state.garden[k]) continue;
        stage.garden(k, progress.slice(double(k) / 16, double(k + 1) / 16), state);
        if (save) save(state);
    }
    std::array<bool, kDirections> needed{};
    for (std::size_t k = 0; k < kDirections; ++k)
        needed[std::size_t(nearest_direction(state.tables.direction[k]))] = true;
    const double count = double(std::count(needed.begin(), needed.end(), true));
    double done = 0;
    for (std::size_t k = 0; k < kDirections; ++k) {
        if (!needed[k]) continue;
        const Progress part =
            progress.slice(0.5 + 0.5 * done / count, 0.5 + 0.5 * (done + 1) / count);
        ++done;
        if (state.object[k]) continue;
        stage.object(k, part, state);
        if (save) save(state);
    }

    Result result;
    result.tables = state.tables;
    for (std::size_t k = 0; k < kDirections; ++k) {
        result.arrival[k] = nearest_direction(state.tables.direction[k]);
        result.ratio[k] = state.arrival[std::size_t(result.arrival[k])];
    }
    result.notes = boxes.notes;
    result.notes.insert(result.notes.end(), state.warnings.begin(), state.warnings.end());
    return result;
}

}  // namespace sekitei::wind
