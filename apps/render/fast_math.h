#pragma once

#include <cmath>

/// Single-precision functions for the inner loops, made of +, -, *, / and sqrt only, so that they
/// give the same bits on every machine. Errors below 2e-6; sekitei::math where more is needed.
namespace sekitei::render {

struct SinCos {
    float sine, cosine;
};

/// Of an angle given in turns, [0, 1].
inline SinCos sincos_turn(float turn)
{
    // Fold to an eighth of a turn on either side of a multiple of a quarter.
    const float quarter = std::floor(turn * 4 + 0.5f);
    const float x = (turn * 4 - quarter) * 1.57079632679f, q = x * x;
    const float s =
        x * (1 - q * (1.0f / 6 - q * (1.0f / 120 - q * (1.0f / 5040 - q * (1.0f / 362880)))));
    const float c = 1 - q * (0.5f - q * (1.0f / 24 - q * (1.0f / 720 - q * (1.0f / 40320))));
    switch (static_cast<int>(quarter) & 3) {
        case 0:
            return {s, c};
        case 1:
            return {c, -s};
        case 2:
            return {-s, -c};
        default:
            return {-c, s};
    }
}

/// atan2(y, x) in turns, (-0.5, 0.5].
inline float atan2_turn(float y, float x)
{
    const float ax = std::abs(x), ay = std::abs(y), low = ax < ay ? ax : ay,
                high = ax < ay ? ay : ax;
    if (high == 0) return 0;
    // Halve the angle once, then the series of the arc tangent, in turns.
    float t = low / high;
    t = t / (1 + std::sqrt(1 + t * t));
    const float q = t * t;
    float a =
        t * (1 - q * (1.0f / 3 -
                      q * (1.0f / 5 - q * (1.0f / 7 - q * (1.0f / 9 - q * (1.0f / 11 - q / 13))))));
    a *= 0.318309886184f;  // 2 / (2 pi)
    if (ay > ax) a = 0.25f - a;
    if (x < 0) a = 0.5f - a;
    return y < 0 ? -a : a;
}

}  // namespace sekitei::render
