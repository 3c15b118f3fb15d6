#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/render/fast_math.h"
#include "apps/render/tufts.h"
#include "core/math.h"
#include "core/mesh_io.h"
#include "core/random.h"

namespace sekitei::render {
namespace {

constexpr double kGolden = 2.39996322972865;  // angle between leaves and between shoots [rad]
constexpr double kTurn = 2 * math::kPi;
constexpr std::array<double, kTuftDensities> kDensity{0.45, 0.7, 1.0};

/// A row of random numbers with an address.
struct Draws {
    std::uint64_t key, next = 0;
    double random() { return uniform_of_key(key, next++); }
    double between(double low, double high) { return low + (high - low) * random(); }
};

Vec3d around(double angle, double y)
{
    return {math::cos(angle), y, math::sin(angle)};
}

/// Two directions across `along`.
std::array<Vec3d, 2> across(Vec3d along)
{
    const Vec3d x =
        normalized(cross(along, std::abs(along.y) < 0.9 ? Vec3d(0, 1, 0) : Vec3d(1, 0, 0)));
    return {x, cross(along, x)};
}

/// Makes one plant. Lengths are in diameters of a full-grown one.
class Gardener {
public:
    /// @param flat  how much the plant's surface as a whole looks up instead of outwards
    explicit Gardener(double flat) : flat_(flat) {}

    std::uint32_t vertex(Vec3d p, double height, double tone, Vec3d normal = {})
    {
        if (dot(normal, normal) == 0) normal = p + Vec3d(0, flat_, 0);
        shape.vertices.push_back(Vec3f(p));
        shape.normals.push_back(Vec3f(normalized(normal)));
        shape.height.push_back(static_cast<float>(height));
        shape.tone.push_back(static_cast<float>(tone));
        return static_cast<std::uint32_t>(shape.vertices.size() - 1);
    }

    /// A pointed blade of one triangle.
    void blade(Vec3d foot, Vec3d along, double length_, double width, double low, double high,
               double tone)
    {
        const Vec3d side = normalized(cross(along, Vec3d(0.01, 1, 0.02))) * (width / 2);
        const auto a = vertex(foot + side, low, tone), b = vertex(foot - side, low, tone),
                   c = vertex(foot + along * length_, high, tone);
        shape.triangles.push_back({a, b, c});
        face(1);
    }

    /// A pointed leaf that droops, widest in its middle.
    void leaf(Vec3d foot, Vec3d along, double length_, double width, double droop, double low,
              double high, double tone)
    {
        const Vec3d side = normalized(cross(along, Vec3d(0.01, 1, 0.02))) * (width / 2);
        const Vec3d middle = foot + along * (0.5 * length_);
        const Vec3d tip = foot + along * length_ + Vec3d(0, -droop * length_, 0);
        const double half = (low + high) / 2;
        const auto a = vertex(foot, low, tone), b = vertex(middle + side, half, tone),
                   c = vertex(middle - side, half, tone), d = vertex(tip, high, tone);
        shape.triangles.push_back({a, c, b});
        shape.triangles.push_back({b, c, d});
        face(2);
    }

    /// A stem of three sides that becomes thinner.
    void stem(Vec3d foot, Vec3d top, double radius, double radius_top, double low, double high,
              double tone)
    {
        const auto [x, y] = across(normalized(top - foot));
        std::array<std::uint32_t, 6> ring{};
        for (std::size_t k = 0; k < 3; ++k) {
            const double a = kTurn * static_cast<double>(k) / 3;
            const Vec3d out = x * math::cos(a) + y * math::sin(a);
            ring[k] = vertex(foot + out * radius, low, tone, out);
            ring[k + 3] = vertex(top + out * radius_top, high, tone, out);
        }
        for (std::size_t k = 0; k < 3; ++k) {
            const std::size_t next = (k + 1) % 3;
            shape.triangles.push_back({ring[k], ring[next], ring[k + 3]});
            shape.triangles.push_back({ring[next], ring[next + 3], ring[k + 3]});
        }
    }

