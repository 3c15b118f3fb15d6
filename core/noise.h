#pragma once

#include <cstdint>

#include "core/random.h"
#include "core/vec.h"

namespace sekitei {

/// Gradient noise summed over octaves: a field whose spectrum falls as 1 / f^beta.
///
/// Lattice gradients are drawn by address, so any point can be asked in any order. With gain
/// 2^-H per octave the profile along any line has the spectral exponent beta = 2 H + 1
/// [Ebert2002, ch. 16].
struct FractalNoise {
    std::uint64_t seed = 0;
    Stream stream{"noise"};
    double frequency = 1;  ///< cycles per unit of the argument, first octave
    double hurst = 0.5;    ///< H; beta = 2 H + 1
    int octaves = 6;

    /// The noise at p, scaled to lie within [-1, 1] (root mean square near 0.25).
    double operator()(Vec3d p) const;
};

/// One octave of gradient noise [Perlin2002], scaled to lie within [-1, 1]; zero on lattice points.
/// Components of p below 9e18.
double gradient_noise(std::uint64_t key, Vec3d p);

}  // namespace sekitei
