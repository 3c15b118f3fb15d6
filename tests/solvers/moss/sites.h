#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "core/random.h"
#include "grids/level_set.h"
#include "solvers/moss/landing.h"
#include "solvers/moss/population.h"

/// Surfaces to live on.
namespace sekitei::moss {

/// A rectangle of square sites, without any grid: what a mesh could be.
struct Sheet {
    int width, height;
    double spacing;
    std::vector<Vec3d> position;
    std::vector<Vec3f> normal;
    std::vector<float> area;
    std::vector<std::uint32_t> begin{0}, neighbour;

    Sheet(int w, int h, double dx = 0.03, Vec3f n = {0, 0, 1}) : width(w), height(h), spacing(dx)
    {
        for (int y = 0; y < h; ++y)
            for (int x = 0; x < w; ++x) {
                position.emplace_back((x + .5) * dx, (y + .5) * dx, 0.7);
                normal.push_back(n);
                area.push_back(static_cast<float>(dx * dx));
                for (int v = y - 1; v <= y + 1; ++v)
                    for (int u = x - 1; u <= x + 1; ++u)
                        if ((u != x || v != y) && u >= 0 && v >= 0 && u < w && v < h)
                            neighbour.push_back(static_cast<std::uint32_t>(u + w * v));
                begin.push_back(static_cast<std::uint32_t>(neighbour.size()));
            }
    }
    Surface surface() const { return {position, {}, normal, area, begin, neighbour, spacing}; }
    std::size_t size() const { return position.size(); }
    std::size_t site(int x, int y) const { return static_cast<std::size_t>(x + width * y); }
};

/// Straight down onto a sheet.
struct SheetLanding : Landing {
    const Sheet& sheet;
    explicit SheetLanding(const Sheet& s) : sheet(s) {}
    void land(std::span<const Flight> seeds, double adhesion,
              std::span<std::int32_t> site) const override
    {
        for (std::size_t i = 0; i < seeds.size(); ++i) {
            const int x = static_cast<int>(std::floor(seeds[i].at.x / sheet.spacing)),
                      y = static_cast<int>(std::floor(seeds[i].at.y / sheet.spacing));
            site[i] = seeds[i].at.z < 0.7 - adhesion || x < 0 || y < 0 || x >= sheet.width ||
                              y >= sheet.height
                          ? kLost
                          : x + sheet.width * y;
        }
    }
};

/// All seeds go to one site, or nowhere.
struct OneLanding : Landing {
    std::int32_t target = kLost;
    OneLanding() = default;
    explicit OneLanding(std::int32_t t) : target(t) {}
    void land(std::span<const Flight> seeds, double, std::span<std::int32_t> site) const override
    {
        std::fill_n(site.begin(), seeds.size(), target);
    }
};

/// A level set on a box, its cells and how seeds land on them.
struct Ground {
    Domain box;
    FloatGrid level_set;
    SurfaceCells cells;
    CellLanding landing;

    /// f in voxels
    Ground(Coord dims, const std::function<double(Vec3d)>& f, double voxel = 0.02)
        : box{dims, {{1.5, -2, 0.3}, voxel}},
          level_set(level_set_from_function(box, f, {}, {.steepness = 1, .is_distance = true})),
          cells(surface_cells(level_set, {}, box)),
          landing(level_set, cells)
    {
    }
    Surface surface() const { return surface_of(cells); }
};

inline const Species& kind(std::string_view name)
{
    for (const Species& s : preset_species())
        if (s.name == name) return s;
    throw std::out_of_range("no such species");
}

/// A slope with bumps and a ramp.
inline double bumpy(Vec3d p)
{
    return 0.7 * (p.z - 14.3 - 0.3 * p.x + 2.5 * std::sin(p.x * 0.4) * std::cos(p.y * 0.3) +
                  3 * std::clamp((p.y - 22.4) / 3, 0.0, 1.0));
}

}  // namespace sekitei::moss
