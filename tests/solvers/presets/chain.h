#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "apps/recipe.h"
#include "grids/scene.h"
#include "solvers/cooling/cooling.h"
#include "solvers/joints/joints.h"
#include "solvers/lava/lava.h"

/// Chains of solvers as the program runs them.
namespace sekitei::presets {

inline double degrees(double cosine)
{
    return std::acos(std::clamp(cosine, -1.0, 1.0)) * 180 / std::numbers::pi;
}

/// A body of lava, cooled as its preset recommends, with seeds thrown on its cooling faces.
class Body {
public:
    /// A family of the paper at its own size, with smooth boundaries.
    explicit Body(lava::Preset preset) : Body({.preset = preset, .noise_amplitude = 0.0}, {}, {}) {}

    Body(const lava::Params& params, const lava::Inputs& inputs, std::optional<int> steps)
        : lava(lava::run(inputs, params, kSeed, {})),
          defaults(lava::preset_defaults(params.preset)),
          heat(cooling::run(
              {lava.region_coarse, lava.heat_domain, defaults.heat_steps, defaults.plateau_share},
              {.steps = steps}, {}, {}))
    {
    }

    joints::Inputs joint_inputs() const
    {
        return {lava.region, lava.body_sdf,    lava.slow_sdf,       heat.gradient,
                lava.domain, lava.heat_domain, defaults.seed_count, {}};
    }

    /// As many seeds as the preset says, at the usual distance, evened out once. Voxel units.
    std::vector<Vec3d> seeds() const
    {
        const TriMesh surface = joints::cooling_surface(joint_inputs(), {});
        const int count = defaults.seed_count.value_or(400);
        const double radius = 0.8 * std::sqrt(surface.area() / count);
        return joints::relax(
            surface, joints::poisson_disk(surface, static_cast<std::size_t>(count), radius, kSeed),
            1, {});
    }

    Polylines lines(const std::vector<Vec3d>& seeds, double step = 1) const
    {
        return joints::trace(joint_inputs(), {.step = step}, seeds, {});
    }

    static constexpr std::uint64_t kSeed = 1;
    lava::Result lava;
    lava::PresetDefaults defaults;
    cooling::Result heat;
};

inline Vec3d end_of(const Polylines& lines, std::size_t i)
{
    return lines.line(i)[lines.size(i) - 1];
}

/// Unit direction in which a line arrives.
inline Vec3d last_direction(const Polylines& lines, std::size_t i)
{
    const std::size_t n = lines.size(i);
    return normalized(lines.line(i)[n - 1] - lines.line(i)[n - 2]);
}

/// Runs a recipe of data/recipes in memory, without its pictures.
/// @param overrides  "lava.voxel=8cm"
inline Scene run_recipe(const std::string& name, const std::vector<std::string>& overrides)
{
    apps::Recipe recipe =
        apps::read_recipe(std::string(SEKITEI_DATA "/recipes/") + name + ".toml", overrides);
    Scene scene;
    for (apps::RecipeStage& stage : recipe.stages) {
        if (stage.process->info().output == apps::OutputKind::Picture) continue;
        apps::StageContext context;
        context.seed = stage.seed;
        context.folder = recipe.folder;
        stage.process->run(scene, context);
        scene.history.push_back(apps::history_of(*stage.process, context));
    }
    return scene;
}

}  // namespace sekitei::presets
