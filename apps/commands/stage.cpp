#include "apps/stage.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <optional>
#include <set>

#include "apps/commands/commands.h"
#include "apps/commands/inputs.h"
#include "apps/console.h"
#include "apps/recipe.h"
#include "apps/runner.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/mesh_io.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

const std::vector<std::string> kMeshSuffixes{".ply", ".obj", ".stl", ".off", ".glb"};

/// Tells a stage what stands in a scene file without rock whose surface could be shown.
void tell_of_trees(Stage& stage, const std::string& name)
{
    if (name == "-" || is_mesh_name(name)) return;
    bool trees = false, forest = false, rock = false;
    for (const VdbGridInfo& grid : inspect_vdb(name).grids) {
        trees = trees || grid.name == "tree_skeleton";
        // A forest out of core has its growth alone.
        forest = forest || grid.name == "forest_instances" || grid.name == "forest_growth";
        rock = rock || grid.name == "surface_sdf" || grid.name == "density";
    }
    stage.meets_trees(trees && !rock);
    stage.meets_forest(forest && !rock);
}

/// Every file that the outputs of the command line stand for.
std::vector<fs::path> targets_of(Stage& stage, const Common& common)
{
    std::vector<fs::path> targets = stage.side_files();
    for (const std::string& name : common.output) {
        targets.emplace_back(name);
        if (makes_mesh(stage) && name != "-" && !is_mesh_name(name))
            targets.push_back(mesh_beside(name));
    }
    return targets;
}

/// A stage that writes a sequence needs a name to number, which none of its scenes has yet.
void check_frames(Stage& stage, const Common& common)
{
    if (stage.frame_interval() == 0) return;
    const fs::path file = common.output.front();
    if (file == "-")
        throw InvalidParameter(
            "--every and --sequence write numbered files beside the result: give a file with -o, "
            "not -");
    if (common.force) return;
    const fs::path folder = file.has_parent_path() ? file.parent_path() : ".";
    const std::string stem = file.stem().string() + ".", suffix = file.extension().string();
    for (const auto& entry : fs::directory_iterator(folder)) {
        const std::string name = entry.path().filename().string();
        if (!name.starts_with(stem) || !name.ends_with(suffix) ||
            name.size() <= stem.size() + suffix.size())
            continue;
        const std::string number =
            name.substr(stem.size(), name.size() - stem.size() - suffix.size());
        if (number.find_first_not_of("0123456789") == std::string::npos)
            throw InvalidParameter(
                fmt::format("{} exists, from an earlier sequence; replace it with --force",
                            (file.has_parent_path() ? folder / name : fs::path(name)).string()));
    }
}

/// Refuses now what could not be written later.
/// @param mesh  whether its result may be a mesh
void check_outputs(Stage& stage, const Common& common, bool mesh)
{
    const StageInfo& info = stage.info();
    if (common.output.empty())
        throw InvalidParameter(fmt::format(
            "{}: say where the result goes with -o FILE (or -o - for standard output)", info.name));
    for (const std::string& name : common.output) {
        if (name == "-") {
            if (common.json) throw InvalidParameter("--json and -o - both want standard output");
            if ((info.output == OutputKind::Scene || info.output == OutputKind::Mesh) &&
                ::isatty(STDOUT_FILENO))
                throw InvalidParameter(
                    "-o - writes binary data: pipe it into another command or a file");
            continue;
        }
        const std::string suffix = fs::path(name).extension().string();
        const bool fits = info.output == OutputKind::Picture  ? suffix == ".png"
                          : info.output == OutputKind::Table  ? suffix == ".csv"
                          : info.output == OutputKind::Points ? suffix == ".ply"
                          : mesh ? is_mesh_name(name) || suffix == ".vdb"
                                 : suffix == ".vdb";
        if (!fits)
            throw InvalidParameter(fmt::format("-o {}: `{}` writes {}", name, info.name,
                                               info.output == OutputKind::Picture  ? ".png"
                                               : info.output == OutputKind::Table  ? ".csv"
                                               : info.output == OutputKind::Points ? ".ply"
                                               : mesh ? ".ply, .obj, .stl, .off, .glb or .vdb"
                                                      : ".vdb"));
    }
    std::set<fs::path> seen;
    for (const fs::path& target : targets_of(stage, common)) {
        if (!seen.insert(target.lexically_normal()).second)
            throw InvalidParameter(
                fmt::format("-o {}: would be written twice{}", target.string(),
                            target.extension() == ".ply"
                                ? "; a scene about a mesh has that beside it, with the scene's name"
                                : ""));
        if (target == "-") continue;
        check_target(target);
        if (!common.force && fs::exists(target))
            throw InvalidParameter(
                fmt::format("{} exists; replace it with --force", target.string()));
    }
}

