#include "grids/surface_cells.h"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "core/error.h"

namespace sekitei {
namespace {

constexpr std::array<Coord, 6> kFaces{
    {{-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}}};

std::string text(Coord c)
{
    return fmt::format("({}, {}, {})", c.x, c.y, c.z);
}

/// Calls f(leaf) for all leaves on all threads, with reports.
template <class F>
void over_leaves(std::size_t count, const Progress& progress, F&& f)
{
    constexpr std::size_t kBatch = 1 << 14;
    for (std::size_t begin = 0; begin < count; begin += kBatch) {
        const std::size_t size = std::min(kBatch, count - begin);
        parallel_for_range(size, [&](std::size_t b, std::size_t e) {
            progress.check();
            for (std::size_t i = b; i != e; ++i) f(begin + i);
        });
        progress.update(static_cast<double>(begin + size) / static_cast<double>(count));
    }
}

/// The values around one leaf, at offsets -8 .. 15 from its origin.
template <class T>
class Around {
public:
    Around(const LeafGrid<T>& grid, std::size_t leaf)
        : grid_(grid), leaves_(grid.topology()->neighbours()[leaf])
    {
    }
    T operator()(Coord c) const
    {
        const std::uint32_t leaf =
            leaves_[static_cast<std::size_t>(neighbour_index(c.x >> 3, c.y >> 3, c.z >> 3))];
        return leaf == kNoLeaf ? grid_.background() : grid_.at(leaf, leaf_offset(c));
    }
    /// Whether no voxel of the leaf or of the six beside it differs in sign from `value`.
    bool uniform(bool negative) const
    {
        for (const std::uint32_t leaf : {leaves_[13], leaves_[4], leaves_[22], leaves_[10],
                                         leaves_[16], leaves_[12], leaves_[14]}) {
            if (leaf != kNoLeaf && !grid_.is_constant(leaf)) return false;
            const T value = leaf == kNoLeaf ? grid_.background() : grid_.constant(leaf);
            if ((value < 0) != negative) return false;
        }
        return true;
    }

private:
    const LeafGrid<T>& grid_;
    const LeafTopology::Neighbours& leaves_;
};

struct Cell {
    Vec3f normal;
    float sdf;
};

/// Where a level set is looked at: everywhere, or in a box that cuts it.
class Surface {
public:
    Surface(const FloatGrid& grid, const std::optional<Domain>& box)
        : grid_(grid), voxel_(grid.transform().voxel), box_(box)
    {
    }

    bool inside(Coord c) const { return !box_ || box_->contains(c); }

    /// The cells of one leaf. `nan` is set to the offset of a value that is not a number.
    LeafMask cells(std::size_t leaf, int& nan) const
    {
        LeafMask mask;
        const Around<float> at(grid_, leaf);
        if (grid_.is_constant(leaf) && (!(grid_.constant(leaf) < 0) || at.uniform(true)))
            return mask;
        const Coord origin = grid_.origin(leaf);
        for (int o = 0; o < kLeafSize; ++o) {
            const float value = grid_.at(leaf, o);
            if (std::isnan(value)) nan = o;
            if (!(value < 0)) continue;
            const Coord c = leaf_coord({0, 0, 0}, o);
            if (!inside(origin + c)) continue;
            for (const Coord f : kFaces)
                if (inside(origin + c + f) && at(c + f) >= 0) {
                    mask.set(o);
                    break;
                }
        }
        return mask;
    }

    /// @param c  the cell, from the leaf's origin
    Cell cell(std::size_t leaf, Coord c) const
    {
        const Around<float> at(grid_, leaf);
        const Coord origin = grid_.origin(leaf);
        const float value = at(c);
        if (near_closed_cut(at, origin, c))
            for (const Coord f : kFaces) {
                if (!inside(origin + c + f) || !(at(c + f) >= 0)) continue;
                const Vec3d g = gradient(at, origin, c + f);
                const double slope = length(g);
                const double step = dot(g, Vec3d(f)) / slope * voxel_;
                // The plane through the air voxel, continued by one voxel.
                if (step > 0 && at(c + f) < step)
                    return {Vec3f(g / slope), static_cast<float>(at(c + f) - step)};
            }
        const Vec3d g = gradient(at, origin, c);
        const double slope = length(g);
        if (slope > 1e-3) return {Vec3f(g / slope), value};
        // The middle of a thin sheet: what the open faces agree on, else the highest of them.
        Vec3d sum, highest{0, 0, -2};
        for (const Coord f : kFaces)
            if (inside(origin + c + f) && at(c + f) >= 0) {
                sum += Vec3d(f);
                if (f.z > highest.z) highest = Vec3d(f);
            }
        return {Vec3f(dot(sum, sum) > 0 ? normalized(sum) : highest), value};
    }

