#include "apps/commands/export.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>

#include "apps/commands/inputs.h"
#include "apps/console.h"
#include "apps/exchange/stage.h"
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

bool is_folder(const std::string& name)
{
    std::error_code unknown;
    return name.ends_with('/') || fs::is_directory(name, unknown);
}

TriMesh read_surface(const fs::path& path)
{
    MeshReadReport report;
    TriMesh mesh = read_mesh(path, &report);
    log_mesh_report(path, report);
    return mesh;
}

class Export {
public:
    Export(const std::vector<std::string>& inputs, const std::vector<std::string>& targets,
           const Words& words, const Common& common)
        : common_(common), targets_(targets), stage_(make_exporting_stage())
    {
        const ParamList params = stage_->params();
        if (!common.params_file.empty()) apply_params_file(common.params_file, params);
        for (const auto& [name, word] : words) {
            try {
                find_param(params, name)->set_text(word);
            } catch (const InvalidParameter& error) {
                throw InvalidParameter(
                    fmt::format("export --{}: {}", option_name(name), error.what()));
            }
            // Nobody who says nothing of points wants them in place of the surfaces.
            if (name == "points") points_ = word;
        }
        stage_->validate();
        map_ = find_param(params, "map")->get().get<std::string>();
        for (const std::string& input : inputs)
            (is_mesh_name(input) ? meshes_ : scenes_).push_back(input);
        if (inputs.empty())
            throw InvalidParameter(
                "export: which scene? give a .vdb file, or - for standard input");
        if (std::ranges::count(scenes_, "-") > 0 && inputs.size() > 1)
            throw InvalidParameter("export: - is one scene by itself, without other inputs");
        context_.seed = common.seed;
        context_.progress = console_progress("export");
        context_.memory_limit = common.memory_limit;
        context_.fix_nan = common.fix_nan;
        check_targets();
    }

    Json run()
    {
        for (std::size_t i = 0; i < std::max<std::size_t>(1, scenes_.size()); ++i) {
            const std::string& input = scenes_.empty() ? meshes_.front() : scenes_[i];
            try {
                export_one(input, i);
            } catch (const InvalidInput& error) {
                throw input == "-" ? error : named_after(input, error);
            }
        }
        for (const auto& [folder, entries] : folders_) {
            const fs::path manifest = fs::path(folder) / "manifest.json";
            write_file(manifest,
                       Json{{"sekitei", SEKITEI_VERSION}, {"outputs", entries}}.dump(2) + "\n");
            log::info("wrote {} files into {}", entries.size() + 1, folder);
        }
        return outputs_;
    }

private:
    bool sequence() const { return scenes_.size() > 1; }

    /// Refuses now what could not be written later.
    void check_targets()
    {
        if (targets_.empty())
            throw InvalidParameter(
                "export: say where the result goes with --to FILE or FOLDER/, or points with -o "
                "FILE.ply");
        std::set<fs::path> seen;
        for (const std::string& target : targets_) {
            if (target == "-")
                throw InvalidParameter(
                    "export: --to -: only points go to standard output, with -o -");
            if (is_folder(target)) {
                if (!seen.insert((fs::path(target) / ".").lexically_normal()).second)
                    throw InvalidParameter(fmt::format("--to {}: is given twice", target));
                if (fs::is_directory(target))
                    keep(fs::path(target) / "manifest.json");
                else
                    check_target((fs::path(target) / ".").parent_path());
                folders_[target] = Json::array();
                continue;
            }
            for (std::size_t i = 0; i < std::max<std::size_t>(1, scenes_.size()); ++i)
                for (const ExportFile& file : files_of(numbered(target, i), points_, map_)) {
                    if (!seen.insert(file.path.lexically_normal()).second)
                        throw InvalidParameter(
                            fmt::format("--to {}: would be written twice", file.path.string()));
                    keep(file.path);
                }
        }
        std::set<std::string> stems;
        for (const std::string& input : scenes_)
            if (!folders_.empty() && !stems.insert(stem_of(input)).second)
                throw InvalidParameter(fmt::format(
                    "export: two scenes are called {}, and their files would be", stem_of(input)));
        for (const std::string& input : scenes_)
            if (input != "-" && !fs::exists(input))
                throw InvalidInput(fmt::format("{}: no such file", input));
    }

