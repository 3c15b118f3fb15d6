#include "apps/runner.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <map>

#include "apps/console.h"
#include "apps/exchange/stage.h"
#include "apps/folder_lock.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/json.h"
#include "core/log.h"
#include "core/mesh_io.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

constexpr int kCacheVersion = 1;
constexpr std::size_t kWorthReading = 256 << 20;  // bytes
constexpr std::size_t kKeptResults = 4;           // of a stage, for going back and forth

double seconds_now()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch())
        .count();
}

/// A grid, point set or mesh that a stage can see: who made it, with which content.
struct Item {
    std::size_t maker;
    std::string hash;
};
using Items = std::map<std::string, Item>;

Json domain_json(const Domain& d)
{
    return {d.dims.x,
            d.dims.y,
            d.dims.z,
            d.transform.origin.x,
            d.transform.origin.y,
            d.transform.origin.z,
            d.transform.voxel};
}

Domain domain_from(const Json& j)
{
    return {{j[0], j[1], j[2]}, {{j[3], j[4], j[5]}, j[6]}};
}

Json bounds_json(const Bounds& b)
{
    return {{b.lower.x, b.lower.y, b.lower.z}, {b.upper.x, b.upper.y, b.upper.z}};
}

Bounds bounds_from(const Json& j)
{
    Bounds b;
    for (const Json& corner : j) b.add(Vec3d(corner[0], corner[1], corner[2]));
    return b;
}

/// A record with a hash of its other members, so that damage to its file is found.
std::string sealed(Json record)
{
    record["seal"] = hash_hex(record.dump());
    return record.dump(1);
}

/// What sealed() was given; null where the text is damaged.
Json unsealed(const std::string& text)
{
    Json record = parse_json(text, false);
    if (!record.is_object()) return nullptr;
    const Json seal = record.value("seal", Json());
    record.erase("seal");
    return seal == hash_hex(record.dump()) ? record : Json();
}

/// The entries of a state that are of the kind a run leaves there: a damaged file may hold others.
Json plausible(Json state)
{
    if (!state.is_object()) state = Json::object();
    auto keep = [&](const char* member, auto&& good) {
        Json& part = state[member];
        if (!part.is_object()) part = Json::object();
        for (auto entry = part.begin(); entry != part.end();)
            good(*entry) ? ++entry : entry = part.erase(entry);
    };
    auto has = [](const Json& entry, std::initializer_list<const char*> names, auto&& good) {
        return entry.is_object() && std::all_of(names.begin(), names.end(), [&](const char* name) {
                   return entry.contains(name) && good(entry[name]);
               });
    };
    auto text = [](const Json& value) { return value.is_string(); };
    auto object = [](const Json& value) { return value.is_object(); };
    keep("owned", text);
    keep("outputs", [&](const Json& entry) { return has(entry, {"key", "hash"}, text); });
    keep("last", [&](const Json& entry) {
        return has(entry, {"params", "files", "inputs", "recalled"}, object) &&
               has(entry, {"stage", "version", "seed"}, [](const Json&) { return true; });
    });
    return state;
}

/// Whether a PLY file is a mesh: its header speaks of faces.
bool has_faces(const fs::path& path)
{
    std::ifstream file(path);
    for (std::string line; std::getline(file, line) && line != "end_header";)
        if (line.starts_with("element face")) return true;
    return false;
}

/// What is kept of one finished stage.
struct Record {
    Json json;  // null: there is none

    bool exists() const { return !json.is_null(); }
    std::map<std::string, std::string> outputs() const
    {
        return json["outputs"].get<std::map<std::string, std::string>>();
    }
};

class Runner {
public:
    Runner(const Recipe& recipe, const RunOptions& options)
        : recipe_(recipe), options_(options), cache_(recipe.out / ".sekitei")
    {
    }

    Json run()
    {
        select();
        prepare();
        Json stages = Json::array();
        for (std::size_t i = 0; i < recipe_.stages.size(); ++i) {
            if (!selected_[i]) continue;
            stages.push_back(options_.dry_run ? plan(i) : perform(i));
        }
        Json summary = {
            {"recipe", recipe_.file.string()}, {"out", recipe_.out.string()}, {"stages", stages}};
        if (!options_.dry_run) {
            write_manifest();
            sweep_cache();
            summary["outputs"] = manifest_["outputs"];
        }
        return summary;
    }

private:
    const RecipeStage& stage(std::size_t i) const { return recipe_.stages[i]; }

    ExportingStage* exports(std::size_t i) const
    {
        return dynamic_cast<ExportingStage*>(stage(i).process.get());
    }

    StageContext context(std::size_t i) const
    {
        StageContext c;
        c.seed = stage(i).seed;
        c.progress = console_progress(stage(i).name);
        c.memory_limit = options_.memory_limit;
        c.fix_nan = options_.fix_nan;
        c.folder = recipe_.folder;
        return c;
    }

    /// Marks the stages to run: all, or those asked for and what they read.
    void select()
    {
        const std::size_t n = recipe_.stages.size();
        selected_.assign(n, options_.only.empty());
        std::set<std::string> unknown = options_.only;
        for (std::size_t i = n; i-- > 0;) {
            if (unknown.erase(stage(i).name)) selected_[i] = true;
            if (selected_[i])
                for (const std::size_t parent : stage(i).from) selected_[parent] = true;
        }
        if (unknown.empty()) return;
        std::vector<std::string> names;
        for (const RecipeStage& s : recipe_.stages) names.push_back(s.name);
        throw InvalidParameter(fmt::format("--only {}: the recipe has no such stage, it has: {}",
                                           *unknown.begin(), fmt::join(names, ", ")));
    }

