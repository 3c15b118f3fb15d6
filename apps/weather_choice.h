#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "core/params.h"
#include "core/weather.h"

/// The weather that a user chose.
namespace sekitei::apps {

/// A file of weather, and the place where it happens.
struct WeatherChoice {
    std::filesystem::path weather;
    std::optional<double> latitude, longitude;
    std::int64_t first_day = 0;
    WeatherFill fill = WeatherFill::Error;

    static void describe(auto&& field)
    {
        field("weather", &WeatherChoice::weather,
              "weather: JMA daily CSV, EPW, monthly normals or own CSV with units in the header");
        field("latitude", &WeatherChoice::latitude, "deg", between(-90, 90),
              "north positive; auto: as the weather file says");
        field("longitude", &WeatherChoice::longitude, "deg", between(-180, 180),
              "east positive; auto: as the weather file says, else 0");
        field("first_day", &WeatherChoice::first_day, "", kNotNegative,
              "day of the weather to begin with, 0 being its first");
        field("fill", &WeatherChoice::fill, "days that are missing in the weather");
    }
};

/// Days of the file, with a site.
/// @param days    how many; none: to its end
/// @param repeat  begin anew where it is shorter
/// @param who     "light", for messages
/// @param folder  where a relative name starts
/// @throws InvalidInput, InvalidParameter
Weather chosen_weather(const WeatherChoice& choice, std::optional<std::int64_t> days, bool repeat,
                       const std::string& who, const std::filesystem::path& folder);

/// The same weather every day, with rain on some [Nomura2010, table 4.3].
struct SteadyWeather {
    double air_temperature = 288.15;
    double air_humidity = 0.73;
    double rainfall = 1861.2;
    int rain_days = 180;
    double wind_speed = 0.2;
    double possible_sunshine = 8, sunshine = 6;

    static void describe(auto&& field)
    {
        field("air_temperature", &SteadyWeather::air_temperature, "K", between(180, 340),
              "without weather: of every day");
        field("air_humidity", &SteadyWeather::air_humidity, "", kFraction,
              "without weather: of every day");
        field("rainfall", &SteadyWeather::rainfall, "mm", kNotNegative,
              "without weather: of a year");
        field("rain_days", &SteadyWeather::rain_days, "", between(1, 365),
              "without weather: of a year, evenly spread");
        field("wind_speed", &SteadyWeather::wind_speed, "m/s", kNotNegative,
              "without weather: of every day");
        field("possible_sunshine", &SteadyWeather::possible_sunshine, "h", between(0, 24),
              "without weather: N0, from sunrise to sunset");
        field("sunshine", &SteadyWeather::sunshine, "h", between(0, 24),
              "without weather: N of every day");
    }
};
/// Rain falls on day d of a year iff floor(rain_days d / 365) > floor(rain_days (d - 1) / 365).
Weather steady_weather(const SteadyWeather& steady, std::size_t days);

}  // namespace sekitei::apps
