#include "apps/garden/garden.h"
#include "apps/stages/stages.h"

namespace sekitei::apps {
namespace {

class LanternStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "lantern",
            "1",
            "a stone lantern, alone or with a fence, a pond or a garden around it",
            OutputKind::Scene,
            false,
            {},
            {"surface_sdf", "obstacle_sdf", "water_surface", "canopy_RU", "leaves"}};
        return kInfo;
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        using garden::Layout;
        garden::validate(params_);
        const bool garden = params_.layout == Layout::Garden;
        if (params_.layout != Layout::Fence && params_.layout != Layout::SouthFence)
            warn_unused(*this,
                        {"fence_distance", "fence_height", "fence_length", "fence_thickness"},
                        "without a fence in the layout");
        if (params_.layout != Layout::Pond && !garden)
            warn_unused(*this, {"pond_distance", "pond_width", "pond_length"},
                        "without a pond in the layout");
        if (!garden) warn_unused(*this, {"canopy_drag"}, "without the garden's trees");
    }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        const double v = params_.cell;
        outline.surface_cells = 3.2 / (v * v);
        return {outline.surface_cells, 1.5e8 + outline.surface_cells * 400,
                outline.surface_cells * 60};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        scene = garden::make(params_, context.seed, context.progress);
        return {{"voxels", scene.floats("surface_sdf").active_count()}};
    }

private:
    garden::Params params_;
};

}  // namespace

std::unique_ptr<Stage> make_lantern()
{
    return std::make_unique<LanternStage>();
}

}  // namespace sekitei::apps
