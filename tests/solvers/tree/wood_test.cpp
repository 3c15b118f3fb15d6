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
#include "grids/marching_tetrahedra.h"
#include "solvers/tree/surroundings.h"
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

TEST(Bark, ThickLimbsAreRoundedBetweenTheirJoints)
{
    Limbs limbs;
    std::int32_t last = -1;
    for (int k = 0; k < 6; ++k)
        last = limbs.add(last, {std::sin(0.5 * k), 0, std::cos(0.5 * k)}, 1, k == 5);
    const std::vector<double> radius(6, 0.02);
    const TriMesh mesh = bark_tubes(limbs.branches, radius, kUnit, {.edge = 0.01}, {});
    expect_limbs(mesh, 1);
    // Neighbouring faces along the limb turn by less than the joints do; the limb's joints stay.
    double sharpest = 1;
    const auto& normal = std::get<std::vector<Vec3f>>(mesh.vertex_attributes.at("normal"));
    for (const auto& t : mesh.triangles)
        for (std::size_t k = 0; k < 3; ++k) {
            const Vec3d a(mesh.vertices[t[k]]), b(mesh.vertices[t[(k + 1) % 3]]);
            const Vec3d n(normal[t[k]]), m(normal[t[(k + 1) % 3]]);
            // Edges along the outer side.
            if (n.y * n.y < 0.01 && m.y * m.y < 0.01 && length(b - a) > 0.03)
                sharpest = std::min(sharpest, dot(n, m));
        }
    EXPECT_GT(sharpest, std::cos(0.3));
    for (std::size_t j = 0; j < 6; ++j) {
        double nearest = 1;
        for (const Vec3f& v : mesh.vertices)
            nearest = std::min(nearest, length(Vec3d(v) - limbs.branches.start[j] * kUnit));
        EXPECT_NEAR(nearest, 0.02, 0.001);
    }
}

TEST(Bark, TightArcsArePinched)
{
    // Rings that halve these bends would reach past one another on the inner side.
    for (const auto& [bend, r] : {std::pair{1.2, 0.15}, {1.3, 0.14}, {1.0, 0.16}}) {
        Limbs limbs;
        std::int32_t last = -1;
        for (int k = 0; k < 3; ++k)
            last = limbs.add(last, {std::sin(k * bend), 0, std::cos(k * bend)}, k == 1 ? 1 : 3);
        expect_limbs(bark_tubes(limbs.branches, std::vector<double>(3, r), kUnit, {}, {}), 1);
    }
}

