#include "core/mesh_sites.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

#include "core/error.h"
#include "core/log.h"
#include "core/mesh_sides.h"
#include "core/parallel.h"

namespace sekitei {
namespace {

using Triangle = std::array<std::uint32_t, 3>;

constexpr double kLeastArea = 1e-12;  ///< what is smaller has no direction to speak of [m^2]
constexpr std::size_t kMostSites = std::size_t(1) << 31;
constexpr std::size_t kGrain = 4096;
constexpr const char* kScaleHint =
    "if its coordinates are not metres, `sekitei mesh --file IN --scale METRES_PER_UNIT -o "
    "OUT.ply` (in recipes: scale of the stage mesh) makes them so";

/// "3, 17 and 40 more": the first ten of what is wrong.
std::string first_ten(const std::vector<std::size_t>& ids)
{
    std::string text;
    for (std::size_t i = 0; i < std::min<std::size_t>(ids.size(), 10); ++i)
        text += fmt::format("{}{}", i == 0 ? "" : ", ", ids[i]);
    return ids.size() > 10 ? fmt::format("{} and {} more", text, ids.size() - 10) : text;
}

/// The longest side of its box [m].
double extent_of(const TriMesh& mesh)
{
    const Vec3d size = mesh.bounds().size();
    return std::max({size.x, size.y, size.z});
}

double squared_length(Vec3f a, Vec3f b)
{
    const Vec3d d = Vec3d(b) - Vec3d(a);
    return dot(d, d);
}

/// The same for both directions of an edge.
Vec3f midpoint(Vec3f a, Vec3f b)
{
    return Vec3f((Vec3d(a) + Vec3d(b)) * 0.5);
}

void check(const TriMesh& mesh, double longest_edge)
{
    if (!(longest_edge > 0) || !std::isfinite(longest_edge))
        throw InvalidParameter(
            fmt::format("sites: longest_edge = {} m, must be > 0", longest_edge));
    if (mesh.triangles.empty())
        throw InvalidInput("sites: the mesh has no triangles, there is no surface to live on");
    if (mesh.vertices.size() >= kMostSites || mesh.triangles.size() >= kMostSites)
        throw LimitExceeded(fmt::format("sites: {} vertices and {} triangles, at most 2^31 - 1",
                                        mesh.vertices.size(), mesh.triangles.size()));
    std::vector<std::size_t> bad;
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i)
        if (const Vec3f v = mesh.vertices[i];
            !std::isfinite(v.x) || !std::isfinite(v.y) || !std::isfinite(v.z))
            bad.push_back(i);
    if (!bad.empty())
        throw InvalidInput(fmt::format("sites: {} vertices are not finite: {}; mend the mesh",
                                       bad.size(), first_ten(bad)));
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
        for (const std::uint32_t v : mesh.triangles[t])
            if (v >= mesh.vertices.size())
                throw InvalidInput(fmt::format("sites: triangle {} has vertex {}, must be below {}",
                                               t, v, mesh.vertices.size()));
}

/// A mesh being divided: triangles by the face they came from.
struct Division {
    std::vector<Vec3f> vertices;
    std::vector<Triangle> triangles;
    std::vector<std::uint32_t> face;
    std::vector<std::uint8_t> halvings;  ///< each triangle is 2^-halvings of its face
};

/// Joins vertices at the same place, whatever attributes told them apart, so that neighbours find
/// each other across creases and seams; leaves out triangles without area and unused vertices.
Division weld(const TriMesh& mesh)
{
    std::vector<std::uint32_t> order(mesh.vertices.size()), same(mesh.vertices.size());
    std::iota(order.begin(), order.end(), 0u);
    // -0 and 0 are one place and compare equal.
    std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
        const Vec3f p = mesh.vertices[a], q = mesh.vertices[b];
        if (p.x != q.x) return p.x < q.x;
        if (p.y != q.y) return p.y < q.y;
        return p.z != q.z ? p.z < q.z : a < b;
    });
    for (std::size_t i = 0; i < order.size(); ++i)
        same[order[i]] = i > 0 && mesh.vertices[order[i]] == mesh.vertices[order[i - 1]]
                             ? same[order[i - 1]]
                             : order[i];

    Division d;
    d.triangles.reserve(mesh.triangles.size());
    d.face.reserve(mesh.triangles.size());
    constexpr std::uint32_t kUnused = std::numeric_limits<std::uint32_t>::max();
    std::vector<std::uint32_t>& index = order;
    std::fill(index.begin(), index.end(), kUnused);
    for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) {
        const auto& [a, b, c] = mesh.triangles[t];
        if (triangle_area(mesh.vertices[a], mesh.vertices[b], mesh.vertices[c]) < kLeastArea)
            continue;
        d.triangles.push_back({same[a], same[b], same[c]});
        d.face.push_back(t);
        for (const std::uint32_t v : d.triangles.back()) index[v] = 0;
    }
    if (d.triangles.empty())
        throw InvalidInput(fmt::format(
            "sites: none of the {} triangles has an area of {} m^2 or more: the mesh is "
            "{:.3g} m across; {}",
            mesh.triangles.size(), kLeastArea, extent_of(mesh), kScaleHint));
    if (const std::size_t dropped = mesh.triangles.size() - d.triangles.size(); dropped > 0)
        log::info("sites: {} triangles smaller than {} m^2 are left out", dropped, kLeastArea);

    std::uint32_t count = 0;
    for (std::size_t v = 0; v < index.size(); ++v)
        if (index[v] != kUnused) {
            index[v] = count++;
            d.vertices.push_back(mesh.vertices[v]);
        }
    for (Triangle& t : d.triangles)
        for (std::uint32_t& v : t) v = index[v];
    d.halvings.assign(d.triangles.size(), 0);
    return d;
}

