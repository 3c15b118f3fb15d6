// Scenes to and from files, beside OpenVDB's own writer and reader on the same values.
// Prints: case, voxels, threads, seconds, MB/s of raw values, ratio to OpenVDB, hash.
#include <fmt/format.h>
#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/Dense.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>

#include "core/file_output.h"
#include "core/noise.h"
#include "core/parallel.h"
#include "grids/vdb_file.h"
#include "tests/bench/measure.h"

using namespace sekitei;
using bench::median;
using bench::seconds_of;

int main(int argc, char** argv)
{
    const int n = argc > 1 ? std::atoi(argv[1]) : 250;
    openvdb::initialize();
    const std::filesystem::path folder =
        std::filesystem::temp_directory_path() / fmt::format("vdb_bench_{}", ::getpid());
    std::filesystem::create_directory(folder);

    // A smooth field with noise in its last digits, as a temperature is.
    const Transform place{.origin = {0, 0, 0}, .voxel = 0.04};
    auto grid = FloatGrid::uninitialised(box_topology({0, 0, 0}, Coord(n)), place, 200.0f);
    const FractalNoise noise{.seed = 7, .frequency = 0.02, .octaves = 2};
    parallel_for(grid.leaf_count(), [&](std::size_t i) {
        for (int v = 0; v < kLeafSize; ++v) {
            const Coord c = leaf_coord(grid.origin(i), v);
            const bool inside = c.x < n && c.y < n && c.z < n;
            grid.values(i)[v] =
                inside ? static_cast<float>(1000 + 800 * noise(centre_of(c))) : 200.0f;
            if (inside) grid.mask(i).set(v);
        }
    });
    auto theirs = openvdb::FloatGrid::create(200.0f);
    for (std::size_t i = 0; i < grid.leaf_count(); ++i) {
        const Coord o = grid.origin(i);
        auto* leaf = theirs->tree().touchLeaf({o.x, o.y, o.z});
        for (int v = 0; v < kLeafSize; ++v) {
            leaf->setValueOnly(static_cast<openvdb::Index>(v), grid.values(i)[v]);
            leaf->setActiveState(static_cast<openvdb::Index>(v), grid.mask(i).test(v));
        }
    }
    theirs->setName("temperature");
    const double voxels = static_cast<double>(grid.active_count());
    Scene scene;
    scene.put("temperature", std::move(grid), "K", "cool");

    for (const std::size_t threads : {1, 2}) {
        const ThreadLimit limit(threads);
        std::vector<double> write, read, write_peer, read_peer;
        for (int round = 0; round < 5; ++round) {
            write.push_back(seconds_of([&] { write_vdb(folder / "ours.vdb", scene); }));
            write_peer.push_back(seconds_of([&] {
                openvdb::io::File file((folder / "theirs.vdb").string());
                file.setCompression(openvdb::io::COMPRESS_BLOSC |
                                    openvdb::io::COMPRESS_ACTIVE_MASK);
                file.write({theirs});
                file.close();
            }));
            read.push_back(seconds_of([&] { read_vdb(folder / "ours.vdb"); }));
            read_peer.push_back(seconds_of([&] {
                openvdb::io::File file((folder / "theirs.vdb").string());
                file.open(false);
                file.getGrids();
            }));
        }
        auto line = [&](const char* name, double own, double peer) {
            fmt::print("{}, {:.0f}, {}, {:.3f}, {:.0f} MB/s, {:.2f}, {}\n", name, voxels, threads,
                       own, voxels * 4e-6 / own, peer / own,
                       file_hash(folder / "ours.vdb").substr(0, 16));
        };
        line("vdb write (synced, hashed, verified)", median(write), median(write_peer));
        line("vdb read (hash checked)", median(read), median(read_peer));
    }
    std::filesystem::remove_all(folder);
}
