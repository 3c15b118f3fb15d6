#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/progress.h"
#include "core/vec.h"
#include "solvers/tree/crown_light.h"
#include "solvers/tree/species.h"
#include "solvers/tree/surroundings.h"

/// Trees that reach for light [Kanamaru1992]: tips bear children; each child sees how light reaches
/// its leaves past all others, dies or bends towards it. No branch knows its place or role.
///
/// Tree space: branch lengths, z up; times unit_length: metres. Generations count from 1.
namespace sekitei::tree {

/// What all trees of a call share. Defaults: the paper's table 1.
struct GroveParams {
    double light_ratio_upper = 3, light_ratio_lower = 2;
    int patch_rows = 8, patch_columns = 16;
    double transmission = 0.90;
    Occlusion occlusion = Occlusion::Ahead;
    Method method = Method::Sweep;
    LightDirection light_direction = LightDirection::Mean;
    double unit_length = 0.2;
    bool ground = true;
    double clearance = 0.25;
    double obstacle_albedo = 0;
    int max_tips = 2'000'000;
    std::vector<double> keep_tips;

    static void describe(auto&& field)
    {
        field("light_ratio_upper", &GroveParams::light_ratio_upper, "", between(0, 1e6),
              "C1, brightness of the upper half of the sky");
        field("light_ratio_lower", &GroveParams::light_ratio_lower, "", between(0, 1e6),
              "C2, of the lower half; only C1/C2 matters");
        field("patch_rows", &GroveParams::patch_rows, "", between(2, 512),
              "V, patches of the sky from top to bottom; even");
        field("patch_columns", &GroveParams::patch_columns, "", between(3, 1024),
              "H, patches around");
        field("transmission", &GroveParams::transmission, "", kFraction,
              "tau, share of light that a tip's leaves let pass");
        field("occlusion", &GroveParams::occlusion,
              "which leaves shade: ahead, full (the paper's words) or exclude");
        field("method", &GroveParams::method, "how shade is found: naive, sweep, bvh or grid");
        field("light_direction", &GroveParams::light_direction,
              "where tips turn: the mean of all light, or the brightest part of the sky");
        field("unit_length", &GroveParams::unit_length, "m", between(1e-3, 100),
              "length of an ordinary branch");
        field("ground", &GroveParams::ground, "branches keep above z = 0 of their own origin");
        field("clearance", &GroveParams::clearance, "", between(0, 100),
              "that tips keep from obstacles, in branch lengths");
        field("obstacle_albedo", &GroveParams::obstacle_albedo, "", kFraction,
              "of obstacles, which return that much of the lower half's light");
        field("max_tips", &GroveParams::max_tips, "", between(1, 1e8),
              "growth stops after the generation that has more");
        field("keep_tips", &GroveParams::keep_tips, "", kNotNegative,
              "instead of death by light: how many children of each generation live, at random");
    }
};
/// @throws InvalidParameter
void validate(const GroveParams& params);

/// Where a tree stands.
struct Plant {
    Vec3d origin;     ///< [branch lengths]
    int species = 0;  ///< index
    int from = 0;     ///< generation before which it does not grow: trees of other ages
};

/// All branches, parents before their children; structure of arrays.
struct Branches {
    enum Flag : std::uint8_t {
        kTip = 1,         ///< bears leaves and children
        kObstructed = 2,  ///< died of an obstacle
        kSprout = 4,      ///< from a latent bud
        kCut = 8,         ///< pruned above: stays although it bears nothing
        kSpent = 16,      ///< its latent bud is gone
        kStrong = 32,     ///< root of a strong bough
        kLeader = 64,     ///< trunk: no part of any bough
        kDead = 128,      ///< wood without life
    };
    std::vector<std::int32_t> parent;      ///< -1: none
    std::vector<std::int32_t> tree;        ///< id: index of the plant
    std::vector<std::uint64_t> key;        ///< its random numbers
    std::vector<std::int32_t> generation;  ///< born in
    std::vector<std::uint8_t> order;       ///< 0 trunk, 1 bough, 2 shoot; of conifers
    std::vector<std::uint8_t> flags;
    std::vector<Vec3d> start, direction;  ///< direction unit
    std::vector<double> length;
    std::vector<double> light;            ///< L when it was born; 1 for first branches
    std::vector<Vec3d> light_vector;      ///< m
    std::vector<std::int32_t> bough;      ///< generation its bough began; -1: leader
    std::vector<std::int32_t> dead_tips;  ///< that left their wood to it
    std::vector<std::int32_t> died;       ///< generation; -1: lives

