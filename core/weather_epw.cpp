#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>

#include "core/math.h"
#include "core/weather_formats.h"

/// EnergyPlus weather [Crawley1999]: eight header lines, then 35 columns an hour.
namespace sekitei::weather_formats {
namespace {

constexpr std::size_t kHeaderLines = 8;
constexpr double kDaySum = 0.8;  ///< least share of hours that make a day's value, as at the JMA
constexpr double kSunshineBeam = 120;  ///< direct light of sunshine [WMO2018] [W/m^2]

/// Columns, from 0.
enum EpwColumn : std::size_t {
    kYear = 0,
    kMonth = 1,
    kDayColumn = 2,
    kDryBulb = 6,
    kDewPointColumn = 7,
    kRelativeHumidity = 8,
    kPressureColumn = 9,
    kSkyLongwave = 12,
    kGlobalColumn = 13,
    kDirectNormal = 14,
    kDiffuseColumn = 15,
    kWindFrom = 20,
    kWindSpeedColumn = 21,
    kRainDepth = 33,
    kLeastColumns = 22
};

struct Hourly {
    std::string_view name;
    EpwColumn column;
    double low, high;
    std::string_view unit;
    std::array<double, 2> missing;
};
constexpr Hourly kDry{"dry bulb temperature", kDryBulb, -93, 67, "C", {99.9, 999}};
constexpr Hourly kDew{"dew point temperature", kDewPointColumn, -93, 67, "C", {99.9, 999}};
constexpr Hourly kRh{"relative humidity", kRelativeHumidity, 0, 110, "%", {999, 999.9}};
constexpr Hourly kP{"station pressure", kPressureColumn, 30000, 110000, "Pa", {999999, 999999}};
constexpr Hourly kIr{"infrared radiation", kSkyLongwave, 0, 1000, "Wh/m^2", {9999, 999900}};
constexpr Hourly kGh{"global radiation", kGlobalColumn, 0, 1500, "Wh/m^2", {9999, 999900}};
constexpr Hourly kDni{"direct normal radiation", kDirectNormal, 0, 1500, "Wh/m^2", {9999, 999900}};
constexpr Hourly kGd{"diffuse radiation", kDiffuseColumn, 0, 1500, "Wh/m^2", {9999, 999900}};
constexpr Hourly kFrom{"wind direction", kWindFrom, 0, 360, "deg", {999, 999.9}};
constexpr Hourly kWind{"wind speed", kWindSpeedColumn, 0, 150, "m/s", {999, 999.9}};
constexpr Hourly kRain{"precipitation depth", kRainDepth, 0, 900, "mm", {999, 999.9}};

/// Values of a day, as they come.
struct Mean {
    double sum = 0, low = INFINITY, high = -INFINITY;
    std::size_t count = 0;
    void add(const std::optional<double>& value)
    {
        if (!value) return;
        sum += *value;
        low = std::min(low, *value);
        high = std::max(high, *value);
        ++count;
    }
    double value() const { return sum / static_cast<double>(count); }
};

struct Day {
    Date date;
    std::size_t line = 0, records = 0;
    Mean temperature, humidity, dew, pressure, longwave, global, direct, diffuse, wind, rain;
    std::size_t sunny = 0;
    std::array<double, 8> run{};  // wind run from each direction
};

class Reader {
public:
    explicit Reader(Problems& problems) : problems_(problems) {}

    RawWeather read(std::string_view text)
    {
        CsvReader reader(text);
        std::string_view line;
        std::vector<CsvCell> cells;
        for (std::size_t i = 0; i < kHeaderLines && reader.next_line(line); ++i) {
            CsvReader::split(line, ',', cells);
            if (i == 0) read_location(cells);
            if (i + 1 == kHeaderLines) read_periods(cells, reader.line());
        }
        raw_.header_line = kHeaderLines;
        while (reader.next_line(line)) {
            if (line.find_first_not_of(" \t,") == std::string_view::npos) continue;
            CsvReader::split(line, ',', cells);
            read_record(cells, reader.line());
        }
        if (!days_.empty()) finish();
        return std::move(raw_);
    }

private:
    void read_location(const std::vector<CsvCell>& cells)
    {
        auto angle = [&](std::size_t i, std::string_view name, double most) {
            const auto value = i < cells.size() ? number_of(cells[i].text) : std::nullopt;
            if (!value || !(std::abs(*value) <= most))
                problems_.add(
                    1, i < cells.size() ? cells[i].column : 1,
                    fmt::format("{}: {}, expected {:g} to {:g} deg", name,
                                quoted(i < cells.size() ? cells[i].text : ""), -most, most));
            return value.value_or(0) * math::kPi / 180;
        };
        raw_.site = Site{angle(6, "latitude", 90), angle(7, "longitude", 180)};
    }

