#include "grids/winding_number.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/math.h"

namespace sekitei {
namespace {

constexpr std::uint32_t kLeafTriangles = 8;
constexpr double kFar = 2.5;  // a node farther than this many radii acts as one dipole

/// Solid angle of a triangle seen from the origin [VanOosterom1983].
double solid_angle(Vec3d a, Vec3d b, Vec3d c)
{
    const double la = length(a), lb = length(b), lc = length(c);
    const double numerator = dot(a, cross(b, c));
    const double denominator = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
    if (numerator == 0 && denominator == 0) return 0;
    return 2 * math::atan2(numerator, denominator);
}

}  // namespace

WindingNumber::WindingNumber(const TriMesh& mesh)
{
    std::vector<Vec3d> centres;
    for (const auto& t : mesh.triangles) {
        const std::array<Vec3d, 3> corners{Vec3d(mesh.vertices[t[0]]), Vec3d(mesh.vertices[t[1]]),
                                           Vec3d(mesh.vertices[t[2]])};
        triangles_.push_back(corners);
        centres.push_back((corners[0] + corners[1] + corners[2]) / 3.0);
    }
    if (!triangles_.empty()) build(0, static_cast<std::uint32_t>(triangles_.size()), centres);
}

std::uint32_t WindingNumber::build(std::uint32_t begin, std::uint32_t end,
                                   std::vector<Vec3d>& centres)
{
    const auto self = static_cast<std::uint32_t>(nodes_.size());
    nodes_.emplace_back();
    Node node;
    node.begin = begin;
    node.end = end;
    double weight = 0;
    Vec3d weighted;
    Bounds bounds;
    for (std::uint32_t i = begin; i < end; ++i) {
        const auto& t = triangles_[i];
        const Vec3d area = cross(t[1] - t[0], t[2] - t[0]) * 0.5;
        node.area += area;
        weight += length(area);
        weighted += centres[i] * length(area);
        bounds.add(centres[i]);
    }
    node.centre = weight > 0 ? weighted / weight : bounds.centre();
    for (std::uint32_t i = begin; i < end; ++i)
        for (const Vec3d& corner : triangles_[i])
            node.radius = std::max(node.radius, length(corner - node.centre));

    if (end - begin > kLeafTriangles) {
        const Vec3d size = bounds.size();
        const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
        std::vector<std::uint32_t> order(end - begin);
        std::iota(order.begin(), order.end(), begin);
        const auto middle = order.begin() + static_cast<std::ptrdiff_t>(order.size() / 2);
        std::nth_element(order.begin(), middle, order.end(), [&](std::uint32_t a, std::uint32_t b) {
            const double x = centres[a][axis], y = centres[b][axis];
            return x != y ? x < y : a < b;
        });
        std::vector<std::array<Vec3d, 3>> sorted;
        std::vector<Vec3d> sorted_centres;
        for (const std::uint32_t i : order) {
            sorted.push_back(triangles_[i]);
            sorted_centres.push_back(centres[i]);
        }
        std::copy(sorted.begin(), sorted.end(), triangles_.begin() + begin);
        std::copy(sorted_centres.begin(), sorted_centres.end(), centres.begin() + begin);
        const std::uint32_t cut = begin + static_cast<std::uint32_t>(order.size() / 2);
        build(begin, cut, centres);
        node.right = build(cut, end, centres);
    }
    nodes_[self] = node;
    return self;
}

double WindingNumber::operator()(Vec3d p) const
{
    if (nodes_.empty()) return 0;
    double angle = 0;
    std::uint32_t stack[64];
    int depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
        const std::uint32_t at = stack[--depth];
        const Node& node = nodes_[at];
        const Vec3d r = node.centre - p;
        const double squared = dot(r, r);
        if (squared > kFar * kFar * node.radius * node.radius) {
            angle += dot(r, node.area) / (squared * std::sqrt(squared));
        } else if (node.right == 0) {
            for (std::uint32_t i = node.begin; i < node.end; ++i) {
                const auto& t = triangles_[i];
                angle += solid_angle(t[0] - p, t[1] - p, t[2] - p);
            }
        } else {
            stack[depth++] = node.right;
            stack[depth++] = at + 1;
        }
    }
    return angle / (4 * math::kPi);
}

}  // namespace sekitei
