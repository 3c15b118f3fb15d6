#include <fmt/format.h>

#include "apps/commands/commands.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
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

Json points_json(const std::string& file, std::size_t bytes, const PointsReport& r)
{
    Json json = {{"file", file},
                 {"bytes", bytes},
                 {"points", r.points},
                 {"attributes", Json::array()},
                 {"warnings", r.warnings}};
    Vec3d lower, upper;
    int axes = 0;
    for (const PointsReport::Property& p : r.properties) {
        const bool any = p.least <= p.most;
        const std::size_t axis = p.name.size() == 1 ? std::string("xyz").find(p.name) : 3;
        if (axis < 3) {
            if (!any) continue;
            lower[int(axis)] = p.least;
            upper[int(axis)] = p.most;
            ++axes;
            continue;
        }
        Json entry = {{"name", p.name}, {"type", p.type}};
        if (any) entry["min"] = p.least, entry["max"] = p.most;
        if (p.not_finite > 0) entry["not_finite"] = p.not_finite;
        json["attributes"].push_back(std::move(entry));
    }
    if (axes == 3) json["bounds_m"] = bounds_json(lower, upper);
    return json;
}

/// A mesh, or points in a PLY file.
Json describe_shape(const std::string& file)
{
    const std::string bytes = read_file(file);
    if (const auto points = describe_points(bytes, file))
        return points_json(file, bytes.size(), *points);
    MeshReadReport report;
    const TriMesh mesh = decode_mesh(bytes, file, &report);
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

std::string bounds_text(const Json& bounds)
{
    const auto lower = bounds[0].get<std::vector<double>>(),
               upper = bounds[1].get<std::vector<double>>();
    return fmt::format("{:.4g},{:.4g},{:.4g} to {:.4g},{:.4g},{:.4g}", lower[0], lower[1], lower[2],
                       upper[0], upper[1], upper[2]);
}

std::string points_text(const Json& j)
{
    std::string text =
        fmt::format("{}  {}\n{} points", j["file"].get<std::string>(),
                    bytes_text(j["bytes"].get<double>()), j["points"].get<std::uint64_t>());
    if (j.contains("bounds_m")) text += fmt::format(", {} m", bounds_text(j["bounds_m"]));
    text += '\n';
    if (!j["attributes"].empty())
        text += fmt::format("\n{:<20} {:<8} {:>14} {:>14}\n", "attribute", "type", "min", "max");
    for (const Json& a : j["attributes"]) {
        auto number = [&](const char* key) {
            return a.contains(key) ? fmt::format("{:.7g}", a[key].get<double>()) : "none";
        };
        text += fmt::format("{:<20} {:<8} {:>14} {:>14}", a["name"].get<std::string>(),
                            a["type"].get<std::string>(), number("min"), number("max"));
        if (a.contains("not_finite"))
            text += fmt::format("  {} are not finite", a["not_finite"].get<std::uint64_t>());
        text += '\n';
    }
    for (const Json& warning : j["warnings"]) log::warning("{}", warning.get<std::string>());
    return text;
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
        const std::string bounds = g.contains("bounds_m") ? bounds_text(g["bounds_m"]) : "";
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
        const Json json = scene ? describe_scene(file) : describe_shape(file);
        if (common.json)
            all.push_back(json);
        else if (scene)
            print(scene_text(json));
        else if (json.contains("points"))
            print(points_text(json));
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
