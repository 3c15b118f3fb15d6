#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "core/params.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"

/// Conductive cooling of the lava body on the coarse grid [Ito2004, eqs. 1, 2].
namespace sekitei::cooling {

enum class Stop { Steps, Steady };
constexpr std::array<std::string_view, 2> choice_names(Stop)
{
    return {"steps", "steady"};
}

/// Virtual degrees of the paper's Table 1.
struct Params {
    double alpha = 0.1;
    double lava_temperature = 2000, cold_temperature = 200, slow_temperature = 2000;
    std::optional<int> steps;  ///< auto: by preset
    Stop stop = Stop::Steps;
    double steady_change = 1e-3;
    std::optional<double> plateau_gradient;  ///< auto: 1e-3 (T_hot - T_cold)
    std::optional<double> robin;  ///< Biot number h H / k of the cold contact; auto: Dirichlet
    bool allow_unstable = false;

    static void describe(auto&& field)
    {
        field("alpha", &Params::alpha, "", kPositive,
              "mesh Fourier number kappa dt / H^2; stable up to 1/6");
        field("lava_temperature", &Params::lava_temperature, "K", between(0, 1e6),
              "initial temperature of the lava (virtual degrees)");
        field("cold_temperature", &Params::cold_temperature, "K", between(0, 1e6),
              "held in air and ground");
        field("slow_temperature", &Params::slow_temperature, "K", between(0, 1e6),
              "held in the slow part");
        field("steps", &Params::steps, "", between(0, 1e7), "time steps");
        field("stop", &Params::stop, "after `steps`, or when nothing changes any more");
        field("steady_change", &Params::steady_change, "K", kPositive,
              "steady: largest change in a step");
        field("plateau_gradient", &Params::plateau_gradient, "K", kNotNegative,
              "gradient below which there is no direction, per heat cell");
        field("robin", &Params::robin, "", kPositive,
              "Biot number of a cold contact that cools by convection");
        field("allow_unstable", &Params::allow_unstable, "accept alpha above 1/6");
    }
};

void validate(const Params& params);

struct Inputs {
    const IntGrid& region;    ///< coarse; absent = cold (background)
    Domain domain;            ///< the coarse box
    int default_steps = 200;  ///< the preset's
    double default_plateau_share = 1e-3;
};

struct Result {
    FloatGrid temperature;         ///< lava and a 1-cell halo active; background cold_temperature
    VectorGrid gradient;           ///< unit length, cold to hot; zero on plateaus (inactive there)
    FloatGrid gradient_magnitude;  ///< [K per cell]
    int steps = 0;
    double last_change = 0;
};

/// Steps that suit a body nothing is known of: at most `most`, and where no slow part keeps it hot
/// few enough that its middle has not cooled flat, 0.083 R^2 / alpha with R its inner radius in
/// cells (a ball of radius 13.4 cells: 150 steps).
int suitable_steps(const IntGrid& region, const Domain& domain, double alpha, int most);

/// Where a long run continues: opaque bytes, saved now and then, and when the run is cancelled, and
/// offered again at the next start. A resumed run gives the bytes of an uninterrupted one.
struct Checkpoint {
    std::function<void(const std::string& bytes)> save;  ///< may be empty
    std::string resume;                                  ///< empty: from the beginning
    double interval = 5e9;  ///< updates of a voxel between two saves; about ten seconds of work
};

/// Forward time, centred space [Ito2004, eq. 2]; doubles throughout, stored as float. Domain
/// border: zero normal gradient. Up to 128^3 cells dense, above sparse on the leaf pool; both give
/// the same bytes, on any number of threads.
///
/// With `robin` = Bi a cold face is a surface that gives off heat by h (T - T_cold): half a cell of
/// rock and the contact in series, a conductance of 1 / (1/2 + 1/Bi) where two cells have 1.
///
/// @throws InvalidParameter  alpha above the stable limit without allow_unstable
/// @throws InvalidInput      no lava in the box; a region that is not 0, 1, 2 or lies elsewhere;
/// the
///                           temperature is the same everywhere (no cooling surface); a checkpoint
///                           that is damaged or of another run, naming what differs
/// @throws NumericalError    the temperature overflows; not steady after the most steps allowed
/// @throws Cancelled         after saving a checkpoint
Result run(const Inputs& inputs, const Params& params, const Checkpoint& checkpoint,
           const Progress& progress);

}  // namespace sekitei::cooling