    /// A body pointed at both ends, thickest at `belly` of its length; or only its upper part.
    void spindle(Vec3d foot, Vec3d top, double radius, double belly, int sides, double low,
                 double high, double tone, bool whole = true)
    {
        const auto [x, y] = across(normalized(top - foot));
        const Vec3d middle = foot + (top - foot) * belly, along = normalized(top - foot);
        const auto first = static_cast<std::uint32_t>(shape.vertices.size());
        const auto n = static_cast<std::uint32_t>(sides);
        for (int k = 0; k < sides; ++k) {
            const double a = kTurn * k / sides;
            const Vec3d out = x * math::cos(a) + y * math::sin(a);
            // Those that stand for shoots are lit as the cushion is.
            vertex(middle + out * radius, whole ? high : low, tone, whole ? out : Vec3d());
        }
        const auto tip = vertex(top, high, tone, whole ? along : Vec3d());
        for (std::uint32_t k = 0; k < n; ++k)
            shape.triangles.push_back({first + k, first + (k + 1) % n, tip});
        if (!whole) return;
        const auto end = vertex(foot, low, tone, -along);
        for (std::uint32_t k = 0; k < n; ++k)
            shape.triangles.push_back({first + (k + 1) % n, first + k, end});
    }

    /// Rings of vertices about the axis under one at the top, closed to a skin.
    /// @param at  (ring, place around in turns) to position; ring -1 is the top
    template <class At, class Shade>
    void skin(int rings, int sides, const At& at, const Shade& shade)
    {
        auto add = [&](int ring, double turn) {
            const auto [height, tone] = shade(ring);
            const Vec3d p = at(ring, turn);
            return vertex(p, height, tone, p.y < 0 ? p : Vec3d());  // the underside looks down
        };
        const std::uint32_t first = add(-1, 0);
        for (int j = 0; j < rings; ++j)
            for (int i = 0; i < sides; ++i) add(j, static_cast<double>(i) / sides);
        auto of = [&](int ring, int i) {
            return first + 1 + static_cast<std::uint32_t>(ring * sides + i % sides);
        };
        for (int i = 0; i < sides; ++i) {
            shape.triangles.push_back({first, of(0, i + 1), of(0, i)});
            for (int j = 0; j + 1 < rings; ++j) {
                shape.triangles.push_back({of(j, i), of(j, i + 1), of(j + 1, i)});
                shape.triangles.push_back({of(j, i + 1), of(j + 1, i + 1), of(j + 1, i)});
            }
        }
    }

    /// The dark inside of a cushion, so that no stone shows between the shoots. It narrows towards
    /// its foot, below the surface.
    void core(Draws draws, double radius, double top, int sides, double height)
    {
        static constexpr std::array<std::array<double, 2>, 5> kProfile{
            {{0.50, 0.88}, {0.88, 0.48}, {1.0, 0.05}, {0.80, -0.9}, {0.45, -1.6}}};
        skin(
            static_cast<int>(kProfile.size()), sides,
            [&](int ring, double turn) {
                if (ring < 0) return Vec3d(0, top, 0);
                const auto [wide, high] = kProfile[static_cast<std::size_t>(ring)];
                const double r = radius * wide * draws.between(0.90, 1.06);
                return around(kTurn * turn, 0) * r +
                       Vec3d(0, high < 0 ? std::min(top, 0.16) * high : top * high, 0);
            },
            [&](int) {
                return std::array<double, 2>{height, 0};
            });
    }

    TuftShape shape;

private:
    /// Turns the last triangles, of one leaf, to the side that the cushion turns outwards.
    void face(std::size_t count)
    {
        const auto last = shape.triangles.end();
        Vec3f area, outwards;
        for (auto t = last - static_cast<std::ptrdiff_t>(count); t != last; ++t) {
            const Vec3f a = shape.vertices[(*t)[0]];
            area += cross(shape.vertices[(*t)[1]] - a, shape.vertices[(*t)[2]] - a);
            for (const std::uint32_t v : *t) outwards += shape.normals[v];
        }
        if (dot(area, outwards) < 0)
            for (auto t = last - static_cast<std::ptrdiff_t>(count); t != last; ++t)
                std::swap((*t)[1], (*t)[2]);
    }

