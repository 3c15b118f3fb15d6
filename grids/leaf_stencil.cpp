#include "grids/leaf_stencil.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "core/clones.h"

#define SEKITEI_INLINE inline __attribute__((always_inline))

namespace sekitei {
namespace {

constexpr int kPlane = 64;  // voxels of a leaf with the same x: 8 rows of 8 along z

/// [Ito2004, eq. 2] for `count` voxels in a row. The association of the sum is part of the result.
SEKITEI_INLINE void heat_row(const double* t, const double* xm, const double* xp, const double* ym,
                             const double* yp, const double* z_sum, const double* coefficient,
                             double* __restrict out, int count)
{
    for (int i = 0; i < count; ++i)
        out[i] =
            t[i] + coefficient[i] * (((xm[i] + xp[i]) + (ym[i] + yp[i])) + z_sum[i] - 6 * t[i]);
}

/// What the air takes beyond the plain step, in place; `old` is T before the step.
SEKITEI_INLINE double convected(double stepped, double old, double extra, double air)
{
    return stepped + extra * (air - old);
}

/// alpha (conductance - 1) faces: how much stronger than a voxel's neighbour the air pulls.
double convection_extra(const HeatProblem& problem, int faces)
{
    return problem.alpha * (problem.convection.conductance - 1) * faces;
}

std::vector<LeafMask> free_inside(const HeatProblem& problem)
{
    std::vector<LeafMask> free = problem.free;
    for (std::size_t leaf = 0; leaf < free.size(); ++leaf) {
        const LeafMask inside = domain_mask(problem.domain, problem.temperature.origin(leaf));
        for (std::size_t w = 0; w < 8; ++w) free[leaf].words[w] &= inside.words[w];
    }
    return free;
}

/// Where the free values of each leaf begin.
std::vector<std::size_t> free_offsets(const std::vector<LeafMask>& free)
{
    std::vector<std::size_t> counts(free.size());
    for (std::size_t leaf = 0; leaf < free.size(); ++leaf)
        counts[leaf] = static_cast<std::size_t>(free[leaf].count());
    return prefix_sum(counts);
}

}  // namespace

std::vector<LeafMask> shifted_masks(const LeafTopology& topology,
                                    const std::vector<LeafMask>& masks, int axis, int sign)
{
    constexpr std::uint64_t kFirst = 0x0101010101010101u;  // z = 0 of each row
    const auto side = static_cast<std::size_t>(
        neighbour_index(axis == 0 ? sign : 0, axis == 1 ? sign : 0, axis == 2 ? sign : 0));
    const auto& neighbours = topology.neighbours();
    std::vector<LeafMask> result(masks.size());
    parallel_for(
        masks.size(),
        [&](std::size_t leaf) {
            const auto& own = masks[leaf].words;
            const std::uint32_t n = neighbours[leaf][side];
            const auto next = n == kNoLeaf ? LeafMask{}.words : masks[n].words;
            auto& out = result[leaf].words;
            for (std::size_t x = 0; x < 8; ++x) {
                if (axis == 0)
                    out[x] =
                        sign > 0 ? (x < 7 ? own[x + 1] : next[0]) : (x > 0 ? own[x - 1] : next[7]);
                else if (axis == 1)
                    out[x] = sign > 0 ? own[x] >> 8 | next[x] << 56 : own[x] << 8 | next[x] >> 56;
                else
                    out[x] = sign > 0 ? (own[x] >> 1 & ~(kFirst << 7)) | (next[x] & kFirst) << 7
                                      : (own[x] << 1 & ~kFirst) | (next[x] >> 7 & kFirst);
            }
        },
        256);
    return result;
}

std::vector<LeafMask> dilated_masks(const LeafTopology& topology,
                                    const std::vector<LeafMask>& masks)
{
    std::vector<LeafMask> grown = masks;
    for (int axis = 0; axis < 3; ++axis) {
        const auto before = shifted_masks(topology, grown, axis, -1);
        const auto after = shifted_masks(topology, grown, axis, 1);
        for (std::size_t leaf = 0; leaf < grown.size(); ++leaf)
            for (std::size_t w = 0; w < 8; ++w)
                grown[leaf].words[w] |= before[leaf].words[w] | after[leaf].words[w];
    }
    return grown;
}

LeafMask domain_mask(const Domain& domain, Coord origin)
{
    const Coord rest = domain.dims - origin;
    if (rest.x >= 8 && rest.y >= 8 && rest.z >= 8 && origin.x >= 0 && origin.y >= 0 &&
        origin.z >= 0)
        return LeafMask::full();
    LeafMask mask;
    for (int offset = 0; offset < kLeafSize; ++offset)
        if (domain.contains(leaf_coord(origin, offset))) mask.set(offset);
    return mask;
}

LeafGrid<double> with_free_values(const HeatProblem& problem, const std::vector<double>& values)
{
    const std::vector<LeafMask> free = free_inside(problem);
    const std::vector<std::size_t> begin = free_offsets(free);
    const LeafGrid<double>& initial = problem.temperature;
    auto result = LeafGrid<double>::uninitialised(initial.topology(), initial.transform(),
                                                  initial.background());
    parallel_for(
        initial.leaf_count(),
        [&](std::size_t leaf) {
            if (free[leaf].none() && initial.is_constant(leaf)) {
                result.set_constant(leaf, initial.constant(leaf));
                return;
            }
            double* out = result.values(leaf);
            for (int i = 0; i < kLeafSize; ++i) out[i] = initial.at(leaf, i);
            std::size_t next = begin[leaf];
            free[leaf].for_each([&](int i) { out[i] = values[next++]; });
        },
        64);
    result.compress();
    return result;
}

// The dense solver ------------------------------------------------------------------------------

namespace {

class DenseHeat final : public HeatSolver {
public:
    explicit DenseHeat(const HeatProblem& problem);

