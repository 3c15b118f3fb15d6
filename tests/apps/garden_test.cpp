#include "apps/garden/garden.h"

#include <gtest/gtest.h>

#include <cmath>

#include "apps/garden/lantern.h"

namespace sekitei::garden {
namespace {

constexpr double kPi = 3.14159265358979323846;

TEST(Lantern, IsAClosedManifoldWhoseFourWindowsMeet)
{
    const MeshReport report = inspect(lantern(0));
    EXPECT_TRUE(report.closed());
    EXPECT_EQ(report.zero_area, 0u);
    EXPECT_EQ(report.pieces, 2u);
    EXPECT_EQ(report.genus(), 3);
}

TEST(Lantern, HasTheVolumeAndAreaOfItsParts)
{
    const TriMesh mesh = lantern(0);
    const double tunnels = 2 * 0.32 * 0.14 * 0.14 - 0.14 * 0.14 * 0.14;
    auto frustum = [](double a, double b, double h) { return h / 3 * (a * a + a * b + b * b); };
    const double volume = 0.5 * 0.5 * 0.15 + kPi * 0.12 * 0.12 * 0.60 + 0.44 * 0.44 * 0.10 +
                          0.32 * 0.32 * 0.28 - tunnels + frustum(0.72, 0.16, 0.22) +
                          4.0 / 3 * kPi * std::pow(0.075, 3);
    EXPECT_NEAR(mesh.signed_volume() / volume, 1, 1e-3);

    const double slant = std::hypot(0.28, 0.22), shaft = kPi * 0.12 * 0.12;
    const double area = 2 * 0.25 + 4 * 0.5 * 0.15 - shaft             // base
                        + 2 * kPi * 0.12 * 0.60                       // shaft
                        + 2 * 0.44 * 0.44 - shaft - 0.32 * 0.32 + 4 * 0.44 * 0.10  // platform
                        + 4 * (0.32 * 0.28 - 0.14 * 0.14) + 4 * 0.09 * 0.14 * 4 +
                        2 * 0.14 * 0.14                               // fire box and its inside
                        + 0.72 * 0.72 - 0.32 * 0.32 + 0.16 * 0.16 + 4 * (0.72 + 0.16) / 2 * slant +
                        4 * kPi * 0.075 * 0.075;
    EXPECT_NEAR(mesh.area() / area, 1, 1e-3);
    const Bounds b = mesh.bounds();
    EXPECT_NEAR(b.upper.z, kLanternHeight, 1e-3);
    EXPECT_FLOAT_EQ(float(b.upper.x), 0.36f);
    EXPECT_FLOAT_EQ(float(b.lower.y), -0.36f);
}

TEST(Lantern, TheShaftTouchesItsCylinderFromInside)
{
    const TriMesh mesh = lantern(0);
    int on_cylinder = 0;
    for (const Vec3f p : mesh.vertices) {
        const double r = std::hypot(double(p.x), double(p.y));
        if (std::abs(r - 0.12) < 1e-6) ++on_cylinder;
    }
    EXPECT_EQ(on_cylinder, 2 * 96);
}

double at(const FloatGrid& grid, Vec3d world)
{
    GridReader<float> reader(grid);
    return reader.sample(grid.transform().voxels(world));
}

TEST(Garden, TheLanternsLevelSetHasItsDistances)
{
    const Scene scene = make({}, 1, {});
    const FloatGrid& sdf = scene.floats("surface_sdf");
    EXPECT_NEAR(at(sdf, {0, 0.12, 0.45}), 0, 1e-3);   // shaft
    EXPECT_NEAR(at(sdf, {0.15, 0, 0.45}), 0.03, 1e-3);
    EXPECT_NEAR(at(sdf, {0.23, 0.05, 0.05}), -0.02, 1e-3);  // base
    EXPECT_NEAR(at(sdf, {0.115, 0, 0.96}), 0.04, 2e-3);     // in a window, over its sill
    EXPECT_LT(at(sdf, {0.23, 0.05, -0.08}), 0);             // under the ground
    EXPECT_FALSE(scene.has("obstacle_sdf"));
    EXPECT_FALSE(scene.has("water_surface"));
}

TEST(Garden, FencesStandWhereTheExperimentsWantThem)
{
    for (const Layout layout : {Layout::Fence, Layout::SouthFence}) {
        Params p;
        p.layout = layout;
        p.fence_distance = 2.3;
        p.fence_height = 1.7;
        const Scene scene = make(p, 1, {});
        const double side = layout == Layout::Fence ? 1 : -1;
        const FloatGrid& sdf = scene.floats("obstacle_sdf");
        EXPECT_NEAR(at(sdf, {1, side * 2.3, 0.8}), 0, 2e-3);
        EXPECT_NEAR(at(sdf, {1, side * 2.5, 0.8}), 0, 2e-3);
        EXPECT_NEAR(at(sdf, {1, side * 2.4, 0.8}), -0.09, 0.012);  // sampling rounds the ridge
        EXPECT_NEAR(at(sdf, {1, side * 2.4, 1.7}), 0, 2e-3);
        EXPECT_NEAR(at(sdf, {5, side * 2.4, 0.8}), 0, 2e-3);
        EXPECT_GT(at(sdf, {1, -side * 2.4, 0.8}), 0.1);
    }
}

TEST(Garden, ThePondHasItsAreaAndLevel)
{
    Params p;
    p.layout = Layout::Pond;
    const IntGrid water = make(p, 1, {}).ints("water_surface");
    const double cell = water.transform().voxel * water.transform().voxel;
    EXPECT_NEAR(double(water.active_count()) * cell, 35, 1e-9);
    for (std::size_t leaf = 0; leaf < water.leaf_count(); ++leaf)
        water.mask(leaf).for_each([&](int offset) {
            const Coord c = leaf_coord(water.origin(leaf), offset);
            EXPECT_EQ(c.z, -1);
            const Vec3d w = water.transform().world(centre_of(c));
            EXPECT_TRUE(w.x < -1 && w.x > -6 && std::abs(w.y) < 3.5);
        });
}

TEST(Garden, TreesStandInTheSouthAndNotInThePond)
{
    Params p;
    p.layout = Layout::Garden;
    const Scene scene = make(p, 7, {});
    const FloatGrid& canopy = scene.floats("canopy_RU");
    EXPECT_GT(canopy.active_count(), 1000u);
    for (const Vec3d leaf : scene.points_of("leaves").position) {
        EXPECT_LT(leaf.y, 4.5);
        EXPECT_GT(leaf.z, 1);
        EXPECT_GT(std::hypot(leaf.x, leaf.y), 4);
    }
}

}  // namespace
}  // namespace sekitei::garden
