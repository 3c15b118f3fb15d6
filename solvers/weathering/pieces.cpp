#include "solvers/weathering/pieces.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/clones.h"
#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::weathering {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr Stream kCutStream{"weathering.cut"}, kNoiseStream{"weathering.noise"},
    kTerrainStream{"weathering.terrain"};

double clamp01(double x)
{
    return std::clamp(x, 0.0, 1.0);
}

/// Points where the rock meets the cold, each as a line of its own.
Polylines open_surface(const Inputs& inputs, const Progress& progress)
{
    const FloatGrid& sdf = inputs.body_sdf;
    const double h = sdf.transform().voxel;
    std::vector<std::vector<Vec3d>> found(sdf.leaf_count());
    parallel_for(
        sdf.leaf_count(),
        [&](std::size_t leaf) {
            progress.check();
            const float* values = sdf.values(leaf);
            if (!values) return;
            GridReader<float> reader(sdf);
            for (int o = 0; o < kLeafSize; ++o) {
                const double d = values[o];
                const Coord c = leaf_coord(sdf.origin(leaf), o);
                if (!(d <= 0 && d > -0.9 * h) || !inputs.domain.contains(c)) continue;
                Vec3d g;
                for (int axis = 0; axis < 3; ++axis) {
                    Coord step{};
                    step[axis] = 1;
                    g[axis] = double(reader.value(c + step)) - double(reader.value(c - step));
                }
                found[leaf].push_back(centre_of(c) - normalized(g) * (d / h));
            }
        },
        16);
    Polylines points;
    for (const auto& leaf : found)
        for (const Vec3d& p : leaf) points.add({p}, StopReason::NoStep);
    return points;
}

/// W of a voxel: clamp(a_dir ramp + a_surf exp(-depth / delta) + a_noise n).
class Proneness {
public:
    Proneness(const Inputs& inputs, const Params& params, std::uint64_t seed,
              const Progress& progress)
        : inputs_(inputs),
          params_(params),
          wall_(open_wall(params)),
          noise_{.seed = seed,
                 .stream = kNoiseStream,
                 .frequency = 1 / params.noise_wavelength,
                 .hurst = 0,  // beta = 1
                 .octaves = octaves(params.noise_wavelength)},
          surface_(wall_ < 0 && params.surface_weight > 0 && !inputs.weathering
                       ? open_surface(inputs, progress)
                       : Polylines{})
    {
        const double h = inputs.domain.transform.voxel;
        fade_ = params.depth ? *params.depth / h : 10;
    }

    double operator()(Coord c) const
    {
        if (inputs_.weathering) return clamp01(double(inputs_.weathering->value(c)));
        const Vec3d p = centre_of(c);
        double w = params_.ramp_weight * ramp(p);
        if (params_.surface_weight > 0)
            w += params_.surface_weight * math::exp(-depth(c, p) / fade_);
        if (params_.noise_weight > 0) w += params_.noise_weight * noise_(p);
        return clamp01(w);
    }

private:
    /// Octaves from the wavelength down to two voxels.
    static int octaves(double wavelength)
    {
        int n = 1;
        for (; wavelength >= 4 && n < 16; wavelength /= 2) ++n;
        return n;
    }

    double ramp(Vec3d p) const
    {
        const Coord n = inputs_.domain.dims;
        const Vec3d x{p.x / n.x, p.y / n.y, p.z / n.z};
        switch (params_.ramp) {
            case Ramp::Uniform:
                return 0.5;
            case Ramp::Cliff:
                return (1 - x.x) * (1 - x.z);
            case Ramp::Tower: {
                const double u = x.x - 0.5, v = x.y - 0.5;
                return clamp01((std::sqrt(u * u + v * v) - 0.25) / 0.1);
            }
        }
        return 0;
    }

    /// Below the open surface [voxels].
    double depth(Coord c, Vec3d p) const
    {
        if (wall_ >= 0) {
            const int axis = wall_ / 2;
            return wall_ % 2 ? inputs_.domain.dims[axis] - p[axis] : p[axis];
        }
        const FloatGrid& sdf = inputs_.body_sdf;
        const double d = sdf.value(c);
        if (d >= 0) return 0;
        if (d > -0.9 * std::abs(double(sdf.background()))) return -d / sdf.transform().voxel;
        // Deeper than the narrow band reaches.
        return std::sqrt(surface_.nearest(p).distance2);
    }

    const Inputs& inputs_;
    const Params& params_;
    int wall_;
    FractalNoise noise_;
    PolylineIndex surface_;
    double fade_ = 10;
};

/// Index of the interval of ascending cuts that holds x: how many lie at or below it.
std::size_t cuts_up_to(const double* cuts, std::size_t count, double x)
{
    return static_cast<std::size_t>(std::upper_bound(cuts, cuts + count, x) - cuts);
}

