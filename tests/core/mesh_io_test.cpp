#include "core/mesh_io.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "core/error.h"
#include "core/file_output.h"
#include "core/random.h"
#include "tests/core/meshes.h"
#include "tests/support/temporary_folder.h"

namespace sekitei {
namespace {

using meshes::append;
using meshes::box;
using meshes::tetrahedron;
using meshes::torus;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::ThrowsMessage;

/// A torus with every kind of attribute on vertices and faces.
TriMesh decorated()
{
    TriMesh mesh = torus(9, 7);
    std::vector<float> age;
    std::vector<std::int32_t> id, column;
    std::vector<Vec3f> normal, flow;
    std::vector<float> wear;
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
        age.push_back(0.1f * static_cast<float>(i));
        id.push_back(static_cast<std::int32_t>(i) - 3);
        const float k = static_cast<float>(i);
        normal.push_back(normalized(Vec3f(k, 1, 3 - k)));
        flow.emplace_back(k, -k, 0.5f);
    }
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
        column.push_back(t < 20 ? -1 : static_cast<std::int32_t>(t / 30));
        wear.push_back(1.0f / static_cast<float>(t + 1));
    }
    mesh.vertex_attributes = {{"age", age}, {"id", id}, {"normal", normal}, {"flow", flow}};
    mesh.face_attributes = {{"column", column}, {"wear", wear}};
    return mesh;
}

/// The triangles as a sorted list of corner positions: what survives any reordering.
std::vector<std::array<Vec3f, 3>> surface(const TriMesh& mesh)
{
    std::vector<std::array<Vec3f, 3>> all;
    for (const auto& t : mesh.triangles) {
        std::array<Vec3f, 3> p{mesh.vertices[t[0]], mesh.vertices[t[1]], mesh.vertices[t[2]]};
        std::rotate(p.begin(), std::min_element(p.begin(), p.end()), p.end());
        all.push_back(p);
    }
    std::sort(all.begin(), all.end());
    return all;
}

MeshReadReport report_of(std::string_view bytes, const std::string& name)
{
    MeshReadReport report;
    decode_mesh(bytes, name, &report);
    return report;
}

/// A matcher for the message of the InvalidInput that reading these bytes throws.
void expect_refused(std::string_view bytes, const std::string& name, const std::string& message)
{
    try {
        decode_mesh(bytes, name);
        ADD_FAILURE() << name << " was read; expected: " << message;
    } catch (const InvalidInput& error) {
        EXPECT_THAT(error.what(), HasSubstr(message));
    }
}

const std::string kPlyText =
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    "property float z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    "7 -2 11\n10 -2 11\n7 2 11\n7 -2 16\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";
const std::string kObj =
    "v 7 -2 11\nv 10 -2 11\nv 7 2 11\nv 7 -2 16\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
const std::string kOff =
    "OFF\n4 4 0\n7 -2 11\n10 -2 11\n7 2 11\n7 -2 16\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";
std::string stl_text()
{
    std::string out = "solid tetrahedron\n";
    const TriMesh mesh = tetrahedron();
    for (const auto& t : mesh.triangles) {
        out += "  facet normal 0 0 0\n    outer loop\n";
        for (const auto v : t)
            out += fmt::format("      vertex {} {} {}\n", mesh.vertices[v].x, mesh.vertices[v].y,
                               mesh.vertices[v].z);
        out += "    endloop\n  endfacet\n";
    }
    return out + "endsolid tetrahedron\n";
}

std::string replaced(std::string text, const std::string& from, const std::string& to)
{
    const auto at = text.find(from);
    if (at == std::string::npos) throw std::logic_error("nothing to replace: " + from);
    return text.replace(at, from.size(), to);
}

// Round trips
// --------------------------------------------------------------------------------------

TEST(MeshIo, PlyBringsBackEveryAttribute)
{
    const TriMesh mesh = decorated();
    MeshReadReport report;
    const TriMesh back = decode_mesh(encode_mesh(mesh, ".ply"), "a.ply", &report);
    EXPECT_EQ(back.vertices, mesh.vertices);
    EXPECT_EQ(back.triangles, mesh.triangles);
    EXPECT_EQ(back.vertex_attributes, mesh.vertex_attributes);
    EXPECT_EQ(back.face_attributes, mesh.face_attributes);
    EXPECT_THAT(report.warnings, IsEmpty());
    EXPECT_EQ(report.flipped_triangles + report.merged_vertices + report.dropped_zero_area, 0u);
    EXPECT_EQ(encode_mesh(back, ".ply"), encode_mesh(mesh, ".ply"));
}

TEST(MeshIo, ColoursComeBackWithinAByte)
{
    TriMesh mesh = tetrahedron();
    const std::vector<Vec3f> colours{{0, 0.25f, 1}, {1, 0, 0}, {0.5f, 0.5f, 0.5f}, {2, -1, 0.1f}};
    mesh.vertex_attributes["color"] = colours;
    const std::string bytes = encode_mesh(mesh, ".ply");
    EXPECT_THAT(bytes, HasSubstr("property uchar red\n"));
    const auto back =
        std::get<std::vector<Vec3f>>(decode_mesh(bytes, "a.ply").vertex_attributes.at("color"));
    for (int i = 0; i < 4; ++i)
        for (int k = 0; k < 3; ++k)
            EXPECT_NEAR(back[std::size_t(i)][k], std::clamp(colours[std::size_t(i)][k], 0.0f, 1.0f),
                        0.5 / 255 + 1e-6);
    EXPECT_EQ(std::get<std::vector<Vec3f>>(
                  decode_mesh(encode_mesh(mesh, ".obj"), "a.obj").vertex_attributes.at("color")),
              colours);
}

TEST(MeshIo, EveryFormatBringsBackTheSurface)
{
    const TriMesh mesh = decorated();
    for (const std::string extension : {".ply", ".obj", ".stl", ".off"}) {
        MeshReadReport report;
        const TriMesh back = decode_mesh(encode_mesh(mesh, extension), "a" + extension, &report);
        EXPECT_EQ(surface(back), surface(mesh)) << extension;
        EXPECT_EQ(back.vertices.size(), mesh.vertices.size()) << extension;
        EXPECT_TRUE(inspect(back).closed()) << extension;
        EXPECT_EQ(report.flipped_triangles, 0u) << extension;
    }
}

TEST(MeshIo, FilesOnDiskComeBackByContentNotByName)
{
    const TemporaryFolder folder;
    for (const std::string extension : {".ply", ".obj", ".stl", ".off"}) {
        const auto path = folder / ("box" + extension), misnamed = folder / "box.dat";
        write_mesh(path, box({1, 2, 3}, {2, 3, 4}));
        std::filesystem::rename(path, misnamed);
        EXPECT_NEAR(read_mesh(misnamed).signed_volume(), 24, 1e-9) << extension;
    }
}

