#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"
#include "grids/scene.h"

/// The VDB file format, versions 222 to 224, with every length checked.
///
/// OpenVDB 10's own reader trusts what it reads: a flipped bit can make it crash, spin or fill the
/// memory. Grids that Sekitei computes with (float, int32, vec3s in 8^3 leaves) are therefore
/// decoded here, straight from the file's bytes into a LeafGrid and back, without a second copy in
/// memory and on all cores. Grids of other types are carried as bytes. The tests hold this code
/// against OpenVDB in both directions.
namespace sekitei::vdb {

inline constexpr std::uint64_t kMagic = 0x56444220;
inline constexpr std::uint32_t kOldestVersion = 222, kNewestVersion = 224;
inline constexpr std::size_t kUuidPosition = 21, kUuidLength = 36;
inline constexpr const char* kPointType = "Tree_ptdataidx32_5_4_3";

/// A metadata value as stored: its type's name and its bytes.
struct Meta {
    std::string type, value;
};
using MetaTable = std::map<std::string, Meta>;

Meta text_meta(std::string_view text);
template <class T>
Meta value_meta(std::string type, const T& value)
{
    return {std::move(type), std::string(reinterpret_cast<const char*>(&value), sizeof value)};
}
/// Text, numbers and vectors as JSON; null for other types.
Json meta_json(const Meta& meta);
/// The text of an entry, empty if it is missing or no text.
std::string meta_text(const MetaTable& table, const std::string& name);

/// Where index space lies in the world.
struct Map {
    enum class Kind { Uniform, NotUniform, Frustum };
    Kind kind = Kind::Uniform;
    std::string type;   ///< "UniformScaleTranslateMap" ...
    std::string bytes;  ///< as stored, type included
    Vec3d scale{1}, translation;
};

/// A grid as the file holds it.
struct RawGrid {
    std::string type;  ///< "Tree_float_5_4_3"; without the suffix for half floats
    bool half = false;
    std::uint32_t compression = 0;
    MetaTable meta;
    std::string map, topology, buffers;
    std::uint64_t memory = 0;  ///< bytes of the leaves' values once read; set by encode_tree()
};

/// A grid's descriptor and what precedes its tree.
struct Entry {
    std::string name;    ///< without the suffix that makes equal names unique
    std::string unique;  ///< as stored
    std::string shown;   ///< "density", or "density[1]" where several have this name
    std::string type;
    bool half = false;
    std::string parent;  ///< unique name of the grid whose tree this one shares
    std::uint64_t descriptor = 0, begin = 0, blocks = 0, end = 0;  ///< positions in the file
    std::uint32_t compression = 0;
    MetaTable meta;
    Map map;
    std::uint64_t tree = 0;        ///< position of the topology
    std::uint64_t bytes_hash = 0;  ///< position of the text of `sekitei:bytes`, 0 if absent
};

struct Header {
    std::uint32_t version = 0, library_major = 0, library_minor = 0;
    std::string uuid;
    MetaTable meta;
    std::vector<Entry> grids;
};

/// Checks everything that can be checked without reading values.
/// @throws InvalidInput  empty, not a VDB, truncated, version, damaged
Header parse_header(std::string_view bytes, const std::string& file);

/// What stands before the grids, with a UUID of zeros.
std::string encode_header(const MetaTable& meta, std::size_t grid_count);
std::string encode_descriptor(const std::string& name, const RawGrid& grid, std::uint64_t position);
/// Compression flags, metadata and map: what stands before the topology.
std::string encode_front(const RawGrid& grid);
std::string encode_map(const Transform& transform);

/// Copies a grid out of the file; a tree shared with another grid is copied with it.
RawGrid extract(std::string_view bytes, const Header& header, const Entry& entry);

/// The UUID of a file with these bytes: "53656b69-7465-8..." ("Sekite", version 8: custom) and 72
/// bits of a hash of everything else.
std::string content_uuid(std::string_view head, std::string_view tail);
std::string uuid_from_hash(const std::string& hex);
/// Whether Sekitei wrote this UUID; a few flipped bits in it do not hide that.
bool is_own_uuid(std::string_view uuid);

/// @param memory  bytes the grid may take
/// @throws InvalidInput   the tree is damaged
/// @throws LimitExceeded  tiles or leaves need more than `memory`
template <class T>
LeafGrid<T> decode_tree(std::string_view bytes, const Header& header, const Entry& entry,
                        const Transform& transform, const std::string& where, double memory,
                        const Progress& progress = {});

/// Type, compression, map, topology and buffers; metadata stays empty. Constant leaves become
/// tiles, 16^3 and 32^3 equal tiles one larger tile. Inactive -0 is written as +0.
template <class T>
RawGrid encode_tree(const LeafGrid<T>& grid, bool half, const Progress& progress = {});

/// The values a file with 16-bit floats gives back.
template <class T>
LeafGrid<T> truncated_to_half(const LeafGrid<T>& grid);

template <class T>
constexpr const char* tree_type();
template <>
constexpr const char* tree_type<float>()
{
    return "Tree_float_5_4_3";
}
template <>
constexpr const char* tree_type<std::int32_t>()
{
    return "Tree_int32_5_4_3";
}
template <>
constexpr const char* tree_type<Vec3f>()
{
    return "Tree_vec3s_5_4_3";
}

/// What a leaf comes to, whichever way it is represented.
enum class LeafKind : std::uint8_t { Empty, Tile, Dense };
template <class T>
LeafKind leaf_kind(const LeafGrid<T>& grid, std::size_t leaf);

/// Inactive zeros have no sign in a VDB file.
inline float without_sign_of_zero(float x)
{
    return x + 0.0f;
}
inline std::int32_t without_sign_of_zero(std::int32_t x)
{
    return x;
}
inline Vec3f without_sign_of_zero(Vec3f v)
{
    return {v.x + 0.0f, v.y + 0.0f, v.z + 0.0f};
}

}  // namespace sekitei::vdb

namespace sekitei {

struct ForeignGrid {
    vdb::RawGrid raw;
    std::uint64_t active = 0;
};

}  // namespace sekitei
