#include "core/mesh_intersections.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <numeric>
#include <vector>

#include "core/parallel.h"

namespace sekitei {
namespace {

constexpr std::uint32_t kLeafTriangles = 4;
constexpr int kMostLookedAt = 4096;

/// Sign of the volume of the tetrahedron (a, b, c, d); 0 within rounding error.
int side(Vec3d a, Vec3d b, Vec3d c, Vec3d d)
{
    const Vec3d u = b - a, v = c - a, w = d - a;
    auto size = [](Vec3d p) { return Vec3d(std::fabs(p.x), std::fabs(p.y), std::fabs(p.z)); };
    const double volume = dot(cross(u, v), w);
    // Each product is wrong by less than this share of its size, rounded differences included.
    const Vec3d p = size(u), q = size(v), r = size(w);
    const double all = (p.y * q.z + p.z * q.y) * r.x + (p.z * q.x + p.x * q.z) * r.y +
                       (p.x * q.y + p.y * q.x) * r.z;
    const double error = 1e-15 * all;
    return volume > error ? 1 : volume < -error ? -1 : 0;
}

using Corners = std::array<Vec3d, 3>;

/// Whether the segment passes through the triangle or its rim from one side to the other.
bool pierces(Vec3d from, Vec3d to, const Corners& t)
{
    const int first = side(t[0], t[1], t[2], from), last = side(t[0], t[1], t[2], to);
    if (first * last != -1) return false;
    bool left = false, right = false;
    for (std::size_t k = 0; k < 3; ++k) {
        const int s = side(from, to, t[k], t[(k + 1) % 3]);
        left = left || s > 0;
        right = right || s < 0;
    }
    return !(left && right);
}

bool meet(const Corners& a, const Corners& b)
{
    for (std::size_t k = 0; k < 3; ++k)
        if (pierces(a[k], a[(k + 1) % 3], b) || pierces(b[k], b[(k + 1) % 3], a)) return true;
    return false;
}

struct Box {
    Vec3f lower{INFINITY}, upper{-INFINITY};

    void add(const Box& b)
    {
        lower = min(lower, b.lower);
        upper = max(upper, b.upper);
    }
    bool overlaps(const Box& b) const
    {
        for (int k = 0; k < 3; ++k)
            if (lower[k] > b.upper[k] || b.lower[k] > upper[k]) return false;
        return true;
    }
};

class Tree {
public:
    Tree(const TriMesh& mesh, const Progress& progress) : mesh_(mesh), order_(mesh.triangles.size())
    {
        boxes_.resize(order_.size());
        std::iota(order_.begin(), order_.end(), 0u);
        parallel_for(
            boxes_.size(),
            [&](std::size_t i) {
                for (const std::uint32_t v : mesh.triangles[i])
                    boxes_[i].add({mesh.vertices[v], mesh.vertices[v]});
            },
            1024);
        nodes_.reserve(order_.size());
        build(0, static_cast<std::uint32_t>(order_.size()), progress);
    }

    /// Pairs of triangle i and a later one that meet.
    std::uint64_t count(std::uint32_t i) const
    {
        const Corners own = corners(i);
        std::uint64_t found = 0;
        int looked_at = 0;
        std::vector<std::uint32_t> stack{0};
        while (!stack.empty() && looked_at < kMostLookedAt) {
            const std::uint32_t n = stack.back();
            stack.pop_back();
            const Node& node = nodes_[n];
            if (!node.box.overlaps(boxes_[i])) continue;
            if (node.right != 0) {
                stack.push_back(node.right);
                stack.push_back(n + 1);
                continue;
            }
            for (std::uint32_t k = node.begin; k < node.end; ++k) {
                const std::uint32_t j = order_[k];
                if (j <= i || !boxes_[j].overlaps(boxes_[i])) continue;
                ++looked_at;
                if (!joined(i, j) && meet(own, corners(j))) ++found;
            }
        }
        return found;
    }

private:
    struct Node {
        Box box;
        std::uint32_t begin, end;
        std::uint32_t right = 0;  // the left child follows its parent; 0: no children
    };

    std::uint32_t build(std::uint32_t begin, std::uint32_t end, const Progress& progress)
    {
        progress.check();
        const auto n = static_cast<std::uint32_t>(nodes_.size());
        nodes_.push_back({{}, begin, end});
        Box box;
        for (std::uint32_t k = begin; k < end; ++k) box.add(boxes_[order_[k]]);
        nodes_[n].box = box;
        if (end - begin <= kLeafTriangles) return n;
        const Vec3f size = box.upper - box.lower;
        const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
        const std::uint32_t middle = begin + (end - begin) / 2;
        std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                         [&](std::uint32_t a, std::uint32_t b) {
                             const float p = boxes_[a].lower[axis] + boxes_[a].upper[axis];
                             const float q = boxes_[b].lower[axis] + boxes_[b].upper[axis];
                             return p != q ? p < q : a < b;
                         });
        build(begin, middle, progress);
        nodes_[n].right = build(middle, end, progress);
        return n;
    }

    Corners corners(std::uint32_t i) const
    {
        const auto& t = mesh_.triangles[i];
        return {Vec3d(mesh_.vertices[t[0]]), Vec3d(mesh_.vertices[t[1]]),
                Vec3d(mesh_.vertices[t[2]])};
    }
    bool joined(std::uint32_t i, std::uint32_t j) const
    {
        for (const std::uint32_t v : mesh_.triangles[i])
            for (const std::uint32_t w : mesh_.triangles[j])
                if (v == w || mesh_.vertices[v] == mesh_.vertices[w]) return true;
        return false;
    }

    const TriMesh& mesh_;
    std::vector<Box> boxes_;
    std::vector<std::uint32_t> order_;
    std::vector<Node> nodes_;
};

}  // namespace

std::uint64_t count_self_intersections(const TriMesh& mesh, std::uint64_t most,
                                       const Progress& progress)
{
    if (mesh.triangles.empty()) return 0;
    const Tree tree(mesh, progress);
    std::atomic<std::uint64_t> found{0};  // integers: any order gives one sum
    parallel_for(
        mesh.triangles.size(),
        [&](std::size_t i) {
            progress.check();
            if (found.load(std::memory_order_relaxed) > most) return;
            if (const std::uint64_t n = tree.count(static_cast<std::uint32_t>(i))) found += n;
        },
        256);
    return std::min(found.load(), most + 1);
}

}  // namespace sekitei
