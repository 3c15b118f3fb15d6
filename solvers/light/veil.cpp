#include "solvers/light/veil.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/math.h"

namespace sekitei::light {
namespace {

/// Calls f(cell, a, b) for the cubes of edge `edge` that p + t d meets between begin and end, a to
/// b of t each, until f says true.
template <class F>
bool walk(Vec3d p, Vec3d d, int edge, double begin, double end, F&& f)
{
    const Vec3d at = p + d * begin;
    Coord cell;
    Vec3d next, step;
    for (int k = 0; k < 3; ++k) {
        cell[k] = static_cast<std::int32_t>(std::floor(at[k] / edge));
        step[k] = d[k] != 0 ? edge / std::abs(d[k]) : INFINITY;
        const double face = double(cell[k] + (d[k] > 0)) * edge;
        next[k] = d[k] != 0 ? (face - p[k]) / d[k] : INFINITY;
    }
    for (double t = begin; t < end;) {
        const int k = next.x <= next.y && next.x <= next.z ? 0 : next.y <= next.z ? 1 : 2;
        // Rounding may put the beginning a little behind a face.
        const double out = std::clamp(next[k], t, end);
        if (f(cell, t, out)) return true;
        t = std::max(t, next[k]);
        next[k] += step[k];
        cell[k] += d[k] > 0 ? 1 : -1;
    }
    return false;
}

}  // namespace

Veil::Veil(const FloatGrid& leaf_area_density, double extinction)
    : grid_(&leaf_area_density), extinction_(extinction)
{
    if (!(extinction >= 0 && std::isfinite(extinction)))
        throw InvalidParameter(fmt::format("light: extinction = {:.6g}, must be >= 0", extinction));
    if (grid_->background() != 0)
        throw InvalidInput(fmt::format("light: background of canopy_lad = {:.6g} 1/m, must be 0",
                                       grid_->background()));
    Bounds box;
    for (std::size_t leaf = 0; leaf < grid_->leaf_count(); ++leaf) {
        bool any = false;
        for (int o = 0; o < (grid_->is_constant(leaf) ? 1 : kLeafSize); ++o) {
            const float v = grid_->at(leaf, o);
            if (!(v >= 0 && std::isfinite(v)))
                throw InvalidInput(fmt::format(
                    "light: canopy_lad = {:.6g} 1/m, must be a leaf area density, >= 0", v));
            any = any || v > 0;
        }
        if (!any) continue;
        box.add(Vec3d(grid_->origin(leaf)));
        box.add(Vec3d(grid_->origin(leaf) + Coord(kLeafEdge)));
    }
    if (!box.empty()) lower_ = box.lower, upper_ = box.upper;
}

double Veil::transmittance(Vec3d from, Vec3d direction) const
{
    constexpr double kOpaque = 20.7;  // exp(-20.7) = 1e-9
    const Transform& transform = grid_->transform();
    const Vec3d p = transform.voxels(from);
    double begin = 0, end = INFINITY;
    for (int k = 0; k < 3; ++k) {
        if (direction[k] == 0) {
            if (!(p[k] >= lower_[k] && p[k] < upper_[k])) return 1;
            continue;
        }
        const double a = (lower_[k] - p[k]) / direction[k], b = (upper_[k] - p[k]) / direction[k];
        begin = std::max(begin, std::min(a, b));
        end = std::min(end, std::max(a, b));
    }
    if (!(begin < end)) return 1;
    const double per_voxel = extinction_ * transform.voxel;
    double depth = 0;
    walk(p, direction, kLeafEdge, begin, end, [&](Coord block, double a, double b) {
        const std::uint32_t leaf = grid_->topology()->find(block * kLeafEdge);
        if (leaf == kNoLeaf) return false;
        const float* v = grid_->values(leaf);
        if (!v) {
            depth += per_voxel * double(grid_->constant(leaf)) * (b - a);
            return depth > kOpaque;
        }
        return walk(p, direction, 1, a, b, [&](Coord c, double in, double out) {
            // A step that rounding takes out of the block has no length.
            if (leaf_origin(c) == block * kLeafEdge)
                depth += per_voxel * double(v[leaf_offset(c)]) * (out - in);
            return depth > kOpaque;
        });
    });
    return depth > kOpaque ? 0 : math::exp(-depth);
}

}  // namespace sekitei::light
