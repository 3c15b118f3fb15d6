#include "core/mesh_sites.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <random>
#include <set>

#include "core/error.h"
#include "core/log.h"
#include "core/mesh_io.h"
#include "core/parallel.h"
#include "tests/core/meshes.h"

namespace sekitei {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;

MeshSites divided(const TriMesh& mesh, double longest_edge)
{
    return mesh_sites(mesh, longest_edge, Progress());
}

double longest_edge_of(const TriMesh& mesh)
{
    double longest = 0;
    for (const auto& t : mesh.triangles)
        for (std::size_t k = 0; k < 3; ++k)
            longest = std::max(
                longest, length(Vec3d(mesh.vertices[t[k]]) - Vec3d(mesh.vertices[t[(k + 1) % 3]])));
    return longest;
}

/// Largest distance of a site's corner from the plane of the face it lies in [m].
double off_plane(const TriMesh& mesh, const MeshSites& sites)
{
    double worst = 0;
    for (std::size_t i = 0; i < sites.size(); ++i) {
        const auto& [a, b, c] = mesh.triangles[sites.face[i]];
        const Vec3d origin(mesh.vertices[a]);
        const Vec3d normal =
            normalized(cross(Vec3d(mesh.vertices[b]) - origin, Vec3d(mesh.vertices[c]) - origin));
        for (const std::uint32_t v : sites.mesh.triangles[i])
            worst = std::max(worst, std::abs(dot(normal, Vec3d(sites.mesh.vertices[v]) - origin)));
    }
    return worst;
}

double area_of(const MeshSites& sites)
{
    double sum = 0;
    for (const float a : sites.area) sum += double(a);
    return sum;
}

/// Sites that share a corner, by looking at all pairs.
std::vector<std::vector<std::uint32_t>> neighbours_by_brute_force(const TriMesh& mesh)
{
    std::vector<std::vector<std::uint32_t>> found(mesh.triangles.size());
    for (std::uint32_t i = 0; i < mesh.triangles.size(); ++i)
        for (std::uint32_t j = 0; j < mesh.triangles.size(); ++j)
            if (i != j && std::any_of(mesh.triangles[i].begin(), mesh.triangles[i].end(),
                                      [&](std::uint32_t v) {
                                          return std::ranges::count(mesh.triangles[j], v) > 0;
                                      }))
                found[i].push_back(j);
    return found;
}

std::vector<std::uint32_t> neighbours_of(const MeshSites& sites, std::size_t i)
{
    return {sites.neighbour.begin() + sites.neighbour_begin[i],
            sites.neighbour.begin() + sites.neighbour_begin[i + 1]};
}

/// A long thin triangle beside small ones: a fan of needles around a fine disc.
TriMesh uneven()
{
    TriMesh mesh;
    mesh.vertices = {{0, 0, 0}, {8, 0, 0}, {0, 0.0625f, 0}, {-0.125f, 0, 0}, {0, -4, 0.5f}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}, {0, 3, 4}, {0, 4, 1}};
    return mesh;
}

TEST(MeshSites, TheSurfaceStaysExactlyWhatItWas)
{
    // Coordinates whose midpoints are floats: nothing may be rounded.
    const TriMesh mesh = meshes::box({8, -16, 4}, {3, 2, 1.5f});
    const MeshSites sites = divided(mesh, 0.11);
    EXPECT_GT(sites.size(), 3000u);
    EXPECT_NEAR(sites.mesh.signed_volume() / 9, 1, 1e-12);
    EXPECT_NEAR(sites.mesh.area() / 27, 1, 1e-12);
    EXPECT_NEAR(area_of(sites) / 27, 1, 1e-12);
    EXPECT_EQ(off_plane(mesh, sites), 0);
    EXPECT_LE(longest_edge_of(sites.mesh), 0.11);
    EXPECT_GT(longest_edge_of(sites.mesh), 0.055);
    const MeshReport report = inspect(sites.mesh);
    EXPECT_TRUE(report.closed());
    EXPECT_EQ(report.euler, 2);
    EXPECT_EQ(report.isolated_vertices, 0u);
    EXPECT_TRUE(sites.mesh.face_attributes.empty());
}

