#include <fmt/format.h>

#include "apps/commands/commands.h"
#include "apps/recipe.h"
#include "core/error.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {

int command_replay(const std::string& file, bool every_value)
{
    const VdbFileInfo info = inspect_vdb(file);
    if (info.history.empty())
        throw InvalidInput(fmt::format(
            "{}: carries no history (sekitei:history); only files of this program can be replayed",
            file));
    print(recipe_from_history(info.history, std::filesystem::path(file).filename().string(),
                              every_value));
    return 0;
}

}  // namespace sekitei::apps
