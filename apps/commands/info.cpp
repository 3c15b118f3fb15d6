#include <fmt/format.h>

#include "apps/commands/commands.h"
#include "core/error.h"
#include "core/mesh_io.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

Json bounds_json(Vec3d lower, Vec3d upper)
{
    return {{lower.x, lower.y, lower.z}, {upper.x, upper.y, upper.z}};
}

Json describe_scene(const std::string& file)
{
    const VdbFileInfo info = inspect_vdb(file);
    Json json = {
        {"file", file}, {"bytes", info.bytes}, {"uuid", info.uuid}, {"creator", info.creator}};
    if (info.domain.dims.x > 0)
        json["domain"] = {{"dims", {info.domain.dims.x, info.domain.dims.y, info.domain.dims.z}},
                          {"voxel_m", info.domain.transform.voxel}};
    json["grids"] = Json::array();
    for (const VdbGridInfo& g : info.grids) {
        Json entry = {{"name", g.name},
                      {"type", g.type},
                      {"class", g.grid_class},
                      {"unit", g.unit},
                      {"stage", g.stage},
                      {"hash", g.hash},
                      {"active_voxels", g.active_voxels},
                      {"bytes_on_disk", g.bytes_on_disk},
                      {"bytes_in_memory", g.memory},
                      {"voxel_m", g.voxel},
                      {"points", g.points}};
        if (g.active_voxels > 0) entry["bounds_m"] = bounds_json(g.lower, g.upper);
        json["grids"].push_back(std::move(entry));
    }
    json["history"] = Json::array();
    for (const HistoryEntry& h : info.history)
        json["history"].push_back({{"stage", h.stage},
                                   {"version", h.version},
                                   {"seed", h.seed},
                                   {"params", h.params},
                                   {"inputs", h.inputs}});
    return json;
}

Json describe_mesh(const std::string& file)
{
    MeshReadReport report;
    const TriMesh mesh = read_mesh(file, &report);
    const MeshReport r = inspect(mesh);
    const Bounds b = mesh.bounds();
    return {{"file", file},
            {"vertices", r.vertices},
            {"triangles", r.triangles},
            {"closed", r.closed()},
            {"open_edges", r.open_edges},
            {"non_manifold_edges", r.non_manifold_edges},
            {"pieces", r.pieces},
            {"volume_m3", r.volume},
            {"area_m2", r.area},
            {"bounds_m", bounds_json(b.lower, b.upper)},
            {"warnings", report.warnings}};
}

std::string scene_text(const Json& j)
{
    std::string text =
        fmt::format("{}  {}\n", j["file"].get<std::string>(), bytes_text(j["bytes"].get<double>()));
    if (j.contains("domain"))
        text += fmt::format("box {} x {} x {} voxels of {} m\n", j["domain"]["dims"][0].get<int>(),
                            j["domain"]["dims"][1].get<int>(), j["domain"]["dims"][2].get<int>(),
                            j["domain"]["voxel_m"].get<double>());
    text += fmt::format("\n{:<26} {:<8} {:<12} {:>14} {:>10} {:>10} {:>8}  {:<6} {}\n", "grid",
                        "type", "class", "active voxels", "on disk", "in memory", "voxel m", "unit",
                        "bounds m");
    for (const Json& g : j["grids"]) {
        std::string bounds;
        if (g.contains("bounds_m")) {
            const auto lower = g["bounds_m"][0].get<std::vector<double>>(),
                       upper = g["bounds_m"][1].get<std::vector<double>>();
            bounds = fmt::format("{:.4g},{:.4g},{:.4g} to {:.4g},{:.4g},{:.4g}", lower[0], lower[1],
                                 lower[2], upper[0], upper[1], upper[2]);
        }
        text += fmt::format("{:<26} {:<8} {:<12} {:>14} {:>10} {:>10} {:>8.4g}  {:<6} {}\n",
                            g["name"].get<std::string>(),
                            g["points"].get<bool>() ? "points" : g["type"].get<std::string>(),
                            g["class"].get<std::string>(), g["active_voxels"].get<std::uint64_t>(),
                            bytes_text(g["bytes_on_disk"].get<double>()),
                            bytes_text(g["bytes_in_memory"].get<double>()),
                            g["voxel_m"].get<double>(), g["unit"].get<std::string>(), bounds);
    }
    if (!j["history"].empty()) text += "\nhistory\n";
    for (const Json& h : j["history"]) {
        text += fmt::format("  {} (version {}, seed {})\n", h["stage"].get<std::string>(),
                            h["version"].get<std::string>(), h["seed"].get<std::uint64_t>());
        std::string line = "   ";
        for (const auto& [name, value] : h["params"].items()) {
            if (value.is_null() || value == "") continue;
            const std::string part = fmt::format(
                " {}={}", name, value.is_string() ? value.get<std::string>() : value.dump());
            if (line.size() + part.size() > 110) {
                text += line + "\n";
                line = "   ";
            }
            line += part;
        }
        text += line + "\n";
    }
    return text;
}

}  // namespace

int command_info(const std::vector<std::string>& files, const Common& common)
{
    Json all = Json::array();
    for (const std::string& file : files) {
        const bool scene = std::filesystem::path(file).extension() == ".vdb";
        const Json json = scene ? describe_scene(file) : describe_mesh(file);
        if (common.json)
            all.push_back(json);
        else if (scene)
            print(scene_text(json));
        else
            print(
                fmt::format("{}\n{} vertices, {} triangles, {} pieces, {}, volume {:.6g} m^3, area "
                            "{:.6g} m^2\n",
                            file, json["vertices"].get<std::size_t>(),
                            json["triangles"].get<std::size_t>(), json["pieces"].get<std::size_t>(),
                            json["closed"].get<bool>()
                                ? std::string("closed")
                                : fmt::format("{} open edges, {} non-manifold edges",
                                              json["open_edges"].get<std::size_t>(),
                                              json["non_manifold_edges"].get<std::size_t>()),
                            json["volume_m3"].get<double>(), json["area_m2"].get<double>()));
    }
    if (common.json) print(all.dump(2) + "\n");
    return 0;
}

}  // namespace sekitei::apps