/// Index of the cut nearest in arc.
std::size_t nearest_cut(const double* cuts, std::size_t count, double arc)
{
    const std::size_t above = cuts_up_to(cuts, count, arc);
    if (above == 0) return 0;
    if (above == count) return count - 1;
    return cuts[above] - arc < arc - cuts[above - 1] ? above : above - 1;
}

/// Joins the cuts of each line into flat arrays and numbers the pieces.
struct LineCuts {
    std::vector<double> arc, height, direction;
    std::vector<std::uint8_t> present;  // one longer than arc
};
Pieces join(const std::vector<LineCuts>& cuts, bool horizontal)
{
    Pieces pieces;
    pieces.horizontal = horizontal;
    pieces.first.assign(1, 0);
    for (const LineCuts& line : cuts) {
        pieces.arc.insert(pieces.arc.end(), line.arc.begin(), line.arc.end());
        pieces.height.insert(pieces.height.end(), line.height.begin(), line.height.end());
        pieces.direction.insert(pieces.direction.end(), line.direction.begin(),
                                line.direction.end());
        pieces.present.insert(pieces.present.end(), line.present.begin(), line.present.end());
        if (pieces.present.size() > 0x7FFFFFFF)
            throw LimitExceeded(
                "weathering: more than 2147483647 pieces; use a larger voxel or cut_ref_length");
        pieces.first.push_back(static_cast<std::uint32_t>(pieces.present.size()));
    }
    return pieces;
}

/// The columns that remove_columns and remove_box name.
std::vector<std::uint8_t> removed_columns(const Inputs& inputs, const Params& params)
{
    const Polylines& lines = inputs.lines;
    std::vector<std::uint8_t> removed(lines.count(), 0);
    for (const double id : params.remove_columns) {
        if (id >= static_cast<double>(lines.count()))
            throw InvalidParameter(fmt::format(
                "weathering: remove_columns = {}, must be below the number of columns, {}", id,
                lines.count()));
        removed[static_cast<std::size_t>(id)] = 1;
    }
    const Coord n = inputs.domain.dims;
    for (std::size_t at = 0; at < params.remove_box.size(); at += 6) {
        const double* box = params.remove_box.data() + at;
        for (std::size_t i = 0; i < lines.count(); ++i) {
            if (lines.size(i) == 0) continue;
            const Vec3d p = lines.line(i)[0];
            const Vec3d x{p.x / n.x, p.y / n.y, p.z / n.z};
            if (x.x >= box[0] && x.y >= box[1] && x.z >= box[2] && x.x <= box[3] && x.y <= box[4] &&
                x.z <= box[5])
                removed[i] = 1;
        }
    }
    return removed;
}

/// One flat step per column: pieces between crossings stand where the line runs inside the terrain.
LineCuts level_cuts(const Vec3d* points, std::size_t count, const Terrain& terrain)
{
    LineCuts out;
    if (count == 0) {
        out.present.push_back(0);
        return out;
    }
    const auto crossings =
        terrain_crossings(points, count, [&](Vec3d p) { return terrain.above(p); });
    std::vector<double> arcs(count, 0);
    for (std::size_t k = 1; k < count; ++k)
        arcs[k] = arcs[k - 1] + length(points[k] - points[k - 1]);
    auto point_at = [&](double arc) {
        std::size_t k = 1;
        while (k + 1 < count && arcs[k] < arc) ++k;
        if (count == 1) return points[0];
        const double l = arcs[k] - arcs[k - 1];
        return points[k - 1] + (points[k] - points[k - 1]) * (l > 0 ? (arc - arcs[k - 1]) / l : 0);
    };
    double begin = 0;
    for (std::size_t k = 0; k <= crossings.size(); ++k) {
        const double end = k < crossings.size() ? crossings[k].arc : arcs.back();
        out.present.push_back(terrain.above(point_at((begin + end) / 2)) < 0);
        begin = end;
        if (k == crossings.size()) break;
        out.arc.push_back(crossings[k].arc);
        out.height.push_back(crossings[k].point.z);
        out.direction.push_back(crossings[k].direction);
    }
    return out;
}

struct WornVoxel {
    Coord voxel;
    float w;
};

