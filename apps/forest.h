#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "grids/scene.h"

/// Forests in scenes.
namespace sekitei::apps {

/// Models that stand for trees: `model` of an instance is
/// (kind * variants + variant) * generations.size() + age.
struct ForestModels {
    std::vector<std::string> kinds;  ///< kinds of trees
    int variants = 3;
    std::vector<int> generations;  ///< ages of the models
    std::uint64_t seed = 0;
};
/// @throws InvalidInput  the scene's forest is not from `sekitei forest`
ForestModels forest_models(const Scene& scene);

}  // namespace sekitei::apps