    /// Everything that can fail early fails here, before anything is computed.
    void prepare()
    {
        visible_.resize(recipe_.stages.size());
        outlines_.resize(recipe_.stages.size());
        records_.resize(recipe_.stages.size());
        if (fs::exists(cache_ / "state.json")) state_ = plausible(read_json(cache_ / "state.json"));
        require_input_files(recipe_, selected_);
        if (options_.dry_run) return;
        refuse_foreign_manifest();
        for (std::size_t i = 0; i < recipe_.stages.size(); ++i)
            if (selected_[i])
                for (const std::string& name : stage(i).write)
                    refuse_foreign(recipe_.out / name, name);

        std::error_code error;
        fs::create_directories(cache_, error);
        if (error)
            throw IoError(fmt::format("cannot make the folder {}: {}", recipe_.out.string(),
                                      error.message()));
        lock_ = std::make_unique<FolderLock>(
            cache_, fmt::format("{} is in use by another run; wait for it or choose another folder "
                                "with --set out=FOLDER",
                                cache_.parent_path().string()));
        remove_stale_temporaries(cache_);
        remove_stale_temporaries(recipe_.out);
        check_target(recipe_.out / "manifest.json");
        for (std::size_t i = 0; i < recipe_.stages.size(); ++i) {
            if (!selected_[i]) continue;
            for (const std::string& name : stage(i).write) {
                const fs::path target = recipe_.out / name;
                if (target.has_parent_path()) fs::create_directories(target.parent_path(), error);
                check_target(target);
            }
        }
    }

    /// A file in the way must be one that an earlier run of this folder wrote, unless --force.
    void refuse_foreign(const fs::path& target, const std::string& name)
    {
        if (options_.force || !fs::exists(target)) return;
        const Json owned = state_.value("owned", Json::object());
        if (owned.contains(name) && (owned[name] == "" || owned[name] == file_hash(target))) return;
        throw InvalidParameter(
            fmt::format("{} exists and was not made by an earlier run here, or was changed since; "
                        "move it away or allow replacing with --force",
                        target.string()));
    }

    void refuse_foreign_manifest() const
    {
        const fs::path path = recipe_.out / "manifest.json";
        if (options_.force || !fs::exists(path)) return;
        const Json json = read_json(path);
        if (json.is_object() && json.contains("sekitei") && json.contains("outputs")) return;
        throw InvalidParameter(
            fmt::format("{} exists and is no manifest of this program; move it away or allow "
                        "replacing with --force",
                        path.string()));
    }

    static Json read_json(const fs::path& path)
    {
        try {
            return parse_json(read_file(path, 1u << 28));
        } catch (const std::exception&) {
            return nullptr;
        }
    }

    /// A damaged record is no record: the stage runs again.
    static Json read_record(const fs::path& path)
    {
        try {
            return unsealed(read_file(path, 1u << 28));
        } catch (const InvalidInput&) {
            return nullptr;
        }
    }

    void save_state() const { write_file(cache_ / "state.json", state_.dump(1)); }

    /// What stage i can see before it runs.
    Items inherited(std::size_t i) const
    {
        Items items;
        if (stage(i).process->info().reads_many) return items;  // each parent stays by itself
        for (const std::size_t parent : stage(i).from)
            for (const auto& [name, item] : visible_[parent]) {
                const auto [old, is_new] = items.emplace(name, item);
                if (is_new || old->second.hash == item.hash) continue;
                throw InvalidParameter(
                    fmt::format("{}: {}.from: both '{}' and '{}' bring a '{}', and they differ; "
                                "read only one of them",
                                stage(i).place, stage(i).name, stage(old->second.maker).name,
                                stage(item.maker).name, name));
            }
        return items;
    }

    /// Stages that stage i builds on, in order, without itself.
    std::vector<std::size_t> ancestors(std::size_t i) const
    {
        std::vector<bool> mark(i + 1, false);
        for (const std::size_t parent : stage(i).from) mark[parent] = true;
        for (std::size_t k = i; k-- > 0;)
            if (mark[k])
                for (const std::size_t parent : stage(k).from) mark[parent] = true;
        std::vector<std::size_t> list;
        for (std::size_t k = 0; k < i; ++k)
            if (mark[k]) list.push_back(k);
        return list;
    }

    /// Whether stage k is part of the history of what stage i makes: a mesh is where stage i goes
    /// on with its triangles.
    bool counts(std::size_t k, std::size_t i) const
    {
        const OutputKind kind = stage(k).process->info().output;
        return kind == OutputKind::Scene ||
               (kind == OutputKind::Mesh && makes_mesh(*stage(i).process));
    }

    std::vector<HistoryEntry> history(std::size_t i) const
    {
        std::vector<HistoryEntry> entries;
        for (const std::size_t k : ancestors(i))
            if (counts(k, i)) entries.push_back(history_of(*stage(k).process, context(k)));
        if (stage(i).process->info().output == OutputKind::Scene)
            entries.push_back(history_of(*stage(i).process, context(i)));
        return entries;
    }

    /// What stage i reads of these items.
    std::vector<std::string> reads(std::size_t i, const Items& items) const
    {
        std::vector<std::string> names = stage(i).process->needs();
        if (const ExportingStage* exporting = exports(i)) {
            std::vector<std::string> present;
            for (const auto& [name, item] : items) present.push_back(name);
            for (std::string& name : exporting->chooses(present)) names.push_back(std::move(name));
        } else
            for (const std::string& name : stage(i).process->uses())
                if (items.contains(name)) names.push_back(name);
        return names;
    }

