#include "solvers/wind/tunnel_scene.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "core/parallel.h"

namespace sekitei::wind {
namespace {

constexpr int kMostSamples = 8;  // an edge of a cube
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

Coord floor_coord(Vec3d p)
{
    return {int(std::floor(p.x)), int(std::floor(p.y)), int(std::floor(p.z))};
}

/// Voxels [lower, upper) of those that count.
struct VoxelBox {
    Coord lower{std::numeric_limits<int>::max()}, upper{std::numeric_limits<int>::min()};
    bool empty() const { return lower.x >= upper.x; }
    void add(Coord c)
    {
        lower = min(lower, c);
        upper = max(upper, c + Coord(1));
    }
};

template <class T, class Constant>
VoxelBox active_box(const LeafGrid<T>& grid, Constant&& constant_counts)
{
    VoxelBox box;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf) {
        const Coord origin = grid.origin(leaf);
        const LeafMask& mask = grid.mask(leaf);
        if (mask.all() || (grid.is_constant(leaf) && constant_counts(grid.constant(leaf)))) {
            box.add(origin);
            box.add(origin + Coord(kLeafEdge - 1));
        } else {
            mask.for_each([&](int offset) { box.add(leaf_coord(origin, offset)); });
        }
    }
    return box;
}

VoxelBox known_box(const FloatGrid& level_set)
{
    return active_box(level_set, [](float v) { return v < 0; });
}

/// Whether points are inside a level set; one per thread.
class Body {
public:
    Body(const FloatGrid& level_set, const VoxelBox& known)
        : transform_(level_set.transform()), reader_(level_set), known_(known)
    {
    }

    bool inside(Vec3d world)
    {
        Vec3d p = transform_.voxels(world);
        p.x = std::clamp(p.x, known_.lower.x + 0.5, known_.upper.x - 0.5);
        p.y = std::clamp(p.y, known_.lower.y + 0.5, known_.upper.y - 0.5);
        p.z = std::max(p.z, known_.lower.z + 0.5);
        const double nearest = double(reader_.value(floor_coord(p)));
        if (std::abs(nearest) > transform_.voxel) return nearest < 0;
        // Between voxels, so that a scene and its mirror image have the same cubes.
        return reader_.sample(p) < 0;
    }

private:
    Transform transform_;
    GridReader<float> reader_;
    VoxelBox known_;
};

/// The level of water over each column of its voxels.
struct WaterLevels {
    Transform transform;
    VoxelBox box;
    std::vector<double> level;

    explicit WaterLevels(const IntGrid& water) : transform(water.transform())
    {
        box = active_box(water, [](std::int32_t) { return false; });
        if (box.empty()) return;
        level.assign(
            std::size_t(box.upper.x - box.lower.x) * std::size_t(box.upper.y - box.lower.y), kNone);
        for (std::size_t leaf = 0; leaf < water.leaf_count(); ++leaf)
            water.mask(leaf).for_each([&](int offset) {
                const Coord c = leaf_coord(water.origin(leaf), offset);
                const double top = transform.world(Vec3d(c + Coord(0, 0, 1))).z;
                double& here = level[column(c)];
                here = here >= top ? here : top;
            });
    }
    std::size_t column(Coord c) const
    {
        return std::size_t(c.x - box.lower.x) * std::size_t(box.upper.y - box.lower.y) +
               std::size_t(c.y - box.lower.y);
    }
    double at(Vec3d world) const
    {
        const Coord c = floor_coord(transform.voxels(world));
        if (c.x < box.lower.x || c.x >= box.upper.x || c.y < box.lower.y || c.y >= box.upper.y)
            return kNone;
        return level[column(c)];
    }
};

/// The cubes of a tunnel.
struct Cubes {
    Vec3d lower;
    double l0 = 0;
    Coord n;
    std::vector<std::uint8_t> solid;
    std::vector<float> drag;

