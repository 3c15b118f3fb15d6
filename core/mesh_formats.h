#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "core/mesh.h"
#include "core/mesh_io.h"

/// What the readers and writers of single mesh formats share. Not for use outside core/.
namespace sekitei::mesh_format {

/// Polygons as a file gave them, before anything is mended.
struct Polygons {
    std::string name;  ///< of the file, for messages
    std::vector<Vec3f> vertices;
    std::vector<std::uint32_t> corners;  ///< vertex indices, polygon after polygon, all in range
    std::vector<std::uint64_t> ends;     ///< of each polygon: one past its last corner
    std::vector<std::array<float, 2>> texture;  ///< coordinates of each corner, or empty
    std::map<std::string, TriMesh::Attribute> vertex_attributes;
    std::map<std::string, TriMesh::Attribute> face_attributes;  ///< one value a polygon
    std::vector<std::uint64_t> places;  ///< of each vertex: its line, or its byte if `binary`
    bool binary = false;
    std::size_t dropped = 0, merged = 0;  ///< what the reader itself left out or joined
    std::vector<std::string> groups, warnings;
    std::vector<std::string> material_files;  ///< what the lines mtllib of an OBJ say
    std::vector<std::string> materials;       ///< that its faces use
};

Polygons read_ply(std::string_view bytes, const std::string& name);
std::optional<PointsReport> describe_ply_points(std::string_view bytes, const std::string& name);
Polygons read_obj(std::string_view bytes, const std::string& name);
Polygons read_off(std::string_view bytes, const std::string& name);
Polygons read_stl(std::string_view bytes, const std::string& name);

/// The pictures (map_Kd) that these materials of an MTL file have, as written, each once and at
/// most 100; of all its materials where none is named.
std::vector<std::string> material_textures(std::string_view mtl,
                                           const std::vector<std::string>& materials);

bool looks_like_ply(std::string_view bytes);
bool looks_like_off(std::string_view bytes);
bool looks_like_stl(std::string_view bytes);
bool looks_like_obj(std::string_view bytes);

std::string write_ply(const TriMesh& mesh, const Progress& progress);
std::string write_obj(const TriMesh& mesh, const Progress& progress);
std::string write_off(const TriMesh& mesh, const Progress& progress);
std::string write_stl(const TriMesh& mesh, const Progress& progress);
std::string write_glb(const TriMesh& mesh, const Progress& progress);

/// Triangulates, joins equal vertices, drops what has no area, agrees the orientation.
/// @throws InvalidInput  vertices that are not numbers, nothing left
TriMesh mend(Polygons&& polygons, MeshReadReport& report);

/// Text line by line; a line ends with LF, CR LF or the end of the text.
class Lines {
public:
    explicit Lines(std::string_view text) : rest_(text) {}
    bool next(std::string_view& line);
    std::uint64_t number() const { return number_; }  ///< of the line last given, from 1
    std::string_view rest() const { return rest_; }

private:
    std::string_view rest_;
    std::uint64_t number_ = 0;
};

/// Takes the next word, separated by blanks or tabs; empty at the end.
std::string_view take_word(std::string_view& line);

/// Read a whole word as a number, whatever the locale; false if it is none. A number beyond the
/// range of double counts as infinite.
bool to_number(std::string_view word, double& value);
bool to_integer(std::string_view word, std::int64_t& value);

/// A word as shown in messages: short, printable.
std::string shown(std::string_view word);

/// The only words with a meaning of their own: attributes that each format spells its own way.
inline constexpr const char* kNormal = "normal";  ///< Vec3f, unit vectors
inline constexpr const char* kColour = "color";   ///< Vec3f, 0..1
/// Texture coordinates of a face's three corners (Vec3f, z = 0).
inline constexpr const char* kTexture[] = {"uv_0", "uv_1", "uv_2"};

/// The three face attributes kTexture, or null.
template <class Mesh>
auto texture_of(Mesh& mesh)
{
    std::array<decltype(std::get_if<std::vector<Vec3f>>(&mesh.face_attributes.begin()->second)), 3>
        corners{};
    for (std::size_t k = 0; k < 3; ++k) {
        const auto found = mesh.face_attributes.find(kTexture[k]);
        if (found != mesh.face_attributes.end())
            corners[k] = std::get_if<std::vector<Vec3f>>(&found->second);
        if (!corners[k]) return decltype(corners){};
    }
    return corners;
}

}  // namespace sekitei::mesh_format
