#include "grids/surface_cells.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <set>

#include "core/error.h"
#include "core/random.h"
#include "grids/level_set.h"

namespace sekitei {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr double kVoxel = 0.02;
constexpr Domain kBox{{37, 44, 29}, {{1.5, -2, 0.3}, kVoxel}};

/// A level set on the box and one leaf beyond; f in voxels.
FloatGrid level_set(const std::function<double(Vec3d)>& f, const Domain& box = kBox)
{
    return level_set_from_function(box, f, {}, {.steepness = 1, .is_distance = true});
}

FloatGrid plane(Vec3d normal, double height)
{
    const Vec3d through{18.3, 21.9, height};
    return level_set([=](Vec3d p) { return dot(p - through, normal); });
}

FloatGrid ball(double radius)
{
    const int edge = static_cast<int>(2 * radius) + 8;
    const Domain box{{edge, edge, edge}, {{1, 2, 3}, kVoxel}};
    const Vec3d centre{edge / 2 + 0.3, edge / 2 - 0.2, edge / 2 + 0.1};
    return level_set([=](Vec3d p) { return length(p - centre) - radius; }, box);
}

/// Lumps, thin in places: every kind of corner.
FloatGrid lumps()
{
    FloatGrid grid = level_set([](Vec3d p) {
        return 0.9 * (std::sin(p.x * 0.7) + std::sin(p.y * 0.5) + std::cos(p.z * 0.9) + 0.4);
    });
    return grid;
}

TEST(SurfaceCells, AreSolidVoxelsBesideAir)
{
    const FloatGrid surface = lumps();
    const SurfaceCells cells = surface_cells(surface, {});
    std::size_t expected = 0;
    for (int x = -16; x < 64; ++x)
        for (int y = -16; y < 64; ++y)
            for (int z = -16; z < 48; ++z) {
                const Coord c{x, y, z};
                bool cell = surface.value(c) < 0;
                cell = cell && (surface.value(c + Coord(1, 0, 0)) >= 0 ||
                                surface.value(c - Coord(1, 0, 0)) >= 0 ||
                                surface.value(c + Coord(0, 1, 0)) >= 0 ||
                                surface.value(c - Coord(0, 1, 0)) >= 0 ||
                                surface.value(c + Coord(0, 0, 1)) >= 0 ||
                                surface.value(c - Coord(0, 0, 1)) >= 0);
                ASSERT_EQ(cells.index.active(c), cell) << x << ' ' << y << ' ' << z;
                expected += cell;
            }
    EXPECT_EQ(cells.size(), expected);
    EXPECT_GT(expected, 5000u);
    for (std::size_t i = 0; i < cells.size(); ++i) {
        ASSERT_EQ(cells.index.value(cells.voxel[i]), static_cast<std::int32_t>(i));
        ASSERT_EQ(cells.sdf[i], std::max(surface.value(cells.voxel[i]),
                                         -static_cast<float>(cells.transform.voxel)));
        ASSERT_EQ(cells.position[i], cells.transform.world(centre_of(cells.voxel[i])));
        ASSERT_NEAR(length(cells.normal[i]), 1, 1e-6);
    }
}

TEST(SurfaceCells, FollowTheOrderOfLeavesAndOffsets)
{
    const SurfaceCells cells = surface_cells(lumps(), {});
    auto key = [](Coord c) { return std::pair(leaf_origin(c), leaf_offset(c)); };
    for (std::size_t i = 1; i < cells.size(); ++i)
        ASSERT_LT(key(cells.voxel[i - 1]), key(cells.voxel[i]));
}

TEST(SurfaceCells, AddUpToTheAreaOfAnyPlane)
{
    for (const Vec3d direction : {Vec3d(0, 0, 1), Vec3d(0.3, -0.2, 0.9), Vec3d(-0.55, 0.5, 0.62),
                                  Vec3d(1, 1, 1.0001), Vec3d(0.4, 0.45, -0.8)}) {
        const Vec3d n = normalized(direction);
        const SurfaceCells cells = surface_cells(plane(n, 14.4), {}, kBox);
        double area = 0;
        for (std::size_t i = 0; i < cells.size(); ++i) {
            const Coord c = cells.voxel[i];
            if (c.x < 14 || c.x >= 23 || c.y < 17 || c.y >= 27) continue;
            area += double(cells.area[i]);
            ASSERT_NEAR(dot(Vec3d(cells.normal[i]), n), 1, 1e-6);
            // A quarter of a voxel above the plane.
            const Vec3d start = cells.transform.voxels(cells.ray_origin(i));
            ASSERT_NEAR(dot(start - Vec3d(18.3, 21.9, 14.4), n), 0.25, 1e-4);
        }
        EXPECT_NEAR(area, 9 * 10 * kVoxel * kVoxel / std::abs(n.z), 1e-7) << n.x << ' ' << n.y;
    }
}

TEST(SurfaceCells, MissLittleOfABall)
{
    // The centres lie inset, by half a voxel on average.
    for (const auto& [radius, error] : {std::pair(25.0, -0.025), std::pair(50.0, -0.013)}) {
        const SurfaceCells cells = surface_cells(ball(radius), {});
        double area = 0;
        for (const float a : cells.area) area += double(a);
        const double exact = 4 * std::numbers::pi * radius * radius * kVoxel * kVoxel;
        EXPECT_NEAR(area / exact - 1, error, 0.004);
    }
}

TEST(SurfaceCells, NeighboursAreAllCellsWithinOneVoxel)
{
    const SurfaceCells cells = surface_cells(lumps(), {});
    ASSERT_EQ(cells.neighbour_begin.size(), cells.size() + 1);
    ASSERT_EQ(cells.neighbour_begin.back(), cells.neighbour.size());
    for (std::size_t i = 0; i < cells.size(); ++i) {
        std::set<std::uint32_t> expected;
        for (int d = 0; d < 27; ++d) {
            const std::int32_t j =
                cells.index.value(cells.voxel[i] + Coord(d / 9 - 1, d / 3 % 3 - 1, d % 3 - 1));
            if (d != 13 && j >= 0) expected.insert(static_cast<std::uint32_t>(j));
        }
        const std::vector<std::uint32_t> found(
            cells.neighbour.begin() + cells.neighbour_begin[i],
            cells.neighbour.begin() + cells.neighbour_begin[i + 1]);
        ASSERT_EQ(found, std::vector<std::uint32_t>(expected.begin(), expected.end()));
    }
}

TEST(SurfaceCells, ValuesGoToGridsAndBack)
{
    const SurfaceCells cells = surface_cells(lumps(), {});
    std::vector<float> heights;
    std::vector<std::int32_t> numbers;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        heights.push_back(static_cast<float>(cells.position[i].z));
        numbers.push_back(static_cast<std::int32_t>(i * 7));
    }
    const FloatGrid grid = cells.to_grid(heights);
    EXPECT_EQ(grid.active_count(), cells.size());
    EXPECT_EQ(grid.transform(), cells.transform);
    EXPECT_EQ(cells.from_grid(grid, -1.0f), heights);
    EXPECT_EQ(cells.from_grid(cells.to_grid(numbers), -1), numbers);
    const VectorGrid normals = cells.to_grid(cells.normal);
    EXPECT_EQ(normals.value(cells.voxel[5]), cells.normal[5]);
    // Where a grid knows nothing.
    FloatGrid holed = grid;
    holed.expand();
    holed.mask(0) = {};
    const std::vector<float> some = cells.from_grid(holed, -9.0f);
    EXPECT_EQ(some.front(), -9.0f);
    EXPECT_EQ(some.back(), heights.back());
}

