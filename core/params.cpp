#include "core/params.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "core/error.h"
#include "core/units.h"

namespace sekitei {
namespace {

/// A JSON value as a user would write it, cut to a length that fits a message.
std::string shown(const Json& value)
{
    // Text that is no UTF-8 must not make dump() throw an error of its own.
    std::string text = value.is_string()
                           ? value.get<std::string>()
                           : value.dump(-1, ' ', false, Json::error_handler_t::replace);
    if (text.size() <= 60) return text;
    std::size_t end = 57;
    while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0) == 0x80) --end;
    return text.substr(0, end) + "...";
}

[[noreturn]] void reject(const Param& p, const Json& value, const std::string& expected)
{
    throw InvalidParameter(fmt::format("{} = {}, must be {}", p.name, shown(value), expected));
}

/// "1,2,3" as three texts; a comma at the end begins an empty one.
Json split_at_commas(std::string_view text)
{
    Json parts = Json::array();
    if (text.empty()) return parts;
    for (std::size_t begin = 0; begin <= text.size();) {
        const std::size_t end = std::min(text.find(',', begin), text.size());
        parts.push_back(std::string(text.substr(begin, end - begin)));
        begin = end + 1;
    }
    return parts;
}

double checked(const Param& p, double number)
{
    if (!p.range.contains(number))
        throw InvalidParameter(fmt::format("{} = {}, must be {}", p.name,
                                           quantity_text(number, p.unit), p.range.text()));
    return number;
}

}  // namespace

bool Range::contains(double value) const
{
    if (!std::isfinite(value)) return false;
    return (without_lower ? value > lower : value >= lower) &&
           (without_upper ? value < upper : value <= upper);
}

std::string Range::text() const
{
    const bool low = std::isfinite(lower), high = std::isfinite(upper);
    if (low && high && !without_lower && !without_upper)
        return fmt::format("{} to {}", lower, upper);
    if (low && high)
        return fmt::format("{} {} and {} {}", without_lower ? ">" : ">=", lower,
                           without_upper ? "<" : "<=", upper);
    if (low) return fmt::format("{} {}", without_lower ? ">" : ">=", lower);
    if (high) return fmt::format("{} {}", without_upper ? "<" : "<=", upper);
    return "a finite number";
}

std::string Param::type_text() const
{
    const std::string tail = unit.empty() ? "" : fmt::format(" [{}]", unit);
    const bool ranged = std::isfinite(range.lower) || std::isfinite(range.upper);
    const std::string bounds = ranged ? ", " + range.text() : "";
    const std::string or_auto = optional ? ", or auto" : "";
    switch (kind) {
        case Kind::Number:
            return "number" + tail + bounds + or_auto;
        case Kind::Integer:
            return "integer" + tail + bounds + or_auto;
        case Kind::Flag:
            return "true or false" + or_auto;
        case Kind::Choice:
            return fmt::format("{}{}", fmt::join(choices, " | "), or_auto);
        case Kind::Text:
            return "text" + or_auto;
        case Kind::Path:
            return "file" + or_auto;
        case Kind::Vector:
            return "x,y,z" + tail + bounds + or_auto;
        case Kind::List:
            return "numbers separated by commas" + tail + bounds;
    }
    return "";
}

std::string Param::value_text() const
{
    const Json value = get();
    if (value.is_null()) return "auto";
    if (value.is_string())
        return value.get<std::string>().empty() ? "none" : value.get<std::string>();
    if (value.is_array()) {
        std::vector<std::string> parts;
        for (const Json& v : value) parts.push_back(fmt::format("{}", v.get<double>()));
        return parts.empty()
                   ? "none"
                   : fmt::format("{}{}{}", fmt::join(parts, ","), unit.empty() ? "" : " ", unit);
    }
    if (value.is_number() && !unit.empty()) return quantity_text(value.get<double>(), unit);
    return value.is_number_float() ? fmt::format("{}", value.get<double>()) : value.dump();
}

void Param::set_text(std::string_view text) const
{
    if (kind == Kind::Vector || kind == Kind::List) {
        if (optional && text == "auto") return set(nullptr);
        return set(split_at_commas(kind == Kind::List && text == "none" ? "" : text));
    }
    set(Json(std::string(text)));
}

std::string option_name(std::string_view name)
{
    std::string option(name);
    std::replace(option.begin(), option.end(), '_', '-');
    return option;
}

