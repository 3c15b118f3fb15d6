#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/log.h"
#include "core/parallel.h"
#include "core/random.h"
#include "grids/marching_tetrahedra.h"
#include "solvers/joints/joints.h"

/// Seeds of the columns: where they may lie, how they are thrown, how they even out.
namespace sekitei::joints {
namespace {

constexpr Stream kDart{"joints.dart"};
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Triangle {
    Vec3d a, b, c;

    double area() const { return 0.5 * length(cross(b - a, c - a)); }
    Vec3d centroid() const { return (a + b + c) / 3.0; }
    double longest2() const
    {
        return std::max({dot(b - a, b - a), dot(c - b, c - b), dot(a - c, a - c)});
    }
    /// Four similar triangles by the midpoints of the edges.
    std::array<Triangle, 4> quarters() const
    {
        const Vec3d ab = (a + b) * 0.5, bc = (b + c) * 0.5, ca = (c + a) * 0.5;
        return {Triangle{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}};
    }
};

Triangle triangle_of(const TriMesh& mesh, std::size_t t)
{
    const auto& v = mesh.triangles[t];
    return {Vec3d(mesh.vertices[v[0]]), Vec3d(mesh.vertices[v[1]]), Vec3d(mesh.vertices[v[2]])};
}

/// The point of a triangle nearest to p [Ericson2005, 5.1.5].
Vec3d closest_on(const Triangle& t, Vec3d p)
{
    const Vec3d ab = t.b - t.a, ac = t.c - t.a, ap = p - t.a;
    const double d1 = dot(ab, ap), d2 = dot(ac, ap);
    if (d1 <= 0 && d2 <= 0) return t.a;
    const Vec3d bp = p - t.b;
    const double d3 = dot(ab, bp), d4 = dot(ac, bp);
    if (d3 >= 0 && d4 <= d3) return t.b;
    const double vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) return t.a + ab * (d1 / (d1 - d3));
    const Vec3d cp = p - t.c;
    const double d5 = dot(ab, cp), d6 = dot(ac, cp);
    if (d6 >= 0 && d5 <= d6) return t.c;
    const double vb = d5 * d2 - d1 * d6;
    if (vb <= 0 && d2 >= 0 && d6 <= 0) return t.a + ac * (d2 / (d2 - d6));
    const double va = d3 * d6 - d5 * d4;
    if (va <= 0 && d4 >= d3 && d5 >= d6)
        return t.b + (t.c - t.b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    const double sum = va + vb + vc;
    if (!(sum > 0)) return t.a;  // a needle whose edges say nothing
    return t.a + ab * (vb / sum) + ac * (vc / sum);
}

/// Points in cubic cells, for "who is within r" and "who is nearest". Grows by insertion.
class PointCells {
public:
    PointCells(const Bounds& bounds, double cell) : lower_(bounds.lower)
    {
        // No more than 2^22 cells, however small the radius: cells only save time.
        const Vec3d size = bounds.size();
        for (cell_ = cell;; cell_ *= 1.25) {
            double cells = 1;
            for (int axis = 0; axis < 3; ++axis) cells *= std::floor(size[axis] / cell_) + 1;
            if (cells <= 4194304.0) break;
        }
        for (int axis = 0; axis < 3; ++axis)
            dims_[axis] = static_cast<int>(std::floor(size[axis] / cell_)) + 1;
        heads_.assign(std::size_t(dims_.x) * std::size_t(dims_.y) * std::size_t(dims_.z), kNone);
    }

    void insert(Vec3d p)
    {
        std::uint32_t& head = heads_[index(cell_of(p))];
        next_.push_back(head);
        head = static_cast<std::uint32_t>(points_.size());
        points_.push_back(p);
    }
    const std::vector<Vec3d>& points() const { return points_; }

    /// Calls visit(point) for the points nearer than r; stops and says true once visit does.
    template <class Visit>
    bool any_within(Vec3d p, double r, Visit&& visit) const
    {
        const Coord low = cell_of(p - Vec3d(r)), high = cell_of(p + Vec3d(r));
        for (int x = low.x; x <= high.x; ++x)
            for (int y = low.y; y <= high.y; ++y)
                for (int z = low.z; z <= high.z; ++z)
                    for (std::uint32_t i = heads_[index({x, y, z})]; i != kNone; i = next_[i]) {
                        const Vec3d d = points_[i] - p;
                        if (dot(d, d) < r * r && visit(points_[i])) return true;
                    }
        return false;
    }

