#include <fmt/format.h>

#include <chrono>

#include "apps/commands/commands.h"
#include "apps/console.h"
#include "apps/runner.h"
#include "core/error.h"
#include "core/log.h"

namespace sekitei::apps {

namespace {

Json run_one(const Recipe& recipe, const std::set<std::string>& only, bool dry_run,
             const Common& common)
{
    const auto start = std::chrono::steady_clock::now();
    RunOptions options;
    options.only = only;
    options.dry_run = dry_run;
    options.force = common.force;
    options.memory_limit = common.memory_limit;
    options.fix_nan = common.fix_nan;
    const Json summary = [&] {
        try {
            return run_recipe(recipe, options);
        } catch (const Cancelled&) {
            log::info("finished stages are kept; the same command goes on from there");
            throw;
        }
    }();
    if (!dry_run) {
        const double seconds =
            std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
        for (const Json& output : summary["outputs"])
            log::info("wrote {}", (recipe.out / output["path"].get<std::string>()).string());
        log::info("wrote {} ({})", (recipe.out / "manifest.json").string(), duration_text(seconds));
    }
    return summary;
}

}  // namespace

int command_run(const std::vector<std::string>& files, const std::vector<std::string>& overrides,
                const std::set<std::string>& only, bool dry_run, const Common& common)
{
    // A mistake in the last recipe is told before the first one runs.
    std::vector<Recipe> recipes;
    for (const std::string& file : files) {
        recipes.push_back(read_recipe(file, overrides));
        for (std::size_t k = 0; k + 1 < recipes.size(); ++k)
            if (recipes[k].out.lexically_normal() == recipes.back().out.lexically_normal())
                throw InvalidParameter(fmt::format("{} and {} both write into {}", files[k], file,
                                                   recipes[k].out.string()));
    }
    Json summaries = Json::array();
    for (std::size_t k = 0; k < recipes.size(); ++k) {
        if (recipes.size() > 1) log::info("{}", files[k]);
        summaries.push_back(run_one(recipes[k], only, dry_run, common));
    }
    if (common.json) print((recipes.size() == 1 ? summaries[0] : summaries).dump(2) + "\n");
    return 0;
}

}  // namespace sekitei::apps
