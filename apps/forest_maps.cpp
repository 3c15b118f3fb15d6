#include "apps/forest_maps.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "apps/habitat.h"
#include "core/csv.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

using forest::DensityMap;
using forest::Factor;
using forest::Raster;

constexpr const char* kDensityGrid = "forest_density";
constexpr const char* kTerrainGrid = "terrain_height";
constexpr double kMostColumns = 1 << 28;

std::string size_text(int width, int depth)
{
    return fmt::format("{} x {}", width, depth);
}

[[noreturn]] void reject_size(const std::string& name, int width, int depth,
                              const ForestFrame& frame)
{
    throw InvalidInput(fmt::format(
        "{}: the map has {} pixels, the forest {} of {:.6g} m; give one of that size, another size "
        "of the forest, or --fit to stretch the map",
        name, size_text(width, depth), size_text(frame.width, frame.depth), frame.pixel));
}

/// The nearest of `from` pixels to pixel `at` of `to`.
int nearest(int at, int from, int to)
{
    if (from == to) return at;
    return std::min(from - 1, static_cast<int>((at + 0.5) * from / to));
}

template <class T, class F>
Raster<T> fitted(const std::string& name, int width, int depth, const ForestFrame& frame, F&& at)
{
    if ((width != frame.width || depth != frame.depth) && !frame.fit)
        reject_size(name, width, depth, frame);
    Raster<T> raster(frame.width, frame.depth, at(0, 0));
    for (int j = 0; j < frame.depth; ++j) {
        for (int i = 0; i < frame.width; ++i)
            raster.set(i, j, at(nearest(i, width, frame.width), nearest(j, depth, frame.depth)));
        if (j % Raster<T>::kEdge == Raster<T>::kEdge - 1) raster.compress();
    }
    raster.compress();
    return raster;
}

template <class T, class F>
Raster<T> from_picture(const Image16& image, const std::string& name, const ForestFrame& frame,
                       F&& of_grey)
{
    return fitted<T>(name, image.width, image.height, frame,
                     [&](int i, int j) { return of_grey(image.at(i, image.height - 1 - j)); });
}

std::uint8_t byte_of(std::uint16_t grey)
{
    return static_cast<std::uint8_t>((grey + 256) / 257);  // no grey but black becomes 0
}

// --- volumes ---

bool is_volume(const std::filesystem::path& file)
{
    return file.extension() == ".vdb";
}

/// The grid that a word means: the one it names, one of `usual`, or the only one of its kind.
std::string choose_grid(const std::filesystem::path& path, const std::string& named,
                        const std::vector<std::string>& usual)
{
    const VdbFileInfo info = inspect_vdb(path);
    std::vector<std::string> all, fitting;
    for (const VdbGridInfo& grid : info.grids) {
        all.push_back(grid.name);
        if (!grid.points && (grid.type == "float" || grid.type == "int32"))
            fitting.push_back(grid.name);
    }
    auto has = [&](const std::string& name) {
        return std::find(all.begin(), all.end(), name) != all.end();
    };
    if (!named.empty() && has(named)) return named;
    if (named.empty()) {
        for (const std::string& name : usual)
            if (has(name)) return name;
        if (fitting.size() == 1) return fitting.front();
    }
    throw InvalidInput(fmt::format(
        "{}: {}; present: {}", path.string(),
        named.empty()
            ? fmt::format("no grid {} and not just one float grid; name one, as in {}:GRID",
                          fmt::join(usual, " or "), path.filename().string())
            : fmt::format("no grid '{}'", named),
        fmt::join(all, ", ")));
}

Grid load_grid(const std::filesystem::path& path, const std::string& name,
               const StageContext& context)
{
    ReadOptions options;
    options.only = {name};
    options.fix_nan = context.fix_nan;
    options.memory_limit = context.memory_limit;
    Scene scene = read_vdb(path, options, context.progress);
    const auto found = scene.grids.find(name);
    if (found == scene.grids.end())
        throw InvalidInput(fmt::format("{}: '{}' is not a grid of numbers", path.string(), name));
    return std::move(found->second);
}

/// Voxels [lower, upper) that hold the active ones; empty: lower == upper.
struct Box {
    Coord lower{}, upper{};
    bool empty() const { return lower == upper; }
};

