#pragma once

#include <array>
#include <string_view>

#include "core/params.h"
#include "core/progress.h"
#include "grids/scene.h"

/// Gardens around the stone lantern: what stands upwind and what shades.
namespace sekitei::garden {

/// The three experiments of [Ogasawara2003, section 5], the second with the fence on the other side
/// (the paper says both), and a garden with a pond around an islet and trees.
enum class Layout { Nothing, Fence, SouthFence, Pond, Garden };
constexpr std::array<std::string_view, 5> choice_names(Layout)
{
    return {"nothing", "fence", "south_fence", "pond", "garden"};
}

struct Params {
    Layout layout = Layout::Nothing;
    double cell = 0.02;
    double fence_distance = 2, fence_height = 2, fence_length = 10, fence_thickness = 0.2;
    double pond_distance = 1, pond_width = 5, pond_length = 7;
    double canopy_drag = 0.5;

    static void describe(auto&& field)
    {
        field("layout", &Params::layout, "what stands around the lantern");
        field("cell", &Params::cell, "m", between(0.002, 0.1), "edge of the surface cells");
        field("fence_distance", &Params::fence_distance, "m", between(0.6, 100),
              "from the lantern's axis to the near side of the fence");
        field("fence_height", &Params::fence_height, "m", kPositive, "height of the fence");
        field("fence_length", &Params::fence_length, "m", kPositive,
              "length of the fence, east to west");
        field("fence_thickness", &Params::fence_thickness, "m", between(0.1, 10),
              "thickness of the fence");
        field("pond_distance", &Params::pond_distance, "m", between(0.6, 100),
              "from the lantern's axis to the near edge of the pond in the west; with layout = "
              "garden the islet's radius");
        field("pond_width", &Params::pond_width, "m", kPositive, "the pond from east to west");
        field("pond_length", &Params::pond_length, "m", kPositive, "the pond from south to north");
        field("canopy_drag", &Params::canopy_drag, "1/m", kNotNegative,
              "R_U of the trees, how they slow the wind");
    }
};
void validate(const Params& params);

/// `surface_sdf` of the lantern; `obstacle_sdf` (fence, trunks), `water_surface` (pond: 1 in the
/// top layer of voxels, whose upper faces are the water's surface), `canopy_RU` [1/m] and points
/// `leaves` (attributes N and pscale, the half edge of a square leaf cluster [m]) where the layout
/// has them. The lantern's base reaches below the ground, z = 0, so that it has no underside.
Scene make(const Params& params, std::uint64_t seed, const Progress& progress);

}  // namespace sekitei::garden
