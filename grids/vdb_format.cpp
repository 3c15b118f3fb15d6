#include "grids/vdb_format.h"

#include <blosc.h>
#include <fmt/format.h>
#include <openvdb/math/Half.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "core/error.h"
#include "core/hash.h"

namespace sekitei::vdb {

static_assert(std::endian::native == std::endian::little, "VDB files are little endian");

namespace {

constexpr std::uint32_t kZip = 1, kActiveMask = 2, kBlosc = 4;
constexpr std::uint32_t kLibraryMajor = 10, kLibraryMinor = 0;
constexpr std::string_view kHalfSuffix = "_HalfFloat";
constexpr char kNameSeparator = '\x1e';

/// Reads bytes in order; any length that leads beyond the end is an error that names the place.
class Cursor {
public:
    Cursor(std::string_view bytes, const std::string& where, std::size_t position)
        : bytes_(bytes), where_(&where), position_(position)
    {
        if (position > bytes.size()) fail("a position lies beyond the end");
    }

    std::size_t position() const { return position_; }
    std::size_t left() const { return bytes_.size() - position_; }

    const char* take(std::uint64_t count)
    {
        if (count > left()) fail(fmt::format("{} bytes are announced, {} are left", count, left()));
        const char* data = bytes_.data() + position_;
        position_ += static_cast<std::size_t>(count);
        return data;
    }
    template <class T>
    T get()
    {
        T value;
        std::memcpy(&value, take(sizeof value), sizeof value);
        return value;
    }
    std::string text()
    {
        const auto length = get<std::uint32_t>();
        return std::string(take(length), length);
    }
    [[noreturn]] void fail(const std::string& what) const
    {
        throw InvalidInput(
            fmt::format("{}: damaged or truncated at byte {}: {}", *where_, position_, what));
    }

private:
    std::string_view bytes_;
    const std::string* where_;
    std::size_t position_;
};

template <class T>
void put(std::string& out, const T& value)
{
    out.append(reinterpret_cast<const char*>(&value), sizeof value);
}
void put_text(std::string& out, std::string_view text)
{
    put(out, static_cast<std::uint32_t>(text.size()));
    out.append(text);
}

MetaTable read_meta(Cursor& in, std::uint64_t* bytes_hash = nullptr)
{
    MetaTable table;
    const auto count = in.get<std::uint32_t>();
    if (count > in.left() / 12) in.fail(fmt::format("{} metadata entries are announced", count));
    for (std::uint32_t i = 0; i < count; ++i) {
        const std::string name = in.text();
        Meta meta;
        meta.type = in.text();
        const auto size = in.get<std::uint32_t>();
        if (bytes_hash && name == "sekitei:bytes") *bytes_hash = in.position();
        meta.value.assign(in.take(size), size);
        table[name] = std::move(meta);
    }
    return table;
}

void put_meta(std::string& out, const MetaTable& table)
{
    put(out, static_cast<std::uint32_t>(table.size()));
    for (const auto& [name, meta] : table) {
        put_text(out, name);
        put_text(out, meta.type);
        put_text(out, meta.value);
    }
}

/// Reads a map; its scale and translation where it is linear, else only its length.
Map read_map(Cursor& in, std::string_view file, bool within_frustum = false)
{
    const std::size_t begin = in.position();
    Map map;
    map.type = in.text();
    auto vector = [&] {
        const auto x = in.get<double>(), y = in.get<double>(), z = in.get<double>();
        return Vec3d(x, y, z);
    };
    bool aligned = true;
    auto matrix = [&] {
        std::array<double, 16> m;
        for (double& v : m) v = in.get<double>();
        map.scale = {m[0], m[5], m[10]};
        map.translation = {m[12], m[13], m[14]};
        for (const std::size_t i : {1u, 2u, 3u, 4u, 6u, 7u, 8u, 9u, 11u})
            aligned = aligned && m[i] == 0;
        aligned = aligned && m[15] == 1;
    };
    if (map.type == "UniformScaleMap" || map.type == "ScaleMap") {
        map.scale = vector();
        in.take(4 * 3 * sizeof(double));
    } else if (map.type == "UniformScaleTranslateMap" || map.type == "ScaleTranslateMap") {
        map.translation = vector();
        map.scale = vector();
        in.take(4 * 3 * sizeof(double));
    } else if (map.type == "TranslationMap") {
        map.translation = vector();
    } else if (map.type == "AffineMap" || map.type == "UnitaryMap") {
        matrix();
    } else if (map.type == "NonlinearFrustumMap" && !within_frustum) {
        in.take(8 * sizeof(double));
        read_map(in, file, true);
        map.kind = Map::Kind::Frustum;
    } else {
        in.fail(fmt::format("transform type '{}' is unknown", map.type.substr(0, 40)));
    }
    map.bytes = std::string(file.substr(begin, in.position() - begin));
    if (map.kind == Map::Kind::Frustum) return map;
    for (int axis = 0; axis < 3; ++axis)
        if (!std::isfinite(map.scale[axis]) || !std::isfinite(map.translation[axis]))
            in.fail("the transform is not finite");
    const double h = map.scale.x;
    if (!aligned || !(h > 0) || std::fabs(map.scale.y - h) > 1e-9 * h ||
        std::fabs(map.scale.z - h) > 1e-9 * h)
        map.kind = Map::Kind::NotUniform;
    return map;
}

std::string shown_name(const std::string& name, const std::string& unique, bool repeated)
{
    const std::size_t separator = unique.find(kNameSeparator);
    if (separator == std::string::npos) return name;
    if (!repeated) return name.empty() ? "unnamed" : name;
    return name + "[" + unique.substr(separator + 1) + "]";
}

}  // namespace

Meta text_meta(std::string_view text)
{
    return {"string", std::string(text)};
}

Json meta_json(const Meta& meta)
{
    auto numbers = [&]<class T>(T) -> Json {
        if (meta.value.size() % sizeof(T) != 0 || meta.value.empty()) return nullptr;
        std::vector<T> values(meta.value.size() / sizeof(T));
        std::memcpy(values.data(), meta.value.data(), meta.value.size());
        if (values.size() == 1) return Json(values[0]);
        return Json(values);
    };
    const std::string& t = meta.type;
    if (t == "string") return Json(meta.value);
    if (t == "bool") return Json(!meta.value.empty() && meta.value[0] != 0);
    if (t == "int32" || t == "vec2i" || t == "vec3i" || t == "vec4i")
        return numbers(std::int32_t{});
    if (t == "int64") return numbers(std::int64_t{});
    if (t == "float" || t == "vec2s" || t == "vec3s" || t == "vec4s") return numbers(float{});
    if (t == "double" || t == "vec2d" || t == "vec3d" || t == "vec4d") return numbers(double{});
    return nullptr;
}

std::string meta_text(const MetaTable& table, const std::string& name)
{
    const auto found = table.find(name);
    return found == table.end() || found->second.type != "string" ? std::string()
                                                                  : found->second.value;
}

Header parse_header(std::string_view bytes, const std::string& file)
{
    if (bytes.empty()) throw InvalidInput(file + ": empty file, expected a VDB");
    std::uint64_t magic = 0;
    std::memcpy(&magic, bytes.data(), std::min<std::size_t>(8, bytes.size()));
    // What can be compared of a magic number that was cut.
    const std::uint64_t known = bytes.size() >= 8 ? ~0ull : (1ull << (8 * bytes.size())) - 1;
    if (magic != (kMagic & known))
        throw InvalidInput(
            fmt::format("{}: not a VDB: magic number {:#x}, expected {:#x}", file, magic, kMagic));
    constexpr std::size_t kShortest = kUuidPosition + kUuidLength + 8;
    if (bytes.size() < kShortest)
        throw InvalidInput(fmt::format("{}: truncated: a VDB has at least {} bytes, file has {}",
                                       file, kShortest, bytes.size()));

    Cursor in(bytes, file, 8);
    Header header;
    header.version = in.get<std::uint32_t>();
    if (header.version > kNewestVersion)
        throw InvalidInput(fmt::format("{}: VDB format version {} is newer than supported {}", file,
                                       header.version, kNewestVersion));
    if (header.version < kOldestVersion)
        throw InvalidInput(fmt::format(
            "{}: VDB format version {} is older than supported {}; write it again with a newer "
            "OpenVDB, e.g. vdb_tool -read old.vdb -write new.vdb",
            file, header.version, kOldestVersion));
    header.library_major = in.get<std::uint32_t>();
    header.library_minor = in.get<std::uint32_t>();
    const bool offsets = in.get<std::uint8_t>() != 0;
    header.uuid = std::string(in.take(kUuidLength), kUuidLength);
    header.meta = read_meta(in);
    const auto count = in.get<std::int32_t>();
    if (count < 0 || static_cast<std::uint64_t>(count) > in.left() / 40 + 1)
        in.fail(fmt::format("{} grids are announced", count));
    if (!offsets && count > 0)
        throw InvalidInput(fmt::format(
            "{}: written as a stream, without the positions of its grids; write it again as a "
            "file, e.g. vdb_tool -read stream.vdb -write file.vdb",
            file));

    for (int i = 0; i < count; ++i) {
        if (in.left() == 0)
            throw InvalidInput(fmt::format(
                "{}: truncated: header says {} grids, file has {} bytes and ends after grid {}",
                file, count, bytes.size(), i));
        Entry grid;
        grid.descriptor = in.position();
        grid.unique = in.text();
        grid.type = in.text();
        if (grid.type.ends_with(kHalfSuffix)) {
            grid.half = true;
            grid.type.resize(grid.type.size() - kHalfSuffix.size());
        }
        grid.parent = in.text();
        grid.begin = in.get<std::uint64_t>();
        grid.blocks = in.get<std::uint64_t>();
        grid.end = in.get<std::uint64_t>();
        grid.name = grid.unique.substr(0, grid.unique.find(kNameSeparator));
        if (!grid.parent.empty()) grid.blocks = grid.end;  // an instance has no tree of its own
        if (grid.begin != in.position() || grid.blocks < grid.begin || grid.end < grid.blocks)
            in.fail(fmt::format("the positions of grid {} are out of order", grid.name));
        if (grid.end > bytes.size())
            throw InvalidInput(fmt::format("{}: truncated: header says {}{} bytes, file has {}",
                                           file, i + 1 < count ? "at least " : "", grid.end,
                                           bytes.size()));
        const std::string where = fmt::format("{}: grid {}", file, grid.name);
        Cursor front(bytes.substr(0, grid.blocks), where, grid.begin);
        grid.compression = front.get<std::uint32_t>();
        if (grid.compression & ~(kZip | kActiveMask | kBlosc))
            front.fail(fmt::format("unknown compression {:#x}", grid.compression));
        grid.meta = read_meta(front, &grid.bytes_hash);
        grid.map = read_map(front, bytes);
        grid.tree = front.position();
        header.grids.push_back(std::move(grid));
        in = Cursor(bytes, file, header.grids.back().end);
    }
    if (in.left() != 0)
        throw InvalidInput(fmt::format("{}: damaged: header says {} bytes, file has {}", file,
                                       in.position(), bytes.size()));

    // Equal names are told apart by a number; equal unique names are an error.
    std::map<std::string, int> names, uniques;
    for (const Entry& g : header.grids) {
        ++names[g.name];
        if (++uniques[g.unique] > 1)
            throw InvalidInput(fmt::format("{}: damaged: two grids are called {}", file, g.name));
    }
    for (Entry& g : header.grids) g.shown = shown_name(g.name, g.unique, names[g.name] > 1);
    return header;
}

std::string encode_header(const MetaTable& meta, std::size_t grid_count)
{
    std::string out;
    put(out, kMagic);
    put(out, kNewestVersion);
    put(out, kLibraryMajor);
    put(out, kLibraryMinor);
    put(out, std::uint8_t{1});  // positions are given
    out.append(kUuidLength, '0');
    put_meta(out, meta);
    put(out, static_cast<std::int32_t>(grid_count));
    return out;
}

std::string encode_front(const RawGrid& grid)
{
    std::string out;
    put(out, grid.compression);
    put_meta(out, grid.meta);
    out += grid.map;
    return out;
}

std::string encode_descriptor(const std::string& name, const RawGrid& grid, std::uint64_t position)
{
    std::string out;
    put_text(out, name);
    put_text(out, grid.half ? grid.type + std::string(kHalfSuffix) : grid.type);
    put_text(out, "");
    const std::uint64_t begin = position + out.size() + 3 * sizeof(std::uint64_t);
    const std::uint64_t blocks = begin + encode_front(grid).size() + grid.topology.size();
    put(out, begin);
    put(out, blocks);
    put(out, blocks + grid.buffers.size());
    return out;
}

std::string encode_map(const Transform& transform)
{
    const double h = transform.voxel;
    std::string out;
    put_text(out, "UniformScaleTranslateMap");
    put(out, transform.origin + Vec3d(h / 2));
    put(out, Vec3d(h));                // scale
    put(out, Vec3d(h));                // voxel size
    put(out, Vec3d(1 / h));            // inverse scale
    put(out, Vec3d(1 / h * (1 / h)));  // its square
    put(out, Vec3d(0.5 * (1 / h)));    // inverse of twice the scale
    return out;
}

RawGrid extract(std::string_view bytes, const Header& header, const Entry& entry)
{
    RawGrid raw;
    raw.type = entry.type;
    raw.half = entry.half;
    raw.compression = entry.compression;
    raw.meta = entry.meta;
    raw.map = entry.map.bytes;
    const Entry* tree = &entry;
    if (!entry.parent.empty()) {
        const auto parent =
            std::find_if(header.grids.begin(), header.grids.end(), [&](const Entry& other) {
                return other.unique == entry.parent && other.parent.empty() &&
                       other.type == entry.type && other.half == entry.half;
            });
        if (parent == header.grids.end())
            throw InvalidInput(
                fmt::format("grid {}: damaged: it shares the tree of grid {}, which "
                            "is missing",
                            entry.name, entry.parent));
        tree = &*parent;
        raw.compression = tree->compression;
    }
    raw.topology = bytes.substr(tree->tree, tree->blocks - tree->tree);
    raw.buffers = bytes.substr(tree->blocks, tree->end - tree->blocks);
    return raw;
}

std::string uuid_from_hash(const std::string& hex)
{
    return fmt::format("53656b69-7465-8{}-a{}-{}", hex.substr(0, 3), hex.substr(3, 3),
                       hex.substr(6, 12));
}

std::string content_uuid(std::string_view head, std::string_view tail)
{
    Hasher hasher;
    hasher.add(head.data(), head.size());
    hasher.add(tail.data(), tail.size());
    return uuid_from_hash(hasher.hex());
}

bool is_own_uuid(std::string_view uuid)
{
    const std::string mark = uuid_from_hash(std::string(32, '?'));
    if (uuid.size() != mark.size()) return false;
    int different = 0;
    for (std::size_t i = 0; i < mark.size(); ++i)
        if (mark[i] != '?' && mark[i] != '-')
            different += std::popcount(static_cast<unsigned char>(mark[i] ^ uuid[i]));
    return different <= 6;  // two random UUIDs differ in about 28 of these bits
}

namespace {

// --- values of one node -----------------------------------------------------------------------

/// How the inactive values of a node are stored; the numbers are those of the format.
enum InactiveCode : std::int8_t {
    kAllBackground = 0,
    kAllMinusBackground = 1,
    kAllOneValue = 2,
    kBackgroundOrMinus = 3,
    kBackgroundOrOneValue = 4,
    kTwoValues = 5,
    kEveryValue = 6
};
bool has_first_value(int code)
{
    return code == kAllOneValue || code == kBackgroundOrOneValue || code == kTwoValues;
}
bool has_selection(int code)
{
    return code == kBackgroundOrMinus || code == kBackgroundOrOneValue || code == kTwoValues;
}

float negative(float x)
{
    return -x;
}
std::int32_t negative(std::int32_t x)
{
    return static_cast<std::int32_t>(0u - static_cast<std::uint32_t>(x));
}
Vec3f negative(Vec3f v)
{
    return -v;
}

using Half = openvdb::math::internal::half;
float half_to_float(std::uint16_t bits)
{
    Half h;
    h.setBits(bits);
    return h;
}
std::uint16_t float_to_half(float x)
{
    return Half(x).bits();
}
float truncated(float x)
{
    return half_to_float(float_to_half(x));
}
Vec3f truncated(Vec3f v)
{
    return {truncated(v.x), truncated(v.y), truncated(v.z)};
}

template <class T>
struct Settings {
    std::uint32_t compression = kActiveMask | kBlosc;
    bool half = false;
    T background{};