TEST(MeshSites, ASiteIsItsTriangle)
{
    const TriMesh mesh = meshes::tetrahedron();
    const MeshSites sites = divided(mesh, 0.7);
    for (std::size_t i = 0; i < sites.size(); ++i) {
        const auto& [a, b, c] = sites.mesh.triangles[i];
        const Vec3d p(sites.mesh.vertices[a]), q(sites.mesh.vertices[b]), r(sites.mesh.vertices[c]);
        const Vec3d twice = cross(q - p, r - p);
        EXPECT_NEAR(double(sites.area[i]), length(twice) / 2, 1e-6);
        EXPECT_LT(length(Vec3d(sites.normal[i]) - normalized(twice)), 1e-5);
        EXPECT_LT(length(Vec3d(sites.position[i]) - (p + q + r) / 3.0), 1e-6);
    }
    EXPECT_TRUE(std::is_sorted(sites.face.begin(), sites.face.end()));
}

TEST(MeshSites, RoundedMidpointsStayWithinAStepOfTheFace)
{
    const TriMesh mesh = meshes::torus(40, 24);
    const MeshSites sites = divided(mesh, 0.1);
    EXPECT_NEAR(sites.mesh.signed_volume() / mesh.signed_volume(), 1, 1e-8);
    EXPECT_NEAR(sites.mesh.area() / mesh.area(), 1, 1e-7);
    EXPECT_NEAR(area_of(sites) / mesh.area(), 1, 1e-7);
    EXPECT_LT(off_plane(mesh, sites), 2 * 4.8e-7);  // floats of 4 to 8 m are 4.8e-7 m apart
    EXPECT_LE(longest_edge_of(sites.mesh), 0.1);
    const MeshReport report = inspect(sites.mesh);
    EXPECT_TRUE(report.closed());
    EXPECT_EQ(report.genus(), 1);
}

TEST(MeshSites, FacesOfVeryDifferentSizesStayJoined)
{
    const TriMesh mesh = uneven();
    const MeshReport before = inspect(mesh);
    const MeshSites sites = divided(mesh, 0.1);
    const MeshReport after = inspect(sites.mesh);
    EXPECT_LE(longest_edge_of(sites.mesh), 0.1);
    EXPECT_EQ(after.non_manifold_edges, 0u);
    EXPECT_EQ(after.misoriented_edges, 0u);
    EXPECT_EQ(after.euler, before.euler);
    // Only the old border is open: its edges, halved until short enough.
    EXPECT_EQ(before.open_edges, 4u);
    double border = 0;
    std::map<std::pair<std::uint32_t, std::uint32_t>, int> sides;
    for (const auto& t : sites.mesh.triangles)
        for (std::size_t k = 0; k < 3; ++k) ++sides[std::minmax(t[k], t[(k + 1) % 3])];
    for (const auto& [edge, count] : sides)
        if (count == 1)
            border += length(Vec3d(sites.mesh.vertices[edge.first]) -
                             Vec3d(sites.mesh.vertices[edge.second]));
    double expected = 0;
    const std::uint32_t ring[] = {1, 2, 3, 4, 1};
    for (int k = 0; k < 4; ++k)
        expected += length(Vec3d(mesh.vertices[ring[k]]) - Vec3d(mesh.vertices[ring[k + 1]]));
    EXPECT_NEAR(border, expected, 1e-6);
    EXPECT_NEAR(area_of(sites), mesh.area(), 1e-6);
}

