#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "apps/commands/commands.h"
#include "apps/scene_items.h"
#include "apps/stage.h"
#include "core/error.h"
#include "core/file_output.h"

namespace sekitei::apps {
namespace {

Json stage_schema(const StageInfo& info)
{
    const auto stage = make_stage(info.name);
    Json properties = params_schema(stage->params());
    properties["stage"] = {{"const", info.name}};
    properties["from"] = {{"description", "stages it reads; default: the one above"},
                          {"type", {"string", "array"}}};
    properties["write"] = {
        {"description",
         "files to write into the output folder; \"x.vdb\" by itself also "
         "writes x.ply where the scene is about a mesh, a list only what it names"},
        {"type", {"string", "array"}}};
    properties["seed"] = {{"description", "of this stage; default: the recipe's"},
                          {"type", "integer"},
                          {"minimum", 0}};
    return {{"title", info.name},       {"description", info.summary},   {"type", "object"},
            {"properties", properties}, {"additionalProperties", false}, {"needs", info.needs},
            {"makes", info.makes}};
}

Json item_schema(const SceneItem& item)
{
    constexpr const char* kKinds[] = {"grid", "points", "mesh"};
    constexpr const char* kClasses[] = {"unknown", "level set", "fog volume"};
    Json json = {{"name", item.name},
                 {"kind", kKinds[static_cast<std::size_t>(item.kind)]},
                 {"type", item.type},
                 {"unit", item.unit},
                 {"class", kClasses[static_cast<std::size_t>(item.grid_class)]},
                 {"description", item.meaning}};
    for (const SceneItem::Attribute& a : item.attributes)
        json["attributes"].push_back(
            {{"name", a.name}, {"type", a.type}, {"unit", a.unit}, {"description", a.meaning}});
    return json;
}

}  // namespace

int command_schema(const std::string& only, SchemaForm form, const CommandPages& pages,
                   const Common& common)
{
    if (!common.output.empty() && form != SchemaForm::Man)
        throw InvalidParameter("schema: --output: only with --man; else use > FILE");
    if (form == SchemaForm::Man) {
        const std::vector<std::string> names = man_page_names(pages);
        if (common.output.empty()) {
            const std::string name = only.empty() ? "sekitei.1" : "sekitei-" + only + ".1";
            if (std::find(names.begin(), names.end(), name) == names.end()) stage_info(only);
            print(man_page(pages, name));
            return 0;
        }
        const std::filesystem::path folder = common.output.front();
        if (!std::filesystem::is_directory(folder))
            throw IoError(fmt::format("{}: no such folder", folder.string()));
        for (const std::string& name : names)
            if (!common.force && std::filesystem::exists(folder / name))
                throw IoError(
                    fmt::format("{}: exists; --force replaces it", (folder / name).string()));
        for (const std::string& name : names) write_file(folder / name, man_page(pages, name));
        return 0;
    }
    if (form == SchemaForm::Markdown) {
        if (!only.empty() && std::none_of(pages.begin(), pages.end(), [&](const CommandPage& page) {
                return page.name == only;
            }))
            stage_info(only);  // throws with the nearest name
        print(markdown_reference(pages, only));
        return 0;
    }
    std::vector<StageInfo> infos = stage_infos();
    if (!only.empty()) infos = {stage_info(only)};
    Json stages = Json::object();
    for (const StageInfo& info : infos) stages[info.name] = stage_schema(info);
    Json items = Json::array();
    for (const SceneItem& item : scene_items()) items.push_back(item_schema(item));
    const Json schema = {{"$schema", "https://json-schema.org/draft/2020-12/schema"},
                         {"title", "Sekitei recipe"},
                         {"type", "object"},
                         {"required", {"sekitei"}},
                         {"properties",
                          {{"sekitei", {{"const", 1}}},
                           {"seed", {{"type", "integer"}, {"minimum", 0}, {"default", 1}}},
                           {"out", {{"type", "string"}, {"description", "output folder"}}}}},
                         {"stages", stages},
                         {"scene", items}};
    print(schema.dump(2) + "\n");
    return 0;
}

}  // namespace sekitei::apps
