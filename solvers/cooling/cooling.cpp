#include "solvers/cooling/cooling.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/error.h"
#include "core/hash.h"
#include "core/log.h"
#include "core/math.h"
#include "grids/leaf_stencil.h"

namespace sekitei::cooling {
namespace {

constexpr std::int32_t kLava = 0, kCold = 1, kSlow = 2;  // region ids

constexpr double kDenseVoxels = 128.0 * 128.0 * 128.0;
constexpr int kMostSteps = 10'000'000;
constexpr double kBatch = 3e7;  // voxel updates between two words of progress: below 0.1 s

/// Regions as masks, on the leaves that hold lava and those around them.
struct Body {
    TopologyPtr topology;
    std::vector<LeafMask> lava, cold, slow;  // inside the domain
    std::uint64_t lava_count = 0, slow_count = 0;
};

void check_place(const Inputs& inputs)
{
    const Coord dims = inputs.domain.dims;
    if (dims.x < 1 || dims.y < 1 || dims.z < 1)
        throw InvalidInput(
            fmt::format("cooling: heat domain = {} x {} x {} cells, must be at least 1 x 1 x 1",
                        dims.x, dims.y, dims.z));
    // Files keep a transform as rounded numbers, so equal means equal to a millionth of a voxel.
    const Transform &of_region = inputs.region.transform(), &of_domain = inputs.domain.transform;
    const double tolerance = 1e-6 * of_domain.voxel;
    const Vec3d shift = of_region.origin - of_domain.origin;
    if (std::abs(of_region.voxel - of_domain.voxel) > tolerance || length(shift) > tolerance)
        throw InvalidInput(fmt::format(
            "cooling: region: voxels of {} m from ({}, {}, {}), must be the heat domain's, {} m "
            "from ({}, {}, {}): "
            "resample the region first",
            of_region.voxel, of_region.origin.x, of_region.origin.y, of_region.origin.z,
            of_domain.voxel, of_domain.origin.x, of_domain.origin.y, of_domain.origin.z));
}

/// Region of a voxel; absent leaves have the grid's background.
std::int32_t region_at(const IntGrid& region, std::uint32_t leaf, int offset)
{
    return leaf == kNoLeaf ? region.background() : region.at(leaf, offset);
}

void check_ids(const IntGrid& region, const Domain& domain)
{
    auto check = [](std::int32_t id, Coord c) {
        if (id != kLava && id != kCold && id != kSlow)
            throw InvalidInput(
                fmt::format("cooling: region = {} at voxel ({}, {}, {}), must be 0 (lava), 1 "
                            "(cold) or 2 (slow)",
                            id, c.x, c.y, c.z));
    };
    if (region.background() != kCold)
        throw InvalidInput(
            fmt::format("cooling: region: background = {}, must be 1 (cold)", region.background()));
    for (std::size_t leaf = 0; leaf < region.leaf_count(); ++leaf) {
        const LeafMask inside = domain_mask(domain, region.origin(leaf));
        if (inside.none()) continue;
        if (region.is_constant(leaf))
            check(region.constant(leaf), region.origin(leaf));
        else
            inside.for_each(
                [&](int i) { check(region.at(leaf, i), leaf_coord(region.origin(leaf), i)); });
    }
}

Body find_body(const Inputs& inputs)
{
    const IntGrid& region = inputs.region;
    std::vector<Coord> origins;
    std::uint64_t outside = 0;
    for (std::size_t leaf = 0; leaf < region.leaf_count(); ++leaf) {
        const LeafMask in_domain = domain_mask(inputs.domain, region.origin(leaf));
        bool lava = false;
        for (int i = 0; i < kLeafSize; ++i)
            if (region.at(leaf, i) == kLava) (in_domain.test(i) ? lava = true : ++outside);
        if (lava) origins.push_back(region.origin(leaf));
    }
    if (origins.empty())
        throw InvalidInput(
            outside
                ? fmt::format("cooling: region: all {} lava voxels lie outside the heat domain of "
                              "{} x {} x {} "
                              "cells: move the body or enlarge the box",
                              outside, inputs.domain.dims.x, inputs.domain.dims.y,
                              inputs.domain.dims.z)
                : std::string(
                      "cooling: region: no lava voxels (id 0): nothing can cool; check the lava "
                      "stage's body and box"));

    Body body;
    body.topology = LeafTopology::build(std::move(origins))->dilated({0, 0, 0}, inputs.domain.dims);
    const std::size_t leaves = body.topology->size();
    body.lava.resize(leaves);
    body.cold.resize(leaves);
    body.slow.resize(leaves);
    parallel_for(
        leaves,
        [&](std::size_t leaf) {
            const Coord origin = body.topology->origin(leaf);
            const std::uint32_t source = region.topology()->find(origin);
            domain_mask(inputs.domain, origin).for_each([&](int i) {
                const std::int32_t id = region_at(region, source, i);
                (id == kLava ? body.lava : id == kCold ? body.cold : body.slow)[leaf].set(i);
            });
        },
        64);
    for (std::size_t leaf = 0; leaf < leaves; ++leaf) {
        body.lava_count += static_cast<std::uint64_t>(body.lava[leaf].count());
        body.slow_count += static_cast<std::uint64_t>(body.slow[leaf].count());
    }
    return body;
}

LeafGrid<double> initial_temperature(const Body& body, const Params& params,
                                     const Transform& transform)
{
    auto grid = LeafGrid<double>::uninitialised(body.topology, transform, params.cold_temperature);
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t leaf) {
            double* t = grid.values(leaf);
            std::fill_n(t, kLeafSize, params.cold_temperature);
            body.lava[leaf].for_each([&](int i) { t[i] = params.lava_temperature; });
            body.slow[leaf].for_each([&](int i) { t[i] = params.slow_temperature; });
        },
        64);
    grid.compress();
    return grid;
}

