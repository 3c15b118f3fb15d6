#include "solvers/forest/canopy.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/inline_math.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::forest {
namespace {

constexpr double kLowestSun = 0.05;  // sine of its height: shadows of 20 times what casts them

int floor_div(int a)
{
    return a >> 3;  // of leaves, also below 0
}

/// The ground of each pixel in whole voxels.
class Ground {
public:
    Ground(const Land& land, int nx, int ny) : land_(land), nx_(nx), ny_(ny) {}
    /// Outside the domain that of the nearest pixel.
    int operator()(int i, int j) const
    {
        if (land_.flat()) return 0;
        return int(std::lround(land_.height(std::clamp(i, 0, nx_ - 1), std::clamp(j, 0, ny_ - 1)) /
                               kPixel));
    }

private:
    static constexpr double kPixel = 1;
    const Land& land_;
    int nx_, ny_;
};

/// Leaves by columns of 8 x 8 pixels: those of a column lie one upon another.
class Columns {
public:
    struct Column {
        std::uint32_t first = kNoLeaf;
        int low = 0, count = 0;  ///< in leaves
    };

    Columns(TopologyPtr topology, int nx, int ny)
        : topology_(std::move(topology)),
          across_((nx + 7) / 8),
          list_(std::size_t(across_) * std::size_t((ny + 7) / 8))
    {
        for (std::uint32_t leaf = 0; leaf < topology_->size(); ++leaf) {
            const Coord o = topology_->origin(leaf);
            Column& column = list_[place(floor_div(o.x), floor_div(o.y))];
            if (column.count++ == 0) {
                column.first = leaf;
                column.low = floor_div(o.z);
                filled_.push_back(place(floor_div(o.x), floor_div(o.y)));
            }
            top_ = std::max(top_, o.z + kLeafEdge);
        }
    }

    const TopologyPtr& topology() const { return topology_; }
    int top() const { return top_; }  ///< above all leaves, in voxels
    /// Places of columns that have leaves.
    const std::vector<std::size_t>& filled() const { return filled_; }
    const Column& column(std::size_t place) const { return list_[place]; }
    Coord corner(std::size_t place) const
    {
        return {8 * int(place % std::size_t(across_)), 8 * int(place / std::size_t(across_)), 0};
    }
    std::uint32_t leaf(int i, int j, int z) const
    {
        const Column& c = list_[place(i >> 3, j >> 3)];
        const int k = floor_div(z) - c.low;
        return k < 0 || k >= c.count ? kNoLeaf : c.first + std::uint32_t(k);
    }

private:
    std::size_t place(int ci, int cj) const
    {
        return std::size_t(cj) * std::size_t(across_) + std::size_t(ci);
    }
    TopologyPtr topology_;
    int across_;
    std::vector<Column> list_;
    std::vector<std::size_t> filled_;
    int top_ = std::numeric_limits<int>::min();
};

/// Leaves from the ground to the uppermost slice that any tree owns.
Columns columns_of(const Forest& forest, const Ground& ground, const Progress& progress)
{
    const int nx = forest.inputs().pixels_x(), ny = forest.inputs().pixels_y();
    const int across = (nx + 7) / 8;
    struct Span {
        int low = std::numeric_limits<int>::max(), high = std::numeric_limits<int>::min();
        void add(int l, int h) { low = std::min(low, l), high = std::max(high, h); }
    };
    // Tiles may share a column.
    std::vector<std::vector<Span>> found(std::size_t(forest.tiles()));
    parallel_for(found.size(), [&](std::size_t tile) {
        progress.check();
        const auto box = forest.tile_bounds(int(tile));
        const int i0 = box[0], i1 = box[1], j0 = box[2], j1 = box[3];
        const int c0 = i0 >> 3, wide = ((i1 + 7) >> 3) - c0, r0 = j0 >> 3;
        std::vector<Span>& spans = found[tile];
        spans.resize(std::size_t(wide) * std::size_t(((j1 + 7) >> 3) - r0));
        forest.visit_owned(int(tile), [&](const Tree&, int i, int j, std::uint64_t slices) {
            if (!slices) return;
            const int g = ground(i, j);
            spans[std::size_t((j >> 3) - r0) * std::size_t(wide) + std::size_t((i >> 3) - c0)].add(
                floor_div(g + 1), floor_div(g + int(std::bit_width(slices))));
        });
    });
    std::vector<Span> all(std::size_t(across) * std::size_t((ny + 7) / 8));
    for (std::size_t tile = 0; tile < found.size(); ++tile) {
        const auto box = forest.tile_bounds(int(tile));
        const int i0 = box[0], i1 = box[1], j0 = box[2], j1 = box[3];
        std::size_t k = 0;
        for (int cj = j0 >> 3; cj < (j1 + 7) >> 3; ++cj)
            for (int ci = i0 >> 3; ci < (i1 + 7) >> 3; ++ci, ++k)
                if (const Span& s = found[tile][k]; s.low <= s.high)
                    all[std::size_t(cj) * std::size_t(across) + std::size_t(ci)].add(s.low, s.high);
    }
    std::vector<Coord> origins;
    for (std::size_t place = 0; place < all.size(); ++place)
        for (int z = all[place].low; z <= all[place].high; ++z)
            origins.push_back(
                Coord(int(place % std::size_t(across)), int(place / std::size_t(across)), z) *
                kLeafEdge);
    return {LeafTopology::build(std::move(origins)), nx, ny};
}

/// The bottom layer alone of columns that have leaves.
TopologyPtr layer_of(const Columns& columns)
{
    std::vector<Coord> origins;
    for (const std::size_t place : columns.filled()) origins.push_back(columns.corner(place));
    return LeafTopology::build(std::move(origins));
}

template <class T>
LeafGrid<T> filled_grid(TopologyPtr topology, Transform transform, T value)
{
    auto grid = LeafGrid<T>::uninitialised(std::move(topology), transform, value);
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t leaf) { std::fill_n(grid.values(leaf), kLeafSize, value); }, 16);
    return grid;
}

