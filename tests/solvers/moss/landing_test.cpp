#include "solvers/moss/landing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "core/error.h"
#include "tests/solvers/moss/sites.h"
#include "tests/support/shapes.h"

namespace sekitei::moss {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr std::int32_t kLost = Landing::kLost;

std::int32_t landed(const CellLanding& landing, Vec3d at, double adhesion, Vec3d fall = {0, 0, -1})
{
    const Flight flight{at, fall};
    std::int32_t site = -7;
    landing.land({&flight, 1}, adhesion, {&site, 1});
    return site;
}

Coord voxel_at(Vec3d p)
{
    return {static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
            static_cast<int>(std::floor(p.z))};
}

/// The same rules with an exhaustive search and small steps.
std::int32_t brute_force(const Ground& g, Vec3d at, double adhesion, Vec3d fall)
{
    Vec3d p = g.box.transform.voxels(at);
    const double distance = double(GridReader<float>(g.level_set).sample(p));
    if (std::abs(distance) <= adhesion) {
        std::int32_t best = kLost;
        double nearest = 1e9;
        for (std::size_t i = 0; i < g.cells.size(); ++i) {
            const double d = length(g.cells.position[i] - at);
            if (d < nearest) nearest = d, best = static_cast<std::int32_t>(i);
        }
        return best;
    }
    if (distance < 0) return kLost;
    const double stride = fall.x == 0 ? 2e-2 : 2e-3;
    const Vec3d step = fall * (stride / length(fall));
    while (p.z > -20 && g.level_set.value(voxel_at(p)) >= 0) p += step;
    return p.z > -20 ? g.cells.index.value(voxel_at(p)) : kLost;
}

const std::map<std::string, std::function<double(Vec3d)>>& shapes_by_name()
{
    static const std::map<std::string, std::function<double(Vec3d)>> shapes = {
        {"ball", [](Vec3d p) { return length(p - Vec3d(16.2, 17.9, 13.1)) - 9.7; }},
        {"cave",
         [](Vec3d p) {
             const Vec3d c = p - Vec3d(16.2, 17.9, 13.1);
             return std::max(p.z - 26.3, 8.6 - length(c));
         }},
        {"thin plate",
         [](Vec3d p) {
             const Vec3d n = normalized(Vec3d(0.3, -0.2, 1));
             return std::abs(dot(p - Vec3d(16, 18, 14.2), n)) - 0.9;
         }},
        {"overhang",
         [](Vec3d p) {
             const double slab = std::max({std::abs(p.z - 20.4) - 1.6, p.x - 18.2});
             const double wall = p.x - 6.7, floor = p.z - 4.3;
             return std::min({slab, wall, floor});
         }},
        {"bumps", bumpy}};
    return shapes;
}

TEST(MossLanding, AgreesWithExhaustiveSearch)
{
    for (const auto& [name, shape] : shapes_by_name()) {
        const Ground g({33, 37, 31}, shape);
        int lost = 0, stuck = 0;
        for (std::uint64_t i = 0; i < 1000; ++i) {
            const Vec3d p{33 * uniform01(3, Stream("x"), i), 37 * uniform01(3, Stream("y"), i),
                          34 * uniform01(3, Stream("z"), i)};
            const Vec3d at = g.box.transform.world(p);
            const double adhesion = (i % 3 ? 0.75 : 2.9) * g.box.transform.voxel;
            const std::int32_t expected = brute_force(g, at, adhesion, {0, 0, -1});
            ASSERT_EQ(landed(g.landing, at, adhesion), expected)
                << name << ' ' << p.x << ' ' << p.y << ' ' << p.z;
            lost += expected == kLost;
            stuck += std::abs(GridReader<float>(g.level_set).sample(p)) <= adhesion;
        }
        EXPECT_GT(lost, 30) << name;
        EXPECT_GT(stuck, 30) << name;
    }
}

TEST(MossLanding, BetweenTwoCellsTheLowerNumberWins)
{
    // Powers of two, so that both are exactly as far.
    const Ground g(
        {33, 37, 31}, [](Vec3d p) { return p.z - 12.5; }, 0.25);
    for (int x = 9; x < 28; ++x) {
        const Vec3d at = g.box.transform.world({double(x), 16.25, 12.75});
        const std::int32_t low = g.cells.index.value({x - 1, 16, 11}),
                           high = g.cells.index.value({x, 16, 11});
        ASSERT_LT(low, high);
        EXPECT_EQ(landed(g.landing, at, 0.2), low);
    }
}

TEST(MossLanding, DriftingSeedsAgreeWithSmallSteps)
{
    for (const auto& [name, shape] : shapes_by_name()) {
        const Ground g({33, 37, 31}, shape);
        int corners = 0, found = 0;
        for (std::uint64_t i = 0; i < 150; ++i) {
            const Vec3d p{33 * uniform01(4, Stream("x"), i), 37 * uniform01(4, Stream("y"), i),
                          45 * uniform01(4, Stream("z"), i)};
            const Vec3d at = g.box.transform.world(p);
            const double slope = 4 * uniform01(4, Stream("s"), i);
            const Vec3d fall{slope * 0.6, slope * -0.8, -1};
            const std::int32_t expected = brute_force(g, at, 0.01, fall);
            const std::int32_t site = landed(g.landing, at, 0.01, fall);
            corners += site != expected;
            found += site != kLost;
        }
        EXPECT_LE(corners, 2) << name;  // small steps may jump over a corner of a voxel
        EXPECT_GT(found, 20) << name;
    }
}

TEST(MossLanding, DropsStraightDownOntoTheSurfaceBelow)
{
    const Vec3d centre{16.2, 17.9, 13.1};
    const Ground g({33, 37, 31}, shapes_by_name().at("ball"));
    for (std::uint64_t i = 0; i < 500; ++i) {
        const Vec3d p{33 * uniform01(5, Stream("x"), i), 37 * uniform01(5, Stream("y"), i), 30.5};
        const std::int32_t site = landed(g.landing, g.box.transform.world(p), 0.01);
        const double off = std::hypot(p.x - centre.x, p.y - centre.y);
        if (off > 9.7 + 0.71) {
            EXPECT_EQ(site, kLost);
        }
        if (off > 8.5) continue;
        ASSERT_GE(site, 0);
        const Vec3d cell = g.box.transform.voxels(g.cells.position[static_cast<std::size_t>(site)]);
        EXPECT_LE(std::max(std::abs(cell.x - p.x), std::abs(cell.y - p.y)), 0.5 + 1e-9);
        const double height = centre.z + std::sqrt(9.7 * 9.7 - std::pow(cell.x - centre.x, 2) -
                                                   std::pow(cell.y - centre.y, 2));
        EXPECT_LE(cell.z, height);
        EXPECT_GT(cell.z, height - 1.001);
    }
}

TEST(MossLanding, NothingFallsThroughAPlateOfOneVoxel)
{
    // One layer of voxels is solid, and only just.
    const Ground g({33, 37, 31},
                   [](Vec3d p) { return std::min(std::abs(p.z - 14.55) - 0.15, p.z - 3.2); });
    for (std::uint64_t i = 0; i < 500; ++i) {
        const Vec3d p{2 + 29 * uniform01(6, Stream("x"), i), 2 + 33 * uniform01(6, Stream("y"), i),
                      16 + 12 * uniform01(6, Stream("z"), i)};
        const double slope = i % 2 ? 0 : 0.3;
        const std::int32_t site =
            landed(g.landing, g.box.transform.world(p), 0.002, {slope, -slope, -1});
        if (site == kLost) {
            EXPECT_TRUE(slope > 0 && (p.x > 25 || p.y < 8));  // past the edge
            continue;
        }
        EXPECT_EQ(g.cells.voxel[static_cast<std::size_t>(site)].z, 14);
    }
}

TEST(MossLanding, CrossesEmptySpaceOfAnyDepth)
{
    // A floor and a ball 3 m above it, sparse: there is no leaf between them.
    TriMesh mesh = shapes::box({0, 0, -0.2}, {0.9, 0.8, 0.0});
    const TriMesh ball = shapes::ball({0.45, 0.4, 3}, 0.1, 4);
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), ball.vertices.begin(), ball.vertices.end());
    for (auto t : ball.triangles)
        mesh.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
    const FloatGrid level_set = level_set_from_mesh(mesh, {{-0.31, 0.17, 0.05}, 0.02}, {});
    EXPECT_LT(level_set.leaf_count(), 2000u);
    const SurfaceCells cells = surface_cells(level_set, {});
    const CellLanding landing(level_set, cells);
    auto height = [&](Vec3d at, Vec3d fall = {0, 0, -1}) {
        const std::int32_t site = landed(landing, at, 0.015, fall);
        return site < 0 ? -9 : cells.position[static_cast<std::size_t>(site)].z;
    };
    EXPECT_NEAR(height({0.45, 0.4, 50}), 3.1, 0.021);
    EXPECT_NEAR(height({0.2, 0.2, 50}), 0, 0.021);
    EXPECT_NEAR(height({0.2, 0.2, 2.2}), 0, 0.021);
    EXPECT_NEAR(height({-0.6, 0.2, 4}, {0.25, 0, -1}), 0, 0.021);
    EXPECT_NEAR(height({-2.55, 0.4, 9}, {0.5, 0, -1}), 3.05, 0.06);
    EXPECT_EQ(height({1.1, 0.2, 3}), -9);
    EXPECT_EQ(height({0.2, 0.2, 3}, {50, 0, -1}), -9);
    EXPECT_EQ(height({0.2, 0.2, 3}, {-1e12, 0, -1}), -9);
    EXPECT_EQ(height({0.45, 0.4, 3}), -9) << "inside";
    EXPECT_EQ(height({0.2, 0.2, -5}), -9) << "below everything";
    EXPECT_EQ(height({1e30, 0.2, 3}), -9);
    EXPECT_EQ(height({std::nan(""), 0.2, 3}), -9);
}

