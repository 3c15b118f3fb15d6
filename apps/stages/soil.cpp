#include "apps/climate.h"
#include "apps/habitat.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/parallel.h"

namespace sekitei::apps {
namespace {

class SoilStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{"soil",
                                     "1",
                                     "warmth, humidity and water of bare ground, day by day",
                                     OutputKind::Scene,
                                     true,
                                     climate_needs(),
                                     {"geology", "soil_h", "soil_water", "soil_theta", "soil_beta",
                                      "soil_Ts", "soil_rh", "soil_E", "soil_runoff", "statistics"},
                                     false,
                                     {"light"}};
        return kInfo;
    }
    std::vector<std::string> uses() override
    {
        std::vector<std::string> names = climate_uses();
        names.push_back("light_S");
        return names;
    }
    std::vector<std::filesystem::path> files() override
    {
        const std::filesystem::path file(params_.soil);
        return file.extension() == ".toml" ? std::vector{file}
                                           : std::vector<std::filesystem::path>{};
    }
    ParamList params() override { return describe(params_); }
    void validate() override
    {
        apps::validate(params_);
        if (std::filesystem::path(params_.soil).extension() != ".toml") find_soil(params_.soil, {});
    }

    void check_files(const StageContext& context) override
    {
        find_soil(params_.soil, context.folder);
    }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        return {outline.surface_cells, memory(outline.surface_cells), outline.surface_cells * 60};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        // What an earlier run of this stage made is not given by anybody.
        for (const char* name : {"geology", "soil_h"})
            if (const auto grid = scene.grids.find(name);
                grid != scene.grids.end() &&
                (grid->second.stage == "soil" || grid->second.stage == "moss"))
                scene.grids.erase(grid);
        const Climate climate(scene, params_, context.folder, context.progress.slice(0, 0.2));
        const SurfaceCells& cells = climate.cells();
        const std::size_t n = cells.size(), days = climate.weather().days.size();
        check_memory("soil", memory(double(n)), context.memory_limit);
        std::vector<double> water = climate.ground().initial_water();
        GroundMeans means(climate.ground());
        Statistics statistics(0);
        if (scene.has("light_S"))
            statistics.choose(cells, cells.from_grid(scene.floats("light_S"), 0),
                              scene.domain.dims.z > 0 ? scene.domain.transform.origin.z : 0);
        ClimateDay day;
        const Progress progress = context.progress.slice(0.2, 1);
        for (std::size_t d = 0; d < days; ++d) {
            climate.advance(d, water, {}, day, progress.slice(1, 1));
            means.add(day, water);
            statistics.add(int(d) + 1, climate.ground(), day, day.light.total, water, {});
            progress.update(double(d + 1) / double(days));
        }
        means.put(scene, cells, "soil");
        put_water(scene, climate, water, "soil");
        label(scene, makes(), days, params_.profile, context.seed);
        scene.points["statistics"] = statistics.points("soil");
        Json summary = means.summary();
        summary["cells"] = n;
        summary["days"] = days;
        summary["largest_balance_error"] = statistics.largest_balance_error();
        if (!climate.ground().has_wind()) summary["wind"] = "as in the weather: no wind stage ran";
        return summary;
    }

private:
    static double memory(double cells) { return 1.5e8 + cells * 700; }

    ClimateParams params_;
};

}  // namespace

std::unique_ptr<Stage> make_soil()
{
    return std::make_unique<SoilStage>();
}

}  // namespace sekitei::apps
