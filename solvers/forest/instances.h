#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/vec.h"
#include "solvers/forest/forest.h"

/// A forest as instances of tree models.
namespace sekitei::forest {

/// Where models of trees come from: each kind of tree in some variants, each of them at some ages.
struct ModelTable {
    std::vector<int> kind;  ///< of each species of the forest, from 0
    int variants = 1, ages = 1;
    /// Of each model, (kind * variants + variant) * ages + age, in heights; 0: there is none, it
    /// died before that age.
    std::vector<double> crown_radius;

    std::size_t model(int of_kind, int variant, int age) const
    {
        return (std::size_t(of_kind) * std::size_t(variants) + std::size_t(variant)) *
                   std::size_t(ages) +
               std::size_t(age);
    }
};
/// @throws InvalidParameter  numbers of kinds, variants or models that do not fit
void validate(const ModelTable& models, std::size_t species);

struct Instance {
    std::uint64_t uid = 0;
    Vec3d position;                       ///< of the foot, world [m]
    double yaw = 0;                       ///< about z, from x to y [rad]
    Vec3d scale;                          ///< of a model of height 1; x = y
    double height = 0;                    ///< [m]
    double cone_radius = 0;               ///< t H, what it wants [m]
    double crown_radius = 0;              ///< t H R^(1/3), what it holds [m]
    double share = 0;                     ///< R
    std::int32_t species = 0, age = 0;    ///< of the tree; age in steps
    std::int32_t variant = 0, model = 0;  ///< of the models; model as ModelTable::model()

    /// Quaternion x y z w of the yaw.
    std::array<float, 4> orient() const;
};

/// The instance of one tree.
///
/// yaw = 2 pi U(uid, 0x60), variant = H2(uid, 0x61) mod variants; the age by its height in
/// proportion to its species' greatest. Scale: its height, across corrected by its crown's radius
/// over the model's, 0.7 to 1.4; of a model that died the next younger one is taken. A tree that
/// has not yet competed has R = 1.
/// @param ground  world z of its foot [m]
Instance instance_of(const Tree& tree, const Inputs& inputs, const ModelTable& models, Vec3d corner,
                     double ground);

/// All of these trees, in their order; feet stand on the ground, bilinear between pixels.
/// @param corner  world position of the domain's corner (0, 0, 0) [m]
/// @throws InvalidParameter  validate(models)
///
/// Bit-identical for any number of threads.
std::vector<Instance> instances(std::span<const Tree> trees, const Inputs& inputs,
                                const ModelTable& models, Vec3d corner = {});

}  // namespace sekitei::forest
