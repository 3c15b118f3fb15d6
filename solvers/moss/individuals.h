#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "core/parallel.h"
#include "solvers/moss/colony.h"

/// What is done to all arrays of individuals alike. Not for use outside solvers/moss.
namespace sekitei::moss {

/// Visits every array, in the order of the file.
template <class P, class F>
void each_common_array(P& p, F&& f)
{
    f(p.foot), f(p.normal), f(p.site), f(p.host), f(p.height);
    f(p.species), f(p.id), f(p.landed), f(p.light), f(p.light_area);
}
template <class F>
void each_array(Plants& p, F&& f)
{
    each_common_array(p, f);
    f(p.growth), f(p.growth_max), f(p.born);
}
template <class F>
void each_array(const Plants& p, F&& f)
{
    each_common_array(p, f);
    f(p.growth), f(p.growth_max), f(p.born);
}
template <class F>
void each_array(Seeds& p, F&& f)
{
    each_common_array(p, f);
    f(p.kind);
}
template <class F>
void each_array(const Seeds& p, F&& f)
{
    each_common_array(p, f);
    f(p.kind);
}

/// Calls f for every array, side by side.
template <class P, class F>
void each_array_in_parallel(P& individuals, F&& f)
{
    std::vector<std::function<void()>> tasks;
    each_array(individuals, [&](auto& v) { tasks.push_back([&v, &f] { f(v); }); });
    parallel_for(tasks.size(), [&](std::size_t k) { tasks[k](); });
}

/// Leaves those with keep[i] != 0, in their order.
template <class P>
void keep_only(P& individuals, std::span<const std::uint8_t> keep)
{
    std::size_t first = 0;
    while (first < keep.size() && keep[first]) ++first;
    if (first == keep.size()) return;
    each_array_in_parallel(individuals, [&](auto& v) {
        std::size_t to = first;
        for (std::size_t i = first; i < keep.size(); ++i)
            if (keep[i]) v[to++] = v[i];
        v.resize(to);
    });
}

/// What a plant takes over from its seed.
inline void append(Plants& plants, const Seeds& seeds, std::size_t i)
{
    plants.foot.push_back(seeds.foot[i]);
    plants.normal.push_back(seeds.normal[i]);
    plants.site.push_back(seeds.site[i]);
    plants.host.push_back(seeds.host[i]);
    plants.height.push_back(seeds.height[i]);
    plants.species.push_back(seeds.species[i]);
    plants.id.push_back(seeds.id[i]);
    plants.landed.push_back(seeds.landed[i]);
    plants.light.push_back(seeds.light[i]);
    plants.light_area.push_back(seeds.light_area[i]);
}

/// Who came to a place; the arrays of a plant or a seed alone are left to the caller.
inline void append(Individuals& to, const Landed& at, std::uint8_t species, std::uint64_t id,
                   std::int32_t day)
{
    to.foot.push_back(at.foot);
    to.normal.push_back(at.normal);
    to.site.push_back(at.site);
    to.host.push_back(at.host);
    to.height.push_back(at.height);
    to.species.push_back(species);
    to.id.push_back(id);
    to.landed.push_back(day);
    to.light.push_back(0);
    to.light_area.push_back(0);
}

}  // namespace sekitei::moss
