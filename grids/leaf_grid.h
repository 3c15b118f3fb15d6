#pragma once

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <utility>
#include <vector>

#include "core/parallel.h"
#include "grids/leaf_topology.h"
#include "grids/transform.h"

/// The leaf pool: sparse values for the hot loops.
///
/// A grid is a topology (which 8^3 leaves there are) and, for each leaf, either 512 values in one
/// contiguous pool or a single constant. A ValueAccessor loop runs at 1/60 of a dense loop; loops
/// over these blocks run at the speed of dense ones. VDB files are written from and read into this
/// form (grids/vdb_file.h); nothing here needs OpenVDB's headers.
namespace sekitei {

/// Which of a leaf's 512 voxels are active; bit i of word w is offset 64 w + i.
struct LeafMask {
    std::array<std::uint64_t, 8> words{};

    bool test(int offset) const
    {
        return (words[static_cast<std::size_t>(offset >> 6)] >> (offset & 63)) & 1;
    }
    void set(int offset) { words[static_cast<std::size_t>(offset >> 6)] |= 1ull << (offset & 63); }
    void reset(int offset)
    {
        words[static_cast<std::size_t>(offset >> 6)] &= ~(1ull << (offset & 63));
    }
    int count() const
    {
        int n = 0;
        for (const std::uint64_t w : words) n += std::popcount(w);
        return n;
    }
    bool all() const { return count() == kLeafSize; }
    bool none() const { return count() == 0; }
    static LeafMask full()
    {
        LeafMask m;
        m.words.fill(~0ull);
        return m;
    }
    /// Calls f(offset) for each active voxel, in order.
    template <class F>
    void for_each(F&& f) const
    {
        for (int w = 0; w < 8; ++w)
            for (std::uint64_t bits = words[static_cast<std::size_t>(w)]; bits; bits &= bits - 1)
                f(w * 64 + std::countr_zero(bits));
    }
    friend bool operator==(const LeafMask&, const LeafMask&) = default;
};

/// A growable block of trivially copyable values whose untouched pages cost nothing.
template <class T>
class PoolBuffer {
    static_assert(std::is_trivially_copyable_v<T>);

public:
    PoolBuffer() = default;
    explicit PoolBuffer(std::size_t count) { resize(count); }
    PoolBuffer(const PoolBuffer& other) : PoolBuffer(other.size_)
    {
        if (size_) std::memcpy(static_cast<void*>(data_), other.data_, size_ * sizeof(T));
    }
    PoolBuffer(PoolBuffer&& other) noexcept
        : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0))
    {
    }
    PoolBuffer& operator=(PoolBuffer other) noexcept
    {
        std::swap(data_, other.data_);
        std::swap(size_, other.size_);
        return *this;
    }
    ~PoolBuffer() { std::free(data_); }

    /// Keeps the first min(old, new) values; new ones are not initialised.
    void resize(std::size_t count)
    {
        if (count == 0) {
            std::free(data_);
            data_ = nullptr;
        } else {
            void* moved = std::realloc(static_cast<void*>(data_), count * sizeof(T));
            if (!moved) throw std::bad_alloc();
            data_ = static_cast<T*>(moved);
            if (count > size_) prefer_large_pages(moved, count * sizeof(T));
        }
        size_ = count;
    }

    std::size_t size() const { return size_; }
    T* data() { return data_; }
    const T* data() const { return data_; }

private:
    T* data_ = nullptr;
    std::size_t size_ = 0;
};

/// A sparse grid over a leaf topology. See the file comment.
///
/// Voxels outside every leaf have the background value and are inactive. Inactive voxels inside a
/// leaf have whatever value is stored for them (level sets: plus or minus the background).
template <class T>
class LeafGrid {
public:
    using Value = T;

    LeafGrid() : topology_(LeafTopology::build({})) {}

    /// Every leaf constant with `background` and inactive.
    LeafGrid(TopologyPtr topology, Transform transform, T background)
        : topology_(std::move(topology)),
          transform_(transform),
          background_(background),
          slots_(topology_->size(), kConstant),
          constants_(topology_->size(), background),
          masks_(topology_->size())
    {
    }

    /// Every leaf with its own 512 uninitialised values (slot = leaf index) and an empty mask: what
    /// parallel writers fill before compress().
    static LeafGrid uninitialised(TopologyPtr topology, Transform transform, T background)
    {
        LeafGrid grid(std::move(topology), transform, background);
        grid.pool_.resize(grid.leaf_count() * kLeafSize);
        for (std::size_t i = 0; i < grid.leaf_count(); ++i)
            grid.slots_[i] = static_cast<std::uint32_t>(i);
        return grid;
    }

