#include "solvers/tree/surroundings.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/triangle.h"
#include "grids/winding_number.h"
#include "solvers/rays/embree.h"

namespace sekitei::tree {
namespace {

constexpr double kFar = std::numeric_limits<double>::infinity();
constexpr double kLargest = 1e9;  // [voxels]; farther out, numbers would not fit an index

/// Visits the cubes of the given edge that a half-line passes, in order, within [lower, upper).
/// @param f  bool(Coord cube, double from, double to): distances along the half-line; true stops
/// @return whether f stopped it
template <class F>
bool walk(Vec3d p, Vec3d d, double edge, Coord lower, Coord upper, double from, double to, F&& f)
{
    for (int k = 0; k < 3; ++k) {
        const double low = lower[k] * edge, high = upper[k] * edge;
        if (d[k] == 0) {
            if (!(p[k] >= low && p[k] < high)) return false;
            continue;
        }
        const double a = (low - p[k]) / d[k], b = (high - p[k]) / d[k];
        from = std::max(from, std::min(a, b));
        to = std::min(to, std::max(a, b));
    }
    if (!(from < to)) return false;
    Coord cube;
    Vec3d next(kFar);
    auto wall = [&](int k) { return ((cube[k] + (d[k] > 0)) * edge - p[k]) / d[k]; };
    for (int k = 0; k < 3; ++k) {
        const double at = std::floor((p[k] + d[k] * from) / edge);
        cube[k] = std::clamp(static_cast<std::int32_t>(std::clamp(at, -kLargest, kLargest)),
                             lower[k], upper[k] - 1);
        if (d[k] != 0) next[k] = wall(k);
    }
    while (true) {
        const int k = next.x <= next.y && next.x <= next.z ? 0 : next.y <= next.z ? 1 : 2;
        const double end = std::min(next[k], to);
        if (end > from && f(cube, from, end)) return true;
        from = std::max(from, end);
        if (!(next[k] < to)) return false;
        cube[k] += d[k] > 0 ? 1 : -1;
        if (cube[k] < lower[k] || cube[k] >= upper[k]) return false;
        next[k] = wall(k);
    }
}

/// Blocks of 8^3 cells between voxel centres; that at o uses the nodes o to o + 8, its own leaf's
/// and the first ones of seven leaves beyond. Those which `matters` finds a node for.
/// @param matters  bool(float)
template <class F>
TopologyPtr blocks_of(const FloatGrid& grid, F&& matters)
{
    std::vector<std::uint8_t> sides(grid.leaf_count());  // bit s: block at the leaf less s
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t leaf) {
            if (grid.is_constant(leaf)) {
                sides[leaf] = matters(grid.constant(leaf)) ? 0xFF : 0;
                return;
            }
            const float* v = grid.values(leaf);
            unsigned found = 0;
            for (int o = 0; o < kLeafSize; ++o) {
                if (!matters(v[o])) continue;
                const bool x = o >> 6 == 0, y = ((o >> 3) & 7) == 0, z = (o & 7) == 0;
                found |= (x ? 0xFFu : 0x0Fu) & (y ? 0xFFu : 0x33u) & (z ? 0xFFu : 0x55u);
            }
            sides[leaf] = static_cast<std::uint8_t>(found);
        },
        16);
    std::vector<Coord> origins;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int s = 0; s < 8; ++s)
            if (sides[leaf] >> s & 1)
                origins.push_back(grid.origin(leaf) -
                                  Coord((s >> 2) & 1, (s >> 1) & 1, s & 1) * kLeafEdge);
    return LeafTopology::build(std::move(origins));
}

/// Their box, in blocks.
std::pair<Coord, Coord> box_of(const LeafTopology& blocks)
{
    if (blocks.size() == 0) return {};
    Coord lower = blocks.origin(0), upper = lower;
    for (const Coord& o : blocks.origins()) lower = min(lower, o), upper = max(upper, o);
    auto block = [](Coord o) { return Coord(o.x >> 3, o.y >> 3, o.z >> 3); };
    return {block(lower), block(upper) + Coord(1)};
}

/// World space to "nodes": voxel units in which voxel centres are whole numbers.
Vec3d nodes_of(const Transform& transform, Vec3d at)
{
    return transform.voxels(at) - Vec3d(0.5);
}

/// The eight voxels around places, mostly of one leaf, which is then looked up once.
class Corners {
public:
    explicit Corners(const FloatGrid& grid) : grid_(grid), reader_(grid) {}

