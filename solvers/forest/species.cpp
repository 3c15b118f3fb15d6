#include "solvers/forest/species.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/error.h"
#include "core/math.h"

namespace sekitei::forest {
namespace {

bool is_colour(std::string_view text)
{
    auto hexadecimal = [](char c) {
        return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f') || (c >= 'A' && c <= 'F');
    };
    return text.size() == 7 && text[0] == '#' &&
           std::all_of(text.begin() + 1, text.end(), hexadecimal);
}

void validate(const Limits& limits, const std::string& who)
{
    if (limits.factor.empty()) throw InvalidParameter(who + ": limits: a factor has no name");
    const std::array<std::pair<const char*, double>, 6> order{
        {{"dies_below", limits.dies_below},
         {"stands_below", limits.stands_below},
         {"best_from", limits.best_from},
         {"best_to", limits.best_to},
         {"stands_above", limits.stands_above},
         {"dies_above", limits.dies_above}}};
    for (std::size_t k = 0; k < order.size(); ++k) {
        if (!std::isfinite(order[k].second))
            throw InvalidParameter(fmt::format("{}: limits.{}: {} = {}, must be a finite number",
                                               who, limits.factor, order[k].first,
                                               order[k].second));
        if (k > 0 && order[k].second < order[k - 1].second)
            throw InvalidParameter(
                fmt::format("{}: limits.{}: {} = {}, must be >= {} = {}; the six limits ascend",
                            who, limits.factor, order[k].first, order[k].second, order[k - 1].first,
                            order[k - 1].second));
    }
}

}  // namespace

const std::vector<Species>& table_species()
{
    // Heights, spreads, growth and colours are the paper's; it draws the fourth green like the
    // first, which no map could tell apart. Leaves, crowns and kinds of trees are ours.
    static const std::vector<Species> table{{.name = "tall",
                                             .max_height = 20,
                                             .spread = 1.0,
                                             .growth = 3,
                                             .leaf_area_index = 4,
                                             .crown_base = 0.5,
                                             .tree = "beech",
                                             .colour = "#008000"},
                                            {.name = "tall_2",
                                             .max_height = 18,
                                             .spread = 1.0,
                                             .growth = 3,
                                             .leaf_area_index = 4,
                                             .crown_base = 0.5,
                                             .tree = "pine",
                                             .colour = "#0000FF"},
                                            {.name = "sub_tall",
                                             .max_height = 12,
                                             .spread = 1.0,
                                             .growth = 1.5,
                                             .leaf_area_index = 4,
                                             .crown_base = 0.4,
                                             .tree = "zelkova",
                                             .colour = "#FF0000"},
                                            {.name = "low",
                                             .max_height = 5,
                                             .spread = 1.5,
                                             .growth = 1.5,
                                             .leaf_area_index = 3,
                                             .crown_base = 0.3,
                                             .tree = "cherry",
                                             .colour = "#9ACD32"},
                                            {.name = "shrub",
                                             .max_height = 2,
                                             .spread = 1.5,
                                             .growth = 0.5,
                                             .leaf_area_index = 2,
                                             .crown_base = 0.1,
                                             .tree = "azalea",
                                             .colour = "#800080"},
                                            {.name = "shrub_2",
                                             .max_height = 2,
                                             .spread = 1.5,
                                             .growth = 0.5,
                                             .leaf_area_index = 2,
                                             .crown_base = 0.1,
                                             .tree = "azalea",
                                             .colour = "#8B4513"}};
    return table;
}

double slope_of(const Species& species, SpreadMode mode)
{
    auto tangent = [](double angle) { return math::sin(angle) / math::cos(angle); };
    switch (mode) {
        case SpreadMode::ApexAngle:
            return tangent(species.spread / 2);
        case SpreadMode::DiameterRatio:
            return species.spread / 2;
        case SpreadMode::RadiusRatio:
            return species.spread;
        case SpreadMode::HalfAngle:
            return tangent(species.spread);
    }
    return 0;
}

void validate(const Species& species, SpreadMode mode)
{
    const std::string who = fmt::format("species '{}'", species.name);
    if (species.name.empty()) throw InvalidParameter("species: name is empty, must be a word");
    validate_described(who, species);
    const bool apex = mode == SpreadMode::ApexAngle, half = mode == SpreadMode::HalfAngle;
    if ((apex && species.spread >= math::kPi) || (half && species.spread >= math::kPi / 2))
        throw InvalidParameter(fmt::format(
            "{}: spread = {}, must be > 0 and < {} with spread_mode = {}", who, species.spread,
            apex ? "pi (3.14159)" : "pi / 2 (1.5708)", choice_names(mode)[std::size_t(mode)]));
    if (!is_colour(species.colour))
        throw InvalidParameter(
            fmt::format("{}: colour = {}, must be #RRGGBB", who, species.colour));
    for (auto limits = species.limits.begin(); limits != species.limits.end(); ++limits) {
        validate(*limits, who);
        if (std::any_of(species.limits.begin(), limits,
                        [&](const Limits& other) { return other.factor == limits->factor; }))
            throw InvalidParameter(fmt::format("{}: limits.{}: given twice", who, limits->factor));
    }
}

}  // namespace sekitei::forest
