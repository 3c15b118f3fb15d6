#include "solvers/light/light.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <memory>

#include "core/clones.h"
#include "core/error.h"
#include "core/log.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/rays/embree.h"

namespace sekitei::light {
namespace {

using math::kPi;

constexpr double kDegree = kPi / 180;
constexpr double kObliquity = 23.45 * kDegree;
constexpr float kFar = INFINITY;

// What a link says. Bit kDown: the ray went below the horizontal.
constexpr std::int32_t kDown = 1 << 30, kNumber = kDown - 1;
// kForeign - 27 down - direction
constexpr std::int32_t kSky = -1, kGround = -2, kForeign = -3, kBuried = -100;
// Leaves, or what they shade: as good as dark. Below the horizontal one less.
constexpr std::int32_t kLeaves = -101;

struct Link {
    bool down;
    std::int32_t site;  ///< or kSky, kGround, kForeign, kBuried, kLeaves
    int facing;         ///< of kForeign: 0..26, neighbour_index() of the rounded normal
};

std::int32_t pack(Link link)
{
    if (link.site >= 0) return link.site | (link.down ? kDown : 0);
    if (link.site == kLeaves) return kLeaves - link.down;
    return link.site == kForeign ? kForeign - link.facing - (link.down ? 27 : 0) : link.site;
}
Link unpack(std::int32_t code)
{
    if (code >= 0) return {(code & kDown) != 0, code & kNumber, 0};
    if (code == kSky) return {false, kSky, 0};
    if (code == kGround) return {true, kGround, 0};
    if (code == kBuried) return {false, kBuried, 0};
    if (code == kLeaves || code == kLeaves - 1) return {code != kLeaves, kLeaves, 0};
    const int rest = kForeign - code;
    return {rest >= 27, kForeign, rest % 27};
}

/// One of 26 directions along faces, edges and corners of a cube, as a neighbour index.
int facing_of(Vec3d n)
{
    auto part = [](double x) { return x > 0.38 ? 2 : x < -0.38 ? 0 : 1; };
    return part(n.x) * 9 + part(n.y) * 3 + part(n.z);
}
Vec3d normal_facing(int facing)
{
    return normalized(Vec3d(facing / 9 - 1, facing / 3 % 3 - 1, facing % 3 - 1));
}

Vec3d horizontal(double azimuth)
{
    return {math::sin(azimuth), math::cos(azimuth), 0};
}

/// Two unit vectors across `n`.
std::pair<Vec3d, Vec3d> across(Vec3d n)
{
    const Vec3d a = normalized(cross(std::abs(n.z) < 0.9 ? Vec3d(0, 0, 1) : Vec3d(1, 0, 0), n));
    return {a, cross(n, a)};
}

/// Patches in bands of equal height, each cut in split x split parts.
void add_sky(Directions& d, const Params& params)
{
    constexpr std::array<int, 7> kPatches{30, 30, 24, 24, 18, 12, 6};
    const int halves = params.sky == Sky::Reinhart ? 2 : 1, split = params.sky_split;
    for (int band = 0; band < 7 * halves; ++band) {
        const int count = kPatches[static_cast<std::size_t>(band / halves)] * halves;
        const double height = 12.0 / halves * kDegree / split, width = 2 * kPi / (count * split);
        for (int k = 0; k < count; ++k, ++d.patches)
            for (int part = 0; part < split * split; ++part) {
                const double low = (band * split + part / split) * height, high = low + height;
                const double sl = math::sin(low), sh = math::sin(high), middle = (low + high) / 2;
                // Integral of cos^2 over the height: the level part of the directions.
                const double level = (height + sh * math::cos(high) - sl * math::cos(low)) / 2;
                const Vec3d towards = horizontal((k * split + part % split + 0.5) * width);
                const Vec3d centre = towards * math::cos(middle) + Vec3d(0, 0, math::sin(middle));
                const Vec3d weight = towards * (level * 2 * math::sin(width / 2)) +
                                     Vec3d(0, 0, width * (sh * sh - sl * sl) / 2);
                d.sky.push_back({Vec3f(centre), Vec3f(weight), d.patches});
            }
    }
    // The zenith's patch, in sectors.
    const int sectors = split * split;
    const double sl = math::sin(84 * kDegree), width = 2 * kPi / sectors;
    const double level = (6 * kDegree - sl * math::cos(84 * kDegree)) / 2;
    for (int k = 0; k < sectors; ++k) {
        const Vec3d towards = horizontal((k + 0.5) * width);
        const double tilt = sectors > 1 ? 87 * kDegree : kPi / 2;
        d.sky.push_back({Vec3f(towards * math::cos(tilt) + Vec3d(0, 0, math::sin(tilt))),
                         Vec3f(towards * (level * 2 * math::sin(width / 2)) +
                               Vec3d(0, 0, width * (1 - sl * sl) / 2)),
                         d.patches});
    }
    ++d.patches;
}

Vec3d sun_direction(double latitude, double declination, double hour_angle)
{
    const double sp = math::sin(latitude), cp = math::cos(latitude);
    const double sd = math::sin(declination), cd = math::cos(declination);
    const double ch = math::cos(hour_angle), sh = math::sin(hour_angle);
    return {-cd * sh, cp * sd - sp * cd * ch, sp * sd + cp * cd * ch};
}

/// Hour angle of sunset.
double sunset_of(double latitude, double declination)
{
    const double cosine = math::cos(latitude) * math::cos(declination);
    const double sine = math::sin(latitude) * math::sin(declination);
    return sine <= -cosine ? 0 : sine >= cosine ? kPi : math::acos(-sine / cosine);
}

/// Bins of nearly equal hour angle, as many as there are bits for.
void add_sun_bins(Directions& d, double latitude, const Params& params)
{
    double all = 0;
    for (int r = 0; r < params.sun_rows; ++r) {
        Directions::Row row;
        row.declination = kObliquity * (2.0 * r / (params.sun_rows - 1) - 1);
        row.sunset = sunset_of(latitude, row.declination);
        all += 2 * row.sunset;
        d.rows.push_back(row);
    }
    if (all == 0) return;
    // The widest share that rounding leaves within the bits.
    auto count_at = [&](const Directions::Row& row, double width) {
        return row.sunset > 0 ? std::max(1, static_cast<int>(2 * row.sunset / width + 0.5)) : 0;
    };
    double width = all / params.sun_bins;
    for (int sum = params.sun_bins + 1; sum > params.sun_bins; width *= 1.002) {
        sum = 0;
        for (const Directions::Row& row : d.rows) sum += count_at(row, width);
        if (sum <= params.sun_bins) break;
    }
    for (Directions::Row& row : d.rows) {
        row.first = static_cast<int>(d.sun.size());
        row.count = count_at(row, width);
        for (int b = 0; b < row.count; ++b) {
            const double hour = row.sunset * ((2.0 * b + 1) / row.count - 1);
            d.sun.emplace_back(sun_direction(latitude, row.declination, hour));
        }
    }
}

void add_rain(Directions& d, std::span<const RainWind> winds, const Params& params)
{
    double all = 0;
    for (const RainWind& w : winds) all += w.weight;
    const int rays = std::max(4, (params.rain_rays + static_cast<int>(winds.size()) - 1) /
                                     static_cast<int>(winds.size()));
    const double cosine = math::cos(params.rain_cone * kDegree);
    for (const RainWind& wind : winds) {
        const Vec3d mean = normalized(horizontal(wind.direction * kPi / 4) * wind.speed +
                                      Vec3d(0, 0, params.fall_speed));
        const auto [a, b] = across(mean);
        for (int k = 0; k < rays; ++k) {
            // A spiral that fills the cone's cap evenly.
            const double along = 1 - (1 - cosine) * (k + 0.5) / rays;
            const double off = std::sqrt(std::max(0.0, 1 - along * along));
            const double turn = 2.39996322972865332 * k;
            Vec3d from = mean * along + a * (off * math::cos(turn)) + b * (off * math::sin(turn));
            // Rain does not rise: a storm's last drops come in level.
            from = normalized(Vec3d(from.x, from.y, std::max(from.z, 0.02)));
            d.rain.push_back(
                {Vec3f(from), static_cast<float>(wind.weight / (all * rays * from.z))});
        }
    }
}

void check_sites(const Sites& sites)
{
    const std::size_t n = sites.size();
    if (sites.normal.size() != n || sites.area.size() != n)
        throw InvalidInput(
            fmt::format("light: {} origins, {} normals and {} areas, must be as many of each", n,
                        sites.normal.size(), sites.area.size()));
    if (n >= static_cast<std::size_t>(kDown))
        throw LimitExceeded(fmt::format("light: {} sites, must be fewer than {}", n, kDown));
    for (std::size_t i = 0; i < n; ++i) {
        const Vec3d p = sites.origin[i];
        const Vec3f m = sites.normal[i];
        if (!(std::isfinite(p.x + p.y + p.z) && std::abs(dot(m, m) - 1) < 1e-3f &&
              sites.area[i] > 0 && std::isfinite(sites.area[i])))
            throw InvalidInput(fmt::format(
                "light: site {}: origin ({:.6g}, {:.6g}, {:.6g}) m, normal ({:.6g}, {:.6g}, "
                "{:.6g}), area {:.6g} m^2; must be finite, of length 1, and > 0",
                i, p.x, p.y, p.z, m.x, m.y, m.z, sites.area[i]));
    }
}

void check_winds(std::span<const RainWind> winds)
{
    double all = 0;
    for (const RainWind& w : winds) {
        if (w.direction < 0 || w.direction > 7)
            throw InvalidInput(
                fmt::format("light: wind direction = {}, must be 0 to 7", w.direction));
        if (!(w.speed >= 0 && w.speed < 200))
            throw InvalidInput(
                fmt::format("light: wind speed = {:.6g} m/s, must be 0 to 200", w.speed));
        if (!(w.weight >= 0 && std::isfinite(w.weight)))
            throw InvalidInput(
                fmt::format("light: share of the rain = {:.6g}, must be >= 0", w.weight));
        all += w.weight;
    }
    if (!winds.empty() && !(all > 0))
        throw InvalidInput("light: the winds' shares of the rain add up to 0, must be > 0");
}

void check_latitude(double latitude)
{
    if (!(std::abs(latitude) <= kPi / 2))
        throw InvalidParameter(
            fmt::format("light: latitude = {:.6g} deg, must be -90 to 90", latitude / kDegree));
}

/// All occluders as one body of triangles.
class Geometry {
public:
    Geometry(std::span<const TriMesh* const> occluders, const Progress& progress)
    {
        const TriMesh* mesh = &joined_;
        if (occluders.size() == 1)
            mesh = occluders[0];
        else
            for (const TriMesh* part : occluders) {
                const auto first = static_cast<std::uint32_t>(joined_.vertices.size());
                joined_.vertices.insert(joined_.vertices.end(), part->vertices.begin(),
                                        part->vertices.end());
                for (const auto& t : part->triangles)
                    joined_.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
            }
        mesh_ = mesh;
        if (!mesh->triangles.empty())
            scene_ = std::make_unique<rays::TriangleScene>(mesh->vertices, mesh->triangles, "light",
                                                           progress);
    }