/// Cuts across the line, drawn voxel by voxel, and which pieces are too weak to hold.
LineCuts perpendicular_cuts(std::size_t line, const Inputs& inputs, const Params& params,
                            std::uint64_t seed, const Proneness& proneness,
                            std::vector<WornVoxel>& worn, std::vector<std::uint8_t>& weak)
{
    LineCuts out;
    std::vector<double> w, u;
    std::vector<WalkStep> steps = walk(inputs.lines.line(line), inputs.lines.size(line));
    std::erase_if(steps, [&](const WalkStep& s) { return !inputs.domain.contains(s.voxel); });
    const double h = inputs.domain.transform.voxel;
    for (std::size_t k = 0; k < steps.size(); ++k) {
        w.push_back(proneness(steps[k].voxel));
        u.push_back(uniform01(seed, kCutStream, line, k));
        worn.push_back({steps[k].voxel, static_cast<float>(w.back())});
    }
    std::vector<double> chance = w;
    if (params.cut_ref_length)
        for (std::size_t k = 0; k < steps.size(); ++k)
            chance[k] = 1 - math::pow(1 - w[k], steps[k].length * h / *params.cut_ref_length);
    const std::vector<int> component = cut_components(chance, u);
    for (std::size_t k = 1; k < steps.size(); ++k)
        if (component[k] != component[k - 1]) out.arc.push_back(steps[k].arc);
    out.present.assign(out.arc.size() + 1, 1);
    weak.assign(out.arc.size() + 1, 0);
    const std::vector<double> means = piece_means(w, component);
    for (std::size_t i = 0; i < means.size(); ++i) weak[i] = means[i] > params.holding_limit;
    return out;
}

FloatGrid worn_grid(const std::vector<std::vector<WornVoxel>>& worn, const Transform& transform)
{
    std::vector<Coord> origins;
    for (const auto& line : worn)
        for (const WornVoxel& v : line) {
            const Coord o = leaf_origin(v.voxel);
            if (origins.empty() || !(origins.back() == o)) origins.push_back(o);
        }
    FloatGrid grid(LeafTopology::build(std::move(origins)), transform, 0.0f);
    grid.expand();
    for (const auto& line : worn)
        for (const WornVoxel& v : line) {
            const std::uint32_t leaf = grid.topology()->find(leaf_origin(v.voxel));
            grid.values(leaf)[leaf_offset(v.voxel)] = v.w;
            grid.mask(leaf).set(leaf_offset(v.voxel));
        }
    grid.compress();
    return grid;
}

/// Arcs of the nearest points of n segments for a leaf's voxels, in the arithmetic of
/// NearLines::nearest().
SEKITEI_CLONES void leaf_arcs(const double* __restrict xs, const double* __restrict ys,
                              const double* __restrict zs, const double* __restrict ax,
                              const double* __restrict ay, const double* __restrict az,
                              const double* __restrict dx, const double* __restrict dy,
                              const double* __restrict dz, const double* __restrict inverse,
                              const double* __restrict arc0, const double* __restrict length,
                              std::size_t n, double* __restrict arc)
{
    for (int row = 0; row < 64; ++row) {
        const double x = xs[row >> 3], y = ys[row & 7];
        double least[8], best[8];
        for (int k = 0; k < 8; ++k) least[k] = kInfinity, best[k] = 0;
        for (std::size_t j = 0; j < n; ++j) {
            const double px = x - ax[j], py = y - ay[j], a = az[j];
            const double ex = dx[j], ey = dy[j], ez = dz[j], inv = inverse[j];
            const double from = arc0[j], l = length[j];
            for (int k = 0; k < 8; ++k) {
                const double pz = zs[k] - a;
                double t = (px * ex + py * ey + pz * ez) * inv;
                t = t > 0.0 ? t : 0.0;
                t = t < 1.0 ? t : 1.0;
                const double rx = px - ex * t, ry = py - ey * t, rz = pz - ez * t;
                const double d2 = rx * rx + ry * ry + rz * rz;
                const bool nearer = d2 < least[k];
                least[k] = nearer ? d2 : least[k];
                best[k] = nearer ? from + t * l : best[k];
            }
        }
        for (int k = 0; k < 8; ++k) arc[row * 8 + k] = best[k];
    }
}

}  // namespace

int open_wall(const Params& params)
{
    if (!params.open_face) return -1;
    const Vec3d d = *params.open_face;
    int axis = 0;
    for (int k = 1; k < 3; ++k)
        if (std::abs(d[k]) > std::abs(d[axis])) axis = k;
    return 2 * axis + (d[axis] > 0 ? 1 : 0);
}

std::uint32_t Pieces::at(std::size_t line, double a, double z) const
{
    const std::size_t begin = first_cut(line), n = first[line + 1] - first[line] - 1;
    if (n == 0) return first[line];
    if (!horizontal)
        return first[line] + static_cast<std::uint32_t>(cuts_up_to(arc.data() + begin, n, a));
    const std::size_t k = nearest_cut(arc.data() + begin, n, a);
    // A level line has no upper side: then its arc decides.
    const double rise = direction[begin + k];
    const double side = rise != 0 ? (z - height[begin + k]) * rise : a - arc[begin + k];
    return first[line] + static_cast<std::uint32_t>(side >= 0 ? k + 1 : k);
}

