#include "apps/specimens.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/stages/scenery.h"
#include "apps/trees.h"
#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/tree/wood.h"

namespace sekitei::apps {
namespace {

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

/// A leaf of two triangles, folded along its rib.
void add_blade(TriMesh& mesh, Vec3d at, const std::array<float, 4>& orient, double area,
               double slender)
{
    const double x = double(orient[0]), y = double(orient[1]), z = double(orient[2]),
                 w = double(orient[3]);
    const Vec3d ex(1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        ey(2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)), ez = cross(ex, ey);
    const double length = std::sqrt(area / slender), half = slender * length;
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    const Vec3d side = ey * (-0.08 * length) + ez * (0.22 * half);
    for (const Vec3d corner : {ey * (-0.5 * length), side + ex * half,
                               ey * (0.5 * length) - ez * (0.12 * length), side - ex * half})
        mesh.vertices.push_back(Vec3f(at + corner));
    mesh.triangles.push_back({first, first + 1, first + 2});
    mesh.triangles.push_back({first, first + 2, first + 3});
}

/// Leaf area over the ground that a full crown covers, at leaf_scale 1; conifers are deeper.
constexpr double kFullness = 0.32;

/// Bark, then leaves; the face attribute `part` tells 0 from 1. Divided by the model's height.
TriMesh mesh_of(const tree::Grove& grown, const SpecimenDetail& detail, const Specimen& model,
                const SpecimenParams& params, const Progress& progress)
{
    const double unit = grown.params().unit_length;
    std::vector<double> radius = tree::thickness(grown.branches(), grown.species(), grown.plants());
    const tree::Branches wood = thicker(grown.branches(), radius, detail.thinnest * radius[0]);
    TriMesh bark = tree::bark_tubes(wood, radius, unit, {.edge = detail.edge}, progress);
    TriMesh mesh;
    mesh.vertices = std::move(bark.vertices);
    mesh.triangles = std::move(bark.triangles);
    const std::size_t of_bark = mesh.triangles.size();
    // Fewer leaves are larger ones: the crown stays as dense as it was.
    tree::Grove grove = grown;
    tree::Species kind = grove.species()[0];
    const double alike = std::sqrt(model.leaf_area / (detail.leaves * tree::kLeafShape));
    kind.leaf_size = std::clamp(alike, detail.full ? 1e-3 : kind.leaf_size, 10.0);
    const bool needles = kind.model == tree::Model::Conifer;
    grove.set_species(0, kind);
    const tree::Leaves leaves = tree::leaves(grove, params.seed);
    const std::size_t count = leaves.position.size();
    if (!detail.full) {
        const double slender = leaf_slenderness(kind.name, needles);
        for (std::size_t i = 0; i < count; ++i)
            add_leaf(mesh, leaves.position[i], leaves.orient[i], double(leaves.area[i]), slender);
    } else {
        // Each tip has one leaf at least: of too many, some stand for all.
        const auto stride =
            std::max<std::size_t>(1, std::size_t(std::lround(double(count) / detail.leaves)));
        const double spread =
            math::kPi * model.crown_radius * model.crown_radius * model.height_m * model.height_m;
        const double full =
            params.leaf_scale * params.leaf_scale * kFullness * (needles ? 2 : 1) * spread;
        double kept = 0;
        for (std::size_t i = stride / 2; i < count; i += stride) kept += double(leaves.area[i]);
        const double more = full / kept;
        // Blades that stand for many are broader.
        const double share = std::min(1.0, detail.leaves / 20'000);
        const double slender = std::lerp(0.42, leaf_slenderness(kind.name, needles), share);
        for (std::size_t i = stride / 2; i < count; i += stride)
            add_blade(mesh, leaves.position[i], leaves.orient[i], double(leaves.area[i]) * more,
                      slender);
    }
    for (Vec3f& v : mesh.vertices) v = Vec3f(Vec3d(v) / model.height_m);
    std::vector<std::int32_t> part(mesh.triangles.size(), 1);
    std::fill_n(part.begin(), of_bark, 0);
    mesh.face_attributes["part"] = std::move(part);
    return mesh;
}

/// All ages of one variant.
void grow(const tree::Species& kind, int variant, const SpecimenParams& params,
          std::size_t first_model, std::span<const SpecimenDetail> details,
          const std::function<bool(std::size_t, std::size_t)>& wanted, Specimen* models,
          const Progress& progress)
{
    tree::Grove grove({}, {kind}, {{}}, hash2(params.seed, std::uint64_t(variant)));
    const double unit = grove.params().unit_length;
    for (std::size_t age = 0; age < params.generations.size(); ++age) {
        Specimen& model = models[age];
        model.kind = kind.name;
        model.variant = variant;
        model.generations = params.generations[age];
        model.mesh.resize(details.size());
        if (age > 0 && models[age - 1].tips == 0) continue;
        grove.grow(model.generations - grove.generation(), progress.slice(1, 1));
        model.tips = grove.tips();
        if (model.tips == 0) continue;
        // What a forest stands up: total height, crown radius and base, in heights.
        const tree::Balls balls = grove.balls();
        double height = 0, across = 0, base = 1e9;
        for (std::size_t i = 0; i < balls.size(); ++i) {
            const Vec3d c = balls.centre[i];
            const double r = balls.radius[i];
            height = std::max(height, c.z + r);
            across = std::max(across, std::hypot(c.x, c.y) + r);
            base = std::min(base, std::max(0.0, c.z - r));
            model.leaf_area +=
                tree::leaf_area(r * unit, grove.params().transmission, kind.leaf_projection);
        }
        model.height_m = height * unit;
        model.crown_radius = across / height;
        model.crown_base = base / height;
        model.trunk_diameter =
            2 * tree::thickness(grove.branches(), grove.species(), grove.plants())[0];
        for (std::size_t d = 0; d < details.size(); ++d)
            if (!wanted || wanted(first_model + age, d))
                model.mesh[d] = mesh_of(grove, details[d], model, params, progress);
    }
}

}  // namespace

tree::Species specimen_kind(const std::string& name)
{
    tree::Species kind = find_tree(name, {});
    if (kind.model == tree::Model::Shoot)
        throw InvalidParameter(fmt::format(
            "specimens: {} grows shoots from many places: there is no single tree", name));
    return kind;
}

std::vector<Specimen> grow_specimens(const std::vector<tree::Species>& kinds,
                                     const SpecimenParams& params,
                                     std::span<const SpecimenDetail> details,
                                     const std::function<bool(std::size_t, std::size_t)>& wanted,
                                     const Progress& progress)
{
    const std::size_t variants = std::size_t(std::max(0, params.variants)),
                      ages = params.generations.size();
    std::vector<Specimen> models(kinds.size() * variants * ages);
    parallel_for(kinds.size() * variants, [&](std::size_t i) {
        progress.check();
        grow(kinds[i / variants], int(i % variants), params, i * ages, details, wanted,
             &models[i * ages], progress);
    });
    return models;
}

}  // namespace sekitei::apps
