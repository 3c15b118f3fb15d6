#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>

#include "core/error.h"
#include "core/mesh_formats.h"
#include "core/mesh_sides.h"
#include "core/random.h"

namespace sekitei::mesh_format {
namespace {

using Triangle = std::array<std::uint32_t, 3>;
constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

/// Keeps the values at `kept`, in that order.
void select(std::map<std::string, TriMesh::Attribute>& attributes,
            const std::vector<std::uint32_t>& kept)
{
    for (auto& [name, attribute] : attributes)
        std::visit(
            [&](auto& values) {
                std::decay_t<decltype(values)> chosen;
                chosen.reserve(kept.size());
                for (const std::uint32_t i : kept) chosen.push_back(values[i]);
                values = std::move(chosen);
            },
            attribute);
}

/// The same bits in all attributes; NaN equals itself here.
bool equal_attributes(const std::map<std::string, TriMesh::Attribute>& attributes, std::size_t a,
                      std::size_t b)
{
    return std::all_of(attributes.begin(), attributes.end(), [&](const auto& entry) {
        return std::visit(
            [&](const auto& values) {
                return std::memcmp(&values[a], &values[b], sizeof values[a]) == 0;
            },
            entry.second);
    });
}

std::uint64_t vertex_key(const Polygons& p, Vec3f v, std::size_t i)
{
    const auto bits = [](float f) { return std::uint64_t(std::bit_cast<std::uint32_t>(f)); };
    std::uint64_t key = hash2(bits(v.x) << 32 | bits(v.y), bits(v.z));
    for (const auto& entry : p.vertex_attributes)
        std::visit(
            [&](const auto& values) {
                std::uint32_t words[sizeof(values[i]) / 4];
                std::memcpy(words, &values[i], sizeof words);
                for (const std::uint32_t word : words) key = hash2(key, word);
            },
            entry.second);
    return key;
}

void check_numbers(const Polygons& p)
{
    std::size_t bad = 0, first = 0;
    for (std::size_t i = p.vertices.size(); i-- > 0;) {
        const Vec3f& v = p.vertices[i];
        if (std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z)) continue;
        ++bad;
        first = i;
    }
    if (bad == 0) return;
    const std::string place = p.places.empty() ? ""
                              : p.binary       ? fmt::format(" at byte {}", p.places[first])
                                               : fmt::format(" in line {}", p.places[first]);
    throw InvalidInput(fmt::format(
        "{}: {} of {} vertices are not finite numbers, the first is vertex {}{}; repair the mesh "
        "where it was made",
        p.name, bad, p.vertices.size(), first, place));
}

/// Joins vertices with equal position and equal attributes; the first one stays.
void weld(Polygons& p)
{
    std::size_t slots = 16;
    while (slots < 2 * p.vertices.size()) slots *= 2;
    std::vector<std::uint32_t> table(slots, kNone), target(p.vertices.size()), kept;
    for (std::uint32_t i = 0; i < p.vertices.size(); ++i) {
        const Vec3f v = p.vertices[i] + Vec3f(0.0f);  // -0 becomes 0: they are one place
        std::size_t slot = vertex_key(p, v, i) & (slots - 1);
        while (table[slot] != kNone &&
               !(p.vertices[kept[table[slot]]] == v &&
                 equal_attributes(p.vertex_attributes, kept[table[slot]], i)))
            slot = (slot + 1) & (slots - 1);
        if (table[slot] == kNone) {
            table[slot] = static_cast<std::uint32_t>(kept.size());
            kept.push_back(i);
        }
        target[i] = table[slot];
    }
    p.merged += p.vertices.size() - kept.size();
    if (kept.size() == p.vertices.size()) return;
    for (std::uint32_t& corner : p.corners) corner = target[corner];
    for (std::size_t i = 0; i < kept.size(); ++i) p.vertices[i] = p.vertices[kept[i]];
    p.vertices.resize(kept.size());
    select(p.vertex_attributes, kept);
}

/// Cuts polygons into triangles.
class Triangulation {
public:
    Triangulation(const Polygons& p) : p_(p)
    {
        triangles.reserve(p.corners.size());
        std::uint64_t begin = 0;
        for (std::uint32_t i = 0; i < p.ends.size(); ++i) {
            face_ = i;
            begin_ = begin;
            split(p.corners.data() + begin, p.ends[i] - begin);
            begin = p.ends[i];
        }
    }

