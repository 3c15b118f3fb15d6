#include "apps/mesh_habitat.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/error.h"
#include "core/log.h"
#include "core/math.h"
#include "core/parallel.h"
#include "grids/level_set.h"
#include "grids/surface_cells.h"
#include "grids/surface_transfer.h"
#include "solvers/light/light.h"
#include "solvers/sun/sun.h"

namespace sekitei::apps {

SunMode sun_mode(const PhotonGround& ground, bool has_weather)
{
    const SunMode mode = ground.sun.value_or(has_weather ? SunMode::Path : SunMode::Fixed);
    if (mode == SunMode::Path && !has_weather)
        throw InvalidParameter("sun = path: along which? give a weather file, which has a place");
    return mode;
}

light::Daylight daylight_of(const PhotonGround& ground, SunMode mode, bool sky,
                            std::span<const WeatherDay> days, const Site& site)
{
    light::Daylight light;
    light.sky = ground.sky_light.value_or(0);
    if (mode == SunMode::Fixed) {
        if (ground.open_light > 0)
            light.beams.push_back(
                light::fixed_sun(ground.open_light, ground.sun_elevation * math::kPi / 180));
        return light;
    }
    const double share = 1 / static_cast<double>(days.size());
    for (const WeatherDay& day : days) {
        const auto moments = sun::moments_of_day(day.year, day.month, day.day, site);
        const sun::Radiation radiation = sun::radiation(day, site, moments);
        for (const sun::Moment& moment : moments)
            light.beams.push_back({moment.to_sun, radiation.beam_normal * moment.share * share});
        if (sky && !ground.sky_light) light.sky += radiation.diffuse * share;
    }
    return light;
}

ParamList describe(MeshMossParams& params)
{
    ParamList list = describe_params(params.weather);
    auto add = [&](ParamList more) {
        for (Param& p : more) list.push_back(std::move(p));
    };
    add(describe_params(params.steady));
    add(describe_params(params.land));
    add(describe_params(params.photons));
    add(describe_params(params));
    add(describe_params(params.geology));
    add(describe_params(params.colony));
    add(describe(params.climate));
    return list;
}

std::vector<float> attribute_at_sites(const TriMesh& mesh, const MeshSites& sites,
                                      const std::string& name)
{
    std::vector<float> values(sites.size());
    auto number = [&]<class T>(const std::vector<T>& list, std::size_t i) -> double {
        if constexpr (std::is_same_v<T, Vec3f>)
            throw InvalidInput(
                fmt::format("the mesh's attribute '{}' is a vector, expected numbers", name));
        else
            return static_cast<double>(list[i]);
    };
    if (const auto found = mesh.face_attributes.find(name); found != mesh.face_attributes.end()) {
        std::visit(
            [&](const auto& list) {
                for (std::size_t i = 0; i < values.size(); ++i)
                    values[i] = static_cast<float>(number(list, sites.face[i]));
            },
            found->second);
        return values;
    }
    const auto found = mesh.vertex_attributes.find(name);
    if (found == mesh.vertex_attributes.end()) {
        std::vector<std::string> there;
        for (const auto& [n, v] : mesh.face_attributes) there.push_back(n);
        for (const auto& [n, v] : mesh.vertex_attributes) there.push_back(n);
        throw InvalidInput(
            fmt::format("the mesh has no attribute '{}', it has: {}", name,
                        there.empty() ? "none" : fmt::format("{}", fmt::join(there, ", "))));
    }
    std::visit(
        [&](const auto& list) {
            for (std::size_t i = 0; i < values.size(); ++i) {
                const auto& t = mesh.triangles[sites.face[i]];
                const Vec3d a(mesh.vertices[t[0]]),
                    ab = Vec3d(mesh.vertices[t[1]]) - a, ac = Vec3d(mesh.vertices[t[2]]) - a,
                    n = cross(ab, ac), p = Vec3d(sites.position[i]) - a;
                const double size = dot(n, n), v = dot(cross(p, ac), n) / size,
                             w = dot(cross(ab, p), n) / size;
                values[i] = static_cast<float>((1 - v - w) * number(list, t[0]) +
                                               v * number(list, t[1]) + w * number(list, t[2]));
            }
        },
        found->second);
    return values;
}

namespace {

/// A face attribute of the old mesh on the faces it was divided into.
TriMesh::Attribute carried(const TriMesh::Attribute& values, const std::vector<std::uint32_t>& face)
{
    return std::visit(
        [&](const auto& list) -> TriMesh::Attribute {
            std::decay_t<decltype(list)> more(face.size());
            for (std::size_t i = 0; i < face.size(); ++i) more[i] = list[face[i]];
            return more;
        },
        values);
}

}  // namespace

// At the peak, for each cell of a mesh's surface: its level set while it is made, and what a grid
// takes there. Measured on a boulder and a bunny.
constexpr double kBytesPerCell = 450, kBytesPerValue = 40;

double mesh_memory(double sites, const light::PhotonParams& photons, int plants)
{
    return 2e8 + 900 * sites + 200 * double(photons.photons) + 700.0 * plants;
}

namespace {

/// Whether another stage left the cells of a surface, by their area.
bool brings_cells(const Scene& scene, const std::string& stage)
{
    const auto area = scene.grids.find("surf_area");
    return area != scene.grids.end() && area->second.stage != stage;
}

}  // namespace

void check_mesh_memory(const Scene& scene, const MeshSites& sites,
                       const light::PhotonParams& photons, int plants, double cell,
                       std::size_t fields, const std::string& stage, double limit)
{
    const double here = mesh_memory(double(sites.size()), photons, plants);
    check_memory(stage, here, limit, "make site larger or send fewer photons");
    if (brings_cells(scene, stage)) return;
    double area = 0;
    for (const float a : sites.area) area += double(a);
    const double cells = area / (cell * cell);
    check_memory(stage, here + cells * (kBytesPerCell + kBytesPerValue * double(fields)), limit,
                 fmt::format("make cell = {:.3g} m larger", cell));
}

void check_mesh_albedo(double albedo, const std::string& stage)
{
    constexpr double kMost = 0.95;
    if (albedo > kMost)
        throw InvalidParameter(fmt::format(
            "{}: albedo = {:.6g}, must be at most {} on a mesh: photons would hardly ever stop",
            stage, albedo, kMost));
}

MeshSites sites_of(const TriMesh& mesh, double longest_edge, const std::string& who,
                   const Progress& progress)
{
    const MeshReport report = inspect(mesh);
    if (report.open_edges > 0)
        log::warning(
            "{}: the mesh is open: {} edges have one face only; nothing grows on the back "
            "of a sheet",
            who, report.open_edges);
    if (report.non_manifold_edges > 0)
        log::warning("{}: {} edges of the mesh have more than two faces", who,
                     report.non_manifold_edges);
    return mesh_sites(mesh, longest_edge, progress);
}

void put_sites(Scene& scene, const MeshSites& sites, const TriMesh& was,
               const std::vector<SiteField>& fields, const std::vector<std::int32_t>* geology,
               const std::string& stage)
{
    TriMesh mesh = sites.mesh;
    Points points;
    for (const auto& [name, values] : was.face_attributes)
        mesh.face_attributes[name] = carried(values, sites.face);
    for (const Vec3f p : sites.position) points.position.emplace_back(p);
    points.attributes = {{"N", sites.normal},
                         {"area", sites.area},
                         {"face", std::vector<std::int32_t>(sites.face.begin(), sites.face.end())}};
    for (const SiteField& field : fields) {
        mesh.face_attributes[field.name] = field.values;
        points.attributes[field.name] = field.values;
    }
    if (geology) {
        mesh.face_attributes["geology"] = *geology;
        points.attributes["geology"] = *geology;
    }
    points.stage = stage;
    scene.points["sites"] = std::move(points);
    scene.meshes["rock"] = std::move(mesh);
}

void put_cells(Scene& scene, const MeshSites& sites, const std::vector<SiteField>& fields,
               double cell, const std::string& stage, const Progress& progress)
{
    SurfaceCells cells;
    if (brings_cells(scene, stage)) {
        cells = surface_cells(scene.floats("surface_sdf"), scene.vectors("surf_normal"),
                              scene.floats("surf_area"), progress.slice(0, 0.5));
    } else {
        const Bounds bounds = sites.mesh.bounds();
        FloatGrid level_set;
        try {
            level_set =
                level_set_from_mesh(sites.mesh, Transform{bounds.lower - Vec3d(3 * cell), cell},
                                    progress.slice(0, 0.4));
            cells = surface_cells(level_set, progress.slice(0.4, 0.5));
        } catch (const InvalidInput&) {
            log::warning("{}: the mesh encloses nothing at voxels of {:.3g} m: no grids", stage,
                         cell);
            return;
        }
        scene.put("surface_sdf", std::move(level_set), "m", stage, GridClass::LevelSet);
        scene.put("surf_normal", cells.to_grid(cells.normal), "", stage, "covariant normalize");
        scene.put("surf_area", cells.to_grid(cells.area), "m^2", stage);
    }
    const SurfaceTransfer transfer = sites_to_cells(sites, cells, progress.slice(0.5, 1));
    for (const SiteField& field : fields)
        scene.put(field.name, cells.to_grid(transfer.apply(field.values, 0)), field.unit, stage);
}

std::vector<std::string> site_items()
{
    return {"rock", "sites", "surface_sdf", "surf_normal", "surf_area"};
}

Exposure exposure_of(const MeshSites& sites, double latitude,
                     const std::vector<light::RainWind>& winds, const Progress& progress)
{
    // Of the coefficients only what sky and rain see is wanted: few rays for the sun.
    light::Params params;
    params.sky_split = 1;
    params.sun_rows = 2;
    params.sun_bins = 64;
    params.bounces = 0;
    std::vector<Vec3d> origin(sites.size());
    for (std::size_t i = 0; i < sites.size(); ++i)
        origin[i] = Vec3d(sites.position[i]) + Vec3d(sites.normal[i]) * 1e-4;
    const TriMesh* occluder = &sites.mesh;
    light::Coefficients found = light::trace({origin, sites.normal, sites.area}, {&occluder, 1},
                                             latitude, winds, params, progress);
    return {std::move(found.sky_view), std::move(found.rain_exposure)};
}

std::vector<std::int32_t> geology_of(const TriMesh& mesh, const MeshSites& sites,
                                     const MeshMossParams& params,
                                     const std::filesystem::path& folder, const Progress& progress)
{
    const int own = geology_of_soil(params.climate.soil);
    if (params.texture.empty() && !mesh.face_attributes.contains("geology"))
        return std::vector<std::int32_t>(sites.size(), own);
    std::optional<Image8> texture;
    const std::filesystem::path file =
        params.texture.is_absolute() ? params.texture : folder / params.texture;
    if (!params.texture.empty()) texture = read_png_rgb8(file);
    std::vector<std::int32_t> geology =
        soil::geology(mesh, sites, texture ? &*texture : nullptr, soil::preset_soils(),
                      params.geology, "the mesh", progress);
    const int known = static_cast<int>(soil::preset_soils().size());
    for (std::size_t i = 0; i < geology.size(); ++i) {
        if (geology[i] == 0) geology[i] = own;
        if (geology[i] != kOwnSoil && (geology[i] < 1 || geology[i] > known))
            throw InvalidInput(fmt::format(
                "the mesh's attribute geology: {} on face {}; expected 0 (the parameter soil), 1 "
                "to {} or {}",
                geology[i], sites.face[i], known, kOwnSoil));
    }
    return geology;
}

namespace {

constexpr std::array<const char*, 10> kZoneColumns{"day",    "zone",        "species", "living",
                                                   "growth", "fitness",     "light",   "light_sd",
                                                   "theta",  "theta_median"};

/// The value that half the area does not exceed.
double median_by_area(std::vector<std::pair<double, double>>& values)
{
    std::ranges::sort(values);
    double area = 0, below = 0;
    for (const auto& [value, a] : values) area += a;
    for (const auto& [value, a] : values)
        if ((below += a) >= area / 2) return value;
    return 0;
}

}  // namespace

ZoneStatistics::ZoneStatistics(const TriMesh& mesh, const MeshSites& sites, int species)
    : sites_(sites), species_(species)
{
    const auto found = mesh.face_attributes.find("zone");
    if (found == mesh.face_attributes.end()) return;
    const auto* zone = std::get_if<std::vector<std::int32_t>>(&found->second);
    if (!zone) throw InvalidInput("the mesh's attribute 'zone' holds no whole numbers");
    zones_ = *zone;
    std::ranges::sort(zones_);
    zones_.erase(std::unique(zones_.begin(), zones_.end()), zones_.end());
    if (zones_.size() > 1000)
        throw InvalidInput(
            fmt::format("the mesh's attribute 'zone' has {} values, at most 1000", zones_.size()));
    for (const std::uint32_t face : sites.face)
        of_site_.push_back(static_cast<std::uint32_t>(
            std::ranges::lower_bound(zones_, (*zone)[face]) - zones_.begin()));
}

void ZoneStatistics::add(int day, const moss::Plants& plants,
                         std::span<const std::vector<float>> fitness, std::span<const float> light,
                         const std::vector<double>& water, const std::vector<float>& depth)
{
    if (empty()) return;
    struct Sum {
        double area = 0, light = 0, square = 0, theta = 0;
        std::vector<std::pair<double, double>> water;
    };
    std::vector<Sum> ground(zones_.size());
    for (std::size_t i = 0; i < sites_.size(); ++i) {
        Sum& sum = ground[of_site_[i]];
        const double a = double(sites_.area[i]), s = double(light[i]);
        sum.area += a;
        sum.light += a * s;
        sum.square += a * s * s;
        const double theta = water[i] / double(depth[i]);
        sum.theta += a * theta;
        sum.water.emplace_back(theta, a);
    }
    const auto kinds = static_cast<std::size_t>(species_);
    std::vector<double> living(zones_.size() * kinds), growth(living.size()), fit(living.size());
    for (std::size_t i = 0; i < sites_.size(); ++i)
        for (std::size_t s = 0; s < kinds; ++s)
            fit[of_site_[i] * kinds + s] += double(sites_.area[i]) * double(fitness[s][i]);
    for (std::size_t i = 0; i < plants.size(); ++i) {
        const std::size_t k = of_site_[plants.site[i]] * kinds + plants.species[i];
        living[k] += 1;
        growth[k] += double(plants.growth[i]);
    }
    for (std::size_t z = 0; z < zones_.size(); ++z) {
        Sum& sum = ground[z];
        const double median = median_by_area(sum.water);
        for (std::size_t s = 0; s < kinds; ++s) {
            const double mean = sum.light / sum.area;
            for (const double value :
                 {double(day), double(zones_[z]), double(s), living[z * kinds + s],
                  growth[z * kinds + s], fit[z * kinds + s] / sum.area, mean,
                  std::sqrt(std::max(0.0, sum.square / sum.area - mean * mean)),
                  sum.theta / sum.area, median})
                rows_.push_back(value);
        }
    }
}

Points ZoneStatistics::points(const std::string& stage) const
{
    Points points;
    const std::size_t width = kZoneColumns.size(), n = rows_.size() / width;
    points.position.assign(n, Vec3d());
    for (std::size_t c = 0; c < width; ++c) {
        std::vector<double> column(n);
        for (std::size_t r = 0; r < n; ++r) column[r] = rows_[r * width + c];
        points.attributes[kZoneColumns[c]] = std::move(column);
    }
    points.stage = stage;
    return points;
}

void ZoneStatistics::restore(const std::vector<double>& saved)
{
    if (saved.size() % (kZoneColumns.size() * std::max<std::size_t>(1, zones_.size())) != 0)
        throw InvalidInput("checkpoint: the zones are of another mesh");
    rows_ = saved;
}

}  // namespace sekitei::apps
