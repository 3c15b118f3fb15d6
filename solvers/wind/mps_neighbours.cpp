#include "solvers/wind/mps_neighbours.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/clones.h"
#include "core/error.h"
#include "core/parallel.h"
#include "solvers/wind/mps_kernel.h"

namespace sekitei::wind::mps {

LatticeConstants lattice_constants(int dimension, double spacing, double radius)
{
    LatticeConstants sums;
    const int reach = int(std::ceil(radius / spacing)), deep = dimension == 3 ? reach : 0;
    double second_moment = 0;
    for (int i = -reach; i <= reach; ++i)
        for (int j = -deep; j <= deep; ++j)
            for (int k = -reach; k <= reach; ++k) {
                const double r = spacing * std::sqrt(double(i * i + j * j + k * k));
                const double w = weight(r, radius);
                if (w == 0) continue;
                sums.n0 += w;
                second_moment += r * r * w;
                ++sums.neighbours;
            }
    sums.lambda = second_moment / sums.n0;
    return sums;
}

Cells::Cells(const Bounds& region, double edge) : origin_(region.lower), edge_(edge)
{
    const Vec3d cells = region.size() / edge;
    const double total = (cells.x + 1) * (cells.y + 1) * (cells.z + 1);
    if (!(total < double(1 << 28)))
        throw LimitExceeded(fmt::format(
            "mps: the domain of {:.4g} x {:.4g} x {:.4g} m has {} cells of {:.4g} m, must be at "
            "most 2^28; take a smaller domain or larger particles",
            region.size().x, region.size().y, region.size().z, count_text(total), edge));
    for (int axis = 0; axis < 3; ++axis) count_[axis] = int(std::floor(cells[axis])) + 1;
}

Coord Cells::cell_of(Vec3d p) const
{
    // Clamping keeps neighbours in the same or in touching cells, so nothing is lost at the border.
    const auto along = [&](int axis) {
        const double cell = std::floor((p[axis] - origin_[axis]) / edge_);
        return int(std::clamp(cell, 0.0, double(count_[axis] - 1)));
    };
    return {along(0), along(1), along(2)};
}

std::vector<std::uint32_t> Cells::sort(const Positions& positions)
{
    const std::size_t n = positions.size();
    std::vector<std::uint32_t> cell(n), order(n);
    parallel_for(
        n, [&](std::size_t i) { cell[i] = std::uint32_t(index(cell_of(positions.at(i)))); }, 1024);
    start_.assign(index(count_ - Coord(1, 1, 1)) + 2, 0);
    for (const std::uint32_t c : cell) ++start_[c + 1];
    for (std::size_t c = 1; c < start_.size(); ++c) start_[c] += start_[c - 1];
    std::vector<std::uint32_t> next(start_.begin(), start_.end() - 1);
    for (std::size_t i = 0; i < n; ++i) order[next[cell[i]]++] = std::uint32_t(i);
    return order;
}

namespace {

/// Writes the indices in [begin, end) within the radius to `out`, past its end of interest too.
SEKITEI_CLONES std::size_t select_near(const double* x, const double* y, const double* z, Vec3d p,
                                       double radius_squared, std::size_t begin, std::size_t end,
                                       std::uint32_t* out)
{
    constexpr std::size_t kBlock = 64;
    double squared[kBlock];
    std::size_t found = 0;
    for (std::size_t first = begin; first < end; first += kBlock) {
        const std::size_t size = std::min(kBlock, end - first);
        for (std::size_t k = 0; k < size; ++k) {
            const double dx = x[first + k] - p.x, dy = y[first + k] - p.y, dz = z[first + k] - p.z;
            squared[k] = dx * dx + dy * dy + dz * dz;
        }
        for (std::size_t k = 0; k < size; ++k) {
            out[found] = std::uint32_t(first + k);
            found += squared[k] < radius_squared;
        }
    }
    return found;
}

}  // namespace

void NeighbourLists::build(const Cells& cells, const Positions& positions,
                           const std::vector<std::uint8_t>& wanted, double radius)
{
    const std::size_t n = positions.size();
    count_.assign(n, 0);
    constexpr std::size_t kChunk = 256;
    for (;;) {
        all_.resize(n * stride_);
        const std::size_t longest = parallel_fold(
            n, kChunk, std::size_t{0},
            [&](std::size_t begin, std::size_t end) {
                std::vector<std::uint32_t> near;
                std::size_t most = 0;
                for (std::size_t i = begin; i < end; ++i) {
                    if (!wanted[i]) continue;
                    std::size_t found = 0;
                    const Vec3d p = positions.at(i);
                    cells.for_each_run(p, radius, [&](std::size_t first, std::size_t last) {
                        near.resize(std::max(near.size(), found + (last - first) + 1));
                        found +=
                            select_near(positions.x.data(), positions.y.data(), positions.z.data(),
                                        p, radius * radius, first, last, near.data() + found);
                    });
                    std::uint32_t* list = all_.data() + i * stride_;
                    std::size_t kept = 0;
                    for (std::size_t k = 0; k < found; ++k)
                        if (near[k] != i && kept++ < stride_) list[kept - 1] = near[k];
                    count_[i] = std::uint32_t(kept);
                    most = std::max(most, kept);
                }
                return most;
            },
            [](std::size_t a, std::size_t b) { return std::max(a, b); });
        if (longest <= stride_) return;
        stride_ = (longest + 15) / 8 * 8;
    }
}

}  // namespace sekitei::wind::mps