    void make_folder(const std::string& name) const
    {
        std::error_code error;
        const fs::path folder = (fs::path(name) / ".").parent_path();
        if (fs::is_directory(folder, error)) return;
        fs::create_directory(folder, error);
        if (error)
            throw IoError(fmt::format("cannot make the folder {}: {}", name, error.message()));
    }

    /// What is there stays there without --force.
    void keep(const fs::path& path) const
    {
        check_target(path);
        if (!common_.force && fs::exists(path))
            throw InvalidParameter(
                fmt::format("{} exists; replace it with --force", path.string()));
        if (!common_.force) return;
        std::error_code unknown;
        for (const std::vector<std::string>* inputs : {&scenes_, &meshes_})
            for (const std::string& input : *inputs)
                if (fs::equivalent(path, input, unknown))
                    throw InvalidParameter(fmt::format(
                        "--to {}: is what is read; give it another name", path.string()));
    }

    fs::path numbered(const std::string& target, std::size_t i) const
    {
        return sequence() ? frame_path(target, int(i) + 1) : fs::path(target);
    }
    static std::string stem_of(const std::string& input)
    {
        return input == "-" ? "scene" : fs::path(input).stem().string();
    }

    Scene read(const std::string& input, bool whole)
    {
        ReadOptions options;
        options.fix_nan = common_.fix_nan;
        options.memory_limit = common_.memory_limit;
        const Progress reading = context_.progress.named("reading");
        if (input == "-") return read_vdb_stream(STDIN_FILENO, options, "", reading);
        const bool about_mesh = meshes_.empty() && speaks_of_mesh(input);
        if (!whole) {
            std::vector<std::string> present;
            for (const VdbGridInfo& grid : inspect_vdb(input).grids) present.push_back(grid.name);
            const bool points = std::ranges::find(present, points_) != present.end();
            if (about_mesh || !meshes_.empty()) present.emplace_back("rock");
            for (std::string& name : stage_->chooses(present))
                if (name != "rock") options.if_there.insert(std::move(name));
            if (points) options.if_there.insert(points_);
            options.keep_foreign = false;
            // Names that are only `if_there` need one that must be: none is.
            options.only = std::move(options.if_there);
            options.if_there.clear();
        }
        Scene scene = read_vdb(input, options, reading);
        if (about_mesh) {
            const fs::path beside = mesh_beside(input);
            if (!fs::exists(beside))
                throw InvalidInput(
                    fmt::format("{}: it is about a mesh, which should lie beside it as {}, where "
                                "there is none",
                                input, beside.string()));
            scene.meshes["rock"] = read_surface(beside);
        }
        return scene;
    }

    /// The meshes by name: the first is the rock unless another is called so.
    std::vector<std::pair<std::string, TriMesh>> surfaces()
    {
        std::vector<std::pair<std::string, TriMesh>> list;
        for (const std::string& file : meshes_)
            list.emplace_back(stem_of(file), read_surface(file));
        const bool rock = std::ranges::any_of(list, [](auto& m) { return m.first == "rock"; });
        if (!rock && !list.empty()) list.front().first = "rock";
        for (std::size_t i = 0; i < list.size(); ++i)
            for (std::size_t k = 0; k < i; ++k)
                if (list[k].first == list[i].first)
                    throw InvalidParameter(
                        fmt::format("export: two meshes are called {}", list[i].first));
        return list;
    }

