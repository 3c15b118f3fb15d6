#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/progress.h"

/// Temperature, humidity and water of the ground under a day's weather [Nomura2010, section 3.2].
///
/// A site is a piece of ground: a surface cell of a volume or a face of a mesh. Radiation is a
/// 24-hour mean [W/m^2], temperature [K], humidity 0..1, water [mm], pressure [hPa].
namespace sekitei::soil {

inline constexpr double kStefanBoltzmann = 5.67e-8;  ///< sigma [W m^-2 K^-4]
inline constexpr double kAirDensity = 1.20;          ///< rho [kg/m^3]
inline constexpr double kAirHeat = 1210;             ///< c_p rho [J m^-3 K^-1]
inline constexpr double kLatentHeat = 2.453e6;       ///< iota at 20 C [J/kg]
inline constexpr double kDiffusivity = 2.54e-5;      ///< D_ATM, of vapour in air [m^2/s]
inline constexpr double kDaySeconds = 86400;

/// How hard it is for water to leave a soil: F(theta) = scale (1 - theta / porosity)^exponent [m].
struct Soil {
    std::string name = "humus";
    double scale = 0.172351295;  ///< F of dry soil [m]
    double exponent = 10;
    double porosity = 0.490;  ///< theta_sat, water volume per soil volume when full
    std::optional<double> albedo;  ///< in place of Params::albedo

    static void describe(auto&& field)
    {
        field("name", &Soil::name, "what recipes call it");
        field("scale", &Soil::scale, "m", kPositive, "F0, length of diffusion through dry soil");
        field("exponent", &Soil::exponent, "", kPositive, "F2, how fast F falls as soil wets");
        field("porosity", &Soil::porosity, "", Range{.lower = 0, .upper = 1, .without_lower = true},
              "theta_sat, share of volume that water can fill");
        field("albedo", &Soil::albedo, "", between(0, 0.95),
              "share of sunlight that it throws back; auto: that of all ground");
    }
};

/// humus, sand, rock, asphalt, asphalt_printed; data/soils/ holds the same for users to edit.
const std::vector<Soil>& preset_soils();
void validate(const Soil& soil);

enum class Balance {
    Exact,  ///< the root of the energy balance
    Linear  ///< linear in T_s - T, as in the paper
};
constexpr std::array<std::string_view, 2> choice_names(Balance)
{
    return {"exact", "linear"};
}
enum class Longwave {
    Paper,     ///< clear sky of fixed emissivity 0.74
    Brutsaert  ///< 1.24 (e / T)^(1/7) [Brutsaert1975]
};
constexpr std::array<std::string_view, 2> choice_names(Longwave)
{
    return {"paper", "brutsaert"};
}

struct Params {
    Balance balance = Balance::Exact;
    Longwave longwave = Longwave::Paper;
    double albedo = 0.20;
    double exchange_bare = 0.0015;
    double exchange_covered = 0.0030;
    double lowest_wind = 0.05;
    bool moss_blocks_evaporation = false;