    /// The nearest point, the lower index on a tie; cells are searched in growing shells.
    std::uint32_t nearest(Vec3d p) const
    {
        const Coord home = cell_of(p);
        const int last = std::max({dims_.x, dims_.y, dims_.z});
        std::uint32_t best = kNone;
        double least2 = kInfinity;
        for (int shell = 0; shell <= last; ++shell) {
            const Coord low = max(home - Coord(shell, shell, shell), Coord(0, 0, 0));
            const Coord high = min(home + Coord(shell, shell, shell), dims_ - Coord(1, 1, 1));
            for (int x = low.x; x <= high.x; ++x)
                for (int y = low.y; y <= high.y; ++y) {
                    const bool face =
                        std::abs(x - home.x) == shell || std::abs(y - home.y) == shell;
                    for (int z = low.z; z <= high.z; ++z) {
                        if (!face && std::abs(z - home.z) != shell) {
                            z = std::max(z, std::min(home.z + shell, high.z + 1) - 1);
                            continue;
                        }
                        for (std::uint32_t i = heads_[index({x, y, z})]; i != kNone; i = next_[i]) {
                            const Vec3d d = points_[i] - p;
                            const double d2 = dot(d, d);
                            if (d2 < least2 || (d2 == least2 && i < best)) {
                                least2 = d2;
                                best = i;
                            }
                        }
                    }
                }
            // All points of the shells beyond are at least shell * cell away.
            const double reached = shell * cell_ * (1 - 1e-12);
            if (best != kNone && least2 < reached * reached) break;
        }
        return best;
    }

private:
    static constexpr std::uint32_t kNone = 0xFFFFFFFFu;

    Coord cell_of(Vec3d p) const
    {
        Coord c;
        for (int axis = 0; axis < 3; ++axis)
            c[axis] = static_cast<int>(
                std::clamp(std::floor((p[axis] - lower_[axis]) / cell_), 0.0, dims_[axis] - 1.0));
        return c;
    }
    std::size_t index(Coord c) const
    {
        return (std::size_t(c.x) * std::size_t(dims_.y) + std::size_t(c.y)) * std::size_t(dims_.z) +
               std::size_t(c.z);
    }

