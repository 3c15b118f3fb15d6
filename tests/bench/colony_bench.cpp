// A day of individuals on meshes. First on a floor of 33 k sites with 16 k mosses, all ripe and
// shedding, with the soil day of the same sites as its peer; then on a rock of a million triangles
// with 100,000 mosses. Prints: case, sites, plants, seeds, threads, seconds, hash.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string>
#include <vector>

#include "core/hash.h"
#include "core/math.h"
#include "core/mesh_sites.h"
#include "core/noise.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/moss/colony.h"
#include "solvers/soil/soil.h"
#include "tests/bench/measure.h"
#include "tests/bench/soil_sites.h"

namespace {

using namespace sekitei;
using bench::median;
using bench::seconds_of;
using std::ranges::min;

constexpr int kRounds = 11;

TriMesh floor_mesh(double size)
{
    TriMesh mesh;
    mesh.vertices = {{0, 0, 0}, {static_cast<float>(size), 0, 0}};
    mesh.vertices.emplace_back(Vec3d(size, size, 0));
    mesh.vertices.emplace_back(Vec3d(0, size, 0));
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    return mesh;
}

/// A ball by latitude and longitude, with bumps.
TriMesh rock(double radius, std::uint32_t rings)
{
    TriMesh mesh;
    const FractalNoise bumps{.seed = 4, .frequency = 1.5, .hurst = 0.9};
    const std::uint32_t around = 2 * rings;
    auto add = [&](double polar, double turn) {
        const Vec3d p{math::sin(polar) * math::cos(turn), math::sin(polar) * math::sin(turn),
                      math::cos(polar)};
        mesh.vertices.emplace_back(p * (radius * (1 + 0.3 * bumps(p))));
    };
    add(0, 0);
    for (std::uint32_t i = 1; i < rings; ++i)
        for (std::uint32_t j = 0; j < around; ++j)
            add(math::kPi * i / rings, 2 * math::kPi * j / around);
    add(math::kPi, 0);
    const auto last = static_cast<std::uint32_t>(mesh.vertices.size() - 1);
    auto at = [&](std::uint32_t i, std::uint32_t j) { return 1 + (i - 1) * around + j % around; };
    for (std::uint32_t j = 0; j < around; ++j) {
        mesh.triangles.push_back({0, at(1, j), at(1, j + 1)});
        for (std::uint32_t i = 1; i + 1 < rings; ++i) {
            mesh.triangles.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
            mesh.triangles.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
        }
        mesh.triangles.push_back({at(rings - 1, j), last, at(rings - 1, j + 1)});
    }
    return mesh;
}

/// So many ripe mosses, anywhere.
moss::Colony crowd(const moss::Community& community, const moss::ColonyParams& params,
                   const moss::MeshSurface& surface, int plants)
{
    moss::Community dense = community;
    dense.propagation.initial_count = (plants + static_cast<int>(community.species.size()) - 1) /
                                      static_cast<int>(community.species.size());
    dense.propagation.initial_growth = 2.2;
    return moss::first_settlers(dense, params, surface.sites());
}

std::string hash_of(const moss::Colony& colony)
{
    return hash_hex(moss::encode({1, "", colony, {}})).substr(0, 16);
}

struct Case {
    std::string name;
    moss::ColonyParams params;
    int plants, days;
};

void measure(const Case& c, const MeshSites& sites)
{
    moss::MeshSurface surface(sites);
    const std::vector<moss::Species> species(moss::preset_species().begin(),
                                             moss::preset_species().begin() + 3);
    const moss::Community community{species, {}, {}, 7};
    moss::Colony colony = crowd(community, c.params, surface, c.plants);
    auto live = [&](moss::Colony& colony_now) {
        // All of them ripe and growing a little; seeds rest.
        const std::vector<float> plants(colony_now.plants.size(), 0.5F),
            seeds(colony_now.seeds.size(), 0.1F);
        return moss::day(colony_now, community, c.params, surface, {plants, seeds, {}, {}}, {});
    };
    for (int d = 0; d < c.days; ++d) live(colony);

    // The soil of the same sites.
    const std::size_t n = sites.size();
    const std::vector<float> air(n, 288), sky(n, 1);
    const bench::SoilSites ground{.water = std::vector<double>(n, 2.0),
                                  .rain = std::vector<double>(n, 3.0),
                                  .light = std::vector<float>(n, 60),
                                  .wind = std::vector<float>(n, 0.2F),
                                  .sky = sky,
                                  .cover = std::vector<float>(n, 0.4F),
                                  .depth = std::vector<float>(n, 30)};
    const soil::Inputs inputs = ground.inputs();
    const std::vector<float> capacity = moss::cover_capacity(c.params, sites);
    soil::Result soil_day;
    struct Row {
        std::vector<double> day, soil, cover, interior, fitness;
        std::string hash;
        std::int64_t thrown = 0;
    } rows[2];
    // Not in turns: a thread that was sent to sleep takes a while to come back.
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        for (int round = 0; round < kRounds; ++round) {
            Row& row = rows[threads - 1];
            moss::Colony now = colony;
            moss::DayStatistics s;
            row.day.push_back(seconds_of([&] { s = live(now); }));
            row.soil.push_back(seconds_of([&] { soil::run(inputs, {}, soil_day, {}); }));
            row.cover.push_back(
                seconds_of([&] { moss::cover(now.plants, c.params, sites, capacity); }));
            row.interior.push_back(seconds_of([&] { moss::interior(now.plants, c.params); }));
            row.fitness.push_back(seconds_of([&] {
                for (const moss::Individuals* all :
                     {static_cast<const moss::Individuals*>(&now.plants),
                      static_cast<const moss::Individuals*>(&now.seeds)})
                    moss::fitness(*all, community, air, sky, {});
            }));
            row.hash = hash_of(now);
            row.thrown = 0;
            for (const auto& k : s.species) row.thrown += k.gemmae + k.spores;
        }
    }
    for (std::size_t k = 0; k < 2; ++k)
        fmt::print(
            "{}, {} sites, {} plants, {} seeds, {} threads, {:.4f} s day ({} thrown), {:.4f} "
            "s soil, {:.4f} s cover, {:.4f} s interior, {:.4f} s fitness, {}\n",
            c.name, n, colony.plants.size(), colony.seeds.size(), k + 1, median(rows[k].day),
            rows[k].thrown, median(rows[k].soil), median(rows[k].cover), median(rows[k].interior),
            median(rows[k].fitness), rows[k].hash);
    const double plants = static_cast<double>(colony.plants.size() + colony.seeds.size());
    fmt::print(
        "  {:.2f} x from 1 to 2 threads (best {:.2f} x); day and soil {:.4f} s on 2, best "
        "{:.4f} s; {:.0f} bytes each in a checkpoint\n",
        median(rows[0].day) / median(rows[1].day), min(rows[0].day) / min(rows[1].day),
        median(rows[1].day) + median(rows[1].soil), min(rows[1].day) + min(rows[1].soil),
        static_cast<double>(moss::encode({1, "", colony, {}}).size()) / plants);
}

}  // namespace

/// Arguments: rings of the rock; 500, which makes a million triangles.
int main(int argc, char** argv)
{
    const std::uint32_t rings = argc > 1 ? static_cast<std::uint32_t>(std::atoi(argv[1])) : 500;
    measure({"floor", {}, 16384, 3}, mesh_sites(floor_mesh(1.81), 0.026, {}));
    measure({"floor with many seeds", {}, 16384, 30}, mesh_sites(floor_mesh(1.81), 0.026, {}));
    measure({"rock", {.cap = 100000}, 100000, 2}, mesh_sites(rock(2.5, rings), 0.5, {}));
}