    /// Leaves whose `dense` is not 0 have 512 uninitialised values of their own; the others are
    /// constant with `background`. All masks are empty.
    static LeafGrid partly_dense(TopologyPtr topology, Transform transform, T background,
                                 const std::vector<std::uint8_t>& dense)
    {
        LeafGrid grid(std::move(topology), transform, background);
        std::uint32_t next = 0;
        for (std::size_t i = 0; i < dense.size(); ++i)
            if (dense[i]) grid.slots_[i] = next++;
        grid.pool_.resize(std::size_t(next) * kLeafSize);
        return grid;
    }

    const TopologyPtr& topology() const { return topology_; }
    const Transform& transform() const { return transform_; }
    void set_transform(const Transform& transform) { transform_ = transform; }
    T background() const { return background_; }
    void set_background(T background) { background_ = background; }

    std::size_t leaf_count() const { return topology_->size(); }
    Coord origin(std::size_t leaf) const { return topology_->origin(leaf); }

    /// The 512 values of a leaf, or null if it is constant.
    T* values(std::size_t leaf)
    {
        return is_constant(leaf) ? nullptr : pool_.data() + std::size_t(slots_[leaf]) * kLeafSize;
    }
    const T* values(std::size_t leaf) const
    {
        return is_constant(leaf) ? nullptr : pool_.data() + std::size_t(slots_[leaf]) * kLeafSize;
    }
    bool is_constant(std::size_t leaf) const { return slots_[leaf] == kConstant; }
    T constant(std::size_t leaf) const { return constants_[leaf]; }

    /// Makes a leaf constant; its pool values are dropped by the next compress().
    void set_constant(std::size_t leaf, T value)
    {
        slots_[leaf] = kConstant;
        constants_[leaf] = value;
    }

    LeafMask& mask(std::size_t leaf) { return masks_[leaf]; }
    const LeafMask& mask(std::size_t leaf) const { return masks_[leaf]; }

    /// Value at an offset of a leaf, constant or not.
    T at(std::size_t leaf, int offset) const
    {
        return is_constant(leaf)
                   ? constants_[leaf]
                   : pool_.data()[std::size_t(slots_[leaf]) * kLeafSize + std::size_t(offset)];
    }

    /// Value at any voxel: one hash look-up. For loops use leaves and their neighbours.
    T value(Coord c) const
    {
        const std::uint32_t leaf = topology_->find(leaf_origin(c));
        return leaf == kNoLeaf ? background_ : at(leaf, leaf_offset(c));
    }
    bool active(Coord c) const
    {
        const std::uint32_t leaf = topology_->find(leaf_origin(c));
        return leaf != kNoLeaf && masks_[leaf].test(leaf_offset(c));
    }

    /// Gives every constant leaf its own 512 values.
    void expand()
    {
        std::vector<std::size_t> constants;
        for (std::size_t i = 0; i < leaf_count(); ++i)
            if (is_constant(i)) constants.push_back(i);
        expand(constants);
    }

    /// Gives these constant leaves (no repeats) their own 512 values, equal to the constant.
    void expand(const std::vector<std::size_t>& constants)
    {
        const std::size_t used = pool_.size() / kLeafSize;
        pool_.resize((used + constants.size()) * kLeafSize);
        parallel_for(
            constants.size(),
            [&](std::size_t k) {
                std::fill_n(pool_.data() + (used + k) * kLeafSize, kLeafSize,
                            constants_[constants[k]]);
                slots_[constants[k]] = static_cast<std::uint32_t>(used + k);
            },
            64);
    }

