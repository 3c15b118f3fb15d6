#include "solvers/tree/wood.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <numbers>
#include <numeric>

#include "core/error.h"
#include "core/mesh_intersections.h"
#include "core/parallel.h"
#include "tests/solvers/tree/limbs.h"
#include "tests/support/mesh_check.h"

namespace sekitei::tree {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr double kUnit = 0.2;  // [m]

std::vector<double> radii(const Branches& b, double tip = 0.0015)
{
    Species species;
    species.tip_radius = tip;
    const std::vector<Plant> plants(1);
    return thickness(b, std::span(&species, 1), plants);
}

TEST(Thickness, FollowsDaVinci)
{
    const std::vector<std::int32_t> parent{-1, 0, 0, 1, 1, 2, 5, 5}, none(8, 0);
    const auto r = thickness(parent, none, 0.002, 2, 0.5);
    const double pair = 0.002 * std::sqrt(2.0);
    const std::vector<double> expected{0.004, pair, pair, 0.002, 0.002, pair, 0.002, 0.002};
    for (std::size_t i = 0; i < 8; ++i) EXPECT_NEAR(r[i], expected[i], 1e-12) << i;
    EXPECT_NEAR(r[1], 0.002828427, 1e-9);

    const auto other = thickness(parent, none, 0.002, 2.49, 0.5);
    EXPECT_NEAR(other[0], 0.003489966, 1e-9);
    for (const std::size_t i : {1u, 2u, 5u}) EXPECT_NEAR(other[i], 0.002641956, 1e-9);

    std::vector<std::int32_t> dead = none;
    dead[2] = 1;
    const auto more = thickness(parent, dead, 0.002, 2, 0.5);
    EXPECT_NEAR(more[2], 0.003162278, 1e-9);
    EXPECT_NEAR(more[0], 0.004242641, 1e-9);
    EXPECT_NEAR(more[5], pair, 1e-12);
}

TEST(Thickness, DeadWoodLeavesTheLivingAsTheyWere)
{
    Branches b = fork();
    b.dead_tips[1] = 3;
    const auto before = radii(b);
    // Two dead branches on the first arm: more than the wood they hang on.
    Limbs limbs{b};
    for (int k = 0; k < 40; ++k) limbs.add(k == 0 ? 4 : 5, {1, 0.1 * k, 0}, 1);
    for (std::size_t i = 5; i < limbs.branches.size(); ++i)
        limbs.branches.flags[i] = Branches::kDead;
    const auto after = radii(limbs.branches);
    for (std::size_t i = 0; i < before.size(); ++i) EXPECT_EQ(after[i], before[i]);
    for (std::size_t i = 5; i < after.size(); ++i)
        EXPECT_LE(after[i], after[std::size_t(limbs.branches.parent[i])]);
}

TEST(Thickness, NamesWhatIsWrong)
{
    EXPECT_THAT([] { thickness(std::vector{0}, std::vector{0}, 1, 2, 0); },
                ThrowsMessage<InvalidInput>(HasSubstr("branch 0 has the parent 0")));
    EXPECT_THROW(thickness(std::vector{-1}, std::vector<std::int32_t>{}, 1, 2, 0), InvalidInput);
    Branches b = fork();
    b.tree[3] = 4;
    EXPECT_THAT([&] { radii(b); }, ThrowsMessage<InvalidInput>(HasSubstr("branch 3 is of tree 4")));
}

/// Pieces of a mesh, each by itself.
std::vector<TriMesh> pieces_of(const TriMesh& mesh)
{
    std::vector<std::uint32_t> root(mesh.vertices.size());
    std::iota(root.begin(), root.end(), 0u);
    auto find = [&](std::uint32_t v) {
        while (root[v] != v) v = root[v] = root[root[v]];
        return v;
    };
    for (const auto& t : mesh.triangles)
        for (const std::uint32_t v : t) root[find(v)] = find(t[0]);
    std::map<std::uint32_t, TriMesh> parts;
    std::vector<std::uint32_t> now(mesh.vertices.size());
    for (std::uint32_t v = 0; v < mesh.vertices.size(); ++v) {
        TriMesh& part = parts[find(v)];
        now[v] = static_cast<std::uint32_t>(part.vertices.size());
        part.vertices.push_back(mesh.vertices[v]);
    }
    for (const auto& t : mesh.triangles)
        parts[find(t[0])].triangles.push_back({now[t[0]], now[t[1]], now[t[2]]});
    std::vector<TriMesh> list;
    for (auto& [_, part] : parts) list.push_back(std::move(part));
    return list;
}

void expect_limbs(const TriMesh& mesh, std::size_t limbs, std::uint64_t most_crossings = 0)
{
    const MeshReport report = inspect(mesh);
    EXPECT_TRUE(report.closed()) << report.open_edges << " open, " << report.non_manifold_edges;
    EXPECT_EQ(report.pieces, limbs);
    EXPECT_EQ(report.genus(), 0);
    EXPECT_EQ(report.zero_area, 0u);
    EXPECT_EQ(report.isolated_vertices, 0u);
    std::uint64_t crossings = 0;
    for (const TriMesh& piece : pieces_of(mesh)) {
        const auto facts = testing_support::look_at(piece);
        EXPECT_TRUE(facts.each_edge_twice && facts.all_used && facts.one_fan);
        EXPECT_EQ(facts.euler, 2);
        EXPECT_GT(facts.volume, 0);
        crossings += count_self_intersections(piece, 1000);
    }
    EXPECT_LE(crossings, most_crossings);
}

TEST(Bark, OfAStraightLimbIsAPrism)
{
    Limbs limbs;
    std::int32_t last = limbs.add(-1, {0.2, -0.1, 1}, 3, false, {1, 2, 3});
    for (int k = 0; k < 3; ++k) last = limbs.add(last, {0.2, -0.1, 1}, 1);
    const Branches& b = limbs.branches;
    const double r = 0.05;
    const int sides = 16;
    const TriMesh mesh = bark_tubes(b, std::vector<double>(4, r), kUnit,
                                    {.edge = 2 * std::numbers::pi * r / sides}, {});
    expect_limbs(mesh, 1);
    const double section = 0.5 * sides * r * r * std::sin(2 * std::numbers::pi / sides);
    EXPECT_NEAR(mesh.signed_volume(), section * 6 * kUnit, 1e-6 * section);
    // Corners know how far along and around they lie.
    const auto& along = std::get<std::vector<Vec3f>>(mesh.face_attributes.at("uv_1"));
    double longest = 0, widest = 0;
    for (const Vec3f& uv : along) {
        longest = std::max(longest, double(uv.y));
        widest = std::max(widest, double(uv.x));
    }
    EXPECT_NEAR(longest, 6 * kUnit, 1e-6);
    EXPECT_NEAR(widest, std::numbers::pi * r, 1e-6);
}

TEST(Bark, TextureIsAsLargeAsTheBark)
{
    const Branches b = wander(6, 1, 0.3, 3);
    const TriMesh mesh = bark_tubes(b, std::vector<double>(6, 0.02), kUnit, {.edge = 0.004}, {});
    std::array<const std::vector<Vec3f>*, 3> uv{};
    for (std::size_t k = 0; k < 3; ++k)
        uv[k] = &std::get<std::vector<Vec3f>>(mesh.face_attributes.at("uv_" + std::to_string(k)));
    double area = 0;
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
        const Vec3f a = (*uv[0])[t], p = (*uv[1])[t] - a, q = (*uv[2])[t] - a;
        area += 0.5 * std::abs(double(p.x) * double(q.y) - double(p.y) * double(q.x));
    }
    EXPECT_NEAR(area, mesh.area(), 0.02 * mesh.area());
}

