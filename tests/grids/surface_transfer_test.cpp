#include "grids/surface_transfer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"
#include "grids/level_set.h"
#include "tests/core/meshes.h"
#include "tests/support/shapes.h"

namespace sekitei {
namespace {

using testing::Each;
using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr Vec3d kOrigin{1.5, -2, 0.3};

struct Both {
    SurfaceCells cells;
    MeshSites sites;

    Both(const TriMesh& mesh, double voxel, double edge)
        : cells(surface_cells(level_set_from_mesh(mesh, {kOrigin, voxel}, {}), {})),
          sites(mesh_sites(mesh, edge, {}))
    {
    }
    Vec3d foot(std::size_t cell) const
    {
        return cells.position[cell] - Vec3d(cells.normal[cell]) * double(cells.sdf[cell]);
    }
    using Field = std::function<double(Vec3d)>;
    std::vector<float> at_cells(const Field& f) const
    {
        std::vector<float> values;
        for (std::size_t i = 0; i < cells.size(); ++i)
            values.push_back(static_cast<float>(f(foot(i))));
        return values;
    }
    std::vector<float> at_sites(const Field& f) const
    {
        std::vector<float> values;
        for (const Vec3f& p : sites.position) values.push_back(static_cast<float>(f(Vec3d(p))));
        return values;
    }
};

double total(const std::vector<float>& values, const std::vector<float>& area)
{
    double sum = 0;
    for (std::size_t i = 0; i < values.size(); ++i) sum += double(values[i]) * double(area[i]);
    return sum;
}

/// A block whose upper face is tilted; where the test looks is far from its rim.
TriMesh tilted()
{
    TriMesh mesh = shapes::box({1.6, -1.9, 0.4}, {2.6, -1.0, 0.7});
    for (Vec3f& v : mesh.vertices)
        if (v.z > 0.5F) v.z += 0.31F * (v.x - 1.6F) + 0.17F * (v.y + 1.9F);
    return mesh;
}

bool on_tilted_face(Vec3d p, Vec3f normal, double margin)
{
    return normal.z > 0.8F && p.x > 1.6 + margin && p.x < 2.6 - margin && p.y > -1.9 + margin &&
           p.y < -1.0 - margin;
}

TEST(SurfaceTransfer, AConstantFieldStaysExactlyWhatItIs)
{
    const Both both(shapes::ball({2, -1, 1}, 0.4, 3), 0.03, 0.04);
    for (const SurfaceTransfer& transfer :
         {cells_to_sites(both.cells, both.sites, {}), sites_to_cells(both.sites, both.cells, {})}) {
        EXPECT_EQ(transfer.missing(), 0u);
        const std::vector<float> values(transfer.sources, 0.1F);
        EXPECT_THAT(transfer.apply(values, -1), Each(0.1F));
        for (std::size_t i = 0; i < transfer.size(); ++i) {
            double sum = 0;
            for (std::uint32_t k = transfer.begin[i]; k < transfer.begin[i + 1]; ++k) {
                sum += double(transfer.weight[k]);
                EXPECT_GT(transfer.weight[k], 0);
                if (k > transfer.begin[i]) {
                    EXPECT_LT(transfer.source[k - 1], transfer.source[k]);
                }
            }
            EXPECT_NEAR(sum, 1, 1e-6);
        }
    }
}

TEST(SurfaceTransfer, LinearFieldsComeOutExactlyOnAPlane)
{
    const Both both(tilted(), 0.02, 0.025);
    const auto f = [](Vec3d p) { return 3 * p.x - 2 * p.y + 0.5 * p.z; };
    const auto found = cells_to_sites(both.cells, both.sites, {}).apply(both.at_cells(f), NAN);
    std::size_t seen = 0;
    for (std::size_t i = 0; i < both.sites.size(); ++i) {
        const Vec3d p(both.sites.position[i]);
        if (!on_tilted_face(p, both.sites.normal[i], 0.06)) continue;
        ++seen;
        EXPECT_NEAR(double(found[i]), f(p), 2e-5) << i;  // a gradient of 3.7 over 0.02 m is 0.07
    }
    EXPECT_GT(seen, 2000u);
}

TEST(SurfaceTransfer, CurvedFieldsConvergeAtSecondOrder)
{
    const auto f = [](Vec3d p) { return std::sin(9 * p.x) * std::cos(7 * p.y); };
    const auto worst = [&](double voxel) {
        const Both both(tilted(), voxel, 0.025);
        const auto found = cells_to_sites(both.cells, both.sites, {}).apply(both.at_cells(f), NAN);
        double error = 0;
        for (std::size_t i = 0; i < both.sites.size(); ++i)
            if (const Vec3d p(both.sites.position[i]); on_tilted_face(p, both.sites.normal[i], 0.1))
                error = std::max(error, std::abs(double(found[i]) - f(p)));
        return error;
    };
    const double coarse = worst(0.03), fine = worst(0.015);
    EXPECT_LT(fine, 0.01);
    EXPECT_GT(coarse / fine, 3.2);
}

TEST(SurfaceTransfer, SourcesAreTheAgreeingCellsWithinReach)
{
    const double voxel = 0.05;
    const Both both(shapes::ball({2, -1, 1}, 0.3, 3), voxel, 0.07);
    const SurfaceTransfer transfer = cells_to_sites(both.cells, both.sites, {});
    for (std::size_t i = 0; i < both.sites.size(); ++i) {
        std::vector<std::uint32_t> expected;
        for (std::uint32_t c = 0; c < both.cells.size(); ++c)
            if (length(both.foot(c) - Vec3d(both.sites.position[i])) < 1.5 * voxel &&
                dot(both.cells.normal[c], both.sites.normal[i]) > 0)
                expected.push_back(c);
        // None is left out but those whose weight a linear field would need below zero.
        const std::vector<std::uint32_t> found(transfer.source.begin() + transfer.begin[i],
                                               transfer.source.begin() + transfer.begin[i + 1]);
        EXPECT_TRUE(std::ranges::includes(expected, found));
        EXPECT_GE(found.size() + 1, expected.size());
    }
}

TEST(SurfaceTransfer, PiecesGoToTheNearestCell)
{
    // Sites smaller than a voxel are one piece each.
    const double voxel = 0.05;
    const Both both(shapes::ball({2.013, -1.007, 1.0211}, 0.3, 3), voxel, 0.04);
    const SurfaceTransfer transfer = sites_to_cells(both.sites, both.cells, {});
    std::vector<double> area(both.cells.size(), 0), moment(both.cells.size(), 0);
    std::vector<float> values;
    for (std::size_t i = 0; i < both.sites.size(); ++i) {
        values.push_back(static_cast<float>(uniform01(1, Stream("v"), i)));
        double nearest = INFINITY;
        std::size_t best = 0;
        for (std::size_t c = 0; c < both.cells.size(); ++c)
            if (dot(both.cells.normal[c], both.sites.normal[i]) > 0)
                if (const double d = length(both.foot(c) - Vec3d(both.sites.position[i]));
                    d < nearest) {
                    nearest = d;
                    best = c;
                }
        area[best] += double(both.sites.area[i]);
        moment[best] += double(both.sites.area[i]) * double(values[i]);
    }
    const auto found = transfer.apply(values, NAN);
    std::size_t seen = 0;
    for (std::size_t c = 0; c < both.cells.size(); ++c)
        if (area[c] > 0) {
            ++seen;
            EXPECT_NEAR(double(found[c]), moment[c] / area[c], 1e-5) << c;
        }
    EXPECT_GT(seen, both.cells.size() * 3 / 4);
}

TEST(SurfaceTransfer, LargeSitesCountByTheirPartNearACell)
{
    // Sites of ten voxels; the parts by throwing points at them.
    const Both both(shapes::ball({2.013, -1.007, 1.0211}, 0.3, 1), 0.03, 1);
    ASSERT_EQ(both.sites.size(), 32u);
    std::vector<std::vector<double>> part(both.cells.size(), std::vector<double>(32, 0));
    std::vector<double> whole(both.cells.size(), 0);
    constexpr std::uint64_t kPoints = 2000;
    for (std::size_t i = 0; i < 32; ++i)
        for (std::uint64_t k = 0; k < kPoints; ++k) {
            const double root = std::sqrt(uniform01(1, Stream("a"), 32 * k + i)),
                         b = root * uniform01(1, Stream("b"), 32 * k + i);
            const auto corner = [&](std::size_t c) {
                return Vec3d(both.sites.mesh.vertices[both.sites.mesh.triangles[i][c]]);
            };
            const Vec3d p = corner(0) * (1 - root) + corner(1) * b + corner(2) * (root - b);
            double nearest = INFINITY;
            std::size_t best = 0;
            for (std::size_t c = 0; c < both.cells.size(); ++c)
                if (const Vec3d away = both.foot(c) - p;
                    dot(away, away) < nearest &&
                    dot(both.cells.normal[c], both.sites.normal[i]) > 0) {
                    nearest = dot(away, away);
                    best = c;
                }
            part[best][i] += double(both.sites.area[i]) / kPoints;
            whole[best] += double(both.sites.area[i]) / kPoints;
        }
    const SurfaceTransfer transfer = sites_to_cells(both.sites, both.cells, {});
    double error = 0, shared = 0;
    for (std::size_t c = 0; c < both.cells.size(); ++c) {
        if (transfer.begin[c + 1] - transfer.begin[c] < 2 || whole[c] == 0) continue;
        for (std::uint32_t k = transfer.begin[c]; k < transfer.begin[c + 1]; ++k)
            error += std::abs(double(transfer.weight[k]) - part[c][transfer.source[k]] / whole[c]);
        shared += transfer.begin[c + 1] - transfer.begin[c];
    }
    EXPECT_GT(shared, 200);
    EXPECT_LT(error / shared, 0.1);  // a cell has seven pieces
}

TEST(SurfaceTransfer, WhatIsSpreadOverTheSurfaceStaysWhatItWas)
{
    // Sites from half a voxel to fifty voxels.
    const auto f = [](Vec3d p) { return 2 + std::sin(5 * p.x) + p.z; };
    for (const double edge : {0.012, 0.03, 1.0})
        for (const TriMesh& mesh : {tilted(), shapes::ball({2, -1, 1}, 0.5, 4)}) {
            const Both both(mesh, 0.02, edge);
            const auto at_sites = both.at_sites(f);
            const SurfaceTransfer to_cells = sites_to_cells(both.sites, both.cells, {});
            const auto at_cells = to_cells.apply(at_sites, NAN);
            EXPECT_EQ(to_cells.missing(), 0u);
            const double there = total(at_sites, both.sites.area);
            const double here = total(at_cells, both.cells.area) / there;
            EXPECT_NEAR(here, 1, 0.04) << edge;
            // Most of that is the area of the cells, which lie half a voxel deep.
            const double area = total(std::vector<float>(both.cells.size(), 1), both.cells.area) /
                                total(std::vector<float>(both.sites.size(), 1), both.sites.area);
            EXPECT_NEAR(here / area, 1, 0.006) << edge;
            const auto back = cells_to_sites(both.cells, both.sites, {}).apply(at_cells, NAN);
            EXPECT_NEAR(total(back, both.sites.area) / there, 1, 0.003) << edge;
        }
}

TEST(SurfaceTransfer, ABallsFieldComesBackFromItsVoxels)
{
    const auto f = [](Vec3d p) { return std::sin(4 * p.x) + 2 * p.y * p.z; };
    const auto round_trip = [&](double voxel) {
        const Both both(shapes::ball({2, -1, 1}, 0.4, 5), voxel, 0.02);
        const auto there = both.at_sites(f);
        const auto back =
            cells_to_sites(both.cells, both.sites, {})
                .apply(sites_to_cells(both.sites, both.cells, {}).apply(there, NAN), NAN);
        double square = 0;
        for (std::size_t i = 0; i < there.size(); ++i)
            square += std::pow(double(back[i]) - double(there[i]), 2);
        return std::sqrt(square / double(there.size()));
    };
    const double coarse = round_trip(0.06), fine = round_trip(0.03);
    EXPECT_LT(fine, 0.012);  // of a field from -3 to 0
    EXPECT_GT(coarse / fine, 1.8);
}

TEST(SurfaceTransfer, SidesOfAThinSlabDoNotMix)
{
    for (const double thick : {0.024, 0.036, 0.05, 0.1}) {  // a voxel is 0.03
        const Both both(shapes::box({1.7, -1.8, 0.522}, {2.5, -1.1, 0.522 + thick}), 0.03, 0.05);
        const auto f = [&](Vec3d p) { return p.z > 0.522 + thick / 2 ? 10.0 : 20.0; };
        // One layer of cells can look one way only: the other side has none.
        const auto sites = cells_to_sites(both.cells, both.sites, {}).apply(both.at_cells(f), NAN);
        for (std::size_t i = 0; i < sites.size(); ++i)
            if (const float up = both.sites.normal[i].z; std::abs(up) > 0.5F && thick > 0.03) {
                EXPECT_EQ(sites[i], up > 0 ? 10 : 20);
            }
        const auto cells = sites_to_cells(both.sites, both.cells, {}).apply(both.at_sites(f), NAN);
        for (std::size_t c = 0; c < cells.size(); ++c) {
            const Vec3d p = both.cells.position[c];  // beside the rim its wall counts, too
            if (p.x > 1.76 && p.x < 2.44 && p.y > -1.74 && p.y < -1.16) {
                EXPECT_EQ(cells[c], both.cells.normal[c].z > 0 ? 10 : 20);
            }
        }
    }
}

TEST(SurfaceTransfer, TheNearestStandsInAndBeyondItIsMissing)
{
    // Cells of a block, sites of sheets above it.
    const double voxel = 0.02;
    const TriMesh block = shapes::box({1.6, -1.9, 0.4}, {2.0, -1.5, 0.6});
    for (const double off : {2.5, 3.8, 4.2, 40.0, -2.5, -3.8, -4.2}) {
        // Above the block looking up, or below it looking down.
        const double above = std::abs(off);
        TriMesh sheet;
        const auto z = static_cast<float>((off > 0 ? 0.6 : 0.4) + off * voxel);
        sheet.vertices = {{1.7F, -1.8F, z}, {1.9F, -1.8F, z}, {1.8F, -1.6F, z}};
        sheet.triangles = {{0, 1, 2}};
        if (off < 0) sheet = shapes::inverted(sheet);
        Both both(block, voxel, 1);
        both.sites = mesh_sites(sheet, 0.05, {});
        const SurfaceTransfer up = cells_to_sites(both.cells, both.sites, {});
        EXPECT_EQ(up.missing(), above < 4 ? 0u : both.sites.size());
        EXPECT_THAT(up.apply(std::vector<float>(both.cells.size(), 3), -7),
                    Each(above < 4 ? 3 : -7));
        if (above < 4) {
            EXPECT_EQ(up.source.size(), both.sites.size());
        }
        // Such sites do not count as part of the block's surface.
        const SurfaceTransfer down = sites_to_cells(both.sites, both.cells, {});
        EXPECT_EQ(down.missing(), both.cells.size());
    }
    // A block of which one corner has no sites: its cells do as their neighbours.
    Both both(block, voxel, 0.02);
    MeshSites some = both.sites;
    const auto hidden = [](Vec3f p) { return p.x < 1.64F && p.y < -1.86F && p.z > 0.56F; };
    for (std::size_t i = 0; i < some.size(); ++i)
        if (hidden(some.position[i])) some.mesh.triangles[i] = {0, 0, 0};
    const SurfaceTransfer down = sites_to_cells(some, both.cells, {});
    EXPECT_EQ(down.missing(), 0u);
}

TEST(SurfaceTransfer, VolumesAreSampledBetweenTheirVoxels)
{
    FloatGrid grid(LeafTopology::build({{0, 0, 0}, {8, 0, 0}}), {kOrigin, 0.25}, -5.0F);
    grid.expand();
    const auto f = [](Vec3d p) { return 2 * p.x - 3 * p.y + 0.5 * p.z + 1; };
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int offset = 0; offset < kLeafSize; ++offset) {
            const Coord c = leaf_coord(grid.origin(leaf), offset);
            grid.values(leaf)[offset] = static_cast<float>(f(grid.transform().world(centre_of(c))));
        }
    std::vector<Vec3f> points;
    for (std::uint64_t i = 0; i < 500; ++i)
        points.emplace_back(Vec3d(1.7 + 3.5 * uniform01(1, Stream("x"), i),
                                  -1.8 + 1.6 * uniform01(1, Stream("y"), i),
                                  0.5 + 1.6 * uniform01(1, Stream("z"), i)));
    const auto found = sample_grid(grid, points);
    for (std::size_t i = 0; i < points.size(); ++i)
        EXPECT_NEAR(double(found[i]), f(Vec3d(points[i])), 2e-5);
    EXPECT_THAT(sample_grid(grid, std::vector<Vec3f>{{100, 0, 0}, {1e30F, 0, 0}}), Each(-5.0F));
    EXPECT_TRUE(sample_grid(grid, {}).empty());
}

TEST(SurfaceTransfer, IsBitIdenticalForAnyNumberOfThreads)
{
    const Both both(tilted(), 0.03, 0.05);
    auto on_threads = [&](std::size_t n) {
        const ThreadLimit limit(n);
        return std::pair(cells_to_sites(both.cells, both.sites, {}),
                         sites_to_cells(both.sites, both.cells, {}));
    };
    const auto one = on_threads(1), four = on_threads(4);
    for (const auto& [a, b] :
         {std::pair(&one.first, &four.first), std::pair(&one.second, &four.second)}) {
        EXPECT_EQ(a->begin, b->begin);
        EXPECT_EQ(a->source, b->source);
        EXPECT_EQ(a->weight, b->weight);
    }
}

TEST(SurfaceTransfer, NamesAWrongNumberOfValuesAndCanBeStopped)
{
    const Both both(shapes::box({1.7, -1.8, 0.5}, {2, -1.5, 0.8}), 0.05, 0.1);
    const SurfaceTransfer transfer = cells_to_sites(both.cells, both.sites, {});
    const std::size_t n = both.cells.size();
    EXPECT_THAT([&] { transfer.apply(std::vector<float>(n - 1), 0); },
                ThrowsMessage<InvalidInput>(HasSubstr("must be " + std::to_string(n))));
    const std::atomic<bool> wish = true;
    EXPECT_THROW(cells_to_sites(both.cells, both.sites, Progress(nullptr, &wish)), Cancelled);
    EXPECT_THROW(sites_to_cells(both.sites, both.cells, Progress(nullptr, &wish)), Cancelled);
}

}  // namespace
}  // namespace sekitei
