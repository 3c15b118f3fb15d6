#include "solvers/moss/growth.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/clones.h"
#include "core/error.h"
#include "core/inline_math.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::moss {
namespace {

constexpr double kLn2 = 0.693147180559945309;

void check_order(const std::string& who, const char* low_name, double low, const char* high_name,
                 double high, const char* unit)
{
    if (!(high > low))
        throw InvalidParameter(fmt::format("{}: {} = {:.9g}{}, must be > {} = {:.9g}{}", who,
                                           high_name, high, unit, low_name, low, unit));
}

/// g from s - 1/2 and its distance from 0, scaled and to the power n.
inline double shaped(double above, double power, double scale)
{
    const double g = 0.5 + std::copysign(power / scale, above);
    return g < 0 ? 0 : g;
}

double powered(double distance, double softness)
{
    return softness == 1     ? distance
           : softness == 0.5 ? std::sqrt(distance)
                             : math::pow(distance, softness);
}

double gate(const Rules& rules, double light)
{
    return rules.light_gate ? 1 - math::inline_exp(-light / rules.light_compensation) : 1;
}

// The same operations as for one site, a block at a time: the loops without a branch run several
// sites side by side.
constexpr std::size_t kBlock = 256;
constexpr double kNoLimit = 1e300;

SEKITEI_CLONES void bells_above(const float* x, std::size_t n, double limit, double x0, double x1,
                                double* above)
{
    for (std::size_t i = 0; i < n; ++i) {
        const double value = x[i] < limit ? x[i] : limit;
        const double z = (value - (x0 + x1) / 2) / (x1 - x0);
        above[i] = math::inline_exp(-4 * kLn2 * z * z) - 0.5;
    }
}

SEKITEI_CLONES void roots(double* distance, std::size_t n)
{
    for (std::size_t i = 0; i < n; ++i) distance[i] = std::sqrt(distance[i]);
}

SEKITEI_CLONES void multiply_shaped(double* g, const double* above, const double* power,
                                    std::size_t n, double scale)
{
    for (std::size_t i = 0; i < n; ++i) g[i] *= shaped(above[i], power[i], scale);
}

SEKITEI_CLONES void multiply_gate(double* g, const float* light, std::size_t n, double compensation)
{
    for (std::size_t i = 0; i < n; ++i)
        g[i] *= 1 - math::inline_exp(-static_cast<double>(light[i]) / compensation);
}

/// g[i] *= response(min(x[i], limit), ...)
void multiply_response(double* g, const float* x, std::size_t n, double limit, double x0, double x1,
                       double softness, Response form)
{
    double above[kBlock], power[kBlock];
    const double scale = form == Response::Normalised ? 2 : 1;
    bells_above(x, n, limit, x0, x1, above);
    for (std::size_t i = 0; i < n; ++i) power[i] = scale * std::abs(above[i]);
    if (softness == 0.5)
        roots(power, n);
    else if (softness != 1)
        for (std::size_t i = 0; i < n; ++i) power[i] = powered(power[i], softness);
    multiply_shaped(g, above, power, n, scale);
}

}  // namespace

const std::vector<Species>& preset_species()
{
    static const std::vector<Species> species = {
        {},
        {"hypnum", 276.15, 295.15, 1, 0.90, 1.10, 0.5, 0, 40, 1, 0.25, 0.100, 0.35, 0.15, 0},
        {"polytrichum", 278.15, 297.15, 1, 0.85, 1.15, 1, 0, 50, 1, 0.30, 0.075, 0.37, 0.12, 0},
        {"grimmia", 268.15, 303.15, 1, 0.75, 1.25, 0.5, 0, 220, 1, 0.20, 0.100, 0.35, 0.10, 0}};
    return species;
}

void validate(const Species& s)
{
    const std::string who = "species " + s.name;
    validate_described(who, s);
    check_order(who, "temperature_low", s.temperature_low, "temperature_high", s.temperature_high,
                " K");
    check_order(who, "humidity_low", s.humidity_low, "humidity_high", s.humidity_high, "");
    check_order(who, "light_low", s.light_low, "light_high", s.light_high, " W/m^2");
}

void validate(const Rules& r)
{
    validate_described("moss", r);
    check_order("moss", "gemma_age_low", r.gemma_age_low, "gemma_age_high", r.gemma_age_high, " d");
    check_order("moss", "spore_age_low", r.spore_age_low, "spore_age_high", r.spore_age_high, " d");
}

double bell(double x, double x0, double x1)
{
    const double z = (x - (x0 + x1) / 2) / (x1 - x0);
    return math::inline_exp(-4 * kLn2 * z * z);
}

