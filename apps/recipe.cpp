#include "apps/recipe.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <map>
#include <set>

#include "apps/exchange/stage.h"
#include "apps/toml_file.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"

namespace sekitei::apps {
namespace {

std::vector<std::string> strings_of(const toml::node& node, const std::string& key)
{
    std::vector<std::string> list;
    if (const auto* one = node.as_string()) return {one->get()};
    if (const auto* many = node.as_array()) {
        for (const toml::node& element : *many) {
            const auto* text = element.as_string();
            if (!text) throw InvalidParameter(key + " must be a name or a list of names");
            list.push_back(text->get());
        }
        return list;
    }
    throw InvalidParameter(key + " must be a name or a list of names");
}

std::uint64_t seed_of(const toml::node& node)
{
    const auto* v = node.as_integer();
    if (!v || v->get() < 0) throw InvalidParameter("seed must be an integer, 0 or larger");
    return static_cast<std::uint64_t>(v->get());
}

const std::vector<std::string>& extensions_of(Stage& stage)
{
    static const std::vector<std::string> kScene{".vdb"},
        kMesh{".ply", ".obj", ".stl", ".off", ".glb", ".vdb"}, kPicture{".png"}, kTable{".csv"},
        kPoints{".ply", ".glb", ".usda", ".csv", ".obj", ".mtl", ".png", ".json", ".vdb"};
    if (makes_mesh(stage)) return kMesh;
    switch (stage.info().output) {
        case OutputKind::Mesh:
            return kMesh;
        case OutputKind::Picture:
            return kPicture;
        case OutputKind::Table:
            return kTable;
        case OutputKind::Points:
            return kPoints;
        case OutputKind::Scene:
            break;
    }
    return kScene;
}

/// What a user wrote for a stage, before links between stages are known.
struct Draft {
    RecipeStage stage;
    std::vector<std::string> from;
    bool from_given = false;
    bool one_file = false;  ///< write is a name, not a list
    toml::source_region source, write_source;
    const toml::table* table = nullptr;
};

/// A stage's name is part of file names in the cache and of messages.
bool usable_name(const std::string& name)
{
    constexpr std::size_t kLongestName = 100;
    if (name.empty() || name.size() > kLongestName || name.front() == '.') return false;
    return std::none_of(name.begin(), name.end(),
                        [](char c) { return c == '/' || c == 0x7F || (c >= 0 && c < 0x20); });
}

/// Fills a draft from its table.
void read_stage(const std::string& name, const toml::table& table, std::uint64_t seed, Draft& draft,
                TomlErrors& errors)
{
    draft.stage.name = name;
    draft.stage.seed = seed;
    draft.table = &table;
    draft.source = draft.write_source = table.source();
    draft.stage.place = errors.place(table.source());
    if (!usable_name(name))
        return errors.add(
            table.source(),
            fmt::format(
                "{}: a stage's name has 1 to 100 bytes, no '/' and no control characters, "
                "and does not begin with a dot",
                Json(name.substr(0, 40)).dump(-1, ' ', true, Json::error_handler_t::replace)));
    std::string process = name;
    if (const toml::node* node = table.get("stage")) {
        if (const auto* text = node->as_string())
            process = text->get();
        else
            return errors.add(node->source(),
                              fmt::format("{}.stage: must be the name of a stage", name));
    }
    try {
        draft.stage.process = make_stage(process);
    } catch (const Error& error) {
        const toml::node* node = table.get("stage");
        return errors.add(node ? node->source() : table.source(),
                          fmt::format("{}: {}", name, error.what()));
    }
    const ParamList params = draft.stage.process->params();
    for (const auto& [key, node, source] : in_file_order(table)) {
        const std::string where = name + "." + key;
        try {
            if (key == "stage") continue;
            if (key == "from") {
                draft.from = strings_of(*node, "from");
                draft.from_given = true;
            } else if (key == "write") {
                draft.write_source = node->source();
                draft.one_file = node->is_string();
                draft.stage.write = strings_of(*node, "write");
            } else if (key == "seed")
                draft.stage.seed = seed_of(*node);
            else if (const Param* param = find_param(params, key))
                param->set(json_of(*node, key));
            else {
                std::vector<std::string> known{"stage", "from", "write", "seed"};
                for (const Param& p : params) known.push_back(p.name);
                const std::string near = nearest_name(key, known);
                errors.add(source,
                           fmt::format("{}: unknown key; {}", where,
                                       near.empty() ? fmt::format("the keys of `{}` are: {}",
                                                                  process, fmt::join(known, ", "))
                                                    : fmt::format("did you mean '{}'?", near)));
            }
        } catch (const Error& error) {
            errors.add(node->source(), fmt::format("{}: {}", name, error.what()));
        }
    }
    if (auto* exporting = dynamic_cast<ExportingStage*>(draft.stage.process.get()))
        exporting->asked_for(draft.stage.write);
    try {
        draft.stage.process->validate();
    } catch (const Error& error) {
        errors.add(place_of_blame(table, process, error.what(), table.source()), error.what());
    }
}

/// Orders the drafts so that each follows what it reads; reports unknown names and cycles.
std::vector<std::size_t> sorted(const std::vector<Draft>& drafts, TomlErrors& errors)
{
    std::map<std::string, std::size_t> index;
    for (std::size_t i = 0; i < drafts.size(); ++i) index[drafts[i].stage.name] = i;
    std::vector<std::vector<std::size_t>> parents(drafts.size());
    std::vector<std::string> names;
    names.reserve(drafts.size());
    for (const Draft& d : drafts) names.push_back(d.stage.name);
    for (std::size_t i = 0; i < drafts.size(); ++i)
        for (const std::string& parent : drafts[i].from) {
            if (index.contains(parent)) {
                parents[i].push_back(index[parent]);
                continue;
            }
            const std::string near = nearest_name(parent, names);
            errors.add(
                drafts[i].source,
                fmt::format("{}.from: there is no stage '{}'{}", drafts[i].stage.name, parent,
                            near.empty() ? "" : fmt::format(", did you mean '{}'?", near)));
        }
    std::vector<std::size_t> order;
    std::vector<bool> placed(drafts.size(), false);
    for (bool moved = true; moved;) {
        moved = false;
        for (std::size_t i = 0; i < drafts.size(); ++i) {
            if (placed[i]) continue;
            if (!std::all_of(parents[i].begin(), parents[i].end(),
                             [&](std::size_t p) { return placed[p]; }))
                continue;
            placed[i] = moved = true;
            order.push_back(i);
        }
    }
    std::vector<std::string> circle;
    for (std::size_t i = 0; i < drafts.size(); ++i)
        if (!placed[i]) circle.push_back(drafts[i].stage.name);
    if (!circle.empty())
        errors.add(drafts[index[circle.front()]].source,
                   fmt::format("{}.from: these stages wait for each other: {}", circle.front(),
                               fmt::join(circle, ", ")));
    return order;
}

/// Every grid, point set and mesh that a stage needs must be made by something it reads.
void check_supplies(const std::vector<Draft>& drafts, const std::vector<std::size_t>& order,
                    TomlErrors& errors)
{
    std::map<std::string, std::set<std::string>> visible;
    for (const std::size_t i : order) {
        const RecipeStage& stage = drafts[i].stage;
        std::set<std::string>& here = visible[stage.name];
        const bool many = stage.process->info().reads_many;
        for (const std::string& parent : drafts[i].from)
            here.insert(visible[parent].begin(), visible[parent].end());
        const bool rock = here.contains("rock");
        stage.process->meets_trees(here.contains("tree_skeleton") && !rock);
        stage.process->meets_forest(here.contains("forest_instances") && !rock);
        try {
            stage.process->check_reading();
        } catch (const InvalidParameter& error) {
            errors.add(place_of_blame(*drafts[i].table, stage.process->info().name, error.what(),
                                      drafts[i].source),
                       error.what());
        }
        for (const std::string& need : stage.process->needs()) {
            const bool there = many ? std::all_of(drafts[i].from.begin(), drafts[i].from.end(),
                                                  [&](const auto& parent) {
                                                      return visible[parent].contains(need);
                                                  })
                                    : here.contains(need);
            if (there) continue;
            std::vector<std::string> makers;
            for (const StageInfo& info : stage_infos())
                for (const std::string& made : info.makes)
                    if (made == need) makers.push_back("`" + info.name + "`");
            errors.add(
                drafts[i].source,
                fmt::format("{}: needs '{}', which no stage it reads makes{}", stage.name, need,
                            makers.empty() ? ""
                                           : fmt::format("; add a {} stage before it",
                                                         fmt::join(makers, " or "))));
        }
        if (many) here.clear();
        for (const std::string& made : stage.process->makes()) here.insert(made);
    }
}

/// Tells each stage whether a mesh comes to it from those it reads.
void pass_meshes_on(std::vector<Draft>& drafts, const std::vector<std::size_t>& order)
{
    std::set<std::string> with_mesh;
    for (const std::size_t i : order) {
        Stage& stage = *drafts[i].stage.process;
        const bool there =
            std::any_of(drafts[i].from.begin(), drafts[i].from.end(),
                        [&](const std::string& parent) { return with_mesh.contains(parent); });
        if (stage.info().reads_mesh) stage.meets_mesh(there);
        if (there || makes_mesh(stage)) with_mesh.insert(drafts[i].stage.name);
    }
}

/// A scene about a mesh is nothing to draw or to go on from without it: where only the scene is
/// asked for, its mesh goes beside it as it does by hand. A list is taken at its word.
void add_meshes_beside(std::vector<Draft>& drafts, const TomlErrors& errors)
{
    std::map<std::string, std::string> owner;
    auto plain = [](const std::filesystem::path& path) { return path.lexically_normal().string(); };
    for (const Draft& draft : drafts)
        for (const std::string& name : draft.stage.write)
            owner.emplace(plain(name), draft.stage.name);
    // Materials of an OBJ and what the greys of a map mean.
    for (Draft& draft : drafts) {
        if (draft.stage.process->info().output != OutputKind::Points) continue;
        std::vector<std::string>& write = draft.stage.write;
        for (std::size_t i = 0; i < write.size(); ++i) {
            std::filesystem::path beside = write[i];
            if (beside.extension() != ".obj" && beside.extension() != ".png") continue;
            beside.replace_extension(beside.extension() == ".obj" ? ".mtl" : ".json");
            if (!owner.contains(plain(beside))) write.push_back(beside.string());
            owner.emplace(plain(beside), draft.stage.name);
        }
    }
    for (Draft& draft : drafts) {
        std::vector<std::string>& write = draft.stage.write;
        if (!draft.one_file || !makes_mesh(*draft.stage.process)) continue;
        std::filesystem::path beside = write.front();
        if (beside.extension() != ".vdb") continue;
        beside.replace_extension(".ply");
        const auto other = owner.find(plain(beside));
        if (other == owner.end())
            write.push_back(beside.string());
        else
            log::warning(
                "{}: {}.write: the mesh of {} belongs beside it as {}, which the stage '{}' "
                "writes; "
                "the scene cannot be drawn: give one of the two another name",
                errors.place(draft.write_source), draft.stage.name, write.front(), beside.string(),
                other->second);
    }
}

/// File names must suit the stage, stay inside the output folder and be used once.
void check_writes(const std::vector<Draft>& drafts, TomlErrors& errors)
{
    std::map<std::string, std::string> owner;
    for (const Draft& draft : drafts) {
        const RecipeStage& stage = draft.stage;
        if (!stage.process) continue;
        const ParamList params = stage.process->params();
        if (const int every = stage.process->frame_interval(); every != 0 && stage.write.empty())
            errors.add(draft.source,
                       fmt::format("{}: every = {} numbers scenes after the stage's own file, but "
                                   "it writes none; add write = \"{}.vdb\"",
                                   stage.name, every, stage.name));
        std::vector<std::filesystem::path> beside = stage.process->side_files();
        for (const std::filesystem::path& folder : stage.process->side_folders())
            beside.push_back(folder);
        if (!beside.empty())
            errors.add(
                draft.source,
                fmt::format("{}: {} would be written behind the recipe's back; write points "
                            "with an `export` stage, or make it from the scene by "
                            "command: `sekitei {}`",
                            stage.name, beside.front().string(), stage.process->info().name));
        for (const std::string& name : stage.write) {
            const std::filesystem::path path(name);
            const auto& allowed = extensions_of(*stage.process);
            auto complain = [&](const std::string& text) {
                errors.add(draft.write_source,
                           fmt::format("{}.write: '{}' {}", stage.name, name, text));
            };
            if (std::find(allowed.begin(), allowed.end(), path.extension().string()) ==
                allowed.end())
                complain(fmt::format("must end in one of: {}", fmt::join(allowed, ", ")));
            const std::string plain = path.lexically_normal().string();
            if (path.is_absolute() || plain.starts_with(".."))
                complain("must lie inside the output folder");
            if (plain == "manifest.json" || plain.starts_with(".sekitei"))
                complain("is a name the program uses itself");
            const auto [other, is_new] = owner.emplace(plain, stage.name);
            if (!is_new)
                complain(fmt::format("is already written by the stage '{}'", other->second));
        }
    }
}

/// Applies "a.b=value" to the parsed table, typed like TOML and, failing that, as text.
void apply_override(toml::table& root, const std::string& text)
{
    const std::size_t equals = text.find('=');
    if (equals == std::string::npos || equals == 0)
        throw InvalidParameter(fmt::format("--set {}: expected stage.key=value", text));
    const std::string path = text.substr(0, equals), word = text.substr(equals + 1);
    const std::string source = "--set " + text;
    toml::table parsed;
    try {
        parsed = toml::parse("v = " + word, source);
    } catch (const toml::parse_error&) {
        parsed.clear();
    }
    if (parsed.size() != 1) {
        try {
            parsed = toml::parse("v = " + Json(word).dump(-1, ' ', true), source);
        } catch (const Json::exception&) {
            throw InvalidParameter(source + ": is not UTF-8 text");
        } catch (const toml::parse_error& error) {
            throw InvalidParameter(fmt::format("{}: {}", source, error.description()));
        }
    }
    toml::table* target = &root;
    std::string key = path;
    if (const std::size_t dot = path.find('.'); dot != std::string::npos) {
        const std::string stage = path.substr(0, dot);
        key = path.substr(dot + 1);
        target = root.get_as<toml::table>(stage);
        if (!target) {
            std::vector<std::string> names;
            for (const auto& [k, node] : root)
                if (node.is_table()) names.emplace_back(k.str());
            throw InvalidParameter(fmt::format("--set {}: the recipe has no stage '{}', it has: {}",
                                               text, stage, fmt::join(names, ", ")));
        }
    }
    // Moved, for a copy forgets where it was written.
    parsed.get("v")->visit([&](auto& value) { target->insert_or_assign(key, std::move(value)); });
}

std::string toml_value(const Json& value)
{
    if (value.is_string()) return value.dump();
    if (value.is_array()) {
        std::vector<std::string> parts;
        for (const Json& v : value) parts.push_back(toml_value(v));
        return fmt::format("[{}]", fmt::join(parts, ", "));
    }
    return value.dump();
}

}  // namespace

Recipe read_recipe(const std::filesystem::path& file, const std::vector<std::string>& overrides)
{
    return parse_recipe(read_toml_text(file), file, overrides);
}

Recipe parse_recipe(const std::string& text, const std::filesystem::path& file,
                    const std::vector<std::string>& overrides)
{
    toml::table root = parse_toml(text, file);
    for (const std::string& word : overrides) apply_override(root, word);

    TomlErrors errors(file.string());
    Recipe recipe;
    recipe.file = file;
    recipe.folder = file.has_parent_path() ? file.parent_path() : ".";
    recipe.out = "out/" + file.stem().string();
    const toml::node* version = root.get("sekitei");
    if (!version)
        errors.add(file.string() + ":1:1", "sekitei: missing, expected `sekitei = 1` at the top");
    else if (const auto* v = version->as_integer(); !v || v->get() != 1)
        errors.add(version->source(), "sekitei: recipes of this program have the version 1");

    std::vector<Draft> drafts;
    for (const auto& [key, node, source] : in_file_order(root)) {
        try {
            if (key == "sekitei") continue;
            if (key == "seed")
                recipe.seed = seed_of(*node);
            else if (key == "out") {
                const auto* folder = node->as_string();
                if (!folder || folder->get().empty())
                    throw InvalidParameter("must be the name of a folder");
                recipe.out = folder->get();
            } else if (!node->is_table())
                errors.add(
                    source,
                    fmt::format(
                        "{}: unknown key; the keys before the first table are sekitei, seed, out",
                        key));
        } catch (const Error& error) {
            errors.add(node->source(), fmt::format("{}: {}", key, error.what()));
        }
    }
    for (const auto& [key, node, source] : in_file_order(root)) {
        const toml::table* table = node->as_table();
        if (!table) continue;
        drafts.emplace_back();
        read_stage(key, *table, recipe.seed, drafts.back(), errors);
    }
    // By default a stage reads the one above it.
    for (std::size_t i = 1; i < drafts.size(); ++i)
        if (!drafts[i].from_given && drafts[i].stage.process &&
            drafts[i].stage.process->reads_scene())
            drafts[i].from = {drafts[i - 1].stage.name};
    for (const Draft& draft : drafts)
        if (draft.stage.process && !draft.stage.process->reads_scene() &&
            !draft.stage.process->info().reads_if_given && !draft.from.empty())
            errors.add(draft.source,
                       fmt::format("{}.from: the stage '{}' reads no other", draft.stage.name,
                                   draft.stage.process->info().name));
    for (const Draft& draft : drafts)
        if (draft.stage.process && draft.stage.process->info().reads_many &&
            draft.from.size() < 2 && draft.stage.process->info().output == OutputKind::Table)
            errors.add(draft.source,
                       fmt::format("{}.from: `{}` reads two stages or more", draft.stage.name,
                                   draft.stage.process->info().name));
    if (drafts.empty())
        errors.add(file.string() + ":1:1",
                   "the recipe has no stage, expected tables such as [lava]");

    // Links and supplies can be judged only where every stage is known.
    const bool known = std::all_of(drafts.begin(), drafts.end(),
                                   [](const Draft& d) { return d.stage.process != nullptr; });
    const std::vector<std::size_t> order = sorted(drafts, errors);
    if (known && order.size() == drafts.size()) pass_meshes_on(drafts, order);
    if (known && order.size() == drafts.size()) check_supplies(drafts, order, errors);
    if (known && order.size() == drafts.size()) add_meshes_beside(drafts, errors);
    check_writes(drafts, errors);
    errors.raise();
    std::map<std::string, std::size_t> position;
    for (const std::size_t i : order) {
        Draft& draft = drafts[i];
        for (const std::string& parent : draft.from)
            draft.stage.from.push_back(position.at(parent));
        position[draft.stage.name] = recipe.stages.size();
        recipe.stages.push_back(std::move(draft.stage));
    }
    return recipe;
}

void require_input_files(const Recipe& recipe, const std::vector<bool>& selected)
{
    StageContext context;
    context.folder = recipe.folder;
    std::vector<std::string> wrong;
    ExitCode code = ExitCode::BadInput;
    for (std::size_t i = 0; i < recipe.stages.size(); ++i) {
        if (!selected[i]) continue;
        const RecipeStage& stage = recipe.stages[i];
        const std::size_t before = wrong.size();
        auto require = [&](const std::string& key, const std::filesystem::path& file) {
            const std::filesystem::path path = Stage::resolve(context, file);
            if (!file.empty() && !std::filesystem::exists(path))
                wrong.push_back(fmt::format("{}: {}: {} = {}: no such file", stage.place,
                                            stage.name, key, path.string()));
        };
        for (const Param& param : stage.process->params())
            if (param.kind == Param::Kind::Path)
                require(param.name, param.get().get<std::string>());
        for (const std::filesystem::path& file : stage.process->files()) require("file", file);
        if (wrong.size() > before) continue;
        try {
            stage.process->check_files(context);
        } catch (const InvalidInput& error) {
            const bool named = blames_own_file(*stage.process, context, error.what());
            wrong.push_back(named ? error.what()
                                  : fmt::format("{}: {}", stage.place, error.what()));
            if (error.code() == ExitCode::Usage) code = error.code();
        }
    }
    if (!wrong.empty()) throw InvalidInput(fmt::format("{}", fmt::join(wrong, "\n")), code);
}

void apply_params_file(const std::filesystem::path& file, const ParamList& params,
                       const std::function<void()>& validate)
{
    const toml::table table = read_toml(file);
    TomlErrors errors(file.string());
    for (const auto& [key, node, source] : in_file_order(table)) {
        try {
            if (const Param* param = find_param(params, key)) {
                param->set(json_of(*node, key));
                continue;
            }
            std::vector<std::string> known;
            for (const Param& p : params) known.push_back(p.name);
            const std::string near = nearest_name(key, known);
            errors.add(source,
                       fmt::format("{}: unknown key{}", key,
                                   near.empty() ? "" : fmt::format(", did you mean '{}'?", near)));
        } catch (const Error& error) {
            errors.add(node->source(), error.what());
        }
    }
    errors.raise();
    if (!validate) return;
    try {
        validate();
    } catch (const InvalidParameter& error) {
        errors.add(place_of_blame(table, "", error.what(), table.source()), error.what());
    }
    errors.raise();
}

std::string recipe_from_history(const std::vector<HistoryEntry>& history, const std::string& output,
                                bool every_value)
{
    std::string text = "sekitei = 1\n";
    std::map<std::string, int> used;
    std::string before;
    for (std::size_t i = 0; i < history.size(); ++i) {
        const HistoryEntry& entry = history[i];
        const auto stage = make_stage(entry.stage);
        const int repeat = ++used[entry.stage];
        const std::string name =
            repeat == 1 ? entry.stage : fmt::format("{}_{}", entry.stage, repeat);
        text += fmt::format("\n[{}]\n", name);
        if (repeat > 1) text += fmt::format("stage = \"{}\"\n", entry.stage);
        if (stage->info().reads_if_given && i > 0)
            text += fmt::format("from = {}\n", Json(before).dump());
        before = name;
        text += fmt::format("seed = {}\n", entry.seed);
        for (const Param& param : stage->params()) {
            if (!entry.params.contains(param.name)) continue;
            const Json& value = entry.params[param.name];
            const Json usual = param.get();
            if (value.is_null() || (!every_value && value == usual)) continue;
            if (param.kind == Param::Kind::Path && value == "") continue;
            // Files beside the result are none of a recipe's business.
            param.set(value);
            if (!stage->side_files().empty() || !stage->side_folders().empty()) {
                param.set(usual);
                continue;
            }
            text += fmt::format("{} = {}{}\n", param.name, toml_value(value),
                                param.unit.empty() ? "" : "  # " + param.unit);
        }
        if (i + 1 == history.size()) text += fmt::format("write = {}\n", Json(output).dump());
    }
    return text;
}

}  // namespace sekitei::apps
