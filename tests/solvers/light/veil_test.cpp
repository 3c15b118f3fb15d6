// Light through leaves.
#include "solvers/light/veil.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/light/light.h"

namespace sekitei::light {
namespace {

using std::numbers::pi;
using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr double kLatitude = 39.7 * pi / 180;
constexpr double kEdge = 0.5, kDensity = 0.375;  // exact in float
constexpr Vec3d kOrigin(-256, -256, 2);

/// Leaves of one density, `thick` blocks of 4 m above 2 m, over 512 m.
FloatGrid slab(int thick, float density = float(kDensity))
{
    FloatGrid grid(box_topology({0, 0, 0}, {1024, 1024, 8 * thick}), {kOrigin, kEdge}, 0);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf) {
        grid.set_constant(leaf, density);
        grid.mask(leaf) = LeafMask::full();
    }
    return grid;
}

/// A few blocks of leaves of many densities.
FloatGrid bushes()
{
    constexpr Stream kAny{"test.leaves"};
    auto grid = FloatGrid::uninitialised(
        LeafTopology::build({{-8, 0, 0}, {0, 0, 0}, {0, 8, 0}, {8, 8, 8}, {0, 0, 16}}),
        {{1, 2, 3}, kEdge}, 0);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) {
            const double u = uniform01(1, kAny, leaf, std::uint64_t(o));
            grid.values(leaf)[o] = u < 0.4 ? 0.0f : float(u);
            if (u >= 0.4) grid.mask(leaf).set(o);
        }
    grid.set_constant(4, 0.25f);
    grid.mask(4) = LeafMask::full();
    return grid;
}

struct Probes {
    std::vector<Vec3d> origin;
    std::vector<Vec3f> normal;
    std::vector<float> area;

    void add(Vec3d p, Vec3f n)
    {
        origin.push_back(p);
        normal.push_back(n);
        area.push_back(1);
    }
    operator Sites() const { return {origin, normal, area}; }
};

/// Places on a floor, some metres apart.
Probes floor_probes(int across)
{
    Probes probes;
    for (int i = 0; i < across; ++i)
        for (int j = 0; j < across; ++j) probes.add({3.1 * i, 2.7 * j, 0}, {0, 0, 1});
    return probes;
}

void expect_same(const Coefficients& a, const Coefficients& b)
{
    EXPECT_EQ(a.bits, b.bits);
    EXPECT_EQ(a.sky_view, b.sky_view);
    EXPECT_EQ(a.rain_exposure, b.rain_exposure);
    EXPECT_EQ(a.links, b.links);
}

TEST(Veil, OfASlabIsBeersLaw)
{
    const FloatGrid leaves = slab(2);
    const Veil veil(leaves, 0.6);
    for (const Vec3d way : {Vec3d(0, 0, 1), {1, 0, 1}, {-0.3, 0.4, 0.5}, {1e-9, -2, 0.4}}) {
        const Vec3d d = normalized(way);
        EXPECT_NEAR(veil.transmittance({3.3, 4.2, 0}, d), std::exp(-0.6 * kDensity * 8 / d.z),
                    1e-9);
        // From within, and from above downwards.
        EXPECT_NEAR(veil.transmittance({3.3, 4.2, 7.25}, d), std::exp(-0.6 * kDensity * 2.75 / d.z),
                    1e-9);
        EXPECT_NEAR(veil.transmittance({3.3, 4.2, 30}, -d), std::exp(-0.6 * kDensity * 8 / d.z),
                    1e-9);
        EXPECT_EQ(veil.transmittance({3.3, 4.2, 10.01}, d), 1);
    }
    EXPECT_EQ(veil.transmittance({3.3, 4.2, 1}, {1, 0, 0}), 1);
    EXPECT_NEAR(veil.transmittance({3.3, 4.2, 3}, {1, 0, 0}), 0, 1e-9);
}

