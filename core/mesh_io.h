#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"

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
    /// Pictures (map_Kd) that the materials of an OBJ with texture coordinates name, and material
    /// files that it names and that are not there; both found from the OBJ's folder, by
    /// read_mesh().
    std::vector<std::filesystem::path> textures, lost_materials;
};

/// Reads PLY (ascii, both binary orders), OBJ, STL (ascii, binary) or OFF, chosen by content, then
/// by name.
///
/// The header is checked against the file's size, and every index against the vertices, before
/// anything is built; OpenMesh reads OFF and STL. Scalar properties of PLY come back as attributes
/// (integers as int32, others as float; NAME_x, NAME_y, NAME_z as one Vec3f; nx, ny, nz as
/// `normal`; red, green, blue as `color` in 0..1). Groups `column_00042` of OBJ come back as
/// `column`.
///
/// Texture coordinates belong to the corners of faces, since a seam gives one vertex two of them:
/// lines `vt` of OBJ, and of PLY the list `texcoord` of a face or else the vertex properties (s,
/// t), (u, v), (texture_u, texture_v) or (texture_s, texture_t), come back as the face attributes
/// uv_0, uv_1 and uv_2 (Vec3f, z = 0), one for each corner, and go out the same way. The picture
/// itself, `map_Kd` of a material, is only reported.
///
/// Zero-area triangles and vertices with equal position and attributes are dropped and counted.
/// Neighbours are made to agree in orientation, and closed pieces turned to positive volume unless
/// they wall a cavity. Holes and non-manifold edges stay; inspect() counts them.
/// @param report  what was mended; if null, warnings go to the log
/// @throws InvalidInput  file:line or byte, value, what was expected
TriMesh read_mesh(const std::filesystem::path& path, MeshReadReport* report = nullptr);

/// The same from bytes; `name` chooses the format where content does not, and is used in messages.
TriMesh decode_mesh(std::string_view bytes, const std::string& name,
                    MeshReadReport* report = nullptr);

/// Writes by extension: .ply (binary little endian, all attributes), .obj (one `g column_00042` a
/// column, when the face attribute `column` exists), .stl (binary), .off, .glb (glTF 2.0, y up,
/// custom attributes as _NAME vertex attributes, `column` as _COLUMN_ID; vertices split where an
/// int32 face attribute changes, other face attributes averaged over the faces at a vertex).
///
/// The vertex attributes `normal` and `color` (Vec3f) become what each format has for them; other
/// vectors keep their z-up components.
/// @throws InvalidInput  no triangles, vertices not finite, attributes of the wrong length
/// @throws InvalidParameter  unknown extension
/// @throws IoError
/// @throws Cancelled  from `progress`; the target is left as it was
void write_mesh(const std::filesystem::path& path, const TriMesh& mesh,
                const Progress& progress = {});

/// The bytes write_mesh() would write; `extension` with its dot.
std::string encode_mesh(const TriMesh& mesh, std::string_view extension,
                        const Progress& progress = {});

/// Reads PLY bytes (for pipes); `name` is used in messages.
TriMesh decode_ply(std::string_view bytes, const std::string& name);

/// Points as a PLY file holds them.
struct PointsReport {
    /// A scalar property of all points, as the file names it.
    struct Property {
        std::string name, type;  ///< type: char uchar short ushort int uint float double
        double least = std::numeric_limits<double>::infinity();  ///< of the finite values
        double most = -std::numeric_limits<double>::infinity();  ///< below `least`: there are none
        std::uint64_t not_finite = 0;                            ///< NaN and infinities
    };
    std::uint64_t points = 0;
    std::vector<Property> properties;  ///< in the order of the file, the coordinates among them
    std::vector<std::string> warnings;
};

/// Looks through a PLY file that has points and no faces; nothing if it is another file.
/// @throws InvalidInput  as read_mesh()
std::optional<PointsReport> describe_points(std::string_view bytes, const std::string& name);

}  // namespace sekitei