    /// What the key of stage i is made of. Parameters of ancestors that it looks up count too.
    Json ingredients(std::size_t i, const Items& items) const
    {
        Json inputs = Json::object();
        if (stage(i).process->info().reads_many) {
            for (const std::size_t parent : stage(i).from)
                for (const std::string& name : reads(i, visible_[parent]))
                    if (const auto found = visible_[parent].find(name);
                        found != visible_[parent].end())
                        inputs[stage(parent).name + "/" + name] = found->second.hash;
        } else
            for (const std::string& name : reads(i, items))
                if (const auto found = items.find(name); found != items.end())
                    inputs[name] = found->second.hash;
        Json recalled = Json::object();
        for (const std::size_t k : ancestors(i))
            for (const std::string& recall : stage(i).process->info().recalls) {
                const std::size_t dot = std::min(recall.find('.'), recall.size());
                const std::string name = recall.substr(0, dot);
                if (stage(k).process->info().name != name) continue;
                const Json params = params_json(stage(k).process->params());
                if (dot == recall.size())
                    recalled[name] = params;
                else
                    recalled[name][recall.substr(dot + 1)] = params[recall.substr(dot + 1)];
            }
        return {{"cache", kCacheVersion},
                {"recalled", recalled},
                {"stage", stage(i).process->info().name},
                {"version", stage(i).process->info().version},
                {"params", params_json(stage(i).process->params())},
                {"seed", stage(i).seed},
                {"inputs", inputs},
                {"files", input_hashes(*stage(i).process, context(i))}};
    }

    fs::path record_path(std::size_t i, const std::string& key) const
    {
        return cache_ / fmt::format("{}-{}.json", stage(i).name, key.substr(0, 16));
    }
    static const char* extension(OutputKind kind)
    {
        return kind == OutputKind::Scene                                ? ".vdb"
               : kind == OutputKind::Mesh || kind == OutputKind::Points ? ".ply"
               : kind == OutputKind::Picture                            ? ".png"
                                                                        : ".csv";
    }
    fs::path result_path(std::size_t i, const std::string& key) const
    {
        return cache_ / fmt::format("{}-{}{}", stage(i).name, key.substr(0, 16),
                                    extension(stage(i).process->info().output));
    }

    /// Of the mesh beside a scene that has one.
    fs::path mesh_path(std::size_t i, const std::string& key) const
    {
        return result_path(i, key).replace_extension(".ply");
    }

    /// The record of a finished stage with this key, if its result file is whole.
    Record find_record(std::size_t i, const std::string& key, std::string& reason) const
    {
        const fs::path path = record_path(i, key);
        if (!fs::exists(path)) return {};
        Record record{read_record(path)};
        if (!record.exists() || record.json.value("key", "") != key) {
            reason = "its kept result is damaged";
            return {};
        }
        const fs::path result = result_path(i, key);
        std::error_code error;
        if (!fs::exists(result) ||
            fs::file_size(result, error) != record.json.value("bytes", std::uint64_t{0}) ||
            file_hash(result, context(i).progress) != record.json.value("file_hash", "")) {
            reason = "its kept result is missing or damaged";
            return {};
        }
        if (const std::string mesh = record.json.value("mesh_hash", "");
            !mesh.empty() && (!fs::exists(mesh_path(i, key)) ||
                              file_hash(mesh_path(i, key), context(i).progress) != mesh)) {
            reason = "its kept mesh is missing or damaged";
            return {};
        }
        const Json frames = record.json.value("frames", Json::object());
        for (const auto& [name, hash] : frames.items())
            if (!fs::exists(recipe_.out / name) || file_hash(recipe_.out / name) != hash) {
                reason = fmt::format("{} of its sequence is gone or was changed", name);
                return {};
            }
        return record;
    }

    /// Why a stage runs, compared with the last run in this folder.
    std::string reason_to_run(std::size_t i, const Json& now) const
    {
        const Json last_runs = state_.value("last", Json::object());
        if (!last_runs.contains(stage(i).name)) return "it has not run before";
        const Json& last = last_runs[stage(i).name];
        if (last["stage"] != now["stage"] || last["version"] != now["version"])
            return "the process changed";
        for (const auto& [name, value] : now["params"].items())
            if (!last["params"].contains(name) || last["params"][name] != value)
                return fmt::format(
                    "{} changed from {} to {}", name,
                    last["params"].contains(name) ? last["params"][name].dump() : "nothing",
                    value.dump());
        if (last["seed"] != now["seed"]) return "the seed changed";
        for (const auto& [name, value] : now["files"].items())
            if (!last["files"].contains(name) || last["files"][name] != value)
                return fmt::format("the file {} changed", name);
        for (const auto& [name, value] : now["inputs"].items())
            if (!last["inputs"].contains(name) || last["inputs"][name] != value)
                return fmt::format("its input {} changed", name);
        const Json recalled = last.value("recalled", Json::object());
        for (const auto& [name, params] : now["recalled"].items()) {
            const Json before = recalled.value(name, Json::object());
            for (const auto& [key, value] : params.items())
                if (!before.contains(key) || before[key] != value)
                    return fmt::format("{}.{} changed to {}", name, key, value.dump());
        }
        return "its kept result is gone";
    }

    static std::string key_of(const Json& ingredients) { return hash_hex(ingredients.dump()); }

