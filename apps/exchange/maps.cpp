#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "apps/exchange/files.h"
#include "core/error.h"
#include "core/parallel.h"
#include "core/params.h"

namespace sekitei::apps {
namespace {

constexpr double kMostPixels = 16384;
constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();

/// Values of pixels, rows from the north.
struct Raster {
    int width = 0, height = 0;
    double pixel = 1;  // [m]
    Vec3d corner;      // of the south-western pixel
    std::vector<float> values;

    Raster(Vec3d low, Vec3d high, double size) : pixel(size), corner(low.x, low.y, 0)
    {
        const double w = std::ceil((high.x - low.x) / size - 1e-6),
                     h = std::ceil((high.y - low.y) / size - 1e-6);
        if (!(w <= kMostPixels && h <= kMostPixels))
            throw LimitExceeded(fmt::format(
                "export: a map of {:.0f} by {:.0f} pixels, at most {} are possible along a side; "
                "make metres_per_pixel larger",
                w, h, kMostPixels));
        width = std::max(1, int(w));
        height = std::max(1, int(h));
        values.assign(std::size_t(width) * std::size_t(height), kNothing);
    }
    float& at(int x, int row)
    {
        return values[std::size_t(row) * std::size_t(width) + std::size_t(x)];
    }
};

/// The grid, if it is one voxel high and not larger than a picture.
const FloatGrid* flat(const Grid& grid)
{
    const auto* floats = std::get_if<FloatGrid>(&grid.values);
    if (!floats || floats->leaf_count() == 0) return nullptr;
    bool any = false;
    for (std::size_t leaf = 0; leaf < floats->leaf_count(); ++leaf) {
        const LeafMask& mask = floats->mask(leaf);
        if (mask.none()) continue;
        any = true;
        if (floats->origin(leaf).z != 0) return nullptr;
        bool low = true;
        mask.for_each(
            [&](int offset) { low = low && leaf_coord(floats->origin(leaf), offset).z == 0; });
        if (!low) return nullptr;
    }
    return any ? floats : nullptr;
}

Raster of_grid(const FloatGrid& grid)
{
    const double v = grid.transform().voxel;
    Bounds land;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.mask(leaf).for_each([&](int offset) {
            const Coord c = leaf_coord(grid.origin(leaf), offset);
            land.add(Vec3d(c));
            land.add(Vec3d(c) + Vec3d(1, 1, 0));
        });
    const Vec3d low = grid.transform().world(land.lower), high = grid.transform().world(land.upper);
    Raster raster(low, high, v);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.mask(leaf).for_each([&](int offset) {
            const Coord c = leaf_coord(grid.origin(leaf), offset);
            raster.at(c.x - int(land.lower.x), raster.height - 1 - (c.y - int(land.lower.y))) =
                grid.at(leaf, offset);
        });
    return raster;
}

/// A number of a surface at a place on a triangle; false where it has none of this name.
class Sampled {
public:
    Sampled(const Surface& surface, const std::string& name) : mesh_(surface.mesh())
    {
        if (const auto field = surface.fields.find(name); field != surface.fields.end())
            vertices_ = &field->second;
        auto find = [&](const auto& attributes, auto*& floats, auto*& whole) {
            const auto found = attributes.find(name);
            if (found == attributes.end()) return;
            floats = std::get_if<std::vector<float>>(&found->second);
            whole = std::get_if<std::vector<std::int32_t>>(&found->second);
        };
        if (!vertices_) find(mesh_.vertex_attributes, vertices_, whole_vertices_);
        find(mesh_.face_attributes, faces_, whole_faces_);
    }
    bool has() const { return vertices_ || whole_vertices_ || faces_ || whole_faces_; }
    float value(std::size_t t, const std::array<double, 3>& weights) const
    {
        if (whole_faces_) return static_cast<float>((*whole_faces_)[t]);
        const auto& corners = mesh_.triangles[t];
        if (vertices_) {
            double sum = 0;
            for (std::size_t k = 0; k < 3; ++k)
                sum += weights[k] * static_cast<double>((*vertices_)[corners[k]]);
            return static_cast<float>(sum);
        }
        if (whole_vertices_) {
            const auto k = std::size_t(std::ranges::max_element(weights) - weights.begin());
            return static_cast<float>((*whole_vertices_)[corners[k]]);
        }
        return faces_ ? (*faces_)[t] : kNothing;
    }

private:
    const TriMesh& mesh_;
    const std::vector<float>*vertices_ = nullptr, *faces_ = nullptr;
    const std::vector<std::int32_t>*whole_vertices_ = nullptr, *whole_faces_ = nullptr;
};

bool stands_still(const Surface& surface)
{
    return surface.kind == "rock" || surface.kind == "ground" || surface.kind == "obstacle";
}

Raster of_surfaces(const Assembly& assembly, const std::string& name,
                   const std::optional<double>& metres_per_pixel, const Progress& progress)
{
    Bounds box;
    for (const Surface& surface : assembly.surfaces)
        if (stands_still(surface)) {
            box.add(surface.mesh().bounds().lower);
            box.add(surface.mesh().bounds().upper);
        }
    if (box.empty())
        throw InvalidInput(
            "export: a map shows rock, ground or obstacles from above, the scene has none of "
            "them");
    const double longer = std::max(box.size().x, box.size().y);
    const double pixel = metres_per_pixel.value_or(longer > 0 ? longer / 1024 : 1);
    Raster raster(box.lower, box.upper, pixel);
    std::vector<float> highest(raster.values.size(), -std::numeric_limits<float>::infinity());
    // Bands of rows by themselves, triangles in their order in each.
    constexpr int kBand = 64;
    const int bands = (raster.height + kBand - 1) / kBand;
    for (const Surface& surface : assembly.surfaces) {
        if (!stands_still(surface)) continue;
        progress.check();
        const TriMesh& mesh = surface.mesh();
        const bool height = name == "height";
        const Sampled field(surface, name);
        parallel_for(std::size_t(bands), [&](std::size_t band) {
            const int first = int(band) * kBand, last = std::min(raster.height, first + kBand);
            for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
                std::array<Vec3d, 3> p;
                for (std::size_t k = 0; k < 3; ++k) {
                    p[k] = (Vec3d(mesh.vertices[mesh.triangles[t][k]]) - raster.corner) / pixel;
                    p[k].y = raster.height - p[k].y;  // rows from the north
                }
                const double low_y = std::min({p[0].y, p[1].y, p[2].y}),
                             high_y = std::max({p[0].y, p[1].y, p[2].y});
                const int y0 = std::max(first, int(std::ceil(low_y - 0.5))),
                          y1 = std::min(last - 1, int(std::floor(high_y - 0.5)));
                if (y0 > y1) continue;
                const double area =
                    (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[1].y - p[0].y) * (p[2].x - p[0].x);
                if (area == 0) continue;
                const int x0 =
                              std::max(0, int(std::ceil(std::min({p[0].x, p[1].x, p[2].x}) - 0.5))),
                          x1 = std::min(raster.width - 1,
                                        int(std::floor(std::max({p[0].x, p[1].x, p[2].x}) - 0.5)));
                for (int y = y0; y <= y1; ++y)
                    for (int x = x0; x <= x1; ++x) {
                        const double px = x + 0.5, py = y + 0.5;
                        std::array<double, 3> w;
                        for (std::size_t k = 0; k < 3; ++k) {
                            const Vec3d &a = p[(k + 1) % 3], &b = p[(k + 2) % 3];
                            w[k] = ((b.x - a.x) * (py - a.y) - (b.y - a.y) * (px - a.x)) / area;
                        }
                        if (!(w[0] >= 0 && w[1] >= 0 && w[2] >= 0)) continue;
                        double z = 0;
                        for (std::size_t k = 0; k < 3; ++k)
                            z += w[k] * static_cast<double>(mesh.vertices[mesh.triangles[t][k]].z);
                        const std::size_t i =
                            std::size_t(y) * std::size_t(raster.width) + std::size_t(x);
                        if (!(static_cast<float>(z) > highest[i])) continue;
                        highest[i] = static_cast<float>(z);
                        raster.values[i] = height ? static_cast<float>(z) : field.value(t, w);
                    }
            }
        });
    }
    return raster;
}

}  // namespace

