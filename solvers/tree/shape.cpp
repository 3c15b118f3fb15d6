#include "solvers/tree/shape.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/error.h"
#include "core/math.h"
#include "core/point_search.h"

namespace sekitei::tree {
namespace {

double across(Vec3d p)
{
    return std::sqrt(p.x * p.x + p.y * p.y);
}

double mean_of(std::span<const double> values)
{
    double sum = 0;
    for (const double v : values) sum += v;
    return sum / static_cast<double>(values.size());
}

/// St.dev. / mean, of all there is (not of a sample).
double variation(std::span<const double> values)
{
    const double mean = mean_of(values);
    double squares = 0;
    for (const double v : values) squares += (v - mean) * (v - mean);
    return mean > 0 ? std::sqrt(squares / static_cast<double>(values.size())) / mean : 0;
}

std::vector<std::uint32_t> tips_of(const Grove& grove, int tree)
{
    std::vector<std::uint32_t> tips;
    for (const std::uint32_t tip : grove.tip_list())
        if (tree < 0 || grove.branches().tree[tip] == tree) tips.push_back(tip);
    return tips;
}

/// Of the tree, or the mean of those that have tips.
Vec3d origin_of(const Grove& grove, int tree)
{
    std::vector<bool> has_tips(grove.plants().size());
    for (const std::uint32_t tip : tips_of(grove, tree))
        has_tips[static_cast<std::size_t>(grove.branches().tree[tip])] = true;
    Vec3d sum;
    double count = 0;
    for (std::size_t i = 0; i < has_tips.size(); ++i)
        if (has_tips[i]) sum += grove.plants()[i].origin, ++count;
    return count > 0 ? sum / count : Vec3d{};
}

std::vector<Vec3d> ends_about(const Grove& grove, int tree, Vec3d origin)
{
    std::vector<Vec3d> ends;
    for (const std::uint32_t tip : tips_of(grove, tree))
        ends.push_back(grove.branches().end(tip) - origin);
    return ends;
}

/// Share of tips with a branch that points down among those that carry them.
double weeping_of(const Grove& grove, std::span<const std::uint32_t> tips)
{
    const Branches& b = grove.branches();
    std::vector<bool> weeps(b.size());
    for (std::size_t i = 0; i < b.size(); ++i)
        weeps[i] = b.direction[i].z < 0 ||
                   (b.parent[i] >= 0 && weeps[static_cast<std::size_t>(b.parent[i])]);
    const auto count = std::ranges::count_if(tips, [&](std::uint32_t tip) { return weeps[tip]; });
    return static_cast<double>(count) / static_cast<double>(tips.size());
}

// The hull works on a lattice. Coordinates have 41 bits, so determinants of their differences have
// 123 and six times the volume has no more.
using Whole = Vec3<std::int64_t>;
__extension__ using Wide = __int128;
constexpr int kLatticeBits = 40;

Vec3<Wide> wide_cross(Whole a, Whole b)
{
    return cross(Vec3<Wide>(a), Vec3<Wide>(b));
}

/// Six times the volume of the tetrahedron; positive where p sees a, b, c counter-clockwise.
Wide six_volumes(Whole a, Whole b, Whole c, Whole p)
{
    return dot(wide_cross(b - a, c - a), Vec3<Wide>(p - a));
}

double wide_length(Vec3<Wide> v)
{
    return length(Vec3d(v));
}

/// A triangle of the hull, counter-clockwise from outside.
struct Facet {
    std::array<std::uint32_t, 3> corner{}, beyond{};  ///< beyond[k]: across corner k to k + 1
    std::vector<std::uint32_t> outside;               ///< points above it, each in one facet only
    bool gone = false;
};

class QuickHull {
public:
    explicit QuickHull(std::vector<Whole> points) : at_(std::move(points))
    {
        if (!begin()) return;
        for (std::uint32_t f = 0; f < facets_.size(); ++f)
            while (!facets_[f].gone && !facets_[f].outside.empty()) add_farthest(f);
    }