template <class G>
Box active_box(const G& grid, double& count)
{
    Box box{Coord(std::numeric_limits<int>::max()), Coord(std::numeric_limits<int>::min())};
    count = 0;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.mask(leaf).for_each([&](int k) {
            const Coord c = leaf_coord(grid.origin(leaf), k);
            box.lower = min(box.lower, c);
            box.upper = max(box.upper, c + Coord(1));
            ++count;
        });
    return count > 0 ? box : Box{};
}

/// A grid as layers of pixels: column i from the west, row j from the south, layer z = 0 the
/// lowest.
class Layers {
public:
    /// @param usual  names of the grid where `named` is empty
    Layers(const std::filesystem::path& path, const std::string& named,
           const std::vector<std::string>& usual, const ForestFrame& frame,
           const StageContext& context)
    {
        const std::string chosen = choose_grid(path, named, usual);
        name_ = fmt::format("{}: grid '{}'", path.string(), chosen);
        grid_ = load_grid(path, chosen, context);
        place(frame);
    }
    Layers(Grid grid, std::string name, const ForestFrame& frame)
        : name_(std::move(name)), grid_(std::move(grid))
    {
        place(frame);
    }

    const std::string& name() const { return name_; }
    int count() const { return to_.z; }

    /// @param f  makes a value of a number and its pixel
    template <class T, class F>
    Raster<T> layer(int z, const ForestFrame& frame, F&& f) const
    {
        return std::visit(
            [&](const auto& grid) -> Raster<T> {
                if constexpr (requires { static_cast<float>(grid.value(Coord())); })
                    return fitted<T>(
                        name_, to_.x - from_.x, to_.y - from_.y, frame, [&](int i, int j) {
                            return f(static_cast<float>(grid.value({from_.x + i, from_.y + j, z})),
                                     i, j);
                        });
                else
                    throw wrong_type();
            },
            grid_.values);
    }
    Raster<float> only_layer(const ForestFrame& frame) const
    {
        if (count() != 1)
            throw InvalidInput(fmt::format("{}: {} layers, must have one, z = 0", name_, count()));
        return layer<float>(0, frame, [&](float value, int i, int j) {
            if (!std::isfinite(value))
                throw InvalidInput(fmt::format("{}: {} at pixel ({}, {}), must be a finite number",
                                               name_, value, i, j));
            return value;
        });
    }

private:
    InvalidInput wrong_type() const
    {
        return InvalidInput(
            fmt::format("{} holds {}, must hold floats or integers", name_, grid_.type_name()));
    }

    void place(const ForestFrame& frame)
    {
        double active = 0;
        Box box;
        Transform transform;
        if (const auto* floats = std::get_if<FloatGrid>(&grid_.values)) {
            box = active_box(*floats, active);
            transform = floats->transform();
        } else if (const auto* ints = std::get_if<IntGrid>(&grid_.values)) {
            box = active_box(*ints, active);
            transform = ints->transform();
        } else {
            throw wrong_type();
        }
        if (box.empty()) throw InvalidInput(name_ + ": the grid has no active voxels");
        if (box.lower.z < 0)
            throw InvalidInput(fmt::format("{}: the grid's lowest layer is z = {}, must be 0",
                                           name_, box.lower.z));
        from_ = {box.lower.x, box.lower.y, 0};
        to_ = box.upper;
        if (!frame.fit) require_frame(frame, transform.voxel, active);
    }

    void require_frame(const ForestFrame& frame, double voxel, double active)
    {
        if (std::abs(voxel - frame.pixel) > 1e-6 * frame.pixel)
            throw InvalidInput(fmt::format(
                "{}: voxels of {:.6g} m, the forest's pixels have {:.6g} m; resample the grid, or "
                "give --fit to stretch it over the forest",
                name_, voxel, frame.pixel));
        // A full rectangle of another size is a map of another forest; loose voxels are a sparse
        // map.
        const Coord size = to_ - from_;
        const bool same = size.x == frame.width && size.y == frame.depth;
        const bool inside =
            from_.x >= 0 && from_.y >= 0 && to_.x <= frame.width && to_.y <= frame.depth;
        if (!same && (!inside || std::fmod(active, double(size.x) * double(size.y)) == 0))
            reject_size(name_, size.x, size.y, frame);
        if (same && !inside)
            throw InvalidInput(fmt::format(
                "{}: the grid begins at voxel ({}, {}), must begin at (0, 0), the forest's "
                "south-western pixel",
                name_, from_.x, from_.y));
        from_ = {0, 0, 0};
        to_ = {frame.width, frame.depth, to_.z};
    }

