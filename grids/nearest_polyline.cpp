#include "grids/nearest_polyline.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

// The same source for wider registers, chosen at run time; without FMA the bytes are the same.
#if defined(__x86_64__) && !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__)
#define SEKITEI_WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define SEKITEI_WIDE
#endif

namespace sekitei {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// Bounds are widened by this share, far above the rounding of a distance.
constexpr double kMargin = 1e-9;
/// A tree leaf holds at most this many boxes.
constexpr std::size_t kTreeLeaf = 4;
/// How many near segments may each rule out others in a cube.
constexpr int kRivals = 2;
/// Long oblique segments enter the tree as several boxes, each at most this wide [voxels].
constexpr double kBoxWidth = 8;

struct Segment {
    Vec3d a, d;
    double inverse_length2 = 0;  // 0 for a single point
    double arc0 = 0, length = 0;
    std::int32_t line = 0;
};

/// Parameter of the nearest point: 0 at the start, 1 at the end. min and max in this order turn
/// into single instructions, and the result never depends on which loop computes it.
double parameter(Vec3d p, const Segment& s)
{
    const double t = dot(p - s.a, s.d) * s.inverse_length2;
    return std::min(std::max(t, 0.0), 1.0);
}

double distance2(Vec3d p, const Segment& s)
{
    const double t = parameter(p, s);
    const Vec3d r = (p - s.a) - s.d * t;
    return dot(r, r);
}

Segment segment_of(const PolylineIndex::Candidates& c, std::size_t j)
{
    return {{c.ax[j], c.ay[j], c.az[j]},
            {c.dx[j], c.dy[j], c.dz[j]},
            c.inverse_length2[j],
            c.arc0[j],
            c.length[j],
            c.line[j]};
}

NearestPoint found_on(const Segment& s, Vec3d p, double d2)
{
    const double t = parameter(p, s);
    return {s.line, d2, s.arc0 + t * s.length, s.a + s.d * t};
}

NearestPoint nothing()
{
    NearestPoint none;
    none.distance2 = kInfinity;
    return none;
}

double box_distance2(Vec3d p, Vec3d lower, Vec3d upper)
{
    const Vec3d r = max(max(lower - p, p - upper), Vec3d(0.0));
    return dot(r, r);
}

/// Room for n candidates.
void resize(PolylineIndex::Candidates& out, std::size_t n)
{
    out.segments.resize(n);
    for (auto* v : {&out.ax, &out.ay, &out.az, &out.dx, &out.dy, &out.dz, &out.inverse_length2,
                    &out.arc0, &out.length})
        v->resize(n);
    out.line.resize(n);
}

void set_lines(PolylineIndex::Candidates& out)
{
    out.lines.clear();
    for (const std::int32_t line : out.line)
        if (out.lines.empty() || out.lines.back() != line) out.lines.push_back(line);
}

/// Ways from the nearest point of each candidate to p, and their squared lengths.
SEKITEI_WIDE void ways_to(Vec3d p, const double* __restrict ax, const double* __restrict ay,
                          const double* __restrict az, const double* __restrict dx,
                          const double* __restrict dy, const double* __restrict dz,
                          const double* __restrict inverse, std::size_t n, double* __restrict wx,
                          double* __restrict wy, double* __restrict wz, double* __restrict w2)
{
    for (std::size_t j = 0; j < n; ++j) {
        const double px = p.x - ax[j], py = p.y - ay[j], pz = p.z - az[j];
        double t = (px * dx[j] + py * dy[j] + pz * dz[j]) * inverse[j];
        t = t > 0.0 ? t : 0.0;
        t = t < 1.0 ? t : 1.0;
        const double rx = px - dx[j] * t, ry = py - dy[j] * t, rz = pz - dz[j] * t;
        wx[j] = rx;
        wy[j] = ry;
        wz[j] = rz;
        w2[j] = rx * rx + ry * ry + rz * rz;
    }
}

/// Lowers kept[j] below zero for each candidate that `corner_distance` beats in the whole cube.
///
/// With w the way from candidate j's nearest point to the centre, d = |w|, convexity gives for each
/// p of the cube distance_j(p) >= d + (p - centre) . w / d. Minus the (convex) distance to the
/// rival that is concave in p: where it is positive at all corners, it is everywhere.
SEKITEI_WIDE void beaten_in_cube(double half, const double* __restrict corner_distance,
                                 const double* __restrict wx, const double* __restrict wy,
                                 const double* __restrict wz, const double* __restrict w2,
                                 std::size_t n, double* __restrict kept)
{
    for (std::size_t j = 0; j < n; ++j) {
        const double d2 = w2[j], d = std::sqrt(d2);
        const double x = wx[j] * half, y = wy[j] * half, z = wz[j] * half;
        double least = kInfinity;
        for (int k = 0; k < 8; ++k) {
            const double slope = (k & 1 ? x : -x) + (k & 2 ? y : -y) + (k & 4 ? z : -z);
            const double ahead = d2 + slope - corner_distance[k] * d;
            least = ahead < least ? ahead : least;
        }
        kept[j] = least > kMargin * (1 + d2) ? -1.0 : kept[j];
    }
}

/// A row of 8 voxels along z: one register, two or four, as the processor has them.
typedef double Row __attribute__((vector_size(64)));
typedef std::int64_t RowIds __attribute__((vector_size(64)));

/// What the leaf loop reads of a candidate, side by side.
struct Packed {
    double ax, ay, az, dx, dy, dz, inverse_length2, arc0, length;
    std::int64_t line;
};

/// Line, and arc length if asked for, of the nearest candidate for each voxel of the leaf at
/// `origin`. The same arithmetic as distance2(), in the same order, so that ties fall the same way.
SEKITEI_WIDE void nearest_in_rows(Coord origin, const Packed* candidates, std::size_t n,
                                  std::int32_t* __restrict line, double* __restrict arc)
{
    const Row steps{0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5};
    const Row zero{}, one = zero + 1.0, z = steps + double(origin.z);
    for (int row = 0; row < kLeafEdge * kLeafEdge; ++row) {
        const double x = origin.x + (row >> 3) + 0.5, y = origin.y + (row & 7) + 0.5;
        Row least = zero + kInfinity, along = zero;
        RowIds owner{};
        for (std::size_t j = 0; j < n; ++j) {
            const Packed& c = candidates[j];
            const double px = x - c.ax, py = y - c.ay;
            const double level = px * c.dx + py * c.dy;
            const Row pz = z - c.az;
            Row t = (level + pz * c.dz) * c.inverse_length2;
            t = t > zero ? t : zero;
            t = t < one ? t : one;
            const Row rx = px - c.dx * t, ry = py - c.dy * t, rz = pz - c.dz * t;
            const Row d2 = rx * rx + ry * ry + rz * rz;
            const RowIds nearer = d2 < least;
            least = nearer ? d2 : least;
            owner = nearer ? RowIds{} + c.line : owner;
            along = nearer ? c.arc0 + t * c.length : along;
        }
        for (int k = 0; k < kLeafEdge; ++k)
            line[row * kLeafEdge + k] = static_cast<std::int32_t>(owner[k]);
        if (arc)
            for (int k = 0; k < kLeafEdge; ++k) arc[row * kLeafEdge + k] = along[k];
    }
}

}  // namespace

