#include "core/error.h"

#include <fmt/format.h>

namespace sekitei {

std::string bytes_text(double bytes)
{
    static constexpr const char* kUnits[] = {"B", "kB", "MB", "GB", "TB", "PB", "EB"};
    int unit = 0;
    while (bytes >= 999.5 && unit < 6) {
        bytes /= 1000;
        ++unit;
    }
    return unit == 0 ? fmt::format("{:.0f} B", bytes)
                     : fmt::format("{:.3g} {}", bytes, kUnits[unit]);
}

std::string count_text(double count)
{
    if (count < 9999.5) return fmt::format("{:.0f}", count);
    static constexpr const char* kWords[] = {"thousand", "million", "billion", "trillion"};
    for (const char* word : kWords) {
        count /= 1000;
        if (count < 999.5) return fmt::format("{:.3g} {}", count, word);
    }
    return fmt::format("{:.1e}", count * 1e12);
}

}  // namespace sekitei
