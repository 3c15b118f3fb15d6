#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"
#include "solvers/tree/species.h"

/// Models of trees for instancing: kinds of trees, some variants of each, at some ages.
namespace sekitei::apps {

/// How fine a mesh is.
struct SpecimenDetail {
    std::string_view name;
    double leaves = 1;    ///< about so many, at most
    double thinnest = 0;  ///< wood, by the trunk
    double edge = 0.02;   ///< of facets of bark [m, as grown]
    /// For pictures: leaves of two triangles, as many as asked for, that fill the crown of any
    /// model alike; otherwise those that it has, of four.
    bool full = false;
};
/// What files are written of.
inline constexpr std::array<SpecimenDetail, 3> kFileDetails{
    {{"near", 20'000, 0.0}, {"middle", 2'500, 0.06}, {"far", 300, 0.15}}};

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
    /// 0, 1. One for each detail; those that nobody wanted are empty.
    std::vector<TriMesh> mesh;
};

struct SpecimenParams {
    int variants = 3;              ///< of each kind
    std::vector<int> generations;  ///< ages, ascending
    std::uint64_t seed = 1;        ///< of the first variant
    double leaf_scale = 1;         ///< of full crowns: by which leaves are larger than they are
};

/// A kind by name or .toml file that models can be grown of.
/// @throws InvalidParameter  no such kind; one that grows shoots from many places
tree::Species specimen_kind(const std::string& name);

/// Grows each variant of each kind once through all ages.
/// @param wanted  whether a mesh of this model in this detail is to be made; empty: all
/// @return models in the order (kind * variants + variant) * ages + age, all of them
///
/// Bit-identical for any number of threads.
std::vector<Specimen> grow_specimens(
    const std::vector<tree::Species>& kinds, const SpecimenParams& params,
    std::span<const SpecimenDetail> details = {},
    const std::function<bool(std::size_t model, std::size_t detail)>& wanted = {},
    const Progress& progress = {});

}  // namespace sekitei::apps
