#include "apps/render/colour.h"

#include <algorithm>
#include <cmath>

#include "core/math.h"
#include "core/random.h"

namespace sekitei::render {

std::uint8_t srgb_byte(double linear, double dither)
{
    const double x = std::clamp(linear, 0.0, 1.0);
    const double s = x <= 0.0031308 ? 12.92 * x : 1.055 * math::pow(x, 1 / 2.4) - 0.055;
    return static_cast<std::uint8_t>(std::clamp(s * 255 + 0.5 + dither, 0.0, 255.0));
}

double linear_of_srgb(double value)
{
    return value <= 0.04045 ? value / 12.92 : math::pow((value + 0.055) / 1.055, 2.4);
}

Vec3f from_oklch(double lightness, double chroma, double hue)
{
    const double a = chroma * math::cos(2 * math::kPi * hue),
                 b = chroma * math::sin(2 * math::kPi * hue);
    const double l = lightness + 0.3963377774 * a + 0.2158037573 * b;
    const double m = lightness - 0.1055613458 * a - 0.0638541728 * b;
    const double s = lightness - 0.0894841775 * a - 1.2914855480 * b;
    const double l3 = l * l * l, m3 = m * m * m, s3 = s * s * s;
    auto unit = [](double v) { return static_cast<float>(std::clamp(v, 0.0, 1.0)); };
    return {unit(4.0767416621 * l3 - 3.3077115913 * m3 + 0.2309699292 * s3),
            unit(-1.2684380046 * l3 + 2.6097574011 * m3 - 0.3413193965 * s3),
            unit(-0.0041960863 * l3 - 0.7034186147 * m3 + 1.7076147010 * s3)};
}

Vec3f colour_of_value(double t)
{
    t = std::clamp(t, 0.0, 1.0);
    // Hue from violet-blue (0.82 turns) down to yellow (0.29); chroma is highest in the middle,
    // where the gamut has room.
    const double hue = 0.82 - 0.53 * t;
    const double chroma = 0.10 + 0.10 * t * (1 - t) * (1 - 0.6 * t) + 0.06 * t * t;
    return from_oklch(0.26 + 0.66 * t, chroma, hue);
}

Vec3f colour_of_id(std::int64_t id)
{
    if (id < 0) return Vec3f(id == -1 ? 0.35f : 0.22f);
    // Golden-ratio steps of the hue keep successive numbers apart, three lightnesses more so.
    const double turns = static_cast<double>(id % 100000) * 0.61803398875 + 0.08;
    const double lightness = 0.56 + 0.11 * static_cast<double>(id % 3);
    const double chroma = 0.10 + 0.05 * static_cast<double>((id / 3) % 2);
    return from_oklch(lightness, chroma, turns - std::floor(turns));
}

Vec3f colour_of_direction(Vec3f v)
{
    const float l = length(v);
    if (!(l > 0) || !std::isfinite(l)) return Vec3f(0.2f);
    Vec3f colour;
    for (int i = 0; i < 3; ++i) {
        // Even in the display's values, so that opposite directions look equally strong.
        colour[i] = static_cast<float>(linear_of_srgb(0.5 + 0.45 * static_cast<double>(v[i] / l)));
    }
    return colour;
}

Vec3f tone_map(Vec3f radiance)
{
    constexpr double kSlope = 1.18, kGrey = 0.18, kWhite = 16;
    const double grey = math::pow(kGrey, kSlope), white = math::pow(kWhite, kSlope);
    // f(x) = k x^n / (x^n + c) with f(grey) = grey and f(white) = 1.
    const double c = grey * (1 - kGrey) / (kGrey - grey / white), k = (white + c) / white;
    auto film = [&](double x) {
        const double p = x > 0 ? math::pow(x, kSlope) : 0;
        return std::min(1.0, k * p / (p + c));
    };
    const double luminance = 0.2126 * static_cast<double>(radiance.x) +
                             0.7152 * static_cast<double>(radiance.y) +
                             0.0722 * static_cast<double>(radiance.z);
    const double bright = luminance / (luminance + 2.5);
    Vec3f out;
    for (int i = 0; i < 3; ++i) {
        const double own = static_cast<double>(radiance[i]);
        out[i] = static_cast<float>(film(own + (luminance - own) * bright * 0.35));
    }
    return out;
}

}  // namespace sekitei::render
