#include "apps/render/slice.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/render/colour.h"
#include "apps/render/text.h"
#include "core/error.h"

namespace sekitei::render {
namespace {

constexpr Rgb kInk{40, 40, 40};
constexpr const char* kAxes[3] = {"x", "y", "z"};

/// Voxels a picture shows: the scene's box if the grid lies in it, else what the leaves cover.
template <class T>
void extent(const LeafGrid<T>& grid, const Domain& domain, Coord& lower, Coord& upper)
{
    if (domain.dims.x > 0 && domain.transform == grid.transform()) {
        lower = {};
        upper = domain.dims;
        return;
    }
    lower = Coord(std::numeric_limits<std::int32_t>::max());
    upper = Coord(std::numeric_limits<std::int32_t>::min());
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf) {
        const Coord origin = grid.origin(leaf);
        grid.mask(leaf).for_each([&](int offset) {
            const Coord c = leaf_coord(origin, offset);
            lower = min(lower, c);
            upper = max(upper, c + Coord(1));
        });
    }
}

/// One plane's voxels, rows from the bottom.
template <class T>
struct Plane {
    std::vector<T> values;
    std::vector<char> active;
};

Rgb bytes(Vec3f c)
{
    return {srgb_byte(static_cast<double>(c.x)), srgb_byte(static_cast<double>(c.y)),
            srgb_byte(static_cast<double>(c.z))};
}

void draw_line(Image8& image, int x0, int y0, int x1, int y1)
{
    for (int y = std::max(0, y0); y <= std::min(image.height - 1, y1); ++y)
        for (int x = std::max(0, x0); x <= std::min(image.width - 1, x1); ++x)
            for (int c = 0; c < 3; ++c) image.at(x, y, c) = kInk[c];
}

template <class T>
SlicePlot draw(const LeafGrid<T>& grid, const Grid& meta, const Domain& domain,
               const SliceParams& params)
{
    const int axis = params.axis == "x" ? 0 : params.axis == "y" ? 1 : 2;
    const int across = axis == 0 ? 1 : 0, upward = axis == 2 ? 1 : 2;
    Coord lower, upper;
    extent(grid, domain, lower, upper);
    if (!(lower.x < upper.x))
        throw InvalidInput(
            fmt::format("slice: grid {} has no active voxels, nothing to show", params.grid));

    // The plane's voxels.
    const Transform& transform = grid.transform();
    const double h = transform.voxel, base = transform.origin[axis];
    const double first = base + h * lower[axis], last = base + h * upper[axis];
    const double position = params.at.value_or((first + last) / 2);
    if (!(position >= first && position <= last))
        throw InvalidParameter(
            fmt::format("slice: at = {:.6g} m, must be {:.6g} to {:.6g} along {}", position, first,
                        last, kAxes[axis]));
    SlicePlot plot;
    plot.plane = std::clamp(static_cast<int>(std::floor((position - base) / h)), lower[axis],
                            upper[axis] - 1);
    plot.columns = upper[across] - lower[across];
    plot.rows = upper[upward] - lower[upward];
    const auto columns = static_cast<std::size_t>(plot.columns);
    Plane<T> plane;
    plane.values.resize(columns * static_cast<std::size_t>(plot.rows));
    plane.active.resize(plane.values.size());
    GridReader<T> reader(grid);
    for (int j = 0; j < plot.rows; ++j)
        for (int i = 0; i < plot.columns; ++i) {
            Coord c;
            c[axis] = plot.plane;
            c[across] = lower[across] + i;
            c[upward] = lower[upward] + j;
            const std::size_t k =
                static_cast<std::size_t>(j) * columns + static_cast<std::size_t>(i);
            plane.values[k] = reader.value(c);
            plane.active[k] = reader.active(c);
        }

    // What the colours mean.
    double low = INFINITY, high = -INFINITY;
    std::vector<std::int32_t> names;
    if constexpr (std::is_same_v<T, float>) {
        for (std::size_t k = 0; k < plane.values.size(); ++k)
            if (plane.active[k] && std::isfinite(plane.values[k])) {
                low = std::min(low, static_cast<double>(plane.values[k]));
                high = std::max(high, static_cast<double>(plane.values[k]));
            }
        if (!(low <= high)) low = high = 0;
        low = params.low.value_or(low);
        high = params.high.value_or(high);
        if (low > high)
            throw InvalidParameter(
                fmt::format("slice: low = {:.6g}, must be below high = {:.6g}", low, high));
    } else if constexpr (std::is_same_v<T, std::int32_t>) {
        for (std::size_t k = 0; k < plane.values.size(); ++k)
            if (plane.active[k]) names.push_back(plane.values[k]);
        std::sort(names.begin(), names.end());
        names.erase(std::unique(names.begin(), names.end()), names.end());
    }

    // Lay out: title, plot with numbers at its left and foot, bar at its right.
    const int text = params.width >= 700 ? 2 : 1;
    const std::string unit = meta.unit.empty() ? "" : " [" + meta.unit + "]";
    const std::string title = fmt::format("{}{}   {} = {:.6g} m", params.grid, unit, kAxes[axis],
                                          base + h * (plot.plane + 0.5));
    auto end = [&](int a, bool top) {
        return transform.origin[a] + h * (top ? upper[a] : lower[a]);
    };
    const Ticks up_ticks = ticks(end(upward, false), end(upward, true), 6);
    int left = 0;
    for (const double v : up_ticks.values)
        left = std::max(left, text_width(tick_text(v, up_ticks), text));
    const int margin = 6 * text, top = margin + 14 * text;
    plot.left = margin + left + 5 * text;
    int bar = 0;
    if constexpr (std::is_same_v<T, float>)
        bar = colour_bar_width(low, high, unit.empty() ? "" : meta.unit, text);
    else if constexpr (std::is_same_v<T, std::int32_t>)
        bar = text_width("99999999", text) + 10 * text;
    const int room =
        std::max(16, params.width - plot.left - 2 * margin - bar - (bar ? 8 * text : 0));
    plot.scale = std::min(double(room) / plot.columns, 2.0 * params.width / plot.rows);
    const int wide = std::max(1, static_cast<int>(plot.columns * plot.scale)),
              tall = std::max(1, static_cast<int>(plot.rows * plot.scale));
    plot.bottom = top + tall;
    const int foot = 34 * text;
    plot.image = Image8(params.width, std::max(plot.bottom + foot, 96 * text), 3);
    std::fill(plot.image.pixels.begin(), plot.image.pixels.end(), std::uint8_t{255});

    // Voxels, each a block of one colour; inactive ones stay white.
    for (int y = 0; y < tall; ++y)
        for (int x = 0; x < wide; ++x) {
            const int i = std::min(plot.columns - 1, static_cast<int>((x + 0.5) / plot.scale));
            const int j = std::min(plot.rows - 1, static_cast<int>((y + 0.5) / plot.scale));
            const std::size_t k =
                static_cast<std::size_t>(j) * columns + static_cast<std::size_t>(i);
            if (!plane.active[k]) continue;
            Vec3f colour;
            if constexpr (std::is_same_v<T, float>) {
                const auto v = static_cast<double>(plane.values[k]);
                colour = std::isfinite(v)
                             ? colour_of_value(high > low ? (v - low) / (high - low) : 0.5)
                             : Vec3f(0.5f, 0, 0.3f);
            } else if constexpr (std::is_same_v<T, std::int32_t>) {
                colour = colour_of_id(plane.values[k]);
            } else {
                colour = colour_of_direction(plane.values[k]);
            }
            const Rgb rgb = bytes(colour);
            if (plot.left + x >= plot.image.width) continue;
            for (int c = 0; c < 3; ++c)
                plot.image.at(plot.left + x, plot.bottom - 1 - y, c) = rgb[c];
        }

    // Frame, numbers, names.
    Image8& image = plot.image;
    draw_line(image, plot.left - 1, top - 1, plot.left + wide, top - 1);
    draw_line(image, plot.left - 1, plot.bottom, plot.left + wide, plot.bottom);
    draw_line(image, plot.left - 1, top - 1, plot.left - 1, plot.bottom);
    draw_line(image, plot.left + wide, top - 1, plot.left + wide, plot.bottom);
    draw_text(image, margin, margin, title, text, kInk);
    for (const double v : up_ticks.values) {
        const int y = plot.bottom - static_cast<int>((v - end(upward, false)) / h * plot.scale);
        const std::string label = tick_text(v, up_ticks);
        draw_line(image, plot.left - 3 * text, y, plot.left - 1, y);
        draw_text(image, plot.left - 5 * text - text_width(label, text), y - 3 * text, label, text,
                  kInk);
    }
    const Ticks across_ticks = ticks(end(across, false), end(across, true), 6);
    for (const double v : across_ticks.values) {
        const int x = plot.left + static_cast<int>((v - end(across, false)) / h * plot.scale);
        const std::string label = tick_text(v, across_ticks);
        draw_line(image, x, plot.bottom, x, plot.bottom + 3 * text);
        draw_text(image, x - text_width(label, text) / 2, plot.bottom + 5 * text, label, text,
                  kInk);
    }
    const std::string across_name = fmt::format("{} [m]", kAxes[across]),
                      up_name = fmt::format("{} [m]", kAxes[upward]);
    draw_text(image, plot.left + (wide - text_width(across_name, text)) / 2,
              plot.bottom + 18 * text, across_name, text, kInk);
    draw_text(image, margin, plot.bottom + 18 * text, up_name, text, kInk);
    const int bar_left = plot.left + wide + 8 * text;
    if constexpr (std::is_same_v<T, float>)
        draw_colour_bar(image, bar_left, top, std::max(tall, 60 * text), low, high, meta.unit, text,
                        kInk);
    else if constexpr (std::is_same_v<T, std::int32_t>)
        draw_id_legend(image, bar_left, top - 12 * text, std::max(tall, 60 * text) + 12 * text,
                       names, "", text, kInk);
    return plot;
}

}  // namespace

