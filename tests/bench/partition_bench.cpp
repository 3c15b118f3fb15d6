// Partition of a box of lava into columns, against a KD-tree over samples of the same lines.
//
//     partition_bench [edge columns]     (default 250 400)
//
// The samples of the KD-tree are as sparse as they may be: the widest spacing at which no voxel
// that it labels wrongly lies half a voxel or more beyond the true wall.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <nanoflann.hpp>
#include <string>
#include <vector>

#include "core/parallel.h"
#include "core/random.h"
#include "grids/nearest_polyline.h"
#include "solvers/joints/joints.h"

namespace sekitei {
namespace {

struct Time {
    double cpu = 0;   ///< of all threads together, divided by their number [s]
    double wall = 0;  ///< says little on a busy machine
};

Time time_of(auto&& work)
{
    const std::clock_t cpu = std::clock();
    const auto wall = std::chrono::steady_clock::now();
    work();
    return {double(std::clock() - cpu) / CLOCKS_PER_SEC / double(thread_count()),
            std::chrono::duration<double>(std::chrono::steady_clock::now() - wall).count()};
}

double median(std::vector<Time> v)
{
    std::sort(v.begin(), v.end(), [](Time a, Time b) { return a.cpu < b.cpu; });
    return v[v.size() / 2].cpu;
}

double least_wall(const std::vector<Time>& v)
{
    return std::min_element(v.begin(), v.end(), [](Time a, Time b) { return a.wall < b.wall; })
        ->wall;
}

/// Columns below a flat top, all bent alike by `bend` voxels so that they keep their distance.
Polylines columns(int edge, int count, double bend)
{
    TriMesh top;
    const auto e = static_cast<float>(edge);
    top.vertices = {{0, 0, e}, {e, 0, e}, {e, e, e}, {0, e, e}};
    top.triangles = {{0, 1, 2}, {0, 2, 3}};
    const double radius = 0.8 * edge / std::sqrt(double(count));
    const auto seeds = joints::relax(
        top, joints::poisson_disk(top, static_cast<std::size_t>(count), radius, 1), 1, {});
    Polylines lines;
    std::vector<Vec3d> points;
    for (const Vec3d& s : seeds) {
        points.clear();
        for (int k = 0; k <= edge; ++k) {
            const double t = double(k) / edge;
            points.push_back(on_line_lattice({s.x + bend * t * t, s.y, edge - double(k)}));
        }
        lines.add(points, StopReason::OutOfDomain);
    }
    return joints::simplify(lines, 0.02);
}

IntGrid lava_box(int edge)
{
    const TopologyPtr topology = box_topology({0, 0, 0}, {edge, edge, edge});
    IntGrid region(topology, {}, 1);
    for (std::size_t i = 0; i < region.leaf_count(); ++i) {
        const Coord o = region.origin(i);
        if (o.x + 8 <= edge && o.y + 8 <= edge && o.z + 8 <= edge) {
            region.set_constant(i, 0);
            region.mask(i) = LeafMask::full();
            continue;
        }
        region.set_constant(i, 0);
        for (int k = 0; k < kLeafSize; ++k) {
            const Coord c = leaf_coord(o, k);
            if (c.x < edge && c.y < edge && c.z < edge) region.mask(i).set(k);
        }
    }
    return region;
}

struct Samples {
    std::vector<Vec3f> points;
    std::vector<std::int32_t> line;

