#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/params.h"

/// Kinds of trees in a forest [Mizoguchi2008, table 5.1].
namespace sekitei::forest {

/// How `spread` gives the radius r of the cone at height z.
enum class SpreadMode {
    ApexAngle,      ///< full apex angle [rad]: r = z tan(spread / 2)
    DiameterRatio,  ///< r = z spread / 2
    RadiusRatio,    ///< r = z spread
    HalfAngle       ///< r = z tan(spread)
};
constexpr std::array<std::string_view, 4> choice_names(SpreadMode)
{
    return {"apex_angle", "diameter_ratio", "radius_ratio", "half_angle"};
}

/// What a tree needs of one factor of its surroundings: outside [dies_below, dies_above] it dies,
/// outside [stands_below, stands_above] it stands still, between best_from and best_to it grows as
/// fast as it can.
struct Limits {
    std::string factor;  ///< name of an environment map
    double dies_below = 0, stands_below = 0, best_from = 0, best_to = 1, stands_above = 1,
           dies_above = 1;
};

struct Species {
    std::string name = "tall";
    double max_height = 20;
    double spread = 1.0;
    double growth = 3;
    double leaf_area_index = 4;
    double crown_base = 0.5;
    double max_slope = 0.69813170079773183;  // 40 degrees
    int max_age = 0;
    std::string tree = "beech";
    std::string colour = "#008000";
    std::vector<Limits> limits{};

    static void describe(auto&& field)
    {
        field("name", &Species::name, "what it is called in tables");
        field("max_height", &Species::max_height, "m", kPositive,
              "height at which it stops growing");
        field("spread", &Species::spread, "", kPositive,
              "opening of the cone, by spread_mode: full apex angle in radians, or a ratio");
        field("growth", &Species::growth, "m", kNotNegative, "fastest growth in a step");
        field("leaf_area_index", &Species::leaf_area_index, "", kNotNegative,
              "leaf area over the area of its crown");
        field("crown_base", &Species::crown_base, "", kFraction,
              "height of the lowest leaves / height");
        field("max_slope", &Species::max_slope, "rad", between(0, 1.5707963267948966),
              "it does not germinate where the ground is steeper");
        field("max_age", &Species::max_age, "", between(0, 65535),
              "steps after which it dies; 0: never");
        field("tree", &Species::tree, "kind of tree that stands for it in pictures and exports");
        field("colour", &Species::colour, "on distribution maps, #RRGGBB");
    }
};

/// The six species of [Mizoguchi2008, table 5.1].
const std::vector<Species>& table_species();

/// r / z of the cone.
double slope_of(const Species& species, SpreadMode mode);

/// @throws InvalidParameter  naming the species, the key and the value
void validate(const Species& species, SpreadMode mode);

}  // namespace sekitei::forest