double Pieces::gap(std::size_t line, std::uint32_t piece, double a, double z, bool wanted,
                   double reach) const
{
    if ((present[piece] != 0) == wanted) return 0;
    const std::size_t begin = first_cut(line), n = first[line + 1] - first[line] - 1;
    if (n == 0) return kInfinity;
    const std::size_t own = piece - first[line];
    if (horizontal) {
        const std::size_t k = nearest_cut(arc.data() + begin, n, a);
        const std::size_t other = own == k ? k + 1 : k;
        if ((present[first[line] + other] != 0) != wanted) return kInfinity;
        const double d = direction[begin + k] != 0 ? z - height[begin + k] : a - arc[begin + k];
        return std::abs(d);
    }
    double least = kInfinity;
    for (std::size_t k = own; k < n && arc[begin + k] - a <= reach; ++k)
        if ((present[first[line] + k + 1] != 0) == wanted) {
            least = arc[begin + k] - a;
            break;
        }
    for (std::size_t k = own; k > 0 && a - arc[begin + k - 1] <= reach; --k)
        if ((present[first[line] + k - 1] != 0) == wanted) {
            least = std::min(least, a - arc[begin + k - 1]);
            break;
        }
    return std::max(least, 0.0);
}

Terrain::Terrain(const Inputs& inputs, const Params& params, std::uint64_t seed)
    : level_set_(inputs.terrain),
      domain_(inputs.domain),
      base_(params.terrain_base),
      slope_x_(params.terrain_slope_x),
      slope_y_(params.terrain_slope_y),
      amplitude_(params.terrain_amplitude),
      noise_{.seed = seed,
             .stream = kTerrainStream,
             .frequency = 2,  // hills half as wide as the box
             .hurst = params.terrain_hurst,
             .octaves = params.terrain_octaves}
{
    // Slow rock asks for the same heights again and again, columns only on their lines.
    if (level_set_ || params.slow_fill != SlowFill::Rock) return;
    const Coord n = domain_.dims;
    levels_.resize(cell(n.x + kBorder, -kBorder));
    parallel_for(static_cast<std::size_t>(n.x + 2 * kBorder), [&](std::size_t row) {
        const int x = static_cast<int>(row) - kBorder;
        for (int y = -kBorder; y < n.y + kBorder; ++y)
            levels_[cell(x, y)] = level(x + 0.5, y + 0.5);
    });
}

double Terrain::level(double x, double y) const
{
    const Coord n = domain_.dims;
    const double wide = std::max(n.x, n.y);
    double z = base_ + slope_x_ * x / n.x + slope_y_ * y / n.y;
    if (amplitude_ > 0) z += amplitude_ * noise_({x / wide, y / wide, 0});
    return z * n.z;
}

double Terrain::above(Vec3d p) const
{
    if (!level_set_) return p.z - level(p.x, p.y);
    // The level set may end at the box: there its outermost voxels go on.
    const Vec3d inside = max(min(p, Vec3d(domain_.dims) - Vec3d(0.5)), Vec3d(0.5));
    return double(GridReader<float>(*level_set_).sample(inside)) / level_set_->transform().voxel;
}

double Terrain::above(Coord c) const
{
    return level_set_ ? above(centre_of(c)) : c.z + 0.5 - levels_[cell(c.x, c.y)];
}

double Terrain::distance_above(Coord c) const
{
    if (level_set_) return above(centre_of(c));
    const double gx = (levels_[cell(c.x + 1, c.y)] - levels_[cell(c.x - 1, c.y)]) / 2;
    const double gy = (levels_[cell(c.x, c.y + 1)] - levels_[cell(c.x, c.y - 1)]) / 2;
    return above(c) / std::sqrt(1 + gx * gx + gy * gy);
}

void NearLines::enter(Vec3d centre, double rho)
{
    index_.candidates(centre, rho, candidates_);
    begin_.clear();
    for (std::size_t j = 0; j < candidates_.line.size(); ++j)
        if (j == 0 || candidates_.line[j] != candidates_.line[j - 1]) begin_.push_back(j);
    begin_.push_back(candidates_.line.size());
}

NearLines::Part NearLines::part(std::int32_t line)
{
    auto of = [](const PolylineIndex::Candidates& c, std::size_t b, std::size_t e) {
        return Part{c.ax.data() + b,
                    c.ay.data() + b,
                    c.az.data() + b,
                    c.dx.data() + b,
                    c.dy.data() + b,
                    c.dz.data() + b,
                    c.inverse_length2.data() + b,
                    c.arc0.data() + b,
                    c.length.data() + b,
                    e - b};
    };
    const auto found = std::lower_bound(candidates_.lines.begin(), candidates_.lines.end(), line);
    if (found != candidates_.lines.end() && *found == line) {
        const auto k = static_cast<std::size_t>(found - candidates_.lines.begin());
        return of(candidates_, begin_[k], begin_[k + 1]);
    }
    // A column that does not own voxels by distance, such as one painted by another tool.
    const auto id = static_cast<std::size_t>(line);
    whole_ = {};
    const std::size_t first = lines_.begin[id], last = lines_.begin[id + 1];
    for (std::size_t k = first; k < last && (k + 1 < last || k == first); ++k) {
        const Vec3d a = lines_.points[k];
        const Vec3d d = k + 1 < last ? lines_.points[k + 1] - a : Vec3d();
        const double l2 = dot(d, d);
        whole_.ax.push_back(a.x);
        whole_.ay.push_back(a.y);
        whole_.az.push_back(a.z);
        whole_.dx.push_back(d.x);
        whole_.dy.push_back(d.y);
        whole_.dz.push_back(d.z);
        const double inverse = 1 / l2;
        whole_.inverse_length2.push_back(l2 > 0 && std::isfinite(inverse) ? inverse : 0);
        whole_.arc0.push_back(arcs_[k]);
        whole_.length.push_back(std::sqrt(l2));
    }
    return of(whole_, 0, whole_.ax.size());
}

