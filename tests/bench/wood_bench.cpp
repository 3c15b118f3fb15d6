// From branches to wood and leaves, and rays past a rock. Prints: case, threads, seconds of the
// best round, what came out, hash.
// Arguments: generations of the table-1 tree, 40 (50: 11 505 branches); a folder to write bark.ply
// and wood.ply into.

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/mesh_io.h"
#include "core/parallel.h"
#include "core/random.h"
#include "grids/level_set.h"
#include "grids/marching_tetrahedra.h"
#include "solvers/tree/surroundings.h"
#include "solvers/tree/wood.h"
#include "tests/bench/measure.h"

namespace {

using namespace sekitei;
using namespace sekitei::tree;

struct Case {
    std::string name;
    int rounds;
    std::function<void()> work;
    std::function<std::string()> hash;
};

std::vector<float> values_of(const FloatGrid& grid)
{
    std::vector<float> list;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) list.push_back(grid.at(leaf, o));
    return list;
}

}  // namespace

int main(int argc, char** argv)
{
    const int generations = argc > 1 ? std::atoi(argv[1]) : 40;
    Grove grove({}, {Species{}}, {Plant{}}, 1);
    grove.grow(generations);
    const Branches& branches = grove.branches();
    const double unit = grove.params().unit_length;
    const std::vector<double> radius = thickness(branches, grove.species(), grove.plants());
    fmt::print("{} branches, {} tips, trunk {:.3f} m thick\n", branches.size(), grove.tips(),
               2 * radius[0]);

    TriMesh bark;
    FloatGrid wood;
    Leaves foliage;
    Canopy fog;
    std::vector<Case> cases;
    cases.push_back({"bark", 5, [&] { bark = bark_tubes(branches, radius, unit, {}, {}); },
                     [&] {
                         return fmt::format("{} triangles  {}", bark.triangles.size(),
                                            bench::hash_of(bark.vertices));
                     }});
    for (const double voxel : {0.02, 0.005})
        cases.push_back({fmt::format("wood at {} m", voxel), 3,
                         [&, voxel] { wood = wood_level_set(branches, radius, unit, voxel, {}); },
                         [&] {
                             return fmt::format("{} leaves  {}", wood.leaf_count(),
                                                bench::hash_of(values_of(wood)));
                         }});
    cases.push_back({"leaves", 5, [&] { foliage = leaves(grove, 1); },
                     [&] {
                         return fmt::format("{} leaves  {}", foliage.area.size(),
                                            bench::hash_of(foliage.normal));
                     }});
    cases.push_back({"canopy at 0.1 m", 3, [&] { fog = canopy(grove, 0.1, {}); },
                     [&] { return bench::hash_of(values_of(fog.leaf_area_density)); }});

    // Half-lines from places around a boulder, and through the canopy.
    const TriMesh rock = read_mesh(SEKITEI_DATA "/meshes/boulder.ply");
    const FloatGrid grid = level_set_from_mesh(rock, {rock.bounds().lower - Vec3d(0.2), 0.02}, {});
    const auto by_grid = level_set_obstacle(grid);
    const auto by_mesh = mesh_obstacle(rock, by_grid->reach(), {});
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    constexpr std::size_t kPlaces = 4000;
    std::vector<double> seen(kPlaces * sky.size());
    auto look = [&](const std::function<double(Vec3d, Vec3d)>& what, Vec3d lower, Vec3d upper) {
        parallel_for(kPlaces, [&](std::size_t i) {
            Vec3d at;
            for (int k = 0; k < 3; ++k)
                at[k] = lower[k] + (upper[k] - lower[k]) * uniform_of_key(i, std::uint64_t(k));
            for (std::size_t p = 0; p < sky.size(); ++p)
                seen[i * sky.size() + p] = what(at, sky.direction[p]);
        });
    };
    auto rays = [&](std::string name, int rounds, std::function<double(Vec3d, Vec3d)> what,
                    Vec3d lower, Vec3d upper) {
        cases.push_back({fmt::format("{} half-lines: {}", seen.size(), name), rounds,
                         [&look, what, lower, upper] { look(what, lower, upper); },
                         [&] { return bench::hash_of(seen); }});
    };
    const Bounds box = rock.bounds();
    for (const auto& [name, obstacle] :
         {std::pair{"level set", by_grid.get()}, std::pair{"mesh", by_mesh.get()}})
        rays(
            name, 3, [o = obstacle](Vec3d at, Vec3d way) { return double(o->blocks(at, way)); },
            box.lower - Vec3d(0.3), box.upper + Vec3d(0.3));
    const Canopy stand = canopy(grove, 0.2, {});
    const BackgroundShade shade(stand.leaf_area_density, 0.5);
    rays(
        "shade", 3, [&](Vec3d at, Vec3d way) { return shade.transmittance(at, way); },
        Vec3d(-8, -8, 0), Vec3d(8, 8, 8));

    const auto rounds = bench::in_turn(cases);
    for (std::size_t c = 0; c < cases.size(); ++c)
        for (const std::size_t threads : {1u, 2u}) {
            const bench::Rounds& r = rounds[2 * c + threads - 1];
            fmt::print("{:30} threads {} {:8.4f} s  cpu {:8.4f} s  {}\n", cases[c].name, threads,
                       *std::min_element(r.seconds.begin(), r.seconds.end()),
                       *std::min_element(r.processor.begin(), r.processor.end()), r.hash);
        }
    if (argc > 2) {
        const std::filesystem::path folder = argv[2];
        write_mesh(folder / "bark.ply", bark);
        TriMesh solid =
            marching_tetrahedra(wood_level_set(branches, radius, unit, 0.005, {}), 0, {});
        for (auto& t : solid.triangles) std::swap(t[1], t[2]);  // inside is negative
        write_mesh(folder / "wood.ply", solid);
    }
}
