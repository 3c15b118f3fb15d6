#include "scenes.h"

#include <gtest/gtest.h>

/// The scenes with one seed.
namespace sekitei::forest::scenes {
namespace {

TEST(ForestScenes, SettleInLayersThinOutAndLeaveAPathFree)
{
    half_a_kilometre({1});
}
TEST(ForestScenes, HaveNoLayersUnderUprightConesAndDiscs)
{
    controls({1});
}
TEST(ForestScenes, HaveMoreTreesWhereMapsAreHigher)
{
    densities({1});
}
TEST(ForestScenes, KeepTheirTallTreesWhereTheGroundIsCleared)
{
    cleared({1});
}
TEST(ForestScenes, LoseTallTreesAloneWhereTheUpperMapsAreZero)
{
    felling({1});
}
TEST(ForestScenes, FillAClearingFromItsEdge)
{
    filling({1});
}
TEST(ForestScenes, AreTheSamePaintedOrInColumns)
{
    painter({1});
}
TEST(ForestScenes, FollowWater)
{
    water({1});
}
TEST(ForestScenes, SpareCliffs)
{
    slopes({1});
}

}  // namespace
}  // namespace sekitei::forest::scenes