TEST(MossLanding, AWholeLeafOfStoneIsLandedOn)
{
    // Distances cut at half a voxel: every leaf is constant.
    FloatGrid block(LeafTopology::build({{8, 0, -8}}), {{0.7, 0.2, 0}, 0.04}, 0.02F);
    block.set_constant(0, -0.02F);
    const SurfaceCells cells = surface_cells(block, {});
    ASSERT_EQ(cells.size(), 8u * 8 * 8 - 6 * 6 * 6);
    const CellLanding landing(block, cells);
    for (const double slope : {0.0, 0.2}) {
        const std::int32_t site =
            landed(landing, block.transform().world({11.4, 2.5, 7.3}), 0.001, {slope, slope, -1});
        const int over = slope > 0 ? 1 : 0;
        EXPECT_EQ(site, cells.index.value({11 + over, 2 + over, -1}));
    }
    EXPECT_EQ(landed(landing, block.transform().world({7.4, 2.5, 7.3}), 0.001), kLost);
}

TEST(MossLanding, CellsOfAnotherLevelSetAreRefused)
{
    const Ground g({33, 37, 31}, bumpy), other({33, 37, 31}, bumpy, 0.03);
    EXPECT_THAT([&] { CellLanding(g.level_set, other.cells); },
                ThrowsMessage<InvalidInput>(HasSubstr("another level set")));
}

TEST(MossLanding, FeetStandOnTheSurface)
{
    const Vec3d n = normalized(Vec3d(0.4, -0.3, 1));
    const Ground g({33, 37, 31}, [&](Vec3d p) { return dot(p - Vec3d(16, 18, 15), n); });
    const Surface surface = g.surface();
    for (std::size_t i = 0; i < surface.size(); ++i)
        ASSERT_NEAR(dot(g.box.transform.voxels(surface.foot(i)) - Vec3d(16, 18, 15), n), 0, 1e-3);
}

}  // namespace
}  // namespace sekitei::moss
