#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "grids/polyline.h"

/// Cuts, collapse and the density of what stands [Ito2004, sections 3.4, 3.5].
namespace sekitei::weathering {

enum class Cut { None, Horizontal, Perpendicular };
constexpr std::array<std::string_view, 3> choice_names(Cut)
{
    return {"none", "horizontal", "perpendicular"};
}
enum class Collapse { Exposed, All };
constexpr std::array<std::string_view, 2> choice_names(Collapse)
{
    return {"exposed", "all"};
}
enum class AntiAliasing { Plane, Simplex, Literal };
constexpr std::array<std::string_view, 3> choice_names(AntiAliasing)
{
    return {"plane", "simplex", "literal"};
}
enum class SlowFill { Rock, Empty };
constexpr std::array<std::string_view, 2> choice_names(SlowFill)
{
    return {"rock", "empty"};
}
/// Large-scale proneness to weather: uniform 1/2, or the scenes' ramps in box shares: the cliff's
/// (1 - x)(1 - z), the tower's clamp((r - 0.25) / 0.1) with r from the vertical axis.
enum class Ramp { Uniform, Cliff, Tower };
constexpr std::array<std::string_view, 3> choice_names(Ramp)
{
    return {"uniform", "cliff", "tower"};
}

/// Classes of the finished surface, as in the `surface` grid and mesh attribute.
enum class Surface : std::int32_t {
    JointWall,
    CutFace,
    CoolingContact,
    SlowContact,
    TerrainCut,
    DomainCap
};

struct Params {
    Cut cut = Cut::None;
    Collapse collapse = Collapse::Exposed;
    AntiAliasing anti_aliasing = AntiAliasing::Plane;
    SlowFill slow_fill = SlowFill::Rock;
    double density = 1;  ///< volmax
    Ramp ramp = Ramp::Uniform;
    double ramp_weight = 0.6, surface_weight = 0.3, noise_weight = 0.2;
    std::optional<double> depth;  ///< delta [m]; auto: 10 voxels
    /// Outward direction of the weathered box face: the wall whose normal is nearest to it is open
    /// to the air. Auto: every wall cuts through rock that goes on, depth from the body's surface.
    std::optional<Vec3d> open_face;
    double noise_wavelength = 20;  ///< [voxels]
    double holding_limit = 0.5;
    /// [m]; a voxel that holds the length l of line is cut with the chance 1 - (1 - W)^(l / this).
    /// Auto: with the chance W, one draw a voxel (the paper).
    std::optional<double> cut_ref_length;
    // horizontal cuts: terrain z = base + slope . (x, y) + amplitude fBm, in shares of the box
    double terrain_base = 0.2, terrain_slope_x = 0.45, terrain_slope_y = 0;
    double terrain_amplitude = 0.12, terrain_hurst = 0.8;
    int terrain_octaves = 6;
    std::vector<double> remove_columns;  ///< ids
    std::vector<double> remove_box;  ///< boxes x0,y0,z0,x1,y1,z1 in shares of the scene's: columns
                                     ///< whose seed lies in one

