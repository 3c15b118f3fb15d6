#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "apps/render/render.h"
#include "core/mesh.h"
#include "core/progress.h"
#include "grids/scene.h"

/// A forest of a scene as trees and ground to draw.
namespace sekitei::apps {

/// Leaves by what tree bears them, or all as asked for.
enum class Season { Auto, Green, Autumn, Blossom, Bare };
constexpr std::array<std::string_view, 5> choice_names(Season)
{
    return {"auto", "green", "autumn", "blossom", "bare"};
}

/// Names of the grids and points below.
std::vector<std::string> forest_uses();

/// Puts the trees of `forest_instances`, what grows their models, and grass, ferns and herbs around
/// an eye near the ground. Bushes that an eye would be in are left out.
/// @param leaf_scale  by which leaves are drawn larger than they are
/// @throws InvalidInput  attributes or models that are missing
void add_forest(render::Stuff& stuff, const Scene& scene, Season season, double leaf_scale,
                const std::optional<Vec3d>& eye, std::uint64_t seed, const Progress& progress);

/// The ground of `forest_instances`: `terrain_height`, level where there is none. Its vertex
/// attribute `light` is `ground_transmittance`; beyond its border it falls gently to its lowest
/// place.
TriMesh forest_floor(const Scene& scene);

}  // namespace sekitei::apps