    Vec3d lower_;
    double cell_;
    Coord dims_;
    std::vector<std::uint32_t> heads_, next_;
    std::vector<Vec3d> points_;
};

Bounds bounds_of(const TriMesh& mesh)
{
    Bounds bounds;
    for (const Vec3f& v : mesh.vertices) bounds.add(Vec3d(v));
    return bounds;
}

/// Between two looks at the wish to stop: a few milliseconds of work.
constexpr std::uint64_t kDartsPerCheck = 4096;

/// A dart that stuck: where, and in which triangle of the surface.
struct Dart {
    Vec3d at;
    std::size_t triangle;
};

/// See poisson_disk().
std::vector<Dart> throw_darts(const TriMesh& surface, std::size_t count, double radius,
                              std::uint64_t seed, const Progress& progress)
{
    const Bounds bounds = bounds_of(surface);
    std::vector<Dart> stuck;
    if (surface.triangles.empty()) return stuck;
    PointCells cells(bounds, radius);

    // The first round aims at the whole surface, later ones at the fragments that are left.
    struct Fragment {
        Triangle shape;
        std::size_t triangle;
    };
    std::vector<Fragment> fragments;
    std::vector<double> area_up_to(surface.triangles.size());
    double area = 0;
    for (std::size_t t = 0; t < surface.triangles.size(); ++t)
        area_up_to[t] = area += triangle_of(surface, t).area();
    if (!(area > 0)) return stuck;
    const double disks = area / (radius * radius);

    auto covered = [&](const Triangle& t) {
        auto near = [&](Vec3d p, Vec3d q) { return dot(p - q, p - q) < radius * radius; };
        return cells.any_within(t.a, radius, [&](Vec3d s) { return near(s, t.b) && near(s, t.c); });
    };
    std::vector<Fragment> left;
    // Splits a fragment until it is no longer than `longest` and keeps what no single disk covers.
    auto keep = [&](auto&& self, const Triangle& shape, std::size_t triangle,
                    double longest2) -> void {
        if (covered(shape)) return;
        if (shape.longest2() <= longest2) {
            left.push_back({shape, triangle});
            return;
        }
        for (const Triangle& quarter : shape.quarters()) self(self, quarter, triangle, longest2);
    };

    const std::uint64_t most_tries =
        count > 0 ? 1000 * std::uint64_t(count) : std::numeric_limits<std::uint64_t>::max();
    const double smallest = 5e-4 * radius;
    double longest = radius / 2;
    std::uint64_t tries = 0;
    for (bool whole = true; area > 0; whole = false) {
        const double aims = 6 * area / (radius * radius) +
                            (whole ? 0.0 : std::min(double(fragments.size()), disks));
        const auto darts = static_cast<std::uint64_t>(std::max(64.0, aims));
        for (std::uint64_t k = 0; k < darts && tries < most_tries; ++k, ++tries) {
            if (tries % kDartsPerCheck == 0) progress.check();
            const double u = uniform01(seed, kDart, tries, 0) * area;
            const auto found = std::upper_bound(area_up_to.begin(), area_up_to.end(), u);
            const auto i = static_cast<std::size_t>(std::min(found, area_up_to.end() - 1) -
                                                    area_up_to.begin());
            const Triangle t = whole ? triangle_of(surface, i) : fragments[i].shape;
            const double s = std::sqrt(uniform01(seed, kDart, tries, 1));
            const double v = uniform01(seed, kDart, tries, 2);
            const Vec3d p = t.a * (1 - s) + t.b * (s * (1 - v)) + t.c * (s * v);
            if (cells.any_within(p, radius, [](Vec3d) { return true; })) continue;
            cells.insert(p);
            stuck.push_back({p, whole ? i : fragments[i].triangle});
            if (stuck.size() == count) return stuck;
        }
        if (tries >= most_tries) return stuck;

        // Narrow the aim to what is free or at the rim of several disks.
        left.clear();
        std::size_t kept = 0;
        if (whole)
            for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
                if (++kept % kDartsPerCheck == 0) progress.check();
                keep(keep, triangle_of(surface, t), t, longest * longest);
            }
        else
            for (const Fragment& f : fragments) {
                if (++kept % kDartsPerCheck == 0) progress.check();
                if (f.shape.longest2() > smallest * smallest)
                    keep(keep, f.shape, f.triangle,
                         std::min(longest * longest, f.shape.longest2() * 0.3));
                else if (!cells.any_within(f.shape.centroid(), radius, [](Vec3d) { return true; }))
                    left.push_back(f);  // free, not only a speck between rims: keep aiming
            }
        longest = std::max(longest / 2, smallest);
        fragments.swap(left);
        area_up_to.resize(fragments.size());
        area = 0;
        for (std::size_t i = 0; i < fragments.size(); ++i)
            area_up_to[i] = area += fragments[i].shape.area();
    }
    return stuck;
}

/// The surface cut into pieces that are small against a cell: what integrals over cells sum over.
struct Pieces {
    struct Piece {
        Vec3f a, b, c;
        Triangle triangle() const { return {Vec3d(a), Vec3d(b), Vec3d(c)}; }
    };
    std::vector<Piece> pieces;
    Bounds bounds;
    double spacing = 1;

    Pieces(const TriMesh& surface, std::size_t seeds, const Progress& progress)
        : bounds(bounds_of(surface))
    {
        double area = 0;
        for (std::size_t t = 0; t < surface.triangles.size(); ++t)
            area += triangle_of(surface, t).area();
        spacing = std::sqrt(area / double(std::max<std::size_t>(seeds, 1)));
        auto add = [&](auto&& self, const Triangle& t) -> void {
            if (t.longest2() <= spacing * spacing / 64)
                pieces.push_back({Vec3f(t.a), Vec3f(t.b), Vec3f(t.c)});
            else
                for (const Triangle& quarter : t.quarters()) self(self, quarter);
        };
        for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
            if (t % 1024 == 0) progress.check();
            add(add, triangle_of(surface, t));
        }
    }
};

/// Which pieces each seed's cell has: members[begin[s]] to members[begin[s + 1]], in order.
struct Cells {
    std::vector<std::uint32_t> begin, members;
};

Cells assign(const Pieces& surface, const std::vector<Vec3d>& seeds, const Progress& progress)
{
    PointCells points(surface.bounds, std::max(surface.spacing, 1e-9));
    for (const Vec3d& s : seeds) points.insert(s);
    std::vector<std::uint32_t> owner(surface.pieces.size());
    parallel_for_range(
        owner.size(),
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            for (std::size_t i = begin; i < end; ++i)
                owner[i] = points.nearest(surface.pieces[i].triangle().centroid());
        },
        4096);
    Cells cells;
    cells.begin.assign(seeds.size() + 1, 0);
    for (const std::uint32_t o : owner) ++cells.begin[o + 1];
    std::partial_sum(cells.begin.begin(), cells.begin.end(), cells.begin.begin());
    cells.members.resize(owner.size());
    std::vector<std::uint32_t> next(cells.begin.begin(), cells.begin.end() - 1);
    for (std::size_t i = 0; i < owner.size(); ++i)
        cells.members[next[owner[i]]++] = static_cast<std::uint32_t>(i);
    return cells;
}

