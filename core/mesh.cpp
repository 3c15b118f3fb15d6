#include "core/mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/error.h"
#include "core/mesh_sides.h"
#include "core/parallel.h"

namespace sekitei {
namespace {

bool finite(Vec3f p)
{
    return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
}

struct Pieces {
    std::vector<std::uint32_t> parent;

    explicit Pieces(std::size_t count) : parent(count)
    {
        std::iota(parent.begin(), parent.end(), 0u);
    }
    std::uint32_t find(std::uint32_t i)
    {
        while (parent[i] != i) i = parent[i] = parent[parent[i]];
        return i;
    }
    void join(std::uint32_t a, std::uint32_t b)
    {
        a = find(a);
        b = find(b);
        parent[std::max(a, b)] = std::min(a, b);
    }
};

}  // namespace

Bounds TriMesh::bounds() const
{
    Bounds box;
    for (const Vec3f& v : vertices) box.add(Vec3d(v));
    return box;
}

double TriMesh::signed_volume() const
{
    // Measure from the middle: far from the origin the terms would cancel.
    const Bounds box = bounds();
    const Vec3d origin = box.empty() ? Vec3d{} : box.centre();
    return parallel_sum(triangles.size(), [&](std::size_t t) {
        const Vec3d a = Vec3d(vertices[triangles[t][0]]) - origin,
                    b = Vec3d(vertices[triangles[t][1]]) - origin,
                    c = Vec3d(vertices[triangles[t][2]]) - origin;
        return dot(a, cross(b, c)) / 6;
    });
}

double TriMesh::area() const
{
    return parallel_sum(triangles.size(), [&](std::size_t t) {
        const Vec3d a(vertices[triangles[t][0]]), b(vertices[triangles[t][1]]),
            c(vertices[triangles[t][2]]);
        return length(cross(b - a, c - a)) / 2;
    });
}

MeshReport inspect(const TriMesh& mesh)
{
    MeshReport report;
    report.vertices = mesh.vertices.size();
    report.triangles = mesh.triangles.size();
    if (mesh.vertices.size() > std::numeric_limits<std::uint32_t>::max() ||
        mesh.triangles.size() > std::numeric_limits<std::uint32_t>::max())
        throw LimitExceeded(fmt::format("mesh: {} vertices and {} triangles, at most 4.29 billion",
                                        mesh.vertices.size(), mesh.triangles.size()));
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
        for (const std::uint32_t v : mesh.triangles[t])
            if (v >= mesh.vertices.size())
                throw InvalidInput(fmt::format("mesh: triangle {} has vertex {}, must be below {}",
                                               t, v, mesh.vertices.size()));

    // Look at every vertex and every triangle.
    std::vector<char> used(mesh.vertices.size(), 0);
    TriMesh sound;  // triangles whose measures are numbers
    std::vector<TriangleSide> sides;
    sides.reserve(3 * mesh.triangles.size());
    Pieces pieces(mesh.triangles.size());
    std::size_t whole = 0;  // triangles with three different vertices
    report.least_area = mesh.triangles.empty() ? 0 : std::numeric_limits<double>::infinity();
    for (const Vec3f& v : mesh.vertices) report.bad_vertices += !finite(v);
    for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) {
        const auto& [a, b, c] = mesh.triangles[t];
        used[a] = used[b] = used[c] = 1;
        const bool numbers =
            finite(mesh.vertices[a]) && finite(mesh.vertices[b]) && finite(mesh.vertices[c]);
        const double area =
            numbers ? triangle_area(mesh.vertices[a], mesh.vertices[b], mesh.vertices[c])
                    : std::numeric_limits<double>::infinity();
        report.least_area = std::min(report.least_area, area);
        if (numbers) sound.triangles.push_back(mesh.triangles[t]);
        const bool repeated = a == b || b == c || c == a;
        if (repeated || area == 0) ++report.zero_area;
        if (repeated) continue;
        ++whole;
        append_sides(mesh, t, sides);
    }

    // Look at every edge.
    sort_by_edge(sides);
    std::int64_t edges = 0;
    for (std::size_t i = 0, next = 0; i < sides.size(); i = next) {
        for (next = i + 1; next < sides.size() && sides[next].edge == sides[i].edge; ++next)
            pieces.join(sides[i].triangle, sides[next].triangle);
        ++edges;
        const std::size_t count = next - i;
        report.open_edges += count == 1;
        report.non_manifold_edges += count > 2;
        report.misoriented_edges += count == 2 && sides[i].rising == sides[i + 1].rising;
    }
    for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) {
        const auto& [a, b, c] = mesh.triangles[t];
        const bool repeated = a == b || b == c || c == a;
        report.pieces += !repeated && pieces.find(t) == t;
    }
    const auto used_count = std::count(used.begin(), used.end(), 1);
    report.isolated_vertices = mesh.vertices.size() - static_cast<std::size_t>(used_count);

    // Vertices of repeated triangles alone belong to no surface.
    std::fill(used.begin(), used.end(), 0);
    for (const TriangleSide& side : sides)
        used[side.edge >> 32] = used[side.edge & 0xFFFFFFFFu] = 1;
    report.euler =
        std::count(used.begin(), used.end(), 1) - edges + static_cast<std::int64_t>(whole);

    if (!std::isfinite(report.least_area)) report.least_area = 0;
    sound.vertices = mesh.vertices;
    for (Vec3f& v : sound.vertices)
        if (!finite(v)) v = {};
    report.volume = sound.signed_volume();
    report.area = sound.area();
    return report;
}

double triangle_area(Vec3f a, Vec3f b, Vec3f c)
{
    const Vec3d origin(a);
    return length(cross(Vec3d(b) - origin, Vec3d(c) - origin)) / 2;
}

}  // namespace sekitei
