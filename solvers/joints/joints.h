#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/params.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "grids/polyline.h"

/// Contraction centres, centre lines and columns [Ito2004, section 3.3].
namespace sekitei::joints {

enum class Integrator { Rk4, Euler };
constexpr std::array<std::string_view, 2> choice_names(Integrator) { return {"rk4", "euler"}; }
enum class SeedMode { Surface, Plane };
constexpr std::array<std::string_view, 2> choice_names(SeedMode) { return {"surface", "plane"}; }

struct Params {
    std::optional<double> spacing;      ///< mean distance of columns [m]; auto: from count
    std::optional<int> count;           ///< auto: by preset, else from spacing
    std::optional<double> seed_radius;  ///< least pair distance [m]; auto: 0.8 sqrt(area / count)
    SeedMode seed_mode = SeedMode::Surface;
    double maturity = 1;                ///< Lloyd sweeps
    std::optional<double> target_cv;    ///< instead of maturity: coefficient of variation of cell areas
    double step = 1;                    ///< Kf [voxels]
    Integrator integrator = Integrator::Rk4;
    double least_direction = 0.1;       ///< g_min
    double simplify = 0.02;             ///< Douglas-Peucker tolerance [voxels]
    bool arc = true;                    ///< also write the arc-length grid

    static void describe(auto&& field)
    {
        field("spacing", &Params::spacing, "m", kPositive, "mean distance between columns");
        field("count", &Params::count, "", between(1, 1e8), "number of seeds over all cooling faces");
        field("seed_radius", &Params::seed_radius, "m", kPositive, "least distance between two seeds");
        field("seed_mode", &Params::seed_mode, "sample the cooling surface itself, or a plane below it (the paper)");
        field("maturity", &Params::maturity, "", between(0, 100), "Lloyd sweeps that even the columns out");
        field("target_cv", &Params::target_cv, "", between(0, 1), "instead of maturity: coefficient of variation of the cell areas");
        field("step", &Params::step, "voxels", kPositive, "Kf, length of one step of a centre line");
        field("integrator", &Params::integrator, "how centre lines follow the gradient");
        field("least_direction", &Params::least_direction, "", kFraction, "interpolated direction shorter than this ends a line");
        field("simplify", &Params::simplify, "voxels", kNotNegative, "tolerance when lines are simplified");
        field("arc", &Params::arc, "also write the arc length of each voxel's nearest point");
    }
};

void validate(const Params& params);

struct Inputs {
    const IntGrid& region;        ///< fine
    const FloatGrid& body_sdf;    ///< fine [m]
    const FloatGrid& slow_sdf;    ///< fine [m], may have no leaves
    const VectorGrid& gradient;   ///< coarse unit vectors
    Domain domain, heat_domain;
    std::optional<int> default_count;   ///< the preset's
    std::vector<Vec3d> explicit_seeds;  ///< world [m]; replaces sampling when not empty
};

struct Result {
    std::vector<Vec3d> seeds;  ///< world [m], on the cooling surface
    Polylines lines;           ///< simplified, fine voxel units
    IntGrid column;            ///< nearest line; background -1; lava voxels active
    FloatGrid arc;             ///< arc length of the nearest point [m]; empty unless asked for
};

/// @throws InvalidParameter  fewer than 90 % of the seeds fit; names spacing, area and the saturation bound
/// @throws InvalidInput      no cooling surface
Result run(const Inputs& inputs, const Params& params, std::uint64_t seed, const Progress& progress);

// The steps of run(), for tests and for other tools.

/// Triangles of the cooling surface (lava against cold) in fine voxel units.
TriMesh cooling_surface(const Inputs& inputs, const Progress& progress);

/// Poisson-disk points on a triangle mesh by dart throwing in a fixed random order, `radius` least
/// distance; at most `count` points (0: fill to saturation with no surface farther than 1.05 radius).
std::vector<Vec3d> poisson_disk(const TriMesh& surface, std::size_t count, double radius,
                                std::uint64_t seed);

/// Fractional Lloyd sweeps on the surface.
std::vector<Vec3d> relax(const TriMesh& surface, std::vector<Vec3d> seeds, double sweeps,
                         std::uint64_t seed, const Progress& progress);

/// Centre lines from seeds; not simplified.
Polylines trace(const Inputs& inputs, const Params& params, const std::vector<Vec3d>& seeds_voxels,
                const Progress& progress);

/// Douglas-Peucker on every line.
Polylines simplify(const Polylines& lines, double tolerance);

/// Nearest line and arc length of each active lava voxel of `region`.
void partition(const IntGrid& region, const Polylines& lines, double voxel, IntGrid& column,
               FloatGrid* arc, const Progress& progress);

}  // namespace sekitei::joints
