#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "solvers/soil/soil.h"

namespace sekitei::soil {
namespace {

constexpr float kUnderside = -0.3F;
constexpr double kSlopeExponent = 1.1;
constexpr std::uint32_t kUnreached = ~0u;

template <class T>
std::span<const std::uint32_t> neighbours(const T& surface, std::size_t i)
{
    return surface.neighbour.subspan(surface.neighbour_begin[i],
                                     surface.neighbour_begin[i + 1] - surface.neighbour_begin[i]);
}

void check(const Surface& s)
{
    const std::size_t n = s.position.size();
    if (s.normal_up.size() != n || s.area.size() != n || s.neighbour_begin.size() != n + 1 ||
        (!s.drop_target.empty() && s.drop_target.size() != n))
        throw InvalidInput(fmt::format(
            "runoff: {} positions, {} normals, {} areas, {} neighbour lists, {} drop targets; they "
            "must agree",
            n, s.normal_up.size(), s.area.size(), s.neighbour_begin.size(), s.drop_target.size()));
    if (s.neighbour_begin[0] != 0 || s.neighbour_begin[n] != s.neighbour.size())
        throw InvalidInput("runoff: neighbour lists do not cover the neighbours");
    for (std::size_t i = 0; i < n; ++i) {
        const Vec3d p = s.position[i];
        if (!(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z)))
            throw InvalidInput(fmt::format("runoff: site {}: position is not finite", i));
        if (!(s.area[i] > 0 && std::isfinite(s.area[i])))
            throw InvalidInput(
                fmt::format("runoff: site {}: area = {:.6g} m^2, must be > 0", i, s.area[i]));
        if (s.neighbour_begin[i] > s.neighbour_begin[i + 1])
            throw InvalidInput(
                fmt::format("runoff: site {}: neighbour list ends before it begins", i));
        for (const std::uint32_t j : neighbours(s, i))
            if (j >= n || j == i)
                throw InvalidInput(fmt::format(
                    "runoff: site {}: neighbour = {}, must be another of {} sites", i, j, n));
        if (s.drop_target.empty() || s.drop_target[i] < 0) continue;
        const auto target = static_cast<std::size_t>(s.drop_target[i]);
        if (target >= n || !(s.position[target].z < p.z))
            throw InvalidInput(fmt::format(
                "runoff: site {}: drop target {} must be a lower site, or -1", i, target));
    }
}

bool drips(const Surface& s, std::size_t i)
{
    return s.normal_up[i] < kUnderside;
}

bool has_lower(const Surface& s, std::size_t i)
{
    return std::ranges::any_of(neighbours(s, i),
                               [&](std::uint32_t j) { return s.position[j].z < s.position[i].z; });
}

/// Steps over level ground to a site that drains: 0 where a site drains by itself.
std::vector<std::uint32_t> level_steps(const Surface& s)
{
    std::vector<std::uint32_t> steps(s.position.size(), kUnreached), front, next;
    for (std::uint32_t i = 0; i < steps.size(); ++i)
        if (drips(s, i) || has_lower(s, i)) {
            steps[i] = 0;
            front.push_back(i);
        }
    for (std::uint32_t distance = 1; !front.empty(); ++distance) {
        next.clear();
        for (const std::uint32_t i : front)
            for (const std::uint32_t j : neighbours(s, i))
                if (steps[j] == kUnreached && s.position[j].z == s.position[i].z) {
                    steps[j] = distance;
                    next.push_back(j);
                }
        front.swap(next);
    }
    return steps;
}

}  // namespace

Paths runoff_paths(const Surface& s, const Progress& progress)
{
    check(s);
    const std::size_t n = s.position.size();
    progress.update(0.1);
    const std::vector<std::uint32_t> steps = level_steps(s);

    // Where site i drains to; empty for pits.
    auto targets = [&](std::size_t i, auto&& visit) {
        if (drips(s, i)) {
            if (!s.drop_target.empty() && s.drop_target[i] >= 0)
                visit(static_cast<std::uint32_t>(s.drop_target[i]), 1.0);
            return;
        }
        const Vec3d p = s.position[i];
        for (const std::uint32_t j : neighbours(s, i)) {
            const double drop = p.z - s.position[j].z;
            if (drop > 0)
                visit(j, math::pow(drop / length(p - s.position[j]), kSlopeExponent));
            else if (drop == 0 && steps[i] != 0 && steps[i] != kUnreached &&
                     steps[j] + 1 == steps[i])
                visit(j, 1.0);
        }
    };
    Paths paths;
    std::vector<std::uint32_t> counts(n);
    parallel_for(
        n,
        [&](std::size_t i) {
            std::uint32_t count = 0;
            targets(i, [&](std::uint32_t, double) { ++count; });
            counts[i] = count;
        },
        1024);
    progress.update(0.4);
    paths.begin = prefix_sum(counts);
    paths.target.resize(paths.begin.back());
    paths.share.resize(paths.begin.back());
    parallel_for(
        n,
        [&](std::size_t i) {
            double sum = 0;
            targets(i, [&](std::uint32_t, double weight) { sum += weight; });
            std::size_t slot = paths.begin[i];
            targets(i, [&](std::uint32_t j, double weight) {
                paths.target[slot] = j;
                paths.share[slot++] = static_cast<float>(weight / sum);
            });
        },
        1024);
    progress.update(0.8);
    for (const std::uint32_t count : counts) paths.ends += count == 0;

    // From high to low; on level ground from afar to its outlet.
    paths.order.resize(n);
    std::iota(paths.order.begin(), paths.order.end(), 0u);
    std::ranges::sort(paths.order, [&](std::uint32_t a, std::uint32_t b) {
        const double za = s.position[a].z, zb = s.position[b].z;
        if (za != zb) return za > zb;
        return steps[a] != steps[b] ? steps[a] > steps[b] : a < b;
    });
    progress.update(1);
    return paths;
}

void route_rain(const Paths& paths, std::span<const float> area, std::span<const double> capacity,
                std::span<const double> water, const Values<double>& rain, Runoff& result)
{
    const std::size_t n = paths.order.size();
    if (area.size() != n || capacity.size() != n || water.size() != n || !rain.fits(n))
        throw InvalidInput(fmt::format(
            "runoff: paths of {} sites, but {} areas, {} capacities, {} stores of water", n,
            area.size(), capacity.size(), water.size()));
    result.supply.resize(n);
    result.run.resize(n);
    result.outflow = 0;
    for (std::size_t i = 0; i < n; ++i) {
        if (!(rain[i] >= 0 && std::isfinite(rain[i])))
            throw InvalidInput(
                fmt::format("runoff: site {}: rain = {:.6g} mm, must be >= 0", i, rain[i]));
        result.supply[i] = rain[i];
    }
    for (const std::uint32_t i : paths.order) {
        const double run = std::max(0.0, water[i] + result.supply[i] - capacity[i]);
        result.run[i] = run;
        if (run == 0) continue;
        double volume = run * area[i];
        const std::size_t begin = paths.begin[i], end = paths.begin[i + 1];
        if (begin == end) {
            result.outflow += volume;
            continue;
        }
        const double whole = volume;
        for (std::size_t k = begin; k + 1 < end; ++k) {
            const double part = std::min(volume, whole * paths.share[k]);
            result.supply[paths.target[k]] += part / area[paths.target[k]];
            volume -= part;
        }
        result.supply[paths.target[end - 1]] += volume / area[paths.target[end - 1]];
    }
}

}  // namespace sekitei::soil