TEST(SurfaceCells, ComeBackFromTheirGrids)
{
    const FloatGrid surface = lumps();
    const SurfaceCells cells = surface_cells(surface, {}, kBox);
    const SurfaceCells again =
        surface_cells(surface, cells.to_grid(cells.normal), cells.to_grid(cells.area), {});
    EXPECT_EQ(again.voxel, cells.voxel);
    EXPECT_EQ(again.position, cells.position);
    EXPECT_EQ(again.normal, cells.normal);
    EXPECT_EQ(again.area, cells.area);
    EXPECT_EQ(again.neighbour_begin, cells.neighbour_begin);
    EXPECT_EQ(again.neighbour, cells.neighbour);
    std::vector<float> flat(cells.area);
    flat[3] = 0;
    EXPECT_THAT(
        [&] { surface_cells(surface, cells.to_grid(cells.normal), cells.to_grid(flat), {}); },
        ThrowsMessage<InvalidInput>(HasSubstr("has the area 0 m^2")));
}

TEST(SurfaceCells, LeaveOutWhatIsOnlyCutByTheBox)
{
    const Vec3d n = normalized(Vec3d(0.3, -0.2, 0.9));
    const FloatGrid open = plane(n, 14.4);
    // The same block, closed at the walls and at the bottom.
    const FloatGrid closed = level_set([&](Vec3d p) {
        const Vec3d out = max(-p, p - Vec3d(kBox.dims));
        return std::max(dot(p - Vec3d(18.3, 21.9, 14.4), n), std::max({out.x, out.y, -p.z}));
    });
    const SurfaceCells a = surface_cells(open, {}, kBox), b = surface_cells(closed, {}, kBox);
    EXPECT_EQ(a.size(), std::size_t(37 * 44));  // one a column
    EXPECT_EQ(a.voxel, b.voxel);
    for (std::size_t i = 0; i < b.size(); ++i) {
        ASSERT_GT(dot(Vec3d(b.normal[i]), n), 0.99) << b.voxel[i].x << ' ' << b.voxel[i].y;
        ASSERT_NEAR(b.sdf[i], a.sdf[i], 0.1 * kVoxel);
    }
    EXPECT_GT(surface_cells(closed, {}).size(), b.size() + 2 * (37 + 44) * 8);
}

