#include "grids/polyline.h"

#include <fmt/format.h>

#include <cmath>

#include "core/error.h"

namespace sekitei {
namespace {

template <class T>
const std::vector<T>& attribute(const Points& points, const std::string& name)
{
    const auto found = points.attributes.find(name);
    if (found == points.attributes.end())
        throw InvalidInput(fmt::format(
            "centre lines: no attribute `{}`; expected points written by `sekitei joint`", name));
    const auto* values = std::get_if<std::vector<T>>(&found->second);
    if (!values)
        throw InvalidInput(
            fmt::format("centre lines: attribute `{}` has another type than int32; "
                        "expected points written by `sekitei joint`",
                        name));
    if (values->size() != points.position.size())
        throw InvalidInput(
            fmt::format("centre lines: attribute `{}` has {} values for {} points; must be as many",
                        name, values->size(), points.position.size()));
    return *values;
}

}  // namespace

Vec3d on_line_lattice(Vec3d p)
{
    auto snap = [](double x) { return std::floor(x * 0x1p20 + 0.5) * 0x1p-20; };
    return {snap(p.x), snap(p.y), snap(p.z)};
}

std::vector<double> Polylines::arc_lengths() const
{
    std::vector<double> arc(points.size(), 0.0);
    for (std::size_t i = 0; i < count(); ++i)
        for (std::size_t k = begin[i] + 1; k < begin[i + 1]; ++k)
            arc[k] = arc[k - 1] + length(points[k] - points[k - 1]);
    return arc;
}

Points to_points(const Polylines& lines, const Transform& transform)
{
    const std::size_t n = lines.points.size();
    Points out;
    out.position.reserve(n);
    std::vector<std::int32_t> line, order, stop;
    std::vector<float> arc;
    line.reserve(n);
    order.reserve(n);
    stop.reserve(n);
    arc.reserve(n);
    const std::vector<double> arcs = lines.arc_lengths();
    for (std::size_t i = 0; i < lines.count(); ++i) {
        for (std::size_t k = lines.begin[i]; k < lines.begin[i + 1]; ++k) {
            out.position.push_back(transform.world(lines.points[k]));
            line.push_back(static_cast<std::int32_t>(i));
            order.push_back(static_cast<std::int32_t>(k - lines.begin[i]));
            stop.push_back(static_cast<std::int32_t>(lines.stop[i]));
            arc.push_back(static_cast<float>(arcs[k] * transform.voxel));
        }
    }
    out.attributes.emplace("line", std::move(line));
    out.attributes.emplace("order", std::move(order));
    out.attributes.emplace("stop", std::move(stop));
    out.attributes.emplace("arc", std::move(arc));
    out.stage = "joint";
    return out;
}

Polylines to_polylines(const Points& points, const Transform& transform)
{
    const auto& line = attribute<std::int32_t>(points, "line");
    const auto& order = attribute<std::int32_t>(points, "order");
    const auto& stop = attribute<std::int32_t>(points, "stop");
    constexpr auto kReasons = static_cast<std::int32_t>(choice_names(StopReason{}).size());

    Polylines out;
    std::vector<Vec3d> current;
    for (std::size_t k = 0; k < points.position.size(); ++k) {
        const auto next = static_cast<std::int32_t>(out.count());
        const bool starts = current.empty();
        if (line[k] != next || order[k] != static_cast<std::int32_t>(current.size()))
            throw InvalidInput(
                fmt::format("centre lines: point {} is point {} of line {}, must be point {} of "
                            "line {}{}; keep "
                            "the points in the order in which `sekitei joint` wrote them",
                            k, order[k], line[k], current.size(), next,
                            starts ? "" : " (or the first of the next line)"));
        if (stop[k] < 0 || stop[k] >= kReasons)
            throw InvalidInput(fmt::format("centre lines: stop = {} at point {}, must be 0 to {}",
                                           stop[k], k, kReasons - 1));
        const Vec3d p = transform.voxels(points.position[k]);
        if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z))
            throw InvalidInput(fmt::format("centre lines: point {} is not finite", k));
        current.push_back(on_line_lattice(p));
        if (k + 1 == points.position.size() || order[k + 1] == 0) {
            out.add(current, static_cast<StopReason>(stop[k]));
            current.clear();
        }
    }
    return out;
}

}  // namespace sekitei
