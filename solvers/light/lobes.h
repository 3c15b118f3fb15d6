#pragma once

#include <algorithm>
#include <cmath>

#include "core/math.h"
#include "core/vec.h"

/// Directions drawn from two numbers in [0, 1).
namespace sekitei::light {

inline constexpr double kSunRadius = 0.2665 * math::kPi / 180;  // of its disc as seen from here

/// Sine and cosine of a turn, 0 <= u < 1 for the whole circle. Both at once and inline, at a third
/// of the cost of math::sin and cos; within 1e-15; the same bits on every machine.
struct Turn {
    double sine, cosine;
    [[gnu::always_inline]] explicit Turn(double u)
    {
        // u = (quarter + x) / 4 with |x| <= 1/2
        const double quarters = 4 * u;
        const int quarter = static_cast<int>(quarters + 0.5);
        const double x = (quarters - quarter) * (math::kPi / 2), q = x * x;
        double s = -1.0 / 1307674368000, c = -1.0 / 87178291200;
        for (const double term : {1.0 / 6227020800, -1.0 / 39916800, 1.0 / 362880, -1.0 / 5040,
                                  1.0 / 120, -1.0 / 6, 1.0})
            s = s * q + term;
        for (const double term :
             {1.0 / 479001600, -1.0 / 3628800, 1.0 / 40320, -1.0 / 720, 1.0 / 24, -0.5, 1.0})
            c = c * q + term;
        s *= x;
        const bool swapped = (quarter & 1) != 0;
        sine = swapped ? c : s;
        cosine = swapped ? s : c;
        if ((quarter & 2) != 0) sine = -sine;
        if (((quarter + 1) & 2) != 0) cosine = -cosine;
    }
};

/// A unit vector and two across it, right-handed [Duff2017].
struct Frame {
    Vec3d n, a, b;
    [[gnu::always_inline]] explicit Frame(Vec3d normal) : n(normal)
    {
        const double sign = std::copysign(1.0, n.z), s = -1 / (sign + n.z), t = n.x * n.y * s;
        a = {1 + sign * n.x * n.x * s, sign * t, -sign * n.x};
        b = {t, sign + n.y * n.y * s, -n.y};
    }
    Vec3d at(double sine, double cosine, Turn turn) const
    {
        return a * (sine * turn.cosine) + b * (sine * turn.sine) + n * cosine;
    }
};

/// Cosine lobe: theta = arccos sqrt(u), azimuth 2 pi v [Nomura2010, eq. 3.1].
inline Vec3d cosine_direction(const Frame& frame, double u, double v)
{
    return frame.at(std::sqrt(1 - u), std::sqrt(u), Turn(v));
}

/// Uniform in solid angle over the cap 0 <= 1 - cos theta <= cap.
inline Vec3d cap_direction(const Frame& frame, double cap, double u, double v)
{
    const double rest = cap * u;  // 1 - cos theta
    return frame.at(std::sqrt(std::max(0.0, rest * (2 - rest))), 1 - rest, Turn(v));
}

/// The cap of a cone of half angle `angle` [rad].
inline double cap_of_cone(double angle)
{
    const double half = math::sin(angle / 2);
    return 2 * half * half;
}

}  // namespace sekitei::light
