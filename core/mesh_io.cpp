#include "core/mesh_io.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/mesh_formats.h"

namespace sekitei {
namespace mesh_format {

bool Lines::next(std::string_view& line)
{
    if (rest_.empty()) return false;
    const std::size_t end = std::min(rest_.find('\n'), rest_.size());
    line = rest_.substr(0, end);
    rest_.remove_prefix(std::min(end + 1, rest_.size()));
    if (line.ends_with('\r')) line.remove_suffix(1);
    ++number_;
    return true;
}

std::string_view take_word(std::string_view& line)
{
    const auto blank = [](char c) { return c == ' ' || c == '\t'; };
    std::size_t begin = 0;
    while (begin < line.size() && blank(line[begin])) ++begin;
    std::size_t end = begin;
    while (end < line.size() && !blank(line[end])) ++end;
    const std::string_view word = line.substr(begin, end - begin);
    line.remove_prefix(end);
    return word;
}

bool to_number(std::string_view word, double& value)
{
    if (word.starts_with('+')) word.remove_prefix(1);
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (word.empty() || word.starts_with('+') || end != word.data() + word.size()) return false;
    if (error == std::errc::result_out_of_range) {
        const std::size_t exponent = word.find_first_of("eE");
        const bool tiny = exponent != std::string_view::npos
                              ? word.substr(exponent + 1).starts_with('-')
                              : word.find_first_of("123456789") > word.find('.');
        value = tiny ? 0.0 : INFINITY;
        return true;
    }
    return error == std::errc{};
}

bool to_integer(std::string_view word, std::int64_t& value)
{
    if (word.starts_with('+')) word.remove_prefix(1);
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    return error == std::errc{} && !word.empty() && end == word.data() + word.size();
}

std::string shown(std::string_view word)
{
    std::string out;
    for (const char c : word.substr(0, 40))
        out += static_cast<unsigned char>(c) < ' ' || c == 127 ? '?' : c;
    if (word.size() > 40) out += "...";
    return out;
}

}  // namespace mesh_format

namespace {

using namespace mesh_format;

std::string extension_of(const std::filesystem::path& path)
{
    std::string extension = path.extension().string();
    for (char& c : extension)
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    return extension;
}

Polygons read_polygons(std::string_view bytes, const std::string& name)
{
    if (bytes.empty()) throw InvalidInput(fmt::format("{}: empty file, expected a mesh", name));
    // What the first bytes say beats the name; binary STL begins with anything and comes last.
    const std::string extension = extension_of(name);
    if (looks_like_ply(bytes)) return read_ply(bytes, name);
    if (looks_like_off(bytes)) return read_off(bytes, name);
    if (extension == ".stl" || looks_like_stl(bytes)) return read_stl(bytes, name);
    if (extension == ".obj" || looks_like_obj(bytes)) return read_obj(bytes, name);
    if (extension == ".ply") return read_ply(bytes, name);
    if (extension == ".off") return read_off(bytes, name);
    throw InvalidInput(
        fmt::format("{}: not a mesh that can be read: expected PLY, OBJ, STL or OFF", name));
}

/// Refuses what no reader of the file could take.
void check(const TriMesh& mesh)
{
    if (mesh.triangles.empty()) throw InvalidInput("mesh: no triangles, nothing to write");
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
        const Vec3f& v = mesh.vertices[i];
        if (!std::isfinite(v.x) || !std::isfinite(v.y) || !std::isfinite(v.z))
            throw InvalidInput(
                fmt::format("mesh: vertex {} = ({}, {}, {}), must be finite", i, v.x, v.y, v.z));
    }
    if (mesh.vertices.size() > 0x7FFFFFFF)
        throw LimitExceeded(
            fmt::format("mesh: {} vertices, at most 2.14 billion in a file", mesh.vertices.size()));
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
        for (const std::uint32_t v : mesh.triangles[t])
            if (v >= mesh.vertices.size())
                throw InvalidInput(fmt::format("mesh: triangle {} has vertex {}, must be below {}",
                                               t, v, mesh.vertices.size()));
    auto check_attributes = [](const auto& attributes, std::size_t count, const char* what) {
        for (const auto& [name, attribute] : attributes) {
            const std::size_t size =
                std::visit([](const auto& values) { return values.size(); }, attribute);
            if (size != count)
                throw InvalidInput(
                    fmt::format("mesh: attribute {} has {} values, must be {}, one "
                                "for each {}",
                                name, size, count, what));
        }
    };
    check_attributes(mesh.vertex_attributes, mesh.vertices.size(), "vertex");
    check_attributes(mesh.face_attributes, mesh.triangles.size(), "triangle");
}

/// Looks into the material files of an OBJ at `path` for pictures.
void find_textures(const std::filesystem::path& path, const std::vector<std::string>& files,
                   const std::vector<std::string>& materials, MeshReadReport& report)
{
    constexpr std::uint64_t kLargestMaterials = 16u << 20;
    const std::filesystem::path folder = path.parent_path();
    std::error_code unknown;
    for (const std::string& line : files) {
        // A line is one name with blanks in it or several names.
        std::vector<std::string> names{line};
        if (!std::filesystem::exists(folder / line, unknown)) {
            names.clear();
            std::string_view rest = line;
            for (std::string_view word = take_word(rest); !word.empty(); word = take_word(rest))
                names.emplace_back(word);
        }
        for (const std::string& name : names) try {
                const std::string bytes = read_file(folder / name, kLargestMaterials);
                for (const std::string& texture : material_textures(bytes, materials))
                    if (std::ranges::count(report.textures, folder / texture) == 0)
                        report.textures.push_back(folder / texture);
            } catch (const InvalidInput&) {
                report.lost_materials.push_back(folder / name);
            }
    }
}

TriMesh mend_reported(Polygons&& polygons, MeshReadReport* report)
{
    MeshReadReport own;
    TriMesh mesh = mend(std::move(polygons), own);
    if (report)
        *report = std::move(own);
    else
        for (const std::string& warning : own.warnings) log::warning("{}", warning);
    return mesh;
}

}  // namespace

