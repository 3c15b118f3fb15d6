#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/csv.h"
#include "core/solar_day.h"
#include "core/weather.h"

/// What the readers of weather formats share. Used by core/weather*.cpp only.
namespace sekitei::weather_formats {

/// What a file may tell of a day, in SI units (water [mm], pressure [hPa], sunshine [h]).
enum Quantity {
    kTemperature,
    kTemperatureMin,
    kTemperatureMax,
    kDewPoint,
    kHumidity,
    kPrecipitation,
    kWindSpeed,
    kWindDirection,  // 0..7
    kSunshine,
    kPossibleSunshine,
    kGlobal,
    kDiffuse,
    kLongwave,
    kPressure,
    kQuantities
};

struct Unit {
    std::string_view name;
    double offset, scale;  ///< SI = (value + offset) * scale
};

struct QuantityInfo {
    std::string_view name;  ///< column of our own CSV
    double low, high;       ///< [SI] of a day
    std::vector<Unit> units;
};
const QuantityInfo& info(Quantity quantity);

/// A day as the file has it.
struct RawDay {
    Date date;
    std::size_t line = 0;
    std::array<std::optional<double>, kQuantities> value{};
    std::array<std::size_t, kQuantities> column{};  ///< where it stands; 0: not in the file
};

/// A file as its reader leaves it.
struct RawWeather {
    std::vector<RawDay> days;
    std::array<bool, kQuantities> given{};  ///< the file has a place for it
    std::size_t header_line = 1;            ///< where a missing quantity would be named
    std::optional<Site> site;
    std::optional<double> hargreaves;  ///< k_Rs of [Allen1998, eq. 50]
    std::vector<std::string> notes;
    bool dates_complete = true;  ///< no line was dropped for its date
};

/// A number in `unit`, checked against the quantity's range; a blank cell gives nothing. What is
/// wrong becomes a problem.
std::optional<double> read_quantity(const CsvCell& cell, std::size_t line, Quantity quantity,
                                    const Unit& unit, Problems& problems);

/// 2023-04-05 or 2023/4/5; what is wrong becomes a problem.
std::optional<Date> read_date(const CsvCell& cell, std::size_t line, Problems& problems);

/// 0..7 of degrees from north over east.
int direction_of_degrees(double degrees);
/// 0..7 of 16 points counted from north over east: half winds count to the main wind next to them,
/// NNE to N and ENE to E.
int direction_of_sixteenth(int point);

RawWeather read_jma(std::string_view text, Problems& problems);
RawWeather read_epw(std::string_view text, Problems& problems);
RawWeather read_own(std::string_view text, Problems& problems);      ///< one line a day
RawWeather read_normals(std::string_view text, Problems& problems);  ///< one line a month

/// Whether the first line that is neither blank nor a comment starts with this word.
bool header_starts_with(std::string_view text, std::string_view word);

}  // namespace sekitei::weather_formats
