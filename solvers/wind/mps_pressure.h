#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/vec.h"

namespace sekitei::wind::mps {

/// A symmetric positive (semi-)definite system: diagonal[i] x_i - sum over j of w_ij x_j = rhs[i].
///
/// Off-diagonal weights are >= 0 and kept in single precision, which halves the traffic of the
/// solver; the diagonal must be summed from the rounded weights so that rows still close exactly.
struct PressureSystem {
    std::size_t size = 0, stride = 0;    ///< unknowns; room for each row
    std::vector<std::uint32_t> count;    ///< entries of row i
    std::vector<std::uint32_t> columns;  ///< [i * stride + k]
    std::vector<float> weights;          ///< w_ij, same place
    std::vector<double> diagonal, rhs;
    std::vector<Vec3d> place;  ///< of each unknown [m], for the coarse level

    /// Makes room for `unknowns` rows of at most `row_length` entries.
    void resize(std::size_t unknowns, std::size_t row_length);
};

struct Convergence {
    int iterations = 0;
    double residual = 0;  ///< |b - A x| / |b|
    bool converged = false;
};

/// Conjugate gradients, preconditioned by Jacobi plus a direct solve on aggregates
/// [Nicolaides1987]: cubes of edge `aggregate` in which x is constant. Starts from x.
///
/// Sums are ordered: the same bits on any number of threads.
Convergence solve(const PressureSystem& system, double aggregate, double tolerance,
                  int max_iterations, std::vector<double>& x);

}  // namespace sekitei::wind::mps
