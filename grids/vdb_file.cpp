#include "grids/vdb_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>

#include "core/error.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/json.h"
#include "core/log.h"
#include "core/machine.h"
#include "grids/vdb_format.h"
#include "grids/vdb_points.h"

namespace sekitei {
namespace {

namespace fs = std::filesystem;
using vdb::Entry;
using vdb::Header;
using vdb::RawGrid;

constexpr std::string_view kFrameMagic = "SEKITEI1";
constexpr int kFormat = 1;  // of our metadata
constexpr std::size_t kUuidEnd = vdb::kUuidPosition + vdb::kUuidLength;
const std::string kNoHash(32, '0');

constexpr const char* class_name(GridClass c)
{
    return c == GridClass::LevelSet    ? "level set"
           : c == GridClass::FogVolume ? "fog volume"
                                       : "unknown";
}
GridClass class_of(const std::string& name)
{
    return name == "level set"    ? GridClass::LevelSet
           : name == "fog volume" ? GridClass::FogVolume
                                  : GridClass::Unknown;
}

std::string json_text(const Json& json)
{
    return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Json domain_json(const Domain& d)
{
    const Transform& t = d.transform;
    return {{"dims", {d.dims.x, d.dims.y, d.dims.z}},
            {"origin", {t.origin.x, t.origin.y, t.origin.z}},
            {"voxel", t.voxel}};
}
Domain domain_from(const Json& j)
{
    Domain d;
    for (int axis = 0; axis < 3; ++axis) {
        d.dims[axis] = j.at("dims").at(std::size_t(axis)).get<std::int32_t>();
        d.transform.origin[axis] = j.at("origin").at(std::size_t(axis)).get<double>();
    }
    d.transform.voxel = j.at("voxel").get<double>();
    return d;
}

Json history_json(const std::vector<HistoryEntry>& history)
{
    Json list = Json::array();
    for (const HistoryEntry& h : history)
        list.push_back({{"stage", h.stage},
                        {"version", h.version},
                        {"params", h.params},
                        {"seed", h.seed},
                        {"inputs", h.inputs}});
    return list;
}
std::vector<HistoryEntry> history_from(const Json& list)
{
    std::vector<HistoryEntry> history;
    for (const Json& j : list)
        history.push_back({.stage = j.at("stage").get<std::string>(),
                           .version = j.at("version").get<std::string>(),
                           .params = j.at("params"),
                           .seed = j.at("seed").get<std::uint64_t>(),
                           .inputs = j.at("inputs")});
    return history;
}

/// Calls `use` with the JSON of a file metadata entry, if there is one.
template <class Use>
void with_json(const Header& header, const std::string& file, const std::string& name, Use&& use)
{
    const std::string text = vdb::meta_text(header.meta, name);
    if (text.empty()) return;
    try {
        use(parse_json(text));
    } catch (const Json::exception& error) {
        throw InvalidInput(fmt::format("{}: damaged: metadata {}: {}", file, name, error.what()));
    }
}

constexpr std::size_t kChunk = 1 << 24;  // bytes between looks at the wish to stop

/// Calls use(part) for each part of `bytes` in turn.
template <class Use>
void by_chunks(std::string_view bytes, const Progress& progress, Use&& use)
{
    for (; !bytes.empty(); bytes.remove_prefix(std::min(kChunk, bytes.size()))) {
        progress.check();
        use(bytes.substr(0, kChunk));
    }
}

// --- writing ----------------------------------------------------------------------------------

/// Where bytes go for a pipe: the same calls as AtomicFile.
struct MemoryFile {
    std::string bytes;
    void write(std::string_view text) { bytes += text; }
    void write_at(std::uint64_t offset, const void* data, std::size_t count)
    {
        std::memcpy(bytes.data() + offset, data, count);
    }
    void reserve(std::uint64_t) {}
    std::uint64_t size() const { return bytes.size(); }
};

/// Metadata a foreign program gave a grid; types are those of the nearest VDB type.
void put_extra(vdb::MetaTable& table, const Json& extra)
{
    for (const auto& [name, value] : extra.items()) {
        if (value.is_string())
            table[name] = vdb::text_meta(value.get<std::string>());
        else if (value.is_boolean())
            table[name] = vdb::value_meta("bool", value.get<bool>());
        else if (value.is_number_integer())
            table[name] = vdb::value_meta("int64", value.get<std::int64_t>());
        else if (value.is_number())
            table[name] = vdb::value_meta("double", value.get<double>());
        else if (value.is_array() && value.size() == 3 &&
                 std::all_of(value.begin(), value.end(),
                             [](const Json& v) { return v.is_number(); }))
            table[name] = vdb::value_meta(
                "vec3d",
                Vec3d(value[0].get<double>(), value[1].get<double>(), value[2].get<double>()));
    }
}

struct ActiveBox {
    Coord lower{0, 0, 0}, upper{-1, -1, -1};
    std::uint64_t count = 0;
};

template <class T>
ActiveBox active_box(const LeafGrid<T>& grid)
{
    constexpr std::int32_t kMost = std::numeric_limits<std::int32_t>::max();
    const ActiveBox none{Coord(kMost), Coord(-kMost - 1), 0};
    const ActiveBox box = parallel_fold(
        grid.leaf_count(), 4096, none,
        [&](std::size_t begin, std::size_t end) {
            ActiveBox b = none;
            for (std::size_t i = begin; i < end; ++i) {
                const LeafMask& mask = grid.mask(i);
                if (mask.none()) continue;
                const Coord o = grid.origin(i);
                b.count += static_cast<std::uint64_t>(mask.count());
                if (mask.all()) {
                    b.lower = min(b.lower, o);
                    b.upper = max(b.upper, o + Coord(7));
                } else
                    mask.for_each([&](int v) {
                        b.lower = min(b.lower, leaf_coord(o, v));
                        b.upper = max(b.upper, leaf_coord(o, v));
                    });
            }
            return b;
        },
        [](ActiveBox a, const ActiveBox& b) {
            return ActiveBox{min(a.lower, b.lower), max(a.upper, b.upper), a.count + b.count};
        });
    return box.count == 0 ? ActiveBox{} : box;
}

template <class T>
RawGrid encode_values(const LeafGrid<T>& given, const Grid& grid, bool half,
                      const Progress& progress)
{
    const Transform& t = given.transform();
    if (!(t.voxel > 0) || !std::isfinite(t.voxel) || !std::isfinite(length(t.origin)))
        throw InvalidInput(
            fmt::format("voxel size = {} m at origin {} {} {}, must be > 0 and finite", t.voxel,
                        t.origin.x, t.origin.y, t.origin.z));
    const LeafGrid<T>* values = &given;
    LeafGrid<T> halves;
    if constexpr (!std::is_integral_v<T>) {
        if (half) {  // what is hashed is what will be read
            halves = vdb::truncated_to_half(given);
            values = &halves;
        }
    }
    RawGrid raw = vdb::encode_tree(*values, half, progress);
    put_extra(raw.meta, grid.extra);
    const ActiveBox box = active_box(*values);
    raw.meta["file_bbox_min"] = vdb::value_meta("vec3i", box.lower);
    raw.meta["file_bbox_max"] = vdb::value_meta("vec3i", box.upper);
    raw.meta["file_voxel_count"] = vdb::value_meta("int64", static_cast<std::int64_t>(box.count));
    raw.meta["file_mem_bytes"] = vdb::value_meta("int64", static_cast<std::int64_t>(raw.memory));
    raw.meta["file_compression"] = vdb::text_meta("blosc + active values");
    if (raw.half) raw.meta["is_saved_as_half_float"] = vdb::value_meta("bool", true);
    if (!grid.vector_type.empty()) raw.meta["vector_type"] = vdb::text_meta(grid.vector_type);
    raw.meta["sekitei:origin"] = vdb::value_meta("vec3d", t.origin);
    if (raw.half) {
        Grid copy;
        copy.values = std::move(halves);
        raw.meta["sekitei:hash"] = vdb::text_meta(content_hash(copy, progress));
    } else
        raw.meta["sekitei:hash"] = vdb::text_meta(content_hash(grid, progress));
    return raw;
}

RawGrid encode_grid(const std::string& name, const Grid& grid, bool half, const Progress& progress)
{
    RawGrid raw;
    try {
        if (const auto* f = std::get_if<FloatGrid>(&grid.values))
            raw = encode_values(*f, grid, half, progress);
        else if (const auto* i = std::get_if<IntGrid>(&grid.values))
            raw = encode_values(*i, grid, half, progress);
        else if (const auto* v = std::get_if<VectorGrid>(&grid.values))
            raw = encode_values(*v, grid, half, progress);
        else {
            const auto& foreign = std::get<std::shared_ptr<const ForeignGrid>>(grid.values);
            if (!foreign) throw InvalidInput("has no values");
            raw = foreign->raw;
            raw.meta["sekitei:hash"] = vdb::text_meta(content_hash(grid));
        }
    } catch (const InvalidInput& error) {
        throw InvalidInput(fmt::format("grid {}: {}", name, error.what()));
    }
    raw.meta["class"] = vdb::text_meta(class_name(grid.grid_class));
    if (!grid.unit.empty()) raw.meta["sekitei:unit"] = vdb::text_meta(grid.unit);
    if (!grid.stage.empty()) raw.meta["sekitei:stage"] = vdb::text_meta(grid.stage);
    return raw;
}

/// The hash in `sekitei:bytes`: of a grid's bytes with 32 zeros in that place.
std::string bytes_hash(std::string_view unique, std::string_view type, std::string_view front,
                       std::string_view rest)
{
    Hasher hasher;
    hasher.add(unique);
    hasher.add(type);
    hasher.add(front.data(), front.size());
    hasher.add(rest.data(), rest.size());
    return hasher.hex();
}

/// Writes the scene; returns the file's UUID.
template <class Out>
std::string write_scene(Out& out, const Scene& scene, const WriteOptions& options,
                        const Progress& progress)
{
    for (const auto& [name, points] : scene.points)
        if (scene.grids.contains(name))
            throw InvalidInput(fmt::format("{} names a grid and points; rename one", name));

    vdb::MetaTable meta;
    meta["creator"] = vdb::text_meta("Sekitei " SEKITEI_VERSION);
    meta["sekitei:format"] = vdb::value_meta("int32", std::int32_t{kFormat});
    meta["sekitei:history"] = vdb::text_meta(json_text(history_json(scene.history)));
    if (scene.domain.dims.x > 0)
        meta["sekitei:domain"] = vdb::text_meta(json_text(domain_json(scene.domain)));
    if (scene.heat_domain.dims.x > 0)
        meta["sekitei:heat_domain"] = vdb::text_meta(json_text(domain_json(scene.heat_domain)));

    Hasher whole;
    auto emit = [&](std::string_view bytes) {
        by_chunks(bytes, progress, [&](std::string_view part) {
            whole.add(part.data(), part.size());
            out.write(part);
        });
    };
    const std::string header = vdb::encode_header(meta, scene.grids.size() + scene.points.size());
    whole.add(header.data(), vdb::kUuidPosition);
    whole.add(header.data() + kUuidEnd, header.size() - kUuidEnd);
    out.write(header);

    auto emit_grid = [&](const std::string& name, RawGrid raw) {
        raw.meta["name"] = vdb::text_meta(name);
        raw.meta["sekitei:bytes"] = vdb::text_meta(kNoHash);
        const std::string type = raw.type + (raw.half ? "_HalfFloat" : "");
        Hasher hasher;
        hasher.add(name);
        hasher.add(type);
        const std::string blank = vdb::encode_front(raw);
        hasher.add(blank.data(), blank.size());
        hasher.add(raw.topology.data(), raw.topology.size());
        by_chunks(raw.buffers, progress,
                  [&](std::string_view part) { hasher.add(part.data(), part.size()); });
        raw.meta["sekitei:bytes"] = vdb::text_meta(hasher.hex());
        const std::string descriptor = vdb::encode_descriptor(name, raw, out.size());
        const std::string front = vdb::encode_front(raw);
        out.reserve(out.size() + descriptor.size() + front.size() + raw.topology.size() +
                    raw.buffers.size());
        emit(descriptor);
        emit(front);
        emit(raw.topology);
        emit(raw.buffers);
    };
    const double steps = static_cast<double>(std::max<std::size_t>(1, scene.grids.size()));
    double step = 0;
    for (const auto& [name, grid] : scene.grids) {
        emit_grid(name, encode_grid(name, grid, options.half,
                                    progress.slice(step / steps, (step + 1) / steps)));
        ++step;
    }
    for (const auto& [name, points] : scene.points) {
        RawGrid raw = vdb::encode_points(name, points);
        raw.meta["class"] = vdb::text_meta("unknown");
        if (!points.stage.empty()) raw.meta["sekitei:stage"] = vdb::text_meta(points.stage);
        raw.meta["sekitei:hash"] = vdb::text_meta(content_hash(points));
        emit_grid(name, std::move(raw));
    }
    std::string uuid = vdb::uuid_from_hash(whole.hex());
    out.write_at(vdb::kUuidPosition, uuid.data(), uuid.size());
    return uuid;
}

// --- reading ----------------------------------------------------------------------------------

std::string uuid_of(std::string_view bytes, const Progress& progress)
{
    Hasher hasher;
    for (const std::string_view side :
         {bytes.substr(0, vdb::kUuidPosition), bytes.substr(kUuidEnd)})
        by_chunks(side, progress,
                  [&](std::string_view part) { hasher.add(part.data(), part.size()); });
    return vdb::uuid_from_hash(hasher.hex());
}

/// Whether the bytes of one grid of our own file are as they were written.
bool grid_bytes_hold(std::string_view bytes, const Entry& entry)
{
    if (entry.bytes_hash == 0 || entry.bytes_hash + kNoHash.size() > entry.end) return false;
    std::string front(bytes.substr(entry.begin, entry.tree - entry.begin));
    const std::size_t at = entry.bytes_hash - entry.begin;
    if (at + kNoHash.size() > front.size()) return false;
    const std::string stored = front.substr(at, kNoHash.size());
    front.replace(at, kNoHash.size(), kNoHash);
    return stored == bytes_hash(entry.unique, entry.type + (entry.half ? "_HalfFloat" : ""), front,
                                bytes.substr(entry.tree, entry.end - entry.tree));
}

/// The grids of our own file whose bytes changed; empty if only the header did.
std::vector<std::string> damaged_grids(std::string_view bytes, const Header& header)
{
    std::vector<std::string> names;
    for (const Entry& entry : header.grids)
        if (!grid_bytes_hold(bytes, entry)) names.push_back(entry.shown);
    return names;
}

/// Whether Sekitei wrote these bytes, and nothing changed since.
/// @throws InvalidInput  it did, and something has
bool is_own_and_whole(std::string_view bytes, const Header& header, const std::string& file,
                      const Progress& progress)
{
    const std::string expected = uuid_of(bytes, progress);
    if (header.uuid == expected) return true;
    // A foreign program makes a random UUID; ours stays recognisable with flipped bits.
    if (!vdb::is_own_uuid(header.uuid)) return false;
    const std::vector<std::string> damaged = damaged_grids(bytes, header);
    throw InvalidInput(fmt::format(
        "{}: damaged: hash mismatch in {}; use another copy or make it again", file,
        damaged.empty() ? "the header" : fmt::format("grid {}", fmt::join(damaged, ", "))));
}

Transform transform_of(const Entry& entry)
{
    Transform t;
    t.voxel = entry.map.scale.x;
    t.origin = entry.map.translation - Vec3d(t.voxel / 2);
    // origin + voxel / 2 was rounded: take the origin that was meant, if it still fits.
    const auto found = entry.meta.find("sekitei:origin");
    if (found != entry.meta.end() && found->second.type == "vec3d" &&
        found->second.value.size() == sizeof(Vec3d)) {
        Vec3d origin;
        std::memcpy(&origin, found->second.value.data(), sizeof origin);
        if (origin + Vec3d(t.voxel / 2) == entry.map.translation) t.origin = origin;
    }
    return t;
}

float largest(float x)
{
    return std::fabs(x);
}
float largest(Vec3f v)
{
    return std::max({std::fabs(v.x), std::fabs(v.y), std::fabs(v.z)});
}
bool finite(float x)
{
    return std::isfinite(x);
}
bool finite(Vec3f v)
{
    return finite(v.x) && finite(v.y) && finite(v.z);
}
std::string value_text(float x)
{
    return fmt::format("{}", x);
}
std::string value_text(Vec3f v)
{
    return fmt::format("({} {} {})", v.x, v.y, v.z);
}

struct Found {
    std::uint64_t count = 0;
    std::size_t leaf = 0;
    int offset = 0;
};

/// Counts voxels where `bad` holds and remembers the first. Background values mean "no value" and
/// are let through, so that a grid of times may have infinity there.
template <class T, class Bad>
Found count_where(const LeafGrid<T>& grid, const Progress& progress, Bad&& bad)
{
    const T none = grid.background();
    return parallel_fold(
        grid.leaf_count(), 512, Found{},
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            Found f;
            for (std::size_t i = begin; i < end; ++i) {
                const bool constant = grid.is_constant(i);
                for (int v = 0; v < (constant ? 1 : kLeafSize); ++v) {
                    const T x = grid.at(i, v);
                    if (!bad(x) || std::memcmp(&x, &none, sizeof x) == 0) continue;
                    if (f.count == 0) {
                        f.leaf = i;
                        f.offset = v;
                    }
                    f.count += constant ? kLeafSize : 1;
                }
            }
            return f;
        },
        [](Found a, const Found& b) {
            if (a.count == 0) return b;
            a.count += b.count;
            return a;
        });
}

/// Refuses, or mends, values that no stage can compute with.
template <class T>
void check_values(LeafGrid<T>& grid, const std::string& where, const std::string& name,
                  const std::string& unit, bool fix_nan, const Progress& progress)
{
    const Found bad = count_where(grid, progress, [](const T& x) { return !finite(x); });
    auto at = [&](const Found& f) {
        const Coord c = leaf_coord(grid.origin(f.leaf), f.offset);
        return fmt::format("({}, {}, {})", c.x, c.y, c.z);
    };
    const bool nan_background = grid.background() != grid.background();
    if (nan_background && !fix_nan)
        throw InvalidInput(where +
                           ": the background is NaN, expected a number; --fix-nan makes it 0");
    if (nan_background) grid.set_background(T{});
    if (bad.count > 0 && !fix_nan)
        throw InvalidInput(fmt::format(
            "{}: {} voxels are NaN or infinite, first {} at {}; --fix-nan replaces them by the "
            "background",
            where, bad.count, value_text(grid.at(bad.leaf, bad.offset)), at(bad)));
    if (bad.count > 0) {
        const T fill = finite(grid.background()) ? grid.background() : T{};
        parallel_for(
            grid.leaf_count(),
            [&](std::size_t i) {
                if (T* v = grid.values(i))
                    std::replace_if(
                        v, v + kLeafSize, [](const T& x) { return !finite(x); }, fill);
                else if (!finite(grid.constant(i)))
                    grid.set_constant(i, fill);
            },
            64);
        grid.compress();
        log::warning("{}: {} voxels were NaN or infinite, now {}", where, bad.count,
                     value_text(fill));
    }
    const bool kelvin = unit == "K" || name == "temperature" || name == "air_T";
    constexpr float kMost = 1e30f;
    const Found range = count_where(grid, progress, [&](const T& x) {
        const float m = largest(x);
        return m > kMost || (kelvin && m > 0 && m < std::numeric_limits<float>::min());
    });
    if (range.count > 0)
        throw InvalidInput(fmt::format(
            "{}: {} voxels out of range, first {}{} at {}, expected {}at most {:g}{}", where,
            range.count, value_text(grid.at(range.leaf, range.offset)), kelvin ? " K" : "",
            at(range), kelvin ? "0 or a normal number " : "a magnitude of ", kMost,
            kelvin         ? " K"
            : unit.empty() ? ""
                           : " " + unit));
}
bool is_leaf_grid(const Entry& entry)
{
    return entry.type == vdb::tree_type<float>() || entry.type == vdb::tree_type<std::int32_t>() ||
           entry.type == vdb::tree_type<Vec3f>();
}

struct Budget {
    double left;
    void take(double bytes) { left = std::max(0.0, left - bytes); }
};

template <class T>
LeafGrid<T> read_values(std::string_view bytes, const Header& header, const Entry& entry,
                        const std::string& where, Budget& budget, const Progress& progress)
{
    LeafGrid<T> grid = vdb::decode_tree<T>(bytes, header, entry, transform_of(entry), where,
                                           budget.left, progress);
    budget.take(static_cast<double>(grid.memory_bytes()));
    return grid;
}

Grid read_grid(std::string_view bytes, const Header& header, const Entry& entry,
               const std::string& where, Budget& budget, const Progress& progress = {})
{
    Grid grid;
    grid.grid_class = class_of(vdb::meta_text(entry.meta, "class"));
    grid.unit = vdb::meta_text(entry.meta, "sekitei:unit");
    grid.stage = vdb::meta_text(entry.meta, "sekitei:stage");
    grid.vector_type = vdb::meta_text(entry.meta, "vector_type");
    for (const auto& [name, meta] : entry.meta) {
        static const std::set<std::string> kOwn = {"name", "class", "vector_type",
                                                   "is_saved_as_half_float"};
        if (kOwn.contains(name) || name.starts_with("file_") || name.starts_with("sekitei:"))
            continue;
        if (Json value = vdb::meta_json(meta); !value.is_null()) grid.extra[name] = value;
    }
    if (!is_leaf_grid(entry)) {
        auto foreign = std::make_shared<ForeignGrid>();
        foreign->raw = vdb::extract(bytes, header, entry);
        const auto count = entry.meta.find("file_voxel_count");
        if (count != entry.meta.end() && count->second.value.size() == sizeof foreign->active)
            std::memcpy(&foreign->active, count->second.value.data(), sizeof foreign->active);
        budget.take(static_cast<double>(entry.end - entry.begin));
        grid.values = std::shared_ptr<const ForeignGrid>(std::move(foreign));
        return grid;
    }
    if (entry.map.kind != vdb::Map::Kind::Uniform)
        throw InvalidInput(fmt::format(
            "{}: its transform ({}{}) is {}; every stage needs cubic voxels along the axes: "
            "resample it first",
            where, entry.map.type,
            entry.map.kind == vdb::Map::Kind::Frustum
                ? ""
                : fmt::format(", scale {} {} {}", entry.map.scale.x, entry.map.scale.y,
                              entry.map.scale.z),
            entry.map.kind == vdb::Map::Kind::Frustum
                ? "a frustum"
                : "not uniform, rotated, sheared or mirrored"));
    if (entry.type == vdb::tree_type<float>())
        grid.values = read_values<float>(bytes, header, entry, where, budget, progress);
    else if (entry.type == vdb::tree_type<Vec3f>())
        grid.values = read_values<Vec3f>(bytes, header, entry, where, budget, progress);
    else
        grid.values = read_values<std::int32_t>(bytes, header, entry, where, budget, progress);
    return grid;
}

/// The grids to read, each with the name it gets.
std::vector<std::pair<std::string, const Entry*>> choose(const Header& header,
                                                         const std::string& file,
                                                         const ReadOptions& options)
{
    const std::set<std::string>& only = options.only;
    std::vector<std::pair<std::string, const Entry*>> chosen;
    for (const Entry& entry : header.grids) {
        const std::string name = entry.name.empty() ? "unnamed" : entry.name;
        if (only.empty() || only.contains(entry.shown) || only.contains(name) ||
            options.if_there.contains(name))
            // One of several of a name keeps the number by which it was asked for.
            chosen.emplace_back(only.contains(entry.shown) ? entry.shown : name, &entry);
    }
    auto shown = [&](auto&& keep) {
        std::vector<std::string> names;
        for (const Entry& entry : header.grids)
            if (keep(entry)) names.push_back(entry.shown);
        return fmt::format("{}", fmt::join(names, ", "));
    };
    for (const std::string& name : only)
        if (std::none_of(header.grids.begin(), header.grids.end(), [&](const Entry& e) {
                return e.shown == name || e.name == name || (e.name.empty() && name == "unnamed");
            }))
            throw InvalidInput(fmt::format(
                "{}: no grid is called {}, {}", file, name,
                header.grids.empty() ? "there are none"
                                     : "present: " + shown([](const Entry&) { return true; })));
    std::map<std::string, int> counts;
    for (const auto& [name, entry] : chosen)
        if (++counts[name] > 1)
            throw InvalidInput(fmt::format(
                "{}: several grids are called {} ({}); choose one, e.g. --grid {}", file, name,
                shown([&, same = entry->name](const Entry& e) { return e.name == same; }),
                entry->shown));
    return chosen;
}

Scene read_bytes(std::string_view bytes, const std::string& file, const ReadOptions& options,
                 const Progress& progress)
{
    const Header header = vdb::parse_header(bytes, file);
    const bool own = options.check_hashes && is_own_and_whole(bytes, header, file, progress);
    Scene scene;
    with_json(header, file, "sekitei:history",
              [&](const Json& j) { scene.history = history_from(j); });
    with_json(header, file, "sekitei:domain",
              [&](const Json& j) { scene.domain = domain_from(j); });
    with_json(header, file, "sekitei:heat_domain",
              [&](const Json& j) { scene.heat_domain = domain_from(j); });

    const double allowed = options.memory_limit > 0 ? options.memory_limit : physical_memory();
    Budget budget{allowed - static_cast<double>(bytes.size())};
    const auto chosen = choose(header, file, options);
    double step = 0;
    for (const auto& [name, entry] : chosen) {
        progress.update(step++ / static_cast<double>(chosen.size()));
        const std::string where = fmt::format("{}: grid {}", file, entry->shown);
        const std::string hash = vdb::meta_text(entry->meta, "sekitei:hash");
        std::string found;
        if (entry->type == vdb::kPointType) {
            RawGrid raw = vdb::extract(bytes, header, *entry);
            if (static_cast<double>(raw.buffers.size()) > budget.left)
                throw LimitExceeded(
                    fmt::format("{}: needs more than the {} allowed", where, bytes_text(allowed)));
            Points points = own ? vdb::decode_points(raw, where)
                                : vdb::decode_untrusted_points(raw, where, budget.left);
            if (!own && !hash.empty()) found = content_hash(points);
            scene.points[name] = std::move(points);
        } else {
            if (!is_leaf_grid(*entry) && !options.keep_foreign) continue;
            Grid grid = read_grid(bytes, header, *entry, where, budget, progress);
            if (!own && !hash.empty()) found = content_hash(grid, progress);
            if (auto* f = std::get_if<FloatGrid>(&grid.values))
                check_values(*f, where, name, grid.unit, options.fix_nan, progress);
            if (auto* v = std::get_if<VectorGrid>(&grid.values))
                check_values(*v, where, name, grid.unit, options.fix_nan, progress);
            scene.grids[name] = std::move(grid);
        }
        // Another program wrote the file and kept our mark: what it changed is its own business.
        if (found != hash && !own && options.check_hashes)
            log::warning("{}: was changed by another program since stage '{}' made it", where,
                         vdb::meta_text(entry->meta, "sekitei:stage"));
    }
    return scene;
}

/// hash_hex() that can be stopped.
std::string hash_of(std::string_view bytes, const Progress& progress)
{
    Hasher hasher;
    by_chunks(bytes, progress,
              [&](std::string_view part) { hasher.add(part.data(), part.size()); });
    return hasher.hex();
}

/// The VDB inside a frame that a shell put into a file.
std::string_view unframed(std::string_view bytes, const std::string& file,
                          const Progress& progress = {})
{
    if (!bytes.starts_with(kFrameMagic)) return bytes;
    std::uint64_t length = 0;
    const std::size_t begin = kFrameMagic.size() + sizeof length;
    if (bytes.size() >= begin)
        std::memcpy(&length, bytes.data() + kFrameMagic.size(), sizeof length);
    if (bytes.size() < begin + kNoHash.size() || length != bytes.size() - begin - kNoHash.size())
        throw InvalidInput(fmt::format("{}: truncated: the frame says {} bytes, {} came", file,
                                       length + begin + kNoHash.size(), bytes.size()));
    const std::string_view inside = bytes.substr(begin, length);
    if (hash_of(inside, progress) != bytes.substr(begin + length))
        throw InvalidInput(file + ": damaged on its way: hash mismatch");
    return inside;
}

std::string load(const fs::path& path, double memory_limit, const Progress& progress = {})
{
    std::error_code ignored;
    const auto size = fs::file_size(path, ignored);
    const double allowed = memory_limit > 0 ? memory_limit : physical_memory();
    if (!ignored && static_cast<double>(size) > allowed)
        throw LimitExceeded(fmt::format("{}: has {}, allowed are {}; raise --memory", path.string(),
                                        bytes_text(static_cast<double>(size)),
                                        bytes_text(allowed)));
    return read_file(path, std::numeric_limits<std::uint64_t>::max(), progress);
}

/// Whether a file's bytes hash to the UUID that stands in it, and that is this one. A piece at a
/// time: the scene is still in memory.
bool reads_back(const fs::path& path, const std::string& uuid, const Progress& progress)
{
    std::ifstream file(path, std::ios::binary);
    std::string start(kUuidEnd, '\0');
    if (!file.read(start.data(), std::streamsize(start.size()))) return false;
    Hasher hasher;
    hasher.add(start.data(), vdb::kUuidPosition);
    std::string piece(std::size_t(4) << 20, '\0');
    while (file) {
        progress.check();
        file.read(piece.data(), std::streamsize(piece.size()));
        hasher.add(piece.data(), static_cast<std::size_t>(file.gcount()));
    }
    return file.eof() && start.substr(vdb::kUuidPosition) == uuid &&
           vdb::uuid_from_hash(hasher.hex()) == uuid;
}

void write_all(int fd, std::string_view bytes, const Progress& progress)
{
    while (!bytes.empty()) {
        progress.check();
        const ssize_t n = ::write(fd, bytes.data(), bytes.size());
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0)
            throw IoError(fmt::format("cannot write to the pipe: {}", errno == EPIPE
                                                                          ? "its reader has gone"
                                                                          : std::strerror(errno)));
        bytes.remove_prefix(static_cast<std::size_t>(n));
    }
}

}  // namespace

