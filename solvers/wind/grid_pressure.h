#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/vec.h"

namespace sekitei::wind::grid {

/// Cells of a box in one array, with a margin of `kMargin` cells on every side for what lies
/// beyond.
struct Lattice {
    static constexpr int kMargin = 3;
    Coord n;  ///< cells of the box

    std::size_t stride_x() const { return std::size_t(n.y + 2 * kMargin) * stride_y(); }
    std::size_t stride_y() const { return std::size_t(n.z + 2 * kMargin); }
    std::size_t size() const { return std::size_t(n.x + 2 * kMargin) * stride_x(); }
    std::size_t at(int i, int j, int k) const
    {
        return std::size_t(i + kMargin) * stride_x() + std::size_t(j + kMargin) * stride_y() +
               std::size_t(k + kMargin);
    }
};

struct Convergence {
    int iterations = 0;
    double residual = 0;  ///< largest |b - A x|
    bool converged = false;
};

/// The Poisson equation on the cells of a box: A x = sum over open faces of (x - x_neighbour).
///
/// Walls and the other sides have no flow (Neumann); behind the face x = n.x, x = 0 (Dirichlet),
/// half a cell off. Conjugate gradients, preconditioned by one V-cycle of multigrid: cells are
/// joined by eights, a coarse face has the sum of its fine faces over its length, so that walls a
/// single cell thick stay tight [Braess1995]; two steps of Chebyshev-weighted Jacobi before and
/// after; a direct solve on the last level. The V-cycle is in single precision.
class PressureSolver {
public:
    /// @param air  1 where there is air; all of it must be connected to the face x = n.x
    PressureSolver(Lattice lattice, const std::vector<std::uint8_t>& air);

    /// Starts from x, whose margin and solid cells are 0, as are those of b. Sums are ordered: the
    /// same bits on any number of threads.
    /// @param tolerance  largest |b - A x| at the end
    Convergence solve(const std::vector<double>& b, double tolerance, int most_iterations,
                      std::vector<double>& x);

private:
    struct Level {
        Lattice lattice;
        std::vector<float> tx, ty, tz;  ///< coupling to the cell before along each axis
        std::vector<float> diagonal, inverse;
        std::vector<float> x, y, b;
    };
    void coarsen();
    void factorise();
    void cycle(std::size_t level);
    void solve_coarsest();

    std::vector<Level> levels_;
    std::vector<std::size_t> last_cells_;  ///< of the coarsest level
    std::vector<double> factor_;           ///< its Cholesky factor, dense rows
    std::vector<double> r_, p_, q_;
};

}  // namespace sekitei::wind::grid