    void read_periods(const std::vector<CsvCell>& cells, std::size_t line)
    {
        const double an_hour =
            (cells.size() > 2 ? number_of(cells[2].text) : std::nullopt).value_or(0);
        if (cells[0].text != "DATA PERIODS" || an_hour < 1 || an_hour > 60 ||
            an_hour != std::floor(an_hour))
            problems_.add(line, 1,
                          "expected the eighth header line, DATA PERIODS, with 1 to 60 records an "
                          "hour");
        else
            records_a_day_ = 24 * static_cast<std::size_t>(an_hour);
    }

    std::optional<double> value(const std::vector<CsvCell>& cells, std::size_t line,
                                const Hourly& of)
    {
        if (of.column >= cells.size() || cells[of.column].text.empty()) return std::nullopt;
        const CsvCell& cell = cells[of.column];
        const auto number = number_of(cell.text);
        if (!number) {
            problems_.add(line, cell.column,
                          fmt::format("{}: {}, expected a number", of.name, quoted(cell.text)));
            return std::nullopt;
        }
        for (const double code : of.missing)
            if (*number == code) return std::nullopt;
        if (!(*number >= of.low && *number <= of.high)) {
            problems_.add(
                line, cell.column,
                fmt::format("{}: {} {}, expected {:g} to {:g} {}, or {:g} where missing", of.name,
                            cell.text, of.unit, of.low, of.high, of.unit, of.missing[0]));
            return std::nullopt;
        }
        return number;
    }

    /// Year, month and day of a record.
    std::optional<Date> date_of_record(const std::vector<CsvCell>& cells, std::size_t line)
    {
        std::array<int, 3> part{};
        for (std::size_t k = 0; k < 3; ++k) {
            const auto number = number_of(cells[k].text);
            if (!number || *number != std::floor(*number) || *number < 1 || *number > 9999) {
                problems_.add(
                    line, cells[k].column,
                    fmt::format("{}: {}, expected a whole number",
                                std::array{"year", "month", "day"}[k], quoted(cells[k].text)));
                return std::nullopt;
            }
            part[k] = static_cast<int>(*number);
        }
        if (!date_exists(part[0], part[1], part[2])) {
            problems_.add(line, cells[kDayColumn].column,
                          fmt::format("date: {:04}-{:02}-{:02}, expected a day of the calendar",
                                      part[0], part[1], part[2]));
            return std::nullopt;
        }
        return Date{part[0], part[1], part[2]};
    }

    void read_record(const std::vector<CsvCell>& cells, std::size_t line)
    {
        if (cells.size() < kLeastColumns) {
            problems_.add(line, 1,
                          fmt::format("line has {} cells, expected 35 (at least {})", cells.size(),
                                      static_cast<std::size_t>(kLeastColumns)));
            raw_.dates_complete = false;
            return;
        }
        const auto date = date_of_record(cells, line);
        if (!date) {
            raw_.dates_complete = false;
            return;
        }
        if (days_.empty() || !(days_.back().date == *date)) {
            days_.emplace_back();
            days_.back().date = *date;
            days_.back().line = line;
        }
        Day& day = days_.back();
        ++day.records;
        auto humidity = value(cells, line, kRh);
        if (humidity && *humidity > 100) {
            humidity = 100;
            ++supersaturated_;
        }
        day.temperature.add(value(cells, line, kDry));
        day.dew.add(value(cells, line, kDew));
        day.humidity.add(humidity);
        day.pressure.add(value(cells, line, kP));
        day.longwave.add(value(cells, line, kIr));
        day.global.add(value(cells, line, kGh));
        day.diffuse.add(value(cells, line, kGd));
        const auto direct = value(cells, line, kDni);
        day.direct.add(direct);
        if (direct && *direct > kSunshineBeam) ++day.sunny;
        day.rain.add(value(cells, line, kRain));
        const auto speed = value(cells, line, kWind), from = value(cells, line, kFrom);
        day.wind.add(speed);
        if (speed && from) day.run[static_cast<std::size_t>(direction_of_degrees(*from))] += *speed;
    }

