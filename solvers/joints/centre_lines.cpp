#include <algorithm>
#include <array>
#include <cmath>

#include "core/parallel.h"
#include "solvers/joints/joints.h"

/// Centre lines: from the seeds along the gradient into the hot lava.
namespace sekitei::joints {
namespace {

/// The gradient's unit vectors, trilinear between the centres of coarse cells; cells that are not
/// active count as zero.
class Direction {
public:
    Direction(const VectorGrid& gradient, const Domain& fine, const Domain& coarse)
        : reader_(gradient), fine_(fine), coarse_(coarse)
    {
    }

    /// @param p  fine voxel units
    Vec3d operator()(Vec3d p)
    {
        const Vec3d u = coarse_index(p, fine_, coarse_);
        const Coord low(static_cast<int>(u.x), static_cast<int>(u.y), static_cast<int>(u.z));
        const Vec3d f = u - Vec3d(low);
        if (!(low == low_) || !known_) load(low);
        Vec3d sum;
        for (std::size_t k = 0; k < 8; ++k) {
            const double weight =
                (k & 4 ? f.x : 1 - f.x) * (k & 2 ? f.y : 1 - f.y) * (k & 1 ? f.z : 1 - f.z);
            sum += corner_[k] * weight;
        }
        return sum;
    }

private:
    /// The eight cells around; a line stays among them for several steps.
    void load(Coord low)
    {
        const Coord last = coarse_.dims - Coord(1, 1, 1);
        for (std::size_t k = 0; k < 8; ++k) {
            const Coord c = min(low + Coord(k & 4 ? 1 : 0, k & 2 ? 1 : 0, k & 1 ? 1 : 0), last);
            corner_[k] = reader_.active(c) ? Vec3d(reader_.value(c)) : Vec3d();
        }
        low_ = low;
        known_ = true;
    }

