#pragma once

#include <cstddef>
#include <vector>

#include "core/vec.h"
#include "core/weather.h"

/// Where the sun stands and how much of its light reaches the ground on a day.
///
/// World axes: x east, y north, z up. Radiation is a 24-hour mean in W/m^2.
namespace sekitei::sun {

struct Position {
    double elevation = 0;  ///< above the horizon, geometric: no refraction [rad]
    double azimuth = 0;    ///< from north over east, 0 .. 2 pi [rad]
};

/// Julian day of a moment in universal time; `hours` may lie outside 0 .. 24.
/// @throws InvalidParameter  a date that does not exist
double julian_day(int year, int month, int day, double hours);

/// Low-precision position of [Meeus1998, ch. 25], as in NOAA's solar calculator: better than 0.02
/// degrees from 1950 to 2050.
Position position(double julian_day, const Site& site);

/// Unit vector towards the sun.
Vec3d direction(const Position& position);

/// One moment of a day.
struct Moment {
    Vec3d to_sun;
    double elevation = 0;  ///< [rad]
    double hour = 0;       ///< true solar time, 12 at noon [h]
    double share = 0;      ///< of 24 hours: its weight in a daily mean
};

/// Sun positions at the middles of `count` equal parts of the time from sunrise to sunset on a
/// calendar day of local time. None in polar night.
/// @param count  >= 1; 96 or more for daily sums
/// @throws InvalidParameter  count, date or latitude
std::vector<Moment> moments_of_day(int year, int month, int day, const Site& site,
                                   std::size_t count = 96);

/// Light of one day on the horizontal, and the beam across it.
struct Radiation {
    double extraterrestrial = 0;  ///< Ra
    double global = 0;            ///< G_h
    double diffuse = 0;           ///< G_d
    double beam = 0;              ///< G_b = G_h - G_d
    /// DNI, constant while the sun is up, so that the moments given add up to `beam` [W/m^2]
    double beam_normal = 0;
};

/// G_h as measured, or Ra (0.25 + 0.50 N / N0) [Allen1998, eq. 35]; G_d as measured, or the daily
/// diffuse share of [Erbs1982]. Polar night gives zeros.
/// @param moments  moments_of_day() of the same day and site
Radiation radiation(const WeatherDay& day, const Site& site, const std::vector<Moment>& moments);

/// Diffuse share of daily global radiation for clearness K = G_h / Ra [Erbs1982].
double diffuse_share(double clearness, double sunset_angle);

/// Light on a plane that sees the whole sky and level ground.
struct PlaneLight {
    double direct = 0, sky = 0, ground = 0;
    double total() const { return direct + sky + ground; }
};

/// @param normal  unit vector; the sky is isotropic, the ground reflects `albedo` diffusely
PlaneLight light_on_plane(Vec3d normal, const std::vector<Moment>& moments,
                          const Radiation& radiation, double albedo);

}  // namespace sekitei::sun
