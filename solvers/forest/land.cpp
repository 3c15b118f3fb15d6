#include "solvers/forest/land.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/math.h"

namespace sekitei::forest {
namespace {

/// Rise over run [1] between neighbours along an axis of `count` pixels.
template <class F>
double difference(int at, int count, double pixel, F&& height)
{
    const int before = std::max(at - 1, 0), after = std::min(at + 1, count - 1);
    return after == before ? 0 : (height(after) - height(before)) / ((after - before) * pixel);
}

}  // namespace

double response(const Limits& limits, double value)
{
    if (!(value >= limits.dies_below && value <= limits.dies_above)) return -1;  // NaN too
    // Where best and standing limits meet, the limit itself belongs to the best.
    if (value >= limits.best_from && value <= limits.best_to) return 1;
    if (value < limits.best_from)
        return value <= limits.stands_below
                   ? 0
                   : (value - limits.stands_below) / (limits.best_from - limits.stands_below);
    return value >= limits.stands_above
               ? 0
               : (limits.stands_above - value) / (limits.stands_above - limits.best_to);
}

double Land::height_at(double x, double y) const
{
    if (flat()) return 0;
    const double u = std::clamp(x / pixel - 0.5, 0.0, double(ground.width() - 1));
    const double v = std::clamp(y / pixel - 0.5, 0.0, double(ground.depth() - 1));
    const int i = static_cast<int>(u), j = static_cast<int>(v);
    const int i1 = std::min(i + 1, ground.width() - 1), j1 = std::min(j + 1, ground.depth() - 1);
    const double a = u - i, b = v - j;
    return (1 - b) * ((1 - a) * height(i, j) + a * height(i1, j)) +
           b * ((1 - a) * height(i, j1) + a * height(i1, j1));
}

double Land::slope(int i, int j) const
{
    if (flat()) return 0;
    const double east = difference(i, ground.width(), pixel, [&](int k) { return height(k, j); });
    const double north = difference(j, ground.depth(), pixel, [&](int k) { return height(i, k); });
    return math::atan2(std::sqrt(east * east + north * north), 1);
}

bool Land::has_factor(const std::string& name) const
{
    return std::any_of(factors.begin(), factors.end(),
                       [&](const Factor& factor) { return factor.name == name; });
}

template <class F>
void Land::add_factor(const std::string& name, F&& value_at)
{
    if (has_factor(name)) return;
    Factor factor{name, {}, 0};
    if (flat()) {
        factor.constant = static_cast<float>(value_at(0, 0));
    } else {
        factor.value = {ground.width(), ground.depth(), 0.0f};
        for (int j = 0; j < ground.depth(); ++j)
            for (int i = 0; i < ground.width(); ++i)
                factor.value.set(i, j, static_cast<float>(value_at(i, j)));
        factor.value.compress();
    }
    factors.push_back(std::move(factor));
}

void Land::add_temperature(double at_base, double base, double lapse)
{
    add_factor("temperature",
               [&](int i, int j) { return at_base - lapse * (height(i, j) - base); });
}

void Land::add_slope()
{
    add_factor("slope", [&](int i, int j) { return slope(i, j) * (180 / math::kPi); });
}

void Land::bind(const std::vector<Species>& species)
{
    needs_.assign(species.size(), {});
    max_slope_.clear();
    for (std::size_t s = 0; s < species.size(); ++s) {
        max_slope_.push_back(species[s].max_slope);
        for (const Limits& limits : species[s].limits) {
            const auto found = std::find_if(factors.begin(), factors.end(), [&](const Factor& f) {
                return f.name == limits.factor;
            });
            if (found == factors.end()) {
                std::vector<std::string> names;
                for (const Factor& factor : factors) names.push_back(factor.name);
                const std::string near = nearest_name(limits.factor, names);
                throw InvalidParameter(fmt::format(
                    "species '{}': limits.{}: there is no environment map '{}'; there {}{}",
                    species[s].name, limits.factor, limits.factor,
                    names.empty() ? "is none: give one"
                                  : fmt::format("are: {}", fmt::join(names, ", ")),
                    near.empty() ? "" : "; did you mean '" + near + "'?"));
            }
            needs_[s].push_back({static_cast<std::size_t>(found - factors.begin()), limits});
        }
    }
}

bool Land::admits(int species, int i, int j) const
{
    if (!plantable.empty() && plantable.at(i, j) == 0) return false;
    // Rocks take every slice that they reach into, so a seedling would have nothing left.
    if (!blocked_height.empty() && double(blocked_height.at(i, j)) > 1e-9) return false;
    if (!flat() && slope(i, j) > max_slope_[std::size_t(species)]) return false;
    return vigour(species, i, j) >= 0;
}

double Land::vigour(int species, int i, int j) const
{
    double all = 1;
    for (const Need& need : needs_[std::size_t(species)]) {
        const double one = response(need.limits, factors[need.factor].at(i, j));
        if (one < 0) return -1;
        all = combine == Combine::Minimum ? std::min(all, one) : all * one;
    }
    return all;
}

}  // namespace sekitei::forest