NearestPoint NearLines::nearest(std::int32_t line, Vec3d p)
{
    const Part s = part(line);
    NearestPoint best;
    best.line = line;
    best.distance2 = kInfinity;
    for (std::size_t j = 0; j < s.count; ++j) {
        const double px = p.x - s.ax[j], py = p.y - s.ay[j], pz = p.z - s.az[j];
        double t = (px * s.dx[j] + py * s.dy[j] + pz * s.dz[j]) * s.inverse[j];
        t = t > 0.0 ? t : 0.0;
        t = t < 1.0 ? t : 1.0;
        const double rx = px - s.dx[j] * t, ry = py - s.dy[j] * t, rz = pz - s.dz[j] * t;
        const double d2 = rx * rx + ry * ry + rz * rz;
        if (d2 < best.distance2) {
            best.distance2 = d2;
            best.arc = s.arc0[j] + t * s.length[j];
            best.point = Vec3d(s.ax[j], s.ay[j], s.az[j]) + Vec3d(s.dx[j], s.dy[j], s.dz[j]) * t;
        }
    }
    return best;
}

void NearLines::arcs(std::int32_t line, Coord origin, double* arc)
{
    const Part s = part(line);
    double x[8], y[8], z[8];
    for (int k = 0; k < 8; ++k) {
        x[k] = origin.x + k + 0.5;
        y[k] = origin.y + k + 0.5;
        z[k] = origin.z + k + 0.5;
    }
    leaf_arcs(x, y, z, s.ax, s.ay, s.az, s.dx, s.dy, s.dz, s.inverse, s.arc0, s.length, s.count,
              arc);
}

CutResult cut_columns(const Inputs& inputs, const Params& params, std::uint64_t seed,
                      const Terrain* terrain, const Progress& progress)
{
    const std::size_t count = inputs.lines.count();
    const std::vector<std::uint8_t> removed = removed_columns(inputs, params);
    std::vector<LineCuts> cuts(count);
    std::vector<std::vector<std::uint8_t>> weak(count);
    std::vector<std::vector<WornVoxel>> worn(count);
    if (params.cut == Cut::Perpendicular) {
        const Proneness proneness(inputs, params, seed, progress);
        parallel_for(count, [&](std::size_t i) {
            progress.check();
            cuts[i] = perpendicular_cuts(i, inputs, params, seed, proneness, worn[i], weak[i]);
        });
    } else if (params.cut == Cut::Horizontal) {
        parallel_for(count, [&](std::size_t i) {
            progress.check();
            cuts[i] = level_cuts(inputs.lines.line(i), inputs.lines.size(i), *terrain);
        });
    } else {
        for (LineCuts& line : cuts) line.present.assign(1, 1);
    }
    for (std::size_t i = 0; i < count; ++i)
        if (removed[i]) std::fill(cuts[i].present.begin(), cuts[i].present.end(), 0);

    CutResult result;
    result.pieces = join(cuts, params.cut == Cut::Horizontal);
    result.weak.reserve(result.pieces.count());
    for (std::size_t i = 0; i < count; ++i) {
        weak[i].resize(cuts[i].present.size(), 0);
        if (removed[i]) std::fill(weak[i].begin(), weak[i].end(), 0);
        result.weak.insert(result.weak.end(), weak[i].begin(), weak[i].end());
    }
    result.weathering = worn_grid(worn, inputs.domain.transform);
    return result;
}