struct PolylineIndex::State {
    struct Box {
        Vec3d lower, upper;
        std::uint32_t segment;
    };
    struct Node {
        Vec3d lower, upper;
        std::uint32_t first, count;  // count > 0: boxes; else children at first, first + 1
    };
    std::vector<Segment> segments;
    std::vector<Box> boxes;
    std::vector<Node> nodes;

    void split(std::uint32_t node);
    template <class Visit>
    void nearest_first(Vec3d p, double& bound2, Visit&& visit) const;
};

/// Halves a node's boxes at the median along the longest side until few are left.
void PolylineIndex::State::split(std::uint32_t node)
{
    const std::size_t first = nodes[node].first, count = nodes[node].count;
    Bounds extent, centres;
    for (std::size_t i = first; i < first + count; ++i) {
        extent.add(boxes[i].lower);
        extent.add(boxes[i].upper);
        centres.add((boxes[i].lower + boxes[i].upper) * 0.5);
    }
    nodes[node].lower = extent.lower;
    nodes[node].upper = extent.upper;
    if (count <= kTreeLeaf) return;
    const Vec3d size = centres.size();
    const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    const auto begin = boxes.begin() + static_cast<std::ptrdiff_t>(first);
    const auto middle = begin + static_cast<std::ptrdiff_t>(count / 2);
    std::nth_element(begin, middle, begin + static_cast<std::ptrdiff_t>(count),
                     [axis](const Box& a, const Box& b) {
                         return a.lower[axis] + a.upper[axis] < b.lower[axis] + b.upper[axis];
                     });
    const auto child = static_cast<std::uint32_t>(nodes.size());
    const auto half = static_cast<std::uint32_t>(count / 2);
    nodes.push_back({{}, {}, static_cast<std::uint32_t>(first), half});
    nodes.push_back({{},
                     {},
                     static_cast<std::uint32_t>(first) + half,
                     static_cast<std::uint32_t>(count) - half});
    nodes[node].first = child;
    nodes[node].count = 0;
    split(child);
    split(child + 1);
}