/// Reads what a stage works on: a scene, and for pictures a mesh file as well.
Scene read_input(Stage& stage, const std::string& name, const Common& common,
                 const Progress& progress)
{
    ReadOptions options;
    options.fix_nan = common.fix_nan;
    options.memory_limit = common.memory_limit;
    const bool passed_on = std::any_of(
        common.output.begin(), common.output.end(),
        [](const std::string& target) { return fs::path(target).extension() == ".vdb"; });
    if (stage.info().output != OutputKind::Scene && !passed_on) {
        // Nothing is passed on, so only what is needed is loaded.
        for (const std::string& need : stage.needs()) {
            if (const std::string hint = maker_hint(need);
                !hint.empty() && name != "-" && !is_mesh_name(name) && need != "rock" &&
                stage.info().output != OutputKind::Mesh) {
                const std::vector<VdbGridInfo> grids = inspect_vdb(name).grids;
                if (std::none_of(grids.begin(), grids.end(),
                                 [&](const VdbGridInfo& grid) { return grid.name == need; })) {
                    std::vector<std::string> present;
                    for (const VdbGridInfo& grid : grids) present.push_back(grid.name);
                    throw InvalidInput(fmt::format("{}: the scene has no '{}', present: {}{}", name,
                                                   need, fmt::join(present, ", "), hint));
                }
            }
            options.only.insert(need);
        }
        for (const std::string& extra : stage.uses()) options.if_there.insert(extra);
        options.keep_foreign = false;
    }
    if (stage.info().output == OutputKind::Mesh && !options.only.empty()) {
        // Attributes come from what is there; a foreign volume has only its own grid.
        if (name == "-")
            options.only.clear();
        else if (!is_mesh_name(name)) {
            std::set<std::string> present;
            for (const VdbGridInfo& grid : inspect_vdb(name).grids) present.insert(grid.name);
            const std::string surface = stage.needs().front();
            std::erase_if(options.only, [&](const std::string& n) {
                return n != surface && !present.contains(n);
            });
        }
    }
    // A picture of a scene file: its surface is extracted on the way.
    const bool picture_of_surface =
        stage.info().output == OutputKind::Picture && options.only.contains("rock");
    auto surface_stage = [](bool density) {
        auto mesh_stage = make_stage("mesh");
        if (!density) find_param(mesh_stage->params(), "grid")->set("surface_sdf");
        return mesh_stage;
    };
    auto with_surface = [&](Scene scene) {
        StageContext context;
        context.progress = console_progress("mesh");
        surface_stage(scene.has("density"))->run(scene, context);
        return scene;
    };
    auto as_mesh = [&](TriMesh mesh) {
        Scene scene;
        scene.meshes["rock"] = std::move(mesh);
        return scene;
    };
    const ParamList params = stage.params();
    const Param* texture = find_param(params, "texture");
    auto load_mesh = [&](const fs::path& path) {
        MeshReadReport report;
        TriMesh mesh = read_mesh(path, &report);
        log_mesh_report(path, report);
        if (texture && texture->get() == "") tell_of_textures(path, report);
        return mesh;
    };
    if (name == "-") {
        std::string start(3, '\0');
        std::size_t got = 0;
        while (got < 3) {
            const ssize_t n = ::read(STDIN_FILENO, start.data() + got, 3 - got);
            if (n <= 0)
                throw InvalidInput(
                    "standard input is empty; expected a scene from another command");
            got += static_cast<std::size_t>(n);
        }
        if (start != "ply") {
            if (picture_of_surface) options.only.clear();
            Scene scene = read_vdb_stream(STDIN_FILENO, options, start, progress);
            if (stage.info().reads_mesh && scene.points.contains("sites"))
                throw InvalidInput(
                    "standard input: the scene is about a mesh, which lies beside its file; give "
                    "the file's name");
            const bool rock = scene.has("density") || scene.has("surface_sdf");
            const bool trees =
                scene.points.contains("tree_skeleton") || scene.points.contains("forest_instances");
            return picture_of_surface && (rock || !trees) ? with_surface(std::move(scene)) : scene;
        }
        std::string bytes = start;
        char block[1 << 16];
        for (ssize_t n; (n = ::read(STDIN_FILENO, block, sizeof block)) > 0;)
            bytes.append(block, static_cast<std::size_t>(n));
        return as_mesh(decode_ply(bytes, "standard input"));
    }
    if (is_mesh_name(name)) {
        if (!stage.info().reads_mesh)
            throw InvalidInput(
                fmt::format("{}: `{}` reads scenes (.vdb); make one with `sekitei lava --preset "
                            "mesh --mesh {}`",
                            name, stage.info().name, name));
        Scene scene = as_mesh(load_mesh(name));
        // As a stage that read it, so that the scene can be made again from its history.
        const auto reader = make_stage("mesh");
        find_param(reader->params(), "file")->set(name);
        StageContext context;
        context.seed = common.seed;
        scene.history.push_back(history_of(*reader, context));
        return scene;
    }
    if (stage.info().reads_mesh && speaks_of_mesh(name)) {
        const fs::path beside = mesh_beside(name);
        if (!fs::exists(beside))
            throw InvalidInput(
                fmt::format("{}: it is about a mesh, which should lie beside it as "
                            "{}, where there is none",
                            name, beside.string()));
        options.only.erase("rock");
        if (stage.info().output == OutputKind::Picture) options.only.insert("sites");
        Scene scene = read_vdb(name, options, progress);
        scene.meshes["rock"] = load_mesh(beside);
        return scene;
    }
    if (picture_of_surface) {
        std::set<std::string> present;
        for (const VdbGridInfo& grid : inspect_vdb(name).grids) present.insert(grid.name);
        options.only.clear();
        const auto surface = surface_stage(present.contains("density"));
        for (const std::string& need : surface->needs()) options.only.insert(need);
        for (const std::string& used : surface->uses()) options.if_there.insert(used);
        return with_surface(read_vdb(name, options, progress));
    }
    return read_vdb(name, options, progress);
}