TEST(Bark, KinksShorterThanALimbIsThickAreLeftOut)
{
    for (std::uint64_t seed = 0; seed < 10; ++seed) {
        const Branches b = wander(20, 0.2, 0.5, seed);
        expect_limbs(bark_tubes(b, std::vector<double>(20, 0.1), kUnit, {}, {}), 1);
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

TriMesh meshed(const FloatGrid& wood)
{
    TriMesh mesh = marching_tetrahedra(wood, 0, {});
    for (auto& t : mesh.triangles) std::swap(t[1], t[2]);  // inside is negative
    return mesh;
}

TEST(WoodLevelSet, OfATaperedLimbIsItsDistance)
{
    // Branch 1 goes on from branch 0 with half its radius; they join in the geometric mean.
    Limbs limbs;
    limbs.add(-1, {1, 2, 3}, 5, false, {2, 1, -1});
    limbs.add(0, {1, 2, 3}, 2);
    const double r0 = 0.1, r1 = 0.05, joint = std::sqrt(r0 * r1), voxel = 0.0125;
    const FloatGrid wood = wood_level_set(limbs.branches, std::vector{r0, r1}, kUnit, voxel, {});
    EXPECT_FLOAT_EQ(wood.background(), static_cast<float>(4 * voxel));
    // Brute force: balls along the limb.
    const Vec3d from = limbs.branches.start[0] * kUnit, middle = limbs.branches.end(0) * kUnit,
                to = limbs.branches.end(1) * kUnit;
    GridReader<float> reader(wood);
    std::size_t seen = 0;
    for (std::uint64_t i = 0; i < 6000; ++i) {
        Vec3d at;
        for (int k = 0; k < 3; ++k) {
            const double low = std::min(from[k], to[k]) - 0.2,
                         high = std::max(from[k], to[k]) + 0.2;
            at[k] = low + (high - low) * uniform_of_key(i, std::uint64_t(k));
        }
        const Coord c(static_cast<int>(std::floor(wood.transform().voxels(at).x)),
                      static_cast<int>(std::floor(wood.transform().voxels(at).y)),
                      static_cast<int>(std::floor(wood.transform().voxels(at).z)));
        const Vec3d centre = wood.transform().world(centre_of(c));
        double exact = INFINITY;
        for (int s = 0; s <= 1000; ++s) {
            const double f = s / 1000.0;
            exact = std::min(exact,
                             length(from + (middle - from) * f - centre) - r0 - (joint - r0) * f);
            exact = std::min(
                exact, length(middle + (to - middle) * f - centre) - joint - (r1 - joint) * f);
        }
        const double found = double(reader.value(c));
        EXPECT_NEAR(found, std::clamp(exact, -4 * voxel, 4 * voxel), 1e-5);
        EXPECT_EQ(reader.active(c), std::abs(found) < 4 * voxel - 1e-7);
        seen += reader.active(c);
    }
    EXPECT_GT(seen, 100u);
}

TEST(WoodLevelSet, IsOneClosedPieceForEachTree)
{
    for (const double tip : {0.0015, 0.01, 0.03})
        for (const Branches& b : {fork(), whorls(5), wander(20, 1, 0.4, 9)}) {
            for (const double voxel : {0.02, 0.05}) {
                SCOPED_TRACE(testing::Message() << "tip " << tip << " voxel " << voxel);
                const auto radius = radii(b, tip);
                const TriMesh mesh = meshed(wood_level_set(b, radius, kUnit, voxel, {}));
                const MeshReport report = inspect(mesh);
                EXPECT_TRUE(report.closed());
                EXPECT_EQ(report.pieces, 1u);
                EXPECT_GT(report.volume, 0);
            }
        }
}

TEST(WoodLevelSet, HasTheVolumeOfTheBark)
{
    const Branches b = fork();
    const auto radius = radii(b, 0.02);
    // Fine enough for leaves that lie all inside.
    const TriMesh by_grid = meshed(wood_level_set(b, radius, kUnit, 0.002, {}));
    double by_bark = 0;
    for (const TriMesh& piece :
         pieces_of(bark_tubes(b, radius, kUnit, {.edge = 0.004, .most_sides = 64}, {})))
        by_bark += piece.signed_volume();
    EXPECT_EQ(inspect(by_grid).pieces, 1u);
    // Tubes overlap at forks, capsules have round ends and fillets.
    EXPECT_NEAR(by_grid.signed_volume(), by_bark, 0.1 * by_bark);
}

TEST(WoodLevelSet, HollowsBetweenLimbsAreFilled)
{
    Limbs limbs;
    const auto trunk = limbs.add(-1, {0, 0, 1}, 3);
    limbs.add(trunk, {1, 0, 1}, 3);
    limbs.add(trunk, {-1, 0, 1}, 3);
    const std::vector<double> radius{0.05, 0.05, 0.05};
    const double voxel = 0.01;
    const FloatGrid wood = wood_level_set(limbs.branches, radius, kUnit, voxel, {});
    GridReader<float> reader(wood);
    // In the crotch, as far from both arms; and where only one is near.
    auto at = [&](Vec3d p) { return double(reader.sample(wood.transform().voxels(p))); };
    const double height = 0.12, plain = height / std::sqrt(2.0) - 0.05;
    EXPECT_NEAR(at({0, 0, 0.6 + height}), plain - 0.7 * 0.05 / 4, 0.002);
    EXPECT_NEAR(at({0.3 - 0.05, 0, 0.6 + 0.3 + 0.05}), 0.1 / std::sqrt(2.0) - 0.05, 0.001);
    // Nowhere steeper than a distance.
    for (std::size_t leaf = 0; leaf < wood.leaf_count(); ++leaf)
        wood.mask(leaf).for_each([&](int o) {
            const Coord c = leaf_coord(wood.origin(leaf), o);
            for (int k = 0; k < 3; ++k) {
                Coord d;
                d[k] = 1;
                EXPECT_LE(std::abs(double(reader.value(c + d)) - double(wood.at(leaf, o))),
                          1.02 * voxel);
            }
        });
}

TEST(WoodLevelSet, ThinBranchesAreLeftOutButNotTheFirst)
{
    const Branches b = fork();
    const auto radius = radii(b);
    const FloatGrid thin = wood_level_set(b, radius, kUnit, 0.02, {});
    // The first branch alone, half a voxel's diagonal thick.
    const double r = 0.87 * 0.02, l = 4 * kUnit;
    const double capsule = std::numbers::pi * r * r * (l + 4.0 / 3 * r);
    EXPECT_NEAR(meshed(thin).signed_volume(), capsule, 0.35 * capsule);
    const FloatGrid none = wood_level_set({}, {}, kUnit, 0.02, {});
    EXPECT_EQ(none.leaf_count(), 0u);
    EXPECT_FLOAT_EQ(none.background(), 0.08f);
}

bool same(const FloatGrid& a, const FloatGrid& b)
{
    if (!(a.transform() == b.transform()) || a.topology()->origins() != b.topology()->origins())
        return false;
    for (std::size_t leaf = 0; leaf < a.leaf_count(); ++leaf) {
        if (!(a.mask(leaf) == b.mask(leaf)) || a.is_constant(leaf) != b.is_constant(leaf))
            return false;
        for (int o = 0; o < kLeafSize; ++o)
            if (a.at(leaf, o) != b.at(leaf, o)) return false;
    }
    return true;
}

TEST(WoodLevelSet, IsTheSameOnAnyNumberOfThreads)
{
    const Branches b = whorls(8);
    const auto radius = radii(b, 0.006);
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return wood_level_set(b, radius, kUnit, 0.01, {});
    };
    EXPECT_TRUE(same(on(1), on(4)));
}

TEST(WoodLevelSet, TellsWhatItWouldNeed)
{
    const Branches b = fork();
    const auto radius = radii(b);
    EXPECT_THAT([&] { wood_level_set(b, radius, 1000, 1e-5, {}); },
                ThrowsMessage<LimitExceeded>(HasSubstr("use a larger voxel")));
    EXPECT_THAT([&] { wood_level_set(b, std::vector<double>(5, 1.0), kUnit, 1e-4, {}); },
                ThrowsMessage<LimitExceeded>(HasSubstr("wood level set: needs")));
    EXPECT_THAT([&] { wood_level_set(b, radius, kUnit, 0, {}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("voxel of the wood = 0 m")));
}

/// A grove that has grown a little.
Grove grove(int generations, Species species = {}, double tau = 0.9)
{
    GroveParams params;
    params.transmission = tau;
    Grove g(params, {species}, {Plant{.origin = {3, -2, 0}}, Plant{.origin = {20, 5, 0}}}, 3);
    g.grow(generations);
    return g;
}

TEST(Leaves, AddUpToTheLeafAreaOfTheirBalls)
{
    const Grove g = grove(8);
    ASSERT_GT(g.tips(), 10u);
    const double ball = leaf_area(0.4, 0.9, 0.5);
    EXPECT_NEAR(ball, 0.106, 5e-4);
    const Leaves list = leaves(g, 1);
    std::vector<double> area(g.tips());
    const Balls balls = g.balls();
    for (std::size_t i = 0; i < list.area.size(); ++i) {
        const auto b = std::size_t(list.ball[i]);
        area[b] += double(list.area[i]);
        EXPECT_LE(length(list.position[i] - balls.centre[b] * 0.2), 0.4 + 1e-9);
        EXPECT_FLOAT_EQ(4 * list.pscale[i] * list.pscale[i], list.area[i]);
        EXPECT_NEAR(double(list.area[i]), kLeafShape * 0.06 * 0.06,
                    0.01 * kLeafShape * 0.06 * 0.06);
        EXPECT_EQ(list.tree[i], g.branches().tree[g.tip_list()[b]]);
        EXPECT_EQ(list.species[i], 0);
    }
    for (const double a : area) EXPECT_NEAR(a, ball, 1e-5);
}

TEST(Leaves, ABallLooksAsThinAsItsTransmission)
{
    // Lines at random through one ball with its leaves as discs: on average they pass as Beer says
    // (of many small leaves; few large ones hide one another less evenly).
    Species small;
    small.leaf_size = 0.02;
    GroveParams params;
    params.transmission = 0.6;
    const Grove g(params, {small}, {Plant{}}, 5);
    const Leaves list = leaves(g, 1);
    const Vec3d centre = g.balls().centre[0] * 0.2;
    const double radius = 0.4;
    double depth = 0, chords = 0;
    int lines = 0;
    for (std::uint64_t i = 0; i < 4000; ++i) {
        const double z = 2 * uniform_of_key(i, 0) - 1, a = 6.283185307 * uniform_of_key(i, 1);
        const Vec3d way(std::sqrt(1 - z * z) * std::cos(a), std::sqrt(1 - z * z) * std::sin(a), z);
        const Vec3d h = fork_axis(way), k = cross(way, h);
        const double r = radius * std::sqrt(uniform_of_key(i, 2)),
                     t = 6.283185307 * uniform_of_key(i, 3);
        const Vec3d at = centre + (h * std::cos(t) + k * std::sin(t)) * r;
        for (std::size_t l = 0; l < list.area.size(); ++l) {
            const Vec3d n(list.normal[l]);
            const double slope = dot(n, way);
            if (slope == 0) continue;
            const Vec3d hit = at + way * (dot(n, list.position[l] - at) / slope);
            const double disc = double(list.area[l]) / std::numbers::pi;
            const Vec3d off = hit - list.position[l];
            depth += dot(off, off) < disc;
        }
        chords += 2 * std::sqrt(radius * radius - r * r);
        ++lines;
    }
    EXPECT_NEAR(chords / lines, 4.0 / 3 * radius, 0.01);
    EXPECT_NEAR(depth / lines, -std::log(0.6), 0.03);
}

TEST(Leaves, FillTheirBallEvenly)
{
    Species small;
    small.leaf_size = 0.01;
    const Grove g(GroveParams{}, {small}, {Plant{}}, 5);
    const Leaves list = leaves(g, 1);
    const Vec3d centre = g.balls().centre[0] * 0.2;
    const double n = static_cast<double>(list.area.size());
    ASSERT_GT(n, 1000);
    Vec3d mean, normals;
    int inner = 0;
    for (std::size_t i = 0; i < list.area.size(); ++i) {
        mean += (list.position[i] - centre) / n;
        normals += Vec3d(list.normal[i]) / n;
        inner += length(list.position[i] - centre) < 0.2;
    }
    EXPECT_LT(length(mean), 0.003);
    EXPECT_NEAR(inner / n, 1.0 / 8, 0.005);
    EXPECT_LT(length(normals), 0.05);
}

TEST(Leaves, OrientBringsZToTheNormal)
{
    for (const auto orientation : {LeafOrientation::Spherical, LeafOrientation::Planophile}) {
        Species species;
        species.leaf_orientation = orientation;
        const Grove g = grove(6, species);
        const Leaves list = leaves(g, 1);
        double lean = 0;
        for (std::size_t i = 0; i < list.area.size(); ++i) {
            const auto [x, y, z, w] = list.orient[i];
            EXPECT_NEAR(x * x + y * y + z * z + w * w, 1, 1e-6);
            const Vec3d turned(2.0 * (x * z + w * y), 2.0 * (y * z - w * x),
                               1 - 2.0 * (x * x + y * y));
            EXPECT_LT(length(turned - Vec3d(list.normal[i])), 1e-6);
            EXPECT_NEAR(double(length(list.normal[i])), 1, 1e-6);
            const Vec3d u =
                normalized(g.branches().light_vector[g.tip_list()[std::size_t(list.ball[i])]]);
            lean += std::abs(dot(u, Vec3d(list.normal[i]))) / double(list.area.size());
        }
        // Mean of |cos|: 1/2 of spherical ones; of planophile ones 2/pi (1 + 1/3) = 0.849.
        EXPECT_NEAR(lean, orientation == LeafOrientation::Spherical ? 0.5 : 0.849, 0.02);
    }
}

TEST(Leaves, AreKeyedByTheirBranch)
{
    // A tree alone has the leaves that it has beside one too far to matter.
    GroveParams params;
    Grove one(params, {Species{}}, {Plant{}}, 3);
    Grove two(params, {Species{}}, {Plant{}, Plant{.origin = {500, 0, 0}}}, 3);
    const Leaves a = leaves(one, 4), b = leaves(two, 4), c = leaves(one, 5);
    ASSERT_EQ(b.position.size(), 2 * a.position.size());
    for (std::size_t i = 0; i < a.position.size(); ++i) {
        EXPECT_EQ(a.position[i], b.position[i]);
        EXPECT_EQ(a.orient[i], b.orient[i]);
    }
    EXPECT_NE(a.position, c.position);
}

TEST(Leaves, AreTheSameOnAnyNumberOfThreads)
{
    const Grove g = grove(8);
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return leaves(g, 1);
    };
    const Leaves one = on(1), four = on(4);
    EXPECT_EQ(one.position, four.position);
    EXPECT_EQ(one.orient, four.orient);
    EXPECT_EQ(one.area, four.area);
}

TEST(Leaves, OpaqueAndClearBalls)
{
    EXPECT_TRUE(leaves(grove(2, {}, 1.0), 1).area.empty());
    EXPECT_THAT([] { leaves(grove(0, {}, 0.0), 1); },
                ThrowsMessage<InvalidParameter>(HasSubstr("transmission = 0")));
    EXPECT_THROW(leaf_area(0, 0.9, 0.5), InvalidParameter);
    EXPECT_THROW(leaf_area(1, 0.9, 0), InvalidParameter);
    Species tiny;
    tiny.leaf_size = 1e-3;
    tiny.ball_radius = 1e3;
    EXPECT_THAT([&] { leaves(grove(0, tiny), 1); },
                ThrowsMessage<LimitExceeded>(HasSubstr("raise leaf_size")));
}

double integral(const FloatGrid& grid)
{
    double sum = 0;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) sum += double(grid.at(leaf, o));
    return sum * std::pow(grid.transform().voxel, 3);
}