IntGrid component_grid(const Inputs& inputs, const Pieces& pieces, const PolylineIndex& index,
                       const std::vector<double>& arcs, const Progress& progress)
{
    const IntGrid& column = inputs.column;
    const LeafTopology& columns = *column.topology();
    const std::size_t leaves = inputs.region.leaf_count();
    const auto lines = static_cast<std::int32_t>(inputs.lines.count());
    IntGrid component = IntGrid::uninitialised(column.topology(), inputs.domain.transform, -1);
    std::vector<std::uint8_t> filled(column.leaf_count(), 0);
    std::atomic<std::size_t> bad{std::numeric_limits<std::size_t>::max()};
    const double rho = 3.5 * std::sqrt(3.0);
    parallel_for_range(
        leaves,
        [&](std::size_t begin, std::size_t end) {
            NearLines near(index, inputs.lines, arcs);
            std::vector<std::int32_t> ids;
            std::vector<double> arc(kLeafSize);
            for (std::size_t r = begin; r != end; ++r) {
                progress.check();
                const Coord origin = inputs.region.origin(r);
                LeafMask lava;
                if (inputs.region.is_constant(r)) {
                    if (inputs.region.constant(r) == kLavaRegion) lava = LeafMask::full();
                } else {
                    const std::int32_t* v = inputs.region.values(r);
                    for (int o = 0; o < kLeafSize; ++o)
                        if (v[o] == kLavaRegion) lava.set(o);
                }
                if (lava.none()) continue;

                // Which columns are here; one without a line is the caller's mistake.
                const std::uint32_t leaf = columns.find(origin);
                ids.clear();
                bool fits = leaf != kNoLeaf;
                if (fits)
                    lava.for_each([&](int o) {
                        const std::int32_t id = column.at(leaf, o);
                        fits = fits && id >= 0 && id < lines;
                        if (ids.empty() || ids.back() != id) ids.push_back(id);
                    });
                if (!fits) {
                    std::size_t known = bad.load();
                    while (r < known && !bad.compare_exchange_weak(known, r)) {
                    }
                    continue;
                }
                std::sort(ids.begin(), ids.end());
                ids.erase(std::unique(ids.begin(), ids.end()), ids.end());

                const std::int32_t* here = column.values(leaf);
                std::int32_t* out = component.values(leaf);
                std::fill_n(out, kLeafSize, -1);
                component.mask(leaf) = lava;
                filled[leaf] = 1;
                bool entered = false;
                for (const std::int32_t id : ids) {
                    const auto line = static_cast<std::size_t>(id);
                    const std::size_t first = pieces.first[line],
                                      n = pieces.first[line + 1] - first - 1;
                    // One level cut needs no arc, unless the line itself is level.
                    const bool needs_arc =
                        n > 1 || (n == 1 && !(pieces.horizontal &&
                                              pieces.direction[pieces.first_cut(line)] != 0));
                    if (needs_arc) {
                        if (!entered) near.enter(centre_of(origin) + Vec3d(3.5), rho);
                        entered = true;
                        near.arcs(id, origin, arc.data());
                    }
                    const double* cuts = pieces.arc.data() + pieces.first_cut(line);
                    // Search only among the cuts that fall into this leaf.
                    std::size_t low = 0, high = n;
                    if (n > 0 && !pieces.horizontal) {
                        const auto [least, most] = std::minmax_element(arc.begin(), arc.end());
                        low = cuts_up_to(cuts, n, *least);
                        high = cuts_up_to(cuts, n, *most);
                    }
                    lava.for_each([&](int o) {
                        if (ids.size() > 1 && here[o] != id) return;
                        std::size_t piece = first;
                        if (n > 0)
                            piece = pieces.horizontal
                                        ? pieces.at(line, arc[static_cast<std::size_t>(o)],
                                                    origin.z + (o & 7) + 0.5)
                                        : first + low +
                                              cuts_up_to(cuts + low, high - low,
                                                         arc[static_cast<std::size_t>(o)]);
                        out[o] = static_cast<std::int32_t>(piece);
                    });
                }
            }
        },
        16);
    if (bad != std::numeric_limits<std::size_t>::max()) {
        const std::size_t r = bad;
        const Coord origin = inputs.region.origin(r);
        for (int o = 0; o < kLeafSize; ++o) {
            const Coord c = leaf_coord(origin, o);
            const std::int32_t id = column.value(c);
            if (inputs.region.at(r, o) == kLavaRegion && (id < 0 || id >= lines))
                throw InvalidInput(fmt::format(
                    "weathering: column = {} at lava voxel ({}, {}, {}), must be the id of one of "
                    "the {} centre lines; make `column` and `centre_lines` with one `sekitei "
                    "joint`",
                    id, c.x, c.y, c.z, lines));
        }
    }
    for (std::size_t i = 0; i < component.leaf_count(); ++i)
        if (!filled[i]) component.set_constant(i, -1);
    component.compress();
    return component;
}

Falling::Falling(std::size_t pieces) : parent_(pieces), exposed_(pieces, 0)
{
    std::iota(parent_.begin(), parent_.end(), 0u);
}

std::uint32_t Falling::group(std::uint32_t a)
{
    while (parent_[a] != a) a = parent_[a] = parent_[parent_[a]];
    return a;
}

void Falling::touch(std::uint32_t a, std::uint32_t b)
{
    a = group(a);
    b = group(b);
    if (a == b) return;
    if (b < a) std::swap(a, b);
    parent_[b] = a;
    exposed_[a] = exposed_[a] | exposed_[b];
}

void Falling::expose(std::uint32_t a)
{
    exposed_[group(a)] = 1;
}

