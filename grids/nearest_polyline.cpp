#include "grids/nearest_polyline.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/clones.h"

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
/// Coordinate of no candidate [voxels]; its fourth power would overflow, its square does not.
constexpr double kNowhere = 1e150;

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

/// The arrays that say where a candidate lies.
constexpr std::vector<double> PolylineIndex::Candidates::*kGeometry[] = {
    &PolylineIndex::Candidates::ax,
    &PolylineIndex::Candidates::ay,
    &PolylineIndex::Candidates::az,
    &PolylineIndex::Candidates::dx,
    &PolylineIndex::Candidates::dy,
    &PolylineIndex::Candidates::dz,
    &PolylineIndex::Candidates::inverse_length2};

/// Eight doubles side by side: one register, two or four, as the processor has them.
constexpr std::size_t kLanes = 8;
typedef double Row __attribute__((vector_size(64)));
typedef double RowAnywhere __attribute__((vector_size(64), aligned(8)));
typedef std::int64_t RowIds __attribute__((vector_size(64)));
typedef std::int32_t ShortRowIds __attribute__((vector_size(32)));

/// Room for n candidates, and behind them for lanes where nothing is near.
void resize(PolylineIndex::Candidates& out, std::size_t n)
{
    const std::size_t padded = (n + kLanes - 1) / kLanes * kLanes;
    for (auto array : kGeometry) {
        (out.*array).resize(padded);
        std::fill((out.*array).begin() + static_cast<std::ptrdiff_t>(n), (out.*array).end(),
                  array == &PolylineIndex::Candidates::ax ? kNowhere : 0.0);
    }
    out.segments.resize(n);
    out.arc0.resize(n);
    out.length.resize(n);
    out.line.resize(n);
}

void set_lines(PolylineIndex::Candidates& out)
{
    out.lines.clear();
    for (const std::int32_t line : out.line)
        if (out.lines.empty() || out.lines.back() != line) out.lines.push_back(line);
}

/// Ways from the nearest points of eight candidates to a cube's centre, and their squared lengths;
/// `ahead` < 0 once another candidate beats them in the whole cube.
struct alignas(64) Ways {
    Row x, y, z, length2, ahead;
};

/// What one thread reuses from cube to cube.
struct Work {
    std::vector<Ways> ways;
    std::vector<std::uint32_t> chosen;

    void make_room(std::size_t n)
    {
        ways.resize((n + kLanes - 1) / kLanes);
        chosen.resize(n);
    }
};

Work& work_of_this_thread()
{
    thread_local Work work;
    return work;
}

#define SEKITEI_INLINE inline __attribute__((always_inline))