TEST(Canopy, HoldsAllLeafArea)
{
    const Grove g = grove(10);
    const double all = double(g.tips()) * leaf_area(0.4, 0.9, 0.5);
    for (const double voxel : {0.1, 0.35, 3.0}) {
        const Canopy c = canopy(g, voxel, {});
        EXPECT_EQ(c.leaf_area_density.background(), 0);
        EXPECT_NEAR(integral(c.leaf_area_density), all, 1e-5 * all);
        EXPECT_NEAR(integral(c.drag), kCanopyDrag * all, 1e-5 * all);
    }
}

TEST(Canopy, BelongsWhereTheBallsAre)
{
    const Grove g(GroveParams{}, {Species{}}, {Plant{.origin = {3, -2, 1}}}, 5);
    const Canopy c = canopy(g, 0.1, {});
    const Vec3d centre(0.6, -0.4, 3.2);  // 15 branch lengths up
    Vec3d mean;
    double all = 0;
    const FloatGrid& lad = c.leaf_area_density;
    for (std::size_t leaf = 0; leaf < lad.leaf_count(); ++leaf)
        lad.mask(leaf).for_each([&](int o) {
            const Vec3d at = lad.transform().world(centre_of(leaf_coord(lad.origin(leaf), o)));
            EXPECT_LE(length(at - centre), 0.45);
            mean += at * double(lad.at(leaf, o));
            all += double(lad.at(leaf, o));
        });
    EXPECT_LT(length(mean / all - centre), 0.003);
    GridReader<float> density(lad), light(c.light);
    const double even = leaf_area(0.4, 0.9, 0.5) / (4.0 / 3 * std::numbers::pi * 0.064);
    EXPECT_NEAR(double(density.sample(lad.transform().voxels(centre))), even, 0.02 * even);
    EXPECT_EQ(light.sample(c.light.transform().voxels(centre)), 1.0f);
    EXPECT_EQ(light.sample(c.light.transform().voxels(centre + Vec3d(0.6, 0, 0))), 0.0f);
}