TEST(MeshIo, ObjGroupsCarryTheColumn)
{
    const TriMesh mesh = decorated();
    const std::string bytes = encode_mesh(mesh, ".obj");
    EXPECT_THAT(bytes, HasSubstr("\ng column_-1\n"));
    EXPECT_THAT(bytes, HasSubstr("\ng column_00002\n"));
    const TriMesh back = decode_mesh(bytes, "a.obj");
    // here the columns rise with the triangles, so that their order survives
    EXPECT_EQ(back.face_attributes.at("column"), mesh.face_attributes.at("column"));
    EXPECT_EQ(back.triangles, mesh.triangles);
}

TEST(MeshIo, FloatsSurviveTextExactly)
{
    TriMesh mesh = tetrahedron();
    mesh.vertices[3] = {0.1f, 1.17549435e-38f, 16777216.0f / 3};
    for (const std::string extension : {".obj", ".off"})
        EXPECT_EQ(surface(decode_mesh(encode_mesh(mesh, extension), "a" + extension)),
                  surface(decode_mesh(encode_mesh(mesh, ".ply"), "a.ply")))
            << extension;
}

struct Glb {
    nlohmann::json json;
    std::string data;

    explicit Glb(const std::string& bytes)
    {
        auto word = [&](std::size_t at) {
            std::uint32_t v = 0;
            std::memcpy(&v, bytes.data() + at, 4);
            return v;
        };
        EXPECT_EQ(bytes.substr(0, 4), "glTF");
        EXPECT_EQ(word(8), bytes.size());
        const std::size_t length = word(12);
        json = nlohmann::json::parse(bytes.substr(20, length));
        data = bytes.substr(28 + length);
        EXPECT_EQ(word(20 + length), data.size());
    }
    float at(const std::string& attribute, std::size_t i, std::size_t k = 0) const
    {
        const auto& accessor =
            json["accessors"]
                [json["meshes"][0]["primitives"][0]["attributes"][attribute].get<std::size_t>()];
        const std::size_t components = accessor["type"] == "VEC3" ? 3 : 1;
        const std::size_t offset =
            json["bufferViews"][accessor["bufferView"].get<std::size_t>()]["byteOffset"];
        float v = 0;
        std::memcpy(&v, data.data() + offset + 4 * (components * i + k), 4);
        return v;
    }
    std::size_t vertices() const { return json["accessors"][0]["count"]; }
};

TEST(MeshIo, GlbPointsYUpAndSplitsVerticesAtColumnBorders)
{
    TriMesh mesh = box({1, 2, 3}, {2, 3, 4});
    mesh.face_attributes["column"] =
        std::vector<std::int32_t>{7, 7, 42, 42, 7, 7, 7, 7, 7, 7, 7, 7};  // the top is another
    mesh.face_attributes["wear"] = std::vector<float>(12, 0.25f);
    mesh.vertex_attributes["age"] = std::vector<float>{0, 1, 2, 3, 4, 5, 6, 7};
    mesh.vertex_attributes["normal"] = std::vector<Vec3f>(8, Vec3f(0, 3, 0));
    const Glb glb(encode_mesh(mesh, ".glb"));
    EXPECT_EQ(glb.vertices(), 12u);  // 8 + the 4 corners of the top again
    int tops = 0;
    for (std::size_t i = 0; i < glb.vertices(); ++i) {
        const float x = glb.at("POSITION", i, 0), y = glb.at("POSITION", i, 1),
                    z = glb.at("POSITION", i, 2);
        EXPECT_TRUE(x == 1 || x == 3);
        EXPECT_TRUE(y == 3 || y == 7) << y;    // our z
        EXPECT_TRUE(z == -2 || z == -5) << z;  // our -y
        tops += glb.at("_COLUMN_ID", i) == 42;
        EXPECT_TRUE(glb.at("_COLUMN_ID", i) == 7 || y == 7);
        EXPECT_EQ(glb.at("_AGE", i), float((x == 3) + 2 * (z == -5) + 4 * (y == 7)));
        EXPECT_EQ(glb.at("_WEAR", i), 0.25f);
        EXPECT_EQ(glb.at("NORMAL", i, 2), -1.0f);  // unit length, turned with the space
    }
    EXPECT_EQ(tops, 4);
    EXPECT_EQ(glb.json["accessors"][0]["min"], nlohmann::json({1.0, 3.0, -5.0}));
    EXPECT_EQ(glb.json["accessors"][0]["max"], nlohmann::json({3.0, 7.0, -2.0}));
}

TEST(MeshIo, RefusesToWriteWhatNobodyCouldRead)
{
    auto refused = [](const TriMesh& mesh, const std::string& message) {
        for (const std::string extension : {".ply", ".obj", ".stl", ".off", ".glb"})
            EXPECT_THAT([&] { encode_mesh(mesh, extension); },
                        ThrowsMessage<InvalidInput>(HasSubstr(message)));
    };
    refused(TriMesh{}, "no triangles");
    TriMesh mesh = tetrahedron();
    mesh.vertices[2].z = INFINITY;
    refused(mesh, "vertex 2 = (7, 2, inf), must be finite");
    mesh = tetrahedron();
    mesh.face_attributes["column"] = std::vector<std::int32_t>(3);
    refused(mesh, "attribute column has 3 values, must be 4, one for each triangle");
    mesh = tetrahedron();
    mesh.triangles[0][0] = 4;
    refused(mesh, "triangle 0 has vertex 4, must be below 4");
    EXPECT_THAT([] { encode_mesh(tetrahedron(), ".fbx"); },
                ThrowsMessage<InvalidParameter>(HasSubstr("'.fbx', must be one of .ply .obj")));
}

TEST(MeshIo, TwoAttributesCannotShareAName)
{
    TriMesh mesh = tetrahedron();
    mesh.vertex_attributes["x"] = std::vector<float>(4);
    EXPECT_THAT([&] { encode_mesh(mesh, ".ply"); },
                ThrowsMessage<InvalidInput>(HasSubstr("'x': rename")));
    mesh = tetrahedron();
    mesh.vertex_attributes["a b"] = mesh.vertex_attributes["a_b"] = std::vector<float>(4);
    EXPECT_THAT([&] { encode_mesh(mesh, ".glb"); },
                ThrowsMessage<InvalidInput>(HasSubstr("_A_B: rename")));
}

// What is mended and reported
// ----------------------------------------------------------------------

