#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "solvers/tree/grove.h"

/// Measures of a tree's form, as section 4 of the paper looks at them.
namespace sekitei::tree {

struct Shape {
    std::size_t tips = 0;
    double weeping = 0;     ///< share of tips with a downward branch on the way to the root
    double radius_max = 0;  ///< largest horizontal distance of a tip from the origin's axis
    double radius_rms = 0;
    double lowest = 0, highest = 0, mean_height = 0;  ///< of tips
    Vec3d lean;              ///< A: mean horizontal offset / rms horizontal distance
    double spacing_cv = 0;   ///< st.dev. / mean of the distance to the nearest tip
    double spacing_gap = 0;  ///< largest nearest distance / mean
    double hole_cv = 0;      ///< st.dev. / mean of counts in 36 equal-area cells of the top view
    double sphericity = 0;   ///< of the tips' convex hull: pi^(1/3) (6 V)^(2/3) / A
    double width = 0;        ///< larger horizontal extent of the tips
    double mean_light = 0;   ///< of tips
    double upward = 0;       ///< share of tips that point up
};
/// Of the living tips of the trees named; empty: of all. Lengths in branch lengths.
/// @param tree  id, or -1 for all together (about the mean of their origins)
Shape shape_of(const Grove& grove, int tree = -1);

/// R^2 of a straight line through r_max of 1-unit bins of depth below the apex, over the upper
/// `share` of the height: 1 for a cone.
double profile_r2(const Grove& grove, double share);

/// Volume and area of the convex hull of points; 0 for fewer than 4 or flat ones.
struct Hull {
    double volume = 0, area = 0;
};
Hull convex_hull(std::span<const Vec3d> points);

}  // namespace sekitei::tree
