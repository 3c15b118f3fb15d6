#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "solvers/tree/chains.h"
#include "solvers/tree/wood.h"

namespace sekitei::tree {
namespace {

using math::kPi;

// Shape of tubes, in radii where nothing else is said.
constexpr double kNearest = 0.7;  // stations of a bent limb that lie nearer become one
constexpr double kSpacing = 10;   // most between rings, in BarkParams::edge
constexpr double kFlare = 1.35;   // thickness of a side limb where it leaves its parent
constexpr double kHidden = 0.95;  // most of its parent's inscribed circle that it fills there
constexpr double kFlareLength = 2.5;
constexpr double kMiter = 1.5;   // most that a ring is widened across a bend
constexpr double kReach = 0.45;  // most of a piece of limb that a slanting ring takes up
constexpr double kPinch = 0.3;   // least of its width that it keeps for that
constexpr double kTurn = 0.2;    // a bend that a limb may have from ring to ring, if thick
constexpr double kSharp = 1;     // more is a kink
constexpr double kCone = 0.6;    // height of tips' ends

/// Where a ring goes.
struct Station {
    Vec3d at;
    double radius = 0;
    std::uint32_t branch = 0;  ///< of the piece above
};

struct Ring {
    Vec3d at, normal;    ///< of its plane, along the limb
    Vec3d right, ahead;  ///< axes in the plane, turned without twist; right = where it begins
    Vec3d across;        ///< unit, of the bend
    double widened = 1;  ///< along `across`
    double radius = 0, slope = 0, along = 0;  ///< slope: loss of radius along the limb
    std::uint32_t sides = 0, branch = 0;
};

/// u, across `from`, after the smallest turn that brings `from` to `to`.
Vec3d transported(Vec3d u, Vec3d from, Vec3d to)
{
    const double c = dot(from, to);
    Vec3d turned = c > -0.999 ? u - (from + to) * (dot(to, u) / (1 + c)) : u;
    turned -= to * dot(turned, to);
    const double size = length(turned);
    return size > 1e-6 ? turned / size : fork_axis(to);
}

class Tubes {
public:
    Tubes(const Branches& branches, std::span<const double> radius, double unit_length,
          const BarkParams& params)
        : branches_(branches),
          radius_(radius),
          unit_(unit_length),
          params_(params),
          chains_(chains_of(branches, radius, unit_length))
    {
    }