    double volume() const  ///< [cells]
    {
        Wide sum = 0;
        for (const Facet& f : facets_)
            if (!f.gone) sum += six_volumes(at(f, 0), at(f, 1), at(f, 2), at_[first_]);
        return static_cast<double>(-sum) / 6;
    }
    double area() const
    {
        double sum = 0;
        for (const Facet& f : facets_)
            if (!f.gone)
                sum += wide_length(wide_cross(at(f, 1) - at(f, 0), at(f, 2) - at(f, 0))) / 2;
        return sum;
    }

private:
    Whole at(const Facet& f, std::size_t corner) const { return at_[f.corner[corner]]; }
    Wide above(const Facet& f, std::uint32_t p) const
    {
        return six_volumes(at(f, 0), at(f, 1), at(f, 2), at_[p]);
    }
    /// The point with the largest measure, the first of equal ones.
    template <class Measure>
    std::uint32_t farthest(Measure&& measure) const
    {
        std::uint32_t best = 0;
        for (std::uint32_t p = 1; p < at_.size(); ++p)
            if (measure(p) > measure(best)) best = p;
        return best;
    }

    /// A tetrahedron; false where all points lie in a plane.
    bool begin()
    {
        const auto size = [](Wide v) { return v < 0 ? -v : v; };
        const auto a = static_cast<std::uint32_t>(std::ranges::min_element(at_) - at_.begin());
        const std::uint32_t b =
            farthest([&](std::uint32_t p) { return wide_length(Vec3<Wide>(at_[p] - at_[a])); });
        const std::uint32_t c = farthest([&](std::uint32_t p) {
            return wide_length(wide_cross(at_[b] - at_[a], at_[p] - at_[a]));
        });
        const std::uint32_t d = farthest(
            [&](std::uint32_t p) { return size(six_volumes(at_[a], at_[b], at_[c], at_[p])); });
        const Wide volume = six_volumes(at_[a], at_[b], at_[c], at_[d]);
        if (volume == 0) return false;

        first_ = a;
        const std::array<std::uint32_t, 4> t =
            volume < 0 ? std::array{a, b, c, d} : std::array{a, c, b, d};
        facets_.resize(4);
        facets_[0] = {{t[0], t[1], t[2]}, {1, 2, 3}, {}, false};
        facets_[1] = {{t[1], t[0], t[3]}, {0, 3, 2}, {}, false};
        facets_[2] = {{t[2], t[1], t[3]}, {0, 1, 3}, {}, false};
        facets_[3] = {{t[0], t[2], t[3]}, {0, 2, 1}, {}, false};
        for (std::uint32_t p = 0; p < at_.size(); ++p) assign(p, 0);
        return true;
    }

    /// Puts a point on the first facet from `from` on that it is above; none: it is inside.
    void assign(std::uint32_t p, std::size_t from)
    {
        for (std::size_t f = from; f < facets_.size(); ++f)
            if (above(facets_[f], p) > 0) return facets_[f].outside.push_back(p);
    }