Scene read_vdb(const fs::path& path, const ReadOptions& options, const Progress& progress)
{
    const std::string bytes = load(path, options.memory_limit, progress);
    return read_bytes(unframed(bytes, path.string(), progress), path.string(), options, progress);
}

void write_vdb(const fs::path& path, const Scene& scene, const WriteOptions& options,
               const Progress& progress)
{
    AtomicFile file(path);
    const std::string uuid = write_scene(file, scene, options, progress.slice(0, 0.8));
    file.set_verifier([&](const fs::path& temporary) {
        progress.update(0.9);
        if (!reads_back(temporary, uuid, progress))
            throw IoError(fmt::format(
                "cannot write {}: what was read back differs from what was written; check the disk",
                path.string()));
    });
    progress.update(0.8);
    file.commit();
}

void write_vdb_stream(int file_descriptor, const Scene& scene, const Progress& progress)
{
    MemoryFile file;
    write_scene(file, scene, {}, progress.slice(0, 0.5));
    const std::uint64_t length = file.bytes.size();
    std::string head(kFrameMagic);
    head.append(reinterpret_cast<const char*>(&length), sizeof length);
    write_all(file_descriptor, head, progress);
    by_chunks(file.bytes, progress,
              [&](std::string_view part) { write_all(file_descriptor, part, progress); });
    write_all(file_descriptor, hash_of(file.bytes, progress), progress);
}

