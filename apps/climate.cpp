#include "apps/climate.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "apps/presets.h"
#include "core/error.h"
#include "core/json.h"
#include "core/log.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/solar_day.h"

namespace sekitei::apps {
namespace {

template <class T>
const std::vector<T>& attribute(const Points& points, const std::string& set,
                                const std::string& name)
{
    if (const auto* values = points.values<T>(name)) return *values;
    if (points.attributes.contains(name))
        throw InvalidInput(
            fmt::format("the attribute '{}' of the points '{}' has an unexpected type", name, set));
    throw InvalidInput(fmt::format("the points '{}' have no attribute '{}'", set, name));
}

/// The numbers of a day that are always there, by the name of their attribute.
constexpr std::pair<const char*, double WeatherDay::*> kNumbers[] = {
    {"temperature", &WeatherDay::temperature},
    {"humidity", &WeatherDay::humidity},
    {"precipitation", &WeatherDay::precipitation},
    {"wind_speed", &WeatherDay::wind_speed},
    {"possible_sunshine", &WeatherDay::possible_sunshine},
    {"sunshine", &WeatherDay::sunshine},
    {"pressure", &WeatherDay::pressure}};
/// Those that may be missing: -1 then, since none can be negative.
constexpr std::pair<const char*, std::optional<double> WeatherDay::*> kMeasured[] = {
    {"global_radiation", &WeatherDay::global_radiation},
    {"diffuse_radiation", &WeatherDay::diffuse_radiation},
    {"longwave", &WeatherDay::longwave}};
constexpr std::pair<const char*, int WeatherDay::*> kWhole[] = {
    {"year", &WeatherDay::year},
    {"month", &WeatherDay::month},
    {"day", &WeatherDay::day},
    {"wind_direction", &WeatherDay::wind_direction}};

/// What the solvers take, in the order of kNumbers; the day's length and the sunshine in hours.
constexpr std::pair<double, double> kPossible[] = {{180, 340}, {0, 1},  {0, 5000},  {0, 150},
                                                   {0, 24},    {0, 24}, {300, 1200}};

constexpr float kWallSlope = 0.10f;

/// The soil that ClimateParams::soil means: where the soil stage left its numbers, those, so that a
/// file of soil is read once.
soil::Soil own_soil(const Scene& scene, const ClimateParams& params,
                    const std::filesystem::path& folder)
{
    if (const auto grid = scene.grids.find("geology"); grid != scene.grids.end())
        if (const auto kept = grid->second.extra.find("soil"); kept != grid->second.extra.end()) {
            soil::Soil soil;
            const Json numbers = parse_json(kept->get<std::string>(), false);
            for (const Param& p : describe_params(soil))
                if (numbers.is_object() && numbers.contains(p.name)) p.set(numbers[p.name]);
            soil::validate(soil);
            return soil;
        }
    return find_soil(params.soil, folder);
}

/// Solid below each cell, straight down [mm], from 1 to 1000; 1 on walls and undersides.
std::vector<float> thickness(const FloatGrid& surface, const SurfaceCells& cells,
                             const Progress& progress)
{
    const double voxel = cells.transform.voxel;
    const int most = static_cast<int>(std::ceil(1 / voxel));
    std::vector<float> depth(cells.size());
    parallel_for_range(
        cells.size(),
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            GridReader<float> reader(surface);
            for (std::size_t i = begin; i != end; ++i) {
                double solid = 0.001;
                if (cells.normal[i].z > kWallSlope) {
                    double above = cells.sdf[i];
                    solid = -above;
                    for (int k = 1; k <= most; ++k) {
                        const double below = reader.value(cells.voxel[i] - Coord(0, 0, k));
                        if (below >= 0) {
                            solid += voxel * above / (above - below);
                            break;
                        }
                        solid += voxel;
                        above = below;
                    }
                }
                depth[i] = static_cast<float>(1000 * std::clamp(solid, 0.001, 1.0));
            }
        },
        1024);
    return depth;
}

/// The cell that a drop from an underside falls on: the first below it, -1 where there is none.
std::vector<std::int32_t> drop_targets(const FloatGrid& surface, const SurfaceCells& cells,
                                       const Progress& progress)
{
    std::vector<std::int32_t> target(cells.size(), -1);
    int lowest = std::numeric_limits<int>::max();
    for (std::size_t leaf = 0; leaf < cells.index.leaf_count(); ++leaf)
        lowest = std::min(lowest, cells.index.origin(leaf).z);
    parallel_for_range(
        cells.size(),
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            GridReader<std::int32_t> at(cells.index);
            GridReader<float> sdf(surface);
            for (std::size_t i = begin; i != end; ++i) {
                if (cells.normal[i].z > -0.3f) continue;
                bool out = false;  // the drop has left the solid it hung on
                for (Coord c = cells.voxel[i]; c.z >= lowest; c.z -= 1) {
                    const bool solid = sdf.value(c) < 0;
                    out = out || !solid;
                    if (!out || !solid) continue;
                    if (const std::int32_t below = at.value(c);
                        below >= 0 && cells.normal[std::size_t(below)].z > -0.3f)
                        target[i] = below;
                    break;
                }
            }
        },
        1024);
    return target;
}

}  // namespace

