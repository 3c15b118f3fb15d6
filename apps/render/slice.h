#pragma once

#include "apps/render/render.h"

namespace sekitei::render {

/// A slice's picture and where the plane lies in it: voxel (i, j) of the plane, counted from the
/// lower left, covers pixels [left + i s, left + (i+1) s) by [bottom - (j+1) s, bottom - j s).
struct SlicePlot {
    Image8 image;
    int left = 0, bottom = 0, columns = 0, rows = 0;  ///< columns, rows: voxels
    double scale = 1;                                 ///< s, pixels a voxel
    int plane = 0;                                    ///< voxel index along the axis
};

SlicePlot draw_slice(const Scene& scene, const SliceParams& params);

}  // namespace sekitei::render