const Param* find_param(const ParamList& params, std::string_view name)
{
    const auto found = std::find_if(params.begin(), params.end(), [&](const Param& p) {
        return p.name == name || option_name(p.name) == name;
    });
    return found == params.end() ? nullptr : &*found;
}

std::string nearest_name(std::string_view name, const std::vector<std::string>& known)
{
    auto distance = [](std::string_view a, std::string_view b) {
        std::vector<std::size_t> row(b.size() + 1);
        for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
        for (std::size_t i = 1; i <= a.size(); ++i) {
            std::size_t diagonal = row[0];
            row[0] = i;
            for (std::size_t j = 1; j <= b.size(); ++j) {
                const std::size_t replace = diagonal + (a[i - 1] != b[j - 1]);
                diagonal = row[j];
                row[j] = std::min({row[j] + 1, row[j - 1] + 1, replace});
            }
        }
        return row.back();
    };
    std::string best;
    std::size_t least = std::max<std::size_t>(2, name.size() / 2) + 1;
    for (const std::string& candidate : known) {
        const std::size_t longer = std::max(name.size(), candidate.size()),
                          shorter = std::min(name.size(), candidate.size());
        if (longer - shorter >= least) continue;
        const std::size_t d = distance(name, candidate);
        if (d < least) {
            least = d;
            best = candidate;
        }
    }
    return best;
}

Json params_json(const ParamList& params)
{
    Json object = Json::object();
    for (const Param& p : params) object[p.name] = p.get();
    return object;
}

Json params_schema(const ParamList& params)
{
    Json properties = Json::object();
    for (const Param& p : params) {
        Json entry = {{"description", p.help}, {"default", p.get()}};
        switch (p.kind) {
            case Param::Kind::Number:
                entry["type"] = {"number", "string"};
                break;
            case Param::Kind::Integer:
                entry["type"] = "integer";
                break;
            case Param::Kind::Flag:
                entry["type"] = "boolean";
                break;
            case Param::Kind::Choice:
                entry["enum"] = p.choices;
                break;
            case Param::Kind::Text:
                entry["type"] = "string";
                break;
            case Param::Kind::Path:
                entry["type"] = "string";
                entry["format"] = "path";
                break;
            case Param::Kind::Vector:
                entry["type"] = "array";
                entry["minItems"] = entry["maxItems"] = 3;
                break;
            case Param::Kind::List:
                entry["type"] = "array";
                break;
        }
        if (p.optional && p.kind == Param::Kind::Choice)
            entry["enum"].push_back("auto");
        else if (p.optional) {
            // "auto" and null stand for an empty value
            Json types = entry["type"].is_array() ? entry["type"] : Json::array({entry["type"]});
            for (const char* type : {"string", "null"})
                if (std::find(types.begin(), types.end(), Json(type)) == types.end())
                    types.push_back(type);
            entry["type"] = std::move(types);
        }
        if (!p.unit.empty()) entry["unit"] = p.unit;
        if (std::isfinite(p.range.lower))
            entry[p.range.without_lower ? "exclusiveMinimum" : "minimum"] = p.range.lower;
        if (std::isfinite(p.range.upper))
            entry[p.range.without_upper ? "exclusiveMaximum" : "maximum"] = p.range.upper;
        properties[p.name] = std::move(entry);
    }
    return properties;
}

void validate_params(std::string_view solver, const ParamList& params)
{
    for (const Param& p : params) {
        try {
            const Json value = p.get();
            // JSON has no NaN or infinity: they come back as text and must not pass as a name.
            if (value.is_string() &&
                (p.kind == Param::Kind::Number || p.kind == Param::Kind::Integer))
                throw InvalidParameter(fmt::format("{} = {}, must be {}", p.name,
                                                   value.get<std::string>(), p.range.text()));
            p.set(value);
        } catch (const InvalidParameter& error) {
            throw InvalidParameter(fmt::format("{}: {}", solver, error.what()));
        }
    }
}