Points weather_points(const Weather& weather)
{
    Points points;
    const std::size_t n = weather.days.size();
    points.position.assign(n, Vec3d());
    for (const auto& [name, field] : kNumbers) {
        std::vector<double> values(n);
        for (std::size_t i = 0; i < n; ++i) values[i] = weather.days[i].*field;
        points.attributes[name] = std::move(values);
    }
    for (const auto& [name, field] : kMeasured) {
        std::vector<double> values(n);
        for (std::size_t i = 0; i < n; ++i) values[i] = (weather.days[i].*field).value_or(-1);
        points.attributes[name] = std::move(values);
    }
    for (const auto& [name, field] : kWhole) {
        std::vector<std::int32_t> values(n);
        for (std::size_t i = 0; i < n; ++i) values[i] = weather.days[i].*field;
        points.attributes[name] = std::move(values);
    }
    const Site site = weather.site.value_or(Site{});
    points.attributes["latitude"] = std::vector<double>(n, site.latitude);
    points.attributes["longitude"] = std::vector<double>(n, site.longitude);
    points.stage = "light";
    return points;
}

Weather weather_of(const Scene& scene)
{
    const Points& points = scene.points_of("weather");
    Weather weather;
    weather.days.resize(points.position.size());
    if (weather.days.empty()) throw InvalidInput("the points 'weather' are empty");
    for (const auto& [name, field] : kNumbers) {
        const auto& values = attribute<double>(points, "weather", name);
        for (std::size_t i = 0; i < values.size(); ++i) weather.days[i].*field = values[i];
    }
    for (const auto& [name, field] : kMeasured) {
        const auto& values = attribute<double>(points, "weather", name);
        for (std::size_t i = 0; i < values.size(); ++i)
            if (values[i] >= 0) weather.days[i].*field = values[i];
    }
    for (const auto& [name, field] : kWhole) {
        const auto& values = attribute<std::int32_t>(points, "weather", name);
        for (std::size_t i = 0; i < values.size(); ++i) weather.days[i].*field = values[i];
    }
    weather.site = Site{attribute<double>(points, "weather", "latitude").front(),
                        attribute<double>(points, "weather", "longitude").front()};
    for (std::size_t i = 0; i < weather.days.size(); ++i) {
        const int direction = weather.days[i].wind_direction;
        if (direction < 0 || direction > 7 ||
            !date_exists(weather.days[i].year, weather.days[i].month, weather.days[i].day))
            throw InvalidInput(fmt::format(
                "the points 'weather': day {} is {}-{}-{} with wind_direction {}; expected a date "
                "and 0 to 7",
                i, weather.days[i].year, weather.days[i].month, weather.days[i].day, direction));
    }
    auto require = [](bool good, const char* name, std::size_t i, double value,
                      const std::string& expected) {
        if (!good)
            throw InvalidInput(fmt::format(
                "the points 'weather': {} = {} on day {}, must be {}; run `sekitei light` again",
                name, value, i, expected));
    };
    for (std::size_t i = 0; i < weather.days.size(); ++i) {
        for (std::size_t k = 0; k < std::size(kNumbers); ++k) {
            const auto& [name, field] = kNumbers[k];
            const auto [low, high] = kPossible[k];
            const double value = weather.days[i].*field;
            require(value >= low && value <= high, name, i, value,
                    fmt::format("{} to {}", low, high));
        }
        for (const auto& [name, field] : kMeasured) {
            const double value = attribute<double>(points, "weather", name)[i];
            require(value == -1 || (value >= 0 && value < 1e4), name, i, value,
                    "0 to 10000, or -1 for none");
        }
    }
    require(std::abs(weather.site->latitude) <= math::kPi / 2, "latitude [rad]", 0,
            weather.site->latitude, "-pi/2 to pi/2");
    require(std::abs(weather.site->longitude) <= 2 * math::kPi, "longitude [rad]", 0,
            weather.site->longitude, "-2 pi to 2 pi");
    return weather;
}