std::vector<std::string> map_names(const Scene& scene, const Assembly& assembly)
{
    std::vector<std::string> names;
    if (std::ranges::any_of(assembly.surfaces, stands_still)) names.emplace_back("height");
    for (const auto& [name, field] : assembly.fields)
        if (std::ranges::any_of(assembly.surfaces, [&, field_name = &name](const Surface& surface) {
                return stands_still(surface) && Sampled(surface, *field_name).has();
            }))
            names.push_back(name);
    for (const auto& [name, grid] : scene.grids)
        if (flat(grid) && std::ranges::find(names, name) == names.end()) names.push_back(name);
    return names;
}

FieldMap make_map(const Scene& scene, const Assembly& assembly, const std::string& name,
                  const std::optional<double>& metres_per_pixel, const Progress& progress)
{
    const std::vector<std::string> names = map_names(scene, assembly);
    if (std::ranges::find(names, name) == names.end()) {
        if (name == "height")
            throw InvalidInput(
                "export: a map shows rock, ground or obstacles from above, the scene has none of "
                "them");
        const std::string near = nearest_name(name, names);
        throw InvalidParameter(fmt::format("export: map = {}: must be one of {}{}", name,
                                           fmt::join(names, ", "),
                                           near.empty() ? "" : "; did you mean '" + near + "'?"));
    }
    const auto grid = scene.grids.find(name);
    const FloatGrid* own =
        grid == scene.grids.end() || metres_per_pixel ? nullptr : flat(grid->second);
    const Raster raster =
        own ? of_grid(*own) : of_surfaces(assembly, name, metres_per_pixel, progress);
    double low = INFINITY, high = -INFINITY;
    std::size_t unseen = 0;
    for (const float x : raster.values) {
        if (!std::isfinite(x)) {
            ++unseen;
            continue;
        }
        low = std::min(low, static_cast<double>(x));
        high = std::max(high, static_cast<double>(x));
    }
    if (unseen == raster.values.size())
        throw InvalidInput(fmt::format("export: map = {}: nothing of it is seen from above", name));
    // Where something is left out, black is kept for that.
    const int first = unseen > 0 ? 1 : 0;
    FieldMap map;
    map.picture = Image16(raster.width, raster.height, 1);
    for (std::size_t i = 0; i < raster.values.size(); ++i) {
        const float x = raster.values[i];
        const double part = high > low ? (static_cast<double>(x) - low) / (high - low) : 0;
        map.picture.pixels[i] =
            std::isfinite(x)
                ? static_cast<std::uint16_t>(first + std::lround(part * double(65535 - first)))
                : std::uint16_t{0};
    }
    std::string unit;
    if (name == "height")
        unit = "m";
    else if (grid != scene.grids.end())
        unit = grid->second.unit;
    map.notes = {{"field", name},
                 {"unit", unit},
                 {"low", low},
                 {"high", high},
                 {"first", first},
                 {"unseen", unseen},
                 {"metres_per_pixel", raster.pixel},
                 {"width", raster.width},
                 {"height", raster.height},
                 {"corner", {raster.corner.x, raster.corner.y}},
                 {"up", "+y"},
                 {"value", "low + (high - low) * (grey - first) / (65535 - first)"}};
    return map;
}

}  // namespace sekitei::apps