/// Lava voxels that touch cold ones, and on how many faces.
std::vector<Convection::Voxel> cold_contacts(const Body& body)
{
    std::vector<std::vector<LeafMask>> sides;
    for (int axis = 0; axis < 3; ++axis)
        for (int sign = -1; sign <= 1; sign += 2)
            sides.push_back(shifted_masks(*body.topology, body.cold, axis, sign));
    std::vector<Convection::Voxel> contacts;
    for (std::size_t leaf = 0; leaf < body.lava.size(); ++leaf)
        body.lava[leaf].for_each([&](int i) {
            std::uint16_t faces = 0;
            for (const auto& side : sides)
                faces = static_cast<std::uint16_t>(faces + side[leaf].test(i));
            if (faces)
                contacts.push_back(
                    {static_cast<std::uint32_t>(leaf), static_cast<std::uint16_t>(i), faces});
        });
    return contacts;
}

Convection convection_of(const Body& body, const Params& params)
{
    Convection convection;
    convection.air_temperature = params.cold_temperature;
    if (params.robin) {
        convection.conductance = 1 / (0.5 + 1 / *params.robin);
        convection.voxels = cold_contacts(body);
    }
    return convection;
}

/// The maximum principle: no weight of T in T' may be negative.
void check_stable(const HeatProblem& problem, const Params& params)
{
    if (params.allow_unstable) return;
    double most = 6;
    for (const Convection::Voxel& v : problem.convection.voxels)
        most = std::max(most, 6 + v.faces * (problem.convection.conductance - 1));
    if (params.alpha * most > 1 + 1e-12)
        throw InvalidParameter(
            fmt::format("cooling: alpha = {}, must be <= {:.6g}: the convective surface (robin = "
                        "{}) makes larger steps unstable",
                        params.alpha, 1 / most, *params.robin));
}

// Checkpoints: a line of text that says whose they are, the temperatures, a hash of all that.

constexpr std::string_view kMagic = "sekitei cooling checkpoint\n";
constexpr std::size_t kHashDigits = 32;

/// What a run is made of; two runs that agree in it take the same steps.
Json identity_of(const Inputs& inputs, const Body& body, Params params, int steps)
{
    params.steps = steps;
    Hasher hasher;
    for (std::size_t leaf = 0; leaf < body.lava.size(); ++leaf) {
        hasher.add_value(body.topology->origin(leaf));
        hasher.add_value(body.lava[leaf].words);
        hasher.add_value(body.cold[leaf].words);
        hasher.add_value(body.slow[leaf].words);
    }
    const Coord dims = inputs.domain.dims;
    return {{"version", SEKITEI_VERSION},
            {"cells", {dims.x, dims.y, dims.z}},
            {"region", hasher.hex()},
            {"parameters", params_json(describe_params(params))}};
}

struct Saved {
    int steps = 0;
    double change = 0;
    std::vector<double> values;
};

