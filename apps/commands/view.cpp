#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <map>
#include <optional>

#include "apps/commands/commands.h"
#include "apps/console.h"
#include "apps/exchange/assembly.h"
#include "apps/page.h"
#include "apps/stage.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/json.h"
#include "core/log.h"
#include "core/mesh_io.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

/// What the words of the command line stand for.
struct Shown {
    std::vector<fs::path> scenes;  ///< moments, in order; or one that explains `picture`
    fs::path picture;              ///< a .glb; empty: made from the scenes
    std::vector<fs::path> meshes;  ///< further surfaces
    fs::path output;               ///< where the page goes unless -o says otherwise
    std::string title;
};

/// "moss.0030.vdb" is moment 30 of "moss".
struct Numbered {
    std::string stem;
    int number = 0;
};
std::optional<Numbered> numbered(const fs::path& file)
{
    const std::string stem = file.stem().string();
    const std::size_t dot = stem.rfind('.');
    if (dot == std::string::npos || dot == 0 || stem.size() < dot + 5) return {};
    int number = 0;
    const auto [end, error] =
        std::from_chars(stem.data() + dot + 1, stem.data() + stem.size(), number);
    if (error != std::errc{} || end != stem.data() + stem.size() || number < 0) return {};
    return Numbered{stem.substr(0, dot), number};
}

bool has_climate(const fs::path& scene)
{
    for (const VdbGridInfo& grid : inspect_vdb(scene).grids)
        if (grid.name == "surf_area" || (grid.points && grid.name == "sites")) return true;
    return false;
}

/// Whether a .glb is one that holds a whole scene, not a mesh alone.
bool whole_scene(const fs::path& glb)
{
    const Json json = check_glb(read_file(glb), glb.string());
    const Json asset = json.value("asset", Json::object());
    return asset.is_object() && asset.contains("extras") && asset["extras"].is_object() &&
           asset["extras"].contains("sekitei");
}

/// What a folder made by `run` or `export` shows: its longest sequence of scenes, else its last
/// .glb of a whole scene, explained by the last scene with a climate, else its last scene.
Shown shown_of_folder(const fs::path& folder)
{
    const fs::path manifest = folder / "manifest.json";
    if (!fs::is_regular_file(manifest))
        throw InvalidInput(
            fmt::format("{}: no manifest.json in it; `sekitei run` and `sekitei export` leave one "
                        "in their output folders, or name scenes (.vdb) or a .glb",
                        folder.string()));
    const Json json = parse_json(read_file(manifest, 1u << 28), false);
    if (!json.is_object() || !json.contains("outputs") || !json["outputs"].is_array())
        throw InvalidInput(
            fmt::format("{}: not a manifest, it has no list `outputs`", manifest.string()));
    std::vector<fs::path> scenes, pictures;
    std::map<std::string, std::map<int, fs::path>> sequences;
    for (const Json& output : json["outputs"]) {
        if (!output.is_object() || !output.contains("path") || !output["path"].is_string())
            throw InvalidInput(fmt::format("{}: an output without path", manifest.string()));
        const fs::path file = folder / output["path"].get<std::string>();
        const std::string suffix = file.extension().string();
        if (suffix != ".vdb" && suffix != ".glb") continue;
        if (!fs::is_regular_file(file))
            throw InvalidInput(fmt::format("{} names {}, which is missing; make it again",
                                           manifest.string(), output["path"].get<std::string>()));
        if (suffix == ".glb")
            pictures.push_back(file);
        else if (const auto moment = numbered(file))
            sequences[moment->stem][moment->number] = file;
        else
            scenes.push_back(file);
    }
    Shown shown;
    const fs::path named = fs::absolute(folder).lexically_normal();
    shown.title = (named.has_filename() ? named : named.parent_path()).filename().string();
    shown.output = folder / "view.html";
    std::size_t most = 1;
    for (const auto& [stem, moments] : sequences)
        if (moments.size() > most) {
            most = moments.size();
            shown.scenes.clear();
            for (const auto& [number, file] : moments) shown.scenes.push_back(file);
        }
    if (!shown.scenes.empty()) return shown;
    for (auto picture = pictures.rbegin(); picture != pictures.rend(); ++picture)
        if (whole_scene(*picture)) {
            shown.picture = *picture;
            break;
        }
    for (auto scene = scenes.rbegin(); scene != scenes.rend() && shown.scenes.empty(); ++scene)
        if (has_climate(*scene)) shown.scenes = {*scene};
    if (shown.picture.empty()) {
        if (!scenes.empty()) shown.scenes = {scenes.back()};
        if (scenes.empty() && !pictures.empty()) shown.picture = pictures.back();
    }
    if (shown.picture.empty() && shown.scenes.empty())
        throw InvalidInput(fmt::format("{} names no scene (.vdb) and no .glb: nothing to show",
                                       manifest.string()));
    return shown;
}

