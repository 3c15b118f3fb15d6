#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "core/vec.h"
#include "solvers/tree/grove.h"

/// Measures of a tree's form, as section 4 of the paper looks at them: numbers for crowns that are
/// round, branches that weep, tips that spread evenly. Lengths in branch lengths. Same bits on any
/// machine and for any number of threads.
namespace sekitei::tree {

struct Shape {
    std::size_t tips = 0;
    double weeping = 0;     ///< share of tips with a downward branch on the way to the root
    double radius_max = 0;  ///< largest horizontal distance of a tip from the origin's axis
    double radius_rms = 0;
    double lowest = 0, highest = 0, mean_height = 0;  ///< of tips' ends
    Vec3d lean;              ///< A: mean horizontal offset / rms horizontal distance
    double spacing_cv = 0;   ///< st.dev. / mean of the distance to the nearest tip
    double spacing_gap = 0;  ///< largest nearest distance / mean
    double hole_cv = 0;      ///< st.dev. / mean of counts in 36 equal-area cells of the top view
    double sphericity = 0;   ///< of the tips' convex hull: pi^(1/3) (6 V)^(2/3) / A
    double width = 0;        ///< larger horizontal extent of the tips
    double mean_light = 0;   ///< of tips
    double upward = 0;       ///< share of tips that point up
};
/// Of the ends of living tips; all 0 where there are none.
/// @param tree  id, or -1 for all together, about the mean origin of the trees that have tips
Shape shape_of(const Grove& grove, int tree = -1);

/// Ends of living tips, in their order.
/// @param tree  id, or -1 for all
std::vector<Vec3d> tip_ends(const Grove& grove, int tree = -1);

/// R^2 of a straight line through r_max of 1-unit bins of depth below the apex, over the upper
/// `share` of the height above the origins: 1 for a cone.
double profile_r2(const Grove& grove, double share);
/// The same of points about the z axis, heights above z = 0. Bins without points are left out;
/// 0 for fewer than three.
double profile_r2(std::span<const Vec3d> points, double share);

/// Mean horizontal offset / rms horizontal distance from the z axis: 0 for a crown that stands
/// upright, length 1 for one point off the axis. z is 0.
Vec3d lean_of(std::span<const Vec3d> points);

/// Distances to nearest neighbours; 0 for fewer than two points.
struct Spacing {
    double mean = 0;
    double cv = 0;   ///< st.dev. / mean
    double gap = 0;  ///< largest / mean
};
Spacing spacing_of(std::span<const Vec3d> points);

/// St.dev. / mean of how many points lie in each of 36 cells of one area, 6 rings by 6 sectors of
/// the disc of `radius` about the z axis; those farther out count to the outermost ring. About
/// sqrt(36 / n) for n points thrown at random, 0 for evenly spread ones, sqrt(35) for one heap.
double hole_cv_of(std::span<const Vec3d> points, double radius);

/// Volume and area of the convex hull of points; 0 for fewer than 4 or flat ones.
struct Hull {
    double volume = 0, area = 0;
    /// pi^(1/3) (6 V)^(2/3) / A: 1 for a ball.
    double sphericity() const;
};
/// Quickhull [Barber1996] on points rounded to 2^-40 of their extent and in whole numbers from
/// there on, so that no rounding can tear it, however flat, collinear or repeated points are.
/// O(n log n) for points like those of crowns.
/// @throws InvalidInput  a point that is not finite
Hull convex_hull(std::span<const Vec3d> points);

}  // namespace sekitei::tree