/// Active where a value is not the background; then as small as can be.
template <class T>
void activate(LeafGrid<T>& grid)
{
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t leaf) {
            const T* v = grid.values(leaf);
            for (int o = 0; o < kLeafSize; ++o)
                if (v[o] != grid.background()) grid.mask(leaf).set(o);
        },
        16);
    grid.compress();
}

/// What visits of one tile need to know of the tree at hand.
struct Crown {
    float density = 0;       ///< [1/m]
    std::uint64_t mask = 0;  ///< slices that bear leaves
    std::int32_t rank = 0;
};

std::vector<std::pair<std::uint64_t, std::int32_t>> ranks_of(const Forest& forest)
{
    std::vector<std::pair<std::uint64_t, std::int32_t>> list;
    list.reserve(forest.size());
    std::int32_t rank = 0;
    for (const Tree& tree : forest.ranked()) list.emplace_back(tree.uid, ++rank);
    std::sort(list.begin(), list.end());
    return list;
}

Crown crown_of(const Forest& forest, const Tree& tree)
{
    const Species& species = forest.inputs().species[tree.species];
    const std::vector<std::uint32_t> own = forest.footprint(tree);
    std::size_t top = own.size();
    while (top > 0 && own[top - 1] == 0) --top;
    // The uppermost slice at least: a tree with leaves only at its tip ends between two.
    const double base = std::ceil(species.crown_base * tree.height - 1e-9);
    const std::size_t from =
        std::clamp<std::size_t>(std::size_t(base), 1, std::max<std::size_t>(1, top));
    std::uint64_t voxels = 0;
    for (std::size_t k = from; k <= top; ++k) voxels += own[k - 1];
    Crown crown;
    if (voxels == 0) return crown;
    const double radius = slope_of(species, forest.inputs().params.spread_mode) * tree.height;
    crown.density = static_cast<float>(species.leaf_area_index * math::kPi * radius * radius /
                                       static_cast<double>(voxels));
    crown.mask = ~0ull << (from - 1);
    return crown;
}

