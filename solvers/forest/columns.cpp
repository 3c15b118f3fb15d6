#include <algorithm>
#include <bit>
#include <cmath>

#include "core/clones.h"
#include "solvers/forest/draw.h"

#define SEKITEI_INLINE __attribute__((always_inline)) inline

// A pixel has one word whose bit k - 1 is slice k. A cone's part in a pixel is a run of bits, from
// the lowest slice whose circle covers the pixel's centre to the tree's top: one visit instead of
// one a slice.
namespace sekitei::forest {
namespace {

constexpr double kTopSlack = 1e-9;  // a height of 3 m less a rounding still reaches slice 3

/// Slices lo..hi of a word.
SEKITEI_INLINE std::uint64_t run_of_bits(int lo, int hi)
{
    const std::uint64_t below_hi = hi >= 64 ? ~0ull : (1ull << hi) - 1;
    return below_hi & ~((1ull << (lo - 1)) - 1);
}

/// Inverted cones whose slices follow the ground: k is remembered from pixel to pixel.
struct InvertedCone {
    const Canvas& canvas;
    const double* reach = nullptr;
    int top = 1, k = 1;

    SEKITEI_INLINE void begin(const Claim& claim)
    {
        reach = canvas.reach[claim.tree->species].data();
        top = canvas.top(claim.height);
        k = top;
    }
    SEKITEI_INLINE bool slices(double squared, int, int, int& lo, int& hi)
    {
        if (squared > reach[top]) return false;
        while (k > 1 && squared <= reach[k - 1]) --k;
        while (squared > reach[k]) ++k;
        lo = k;
        hi = top;
        return true;
    }
    SEKITEI_INLINE int trunk_top() const { return top; }
};

/// Any orientation, on any ground.
struct AnyShape {
    const Canvas& canvas;
    double height = 0, slope = 1, ground = 0;
    bool absolute = false;
    int top = 1;

    SEKITEI_INLINE void begin(const Claim& claim)
    {
        height = claim.height;
        slope = canvas.slope[claim.tree->species];
        top = canvas.top(height);
        absolute = canvas.params.slice_frame == SliceFrame::Absolute && !canvas.land.flat();
        if (absolute)  // of an image across the border: that of its tree
            ground = canvas.land.height((claim.trunk_i % canvas.nx + canvas.nx) % canvas.nx,
                                        (claim.trunk_j % canvas.ny + canvas.ny) % canvas.ny);
    }
    /// Whether slice k, at k - down above the foot, covers a squared distance.
    SEKITEI_INLINE bool covers(int k, double down, double squared) const
    {
        const double z = double(k) - down;
        if (z < 0) return false;
        double r = 0;
        switch (canvas.params.orientation) {
            case Orientation::Inverted:
                r = z * slope;
                break;
            case Orientation::Upright:
                r = std::max(0.0, height - z) * slope;
                break;
            case Orientation::Flat:
                r = height * slope;
                break;
        }
        return squared <= r * r;
    }
    SEKITEI_INLINE bool slices(double squared, int i, int j, int& lo, int& hi) const
    {
        const double down = absolute ? ground - canvas.land.height(i, j) : 0;
        hi = absolute ? int(std::clamp(std::floor(std::max(1.0, height) + down + kTopSlack), 0.0,
                                       double(canvas.params.slices)))
                      : top;
        lo = std::max(1, int(std::min(65.0, std::ceil(down))));
        if (canvas.params.orientation == Orientation::Upright) {
            // The lowest slices are the widest.
            while (hi >= lo && !covers(hi, down, squared)) --hi;
            return hi >= lo;
        }
        // A little below where the circle should reach, then on to where it does.
        if (canvas.params.orientation == Orientation::Inverted)
            lo = std::max(lo, int(std::min(65.0, std::sqrt(squared) / slope + down - 1e-6)));
        while (lo <= hi && !covers(lo, down, squared)) ++lo;
        return lo <= hi;
    }
    SEKITEI_INLINE int trunk_top() const { return top; }
};

/// Visits all columns of a tile that a claim covers: f(i, j, first slice, last slice).
template <class Shape, class F>
SEKITEI_INLINE void each_column(const Canvas& canvas, const std::array<int, 4>& bounds,
                                const Claim& claim, Shape& shape, F&& f)
{
    const int i0 = bounds[0], i1 = bounds[1], j0 = bounds[2], j1 = bounds[3];
    const double p = canvas.params.pixel, radius = canvas.radius(*claim.tree);
    const double squared_radius = radius * radius * (1 + 1e-12) + 1e-300;
    const double row = claim.y / p - 0.5, column = claim.x / p - 0.5, across = radius / p;
    shape.begin(claim);
    auto low = [](double v, int least) { return v <= double(least) ? least : int(std::floor(v)); };
    auto high = [](double v, int most) { return v >= double(most) ? most : int(std::ceil(v)); };
    int first = low(row - across, j0), last = high(row + across, j1 - 1);
    if (claim.trunk_j >= j0 && claim.trunk_j < j1) {
        first = std::min(first, claim.trunk_j);
        last = std::max(last, claim.trunk_j);
    }
    for (int j = first; j <= last; ++j) {
        const double dy = (double(j) + 0.5) * p - claim.y, dy2 = dy * dy;
        int from = i1, to = i0 - 1;
        if (dy2 <= squared_radius) {
            const double half = std::sqrt(squared_radius - dy2) / p;
            from = low(column - half, i0);
            to = high(column + half, i1 - 1);
        }
        const bool trunk_row = j == claim.trunk_j && claim.trunk_i >= i0 && claim.trunk_i < i1;
        if (trunk_row) {
            from = std::min(from, claim.trunk_i);
            to = std::max(to, claim.trunk_i);
        }
        for (int i = from; i <= to; ++i) {
            int lo = 1, hi = 0;
            if (trunk_row && i == claim.trunk_i) {
                hi = shape.trunk_top();
            } else {
                const double dx = (double(i) + 0.5) * p - claim.x;
                if (!shape.slices(dx * dx + dy2, i, j, lo, hi)) continue;
            }
            f(i, j, lo, hi);
        }
    }
}

/// Density of a tile: one value a band where it has only one.
struct Weights {
    bool same = true;  ///< one value for all bands and pixels
    std::uint64_t all = 65535;
    std::vector<std::uint16_t> constant;
    std::vector<std::vector<std::uint16_t>> values;  ///< empty where constant
    std::vector<std::uint64_t> bits;                 ///< slices of each band