Points table_points(const wind::AirTables& tables)
{
    Points points;
    points.position.assign(8, Vec3d());
    auto put = [&](const std::string& name, const wind::AirTables::Table& table) {
        points.attributes[name] = std::vector<double>(table.begin(), table.end());
    };
    put("A_U", tables.speed);
    put("A_T", tables.temperature);
    put("A_q", tables.humidity);
    put("direction", tables.direction);
    for (std::size_t k = 0; k < tables.layers.size(); ++k)
        put(fmt::format("A_T_layer_{}", k), tables.layers[k]);
    points.attributes["layer_base"] = std::vector<double>(8, tables.layer_base);
    points.attributes["layer_height"] = std::vector<double>(8, tables.layer_height);
    points.stage = "wind";
    return points;
}

wind::AirTables tables_of(const Scene& scene)
{
    const Points& points = scene.points_of("air_tables");
    if (points.position.size() != 8)
        throw InvalidInput(
            fmt::format("the points 'air_tables' are {}, must be 8, one for each "
                        "direction of the wind",
                        points.position.size()));
    auto get = [&](const std::string& name) {
        const auto& values = attribute<double>(points, "air_tables", name);
        wind::AirTables::Table table;
        std::copy_n(values.begin(), 8, table.begin());
        for (const double v : table)
            if (!(v >= 0 && v < 1e6))
                throw InvalidInput(fmt::format(
                    "the points 'air_tables': {} = {}, must be a number >= 0", name, v));
        return table;
    };
    wind::AirTables tables;
    tables.speed = get("A_U");
    tables.temperature = get("A_T");
    tables.humidity = get("A_q");
    tables.direction = get("direction");
    for (int k = 0; points.attributes.contains(fmt::format("A_T_layer_{}", k)); ++k)
        tables.layers.push_back(get(fmt::format("A_T_layer_{}", k)));
    tables.layer_base = attribute<double>(points, "air_tables", "layer_base").front();
    tables.layer_height = attribute<double>(points, "air_tables", "layer_height").front();
    return tables;
}

Points daylight_points(const light::Coefficients& coefficients, const SurfaceCells& cells)
{
    Points points;
    points.position = cells.position;
    const std::size_t n = cells.size();
    for (std::size_t w = 0; w < coefficients.words(); ++w)
        points.attributes[fmt::format("bits_{:02}", w)] = coefficients.word(w);
    for (std::size_t k = 0; k * n < coefficients.links.size(); ++k)
        points.attributes[fmt::format("link_{:02}", k)] =
            std::vector<std::int32_t>(coefficients.links.begin() + std::ptrdiff_t(k * n),
                                      coefficients.links.begin() + std::ptrdiff_t((k + 1) * n));
    points.stage = "light";
    return points;
}