TEST(Bark, OfForksChainsAndWhorlsIsClosedAndOutward)
{
    for (const double tip : {0.0015, 0.02}) {
        Branches b = fork();
        expect_limbs(bark_tubes(b, radii(b, tip), kUnit, {}, {}), 3);
        b = wander(30, 1, 0.2, 1);
        expect_limbs(bark_tubes(b, radii(b, tip), kUnit, {}, {}), 1);
        b = whorls(6);
        expect_limbs(bark_tubes(b, radii(b, tip), kUnit, {}, {}), 31);
    }
}

TEST(Bark, BendsDoNotFoldOver)
{
    for (const double bend : {0.5, 1.0, 1.5, 2.0})
        for (const double r : {0.01, 0.05, 0.15}) {
            // In a zigzag that comes back on itself other pieces may cross; here bends alternate.
            Limbs limbs;
            std::int32_t last = -1;
            for (int k = 0; k < 9; ++k) {
                const double a = bend / 2 * (k % 2 ? 1 : -1);
                last = limbs.add(last, {std::sin(a), 0.1 * std::sin(a), std::cos(a)}, 1, k == 8);
            }
            const std::vector<double> radius(9, r);
            SCOPED_TRACE(testing::Message() << "bend " << bend << " radius " << r);
            expect_limbs(bark_tubes(limbs.branches, radius, kUnit, {}, {}), 1);
        }
}

