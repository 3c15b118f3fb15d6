#pragma once

#include "core/random.h"
#include "solvers/tree/grove.h"

/// Trees made by hand.
namespace sekitei::tree {

struct Limbs {
    Branches branches;

    /// @return its index; goes on from its parent's end
    std::int32_t add(std::int32_t parent, Vec3d direction, double length, bool tip = false,
                     Vec3d start = {})
    {
        Branches& b = branches;
        const std::size_t n = b.size();
        b.start.push_back(parent < 0 ? start : b.end(std::size_t(parent)));
        b.direction.push_back(normalized(direction));
        b.length.push_back(length);
        b.parent.push_back(parent);
        b.tree.push_back(parent < 0 ? 0 : b.tree[std::size_t(parent)]);
        b.key.push_back(hash2(77, n));
        b.generation.push_back(parent < 0 ? 0 : b.generation[std::size_t(parent)] + 1);
        b.order.push_back(0);
        b.flags.push_back(tip ? std::uint8_t{Branches::kTip} : std::uint8_t{0});
        b.light.push_back(1);
        b.light_vector.emplace_back();
        b.bough.push_back(-1);
        b.dead_tips.push_back(0);
        b.died.push_back(-1);
        return static_cast<std::int32_t>(n);
    }
};

/// A trunk and two arms, in a plane that is no axis'.
inline Branches fork()
{
    Limbs limbs;
    const auto trunk = limbs.add(-1, {0.1, 0.05, 1}, 4, false, {0.3, -0.2, 0.1});
    const auto arm = limbs.add(trunk, {0.6, 0.2, 1}, 2);
    limbs.add(arm, {0.8, 0.2, 0.8}, 1, true);
    limbs.add(arm, {0.3, 0.4, 1}, 1, true);
    limbs.add(trunk, {-0.5, -0.3, 1}, 2, true);
    return limbs.branches;
}

/// A limb of many pieces, each turned against the last by `bend` at random.
inline Branches wander(int pieces, double length, double bend, std::uint64_t seed)
{
    Limbs limbs;
    Vec3d way(0, 0, 1);
    std::int32_t last = -1;
    for (int k = 0; k < pieces; ++k) {
        Vec3d aside;
        for (int a = 0; a < 3; ++a) aside[a] = uniform_of_key(seed, std::uint64_t(3 * k + a)) - 0.5;
        aside = normalized(cross(way, aside));
        if (k > 0) way = way * std::cos(bend) + aside * std::sin(bend);
        last = limbs.add(last, way, length, k + 1 == pieces);
    }
    return limbs.branches;
}

/// A leader with whorls of five, as conifers have.
inline Branches whorls(int count)
{
    Limbs limbs;
    std::int32_t leader = limbs.add(-1, {0, 0, 1}, 2);
    for (int w = 0; w < count; ++w) {
        for (int k = 0; k < 5; ++k) {
            const double a = 2 * 3.14159265358979 * k / 5 + 2.4 * w;
            const auto bough = limbs.add(leader, {std::cos(a), std::sin(a), 0.27}, 0.5);
            limbs.add(bough, {std::cos(a), std::sin(a), 0.5}, 0.5, true);
        }
        leader = limbs.add(leader, {0, 0, 1}, 1, w + 1 == count);
    }
    return limbs.branches;
}

}  // namespace sekitei::tree
