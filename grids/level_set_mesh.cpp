#include <fmt/format.h>
#include <openvdb/Grid.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/MeshToVolume.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <vector>

#include "core/error.h"
#include "core/parallel.h"
#include "grids/level_set.h"
#include "grids/winding_number.h"

namespace sekitei {
namespace {

void require_usable(const TriMesh& mesh)
{
    if (mesh.triangles.empty())
        throw InvalidInput(fmt::format(
            "mesh: {} vertices and no triangles, expected a closed surface; a point cloud must be "
            "meshed first",
            mesh.vertices.size()));
    std::size_t bad = 0, first_bad = 0;
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
        const Vec3f v = mesh.vertices[i];
        if (std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z)) continue;
        if (bad++ == 0) first_bad = i;
    }
    if (bad > 0)
        throw InvalidInput(
            fmt::format("mesh: {} vertices are NaN or infinite, the first is number {}; expected "
                        "finite coordinates",
                        bad, first_bad));
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i)
        for (const std::uint32_t v : mesh.triangles[i])
            if (v >= mesh.vertices.size())
                throw InvalidInput(
                    fmt::format("mesh: triangle {} names vertex {}, but there are {} vertices", i,
                                v, mesh.vertices.size()));
}

/// The mesh as OpenVDB reads it, in index space: an integer index is a voxel's centre.
struct MeshAdapter {
    const TriMesh& mesh;
    Transform transform;

    std::size_t polygonCount() const { return mesh.triangles.size(); }
    std::size_t pointCount() const { return mesh.vertices.size(); }
    std::size_t vertexCount(std::size_t) const { return 3; }
    void getIndexSpacePoint(std::size_t triangle, std::size_t corner, openvdb::Vec3d& point) const
    {
        const Vec3d p =
            transform.voxels(Vec3d(mesh.vertices[mesh.triangles[triangle][corner]])) - Vec3d(0.5);
        point = openvdb::Vec3d(p.x, p.y, p.z);
    }
};

/// OpenVDB asks it from many threads whether to stop.
struct StopWish {
    const Progress& progress;

    void start(const char* = nullptr) {}
    void end() {}
    bool wasInterrupted(int = -1) const { return progress.cancelled(); }
};

/// A grid in voxel edges as one in world units.
FloatGrid from_vdb(const openvdb::FloatGrid& vdb, const Transform& transform, float background)
{
    const auto voxel = static_cast<float>(transform.voxel);
    const auto& tree = vdb.tree();
    std::vector<Coord> origins;
    std::vector<const openvdb::FloatTree::LeafNodeType*> leaves;
    for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) {
        const openvdb::Coord o = leaf->origin();
        origins.emplace_back(o.x(), o.y(), o.z());
        leaves.push_back(&*leaf);
    }
    // Tiles inside the body become constant leaves.
    auto tile = tree.cbeginValueAll();
    tile.setMaxDepth(openvdb::FloatTree::ValueAllCIter::LEAF_DEPTH - 1);
    for (; tile; ++tile) {
        if (!(*tile < 0)) continue;
        const openvdb::CoordBBox box = tile.getBoundingBox();
        for (int x = box.min().x(); x <= box.max().x(); x += kLeafEdge)
            for (int y = box.min().y(); y <= box.max().y(); y += kLeafEdge)
                for (int z = box.min().z(); z <= box.max().z(); z += kLeafEdge)
                    origins.emplace_back(x, y, z);
    }
    FloatGrid grid(LeafTopology::build(origins), transform, background);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.set_constant(leaf, -background);
    std::vector<std::size_t> dense;
    for (const auto* leaf : leaves) {
        const openvdb::Coord o = leaf->origin();
        dense.push_back(grid.topology()->find({o.x(), o.y(), o.z()}));
    }
    grid.expand(dense);
    parallel_for(
        leaves.size(),
        [&](std::size_t k) {
            float* values = grid.values(dense[k]);
            LeafMask& mask = grid.mask(dense[k]);
            for (openvdb::Index o = 0; o < static_cast<openvdb::Index>(kLeafSize); ++o) {
                values[o] = std::clamp(leaves[k]->getValue(o) * voxel, -background, background);
                if (std::fabs(values[o]) < background) mask.set(static_cast<int>(o));
            }
        },
        64);
    grid.compress();
    return grid;
}

