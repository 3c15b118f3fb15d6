#include "grids/vdb_points.h"

#include <fmt/format.h>
#include <openvdb/io/Archive.h>
#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointConversion.h>
#include <openvdb/points/PointDataGrid.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <numeric>
#include <sstream>

#include "core/error.h"
#include "core/json.h"
#include "core/log.h"

namespace sekitei::vdb {
namespace {

namespace points = openvdb::points;
using openvdb::Quats;
using openvdb::Vec3d;
using openvdb::Vec3s;

constexpr const char* kPosition = "sekitei_position";
constexpr const char* kIndex = "sekitei_index";

void initialise()
{
    static const bool once = (openvdb::initialize(), true);
    (void)once;
}

/// Archive::write with positions, which OpenVDB offers to files only.
struct SeekableArchive : openvdb::io::Archive {
    void write_to(std::ostream& out, const openvdb::GridCPtrVec& grids) const
    {
        write(out, grids, true, openvdb::MetaMap());
    }
};

/// A list of values as OpenVDB's point conversion wants it.
template <class Stored, class Value, class Convert>
struct Column {
    using value_type = Stored;
    const std::vector<Value>& values;
    Convert convert;
    std::size_t size() const { return values.size(); }
    void get(Stored& out, std::size_t i) const { out = convert(values[i]); }
    template <class T>
    void get(T& out, std::size_t i, openvdb::Index) const
    {
        out = convert(values[i]);
    }
};

template <class Stored, class Value, class Convert>
void add_column(points::PointDataTree& tree, const openvdb::tools::PointIndexTree& index,
                const std::string& name, const std::vector<Value>& values, Convert convert)
{
    points::appendAttribute<Stored>(tree, name);
    const Column<Stored, Value, Convert> column{values, convert};
    points::populateAttribute(tree, index, name, column);
}

/// Edge of the cells that hold the points: a 64th of the longest side, so that P, which is stored
/// within its cell, keeps its precision.
double cell_edge(const Points& p)
{
    Bounds bounds;
    for (const auto& x : p.position) bounds.add(x);
    const auto size = bounds.size();
    const double longest = std::max({size.x, size.y, size.z});
    // A coordinate must stay well within the 31 bits of an index.
    const double far =
        std::max({std::fabs(bounds.lower.x), std::fabs(bounds.lower.y), std::fabs(bounds.lower.z),
                  std::fabs(bounds.upper.x), std::fabs(bounds.upper.y), std::fabs(bounds.upper.z)});
    // OpenVDB takes scales below about 1e-5 for zero.
    return bounds.empty() ? 1.0 : std::max({longest / 64, far * 1e-6, 1e-3});
}

}  // namespace

RawGrid encode_points(const std::string& name, const Points& p)
{
    initialise();
    for (std::size_t i = 0; i < p.position.size(); ++i)
        if (!std::isfinite(p.position[i].x) || !std::isfinite(p.position[i].y) ||
            !std::isfinite(p.position[i].z))
            throw InvalidInput(
                fmt::format("points {}: position {} is not finite, cannot be stored", name, i));
    for (const auto& [attribute, values] : p.attributes) {
        const std::size_t size = std::visit([](const auto& v) { return v.size(); }, values);
        if (size != p.position.size())
            throw InvalidInput(fmt::format("points {}: attribute {} has {} values for {} points",
                                           name, attribute, size, p.position.size()));
        if (!points::AttributeSet::Descriptor::validName(attribute) || attribute == "P" ||
            attribute == kPosition || attribute == kIndex)
            throw InvalidInput(
                fmt::format("points {}: attribute '{}' has a name that VDB points cannot hold",
                            name, attribute));
    }

    // One thread: the order of points within a cell must not depend on the machine.
    const ThreadLimit serial(1);
    const double edge = cell_edge(p);
    const auto transform = openvdb::math::Transform::createLinearTransform(edge);
    std::vector<Vec3d> positions;
    positions.reserve(p.position.size());
    for (const auto& any : p.position) {
        const auto x = plain_zero(any);
        positions.emplace_back(x.x, x.y, x.z);
    }
    const points::PointAttributeVector<Vec3d> wrapped(positions);
    const auto index =
        openvdb::tools::createPointIndexGrid<openvdb::tools::PointIndexGrid>(wrapped, *transform);
    const auto grid = points::createPointDataGrid<points::NullCodec, points::PointDataGrid>(
        *index, wrapped, *transform);
    Json schema = Json::object();
    if (!positions.empty()) {
        auto& tree = grid->tree();
        const auto& order = index->tree();
        auto same = [](auto v) { return plain_zero(v); };
        std::vector<std::int64_t> numbers(positions.size());
        std::iota(numbers.begin(), numbers.end(), 0);
        add_column<std::int64_t>(tree, order, kIndex, numbers, same);
        add_column<Vec3d>(tree, order, kPosition, positions, same);
        for (const auto& [attribute, any] : p.attributes) {
            if (const auto* f = std::get_if<std::vector<float>>(&any))
                add_column<float>(tree, order, attribute, *f, same);
            else if (const auto* d = std::get_if<std::vector<double>>(&any))
                add_column<double>(tree, order, attribute, *d, same);
            else if (const auto* i = std::get_if<std::vector<std::int32_t>>(&any))
                add_column<std::int32_t>(tree, order, attribute, *i, same);
            else if (const auto* l = std::get_if<std::vector<std::int64_t>>(&any))
                add_column<std::int64_t>(tree, order, attribute, *l, same);
            else if (const auto* v = std::get_if<std::vector<Vec3f>>(&any))
                add_column<Vec3s>(tree, order, attribute, *v, [](const Vec3f& x0) {
                    const Vec3f x = plain_zero(x0);
                    return Vec3s(x.x, x.y, x.z);
                });
            else if (const auto* q = std::get_if<std::vector<std::array<float, 4>>>(&any))
                add_column<Quats>(tree, order, attribute, *q, [](const std::array<float, 4>& x0) {
                    const auto x = plain_zero(x0);
                    return Quats(x[0], x[1], x[2], x[3]);
                });
        }
    }
    // The kinds of attributes, which a grid without points cannot show.
    static constexpr const char* kKinds[] = {"float", "double", "int32", "int64", "vec3s", "quats"};
    for (const auto& [attribute, any] : p.attributes) schema[attribute] = kKinds[any.index()];

    grid->setName("points");
    std::ostringstream out;
    SeekableArchive archive;
    archive.setCompression(openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
    archive.write_to(out, {grid});
    const std::string bytes = std::move(out).str();
    const Header header = parse_header(bytes, "points " + name);
    RawGrid raw = extract(bytes, header, header.grids.at(0));
    raw.meta["sekitei:attributes"] = text_meta(schema.dump());
    raw.meta["sekitei:points"] = value_meta("int64", static_cast<std::int64_t>(p.position.size()));
    return raw;
}

namespace {

/// A whole VDB stream that holds just this grid.
std::string alone(const RawGrid& grid)
{
    std::string bytes = encode_header({}, 1);
    bytes.replace(kUuidPosition, kUuidLength, uuid_from_hash(std::string(32, '0')));
    bytes += encode_descriptor("points", grid, bytes.size());
    bytes += encode_front(grid) + grid.topology + grid.buffers;
    return bytes;
}

template <class Stored, class Value, class Convert>
bool fetch(const points::PointDataTree& tree, const std::string& name,
           const std::vector<std::size_t>& order, Points& out, Convert convert)
{
    std::vector<Value> values(order.size());
    std::size_t at = 0;
    for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) {
        const auto& array = leaf->constAttributeArray(name);
        if (array.valueType() != openvdb::typeNameAsString<Stored>() || array.stride() != 1)
            return false;
        const points::AttributeHandle<Stored> handle(array);
        for (auto i = leaf->beginIndexOn(); i; ++i)
            values.at(order[at++]) = convert(handle.get(*i));
    }
    out.attributes[name] = std::move(values);
    return true;
}

void fetch_any(const points::PointDataTree& tree, const std::string& name, const std::string& kind,
               const std::vector<std::size_t>& order, Points& out)
{
    auto same = [](auto v) { return v; };
    bool known = false;
    if (kind == "float")
        known = fetch<float, float>(tree, name, order, out, same);
    else if (kind == "double")
        known = fetch<double, double>(tree, name, order, out, same);
    else if (kind == "int32")
        known = fetch<std::int32_t, std::int32_t>(tree, name, order, out, same);
    else if (kind == "int64")
        known = fetch<std::int64_t, std::int64_t>(tree, name, order, out, same);
    else if (kind == "vec3s")
        known = fetch<Vec3s, Vec3f>(tree, name, order, out,
                                    [](const Vec3s& v) { return Vec3f(v.x(), v.y(), v.z()); });
    else if (kind == "quats")
        known = fetch<Quats, std::array<float, 4>>(tree, name, order, out, [](const Quats& q) {
            return std::array<float, 4>{q.x(), q.y(), q.z(), q.w()};
        });
    if (!known) log::warning("point attribute {} has type {}, which is not read", name, kind);
}

Points decode_with_openvdb(const RawGrid& raw)
{
    initialise();
    std::istringstream in(alone(raw));
    in.exceptions(std::ios::failbit | std::ios::badbit);
    openvdb::io::Stream stream(in, false);
    const auto grid = openvdb::gridPtrCast<points::PointDataGrid>(stream.getGrids()->at(0));
    if (!grid) throw InvalidInput("not a point grid");
    const auto& tree = grid->tree();

    Points out;
    out.stage = meta_text(raw.meta, "sekitei:stage");
    const auto first = tree.cbeginLeaf();
    bool own = false;
    if (first) {
        const auto& names = first->attributeSet().descriptor();
        own = names.find(kPosition) != points::AttributeSet::INVALID_POS &&
              names.find(kIndex) != points::AttributeSet::INVALID_POS;
    }
    // Order by the stored index, or as they lie in the tree.
    std::vector<std::size_t> order;
    for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) {
        if (own) {
            const points::AttributeHandle<std::int64_t> index(leaf->constAttributeArray(kIndex));
            for (auto i = leaf->beginIndexOn(); i; ++i)
                order.push_back(static_cast<std::size_t>(index.get(*i)));
        } else
            for (auto i = leaf->beginIndexOn(); i; ++i) order.push_back(order.size());
    }
    // A tool may have deleted points: close the gaps, keep the order.
    if (own) {
        std::vector<std::size_t> by(order.size());
        std::iota(by.begin(), by.end(), std::size_t{0});
        std::stable_sort(by.begin(), by.end(),
                         [&](std::size_t a, std::size_t b) { return order[a] < order[b]; });
        for (std::size_t rank = 0; rank < by.size(); ++rank) order[by[rank]] = rank;
    }
    out.position.resize(order.size());
    std::size_t at = 0;
    for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) {
        const points::AttributeHandle<Vec3s> local(leaf->constAttributeArray("P"));
        const auto exact = own ? std::make_unique<points::AttributeHandle<Vec3d>>(
                                     leaf->constAttributeArray(kPosition))
                               : nullptr;
        for (auto i = leaf->beginIndexOn(); i; ++i) {
            const Vec3d moved =
                grid->transform().indexToWorld(Vec3d(local.get(*i)) + i.getCoord().asVec3d());
            Vec3d world = moved;
            if (exact) {
                // Trust the exact position unless a tool has moved the point since.
                const Vec3d stored = exact->get(*i);
                if ((stored - moved).length() < 1e-3 * grid->voxelSize()[0]) world = stored;
            }
            out.position[order[at++]] = {world.x(), world.y(), world.z()};
        }
    }
    if (first)
        for (const auto& [name, position] : first->attributeSet().descriptor().map())
            if (name != "P" && name != kPosition && name != kIndex)
                fetch_any(tree, name, first->constAttributeArray(position).valueType(), order, out);