    bool occluded(Vec3f origin, Vec3f direction) const
    {
        return scene_ && scene_->occluded(origin, direction, 0, kFar);
    }
    bool intersect(Vec3f origin, Vec3f direction, double& distance, Vec3d& normal) const
    {
        rays::Hit hit;
        if (!scene_ || !scene_->intersect(origin, direction, 0, kFar, hit)) return false;
        const auto& t = mesh_->triangles[hit.triangle];
        const Vec3d a(mesh_->vertices[t[0]]);
        normal =
            normalized(cross(Vec3d(mesh_->vertices[t[1]]) - a, Vec3d(mesh_->vertices[t[2]]) - a));
        distance = hit.distance;
        return true;
    }

private:
    TriMesh joined_;
    const TriMesh* mesh_ = nullptr;
    std::unique_ptr<rays::TriangleScene> scene_;
};

/// Finds the site that a hit belongs to: sites sorted by the bucket they lie in.
class SiteFinder {
public:
    explicit SiteFinder(const Sites& sites) : sites_(sites)
    {
        Bounds bounds;
        for (const Vec3d& p : sites.origin) bounds.add(p);
        lower_ = bounds.lower;
        const double mean =
            parallel_sum(sites.size(), [&](std::size_t i) { return double(sites.area[i]); }) /
            static_cast<double>(std::max<std::size_t>(1, sites.size()));
        const Vec3d size = bounds.size();
        // 21 bits for each axis.
        edge_ = std::max(2 * std::sqrt(mean), std::max({size.x, size.y, size.z}) / 1e6);
        for (std::size_t i = 0; i < sites.size(); ++i)
            order_.emplace_back(key(bucket(sites.origin[i])), static_cast<std::uint32_t>(i));
        std::sort(order_.begin(), order_.end());
    }