std::string checkpoint_bytes(const Json& identity, const Saved& saved)
{
    Json header = identity;
    header["steps"] = saved.steps;
    std::string bytes = std::string(kMagic) + header.dump() + "\n";
    bytes.append(reinterpret_cast<const char*>(&saved.change), sizeof(double));
    bytes.append(reinterpret_cast<const char*>(saved.values.data()),
                 saved.values.size() * sizeof(double));
    return bytes + hash_hex(bytes);
}

/// The first parameter or property in which two identities differ, with both values.
std::string first_difference(const Json& found, const Json& expected)
{
    for (const auto& [key, value] : expected.items()) {
        const Json other = found.contains(key) ? found[key] : Json();
        if (other == value) continue;
        if (value.is_object() && other.is_object()) return first_difference(other, value);
        return fmt::format("{} = {}, this run has {}", key, other.dump(), value.dump());
    }
    return "it has other parameters";
}

Saved read_checkpoint(const std::string& bytes, const Json& identity, std::uint64_t voxels)
{
    const std::string where = "cooling: checkpoint: ", mend = ": remove it to begin again";
    if (bytes.compare(0, kMagic.size(), kMagic) != 0)
        throw InvalidInput(where + "not a checkpoint of this stage" + mend);
    const std::size_t line_end = bytes.find('\n', kMagic.size());
    if (line_end == std::string::npos || bytes.size() < line_end + 1 + sizeof(double) + kHashDigits)
        throw InvalidInput(where + fmt::format("cut off after {} bytes", bytes.size()) + mend);
    const std::string_view content(bytes.data(), bytes.size() - kHashDigits);
    if (hash_hex(content) != std::string_view(bytes).substr(content.size()))
        throw InvalidInput(
            where +
            fmt::format("damaged: its {} bytes do not have the hash they end with", bytes.size()) +
            mend);

    Json header =
        Json::parse(bytes.begin() + kMagic.size(),
                    bytes.begin() + static_cast<std::ptrdiff_t>(line_end), nullptr, false);
    const Json done = header.is_object() ? header.value("steps", Json()) : Json();
    if (!done.is_number_integer() || done < 0 || done > std::numeric_limits<int>::max())
        throw InvalidInput(where + "its header cannot be read" + mend);
    Saved saved;
    saved.steps = done.get<int>();
    header.erase("steps");
    if (header != identity)
        throw InvalidInput(where + "of another run: " + first_difference(header, identity) + mend);
    const std::size_t expected = line_end + 1 + (1 + voxels) * sizeof(double) + kHashDigits;
    if (bytes.size() != expected)
        throw InvalidInput(where + fmt::format("{} bytes, must be {}", bytes.size(), expected) +
                           mend);
    saved.values.resize(voxels);
    std::memcpy(&saved.change, bytes.data() + line_end + 1, sizeof(double));
    std::memcpy(saved.values.data(), bytes.data() + line_end + 1 + sizeof(double),
                voxels * sizeof(double));
    return saved;
}

/// Runs the solver to its end, saving on the way.
Saved cool(HeatSolver& solver, const Body& body, const Params& params, int steps,
           const Json& identity, const Checkpoint& checkpoint, const Progress& progress)
{
    const bool steady = params.stop == Stop::Steady;
    const auto voxels = static_cast<double>(body.lava_count);
    int first = 0;
    Saved now;
    if (!checkpoint.resume.empty()) {
        now = read_checkpoint(checkpoint.resume, identity, body.lava_count);
        first = now.steps;
        solver.set_free_values(now.values);
        now.values.clear();
    }
    auto save = [&] {
        if (!checkpoint.save) return;
        now.steps = first + solver.steps();
        now.values = solver.free_values();
        checkpoint.save(checkpoint_bytes(identity, now));
    };

    const int batch = static_cast<int>(std::clamp(kBatch / voxels, 1.0, 1000.0));
    double since_save = 0, first_change = 0;
    bool done =
        now.steps >= steps || (steady && now.steps > 0 && now.change < params.steady_change);
    try {
        while (!done) {
            // The last step, and every step of a search for the steady state, is measured.
            const int left = steps - (first + solver.steps());
            const int taken = steady || left == 1 ? 1 : std::min(batch, left - 1);
            if (steady || left == 1)
                now.change = solver.step(progress);
            else
                solver.advance(taken, progress);
            const int at = first + solver.steps();
            if (first_change == 0) first_change = now.change;
            done = at >= steps || (steady && now.change < params.steady_change);

            since_save += taken * voxels;
            if (!done && since_save >= checkpoint.interval) {
                save();
                since_save = 0;
            }
            if (!std::isfinite(now.change))
                throw NumericalError(
                    fmt::format("cooling: the temperature overflows at step {} with alpha = {}, "
                                "which is stable up to 1/6",
                                at, params.alpha));
            const bool falling = steady && first_change > params.steady_change && now.change > 0;
            progress.update(falling ? std::clamp(math::log(first_change / now.change) /
                                                     math::log(first_change / params.steady_change),
                                                 0.0, 1.0)
                                    : double(at) / steps);
        }
    } catch (const Cancelled&) {
        save();
        throw;
    }
    now.steps = first + solver.steps();
    now.values = solver.free_values();
    if (!std::all_of(now.values.begin(), now.values.end(),
                     [](double t) { return std::abs(t) <= 3.4e38; }))
        throw NumericalError(
            fmt::format("cooling: the temperature overflows within {} steps with alpha = {}, which "
                        "is stable up to 1/6",
                        now.steps, params.alpha));
    if (steady && !(now.change < params.steady_change))
        throw NumericalError(fmt::format(
            "cooling: not steady after {} steps: largest change = {} K, must be < {} K; "
            "allow more steps or a larger steady_change",
            now.steps, now.change, params.steady_change));
    return now;
}