TEST(Canopy, LetsAsMuchLightPassAsABall)
{
    const Grove g(GroveParams{}, {Species{}}, {Plant{}}, 5);
    const Canopy c = canopy(g, 0.05, {});
    const BackgroundShade shade(c.leaf_area_density, 0.5);
    // Over the disc: -ln tau on average.
    double depth = 0, weight = 0;
    for (int i = -40; i < 40; ++i)
        for (int j = -40; j < 40; ++j) {
            const double x = (i + 0.5) * 0.012, y = (j + 0.5) * 0.012;
            depth -= std::log(shade.transmittance({x, y, 10}, {0, 0, -1}));
            weight += x * x + y * y < 0.16;
        }
    EXPECT_NEAR(depth / weight, -std::log(0.9), 0.02 * -std::log(0.9));
}

TEST(Canopy, LightIsThatOfTheBrightestBall)
{
    const Grove g = grove(10);
    const Canopy c = canopy(g, 0.1, {});
    const Balls balls = g.balls();
    GridReader<float> reader(c.light);
    const auto foliage = g.foliage();
    for (std::size_t i = 0; i < foliage.size(); ++i) {
        const Vec3d v = c.light.transform().voxels(balls.centre[i] * 0.2);
        const Coord at(static_cast<int>(v.x), static_cast<int>(v.y), static_cast<int>(v.z));
        double brightest = 0;
        for (std::size_t j = 0; j < foliage.size(); ++j)
            if (length(c.light.transform().world(centre_of(at)) - balls.centre[j] * 0.2) < 0.4)
                brightest = std::max(brightest, g.branches().light[foliage[j]]);
        EXPECT_FLOAT_EQ(reader.value(at), static_cast<float>(brightest));
    }
}

