#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/image.h"
#include "grids/level_set.h"
#include "solvers/weathering/weathering.h"

namespace sekitei::apps {
namespace {

/// Fields and files that replace the solver's own formulas.
struct Sources {
    std::string field;
    std::string terrain_grid;
    std::filesystem::path terrain_map;
    double terrain_low = 0, terrain_high = 1;

    static void describe(auto&& add)
    {
        add("field", &Sources::field, "grid of the scene to use as W in place of the formula");
        add("terrain_grid", &Sources::terrain_grid, "level set of the scene to use as terrain");
        add("terrain_map", &Sources::terrain_map,
            "PNG whose grey is the terrain's height, stretched over the box");
        add("terrain_low", &Sources::terrain_low, "m", kAny, "height of black in terrain_map");
        add("terrain_high", &Sources::terrain_high, "m", kAny, "height of white in terrain_map");
    }
};

/// Height in metres at (x, y) in [0, 1]^2 of the map, bilinear; row 0 is the north edge.
double map_height(const Image16& map, double x, double y, double low, double high)
{
    const double u = std::clamp(x * map.width - 0.5, 0.0, map.width - 1.0);
    const double v = std::clamp((1 - y) * map.height - 0.5, 0.0, map.height - 1.0);
    const int i = std::min(static_cast<int>(u), map.width - 1),
              j = std::min(static_cast<int>(v), map.height - 1);
    const int i1 = std::min(i + 1, map.width - 1), j1 = std::min(j + 1, map.height - 1);
    const double f = u - i, g = v - j;
    const double grey = (1 - g) * ((1 - f) * map.at(i, j) + f * map.at(i1, j)) +
                        g * ((1 - f) * map.at(i, j1) + f * map.at(i1, j1));
    return low + (high - low) * grey / 65535;
}

/// Bound on the gradient of z - height(x, y) for a map stretched over the domain: from its steepest
/// step.
double map_steepness(const Image16& map, const Domain& domain, double range)
{
    double along_x = 0, along_y = 0;  // grey levels a pixel
    for (int j = 0; j < map.height; ++j)
        for (int i = 0; i < map.width; ++i) {
            if (i > 0)
                along_x = std::max(along_x, std::abs(double(map.at(i, j)) - map.at(i - 1, j)));
            if (j > 0)
                along_y = std::max(along_y, std::abs(double(map.at(i, j)) - map.at(i, j - 1)));
        }
    const double voxels_a_grey = std::abs(range) / 65535 / domain.transform.voxel;
    const double sx = along_x * voxels_a_grey * map.width / domain.dims.x;
    const double sy = along_y * voxels_a_grey * map.height / domain.dims.y;
    return std::sqrt(1 + sx * sx + sy * sy);
}

class WeatherStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "weather",
            "1",
            "cut columns, let weak pieces fall, find the density of what stands",
            OutputKind::Scene,
            true,
            {"region", "column", "body_sdf", "slow_sdf", "centre_lines"},
            {"component", "weathering", "density", "surface"}};
        return kInfo;
    }

    std::vector<std::string> needs() override
    {
        std::vector<std::string> names = info().needs;
        for (const std::string& name : {sources_.field, sources_.terrain_grid})
            if (!name.empty()) names.push_back(name);
        return names;
    }

    ParamList params() override
    {
        ParamList list = describe_params(params_);
        for (Param& p : describe_params(sources_)) list.push_back(std::move(p));
        return list;
    }
    void validate() override
    {
        weathering::validate(params_);
        const std::string why = fmt::format(
            "with cut = {}",
            weathering::choice_names(params_.cut)[static_cast<std::size_t>(params_.cut)]);
        if (params_.cut != weathering::Cut::Perpendicular)
            warn_unused(
                *this,
                {"collapse", "ramp", "ramp_weight", "surface_weight", "noise_weight", "depth",
                 "open_face", "noise_wavelength", "holding_limit", "cut_ref_length", "field"},
                why);
        if (params_.cut != weathering::Cut::Horizontal)
            warn_unused(*this,
                        {"terrain_base", "terrain_slope_x", "terrain_slope_y", "terrain_amplitude",
                         "terrain_hurst", "terrain_octaves", "terrain_grid", "terrain_map",
                         "terrain_low", "terrain_high"},
                        why);
        else if (!sources_.terrain_grid.empty() || !sources_.terrain_map.empty())
            warn_unused(*this,
                        {"terrain_base", "terrain_slope_x", "terrain_slope_y", "terrain_amplitude",
                         "terrain_hurst", "terrain_octaves"},
                        "with a terrain of your own");
    }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        return {outline.lava_voxels, memory(outline.lava_voxels), outline.lava_voxels * 4};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        const Polylines lines =
            to_polylines(scene.points_of("centre_lines"), scene.domain.transform);
        weathering::Inputs inputs{scene.ints("region"),
                                  scene.ints("column"),
                                  scene.floats("body_sdf"),
                                  scene.floats("slow_sdf"),
                                  lines,
                                  scene.domain};
        check_memory("weather", memory(static_cast<double>(inputs.region.active_count())),
                     context.memory_limit);
        if (!sources_.field.empty()) inputs.weathering = &scene.floats(sources_.field);
        FloatGrid terrain;
        if (!sources_.terrain_grid.empty())
            inputs.terrain = &scene.floats(sources_.terrain_grid);
        else if (!sources_.terrain_map.empty()) {
            const Image16 map = read_png_grey16(resolve(context, sources_.terrain_map));
            const Domain& d = scene.domain;
            terrain = level_set_from_function(
                d,
                [&](Vec3d p) {
                    const double height = map_height(map, p.x / d.dims.x, p.y / d.dims.y,
                                                     sources_.terrain_low, sources_.terrain_high);
                    return p.z - (height - d.transform.origin.z) / d.transform.voxel;
                },
                context.progress,
                {.steepness = map_steepness(map, d, sources_.terrain_high - sources_.terrain_low)});
            inputs.terrain = &terrain;
        }
        weathering::Result result =
            weathering::run(inputs, params_, context.seed, context.progress);
        scene.put("component", std::move(result.component), "weather");
        scene.put("weathering", std::move(result.weathering), "", "weather");
        scene.put("density", std::move(result.density), "", "weather", GridClass::FogVolume);
        scene.put("surface", std::move(result.surface), "weather");
        return {{"columns", result.columns},
                {"pieces", result.pieces},
                {"removed_pieces", result.removed_pieces},
                {"removed_share",
                 result.lava_voxels > 0 ? result.removed_voxels / result.lava_voxels : 0},
                {"leaves_touched_share", result.leaves_touched_share}};
    }

private:
    /// Bytes at the peak: columns, components and the density's surface a voxel, and what does not
    /// grow with them.
    static double memory(double voxels) { return 1e8 + voxels * 20; }

    weathering::Params params_;
    Sources sources_;
};

}  // namespace

std::unique_ptr<Stage> make_weather()
{
    return std::make_unique<WeatherStage>();
}

}  // namespace sekitei::apps