double response(double x, double x0, double x1, double softness, Response form)
{
    const double above = bell(x, x0, x1) - 0.5;
    const double scale = form == Response::Normalised ? 2 : 1;
    return shaped(above, powered(scale * std::abs(above), softness), scale);
}

Fitness fitness(const Species& s, const Rules& rules, double temperature, double humidity,
                double light)
{
    return {.temperature = response(temperature, s.temperature_low, s.temperature_high,
                                    s.temperature_softness, rules.response),
            .humidity = response(std::min(humidity, 1.0), s.humidity_low, s.humidity_high,
                                 s.humidity_softness, rules.response),
            .light = response(light, s.light_low, s.light_high, s.light_softness, rules.response),
            .gate = gate(rules, light)};
}

void fitness(const Species& s, const Rules& rules, std::span<const float> temperature,
             std::span<const float> humidity, std::span<const float> light, std::span<float> result,
             const Progress& progress)
{
    const std::size_t count = result.size();
    if (temperature.size() != count || humidity.size() != count || light.size() != count)
        throw InvalidInput(fmt::format(
            "moss: {} temperatures, {} humidities, {} lights for {} sites; they must agree",
            temperature.size(), humidity.size(), light.size(), count));
    parallel_for_range(
        count,
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            for (std::size_t first = begin; first < end; first += kBlock) {
                const std::size_t n = std::min(kBlock, end - first);
                double g[kBlock];
                std::fill_n(g, n, 1.0);
                multiply_response(g, temperature.data() + first, n, kNoLimit, s.temperature_low,
                                  s.temperature_high, s.temperature_softness, rules.response);
                multiply_response(g, humidity.data() + first, n, 1, s.humidity_low, s.humidity_high,
                                  s.humidity_softness, rules.response);
                multiply_response(g, light.data() + first, n, kNoLimit, s.light_low, s.light_high,
                                  s.light_softness, rules.response);
                if (rules.light_gate)
                    multiply_gate(g, light.data() + first, n, rules.light_compensation);
                for (std::size_t i = 0; i < n; ++i) result[first + i] = static_cast<float>(g[i]);
            }
        },
        4096);
}

double daily_growth(const Species& s, const Rules& rules, double fitness)
{
    return rules.growth_rate * s.growth_rate * (fitness - s.growth_threshold);
}

double grown(const Rules& rules, double growth, double daily_growth)
{
    return std::clamp(growth + daily_growth, 0.0, rules.growth_cap);
}

bool dies(const Species& s, double growth, double daily_growth)
{
    return growth < s.death_threshold && daily_growth < 0;
}

int gemmae_shed(const Rules& rules, double largest_before, double largest_now)
{
    const double before = std::floor(largest_before / rules.gemma_step);
    const double now = std::floor(largest_now / rules.gemma_step);
    return static_cast<int>(std::clamp(now - before, 0.0, 1e6));
}

bool spore_shed(const Rules& rules, double growth, double daily_growth)
{
    return growth >= rules.spore_threshold && daily_growth > 0;
}

DayOfLife live_a_day(const Species& species, const Rules& rules, double fitness, float& growth,
                     float& growth_max)
{
    const double d = daily_growth(species, rules, fitness);
    growth = static_cast<float>(grown(rules, double(growth), d));
    const double now = double(growth), before = double(growth_max);
    if (dies(species, now, d)) return {.died = true};
    growth_max = std::max(growth_max, growth);
    return {.gemmae = now > before ? gemmae_shed(rules, before, now) : 0,
            .spore = spore_shed(rules, now, d)};
}

double seed_readiness(Seed kind, const Rules& r, int age)
{
    return kind == Seed::Gemma
               ? response(age, r.gemma_age_low, r.gemma_age_high, 1, Response::Normalised)
               : response(age, r.spore_age_low, r.spore_age_high, 1, Response::Normalised);
}

bool germinates(const Species& s, Seed kind, const Rules& rules, int age, double fitness)
{
    return age >= 1 && fitness * seed_readiness(kind, rules, age) > s.germination_threshold;
}

int last_germination_age(const Species& s, Seed kind, const Rules& r)
{
    // bell > tau_b within (x1 - x0) sqrt(-ln tau_b / (4 ln 2)) of the middle; the test decides.
    const double low = kind == Seed::Gemma ? r.gemma_age_low : r.spore_age_low;
    const double high = kind == Seed::Gemma ? r.gemma_age_high : r.spore_age_high;
    const double reach = (high - low) * std::sqrt(-math::log(s.germination_threshold) / (4 * kLn2));
    const double last = std::clamp((low + high) / 2 + reach + 1, 0.0, 2e9);
    int age = static_cast<int>(last);
    while (age > 0 && last - age < 3 && !germinates(s, kind, r, age, 1)) --age;
    return germinates(s, kind, r, age, 1) ? age : 0;
}

}  // namespace sekitei::moss
