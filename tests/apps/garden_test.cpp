#include "apps/render/garden.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "apps/render/camera.h"
#include "apps/render/path_tracer.h"
#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "solvers/rays/embree.h"
#include "tests/support/tufts.h"

namespace sekitei::render {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;
using namespace render::testing;

Params small()
{
    Params params;
    params.width = 64;
    params.height = 40;
    params.samples = 4;
    params.eye = Vec3d(0.15, -0.35, 0.95);
    params.target = Vec3d(0.15, 0.1, 0.7);
    params.ground_height = 0.1;
    return params;
}

TEST(Garden, OneRockAloneGivesTheBytesOfItsMesh)
{
    const TriMesh rock = plane(2, 0.7f);
    Stuff stuff;
    stuff.pieces = {{&rock, Substance::Rock}};
    EXPECT_EQ(run(stuff, small(), 3, {}).pixels, run(rock, small(), 3, {}).pixels);
    // Several pieces take another way through the code, and must come to the same.
    const TriMesh none;
    stuff.pieces.push_back({&none, Substance::Water});
    EXPECT_EQ(run(stuff, small(), 3, {}).pixels, run(rock, small(), 3, {}).pixels);
}

TEST(Garden, APictureWithMossIsTheSameOnAnyNumberOfThreads)
{
    const TriMesh rock = plane(2, 0.7f), water = plane(3, 0.2f), boards = plane(0.1f, 0.75f);
    Stuff stuff;
    stuff.pieces = {
        {&water, Substance::Water}, {&rock, Substance::Rock}, {&boards, Substance::Wood}};
    stuff.moss = scattered(200);
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return run(stuff, small(), 3, {}).pixels;
    };
    const auto one = on(1);
    EXPECT_EQ(one, on(3));
    stuff.moss.clear();
    EXPECT_NE(one, on(2));
}

TEST(Garden, MossMakesRockGreener)
{
    const TriMesh rock = plane(2, 0.7f);
    Stuff stuff;
    stuff.pieces = {{&rock, Substance::Rock}};
    auto green = [&] {
        const Image8 image = run(stuff, small(), 3, {});
        double sum = 0;  // of green over red and blue, in the middle of the picture
        for (int y = 15; y < 25; ++y)
            for (int x = 25; x < 40; ++x)
                sum += image.at(x, y, 1) - 0.5 * (image.at(x, y, 0) + image.at(x, y, 2));
        return sum / 150;
    };
    const double bare = green();
    stuff.moss = scattered(600);
    EXPECT_GT(green(), bare + 10);
}

TEST(Garden, EachTriangleHasTheSubstanceOfItsPiece)
{
    const TriMesh rock = plane(2, 0), water = plane(1, 1), leaves = plane(1, 2);
    const std::vector<Piece> pieces{
        {&rock, Substance::Rock}, {&water, Substance::Water}, {&leaves, Substance::Foliage}};
    const TriMesh all = joined(pieces);
    ASSERT_EQ(all.triangles.size(), 6u);
    EXPECT_EQ(all.vertices[all.triangles[3][1]], water.vertices[2]);
    const GardenLook look(pieces, 1);
    SurfacePoint p;
    p.normal = Vec3f(0, 0, 1);
    p.footprint = 0.001f;
    for (std::uint32_t t = 0; t < 6; ++t) {
        p.triangle = t;
        p.position = all.vertices[all.triangles[t][0]];
        const Material m = look.surface(p);
        EXPECT_EQ(m.transmit.y > 0, t >= 4) << t;
        EXPECT_EQ(m.roughness < 0.1f, t == 2 || t == 3) << t;
        if (t == 2 || t == 3) {
            EXPECT_LT(m.albedo.y, 0.03f);
            EXPECT_GT(m.normal.z, 0.99f);
        }
    }
}