/// Moves each seed `fraction` of the way to the centroid of its cell, and onto the surface.
std::vector<Vec3d> lloyd(const Pieces& surface, const Cells& cells, const std::vector<Vec3d>& seeds,
                         double fraction)
{
    std::vector<Vec3d> moved(seeds);
    parallel_for(
        seeds.size(),
        [&](std::size_t s) {
            Vec3d sum;
            double area = 0;
            for (std::uint32_t k = cells.begin[s]; k < cells.begin[s + 1]; ++k) {
                const Triangle t = surface.pieces[cells.members[k]].triangle();
                const double a = t.area();
                sum += t.centroid() * a;
                area += a;
            }
            if (!(area > 0)) return;
            const Vec3d target = seeds[s] + (sum / area - seeds[s]) * fraction;
            double least2 = kInfinity;
            for (std::uint32_t k = cells.begin[s]; k < cells.begin[s + 1]; ++k) {
                const Vec3d p = closest_on(surface.pieces[cells.members[k]].triangle(), target);
                const double d2 = dot(p - target, p - target);
                if (d2 < least2) {
                    least2 = d2;
                    moved[s] = p;
                }
            }
        },
        16);
    return moved;
}

double variation(const Pieces& surface, const Cells& cells)
{
    const std::size_t n = cells.begin.size() - 1;
    std::vector<double> areas(n, 0.0);
    for (std::size_t s = 0; s < n; ++s)
        for (std::uint32_t k = cells.begin[s]; k < cells.begin[s + 1]; ++k)
            areas[s] += surface.pieces[cells.members[k]].triangle().area();
    const double mean = std::accumulate(areas.begin(), areas.end(), 0.0) / double(n);
    double square = 0;
    for (const double a : areas) square += (a - mean) * (a - mean);
    return mean > 0 ? std::sqrt(square / double(n)) / mean : 0;
}

/// A polygon corner with the value by which it is being cut.
struct Corner {
    Vec3d p;
    double keep = 0;  ///< kept where > 0
};

/// The part of a convex polygon where `keep` is not negative.
void clip(std::vector<Corner>& polygon, std::vector<Corner>& scratch)
{
    scratch.clear();
    for (std::size_t i = 0; i < polygon.size(); ++i) {
        const Corner& a = polygon[i];
        const Corner& b = polygon[(i + 1) % polygon.size()];
        if (a.keep >= 0) scratch.push_back(a);
        if ((a.keep >= 0) != (b.keep >= 0)) {
            const double t = a.keep / (a.keep - b.keep);
            scratch.push_back({a.p + (b.p - a.p) * t, 0});
        }
    }
    polygon.swap(scratch);
}

}  // namespace