Shown shown_of(const std::vector<std::string>& inputs)
{
    if (inputs.empty())
        throw InvalidParameter(
            "view: of what? give a folder with manifest.json, scenes (.vdb) or a .glb");
    const fs::path first = inputs.front();
    if (inputs.size() == 1 && fs::is_directory(first)) return shown_of_folder(first);
    if (inputs.size() == 1 && first.filename() == "manifest.json")
        return shown_of_folder(first.has_parent_path() ? first.parent_path() : fs::path("."));
    Shown shown;
    for (const std::string& input : inputs) {
        const fs::path file = input;
        const std::string suffix = file.extension().string();
        if (fs::is_directory(file))
            throw InvalidParameter(
                fmt::format("view {}: a folder goes by itself, without other inputs", input));
        if (suffix == ".vdb")
            shown.scenes.push_back(file);
        else if (suffix == ".glb") {
            if (!shown.picture.empty())
                throw InvalidParameter(
                    fmt::format("view {} {}: one .glb is enough", shown.picture.string(), input));
            shown.picture = file;
        } else if (suffix == ".ply" || suffix == ".obj" || suffix == ".stl" || suffix == ".off")
            shown.meshes.push_back(file);
        else
            throw InvalidParameter(fmt::format(
                "view {}: takes a folder with manifest.json, scenes (.vdb), a .glb and meshes "
                "(.ply .obj .stl .off)",
                input));
        if (!fs::is_regular_file(file)) throw InvalidInput(fmt::format("{}: no such file", input));
    }
    if (!shown.picture.empty() && (shown.scenes.size() > 1 || !shown.meshes.empty()))
        throw InvalidParameter(
            fmt::format("view {}: a .glb is shown as it is, with one scene (.vdb) that explains it "
                        "at the most",
                        shown.picture.string()));
    if (shown.picture.empty() && shown.scenes.empty())
        throw InvalidParameter(
            fmt::format("view {}: a mesh by itself has nothing to explain; "
                        "`sekitei export {} --to scene.glb` first",
                        inputs.front(), inputs.front()));
    const fs::path main = shown.picture.empty() ? shown.scenes.front() : shown.picture;
    const auto moment = numbered(main);
    shown.title = moment ? moment->stem : main.stem().string();
    shown.output = main.parent_path() / (shown.title + ".html");
    return shown;
}

/// The mesh that a scene is about: beside it, or beside the scene that its sequence ends with.
fs::path mesh_of(const fs::path& scene)
{
    fs::path beside = fs::path(scene).replace_extension(".ply");
    if (fs::exists(beside)) return beside;
    const auto moment = numbered(scene);
    const fs::path last = moment ? scene.parent_path() / (moment->stem + ".ply") : fs::path();
    if (moment && fs::exists(last)) return last;
    throw InvalidInput(
        fmt::format("{}: it is about a mesh, which should lie beside it as {}, where there is none",
                    scene.string(), beside.string()));
}

/// "day 30"
std::string label_of(const Scene& scene, const fs::path& file)
{
    const auto moment = numbered(file);
    if (!moment) return file.stem().string();
    const std::string stage = scene.history.empty() ? "" : scene.history.back().stage;
    const char* word = stage == "moss"     ? "day "
                       : stage == "soil"   ? "day "
                       : stage == "tree"   ? "generation "
                       : stage == "forest" ? "step "
                                           : "";
    return fmt::format("{}{}", word, moment->number);
}

}  // namespace

int command_view(const std::vector<std::string>& inputs, int moss_lod, const Common& common)
{
    const Shown shown = shown_of(inputs);
    if (common.output.size() > 1) throw InvalidParameter("view: writes one page; give one -o");
    const fs::path target = common.output.empty() ? shown.output : fs::path(common.output.front());
    if (target.extension() != ".html" && target.extension() != ".htm")
        throw InvalidParameter(fmt::format("-o {}: `view` writes .html", target.string()));
    check_target(target);
    if (!common.force && fs::exists(target))
        throw InvalidParameter(fmt::format("{} exists; replace it with --force", target.string()));

    const Progress progress = console_progress("view");
    ReadOptions options;
    options.memory_limit = common.memory_limit;
    Page page(shown.title);
    // Names as the commands that the page shows take them.
    auto explain = [&](const Scene& scene, const fs::path& file) {
        const bool sites = scene.points.contains("sites");
        if (!sites &&
            !(scene.has("surface_sdf") && scene.has("surf_normal") && scene.has("surf_area")))
            return;
        page.explain(Explainer(scene, file.string(), sites), file.string(), progress);
    };
    if (!shown.picture.empty()) {
        page.add(shown.picture.stem().string(), shown.picture.string(),
                 read_file(shown.picture, 1ull << 32, progress), progress);
        if (!shown.scenes.empty())
            explain(read_vdb(shown.scenes.front(), options, progress), shown.scenes.front());
    } else
        for (const fs::path& file : shown.scenes) {
            Scene scene = read_vdb(file, options, progress);
            auto load = [&](const fs::path& path) {
                MeshReadReport report;
                TriMesh mesh = read_mesh(path, &report);
                log_mesh_report(path, report);
                return mesh;
            };
            if (scene.points.contains("sites") && !scene.meshes.contains("rock"))
                scene.meshes["rock"] = load(mesh_of(file));
            std::vector<std::pair<std::string, TriMesh>> meshes;
            for (const fs::path& mesh : shown.meshes)
                meshes.emplace_back(mesh.stem().string(), load(mesh));
            AssemblyOptions how;
            how.moss_lod = moss_lod;
            how.memory_limit = common.memory_limit;
            std::string glb;
            try {
                glb = encode_glb(assemble(scene, how, progress, std::move(meshes)), progress);
            } catch (const InvalidInput& error) {
                throw named_after(file.string(), error);
            }
            page.add(label_of(scene, file), file.string(), glb, progress);
            explain(scene, file);
        }
    const std::string html = page.html();
    write_file(target, html, progress);
    clear_progress_line();
    log::info("wrote {}, {}: open it in a browser", target.string(),
              bytes_text(static_cast<double>(html.size())));
    if (common.json)
        print(Json{{"page", target.string()}, {"bytes", html.size()}, {"moments", page.frames()}}
                  .dump(2) +
              "\n");
    return 0;
}

}  // namespace sekitei::apps
