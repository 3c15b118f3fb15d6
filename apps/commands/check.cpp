#include <fmt/format.h>
#include <fmt/ranges.h>

#include "apps/commands/commands.h"
#include "apps/recipe.h"
#include "core/error.h"
#include "core/log.h"

namespace sekitei::apps {

int command_check(const std::vector<std::string>& recipes,
                  const std::vector<std::string>& overrides, const Common& common)
{
    std::vector<std::string> errors;
    ExitCode code = ExitCode::BadInput;  // of missing files alone; a mistake in a recipe outweighs
                                         // them, as in `run`
    Json report = Json::array();
    for (const std::string& file : recipes) {
        try {
            const Recipe recipe = read_recipe(file, overrides);
            require_input_files(recipe, std::vector<bool>(recipe.stages.size(), true));
            report.push_back(
                {{"recipe", file}, {"stages", recipe.stages.size()}, {"errors", Json::array()}});
            log::info("{}: good, {} stages", file, recipe.stages.size());
        } catch (const InvalidInput& error) {
            if (error.code() == ExitCode::Usage) code = ExitCode::Usage;
            errors.emplace_back(error.what());
            report.push_back({{"recipe", file}, {"errors", {error.what()}}});
        }
    }
    if (common.json) print(report.dump(2) + "\n");
    if (!errors.empty()) throw InvalidInput(fmt::format("{}", fmt::join(errors, "\n")), code);
    return 0;
}

}  // namespace sekitei::apps