Scene read_vdb_stream(int file_descriptor, const ReadOptions& options, std::string already_read,
                      const Progress& progress)
{
    constexpr const char* kName = "standard input";
    std::string bytes = std::move(already_read);
    const double allowed = options.memory_limit > 0 ? options.memory_limit : physical_memory();
    std::uint64_t wanted = std::numeric_limits<std::uint64_t>::max();
    // Grow with what comes, never with what is announced.
    for (std::size_t block = 1 << 16;; block = std::min<std::size_t>(2 * block, 1 << 26)) {
        if (bytes.starts_with(kFrameMagic) && bytes.size() >= kFrameMagic.size() + 8) {
            std::uint64_t length = 0;
            std::memcpy(&length, bytes.data() + kFrameMagic.size(), sizeof length);
            if (static_cast<double>(length) > allowed)
                throw LimitExceeded(fmt::format("{}: {} are announced, allowed are {}", kName,
                                                bytes_text(static_cast<double>(length)),
                                                bytes_text(allowed)));
            wanted = length + kFrameMagic.size() + 8 + kNoHash.size();
        }
        if (bytes.size() >= wanted) break;
        if (static_cast<double>(bytes.size()) > allowed)
            throw LimitExceeded(
                fmt::format("{}: more than the {} allowed", kName, bytes_text(allowed)));
        const std::size_t have = bytes.size();
        bytes.resize(have +
                     static_cast<std::size_t>(std::min<std::uint64_t>(block, wanted - have)));
        ssize_t n = 0;
        do {
            progress.check();
            n = ::read(file_descriptor, bytes.data() + have, bytes.size() - have);
        } while (n < 0 && errno == EINTR);
        if (n < 0)
            throw InvalidInput(fmt::format("{}: cannot read: {}", kName, std::strerror(errno)));
        bytes.resize(have + static_cast<std::size_t>(n));
        if (n == 0) break;
    }
    return read_bytes(unframed(bytes, kName, progress), kName, options, progress);
}