    /// The nearest site within one and a half cells that faces the ray, or -1.
    std::int32_t find(Vec3d p, Vec3d direction) const
    {
        const Coord centre = bucket(p);
        std::int32_t best = -1;
        double nearest = 0.5625 * edge_ * edge_;
        for (int dx = -1; dx <= 1; ++dx)
            for (int dy = -1; dy <= 1; ++dy) {
                // The three buckets along z are neighbours in the order as well.
                const Coord low = centre + Coord(dx, dy, -1), high = centre + Coord(dx, dy, 1);
                if (low.x < 0 || low.y < 0 || high.z < 0) continue;
                const std::uint64_t last = key(high);
                auto at = std::lower_bound(
                    order_.begin(), order_.end(),
                    std::pair(key({low.x, low.y, std::max(low.z, 0)}), std::uint32_t(0)));
                for (; at != order_.end() && at->first <= last; ++at) {
                    const Vec3d d = sites_.origin[at->second] - p;
                    const double square = dot(d, d);
                    if (square > nearest || dot(Vec3d(sites_.normal[at->second]), direction) >= 0)
                        continue;
                    const auto number = static_cast<std::int32_t>(at->second);
                    if (square < nearest || best < 0 || number < best) best = number;
                    nearest = square;
                }
            }
        return best;
    }

private:
    Coord bucket(Vec3d p) const
    {
        const Vec3d u = (p - lower_) / edge_;
        auto cut = [](double x) { return static_cast<int>(std::clamp(std::floor(x), -4.0, 2e6)); };
        return {cut(u.x), cut(u.y), cut(u.z)};
    }
    static std::uint64_t key(Coord c)
    {
        return (std::uint64_t(std::uint32_t(c.x)) << 42) |
               (std::uint64_t(std::uint32_t(c.y)) << 21) | std::uint64_t(std::uint32_t(c.z));
    }