    std::string name_;
    Grid grid_;
    Coord from_, to_;
};

// --- words ---

std::string_view trimmed(std::string_view text)
{
    while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
    while (!text.empty() && text.back() == ' ') text.remove_suffix(1);
    return text;
}

MapWord map_word(const std::string& option, std::string_view text, bool named)
{
    MapWord word;
    word.option = option;
    word.text = std::string(text);
    auto wrong = [&](const std::string& why) {
        return InvalidParameter(fmt::format("{} = {}: {}", option, word.text, why));
    };
    if (named) {
        const std::size_t equals = text.find('=');
        if (equals == std::string_view::npos || equals == 0)
            throw wrong("expected NAME=MAP, e.g. water=wet.png");
        word.name = std::string(trimmed(text.substr(0, equals)));
        text = trimmed(text.substr(equals + 1));
    }
    if (const auto number = number_of(text)) {
        word.number = *number;
        return word;
    }
    if (text.ends_with(']')) {
        const std::size_t open = text.rfind('[');
        const std::string_view inside =
            open == std::string_view::npos ? "" : text.substr(open + 1, text.size() - open - 2);
        const std::size_t dots = inside.find("..");
        const auto low = number_of(trimmed(inside.substr(0, dots)));
        const auto high = dots == std::string_view::npos
                              ? std::nullopt
                              : number_of(trimmed(inside.substr(dots + 2)));
        if (!low || !high)
            throw wrong("expected the values of black and white, e.g. heat.png[-5..25]");
        word.range = {*low, *high};
        text = text.substr(0, open);
    }
    if (const std::size_t at = text.rfind(".vdb:"); at != std::string_view::npos) {
        word.grid = std::string(text.substr(at + 5));
        text = text.substr(0, at + 4);
        if (word.grid.empty()) throw wrong("expected the name of a grid after the colon");
    }
    word.file = std::string(text);
    if (!is_volume(word.file) && word.file.extension() != ".png")
        throw wrong("expected a number, a .png file, or a .vdb file with :GRID after it");
    if (is_volume(word.file) && word.range)
        throw wrong("a volume has values of its own; the range in brackets is for pictures");
    return word;
}

MapWord one_word(const std::string& option, const std::string& text)
{
    const std::vector<MapWord> words = map_words(option, text, false);
    if (words.size() != 1)
        throw InvalidParameter(
            fmt::format("{} = {}: {} maps, must be one", option, text, words.size()));
    return words.front();
}

/// A word's only layer.
Raster<float> raster_of(const MapWord& word, const ForestFrame& frame, const StageContext& context)
{
    if (word.number) return {frame.width, frame.depth, static_cast<float>(*word.number)};
    const std::filesystem::path path = Stage::resolve(context, word.file);
    if (is_volume(path)) {
        const std::string& usual = word.name.empty() ? word.option : word.name;
        return Layers(path, word.grid, {usual}, frame, context).only_layer(frame);
    }
    const std::array<double, 2> range = word.range.value_or(std::array<double, 2>{0, 1});
    const double black = range[0], white = range[1];
    return from_picture<float>(
        read_png_grey16(path), path.string(), frame, [black, white](std::uint16_t grey) {
            return static_cast<float>(black + (white - black) * (grey / 65535.0));
        });
}

/// The bands that a word of a density gives.
std::vector<DensityMap> density_of(const MapWord& word, const ForestFrame& frame,
                                   const StageContext& context)
{
    if (word.range)
        throw InvalidParameter(
            fmt::format("density = {}: a density has no range; black is 0 and white 1", word.text));
    if (word.number) {
        if (!(*word.number >= 0 && *word.number <= 1))
            throw InvalidParameter(fmt::format("density = {}, must be 0 to 1", word.text));
        return {{frame.width, frame.depth, forest::density_value(*word.number)}};
    }
    const std::filesystem::path path = Stage::resolve(context, word.file);
    if (!is_volume(path)) return {image_map(read_png_grey16(path), path.string(), frame)};
    const Layers layers(path, word.grid, {kDensityGrid}, frame, context);
    std::vector<DensityMap> maps;
    for (int z = 0; z < layers.count(); ++z)
        maps.push_back(layers.layer<std::uint16_t>(z, frame, [&](float value, int i, int j) {
            if (!(value >= 0 && value <= 1))
                throw InvalidInput(
                    fmt::format("{}: density = {} at pixel ({}, {}) of layer {}, must be 0 to 1",
                                layers.name(), value, i, j, z));
            return forest::density_value(double(value));
        }));
    return maps;
}

