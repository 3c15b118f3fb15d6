#pragma once

#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

#include "core/vec.h"
#include "grids/scene.h"

namespace sekitei {

/// Why a centre line ended (columnar joints, 2.3).
enum class StopReason : std::int32_t { NoStep, Flat, Reversal, OutOfDomain, LeftLava, TooLong };
constexpr std::array<std::string_view, 6> choice_names(StopReason)
{
    return {"no_step", "flat", "reversal", "domain", "region", "max"};
}

/// Polylines in one flat array; line i has the points [begin[i], begin[i + 1]). Voxel units.
struct Polylines {
    std::vector<Vec3d> points;
    std::vector<std::uint32_t> begin{0};
    std::vector<StopReason> stop;  ///< one a line

    std::size_t count() const { return begin.size() - 1; }
    std::size_t size(std::size_t line) const { return begin[line + 1] - begin[line]; }
    const Vec3d* line(std::size_t i) const { return points.data() + begin[i]; }
    void add(const std::vector<Vec3d>& line_points, StopReason reason)
    {
        points.insert(points.end(), line_points.begin(), line_points.end());
        begin.push_back(static_cast<std::uint32_t>(points.size()));
        stop.push_back(reason);
    }
    /// Arc length from the line's first point to each point, parallel to `points` [voxels].
    std::vector<double> arc_lengths() const;
};

/// The nearest point of a lattice of 2^-20 voxel. Centre lines lie on it, so that they pass through
/// world coordinates and files without losing a bit.
Vec3d on_line_lattice(Vec3d p);

/// As scene points: attributes `line` (int32), `order` (int32), `arc` (float, m), `stop` (int32).
Points to_points(const Polylines& lines, const Transform& transform);
/// Points are put on the lattice of 2^-20 voxel.
/// @throws InvalidInput  attributes missing or lines not contiguous
Polylines to_polylines(const Points& points, const Transform& transform);

}  // namespace sekitei
