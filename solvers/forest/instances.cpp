#include "solvers/forest/instances.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"

namespace sekitei::forest {
namespace {

constexpr std::uint64_t kYaw = 0x60, kVariant = 0x61;
constexpr double kNarrowest = 0.7, kWidest = 1.4;  // that a model's crown is made

}  // namespace

void validate(const ModelTable& models, std::size_t species)
{
    if (models.kind.size() != species)
        throw InvalidParameter(
            fmt::format("forest: kinds of trees are given for {} species, there are {}",
                        models.kind.size(), species));
    if (models.variants < 1 || models.ages < 1)
        throw InvalidParameter(fmt::format("forest: {} variants of models at {} ages, must be >= 1",
                                           models.variants, models.ages));
    for (const int kind : models.kind)
        if (kind < 0 || models.model(kind + 1, 0, 0) > models.crown_radius.size())
            throw InvalidParameter(
                fmt::format("forest: kind of tree = {}, must be one of the {} models' kinds", kind,
                            models.crown_radius.size()));
    for (std::size_t m = 0; m < models.crown_radius.size(); ++m)
        if (!(models.crown_radius[m] >= 0 && std::isfinite(models.crown_radius[m])))
            throw InvalidParameter(
                fmt::format("forest: crown radius of model {} = {:.6g}, must be >= 0 heights", m,
                            models.crown_radius[m]));
}

std::array<float, 4> Instance::orient() const
{
    return {0, 0, static_cast<float>(math::sin(yaw / 2)), static_cast<float>(math::cos(yaw / 2))};
}

Instance instance_of(const Tree& tree, const Inputs& inputs, const ModelTable& models, Vec3d corner,
                     double ground)
{
    const Species& species = inputs.species[tree.species];
    Instance at;
    at.uid = tree.uid;
    at.position = {corner.x + tree.x, corner.y + tree.y, ground};
    at.yaw = 2 * math::kPi * uniform_of_key(tree.uid, kYaw);
    at.height = tree.height;
    at.share = tree.cone == 0 ? 1 : tree.share();
    at.cone_radius = slope_of(species, inputs.params.spread_mode) * tree.height;
    at.crown_radius = at.share > 0 ? at.cone_radius * math::pow(at.share, 1.0 / 3) : 0;
    at.species = tree.species;
    at.age = tree.age;
    at.variant = static_cast<std::int32_t>(hash2(tree.uid, kVariant) %
                                           static_cast<std::uint64_t>(models.variants));
    const int oldest = std::clamp(static_cast<int>(models.ages * tree.height / species.max_height),
                                  0, models.ages - 1);
    int age = oldest;
    auto radius = [&](int of_age) {
        return models.crown_radius[models.model(models.kind[tree.species], at.variant, of_age)];
    };
    while (age > 0 && radius(age) == 0) --age;
    double across = 1;
    if (radius(age) > 0)
        across = std::clamp(at.crown_radius / tree.height / radius(age), kNarrowest, kWidest);
    else
        age = oldest;
    at.model = static_cast<std::int32_t>(models.model(models.kind[tree.species], at.variant, age));
    at.scale = Vec3d(across, across, 1) * tree.height;
    return at;
}

std::vector<Instance> instances(std::span<const Tree> trees, const Inputs& inputs,
                                const ModelTable& models, Vec3d corner)
{
    validate(models, inputs.species.size());
    std::vector<Instance> list(trees.size());
    parallel_for(
        trees.size(),
        [&](std::size_t i) {
            list[i] = instance_of(trees[i], inputs, models, corner,
                                  corner.z + inputs.land.height_at(trees[i].x, trees[i].y));
        },
        1024);
    return list;
}

}  // namespace sekitei::forest