    Weights(const Canvas& canvas, const std::array<int, 4>& bounds)
    {
        const int i0 = bounds[0], i1 = bounds[1], j0 = bounds[2], j1 = bounds[3];
        const std::size_t bands = canvas.density.size();
        constant.resize(bands);
        values.resize(bands);
        for (std::size_t b = 0; b < bands; ++b) {
            const int lo = int(b) * canvas.params.band + 1,
                      hi = std::min(canvas.params.slices, lo + canvas.params.band - 1);
            bits.push_back(run_of_bits(lo, hi));
            const DensityMap& map = canvas.density[b];
            if (!map.constant(i0, i1, j0, j1, constant[b])) {
                same = false;
                values[b].reserve(std::size_t(i1 - i0) * std::size_t(j1 - j0));
                for (int j = j0; j < j1; ++j)
                    for (int i = i0; i < i1; ++i) values[b].push_back(map.at(i, j));
            }
            same = same && constant[b] == constant[0];
        }
        if (same) all = constant[0];
    }
    SEKITEI_INLINE std::uint64_t of(std::uint64_t taken, std::size_t pixel) const
    {
        if (same) return all * std::uint64_t(std::popcount(taken));
        std::uint64_t sum = 0;
        for (std::size_t b = 0; b < bits.size(); ++b)
            if (const std::uint64_t here = taken & bits[b])
                sum += std::uint64_t(values[b].empty() ? constant[b] : values[b][pixel]) *
                       std::uint64_t(std::popcount(here));
        return sum;
    }
};

/// Slices that rock takes before any tree.
template <class Word>
std::vector<Word> rocks(const Canvas& canvas, const std::array<int, 4>& bounds)
{
    const int i0 = bounds[0], i1 = bounds[1], j0 = bounds[2], j1 = bounds[3];
    std::vector<Word> taken(std::size_t(i1 - i0) * std::size_t(j1 - j0), 0);
    const Raster<float>& blocked = canvas.land.blocked_height;
    float none = 0;
    if (blocked.empty() || (blocked.constant(i0, i1, j0, j1, none) && !(none > 0))) return taken;
    for (int j = j0; j < j1; ++j)
        for (int i = i0; i < i1; ++i)
            if (const double high = std::min(64.0, std::ceil(double(blocked.at(i, j)) - kTopSlack));
                high >= 1)
                taken[std::size_t(j - j0) * std::size_t(i1 - i0) + std::size_t(i - i0)] =
                    static_cast<Word>(run_of_bits(1, int(high)));
    return taken;
}

SEKITEI_INLINE void draw(const Canvas& canvas, const std::array<int, 4>& bounds,
                         const std::vector<Claim>& claims, std::vector<Gain>& gains)
{
    const int i0 = bounds[0], i1 = bounds[1], j0 = bounds[2];
    const Weights weights(canvas, bounds);
    std::vector<std::uint64_t> taken = rocks<std::uint64_t>(canvas, bounds);
    const auto width = std::size_t(i1 - i0);
    AnyShape shape{canvas};
    for (std::size_t c = 0; c < claims.size(); ++c) {
        Gain gain;
        each_column(canvas, bounds, claims[c], shape, [&](int i, int j, int lo, int hi) {
            const std::size_t pixel = std::size_t(j - j0) * width + std::size_t(i - i0);
            const std::uint64_t wanted = run_of_bits(lo, hi);
            const std::uint64_t got = wanted & ~taken[pixel];
            gain.cone += static_cast<std::uint32_t>(hi - lo + 1);
            if (got == 0) return;
            taken[pixel] |= wanted;
            gain.kept += weights.of(got, pixel);
        });
        gains[c] = gain;
    }
}

/// The same for inverted cones on slices that follow the ground: the hot loop. The lowest slice of
/// a pixel, the smallest k with squared <= (k t)^2, comes from a root that may be one too small, so
/// that nothing branches but the ends of rows.
template <class Word, bool kSame>
SEKITEI_INLINE void draw_inverted(const Canvas& canvas, const std::array<int, 4>& bounds,
                                  const Weights& weights, const std::vector<Claim>& claims,
                                  std::vector<Gain>& gains)
{
    const int i0 = bounds[0], i1 = bounds[1], j0 = bounds[2], j1 = bounds[3];
    const auto width = std::size_t(i1 - i0);
    const double p = canvas.params.pixel;
    std::vector<Word> taken = rocks<Word>(canvas, bounds);
    for (std::size_t c = 0; c < claims.size(); ++c) {
        const Claim& claim = claims[c];
        const std::size_t kind = claim.tree->species;
        const double* const reach = canvas.reach[kind].data();
        const double per_slice = 1 / canvas.slope[kind];
        const int top = canvas.top(claim.height);
        const double limit = reach[top], radius = double(top) * canvas.slope[kind];
        const auto all = static_cast<Word>(run_of_bits(1, top));
        std::uint64_t kept = 0;
        std::uint32_t cone = 0;
        auto take = [&](std::size_t pixel, Word wanted) {
            const auto got = static_cast<Word>(wanted & ~taken[pixel]);
            taken[pixel] = static_cast<Word>(taken[pixel] | wanted);
            if constexpr (kSame)
                kept += std::uint64_t(std::popcount(got));
            else
                kept += weights.of(got, pixel);
        };
        const bool trunk =
            claim.trunk_i >= i0 && claim.trunk_i < i1 && claim.trunk_j >= j0 && claim.trunk_j < j1;
        if (trunk) {
            take(std::size_t(claim.trunk_j - j0) * width + std::size_t(claim.trunk_i - i0), all);
            cone += static_cast<std::uint32_t>(top);
        }
        const double row = claim.y / p - 0.5, column = claim.x / p - 0.5, across = radius / p;
        const int first = int(std::max(double(j0), std::floor(row - across))),
                  last = int(std::min(double(j1 - 1), std::ceil(row + across)));
        for (int j = first; j <= last; ++j) {
            const double dy = (double(j) + 0.5) * p - claim.y, dy2 = dy * dy;
            if (dy2 > limit) continue;
            auto squared = [&](int i) {
                const double dx = (double(i) + 0.5) * p - claim.x;
                return dx * dx + dy2;
            };
            const double half = std::sqrt(limit - dy2) / p;
            int from = int(std::max(double(i0), std::floor(column - half))),
                to = int(std::min(double(i1 - 1), std::ceil(column + half)));
            while (from <= to && squared(from) > limit) ++from;
            while (from <= to && squared(to) > limit) --to;
            Word* const line = taken.data() + std::size_t(j - j0) * width;
            auto span = [&](int begin, int end) {
                for (int i = begin; i < end; ++i) {
                    const double d2 = squared(i);
                    int lo = std::max(1, int(std::sqrt(d2) * per_slice));
                    lo += d2 > reach[lo];
                    lo += d2 > reach[lo];
                    const auto wanted =
                        static_cast<Word>(all & ~((std::uint64_t(1) << (lo - 1)) - 1));
                    cone += static_cast<std::uint32_t>(top - lo + 1);
                    take(std::size_t(line - taken.data()) + std::size_t(i - i0), wanted);
                }
            };
            if (trunk && j == claim.trunk_j) {
                span(from, std::min(to + 1, claim.trunk_i));
                span(std::max(from, claim.trunk_i + 1), to + 1);
            } else
                span(from, to + 1);
        }
        gains[c] = {kSame ? kept * weights.all : kept, cone};
    }
}

template <class Word>
SEKITEI_INLINE void draw_plain(const Canvas& canvas, const std::array<int, 4>& bounds,
                               const std::vector<Claim>& claims, std::vector<Gain>& gains)
{
    const Weights weights(canvas, bounds);
    if (weights.same)
        draw_inverted<Word, true>(canvas, bounds, weights, claims, gains);
    else
        draw_inverted<Word, false>(canvas, bounds, weights, claims, gains);
}

bool plain(const Canvas& canvas)
{
    return canvas.params.orientation == Orientation::Inverted &&
           (canvas.params.slice_frame == SliceFrame::Ground || canvas.land.flat());
}

SEKITEI_CLONES void draw_plain_32(const Canvas& canvas, const std::array<int, 4>& bounds,
                                  const std::vector<Claim>& claims, std::vector<Gain>& gains)
{
    draw_plain<std::uint32_t>(canvas, bounds, claims, gains);
}
SEKITEI_CLONES void draw_plain_64(const Canvas& canvas, const std::array<int, 4>& bounds,
                                  const std::vector<Claim>& claims, std::vector<Gain>& gains)
{
    draw_plain<std::uint64_t>(canvas, bounds, claims, gains);
}
SEKITEI_CLONES void draw_any(const Canvas& canvas, const std::array<int, 4>& bounds,
                             const std::vector<Claim>& claims, std::vector<Gain>& gains)
{
    draw(canvas, bounds, claims, gains);
}

template <class Shape>
void visit(const Canvas& canvas, const std::array<int, 4>& bounds, const std::vector<Claim>& claims,
           const OwnedVisitor& f)
{
    const int i0 = bounds[0], i1 = bounds[1], j0 = bounds[2];
    std::vector<std::uint64_t> taken = rocks<std::uint64_t>(canvas, bounds);
    const auto width = std::size_t(i1 - i0);
    Shape shape{canvas};
    for (const Claim& claim : claims)
        each_column(canvas, bounds, claim, shape, [&](int i, int j, int lo, int hi) {
            std::uint64_t& word = taken[std::size_t(j - j0) * width + std::size_t(i - i0)];
            const std::uint64_t got = run_of_bits(lo, hi) & ~word;
            word |= got;
            if (got != 0) f(*claim.tree, i, j, got);
        });
}

}  // namespace

Canvas::Canvas(const Params& p, const Land& l, const std::vector<DensityMap>& d,
               const std::vector<double>& s, int width, int depth)
    : params(p), land(l), density(d), slope(s), nx(width), ny(depth)
{
    for (const double t : slope) {
        std::vector<double>& squares = reach.emplace_back();
        // One more than there are: who looks for the lowest slice may look one too far.
        for (int k = 0; k <= params.slices + 1; ++k) {
            const double r = double(k) * t;
            squares.push_back(r * r);
        }
    }
}

int Canvas::top(double height) const
{
    return std::max(1, int(std::min(double(params.slices), std::floor(height + kTopSlack))));
}

double Canvas::radius(const Tree& tree) const
{
    const double t = slope[tree.species];
    if (params.orientation == Orientation::Inverted &&
        (params.slice_frame == SliceFrame::Ground || land.flat()))
        return double(top(tree.height)) * t;
    return std::max(1.0, tree.height + kTopSlack) * t;
}

void draw_columns(const Canvas& canvas, const std::array<int, 4>& bounds,
                  const std::vector<Claim>& claims, std::vector<Gain>& gains)
{
    gains.resize(claims.size());
    if (!plain(canvas))
        draw_any(canvas, bounds, claims, gains);
    else if (canvas.params.slices <= 32)
        draw_plain_32(canvas, bounds, claims, gains);
    else
        draw_plain_64(canvas, bounds, claims, gains);
}

void visit_columns(const Canvas& canvas, const std::array<int, 4>& bounds,
                   const std::vector<Claim>& claims, const OwnedVisitor& f)
{
    if (plain(canvas))
        visit<InvertedCone>(canvas, bounds, claims, f);
    else
        visit<AnyShape>(canvas, bounds, claims, f);
}

}  // namespace sekitei::forest
