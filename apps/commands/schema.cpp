#include <fmt/format.h>
#include <fmt/ranges.h>

#include "apps/commands/commands.h"
#include "apps/stage.h"

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

std::string reference(const StageInfo& info)
{
    std::string text = fmt::format("## {}\n\n{}.\n\n", info.name, info.summary);
    text[text.find(info.summary)] = static_cast<char>(std::toupper(info.summary.front()));
    if (!info.needs.empty()) text += fmt::format("Needs `{}`. ", fmt::join(info.needs, "`, `"));
    if (!info.makes.empty()) text += fmt::format("Makes `{}`.", fmt::join(info.makes, "`, `"));
    text += "\n\n| parameter | default | values | meaning |\n|---|---|---|---|\n";
    const auto stage = make_stage(info.name);
    for (const Param& p : stage->params()) {
        std::string type = p.type_text();
        for (std::size_t at = 0; (at = type.find('|', at)) != std::string::npos; at += 2)
            type.insert(at, "\\");
        text += fmt::format("| `{}` | {} | {} | {} |\n", p.name, p.value_text(), type, p.help);
    }
    return text + "\n";
}

}  // namespace

int command_schema(const std::string& only, bool markdown)
{
    std::vector<StageInfo> infos = stage_infos();
    if (!only.empty()) infos = {stage_info(only)};
    if (markdown) {
        std::string text =
            "# Reference\n\nEvery stage with its parameters: recipe keys, and with `--` and "
            "hyphens the options of the\n"
            "command of the same name. Made by `sekitei schema --markdown`.\n\n"
            "A scene about a mesh, as `light` and `moss` make of one, has its mesh beside it: "
            "`-o x.vdb` and the recipe\n"
            "line `write = \"x.vdb\"` write x.ply too. A list writes only what it names: "
            "`write = [\"x.vdb\"]` leaves the\n"
            "mesh out, and nothing can draw such a scene; `write = [\"x.vdb\", \"x.ply\"]` names "
            "both.\n\n";
        for (const StageInfo& info : infos) text += reference(info);
        text.pop_back();
        print(text);
        return 0;
    }
    Json stages = Json::object();
    for (const StageInfo& info : infos) stages[info.name] = stage_schema(info);
    const Json schema = {{"$schema", "https://json-schema.org/draft/2020-12/schema"},
                         {"title", "Sekitei recipe"},
                         {"type", "object"},
                         {"required", {"sekitei"}},
                         {"properties",
                          {{"sekitei", {{"const", 1}}},
                           {"seed", {{"type", "integer"}, {"minimum", 0}, {"default", 1}}},
                           {"out", {{"type", "string"}, {"description", "output folder"}}}}},
                         {"stages", stages}};
    print(schema.dump(2) + "\n");
    return 0;
}

}  // namespace sekitei::apps
