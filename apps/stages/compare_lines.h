#pragma once

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "grids/scene.h"

namespace sekitei::apps {

/// One line of a comparison. Without bounds it informs only.
struct Line {
    std::string measure, scene;
    double value = 0, first = 0;
    bool ratio = true;  ///< bounds are of value / first, else of value
    double lower = -std::numeric_limits<double>::infinity(),
           upper = std::numeric_limits<double>::infinity();
    bool strictly = false;  ///< the bounds themselves are out

    double compared() const { return ratio ? value / first : value; }
    bool bounded() const { return std::isfinite(lower) || std::isfinite(upper); }
    bool holds() const
    {
        return strictly ? compared() > lower && compared() < upper
                        : compared() >= lower && compared() <= upper;
    }
    std::string expected() const
    {
        if (!bounded()) return "";
        if (!std::isfinite(upper)) return fmt::format("{} {:g}", strictly ? ">" : ">=", lower);
        if (!std::isfinite(lower)) return fmt::format("{} {:g}", strictly ? "<" : "<=", upper);
        if (lower == upper) return fmt::format("{:g}", lower);
        return fmt::format("{:g} to {:g}", lower, upper);
    }
};

/// What the figures of [Kanamaru1992] show of trees; scenes are known by their names: a, b, c ...
/// or fig10a, fig10b ...; kept, removed ...
/// @param figure  5, 6, 10 to 14, 16; 1: pollards
/// @throws InvalidParameter  no criterion for this figure; InvalidInput  a scene is missing
std::vector<Line> tree_lines(int figure, const std::vector<std::pair<std::string, Scene>>& scenes);
/// Figures that have criteria: "1, 5, 6 ..."
std::string tree_figures();
bool is_tree_figure(int figure);

}  // namespace sekitei::apps
