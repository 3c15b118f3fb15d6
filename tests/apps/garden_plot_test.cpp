#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "apps/exchange/assembly.h"
#include "apps/forest_maps.h"
#include "apps/garden/plot.h"
#include "apps/ground.h"
#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "grids/surface_cells.h"

namespace sekitei::garden {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

PlotParams level_ground()
{
    PlotParams p;
    p.size = {4, 3};
    p.cell = 0.05;
    p.relief = 0;
    p.land = 5;
    return p;
}

Scene plot(const PlotParams& p, const std::vector<const Scene*>& rocks = {},
           const Image16* land = nullptr)
{
    validate(p, rocks.size());
    return make_plot(p, rocks, land, 7, 1e7, {});
}

/// A block of 0.4 x 0.8 x 1.2 m between x = 1, y = 2, z = 3 and there, of two columns.
Scene block()
{
    Scene rock;
    const Transform lattice{{0, 0, 0}, 0.05};
    const Coord low(20, 40, 60), high(28, 56, 84);
    std::vector<Coord> origins;
    for (int x = 16; x < 32; x += 8)
        for (int y = 32; y < 64; y += 8)
            for (int z = 56; z < 88; z += 8) origins.push_back({x, y, z});
    const TopologyPtr topology = LeafTopology::build(std::move(origins));
    auto density = FloatGrid::uninitialised(topology, lattice, 0.0f);
    auto column = IntGrid::uninitialised(topology, lattice, -1);
    for (std::size_t leaf = 0; leaf < density.leaf_count(); ++leaf)
        for (int k = 0; k < kLeafSize; ++k) {
            const Coord c = leaf_coord(density.origin(leaf), k);
            const bool in = c.x >= low.x && c.y >= low.y && c.z >= low.z && c.x < high.x &&
                            c.y < high.y && c.z < high.z;
            density.values(leaf)[k] = in;
            column.values(leaf)[k] = in ? (c.y < 48 ? 3 : 4) : -1;
            density.mask(leaf).set(k);
            column.mask(leaf).set(k);
        }
    rock.put("density", std::move(density), "", "weather", GridClass::FogVolume);
    rock.put("component", IntGrid(column), "weather");
    rock.put("surface", IntGrid(column), "weather");
    rock.put("column", std::move(column), "joint");
    return rock;
}

TEST(Plot, LevelGroundHasOneCellForEachSquareAndNoneOutside)
{
    const Scene scene = plot(level_ground());
    const SurfaceCells cells = surface_cells(scene.floats("surface_sdf"), {}, scene.domain);
    EXPECT_EQ(cells.size(), 80u * 60u);
    double area = 0;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        EXPECT_NEAR(double(cells.normal[i].z), 1, 1e-4);
        EXPECT_NEAR(cells.position[i].z - double(cells.sdf[i]), 0, 1e-4);
        area += double(cells.area[i]);
    }
    EXPECT_NEAR(area, 12, 0.01);
    const std::vector<std::int32_t> soil = cells.from_grid(scene.ints("geology"), 0);
    for (const std::int32_t s : soil) EXPECT_EQ(s, apps::geology_of_soil("humus"));
}

TEST(Plot, APondHasItsEllipseAndNoCellsBelowItsLevel)
{
    PlotParams p = level_ground();
    p.pond = "0.4, 0.1, 2, 1.2, 30";
    p.shore = 0;
    p.bank = 0.1;
    const Scene scene = plot(p);
    const IntGrid& water = scene.ints("water_surface");
    // Water reaches 0.15 m under its banks: an ellipse that much larger all around, nearly.
    const double a = 1, b = 0.6, under = 0.15 / b;
    EXPECT_NEAR(double(water.active_count()) * 0.05 * 0.05,
                math::kPi * a * b * (1 + under) * (1 + under), 0.06);
    EXPECT_NEAR(water.transform().origin.z, -0.1, 1e-12);
    EXPECT_NEAR(scene.domain.transform.origin.z, -0.1, 1e-12);
    const SurfaceCells cells = surface_cells(scene.floats("surface_sdf"), {}, scene.domain);
    for (std::size_t i = 0; i < cells.size(); ++i) {
        EXPECT_GT(cells.position[i].z, -0.1);
        const double x = cells.position[i].x - 0.4, y = cells.position[i].y - 0.1,
                     c = math::cos(math::kPi / 6), s = math::sin(math::kPi / 6);
        const double u = (c * x + s * y) / a, v = (-s * x + c * y) / b;
        EXPECT_GT(u * u + v * v, 0.85) << "a cell in the water";
    }
    const double dry = 12 - math::kPi * a * b;
    double area = 0;
    for (std::size_t i = 0; i < cells.size(); ++i)
        area += double(cells.area[i]) * double(cells.normal[i].z);
    EXPECT_NEAR(area, dry, 0.05 * dry);  // the shore loses half a cell

    p.islet = "0.4, 0.1, 0.35";
    const Scene with = plot(p);
    EXPECT_NEAR(double(water.active_count()) - double(with.ints("water_surface").active_count()),
                math::kPi * 0.2 * 0.2 / 0.0025, 25);
}

