#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/math.h"
#include "solvers/tree/wood.h"

namespace sekitei::tree {
namespace {

struct Pipes {
    double tip_radius = 0, exponent = 0, memory = 0;
};

/// @param alive   bool(i)
/// @param is_tip  bool(i)
/// @param pipes   Pipes(i)
template <class Alive, class IsTip, class PipesOf>
std::vector<double> radii(std::span<const std::int32_t> parent,
                          std::span<const std::int32_t> dead_tips, Alive&& alive, IsTip&& is_tip,
                          PipesOf&& pipes)
{
    const std::size_t n = parent.size();
    if (dead_tips.size() != n)
        throw InvalidInput(
            fmt::format("tree: {} branches with {} numbers of dead tips, must be as "
                        "many",
                        n, dead_tips.size()));
    // In pipes of one tip each: what they have in common comes last.
    std::vector<double> wood(n);
    for (std::size_t i = n; i-- > 0;) {
        if (parent[i] >= static_cast<std::int32_t>(i))
            throw InvalidInput(fmt::format(
                "tree: branch {} has the parent {}, must be one before it", i, parent[i]));
        wood[i] += pipes(i).memory * dead_tips[i];
        if (wood[i] == 0 || is_tip(i)) wood[i] += 1;
        // Living wood does not feed dead wood: what that left is in dead_tips already.
        if (parent[i] >= 0 && alive(i) == alive(std::size_t(parent[i])))
            wood[std::size_t(parent[i])] += wood[i];
    }
    std::vector<double> radius(n);
    for (std::size_t i = 0; i < n; ++i) {
        const Pipes p = pipes(i);
        radius[i] = p.tip_radius *
                    (p.exponent == 2 ? std::sqrt(wood[i]) : math::pow(wood[i], 1 / p.exponent));
        if (parent[i] >= 0) radius[i] = std::min(radius[i], radius[std::size_t(parent[i])]);
    }
    return radius;
}

}  // namespace

std::vector<double> thickness(const Branches& branches, std::span<const Species> species,
                              std::span<const Plant> plants)
{
    for (std::size_t i = 0; i < branches.size(); ++i) {
        const std::int32_t tree = branches.tree[i];
        if (tree < 0 || static_cast<std::size_t>(tree) >= plants.size())
            throw InvalidInput(
                fmt::format("tree: branch {} is of tree {}, there are {}", i, tree, plants.size()));
    }
    for (const Plant& plant : plants)
        if (plant.species < 0 || static_cast<std::size_t>(plant.species) >= species.size())
            throw InvalidInput(fmt::format("tree: a tree is of species {}, there are {}",
                                           plant.species, species.size()));
    return radii(
        branches.parent, branches.dead_tips, [&](std::size_t i) { return branches.alive(i); },
        [&](std::size_t i) { return branches.is(i, Branches::kTip); },
        [&](std::size_t i) {
            const Species& s = species[std::size_t(plants[std::size_t(branches.tree[i])].species)];
            return Pipes{s.tip_radius, s.pipe_exponent, s.pipe_memory};
        });
}

std::vector<double> thickness(std::span<const std::int32_t> parent,
                              std::span<const std::int32_t> dead_tips, double tip_radius,
                              double exponent, double memory)
{
    return radii(
        parent, dead_tips, [](std::size_t) { return true; }, [](std::size_t) { return false; },
        [&](std::size_t) {
            return Pipes{tip_radius, exponent, memory};
        });
}

}  // namespace sekitei::tree