    /// Values at c + (0 or 1), x slowest.
    void read(Coord c, std::array<double, 8>& v)
    {
        const Coord origin = leaf_origin(c);
        if (!known_ || !(origin == origin_)) {
            origin_ = origin;
            leaf_ = grid_.topology()->find(origin);
            values_ = leaf_ == kNoLeaf ? nullptr : grid_.values(leaf_);
            known_ = true;
        }
        if ((c.x & 7) == 7 || (c.y & 7) == 7 || (c.z & 7) == 7) {
            for (int k = 0; k < 8; ++k)
                v[std::size_t(k)] = double(reader_.value(c + Coord(k >> 2, (k >> 1) & 1, k & 1)));
        } else if (values_) {
            const float* at = values_ + leaf_offset(c);
            v = {double(at[0]),  double(at[1]),  double(at[8]),  double(at[9]),
                 double(at[64]), double(at[65]), double(at[72]), double(at[73])};
        } else
            v.fill(double(leaf_ == kNoLeaf ? grid_.background() : grid_.constant(leaf_)));
    }

private:
    const FloatGrid& grid_;
    GridReader<float> reader_;
    Coord origin_;
    std::uint32_t leaf_ = kNoLeaf;
    const float* values_ = nullptr;
    bool known_ = false;
};

/// Trilinear between the corners, f in 0..1.
double mixed(const std::array<double, 8>& v, Vec3d f)
{
    auto mix = [](double a, double b, double t) { return a + (b - a) * t; };
    return mix(mix(mix(v[0], v[1], f.z), mix(v[2], v[3], f.z), f.y),
               mix(mix(v[4], v[5], f.z), mix(v[6], v[7], f.z), f.y), f.x);
}

Coord floor_of(Vec3d p)
{
    return {static_cast<std::int32_t>(std::floor(p.x)), static_cast<std::int32_t>(std::floor(p.y)),
            static_cast<std::int32_t>(std::floor(p.z))};
}

bool within_indices(Vec3d p)
{
    return std::abs(p.x) < kLargest && std::abs(p.y) < kLargest && std::abs(p.z) < kLargest;
}

class LevelSetObstacle final : public Obstacle {
public:
    explicit LevelSetObstacle(const FloatGrid& grid) : grid_(&grid)
    {
        check();
        blocks_ = blocks_of(grid, [](float v) { return v < 0; });
        std::tie(lower_, upper_) = box_of(*blocks_);
    }

    bool blocks(Vec3d from, Vec3d direction) const override
    {
        const double h = grid_->transform().voxel;
        const Vec3d p = nodes_of(grid_->transform(), from);
        Corners corners(*grid_);
        std::array<double, 8> v;
        return walk(p, direction, kLeafEdge, lower_, upper_, 0, kFar,
                    [&](Coord block, double t, double end) {
                        if (blocks_->find(block * kLeafEdge) == kNoLeaf) return false;
                        while (true) {
                            const Vec3d at = p + direction * t;
                            const Coord cell = floor_of(at);
                            corners.read(cell, v);
                            const double d = mixed(v, at - Vec3d(cell)) / h;
                            if (d < 0) return true;
                            if (t == end) return false;
                            // Distances of united or cut bodies are too large here and there.
                            t = std::min(end, t + std::max(kLeastStep, 0.8 * d));
                        }
                    });
    }
    double distance(Vec3d at) const override
    {
        const Vec3d p = grid_->transform().voxels(at);
        if (!within_indices(p)) return kFar;
        const double d = double(GridReader<float>(*grid_).sample(p));
        return d < double(grid_->background()) * (1 - 1e-6) ? d : kFar;
    }
    double reach() const override
    {
        // Nearer than this, all eight voxels around a place know their distance.
        return double(grid_->background()) - 1.75 * grid_->transform().voxel;
    }
    Vec3d away(Vec3d at) const override
    {
        const Vec3d p = grid_->transform().voxels(at);
        if (!within_indices(p)) return {0, 0, 1};
        GridReader<float> reader(*grid_);
        Vec3d gradient;
        for (int k = 0; k < 3; ++k) {
            Vec3d step;
            step[k] = 0.5;
            gradient[k] = double(reader.sample(p + step)) - double(reader.sample(p - step));
        }
        const double l = length(gradient);
        return l > 0 ? gradient / l : Vec3d(0, 0, 1);
    }

private:
    static constexpr double kLeastStep = 0.25;  // [voxels]; what passes is a 1/100 voxel deep

