#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "core/image.h"
#include "core/mesh.h"
#include "core/params.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "grids/scene.h"

/// The body of lava and what surrounds it: where it cools, where it stays hot.
namespace sekitei::lava {

/// Region ids, as in the `region` grid.
inline constexpr std::int32_t kLava = 0, kCold = 1, kSlow = 2;

/// The paper's four families (fig. 11), its three scenes (fig. 13), its cooling example (fig. 6),
/// and bodies that come from a file.
enum class Preset {
    Chevron,
    Rosette,
    Fan,
    Basin,
    Cliff,
    Tower,
    Coast,
    Slab,
    HeightMap,
    Mesh,
    Volume
};
constexpr std::array<std::string_view, 11> choice_names(Preset)
{
    return {"chevron", "rosette", "fan",        "basin", "cliff", "tower",
            "coast",   "slab",    "height_map", "mesh",  "volume"};
}

/// Which part of the surroundings of a body from a file stays hot (the rest of the outside is
/// cold): everything below a height, or a layer on the mesh's faces that look down or belong to a
/// group.
enum class SlowPart { None, Below, FacingDown, Group };
constexpr std::array<std::string_view, 4> choice_names(SlowPart)
{
    return {"none", "below", "facing_down", "group"};
}

struct Params {
    Preset preset = Preset::Chevron;
    std::optional<Vec3d> size;  ///< box [m]; auto: the preset's number of voxels
    /// Fine edge [m]; auto: 4 cm, with `size` the longest side in as many voxels as the preset's,
    /// bodies from files 250 voxels along the longest side, volumes their own.
    std::optional<double> voxel;
    std::optional<double> heat_cell;  ///< coarse edge [m]; auto: about 8 voxels (paper: 250 / 32)
    /// Of the boundaries, share of the box's height; auto: by preset.
    std::optional<double> noise_amplitude;
    double noise_beta = 2;  ///< spectral exponent of the boundary noise
    std::filesystem::path height_map;
    std::optional<double> metres_per_pixel;         ///< required with a height map
    std::optional<double> height_low, height_high;  ///< [m] of black and white; required likewise
    double base = 0;                                ///< lower side of the lava [m]
    std::filesystem::path mesh;
    double mesh_scale = 1;  ///< metres per unit of the file
    std::filesystem::path volume;
    std::optional<double> margin;  ///< cold around a body from a file [m]; auto: two heat cells
    bool cold_ground = false;      ///< the ground below a height map's base cools it too
    SlowPart slow = SlowPart::None;
    double slow_below = 0;    ///< [m], with `below`
    double slow_slope = 0.5;  ///< facing_down: outward normal z below -slow_slope
    std::string slow_group;
    std::optional<double> slow_thickness;  ///< of the slow layer on facing_down and group faces
                                           ///< [m]; auto: two heat cells
    bool strict = false;                   ///< refuse meshes that would need repair

