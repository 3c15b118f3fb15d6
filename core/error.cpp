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
    if (count < 1e4) return fmt::format("{:.0f}", count);
    if (count < 1e6) return fmt::format("{:.3g} thousand", count / 1e3);
    if (count < 1e9) return fmt::format("{:.3g} million", count / 1e6);
    if (count < 1e15) return fmt::format("{:.3g} billion", count / 1e9);
    return fmt::format("{:.1e}", count);
}

}  // namespace sekitei
