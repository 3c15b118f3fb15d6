#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "core/vec.h"

/// Points near a place. Both searches below find exactly the same points: those whose squared
/// distance, as squared_distance() computes it in float, is at most radius * radius.
///
/// Each keeps its own copy of the points, sorted; the place in it is called a slot. The order in
/// which a query visits points depends on the points alone, not on threads. Queries may run from
/// any number of threads. A radius or a place that is NaN finds nothing.
namespace sekitei {

inline float squared_distance(Vec3f a, Vec3f b)
{
    const float x = a.x - b.x, y = a.y - b.y, z = a.z - b.z;
    return x * x + y * y + z * z;
}

/// A point and its number in the array it came from.
struct NumberedPoint {
    Vec3f at;
    std::uint32_t index = 0;
};

namespace detail {

/// The k smallest of the values it is shown.
class Smallest {
public:
    /// @param most  larger values are passed over
    Smallest(int k, float most) : k_(static_cast<std::size_t>(k)), most_(most)
    {
        heap_.reserve(k_);
    }
    /// What a value must not exceed to matter.
    float bound() const { return heap_.size() < k_ ? most_ : heap_.front(); }
    void show(float value)
    {
        if (!(value <= bound())) return;
        if (heap_.size() == k_) {
            std::ranges::pop_heap(heap_);
            heap_.pop_back();
        }
        heap_.push_back(value);
        std::ranges::push_heap(heap_);
    }

private:
    std::size_t k_;
    float most_;
    std::vector<float> heap_;  // the largest in front
};

}  // namespace detail

/// A balanced tree in one array [Ericson2005, 7.3.7]: each half of a range lies on its side of a
/// plane. Good for any spread of points and any radius.
class KdTree {
public:
    KdTree() = default;
    /// @throws InvalidInput   a point that is not finite
    /// @throws LimitExceeded  2^31 points or more
    explicit KdTree(std::span<const Vec3f> points);

    std::size_t size() const { return points_.size(); }
    /// The points in the order of their slots.
    const std::vector<NumberedPoint>& points() const { return points_; }

    /// Calls f(slot, squared distance) for each point within `radius` of `at`.
    template <class F>
    void within_slots(Vec3f at, float radius, F&& f) const
    {
        if (radius >= 0)
            visit(
                at, [r2 = radius * radius] { return r2; }, f);
    }
    /// Calls f(index, squared distance) for each point within `radius` of `at`.
    template <class F>
    void within(Vec3f at, float radius, F&& f) const
    {
        within_slots(at, radius, [&](std::size_t slot, float d2) { f(points_[slot].index, d2); });
    }
    /// Distance to the k-th nearest point, k >= 1; `most` where fewer than k are that near.
    float distance_to_nearest(Vec3f at, int k, float most) const
    {
        detail::Smallest nearest(k, most * most);
        visit(
            at, [&] { return nearest.bound(); }, [&](std::size_t, float d2) { nearest.show(d2); });
        return std::min(std::sqrt(nearest.bound()), most);
    }

private:
    struct Plane {
        float at = 0;
        std::uint32_t axis = 0;
    };

    /// Shows f every point whose squared distance is at most bound(), which may shrink meanwhile.
    template <class Bound, class F>
    void visit(Vec3f at, Bound&& bound, F&& f) const
    {
        struct Part {
            std::uint32_t node, begin, end;
            float away;  ///< squared distance to the plane beyond which it lies
        };
        std::array<Part, 40> stack;
        std::size_t waiting = 0;
        stack[waiting++] = {1, 0, static_cast<std::uint32_t>(points_.size()), 0};
        while (waiting > 0) {
            Part part = stack[--waiting];
            if (!(part.away <= bound())) continue;
            // Go down on the side of `at`; the other side waits.
            while (part.node < planes_.size()) {
                const Plane plane = planes_[part.node];
                const std::uint32_t middle = part.begin + (part.end - part.begin) / 2;
                const float off = at[static_cast<int>(plane.axis)] - plane.at;
                const bool above = off > 0;
                const Part low{2 * part.node, part.begin, middle, 0};
                const Part high{2 * part.node + 1, middle, part.end, 0};
                stack[waiting] = above ? low : high;
                stack[waiting++].away = off * off;
                part = above ? high : low;
            }
            for (std::uint32_t slot = part.begin; slot < part.end; ++slot) {
                const float d2 = squared_distance(at, points_[slot].at);
                if (d2 <= bound()) f(std::size_t{slot}, d2);
            }
        }
    }

