#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace sekitei {

/// One day of weather; all radiation as a 24-hour mean.
struct WeatherDay {
    int year = 0, month = 1, day = 1;
    double temperature = 0;                   ///< [K]
    double humidity = 0;                      ///< relative, 0..1
    double precipitation = 0;                 ///< [mm/day]
    double wind_speed = 0;                    ///< [m/s]
    int wind_direction = 0;                   ///< 0..7 = N NE E SE S SW W NW, where it blows from
    double possible_sunshine = 0;             ///< N0 [h]
    double sunshine = 0;                      ///< N [h]
    std::optional<double> global_radiation;   ///< on the horizontal [W/m^2]
    std::optional<double> diffuse_radiation;  ///< its diffuse part [W/m^2]
    std::optional<double> longwave;           ///< from the sky [W/m^2]
    double pressure = 1013.0;                 ///< [hPa]
};

/// "N", "NE" ... of a direction 0..7.
constexpr std::string_view wind_name(int direction)
{
    constexpr std::array<std::string_view, 8> kNames{"N", "NE", "E", "SE", "S", "SW", "W", "NW"};
    return kNames[static_cast<std::size_t>(direction)];
}

/// Where the weather was observed; needed for the sun's path.
struct Site {
    double latitude = 0, longitude = 0;  ///< [rad], north and east positive
};

struct Weather {
    std::vector<WeatherDay> days;  ///< without gaps, in order
    std::optional<Site> site;      ///< where the file says so
    std::vector<std::string>
        notes;  ///< what was derived or filled in, and by which method; for summaries
    std::optional<Site> stated{};  ///< what the file says where another site replaced it
};

/// What to do when a day is missing.
enum class WeatherFill { Error, Interpolate };
constexpr std::array<std::string_view, 2> choice_names(WeatherFill)
{
    return {"error", "interpolate"};
}

/// Reads JMA daily CSV (Shift_JIS or UTF-8), EPW (hourly, averaged), own CSV with units in the
/// header, or own CSV of monthly normals, chosen by content; data/weather/README.md shows our own.
///
/// Missing humidity or sunshine is derived and noted. Every bad field is named with its line,
/// column, value and expectation, all at once. `fill` also says what happens on a day that is there
/// but lacks a value that cannot be derived; gaps of more than 30 days are never bridged.
/// @param site  replaces the file's, and is needed for the length of the day where the file has
/// none
/// @throws InvalidInput  the file; InvalidParameter  the site
Weather read_weather(const std::filesystem::path& path, const std::optional<Site>& site,
                     WeatherFill fill);

/// The same from bytes; `name` is used in messages.
Weather decode_weather(std::string_view bytes, const std::string& name,
                       const std::optional<Site>& site, WeatherFill fill);

/// Days `first` .. `first + count - 1`; repeats whole years when `repeat` and the series is
/// shorter. Days that repeat keep their dates, so that each exists in the calendar.
/// @throws InvalidParameter  too short: names both numbers and the option that repeats
Weather select_days(const Weather& weather, std::size_t first, std::size_t count, bool repeat);

}  // namespace sekitei
