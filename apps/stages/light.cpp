#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/climate.h"
#include "apps/stages/scenery.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/log.h"
#include "core/math.h"
#include "grids/level_set.h"
#include "grids/marching_tetrahedra.h"

namespace sekitei::apps {
namespace {

/// The surface, the place and the days.
struct LightParams {
    std::string surface;
    std::optional<double> cell;
    std::filesystem::path weather;
    std::optional<double> latitude, longitude;
    std::int64_t first_day = 0;
    std::optional<std::int64_t> days;
    bool repeat_year = false;
    WeatherFill fill = WeatherFill::Error;

    static void describe(auto&& field)
    {
        field("surface", &LightParams::surface,
              "grid whose surface gets the climate; empty: surface_sdf, else density");
        field("cell", &LightParams::cell, "m", kPositive,
              "edge of the surface cells where the surface is no level set; auto: its voxel");
        field("weather", &LightParams::weather,
              "weather: JMA daily CSV, EPW, monthly normals or own CSV with units in the header");
        field("latitude", &LightParams::latitude, "deg", between(-90, 90),
              "north positive; auto: as the weather file says");
        field("longitude", &LightParams::longitude, "deg", between(-180, 180),
              "east positive; auto: as the weather file says, else 0");
        field("first_day", &LightParams::first_day, "", kNotNegative,
              "day of the weather to begin with, 0 being its first");
        field("days", &LightParams::days, "d", between(1, 1000000),
              "length of the weather to use; auto: to its end");
        field("repeat_year", &LightParams::repeat_year,
              "begin the weather anew when it is shorter than days");
        field("fill", &LightParams::fill, "days that are missing in the weather");
    }
};

/// The grids that may carry the surface, by preference.
const std::vector<std::string> kSurfaces{"surface_sdf", "density"};

class LightStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "light",
            "1",
            "sun, sky and rain on every cell of a surface, under the weather of a place",
            OutputKind::Scene,
            true,
            {},
            {"surface_sdf", "surf_normal", "surf_area", "sky_view", "rain_exposure", "light_S",
             "light_direct", "light_sky", "light_reflected", "daylight", "weather"},
            false,
            {"weather.open_face"}};
        return kInfo;
    }
    std::vector<std::string> needs() override
    {
        if (!params_.surface.empty()) return {params_.surface};
        return {};
    }
    std::vector<std::string> uses() override
    {
        std::vector<std::string> names{"obstacle_sdf", "leaves"};
        if (params_.surface.empty()) names.insert(names.end(), kSurfaces.begin(), kSurfaces.end());
        return names;
    }
    ParamList params() override
    {
        ParamList list = describe_params(params_);
        for (Param& p : describe_params(light_)) list.push_back(std::move(p));
        return list;
    }
    void validate() override
    {
        validate_described("light", params_);
        light::validate(light_);
        if (!params_.days) warn_unused(*this, {"repeat_year"}, "without days");
        if (light_.bounces == 0) warn_unused(*this, {"links", "albedo"}, "with bounces = 0");
        if (params_.weather.empty())
            throw InvalidParameter(
                "light: weather: which? give a JMA daily CSV, an EPW, monthly normals or a CSV "
                "with units in its header; data/weather has some");
    }

    void check_files(const StageContext& context) override { days(context); }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        if (outline.surface_cells == 0)
            outline.surface_cells = 6 * std::pow(std::max(1.0, outline.lava_voxels), 2.0 / 3);
        return {outline.surface_cells, memory(outline.surface_cells), outline.surface_cells * 200};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        const Progress& progress = context.progress;
        // The weather first: its mistakes are the quickest to find.
        const Weather weather = days(context);
        for (const std::string& note : weather.notes) log::info("light: {}", note);

        const std::optional<Domain> box = find_surface(scene, context);
        const FloatGrid& surface = scene.floats("surface_sdf");
        const SurfaceCells cells = surface_cells(surface, progress.slice(0.1, 0.15), box);
        check_memory("light", memory(double(cells.size())), context.memory_limit);
        std::vector<Vec3d> origin(cells.size());
        for (std::size_t i = 0; i < cells.size(); ++i) origin[i] = cells.ray_origin(i);
        const light::Sites sites{origin, cells.normal, cells.area};

        std::vector<TriMesh> hiding;
        hiding.push_back(marching_tetrahedra(surface, 0, progress.slice(0.15, 0.25)));
        for (TriMesh mesh : {obstacle_mesh(scene), leaf_mesh(scene)})
            if (!mesh.triangles.empty()) hiding.push_back(std::move(mesh));
        std::vector<const TriMesh*> occluders;
        for (const TriMesh& mesh : hiding) occluders.push_back(&mesh);
        light::Params p = light_;
        if (!p.ground && scene.domain.dims.z > 0) p.ground = scene.domain.transform.origin.z;
        const light::Coefficients coefficients =
            light::trace(sites, occluders, weather.site->latitude, light::rain_winds(weather.days),
                         p, progress.slice(0.25, 0.8));
        hiding.clear();

        const std::size_t n = cells.size();
        std::vector<double> total(n), direct(n), sky(n), reflected(n);
        for (std::size_t d = 0; d < weather.days.size(); ++d) {
            const WeatherDay& day = weather.days[d];
            const auto moments = sun::moments_of_day(day.year, day.month, day.day, *weather.site);
            const light::Light today = light::day(coefficients, sites, moments,
                                                  sun::radiation(day, *weather.site, moments));
            parallel_for(
                n,
                [&](std::size_t i) {
                    total[i] += double(today.total[i]);
                    direct[i] += double(today.direct[i]);
                    sky[i] += double(today.sky[i]);
                    reflected[i] += double(today.reflected[i]);
                },
                8192);
            progress.slice(0.8, 1).update(double(d + 1) / double(weather.days.size()));
        }
        auto put = [&](const char* name, const std::vector<double>& sum) {
            std::vector<float> mean(n);
            for (std::size_t i = 0; i < n; ++i)
                mean[i] = static_cast<float>(sum[i] / double(weather.days.size()));
            scene.put(name, cells.to_grid(mean), "W/m^2", "light");
        };
        put("light_S", total);
        put("light_direct", direct);
        put("light_sky", sky);
        put("light_reflected", reflected);
        scene.put("sky_view", cells.to_grid(coefficients.sky_view), "", "light");
        scene.put("rain_exposure", cells.to_grid(coefficients.rain_exposure), "", "light");
        scene.put("surf_normal", cells.to_grid(cells.normal), "", "light", "covariant normalize");
        scene.put("surf_area", cells.to_grid(cells.area), "m^2", "light");
        scene.points["daylight"] = daylight_points(coefficients, cells);
        scene.points["weather"] = weather_points(weather);

        double area = 0, mean = 0, view = 0;
        for (std::size_t i = 0; i < n; ++i) {
            area += double(cells.area[i]);
            mean += double(cells.area[i]) * total[i] / double(weather.days.size());
            view += double(cells.area[i] * coefficients.sky_view[i]);
        }
        Json summary = {{"cells", n},
                        {"area_m2", area},
                        {"days", weather.days.size()},
                        {"mean_light", mean / area},
                        {"mean_sky_view", view / area},
                        {"bytes_a_cell", coefficients.bytes_per_site()}};
        for (const std::string& note : weather.notes)  // told in full above
            summary["derived"].push_back(note.substr(0, note.find(':')));
        return summary;
    }