TEST(MeshIo, HolesAndFinsAreReadAndLeftToInspect)
{
    const std::string open = replaced(replaced(kPlyText, "face 4", "face 3"), "3 1 2 3\n", "");
    EXPECT_EQ(inspect(decode_mesh(open, "a.ply")).open_edges, 3u);
    for (const std::string& fin :
         {kObj + "v 20 20 20\nf 1 2 5\n",
          replaced(replaced(kOff, "4 4 0", "4 5 0"), "3 1 2 3\n", "3 1 2 3\n3 2 1 3\n")})
        EXPECT_GT(inspect(decode_mesh(fin, "a")).non_manifold_edges +
                      inspect(decode_mesh(fin, "a")).open_edges,
                  0u);
}

TEST(MeshIo, TrianglesWithoutAreaAreDroppedAndCounted)
{
    const std::string obj = kObj + "f 1 1 2\nf 1 2 2\nv 8 -2 11\nf 1 2 5\nf 3 4\n";
    MeshReadReport report;
    const TriMesh mesh = decode_mesh(obj, "a.obj", &report);
    EXPECT_EQ(report.dropped_zero_area, 4u);
    EXPECT_EQ(mesh.triangles.size(), 4u);
    const std::string off =
        replaced(replaced(kOff, "4 4 0", "4 6 0"), "3 0 2 1\n", "3 0 2 1\n3 0 0 1\n3 1 2 1\n");
    EXPECT_EQ(report_of(off, "a.off").dropped_zero_area, 2u);
}

TEST(MeshIo, EqualVerticesAreJoinedUnlessTheirAttributesDiffer)
{
    const std::string doubled = kObj + "v 7 -2 11\nv 7 2 11\nf 5 6 2\n";
    EXPECT_EQ(report_of(doubled, "a.obj").merged_vertices, 2u);
    TriMesh mesh;
    append(mesh, tetrahedron());
    append(mesh, tetrahedron());
    EXPECT_EQ(decode_mesh(encode_mesh(mesh, ".ply"), "a.ply").vertices.size(), 4u);
    mesh.vertex_attributes["side"] = std::vector<std::int32_t>{0, 0, 0, 0, 1, 1, 1, 0};
    const TriMesh back = decode_mesh(encode_mesh(mesh, ".ply"), "a.ply");
    EXPECT_EQ(back.vertices.size(), 7u);
    EXPECT_EQ(std::get<std::vector<std::int32_t>>(back.vertex_attributes.at("side")).size(), 7u);
}

TEST(MeshIo, StlVerticesAreJoined)
{
    for (const std::string& bytes : {stl_text(), encode_mesh(tetrahedron(), ".stl")}) {
        MeshReadReport report;
        const TriMesh mesh = decode_mesh(bytes, "a.stl", &report);
        EXPECT_EQ(mesh.vertices.size(), 4u);
        EXPECT_EQ(report.merged_vertices, 8u);
        EXPECT_NEAR(mesh.signed_volume(), 10, 1e-12);
    }
}

TEST(MeshIo, StlVerticesThatRoundingMovedOffZeroAreJoined)
{
    TriMesh mesh = tetrahedron();
    const Vec3f corner = mesh.vertices[0];
    for (Vec3f& p : mesh.vertices) p -= corner;
    std::string bytes = encode_mesh(mesh, ".stl");
    const std::size_t merged = decode_mesh(bytes, "a.stl").vertices.size();
    // One copy of a coordinate that is zero becomes what a turn by 90 degrees leaves of it.
    int moved = 0;
    for (std::size_t at = 84; at + 50 <= bytes.size() && moved == 0; at += 50)
        for (std::size_t k = 3; k < 12 && moved == 0; ++k) {
            float value;
            std::memcpy(&value, bytes.data() + at + 4 * k, sizeof value);
            if (value != 0) continue;
            const float rounded = 4.4e-17f;
            std::memcpy(bytes.data() + at + 4 * k, &rounded, sizeof rounded);
            ++moved;
        }
    ASSERT_EQ(moved, 1);
    EXPECT_EQ(decode_mesh(bytes, "a.stl").vertices.size(), merged);
}

TEST(MeshIo, AMeshInsideOutIsTurned)
{
    TriMesh mesh;
    append(mesh, box({1, 2, 3}, {2, 3, 4}), true);
    for (const std::string extension : {".ply", ".obj", ".stl", ".off"}) {
        MeshReadReport report;
        const TriMesh back = decode_mesh(encode_mesh(mesh, extension), "a" + extension, &report);
        EXPECT_NEAR(back.signed_volume(), 24, 1e-12);
        EXPECT_EQ(report.flipped_triangles, 12u);
    }
}

TEST(MeshIo, MixedOrientationFollowsTheMajority)
{
    TriMesh mesh = torus(23, 11);
    const double volume = mesh.signed_volume();
    std::size_t turned = 0;
    for (std::size_t t = 0; t < mesh.triangles.size(); t += 1 + t % 5) {
        std::swap(mesh.triangles[t][0], mesh.triangles[t][2]);
        ++turned;
    }
    ASSERT_LT(2 * turned, mesh.triangles.size());
    MeshReadReport report;
    const TriMesh back = decode_mesh(encode_mesh(mesh, ".ply"), "a.ply", &report);
    EXPECT_EQ(report.flipped_triangles, turned);
    EXPECT_TRUE(inspect(back).closed());
    EXPECT_NEAR(back.signed_volume(), volume, 1e-9 * volume);
}

TEST(MeshIo, TheWallOfACavityKeepsItsOrientation)
{
    TriMesh hollow = box({0, 0, 0}, {10, 20, 30});
    append(hollow, box({1, 2, 3}, {2, 3, 4}), true);        // a cavity
    append(hollow, box({1.5f, 3, 4}, {1, 1, 1}));           // a stone in it
    append(hollow, box({100, 100, 100}, {3, 3, 3}), true);  // inside out, alone
    MeshReadReport report;
    TriMesh back = decode_mesh(encode_mesh(hollow, ".ply"), "a.ply", &report);
    EXPECT_EQ(report.flipped_triangles, 12u);
    EXPECT_NEAR(back.signed_volume(), 6000 - 24 + 1 + 27, 1e-6);
    TriMesh inverted;
    append(inverted, hollow, true);
    back = decode_mesh(encode_mesh(inverted, ".ply"), "a.ply", &report);
    EXPECT_NEAR(back.signed_volume(), 6000 - 24 + 1 + 27, 1e-6);
}