    /// All files of one scene into a folder, as far as it has what they show.
    std::vector<ExportFile> files_for(const fs::path& folder, const std::string& stem,
                                      const Scene& scene, const Assembly& all) const
    {
        std::vector<ExportFile> files;
        auto add = [&](const std::string& tail, const std::string& points, const std::string& map) {
            for (ExportFile& file : files_of(folder / (stem + tail), points, map))
                files.push_back(std::move(file));
        };
        add(".glb", "", "");
        add(".usda", "", "");
        if (!all.sets.empty()) add(".csv", "", "");
        if (!all.surfaces.empty()) {
            add(".obj", "", "");
            add(".ply", "", "");
        }
        for (const CopySet& set : all.sets) {
            const std::string name = set.name == "forest" ? "forest_instances" : set.name;
            add("_" + name + ".ply", name, "");
        }
        for (const std::string& map : map_names(scene, all)) add("_" + map + ".png", "", map);
        if (!scene.grids.empty() || !scene.points.empty()) add(".vdb", "", "");
        return files;
    }

    void export_one(const std::string& input, std::size_t number)
    {
        std::vector<ExportFile> files;
        bool shown = !folders_.empty(), whole = !folders_.empty();
        for (const std::string& target : targets_)
            if (!is_folder(target))
                for (ExportFile& file : files_of(numbered(target, number), points_, map_)) {
                    shown = shown || wants_assembly(file.kind);
                    whole = whole || file.kind == ExportKind::Vdb;
                    files.push_back(std::move(file));
                }
        stage_->asked_for({"scene.glb"});
        const Scene scene = scenes_.empty() ? Scene() : read(input, whole);
        const ExportOptions options = stage_->options(context_);
        Assembly all;
        if (shown)
            all =
                assemble(scene, options.assembly, context_.progress.named("gathering"), surfaces());
        // Nothing is left half: what stands in the way is found before the first file.
        std::map<std::string, std::vector<ExportFile>> of_folders;
        for (const auto& [folder, entries] : folders_) {
            make_folder(folder);
            of_folders[folder] = files_for(folder, stem_of(input), scene, all);
            for (const ExportFile& file : of_folders[folder]) keep(file.path);
        }
        for (const ExportFile& file : files)
            if (file.kind == ExportKind::Vdb && scenes_.empty())
                throw InvalidParameter(
                    fmt::format("--to {}: a mesh alone makes no scene", file.path.string()));
        const Bounds bounds = all.bounds();
        auto write = [&](const ExportFile& file) {
            write_export(file, scene, &all, options, context_.progress.named("writing"));
            clear_progress_line();
            log::detail("wrote {}", file.path.string());
        };
        for (const ExportFile& file : files) {
            remove_stale_temporaries(file.path.has_parent_path() ? file.path.parent_path() : ".");
            write(file);
            if (common_.json)
                outputs_.push_back(describe_output(file.path, file.path.string(), "export", bounds,
                                                   context_.progress));
        }
        for (const auto& [folder, list] : of_folders) {
            remove_stale_temporaries(folder);
            for (const ExportFile& file : list) {
                write(file);
                Json entry = describe_output(file.path, file.path.filename().string(), "export",
                                             bounds, context_.progress);
                if (common_.json) outputs_.push_back(entry);
                folders_[folder].push_back(std::move(entry));
            }
        }
        if (shown)
            log::info("export: {} triangles of surfaces and prototypes, {} copies", all.triangles(),
                      all.copies());
    }

    const Common& common_;
    const std::vector<std::string>& targets_;
    std::unique_ptr<ExportingStage> stage_;
    StageContext context_;
    std::vector<std::string> scenes_, meshes_;
    std::string points_, map_;
    std::map<std::string, Json> folders_;  // what their manifests will list
    Json outputs_ = Json::array();
};

}  // namespace

int command_export(const std::vector<std::string>& inputs, const std::vector<std::string>& targets,
                   const Words& words, const Common& common)
{
    const Json outputs = Export(inputs, targets, words, common).run();
    clear_progress_line();
    if (common.json)
        print(Json{{"stage", "export"}, {"seed", common.seed}, {"outputs", outputs}}.dump(2) +
              "\n");
    return 0;
}

}  // namespace sekitei::apps
