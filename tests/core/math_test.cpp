#include "core/math.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "core/inline_math.h"
#include "core/random.h"

namespace sekitei {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr Stream kArguments{"test.math"};

/// Largest difference from the C library's long double function over 20,000 arguments, relative or
/// absolute; the reference is four digits better than double.
double worst(const std::function<double(double)>& ours,
             const std::function<long double(long double)>& theirs, double lower, double upper,
             bool relative)
{
    double error = 0;
    for (std::uint64_t i = 0; i < 20000; ++i) {
        const double x = lower + (upper - lower) * uniform01(1, kArguments, i);
        const long double expected = theirs(static_cast<long double>(x));
        const long double difference = std::abs(static_cast<long double>(ours(x)) - expected);
        error = std::max(
            error, static_cast<double>(relative ? difference / std::abs(expected) : difference));
    }
    return error;
}

const auto kExp = [](long double x) { return std::exp(x); };
const auto kLog = [](long double x) { return std::log(x); };

TEST(Math, ExpAgreesWithTheCLibrary)
{
    EXPECT_LT(worst(math::exp, kExp, -1, 1, true), 1e-15);
    EXPECT_LT(worst(math::exp, kExp, -708, 709, true), 1e-15);
}

TEST(Math, InlineFunctionsAgreeWithTheCLibrary)
{
    auto exp = [](long double x) { return std::exp(x); };
    auto log = [](long double x) { return std::log(x); };
    EXPECT_LT(worst(math::inline_exp, exp, -1, 1, true), 5e-16);
    EXPECT_LT(worst(math::inline_exp, exp, -700, 700, true), 5e-16);
    EXPECT_LT(worst(math::inline_log, log, 0.5, 2, false), 3e-16);
    EXPECT_LT(worst(math::inline_log, log, 1e-3, 1e-2, true), 3e-16);
    EXPECT_LT(worst(math::inline_log, log, 10, 1e12, true), 3e-16);
    EXPECT_EQ(math::inline_exp(0), 1);
    EXPECT_EQ(math::inline_log(1), 0);
    EXPECT_EQ(math::inline_exp(-kInfinity), math::inline_exp(-708));
    EXPECT_EQ(math::inline_exp(kInfinity), math::inline_exp(709));
    EXPECT_EQ(math::inline_log(0), math::inline_log(1e-300));
    EXPECT_TRUE(std::isnan(math::inline_exp(std::nan(""))));
}

TEST(Math, LogAgreesWithTheCLibrary)
{
    EXPECT_LT(worst(math::log, kLog, 0.5, 2, true), 1e-15);
    EXPECT_LT(worst(math::log, kLog, 1 - 1e-9, 1 + 1e-9, true), 1e-15);
    EXPECT_LT(worst(math::log, kLog, 0, 1e300, true), 1e-15);
    EXPECT_LT(worst(math::log, kLog, 0, 1e-300, true), 1e-15);
}

TEST(Math, PowAgreesWithTheCLibraryEvenForLargeExponents)
{
    for (const double exponent : {-300.5, -2.2, -1.0, 0.3, 0.5, 1 / 2.4, 2.0, 2.4, 17.0, 300.0})
        for (const auto& [lower, upper] : {std::pair{0.1, 10.0}, {0.9, 1.1}, {1e-3, 1.0}}) {
            if (std::abs(exponent * std::log(lower)) > 690) continue;
            EXPECT_LT(worst([&](double x) { return math::pow(x, exponent); },
                            [&](long double x) {
                                return std::pow(x, static_cast<long double>(exponent));
                            },
                            lower, upper, true),
                      1e-15)
                << exponent << " on " << lower << ".." << upper;
        }
}

TEST(Math, SineAndCosineAgreeWithTheCLibrary)
{
    for (const double range : {0.7, 7.0, 1e6}) {
        EXPECT_LT(worst(
                      math::sin, [](long double x) { return std::sin(x); }, -range, range, false),
                  1e-15);
        EXPECT_LT(worst(
                      math::cos, [](long double x) { return std::cos(x); }, -range, range, false),
                  1e-15);
    }
    EXPECT_LT(worst(
                  math::sin, [](long double x) { return std::sin(x); }, 1e-9, 1e-3, true),
              1e-15);
}

TEST(Math, InverseFunctionsAgreeWithTheCLibrary)
{
    for (const double x : {-3.0, -1e-3, 1e-9, 0.5, 7.0, 1e9})
        EXPECT_LT(worst([&](double y) { return math::atan2(y, x); },
                        [&](long double y) { return std::atan2(y, static_cast<long double>(x)); },
                        -5, 5, true),
                  1e-15)
            << x;
    EXPECT_LT(worst(
                  math::acos, [](long double x) { return std::acos(x); }, -1, 0.999, true),
              1e-15);
}

TEST(Math, SpecialValuesAreThoseOfTheCLibrary)
{
    EXPECT_EQ(math::exp(0), 1);
    EXPECT_EQ(math::exp(800), kInfinity);
    EXPECT_EQ(math::exp(kInfinity), kInfinity);
    EXPECT_EQ(math::exp(-800), 0);
    EXPECT_EQ(math::exp(-kInfinity), 0);
    EXPECT_EQ(math::log(1), 0);
    EXPECT_EQ(math::log(0), -kInfinity);
    EXPECT_EQ(math::log(kInfinity), kInfinity);
    EXPECT_NEAR(math::log(std::numeric_limits<double>::denorm_min()), -744.4400719213812, 1e-12);
    EXPECT_TRUE(std::isnan(math::log(-1)));
    EXPECT_EQ(math::pow(0, 2.5), 0);
    EXPECT_EQ(math::pow(0, -2.5), kInfinity);
    EXPECT_EQ(math::pow(0, 0), 1);
    EXPECT_EQ(math::pow(3, 1), 3);
    EXPECT_EQ(math::pow(10, 400), kInfinity);
    EXPECT_EQ(math::pow(10, -400), 0);
    EXPECT_EQ(math::pow(kInfinity, 2.5), kInfinity);
    EXPECT_EQ(math::pow(kInfinity, -2.5), 0);
    EXPECT_EQ(math::pow(1, kInfinity), 1);
    EXPECT_EQ(math::pow(2, kInfinity), kInfinity);
    EXPECT_EQ(math::pow(2, 1e308), kInfinity);
    EXPECT_EQ(math::pow(0.5, kInfinity), 0);
    EXPECT_TRUE(std::isnan(math::pow(-2, 0.5)));
    EXPECT_EQ(math::atan2(0, 1), 0);
    EXPECT_EQ(math::atan2(0, -1), math::kPi);
    EXPECT_EQ(math::atan2(2, 0), math::kPi / 2);
    EXPECT_EQ(math::atan2(-2, 0), -math::kPi / 2);
    EXPECT_NEAR(math::atan2(kInfinity, kInfinity), math::kPi / 4, 1e-15);
    EXPECT_EQ(math::atan2(3, kInfinity), 0);
    EXPECT_EQ(math::acos(1.5), 0);
    EXPECT_EQ(math::acos(-1.5), math::kPi);
    EXPECT_EQ(math::sin(0), 0);
    EXPECT_EQ(math::cos(0), 1);
}

TEST(Math, NotANumberStaysNotANumber)
{
    const double nan = std::nan("");
    for (const double value :
         {math::exp(nan), math::log(nan), math::pow(nan, 2), math::pow(2, nan), math::sin(nan),
          math::cos(nan), math::sin(kInfinity), math::cos(-kInfinity), math::atan2(nan, 1),
          math::atan2(1, nan), math::acos(nan)})
        EXPECT_TRUE(std::isnan(value));
}

}  // namespace
}  // namespace sekitei
