#include "apps/weather_choice.h"

#include <fmt/format.h>

#include "core/error.h"
#include "core/math.h"
#include "core/solar_day.h"

namespace sekitei::apps {

Weather chosen_weather(const WeatherChoice& choice, std::optional<std::int64_t> days, bool repeat,
                       const std::string& who, const std::filesystem::path& folder)
{
    std::optional<Site> site;
    if (choice.latitude) site = Site{*choice.latitude * math::kPi / 180, 0};
    const std::filesystem::path file =
        choice.weather.is_absolute() ? choice.weather : folder / choice.weather;
    Weather weather = read_weather(file, site, choice.fill);
    if (weather.site && choice.longitude)
        weather.site->longitude = *choice.longitude * math::kPi / 180;
    else if (weather.site && weather.stated)
        weather.site->longitude = weather.stated->longitude;
    if (!weather.site)
        throw InvalidParameter(
            fmt::format("{}: latitude: {} does not say where it was measured; give --latitude", who,
                        file.string()));
    const auto first = static_cast<std::size_t>(choice.first_day);
    if (first >= weather.days.size())
        throw InvalidParameter(fmt::format("{}: first_day = {}, but {} has {} days", who, first,
                                           file.string(), weather.days.size()));
    return select_days(weather, first,
                       days ? static_cast<std::size_t>(*days) : weather.days.size() - first,
                       repeat);
}

Weather steady_weather(const SteadyWeather& steady, std::size_t days)
{
    Weather weather;
    weather.site = Site{};
    weather.days.resize(days);
    const long first = day_number(2001, 1, 1);
    for (std::size_t d = 0; d < days; ++d) {
        const Date date = date_of(first + static_cast<long>(d));
        const auto rains = [&](std::size_t k) {
            return static_cast<std::size_t>(steady.rain_days) * k / 365;
        };
        WeatherDay& day = weather.days[d];
        day.year = date.year, day.month = date.month, day.day = date.day;
        day.temperature = steady.air_temperature;
        day.humidity = steady.air_humidity;
        day.precipitation = rains(d + 1) > rains(d) ? steady.rainfall / steady.rain_days : 0;
        day.wind_speed = steady.wind_speed;
        day.possible_sunshine = steady.possible_sunshine;
        day.sunshine = steady.sunshine;
    }
    return weather;
}

}  // namespace sekitei::apps