    double flat_;
};

/// One shoot of a plant: the same at all levels of detail and densities.
struct Shoot {
    std::uint64_t key = 0;  // of its own random numbers
    double rank = 0;        // [0, 1): it has grown at densities above
    double tone = 0;
    std::vector<Vec3d> path;  // foot to tip
    Vec3d along() const { return normalized(path.back() - path.front()); }
};

/// The place of i in an order that spreads evenly, however far it is followed, van der Corput's.
double rank_of(int i)
{
    double rank = 0;
    for (double digit = 0.5; i; i >>= 1, digit /= 2)
        if (i & 1) rank += digit;
    return rank;
}

/// How a level of detail draws a species, found by comparing pictures of its levels.
struct Level {
    double wide = 1;           // of shoots, or of the skin
    double low = 0, high = 1;  // `height` there
    double tone = 0;           // that self-shading of the shoots would have given
};

/// What makes a species.
struct Habit {
    double flat;                   // see Gardener
    double core, core_top;         // radius and height of the dark inside
    int stalks;                    // sporophytes of the last model
    double stalk_low, stalk_high;  // length
    double nod;                    // of the capsule: 1 hangs, -1 upright
    double capsule;                // length
    Level middle, far;             // levels 1 and 2
};

/// Short shoots, closely packed over a dome with an uneven rim.
class Cushion {
public:
    int count;
    double dome, leaf_length;
    bool hair;                                  // the leaves at the tips end in long points
    static constexpr double kMiddle = 2.0 / 3;  // of the shoots stand for all in level 1

    Shoot shoot(std::uint64_t key, int i) const
    {
        Draws rims{hash2(key, 1)}, d{hash2(hash2(key, 2), static_cast<std::uint64_t>(i))};
        const double phase = rims.between(0, kTurn), phase2 = rims.between(0, kTurn);
        // Evenly over the dome, and a little beyond its rim.
        const double a = i * kGolden + d.between(-0.2, 0.2);
        const double cosine = 1 - 1.12 * (i + 0.5) / count;
        const double sine = std::sqrt(1 - cosine * cosine);
        const double rim = 1 + 0.13 * math::sin(2 * a + phase) + 0.10 * math::sin(5 * a + phase2);
        const Vec3d out = around(a, 0) * sine;
        const Vec3d foot = out * (0.33 * rim) + Vec3d(0, dome * 0.72 * cosine, 0);
        const double heading = d.between(0, kTurn);
        const Vec3d along = normalized(out + Vec3d(0, 0.25 + 0.9 * cosine, 0) +
                                       around(heading, d.between(-0.5, 0.5)) * 0.22);
        const double length_ = (0.17 + 0.10 * dome) * d.between(0.8, 1.15);
        return {d.key, rank_of(i), d.between(-1, 1), {foot, foot + along * length_}};
    }
    void near(Gardener& g, const Shoot& s) const
    {
        Draws d{hash2(s.key, 1)};
        const Vec3d along = s.along();
        const auto [x, y] = across(along);
        const double start = d.between(0, kTurn), length_ = length(s.path[1] - s.path[0]);
        constexpr int kLeaves = 11;
        for (int k = 0; k < kLeaves; ++k) {
            const double h = static_cast<double>(k) / (kLeaves - 1), turn = start + k * kGolden;
            const Vec3d spread = x * math::cos(turn) + y * math::sin(turn);
            // Leaves close up towards the tip.
            g.leaf(s.path[0] + along * (length_ * h),
                   normalized(along * (0.5 + 0.9 * h) + spread * (0.95 - 0.5 * h)),
                   leaf_length * (1.15 - 0.4 * h), 0.034 * (1.15 - 0.35 * h), 0.04, 0.15 + 0.45 * h,
                   0.40 + 0.60 * h, s.tone);
        }
        if (hair)
            for (int k = 0; k < 3; ++k) {
                const double heading = d.between(0, kTurn);
                g.blade(s.path[1], normalized(along + around(heading, d.between(-0.3, 0.6)) * 0.4),
                        d.between(0.06, 0.11), 0.008, 1.2, 1.3, s.tone);
            }
    }
    void middle(Gardener& g, const Shoot& s, const Level& level) const
    {
        g.spindle(s.path[0], s.path[1] + s.along() * (0.5 * leaf_length), 0.075 * level.wide, 0.35,
                  3, level.low, level.high, s.tone + level.tone, false);
    }
};

/// Creeping stems with branches like feathers, over each other.
class Mat {
public:
    int count;
    static constexpr double kMiddle = 1;

