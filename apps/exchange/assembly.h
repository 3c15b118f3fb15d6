#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "apps/stages/forest_scenery.h"
#include "core/mesh.h"
#include "core/progress.h"
#include "grids/scene.h"

/// What other programs can draw of a scene: surfaces, and prototypes with the places of their
/// copies. Nothing is copied out: a plant is a row of the scene's points until it is written.
namespace sekitei::apps {

/// How fine the models of forest trees are, see kFileDetails.
enum class TreeDetail { Near, Middle, Far };
constexpr std::array<std::string_view, 3> choice_names(TreeDetail)
{
    return {"near", "middle", "far"};
}

struct AssemblyOptions {
    TreeDetail trees = TreeDetail::Far;
    int moss_lod = 1;                 ///< 0 finest .. 2, see render::TuftModel
    Season season = Season::Auto;     ///< of leaves
    double leaf_scale = 1;            ///< by which leaves are larger than they are
    std::optional<double> tuft_size;  ///< [m]; auto: as `render` chooses it
    bool fields = true;               ///< sample the fields of surface cells at vertices
    std::uint64_t seed = 1;           ///< of which sibling stands for which plant
    double memory_limit = 0;          ///< bytes, 0: none
};

/// A surface in one colour, as glTF and USD know it: linear, metallic 0.
struct SurfaceMaterial {
    std::string name;  ///< rock, ground, water, wood, bark, leaf_KIND, moss_SPECIES
    Vec3f colour{0.5f};
    float roughness = 1;
    bool double_sided = false;
};

/// A mesh of the scene in world space.
struct Surface {
    std::string name;  ///< rock, ground, water, obstacle, bark, or that of a mesh given besides
    std::string kind;  ///< rock, ground, water, obstacle, bark or leaves
    std::size_t material = 0;
    TriMesh own;                     ///< where it was made for the assembly
    const TriMesh* given = nullptr;  ///< where it is the scene's; else null
    /// Fields of the grids at each vertex, besides the attributes of the mesh. Where no cell is
    /// near, the mean of the nearest vertices that know one.
    std::map<std::string, std::vector<float>> fields;

    const TriMesh& mesh() const { return given ? *given : own; }
};

/// What a scalar of surfaces or copies is.
struct FieldInfo {
    std::string name;          ///< of the grid or attribute
    std::string unit;          ///< empty: none, or not known
    double low = 0, high = 0;  ///< of all surfaces that have it
};

/// A piece of a prototype in one material.
struct PrototypePart {
    TriMesh mesh;  ///< in its own space; `normal` and `color` may be among the vertex attributes
    std::size_t material = 0;
};

/// A mesh that stands in many places. Mosses grow along +y in their own space and are about 1
/// across, trees along +z and are 1 high, leaves have +y along them, +z on their upper side and an
/// area of 1.
struct CopiedModel {
    std::string name;     ///< bryum_0_lod1, beech_1_22_far, cherry
    std::string species;  ///< bryum, beech, cherry
    std::vector<PrototypePart> parts;
};

/// Where a copy stands: world = position + orient * (scale * local), z up.
struct Placement {
    Vec3d position;
    std::array<float, 4> orient{0, 0, 0, 1};  ///< x y z w, unit
    Vec3f scale{1};
};

/// All copies of one sort: `moss`, `forest` or `leaves`.
struct CopySet {
    std::string name;
    std::vector<CopiedModel> prototypes;
    /// Rows of `points` by prototype: of p they are order[first[p]] .. order[first[p + 1] - 1],
    /// ascending. Rows that are nowhere in it are not drawn (plants of size 0).
    std::vector<std::uint32_t> order, first;
    const Points* points = nullptr;  ///< of the scene, which must outlive this
    double size = 1;                 ///< scale is this times `scale` or `pscale`
    /// Orientations where they are not those of the points; one a row, or none at all.
    std::vector<std::array<float, 4>> turned;

    struct Column {
        FieldInfo info;
        const Points::Attribute* values = nullptr;  ///< floats or int32
    };
    std::vector<Column> columns;  ///< numbers of each copy: species, growth, age, height ...

    Placement at(std::size_t row) const;
    std::int64_t id(std::size_t row) const;  ///< the attribute `id`, or the row
    std::size_t count() const { return order.size(); }

    /// Found by assemble().
    const std::vector<std::array<float, 4>>* orient = nullptr;
    const std::vector<Vec3f>*scale = nullptr, *normal = nullptr;
    const std::vector<float>* pscale = nullptr;
    const std::vector<std::int64_t>* ids = nullptr;
};

struct Assembly {
    std::vector<SurfaceMaterial> materials;
    std::vector<Surface> surfaces;
    std::vector<CopySet> sets;
    std::vector<std::string> species;         ///< of moss, by number
    std::map<std::string, FieldInfo> fields;  ///< of surfaces, by attribute

    std::size_t triangles() const;  ///< of surfaces and prototypes, each once
    std::size_t copies() const;
    Bounds bounds() const;  ///< of surfaces and the feet of copies
};

/// Names of points, meshes and special grids that an assembly looks for; every grid on surface
/// cells counts as well.
std::vector<std::string> assembly_uses();

/// Gathers rock (the mesh `rock`, or the surface of `density` or `surface_sdf`), `ground`, `water`,
/// `obstacle`, `bark`, moss, forest and leaves.
///
/// @param scene   must outlive the result and stay as it is
/// @param meshes  further ones by name, taken over; "rock" stands in for the scene's own
/// @throws InvalidInput  nothing to draw, with what the scene has; points that are not sound
/// @throws LimitExceeded
///
/// Bit-identical for any number of threads.
Assembly assemble(const Scene& scene, const AssemblyOptions& options = {},
                  const Progress& progress = {},
                  std::vector<std::pair<std::string, TriMesh>> meshes = {});

/// Takes a file piece by piece, in order.
using Sink = std::function<void(std::string_view)>;

/// glTF 2.0, binary, y up: surfaces as nodes, copies by EXT_mesh_gpu_instancing. What stands in it
/// is told by docs/exchange.md. Memory does not grow with the number of copies.
/// @throws LimitExceeded  more than 4.29 GB
void write_glb(const Assembly& assembly, const Sink& sink, const Progress& progress = {});
std::string encode_glb(const Assembly& assembly, const Progress& progress = {});

/// USD as text: meshes with primvars, and a PointInstancer for each set with its prototypes.
void write_usda(const Assembly& assembly, const Sink& sink, const Progress& progress = {});

/// A row for each copy of each set: set, prototype, id, P, orient, scale, pscale and what else the
/// points know.
void write_instances_csv(const Assembly& assembly, const Sink& sink, const Progress& progress = {});

/// Surfaces as objects with a group for each column; copies are left out. Materials go into a file
/// of their own, `materials` as it is named in the text.
void write_obj(const Assembly& assembly, const std::string& materials, const Sink& sink,
               const Progress& progress = {});
std::string obj_materials(const Assembly& assembly);

/// All surfaces as one mesh with all fields; `part` (int32, of faces) tells them apart.
TriMesh joined_surfaces(const Assembly& assembly);

}  // namespace sekitei::apps
