#pragma once

#include <cstdint>
#include <vector>

/// The scenes of the paper's figures, and some of our own, at their full size and for each seed.
/// What must hold of them is asserted, after every step where it is said of every step; what was
/// found is printed.
namespace sekitei::forest::scenes {

using Seeds = std::vector<std::uint64_t>;

/// R1, R2, R3, R5; figures 5.1, 5.4, 5.5, 5.6: density 1 settles in layers, density .4 thins them,
/// a path stays free.
void half_a_kilometre(const Seeds& seeds);
void controls(const Seeds& seeds);   ///< R2: cones that stand upright and discs have no layers
void densities(const Seeds& seeds);  ///< R4, figure 5.2
void cleared(const Seeds& seeds);    ///< R6, figure 5.7
void felling(const Seeds& seeds);    ///< R7, figure 4.8
void filling(const Seeds& seeds);    ///< R8, figure 4.9
void painter(const Seeds& seeds);    ///< R9
void tiles(const Seeds& seeds);      ///< R10
void water(const Seeds& seeds);      ///< R11
void slopes(const Seeds& seeds);     ///< R12
/// R14: the three tall species on a square so wide, as dense as a small one that repeats itself.
void large(double size, const Seeds& seeds);

}  // namespace sekitei::forest::scenes