/// Leaf area densities, owners and heights, by two visits of every tile: what is where is known
/// before anything is allocated.
void put_trees(Canopy& canopy, const Forest& forest, const Ground& ground, const Columns& columns,
               bool occupancy, const std::function<bool(const Tree&)>& leafless,
               const Progress& progress)
{
    const auto ranks = occupancy ? ranks_of(forest) : decltype(ranks_of(forest)){};
    const TopologyPtr layer = canopy.height.topology();
    parallel_for(std::size_t(forest.tiles()), [&](std::size_t tile) {
        progress.check();
        const auto box = forest.tile_bounds(int(tile));
        const int i0 = box[0], i1 = box[1], j0 = box[2], j1 = box[3];
        std::vector<std::uint8_t> top(std::size_t(i1 - i0) * std::size_t(j1 - j0));
        Crown crown;
        std::uint64_t last = 0;
        bool first = true;
        forest.visit_owned(int(tile), [&](const Tree& tree, int i, int j, std::uint64_t slices) {
            if (!slices) return;
            if (first || tree.uid != last) {
                progress.check();
                crown = leafless && leafless(tree) ? Crown{} : crown_of(forest, tree);
                if (occupancy)
                    crown.rank = std::lower_bound(ranks.begin(), ranks.end(),
                                                  std::pair(tree.uid, std::int32_t(0)))
                                     ->second;
                first = false;
                last = tree.uid;
            }
            const int g = ground(i, j), across = leaf_offset({i, j, 0});
            for (std::uint64_t bits = slices; bits; bits &= bits - 1) {
                const int k = std::countr_zero(bits), z = g + 1 + k;
                const std::uint32_t leaf = columns.leaf(i, j, z);
                if ((crown.mask >> k) & 1)
                    canopy.leaf_area_density.values(leaf)[across | (z & 7)] = crown.density;
                if (occupancy) canopy.owner.values(leaf)[across | (z & 7)] = crown.rank;
            }
            std::uint8_t& highest =
                top[std::size_t(j - j0) * std::size_t(i1 - i0) + std::size_t(i - i0)];
            if (const auto k = static_cast<std::uint8_t>(std::bit_width(slices)); k > highest) {
                highest = k;
                canopy.height.values(layer->find(leaf_origin({i, j, 0})))[across] =
                    static_cast<float>(tree.height);
            }
        });
    });
}

/// The lowest ground of a column of 8 x 8 pixels.
int lowest_ground(const std::function<int(int, int)>& ground, int ci, int cj)
{
    int low = std::numeric_limits<int>::max();
    for (int j = 8 * cj; j < 8 * cj + 8; ++j)
        for (int i = 8 * ci; i < 8 * ci + 8; ++i) low = std::min(low, ground(i, j));
    return low;
}

/// The leaf area along rays towards the sun, in cubes of one voxel.
class SunRay {
public:
    SunRay(const FloatGrid& lad, const Columns& columns, Vec3d to_sun, int nx, int ny, bool wrap,
           double extinction)
        : lad_(lad),
          columns_(columns),
          sun_(to_sun),
          size_(nx, ny, 0),
          wrap_(wrap),
          extinction_(extinction)
    {
    }

    double transmittance(Vec3d p) const
    {
        constexpr double kOpaque = 60;
        Coord c(int(std::floor(p.x)), int(std::floor(p.y)), int(std::floor(p.z)));
        // Distances along the ray to the next face on each axis, and from face to face.
        Vec3d next, step;
        Coord way;
        for (int a = 0; a < 3; ++a) {
            way[a] = sun_[a] > 0 ? 1 : -1;
            step[a] = sun_[a] != 0 ? 1 / std::abs(sun_[a]) : INFINITY;
            const double left = sun_[a] > 0 ? c[a] + 1 - p[a] : p[a] - c[a];
            next[a] = sun_[a] != 0 ? left * step[a] : INFINITY;
        }
        double depth = 0, at = 0;
        while (c.z < columns_.top()) {
            const int axis = next.x <= next.y && next.x <= next.z ? 0 : next.y <= next.z ? 1 : 2;
            const std::uint32_t leaf = columns_.leaf(c.x, c.y, c.z);
            if (leaf != kNoLeaf)
                depth += double(lad_.values(leaf)[leaf_offset(c)]) * (next[axis] - at);
            if (extinction_ * depth > kOpaque) return 0;
            at = next[axis];
            next[axis] += step[axis];
            c[axis] += way[axis];
            if (axis < 2 && (c[axis] < 0 || c[axis] >= size_[axis])) {
                if (!wrap_) break;
                c[axis] = c[axis] < 0 ? size_[axis] - 1 : 0;
            }
        }
        return math::inline_exp(-extinction_ * depth);
    }

private:
    const FloatGrid& lad_;
    const Columns& columns_;
    Vec3d sun_;
    Coord size_;
    bool wrap_;
    double extinction_;
};