TEST(MeshSites, AFewHalvingsAreTheOnesExpected)
{
    // Legs of 1, diagonal of sqrt 2: at a limit of 1.2 the diagonal alone is halved.
    TriMesh square;
    square.vertices = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    square.triangles = {{0, 1, 2}, {0, 2, 3}};
    EXPECT_EQ(divided(square, 1.5).size(), 2u);
    EXPECT_EQ(divided(square, 1.2).size(), 4u);
    EXPECT_EQ(divided(square, 1.2).mesh.vertices.size(), 5u);
    // All three: four pieces each.
    EXPECT_EQ(divided(square, 0.9).size(), 8u);
    // Two long sides and a short one, whichever comes first: three pieces.
    TriMesh blade;
    blade.vertices = {{0, 0, 0}, {0.5f, 0, 0}, {0, 1, 0}};
    for (const std::array<std::uint32_t, 3> t :
         {std::array<std::uint32_t, 3>{0, 1, 2}, {1, 2, 0}, {2, 0, 1}}) {
        blade.triangles = {t};
        const MeshSites sites = divided(blade, 0.75);
        EXPECT_EQ(sites.size(), 3u);
        EXPECT_NEAR(area_of(sites), 0.25, 1e-9);
        EXPECT_NEAR(sites.mesh.area(), 0.25, 1e-9);
        EXPECT_LE(longest_edge_of(sites.mesh), 0.75);
    }
}

TEST(MeshSites, NeighboursAreThoseThatShareACorner)
{
    for (const TriMesh& mesh : {meshes::tetrahedron(), uneven(), meshes::box({}, {1, 2, 0.5f})}) {
        const MeshSites sites = divided(mesh, 0.6);
        const auto expected = neighbours_by_brute_force(sites.mesh);
        ASSERT_EQ(sites.neighbour_begin.size(), sites.size() + 1);
        for (std::size_t i = 0; i < sites.size(); ++i)
            ASSERT_EQ(neighbours_of(sites, i), expected[i]) << i;
    }
}

TEST(MeshSites, NeighboursFindEachOtherAcrossACrease)
{
    // Every face has corners of its own, as files with normals have them.
    const TriMesh whole = meshes::box({0.5f, 0, 0}, {1, 2, 0.5f});
    TriMesh torn;
    for (const auto& t : whole.triangles) {
        const auto base = static_cast<std::uint32_t>(torn.vertices.size());
        for (const std::uint32_t v : t) torn.vertices.push_back(whole.vertices[v]);
        torn.triangles.push_back({base, base + 1, base + 2});
    }
    ASSERT_EQ(inspect(torn).open_edges, 36u);
    torn.vertices[5].z = -0.0f;
    const MeshSites sites = divided(torn, 0.3), expected = divided(whole, 0.3);
    EXPECT_TRUE(inspect(sites.mesh).closed());
    EXPECT_EQ(sites.mesh.vertices.size(), expected.mesh.vertices.size());
    EXPECT_EQ(sites.neighbour.size(), expected.neighbour.size());
    EXPECT_EQ(sites.position, expected.position);
}

TEST(MeshSites, SolidsMayTouch)
{
    TriMesh both = meshes::box({0, 0, 0}, {1, 1, 1});
    meshes::append(both, meshes::box({1, 0, 1}, {1, 1, 1}));  // edge to edge
    const MeshSites sites = divided(both, 0.3);
    EXPECT_NEAR(sites.mesh.signed_volume(), 2, 1e-12);
    EXPECT_EQ(inspect(sites.mesh).open_edges, 0u);
    // Water runs from one to the other.
    bool across = false;
    for (std::size_t i = 0; i < sites.size(); ++i)
        for (const std::uint32_t j : neighbours_of(sites, i))
            across = across || ((sites.face[i] < 12) != (sites.face[j] < 12));
    EXPECT_TRUE(across);
}