/// @throws InvalidInput  neighbours run along an edge in the same direction
void check_winding(const TriMesh& mesh, const std::vector<std::uint32_t>& face)
{
    std::vector<TriangleSide> sides;
    sides.reserve(3 * mesh.triangles.size());
    for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) append_sides(mesh, t, sides);
    sort_by_edge(sides);
    std::vector<std::size_t> bad;
    bool closed = true;
    for (std::size_t i = 0, next = 0; i < sides.size(); i = next) {
        // Where several sheets or solids meet at an edge, nobody can say which runs on into which.
        int rising = 0;
        for (next = i; next < sides.size() && sides[next].edge == sides[i].edge; ++next)
            rising += sides[next].rising ? 1 : -1;
        closed = closed && rising == 0;
        if (next - i == 2 && rising != 0)
            for (std::size_t k = i; k < next; ++k) bad.push_back(face[sides[k].triangle]);
    }
    if (!bad.empty()) {
        std::sort(bad.begin(), bad.end());
        bad.erase(std::unique(bad.begin(), bad.end()), bad.end());
        throw InvalidInput(
            fmt::format("sites: {} triangles are wound against a neighbour: {}; make the mesh's "
                        "normals consistent",
                        bad.size(), first_ten(bad)));
    }
    if (closed && mesh.signed_volume() < 0)
        log::warning("sites: the mesh is closed and inside out: what grows will grow inside");
}

/// Refuses what cannot be held, before anything is held.
void check_count(const Division& d, double longest_edge)
{
    // A piece has at most the area of the equilateral triangle, and covers at most longest_edge of
    // its face's longest edge.
    const double largest = std::sqrt(3.0) / 4 * longest_edge * longest_edge;
    const double count = parallel_sum(d.triangles.size(), [&](std::size_t t) {
        const auto& [i, j, k] = d.triangles[t];
        const Vec3f a = d.vertices[i], b = d.vertices[j], c = d.vertices[k];
        const double longest =
            std::sqrt(std::max({squared_length(a, b), squared_length(b, c), squared_length(c, a)}));
        return std::max({1.0, triangle_area(a, b, c) / largest, longest / longest_edge});
    });
    if (count >= double(kMostSites))
        throw LimitExceeded(
            fmt::format("sites: longest_edge = {} m makes {} sites or more, at most 2^31 - 1: "
                        "raise it, or check the unit of the mesh: {}",
                        longest_edge, count_text(count), kScaleHint));
}

/// One side of a triangle that is to be halved.
struct LongSide {
    std::uint64_t edge;  ///< lower vertex << 32 | higher vertex
    std::uint64_t slot;  ///< 3 triangle + side
};

