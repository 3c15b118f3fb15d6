#include "solvers/weathering/boundary.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/parallel.h"

namespace sekitei::weathering {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// Half the width of the ramp from 0 to volmax [voxels]: the longest lattice edge, sqrt(3), so that
/// an edge across the surface never ends in a clamped value.
const double kHalfRamp = std::sqrt(3.0);
/// Cuts farther than this along a line do not matter [voxels].
constexpr double kReach = 3;
/// Least distance from the surface: keeps a voxel on the side that its region and piece say.
constexpr double kLeastDepth = 1e-4;

enum class Fill : std::uint8_t { Empty, Rock, Both };

/// A leaf and one voxel around it: bit z + 1 of rows[x + 1][y + 1] is the voxel (x, y, z).
using Rows = std::array<std::array<std::uint16_t, 10>, 10>;

/// Voxels of a leaf whose 26-neighbourhood holds both rock and emptiness.
LeafMask mixed_26(const Rows& rows)
{
    std::array<std::array<std::uint16_t, 10>, 10> any, all;
    for (std::size_t x = 0; x < 10; ++x)
        for (std::size_t y = 0; y < 10; ++y) {
            const unsigned r = rows[x][y];
            any[x][y] = static_cast<std::uint16_t>(r | r << 1 | r >> 1);
            all[x][y] = static_cast<std::uint16_t>(r & r << 1 & r >> 1);
        }
    LeafMask mask;
    for (std::size_t x = 0; x < 8; ++x)
        for (std::size_t y = 0; y < 8; ++y) {
            unsigned one = 0, every = ~0u;
            for (std::size_t i = 0; i < 3; ++i)
                for (std::size_t j = 0; j < 3; ++j) {
                    one |= any[x + i][y + j];
                    every &= all[x + i][y + j];
                }
            mask.words[x] |= std::uint64_t(((one & ~every) >> 1) & 0xFF) << (8 * y);
        }
    return mask;
}

/// The same for the six faces.
LeafMask mixed_6(const Rows& rows)
{
    LeafMask mask;
    for (std::size_t x = 1; x < 9; ++x)
        for (std::size_t y = 1; y < 9; ++y) {
            const unsigned r = rows[x][y];
            const unsigned one = r | r << 1 | r >> 1 | rows[x - 1][y] | rows[x + 1][y] |
                                 rows[x][y - 1] | rows[x][y + 1];
            const unsigned every = r & r << 1 & r >> 1 & rows[x - 1][y] & rows[x + 1][y] &
                                   rows[x][y - 1] & rows[x][y + 1];
            mask.words[x - 1] |= std::uint64_t(((one & ~every) >> 1) & 0xFF) << (8 * (y - 1));
        }
    return mask;
}

struct Step {
    int x, y, z;
};
Step step_of(std::size_t neighbour)
{
    const int n = static_cast<int>(neighbour);
    return {n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1};
}

/// Does any of these voxels touch the leaf's neighbour in this direction.
bool reaches(const LeafMask& mask, Step d)
{
    std::uint64_t part = ~0ull;
    if (d.y) part &= d.y < 0 ? 0xFFull : 0xFFull << 56;
    if (d.z) part &= d.z < 0 ? 0x0101010101010101ull : 0x8080808080808080ull;
    for (std::size_t x = 0; x < 8; ++x)
        if ((d.x == 0 || x == (d.x < 0 ? 0u : 7u)) && (mask.words[x] & part)) return true;
    return false;
}

/// A level set near a voxel [voxels, negative inside]; beyond the box it goes on linearly.
class Band {
public:
    Band(const FloatGrid& grid, const Domain& domain)
        : reader_(grid),
          domain_(domain),
          edge_(grid.transform().voxel),
          limit_(0.99 * std::abs(double(grid.background())) / edge_)
    {
    }