    void adopt(std::size_t i, Items items, const Record& record)
    {
        for (const auto& [name, hash] : record.outputs()) items[name] = {i, hash};
        visible_[i] = std::move(items);
        records_[i] = record;
        SceneOutline& outline = outlines_[i];
        outline.domain = domain_from(record.json["domain"]);
        outline.heat_domain = domain_from(record.json["heat_domain"]);
        outline.lava_voxels = record.json.value("lava_voxels", 0.0);
        outline.surface_cells = record.json.value("surface_cells", 0.0);
    }

    SceneOutline inherited_outline(std::size_t i) const
    {
        SceneOutline outline;
        for (const std::size_t parent : stage(i).from)
            if (outlines_[parent].domain.dims.x > 0 || outlines_[parent].surface_cells > 0)
                outline = outlines_[parent];
        return outline;
    }

    // ---- planning -------------------------------------------------------------------------

    Json plan(std::size_t i)
    {
        SceneOutline outline = inherited_outline(i);
        const Need need = stage(i).process->estimate(outline, context(i));
        bool waits = false;
        for (const std::size_t parent : stage(i).from) waits = waits || will_run_.contains(parent);
        std::string reason, state = "run";
        if (waits) {
            reason = "what it reads is made anew";
            will_run_.insert(i);
            outlines_[i] = outline;
            Items items;
            if (!stage(i).process->info().reads_many)
                for (const std::size_t parent : stage(i).from)
                    items.insert(visible_[parent].begin(), visible_[parent].end());
            visible_[i] = std::move(items);
        } else {
            Items items = inherited(i);
            const Json now = ingredients(i, items);
            const Record record = find_record(i, key_of(now), reason);
            if (record.exists()) {
                state = "cached";
                reason = "nothing changed";
                adopt(i, std::move(items), record);
            } else {
                if (reason.empty()) reason = reason_to_run(i, now);
                will_run_.insert(i);
                outlines_[i] = outline;
                visible_[i] = std::move(items);
            }
        }
        log::info("{:<12} {:<7} {:<44} {:>16} voxels {:>9} memory {:>9} disk", stage(i).name, state,
                  reason, count_text(need.voxels), bytes_text(need.memory), bytes_text(need.disk));
        return {{"name", stage(i).name}, {"state", state},        {"reason", reason},
                {"voxels", need.voxels}, {"memory", need.memory}, {"disk", need.disk}};
    }

    // ---- running --------------------------------------------------------------------------

    Json perform(std::size_t i)
    {
        const double start = seconds_now();
        Items items = inherited(i);
        auto require = [&](const Items& there) {
            for (const std::string& need : stage(i).process->needs())
                if (!there.contains(need))
                    throw InvalidInput(
                        fmt::format("{}: {} needs '{}', which the stages before it did not make",
                                    stage(i).place, stage(i).name, need));
        };
        if (stage(i).process->info().reads_many)
            for (const std::size_t parent : stage(i).from) require(visible_[parent]);
        else
            require(items);
        const Json now = ingredients(i, items);
        const std::string key = key_of(now);
        std::string reason;
        Record record = find_record(i, key, reason);
        const bool cached = record.exists();
        if (cached) {
            reason = "nothing changed";
            adopt(i, std::move(items), record);
            log::info("{:<12} unchanged", stage(i).name);
            if (stage(i).process->info().reads_many &&
                stage(i).process->info().output == OutputKind::Table)
                show_table(read_file(result_path(i, key), 1u << 28));
        } else {
            if (reason.empty()) reason = reason_to_run(i, now);
            log::detail("{}: {}", stage(i).name, reason);
            record = compute(i, std::move(items), now, key, start);
            log::info("{:<12} {:>8}  {}", stage(i).name, duration_text(seconds_now() - start),
                      summary_text(record.json["summary"]));
        }
        state_["last"][stage(i).name] = now;
        for (const std::string& name : stage(i).write) write_output(i, name);
        if (ExportingStage* exporting = exports(i)) exporting->done();
        if (const std::string why = record.json.value("stopped", ""); !why.empty())
            throw LimitExceeded(fmt::format("{}: {}", stage(i).name, why));
        release(i);
        return {{"name", stage(i).name},
                {"state", cached ? "cached" : "run"},
                {"reason", reason},
                {"seconds", seconds_now() - start},
                {"summary", record.json["summary"]}};
    }

    static std::string summary_text(const Json& summary)
    {
        std::vector<std::string> parts;
        for (const auto& [name, value] : summary.items()) {
            if (value.is_number_float())
                parts.push_back(fmt::format("{} {:.4g}", name, value.get<double>()));
            else
                parts.push_back(fmt::format(
                    "{} {}", name, value.is_string() ? value.get<std::string>() : value.dump()));
        }
        return fmt::format("{}", fmt::join(parts, ", "));
    }

