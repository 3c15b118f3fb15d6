#include "core/mesh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/error.h"
#include "core/mesh_parts.h"
#include "core/parallel.h"
#include "tests/core/meshes.h"

namespace sekitei {
namespace {

using meshes::append;
using meshes::box;
using meshes::tetrahedron;
using meshes::torus;
using testing::HasSubstr;
using testing::ThrowsMessage;

TEST(Mesh, MeasuresATetrahedronWhereverItStands)
{
    const TriMesh mesh = tetrahedron();
    const MeshReport report = inspect(mesh);
    EXPECT_NEAR(mesh.signed_volume(), 10, 1e-12);
    EXPECT_NEAR(report.volume, 10, 1e-12);
    const double slant = std::sqrt(20.0 * 20 + 15 * 15 + 12 * 12) / 2;
    EXPECT_NEAR(mesh.area(), 6 + 7.5 + 10 + slant, 1e-12);
    EXPECT_NEAR(report.least_area, 6, 1e-12);
    EXPECT_TRUE(report.closed());
    EXPECT_EQ(report.genus(), 0);
    EXPECT_EQ(report.pieces, 1u);
    EXPECT_EQ(mesh.bounds().lower, Vec3d(7, -2, 11));
    EXPECT_EQ(mesh.bounds().upper, Vec3d(10, 2, 16));
}

TEST(Mesh, VolumeSurvivesAPlaceFarFromTheOrigin)
{
    EXPECT_NEAR(box({100000, -200000, 5000}, {2, 3, 4}).signed_volume(), 24, 1e-9);
}

TEST(Mesh, VolumeIsNegativeInsideOut)
{
    TriMesh mesh;
    append(mesh, box({1, 2, 3}, {2, 3, 4}), true);
    EXPECT_NEAR(mesh.signed_volume(), -24, 1e-12);
}

TEST(Mesh, CountsTheEdgesOfAHole)
{
    TriMesh mesh = box({1, 2, 3}, {2, 3, 4});
    mesh.triangles.pop_back();
    const MeshReport report = inspect(mesh);
    EXPECT_EQ(report.open_edges, 3u);
    EXPECT_EQ(report.non_manifold_edges, 0u);
    EXPECT_FALSE(report.closed());
    EXPECT_EQ(report.euler, 1);
}

TEST(Mesh, CountsEdgesOfMoreThanTwoTriangles)
{
    TriMesh mesh = tetrahedron();
    mesh.vertices.emplace_back(20.0f, 20.0f, 20.0f);
    mesh.triangles.push_back({0, 1, 4});  // a fin on edge 0-1
    const MeshReport report = inspect(mesh);
    EXPECT_EQ(report.non_manifold_edges, 1u);
    EXPECT_EQ(report.open_edges, 2u);
    EXPECT_EQ(report.pieces, 1u);
}

TEST(Mesh, CountsEdgesWhoseTrianglesDisagree)
{
    TriMesh mesh = tetrahedron();
    std::swap(mesh.triangles[2][0], mesh.triangles[2][1]);
    const MeshReport report = inspect(mesh);
    EXPECT_EQ(report.misoriented_edges, 3u);
    EXPECT_FALSE(report.closed());
}

TEST(Mesh, FindsTheHoleOfATorus)
{
    const MeshReport report = inspect(torus(23, 11));
    EXPECT_TRUE(report.closed());
    EXPECT_EQ(report.euler, 0);
    EXPECT_EQ(report.genus(), 1);
    EXPECT_GT(report.volume, 0);
}

TEST(Mesh, CountsPiecesAndTheirGenus)
{
    TriMesh mesh = torus(17, 9);
    append(mesh, box({40, 0, 0}, {1, 2, 3}));
    const MeshReport report = inspect(mesh);
    EXPECT_EQ(report.pieces, 2u);
    EXPECT_EQ(report.genus(), 1);
}

TEST(Mesh, CountsWhatHasNoArea)
{
    TriMesh mesh = tetrahedron();
    mesh.vertices.emplace_back(1.0f, 1.0f, 1.0f);  // used by nothing
    mesh.triangles.push_back({1, 1, 2});
    const MeshReport report = inspect(mesh);
    EXPECT_EQ(report.zero_area, 1u);
    EXPECT_EQ(report.least_area, 0);
    EXPECT_EQ(report.isolated_vertices, 1u);
    EXPECT_TRUE(report.closed());
    EXPECT_EQ(report.genus(), 0);
}

TEST(Mesh, CountsVerticesThatAreNoNumbers)
{
    TriMesh mesh = tetrahedron();
    mesh.vertices[3].y = NAN;
    const MeshReport report = inspect(mesh);
    EXPECT_EQ(report.bad_vertices, 1u);
    EXPECT_TRUE(std::isfinite(report.area));
}

TEST(Mesh, AnEmptyMeshIsReportedEmpty)
{
    const MeshReport report = inspect(TriMesh{});
    EXPECT_EQ(report.triangles, 0u);
    EXPECT_EQ(report.pieces, 0u);
    EXPECT_EQ(report.area, 0);
}

TEST(Mesh, NamesATriangleWithoutItsVertex)
{
    TriMesh mesh = tetrahedron();
    mesh.triangles[1][2] = 9;
    EXPECT_THAT([&] { inspect(mesh); },
                ThrowsMessage<InvalidInput>(HasSubstr("triangle 1 has vertex 9, must be below 4")));
}

TEST(Mesh, APartKeepsItsTrianglesVerticesAndAttributes)
{
    TriMesh mesh = tetrahedron();
    mesh.vertex_attributes["height"] = std::vector<float>{10, 11, 12, 13};
    mesh.face_attributes["column"] = std::vector<std::int32_t>{5, 6, 7, 8};
    const std::vector<std::uint8_t> kept{0, 1, 0, 0};
    const TriMesh part = part_of(mesh, kept);
    ASSERT_EQ(part.triangles.size(), 1u);
    ASSERT_EQ(part.vertices.size(), 3u);
    for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t was = mesh.triangles[1][k], is = part.triangles[0][k];
        EXPECT_EQ(part.vertices[is], mesh.vertices[was]);
        EXPECT_EQ(std::get<std::vector<float>>(part.vertex_attributes.at("height"))[is],
                  10 + float(was));
    }
    EXPECT_EQ(std::get<std::vector<std::int32_t>>(part.face_attributes.at("column")),
              (std::vector<std::int32_t>{6}));
    EXPECT_THAT([&] { part_of(mesh, std::vector<std::uint8_t>(3)); },
                ThrowsMessage<InvalidInput>(HasSubstr("3 numbers for 4 triangles")));
}

TEST(Mesh, MeasuresAreTheSameOnAnyNumberOfThreads)
{
    const TriMesh mesh = torus(211, 97);
    const double volume = mesh.signed_volume(), area = mesh.area();
    for (const std::size_t threads : {1u, 2u, 7u}) {
        const ThreadLimit limit(threads);
        EXPECT_EQ(mesh.signed_volume(), volume);
        EXPECT_EQ(mesh.area(), area);
    }
}

}  // namespace
}  // namespace sekitei
