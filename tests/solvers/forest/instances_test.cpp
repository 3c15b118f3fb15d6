#include "solvers/forest/instances.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/random.h"

namespace sekitei::forest {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

/// Three kinds, two variants, three ages; crowns of every model differ.
ModelTable table()
{
    ModelTable models{{0, 2, 1, 0, 0, 0}, 2, 3, {}};
    for (int m = 0; m < 18; ++m) models.crown_radius.push_back(0.4 + 0.01 * m);
    return models;
}

Inputs inputs()
{
    Inputs s;
    s.width = 40;
    s.depth = 20;
    s.species = table_species();
    return s;
}

Tree tree(double height, int species, std::uint64_t uid = 77)
{
    return {.x = 12.25,
            .y = 3.5,
            .height = height,
            .uid = uid,
            .kept = 65535 * 3 / 4 * 100,
            .cone = 100,
            .age = 8,
            .species = static_cast<std::uint8_t>(species)};
}

TEST(Instances, TakeYawAndVariantFromTheTreesNumber)
{
    for (const std::uint64_t uid : {1ull, 2ull, 0xFFFFFFFFFFFFFFFFull, 0x1139FD5694AAC492ull}) {
        const Instance a = instance_of(tree(20, 0, uid), inputs(), table(), {}, 0);
        EXPECT_DOUBLE_EQ(a.yaw, 2 * std::numbers::pi * double(hash2(uid, 0x60) >> 11) * 0x1p-53);
        EXPECT_EQ(a.variant, std::int32_t(hash2(uid, 0x61) % 2));
        const auto q = a.orient();
        // x turned by the quaternion about z.
        const double x = 1 - 2 * double(q[2]) * double(q[2]), y = 2 * double(q[2]) * double(q[3]);
        EXPECT_NEAR(x, std::cos(a.yaw), 1e-6);
        EXPECT_NEAR(y, std::sin(a.yaw), 1e-6);
        EXPECT_EQ(a.uid, uid);
    }
}

TEST(Instances, TakeTheModelOfTheirKindAndAge)
{
    // Species 1 (18 m) is kind 2: models 12 to 17.
    for (const auto& [height, age] :
         {std::pair(1.0, 0), {5.9, 0}, {6.1, 1}, {12.1, 2}, {18.0, 2}}) {
        const Instance a = instance_of(tree(height, 1), inputs(), table(), {}, 0);
        EXPECT_EQ(a.model, (2 * 2 + a.variant) * 3 + age) << height;
        EXPECT_EQ(a.age, 8);
        EXPECT_EQ(a.species, 1);
    }
}

TEST(Instances, AreAsHighAsTheTreeAndAsWideAsWhatItHolds)
{
    Tree t = tree(10, 0);
    t.kept = 65535 * 64;  // R = 0.64
    const Instance a = instance_of(t, inputs(), table(), {}, 0);
    const double cone = std::tan(0.5) * 10, holds = cone * std::cbrt(0.64);
    EXPECT_NEAR(a.cone_radius, cone, 1e-12);
    EXPECT_NEAR(a.crown_radius, holds, 1e-12);
    EXPECT_NEAR(a.share, 0.64, 1e-12);
    EXPECT_EQ(a.scale.z, 10);
    const double model = 0.4 + 0.01 * a.model;
    ASSERT_GT(holds / 10 / model, 0.7);
    ASSERT_LT(holds / 10 / model, 1.4);
    EXPECT_NEAR(a.scale.x * model, holds, 1e-12);
    EXPECT_EQ(a.scale.x, a.scale.y);
    EXPECT_EQ(a.height, 10);
}

TEST(Instances, BendModelsOnlySoMuch)
{
    ModelTable models = table();
    for (const auto& [radius, across] : {std::pair(0.01, 1.4), {5.0, 0.7}}) {
        models.crown_radius.assign(18, radius);
        const Instance a = instance_of(tree(10, 0), inputs(), models, {}, 0);
        EXPECT_DOUBLE_EQ(a.scale.x, 10 * across);
        EXPECT_EQ(a.scale.z, 10);
    }
}

TEST(Instances, OfModelsThatDiedAreTheYoungerOnes)
{
    ModelTable models = table();
    for (const int variant : {0, 1}) models.crown_radius[models.model(0, variant, 2)] = 0;
    EXPECT_EQ(instance_of(tree(20, 0), inputs(), models, {}, 0).model % 3, 1);
    for (double& r : models.crown_radius) r = 0;
    const Instance a = instance_of(tree(20, 0), inputs(), models, {}, 0);
    EXPECT_EQ(a.model % 3, 2);
    EXPECT_EQ(a.scale, Vec3d(20, 20, 20));
}

TEST(Instances, OfSeedlingsHoldAllTheyWant)
{
    Tree t = tree(1, 0);
    t.cone = 0;
    t.kept = 0;
    const Instance a = instance_of(t, inputs(), table(), {}, 0);
    EXPECT_EQ(a.share, 1);
    EXPECT_EQ(a.crown_radius, a.cone_radius);
    t.cone = 5;  // now it has, and kept nothing
    EXPECT_EQ(instance_of(t, inputs(), table(), {}, 0).crown_radius, 0);
}

TEST(Instances, StandOnTheGround)
{
    Inputs s = inputs();
    s.land.pixel = 1;
    s.land.ground = {40, 20, 0.0f};
    for (int j = 0; j < 20; ++j)
        for (int i = 0; i < 40; ++i) s.land.ground.set(i, j, float(0.5 * (i + 0.5) - (j + 0.5)));
    const std::vector<Tree> trees{tree(3, 4)};
    const auto list = instances(trees, s, table(), {1000, 2000, 30});
    EXPECT_EQ(list[0].position, Vec3d(1012.25, 2003.5, 30 + 0.5 * 12.25 - 3.5));
}

TEST(Instances, NameModelsThatDoNotFit)
{
    ModelTable models = table();
    models.kind.pop_back();
    EXPECT_THAT([&] { instances({}, inputs(), models); },
                ThrowsMessage<InvalidParameter>(HasSubstr("5 species, there are 6")));
    models = table();
    models.kind[2] = 3;
    EXPECT_THAT([&] { validate(models, 6); },
                ThrowsMessage<InvalidParameter>(HasSubstr("kind of tree = 3")));
    models = table();
    models.crown_radius[4] = -1;
    EXPECT_THAT([&] { validate(models, 6); },
                ThrowsMessage<InvalidParameter>(HasSubstr("crown radius of model 4 = -1")));
    EXPECT_THROW(validate(ModelTable{{0}, 0, 3, {}}, 1), InvalidParameter);
}

}  // namespace
}  // namespace sekitei::forest