    double operator()(Coord c)
    {
        if (domain_.contains(c)) return reader_.value(c) / edge_;
        const Coord top = domain_.dims - Coord(1);
        const Coord a = max(min(c, top), Coord(0));
        const double at = reader_.value(a) / edge_;
        if (std::abs(at) >= limit_) return at;
        const double before = reader_.value(max(min(a * 2 - c, top), Coord(0))) / edge_;
        return 2 * at - before;
    }
    bool far(double d) const { return std::abs(d) >= limit_; }

private:
    GridReader<float> reader_;
    const Domain& domain_;
    double edge_, limit_;
};

struct Depth {
    double s = kInfinity;  ///< signed distance to the boundary, positive in rock [voxels]
    Surface surface = Surface::JointWall;
};
Depth least(Depth a, Depth b)
{
    return b.s < a.s ? b : a;
}
Depth most(Depth a, Depth b)
{
    return b.s > a.s ? b : a;
}

class BoundaryPass {
public:
    BoundaryPass(const Inputs& inputs, const Params& params, const IntGrid& component,
                 const Pieces& pieces, const PolylineIndex& index, const std::vector<double>& arcs,
                 const Terrain* terrain, const Progress& progress)
        : inputs_(inputs),
          params_(params),
          component_(component),
          pieces_(pieces),
          index_(index),
          arcs_(arcs),
          terrain_(terrain),
          progress_(progress)
    {
    }

    BoundaryResult run()
    {
        find_rock();
        progress_.update(0.2);
        grow();
        progress_.update(0.3);

        BoundaryResult result;
        result.density = FloatGrid::uninitialised(topology_, inputs_.domain.transform, 0.0f);
        result.surface = IntGrid::uninitialised(topology_, inputs_.domain.transform, -1);
        std::vector<std::uint8_t> touched(topology_->size(), 0);
        topology_->neighbours();
        parallel_for_range(
            topology_->size(),
            [&](std::size_t begin, std::size_t end) {
                Worker worker(*this);
                for (std::size_t leaf = begin; leaf != end; ++leaf) {
                    progress_.check();
                    touched[leaf] = worker.fill(leaf, result);
                }
            },
            8);
        progress_.update(0.9);
        result.density.compress();
        result.surface.compress();

        std::size_t lava_leaves = 0, lava_touched = 0;
        for (std::size_t r = 0; r < counts_.size(); ++r) {
            result.lava_voxels += counts_[r].lava;
            result.removed_voxels += counts_[r].removed;
            if (counts_[r].lava == 0) continue;
            ++lava_leaves;
            const std::uint32_t leaf = topology_->find(inputs_.region.origin(r));
            if (leaf != kNoLeaf) lava_touched += touched[leaf];
        }
        if (lava_leaves > 0)
            result.leaves_touched_share =
                static_cast<double>(lava_touched) / static_cast<double>(lava_leaves);
        return result;
    }

private:
    struct Counts {
        int lava = 0, removed = 0;
    };

    /// Find which voxels are rock.
    void find_rock()
    {
        const IntGrid& region = inputs_.region;
        rock_.resize(region.leaf_count());
        counts_.resize(region.leaf_count());
        parallel_for_range(
            region.leaf_count(),
            [&](std::size_t begin, std::size_t end) {
                for (std::size_t r = begin; r != end; ++r) {
                    progress_.check();
                    const Coord origin = region.origin(r);
                    const std::uint32_t leaf = component_.topology()->find(origin);
                    if (region.is_constant(r) && leaf != kNoLeaf && component_.is_constant(leaf)) {
                        constant_rock(r, region.constant(r), component_.constant(leaf));
                        continue;
                    }
                    for (int o = 0; o < kLeafSize; ++o) {
                        const std::int32_t id = region.at(r, o);
                        if (id == kLavaRegion) {
                            const auto piece = static_cast<std::size_t>(component_.at(leaf, o));
                            ++counts_[r].lava;
                            if (pieces_.present[piece])
                                rock_[r].set(o);
                            else
                                ++counts_[r].removed;
                        } else if (id == kSlowRegion && params_.slow_fill == SlowFill::Rock &&
                                   stands(leaf_coord(origin, o)))
                            rock_[r].set(o);
                    }
                }
            },
            16);
    }