    std::vector<Triangle> triangles;
    std::vector<std::uint32_t> face;  ///< the polygon each came from
    std::vector<Triangle> places;     ///< in `corners`; only if these have texture coordinates
    std::size_t split_polygons = 0, too_short = 0, fanned = 0;

private:
    const Polygons& p_;
    std::uint32_t face_ = 0;
    std::uint64_t begin_ = 0;             // of the present polygon in `corners`
    std::uint64_t budget_ = 100'000'000;  // point tests; a hostile file must not cost minutes
    std::vector<std::array<double, 2>> flat_;
    std::vector<std::uint32_t> next_, previous_;

    /// A triangle of the polygon's corners a, b and c.
    void add(std::uint32_t a, std::uint32_t b, std::uint32_t c)
    {
        const std::uint32_t* first = p_.corners.data() + begin_;
        triangles.push_back({first[a], first[b], first[c]});
        face.push_back(face_);
        const auto at = static_cast<std::uint32_t>(begin_);
        if (!p_.texture.empty()) places.push_back({at + a, at + b, at + c});
    }

    Vec3d at(std::uint32_t vertex) const { return Vec3d(p_.vertices[vertex]); }

    void split(const std::uint32_t* corner, std::uint64_t n)
    {
        if (n < 3) {
            ++too_short;
            return;
        }
        if (n == 3) return add(0, 1, 2);
        ++split_polygons;

        // Project along the polygon's mean normal [Newell], so that it runs counter-clockwise.
        Vec3d normal{};
        const Vec3d origin = at(corner[0]);
        for (std::uint64_t i = 1; i + 1 < n; ++i)
            normal += cross(at(corner[i]) - origin, at(corner[i + 1]) - origin);
        int axis = 0;
        for (int k = 1; k < 3; ++k)
            if (std::abs(normal[k]) > std::abs(normal[axis])) axis = k;
        const int u = (axis + 1) % 3, v = (axis + 2) % 3;
        const double sign = normal[axis] < 0 ? -1 : 1;
        flat_.resize(n);
        for (std::uint64_t i = 0; i < n; ++i) {
            const Vec3d d = at(corner[i]) - origin;
            flat_[i] = {d[u], sign * d[v]};
        }
        next_.resize(n);
        previous_.resize(n);
        for (std::uint32_t i = 0; i < n; ++i) {
            next_[i] = i + 1 < n ? i + 1 : 0;
            previous_[i] = i > 0 ? i - 1 : static_cast<std::uint32_t>(n - 1);
        }

        // A convex polygon is a fan; otherwise cut ears off, always going on behind the last one.
        std::uint32_t i = 0;
        std::uint64_t left = n, failed = 0;
        const bool convex = all_convex();
        while (left > 3 && !convex && failed < left && budget_ > 0) {
            if (is_ear(i)) {
                add(previous_[i], i, next_[i]);
                next_[previous_[i]] = next_[i];
                previous_[next_[i]] = previous_[i];
                --left;
                failed = 0;
            } else
                ++failed;
            i = next_[i];
        }
        if (left > 3 && !convex) ++fanned;
        if (convex) i = 0;
        for (std::uint32_t k = next_[i]; next_[k] != i; k = next_[k]) add(i, k, next_[k]);
    }

    double turn(std::uint32_t a, std::uint32_t b, std::uint32_t c) const
    {
        return (flat_[b][0] - flat_[a][0]) * (flat_[c][1] - flat_[a][1]) -
               (flat_[b][1] - flat_[a][1]) * (flat_[c][0] - flat_[a][0]);
    }

    bool all_convex() const
    {
        // Turning left everywhere is not enough (a star polygon does): it must also go round once.
        int sweeps = 0;
        for (std::uint32_t i = 0; i < next_.size(); ++i) {
            if (turn(previous_[i], i, next_[i]) < 0) return false;
            sweeps += flat_[i][0] < flat_[previous_[i]][0] && flat_[i][0] <= flat_[next_[i]][0];
        }
        return sweeps <= 1;
    }

