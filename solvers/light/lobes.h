#pragma once

#include <algorithm>
#include <cmath>

#include "core/math.h"
#include "core/vec.h"

/// Directions drawn from two numbers in [0, 1).
namespace sekitei::light {

/// Sine and cosine of a turn, 0..1 for the whole circle.
struct Turn {
    double sine, cosine;
    explicit Turn(double u)
        : sine(math::sin(2 * math::kPi * u)), cosine(math::cos(2 * math::kPi * u))
    {
    }
};

/// A unit vector and two across it, right-handed [Duff2017].
struct Frame {
    Vec3d n, a, b;
    explicit Frame(Vec3d normal) : n(normal)
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

/// Uniform over a cone of half angle `angle` [rad].
inline Vec3d cone_direction(Vec3d axis, double angle, double u, double v)
{
    const double half = math::sin(angle / 2);
    return cap_direction(Frame(axis), 2 * half * half, u, v);
}

}  // namespace sekitei::light
