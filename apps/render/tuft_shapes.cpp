#include <algorithm>
#include <cmath>

#include "apps/render/fast_math.h"
#include "apps/render/tufts.h"
#include "core/math.h"
#include "core/random.h"

namespace sekitei::render {
namespace {

constexpr double kGolden = 2.39996322972865;  // angle between leaves and between shoots [rad]

/// Makes one plant. Lengths are in diameters of a full-grown one.
class Gardener {
public:
    /// @param flat  how much the plant's surface as a whole looks up instead of outwards
    Gardener(std::uint64_t key, double flat) : key_(key), flat_(flat) {}

    double random() { return uniform_of_key(key_, draw_++); }
    double between(double low, double high) { return low + (high - low) * random(); }

    std::uint32_t vertex(Vec3d p, double height, double tone)
    {
        shape.vertices.push_back(Vec3f(p));
        shape.normals.push_back(Vec3f(normalized(p + Vec3d(0, flat_, 0))));
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
    }

    /// A stem of three sides that becomes thinner.
    void stem(Vec3d foot, Vec3d top, double radius, double radius_top, double low, double high,
              double tone)
    {
        const Vec3d along = normalized(top - foot);
        const Vec3d x =
            normalized(cross(along, std::abs(along.y) < 0.9 ? Vec3d(0, 1, 0) : Vec3d(1, 0, 0)));
        const Vec3d y = cross(along, x);
        std::array<std::uint32_t, 6> ring{};
        for (std::size_t k = 0; k < 3; ++k) {
            const double a = 2 * math::kPi * static_cast<double>(k) / 3;
            const Vec3d out = x * math::cos(a) + y * math::sin(a);
            ring[k] = vertex(foot + out * radius, low, tone);
            ring[k + 3] = vertex(top + out * radius_top, high, tone);
        }
        for (std::size_t k = 0; k < 3; ++k) {
            const std::size_t next = (k + 1) % 3;
            shape.triangles.push_back({ring[k], ring[next], ring[k + 3]});
            shape.triangles.push_back({ring[next], ring[next + 3], ring[k + 3]});
        }
    }

    /// The dark inside of a cushion, so that no stone shows between the shoots. It narrows towards
    /// its foot, below the surface.
    void core(double radius, double top)
    {
        constexpr std::array<std::array<double, 2>, 5> kProfile{
            {{0.50, 0.88}, {0.88, 0.48}, {1.0, 0.05}, {0.80, -0.9}, {0.45, -1.6}}};
        constexpr int kAround = 12;
        const std::uint32_t first = vertex(Vec3d(0, top, 0), 0.05, 0);
        for (const auto& [wide, high] : kProfile)
            for (int i = 0; i < kAround; ++i) {
                const double a = 2 * math::kPi * i / kAround;
                const double r = radius * wide * between(0.90, 1.06);
                vertex(Vec3d(r * math::cos(a),
                             std::min(top, 0.16) * std::min(high, 0.0) + top * std::max(high, 0.0),
                             r * math::sin(a)),
                       0.03, 0);
            }
        auto at = [&](int ring, int i) {
            return first + 1 + static_cast<std::uint32_t>(ring * kAround + i % kAround);
        };
        for (int i = 0; i < kAround; ++i) {
            shape.triangles.push_back({first, at(0, i + 1), at(0, i)});
            for (int j = 0; j + 1 < static_cast<int>(kProfile.size()); ++j) {
                shape.triangles.push_back({at(j, i), at(j, i + 1), at(j + 1, i)});
                shape.triangles.push_back({at(j, i + 1), at(j + 1, i + 1), at(j + 1, i)});
            }
        }
    }

    /// A stalk with a capsule that nods.
    void capsule(Vec3d foot, double height)
    {
        const Vec3d top = foot + Vec3d(between(-0.12, 0.12), height, between(-0.12, 0.12));
        stem(foot, top, 0.005, 0.004, 2, 2, -0.5);
        const double a = between(0, 2 * math::kPi);
        const Vec3d nod = normalized(Vec3d(math::cos(a), -0.3, math::sin(a)));
        stem(top, top + nod * 0.05, 0.007, 0.021, 2, 2, 0.3);
        stem(top + nod * 0.05, top + nod * 0.10, 0.021, 0.004, 2, 2, 0.6);
    }