TEST(Garden, PlantsThrowShadowsOnTheStone)
{
    const TriMesh mesh = plane(2, 0.7f);
    const rays::TriangleScene rays(mesh.vertices, mesh.triangles, "test");
    const std::vector<Vec3f> normals(6, Vec3f(0, 0, 1));
    const PlainLook red(Vec3f(0.5f, 0.1f, 0.1f), Vec3f(0));
    Sky sky = Sky::uniform(0, true);
    sky.set_sun(normalized(Vec3d(1, 0.2, 0.5)), 0.004, Vec3f(2));
    Tuft plant{Vec3d(0.15, 0.1, 0.7), upright(0), 1, 3};
    const Tufts tufts({plant}, kSpecies, 0.1, 1);
    World world{.mesh = mesh,
                .rays = rays,
                .normals = normals,
                .look = red,
                .sky = sky,
                .camera = make_camera(small(), mesh.bounds())};
    auto dark = [&] {  // pixels of stone alone without any sun
        const Film film =
            trace(world, {.width = 64, .height = 40, .samples = 4, .bounces = 0}, 1, {});
        int count = 0;
        for (std::size_t i = 0; i < film.radiance.size(); ++i)
            count += film.albedo[i] == Vec3f(0.5f, 0.1f, 0.1f) && film.radiance[i].x == 0;
        return count;
    };
    EXPECT_EQ(dark(), 0);
    world.tufts = &tufts;
    EXPECT_GT(dark(), 5);
}

/// Radiance of a level leaf over black ground, seen from above.
double leaf_light(Vec3d sun)
{
    class Leaf : public Look {
    public:
        Material surface(const SurfacePoint& p) const override
        {
            Material m;
            m.albedo = Vec3f(0.3f);
            m.normal = p.normal;
            m.transmit = Vec3f(0.2f);
            return m;
        }
        Material ground(const SurfacePoint& p) const override { return surface(p); }
    };
    const TriMesh mesh = plane(3, 1);
    const rays::TriangleScene rays(mesh.vertices, mesh.triangles, "test");
    const std::vector<Vec3f> normals(6, Vec3f(0, 0, 1));
    Sky sky = Sky::uniform(0, true);
    sky.set_sun(sun, 0.004, Vec3f(2));
    const Leaf leaf;
    Params params;
    params.eye = Vec3d(0, -0.1, 4);
    params.target = Vec3d(0, 0, 1);
    Bounds bounds;
    for (const Vec3f& v : mesh.vertices) bounds.add(Vec3d(v));
    const World world{.mesh = mesh,
                      .rays = rays,
                      .normals = normals,
                      .look = leaf,
                      .sky = sky,
                      .camera = make_camera(params, bounds)};
    const Film film = trace(world, {.width = 16, .height = 9, .samples = 8}, 1, {});
    return static_cast<double>(film.radiance[4 * 16 + 8].y);
}

TEST(Garden, AThinLeafPassesLightOnFromBehind)
{
    const Vec3d above = normalized(Vec3d(0.6, 0, 0.8)), below(above.x, 0, -above.z);
    // Irradiance 2 x 0.8 on either side; no ground, so that the sun may stand below.
    EXPECT_NEAR(leaf_light(above), 0.3 * 2 * 0.8 / math::kPi, 0.003);
    EXPECT_NEAR(leaf_light(below), 0.2 * 2 * 0.8 / math::kPi, 0.003);
}

TEST(Garden, MatsLieFlatOnTheStoneAndCushionsStandAsTheyAre)
{
    const Vec3d normal = normalized(Vec3d(-0.5, 0.3, 0.8));
    TriMesh slope = plane(2, 0);
    for (Vec3f& v : slope.vertices) v.z = (0.5f * v.x - 0.3f * v.y) / 0.8f;
    const rays::TriangleScene rays(slope.vertices, slope.triangles, "test");
    Tuft t;
    t.position = Vec3d(0.6, 0.3, (0.5 * 0.6 - 0.3 * 0.3) / 0.8);
    auto axis = [](const Tuft& plant, Vec3d of) {
        const Vec3d q(Vec3f(plant.orient[0], plant.orient[1], plant.orient[2]));
        const auto w = static_cast<double>(plant.orient[3]);
        const double norm = dot(q, q) + w * w;
        return of + cross(q, cross(q, of) + of * w) * (2.0 / norm);
    };
    for (const double yaw : {0.0, 1.0, 4.0})
        for (const std::int32_t species : {1, 2}) {
            t.orient = upright(yaw);
            t.species = species;
            std::vector<Tuft> moss{t};
            lay_mats(moss, kSpecies, 0.03, slope, rays);
            const Vec3d up = axis(moss[0], {0, 1, 0}), side = axis(moss[0], {1, 0, 0});
            const Vec3d old_up = axis(t, {0, 1, 0}), old_side = axis(t, {1, 0, 0});
            EXPECT_LT(length(up - (species == 2 ? normal : old_up)), 1e-6) << yaw;
            // It turned no more than it had to: about the axis across both directions.
            const Vec3d about = normalized(cross(old_up, normal));
            const double cosine = species == 2 ? dot(old_up, normal) : 1;
            EXPECT_NEAR(dot(side, old_side),
                        cosine + (1 - cosine) * std::pow(dot(old_side, about), 2), 1e-6);
        }
    t.species = 2;
    t.position.z += 1;  // nothing near
    std::vector<Tuft> moss{t};
    lay_mats(moss, kSpecies, 0.03, slope, rays);
    EXPECT_EQ(moss[0].orient, t.orient);
}

