#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>

#include "core/mesh_io.h"
#include "core/mesh_sites.h"

/// The meshes of data/ are what their README says.
namespace sekitei {
namespace {

const std::filesystem::path kMeshes = std::filesystem::path(SEKITEI_DATA) / "meshes";

struct Scene {
    TriMesh mesh;
    MeshSites sites;

    Scene(const std::string& name, double edge)
    {
        MeshReadReport report;
        mesh = read_mesh(kMeshes / name, &report);
        EXPECT_TRUE(report.warnings.empty());
        EXPECT_EQ(report.flipped_triangles, 0u);
        EXPECT_EQ(report.dropped_zero_area, 0u);
        sites = mesh_sites(mesh, edge, Progress());
    }
    std::int32_t geology(std::size_t site) const
    {
        return std::get<std::vector<std::int32_t>>(
            mesh.face_attributes.at("geology"))[sites.face[site]];
    }
    /// Area of the sites of one soil that `chosen` takes [m^2].
    double area(std::int32_t soil, const std::function<bool(Vec3f, Vec3f)>& chosen) const
    {
        double sum = 0;
        for (std::size_t i = 0; i < sites.size(); ++i)
            if (geology(i) == soil && chosen(sites.position[i], sites.normal[i]))
                sum += double(sites.area[i]);
        return sum;
    }
};

TEST(MeshScenes, TheRoofHasTheZonesOfItsTable)
{
    const Scene roof("roof2x2.ply", 0.12);
    EXPECT_NEAR(length(roof.mesh.bounds().size()) / 2, 1.7066, 1e-4);
    EXPECT_NEAR(roof.mesh.signed_volume(), 2 * 2 * 0.3 + 2 * 0.1 * 1.5 + 2 * 1 * 0.1, 1e-6);
    EXPECT_EQ(inspect(roof.mesh).open_edges, 0u);
    EXPECT_EQ(inspect(roof.mesh).misoriented_edges, 0u);
    const auto up = [](Vec3f n) { return n.z > 0.9F; };
    EXPECT_NEAR(roof.area(1, [&](Vec3f p, Vec3f n) { return up(n) && p.y < -1; }), 2, 1e-5);
    EXPECT_NEAR(roof.area(1, [&](Vec3f p, Vec3f n) { return up(n) && p.y > -1; }), 2, 1e-5);
    EXPECT_NEAR(roof.area(2, [&](Vec3f p, Vec3f n) { return n.y < -0.9F && p.y > -0.5F; }), 3,
                1e-5);
    EXPECT_NEAR(roof.area(2, [&](Vec3f p, Vec3f n) { return n.z < -0.9F && p.z > 1; }), 2, 1e-5);
    EXPECT_NEAR(roof.area(2, [&](Vec3f p, Vec3f n) { return up(n) && p.y < 0; }), 2, 1e-5);
    // The far side is +y: under the roof, before the wall.
    EXPECT_NEAR(roof.area(2, [&](Vec3f p, Vec3f) { return p.y < -1.001F; }), 0, 0);
}

TEST(MeshScenes, TheCoversLetThroughWhatTheirNamesSay)
{
    for (const int share : {0, 5, 10, 20, 40, 80, 100}) {
        const Scene shade("shade_" +
                              std::string(share < 10    ? "00"
                                          : share < 100 ? "0"
                                                        : "") +
                              std::to_string(share) + ".ply",
                          3);
        // A whole number of pitches of 2.04 x 2.04 m, all slats looking up.
        const double cover = shade.area(
            3, [](Vec3f p, Vec3f n) { return n.z == 1 && std::abs(p.z - 2.40F) < 0.01F; });
        EXPECT_NEAR(cover / (2.04 * 2.04), 1 - share / 100.0, 1e-5) << share;
        EXPECT_EQ(shade.area(3, [](Vec3f, Vec3f n) { return n.z != 1; }), 0);
        EXPECT_NEAR(shade.area(1, [](Vec3f p, Vec3f n) { return n.z > 0.9F && p.z == 0; }), 4,
                    1e-5);
    }
}

TEST(MeshScenes, TheBoulderIsClosedAndStandsInTheGround)
{
    const Scene boulder("boulder.ply", 0.2);
    const MeshReport report = inspect(boulder.mesh);
    EXPECT_TRUE(report.closed());
    EXPECT_EQ(report.pieces, 2u);
    EXPECT_EQ(report.genus(), 0);
    EXPECT_EQ(report.triangles, 22944u);
    const double ground = 2.4 * 2.4 * 0.3;
    EXPECT_NEAR(report.volume - ground, 4.0 / 3 * 3.14159 * 0.125, 0.15);
    double lowest = 1;
    for (std::size_t i = 0; i < boulder.sites.size(); ++i)
        if (boulder.geology(i) == 3) lowest = std::min(lowest, double(boulder.sites.position[i].z));
    EXPECT_NEAR(lowest, -0.06, 0.01);
}

}  // namespace
}  // namespace sekitei