private:
    /// The days of the weather that count.
    Weather days(const StageContext& context) const
    {
        std::optional<Site> site;
        if (params_.latitude) site = Site{*params_.latitude * math::kPi / 180, 0};
        const std::filesystem::path file = resolve(context, params_.weather);
        Weather weather = read_weather(file, site, params_.fill);
        if (weather.site && params_.longitude)
            weather.site->longitude = *params_.longitude * math::kPi / 180;
        else if (weather.site && weather.stated)
            weather.site->longitude = weather.stated->longitude;
        if (!weather.site)
            throw InvalidParameter(fmt::format(
                "light: latitude: {} does not say where it was measured; give --latitude",
                file.string()));
        const auto first = static_cast<std::size_t>(params_.first_day);
        if (first >= weather.days.size())
            throw InvalidParameter(fmt::format("light: first_day = {}, but {} has {} days", first,
                                               file.string(), weather.days.size()));
        const std::size_t count =
            params_.days ? static_cast<std::size_t>(*params_.days) : weather.days.size() - first;
        return select_days(weather, first, count, params_.repeat_year);
    }

    /// Puts surface_sdf into the scene where it is not there, and says which box cuts it.
    std::optional<Domain> find_surface(Scene& scene, const StageContext& context)
    {
        std::string name = params_.surface;
        for (const std::string& known : kSurfaces)
            if (name.empty() && scene.has(known)) name = known;
        if (name.empty())
            throw InvalidInput(
                "light: the scene has neither 'surface_sdf' nor 'density'; give --surface GRID, or "
                "make a scene with `sekitei lantern` or `lava ... weather`");
        const FloatGrid& grid = scene.floats(name);
        const bool level_set = scene.grids.at(name).grid_class == GridClass::LevelSet;
        const Domain& domain = scene.domain;
        if (level_set && !params_.cell) {
            if (name != "surface_sdf")
                scene.put("surface_sdf", FloatGrid(grid), "m", "light", GridClass::LevelSet);
            if (domain.dims.x > 0 && domain.transform == grid.transform()) return domain;
            return {};
        }
        // A volume: its surface, and the distance to that.
        const double iso = level_set ? 0 : 0.5;
        TriMesh mesh = marching_tetrahedra(grid, iso, context.progress.slice(0, 0.05));
        if (mesh.triangles.empty())
            throw InvalidInput(fmt::format("light: the grid '{}' has no surface at {}", name, iso));
        const double cell = params_.cell.value_or(grid.transform().voxel);
        double area = 0;
        for (const auto& t : mesh.triangles) {
            const Vec3d a(mesh.vertices[t[0]]), b(mesh.vertices[t[1]]), c(mesh.vertices[t[2]]);
            area += length(cross(b - a, c - a)) / 2;
        }
        check_memory("light", memory(area / (cell * cell)), context.memory_limit);
        Domain box;
        Vec3d lower, upper;
        if (domain.dims.x > 0) {
            lower = domain.transform.origin;
            upper = domain.transform.world(Vec3d(domain.dims));
        } else {
            const Bounds b = mesh.bounds();
            lower = b.lower - Vec3d(2 * cell);
            upper = b.upper + Vec3d(2 * cell);
        }
        // Walls of the box are cuts through rock that goes on, but for the top and the face that
        // the weather stage calls open.
        Vec3d open{0, 0, 1};
        if (const Json* made = params_of(scene, "weather"); made && made->contains("open_face")) {
            const Json& face = (*made)["open_face"];
            if (face.is_array() && face.size() == 3)
                open += Vec3d(face[0].get<double>(), face[1].get<double>(), face[2].get<double>());
        }
        for (int axis = 0; axis < 3; ++axis) {
            if (open[axis] < -0.5) lower[axis] -= 3 * cell;
            if (open[axis] > 0.5) upper[axis] += 3 * cell;
        }
        box.transform = {lower, cell};
        for (int axis = 0; axis < 3; ++axis)
            box.dims[axis] = static_cast<int>(std::ceil((upper[axis] - lower[axis]) / cell - 1e-6));
        scene.put("surface_sdf",
                  level_set_from_mesh(mesh, box.transform, context.progress.slice(0.05, 0.1)), "m",
                  "light", GridClass::LevelSet);
        if (domain.dims.x == 0) return {};
        return box;
    }

    /// Bytes at the peak: rays' geometry, coefficients, grids.
    static double memory(double cells) { return 2e8 + cells * 1600; }

    LightParams params_;
    light::Params light_;
};

}  // namespace

std::unique_ptr<Stage> make_light()
{
    return std::make_unique<LightStage>();
}

}  // namespace sekitei::apps
