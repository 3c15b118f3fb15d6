#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "grids/scene.h"
#include "solvers/tree/grove.h"

/// Trees in scenes. What growth goes on from is kept exactly: points `tree_skeleton`, `trees` and
/// `tree_buds`, and the parameters as text with the grid `canopy_lad`.
namespace sekitei::apps {

/// Kinds of trees by name; data/trees/ holds the same for users to edit.
const std::vector<tree::Species>& preset_trees();
/// One of these, or what a .toml file describes.
/// @throws InvalidParameter
tree::Species find_tree(const std::string& name, const std::filesystem::path& folder);

/// All that makes a grove.
struct GroveRecord {
    tree::GroveParams params;
    std::vector<tree::Species> species;
    tree::Grove::State state;
};
/// What grove_record() reads.
std::vector<std::string> grove_items();
/// @throws InvalidInput  an attribute or the parameters are missing or damaged
GroveRecord grove_record(const Scene& scene);

/// Parameters, species, seed and generation as text, for the metadata of grids.
std::string grove_settings(const tree::Grove& grove);
/// Puts `tree_skeleton`, `trees` and `tree_buds`.
/// @param radius  of each branch [m]
void put_grove(Scene& scene, const tree::Grove& grove, std::span<const double> radius);

/// Rows of `tree_growth`: one for each generation.
void put_growth(Scene& scene, const std::vector<tree::GenerationStatistics>& rows);
std::vector<tree::GenerationStatistics> growth_of(const Scene& scene);
/// The same as comma-separated values; lengths in branch lengths.
std::string growth_csv(const std::vector<tree::GenerationStatistics>& rows);

/// Wood alone, without what growth needs.
struct Skeleton {
    tree::Branches branches;
    std::vector<double> radius;  ///< [m]
    double unit_length = 0.2;    ///< [m]
};
/// @throws InvalidInput  an attribute is missing
Skeleton skeleton_of(const Scene& scene);

/// A file of the skeleton [m]: vertices x y z radius generation order light alive dead_age tree_id
/// key, edges v1 v2. `.ply` and `.json`; `.obj` has polylines only.
/// @param suffix  with its dot
std::string encode_skeleton(const tree::Grove& grove, std::span<const double> radius,
                            std::string_view suffix);

}  // namespace sekitei::apps
