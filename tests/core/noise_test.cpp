#include "core/noise.h"

#include <gtest/gtest.h>

#include <cmath>

namespace sekitei {
namespace {

constexpr Stream kPoints{"test.points"};

/// A point in a box of 200 x 300 x 500 around the origin.
Vec3d point(std::uint64_t i)
{
    return {200 * (uniform01(3, kPoints, i, 0) - 0.5), 300 * (uniform01(3, kPoints, i, 1) - 0.5),
            500 * (uniform01(3, kPoints, i, 2) - 0.5)};
}

TEST(Noise, OneOctaveIsBoundedEvenWhereGradientsConspire)
{
    // With all eight gradients free the sum peaks near this place of the cell.
    double largest = 0;
    for (std::uint64_t key = 0; key < 400000; ++key)
        largest = std::max(largest, std::abs(gradient_noise(key, {0.36, 0.48, 0.5})));
    EXPECT_LE(largest, 1);
    EXPECT_GT(largest, 0.85);
}

TEST(Noise, OneOctaveVanishesOnLatticePoints)
{
    for (int x = -3; x < 4; ++x)
        for (int z = -2; z < 3; ++z) EXPECT_EQ(gradient_noise(9, {double(x), 5.0, double(z)}), 0);
}

TEST(Noise, IsContinuousAcrossLatticePlanes)
{
    for (std::uint64_t i = 0; i < 200; ++i) {
        Vec3d p = point(i);
        p.y = std::floor(p.y);
        EXPECT_NEAR(gradient_noise(4, p - Vec3d(0, 1e-9, 0)), gradient_noise(4, p), 1e-8);
    }
}

TEST(Noise, StaysInItsRangeWithMeanZero)
{
    const FractalNoise noise{.seed = 5, .frequency = 0.7, .hurst = 0.6};
    double sum = 0, squares = 0;
    constexpr int kDraws = 40000;
    for (std::uint64_t i = 0; i < kDraws; ++i) {
        const double value = noise(point(i));
        ASSERT_LE(std::abs(value), 1);
        sum += value;
        squares += value * value;
    }
    const double rms = std::sqrt(squares / kDraws);
    EXPECT_NEAR(sum / kDraws, 0, 4 * rms / 200);
    EXPECT_GT(rms, 0.1);
    EXPECT_LT(rms, 0.3);
}

/// Mean square difference of the noise over a distance, in three directions.
double structure(const FractalNoise& noise, double lag)
{
    double sum = 0;
    constexpr int kDraws = 6000;
    for (std::uint64_t i = 0; i < kDraws; ++i) {
        const Vec3d p = point(i);
        const double here = noise(p);
        for (const Vec3d step : {Vec3d(lag, 0, 0), Vec3d(0, lag, 0), Vec3d(0, 0, lag)})
            sum += std::pow(noise(p + step) - here, 2);
    }
    return sum / (3 * kDraws);
}

TEST(Noise, DifferencesGrowAsThePowerTwoHOfTheDistance)
{
    for (const double hurst : {0.3, 0.5, 0.7}) {
        FractalNoise noise{.seed = 11, .frequency = 0.25, .hurst = hurst, .octaves = 12};
        // octaves span wavelengths from 4 down to 4 / 2^11; stay well inside
        const double near = structure(noise, 1.0 / 64), far = structure(noise, 1.0 / 4);
        EXPECT_NEAR(std::log2(far / near) / 4, 2 * hurst, 0.12) << hurst;
    }
}

TEST(Noise, FrequencyScalesTheArgument)
{
    FractalNoise slow{.seed = 2, .frequency = 0.5}, fast{.seed = 2, .frequency = 2};
    for (std::uint64_t i = 0; i < 50; ++i) EXPECT_DOUBLE_EQ(slow(point(i) * 4), fast(point(i)));
}

TEST(Noise, DependsOnSeedAndStreamAndOnNothingElse)
{
    const FractalNoise a{.seed = 1}, again{.seed = 1}, seed{.seed = 2},
        stream{.seed = 1, .stream = Stream{"other"}};
    const Vec3d p{1.3, -2.7, 5.1};
    EXPECT_EQ(a(p), again(p));
    EXPECT_NE(a(p), seed(p));
    EXPECT_NE(a(p), stream(p));
}

}  // namespace
}  // namespace sekitei