    Record compute(std::size_t i, Items items, const Json& now, const std::string& key,
                   double start)
    {
        Stage& process = *stage(i).process;
        for (const std::string& name : process.makes()) drop(name);
        for (const std::string& name : reads(i, items))
            if (!process.info().reads_many) load(name, items.at(name));
        // What an optional input would be must not be there from another branch of the recipe.
        for (const std::string& name : process.uses())
            if (!items.contains(name)) drop(name);
        if (exports(i)) drop_others(items);
        const SceneOutline outline = inherited_outline(i);
        scene_.domain = outline.domain;
        scene_.heat_domain = outline.heat_domain;
        scene_.history.clear();
        for (const std::size_t k : ancestors(i))
            if (counts(k, i)) scene_.history.push_back(history_of(*stage(k).process, context(k)));

        StageContext c = context(i);
        c.checkpoint = cache_ / fmt::format("{}-{}.checkpoint", stage(i).name, key.substr(0, 16));
        // A sequence goes beside the scene that the stage writes.
        const auto scene_file =
            std::find_if(stage(i).write.begin(), stage(i).write.end(),
                         [](const std::string& name) { return name.ends_with(".vdb"); });
        Json frames = Json::object();
        const fs::path frames_file =
            cache_ / fmt::format("{}-{}.frames", stage(i).name, key.substr(0, 16));
        if (scene_file != stage(i).write.end() && wants_frames(i)) {
            // As whole as the scene itself: with what the stage does not read, too.
            for (const auto& [name, item] : items)
                if (stage(item.maker).process->info().output == OutputKind::Scene &&
                    !makes_item(process, name))
                    load(name, item);
            // A run that goes on does not write again what an interrupted one wrote.
            if (fs::exists(c.checkpoint)) {
                if (fs::exists(frames_file)) frames = read_record(frames_file);
                bool whole = frames.is_object();
                if (whole)
                    for (const auto& [name, hash] : frames.items())
                        whole = whole && fs::exists(recipe_.out / name) &&
                                file_hash(recipe_.out / name) == hash;
                if (!whole) {
                    frames = Json::object();
                    fs::remove(c.checkpoint);
                }
            }
            c.frame = [&](int number, const Scene& all) {
                const std::string name = frame_path(*scene_file, number).string();
                Scene frame;
                frame.domain = all.domain;
                frame.heat_domain = all.heat_domain;
                frame.history = all.history;
                frame.history.push_back(history_of(process, c));
                auto copy = [&](const std::string& item) {
                    if (const auto grid = all.grids.find(item); grid != all.grids.end())
                        frame.grids.insert(*grid);
                    if (const auto set = all.points.find(item); set != all.points.end())
                        frame.points.insert(*set);
                };
                for (const auto& [item, where] : items) copy(item);
                for (const std::string& item : process.makes()) copy(item);
                refuse_foreign(recipe_.out / name, name);
                state_["owned"][name] = "";
                save_state();
                write_vdb(recipe_.out / name, frame, {}, c.progress.slice(1, 1));
                frames[name] = file_hash(recipe_.out / name);
                state_["owned"][name] = frames[name];
                write_file(frames_file, sealed(frames));
            };
        }
        const Json summary =
            process.info().reads_many ? process.run_many(parents_of(i), c) : process.run(scene_, c);
        clear_progress_line();
        if (process.info().reads_many && process.info().output == OutputKind::Scene) {
            for (const std::string& name : process.makes())
                move_item(name, process.new_scene, scene_);
            scene_.domain = process.new_scene.domain;
            scene_.heat_domain = process.new_scene.heat_domain;
            process.new_scene = {};
        }

        // Keep the result: the file first, the record that vouches for it last.
        const fs::path result = result_path(i, key);
        const Progress keeping = c.progress.named("keeping the result");
        std::string mesh_hash;
        std::map<std::string, std::string> outputs;
        if (process.info().output == OutputKind::Picture)
            write_png(result, process.picture);
        else if (process.info().output == OutputKind::Table ||
                 process.info().output == OutputKind::Points)
            write_file(result, process.table);
        else if (process.info().output == OutputKind::Mesh) {
            const TriMesh& mesh = scene_.meshes.at("rock");
            const std::string bytes = encode_mesh(mesh, ".ply", keeping);
            outputs["rock"] = hash_hex(bytes);
            write_file(result, bytes, keeping);
        } else {
            Scene part;
            part.domain = scene_.domain;
            part.heat_domain = scene_.heat_domain;
            for (const std::string& name : process.makes()) move_item(name, scene_, part);
            try {
                for (const auto& [name, grid] : part.grids)
                    outputs[name] = content_hash(grid, keeping);
                for (const auto& [name, points] : part.points) outputs[name] = content_hash(points);
                if (const auto mesh = part.meshes.find("rock"); mesh != part.meshes.end()) {
                    const std::string bytes = encode_mesh(mesh->second, ".ply", keeping);
                    outputs["rock"] = mesh_hash = hash_hex(bytes);
                    write_file(mesh_path(i, key), bytes, keeping);
                }
                write_vdb(result, part, {}, keeping);
            } catch (...) {
                for (const std::string& name : process.makes()) move_item(name, part, scene_);
                throw;
            }
            for (const std::string& name : process.makes()) move_item(name, part, scene_);
        }
        clear_progress_line();
        for (const auto& [name, hash] : outputs) in_memory_[name] = {hash, key};

        double lava_voxels = outline.lava_voxels;
        if (process.info().name == "lava")
            lava_voxels = static_cast<double>(scene_.ints("region").active_count());
        double surface_cells = outline.surface_cells;
        if (const auto area = scene_.grids.find("surf_area"); area != scene_.grids.end())
            surface_cells = static_cast<double>(area->second.active_count());
        else if (surface_cells == 0) {
            SceneOutline made = outline;  // a lantern knows how many it will have
            process.estimate(made, c);
            surface_cells = made.surface_cells;
        }
        Record record{{{"key", key},
                       {"stage", process.info().name},
                       {"made_with", SEKITEI_VERSION},
                       {"ingredients", now},
                       {"outputs", outputs},
                       {"bytes", static_cast<std::uint64_t>(fs::file_size(result))},
                       {"file_hash", file_hash(result, keeping)},
                       {"domain", domain_json(scene_.domain)},
                       {"heat_domain", domain_json(scene_.heat_domain)},
                       {"lava_voxels", lava_voxels},
                       {"surface_cells", surface_cells},
                       {"frames", frames},
                       {"summary", summary},
                       {"stopped", process.stopped},
                       {"seconds", seconds_now() - start}}};
        if (!mesh_hash.empty()) record.json["mesh_hash"] = file_hash(mesh_path(i, key), keeping);
        if (makes_mesh(process))
            record.json["bounds"] = bounds_json(scene_.meshes.at("rock").bounds());
        write_file(record_path(i, key), sealed(record.json));
        std::error_code ignored;
        fs::remove(frames_file, ignored);
        adopt(i, std::move(items), record);
        return record;
    }

