#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "apps/exchange/assembly.h"
#include "core/image.h"

/// The files that a scene is exported to.
namespace sekitei::apps {

/// A field seen from above, north up.
struct FieldMap {
    Image16 picture;
    /// What its greys mean: field, unit, low, high, first (the grey of `low`; below it nothing
    /// was seen), metres_per_pixel, corner (of its south-western pixel), up.
    Json notes;
};
/// "height" and the fields that a map can show.
std::vector<std::string> map_names(const Scene& scene, const Assembly& assembly);
/// Of a grid that is one voxel high, in its own pixels; else of the highest surface of rock, ground
/// or obstacle in each pixel.
/// @param metres_per_pixel  auto: a 1024th of the longer side
/// @throws InvalidParameter  no such field; InvalidInput  nothing is seen from above
/// @throws LimitExceeded  more than 16384 pixels along a side
FieldMap make_map(const Scene& scene, const Assembly& assembly, const std::string& name,
                  const std::optional<double>& metres_per_pixel, const Progress& progress = {});

/// What a file is, chosen by its suffix.
enum class ExportKind {
    Glb,
    Usda,
    Instances,
    Obj,
    Materials,
    MeshPly,
    PointsPly,
    Map,
    MapNotes,
    Vdb
};

struct ExportFile {
    std::filesystem::path path;
    ExportKind kind = ExportKind::Glb;
    std::string of;  ///< points or field, where it is one of them
};
/// Suffixes that can be asked for; those of files that come beside them follow.
inline constexpr std::array<std::string_view, 7> kExportSuffixes{".glb", ".usda", ".csv", ".obj",
                                                                 ".ply", ".png",  ".vdb"};
inline constexpr std::array<std::string_view, 2> kBesideSuffixes{".mtl", ".json"};

/// The file and what belongs beside it: x.obj brings x.mtl, x.png x.json.
/// @param points  of which .ply is; empty: the surfaces
/// @param map     what .png shows
/// @throws InvalidParameter  a suffix that nothing is written for
std::vector<ExportFile> files_of(const std::filesystem::path& path, const std::string& points,
                                 const std::string& map);

/// Whether it shows what can be drawn, and so needs an assembly.
bool wants_assembly(ExportKind kind);

struct ExportOptions {
    AssemblyOptions assembly;
    std::optional<double> metres_per_pixel;
    bool half = false;  ///< 16-bit floats in .vdb
};

/// Writes one file, whole or not at all.
/// @param assembly  null where the kind wants none
void write_export(const ExportFile& file, const Scene& scene, const Assembly* assembly,
                  const ExportOptions& options, const Progress& progress);

}  // namespace sekitei::apps