    /// The steepest rise from the cell into the air.
    float rise(std::size_t leaf, Coord c) const
    {
        const Around<float> at(grid_, leaf);
        float most = 0;
        for (const Coord f : kFaces)
            if (inside(grid_.origin(leaf) + c + f)) most = std::max(most, at(c + f) - at(c));
        return most / static_cast<float>(voxel_);
    }

private:
    /// Central differences; one-sided at the box's walls.
    Vec3d gradient(const Around<float>& at, Coord origin, Coord c) const
    {
        Vec3d g;
        for (int axis = 0; axis < 3; ++axis) {
            Coord low = c, high = c;
            low[axis] -= 1;
            high[axis] += 1;
            if (!inside(origin + low)) low = c;
            if (!inside(origin + high)) high = c;
            const int span = high[axis] - low[axis];
            if (span) g[axis] = (double(at(high)) - double(at(low))) / (span * voxel_);
        }
        return g;
    }

    /// Whether within two voxels the box cuts the body and the level set is closed there.
    bool near_closed_cut(const Around<float>& at, Coord origin, Coord c) const
    {
        if (!box_) return false;
        for (const Coord f : kFaces)
            for (int k = 1; k <= 2; ++k) {
                const Coord beyond = c + f * k;
                if (inside(origin + beyond)) continue;
                if (at(beyond - f) < 0 && at(beyond) >= 0) return true;
                break;
            }
        return false;
    }