    // Kinds of attributes of an empty set.
    const Json schema = parse_json(meta_text(raw.meta, "sekitei:attributes"), false);
    if (out.position.empty() && schema.is_object())
        for (const auto& [name, kind] : schema.items()) {
            if (kind == "float") out.attributes[name] = std::vector<float>();
            if (kind == "double") out.attributes[name] = std::vector<double>();
            if (kind == "int32") out.attributes[name] = std::vector<std::int32_t>();
            if (kind == "int64") out.attributes[name] = std::vector<std::int64_t>();
            if (kind == "vec3s") out.attributes[name] = std::vector<Vec3f>();
            if (kind == "quats") out.attributes[name] = std::vector<std::array<float, 4>>();
        }
    return out;
}

/// Virtual memory of this process [bytes].
double own_size()
{
    double pages = 0;
    if (std::FILE* file = std::fopen("/proc/self/statm", "r")) {
        if (std::fscanf(file, "%lf", &pages) != 1) pages = 0;
        std::fclose(file);
    }
    return pages * static_cast<double>(sysconf(_SC_PAGESIZE));
}

/// Of the processor, in which damage must have shown: what is whole takes a second for some hundred
/// megabytes.
int trial_seconds(const RawGrid& grid)
{
    return 2 + static_cast<int>((grid.topology.size() + grid.buffers.size()) >> 24);
}

}  // namespace