    /// The mat's height over its middle and down to its edge, which lies on the stone.
    static double lie(Vec3d p)
    {
        const double r2 = p.x * p.x + p.z * p.z;
        return 0.12 - 0.35 * r2 - 1.3 * r2 * r2;
    }
    Shoot shoot(std::uint64_t key, int i) const
    {
        Draws d{hash2(hash2(key, 2), static_cast<std::uint64_t>(i))};
        const double a = i * kGolden + d.between(-0.4, 0.4), from = a + d.between(-0.9, 0.9);
        Vec3d p = around(from, 0) * d.between(0.0, 0.30);
        const double lift = d.between(-0.03, 0.04);
        Shoot s{d.key, rank_of(i), d.between(-1, 1), {}};
        double heading = a;
        const double turn = d.between(-0.20, 0.20);
        constexpr int kSteps = 11;
        for (int k = 0; k <= kSteps; ++k) {
            p.y = lie(p) + lift;
            s.path.push_back(p);
            p += around(heading, 0) * 0.040;
            heading += turn;
        }
        return s;
    }
    void near(Gardener& g, const Shoot& s) const
    {
        Draws d{hash2(s.key, 1)};
        const auto steps = s.path.size() - 1;
        for (std::size_t k = 0; k < steps; ++k) {
            const double h = static_cast<double>(k) / static_cast<double>(steps);
            const Vec3d p = s.path[k], along = normalized(s.path[k + 1] - p);
            // Branches on both sides, shorter towards the tip, with ends that curl down.
            const double reach = 0.115 * (1.1 - 0.8 * h) * d.between(0.75, 1.25);
            for (const double side : {-1.0, 1.0}) {
                const Vec3d out = beside(along, side * d.between(0.6, 1.0));
                g.leaf(p, out, reach, 0.026, 0.45, 0.30 + 0.25 * h, 0.65 + 0.35 * h, s.tone);
                g.blade(p + out * (0.4 * reach), normalized(out + along * 0.9), reach * 0.5, 0.018,
                        0.40 + 0.25 * h, 0.70 + 0.30 * h, s.tone);
            }
            g.blade(p, normalized(along + Vec3d(0, 0.35, 0)), 0.060, 0.026, 0.35 + 0.3 * h,
                    0.70 + 0.30 * h, s.tone);
        }
    }
    void middle(Gardener& g, const Shoot& s, const Level& level) const
    {
        for (const std::size_t k : {1, 4, 7}) {
            const Vec3d along = normalized(s.path[k + 1] - s.path[k]);
            const double h = static_cast<double>(k) / 11;
            for (const double side : {-1.0, 1.0})
                g.blade(s.path[k], beside(along, side * 0.75), 0.120 * (1.1 - 0.8 * h) + 0.04,
                        0.10 * level.wide, level.low, level.high, s.tone + level.tone);
        }
        const Vec3d along = normalized(s.path[11] - s.path[8]);
        g.blade(s.path[8], along, 0.16, 0.06 * level.wide, level.low, level.high,
                s.tone + level.tone);
    }

private:
    static Vec3d beside(Vec3d along, double angle)
    {
        const double c = math::cos(angle), s = math::sin(angle);
        const Vec3d level = normalized(Vec3d(along.x, 0, along.z));
        return normalized(Vec3d(level.x * c - level.z * s, 0.38, level.x * s + level.z * c));
    }
};

/// Tall stems with stiff leaves all around: stars from above.
class Stars {
public:
    int count;
    static constexpr double kMiddle = 1;