TEST(Plot, AStoneStandsWhereItIsPutTurnedAndScaled)
{
    const Scene rock = block();
    PlotParams p = level_ground();
    p.stones = "1, -0.5, 0.3, 90, 0.5";
    const Scene scene = plot(p, {&rock});
    const TriMesh& mesh = scene.meshes.at("rock");
    const auto& surface = std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("surface"));
    const auto& column = std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("column"));
    ASSERT_EQ(surface.size(), mesh.triangles.size());
    Bounds stone;
    std::set<std::int32_t> columns;
    for (std::size_t f = 0; f < surface.size(); ++f)
        if (surface[f] != kGroundSurface) {
            for (const std::uint32_t v : mesh.triangles[f]) stone.add(Vec3d(mesh.vertices[v]));
            columns.insert(column[f]);
        }
    // 0.4 x 0.8 m become 0.4 x 0.2 m along x and y; 0.3 m of 0.6 m lie in the ground.
    EXPECT_NEAR(stone.lower.x, 1 - 0.2, 0.01);
    EXPECT_NEAR(stone.upper.x, 1 + 0.2, 0.01);
    EXPECT_NEAR(stone.lower.y, -0.5 - 0.1, 0.01);
    EXPECT_NEAR(stone.upper.y, -0.5 + 0.1, 0.01);
    EXPECT_NEAR(stone.upper.z, 0.3, 0.015);
    EXPECT_GT(stone.lower.z, -0.16) << "what the ground hides";
    EXPECT_EQ(columns, (std::set<std::int32_t>{3, 4}));

    const SurfaceCells cells = surface_cells(scene.floats("surface_sdf"), {}, scene.domain);
    const std::vector<std::int32_t> geology = cells.from_grid(scene.ints("geology"), 0);
    const std::vector<float> depth = cells.from_grid(scene.floats("soil_h"), 0);
    double stony = 0;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        const bool above = cells.position[i].z > 0.03;
        if (above) {
            EXPECT_EQ(geology[i], apps::geology_of_soil("rock"));
        }
        EXPECT_EQ(depth[i], apps::is_stone(geology[i]) ? apps::kSkinDepth : 50);
        if (apps::is_stone(geology[i])) stony += double(cells.area[i]);
    }
    // Four walls and the top.
    EXPECT_NEAR(stony, 2 * (0.4 + 0.2) * 0.3 + 0.4 * 0.2, 0.1);
    EXPECT_NEAR(double(scene.floats("blocked_height").value({0, -1, 0})), 0.3, 0.02);
    EXPECT_EQ(scene.floats("blocked_height").value({-1, 0, 0}), 0);

    // A second stone has columns of its own.
    p.stones += "; -1, 0.5, 0.3, 0, 0.5";
    const Scene both = plot(p, {&rock});
    columns.clear();
    const TriMesh& two = both.meshes.at("rock");
    const auto& kind = std::get<std::vector<std::int32_t>>(two.face_attributes.at("surface"));
    const auto& number = std::get<std::vector<std::int32_t>>(two.face_attributes.at("column"));
    for (std::size_t f = 0; f < kind.size(); ++f)
        if (kind[f] != kGroundSurface) columns.insert(number[f]);
    EXPECT_EQ(columns.size(), 4u);
}

TEST(Plot, OtherProgramsGetStonesAndSoilApart)
{
    const Scene rock = block();
    PlotParams p = level_ground();
    p.stones = "1, -0.5, 0.3, 90, 0.5";
    const Scene scene = plot(p, {&rock});
    const apps::Assembly all = apps::assemble(scene, {});
    ASSERT_EQ(all.surfaces.size(), 2u);
    EXPECT_EQ(all.surfaces[0].kind, "rock");
    EXPECT_EQ(all.surfaces[1].kind, "ground");
    const Bounds stone = all.surfaces[0].mesh().bounds();
    EXPECT_NEAR(stone.size().x, 0.4, 0.02);
    EXPECT_EQ(all.surfaces[0].mesh().triangles.size() + all.surfaces[1].mesh().triangles.size(),
              scene.meshes.at("rock").triangles.size());
}