    const FloatGrid& grid_;
    double voxel_;
    const std::optional<Domain>& box_;
};

template <class T>
LeafGrid<T> grid_of(const SurfaceCells& cells, const std::vector<T>& values)
{
    if (values.size() != cells.size())
        throw InvalidInput(fmt::format("surface_cells: {} values, must be {}, one a cell",
                                       values.size(), cells.size()));
    LeafGrid<T> grid = LeafGrid<T>::uninitialised(cells.index.topology(), cells.transform, T{});
    parallel_for(grid.leaf_count(), [&](std::size_t leaf) {
        T* target = grid.values(leaf);
        std::fill_n(target, kLeafSize, T{});
        grid.mask(leaf) = cells.index.mask(leaf);
        grid.mask(leaf).for_each(
            [&](int o) { target[o] = values[static_cast<std::size_t>(cells.index.at(leaf, o))]; });
    });
    grid.compress();
    return grid;
}

template <class T>
std::vector<T> values_of(const SurfaceCells& cells, const LeafGrid<T>& grid, T missing)
{
    if (!(grid.transform() == cells.transform))
        throw InvalidInput(
            fmt::format("surface_cells: a grid with voxels of {} m at another place than the "
                        "cells' ({} m); must be on the same lattice",
                        grid.transform().voxel, cells.transform.voxel));
    std::vector<T> values(cells.size());
    parallel_for_range(
        cells.size(),
        [&](std::size_t begin, std::size_t end) {
            GridReader<T> reader(grid);
            for (std::size_t i = begin; i != end; ++i)
                values[i] = reader.active(cells.voxel[i]) ? reader.value(cells.voxel[i]) : missing;
        },
        4096);
    return values;
}

/// The surface graph: cells that share a face, an edge or a corner.
/// @param first  number of each leaf's first cell
void join_neighbours(SurfaceCells& cells, const std::vector<std::size_t>& first,
                     const Progress& progress)
{
    const std::size_t count = cells.size();
    cells.neighbour_begin.assign(count + 1, 0);
    for (const bool fill : {false, true}) {
        over_leaves(cells.index.leaf_count(), progress.slice(fill ? 0.5 : 0, fill ? 1 : 0.5),
                    [&](std::size_t k) {
                        const Around<std::int32_t> at(cells.index, k);
                        std::size_t i = first[k];
                        cells.index.mask(k).for_each([&](int o) {
                            const Coord c = leaf_coord({0, 0, 0}, o);
                            std::array<std::uint32_t, 26> found;
                            std::size_t size = 0;
                            for (int d = 0; d < 27; ++d) {
                                if (d == 13) continue;
                                const std::int32_t other =
                                    at(c + Coord(d / 9 - 1, d / 3 % 3 - 1, d % 3 - 1));
                                if (other >= 0) found[size++] = static_cast<std::uint32_t>(other);
                            }
                            if (fill) {
                                std::sort(found.begin(), found.begin() + size);
                                std::copy_n(found.begin(), size,
                                            cells.neighbour.begin() + cells.neighbour_begin[i]);
                            } else
                                cells.neighbour_begin[i + 1] = static_cast<std::uint32_t>(size);
                            ++i;
                        });
                    });
        if (fill) break;
        for (std::size_t i = 0; i < count; ++i)
            cells.neighbour_begin[i + 1] += cells.neighbour_begin[i];
        cells.neighbour.resize(cells.neighbour_begin[count]);
    }
}

}  // namespace

Vec3d SurfaceCells::ray_origin(std::size_t cell) const
{
    const Vec3d n(normal[cell]);
    return position[cell] + n * (0.25 * transform.voxel - double(sdf[cell]));
}

FloatGrid SurfaceCells::to_grid(const std::vector<float>& values) const
{
    return grid_of(*this, values);
}
IntGrid SurfaceCells::to_grid(const std::vector<std::int32_t>& values) const
{
    return grid_of(*this, values);
}
VectorGrid SurfaceCells::to_grid(const std::vector<Vec3f>& values) const
{
    return grid_of(*this, values);
}
std::vector<float> SurfaceCells::from_grid(const FloatGrid& grid, float missing) const
{
    return values_of(*this, grid, missing);
}
std::vector<std::int32_t> SurfaceCells::from_grid(const IntGrid& grid, std::int32_t missing) const
{
    return values_of(*this, grid, missing);
}

SurfaceCells surface_cells(const FloatGrid& surface, const Progress& progress,
                           const std::optional<Domain>& box)
{
    const double voxel = surface.transform().voxel;
    if (!(voxel > 0 && std::isfinite(voxel)))
        throw InvalidInput(fmt::format("surface_cells: voxel = {} m, must be > 0", voxel));
    if (!(surface.background() > 0 && std::isfinite(surface.background())))
        throw InvalidInput(fmt::format(
            "surface_cells: not a level set: background = {} m, must be > 0, the width of the band",
            surface.background()));
    if (box && !(box->transform == surface.transform()))
        throw InvalidInput(
            fmt::format("surface_cells: the box has voxels of {} m, the surface of {} m; both must "
                        "be on the same lattice",
                        box->transform.voxel, voxel));

    // Mark the cells of each leaf.
    const Surface body(surface, box);
    const std::size_t leaves = surface.leaf_count();
    std::vector<LeafMask> masks(leaves);
    std::vector<int> nan(leaves, -1);
    over_leaves(leaves, progress.slice(0, 0.4),
                [&](std::size_t leaf) { masks[leaf] = body.cells(leaf, nan[leaf]); });
    std::vector<Coord> origins;
    std::vector<std::size_t> source;
    for (std::size_t leaf = 0; leaf < leaves; ++leaf) {
        if (nan[leaf] >= 0)
            throw InvalidInput("surface_cells: not a level set: voxel " +
                               text(leaf_coord(surface.origin(leaf), nan[leaf])) +
                               " is not a number");
        if (masks[leaf].none()) continue;
        origins.push_back(surface.origin(leaf));
        source.push_back(leaf);
    }
    if (source.empty())
        throw InvalidInput("no_surface_cells: the level set has no voxel < 0 beside one >= 0" +
                           std::string(box ? " inside the box" : "") +
                           "; is it empty, solid throughout, or finer than its voxels?");

    // Number them by leaf and offset.
    SurfaceCells cells;
    cells.transform = surface.transform();
    cells.index = IntGrid::uninitialised(LeafTopology::build(origins), cells.transform, -1);
    std::vector<std::size_t> counts(source.size());
    for (std::size_t k = 0; k < source.size(); ++k)
        counts[k] = static_cast<std::size_t>(masks[source[k]].count());
    const std::vector<std::size_t> first = prefix_sum(counts);
    const std::size_t count = first.back();
    if (count > 0x7FFFFFFF)
        throw LimitExceeded(
            fmt::format("surface_cells: {} cells, must be at most 2147483647; use "
                        "larger voxels",
                        count));
    cells.voxel.resize(count);
    cells.position.resize(count);
    cells.normal.resize(count);
    cells.sdf.resize(count);
    cells.area.resize(count);
    std::vector<float> rise(count);
    over_leaves(source.size(), progress.slice(0.4, 0.7), [&](std::size_t k) {
        const std::size_t leaf = source[k];
        std::int32_t* number = cells.index.values(k);
        std::fill_n(number, kLeafSize, -1);
        cells.index.mask(k) = masks[leaf];
        std::size_t i = first[k];
        masks[leaf].for_each([&](int o) {
            const Coord local = leaf_coord({0, 0, 0}, o), c = surface.origin(leaf) + local;
            const Cell cell = body.cell(leaf, local);
            const Vec3f n = cell.normal;
            number[o] = static_cast<std::int32_t>(i);
            cells.voxel[i] = c;
            cells.position[i] = cells.transform.world(centre_of(c));
            cells.normal[i] = n;
            cells.sdf[i] = cell.sdf;
            cells.area[i] = static_cast<float>(
                voxel * voxel / double(std::max({std::abs(n.x), std::abs(n.y), std::abs(n.z)})));
            rise[i] = body.rise(leaf, local);
            ++i;
        });
    });

    // A distance falls by a voxel a voxel: temperatures, densities and other units do not.
    const double n = static_cast<double>(count);
    const double mean = parallel_sum(count, [&](std::size_t i) { return double(rise[i]); }) / n;
    const double deep = parallel_sum(
        count, [&](std::size_t i) { return double(cells.sdf[i]) < -1.75 * voxel ? 1.0 : 0.0; });
    if (!(mean > 0.25 && mean < 4) || deep > 0.1 * n)
        throw InvalidInput(fmt::format(
            "surface_cells: not a level set: from cell to air it rises by {:.3g} m a metre on "
            "average, must be about 1, and {:.0f} of {} cells lie deeper than 1.75 voxels; if a "
            "box cuts the body, give its box",
            mean, deep, count));
    for (float& depth : cells.sdf) depth = std::max(depth, -static_cast<float>(voxel));

    join_neighbours(cells, first, progress.slice(0.7, 1));
    return cells;
}

SurfaceCells surface_cells(const FloatGrid& surface, const VectorGrid& normal,
                           const FloatGrid& area, const Progress& progress)
{
    if (!(surface.transform() == area.transform() && normal.transform() == area.transform()))
        throw InvalidInput("surface_cells: surface, normals and areas must be on the same lattice");
    SurfaceCells cells;
    cells.transform = area.transform();
    cells.index = IntGrid::uninitialised(area.topology(), cells.transform, -1);
    std::vector<std::size_t> counts(area.leaf_count());
    for (std::size_t k = 0; k < counts.size(); ++k)
        counts[k] = static_cast<std::size_t>(area.mask(k).count());
    const std::vector<std::size_t> first = prefix_sum(counts);
    const std::size_t count = first.back();
    if (count == 0) throw InvalidInput("no_surface_cells: the grid of areas has no active voxel");
    cells.voxel.resize(count);
    cells.position.resize(count);
    cells.normal.resize(count);
    cells.sdf.resize(count);
    cells.area.resize(count);
    over_leaves(counts.size(), progress.slice(0, 0.5), [&](std::size_t k) {
        std::int32_t* number = cells.index.values(k);
        std::fill_n(number, kLeafSize, -1);
        cells.index.mask(k) = area.mask(k);
        GridReader<float> depth(surface);
        GridReader<Vec3f> facing(normal);
        std::size_t i = first[k];
        area.mask(k).for_each([&](int o) {
            const Coord c = leaf_coord(area.origin(k), o);
            number[o] = static_cast<std::int32_t>(i);
            cells.voxel[i] = c;
            cells.position[i] = cells.transform.world(centre_of(c));
            cells.normal[i] = facing.value(c);
            cells.sdf[i] = std::max(depth.value(c), -static_cast<float>(cells.transform.voxel));
            cells.area[i] = area.at(k, o);
            if (!(cells.area[i] > 0) || !(std::abs(length(cells.normal[i]) - 1) < 1e-3))
                throw InvalidInput(
                    fmt::format("surface_cells: voxel {} has the area {:.3g} m^2 and a normal of "
                                "length {:.3g}; must be > 0 and 1",
                                text(c), cells.area[i], length(cells.normal[i])));
            ++i;
        });
    });
    join_neighbours(cells, first, progress.slice(0.5, 1));
    return cells;
}

}  // namespace sekitei
