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
#include "solvers/tree/species.h"

/// A forest of a scene as trees and ground to draw.
namespace sekitei::apps {

/// Leaves by what tree bears them, or all as asked for.
enum class Season { Auto, Green, Autumn, Blossom, Bare };
constexpr std::array<std::string_view, 5> choice_names(Season)
{
    return {"auto", "green", "autumn", "blossom", "bare"};
}

/// Leaves of a single tree of this kind.
/// @param species  empty: not known
render::LeafColours leaf_colours(const std::string& species, bool needles, Season season);
/// What trees of a forest of this kind look like: leaves, each tree has those of one of them, and
/// the tint of their bark.
struct TreeLook {
    std::vector<render::LeafColours> leaves;
    Vec3f bark{1};
};
TreeLook tree_look(const tree::Species& kind, Season season);
/// Takes the leaves, which follow the bark, from a model.
void drop_leaves(TriMesh& mesh);

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
