#include <fmt/format.h>

#include <OpenMesh/Core/IO/MeshIO.hh>
#include <OpenMesh/Core/Mesh/PolyMesh_ArrayKernelT.hh>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <mutex>
#include <sstream>

#include "core/error.h"
#include "core/mesh_formats.h"

// OFF and STL are read by OpenMesh, each behind a guard: OpenMesh 9 believes counts and indices as
// they come, so the guard has looked at every one of them and hands on only what it understood.
namespace sekitei::mesh_format {
namespace {

using HalfEdges = OpenMesh::PolyMesh_ArrayKernelT<>;

/// Takes polygons from OpenMesh's readers without building half edges: these refuse faces at
/// non-manifold edges and cost valence^2 around a vertex.
class Collector : public OpenMesh::IO::ImporterT<HalfEdges> {
public:
    Collector(HalfEdges& unused, Polygons& out) : ImporterT(unused), out_(out) {}

    using ImporterT::add_face;
    using ImporterT::add_vertex;
    OpenMesh::VertexHandle add_vertex(const OpenMesh::Vec3f& p) override
    {
        out_.vertices.emplace_back(p[0], p[1], p[2]);
        return OpenMesh::VertexHandle(static_cast<int>(out_.vertices.size()) - 1);
    }
    OpenMesh::FaceHandle add_face(const VHandles& corners) override
    {
        for (const OpenMesh::VertexHandle v : corners) {
            if (v.idx() < 0 || std::size_t(v.idx()) >= out_.vertices.size()) {
                sound = false;
                return OpenMesh::FaceHandle();
            }
            out_.corners.push_back(static_cast<std::uint32_t>(v.idx()));
        }
        out_.ends.push_back(out_.corners.size());
        return OpenMesh::FaceHandle(static_cast<int>(out_.ends.size()) - 1);
    }
    void reserve(unsigned int, unsigned int, unsigned int) override {}
    std::size_t n_vertices() const override { return out_.vertices.size(); }
    std::size_t n_faces() const override { return out_.ends.size(); }

