#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>

#include "solvers/joints/joints.h"

namespace sekitei::joints {
namespace {

/// A rectangle at height z, not at the origin.
TriMesh rectangle(double width, double depth, double z = 17.5)
{
    const auto w = static_cast<float>(width), d = static_cast<float>(depth),
               h = static_cast<float>(z);
    TriMesh mesh;
    mesh.vertices = {{0, 0, h}, {w, 0, h}, {w, d, h}, {0, d, h}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    return mesh;
}

/// A sphere: an octahedron halved `levels` times.
TriMesh sphere(double radius, int levels)
{
    TriMesh mesh;
    auto add = [&](auto&& self, Vec3d a, Vec3d b, Vec3d c, int level) -> void {
        if (level == 0) {
            const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
            for (const Vec3d& p : {a, b, c}) mesh.vertices.push_back(Vec3f(p * radius));
            mesh.triangles.push_back({first, first + 1, first + 2});
            return;
        }
        const Vec3d ab = normalized(a + b), bc = normalized(b + c), ca = normalized(c + a);
        self(self, a, ab, ca, level - 1);
        self(self, ab, b, bc, level - 1);
        self(self, ca, bc, c, level - 1);
        self(self, ab, bc, ca, level - 1);
    };
    for (const double x : {-1.0, 1.0})
        for (const double y : {-1.0, 1.0})
            for (const double z : {-1.0, 1.0}) add(add, {x, 0, 0}, {0, y, 0}, {0, 0, z}, levels);
    return mesh;
}

double least_distance(const std::vector<Vec3d>& points)
{
    double least = INFINITY;
    for (std::size_t i = 0; i < points.size(); ++i)
        for (std::size_t j = 0; j < i; ++j) least = std::min(least, length(points[i] - points[j]));
    return least;
}

TEST(PoissonDisk, KeepsTheLeastDistanceAndFillsTheSurface)
{
    struct Case {
        TriMesh surface;
        double radius;
    };
    for (const Case& c :
         {Case{rectangle(250, 170), 10}, Case{sphere(40, 5), 7.3}, Case{sphere(23, 1), 4}}) {
        const std::vector<Vec3d> points = poisson_disk(c.surface, 0, c.radius, 11);
        EXPECT_GE(least_distance(points), c.radius);
        double farthest = 0;
        for (const auto& t : c.surface.triangles) {
            const Vec3d p0(c.surface.vertices[t[0]]), p1(c.surface.vertices[t[1]]),
                p2(c.surface.vertices[t[2]]);
            const int n = static_cast<int>(std::ceil(length(p1 - p0) / 2)) + 1;
            for (int i = 0; i <= n; ++i)
                for (int j = 0; i + j <= n; ++j) {
                    const Vec3d p = p0 + (p1 - p0) * (double(i) / n) + (p2 - p0) * (double(j) / n);
                    double nearest = INFINITY;
                    for (const Vec3d& q : points) nearest = std::min(nearest, length(p - q));
                    farthest = std::max(farthest, nearest);
                }
        }
        EXPECT_LE(farthest, 1.05 * c.radius);
        EXPECT_GT(farthest, 0.8 * c.radius);
    }
}

// Saturation of random sequential packing, as found on a torus by an independent script. Counted in
// a window away from the rim, where the rest of the rectangle takes the place of the torus.
TEST(PoissonDisk, SaturatesWhereRandomSequentialPackingDoes)
{
    auto in_window = [](double radius) {
        int count = 0;
        for (const Vec3d& p : poisson_disk(rectangle(310, 310), 0, radius, 5))
            count += p.x >= 30 && p.x < 280 && p.y >= 30 && p.y < 280;
        return count;
    };
    const int at_5 = in_window(5), at_10 = in_window(10);
    EXPECT_GE(at_5, 1560);
    EXPECT_LE(at_5, 1760);
    EXPECT_GE(at_10, 405);
    EXPECT_LE(at_10, 450);
    EXPECT_LT(poisson_disk(rectangle(200, 200), 2000, 5, 3).size(), 1800u);
}

TEST(PoissonDisk, BeginsTheSameWhateverTheCount)
{
    const TriMesh surface = rectangle(120, 90);
    const auto few = poisson_disk(surface, 20, 6, 4), more = poisson_disk(surface, 60, 6, 4);
    ASSERT_EQ(few.size(), 20u);
    ASSERT_EQ(more.size(), 60u);
    EXPECT_TRUE(std::equal(few.begin(), few.end(), more.begin()));
    EXPECT_NE(poisson_disk(surface, 20, 6, 5), few);
}

/// Chi-square of counts in cells of equal expectation.
double chi_square(const std::vector<double>& counts)
{
    const double mean = std::accumulate(counts.begin(), counts.end(), 0.0) / double(counts.size());
    double sum = 0;
    for (const double c : counts) sum += (c - mean) * (c - mean) / mean;
    return sum;
}

TEST(PoissonDisk, SpreadsUniformlyOverASphere)
{
    // Few points a throw, many throws: counts in 48 cells of equal area, 8 by height and 6 by
    // angle.
    const TriMesh surface = sphere(31, 6);
    std::vector<double> few(48), full(48);
    auto add = [](std::vector<double>& counts, const std::vector<Vec3d>& points) {
        for (const Vec3d& p : points) {
            const int band = std::clamp(int((p.z / length(p) + 1) * 4), 0, 7);
            const int sector =
                std::clamp(int((std::atan2(p.y, p.x) / std::numbers::pi + 1) * 3), 0, 5);
            ++counts[static_cast<std::size_t>(band * 6 + sector)];
        }
    };
    for (std::uint64_t run = 0; run < 300; ++run) add(few, poisson_disk(surface, 12, 5, run));
    for (std::uint64_t run = 0; run < 12; ++run) add(full, poisson_disk(surface, 0, 5, run));
    EXPECT_LT(chi_square(few), 72.4);  // p = 0.01 with 47 degrees of freedom
    EXPECT_GT(chi_square(few), 20);
    EXPECT_LT(chi_square(full), 72.4);
}

TEST(PoissonDisk, InThePlaneLiftsSeedsVerticallyAndMeasuresInPlan)
{
    // A roof of 45 degrees: distances in plan are 1 / sqrt 2 of those along the slope.
    TriMesh roof;
    roof.vertices = {{0, 0, 5}, {100, 0, 105}, {100, 60, 105}, {0, 60, 5}};
    roof.triangles = {{0, 1, 2}, {0, 2, 3}};
    const std::vector<Vec3d> points = poisson_disk_plane(roof, 40, 8, 6);
    ASSERT_EQ(points.size(), 40u);
    std::vector<Vec3d> plan;
    for (const Vec3d& p : points) {
        EXPECT_NEAR(p.z, p.x + 5, 1e-4);
        plan.push_back({p.x, p.y, 0});
    }
    EXPECT_GE(least_distance(plan), 8);
    // Two faces, up and down, share the count by their area in plan.
    TriMesh both = rectangle(100, 60, 50);
    for (const Vec3f& v : rectangle(50, 60, 10).vertices) both.vertices.push_back(v);
    both.triangles.push_back({4, 6, 5});
    both.triangles.push_back({4, 7, 6});
    const auto shared = poisson_disk_plane(both, 60, 6, 6);
    ASSERT_EQ(shared.size(), 60u);
    EXPECT_EQ(std::count_if(shared.begin(), shared.end(), [](Vec3d p) { return p.z > 30; }), 40);
}

// Realism: statistics of the Voronoi cells of seeds on a plane

struct Cell {
    std::vector<Vec3d> corners;
    std::vector<int> neighbour;  ///< across the edge that begins at each corner; -1 the rim
};

/// The exact Voronoi cell of seed i in the rectangle [0, width] x [0, depth], by cutting half
/// planes.
Cell voronoi_cell(const std::vector<Vec3d>& seeds, std::size_t i, double width, double depth)
{
    Cell cell{{{0, 0, 0}, {width, 0, 0}, {width, depth, 0}, {0, depth, 0}}, {-1, -1, -1, -1}};
    std::vector<std::pair<double, std::size_t>> others;
    for (std::size_t j = 0; j < seeds.size(); ++j)
        if (j != i && length(seeds[j] - seeds[i]) < 80)
            others.push_back({length(seeds[j] - seeds[i]), j});
    std::sort(others.begin(), others.end());
    for (const auto& [distance, j] : others) {
        const Vec3d n = seeds[j] - seeds[i], m = (seeds[j] + seeds[i]) * 0.5;
        auto side = [&](Vec3d p) { return (p.x - m.x) * n.x + (p.y - m.y) * n.y; };
        Cell cut;
        for (std::size_t k = 0; k < cell.corners.size(); ++k) {
            const Vec3d a = cell.corners[k], b = cell.corners[(k + 1) % cell.corners.size()];
            const double sa = side(a), sb = side(b);
            if (sa <= 0) {
                cut.corners.push_back(a);
                cut.neighbour.push_back(cell.neighbour[k]);
            }
            if ((sa <= 0) != (sb <= 0)) {
                cut.corners.push_back(a + (b - a) * (sa / (sa - sb)));
                cut.neighbour.push_back(sa <= 0 ? static_cast<int>(j) : cell.neighbour[k]);
            }
        }
        cell = cut;
    }
    return cell;
}

struct Statistics {
    std::array<double, 12> sides{};  ///< share of cells with this many apparent sides [%]
    double mean = 0, cv = 0, angle_sd = 0, tv = 0;
};

/// Apparent sides (walls longer than 0.15 sqrt(mean area)), area variation, corner angles, and half
/// the L1 distance to the 400 columns of Devils Postpile; cells that touch the rim are left out.
Statistics statistics(const std::vector<Vec3d>& seeds, double width, double depth)
{
    std::vector<double> areas, angles;
    std::vector<std::vector<double>> walls;
    for (std::size_t i = 0; i < seeds.size(); ++i) {
        const Cell cell = voronoi_cell(seeds, i, width, depth);
        if (std::count(cell.neighbour.begin(), cell.neighbour.end(), -1)) continue;
        double area = 0;
        const std::size_t n = cell.corners.size();
        walls.emplace_back();
        for (std::size_t k = 0; k < n; ++k) {
            const Vec3d a = cell.corners[k], b = cell.corners[(k + 1) % n],
                        before = cell.corners[(k + n - 1) % n];
            area += cross(a, b).z / 2;
            walls.back().push_back(length(b - a));
            const Vec3d u = normalized(b - a), v = normalized(before - a);
            angles.push_back(std::acos(std::clamp(dot(u, v), -1.0, 1.0)) * 180 / std::numbers::pi);
        }
        areas.push_back(area);
    }
    auto mean_of = [](const std::vector<double>& v) {
        return std::accumulate(v.begin(), v.end(), 0.0) / double(v.size());
    };
    auto deviation_of = [&](const std::vector<double>& v) {
        const double mean = mean_of(v);
        double sum = 0;
        for (const double x : v) sum += (x - mean) * (x - mean);
        return std::sqrt(sum / double(v.size()));
    };
    Statistics s;
    const double longest = 0.15 * std::sqrt(mean_of(areas));
    for (const auto& w : walls) {
        const auto n = static_cast<std::size_t>(
            std::count_if(w.begin(), w.end(), [&](double l) { return l > longest; }));
        s.sides[std::min<std::size_t>(n, 11)] += 100.0 / double(walls.size());
        s.mean += double(n) / double(walls.size());
    }
    s.cv = deviation_of(areas) / mean_of(areas);
    s.angle_sd = deviation_of(angles);
    constexpr std::array<double, 12> kPostpile{0, 0, 0, 0.5, 9.5, 37.5, 44.5, 8.0, 0, 0, 0, 0};
    for (std::size_t k = 0; k < 12; ++k) s.tv += std::abs(s.sides[k] - kPostpile[k]) / 2;
    return s;
}

Statistics after(double radius, double sweeps, std::uint64_t seed)
{
    const TriMesh surface = rectangle(500, 500, 3);
    return statistics(relax(surface, poisson_disk(surface, 1600, radius, seed), sweeps, {}), 500,
                      500);
}

TEST(Realism, OfTheDefaultIsThatOfDevilsPostpile)
{
    for (const std::uint64_t seed : {1, 2, 3}) {
        const Statistics s = after(10, 1, seed);
        EXPECT_LE(s.tv, 9);
        EXPECT_GE(s.mean, 5.5);
        EXPECT_LE(s.mean, 5.75);
        EXPECT_EQ(std::max_element(s.sides.begin(), s.sides.end()) - s.sides.begin(), 6);
        EXPECT_LE(s.sides[3], 1);
        EXPECT_GE(s.angle_sd, 13);
        EXPECT_LE(s.angle_sd, 17);
    }
}

// Shares of 3 to 8 apparent sides, mean, area variation and angle deviation, from an independent
// script on a torus of the same size.
TEST(Realism, AgreesWithIndependentSimulationsOfMaturity)
{
    struct Row {
        double radius, sweeps;
        std::array<double, 6> sides;
        double mean, cv, angle_sd;
    };
    for (const Row& row : {Row{5, 0, {1.7, 17.1, 39.4, 28.6, 10.4, 2.4}, 5.38, .386, 25.2},
                           Row{5, 2, {0, 8.6, 42.1, 36.4, 11.2, 1.4}, 5.55, .236, 17.2},
                           Row{10, 0, {0, 7.0, 40.6, 41.1, 10.6, .8}, 5.58, .153, 16.6},
                           Row{10, 2, {0, 4.0, 38.8, 45.9, 10.8, .6}, 5.65, .107, 14.0},
                           Row{10, 5, {0, 2.5, 34.0, 52.4, 10.5, .6}, 5.73, .089, 12.6}}) {
        const Statistics s = after(row.radius, row.sweeps, 1);
        std::printf(
            "maturity: r %g, %g sweeps: %.1f %.1f %.1f %.1f %.1f %.1f, mean %.2f, cv %.3f, "
            "angle sd %.1f, TV %.1f\n",
            row.radius, row.sweeps, s.sides[3], s.sides[4], s.sides[5], s.sides[6], s.sides[7],
            s.sides[8], s.mean, s.cv, s.angle_sd, s.tv);
        for (std::size_t k = 0; k < 6; ++k)
            EXPECT_NEAR(s.sides[k + 3], row.sides[k], 4) << k + 3 << " sides";
        EXPECT_NEAR(s.mean, row.mean, .06);
        EXPECT_NEAR(s.cv, row.cv, .025);
        EXPECT_NEAR(s.angle_sd, row.angle_sd, 1.2);
    }
}

// Relaxation

TEST(Relaxation, KeepsSeedsOnTheSurfaceAndEvensTheCellsOut)
{
    const TriMesh surface = sphere(30, 5);
    const auto seeds = poisson_disk(surface, 150, 6, 2);
    const double before = area_variation(surface, seeds);
    const auto once = relax(surface, seeds, 1, {}), thrice = relax(surface, seeds, 3, {});
    EXPECT_LT(area_variation(surface, once), 0.85 * before);
    EXPECT_LT(area_variation(surface, thrice), area_variation(surface, once));
    for (const Vec3d& p : thrice) EXPECT_NEAR(length(p), 30, 0.05);
    EXPECT_EQ(relax(surface, seeds, 0, {}), seeds);
}

TEST(Relaxation, MovesAFractionOfTheWayOnTheLastSweep)
{
    const TriMesh surface = rectangle(100, 80);
    const auto seeds = poisson_disk(surface, 60, 8, 2);
    const auto one = relax(surface, seeds, 1, {}), third = relax(surface, seeds, 1.0 / 3, {});
    for (std::size_t i = 0; i < seeds.size(); ++i)
        EXPECT_LT(length(third[i] - (seeds[i] + (one[i] - seeds[i]) / 3.0)), 1e-4);
}

TEST(Relaxation, FindsTheCentroidOfAnExactlyKnownCell)
{
    // Two seeds halve a rectangle at x = 30: the centroids are those of the halves.
    const auto moved = relax(rectangle(100, 60), {{10, 21, 17.5}, {50, 21, 17.5}}, 1, {});
    EXPECT_NEAR(length(moved[0] - Vec3d(15, 30, 17.5)), 0, 0.3);
    EXPECT_NEAR(length(moved[1] - Vec3d(65, 30, 17.5)), 0, 0.3);
}

TEST(Relaxation, ReachesATargetedVariationOfAreas)
{
    const TriMesh surface = rectangle(300, 200);
    const auto seeds = poisson_disk(surface, 400, 6, 2);
    const double before = area_variation(surface, seeds);
    ASSERT_GT(before, 0.2);
    for (const double target : {0.20, 0.12})
        EXPECT_NEAR(area_variation(surface, relax_to(surface, seeds, target, {})), target, 0.004);
}

}  // namespace
}  // namespace sekitei::joints