TEST(Veil, AddsUpVoxelsOfAnyDensity)
{
    const FloatGrid leaves = bushes();
    const Veil veil(leaves, 0.5);
    constexpr Stream kRay{"test.rays"};
    int shaded = 0;
    for (std::uint64_t n = 0; n < 400; ++n) {
        auto u = [&](std::uint64_t k) { return uniform01(2, kRay, n, k); };
        const Vec3d from(-4 + 12 * u(0), 12 * u(1), 14 * u(2));
        const Vec3d d = normalized(Vec3d(u(3) - 0.5, u(4) - 0.5, u(5) - 0.5));
        constexpr double kStep = 1e-3;
        double depth = 0;
        for (double t = kStep / 2; t < 30; t += kStep) {
            const Vec3d p = leaves.transform().voxels(from + d * t);
            depth += kStep * 0.5 *
                     double(leaves.value(
                         {int(std::floor(p.x)), int(std::floor(p.y)), int(std::floor(p.z))}));
        }
        ASSERT_NEAR(veil.transmittance(from, d), std::exp(-depth), 2e-3) << n;
        shaded += depth > 0.1;
    }
    EXPECT_GT(shaded, 100);
    // Along the axes, faces and edges included.
    EXPECT_LT(veil.transmittance({1, 2, 3}, {0, 0, 1}), 1);
    EXPECT_NEAR(veil.transmittance({5.3, 6.2, 0}, {0, 0, 1}), std::exp(-0.5 * 0.25 * 4), 1e-9);
}

TEST(Veil, NamesWhatIsNoLeafArea)
{
    EXPECT_THAT([] { Veil(slab(1, -1), 0.5); },
                ThrowsMessage<InvalidInput>(HasSubstr("canopy_lad = -1 1/m")));
    EXPECT_THROW(Veil(slab(1, NAN), 0.5), InvalidInput);
    FloatGrid sea = slab(1);
    sea.set_background(2);
    EXPECT_THAT([&] { Veil(sea, 0.5); },
                ThrowsMessage<InvalidInput>(HasSubstr("background of canopy_lad = 2")));
    EXPECT_THROW(Veil(slab(1), -0.1), InvalidParameter);
    EXPECT_EQ(Veil(FloatGrid(), 0.5).transmittance({1, 2, 3}, {0, 0, 1}), 1);
}

TEST(Veil, ThatTakesNothingChangesNothing)
{
    const Probes probes = floor_probes(4);
    const FloatGrid leaves = slab(1), none;
    const Veil clear(leaves, 0), empty(none, 0.5);
    const Coefficients bare = trace(probes, {}, kLatitude, {}, {}, {});
    expect_same(trace(probes, {}, kLatitude, {}, {}, {}, &clear), bare);
    expect_same(trace(probes, {}, kLatitude, {}, {}, {}, &empty), bare);
}

TEST(Veil, LetsInItsShareOfTheSky)
{
    // 2 E3(tau), E3 by Simpson's rule.
    auto share = [](double tau) {
        double sum = 0;
        constexpr int kSteps = 2000;
        for (int k = 0; k <= kSteps; ++k) {
            const double mu = double(k) / kSteps, w = k == 0 || k == kSteps ? 1 : k % 2 ? 4 : 2;
            if (mu > 0) sum += w * mu * std::exp(-tau / mu);
        }
        return 2 * sum / (3 * kSteps);
    };
    Probes probes = floor_probes(2);
    const FloatGrid leaves = slab(1);
    for (const double extinction : {0.1, 0.5, 1.0}) {
        const Veil veil(leaves, extinction);
        const Coefficients c = trace(probes, {}, kLatitude, {}, {.sky_split = 4}, {}, &veil);
        for (const float view : c.sky_view)
            EXPECT_NEAR(double(view), share(extinction * kDensity * 4), 0.004) << extinction;
        // Rain drips through.
        for (const float e : c.rain_exposure) EXPECT_NEAR(double(e), 1, 1e-5);
    }
}

