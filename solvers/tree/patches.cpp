#include "solvers/tree/patches.h"

#include <fmt/format.h>

#include <cmath>

#include "core/error.h"
#include "core/math.h"

namespace sekitei::tree {

SkyPatches sky_patches(int rows, int across, double upper, double lower)
{
    if (rows < 2 || rows % 2 != 0)
        throw InvalidParameter(
            fmt::format("tree: patch_rows = {}, must be an even number, >= 2", rows));
    if (across < 3)
        throw InvalidParameter(fmt::format("tree: patch_columns = {}, must be >= 3", across));
    for (const double c : {upper, lower})
        if (!(std::isfinite(c) && c >= 0))
            throw InvalidParameter(fmt::format(
                "tree: brightness of the sky = {} above, {} below, must be >= 0", upper, lower));
    if (upper + lower == 0)
        throw InvalidParameter("tree: brightness of the sky = 0 above, 0 below, one must be > 0");

    SkyPatches sky;
    sky.rows = rows;
    sky.across = across;
    const int half_rows = rows / 2, half_turn = across % 2 == 0 ? across / 2 : across;
    // A row and its mirror image below, a column and the one across: from the same numbers, so that
    // opposite patches are exact negatives.
    auto edge = [&](int row) {
        return row == half_rows ? 0 : math::cos(math::kPi * static_cast<double>(row) / rows);
    };
    for (int row = 0; row < rows; ++row) {
        const bool above = row < half_rows;
        const int v = above ? row : rows - 1 - row;
        const double polar = (v + 0.5) * math::kPi / rows, s = math::sin(polar),
                     z = above ? math::cos(polar) : -math::cos(polar),
                     solid = 2 * math::kPi / across * (edge(v) - edge(v + 1));
        for (int column = 0; column < across; ++column) {
            const double azimuth = (column % half_turn + 0.5) * 2 * math::kPi / across,
                         side = column < half_turn ? s : -s;
            sky.direction.emplace_back(side * math::cos(azimuth), side * math::sin(azimuth), z);
            sky.solid.push_back(solid);
            sky.brightness.push_back(above ? upper : lower);
            sky.open += sky.brightness.back() * solid;
        }
    }
    return sky;
}

}  // namespace sekitei::tree
