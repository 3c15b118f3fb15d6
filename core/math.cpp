#include "core/math.h"

#include <bit>
#include <cmath>
#include <initializer_list>
#include <limits>

namespace sekitei::math {
namespace {

constexpr double kLn2High = 0x1.62e42fee00000p-1;   // the upper bits of ln 2: k * kLn2High is exact
constexpr double kLn2Low = 0x1.a39ef35793c76p-33;   // the rest
constexpr double kPio2High = 0x1.921fb54400000p+0;  // the same for pi / 2
constexpr double kPio2Middle = 0x1.0b4611a600000p-34;
constexpr double kPio2Low = 0x1.3198a2e037073p-69;

double nearest(double x)
{
    return std::floor(x + 0.5);
}

/// 2^k for |k| < 1023.
double power_of_two(int k)
{
    return std::bit_cast<double>(static_cast<std::uint64_t>(k + 1023) << 52);
}

/// sin(r), |r| <= pi/4, Taylor to r^19.
double sin_kernel(double r)
{
    const double q = r * r;
    double s = -1.0 / 121645100408832000.0;
    for (const double c :
         {1.0 / 355687428096000.0, -1.0 / 1307674368000.0, 1.0 / 6227020800.0, -1.0 / 39916800.0,
          1.0 / 362880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0})
        s = s * q + c;
    return r + r * q * s;
}

/// cos(r), |r| <= pi/4, Taylor to r^18.
double cos_kernel(double r)
{
    const double q = r * r;
    double s = -1.0 / 6402373705728000.0;
    for (const double c : {1.0 / 20922789888000.0, -1.0 / 87178291200.0, 1.0 / 479001600.0,
                           -1.0 / 3628800.0, 1.0 / 40320.0, -1.0 / 720.0, 1.0 / 24.0, -0.5})
        s = s * q + c;
    return 1.0 + q * s;
}

/// Reduces x to r in [-pi/4, pi/4] and the quadrant.
double reduce(double x, int& quadrant)
{
    quadrant = 0;
    if (!(std::abs(x) < 0x1p52)) return std::nan("");  // no digit of the angle is left
    const double k = nearest(x / (kPi / 2));
    quadrant = static_cast<int>(static_cast<long long>(k) & 3);
    return ((x - k * kPio2High) - k * kPio2Middle) - k * kPio2Low;
}

/// atan(x), |x| <= 1, by halving the angle twice and a Taylor series.
double atan_kernel(double x)
{
    double t = x;
    for (int i = 0; i < 2; ++i) t = t / (1.0 + std::sqrt(1.0 + t * t));
    const double q = t * t;
    double s = 0;
    for (int k = 23; k >= 1; k -= 2) s = 1.0 / k - q * s;
    return 4.0 * t * s;
}

/// A number as the unevaluated sum of two doubles.
struct Pair {
    double high, low;
};

/// a + b exactly, |a| >= |b|.
Pair exact_sum(double a, double b)
{
    const double sum = a + b;
    return {sum, b - (sum - a)};
}

/// a * b exactly, by splitting the factors in halves [Dekker1971]; |a|, |b| < 1e290.
Pair exact_product(double a, double b)
{
    constexpr double kSplit = 0x1p27 + 1;
    const double ca = kSplit * a, cb = kSplit * b;
    const double ah = ca - (ca - a), al = a - ah, bh = cb - (cb - b), bl = b - bh;
    const double product = a * b;
    return {product, ((ah * bh - product) + ah * bl + al * bh) + al * bl};
}

/// log(x), x > 0 and finite, to some 70 bits: pow multiplies its error by up to 745.
Pair log_pair(double x)
{
    int k = 0;
    if (x < std::numeric_limits<double>::min()) {  // subnormal: the exponent field says nothing
        x *= 0x1p54;
        k = -54;
    }
    const std::uint64_t bits = std::bit_cast<std::uint64_t>(x);
    k += static_cast<int>(bits >> 52) - 1023;
    double m = std::bit_cast<double>((bits & 0xFFFFFFFFFFFFFu) | (1023ull << 52));  // [1, 2)
    if (m > 1.41421356237309505) {
        m *= 0.5;
        ++k;
    }
    // log m = 2 atanh(z), z = (m - 1) / (m + 1), |z| < 0.172. m - 1 is exact; m + 1 is d + e, and
    // the remainder of the division gives z its lower half.
    const double f = m - 1;
    const auto [d, e] = exact_sum(2.0, f);
    const double z = f / d;
    const Pair zd = exact_product(z, d);
    const double z_low = ((f - zd.high) - zd.low - z * e) / d;
    const Pair q = exact_product(z, z);
    const double q_low = q.low + 2 * z * z_low;
    // z^3 / 3 in two parts, the rest of the series in one
    const Pair cube = exact_product(z, q.high);
    const double third = cube.high / 3;
    const Pair back = exact_product(third, 3);
    const double third_low =
        (((cube.high - back.high) - back.low) + cube.low + z * q_low + z_low * q.high) / 3;
    double s = 0;
    for (int n = 23; n >= 5; n -= 2) s = (s + 1.0 / n) * q.high;
    const double rest = s * z * q.high;
    // Sum from the largest: k ln 2, 2 z, 2 z^3 / 3, the low parts.
    const Pair a = exact_sum(2 * z, 2 * third);
    const Pair b = k == 0 ? Pair{a.high, 0} : exact_sum(k * kLn2High, a.high);
    return exact_sum(b.high, b.low + (a.low + (k * kLn2Low + 2 * (z_low + third_low + rest))));
}

}  // namespace

double exp(double x)
{
    if (std::isnan(x)) return x;
    if (x > 709.78) return std::numeric_limits<double>::infinity();
    if (x < -745) return 0;
    const double k = nearest(x / (kLn2High + kLn2Low));
    const double r = (x - k * kLn2High) - k * kLn2Low;  // |r| <= ln(2) / 2
    double s = 1.0;
    for (int n = 14; n >= 1; --n) s = 1.0 + r * s / n;
    const int half = static_cast<int>(k) / 2, rest = static_cast<int>(k) - half;
    return s * power_of_two(half) * power_of_two(rest);
}

double log(double x)
{
    if (!(x > 0)) return x == 0 ? -std::numeric_limits<double>::infinity() : std::nan("");
    if (std::isinf(x)) return x;
    return log_pair(x).high;
}

double pow(double base, double exponent)
{
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    if (exponent == 0 || base == 1) return 1;
    if (std::isnan(exponent) || !(base >= 0)) return std::nan("");
    if (exponent == 1) return base;
    if (exponent == 2) return base * base;
    if (base == 0 || std::isinf(base)) return (base == 0) == (exponent > 0) ? 0 : kInfinity;
    const auto [high, low] = log_pair(base);
    const double rough = exponent * high;
    if (!(std::abs(rough) < 800)) return rough > 0 ? kInfinity : 0;
    const Pair power = exact_product(exponent, high);
    return exp(power.high) * (1 + (power.low + exponent * low));
}

double sin(double x)
{
    int quadrant = 0;
    const double r = reduce(x, quadrant);
    const double s = quadrant & 1 ? cos_kernel(r) : sin_kernel(r);
    return quadrant & 2 ? -s : s;
}

double cos(double x)
{
    int quadrant = 0;
    const double r = reduce(x, quadrant);
    const double s = quadrant & 1 ? sin_kernel(r) : cos_kernel(r);
    return quadrant == 1 || quadrant == 2 ? -s : s;
}

double atan2(double y, double x)
{
    if (x == 0 && y == 0) return 0;
    if (std::isinf(x) && std::isinf(y)) {
        x = std::copysign(1.0, x);
        y = std::copysign(1.0, y);
    }
    if (std::abs(y) <= std::abs(x)) {
        const double a = atan_kernel(y / x);
        return x > 0 ? a : (y >= 0 ? a + kPi : a - kPi);
    }
    // nearer the y axis: measure from there
    const double a = kPi / 2 - atan_kernel(x / std::abs(y));
    return y > 0 ? a : -a;
}

double acos(double x)
{
    if (x >= 1) return 0;
    if (x <= -1) return kPi;
    return atan2(std::sqrt((1 - x) * (1 + x)), x);
}

}  // namespace sekitei::math
