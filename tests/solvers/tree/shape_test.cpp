#include "solvers/tree/shape.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "core/error.h"
#include "core/math.h"
#include "core/random.h"

namespace sekitei::tree {
namespace {

constexpr double kPi = math::kPi;

/// n points spread evenly over a sphere: a spiral of equal areas.
std::vector<Vec3d> on_sphere(int n, double radius)
{
    std::vector<Vec3d> points;
    for (int i = 0; i < n; ++i) {
        const double z = 1 - (2 * i + 1.0) / n, r = std::sqrt(1 - z * z);
        const double turn = kPi * (3 - std::sqrt(5.0)) * i;
        points.push_back(radius * Vec3d{r * math::cos(turn), r * math::sin(turn), z});
    }
    return points;
}

/// The lattice 0..n on each axis.
std::vector<Vec3d> lattice(int n, Vec3d step)
{
    std::vector<Vec3d> points;
    for (int x = 0; x <= n; ++x)
        for (int y = 0; y <= n; ++y)
            for (int z = 0; z <= n; ++z) points.push_back({x * step.x, y * step.y, z * step.z});
    return points;
}

std::vector<Vec3d> cloud(int n, std::uint64_t seed)
{
    std::vector<Vec3d> points;
    for (int i = 0; i < n; ++i) {
        const auto key = hash2(seed, static_cast<std::uint64_t>(i));
        points.push_back({4 * uniform_of_key(key, 1) - 2, 3 * uniform_of_key(key, 2),
                          5 * uniform_of_key(key, 3)});
    }
    return points;
}

/// Volume and area by trying each triple of points whether it bounds them all. General position.
Hull brute_hull(const std::vector<Vec3d>& p)
{
    Hull hull;
    Vec3d middle;
    for (const Vec3d q : p) middle += q / static_cast<double>(p.size());
    for (std::size_t a = 0; a < p.size(); ++a)
        for (std::size_t b = a + 1; b < p.size(); ++b)
            for (std::size_t c = b + 1; c < p.size(); ++c) {
                const Vec3d n = cross(p[b] - p[a], p[c] - p[a]);
                int above = 0, below = 0;
                for (std::size_t d = 0; d < p.size(); ++d)
                    if (d != a && d != b && d != c) ++(dot(n, p[d] - p[a]) > 0 ? above : below);
                if (above > 0 && below > 0) continue;
                hull.area += length(n) / 2;
                hull.volume += std::abs(dot(n, middle - p[a])) / 6;
            }
    return hull;
}

TEST(ConvexHull, OfABoxIsExactHoweverManyPointsLieOnItsFacesAndEdges)
{
    // 2 x 3 x 4: edges 0.25, 0.375, 0.5 by 8.
    const Hull hull = convex_hull(lattice(8, {0.25, 0.375, 0.5}));
    EXPECT_DOUBLE_EQ(hull.volume, 24);
    EXPECT_DOUBLE_EQ(hull.area, 2 * (6 + 8 + 12));
    // A cube: (pi / 6)^(1/3).
    EXPECT_NEAR(convex_hull(lattice(3, Vec3d(0.1))).sphericity(), std::cbrt(kPi / 6), 1e-11);
}

TEST(ConvexHull, OfATetrahedronWithRepeatedPoints)
{
    std::vector<Vec3d> points{{0, 0, 0}, {1, 0, 0}, {0, 2, 0}, {0, 0, 3}};
    points.insert(points.end(), points.begin(), points.end() - 1);
    points.push_back({0.5, 0, 0});
    points.push_back({0.25, 1, 0.375});
    const Hull hull = convex_hull(points);
    EXPECT_DOUBLE_EQ(hull.volume, 1);
    EXPECT_NEAR(hull.area, 1 + 1.5 + 3 + 0.5 * std::sqrt(36.0 + 9 + 4), 1e-11);
}

TEST(ConvexHull, AgreesWithBruteForce)
{
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
        const auto points = cloud(24, seed);
        const Hull found = convex_hull(points), expected = brute_hull(points);
        EXPECT_NEAR(found.volume, expected.volume, 1e-9) << seed;
        EXPECT_NEAR(found.area, expected.area, 1e-9) << seed;
    }
}

TEST(ConvexHull, OfFewPointsOfALatticeIsThatOfTheSamePointsShakenALittle)
{
    // Planes and lines through many points, in all orders.
    for (std::uint64_t seed = 1; seed <= 300; ++seed) {
        std::vector<Vec3d> points, shaken;
        for (std::uint64_t i = 0; i < 40; ++i) {
            const auto key = hash2(seed, i);
            const auto whole = [&](std::uint64_t k) {
                return std::floor(4 * uniform_of_key(key, k));
            };
            points.push_back({whole(1), whole(2), whole(3)});
            shaken.push_back(points.back() + Vec3d{uniform_of_key(key, 4), uniform_of_key(key, 5),
                                                   uniform_of_key(key, 6)} *
                                                 1e-7);
        }
        const Hull found = convex_hull(points), expected = convex_hull(shaken);
        ASSERT_NEAR(found.volume, expected.volume, 1e-4) << seed;
        ASSERT_NEAR(found.area, expected.area, 1e-4) << seed;
    }
}

TEST(ConvexHull, OfASphereTendsToIt)
{
    const double r = 2.5;
    double before = 1;
    for (const int n : {100, 1000, 10000}) {
        const Hull hull = convex_hull(on_sphere(n, r));
        const double missing = 1 - hull.volume / (4 * kPi / 3 * r * r * r);
        EXPECT_LT(hull.sphericity(), 1);
        EXPECT_GT(missing, 0);
        EXPECT_NEAR(before / missing, n == 100 ? before / missing : 10.0, 1.0) << n;
        before = missing;
    }
    EXPECT_GT(convex_hull(on_sphere(10000, r)).sphericity(), 0.999);
}

TEST(ConvexHull, IsTheSameForAnyOrderScaleAndPlace)
{
    auto points = cloud(500, 7);
    const Hull hull = convex_hull(points);
    std::ranges::reverse(points);
    EXPECT_NEAR(convex_hull(points).volume, hull.volume, 1e-12 * hull.volume);
    for (Vec3d& p : points) p = p * 1e6 + Vec3d{1e7, -3e7, 2e7};
    EXPECT_NEAR(convex_hull(points).volume, hull.volume * 1e18, 1e-9 * hull.volume * 1e18);
    EXPECT_NEAR(convex_hull(points).area, hull.area * 1e12, 1e-9 * hull.area * 1e12);
}

TEST(ConvexHull, OfFlatOrFewPointsIsNothing)
{
    EXPECT_EQ(convex_hull({}).volume, 0);
    EXPECT_EQ(convex_hull(std::vector<Vec3d>(10, Vec3d{1, 2, 3})).area, 0);
    EXPECT_EQ(convex_hull(std::vector<Vec3d>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}).area, 0);
    EXPECT_EQ(convex_hull(lattice(5, {1, 1, 0})).area, 0);
    EXPECT_EQ(convex_hull(lattice(5, {1, 0, 0})).sphericity(), 0);
    EXPECT_THROW(convex_hull(std::vector<Vec3d>(5, Vec3d{0, NAN, 0})), InvalidInput);
}