TriMesh decode_mesh(std::string_view bytes, const std::string& name, MeshReadReport* report)
{
    return mend_reported(read_polygons(bytes, name), report);
}

TriMesh read_mesh(const std::filesystem::path& path, MeshReadReport* report)
{
    Polygons polygons = read_polygons(read_file(path), path.string());
    const bool textured = !polygons.texture.empty();
    const std::vector<std::string> files = std::move(polygons.material_files),
                                   materials = std::move(polygons.materials);
    TriMesh mesh = mend_reported(std::move(polygons), report);
    if (report && textured) find_textures(path, files, materials, *report);
    return mesh;
}

TriMesh decode_ply(std::string_view bytes, const std::string& name)
{
    return mend_reported(read_ply(bytes, name), nullptr);
}

std::optional<PointsReport> describe_points(std::string_view bytes, const std::string& name)
{
    if (!looks_like_ply(bytes)) return std::nullopt;
    return describe_ply_points(bytes, name);
}

std::string encode_mesh(const TriMesh& mesh, std::string_view extension, const Progress& progress)
{
    check(mesh);
    if (extension == ".ply") return write_ply(mesh, progress);
    if (extension == ".obj") return write_obj(mesh, progress);
    if (extension == ".stl") return write_stl(mesh, progress);
    if (extension == ".off") return write_off(mesh, progress);
    if (extension == ".glb") return write_glb(mesh, progress);
    throw InvalidParameter(fmt::format(
        "mesh file extension '{}', must be one of .ply .obj .stl .off .glb", extension));
}

void write_mesh(const std::filesystem::path& path, const TriMesh& mesh, const Progress& progress)
{
    write_file(path, encode_mesh(mesh, extension_of(path), progress), progress);
}

}  // namespace sekitei
