#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/mesh.h"
#include "core/params.h"
#include "core/progress.h"
#include "core/vec.h"
#include "core/weather.h"
#include "solvers/light/veil.h"
#include "solvers/sun/sun.h"

/// Daily light and rain exposure of surfaces by daylight coefficients [Tregenza1983].
///
/// Rays are traced once for a geometry: one bit for each patch of the sky and each bin of the sun's
/// paths. Every day is then a dot product. World axes: x east, y north, z up; radiation is a
/// 24-hour mean [W/m^2].
namespace sekitei::light {

enum class Sky {
    Tregenza,  ///< 145 patches [Tregenza1987]
    Reinhart   ///< 577, each of them in four
};
constexpr std::array<std::string_view, 2> choice_names(Sky)
{
    return {"tregenza", "reinhart"};
}

struct Params {
    Sky sky = Sky::Tregenza;
    int sky_split = 2;
    int sun_rows = 16;
    int sun_bins = 480;
    int rain_rays = 32;
    double rain_cone = 10;
    double fall_speed = 6;
    double albedo = 0.20;
    double ground_albedo = 0.20;
    int bounces = 1;
    int links = 8;
    std::optional<double> ground;

    static void describe(auto&& field)
    {
        field("sky", &Params::sky, "patches of the sky: tregenza (145) or reinhart (577)");
        field("sky_split", &Params::sky_split, "", between(1, 8),
              "rays for a patch, along and across: V counts them all, a bit their majority");
        field("sun_rows", &Params::sun_rows, "", between(2, 64),
              "declinations of the sun at which visibility is stored");
        field("sun_bins", &Params::sun_bins, "", between(64, 16384),
              "bits a site for the sun, shared among its rows");
        field("rain_rays", &Params::rain_rays, "", between(4, 4096),
              "least number of directions that rain comes from");
        field("rain_cone", &Params::rain_cone, "deg", between(0, 45),
              "half angle by which drops stray from their mean direction");
        field("fall_speed", &Params::fall_speed, "m/s", kPositive, "of rain drops");
        field("albedo", &Params::albedo, "", kFraction, "diffuse reflectance of the surfaces");
        field("ground_albedo", &Params::ground_albedo, "", kFraction,
              "diffuse reflectance of the level ground around");
        field("bounces", &Params::bounces, "", between(0, 8),
              "diffuse reflections followed; 0: the ground alone, nothing in its way");
        field("links", &Params::links, "", between(1, 256),
              "directions a site in which is kept what reflects light onto it");
        field("ground", &Params::ground, "m", kAny,
              "height of level ground; sites below it are buried; auto: far down");
    }
};
void validate(const Params& params);

/// Pieces of surface, as a structure of arrays; views what it is made from.
struct Sites {
    std::span<const Vec3d> origin;  ///< where rays start, just above the surface [m]
    std::span<const Vec3f> normal;  ///< unit, outwards
    std::span<const float> area;    ///< [m^2]
    std::size_t size() const { return origin.size(); }
};

/// Rain that comes with one wind.
struct RainWind {
    int direction = 0;  ///< 0..7 = N NE E SE S SW W NW, where it blows from
    double speed = 0;   ///< [m/s]
    double weight = 1;  ///< share of the rain; the sum need not be 1
};

/// The winds of these days' rain: up to 8, each with its mean speed, weighted by precipitation.
/// Without any rain one calm.
std::vector<RainWind> rain_winds(std::span<const WeatherDay> days);

/// The directions that are traced, and where their bits are.
struct Directions {
    struct Part {
        Vec3f centre;
        Vec3f weight;  ///< integral of the direction over the part: its cosine-weighted size
        int patch;
    };
    /// Bins of one declination, from sunrise to sunset by equal hour angles.
    struct Row {
        double declination = 0, sunset = 0;  ///< [rad]
        int first = 0, count = 0;            ///< bins; none in polar night
    };
    struct Drop {
        Vec3f from;    ///< towards where the drop comes from
        float weight;  ///< share / from.z
    };
    int patches = 0;         ///< of the sky: bits 0 .. patches - 1
    std::vector<Part> sky;   ///< their parts, a ray each, by patch
    std::vector<Row> rows;   ///< south to north
    std::vector<Vec3f> sun;  ///< the bins' centres: the bits of words from sun_word on
    int sun_word = 0, words = 0;
    std::vector<Drop> rain;
};
/// @param latitude  north positive [rad]
Directions directions(double latitude, std::span<const RainWind> winds, const Params& params);

/// What rays found, for each site. A function of geometry, latitude and winds; of no weather.
struct Coefficients {
    Params params;
    double latitude = 0;
    std::vector<RainWind> winds;
    std::size_t sites = 0;
    /// Word w of site i is bits[w * sites + i]; bit b of it is 1 << b. 1 = visible.
    std::vector<std::int32_t> bits;
    std::vector<float> sky_view;       ///< V = V_c, cosine-weighted share of sky, 0..1
    std::vector<float> rain_exposure;  ///< e: rain on the site / rain on open level ground
    /// Link k of site i is links[k * sites + i], what reflects onto it. Empty without bounces.
    std::vector<std::int32_t> links;

    std::size_t words() const { return sites ? bits.size() / sites : 0; }
    /// One word of all sites, for points `daylight`; and back.
    std::vector<std::int32_t> word(std::size_t w) const;
    std::size_t bytes_per_site() const;
};

/// Whether a word of Coefficients::links says something that exists among so many sites.
bool link_fits(std::int32_t link, std::int32_t sites);

/// Traces everything.
///
/// V integrates the parts of patches that are seen, in proportion to the whole sky, so that a plane
/// in the open has exactly (1 + n_z) / 2. Rain: e = mean over drops r of Vis(r) max(0, n.r) / r_z.
/// @param occluders  meshes that may hide the sky; those that carry the sites among them
/// A veil of leaves lets through a share of the light of each part of the sky. A bit cannot tell
/// shares: those of a row of the sun are lit so often as the light comes through, evenly spread
/// from a beginning that differs from site to site, like flecks of sun; so are links. Rain drips
/// through.
/// @param latitude   [rad]
/// @param veil       leaves of a canopy; null: none
/// @throws InvalidInput  arrays of different lengths, sites that are not finite, bad meshes
/// @throws Cancelled
///
/// Bit-identical for any number of threads.
Coefficients trace(const Sites& sites, std::span<const TriMesh* const> occluders, double latitude,
                   std::span<const RainWind> winds, const Params& params, const Progress& progress,
                   const Veil* veil = nullptr);

/// The coefficients after some occluders changed, moved, came or went.
///
/// Only rays that meet a changed box are asked again; the result equals a full trace bit for bit.
/// @param occluders  all of them, after the change
/// @param changed    boxes that hold every triangle that is new or gone
/// @param veil       the same as before
Coefficients retrace(const Coefficients& old, const Sites& sites,
                     std::span<const TriMesh* const> occluders, std::span<const Bounds> changed,
                     const Progress& progress, const Veil* veil = nullptr);

struct Light {
    std::vector<float> total, direct, sky, reflected;
};

/// The light of one day: S = direct + sky + reflected.
///
/// Direct: DNI times the moments' cosines, where the bits nearest in hour angle say that the sun is
/// seen, interpolated between two declinations. Sky: G_d V. Reflected: diffuse bounces between
/// sites, other occluders and the ground along the links; see README.
Light day(const Coefficients& coefficients, const Sites& sites,
          std::span<const sun::Moment> moments, const sun::Radiation& radiation);

}  // namespace sekitei::light
