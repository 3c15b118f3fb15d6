#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "core/mesh.h"
#include "core/params.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"

/// What travels between stages: named grids, points and meshes, and how they were made.
namespace sekitei {

enum class GridClass { Unknown, LevelSet, FogVolume };

/// A grid of a type Sekitei does not compute with (foreign files): kept and written back untouched.
/// Defined in grids/vdb_format.h.
struct ForeignGrid;

struct Grid {
    std::variant<FloatGrid, IntGrid, VectorGrid, std::shared_ptr<const ForeignGrid>> values;
    GridClass grid_class = GridClass::Unknown;
    std::string unit;             ///< "K", "m", "" ...
    std::string stage;            ///< the command that made it; empty for foreign grids
    std::string vector_type;      ///< VDB's vec-type for VectorGrid, e.g. "covariant normalize"
    Json extra = Json::object();  ///< further string/number metadata of a foreign grid, kept

    std::string type_name() const;  ///< "float", "int32", "vec3s", or the foreign type
    std::uint64_t active_count() const;
};

/// Points with named attributes; all arrays have the length of `position`.
struct Points {
    using Attribute = std::variant<std::vector<float>, std::vector<double>,
                                   std::vector<std::int32_t>, std::vector<std::int64_t>,
                                   std::vector<Vec3f>, std::vector<std::array<float, 4>>>;
    std::vector<Vec3d> position;  ///< world [m]; kept exactly through files
    std::map<std::string, Attribute> attributes;
    std::string stage;

    /// The attribute of this name if it is there with this type and one value a point, else null.
    template <class T>
    const std::vector<T>* values(const std::string& name) const
    {
        const auto found = attributes.find(name);
        if (found == attributes.end()) return nullptr;
        const auto* list = std::get_if<std::vector<T>>(&found->second);
        return list && list->size() == position.size() ? list : nullptr;
    }
};

/// The same number, and 0 for -0: OpenVDB stores one of them for both where a block of points holds
/// nothing else, so files and hashes know 0 alone.
template <class T>
constexpr T plain_zero(T x)
{
    if constexpr (std::is_floating_point_v<T>)
        return x + T(0);
    else
        return x;
}
template <class T>
constexpr Vec3<T> plain_zero(Vec3<T> v)
{
    return v + Vec3<T>(0);
}
inline std::array<float, 4> plain_zero(const std::array<float, 4>& q)
{
    return {q[0] + 0.0f, q[1] + 0.0f, q[2] + 0.0f, q[3] + 0.0f};
}

/// One command that took part in making a scene.
struct HistoryEntry {
    std::string stage, version;  ///< "joint", "1"
    Json params;                 ///< normalised: params_json()
    std::uint64_t seed = 0;
    Json inputs = Json::object();  ///< hashes of files read: {"terrain.png": "..."}
};

/// See design: one .vdb file, with meshes beside it.
struct Scene {
    Domain domain;       ///< fine voxels; dims 0 for a foreign file
    Domain heat_domain;  ///< the coarse grid over the same box
    std::map<std::string, Grid> grids;
    std::map<std::string, Points> points;
    std::map<std::string, TriMesh> meshes;  ///< not part of the .vdb
    std::vector<HistoryEntry> history;

    bool has(const std::string& name) const { return grids.contains(name); }

    /// The grid of this name and type.
    /// @throws InvalidInput  lists the names present, or the type found and the type wanted
    const FloatGrid& floats(const std::string& name) const;
    const IntGrid& ints(const std::string& name) const;
    const VectorGrid& vectors(const std::string& name) const;
    const Points& points_of(const std::string& name) const;

    void put(const std::string& name, FloatGrid grid, std::string unit, std::string stage,
             GridClass grid_class = GridClass::Unknown);
    void put(const std::string& name, IntGrid grid, std::string stage);
    void put(const std::string& name, VectorGrid grid, std::string unit, std::string stage,
             std::string vector_type);
};

/// Hash of a grid's transform, topology, masks and values (XXH3-128, hexadecimal).
std::string content_hash(const Grid& grid, const Progress& progress = {});
std::string content_hash(const Points& points);

}  // namespace sekitei