TEST(ConvexHull, StaysWholeForThinShellsOfNearlyFlatFaces)
{
    // A prism of 1000 sides whose ends are flat to 1e-15 or so, in a skew direction.
    std::vector<Vec3d> points;
    const Vec3d u = normalized(Vec3d{1, 2, 2}), v = normalized(Vec3d{2, 1, -2}), w = cross(u, v);
    for (int i = 0; i < 1000; ++i) {
        const double turn = 2 * kPi * i / 1000;
        const Vec3d rim = u * math::cos(turn) + v * math::sin(turn);
        points.insert(points.end(), {rim, rim + 2.0 * w, rim * 0.5, rim * 0.25 + 2.0 * w, rim + w});
    }
    const Hull hull = convex_hull(points);
    EXPECT_NEAR(hull.volume, 2 * 500 * math::sin(2 * kPi / 1000), 1e-9);
    EXPECT_NEAR(hull.area, 1000 * math::sin(2 * kPi / 1000) + 4000 * math::sin(kPi / 1000), 1e-9);
}

TEST(Spacing, OfALatticeIsEven)
{
    const Spacing even = spacing_of(lattice(6, {0.5, 0.75, 2}));
    EXPECT_DOUBLE_EQ(even.mean, 0.5);
    EXPECT_EQ(even.cv, 0);
    EXPECT_EQ(even.gap, 1);
}

