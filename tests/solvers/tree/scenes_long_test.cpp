#include <gtest/gtest.h>

#include "scenes.h"

/// Scenes that take more than a second or two for five seeds.
namespace sekitei::tree::scenes {
namespace {

const Seeds kFive{1, 2, 3, 4, 5};

TEST(TreeScenesOfFiveSeeds, TropismSpreadsTipsAndMakesThemWeep)
{
    dichotomy(kFive);
}
TEST(TreeScenesOfFiveSeeds, ACrownClosesWhereANeighbourWas)
{
    regeneration(kFive);
}
TEST(TreeScenesOfFiveSeeds, LeavesOfAnySizeGiveOneOutline)
{
    radius(kFive);
}
TEST(TreeScenesOfFiveSeeds, TreesGrowAwayFromWallsAndOutFromUnderRoofs)
{
    wall_and_roof(kFive);
}

}  // namespace
}  // namespace sekitei::tree::scenes