// --- terrain ---

/// Heights of the highest surface in each column of voxels.
struct Columns {
    Coord lower{}, upper{};
    std::vector<double> height;  ///< world [m]; -infinity where there is none

    double& at(int x, int y)
    {
        return height[std::size_t(y - lower.y) * std::size_t(upper.x - lower.x) +
                      std::size_t(x - lower.x)];
    }
};

/// @param solid  whether a larger value than `iso` is solid (a density), or a smaller one
Columns highest_surface(const FloatGrid& grid, bool density, const std::string& name)
{
    const float iso = density ? 0.5f : 0.0f;
    auto solid = [&](float v) { return density ? v >= iso : v < iso; };
    Columns columns;
    columns.lower = Coord(std::numeric_limits<int>::max());
    columns.upper = Coord(std::numeric_limits<int>::min());
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf) {
        columns.lower = min(columns.lower, grid.origin(leaf));
        columns.upper = max(columns.upper, grid.origin(leaf) + Coord(kLeafEdge));
    }
    if (grid.leaf_count() == 0) throw InvalidInput(name + ": the grid has no active voxels");
    const double wide = double(columns.upper.x) - columns.lower.x,
                 deep = double(columns.upper.y) - columns.lower.y;
    if (wide * deep > kMostColumns)
        throw InvalidInput(fmt::format("{}: {} x {} columns of voxels are too many for a terrain",
                                       name, wide, deep));
    columns.height.assign(std::size_t(wide * deep), -std::numeric_limits<double>::infinity());
    const Transform& transform = grid.transform();
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int k = 0; k < kLeafSize; ++k) {
            const float below = grid.at(leaf, k);
            if (!solid(below) || !grid.mask(leaf).test(k)) continue;
            const Coord c = leaf_coord(grid.origin(leaf), k);
            // z runs fastest. What lies under a roof never counts, so neither does what a level set
            // does not know beyond its narrow band.
            const float above =
                (k & 7) != 7 ? grid.at(leaf, k + 1) : grid.value(c + Coord(0, 0, 1));
            if (solid(above)) continue;
            const double share = (double(below) - double(iso)) / (double(below) - double(above));
            double& highest = columns.at(c.x, c.y);
            highest = std::max(highest, transform.origin.z + transform.voxel * (c.z + 0.5 + share));
        }
    return columns;
}

Raster<float> ground_of(const FloatGrid& grid, bool density, const std::string& name,
                        const ForestFrame& frame)
{
    Columns columns = highest_surface(grid, density, name);
    const Transform& transform = grid.transform();
    // The columns whose centres lie in a pixel, or the one that holds its centre.
    auto range = [&](double from, double to, double origin, int lower, int upper) {
        const double a = (from - origin) / transform.voxel, b = (to - origin) / transform.voxel;
        double first = std::ceil(a - 0.5), last = std::ceil(b - 0.5);
        if (last <= first) {
            first = std::floor((a + b) / 2);
            last = first + 1;
        }
        return std::pair{static_cast<int>(std::clamp(first, double(lower), double(upper))),
                         static_cast<int>(std::clamp(last, double(lower), double(upper)))};
    };
    Raster<float> ground(frame.width, frame.depth, 0.0f);
    bool any = false;
    for (int j = 0; j < frame.depth; ++j) {
        const double y = frame.corner.y + j * frame.pixel;
        const auto [y0, y1] =
            range(y, y + frame.pixel, transform.origin.y, columns.lower.y, columns.upper.y);
        if (y0 >= y1) continue;
        for (int i = 0; i < frame.width; ++i) {
            const double x = frame.corner.x + i * frame.pixel;
            const auto [x0, x1] =
                range(x, x + frame.pixel, transform.origin.x, columns.lower.x, columns.upper.x);
            double highest = -std::numeric_limits<double>::infinity();
            for (int v = y0; v < y1; ++v)
                for (int u = x0; u < x1; ++u) highest = std::max(highest, columns.at(u, v));
            if (!std::isfinite(highest)) continue;
            ground.set(i, j, static_cast<float>(highest - frame.corner.z));
            any = true;
        }
    }
    if (!any)
        throw InvalidInput(fmt::format(
            "{}: no surface within the forest, x {:.6g} to {:.6g} m, y {:.6g} to {:.6g} m; move "
            "the forest's corner there",
            name, frame.corner.x, frame.corner.x + frame.width * frame.pixel, frame.corner.y,
            frame.corner.y + frame.depth * frame.pixel));
    ground.compress();
    return ground;
}

