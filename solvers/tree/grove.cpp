#include "solvers/tree/grove.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>

#include "core/error.h"
#include "core/log.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/tree/wood.h"

namespace sekitei::tree {
namespace {

using math::kPi;

// Draws of a key; keys of children are kChild + their number.
enum Draw : std::uint64_t {
    kDeath = 0,
    kPlace = 1,  // and 2, 3
    kWay = 4,    // and 5
    kGermination = 6,
    kAzimuth = 7,
    kChild = 0x100,
    kSproutOf = 0x10000,
    kBreakOf = 0x20000
};

constexpr double kWhorlAngle = 75 * kPi / 180, kShootAngle = 50 * kPi / 180;
constexpr double kGoldenTurn = 2.399963;
constexpr int kWhorl = 5;
constexpr double kLateralLength = 0.5, kShootLength = 0.35;
constexpr int kCollisionSteps = 4;  // places along a child that are asked for their distance

Vec3d unit_from(double u, double v)
{
    const double z = 2 * u - 1, r = std::sqrt(std::max(0.0, 1 - z * z)), a = 2 * kPi * v;
    return {r * math::cos(a), r * math::sin(a), z};
}

/// At `angle` from p, turned about it by `azimuth` from its fork axis.
Vec3d aslant(Vec3d p, double angle, double azimuth)
{
    const Vec3d h = fork_axis(p), k = cross(p, h);
    return normalized(p * math::cos(angle) +
                      (h * math::cos(azimuth) + k * math::sin(azimuth)) * math::sin(angle));
}

double seconds_since(std::chrono::steady_clock::time_point start)
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

template <class T>
void keep(std::vector<T>& list, const std::vector<std::uint8_t>& gone)
{
    std::size_t left = 0;
    for (std::size_t i = 0; i < list.size(); ++i)
        if (!gone[i]) list[left++] = list[i];
    list.resize(left);
}

/// Calls f on every array of branches.
template <class B, class F>
void each_array(B& b, F&& f)
{
    f(b.parent);
    f(b.tree);
    f(b.key);
    f(b.generation);
    f(b.order);
    f(b.flags);
    f(b.start);
    f(b.direction);
    f(b.length);
    f(b.light);
    f(b.light_vector);
    f(b.bough);
    f(b.dead_tips);
    f(b.died);
}

}  // namespace

Vec3d fork_axis(Vec3d p)
{
    const Vec3d h(-p.y, p.x, 0);  // z x p
    const double size = length(h);
    return size < 1e-9 ? Vec3d(1, 0, 0) : h / size;
}

Vec3d bend(Vec3d p, Vec3d u, double share, Vec3d aside)
{
    if (share == 0 || dot(u, u) == 0) return p;
    const double cosine = dot(p, u);
    Vec3d across = u - p * cosine;
    const double sine = length(across);
    if (sine < 1e-12) {
        if (cosine > 0) return p;
        across = aside;
    } else
        across = across / sine;
    const double angle = share * math::atan2(sine, cosine);
    return normalized(p * math::cos(angle) + across * math::sin(angle));
}

void validate(const GroveParams& params)
{
    validate_described("tree", params);
    if (params.patch_rows % 2 != 0)
        throw InvalidParameter(
            fmt::format("tree: patch_rows = {}, must be even: the horizon lies "
                        "between two rows",
                        params.patch_rows));
    if (!(params.light_ratio_upper + params.light_ratio_lower > 0))
        throw InvalidParameter(
            "tree: light_ratio_upper = light_ratio_lower = 0, one must be > 0: no light");
    if (params.transmission == 0 && params.method == Method::Grid)
        throw InvalidParameter(
            "tree: transmission = 0 with method = grid: opaque leaves have no "
            "extinction; use sweep");
}

/// Children of a generation, before their fate is known.
struct Grove::Candidates {
    std::vector<std::int32_t> parent, tree;
    std::vector<std::uint64_t> key;
    std::vector<std::uint8_t> order, flags;
    std::vector<Vec3d> start, direction;
    std::vector<double> length;
    std::vector<std::int32_t> bough;

