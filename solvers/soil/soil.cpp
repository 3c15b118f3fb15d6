#include "solvers/soil/soil.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/inline_math.h"
#include "core/log.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::soil {
namespace {

constexpr double kLn10 = 2.302585092994045684;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

double fourth(double x)
{
    return (x * x) * (x * x);
}

struct Saturation {
    double q, slope;
};

/// q_sat and its exact derivative, from one exponential.
Saturation saturation(double temperature, double pressure)
{
    const double t = temperature - 273.15, s = 237.3 + t;
    const double e = 6.1078 * math::inline_exp(7.5 * kLn10 * t / s);
    const double dry = pressure - 0.378 * e;
    if (!(dry > 0)) return {kInfinity, kInfinity};
    return {0.622 * e / dry, 0.622 * pressure / (dry * dry) * e * (kLn10 * 7.5 * 237.3) / (s * s)};
}

/// What depends on T, rh and the day alone, often the same for many sites.
struct Weather {
    double temperature = -1, humidity = -1;
    double q = 0, slope = 0, vapour = 0;  ///< q_sat, Delta, rh q_sat
    double dew = 0;                       ///< T_d [K]
    double black = 0, sky = 0;            ///< sigma T^4, L of the whole sky [W/m^2]
};

Weather weather_at(double temperature, double humidity, const Air& air, double cloud,
                   const Params& params)
{
    Weather w;
    w.temperature = temperature;
    w.humidity = humidity;
    const Saturation at = saturation(temperature, air.pressure);
    w.q = at.q;
    w.slope = at.slope;
    w.vapour = humidity * at.q;
    w.dew = params.balance == Balance::Exact ? dew_point(w.vapour, air.pressure) : 0;
    w.black = kStefanBoltzmann * fourth(temperature);
    double loss = 0.26;
    if (params.longwave == Longwave::Brutsaert) {
        const double e = humidity * vapour_pressure(temperature);
        loss = 1 - 1.24 * math::pow(e / temperature, 1.0 / 7);
    }
    w.sky = air.longwave.value_or(w.black * (1 - loss * cloud));
    return w;
}

/// The root of f(T_s) = gain - sigma T_s^4 - c (T_s - T) - a (q_sat(T_s) - vapour), which falls
/// everywhere, by Newton steps inside a bracket.
double balanced_temperature(double gain, double c, double a, const Weather& w, double pressure,
                            double guess)
{
    auto f = [&](double ts, double& derivative) {
        double value = gain - kStefanBoltzmann * fourth(ts) - c * (ts - w.temperature);
        derivative = -4 * kStefanBoltzmann * ts * ts * ts - c;
        if (a > 0) {
            const Saturation at = saturation(ts, pressure);
            value -= a * (at.q - w.vapour);
            derivative -= a * at.slope;
        }
        return value;
    };
    double lower = w.temperature - 80, upper = w.temperature + 80, derivative = 0;
    // Widen only where a Newton step wants to leave: few balances need it.
    bool lower_known = false, upper_known = false;
    double ts = std::clamp(guess, lower, upper);
    for (int i = 0; i < 100; ++i) {
        const double value = f(ts, derivative);
        if (value == 0) break;
        if (value > 0)
            lower = ts, lower_known = true;
        else
            upper = ts, upper_known = true;
        double next = ts - value / derivative;
        if (!(next > lower) && !lower_known && value < 0) {
            double unused = 0;
            while (lower > 40 && f(lower, unused) < 0) lower = std::max(40.0, lower - 80);
            lower_known = true;
        }
        if (!(next < upper) && !upper_known && value > 0) {
            double unused = 0;
            while (f(upper, unused) > 0) upper += 80;
            upper_known = true;
        }
        if (!(next > lower && next < upper)) next = 0.5 * (lower + upper);
        const double step = next - ts;
        ts = next;
        // The next step would be some 0.02 / K times this one squared: below 1e-11 K.
        if (std::abs(step) <= 1e-5) break;
    }
    return ts;
}

struct Bad {
    const char* field;
    double value;
    const char* unit;
    const char* range;
};

/// The first field of a site out of its range.
std::optional<Bad> bad_field(const Site& s)
{
    auto negative = [](double v) { return !(v >= 0 && v < kInfinity); };
    if (!(s.temperature >= 180 && s.temperature <= 340))
        return Bad{"temperature", s.temperature, " K", "180 to 340"};
    if (!(s.humidity >= 0 && s.humidity <= 1)) return Bad{"humidity", s.humidity, "", "0 to 1"};
    if (negative(s.light)) return Bad{"light", s.light, " W/m^2", ">= 0"};
    if (negative(s.rain)) return Bad{"rain", s.rain, " mm", ">= 0"};
    if (negative(s.wind)) return Bad{"wind", s.wind, " m/s", ">= 0"};
    if (!(s.sky_view >= 0 && s.sky_view <= 1)) return Bad{"sky_view", s.sky_view, "", "0 to 1"};
    if (negative(s.cover)) return Bad{"cover", s.cover, "", ">= 0"};
    if (!(s.depth > 0 && s.depth < kInfinity)) return Bad{"depth", s.depth, " mm", "> 0"};
    if (negative(s.water)) return Bad{"water", s.water, " mm", ">= 0"};
    return std::nullopt;
}

[[noreturn]] void reject(const Bad& bad, const std::string& where)
{
    throw InvalidInput(fmt::format("soil:{} {} = {:.6g}{}, must be {}", where, bad.field, bad.value,
                                   bad.unit, bad.range));
}

/// The day's air with A in 0..1.
Air checked(Air air)
{
    if (air.sunshine > 1 && air.sunshine <= 1.02) {
        log::warning("soil: sunshine = {:.4g} of the possible, taken as 1", air.sunshine);
        air.sunshine = 1;
    }
    if (!(air.sunshine >= 0 && air.sunshine <= 1))
        reject({"sunshine", air.sunshine, "", "0 to 1"}, "");
    if (!(air.pressure > 0 && air.pressure < 2000))
        reject({"pressure", air.pressure, " hPa", "0 to 2000"}, "");
    if (air.longwave && !(*air.longwave >= 0 && *air.longwave < kInfinity))
        reject({"longwave", *air.longwave, " W/m^2", ">= 0"}, "");
    return air;
}

/// p > 0.378 e, or there is no air left in the vapour.
std::optional<Bad> bad_pressure(const Site& site, const Air& air)
{
    if (air.pressure > 0.378 * vapour_pressure(site.temperature)) return std::nullopt;
    return Bad{"pressure", air.pressure, " hPa", "> 0.378 e_sat"};
}

Day solve(const Site& site, const Air& air, const Weather& w, const Soil& soil,
          const Params& params)
{
    const double wind = std::max(site.wind, params.lowest_wind);
    const double covered = params.exchange_bare + (params.exchange_covered - params.exchange_bare) *
                                                      std::min(1.0, site.cover);
    const double conductance = covered * wind;
    const double exchange = params.moss_blocks_evaporation ? params.exchange_bare : covered;

    Day d;
    d.absorbed = (1 - soil.albedo.value_or(params.albedo)) * site.light + site.sky_view * w.sky +
                 (1 - site.sky_view) * w.black;
    // Rain first: what finds no room runs off.
    const double capacity = site.depth * soil.porosity;
    double water = site.water + site.rain;
    d.runoff = std::max(0.0, water - capacity);
    water -= d.runoff;
    d.beta = evaporation_share(soil, water / site.depth, exchange, wind);

    // Energy balance.
    const double net = d.absorbed - w.black;
    const double c = kAirHeat * conductance;
    const double k = 4 * w.black / w.temperature + c;
    const double a = kLatentHeat * kAirDensity * exchange * wind;
    const double dryness = w.q - w.vapour;
    double rise = 0, q_surface = 0;
    const bool exact = params.balance == Balance::Exact;
    const bool dew =
        exact ? d.absorbed - kStefanBoltzmann * fourth(w.dew) - c * (w.dew - w.temperature) < 0
              : w.slope * net + k * dryness < 0;
    if (dew) d.beta = 1;
    rise = (net - a * d.beta * dryness) / (k + a * d.beta * w.slope);
    if (exact) {
        d.temperature =
            balanced_temperature(d.absorbed, c, a * d.beta, w, air.pressure, w.temperature + rise);
        rise = d.temperature - w.temperature;
        q_surface = saturation(d.temperature, air.pressure).q;
    } else {
        d.temperature = w.temperature + rise;
        q_surface = w.q + w.slope * rise;
    }
    double evaporation = kAirDensity * d.beta * exchange * wind * (q_surface - w.vapour);  // [mm/s]

    // No more leaves than there is: then the rest of the heat warms the ground.
    if (evaporation > water / kDaySeconds) {
        evaporation = water / kDaySeconds;
        d.latent = kLatentHeat * evaporation;
        rise = (net - d.latent) / k;
        if (exact) {
            d.temperature = balanced_temperature(d.absorbed - d.latent, c, 0, w, air.pressure,
                                                 w.temperature + rise);
            rise = d.temperature - w.temperature;
            q_surface = saturation(d.temperature, air.pressure).q;
        } else {
            d.temperature = w.temperature + rise;
            q_surface = w.q + w.slope * rise;
        }
        const double potential = kAirDensity * exchange * wind * (q_surface - w.vapour);
        d.beta = potential > 0 ? std::clamp(evaporation / potential, 0.0, 1.0) : 0;
        d.evaporation = water;
        d.water = 0;
    } else {
        d.latent = kLatentHeat * evaporation;
        d.evaporation = kDaySeconds * evaporation;
        water = std::max(0.0, water - d.evaporation);
        const double excess = std::max(0.0, water - capacity);  // dew on full ground
        d.runoff += excess;
        d.water = water - excess;
    }
    d.sensible = c * rise;
    d.humidity = d.beta + (1 - d.beta) * w.vapour / q_surface;
    return d;
}

template <class T>
void check_length(const char* what, const Values<T>& values, std::size_t count)
{
    if (!values.fits(count))
        throw InvalidInput(
            fmt::format("soil: {}: one value for each of {} sites, or one for all", what, count));
}

Site site_at(const Inputs& in, std::size_t i)
{
    return {.light = in.light[i],
            .temperature = in.temperature[i],
            .humidity = in.humidity[i],
            .rain = in.rain[i],
            .wind = in.wind[i],
            .sky_view = in.sky_view[i],
            .cover = in.cover[i],
            .depth = in.depth[i],
            .water = in.water[i]};
}

std::size_t soil_at(const Inputs& in, std::size_t i)
{
    return in.soil.empty() ? 0 : in.soil[i];
}

constexpr std::size_t kChunk = 4096;

/// The smallest i in [0, count) for which test(i) holds, else count.
template <class Test>
std::size_t first_where(std::size_t count, Test&& test)
{
    return parallel_fold(
        count, kChunk, count,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i != end; ++i)
                if (test(i)) return i;
            return count;
        },
        [](std::size_t a, std::size_t b) { return std::min(a, b); });
}

}  // namespace

