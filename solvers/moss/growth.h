#pragma once

#include <array>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/progress.h"

/// The rules by which a moss lives: fitness, growth, death, seeds [Nomura2010, section 3.3].
///
/// Pure functions of one individual and one day. Temperature [K], humidity 0..1, light as 24-hour
/// mean [W/m^2], growth in units of G_moss (2 = full size), age in days.
namespace sekitei::moss {

/// Where a moss thrives, and how fast. Fitness is 1/2 at both ends of each range.
struct Species {
    std::string name = "bryum";
    double temperature_low = 274.15, temperature_high = 299.15, temperature_softness = 1;
    double humidity_low = 0.80, humidity_high = 1.20, humidity_softness = 0.5;
    double light_low = 0, light_high = 60, light_softness = 1;
    double growth_rate = 0.30;
    double growth_threshold = 0.100;
    double germination_threshold = 0.40;
    double death_threshold = 0.10;
    double priority = 0;

    static void describe(auto&& field)
    {
        constexpr Range kSoftness{.lower = 0, .upper = 1, .without_lower = true};
        constexpr Range kOpen{.lower = 0, .upper = 1, .without_lower = true, .without_upper = true};
        field("name", &Species::name, "what recipes and grids call it");
        field("temperature_low", &Species::temperature_low, "K", kPositive,
              "T0: surface temperature below which fitness is under one half");
        field("temperature_high", &Species::temperature_high, "K", kPositive, "T1, the upper end");
        field("temperature_softness", &Species::temperature_softness, "", kSoftness,
              "n_T: 1 fades as a bell, smaller values make the ends steeper");
        field("humidity_low", &Species::humidity_low, "", kAny, "rh0 at the surface");
        field("humidity_high", &Species::humidity_high, "", kAny,
              "rh1; above 1 where saturation is best");
        field("humidity_softness", &Species::humidity_softness, "", kSoftness, "n_rh");
        field("light_low", &Species::light_low, "W/m^2", kAny, "S0, 24-hour mean");
        field("light_high", &Species::light_high, "W/m^2", kAny, "S1");
        field("light_softness", &Species::light_softness, "", kSoftness, "n_S");
        field("growth_rate", &Species::growth_rate, "", kOpen,
              "alpha_g, growth a day where fitness is 1, but for the threshold");
        field("growth_threshold", &Species::growth_threshold, "", kOpen,
              "tau_g, fitness at which growth and decay balance");
        field("germination_threshold", &Species::germination_threshold, "", kOpen,
              "tau_b, fitness times freshness that a seed needs");
        field("death_threshold", &Species::death_threshold, "", kOpen,
              "tau_d, growth below which a shrinking moss dies");
        field("priority", &Species::priority, "", kAny, "added to growth where two want one place");
    }
};

/// bryum, hypnum, polytrichum [Nomura2010, table 4.2] and grimmia, a sun-loving cushion of our own;
/// data/species/ holds the same for users to edit.
const std::vector<Species>& preset_species();

/// @throws InvalidParameter  "species bryum: temperature_high = 270 K, must be > temperature_low =
///                           274.15 K"
void validate(const Species& species);

enum class Response {
    Normalised,  ///< fitness factors in 0..1
    Printed      ///< as printed, -0.21..1.21 for softness 1/2, cut at 0
};
constexpr std::array<std::string_view, 2> choice_names(Response)
{
    return {"normalised", "printed"};
}

/// What all species have in common.
struct Rules {
    Response response = Response::Normalised;
    bool light_gate = true;
    double light_compensation = 1.5;
    double growth_rate = 1;
    double growth_cap = 10;
    double gemma_step = 0.5;
    double spore_threshold = 2.0;
    double gemma_age_low = -60, gemma_age_high = 60;
    double spore_age_low = 60, spore_age_high = 365;