/// Calls visit(segment) for all segments whose boxes come within sqrt(bound2) of p, near ones
/// first; visit may lower bound2.
template <class Visit>
void PolylineIndex::State::nearest_first(Vec3d p, double& bound2, Visit&& visit) const
{
    if (nodes.empty()) return;
    struct Entry {
        std::uint32_t node;
        double distance2;
    };
    std::array<Entry, 64> stack;  // the tree is balanced: depth <= log2(2^32 / 4)
    std::size_t top = 0;
    stack[top++] = {0, box_distance2(p, nodes[0].lower, nodes[0].upper)};
    while (top > 0) {
        const Entry entry = stack[--top];
        if (entry.distance2 > bound2) continue;
        const Node& node = nodes[entry.node];
        if (node.count > 0) {
            for (std::uint32_t i = node.first; i < node.first + node.count; ++i)
                if (box_distance2(p, boxes[i].lower, boxes[i].upper) <= bound2)
                    visit(boxes[i].segment);
            continue;
        }
        Entry near{node.first, 0}, far{node.first + 1, 0};
        for (Entry* e : {&near, &far})
            e->distance2 = box_distance2(p, nodes[e->node].lower, nodes[e->node].upper);
        if (far.distance2 < near.distance2) std::swap(near, far);
        stack[top++] = far;
        stack[top++] = near;
    }
}

PolylineIndex::PolylineIndex(const Polylines& lines) : state_(std::make_unique<State>())
{
    State& s = *state_;
    const std::vector<double> arcs = lines.arc_lengths();
    for (std::size_t i = 0; i < lines.count(); ++i) {
        const std::size_t begin = lines.begin[i], end = lines.begin[i + 1];
        for (std::size_t k = begin; k < end && (k + 1 < end || k == begin); ++k) {
            Segment segment;
            segment.a = lines.points[k];
            if (k + 1 < end) segment.d = lines.points[k + 1] - lines.points[k];
            const double l2 = dot(segment.d, segment.d);
            segment.inverse_length2 = l2 > 0 ? 1 / l2 : 0;
            if (!std::isfinite(segment.inverse_length2)) segment.inverse_length2 = 0;
            segment.length = std::sqrt(l2);
            segment.arc0 = arcs[k];
            segment.line = static_cast<std::int32_t>(i);
            s.segments.push_back(segment);
        }
    }
    for (std::size_t j = 0; j < s.segments.size(); ++j) {
        const Segment& segment = s.segments[j];
        // The second longest side says how badly one box fits the segment.
        std::array<double, 3> side{std::abs(segment.d.x), std::abs(segment.d.y),
                                   std::abs(segment.d.z)};
        std::sort(side.begin(), side.end());
        const int parts = 1 + static_cast<int>(std::min(side[1] / kBoxWidth, 4096.0));
        for (int k = 0; k < parts; ++k) {
            const Vec3d a = segment.a + segment.d * (double(k) / parts);
            const Vec3d b = segment.a + segment.d * (double(k + 1) / parts);
            const Vec3d slack((1 + std::max(length(a), length(b))) * 1e-12);
            s.boxes.push_back({min(a, b) - slack, max(a, b) + slack, std::uint32_t(j)});
        }
    }
    if (s.boxes.empty()) return;
    s.nodes.push_back({{}, {}, 0, static_cast<std::uint32_t>(s.boxes.size())});
    s.split(0);
}