    bool is_ear(std::uint32_t i)
    {
        const std::uint32_t a = previous_[i], b = next_[i];
        if (turn(a, i, b) <= 0) return false;
        for (std::uint32_t k = next_[b]; k != a; k = next_[k]) {
            if (budget_ > 0) --budget_;
            if (flat_[k] == flat_[a] || flat_[k] == flat_[i] || flat_[k] == flat_[b]) continue;
            if (turn(a, i, k) >= 0 && turn(i, b, k) >= 0 && turn(b, a, k) >= 0) return false;
        }
        return true;
    }
};

/// Says for any point whether closed surfaces enclose it: counts crossings of an upward ray, found
/// through a grid over the xy plane.
class Enclosure {
public:
    Enclosure(const TriMesh& mesh, const std::vector<char>& closed,
              const std::vector<std::uint32_t>& piece)
        : mesh_(mesh), piece_(piece)
    {
        std::vector<std::uint32_t> members;
        for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t)
            if (closed[piece[t]]) {
                members.push_back(t);
                for (const std::uint32_t v : mesh.triangles[t]) box_.add(Vec3d(mesh.vertices[v]));
            }
        // Halve the resolution until large triangles no longer fill the table.
        cells_ = std::clamp(static_cast<int>(std::sqrt(double(members.size()) / 2)), 1, 2048);
        while (cells_ > 1 && entries(members) > 16.0 * double(members.size())) cells_ /= 2;
        first_.assign(std::size_t(cells_) * std::size_t(cells_) + 1, 0);
        for (int fill = 0; fill < 2; ++fill) {
            for (const std::uint32_t t : members)
                for_cells(t, [&](std::size_t cell) {
                    if (fill)
                        list_[first_[cell]++] = t;
                    else
                        ++first_[cell + 1];
                });
            if (fill) break;
            std::partial_sum(first_.begin(), first_.end(), first_.begin());
            list_.resize(first_.back());
        }
        // Filling has moved every start to its end: move them back.
        std::rotate(first_.begin(), first_.end() - 1, first_.end());
        first_[0] = 0;
    }

    /// Inside by parity, surfaces of `own` left out.
    bool contains(Vec3d p, std::uint32_t own) const
    {
        const std::size_t cell =
            std::size_t(index(p.y, 1)) * std::size_t(cells_) + std::size_t(index(p.x, 0));
        bool inside = false;
        for (std::uint64_t i = first_[cell]; i < first_[cell + 1]; ++i)
            if (piece_[list_[i]] != own && above(p, mesh_.triangles[list_[i]])) inside = !inside;
        return inside;
    }

private:
    const TriMesh& mesh_;
    const std::vector<std::uint32_t>& piece_;
    Bounds box_;
    int cells_ = 1;
    std::vector<std::uint64_t> first_;
    std::vector<std::uint32_t> list_;

    int index(double value, int axis) const
    {
        const double size = box_.upper[axis] - box_.lower[axis];
        if (!(size > 0)) return 0;
        return static_cast<int>(
            std::clamp((value - box_.lower[axis]) / size * cells_, 0.0, double(cells_ - 1)));
    }

    std::array<int, 4> range(std::uint32_t t) const
    {
        Bounds b;
        for (const std::uint32_t v : mesh_.triangles[t]) b.add(Vec3d(mesh_.vertices[v]));
        return {index(b.lower.x, 0), index(b.upper.x, 0), index(b.lower.y, 1), index(b.upper.y, 1)};
    }

    double entries(const std::vector<std::uint32_t>& members) const
    {
        double sum = 0;
        for (const std::uint32_t t : members) {
            const auto [x0, x1, y0, y1] = range(t);
            sum += double(x1 - x0 + 1) * double(y1 - y0 + 1);
        }
        return sum;
    }

    template <class F>
    void for_cells(std::uint32_t t, const F& f) const
    {
        const auto [x0, x1, y0, y1] = range(t);
        for (int y = y0; y <= y1; ++y)
            for (int x = x0; x <= x1; ++x) f(std::size_t(y) * std::size_t(cells_) + std::size_t(x));
    }

    /// Does the upward ray from p cross the triangle? Sides are taken from the lower vertex index
    /// to the higher, so that two triangles agree on whose side of a shared edge p lies.
    bool above(Vec3d p, const Triangle& triangle) const
    {
        bool inside = false;
        for (int k = 0; k < 3; ++k) {
            std::uint32_t i = triangle[std::size_t(k)], j = triangle[std::size_t((k + 1) % 3)];
            if (i > j) std::swap(i, j);
            const Vec3d a(mesh_.vertices[i]), b(mesh_.vertices[j]);
            if ((a.y > p.y) == (b.y > p.y)) continue;
            const double side = (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x);
            if ((side > 0) == (b.y > a.y)) inside = !inside;
        }
        if (!inside) return false;
        const Vec3d a(mesh_.vertices[triangle[0]]);
        const Vec3d n =
            cross(Vec3d(mesh_.vertices[triangle[1]]) - a, Vec3d(mesh_.vertices[triangle[2]]) - a);
        return n.z != 0 && dot(n, a - p) / n.z > 0;
    }
};

