#pragma once

#include <array>
#include <string>
#include <string_view>

#include "core/params.h"

/// Kinds of trees.
namespace sekitei::tree {

enum class Model {
    Dichotomy,  ///< every tip forks in two [Kanamaru1992, section 4.1 (2)]
    Shoot,      ///< buds grow on without forking [Kanamaru1992, section 4.1 (1)]
    Conifer     ///< a leader with whorls of boughs, which bear shoots
};
constexpr std::array<std::string_view, 3> choice_names(Model)
{
    return {"dichotomy", "shoot", "conifer"};
}
enum class Azimuth { Fixed, Random };
constexpr std::array<std::string_view, 2> choice_names(Azimuth)
{
    return {"fixed", "random"};
}
enum class BudPlaces { Sphere, Cylinder };
constexpr std::array<std::string_view, 2> choice_names(BudPlaces)
{
    return {"sphere", "cylinder"};
}
enum class LeafOrientation { Spherical, Planophile };
constexpr std::array<std::string_view, 2> choice_names(LeafOrientation)
{
    return {"spherical", "planophile"};
}

/// Lengths are in branch lengths (one ordinary branch = 1), as in the paper, unless they carry a
/// unit. Defaults: the tree of its table 1.
struct Species {
    std::string name = "table-1";
    Model model = Model::Dichotomy;
    double tropism = 0.4;
    double ball_radius = 2.0;
    double death_threshold = 0.6;
    double death_dither = 0.3;
    double branch_angle = 10;
    double first_length = 15;
    Azimuth vertical_azimuth = Azimuth::Fixed;
    int leaf_retention = 1;
    // Shoots.
    int buds = 50;
    BudPlaces bud_places = BudPlaces::Sphere;
    double bud_radius = 5;
    double bud_height = 30;
    int stagger = 20;
    // Conifers.
    double leader_tropism = 0.1;
    // Buds, boughs, dead wood.
    double latent_share = 0;
    double latent_light = 0.8;
    double latent_chance = 0.1;
    int latent_age = 100;
    int active_period = 0;
    int shed_delay = 0;
    int strong_boughs = 0;
    int bough_generation = 3;
    double dead_persist = 0;
    // Wood and leaves.
    double pipe_exponent = 2.0;
    double tip_radius = 0.0015;
    double pipe_memory = 0.5;
    double leaf_projection = 0.5;
    double leaf_size = 0.06;
    LeafOrientation leaf_orientation = LeafOrientation::Spherical;

    static void describe(auto&& field)
    {
        field("name", &Species::name, "what recipes call it");
        field("model", &Species::model, "how it branches: dichotomy, shoot or conifer");
        field("tropism", &Species::tropism, "", kFraction,
              "I, share of the angle to the light that a tip turns by");
        field("ball_radius", &Species::ball_radius, "", between(1e-3, 1e3),
              "R of the leaves of one tip, in branch lengths");
        field("death_threshold", &Species::death_threshold, "", between(-10, 10),
              "D0, light below which tips die; -1: none dies");
        field("death_dither", &Species::death_dither, "", between(0, 10),
              "by how much thresholds differ from tip to tip");
        field("branch_angle", &Species::branch_angle, "deg",
              Range{.lower = 0, .upper = 90, .without_lower = true, .without_upper = true},
              "of both forks against their parent");
        field("first_length", &Species::first_length, "",
              Range{.lower = 0, .upper = 1e4, .without_lower = true},
              "of the first branch, in branch lengths");
        field("vertical_azimuth", &Species::vertical_azimuth,
              "plane of a vertical branch's forks: fixed along x, or random");
        field("leaf_retention", &Species::leaf_retention, "", between(1, 100),
              "generations that leaves stay; 1: only on tips");
        field("buds", &Species::buds, "", between(1, 1e6), "shoot: how many");
        field("bud_places", &Species::bud_places, "shoot: in a sphere or on a cylinder");
        field("bud_radius", &Species::bud_radius, "",
              Range{.lower = 0, .upper = 1e4, .without_lower = true},
              "shoot: of that, in branch lengths");
        field("bud_height", &Species::bud_height, "",
              Range{.lower = 0, .upper = 1e4, .without_lower = true},
              "shoot: of the cylinder, in branch lengths");
        field("stagger", &Species::stagger, "", between(1, 1000),
              "shoot: buds germinate in generations 1 to this");
        field("leader_tropism", &Species::leader_tropism, "", kFraction,
              "conifer: I of the leader");
        field("latent_share", &Species::latent_share, "", kFraction,
              "branches that keep a dormant bud, which a cut above it wakes; 0: none, 1: all");
        field("latent_light", &Species::latent_light, "", kFraction,
              "light from which dormant buds sprout");
        field("latent_chance", &Species::latent_chance, "", kFraction,
              "with which they then do, in a generation");
        field("latent_age", &Species::latent_age, "", between(0, 10000),
              "generations that buds stay alive");
        field("active_period", &Species::active_period, "", between(0, 10000),
              "generations after which a bough stops branching; 0: never");
        field("shed_delay", &Species::shed_delay, "", between(0, 10000),
              "generations from then until it falls");
        field("strong_boughs", &Species::strong_boughs, "", between(0, 1000),
              "thickest boughs, which last twice as long");
        field("bough_generation", &Species::bough_generation, "", between(1, 100),
              "dichotomy: generation at which boughs begin");
        field("dead_persist", &Species::dead_persist, "", between(0, 10000),
              "generations that dead wood of tip_radius hangs on, on average; 0: none");
        field("pipe_exponent", &Species::pipe_exponent, "", between(1, 4),
              "e: r^e of a branch is the sum over what it bears");
        field("tip_radius", &Species::tip_radius, "m", between(1e-5, 1),
              "of the youngest branches");
        field("pipe_memory", &Species::pipe_memory, "", kFraction,
              "share of their wood that dead tips leave behind");
        field("leaf_projection", &Species::leaf_projection, "",
              Range{.lower = 0, .upper = 1, .without_lower = true},
              "G, area that a leaf shows to light, by its own");
        field("leaf_size", &Species::leaf_size, "m", between(1e-3, 10), "length of a leaf");
        field("leaf_orientation", &Species::leaf_orientation,
              "spherical: any; planophile: across the light");
    }
};
/// @throws InvalidParameter
void validate(const Species& species);

}  // namespace sekitei::tree