TriMesh cooling_surface(const Inputs& inputs, const Progress& progress)
{
    // In voxel units from the start: world coordinates far from the origin would cost digits.
    const TriMesh whole = marching_tetrahedra(inputs.body_sdf, 0, {}, progress);
    const Vec3d size(inputs.domain.dims);
    const bool has_slow = inputs.slow_sdf.leaf_count() > 0;

    // What is left of each triangle: all, nothing, or a polygon of so many corners.
    constexpr std::uint8_t kAll = 0xFF;
    constexpr std::size_t kChunk = 4096;
    std::vector<std::uint8_t> left(whole.triangles.size());
    std::vector<std::vector<Vec3f>> corners_left((left.size() + kChunk - 1) / kChunk);
    // The tracer calls the higher side inside, here the cold one: its triangles face the lava.
    auto corners_of = [&](std::size_t t) {
        const auto& v = whole.triangles[t];
        return std::array<std::uint32_t, 3>{v[0], v[2], v[1]};
    };
    parallel_for(corners_left.size(), [&](std::size_t chunk) {
        progress.check();
        GridReader<float> slow(inputs.slow_sdf);
        std::vector<Corner> polygon, scratch;
        const std::size_t end = std::min(left.size(), (chunk + 1) * kChunk);
        for (std::size_t t = chunk * kChunk; t < end; ++t) {
            const std::array<std::uint32_t, 3> corners = corners_of(t);
            const Triangle shape{Vec3d(whole.vertices[corners[0]]),
                                 Vec3d(whole.vertices[corners[1]]),
                                 Vec3d(whole.vertices[corners[2]])};
            const Vec3d outward = normalized(cross(shape.b - shape.a, shape.c - shape.a));
            const Vec3d low = min(min(shape.a, shape.b), shape.c);
            const Vec3d high = max(max(shape.a, shape.b), shape.c);

            // Walls of the box, where the level set was closed, are no surface of the lava.
            bool outside = false, wall = false, crosses = false;
            for (int axis = 0; axis < 3; ++axis) {
                outside = outside || high[axis] <= 0 || low[axis] >= size[axis];
                crosses = crosses || low[axis] < 0 || high[axis] > size[axis];
                wall = wall || (std::abs(outward[axis]) > 0.7 &&
                                (high[axis] <= 0.5 || low[axis] >= size[axis] - 0.5));
            }
            if (outside || wall) continue;

            polygon.clear();
            for (const Vec3d& p : {shape.a, shape.b, shape.c}) polygon.push_back({p, 1});
            if (crosses)
                for (int axis = 0; axis < 3; ++axis)
                    for (const bool upper : {false, true}) {
                        for (Corner& c : polygon)
                            c.keep = upper ? size[axis] - c.p[axis] : c.p[axis];
                        clip(polygon, scratch);
                    }
            // Behind a contact of slow part and cold there is no lava to crack. Looked up a little
            // inside, because on the contact itself both level sets are zero.
            bool slow_behind = false;
            if (has_slow && polygon.size() >= 3) {
                for (Corner& c : polygon) {
                    c.keep = double(slow.sample(c.p - outward * 0.75));
                    slow_behind = slow_behind || c.keep < 0;
                }
                if (slow_behind) clip(polygon, scratch);
            }
            if (polygon.size() < 3) continue;
            left[t] = crosses || slow_behind ? static_cast<std::uint8_t>(polygon.size()) : kAll;
            if (left[t] != kAll)
                for (const Corner& c : polygon) corners_left[chunk].push_back(Vec3f(c.p));
        }
    });

    // Number the vertices in the order of the triangles.
    TriMesh cut;
    constexpr auto kUnused = 0xFFFFFFFFu;
    std::vector<std::uint32_t> kept_as(whole.vertices.size(), kUnused);
    std::vector<Vec3f>::const_iterator next;
    for (std::size_t t = 0; t < left.size(); ++t) {
        if (t % kChunk == 0) {
            progress.check();
            next = corners_left[t / kChunk].cbegin();
        }
        if (left[t] == 0) continue;
        if (left[t] == kAll) {
            std::array<std::uint32_t, 3> kept = corners_of(t);
            for (std::uint32_t& corner : kept) {
                std::uint32_t& as = kept_as[corner];
                if (as == kUnused) {
                    as = static_cast<std::uint32_t>(cut.vertices.size());
                    cut.vertices.push_back(whole.vertices[corner]);
                }
                corner = as;
            }
            cut.triangles.push_back(kept);
            continue;
        }
        const auto first = static_cast<std::uint32_t>(cut.vertices.size());
        cut.vertices.insert(cut.vertices.end(), next, next + left[t]);
        next += left[t];
        for (std::uint32_t k = 2; k < left[t]; ++k) {
            const std::array<std::uint32_t, 3> fan{first, first + k - 1, first + k};
            const Triangle piece{Vec3d(cut.vertices[fan[0]]), Vec3d(cut.vertices[fan[1]]),
                                 Vec3d(cut.vertices[fan[2]])};
            if (piece.area() > 1e-9) cut.triangles.push_back(fan);
        }
    }
    return cut;
}

std::vector<Vec3d> poisson_disk(const TriMesh& surface, std::size_t count, double radius,
                                std::uint64_t seed, const Progress& progress)
{
    std::vector<Vec3d> points;
    for (const Dart& dart : throw_darts(surface, count, radius, seed, progress))
        points.push_back(dart.at);
    return points;
}