    static void describe(auto&& field)
    {
        field("response", &Rules::response, "form of the fitness factors");
        field("light_gate", &Rules::light_gate, "nothing grows in the dark");
        field("light_compensation", &Rules::light_compensation, "W/m^2", kPositive,
              "light Sc at which the gate 1 - exp(-S / Sc) is 63 %");
        field("growth_rate", &Rules::growth_rate, "",
              Range{.lower = 0, .upper = 100, .without_lower = true},
              "multiplies every species' rate; 0.02 is natural, 1 is the paper's clock");
        field("growth_cap", &Rules::growth_cap, "", kPositive, "largest growth");
        field("gemma_step", &Rules::gemma_step, "", kPositive, "growth from one gemma to the next");
        field("spore_threshold", &Rules::spore_threshold, "", kNotNegative,
              "growth from which a moss sheds one spore a day");
        field("gemma_age_low", &Rules::gemma_age_low, "d", kAny,
              "lower end of a gemma's germination bell");
        field("gemma_age_high", &Rules::gemma_age_high, "d", kAny, "upper end");
        field("spore_age_low", &Rules::spore_age_low, "d", kAny,
              "lower end of a spore's germination bell");
        field("spore_age_high", &Rules::spore_age_high, "d", kAny, "upper end");
    }
};
/// @throws InvalidParameter
void validate(const Rules& rules);

/// s = exp(-4 ln 2 ((x - (x0 + x1) / 2) / (x1 - x0))^2): 1 in the middle, 1/2 at both ends
/// [Nomura2010, eq. 3.18, with the natural logarithm].
double bell(double x, double x0, double x1);
/// g: the bell, its ends steeper for softness n < 1 [Nomura2010, eq. 3.19]. Normalised:
/// 1/2 + sgn(s - 1/2) (2 |s - 1/2|)^n / 2.
double response(double x, double x0, double x1, double softness, Response form);

/// The factors of G, for explanations.
struct Fitness {
    double temperature = 0, humidity = 0, light = 0;
    double gate = 1;
    double total() const { return temperature * humidity * light * gate; }  ///< G, 0..1
};
/// @param humidity  above 1 counts as 1
Fitness fitness(const Species& species, const Rules& rules, double temperature, double humidity,
                double light);

/// G of many sites, all spans of one length; in parallel, the same bits on any number of threads.
/// @throws InvalidInput  spans of different lengths
void fitness(const Species& species, const Rules& rules, std::span<const float> temperature,
             std::span<const float> humidity, std::span<const float> light, std::span<float> result,
             const Progress& progress);

/// D, growth of one day at fitness G; negative below the growth threshold.
double daily_growth(const Species& species, const Rules& rules, double fitness);
/// G_moss after a day of growth D: capped, not below 0.
double grown(const Rules& rules, double growth, double daily_growth);
/// Whether a moss that grew by D to G_moss = `growth` dies: both small and shrinking.
bool dies(const Species& species, double growth, double daily_growth);

/// Gemmae shed when the largest growth so far rises: one for each multiple of the step it reaches.
int gemmae_shed(const Rules& rules, double largest_before, double largest_now);
/// Whether a spore is shed today.
bool spore_shed(const Rules& rules, double growth, double daily_growth);

/// What a day brings a moss.
struct DayOfLife {
    bool died = false;
    int gemmae = 0;
    bool spore = false;
};
/// Lets a moss grow for a day; changes its growth and the largest so far.
DayOfLife live_a_day(const Species& species, const Rules& rules, double fitness, float& growth,
                     float& growth_max);

enum class Seed { Gemma, Spore };
/// How ready a seed is at an age [days since release]: 0..1.
double seed_readiness(Seed kind, const Rules& rules, int age);
/// Whether a seed germinates; fitness is that of its own species on its site. Never on day 0.
bool germinates(const Species& species, Seed kind, const Rules& rules, int age, double fitness);
/// Age after which the seed cannot germinate even at fitness 1; 0 if it never can.
int last_germination_age(const Species& species, Seed kind, const Rules& rules);

}  // namespace sekitei::moss