    std::size_t at(Coord c) const
    {
        return (std::size_t(c.x) * std::size_t(n.y) + std::size_t(c.y)) * std::size_t(n.z) +
               std::size_t(c.z);
    }
    bool holds(Coord c) const
    {
        return c.x >= 0 && c.y >= 0 && c.z >= 0 && c.x < n.x && c.y < n.y && c.z < n.z;
    }
    Coord of(Vec3d p) const { return floor_coord((p - lower) / l0); }
};

/// Whether walls thinner than the cube have their middle in it along half of the lines of an axis.
/// `inside` is asked at sample `s` of the cube; samples -m .. 2 m reach one cube farther.
template <class Inside>
bool holds_thin_wall(int m, Inside&& inside)
{
    for (int axis = 0; axis < 3; ++axis) {
        const int b = (axis + 1) % 3, c = (axis + 2) % 3;
        int lines = 0;
        for (int i = 0; i < m; ++i)
            for (int j = 0; j < m; ++j) {
                Coord s;
                s[b] = i, s[c] = j;
                bool found = false;
                int begin = 0, length = 0;
                for (int k = -m; k <= 2 * m; ++k) {
                    s[axis] = k;
                    if (k < 2 * m && inside(s)) {
                        if (length++ == 0) begin = k;
                        continue;
                    }
                    const int twice = 2 * begin + length;  // of the middle
                    found |= length > 0 && length < m && twice >= 0 && twice < 2 * m;
                    length = 0;
                }
                lines += found;
            }
        if (2 * lines >= m * m) return true;
    }
    return false;
}

int samples_per_edge(double l0, double voxel)
{
    return int(std::clamp(std::ceil(l0 / voxel - 1e-6), 1.0, double(kMostSamples)));
}

void mark_solid(const FloatGrid& level_set, const Heading& heading, const Progress& progress,
                Cubes& cubes)
{
    const VoxelBox known = known_box(level_set);
    if (known.empty()) return;
    const int m = samples_per_edge(cubes.l0, level_set.transform().voxel);
    parallel_for(
        std::size_t(cubes.n.x) * std::size_t(cubes.n.y),
        [&](std::size_t column) {
            progress.check();
            Body body(level_set, known);
            for (int k = 0; k < cubes.n.z; ++k) {
                const Coord cube(int(column / std::size_t(cubes.n.y)),
                                 int(column % std::size_t(cubes.n.y)), k);
                std::uint8_t& solid = cubes.solid[cubes.at(cube)];
                if (solid) continue;
                const auto inside = [&](Coord s) {
                    const Vec3d p = Vec3d(cube) + (Vec3d(s) + Vec3d(0.5)) / double(m);
                    return body.inside(heading.world(cubes.lower + p * cubes.l0));
                };
                int count = 0;
                for (int a = 0; a < m; ++a)
                    for (int b = 0; b < m; ++b)
                        for (int c = 0; c < m; ++c) count += inside({a, b, c});
                if (count == 0) continue;
                solid = 2 * count >= m * m * m || holds_thin_wall(m, inside);
            }
        },
        8);
}

}  // namespace

bool WindTunnel::holds_water(const Bounds& box, double l0) const
{
    if (!water_level) return false;
    const auto steps = [&](int axis) { return int(std::ceil(box.size()[axis] / l0)); };
    for (int i = 0; i <= steps(0); ++i)
        for (int j = 0; j <= steps(1); ++j) {
            const double level = water_level(std::min(box.lower.x + i * l0, box.upper.x),
                                             std::min(box.lower.y + j * l0, box.upper.y));
            // Water beside a box's floor wets its air.
            if (level >= box.lower.z - 0.5 * l0 && level <= box.upper.z) return true;
        }
    return false;
}

Heading Heading::from(int direction, Vec3d axis)
{
    const double h = std::sqrt(0.5);
    // Towards where wind from N, NE, E ... goes: south, south-west, west ...
    const Vec3d towards[] = {{0, -1, 0}, {-h, -h, 0}, {-1, 0, 0}, {-h, h, 0},
                             {0, 1, 0},  {h, h, 0},   {1, 0, 0},  {h, -h, 0}};
    Heading heading;
    heading.origin = axis;
    heading.along = towards[direction];
    heading.across = {-heading.along.y, heading.along.x, 0};
    return heading;
}