/// Lists in `chosen`, ascending, those of the candidates that no near one beats in the whole cube
/// centre +- half; returns how many. Stops early once all are of one line if that suffices.
///
/// With w the way from candidate j's nearest point to the centre, d = |w|, convexity gives for each
/// p of the cube distance_j(p) >= d + (p - centre) . w / d. Minus the (convex) distance to the
/// rival that is concave in p: where it is positive at all corners, it is everywhere. Times d and
/// squared, no root is left.
SEKITEI_INLINE std::size_t cull(const PolylineIndex::Candidates& c, Vec3d centre, double half,
                                bool one_line_suffices, Work& work)
{
    const std::size_t n = c.line.size();
    const std::int32_t* line = c.line.data();
    if (n == 0) return 0;
    Ways* const ways = work.ways.data();
    std::uint32_t* const chosen = work.chosen.data();
    const Row zero{}, one = zero + 1.0;
    const std::size_t count = (n + kLanes - 1) / kLanes;
    // The first rival is the nearest, or nearly: to find it without branches, the number of each
    // takes the place of the last digits of its distance.
    constexpr std::int64_t kNumber = (1 << 20) - 1;
    RowIds number{0, 1, 2, 3, 4, 5, 6, 7};
    Row nearest = zero + kInfinity;
    for (std::size_t g = 0; g < count; ++g) {
        auto row = [g](const std::vector<double>& v) -> const RowAnywhere& {
            return reinterpret_cast<const RowAnywhere*>(v.data())[g];
        };
        const Row dx = row(c.dx), dy = row(c.dy), dz = row(c.dz);
        const Row px = centre.x - row(c.ax), py = centre.y - row(c.ay), pz = centre.z - row(c.az);
        Row t = (px * dx + py * dy + pz * dz) * row(c.inverse_length2);
        t = t > zero ? t : zero;
        t = t < one ? t : one;
        Ways& w = ways[g];
        w.x = px - dx * t;
        w.y = py - dy * t;
        w.z = pz - dz * t;
        w.length2 = w.x * w.x + w.y * w.y + w.z * w.z;
        w.ahead = zero;
        const RowIds numbered =
            (reinterpret_cast<RowIds>(w.length2) & ~kNumber) | (number & kNumber);
        const Row far = reinterpret_cast<Row>(numbered);
        nearest = far < nearest ? far : nearest;
        number += kLanes;
    }
    for (int lanes = 4; lanes > 0; lanes /= 2)
        for (int k = 0; k < lanes; ++k)
            nearest[k] = nearest[k] < nearest[k + lanes] ? nearest[k] : nearest[k + lanes];

    std::size_t kept = n;
    for (std::size_t j = 0; j < n; ++j) chosen[j] = static_cast<std::uint32_t>(j);
    auto rival = std::bit_cast<std::uint64_t>(double(nearest[0])) & std::uint64_t(kNumber);
    for (int round = 0;;) {
        // Its distance from the corners of the cube.
        const Segment r = segment_of(c, rival);
        const Row px = Row{-half, half, -half, half, -half, half, -half, half} + (centre.x - r.a.x);
        const Row py = Row{-half, -half, half, half, -half, -half, half, half} + (centre.y - r.a.y);
        const Row pz = Row{-half, -half, -half, -half, half, half, half, half} + (centre.z - r.a.z);
        Row t = (px * r.d.x + py * r.d.y + pz * r.d.z) * r.inverse_length2;
        t = t > zero ? t : zero;
        t = t < one ? t : one;
        const Row rx = px - r.d.x * t, ry = py - r.d.y * t, rz = pz - r.d.z * t;
        const Row corner2 = rx * rx + ry * ry + rz * rz;

        for (std::size_t g = 0; g < count; ++g) {
            Ways& w = ways[g];
            const Row base = w.length2 - kMargin * (one + w.length2);
            const Row x = w.x * half, y = w.y * half, z = w.z * half;
            const Row sum = x + y, difference = x - y;
            const Row slope[4] = {sum + z, difference - z, sum - z, difference + z};
            Row most = zero - kInfinity;
            auto corner = [&](int k, const Row& s) {
                const Row lack = corner2[k] * w.length2 - s * (s > zero ? s : zero);
                most = most > lack ? most : lack;
            };
            corner(7, base + slope[0]);
            corner(0, base - slope[0]);
            corner(1, base + slope[1]);
            corner(6, base - slope[1]);
            corner(3, base + slope[2]);
            corner(4, base - slope[2]);
            corner(5, base + slope[3]);
            corner(2, base - slope[3]);
            w.ahead = w.ahead < most ? w.ahead : most;
        }
        std::size_t still = 0;
        for (std::size_t k = 0; k < kept; ++k) {
            const std::uint32_t j = chosen[k];
            chosen[still] = j;
            still += ways[j / kLanes].ahead[j % kLanes] < 0 ? 0 : 1;
        }
        kept = still;
        if (kept == 1 || ++round == kRivals) return kept;
        if (one_line_suffices && line[chosen[0]] == line[chosen[kept - 1]]) return kept;

        // The next rival is the nearest of what is left of other lines.
        const std::int32_t last = line[rival];
        double least2 = kInfinity;
        for (std::size_t k = 0; k < kept; ++k) {
            const std::size_t j = chosen[k];
            const double d2 = ways[j / kLanes].length2[j % kLanes];
            const bool nearer = d2 < least2 && line[j] != last;
            rival = nearer ? j : rival;
            least2 = nearer ? d2 : least2;
        }
        if (least2 == kInfinity) return kept;
    }
}

/// Line, and arc length if wanted, of the nearest of the chosen candidates for each voxel of the
/// 4^3 block at `low`, which is an octant of the leaf whose values `line` and `arc` are. The same
/// arithmetic as distance2(), in the same order, so that ties fall the same way.
template <bool kArc>
SEKITEI_INLINE void nearest_in_octant(Coord low, const PolylineIndex::Candidates& c,
                                      const std::uint32_t* chosen, std::size_t n,
                                      std::int32_t* line, double* arc)
{
    constexpr int kEdge = kLeafEdge / 2;
    const Row zero{}, one = zero + 1.0;
    const Row z = Row{0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5} + double(low.z);
    const int first = leaf_offset(low);
    for (int pair = 0; pair < kEdge; pair += 2) {  // two rows along z at a time, four times in x
        const Row y = Row{0.5, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5} + double(low.y + pair);
        Row least[kEdge], along[kEdge];
        RowIds owner[kEdge];
        for (int i = 0; i < kEdge; ++i) {
            least[i] = zero + kInfinity;
            along[i] = zero;
            owner[i] = RowIds{} - 1;
        }
        for (std::size_t k = 0; k < n; ++k) {
            const Segment s = segment_of(c, chosen[k]);
            const Row py = y - s.a.y, pz = z - s.a.z;
            const Row by_y = py * s.d.y, by_z = pz * s.d.z;
            for (int i = 0; i < kEdge; ++i) {
                const double px = low.x + i + 0.5 - s.a.x;
                Row t = (px * s.d.x + by_y + by_z) * s.inverse_length2;
                t = t > zero ? t : zero;
                t = t < one ? t : one;
                const Row rx = px - s.d.x * t, ry = py - s.d.y * t, rz = pz - s.d.z * t;
                const Row d2 = rx * rx + ry * ry + rz * rz;
                const RowIds nearer = d2 < least[i];
                least[i] = nearer ? d2 : least[i];
                owner[i] = nearer ? RowIds{} + s.line : owner[i];
                if (kArc) along[i] = nearer ? s.arc0 + t * s.length : along[i];
            }
        }
        for (int i = 0; i < kEdge; ++i) {
            const int at = first + (i * kLeafEdge + pair) * kLeafEdge;
            const ShortRowIds ids = __builtin_convertvector(owner[i], ShortRowIds);
            std::memcpy(line + at, &ids, sizeof(ids) / 2);
            std::memcpy(line + at + kLeafEdge,
                        reinterpret_cast<const char*>(&ids) + sizeof(ids) / 2, sizeof(ids) / 2);
            if (!kArc) continue;
            std::memcpy(arc + at, &along[i], sizeof(Row) / 2);
            std::memcpy(arc + at + kLeafEdge,
                        reinterpret_cast<const char*>(&along[i]) + sizeof(Row) / 2,
                        sizeof(Row) / 2);
        }
    }
}

