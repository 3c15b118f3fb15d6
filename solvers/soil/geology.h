#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/image.h"
#include "core/mesh.h"
#include "core/mesh_sites.h"
#include "core/params.h"
#include "core/progress.h"
#include "core/vec.h"
#include "solvers/soil/soil.h"

/// Which soil lies where on a mesh.
namespace sekitei::soil {

/// What ground looks like [Nomura2010, section 3.2].
struct GeologyParams {
    std::string colours = "humus #6F4B3E, sand #C39143, asphalt #7D7D7D";
    std::string fallback;
    double farthest = 40;

    static void describe(auto&& field)
    {
        field("colours", &GeologyParams::colours,
              "soils and their colours in the texture: 'humus #6F4B3E, sand #C39143'");
        field("fallback", &GeologyParams::fallback,
              "soil of colours unlike all of these; empty: such a colour is an error");
        field("farthest", &GeologyParams::farthest, "", kPositive,
              "difference of colours (CIE 1976, Delta E) that still counts as alike");
    }
};

/// One soil's colour, sRGB.
struct SoilColour {
    std::string soil;
    std::array<std::uint8_t, 3> colour{};
};

/// Reads GeologyParams::colours.
/// @throws InvalidParameter  an entry that is not "name #RRGGBB", no entry
std::vector<SoilColour> soil_colours(std::string_view text);

/// CIELAB, white point D65 2 degrees, of an sRGB colour (IEC 61966-2-1) with channels 0..1.
Vec3d lab_of_srgb(Vec3d srgb);

/// The soil of each site: 1 + its index in `soils`.
///
/// A face attribute `geology` (int32) decides where the mesh has one; its values are returned as
/// they are. Else the texture at the site's centroid does: bilinear between the sRGB values of
/// texels whose centres lie at (i + 1/2) / size, v upwards, repeated beyond 0..1; then the soil
/// whose colour is nearest in CIELAB. Where none is within `farthest`: `fallback`.
///
/// @param mesh       that `sites` were made of, with the face attributes uv_0, uv_1, uv_2 (Vec3f)
/// @param texture    RGB or RGBA; null: there is none
/// @param soils      what colours and fallback may name
/// @param mesh_name  for messages
/// @throws InvalidInput  neither the attribute nor texture and coordinates; coordinates that are
///                       not finite; a colour unlike all: the first site, its colour, its distances
/// @throws InvalidParameter  a soil that is not in `soils`
///
/// Bit-identical for any number of threads.
std::vector<std::int32_t> geology(const TriMesh& mesh, const MeshSites& sites,
                                  const Image8* texture, std::span<const Soil> soils,
                                  const GeologyParams& params, std::string_view mesh_name,
                                  const Progress& progress);

}  // namespace sekitei::soil