void write_to_stdout(const std::string& bytes, const Progress& progress)
{
    for (std::size_t done = 0; done < bytes.size();) {
        progress.check();
        const ssize_t n = ::write(STDOUT_FILENO, bytes.data() + done, bytes.size() - done);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0)
            throw IoError(fmt::format("cannot write to standard output: {}", std::strerror(errno)));
        done += static_cast<std::size_t>(n);
    }
}

/// A scene and the mesh beside it.
void write_pair(const std::string& name, const Scene& scene, const Progress& progress)
{
    const fs::path beside = mesh_beside(name);
    write_file_with(
        beside, encode_mesh(scene.meshes.at("rock"), beside.extension().string(), progress),
        [&] { write_vdb(name, scene, {}, progress); }, progress);
}

void write_result(Stage& stage, const Scene& scene, const std::string& name,
                  const Progress& progress)
{
    switch (stage.info().output) {
        case OutputKind::Picture:
            if (name == "-")
                write_to_stdout(encode_png(stage.picture), progress);
            else
                write_png(name, stage.picture);
            return;
        case OutputKind::Table:
        case OutputKind::Points:
            if (name == "-")
                write_to_stdout(stage.table, progress);
            else
                write_file(name, stage.table);
            return;
        case OutputKind::Mesh:
            if (name == "-")
                return write_to_stdout(encode_mesh(scene.meshes.at("rock"), ".ply", progress),
                                       progress);
            if (is_mesh_name(name)) return write_mesh(name, scene.meshes.at("rock"), progress);
            return write_pair(name, scene, progress);
        case OutputKind::Scene:
            if (makes_mesh(stage)) {
                const TriMesh& mesh = scene.meshes.at("rock");
                if (name == "-")
                    return write_to_stdout(encode_mesh(mesh, ".ply", progress), progress);
                if (is_mesh_name(name)) return write_mesh(name, mesh, progress);
                return write_pair(name, scene, progress);
            }
            if (name == "-")
                write_vdb_stream(STDOUT_FILENO, scene, progress);
            else
                write_vdb(name, scene, {}, progress);
    }
}

}  // namespace

bool is_mesh_name(const std::string& name)
{
    const std::string suffix = fs::path(name).extension().string();
    return std::find(kMeshSuffixes.begin(), kMeshSuffixes.end(), suffix) != kMeshSuffixes.end();
}

fs::path mesh_beside(const std::string& scene)
{
    return fs::path(scene).replace_extension(".ply");
}

bool speaks_of_mesh(const std::string& name)
{
    if (name == "-" || is_mesh_name(name)) return false;
    const std::vector<VdbGridInfo> grids = inspect_vdb(name).grids;
    return std::any_of(grids.begin(), grids.end(),
                       [](const VdbGridInfo& grid) { return grid.points && grid.name == "sites"; });
}

