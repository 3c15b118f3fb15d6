// The lava stage at the sizes of the paper's scenes and beyond, and meshes against OpenVDB's own
// converter settings. Prints: case, voxels, threads, seconds (median of five), ns per voxel, hash.

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <string_view>

#include "core/hash.h"
#include "core/log.h"
#include "core/parallel.h"
#include "solvers/lava/lava.h"
#include "tests/support/shapes.h"

namespace {

using namespace sekitei;

template <class T>
void add_to(Hasher& hasher, const LeafGrid<T>& grid)
{
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf) {
        hasher.add_value(grid.origin(leaf));
        hasher.add_value(grid.mask(leaf));
        if (const T* values = grid.values(leaf))
            hasher.add(values, kLeafSize * sizeof(T));
        else
            hasher.add_value(grid.constant(leaf));
    }
}

void measure(std::string_view name, const lava::Params& params, const lava::Inputs& inputs,
             int repeats)
{
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        std::vector<double> seconds;
        double voxels = 0, bytes = 0;
        std::string hash;
        for (int i = 0; i < repeats; ++i) {
            const auto start = std::chrono::steady_clock::now();
            const lava::Result r = lava::run(inputs, params, 7, {});
            seconds.push_back(
                std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
            Hasher hasher;
            add_to(hasher, r.region);
            add_to(hasher, r.region_coarse);
            add_to(hasher, r.body_sdf);
            add_to(hasher, r.slow_sdf);
            hash = hasher.hex();
            voxels = r.domain.voxel_count();
            bytes = static_cast<double>(r.region.memory_bytes() + r.body_sdf.memory_bytes() +
                                        r.slow_sdf.memory_bytes());
        }
        std::sort(seconds.begin(), seconds.end());
        const double median = seconds[seconds.size() / 2];
        fmt::print("{}, {:.3g} voxels, {} threads, {:.3f} s, {:.2f} ns/voxel, {:.0f} MB, {}\n",
                   name, voxels, threads, median, 1e9 * median / voxels, bytes / 1e6, hash);
    }
}

}  // namespace

int main(int argc, char** argv)
{
    log::set_level(log::Level::Quiet);
    const bool large = argc > 1 && std::string_view(argv[1]) == "large";
    for (const lava::Preset preset : {lava::Preset::Chevron, lava::Preset::Fan, lava::Preset::Cliff,
                                      lava::Preset::Tower, lava::Preset::Coast}) {
        lava::Params params;
        params.preset = preset;
        measure(choice_names(preset)[static_cast<std::size_t>(preset)], params, {}, 5);
    }
    lava::Inputs inputs;
    inputs.mesh = shapes::ball({1, 2, 3}, 4, 6);
    lava::Params mesh;
    mesh.preset = lava::Preset::Mesh;
    measure("ball mesh, 32768 faces", mesh, inputs, 5);
    inputs.mesh->triangles.resize(32000);
    measure("the same with a hole", mesh, inputs, 3);
    if (large) {
        lava::Params params;
        params.preset = lava::Preset::Cliff;
        params.size = Vec3d(40, 16, 40);
        params.voxel = 0.04;
        measure("cliff 1000 x 400 x 1000", params, {}, 1);
    }
}