    std::size_t size() const { return key.size(); }
    Vec3d end(std::size_t i) const { return start[i] + direction[i] * length[i]; }
    bool is(std::size_t i, Flag flag) const { return (flags[i] & flag) != 0; }
    bool alive(std::size_t i) const { return !is(i, kDead); }
    friend bool operator==(const Branches&, const Branches&) = default;
};

/// Of one generation.
struct GenerationStatistics {
    int generation = 0;
    std::size_t tips = 0, births = 0, deaths = 0, obstructed = 0, sprouts = 0, shed = 0;
    double mean_light = 0;           ///< of the children, before death
    double lowest = 0, highest = 0;  ///< of the tips' ends
    double rms_radius = 0;           ///< of the tips, horizontally about their tree's origin
    double weeping = 0;  ///< share of tips with a branch pointing down on their way to the root
    double seconds_light = 0, seconds_rest = 0;
};

enum class Status { Growing, Extinct, Limit };

/// The trees of a scene and their growth.
class Grove {
public:
    /// First branches, or buds that wait.
    /// @param plants  shoots: bud j belongs to plant j mod count of the plants of its species
    /// @throws InvalidParameter  params, species; two origins closer than 1e-9; no plant
    /// @throws InvalidInput      all origins (buds) inside obstacles; single ones are dropped with
    /// a
    ///                           warning
    Grove(GroveParams params, std::vector<Species> species, std::vector<Plant> plants,
          std::uint64_t seed, const Surroundings* surroundings = nullptr);

    /// One generation: sprout, children, light, death, bend, collide, shed, break.
    ///
    /// Bit-identical for any number of threads.
    GenerationStatistics step(const Progress& progress = {});
    /// `generations` steps, fewer when the trees die out or max_tips is passed.
    /// @param observer  called after each
    Status grow(int generations, const Progress& progress = {},
                const std::function<void(const GenerationStatistics&)>& observer = {});

    int generation() const { return generation_; }
    Status status() const;
    std::size_t tips() const { return tips_.size(); }
    const std::vector<std::uint32_t>& tip_list() const { return tips_; }
    const Branches& branches() const { return branches_; }
    const std::vector<Plant>& plants() const { return plants_; }
    const std::vector<Species>& species() const { return species_; }
    const GroveParams& params() const { return params_; }
    /// Branches that bear leaves: living tips, and with leaf_retention the youngest behind them.
    std::vector<std::uint32_t> foliage() const;
    /// Their balls, in the same order.
    Balls balls() const;
    const Species& species_of(std::size_t branch) const
    {
        return species_[static_cast<std::size_t>(
            plants_[static_cast<std::size_t>(branches_.tree[branch])].species)];
    }

    // Between generations.
    /// @throws InvalidParameter  no such tree; the grove stays as it was
    void remove_tree(int id);
    /// Cuts every living branch that `cut` names, with all that it bears. Their parents stay as
    /// stubs.
    /// @return branches cut off
    std::size_t prune(const std::function<bool(const Branches&, std::size_t)>& cut);
    void set_species(int index, Species species);
    void set_params(GroveParams params);
    void set_surroundings(const Surroundings* surroundings);
    /// @return its id
    int add_plant(Plant plant);

    /// All that goes on; Grove(state) goes on to the same bits.
    struct State {
        int generation = 0;
        std::uint64_t seed = 0, next_root = 0;
        std::vector<Plant> plants;
        Branches branches;
        std::vector<std::uint32_t> tips;
        struct Bud {
            Vec3d at, direction;
            std::uint64_t key = 0;
            std::int32_t tree = 0, generation = 0;
            friend bool operator==(const Bud&, const Bud&) = default;
        };
        std::vector<Bud> buds;  ///< that wait to germinate
    };
    State state() const;
    Grove(GroveParams params, std::vector<Species> species, State state,
          const Surroundings* surroundings = nullptr);

private:
    struct Candidates;
    using Index = std::uint32_t;

    void check(const std::vector<Plant>& plants) const;
    void place(std::size_t plant);
    bool may_grow(std::size_t tip) const;
    CrownLightParams light_params() const;
    Sight look(Vec3d from, std::size_t patch) const;
    int period_of(const Species& species, bool strong) const;
    void find_boughs();
    void sprout(Candidates& children, const Progress& progress);
    void branch(Candidates& children);
    CrownLight light(const Candidates& children, const Progress& progress) const;
    bool collides(Vec3d start, Vec3d direction, double length, double floor, Vec3d& away) const;
    std::vector<std::int32_t> living_children() const;
    void kill(std::size_t branch, std::vector<std::int32_t>& children);
    std::size_t shed();
    void cut(const std::vector<std::uint8_t>& gone);
    void weather_dead_wood();
    void forget(const std::vector<std::uint8_t>& gone);
    void survey(GenerationStatistics& statistics) const;

    GroveParams params_;
    std::vector<Species> species_;
    std::vector<Plant> plants_;
    const Surroundings* surroundings_ = nullptr;
    SkyPatches sky_;
    std::uint64_t seed_ = 0, next_root_ = 0;
    int generation_ = 0;
    Branches branches_;
    std::vector<Index> tips_;
    std::vector<State::Bud> buds_;
    std::vector<Index> bough_of_;  // root of each branch's bough; itself where there is none
};

/// p turned by share I of its angle to u, in their plane [Kanamaru1992, fig. 4]; opposite ones turn
/// towards `aside`.
/// @param direction, towards  unit; towards 0: no turn
/// @param aside               unit, across `direction`
Vec3d bend(Vec3d direction, Vec3d towards, double share, Vec3d aside);
/// Horizontal unit vector across a branch, in the plane in which it forks: z x p / |z x p|, +x for
/// vertical ones.
Vec3d fork_axis(Vec3d direction);

}  // namespace sekitei::tree