    void check() const
    {
        const double band = double(grid_->background());
        auto refuse = [](const std::string& what) {
            throw InvalidInput("tree: the obstacle is no level set: " + what +
                               "; expected distances in metres, negative inside, in a band of 3 "
                               "voxels or more");
        };
        if (!(std::isfinite(band) && band >= 2 * grid_->transform().voxel))
            refuse(fmt::format("background = {} m at a voxel of {} m", band,
                               grid_->transform().voxel));
        const std::size_t leaves = grid_->leaf_count();
        std::vector<std::array<bool, 3>> found(leaves);  // active, inside, broken
        parallel_for(
            leaves,
            [&](std::size_t leaf) {
                found[leaf][0] = !grid_->mask(leaf).none();
                for (int o = 0; o < (grid_->is_constant(leaf) ? 1 : kLeafSize); ++o) {
                    const float v = grid_->at(leaf, o);
                    found[leaf][1] |= v < 0;
                    found[leaf][2] |= !(std::abs(double(v)) <= 2 * band);
                }
            },
            64);
        std::array<bool, 3> any{};
        for (const auto& f : found)
            for (std::size_t k = 0; k < 3; ++k) any[k] |= f[k];
        if (any[2]) refuse(fmt::format("values beyond its background of {} m, or NaN", band));
        if (!any[0]) refuse("it has no active voxels");
        if (!any[1]) refuse("nothing is inside");
    }

    const FloatGrid* grid_;
    TopologyPtr blocks_;   ///< with a node inside
    Coord lower_, upper_;  ///< their box, in blocks
};

class MeshObstacle final : public Obstacle {
public:
    MeshObstacle(TriMesh mesh, double reach, const Progress& progress)
        : mesh_(checked(std::move(mesh), reach)),
          triangles_(mesh_.vertices, mesh_.triangles, "tree", progress),
          winding_(mesh_),
          reach_(reach),
          bounds_(mesh_.bounds())
    {
    }

    bool blocks(Vec3d from, Vec3d direction) const override
    {
        return triangles_.occluded(Vec3f(from), Vec3f(direction), 0,
                                   std::numeric_limits<float>::infinity());
    }
    double distance(Vec3d at) const override
    {
        for (int k = 0; k < 3; ++k)
            if (!(at[k] > bounds_.lower[k] - reach_ && at[k] < bounds_.upper[k] + reach_))
                return kFar;
        const Nearest nearest = find(at);
        const bool inside = is_inside(at);
        if (!nearest.found) return inside ? -reach_ : kFar;
        return inside ? -nearest.distance : nearest.distance;
    }
    double reach() const override { return reach_; }
    Vec3d away(Vec3d at) const override
    {
        const Nearest nearest = find(at);
        if (!nearest.found) return {0, 0, 1};
        const bool inside = is_inside(at);
        const Vec3d off = inside ? nearest.at - at : at - nearest.at;
        // Closer than floats can tell, the triangle itself knows better.
        const double least = 1e-6 * (1 + length(at));
        if (nearest.distance > least) return off / nearest.distance;
        const auto [a, b, c] = corners(nearest.triangle);
        const Vec3d normal = normalized(cross(b - a, c - a));
        // Of a mesh wound inwards, normals point inside.
        return is_inside(nearest.at + normal * (4 * least)) ? -normal : normal;
    }

private:
    struct Nearest {
        bool found = false;
        double distance = 0;
        Vec3d at;
        std::uint32_t triangle = 0;
    };

    static TriMesh checked(TriMesh mesh, double reach)
    {
        if (!(reach > 0 && std::isfinite(reach)))
            throw InvalidParameter(
                fmt::format("tree: reach of an obstacle = {} m, must be > 0", reach));
        return mesh;
    }
    std::array<Vec3d, 3> corners(std::uint32_t triangle) const
    {
        const auto& t = mesh_.triangles[triangle];
        return {Vec3d(mesh_.vertices[t[0]]), Vec3d(mesh_.vertices[t[1]]),
                Vec3d(mesh_.vertices[t[2]])};
    }
    Nearest find(Vec3d at) const
    {
        Nearest best;
        double best2 = reach_ * reach_;
        triangles_.near(at, reach_, [&](std::uint32_t triangle) {
            const auto [a, b, c] = corners(triangle);
            const Vec3d p = closest_on_triangle(at, a, b, c);
            const double d2 = dot(p - at, p - at);
            if (d2 < best2 || (d2 == best2 && (!best.found || triangle < best.triangle))) {
                best = {true, std::sqrt(d2), p, triangle};
                best2 = d2;
            }
            return std::sqrt(best2);
        });
        return best;
    }
    /// The nearest triangle's side would do but for edges and corners, where it may be the wrong
    /// one; parts that overlap would need more.
    bool is_inside(Vec3d at) const { return std::abs(winding_(at)) > 0.5; }

    TriMesh mesh_;
    rays::TriangleScene triangles_;
    WindingNumber winding_;
    double reach_;
    Bounds bounds_;
};

}  // namespace

std::unique_ptr<Obstacle> level_set_obstacle(const FloatGrid& grid)
{
    return std::make_unique<LevelSetObstacle>(grid);
}

std::unique_ptr<Obstacle> mesh_obstacle(TriMesh mesh, double reach, const Progress& progress)
{
    return std::make_unique<MeshObstacle>(std::move(mesh), reach, progress);
}