TEST(Plot, LandFollowsItsHeightMapAndItsCuts)
{
    Image16 map(5, 4, 1);
    for (int y = 0; y < 4; ++y)
        for (int x = 0; x < 5; ++x) map.at(x, y) = std::uint16_t(x * 65535 / 4);  // rises eastwards
    PlotParams p = level_ground();
    p.height_map = "map.png";
    p.metres_per_pixel = 10;
    p.height_low = 100;
    p.height_high = 140;
    p.centre = {20, 20, 0};
    p.land = 30;
    const Scene hill = plot(p, {}, &map);
    const FloatGrid& ground = hill.floats("ground_height");
    for (const int x : {5, 15, 24, 35})
        EXPECT_NEAR(double(ground.value({x, 12, 0})), 100 + (x + 0.5 - 5), 0.5) << x;
    p.cuts = "0, 0, 110, 3, 2";
    const Scene cut = plot(p, {}, &map);
    EXPECT_NEAR(double(cut.floats("ground_height").value({20, 20, 0})), 110, 1e-3);
    EXPECT_NEAR(double(cut.floats("ground_height").value({28, 20, 0})),
                double(ground.value({28, 20, 0})), 1e-3);

    // A forest on it stands on the same ground, and keeps off the plot.
    forest::Land land;
    apps::take_land(land, cut, {40, 30, 1, {0, 5, 90}});
    EXPECT_EQ(land.ground.at(20, 15), cut.floats("ground_height").value({20, 20, 0}) - 90);
    EXPECT_EQ(land.plantable.at(20, 15), 0);
    EXPECT_EQ(land.plantable.at(20, 20), 1);
    EXPECT_EQ(land.blocked_height.at(20, 15), 0);
}

TEST(Plot, TheSameBytesOnAnyNumberOfThreads)
{
    const Scene rock = block();
    PlotParams p = level_ground();
    p.relief = 0.2;
    p.relief_wavelength = 1;
    p.stones = "-1, -0.7, 0.2, 33, 0.7";
    p.lantern = "1, 0.5, 20";
    p.pond = "0, 0, 1.5, 1";
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        const Scene scene = plot(p, {&rock});
        std::string all;
        for (const auto& [name, grid] : scene.grids) all += name + content_hash(grid);
        return std::pair(all, scene.meshes.at("rock").vertices);
    };
    const auto one = on(1);
    EXPECT_EQ(one, on(3));
}

TEST(Plot, WhatCannotBeIsNamed)
{
    auto refused = [](auto&& change, const char* words, std::size_t scenes = 1) {
        PlotParams p = level_ground();
        change(p);
        EXPECT_THAT([&] { validate(p, scenes); },
                    ThrowsMessage<InvalidParameter>(HasSubstr(words)));
    };
    refused([](PlotParams& p) { p.stones = "1"; }, "1 numbers, must be 2 to 6");
    refused([](PlotParams& p) { p.stones = "1,1,0,0,0"; }, "scale 0");
    refused([](PlotParams& p) { p.stones = "1,1,0,0,1,1"; }, "scene 1, but 1 are given");
    refused([](PlotParams& p) { p.stones = "1,1"; }, "none is given", 0);
    refused([](PlotParams& p) { p.stones = "3,0"; }, "outside the plot of 4 x 3 m");
    refused([](PlotParams& p) { p.stones = "1,two"; }, "stones = 1,two");
    refused([](PlotParams& p) { p.lantern = "0,0;1,1"; }, "must be one place");
    refused([](PlotParams& p) { p.islet = "0,0,1"; }, "there is no pond");
    refused([](PlotParams& p) { p.pond = "0,0,1,-1"; }, "width -1 m");
    refused([](PlotParams& p) { p.height_map = "x.png"; }, "metres_per_pixel");
    refused([](PlotParams& p) { p.height_low = 3; }, "there is no height_map");
    refused([](PlotParams& p) { p.size = {1, 2, 3}; }, "3 numbers");
    PlotParams p = level_ground();
    EXPECT_THAT([&] { make_plot(p, {}, nullptr, 1, 100, {}); },
                ThrowsMessage<LimitExceeded>(HasSubstr("--cell")));
}

}  // namespace
}  // namespace sekitei::garden