    /// Turns leaves of 512 equal values whose mask is full or empty into constants and packs the
    /// pool in leaf order. Afterwards the representation is a function of values and masks alone.
    void compress()
    {
        parallel_for(
            leaf_count(),
            [&](std::size_t i) {
                const T* v = values(i);
                if (!v || !(masks_[i].all() || masks_[i].none())) return;
                if (std::all_of(v + 1, v + kLeafSize,
                                [&](const T& x) { return same_bits(x, v[0]); }))
                    set_constant(i, v[0]);
            },
            64);
        // Constant leaves with a partial mask need values of their own (VDB has no such tile).
        std::vector<std::size_t> partial;
        std::size_t dense = 0;
        bool ordered = true;
        std::uint32_t last = 0;
        for (std::size_t i = 0; i < leaf_count(); ++i) {
            if (is_constant(i)) {
                if (!masks_[i].all() && !masks_[i].none()) partial.push_back(i);
                continue;
            }
            ordered = ordered && (dense == 0 || slots_[i] > last);
            last = slots_[i];
            ++dense;
        }
        if (partial.empty() && ordered) {  // slots ascend: pack in place
            std::uint32_t next = 0;
            for (std::size_t i = 0; i < leaf_count(); ++i) {
                if (is_constant(i)) continue;
                if (slots_[i] != next)
                    std::memmove(static_cast<void*>(pool_.data() + std::size_t(next) * kLeafSize),
                                 pool_.data() + std::size_t(slots_[i]) * kLeafSize,
                                 kLeafSize * sizeof(T));
                slots_[i] = next++;
            }
            pool_.resize(dense * kLeafSize);
            return;
        }
        PoolBuffer<T> packed((dense + partial.size()) * kLeafSize);
        std::uint32_t next = 0;
        for (std::size_t i = 0; i < leaf_count(); ++i) {
            if (is_constant(i) && (masks_[i].all() || masks_[i].none())) continue;
            T* target = packed.data() + std::size_t(next) * kLeafSize;
            if (const T* v = values(i))
                std::memcpy(static_cast<void*>(target), v, kLeafSize * sizeof(T));
            else
                std::fill_n(target, kLeafSize, constants_[i]);
            slots_[i] = next++;
        }
        pool_ = std::move(packed);
    }

    std::uint64_t active_count() const
    {
        std::uint64_t n = 0;
        for (const LeafMask& m : masks_) n += static_cast<std::uint64_t>(m.count());
        return n;
    }
    std::size_t dense_leaf_count() const { return pool_.size() / kLeafSize; }
    std::size_t memory_bytes() const
    {
        return pool_.size() * sizeof(T) +
               leaf_count() * (sizeof(T) + sizeof(LeafMask) + 4 + sizeof(Coord));
    }

private:
    static constexpr std::uint32_t kConstant = 0xFFFFFFFFu;
    static bool same_bits(const T& a, const T& b) { return std::memcmp(&a, &b, sizeof(T)) == 0; }

    TopologyPtr topology_;
    Transform transform_;
    T background_{};
    std::vector<std::uint32_t> slots_;  // index into the pool in leaves, or kConstant
    std::vector<T> constants_;
    std::vector<LeafMask> masks_;
    PoolBuffer<T> pool_;
};

using FloatGrid = LeafGrid<float>;
using IntGrid = LeafGrid<std::int32_t>;
using VectorGrid = LeafGrid<Vec3f>;

/// Random access that remembers the last leaf; one per thread.
template <class T>
class GridReader {
public:
    explicit GridReader(const LeafGrid<T>& grid) : grid_(&grid) {}

    T value(Coord c)
    {
        const Coord o = leaf_origin(c);
        if (!(o == last_origin_) || !known_) {
            last_ = grid_->topology()->find(o);
            last_origin_ = o;
            known_ = true;
        }
        return last_ == kNoLeaf ? grid_->background() : grid_->at(last_, leaf_offset(c));
    }
    bool active(Coord c)
    {
        value(c);
        return last_ != kNoLeaf && grid_->mask(last_).test(leaf_offset(c));
    }

    /// Trilinear interpolation at p in voxel units (centres at a + 0.5).
    T sample(Vec3d p) requires(!std::is_integral_v<T>)
    {
        const Vec3d u = p - Vec3d(0.5);
        const Vec3d base{std::floor(u.x), std::floor(u.y), std::floor(u.z)};
        const Vec3d f = u - base;
        const Coord c(static_cast<int>(base.x), static_cast<int>(base.y), static_cast<int>(base.z));
        auto mix = [](const T& a, const T& b, double t) {
            return a * static_cast<float>(1 - t) + b * static_cast<float>(t);
        };
        T plane[2];
        for (int i = 0; i < 2; ++i) {
            T row[2];
            for (int j = 0; j < 2; ++j)
                row[j] = mix(value(c + Coord(i, j, 0)), value(c + Coord(i, j, 1)), f.z);
            plane[i] = mix(row[0], row[1], f.y);
        }
        return mix(plane[0], plane[1], f.x);
    }

private:
    const LeafGrid<T>* grid_;
    Coord last_origin_{};
    std::uint32_t last_ = kNoLeaf;
    bool known_ = false;
};

}  // namespace sekitei