TEST(Garden, PlantsComeFromPoints)
{
    Points points;
    points.position = {{1, 2, 3}, {4, 5, 6}};
    points.attributes["orient"] =
        std::vector<std::array<float, 4>>{{0, 0, 0, 1}, {0.5f, 0.5f, 0.5f, 0.5f}};
    points.attributes["pscale"] = std::vector<float>{0.25f, 1};
    EXPECT_THAT([&] { tufts_of(points); },
                ThrowsMessage<InvalidInput>("render: points of moss have no attribute species"));
    points.attributes["species"] = std::vector<float>{1, 2};
    EXPECT_THAT([&] { tufts_of(points); },
                ThrowsMessage<InvalidInput>(
                    "render: attribute species of moss is of another type, must be int32"));
    points.attributes["species"] = std::vector<std::int32_t>{3};
    EXPECT_THAT([&] { tufts_of(points); }, ThrowsMessage<InvalidInput>(HasSubstr("has 1 values")));
    points.attributes["species"] = std::vector<std::int32_t>{3, 2};
    const auto tufts = tufts_of(points);
    ASSERT_EQ(tufts.size(), 2u);
    EXPECT_EQ(tufts[1].position, Vec3d(4, 5, 6));
    EXPECT_EQ(tufts[1].orient[3], 0.5f);
    EXPECT_EQ(tufts[0].scale, 0.25f);
    EXPECT_EQ(tufts[0].species, 3);
    EXPECT_EQ(tufts[0].growth, 0.5f);  // as its size says
    EXPECT_LT(tufts[1].growth, 2);     // never ripe unknown to its points
    EXPECT_EQ(tufts[1].age, Tuft().age);
    points.attributes["growth"] = std::vector<float>{0.5f, 3.25f};
    points.attributes["wetness"] = std::vector<float>{0.25f, 1};
    points.attributes["age"] = std::vector<std::int32_t>{4, 700};
    points.attributes["id"] = std::vector<std::int64_t>{11, 1LL << 40};
    const Tuft grown = tufts_of(points)[1];
    EXPECT_EQ(grown.growth, 3.25f);
    EXPECT_EQ(grown.wetness, 1);
    EXPECT_EQ(grown.age, 700);
    EXPECT_EQ(grown.id, 1LL << 40);
    points.attributes["age"] = std::vector<float>{4, 700};
    EXPECT_THAT([&] { tufts_of(points); },
                ThrowsMessage<InvalidInput>(
                    "render: attribute age of moss is of another type, must be int32"));
}

TEST(Garden, WhatCannotBeDrawnIsNamed)
{
    const TriMesh rock = plane(2, 0.7f), none;
    Stuff stuff;
    EXPECT_THAT([&] { run(stuff, small(), 1, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("the garden has no meshes")));
    stuff.pieces = {{&none, Substance::Water}};
    EXPECT_THAT([&] { run(stuff, small(), 1, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("the meshes have no triangles")));
    TriMesh broken = rock;
    broken.triangles[1][2] = 9;
    stuff.pieces = {{&rock, Substance::Rock}, {&broken, Substance::Water}};
    EXPECT_THAT([&] { run(stuff, small(), 1, {}); },
                ThrowsMessage<InvalidInput>(
                    "render: triangle 1 of mesh 2 names vertex 9, but the mesh has 4"));
    stuff.pieces = {{&rock, Substance::Rock}};
    stuff.moss = scattered(5);
    stuff.moss[3].species = 5;
    EXPECT_THAT([&] { run(stuff, small(), 1, {}); },
                ThrowsMessage<InvalidInput>("render: moss 3 is of species 5, must be 1 to 4"));
    stuff.moss[3].species = 1;
    stuff.moss[2].orient = {0, 0, 0, 0};
    EXPECT_THAT([&] { run(stuff, small(), 1, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("render: moss 2 at (")));
    stuff.moss_size = 0;
    EXPECT_THAT([&] { run(stuff, small(), 1, {}); },
                ThrowsMessage<InvalidParameter>("render: moss_size = 0 m, must be > 0"));
}

}  // namespace
}  // namespace sekitei::render
