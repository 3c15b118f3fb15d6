#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "grids/scene.h"
#include "solvers/forest/forest.h"

/// Forests in scenes. What growth goes on from is kept exactly, as points `forest_trees`; what made
/// it is text with the grid `canopy_height`.
namespace sekitei::apps {

/// Models that stand for trees: `model` of an instance is
/// (kind * variants + variant) * generations.size() + age.
struct ForestModels {
    std::vector<std::string> kinds;  ///< kinds of trees
    int variants = 3;
    std::vector<int> generations{12, 22, 40};  ///< ages of the models
    std::uint64_t seed = 1;

    std::size_t size() const { return kinds.size() * std::size_t(variants) * generations.size(); }
};

/// What a forest was grown with.
struct ForestRecord {
    double width = 0, depth = 0;  ///< [m]
    Vec3d corner;                 ///< world position of its south-western corner [m]
    forest::Params params;
    std::vector<forest::Species> species;
    ForestModels models;
    int step = 0;
    std::uint64_t seed = 0;
};

/// The metadata of `canopy_height` that holds it.
inline constexpr const char* kForestSettings = "forest";
std::string forest_settings(const ForestRecord& record);
/// @throws InvalidInput  the scene's forest is not from `sekitei forest`, or damaged
ForestRecord forest_record(const Scene& scene);
ForestModels forest_models(const Scene& scene);

/// Points `forest_growth`: one row a step, columns as doubles: step, trees, births, lost, the
/// causes of death, mean_share, count_S_C of species S (from 0) and height class C.
void put_forest_growth(Scene& scene, const std::vector<forest::StepStatistics>& rows);
std::vector<forest::StepStatistics> forest_growth_of(const Scene& scene);
/// The same as comma-separated values, species by name.
std::string forest_growth_csv(const std::vector<forest::StepStatistics>& rows,
                              const std::vector<forest::Species>& species);
/// What its columns of height classes are called, "to_3m" ...
inline constexpr std::array<const char*, forest::StepStatistics::kClasses> kForestClasses{
    "to_3m", "to_8m", "to_12m", "above"};
/// The one density a forest was grown with, from the history of its scene.
/// @throws InvalidInput  it has several, or a map
double forest_density(const Scene& scene);
/// One row as JSON and back: what folders of forests out of core keep.
Json row_json(const forest::StepStatistics& row);
forest::StepStatistics row_of(const Json& json);

/// Points `forest_trees`: position = (x, y, height) in the forest's own metres, uid, species,
/// age, kept, cone.
void put_forest_trees(Scene& scene, const std::vector<forest::Tree>& trees);
/// @throws InvalidInput  an attribute is missing
std::vector<forest::Tree> forest_trees_of(const Scene& scene);

/// 64 bits as the signed number that points can hold.
std::int64_t signed_bits(std::uint64_t bits);
std::uint64_t unsigned_bits(std::int64_t bits);

}  // namespace sekitei::apps