/// Halves all edges longer than `longest_edge` once; false if there are none.
bool halve(Division& d, double longest_edge, const Progress& progress)
{
    progress.check();
    const std::size_t count = d.triangles.size();
    // Find the long sides, edge by edge.
    constexpr std::size_t kChunk = 1 << 16;
    const double limit = longest_edge * longest_edge;
    std::vector<std::vector<LongSide>> parts((count + kChunk - 1) / kChunk);
    parallel_for(parts.size(), [&](std::size_t part) {
        for (std::size_t t = part * kChunk; t < std::min(count, (part + 1) * kChunk); ++t)
            for (std::size_t k = 0; k < 3; ++k) {
                const std::uint64_t a = d.triangles[t][k], b = d.triangles[t][(k + 1) % 3];
                if (squared_length(d.vertices[a], d.vertices[b]) > limit)
                    parts[part].push_back({std::min(a, b) << 32 | std::max(a, b), 3 * t + k});
            }
    });
    std::vector<LongSide> sides;
    for (std::vector<LongSide>& part : parts) {
        sides.insert(sides.end(), part.begin(), part.end());
        part = {};
    }
    if (sides.empty()) return false;
    std::sort(sides.begin(), sides.end(),
              [](const LongSide& a, const LongSide& b) { return a.edge < b.edge; });
    progress.check();

    // Each side makes one triangle more.
    if (count + sides.size() >= kMostSites)
        throw LimitExceeded(
            fmt::format("sites: longest_edge = {} m makes {} sites or more, at most 2^31 - 1: "
                        "raise it, or check the unit of the mesh: {}",
                        longest_edge, count_text(double(count + sides.size())), kScaleHint));
    constexpr std::uint32_t kWhole = std::numeric_limits<std::uint32_t>::max();
    std::vector<std::uint32_t> middle(3 * count, kWhole);
    for (std::size_t i = 0; i < sides.size(); ++i) {
        if (i == 0 || sides[i].edge != sides[i - 1].edge)
            d.vertices.push_back(
                midpoint(d.vertices[sides[i].edge >> 32], d.vertices[sides[i].edge & 0xFFFFFFFFu]));
        middle[sides[i].slot] = static_cast<std::uint32_t>(d.vertices.size() - 1);
    }
    std::vector<std::uint32_t> begin(count + 1, 0);
    for (std::size_t t = 0; t < count; ++t) {
        std::uint32_t pieces = 1;
        for (std::size_t k = 0; k < 3; ++k) pieces += middle[3 * t + k] != kWhole;
        begin[t + 1] = begin[t] + pieces;
    }
    const std::size_t total = begin.back();
    sides = {};

    Division finer;
    finer.vertices = std::move(d.vertices);
    finer.triangles.resize(total);
    finer.face.resize(total);
    finer.halvings.resize(total);
    parallel_for(
        count,
        [&](std::size_t t) {
            std::size_t out = begin[t];
            auto put = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, int halvings) {
                finer.triangles[out] = {a, b, c};
                finer.face[out] = d.face[t];
                finer.halvings[out] = static_cast<std::uint8_t>(d.halvings[t] + halvings);
                ++out;
            };
            // Turn the triangle so that the pattern of its long sides starts at the first.
            const std::size_t pieces = begin[t + 1] - begin[t];
            std::size_t turn = 0;
            const auto is_long = [&](std::size_t k) { return middle[3 * t + k % 3] != kWhole; };
            if (pieces == 2)
                while (!is_long(turn)) ++turn;
            if (pieces == 3)
                while (is_long(turn + 2)) ++turn;
            const std::uint32_t a = d.triangles[t][turn], b = d.triangles[t][(turn + 1) % 3],
                                c = d.triangles[t][(turn + 2) % 3];
            const std::uint32_t ab = middle[3 * t + turn], bc = middle[3 * t + (turn + 1) % 3],
                                ca = middle[3 * t + (turn + 2) % 3];
            const auto& p = finer.vertices;
            switch (pieces) {
                case 1:
                    put(a, b, c, 0);
                    break;
                case 2:
                    put(a, ab, c, 1);
                    put(ab, b, c, 1);
                    break;
                case 3:
                    put(ab, b, bc, 2);
                    if (squared_length(p[a], p[bc]) <= squared_length(p[ab], p[c])) {
                        put(a, ab, bc, 2);
                        put(a, bc, c, 1);
                    } else {
                        put(ab, bc, c, 2);
                        put(a, ab, c, 1);
                    }
                    break;
                default:
                    put(a, ab, ca, 2);
                    put(ab, b, bc, 2);
                    put(ca, bc, c, 2);
                    put(ab, bc, ca, 2);
            }
        },
        kGrain);
    d = std::move(finer);
    return true;
}

