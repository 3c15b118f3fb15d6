#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <vector>

#include "apps/commands/commands.h"
#include "apps/console.h"
#include "apps/stages/scenery.h"
#include "apps/trees.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/math.h"
#include "core/mesh_io.h"
#include "core/random.h"
#include "solvers/tree/wood.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

/// A level of detail: so many leaves at most, and no wood thinner than a share of the trunk.
struct Level {
    const char* name;
    double leaves, thinnest;
};
constexpr std::array<Level, 3> kLevels{
    {{"near", 20'000, 0.0}, {"middle", 2'500, 0.06}, {"far", 300, 0.15}}};

/// Branches at least so thick; what a thin one bears is thinner still.
tree::Branches thicker(const tree::Branches& all, std::vector<double>& radius, double least)
{
    tree::Branches some;
    std::vector<std::int32_t> now(all.size(), -1);
    std::vector<double> kept;
    for (std::size_t i = 0; i < all.size(); ++i) {
        const std::int32_t parent = all.parent[i];
        if (radius[i] < least || (parent >= 0 && now[std::size_t(parent)] < 0)) continue;
        now[i] = static_cast<std::int32_t>(kept.size());
        kept.push_back(radius[i]);
        some.parent.push_back(parent < 0 ? -1 : now[std::size_t(parent)]);
        some.tree.push_back(all.tree[i]);
        some.key.push_back(all.key[i]);
        some.generation.push_back(all.generation[i]);
        some.order.push_back(all.order[i]);
        some.flags.push_back(all.flags[i]);
        some.start.push_back(all.start[i]);
        some.direction.push_back(all.direction[i]);
        some.length.push_back(all.length[i]);
        some.light.push_back(all.light[i]);
        some.light_vector.push_back(all.light_vector[i]);
        some.bough.push_back(all.bough[i]);
        some.dead_tips.push_back(all.dead_tips[i]);
        some.died.push_back(all.died[i]);
    }
    radius = std::move(kept);
    return some;
}

/// Bark, then leaves; the face attribute `part` tells 0 from 1. Divided by `height`.
TriMesh model_of(const tree::Grove& grown, const Level& level, double area, double height,
                 std::uint64_t seed, const Progress& progress)
{
    const double unit = grown.params().unit_length;
    std::vector<double> radius = tree::thickness(grown.branches(), grown.species(), grown.plants());
    const tree::Branches wood = thicker(grown.branches(), radius, level.thinnest * radius[0]);
    TriMesh bark = tree::bark_tubes(wood, radius, unit, {}, progress);
    TriMesh mesh;
    mesh.vertices = std::move(bark.vertices);
    mesh.triangles = std::move(bark.triangles);
    const std::size_t of_bark = mesh.triangles.size();
    // Fewer leaves are larger ones: the crown stays as dense as it was.
    tree::Grove grove = grown;
    tree::Species kind = grove.species()[0];
    kind.leaf_size =
        std::clamp(std::sqrt(area / (level.leaves * tree::kLeafShape)), kind.leaf_size, 10.0);
    const double slender = leaf_slenderness(kind.name, kind.model == tree::Model::Conifer);
    grove.set_species(0, kind);
    const tree::Leaves leaves = tree::leaves(grove, seed);
    for (std::size_t i = 0; i < leaves.position.size(); ++i)
        add_leaf(mesh, leaves.position[i], leaves.orient[i], double(leaves.area[i]), slender);
    for (Vec3f& v : mesh.vertices) v = Vec3f(Vec3d(v) / height);
    std::vector<std::int32_t> part(mesh.triangles.size(), 1);
    std::fill_n(part.begin(), of_bark, 0);
    mesh.face_attributes["part"] = std::move(part);
    return mesh;
}

struct File {
    std::string name, bytes;
};

