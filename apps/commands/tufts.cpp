#include "apps/render/tufts.h"

#include <fmt/format.h>

#include <filesystem>
#include <vector>

#include "apps/commands/commands.h"
#include "apps/stage.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"

namespace sekitei::apps {

int command_tufts(const std::vector<std::string>& species, double growth, const Common& common)
{
    if (common.output.size() != 1 || !std::filesystem::is_directory(common.output.front()))
        throw InvalidParameter("tufts: say with -o FOLDER into which existing folder");
    const std::filesystem::path folder = common.output.front();
    for (const std::string& name : species)
        if (name.empty() || name.find_first_of("/\\") != std::string::npos)
            throw InvalidParameter(fmt::format("tufts: --species {}: must be a name", name));
    const auto files = render::tuft_files(species, static_cast<float>(growth));
    for (const render::TuftFile& file : files)
        if (!common.force && std::filesystem::exists(folder / file.name))
            throw InvalidParameter(
                fmt::format("{} exists; replace it with --force", (folder / file.name).string()));
    for (const render::TuftFile& file : files) write_file(folder / file.name, file.bytes);
    if (common.json) {
        Json names = Json::array();
        for (const render::TuftFile& file : files) names.push_back((folder / file.name).string());
        print(Json{{"files", names}}.dump(2) + "\n");
    }
    log::info("wrote {} models into {}", files.size(), folder.string());
    return 0;
}

}  // namespace sekitei::apps