    const Sites& sites_;
    Vec3d lower_;
    double edge_ = 1;
    std::vector<std::pair<std::uint64_t, std::uint32_t>> order_;
};

/// Whether a ray can meet one of the changed boxes.
class Reach {
public:
    explicit Reach(std::span<const Bounds> boxes)
    {
        for (const Bounds& b : boxes) {
            if (b.empty()) continue;
            // Rays and corners are rounded to float: widen by more than that.
            const Vec3d far = max(max(b.lower, -b.lower), max(b.upper, -b.upper));
            const Vec3d margin = Vec3d(1e-5 * (std::max({far.x, far.y, far.z}) + 1e-3));
            boxes_.push_back({b.lower - margin, b.upper + margin});
        }
    }
    bool met(Vec3d origin, Vec3f direction) const
    {
        for (const Bounds& b : boxes_) {
            double near = 0, far = INFINITY;
            for (int axis = 0; axis < 3; ++axis) {
                const double o = origin[axis], d = double(direction[axis]);
                // A direction along the box's sides is never told apart from one within them.
                if (std::abs(d) < 1e-6) {
                    if (o < b.lower[axis] || o > b.upper[axis]) near = INFINITY;
                    continue;
                }
                const double s = (b.lower[axis] - o) / d, t = (b.upper[axis] - o) / d;
                near = std::max(near, std::min(s, t));
                far = std::min(far, std::max(s, t));
            }
            if (near <= far * (1 + 1e-6)) return true;
        }
        return false;
    }

private:
    std::vector<Bounds> boxes_;
};

/// The place is the identity, so that a site keeps its random numbers when others come or go.
std::uint64_t key_of(Vec3d origin)
{
    return hash2(
        hash2(std::bit_cast<std::uint64_t>(origin.x), std::bit_cast<std::uint64_t>(origin.y)),
        std::bit_cast<std::uint64_t>(origin.z));
}

/// The directions from which light is reflected onto a site: cosine-weighted, turned at random from
/// site to site.
class LinkDirections {
public:
    LinkDirections(Vec3d origin, Vec3f normal, int count) : normal_(normal), count_(count)
    {
        std::tie(a_, b_) = across(normal_);
        constexpr Stream kTurn{"light.link_turn"};
        const std::uint64_t place = key_of(origin);
        turn_ = uniform01(0, kTurn, place, 0) * 2 * kPi;
        shift_ = uniform01(0, kTurn, place, 1);
    }
    Vec3d operator()(int k) const
    {
        const double square = (k + shift_) / count_;
        const double angle = turn_ + 2.39996322972865332 * k, r = std::sqrt(square);
        return a_ * (r * math::cos(angle)) + b_ * (r * math::sin(angle)) +
               normal_ * std::sqrt(std::max(0.0, 1 - square) + 1e-12);
    }

private:
    Vec3d normal_, a_, b_;
    int count_;
    double turn_, shift_;
};

/// The rays of single sites.
class Tracer {
public:
    Tracer(Coefficients& result, const Sites& sites, const Geometry& geometry, const Veil* veil)
        : result_(result),
          sites_(sites),
          geometry_(geometry),
          veil_(veil),
          finder_(sites),
          directions_(directions(result.latitude, result.winds, result.params))
    {
        // A moment may lie this far from the bin that answers for it.
        double gap = 0;
        for (std::size_t r = 0; r < directions_.rows.size(); ++r) {
            const Directions::Row& row = directions_.rows[r];
            if (row.count) gap = std::max(gap, row.sunset / row.count);
        }
        double step = 0;
        for (std::size_t r = 1; r < directions_.rows.size(); ++r)
            step = std::max(step,
                            directions_.rows[r].declination - directions_.rows[r - 1].declination);
        margin_ = static_cast<float>(math::sin(std::min(gap + step, kPi / 4)));
    }