light::Coefficients coefficients_of(const Scene& scene, const SurfaceCells& cells)
{
    const Points& points = scene.points_of("daylight");
    if (points.position.size() != cells.size())
        throw InvalidInput(
            fmt::format("the points 'daylight' are {}, the surface has {} cells; run `sekitei "
                        "light` on this surface",
                        points.position.size(), cells.size()));
    for (std::size_t i = 0; i < cells.size(); ++i) {
        const Vec3d a = points.position[i], b = cells.position[i];
        if (length(a - b) > 0.01 * cells.transform.voxel)
            throw InvalidInput(fmt::format(
                "the points 'daylight': point {} lies at ({:.4g}, {:.4g}, {:.4g}) m, the cell at "
                "({:.4g}, {:.4g}, {:.4g}) m; they are of another surface, run `sekitei light` on "
                "this one",
                i, a.x, a.y, a.z, b.x, b.y, b.z));
    }
    const Json* made = params_of(scene, "light");
    if (!made)
        throw InvalidInput(
            "the scene's history knows no light stage, whose parameters say what the points "
            "'daylight' mean; run `sekitei light`");
    light::Coefficients c;
    for (const Param& p : describe_params(c.params))
        if (made->contains(p.name)) p.set((*made)[p.name]);
    c.latitude = attribute<double>(scene.points_of("weather"), "weather", "latitude").front();
    c.sites = cells.size();
    std::size_t words = 0, links = 0;
    for (const auto& [name, values] : points.attributes) {
        words += name.starts_with("bits_");
        links += name.starts_with("link_");
    }
    c.bits.reserve(words * cells.size());
    c.links.reserve(links * cells.size());
    for (int w = 0; points.attributes.contains(fmt::format("bits_{:02}", w)); ++w) {
        const auto& word =
            attribute<std::int32_t>(points, "daylight", fmt::format("bits_{:02}", w));
        c.bits.insert(c.bits.end(), word.begin(), word.end());
    }
    for (int k = 0; points.attributes.contains(fmt::format("link_{:02}", k)); ++k) {
        const auto& link =
            attribute<std::int32_t>(points, "daylight", fmt::format("link_{:02}", k));
        c.links.insert(c.links.end(), link.begin(), link.end());
    }
    if (c.bits.empty())
        throw InvalidInput(
            "the points 'daylight' have no attribute 'bits_00'; run `sekitei light`");
    const auto count = static_cast<std::int32_t>(cells.size());
    for (std::size_t i = 0; i < c.links.size(); ++i)
        if (!light::link_fits(c.links[i], count))
            throw InvalidInput(fmt::format(
                "the points 'daylight': link_{:02} = {} at point {}, which is no cell of this "
                "surface; run `sekitei light` on it",
                i / cells.size(), c.links[i], i % cells.size()));
    c.sky_view = cells.from_grid(scene.floats("sky_view"), 0);
    c.rain_exposure = cells.from_grid(scene.floats("rain_exposure"), 0);
    return c;
}

std::vector<std::string> climate_needs()
{
    return {"surface_sdf",   "surf_normal", "surf_area", "sky_view",
            "rain_exposure", "daylight",    "weather"};
}

std::vector<std::string> climate_uses()
{
    std::vector<std::string> names{"geology", "soil_h", "air_tables"};
    for (int k = 0; k < 8; ++k) names.push_back(fmt::format("wind_ratio_{}", k));
    return names;
}