WindTunnel fill_tunnel(const WindTunnel& tunnel, double l0, const Heading& heading,
                       const TunnelContents& contents, const Progress& progress)
{
    auto cubes = std::make_shared<Cubes>();
    cubes->lower = tunnel.lower;
    cubes->l0 = l0;
    cubes->n = {int(std::round(tunnel.size.x / l0)), int(std::round(tunnel.size.y / l0)),
                int(std::round(tunnel.size.z / l0))};
    const std::size_t count =
        std::size_t(cubes->n.x) * std::size_t(cubes->n.y) * std::size_t(cubes->n.z);
    cubes->solid.assign(count, 0);
    for (const FloatGrid* solid : contents.solids) mark_solid(*solid, heading, progress, *cubes);

    WindTunnel filled = tunnel;
    filled.solid = [cubes](Vec3d p) {
        const Coord c = cubes->of(p);
        return cubes->holds(c) && cubes->solid[cubes->at(c)] != 0;
    };
    filled.canopy = nullptr;
    filled.water_level = nullptr;
    const auto centre = [&](Coord c) {
        return heading.world(cubes->lower + (Vec3d(c) + Vec3d(0.5)) * l0);
    };

    if (contents.water) {
        const auto levels = std::make_shared<const WaterLevels>(*contents.water);
        if (!levels->box.empty()) {
            const double ground = heading.origin.z;
            filled.water_level = [levels, heading, ground](double x, double y) {
                return levels->at(heading.world({x, y, 0})) - ground;
            };
            for (int i = 0; i < cubes->n.x; ++i)
                for (int j = 0; j < cubes->n.y; ++j)
                    for (int k = 0; k < cubes->n.z; ++k) {
                        const Vec3d p = centre({i, j, k});
                        if (p.z < levels->at(p)) cubes->solid[cubes->at({i, j, k})] = 1;
                    }
        }
    }

    if (contents.canopy) {
        const FloatGrid& canopy = *contents.canopy;
        const int m = samples_per_edge(l0, canopy.transform().voxel);
        cubes->drag.assign(count, 0);
        parallel_for(std::size_t(cubes->n.x), [&](std::size_t i) {
            progress.check();
            GridReader<float> reader(canopy);
            for (int j = 0; j < cubes->n.y; ++j)
                for (int k = 0; k < cubes->n.z; ++k) {
                    double sum = 0;
                    for (int a = 0; a < m; ++a)
                        for (int b = 0; b < m; ++b)
                            for (int c = 0; c < m; ++c) {
                                const Vec3d p = Vec3d(int(i), j, k) +
                                                Vec3d(a + 0.5, b + 0.5, c + 0.5) / double(m);
                                const Vec3d w = heading.world(cubes->lower + p * l0);
                                sum +=
                                    double(reader.value(floor_coord(canopy.transform().voxels(w))));
                            }
                    cubes->drag[cubes->at({int(i), j, k})] = float(sum / (m * m * m));
                }
        });
        if (std::any_of(cubes->drag.begin(), cubes->drag.end(), [](float d) { return d > 0; }))
            filled.canopy = [cubes](Vec3d p) {
                const Coord c = cubes->of(p);
                return cubes->holds(c) ? double(cubes->drag[cubes->at(c)]) : 0.0;
            };
    }
    return filled;
}

Bounds known_bounds(const FloatGrid& level_set)
{
    const VoxelBox box = known_box(level_set);
    Bounds bounds;
    if (box.empty()) return bounds;
    bounds.add(level_set.transform().world(Vec3d(box.lower)));
    bounds.add(level_set.transform().world(Vec3d(box.upper)));
    return bounds;
}

}  // namespace sekitei::wind
