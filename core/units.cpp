#include "core/units.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <vector>

#include "core/error.h"
#include "core/math.h"

namespace sekitei {
namespace {

struct Unit {
    std::string_view dimension, name;
    double factor, offset = 0;  ///< SI = number * factor + offset
};

constexpr double kDegree = math::kPi / 180;

constexpr Unit kUnits[] = {
    {"m", "um", 1e-6},
    {"m", "mm", 1e-3},
    {"m", "cm", 1e-2},
    {"m", "m", 1},
    {"m", "km", 1e3},
    {"m", "in", 0.0254},
    {"m", "ft", 0.3048},
    {"s", "ms", 1e-3},
    {"s", "s", 1},
    {"s", "min", 60},
    {"s", "h", 3600},
    {"s", "d", 86400},
    {"s", "y", 31557600},
    {"K", "K", 1},
    {"K", "C", 1, 273.15},
    {"rad", "rad", 1},
    {"rad", "deg", kDegree},
    {"m/s", "m/s", 1},
    {"m/s", "km/h", 1 / 3.6},
    {"m/s", "mm/h", 1e-3 / 3600},
    {"", "%", 0.01},
    {"W/m^2", "W/m^2", 1},
    {"W/m^2", "kW/m^2", 1e3},
    {"m^2/s", "m^2/s", 1},
    {"m^2/s", "mm^2/s", 1e-6},
    {"deg", "deg", 1},
    {"deg", "rad", 1 / kDegree},
    {"voxels", "voxels", 1},
    {"cells", "cells", 1},
    {"pixels", "px", 1},
    {"kg/m^3", "kg/m^3", 1},
};

std::string_view trimmed(std::string_view text)
{
    while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
    while (!text.empty() && (text.back() == ' ' || text.back() == '\t')) text.remove_suffix(1);
    return text;
}

/// Splits "2.5 cm" into 2.5 and "cm".
double leading_number(std::string_view text, std::string_view& rest)
{
    std::string_view body = trimmed(text);
    if (body.size() > 1 && body[0] == '+' && body[1] != '-') body.remove_prefix(1);
    double value = 0;
    const auto [end, error] = std::from_chars(body.data(), body.data() + body.size(), value);
    if (error != std::errc{} || !std::isfinite(value))
        throw InvalidParameter(fmt::format("'{}' is not a number", text));
    rest = trimmed(body.substr(static_cast<std::size_t>(end - body.data())));
    return value;
}

}  // namespace

double parse_quantity(std::string_view text, std::string_view unit)
{
    std::string_view suffix;
    double value = leading_number(text, suffix);
    if (suffix.empty() || suffix == unit) return value;
    for (const Unit& u : kUnits)
        if (u.name == suffix && u.dimension == unit) {
            value = value * u.factor + u.offset;
            if (!std::isfinite(value))
                throw InvalidParameter(fmt::format("'{}' is too large", text));
            return value;
        }
    throw InvalidParameter(
        fmt::format("'{}' has the unit '{}', expected {}", text, suffix,
                    unit.empty() ? "a plain number or %" : "one of: " + accepted_units(unit)));
}

double parse_count(std::string_view text)
{
    std::string_view suffix;
    const double value = leading_number(text, suffix);
    const double factor = suffix == "k" || suffix == "K" ? 1e3
                          : suffix == "M"                ? 1e6
                          : suffix == "G"                ? 1e9
                                                         : 0;
    if (factor == 0) return parse_quantity(text, "");
    // 2.3 * 1e6 is not quite a whole number, 2.3M is.
    const double count = value * factor, whole = std::round(count);
    if (!std::isfinite(count)) throw InvalidParameter(fmt::format("'{}' is too large", text));
    return std::abs(count - whole) <= 1e-12 * std::abs(whole) ? whole : count;
}

std::string quantity_text(double value, std::string_view unit)
{
    return unit.empty() ? fmt::format("{}", value) : fmt::format("{} {}", value, unit);
}

std::string accepted_units(std::string_view unit)
{
    std::string list;
    for (const Unit& u : kUnits)
        if (u.dimension == unit) list += (list.empty() ? "" : " ") + std::string(u.name);
    return list.empty() ? std::string(unit) : list;
}

double parse_bytes(std::string_view text)
{
    std::string_view suffix;
    const double value = leading_number(text, suffix);
    static constexpr struct {
        std::string_view name;
        double factor;
    } kSizes[] = {{"", 1},         {"B", 1},        {"k", 1e3},      {"kB", 1e3},
                  {"K", 1e3},      {"KB", 1e3},     {"M", 1e6},      {"MB", 1e6},
                  {"G", 1e9},      {"GB", 1e9},     {"T", 1e12},     {"TB", 1e12},
                  {"KiB", 0x1p10}, {"MiB", 0x1p20}, {"GiB", 0x1p30}, {"TiB", 0x1p40}};
    for (const auto& size : kSizes)
        if (size.name == suffix && value > 0 && std::isfinite(value * size.factor))
            return value * size.factor;
    throw InvalidParameter(fmt::format("'{}' is not a size; write 8G, 500MB or 2GiB", text));
}

}  // namespace sekitei