    void constant_rock(std::size_t r, std::int32_t region, std::int32_t piece)
    {
        if (region == kLavaRegion) {
            counts_[r].lava = kLeafSize;
            if (pieces_.present[static_cast<std::size_t>(piece)])
                rock_[r] = LeafMask::full();
            else
                counts_[r].removed = kLeafSize;
            return;
        }
        if (region != kSlowRegion || params_.slow_fill != SlowFill::Rock) return;
        for (int o = 0; o < kLeafSize; ++o)
            if (stands(leaf_coord(inputs_.region.origin(r), o))) rock_[r].set(o);
    }

    /// Slow rock is cut by the terrain itself.
    bool stands(Coord c) const { return !terrain_ || terrain_->above(c) < 0; }

    /// List the leaves that hold rock or touch some.
    void grow()
    {
        const LeafTopology& base = *inputs_.region.topology();
        std::vector<std::uint8_t> needed(base.size(), 0);
        std::vector<std::uint32_t> missing(base.size(),
                                           0);  // bit n: no leaf there, rock touches it
        base.neighbours();
        parallel_for(
            base.size(),
            [&](std::size_t r) {
                needed[r] = !rock_[r].none();
                for (std::size_t n = 0; n < 27; ++n) {
                    const std::uint32_t other = base.neighbours()[r][n];
                    const Step d = step_of(n);
                    if (other == kNoLeaf) {
                        if (reaches(rock_[r], d)) missing[r] |= 1u << n;
                    } else if (!needed[r] && reaches(rock_[other], {-d.x, -d.y, -d.z}))
                        needed[r] = 1;
                }
            },
            64);
        std::vector<Coord> origins;
        for (std::size_t r = 0; r < base.size(); ++r) {
            if (needed[r]) origins.push_back(base.origin(r));
            for (std::size_t n = 0; missing[r] >> n; ++n)
                if ((missing[r] >> n) & 1) {
                    const Step d = step_of(n);
                    origins.push_back(base.origin(r) + Coord(d.x, d.y, d.z) * kLeafEdge);
                }
        }
        topology_ = LeafTopology::build(std::move(origins));
        region_leaf_.resize(topology_->size());
        fill_.resize(topology_->size());
        parallel_for(
            topology_->size(),
            [&](std::size_t leaf) {
                region_leaf_[leaf] = base.find(topology_->origin(leaf));
                const LeafMask* mask = rock(static_cast<std::uint32_t>(leaf));
                fill_[leaf] = !mask || mask->none() ? Fill::Empty
                              : mask->all()         ? Fill::Rock
                                                    : Fill::Both;
            },
            64);
    }

    const LeafMask* rock(std::uint32_t leaf) const
    {
        const std::uint32_t r = leaf == kNoLeaf ? kNoLeaf : region_leaf_[leaf];
        return r == kNoLeaf ? nullptr : &rock_[r];
    }

    /// What one thread needs to fill leaves.
    class Worker {
    public:
        explicit Worker(const BoundaryPass& pass)
            : pass_(pass),
              near_(pass.index_, pass.inputs_.lines, pass.arcs_),
              body_(pass.inputs_.body_sdf, pass.inputs_.domain),
              slow_(pass.inputs_.slow_sdf, pass.inputs_.domain),
              region_(pass.inputs_.region),
              component_(pass.component_)
        {
        }