TEST(Bark, RingsDoNotTwist)
{
    // Along a helix the seam stays where it is turned to, instead of going round.
    const int pieces = 60;
    Limbs limbs;
    std::int32_t last = -1;
    for (int k = 0; k < pieces; ++k) {
        const double a = 0.3 * k;
        last = limbs.add(last, {0.3 * std::cos(a), 0.3 * std::sin(a), 1}, 1, k + 1 == pieces);
    }
    const TriMesh mesh =
        bark_tubes(limbs.branches, std::vector<double>(pieces, 0.05), kUnit, {.edge = 0.02}, {});
    expect_limbs(mesh, 1);
    const std::size_t sides = 16;
    ASSERT_EQ(mesh.vertices.size(), sides * pieces + sides / 2 + 1);
    for (std::size_t j = 1; j < pieces; ++j) {
        Vec3d before, after;
        for (std::size_t i = 0; i < sides; ++i) {
            before += Vec3d(mesh.vertices[(j - 1) * sides + i]) / double(sides);
            after += Vec3d(mesh.vertices[j * sides + i]) / double(sides);
        }
        const Vec3d a = normalized(Vec3d(mesh.vertices[(j - 1) * sides]) - before);
        const Vec3d b = normalized(Vec3d(mesh.vertices[j * sides]) - after);
        EXPECT_GT(dot(a, b), 0.9) << j;
    }
}

TEST(Bark, SideLimbsBeginWithinTheirParents)
{
    for (const Branches& b : {fork(), whorls(3)}) {
        const auto radius = radii(b, 0.004);
        const auto pieces = pieces_of(bark_tubes(b, radius, kUnit, {.edge = 0.005}, {}));
        // The first ring of each but the first piece lies inside another one.
        for (std::size_t p = 1; p < pieces.size(); ++p)
            for (std::size_t v = 0; v < 4; ++v) {
                const Vec3d at(pieces[p].vertices[v]);
                bool inside = false;
                for (std::size_t q = 0; q < pieces.size(); ++q) {
                    if (q == p) continue;
                    double angle = 0;
                    for (const auto& t : pieces[q].triangles) {
                        const Vec3d a = Vec3d(pieces[q].vertices[t[0]]) - at,
                                    c = Vec3d(pieces[q].vertices[t[1]]) - at,
                                    d = Vec3d(pieces[q].vertices[t[2]]) - at;
                        angle += 2 * std::atan2(dot(a, cross(c, d)),
                                                length(a) * length(c) * length(d) +
                                                    dot(a, c) * length(d) + dot(c, d) * length(a) +
                                                    dot(d, a) * length(c));
                    }
                    inside |= angle > 2 * std::numbers::pi;
                }
                EXPECT_TRUE(inside) << "limb " << p << " corner " << v;
            }
    }
}

bool same(const TriMesh& a, const TriMesh& b)
{
    return a.triangles == b.triangles && a.vertices == b.vertices &&
           a.vertex_attributes == b.vertex_attributes && a.face_attributes == b.face_attributes;
}

TEST(Bark, IsTheSameOnAnyNumberOfThreads)
{
    const Branches b = whorls(40);
    const auto radius = radii(b);
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return bark_tubes(b, radius, kUnit, {}, {});
    };
    EXPECT_TRUE(same(on(1), on(4)));
}

TEST(Bark, NoBranchesNoBark)
{
    EXPECT_TRUE(bark_tubes({}, {}, kUnit, {}, {}).triangles.empty());
}

TEST(Bark, NamesWhatIsWrong)
{
    const Branches good = fork();
    const auto radius = radii(good);
    EXPECT_THAT([&] { bark_tubes(good, radius, kUnit, {.edge = 0}, {}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("edge of the bark = 0 m")));
    EXPECT_THAT([&] { bark_tubes(good, radius, kUnit, {.least_sides = 2}, {}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("least_sides = 2")));
    EXPECT_THAT([&] { bark_tubes(good, radius, -1, {}, {}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("unit_length = -1 m")));
    EXPECT_THAT([&] { bark_tubes(good, std::vector<double>(2, 1.0), kUnit, {}, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("5 branches with 2 radii")));
    Branches bad = good;
    bad.length[2] = 0;
    EXPECT_THAT([&] { bark_tubes(bad, radius, kUnit, {}, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("branch 2")));
    bad = good;
    bad.start[1].y = NAN;
    EXPECT_THROW(bark_tubes(bad, radius, kUnit, {}, {}), InvalidInput);
    bad = good;
    bad.parent[1] = 3;
    EXPECT_THAT([&] { bark_tubes(bad, radius, kUnit, {}, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("branch 1 has the parent 3")));
}

}  // namespace
}  // namespace sekitei::tree
