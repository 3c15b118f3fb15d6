#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "core/mesh.h"
#include "core/params.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "grids/polyline.h"

/// Contraction centres, centre lines and columns [Ito2004, section 3.3].
namespace sekitei::joints {

enum class Integrator { Rk4, Euler };
constexpr std::array<std::string_view, 2> choice_names(Integrator)
{
    return {"rk4", "euler"};
}
enum class SeedMode { Surface, Plane };
constexpr std::array<std::string_view, 2> choice_names(SeedMode)
{
    return {"surface", "plane"};
}

struct Params {
    std::optional<double> spacing;      ///< mean distance of columns [m]; auto: from count
    std::optional<int> count;           ///< auto: by preset, else from spacing
    std::optional<double> seed_radius;  ///< least pair distance [m]; auto: 0.8 sqrt(area / count)
    SeedMode seed_mode = SeedMode::Surface;
    double maturity = 1;  ///< Lloyd sweeps
    /// Instead of maturity: coefficient of variation of cell areas.
    std::optional<double> target_cv;
    double step = 1;  ///< Kf [voxels]
    Integrator integrator = Integrator::Rk4;
    double least_direction = 0.1;  ///< g_min
    double simplify = 0.02;        ///< Douglas-Peucker tolerance [voxels]
    bool arc = true;               ///< also write the arc-length grid

    static void describe(auto&& field)
    {
        field("spacing", &Params::spacing, "m", kPositive, "mean distance between columns");
        field("count", &Params::count, "", between(1, 1e8),
              "number of seeds over all cooling faces");
        field("seed_radius", &Params::seed_radius, "m", kPositive,
              "least distance between two seeds");
        field("seed_mode", &Params::seed_mode,
              "sample the cooling surface itself, or a plane below it (the paper)");
        field("maturity", &Params::maturity, "", between(0, 100),
              "Lloyd sweeps that even the columns out");
        field("target_cv", &Params::target_cv, "", between(0, 1),
              "instead of maturity: coefficient of variation of the cell areas");
        field("step", &Params::step, "voxels", kPositive,
              "Kf, length of one step of a centre line");
        field("integrator", &Params::integrator, "how centre lines follow the gradient");
        field("least_direction", &Params::least_direction, "", kFraction,
              "interpolated direction shorter than this ends a line");
        field("simplify", &Params::simplify, "voxels", kNotNegative,
              "tolerance when lines are simplified");
        field("arc", &Params::arc, "also write the arc length of each voxel's nearest point");
    }
};

void validate(const Params& params);

struct Inputs {
    const IntGrid& region;       ///< fine
    const FloatGrid& body_sdf;   ///< fine [m]
    const FloatGrid& slow_sdf;   ///< fine [m], may have no leaves
    const VectorGrid& gradient;  ///< coarse unit vectors
    Domain domain, heat_domain;
    std::optional<int> default_count;   ///< the preset's
    std::vector<Vec3d> explicit_seeds;  ///< world [m]; replaces sampling when not empty
};

/// Seeds: `count`, else from `spacing` and the area, else the preset's count, else a spacing
/// of 12.5 voxels.
struct Result {
    std::vector<Vec3d> seeds;  ///< world [m], on the cooling surface
    Polylines lines;           ///< simplified, fine voxel units
    IntGrid column;            ///< nearest line; background -1; lava voxels active
    FloatGrid arc;             ///< arc length of the nearest point [m]; empty unless asked for
};

/// @throws InvalidParameter  fewer than 90 % of the seeds fit; names spacing, area and the
/// saturation bound
/// @throws InvalidInput      no cooling surface, no gradient anywhere, an explicit seed outside the
/// box
///
/// Bit-identical for any number of threads. The lines lie on the lattice of on_line_lattice().
Result run(const Inputs& inputs, const Params& params, std::uint64_t seed,
           const Progress& progress);

// The steps of run(), for tests and for other tools.

/// Triangles of the cooling surface (lava against cold) in fine voxel units, cut at the domain box;
/// the walls of the box are no part of it. Counter-clockwise seen from the cold side.
TriMesh cooling_surface(const Inputs& inputs, const Progress& progress);

/// Random sequential packing: no more than this / radius^2 seeds fit on a unit of area, on average.
inline constexpr double kSaturation = 0.6965;

/// Poisson-disk points on a triangle mesh by dart throwing in a fixed random order, `radius` least
/// distance (straight, not along the surface); at most `count` points and 1000 count tries (0: fill
/// until no surface is farther than 1.001 radius from a seed).
///
/// Darts that miss narrow the aim instead of being thrown for nothing: what is left of the surface
/// is kept as triangle fragments, those inside one disk are dropped, the others split [Cline2009].
/// The fragments always hold all the free area, so the points are distributed as by plain dart
/// throwing.
std::vector<Vec3d> poisson_disk(const TriMesh& surface, std::size_t count, double radius,
                                std::uint64_t seed, const Progress& progress = {});

/// The same on the surface's projection onto a horizontal plane, lifted vertically; surfaces facing
/// up and down are sampled one after the other, each with its share of `count` [Ito2004].
std::vector<Vec3d> poisson_disk_plane(const TriMesh& surface, std::size_t count, double radius,
                                      std::uint64_t seed, const Progress& progress = {});

/// Fractional Lloyd sweeps on the surface: each seed moves to the centroid of its cell and back
/// onto the surface, on the last sweep by a fraction of the way.
std::vector<Vec3d> relax(const TriMesh& surface, std::vector<Vec3d> seeds, double sweeps,
                         const Progress& progress);

/// As many sweeps, at most 40, as bring the coefficient of variation of the cells' areas down to
/// `target`; the last one by bisection.
std::vector<Vec3d> relax_to(const TriMesh& surface, std::vector<Vec3d> seeds, double target,
                            const Progress& progress);

/// Standard deviation over mean of the areas of the seeds' cells on the surface.
double area_variation(const TriMesh& surface, const std::vector<Vec3d>& seeds);

/// A point in fine voxel units as an index on the lattice of coarse cell centres: u = p h / H - 0.5
/// when both boxes begin at the same corner, held within the lattice.
Vec3d coarse_index(Vec3d p, const Domain& fine, const Domain& coarse);

/// A traced line.
struct Path {
    std::vector<Vec3d> points;
    StopReason stop = StopReason::NoStep;
};

/// P' = P + step * g(P) from `start` through [0, dims], voxel units [Ito2004, eq. 3]. Stops, tested
/// in this order: `flat` (|direction| < least_direction), `reversal` (a turn of more than 90
/// degrees; the last point is dropped), `domain` (clipped at the box), `region` (not in lava;
/// bisected to 1e-3 voxel), `max` (10 times the sum of the box's edges).
/// @param direction  interpolated unit vectors, not renormalised
Path follow(Vec3d start, Coord dims, const std::function<Vec3d(Vec3d)>& direction,
            const std::function<bool(Vec3d)>& in_lava, const Params& params);

/// Centre lines from seeds, which first move 0.5 voxel along the gradient into the lava; where that
/// is not enough (a rough surface), up to 2 voxels. Not simplified. A line without a step stays as
/// a single point.
Polylines trace(const Inputs& inputs, const Params& params, const std::vector<Vec3d>& seeds_voxels,
                const Progress& progress);

/// Douglas-Peucker on every line.
Polylines simplify(const Polylines& lines, double tolerance);

/// Nearest line and arc length of each active lava voxel of `region`.
void partition(const IntGrid& region, const Polylines& lines, double voxel, IntGrid& column,
               FloatGrid* arc, const Progress& progress);

}  // namespace sekitei::joints
