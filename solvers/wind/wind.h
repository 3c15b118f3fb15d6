#pragma once

#include <array>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/progress.h"
#include "core/vec.h"
#include "grids/leaf_grid.h"
#include "solvers/wind/air.h"

/// The wind before an object, and beside each of its cells, for eight directions
/// [Ogasawara2003, sections 4.2 and 4.3].
namespace sekitei::wind {

enum class Solver {
    Mps,  ///< particles: the paper's method, minutes a direction
    Grid  ///< the same boxes on a fixed grid, seconds a direction
};
constexpr std::array<std::string_view, 2> choice_names(Solver)
{
    return {"mps", "grid"};
}

/// Boxes and times of the two stages. In the garden the object is left out and a probe measures
/// what arrives where it stands; then the object stands in a box of its own.
struct Params {
    Solver solver = Solver::Grid;
    double speed = 3;                      ///< U0 [m/s]; ratios do not depend on it
    std::optional<Vec3d> garden_size;      ///< along, across, up [m]
    std::optional<double> garden_spacing;  ///< l0 of the garden [m]
    double probe_margin = 0.5;
    std::optional<double> object_margin;
    std::optional<double> object_spacing;  ///< l0 around the object [m]
    double largest_count = 100000;
    double settle = 8;
    double duration = 10;
    double sample_radius = 0.10;
    bool per_layer = false;
    std::optional<double> ground;  ///< height of the ground [m]

    static void describe(auto&& field)
    {
        field("solver", &Params::solver, "particles (the paper's), or a grid, which is quicker");
        field("speed", &Params::speed, "m/s", kPositive,
              "of the stream in the solver; ratios do not depend on it");
        field("garden_size", &Params::garden_size, "m", kPositive,
              "box of the garden along the wind, across and up; the object stands at 7/12 of the "
              "length; auto: 24 x 16 x 8, larger for objects over 4 m or trees over 6 m");
        field("garden_spacing", &Params::garden_spacing, "m", kPositive,
              "particle or cell of the garden; auto: 0.5, coarser over largest_count");
        field("probe_margin", &Params::probe_margin, "m", kNotNegative,
              "by which the probe reaches beyond the object");
        field("object_margin", &Params::object_margin, "m", kPositive,
              "air around the object; auto: 0.4, or a quarter of its longest side");
        field("object_spacing", &Params::object_spacing, "m", kPositive,
              "particle or cell around the object; auto: 0.05 or a tenth of its longest side, "
              "coarser over largest_count");
        field("largest_count", &Params::largest_count, "", between(1000, 1e8),
              "particles or cells that an auto spacing may make");
        field("settle", &Params::settle, "s", kNotNegative,
              "after one flow through the box, before measuring; at 3 m/s and 0.5 m, in "
              "proportion otherwise");
        field("duration", &Params::duration, "s", kPositive, "of measuring, likewise");
        field("sample_radius", &Params::sample_radius, "m", kPositive,
              "around a cell in which its wind is measured; at least two spacings");
        field("per_layer", &Params::per_layer, "exchange with water by height, each 0.5 m");
        field("ground", &Params::ground, "m", kAny,
              "height of the ground; auto: the object's lowest cell");
    }
};

/// @throws InvalidParameter  the first field out of its range
void validate(const Params& params);

struct Inputs {
    const FloatGrid* object = nullptr;    ///< `surface_sdf`: level set [m]
    const FloatGrid* obstacle = nullptr;  ///< `obstacle_sdf`: what else stands there, or null
    const IntGrid* water = nullptr;       ///< `water_surface`, or null
    const FloatGrid* canopy = nullptr;    ///< `canopy_RU` [1/m], or null
    std::span<const Vec3d> cells;         ///< centres of the object's surface cells [m]
};

/// What has been found so far: what a checkpoint holds.
struct State {
    std::array<bool, 8> garden{};  ///< directions of the weather whose tables are known
    AirTables tables;
    std::array<bool, 8> object{};  ///< directions of arrival whose ratios are known
    /// By direction of arrival, one value for each cell.
    std::array<std::vector<float>, 8> arrival;
    std::vector<std::string> warnings;
};

/// Boxes of a run, found before anything is allocated.
struct Plan {
    Vec3d axis;         ///< where the object stands, on the ground [m]
    Vec3d garden_size;  ///< [m]
    double place = 0;   ///< of the object along the garden [m]
    double garden_spacing = 0.5, object_spacing = 0.05;  ///< [m]
    double object_margin = 0.4;                          ///< [m]
    double sample_radius = 0.1;                          ///< [m]
    double garden_count = 0, object_count = 0;           ///< cells; the object's largest box
    double bytes = 0;                                    ///< memory, without the inputs
    std::vector<std::string> notes;  ///< spacings coarser than the default, and why
};

struct Result {
    AirTables tables;
    /// wind_ratio_k: speed at a cell / speed before the object, when the wind blows from k. 0 where
    /// there is no air: deep in gaps narrower than the spacing, and at cut faces of the rock.
    std::array<std::vector<float>, 8> ratio;
    std::array<int, 8> arrival{};    ///< direction 0..7 from which air arrives, by the wind's
    std::vector<std::string> notes;  ///< of the plan, and warnings
};

/// @throws InvalidParameter  the garden does not hold the probe, or parameters out of range
/// @throws InvalidInput      no cells
/// @throws LimitExceeded     a spacing that makes more than 50 million cells
Plan plan(const Inputs& inputs, const Params& params);

/// For each direction a garden without the object, then the object's box for each direction from
/// which air arrives at it (nearest of 8). A fence may turn the air: behind it the mean flow comes
/// back towards it.
///
/// A rock that is cut off by its box goes on sideways. Where no air reaches the probe, A_U = 0, and
/// where none passes the object the ratios are 0, both with a warning.
/// @param before  what an interrupted run has found
/// @param save    called after each direction of each stage with all that is known
/// @throws NumericalError  from the solvers, naming the step; nothing of that direction is kept
///
/// Bit-identical for any number of threads, interrupted or not.
Result run(const Inputs& inputs, const Params& params, const Progress& progress, State before = {},
           const std::function<void(const State&)>& save = {});

}  // namespace sekitei::wind