    std::size_t size() const { return key.size(); }
    void add(std::int32_t parent_, std::int32_t tree_, std::uint64_t key_, int order_, int flags_,
             Vec3d start_, Vec3d direction_, double length_, std::int32_t bough_)
    {
        parent.push_back(parent_);
        tree.push_back(tree_);
        key.push_back(key_);
        order.push_back(static_cast<std::uint8_t>(order_));
        flags.push_back(static_cast<std::uint8_t>(flags_));
        start.push_back(start_);
        direction.push_back(direction_);
        length.push_back(length_);
        bough.push_back(bough_);
    }
    Vec3d end(std::size_t i) const { return start[i] + direction[i] * length[i]; }
};

Grove::Grove(GroveParams params, std::vector<Species> species, std::vector<Plant> plants,
             std::uint64_t seed, const Surroundings* surroundings)
    : species_(std::move(species)), surroundings_(surroundings), seed_(seed)
{
    set_params(std::move(params));
    for (const Species& s : species_) validate(s);
    check(plants);
    // A shoot's buds take turns among the plants of its species.
    std::vector<std::vector<std::size_t>> of_species(species_.size());
    plants_ = std::move(plants);
    std::size_t rejected = 0, places = 0;
    auto inside = [&](Vec3d at) {
        double distance = 0;
        return surroundings_ && surroundings_->nearest(at * params_.unit_length, distance) &&
               distance <= 0;
    };
    for (std::size_t i = 0; i < plants_.size(); ++i)
        of_species[std::size_t(plants_[i].species)].push_back(i);
    for (std::size_t i = 0; i < plants_.size(); ++i) {
        const Species& kind = species_[std::size_t(plants_[i].species)];
        if (kind.model == Model::Shoot) continue;
        ++places;
        if (inside(plants_[i].origin)) {
            ++rejected;
            plants_[i].from = -1;  // never
        } else if (plants_[i].from == 0)
            place(i);
    }
    for (std::size_t s = 0; s < species_.size(); ++s) {
        const Species& kind = species_[s];
        if (kind.model != Model::Shoot || of_species[s].empty()) continue;
        for (int j = 0; j < kind.buds; ++j) {
            const std::size_t plant = of_species[s][std::size_t(j) % of_species[s].size()];
            const std::uint64_t key = hash2(seed_, next_root_++);
            auto u = [&](std::uint64_t k) { return uniform_of_key(key, k); };
            const Vec3d origin = plants_[plant].origin;
            State::Bud bud{{}, unit_from(u(kWay), u(kWay + 1)), key, std::int32_t(plant), 0};
            if (kind.bud_places == BudPlaces::Sphere) {
                // Cube root as a power: the same bits everywhere.
                bud.at = origin + unit_from(u(kPlace), u(kPlace + 1)) *
                                      (kind.bud_radius * math::pow(u(kPlace + 2), 1.0 / 3));
            } else {
                const double azimuth = 2 * kPi * u(kPlace);
                const Vec3d out(math::cos(azimuth), math::sin(azimuth), 0);
                bud.at =
                    origin + out * kind.bud_radius + Vec3d(0, 0, kind.bud_height * u(kPlace + 1));
                const double outward = dot(bud.direction, out);
                if (outward < 0) bud.direction -= out * (2 * outward);
            }
            bud.generation = plants_[plant].from + 1 +
                             static_cast<int>(static_cast<double>(kind.stagger) * u(kGermination));
            ++places;
            if (inside(bud.at))
                ++rejected;
            else
                buds_.push_back(bud);
        }
    }
    if (rejected == places)
        throw InvalidInput(fmt::format(
            "tree: all {} origins and buds lie inside obstacles; move them out (origin)", places));
    if (rejected > 0)
        log::warning("tree: {} of {} origins and buds lie inside obstacles and do not grow",
                     rejected, places);
}

Grove::Grove(GroveParams params, std::vector<Species> species, State state,
             const Surroundings* surroundings)
    : species_(std::move(species)),
      plants_(std::move(state.plants)),
      surroundings_(surroundings),
      seed_(state.seed),
      next_root_(state.next_root),
      generation_(state.generation),
      branches_(std::move(state.branches)),
      tips_(std::move(state.tips)),
      buds_(std::move(state.buds))
{
    set_params(std::move(params));
    for (const Species& s : species_) validate(s);
    check(plants_);
    const std::size_t n = branches_.size();
    each_array(branches_, [&](const auto& list) {
        if (list.size() != n) throw InvalidInput("tree: the branches' arrays differ in length");
    });
    for (std::size_t i = 0; i < n; ++i)
        if (branches_.parent[i] >= static_cast<std::int32_t>(i) || branches_.tree[i] < 0 ||
            static_cast<std::size_t>(branches_.tree[i]) >= plants_.size())
            throw InvalidInput(
                fmt::format("tree: branch {} has the parent {} and the tree {}; parents come "
                            "before their children, and there are {} trees",
                            i, branches_.parent[i], branches_.tree[i], plants_.size()));
    for (const Index tip : tips_)
        if (tip >= n) throw InvalidInput(fmt::format("tree: tip {} of {} branches", tip, n));
    for (const State::Bud& bud : buds_)
        if (bud.tree < 0 || static_cast<std::size_t>(bud.tree) >= plants_.size())
            throw InvalidInput(
                fmt::format("tree: a bud of tree {}, there are {}", bud.tree, plants_.size()));
}

Grove::State Grove::state() const
{
    return {generation_, seed_, next_root_, plants_, branches_, tips_, buds_};
}

void Grove::check(const std::vector<Plant>& plants) const
{
    if (plants.empty()) throw InvalidParameter("tree: no origin: where should a tree stand?");
    for (std::size_t i = 0; i < plants.size(); ++i) {
        const Plant& p = plants[i];
        if (!(std::isfinite(p.origin.x) && std::isfinite(p.origin.y) && std::isfinite(p.origin.z)))
            throw InvalidParameter(fmt::format("tree: origin {} is not finite", i));
        if (p.species < 0 || static_cast<std::size_t>(p.species) >= species_.size())
            throw InvalidParameter(fmt::format("tree: tree {} is of species {}, there are {}", i,
                                               p.species, species_.size()));
    }
    std::vector<std::size_t> order(plants.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::ranges::sort(order, {}, [&](std::size_t i) { return plants[i].origin; });
    for (std::size_t k = 1; k < order.size(); ++k)
        if (length(plants[order[k]].origin - plants[order[k - 1]].origin) < 1e-9)
            throw InvalidParameter(fmt::format("tree: origins {} and {} are the same place",
                                               std::min(order[k - 1], order[k]),
                                               std::max(order[k - 1], order[k])));
}

void Grove::set_params(GroveParams params)
{
    validate(params);
    params_ = std::move(params);
    sky_ = sky_patches(params_.patch_rows, params_.patch_columns, params_.light_ratio_upper,
                       params_.light_ratio_lower);
    if (params_.transmission == 1)
        log::warning("tree: transmission = 1: leaves shade nothing, and no tree sees another");
}

void Grove::set_species(int index, Species species)
{
    if (index < 0 || static_cast<std::size_t>(index) >= species_.size())
        throw InvalidParameter(
            fmt::format("tree: species {}, there are {}", index, species_.size()));
    validate(species);
    species_[static_cast<std::size_t>(index)] = std::move(species);
}

void Grove::set_surroundings(const Surroundings* surroundings)
{
    surroundings_ = surroundings;
}

int Grove::add_plant(Plant plant)
{
    std::vector<Plant> more = plants_;
    plant.from = std::max(plant.from, generation_);
    more.push_back(plant);
    check(more);
    if (species_[std::size_t(plant.species)].model == Model::Shoot)
        throw InvalidParameter("tree: buds of shoots cannot be added to a grove that grows");
    plants_ = std::move(more);
    if (plant.from == generation_) place(plants_.size() - 1);
    return static_cast<int>(plants_.size()) - 1;
}

/// The first branch of a tree.
void Grove::place(std::size_t plant)
{
    const Species& kind = species_[std::size_t(plants_[plant].species)];
    tips_.push_back(static_cast<Index>(branches_.size()));
    Branches& b = branches_;
    b.parent.push_back(-1);
    b.tree.push_back(static_cast<std::int32_t>(plant));
    b.key.push_back(hash2(seed_, next_root_++));
    b.generation.push_back(plants_[plant].from);
    b.order.push_back(0);
    b.flags.push_back(Branches::kTip | Branches::kLeader);
    b.start.push_back(plants_[plant].origin);
    b.direction.emplace_back(0, 0, 1);
    b.length.push_back(kind.first_length);
    b.light.push_back(1);
    b.light_vector.emplace_back();
    b.bough.push_back(-1);
    b.dead_tips.push_back(0);
    b.died.push_back(-1);
}

int Grove::period_of(const Species& kind, bool strong) const
{
    return kind.active_period * (strong ? 2 : 1);
}

/// Finds the root of each branch's bough. Boughs that come to the end of their period are strong
/// where they are among the thickest of their tree.
void Grove::find_boughs()
{
    const Branches& b = branches_;
    bool any = false;
    for (const Species& s : species_) any |= s.active_period > 0;
    bough_of_.clear();
    if (!any) return;
    bough_of_.resize(b.size());
    std::vector<std::vector<Index>> roots(plants_.size());
    std::vector<std::uint8_t> due(plants_.size());
    for (std::size_t i = 0; i < b.size(); ++i) {
        const std::int32_t parent = b.parent[i];
        const bool root =
            b.bough[i] >= 0 && (parent < 0 || b.bough[std::size_t(parent)] != b.bough[i]);
        bough_of_[i] =
            root || b.bough[i] < 0 ? static_cast<Index>(i) : bough_of_[std::size_t(parent)];
        if (!root || !b.alive(i)) continue;
        const auto tree = std::size_t(b.tree[i]);
        roots[tree].push_back(static_cast<Index>(i));
        const Species& kind = species_of(i);
        due[tree] |= kind.active_period > 0 && kind.strong_boughs > 0 &&
                     generation_ - b.bough[i] == kind.active_period;
    }
    std::vector<double> wood;
    for (std::size_t tree = 0; tree < plants_.size(); ++tree) {
        if (!due[tree]) continue;
        if (wood.empty()) wood = thickness(b, species_, plants_);
        std::vector<Index> thickest = roots[tree];
        std::ranges::stable_sort(thickest, [&](Index x, Index y) { return wood[x] > wood[y]; });
        const Species& kind = species_[std::size_t(plants_[tree].species)];
        thickest.resize(std::min(thickest.size(), std::size_t(kind.strong_boughs)));
        for (const Index root : thickest)
            if (generation_ - b.bough[root] == kind.active_period)
                branches_.flags[root] |= Branches::kStrong;
    }
}

/// Buds that germinate now, and dormant ones that find light.
void Grove::sprout(Candidates& children, const Progress& progress)
{
    for (const State::Bud& bud : buds_)
        if (bud.generation == generation_)
            children.add(-1, bud.tree, bud.key, 0, 0, bud.at, bud.direction, 1, -1);
    std::erase_if(buds_, [&](const State::Bud& bud) { return bud.generation <= generation_; });

    // A branch that grows keeps the buds below it asleep; only where it was cut do they wake. Who
    // would sprout is drawn first: light is dearer than chance.
    const Branches& b = branches_;
    std::vector<std::uint8_t> released(b.size());
    for (std::size_t i = b.size(); i-- > 0;) {
        released[i] |= b.is(i, Branches::kCut);
        if (b.parent[i] >= 0) released[std::size_t(b.parent[i])] |= released[i];
    }
    std::vector<Index> waking;
    for (std::size_t i = 0; i < b.size(); ++i) {
        const Species& kind = species_of(i);
        if (kind.latent_share == 0 || !released[i] || !b.alive(i) || b.is(i, Branches::kTip) ||
            b.is(i, Branches::kSpent) || generation_ - b.generation[i] > kind.latent_age)
            continue;
        if (uniform_of_key(b.key[i], kSproutOf) >= kind.latent_share) continue;
        if (uniform_of_key(b.key[i], kSproutOf + std::uint64_t(generation_)) < kind.latent_chance)
            waking.push_back(static_cast<Index>(i));
    }
    if (waking.empty()) return;
    Lookers lookers;
    for (const Index i : waking) {
        lookers.at.push_back(b.end(i));
        lookers.own.push_back(Lookers::kNoBall);
    }
    const SightOf sight =
        !surroundings_ || surroundings_->empty() ? SightOf() : [&](std::size_t i, std::size_t p) {
            return look(lookers.at[i], p);
        };
    const CrownLight found = crown_light(sky_, balls(), lookers, light_params(), sight, progress);
    for (std::size_t k = 0; k < waking.size(); ++k) {
        const Index i = waking[k];
        if (found.light[k] < species_of(i).latent_light) continue;
        branches_.flags[i] |= Branches::kSpent;
        const std::uint64_t key = hash2(b.key[i], kSproutOf + std::uint64_t(generation_));
        Vec3d way = unit_from(uniform_of_key(key, kWay), uniform_of_key(key, kWay + 1));
        if (dot(way, b.direction[i]) < 0) way = -way;
        const bool conifer = species_of(i).model == Model::Conifer;
        const int order = conifer ? std::min(2, b.order[i] + 1) : b.order[i];
        children.add(static_cast<std::int32_t>(i), b.tree[i], key, order, Branches::kSprout,
                     b.end(i), way, conifer ? kShootLength : 1,
                     b.bough[i] >= 0 || !conifer ? b.bough[i] : generation_);
    }
}

/// What every living tip bears.
void Grove::branch(Candidates& children)
{
    const Branches& b = branches_;
    for (const Index tip : tips_) {
        const Species& kind = species_of(tip);
        if (!may_grow(tip)) continue;
        const Vec3d p = b.direction[tip], at = b.end(tip);
        const auto parent = static_cast<std::int32_t>(tip);
        auto add = [&](int child, int order, int flags, Vec3d way, double size, int bough) {
            children.add(parent, b.tree[tip], hash2(b.key[tip], kChild + std::uint64_t(child)),
                         order, flags, at, way, size, bough);
        };
        const int leader = b.flags[tip] & Branches::kLeader;
        switch (kind.model) {
            case Model::Dichotomy: {
                const double angle = kind.branch_angle * kPi / 180;
                Vec3d h = fork_axis(p);
                if (kind.vertical_azimuth == Azimuth::Random && std::hypot(p.x, p.y) < 1e-9) {
                    const double azimuth = 2 * kPi * uniform_of_key(b.key[tip], kAzimuth);
                    h = {math::cos(azimuth), math::sin(azimuth), 0};
                }
                const int age = generation_ - plants_[std::size_t(b.tree[tip])].from;
                const bool begins = b.bough[tip] < 0 && age >= kind.bough_generation;
                const int bough = begins ? generation_ : b.bough[tip];
                const int flags = begins ? 0 : leader;
                add(0, b.order[tip], flags, p * math::cos(angle) + h * math::sin(angle), 1, bough);
                add(1, b.order[tip], flags, p * math::cos(angle) - h * math::sin(angle), 1, bough);
                break;
            }
            case Model::Shoot:
                add(0, 0, 0, p, 1, -1);
                break;
            case Model::Conifer:
                if (b.order[tip] == 0) {
                    add(0, 0, leader, p, 1, -1);
                    for (int k = 1; k <= kWhorl; ++k)
                        add(k, 1, 0,
                            aslant(p, kWhorlAngle,
                                   2 * kPi * k / kWhorl + kGoldenTurn * generation_),
                            kLateralLength, generation_);
                } else {
                    add(0, b.order[tip], 0, p, b.length[tip], b.bough[tip]);
                    if (b.order[tip] == 1 && (generation_ - b.bough[tip]) % 2 == 0) {
                        const Vec3d h = fork_axis(p);
                        for (int k = 1; k <= 2; ++k)
                            add(k, 2, 0,
                                normalized(p * math::cos(kShootAngle) +
                                           h * (math::sin(kShootAngle) * (k == 1 ? 1 : -1))),
                                kShootLength, b.bough[tip]);
                    }
                }
                break;
        }
    }
}

bool Grove::may_grow(std::size_t tip) const
{
    const Species& kind = species_of(tip);
    if (kind.active_period == 0 || branches_.bough[tip] < 0) return true;
    const bool strong = branches_.is(bough_of_[tip], Branches::kStrong);
    return generation_ - branches_.bough[tip] <= period_of(kind, strong);
}

CrownLightParams Grove::light_params() const
{
    return {params_.transmission, params_.occlusion, params_.method, params_.light_direction,
            params_.obstacle_albedo * params_.light_ratio_lower};
}

Sight Grove::look(Vec3d from, std::size_t patch) const
{
    const Vec3d at = from * params_.unit_length, way = sky_.direction[patch];
    Sight sight;
    sight.blocked = surroundings_->blocks(at, way);
    if (surroundings_->shade) sight.transmittance = surroundings_->shade->transmittance(at, way);
    return sight;
}

CrownLight Grove::light(const Candidates& children, const Progress& progress) const
{
    Balls shading;
    Lookers lookers;
    for (std::size_t i = 0; i < children.size(); ++i) {
        shading.centre.push_back(children.end(i));
        shading.radius.push_back(
            species_[std::size_t(plants_[std::size_t(children.tree[i])].species)].ball_radius);
        lookers.own.push_back(static_cast<std::uint32_t>(i));
    }
    lookers.at = shading.centre;
    // Leaves that are older: of tips that bear nothing more, and those of evergreens.
    for (const Index i : foliage()) {
        const bool gone =
            branches_.is(i, Branches::kTip)
                ? may_grow(i) && species_of(i).leaf_retention == 1
                : generation_ - branches_.generation[i] >= species_of(i).leaf_retention;
        if (gone) continue;
        shading.centre.push_back(branches_.end(i));
        shading.radius.push_back(species_of(i).ball_radius);
    }
    const SightOf sight =
        !surroundings_ || surroundings_->empty() ? SightOf() : [&](std::size_t i, std::size_t p) {
            return look(lookers.at[i], p);
        };
    return crown_light(sky_, shading, lookers, light_params(), sight, progress);
}

std::vector<std::uint32_t> Grove::foliage() const
{
    const Branches& b = branches_;
    bool evergreen = false;
    for (const Species& s : species_) evergreen |= s.leaf_retention > 1;
    if (!evergreen) return tips_;
    std::vector<Index> list;
    for (std::size_t i = 0; i < b.size(); ++i) {
        if (!b.alive(i)) continue;
        const bool first = b.parent[i] < 0 && species_of(i).model != Model::Shoot;
        if (b.is(i, Branches::kTip) ||
            (!first && generation_ - b.generation[i] < species_of(i).leaf_retention))
            list.push_back(static_cast<Index>(i));
    }
    return list;
}

Balls Grove::balls() const
{
    Balls balls;
    for (const Index i : foliage()) {
        balls.centre.push_back(branches_.end(i));
        balls.radius.push_back(species_of(i).ball_radius);
    }
    return balls;
}

/// Whether a child comes too near something; `away` leads from there.
bool Grove::collides(Vec3d start, Vec3d way, double size, double floor, Vec3d& away) const
{
    const double metre = params_.unit_length;
    auto clear_of = [&](Vec3d at, Vec3d* normal) {
        double distance = std::numeric_limits<double>::infinity();
        const Obstacle* nearest =
            surroundings_ ? surroundings_->nearest(at * metre, distance) : nullptr;
        distance /= metre;
        const bool ground = params_.ground && at.z - floor < distance;
        if (normal)
            *normal = ground ? Vec3d(0, 0, 1) : nearest ? nearest->away(at * metre) : Vec3d();
        return ground ? at.z - floor : distance;
    };
    // One that begins within the clearance may leave it, or go along.
    const double least = std::min(params_.clearance, clear_of(start, nullptr));
    double worst = std::numeric_limits<double>::infinity();
    Vec3d where;
    for (int k = 1; k <= kCollisionSteps; ++k) {
        const Vec3d at = start + way * (size * k / kCollisionSteps);
        if (const double d = clear_of(at, nullptr); d < worst) worst = d, where = at;
    }
    if (!(worst < least - 1e-9)) return false;
    clear_of(where, &away);
    return true;
}

std::vector<std::int32_t> Grove::living_children() const
{
    std::vector<std::int32_t> count(branches_.size());
    for (std::size_t i = 0; i < branches_.size(); ++i)
        if (branches_.parent[i] >= 0 && branches_.alive(i))
            ++count[std::size_t(branches_.parent[i])];
    return count;
}

/// Ends a branch that bears nothing more, and what of its way to the root then bears nothing.
void Grove::kill(std::size_t i, std::vector<std::int32_t>& children)
{
    Branches& b = branches_;
    for (;;) {
        b.flags[i] = static_cast<std::uint8_t>((b.flags[i] | Branches::kDead) & ~Branches::kTip);
        b.died[i] = generation_;
        const std::int32_t parent = b.parent[i];
        if (parent < 0) return;
        const auto p = std::size_t(parent);
        b.dead_tips[p] += b.dead_tips[i];
        b.dead_tips[i] = 0;
        if (--children[p] > 0 || b.is(p, Branches::kCut) || b.is(p, Branches::kTip)) return;
        i = p;
    }
}

/// Boughs whose time is over fall, with all they bear.
/// @return how many
std::size_t Grove::shed()
{
    Branches& b = branches_;
    bool any = false;
    for (const Species& s : species_) any |= s.active_period > 0;
    if (!any) return 0;
    find_boughs();
    std::size_t fallen = 0;
    std::vector<std::uint8_t> gone(b.size());
    for (std::size_t i = 0; i < b.size(); ++i) {
        const Species& kind = species_of(i);
        if (kind.active_period == 0 || b.bough[i] < 0) continue;
        const Index root = bough_of_[i];
        if (root == i) {
            const int age = generation_ - b.bough[i];
            gone[i] = age >= period_of(kind, b.is(i, Branches::kStrong)) + kind.shed_delay;
            fallen += gone[i];
        } else
            gone[i] = gone[root];
    }
    if (fallen == 0) return 0;
    cut(gone);
    return fallen;
}

/// Takes branches away, each with all that it bears. Their wood stays with those that bore them.
void Grove::cut(const std::vector<std::uint8_t>& gone)
{
    Branches& b = branches_;
    std::vector<std::int32_t> children = living_children();
    for (std::size_t i = b.size(); i-- > 0;) {
        if (!gone[i] || !b.alive(i)) continue;
        if (b.is(i, Branches::kTip)) ++b.dead_tips[i];
        b.flags[i] = static_cast<std::uint8_t>((b.flags[i] | Branches::kDead) & ~Branches::kTip);
        b.died[i] = generation_;
        if (b.parent[i] < 0) continue;
        const auto p = std::size_t(b.parent[i]);
        b.dead_tips[p] += b.dead_tips[i];
        b.dead_tips[i] = 0;
        --children[p];
    }
    forget(gone);
}

/// Dead wood breaks, thin pieces first; what does not persist goes at once.
void Grove::weather_dead_wood()
{
    const Branches& b = branches_;
    std::vector<std::uint8_t> gone(b.size());
    bool any = false, hanging = false;
    for (std::size_t i = 0; i < b.size(); ++i)
        if (!b.alive(i)) (species_of(i).dead_persist > 0 ? hanging : any) = true;
    if (!any && !hanging) return;
    const std::vector<double> radius =
        hanging ? thickness(b, species_, plants_) : std::vector<double>();
    for (std::size_t i = 0; i < b.size(); ++i) {
        if (b.alive(i)) continue;
        const Species& kind = species_of(i);
        if (b.parent[i] >= 0 && gone[std::size_t(b.parent[i])])
            gone[i] = 1;
        else if (kind.dead_persist == 0)
            gone[i] = 1;
        else if (b.died[i] < generation_) {
            const double thick = radius[i] / kind.tip_radius;
            gone[i] = uniform_of_key(b.key[i], kBreakOf + std::uint64_t(generation_)) <
                      1 - math::exp(-1 / (kind.dead_persist * thick));
        }
    }
    forget(gone);
}

/// Takes branches out of all lists; what is left keeps its order.
void Grove::forget(const std::vector<std::uint8_t>& gone)
{
    std::vector<std::int32_t> now(branches_.size(), -1);
    std::int32_t left = 0;
    for (std::size_t i = 0; i < gone.size(); ++i)
        if (!gone[i]) now[i] = left++;
    if (static_cast<std::size_t>(left) == branches_.size()) return;
    for (std::int32_t& parent : branches_.parent)
        if (parent >= 0) parent = now[std::size_t(parent)];
    each_array(branches_, [&](auto& list) { keep(list, gone); });
    std::size_t tips = 0;
    for (const Index tip : tips_)
        if (now[tip] >= 0 && branches_.is(std::size_t(now[tip]), Branches::kTip))
            tips_[tips++] = static_cast<Index>(now[tip]);
    tips_.resize(tips);
    bough_of_.clear();
}

GenerationStatistics Grove::step(const Progress& progress)
{
    using Clock = std::chrono::steady_clock;
    const auto began = Clock::now();
    ++generation_;
    GenerationStatistics statistics;
    statistics.generation = generation_;
    for (std::size_t i = 0; i < plants_.size(); ++i)
        if (plants_[i].from > 0 && plants_[i].from == generation_ - 1 &&
            species_[std::size_t(plants_[i].species)].model != Model::Shoot)
            place(i);

    Candidates children;
    find_boughs();
    sprout(children, progress);
    for (const std::uint8_t flags : children.flags)
        statistics.sprouts += (flags & Branches::kSprout) != 0;
    branch(children);
    statistics.births = children.size();
    const auto lighting = Clock::now();
    const CrownLight found = light(children, progress);
    statistics.seconds_light = seconds_since(lighting);
    for (const double l : found.light) statistics.mean_light += l / double(children.size());

    // Who dies.
    const std::size_t n = children.size();
    std::vector<std::uint8_t> dies(n);
    if (!params_.keep_tips.empty()) {
        const auto at = std::min(std::size_t(generation_), params_.keep_tips.size()) - 1;
        std::vector<std::size_t> order(n);
        std::iota(order.begin(), order.end(), std::size_t{0});
        std::ranges::stable_sort(
            order, {}, [&](std::size_t i) { return uniform_of_key(children.key[i], kDeath); });
        for (std::size_t k = static_cast<std::size_t>(params_.keep_tips[at]); k < n; ++k)
            dies[order[k]] = 1;
    } else
        for (std::size_t i = 0; i < n; ++i) {
            const Species& kind =
                species_[std::size_t(plants_[std::size_t(children.tree[i])].species)];
            const double threshold =
                kind.death_threshold +
                kind.death_dither * (2 * uniform_of_key(children.key[i], kDeath) - 1);
            const bool leads = kind.model == Model::Conifer && children.order[i] == 0;
            dies[i] = found.light[i] < threshold && !leads;
        }

    // Who lives bends, and makes way for what is solid.
    const bool solid = params_.ground || (surroundings_ && !surroundings_->obstacles.empty());
    std::vector<std::uint8_t> obstructed(n);
    parallel_for(
        n,
        [&](std::size_t i) {
            if (dies[i]) return;
            const Plant& plant = plants_[std::size_t(children.tree[i])];
            const Species& kind = species_[std::size_t(plant.species)];
            const bool leads = kind.model == Model::Conifer && children.order[i] == 0;
            Vec3d& way = children.direction[i];
            way = bend(way, found.towards[i], leads ? kind.leader_tropism : kind.tropism,
                       fork_axis(way));
            Vec3d away;
            if (!solid ||
                !collides(children.start[i], way, children.length[i], plant.origin.z, away))
                return;
            const Vec3d along = way - away * dot(way, away);
            const double size = length(along);
            if (size > 1e-9) way = along / size;
            if (size <= 1e-9 ||
                collides(children.start[i], way, children.length[i], plant.origin.z, away))
                dies[i] = obstructed[i] = 1;
        },
        64);

    // Survivors become branches and tips; tips that bore nothing that lives die.
    Branches& b = branches_;
    std::vector<std::int32_t> living = living_children();
    std::vector<Index> before, after;
    before.swap(tips_);
    std::vector<std::uint8_t> bore(b.size());
    for (std::size_t i = 0; i < n; ++i) {
        const std::int32_t parent = children.parent[i];
        if (parent >= 0) bore[std::size_t(parent)] = 1;
        if (dies[i]) {
            ++statistics.deaths;
            statistics.obstructed += obstructed[i];
            if (parent >= 0) ++b.dead_tips[std::size_t(parent)];
            continue;
        }
        if (parent >= 0) ++living[std::size_t(parent)];
        after.push_back(static_cast<Index>(b.size()));
        b.parent.push_back(parent);
        b.tree.push_back(children.tree[i]);
        b.key.push_back(children.key[i]);
        b.generation.push_back(generation_);
        b.order.push_back(children.order[i]);
        b.flags.push_back(static_cast<std::uint8_t>(children.flags[i] | Branches::kTip));
        b.start.push_back(children.start[i]);
        b.direction.push_back(children.direction[i]);
        b.length.push_back(children.length[i]);
        b.light.push_back(found.light[i]);
        b.light_vector.push_back(found.mean[i]);
        b.bough.push_back(children.bough[i]);
        b.dead_tips.push_back(0);
        b.died.push_back(-1);
        living.push_back(0);
    }
    for (const Index tip : before) {
        if (!bore[tip]) {  // at rest
            tips_.push_back(tip);
            continue;
        }
        b.flags[tip] = static_cast<std::uint8_t>(b.flags[tip] & ~Branches::kTip);
    }
    for (const Index tip : before)
        if (bore[tip] && living[tip] == 0) kill(tip, living);
    tips_.insert(tips_.end(), after.begin(), after.end());
    statistics.shed = shed();
    weather_dead_wood();
    survey(statistics);
    statistics.seconds_rest = seconds_since(began) - statistics.seconds_light;
    return statistics;
}

void Grove::survey(GenerationStatistics& statistics) const
{
    const Branches& b = branches_;
    statistics.tips = tips_.size();
    if (tips_.empty()) return;
    std::vector<std::uint8_t> weeps(b.size());
    for (std::size_t i = 0; i < b.size(); ++i)
        weeps[i] = b.direction[i].z < 0 || (b.parent[i] >= 0 && weeps[std::size_t(b.parent[i])]);
    statistics.lowest = std::numeric_limits<double>::infinity();
    statistics.highest = -statistics.lowest;
    double squares = 0;
    std::size_t weeping = 0;
    for (const Index tip : tips_) {
        const Vec3d end = b.end(tip), off = end - plants_[std::size_t(b.tree[tip])].origin;
        statistics.lowest = std::min(statistics.lowest, end.z);
        statistics.highest = std::max(statistics.highest, end.z);
        squares += off.x * off.x + off.y * off.y;
        weeping += weeps[tip];
    }
    const auto n = static_cast<double>(tips_.size());
    statistics.rms_radius = std::sqrt(squares / n);
    statistics.weeping = static_cast<double>(weeping) / n;
}

Status Grove::status() const
{
    if (tips_.size() > static_cast<std::size_t>(params_.max_tips)) return Status::Limit;
    if (!tips_.empty() || !buds_.empty()) return Status::Growing;
    for (const Plant& plant : plants_)
        if (plant.from >= generation_ && plant.from > 0) return Status::Growing;
    // A cut tree lives on in its buds.
    for (std::size_t i = 0; i < branches_.size(); ++i)
        if (branches_.alive(i) && species_of(i).latent_share > 0) return Status::Growing;
    return Status::Extinct;
}

Status Grove::grow(int generations, const Progress& progress,
                   const std::function<void(const GenerationStatistics&)>& observer)
{
    for (int g = 0; g < generations && status() == Status::Growing; ++g) {
        progress.check();
        const GenerationStatistics statistics = step(progress.slice(1, 1));
        if (observer) observer(statistics);
        progress.update(double(g + 1) / double(generations));
    }
    return status();
}

void Grove::remove_tree(int id)
{
    const Branches& b = branches_;
    if (id < 0 || static_cast<std::size_t>(id) >= plants_.size())
        throw InvalidParameter(
            fmt::format("tree: remove: no tree {}; there are 0 to {}", id, plants_.size() - 1));
    if (plants_[std::size_t(id)].from < 0)
        throw InvalidParameter(fmt::format("tree: remove: tree {} is gone already", id));
    std::vector<std::uint8_t> gone(b.size());
    for (std::size_t i = 0; i < b.size(); ++i) gone[i] = b.tree[i] == id;
    forget(gone);
    std::erase_if(buds_, [&](const State::Bud& bud) { return bud.tree == id; });
    plants_[std::size_t(id)].from = -1;
}

std::size_t Grove::prune(const std::function<bool(const Branches&, std::size_t)>& unwanted)
{
    Branches& b = branches_;
    std::vector<std::uint8_t> gone(b.size());
    std::size_t count = 0;
    for (std::size_t i = 0; i < b.size(); ++i) {
        const std::int32_t parent = b.parent[i];
        gone[i] = (parent >= 0 && gone[std::size_t(parent)]) || (b.alive(i) && unwanted(b, i));
        count += gone[i];
        if (gone[i] && parent >= 0 && !gone[std::size_t(parent)])
            b.flags[std::size_t(parent)] |= Branches::kCut;
    }
    cut(gone);
    return count;
}

}  // namespace sekitei::tree
