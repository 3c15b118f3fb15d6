// The leaves of a forest as grids, and its trees as instances: seconds, voxels, hash.
// canopy_bench [size in m, 512] [steps, 50]
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <vector>

#include "core/hash.h"
#include "core/parallel.h"
#include "grids/scene.h"
#include "solvers/forest/canopy.h"
#include "solvers/forest/instances.h"

using namespace sekitei;

namespace {

template <class F>
double seconds_of(F&& f)
{
    double best = 1e9;
    for (int round = 0; round < 3; ++round) {
        const auto begin = std::chrono::steady_clock::now();
        f();
        best = std::min(
            best, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    }
    return best;
}

}  // namespace

int main(int count, char** words)
{
    const double size = count > 1 ? std::atof(words[1]) : 512;
    const int steps = count > 2 ? std::atoi(words[2]) : 50;
    forest::Inputs inputs;
    inputs.width = inputs.depth = size;
    inputs.species = forest::table_species();
    forest::Forest forest(inputs);
    forest.sow(std::vector<std::uint64_t>(6, std::uint64_t(1000 * size * size / (512 * 512))));
    for (int n = 0; n < steps; ++n) forest.advance();
    fmt::print("{} trees\ncase, threads, seconds, active voxels, MB, hash of transmittance\n",
               forest.size());
    forest::CanopyParams all, fields, slanted;
    fields.occupancy = slanted.occupancy = false;
    slanted.sun = Vec3d(1, -0.5, 1);
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        for (const auto& [name, params] : {std::pair("canopy", all),
                                           {"canopy without owners", fields},
                                           {"canopy, slanted sun", slanted}}) {
            forest::Canopy c;
            const double seconds = seconds_of([&] { c = forest::canopy(forest, params); });
            std::size_t bytes = 0;
            for (const FloatGrid* g : {&c.leaf_area_density, &c.drag, &c.transmittance, &c.height,
                                       &c.ground_transmittance, &c.terrain, &c.density})
                bytes += g->memory_bytes();
            bytes += c.owner.memory_bytes();
            Grid grid;
            grid.values = c.transmittance;
            const std::string hash = content_hash(grid);
            fmt::print("{}, {}, {:.3f}, {}, {:.1f}, {}\n", name, threads, seconds,
                       c.leaf_area_density.active_count(), double(bytes) / 1e6, hash.substr(0, 16));
        }
        const auto trees = forest.trees();
        const forest::ModelTable models{{0, 0, 0, 0, 0, 0}, 3, 3, std::vector<double>(9, 0.4)};
        std::vector<forest::Instance> list;
        fmt::print("instances, {}, {:.3f}\n", threads,
                   seconds_of([&] { list = forest::instances(trees, inputs, models); }));
    }
}
