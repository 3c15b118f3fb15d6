#include "grids/nearest_polyline.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

// The same source for wider registers, chosen at run time; without FMA the bytes are the same.
#if defined(__x86_64__) && !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__)
#define SEKITEI_WIDE __attribute__((target_clones("avx2", "default")))
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

void clear(PolylineIndex::Candidates& out)
{
    out.segments.clear();
    out.lines.clear();
    for (auto* v : {&out.ax, &out.ay, &out.az, &out.dx, &out.dy, &out.dz, &out.inverse_length2,
                    &out.arc0, &out.length})
        v->clear();
    out.line.clear();
}

void push(PolylineIndex::Candidates& out, std::uint32_t id, const Segment& s)
{
    out.segments.push_back(id);
    out.ax.push_back(s.a.x);
    out.ay.push_back(s.a.y);
    out.az.push_back(s.a.z);
    out.dx.push_back(s.d.x);
    out.dy.push_back(s.d.y);
    out.dz.push_back(s.d.z);
    out.inverse_length2.push_back(s.inverse_length2);
    out.arc0.push_back(s.arc0);
    out.length.push_back(s.length);
    out.line.push_back(s.line);
    if (out.lines.empty() || out.lines.back() != s.line) out.lines.push_back(s.line);
}

/// Squared distances of one point to all candidates.
SEKITEI_WIDE void distances2(Vec3d p, const double* __restrict ax, const double* __restrict ay,
                             const double* __restrict az, const double* __restrict dx,
                             const double* __restrict dy, const double* __restrict dz,
                             const double* __restrict inverse, std::size_t n,
                             double* __restrict out)
{
    for (std::size_t j = 0; j < n; ++j) {
        const double px = p.x - ax[j], py = p.y - ay[j], pz = p.z - az[j];
        double t = (px * dx[j] + py * dy[j] + pz * dz[j]) * inverse[j];
        t = t > 0.0 ? t : 0.0;
        t = t < 1.0 ? t : 1.0;
        const double rx = px - dx[j] * t, ry = py - dy[j] * t, rz = pz - dz[j] * t;
        out[j] = rx * rx + ry * ry + rz * rz;
    }
}

void distances2(Vec3d p, const PolylineIndex::Candidates& c, std::vector<double>& out)
{
    out.resize(c.segments.size());
    distances2(p, c.ax.data(), c.ay.data(), c.az.data(), c.dx.data(), c.dy.data(), c.dz.data(),
               c.inverse_length2.data(), c.segments.size(), out.data());
}

/// Index of the nearest candidate for each of the 8 voxels of a row along z. The same arithmetic
/// as distance2(), in the same order, so that ties fall the same way.
SEKITEI_WIDE void nearest_in_row(double x, double y, const double* __restrict z,
                                 const double* __restrict ax, const double* __restrict ay,
                                 const double* __restrict az, const double* __restrict dx,
                                 const double* __restrict dy, const double* __restrict dz,
                                 const double* __restrict inverse, std::size_t n,
                                 double* __restrict index)
{
    double least[kLeafEdge], which[kLeafEdge];
    for (int k = 0; k < kLeafEdge; ++k) least[k] = kInfinity, which[k] = 0;
    for (std::size_t j = 0; j < n; ++j) {
        const double px = x - ax[j], py = y - ay[j], a = az[j];
        const double ex = dx[j], ey = dy[j], ez = dz[j], inv = inverse[j];
        const double along = px * ex + py * ey, id = static_cast<double>(j);
        for (int k = 0; k < kLeafEdge; ++k) {
            const double pz = z[k] - a;
            double t = (along + pz * ez) * inv;
            t = t > 0.0 ? t : 0.0;
            t = t < 1.0 ? t : 1.0;
            const double rx = px - ex * t, ry = py - ey * t, rz = pz - ez * t;
            const double d2 = rx * rx + ry * ry + rz * rz;
            const bool nearer = d2 < least[k];
            least[k] = nearer ? d2 : least[k];
            which[k] = nearer ? id : which[k];
        }
    }
    for (int k = 0; k < kLeafEdge; ++k) index[k] = which[k];
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
    clear(out);
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
    for (const std::uint32_t j : ids) push(out, j, s.segments[j]);
}

void PolylineIndex::narrow(const Candidates& from, Vec3d centre, double half, Candidates& out)
{
    clear(out);
    thread_local std::vector<double> d2;
    distances2(centre, from, d2);
    const auto best = std::min_element(d2.begin(), d2.end());
    if (best == d2.end()) return;

    // The distance to a segment is convex: its largest value in the cube is at a corner.
    const Segment nearest = segment_of(from, static_cast<std::size_t>(best - d2.begin()));
    double worst2 = 0;
    for (int corner = 0; corner < 8; ++corner) {
        const Vec3d p = centre + Vec3d(corner & 1 ? half : -half, corner & 2 ? half : -half,
                                       corner & 4 ? half : -half);
        worst2 = std::max(worst2, distance2(p, nearest));
    }
    const double reach = (std::sqrt(worst2) + half * std::sqrt(3.0)) * (1 + kMargin) + kMargin;
    for (std::size_t j = 0; j < d2.size(); ++j)
        if (d2[j] <= reach * reach) push(out, from.segments[j], segment_of(from, j));
}

void PolylineIndex::nearest_in_leaf(Coord origin, const Candidates& c, std::int32_t* line,
                                    double* arc)
{
    double z[kLeafEdge], index[kLeafEdge];
    for (int k = 0; k < kLeafEdge; ++k) z[k] = origin.z + k + 0.5;
    for (int row = 0; row < kLeafEdge * kLeafEdge; ++row) {
        const double x = origin.x + (row >> 3) + 0.5, y = origin.y + (row & 7) + 0.5;
        nearest_in_row(x, y, z, c.ax.data(), c.ay.data(), c.az.data(), c.dx.data(), c.dy.data(),
                       c.dz.data(), c.inverse_length2.data(), c.segments.size(), index);
        for (int k = 0; k < kLeafEdge; ++k) {
            const auto j = static_cast<std::size_t>(index[k]);
            const int offset = row * kLeafEdge + k;
            if (line) line[offset] = c.line[j];
            if (arc)
                arc[offset] = c.arc0[j] + parameter({x, y, z[k]}, segment_of(c, j)) * c.length[j];
        }
    }
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