/// All leaves of voxels above the ground that a shadow may reach, besides those of `columns`.
TopologyPtr shadowed(const FloatGrid& lad, const Columns& columns, const Ground& ground, int nx,
                     int ny, Vec3d sun, bool wrap)
{
    const int across = (nx + 7) / 8, deep = (ny + 7) / 8;
    std::vector<int> low(std::size_t(across) * std::size_t(deep));
    parallel_for(low.size(), [&](std::size_t place) {
        low[place] = floor_div(lowest_ground(ground, int(place) % across, int(place) / across) + 1);
    });
    const int lowest = *std::min_element(low.begin(), low.end()), highest = columns.top() / 8;
    std::vector<std::uint8_t> marked(low.size() * std::size_t(std::max(0, highest - lowest)));
    auto mark = [&](std::size_t place, int level) {
        if (level >= low[place]) marked[std::size_t(level - lowest) * low.size() + place] = 1;
    };
    for (std::uint32_t leaf = 0; leaf < lad.leaf_count(); ++leaf) {
        const Coord o = lad.origin(leaf);
        if (std::all_of(lad.values(leaf), lad.values(leaf) + kLeafSize,
                        [](float v) { return v == 0; }))
            continue;
        for (int level = floor_div(o.z); level >= lowest; --level) {
            // From a voxel of that level up to one of this leaf.
            const double rise0 = std::max(0, o.z - 8 * level - 8), rise1 = o.z + 8 - 8 * level;
            int from[2], to[2];
            for (int a = 0; a < 2; ++a) {
                const double near = rise0 * sun[a] / sun.z, far = rise1 * sun[a] / sun.z;
                from[a] = int(std::floor((o[a] - std::max(near, far)) / 8));
                to[a] = int(std::floor((o[a] + 8 - std::min(near, far)) / 8));
            }
            // In a domain that repeats, once is enough; the last leaf there may be a part of one.
            const int sizes[2] = {across, deep};
            for (int a = 0; a < 2; ++a) {
                if (wrap)
                    from[a] -= 1, to[a] += 1;
                else
                    from[a] = std::max(from[a], 0), to[a] = std::min(to[a], sizes[a] - 1);
                if (to[a] - from[a] >= sizes[a]) from[a] = 0, to[a] = sizes[a] - 1;
            }
            for (int cj = from[1]; cj <= to[1]; ++cj)
                for (int ci = from[0]; ci <= to[0]; ++ci)
                    mark(std::size_t((cj % deep + deep) % deep) * std::size_t(across) +
                             std::size_t((ci % across + across) % across),
                         level);
        }
    }
    std::vector<Coord> origins = columns.topology()->origins();
    for (std::size_t place = 0; place < low.size(); ++place) {
        // Without gaps.
        int bottom = highest, top = lowest - 1;
        for (int level = lowest; level < highest; ++level)
            if (marked[std::size_t(level - lowest) * low.size() + place])
                bottom = std::min(bottom, level), top = level;
        const Columns::Column& has = columns.column(place);
        if (has.count > 0 && top >= bottom) {
            bottom = std::min(bottom, has.low);
            top = std::max(top, has.low + has.count - 1);
        }
        for (int level = bottom; level <= top; ++level)
            origins.push_back(Coord(int(place) % across, int(place) / across, level) * kLeafEdge);
    }
    return LeafTopology::build(std::move(origins));
}

/// Light from one side. `lit` are the columns of the transmittance.
void shade_from_sun(Canopy& canopy, const SunRay& ray, const Columns& lit, const Ground& ground,
                    int nx, int ny, const Progress& progress)
{
    FloatGrid &through = canopy.transmittance, &bottom = canopy.ground_transmittance;
    parallel_for(lit.filled().size(), [&](std::size_t n) {
        progress.check();
        const std::size_t place = lit.filled()[n];
        const Columns::Column& column = lit.column(place);
        const Coord at = lit.corner(place);
        float* level = bottom.values(bottom.topology()->find(at));
        for (int i = at.x; i < std::min(at.x + 8, nx); ++i)
            for (int j = at.y; j < std::min(at.y + 8, ny); ++j) {
                const int low = ground(i, j) + 1, across = leaf_offset({i, j, 0});
                for (int z = 8 * (column.low + column.count) - 1;
                     z >= std::max(low, 8 * column.low); --z)
                    through.values(column.first +
                                   std::size_t(floor_div(z) - column.low))[across | (z & 7)] =
                        static_cast<float>(ray.transmittance(centre_of({i, j, z})));
                level[across] =
                    static_cast<float>(ray.transmittance({i + 0.5, j + 0.5, double(low)}));
            }
    });
}

