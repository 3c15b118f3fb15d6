#include "grids/marching_tetrahedra.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

#include "core/error.h"

namespace sekitei {
namespace {

// Corners of a cell and the seven edge directions are bit sets: 4 = x, 2 = y, 1 = z. An edge is
// (lower corner, direction); its end is lower | direction.
constexpr int kWords = 8 * 7;  // crossing bits of a block: [x slab][direction - 1], 64 (y, z) each
constexpr int kEdge = kLeafEdge + 1;
constexpr std::uint64_t kLowRow = 0xFFull;                   // y = 0
constexpr std::uint64_t kLowColumn = 0x0101010101010101ull;  // z = 0

constexpr int word_index(int x, int direction)
{
    return x * 7 + direction - 1;
}

/// Index into a block's table of vertex ids: node (x, y, z) of 9^3 and a direction.
constexpr int edge_index(int x, int y, int z, int direction)
{
    return ((x * kEdge + y) * kEdge + z) * 8 + direction;
}

/// Triangles of each of the 256 ways in which the corners of a cell lie inside (bit c = corner c).
struct CellTable {
    struct Case {
        std::uint8_t count = 0;
        std::array<std::array<std::uint16_t, 3>, 12> triangles{};  // offsets as of edge_index
    };
    std::array<Case, 256> cases;

    CellTable()
    {
        constexpr int kAxes[6][3] = {{4, 2, 1}, {4, 1, 2}, {2, 4, 1},
                                     {2, 1, 4}, {1, 4, 2}, {1, 2, 4}};
        for (int inside = 0; inside < 256; ++inside)
            for (const auto& axes : kAxes)
                add_tetrahedron({0, axes[0], axes[0] | axes[1], 7}, inside,
                                cases[static_cast<std::size_t>(inside)]);
    }

private:
    static Coord position(int corner) { return {corner >> 2, (corner >> 1) & 1, corner & 1}; }

    static void add_tetrahedron(const std::array<int, 4>& corners, int inside, Case& out)
    {
        std::vector<int> in, outside;
        for (const int c : corners) ((inside >> c) & 1 ? in : outside).push_back(c);
        if (in.empty() || outside.empty()) return;
        std::vector<std::pair<int, int>> ring;  // crossed edges around the cut
        if (in.size() == 2) {
            ring = {
                {in[0], outside[0]}, {in[0], outside[1]}, {in[1], outside[1]}, {in[1], outside[0]}};
        } else {
            for (const int a : in)
                for (const int b : outside) ring.emplace_back(a, b);
        }
        // Wind the ring so that its normal points from inside to outside.
        Coord towards{};
        for (const int a : in)
            for (const int b : outside) towards += position(b) - position(a);
        auto middle = [](const std::pair<int, int>& e) {
            return position(e.first) + position(e.second);
        };
        const Coord normal =
            cross(middle(ring[1]) - middle(ring[0]), middle(ring[2]) - middle(ring[0]));
        if (dot(normal, towards) < 0) std::reverse(ring.begin(), ring.end());
        auto offset = [](const std::pair<int, int>& e) {
            const int lower = e.first & e.second, direction = e.first ^ e.second;
            const Coord p = position(lower);
            return static_cast<std::uint16_t>(edge_index(p.x, p.y, p.z, direction));
        };
        for (std::size_t k = 2; k < ring.size(); ++k)
            out.triangles[out.count++] = {offset(ring[0]), offset(ring[k - 1]), offset(ring[k])};
    }
};

/// Bit (y, z) of word x: is the voxel inside.
using InsideBits = std::array<std::uint64_t, 8>;

InsideBits inside_bits(const float* values, float iso)
{
    InsideBits bits{};
    for (std::size_t x = 0; x < 8; ++x) {
        std::array<std::uint8_t, 64> bytes;
        for (std::size_t i = 0; i < 64; ++i) bytes[i] = values[x * 64 + i] >= iso;
        for (std::size_t row = 0; row < 8; ++row) {
            // Gather eight bytes of 0 or 1 into one byte, the first lowest.
            std::uint64_t packed = 0;
            for (std::size_t i = 0; i < 8; ++i)
                packed |= std::uint64_t(bytes[row * 8 + i]) << (8 * i);
            bits[x] |= ((packed * 0x0102040810204080ull) >> 56) << (8 * row);
        }
    }
    return bits;
}

int count_bits(std::uint64_t x)
{
    x -= (x >> 1) & 0x5555555555555555ull;
    x = (x & 0x3333333333333333ull) + ((x >> 2) & 0x3333333333333333ull);
    x = (x + (x >> 4)) & 0x0F0F0F0F0F0F0F0Full;
    return static_cast<int>((x * 0x0101010101010101ull) >> 56);
}

/// Where the voxels of an 8^3 block and of its upper neighbours lie.
struct Block {
    Coord origin;
    std::array<std::uint32_t, 8> leaf{};   ///< of the topology, by corner; kNoLeaf: background
    std::array<std::uint32_t, 8> block{};  ///< of the list of blocks, by corner
    std::array<std::uint64_t, kWords> crossing{};
    std::array<std::uint16_t, kWords> before{};  ///< crossings of the block ahead of each word
    std::uint32_t vertices = 0, triangles = 0;
    std::uint64_t first_vertex = 0, first_triangle = 0;
};

class Extraction {
public:
    Extraction(const FloatGrid& field, double iso, const Transform& transform,
               const Progress& progress)
        : field_(field),
          topology_(*field.topology()),
          transform_(transform),
          progress_(progress),
          iso_(iso)
    {
        // value >= iso for doubles is value >= the least float not below iso.
        float_iso_ = static_cast<float>(iso);
        if (static_cast<double>(float_iso_) < iso)
            float_iso_ = std::nextafter(float_iso_, std::numeric_limits<float>::infinity());
        background_inside_ = field.background() >= float_iso_;
    }

