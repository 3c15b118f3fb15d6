#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/clones.h"
#include "core/error.h"
#include "core/inline_math.h"
#include "core/math.h"
#include "core/parallel.h"
#include "solvers/tree/crown_shade.h"

namespace sekitei::tree {
namespace {

constexpr int kEdge = 8;           ///< of a brick [voxels]
constexpr int kNodes = kEdge + 1;  ///< along it, those of the next one included
constexpr int kNumbers = kNodes * kNodes * kNodes;
constexpr int kWords = kEdge * kNodes * kNodes;
constexpr double kStep = 0.5;  ///< of half-lines [voxels]
constexpr double kSharp = 24;  ///< voxels of a half-line before those twice as wide
constexpr int kCoarsest = 4;   ///< times the finest
constexpr double kDark = 10;   ///< optical depth that ends a half-line
constexpr double kMostBytes = 4.0 * (1u << 30);
constexpr int kLanes = 16;

/// Boxes of one edge, side by side.
struct Boxes {
    Vec3d lower;
    double edge = 1;
    Coord count{1, 1, 1};

    Boxes(const Bounds& bounds, double size, const char* what) : lower(bounds.lower), edge(size)
    {
        const Vec3d n = bounds.size() / edge;
        const double all = (n.x + 1) * (n.y + 1) * (n.z + 1);
        if (all * 4 > kMostBytes / 8)
            throw LimitExceeded(fmt::format(
                "tree: method = grid needs {} for {} of crowns so far apart, must be below {}; "
                "method = sweep needs none",
                bytes_text(all * 4), what, bytes_text(kMostBytes / 8)));
        count = Coord(1) + Coord(n);
    }
    std::size_t size() const
    {
        return static_cast<std::size_t>(count.x) * static_cast<std::size_t>(count.y) *
               static_cast<std::size_t>(count.z);
    }
    std::size_t index(Coord c) const
    {
        return (static_cast<std::size_t>(c.z) * static_cast<std::size_t>(count.y) +
                static_cast<std::size_t>(c.y)) *
                   static_cast<std::size_t>(count.x) +
               static_cast<std::size_t>(c.x);
    }
    /// The box of a place; that nearest to it if it lies outside.
    Coord at(Vec3d p) const
    {
        const Vec3d q = (p - lower) / edge, last(count - Coord(1));
        return Coord(max(Vec3d(0), min(q, last)));
    }
};

/// Calls f(c) for all coordinates from a to b.
template <class F>
void for_box(Coord a, Coord b, F&& f)
{
    Coord c;
    for (c.z = a.z; c.z <= b.z; ++c.z)
        for (c.y = a.y; c.y <= b.y; ++c.y)
            for (c.x = a.x; c.x <= b.x; ++c.x) f(c);
}

/// Extinction at the nodes of a brick, of 16 bits. A word holds a node and, above it, the next one
/// along x, so that four words are all that trilinear interpolation asks for.
struct Brick {
    float unit = 0;
    std::array<std::int32_t, kWords> words;
};

/// Places within a brick as integers, 2^-kBits voxels: compilers clamp those side by side.
constexpr int kBits = 23, kOne = 1 << kBits;

/// Adds to `sums` the extinction at `count` places p, p + d, p + 2 d ... within a brick, kLanes
/// side by side.
SEKITEI_CLONES_512 void sum_brick(const std::int32_t* __restrict words, float unit, Coord p,
                                  Coord d, int count, float* __restrict sums)
{
    constexpr int kLast = kEdge * kOne - 1, kUp = kEdge * kNodes;
    constexpr float kFine = 1.0F / kOne;
    for (int from = 0; from < count; from += kLanes)
        for (int lane = 0; lane < kLanes; ++lane) {
            const int k = from + lane;
            const int x = std::min(std::max(p.x + k * d.x, 0), kLast),
                      y = std::min(std::max(p.y + k * d.y, 0), kLast),
                      z = std::min(std::max(p.z + k * d.z, 0), kLast);
            const float fx = kFine * static_cast<float>(x & (kOne - 1)),
                        fy = kFine * static_cast<float>(y & (kOne - 1)),
                        fz = kFine * static_cast<float>(z & (kOne - 1));
            const int n = ((z >> kBits) * kNodes + (y >> kBits)) * kEdge + (x >> kBits);
            auto along = [fx](std::int32_t word) __attribute__((always_inline))
            {
                const auto here = static_cast<float>(word & 0xFFFF),
                           next = static_cast<float>((word >> 16) & 0xFFFF);
                return here + fx * (next - here);
            };
            const float a = along(words[n]), b = along(words[n + kEdge]), c = along(words[n + kUp]),
                        e = along(words[n + kUp + kEdge]), low = a + fy * (b - a),
                        high = c + fy * (e - c);
            sums[lane] += static_cast<float>(k < count) * (unit * (low + fz * (high - low)));
        }
}

/// Sum of all lanes.
double total(const std::array<float, kLanes>& sums)
{
    std::array<float, kLanes> s = sums;
    for (int half = kLanes / 2; half > 0; half /= 2)
        for (int i = 0; i < half; ++i)
            s[static_cast<std::size_t>(i)] += s[static_cast<std::size_t>(i + half)];
    return static_cast<double>(s[0]);
}

/// Takes the chord of a ball out of each half-line; where it shades by the rule, adds `depth`.
SEKITEI_CLONES_512 void cut_chords(const double* __restrict x, const double* __restrict y,
                                   const double* __restrict z, std::size_t n, Vec3d d, double r2,
                                   double kappa, double depth, Occlusion occlusion,
                                   double* __restrict cut, double* __restrict shade)
{
    const double d2 = dot(d, d);
    const bool within = d2 <= r2;
    const double always = within && occlusion == Occlusion::Full ? depth : 0;
    if (within && occlusion != Occlusion::Ahead) depth = 0;
    for (std::size_t p = 0; p < n; ++p) {
        const double t = d.x * x[p] + d.y * y[p] + d.z * z[p], rest = r2 - (d2 - t * t);
        const double half = std::sqrt(rest > 0 ? rest : 0);
        const double far = t + half > 0 ? t + half : 0, near = t - half > 0 ? t - half : 0;
        cut[p] += kappa * (far - near);
        shade[p] += always + ((rest >= 0) & (t > 0) ? depth : 0);
    }
}

SEKITEI_CLONES_512 void exponentials(double* share, std::size_t n)
{
    for (std::size_t p = 0; p < n; ++p) share[p] = math::inline_exp(-share[p]);
}

}  // namespace

/// Extinction at the nodes of a lattice, in bricks; empty bricks take no place.
struct ExtinctionGrid::Bricks {
    double voxel = 1;
    Boxes boxes;
    std::vector<std::int32_t> index;  ///< brick of a box; -1: empty
    std::vector<Brick> bricks;        ///< of kappa times coverage [1/voxel]