Raster<float> terrain_of_volume(const MapWord& word, const std::filesystem::path& path,
                                const ForestFrame& frame, const StageContext& context)
{
    std::vector<std::string> usual{kTerrainGrid, "density", "surface_sdf", "body_sdf"};
    for (const VdbGridInfo& grid : inspect_vdb(path).grids)
        if (grid.grid_class == "level set") usual.push_back(grid.name);
    const std::string name = choose_grid(path, word.grid, usual);
    const std::string who = fmt::format("{}: grid '{}'", path.string(), name);
    Grid grid = load_grid(path, name, context);
    const bool fog = grid.grid_class == GridClass::FogVolume || name == "density",
               level_set = grid.grid_class == GridClass::LevelSet;
    if (!fog && !level_set) {
        Raster<float> ground = Layers(std::move(grid), who, frame).only_layer(frame);
        ground.transform([&](float z) { return static_cast<float>(double(z) - frame.corner.z); });
        return ground;
    }
    const auto* floats = std::get_if<FloatGrid>(&grid.values);
    if (!floats)
        throw InvalidInput(fmt::format("{} holds {}, must hold floats", who, grid.type_name()));
    return ground_of(*floats, fog, who, frame);
}

Raster<float> terrain_of_picture(const TerrainParams& params, const std::filesystem::path& path,
                                 const ForestFrame& frame)
{
    const Image16 image = read_png_grey16(path);
    double across = params.metres_per_pixel.value_or(frame.pixel), along = across;
    if (frame.fit) {
        across = frame.width * frame.pixel / image.width;
        along = frame.depth * frame.pixel / image.height;
    } else if (!params.metres_per_pixel &&
               (image.width != frame.width || image.height != frame.depth)) {
        throw InvalidInput(fmt::format(
            "{}: the terrain has {} pixels, the forest {} of {:.6g} m; give metres_per_pixel, the "
            "size of the terrain's pixels, or --fit to stretch it",
            path.string(), size_text(image.width, image.height),
            size_text(frame.width, frame.depth), frame.pixel));
    }
    const double wide = frame.width * frame.pixel, deep = frame.depth * frame.pixel;
    if (image.width * across < wide * (1 - 1e-9) || image.height * along < deep * (1 - 1e-9))
        throw InvalidInput(fmt::format(
            "{}: the terrain covers {:.6g} x {:.6g} m, the forest {:.6g} x {:.6g} m; make the "
            "forest smaller, metres_per_pixel larger, or give --fit to stretch the terrain",
            path.string(), image.width * across, image.height * along, wide, deep));
    const double low = *params.height_low, span = (*params.height_high - low) / 65535;
    Raster<float> ground(frame.width, frame.depth, 0.0f);
    for (int y = 0; y < frame.depth; ++y)
        for (int x = 0; x < frame.width; ++x) {
            // Bilinear between pixel centres; row 0 is the northern edge, the largest y.
            const double u = std::clamp((x + 0.5) * frame.pixel / across - 0.5, 0.0,
                                        image.width - 1.0),
                         v = std::clamp(image.height - (y + 0.5) * frame.pixel / along - 0.5, 0.0,
                                        image.height - 1.0);
            const int i = static_cast<int>(u), j = static_cast<int>(v);
            const int i1 = std::min(i + 1, image.width - 1), j1 = std::min(j + 1, image.height - 1);
            const double s = u - i, t = v - j;
            const double grey = (image.at(i, j) * (1 - s) + image.at(i1, j) * s) * (1 - t) +
                                (image.at(i, j1) * (1 - s) + image.at(i1, j1) * s) * t;
            ground.set(x, y, static_cast<float>(low + span * grey));
        }
    ground.compress();
    return ground;
}

}  // namespace