FloatGrid terrain_of(const Land& land, int nx, int ny, const Transform& transform)
{
    const auto level = static_cast<float>(transform.origin.z);
    if (land.flat()) return {LeafTopology::build({}), transform, level};
    auto grid = FloatGrid::uninitialised(box_topology({0, 0, 0}, {nx, ny, 1}), transform, level);
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t leaf) {
            const Coord o = grid.origin(leaf);
            std::fill_n(grid.values(leaf), kLeafSize, level);
            for (int i = o.x; i < std::min(o.x + 8, nx); ++i)
                for (int j = o.y; j < std::min(o.y + 8, ny); ++j) {
                    grid.values(leaf)[leaf_offset({i, j, 0})] =
                        static_cast<float>(transform.origin.z + land.height(i, j));
                    grid.mask(leaf).set(leaf_offset({i, j, 0}));
                }
        },
        16);
    return grid;
}

FloatGrid density_of(const Forest& forest, int nx, int ny, const Transform& transform)
{
    constexpr std::uint16_t kFull = 65535;
    const std::vector<DensityMap>& maps = forest.density();
    const int bands = int(maps.size());
    // All pixels of all bands are active, also where nothing was painted: who reads it back as maps
    // counts layers.
    auto grid =
        filled_grid<float>(box_topology({0, 0, 0}, {nx, ny, std::max(1, bands)}), transform, 1);
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t leaf) {
            const Coord o = grid.origin(leaf);
            for (int i = o.x; i < std::min(o.x + 8, nx); ++i)
                for (int j = o.y; j < std::min(o.y + 8, ny); ++j)
                    for (int b = o.z; b < std::min(o.z + 8, bands); ++b) {
                        const int offset = leaf_offset({i, j, b});
                        const DensityMap& map = maps[std::size_t(b)];
                        grid.values(leaf)[offset] =
                            map.empty() ? 1
                                        : static_cast<float>(double(map.at(i, j)) / double(kFull));
                        grid.mask(leaf).set(offset);
                    }
        },
        16);
    grid.compress();
    return grid;
}

}  // namespace

void validate(const CanopyParams& params)
{
    validate_described("forest", params);
    if (!params.sun) return;
    const Vec3d s = *params.sun;
    const double across = length(s);
    if (!(std::isfinite(across) && across > 0 && s.z >= kLowestSun * across))
        throw InvalidParameter(fmt::format(
            "forest: sun = {:.6g},{:.6g},{:.6g}, must point upwards, at least 3 degrees "
            "over the horizon",
            s.x, s.y, s.z));
}