    Bricks(const Balls& balls, double h, const Bounds& bounds, double per_length,
           const Progress& progress)
        : voxel(h), boxes(bounds, kEdge * h, "bricks"), index(boxes.size(), -1)
    {
        // Which balls touch which bricks, in the order of the balls.
        auto nodes_of = [&](std::size_t j) {
            const Vec3d p = (balls.centre[j] - boxes.lower) / voxel;
            const double reach = balls.radius[j] / voxel + 0.5;
            const Vec3d a = p - Vec3d(reach), b = p + Vec3d(reach);
            return std::pair{Coord(Vec3d(std::ceil(a.x), std::ceil(a.y), std::ceil(a.z))),
                             Coord(Vec3d(std::floor(b.x), std::floor(b.y), std::floor(b.z)))};
        };
        auto for_bricks = [&](std::size_t j, auto&& f) {
            const auto [a, b] = nodes_of(j);
            // Node 8 of a brick is node 0 of the next.
            for_box({(a.x - 1) / kEdge, (a.y - 1) / kEdge, (a.z - 1) / kEdge},
                    {b.x / kEdge, b.y / kEdge, b.z / kEdge},
                    [&](Coord c) { f(c, boxes.index(c)); });
        };
        double pairs = 0;
        for (const double r : balls.radius) {
            const double side = 2 * r / (kEdge * voxel) + 1;
            pairs += side * side * side;
        }
        if (pairs * 4 > kMostBytes / 4)
            throw LimitExceeded(
                "tree: method = grid needs radii that differ less, say 4 : 1; method = bvh does "
                "not");
        std::vector<Coord> place;
        std::vector<std::uint32_t> members;
        for (std::size_t j = 0; j < balls.size(); ++j)
            for_bricks(j, [&](Coord c, std::size_t box) {
                if (index[box] < 0) {
                    index[box] = static_cast<std::int32_t>(place.size());
                    place.push_back(c);
                    members.push_back(0);
                }
                ++members[static_cast<std::size_t>(index[box])];
            });
        const double bytes = static_cast<double>(place.size()) * sizeof(Brick);
        if (bytes > kMostBytes / 2)
            throw LimitExceeded(fmt::format(
                "tree: method = grid needs {} for {} bricks, must be below {}; method = sweep "
                "needs none",
                bytes_text(bytes), count_text(static_cast<double>(place.size())),
                bytes_text(kMostBytes / 2)));
        const std::vector<std::uint32_t> begin = prefix_sum(members);
        std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1), member(begin.back());
        for (std::size_t j = 0; j < balls.size(); ++j)
            for_bricks(j, [&](Coord, std::size_t box) {
                member[next[static_cast<std::size_t>(index[box])]++] =
                    static_cast<std::uint32_t>(j);
            });

