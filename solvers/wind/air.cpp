#include "solvers/wind/air.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/math.h"

namespace sekitei::wind {
namespace {

constexpr double kViscosity = 1.51e-5;    // nu of air [m^2/s]
constexpr double kDiffusivity = 2.54e-5;  // D of vapour in air [m^2/s]
constexpr double kLength = 0.03;          // X0 [m]
constexpr double kLowestSpeed = 0.05;     // [m/s]
constexpr double kLn10 = 2.30258509299404568402;

/// q_sat [kg/kg]
double saturation_humidity(double temperature, double pressure)
{
    const double t = temperature - 273.15;
    const double e = 6.1078 * math::exp(7.5 * kLn10 * t / (237.3 + t));
    return 0.622 * e / (pressure - 0.378 * e);
}

void check(const char* field, double value, const char* unit, bool good, const char* range)
{
    if (!good)
        throw InvalidInput(fmt::format("wind: {} = {:.6g}{}{}, must be {}", field, value,
                                       *unit ? " " : "", unit, range));
}

/// Air that has touched `touched` (A_T) of water on its way.
Air mixed(const WeatherDay& day, double water, double touched, double speed,
          const Exchange& exchange)
{
    const double t = day.temperature, p = day.pressure;
    const double dose = touched * exchange_coefficient(day.wind_speed, exchange.law);
    const double f = exchange.bounded ? 1 - math::exp(-dose) : dose;
    const double q = saturation_humidity(t, p) * day.humidity;
    Air air;
    air.temperature = t + f * (water - t);
    const double humid = q + f * (saturation_humidity(water, p) - q);
    air.humidity = std::clamp(humid / saturation_humidity(air.temperature, p), 0.0, 1.0);
    air.speed = speed * day.wind_speed;
    return air;
}

void check(const WeatherDay& day, double water)
{
    const auto warm = [](double t) { return t >= 180 && t <= 340; };
    check("temperature", day.temperature, "K", warm(day.temperature), "180 to 340");
    check("water temperature", water, "K", warm(water), "180 to 340");
    check("humidity", day.humidity, "", day.humidity >= 0 && day.humidity <= 1, "0 to 1");
    check("wind speed", day.wind_speed, "m/s", day.wind_speed >= 0 && std::isfinite(day.wind_speed),
          ">= 0");
    check("wind direction", day.wind_direction, "",
          day.wind_direction >= 0 && day.wind_direction < 8, "0 to 7 (N NE E SE S SW W NW)");
    check("pressure", day.pressure, "hPa", day.pressure >= 300 && day.pressure <= 1200,
          "300 to 1200");
}

}  // namespace

double exchange_coefficient(double speed, ExchangeLaw law)
{
    const double reynolds = kLength * std::max(speed, kLowestSpeed) / kViscosity;
    const double schmidt = math::pow(kViscosity / kDiffusivity, -2.0 / 3);
    if (law == ExchangeLaw::Laminar || (reynolds >= 2.5e3 && reynolds < 1.5e4))
        return 0.664 * schmidt / std::sqrt(reynolds);
    if (reynolds < 2.5e3) return 1.45 * schmidt * math::pow(reynolds, -0.6);
    if (reynolds < 6.5e6) return 0.037 * schmidt * math::pow(reynolds, -0.2);
    return 0.2275 * schmidt * math::pow(math::log(reynolds) / kLn10, -2.58);
}

double water_touch(double speed, double dt, double stream, double depth)
{
    return stream * dt / depth * std::sqrt(speed / stream);
}

AirTables::Table AirTables::straight()
{
    Table azimuth{};
    for (std::size_t k = 0; k < 8; ++k) azimuth[k] = double(k) * (math::kPi / 4);
    return azimuth;
}

std::size_t AirTables::layer_at(double z) const
{
    const double layer = std::floor((z - layer_base) / layer_height);
    return std::size_t(std::clamp(layer, 0.0, double(layers.size() - 1)));
}

int nearest_direction(double azimuth)
{
    const double octant = std::round(azimuth / (math::kPi / 4));
    return int(octant - 8 * std::floor(octant / 8));
}

Air air_before(const WeatherDay& day, double water, const AirTables& tables,
               const Exchange& exchange)
{
    check(day, water);
    const auto k = std::size_t(day.wind_direction);
    Air air = mixed(day, water, tables.temperature[k], tables.speed[k], exchange);
    // Tables from elsewhere may differ between heat and vapour; ours never do.
    if (tables.humidity[k] != tables.temperature[k]) {
        const double p = day.pressure;
        const Air other = mixed(day, water, tables.humidity[k], tables.speed[k], exchange);
        const double q = other.humidity * saturation_humidity(other.temperature, p);
        air.humidity = std::min(1.0, q / saturation_humidity(air.temperature, p));
    }
    return air;
}

std::vector<Air> air_by_layer(const WeatherDay& day, double water, const AirTables& tables,
                              const Exchange& exchange)
{
    check(day, water);
    const auto k = std::size_t(day.wind_direction);
    std::vector<Air> air;
    air.reserve(tables.layers.size());
    for (const AirTables::Table& touched : tables.layers)
        air.push_back(mixed(day, water, touched[k], tables.speed[k], exchange));
    return air;
}

double water_temperature(int day)
{
    return 288.15 - 5 * math::cos(2 * math::kPi * (day - 30) / 365);
}

}  // namespace sekitei::wind
