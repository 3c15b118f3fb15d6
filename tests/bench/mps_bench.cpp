// The particle method for the wind: particle steps a second, the Poisson solve included.
// Prints `case, particles, threads, seconds, rate, hash`; `seconds` is the wall time of a step, the
// median over a run after a start that is not measured; `rate` counts fluid particles only.
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "core/hash.h"
#include "core/parallel.h"
#include "solvers/wind/mps.h"

namespace {

using namespace sekitei;
using namespace sekitei::wind;

/// A garden with a fence across most of the stream and a hill behind it.
mps::WindTunnel garden(double l0, Vec3d size)
{
    mps::WindTunnel tunnel;
    tunnel.size = size;
    tunnel.speed = 3;
    tunnel.solid = [=](Vec3d p) {
        const Vec3d hill = p - Vec3d(0.6 * size.x, 0.5 * size.y, 0);
        const bool fence = std::abs(p.x - 0.4 * size.x) < 0.51 * l0 && p.z < 0.25 * size.z &&
                           std::abs(p.y - 0.5 * size.y) < 0.3 * size.y;
        return fence || length(hill) < 0.15 * size.z;
    };
    return tunnel;
}

std::uint64_t hash_of(const mps::Particles& q)
{
    Hasher hasher;
    const auto add = [&](const auto& v) { hasher.add(v.data(), v.size() * sizeof v[0]); };
    add(q.position.x), add(q.position.y), add(q.position.z);
    add(q.u), add(q.v), add(q.w), add(q.pressure);
    return hasher.low64();
}

void run(const char* name, double l0, Vec3d size, std::size_t threads, int warm, int steps)
{
    const ThreadLimit limit(threads);
    mps::Simulation wind(mps::Settings::air(3, l0, 3), garden(l0, size));
    for (int i = 0; i < warm; ++i) wind.step();
    std::vector<double> seconds;
    double iterations = 0, unknowns = 0;
    for (int i = 0; i < steps; ++i) {
        const auto start = std::chrono::steady_clock::now();
        const mps::StepReport report = wind.step();
        seconds.push_back(
            std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
        iterations += report.convergence.iterations;
        unknowns = double(report.unknowns);
    }
    std::sort(seconds.begin(), seconds.end());
    const double step = seconds[seconds.size() / 2];
    const double fluid = double(wind.count(mps::Kind::Fluid));
    fmt::print(
        "{:<12} {:>7.0f} {} {:.4f} {:>9.0f} {:016x}  ({} particles, {:.0f} unknowns, {:.0f} "
        "iterations, fastest step {:.4f} s)\n",
        name, fluid, threads, step, fluid / step, hash_of(wind.particles()),
        wind.particles().size(), unknowns, iterations / steps, seconds[0]);
    std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv)
{
    const int steps = argc > 1 ? std::atoi(argv[1]) : 40;
    fmt::print("case, particles, threads, seconds, rate, hash\n");
    for (const std::size_t threads : {1u, 2u}) {
        run("SL1 24x16x8", 0.5, {24, 16, 8}, threads, 60, steps);
        run("SL2 2x1.6x1.3", 0.05, {2.0, 1.6, 1.3}, threads, 60, steps);
    }
}
