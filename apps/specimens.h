#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"
#include "solvers/tree/species.h"

/// Models of trees for instancing: kinds of trees, some variants of each, at some ages.
namespace sekitei::apps {

/// Levels of detail, the finest first; files are written of the first three.
enum class SpecimenLevel : std::size_t { Near, Middle, Far, Clumps };
inline constexpr std::size_t kSpecimenLevels = 4;
constexpr std::array<std::string_view, kSpecimenLevels> choice_names(SpecimenLevel)
{
    return {"near", "middle", "far", "clumps"};
}

struct Specimen {
    std::string kind;
    int variant = 0, generations = 0;
    std::size_t tips = 0;       ///< 0: it died out before; all below is 0 or empty then
    double height_m = 0;        ///< as grown [m]
    double crown_radius = 0;    ///< [heights]
    double crown_base = 0;      ///< [heights]
    double leaf_area = 0;       ///< as grown [m^2]
    double trunk_diameter = 0;  ///< as grown [m]
    /// Height 1, foot at the origin; bark, then leaves, which the face attribute `part` tells:
    /// 0, 1. Those that nobody wanted are empty.
    std::array<TriMesh, kSpecimenLevels> mesh;
};

struct SpecimenParams {
    int variants = 3;              ///< of each kind
    std::vector<int> generations;  ///< ages, ascending
    std::uint64_t seed = 1;        ///< of the first variant
    double leaf_scale = 1;         ///< by which leaves are drawn larger than they are
};

/// A kind by name or .toml file that models can be grown of.
/// @throws InvalidParameter  no such kind; one that grows shoots from many places
tree::Species specimen_kind(const std::string& name);

/// Grows each variant of each kind once through all ages.
/// @param wanted  whether a mesh of this model at this level is to be made; empty: none
/// @return models in the order (kind * variants + variant) * ages + age, all of them
///
/// Bit-identical for any number of threads.
std::vector<Specimen> grow_specimens(
    const std::vector<tree::Species>& kinds, const SpecimenParams& params,
    const std::function<bool(std::size_t model, SpecimenLevel level)>& wanted = {},
    const Progress& progress = {});

}  // namespace sekitei::apps
