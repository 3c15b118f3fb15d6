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
    const std::uint64_t bits = std::bit_cast<std::uint64_t>(x);
    int k = static_cast<int>(bits >> 52) - 1023;
    double m = std::bit_cast<double>((bits & 0xFFFFFFFFFFFFFu) | (1023ull << 52));  // [1, 2)
    if (m > 1.41421356237309505) {
        m *= 0.5;
        ++k;
    }
    // log m = 2 atanh(z), z = (m - 1) / (m + 1), |z| < 0.172
    const double z = (m - 1) / (m + 1), q = z * z;
    double s = 0;
    for (int n = 21; n >= 3; n -= 2) s = (s + 1.0 / n) * q;
    return k * kLn2High + (2 * z + (2 * z * s + k * kLn2Low));
}

double pow(double base, double exponent)
{
    if (exponent == 0) return 1;
    if (base == 0) return exponent > 0 ? 0 : std::numeric_limits<double>::infinity();
    return exp(exponent * log(base));
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