FloatGrid convert(const TriMesh& mesh, const Transform& transform, double outside, double inside,
                  int flags, const Progress& progress)
{
    require_usable(mesh);
    openvdb::initialize();
    const MeshAdapter adapter{mesh, transform};
    StopWish stop{progress};
    // Voxels of edge 1: OpenVDB takes edges of nanometres for zero.
    const auto vdb_transform = openvdb::math::Transform::createLinearTransform(1.0);
    progress.update(0);
    // OpenVDB's band is ragged by up to a voxel at its outer side.
    constexpr double ragged = 1.5;
    const auto vdb = openvdb::tools::meshToVolume<openvdb::FloatGrid>(
        stop, adapter, *vdb_transform, static_cast<float>(outside + ragged),
        static_cast<float>(inside > 0 ? inside + ragged : 0), flags);
    progress.update(0.9);
    FloatGrid grid = from_vdb(*vdb, transform, static_cast<float>(outside * transform.voxel));
    progress.update(1);
    return grid;
}

bool has_inside(const FloatGrid& grid)
{
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o)
            if (grid.at(leaf, o) <= 0) return true;
    return false;
}

/// Signs for the distances of one leaf.
///
/// In a ball that the mesh does not enter the winding number is harmonic, and between 0 and 1, so
/// by Harnack's inequality one value near 0 or 1 in its middle settles the side of all voxels
/// nearby: u(x) <= u(0) (1 + q) / (1 - q)^2 at the share q of the radius. Voxels far from the mesh
/// go first, and settle the most.
template <class WindingAt>
void inside_of_leaf(const std::array<float, kLeafSize>& distance, WindingAt&& winding_at,
                    double voxel, float* values)
{
    constexpr double error = 0.02;  // of the tree's dipoles
    std::array<std::uint16_t, kLeafSize> order;
    std::iota(order.begin(), order.end(), std::uint16_t{0});
    std::sort(order.begin(), order.end(), [&](std::uint16_t a, std::uint16_t b) {
        return distance[a] != distance[b] ? distance[a] > distance[b] : a < b;
    });
    LeafMask known;
    for (const std::uint16_t i : order) {
        if (known.test(i)) continue;
        const double w = winding_at(i);
        const bool in = w > 0.5;
        known.set(i);
        values[i] = in ? -distance[i] : distance[i];
        const double u = std::fabs(in ? 1 - w : w) + error, radius = distance[i] / voxel;
        const Coord c = leaf_coord({0, 0, 0}, i);
        const int reach = static_cast<int>(radius);
        for (int x = std::max(c.x - reach, 0); x <= std::min(c.x + reach, 7); ++x)
            for (int y = std::max(c.y - reach, 0); y <= std::min(c.y + reach, 7); ++y)
                for (int z = std::max(c.z - reach, 0); z <= std::min(c.z + reach, 7); ++z) {
                    const int near = leaf_offset({x, y, z});
                    const double q = length(Vec3d(Coord(x, y, z) - c)) / radius;
                    if (q >= 1 || known.test(near) || u * (1 + q) >= 0.5 * (1 - q) * (1 - q))
                        continue;
                    known.set(near);
                    values[near] = in ? -distance[std::size_t(near)] : distance[std::size_t(near)];
                }
    }
}

[[noreturn]] void throw_nothing_inside(const TriMesh& mesh, double voxel)
{
    const Vec3d size = mesh.bounds().size();
    throw InvalidInput(fmt::format(
        "mesh: {} triangles, {:.4g} x {:.4g} x {:.4g} m, hold no voxel of {:.4g} m; expected a "
        "body that encloses a volume: use a smaller voxel, another scale, or close its holes",
        mesh.triangles.size(), size.x, size.y, size.z, voxel));
}

}  // namespace

FloatGrid level_set_from_mesh(const TriMesh& mesh, const Transform& transform,
                              const Progress& progress)
{
    // Renormalising would move flat faces by a third of a voxel. Without it faces inside the body
    // (of parts that overlap) leave small distances behind, which are mended.
    FloatGrid grid =
        mend_distances(convert(mesh, transform, kBandVoxels, kBandVoxels,
                               openvdb::tools::DISABLE_RENORMALIZATION, progress.slice(0, 0.7)),
                       progress.slice(0.7, 1));
    if (!has_inside(grid)) throw_nothing_inside(mesh, transform.voxel);
    return grid;
}

FloatGrid distance_to_mesh(const TriMesh& mesh, const Transform& transform, double band,
                           const Progress& progress)
{
    return convert(mesh, transform, band, 0, openvdb::tools::UNSIGNED_DISTANCE_FIELD, progress);
}