    TriMesh run()
    {
        static const CellTable table;
        classify();
        find_blocks();
        progress_.update(0.3);
        parallel_for(
            blocks_.size(), [&](std::size_t b) { count(blocks_[b], table); }, 16);
        progress_.update(0.5);
        std::uint64_t vertices = 0, triangles = 0;
        for (Block& block : blocks_) {
            block.first_vertex = vertices;
            block.first_triangle = triangles;
            vertices += block.vertices;
            triangles += block.triangles;
        }
        if (vertices > std::numeric_limits<std::uint32_t>::max())
            throw LimitExceeded(
                fmt::format("marching tetrahedra: the surface has {} vertices, a mesh holds at "
                            "most 4294967295; use a larger voxel",
                            vertices));
        TriMesh mesh;
        mesh.vertices.resize(vertices);
        mesh.triangles.resize(triangles);
        parallel_for_range(
            blocks_.size(),
            [&](std::size_t begin, std::size_t end) {
                std::vector<float> values(kEdge * kEdge * kEdge);
                std::vector<std::uint32_t> ids(kEdge * kEdge * kEdge * 8);
                for (std::size_t b = begin; b != end; ++b) {
                    progress_.check();
                    emit(blocks_[b], table, values.data(), ids.data(), mesh);
                }
            },
            16);
        progress_.update(1);
        return mesh;
    }

private:
    enum Side : std::uint8_t { Outside, Inside, Mixed };

    Side background_side() const { return background_inside_ ? Inside : Outside; }
    Side side(std::uint32_t leaf) const
    {
        return leaf == kNoLeaf ? background_side() : sides_[leaf];
    }
    InsideBits bits(std::uint32_t leaf) const
    {
        if (leaf != kNoLeaf && sides_[leaf] == Mixed) return bits_[leaf];
        InsideBits all;
        all.fill(side(leaf) == Inside ? ~0ull : 0);
        return all;
    }

    /// Find on which side of iso each leaf lies, voxel by voxel where it is on both.
    void classify()
    {
        sides_.resize(topology_.size());
        bits_.resize(topology_.size());
        parallel_for_range(
            topology_.size(),
            [&](std::size_t begin, std::size_t end) {
                progress_.check();
                for (std::size_t i = begin; i != end; ++i) {
                    const float* values = field_.values(i);
                    if (!values) {
                        sides_[i] = field_.constant(i) >= float_iso_ ? Inside : Outside;
                        continue;
                    }
                    const InsideBits own = inside_bits(values, float_iso_);
                    std::uint64_t any = 0, all = ~0ull;
                    for (const std::uint64_t w : own) {
                        any |= w;
                        all &= w;
                    }
                    sides_[i] = any == 0 ? Outside : all == ~0ull ? Inside : Mixed;
                    if (sides_[i] == Mixed) bits_[i] = own;
                }
            },
            64);
    }

    static Coord corner_offset(int corner)
    {
        return Coord((corner >> 2) & 1, (corner >> 1) & 1, corner & 1) * kLeafEdge;
    }

