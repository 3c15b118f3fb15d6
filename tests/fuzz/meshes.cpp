#include "tests/core/meshes.h"

#include <cmath>

#include "apps/page.h"
#include "core/file_output.h"
#include "core/mesh_io.h"
#include "tests/fuzz/readers.h"

namespace sekitei::fuzz {
namespace {

/// What was read can be inspected, written and read again.
void look_at(const TriMesh& mesh)
{
    const MeshReport seen = inspect(mesh);
    if (seen.triangles == 0 || seen.bad_vertices > 0 || seen.zero_area > 0)
        broken(
            "a mesh without triangles, with a vertex that is not finite or with a triangle "
            "without area was accepted");
    std::string ply;
    if (!accepts("", [&] { ply = encode_mesh(mesh, ".ply"); })) return;  // equal attribute names
    MeshReadReport report;
    if (decode_mesh(ply, "again.ply", &report).triangles.size() != mesh.triangles.size())
        broken("a mesh does not come back as it was written");
}

void read_as(std::string_view bytes, const char* name)
{
    TriMesh mesh;
    MeshReadReport report;
    if (accepts(name, [&] { mesh = decode_mesh(bytes, name, &report); })) look_at(mesh);
}

std::vector<std::string> encoded(std::string_view suffix)
{
    TriMesh shape = meshes::torus(7, 5);
    std::vector<float> light(shape.triangles.size());
    std::vector<std::int32_t> column(shape.triangles.size());
    for (std::size_t i = 0; i < light.size(); ++i) {
        light[i] = static_cast<float>(i) / 3;
        column[i] = static_cast<std::int32_t>(i % 4);
    }
    shape.face_attributes["light"] = light;
    shape.face_attributes["column"] = column;
    shape.vertex_attributes["normal"] = shape.vertices;
    return {encode_mesh(shape, suffix), encode_mesh(meshes::box({-1, 0, 2}, {1, 2, 3}), suffix),
            encode_mesh(meshes::tetrahedron(), suffix)};
}

std::vector<std::string> ply_seeds()
{
    std::vector<std::string> seeds = encoded(".ply");
    seeds.push_back(
        "ply\nformat ascii 1.0\ncomment none\nelement vertex 5\nproperty float x\nproperty double "
        "y\nproperty float z\nproperty float s\nproperty float t\nproperty uchar red\nproperty "
        "uchar green\nproperty uchar blue\nelement face 3\nproperty list uchar int "
        "vertex_indices\nproperty short quality\nelement edge 1\nproperty int vertex1\nproperty "
        "int vertex2\nend_header\n0 0 0 0 0 1 2 3\n1 0 0 .5 0 1 2 3\n1 1 0 1 1 1 2 3\n0 1 0 0 1 1 "
        "2 3\n.5 .5 1e0 0 0 9 9 9\n4 0 1 2 3 -7\n3 0 1 4 1\n3 1 2 4 0\n0 1\n");
    std::string big =
        "ply\r\nformat binary_big_endian 1.0\r\nelement vertex 3\r\nproperty float "
        "x\r\nproperty float y\r\nproperty float z\r\nelement face 1\r\nproperty "
        "list uchar ushort vertex_index\r\nproperty list uchar float "
        "texcoord\r\nend_header\r\n";
    const unsigned char values[] = {
        0,    0, 0, 0, 0,    0,    0, 0, 0, 0, 0, 0, 0x3f, 0x80, 0, 0, 0,    0,    0, 0, 0, 0, 0, 0,
        0,    0, 0, 0, 0x40, 0x00, 0, 0, 0, 0, 0, 0, 3,    0,    0, 0, 1,    0,    2, 6, 0, 0, 0, 0,
        0x3f, 0, 0, 0, 0,    0,    0, 0, 0, 0, 0, 0, 0x3f, 0x80, 0, 0, 0x3f, 0x80, 0, 0};
    big.append(reinterpret_cast<const char*>(values), sizeof values);
    seeds.push_back(big);
    return seeds;
}

std::vector<std::string> obj_seeds()
{
    std::vector<std::string> seeds = encoded(".obj");
    seeds.push_back(
        "# quads, negative indices, texture\nmtllib a.mtl\no thing\ng column_00042\nusemtl "
        "rock\nv 0 0 0 0.5 0.5 0.5\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1\nvt 0 0\nvt 1 0\nvt 1 "
        "1\nvn 0 0 1\ns off\nf 1/1/1 2/2/1 3/3/1 4/3/1\nf -5//1 -4//1 -1//1\ng top\nf 2 3 5 \\\n "
        "4\nl 1 2 3");
    return seeds;
}

std::vector<std::string> off_seeds()
{
    std::vector<std::string> seeds = encoded(".off");
    seeds.push_back(
        "COFF\n# coloured\n4 2 0\n0 0 0 255 0 0 255\n1 0 0 255 0 0 255\n1 1 0 0 1 0 "
        "1\n0 1 0 0 0 0 0\n3 0 1 2\n4 0 1 2 3 0.1 0.2 0.3\n");
    return seeds;
}

std::vector<std::string> stl_seeds()
{
    std::vector<std::string> seeds = encoded(".stl");
    seeds.push_back(
        "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 "
        "1 0\nendloop\nendfacet\nfacet normal 0 0 1\nouter loop\nvertex 1 0 0\nvertex "
        "1 1 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n");
    return seeds;
}

/// Materials are looked up for the pictures they name.
void read_mtl(std::string_view bytes)
{
    static const std::filesystem::path kObj =
        put("m.obj",
            "mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 "
            "1\nf 1/1 2/2 3/3\n");
    put("m.mtl", bytes);
    MeshReadReport report;
    accepts("m.", [&] { read_mesh(kObj, &report); });
}

/// What a page would show.
void read_glb(std::string_view bytes)
{
    accepts("a.glb", [&] { apps::Page("a garden").add("day 1", "a.glb", bytes, {}); });
}

void read_points(std::string_view bytes)
{
    accepts("p.ply", [&] {
        const auto report = describe_points(bytes, "p.ply");
        if (report && report->points > bytes.size()) broken("more points than bytes");
    });
}

std::vector<std::string> points_seeds()
{
    std::string binary =
        "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty double "
        "x\nproperty double y\nproperty double z\nproperty float "
        "pscale\nproperty int id\nend_header\n";
    for (int i = 0; i < 4; ++i) {
        const double p[] = {1.0 * i, 2.0, -3.5};
        const float scale = 0.5f;
        binary.append(reinterpret_cast<const char*>(p), sizeof p);
        binary.append(reinterpret_cast<const char*>(&scale), sizeof scale);
        binary.append(reinterpret_cast<const char*>(&i), sizeof i);
    }
    return {binary,
            "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float "
            "y\nproperty float z\nproperty uchar species\nend_header\n1 2 3 4\nnan inf 0 "
            "255\n"};
}

}  // namespace

std::vector<Reader> mesh_readers()
{
    return {{"ply", [](std::string_view b) { read_as(b, "a.ply"); }, ply_seeds},
            {"obj", [](std::string_view b) { read_as(b, "a.obj"); }, obj_seeds},
            {"off", [](std::string_view b) { read_as(b, "a.off"); }, off_seeds},
            {"stl", [](std::string_view b) { read_as(b, "a.stl"); }, stl_seeds},
            {"glb", read_glb, [] { return encoded(".glb"); }},
            {"mtl", read_mtl,
             [] {
                 return std::vector<std::string>{
                     "newmtl a\nKd 0.5 0.5 0.5\nmap_Kd -s 1 1 1 \"a b.png\"\nnewmtl b\nmap_Kd "
                     "stone.jpg\r\n"};
             }},
            {"points_ply", read_points, points_seeds}};
}

}  // namespace sekitei::fuzz
