// Stages of weathering on two scenes: columns across a 250^3 box broken into pieces, and 1200
// columns in 300^3 under a terrain. Prints: case, voxels, threads, seconds, ratio to one thread,
// hash.

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <ctime>
#include <optional>
#include <vector>

#include "core/hash.h"
#include "core/parallel.h"
#include "solvers/weathering/boundary.h"
#include "solvers/weathering/pieces.h"
#include "tests/bench/measure.h"

namespace {

using namespace sekitei;
using bench::median;
using namespace sekitei::weathering;

struct Scene {
    std::string name;
    Domain domain;
    IntGrid region, column;
    FloatGrid body, slow;
    Polylines lines;
    Params params;

    Inputs inputs() const
    {
        return {.region = region,
                .column = column,
                .body_sdf = body,
                .slow_sdf = slow,
                .lines = lines,
                .domain = domain};
    }
};

/// Gently bent columns from a cold top down to a slow bottom.
Scene make_scene(std::string name, int n, int columns, double slow_share, const Params& params)
{
    Scene s;
    s.name = std::move(name);
    s.params = params;
    s.domain = {{n, n, n}, {{}, 0.04}};
    const double top = n * (1 - 3 / 32.0) + 0.3, bottom = n * slow_share + 0.3;
    const int side = static_cast<int>(std::sqrt(double(columns)));
    const double pitch = double(n) / side;
    for (int i = 0; i < side * side; ++i) {
        const auto k = static_cast<std::uint64_t>(i);
        Vec3d p(pitch * (i % side + uniform01(1, Stream("x"), k)),
                pitch * (i / side + uniform01(1, Stream("y"), k)), top - 0.5);
        std::vector<Vec3d> line;
        for (int part = 0; part <= 8; ++part) {
            line.push_back(p);
            const double bend = 0.02 * (part - 4);
            p += Vec3d(bend, -bend / 2, -1) * ((top - 0.5 - bottom) / 8);
        }
        s.lines.add(line, StopReason::LeftLava);
    }
    const TopologyPtr topology = box_topology({0, 0, 0}, s.domain.dims);
    s.region = IntGrid::uninitialised(topology, s.domain.transform, 1);
    s.column = IntGrid::uninitialised(topology, s.domain.transform, -1);
    s.body = FloatGrid::uninitialised(topology, s.domain.transform, 0.16f);
    s.slow = FloatGrid::uninitialised(topology, s.domain.transform, 0.16f);
    const PolylineIndex index(s.lines);
    parallel_for_range(
        topology->size(),
        [&](std::size_t begin, std::size_t end) {
            PolylineIndex::Candidates candidates;
            for (std::size_t i = begin; i < end; ++i) {
                const Coord origin = topology->origin(i);
                index.candidates(centre_of(origin) + Vec3d(3.5), 3.5 * std::sqrt(3.0), candidates);
                std::int32_t line[kLeafSize];
                PolylineIndex::nearest_in_leaf(origin, candidates, line, nullptr);
                for (int o = 0; o < kLeafSize; ++o) {
                    const Coord c = leaf_coord(origin, o);
                    const double z = c.z + 0.5;
                    const bool in = s.domain.contains(c) && z < top, slow = in && z < bottom;
                    s.region.values(i)[o] = slow ? 2 : in ? 0 : 1;
                    if (in) s.region.mask(i).set(o);
                    s.column.values(i)[o] = in && !slow ? line[o] : -1;
                    if (in && !slow) s.column.mask(i).set(o);
                    s.body.values(i)[o] = static_cast<float>(std::clamp(z - top, -4.0, 4.0) * 0.04);
                    s.slow.values(i)[o] =
                        static_cast<float>(std::clamp(z - bottom, -4.0, 4.0) * 0.04);
                }
            }
        },
        16);
    s.region.compress();
    s.column.compress();
    s.body.compress();
    s.slow.compress();
    return s;
}

struct Times {
    std::vector<double> cut, component, collapse, density;
    double cut_cpu = 0, component_cpu = 0, collapse_cpu = 0, density_cpu = 0;  // of the last repeat
};

void measure(const Scene& scene)
{
    const Inputs inputs = scene.inputs();
    const Progress progress;
    Times first;
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        Times times;
        std::string hash;
        double touched = 0, share = 0;
        for (int repeat = 0; repeat < 5; ++repeat) {
            auto last = std::chrono::steady_clock::now();
            auto last_cpu = std::clock();
            auto lap = [&](std::vector<double>& into, double& cpu) {
                const auto now = std::chrono::steady_clock::now();
                into.push_back(std::chrono::duration<double>(now - last).count());
                last = now;
                cpu = double(std::clock() - last_cpu) / CLOCKS_PER_SEC;
                last_cpu = std::clock();
            };
            const std::vector<double> arcs = scene.lines.arc_lengths();
            const PolylineIndex index(scene.lines);
            std::optional<Terrain> terrain;
            if (scene.params.cut == Cut::Horizontal) terrain.emplace(inputs, scene.params, 1);
            const Terrain* above = terrain ? &*terrain : nullptr;
            CutResult cut = cut_columns(inputs, scene.params, 1, above, progress);
            lap(times.cut, times.cut_cpu);
            const IntGrid component = component_grid(inputs, cut.pieces, index, arcs, progress);
            lap(times.component, times.component_cpu);
            collapse(inputs, scene.params, component, cut.weak, cut.pieces, progress);
            lap(times.collapse, times.collapse_cpu);
            const BoundaryResult boundary = find_boundary(inputs, scene.params, component,
                                                          cut.pieces, index, arcs, above, progress);
            lap(times.density, times.density_cpu);
            touched = boundary.leaves_touched_share;
            share = boundary.removed_voxels / boundary.lava_voxels;
            Hasher hasher;
            for (std::size_t i = 0; i < boundary.density.leaf_count(); ++i)
                for (int o = 0; o < kLeafSize; ++o) hasher.add_value(boundary.density.at(i, o));
            hash = hasher.hex();
        }
        if (threads == 1) first = times;
        const double voxels = scene.domain.voxel_count();
        auto line = [&](const char* stage, const std::vector<double>& t,
                        const std::vector<double>& one, double cpu) {
            fmt::print("{} {}, {:.0f}, {}, {:.4f}, {:.2f}, {:.4f}, {}\n", scene.name, stage, voxels,
                       threads, median(t), median(one) / median(t), cpu, hash);
        };
        line("cuts", times.cut, first.cut, times.cut_cpu);
        line("component", times.component, first.component, times.component_cpu);
        line("collapse", times.collapse, first.collapse, times.collapse_cpu);
        line("density", times.density, first.density, times.density_cpu);
        fmt::print("  removed {:.1f} %, lava leaves touched {:.1f} %\n", 100 * share,
                   100 * touched);
    }
}

}  // namespace

int main()
{
    fmt::print("case, voxels, threads, seconds, speed-up, CPU seconds, hash\n");
    Params pieces;
    pieces.cut = Cut::Perpendicular;
    pieces.ramp = Ramp::Cliff;
    pieces.open_face = Vec3d(0, -1, 0);
    measure(make_scene("pieces", 250, 400, 3 / 32.0, pieces));
    Params coast;
    coast.cut = Cut::Horizontal;
    measure(make_scene("coast", 300, 1200, 0.1, coast));
}