FloatGrid level_set_from_open_mesh(const TriMesh& mesh, const Domain& domain,
                                   const Progress& progress)
{
    const double voxel = domain.transform.voxel;
    const auto background = static_cast<float>(kBandVoxels * voxel);
    const FloatGrid distance =
        distance_to_mesh(mesh, domain.transform, kBandVoxels, progress.slice(0, 0.2));
    const WindingNumber winding(mesh);
    // An open mesh has no enclosed volume, but its sign still tells which way it is wound.
    const Vec3d middle = mesh.bounds().centre();
    TriMesh centred = mesh;
    for (Vec3f& v : centred.vertices) v = Vec3f(Vec3d(v) - middle);
    const double sense = centred.signed_volume() < 0 ? -1 : 1;
    auto winding_at = [&](Vec3d p) { return sense * winding(domain.transform.world(p)); };

    // Away from the mesh the winding number is harmonic and a leaf's corners and centre tell
    // whether a patch passes through; leaves where they differ, and those at the mesh, are looked
    // at voxel by voxel.
    const TopologyPtr all = box_topology({-8, -8, -8}, domain.dims + Coord(8, 8, 8));
    std::vector<signed char> side(all->size());
    const auto batched = [&](std::size_t count, const Progress& part, auto&& f) {
        constexpr std::size_t batch = 256;
        for (std::size_t begin = 0; begin < count; begin += batch) {
            part.update(static_cast<double>(begin) / static_cast<double>(count));
            parallel_for(
                std::min(batch, count - begin), [&](std::size_t i) { f(begin + i); }, 4);
        }
    };
    const Coord first(-8, -8, -8), last = all->origin(all->size() - 1);
    const Coord corners = (last - first) / kLeafEdge + Coord(2, 2, 2);
    const auto corner_index = [&](Coord c) {
        const Coord n = (c - first) / kLeafEdge;
        return (std::size_t(n.x) * std::size_t(corners.y) + std::size_t(n.y)) *
                   std::size_t(corners.z) +
               std::size_t(n.z);
    };
    std::vector<char> corner_inside(std::size_t(corners.x) * std::size_t(corners.y) *
                                    std::size_t(corners.z));
    batched(corner_inside.size(), progress.slice(0.2, 0.35), [&](std::size_t i) {
        const std::size_t row = i / std::size_t(corners.z);
        const Coord n(static_cast<int>(row / std::size_t(corners.y)),
                      static_cast<int>(row % std::size_t(corners.y)),
                      static_cast<int>(i % std::size_t(corners.z)));
        corner_inside[i] = winding_at(Vec3d(first + n * kLeafEdge)) > 0.5;
    });
    batched(all->size(), progress.slice(0.35, 0.5), [&](std::size_t leaf) {
        const Coord o = all->origin(leaf);
        const std::uint32_t own = distance.topology()->find(o);
        if (own != kNoLeaf && !distance.is_constant(own)) return;
        const bool in = corner_inside[corner_index(o)];
        for (int c = 1; c < 8; ++c)
            if (corner_inside[corner_index(
                    o + Coord(c & 1 ? 8 : 0, c & 2 ? 8 : 0, c & 4 ? 8 : 0))] != in)
                return;
        if ((winding_at(Vec3d(o) + Vec3d(4)) > 0.5) == in) side[leaf] = in ? -1 : 1;
    });

    FloatGrid signed_distance(all, domain.transform, background);
    std::vector<std::size_t> mixed;
    for (std::size_t leaf = 0; leaf < all->size(); ++leaf) {
        if (side[leaf] == 0) mixed.push_back(leaf);
        if (side[leaf] < 0) signed_distance.set_constant(leaf, -background);
    }
    signed_distance.expand(mixed);
    batched(mixed.size(), progress.slice(0.5, 0.9), [&](std::size_t k) {
        const Coord o = all->origin(mixed[k]);
        const std::uint32_t own = distance.topology()->find(o);
        std::array<float, kLeafSize> size;
        for (int i = 0; i < kLeafSize; ++i)
            size[std::size_t(i)] = own == kNoLeaf ? background : std::fabs(distance.at(own, i));
        inside_of_leaf(
            size, [&](int i) { return winding_at(centre_of(leaf_coord(o, i))); }, voxel,
            signed_distance.values(mixed[k]));
    });
    FloatGrid grid = mend_distances(signed_distance, domain, progress.slice(0.9, 1));
    if (!has_inside(grid)) throw_nothing_inside(mesh, voxel);
    return grid;
}

}  // namespace sekitei
