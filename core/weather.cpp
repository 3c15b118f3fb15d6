#include "core/weather.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/file_output.h"
#include "core/math.h"
#include "core/solar_day.h"
#include "core/weather_formats.h"

namespace sekitei {
namespace weather_formats {

const QuantityInfo& info(Quantity quantity)
{
    static const std::vector<Unit> temperature{
        {"C", 273.15, 1}, {"K", 0, 1}, {"F", 459.67, 5.0 / 9}};
    static const std::vector<Unit> hours{{"h", 0, 1}, {"min", 0, 1.0 / 60}};
    static const std::vector<Unit> radiation{
        {"W/m^2", 0, 1}, {"MJ/m^2", 0, 1e6 / 86400}, {"kWh/m^2", 0, 1000.0 / 24}};
    // Bounds are those of the Earth with room to spare: a slip of a unit or a digit falls outside.
    static const std::array<QuantityInfo, kQuantities> all{{
        {"temperature", 180, 340, temperature},
        {"temperature_min", 180, 340, temperature},
        {"temperature_max", 180, 340, temperature},
        {"dew_point", 180, 340, temperature},
        {"humidity", 0, 1, {{"%", 0, 0.01}, {"1", 0, 1}}},
        {"precipitation", 0, 5000, {{"mm", 0, 1}, {"mm/day", 0, 1}, {"in", 0, 25.4}}},
        {"wind_speed", 0, 150, {{"m/s", 0, 1}, {"km/h", 0, 1 / 3.6}, {"kn", 0, 1852.0 / 3600}}},
        {"wind_direction", 0, 360, {{"deg", 0, 1}}},
        {"sunshine", 0, 24, hours},
        {"possible_sunshine", 0, 24, hours},
        {"global", 0, 700, radiation},
        {"diffuse", 0, 700, radiation},
        {"longwave", 0, 800, radiation},
        {"pressure", 300, 1100, {{"hPa", 0, 1}, {"Pa", 0, 0.01}, {"kPa", 0, 10}}},
    }};
    return all[quantity];
}

std::optional<double> read_quantity(const CsvCell& cell, std::size_t line, Quantity quantity,
                                    const Unit& unit, Problems& problems)
{
    if (cell.text.empty()) return std::nullopt;
    const QuantityInfo& of = info(quantity);
    const auto value = number_of(cell.text);
    if (!value) {
        problems.add(line, cell.column,
                     fmt::format("{}: {}, expected a number", of.name, quoted(cell.text)));
        return std::nullopt;
    }
    // Range ends in the file's unit: what a person typed is compared with what they may type.
    const double low = of.low / unit.scale - unit.offset, high = of.high / unit.scale - unit.offset;
    if (!(*value >= low && *value <= high)) {
        problems.add(line, cell.column,
                     fmt::format("{}: {} {}, expected {:.6g} to {:.6g} {}", of.name, cell.text,
                                 unit.name, low, high, unit.name));
        return std::nullopt;
    }
    return std::clamp((*value + unit.offset) * unit.scale, of.low, of.high);
}

std::optional<Date> read_date(const CsvCell& cell, std::size_t line, Problems& problems)
{
    std::array<int, 3> part{};
    std::string_view rest = cell.text;
    bool good = true;
    for (std::size_t k = 0; k < 3 && good; ++k) {
        const std::size_t end =
            k == 2 ? rest.size() : std::min(rest.find_first_of("-/"), rest.size());
        const std::string_view digits = rest.substr(0, end);
        good =
            !digits.empty() && digits.size() <= 4 &&
            std::all_of(digits.begin(), digits.end(), [](char c) { return c >= '0' && c <= '9'; });
        for (const char c : digits)
            if (good) part[k] = part[k] * 10 + (c - '0');
        rest.remove_prefix(std::min(end + 1, rest.size()));
    }
    if (!good || part[0] < 1) {
        problems.add(line, cell.column,
                     fmt::format("date: {}, expected a day like 2023-04-05", quoted(cell.text)));
        return std::nullopt;
    }
    if (!date_exists(part[0], part[1], part[2])) {
        problems.add(line, cell.column,
                     fmt::format("date: {}, expected a day of the calendar", quoted(cell.text)));
        return std::nullopt;
    }
    return Date{part[0], part[1], part[2]};
}

int direction_of_degrees(double degrees)
{
    return static_cast<int>(std::floor(degrees / 45 + 0.5)) % 8;
}

int direction_of_sixteenth(int point)
{
    return point % 2 == 0 ? point / 2 : (point % 4 == 1 ? point / 2 : (point / 2 + 1) % 8);
}

bool header_starts_with(std::string_view text, std::string_view word)
{
    CsvReader reader(text);
    std::string_view line;
    while (reader.next_line(line)) {
        const std::size_t begin = line.find_first_not_of(" \t\",;");
        if (begin == std::string_view::npos || line[begin] == '#') continue;
        return line.substr(begin).starts_with(word);
    }
    return false;
}

}  // namespace weather_formats

namespace {

using namespace weather_formats;

/// Longest run of days that interpolation may bridge.
constexpr long kLongestGap = 30;
constexpr double kHargreaves = 0.16;  // k_Rs of a place inland [Allen1998, eq. 50]

/// "年月日" in Shift_JIS and UTF-8: in the header of every table of the agency.
constexpr std::string_view kJmaShiftJis = "\x94\x4e\x8c\x8e\x93\xfa";
constexpr std::string_view kJmaUtf8 = "年月日";

std::string text_of(const Date& date)
{
    return fmt::format("{:04}-{:02}-{:02}", date.year, date.month, date.day);
}
long number_of_day(const Date& date)
{
    return day_number(date.year, date.month, date.day);
}

/// Saturation vapour pressure [kPa] at a temperature [K] [Allen1998, eq. 11].
double saturation_pressure(double temperature)
{
    const double t = temperature - 273.15;
    return 0.6108 * math::exp(17.27 * t / (t + 237.3));
}

/// Puts blank days where dates are missing, or names them.
void close_gaps(RawWeather& raw, WeatherFill fill, Problems& problems)
{
    if (raw.days.empty()) return;
    std::vector<RawDay> days;
    std::size_t filled = 0;
    for (const RawDay& day : raw.days) {
        if (!days.empty()) {
            const long step = number_of_day(day.date) - number_of_day(days.back().date);
            if (step <= 0) {
                problems.add(day.line, 1,
                             fmt::format("date: {} follows {}, expected the day after it",
                                         text_of(day.date), text_of(days.back().date)));
                continue;
            }
            if (step > 1 && raw.dates_complete) {
                const Date missing = date_of(number_of_day(days.back().date) + 1);
                const std::string what = step == 2 ? fmt::format("{} is missing", text_of(missing))
                                                   : fmt::format("{} days from {} are missing",
                                                                 step - 1, text_of(missing));
                if (step - 1 > kLongestGap)
                    problems.add(day.line, 1,
                                 fmt::format("date: {}, interpolation bridges at most {}", what,
                                             kLongestGap));
                else if (fill == WeatherFill::Error)
                    problems.add(day.line, 1,
                                 fmt::format("date: {}, expected every day; fill = interpolate "
                                             "bridges gaps",
                                             what));
                else
                    for (long k = 1; k < step; ++k, ++filled) {
                        RawDay blank;
                        blank.date = date_of(number_of_day(days.back().date) + 1);
                        blank.line = day.line;
                        days.push_back(blank);
                    }
            }
        }
        days.push_back(day);
    }
    if (filled > 0)
        raw.notes.push_back(fmt::format("{} missing {} interpolated between neighbours", filled,
                                        filled == 1 ? "day" : "days"));
    raw.days = std::move(days);
}

/// Fills what is still missing of a quantity by straight lines between the days that have it.
void bridge(RawWeather& raw, Quantity quantity, WeatherFill fill, Problems& problems)
{
    auto& days = raw.days;
    auto has = [&](std::size_t i) { return days[i].value[quantity].has_value(); };
    std::size_t filled = 0;
    for (std::size_t i = 0; i < days.size();) {
        if (has(i)) {
            ++i;
            continue;
        }
        std::size_t end = i;
        while (end < days.size() && !has(end)) ++end;
        const bool before = i > 0, after = end < days.size();
        if (fill == WeatherFill::Error || !(before || after) ||
            end - i > static_cast<std::size_t>(kLongestGap)) {
            for (std::size_t k = i; k < end; ++k)
                problems.add(
                    days[k].line, std::max<std::size_t>(1, days[k].column[quantity]),
                    fmt::format("{}: no value on {}, expected a number; {}", info(quantity).name,
                                text_of(days[k].date),
                                fill == WeatherFill::Error
                                    ? "fill = interpolate bridges gaps"
                                    : fmt::format("interpolation bridges at most {} days between "
                                                  "days that have one",
                                                  kLongestGap)));
        } else {
            const double a = *days[before ? i - 1 : end].value[quantity],
                         b = *days[after ? end : i - 1].value[quantity];
            const auto span = static_cast<double>(end - i + 1);
            for (std::size_t k = i; k < end; ++k, ++filled)
                days[k].value[quantity] = a + (b - a) * static_cast<double>(k - i + 1) / span;
        }
        i = end;
    }
    if (filled > 0)
        raw.notes.push_back(fmt::format("{}: interpolated on {} {}", info(quantity).name, filled,
                                        filled == 1 ? "day" : "days"));
}

/// Sets a quantity on the days that lack it wherever `rule` gives a value; notes how often.
template <class Rule>
void derive(RawWeather& raw, Quantity quantity, std::string_view method, Rule&& rule)
{
    std::size_t count = 0;
    for (RawDay& day : raw.days)
        if (!day.value[quantity])
            if (const std::optional<double> value = rule(day)) {
                day.value[quantity] = value;
                ++count;
            }
    if (count > 0)
        raw.notes.push_back(fmt::format("{}: {} on {} {}", info(quantity).name, method, count,
                                        count == 1 ? "day" : "days"));
}

void derive_missing(RawWeather& raw, const std::optional<Site>& site)
{
    derive(raw, kTemperature, "mean of the daily extremes [FAO-56, eq. 9]",
           [](const RawDay& d) -> std::optional<double> {
               if (!d.value[kTemperatureMin] || !d.value[kTemperatureMax]) return std::nullopt;
               return (*d.value[kTemperatureMin] + *d.value[kTemperatureMax]) / 2;
           });
    // Vapour pressure at the dew point over saturation at the mean temperature, since solvers
    // multiply the two again.
    auto humidity_at = [](Quantity dew) {
        return [dew](const RawDay& d) -> std::optional<double> {
            if (!d.value[dew] || !d.value[kTemperature]) return std::nullopt;
            return std::min(1.0, saturation_pressure(*d.value[dew]) /
                                     saturation_pressure(*d.value[kTemperature]));
        };
    };
    derive(raw, kHumidity, "from the dew point", humidity_at(kDewPoint));
    derive(raw, kHumidity, "from the daily minimum temperature as dew point [FAO-56, eq. 48]",
           humidity_at(kTemperatureMin));
    if (!site) return;

    auto day_of = [](const RawDay& d) {
        return day_of_year(d.date.year, d.date.month, d.date.day);
    };
    // A polar night has no Ra to compare with, and no sunshine either.
    auto sunshine_of = [&](const RawDay& d, double ratio) {
        const double n0 =
            d.value[kPossibleSunshine].value_or(possible_sunshine(site->latitude, day_of(d)));
        return n0 * std::clamp((ratio - 0.25) / 0.50, 0.0, 1.0);
    };
    derive(raw, kSunshine, "from global radiation [FAO-56, eq. 35 solved for n]",
           [&](const RawDay& d) -> std::optional<double> {
               if (!d.value[kGlobal]) return std::nullopt;
               const double ra = extraterrestrial_radiation(site->latitude, day_of(d));
               return ra > 0 ? sunshine_of(d, *d.value[kGlobal] / ra) : 0;
           });
    const double k = raw.hargreaves.value_or(kHargreaves);
    derive(raw, kSunshine,
           fmt::format("from the daily temperature range by Hargreaves, k_Rs = {} [FAO-56, eq. 50 "
                       "and 35]",
                       k),
           [&](const RawDay& d) -> std::optional<double> {
               if (!d.value[kTemperatureMin] || !d.value[kTemperatureMax]) return std::nullopt;
               const double range = *d.value[kTemperatureMax] - *d.value[kTemperatureMin];
               return sunshine_of(d, k * std::sqrt(std::max(0.0, range)));
           });
}

/// Names quantities that are neither in the file nor to be had from what is.
void require(const RawWeather& raw, const std::optional<Site>& site, Problems& problems)
{
    auto missing = [&](const std::string& text) { problems.add(raw.header_line, 1, text); };
    const auto& g = raw.given;
    const bool range = g[kTemperatureMin] && g[kTemperatureMax];
    if (!g[kTemperature] && !range)
        missing("temperature is missing, expected it or temperature_min and temperature_max");
    if (!g[kHumidity] && !g[kDewPoint] && !g[kTemperatureMin])
        missing("humidity is missing, expected it, dew_point or temperature_min");
    if (!g[kPrecipitation]) missing("precipitation is missing, expected it (in EPW column 34)");
    if (!g[kWindSpeed]) missing("wind_speed is missing, expected it");
    if (!g[kSunshine] && !g[kGlobal] && !range)
        missing("sunshine is missing, expected it, global or temperature_min and temperature_max");
    if (!site && !(g[kPossibleSunshine] && g[kSunshine]))
        missing(
            "the file names no latitude, which the length of the day and missing sunshine need; "
            "give the site's latitude and longitude");
}

/// Compares values of one day with each other.
void check_day(const RawDay& d, std::size_t& clamped, double& sunshine, double possible,
               Problems& problems)
{
    const auto& low = d.value[kTemperatureMin];
    const auto& high = d.value[kTemperatureMax];
    if (low && high && *low > *high)
        problems.add(d.line, d.column[kTemperatureMin],
                     fmt::format("temperature_min: {:.6g} C, expected at most temperature_max = "
                                 "{:.6g} C",
                                 *low - 273.15, *high - 273.15));
    if (sunshine > possible) {
        if (sunshine > possible * 1.02)
            problems.add(d.line, std::max<std::size_t>(1, d.column[kSunshine]),
                         fmt::format("sunshine: {:.6g} h on {}, expected at most the {:.4g} h "
                                     "between sunrise and sunset; check the site's latitude",
                                     sunshine, text_of(d.date), possible));
        sunshine = possible;
        ++clamped;
    }
    if (d.value[kGlobal] && d.value[kDiffuse] && *d.value[kDiffuse] > *d.value[kGlobal] * 1.02)
        problems.add(d.line, std::max<std::size_t>(1, d.column[kDiffuse]),
                     fmt::format("diffuse: {:.6g} W/m^2, expected at most global = {:.6g} W/m^2",
                                 *d.value[kDiffuse], *d.value[kGlobal]));
}

Weather finish(RawWeather raw, const std::optional<Site>& given_site, WeatherFill fill,
               Problems& problems)
{
    const std::optional<Site> site = given_site ? given_site : raw.site;
    require(raw, site, problems);
    if (raw.days.empty() && !problems.any())
        problems.add(raw.header_line, 1, "no days follow, expected at least one");
    // A file whose columns are in doubt would only repeat that on every line.
    const bool columns_known = raw.given[kTemperature] || raw.given[kTemperatureMin];
    close_gaps(raw, fill, problems);
    if (columns_known && !problems.any()) {
        derive_missing(raw, site);
        for (const Quantity q : {kTemperature, kHumidity, kPrecipitation, kWindSpeed, kSunshine})
            bridge(raw, q, fill, problems);
        if (raw.given[kPossibleSunshine]) bridge(raw, kPossibleSunshine, fill, problems);
    }
    problems.throw_if_any();

    Weather weather;
    weather.site = site;
    weather.stated = raw.site;
    weather.days.reserve(raw.days.size());
    std::size_t clamped = 0, calm = 0, no_pressure = 0;
    std::array<std::size_t, kQuantities> unknown{};
    for (const RawDay& d : raw.days) {
        WeatherDay day;
        day.year = d.date.year;
        day.month = d.date.month;
        day.day = d.date.day;
        const int number = day_of_year(day.year, day.month, day.day);
        day.temperature = *d.value[kTemperature];
        day.humidity = *d.value[kHumidity];
        day.precipitation = *d.value[kPrecipitation];
        day.wind_speed = *d.value[kWindSpeed];
        if (d.value[kWindDirection]) {
            day.wind_direction = static_cast<int>(*d.value[kWindDirection]);
        } else if (raw.given[kWindDirection]) {
            day.wind_direction = weather.days.empty() ? 0 : weather.days.back().wind_direction;
            ++calm;
        } else {
            day.wind_direction = 3 * number % 8;
        }
        day.possible_sunshine = d.value[kPossibleSunshine]
                                    ? *d.value[kPossibleSunshine]
                                    : possible_sunshine(site->latitude, number);
        day.sunshine = *d.value[kSunshine];
        check_day(d, clamped, day.sunshine, day.possible_sunshine, problems);
        day.global_radiation = d.value[kGlobal];
        day.diffuse_radiation = d.value[kDiffuse];
        if (day.global_radiation && day.diffuse_radiation)
            day.diffuse_radiation = std::min(*day.diffuse_radiation, *day.global_radiation);
        day.longwave = d.value[kLongwave];
        for (const Quantity q : {kGlobal, kDiffuse, kLongwave})
            if (raw.given[q] && !d.value[q]) ++unknown[q];
        if (d.value[kPressure])
            day.pressure = *d.value[kPressure];
        else if (raw.given[kPressure])
            ++no_pressure;
        weather.days.push_back(day);
    }
    problems.throw_if_any();

    // Tell what was made up.
    auto& notes = raw.notes;
    auto count = [](std::size_t n) { return fmt::format("{} {}", n, n == 1 ? "day" : "days"); };
    if (!raw.given[kWindDirection])
        notes.push_back(
            "wind_direction: the file has none; the eight directions take turns, 3 d mod 8 for day "
            "d of the year");
    if (calm > 0)
        notes.push_back(
            fmt::format("wind_direction: the day before's on {} without one", count(calm)));
    if (clamped > 0)
        notes.push_back(fmt::format("sunshine: up to 2 % longer than the day on {}, cut to it",
                                    count(clamped)));
    for (const Quantity q : {kGlobal, kDiffuse, kLongwave})
        if (unknown[q] > 0)
            notes.push_back(fmt::format("{}: no value on {}, left to the solvers' formulas",
                                        info(q).name, count(unknown[q])));
    if (no_pressure > 0)
        notes.push_back(
            fmt::format("pressure: 1013 hPa on {} without a value", count(no_pressure)));
    weather.notes = std::move(notes);
    return weather;
}

}  // namespace

Weather decode_weather(std::string_view bytes, const std::string& name,
                       const std::optional<Site>& site, WeatherFill fill)
{
    if (site &&
        !(std::abs(site->latitude) <= math::kPi / 2 && std::abs(site->longitude) <= 2 * math::kPi))
        throw InvalidParameter(fmt::format(
            "weather: latitude = {:.6g} deg, longitude = {:.6g} deg, must be -90 to 90 and -360 to "
            "360",
            site->latitude * 180 / math::kPi, site->longitude * 180 / math::kPi));
    Problems problems(name);
    const std::string text = decode_text(bytes, name, kJmaShiftJis, problems);
    RawWeather raw;
    if (text.starts_with("LOCATION,"))
        raw = read_epw(text, problems);
    else if (text.find(kJmaUtf8) != std::string::npos)
        raw = read_jma(text, problems);
    else if (header_starts_with(text, "month"))
        raw = read_normals(text, problems);
    else
        raw = read_own(text, problems);
    return finish(std::move(raw), site, fill, problems);
}

Weather read_weather(const std::filesystem::path& path, const std::optional<Site>& site,
                     WeatherFill fill)
{
    // A century of hourly values has 160 MB; what is far larger is no weather.
    return decode_weather(read_file(path, 1ull << 28), path.string(), site, fill);
}

Weather select_days(const Weather& weather, std::size_t first, std::size_t count, bool repeat)
{
    const std::size_t length = weather.days.size();
    Weather chosen{{}, weather.site, weather.notes, weather.stated};
    if (first <= length && count <= length - first) {
        const auto begin = weather.days.begin() + static_cast<std::ptrdiff_t>(first);
        chosen.days.assign(begin, begin + static_cast<std::ptrdiff_t>(count));
        return chosen;
    }
    const auto wanted =
        fmt::format("weather: days = {} from day {}, the series has {}", count, first, length);
    if (!repeat)
        throw InvalidParameter(wanted + "; ask for fewer, or let it repeat with --repeat-year");

    // Whole years: until the last day before the date of the first day comes round again.
    std::size_t period = 0;
    for (std::size_t i = 1; i <= length; ++i) {
        const WeatherDay &start = weather.days.front(), &last = weather.days[i - 1];
        const Date next = date_of(day_number(last.year, last.month, last.day) + 1);
        if (next.month == start.month && next.day == start.day) period = i;
    }
    if (period == 0)
        throw InvalidParameter(wanted + ", less than the whole year that --repeat-year needs");
    if (count > (1u << 26) || first > std::numeric_limits<std::size_t>::max() - count)
        throw InvalidParameter(wanted + fmt::format(", must be at most {} days", 1u << 26));
    chosen.days.reserve(count);
    for (std::size_t i = first; i < first + count; ++i)
        chosen.days.push_back(weather.days[i < length ? i : i % period]);
    chosen.notes.push_back(
        fmt::format("days: the first {} of the series repeat, with their dates", period));
    return chosen;
}

}  // namespace sekitei
