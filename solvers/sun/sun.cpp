#include "solvers/sun/sun.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/math.h"
#include "core/solar_day.h"

namespace sekitei::sun {
namespace {

using math::kPi;

constexpr double kDegree = kPi / 180;

void check_date(int year, int month, int day)
{
    if (!date_exists(year, month, day))
        throw InvalidParameter(fmt::format("sun: date = {:04}-{:02}-{:02}, must be in the calendar",
                                           year, month, day));
}

void check_site(const Site& site)
{
    if (!(std::abs(site.latitude) <= kPi / 2))
        throw InvalidParameter(
            fmt::format("sun: latitude = {:.6g} deg, must be -90 to 90", site.latitude / kDegree));
    if (!(std::abs(site.longitude) <= 2 * kPi))
        throw InvalidParameter(fmt::format("sun: longitude = {:.6g} deg, must be -360 to 360",
                                           site.longitude / kDegree));
}

/// The angle in [0, 2 pi).
double turn(double angle)
{
    const double a = angle - 2 * kPi * std::floor(angle / (2 * kPi));
    return a < 2 * kPi ? a : 0;
}

struct Equatorial {
    double sin_declination, cos_declination;
    double hour_angle;  ///< westwards from the meridian, 0 .. 2 pi
};

Equatorial equatorial(double julian_day, double longitude)
{
    const double days = julian_day - 2451545.0, t = days / 36525;
    // The sun's apparent longitude: mean longitude, equation of the centre, aberration, nutation.
    const double l0 = (280.46646 + t * (36000.76983 + t * 0.0003032)) * kDegree;
    const double m = (357.52911 + t * (35999.05029 - 0.0001537 * t)) * kDegree;
    const double centre = (1.914602 - t * (0.004817 + 0.000014 * t)) * math::sin(m) +
                          (0.019993 - 0.000101 * t) * math::sin(2 * m) +
                          0.000289 * math::sin(3 * m);
    const double node = (125.04 - 1934.136 * t) * kDegree;
    const double apparent = l0 + (centre - 0.00569 - 0.00478 * math::sin(node)) * kDegree;
    const double obliquity =
        (23 + (26 + (21.448 - t * (46.815 + t * (0.00059 - t * 0.001813))) / 60) / 60 +
         0.00256 * math::cos(node)) *
        kDegree;
    const double sl = math::sin(apparent), cl = math::cos(apparent);
    const double ascension = math::atan2(math::cos(obliquity) * sl, cl);
    const double sd = math::sin(obliquity) * sl;
    const double sidereal = (280.46061837 + 360.98564736629 * days) * kDegree;
    return {sd, std::sqrt((1 - sd) * (1 + sd)), turn(sidereal + longitude - ascension)};
}

}  // namespace

double julian_day(int year, int month, int day, double hours)
{
    check_date(year, month, day);
    return 2440587.5 + static_cast<double>(day_number(year, month, day)) + hours / 24;
}

Position position(double julian_day, const Site& site)
{
    check_site(site);
    const Equatorial sun = equatorial(julian_day, site.longitude);
    // The horizon's axes.
    const double sp = math::sin(site.latitude), cp = math::cos(site.latitude);
    const double ch = math::cos(sun.hour_angle), sh = math::sin(sun.hour_angle);
    const double up = sp * sun.sin_declination + cp * sun.cos_declination * ch;
    const double north = cp * sun.sin_declination - sp * sun.cos_declination * ch;
    const double east = -sun.cos_declination * sh;
    return {math::atan2(up, std::sqrt(north * north + east * east)),
            turn(math::atan2(east, north))};
}

Vec3d direction(const Position& p)
{
    const double level = math::cos(p.elevation);
    return {level * math::sin(p.azimuth), level * math::cos(p.azimuth), math::sin(p.elevation)};
}

std::vector<Moment> moments_of_day(int year, int month, int day, const Site& site,
                                   std::size_t count)
{
    if (count < 1) throw InvalidParameter("sun: moments a day = 0, must be >= 1");
    check_site(site);
    // True noon: mean noon, corrected by the equation of time.
    double noon = julian_day(year, month, day, 12 - site.longitude / (2 * kPi) * 24);
    double hour = equatorial(noon, site.longitude).hour_angle;
    if (hour > kPi) hour -= 2 * kPi;
    noon -= hour / (2 * kPi);
    // Half the time from sunrise to sunset, as an angle.
    const Equatorial sun = equatorial(noon, site.longitude);
    const double cosine = math::cos(site.latitude) * sun.cos_declination;
    const double sine = math::sin(site.latitude) * sun.sin_declination;
    if (sine <= -cosine) return {};
    const double half = sine >= cosine ? kPi : math::acos(-sine / cosine);

    std::vector<Moment> moments;
    moments.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
        const double angle =
            (2 * (static_cast<double>(i) + 0.5) / static_cast<double>(count) - 1) * half;
        const Position p = position(noon + angle / (2 * kPi), site);
        if (p.elevation <= 0) continue;  // the declination moved a little since noon
        moments.push_back({direction(p), p.elevation, 12 * (1 + angle / kPi),
                           half / kPi / static_cast<double>(count)});
    }
    return moments;
}

double diffuse_share(double k, double sunset_angle)
{
    if (sunset_angle >= 81.4 * kDegree)
        return k < 0.722 ? 1 + k * (0.2832 + k * (-2.5557 + k * 0.8448)) : 0.175;
    return k < 0.715 ? 1 + k * (-0.2727 + k * (2.4495 + k * (-11.9514 + k * 9.3879))) : 0.143;
}

Radiation radiation(const WeatherDay& day, const Site& site, const std::vector<Moment>& moments)
{
    check_date(day.year, day.month, day.day);
    check_site(site);
    const int j = day_of_year(day.year, day.month, day.day);
    const double sunshine =
        day.possible_sunshine > 0 ? std::min(1.0, day.sunshine / day.possible_sunshine) : 0;
    Radiation r;
    r.extraterrestrial = extraterrestrial_radiation(site.latitude, j);
    r.global = day.global_radiation.value_or(r.extraterrestrial * (0.25 + 0.50 * sunshine));
    if (day.diffuse_radiation)
        r.diffuse = std::min(*day.diffuse_radiation, r.global);
    else if (r.extraterrestrial > 0)
        r.diffuse =
            r.global * diffuse_share(r.global / r.extraterrestrial, sunset_angle(site.latitude, j));
    else
        r.diffuse = r.global;  // twilight

    // Light that no moment's sun can carry is the sky's: a night between twilights.
    double sines = 0;
    for (const Moment& m : moments) sines += m.to_sun.z * m.share;
    if (sines <= 0) r.diffuse = r.global;
    r.beam = r.global - r.diffuse;
    if (sines > 0) r.beam_normal = r.beam / sines;
    return r;
}

PlaneLight light_on_plane(Vec3d normal, const std::vector<Moment>& moments, const Radiation& r,
                          double albedo)
{
    double cosines = 0;
    for (const Moment& m : moments) cosines += std::max(0.0, dot(normal, m.to_sun)) * m.share;
    return {r.beam_normal * cosines, r.diffuse * (1 + normal.z) / 2,
            albedo * r.global * (1 - normal.z) / 2};
}

}  // namespace sekitei::sun