    static void describe(auto&& field)
    {
        field("cut", &Params::cut, "how columns are cut");
        field("collapse", &Params::collapse,
              "which weak pieces fall: those at the surface, or all (the paper)");
        field("anti_aliasing", &Params::anti_aliasing, "how the boundary's density is found");
        field("slow_fill", &Params::slow_fill,
              "the slow part as massive rock, or empty (the paper)");
        field("density", &Params::density, "", kPositive, "volmax, density of whole rock");
        field("ramp", &Params::ramp, "large-scale proneness to weather");
        field("ramp_weight", &Params::ramp_weight, "", kFraction, "share of the ramp in W");
        field("surface_weight", &Params::surface_weight, "", kFraction,
              "share of the nearness to the open surface in W");
        field("noise_weight", &Params::noise_weight, "", kFraction, "share of 1/f noise in W");
        field("depth", &Params::depth, "m", kPositive, "depth over which the surface term fades");
        field("open_face", &Params::open_face, "", between(-1, 1),
              "outward direction of the box face that weathers");
        field("noise_wavelength", &Params::noise_wavelength, "voxels", kPositive,
              "longest wavelength of the noise");
        field("holding_limit", &Params::holding_limit, "", kFraction,
              "mean W above which a piece falls");
        field("cut_ref_length", &Params::cut_ref_length, "m", kPositive,
              "length of line on which W is the chance of a cut");
        field("terrain_base", &Params::terrain_base, "", kAny,
              "height of the terrain at the origin, share of the box height");
        field("terrain_slope_x", &Params::terrain_slope_x, "", kAny,
              "rise along x, share of the box height over its width");
        field("terrain_slope_y", &Params::terrain_slope_y, "", kAny, "rise along y");
        field("terrain_amplitude", &Params::terrain_amplitude, "", kNotNegative,
              "relief of the terrain, share of the box height");
        field("terrain_hurst", &Params::terrain_hurst, "", kFraction,
              "Hurst exponent of the terrain");
        field("terrain_octaves", &Params::terrain_octaves, "", between(1, 16),
              "octaves of the terrain");
        field("remove_columns", &Params::remove_columns, "", kNotNegative,
              "ids of columns to leave out");
        field("remove_box", &Params::remove_box, "", kAny,
              "leave out columns that start in boxes x0,y0,z0,x1,y1,z1 (shares of the scene's)");
    }
};

void validate(const Params& params);

struct Inputs {
    const IntGrid& region;      ///< fine
    const IntGrid& column;      ///< fine
    const FloatGrid& body_sdf;  ///< fine [m]
    const FloatGrid& slow_sdf;  ///< fine [m], may have no leaves
    const Polylines& lines;     ///< simplified, voxel units
    Domain domain;
    const FloatGrid* weathering = nullptr;  ///< a W field of the user's, replaces the formula
    const FloatGrid* terrain = nullptr;  ///< level set of what stays, replaces the fractal terrain
};

struct Result {
    IntGrid component;     ///< global piece ids; background -1; lava voxels active
    FloatGrid weathering;  ///< W on voxels crossed by a line
    FloatGrid density;     ///< fog volume [0, density]; the surface lies at density / 2
    IntGrid surface;       ///< class of the nearest boundary, active on the boundary ring
    std::size_t columns = 0, pieces = 0, removed_pieces = 0;
    double removed_voxels = 0, lava_voxels = 0;
    double leaves_touched_share = 0;  ///< of lava leaves by the boundary pass
};

/// Cuts the columns, lets weak pieces fall and finds the density of what stands.
///
/// A piece is weak when the mean W of the voxels that its part of the centre line crosses is above
/// holding_limit. With `exposed` a weak piece falls if one of its faces touches cold, a removed
/// voxel or the open wall, repeated to a fixed point. Slow voxels and the other walls hold.
///
/// Plane mode: density = volmax clamp(1/2 + s / (2 sqrt 3)) on every voxel whose 26-neighbourhood
/// holds rock and emptiness, with s [voxels] the signed distance to the rock's boundary, put
/// together as a solid: columns (bisector planes, cuts), body, slow part and box, each extended
/// beyond its end so that edges stay sharp. The same is done one voxel outside the box.
///
/// @throws InvalidInput      a column id without a line, grids that do not fit the domain
/// @throws InvalidParameter  see validate(); a removed column that does not exist
///
/// Bit-identical for any number of threads.
Result run(const Inputs& inputs, const Params& params, std::uint64_t seed,
           const Progress& progress);

// Parts of run() with oracles of their own.

/// Voxels a polyline passes, in order, half-open voxels (exact parametric walk), with the length in
/// each.
struct WalkStep {
    Coord voxel;
    double length = 0;  ///< [voxels]
    double arc = 0;     ///< at which the line enters the voxel
};
std::vector<WalkStep> walk(const Vec3d* points, std::size_t count);

/// Where a line meets a terrain.
struct Crossing {
    Vec3d point;           ///< [voxels]; the cut lies at its z
    double arc = 0;        ///< [voxels]
    double direction = 0;  ///< sign of the line's dz there
};
/// @param height  above the terrain: positive where rock is removed, zero on the terrain
std::vector<Crossing> terrain_crossings(const Vec3d* points, std::size_t count,
                                        const std::function<double(Vec3d)>& height);

/// Component of each voxel of a walk: a new one starts where u < W (k >= 1).
std::vector<int> cut_components(const std::vector<double>& w, const std::vector<double>& u);

/// Raw shares of equation (6): 1/n + mean(d) - d_i, d in voxels.
std::vector<double> literal_ratios(const std::vector<double>& d);
/// The same projected onto the probability simplex.
std::vector<double> simplex_ratios(const std::vector<double>& d);

}  // namespace sekitei::weathering