    /// List the blocks whose cells (lower corner in the block) may cross the surface: leaves, and
    /// places without a leaf just below one.
    void find_blocks()
    {
        const std::size_t leaves = topology_.size();
        // 1: the leaf is a block. Bit k of below: the place a step k below has no leaf and is one.
        std::vector<std::uint8_t> is_block(leaves, 0), below(leaves, 0);
        parallel_for_range(
            leaves,
            [&](std::size_t begin, std::size_t end) {
                progress_.check();
                for (std::size_t i = begin; i != end; ++i) {
                    const Coord o = topology_.origin(i);
                    const Side own = sides_[i];
                    bool mixed = own == Mixed;
                    for (int k = 1; k < 8 && !mixed; ++k)
                        mixed = side(topology_.find(o + corner_offset(k))) != own;
                    is_block[i] = mixed;
                    if (own == background_side()) continue;
                    for (int k = 1; k < 8; ++k)
                        if (topology_.find(o - corner_offset(k)) == kNoLeaf)
                            below[i] = static_cast<std::uint8_t>(below[i] | (1 << k));
                }
            },
            64);
        std::vector<Coord> origins;
        for (std::size_t i = 0; i < leaves; ++i) {
            if (is_block[i]) origins.push_back(topology_.origin(i));
            for (int k = 1; below[i] >> k; ++k)
                if ((below[i] >> k) & 1) origins.push_back(topology_.origin(i) - corner_offset(k));
        }
        const auto order = LeafTopology::build(std::move(origins));
        blocks_.resize(order->size());
        parallel_for(
            order->size(),
            [&](std::size_t b) {
                Block& block = blocks_[b];
                block.origin = order->origin(b);
                for (int k = 0; k < 8; ++k) {
                    const auto slot = static_cast<std::size_t>(k);
                    block.leaf[slot] = topology_.find(block.origin + corner_offset(k));
                    block.block[slot] = order->find(block.origin + corner_offset(k));
                }
            },
            64);
    }

    /// The inside bits of slabs x = 0..8 of a block, for the voxel itself and one up in z, y, yz.
    using Slabs = std::array<std::array<std::uint64_t, 9>, 4>;
    Slabs slabs(const Block& block) const
    {
        Slabs s;
        std::array<InsideBits, 8> around;
        for (std::size_t k = 0; k < 8; ++k) around[k] = bits(block.leaf[k]);
        for (std::size_t x = 0; x < 9; ++x) {
            const std::size_t half = x < 8 ? 0 : 4, slab = x < 8 ? x : 0;
            const std::uint64_t here = around[half][slab], z = around[half | 1][slab],
                                y = around[half | 2][slab], yz = around[half | 3][slab];
            auto up_z = [](std::uint64_t w, std::uint64_t next) {
                return ((w >> 1) & ~(kLowColumn << 7)) | ((next & kLowColumn) << 7);
            };
            s[0][x] = here;
            s[1][x] = up_z(here, z);
            s[2][x] = (here >> 8) | (y << 56);
            s[3][x] = up_z(s[2][x], (z >> 8) | (yz << 56));
        }
        return s;
    }

    /// Cells with corners on both sides, as bits (y, z) of slab x.
    static std::uint64_t mixed_cells(const Slabs& s, std::size_t x)
    {
        std::uint64_t any = 0, all = ~0ull;
        for (std::size_t k = 0; k < 8; ++k) {
            any |= s[k & 3][x + (k >> 2)];
            all &= s[k & 3][x + (k >> 2)];
        }
        return any & ~all;
    }

    static std::size_t cell_case(const Slabs& s, std::size_t x, int bit)
    {
        std::size_t c = 0;
        for (std::size_t k = 0; k < 8; ++k) c |= ((s[k & 3][x + (k >> 2)] >> bit) & 1) << k;
        return c;
    }

    void count(Block& block, const CellTable& table) const
    {
        progress_.check();
        const Slabs s = slabs(block);
        int vertices = 0;
        std::uint32_t triangles = 0;
        for (std::size_t x = 0; x < 8; ++x) {
            for (std::size_t d = 1; d < 8; ++d) {
                const std::size_t word = x * 7 + d - 1;
                const std::uint64_t crossing = s[0][x] ^ s[d & 3][x + (d >> 2)];
                block.crossing[word] = crossing;
                block.before[word] = static_cast<std::uint16_t>(vertices);
                vertices += count_bits(crossing);
            }
            for (std::uint64_t cells = mixed_cells(s, x); cells; cells &= cells - 1)
                triangles += table.cases[cell_case(s, x, std::countr_zero(cells))].count;
        }
        block.vertices = static_cast<std::uint32_t>(vertices);
        block.triangles = triangles;
    }

