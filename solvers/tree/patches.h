#pragma once

#include <cstddef>
#include <vector>

#include "core/vec.h"

/// The celestial sphere that leaves look at, cut into patches [Kanamaru1992, section 3].
namespace sekitei::tree {

/// Rows of equal polar angle from the zenith down, each of equal azimuths from +x; patch
/// p = row * across + column. directions[p] is the middle of the patch; those of p and opposite(p)
/// are each other's exact negatives where `across` is even.
struct SkyPatches {
    int rows = 0, across = 0;        ///< V, H
    std::vector<Vec3d> direction;    ///< N, unit
    std::vector<double> solid;       ///< S, exact; they add up to 4 pi
    std::vector<double> brightness;  ///< B0: C1 in the upper half, C2 in the lower
    double open = 0;                 ///< sum B0 S: the light of a leaf alone

    std::size_t size() const { return direction.size(); }
    /// The patch that is seen the other way; needs an even `across`.
    std::size_t opposite(std::size_t patch) const
    {
        const auto h = static_cast<std::size_t>(across), row = patch / h, column = patch % h;
        return (static_cast<std::size_t>(rows) - 1 - row) * h + (column + h / 2) % h;
    }
};

/// @param rows    V, even, >= 2
/// @param across  H, >= 3
/// @param upper, lower  C1, C2 >= 0, not both 0; only their ratio matters
/// @throws InvalidParameter
SkyPatches sky_patches(int rows, int across, double upper, double lower);

}  // namespace sekitei::tree