    void advance(int count, const Progress& progress) override
    {
        for (int i = 0; i < count; ++i) {
            progress.check();
            step_planes(false);
        }
    }
    double step(const Progress& progress) override
    {
        progress.check();
        step_planes(true);
        return *std::max_element(change_.begin(), change_.end());
    }
    int steps() const override { return steps_; }
    std::vector<double> free_values() const override;
    void set_free_values(const std::vector<double>& values) override;

private:
    struct Contact {
        std::size_t voxel;
        double extra;
    };

    std::size_t index(Coord c) const
    {
        return (std::size_t(c.x) * std::size_t(dims_.y) + std::size_t(c.y)) * std::size_t(dims_.z) +
               std::size_t(c.z);
    }
    void step_planes(bool measure);
    void heat_planes(int begin, int end, double* z_sum);

    Coord dims_;
    std::vector<std::size_t> free_;  // index of each free voxel, in the order of free_values()
    std::vector<double> coefficient_, now_, next_, change_;
    std::vector<Contact> contacts_;
    std::vector<std::size_t> contact_begin_;  // by plane
    double air_ = 0;
    int steps_ = 0;
};

DenseHeat::DenseHeat(const HeatProblem& problem)
    : dims_(problem.domain.dims), air_(problem.convection.air_temperature)
{
    const auto voxels = std::size_t(dims_.x) * std::size_t(dims_.y) * std::size_t(dims_.z);
    now_.assign(voxels, problem.temperature.background());
    coefficient_.assign(voxels, 0);
    change_.assign(std::size_t(dims_.x), 0);
    const std::vector<LeafMask> free = free_inside(problem);
    for (std::size_t leaf = 0; leaf < free.size(); ++leaf) {
        const Coord origin = problem.temperature.origin(leaf);
        domain_mask(problem.domain, origin).for_each([&](int i) {
            now_[index(leaf_coord(origin, i))] = problem.temperature.at(leaf, i);
        });
        free[leaf].for_each([&](int i) {
            free_.push_back(index(leaf_coord(origin, i)));
            coefficient_[free_.back()] = problem.alpha;
        });
    }
    next_ = now_;
    for (const Convection::Voxel& v : problem.convection.voxels)
        contacts_.push_back({index(leaf_coord(problem.temperature.origin(v.leaf), v.offset)),
                             convection_extra(problem, v.faces)});
    std::sort(contacts_.begin(), contacts_.end(),
              [](const Contact& a, const Contact& b) { return a.voxel < b.voxel; });
    contact_begin_.assign(std::size_t(dims_.x) + 1, contacts_.size());
    const std::size_t plane = std::size_t(dims_.y) * std::size_t(dims_.z);
    for (std::size_t i = contacts_.size(); i-- > 0;)
        for (std::size_t x = 0; x <= contacts_[i].voxel / plane; ++x)
            contact_begin_[x] = std::min(contact_begin_[x], i);
}

SEKITEI_CLONES void heat_plane(const double* t, const double* xm, const double* xp,
                               const double* coefficient, double* __restrict out, double* z_sum,
                               int ny, int nz)
{
    for (int y = 0; y < ny; ++y) {
        const std::ptrdiff_t row = std::ptrdiff_t(y) * nz;
        const double* r = t + row;
        z_sum[0] = r[0] + r[nz > 1 ? 1 : 0];
        for (int z = 1; z < nz - 1; ++z) z_sum[z] = r[z - 1] + r[z + 1];
        if (nz > 1) z_sum[nz - 1] = r[nz - 2] + r[nz - 1];
        heat_row(r, xm + row, xp + row, y > 0 ? r - nz : r, y < ny - 1 ? r + nz : r, z_sum,
                 coefficient + row, out + row, nz);
    }
}

void DenseHeat::step_planes(bool measure)
{
    const std::size_t plane = std::size_t(dims_.y) * std::size_t(dims_.z);
    const auto planes = std::size_t(dims_.x);
    // A task below some ten thousand voxels costs more to hand out than to do.
    const std::size_t grain = std::max<std::size_t>(1, 16384 / plane);
    parallel_for_range(
        planes,
        [&](std::size_t begin, std::size_t end) {
            std::vector<double> z_sum(std::size_t(dims_.z));
            for (std::size_t x = begin; x < end; ++x) {
                const double* t = now_.data() + x * plane;
                double* out = next_.data() + x * plane;
                heat_plane(t, x > 0 ? t - plane : t, x + 1 < planes ? t + plane : t,
                           coefficient_.data() + x * plane, out, z_sum.data(), dims_.y, dims_.z);
                for (std::size_t i = contact_begin_[x]; i < contact_begin_[x + 1]; ++i) {
                    const std::size_t v = contacts_[i].voxel;
                    next_[v] = convected(next_[v], now_[v], contacts_[i].extra, air_);
                }
                if (!measure) continue;
                double largest = 0;
                for (std::size_t i = 0; i < plane; ++i)
                    largest = std::max(largest, std::abs(out[i] - t[i]));
                change_[x] = largest;
            }
        },
        grain);
    now_.swap(next_);
    ++steps_;
}

std::vector<double> DenseHeat::free_values() const
{
    std::vector<double> values(free_.size());
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = now_[free_[i]];
    return values;
}

void DenseHeat::set_free_values(const std::vector<double>& values)
{
    for (std::size_t i = 0; i < values.size(); ++i) now_[free_[i]] = values[i];
}

// The sparse solver -----------------------------------------------------------------------------

using Four = double __attribute__((vector_size(32), aligned(8), may_alias));

/// The voxel's coefficient for each pattern of free voxels in a row of 8: row_coefficients[8 m +
/// z].
using RowCoefficients = std::array<double, 256 * 8>;

RowCoefficients row_coefficients(double alpha)
{
    RowCoefficients table{};
    for (std::size_t m = 0; m < 256; ++m)
        for (std::size_t z = 0; z < 8; ++z) table[8 * m + z] = (m >> z) & 1 ? alpha : 0;
    return table;
}

/// Where a leaf reads what lies beyond it: the planes before and after, the rows beside each plane
/// (64 apart), the values at the ends of each row (8 apart).
struct Surroundings {
    const double *xm, *xp, *ym, *yp, *zm, *zp;
};

/// What will be touched two leaves later. The processor's own prefetching stops at the 4 kB of a
/// leaf; asking in time is worth a factor of two.
struct Soon {
    const double *t, *xp, *yp;
    double* out;
};
constexpr std::size_t kSoon = 2;

/// One step of one leaf, [Ito2004, eq. 2], with the sums associated as in heat_row().
SEKITEI_CLONES void heat_leaf(const double* t, const Surroundings& around, const LeafMask& free,
                              const double* coefficients, double* __restrict out, const Soon& soon)
{
    const auto four = [](const double* v) -> const Four& {
        return *reinterpret_cast<const Four*>(v);
    };
    for (int x = 0; x < 8; ++x) {
        const double* before = x > 0 ? t + (x - 1) * kPlane : around.xm;
        const double* after = x < 7 ? t + (x + 1) * kPlane : around.xp;
        __builtin_prefetch(soon.xp + x * 8);
        __builtin_prefetch(soon.yp + x * kPlane);
        const std::uint64_t pattern = free.words[static_cast<std::size_t>(x)];
        for (int y = 0; y < 8; ++y) {
            const int row = x * kPlane + y * 8;
            const double* p = t + row;
            __builtin_prefetch(soon.t + row);
            __builtin_prefetch(soon.out + row, 1);
            const double* left = y > 0 ? p - 8 : around.ym + x * kPlane;
            const double* right = y < 7 ? p + 8 : around.yp + x * kPlane;
            const double* c = coefficients + 8 * (pattern >> (8 * y) & 255);
            const Four low = four(p), high = four(p + 4);
            const Four z_low = Four{around.zm[row], p[0], p[1], p[2]} + four(p + 1);
            const Four z_high = four(p + 3) + Four{p[5], p[6], p[7], around.zp[row]};
            const Four sum_low =
                ((four(before + y * 8) + four(after + y * 8)) + (four(left) + four(right))) + z_low;
            const Four sum_high = ((four(before + y * 8 + 4) + four(after + y * 8 + 4)) +
                                   (four(left + 4) + four(right + 4))) +
                                  z_high;
            *reinterpret_cast<Four*>(out + row) = low + four(c) * (sum_low - 6 * low);
            *reinterpret_cast<Four*>(out + row + 4) = high + four(c + 4) * (sum_high - 6 * high);
        }
    }
}

/// 512 doubles for each block, cache-line aligned.
class BlockBuffer {
public:
    explicit BlockBuffer(std::size_t blocks) : pool_(blocks * kLeafSize + 8)
    {
        const auto address = reinterpret_cast<std::uintptr_t>(pool_.data());
        first_ = pool_.data() + ((64 - address % 64) % 64) / sizeof(double);
    }
    BlockBuffer(BlockBuffer&& other) noexcept = default;
    double* data() { return first_; }
    const double* data() const { return first_; }

private:
    PoolBuffer<double> pool_;
    double* first_;
};

class SparseHeat final : public HeatSolver {
public:
    explicit SparseHeat(const HeatProblem& problem);

