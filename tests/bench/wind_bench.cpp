// The wind of one direction by particles and by the grid, on the same boxes and times.
// Prints `case, cells, threads, seconds, ratio, hash`: seconds for the whole run of a direction
// (particles: from the median step of a short run), ratio particles / grid.
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "core/hash.h"
#include "core/parallel.h"
#include "solvers/wind/grid_wind.h"
#include "solvers/wind/mps.h"

namespace {

using namespace sekitei;
using namespace sekitei::wind;
using Clock = std::chrono::steady_clock;

double since(Clock::time_point start)
{
    return std::chrono::duration<double>(Clock::now() - start).count();
}

/// A garden with a fence, or a block in its box.
WindTunnel scene(Vec3d size)
{
    WindTunnel tunnel;
    tunnel.size = size;
    tunnel.solid = [=](Vec3d p) {
        return std::abs(p.x - 0.48 * size.x) < 0.011 * size.x && p.z < 0.25 * size.z &&
               std::abs(p.y - 0.5 * size.y) < 0.31 * size.y;
    };
    return tunnel;
}

/// A step of particles, the median after some that are not measured [s]; and their time step.
std::pair<double, double> particle_step(double l0, Vec3d size, int steps)
{
    mps::Simulation wind(mps::Settings::air(3, l0, 3), scene(size));
    for (int i = 0; i < 60; ++i) wind.step();
    std::vector<double> seconds;
    const double begin = wind.time();
    for (int i = 0; i < steps; ++i) {
        const auto start = Clock::now();
        wind.step();
        seconds.push_back(since(start));
    }
    std::nth_element(seconds.begin(), seconds.begin() + steps / 2, seconds.end());
    return {seconds[std::size_t(steps / 2)], (wind.time() - begin) / steps};
}

void compare(const char* name, double l0, Vec3d size, std::size_t threads, int rounds, int steps)
{
    const ThreadLimit limit(threads);
    const double end = size.x / 3 + 18 * (l0 / 0.5);
    std::vector<double> grid, particles;
    std::uint64_t hash = 0;
    double cells = 0, count = 0;
    for (int round = 0; round < rounds; ++round) {
        const auto start = Clock::now();
        grid::Simulation wind(grid::Settings::air(l0, 3), scene(size));
        wind.run_until(end);
        grid.push_back(since(start));
        cells = double(wind.air_cells()), count = double(wind.steps());
        Hasher hasher;
        const Coord n = wind.size();
        for (int i = 0; i < n.x; ++i)
            for (int j = 0; j < n.y; ++j)
                for (int k = 0; k < n.z; ++k) {
                    const Vec3d u = wind.velocity({i, j, k});
                    hasher.add(&u, sizeof u);
                }
        hash = hasher.low64();
        const auto [step, dt] = particle_step(l0, size, steps);
        particles.push_back(step * end / dt);
    }
    const auto median = [](std::vector<double>& v) {
        std::nth_element(v.begin(), v.begin() + std::ptrdiff_t(v.size() / 2), v.end());
        return v[v.size() / 2];
    };
    const double quick = median(grid), slow = median(particles);
    fmt::print(
        "{:<14} {:>7.0f} {} {:>8.2f} {:>6.1f} {:016x}  ({:.2f} ms a step; particles {:.1f} s)\n",
        name, cells, threads, quick, slow / quick, hash, 1e3 * quick / count, slow);
    std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv)
{
    const int rounds = argc > 1 ? std::atoi(argv[1]) : 5;
    const int steps = argc > 2 ? std::atoi(argv[2]) : 20;
    fmt::print("case, cells, threads, seconds, ratio, hash\n");
    for (const std::size_t threads : {1u, 2u}) {
        compare("garden 24x16x8", 0.5, {24, 16, 8}, threads, rounds, steps);
        compare("object 1.5 m", 0.05, {1.55, 1.55, 1.9}, threads, rounds, steps);
    }
}
