#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/vec.h"
#include "solvers/forest/raster.h"
#include "solvers/forest/species.h"

/// What a forest stands on: ground, rocks, water, warmth.
namespace sekitei::forest {

/// How several factors act together on growth.
enum class Combine {
    Minimum,  ///< the scarcest one limits (Liebig)
    Product
};
constexpr std::array<std::string_view, 2> choice_names(Combine)
{
    return {"minimum", "product"};
}

/// An environment map: water 0..1, temperature [C], soil_depth [m], light 0..1, slope [deg] ...
struct Factor {
    std::string name;
    Raster<float> value;
    float constant = 0;  ///< everywhere, where `value` is empty

    double at(int i, int j) const
    {
        return value.empty() ? double(constant) : double(value.at(i, j));
    }
};

/// 1 between best_from and best_to, falling in a line to 0 at stands_below and stands_above, 0 from
/// there to dies_below and dies_above, below 0 beyond them (the tree dies).
double response(const Limits& limits, double value);

/// Rasters that are empty stand for flat, free, plantable ground. All have the forest's pixels.
class Land {
public:
    double pixel = 1;                ///< [m]
    Raster<float> ground;            ///< height [m]
    Raster<std::uint8_t> plantable;  ///< 0: no seedling
    Raster<float> blocked_height;    ///< of rocks above the ground [m], whose space is taken
    std::vector<Factor> factors;
    Combine combine = Combine::Minimum;

    bool flat() const { return ground.empty(); }
    double height(int i, int j) const { return ground.empty() ? 0 : double(ground.at(i, j)); }
    /// Bilinear between pixel centres [m].
    double height_at(double x, double y) const;
    /// By central differences, one-sided at borders [rad].
    double slope(int i, int j) const;
    bool has_factor(const std::string& name) const;
    /// Adds the factor `temperature` = at_base - lapse * (height - base) [C] (0.0065 C/m as usual).
    /// A map of that name that is there already stays; so does one of `slope`.
    void add_temperature(double at_base, double base, double lapse = 0.0065);
    /// Adds the factor `slope` [deg].
    void add_slope();

    /// Index of each species' limits in `factors`.
    /// @throws InvalidParameter  a species has limits of a factor that is not there
    void bind(const std::vector<Species>& species);
    /// Whether a seedling of this species (0-based) may stand there; bind() first. It may not where
    /// the ground is too steep or not plantable, where a rock lies, and where it
    /// would die.
    bool admits(int species, int i, int j) const;
    /// f_env in 0..1; below 0 where the species dies.
    double vigour(int species, int i, int j) const;

private:
    template <class F>
    void add_factor(const std::string& name, F&& value_at);

    struct Need {
        std::size_t factor;
        Limits limits;
    };
    std::vector<std::vector<Need>> needs_;  // by species
    std::vector<double> max_slope_;         // [rad]
};

}  // namespace sekitei::forest