        bool fill(std::size_t leaf, BoundaryResult& out)
        {
            const auto& neighbours = pass_.topology_->neighbours()[leaf];
            const Fill own = pass_.fill_[leaf];
            const double volmax = pass_.params_.density;
            bool both = own == Fill::Both;
            for (std::size_t n = 0; n < 27 && !both; ++n)
                both = (neighbours[n] == kNoLeaf ? Fill::Empty : pass_.fill_[neighbours[n]]) != own;
            const Rows rows = both ? rows_around(neighbours) : Rows{};
            const LeafMask ring = both ? mixed_26(rows) : LeafMask{};
            if (ring.none()) {
                const bool rock = own == Fill::Rock;
                out.density.set_constant(leaf, rock ? static_cast<float>(volmax) : 0.0f);
                if (rock) out.density.mask(leaf) = LeafMask::full();
                out.surface.set_constant(leaf, -1);
                return false;
            }

            origin_ = pass_.topology_->origin(leaf);
            near_.enter(centre_of(origin_) + Vec3d(3.5), (3.5 + 1) * std::sqrt(3.0));
            gather_columns();
            float* density = out.density.values(leaf);
            std::int32_t* surface = out.surface.values(leaf);
            const LeafMask* rock = pass_.rock(static_cast<std::uint32_t>(leaf));
            const bool plane = pass_.params_.anti_aliasing == AntiAliasing::Plane;
            const LeafMask shared = plane ? LeafMask{} : mixed_6(rows);
            for (int o = 0; o < kLeafSize; ++o) {
                const bool solid = rock && rock->test(o);
                double volume = solid ? volmax : 0;
                surface[o] = -1;
                if (ring.test(o)) {
                    const Depth depth = depth_at(o, solid);
                    surface[o] = static_cast<std::int32_t>(depth.surface);
                    if (plane)
                        volume = volmax * std::clamp(0.5 + depth.s / (2 * kHalfRamp), 0.0, 1.0);
                    else if (shared.test(o))
                        volume = mixed_volume(o, volume);
                }
                density[o] = static_cast<float>(volume);
                if (density[o] > 0) out.density.mask(leaf).set(o);
            }
            out.surface.mask(leaf) = ring;
            return true;
        }

    private:
        Rows rows_around(const LeafTopology::Neighbours& neighbours) const
        {
            Rows rows{};
            for (std::size_t n = 0; n < 27; ++n) {
                const LeafMask* mask = pass_.rock(neighbours[n]);
                if (!mask || mask->none()) continue;
                const Step d = step_of(n);
                const int x0 = d.x < 0 ? 7 : 0, x1 = d.x > 0 ? 1 : 8;
                const int y0 = d.y < 0 ? 7 : 0, y1 = d.y > 0 ? 1 : 8;
                for (int x = x0; x < x1; ++x)
                    for (int y = y0; y < y1; ++y) {
                        const unsigned r = static_cast<unsigned>(
                            (mask->words[static_cast<std::size_t>(x)] >> (8 * y)) & 0xFF);
                        auto& row = rows[static_cast<std::size_t>(x + 8 * d.x + 1)]
                                        [static_cast<std::size_t>(y + 8 * d.y + 1)];
                        row = static_cast<std::uint16_t>(row | (d.z < 0   ? r >> 7
                                                                : d.z > 0 ? (r & 1) << 9
                                                                          : r << 1));
                    }
            }
            return rows;
        }

        /// Columns of the lava voxels of the leaf and one voxel around it; -1 elsewhere.
        void gather_columns()
        {
            const IntGrid& column = pass_.inputs_.column;
            const IntGrid& region = pass_.inputs_.region;
            const Coord dims = pass_.inputs_.domain.dims;
            for (std::size_t n = 0; n < 27; ++n) {
                const Step d = step_of(n);
                const Coord shift = Coord(d.x, d.y, d.z) * kLeafEdge;
                const std::uint32_t c = column.topology()->find(origin_ + shift);
                const std::uint32_t r = region.topology()->find(origin_ + shift);
                const int x0 = d.x < 0 ? 7 : 0, x1 = d.x > 0 ? 1 : 8;
                const int y0 = d.y < 0 ? 7 : 0, y1 = d.y > 0 ? 1 : 8;
                const int z0 = d.z < 0 ? 7 : 0, z1 = d.z > 0 ? 1 : 8;
                for (int x = x0; x < x1; ++x)
                    for (int y = y0; y < y1; ++y)
                        for (int z = z0; z < z1; ++z) {
                            const int o = leaf_offset({x, y, z});
                            const Coord p = origin_ + shift + Coord(x, y, z);
                            const bool lava = c != kNoLeaf && r != kNoLeaf && p.x >= 0 &&
                                              p.y >= 0 && p.z >= 0 && p.x < dims.x &&
                                              p.y < dims.y && p.z < dims.z &&
                                              region.at(r, o) == kLavaRegion;
                            columns_[cell(x + shift.x, y + shift.y, z + shift.z)] =
                                lava ? column.at(c, o) : -1;
                        }
            }
        }

