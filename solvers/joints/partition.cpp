#include <algorithm>
#include <array>
#include <cmath>

#include "core/error.h"
#include "core/parallel.h"
#include "grids/nearest_polyline.h"
#include "solvers/joints/joints.h"

/// Which column each voxel of lava belongs to.
namespace sekitei::joints {
namespace {

constexpr std::int32_t kLava = 0;  // id in the `region` grid
constexpr std::int32_t kNoColumn = -1;
constexpr int kNodeEdge = 32, kMiddleEdge = 16;

/// The lowest voxel of the cube of this edge (a power of two) that holds c.
Coord cube_origin(Coord c, int edge)
{
    return {c.x & ~(edge - 1), c.y & ~(edge - 1), c.z & ~(edge - 1)};
}

/// Centre of a cube, and the half width of the cube of its voxel centres.
Vec3d cube_centre(Coord origin, int edge)
{
    return Vec3d(origin) + Vec3d(edge * 0.5);
}
double cube_half(int edge)
{
    return (edge - 1) * 0.5;
}

LeafMask lava_of(const IntGrid& region, std::size_t leaf)
{
    if (region.is_constant(leaf))
        return region.constant(leaf) == kLava ? region.mask(leaf) : LeafMask{};
    LeafMask lava;
    const std::int32_t* id = region.values(leaf);
    region.mask(leaf).for_each([&](int offset) {
        if (id[offset] == kLava) lava.set(offset);
    });
    return lava;
}

/// What one thread reuses from node to node.
struct Scratch {
    PolylineIndex::Candidates node, middle, leaf;
    std::array<std::int32_t, kLeafSize> line;
    std::array<double, kLeafSize> along;
};

}  // namespace

void partition(const IntGrid& region, const Polylines& lines, double voxel, IntGrid& column,
               FloatGrid* arc, const Progress& progress)
{
    if (lines.count() == 0)
        throw InvalidInput("joints: 0 centre lines, must be at least 1 to make columns");

    // Leaves with lava, in leaf order.
    std::vector<LeafMask> masks(region.leaf_count());
    parallel_for(
        masks.size(), [&](std::size_t i) { masks[i] = lava_of(region, i); }, 64);
    std::vector<Coord> origins;
    for (std::size_t i = 0; i < masks.size(); ++i) {
        if (masks[i].none()) continue;
        masks[origins.size()] = masks[i];
        origins.push_back(region.origin(i));
    }
    const std::size_t leaves = origins.size();
    const TopologyPtr topology =
        leaves == region.leaf_count() ? region.topology() : LeafTopology::build(std::move(origins));

    // Leaves by the 32^3 cube that holds them, then by the 16^3 cube.
    std::vector<std::uint32_t> order(leaves);
    for (std::size_t i = 0; i < leaves; ++i) order[i] = static_cast<std::uint32_t>(i);
    std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
        const Coord oa = topology->origin(a), ob = topology->origin(b);
        for (const int edge : {kNodeEdge, kMiddleEdge})
            if (const Coord ca = cube_origin(oa, edge), cb = cube_origin(ob, edge); !(ca == cb))
                return ca < cb;
        return a < b;
    });
    std::vector<std::size_t> node_begin;
    for (std::size_t k = 0; k < leaves; ++k)
        if (k == 0 || !(cube_origin(topology->origin(order[k]), kNodeEdge) ==
                        cube_origin(topology->origin(order[k - 1]), kNodeEdge)))
            node_begin.push_back(k);
    node_begin.push_back(leaves);
    const std::size_t nodes = node_begin.size() - 1;

    const Transform transform = region.transform();
    column = IntGrid::uninitialised(topology, transform, kNoColumn);
    if (arc) *arc = FloatGrid::uninitialised(topology, transform, 0.0f);
    const PolylineIndex index(lines);

    auto fill_leaf = [&](std::size_t leaf, bool one_line, Scratch& s) {
        const LeafMask& mask = masks[leaf];
        const bool full = mask.all();
        column.mask(leaf) = mask;
        const bool uniform = one_line && full;
        if (arc || !uniform)
            PolylineIndex::nearest_in_leaf(topology->origin(leaf), s.leaf, s.line.data(),
                                           arc ? s.along.data() : nullptr);
        if (uniform) {
            column.set_constant(leaf, s.leaf.line.front());
        } else {
            std::int32_t* out = column.values(leaf);
            for (int k = 0; k < kLeafSize; ++k)
                out[k] = full || mask.test(k) ? s.line[static_cast<std::size_t>(k)] : kNoColumn;
        }
        if (arc) {
            arc->mask(leaf) = mask;
            float* out = arc->values(leaf);
            for (int k = 0; k < kLeafSize; ++k)
                out[k] = full || mask.test(k)
                             ? static_cast<float>(s.along[static_cast<std::size_t>(k)] * voxel)
                             : 0.0f;
        }
    };

    auto fill_node = [&](std::size_t node, Scratch& s) {
        progress.check();
        const Coord origin = cube_origin(topology->origin(order[node_begin[node]]), kNodeEdge);
        index.candidates(cube_centre(origin, kNodeEdge), cube_half(kNodeEdge) * std::sqrt(3.0),
                         s.leaf);
        PolylineIndex::narrow(s.leaf, cube_centre(origin, kNodeEdge), cube_half(kNodeEdge), s.node);
        Coord middle_origin{};
        bool middle_known = false;
        for (std::size_t k = node_begin[node]; k < node_begin[node + 1]; ++k) {
            const std::size_t leaf = order[k];
            const Coord o = topology->origin(leaf), m = cube_origin(o, kMiddleEdge);
            if (!middle_known || !(m == middle_origin)) {
                PolylineIndex::narrow(s.node, cube_centre(m, kMiddleEdge), cube_half(kMiddleEdge),
                                      s.middle);
                middle_origin = m;
                middle_known = true;
            }
            // One line for the whole cube: nothing to narrow down for its leaves' ids.
            if (s.middle.lines.size() == 1 && !arc) {
                s.leaf = s.middle;
                fill_leaf(leaf, true, s);
                continue;
            }
            PolylineIndex::narrow(s.middle, cube_centre(o, kLeafEdge), cube_half(kLeafEdge),
                                  s.leaf);
            fill_leaf(leaf, s.leaf.lines.size() == 1, s);
        }
    };

    // In batches, so that progress is told from this thread.
    const std::size_t batch = std::max<std::size_t>(64, nodes / 64);
    for (std::size_t first = 0; first < nodes; first += batch) {
        progress.update(double(first) / double(nodes));
        parallel_for_range(std::min(batch, nodes - first), [&](std::size_t begin, std::size_t end) {
            Scratch scratch;
            for (std::size_t k = begin; k < end; ++k) fill_node(first + k, scratch);
        });
    }
    column.compress();
    if (arc) arc->compress();
}

}  // namespace sekitei::joints
