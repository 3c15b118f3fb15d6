#include "grids/surface_transfer.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/parallel.h"

namespace sekitei {
namespace {

constexpr double kReach = 1.5;     // of the weighted mean, and of a piece [voxels]
constexpr double kFarthest = 4.0;  // of the nearest that stands in [voxels]
constexpr std::size_t kChunk = 1024;
constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

struct Link {
    std::uint32_t target, source;
    double weight;
};

/// Where the cells' pieces of surface lie, in voxel units.
class Feet {
public:
    explicit Feet(const SurfaceCells& cells)
        : cells_(cells), index_(cells.index), inverse_(1 / cells.transform.voxel)
    {
        for (const Coord c : cells.voxel) {
            box_.add(Vec3d(c));
            box_.add(Vec3d(c) + Vec3d(1.0));
        }
    }

    /// Whether anything in a box of voxel units can have a foot within reach.
    bool near(const Bounds& box) const
    {
        for (int k = 0; k < 3; ++k)
            if (!(box.upper[k] > box_.lower[k] - kFarthest - 1 &&
                  box.lower[k] < box_.upper[k] + kFarthest + 1))
                return false;
        return true;
    }
    bool near(Vec3d p) const { return near(Bounds{p, p}); }

    Vec3d foot(std::uint32_t cell) const
    {
        return centre_of(cells_.voxel[cell]) -
               Vec3d(cells_.normal[cell]) * (double(cells_.sdf[cell]) * inverse_);
    }

    /// Calls f(cell, foot, distance, n.n) for the agreeing cells in the block of voxels that
    /// reaches `radius` voxels from p's own, the inner block of `inner` left out. All feet within
    /// radius - 1/2 are in it, for a foot lies within a voxel of its centre; cells that cannot have
    /// theirs within `reach`, which f may shorten, are passed over.
    template <class F>
    void around(Vec3d p, Vec3d normal, int radius, int inner, const double& reach, F&& f)
    {
        const Coord middle(static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
                           static_cast<int>(std::floor(p.z)));
        const Vec3d to_middle = centre_of(middle) - p;
        for (int x = -radius; x <= radius; ++x)
            for (int y = -radius; y <= radius; ++y) {
                const bool sides = std::max(std::abs(x), std::abs(y)) > inner;
                const double dx = to_middle.x + x, dy = to_middle.y + y;
                for (int z = -radius; z <= radius;
                     z += sides || z != -inner - 1 ? 1 : 2 * inner + 2) {
                    const double dz = to_middle.z + z;
                    if (dx * dx + dy * dy + dz * dz > (reach + 1) * (reach + 1)) continue;
                    const std::int32_t found = index_.value(middle + Coord(x, y, z));
                    if (found < 0) continue;
                    const auto cell = static_cast<std::uint32_t>(found);
                    const double agree = dot(normal, Vec3d(cells_.normal[cell]));
                    if (!(agree > 0)) continue;
                    const Vec3d q = foot(cell);
                    f(cell, q, length(q - p), agree);
                }
            }
    }