template <bool kArc>
SEKITEI_INLINE void nearest_in_octants(Coord origin, const PolylineIndex::Candidates& c, Work& work,
                                       std::int32_t* line, double* arc)
{
    constexpr int kEdge = kLeafEdge / 2;
    work.make_room(c.line.size());
    for (int octant = 0; octant < 8; ++octant) {
        const Coord low =
            origin + Coord(octant & 4 ? kEdge : 0, octant & 2 ? kEdge : 0, octant & 1 ? kEdge : 0);
        const std::size_t kept =
            cull(c, Vec3d(low) + Vec3d(kEdge * 0.5), (kEdge - 1) * 0.5, !kArc, work);
        const std::int32_t owner = kept > 0 ? c.line[work.chosen[0]] : -1;
        if (!kArc && (kept == 0 || owner == c.line[work.chosen[kept - 1]])) {
            for (int x = 0; x < kEdge; ++x)
                for (int y = 0; y < kEdge; ++y)
                    std::fill_n(line + leaf_offset(low + Coord(x, y, 0)), kEdge, owner);
            continue;
        }
        nearest_in_octant<kArc>(low, c, work.chosen.data(), kept, line, arc);
    }
}

SEKITEI_CLONES_512 void ids_in_leaf(Coord origin, const PolylineIndex::Candidates& c, Work& work,
                                    std::int32_t* line)
{
    nearest_in_octants<false>(origin, c, work, line, nullptr);
}

SEKITEI_CLONES_512 void ids_and_arcs_in_leaf(Coord origin, const PolylineIndex::Candidates& c,
                                             Work& work, std::int32_t* line, double* arc)
{
    nearest_in_octants<true>(origin, c, work, line, arc);
}

SEKITEI_CLONES_512 std::size_t cull_cube(const PolylineIndex::Candidates& c, Vec3d centre,
                                         double half, Work& work)
{
    return cull(c, centre, half, false, work);
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
    // A bit for each segment near by, so that they come out in order and once.
    thread_local std::vector<std::uint64_t> marks;
    thread_local std::vector<std::uint32_t> ids;
    marks.resize(std::max(marks.size(), s.segments.size() / 64 + 1));
    s.nearest_first(centre, reach2,
                    [&](std::uint32_t j) { marks[j / 64] |= std::uint64_t(1) << (j % 64); });
    ids.clear();
    for (std::size_t word = 0; word < s.segments.size() / 64 + 1; ++word) {
        for (std::uint64_t bits = marks[word]; bits != 0; bits &= bits - 1) {
            const auto j = static_cast<std::uint32_t>(word * 64) +
                           static_cast<std::uint32_t>(std::countr_zero(bits));
            if (distance2(centre, s.segments[j]) <= reach2) ids.push_back(j);
        }
        marks[word] = 0;
    }
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
    Work& work = work_of_this_thread();
    work.make_room(from.line.size());
    const std::size_t kept = cull_cube(from, centre, half, work);
    resize(out, kept);
    auto pick = [&](const auto& source, auto& target) {
        for (std::size_t k = 0; k < kept; ++k) target[k] = source[work.chosen[k]];
    };
    for (auto array : kGeometry) pick(from.*array, out.*array);
    pick(from.segments, out.segments);
    pick(from.arc0, out.arc0);
    pick(from.length, out.length);
    pick(from.line, out.line);
    set_lines(out);
}

void PolylineIndex::nearest_in_leaf(Coord origin, const Candidates& c, std::int32_t* line,
                                    double* arc)
{
    Work& work = work_of_this_thread();
    if (arc)
        ids_and_arcs_in_leaf(origin, c, work, line, arc);
    else
        ids_in_leaf(origin, c, work, line);
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
