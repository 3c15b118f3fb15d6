#include "core/random.h"

#include <gtest/gtest.h>

namespace sekitei {
namespace {

// Check values of the generator that core/random.h defines, computed independently of this code.
TEST(Random, AgreesWithThePublishedCheckValues)
{
    EXPECT_EQ(mix64(0), 0xe220a8397b1dcdafu);
    EXPECT_EQ(hash2(1, 2), 0xbcd9dbb49673066bu);
    EXPECT_DOUBLE_EQ(uniform_of_key(hash2(1, 0), 0), 0.8847898165349132);
    EXPECT_DOUBLE_EQ(uniform_of_key(hash2(1, 0), 1), 0.7778579078492538);
}

TEST(Random, StreamsAreIndependentOfEachOther)
{
    constexpr Stream kA{"a"}, kB{"b"};
    EXPECT_NE(uniform01(7, kA, 3), uniform01(7, kB, 3));
    double mean = 0, product = 0;
    constexpr int kDraws = 20000;
    for (std::uint64_t i = 0; i < kDraws; ++i) {
        const double a = uniform01(7, kA, i) - 0.5, b = uniform01(7, kB, i) - 0.5;
        mean += a;
        product += a * b;
    }
    EXPECT_NEAR(mean / kDraws, 0, 4 * 0.2887 / 141.4);  // four standard errors
    EXPECT_NEAR(product / kDraws, 0, 4 * 0.0833 / 141.4);
}

}  // namespace
}  // namespace sekitei