    /// One scene for each stage that stage i reads, with what i asks of it.
    std::vector<std::pair<std::string, Scene>> parents_of(std::size_t i)
    {
        std::vector<std::pair<std::string, Scene>> scenes;
        for (const std::size_t parent : stage(i).from) {
            Scene scene;
            scene.domain = outlines_[parent].domain;
            scene.heat_domain = outlines_[parent].heat_domain;
            scene.history = history(parent);
            for (const std::string& name : reads(i, visible_[parent])) {
                load(name, visible_[parent].at(name));
                move_item(name, scene_, scene);
                in_memory_.erase(name);
            }
            scenes.emplace_back(stage(parent).name, std::move(scene));
        }
        return scenes;
    }

    /// Whether stage i writes scenes on its way.
    bool wants_frames(std::size_t i) const { return stage(i).process->frame_interval() != 0; }
    static bool makes_item(Stage& process, const std::string& name)
    {
        const std::vector<std::string> names = process.makes();
        return std::find(names.begin(), names.end(), name) != names.end();
    }

    static void move_item(const std::string& name, Scene& from, Scene& to)
    {
        if (auto node = from.grids.extract(name)) to.grids.insert(std::move(node));
        if (auto node = from.points.extract(name)) to.points.insert(std::move(node));
        if (auto node = from.meshes.extract(name)) to.meshes.insert(std::move(node));
    }

    void drop(const std::string& name)
    {
        scene_.grids.erase(name);
        scene_.points.erase(name);
        scene_.meshes.erase(name);
        in_memory_.erase(name);
    }

    /// Leaves nothing in memory but these.
    void drop_others(const Items& items)
    {
        std::vector<std::string> names;
        for (const auto& [name, content] : in_memory_)
            if (!items.contains(name)) names.push_back(name);
        for (const std::string& name : names) drop(name);
    }

    /// Brings an item with this very content into memory.
    void load(const std::string& name, const Item& item)
    {
        // Grids of equal values may differ in the words that come with them.
        const std::string key = records_[item.maker].json["key"];
        const auto held = in_memory_.find(name);
        if (held != in_memory_.end() && held->second == std::pair(item.hash, key)) return;
        drop(name);
        const fs::path result = result_path(item.maker, key);
        const Progress reading = context(item.maker).progress.named("reading");
        if (stage(item.maker).process->info().output == OutputKind::Mesh ||
            (name == "rock" && records_[item.maker].json.contains("mesh_hash"))) {
            const fs::path mesh = mesh_path(item.maker, key);
            scene_.meshes[name] = decode_ply(read_file(mesh, 1ull << 36, reading), mesh.string());
        } else {
            ReadOptions read;
            read.only = {name};
            read.memory_limit = options_.memory_limit;
            // The file's own hash was compared when the record was found.
            read.check_hashes = false;
            Scene part = read_vdb(result, read, reading);
            move_item(name, part, scene_);
        }
        in_memory_[name] = {item.hash, key};
    }

    /// Frees what no later stage or output file needs.
    void release(std::size_t i)
    {
        std::set<std::string> wanted;
        std::vector<std::string> held;
        for (const auto& [name, content] : in_memory_) held.push_back(name);
        bool whole_scene = false;
        for (std::size_t k = i + 1; k < recipe_.stages.size(); ++k) {
            if (!selected_[k]) continue;
            for (const std::string& need : stage(k).process->needs()) wanted.insert(need);
            for (const std::string& name : stage(k).process->uses()) wanted.insert(name);
            if (const ExportingStage* exporting = exports(k))
                for (const std::string& name : exporting->chooses(held)) wanted.insert(name);
            for (const std::string& name : stage(k).write)
                whole_scene = whole_scene || fs::path(name).extension() == ".vdb";
        }
        std::vector<std::string> names;
        std::size_t bytes = 0;
        for (const auto& [name, content] : in_memory_)
            if (!wanted.contains(name)) {
                names.push_back(name);
                bytes += bytes_of(name);
            }
        // What only an output file needs is read again for it, where keeping it costs much.
        if (whole_scene && bytes < kWorthReading) return;
        for (const std::string& name : names) drop(name);
    }

    std::size_t bytes_of(const std::string& name) const
    {
        const auto grid = scene_.grids.find(name);
        if (grid == scene_.grids.end()) return 0;
        return std::visit(
            [](const auto& values) -> std::size_t {
                if constexpr (requires { values.memory_bytes(); })
                    return values.memory_bytes();
                else
                    return 0;
            },
            grid->second.values);
    }

    // ---- outputs --------------------------------------------------------------------------