/// The leaves of `masks` that have an active voxel, as an empty grid with those masks.
template <class T>
LeafGrid<T> grid_on(const LeafTopology& topology, const std::vector<LeafMask>& masks,
                    const Transform& transform, T background)
{
    std::vector<Coord> origins;
    for (std::size_t leaf = 0; leaf < masks.size(); ++leaf)
        if (!masks[leaf].none()) origins.push_back(topology.origin(leaf));
    LeafGrid<T> grid(LeafTopology::build(std::move(origins)), transform, background);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.mask(leaf) = masks[topology.find(grid.origin(leaf))];
    return grid;
}

FloatGrid as_floats(const LeafGrid<double>& source, const IntGrid& where, const Params& params)
{
    auto grid = FloatGrid::uninitialised(where.topology(), where.transform(),
                                         static_cast<float>(params.cold_temperature));
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t leaf) {
            grid.mask(leaf) = where.mask(leaf);
            const std::uint32_t from = source.topology()->find(grid.origin(leaf));
            for (int i = 0; i < kLeafSize; ++i)
                grid.values(leaf)[i] = static_cast<float>(source.at(from, i));
        },
        64);
    grid.compress();
    return grid;
}

/// Splits the gradient into direction and magnitude; plateaus have neither.
void store_gradient(const LeafGrid<Vec3d>& gradient, double plateau, Result& result)
{
    const Transform& transform = gradient.transform();
    result.gradient = VectorGrid::uninitialised(gradient.topology(), transform, Vec3f());
    result.gradient_magnitude = FloatGrid::uninitialised(gradient.topology(), transform, 0);
    parallel_for(
        gradient.leaf_count(),
        [&](std::size_t leaf) {
            for (int i = 0; i < kLeafSize; ++i) {
                const Vec3d g = gradient.at(leaf, i);
                const double magnitude = length(g);
                const bool directed = magnitude >= plateau && magnitude > 0;
                result.gradient.values(leaf)[i] = directed ? Vec3f(g / magnitude) : Vec3f();
                result.gradient_magnitude.values(leaf)[i] =
                    directed ? static_cast<float>(magnitude) : 0;
                if (directed && gradient.mask(leaf).test(i)) result.gradient.mask(leaf).set(i);
            }
            result.gradient_magnitude.mask(leaf) = result.gradient.mask(leaf);
        },
        64);
    result.gradient.compress();
    result.gradient_magnitude.compress();
}

constexpr std::string_view kNoSurface = "no cooling surface: no columns possible";

}  // namespace

void validate(const Params& params)
{
    validate_described("cooling", params);
    if (params.alpha > 1.0 / 6 && !params.allow_unstable)
        throw InvalidParameter(
            fmt::format("cooling: alpha = {}, must be <= 1/6: larger steps are unstable "
                        "(allow_unstable takes them)",
                        params.alpha));
}

