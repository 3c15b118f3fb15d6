#pragma once

#include <array>
#include <utility>
#include <vector>

#include "core/vec.h"

namespace sekitei::render {

/// Light from all directions: a sun and a sky. Radiance relative to the sun's irradiance above the
/// air, in linear red, green and blue.
///
/// The day sky is computed, not fitted: single scattering along each view ray in a curved
/// atmosphere of air, haze and ozone [Nishita1993], Rayleigh and Cornette-Shanks phase functions,
/// optical depths by an approximation of the Chapman function [Schuler2012], and all further
/// scattering as an isotropic geometric series [Hillaire2020]. A sun below the horizon gives
/// twilight and then a faint night. It is symmetric about the sun's vertical plane.
class Sky {
public:
    /// @param sun        unit vector to the sun
    /// @param sun_radius angular radius [rad]; 0 gives sharp shadows
    /// @param turbidity  optical depth of air and haze over that of air alone [Preetham1999]
    /// @param below      whether the lower half can be met (no ground plane)
    static Sky day(Vec3d sun, double sun_radius, double turbidity, bool below);

    /// The same radiance from everywhere and no sun.
    static Sky uniform(float radiance, bool below);

    /// Adds a sun to any sky. @param irradiance  on a plane facing it
    void set_sun(Vec3d direction, double radius, Vec3f irradiance);

    /// Without the sun's disc.
    Vec3f radiance(Vec3f direction) const;
    /// A direction drawn in proportion to the sky's luminance, and its density per steradian.
    std::pair<Vec3f, float> sample(std::array<float, 2> u) const;
    float density(Vec3f direction) const;

    bool has_sun() const { return sun_irradiance_.x + sun_irradiance_.y + sun_irradiance_.z > 0; }
    /// A direction to a point of the sun's disc, uniform in solid angle.
    Vec3f sample_sun(std::array<float, 2> u) const;
    Vec3f sun_irradiance() const { return sun_irradiance_; }
    Vec3f sun_direction() const { return sun_; }
    /// Radiance of the disc in this direction, zero beside it.
    Vec3f sun_disc(Vec3f direction) const;

    /// Radiance of a white matt surface that lies well: what exposures are measured against.
    float white() const { return white_; }

private:
    void finish(bool below);
    std::size_t cell(Vec3f direction) const;
    Vec3f table_radiance(Vec3f direction) const;

    static constexpr int kElevations = 96, kAzimuths = 64;  // radiance table, half of the dome
    static constexpr int kRows = 64, kColumns = 64;         // equal-area cells of the whole sphere

    bool is_uniform_ = false;
    float uniform_ = 0;
    Vec3f sun_{0, 0, 1}, sun_x_{1, 0, 0}, sun_y_{0, 1, 0};  // the disc's axes
    Vec3f flat_{1, 0, 0};                                   // horizontal, towards the sun
    float sun_cos_ = 1;
    Vec3f sun_irradiance_, below_;
    float white_ = 1;
    std::vector<Vec3f> table_;
    std::vector<float> cumulative_, density_;
};

}  // namespace sekitei::render