int command_stage(const std::string& name, const std::vector<std::string>& inputs,
                  const Words& words, const Common& common)
{
    const auto stage = make_stage(name);
    const ParamList params = stage->params();
    if (!common.params_file.empty()) apply_params_file(common.params_file, params);
    for (const auto& [param, word] : words) {
        try {
            find_param(params, param)->set_text(word);
        } catch (const InvalidParameter& error) {
            throw InvalidParameter(
                fmt::format("{} --{}: {}", name, option_name(param), error.what()));
        }
    }
    // What standard input brings is known only once it is read.
    const bool unknown = stage->info().reads_mesh && !inputs.empty() && inputs.front() == "-";
    if (stage->info().reads_mesh && !inputs.empty() && !unknown)
        stage->meets_mesh(is_mesh_name(inputs.front()) || speaks_of_mesh(inputs.front()));
    if (stage->info().output != OutputKind::Scene && !inputs.empty() && fs::exists(inputs.front()))
        tell_of_trees(*stage, inputs.front());
    stage->validate();
    stage->check_reading();
    if (inputs.empty() && stage->reads_scene())
        throw InvalidParameter(
            fmt::format("{}: which scene? give a .vdb file, or - for standard input", name));
    if (!inputs.empty() && !stage->reads_scene() && !stage->info().reads_if_given)
        throw InvalidParameter(
            fmt::format("{}: reads no scene, but '{}' was given", name, inputs.front()));
    if (inputs.size() > 1 && !stage->info().reads_many)
        throw InvalidParameter(
            fmt::format("{}: reads one scene, but '{}' was given as well", name, inputs[1]));
    check_outputs(*stage, common, unknown || makes_mesh(*stage));
    check_frames(*stage, common);

    StageContext context;
    context.seed = common.seed;
    context.progress = console_progress(name);
    context.memory_limit = common.memory_limit;
    context.fix_nan = common.fix_nan;
    Scene scene;
    std::vector<std::pair<std::string, Scene>> scenes;
    if (stage->info().reads_many)
        for (const std::string& input : inputs)
            scenes.emplace_back(
                fs::path(input).stem().string(),
                read_input(*stage, input, common, context.progress.named("reading")));
    else if (!inputs.empty())
        scene = read_input(*stage, inputs.front(), common, context.progress.named("reading"));
    if (unknown) {
        stage->meets_mesh(scene.meshes.contains("rock"));
        check_outputs(*stage, common, makes_mesh(*stage));
    }
    for (const fs::path& target : targets_of(*stage, common))
        if (target != "-")
            remove_stale_temporaries(target.has_parent_path() ? target.parent_path() : ".");
    const HistoryEntry entry = history_of(*stage, context);
    // A mesh takes what attributes are there, and a picture can be of a volume.
    const bool sure = stage->info().output != OutputKind::Mesh && name != "render";
    if (sure && !stage->info().reads_many && stage->reads_scene()) {
        try {
            require_needs(*stage, scene);
        } catch (const InvalidInput& error) {
            throw inputs.front() == "-" ? error : named_after(inputs.front(), error);
        }
    }
    if (stage->info().output == OutputKind::Scene && common.output.front() != "-")
        context.frame = [&](int number, const Scene& frame) {
            const fs::path file = frame_path(common.output.front(), number);
            check_target(file);
            Scene numbered = frame;
            numbered.history.push_back(entry);
            write_vdb(file, numbered, {}, context.progress.slice(1, 1));
        };
    std::set<std::string> read;
    for (const std::string& used : stage->needs()) read.insert(used);
    for (const std::string& used : stage->uses()) read.insert(used);
    for (const std::string& made : stage->makes()) {  // replaced, or gone if not made this time
        if (stage->info().output != OutputKind::Scene || read.contains(made))
            continue;  // a grid called like the mesh is something else
        scene.grids.erase(made);
        scene.points.erase(made);
    }
    const Json summary = [&] {
        try {
            if (!stage->info().reads_many) return stage->run(scene, context);
            Json numbers = stage->run_many(scenes, context);
            scene = std::move(stage->new_scene);
            return numbers;
        } catch (const InvalidInput& error) {
            if (inputs.empty() || inputs.front() == "-" ||
                blames_own_file(*stage, context, error.what()))
                throw;
            throw named_after(inputs.front(), error);
        }
    }();
    clear_progress_line();
    if (stage->info().output == OutputKind::Scene) scene.history.push_back(entry);

    Json outputs = Json::array();
    for (const std::string& target : common.output) {
        write_result(*stage, scene, target, console_progress(name).named("writing"));
        clear_progress_line();
        if (common.json && target != "-") {
            const auto mesh = scene.meshes.find("rock");
            outputs.push_back(describe_output(
                target, target, name,
                mesh == scene.meshes.end() ? std::optional<Bounds>() : mesh->second.bounds(),
                context.progress));
        }
    }
    if (common.json)
        print(Json{{"stage", name},
                   {"seed", common.seed},
                   {"params", params_json(params)},
                   {"summary", summary},
                   {"outputs", outputs}}
                  .dump(2) +
              "\n");
    if (!stage->stopped.empty()) throw LimitExceeded(stage->stopped);
    return 0;
}

}  // namespace sekitei::apps