std::vector<MapWord> map_words(const std::string& option, const std::string& text, bool named)
{
    std::vector<MapWord> words;
    if (!text.empty() && split_names(text).empty())
        throw InvalidParameter(fmt::format("{} = {}: names no map", option, text));
    for (const std::string& one : split_names(text)) {
        words.push_back(map_word(option, one, named));
        if (named && std::any_of(words.begin(), words.end() - 1, [&](const MapWord& other) {
                return other.name == words.back().name;
            }))
            throw InvalidParameter(
                fmt::format("{} = {}: '{}' is given twice", option, text, words.back().name));
    }
    return words;
}

std::vector<std::filesystem::path> map_files(const std::string& text, bool named)
{
    std::vector<std::filesystem::path> files;
    for (const MapWord& word : map_words("map", text, named))
        if (!word.file.empty() && std::find(files.begin(), files.end(), word.file) == files.end())
            files.push_back(word.file);
    return files;
}

std::vector<DensityMap> read_density(const std::string& text, int bands, const ForestFrame& frame,
                                     const StageContext& context)
{
    const std::vector<MapWord> words = map_words("density", text, false);
    std::vector<DensityMap> maps;
    if (words.empty()) maps = {{frame.width, frame.depth, forest::density_value(1)}};
    for (const MapWord& word : words) {
        std::vector<DensityMap> some = density_of(word, frame, context);
        if (words.size() > 1 && some.size() > 1)
            throw InvalidParameter(
                fmt::format("density = {}: {} has {} maps; give it alone, or grids of one layer",
                            text, word.text, some.size()));
        std::move(some.begin(), some.end(), std::back_inserter(maps));
    }
    if (maps.size() == 1) maps.resize(std::size_t(bands), DensityMap(maps.front()));
    if (maps.size() != std::size_t(bands))
        throw InvalidParameter(
            fmt::format("density = {}: {} maps, must be {}, one a band of slices, or 1 for all",
                        text, maps.size(), bands));
    return maps;
}

std::vector<Factor> read_environment(const std::string& text, const ForestFrame& frame,
                                     const StageContext& context)
{
    std::vector<Factor> factors;
    for (const MapWord& word : map_words("environment", text, true)) {
        Factor factor{word.name, {}, static_cast<float>(word.number.value_or(0))};
        if (!word.number) factor.value = raster_of(word, frame, context);
        factors.push_back(std::move(factor));
    }
    return factors;
}

Raster<float> read_map(const std::string& option, const std::string& text, const ForestFrame& frame,
                       const StageContext& context)
{
    return raster_of(one_word(option, text), frame, context);
}

Raster<std::uint8_t> read_mask(const std::string& option, const std::string& text,
                               const ForestFrame& frame, const StageContext& context)
{
    const Raster<float> map = read_map(option, text, frame, context);
    Raster<std::uint8_t> mask(frame.width, frame.depth, 0);
    for (int j = 0; j < frame.depth; ++j)
        for (int i = 0; i < frame.width; ++i) mask.set(i, j, map.at(i, j) != 0);
    mask.compress();
    return mask;
}

void validate(const TerrainParams& params)
{
    validate_described("forest", params);
    if (params.terrain.empty()) {
        if (params.metres_per_pixel || params.height_low || params.height_high)
            throw InvalidParameter(
                "forest: metres_per_pixel, height_low and height_high are for a terrain picture; "
                "give one with terrain = FILE.png");
        return;
    }
    const MapWord word = one_word("terrain", params.terrain);
    const bool picture = !word.number && !is_volume(word.file);
    if (word.number || word.range)
        throw InvalidParameter(fmt::format(
            "forest: terrain = {}, must be a .png or .vdb file; height_low and height_high are the "
            "heights of black and white",
            params.terrain));
    if (picture && (!params.height_low || !params.height_high))
        throw InvalidParameter(
            "forest: a terrain picture needs height_low and height_high, the heights of black and "
            "white");
    if (picture && *params.height_low > *params.height_high)
        throw InvalidParameter(
            fmt::format("forest: height_low = {} m, must be at most height_high = {} m",
                        *params.height_low, *params.height_high));
    if (!picture && (params.metres_per_pixel || params.height_low || params.height_high))
        throw InvalidParameter(
            "forest: metres_per_pixel, height_low and height_high are for pictures; a volume has "
            "sizes of its own");
}

Raster<float> read_terrain(const TerrainParams& params, const ForestFrame& frame,
                           const StageContext& context)
{
    validate(params);
    if (params.terrain.empty()) return {};
    const MapWord word = one_word("terrain", params.terrain);
    const std::filesystem::path path = Stage::resolve(context, word.file);
    return is_volume(path) ? terrain_of_volume(word, path, frame, context)
                           : terrain_of_picture(params, path, frame);
}