    void advance(int count, const Progress& progress) override;
    double step(const Progress& progress) override;
    int steps() const override { return steps_; }
    std::vector<double> free_values() const override;
    void set_free_values(const std::vector<double>& values) override;

private:
    /// A leaf with free voxels; its block has the same number as the leaf.
    struct Leaf {
        std::array<std::size_t, 6> face{};  // where xm xp ym yp zm zp are read, in doubles
        LeafMask free;
        std::size_t values_begin = 0;  // among free_values()
        std::uint32_t contacts_begin = 0, contacts_end = 0;
        std::array<std::int8_t, 3> last{7, 7, 7};  // last plane, row, voxel inside the domain
        std::array<std::uint32_t, 6> neighbour{};  // leaf, or kNoLeaf where values are held
    };
    struct Contact {
        int offset;
        double extra;
    };
    /// Leaves with consecutive x: what is computed between two meetings of all threads.
    struct Slab {
        std::uint32_t begin = 0, end = 0;
        std::vector<std::uint32_t> awake;
        bool sleepers = false;
    };

    void make_slabs();
    void find_sleepers();
    void wake(Slab& slab);
    void step_slab(Slab& slab, int source, bool measure);
    void step_leaf(std::uint32_t number, int source, bool measure, std::uint32_t soon);
    void copy_ghosts(const Leaf& leaf, double* block) const;