PolylineIndex::~PolylineIndex() = default;
PolylineIndex::PolylineIndex(PolylineIndex&&) noexcept = default;
PolylineIndex& PolylineIndex::operator=(PolylineIndex&&) noexcept = default;

std::size_t PolylineIndex::segment_count() const
{
    return state_->segments.size();
}

void PolylineIndex::candidates(Vec3d centre, double rho, Candidates& out) const
{
    const State& s = *state_;
    double least2 = kInfinity;
    s.nearest_first(centre, least2, [&](std::uint32_t j) {
        least2 = std::min(least2, distance2(centre, s.segments[j]));
    });
    const double reach = (std::sqrt(least2) + 2 * rho) * (1 + kMargin) + kMargin;
    double reach2 = reach * reach;
    thread_local std::vector<std::uint32_t> ids;
    ids.clear();
    s.nearest_first(centre, reach2, [&](std::uint32_t j) {
        if (distance2(centre, s.segments[j]) <= reach2) ids.push_back(j);
    });
    std::sort(ids.begin(), ids.end());
    ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
    resize(out, ids.size());
    for (std::size_t k = 0; k < ids.size(); ++k) {
        const Segment& segment = s.segments[ids[k]];
        out.segments[k] = ids[k];
        out.ax[k] = segment.a.x;
        out.ay[k] = segment.a.y;
        out.az[k] = segment.a.z;
        out.dx[k] = segment.d.x;
        out.dy[k] = segment.d.y;
        out.dz[k] = segment.d.z;
        out.inverse_length2[k] = segment.inverse_length2;
        out.arc0[k] = segment.arc0;
        out.length[k] = segment.length;
        out.line[k] = segment.line;
    }
    set_lines(out);
}