TEST(MeshSites, TrianglesWithoutAreaAreLeftOutAndTold)
{
    TriMesh mesh = meshes::box({0, 0, 0}, {1, 1, 1});
    mesh.vertices.emplace_back(0.5f, 0.5f, 1.0f);
    mesh.triangles.insert(mesh.triangles.begin() + 3, {8, 8, 8});
    mesh.triangles.push_back({0, 1, 1});
    std::string told;
    log::set_sink([&](log::Level, const std::string& line) { told += line + "\n"; });
    const MeshSites sites = divided(mesh, 2);
    log::set_sink({});
    EXPECT_EQ(sites.size(), 12u);
    EXPECT_THAT(told, HasSubstr("sites: 2 triangles smaller than 1e-12 m^2 are left out"));
    EXPECT_EQ(std::ranges::count(sites.face, 3u), 0);
    EXPECT_EQ(sites.face.back(), 12u);
    EXPECT_EQ(sites.mesh.vertices.size(), 8u);
    TriMesh nothing;
    nothing.vertices = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
    nothing.triangles = {{0, 1, 2}};
    EXPECT_THAT([&] { divided(nothing, 1); },
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("none of the 1 triangles has an area"), HasSubstr("--scale"))));
}

TEST(MeshSites, AnInvertedBodyIsWarnedOf)
{
    TriMesh mesh, outwards = meshes::box({0, 0, 0}, {1, 1, 1});
    meshes::append(mesh, outwards, true);
    std::string told;
    log::set_sink([&](log::Level level, const std::string& line) {
        if (level == log::Level::Warning) told += line;
    });
    divided(mesh, 1);
    EXPECT_THAT(told, HasSubstr("inside out"));
    told.clear();
    divided(outwards, 1);
    mesh.triangles.pop_back();  // open: has no inside
    divided(mesh, 1);
    log::set_sink({});
    EXPECT_EQ(told, "");
}

TEST(MeshSites, NamesWhatIsWrongWithTheMesh)
{
    EXPECT_THAT([] { divided({}, 1); }, ThrowsMessage<InvalidInput>(HasSubstr("no triangles")));
    TriMesh mesh = meshes::box({0, 0, 0}, {1, 1, 1});
    for (const double bad : {0.0, -1.0, std::nan(""), double(INFINITY)})
        EXPECT_THAT([&] { divided(mesh, bad); },
                    ThrowsMessage<InvalidParameter>(HasSubstr("longest_edge = ")));
    TriMesh beyond = mesh;
    beyond.triangles[7][1] = 8;
    EXPECT_THAT([&] { divided(beyond, 1); },
                ThrowsMessage<InvalidInput>(HasSubstr("triangle 7 has vertex 8, must be below 8")));
    TriMesh nan = mesh;
    nan.vertices[3].y = NAN;
    nan.vertices[6].z = INFINITY;
    EXPECT_THAT([&] { divided(nan, 1); },
                ThrowsMessage<InvalidInput>(HasSubstr("2 vertices are not finite: 3, 6;")));
    // One face of twelve turned: it and its three neighbours disagree.
    TriMesh turned = mesh;
    std::swap(turned.triangles[4][0], turned.triangles[4][1]);
    EXPECT_THAT(
        [&] { divided(turned, 1); },
        ThrowsMessage<InvalidInput>(HasSubstr("4 triangles are wound against a neighbour")));
    // The first ten of many.
    TriMesh many;
    for (int i = 0; i < 12; ++i) {
        TriMesh one = mesh;
        std::swap(one.triangles[4][0], one.triangles[4][1]);
        for (Vec3f& v : one.vertices) v.x += float(3 * i);
        meshes::append(many, one);
    }
    EXPECT_THAT(
        [&] { divided(many, 1); },
        ThrowsMessage<InvalidInput>(AllOf(HasSubstr("48 triangles"), HasSubstr(" and 38 more"))));
}

TEST(MeshSites, SheetsMayMeetAtAnEdgeAnyWay)
{
    TriMesh fin;  // two triangles of a floor and one standing on their common edge
    fin.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}};
    fin.triangles = {{0, 1, 2}, {1, 0, 3}, {0, 1, 4}};
    EXPECT_EQ(divided(fin, 2).size(), 3u);
    fin.triangles[1] = {0, 1, 3};
    EXPECT_EQ(divided(fin, 2).size(), 3u);
    fin.triangles.pop_back();  // two alone must agree
    EXPECT_THAT([&] { divided(fin, 2); }, ThrowsMessage<InvalidInput>(HasSubstr("2 triangles")));
}