    std::vector<NumberedPoint> points_;
    std::vector<Plane> planes_;  // of node i, whose halves are nodes 2 i and 2 i + 1; 0 is unused
};

/// Points sorted by cells of one size. Fastest for radii near that size.
class CellIndex {
public:
    CellIndex() = default;
    /// @param edge  of the cells [m], > 0
    /// @throws InvalidInput      a point that is not finite
    /// @throws InvalidParameter  the edge
    /// @throws LimitExceeded     2^31 points or more
    CellIndex(std::span<const Vec3f> points, float edge);

    std::size_t size() const { return points_.size(); }
    const std::vector<NumberedPoint>& points() const { return points_; }

    template <class F>
    void within_slots(Vec3f at, float radius, F&& f) const
    {
        const float r2 = radius * radius;
        visit(at, radius, [&](std::uint32_t begin, std::uint32_t end) {
            for (std::uint32_t slot = begin; slot < end; ++slot) {
                const float d2 = squared_distance(at, points_[slot].at);
                if (d2 <= r2) f(std::size_t{slot}, d2);
            }
        });
    }
    template <class F>
    void within(Vec3f at, float radius, F&& f) const
    {
        within_slots(at, radius, [&](std::size_t slot, float d2) { f(points_[slot].index, d2); });
    }
    float distance_to_nearest(Vec3f at, int k, float most) const
    {
        // Widen the search until k points are in it.
        for (float radius = std::min(most, 0.5f * static_cast<float>(edge_));; radius *= 2) {
            radius = std::min(radius, most);
            int found = 0;
            detail::Smallest nearest(k, radius * radius);
            within_slots(at, radius, [&](std::size_t, float d2) {
                ++found;
                nearest.show(d2);
            });
            if (found >= k || !(radius < most)) return std::min(std::sqrt(nearest.bound()), most);
        }
    }

private:
    /// Shows f(begin, end) the slots of all cells that may hold a point within the radius.
    template <class F>
    void visit(Vec3f at, float radius, F&& f) const
    {
        if (!(radius >= 0)) return;
        // A little more than the radius: differences and squares are rounded to float.
        const double reach = radius * (1 + 1e-6) + 1e-20;
        std::array<std::uint32_t, 3> first{}, count{};
        for (int k = 0; k < 3; ++k) {
            const auto axis = static_cast<std::size_t>(k);
            const double low = std::max(at[k] - reach, lower_[k]);
            const double high = std::min(at[k] + reach, upper_[k]);
            if (!(low <= high)) return;
            const auto begin = cell(low, k), end = cell(high, k) + 1;
            first[axis] = static_cast<std::uint32_t>(begin % cells_[axis]);
            count[axis] =
                static_cast<std::uint32_t>(std::min<std::uint64_t>(end - begin, cells_[axis]));
        }
        auto row = [&](std::uint32_t x, std::uint32_t y) {
            const std::uint32_t* start =
                start_.data() + (std::size_t{x} * cells_[1] + y) * std::size_t{cells_[2]};
            // Cells of a row lie side by side; past the last one it goes on at the first.
            const std::uint32_t end = first[2] + count[2];
            f(start[first[2]], start[std::min(end, cells_[2])]);
            if (end > cells_[2]) f(start[0], start[end - cells_[2]]);
        };
        for (std::uint32_t i = 0, x = first[0]; i < count[0];
             ++i, x = x + 1 == cells_[0] ? 0 : x + 1)
            for (std::uint32_t j = 0, y = first[1]; j < count[1];
                 ++j, y = y + 1 == cells_[1] ? 0 : y + 1)
                row(x, y);
    }
    std::uint64_t cell(double coordinate, int axis) const
    {
        return static_cast<std::uint64_t>((coordinate - lower_[axis]) * per_metre_);
    }

    double edge_ = 1, per_metre_ = 1;
    Vec3d lower_{INFINITY}, upper_{-INFINITY};
    /// Cells along each axis. Where space has more of them than is worth a table, cell i is kept in
    /// place i modulo this number, together with others that lie far away.
    std::array<std::uint32_t, 3> cells_{1, 1, 1};
    std::vector<NumberedPoint> points_;  // by cell, then by index
    std::vector<std::uint32_t> start_;   // the first slot of each cell; one more at the end
};

}  // namespace sekitei
