#include "apps/stage.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "apps/stages/stages.h"
#include "core/csv.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"

namespace sekitei::apps {
namespace {

using Factory = std::unique_ptr<Stage> (*)();
constexpr Factory kFactories[] = {make_lava,   make_cool,         make_joint,      make_weather,
                                  make_mesh,   make_lantern,      make_garden,     make_light,
                                  make_wind,   make_soil,         make_moss,       make_tree,
                                  make_forest, make_render,       make_statistics, make_plot,
                                  make_sketch, make_distribution, make_compare,    make_export};

}  // namespace

Json Stage::run_many(const std::vector<std::pair<std::string, Scene>>&, const StageContext&)
{
    throw Error(ExitCode::Bug, fmt::format("the stage '{}' reads one scene", info().name));
}

int Stage::frame_interval()
{
    const ParamList list = params();
    const Param* every = find_param(list, "every");
    return every ? every->get().get<int>() : 0;
}

const std::vector<StageInfo>& stage_infos()
{
    static const std::vector<StageInfo> infos = [] {
        std::vector<StageInfo> list;
        for (const Factory make : kFactories) list.push_back(make()->info());
        return list;
    }();
    return infos;
}

std::unique_ptr<Stage> make_stage(const std::string& name)
{
    for (std::size_t i = 0; i < stage_infos().size(); ++i)
        if (stage_infos()[i].name == name) return kFactories[i]();
    std::vector<std::string> names;
    for (const StageInfo& info : stage_infos()) names.push_back(info.name);
    const std::string near = nearest_name(name, names);
    throw InvalidParameter(
        fmt::format("there is no stage '{}', expected one of: {}{}", name, fmt::join(names, ", "),
                    near.empty() ? "" : fmt::format(" (did you mean '{}'?)", near)));
}

const StageInfo& stage_info(const std::string& name)
{
    for (const StageInfo& info : stage_infos())
        if (info.name == name) return info;
    make_stage(name);  // throws with the nearest name
    throw InvalidParameter("unknown stage " + name);
}

Json input_hashes(Stage& stage, const StageContext& context)
{
    Json hashes = Json::object();
    for (const Param& param : stage.params()) {
        if (param.kind != Param::Kind::Path) continue;
        const std::string path = param.get().get<std::string>();
        if (path.empty()) continue;
        hashes[path] = file_hash(Stage::resolve(context, path));
    }
    for (const std::filesystem::path& path : stage.files())
        hashes[path.string()] = file_hash(Stage::resolve(context, path));
    return hashes;
}

HistoryEntry history_of(Stage& stage, const StageContext& context)
{
    // What else is written, and where, is no part of how the scene was made.
    Json params = params_json(stage.params());
    std::vector<std::filesystem::path> beside = stage.side_files();
    for (const std::filesystem::path& folder : stage.side_folders()) beside.push_back(folder);
    for (const std::filesystem::path& file : beside)
        for (const Param& p : stage.params())
            if (params[p.name] == Json(file.string())) params[p.name] = "";
    return {stage.info().name, stage.info().version, std::move(params), context.seed,
            input_hashes(stage, context)};
}

const Json* params_of(const Scene& scene, const std::string& stage)
{
    for (auto entry = scene.history.rbegin(); entry != scene.history.rend(); ++entry)
        if (entry->stage == stage) return &entry->params;
    return nullptr;
}

void log_mesh_report(const std::filesystem::path& file, const MeshReadReport& report)
{
    for (const std::string& warning : report.warnings) log::warning("{}", warning);
    if (report.dropped_zero_area > 0)
        log::warning("{}: dropped {} triangles without area", file.string(),
                     report.dropped_zero_area);
    if (report.flipped_triangles > 0)
        log::warning("{}: turned {} triangles so that all face outwards", file.string(),
                     report.flipped_triangles);
    if (report.merged_vertices > 0)
        log::detail("{}: joined {} equal vertices", file.string(), report.merged_vertices);
    if (report.split_polygons > 0)
        log::detail("{}: split {} polygons into triangles", file.string(), report.split_polygons);
}

void tell_of_textures(const std::filesystem::path& file, const MeshReadReport& report)
{
    constexpr std::size_t kShown = 3;
    // The names come out of a file.
    const auto printable = [](const std::filesystem::path& path) {
        std::string text = path.string();
        std::replace_if(
            text.begin(), text.end(), [](unsigned char c) { return c < ' ' || c == 0x7F; }, '?');
        return text;
    };
    if (!report.textures.empty()) {
        std::vector<std::string> names;
        std::error_code unknown;
        for (const auto& texture : report.textures)
            if (names.size() < kShown)
                names.push_back(printable(texture) + (std::filesystem::exists(texture, unknown)
                                                          ? ""
                                                          : " (which is not there)"));
        const std::filesystem::path& first = report.textures.front();
        log::info(
            "{}: its materials name the texture {}{}, which is not used by itself; moss takes the "
            "soils from its colours with --texture {}{}",
            file.string(), fmt::join(names, ", "),
            report.textures.size() > kShown
                ? fmt::format(" and {} more", report.textures.size() - kShown)
                : "",
            printable(std::filesystem::path(first).replace_extension(".png")),
            first.extension() == ".png" ? "" : ", once it is a PNG");
    } else if (!report.lost_materials.empty())
        log::info(
            "{}: it has texture coordinates, but its materials {} cannot be read; moss takes the "
            "soils from the colours of a texture with --texture FILE.png",
            file.string(), printable(report.lost_materials.front()));
}

bool makes_mesh(Stage& stage)
{
    const std::vector<std::string> made = stage.makes();
    return std::find(made.begin(), made.end(), "rock") != made.end();
}

InvalidInput named_after(const std::string& file, const InvalidInput& error)
{
    const std::string what = error.what();
    if (file.empty() || error.code() != ExitCode::BadInput || what.find(file) != std::string::npos)
        return error;
    return InvalidInput(file + ": " + what, error.code());
}

std::string maker_hint(const std::string& item)
{
    std::vector<std::string> makers;
    for (const StageInfo& info : stage_infos())
        for (const std::string& made : info.makes)
            if (made == item) makers.push_back(fmt::format("`sekitei {}`", info.name));
    return makers.empty() ? "" : fmt::format("; run {} first", fmt::join(makers, " or "));
}

void require_needs(Stage& stage, const Scene& scene)
{
    std::vector<std::string> present;
    for (const auto& [name, grid] : scene.grids) present.push_back(name);
    for (const auto& [name, points] : scene.points) present.push_back(name);
    for (const auto& [name, mesh] : scene.meshes) present.push_back(name);
    std::vector<std::string> missing;
    for (const std::string& need : stage.needs())
        if (std::find(present.begin(), present.end(), need) == present.end())
            missing.push_back("'" + need + "'");
    if (missing.empty()) return;
    const std::string first = missing.front().substr(1, missing.front().size() - 2);
    throw InvalidInput(fmt::format(
        "{}: the scene has no {}, present: {}{}", stage.info().name, fmt::join(missing, ", "),
        present.empty() ? "nothing" : fmt::format("{}", fmt::join(present, ", ")),
        maker_hint(first)));
}

bool blames_own_file(Stage& stage, const StageContext& context, std::string_view message)
{
    std::vector<std::filesystem::path> files = stage.files();
    for (const Param& param : stage.params())
        if (param.kind == Param::Kind::Path) files.emplace_back(param.get().get<std::string>());
    return std::any_of(files.begin(), files.end(), [&](const std::filesystem::path& file) {
        return !file.empty() && message.starts_with(Stage::resolve(context, file).string() + ":");
    });
}

void show_table(const std::string& csv)
{
    std::vector<std::vector<std::string>> rows;
    std::vector<std::size_t> width;
    CsvReader reader(csv);
    std::vector<CsvCell> cells;
    for (std::string_view line; reader.next_line(line);) {
        CsvReader::split(line, ',', cells);
        rows.emplace_back();
        for (std::size_t k = 0; k < cells.size(); ++k) {
            rows.back().emplace_back(cells[k].text);
            width.resize(std::max(width.size(), k + 1));
            width[k] = std::max(width[k], cells[k].text.size());
        }
    }
    for (const std::vector<std::string>& row : rows) {
        std::string text;
        for (std::size_t k = 0; k < row.size(); ++k)
            text += k > 0 && number_of(row[k]) ? fmt::format("{:>{}}  ", row[k], width[k])
                                               : fmt::format("{:<{}}  ", row[k], width[k]);
        log::info("{}", text);
    }
}

std::filesystem::path frame_path(const std::filesystem::path& file, int number)
{
    std::filesystem::path path = file;
    return path.replace_extension(fmt::format(".{:04}{}", number, file.extension().string()));
}

void warn_unused(Stage& stage, const std::vector<std::string>& names, const std::string& why)
{
    const auto fresh = make_stage(stage.info().name);
    const ParamList now = stage.params(), usual = fresh->params();
    for (const std::string& name : names)
        if (find_param(now, name)->get() != find_param(usual, name)->get())
            log::warning("{}: {} = {} has no effect {}", stage.info().name, name,
                         find_param(now, name)->value_text(), why);
}

void check_memory(const std::string& who, double bytes, double limit, std::string_view instead)
{
    if (limit > 0 && bytes > limit)
        throw LimitExceeded(
            fmt::format("{}: needs about {} of memory, the limit is {}; raise it with "
                        "--memory or {}",
                        who, bytes_text(bytes), bytes_text(limit), instead));
}

}  // namespace sekitei::apps