TEST(MeshIo, ASurfaceWithOneSideIsReadWithAWarning)
{
    std::string obj;
    constexpr int kSteps = 24;
    for (int i = 0; i < kSteps; ++i) {
        const double u = 2 * std::numbers::pi * i / kSteps;
        for (const double w : {-1.0, 1.0})
            obj += fmt::format("v {} {} {}\n", (5 + w * std::cos(u / 2)) * std::cos(u),
                               (5 + w * std::cos(u / 2)) * std::sin(u), w * std::sin(u / 2));
    }
    for (int i = 0; i < kSteps; ++i) {
        const bool last = i + 1 == kSteps;  // the band closes upside down
        const int a = 2 * i + 1, b = a + 1, c = last ? 2 : a + 2, d = last ? 1 : a + 3;
        obj += fmt::format("f {} {} {}\nf {} {} {}\n", a, c, b, b, c, d);
    }
    EXPECT_THAT(report_of(obj, "a.obj").warnings, Contains(HasSubstr("one side only")));
    EXPECT_THAT(report_of(kObj, "a.obj").warnings, IsEmpty());
}

TEST(MeshIo, QuadsAndConcavePolygonsKeepTheirArea)
{
    // An L of area 12 in the plane y = 2, and an arrow head whose only right diagonal is 1-3.
    const std::string ell = "v 0 2 0\nv 4 2 0\nv 4 2 2\nv 2 2 2\nv 2 2 4\nv 0 2 4\nf 1 2 3 4 5 6\n";
    MeshReadReport report;
    TriMesh mesh = decode_mesh(ell, "a.obj", &report);
    EXPECT_NEAR(mesh.area(), 12, 1e-12);
    EXPECT_EQ(mesh.triangles.size(), 4u);
    EXPECT_EQ(report.split_polygons, 1u);
    EXPECT_EQ(inspect(mesh).misoriented_edges, 0u);
    for (int turn = 0; turn < 4; ++turn) {
        std::string arrow = "v 0 0 0\nv 4 0 3\nv 0 0 9\nv 1 0 3\nf";
        for (int k = 0; k < 4; ++k) arrow += fmt::format(" {}", (k + turn) % 4 + 1);
        EXPECT_NEAR(decode_mesh(arrow, "a.obj").area(), 13.5, 1e-12);
    }
}

TEST(MeshIo, APolygonOfAHundredThousandCornersIsReadAtOnce)
{
    std::string obj, face = "f";
    constexpr int kCorners = 100000;
    for (int i = 0; i < kCorners; ++i) {
        const double u = 2 * std::numbers::pi * i / kCorners;
        obj += fmt::format("v {} {} 5\n", 1000 * std::cos(u), 1000 * std::sin(u));
        face += fmt::format(" {}", i + 1);
    }
    const TriMesh mesh = decode_mesh(obj + face, "a.obj");
    EXPECT_NEAR(mesh.area(), std::numbers::pi * 1e6, 100);
}

TEST(MeshIo, OddSizesAreSuspected)
{
    EXPECT_THAT(report_of(replaced(kObj, "v 7 -2 16", "v 7 -2 2000016"), "a.obj").warnings,
                ElementsAre(HasSubstr("2e+06 m across")));
    const std::string tiny = "v 0 0 0\nv 1e-6 0 0\nv 0 1e-6 0\nf 1 2 3\n";
    EXPECT_THAT(report_of(tiny, "a.obj").warnings, ElementsAre(HasSubstr("1e-06 m across")));
}

// Dialects
// -----------------------------------------------------------------------------------------

TEST(MeshIo, PlyDialectsAreRead)
{
    std::string crlf;
    for (const char c : kPlyText) crlf += c == '\n' ? std::string("\r\n") : std::string(1, c);
    EXPECT_EQ(surface(decode_mesh(crlf, "a.ply")), surface(tetrahedron()));
    EXPECT_EQ(surface(decode_mesh(kPlyText.substr(0, kPlyText.size() - 1), "a.ply")),
              surface(tetrahedron()));

    // Big-endian, doubles, unknown properties, an unused element in front, two lists on a face.
    std::string big =
        "ply\nformat binary_big_endian 1.0\nobj_info x\nelement camera 2\nproperty ushort f\n"
        "property list uchar short d\nelement vertex 4\nproperty double x\nproperty uchar shine\n"
        "property double y\nproperty double z\nproperty list uchar float w\nelement face 4\n"
        "property list int uint vertex_index\nproperty list uchar float texcoord\n"
        "property short part\nend_header\n";
    auto put = [&](auto value) {
        char bytes[sizeof value];
        std::memcpy(bytes, &value, sizeof value);
        std::reverse(bytes, bytes + sizeof value);
        big.append(bytes, sizeof value);
    };
    for (int i = 0; i < 2; ++i) {
        put(std::uint16_t(5));
        put(std::uint8_t(1));
        put(std::int16_t(-3));
    }
    const TriMesh tetra = tetrahedron();
    for (const Vec3f& v : tetra.vertices) {
        put(double(v.x));
        put(std::uint8_t(200));
        put(double(v.y));
        put(double(v.z));
        put(std::uint8_t(1));
        put(0.5f);
    }
    for (const auto& t : tetra.triangles) {
        put(std::int32_t(3));
        for (const std::uint32_t v : t) put(v);
        put(std::uint8_t(2));
        put(0.5f);
        put(0.5f);
        put(std::int16_t(-9));
    }
    MeshReadReport report;
    const TriMesh mesh = decode_mesh(big, "a.ply", &report);
    EXPECT_EQ(surface(mesh), surface(tetra));
    EXPECT_EQ(std::get<std::vector<std::int32_t>>(mesh.vertex_attributes.at("shine"))[3], 200);
    EXPECT_EQ(std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("part"))[2], -9);
    EXPECT_THAT(report.warnings,
                ElementsAre(HasSubstr("'camera'"), HasSubstr("'w'"), HasSubstr("'texcoord'")));
}

TEST(MeshIo, ObjDialectsAreRead)
{
    const std::string text =
        "# a quad, counted back, with texture and normal indices\r\nmtllib none.mtl\r\n"
        "o thing\nusemtl rock\nv 0 0 0 1.0\nv 2 0 0\n  v\t2 3 0\nv 0 +3 0\nvt 0 0\nvn 0 0 1\n"
        "f -4/1/1 -3//1 -2/1 -1 # all four\nusemtl moss\nf 1 \\\n 2 \\\n 3\ng\nl 1 2";
    MeshReadReport report;
    const TriMesh mesh = decode_mesh(text, "a.obj", &report);
    EXPECT_EQ(mesh.triangles.size(), 3u);
    EXPECT_EQ(report.split_polygons, 1u);
    EXPECT_THAT(report.groups, ElementsAre("default"));
    decode_mesh(replaced(text, "\ng\n", "\n"), "a.obj", &report);
    EXPECT_THAT(report.groups, ElementsAre("rock", "moss"));
    EXPECT_EQ(inspect(decode_mesh("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0", "a.obj")).triangles, 1u);
}

