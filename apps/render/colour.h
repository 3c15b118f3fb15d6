#pragma once

#include <cstdint>

#include "core/vec.h"

/// From light and numbers to colours of a picture. Linear red, green, blue unless said otherwise.
namespace sekitei::render {

/// The sRGB byte of a linear value, clamped. `dither` in [-0.5, 0.5] hides steps in skies.
std::uint8_t srgb_byte(double linear, double dither = 0);
double linear_of_srgb(double value);

/// A linear colour from Oklab lightness, chroma and hue [turns] [Ottosson2020], clamped to [0, 1].
Vec3f from_oklch(double lightness, double chroma, double hue);

/// Dark blue over green to light yellow for t in [0, 1]: lightness rises evenly, so that equal
/// steps of the value look equal.
Vec3f colour_of_value(double t);

/// A colour for a number that is a name: neighbouring numbers differ clearly; negative ones grey.
Vec3f colour_of_id(std::int64_t id);

/// A colour for a direction: each component from -1 to 1 as linear red, green, blue; zero is grey.
Vec3f colour_of_direction(Vec3f v);

/// Scene light to display light in [0, 1]: a sigmoid in the logarithm that keeps middle grey (0.18)
/// and reaches white at 16; bright colours lose some saturation, as film does.
Vec3f tone_map(Vec3f radiance);

}  // namespace sekitei::render