VdbFileInfo inspect_vdb(const fs::path& path, const Progress& progress)
{
    const std::string file = load(path, 0, progress);
    const std::string_view bytes = unframed(file, path.string(), progress);
    const Header header = vdb::parse_header(bytes, path.string());
    VdbFileInfo info;
    info.bytes = bytes.size();
    info.uuid = header.uuid;
    info.creator = vdb::meta_text(header.meta, "creator");
    with_json(header, path.string(), "sekitei:history",
              [&](const Json& j) { info.history = history_from(j); });
    with_json(header, path.string(), "sekitei:domain",
              [&](const Json& j) { info.domain = domain_from(j); });
    for (const Entry& entry : header.grids) {
        VdbGridInfo grid;
        grid.name = entry.shown;
        Grid named;
        auto foreign = std::make_shared<ForeignGrid>();
        foreign->raw.type = entry.type;
        named.values = std::shared_ptr<const ForeignGrid>(std::move(foreign));
        grid.points = entry.type == vdb::kPointType;
        grid.type = grid.points ? "points" : named.type_name();
        grid.grid_class = vdb::meta_text(entry.meta, "class");
        grid.unit = vdb::meta_text(entry.meta, "sekitei:unit");
        grid.stage = vdb::meta_text(entry.meta, "sekitei:stage");
        grid.hash = vdb::meta_text(entry.meta, "sekitei:hash");
        grid.bytes_on_disk = entry.end - entry.descriptor;
        grid.metadata = Json::object();
        for (const auto& [name, meta] : entry.meta)
            if (Json value = vdb::meta_json(meta); !value.is_null()) grid.metadata[name] = value;
        const char* count = grid.points ? "sekitei:points" : "file_voxel_count";
        if (const auto c = grid.metadata.find(count);
            c != grid.metadata.end() && c->is_number_integer() && c->get<std::int64_t>() > 0)
            grid.active_voxels = c->get<std::uint64_t>();
        if (const auto m = grid.metadata.find("file_mem_bytes");
            m != grid.metadata.end() && m->is_number_integer() && m->get<std::int64_t>() > 0)
            grid.memory = m->get<std::uint64_t>();
        if (entry.map.kind == vdb::Map::Kind::Uniform) {
            const Transform t = transform_of(entry);
            grid.voxel = t.voxel;
            const Json lower = grid.metadata.value("file_bbox_min", Json()),
                       upper = grid.metadata.value("file_bbox_max", Json());
            if (lower.is_array() && upper.is_array() && lower.size() == 3 && upper.size() == 3 &&
                grid.active_voxels > 0) {
                grid.lower = t.world(
                    {lower[0].get<double>(), lower[1].get<double>(), lower[2].get<double>()});
                grid.upper = t.world({upper[0].get<double>() + 1, upper[1].get<double>() + 1,
                                      upper[2].get<double>() + 1});
            }
        }
        info.grids.push_back(std::move(grid));
    }
    return info;
}

