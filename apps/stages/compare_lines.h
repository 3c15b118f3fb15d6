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

/// Lines as they are found.
class LineList {
public:
    std::vector<Line> list;

    void bound(const std::string& measure, const std::string& scene, double value, double lower,
               double upper)
    {
        list.push_back({measure, scene, value, 0, false, lower, upper});
    }
    void info(const std::string& measure, const std::string& scene, double value)
    {
        list.push_back({measure, scene, value, 0, false});
    }
    void ratio(const std::string& measure, const std::string& scene, double value, double first,
               double lower, double upper)
    {
        list.push_back({measure, scene, value, first, true, lower, upper});
    }
    /// A value above (sign 1) or below (-1) the one before.
    void after(const std::string& measure, const std::string& scene, double value, double before,
               int sign)
    {
        const double any = std::numeric_limits<double>::infinity();
        list.push_back({measure + (sign > 0 ? ", rising" : ", falling"), scene, value, 0, false,
                        sign > 0 ? before : -any, sign > 0 ? any : before, true});
    }
};

/// What a scene is called among those of a figure: "fig10a" and "a" are both a.
inline std::string scene_key(const std::string& name)
{
    if (!name.starts_with("fig")) return name;
    const std::size_t end = name.find_first_not_of("0123456789", 3);
    if (end == std::string::npos) return name;
    return name.substr(name[end] == '_' || name[end] == '-' ? end + 1 : end);
}

/// What the figures of [Kanamaru1992] show of trees; scenes are known by their names: a, b, c ...
/// or fig10a, fig10b ...; kept, removed ...
/// @param figure  5, 6, 10 to 14, 16; 1: pollards
/// @throws InvalidParameter  no criterion for this figure; InvalidInput  a scene is missing
std::vector<Line> tree_lines(int figure, const std::vector<std::pair<std::string, Scene>>& scenes);
/// Figures that have criteria: "1, 5, 6 ..."
std::string tree_figures();
bool is_tree_figure(int figure);

/// The same of forests [Mizoguchi2008]: 48 for figure 4.8 ...
/// @param figure  48, 49, 51, 52, 54 to 57
std::vector<Line> forest_lines(int figure,
                               const std::vector<std::pair<std::string, Scene>>& scenes);
std::string forest_figures();
bool is_forest_figure(int figure);

/// How parts of a garden act on one another: the first scene, which has everything, beside others
/// that lack leaves, the pond or the stones. Each gives the lines that its grids allow.
/// @throws InvalidInput  nothing can be compared
std::vector<Line> garden_lines(const std::vector<std::pair<std::string, Scene>>& scenes);

}  // namespace sekitei::apps