/// Calls visit(neighbour) in ascending order: a merge of what meets at the three corners.
template <class Visit>
void visit_neighbours(const std::vector<Triangle>& triangles,
                      const std::vector<std::uint32_t>& begin,
                      const std::vector<std::uint32_t>& around, std::uint32_t i, Visit&& visit)
{
    constexpr std::uint32_t kEnd = std::numeric_limits<std::uint32_t>::max();
    std::array<std::uint32_t, 3> at{}, end{};
    for (std::size_t k = 0; k < 3; ++k) {
        at[k] = begin[triangles[i][k]];
        end[k] = begin[triangles[i][k] + 1];
    }
    while (true) {
        std::uint32_t next = kEnd;
        for (std::size_t k = 0; k < 3; ++k)
            if (at[k] != end[k]) next = std::min(next, around[at[k]]);
        if (next == kEnd) return;
        for (std::size_t k = 0; k < 3; ++k) at[k] += at[k] != end[k] && around[at[k]] == next;
        if (next != i) visit(next);
    }
}

void find_neighbours(MeshSites& sites, const Progress& progress)
{
    const std::vector<Triangle>& triangles = sites.mesh.triangles;
    const std::size_t n = triangles.size();
    // Where each vertex's triangles begin, then the triangles, ascending.
    std::vector<std::uint32_t> begin(sites.mesh.vertices.size() + 1, 0), around;
    if (3.0 * double(n) > 4294967295.0)
        throw LimitExceeded(
            fmt::format("sites: {} sites have too many corners, at most 1.43 "
                        "billion sites: raise longest_edge",
                        n));
    for (const Triangle& t : triangles)
        for (const std::uint32_t v : t) ++begin[v + 1];
    for (std::size_t v = 0; v + 1 < begin.size(); ++v) begin[v + 1] += begin[v];
    around.resize(3 * n);
    for (std::uint32_t t = 0; t < n; ++t)
        for (const std::uint32_t v : triangles[t]) around[begin[v]++] = t;
    for (std::size_t v = begin.size() - 1; v > 0; --v) begin[v] = begin[v - 1];
    begin[0] = 0;

    std::vector<std::uint32_t>& first = sites.neighbour_begin;
    first.assign(n + 1, 0);
    parallel_for_range(
        n,
        [&](std::size_t from, std::size_t to) {
            progress.check();
            for (std::size_t i = from; i != to; ++i)
                visit_neighbours(triangles, begin, around, std::uint32_t(i),
                                 [&](std::uint32_t) { ++first[i + 1]; });
        },
        kGrain);
    std::uint64_t total = 0;
    for (std::size_t i = 1; i <= n; ++i) {
        total += first[i];
        first[i] = static_cast<std::uint32_t>(total);
    }
    if (total > 4294967295u)
        throw LimitExceeded(
            fmt::format("sites: {} sites have {} neighbours, at most 4.29 billion: "
                        "raise longest_edge",
                        n, count_text(double(total))));
    sites.neighbour.resize(total);
    parallel_for_range(
        n,
        [&](std::size_t from, std::size_t to) {
            progress.check();
            for (std::size_t i = from; i != to; ++i) {
                std::uint32_t* out = sites.neighbour.data() + first[i];
                visit_neighbours(triangles, begin, around, std::uint32_t(i),
                                 [&](std::uint32_t j) { *out++ = j; });
            }
        },
        kGrain);
}

}  // namespace

