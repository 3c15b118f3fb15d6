#pragma once

#include <cstdint>
#include <vector>

#include "core/mesh.h"

namespace sekitei {

/// How often a mesh winds around a point [Jacobson2013]: 1 inside and 0 outside a closed mesh wound
/// outwards, something between near the holes of an open one.
///
/// Far triangles are taken together as dipoles in a tree [Barill2018, eq. 8]; error below 0.02.
class WindingNumber {
public:
    explicit WindingNumber(const TriMesh& mesh);

    double operator()(Vec3d p) const;

private:
    struct Node {
        Vec3d centre, area;  ///< area-weighted centre; sum of area vectors
        double radius = 0;   ///< of a ball about the centre that holds all its triangles
        std::uint32_t begin = 0, end = 0;
        std::uint32_t right = 0;  ///< the left child follows its parent; 0: no children
    };
    std::uint32_t build(std::uint32_t begin, std::uint32_t end, std::vector<Vec3d>& centres);

    std::vector<std::array<Vec3d, 3>> triangles_;
    std::vector<Node> nodes_;
};

}  // namespace sekitei
