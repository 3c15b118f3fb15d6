#include "apps/exchange/files.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/mesh_io.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

/// A file whose pieces come one after the other.
template <class F>
void stream(const fs::path& path, F&& write)
{
    AtomicFile file(path);
    write([&](std::string_view part) { file.write(part); });
    file.commit();
}

}  // namespace

std::vector<ExportFile> files_of(const fs::path& path, const std::string& points,
                                 const std::string& map)
{
    const std::string suffix = path.extension().string();
    auto beside = [&](const char* other) { return fs::path(path).replace_extension(other); };
    if (suffix == ".glb") return {{path, ExportKind::Glb, ""}};
    if (suffix == ".usda") return {{path, ExportKind::Usda, ""}};
    if (suffix == ".csv") return {{path, ExportKind::Instances, ""}};
    if (suffix == ".obj")
        return {{path, ExportKind::Obj, ""}, {beside(".mtl"), ExportKind::Materials, ""}};
    if (suffix == ".ply")
        return {{path, points.empty() ? ExportKind::MeshPly : ExportKind::PointsPly, points}};
    if (suffix == ".png")
        return {{path, ExportKind::Map, map}, {beside(".json"), ExportKind::MapNotes, map}};
    if (suffix == ".vdb") return {{path, ExportKind::Vdb, ""}};
    throw InvalidParameter(fmt::format("{}: export writes {} or a folder, its name ending in /",
                                       path.string(), fmt::join(kExportSuffixes, ", ")));
}

bool wants_assembly(ExportKind kind)
{
    return kind != ExportKind::PointsPly && kind != ExportKind::Vdb;
}

void write_export(const ExportFile& file, const Scene& scene, const Assembly* assembly,
                  const ExportOptions& options, const Progress& progress)
{
    auto copies_left_out = [&] {
        if (assembly->copies() > 0)
            log::info(
                "{}: {} copies of plants are left out, the format knows none; see .csv, "
                ".usda or .glb",
                file.path.string(), assembly->copies());
    };
    auto surfaces_only = [&] {
        if (assembly->surfaces.empty())
            throw InvalidInput(fmt::format("export: {}: the scene has plants alone and no surface",
                                           file.path.string()));
        copies_left_out();
    };
    switch (file.kind) {
        case ExportKind::Glb:
            return stream(file.path,
                          [&](const Sink& sink) { write_glb(*assembly, sink, progress); });
        case ExportKind::Usda:
            return stream(file.path,
                          [&](const Sink& sink) { write_usda(*assembly, sink, progress); });
        case ExportKind::Instances:
            if (assembly->sets.empty())
                throw InvalidInput(
                    fmt::format("export: {}: the scene has no moss, forest or leaves to list",
                                file.path.string()));
            return stream(file.path, [&](const Sink& sink) {
                write_instances_csv(*assembly, sink, progress);
            });
        case ExportKind::Obj:
            surfaces_only();
            return stream(file.path, [&](const Sink& sink) {
                write_obj(*assembly,
                          fs::path(file.path).replace_extension(".mtl").filename().string(), sink,
                          progress);
            });
        case ExportKind::Materials:
            return write_file(file.path, obj_materials(*assembly), progress);
        case ExportKind::MeshPly: {
            surfaces_only();
            const Surface& first = assembly->surfaces.front();
            if (assembly->surfaces.size() == 1 && first.fields.empty())
                return write_mesh(file.path, first.mesh(), progress);
            return write_mesh(file.path, joined_surfaces(*assembly), progress);
        }
        case ExportKind::PointsPly:
            return write_file(file.path, encode_points(scene.points_of(file.of), progress),
                              progress);
        case ExportKind::Map:
            return write_file(
                file.path,
                encode_png(make_map(scene, *assembly, file.of, options.metres_per_pixel, progress)
                               .picture),
                progress);
        case ExportKind::MapNotes:
            return write_file(
                file.path,
                make_map(scene, *assembly, file.of, options.metres_per_pixel, progress)
                        .notes.dump(2) +
                    "\n",
                progress);
        case ExportKind::Vdb:
            return write_vdb(file.path, scene, {.half = options.half}, progress);
    }
}

}  // namespace sekitei::apps