    TriMesh run(const Progress& progress) const
    {
        const std::size_t n = chains_.size();
        std::vector<std::uint64_t> vertices(n), triangles(n);
        parallel_for(
            n,
            [&](std::size_t c) {
                const std::vector<Ring> limb = rings(c);
                vertices[c] = 1;
                triangles[c] = limb.front().sides - 2 + limb.back().sides;
                for (std::size_t j = 0; j < limb.size(); ++j) {
                    vertices[c] += limb[j].sides;
                    if (j > 0) triangles[c] += limb[j].sides + limb[j - 1].sides;
                }
            },
            64);
        progress.update(0.3);
        const auto first_vertex = prefix_sum(vertices), first_triangle = prefix_sum(triangles);
        if (first_vertex.back() > std::numeric_limits<std::uint32_t>::max())
            throw LimitExceeded(
                fmt::format("tree: bark of {} vertices, a mesh holds at most 4294967295; use a "
                            "larger edge",
                            first_vertex.back()));
        TriMesh mesh;
        mesh.vertices.resize(first_vertex.back());
        mesh.triangles.resize(first_triangle.back());
        std::vector<Vec3f> normal(mesh.vertices.size());
        std::vector<float> radius(mesh.vertices.size());
        std::vector<std::int32_t> branch(mesh.triangles.size()), tree(mesh.triangles.size());
        std::array<std::vector<Vec3f>, 3> uv;
        for (auto& corner : uv) corner.resize(mesh.triangles.size());
        parallel_for(
            n,
            [&](std::size_t c) {
                progress.check();
                const std::vector<Ring> limb = rings(c);
                auto vertex = static_cast<std::uint32_t>(first_vertex[c]);
                std::size_t triangle = first_triangle[c];
                auto put = [&](std::array<std::uint32_t, 3> corners, std::array<Vec3f, 3> at,
                               std::uint32_t of) {
                    mesh.triangles[triangle] = corners;
                    for (std::size_t k = 0; k < 3; ++k) uv[k][triangle] = at[k];
                    branch[triangle] = static_cast<std::int32_t>(of);
                    tree[triangle] = branches_.tree[of];
                    ++triangle;
                };
                std::uint32_t below = vertex;
                for (std::size_t j = 0; j < limb.size(); ++j) {
                    const Ring& ring = limb[j];
                    const std::uint32_t first = vertex;
                    for (std::uint32_t i = 0; i < ring.sides; ++i, ++vertex) {
                        const Vec3d out = outwards(ring, i);
                        mesh.vertices[vertex] = Vec3f(ring.at + offset(ring, out));
                        normal[vertex] = Vec3f(normalized(out + ring.normal * ring.slope));
                        radius[vertex] = static_cast<float>(ring.radius);
                    }
                    if (j == 0)
                        for (std::uint32_t i = 1; i + 1 < ring.sides; ++i)
                            put({first, first + i + 1, first + i},
                                {flat(ring, 0), flat(ring, i + 1), flat(ring, i)}, ring.branch);
                    else
                        join(limb[j - 1], below, ring, first, put);
                    below = first;
                }
                const Ring& last = limb.back();
                const double cone =
                    branches_.is(last.branch, Branches::kTip) ? kCone * last.radius : 0;
                mesh.vertices[vertex] = Vec3f(last.at + last.normal * cone);
                normal[vertex] = Vec3f(last.normal);
                radius[vertex] = static_cast<float>(last.radius);
                const auto top = static_cast<float>(last.along + cone);
                for (std::uint32_t i = 0; i < last.sides; ++i) {
                    const Vec3f a = around(last, i), b = around(last, i + 1);
                    put({below + i, below + (i + 1) % last.sides, vertex},
                        {a, b, Vec3f((a.x + b.x) / 2, top, 0)}, last.branch);
                }
            },
            16);
        mesh.vertex_attributes["normal"] = std::move(normal);
        mesh.vertex_attributes["radius"] = std::move(radius);
        mesh.face_attributes["branch_id"] = std::move(branch);
        mesh.face_attributes["tree"] = std::move(tree);
        for (std::size_t k = 0; k < 3; ++k)
            mesh.face_attributes["uv_" + std::to_string(k)] = std::move(uv[k]);
        progress.update(1);
        return mesh;
    }

private:
    /// Triangles between two rings: whichever has its next corner first goes on.
    template <class Put>
    static void join(const Ring& a, std::uint32_t first_a, const Ring& b, std::uint32_t first_b,
                     Put&& put)
    {
        std::uint32_t i = 0, j = 0;
        while (i < a.sides || j < b.sides) {
            const std::uint32_t at = first_a + i % a.sides, bt = first_b + j % b.sides;
            if (j == b.sides ||
                (i < a.sides && std::uint64_t(i + 1) * b.sides <= std::uint64_t(j + 1) * a.sides)) {
                ++i;
                put({at, first_a + i % a.sides, bt}, {around(a, i - 1), around(a, i), around(b, j)},
                    a.branch);
            } else {
                ++j;
                put({at, first_b + j % b.sides, bt}, {around(a, i), around(b, j), around(b, j - 1)},
                    a.branch);
            }
        }
    }
    static Vec3d outwards(const Ring& ring, std::uint32_t i)
    {
        const double a = 2 * kPi * i / ring.sides;
        return ring.right * math::cos(a) + ring.ahead * math::sin(a);
    }
    static Vec3d offset(const Ring& ring, Vec3d out)
    {
        return (out + ring.across * (dot(out, ring.across) * (ring.widened - 1))) * ring.radius;
    }
    /// Metres around and along; the seam lies half a turn from 0.
    static Vec3f around(const Ring& ring, std::uint32_t i)
    {
        return Vec3f(Vec3d((double(i) / ring.sides - 0.5) * 2 * kPi * ring.radius, ring.along, 0));
    }
    /// Metres in the plane of a cap.
    static Vec3f flat(const Ring& ring, std::uint32_t i)
    {
        const Vec3d off = offset(ring, outwards(ring, i));
        return Vec3f(Vec3d(dot(off, ring.right), dot(off, ring.ahead), 0));
    }

