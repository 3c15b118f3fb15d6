#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "core/error.h"
#include "core/weather.h"

/// Any bytes are days that solvers may use, or InvalidInput.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
    using namespace sekitei;
    const std::string_view bytes(reinterpret_cast<const char*>(data), size);
    try {
        const Weather weather =
            decode_weather(bytes, "w.csv", Site{0.7, 2.4}, WeatherFill::Interpolate);
        for (const WeatherDay& d : weather.days) {
            const bool good = d.temperature >= 180 && d.temperature <= 340 && d.humidity >= 0 &&
                              d.humidity <= 1 && d.precipitation >= 0 && d.wind_speed >= 0 &&
                              d.wind_direction >= 0 && d.wind_direction < 8 && d.sunshine >= 0 &&
                              d.sunshine <= d.possible_sunshine && d.pressure >= 300;
            if (!good) std::abort();
        }
    } catch (const InvalidInput&) {
    }
    return 0;
}
