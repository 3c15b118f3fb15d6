#include "apps/garden/lantern.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <vector>

#include "core/math.h"

namespace sekitei::garden {
namespace {

constexpr int kSides = 96;         // of the shaft; a multiple of 4 keeps its symmetry
constexpr double kShaft = 0.12;    // radius
constexpr double kRoofTop = 0.08;  // half width

/// Collects triangles; equal points become one vertex.
class Builder {
public:
    std::uint32_t vertex(Vec3d p)
    {
        const std::array<double, 3> key{p.x, p.y, p.z};
        const auto [at, is_new] =
            known_.emplace(key, static_cast<std::uint32_t>(mesh.vertices.size()));
        if (is_new) mesh.vertices.emplace_back(float(p.x), float(p.y), float(p.z));
        return at->second;
    }
    void triangle(Vec3d a, Vec3d b, Vec3d c)
    {
        mesh.triangles.push_back({vertex(a), vertex(b), vertex(c)});
    }
    void quad(Vec3d a, Vec3d b, Vec3d c, Vec3d d)
    {
        triangle(a, b, c);
        triangle(a, c, d);
    }

    TriMesh mesh;

private:
    std::map<std::array<double, 3>, std::uint32_t> known_;
};

/// Points of a square ring at the grid's lines, counter-clockwise from above, from (w, 0+).
std::vector<Vec3d> square_ring(const std::vector<double>& lines, double half, double z)
{
    std::vector<double> inside;
    for (const double x : lines)
        if (std::abs(x) <= half) inside.push_back(x);
    std::vector<Vec3d> ring;
    for (std::size_t i = 0; i + 1 < inside.size(); ++i) ring.push_back({half, inside[i], z});
    for (std::size_t i = inside.size() - 1; i > 0; --i) ring.push_back({inside[i], half, z});
    for (std::size_t i = inside.size() - 1; i > 0; --i) ring.push_back({-half, inside[i], z});
    for (std::size_t i = 0; i + 1 < inside.size(); ++i) ring.push_back({inside[i], -half, z});
    return ring;
}

std::vector<Vec3d> circle(double radius, double z)
{
    std::vector<Vec3d> ring;
    for (int i = 0; i < kSides; ++i) {
        const double angle = 2 * math::kPi * (i + 0.5) / kSides - math::kPi / 4;
        ring.push_back({radius * math::cos(angle), radius * math::sin(angle), z});
    }
    return ring;
}

/// The strip between two rings around the z axis, both counter-clockwise and starting at the same
/// angle; its front is where the outer ring lies to the right of the way around.
void strip(Builder& to, const std::vector<Vec3d>& outer, const std::vector<Vec3d>& inner,
           bool turned)
{
    // Angles grow along each ring; advance on the one that is behind.
    auto angle = [](const std::vector<Vec3d>& ring, std::size_t i) {
        const Vec3d p = ring[i % ring.size()], first = ring[0];
        double a = math::atan2(p.y, p.x) - math::atan2(first.y, first.x);
        if (a < -1e-9) a += 2 * math::kPi;
        return i == ring.size() ? 2 * math::kPi : a;
    };
    auto emit = [&](Vec3d a, Vec3d b, Vec3d c) {
        if (turned)
            to.triangle(a, c, b);
        else
            to.triangle(a, b, c);
    };
    for (std::size_t i = 0, k = 0; i < outer.size() || k < inner.size();) {
        const Vec3d a = outer[i % outer.size()], b = inner[k % inner.size()];
        const bool along_outer =
            k == inner.size() || (i < outer.size() && angle(outer, i + 1) <= angle(inner, k + 1));
        if (along_outer)
            emit(a, outer[++i % outer.size()], b);
        else
            emit(a, inner[++k % inner.size()], b);
    }
}

void icosphere(Builder& to, Vec3d centre, double radius)
{
    const double g = (1 + std::sqrt(5.0)) / 2;
    std::vector<Vec3d> v = {{-1, g, 0}, {1, g, 0}, {-1, -g, 0}, {1, -g, 0},
                            {0, -1, g}, {0, 1, g}, {0, -1, -g}, {0, 1, -g},
                            {g, 0, -1}, {g, 0, 1}, {-g, 0, -1}, {-g, 0, 1}};
    for (Vec3d& p : v) p = p / length(p);
    std::vector<std::array<int, 3>> faces = {
        {0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
        {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
        {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
    for (int level = 0; level < 3; ++level) {
        std::map<std::pair<int, int>, int> middles;
        auto middle = [&](int a, int b) {
            const auto [at, is_new] =
                middles.emplace(std::minmax(a, b), static_cast<int>(v.size()));
            if (is_new) {
                const Vec3d m = v[std::size_t(a)] + v[std::size_t(b)];
                v.push_back(m / length(m));
            }
            return at->second;
        };
        std::vector<std::array<int, 3>> finer;
        for (const auto& [a, b, c] : faces) {
            const int ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
            finer.insert(finer.end(), {{a, ab, ca}, {b, bc, ab}, {c, ca, bc}, {ab, bc, ca}});
        }
        faces = std::move(finer);
    }
    auto at = [&](int i) { return centre + v[std::size_t(i)] * radius; };
    for (const auto& [a, b, c] : faces) to.triangle(at(a), at(b), at(c));
}

}  // namespace

TriMesh lantern(double sunk)
{
    // Base, platform and fire box fill whole cells of a grid of planes; so does the roof's flat
    // underside. What is round or slanted is joined along the grid's lines.
    const std::vector<double> xs = {-0.36, -0.25, -0.22, -0.16, -0.07,
                                    0.07,  0.16,  0.22,  0.25,  0.36};
    const std::vector<double> zs = {-sunk, 0.15, 0.75, 0.85, 0.92, 1.06, 1.13, 1.35};
    auto solid = [](Vec3d p) {  // the boxes; the shaft's and the roof's layers count as air
        const double side = std::max(std::abs(p.x), std::abs(p.y));
        if (p.z < 0.15) return side < 0.25;
        if (p.z > 0.75 && p.z < 0.85) return side < 0.22;
        if (p.z < 0.85 || p.z > 1.13) return false;
        const bool window =
            p.z > 0.92 && p.z < 1.06 && std::min(std::abs(p.x), std::abs(p.y)) < 0.07;
        return side < 0.16 && !window;
    };
    Builder to;
    const std::size_t n = xs.size() - 1, layers = zs.size() - 1;
    auto cell = [&](std::size_t i, std::size_t j, std::size_t k) {
        if (i >= n || j >= n || k >= layers) return false;  // also below 0, which wraps
        return solid({(xs[i] + xs[i + 1]) / 2, (xs[j] + xs[j + 1]) / 2, (zs[k] + zs[k + 1]) / 2});
    };
    for (std::size_t k = 0; k < layers; ++k)
        for (std::size_t j = 0; j < n; ++j)
            for (std::size_t i = 0; i < n; ++i) {
                if (!cell(i, j, k)) continue;
                const double x0 = xs[i], x1 = xs[i + 1], y0 = xs[j], y1 = xs[j + 1], z0 = zs[k],
                             z1 = zs[k + 1];
                // Faces under the shaft and the roof are made below.
                const bool under_shaft = std::max({std::abs(x0 + x1), std::abs(y0 + y1)}) < 0.32;
                if (!cell(i + 1, j, k))
                    to.quad({x1, y0, z0}, {x1, y1, z0}, {x1, y1, z1}, {x1, y0, z1});
                if (!cell(i - 1, j, k))
                    to.quad({x0, y0, z0}, {x0, y0, z1}, {x0, y1, z1}, {x0, y1, z0});
                if (!cell(i, j + 1, k))
                    to.quad({x0, y1, z0}, {x0, y1, z1}, {x1, y1, z1}, {x1, y1, z0});
                if (!cell(i, j - 1, k))
                    to.quad({x0, y0, z0}, {x1, y0, z0}, {x1, y0, z1}, {x0, y0, z1});
                if (!cell(i, j, k + 1) && !(z1 == 0.15 && under_shaft) && z1 != 1.13)
                    to.quad({x0, y0, z1}, {x1, y0, z1}, {x1, y1, z1}, {x0, y1, z1});
                if (!cell(i, j, k - 1) && !(z0 == 0.75 && under_shaft))
                    to.quad({x0, y0, z0}, {x0, y1, z0}, {x1, y1, z0}, {x1, y0, z0});
            }
    // Shaft: from the square of the grid around it to the circle, up, and out again.
    const auto foot = square_ring(xs, 0.16, 0.15), head = square_ring(xs, 0.16, 0.75);
    const auto low = circle(kShaft, 0.15), high = circle(kShaft, 0.75);
    strip(to, foot, low, false);
    strip(to, low, high, false);
    strip(to, head, high, true);
    // Roof: underside around the fire box, slanted sides, top.
    for (std::size_t j = 0; j < n; ++j)
        for (std::size_t i = 0; i < n; ++i)
            if (std::max(std::abs(xs[i] + xs[i + 1]), std::abs(xs[j] + xs[j + 1])) > 0.32)
                to.quad({xs[i], xs[j], 1.13}, {xs[i], xs[j + 1], 1.13},
                        {xs[i + 1], xs[j + 1], 1.13}, {xs[i + 1], xs[j], 1.13});
    strip(to, square_ring(xs, kLanternRadius, 1.13),
          square_ring({-kRoofTop, kRoofTop}, kRoofTop, 1.35), false);
    to.quad({-kRoofTop, -kRoofTop, 1.35}, {kRoofTop, -kRoofTop, 1.35}, {kRoofTop, kRoofTop, 1.35},
            {-kRoofTop, kRoofTop, 1.35});
    TriMesh mesh = std::move(to.mesh);
    Builder ball;
    icosphere(ball, {0, 0, 1.425}, 0.075);
    append(mesh, ball.mesh);
    return mesh;
}

TriMesh box(Vec3d lower, Vec3d upper)
{
    Builder to;
    const Vec3d a = lower, b = upper;
    to.quad({b.x, a.y, a.z}, {b.x, b.y, a.z}, {b.x, b.y, b.z}, {b.x, a.y, b.z});
    to.quad({a.x, a.y, a.z}, {a.x, a.y, b.z}, {a.x, b.y, b.z}, {a.x, b.y, a.z});
    to.quad({a.x, b.y, a.z}, {a.x, b.y, b.z}, {b.x, b.y, b.z}, {b.x, b.y, a.z});
    to.quad({a.x, a.y, a.z}, {b.x, a.y, a.z}, {b.x, a.y, b.z}, {a.x, a.y, b.z});
    to.quad({a.x, a.y, b.z}, {b.x, a.y, b.z}, {b.x, b.y, b.z}, {a.x, b.y, b.z});
    to.quad({a.x, a.y, a.z}, {a.x, b.y, a.z}, {b.x, b.y, a.z}, {b.x, a.y, a.z});
    return std::move(to.mesh);
}

void append(TriMesh& mesh, const TriMesh& other)
{
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), other.vertices.begin(), other.vertices.end());
    for (auto t : other.triangles) {
        for (std::uint32_t& v : t) v += first;
        mesh.triangles.push_back(t);
    }
}

}  // namespace sekitei::garden
