#pragma once

#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <string>

#include "apps/climate.h"
#include "apps/stage.h"
#include "core/file_output.h"
#include "core/log.h"
#include "grids/level_set.h"
#include "grids/surface_cells.h"
#include "tests/support/temporary_folder.h"

/// Small scenes, short weathers, and stages run on them in process.
namespace sekitei::apps::testing {

/// One day of an own CSV; negative radiation is left out of the file.
struct Sky {
    double celsius = 14, humidity = 85, rain = 3, wind = 1.5, direction = 270, sunshine = 4;
    double global = 100, diffuse = 60;
};

/// A weather file of `days` days from a date on.
inline std::string weather_csv(int days, const std::function<Sky(int)>& sky,
                               std::chrono::year_month_day first = std::chrono::year{2021} /
                                                                   std::chrono::March / 1,
                               double latitude = 39.7)
{
    std::string text = fmt::format(
        "# latitude = {} deg\n# longitude = 141.15 deg\n"
        "date,temperature [C],humidity [%],precipitation [mm],wind_speed [m/s],wind_direction "
        "[deg],"
        "sunshine [h],global [W/m^2],diffuse [W/m^2]\n",
        latitude);
    for (int d = 0; d < days; ++d) {
        const std::chrono::year_month_day date{std::chrono::sys_days(first) + std::chrono::days(d)};
        const Sky s = sky(d);
        text += fmt::format("{:04}-{:02}-{:02},{},{},{},{},{},{},{},{}\n", int(date.year()),
                            unsigned(date.month()), unsigned(date.day()), s.celsius, s.humidity,
                            s.rain, s.wind, s.direction, s.sunshine, s.global, s.diffuse);
    }
    return text;
}

/// A body given by its distance in metres, in a box whose walls and underside are cuts.
inline Scene body(double cell, Vec3d lower, Vec3d size,
                  const std::function<double(Vec3d)>& distance)
{
    Scene scene;
    scene.domain.transform = {lower, cell};
    for (int axis = 0; axis < 3; ++axis)
        scene.domain.dims[axis] = static_cast<int>(std::ceil(size[axis] / cell - 1e-9));
    const Transform lattice = scene.domain.transform;
    scene.put("surface_sdf",
              level_set_from_function(
                  scene.domain, [&](Vec3d p) { return distance(lattice.world(p)) / cell; }, {}),
              "m", "test", GridClass::LevelSet);
    return scene;
}

inline double box_distance(Vec3d p, Vec3d centre, Vec3d half)
{
    const Vec3d q{std::abs(p.x - centre.x) - half.x, std::abs(p.y - centre.y) - half.y,
                  std::abs(p.z - centre.z) - half.z};
    const Vec3d out{std::max(q.x, 0.0), std::max(q.y, 0.0), std::max(q.z, 0.0)};
    return length(out) + std::min(0.0, std::max({q.x, q.y, q.z}));
}

/// Level ground at z = 0.5, 1 m by 0.8 m.
inline Scene plane(double cell = 0.04)
{
    return body(cell, {0.3, -0.2, 0}, {1.0, 0.8, 1.0}, [](Vec3d p) { return p.z - 0.5; });
}

/// Runs one stage as a command does: parameters by name, history behind it.
inline Json run(Scene& scene, const std::string& name, const Json& values = Json::object(),
                const StageContext& context = {}, std::unique_ptr<Stage>* keep = nullptr)
{
    std::unique_ptr<Stage> stage = make_stage(name);
    const ParamList params = stage->params();
    for (const auto& [key, value] : values.items()) {
        const Param* param = find_param(params, key);
        if (!param) throw std::logic_error("no parameter " + key);
        param->set(value);
    }
    stage->validate();
    const HistoryEntry entry = history_of(*stage, context);
    Json summary = stage->run(scene, context);
    if (stage->info().output == OutputKind::Scene) scene.history.push_back(entry);
    if (keep) *keep = std::move(stage);
    return summary;
}

/// Stages whose words nobody needs, with a folder for what they read.
class Habitat {
public:
    Habitat() : level_(log::level()) { log::set_level(log::Level::Quiet); }
    ~Habitat() { log::set_level(level_); }

    StageContext context(std::uint64_t seed = 7) const
    {
        StageContext c;
        c.seed = seed;
        c.folder = folder.path();
        return c;
    }
    /// Puts a weather into the folder; its name.
    std::string weather(const std::string& text)
    {
        const std::string name = fmt::format("weather-{}.csv", ++count_);
        write_file(folder / name, text);
        return name;
    }
    void light(Scene& scene, const std::string& text, Json more = Json::object())
    {
        more["weather"] = weather(text);
        run(scene, "light", more, context());
    }

    TemporaryFolder folder;

private:
    log::Level level_;
    int count_ = 0;
};

inline SurfaceCells cells_of(const Scene& scene)
{
    return surface_cells(scene.floats("surface_sdf"), scene.vectors("surf_normal"),
                         scene.floats("surf_area"), {});
}

inline const std::vector<double>& column(const Scene& scene, const std::string& name)
{
    return std::get<std::vector<double>>(scene.points_of("statistics").attributes.at(name));
}

/// Share of the surface's area whose moss is any, or the one numbered (from 1).
inline double cover(const Scene& scene, int species = 0)
{
    const SurfaceCells cells = cells_of(scene);
    const std::vector<std::int32_t> moss = cells.from_grid(scene.ints("moss_species"), 0);
    double covered = 0, all = 0;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        all += double(cells.area[i]);
        if (species ? moss[i] == species : moss[i] > 0) covered += double(cells.area[i]);
    }
    return covered / all;
}

}  // namespace sekitei::apps::testing
