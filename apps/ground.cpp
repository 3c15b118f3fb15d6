#include "apps/ground.h"

#include <algorithm>

#include "apps/presets.h"
#include "core/error.h"
#include "core/parallel.h"

namespace sekitei::apps {
namespace {

/// Sums of several values over the sites in one pass, in a fixed order.
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

}  // namespace

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

int geology_of_soil(const std::string& name)
{
    const std::vector<soil::Soil>& soils = soil::preset_soils();
    for (std::size_t k = 0; k < soils.size(); ++k)
        if (soils[k].name == name) return static_cast<int>(k) + 1;
    return kOwnSoil;
}

ClimateParams resolved(ClimateParams params)
{
    const bool full = params.profile == Profile::Full;
    params.ground.balance =
        params.balance.value_or(full ? soil::Balance::Exact : soil::Balance::Linear);
    params.sky_view = params.sky_view.value_or(full);
    params.rain_shelter = params.rain_shelter.value_or(full);
    params.runoff = params.runoff.value_or(full);
    return params;
}

Ground::Ground(const ClimateParams& params, Site site, GroundSites sites)
    : params_(resolved(params)), site_(site), s_(std::move(sites)), soils_(soil::preset_soils())
{
    soils_.push_back(s_.own);
    soil_index_.resize(size());
    capacity_.resize(size());
    for (std::size_t i = 0; i < size(); ++i) {
        soil_index_[i] = static_cast<std::uint8_t>(
            s_.geology[i] == kOwnSoil ? soils_.size() - 1 : std::size_t(s_.geology[i] - 1));
        capacity_[i] = double(s_.depth[i]) * soils_[soil_index_[i]].porosity;
    }
    for (const float a : s_.area) area_ += double(a);
}

std::size_t Ground::bytes() const
{
    auto size = [](const auto& v) { return v.capacity() * sizeof(v[0]); };
    std::size_t sum = size(s_.geology) + size(soil_index_) + size(s_.depth) + size(capacity_) +
                      size(s_.layer) + size(s_.paths.order) + size(s_.paths.begin) +
                      size(s_.paths.target) + size(s_.paths.share);
    for (const auto& ratio : s_.wind_ratio) sum += size(ratio);
    return sum;
}

std::vector<double> Ground::initial_water() const
{
    std::vector<double> water(capacity_);
    for (double& w : water) w *= params_.initial_water;
    return water;
}

void Ground::advance(const WeatherDay& w, std::span<const float> light, std::vector<double>& water,
                     std::span<const float> cover, GroundDay& day, const Progress& progress) const
{
    const std::size_t n = size();
    day.weather = w;

    // Air before the object, and along it.
    const auto k = std::size_t(w.wind_direction);
    day.wind.resize(n);
    day.air_temperature.resize(n);
    day.air_humidity.resize(n);
    // Seasons are half a year apart on the southern hemisphere.
    const int season = day_of_year(w.year, w.month, w.day) + (site_.latitude < 0 ? 183 : 0);
    const double pond =
        params_.water_temperature.value_or(wind::water_temperature((season - 1) % 366 + 1));
    const wind::Air air = wind::air_before(w, pond, s_.tables, params_.exchange);
    const std::vector<wind::Air> layers = wind::air_by_layer(w, pond, s_.tables, params_.exchange);
    const bool windy = has_wind();
    parallel_for_range(
        n,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i != end; ++i) {
                const wind::Air& here = s_.layer.empty() ? air : layers[s_.layer[i]];
                day.air_temperature[i] = float(here.temperature);
                day.air_humidity[i] = float(here.humidity);
                day.wind[i] = float(here.speed * (windy ? double(s_.wind_ratio[k][i]) : 1.0));
            }
        },
        4096);

    // Rain, and what runs on.
    std::vector<double>& rain = day.rain.supply;
    rain.resize(n);
    const bool shelter = *params_.rain_shelter;
    const auto before = sums(n, [&](std::size_t i) {
        const double area = double(s_.area[i]);
        rain[i] = w.precipitation * (shelter ? double(s_.rain_exposure[i]) : 1.0);
        return std::array{water[i] * area, rain[i] * area};
    });
    const double stored = before[0];
    day.rainfall = before[1];
    double outflow = 0;
    if (*params_.runoff) {
        soil::route_rain(s_.paths, s_.area, capacity_, water, rain, day.rain);
        outflow = day.rain.outflow;
    } else {
        day.rain.run.assign(n, 0);
    }

    soil::Inputs inputs{.water = water,
                        .light = light,
                        .temperature = day.air_temperature,
                        .humidity = day.air_humidity,
                        .rain = day.rain.supply,
                        .wind = day.wind,
                        .sky_view = 1.0f,
                        .cover = 0.0f,
                        .depth = s_.depth,
                        .soil = soil_index_,
                        .soils = soils_,
                        .air = air_of(w)};
    if (*params_.sky_view) inputs.sky_view = s_.sky_view;
    if (!cover.empty()) inputs.cover = cover;
    soil::run(inputs, params_.ground, day.ground, progress);

    // What route_rain() sent on was not kept: soil::run() found the same excess, plus dew's.
    const auto after = sums(n, [&](std::size_t i) {
        const double area = double(s_.area[i]);
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

soil::Air Ground::air_of(const WeatherDay& w)
{
    return {
        .sunshine = w.possible_sunshine > 0 ? std::min(1.0, w.sunshine / w.possible_sunshine) : 0.0,
        .pressure = w.pressure,
        .longwave = w.longwave};
}

soil::Day Ground::day_at(std::size_t i, const GroundDay& day, double light, double water,
                         double cover) const
{
    return soil::day({.light = light,
                      .temperature = double(day.air_temperature[i]),
                      .humidity = double(day.air_humidity[i]),
                      .rain = day.rain.supply[i],
                      .wind = double(day.wind[i]),
                      .sky_view = *params_.sky_view ? double(s_.sky_view[i]) : 1.0,
                      .cover = cover,
                      .depth = double(s_.depth[i]),
                      .water = water},
                     air_of(day.weather), soils_[soil_index_[i]], params_.ground);
}

}  // namespace sekitei::apps