        // A voxel's coverage by its distance from the surface, scaled so that each ball has all of
        // its volume.
        auto coverage = [&](std::size_t j, Vec3d centre, Coord node) {
            const double away = length(Vec3d(node) - centre);
            return std::clamp(0.5 + balls.radius[j] / voxel - away, 0.0, 1.0);
        };
        std::vector<double> scale(balls.size());
        parallel_for(
            balls.size(),
            [&](std::size_t j) {
                const auto [a, b] = nodes_of(j);
                const Vec3d centre = (balls.centre[j] - boxes.lower) / voxel;
                double sum = 0;
                for_box(a, b, [&](Coord c) { sum += coverage(j, centre, c); });
                const double r = balls.radius[j] / voxel;
                // kappa = -ln tau / (4 r / 3) times the volume 4/3 pi r^3
                scale[j] = sum > 0 ? per_length * math::kPi * r * r / sum : 0;
            },
            256);
        progress.check();
        bricks.resize(place.size());
        parallel_for(place.size(), [&](std::size_t k) {
            if (k % 64 == 0) progress.check();
            std::array<double, kNumbers> sum{};
            const Coord first = {place[k].x * kEdge, place[k].y * kEdge, place[k].z * kEdge},
                        last = first + Coord(kEdge);
            for (std::uint32_t m = begin[k]; m < begin[k + 1]; ++m) {
                const std::size_t j = member[m];
                const auto [a, b] = nodes_of(j);
                const Vec3d centre = (balls.centre[j] - boxes.lower) / voxel;
                for_box(max(a, first), min(b, last), [&](Coord c) {
                    const Coord l = c - first;
                    sum[static_cast<std::size_t>((l.z * kNodes + l.y) * kNodes + l.x)] +=
                        scale[j] * coverage(j, centre, c);
                });
            }
            const double unit = *std::max_element(sum.begin(), sum.end()) / 0xFFFF;
            if (unit == 0) return;
            bricks[k].unit = static_cast<float>(unit);
            auto of = [&](std::size_t row, std::size_t i) {
                return static_cast<std::uint32_t>(sum[row * kNodes + i] / unit + 0.5);
            };
            for (std::size_t row = 0; row < kNodes * kNodes; ++row)
                for (std::size_t i = 0; i < kEdge; ++i)
                    bricks[k].words[row * kEdge + i] =
                        static_cast<std::int32_t>(of(row, i) | of(row, i + 1) << 16);
        });
    }

