#pragma once

#include <bit>
#include <cstdint>

/// exp and log for inner loops: inlined and without branches, so that compilers put many side by
/// side. The same bits on every machine, like sekitei::math; 5 to 10 times as fast, over a shorter
/// range.
namespace sekitei::math {

/// exp(x); x is clamped to [-708, 709]. Relative error below 5e-16. NaN stays NaN.
inline double inline_exp(double x)
{
    constexpr double kShift = 0x1.8p52;  // adding it rounds to an integer, held in the low bits
    constexpr double kLog2e = 1.44269504088896340736;
    constexpr double kLn2High = 0x1.62e42fee00000p-1, kLn2Low = 0x1.a39ef35793c76p-33;
    x = x < -708 ? -708 : x;
    x = x > 709 ? 709 : x;
    const double shifted = x * kLog2e + kShift, k = shifted - kShift;
    const double r = (x - k * kLn2High) - k * kLn2Low;  // |r| <= ln(2) / 2
    // Taylor to r^13, by pairs so that the processor can work on several at once.
    const double q = r * r, q2 = q * q;
    const double high = (1.0 / 40320 + r * (1.0 / 362880)) +
                        q * (1.0 / 3628800 + r * (1.0 / 39916800)) +
                        q2 * (1.0 / 479001600 + r * (1.0 / 6227020800.0));
    const double middle = (1.0 / 24 + r * (1.0 / 120)) + q * (1.0 / 720 + r * (1.0 / 5040));
    const double rest = q * ((0.5 + r * (1.0 / 6)) + q * middle + q * q2 * high);
    const std::uint64_t exponent = (std::bit_cast<std::uint64_t>(shifted) << 52) + (1023ull << 52);
    return (1 + (r + rest)) * std::bit_cast<double>(exponent);
}

/// log(x) for x in [1e-300, 1e300]; smaller x counts as 1e-300. Error below 3e-16 absolute near 1,
/// else relative.
inline double inline_log(double x)
{
    constexpr double kLn2High = 0x1.62e42fee00000p-1, kLn2Low = 0x1.a39ef35793c76p-33;
    x = x < 1e-300 ? 1e-300 : x;
    // x = m 2^k with m in [0.7071, 1.4142).
    const std::uint64_t bits = std::bit_cast<std::uint64_t>(x);
    const std::uint64_t offset = bits - 0x3FE6A09E667F3BCDull;
    const auto k64 = static_cast<std::int64_t>(offset) >> 52;
    const double k = static_cast<double>(static_cast<std::int32_t>(k64));
    const double m = std::bit_cast<double>(bits - (static_cast<std::uint64_t>(k64) << 52));
    // log m = 2 atanh(z), |z| < 0.1716.
    const double z = (m - 1) / (m + 1), q = z * z;
    double s = 1.0 / 21;
    s = s * q + 1.0 / 19;
    s = s * q + 1.0 / 17;
    s = s * q + 1.0 / 15;
    s = s * q + 1.0 / 13;
    s = s * q + 1.0 / 11;
    s = s * q + 1.0 / 9;
    s = s * q + 1.0 / 7;
    s = s * q + 1.0 / 5;
    s = s * q + 1.0 / 3;
    return k * kLn2High + (2 * z + (2 * z * q * s + k * kLn2Low));
}

}  // namespace sekitei::math
