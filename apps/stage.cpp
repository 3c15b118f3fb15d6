#include "apps/stage.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/file_output.h"

namespace sekitei::apps {
namespace {

using Factory = std::unique_ptr<Stage> (*)();
constexpr Factory kFactories[] = {make_lava, make_cool, make_joint, make_weather, make_mesh, make_render};

}  // namespace

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
    throw InvalidParameter(fmt::format("there is no stage '{}', expected one of: {}{}", name,
                                       fmt::join(names, ", "),
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
    return hashes;
}

HistoryEntry history_of(Stage& stage, const StageContext& context)
{
    return {stage.info().name, stage.info().version, params_json(stage.params()), context.seed,
            input_hashes(stage, context)};
}

void check_memory(const std::string& who, double bytes, double limit)
{
    if (limit > 0 && bytes > limit)
        throw LimitExceeded(fmt::format("{}: needs about {} of memory, the limit is {}; raise it with "
                                        "--memory or make the voxels larger",
                                        who, bytes_text(bytes), bytes_text(limit)));
}

}  // namespace sekitei::apps
