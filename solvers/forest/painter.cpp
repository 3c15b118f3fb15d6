#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "solvers/forest/draw.h"

// The paper's way [Mizoguchi2008, section 4.2]: every slice is a picture, trees are circles drawn
// from small to large in the colour of their number, and space is counted in the pictures. Nothing
// here is shared with the columns but the rule of the highest slice: one checks the other.
namespace sekitei::forest {
namespace {

/// Whether a tree's circle of slice k covers the centre of pixel (i, j).
bool covers(const Canvas& canvas, const Claim& claim, int i, int j, int k)
{
    const Params& p = canvas.params;
    if (i == claim.trunk_i && j == claim.trunk_j) return k <= canvas.top(claim.height);
    double down = 0;  // from the ground at the trunk to that of the pixel
    if (p.slice_frame == SliceFrame::Absolute && !canvas.land.flat())
        down = canvas.land.height((claim.trunk_i % canvas.nx + canvas.nx) % canvas.nx,
                                  (claim.trunk_j % canvas.ny + canvas.ny) % canvas.ny) -
               canvas.land.height(i, j);
    const double z = double(k) - down;
    if (z < 0 || double(k) > std::floor(std::max(1.0, claim.height) + down + 1e-9)) return false;
    const double t = canvas.slope[claim.tree->species];
    const double r = p.orientation == Orientation::Inverted  ? z * t
                     : p.orientation == Orientation::Upright ? std::max(0.0, claim.height - z) * t
                                                             : claim.height * t;
    const double dx = (double(i) + 0.5) * p.pixel - claim.x,
                 dy = (double(j) + 0.5) * p.pixel - claim.y;
    return dx * dx + dy * dy <= r * r;
}

/// Calls f(i, j) for the pixels of the domain whose centres a circle of slice k covers.
template <class F>
void circle(const Canvas& canvas, const Claim& claim, int k, F&& f)
{
    const double p = canvas.params.pixel, r = canvas.radius(*claim.tree) + p;
    const int i0 = std::max(0, int(std::floor(std::max(0.0, (claim.x - r) / p)))),
              i1 = int(std::ceil(std::min(double(canvas.nx), (claim.x + r) / p))),
              j0 = std::max(0, int(std::floor(std::max(0.0, (claim.y - r) / p)))),
              j1 = int(std::ceil(std::min(double(canvas.ny), (claim.y + r) / p)));
    for (int j = j0; j < j1; ++j)
        for (int i = i0; i < i1; ++i)
            if (covers(canvas, claim, i, j, k)) f(i, j);
}

}  // namespace

std::vector<std::uint32_t> paint(const Canvas& canvas, const std::vector<Claim>& claims)
{
    const auto width = std::size_t(canvas.nx), area = width * std::size_t(canvas.ny);
    std::vector<std::uint32_t> image(area * std::size_t(canvas.params.slices), 0);
    // One picture a task.
    parallel_for(std::size_t(canvas.params.slices), [&](std::size_t slice) {
        std::uint32_t* const picture = image.data() + slice * area;
        const int k = int(slice) + 1;
        for (std::size_t c = claims.size(); c-- > 0;)
            circle(canvas, claims[c], k, [&](int i, int j) {
                picture[std::size_t(j) * width + std::size_t(i)] =
                    static_cast<std::uint32_t>(c + 1);
            });
        if (canvas.land.blocked_height.empty()) return;
        for (int j = 0; j < canvas.ny; ++j)
            for (int i = 0; i < canvas.nx; ++i)
                if (double(canvas.land.blocked_height.at(i, j)) > double(k - 1) + 1e-9)
                    picture[std::size_t(j) * width + std::size_t(i)] = kBlocked;
    });
    return image;
}

void count_painted(const Canvas& canvas, const std::vector<std::uint32_t>& image,
                   const std::vector<Claim>& claims, std::vector<Gain>& gains)
{
    const auto width = std::size_t(canvas.nx), area = width * std::size_t(canvas.ny);
    gains.assign(claims.size(), {});
    for (int k = 1; k <= canvas.params.slices; ++k) {
        const DensityMap& map = canvas.density[std::size_t((k - 1) / canvas.params.band)];
        for (int j = 0; j < canvas.ny; ++j)
            for (int i = 0; i < canvas.nx; ++i) {
                const std::uint32_t owner =
                    image[std::size_t(k - 1) * area + std::size_t(j) * width + std::size_t(i)];
                if (owner != 0 && owner != kBlocked) gains[owner - 1].kept += map.at(i, j);
            }
    }
    parallel_for(claims.size(), [&](std::size_t c) {
        for (int k = 1; k <= canvas.params.slices; ++k)
            circle(canvas, claims[c], k, [&](int, int) { ++gains[c].cone; });
    });
}

}  // namespace sekitei::forest