        static std::size_t cell(int x, int y, int z)
        {
            return static_cast<std::size_t>(((x + 1) * 10 + y + 1) * 10 + z + 1);
        }

        /// Distinct columns of a voxel and its 26 neighbours, ascending.
        void find_lines(Coord v)
        {
            lines_.clear();
            std::int32_t last = -1;
            for (int x = v.x - 1; x <= v.x + 1; ++x)
                for (int y = v.y - 1; y <= v.y + 1; ++y)
                    for (int z = v.z - 1; z <= v.z + 1; ++z) {
                        const std::int32_t id = columns_[cell(x, y, z)];
                        if (id < 0 || id == last) continue;
                        last = id;
                        if (std::find(lines_.begin(), lines_.end(), id) == lines_.end())
                            lines_.push_back(id);
                    }
            std::sort(lines_.begin(), lines_.end());
        }

        /// Signed distance to the boundary of the columns that stand, as if there were no other
        /// boundary. Infinite where no column is near or all around stand.
        Depth columns_depth(Coord c, std::int32_t own_column)
        {
            const Vec3d p = centre_of(c);
            const Pieces& pieces = pass_.pieces_;
            points_.clear();
            std::size_t own = 0;
            for (std::size_t k = 0; k < lines_.size(); ++k) {
                points_.push_back(near_.nearest(lines_[k], p));
                const bool nearer = points_[k].distance2 < points_[own].distance2;
                if (own_column >= 0 ? lines_[k] == own_column : nearer) own = k;
            }
            const NearestPoint& i = points_[own];
            auto piece_of = [&](const NearestPoint& at) {
                return pieces.at(static_cast<std::size_t>(at.line), at.arc, p.z);
            };
            const std::uint32_t piece =
                own_column >= 0 ? static_cast<std::uint32_t>(component_.value(c)) : piece_of(i);
            const bool stands = pieces.present[piece] != 0;
            Depth depth;
            for (const NearestPoint& j : points_) {
                const std::uint32_t other = &j == &i ? piece : piece_of(j);
                // How far along its line the other column changes to the opposite state, and how
                // far the plane between the two columns is: both must be crossed.
                Depth boundary;
                boundary.s = pieces.gap(static_cast<std::size_t>(j.line), other, j.arc, p.z,
                                        !stands, kReach);
                if (boundary.s == kInfinity) continue;
                boundary.surface = pieces.horizontal ? Surface::TerrainCut : Surface::CutFace;
                if (&j != &i) {
                    const double apart = length(j.point - i.point);
                    const double wall =
                        apart > 0 ? std::max(0.0, (j.distance2 - i.distance2) / (2 * apart)) : 0;
                    if (wall >= boundary.s) boundary = {wall, Surface::JointWall};
                }
                depth = least(depth, boundary);
            }
            if (!stands) depth.s = -depth.s;
            return depth;
        }

        /// Signed distance to the boundary of all rock, put together from its parts.
        Depth depth_at(int offset, bool solid)
        {
            const Inputs& in = pass_.inputs_;
            const Coord v = leaf_coord({}, offset), c = origin_ + v;
            const Vec3d p = centre_of(c);
            find_lines(v);
            Depth depth{kInfinity, Surface::JointWall};
            const bool slow_part = in.slow_sdf.leaf_count() > 0;
            if (!lines_.empty()) depth = columns_depth(c, columns_[cell(v.x, v.y, v.z)]);
            if (pass_.params_.slow_fill == SlowFill::Rock) {
                Depth slow{slow_part ? -slow_(c) : -kInfinity, Surface::SlowContact};
                if (lines_.empty()) slow.s = kInfinity;  // the body's boundary is the slow part's
                if (pass_.terrain_ && (lines_.empty() || slow.s > -kReach))
                    slow = least(slow, {-pass_.terrain_->distance_above(c), Surface::TerrainCut});
                depth = lines_.empty() ? slow : most(depth, slow);
            } else if (slow_part)
                depth = least(depth, {slow_(c), Surface::SlowContact});

            double body = body_(c);
            // A foreign level set may lack its interior: there the region knows better.
            if (solid && body > 0 && body_.far(body)) body = -kInfinity;
            depth = least(depth, {-body, Surface::CoolingContact});
            const Coord n = in.domain.dims;
            const double box = std::min({p.x, p.y, p.z, n.x - p.x, n.y - p.y, n.z - p.z});
            depth = least(depth, {box, Surface::DomainCap});
            depth.s = solid ? std::max(depth.s, kLeastDepth) : std::min(depth.s, -kLeastDepth);
            return depth;
        }