    /// Replaces what the farthest point above a facet sees by a cone to that point.
    void add_farthest(std::uint32_t facet)
    {
        const Facet& under = facets_[facet];
        std::uint32_t apex = under.outside.front();
        for (const std::uint32_t p : under.outside)
            if (above(under, p) > above(under, apex)) apex = p;

        // Facets in whose plane the apex lies go, too: then no new one can be without area.
        horizon_.clear();
        std::vector<std::uint32_t> seen{facet};
        facets_[facet].gone = true;
        for (std::size_t i = 0; i < seen.size(); ++i)
            for (std::size_t k = 0; k < 3; ++k) {
                const std::uint32_t g = facets_[seen[i]].beyond[k];
                if (facets_[g].gone) continue;
                if (above(facets_[g], apex) >= 0) {
                    facets_[g].gone = true;
                    seen.push_back(g);
                }
            }
        for (const std::uint32_t f : seen)
            for (std::size_t k = 0; k < 3; ++k)
                if (const std::uint32_t g = facets_[f].beyond[k]; !facets_[g].gone)
                    horizon_.push_back({facets_[f].corner[k], facets_[f].corner[(k + 1) % 3], g});

        // The horizon is one loop: each of its edges starts where another ends.
        const auto first = static_cast<std::uint32_t>(facets_.size());
        std::ranges::sort(horizon_, {}, &Edge::from);
        for (const Edge& e : horizon_) {
            const auto next = std::ranges::lower_bound(horizon_, e.to, {}, &Edge::from);
            const auto self = static_cast<std::uint32_t>(facets_.size());
            Facet cone{{e.from, e.to, apex},
                       {e.beyond, first + static_cast<std::uint32_t>(next - horizon_.begin()), 0},
                       {},
                       false};
            Facet& behind = facets_[e.beyond];
            for (std::size_t k = 0; k < 3; ++k)
                if (behind.corner[k] == e.to && behind.corner[(k + 1) % 3] == e.from)
                    behind.beyond[k] = self;
            facets_.push_back(std::move(cone));
        }
        for (std::uint32_t f = first; f < facets_.size(); ++f)
            facets_[facets_[f].beyond[1]].beyond[2] = f;

        // What is above a facet that went and outside the new hull is above the cone.
        for (const std::uint32_t f : seen) {
            const std::vector<std::uint32_t> points = std::exchange(facets_[f].outside, {});
            for (const std::uint32_t p : points)
                if (p != apex) assign(p, first);
        }
    }

    struct Edge {
        std::uint32_t from, to, beyond;
    };
    std::vector<Whole> at_;
    std::vector<Facet> facets_;
    std::vector<Edge> horizon_;
    std::uint32_t first_ = 0;
};

}  // namespace

Shape shape_of(const Grove& grove, int tree)
{
    const std::vector<std::uint32_t> tips = tips_of(grove, tree);
    const std::vector<Vec3d> ends = ends_about(grove, tree, origin_of(grove, tree));
    const double from_ground = origin_of(grove, tree).z;
    Shape shape;
    if (tips.empty()) return shape;

    const auto n = static_cast<double>(tips.size());
    Bounds box;
    double squares = 0;
    std::size_t upward = 0;
    for (std::size_t i = 0; i < tips.size(); ++i) {
        box.add(ends[i]);
        squares += ends[i].x * ends[i].x + ends[i].y * ends[i].y;
        shape.radius_max = std::max(shape.radius_max, across(ends[i]));
        shape.mean_height += (ends[i].z + from_ground) / n;
        shape.mean_light += grove.branches().light[tips[i]] / n;
        upward += grove.branches().direction[tips[i]].z > 0;
    }
    shape.tips = tips.size();
    shape.upward = static_cast<double>(upward) / n;
    shape.weeping = weeping_of(grove, tips);
    shape.radius_rms = std::sqrt(squares / n);
    shape.lowest = box.lower.z + from_ground;
    shape.highest = box.upper.z + from_ground;
    shape.width = std::max(box.size().x, box.size().y);
    shape.lean = lean_of(ends);
    const Spacing spacing = spacing_of(ends);
    shape.spacing_cv = spacing.cv;
    shape.spacing_gap = spacing.gap;
    shape.hole_cv = hole_cv_of(ends, shape.radius_max);
    shape.sphericity = convex_hull(ends).sphericity();
    return shape;
}

std::vector<Vec3d> tip_ends(const Grove& grove, int tree)
{
    return ends_about(grove, tree, {});
}

double profile_r2(const Grove& grove, double share)
{
    return profile_r2(ends_about(grove, -1, origin_of(grove, -1)), share);
}

double profile_r2(std::span<const Vec3d> points, double share)
{
    double apex = 0;
    for (const Vec3d p : points) apex = std::max(apex, p.z);
    std::vector<double> widest(static_cast<std::size_t>(share * apex) + 1, -1.0);
    for (const Vec3d p : points)
        if (const double depth = apex - p.z; depth <= share * apex) {
            double& r = widest[static_cast<std::size_t>(depth)];
            r = std::max(r, across(p));
        }

    std::vector<double> x, y;
    for (std::size_t i = 0; i < widest.size(); ++i)
        if (widest[i] >= 0) x.push_back(static_cast<double>(i)), y.push_back(widest[i]);
    if (x.size() < 3) return 0;
    const double mean_x = mean_of(x), mean_y = mean_of(y);
    double xx = 0, xy = 0, yy = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
        xx += (x[i] - mean_x) * (x[i] - mean_x);
        xy += (x[i] - mean_x) * (y[i] - mean_y);
        yy += (y[i] - mean_y) * (y[i] - mean_y);
    }
    return yy > 0 ? xy * xy / (xx * yy) : 0;
}