    static void describe(auto&& field)
    {
        field("balance", &Params::balance,
              "energy balance solved exactly, or linearised as in the paper");
        field("longwave", &Params::longwave,
              "emissivity of the clear sky: 0.74 (paper), or by its vapour");
        field("albedo", &Params::albedo, "", kFraction,
              "share of sunlight that the ground throws back");
        field("exchange_bare", &Params::exchange_bare, "", kPositive,
              "bulk coefficient C_H of bare ground");
        field("exchange_covered", &Params::exchange_covered, "", kPositive,
              "C_H of ground covered by moss");
        field("lowest_wind", &Params::lowest_wind, "m/s", kPositive,
              "floor of the local wind speed");
        field("moss_blocks_evaporation", &Params::moss_blocks_evaporation,
              "moss raises the exchange of heat but not of vapour");
    }
};
void validate(const Params& params);

/// What one day has in common for all sites.
struct Air {
    double sunshine = 0;             ///< A = N / N0, 0..1
    double pressure = 1013;          ///< [hPa]
    std::optional<double> longwave;  ///< measured, from the whole sky [W/m^2]
};

/// One site on one day.
struct Site {
    double light = 0;        ///< S on the site's plane [W/m^2]
    double temperature = 0;  ///< T of the air [K]
    double humidity = 0;     ///< rh of the air
    double rain = 0;         ///< P that reaches the site, with what runs onto it [mm]
    double wind = 0;         ///< U at the site [m/s]
    double sky_view = 1;     ///< V
    double cover = 0;        ///< c, share covered by moss; more than 1 counts as 1
    double depth = 300;      ///< h of the soil [mm]
    double water = 0;        ///< O at yesterday's end [mm]
};

struct Day {
    double temperature = 0;  ///< T_s of the surface [K]
    double humidity = 0;     ///< rh_s at the surface, in (0, 1]
    double evaporation = 0;  ///< E, negative for dew [mm/day]
    double water = 0;        ///< O at the day's end [mm]
    double beta = 0;         ///< share of the potential exchange of vapour
    double runoff = 0;       ///< rain and dew that found no room [mm]
    double absorbed = 0;     ///< R = (1 - albedo) S + L [W/m^2]
    double sensible = 0;     ///< H, heat given to the air [W/m^2]
    double latent = 0;       ///< iota E [W/m^2]
};

/// One day of one site: rain, beta, energy balance with the dew rule, supply limit.
///
/// Where the balance drives T_s below the dew point, vapour condenses unhindered by the soil
/// (beta = 1). No more evaporates than there is. Balance, exact: R = sigma T_s^4 + H + iota E
/// (1e-8 W/m^2); linear: with sigma T^4 + 4 sigma T^3 (T_s - T). Water: O + P = O' + E + runoff
/// (1e-9 mm).
/// @param soil, params  as validate() accepts them
/// @throws InvalidInput  "soil: temperature = 400 K, must be 180 to 340"
Day day(const Site& site, const Air& air, const Soil& soil, const Params& params);

/// Thermodynamics; T in kelvin.
double vapour_pressure(double temperature);  ///< e_sat [hPa]
/// q_sat; infinity where the vapour pressure leaves no room for air.
double saturation_humidity(double temperature, double pressure);
double saturation_slope(double temperature, double pressure);  ///< Delta = dq_sat/dT [1/K]
/// Temperature at which the specific humidity `q` saturates; 0 for q <= 0.
double dew_point(double q, double pressure);
/// beta = 1 / (1 + C_H U F(theta) / D_ATM)
double evaporation_share(const Soil& soil, double theta, double exchange, double wind);
/// C(A), by which clouds change the sky's longwave loss.
double cloud_factor(double sunshine);

/// One value for each site, or one for all. Views what it is made from.
template <class T>
class Values {
public:
    Values(T all) : all_(all) {}
    Values(const std::vector<T>& each) : each_(each.data()), size_(each.size()) {}
    Values(std::span<const T> each) : each_(each.data()), size_(each.size()) {}
    T operator[](std::size_t i) const { return size_ ? each_[i] : all_; }
    /// Whether there is a value for each of `count` sites.
    bool fits(std::size_t count) const { return !each_ || size_ == count; }

private:
    T all_{};
    const T* each_ = nullptr;
    std::size_t size_ = 0;
};

/// Many sites on one day, as a structure of arrays.
struct Inputs {
    std::span<const double> water;  ///< O at yesterday's end [mm]; its size is the number of sites
    Values<float> light, temperature, humidity;
    Values<double> rain;
    Values<float> wind, sky_view, cover, depth;
    std::span<const std::uint8_t> soil;  ///< index into `soils`; empty: all are the first
    std::span<const Soil> soils;
    Air air;
};

struct Result {
    std::vector<double> water, evaporation, runoff;  ///< [mm]
    std::vector<float> temperature, humidity, beta;
};

/// day() for every site, into `result`, whose storage is reused.
///
/// @throws InvalidInput    the first bad site, its field, value and range; `result` is unchanged
/// @throws NumericalError  a result that is not finite, with the site's inputs; like Cancelled it
///                         leaves `result` unfinished
///
/// Bit-identical for any number of threads, and equal to day() up to the rounding to float.
void run(const Inputs& inputs, const Params& params, Result& result, const Progress& progress);

/// Surface on which rain runs: a graph of sites.
struct Surface {
    std::span<const Vec3d> position;   ///< on the surface [m], z up
    std::span<const float> normal_up;  ///< z of the outward unit normal
    std::span<const float> area;       ///< [m^2]
    /// Neighbours of site i: neighbour[neighbour_begin[i] .. neighbour_begin[i + 1]).
    std::span<const std::uint32_t> neighbour_begin, neighbour;
    /// Site that a drop from an underside falls on, -1: none. Empty: all leave.
    std::span<const std::int32_t> drop_target;
};

/// Where the water of each site goes; a function of the geometry alone.
struct Paths {
    std::vector<std::uint32_t> order;  ///< every site after all that drain into it
    std::vector<std::uint32_t> begin,
        target;                ///< site i drains into target[begin[i] .. begin[i + 1])
    std::vector<float> share;  ///< of the water, 0..1; the last target takes the rest
    std::size_t ends = 0;      ///< sites from which water leaves the surface
};

/// Water flows to all lower neighbours with weights slope^1.1 [Freeman1991], slope = drop over
/// distance, so that walls have one too. Over level ground it takes the shortest way to a site with
/// a lower neighbour. From undersides (normal_up < -0.3) it falls on the drop target. From pits it
/// leaves: puddles are not modelled.
/// @throws InvalidInput  arrays of different lengths, a neighbour or target out of range, a target
///                       above its site, positions or areas that are not finite
Paths runoff_paths(const Surface& surface, const Progress& progress);

struct Runoff {
    std::vector<double> supply;  ///< rain plus what runs onto the site [mm]: Site::rain
    std::vector<double> run;     ///< what finds no room and goes on [mm]
    double outflow = 0;          ///< what leaves the surface [mm m^2 = litres]
};

/// Sends one day's rain from high to low; each site keeps what it has room for.
///
/// sum(rain area) = sum((supply - run) area) + outflow to 1e-12 of its value.
/// @param capacity  h porosity of each site [mm]
/// @param water     O at yesterday's end [mm]
/// @param rain      [mm]; may be result.supply itself
void route_rain(const Paths& paths, std::span<const float> area, std::span<const double> capacity,
                std::span<const double> water, const Values<double>& rain, Runoff& result);

}  // namespace sekitei::soil