    double joint(std::size_t branch) const
    {
        return end_radius(branches_, radius_, chains_, branch);
    }
    std::uint32_t corners(double radius) const
    {
        return static_cast<std::uint32_t>(std::clamp(2 * kPi * radius / params_.edge + 0.5,
                                                     double(params_.least_sides),
                                                     double(params_.most_sides)));
    }

    std::vector<Station> stations(std::size_t chain) const
    {
        const auto limb = chains_[chain];
        const double spacing = kSpacing * params_.edge;
        std::vector<Station> list;
        auto add = [&](Vec3d at, double radius, std::uint32_t branch) {
            list.push_back({at, radius, branch});
        };
        for (std::size_t k = 0; k < limb.size(); ++k) {
            const std::uint32_t b = limb[k];
            const double r0 = k == 0 ? radius_[b] : joint(limb[k - 1]), r1 = joint(b);
            // Limbs go on where they ended.
            const Vec3d from = (k == 0 ? branches_.start[b] : branches_.end(limb[k - 1])) * unit_;
            const Vec3d to = branches_.end(b) * unit_;
            const double size = length(to - from);
            std::vector<std::pair<double, double>> pieces;  // where, radius
            double done = 0;
            if (k == 0 && branches_.parent[b] >= 0) {
                // A side limb begins in the middle of its parent, and thicker than it goes on.
                const double parent = joint(std::size_t(branches_.parent[b]));
                const double hidden = kHidden * parent * math::cos(kPi / corners(parent));
                double first = std::min(r0, hidden);
                if (2 * kPi * r0 > 1.5 * params_.least_sides * params_.edge) {
                    first = std::min(kFlare * r0, hidden);
                    const double sine =
                        length(cross(normalized(to - from),
                                     branches_.direction[std::size_t(branches_.parent[b])]));
                    done = std::min(0.8 * size, kFlareLength * parent / std::max(sine, 0.35));
                    const double middle = std::max(0.0, 0.35 * (first - r0));
                    pieces.emplace_back(done / 2, r0 + (r1 - r0) * done / 2 / size + middle);
                    pieces.emplace_back(done, r0 + (r1 - r0) * done / size);
                }
                add(from, first, b);
            } else
                add(from, r0, b);
            const int more = static_cast<int>(std::ceil((size - done) / spacing - 1e-9));
            for (int i = 1; i < more; ++i) {
                const double s = done + (size - done) * i / more;
                pieces.emplace_back(s, r0 + (r1 - r0) * s / size);
            }
            for (const auto& [s, r] : pieces) add(from + (to - from) * (s / size), r, b);
            if (k + 1 == limb.size()) add(to, r1, b);
        }
        // Kinks shorter than the limb is thick would fold the bark over.
        std::vector<Station> kept{list.front()};
        for (std::size_t k = 1; k < list.size(); ++k) {
            const bool last = k + 1 == list.size();
            const double nearest = kNearest * list[k].radius;
            if (!last && length(list[k].at - kept.back().at) < nearest) {
                kept.back().branch = list[k].branch;
                continue;
            }
            if (last)
                while (kept.size() > 1 && length(list[k].at - kept.back().at) < nearest)
                    kept.pop_back();
            kept.push_back(list[k]);
        }
        return rounded(kept);
    }

    /// Cubic curves through the stations instead of lines, where bends of thick limbs would show.
    std::vector<Station> rounded(const std::vector<Station>& list) const
    {
        const std::size_t n = list.size();
        std::vector<Vec3d> way(n - 1);  // of the pieces
        for (std::size_t j = 0; j + 1 < n; ++j) way[j] = normalized(list[j + 1].at - list[j].at);
        auto turn = [&](std::size_t j) {  // angle at a station
            if (j == 0 || j + 1 == n) return 0.0;
            return math::atan2(length(cross(way[j - 1], way[j])), dot(way[j - 1], way[j]));
        };
        auto tangent = [&](std::size_t j) {
            return normalized(way[j > 0 ? j - 1 : 0] + way[std::min(j, n - 2)]);
        };
        std::vector<Station> fine;
        for (std::size_t j = 0; j < n; ++j) {
            fine.push_back(list[j]);
            if (j + 1 == n || corners(list[j].radius) <= std::uint32_t(params_.least_sides))
                continue;
            const Station &a = list[j], &b = list[j + 1];
            const double size = length(b.at - a.at);
            // Sharp bends, and those tighter than the limb is thick, stay as they are: the curve
            // would be tighter still.
            const double bend = std::max(turn(j), turn(j + 1));
            if (bend > kSharp || size < 2 * a.radius * bend) continue;
            const int parts = static_cast<int>(
                std::min(std::ceil(bend / kTurn), std::floor(size / (kNearest * a.radius))));
            const Vec3d da = tangent(j) * size, db = tangent(j + 1) * size;
            for (int i = 1; i < parts; ++i) {
                const double t = double(i) / parts, u = 1 - t;
                // Hermite's cubic.
                const Vec3d at = a.at * (u * u * (1 + 2 * t)) + b.at * (t * t * (1 + 2 * u)) +
                                 da * (u * u * t) - db * (t * t * u);
                fine.push_back({at, a.radius + (b.radius - a.radius) * t, a.branch});
            }
        }
        return fine;
    }