    GridReader<Vec3f> reader_;
    Domain fine_, coarse_;
    Coord low_;
    bool known_ = false;
    std::array<Vec3d, 8> corner_;
};

/// Inside the body and outside its slow part, at fine resolution.
class Lava {
public:
    explicit Lava(const Inputs& inputs)
        : body_(inputs.body_sdf),
          slow_(inputs.slow_sdf),
          has_slow_(inputs.slow_sdf.leaf_count() > 0)
    {
    }
    bool operator()(Vec3d p) { return body_.sample(p) < 0 && (!has_slow_ || slow_.sample(p) > 0); }

private:
    GridReader<float> body_, slow_;
    bool has_slow_;
};

bool inside(Vec3d p, Vec3d size)
{
    return p.x >= 0 && p.y >= 0 && p.z >= 0 && p.x <= size.x && p.y <= size.y && p.z <= size.z;
}

/// Where the way from p (inside) to q leaves the box.
Vec3d clip_to_box(Vec3d p, Vec3d q, Vec3d size)
{
    double t = 1;
    for (int axis = 0; axis < 3; ++axis) {
        const double d = q[axis] - p[axis];
        if (q[axis] < 0) t = std::min(t, -p[axis] / d);
        if (q[axis] > size[axis]) t = std::min(t, (size[axis] - p[axis]) / d);
    }
    const Vec3d hit = p + (q - p) * t;
    return min(max(hit, Vec3d(0.0)), size);
}

/// The last point in lava on the way from p (in lava) to q (not), to 1e-3 voxel.
template <class InLava>
Vec3d boundary_between(Vec3d p, Vec3d q, InLava&& in_lava)
{
    double low = 0, high = 1;
    const double span = length(q - p);
    while ((high - low) * span > 1e-3) {
        const double middle = (low + high) / 2;
        (in_lava(p + (q - p) * middle) ? low : high) = middle;
    }
    return p + (q - p) * ((low + high) / 2);
}

/// One step of the integrator from p, where the unit direction is `first`.
template <class Field>
Vec3d step_from(Vec3d p, Vec3d first, Field&& direction, const Params& params)
{
    const double h = params.step;
    if (params.integrator == Integrator::Euler) return first * h;
    // Stages that meet a ridge or a plateau say nothing about the way there: then a plain step,
    // after which the stop rules decide.
    auto stage = [&](Vec3d q, Vec3d& g) {
        g = direction(q);
        const double l = length(g);
        if (l < params.least_direction || dot(g, first) < 0) return false;
        g = g / l;
        return true;
    };
    Vec3d k2, k3, k4;
    if (!stage(p + first * (h / 2), k2) || !stage(p + k2 * (h / 2), k3) || !stage(p + k3 * h, k4))
        return first * h;
    return (first + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6);
}

template <class Field, class InLava>
Path follow_in(Vec3d start, Coord dims, Field&& direction, InLava&& in_lava, const Params& params)
{
    const Vec3d size(dims);
    const auto most_steps = static_cast<std::size_t>(
        std::ceil(10.0 * (double(dims.x) + double(dims.y) + double(dims.z)) / params.step));
    Path path{{start}, StopReason::NoStep};
    if (!inside(start, size) || !in_lava(start)) return path;

    auto stop = [&](StopReason reason) {
        path.stop = path.points.size() > 1 ? reason : StopReason::NoStep;
        return path;
    };
    Vec3d previous;
    for (std::size_t k = 0; k < most_steps; ++k) {
        const Vec3d p = path.points.back();
        const Vec3d g = direction(p);
        const double l = length(g);
        // A field of nothing but zeros is flat even when every direction is allowed.
        if (l < params.least_direction || !(l > 0)) return stop(StopReason::Flat);
        const Vec3d unit = g / l;
        if (k > 0 && dot(unit, previous) < 0) {
            path.points.pop_back();
            return stop(StopReason::Reversal);
        }
        const Vec3d q = p + step_from(p, unit, direction, params);
        if (!inside(q, size)) {
            const Vec3d hit = clip_to_box(p, q, size);
            if (!in_lava(hit)) {
                path.points.push_back(boundary_between(p, hit, in_lava));
                return stop(StopReason::LeftLava);
            }
            if (length(hit - p) > 0) path.points.push_back(hit);
            return stop(StopReason::OutOfDomain);
        }
        if (!in_lava(q)) {
            path.points.push_back(boundary_between(p, q, in_lava));
            return stop(StopReason::LeftLava);
        }
        path.points.push_back(q);
        previous = q - p;
    }
    return stop(StopReason::TooLong);
}

double distance2_to_segment(Vec3d p, Vec3d a, Vec3d b)
{
    const Vec3d d = b - a;
    const double l2 = dot(d, d);
    const double t = l2 > 0 ? std::clamp(dot(p - a, d) / l2, 0.0, 1.0) : 0.0;
    const Vec3d r = p - a - d * t;
    return dot(r, r);
}

}  // namespace

Vec3d coarse_index(Vec3d p, const Domain& fine, const Domain& coarse)
{
    const double edge = coarse.transform.voxel;
    const Vec3d corner = (fine.transform.origin - coarse.transform.origin) / edge;
    const Vec3d u = p * (fine.transform.voxel / edge) + corner - Vec3d(0.5);
    return min(max(u, Vec3d(0.0)), Vec3d(coarse.dims - Coord(1, 1, 1)));
}

Path follow(Vec3d start, Coord dims, const std::function<Vec3d(Vec3d)>& direction,
            const std::function<bool(Vec3d)>& in_lava, const Params& params)
{
    return follow_in(start, dims, direction, in_lava, params);
}

Polylines trace(const Inputs& inputs, const Params& params, const std::vector<Vec3d>& seeds_voxels,
                const Progress& progress)
{
    const Vec3d size(inputs.domain.dims);
    std::vector<Path> paths(seeds_voxels.size());
    parallel_for_range(
        paths.size(),
        [&](std::size_t begin, std::size_t end) {
            Direction direction(inputs.gradient, inputs.domain, inputs.heat_domain);
            Lava in_lava(inputs);
            for (std::size_t i = begin; i < end; ++i) {
                progress.check();
                const Vec3d seed = seeds_voxels[i], g = normalized(direction(seed));
                Vec3d start = seed + g * 0.5;
                for (int k = 2; k <= 4 && !(inside(start, size) && in_lava(start)); ++k)
                    start = seed + g * (0.5 * k);
                if (!inside(start, size) || !in_lava(start))
                    start = min(max(seed + g * 0.5, Vec3d(0.0)), size);
                paths[i] = follow_in(start, inputs.domain.dims, direction, in_lava, params);
            }
        },
        8);
    Polylines lines;
    for (const Path& path : paths) lines.add(path.points, path.stop);
    return lines;
}

Polylines simplify(const Polylines& lines, double tolerance)
{
    Polylines out;
    std::vector<Vec3d> kept;
    std::vector<char> keep;
    std::vector<std::pair<std::size_t, std::size_t>> spans;
    for (std::size_t i = 0; i < lines.count(); ++i) {
        const Vec3d* p = lines.line(i);
        const std::size_t n = lines.size(i);
        keep.assign(n, 0);
        if (n > 0) keep.front() = keep.back() = 1;
        if (n > 2) spans.push_back({0, n - 1});
        while (!spans.empty()) {
            const auto [first, last] = spans.back();
            spans.pop_back();
            double worst2 = tolerance * tolerance;
            std::size_t worst = first;
            for (std::size_t k = first + 1; k < last; ++k) {
                const double d2 = distance2_to_segment(p[k], p[first], p[last]);
                if (d2 > worst2) {
                    worst2 = d2;
                    worst = k;
                }
            }
            if (worst == first) continue;
            keep[worst] = 1;
            spans.push_back({first, worst});
            spans.push_back({worst, last});
        }
        kept.clear();
        for (std::size_t k = 0; k < n; ++k)
            if (keep[k]) kept.push_back(p[k]);
        out.add(kept, lines.stop[i]);
    }
    return out;
}

}  // namespace sekitei::joints