TEST(SurfaceCells, OfAThinSheetFaceUpwardsWhereNothingElseTells)
{
    FloatGrid sheet(box_topology({0, 0, 0}, {16, 16, 16}), {{0, 0, 0}, kVoxel}, 0.08f);
    sheet.expand();
    for (std::size_t leaf = 0; leaf < sheet.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) {
            const Coord c = leaf_coord(sheet.origin(leaf), o);
            if (c.z == 9 && c.x > 2 && c.x < 12 && c.y > 3 && c.y < 11)
                sheet.values(leaf)[o] = -0.01f;
            else
                sheet.values(leaf)[o] = 0.01f;
        }
    const SurfaceCells cells = surface_cells(sheet, {});
    const std::int32_t middle = cells.index.value({7, 7, 9});
    ASSERT_GE(middle, 0);
    EXPECT_EQ(cells.normal[static_cast<std::size_t>(middle)], Vec3f(0, 0, 1));
}

TEST(SurfaceCells, AreTheSameOnAnyNumberOfThreads)
{
    const FloatGrid surface = lumps();
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return surface_cells(surface, {}, kBox);
    };
    const SurfaceCells one = on(1), four = on(4);
    EXPECT_EQ(one.voxel, four.voxel);
    EXPECT_EQ(one.normal, four.normal);
    EXPECT_EQ(one.area, four.area);
    EXPECT_EQ(one.neighbour_begin, four.neighbour_begin);
    EXPECT_EQ(one.neighbour, four.neighbour);
}

TEST(SurfaceCells, NameWhatIsNoLevelSet)
{
    auto of = [](FloatGrid grid) { return [grid] { surface_cells(grid, {}); }; };
    FloatGrid empty(box_topology({0, 0, 0}, {8, 8, 8}), {{0, 0, 0}, kVoxel}, 0.08f);
    EXPECT_THAT(of(empty), ThrowsMessage<InvalidInput>(HasSubstr("no_surface_cells")));
    EXPECT_THAT(of(FloatGrid()), ThrowsMessage<InvalidInput>(HasSubstr("background = 0 m")));
    FloatGrid nan = lumps();
    nan.expand();
    nan.values(3)[9] = std::numeric_limits<float>::quiet_NaN();
    EXPECT_THAT(of(nan), ThrowsMessage<InvalidInput>(HasSubstr("is not a number")));
    // A level set that ends inside its body.
    EXPECT_THAT(of(plane({0, 0, 1}, 14.4)), ThrowsMessage<InvalidInput>(HasSubstr("give its box")));
    // Temperatures in degrees centigrade have two signs as well.
    FloatGrid degrees = lumps();
    degrees.expand();
    for (std::size_t leaf = 0; leaf < degrees.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) degrees.values(leaf)[o] *= 100;
    EXPECT_THAT(of(degrees), ThrowsMessage<InvalidInput>(HasSubstr("not a level set: from cell")));
    FloatGrid flat = lumps();
    flat.set_transform({{0, 0, 0}, 0});
    EXPECT_THAT(of(flat), ThrowsMessage<InvalidInput>(HasSubstr("voxel = 0 m, must be > 0")));

    const SurfaceCells cells = surface_cells(lumps(), {});
    EXPECT_THAT([&] { cells.to_grid(std::vector<float>(3)); },
                ThrowsMessage<InvalidInput>(HasSubstr("3 values, must be")));
    EXPECT_THAT([&] { cells.from_grid(ball(9), 0.0f); },
                ThrowsMessage<InvalidInput>(HasSubstr("same lattice")));
    EXPECT_THAT(
        [&] {
            surface_cells(lumps(), {}, Domain{{9, 9, 9}, {{0, 0, 0}, kVoxel}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("same lattice")));
}

}  // namespace
}  // namespace sekitei