TEST(MeshSites, RefusesWhatItCannotHoldBeforeItTries)
{
    TriMesh mesh = meshes::box({0, 0, 0}, {1000, 1000, 1});
    EXPECT_THAT([&] { divided(mesh, 0.02); },
                ThrowsMessage<LimitExceeded>(
                    AllOf(HasSubstr("longest_edge = 0.02 m"), HasSubstr("at most 2^31 - 1"))));
    TriMesh needle;  // hardly any area, but long
    needle.vertices = {{0, 0, 0}, {1e9f, 0, 0}, {0, 1e-3f, 0}};
    needle.triangles = {{0, 1, 2}};
    EXPECT_THROW(divided(needle, 0.1), LimitExceeded);
    // Far from the origin floats have no midpoints.
    TriMesh far = meshes::tetrahedron({1e7f, 0, 0});
    EXPECT_THAT([&] { divided(far, 0.5); },
                ThrowsMessage<InvalidParameter>(HasSubstr("move the mesh to the origin")));
    EXPECT_EQ(divided(far, 8).size(), 4u);
}

TEST(MeshSites, IsBitIdenticalForAnyNumberOfThreads)
{
    const TriMesh mesh = meshes::torus(60, 30);
    auto on_threads = [&](std::size_t n) {
        const ThreadLimit limit(n);
        return divided(mesh, 0.06);
    };
    const MeshSites one = on_threads(1), four = on_threads(4);
    EXPECT_EQ(one.mesh.vertices, four.mesh.vertices);
    EXPECT_EQ(one.mesh.triangles, four.mesh.triangles);
    EXPECT_EQ(one.face, four.face);
    EXPECT_EQ(one.position, four.position);
    EXPECT_EQ(one.normal, four.normal);
    EXPECT_EQ(one.area, four.area);
    EXPECT_EQ(one.neighbour_begin, four.neighbour_begin);
    EXPECT_EQ(one.neighbour, four.neighbour);
}

TEST(MeshSites, CanBeStopped)
{
    const std::atomic<bool> wish = true;
    EXPECT_THROW(mesh_sites(meshes::torus(9, 9), 0.1, Progress(nullptr, &wish)), Cancelled);
}

TEST(MeshSites, AScannedBunnyStaysItself)
{
    const std::filesystem::path path = "/usr/share/glmark2/models/bunny.obj";
    if (!std::filesystem::exists(path)) GTEST_SKIP() << "needs the package glmark2-data";
    MeshReadReport told;
    TriMesh bunny = read_mesh(path, &told);
    for (const bool open : {false, true}) {
        if (open) {
            const double floor = bunny.bounds().lower.y + bunny.bounds().size().y / 50;
            std::erase_if(bunny.triangles, [&](const auto& t) {
                return std::ranges::any_of(
                    t, [&](std::uint32_t v) { return double(bunny.vertices[v].y) < floor; });
            });
            bunny.face_attributes.clear();
        }
        const MeshReport before = inspect(bunny);
        const double limit = bunny.bounds().size().y / 150;
        const MeshSites sites = divided(bunny, limit);
        const MeshReport after = inspect(sites.mesh);
        EXPECT_EQ(before.open_edges > 0, open);
        EXPECT_EQ(after.open_edges > 0, open);
        EXPECT_EQ(after.non_manifold_edges, 0u);
        EXPECT_EQ(after.misoriented_edges, 0u);
        EXPECT_EQ(after.euler, before.euler);
        EXPECT_EQ(after.pieces, before.pieces);
        EXPECT_GT(after.triangles, 2 * before.triangles);
        EXPECT_NEAR(after.area / before.area, 1, 1e-6);
        if (!open) {
            EXPECT_NEAR(after.volume / before.volume, 1, 1e-6);
        }
        EXPECT_LE(longest_edge_of(sites.mesh), limit);
        EXPECT_LT(off_plane(bunny, sites), 1e-6 * bunny.bounds().size().y);
    }
}

}  // namespace
}  // namespace sekitei