    std::vector<Ring> rings(std::size_t chain) const
    {
        const std::vector<Station> list = stations(chain);
        const std::size_t n = list.size();
        std::vector<Vec3d> way(n);  // of the piece above
        std::vector<double> size(n);
        for (std::size_t j = 0; j + 1 < n; ++j) {
            const Vec3d to = list[j + 1].at - list[j].at;
            size[j] = length(to);
            way[j] = size[j] > 0 ? to / size[j] : branches_.direction[list[j].branch];
        }
        way[n - 1] = way[n - 2];
        std::vector<Ring> rings(n);
        Vec3d right = fork_axis(way[0]);
        double along = 0;
        std::uint32_t sides = 0;
        double thickest = list[0].radius;
        if (n > 1) thickest = std::max(thickest, list[1].radius);
        for (std::size_t j = 0; j < n; ++j) {
            Ring& ring = rings[j];
            const Vec3d before = way[j > 0 ? j - 1 : 0], after = way[j];
            ring.at = list[j].at;
            ring.branch = list[std::min(j, n - 2)].branch;
            ring.radius = list[j].radius;
            ring.along = along;
            along += size[j];
            const Vec3d both = before + after;
            ring.normal = length(both) > 0.05 ? normalized(both) : before;
            ring.right = transported(right, before, ring.normal);
            ring.ahead = cross(ring.normal, ring.right);
            right = transported(right, before, after);
            // The plane that halves a bend cuts the limb aslant, in a longer ellipse.
            const double cosine = dot(ring.normal, after);
            const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
            if (j > 0 && j + 1 < n && sine > 1e-6) {
                ring.across = after - before;
                ring.across -= ring.normal * dot(ring.across, ring.normal);
                ring.across = normalized(ring.across);
                const double room = kReach * std::min(size[j - 1], size[j]) / (ring.radius * sine);
                ring.widened = std::max(kPinch, std::min({1 / std::max(cosine, 1 / kMiter), room}));
            }
            if (j + 1 < n && size[j] > 0)
                ring.slope = (list[j].radius - list[j + 1].radius) / size[j];
            else if (j > 0)
                ring.slope = rings[j - 1].slope;
            const std::uint32_t wanted = corners(j == 0 ? thickest : ring.radius);
            // Few steps from one number of sides to the next.
            if (sides == 0 || 4 * wanted <= 3 * sides ||
                wanted == std::uint32_t(params_.least_sides))
                sides = wanted;
            ring.sides = sides;
        }
        return rings;
    }

    const Branches& branches_;
    std::span<const double> radius_;
    double unit_;
    BarkParams params_;
    Chains chains_;
};

}  // namespace

TriMesh bark_tubes(const Branches& branches, std::span<const double> radius, double unit_length,
                   const BarkParams& params, const Progress& progress)
{
    if (!(params.edge > 0 && std::isfinite(params.edge)))
        throw InvalidParameter(
            fmt::format("tree: edge of the bark = {} m, must be > 0", params.edge));
    if (!(params.least_sides >= 3 && params.most_sides >= params.least_sides &&
          params.most_sides <= 1024))
        throw InvalidParameter(
            fmt::format("tree: least_sides = {}, most_sides = {}, must be 3 <= least_sides <= "
                        "most_sides <= 1024",
                        params.least_sides, params.most_sides));
    return Tubes(branches, radius, unit_length, params).run(progress);
}

}  // namespace sekitei::tree
