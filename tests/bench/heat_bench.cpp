// The heat step beside its peers: a dense 256^3 loop and a ValueAccessor loop over the same rock.
// Prints `case, voxels, threads, seconds, ratio, hash`. Seconds are the median of five, project and
// peers in turn; the ratio is the project's rate per voxel over the peer's.
#include <fmt/format.h>
#include <openvdb/openvdb.h>
#include <openvdb/tree/LeafManager.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <ctime>
#include <functional>
#include <numeric>
#include <vector>

#include "core/hash.h"
#include "core/log.h"
#include "grids/leaf_stencil.h"
#include "solvers/cooling/cooling.h"
#include "tests/bench/measure.h"

namespace {

using namespace sekitei;
using bench::median;

constexpr double kAlpha = 0.1;

/// Processor time on one thread, which a busy machine disturbs least; else the clock on the wall.
double seconds_of(const std::function<void()>& work)
{
    const std::clock_t used = std::clock();
    const auto start = std::chrono::steady_clock::now();
    work();
    if (thread_count() == 1) return double(std::clock() - used) / CLOCKS_PER_SEC;
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

/// A bumpy rock of 4 million voxels in a box of 256^3.
bool in_rock(Coord c)
{
    const Vec3d p = centre_of(c) - Vec3d(128);
    const double bump =
        std::sin(0.11 * p.x) * std::sin(0.13 * p.y) + 0.6 * std::sin(0.23 * p.z + 0.07 * p.x);
    return length(p) < 97 + 5 * bump;
}

double start_of(Coord c)
{
    return in_rock(c) ? 1000 + (c.x * 7 + c.y * 13 + c.z * 29) % 1000 : 200;
}

HeatProblem rock_problem(bool ragged_start)
{
    HeatProblem problem;
    problem.domain.dims = Coord(256, 256, 256);
    const TopologyPtr box = box_topology({0, 0, 0}, problem.domain.dims);
    std::vector<Coord> origins;
    for (const Coord& o : box->origins())
        for (int i = 0; i < kLeafSize; ++i)
            if (in_rock(leaf_coord(o, i))) {
                origins.push_back(o);
                break;
            }
    auto grid = LeafGrid<double>::uninitialised(LeafTopology::build(origins), {}, 200.0);
    problem.free.resize(grid.leaf_count());
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int i = 0; i < kLeafSize; ++i) {
            const Coord c = leaf_coord(grid.origin(leaf), i);
            const bool rock = in_rock(c);
            grid.values(leaf)[i] = !rock ? 200 : ragged_start ? start_of(c) : 2000;
            if (rock) problem.free[leaf].set(i);
        }
    grid.compress();
    problem.temperature = std::move(grid);
    problem.alpha = kAlpha;
    return problem;
}

/// The textbook loop over a full array.
template <class T>
__attribute__((target_clones("avx2", "default"))) void dense_rows(const T* t, T* out, int n, int x)
{
    const std::size_t plane = std::size_t(n) * std::size_t(n);
    for (int y = 1; y < n - 1; ++y) {
        const T* r = t + std::size_t(x) * plane + std::size_t(y) * std::size_t(n);
        T* o = out + (r - t);
        for (int z = 1; z < n - 1; ++z)
            o[z] =
                r[z] + T(kAlpha) * (((r[z - std::ptrdiff_t(plane)] + r[z + std::ptrdiff_t(plane)]) +
                                     (r[z - n] + r[z + n])) +
                                    (r[z - 1] + r[z + 1]) - 6 * r[z]);
    }
}

template <class T>
struct DensePeer {
    static constexpr int n = 256;
    std::vector<T> now, next;
    DensePeer() : now(std::size_t(n) * n * n), next(now.size())
    {
        for (std::size_t i = 0; i < now.size(); ++i) now[i] = next[i] = T(1000 + i % 997);
    }
    void step()
    {
        parallel_for(std::size_t(n - 2),
                     [&](std::size_t x) { dense_rows(now.data(), next.data(), n, int(x) + 1); });
        now.swap(next);
    }
    double voxels() const { return double(n - 2) * (n - 2) * (n - 2); }
};

/// One accessor for each task, seven look-ups for each active voxel.
struct AccessorPeer {
    openvdb::DoubleGrid::Ptr now = openvdb::DoubleGrid::create(200), next;
    AccessorPeer()
    {
        auto writer = now->getAccessor();
        for (int x = 0; x < 256; ++x)
            for (int y = 0; y < 256; ++y)
                for (int z = 0; z < 256; ++z)
                    if (in_rock({x, y, z})) writer.setValue({x, y, z}, start_of({x, y, z}));
        next = now->deepCopy();
    }
    void step()
    {
        openvdb::tree::LeafManager<openvdb::DoubleTree> leaves(next->tree());
        leaves.foreach ([&](openvdb::DoubleTree::LeafNodeType& leaf, std::size_t) {
            const auto from = now->getConstAccessor();
            for (auto voxel = leaf.beginValueOn(); voxel; ++voxel) {
                const openvdb::Coord c = voxel.getCoord();
                const double t = from.getValue(c);
                voxel.setValue(t + kAlpha * (((from.getValue(c.offsetBy(-1, 0, 0)) +
                                               from.getValue(c.offsetBy(1, 0, 0))) +
                                              (from.getValue(c.offsetBy(0, -1, 0)) +
                                               from.getValue(c.offsetBy(0, 1, 0)))) +
                                             (from.getValue(c.offsetBy(0, 0, -1)) +
                                              from.getValue(c.offsetBy(0, 0, 1))) -
                                             6 * t));
            }
        });
        now.swap(next);
    }
    /// In the order of HeatSolver::free_values().
    std::vector<double> values() const
    {
        std::vector<double> all;
        for (auto leaf = now->tree().cbeginLeaf(); leaf; ++leaf)
            for (auto voxel = leaf->cbeginValueOn(); voxel; ++voxel) all.push_back(*voxel);
        return all;
    }
};

std::string hash_of(const std::vector<double>& values)
{
    return hash_hex({reinterpret_cast<const char*>(values.data()), values.size() * sizeof(double)});
}

/// Order of leaves differs between the two, so compare what does not depend on it.
double largest_difference(std::vector<double> a, std::vector<double> b)
{
    if (a.size() != b.size()) return INFINITY;
    std::sort(a.begin(), a.end());
    std::sort(b.begin(), b.end());
    double worst = 0;
    for (std::size_t i = 0; i < a.size(); ++i) worst = std::max(worst, std::abs(a[i] - b[i]));
    return worst;
}

void line(const char* name, double voxels, std::size_t threads, double seconds, double ratio,
          const std::string& hash)
{
    fmt::print("{:<34} {:>9.0f} {} {:.4f} {:7.2f} {}\n", name, voxels, threads, seconds, ratio,
               hash);
    std::fflush(stdout);
}

void rock(std::size_t threads, int repeats)
{
    const ThreadLimit limit(threads);
    constexpr int kSteps = 20;
    const HeatProblem problem = rock_problem(true);
    const auto solver = sparse_heat_solver(problem);
    DensePeer<double> dense;
    DensePeer<float> dense_float;
    AccessorPeer accessor;
    solver->advance(2, {});
    accessor.step();
    accessor.step();
    const double difference = largest_difference(solver->free_values(), accessor.values());
    std::vector<double> swept, single, in_double, in_float, looked_up;
    for (int r = 0; r < repeats; ++r) {
        swept.push_back(seconds_of([&] { solver->advance(kSteps, {}); }) / kSteps);
        in_double.push_back(seconds_of([&] {
                                for (int i = 0; i < kSteps; ++i) dense.step();
                            }) /
                            kSteps);
        single.push_back(seconds_of([&] {
                             for (int i = 0; i < kSteps; ++i) solver->advance(1, {});
                         }) /
                         kSteps);
        in_float.push_back(seconds_of([&] {
                               for (int i = 0; i < kSteps; ++i) dense_float.step();
                           }) /
                           kSteps);
        looked_up.push_back(seconds_of([&] { accessor.step(); }));
    }
    const double voxels = double(solver->free_values().size());
    const double sweep = median(swept) / voxels, alone = median(single) / voxels;
    const std::string hash = hash_of(solver->free_values());
    line("rock, step", voxels, threads, median(swept), 1, hash);
    line("rock, one step at a time", voxels, threads, median(single), 1, hash);
    line("peer dense 256^3 double", dense.voxels(), threads, median(in_double),
         median(in_double) / dense.voxels() / sweep, "-");
    line("  to one step at a time", dense.voxels(), threads, median(in_double),
         median(in_double) / dense.voxels() / alone, "-");
    line("peer dense 256^3 float", dense.voxels(), threads, median(in_float),
         median(in_float) / dense.voxels() / sweep, "-");
    line("peer ValueAccessor double", voxels, threads, median(looked_up),
         median(looked_up) / voxels / sweep, fmt::format("differs by {:.1e}", difference));
}

void uniform_start(std::size_t threads)
{
    const ThreadLimit limit(threads);
    const HeatProblem problem = rock_problem(false);
    const double setup = seconds_of([&] { sparse_heat_solver(problem); });
    const auto solver = sparse_heat_solver(problem);
    const double seconds = seconds_of([&] { solver->advance(60, {}); });
    const auto values = solver->free_values();
    line("rock, set up", double(values.size()), threads, setup, 1, "-");
    line("rock, first 60 steps, each", double(values.size()), threads, seconds / 60, 1,
         hash_of(values));
}

/// The paper's size: a chevron of 32^3 cells, 2000 steps and the gradient.
void small(std::size_t threads, int repeats)
{
    const ThreadLimit limit(threads);
    IntGrid region(box_topology({0, 0, 0}, {32, 32, 32}), {}, 1);
    region.expand();
    for (std::size_t leaf = 0; leaf < region.leaf_count(); ++leaf)
        for (int i = 0; i < kLeafSize; ++i) {
            const int z = leaf_coord(region.origin(leaf), i).z;
            region.values(leaf)[i] = z < 3 || z > 28;
        }
    cooling::Params params;
    params.steps = 2000;
    std::vector<double> seconds;
    Hasher hasher;
    for (int r = 0; r < repeats; ++r) {
        cooling::Result result;
        seconds.push_back(seconds_of([&] {
            result = cooling::run({region, {Coord(32, 32, 32), {}}}, params, {}, {});
        }));
        if (r == 0)
            for (std::size_t leaf = 0; leaf < result.temperature.leaf_count(); ++leaf)
                for (int i = 0; i < kLeafSize; ++i)
                    hasher.add_value(result.temperature.at(leaf, i));
    }
    line("32^3 x 2000 steps (bar 0.5 s)", 32768, threads, median(seconds), 1, hasher.hex());
}

}  // namespace

int main(int argc, char** argv)
{
    const int repeats = argc > 1 ? std::atoi(argv[1]) : 5;
    openvdb::initialize();
    sekitei::log::set_level(sekitei::log::Level::Warning);
    fmt::print("case, voxels, threads, seconds, ratio, hash\n");
    for (const std::size_t threads : {1u, 2u}) {
        small(threads, repeats);
        uniform_start(threads);
        rock(threads, repeats);
    }
}