bool Falling::falls(std::uint32_t a)
{
    return exposed_[group(a)] != 0;
}

void collapse(const Inputs& inputs, const Params& params, const IntGrid& component,
              const std::vector<std::uint8_t>& weak, Pieces& pieces, const Progress& progress)
{
    if (std::none_of(weak.begin(), weak.end(), [](std::uint8_t w) { return w != 0; })) return;
    if (params.collapse == Collapse::All) {
        for (std::size_t i = 0; i < weak.size(); ++i)
            if (weak[i]) pieces.present[i] = 0;
        return;
    }

    constexpr std::int32_t kAir = -1, kHolds = -2;
    const IntGrid& region = inputs.region;
    const LeafTopology& topology = *region.topology();
    const Domain& domain = inputs.domain;
    const int wall = open_wall(params);
    // What a voxel is to a weak piece beside it.
    auto what = [&](std::int32_t region_id, std::int32_t piece) {
        if (region_id == kLavaRegion) {
            const auto id = static_cast<std::size_t>(piece);
            return weak[id] ? piece : pieces.present[id] ? kHolds : kAir;
        }
        return region_id == kColdRegion ? kAir : kHolds;
    };
    auto outside = [&](Coord c) {
        if (wall < 0) return kHolds;
        const int axis = wall / 2;
        return (wall % 2 ? c[axis] >= domain.dims[axis] : c[axis] < 0) ? kAir : kHolds;
    };

    struct Contacts {
        std::vector<std::uint32_t> exposed;
        std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;
    };
    auto look_at = [&](std::size_t leaf, Contacts& contacts) {
        const Coord origin = region.origin(leaf);
        const std::uint32_t own = component.topology()->find(origin);
        if (own == kNoLeaf) return;
        // The leaf with a border of one voxel; its edges and corners are not needed.
        std::array<std::int32_t, 1000> block;
        auto cell = [&](int x, int y, int z) -> std::int32_t& {
            return block[static_cast<std::size_t>(((x + 1) * 10 + y + 1) * 10 + z + 1)];
        };
        bool any = false;
        for (int o = 0; o < kLeafSize; ++o) {
            const Coord c = leaf_coord({}, o);
            std::int32_t& out = cell(c.x, c.y, c.z);
            out = domain.contains(origin + c) ? what(region.at(leaf, o), component.at(own, o))
                                              : outside(origin + c);
            any = any || out >= 0;
        }
        if (!any) return;
        for (int axis = 0; axis < 3; ++axis)
            for (int side = -1; side <= 1; side += 2) {
                Coord step{};
                step[axis] = side;
                const Coord there = origin + step * kLeafEdge;
                const std::uint32_t next = topology.find(there);
                const std::uint32_t next_component = component.topology()->find(there);
                for (int k = 0; k < 64; ++k) {
                    Coord c{};
                    c[axis] = side < 0 ? -1 : 8;
                    c[(axis + 1) % 3] = k >> 3;
                    c[(axis + 2) % 3] = k & 7;
                    const int o = leaf_offset(c);
                    const std::int32_t id =
                        next == kNoLeaf ? region.background() : region.at(next, o);
                    const std::int32_t piece =
                        next_component == kNoLeaf ? -1 : component.at(next_component, o);
                    cell(c.x, c.y, c.z) =
                        domain.contains(origin + c) ? what(id, piece) : outside(origin + c);
                }
            }
        auto meet = [&](std::int32_t a, std::int32_t b) {
            if (a == b || a == kHolds || b == kHolds) return;
            if (a >= 0 && b >= 0)
                contacts.pairs.emplace_back(std::min(a, b), std::max(a, b));
            else
                contacts.exposed.push_back(static_cast<std::uint32_t>(std::max(a, b)));
        };
        for (int x = 0; x < 8; ++x)
            for (int y = 0; y < 8; ++y)
                for (int z = 0; z < 8; ++z) {
                    const std::int32_t a = cell(x, y, z);
                    if (a == kHolds) continue;
                    meet(a, cell(x + 1, y, z));
                    meet(a, cell(x, y + 1, z));
                    meet(a, cell(x, y, z + 1));
                    if (x == 0) meet(a, cell(-1, y, z));
                    if (y == 0) meet(a, cell(x, -1, z));
                    if (z == 0) meet(a, cell(x, y, -1));
                }
    };

    // Chunks of leaves in batches, so that the lists of contacts stay short.
    constexpr std::size_t kChunk = 32, kBatch = 512;
    const std::size_t leaves = region.leaf_count(), chunks = (leaves + kChunk - 1) / kChunk;
    Falling falling(pieces.count());
    for (std::size_t batch = 0; batch < chunks; batch += kBatch) {
        const std::size_t n = std::min(kBatch, chunks - batch);
        std::vector<Contacts> found(n);
        parallel_for(n, [&](std::size_t k) {
            progress.check();
            const std::size_t begin = (batch + k) * kChunk;
            for (std::size_t i = begin; i < std::min(leaves, begin + kChunk); ++i)
                look_at(i, found[k]);
            auto tidy = [](auto& list) {
                std::sort(list.begin(), list.end());
                list.erase(std::unique(list.begin(), list.end()), list.end());
            };
            tidy(found[k].pairs);
            tidy(found[k].exposed);
        });
        for (const Contacts& contacts : found) {
            for (const auto& [a, b] : contacts.pairs) falling.touch(a, b);
            for (const std::uint32_t a : contacts.exposed) falling.expose(a);
        }
        progress.update(static_cast<double>(batch + n) / static_cast<double>(chunks));
    }
    for (std::size_t i = 0; i < weak.size(); ++i)
        if (weak[i] && falling.falls(static_cast<std::uint32_t>(i))) pieces.present[i] = 0;
}