namespace detail {

double number_from(const Param& p, const Json& value)
{
    if (value.is_number()) return checked(p, value.get<double>());
    if (!value.is_string()) reject(p, value, p.type_text());
    try {
        const auto& text = value.get_ref<const std::string&>();
        const bool count = p.kind == Param::Kind::Integer && p.unit.empty();
        return checked(p, count ? parse_count(text) : parse_quantity(text, p.unit));
    } catch (const InvalidParameter& error) {
        const std::string why = error.what();
        if (why.starts_with(p.name)) throw;
        throw InvalidParameter(fmt::format("{}: {}", p.name, why));
    }
}

std::int64_t integer_from(const Param& p, const Json& value)
{
    if (value.is_number_unsigned() && value.get<std::uint64_t>() > 0x7FFFFFFFFFFFFFFFu)
        reject(p, value, "an integer below 9.2e18");
    if (value.is_number_integer()) {
        checked(p, static_cast<double>(value.get<std::int64_t>()));
        return value.get<std::int64_t>();
    }
    // Digits alone are taken as they are: a double would lose those behind the sixteenth.
    if (value.is_string()) {
        const auto& text = value.get_ref<const std::string&>();
        std::int64_t exact = 0;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), exact);
        if (error == std::errc{} && end == text.data() + text.size())
            return integer_from(p, Json(exact));
    }
    const double number = number_from(p, value);
    if (number != std::floor(number)) reject(p, value, p.type_text());
    if (std::abs(number) > 9e15) reject(p, value, "an integer below 9e15");
    return static_cast<std::int64_t>(number);
}

std::uint64_t unsigned_from(const Param& p, const Json& value)
{
    std::uint64_t large = 0;
    bool exact = value.is_number_unsigned();
    if (exact)
        large = value.get<std::uint64_t>();
    else if (value.is_string()) {
        const auto& text = value.get_ref<const std::string&>();
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), large);
        exact = error == std::errc{} && end == text.data() + text.size();
    }
    if (exact) {
        checked(p, static_cast<double>(large));
        return large;
    }
    const std::int64_t number = integer_from(p, value);
    if (number < 0) reject_width(p, value, 0, 0x1p64);
    return static_cast<std::uint64_t>(number);
}

void reject_width(const Param& p, const Json& value, double lower, double upper)
{
    reject(p, value, fmt::format("an integer from {} to {}", lower, upper));
}

bool flag_from(const Param& p, const Json& value)
{
    if (value.is_boolean()) return value.get<bool>();
    if (value.is_string()) {
        const auto& text = value.get_ref<const std::string&>();
        if (text == "true" || text == "on" || text == "yes" || text == "1") return true;
        if (text == "false" || text == "off" || text == "no" || text == "0") return false;
    }
    reject(p, value, "true or false");
}

int choice_from(const Param& p, const Json& value)
{
    if (value.is_string()) {
        const auto& text = value.get_ref<const std::string&>();
        const auto found = std::find(p.choices.begin(), p.choices.end(), text);
        if (found != p.choices.end()) return static_cast<int>(found - p.choices.begin());
        const std::string near = nearest_name(text, p.choices);
        reject(p, value,
               fmt::format("one of: {}{}", fmt::join(p.choices, ", "),
                           near.empty() ? "" : fmt::format(" (did you mean '{}'?)", near)));
    }
    reject(p, value, fmt::format("one of: {}", fmt::join(p.choices, ", ")));
}

std::string text_from(const Param& p, const Json& value)
{
    if (!value.is_string()) reject(p, value, p.type_text());
    return value.get<std::string>();
}

Vec3d vector_from(const Param& p, const Json& value)
{
    if (value.is_string()) {
        const Json parts = split_at_commas(value.get_ref<const std::string&>());
        if (parts.size() != 3) reject(p, value, "three numbers x,y,z");
        return vector_from(p, parts);
    }
    if (!value.is_array() || value.size() != 3) reject(p, value, "three numbers x,y,z");
    return {number_from(p, value[0]), number_from(p, value[1]), number_from(p, value[2])};
}

std::vector<double> list_from(const Param& p, const Json& value)
{
    if (value.is_number() || value.is_string()) return {number_from(p, value)};
    if (!value.is_array()) reject(p, value, p.type_text());
    std::vector<double> list;
    for (const Json& v : value) list.push_back(number_from(p, v));
    return list;
}

bool is_auto(const Json& value)
{
    return value.is_null() || (value.is_string() && value.get_ref<const std::string&>() == "auto");
}

Json number_json(double value)
{
    if (std::isnan(value)) return "nan";
    if (std::isinf(value)) return value > 0 ? "infinity" : "-infinity";
    return value;
}

}  // namespace detail
}  // namespace sekitei
