#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <vector>

namespace sekitei::forest {

/// Values of the pixels of a forest, i eastwards, j northwards. Blocks of equal values take no
/// memory of their own.
template <class T>
class Raster {
public:
    static constexpr int kEdge = 64;  ///< of a block [pixels]

    Raster() = default;
    Raster(int width, int depth, T value)
        : width_(width), depth_(depth), across_((width + kEdge - 1) / kEdge)
    {
        blocks_.resize(std::size_t(across_) * std::size_t((depth + kEdge - 1) / kEdge),
                       {value, {}});
    }

    int width() const { return width_; }
    int depth() const { return depth_; }
    bool empty() const { return blocks_.empty(); }

    T at(int i, int j) const
    {
        const Block& block = blocks_[place(i, j)];
        return block.values.empty() ? block.constant : block.values[inside(i, j)];
    }
    void set(int i, int j, T value)
    {
        Block& block = blocks_[place(i, j)];
        if (block.values.empty()) {
            if (block.constant == value) return;
            block.values.assign(std::size_t(kEdge) * kEdge, block.constant);
        }
        block.values[inside(i, j)] = value;
    }
    /// Puts f(value) in place of every value.
    template <class F>
    void transform(F&& f)
    {
        for (Block& block : blocks_) {
            block.constant = f(block.constant);
            for (T& value : block.values) value = f(value);
        }
    }
    /// Drops the values of blocks that have only one.
    void compress()
    {
        for (std::size_t k = 0; k < blocks_.size(); ++k) {
            Block& block = blocks_[k];
            if (block.values.empty()) continue;
            // Blocks at the borders reach beyond them.
            const auto row = static_cast<int>(k) / across_, column = static_cast<int>(k) % across_;
            const auto wide = std::min(kEdge, width_ - column * kEdge);
            const auto deep = std::min(kEdge, depth_ - row * kEdge);
            const T first = block.values.front();
            bool same = true;
            for (int j = 0; j < deep && same; ++j) {
                const auto begin = block.values.begin() + j * kEdge;
                same = std::all_of(begin, begin + wide, [&](const T& v) { return v == first; });
            }
            if (same) {
                block.constant = first;
                std::vector<T>().swap(block.values);  // `= {}` would keep the memory
            }
        }
    }
    friend bool operator==(const Raster& a, const Raster& b)
    {
        if (a.width_ != b.width_ || a.depth_ != b.depth_) return false;
        for (int j = 0; j < a.depth_; ++j)
            for (int i = 0; i < a.width_; ++i)
                if (a.at(i, j) != b.at(i, j)) return false;
        return true;
    }
    /// Whether all of [i0, i1) x [j0, j1) lies in blocks of one value, the same; then `value` is
    /// it.
    bool constant(int i0, int i1, int j0, int j1, T& value) const
    {
        value = blocks_[place(i0, j0)].constant;
        for (int j = j0; j < j1; j = (j / kEdge + 1) * kEdge)
            for (int i = i0; i < i1; i = (i / kEdge + 1) * kEdge) {
                const Block& block = blocks_[place(i, j)];
                if (!block.values.empty() || block.constant != value) return false;
            }
        return true;
    }
    std::size_t memory_bytes() const
    {
        std::size_t bytes = blocks_.size() * sizeof(Block);
        for (const Block& block : blocks_) bytes += block.values.size() * sizeof(T);
        return bytes;
    }

private:
    struct Block {
        T constant{};
        std::vector<T> values;
    };
    std::size_t place(int i, int j) const
    {
        return std::size_t(j / kEdge) * std::size_t(across_) + std::size_t(i / kEdge);
    }
    static std::size_t inside(int i, int j)
    {
        return std::size_t(j % kEdge) * kEdge + std::size_t(i % kEdge);
    }

    int width_ = 0, depth_ = 0, across_ = 0;
    std::vector<Block> blocks_;
};

}  // namespace sekitei::forest