    void write_output(std::size_t i, const std::string& name)
    {
        const fs::path target = recipe_.out / name;
        const std::string recipe_key = output_key(i, name);
        const Json old = state_.value("outputs", Json::object());
        const bool fresh = old.contains(name) && old[name].value("key", "") == recipe_key &&
                           fs::exists(target) &&
                           file_hash(target, context(i).progress) == old[name].value("hash", "");
        if (!fresh) {
            // Say that the name is ours before the file exists, so that a killed run can go on.
            state_["owned"][name] = "";
            save_state();
            produce(i, target);
            clear_progress_line();
            state_["outputs"][name] = {{"key", recipe_key},
                                       {"hash", file_hash(target, context(i).progress)}};
        }
        state_["owned"][name] = state_["outputs"][name]["hash"];
        save_state();
        written_.push_back({name, i});
    }

    std::string output_key(std::size_t i, const std::string& name) const
    {
        Json content = {
            {"name", name}, {"key", records_[i].json["key"]}, {"program", SEKITEI_VERSION}};
        if (fs::path(name).extension() == ".vdb") {
            for (const auto& [item, where] : visible_[i]) content["items"][item] = where.hash;
            for (const HistoryEntry& e : history(i))
                content["history"].push_back({e.stage, e.params, e.seed, e.inputs});
        }
        return hash_hex(content.dump());
    }

    void produce(std::size_t i, const fs::path& target)
    {
        const OutputKind kind = stage(i).process->info().output;
        const std::string suffix = target.extension().string();
        const Progress writing = context(i).progress.named("writing");
        if (kind == OutputKind::Picture || kind == OutputKind::Table ||
            (kind == OutputKind::Points && suffix == ".ply") ||
            (kind == OutputKind::Mesh && suffix == ".ply")) {  // the kept result itself
            write_file(target,
                       read_file(result_path(i, records_[i].json["key"]), 1ull << 36, writing),
                       writing);
        } else if (suffix == ".vdb") {
            Scene whole;
            for (const auto& [name, item] : visible_[i])
                if (stage(item.maker).process->info().output == OutputKind::Scene && name != "rock")
                    load(name, item);
            for (const auto& [name, item] : visible_[i]) move_item(name, scene_, whole);
            whole.domain = outlines_[i].domain;
            whole.heat_domain = outlines_[i].heat_domain;
            whole.history = history(i);
            auto give_back = [&] {
                for (const auto& [name, item] : visible_[i]) move_item(name, whole, scene_);
            };
            try {
                if (ExportingStage* exporting = exports(i))
                    exporting->write(whole, target, writing_context(i));
                else
                    write_vdb(target, whole, {}, writing);
            } catch (...) {
                give_back();
                throw;
            }
            give_back();
        } else if (ExportingStage* exporting = exports(i)) {
            drop_others(visible_[i]);
            for (const std::string& name : reads(i, visible_[i])) load(name, visible_[i].at(name));
            scene_.domain = outlines_[i].domain;
            scene_.heat_domain = outlines_[i].heat_domain;
            scene_.history = history(i);
            exporting->write(scene_, target, writing_context(i));
        } else {
            load("rock", visible_[i].at("rock"));
            write_mesh(target, scene_.meshes.at("rock"), writing);
        }
    }

    StageContext writing_context(std::size_t i) const
    {
        StageContext c = context(i);
        c.progress = c.progress.named("writing");
        return c;
    }

    void write_manifest()
    {
        Json outputs = Json::array();
        for (std::size_t i = 0; i < recipe_.stages.size(); ++i) {
            if (!selected_[i]) continue;
            const Json frames = records_[i].json.value("frames", Json::object());
            for (const auto& [name, hash] : frames.items()) written_.push_back({name, i});
        }
        for (const auto& [name, i] : written_) {
            std::optional<Bounds> bounds;
            if (const auto known = records_[i].json.find("bounds"); known != records_[i].json.end())
                bounds = bounds_from(*known);
            outputs.push_back(describe_output(recipe_.out / name, name, stage(i).name, bounds,
                                              console_progress("manifest")));
        }
        Json stages = Json::array();
        for (std::size_t i = 0; i < recipe_.stages.size(); ++i)
            if (selected_[i])
                stages.push_back({{"name", stage(i).name},
                                  {"stage", stage(i).process->info().name},
                                  {"seed", stage(i).seed},
                                  {"key", records_[i].json["key"]},
                                  {"summary", records_[i].json["summary"]}});
        keep_unselected(outputs, stages);
        Json recipe_content = Json::array();
        for (const Json& s : stages) recipe_content.push_back(s["key"]);
        manifest_ = {{"sekitei", SEKITEI_VERSION},
                     {"recipe_hash", hash_hex(recipe_content.dump())},
                     {"seed", recipe_.seed},
                     {"stages", stages},
                     {"outputs", outputs}};
        write_file(recipe_.out / "manifest.json", manifest_.dump(2) + "\n");
        save_state();
    }

    /// With --only, the manifest goes on listing what earlier runs made of the other stages, if it
    /// is still there.
    void keep_unselected(Json& outputs, Json& stages) const
    {
        const fs::path path = recipe_.out / "manifest.json";
        if (options_.only.empty() || !fs::exists(path)) return;
        const Json old = read_json(path);
        if (!old.is_object()) return;
        std::set<std::string> unselected;
        for (std::size_t i = 0; i < recipe_.stages.size(); ++i)
            if (!selected_[i]) unselected.insert(stage(i).name);
        // Somebody may have changed it: entries that are not ours are left out.
        auto members = [&](const char* list) { return old.value(list, Json::array()); };
        auto text = [](const Json& entry, const char* name) -> std::string {
            const bool there = entry.is_object() && entry.contains(name) && entry[name].is_string();
            return there ? entry[name].get<std::string>() : "";
        };
        for (const Json& entry : members("stages"))
            if (unselected.contains(text(entry, "name"))) stages.push_back(entry);
        for (const Json& entry : members("outputs")) {
            const fs::path file = recipe_.out / text(entry, "path");
            if (unselected.contains(text(entry, "stage")) && fs::is_regular_file(file) &&
                file_hash(file) == text(entry, "hash"))
                outputs.push_back(entry);
        }
    }