Points decode_points(const RawGrid& grid, const std::string& where)
{
    try {
        return decode_with_openvdb(grid);
    } catch (const std::exception& error) {
        throw InvalidInput(fmt::format("{}: damaged: {}", where, error.what()));
    }
}

Points decode_untrusted_points(const RawGrid& grid, const std::string& where, double memory)
{
    initialise();
    const double size = own_size();
    const int seconds = trial_seconds(grid);
    const pid_t child = fork();
    if (child < 0) throw LimitExceeded(where + ": no process is left to try reading it in");
    if (child == 0) {
        // Only this thread lives on here; reading is serial and ends without destructors.
        struct rlimit none {
            0, 0
        };
        setrlimit(RLIMIT_CORE, &none);
        struct rlimit cpu {
            static_cast<rlim_t>(seconds), static_cast<rlim_t>(seconds)
        };
        setrlimit(RLIMIT_CPU, &cpu);
        // Address sanitizers reserve terabytes; there the limit would end every child.
        if (size < 1e12) {
            const auto most = static_cast<rlim_t>(size + std::min(memory, 1e15));
            struct rlimit space {
                most, most
            };
            setrlimit(RLIMIT_AS, &space);
        }
        for (const int s : {SIGSEGV, SIGBUS, SIGFPE, SIGABRT, SIGILL, SIGINT, SIGTERM})
            signal(s, SIG_DFL);
        int result = 1;
        try {
            decode_with_openvdb(grid);
            result = 0;
        } catch (...) {
        }
        _exit(result);
    }
    // The processor limit ends a child that spins; one that sleeps is ended here.
    int status = 0;
    bool ended = false;
    for (int tick = 0; tick < 5 * seconds * 1000 && !ended; ++tick) {
        ended = waitpid(child, &status, WNOHANG) == child;
        if (!ended) poll(nullptr, 0, 1);
    }
    if (!ended) {
        kill(child, SIGKILL);
        waitpid(child, &status, 0);
    }
    if (!ended || !WIFEXITED(status) || WEXITSTATUS(status) != 0)
        throw InvalidInput(fmt::format(
            "{}: damaged: reading its points {}", where,
            ended && WIFEXITED(status)             ? "failed, or needed too much memory"
            : ended && WTERMSIG(status) == SIGXCPU ? fmt::format("took more than {} s", seconds)
            : ended                                ? "crashed"
                                                   : "did not end"));
    return decode_points(grid, where);
}

}  // namespace sekitei::vdb
