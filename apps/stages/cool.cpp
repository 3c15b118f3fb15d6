#include <filesystem>

#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "solvers/cooling/cooling.h"
#include "solvers/lava/lava.h"

namespace sekitei::apps {
namespace {

/// What the lava preset of this scene recommends; generic values without one.
lava::PresetDefaults recommended(const Scene& scene)
{
    if (const Json* made = params_of(scene, "lava")) {
        lava::Params params;
        const ParamList list = describe_params(params);
        if (made->contains("preset")) find_param(list, "preset")->set((*made)["preset"]);
        return lava::preset_defaults(params.preset);
    }
    lava::PresetDefaults unknown;
    unknown.generic = true;
    return unknown;
}

/// Two buffers, gradients and the scene's own grids.
constexpr double kBytesPerCell = 100;

class CoolStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "cool",
            "1",
            "cool the lava: temperature and its gradient",
            OutputKind::Scene,
            true,
            {"region_coarse"},
            {"temperature", "temperature_gradient", "temperature_gradient_mag"},
            false,
            {"lava.preset"}};
        return kInfo;
    }

    ParamList params() override { return describe_params(params_); }
    void validate() override { cooling::validate(params_); }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        const double cells = outline.heat_domain.voxel_count();
        return {cells, cells * kBytesPerCell, cells * 20};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        const IntGrid& region = scene.ints("region_coarse");
        const lava::PresetDefaults defaults = recommended(scene);
        const int steps = defaults.generic
                              ? cooling::suitable_steps(region, scene.heat_domain, params_.alpha,
                                                        defaults.heat_steps)
                              : defaults.heat_steps;
        const cooling::Inputs inputs{region, scene.heat_domain, steps, defaults.plateau_share};
        check_memory("cool", scene.heat_domain.voxel_count() * kBytesPerCell, context.memory_limit);

        cooling::Checkpoint checkpoint;
        if (!context.checkpoint.empty()) {
            checkpoint.save = [&](const std::string& bytes) {
                write_file(context.checkpoint, bytes);
            };
            if (std::filesystem::exists(context.checkpoint)) {
                checkpoint.resume = read_file(context.checkpoint);
                if (checkpoint.resume.empty())
                    throw InvalidInput(
                        context.checkpoint.string() +
                        ": empty, expected a checkpoint of cool: remove it to begin again");
            }
        }
        cooling::Result result = [&] {
            try {
                return cooling::run(inputs, params_, checkpoint, context.progress);
            } catch (const InvalidInput& error) {
                // The solver knows the checkpoint's bytes, not where they came from.
                const std::string_view what = error.what();
                if (checkpoint.resume.empty() || what.find("checkpoint") == std::string_view::npos)
                    throw;
                throw InvalidInput(context.checkpoint.string() + ": " + error.what(), error.code());
            }
        }();
        if (!context.checkpoint.empty()) {
            std::error_code ignored;
            std::filesystem::remove(context.checkpoint, ignored);
        }
        scene.put("temperature", std::move(result.temperature), "K", "cool");
        scene.put("temperature_gradient", std::move(result.gradient), "", "cool",
                  "covariant normalize");
        scene.put("temperature_gradient_mag", std::move(result.gradient_magnitude), "K/cell",
                  "cool");
        return {{"steps", result.steps}, {"last_change_K", result.last_change}};
    }

private:
    cooling::Params params_;
};

}  // namespace

std::unique_ptr<Stage> make_cool()
{
    return std::make_unique<CoolStage>();
}

}  // namespace sekitei::apps