const std::vector<Soil>& preset_soils()
{
    // F0 = F1 theta_sat^F2 of the printed F1. For asphalt that gives 3.95e-30 m, as if it were
    // always wet; `asphalt` and `rock` take the magnitude of the others.
    static const std::vector<Soil> soils = {{"humus", 0.172351295, 10.0, 0.490, {}},
                                            {"sand", 0.147459256, 16.6, 0.392, {}},
                                            {"rock", 0.15, 19.4, 0.012, {}},
                                            {"asphalt", 0.15, 19.4, 0.012, {}},
                                            {"asphalt_printed", 3.95e-30, 19.4, 0.012, {}}};
    return soils;
}

void validate(const Soil& soil)
{
    validate_described("soil " + soil.name, soil);
}

void validate(const Params& params)
{
    validate_described("soil", params);
}

double vapour_pressure(double temperature)
{
    const double t = temperature - 273.15;
    return 6.1078 * math::inline_exp(7.5 * kLn10 * t / (237.3 + t));
}

double saturation_humidity(double temperature, double pressure)
{
    return saturation(temperature, pressure).q;
}

double saturation_slope(double temperature, double pressure)
{
    return saturation(temperature, pressure).slope;
}

double dew_point(double q, double pressure)
{
    if (!(q > 0)) return 0;
    const double e = pressure * q / (0.622 + 0.378 * q);
    const double x = math::inline_log(e / 6.1078) / kLn10;
    return 273.15 + 237.3 * x / (7.5 - x);
}