    /// Optical depth of the part of a half-line from `begin` to `end`; those above `most` are as
    /// good as each other.
    double depth(Vec3d at, Vec3d way, double begin, double end_at, double most) const
    {
        const Vec3d from = (at - boxes.lower) / voxel;
        double enter = begin / voxel, leave = end_at / voxel;
        std::array<double, 3> next{}, every{};
        for (int a = 0; a < 3; ++a) {
            const double end = static_cast<double>(boxes.count[a]) * kEdge;
            if (way[a] == 0) {
                if (!(from[a] >= 0 && from[a] < end)) return 0;
                continue;
            }
            const double low = -from[a] / way[a], high = (end - from[a]) / way[a];
            enter = std::max(enter, std::min(low, high));
            leave = std::min(leave, std::max(low, high));
        }
        if (!(enter < leave)) return 0;
        Coord box;
        for (int a = 0; a < 3; ++a) {
            const double p = (from[a] + way[a] * enter) / kEdge;
            box[a] = std::clamp(static_cast<std::int32_t>(p), 0, boxes.count[a] - 1);
            const double side = static_cast<double>(box[a] + (way[a] > 0)) * kEdge;
            next[static_cast<std::size_t>(a)] = way[a] == 0 ? INFINITY : (side - from[a]) / way[a];
            every[static_cast<std::size_t>(a)] = way[a] == 0 ? 0 : kEdge / std::abs(way[a]);
        }
        // Steps have their places along the whole half-line; each brick takes those within it.
        auto step_at = [](double s) { return std::ceil(s / kStep - 0.5); };
        std::array<float, kLanes> sums{};
        const Coord stride(way * (kStep * kOne));
        double s = enter;
        unsigned met = 0;
        while (true) {
            const int a =
                next[0] < next[1] ? (next[0] < next[2] ? 0 : 2) : (next[1] < next[2] ? 1 : 2);
            const double exit = std::min(next[static_cast<std::size_t>(a)], leave);
            if (const std::int32_t brick = index[boxes.index(box)]; brick >= 0) {
                const double k = step_at(s), count = step_at(exit) - k;
                if (count > 0) {
                    const Vec3d p =
                        from + way * ((k + 0.5) * kStep) - Vec3d(box) * static_cast<double>(kEdge);
                    const Brick& its = bricks[static_cast<std::size_t>(brick)];
                    sum_brick(its.words.data(), its.unit, Coord(p * kOne), stride,
                              static_cast<int>(count), sums.data());
                    if (++met % 8 == 0 && total(sums) * kStep > most) break;
                }
            }
            if (exit == leave) break;
            s = exit;
            box[a] += way[a] > 0 ? 1 : -1;
            if (box[a] < 0 || box[a] >= boxes.count[a]) break;
            next[static_cast<std::size_t>(a)] += every[static_cast<std::size_t>(a)];
        }
        return total(sums) * kStep;
    }
};

/// Balls by place, for those that are near.
struct ExtinctionGrid::Near {
    const SkyPatches& sky;
    const Balls& balls;
    double absorbed;  ///< -ln tau
    Occlusion occlusion;
    double reach;
    Boxes boxes;
    std::vector<std::uint32_t> begin, member;
    std::vector<double> x, y, z;  ///< of the patches

    Near(const SkyPatches& s, const Balls& b, double depth, Occlusion rule, const Bounds& bounds,
         double largest)
        : sky(s),
          balls(b),
          absorbed(depth),
          occlusion(rule),
          reach(2 * largest),
          boxes(bounds, reach, "cells")
    {
        std::vector<std::uint32_t> count(boxes.size());
        for (const Vec3d p : balls.centre) ++count[boxes.index(boxes.at(p))];
        begin = prefix_sum(count);
        std::vector<std::uint32_t>& next = count;
        next.assign(begin.begin(), begin.end() - 1);
        member.resize(balls.size());
        for (std::uint32_t j = 0; j < balls.size(); ++j)
            member[next[boxes.index(boxes.at(balls.centre[j]))]++] = j;
        for (const Vec3d d : sky.direction) {
            x.push_back(d.x), y.push_back(d.y), z.push_back(d.z);
        }
    }