/// Makes neighbours agree, then turns closed pieces that are inside out.
///
/// A closed piece of negative volume inside another is the wall of a cavity and stays as it is.
/// @return  triangles turned
std::size_t orient(TriMesh& mesh, std::vector<std::string>& warnings, const std::string& name)
{
    const std::size_t count = mesh.triangles.size();
    std::vector<TriangleSide> sides;
    sides.reserve(3 * count);
    for (std::uint32_t t = 0; t < count; ++t) append_sides(mesh, t, sides);
    sort_by_edge(sides);

    // Neighbours across edges of exactly two triangles; elsewhere orientation says nothing.
    struct Neighbour {
        std::uint32_t triangle = kNone;
        bool agrees = true;
    };
    std::vector<std::array<Neighbour, 3>> neighbours(count);
    std::vector<std::uint8_t> degree(count, 0);
    for (std::size_t i = 0, next = 0; i < sides.size(); i = next) {
        for (next = i + 1; next < sides.size() && sides[next].edge == sides[i].edge;) ++next;
        if (next - i != 2) continue;
        const TriangleSide &a = sides[i], &b = sides[i + 1];
        neighbours[a.triangle][degree[a.triangle]++] = {b.triangle, a.rising != b.rising};
        neighbours[b.triangle][degree[b.triangle]++] = {a.triangle, a.rising != b.rising};
    }
    sides = {};

    // Walk every piece and give each triangle the sense of the first one.
    std::vector<std::uint32_t> piece(count, kNone), queue;
    std::vector<char> turned(count, 0), closed;
    std::vector<double> volume;
    bool one_sided = false;
    std::size_t flipped = 0;
    const auto texture = texture_of(mesh);
    auto flip = [&](std::uint32_t t) {
        std::swap(mesh.triangles[t][1], mesh.triangles[t][2]);
        if (texture[0]) std::swap((*texture[1])[t], (*texture[2])[t]);
    };
    const Vec3d origin = mesh.bounds().centre();
    for (std::uint32_t start = 0; start < count; ++start) {
        if (piece[start] != kNone) continue;
        const auto id = static_cast<std::uint32_t>(volume.size());
        queue.assign(1, start);
        piece[start] = id;
        std::size_t against = 0;
        bool whole = true, twisted = false;
        for (std::size_t head = 0; head < queue.size(); ++head) {
            const std::uint32_t t = queue[head];
            against += turned[t] != 0;
            whole = whole && degree[t] == 3;
            for (int k = 0; k < degree[t]; ++k) {
                const Neighbour& n = neighbours[t][std::size_t(k)];
                const char sense = static_cast<char>(n.agrees ? turned[t] : !turned[t]);
                if (piece[n.triangle] == kNone) {
                    piece[n.triangle] = id;
                    turned[n.triangle] = sense;
                    queue.push_back(n.triangle);
                } else if (turned[n.triangle] != sense)
                    twisted = true;
            }
        }
        // Turn the lesser part.
        const bool turn_others = 2 * against > queue.size();
        double sum = 0;
        for (const std::uint32_t t : queue) {
            if ((turned[t] != 0) != turn_others) {
                flip(t);
                ++flipped;
            }
            const auto& [a, b, c] = mesh.triangles[t];
            sum += dot(Vec3d(mesh.vertices[a]) - origin,
                       cross(Vec3d(mesh.vertices[b]) - origin, Vec3d(mesh.vertices[c]) - origin));
        }
        volume.push_back(sum);
        closed.push_back(whole && !twisted);
        one_sided = one_sided || twisted;
    }
    if (one_sided)
        warnings.push_back(fmt::format(
            "{}: the surface has one side only, like a Moebius band: its orientation stays mixed",
            name));

    // Turn everything if the whole is inside out.
    double total = 0;
    for (std::size_t i = 0; i < volume.size(); ++i)
        if (closed[i]) total += volume[i];
    if (total < 0) {
        for (std::uint32_t t = 0; t < count; ++t)
            if (closed[piece[t]]) {
                flip(t);
                ++flipped;
            }
        for (double& v : volume) v = -v;
    }

    // Then the closed pieces still inside out, unless they are the walls of cavities.
    std::vector<std::uint32_t> first(volume.size(), kNone);
    bool any = false;
    for (std::uint32_t t = static_cast<std::uint32_t>(count); t-- > 0;) first[piece[t]] = t;
    for (std::size_t i = 0; i < volume.size(); ++i) any = any || (closed[i] && volume[i] < 0);
    if (!any) return flipped;
    const Enclosure enclosure(mesh, closed, piece);
    std::vector<char> inverted(volume.size(), 0);
    for (std::uint32_t i = 0; i < volume.size(); ++i) {
        if (!closed[i] || volume[i] >= 0) continue;
        const auto& [a, b, c] = mesh.triangles[first[i]];
        const Vec3d middle =
            (Vec3d(mesh.vertices[a]) + Vec3d(mesh.vertices[b]) + Vec3d(mesh.vertices[c])) *
            (1.0 / 3);
        inverted[i] = !enclosure.contains(middle, i);
    }
    for (std::uint32_t t = 0; t < count; ++t)
        if (inverted[piece[t]]) {
            flip(t);
            ++flipped;
        }
    return flipped;
}

}  // namespace