double evaporation_share(const Soil& soil, double theta, double exchange, double wind)
{
    const double room = 1 - theta / soil.porosity;  // below 0 counts as 1e-300
    const double f = soil.scale * math::inline_exp(soil.exponent * math::inline_log(room));
    return 1 / (1 + exchange * wind * f / kDiffusivity);
}

double cloud_factor(double a)
{
    return 0.298 + a * (1.135 + a * (-1.234 + a * 0.826));
}

Day day(const Site& site, const Air& air, const Soil& soil, const Params& params)
{
    if (const auto bad = bad_field(site)) reject(*bad, "");
    const Air a = checked(air);
    if (const auto bad = bad_pressure(site, a)) reject(*bad, "");
    return solve(site, a,
                 weather_at(site.temperature, site.humidity, a, cloud_factor(a.sunshine), params),
                 soil, params);
}

void run(const Inputs& in, const Params& params, Result& result, const Progress& progress)
{
    validate(params);
    const std::size_t count = in.water.size();
    check_length("light", in.light, count);
    check_length("temperature", in.temperature, count);
    check_length("humidity", in.humidity, count);
    check_length("rain", in.rain, count);
    check_length("wind", in.wind, count);
    check_length("sky_view", in.sky_view, count);
    check_length("cover", in.cover, count);
    check_length("depth", in.depth, count);
    if (!in.soil.empty() && in.soil.size() != count)
        throw InvalidInput(
            fmt::format("soil: {} sites have {} kinds of soil", count, in.soil.size()));
    if (in.soils.empty()) throw InvalidInput("soil: no kinds of soil, at least one is needed");
    for (const Soil& s : in.soils) validate(s);
    const Air air = checked(in.air);

    // Look at every site before anything is written.
    auto site_is_bad = [&](std::size_t i) {
        const Site s = site_at(in, i);
        return bad_field(s) || soil_at(in, i) >= in.soils.size();
    };
    if (const std::size_t i = first_where(count, site_is_bad); i < count) {
        const std::string where = fmt::format(" site {}:", i);
        if (const auto bad = bad_field(site_at(in, i))) reject(*bad, where);
        throw InvalidInput(fmt::format("soil:{} kind of soil = {}, must be 0 to {}", where,
                                       soil_at(in, i), in.soils.size() - 1));
    }
    // e_sat rises with T: the warmest site is the one to look at.
    float warmest = 0;
    for (std::size_t i = 0; i < count; ++i) warmest = std::max(warmest, in.temperature[i]);
    if (const auto bad = bad_pressure({.temperature = warmest}, air); bad && count)
        reject(*bad, "");

    result.water.resize(count);
    result.evaporation.resize(count);
    result.runoff.resize(count);
    result.temperature.resize(count);
    result.humidity.resize(count);
    result.beta.resize(count);
    const double cloud = cloud_factor(air.sunshine);
    parallel_for_range(
        count,
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            Weather w;
            for (std::size_t i = begin; i != end; ++i) {
                const Site site = site_at(in, i);
                if (site.temperature != w.temperature || site.humidity != w.humidity)
                    w = weather_at(site.temperature, site.humidity, air, cloud, params);
                const Day d = solve(site, air, w, in.soils[soil_at(in, i)], params);
                result.water[i] = d.water;
                result.evaporation[i] = d.evaporation;
                result.runoff[i] = d.runoff;
                result.temperature[i] = static_cast<float>(d.temperature);
                result.humidity[i] = static_cast<float>(d.humidity);
                result.beta[i] = static_cast<float>(d.beta);
            }
        },
        kChunk);

    const std::size_t broken = first_where(count, [&](std::size_t i) {
        return !(std::isfinite(result.water[i]) && std::isfinite(result.evaporation[i]) &&
                 std::isfinite(result.temperature[i]) && std::isfinite(result.humidity[i]));
    });
    if (broken < count) {
        const Site s = site_at(in, broken);
        throw NumericalError(fmt::format(
            "soil: site {}: result is not finite (S = {:.9g} W/m^2, T = {:.9g} K, rh = {:.9g}, "
            "P = {:.9g} mm, U = {:.9g} m/s, V = {:.9g}, c = {:.9g}, h = {:.9g} mm, O = {:.9g} mm)",
            broken, s.light, s.temperature, s.humidity, s.rain, s.wind, s.sky_view, s.cover,
            s.depth, s.water));
    }
}

}  // namespace sekitei::soil
