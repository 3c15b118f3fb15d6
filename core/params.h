#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/vec.h"

/// Parameters described once.
///
/// A solver's Params has a static `describe(auto&& field)` that names every member once. Option,
/// recipe key, validation, --help, reference page, schema and hash all follow from it:
///
///     static void describe(auto&& field)
///     {
///         field("alpha", &Params::alpha, "", kPositive, "mesh Fourier number");
///         field("cut", &Params::cut, "how columns break");       // bool, enum, text, path
///     }
///
/// An enum taking part has `constexpr std::array<std::string_view, N> choice_names(E)` beside it,
/// one name per enumerator from 0. A std::optional member is `auto` when empty.
namespace sekitei {

using Json = nlohmann::json;

struct Range {
    double lower = -std::numeric_limits<double>::infinity();
    double upper = std::numeric_limits<double>::infinity();
    bool without_lower = false, without_upper = false;

    bool contains(double value) const;
    std::string text() const;  ///< "> 0", "0 to 1", "any number"
};

inline constexpr Range kAny{};
inline constexpr Range kPositive{.lower = 0, .without_lower = true};
inline constexpr Range kNotNegative{.lower = 0};
inline constexpr Range kFraction{.lower = 0, .upper = 1};
constexpr Range between(double lower, double upper)
{
    return {.lower = lower, .upper = upper};
}

/// One parameter, bound to a member of one Params object.
struct Param {
    enum class Kind { Number, Integer, Flag, Choice, Text, Path, Vector, List };

    std::string name, unit, help;
    Kind kind = Kind::Text;
    Range range;
    bool optional = false;             ///< accepts "auto"
    std::vector<std::string> choices;  ///< of a Choice

    /// The value in `unit`; null stands for auto.
    std::function<Json()> get;
    /// Takes numbers, quantities as text ("2cm"), true/false, names, arrays; checks type and range.
    /// @throws InvalidParameter  "alpha = -1, must be > 0"
    std::function<void(const Json&)> set;