VerifyResult verify_vdb(const fs::path& path)
{
    const std::string file = load(path, 0);
    const std::string_view bytes = unframed(file, path.string());
    const Header header = vdb::parse_header(bytes, path.string());
    VerifyResult result;
    const bool whole = header.uuid == uuid_of(bytes, {});
    if (!whole && vdb::is_own_uuid(header.uuid)) {
        result.damaged = damaged_grids(bytes, header);
        if (result.damaged.empty()) result.damaged.push_back("(header)");
        for (const Entry& entry : header.grids)
            if (std::find(result.damaged.begin(), result.damaged.end(), entry.shown) ==
                result.damaged.end())
                result.good.push_back(entry.shown);
        return result;
    }
    Budget budget{physical_memory()};
    for (const Entry& entry : header.grids) {
        const std::string hash = vdb::meta_text(entry.meta, "sekitei:hash");
        if (hash.empty()) {
            result.without_hash.push_back(entry.shown);
            continue;
        }
        const std::string where = fmt::format("{}: grid {}", path.string(), entry.shown);
        std::string found;
        try {
            if (entry.type == vdb::kPointType) {
                const RawGrid raw = vdb::extract(bytes, header, entry);
                found = content_hash(whole ? vdb::decode_points(raw, where)
                                           : vdb::decode_untrusted_points(raw, where, budget.left));
            } else {
                Budget one = budget;
                found = content_hash(read_grid(bytes, header, entry, where, one));
            }
        } catch (const InvalidInput&) {
        }
        (found == hash ? result.good : result.damaged).push_back(entry.shown);
    }
    return result;
}

}  // namespace sekitei