Vec3d lean_of(std::span<const Vec3d> points)
{
    Vec3d sum;
    double squares = 0;
    for (const Vec3d p : points) {
        sum += {p.x, p.y, 0};
        squares += p.x * p.x + p.y * p.y;
    }
    const auto n = static_cast<double>(points.size());
    return squares > 0 ? sum / n / std::sqrt(squares / n) : Vec3d{};
}

Spacing spacing_of(std::span<const Vec3d> points)
{
    if (points.size() < 2) return {};
    Bounds box;
    for (const Vec3d p : points) box.add(p);
    std::vector<Vec3f> near(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) near[i] = Vec3f(points[i] - box.centre());
    const KdTree tree(near);
    std::vector<double> distance(points.size());
    for (std::size_t i = 0; i < points.size(); ++i)  // the nearest is the point itself
        distance[i] = tree.distance_to_nearest(near[i], 2, std::numeric_limits<float>::max());
    const double mean = mean_of(distance);
    return {mean, variation(distance), mean > 0 ? std::ranges::max(distance) / mean : 0};
}

double hole_cv_of(std::span<const Vec3d> points, double radius)
{
    std::array<double, 36> counts{};
    for (const Vec3d p : points) {
        const double inner = radius > 0 ? (p.x * p.x + p.y * p.y) / (radius * radius) : 0;
        const double turn = math::atan2(p.y, p.x) / (2 * math::kPi);
        const int ring = std::min(static_cast<int>(6 * std::min(inner, 1.0)), 5);
        const int sector = std::min(static_cast<int>(6 * (turn < 0 ? turn + 1 : turn)), 5);
        ++counts[static_cast<std::size_t>(6 * ring + sector)];
    }
    return variation(counts);
}

double Hull::sphericity() const
{
    return area > 0 ? math::pow(math::kPi, 1.0 / 3) * math::pow(6 * volume, 2.0 / 3) / area : 0;
}

Hull convex_hull(std::span<const Vec3d> points)
{
    Bounds box;
    for (const Vec3d p : points) {
        if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z))
            throw InvalidInput(
                fmt::format("tree: point of a hull = ({}, {}, {}), must be finite", p.x, p.y, p.z));
        box.add(p);
    }
    const double extent = std::max({box.size().x, box.size().y, box.size().z});
    if (points.size() < 4 || !(extent > 0)) return {};

    // A power of two, so that coordinates that are short binary fractions stay what they are.
    const double cell = std::ldexp(1.0, std::ilogb(extent) + 1 - kLatticeBits);
    std::vector<Whole> lattice;
    lattice.reserve(points.size());
    for (const Vec3d p : points) {
        const Vec3d q = (p - box.lower) / cell;
        lattice.emplace_back(std::llround(q.x), std::llround(q.y), std::llround(q.z));
    }
    const QuickHull hull(std::move(lattice));
    return {hull.volume() * cell * cell * cell, hull.area() * cell * cell};
}

}  // namespace sekitei::tree