    /// A typical year is made of months of many years: one year for all.
    void date_typical_year()
    {
        bool running = true, leap = false;
        for (std::size_t i = 0; i < days_.size(); ++i) {
            const Date& d = days_[i].date;
            leap = leap || (d.month == 2 && d.day == 29);
            if (i > 0 && d.year != days_[i - 1].date.year) {
                const Date& before = days_[i - 1].date;
                running = running && d.year == before.year + 1 && before.month == 12;
            }
        }
        if (running) return;
        const int year = leap ? 2024 : 2023;
        for (Day& day : days_) day.date.year = year;
        raw_.notes.push_back(
            fmt::format("a typical year made of months of several years, dated {}", year));
    }

    void finish()
    {
        date_typical_year();
        const double full = static_cast<double>(records_a_day_);
        std::size_t partial = 0;
        bool any_direct = false;
        for (const Day& day : days_) {
            if (day.records != records_a_day_)
                problems_.add(day.line, 1,
                              fmt::format("date: {:04}-{:02}-{:02} has {} records, expected {}",
                                          day.date.year, day.date.month, day.date.day, day.records,
                                          records_a_day_));
            RawDay raw;
            raw.date = day.date;
            raw.line = day.line;
            bool filled = false;
            // A day's mean of four fifths of its hours or more; radiation needs them all, since
            // a missing noon and a missing midnight are not alike.
            auto put = [&](Quantity q, const Mean& mean, bool all, double offset, double scale) {
                raw_.given[q] = raw_.given[q] || mean.count > 0;
                const auto count = static_cast<double>(mean.count);
                if (mean.count == 0 || count < (all ? full : full * kDaySum)) return;
                filled = filled || count < full;
                raw.value[q] = (mean.value() + offset) * scale;
            };
            put(kTemperature, day.temperature, false, 273.15, 1);
            put(kDewPoint, day.dew, false, 273.15, 1);
            put(kHumidity, day.humidity, false, 0, 0.01);
            put(kPressure, day.pressure, false, 0, 0.01);
            put(kLongwave, day.longwave, true, 0, full / 24);
            put(kGlobal, day.global, true, 0, full / 24);
            put(kDiffuse, day.diffuse, true, 0, full / 24);
            put(kWindSpeed, day.wind, false, 0, 1);
            put(kPrecipitation, day.rain, false, 0, full);
            if (raw.value[kTemperature]) {
                raw.value[kTemperatureMin] = day.temperature.low + 273.15;
                raw.value[kTemperatureMax] = day.temperature.high + 273.15;
                raw_.given[kTemperatureMin] = raw_.given[kTemperatureMax] = true;
            }
            if (day.direct.count == records_a_day_) {
                const double n0 = possible_sunshine(
                    raw_.site->latitude, day_of_year(day.date.year, day.date.month, day.date.day));
                raw.value[kSunshine] = std::min(n0, static_cast<double>(day.sunny) * 24 / full);
                any_direct = true;
            }
            const auto most = std::max_element(day.run.begin(), day.run.end());
            raw_.given[kWindDirection] = true;
            if (*most > 0) raw.value[kWindDirection] = static_cast<double>(most - day.run.begin());
            partial += filled;
            raw_.days.push_back(raw);
        }
        raw_.given[kSunshine] = any_direct;
        if (any_direct)
            raw_.notes.push_back(fmt::format(
                "sunshine: hours with direct light above {:g} W/m^2 [WMO-No. 8]", kSunshineBeam));
        if (partial > 0)
            raw_.notes.push_back(
                fmt::format("means of the hours there are on {} days with hours missing", partial));
        if (supersaturated_ > 0)
            raw_.notes.push_back(
                fmt::format("humidity: above 100 % in {} records, cut to 100 %", supersaturated_));
    }

    Problems& problems_;
    RawWeather raw_;
    std::vector<Day> days_;
    std::size_t records_a_day_ = 24, supersaturated_ = 0;
};

}  // namespace

RawWeather read_epw(std::string_view text, Problems& problems)
{
    return Reader(problems).read(text);
}

}  // namespace sekitei::weather_formats
