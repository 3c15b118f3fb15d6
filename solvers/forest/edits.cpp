#include "solvers/forest/edits.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.h"

namespace sekitei::forest {
namespace {

/// The box around a region [m].
struct Box {
    double x0 = -std::numeric_limits<double>::infinity(), x1 = -x0, y0 = x0, y1 = x1;
};

Box box_of(const Region& region)
{
    switch (region.kind) {
        case Region::Kind::Disc:
            return {region.x - region.radius, region.x + region.radius, region.y - region.radius,
                    region.y + region.radius};
        case Region::Kind::Polygon: {
            Box box{1, 0, 1, 0};  // nothing
            for (std::size_t k = 0; k < region.corners.size(); ++k) {
                const auto [x, y] = region.corners[k];
                if (k == 0) box = {x, x, y, y};
                box = {std::min(box.x0, x), std::max(box.x1, x), std::min(box.y0, y),
                       std::max(box.y1, y)};
            }
            return box;
        }
        default:
            return {};
    }
}

/// Pixels [first, second) of `count` that [from, to] touches.
std::pair<int, int> pixels_of(double from, double to, double pixel, int count)
{
    const double n = count;
    return {static_cast<int>(std::clamp(std::floor(from / pixel), 0.0, n)),
            static_cast<int>(std::clamp(std::floor(to / pixel) + 1, 0.0, n))};
}

}  // namespace

bool Region::contains(double at_x, double at_y) const
{
    switch (kind) {
        case Kind::Everywhere:
            return true;
        case Kind::Disc: {
            const double dx = at_x - x, dy = at_y - y;
            return dx * dx + dy * dy <= radius * radius;
        }
        case Kind::Polygon: {
            bool inside = false;
            for (std::size_t k = 0, last = corners.size() - 1; k < corners.size(); last = k++) {
                const auto [ax, ay] = corners[k];
                const auto [bx, by] = corners[last];
                if ((ay > at_y) != (by > at_y) && at_x < (bx - ax) * (at_y - ay) / (by - ay) + ax)
                    inside = !inside;
            }
            return inside;
        }
        case Kind::Mask: {
            const double i = std::floor(at_x / pixel), j = std::floor(at_y / pixel);
            return i >= 0 && j >= 0 && i < mask.width() && j < mask.depth() &&
                   mask.at(static_cast<int>(i), static_cast<int>(j)) != 0;
        }
    }
    return false;
}

std::uint16_t density_value(double value)
{
    if (!(value >= 0 && value <= 1))
        throw InvalidInput(fmt::format("density = {}, must be 0 to 1", value));
    return static_cast<std::uint16_t>(std::floor(65535 * value + 0.5));
}

void apply(const Edit& edit, std::vector<DensityMap>& maps, double pixel)
{
    if (edit.kind == Edit::Kind::Fell || edit.kind == Edit::Kind::Plant) return;
    if (edit.map < 0 || std::size_t(edit.map) >= maps.size())
        throw InvalidInput(fmt::format("edit of step {}: map = {}, must be 1 to {}", edit.step,
                                       edit.map + 1, maps.size()));
    DensityMap& map = maps[std::size_t(edit.map)];
    const bool image = edit.kind == Edit::Kind::Image, set = edit.kind == Edit::Kind::Set;
    if (image && (edit.image.width() != map.width() || edit.image.depth() != map.depth()))
        throw InvalidInput(fmt::format(
            "edit of step {}: the image has {} x {} pixels, map {} has {} x {}", edit.step,
            edit.image.width(), edit.image.depth(), edit.map + 1, map.width(), map.depth()));
    if (!image && !set && !(edit.value >= 0 && std::isfinite(edit.value)))
        throw InvalidInput(
            fmt::format("edit of step {}: multiply = {}, must be >= 0", edit.step, edit.value));
    const std::uint16_t value = set ? density_value(edit.value) : std::uint16_t(0);
    auto product = [&](std::uint16_t v) {
        return static_cast<std::uint16_t>(
            std::min(65535.0, std::floor(double(v) * edit.value + 0.5)));
    };

    // Whole maps keep their blocks of one value.
    if (edit.region.kind == Region::Kind::Everywhere) {
        if (image)
            map = edit.image;
        else if (set)
            map = {map.width(), map.depth(), value};
        else
            map.transform(product);
        return;
    }
    const Box box = box_of(edit.region);
    const auto [i0, i1] = pixels_of(box.x0, box.x1, pixel, map.width());
    const auto [j0, j1] = pixels_of(box.y0, box.y1, pixel, map.depth());
    for (int j = j0; j < j1; ++j)
        for (int i = i0; i < i1; ++i) {
            if (!edit.region.contains((i + 0.5) * pixel, (j + 0.5) * pixel)) continue;
            map.set(i, j, image ? edit.image.at(i, j) : set ? value : product(map.at(i, j)));
        }
    map.compress();
}

}  // namespace sekitei::forest
