#include "apps/climate.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "apps/presets.h"
#include "core/error.h"
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

constexpr int kRock = 3;       // and the harder ones after it
constexpr int kOwnSoil = 100;  // geology of a soil from a file
constexpr float kWallSlope = 0.10f;

/// Sums of several values over the cells in one pass, in a fixed order.
template <class F>
auto sums(std::size_t count, F&& values)
{
    using Sum = decltype(values(std::size_t(0)));
    auto join = [](Sum a, const Sum& b) {
        for (std::size_t k = 0; k < a.size(); ++k) a[k] += b[k];
        return a;
    };
    return parallel_fold(
        count, 1024, Sum{},
        [&](std::size_t begin, std::size_t end) {
            Sum sum{};
            for (std::size_t i = begin; i != end; ++i) sum = join(sum, values(i));
            return sum;
        },
        join);
}

/// The soil that ClimateParams::soil means: where the soil stage left its numbers, those, so that a
/// file of soil is read once.
soil::Soil own_soil(const Scene& scene, const ClimateParams& params,
                    const std::filesystem::path& folder)
{
    if (const auto grid = scene.grids.find("geology"); grid != scene.grids.end())
        if (const auto kept = grid->second.extra.find("soil"); kept != grid->second.extra.end()) {
            soil::Soil soil;
            const Json numbers = Json::parse(kept->get<std::string>(), nullptr, false);
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

ParamList describe(ClimateParams& params)
{
    ParamList list = describe_params(params);
    for (Param& p : describe_params(params.exchange)) list.push_back(std::move(p));
    for (Param& p : describe_params(params.ground))
        if (p.name != "balance") list.push_back(std::move(p));
    return list;
}

void validate(const ClimateParams& params)
{
    validate_described("soil", params);
    soil::validate(params.ground);
}

soil::Soil find_soil(const std::string& name, const std::filesystem::path& folder)
{
    return preset_or_file("soil", name, folder, soil::preset_soils(),
                          [](soil::Soil& soil, const std::string&) { soil::validate(soil); });
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
    : params_(params), weather_(weather_of(scene))
{
    const bool full = params.profile == Profile::Full;
    params_.ground.balance =
        params.balance.value_or(full ? soil::Balance::Exact : soil::Balance::Linear);
    params_.sky_view = params.sky_view.value_or(full);
    params_.rain_shelter = params.rain_shelter.value_or(full);
    params_.runoff = params.runoff.value_or(full);
    site_ = *weather_.site;
    const FloatGrid& surface = scene.floats("surface_sdf");
    cells_ = surface_cells(surface, scene.vectors("surf_normal"), scene.floats("surf_area"),
                           progress.slice(0, 0.3));
    coefficients_ = coefficients_of(scene, cells_);

    // Soils: what the scene says, else the same everywhere.
    soils_ = soil::preset_soils();
    soils_.push_back(own_soil(scene, params, folder));
    int id = kOwnSoil;
    for (std::size_t k = 0; k + 1 < soils_.size(); ++k)
        if (soils_[k].name == params.soil) id = static_cast<int>(k) + 1;
    geology_ = scene.has("geology") ? cells_.from_grid(scene.ints("geology"), 0)
                                    : std::vector<std::int32_t>(cells_.size(), id);
    soil_index_.resize(cells_.size());
    for (std::size_t i = 0; i < cells_.size(); ++i) {
        if (geology_[i] == 0) geology_[i] = id;
        const bool known = geology_[i] == kOwnSoil ||
                           (geology_[i] > 0 && geology_[i] < static_cast<int>(soils_.size()));
        if (!known)
            throw InvalidInput(fmt::format(
                "grid geology: {} at voxel ({}, {}, {}); expected 0 (the parameter soil), 1 to {} "
                "or {}",
                geology_[i], cells_.voxel[i].x, cells_.voxel[i].y, cells_.voxel[i].z,
                soils_.size() - 1, kOwnSoil));
        soil_index_[i] = static_cast<std::uint8_t>(
            geology_[i] == kOwnSoil ? soils_.size() - 1 : std::size_t(geology_[i] - 1));
    }
    if (scene.has("soil_h"))
        depth_ = cells_.from_grid(scene.floats("soil_h"), 1);
    else if (params.depth)
        depth_.assign(cells_.size(), static_cast<float>(*params.depth * 1000));
    else {
        depth_ = thickness(surface, cells_, progress.slice(0.3, 0.4));
        for (std::size_t i = 0; i < cells_.size(); ++i)
            if (geology_[i] >= kRock && geology_[i] != kOwnSoil) depth_[i] = 20;
    }
    capacity_.resize(cells_.size());
    for (std::size_t i = 0; i < cells_.size(); ++i) {
        if (!(depth_[i] > 0))
            throw InvalidInput(fmt::format("grid soil_h: {} mm at voxel ({}, {}, {}), must be > 0",
                                           depth_[i], cells_.voxel[i].x, cells_.voxel[i].y,
                                           cells_.voxel[i].z));
        capacity_[i] = double(depth_[i]) * soils_[soil_index_[i]].porosity;
    }

    has_wind_ = scene.has("wind_ratio_0");
    if (has_wind_) {
        for (int k = 0; k < 8; ++k)
            wind_ratio_[std::size_t(k)] =
                cells_.from_grid(scene.floats(fmt::format("wind_ratio_{}", k)), 1);
        tables_ = tables_of(scene);
        if (!tables_.layers.empty()) {
            layer_.resize(cells_.size());
            for (std::size_t i = 0; i < cells_.size(); ++i)
                layer_[i] = static_cast<std::uint8_t>(tables_.layer_at(cells_.position[i].z));
        }
    }
    for (const float a : cells_.area) area_ += a;
    if (*params_.runoff) {
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
        paths_ = soil::runoff_paths(
            {foot, up, cells_.area, cells_.neighbour_begin, cells_.neighbour, drops},
            progress.slice(0.6, 1));
    }
}

std::size_t Climate::bytes() const
{
    auto size = [](const auto& v) { return v.capacity() * sizeof(v[0]); };
    std::size_t sum = size(geology_) + size(soil_index_) + size(depth_) + size(capacity_) +
                      size(layer_) + size(paths_.order) + size(paths_.begin) + size(paths_.target) +
                      size(paths_.share);
    for (const auto& ratio : wind_ratio_) sum += size(ratio);
    return sum;
}

std::vector<double> Climate::initial_water() const
{
    std::vector<double> water(capacity_);
    for (double& w : water) w *= params_.initial_water;
    return water;
}

void Climate::advance(std::size_t index, std::vector<double>& water, std::span<const float> cover,
                      ClimateDay& day, const Progress& progress) const
{
    const std::size_t n = cells_.size();
    const WeatherDay& w = weather_.days[index];
    day.weather = w;
    const auto moments = sun::moments_of_day(w.year, w.month, w.day, site_);
    const sun::Radiation radiation = sun::radiation(w, site_, moments);
    // A day's light asks no more rays: where they would start does not matter.
    day.light = light::day(coefficients_, {cells_.position, cells_.normal, cells_.area}, moments,
                           radiation);

    // Air before the object, and along it.
    const auto k = std::size_t(w.wind_direction);
    day.wind.resize(n);
    day.air_temperature.resize(n);
    day.air_humidity.resize(n);
    // Seasons are half a year apart on the southern hemisphere.
    const int season = day_of_year(w.year, w.month, w.day) + (site_.latitude < 0 ? 183 : 0);
    const double pond =
        params_.water_temperature.value_or(wind::water_temperature((season - 1) % 366 + 1));
    const wind::Air air = wind::air_before(w, pond, tables_, params_.exchange);
    const std::vector<wind::Air> layers = wind::air_by_layer(w, pond, tables_, params_.exchange);
    parallel_for_range(
        n,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i != end; ++i) {
                const wind::Air& here = layer_.empty() ? air : layers[layer_[i]];
                day.air_temperature[i] = float(here.temperature);
                day.air_humidity[i] = float(here.humidity);
                day.wind[i] = float(here.speed * (has_wind_ ? double(wind_ratio_[k][i]) : 1.0));
            }
        },
        4096);

    // Rain, and what runs on.
    std::vector<double>& rain = day.rain.supply;
    rain.resize(n);
    const bool shelter = *params_.rain_shelter;
    const auto before = sums(n, [&](std::size_t i) {
        const double area = double(cells_.area[i]);
        rain[i] = w.precipitation * (shelter ? double(coefficients_.rain_exposure[i]) : 1.0);
        return std::array{water[i] * area, rain[i] * area};
    });
    const double stored = before[0];
    day.rainfall = before[1];
    double outflow = 0;
    if (*params_.runoff) {
        soil::route_rain(paths_, cells_.area, capacity_, water, rain, day.rain);
        outflow = day.rain.outflow;
    } else {
        day.rain.run.assign(n, 0);
    }

    soil::Inputs inputs{
        .water = water,
        .light = day.light.total,
        .temperature = day.air_temperature,
        .humidity = day.air_humidity,
        .rain = day.rain.supply,
        .wind = day.wind,
        .sky_view = 1.0f,
        .cover = 0.0f,
        .depth = depth_,
        .soil = soil_index_,
        .soils = soils_,
        .air = {.sunshine =
                    w.possible_sunshine > 0 ? std::min(1.0, w.sunshine / w.possible_sunshine) : 0.0,
                .pressure = w.pressure,
                .longwave = w.longwave}};
    if (*params_.sky_view) inputs.sky_view = coefficients_.sky_view;
    if (!cover.empty()) inputs.cover = cover;
    soil::run(inputs, params_.ground, day.ground, progress);

    // What route_rain() sent on was not kept: soil::run() found the same excess, plus dew's.
    const auto after = sums(n, [&](std::size_t i) {
        const double area = double(cells_.area[i]);
        return std::array{day.ground.water[i] * area, day.ground.evaporation[i] * area,
                          (day.ground.runoff[i] - day.rain.run[i]) * area,
                          day.rain.supply[i] * area};
    });
    day.evaporation = after[1];
    day.outflow = outflow + after[2];
    day.balance_error = (stored + day.rainfall - after[0] - day.evaporation - day.outflow) /
                        std::max(stored + day.rainfall, area_);
    day.inflow = after[3] - day.rainfall;
    water.swap(day.ground.water);
}

}  // namespace sekitei::apps
