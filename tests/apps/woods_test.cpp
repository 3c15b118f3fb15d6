#include "apps/render/woods.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <optional>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"

namespace sekitei::render {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

/// A trunk of four triangles and leaves of two, lopsided so that turns and mirrors show.
TriMesh small_tree()
{
    TriMesh mesh;
    auto triangle = [&](Vec3f a, Vec3f b, Vec3f c) {
        const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
        for (const Vec3f& v : {a, b, c}) mesh.vertices.push_back(v);
        mesh.triangles.push_back({first, first + 1, first + 2});
    };
    triangle({-0.05f, 0, 0}, {0.05f, 0, 0}, {0, 0, 0.6f});
    triangle({0, -0.05f, 0}, {0, 0.05f, 0}, {0, 0, 0.6f});
    for (int i = 0; i < 20; ++i) {
        auto u = [&](int k) {
            return static_cast<float>(uniform_of_key(5, std::uint64_t(8 * i + k)));
        };
        const Vec3f at{0.6f * u(0) - 0.2f, 0.5f * u(1) - 0.3f, 0.4f + 0.6f * u(2)};
        const Vec3f x{0.1f, 0.1f * u(3), 0.1f * u(4)}, y{-0.1f * u(5), 0.1f, 0.1f * u(6)};
        triangle(at, at + x, at + x + y);
        triangle(at, at + x + y, at + y);
    }
    std::vector<std::int32_t> part(mesh.triangles.size(), 1);
    part[0] = part[1] = 0;
    mesh.face_attributes["part"] = part;
    return mesh;
}

std::vector<TreeModel> models(std::size_t count = 1)
{
    std::vector<TreeModel> list(count);
    for (TreeModel& model : list) model.mesh.fill(small_tree());
    return list;
}

StandingTree standing(std::uint64_t i)
{
    auto u = [&](std::uint64_t k) { return uniform_of_key(7, 16 * i + k); };
    const double half = math::kPi * u(0);
    const auto wide = static_cast<float>(3 + 6 * u(1));
    return {{60 * u(2), 60 * u(3), 5 * u(4)},
            {0, 0, static_cast<float>(math::sin(half)), static_cast<float>(math::cos(half))},
            {wide, wide, static_cast<float>(5 + 15 * u(5))},
            0,
            std::int64_t(i)};
}

/// Its corner in the world: scaled, turned about z, moved.
Vec3d corner(const StandingTree& t, Vec3f p)
{
    const double turn = 2 * std::atan2(double(t.orient[2]), double(t.orient[3]));
    const Vec3d s(p);
    const Vec3d q(s.x * double(t.scale.x), s.y * double(t.scale.y), s.z * double(t.scale.z));
    return t.position + Vec3d(q.x * std::cos(turn) - q.y * std::sin(turn),
                              q.x * std::sin(turn) + q.y * std::cos(turn), q.z);
}

struct Found {
    std::size_t tree = 0, triangle = 0;
    double distance = INFINITY;
};
Found nearest(const std::vector<StandingTree>& trees, const TriMesh& mesh, Vec3d from, Vec3d to)
{
    Found best;
    for (std::size_t i = 0; i < trees.size(); ++i)
        for (std::size_t k = 0; k < mesh.triangles.size(); ++k) {
            const auto& t = mesh.triangles[k];
            const Vec3d a = corner(trees[i], mesh.vertices[t[0]]),
                        e1 = corner(trees[i], mesh.vertices[t[1]]) - a,
                        e2 = corner(trees[i], mesh.vertices[t[2]]) - a;
            const Vec3d h = cross(to, e2), s = from - a, q = cross(s, e1);
            const double det = dot(e1, h), u = dot(s, h) / det, v = dot(to, q) / det,
                         far = dot(e2, q) / det;
            if (u >= 0 && v >= 0 && u + v <= 1 && far > 0 && far < best.distance)
                best = {i, k, far};
        }
    return best;
}

std::vector<StandingTree> stand(std::size_t count)
{
    std::vector<StandingTree> trees;
    for (std::size_t i = 0; i < count; ++i) trees.push_back(standing(i));
    return trees;
}
std::vector<std::uint8_t> level_of_all(std::size_t count, std::uint8_t level = 0)
{
    return std::vector<std::uint8_t>(count, level);
}

TEST(Woods, RaysMeetCopiesWhereTheTransformedMeshIs)
{
    const auto trees = stand(40);
    const TriMesh mesh = small_tree();
    const Woods woods(trees, models(), level_of_all(trees.size()), 1);
    int met = 0;
    for (std::uint64_t i = 0; i < 1000; ++i) {
        auto u = [&](std::uint64_t k) { return uniform_of_key(11, 8 * i + k); };
        const Vec3d from(80 * u(0) - 10, 80 * u(1) - 10, 25 * u(2));
        const StandingTree& aim = trees[std::size_t(u(3) * 40)];
        const Vec3d to = normalized(aim.position + Vec3d(3 * u(4), 3 * u(5), 12 * u(6)) - from);
        const Vec3f origin(from), direction(to);
        const Found truth = nearest(trees, mesh, Vec3d(origin), Vec3d(direction));
        WoodHit hit;
        const bool found = woods.intersect(origin, direction, 1e4f, hit);
        ASSERT_EQ(found, std::isfinite(truth.distance)) << i;
        EXPECT_EQ(woods.occluded(origin, direction, 1e4f), found);
        if (!found) continue;
        ++met;
        EXPECT_EQ(hit.tree, truth.tree);
        EXPECT_EQ(hit.triangle, truth.triangle);
        EXPECT_NEAR(hit.distance, truth.distance, 1e-4);
        Vec3f position, geometric, soft;
        woods.place(hit, position, geometric, soft);
        EXPECT_LT(length(Vec3d(position) - (from + to * truth.distance)), 1e-3);
        // Across the face: uneven scale turns normals its own way.
        const auto& t = mesh.triangles[truth.triangle];
        const Vec3d a = corner(trees[truth.tree], mesh.vertices[t[0]]);
        const Vec3d normal = normalized(cross(corner(trees[truth.tree], mesh.vertices[t[1]]) - a,
                                              corner(trees[truth.tree], mesh.vertices[t[2]]) - a));
        EXPECT_GT(dot(normal, Vec3d(geometric)), 0.9999);
        EXPECT_GT(dot(normal, Vec3d(soft)), 0.999);
        EXPECT_FALSE(woods.occluded(origin, direction, float(truth.distance * 0.999)));
    }
    EXPECT_GT(met, 200);
}

TEST(Woods, LevelsFollowTheSizeInPixels)
{
    std::size_t last = 0;
    for (double pixels = 3000; pixels > 1; pixels *= 0.9) {
        EXPECT_GE(tree_level(pixels), last);
        last = tree_level(pixels);
    }
    EXPECT_EQ(tree_level(3000), 0U);
    EXPECT_EQ(last, kTreeLevels - 1);

    std::vector<StandingTree> trees(3);
    for (StandingTree& t : trees) t.scale = {8, 8, 20};
    trees[1].position.x = 300;
    trees[2].position.x = 5000;
    const auto levels = tree_levels(trees, 1, {{0, 0, 10}, 0.001});
    EXPECT_EQ(levels[0], 0);  // the eye is in it
    EXPECT_EQ(levels[1], tree_level(20 / 0.3));
    EXPECT_EQ(levels[2], kTreeLevels - 1);
    for (const std::uint8_t level : tree_levels(trees, 1, {})) EXPECT_EQ(level, 0);

    // A copy is drawn with the mesh of its own level.
    auto two = models();
    two[0].mesh[3] = {};
    for (Vec3f& v : two[0].mesh[2].vertices) v.z *= 0.5f;
    trees.resize(1);
    WoodHit hit;
    const Woods low(trees, two, level_of_all(1, 2), 1), high(trees, two, level_of_all(1, 1), 1);
    auto top = [&](const Woods& woods) {
        double best = 0;
        for (int i = -60; i <= 60; ++i)
            for (int j = -60; j <= 60; ++j)
                if (woods.intersect({0.1f * float(i), 0.1f * float(j), 50}, {0, 0, -1}, 100, hit))
                    best = std::max(best, 50 - hit.distance);
        return best;
    };
    EXPECT_NEAR(top(low), top(high) / 2, 0.3);
    EXPECT_THAT([&] { Woods(trees, two, level_of_all(1, 3), 1); },
                ThrowsMessage<InvalidInput>(HasSubstr("no triangles")));
}

TEST(Woods, TreesDifferByTheirIdAndLeavesFromBark)
{
    auto trees = stand(30);
    auto of = [](const std::vector<StandingTree>& list, std::uint32_t tree,
                 std::uint32_t triangle) {
        const Woods woods(list, models(), level_of_all(list.size()), 1);
        return woods.material({tree, triangle, 1, 0.3f, 0.3f}, {{1, 1, 1}, {0, 0, 1}});
    };
    const Material bark = of(trees, 0, 0), leaf = of(trees, 0, 2);
    EXPECT_EQ(length(bark.transmit), 0);
    EXPECT_GT(length(leaf.transmit), 0);
    EXPECT_EQ(of(trees, 0, 2).albedo, of(trees, 0, 3).albedo) << "one leaf";
    EXPECT_NE(of(trees, 0, 2).albedo, of(trees, 1, 2).albedo) << "two trees";
    // The same tree in another list and place in it.
    std::vector<StandingTree> alone{trees[9], trees[3]};
    EXPECT_EQ(of(alone, 1, 5).albedo, of(trees, 3, 5).albedo);
}

TEST(Woods, MistakesAreNamed)
{
    auto refuse = [](auto&& change, const char* words) {
        std::vector<StandingTree> trees(2);
        change(trees[1]);
        EXPECT_THAT([&] { tree_levels(trees, 1, {}); },
                    ThrowsMessage<InvalidInput>(HasSubstr(words)));
    };
    refuse([](StandingTree& t) { t.position.x = NAN; }, "tree 1 at (nan");
    refuse([](StandingTree& t) { t.orient = {0, 0, 0, 0}; }, "orientation");
    refuse([](StandingTree& t) { t.scale.z = 0; }, "tree 1 has scale (1, 1, 0)");
    refuse([](StandingTree& t) { t.scale.x = NAN; }, "scale (nan");
    refuse([](StandingTree& t) { t.model = 1; }, "model 1, must be 0 to 0");
    refuse([](StandingTree& t) { t.model = -1; }, "model -1");
    auto bad = models();
    bad[0].mesh[0].face_attributes.clear();
    EXPECT_THAT([&] { Woods(stand(1), bad, level_of_all(1), 1); },
                ThrowsMessage<InvalidInput>(HasSubstr("'part'")));
    bad = models();
    bad[0].mesh[0].triangles[4][1] = 9999;
    EXPECT_THAT([&] { Woods(stand(1), bad, level_of_all(1), 1); },
                ThrowsMessage<InvalidInput>(HasSubstr("triangle 4 names vertex 9999")));
}

TEST(Woods, PicturesAreTheSameOnAnyNumberOfThreads)
{
    TriMesh floor;
    floor.vertices = {{-20, -20, 0}, {80, -20, 0}, {80, 80, 0}, {-20, 80, 0}};
    floor.triangles = {{0, 1, 2}, {0, 2, 3}};
    floor.vertex_attributes["light"] = std::vector<float>{0, 0.3f, 0.6f, 1};
    Stuff stuff;
    stuff.pieces.push_back({&floor, Substance::Floor});
    stuff.trees = stand(60);
    stuff.models = 1;
    int asked = 0;
    stuff.grow = [&](const std::vector<std::uint8_t>& levels) {
        asked = levels.at(0);
        return models();
    };
    const Params params{.width = 64, .height = 40, .samples = 4};
    auto picture = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return run(stuff, params, 3, {}).pixels;
    };
    const auto one = picture(1);
    EXPECT_EQ(one, picture(2));
    EXPECT_NE(asked, 0);
    stuff.trees.clear();
    EXPECT_NE(one, picture(1));
}

}  // namespace
}  // namespace sekitei::render