    static void describe(auto&& field)
    {
        field("preset", &Params::preset, "family, scene or source of the lava body");
        field("size", &Params::size, "m", kPositive, "box of the scene");
        field("voxel", &Params::voxel, "m", kPositive, "edge of a fine voxel");
        field("heat_cell", &Params::heat_cell, "m", kPositive, "edge of a coarse heat cell");
        field("noise_amplitude", &Params::noise_amplitude, "", between(0, 0.5),
              "relief of the boundaries, share of the box height");
        field("noise_beta", &Params::noise_beta, "", between(1, 3),
              "spectral exponent of that relief, 1/f^beta");
        field("height_map", &Params::height_map,
              "PNG whose grey is the height of the lava's surface");
        field("metres_per_pixel", &Params::metres_per_pixel, "m", kPositive,
              "horizontal size of a height map's pixel; must be given with one");
        field("height_low", &Params::height_low, "m", kAny,
              "height of a height map's black; must be given with one");
        field("height_high", &Params::height_high, "m", kAny,
              "height of its white; must be given with one");
        field("base", &Params::base, "m", kAny,
              "height of the lava's lower side under a height map");
        field("mesh", &Params::mesh, "closed mesh of the lava body (PLY, OBJ, STL, OFF)");
        field("mesh_scale", &Params::mesh_scale, "", kPositive, "metres per unit of the mesh file");
        field("volume", &Params::volume,
              "VDB file with a `region` grid or with level sets of the body and its slow part");
        field("margin", &Params::margin, "m", kPositive,
              "width of the cold surroundings of a body from a file");
        field("cold_ground", &Params::cold_ground,
              "the ground below a height map's base is cold too");
        field("slow", &Params::slow, "part of a mesh body's surroundings that stays hot");
        field("slow_below", &Params::slow_below, "m", kAny,
              "height of the slow part with slow = below");
        field("slow_slope", &Params::slow_slope, "", kFraction,
              "with facing_down: outward normal's z below minus this");
        field("slow_group", &Params::slow_group,
              "with group: name of the mesh group that stays hot");
        field("slow_thickness", &Params::slow_thickness, "m", kPositive,
              "thickness of the hot layer on the chosen faces");
        field("strict", &Params::strict, "refuse a mesh that needs repair");
    }
};

void validate(const Params& params);

/// Bodies read from files by the caller; only the one that `preset` names is used.
struct Inputs {
    std::optional<Image16> height_map;
    std::optional<TriMesh> mesh;           ///< in the file's units
    std::vector<std::string> mesh_groups;  ///< names; the face attribute `group` indexes them
    /// `region` (Int32), or level sets `body_sdf` / any single level set.
    const Scene* volume = nullptr;
};

struct Result {
    /// Boxes with one origin; the coarse one may reach a little farther.
    Domain domain, heat_domain;
    IntGrid region, region_coarse;  ///< ids; background kCold; lava and slow voxels active
    /// Level set of lava and slow part together [m]. It knows nothing of the box walls: values go
    /// on as if there were none, and are valid one leaf beyond the box.
    FloatGrid body_sdf;
    FloatGrid slow_sdf;  ///< level set of the slow part [m]; no leaves when there is none
    double lava_voxels = 0, cold_voxels = 0, slow_voxels = 0;  ///< of the fine box
};

/// What a preset recommends for later stages.
struct PresetDefaults {
    int heat_steps = 200;
    double plateau_share = 1e-3;    ///< plateau_eps / (T_hot - T_cold)
    std::optional<int> seed_count;  ///< over all cooling faces; empty: from the spacing
    bool generic = false;  ///< nothing is known of the body: its size may ask for fewer steps
};
PresetDefaults preset_defaults(Preset preset);

/// What this run would need, found before anything is allocated, in doubles that cannot overflow.
struct Estimate {
    double voxels = 0;     ///< of the fine box
    double bytes = 0;      ///< memory of run(): constant leaves and two surfaces
    Coord dims;            ///< fine; clamped to 2^31 - 1
    double voxel = 0;      ///< edge [m], auto resolved
    Coord heat_dims;       ///< coarse; clamped likewise
    double heat_cell = 0;  ///< edge [m]
};
/// @throws InvalidParameter, InvalidInput  as run() does for what it needs to know
Estimate estimate(const Params& params, const Inputs& inputs);

/// Regions at both resolutions from implicit boundaries; on overlap cold wins over slow.
///
/// Fine leaves that the surface does not meet are constants: cost follows the surface.
/// @throws InvalidParameter  out of range, or a parameter that does not go with the preset
/// @throws InvalidInput      open mesh when strict or when nothing is inside, unknown group, a
/// volume
///                           without level set or region, no lava inside the box
/// @throws LimitExceeded     more voxels than indices can name
Result run(const Inputs& inputs, const Params& params, std::uint64_t seed,
           const Progress& progress);

}  // namespace sekitei::lava