TEST(Spacing, OfAFewPoints)
{
    // Nearest distances 1, 1, 3, 4: mean 2.25, variance 1.6875.
    const Spacing s =
        spacing_of(std::vector<Vec3d>{{0, 100, 0}, {0, 101, 0}, {0, 104, 0}, {0, 104, -4}});
    EXPECT_DOUBLE_EQ(s.mean, 2.25);
    EXPECT_NEAR(s.cv, std::sqrt(1.6875) / 2.25, 1e-12);
    EXPECT_NEAR(s.gap, 4 / 2.25, 1e-12);
    EXPECT_EQ(spacing_of(std::vector<Vec3d>{{1, 2, 3}}).mean, 0);
    // Two in one place are nearest to each other.
    EXPECT_DOUBLE_EQ(spacing_of(std::vector<Vec3d>{{0, 0, 0}, {0, 0, 0}, {3, 0, 0}}).mean, 1);
}

TEST(Spacing, OfRandomPointsFollowsPoisson)
{
    // Distances to the nearest of a Poisson process in a plane: CV = sqrt(4 / pi - 1) = 0.523.
    std::vector<Vec3d> points;
    for (std::uint64_t i = 0; i < 20000; ++i)
        points.push_back({uniform_of_key(i, 1), uniform_of_key(i, 2), 0});
    EXPECT_NEAR(spacing_of(points).cv, std::sqrt(4 / kPi - 1), 0.01);
}

TEST(HoleCv, OfAnEvenDiscIsNothingAndOfOneHeapTheMost)
{
    // Rings and sectors of one area: a spiral that gives each the same number.
    std::vector<Vec3d> disc;
    for (int ring = 0; ring < 12; ++ring)
        for (int sector = 0; sector < 24; ++sector) {
            const double r = 3 * std::sqrt((ring + 0.5) / 12), turn = (sector + 0.5) * kPi / 12;
            disc.push_back({r * math::cos(turn), r * math::sin(turn), 0.1 * ring});
        }
    EXPECT_EQ(hole_cv_of(disc, 3), 0);
    EXPECT_NEAR(hole_cv_of(std::vector<Vec3d>(50, Vec3d{1, 1, 0}), 3), std::sqrt(35.0), 1e-12);
    // Half of it gone: counts 2 n, 0.
    std::erase_if(disc, [](Vec3d p) { return p.y < 0; });
    EXPECT_NEAR(hole_cv_of(disc, 3), 1, 1e-12);
    // Points on the rim and beyond count to the outermost ring, the axis to the innermost.
    EXPECT_NEAR(hole_cv_of(std::vector<Vec3d>{{3, 0, 0}, {-9, 0, 0}, {0, 0, 0}}, 3),
                std::sqrt(3 / 36.0 - 9 / 1296.0) / (3 / 36.0), 1e-12);
}

TEST(Lean, OfAShiftedCloud)
{
    // A ring of radius a about (s, 0): mean s, rms sqrt(s^2 + a^2).
    std::vector<Vec3d> ring;
    for (int i = 0; i < 8; ++i)
        ring.push_back({3 + 4 * math::cos(i * kPi / 4), 4 * math::sin(i * kPi / 4), 7.0 * i});
    EXPECT_NEAR(lean_of(ring).x, 0.6, 1e-12);
    EXPECT_NEAR(lean_of(ring).y, 0, 1e-12);
    EXPECT_EQ(lean_of(ring).z, 0);
    EXPECT_EQ(length(lean_of(std::vector<Vec3d>{{0, 0, 5}})), 0);
    EXPECT_EQ(length(lean_of({})), 0);
}

TEST(Profile, OfAConeIsALineAndOfABallIsNot)
{
    std::vector<Vec3d> cone{{0, 0, 30}}, ball;
    for (int i = 0; i < 60; ++i) {
        const double z = 0.25 + 0.5 * i, turn = 2.4 * i;
        cone.push_back({0.4 * (30 - z) * math::cos(turn), 0.4 * (30 - z) * math::sin(turn), z});
        const double r = std::sqrt(15 * 15 - (z - 15) * (z - 15));
        ball.push_back({r * math::cos(turn), r * math::sin(turn), z});
    }
    EXPECT_GT(profile_r2(cone, 0.6), 0.9999);
    EXPECT_LT(profile_r2(ball, 0.6), 0.9);
    // What is below the share does not count.
    cone.push_back({50, 0, 1});
    EXPECT_GT(profile_r2(cone, 0.6), 0.9999);
    EXPECT_LT(profile_r2(cone, 1), 0.9);
    EXPECT_EQ(profile_r2(std::span(cone).first(2), 0.6), 0);
    EXPECT_EQ(profile_r2({}, 0.6), 0);
}

}  // namespace
}  // namespace sekitei::tree