void PolylineIndex::narrow(const Candidates& from, Vec3d centre, double half, Candidates& out)
{
    const std::size_t n = from.segments.size();
    struct Work {
        std::vector<double> wx, wy, wz, w2, kept;
        std::vector<std::uint32_t> chosen;
    };
    thread_local Work w;
    for (auto* v : {&w.wx, &w.wy, &w.wz, &w.w2, &w.kept}) v->resize(n);
    ways_to(centre, from.ax.data(), from.ay.data(), from.az.data(), from.dx.data(), from.dy.data(),
            from.dz.data(), from.inverse_length2.data(), n, w.wx.data(), w.wy.data(), w.wz.data(),
            w.w2.data());

    // The nearest few are the rivals that may beat the others in the whole cube.
    std::fill(w.kept.begin(), w.kept.end(), 1.0);
    double beyond2 = -1;
    for (int rival = 0; rival < kRivals; ++rival) {
        std::size_t nearest = n;
        for (std::size_t j = 0; j < n; ++j)
            if (w.w2[j] > beyond2 && w.kept[j] > 0 && (nearest == n || w.w2[j] < w.w2[nearest]))
                nearest = j;
        if (nearest == n) break;
        beyond2 = w.w2[nearest];
        const Segment segment = segment_of(from, nearest);
        double corner_distance[8];
        for (int k = 0; k < 8; ++k)
            corner_distance[k] = std::sqrt(distance2(
                centre + Vec3d(k & 1 ? half : -half, k & 2 ? half : -half, k & 4 ? half : -half),
                segment));
        beaten_in_cube(half, corner_distance, w.wx.data(), w.wy.data(), w.wz.data(), w.w2.data(), n,
                       w.kept.data());
    }

    w.chosen.clear();
    for (std::size_t j = 0; j < n; ++j)
        if (w.kept[j] > 0) w.chosen.push_back(static_cast<std::uint32_t>(j));
    auto pick = [&](const auto& source, auto& target) {
        target.resize(w.chosen.size());
        for (std::size_t k = 0; k < w.chosen.size(); ++k) target[k] = source[w.chosen[k]];
    };
    pick(from.segments, out.segments);
    pick(from.ax, out.ax);
    pick(from.ay, out.ay);
    pick(from.az, out.az);
    pick(from.dx, out.dx);
    pick(from.dy, out.dy);
    pick(from.dz, out.dz);
    pick(from.inverse_length2, out.inverse_length2);
    pick(from.arc0, out.arc0);
    pick(from.length, out.length);
    pick(from.line, out.line);
    set_lines(out);
}

void PolylineIndex::nearest_in_leaf(Coord origin, const Candidates& c, std::int32_t* line,
                                    double* arc)
{
    thread_local std::vector<Packed> packed;
    packed.clear();
    for (std::size_t j = 0; j < c.segments.size(); ++j)
        packed.push_back({c.ax[j], c.ay[j], c.az[j], c.dx[j], c.dy[j], c.dz[j],
                          c.inverse_length2[j], c.arc0[j], c.length[j], c.line[j]});
    nearest_in_rows(origin, packed.data(), packed.size(), line, arc);
}

NearestPoint PolylineIndex::nearest(Vec3d p, const Candidates& candidates)
{
    std::size_t best = 0;
    double least2 = kInfinity;
    for (std::size_t j = 0; j < candidates.segments.size(); ++j) {
        const double d2 = distance2(p, segment_of(candidates, j));
        if (d2 < least2) {
            least2 = d2;
            best = j;
        }
    }
    if (candidates.segments.empty()) return nothing();
    return found_on(segment_of(candidates, best), p, least2);
}

void PolylineIndex::nearest_per_line(Vec3d p, const Candidates& candidates,
                                     std::vector<NearestPoint>& out)
{
    out.clear();
    const std::size_t n = candidates.segments.size();
    for (std::size_t j = 0; j < n;) {
        const std::int32_t line = candidates.line[j];
        std::size_t best = j;
        double least2 = kInfinity;
        for (; j < n && candidates.line[j] == line; ++j) {
            const double d2 = distance2(p, segment_of(candidates, j));
            if (d2 < least2) {
                least2 = d2;
                best = j;
            }
        }
        out.push_back(found_on(segment_of(candidates, best), p, least2));
    }
}

NearestPoint PolylineIndex::nearest(Vec3d p) const
{
    const State& s = *state_;
    std::uint32_t best = 0;
    double least2 = kInfinity;
    s.nearest_first(p, least2, [&](std::uint32_t j) {
        const double d2 = distance2(p, s.segments[j]);
        if (d2 < least2 || (d2 == least2 && j < best)) {
            least2 = d2;
            best = j;
        }
    });
    return s.segments.empty() ? nothing() : found_on(s.segments[best], p, least2);
}

NearestPoint PolylineIndex::nearest_brute_force(Vec3d p) const
{
    NearestPoint found = nothing();
    for (const Segment& s : state_->segments) {
        const double d2 = distance2(p, s);
        if (d2 < found.distance2) found = found_on(s, p, d2);
    }
    return found;
}

}  // namespace sekitei
