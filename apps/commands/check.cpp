#include <fmt/format.h>
#include <fmt/ranges.h>

#include "apps/commands/commands.h"
#include "apps/recipe.h"
#include "core/error.h"
#include "core/log.h"

namespace sekitei::apps {

int command_check(const std::vector<std::string>& recipes, const std::vector<std::string>& overrides, const Common& common)
{
    std::vector<std::string> errors;
    Json report = Json::array();
    for (const std::string& file : recipes) {
        try {
            const Recipe recipe = read_recipe(file, overrides);
            std::vector<std::string> missing;  // every file it names must be there
            for (const RecipeStage& stage : recipe.stages) {
                StageContext context;
                context.folder = recipe.folder;
                try {
                    input_hashes(*stage.process, context);
                } catch (const InvalidInput& error) {
                    missing.push_back(fmt::format("{}: {}: {}", stage.place, stage.name, error.what()));
                }
            }
            if (!missing.empty()) throw InvalidParameter(fmt::format("{}", fmt::join(missing, "\n")));
            report.push_back({{"recipe", file}, {"stages", recipe.stages.size()}, {"errors", Json::array()}});
            log::info("{}: good, {} stages", file, recipe.stages.size());
        } catch (const InvalidInput& error) {
            errors.emplace_back(error.what());
            report.push_back({{"recipe", file}, {"errors", {error.what()}}});
        }
    }
    if (common.json) print(report.dump(2) + "\n");
    if (!errors.empty()) throw InvalidParameter(fmt::format("{}", fmt::join(errors, "\n")));
    return 0;
}

}  // namespace sekitei::apps