/// Texture coordinates of a triangle by position: which corner has which.
std::map<Vec3f, std::pair<float, float>> texture_of(const TriMesh& mesh, std::size_t t)
{
    std::map<Vec3f, std::pair<float, float>> found;
    for (std::size_t k = 0; k < 3; ++k) {
        const Vec3f uv =
            std::get<std::vector<Vec3f>>(mesh.face_attributes.at("uv_" + std::to_string(k)))[t];
        EXPECT_EQ(uv.z, 0);
        found[mesh.vertices[mesh.triangles[t][k]]] = {uv.x, uv.y};
    }
    return found;
}

/// A tetrahedron whose every corner has coordinates of its own: each edge is a seam.
TriMesh seams()
{
    TriMesh mesh = tetrahedron();
    for (int k = 0; k < 3; ++k) {
        std::vector<Vec3f> uv;
        for (int t = 0; t < 4; ++t) uv.emplace_back(0.1f * float(t), 0.3f * float(k) - 1, 0.0f);
        mesh.face_attributes["uv_" + std::to_string(k)] = uv;
    }
    return mesh;
}

TEST(MeshIo, TextureCoordinatesComeBackWithTheirCorners)
{
    TriMesh mesh = seams();
    mesh.face_attributes["part"] = std::vector<std::int32_t>{4, 5, 6, 7};
    for (const bool normals : {false, true}) {
        if (normals) mesh.vertex_attributes["normal"] = std::vector<Vec3f>(4, Vec3f(0, 0, 1));
        for (const char* extension : {".ply", ".obj"}) {
            MeshReadReport report;
            const TriMesh again =
                decode_mesh(encode_mesh(mesh, extension), std::string("a") + extension, &report);
            EXPECT_EQ(again.vertices.size(), 4u);  // seams do not tear the mesh
            ASSERT_EQ(again.triangles.size(), 4u);
            for (std::size_t t = 0; t < 4; ++t)
                EXPECT_EQ(texture_of(again, t), texture_of(mesh, t)) << extension;
            EXPECT_THAT(report.warnings, IsEmpty());
        }
    }
    EXPECT_THAT(encode_mesh(mesh, ".ply"), HasSubstr("property list uchar float texcoord"));
    // Equal pairs are written once.
    const std::string text = encode_mesh(mesh, ".obj");
    std::size_t lines = 0;
    for (std::size_t at = 0; (at = text.find("\nvt ", at)) != std::string::npos; ++at) ++lines;
    EXPECT_EQ(lines, 12u);
    mesh.face_attributes["uv_0"] = mesh.face_attributes["uv_1"] = mesh.face_attributes["uv_2"];
    const std::string fewer = encode_mesh(mesh, ".obj");
    EXPECT_EQ(fewer.find("vt -"), std::string::npos);
    EXPECT_THAT(fewer, HasSubstr("/4/"));
    EXPECT_THAT(fewer, Not(HasSubstr("/5/")));
}

