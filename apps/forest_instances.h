#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"
#include "grids/scene.h"
#include "solvers/forest/instances.h"

/// Trees of a forest as points of scenes and as files for other programs.
namespace sekitei::apps {

/// Points with `orient`, `scale`, `pscale`, `id`, `height`, `crown_radius`, `cone_radius`, `R`,
/// `species`, `variant`, `age`, `model`.
Points instance_points(std::span<const forest::Instance> instances, const std::string& stage);
/// Back again, as exactly as single precision allows.
/// @param name  of the points, for messages
/// @throws InvalidInput  an attribute is missing
std::vector<forest::Instance> instances_of(const Points& points, const std::string& name);

/// All instances of a forest, block after block; asked once or more, the same every time.
using InstanceBlocks =
    std::function<void(const std::function<void(std::span<const forest::Instance>)>& take)>;

/// @name Files piece by piece: the header, then rows
/// PLY: little-endian; x y z as double, orient_x .. orient_w, scale_x .. scale_z, pscale as float,
/// id_high and id_low as uint (PLY knows no 64 bits), height, crown_radius, cone_radius, R as
/// float, species, variant, age, model as int. CSV: the same by name, each number as short as it
/// can be read back.
std::string instance_ply_header(std::uint64_t count);
void append_ply(std::string& bytes, std::span<const forest::Instance> instances);
std::string instance_csv_header();
void append_csv(std::string& text, std::span<const forest::Instance> instances);

/// What a USD file shows in a model's place; the names of its prims come from it.
struct Prototype {
    std::string name;               ///< such as beech_0_22; other characters become _
    const TriMesh* mesh = nullptr;  ///< height 1; null or empty: a plain shape of this crown
    double crown_radius = 0.3, crown_base = 0.3;  ///< in heights
};
/// USD as text: a PointInstancer `forest` with its prototypes below it, metres, z up. Positions are
/// relative to `corner`, so that single precision is enough; ids are the lower 63 bits of
/// numbers of trees; primvars height and species.
/// @param prototypes  by Instance::model
/// @throws InvalidInput  an instance of a model that is not there
void write_usda(const InstanceBlocks& instances, std::span<const Prototype> prototypes,
                Vec3d corner, const std::function<void(std::string_view)>& write,
                const Progress& progress = {});

/// A whole .ply, .csv or .usda file, block by block; memory does not grow with it.
/// @param count  of all blocks
/// @throws InvalidParameter  another suffix
/// @throws IoError
void write_instances(const std::filesystem::path& file, std::uint64_t count,
                     const InstanceBlocks& instances, std::span<const Prototype> prototypes,
                     Vec3d corner, const Progress& progress = {});

}  // namespace sekitei::apps
