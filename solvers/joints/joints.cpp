#include "solvers/joints/joints.h"

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/log.h"
#include "core/parallel.h"

namespace sekitei::joints {
namespace {

constexpr double kDefaultSpacing = 12.5;  // [voxels], as 400 seeds on 250^2
/// Of sqrt(area / count): 92 % of what random packing can reach [Ito2004, table 1 read as radii].
constexpr double kRadiusShare = 0.8;
constexpr double kLeastPlaced = 0.9;
constexpr double kLeastWidth = 2;  // [voxels]; thinner columns cannot be told apart

/// Somewhere a direction to follow.
bool has_gradient(const VectorGrid& gradient)
{
    for (std::size_t i = 0; i < gradient.leaf_count(); ++i) {
        bool found = false;
        gradient.mask(i).for_each([&](int offset) {
            const Vec3f g = gradient.at(i, offset);
            found = found || dot(g, g) > 0;
        });
        if (found) return true;
    }
    return false;
}

double area_of(const TriMesh& mesh)
{
    return parallel_sum(mesh.triangles.size(), [&](std::size_t t) {
        const auto& v = mesh.triangles[t];
        const Vec3d a(mesh.vertices[v[0]]), b(mesh.vertices[v[1]]), c(mesh.vertices[v[2]]);
        return 0.5 * length(cross(b - a, c - a));
    });
}

std::vector<Vec3d> given_seeds(const Inputs& inputs)
{
    const Vec3d size(inputs.domain.dims);
    std::vector<Vec3d> seeds;
    for (std::size_t i = 0; i < inputs.explicit_seeds.size(); ++i) {
        const Vec3d w = inputs.explicit_seeds[i], p = inputs.domain.transform.voxels(w);
        if (!(p.x >= 0 && p.y >= 0 && p.z >= 0 && p.x <= size.x && p.y <= size.y && p.z <= size.z))
            throw InvalidInput(fmt::format(
                "joints: seed {} at ({:g}, {:g}, {:g}) m lies outside the box; move it inside", i,
                w.x, w.y, w.z));
        seeds.push_back(p);
    }
    return seeds;
}

/// Throws and evens out the seeds; voxel units.
std::vector<Vec3d> thrown_seeds(const Inputs& inputs, const Params& params, std::uint64_t seed,
                                const Progress& progress)
{
    const TriMesh surface = cooling_surface(inputs, progress.slice(0, 0.3));
    const double h = inputs.domain.transform.voxel, area = area_of(surface);
    if (!(area > 0))
        throw InvalidInput(
            "joints: no cooling surface: no columns possible; the lava touches nothing cold inside "
            "the box (give it a cold part, or a larger box)");

    // How many, and how far apart.
    double wanted = area / (kDefaultSpacing * kDefaultSpacing);
    if (params.count)
        wanted = *params.count;
    else if (params.spacing)
        wanted = area * h * h / (*params.spacing * *params.spacing);
    else if (inputs.default_count)
        wanted = *inputs.default_count;
    if (params.spacing && !params.count && wanted < 1)
        throw InvalidParameter(
            fmt::format("joints: spacing = {:g} m is more than the cooling surface has: {:g} m^2, "
                        "{:g} m across; "
                        "give a spacing below {:g} m",
                        *params.spacing, area * h * h, std::sqrt(area) * h, std::sqrt(area) * h));
    const double width = std::sqrt(area / wanted);
    if (width < kLeastWidth)
        throw InvalidParameter(fmt::format(
            "joints: {} = {} makes columns {:.2g} voxels wide, must be at least {:g}: {} = {:g} at "
            "this voxel edge of {:g} m; or make the voxels smaller",
            params.count ? "count" : "spacing",
            params.count ? std::to_string(*params.count)
                         : fmt::format("{:g} m", params.spacing.value_or(kDefaultSpacing * h)),
            width, kLeastWidth, params.count ? "at most count" : "spacing",
            params.count ? std::floor(area / (kLeastWidth * kLeastWidth)) : kLeastWidth * h, h));
    const auto count = static_cast<std::size_t>(std::max(1.0, std::floor(wanted + 0.5)));
    const double radius = params.seed_radius ? *params.seed_radius / h
                                             : kRadiusShare * std::sqrt(area / double(count));
    const double bound = kSaturation * area / (radius * radius);
    // So far over the bound that no throw can help: say so at once.
    const bool hopeless = double(count) * kLeastPlaced > 4 * bound + 16;

    std::vector<Vec3d> seeds;
    if (!hopeless)
        seeds = params.seed_mode == SeedMode::Plane
                    ? poisson_disk_plane(surface, count, radius, seed, progress)
                    : poisson_disk(surface, count, radius, seed, progress);
    progress.update(0.4);
    if (hopeless || double(seeds.size()) < kLeastPlaced * double(count))
        throw InvalidParameter(fmt::format(
            "joints: {} of {} seeds fit with seed_radius = {:g} m (spacing {:g} m) on {:g} m^2 of "
            "cooling surface, which holds about {:.0f}; ask for at most {:.0f}, or give a "
            "seed_radius below {:g} m",
            hopeless ? std::string("not 90 %") : std::to_string(seeds.size()), count, radius * h,
            std::sqrt(area / double(count)) * h, area * h * h, bound, bound,
            kRadiusShare * std::sqrt(area / double(count)) * h));

    const Progress relaxing = progress.slice(0.4, 1);
    return params.target_cv ? relax_to(surface, std::move(seeds), *params.target_cv, relaxing)
                            : relax(surface, std::move(seeds), params.maturity, relaxing);
}

}  // namespace

void validate(const Params& params)
{
    validate_described("joints", params);
    if (params.spacing && params.count)
        throw InvalidParameter(fmt::format(
            "joints: spacing = {:g} m and count = {}, must be only one of them; leave one out",
            *params.spacing, *params.count));
}

Result run(const Inputs& inputs, const Params& params, std::uint64_t seed, const Progress& progress)
{
    validate(params);
    if (!has_gradient(inputs.gradient))
        throw InvalidInput(
            "joints: no cooling surface: no columns possible; the temperature gradient is zero "
            "everywhere (is any side of the lava cold, and did it cool for long enough?)");

    Result result;
    const Transform& transform = inputs.domain.transform;
    const std::vector<Vec3d> seeds =
        inputs.explicit_seeds.empty() ? thrown_seeds(inputs, params, seed, progress.slice(0, 0.25))
                                      : given_seeds(inputs);
    for (const Vec3d& s : seeds) result.seeds.push_back(transform.world(s));

    const Polylines traced = trace(inputs, params, seeds, progress.slice(0.25, 0.35));
    result.lines = simplify(traced, params.simplify);
    for (Vec3d& p : result.lines.points) p = on_line_lattice(p);
    const auto endless =
        std::count(result.lines.stop.begin(), result.lines.stop.end(), StopReason::TooLong);
    if (endless > 0)
        log::warning("joints: {} centre lines ran in circles and were stopped", endless);

    log::info("joints: {} columns, {} steps of {} voxels, {} segments, h = {:g} m", seeds.size(),
              traced.points.size() - traced.count(), params.step,
              result.lines.points.size() - result.lines.count(), transform.voxel);
    partition(inputs.region, result.lines, transform.voxel, result.column,
              params.arc ? &result.arc : nullptr, progress.slice(0.35, 1));
    progress.update(1);
    return result;
}

}  // namespace sekitei::joints