    /// @param cut    depth that the own and the near balls have in the grid
    /// @param shade  depth of the near balls by the rule
    void sum(Vec3d at, std::uint32_t own, std::span<double> cut, std::span<double> shade) const
    {
        auto add = [&](std::uint32_t j, double depth) {
            const double r = balls.radius[j];
            cut_chords(x.data(), y.data(), z.data(), sky.size(), balls.centre[j] - at, r * r,
                       absorbed / (4 * r / 3), depth, occlusion, cut.data(), shade.data());
        };
        if (own != Lookers::kNoBall) add(own, 0);
        for_box(boxes.at(at - Vec3d(reach)), boxes.at(at + Vec3d(reach)), [&](Coord c) {
            const std::size_t box = boxes.index(c);
            for (std::uint32_t m = begin[box]; m < begin[box + 1]; ++m) {
                const std::uint32_t j = member[m];
                const Vec3d d = balls.centre[j] - at;
                if (j != own && dot(d, d) <= 4 * balls.radius[j] * balls.radius[j])
                    add(j, absorbed);
            }
        });
    }
};

ExtinctionGrid::ExtinctionGrid(const SkyPatches& sky, const Balls& balls, double transmission,
                               Occlusion occlusion, const Progress& progress)
{
    if (balls.size() == 0 || transmission == 1) return;  // nothing in the way
    Bounds bounds;
    double smallest = INFINITY, largest = 0, mean = 0;
    for (std::size_t j = 0; j < balls.size(); ++j) {
        const double r = balls.radius[j];
        smallest = std::min(smallest, r), largest = std::max(largest, r), mean += r;
        bounds.add(balls.centre[j] - Vec3d(r));
        bounds.add(balls.centre[j] + Vec3d(r));
    }
    mean /= static_cast<double>(balls.size());
    // Half a radius; single small balls do not make it finer for all.
    const double voxel = std::max(smallest, mean / 4) / 2, absorbed = -math::log(transmission);
    const double farthest = std::max({-bounds.lower.x, -bounds.lower.y, -bounds.lower.z,
                                      bounds.upper.x, bounds.upper.y, bounds.upper.z});
    if (farthest > 1e9 * voxel)
        throw LimitExceeded(
            fmt::format("tree: method = grid cannot tell radii of {} as far out as {}; method = "
                        "sweep does",
                        smallest, farthest));
    bounds.lower -= Vec3d(2 * voxel * kCoarsest);
    bounds.upper += Vec3d(2 * voxel * kCoarsest);
    for (double h = voxel; h <= voxel * kCoarsest; h *= 2)
        bricks_.push_back(std::make_unique<Bricks>(balls, h, bounds, absorbed, progress));
    near_ = std::make_unique<Near>(sky, balls, absorbed, occlusion, bounds, largest);
}
ExtinctionGrid::~ExtinctionGrid() = default;

void ExtinctionGrid::shade(Vec3d at, std::uint32_t own, std::span<double> share) const
{
    if (bricks_.empty()) {
        std::fill(share.begin(), share.end(), 1.0);
        return;
    }
    const SkyPatches& sky = near_->sky;
    std::vector<double> cut(sky.size());
    std::fill(share.begin(), share.end(), 0.0);
    near_->sum(at, own, cut, share);
    for (std::size_t p = 0; p < sky.size(); ++p) {
        double depth = 0, begin = 0;
        for (const auto& level : bricks_) {
            const double end = level == bricks_.back() ? INFINITY : kSharp * level->voxel;
            depth += level->depth(at, sky.direction[p], begin, end, kDark + cut[p] - depth);
            if (depth > kDark + cut[p]) break;
            begin = end;
        }
        share[p] += std::max(0.0, depth - cut[p]);
    }
    exponentials(share.data(), share.size());
}

}  // namespace sekitei::tree