    std::size_t stored_size() const
    {
        return half && !std::is_integral_v<T> ? sizeof(T) / 2 : sizeof(T);
    }
};

bool bit(const std::uint64_t* words, std::size_t i)
{
    return (words[i >> 6] >> (i & 63)) & 1;
}

/// Bytes that may be compressed; their unpacked size is known.
void read_block(Cursor& in, std::uint32_t compression, std::size_t bytes, char* target)
{
    if (!(compression & (kBlosc | kZip))) {
        std::memcpy(target, in.take(bytes), bytes);
        return;
    }
    const auto packed = in.get<std::int64_t>();
    if (packed <= 0) {
        if (static_cast<std::uint64_t>(-(packed + 1)) + 1 != bytes && !(packed == 0 && bytes == 0))
            in.fail(fmt::format("a block has {} bytes, expected {}", -(packed + 1), bytes));
        std::memcpy(target, in.take(bytes), bytes);
        return;
    }
    const char* source = in.take(static_cast<std::uint64_t>(packed));
    if (bytes == 0) return;
    if (compression & kBlosc) {
        std::size_t unpacked = 0;
        if (blosc_cbuffer_validate(source, static_cast<std::size_t>(packed), &unpacked) != 0 ||
            unpacked != bytes ||
            blosc_decompress_ctx(source, target, bytes, 1) != static_cast<int>(bytes))
            in.fail("a Blosc block does not unpack");
        return;
    }
    auto unpacked = static_cast<uLongf>(bytes);
    if (uncompress(reinterpret_cast<Bytef*>(target), &unpacked,
                   reinterpret_cast<const Bytef*>(source), static_cast<uLong>(packed)) != Z_OK ||
        unpacked != bytes)
        in.fail("a zip block does not unpack");
}

void skip_block(Cursor& in, std::uint32_t compression, std::size_t bytes)
{
    if (!(compression & (kBlosc | kZip))) {
        in.take(bytes);
        return;
    }
    const auto packed = in.get<std::int64_t>();
    if (packed == std::numeric_limits<std::int64_t>::min()) in.fail("a block has no length");
    in.take(static_cast<std::uint64_t>(packed < 0 ? -packed : packed));
}

template <class T>
void read_reals(Cursor& in, const Settings<T>& s, std::size_t count, T* target)
{
    if constexpr (!std::is_integral_v<T>) {
        if (s.half) {
            if (count == 0) return;  // halves leave out even the length of an empty block
            std::vector<std::uint16_t> halves(count * sizeof(T) / sizeof(float));
            read_block(in, s.compression, halves.size() * 2,
                       reinterpret_cast<char*>(halves.data()));
            float* reals = reinterpret_cast<float*>(target);
            std::transform(halves.begin(), halves.end(), reals, half_to_float);
            return;
        }
    }
    read_block(in, s.compression, count * sizeof(T), reinterpret_cast<char*>(target));
}

std::size_t count_on(const std::uint64_t* words, std::size_t count)
{
    std::size_t n = 0;
    for (std::size_t w = 0; w < count / 64; ++w) n += std::size_t(std::popcount(words[w]));
    return n;
}

/// The values of a node with `count` slots; `mask` tells which are active.
template <class T>
void read_values(Cursor& in, const Settings<T>& s, const std::uint64_t* mask, std::size_t count,
                 T* target)
{
    const auto code = in.get<std::int8_t>();
    if (code < 0 || code > kEveryValue) in.fail(fmt::format("node code {}, expected 0..6", code));
    T second = s.background;
    T first = code == kAllBackground ? s.background : negative(s.background);
    if (has_first_value(code)) first = in.get<T>();
    if (code == kTwoValues) second = in.get<T>();
    std::vector<std::uint64_t> selection;
    if (has_selection(code)) {
        selection.resize(count / 64);
        std::memcpy(selection.data(), in.take(count / 8), count / 8);
    }
    const bool masked = (s.compression & kActiveMask) && code != kEveryValue;
    const std::size_t active = masked ? count_on(mask, count) : count;
    if (active == count) {
        read_reals(in, s, count, target);
        return;
    }
    // Active values were stored without gaps: read them to the end, then spread from the front.
    T* packed = target + (count - active);
    read_reals(in, s, active, packed);
    for (std::size_t i = 0; i < count; ++i)
        target[i] = bit(mask, i)                                     ? *packed++
                    : !selection.empty() && bit(selection.data(), i) ? second
                                                                     : first;
}

template <class T>
void skip_values(Cursor& in, const Settings<T>& s, const std::uint64_t* mask, std::size_t count)
{
    const auto code = in.get<std::int8_t>();
    if (code < 0 || code > kEveryValue) in.fail(fmt::format("node code {}, expected 0..6", code));
    if (has_first_value(code)) in.take(sizeof(T));
    if (code == kTwoValues) in.take(sizeof(T));
    if (has_selection(code)) in.take(count / 8);
    const bool masked = (s.compression & kActiveMask) && code != kEveryValue;
    const std::size_t stored = masked ? count_on(mask, count) : count;
    if (stored == 0 && s.half && !std::is_integral_v<T>) return;
    skip_block(in, s.compression, stored * s.stored_size());
}

template <class T>
void put_block(std::string& out, const T* values, std::size_t count)
{
    const std::size_t bytes = count * sizeof(T);
    std::vector<char> packed(bytes + BLOSC_MAX_OVERHEAD);
    // The arguments are those of OpenVDB, so that equal values are equal bytes.
    const int n = blosc_compress_ctx(9, 1, sizeof(T), bytes, values, packed.data(), packed.size(),
                                     BLOSC_LZ4_COMPNAME, bytes, 1);
    if (n <= 0) {
        put(out, -static_cast<std::int64_t>(bytes));
        out.append(reinterpret_cast<const char*>(values), bytes);
    } else {
        put(out, static_cast<std::int64_t>(n));
        out.append(packed.data(), static_cast<std::size_t>(n));
    }
}

/// @param children  slots that hold child nodes, whose value does not count
template <class T>
void put_values(std::string& out, const Settings<T>& s, const std::uint64_t* mask,
                const std::uint64_t* children, const T* values, std::size_t count)
{
    T inactive[2] = {s.background, s.background};
    int distinct = 0;
    for (std::size_t i = 0; i < count && distinct < 3; ++i) {
        if (bit(mask, i) || bit(children, i)) continue;
        if ((distinct > 0 && values[i] == inactive[0]) ||
            (distinct > 1 && values[i] == inactive[1]))
            continue;
        if (distinct < 2) inactive[distinct] = values[i];
        ++distinct;
    }
    const T minus = negative(s.background);
    std::int8_t code = kAllBackground;
    if (distinct == 1 && !(inactive[0] == s.background))
        code = inactive[0] == minus ? kAllMinusBackground : kAllOneValue;
    if (distinct == 2) {
        if (inactive[0] == s.background) std::swap(inactive[0], inactive[1]);
        if (!(inactive[1] == s.background))
            code = kTwoValues;
        else
            code = inactive[0] == minus ? kBackgroundOrMinus : kBackgroundOrOneValue;
    }
    if (distinct > 2) code = kEveryValue;
    put(out, code);
    if (has_first_value(code)) put(out, inactive[0]);
    if (code == kTwoValues) put(out, inactive[1]);
    if (has_selection(code)) {
        std::vector<std::uint64_t> selection(count / 64);
        for (std::size_t i = 0; i < count; ++i)
            if (!bit(mask, i) && values[i] == inactive[1]) selection[i >> 6] |= 1ull << (i & 63);
        out.append(reinterpret_cast<const char*>(selection.data()), count / 8);
    }
    std::vector<T> active;
    if (code != kEveryValue) {
        active.reserve(count_on(mask, count));
        for (std::size_t i = 0; i < count; ++i)
            if (bit(mask, i)) active.push_back(values[i]);
        values = active.data();
        count = active.size();
    }
    if constexpr (std::is_same_v<T, float>) {
        if (s.half) {
            if (count == 0) return;
            std::vector<std::uint16_t> halves(count);
            std::transform(values, values + count, halves.begin(), float_to_half);
            put_block(out, halves.data(), count);
            return;
        }
    } else if constexpr (std::is_same_v<T, Vec3f>) {
        if (s.half) {
            if (count == 0) return;
            std::vector<std::array<std::uint16_t, 3>> halves(count);
            std::transform(values, values + count, halves.begin(), [](const Vec3f& v) {
                return std::array{float_to_half(v.x), float_to_half(v.y), float_to_half(v.z)};
            });
            put_block(out, halves.data(), count);
            return;
        }
    }
    put_block(out, values, count);
}

template <class T>
bool same_bits(const T& a, const T& b)
{
    return std::memcmp(&a, &b, sizeof(T)) == 0;
}

// --- the tree -------------------------------------------------------------------------------

constexpr int kRootEdge = 4096, kMiddleEdge = 128;
constexpr std::size_t kMiddleSlots = 32768, kLowSlots = 4096;

std::uint32_t middle_slot(Coord c)
{
    return static_cast<std::uint32_t>((((c.x & 4095) >> 7) << 10) | (((c.y & 4095) >> 7) << 5) |
                                      ((c.z & 4095) >> 7));
}
std::uint32_t low_slot(Coord c)
{
    return static_cast<std::uint32_t>((((c.x & 127) >> 3) << 8) | (((c.y & 127) >> 3) << 4) |
                                      ((c.z & 127) >> 3));
}
Coord middle_origin(Coord root, std::size_t slot)
{
    const int s = static_cast<int>(slot);
    return root + Coord((s >> 10) * 128, ((s >> 5) & 31) * 128, (s & 31) * 128);
}
Coord low_origin(Coord middle, std::size_t slot)
{
    const int s = static_cast<int>(slot);
    return middle + Coord((s >> 8) * 8, ((s >> 4) & 15) * 8, (s & 15) * 8);
}

template <class T>
struct Tile {
    Coord origin;
    int edge;
    T value;
    bool active;
};

/// The nodes of a tree as the topology section lists them.
template <class T>
struct Nodes {
    T background{};
    std::vector<Tile<T>> tiles;
    std::vector<Coord> leaves;
    std::vector<std::size_t> masks;  // position of each leaf's mask
};

/// Reads one internal node and then, through `child`, its children.
template <class T, std::size_t kSlots, class Origin, class Child>
void read_node(Cursor& in, const Settings<T>& s, Coord origin, int child_edge, Origin&& origin_of,
               Child&& child, Nodes<T>& nodes)
{
    std::array<std::uint64_t, kSlots / 64> children, active;
    std::memcpy(children.data(), in.take(kSlots / 8), kSlots / 8);
    std::memcpy(active.data(), in.take(kSlots / 8), kSlots / 8);
    std::vector<T> values(kSlots);
    read_values(in, s, active.data(), kSlots, values.data());
    for (std::size_t i = 0; i < kSlots; ++i) {
        if (bit(children.data(), i)) continue;
        const bool on = bit(active.data(), i);
        if (on || !same_bits(without_sign_of_zero(values[i]), s.background))
            nodes.tiles.push_back({origin_of(origin, i), child_edge, values[i], on});
    }
    for (std::size_t i = 0; i < kSlots; ++i)
        if (bit(children.data(), i)) child(origin_of(origin, i));
}

template <class T>
Nodes<T> read_topology(Cursor& in, Settings<T>& s)
{
    Nodes<T> nodes;
    if (const auto buffers = in.get<std::int32_t>(); buffers != 1)
        in.fail(fmt::format("{} buffers, expected 1", buffers));
    s.background = nodes.background = in.get<T>();
    const auto tiles = in.get<std::uint32_t>(), children = in.get<std::uint32_t>();
    if (tiles > in.left() / (13 + sizeof(T)) || children > in.left() / 12)
        in.fail(fmt::format("{} tiles and {} nodes are announced", tiles, children));
    std::vector<Coord> roots;
    auto root_origin = [&] {
        const auto x = in.get<std::int32_t>(), y = in.get<std::int32_t>(),
                   z = in.get<std::int32_t>();
        if ((x | y | z) & (kRootEdge - 1)) in.fail("a node's origin is no multiple of 4096");
        roots.emplace_back(x, y, z);
        return roots.back();
    };
    for (std::uint32_t i = 0; i < tiles; ++i) {
        const Coord origin = root_origin();
        const T value = in.get<T>();
        const bool active = in.get<std::uint8_t>() != 0;
        if (active || !same_bits(without_sign_of_zero(value), s.background))
            nodes.tiles.push_back({origin, kRootEdge, value, active});
    }
    for (std::uint32_t i = 0; i < children; ++i) {
        read_node<T, kMiddleSlots>(
            in, s, root_origin(), kMiddleEdge, middle_origin,
            [&](Coord middle) {
                read_node<T, kLowSlots>(
                    in, s, middle, kLeafEdge, low_origin,
                    [&](Coord leaf) {
                        nodes.leaves.push_back(leaf);
                        nodes.masks.push_back(in.position());
                        in.take(kLeafSize / 8);
                    },
                    nodes);
            },
            nodes);
    }
    std::sort(roots.begin(), roots.end());
    if (std::adjacent_find(roots.begin(), roots.end()) != roots.end())
        in.fail("two nodes have one origin");
    return nodes;
}

double leaves_in(int edge)
{
    return std::pow(edge / kLeafEdge, 3);
}

}  // namespace

template <class T>
LeafGrid<T> decode_tree(std::string_view bytes, const Header& header, const Entry& entry,
                        const Transform& transform, const std::string& where, double memory,
                        const Progress& progress)
{
    // A tree shared with another grid is stored once, with that grid.
    const Entry* source = &entry;
    if (!entry.parent.empty()) {
        source = nullptr;
        for (const Entry& other : header.grids)
            if (other.unique == entry.parent && other.parent.empty() && other.type == entry.type &&
                other.half == entry.half)
                source = &other;
        if (!source)
            throw InvalidInput(where + ": damaged: it shares the tree of a grid that is missing");
    }

    Settings<T> settings;
    settings.compression = source->compression;
    settings.half = source->half;
    Cursor topology(bytes.substr(0, source->blocks), where, source->tree);
    Nodes<T> nodes = read_topology(topology, settings);
    if (topology.position() != source->blocks)
        topology.fail("the tree's structure ends before its values begin");

    // Know the cost before anything is allocated.
    double leaves = static_cast<double>(nodes.leaves.size());
    for (const Tile<T>& tile : nodes.tiles) leaves += leaves_in(tile.edge);
    const double needed = leaves * (sizeof(T) + sizeof(LeafMask) + 4 + 2 * sizeof(Coord) + 8) +
                          static_cast<double>(nodes.leaves.size()) * kLeafSize * sizeof(T);
    if (needed > memory || leaves > 4e9)
        throw LimitExceeded(
            fmt::format("{}: {} blocks of 8^3 voxels need {}, allowed are {}; raise --memory",
                        where, count_text(leaves), bytes_text(needed), bytes_text(memory)));

    std::vector<Coord> origins = nodes.leaves;
    for (const Tile<T>& tile : nodes.tiles)
        for (int x = 0; x < tile.edge; x += kLeafEdge)
            for (int y = 0; y < tile.edge; y += kLeafEdge)
                for (int z = 0; z < tile.edge; z += kLeafEdge)
                    origins.push_back(tile.origin + Coord(x, y, z));
    const TopologyPtr shape = LeafTopology::build(std::move(origins));
    std::vector<std::uint8_t> dense(shape->size());
    parallel_for(
        nodes.leaves.size(), [&](std::size_t i) { dense[shape->find(nodes.leaves[i])] = 1; }, 1024);
    auto grid = LeafGrid<T>::partly_dense(shape, transform, nodes.background, dense);
    for (const Tile<T>& tile : nodes.tiles)
        for (int x = 0; x < tile.edge; x += kLeafEdge)
            for (int y = 0; y < tile.edge; y += kLeafEdge)
                for (int z = 0; z < tile.edge; z += kLeafEdge) {
                    const std::uint32_t leaf = shape->find(tile.origin + Coord(x, y, z));
                    grid.set_constant(leaf, tile.value);
                    if (tile.active) grid.mask(leaf) = LeafMask::full();
                }

    // Find where each leaf's values begin, then unpack all leaves at once.
    Cursor scan(bytes.substr(0, source->end), where, source->blocks);
    std::vector<std::size_t> begins(nodes.leaves.size());
    for (std::size_t i = 0; i < nodes.leaves.size(); ++i) {
        progress.check();
        LeafMask mask;
        std::memcpy(&mask, scan.take(sizeof mask), sizeof mask);
        if (std::memcmp(&mask, bytes.data() + nodes.masks[i], sizeof mask) != 0)
            scan.fail("a leaf's mask differs from the one in the tree's structure");
        begins[i] = scan.position();
        skip_values(scan, settings, mask.words.data(), kLeafSize);
    }
    if (scan.position() != source->end) scan.fail("the values end before the grid does");
    parallel_for(
        nodes.leaves.size(),
        [&](std::size_t i) {
            progress.check();
            const std::uint32_t leaf = shape->find(nodes.leaves[i]);
            std::memcpy(&grid.mask(leaf), bytes.data() + nodes.masks[i], sizeof(LeafMask));
            Cursor in(bytes.substr(0, source->end), where, begins[i]);
            read_values(in, settings, grid.mask(leaf).words.data(), kLeafSize, grid.values(leaf));
        },
        32);
    grid.compress();
    return grid;
}

template <class T>
LeafKind leaf_kind(const LeafGrid<T>& grid, std::size_t leaf)
{
    const LeafMask& mask = grid.mask(leaf);
    const bool none = mask.none();
    if (!none && !mask.all()) return LeafKind::Dense;
    if (!grid.is_constant(leaf)) {
        const T* v = grid.values(leaf);
        for (int i = 1; i < kLeafSize; ++i)
            if (!(none ? same_bits(without_sign_of_zero(v[i]), without_sign_of_zero(v[0]))
                       : same_bits(v[i], v[0])))
                return LeafKind::Dense;
    }
    return none && same_bits(without_sign_of_zero(grid.at(leaf, 0)),
                             without_sign_of_zero(grid.background()))
               ? LeafKind::Empty
               : LeafKind::Tile;
}

template <class T>
RawGrid encode_tree(const LeafGrid<T>& grid, bool half, const Progress& progress)
{
    RawGrid raw;
    raw.type = tree_type<T>();
    raw.half = half && !std::is_integral_v<T>;
    raw.compression = kActiveMask | kBlosc;
    raw.map = encode_map(grid.transform());
    Settings<T> settings;
    settings.half = raw.half;
    settings.background = without_sign_of_zero(grid.background());

    // Sort the leaves that hold anything into the order of the tree.
    struct Placed {
        Coord root;
        std::uint32_t key;  // middle slot, low slot
        std::uint32_t leaf;
        LeafKind kind;
    };
    std::vector<LeafKind> kinds(grid.leaf_count());
    parallel_for(
        grid.leaf_count(), [&](std::size_t i) { kinds[i] = leaf_kind(grid, i); }, 256);
    std::vector<Placed> placed;
    for (std::size_t i = 0; i < kinds.size(); ++i) {
        if (kinds[i] == LeafKind::Empty) continue;
        if (kinds[i] == LeafKind::Dense) raw.memory += kLeafSize * sizeof(T) + sizeof(LeafMask);
        const Coord o = grid.origin(i);
        placed.push_back({{o.x & ~4095, o.y & ~4095, o.z & ~4095},
                          (middle_slot(o) << 12) | low_slot(o),
                          static_cast<std::uint32_t>(i),
                          kinds[i]});
    }
    std::sort(placed.begin(), placed.end(), [](const Placed& a, const Placed& b) {
        return a.root != b.root ? a.root < b.root : a.key < b.key;
    });
    auto value_of = [&](const Placed& p) {
        const T v = grid.at(p.leaf, 0);
        return grid.mask(p.leaf).none() ? without_sign_of_zero(v) : v;
    };
    /// Whether placed[begin, end) are `slots` equal tiles.
    auto one_tile = [&](std::size_t begin, std::size_t end, std::size_t slots) {
        if (end - begin != slots) return false;
        for (std::size_t i = begin; i < end; ++i)
            if (placed[i].kind != LeafKind::Tile ||
                !same_bits(value_of(placed[i]), value_of(placed[begin])) ||
                grid.mask(placed[i].leaf).none() != grid.mask(placed[begin].leaf).none())
                return false;
        return true;
    };

    struct Low {
        std::size_t begin, end;  // in `placed`
        bool tile;
    };
    struct Root {
        std::size_t begin, end;
        bool tile;
    };
    std::vector<Root> roots;
    for (std::size_t i = 0; i < placed.size();) {
        std::size_t j = i;
        while (j < placed.size() && placed[j].root == placed[i].root) ++j;
        roots.push_back({i, j, one_tile(i, j, kMiddleSlots * kLowSlots)});
        i = j;
    }

    std::string& out = raw.topology;
    put(out, std::int32_t{1});
    put(out, settings.background);
    const auto root_tiles = static_cast<std::uint32_t>(
        std::count_if(roots.begin(), roots.end(), [](const Root& r) { return r.tile; }));
    put(out, root_tiles);
    put(out, static_cast<std::uint32_t>(roots.size()) - root_tiles);
    for (const Root& root : roots) {
        if (!root.tile) continue;
        put(out, placed[root.begin].root);
        put(out, value_of(placed[root.begin]));
        put(out, static_cast<std::uint8_t>(grid.mask(placed[root.begin].leaf).all()));
    }
    std::vector<std::uint32_t> leaves;  // dense ones, in the order of the file
    for (const Root& root : roots) {
        if (root.tile) continue;
        put(out, placed[root.begin].root);
        std::vector<Low> lows;
        for (std::size_t i = root.begin; i < root.end;) {
            std::size_t j = i;
            while (j < root.end && placed[j].key >> 12 == placed[i].key >> 12) ++j;
            lows.push_back({i, j, one_tile(i, j, kLowSlots)});
            i = j;
        }
        std::vector<std::uint64_t> children(kMiddleSlots / 64), active(kMiddleSlots / 64);
        std::vector<T> values(kMiddleSlots, settings.background);
        for (const Low& low : lows) {
            const std::size_t slot = placed[low.begin].key >> 12;
            values[slot] = low.tile ? value_of(placed[low.begin]) : T{};
            if (!low.tile)
                children[slot >> 6] |= 1ull << (slot & 63);
            else if (grid.mask(placed[low.begin].leaf).all())
                active[slot >> 6] |= 1ull << (slot & 63);
        }
        out.append(reinterpret_cast<const char*>(children.data()), kMiddleSlots / 8);
        out.append(reinterpret_cast<const char*>(active.data()), kMiddleSlots / 8);
        put_values(out, settings, active.data(), children.data(), values.data(), kMiddleSlots);

        std::vector<std::string> parts(lows.size());
        parallel_for(lows.size(), [&](std::size_t n) {
            progress.check();
            const Low& low = lows[n];
            if (low.tile) return;
            std::vector<std::uint64_t> low_children(kLowSlots / 64), low_active(kLowSlots / 64);
            std::vector<T> low_values(kLowSlots, settings.background);
            std::string masks;
            for (std::size_t i = low.begin; i < low.end; ++i) {
                const std::size_t slot = placed[i].key & 4095;
                const LeafMask& mask = grid.mask(placed[i].leaf);
                const bool dense = placed[i].kind == LeafKind::Dense;
                low_values[slot] = dense ? T{} : value_of(placed[i]);
                if (dense) {
                    low_children[slot >> 6] |= 1ull << (slot & 63);
                    put(masks, mask);
                } else if (mask.all())
                    low_active[slot >> 6] |= 1ull << (slot & 63);
            }
            std::string& part = parts[n];
            part.append(reinterpret_cast<const char*>(low_children.data()), kLowSlots / 8);
            part.append(reinterpret_cast<const char*>(low_active.data()), kLowSlots / 8);
            put_values(part, settings, low_active.data(), low_children.data(), low_values.data(),
                       kLowSlots);
            part += masks;
        });
        for (const std::string& part : parts) out += part;
        for (const Low& low : lows)
            for (std::size_t i = low.begin; i < low.end; ++i)
                if (placed[i].kind == LeafKind::Dense) leaves.push_back(placed[i].leaf);
    }

    // Pack the leaves in batches, so that little more than the result is held.
    constexpr std::size_t kBatch = 8192, kPiece = 32;
    static constexpr std::uint64_t kNoChildren[kLeafSize / 64] = {};
    for (std::size_t begin = 0; begin < leaves.size(); begin += kBatch) {
        progress.update(double(begin) / double(leaves.size()));
        const std::size_t count = std::min(kBatch, leaves.size() - begin);
        std::vector<std::string> parts((count + kPiece - 1) / kPiece);
        parallel_for(parts.size(), [&](std::size_t n) {
            std::array<T, kLeafSize> values;
            for (std::size_t i = n * kPiece; i < std::min(count, (n + 1) * kPiece); ++i) {
                const std::uint32_t leaf = leaves[begin + i];
                const LeafMask& mask = grid.mask(leaf);
                for (int v = 0; v < kLeafSize; ++v)
                    values[std::size_t(v)] =
                        mask.test(v) ? grid.at(leaf, v) : without_sign_of_zero(grid.at(leaf, v));
                put(parts[n], mask);
                put_values(parts[n], settings, mask.words.data(), kNoChildren, values.data(),
                           kLeafSize);
            }
        });
        std::size_t bytes = 0;
        for (const std::string& part : parts) bytes += part.size();
        // Guess the whole from what is packed: growing by doubling would need it three times.
        const double whole = double(raw.buffers.size() + bytes) / double(begin + count) *
                             double(leaves.size()) * 1.02;
        if (raw.buffers.capacity() < raw.buffers.size() + bytes)
            raw.buffers.reserve(
                std::max(static_cast<std::size_t>(whole), raw.buffers.size() + bytes));
        for (const std::string& part : parts) raw.buffers += part;
    }
    return raw;
}

template <class T>
LeafGrid<T> truncated_to_half(const LeafGrid<T>& grid)
{
    LeafGrid<T> out = grid;
    out.set_background(truncated(grid.background()));
    parallel_for(
        out.leaf_count(),
        [&](std::size_t i) {
            if (T* v = out.values(i))
                std::transform(v, v + kLeafSize, v, [](const T& x) { return truncated(x); });
            else
                out.set_constant(i, truncated(out.constant(i)));
        },
        64);
    return out;
}

template LeafGrid<float> decode_tree(std::string_view, const Header&, const Entry&,
                                     const Transform&, const std::string&, double, const Progress&);
template LeafGrid<std::int32_t> decode_tree(std::string_view, const Header&, const Entry&,
                                            const Transform&, const std::string&, double,
                                            const Progress&);
template LeafGrid<Vec3f> decode_tree(std::string_view, const Header&, const Entry&,
                                     const Transform&, const std::string&, double, const Progress&);
template RawGrid encode_tree(const LeafGrid<float>&, bool, const Progress&);
template RawGrid encode_tree(const LeafGrid<std::int32_t>&, bool, const Progress&);
template RawGrid encode_tree(const LeafGrid<Vec3f>&, bool, const Progress&);
template LeafGrid<float> truncated_to_half(const LeafGrid<float>&);
template LeafGrid<Vec3f> truncated_to_half(const LeafGrid<Vec3f>&);
template LeafKind leaf_kind(const LeafGrid<float>&, std::size_t);
template LeafKind leaf_kind(const LeafGrid<std::int32_t>&, std::size_t);
template LeafKind leaf_kind(const LeafGrid<Vec3f>&, std::size_t);

}  // namespace sekitei::vdb
