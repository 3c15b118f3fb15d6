#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/climate.h"
#include "apps/mesh_habitat.h"
#include "apps/stages/scenery.h"
#include "apps/stages/stages.h"
#include "apps/weather_choice.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/math.h"
#include "grids/level_set.h"
#include "grids/marching_tetrahedra.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

/// The surface, the place and the days.
struct LightParams {
    std::string surface;
    std::optional<double> cell;
    std::string debug_photons;
    bool keep_photons = false;
    std::optional<std::int64_t> days;
    bool repeat_year = false;
    double canopy_extinction = 0.5;

    static void describe(auto&& field)
    {
        field(
            "surface", &LightParams::surface,
            "grid whose surface gets the climate, or `mesh` for the triangles of a mesh; empty: a "
            "mesh where one is given, else surface_sdf, else density");
        field("cell", &LightParams::cell, "m", kPositive,
              "edge of the surface cells where the surface is no level set; auto: its voxel, or "
              "the site of a mesh");
        field("debug_photons", &LightParams::debug_photons,
              "on a mesh: file for all stored photons as points (PLY); empty: none");
        field("keep_photons", &LightParams::keep_photons,
              "on a mesh: leave all stored photons in the scene, as points");
        field("days", &LightParams::days, "d", between(1, 1000000),
              "length of the weather to use; auto: to its end");
        field("repeat_year", &LightParams::repeat_year,
              "begin the weather anew when it is shorter than days");
        field("canopy_extinction", &LightParams::canopy_extinction, "", between(0, 10),
              "share of the leaf area of canopy_lad that is its shadow; 0: it has none");
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
            {"weather.open_face"},
            true};
        return kInfo;
    }
    void meets_mesh(bool there) override { mesh_given_ = there; }
    std::vector<fs::path> side_files() override
    {
        return params_.debug_photons.empty() ? std::vector<fs::path>()
                                             : std::vector<fs::path>{params_.debug_photons};
    }
    std::vector<std::string> makes() override
    {
        if (!on_mesh()) return info().makes;
        std::vector<std::string> names = site_items();
        for (const char* field : {"light_S", "light_direct", "light_sky", "light_indirect",
                                  "sky_view", "rain_exposure"})
            names.emplace_back(field);
        if (!choice_.weather.empty()) names.emplace_back("weather");
        if (params_.keep_photons) names.emplace_back("photons");
        return names;
    }
    std::vector<std::string> needs() override
    {
        if (on_mesh()) return {"rock"};
        if (!params_.surface.empty()) return {params_.surface};
        return {};
    }
    std::vector<std::string> uses() override
    {
        if (on_mesh()) return {};
        std::vector<std::string> names{"obstacle_sdf", "leaves", "canopy_lad", "canopy_height"};
        if (params_.surface.empty()) names.insert(names.end(), kSurfaces.begin(), kSurfaces.end());
        return names;
    }
    ParamList params() override
    {
        ParamList list = describe_params(params_);
        for (Param& p : describe_params(choice_)) list.push_back(std::move(p));
        for (Param& p : describe_params(light_)) list.push_back(std::move(p));
        for (Param& p : describe_params(ground_)) list.push_back(std::move(p));
        for (Param& p : describe_params(photons_)) list.push_back(std::move(p));
        return list;
    }
    void validate() override
    {
        validate_described("light", params_);
        light::validate(light_);
        light::validate(photons_);
        validate_described("light", choice_);
        validate_described("light", ground_);
        if (!params_.days) warn_unused(*this, {"repeat_year"}, "without days");
        if (light_.bounces == 0) warn_unused(*this, {"links", "albedo"}, "with bounces = 0");
        if (mesh_given_ || !params_.surface.empty()) require_weather();
    }

    void check_files(const StageContext& context) override
    {
        require_weather();
        if (!choice_.weather.empty()) days(context);
    }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        if (on_mesh())
            return {outline.surface_cells, mesh_memory(outline.surface_cells, photons_, 0),
                    outline.surface_cells * 100};
        if (outline.surface_cells == 0)
            outline.surface_cells = 6 * std::pow(std::max(1.0, outline.lava_voxels), 2.0 / 3);
        return {outline.surface_cells, memory(outline.surface_cells), outline.surface_cells * 200};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        if (on_mesh()) return run_on_mesh(scene, context);
        require_weather();
        std::vector<std::string> of_meshes{"debug_photons", "keep_photons"};
        for (const Param& p : describe_params(ground_)) of_meshes.push_back(p.name);
        for (const Param& p : describe_params(photons_)) of_meshes.push_back(p.name);
        warn_unused(*this, of_meshes, "on cells");
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
        // The leaves of a canopy are single leaves, or fog that lets some light through: those of a
        // forest are fog, with those of its single trees in it.
        const bool fog = scene.has("canopy_lad") && params_.canopy_extinction > 0 &&
                         (scene.has("canopy_height") || !scene.points.contains("leaves"));
        std::optional<light::Veil> veil;
        if (fog) veil.emplace(scene.floats("canopy_lad"), params_.canopy_extinction);
        for (TriMesh mesh :
             {obstacle_mesh(scene), bark_mesh(scene, {}), fog ? TriMesh() : leaf_mesh(scene)})
            if (!mesh.triangles.empty()) hiding.push_back(std::move(mesh));
        std::vector<const TriMesh*> occluders;
        for (const TriMesh& mesh : hiding) occluders.push_back(&mesh);
        light::Params p = light_;
        if (!p.ground && scene.domain.dims.z > 0) p.ground = scene.domain.transform.origin.z;
        const light::Coefficients coefficients =
            light::trace(sites, occluders, weather.site->latitude, light::rain_winds(weather.days),
                         p, progress.slice(0.25, 0.8), veil ? &*veil : nullptr);
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
    bool on_mesh() const
    {
        return params_.surface.empty() ? mesh_given_.value_or(false) : params_.surface == "mesh";
    }

    /// Cells need one. Whether there are cells may be known only when the input is read.
    void require_weather() const
    {
        if (choice_.weather.empty() && !on_mesh())
            throw InvalidParameter(
                "light: weather: which? give a JMA daily CSV, an EPW, monthly normals or a CSV "
                "with units in its header; data/weather has some");
    }

    /// Photons of all days at once: their mean light.
    Json run_on_mesh(Scene& scene, const StageContext& context)
    {
        check_mesh_albedo(light_.albedo, "light");
        std::vector<std::string> of_cells;
        for (const Param& p : describe_params(light_))
            if (p.name != "albedo") of_cells.push_back(p.name);
        of_cells.emplace_back("canopy_extinction");
        warn_unused(*this, of_cells, "on a mesh");
        if (scene.has("canopy_lad"))
            log::warning("light: on a mesh, the leaves of canopy_lad give no shade");
        const Progress& progress = context.progress;
        const TriMesh was = scene.meshes.at("rock");
        const MeshSites sites = sites_of(was, ground_.site, "light", progress.slice(0, 0.05));
        constexpr std::size_t kFields = 6;
        check_mesh_memory(scene, sites, photons_, 0, params_.cell.value_or(ground_.site), kFields,
                          "light", context.memory_limit);
        Weather weather;
        if (choice_.weather.empty())
            weather.site = Site{};
        else
            weather = days(context);
        for (const std::string& note : weather.notes) log::info("light: {}", note);
        const SunMode mode = sun_mode(ground_, !choice_.weather.empty());
        const light::Daylight daylight =
            daylight_of(ground_, mode, true, weather.days, *weather.site);
        Exposure seen = exposure_of(sites, weather.site->latitude, light::rain_winds(weather.days),
                                    progress.slice(0.05, 0.3));

        const std::vector<float> albedo(sites.size(), static_cast<float>(light_.albedo));
        const light::PhotonScene rays(sites.mesh, albedo, 0.2, 0, progress.slice(0.3, 0.35));
        light::validate(photons_, rays.radius());
        const light::SiteKernel kernel(sites.position, sites.normal, sites.area, photons_, 0,
                                       &sites.mesh);
        const light::Shot shot =
            shoot(rays, daylight, photons_, context.seed, 1, progress.slice(0.35, 0.6));
        light::PhotonLight found =
            light::light_of_day(rays, kernel, daylight, shot.photons, {}, {}, photons_,
                                context.seed, 1, progress.slice(0.6, 0.8));
        const std::size_t n = sites.size();
        std::vector<float> total(n);
        double area = 0, mean = 0;
        for (std::size_t i = 0; i < n; ++i) {
            total[i] = found.sites.total(i);
            area += double(sites.area[i]);
            mean += double(sites.area[i]) * double(total[i]);
        }
        const std::vector<SiteField> fields{
            {"light_S", "W/m^2", std::move(total)},
            {"light_direct", "W/m^2", std::move(found.sites.beam)},
            {"light_sky", "W/m^2", std::move(found.sites.sky)},
            {"light_indirect", "W/m^2", std::move(found.sites.indirect)},
            {"sky_view", "", std::move(seen.sky_view)},
            {"rain_exposure", "", std::move(seen.rain_exposure)}};
        put_sites(scene, sites, was, fields, nullptr, "light");
        put_cells(scene, sites, fields, params_.cell.value_or(ground_.site), "light",
                  progress.slice(0.8, 1));
        if (!weather.days.empty()) scene.points["weather"] = weather_points(weather);
        if (!params_.debug_photons.empty())
            write_file(resolve(context, params_.debug_photons), encode_points(points_of(shot)));
        if (params_.keep_photons) scene.points["photons"] = points_of(shot);
        const light::Ledger& l = shot.ledger;
        return {{"sites", n},
                {"area_m2", area},
                {"mean_light", mean / area},
                {"photons", l.photons},
                {"stored", shot.photons.size()},
                {"emitted_W", l.emitted},
                {"missed_W", l.missed},
                {"absorbed_W", l.absorbed},
                {"escaped_W", l.escaped},
                {"lost_W", l.lost}};
    }

    /// Stored photons as points: `dir` of flight, `N` of the surface, `flux` [W], `bounce`.
    static Points points_of(const light::Shot& shot)
    {
        Points points;
        points.stage = "light";
        std::vector<Vec3f> direction, normal;
        std::vector<float> flux;
        std::vector<std::int32_t> bounce;
        for (const light::Photon& photon : shot.photons) {
            points.position.emplace_back(photon.position);
            direction.push_back(photon.direction);
            normal.push_back(photon.normal);
            flux.push_back(photon.flux);
            bounce.push_back(photon.bounce);
        }
        points.attributes = {{"dir", std::move(direction)},
                             {"N", std::move(normal)},
                             {"flux", std::move(flux)},
                             {"bounce", std::move(bounce)}};
        return points;
    }

    /// The days of the weather that count.
    Weather days(const StageContext& context) const
    {
        return chosen_weather(choice_, params_.days, params_.repeat_year, "light", context.folder);
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
    WeatherChoice choice_;
    light::Params light_;
    PhotonGround ground_;
    light::PhotonParams photons_;
    std::optional<bool> mesh_given_;  ///< unknown until told
};

}  // namespace

std::unique_ptr<Stage> make_light()
{
    return std::make_unique<LightStage>();
}

}  // namespace sekitei::apps