    /// What a command line may contain after --name: "number [m], > 0".
    std::string type_text() const;
    /// The present value as text: "0.04 m", "auto", "chevron".
    std::string value_text() const;
    /// set() from a word of the command line; vectors and lists are separated by commas.
    void set_text(std::string_view text) const;
};

using ParamList = std::vector<Param>;

/// The spelling of a name on the command line.
std::string option_name(std::string_view name);  ///< seed_count -> seed-count

/// The parameter called `name` (either spelling), or null.
const Param* find_param(const ParamList& params, std::string_view name);

/// The known name nearest to a misspelt one by edit distance, or empty when none is near.
std::string nearest_name(std::string_view name, const std::vector<std::string>& known);

/// All values as one JSON object with keys in alphabetical order: what is hashed and stored.
Json params_json(const ParamList& params);

/// A JSON-schema fragment: properties with type, unit, range, default and description.
Json params_schema(const ParamList& params);

namespace detail {

template <class T>
concept Choice = std::is_enum_v<T>;

double number_from(const Param& param, const Json& value);
std::int64_t integer_from(const Param& param, const Json& value);
std::uint64_t unsigned_from(const Param& param, const Json& value);
[[noreturn]] void reject_width(const Param& param, const Json& value, double lower, double upper);
bool flag_from(const Param& param, const Json& value);
int choice_from(const Param& param, const Json& value);
std::string text_from(const Param& param, const Json& value);
Vec3d vector_from(const Param& param, const Json& value);
std::vector<double> list_from(const Param& param, const Json& value);
bool is_auto(const Json& value);
Json number_json(double value);

template <class T>
struct is_optional : std::false_type {
};
template <class T>
struct is_optional<std::optional<T>> : std::true_type {
    using inner = T;
};

template <class T>
void bind_kind(Param& p)
{
    if constexpr (std::is_same_v<T, bool>)
        p.kind = Param::Kind::Flag;
    else if constexpr (Choice<T>) {
        p.kind = Param::Kind::Choice;
        for (const std::string_view n : choice_names(T{})) p.choices.emplace_back(n);
    } else if constexpr (std::is_integral_v<T>)
        p.kind = Param::Kind::Integer;
    else if constexpr (std::is_floating_point_v<T>)
        p.kind = Param::Kind::Number;
    else if constexpr (std::is_same_v<T, std::string>)
        p.kind = Param::Kind::Text;
    else if constexpr (std::is_same_v<T, std::filesystem::path>)
        p.kind = Param::Kind::Path;
    else if constexpr (std::is_same_v<T, Vec3d>)
        p.kind = Param::Kind::Vector;
    else {
        static_assert(std::is_same_v<T, std::vector<double>>, "a type no recipe can hold");
        p.kind = Param::Kind::List;
    }
}

template <class T>
Json to_json(const T& v)
{
    if constexpr (Choice<T>)
        return Json(std::string(choice_names(T{})[static_cast<std::size_t>(v)]));
    else if constexpr (std::is_floating_point_v<T>)
        return number_json(v);
    else if constexpr (std::is_same_v<T, std::filesystem::path>)
        return Json(v.string());
    else if constexpr (std::is_same_v<T, Vec3d>)
        return Json::array({v.x, v.y, v.z});
    else
        return Json(v);
}

template <class T>
T from_json(const Param& p, const Json& v)
{
    if constexpr (std::is_same_v<T, bool>)
        return flag_from(p, v);
    else if constexpr (Choice<T>)
        return static_cast<T>(choice_from(p, v));
    else if constexpr (std::is_same_v<T, std::uint64_t>)
        return unsigned_from(p, v);
    else if constexpr (std::is_integral_v<T>) {
        const std::int64_t number = integer_from(p, v);
        if (!std::in_range<T>(number))
            reject_width(p, v, static_cast<double>(std::numeric_limits<T>::min()),
                         static_cast<double>(std::numeric_limits<T>::max()));
        return static_cast<T>(number);
    } else if constexpr (std::is_floating_point_v<T>)
        return static_cast<T>(number_from(p, v));
    else if constexpr (std::is_same_v<T, Vec3d>)
        return vector_from(p, v);
    else if constexpr (std::is_same_v<T, std::vector<double>>)
        return list_from(p, v);
    else
        return T(text_from(p, v));
}

}  // namespace detail

/// Every parameter of `target`, bound to it; `target` must outlive the list.
template <class P>
ParamList describe_params(P& target)
{
    ParamList list;
    auto add = [&]<class T>(std::string_view name, T P::*member, std::string_view unit, Range range,
                            std::string_view help) {
        Param p;
        p.name = name;
        p.unit = unit;
        p.help = help;
        p.range = range;
        if constexpr (detail::is_optional<T>::value) {
            detail::bind_kind<typename detail::is_optional<T>::inner>(p);
            p.optional = true;
            p.get = [&target, member] {
                const T& v = target.*member;
                return v ? detail::to_json(*v) : Json(nullptr);
            };
        } else {
            detail::bind_kind<T>(p);
            p.get = [&target, member] { return detail::to_json(target.*member); };
        }
        // The setter keeps a copy of the description for its messages.
        Param description = p;
        description.get = nullptr;
        p.set = [&target, member, description](const Json& v) {
            if constexpr (detail::is_optional<T>::value) {
                if (detail::is_auto(v))
                    target.*member = std::nullopt;
                else
                    target.*member =
                        detail::from_json<typename detail::is_optional<T>::inner>(description, v);
            } else
                target.*member = detail::from_json<T>(description, v);
        };
        list.push_back(std::move(p));
    };
    P::describe([&](auto... args) {
        if constexpr (sizeof...(args) == 5)
            add(args...);
        else {
            [&](auto name, auto member, auto help) {
                add(name, member, "", Range{}, help);
            }(args...);
        }
    });
    return list;
}

/// Checks every member against its described range.
/// @throws InvalidParameter  "cooling: alpha = -1, must be > 0"
void validate_params(std::string_view solver, const ParamList& params);

template <class P>
void validate_described(std::string_view solver, const P& params)
{
    P copy = params;
    validate_params(solver, describe_params(copy));
}

}  // namespace sekitei