TEST(Canopy, IsTheSameOnAnyNumberOfThreads)
{
    const Grove g = grove(8);
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return canopy(g, 0.1, {});
    };
    const Canopy one = on(1), four = on(4);
    EXPECT_TRUE(same(one.leaf_area_density, four.leaf_area_density));
    EXPECT_TRUE(same(one.light, four.light));
}

TEST(Canopy, BadVoxels)
{
    const Grove g = grove(0);
    EXPECT_THAT([&] { canopy(g, -1, {}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("voxel of the canopy = -1 m")));
    EXPECT_THROW(canopy(g, 1e-6, {}), LimitExceeded);
}

TEST(Wood, OfAGrownTreeIsSound)
{
    for (const Model model : {Model::Dichotomy, Model::Conifer, Model::Shoot}) {
        Species species;
        species.model = model;
        if (model == Model::Conifer) {
            species.ball_radius = 1;
            species.death_threshold = 0.45;
            species.tropism = 0.1;
            species.first_length = 1;
        }
        const Grove g = grove(15, species);
        const Branches& b = g.branches();
        ASSERT_GT(b.size(), 100u);
        const auto radius = thickness(b, g.species(), g.plants());
        std::size_t limbs = 0, trees = 0;
        std::vector<int> children(b.size());
        for (std::size_t i = 0; i < b.size(); ++i) {
            trees += b.parent[i] < 0;
            if (b.parent[i] < 0) continue;
            EXPECT_LE(radius[i], radius[std::size_t(b.parent[i])]);
            limbs += children[std::size_t(b.parent[i])]++ > 0;
        }
        expect_limbs(bark_tubes(b, radius, kUnit, {}, {}), limbs + trees);
        const TriMesh wood = meshed(wood_level_set(b, radius, kUnit, 0.01, {}));
        EXPECT_TRUE(inspect(wood).closed());
        if (model != Model::Shoot) {
            EXPECT_EQ(inspect(wood).pieces, trees);
        }
        EXPECT_GT(wood.signed_volume(), 0);
    }
}

}  // namespace
}  // namespace sekitei::tree