    TuftShape shape;

private:
    std::uint64_t key_, draw_ = 0;
    double flat_;
};

Vec3d around(double angle, double y)
{
    return {math::cos(angle), y, math::sin(angle)};
}

/// Short shoots, closely packed over a dome with an uneven rim.
/// @param hair  the leaves at the tips end in long points
TuftShape cushion(Gardener& g, int shoots, double dome, double leaf_length, bool hair,
                  bool capsules)
{
    g.core(0.36, dome * 0.78);
    const double phase = g.between(0, 6.28), phase2 = g.between(0, 6.28);
    for (int i = 0; i < shoots; ++i) {
        // Evenly over the dome, and a little beyond its rim.
        const double a = i * kGolden + g.between(-0.2, 0.2);
        const double cosine = 1 - 1.12 * (i + 0.5) / shoots;
        const double sine = std::sqrt(1 - cosine * cosine);
        const double rim = 1 + 0.13 * math::sin(2 * a + phase) + 0.10 * math::sin(5 * a + phase2);
        const Vec3d out = around(a, 0) * sine;
        const Vec3d foot = out * (0.33 * rim) + Vec3d(0, dome * 0.72 * cosine, 0);
        const Vec3d along = normalized(out + Vec3d(0, 0.25 + 0.9 * cosine, 0) +
                                       around(g.between(0, 6.28), g.between(-0.5, 0.5)) * 0.22);
        const double shoot = (0.17 + 0.10 * dome) * g.between(0.8, 1.15);
        const double tone = g.between(-1, 1), start = g.between(0, 6.28);
        constexpr int kLeaves = 11;
        const Vec3d x = normalized(cross(along, Vec3d(0.3, 0.5, 0.8))), y = cross(along, x);
        for (int k = 0; k < kLeaves; ++k) {
            const double h = static_cast<double>(k) / (kLeaves - 1), turn = start + k * kGolden;
            const Vec3d spread = x * math::cos(turn) + y * math::sin(turn);
            // Leaves close up towards the tip.
            g.blade(foot + along * (shoot * h),
                    normalized(along * (0.5 + 0.9 * h) + spread * (0.95 - 0.5 * h)),
                    leaf_length * (1.15 - 0.4 * h), 0.034 * (1.15 - 0.35 * h), 0.15 + 0.45 * h,
                    0.40 + 0.60 * h, tone);
        }
        if (hair)
            for (int k = 0; k < 3; ++k)
                g.blade(foot + along * shoot,
                        normalized(along + around(g.between(0, 6.28), g.between(-0.3, 0.6)) * 0.4),
                        g.between(0.06, 0.11), 0.008, 1.2, 1.3, tone);
    }
    if (capsules)
        for (int i = 0; i < 7; ++i)
            g.capsule(
                around(g.between(0, 6.28), 0) * g.between(0.05, 0.3) + Vec3d(0, dome * 0.6, 0),
                g.between(0.30, 0.5));
    return std::move(g.shape);
}

/// Creeping stems with branches like feathers, over each other.
TuftShape mat(Gardener& g, bool capsules)
{
    g.core(0.44, 0.065);
    // The mat's height over its middle and down to its edge, which lies on the stone.
    auto lie = [](Vec3d p) {
        const double r2 = p.x * p.x + p.z * p.z;
        return 0.12 - 0.35 * r2 - 1.3 * r2 * r2;
    };
    constexpr int kStems = 24;
    for (int i = 0; i < kStems; ++i) {
        const double a = i * kGolden + g.between(-0.4, 0.4);
        Vec3d p = around(a + g.between(-0.9, 0.9), 0) * g.between(0.0, 0.30);
        const double lift = g.between(-0.03, 0.04), tone = g.between(-1, 1);
        double heading = a;
        const double turn = g.between(-0.20, 0.20);
        constexpr int kSteps = 11;
        for (int s = 0; s < kSteps; ++s) {
            const double h = static_cast<double>(s) / kSteps;
            const Vec3d next = p + around(heading, 0) * 0.040;
            p.y = lie(p) + lift;
            const Vec3d along = normalized(Vec3d(next.x, lie(next) + lift, next.z) - p);
            // Branches on both sides, shorter towards the tip, with ends that curl down.
            const double reach = 0.115 * (1.1 - 0.8 * h) * g.between(0.75, 1.25);
            for (const double side : {-1.0, 1.0}) {
                const Vec3d out = normalized(around(heading + side * g.between(0.6, 1.0), 0.38));
                g.leaf(p, out, reach, 0.026, 0.45, 0.30 + 0.25 * h, 0.65 + 0.35 * h, tone);
                g.blade(p + out * (0.4 * reach), normalized(out + along * 0.9), reach * 0.5, 0.018,
                        0.40 + 0.25 * h, 0.70 + 0.30 * h, tone);
            }
            g.blade(p, normalized(along + Vec3d(0, 0.35, 0)), 0.060, 0.026, 0.35 + 0.3 * h,
                    0.70 + 0.30 * h, tone);
            p = next;
            heading += turn;
        }
    }
    if (capsules)
        for (int i = 0; i < 5; ++i)
            g.capsule(around(g.between(0, 6.28), 0) * g.between(0.05, 0.35) + Vec3d(0, 0.10, 0),
                      g.between(0.40, 0.6));
    return std::move(g.shape);
}

/// Tall stems with stiff leaves all around: stars from above.
TuftShape stars(Gardener& g, bool capsules)
{
    g.core(0.36, 0.14);
    constexpr int kPlants = 18;
    for (int i = 0; i < kPlants; ++i) {
        const double r = 0.40 * std::sqrt((i + 0.5) / kPlants), a = i * kGolden;
        const Vec3d foot = around(a, 0) * r;
        const double tall = g.between(0.55, 0.95) * (1 - 0.35 * r);
        const Vec3d lean = normalized(Vec3d(0, 1, 0) + around(a, 0) * (0.5 * r) +
                                      around(g.between(0, 6.28), 0) * 0.12);
        const double tone = g.between(-1, 1);
        g.stem(foot, foot + lean * tall, 0.012, 0.006, 0.05, 0.35, tone);
        constexpr int kLeaves = 26;
        for (int k = 0; k < kLeaves; ++k) {
            const double h = static_cast<double>(k) / (kLeaves - 1);
            const double up = 0.35 + 0.65 * h;
            // Spread wide below, half upright at the tip.
            const Vec3d out = normalized(around(k * kGolden + a, 0.25 + 1.1 * h * h));
            g.leaf(foot + lean * (tall * up), out, 0.19 * (1 - 0.35 * h), 0.024, 0.14 * (1 - h),
                   0.25 + 0.35 * h, 0.55 + 0.45 * h, tone);
        }
        if (capsules && i % 5 == 1) g.capsule(foot + lean * tall, 0.55);
    }
    return std::move(g.shape);
}

}  // namespace

TuftShape tuft_shape(const std::string& species, int variant)
{
    const bool star = species == "polytrichum", flat = species == "hypnum";
    Gardener g(hash2(hash2(Stream("render.tuft").id, Stream(species).id),
                     static_cast<std::uint64_t>(variant)),
               star   ? 0.8
               : flat ? 0.6
                      : 0.1);
    const bool capsules = variant == kTuftVariants - 1;
    if (flat) return mat(g, capsules);
    if (star) return stars(g, capsules);
    if (species == "grimmia") return cushion(g, 80, 0.40, 0.050, true, capsules);
    return cushion(g, 90, 0.32, 0.058, false, capsules);
}

}  // namespace sekitei::render