    std::vector<Leaf> leaves_;
    std::vector<Contact> contacts_;
    double air_ = 0;
    RowCoefficients coefficients_{};
    std::vector<BlockBuffer> buffers_;   // two; at even steps the first holds the present
    std::vector<std::uint8_t> awake_;    // the others are uniform and so is all around them
    std::vector<std::uint8_t> changed_;  // since the start, so that neighbours must wake
    std::vector<double> change_;
    std::vector<Slab> slabs_;
    std::size_t values_ = 0;
    int present_ = 0;
    int steps_ = 0;
    int depth_ = 1;
};

/// Bytes of both pools that a run of slabs may fill before temporal blocking stops paying.
constexpr std::size_t kCacheBytes = std::size_t(12) << 20;
/// Voxels in a block of steps that is not interrupted: about a tenth of a second.
constexpr std::size_t kUninterrupted = 50'000'000;

SparseHeat::SparseHeat(const HeatProblem& problem) : air_(problem.convection.air_temperature)
{
    const LeafGrid<double>& initial = problem.temperature;
    const LeafTopology& topology = *initial.topology();
    const std::vector<LeafMask> free = free_inside(problem);
    const std::vector<std::size_t> values_begin = free_offsets(free);
    values_ = values_begin.back();

    // Number the blocks: leaves with free voxels, then held leaves, those of one value shared.
    std::vector<std::uint32_t> block_of(initial.leaf_count(), kNoLeaf);
    std::vector<std::size_t> leaf_of;
    for (std::size_t leaf = 0; leaf < free.size(); ++leaf)
        if (!free[leaf].none()) {
            block_of[leaf] = static_cast<std::uint32_t>(leaf_of.size());
            leaf_of.push_back(leaf);
        }
    const std::size_t moving = leaf_of.size();
    std::map<double, std::uint32_t> uniform;
    std::vector<double> uniform_values;
    for (std::size_t leaf = 0; leaf < free.size(); ++leaf)
        if (free[leaf].none() && !initial.is_constant(leaf)) {
            block_of[leaf] = static_cast<std::uint32_t>(leaf_of.size());
            leaf_of.push_back(leaf);
        }
    auto uniform_block = [&](double value) {
        const auto [at, added] = uniform.try_emplace(
            value, static_cast<std::uint32_t>(leaf_of.size() + uniform_values.size()));
        if (added) uniform_values.push_back(value);
        return at->second;
    };
    for (std::size_t leaf = 0; leaf < free.size(); ++leaf)
        if (block_of[leaf] == kNoLeaf) block_of[leaf] = uniform_block(initial.constant(leaf));
    const std::uint32_t background = uniform_block(initial.background());

    // Find where each leaf reads its six sides.
    leaves_.resize(moving);
    parallel_for(
        moving,
        [&](std::size_t number) {
            Leaf& leaf = leaves_[number];
            const std::size_t at = leaf_of[number];
            const Coord origin = initial.origin(at);
            leaf.free = free[at];
            leaf.values_begin = values_begin[at];
            for (int axis = 0; axis < 3; ++axis) {
                const std::size_t stride = axis == 0 ? 64 : axis == 1 ? 8 : 1;
                leaf.last[std::size_t(axis)] = static_cast<std::int8_t>(
                    std::min(7, problem.domain.dims[axis] - 1 - origin[axis]));
                for (int sign = -1; sign <= 1; sign += 2) {
                    const auto side = static_cast<std::size_t>(2 * axis + (sign > 0));
                    Coord beyond = origin;
                    beyond[axis] += sign * kLeafEdge;
                    const bool mirror =
                        beyond[axis] < 0 || beyond[axis] >= problem.domain.dims[axis];
                    const std::uint32_t neighbour = mirror ? kNoLeaf : topology.find(beyond);
                    const std::size_t block = mirror                 ? number
                                              : neighbour == kNoLeaf ? background
                                                                     : block_of[neighbour];
                    // The neighbour's layer that faces us; our own outermost one in the mirror.
                    const std::size_t layer = (sign < 0) != mirror ? 7 : 0;
                    leaf.face[side] = block * kLeafSize + layer * stride;
                    leaf.neighbour[side] =
                        !mirror && block < moving ? static_cast<std::uint32_t>(block) : kNoLeaf;
                }
            }
        },
        256);

    coefficients_ = row_coefficients(problem.alpha);
    for (const Convection::Voxel& v : problem.convection.voxels) {
        Leaf& leaf = leaves_[block_of[v.leaf]];
        if (leaf.contacts_end == 0)
            leaf.contacts_begin = static_cast<std::uint32_t>(contacts_.size());
        contacts_.push_back({v.offset, convection_extra(problem, v.faces)});
        leaf.contacts_end = static_cast<std::uint32_t>(contacts_.size());
    }

    // Fill both buffers: held values are never written again.
    const std::size_t all = leaf_of.size() + uniform_values.size();
    for (int b = 0; b < 2; ++b) {
        buffers_.emplace_back(all);
        double* data = buffers_.back().data();
        parallel_for(
            leaf_of.size(),
            [&](std::size_t number) {
                double* block = data + number * kLeafSize;
                // Voxels outside the domain get the nearest value inside, so that a uniform leaf
                // is uniform to its last voxel.
                const Coord origin = initial.origin(leaf_of[number]);
                for (int i = 0; i < kLeafSize; ++i) {
                    const Coord c =
                        min(leaf_coord(origin, i), problem.domain.dims - Coord(1, 1, 1));
                    block[i] =
                        initial.at(leaf_of[number], leaf_origin(c) == origin ? leaf_offset(c) : i);
                }
            },
            64);
        for (std::size_t u = 0; u < uniform_values.size(); ++u)
            std::fill_n(data + (leaf_of.size() + u) * kLeafSize, kLeafSize, uniform_values[u]);
    }
    change_.assign(moving, 0);

    // Slabs of whole x layers; neighbours lie in the same slab or the ones beside it.
    constexpr std::uint32_t kLeast = 128;
    for (std::uint32_t i = 0; i < moving;) {
        std::uint32_t end = i;
        while (end < moving && end - i < kLeast) {
            const int x = initial.origin(leaf_of[end]).x;
            while (end < moving && initial.origin(leaf_of[end]).x == x) ++end;
        }
        slabs_.push_back({i, end, {}, false});
        i = end;
    }
    std::size_t widest = 1;
    for (const Slab& slab : slabs_) widest = std::max<std::size_t>(widest, slab.end - slab.begin);
    const std::size_t slab_bytes = 2 * widest * kLeafSize * sizeof(double);
    const std::size_t fitting = kCacheBytes / slab_bytes;
    if (moving * kLeafSize < kUninterrupted)
        depth_ = static_cast<int>(std::clamp<std::size_t>(fitting, 3, 10) - 2);
    find_sleepers();
}

void SparseHeat::find_sleepers()
{
    awake_.assign(leaves_.size(), 0);
    changed_.assign(leaves_.size(), 0);
    const double* data = buffers_[std::size_t(present_)].data();
    parallel_for(
        leaves_.size(),
        [&](std::size_t number) {
            const Leaf& leaf = leaves_[number];
            const double* block = data + number * kLeafSize;
            const double value = block[0];
            bool uniform =
                std::all_of(block, block + kLeafSize, [&](double v) { return v == value; });
            for (int i = 0; uniform && i < 8; ++i)
                for (int j = 0; j < 8; ++j) {
                    const auto in_x = std::size_t(i * 8 + j), in_y = std::size_t(i * 64 + j),
                               in_z = std::size_t(i * 64 + j * 8);
                    uniform =
                        uniform && data[leaf.face[0] + in_x] == value &&
                        data[leaf.face[1] + in_x] == value && data[leaf.face[2] + in_y] == value &&
                        data[leaf.face[3] + in_y] == value && data[leaf.face[4] + in_z] == value &&
                        data[leaf.face[5] + in_z] == value;
                }
            const bool exchanges = leaf.contacts_begin < leaf.contacts_end && value != air_;
            awake_[number] = !uniform || exchanges;
        },
        64);
    for (Slab& slab : slabs_) {
        slab.sleepers = true;
        wake(slab);
    }
}

void SparseHeat::wake(Slab& slab)
{
    if (!slab.sleepers) return;
    slab.sleepers = false;
    slab.awake.clear();
    for (std::uint32_t i = slab.begin; i < slab.end; ++i) {
        if (!awake_[i])
            for (const std::uint32_t n : leaves_[i].neighbour)
                if (n != kNoLeaf && changed_[n]) awake_[i] = 1;
        if (awake_[i])
            slab.awake.push_back(i);
        else
            slab.sleepers = true;
    }
}

void SparseHeat::copy_ghosts(const Leaf& leaf, double* block) const
{
    if (leaf.last[0] < 7)
        std::copy_n(block + leaf.last[0] * 64, 64, block + leaf.last[0] * 64 + 64);
    if (leaf.last[1] < 7)
        for (int x = 0; x < 8; ++x) {
            double* row = block + x * 64 + leaf.last[1] * 8;
            std::copy_n(row, 8, row + 8);
        }
    if (leaf.last[2] < 7)
        for (int row = 0; row < 64; ++row)
            block[row * 8 + leaf.last[2] + 1] = block[row * 8 + leaf.last[2]];
}

void SparseHeat::step_leaf(std::uint32_t number, int source, bool measure, std::uint32_t soon)
{
    const Leaf& leaf = leaves_[number];
    const double* from = buffers_[std::size_t(source)].data();
    const double* t = from + std::size_t(number) * kLeafSize;
    double* to = buffers_[std::size_t(1 - source)].data();
    double* out = to + std::size_t(number) * kLeafSize;
    heat_leaf(t,
              {from + leaf.face[0], from + leaf.face[1], from + leaf.face[2], from + leaf.face[3],
               from + leaf.face[4], from + leaf.face[5]},
              leaf.free, coefficients_.data(), out,
              {from + std::size_t(soon) * kLeafSize, from + leaves_[soon].face[1],
               from + leaves_[soon].face[3], to + std::size_t(soon) * kLeafSize});
    for (std::uint32_t i = leaf.contacts_begin; i < leaf.contacts_end; ++i) {
        const int v = contacts_[i].offset;
        out[v] = convected(out[v], t[v], contacts_[i].extra, air_);
    }
    if (measure) {
        double largest = 0;
        for (int i = 0; i < kLeafSize; ++i) largest = std::max(largest, std::abs(out[i] - t[i]));
        change_[number] = largest;
    }
    if (!changed_[number]) changed_[number] = !std::equal(t, t + kLeafSize, out);
    // Held voxels come out unchanged; those just outside the domain mirror those just inside.
    copy_ghosts(leaf, out);
}

void SparseHeat::step_slab(Slab& slab, int source, bool measure)
{
    wake(slab);
    parallel_for(
        slab.awake.size(),
        [&](std::size_t i) {
            step_leaf(slab.awake[i], source, measure,
                      slab.awake[std::min(i + kSoon, slab.awake.size() - 1)]);
        },
        16);
}

/// Several steps in one sweep while the values are still in the cache.
///
/// Step s of slab j follows step s of slab j - 1 and step s - 1 of slab j + 1, so it reads what it
/// needs and overwrites what nobody needs any more: every voxel takes exactly the steps it would
/// take alone.
void SparseHeat::advance(int count, const Progress& progress)
{
    const int slabs = static_cast<int>(slabs_.size());
    while (count > 0) {
        progress.check();
        const int depth = std::min(depth_, count);
        for (int front = 0; front < slabs + depth - 1; ++front) {
            if (depth_ == 1) progress.check();  // the present is whole until the step is done
            for (int s = 0; s < depth; ++s) {
                const int slab = front - s;
                if (slab >= 0 && slab < slabs)
                    step_slab(slabs_[std::size_t(slab)], (present_ + s) & 1, false);
            }
        }
        present_ = (present_ + depth) & 1;
        steps_ += depth;
        count -= depth;
    }
}

double SparseHeat::step(const Progress& progress)
{
    for (Slab& slab : slabs_) {
        progress.check();
        step_slab(slab, present_, true);
    }
    present_ = 1 - present_;
    ++steps_;
    double largest = 0;
    for (const Slab& slab : slabs_)
        for (const std::uint32_t leaf : slab.awake) largest = std::max(largest, change_[leaf]);
    return largest;
}

std::vector<double> SparseHeat::free_values() const
{
    std::vector<double> values(values_);
    const double* data = buffers_[std::size_t(present_)].data();
    parallel_for(
        leaves_.size(),
        [&](std::size_t number) {
            const double* block = data + number * kLeafSize;
            double* out = values.data() + leaves_[number].values_begin;
            leaves_[number].free.for_each([&](int i) { *out++ = block[i]; });
        },
        64);
    return values;
}

void SparseHeat::set_free_values(const std::vector<double>& values)
{
    // Both buffers, since leaves that sleep are read from either.
    parallel_for(
        leaves_.size(),
        [&](std::size_t number) {
            for (BlockBuffer& buffer : buffers_) {
                double* block = buffer.data() + number * kLeafSize;
                const double* in = values.data() + leaves_[number].values_begin;
                leaves_[number].free.for_each([&](int i) { block[i] = *in++; });
                copy_ghosts(leaves_[number], block);
            }
        },
        64);
    find_sleepers();
}

}  // namespace

std::unique_ptr<HeatSolver> dense_heat_solver(const HeatProblem& problem)
{
    return std::make_unique<DenseHeat>(problem);
}

std::unique_ptr<HeatSolver> sparse_heat_solver(const HeatProblem& problem)
{
    return std::make_unique<SparseHeat>(problem);
}

// Sobel -----------------------------------------------------------------------------------------

namespace {

constexpr int kPadded = 10;  // a leaf and one voxel on each side

/// The leaf at `origin` with one voxel around it; outside the domain the nearest voxel inside.
/// @return false, and nothing gathered, when all 27 leaves have one and the same value
bool gather_padded(const LeafGrid<double>& grid, const Domain& domain, Coord origin, double* padded)
{
    std::array<std::uint32_t, 27> leaves{};
    for (int n = 0; n < 27; ++n)
        leaves[std::size_t(n)] =
            grid.topology()->find(origin + Coord(n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1) * kLeafEdge);
    auto value_at = [&](std::uint32_t leaf, int offset) {
        return leaf == kNoLeaf ? grid.background() : grid.at(leaf, offset);
    };

    const double own = value_at(leaves[13], 0);
    bool uniform = domain_mask(domain, origin).all();
    for (const std::uint32_t leaf : leaves)
        uniform =
            uniform && (leaf == kNoLeaf || grid.is_constant(leaf)) && value_at(leaf, 0) == own;
    if (uniform) return false;

    const Coord highest = domain.dims - Coord(1, 1, 1);
    for (int x = -1; x <= kLeafEdge; ++x)
        for (int y = -1; y <= kLeafEdge; ++y)
            for (int z = -1; z <= kLeafEdge; ++z) {
                const Coord c = max(Coord(0, 0, 0), min(origin + Coord(x, y, z), highest));
                const Coord step = leaf_origin(c) - origin;
                const int n = neighbour_index(step.x >> 3, step.y >> 3, step.z >> 3);
                *padded++ = value_at(leaves[std::size_t(n)], leaf_offset(c));
            }
    return true;
}

/// The gradient at all 512 voxels of a padded leaf.
void sobel_leaf(const double* padded, Vec3d* out)
{
    constexpr int kY = kPadded, kX = kPadded * kPadded;
    double smooth[kPadded * kX], slope[kPadded * kX];  // [1 2 1] and [-1 0 1] along z
    for (int i = 1; i < kPadded * kX - 1; ++i) {
        smooth[i] = padded[i - 1] + 2 * padded[i] + padded[i + 1];
        slope[i] = padded[i + 1] - padded[i - 1];
    }
    for (int x = 1; x <= kLeafEdge; ++x)
        for (int y = 1; y <= kLeafEdge; ++y)
            for (int z = 1; z <= kLeafEdge; ++z) {
                const double* s = smooth + x * kX + y * kY + z;
                const double* d = slope + x * kX + y * kY + z;
                auto along_y = [](const double* v) { return v[-kY] + 2 * v[0] + v[kY]; };
                auto along_x = [](const double* v, int dy) {
                    return v[dy - kX] + 2 * v[dy] + v[dy + kX];
                };
                *out++ = Vec3d(along_y(s + kX) - along_y(s - kX), along_x(s, kY) - along_x(s, -kY),
                               along_y(d - kX) + 2 * along_y(d) + along_y(d + kX)) /
                         32;
            }
}

}  // namespace

LeafGrid<Vec3d> sobel_gradient(const LeafGrid<double>& temperature,
                               const LeafGrid<std::int32_t>& where, const Domain& domain)
{
    auto gradient = LeafGrid<Vec3d>::uninitialised(where.topology(), where.transform(), Vec3d());
    parallel_for(
        where.leaf_count(),
        [&](std::size_t leaf) {
            double padded[kPadded * kPadded * kPadded];
            gradient.mask(leaf) = where.mask(leaf);
            if (where.mask(leaf).none() || domain_mask(domain, where.origin(leaf)).none() ||
                !gather_padded(temperature, domain, where.origin(leaf), padded)) {
                gradient.set_constant(leaf, Vec3d());
                return;
            }
            Vec3d* out = gradient.values(leaf);
            sobel_leaf(padded, out);
            for (int i = 0; i < kLeafSize; ++i)
                if (!where.mask(leaf).test(i)) out[i] = Vec3d();
        },
        16);
    gradient.compress();
    return gradient;
}

}  // namespace sekitei
