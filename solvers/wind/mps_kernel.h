#pragma once

#include <cstddef>

namespace sekitei::wind::mps {

/// The kernel [Koshizuka1996, eq. 1]: re / r - 1 for 0 < r < re, else 0.
inline double weight(double r, double re)
{
    return r > 0 && r < re ? re / r - 1 : 0;
}

/// Sums of the kernel over the neighbours of one site of the square or cubic lattice.
struct LatticeConstants {
    double n0 = 0;               ///< sum of w
    double lambda = 0;           ///< sum of r^2 w / sum of w [m^2]
    std::size_t neighbours = 0;  ///< sites with 0 < r < re
};

/// @param dimension  2 or 3
/// @param spacing    of the lattice [m]
/// @param radius     re [m]
LatticeConstants lattice_constants(int dimension, double spacing, double radius);

}  // namespace sekitei::wind::mps