BackgroundShade::BackgroundShade(const FloatGrid& leaf_area_density, double projection)
    : grid_(&leaf_area_density), projection_(projection)
{
    if (!(projection >= 0 && projection <= 1))
        throw InvalidParameter(
            fmt::format("tree: leaf_projection = {}, must be between 0 and 1", projection));
    if (leaf_area_density.background() != 0)
        throw InvalidInput(fmt::format("tree: background of canopy_lad = {} 1/m, must be 0",
                                       leaf_area_density.background()));
    std::vector<std::uint8_t> broken(grid_->leaf_count());
    parallel_for(
        grid_->leaf_count(),
        [&](std::size_t leaf) {
            for (int o = 0; o < (grid_->is_constant(leaf) ? 1 : kLeafSize); ++o) {
                const float v = grid_->at(leaf, o);
                if (!(v >= 0 && std::isfinite(v))) broken[leaf] = 1;
            }
        },
        64);
    if (std::find(broken.begin(), broken.end(), 1) != broken.end())
        throw InvalidInput(
            "tree: canopy_lad has values below 0 or not finite, must be a leaf area density in "
            "1/m");
    blocks_ = blocks_of(*grid_, [](float v) { return v != 0; });
    std::tie(lower_, upper_) = box_of(*blocks_);
    // Blocks of one density all over need no steps from voxel to voxel.
    uniform_.assign(blocks_->size(), -1.0f);
    parallel_for(
        blocks_->size(),
        [&](std::size_t i) {
            const Coord o = blocks_->origin(i);
            float value = -1;
            for (int s = 0; s < 8; ++s) {
                const std::uint32_t leaf = grid_->topology()->find(
                    o + Coord((s >> 2) & 1, (s >> 1) & 1, s & 1) * kLeafEdge);
                if (leaf != kNoLeaf && !grid_->is_constant(leaf)) return;
                const float v = leaf == kNoLeaf ? 0 : grid_->constant(leaf);
                if (s > 0 && v != value) return;
                value = v;
            }
            uniform_[i] = value;
        },
        64);
}

void BackgroundShade::set_growth(double share, std::vector<Vec3d> feet)
{
    if (!(share > 0 && share <= 1 && !feet.empty()))
        throw InvalidParameter(fmt::format(
            "tree: growth of the shade = {}, must be > 0, <= 1, over one foot at least", share));
    share_ = share;
    feet_ = std::move(feet);
}

double BackgroundShade::transmittance(Vec3d from, Vec3d direction) const
{
    constexpr double kOpaque = 60;  // exp(-60) is nothing beside what double sums can tell
    if (lit_from_below_ && direction.z < 0) return 1;
    double all = 0;
    if (share_ == 1)
        all = depth(from, direction, kOpaque);
    else {
        // What is drawn out upwards again is what is known; each metre of a ray is then `longer`.
        const Vec3d* foot = &feet_.front();
        double nearest = INFINITY;
        for (const Vec3d& f : feet_) {
            const Vec3d away = f - from;
            const double square = away.x * away.x + away.y * away.y;
            if (square < nearest) nearest = square, foot = &f;
        }
        from.z = foot->z + (from.z - foot->z) / share_;
        direction.z /= share_;
        const double longer = length(direction);
        all = depth(from, direction / longer, kOpaque * longer * share_) / (longer * share_);
    }
    return all * strength_ > kOpaque ? 0 : math::exp(-all * strength_);
}

double BackgroundShade::depth(Vec3d from, Vec3d direction, double opaque) const
{
    const Transform& transform = grid_->transform();
    const double per_voxel = projection_ * transform.voxel;
    const Vec3d p = nodes_of(transform, from);
    Corners corners(*grid_);
    std::array<double, 8> v;
    double all = 0;
    walk(p, direction, kLeafEdge, lower_, upper_, 0, kFar,
         [&](Coord block, double begin, double end) {
             const std::uint32_t index = blocks_->find(block * kLeafEdge);
             if (index == kNoLeaf) return false;
             if (uniform_[index] >= 0) {
                 all += per_voxel * double(uniform_[index]) * (end - begin);
                 return all > opaque;
             }
             // Between eight voxels the field is a cubic along the line: Gauss's two points give
             // its integral exactly.
             const Coord low = block * kLeafEdge;
             walk(p, direction, 1, low, low + Coord(kLeafEdge), begin, end,
                  [&](Coord cell, double a, double b) {
                      constexpr double kGauss = 0.57735026918962576451;
                      corners.read(cell, v);
                      const Vec3d middle = p + direction * ((a + b) / 2) - Vec3d(cell);
                      const double half = (b - a) / 2;
                      const Vec3d off = direction * (half * kGauss);
                      all += per_voxel * half * (mixed(v, middle - off) + mixed(v, middle + off));
                      return false;
                  });
             return all > opaque;
         });
    return all;
}

}  // namespace sekitei::tree
