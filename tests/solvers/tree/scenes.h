#pragma once

#include <cstdint>
#include <vector>

#include "solvers/tree/species.h"

/// The scenes of the paper's figures, and some of our own, grown and measured for each seed. What
/// must hold of them is asserted; what was found is printed. Table 1 of the paper and no ground
/// unless a scene says otherwise.
namespace sekitei::tree::scenes {

/// The conifer of S10.
Species spruce();

using Seeds = std::vector<std::uint64_t>;

void crown(const Seeds& seeds);          ///< S1, figure 5
void clusters(const Seeds& seeds);       ///< S2, figures 6 (a), (b)
void cylinder(const Seeds& seeds);       ///< S3, figure 6 (c)
void dichotomy(const Seeds& seeds);      ///< S4, figure 10
void regeneration(const Seeds& seeds);   ///< S5, figure 11
void radius(const Seeds& seeds);         ///< S6, figure 12
void threshold(const Seeds& seeds);      ///< S7, figure 13
void light_ratio(const Seeds& seeds);    ///< S8, figure 14
void shading_rule(const Seeds& seeds);   ///< S9
void conifer(const Seeds& seeds);        ///< S10, figures 16 and 17
void pollard(const Seeds& seeds);        ///< S11, figures 1 and 17
void wall_and_roof(const Seeds& seeds);  ///< S12
void forest_edge(const Seeds& seeds);    ///< S13
void dead_wood(const Seeds& seeds);      ///< S14

}  // namespace sekitei::tree::scenes
