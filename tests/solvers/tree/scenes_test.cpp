#include "scenes.h"

#include <gtest/gtest.h>

#include "solvers/tree/grove.h"

namespace sekitei::tree::scenes {
namespace {

const Seeds kFive{1, 2, 3, 4, 5};

TEST(TreeScenes, ShootsFormACrown)
{
    crown(kFive);
}
TEST(TreeScenes, ClustersOfShootsFormOneCrown)
{
    clusters(kFive);
}
TEST(TreeScenes, ShootsOfAStemFormATallCrown)
{
    cylinder(kFive);
}
TEST(TreeScenes, TropismSpreadsTipsAndMakesThemWeep)
{
    dichotomy({1});
}
TEST(TreeScenes, ACrownClosesWhereANeighbourWas)
{
    regeneration({1});
}
TEST(TreeScenes, LeavesOfAnySizeGiveOneOutline)
{
    radius({1});
}
TEST(TreeScenes, TipsThatBearShadeMakeShrubs)
{
    threshold(kFive);
}
TEST(TreeScenes, LightFromAboveMakesTallCrowns)
{
    light_ratio(kFive);
}
TEST(TreeScenes, ThePapersWordsOnShadeLeadToExtinction)
{
    shading_rule(kFive);
}
TEST(TreeScenes, ConifersAreConesAndShedLowBoughs)
{
    conifer(kFive);
}
TEST(TreeScenes, PollardsRegrowFromDormantBuds)
{
    pollard(kFive);
}
TEST(TreeScenes, TreesGrowAwayFromWallsAndOutFromUnderRoofs)
{
    wall_and_roof({2});
}
TEST(TreeScenes, TreesLeanOutOfTheForest)
{
    forest_edge(kFive);
}
TEST(TreeScenes, DeadWoodLeavesTheLivingAlone)
{
    dead_wood(kFive);
}

/// Trees of all models with all that they can have, on the ground.
Grove mixed()
{
    Species fork;
    fork.death_threshold = 0.4;
    fork.latent_share = 0.7;
    fork.latent_light = 0.5;
    fork.latent_chance = 0.5;
    fork.active_period = 9;
    fork.shed_delay = 2;
    fork.dead_persist = 3;
    fork.leaf_retention = 2;
    fork.vertical_azimuth = Azimuth::Random;
    Species spruce = scenes::spruce();
    spruce.active_period = 6;
    spruce.strong_boughs = 2;
    spruce.latent_share = 1;
    spruce.latent_light = 0.4;
    spruce.latent_chance = 0.3;
    Species bush;
    bush.model = Model::Shoot;
    bush.buds = 20;
    return Grove({}, {fork, spruce, bush},
                 {{{-6, 0, 0}, 0}, {{6, 0, 0}, 0, 3}, {{0, 9, 0}, 1}, {{0, -9, 2}, 2}}, 11);
}

void expect_same(const Grove& a, const Grove& b)
{
    const Grove::State s = a.state(), t = b.state();
    EXPECT_TRUE(s.branches == t.branches);
    EXPECT_TRUE(s.buds == t.buds);
    EXPECT_EQ(s.tips, t.tips);
    EXPECT_EQ(s.generation, t.generation);
    EXPECT_EQ(s.next_root, t.next_root);
    EXPECT_EQ(s.seed, t.seed);
}

TEST(SavedGrove, GoesOnToTheSameBitsAtAnyGeneration)
{
    Grove grove = mixed();
    std::size_t sprouts = 0;
    for (int g = 0; g < 24; ++g) {
        Grove again(grove.params(), grove.species(), grove.state());
        expect_same(again, grove);
        again.grow(3);
        Grove on = grove;
        on.grow(3);
        expect_same(again, on);
        sprouts += grove.step().sprouts;
        if (g == 6)  // wakes buds
            grove.prune([](const Branches& b, std::size_t i) { return b.end(i).y > 10; });
    }
    EXPECT_GT(sprouts, 0u);
    EXPECT_GT(grove.tips(), 50u);
}

TEST(SavedGrove, GoesOnToTheSameBitsAfterTreesWereRemovedCutAndAdded)
{
    Grove grove = mixed();
    grove.grow(8);
    Grove saved(grove.params(), grove.species(), grove.state());
    for (Grove* g : {&grove, &saved}) {
        g->remove_tree(0);
        g->prune([](const Branches& b, std::size_t i) {
            return b.tree[i] == 1 ? b.end(i).z > 16 : b.tree[i] == 3 && b.end(i).x > 2;
        });
        g->add_plant({{20, 20, 1}, 1});
    }
    expect_same(grove, saved);
    EXPECT_GT(grove.tips(), 0u);
    // Save again what is cut, too.
    Grove once_more(grove.params(), grove.species(), grove.state());
    for (Grove* g : {&grove, &saved, &once_more}) g->grow(12);
    expect_same(grove, saved);
    expect_same(grove, once_more);
    for (const std::int32_t tree : grove.branches().tree) EXPECT_NE(tree, 0);
}

TEST(RemoveTree, TakesOneTreeAndLeavesTheOthersWhereTheyWere)
{
    Grove grove = mixed();
    grove.grow(10);
    const Grove::State before = grove.state();
    grove.remove_tree(2);
    std::size_t left = 0;
    for (std::size_t i = 0; i < before.branches.size(); ++i) {
        if (before.branches.tree[i] == 2) continue;
        ASSERT_LT(left, grove.branches().size());
        EXPECT_EQ(grove.branches().key[left], before.branches.key[i]);
        EXPECT_EQ(grove.branches().end(left), before.branches.end(i));
        ++left;
    }
    EXPECT_LT(left, before.branches.size());
    EXPECT_EQ(left, grove.branches().size());
    std::size_t tips = 0;
    for (const std::uint32_t tip : before.tips) tips += before.branches.tree[tip] != 2;
    EXPECT_EQ(grove.tips(), tips);
    for (const std::uint32_t tip : grove.tip_list()) EXPECT_LT(tip, left);
}

}  // namespace
}  // namespace sekitei::tree::scenes