    std::size_t kdtree_get_point_count() const { return points.size(); }
    float kdtree_get_pt(std::size_t i, std::size_t axis) const
    {
        return points[i][static_cast<int>(axis)];
    }
    template <class Box>
    bool kdtree_get_bbox(Box&) const
    {
        return false;
    }
};

using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, Samples>,
                                                 Samples, 3, std::uint32_t>;

Samples samples_of(const Polylines& lines, double spacing)
{
    Samples samples;
    for (std::size_t i = 0; i < lines.count(); ++i) {
        const Vec3d* p = lines.line(i);
        // Each line has its own phase: equal heights on all lines would flatter the tree.
        // Their ends are samples too: beyond them the error would be of first order.
        double left = spacing * uniform01(1, Stream("bench.phase"), i);
        for (const Vec3d& end : {p[0], p[lines.size(i) - 1]}) {
            samples.points.push_back(Vec3f(end));
            samples.line.push_back(static_cast<std::int32_t>(i));
        }
        for (std::size_t k = 1; k < lines.size(i); ++k) {
            const double l = length(p[k] - p[k - 1]);
            for (; left <= l; left += spacing) {
                samples.points.push_back(Vec3f(p[k - 1] + (p[k] - p[k - 1]) * (left / l)));
                samples.line.push_back(static_cast<std::int32_t>(i));
            }
            left -= l;
        }
    }
    return samples;
}

std::int32_t nearest_sample(const Tree& tree, const Samples& samples, Vec3d p)
{
    const float query[3] = {float(p.x), float(p.y), float(p.z)};
    std::uint32_t index = 0;
    float distance2 = 0;
    nanoflann::KNNResultSet<float, std::uint32_t> found(1);
    found.init(&index, &distance2);
    tree.findNeighbors(found, query, nanoflann::SearchParams());
    return samples.line[index];
}

/// How far beyond the true wall the farthest wrong label lies [voxels]: every third voxel of the
/// whole box in each direction.
double worst_wall(const Polylines& lines, double spacing, int edge)
{
    const PolylineIndex index(lines);
    const Samples samples = samples_of(lines, spacing);
    const Tree tree(3, samples, nanoflann::KDTreeSingleIndexAdaptorParams(10));
    std::vector<double> worst(static_cast<std::size_t>(edge), 0.0);
    parallel_for(worst.size(), [&](std::size_t x) {
        if (x % 3 != 1) return;
        PolylineIndex::Candidates near;
        std::vector<NearestPoint> per_line;
        for (int y = 1; y < edge; y += 3)
            for (int z = 1; z < edge; z += 3) {
                const Vec3d p = centre_of({static_cast<int>(x), y, z});
                const std::int32_t label = nearest_sample(tree, samples, p);
                const NearestPoint exact = index.nearest(p);
                if (label == exact.line) continue;
                index.candidates(p, 4, near);
                PolylineIndex::nearest_per_line(p, near, per_line);
                for (const NearestPoint& other : per_line)
                    if (other.line == label)
                        worst[x] = std::max(worst[x], (other.distance2 - exact.distance2) /
                                                          (2 * length(other.point - exact.point)));
            }
    });
    return *std::max_element(worst.begin(), worst.end());
}

void report(const std::string& name, double voxels, int threads, double seconds, double ratio,
            std::uint64_t hash)
{
    std::printf("%s, %.0f, %d, %.3f, %.2f, %016llx  (%.1f ns a voxel)\n", name.c_str(), voxels,
                threads, seconds, ratio, static_cast<unsigned long long>(hash),
                1e9 * seconds / voxels);
    std::fflush(stdout);
}

/// Order-dependent sum of all labels, as a fingerprint.
std::uint64_t fingerprint(const IntGrid& column)
{
    std::uint64_t hash = 0;
    for (std::size_t i = 0; i < column.leaf_count(); ++i)
        for (int k = 0; k < kLeafSize; k += column.is_constant(i) ? kLeafSize : 1)
            hash = hash2(hash, static_cast<std::uint64_t>(column.at(i, k)));
    return hash;
}

void compare(int edge, int count, double bend)
{
    const Polylines lines = columns(edge, count, bend);
    const IntGrid region = lava_box(edge);
    const double voxels = double(edge) * edge * edge;
    double spacing = 16, wall = worst_wall(lines, spacing, edge);
    for (; spacing > 0.5 && wall >= 0.5; wall = worst_wall(lines, spacing, edge)) spacing *= 0.95;
    const std::string name = bend > 0 ? "bent" : "straight";
    std::printf(
        "%s: %zu lines, %zu segments; KD-tree samples %.2f voxels apart, walls off by up to %.2f\n",
        name.c_str(), lines.count(), lines.points.size() - lines.count(), spacing, wall);

    const Samples samples = samples_of(lines, spacing);
    const Tree tree(3, samples, nanoflann::KDTreeSingleIndexAdaptorParams(10));
    const int part = std::min(edge, 128);  // of the box, for the slower peer
    std::vector<std::int32_t> labels(static_cast<std::size_t>(part * part * part));
    auto peer = [&] {
        parallel_for(static_cast<std::size_t>(part), [&](std::size_t x) {
            std::size_t at = x * static_cast<std::size_t>(part * part);
            for (int y = 0; y < part; ++y)
                for (int z = 0; z < part; ++z, ++at)
                    labels[at] = nearest_sample(
                        tree, samples, centre_of({static_cast<int>(x) + (edge - part) / 2, y, z}));
        });
    };
    double one_thread = 0;  // wall
    for (const int threads : {1, 2}) {
        const ThreadLimit limit(static_cast<std::size_t>(threads));
        std::vector<Time> ours, ours_with_arc, theirs;
        IntGrid column;
        FloatGrid arc;
        for (int k = 0; k < 5; ++k) {
            ours.push_back(
                time_of([&] { joints::partition(region, lines, 1, column, nullptr, {}); }));
            ours_with_arc.push_back(
                time_of([&] { joints::partition(region, lines, 1, column, &arc, {}); }));
            theirs.push_back(time_of(peer));
        }
        const double own = median(ours), kd = median(theirs);
        const double kd_voxels = double(part) * part * part;
        if (threads == 1) one_thread = least_wall(ours);
        report(name + " columns", voxels, threads, own, (kd / kd_voxels) / (own / voxels),
               fingerprint(column));
        report(name + " columns and arc", voxels, threads, median(ours_with_arc),
               (kd / kd_voxels) / (median(ours_with_arc) / voxels), fingerprint(column));
        report(name + " KD-tree", kd_voxels, threads, kd, 1, 0);
        if (threads == 2)
            std::printf("%s: 2 threads %.2f x one (wall, best of five)\n", name.c_str(),
                        one_thread / least_wall(ours));
    }
}

}  // namespace
}  // namespace sekitei

int main(int argc, char** argv)
{
    const int edge = argc > 2 ? std::atoi(argv[1]) : 250;
    const int count = argc > 2 ? std::atoi(argv[2]) : 400;
    std::printf("case, voxels, threads, seconds, ratio, hash\n");
    if (edge > 300) {  // too large for the peer: time and memory only
        const sekitei::Polylines lines = sekitei::columns(edge, count, 0.2 * edge);
        const sekitei::IntGrid region = sekitei::lava_box(edge);
        const double voxels = double(edge) * edge * edge;
        sekitei::IntGrid column;
        sekitei::FloatGrid arc;
        const sekitei::Time time = sekitei::time_of([&] {
            sekitei::joints::partition(region, lines, 1, column, argc > 3 ? nullptr : &arc, {});
        });
        sekitei::report("large", voxels, static_cast<int>(sekitei::thread_count()), time.cpu, 0,
                        sekitei::fingerprint(column));
        std::printf("wall %.2f s, column %.2f GB, arc %.2f GB\n", time.wall,
                    double(column.memory_bytes()) * 1e-9, double(arc.memory_bytes()) * 1e-9);
        return 0;
    }
    for (const double bend : {0.0, 0.2 * edge}) sekitei::compare(edge, count, bend);
    return 0;
}