Climate::Climate(const Scene& scene, const ClimateParams& params,
                 const std::filesystem::path& folder, const Progress& progress)
    : weather_(weather_of(scene))
{
    const ClimateParams p = resolved(params);
    site_ = *weather_.site;
    const FloatGrid& surface = scene.floats("surface_sdf");
    cells_ = surface_cells(surface, scene.vectors("surf_normal"), scene.floats("surf_area"),
                           progress.slice(0, 0.3));
    coefficients_ = coefficients_of(scene, cells_);

    // Soils: what the scene says, else the same everywhere.
    GroundSites s;
    s.own = own_soil(scene, params, folder);
    const std::vector<soil::Soil>& soils = soil::preset_soils();
    const int id = geology_of_soil(params.soil);
    s.geology = scene.has("geology") ? cells_.from_grid(scene.ints("geology"), 0)
                                     : std::vector<std::int32_t>(cells_.size(), id);
    for (std::size_t i = 0; i < cells_.size(); ++i) {
        if (s.geology[i] == 0) s.geology[i] = id;
        const bool known = s.geology[i] == kOwnSoil ||
                           (s.geology[i] > 0 && s.geology[i] <= static_cast<int>(soils.size()));
        if (!known)
            throw InvalidInput(fmt::format(
                "grid geology: {} at voxel ({}, {}, {}); expected 0 (the parameter soil), 1 to {} "
                "or {}",
                s.geology[i], cells_.voxel[i].x, cells_.voxel[i].y, cells_.voxel[i].z, soils.size(),
                kOwnSoil));
    }
    if (scene.has("soil_h"))
        s.depth = cells_.from_grid(scene.floats("soil_h"), 1);
    else if (params.depth)
        s.depth.assign(cells_.size(), static_cast<float>(*params.depth * 1000));
    else {
        s.depth = thickness(surface, cells_, progress.slice(0.3, 0.4));
        for (std::size_t i = 0; i < cells_.size(); ++i)
            if (is_stone(s.geology[i])) s.depth[i] = kSkinDepth;
    }
    for (std::size_t i = 0; i < cells_.size(); ++i)
        if (!(s.depth[i] > 0))
            throw InvalidInput(fmt::format("grid soil_h: {} mm at voxel ({}, {}, {}), must be > 0",
                                           s.depth[i], cells_.voxel[i].x, cells_.voxel[i].y,
                                           cells_.voxel[i].z));

    if (scene.has("wind_ratio_0")) {
        for (int k = 0; k < 8; ++k)
            s.wind_ratio[std::size_t(k)] =
                cells_.from_grid(scene.floats(fmt::format("wind_ratio_{}", k)), 1);
        s.tables = tables_of(scene);
        if (!s.tables.layers.empty()) {
            s.layer.resize(cells_.size());
            for (std::size_t i = 0; i < cells_.size(); ++i)
                s.layer[i] = static_cast<std::uint8_t>(s.tables.layer_at(cells_.position[i].z));
        }
    }
    if (*p.runoff) {
        std::vector<Vec3d> foot(cells_.size());
        std::vector<float> up(cells_.size());
        for (std::size_t i = 0; i < cells_.size(); ++i) {
            foot[i] = cells_.position[i] - Vec3d(cells_.normal[i]) * double(cells_.sdf[i]);
            up[i] = cells_.normal[i].z;
        }
        std::vector<std::int32_t> drops = drop_targets(surface, cells_, progress.slice(0.4, 0.6));
        // In a gap of one voxel both feet may meet: such drops are lost.
        for (std::size_t i = 0; i < drops.size(); ++i)
            if (drops[i] >= 0 && !(foot[std::size_t(drops[i])].z < foot[i].z)) drops[i] = -1;
        s.paths = soil::runoff_paths(
            {foot, up, cells_.area, cells_.neighbour_begin, cells_.neighbour, drops},
            progress.slice(0.6, 1));
    }
    s.area = cells_.area;
    s.sky_view = coefficients_.sky_view;
    s.rain_exposure = coefficients_.rain_exposure;
    ground_ = Ground(params, site_, std::move(s));
}

void Climate::advance(std::size_t index, std::vector<double>& water, std::span<const float> cover,
                      ClimateDay& day, const Progress& progress) const
{
    const WeatherDay& w = weather_.days[index];
    const auto moments = sun::moments_of_day(w.year, w.month, w.day, site_);
    // A day's light asks no more rays: where they would start does not matter.
    day.light = light::day(coefficients_, {cells_.position, cells_.normal, cells_.area}, moments,
                           sun::radiation(w, site_, moments));
    ground_.advance(w, day.light.total, water, cover, day, progress);
}

}  // namespace sekitei::apps
