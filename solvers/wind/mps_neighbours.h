#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/vec.h"

namespace sekitei::wind::mps {

/// Positions as three arrays, the form in which the loops over neighbours read them.
struct Positions {
    std::vector<double> x, y, z;  ///< [m]

    std::size_t size() const { return x.size(); }
    Vec3d at(std::size_t i) const { return {x[i], y[i], z[i]}; }
    void set(std::size_t i, Vec3d p) { x[i] = p.x, y[i] = p.y, z[i] = p.z; }
    void push_back(Vec3d p) { x.push_back(p.x), y.push_back(p.y), z.push_back(p.z); }
};

/// Particles sorted into uniform cells; the particles of a row of cells along z are consecutive.
class Cells {
public:
    Cells() = default;
    /// @param region  what the particles are expected in; those beyond it count to its border cells
    /// @param edge    of a cell [m]
    /// @throws LimitExceeded  more than 2^28 cells
    Cells(const Bounds& region, double edge);

    double edge() const { return edge_; }

    /// The permutation that sorts by cell, ties by present order: order[new place] = old place.
    /// From now on the runs refer to particles in that order.
    std::vector<std::uint32_t> sort(const Positions& positions);

    /// Calls f(begin, end) for runs of sorted particles that together hold all within `reach` of p.
    template <class F>
    void for_each_run(Vec3d p, double reach, F&& f) const
    {
        const Coord low = cell_of(p - Vec3d(reach)), high = cell_of(p + Vec3d(reach));
        for (int i = low.x; i <= high.x; ++i)
            for (int j = low.y; j <= high.y; ++j) {
                const std::size_t row = index({i, j, 0});
                const std::size_t first = start_[row + std::size_t(low.z)];
                const std::size_t last = start_[row + std::size_t(high.z) + 1];
                if (first != last) f(first, last);
            }
    }

private:
    Coord cell_of(Vec3d p) const;
    std::size_t index(Coord c) const
    {
        return (std::size_t(c.x) * std::size_t(count_.y) + std::size_t(c.y)) *
                   std::size_t(count_.z) +
               std::size_t(c.z);
    }

    Vec3d origin_{};
    double edge_ = 1;
    Coord count_{1, 1, 1};
    std::vector<std::uint32_t> start_;  ///< first particle of each cell, and the end
};

/// For each particle that wants it, the others within a radius, in sorted order.
class NeighbourLists {
public:
    /// @param wanted  0 for particles that need no list
    void build(const Cells& cells, const Positions& positions,
               const std::vector<std::uint8_t>& wanted, double radius);

    std::size_t count(std::size_t i) const { return count_[i]; }
    const std::uint32_t* of(std::size_t i) const { return all_.data() + i * stride_; }
    /// Room for each list; no list is longer.
    std::size_t stride() const { return stride_; }

private:
    std::size_t stride_ = 48;
    std::vector<std::uint32_t> all_, count_;
};

}  // namespace sekitei::wind::mps
