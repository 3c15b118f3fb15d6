#include <gtest/gtest.h>

#include "scenes.h"

/// The scenes with three seeds, and one that takes long.
namespace sekitei::forest::scenes {
namespace {

const Seeds kThree{1, 2, 3};

TEST(ForestScenesOfThreeSeeds, SettleInLayersThinOutAndLeaveAPathFree)
{
    half_a_kilometre(kThree);
}
TEST(ForestScenesOfThreeSeeds, HaveNoLayersUnderUprightConesAndDiscs)
{
    controls(kThree);
}
TEST(ForestScenesOfThreeSeeds, HaveMoreTreesWhereMapsAreHigher)
{
    densities(kThree);
}
TEST(ForestScenesOfThreeSeeds, KeepTheirTallTreesWhereTheGroundIsCleared)
{
    cleared(kThree);
}
TEST(ForestScenesOfThreeSeeds, LoseTallTreesAloneWhereTheUpperMapsAreZero)
{
    felling(kThree);
}
TEST(ForestScenesOfThreeSeeds, FillAClearingFromItsEdge)
{
    filling(kThree);
}
TEST(ForestScenesOfThreeSeeds, AreTheSamePaintedOrInColumns)
{
    painter(kThree);
}
TEST(ForestScenesOfThreeSeeds, FollowWater)
{
    water(kThree);
}
TEST(ForestScenesOfThreeSeeds, SpareCliffs)
{
    slopes(kThree);
}
TEST(ForestScenesLarge, DoNotDependOnTilesThreadsAndDisks)
{
    tiles(kThree);
}
TEST(ForestScenesLarge, AreAsDenseAsSmallOnes)
{
    large(10000, {1});
}

}  // namespace
}  // namespace sekitei::forest::scenes