int suitable_steps(const IntGrid& region, const Domain& domain, double alpha, int most)
{
    // Peel layers off the lava from its cold contact until none is left.
    const Coord n = domain.dims;
    auto at = [&](int x, int y, int z) {
        return (std::size_t(x) * std::size_t(n.y) + std::size_t(y)) * std::size_t(n.z) +
               std::size_t(z);
    };
    std::vector<std::int32_t> id(std::size_t(n.x) * std::size_t(n.y) * std::size_t(n.z));
    std::vector<Coord> rim, next;
    GridReader<std::int32_t> read(region);
    for (int x = 0; x < n.x; ++x)
        for (int y = 0; y < n.y; ++y)
            for (int z = 0; z < n.z; ++z) {
                id[at(x, y, z)] = read.value({x, y, z});
                if (id[at(x, y, z)] == kSlow) return most;
                if (id[at(x, y, z)] == kCold) rim.push_back({x, y, z});
            }
    int layers = 0;
    for (; !rim.empty(); rim.swap(next)) {
        next.clear();
        for (const Coord& c : rim)
            for (int axis = 0; axis < 3; ++axis)
                for (const int step : {-1, 1}) {
                    Coord b = c;
                    b[axis] += step;
                    if (!domain.contains(b) || id[at(b.x, b.y, b.z)] != kLava) continue;
                    id[at(b.x, b.y, b.z)] = kCold;
                    next.push_back(b);
                }
        if (!next.empty()) ++layers;
    }
    const double steps = 0.083 * layers * layers / alpha;
    return static_cast<int>(std::clamp(std::floor(steps + 0.5), 4.0, double(most)));
}

Result run(const Inputs& inputs, const Params& params, const Checkpoint& checkpoint,
           const Progress& progress)
{
    validate(params);
    check_place(inputs);
    check_ids(inputs.region, inputs.domain);

    // Set the problem: lava is free, cold and slow voxels are held.
    const Body body = find_body(inputs);
    const Transform& transform = inputs.domain.transform;
    HeatProblem problem{inputs.domain, initial_temperature(body, params, transform), body.lava,
                        params.alpha, convection_of(body, params)};
    check_stable(problem, params);

    // Find what will be active, and whether anything there can cool at all.
    std::vector<LeafMask> active = dilated_masks(*body.topology, body.lava);
    bool differs = false;
    for (std::size_t leaf = 0; leaf < active.size(); ++leaf) {
        const LeafMask inside = domain_mask(inputs.domain, body.topology->origin(leaf));
        for (std::size_t w = 0; w < 8; ++w) {
            active[leaf].words[w] &= inside.words[w];
            const std::uint64_t cold = active[leaf].words[w] & body.cold[leaf].words[w];
            const std::uint64_t slow = active[leaf].words[w] & body.slow[leaf].words[w];
            differs = differs || (cold && params.cold_temperature != params.lava_temperature) ||
                      (slow && params.slow_temperature != params.lava_temperature);
        }
    }
    if (!differs)
        throw InvalidInput(
            fmt::format("cooling: the lava and all it touches have {} K: {}; give the lava a "
                        "contact of another temperature",
                        params.lava_temperature, kNoSurface));

    // Solve.
    const bool steady = params.stop == Stop::Steady;
    const int steps = params.steps.value_or(steady ? kMostSteps : inputs.default_steps);
    const bool dense = inputs.domain.voxel_count() <= kDenseVoxels;
    log::info("cooling: {} lava cells of {:g} m, alpha = {:g}, {}{} steps, {}", body.lava_count,
              transform.voxel, params.alpha, steady ? "at most " : "", steps,
              dense ? "dense" : "sparse");
    Result result;
    LeafGrid<double> temperature;
    {
        const auto solver = dense ? dense_heat_solver(problem) : sparse_heat_solver(problem);
        const Saved end = cool(*solver, body, params, steps,
                               identity_of(inputs, body, params, steps), checkpoint, progress);
        result.steps = end.steps;
        result.last_change = end.change;
        temperature = with_free_values(problem, end.values);
    }

    // Store the temperature and its direction on the lava and one cell around it.
    const IntGrid where = grid_on<std::int32_t>(*body.topology, active, transform, 0);
    result.temperature = as_floats(temperature, where, params);
    const double hot = std::max(params.lava_temperature, body.slow_count ? params.slow_temperature
                                                                         : params.lava_temperature);
    const double plateau = params.plateau_gradient.value_or(
        inputs.default_plateau_share * std::abs(hot - params.cold_temperature));
    progress.check();
    store_gradient(sobel_gradient(temperature, where, inputs.domain), plateau, result);
    if (result.gradient.active_count() == 0)
        throw InvalidInput(
            fmt::format("cooling: after {} steps the gradient is nowhere above plateau_gradient = "
                        "{} K per cell: {}; "
                        "take fewer steps or a lower plateau_gradient",
                        result.steps, plateau, kNoSurface));
    return result;
}

}  // namespace sekitei::cooling
