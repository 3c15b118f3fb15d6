#pragma once

#include "core/mesh.h"

/// The stone lantern and the garden of [Ogasawara2003, section 5], as exact surfaces.
namespace sekitei::garden {

/// Heights and widths of the lantern [m]; its axis is x = y = 0 and the ground is z = 0.
inline constexpr double kLanternHeight = 1.5;
inline constexpr double kLanternRadius = 0.36;  ///< half the width of the roof, its widest part

/// A stone lantern of 1.5 m: base 0.50 x 0.50 x 0.15, shaft of radius 0.12 up to 0.75, platform
/// 0.44 x 0.44 x 0.10, fire box 0.32 x 0.32 x 0.28 with a window of 0.14 in each side up to 1.13,
/// roof from 0.36 to 0.08 of half width up to 1.35, ball of radius 0.075 around 1.425.
///
/// A closed manifold of genus 3 (the windows meet inside) in two pieces that touch, the ball being
/// one; planes are exact, the shaft is a prism whose edges lie on the cylinder (0.05 mm), the ball
/// an icosphere.
/// @param sunk  how far the base reaches below the ground [m], >= 0
TriMesh lantern(double sunk);

/// An axis-parallel box.
TriMesh box(Vec3d lower, Vec3d upper);

/// Adds a closed mesh to another; attributes are not joined.
void append(TriMesh& mesh, const TriMesh& other);

}  // namespace sekitei::garden