    const Directions& all() const { return directions_; }

    /// Asks the rays of site i for which `again` is true; the others keep their answers.
    template <class Again>
    void site(std::size_t i, const Again& again)
    {
        const Vec3d origin = sites_.origin[i];
        const Vec3f from(origin), n = sites_.normal[i];
        const bool buried = result_.params.ground && origin.z < *result_.params.ground;
        auto visible = [&](Vec3f direction) {
            return !buried && !geometry_.occluded(from, direction);
        };
        auto put = [&](std::size_t bit, bool seen) {
            std::int32_t& word = result_.bits[(bit >> 5) * result_.sites + i];
            const auto mask = static_cast<std::int32_t>(1u << (bit & 31));
            word = seen ? word | mask : word & ~mask;
        };

        // Sky: only what lies before the surface counts.
        auto front = [&](const Directions::Part& part) {
            return dot(n, part.weight) > 0 && dot(n, part.centre) > 0;
        };
        if (std::any_of(directions_.sky.begin(), directions_.sky.end(),
                        [&](const auto& part) { return front(part) && again(part.centre); })) {
            double seen = 0, whole = 0;
            std::size_t p = 0;
            for (int patch = 0; patch < directions_.patches; ++patch) {
                int asked = 0, found = 0;
                for (; p < directions_.sky.size() && directions_.sky[p].patch == patch; ++p) {
                    const Directions::Part& part = directions_.sky[p];
                    if (!front(part)) continue;
                    const double weight = double(dot(n, part.weight));
                    whole += weight;
                    ++asked;
                    if (!visible(part.centre)) continue;
                    const double share = through(origin, part.centre);
                    seen += weight * share;
                    found += share >= 0.5;
                }
                put(static_cast<std::size_t>(patch), asked && 2 * found >= asked);
            }
            result_.sky_view[i] = static_cast<float>((1 + double(n.z)) / 2 * seen / whole);
        }

        // Sun: a bin whose centre lies just behind the surface answers for moments before it.
        const std::size_t first = 32 * static_cast<std::size_t>(directions_.sun_word);
        constexpr Stream kFleck{"light.fleck"};
        for (std::size_t r = 0; r < directions_.rows.size(); ++r) {
            double light = veil_ && !buried ? uniform01(0, kFleck, key_of(origin), r) : 0;
            const auto begin = static_cast<std::size_t>(directions_.rows[r].first);
            const auto count = static_cast<std::size_t>(directions_.rows[r].count);
            for (std::size_t b = begin; b < begin + count; ++b) {
                Vec3f s = directions_.sun[b];
                const float cosine = dot(n, s);
                if (cosine < -margin_) continue;
                if (cosine < kGrazing) s = normalized(s + n * (kGrazing - cosine));
                bool lit = true;
                if (veil_ && !buried) {
                    light += through(origin, s);
                    lit = light >= 1;
                    light -= lit;
                }
                if (again(s)) put(first + b, lit && visible(s));
            }
        }

        bool rain = false;
        for (const Directions::Drop& drop : directions_.rain)
            rain = rain || (dot(n, drop.from) > 0 && again(drop.from));
        if (rain) {
            double sum = 0;
            for (const Directions::Drop& drop : directions_.rain) {
                const float cosine = dot(n, drop.from);
                if (cosine > 0 && visible(drop.from)) sum += double(cosine) * double(drop.weight);
            }
            result_.rain_exposure[i] = static_cast<float>(sum);
        }

        if (result_.links.empty()) return;
        const LinkDirections towards(origin, n, result_.params.links);
        for (int k = 0; k < result_.params.links; ++k) {
            const Vec3d d = towards(k);
            if (again(Vec3f(d)))
                result_.links[static_cast<std::size_t>(k) * result_.sites + i] =
                    buried ? kBuried : pack(link(origin, Vec3f(d), k));
        }
    }

private:
    static constexpr float kGrazing = 0.01f;