TriMesh mend(Polygons&& p, MeshReadReport& report)
{
    if (p.vertices.size() >= kNone || p.corners.size() >= kNone)
        throw LimitExceeded(fmt::format("{}: {} vertices and {} corners, at most 4.29 billion",
                                        p.name, p.vertices.size(), p.corners.size()));
    if (p.ends.empty())
        throw InvalidInput(
            fmt::format("{}: {} vertices and no faces: a surface is needed, not a point cloud",
                        p.name, p.vertices.size()));
    check_numbers(p);
    weld(p);

    TriMesh mesh;
    std::vector<std::uint32_t> kept;
    std::array<std::vector<Vec3f>, 3> texture;
    {
        Triangulation cut(p);
        report.split_polygons = cut.split_polygons;
        report.dropped_zero_area = p.dropped + cut.too_short;
        if (cut.fanned > 0)
            p.warnings.push_back(fmt::format(
                "{}: {} polygons are not simple or too large to cut well: triangles may overlap",
                p.name, cut.fanned));
        mesh.vertices = std::move(p.vertices);
        mesh.triangles.reserve(cut.triangles.size());
        for (std::size_t t = 0; t < cut.triangles.size(); ++t) {
            const auto& [a, b, c] = cut.triangles[t];
            if (triangle_area(mesh.vertices[a], mesh.vertices[b], mesh.vertices[c]) == 0) {
                ++report.dropped_zero_area;
                continue;
            }
            mesh.triangles.push_back(cut.triangles[t]);
            kept.push_back(cut.face[t]);
            if (p.texture.empty()) continue;
            for (std::size_t k = 0; k < 3; ++k) {
                const auto& [u, v] = p.texture[cut.places[t][k]];
                texture[k].emplace_back(u, v, 0.0f);
            }
        }
    }
    if (mesh.triangles.empty())
        throw InvalidInput(
            fmt::format("{}: none of its {} faces has an area", p.name, p.ends.size()));
    mesh.vertex_attributes = std::move(p.vertex_attributes);
    mesh.face_attributes = std::move(p.face_attributes);
    select(mesh.face_attributes, kept);
    if (!p.texture.empty())
        for (std::size_t k = 0; k < 3; ++k)
            mesh.face_attributes[kTexture[k]] = std::move(texture[k]);

    report.merged_vertices = p.merged;
    report.flipped_triangles = orient(mesh, p.warnings, p.name);
    const Vec3d size = mesh.bounds().size();
    const double extent = std::max({size.x, size.y, size.z});
    if (extent < 1e-4 || extent > 1e5)
        p.warnings.push_back(fmt::format(
            "{} is {:.3g} m across: if its coordinates are not metres, say so with --mesh-scale of "
            "`sekitei lava` or --scale of `sekitei mesh --file`",
            p.name, extent));
    report.groups = std::move(p.groups);
    report.warnings = std::move(p.warnings);
    return mesh;
}

}  // namespace sekitei::mesh_format