std::vector<WalkStep> walk(const Vec3d* points, std::size_t count)
{
    std::vector<WalkStep> steps;
    auto voxel_of = [](Vec3d p) {
        return Coord(static_cast<std::int32_t>(std::floor(p.x)),
                     static_cast<std::int32_t>(std::floor(p.y)),
                     static_cast<std::int32_t>(std::floor(p.z)));
    };
    if (count == 1) steps.push_back({voxel_of(points[0]), 0, 0});
    double arc = 0;
    for (std::size_t k = 0; k + 1 < count; ++k) {
        const Vec3d a = points[k], d = points[k + 1] - a;
        const double l = length(d);
        if (!(l > 0)) continue;
        // The next plane of voxel faces along each axis, as a parameter of the segment.
        double plane[3], next[3];
        auto parameter = [&](int axis) {
            const double t = d[axis] != 0 ? (plane[axis] - a[axis]) / d[axis] : kInfinity;
            return t;
        };
        for (int axis = 0; axis < 3; ++axis) {
            plane[axis] = d[axis] > 0 ? std::floor(a[axis]) + 1 : std::ceil(a[axis]) - 1;
            next[axis] = parameter(axis);
        }
        double t = 0;
        while (t < 1) {
            const double until = std::min({1.0, next[0], next[1], next[2]});
            // Rounding at a corner leaves slivers, which belong to no voxel.
            if ((until - t) * l > 1e-12) {
                const Coord voxel = voxel_of(a + d * ((t + until) / 2));
                if (steps.empty() || !(steps.back().voxel == voxel))
                    steps.push_back({voxel, 0, arc + t * l});
                steps.back().length += (until - t) * l;
            }
            t = until;
            for (int axis = 0; axis < 3; ++axis)
                while (next[axis] <= t) {
                    plane[axis] += d[axis] > 0 ? 1 : -1;
                    next[axis] = parameter(axis);
                }
        }
        arc += l;
    }
    if (steps.empty() && count > 1) steps.push_back({voxel_of(points[0]), 0, 0});
    return steps;
}

std::vector<int> cut_components(const std::vector<double>& w, const std::vector<double>& u)
{
    std::vector<int> component(w.size(), 0);
    for (std::size_t k = 1; k < w.size(); ++k)
        component[k] = component[k - 1] + (u[k] < w[k] ? 1 : 0);
    return component;
}

std::vector<double> piece_means(const std::vector<double>& w, const std::vector<int>& component)
{
    std::vector<double> sum, voxels;
    for (std::size_t k = 0; k < w.size(); ++k) {
        const auto piece = static_cast<std::size_t>(component[k]);
        if (piece == sum.size()) {
            sum.push_back(0);
            voxels.push_back(0);
        }
        sum[piece] += w[k];
        voxels[piece] += 1;
    }
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] /= voxels[i];
    return sum;
}

std::vector<Crossing> terrain_crossings(const Vec3d* points, std::size_t count,
                                        const std::function<double(Vec3d)>& height)
{
    std::vector<Crossing> found;
    double arc = 0;
    if (count == 0) return found;
    bool above = height(points[0]) >= 0;
    for (std::size_t k = 0; k + 1 < count; ++k) {
        const Vec3d a = points[k], d = points[k + 1] - a;
        const double l = length(d);
        const int samples = std::max(1, static_cast<int>(std::ceil(l)));  // every voxel
        for (int i = 1; i <= samples; ++i) {
            double high = double(i) / samples;
            if ((height(a + d * high) >= 0) == above) continue;
            double low = double(i - 1) / samples;
            while ((high - low) * l > 1e-10) {
                const double middle = (low + high) / 2;
                if (middle <= low || middle >= high) break;
                ((height(a + d * middle) >= 0) == above ? low : high) = middle;
            }
            found.push_back({a + d * high, arc + high * l, d.z > 0 ? 1.0 : d.z < 0 ? -1.0 : 0.0});
            above = !above;
        }
        arc += l;
    }
    return found;
}

}  // namespace sekitei::weathering