TEST(MeshIo, TheTexturesOfUsedMaterialsAreReported)
{
    const TemporaryFolder folder;
    const auto report = [&](const std::string& begin, const std::string& face) {
        write_file(folder / "a.obj",
                   begin + "v 0 0 0\nv 2 0 0\nv 0 3 0\nvt 0 0\nvt 1 0\nvt 0 1\n" + face);
        MeshReadReport found;
        read_mesh(folder / "a.obj", &found);
        return found;
    };
    const auto textures = [&](const std::string& begin, const std::string& face) {
        return report(begin, face).textures;
    };
    using Paths = std::vector<std::filesystem::path>;
    const std::string face = "f 1/1 2/2 3/3\n";
    write_file(
        folder / "my rock.mtl",
        "newmtl wet rock\r\nKd 1 1 1\r\nmap_Kd -clamp on -s 2 2 -mm 0 1 -o .5 -bm 3 wet rock.png "
        "\r\nmap_Bump bump.png\r\nnewmtl dry\nmap_Kd maps\\dry.png\n");
    write_file(folder / "more.mtl",
               "newmtl dry\n map_Kd b.jpg\nmap_Kd b.jpg\nmap_Kd -s 1 2 3 4.png\n");
    EXPECT_EQ(textures("mtllib my rock.mtl\n", "usemtl wet rock\n" + face),
              Paths{folder / "wet rock.png"});
    EXPECT_EQ(textures("mtllib my rock.mtl\n", "usemtl dry\n" + face),
              Paths{folder / "maps/dry.png"});
    EXPECT_EQ(textures("mtllib my rock.mtl \n", face),
              (Paths{folder / "wet rock.png", folder / "maps/dry.png"}));
    EXPECT_EQ(textures("mtllib my rock.mtl\nmtllib more.mtl\n", "g x\nusemtl dry\n" + face),
              (Paths{folder / "maps/dry.png", folder / "b.jpg", folder / "4.png"}));
    EXPECT_EQ(textures("mtllib my rock.mtl\n", "usemtl other\n" + face), Paths{});
    EXPECT_EQ(textures("mtllib my rock.mtl\n", "f 1 2 3\n"), Paths{}) << "no texture coordinates";
    EXPECT_EQ(report("", face).lost_materials, Paths{});

    // What is not there, or not a file, is reported too.
    const MeshReadReport found = report("mtllib gone.mtl more.mtl ..\n", face);
    EXPECT_EQ(found.lost_materials, (Paths{folder / "gone.mtl", folder / ".."}));
    EXPECT_EQ(found.textures, (Paths{folder / "b.jpg", folder / "4.png"}));

    // Nor do names that no file can have, or very many of them, stop the reader.
    EXPECT_EQ(report("mtllib " + std::string(100'000, 'x') + "\n", face).lost_materials.size(), 1u);
    std::string many;
    for (int i = 0; i < 100'000; ++i) many += "mtllib x\n";
    EXPECT_LE(report(many, face).lost_materials.size(), 100u);
}

TEST(MeshIo, TextureCoordinatesFollowTheirCornersThroughMending)
{
    // A quad beside two triangles, one of them turned; a triangle without area between.
    const std::string text =
        "vt 0 0\nvt 1 0 9\nvt 1 1\nvt 0.25\n"
        "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nv 4 0 0\nv 4 2 0\n"
        "f 1/1 2/2 3/3 4/-1\nf 2/1 2/2 3/3\nf 2/2 3/3 5/4\nf 5/1 6/2/7 3/3\n";
    const TriMesh mesh = decode_mesh(text, "a.obj");
    ASSERT_EQ(mesh.triangles.size(), 4u);
    EXPECT_EQ(inspect(mesh).misoriented_edges, 0u);
    using Corners = std::map<Vec3f, std::pair<float, float>>;
    Corners quad = texture_of(mesh, 0);
    quad.merge(texture_of(mesh, 1));
    EXPECT_EQ(quad, (Corners{{{0, 0, 0}, {0, 0}},
                             {{2, 0, 0}, {1, 0}},
                             {{2, 2, 0}, {1, 1}},
                             {{0, 2, 0}, {0.25f, 0}}}));
    EXPECT_EQ(texture_of(mesh, 2),
              (Corners{{{2, 0, 0}, {1, 0}}, {{2, 2, 0}, {1, 1}}, {{4, 0, 0}, {0.25f, 0}}}));
    EXPECT_EQ(texture_of(mesh, 3),
              (Corners{{{4, 0, 0}, {0, 0}}, {{4, 2, 0}, {1, 0}}, {{2, 2, 0}, {1, 1}}}));
}

TEST(MeshIo, TextureCoordinatesOfVerticesAreHandedToTheCorners)
{
    for (const auto& [u, v] :
         {std::pair("s", "t"), std::pair("u", "v"), std::pair("texture_u", "texture_v")}) {
        const std::string text =
            "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
            "property float z\nproperty float " +
            std::string(u) + "\nproperty double " + v +
            "\nproperty float age\nelement face 2\nproperty list uchar int vertex_indices\n"
            "end_header\n0 0 0 0 0 1\n1 0 0 1 0 1\n0 1 0 0 1 1\n1 0 0 0.5 0 1\n"
            "1 1 0 1 0.5 1\n0 1 0 0 0.25 2\n3 0 1 2\n3 3 4 5\n";
        const TriMesh mesh = decode_mesh(text, "a.ply");
        EXPECT_EQ(mesh.vertices.size(), 5u);  // the seam at (1,0,0) is closed, age keeps (0,1,0)
        EXPECT_EQ(mesh.vertex_attributes.size(), 1u);
        EXPECT_EQ(texture_of(mesh, 1).at({1, 0, 0}), std::pair(0.5f, 0.0f));
        EXPECT_EQ(texture_of(mesh, 0).at({1, 0, 0}), std::pair(1.0f, 0.0f));
        EXPECT_EQ(texture_of(mesh, 1).at({0, 1, 0}), std::pair(0.0f, 0.25f));
    }
}

TEST(MeshIo, MissingTextureCoordinatesAreTold)
{
    MeshReadReport report;
    const TriMesh mesh = decode_mesh(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0.5 0.5\n"
        "f 1 2 3\nf 2/1 4/1 3//2\n",
        "a.obj", &report);
    EXPECT_EQ(texture_of(mesh, 0).at({1, 0, 0}), std::pair(0.0f, 0.0f));
    EXPECT_EQ(texture_of(mesh, 1).at({1, 0, 0}), std::pair(0.5f, 0.5f));
    EXPECT_THAT(report.warnings, ElementsAre(HasSubstr("4 of 6 corners have no texture")));
    // Indices of normals alone are none.
    EXPECT_TRUE(decode_mesh("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//1 3/\n", "a.obj")
                    .face_attributes.empty());
}

TEST(MeshIo, BadTextureCoordinatesAreNamedWithTheirLine)
{
    const std::string begin = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 1\n";
    for (const auto& [text, message] :
         {std::pair("f 1/1 2/2 3/3\nf 1/1 2/2 3/1\n",
                    "a.obj:6: texture index 3, but the file has 2 lines 'vt'"),
          std::pair("f 1/1 2/0 3/1\n", "a.obj:6: texture index 0, must be from 1"),
          std::pair("f 1/1 2/-3 3/1\n", "a.obj:6: texture index -3, must be from 1, or from -2"),
          std::pair("f 1/1 2/x/3 3/1\n", "a.obj:6: '2/x/3', must be a texture index"),
          std::pair("f 1/1 2/99999999999 3/1\n", "a.obj:6: texture index 99999999999"),
          std::pair("vt 0 up\nf 1 2 3\n", "a.obj:6: 'up', must be a number"),
          std::pair("vt\nf 1 2 3\n", "a.obj:6: '', must be a number")})
        EXPECT_THAT([&] { decode_mesh(begin + text, "a.obj"); },
                    ThrowsMessage<InvalidInput>(HasSubstr(message)));
    // Coordinates may come behind the faces that name them.
    EXPECT_EQ(decode_mesh(begin + "f 1/1 2/2 3/3\nvt 5 6\n", "a.obj").triangles.size(), 1u);
}

TEST(MeshIo, ALineOfTenMegabytesIsRead)
{
    EXPECT_EQ(surface(decode_mesh("# " + std::string(10'000'000, 'x') + "\n" + kObj, "a.obj")),
              surface(tetrahedron()));
    EXPECT_EQ(surface(decode_mesh(kObj + "f" + std::string(10'000'000, ' ') + "1 3 2", "a.obj")),
              [] {
                  TriMesh mesh = tetrahedron();
                  mesh.triangles.push_back({0, 2, 1});
                  return surface(mesh);
              }());
}

TEST(MeshIo, OffDialectsAreRead)
{
    const std::string commented = "# made by hand\nOFF # here\n\n4 4 6\n" + kOff.substr(10);
    EXPECT_EQ(surface(decode_mesh(commented, "a.off")), surface(tetrahedron()));
    std::string coloured =
        "COFF 4 4 0\n7 -2 11 255 0 0 255\n10 -2 11 0.5 0.5 0.5 1\n7 2 11 1 2 3\n"
        "7 -2 16 9 9 9 9\n3 0 2 1 0.5 0.5 0.5\n3 0 1 3 7\n3 0 3 2\n3 1 2 3";
    EXPECT_EQ(surface(decode_mesh(coloured, "a.off")), surface(tetrahedron()));
    const TriMesh quads = decode_mesh(
        "OFF\n5 2 0\n0 0 0\n2 0 0\n2 3 0\n0 3 0\n9 9 0\n4 0 1 2 3\n4 2 1 1 4\n", "a.off");
    EXPECT_EQ(quads.triangles.size(), 3u);
}

TEST(MeshIo, StlDialectsAreRead)
{
    std::string loud = stl_text();
    for (char& c : loud)
        if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 32);
    EXPECT_EQ(surface(decode_mesh(loud, "a.stl")), surface(tetrahedron()));
    // A binary file whose title begins with "solid".
    std::string binary = encode_mesh(tetrahedron(), ".stl");
    binary.replace(0, 5, "solid");
    EXPECT_EQ(surface(decode_mesh(binary, "a.dat")), surface(tetrahedron()));
    EXPECT_THAT(report_of(binary + "xx", "a.stl").warnings,
                ElementsAre(HasSubstr("2 bytes behind the last triangle")));
}

// What is refused, each with its good twin
// ---------------------------------------------------------

TEST(MeshIo, TheGoodTwinsAreRead)
{
    for (const std::string& bytes : {kPlyText, kObj, kOff, stl_text()})
        EXPECT_EQ(surface(decode_mesh(bytes, "twin")), surface(tetrahedron()));
    EXPECT_EQ(surface(decode_ply(kPlyText, "twin")), surface(tetrahedron()));
}

TEST(MeshIo, IndicesOutOfRangeAreNamedWithTheirLine)
{
    expect_refused(replaced(kPlyText, "3 0 1 3", "3 0 1 4"), "a.ply",
                   "a.ply:15: face 1 has the vertex index 4, must be 0 to 3");
    expect_refused(replaced(kPlyText, "3 0 1 3", "3 0 -1 3"), "a.ply",
                   "a.ply:15: face 1 has the vertex index -1, must be 0 to 3");
    expect_refused(replaced(kObj, "f 1 2 4", "f 1 2 5"), "a.obj",
                   "a.obj:6: vertex index 5, must be 1 to 4");
    expect_refused(replaced(kObj, "f 1 2 4", "f 1 2 -5"), "a.obj", "a.obj:6: vertex index -5");
    expect_refused(replaced(kObj, "f 1 2 4", "f 1 2 0"), "a.obj", "a.obj:6: vertex index 0");
    expect_refused(replaced(kOff, "3 0 1 3", "3 0 1 4"), "a.off",
                   "a.off:8: vertex index 4, must be 0 to 3");
    expect_refused(replaced(kOff, "3 0 1 3", "3 0 1 -1"), "a.off", "a.off:8: vertex index -1");
    std::string binary = encode_mesh(tetrahedron(), ".ply");
    binary[binary.size() - 1] = 1;
    expect_refused(binary, "a.ply",
                   fmt::format("a.ply: byte {}: face 3 has the vertex index", binary.size() - 13));
}

TEST(MeshIo, VerticesThatAreNoNumbersAreCounted)
{
    for (const std::string bad : {"nan", "inf", "-inf", "1e39", "1e400"}) {
        expect_refused(replaced(kPlyText, "7 2 11", "7 " + bad + " 11"), "a.ply",
                       "a.ply: 1 of 4 vertices are not finite numbers, the first is vertex 2 in "
                       "line 12");
        expect_refused(replaced(kObj, "v 7 2 11", "v 7 " + bad + " 11"), "a.obj",
                       "1 of 4 vertices are not finite numbers, the first is vertex 2 in line 3");
        expect_refused(replaced(kOff, "7 2 11", "7 " + bad + " 11"), "a.off",
                       "1 of 4 vertices are not finite numbers, the first is in line 5");
        expect_refused(replaced(stl_text(), "7 2 11", "7 " + bad + " 11"), "a.stl",
                       "1 of 12 vertices are not finite numbers, the first is in line 5");
    }
    std::string binary = encode_mesh(tetrahedron(), ".stl");
    const float nan = NAN;
    std::memcpy(binary.data() + 96, &nan, 4);
    expect_refused(binary, "a.stl",
                   "1 of 12 vertices are not finite numbers, the first is at byte 96");
    EXPECT_NO_THROW(decode_mesh(replaced(kObj, "v 7 2 11", "v 7 2 1e-400"), "a.obj"));
}

TEST(MeshIo, HeadersThatPromiseTooMuchAreRefusedBeforeAllocation)
{
    expect_refused(replaced(kPlyText, "vertex 4", "vertex 1000000000000"), "a.ply",
                   fmt::format("the header needs at least 6000000000{:03} bytes, the file has {}",
                               173, kPlyText.size() + 12));
    std::string binary = encode_mesh(tetrahedron(), ".ply");
    expect_refused(replaced(binary, "face 4", "face 4000000000000000000"), "a.ply",
                   "the header needs at least 4e+18 bytes");
    expect_refused(replaced(binary, "face 4", "face 40000000000000000000"), "a.ply",
                   "element face has the count '40000000000000000000'");
    expect_refused(replaced(kPlyText, "face 4", "face -4"), "a.ply", "count '-4'");
    expect_refused(
        replaced(kPlyText, "\nelement face", "\nelement empty 999999999999\nelement face"), "a.ply",
        "the header needs at least");
    expect_refused(replaced(kOff, "4 4 0", "999999999999 4 0"), "a.off",
                   "a.off:2: truncated: 999999999999 vertices and 4 faces need at least");
    std::string stl = encode_mesh(tetrahedron(), ".stl");
    stl[83] = 0x7f;
    expect_refused(stl, "a.stl",
                   "truncated: the header's 2130706436 triangles need 106535321884 bytes, the file "
                   "has 284");
    // A list longer than the file.
    const std::string list = replaced(binary, "list uchar", "list int");
    expect_refused(
        list.substr(0, list.size() - 52) + "\xff\xff\xff\x7f" + std::string(60, '\0'), "a.ply",
        "list vertex_indices of 2147483647 entries at byte 245 needs 8589934588 bytes, 60 are");
}

TEST(MeshIo, EveryWriterStopsWhenAsked)
{
    const std::atomic<bool> stop{true};
    const TriMesh mesh = decorated();
    for (const char* extension : {".ply", ".obj", ".stl", ".off", ".glb"})
        EXPECT_THROW(encode_mesh(mesh, extension, Progress({}, &stop)), Cancelled) << extension;
    const auto folder = std::filesystem::path(testing::TempDir()) / "stopped_mesh";
    std::filesystem::create_directory(folder);
    EXPECT_THROW(write_mesh(folder / "a.ply", mesh, Progress({}, &stop)), Cancelled);
    EXPECT_TRUE(std::filesystem::is_empty(folder));
    std::filesystem::remove_all(folder);
}

TEST(MeshIo, TruncatedFilesAreNamed)
{
    const std::string ply = encode_mesh(tetrahedron(), ".ply"),
                      stl = encode_mesh(tetrahedron(), ".stl");
    for (std::size_t length = 8; length < ply.size(); ++length)
        expect_refused(ply.substr(0, length), "a.ply", "a.ply: truncated");
    for (std::size_t length = 1; length < stl.size(); ++length)
        expect_refused(stl.substr(0, length), "a.stl", "a.stl: truncated");
    for (const auto& [bytes, name] : {std::pair{kPlyText, "a.ply"}, {kOff, "a.off"}})
        for (std::size_t length = bytes.find("16") + 2; length + 7 < bytes.size(); length += 3)
            expect_refused(bytes.substr(0, length), name, "");
    expect_refused(stl_text().substr(0, 300), "a.stl", "");
    expect_refused(replaced(stl_text(), "endsolid tetrahedron\n", ""), "a.stl",
                   "truncated: the file of 29 lines ends before 'endsolid'");
}

TEST(MeshIo, WordsThatAreNoNumbersAreNamed)
{
    expect_refused(replaced(kPlyText, "10 -2 11", "10 zwei 11"), "a.ply",
                   "a.ply:11: y = 'zwei', must be a number");
    expect_refused(replaced(kPlyText, "10 -2 11", "10 -2"), "a.ply",
                   "a.ply:11: the line ends before property z of this vertex");
    expect_refused(replaced(kPlyText, "10 -2 11", "10 -2 11 5"), "a.ply",
                   "a.ply:11: '5' behind the last property of this vertex");
    expect_refused(replaced(kPlyText, "3 0 1 3", "300 0 1 3"), "a.ply",
                   "a.ply:15: vertex_indices = 300, must be an integer from 0 to 255");
    expect_refused(replaced(kPlyText, "3 0 1 3", "3 0 1.5 3"), "a.ply", "must be an integer");
    expect_refused(replaced(kObj, "v 10 -2 11", "v 10 -2,5 11"), "a.obj",
                   "a.obj:2: '-2,5', must be a number");
    expect_refused(replaced(kObj, "v 10 -2 11", "v 10 -2"), "a.obj",
                   "a.obj:2: a vertex of 2 numbers, must be 3");
    expect_refused(replaced(kObj, "f 1 2 4", "f 1 2 x"), "a.obj",
                   "a.obj:6: 'x', must be a vertex index");
    expect_refused(replaced(kOff, "10 -2 11", "10 -2"), "a.off",
                   "a.off:4: coordinate z of vertex 1 = '', must be a number");
    expect_refused(replaced(kOff, "3 0 1 3", "3 0 1"), "a.off",
                   "a.off:8: face 1 of 3 corners ends after 2");
    expect_refused(replaced(stl_text(), "7 2 11", "7 2"), "a.stl", "a.stl:5: '', must be a number");
    expect_refused(replaced(stl_text(), "endloop", "end"), "a.stl",
                   "a.stl:7: 'end', expected facet");
}

TEST(MeshIo, HeadersThatMakeNoSenseAreNamed)
{
    expect_refused(replaced(kPlyText, "ascii", "utf8"), "a.ply", "a.ply:2: format 'utf8'");
    expect_refused(replaced(kPlyText, "float z", "real z"), "a.ply", "a.ply:6: type 'real'");
    expect_refused(replaced(kPlyText, "float z", "float y"), "a.ply",
                   "a.ply:6: property y appears twice in element vertex");
    expect_refused(replaced(kPlyText, "float z", "float w"), "a.ply",
                   "a.ply: element vertex has no property 'z'");
    expect_refused(replaced(kPlyText, "int vertex_indices", "float vertex_indices"), "a.ply",
                   "no integer list 'vertex_indices'");
    expect_refused(replaced(kPlyText, "element face", "elephant face"), "a.ply",
                   "a.ply:7: 'elephant'");
    expect_refused("OFF BINARY\n", "a.off", "a.off:1: binary OFF is not read");
    expect_refused(replaced(kOff, "OFF", "4OFF"), "a.off", "other than 3 dimensions");
}

TEST(MeshIo, WhatIsNoSurfaceIsNamed)
{
    expect_refused("", "a.ply", "a.ply: empty file");
    expect_refused("\x89PNG\r\n\x1a\n", "a.ply", "not a PLY file");
    expect_refused("\x89PNG\r\n\x1a\n", "a.png", "a.png: not a mesh that can be read");
    expect_refused(std::string("\x89PNG\r\n\x1a\n\0\0\0\rIHDR", 16), "a.obj", "no OBJ file");
    expect_refused("hello\n", "a.obj", "no vertex in 1 lines");
    expect_refused(kObj.substr(0, kObj.find('f')), "a.obj",
                   "4 vertices and no faces: a surface is needed, not a point cloud");
    expect_refused(kPlyText.substr(0, kPlyText.find("element face")) + "end_header\n" +
                       "7 -2 11\n10 -2 11\n7 2 11\n7 -2 16\n",
                   "a.ply", "not a point cloud");
    expect_refused("v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n", "a.obj",
                   "none of its 1 faces has an area");
    EXPECT_EQ(decode_mesh("v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n", "a.obj").triangles.size(), 1u);
}

TEST(MeshIo, NoMutationDoesWorseThanInvalidInput)
{
    TriMesh mesh = tetrahedron();
    mesh.vertex_attributes["age"] = std::vector<float>{1, 2, 3, 4};
    mesh.face_attributes["column"] = std::vector<std::int32_t>{1, 1, 2, 2};
    const std::pair<std::string, std::string> seeds[] = {{kPlyText, "a.ply"},
                                                         {encode_mesh(mesh, ".ply"), "a.ply"},
                                                         {encode_mesh(mesh, ".obj"), "a.obj"},
                                                         {encode_mesh(seams(), ".ply"), "a.ply"},
                                                         {encode_mesh(seams(), ".obj"), "a.obj"},
                                                         {kOff, "a.off"},
                                                         {stl_text(), "a.stl"},
                                                         {encode_mesh(mesh, ".stl"), "a.stl"}};
    static constexpr std::string_view kAlphabet = "0123456789 -+.\nenfvx#\\/\0\r\t";
    for (const auto& [seed, name] : seeds) {
        std::size_t read = 0, refused = 0;
        for (std::uint64_t i = 0; i < 3000; ++i) {
            const std::uint64_t key = hash2(Stream(name).id, i);
            std::string bytes = seed;
            for (std::uint64_t k = 0; k <= hash2(key, 99) % 4; ++k) {
                const auto draw = [&](std::uint64_t s) { return hash2(key, 10 * k + s); };
                const std::size_t at = draw(0) % bytes.size();
                switch (draw(1) % 5) {
                    case 0:
                        bytes[at] = static_cast<char>(draw(2));
                        break;
                    case 1:
                        bytes[at] = kAlphabet[draw(2) % kAlphabet.size()];
                        break;
                    case 2:
                        bytes.erase(at, 1 + draw(2) % 9);
                        break;
                    case 3:
                        bytes.insert(at, bytes.substr(draw(2) % bytes.size(), draw(3) % 40));
                        break;
                    default:
                        if (draw(2) % 4 == 0) bytes.resize(at);
                }
                if (bytes.empty()) bytes = "x";
            }
            try {
                MeshReadReport report;
                const TriMesh got = decode_mesh(bytes, name, &report);
                ASSERT_FALSE(got.triangles.empty());
                ASSERT_EQ(inspect(got).bad_vertices, 0u);
                ++read;
            } catch (const InvalidInput& error) {
                ASSERT_THAT(error.what(), HasSubstr(name));
                ++refused;
            }
        }
        EXPECT_GT(read, 100u) << name;
        EXPECT_GT(refused, 500u) << name;
    }
}

}  // namespace
}  // namespace sekitei
