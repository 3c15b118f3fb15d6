#include <chrono>

#include "apps/commands/commands.h"
#include "apps/console.h"
#include "apps/runner.h"
#include "core/error.h"
#include "core/log.h"

namespace sekitei::apps {

int command_run(const std::string& file, const std::vector<std::string>& overrides,
                const std::set<std::string>& only, bool dry_run, const Common& common)
{
    const auto start = std::chrono::steady_clock::now();
    const Recipe recipe = read_recipe(file, overrides);
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
    if (common.json) print(summary.dump(2) + "\n");
    return 0;
}

}  // namespace sekitei::apps