    Shoot shoot(std::uint64_t key, int i) const
    {
        Draws d{hash2(hash2(key, 2), static_cast<std::uint64_t>(i))};
        const double r = 0.40 * std::sqrt((i + 0.5) / count), a = i * kGolden;
        const Vec3d foot = around(a, 0) * r;
        const double tall = d.between(0.50, 0.82) * (1 - 0.35 * r), heading = d.between(0, kTurn);
        const Vec3d lean =
            normalized(Vec3d(0, 1, 0) + around(a, 0) * (0.5 * r) + around(heading, 0) * 0.12);
        return {d.key, rank_of(i), d.between(-1, 1), {foot, foot + lean * tall}};
    }
    void near(Gardener& g, const Shoot& s) const
    {
        Draws d{hash2(s.key, 1)};
        g.stem(s.path[0], s.path[1], 0.012, 0.006, 0.05, 0.35, s.tone);
        const double start = d.between(0, kTurn);
        constexpr int kLeaves = 38;
        for (int k = 0; k < kLeaves; ++k) {
            const double h = static_cast<double>(k) / (kLeaves - 1), up = 0.30 + 0.70 * h;
            // Spread wide below, half upright at the tip.
            const Vec3d out = normalized(around(k * kGolden + start, 0.25 + 1.1 * h * h));
            g.leaf(s.path[0] + (s.path[1] - s.path[0]) * up, out, 0.19 * (1 - 0.35 * h), 0.022,
                   0.14 * (1 - h), 0.25 + 0.35 * h, 0.55 + 0.45 * h, s.tone);
        }
    }
    void middle(Gardener& g, const Shoot& s, const Level& level) const
    {
        Draws d{hash2(s.key, 1)};
        const double start = d.between(0, kTurn);
        for (int k = 0; k < 7; ++k) {
            const double h = k < 3 ? 0.35 : k < 6 ? 0.75 : 1;
            const Vec3d out = normalized(around(start + k * kGolden, 0.1 + 1.1 * h * h));
            g.blade(s.path[0] + (s.path[1] - s.path[0]) * (0.3 + 0.65 * h) - out * 0.03, out,
                    0.20 * (1 - 0.25 * h) + 0.03, 0.10 * level.wide, level.low + 0.15 * h,
                    level.high, s.tone + level.tone);
        }
    }
};

/// The outline of all shoots as a coarse skin.
void far(Gardener& g, const std::vector<Shoot>& shoots, Draws draws, bool tall, bool flat,
         double share, const Level& level)
{
    const int sides = tall ? 5 : 7;
    double top = 0;
    std::vector<double> reach(static_cast<std::size_t>(sides), 0.0);
    for (const Shoot& s : shoots) {
        const Vec3d tip = s.path.back();
        for (const Vec3d p : s.path) top = std::max(top, p.y);
        // The sector whose middle is nearest.
        double best = -2;
        std::size_t sector = 0;
        for (int i = 0; i < sides; ++i) {
            const double c = dot(tip, around(kTurn * i / sides, 0));
            if (c > best) best = c, sector = static_cast<std::size_t>(i);
        }
        reach[sector] = std::max(reach[sector], std::sqrt(tip.x * tip.x + tip.z * tip.z));
    }
    // Radius and height of each ring, as shares of reach and top.
    using Profile = std::vector<std::array<double, 2>>;
    static const Profile kDome{{0.72, 0.70}, {1.0, -0.22}}, kFlat{{0.68, 0.80}, {1.0, -0.45}},
        kTall{{0.86, 0.86}, {1.04, 0.50}, {0.75, -0.10}};
    const Profile& profile = tall ? kTall : flat ? kFlat : kDome;
    const double wide = level.wide * (0.55 + 0.45 * share);
    g.skin(
        static_cast<int>(profile.size()), sides,
        [&](int ring, double turn) {
            if (ring < 0) return Vec3d(0, top * 0.92, 0);
            const auto [r, y] = profile[static_cast<std::size_t>(ring)];
            const double out = reach[static_cast<std::size_t>(turn * sides + 0.5)];
            return around(kTurn * turn, 0) * (std::max(out, 0.2) * r * wide) +
                   Vec3d(0, top * y * (y > 0 ? draws.between(0.85, 1.15) : 1.0), 0);
        },
        [&](int ring) {
            const bool last = ring + 1 == static_cast<int>(profile.size());
            return std::array<double, 2>{last ? level.low : level.high,
                                         draws.between(-0.5, 0.5) + level.tone};
        });
}

/// A stalk with a capsule.
void stalk(Gardener& g, Draws d, Vec3d foot, const Habit& habit, int lod)
{
    const Vec3d lean = around(d.between(0, kTurn), 0) * d.between(0, 0.12);
    const Vec3d top = foot + lean + Vec3d(0, d.between(habit.stalk_low, habit.stalk_high), 0);
    const Vec3d nod = normalized(around(d.between(0, kTurn), 0) * (1 - 0.7 * std::abs(habit.nod)) -
                                 Vec3d(0, habit.nod, 0));
    if (lod == 0)
        g.stem(foot, top, 0.006, 0.004, 2, 2, -0.5);
    else
        g.blade(top, normalized(foot - top), length(foot - top), 0.014, 2, 2, -0.5);
    g.spindle(top, top + nod * habit.capsule, 0.021, 0.6, lod == 0 ? 6 : 3, 2, 2, 0.5);
}

template <class Kind>
struct Grown {
    Kind kind;
    Habit habit;