    double through(Vec3d origin, Vec3f direction) const
    {
        return veil_ ? veil_->transmittance(origin, Vec3d(direction)) : 1;
    }

    Link link(Vec3d origin, Vec3f direction, int k) const
    {
        const Vec3d d(direction);
        const bool down = d.z < 0;
        double distance = 0;
        Vec3d normal;
        const bool hit = geometry_.intersect(Vec3f(origin), direction, distance, normal);
        // Leaves before the sky, or above what reflects, are met as often as they take light.
        auto unless_leaves = [&](Link bare, Vec3d from, Vec3d to) -> Link {
            constexpr Stream kLeaf{"light.link_leaves"};
            if (!veil_ || uniform01(0, kLeaf, key_of(origin), std::uint64_t(k)) <
                              veil_->transmittance(from, to))
                return bare;
            return {down, kLeaves, 0};
        };
        constexpr Vec3d kUp(0, 0, 1);
        if (down && result_.params.ground) {
            const double fall = (*result_.params.ground - origin.z) / d.z;
            if (!hit || fall < distance)
                return unless_leaves({true, kGround, 0}, origin + d * fall, kUp);
        }
        if (!hit)
            return down ? unless_leaves({true, kGround, 0}, origin, kUp)
                        : unless_leaves({false, kSky, 0}, origin, d);
        const Vec3d at = origin + d * distance;
        const std::int32_t number = finder_.find(at, d);
        if (number >= 0) return {down, number, 0};
        return unless_leaves({down, kForeign, facing_of(dot(normal, d) > 0 ? -normal : normal)}, at,
                             kUp);
    }

