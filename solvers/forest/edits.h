#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/vec.h"
#include "solvers/forest/raster.h"

/// Changes while a forest grows: density maps, felling, planting.
namespace sekitei::forest {

/// Where an edit acts; coordinates of the forest [m].
struct Region {
    enum class Kind { Everywhere, Disc, Polygon, Mask };
    Kind kind = Kind::Everywhere;
    double x = 0, y = 0, radius = 0;             ///< disc; its border belongs to it
    std::vector<std::array<double, 2>> corners;  ///< polygon, even-odd
    Raster<std::uint8_t> mask;                   ///< not 0: inside
    double pixel = 1;                            ///< of the mask [m]

    bool contains(double at_x, double at_y) const;
    friend bool operator==(const Region&, const Region&) = default;
};

struct NewTree {
    std::uint64_t uid = 0;
    int species = 0;  ///< from 0
    double x = 0, y = 0, height = 1;

    friend bool operator==(const NewTree&, const NewTree&) = default;
};

/// Acts at the beginning of a step, before anything else, in the order of the list.
struct Edit {
    enum class Kind { Set, Multiply, Image, Fell, Plant };
    Kind kind = Kind::Set;
    int step = 1;                 ///< from 1
    int map = 0;                  ///< band from 0, of Set, Multiply, Image
    double value = 0;             ///< of Set (0..1) and Multiply (>= 0; results are clamped to 1)
    Raster<std::uint16_t> image;  ///< of Image: replaces what lies in the region
    double min_height = 0;        ///< of Fell: trees at least so high [m]
    Region region;
    std::vector<NewTree> trees;  ///< of Plant

    friend bool operator==(const Edit&, const Edit&) = default;
};

/// Density of one band of slices, 0..65535 for 0..1.
using DensityMap = Raster<std::uint16_t>;

/// 65535 * value, rounded.
std::uint16_t density_value(double value);

/// Changes the map that the edit is about; Fell and Plant change none.
/// @param pixel  [m]
void apply(const Edit& edit, std::vector<DensityMap>& maps, double pixel);

}  // namespace sekitei::forest