    /// The agreeing cell with the nearest foot within `reach`, the lowest of equals, that `chosen`
    /// takes; kNone.
    template <class Chosen>
    std::uint32_t nearest(Vec3d p, Vec3d normal, double reach, Chosen&& chosen)
    {
        std::uint32_t best = kNone;
        double least = reach;
        for (int radius = 1;; ++radius) {
            around(p, normal, radius, radius == 1 ? -1 : radius - 1, least,
                   [&](std::uint32_t cell, Vec3d, double d, double) {
                       if (d > least || !chosen(cell)) return;
                       if (d == least && best != kNone && best <= cell) return;
                       least = d;
                       best = cell;
                   });
            if (least <= radius - 0.5) return best;
        }
    }

private:
    const SurfaceCells& cells_;
    GridReader<std::int32_t> index_;
    Bounds box_;
    double inverse_;  ///< voxels a metre
};

/// The links of n sites, in their order: f(i, feet, scratch, links) adds those of site i. `scratch`
/// comes empty, with the memory that the sites before took.
template <class Scratch, class F>
std::vector<std::vector<Link>> links_of_sites(std::size_t n, const Feet& feet,
                                              const Progress& progress, F&& f)
{
    std::vector<std::vector<Link>> parts((n + kChunk - 1) / kChunk);
    parallel_for(parts.size(), [&](std::size_t part) {
        progress.check();
        Feet own = feet;
        std::vector<Scratch> scratch;
        for (std::size_t i = part * kChunk; i < std::min(n, (part + 1) * kChunk); ++i) {
            scratch.clear();
            f(i, own, scratch, parts[part]);
        }
    });
    return parts;
}

/// Turns links, ordered by target, into rows whose weights sum to 1.
SurfaceTransfer rows_of(const std::vector<std::vector<Link>>& parts, std::size_t targets,
                        std::size_t sources)
{
    std::uint64_t total = 0;
    for (const auto& part : parts) total += part.size();
    if (total >= kNone)
        throw LimitExceeded(fmt::format("surface transfer: {} weights, at most 4.29 billion",
                                        count_text(double(total))));
    SurfaceTransfer transfer;
    transfer.sources = sources;
    transfer.begin.assign(targets + 1, 0);
    transfer.source.reserve(total);
    transfer.weight.reserve(total);
    for (const auto& part : parts)
        for (std::size_t i = 0, end = 0; i < part.size(); i = end) {
            double sum = 0;
            for (end = i; end < part.size() && part[end].target == part[i].target; ++end)
                sum += part[end].weight;
            for (std::size_t k = i; k < end; ++k) {
                transfer.source.push_back(part[k].source);
                transfer.weight.push_back(static_cast<float>(part[k].weight / sum));
            }
            transfer.begin[part[i].target + 1] = static_cast<std::uint32_t>(end - i);
        }
    for (std::size_t i = 0; i < targets; ++i) transfer.begin[i + 1] += transfer.begin[i];
    return transfer;
}

/// A cell that takes part in a site's mean.
struct Share {
    std::uint32_t cell;
    double weight;
    double u, v;  ///< along the surface, from the site [voxels]
};

/// Moves the weights so that sum(w (u, v)) vanishes, as far as that leaves none negative: with the
/// mean m and the covariance C of (u, v), w (1 - s ((u, v) - m) C^-1 m), s = 1 or less.
void balance(std::vector<Share>& shares)
{
    double sum = 0, u = 0, v = 0, uu = 0, uv = 0, vv = 0;
    for (const Share& s : shares) {
        sum += s.weight;
        u += s.weight * s.u;
        v += s.weight * s.v;
    }
    u /= sum;
    v /= sum;
    for (const Share& s : shares) {
        uu += s.weight / sum * (s.u - u) * (s.u - u);
        uv += s.weight / sum * (s.u - u) * (s.v - v);
        vv += s.weight / sum * (s.v - v) * (s.v - v);
    }
    const double det = uu * vv - uv * uv;
    if (!(det > 1e-6 * (uu + vv) * (uu + vv))) return;  // cells in a row
    const double gu = (vv * u - uv * v) / det, gv = (uu * v - uv * u) / det;
    const auto along = [&](const Share& s) { return gu * (s.u - u) + gv * (s.v - v); };
    double most = 1;
    for (const Share& s : shares) most = std::max(most, along(s));
    for (Share& s : shares) s.weight *= std::max(0.0, 1 - along(s) / most);
}

}  // namespace

std::size_t SurfaceTransfer::missing() const
{
    std::size_t count = 0;
    for (std::size_t i = 0; i < size(); ++i) count += begin[i] == begin[i + 1];
    return count;
}

std::vector<float> SurfaceTransfer::apply(std::span<const float> values, float missing) const
{
    if (values.size() != sources)
        throw InvalidInput(
            fmt::format("surface transfer: {} values, must be {}, one for each "
                        "source",
                        values.size(), sources));
    std::vector<float> result(size(), missing);
    parallel_for(
        size(),
        [&](std::size_t i) {
            if (begin[i] == begin[i + 1]) return;
            // Measure from the first value: equal ones give it back, though weights are rounded.
            const double first = double(values[source[begin[i]]]);
            double sum = 0;
            for (std::uint32_t k = begin[i]; k < begin[i + 1]; ++k)
                sum += double(weight[k]) * (double(values[source[k]]) - first);
            result[i] = static_cast<float>(first + sum);
        },
        kChunk);
    return result;
}

SurfaceTransfer cells_to_sites(const SurfaceCells& cells, const MeshSites& sites,
                               const Progress& progress)
{
    const std::size_t n = sites.size();
    const auto add_links = [&](std::size_t i, Feet& feet, std::vector<Share>& shares,
                               std::vector<Link>& links) {
        const Vec3d p = cells.transform.voxels(Vec3d(sites.position[i]));
        const Vec3d normal(sites.normal[i]);
        if (!feet.near(p)) return;
        // Two directions along the surface.
        const Vec3d aside = std::abs(normal.x) < 0.6 ? Vec3d(1, 0, 0) : Vec3d(0, 1, 0);
        const Vec3d along = normalized(cross(normal, aside)), across = cross(normal, along);
        feet.around(p, normal, 2, -1, kReach,
                    [&](std::uint32_t cell, Vec3d foot, double d, double agree) {
                        if (d >= kReach) return;
                        const Vec3d away = foot - p;
                        shares.push_back(
                            {cell, (1 - d / kReach) * agree, dot(away, along), dot(away, across)});
                    });
        if (shares.empty()) {
            const std::uint32_t nearest =
                feet.nearest(p, normal, kFarthest, [](std::uint32_t) { return true; });
            if (nearest == kNone) return;
            shares.push_back({nearest, 1, 0, 0});
        } else
            balance(shares);
        std::sort(shares.begin(), shares.end(),
                  [](const Share& a, const Share& b) { return a.cell < b.cell; });
        for (const Share& s : shares)
            if (s.weight > 0) links.push_back({static_cast<std::uint32_t>(i), s.cell, s.weight});
    };
    const auto parts = links_of_sites<Share>(n, Feet(cells), progress, add_links);
    progress.update(1);
    return rows_of(parts, n, cells.size());
}

SurfaceTransfer sites_to_cells(const MeshSites& sites, const SurfaceCells& cells,
                               const Progress& progress)
{
    // Give each piece of a site to the nearest cell.
    const std::size_t n = sites.size();
    const auto add_links = [&](std::size_t i, Feet& feet, std::vector<Link>& pieces,
                               std::vector<Link>& links) {
        const Vec3d normal(sites.normal[i]);
        const auto give = [&](const auto& self, Vec3d a, Vec3d b, Vec3d c, double area) -> void {
            Bounds box;
            for (const Vec3d& corner : {a, b, c}) box.add(corner);
            if (!feet.near(box)) return;
            const double longest =
                std::max({dot(b - a, b - a), dot(c - b, c - b), dot(a - c, a - c)});
            if (longest > 1) {
                const Vec3d ab = (a + b) * 0.5, bc = (b + c) * 0.5, ca = (c + a) * 0.5;
                self(self, a, ab, ca, area / 4);
                self(self, ab, b, bc, area / 4);
                self(self, ca, bc, c, area / 4);
                self(self, ab, bc, ca, area / 4);
                return;
            }
            const std::uint32_t cell =
                feet.nearest((a + b + c) / 3.0, normal, kReach, [](std::uint32_t) { return true; });
            if (cell != kNone) pieces.push_back({cell, static_cast<std::uint32_t>(i), area});
        };
        const auto& [a, b, c] = sites.mesh.triangles[i];
        const auto corner = [&](std::uint32_t v) {
            return cells.transform.voxels(Vec3d(sites.mesh.vertices[v]));
        };
        give(give, corner(a), corner(b), corner(c), double(sites.area[i]));
        // Pieces of a site that fall to one cell are one.
        std::stable_sort(pieces.begin(), pieces.end(),
                         [](const Link& x, const Link& y) { return x.target < y.target; });
        const std::size_t before = links.size();
        for (const Link& piece : pieces)
            if (links.size() > before && links.back().target == piece.target)
                links.back().weight += piece.weight;
            else
                links.push_back(piece);
    };
    const Feet feet(cells);
    auto parts = links_of_sites<Link>(n, feet, progress, add_links);
    progress.update(0.8);

    // Order the links by cell; within a cell they stay in the order of sites.
    std::vector<std::uint64_t> begin(cells.size() + 1, 0);
    for (const auto& part : parts)
        for (const Link& link : part) ++begin[link.target + 1];
    for (std::size_t c = 0; c < cells.size(); ++c) begin[c + 1] += begin[c];
    std::vector<Link> links(begin.back());
    std::vector<std::uint64_t> next(begin.begin(), begin.end() - 1);
    for (auto& part : parts) {
        for (const Link& link : part) links[next[link.target]++] = link;
        part = {};
    }

    // A cell that got nothing does as the nearest one that did.
    std::vector<std::uint32_t> stand_in(cells.size(), kNone);
    parallel_for_range(
        cells.size(),
        [&](std::size_t from, std::size_t to) {
            progress.check();
            Feet own = feet;
            for (std::size_t c = from; c != to; ++c)
                if (begin[c] != begin[c + 1])
                    stand_in[c] = static_cast<std::uint32_t>(c);
                else
                    stand_in[c] = own.nearest(
                        own.foot(static_cast<std::uint32_t>(c)), Vec3d(cells.normal[c]), kFarthest,
                        [&](std::uint32_t other) { return begin[other] != begin[other + 1]; });
        },
        kChunk);
    std::vector<std::vector<Link>> rows(1);
    rows[0].reserve(links.size());
    for (std::size_t c = 0; c < cells.size(); ++c) {
        if (stand_in[c] == kNone) continue;
        for (std::uint64_t k = begin[stand_in[c]]; k < begin[stand_in[c] + 1]; ++k)
            rows[0].push_back({static_cast<std::uint32_t>(c), links[k].source, links[k].weight});
    }
    progress.update(1);
    return rows_of(rows, cells.size(), n);
}

std::vector<float> sample_grid(const FloatGrid& grid, std::span<const Vec3f> points)
{
    std::vector<float> values(points.size(), grid.background());
    parallel_for_range(
        points.size(),
        [&](std::size_t begin, std::size_t end) {
            GridReader<float> reader(grid);
            for (std::size_t i = begin; i != end; ++i) {
                const Vec3d p = grid.transform().voxels(Vec3d(points[i]));
                constexpr double kMost = 1 << 30;  // voxel indices are 32-bit
                if (std::abs(p.x) < kMost && std::abs(p.y) < kMost && std::abs(p.z) < kMost)
                    values[i] = reader.sample(p);
            }
        },
        kChunk);
    return values;
}

}  // namespace sekitei