SlicePlot draw_slice(const Scene& scene, const SliceParams& params)
{
    if (params.axis != "x" && params.axis != "y" && params.axis != "z")
        throw InvalidParameter(fmt::format("slice: axis = {}, must be x, y or z", params.axis));
    if (params.width < 200 || params.width > 16384)
        throw InvalidParameter(
            fmt::format("slice: width = {}, must be 200 to 16384 pixels", params.width));
    const auto found = scene.grids.find(params.grid);
    if (found == scene.grids.end()) {
        std::vector<std::string> known;
        for (const auto& [name, grid] : scene.grids) known.push_back(name);
        throw InvalidInput(fmt::format(
            "slice: grid = {}, the scene has {}", params.grid.empty() ? "(none)" : params.grid,
            known.empty() ? "no grids" : fmt::format("{}", fmt::join(known, ", "))));
    }
    const Grid& grid = found->second;
    if (const auto* floats = std::get_if<FloatGrid>(&grid.values))
        return draw(*floats, grid, scene.domain, params);
    if (const auto* ints = std::get_if<IntGrid>(&grid.values))
        return draw(*ints, grid, scene.domain, params);
    if (const auto* vectors = std::get_if<VectorGrid>(&grid.values))
        return draw(*vectors, grid, scene.domain, params);
    throw InvalidInput(fmt::format(
        "slice: grid {} is of a type that cannot be shown, must be float, int32 or vec3s",
        params.grid));
}

Image8 slice(const Scene& scene, const SliceParams& params)
{
    return draw_slice(scene, params).image;
}

}  // namespace sekitei::render