    bool sound = true;

private:
    Polygons& out_;
};

/// @param faces  what the guard counted
void read_by_openmesh(std::string checked, const std::string& extension, bool binary,
                      std::uint64_t faces, Polygons& out)
{
    // The reader modules are one of each for the whole program and keep state while they read.
    static std::mutex mutex;
    const std::lock_guard lock(mutex);
    omlog().disable();
    omerr().disable();
    omout().disable();
    HalfEdges unused;
    Collector collector(unused, out);
    OpenMesh::IO::Options options;
    if (binary) options += OpenMesh::IO::Options::Binary;
    std::istringstream stream(std::move(checked));
    stream.imbue(std::locale::classic());
    if (!OpenMesh::IO::IOManager().read(stream, extension, collector, options) ||
        !collector.sound || out.ends.size() > faces)
        throw InvalidInput(
            fmt::format("{}: OpenMesh cannot read this {} file", out.name, extension.substr(1)));
    out.dropped = faces - out.ends.size();  // faces that meet a vertex twice
}

[[noreturn]] void throw_not_finite(const std::string& name, std::uint64_t bad, std::uint64_t total,
                                   const std::string& first)
{
    throw InvalidInput(fmt::format(
        "{}: {} of {} vertices are not finite numbers, the first is {}; repair the mesh "
        "where it was made",
        name, bad, total, first));
}

bool finite_floats(const double (&v)[3])
{
    return std::all_of(std::begin(v), std::end(v),
                       [](double x) { return std::isfinite(static_cast<float>(x)); });
}

// OFF ---------------------------------------------------------------------------------------------

/// The next line with words in it, comments cut off.
bool next_content(Lines& lines, std::string_view& line)
{
    while (lines.next(line)) {
        line = line.substr(0, line.find('#'));
        std::string_view rest = line;
        if (!take_word(rest).empty()) return true;
    }
    return false;
}

bool is_off_magic(std::string_view word)
{
    if (word.starts_with("ST")) word.remove_prefix(2);
    if (word.starts_with("C")) word.remove_prefix(1);
    if (word.starts_with("N")) word.remove_prefix(1);
    if (word.starts_with("4")) word.remove_prefix(1);
    if (word.starts_with("n")) word.remove_prefix(1);
    return word == "OFF";
}

// STL ---------------------------------------------------------------------------------------------

constexpr std::size_t kStlHeader = 84, kStlTriangle = 50;

std::uint32_t little_endian(std::string_view bytes, std::size_t at)
{
    std::uint32_t value = 0;
    for (std::size_t i = 4; i-- > 0;)
        value = value << 8 | static_cast<unsigned char>(bytes[at + i]);
    return value;
}

void append32(std::string& out, std::uint32_t bits)
{
    for (int i = 0; i < 4; ++i) out += static_cast<char>(bits >> 8 * i & 0xFF);
}

std::uint64_t binary_stl_size(std::string_view bytes)
{
    return kStlHeader + kStlTriangle * std::uint64_t(little_endian(bytes, 80));
}

bool begins_like_text_stl(std::string_view bytes)
{
    std::string_view line = bytes.substr(0, bytes.find('\n'));
    const std::string_view word = take_word(line);
    return (word == "solid" || word == "SOLID") &&
           bytes.substr(0, 512).find('\0') == std::string_view::npos;
}

std::string lower_case(std::string_view word)
{
    std::string out(word.substr(0, 16));
    for (char& c : out)
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    return out;
}

/// Text STL as the bytes of a binary one.
std::string binary_from_text(std::string_view bytes, const std::string& name)
{
    std::string out(kStlHeader, '\0');
    Lines lines(bytes);
    std::uint32_t triangles = 0;
    std::uint64_t bad = 0, first_bad = 0, vertices = 0;
    int corners = 0;
    bool in_facet = false, ended = false;
    auto error = [&](const std::string& what) {
        return InvalidInput(fmt::format("{}:{}: {}", name, lines.number(), what));
    };
    for (std::string_view line; lines.next(line);) {
        const std::string_view word = take_word(line);
        const std::string key = lower_case(word);
        if (key == "facet") {
            if (in_facet) throw error("'facet' before the last one's 'endfacet'");
            in_facet = true;
            corners = 0;
            out.append(12, '\0');  // the normal follows from the corners
        } else if (key == "vertex") {
            if (!in_facet) throw error("'vertex' outside of a facet");
            if (++corners > 3) throw error("a facet with more than 3 vertices");
            double v[3];
            for (double& x : v) {
                const std::string_view number = take_word(line);
                if (!to_number(number, x))
                    throw error(fmt::format("'{}', must be a number", shown(number)));
            }
            ++vertices;
            if (!finite_floats(v) && ++bad == 1) first_bad = lines.number();
            for (const double x : v) append32(out, std::bit_cast<std::uint32_t>(float(x)));
        } else if (key == "endfacet") {
            if (corners != 3)
                throw error(fmt::format("a facet of {} vertices, must be 3", corners));
            in_facet = false;
            corners = 0;
            out.append(2, '\0');
            ++triangles;
        } else if (key == "endsolid")
            ended = true;
        else if (key == "solid")
            ended = false;
        else if (!key.empty() && key != "outer" && key != "endloop")
            throw error(
                fmt::format("'{}', expected facet, outer loop, vertex, endloop, endfacet or "
                            "endsolid",
                            shown(word)));
    }
    if (!ended || in_facet)
        throw InvalidInput(fmt::format("{}: truncated: the file of {} lines ends before 'endsolid'",
                                       name, lines.number()));
    if (bad > 0) throw_not_finite(name, bad, vertices, fmt::format("in line {}", first_bad));
    for (std::size_t i = 0; i < 4; ++i) out[80 + i] = static_cast<char>(triangles >> 8 * i & 0xFF);
    return out;
}

}  // namespace

bool looks_like_off(std::string_view bytes)
{
    std::string_view line;
    Lines lines(bytes.substr(0, 4096));
    return next_content(lines, line) && is_off_magic(take_word(line));
}

Polygons read_off(std::string_view bytes, const std::string& name)
{
    Lines lines(bytes);
    auto error = [&](const std::string& what) {
        return InvalidInput(fmt::format("{}:{}: {}", name, lines.number(), what));
    };
    std::string_view line;
    if (!next_content(lines, line) || line.find('\0') != std::string_view::npos)
        throw InvalidInput(fmt::format("{}: not an OFF file: it does not begin with 'OFF'", name));
    const std::string_view magic = take_word(line);
    if (!is_off_magic(magic))
        throw InvalidInput(fmt::format("{}: not an OFF file: it begins with '{}', not with 'OFF'",
                                       name, shown(magic)));
    if (magic.find_first_of("4n") != std::string_view::npos)
        throw error(fmt::format("'{}' has points of other than 3 dimensions", shown(magic)));

    // Counts follow the first word or stand on a line of their own.
    std::string_view word = take_word(line);
    if (word == "BINARY") throw error("binary OFF is not read: write it as text, or as PLY");
    if (word.empty()) {
        if (!next_content(lines, line)) throw error("truncated: no counts of vertices and faces");
        word = take_word(line);
    }
    std::int64_t vertices = 0, faces = 0;
    if (!to_integer(word, vertices) || vertices < 0)
        throw error(fmt::format("number of vertices '{}', must be 0 or more", shown(word)));
    word = take_word(line);
    if (!to_integer(word, faces) || faces < 0)
        throw error(fmt::format("number of faces '{}', must be 0 or more", shown(word)));
    // A vertex is at least "0 0 0" and a line end, a face "3" of them "3 0 0 0".
    const double needed =
        6.0 * static_cast<double>(vertices) + 2.0 * static_cast<double>(faces) - 1;
    if (needed > static_cast<double>(lines.rest().size()))
        throw error(fmt::format(
            "truncated: {} vertices and {} faces need at least {:.0f} bytes, the file has {}",
            vertices, faces, needed + static_cast<double>(bytes.size() - lines.rest().size()),
            bytes.size()));
    if (vertices > std::numeric_limits<std::int32_t>::max() ||
        faces > std::numeric_limits<std::int32_t>::max())
        throw LimitExceeded(fmt::format("{}: {} vertices and {} faces, at most 2.14 billion", name,
                                        vertices, faces));

    Polygons out;
    out.name = name;
    std::string checked = fmt::format("OFF\n{} {} 0\n", vertices, faces);
    std::uint64_t bad = 0, first_bad = 0;
    for (std::int64_t i = 0; i < vertices; ++i) {
        if (!next_content(lines, line))
            throw error(
                fmt::format("truncated: the file ends after {} of {} vertices", i, vertices));
        double v[3];
        for (int k = 0; k < 3; ++k) {
            word = take_word(line);
            if (!to_number(word, v[k]))
                throw error(fmt::format("coordinate {} of vertex {} = '{}', must be a number",
                                        "xyz"[k], i, shown(word)));
            (checked += word) += k < 2 ? ' ' : '\n';
        }
        out.places.push_back(lines.number());
        if (!finite_floats(v) && ++bad == 1) first_bad = lines.number();
    }
    if (bad > 0)
        throw_not_finite(name, bad, static_cast<std::uint64_t>(vertices),
                         fmt::format("in line {}", first_bad));
    std::string polygon;
    for (std::int64_t i = 0; i < faces; ++i) {
        if (!next_content(lines, line))
            throw error(fmt::format("truncated: the file ends after {} of {} faces", i, faces));
        std::int64_t corners = 0;
        word = take_word(line);
        if (!to_integer(word, corners) || corners < 0)
            throw error(fmt::format("face {} has '{}' corners, must be 0 or more", i, shown(word)));
        // Corners repeated in a row are written once: OpenMesh drops a face that has such.
        polygon.clear();
        std::int64_t kept = 0, first = -1, last = -1;
        for (std::int64_t k = 0; k < corners; ++k) {
            std::int64_t index = 0;
            word = take_word(line);
            if (word.empty())
                throw error(fmt::format("face {} of {} corners ends after {}", i, corners, k));
            if (!to_integer(word, index) || index < 0 || index >= vertices)
                throw error(
                    fmt::format("vertex index {}, must be 0 to {}", shown(word), vertices - 1));
            if (k > 0 && (index == last || (k + 1 == corners && index == first))) continue;
            if (k == 0) first = index;
            last = index;
            ++kept;
            fmt::format_to(std::back_inserter(polygon), " {}", index);
        }
        // What follows on the line is a colour.
        checked += fmt::format("{}{}\n", kept, polygon);
    }
    if (next_content(lines, line))
        out.warnings.push_back(
            fmt::format("{}:{}: lines behind the last face are not used", name, lines.number()));
    read_by_openmesh(std::move(checked), ".off", false, static_cast<std::uint64_t>(faces), out);
    if (out.vertices.size() != static_cast<std::size_t>(vertices))
        throw InvalidInput(fmt::format("{}: OpenMesh finds {} of {} vertices", name,
                                       out.vertices.size(), vertices));
    return out;
}

std::string write_off(const TriMesh& mesh, const Progress& progress)
{
    std::string out = fmt::format("OFF\n{} {} 0\n", mesh.vertices.size(), mesh.triangles.size());
    auto to = std::back_inserter(out);
    for (const Vec3f& v : mesh.vertices) {
        progress.check();
        fmt::format_to(to, "{} {} {}\n", v.x, v.y, v.z);
    }
    for (const auto& [a, b, c] : mesh.triangles) {
        progress.check();
        fmt::format_to(to, "3 {} {} {}\n", a, b, c);
    }
    return out;
}

bool looks_like_stl(std::string_view bytes)
{
    if (bytes.size() > kStlHeader && binary_stl_size(bytes) == bytes.size()) return true;
    return begins_like_text_stl(bytes);
}

/// An STL joins its triangles by equal coordinates only, and 1e-17 and 0 are not equal: what is
/// rounding beside the size of the whole becomes zero.
void snap_to_zero(std::string& binary)
{
    float largest = 0;
    auto each = [&](auto&& f) {
        for (std::size_t at = kStlHeader; at + kStlTriangle <= binary.size(); at += kStlTriangle)
            for (std::size_t k = 3; k < 12; ++k) f(binary.data() + at + 4 * k);
    };
    auto value = [](const char* at) {
        float v;
        std::memcpy(&v, at, sizeof v);
        return v;
    };
    each([&](const char* at) { largest = std::max(largest, std::abs(value(at))); });
    each([&](char* at) {
        if (std::abs(value(at)) < 1e-7f * largest) std::memset(at, 0, sizeof(float));
    });
}

Polygons read_stl(std::string_view bytes, const std::string& name)
{
    Polygons out;
    out.name = name;
    const bool exact = bytes.size() >= kStlHeader && binary_stl_size(bytes) == bytes.size();
    std::string checked;
    if (!exact && begins_like_text_stl(bytes))
        checked = binary_from_text(bytes, name);
    else {
        if (bytes.size() < kStlHeader)
            throw InvalidInput(
                fmt::format("{}: truncated: a binary STL has at least {} bytes, the file has {}",
                            name, kStlHeader, bytes.size()));
        const std::uint64_t needed = binary_stl_size(bytes);
        if (needed > bytes.size())
            throw InvalidInput(fmt::format(
                "{}: truncated: the header's {} triangles need {} bytes, the file has {}", name,
                little_endian(bytes, 80), needed, bytes.size()));
        if (needed < bytes.size())
            out.warnings.push_back(fmt::format("{}: {} bytes behind the last triangle are not used",
                                               name, bytes.size() - needed));
        checked = std::string(bytes.substr(0, needed));
        std::uint64_t bad = 0, first = 0;
        for (std::size_t at = kStlHeader; at < needed; at += kStlTriangle)
            for (std::size_t corner = 1; corner <= 3; ++corner) {
                bool finite = true;
                for (std::size_t k = 0; k < 3; ++k)
                    finite = finite && std::isfinite(std::bit_cast<float>(
                                           little_endian(bytes, at + 12 * corner + 4 * k)));
                if (!finite && ++bad == 1) first = at + 12 * corner;
            }
        if (bad > 0)
            throw_not_finite(name, bad, (needed - kStlHeader) / kStlTriangle * 3,
                             fmt::format("at byte {}", first));
    }
    const std::uint64_t triangles = little_endian(checked, 80);
    if (triangles > 0x7FFFFFFF / 3)
        throw LimitExceeded(
            fmt::format("{}: {} triangles, at most 715 million in an STL", name, triangles));
    snap_to_zero(checked);
    read_by_openmesh(std::move(checked), ".stl", true, triangles, out);
    out.merged = 3 * triangles - std::min<std::uint64_t>(3 * triangles, out.vertices.size());
    return out;
}

std::string write_stl(const TriMesh& mesh, const Progress& progress)
{
    if (mesh.triangles.size() > std::numeric_limits<std::uint32_t>::max())
        throw LimitExceeded("stl: more than 4.29 billion triangles");
    std::string out = "Sekitei: metres, z up";  // must not begin with "solid": that means text
    out.resize(80, ' ');
    append32(out, static_cast<std::uint32_t>(mesh.triangles.size()));
    out.reserve(kStlHeader + kStlTriangle * mesh.triangles.size());
    for (const auto& triangle : mesh.triangles) {
        progress.check();
        const Vec3d a(mesh.vertices[triangle[0]]);
        const Vec3f normal(normalized(
            cross(Vec3d(mesh.vertices[triangle[1]]) - a, Vec3d(mesh.vertices[triangle[2]]) - a)));
        for (const Vec3f& v : {normal, mesh.vertices[triangle[0]], mesh.vertices[triangle[1]],
                               mesh.vertices[triangle[2]]})
            for (int k = 0; k < 3; ++k) append32(out, std::bit_cast<std::uint32_t>(v[k]));
        out.append(2, '\0');
    }
    return out;
}

}  // namespace sekitei::mesh_format