Canopy canopy(const Forest& forest, const CanopyParams& params, Vec3d corner,
              const std::function<bool(const Tree&)>& leafless, const Progress& progress)
{
    validate(params);
    const Inputs& inputs = forest.inputs();
    const double pixel = inputs.params.pixel;
    if (pixel != 1)
        throw InvalidParameter(fmt::format(
            "forest: pixel = {:.6g} m, must be 1 m for the fields of its leaves: their voxels are "
            "cubes, and slices are 1 m apart",
            pixel));
    const int nx = inputs.pixels_x(), ny = inputs.pixels_y();
    const Ground ground(inputs.land, nx, ny);
    const Columns columns = columns_of(forest, ground, progress.slice(0, 0.2));
    progress.update(0.2);

    const Transform volume{corner - Vec3d(0, 0, pixel), pixel}, layer{corner, pixel};
    Canopy canopy;
    canopy.leaf_area_density = filled_grid<float>(columns.topology(), volume, 0);
    if (params.occupancy) canopy.owner = filled_grid<std::int32_t>(columns.topology(), volume, 0);
    canopy.height = filled_grid<float>(layer_of(columns), layer, 0);
    put_trees(canopy, forest, ground, columns, params.occupancy, leafless,
              progress.slice(0.2, 0.5));
    progress.update(0.5);

    const bool from_above =
        !params.sun || (params.sun->x == 0 && params.sun->y == 0) || columns.filled().empty();
    if (from_above) {
        Shade shade = shade_of(canopy.leaf_area_density, ground, params.extinction);
        canopy.transmittance = std::move(shade.transmittance);
        canopy.ground_transmittance = std::move(shade.ground_transmittance);
    } else {
        const Vec3d sun = normalized(*params.sun);
        const bool wrap = inputs.params.border == Border::Wrap;
        const Columns lit(shadowed(canopy.leaf_area_density, columns, ground, nx, ny, sun, wrap),
                          nx, ny);
        canopy.transmittance = filled_grid<float>(lit.topology(), volume, 1);
        canopy.ground_transmittance = filled_grid<float>(layer_of(lit), layer, 1);
        shade_from_sun(canopy,
                       {canopy.leaf_area_density, columns, sun, nx, ny, wrap, params.extinction},
                       lit, ground, nx, ny, progress.slice(0.5, 0.8));
        activate(canopy.transmittance);
        activate(canopy.ground_transmittance);
    }
    progress.update(0.8);

    activate(canopy.leaf_area_density);
    canopy.drag = canopy.leaf_area_density;
    std::vector<double> area(canopy.drag.leaf_count());
    parallel_for(
        area.size(),
        [&](std::size_t leaf) {
            float* v = canopy.drag.values(leaf);
            if (!v) {  // all of it one tree's, or empty
                const double lad = double(canopy.drag.constant(leaf));
                area[leaf] = lad * kLeafSize;
                canopy.drag.set_constant(leaf, static_cast<float>(params.drag * lad));
                return;
            }
            for (int o = 0; o < kLeafSize; ++o) {
                area[leaf] += double(v[o]);
                v[o] = static_cast<float>(params.drag * double(v[o]));
            }
        },
        16);
    for (const double a : area) canopy.leaf_area += a;
    activate(canopy.height);
    canopy.terrain = terrain_of(inputs.land, nx, ny, layer);
    if (params.occupancy) {
        activate(canopy.owner);
        canopy.density = density_of(forest, nx, ny, layer);
    }
    progress.update(1);
    return canopy;
}

Shade shade_of(const FloatGrid& leaf_area_density, const std::function<int(int i, int j)>& ground,
               double extinction)
{
    // Leaves that lie one upon another, and what is between them and the ground.
    struct Stack {
        Coord corner;
        int low, high;
        std::size_t first = 0;
    };
    std::vector<Stack> stacks;
    for (const Coord o : leaf_area_density.topology()->origins()) {
        const int z = floor_div(o.z);
        if (stacks.empty() || stacks.back().corner != Coord(o.x, o.y, 0))
            stacks.push_back({{o.x, o.y, 0}, z, z});
        stacks.back().high = z;
    }
    parallel_for(stacks.size(), [&](std::size_t k) {
        Stack& s = stacks[k];
        s.low = std::min(
            s.low,
            floor_div(lowest_ground(ground, floor_div(s.corner.x), floor_div(s.corner.y)) + 1));
    });
    std::vector<Coord> origins, layer;
    for (Stack& s : stacks) {
        s.first = origins.size();  // in their order already
        for (int z = s.low; z <= s.high; ++z) origins.push_back(s.corner + Coord(0, 0, 8 * z));
        layer.push_back(s.corner);
    }
    const Transform volume = leaf_area_density.transform(),
                    at_ground{volume.origin + Vec3d(0, 0, volume.voxel), volume.voxel};
    Shade shade{filled_grid<float>(LeafTopology::build(std::move(origins)), volume, 1),
                filled_grid<float>(LeafTopology::build(std::move(layer)), at_ground, 1)};
    parallel_for(
        stacks.size(),
        [&](std::size_t k) {
            const Stack& s = stacks[k];
            std::vector<std::uint32_t> leaves;
            for (int z = s.low; z <= s.high; ++z)
                leaves.push_back(leaf_area_density.topology()->find(s.corner + Coord(0, 0, 8 * z)));
            float* level = shade.ground_transmittance.values(k);
            for (int column = 0; column < 64; ++column) {
                const int across = column << 3;
                const int low = ground(s.corner.x + (column >> 3), s.corner.y + (column & 7)) + 1;
                double depth = 0;
                float below = 1;  // a voxel without leaves is as bright as its lower neighbour
                for (int z = 8 * s.high + 7; z >= low; --z) {
                    const auto n = static_cast<std::size_t>(floor_div(z) - s.low);
                    const double lad = leaves[n] == kNoLeaf
                                           ? 0
                                           : volume.voxel * double(leaf_area_density.at(
                                                                leaves[n], across | (z & 7)));
                    float here = below;
                    if (lad > 0) {
                        here =
                            static_cast<float>(math::inline_exp(-extinction * (depth + lad / 2)));
                        depth += lad;
                        below = static_cast<float>(math::inline_exp(-extinction * depth));
                    }
                    shade.transmittance.values(s.first + n)[across | (z & 7)] = here;
                }
                level[across] = below;
            }
        },
        4);
    activate(shade.transmittance);
    activate(shade.ground_transmittance);
    return shade;
}