    std::vector<Shoot> shoots(std::uint64_t key, double share) const
    {
        std::vector<Shoot> list;
        for (int i = 0; i < kind.count; ++i) {
            Shoot s = kind.shoot(key, i);
            if (s.rank < share) list.push_back(std::move(s));
        }
        return list;
    }
    TuftShape body(std::uint64_t key, int lod, double share) const
    {
        Gardener g(habit.flat);
        const auto grown = shoots(key, lod == 1 ? share * Kind::kMiddle : share);
        if (lod == 2) {
            far(g, grown, Draws{hash2(key, 3)}, std::is_same_v<Kind, Stars>,
                std::is_same_v<Kind, Mat>, share, habit.far);
            return std::move(g.shape);
        }
        g.core(Draws{hash2(key, 3)}, habit.core * (0.6 + 0.4 * share),
               habit.core_top * (0.5 + 0.5 * share), lod == 0 ? 12 : 6, lod == 0 ? 0.03 : 0.25);
        for (const Shoot& s : grown) lod == 0 ? kind.near(g, s) : kind.middle(g, s, habit.middle);
        return std::move(g.shape);
    }
    TuftShape capsules(std::uint64_t key, int model, int lod, double share) const
    {
        Gardener g(habit.flat);
        const auto grown = shoots(key, share);
        const int count = std::max(1, habit.stalks * (model + 1) / kTuftModels);
        for (int i = 0; i < count; ++i) {
            Draws d{hash2(hash2(key, 4), static_cast<std::uint64_t>(i))};
            // From among the inner shoots; those of cushions and mats are numbered outwards.
            const auto inner = static_cast<double>(grown.size()) * 0.6;
            const Shoot& s = grown[static_cast<std::size_t>(inner * (i + d.random()) / count)];
            const Vec3d foot = std::is_same_v<Kind, Stars> ? s.path.back() : s.path.front();
            stalk(g, d, foot, habit, lod);
        }
        return std::move(g.shape);
    }
};

// The levels' numbers make fields of plants as bright and as green as in full detail, within a few
// per cent, from low, middle and high views: tests/apps/tufts_test.cpp.
constexpr Habit kHypnum{.flat = 0.6,
                        .core = 0.44,
                        .core_top = 0.065,
                        .stalks = 4,
                        .stalk_low = 0.20,
                        .stalk_high = 0.30,
                        .nod = 0.2,
                        .capsule = 0.08,
                        .middle = {.wide = 1, .low = 0.35, .high = 0.85, .tone = -1},
                        .far = {.wide = 0.88, .low = 0.2, .high = 0.61, .tone = -2.5}};
constexpr Habit kPolytrichum{.flat = 0.8,
                             .core = 0.32,
                             .core_top = 0.10,
                             .stalks = 5,
                             .stalk_low = 0.30,
                             .stalk_high = 0.36,
                             .nod = -0.6,
                             .capsule = 0.10,
                             .middle = {.wide = 1.06, .low = 0.38, .high = 0.78, .tone = 0.25},
                             .far = {.wide = 0.97, .low = 0.47, .high = 0.58, .tone = -1.85}};
constexpr Habit kGrimmia{.flat = 0.1,
                         .core = 0.36,
                         .core_top = 0.31,
                         .stalks = 6,
                         .stalk_low = 0.34,
                         .stalk_high = 0.44,
                         .nod = 0.3,
                         .capsule = 0.08,
                         .middle = {.wide = 0.95, .low = 0.66, .high = 0.96, .tone = -0.15},
                         .far = {.wide = 0.86, .low = 0.95, .high = 0.56, .tone = -2.05}};
constexpr Habit kBryum{.flat = 0.1,
                       .core = 0.36,
                       .core_top = 0.25,
                       .stalks = 6,
                       .stalk_low = 0.34,
                       .stalk_high = 0.50,
                       .nod = 0.8,
                       .capsule = 0.10,
                       .middle = {.wide = 0.95, .low = 0.60, .high = 0.80, .tone = -0.15},
                       .far = {.wide = 0.86, .low = 0.98, .high = 0.55, .tone = -2.4}};

/// Calls f with the species' kind.
template <class F>
TuftShape grow(const std::string& species, const F& f)
{
    if (species == "hypnum") return f(Grown<Mat>{{25}, kHypnum});
    if (species == "polytrichum") return f(Grown<Stars>{{24}, kPolytrichum});
    if (species == "grimmia") return f(Grown<Cushion>{{80, 0.40, 0.050, true}, kGrimmia});
    return f(Grown<Cushion>{{90, 0.32, 0.058, false}, kBryum});
}

std::string ply(const TuftShape& shape)
{
    TriMesh mesh;
    mesh.vertices = shape.vertices;
    mesh.triangles = shape.triangles;
    mesh.vertex_attributes["normal"] = shape.normals;
    mesh.vertex_attributes["height"] = shape.height;
    mesh.vertex_attributes["tone"] = shape.tone;
    std::string bytes = encode_mesh(mesh, ".ply");
    const std::string world = "metres, z up";
    bytes.replace(bytes.find(world), world.size(), "plant diameters, +y along the plant");
    return bytes;
}

std::uint64_t key_of(const std::string& species, int model)
{
    return hash2(hash2(Stream("render.tuft").id, Stream(species).id),
                 static_cast<std::uint64_t>(model));
}

}  // namespace

TuftShape tuft_shape(const std::string& species, const TuftModel& which)
{
    return grow(species, [&](const auto& grown) {
        return grown.body(key_of(species, which.model), which.lod,
                          kDensity[static_cast<std::size_t>(which.density)]);
    });
}

TuftShape tuft_capsules(const std::string& species, const TuftModel& which)
{
    return grow(species, [&](const auto& grown) {
        return grown.capsules(key_of(species, which.model), which.model, which.lod,
                              kDensity[static_cast<std::size_t>(which.density)]);
    });
}

int tuft_density(float growth)
{
    return growth < 0.7f ? 0 : growth < 1.4f ? 1 : 2;
}

int tuft_lod(double pixels)
{
    return pixels >= 10 ? 0 : pixels >= 3 ? 1 : 2;
}

std::vector<TuftFile> tuft_files(const std::vector<std::string>& species, float growth)
{
    std::vector<TuftFile> files;
    for (const std::string& name : species)
        for (TuftModel which{0, 0, tuft_density(growth)}; which.model < kTuftModels; ++which.model)
            for (which.lod = 0; which.lod < kTuftLods; ++which.lod) {
                files.push_back({fmt::format("{}_{}_lod{}.ply", name, which.model, which.lod),
                                 ply(tuft_shape(name, which))});
                if (growth >= kRipe)
                    files.push_back(
                        {fmt::format("{}_{}_capsules_lod{}.ply", name, which.model, which.lod),
                         ply(tuft_capsules(name, which))});
            }
    return files;
}

}  // namespace sekitei::render