/// All models of one kind and their index.
std::vector<File> specimens(const tree::Species& kind, const SpecimenWords& words,
                            std::uint64_t seed, const Progress& progress)
{
    std::vector<File> files;
    Json models = Json::array();
    for (int variant = 0; variant < words.variants; ++variant) {
        tree::Grove grove({}, {kind}, {{}}, hash2(seed, std::uint64_t(variant)));
        const double unit = grove.params().unit_length;
        for (const int generations : words.generations) {
            grove.grow(generations - grove.generation(), progress.slice(1, 1));
            if (grove.tips() == 0) {
                log::warning("specimens: {} {} died out in generation {}", kind.name, variant,
                             grove.generation());
                break;
            }
            // What a forest stands up: total height, crown radius and base, in heights.
            const tree::Balls balls = grove.balls();
            double height = 0, across = 0, base = 1e9, area = 0;
            for (std::size_t i = 0; i < balls.size(); ++i) {
                const Vec3d c = balls.centre[i];
                const double r = balls.radius[i];
                height = std::max(height, c.z + r);
                across = std::max(across, std::hypot(c.x, c.y) + r);
                base = std::min(base, std::max(0.0, c.z - r));
                area +=
                    tree::leaf_area(r * unit, grove.params().transmission, kind.leaf_projection);
            }
            const double metres = height * unit;
            Json model{{"variant", variant},
                       {"generations", generations},
                       {"height_m", metres},
                       {"crown_radius", across / height},
                       {"crown_base", base / height},
                       {"leaf_area_m2", area},
                       {"trunk_diameter_m",
                        2 * tree::thickness(grove.branches(), grove.species(), grove.plants())[0]},
                       {"tips", grove.tips()}};
            for (const Level& level : kLevels) {
                const std::string name =
                    fmt::format("{}_{}_{}_{}.ply", kind.name, variant, generations, level.name);
                const TriMesh mesh = model_of(grove, level, area, metres, seed, progress);
                model["files"][level.name] = name;
                model["triangles"][level.name] = mesh.triangles.size();
                files.push_back({name, encode_mesh(mesh, ".ply", progress)});
            }
            models.push_back(std::move(model));
        }
    }
    const Json index{{"species", kind.name}, {"seed", seed}, {"models", std::move(models)}};
    files.push_back({kind.name + ".json", index.dump(2) + "\n"});
    return files;
}

}  // namespace

int command_specimens(const SpecimenWords& words, const Common& common)
{
    if (common.output.size() != 1 || !fs::is_directory(common.output.front()))
        throw InvalidParameter("specimens: say with -o FOLDER into which existing folder");
    if (words.generations.empty() || words.generations.front() < 1 ||
        !std::ranges::is_sorted(words.generations) ||
        std::ranges::adjacent_find(words.generations) != words.generations.end())
        throw InvalidParameter(
            "specimens: --generations: must be ages from 1 on, each larger than the one before");
    std::vector<tree::Species> kinds;
    for (const std::string& name : words.species) {
        kinds.push_back(find_tree(name, {}));
        if (kinds.back().model == tree::Model::Shoot)
            throw InvalidParameter(fmt::format(
                "specimens: {} grows shoots from many places: there is no single tree", name));
        const std::string& called = kinds.back().name;
        if (called.empty() || called.find_first_of("/\\") != std::string::npos)
            throw InvalidParameter(fmt::format(
                "specimens: {}: its name '{}' must be one that files can have", name, called));
        for (std::size_t k = 0; k + 1 < kinds.size(); ++k)
            if (kinds[k].name == kinds.back().name)
                throw InvalidParameter(fmt::format("specimens: --species {} is given twice", name));
    }
    const fs::path folder = common.output.front();
    auto keep = [&](const std::string& name) {
        if (!common.force && fs::exists(folder / name))
            throw InvalidParameter(
                fmt::format("{} exists; replace it with --force", (folder / name).string()));
    };
    for (const tree::Species& kind : kinds) keep(kind.name + ".json");
    const Progress progress = console_progress("specimens");
    std::vector<File> files;
    for (const tree::Species& kind : kinds)
        for (File& file : specimens(kind, words, common.seed, progress)) {
            keep(file.name);
            files.push_back(std::move(file));
        }
    Json names = Json::array();
    for (const File& file : files) {
        write_file(folder / file.name, file.bytes, progress);
        names.push_back((folder / file.name).string());
    }
    if (common.json) print(Json{{"files", names}}.dump(2) + "\n");
    log::info("wrote {} files into {}", files.size(), folder.string());
    return 0;
}

}  // namespace sekitei::apps