MeshSites mesh_sites(const TriMesh& mesh, double longest_edge, const Progress& progress)
{
    check(mesh, longest_edge);
    Division division = weld(mesh);
    progress.update(0.1);
    {
        TriMesh whole;
        whole.vertices = std::move(division.vertices);
        whole.triangles = std::move(division.triangles);
        check_winding(whole, division.face);
        division.vertices = std::move(whole.vertices);
        division.triangles = std::move(whole.triangles);
    }
    progress.update(0.3);

    // Coordinates are floats: between neighbouring numbers there is no midpoint.
    check_count(division, longest_edge);
    float extent = 0;
    for (const Vec3f& v : division.vertices)
        extent = std::max({extent, std::abs(v.x), std::abs(v.y), std::abs(v.z)});
    const double least = 8 * double(std::nextafter(extent, INFINITY) - extent);
    bool divided = false;
    while (longest_edge >= least && halve(division, longest_edge, progress)) divided = true;
    if (longest_edge < least && halve(division, longest_edge, progress))
        throw InvalidParameter(
            fmt::format("sites: longest_edge = {} m, must be >= {:.3g} m, eight steps of a float "
                        "coordinate of {} m: raise it, or move the mesh to the origin",
                        longest_edge, least, extent));
    progress.update(0.6);

    // Measure. A face's direction and area are sharper than those of its rounded pieces.
    MeshSites sites;
    sites.mesh.vertices = std::move(division.vertices);
    sites.mesh.triangles = std::move(division.triangles);
    sites.face = std::move(division.face);
    const std::size_t n = sites.face.size();
    sites.position.resize(n);
    sites.normal.resize(n);
    sites.area.resize(n);
    parallel_for(
        n,
        [&](std::size_t i) {
            const auto& [a, b, c] = sites.mesh.triangles[i];
            const auto& p = sites.mesh.vertices;
            sites.position[i] = Vec3f((Vec3d(p[a]) + Vec3d(p[b]) + Vec3d(p[c])) / 3.0);
            const Triangle& whole = mesh.triangles[sites.face[i]];
            const Vec3d origin(mesh.vertices[whole[0]]);
            const Vec3d normal = cross(Vec3d(mesh.vertices[whole[1]]) - origin,
                                       Vec3d(mesh.vertices[whole[2]]) - origin);
            const double twice = length(normal);
            sites.normal[i] = Vec3f(normal / twice);
            sites.area[i] = static_cast<float>(std::ldexp(twice / 2, -division.halvings[i]));
        },
        kGrain);
    progress.update(0.7);
    find_neighbours(sites, progress);
    progress.update(1);
    log::detail("sites: {} of {} triangles{}, edges up to {} m", n, mesh.triangles.size(),
                divided ? ", divided" : "", longest_edge);
    return sites;
}

SitePieces cut_sites(const TriMesh& mesh, std::span<const float> area, double longest)
{
    constexpr int kMost = 32;
    if (area.size() != mesh.triangles.size())
        throw InvalidInput(fmt::format("sites: {} areas of {} triangles, must be as many",
                                       area.size(), mesh.triangles.size()));
    SitePieces pieces;
    for (std::uint32_t i = 0; i < mesh.triangles.size(); ++i) {
        const auto& t = mesh.triangles[i];
        const Vec3f a = mesh.vertices[t[0]], ab = mesh.vertices[t[1]] - a,
                    ac = mesh.vertices[t[2]] - a;
        const double edge = double(std::max({length(ab), length(ac), length(ac - ab)}));
        const int k = static_cast<int>(std::clamp(std::ceil(edge / longest), 1.0, double(kMost)));
        const float step = 1 / static_cast<float>(k);
        auto add = [&](int u, int v, float inside) {
            pieces.position.push_back(a + ab * ((static_cast<float>(u) + inside) * step) +
                                      ac * ((static_cast<float>(v) + inside) * step));
            pieces.site.push_back(i);
            pieces.area.push_back(area[i] * step * step);
        };
        for (int u = 0; u < k; ++u)
            for (int v = 0; u + v < k; ++v) {
                add(u, v, 1.0f / 3);
                if (u + v + 1 < k) add(u, v, 2.0f / 3);  // the one upside down between them
            }
    }
    return pieces;
}

}  // namespace sekitei
