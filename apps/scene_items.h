#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "apps/stage.h"

/// What every name in a scene means: the one place that describes grids, points and meshes.
namespace sekitei::apps {

struct SceneItem {
    enum class Kind { Grid, Points, Mesh };

    /// A value at each point of a set, or at each face of a mesh.
    struct Attribute {
        std::string name;  ///< one "<...>" stands for any text
        std::string type;  ///< "float", "double", "int32", "int64", "vec3f", "quatf"
        std::string unit, meaning;
    };

    std::string name;  ///< "suit_<species>": a "<...>" stands for any text
    Kind kind = Kind::Grid;
    std::string type;  ///< of a grid: "float", "int32", "vec3s"
    std::string unit;
    GridClass grid_class = GridClass::Unknown;
    std::string meaning;
    std::vector<Attribute> attributes{};
};

/// In the order in which stages make them.
const std::vector<SceneItem>& scene_items();

/// The item that `name` is, or null.
const SceneItem* find_scene_item(std::string_view name);

/// The attribute that `name` is, or null. The mesh and its points `sites` also have every field of
/// the surface, under the grid's name.
const SceneItem::Attribute* find_attribute(const SceneItem& item, std::string_view name);

/// Every name that a stage reads and makes, whatever its parameters are and whatever it reads, as
/// scene_items() names it: parameters are tried one by one.
struct StageItems {
    std::vector<std::string> needs, uses, makes;  ///< each in the order first met
};
StageItems items_of_stage(const std::string& stage);

}  // namespace sekitei::apps