    void emit(const Block& block, const CellTable& table, float* values, std::uint32_t* ids,
              TriMesh& mesh) const
    {
        if (block.vertices == 0 && block.triangles == 0) return;
        gather(block, values);

        // Place a vertex on each crossing edge that the block owns.
        auto id = static_cast<std::uint32_t>(block.first_vertex);
        for (int x = 0; x < 8; ++x)
            for (int d = 1; d < 8; ++d) {
                const Vec3d direction(d >> 2, (d >> 1) & 1, d & 1);
                const int step = ((d >> 2) * kEdge + ((d >> 1) & 1)) * kEdge + (d & 1);
                std::uint64_t w = block.crossing[static_cast<std::size_t>(word_index(x, d))];
                for (; w; w &= w - 1) {
                    const int bit = std::countr_zero(w), y = bit >> 3, z = bit & 7;
                    const int node = (x * kEdge + y) * kEdge + z;
                    const double a = values[node], b = values[node + step];
                    const double t = (iso_ - a) / (b - a);
                    constexpr double kLeast = 1e-3;
                    const double s = t > kLeast ? (t < 1 - kLeast ? t : 1 - kLeast) : kLeast;
                    const Vec3d p = centre_of(block.origin + Coord(x, y, z)) + direction * s;
                    mesh.vertices[id] = Vec3f(transform_.world(p));
                    ids[node * 8 + d] = id++;
                }
            }
        // Look up those on the block's upper faces, which the blocks above own.
        for (int side = 1; side < 7; ++side) {
            const std::uint32_t above = block.block[static_cast<std::size_t>(side)];
            if (above != kNoLeaf) look_up(blocks_[above], side, ids);
        }

        const Slabs s = slabs(block);
        std::uint64_t triangle = block.first_triangle;
        for (std::size_t x = 0; x < 8; ++x)
            for (std::uint64_t cells = mixed_cells(s, x); cells; cells &= cells - 1) {
                const int bit = std::countr_zero(cells);
                const CellTable::Case& c = table.cases[cell_case(s, x, bit)];
                const std::uint32_t* cell =
                    ids + edge_index(static_cast<int>(x), bit >> 3, bit & 7, 0);
                for (std::size_t k = 0; k < c.count; ++k) {
                    const auto& t = c.triangles[k];
                    mesh.triangles[triangle++] = {cell[t[0]], cell[t[1]], cell[t[2]]};
                }
            }
    }

    /// The 9^3 values of a block's nodes.
    void gather(const Block& block, float* values) const
    {
        for (int corner = 0; corner < 8; ++corner) {
            const std::uint32_t leaf = block.leaf[static_cast<std::size_t>(corner)];
            const float* source = leaf == kNoLeaf ? nullptr : field_.values(leaf);
            const float constant = leaf == kNoLeaf ? field_.background()
                                   : source        ? 0.0f
                                                   : field_.constant(leaf);
            const int nx = corner & 4 ? 1 : 8, ny = corner & 2 ? 1 : 8, nz = corner & 1 ? 1 : 8;
            for (int x = 0; x < nx; ++x)
                for (int y = 0; y < ny; ++y) {
                    float* row =
                        values +
                        ((x + (corner & 4 ? 8 : 0)) * kEdge + y + (corner & 2 ? 8 : 0)) * kEdge +
                        (corner & 1 ? 8 : 0);
                    if (source)
                        std::copy_n(source + x * 64 + y * 8, nz, row);
                    else
                        std::fill_n(row, nz, constant);
                }
        }
    }

    /// Ids of the edges of `above` that lie in the upper face (edge, corner) of the block below.
    static void look_up(const Block& above, int side, std::uint32_t* ids)
    {
        const int slabs = side & 4 ? 1 : 8;
        const std::uint64_t part = (side & 2 ? kLowRow : ~0ull) & (side & 1 ? kLowColumn : ~0ull);
        for (int d = 1; d < 8; ++d) {
            if (d & side) continue;  // leaves the block
            for (int x = 0; x < slabs; ++x) {
                const auto word = static_cast<std::size_t>(word_index(x, d));
                const std::uint64_t crossing = above.crossing[word];
                for (std::uint64_t w = crossing & part; w; w &= w - 1) {
                    const int bit = std::countr_zero(w);
                    const int rank = count_bits(crossing & ((1ull << bit) - 1));
                    ids[edge_index(x + (side & 4 ? 8 : 0), (bit >> 3) + (side & 2 ? 8 : 0),
                                   (bit & 7) + (side & 1 ? 8 : 0), d)] =
                        static_cast<std::uint32_t>(above.first_vertex) + above.before[word] +
                        static_cast<std::uint32_t>(rank);
                }
            }
        }
    }

    const FloatGrid& field_;
    const LeafTopology& topology_;
    const Transform& transform_;
    const Progress& progress_;
    double iso_;
    float float_iso_ = 0;
    bool background_inside_ = false;
    std::vector<Side> sides_;
    std::vector<InsideBits> bits_;
    std::vector<Block> blocks_;
};

}  // namespace

TriMesh marching_tetrahedra(const FloatGrid& field, double iso, const Progress& progress)
{
    return marching_tetrahedra(field, iso, field.transform(), progress);
}

TriMesh marching_tetrahedra(const FloatGrid& field, double iso, const Transform& transform,
                            const Progress& progress)
{
    return Extraction(field, iso, transform, progress).run();
}

}  // namespace sekitei