FloatGrid with_leaves(const FloatGrid& leaf_area_density, const FloatGrid& more)
{
    const Transform coarse = leaf_area_density.transform(), fine = more.transform();
    const double ratio = fine.voxel / coarse.voxel;
    // The lower corner of a voxel of `more`, in voxels of the first.
    auto corner = [&](Coord c) { return coarse.voxels(fine.world(Vec3d(c))); };
    auto floor_of = [](Vec3d p) {
        return Coord(int(std::floor(p.x)), int(std::floor(p.y)), int(std::floor(p.z)));
    };
    std::vector<Coord> touched;
    for (std::size_t leaf = 0; leaf < more.leaf_count(); ++leaf) {
        if (more.mask(leaf).none()) continue;
        const Vec3d from = corner(more.origin(leaf));
        const Coord a = leaf_origin(floor_of(from)),
                    b = leaf_origin(floor_of(from + Vec3d(kLeafEdge * ratio)));
        for (int x = a.x; x <= b.x; x += kLeafEdge)
            for (int y = a.y; y <= b.y; y += kLeafEdge)
                for (int z = a.z; z <= b.z; z += kLeafEdge) touched.emplace_back(x, y, z);
    }
    const TopologyPtr added = LeafTopology::build(touched);
    touched.insert(touched.end(), leaf_area_density.topology()->origins().begin(),
                   leaf_area_density.topology()->origins().end());
    std::vector<double> sum(added->size() * kLeafSize);
    for (std::size_t leaf = 0; leaf < more.leaf_count(); ++leaf)
        more.mask(leaf).for_each([&](int o) {
            const Vec3d from = corner(leaf_coord(more.origin(leaf), o)), to = from + Vec3d(ratio);
            const Coord a = floor_of(from), b = floor_of(to);
            const double density = double(more.at(leaf, o));
            auto share = [&](int axis, int at) {
                return std::max(0.0,
                                std::min(to[axis], at + 1.0) - std::max(from[axis], double(at)));
            };
            for (int x = a.x; x <= b.x; ++x)
                for (int y = a.y; y <= b.y; ++y)
                    for (int z = a.z; z <= b.z; ++z) {
                        const double part = share(0, x) * share(1, y) * share(2, z);
                        if (part > 0)
                            sum[std::size_t(added->find(leaf_origin({x, y, z}))) * kLeafSize +
                                std::size_t(leaf_offset({x, y, z}))] += part * density;
                    }
        });
    auto grid = filled_grid<float>(LeafTopology::build(std::move(touched)), coarse, 0);
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t leaf) {
            const std::uint32_t first = leaf_area_density.topology()->find(grid.origin(leaf)),
                                second = added->find(grid.origin(leaf));
            for (int o = 0; o < kLeafSize; ++o) {
                const double own = first == kNoLeaf ? 0 : double(leaf_area_density.at(first, o));
                const double other =
                    second == kNoLeaf ? 0 : sum[std::size_t(second) * kLeafSize + std::size_t(o)];
                grid.values(leaf)[o] = static_cast<float>(own + other);
            }
        },
        16);
    activate(grid);
    return grid;
}

double canopy_memory(const Inputs& inputs, const CanopyParams& params)
{
    constexpr double kLeaf = 4 * kLeafSize + 100;
    const double columns =
        std::ceil(double(inputs.pixels_x()) / 8) * std::ceil(double(inputs.pixels_y()) / 8);
    // Slices begin at index 1; a column on a slope may meet one leaf more.
    const double leaves = std::floor(double(inputs.params.slices) / 8) + 1 + !inputs.land.flat();
    const double grids = params.occupancy ? 4 : 3, layers = 3 + params.occupancy;
    return columns * kLeaf * (leaves * grids + layers);
}

}  // namespace sekitei::forest
