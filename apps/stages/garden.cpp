#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <optional>

#include "apps/garden/plot.h"
#include "apps/ground.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/image.h"

namespace sekitei::apps {
namespace {

class GardenStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo = [] {
            StageInfo info{"garden",
                           "1",
                           "set rocks, a lantern and a pond on a piece of ground",
                           OutputKind::Scene,
                           true,
                           {"density"},
                           {"surface_sdf", "geology", "soil_h", "water_surface", "ground_height",
                            "blocked_height", "plantable", "rock"},
                           true};
            info.reads_if_given = true;
            return info;
        }();
        return kInfo;
    }
    bool reads_scene() override { return false; }
    std::vector<std::string> uses() override { return {"column", "component", "surface"}; }
    std::vector<std::string> makes() override
    {
        std::vector<std::string> names = info().makes;
        if (params_.pond.empty()) std::erase(names, "water_surface");
        return names;
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        // How many scenes there are is known when they are read.
        garden::validate(params_, std::numeric_limits<std::size_t>::max());
        if (params_.pond.empty()) warn_unused(*this, {"depth", "bank", "shore"}, "without a pond");
        if (params_.relief == 0) warn_unused(*this, {"relief_wavelength"}, "without relief");
        if (params_.height_map.empty())
            warn_unused(*this, {"cuts"}, "without a height map: level land has none");
        geology_of_soil_known();
    }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        outline.surface_cells = garden::plot_cells(params_);
        outline.domain.dims = {1, 1, 1};  // its own comes with its result
        return {outline.surface_cells, memory(outline.surface_cells), outline.surface_cells * 60};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        std::vector<std::pair<std::string, Scene>> none;
        const Json summary = run_many(none, context);
        scene = std::move(new_scene);
        return summary;
    }

    Json run_many(const std::vector<std::pair<std::string, Scene>>& scenes,
                  const StageContext& context) override
    {
        garden::validate(params_, scenes.size());
        if (!scenes.empty() && params_.stones.empty())
            throw InvalidParameter(
                "garden: stones: scenes are given, but no place for their rocks; e.g. --stones "
                "0,0,0.3");
        check_memory("garden", memory(garden::plot_cells(params_)), context.memory_limit,
                     "make the cells larger with --cell");
        std::optional<Image16> land;
        if (!params_.height_map.empty())
            land = read_png_grey16(resolve(context, params_.height_map));
        std::vector<const Scene*> rocks;
        for (const auto& [name, scene] : scenes) {
            if (!scene.has("density"))
                throw InvalidInput(fmt::format(
                    "garden: {}: no grid 'density'; give what `sekitei weather` made", name));
            rocks.push_back(&scene);
        }
        const double most =
            context.memory_limit > 0 ? (context.memory_limit - memory(0)) / kBytesPerCell : 1e9;
        new_scene = garden::make_plot(params_, rocks, land ? &*land : nullptr, context.seed, most,
                                      context.progress);
        for (const auto& [name, scene] : scenes)
            new_scene.history.insert(new_scene.history.end(), scene.history.begin(),
                                     scene.history.end());
        const TriMesh& mesh = new_scene.meshes.at("rock");
        return {{"voxels", new_scene.floats("surface_sdf").active_count()},
                {"triangles", mesh.triangles.size()},
                {"stones", rocks.empty() ? 0
                                         : 1 + std::count(params_.stones.begin(),
                                                          params_.stones.end(), ';')}};
    }

private:
    static constexpr double kBytesPerCell = 700;
    static double memory(double cells) { return 3e8 + cells * kBytesPerCell; }

    void geology_of_soil_known() const
    {
        if (std::filesystem::path(params_.soil).extension() == ".toml")
            throw InvalidParameter(fmt::format(
                "garden: soil = {}: a file; give it to the soil stage, and here humus, sand, rock "
                "or asphalt",
                params_.soil));
        find_soil(params_.soil, {});
    }

    garden::PlotParams params_;
};

}  // namespace

std::unique_ptr<Stage> make_garden()
{
    return std::make_unique<GardenStage>();
}

}  // namespace sekitei::apps