std::vector<Vec3d> poisson_disk_plane(const TriMesh& surface, std::size_t count, double radius,
                                      std::uint64_t seed, const Progress& progress)
{
    // Flatten the two sides apart; what stands upright has no projection.
    struct Side {
        TriMesh flat;
        std::vector<std::size_t> source;
        double area = 0;
    };
    std::array<Side, 2> sides;
    for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
        Triangle shape = triangle_of(surface, t);
        for (Vec3d* p : {&shape.a, &shape.b, &shape.c}) p->z = 0;
        const double twice = cross(shape.b - shape.a, shape.c - shape.a).z;
        if (std::abs(twice) < 1e-9) continue;
        Side& side = sides[twice > 0 ? 0 : 1];
        const auto first = static_cast<std::uint32_t>(side.flat.vertices.size());
        for (const Vec3d& p : {shape.a, shape.b, shape.c}) side.flat.vertices.push_back(Vec3f(p));
        side.flat.triangles.push_back({first, first + 1, first + 2});
        side.source.push_back(t);
        side.area += std::abs(twice) / 2;
    }
    std::vector<Vec3d> points;
    const double total = sides[0].area + sides[1].area;
    for (std::size_t k = 0; k < 2; ++k) {
        const Side& side = sides[k];
        const std::size_t share =
            count == 0 ? 0
            : k == 0 ? static_cast<std::size_t>(std::floor(double(count) * side.area / total + 0.5))
                     : count - points.size();
        if (side.source.empty() || (count > 0 && share == 0)) continue;
        const std::size_t before = points.size();
        for (const Dart& dart : throw_darts(side.flat, share, radius, hash2(seed, k), progress)) {
            // Lift by the plane of the triangle: weights of its corners from areas in the plane.
            const Triangle flat = triangle_of(side.flat, dart.triangle);
            const Triangle up = triangle_of(surface, side.source[dart.triangle]);
            const double whole = cross(flat.b - flat.a, flat.c - flat.a).z;
            const double b = cross(dart.at - flat.a, flat.c - flat.a).z / whole;
            const double c = cross(flat.b - flat.a, dart.at - flat.a).z / whole;
            points.push_back(
                {dart.at.x, dart.at.y, up.a.z * (1 - b - c) + up.b.z * b + up.c.z * c});
        }
        // A side that could not take its share must not be made up for by the other.
        if (k == 0 && count > 0) count -= share - (points.size() - before);
    }
    return points;
}

std::vector<Vec3d> relax(const TriMesh& surface, std::vector<Vec3d> seeds, double sweeps,
                         const Progress& progress)
{
    if (seeds.empty() || !(sweeps > 0)) return seeds;
    const Pieces pieces(surface, seeds.size(), progress);
    const int whole = static_cast<int>(std::ceil(sweeps));
    for (int k = 0; k < whole; ++k) {
        progress.update(double(k) / whole);
        seeds = lloyd(pieces, assign(pieces, seeds, progress), seeds, std::min(1.0, sweeps - k));
    }
    return seeds;
}

std::vector<Vec3d> relax_to(const TriMesh& surface, std::vector<Vec3d> seeds, double target,
                            const Progress& progress)
{
    if (seeds.empty()) return seeds;
    constexpr int kMostSweeps = 40, kBisections = 10;
    const Pieces pieces(surface, seeds.size(), progress);
    Cells cells = assign(pieces, seeds, progress);
    double reached = variation(pieces, cells);
    if (reached <= target) {
        log::warning(
            "joints: target_cv = {:.3f}, but unrelaxed cells have {:.3f} already; a smaller "
            "seed_radius makes them less even",
            target, reached);
        return seeds;
    }
    for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
        progress.update(double(sweep) / kMostSweeps);
        std::vector<Vec3d> next = lloyd(pieces, cells, seeds, 1);
        Cells next_cells = assign(pieces, next, progress);
        reached = variation(pieces, next_cells);
        if (reached <= target) {
            double low = 0, high = 1;
            for (int k = 0; k < kBisections; ++k) {
                const double middle = (low + high) / 2;
                const auto tried = lloyd(pieces, cells, seeds, middle);
                (variation(pieces, assign(pieces, tried, progress)) > target ? low : high) = middle;
            }
            return lloyd(pieces, cells, seeds, high);
        }
        seeds = std::move(next);
        cells = std::move(next_cells);
    }
    log::warning("joints: target_cv = {:.3f} not reached in {} sweeps, cells have {:.3f}", target,
                 kMostSweeps, reached);
    return seeds;
}

double area_variation(const TriMesh& surface, const std::vector<Vec3d>& seeds)
{
    if (seeds.empty()) return 0;
    const Pieces pieces(surface, seeds.size(), {});
    return variation(pieces, assign(pieces, seeds, {}));
}

}  // namespace sekitei::joints
