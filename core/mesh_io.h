#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/mesh.h"

/// Mesh files in and out.
namespace sekitei {

/// What reading had to mend or wants to say.
struct MeshReadReport {
    std::size_t dropped_zero_area = 0;  ///< triangles without area
    std::size_t merged_vertices = 0;    ///< duplicates joined (STL always; others exact duplicates)
    std::size_t split_polygons = 0;     ///< quads and n-gons triangulated
    std::size_t flipped_triangles = 0;  ///< reoriented so that all agree and the volume is positive
    std::vector<std::string> warnings;  ///< e.g. a size of 1e-6 m, unknown properties
    std::vector<std::string> groups;  ///< OBJ groups / materials; face attribute "group" indexes it
};

/// Reads PLY (ascii, both binary orders), OBJ, STL (ascii, binary) or OFF, chosen by content, then
/// by name.
///
/// The header is checked against the file's size before anything is allocated; OpenMesh then reads.
/// Named vertex/face properties of our own PLY files (float and int32) come back as attributes.
/// Zero-area triangles and duplicate vertices are dropped and counted; orientation is made
/// consistent.
/// @throws InvalidInput  file:line or byte, value, what was expected
TriMesh read_mesh(const std::filesystem::path& path, MeshReadReport* report = nullptr);

/// Writes by extension: .ply (binary little endian, all attributes), .obj (one `g column_00042` a
/// column, when the face attribute `column` exists), .stl (binary), .off, .glb (glTF 2.0, y up,
/// custom attributes as _NAME vertex attributes, vertices split where `column` changes).
/// @throws InvalidParameter  unknown extension; IoError
void write_mesh(const std::filesystem::path& path, const TriMesh& mesh);

/// The bytes write_mesh() would write; `extension` with its dot.
std::string encode_mesh(const TriMesh& mesh, std::string_view extension);

/// Reads PLY bytes (for pipes); `name` is used in messages.
TriMesh decode_ply(std::string_view bytes, const std::string& name);

}  // namespace sekitei