TEST(Veil, LetsInItsShareOfTheSun)
{
    const Probes probes = floor_probes(30);
    const FloatGrid leaves = slab(1);
    const Veil veil(leaves, 0.5);
    const Coefficients c = trace(probes, {}, kLatitude, {}, {.bounces = 0}, {}, &veil);
    // Of each bin as many sites see the sun as light comes through.
    const Directions d = directions(kLatitude, {}, c.params);
    double error = 0;
    int counted = 0;
    for (std::size_t b = 0; b < d.sun.size(); ++b) {
        if (d.sun[b].z < 0.05f) continue;
        int lit = 0;
        for (std::size_t i = 0; i < 900; ++i)
            lit += (c.bits[(std::size_t(d.sun_word) + b / 32) * c.sites + i] >> (b % 32)) & 1;
        const double expected = std::exp(-0.5 * kDensity * 4 / double(d.sun[b].z));
        EXPECT_NEAR(lit / 900.0, expected, 0.075) << b;
        error += lit / 900.0 - expected;
        ++counted;
    }
    ASSERT_GT(counted, 300);
    EXPECT_NEAR(error / counted, 0, 0.003);
    // Each site has its share of every row, to one fleck at either end.
    for (const Directions::Row& row : d.rows)
        for (std::size_t i = 0; i < 50; ++i) {
            double lit = 0, expected = 0;
            for (std::size_t b = std::size_t(row.first); b < std::size_t(row.first + row.count);
                 ++b) {
                lit += (c.bits[(std::size_t(d.sun_word) + b / 32) * c.sites + i] >> (b % 32)) & 1;
                expected += std::exp(-0.5 * kDensity * 4 / std::max(0.01, double(d.sun[b].z)));
            }
            EXPECT_LT(std::abs(lit - expected), 1.01);
        }
}

TEST(Veil, DarkensWhatIsReflected)
{
    // A wall's foot: half of what it sees is ground, under leaves or in the open.
    Probes probes;
    for (int i = 0; i < 200; ++i) probes.add({2.0 * i - 200, 0.3 * i, 1}, {0, -1, 0});
    const FloatGrid leaves = slab(4);
    const Veil veil(leaves, 0.5);
    const Params params{.ground = 0.0};
    const std::vector<sun::Moment> moments = sun::moments_of_day(2024, 6, 21, {kLatitude, 2.4});
    sun::Radiation radiation;
    radiation.global = 250;
    radiation.diffuse = 250;
    auto mean = [&](const Veil* through) {
        const Coefficients c = trace(probes, {}, kLatitude, {}, params, {}, through);
        const Light light = day(c, probes, moments, radiation);
        double sum = 0;
        for (const float r : light.reflected) sum += double(r);
        return sum / 200;
    };
    EXPECT_NEAR(mean(nullptr), 0.2 * 250 / 2, 1e-3);
    const double under = std::exp(-0.5 * kDensity * 16);  // of light from above on the ground
    EXPECT_NEAR(mean(&veil) / 25, under, 0.03);
}

TEST(Veil, IsTheSameForAnyNumberOfThreadsAndAfterRetracing)
{
    const FloatGrid leaves = bushes();
    const Veil veil(leaves, 0.5);
    Probes probes;
    for (int i = 0; i < 60; ++i) probes.add({0.1 * i, 2 + 0.07 * i, 2.5}, {0, 0, 1});
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return trace(probes, {}, kLatitude, {}, {}, {}, &veil);
    };
    const Coefficients one = on(1);
    expect_same(one, on(4));
    TriMesh roof;
    roof.vertices = {{2, 2, 3}, {4, 2, 3}, {4, 9, 3}};
    roof.triangles = {{0, 1, 2}};
    const std::vector<const TriMesh*> with{&roof};
    Bounds box;
    for (const Vec3f& v : roof.vertices) box.add(Vec3d(v));
    const Coefficients after = trace(probes, with, kLatitude, {}, {}, {}, &veil);
    EXPECT_NE(after.bits, one.bits);
    expect_same(retrace(one, probes, with, std::span(&box, 1), {}, &veil), after);
}

}  // namespace
}  // namespace sekitei::light