void take_land(forest::Land& land, const Scene& scene, const ForestFrame& frame)
{
    auto fill = [&]<class T>(Raster<T>& raster, const char* name, auto&& value) {
        if (!raster.empty() || !scene.has(name)) return;
        const FloatGrid& grid = scene.floats(name);
        raster = Raster<T>(frame.width, frame.depth, value(grid.background()));
        GridReader<float> reader(grid);
        for (int j = 0; j < frame.depth; ++j) {
            for (int i = 0; i < frame.width; ++i) {
                const Vec3d at = grid.transform().voxels(frame.corner +
                                                         Vec3d(i + 0.5, j + 0.5, 0) * frame.pixel);
                const float here = reader.value({int(std::floor(at.x)), int(std::floor(at.y)), 0});
                if (!std::isfinite(here))
                    throw InvalidInput(fmt::format(
                        "grid '{}': {} at pixel ({}, {}) of the forest, must be a finite number",
                        name, here, i, j));
                raster.set(i, j, value(here));
            }
            if (j % Raster<T>::kEdge == Raster<T>::kEdge - 1) raster.compress();
        }
        raster.compress();
    };
    fill(land.ground, kGroundHeight, [&](float z) { return float(double(z) - frame.corner.z); });
    fill(land.blocked_height, kBlockedHeight, [](float h) { return h; });
    fill(land.plantable, kPlantable, [](float p) { return std::uint8_t(p != 0); });
}

Image16 map_image(const DensityMap& map)
{
    Image16 image(map.width(), map.depth(), 1);
    for (int j = 0; j < map.depth(); ++j)
        for (int i = 0; i < map.width(); ++i) image.at(i, map.depth() - 1 - j) = map.at(i, j);
    return image;
}

Image8 mask_image(const Raster<std::uint8_t>& mask)
{
    Image8 image(mask.width(), mask.depth(), 1);
    for (int j = 0; j < mask.depth(); ++j)
        for (int i = 0; i < mask.width(); ++i) image.at(i, mask.depth() - 1 - j) = mask.at(i, j);
    return image;
}

DensityMap image_map(const Image16& image, const std::string& name, const ForestFrame& frame)
{
    return from_picture<std::uint16_t>(image, name, frame, [](std::uint16_t grey) { return grey; });
}

Raster<std::uint8_t> image_mask(const Image16& image, const std::string& name,
                                const ForestFrame& frame)
{
    return from_picture<std::uint8_t>(image, name, frame, byte_of);
}

MapWatcher::MapWatcher(std::string text, int bands, const ForestFrame& frame,
                       const StageContext& context)
    : text_(std::move(text)),
      bands_(bands),
      frame_(frame),
      context_(context),
      known_(hashes()),
      maps_(read_density(text_, bands_, frame_, context_))
{
}

std::map<std::string, std::string> MapWatcher::hashes() const
{
    std::map<std::string, std::string> found;
    for (const std::filesystem::path& file : map_files(text_, false)) {
        std::string& hash = found[file.string()];
        try {
            hash = file_hash(Stage::resolve(context_, file));
        } catch (const InvalidInput&) {
            hash.clear();
        }
    }
    return found;
}

std::vector<forest::Edit> MapWatcher::changes(int step)
{
    const auto before = hashes();
    if (before == known_) return {};
    std::vector<DensityMap> now;
    try {
        now = read_density(text_, bands_, frame_, context_);
        if (hashes() != before) throw InvalidInput("density: a map is being written");
    } catch (const InvalidInput& error) {
        if (told_ != error.what())
            log::warning("step {}: the maps stay as they were: {}", step, error.what());
        told_ = error.what();
        return {};
    }
    known_ = before;
    told_.clear();
    std::vector<forest::Edit> edits;
    for (std::size_t band = 0; band < now.size(); ++band) {
        if (now[band] == maps_[band]) continue;
        forest::Edit edit;
        edit.kind = forest::Edit::Kind::Image;
        edit.step = step;
        edit.map = static_cast<int>(band);
        edit.image = now[band];
        edits.push_back(std::move(edit));
    }
    maps_ = std::move(now);
    return edits;
}

}  // namespace sekitei::apps
