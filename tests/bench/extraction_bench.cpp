// Marching tetrahedra against OpenVDB's volumeToMesh (adaptivity 0) on the same fog volume.
// Prints: case, voxels, threads, seconds, ratio to the peer, hash.

#include <fmt/format.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/VolumeToMesh.h>

#include <vector>

#include "core/hash.h"
#include "core/noise.h"
#include "grids/marching_tetrahedra.h"
#include "tests/bench/measure.h"

namespace {

using namespace sekitei;
using bench::median;
using bench::seconds_of;

constexpr int kEdge = 300;

/// A ball with bumps, as anti-aliased density.
sekitei::FloatGrid bumpy_rock()
{
    const FractalNoise noise{.seed = 1, .frequency = 1.0 / 60, .octaves = 3};
    const TopologyPtr topology = box_topology({0, 0, 0}, Coord(kEdge));
    auto grid = sekitei::FloatGrid::uninitialised(topology, {{}, 1.0}, 0.0f);
    parallel_for(topology->size(), [&](std::size_t leaf) {
        const Vec3d middle = centre_of(grid.origin(leaf)) + Vec3d(3.5);
        const double off = 120 - length(middle - Vec3d(kEdge / 2.0));
        for (int o = 0; o < kLeafSize; ++o) {
            double depth = off;
            if (std::abs(off) < 40) {
                const Vec3d p = centre_of(leaf_coord(grid.origin(leaf), o));
                depth = 120 + 15 * noise(p) - length(p - Vec3d(kEdge / 2.0));
            }
            const double d = std::clamp(0.5 + depth / 3.4641, 0.0, 1.0);
            grid.values(leaf)[o] = static_cast<float>(d);
            if (d > 0) grid.mask(leaf).set(o);
        }
    });
    grid.compress();
    return grid;
}

openvdb::FloatGrid::Ptr to_openvdb(const sekitei::FloatGrid& grid)
{
    auto out = openvdb::FloatGrid::create(0.0f);
    for (std::size_t i = 0; i < grid.leaf_count(); ++i) {
        const sekitei::Coord o = grid.origin(i);
        if (grid.is_constant(i)) {
            if (grid.constant(i) > 0)
                out->tree().addTile(1, openvdb::Coord(o.x, o.y, o.z), grid.constant(i), true);
            continue;
        }
        auto* leaf = out->tree().touchLeaf(openvdb::Coord(o.x, o.y, o.z));
        for (int k = 0; k < kLeafSize; ++k) {
            const float v = grid.at(i, k);
            leaf->setValueOnly(static_cast<openvdb::Index>(k), v);
            if (grid.mask(i).test(k)) leaf->setValueOn(static_cast<openvdb::Index>(k), v);
        }
    }
    return out;
}

}  // namespace

int main()
{
    openvdb::initialize();
    const sekitei::FloatGrid rock = bumpy_rock();
    const openvdb::FloatGrid::Ptr peer = to_openvdb(rock);
    fmt::print("case, voxels, threads, seconds, ratio, hash\n");
    double one_thread = 0;
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        std::vector<double> own, other;
        TriMesh mesh;
        std::vector<openvdb::Vec3s> points;
        std::vector<openvdb::Vec4I> quads;
        std::vector<openvdb::Vec3I> triangles;
        for (int repeat = 0; repeat < 5; ++repeat) {
            own.push_back(seconds_of([&] { mesh = marching_tetrahedra(rock, 0.5, Progress()); }));
            other.push_back(seconds_of(
                [&] { openvdb::tools::volumeToMesh(*peer, points, triangles, quads, 0.5, 0.0); }));
        }
        Hasher hasher;
        hasher.add(mesh.vertices.data(), mesh.vertices.size() * sizeof(mesh.vertices[0]));
        hasher.add(mesh.triangles.data(), mesh.triangles.size() * sizeof(mesh.triangles[0]));
        const double mine = median(own), theirs = median(other);
        if (threads == 1) one_thread = mine;
        fmt::print("marching_tetrahedra ({} triangles), {}, {}, {:.4f}, {:.2f}, {}\n",
                   mesh.triangles.size(), kEdge * kEdge * kEdge, threads, mine, mine / theirs,
                   hasher.hex());
        fmt::print("volumeToMesh ({} quads), {}, {}, {:.4f}, 1, -\n", quads.size(),
                   kEdge * kEdge * kEdge, threads, theirs);
        if (threads == 2) fmt::print("speed-up on 2 threads: {:.2f}\n", one_thread / mine);
    }
}