    /// Keeps the results of this run and the few newest older ones of each stage.
    void sweep_cache()
    {
        std::set<std::string> current;
        for (std::size_t i = 0; i < recipe_.stages.size(); ++i)
            if (records_[i].exists())
                current.insert(record_path(i, records_[i].json["key"]).filename().string());
        std::map<std::string, std::vector<std::pair<fs::file_time_type, fs::path>>> older;
        for (const auto& entry : fs::directory_iterator(cache_)) {
            const std::string name = entry.path().filename().string();
            const std::size_t dash = name.rfind('-');
            // A checkpoint without a record is of a run that was given up.
            const bool orphan = entry.path().extension() == ".checkpoint" &&
                                !fs::exists(fs::path(entry.path()).replace_extension(".json"));
            if ((entry.path().extension() != ".json" && !orphan) || dash == std::string::npos ||
                current.contains(name))
                continue;
            std::error_code error;
            older[name.substr(0, dash)].emplace_back(entry.last_write_time(error), entry.path());
        }
        for (auto& [name, files] : older) {
            std::sort(files.begin(), files.end(), std::greater<>());
            for (std::size_t k = kKeptResults; k < files.size(); ++k)
                for (const char* suffix :
                     {".json", ".vdb", ".ply", ".png", ".csv", ".checkpoint", ".frames"}) {
                    std::error_code error;
                    fs::remove(fs::path(files[k].second).replace_extension(suffix), error);
                }
        }
    }

    const Recipe& recipe_;
    RunOptions options_;
    fs::path cache_;
    std::unique_ptr<FolderLock> lock_;
    std::vector<bool> selected_;
    std::set<std::size_t> will_run_;
    std::vector<Items> visible_;
    std::vector<SceneOutline> outlines_;
    std::vector<Record> records_;
    Scene scene_;  // what is in memory now
    // Hash of each item's content, and the key of what made it.
    std::map<std::string, std::pair<std::string, std::string>> in_memory_;
    Json state_ = Json::object();
    Json manifest_;
    std::vector<std::pair<std::string, std::size_t>> written_;
};

}  // namespace

Json run_recipe(const Recipe& recipe, const RunOptions& options)
{
    return Runner(recipe, options).run();
}

Json describe_output(const fs::path& path, const std::string& name, const std::string& stage,
                     const std::optional<Bounds>& bounds, const Progress& progress)
{
    Json entry = {{"path", name},
                  {"stage", stage},
                  {"bytes", static_cast<std::uint64_t>(fs::file_size(path))},
                  {"hash", file_hash(path, progress)}};
    const std::string suffix = path.extension().string();
    if (suffix == ".vdb") {
        entry["kind"] = "scene";
        for (const VdbGridInfo& grid : inspect_vdb(path, progress).grids) {
            Json g = {{"name", grid.name},
                      {"type", grid.type},
                      {"unit", grid.unit},
                      {"class", grid.grid_class},
                      {"active_voxels", grid.active_voxels},
                      {"voxel_m", grid.voxel}};
            if (grid.active_voxels > 0)
                g["bounds_m"] = {{grid.lower.x, grid.lower.y, grid.lower.z},
                                 {grid.upper.x, grid.upper.y, grid.upper.z}};
            entry["grids"].push_back(std::move(g));
        }
    } else if (suffix == ".png")
        entry["kind"] = "picture";
    else if (suffix == ".csv")
        entry["kind"] = "table";
    else if (suffix == ".json")
        entry["kind"] = "notes";
    else if (suffix == ".mtl")
        entry["kind"] = "materials";
    else {
        const bool points = suffix == ".ply" && !has_faces(path);
        entry["kind"] = points ? "points" : "mesh";
        entry["unit"] = "m";
        entry["up"] = suffix == ".glb" ? "y" : "z";
        if (suffix == ".ply" && !points) {
            const Bounds b =
                bounds ? *bounds : decode_ply(read_file(path, 1ull << 36, progress), name).bounds();
            if (!b.empty()) entry["bounds_m"] = bounds_json(b);
        } else if (!points && bounds && !bounds->empty())
            entry["bounds_m"] = bounds_json(*bounds);
    }
    return entry;
}

std::vector<std::string> verify_manifest(const fs::path& manifest)
{
    Json json;
    try {
        json = parse_json(read_file(manifest, 1u << 28));
    } catch (const Json::exception& error) {
        throw InvalidInput(fmt::format("{}: not a manifest: {}", manifest.string(), error.what()));
    }
    if (!json.is_object() || !json.contains("outputs") || !json["outputs"].is_array())
        throw InvalidInput(
            fmt::format("{}: not a manifest, it has no list `outputs`", manifest.string()));
    std::vector<std::string> wrong;
    for (const Json& entry : json["outputs"]) {
        if (!entry.contains("path") || !entry["path"].is_string() || !entry.contains("hash"))
            throw InvalidInput(
                fmt::format("{}: an output without path or hash", manifest.string()));
        const std::string name = entry["path"];
        const fs::path path = manifest.parent_path() / name;
        if (!fs::exists(path))
            wrong.push_back(name + " (missing)");
        else if (file_hash(path) != entry["hash"])
            wrong.push_back(name);
    }
    return wrong;
}

}  // namespace sekitei::apps