    Coefficients& result_;
    const Sites& sites_;
    const Geometry& geometry_;
    const Veil* veil_;
    const SiteFinder finder_;
    const Directions directions_;
    float margin_ = 0;
};

template <class F>
void over_sites(std::size_t count, const Progress& progress, F&& f)
{
    constexpr std::size_t kBatch = 2048;
    for (std::size_t begin = 0; begin < count; begin += kBatch) {
        const std::size_t size = std::min(kBatch, count - begin);
        parallel_for_range(
            size,
            [&](std::size_t b, std::size_t e) {
                for (std::size_t i = b; i != e; ++i) {
                    if (i % 32 == 0) progress.check();
                    f(begin + i);
                }
            },
            32);
        progress.update(static_cast<double>(begin + size) / static_cast<double>(count));
    }
}

/// Bins of a day's moments: two rows, each with its share.
struct Glimpse {
    Vec3f beam;  ///< DNI times share times direction
    std::size_t word[2] = {0, 0};
    int shift[2] = {0, 0};
    float share[2] = {0, 0};
};

std::vector<Glimpse> glimpses(const Directions& d, double latitude,
                              std::span<const sun::Moment> moments, double beam_normal)
{
    const double sp = math::sin(latitude), cp = math::cos(latitude);
    std::vector<Glimpse> list;
    for (const sun::Moment& m : moments) {
        const Vec3d s = m.to_sun;
        const double sine = std::clamp(sp * s.z + cp * s.y, -1.0, 1.0);
        const double declination = math::atan2(sine, std::sqrt(1 - sine * sine));
        const double hour = math::atan2(-s.x, cp * s.z - sp * s.y);
        // Rows on either side that have any day.
        std::size_t above = 1;
        while (above + 1 < d.rows.size() && d.rows[above].declination < declination) ++above;
        const Directions::Row *low = &d.rows[above - 1], *high = &d.rows[above];
        double t = std::clamp(
            (declination - low->declination) / (high->declination - low->declination), 0.0, 1.0);
        if (!low->count && !high->count) {
            // Near a pole the first day falls between rows: the next row with a day answers.
            for (const Directions::Row& row : d.rows)
                if (row.count && (!high->count || std::abs(row.declination - declination) <
                                                      std::abs(high->declination - declination)))
                    high = &row;
            if (!high->count) continue;
        }
        if (!low->count) t = 1;
        if (!high->count) t = 0;
        Glimpse g;
        g.beam = Vec3f(s * (m.share * beam_normal));
        int k = 0;
        for (const auto& [row, share] : {std::pair(low, 1 - t), std::pair(high, t)}) {
            if (share > 0) {
                const double place = (hour / row->sunset + 1) / 2 * row->count;
                const int bin =
                    row->first + std::clamp(static_cast<int>(std::floor(place)), 0, row->count - 1);
                g.word[k] = static_cast<std::size_t>(d.sun_word + (bin >> 5));
                g.shift[k] = bin & 31;
                g.share[k] = static_cast<float>(share);
            }
            ++k;
        }
        list.push_back(g);
    }
    return list;
}

/// Adds the beams that a block of sites sees. The same bits with and without AVX2.
SEKITEI_CLONES void add_beams(const Glimpse& g, const std::int32_t* first,
                              const std::int32_t* second, const float* nx, const float* ny,
                              const float* nz, float* sum, std::size_t count)
{
    for (std::size_t i = 0; i < count; ++i) {
        const float cosine = nx[i] * g.beam.x + ny[i] * g.beam.y + nz[i] * g.beam.z;
        const float seen = static_cast<float>((first[i] >> g.shift[0]) & 1) * g.share[0] +
                           static_cast<float>((second[i] >> g.shift[1]) & 1) * g.share[1];
        sum[i] += (cosine > 0 ? cosine : 0.0f) * seen;
    }
}

}  // namespace

void validate(const Params& params)
{
    validate_described("light", params);
}

std::vector<RainWind> rain_winds(std::span<const WeatherDay> days)
{
    std::array<double, 8> rain{}, carried{};
    for (const WeatherDay& day : days) {
        if (day.wind_direction < 0 || day.wind_direction > 7)
            throw InvalidInput(
                fmt::format("light: {:04}-{:02}-{:02}: wind direction = {}, must be "
                            "0 to 7",
                            day.year, day.month, day.day, day.wind_direction));
        const auto d = static_cast<std::size_t>(day.wind_direction);
        rain[d] += day.precipitation;
        carried[d] += day.precipitation * day.wind_speed;
    }
    std::vector<RainWind> winds;
    for (std::size_t d = 0; d < 8; ++d)
        if (rain[d] > 0) winds.push_back({static_cast<int>(d), carried[d] / rain[d], rain[d]});
    if (winds.empty()) winds.push_back({});
    return winds;
}

Directions directions(double latitude, std::span<const RainWind> winds, const Params& params)
{
    check_latitude(latitude);
    check_winds(winds);
    validate(params);
    Directions d;
    add_sky(d, params);
    d.sun_word = (d.patches + 31) / 32;
    add_sun_bins(d, latitude, params);
    d.words = d.sun_word + static_cast<int>((d.sun.size() + 31) / 32);
    const RainWind calm;
    add_rain(d, winds.empty() ? std::span(&calm, 1) : winds, params);
    return d;
}

std::vector<std::int32_t> Coefficients::word(std::size_t w) const
{
    const auto first = bits.begin() + static_cast<std::ptrdiff_t>(w * sites);
    return {first, first + static_cast<std::ptrdiff_t>(sites)};
}

std::size_t Coefficients::bytes_per_site() const
{
    return sites ? (bits.size() + links.size()) * 4 / sites + 8 : 0;
}

Coefficients trace(const Sites& sites, std::span<const TriMesh* const> occluders, double latitude,
                   std::span<const RainWind> winds, const Params& params, const Progress& progress,
                   const Veil* veil)
{
    check_sites(sites);
    Coefficients c;
    c.params = params;
    c.latitude = latitude;
    c.winds.assign(winds.begin(), winds.end());
    c.sites = sites.size();
    const Directions all = directions(latitude, winds, params);
    c.bits.assign(static_cast<std::size_t>(all.words) * c.sites, 0);
    c.sky_view.assign(c.sites, 0);
    c.rain_exposure.assign(c.sites, 0);
    if (params.bounces > 0) c.links.assign(static_cast<std::size_t>(params.links) * c.sites, kSky);
    log::detail("light: {} sites, {} directions of the sky, {} of the sun, {} of rain", c.sites,
                all.sky.size(), all.sun.size(), all.rain.size());
    const Geometry geometry(occluders, progress);
    Tracer tracer(c, sites, geometry, veil);
    over_sites(c.sites, progress,
               [&](std::size_t i) { tracer.site(i, [](Vec3f) { return true; }); });
    return c;
}

Coefficients retrace(const Coefficients& old, const Sites& sites,
                     std::span<const TriMesh* const> occluders, std::span<const Bounds> changed,
                     const Progress& progress, const Veil* veil)
{
    check_sites(sites);
    if (sites.size() != old.sites)
        throw InvalidInput(
            fmt::format("light: {} sites, but the coefficients are of {}; must be "
                        "the same sites",
                        sites.size(), old.sites));
    Coefficients c = old;
    const Geometry geometry(occluders, progress);
    const Reach reach(changed);
    Tracer tracer(c, sites, geometry, veil);
    over_sites(c.sites, progress, [&](std::size_t i) {
        const Vec3d origin = sites.origin[i];
        tracer.site(i, [&](Vec3f direction) { return reach.met(origin, direction); });
    });
    return c;
}

bool link_fits(std::int32_t code, std::int32_t sites)
{
    const Link link = unpack(code);
    if (code >= 0) return link.site < sites;
    return link.site != kForeign || kForeign - code < 54;
}

Light day(const Coefficients& c, const Sites& sites, std::span<const sun::Moment> moments,
          const sun::Radiation& radiation)
{
    const Directions d = directions(c.latitude, c.winds, c.params);
    if (sites.size() != c.sites || sites.normal.size() != c.sites || c.sky_view.size() != c.sites ||
        c.bits.size() != static_cast<std::size_t>(d.words) * c.sites ||
        c.links.size() !=
            (c.params.bounces > 0 ? static_cast<std::size_t>(c.params.links) * c.sites : 0))
        throw InvalidInput(
            fmt::format("light: {} sites, but the coefficients are of {} ({} words "
                        "and {} links); must be the same sites and parameters",
                        sites.size(), c.sites, c.bits.size(), c.links.size()));
    const std::size_t n = c.sites;
    Light light{std::vector<float>(n), std::vector<float>(n), std::vector<float>(n),
                std::vector<float>(n)};

    const std::vector<Glimpse> beams = glimpses(d, c.latitude, moments, radiation.beam_normal);
    constexpr std::size_t kBlock = 512;
    parallel_for((n + kBlock - 1) / kBlock, [&](std::size_t block) {
        const std::size_t begin = block * kBlock, size = std::min(kBlock, n - begin);
        float nx[kBlock], ny[kBlock], nz[kBlock];
        for (std::size_t i = 0; i < size; ++i) {
            const Vec3f m = sites.normal[begin + i];
            nx[i] = m.x;
            ny[i] = m.y;
            nz[i] = m.z;
            light.sky[begin + i] =
                static_cast<float>(radiation.diffuse * double(c.sky_view[begin + i]));
        }
        for (const Glimpse& g : beams)
            add_beams(g, c.bits.data() + g.word[0] * n + begin,
                      c.bits.data() + g.word[1] * n + begin, nx, ny, nz,
                      light.direct.data() + begin, size);
    });

    // What the ground and other occluders send out, as if nothing shaded them.
    const std::vector<sun::Moment> list(moments.begin(), moments.end());
    const double ground = c.params.ground_albedo * radiation.global;
    std::array<double, 27> foreign{};
    for (int facing = 0; facing < 27; ++facing)
        if (facing != 13)
            foreign[static_cast<std::size_t>(facing)] =
                c.params.albedo *
                sun::light_on_plane(normal_facing(facing), list, radiation, c.params.ground_albedo)
                    .total();

    std::vector<float> before(n);
    for (int bounce = 0; bounce < std::max(1, c.params.bounces); ++bounce) {
        before = light.reflected;
        parallel_for(
            n,
            [&](std::size_t i) {
                const double z = double(sites.normal[i].z), below = (1 - z) / 2;
                if (c.links.empty()) {
                    light.reflected[i] = static_cast<float>(ground * below);
                    return;
                }
                // The shares of sky and of what hides it are known better than links tell.
                const double hidden = std::max(0.0, (1 + z) / 2 - double(c.sky_view[i]));
                double sum[2] = {0, 0}, count[2] = {0, 0};
                for (std::size_t k = 0; k < c.links.size() / n; ++k) {
                    const Link link = unpack(c.links[k * n + i]);
                    if (link.site == kBuried) count[0] = count[1] = 1;
                    if (link.site == kSky || link.site == kBuried) continue;
                    double sent = ground;
                    if (link.site == kLeaves)
                        sent = 0;
                    else if (link.site == kForeign)
                        sent = foreign[static_cast<std::size_t>(link.facing)];
                    else if (link.site >= 0) {
                        const auto j = static_cast<std::size_t>(link.site);
                        sent = c.params.albedo *
                               (double(light.direct[j]) + double(light.sky[j]) + double(before[j]));
                    }
                    sum[link.down] += sent;
                    count[link.down] += 1;
                }
                const double up = count[0] > 0 ? sum[0] / count[0] : ground;
                const double down = count[1] > 0 ? sum[1] / count[1] : ground;
                light.reflected[i] = static_cast<float>(up * hidden + down * below);
            },
            1024);
    }
    parallel_for(
        n,
        [&](std::size_t i) {
            light.total[i] = light.direct[i] + light.sky[i] + light.reflected[i];
        },
        8192);
    return light;
}

}  // namespace sekitei::light