        /// Density by the shares of the columns around a voxel [Ito2004, eqs. 5 to 7].
        double mixed_volume(int offset, double binary)
        {
            const Coord v = leaf_coord({}, offset);
            if (columns_[cell(v.x, v.y, v.z)] < 0) return binary;
            find_lines(v);
            const Vec3d p = centre_of(origin_ + v);
            const Pieces& pieces = pass_.pieces_;
            distances_.clear();
            standing_.clear();
            for (const std::int32_t id : lines_) {
                const NearestPoint at = near_.nearest(id, p);
                const std::uint32_t piece = pieces.at(static_cast<std::size_t>(id), at.arc, p.z);
                distances_.push_back(std::sqrt(at.distance2));
                standing_.push_back(pieces.present[piece]);
            }
            const std::vector<double> ratios = pass_.params_.anti_aliasing == AntiAliasing::Literal
                                                   ? literal_ratios(distances_)
                                                   : simplex_ratios(distances_);
            double share = 0;
            for (std::size_t k = 0; k < ratios.size(); ++k)
                if (standing_[k]) share += ratios[k];
            return pass_.params_.density * std::clamp(share, 0.0, 1.0);
        }

        const BoundaryPass& pass_;
        NearLines near_;
        Band body_, slow_;
        GridReader<std::int32_t> region_, component_;
        Coord origin_;
        std::array<std::int32_t, 1000> columns_;
        std::vector<std::int32_t> lines_;
        std::vector<NearestPoint> points_;
        std::vector<double> distances_;
        std::vector<std::uint8_t> standing_;
    };

    const Inputs& inputs_;
    const Params& params_;
    const IntGrid& component_;
    const Pieces& pieces_;
    const PolylineIndex& index_;
    const std::vector<double>& arcs_;
    const Terrain* terrain_;
    const Progress& progress_;
    std::vector<LeafMask> rock_;  // by leaf of the region
    std::vector<Counts> counts_;
    TopologyPtr topology_;                    // of the density
    std::vector<std::uint32_t> region_leaf_;  // by leaf of the density
    std::vector<Fill> fill_;
};

}  // namespace

BoundaryResult find_boundary(const Inputs& inputs, const Params& params, const IntGrid& component,
                             const Pieces& pieces, const PolylineIndex& index,
                             const std::vector<double>& arcs, const Terrain* terrain,
                             const Progress& progress)
{
    return BoundaryPass(inputs, params, component, pieces, index, arcs, terrain, progress).run();
}

std::vector<double> literal_ratios(const std::vector<double>& d)
{
    const auto n = static_cast<double>(d.size());
    double mean = 0;
    for (const double x : d) mean += x / n;
    std::vector<double> ratios;
    ratios.reserve(d.size());
    for (const double x : d) ratios.push_back(1 / n + mean - x);
    return ratios;
}

std::vector<double> simplex_ratios(const std::vector<double>& d)
{
    // tau such that sum max(0, tau - d_i) = 1: over the k nearest, tau = (1 + their sum) / k, for
    // the largest k whose farthest still gets a share.
    std::vector<double> sorted = d;
    std::sort(sorted.begin(), sorted.end());
    double sum = 0, tau = 0;
    for (std::size_t k = 0; k < sorted.size(); ++k) {
        const double with = (1 + sum + sorted[k]) / static_cast<double>(k + 1);
        if (with <= sorted[k]) break;
        sum += sorted[k];
        tau = with;
    }
    std::vector<double> ratios;
    ratios.reserve(d.size());
    for (const double x : d) ratios.push_back(std::max(0.0, tau - x));
    return ratios;
}

}  // namespace sekitei::weathering
