#include "solvers/lava/lava.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/error.h"
#include "core/log.h"
#include "core/mesh_intersections.h"
#include "core/noise.h"
#include "grids/level_set.h"

namespace sekitei::lava {
namespace {

constexpr double kContact = 3.0 / 32;  // of the paper's cold slabs, share of the box height
constexpr double kHeatVoxels = 8;      // fine voxels to a heat cell, at most
constexpr double kLongestSide = 250;   // voxels, when the size of a voxel is left to us
constexpr Stream kTopNoise{"lava.top"}, kBottomNoise{"lava.bottom"};

bool from_file(Preset preset)
{
    return preset == Preset::HeightMap || preset == Preset::Mesh || preset == Preset::Volume;
}

Coord preset_dims(Preset preset)
{
    switch (preset) {
        case Preset::Cliff:
            return {500, 50, 300};
        case Preset::Tower:
        case Preset::Slab:
            return {200, 200, 200};
        case Preset::Coast:
            return {300, 300, 300};
        default:
            return {250, 250, 250};
    }
}

double preset_amplitude(Preset preset)
{
    if (preset == Preset::Slab || from_file(preset)) return 0;
    return preset == Preset::Cliff ? 0.05 : 0.03;
}

double longest(Vec3d v)
{
    return std::max({v.x, v.y, v.z});
}

// --- boxes ---

/// Where the boxes lie, in doubles, so that absurd requests can still be told in numbers.
struct Layout {
    double voxel = 0;
    Vec3d origin;      // world [m]
    Vec3d dims;        // fine voxels
    double ratio = 8;  // edge of a heat cell in fine voxels
    Vec3d heat_dims;
    Coord first;  // index of the foreign grid's voxel that becomes (0, 0, 0)
};

/// Number of edges that cover `share`, forgiving a product that is whole but for rounding.
double cells_over(double share)
{
    return std::max(1.0, std::ceil(share * (1 - 1e-12) - 1e-9));
}

Vec3d cells_over(Vec3d size, double edge)
{
    return {cells_over(size.x / edge), cells_over(size.y / edge), cells_over(size.z / edge)};
}

/// Lays the coarse grid over the same box.
void add_heat_cells(Layout& layout, const Params& params)
{
    const double side = longest(layout.dims);
    layout.ratio =
        params.heat_cell ? *params.heat_cell / layout.voxel : side / std::ceil(side / kHeatVoxels);
    if (layout.ratio < 1 - 1e-9)
        throw InvalidParameter(
            fmt::format("lava: heat_cell = {:.4g} m, must be at least one voxel, {:.4g} m",
                        *params.heat_cell, layout.voxel));
    layout.heat_dims = cells_over(layout.dims, layout.ratio);
}

double margin_of(const Params& params, double voxel)
{
    return params.margin.value_or(2 * params.heat_cell.value_or(kHeatVoxels * voxel));
}

/// A voxel such that the longest side with its margins has kLongestSide of them.
double voxel_for(double side, double margins, const Params& params)
{
    if (params.voxel) return *params.voxel;
    if (params.margin || params.heat_cell)
        return (side + margins * margin_of(params, 0)) / kLongestSide;
    return side / (kLongestSide - margins * 2 * kHeatVoxels);
}

const Image16& height_image(const Inputs& inputs)
{
    if (!inputs.height_map || inputs.height_map->width < 1 || inputs.height_map->height < 1)
        throw InvalidInput(
            "lava: preset = height_map without a picture; give --height-map FILE.png");
    return *inputs.height_map;
}

/// Least and largest height of the map [m].
std::pair<double, double> height_range(const Params& params, const Image16& image)
{
    std::uint16_t low = 65535, high = 0;
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x) {
            low = std::min(low, image.at(x, y));
            high = std::max(high, image.at(x, y));
        }
    const double span = (*params.height_high - *params.height_low) / 65535;
    return {*params.height_low + low * span, *params.height_low + high * span};
}

void require_scale(const Params& params)
{
    if (!params.metres_per_pixel || !params.height_low || !params.height_high)
        throw InvalidParameter(
            "lava: a height map needs metres_per_pixel, height_low and height_high: the size of "
            "its pixels and the heights of black and white");
}

Layout height_map_layout(const Params& params, const Inputs& inputs)
{
    const Image16& image = height_image(inputs);
    require_scale(params);
    const double top = height_range(params, image).second;
    if (top <= params.base)
        throw InvalidParameter(fmt::format(
            "lava: base = {:.6g} m, must lie below the highest point of the height map, {:.6g} m",
            params.base, top));
    const Vec3d size{image.width * *params.metres_per_pixel,
                     image.height * *params.metres_per_pixel, top - params.base};
    Layout layout;
    layout.voxel = params.voxel.value_or(longest(size) / kLongestSide);
    const double margin = margin_of(params, layout.voxel), below = params.cold_ground ? margin : 0;
    layout.origin = {0, 0, params.base - below};
    layout.dims = cells_over({size.x, size.y, size.z + below + margin}, layout.voxel);
    return layout;
}

void require_mesh(const Inputs& inputs)
{
    if (!inputs.mesh)
        throw InvalidInput("lava: preset = mesh without a mesh; give --mesh FILE.ply");
    const TriMesh& mesh = *inputs.mesh;
    if (mesh.triangles.empty())
        throw InvalidInput(fmt::format(
            "lava: the mesh has {} vertices and no triangles, expected a closed surface; mesh a "
            "point cloud first",
            mesh.vertices.size()));
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
        const Vec3f v = mesh.vertices[i];
        if (!std::isfinite(v.x) || !std::isfinite(v.y) || !std::isfinite(v.z))
            throw InvalidInput(fmt::format(
                "lava: vertex {} of the mesh is NaN or infinite, expected finite coordinates", i));
    }
}

Bounds mesh_bounds(const Params& params, const TriMesh& mesh)
{
    Bounds bounds;
    for (const Vec3f& v : mesh.vertices) bounds.add(Vec3d(v) * params.mesh_scale);
    return bounds;
}

Layout mesh_layout(const Params& params, const Inputs& inputs)
{
    require_mesh(inputs);
    const Bounds bounds = mesh_bounds(params, *inputs.mesh);
    Layout layout;
    layout.voxel = voxel_for(longest(bounds.size()), 2, params);
    if (!(layout.voxel > 0))
        throw InvalidInput(
            "lava: all vertices of the mesh lie in one point, expected a body with a volume");
    const double margin = margin_of(params, layout.voxel);
    layout.origin = bounds.lower - Vec3d(margin);
    // Vertices are floats: a thousandth of a voxel makes no voxel more.
    layout.dims = cells_over(bounds.size() + Vec3d(2 * margin - 1e-3 * layout.voxel), layout.voxel);
    return layout;
}

/// What a volume offers as a body.
struct VolumeBody {
    const IntGrid* region = nullptr;
    const FloatGrid *body = nullptr, *slow = nullptr;

    const Transform& transform() const { return region ? region->transform() : body->transform(); }
};

VolumeBody volume_body(const Inputs& inputs)
{
    if (!inputs.volume)
        throw InvalidInput("lava: preset = volume without a scene; name a .vdb file to read");
    const Scene& scene = *inputs.volume;
    VolumeBody found;
    if (scene.has("body_sdf")) {
        found.body = &scene.floats("body_sdf");
        if (scene.has("slow_sdf")) found.slow = &scene.floats("slow_sdf");
    } else if (scene.has("region")) {
        found.region = &scene.ints("region");
    } else {
        std::string names, level_sets;
        int count = 0;
        for (const auto& [name, grid] : scene.grids) {
            names += fmt::format("{}{} ({})", names.empty() ? "" : ", ", name, grid.type_name());
            const auto* floats = std::get_if<FloatGrid>(&grid.values);
            if (!floats || grid.grid_class != GridClass::LevelSet) continue;
            found.body = floats;
            level_sets += (count++ ? ", " : "") + name;
        }
        if (count == 0)
            throw InvalidInput(fmt::format(
                "lava: no body in the volume: it holds {}; expected an int32 grid `region` (0 "
                "lava, 1 cold, 2 slow), a float grid `body_sdf`, or one grid of class level set",
                names.empty() ? "no grids" : names));
        if (count > 1)
            throw InvalidInput(fmt::format(
                "lava: {} level sets in the volume ({}), expected one; rename the body `body_sdf`, "
                "or read one grid only",
                count, level_sets));
    }
    if (found.slow && !(found.slow->transform() == found.body->transform()) &&
        found.slow->leaf_count() > 0)
        throw InvalidInput(
            "lava: body_sdf and slow_sdf have different transforms, expected the same voxels; "
            "resample one of them");
    return found;
}

/// The indices [lower, upper) of voxels that satisfy `wanted`.
template <class T, class Wanted>
std::pair<Coord, Coord> extent_of(const LeafGrid<T>& grid, Wanted&& wanted)
{
    Coord lower(INT32_MAX), upper(INT32_MIN);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) {
            if (!wanted(grid.at(leaf, o), grid.mask(leaf).test(o))) continue;
            const Coord c = leaf_coord(grid.origin(leaf), o);
            lower = min(lower, c);
            upper = max(upper, c + Coord(1, 1, 1));
        }
    return {lower, upper};
}

Layout volume_layout(const Params& params, const Inputs& inputs)
{
    const VolumeBody body = volume_body(inputs);
    const Transform& transform = body.transform();
    Layout layout;
    layout.voxel = transform.voxel;
    if (params.voxel && std::fabs(*params.voxel / transform.voxel - 1) > 1e-6)
        throw InvalidParameter(fmt::format(
            "lava: voxel = {:.6g} m, but the volume's voxels are {:.6g} m; leave voxel out, or "
            "resample the volume first",
            *params.voxel, transform.voxel));

    // A scene of ours knows its box.
    if (inputs.volume->domain.dims.x > 0 && inputs.volume->domain.transform == transform) {
        layout.origin = transform.origin;
        layout.dims = Vec3d(inputs.volume->domain.dims);
        return layout;
    }
    // A foreign region says which box it means when it has cold voxels of its own; otherwise, and
    // around level sets, there is a cold margin.
    auto [lower, upper] =
        body.region ? extent_of(*body.region, [](std::int32_t, bool active) { return active; })
                    : extent_of(*body.body, [](float v, bool) { return v <= 0; });
    if (lower.x >= upper.x)
        throw InvalidInput(body.region
                               ? "lava: the grid `region` has no active voxels, expected lava (0)"
                               : "lava: the level set is nowhere negative, expected a body inside");
    bool own_box = false;
    if (body.region)
        for (std::size_t leaf = 0; leaf < body.region->leaf_count() && !own_box; ++leaf)
            for (int o = 0; o < kLeafSize && !own_box; ++o)
                own_box = body.region->mask(leaf).test(o) && body.region->at(leaf, o) == kCold;
    if (!own_box || params.margin) {
        const int margin = static_cast<int>(
            std::min(1e6, std::ceil(margin_of(params, layout.voxel) / layout.voxel)));
        lower -= Coord(margin);
        upper += Coord(margin);
    }
    // Leaves keep their blocks when the shift is a multiple of eight; a box the user drew is kept
    // exactly, by moving voxels one by one.
    layout.first = own_box && !params.margin ? lower : leaf_origin(lower);
    layout.origin = transform.world(Vec3d(layout.first));
    layout.dims = Vec3d(upper) - Vec3d(layout.first);
    return layout;
}

Layout lay_out(const Params& params, const Inputs& inputs)
{
    Layout layout;
    switch (params.preset) {
        case Preset::HeightMap:
            layout = height_map_layout(params, inputs);
            break;
        case Preset::Mesh:
            layout = mesh_layout(params, inputs);
            break;
        case Preset::Volume:
            layout = volume_layout(params, inputs);
            break;
        default: {
            const Vec3d dims(preset_dims(params.preset));
            layout.voxel =
                params.voxel.value_or(params.size ? longest(*params.size) / longest(dims) : 0.04);
            layout.dims = params.size ? cells_over(*params.size, layout.voxel) : dims;
        }
    }
    add_heat_cells(layout, params);
    return layout;
}

Estimate estimate_of(const Layout& layout)
{
    const Vec3d d = layout.dims;
    Estimate e;
    e.voxel = layout.voxel;
    e.voxels = d.x * d.y * d.z;
    // Three grids of constant leaves, and the leaves of about two surfaces in three grids.
    const double leaves = e.voxels / kLeafSize + 1, surfaces = d.x * d.y + d.y * d.z + d.x * d.z;
    e.bytes = leaves * 3 * 110 + 2 * surfaces * 24 * 12 +
              layout.heat_dims.x * layout.heat_dims.y * layout.heat_dims.z * 4;
    const auto clamped = [](double n) {
        return static_cast<std::int32_t>(std::min(n, 2147483647.0));
    };
    e.dims = {clamped(d.x), clamped(d.y), clamped(d.z)};
    const Vec3d c = layout.heat_dims;
    e.heat_dims = {clamped(c.x), clamped(c.y), clamped(c.z)};
    e.heat_cell = layout.ratio * layout.voxel;
    return e;
}

// --- boundaries that are heights over the plane ---

using HeightFunction = std::function<double(double x, double y)>;  // all in fine voxels

/// A surface z = h(x, y), tabulated on the fine columns and a leaf around the box.
class HeightField {
public:
    HeightField(const HeightFunction& h, Coord dims)
        : nx_(dims.x + 2 * kMargin),
          ny_(dims.y + 2 * kMargin),
          table_(std::size_t(nx_) * std::size_t(ny_))
    {
        parallel_for(static_cast<std::size_t>(nx_), [&](std::size_t i) {
            for (int j = 0; j < ny_; ++j)
                table_[i * std::size_t(ny_) + std::size_t(j)] =
                    h(static_cast<double>(i) - kMargin + 0.5, j - kMargin + 0.5);
        });
        double steepest_x = 0, steepest_y = 0;
        for (int i = 0; i < nx_; ++i)
            for (int j = 0; j < ny_; ++j) {
                if (i > 0)
                    steepest_x = std::max(steepest_x, std::fabs(node(i, j) - node(i - 1, j)));
                if (j > 0)
                    steepest_y = std::max(steepest_y, std::fabs(node(i, j) - node(i, j - 1)));
            }
        steepness_ = std::sqrt(1 + steepest_x * steepest_x + steepest_y * steepest_y);
    }

    /// Bilinear between column centres, where it is exact.
    double operator()(double x, double y) const
    {
        const double u = std::clamp(x + kMargin - 0.5, 0.0, nx_ - 1.0),
                     v = std::clamp(y + kMargin - 0.5, 0.0, ny_ - 1.0);
        const int i = std::min(static_cast<int>(u), std::max(nx_ - 2, 0)),
                  j = std::min(static_cast<int>(v), std::max(ny_ - 2, 0));
        const double s = u - i, t = v - j;
        const double low = node(i, j) + (node(i, j + 1) - node(i, j)) * t;
        if (s == 0) return low;
        const double high = node(i + 1, j) + (node(i + 1, j + 1) - node(i + 1, j)) * t;
        return low + (high - low) * s;
    }

    /// Signed distance [voxels], positive above: near the surface that to the tangent plane at the
    /// foot point of p, farther off a lower bound. Its sign is that of z - h.
    double distance(Vec3d p) const
    {
        const double rise = p.z - (*this)(p.x, p.y);
        const double bound = rise / steepness_;
        if (std::fabs(bound) > kBandVoxels + 1.5 || rise == 0) return bound;
        if (steepness_ == 1) return rise;
        const Vec3d g = normal_at(p.x, p.y);
        const double steep = dot(g, g);
        const Vec3d foot = p - g * (rise / steep);
        const Vec3d foot_normal = normal_at(foot.x, foot.y);
        const double plane =
            (dot(p - foot, foot_normal) + foot.z - (*this)(foot.x, foot.y)) / length(foot_normal);
        const double first = rise / std::sqrt(steep);
        const double d = plane * rise > 0 && std::fabs(plane) <= std::fabs(rise) ? plane : first;
        // Beyond the band only the lower bound may say how far it is.
        const double limit = std::max(kBandVoxels + 1, std::fabs(bound));
        return std::clamp(d, -limit, limit);
    }

private:
    static constexpr int kMargin = 16;

    double node(int i, int j) const
    {
        return table_[std::size_t(i) * std::size_t(ny_) + std::size_t(j)];
    }
    Vec3d normal_at(double x, double y) const
    {
        return {(*this)(x - 0.5, y) - (*this)(x + 0.5, y),
                (*this)(x, y - 0.5) - (*this)(x, y + 0.5), 1};
    }

    int nx_, ny_;
    std::vector<double> table_;
    double steepness_ = 1;
};

/// The implicit boundaries of a preset or a height map, in fine voxels of a box `dims`.
///
/// `top` and `bottom` are heights over the plane; what they part depends on the preset. Coarse and
/// fine grids ask the same functions (never each other).
struct Boundaries {
    Preset preset = Preset::Chevron;
    Vec3d dims;
    HeightFunction top, bottom;  // bottom empty: there is none
    bool bottom_is_cold = false;
    double slow_below = -INFINITY;  // height maps

    bool has_slow() const
    {
        return preset == Preset::Rosette || preset == Preset::Basin || slow_below > -INFINITY ||
               (bottom && !bottom_is_cold);
    }
    double vent_radius() const { return 0.15 * std::min({dims.x, dims.y, dims.z}); }

    /// Signed distance of lava and slow part together, given the distances above top and bottom.
    double body(Vec3d p, double above_top, double above_bottom) const
    {
        double d = above_top;
        if (preset == Preset::Basin) d = std::min(d, dims.x / 2 - p.x);
        if (bottom_is_cold) d = std::max(d, -above_bottom);
        return d;
    }
    /// Signed distance of the slow part before the cold is cut away.
    double slow(Vec3d p, double above_top, double above_bottom) const
    {
        // The plane x = 1/2 of the basin is slow, every other boundary itself is lava.
        constexpr double open = 1e-9;
        if (preset == Preset::Rosette) return length(p - dims * 0.5) - vent_radius() + open;
        if (preset == Preset::Basin) return std::max(-above_top + open, dims.x / 2 - p.x);
        if (preset == Preset::HeightMap) return p.z - slow_below + open;
        return bottom && !bottom_is_cold ? above_bottom + open : INFINITY;
    }
};

std::int32_t region_id(double body, double slow)
{
    return body > 0 ? kCold : slow <= 0 ? kSlow : kLava;  // on overlap cold wins
}

/// A plane displaced by 1/f noise, or the preset's curved floor.
HeightFunction displaced(std::function<double(double u, double v)> share, Vec3d dims,
                         double amplitude, double beta, std::uint64_t seed, Stream stream)
{
    const FractalNoise noise{seed, stream, 2, (beta - 1) / 2, 6};
    const double side = std::max(dims.x, dims.y);
    return [=, share = std::move(share)](double x, double y) {
        double z = share(x / dims.x, y / dims.y);
        if (amplitude > 0) z += amplitude * noise({x / side, y / side, 0});
        return z * dims.z;
    };
}

Boundaries preset_boundaries(const Params& params, Vec3d dims, std::uint64_t seed)
{
    const double amplitude = params.noise_amplitude.value_or(preset_amplitude(params.preset));
    const auto surface = [&](std::function<double(double, double)> share, Stream stream) {
        return displaced(std::move(share), dims, amplitude, params.noise_beta, seed, stream);
    };
    const auto flat = [](double share) { return [share](double, double) { return share; }; };
    Boundaries b;
    b.preset = params.preset;
    b.dims = dims;
    const double top = params.preset == Preset::Slab ? 0.75 : 1 - kContact;
    b.top = surface(flat(top), kTopNoise);
    switch (params.preset) {
        case Preset::Chevron:
        case Preset::Rosette:
            b.bottom = surface(flat(kContact), kBottomNoise);
            b.bottom_is_cold = true;
            break;
        case Preset::Fan:
            b.bottom = surface([](double u, double) { return 0.12 + 1.6 * (u - 0.5) * (u - 0.5); },
                               kBottomNoise);
            break;
        case Preset::Cliff:
            b.bottom = surface(flat(0.2), kBottomNoise);
            break;
        case Preset::Tower:
            b.bottom = surface(
                [](double u, double v) {
                    const double r2 = (u - 0.5) * (u - 0.5) + (v - 0.5) * (v - 0.5);
                    return std::min(0.55, 0.10 + 0.9 * r2);
                },
                kBottomNoise);
            break;
        case Preset::Coast:
            b.bottom = surface(flat(0.1), kBottomNoise);
            break;
        case Preset::Slab:
            b.bottom = surface(flat(0.25), kBottomNoise);
            break;
        default:
            break;
    }
    return b;
}

Boundaries height_map_boundaries(const Params& params, const Image16& image, const Layout& layout)
{
    const double low = *params.height_low, span = (*params.height_high - low) / 65535;
    const double pixels = layout.voxel / *params.metres_per_pixel;  // to a voxel
    const double voxel = layout.voxel, origin = layout.origin.z;
    Boundaries b;
    b.preset = Preset::HeightMap;
    b.dims = layout.dims;
    b.top = [&image, low, span, pixels, voxel, origin](double x, double y) {
        // Bilinear between pixel centres; row 0 is the northern edge, the largest y.
        const double u = std::clamp(x * pixels - 0.5, 0.0, image.width - 1.0),
                     v = std::clamp(image.height - y * pixels - 0.5, 0.0, image.height - 1.0);
        const int i = static_cast<int>(u), j = static_cast<int>(v);
        const int i1 = std::min(i + 1, image.width - 1), j1 = std::min(j + 1, image.height - 1);
        const double s = u - i, t = v - j;
        const double grey = (image.at(i, j) * (1 - s) + image.at(i1, j) * s) * (1 - t) +
                            (image.at(i, j1) * (1 - s) + image.at(i1, j1) * s) * t;
        return (low + span * grey - origin) / voxel;
    };
    if (params.cold_ground) {
        const double base = (params.base - origin) / voxel;
        b.bottom = [base](double, double) { return base; };
        b.bottom_is_cold = true;
    }
    if (params.slow == SlowPart::Below) b.slow_below = (params.slow_below - origin) / voxel;
    return b;
}

// --- grids ---

/// An id grid on the leaves that hold more than cold. `uniform` names the id all of a leaf has, if
/// that is known without looking at its voxels; voxels outside the domain stay inactive.
template <class Uniform, class IdAt>
IntGrid region_grid(const Domain& domain, const std::vector<Coord>& candidates, Uniform&& uniform,
                    IdAt&& id_at)
{
    constexpr std::int32_t kMixed = -1;
    std::vector<std::int32_t> kind(candidates.size(), kCold);
    parallel_for(
        candidates.size(),
        [&](std::size_t i) {
            const Coord o = candidates[i];
            if (o.x < 0 || o.y < 0 || o.z < 0 || !domain.contains(o)) return;
            const bool whole = domain.contains(o + Coord(7, 7, 7));
            const std::optional<std::int32_t> id = uniform(i);
            if (id && (whole || *id == kCold)) {
                kind[i] = *id;
                return;
            }
            for (int k = 0; k < kLeafSize; ++k) {
                const Coord c = leaf_coord(o, k);
                if (!domain.contains(c) || id_at(c) == kCold) continue;
                kind[i] = kMixed;
                return;
            }
        },
        64);
    std::vector<Coord> origins;
    std::vector<std::int32_t> kinds;
    for (std::size_t i = 0; i < candidates.size(); ++i)
        if (kind[i] != kCold) {
            origins.push_back(candidates[i]);
            kinds.push_back(kind[i]);
        }
    IntGrid grid(LeafTopology::build(origins), domain.transform, kCold);
    std::vector<std::size_t> mixed;
    for (std::size_t leaf = 0; leaf < kinds.size(); ++leaf) {
        if (kinds[leaf] == kMixed) {
            mixed.push_back(leaf);
            continue;
        }
        grid.set_constant(leaf, kinds[leaf]);
        grid.mask(leaf) = LeafMask::full();
    }
    grid.expand(mixed);
    parallel_for(
        mixed.size(),
        [&](std::size_t k) {
            const std::size_t leaf = mixed[k];
            for (int i = 0; i < kLeafSize; ++i) {
                const Coord c = leaf_coord(grid.origin(leaf), i);
                if (!domain.contains(c)) continue;
                const std::int32_t id = id_at(c);
                grid.values(leaf)[i] = id;
                if (id != kCold) grid.mask(leaf).set(i);
            }
        },
        64);
    grid.compress();
    return grid;
}

/// Regions of the fine voxels from the signs at their centres.
IntGrid fine_region(const Domain& domain, const FloatGrid& body, const FloatGrid& slow)
{
    return region_grid(
        domain, body.topology()->origins(),
        [&](std::size_t leaf) -> std::optional<std::int32_t> {
            if (!body.is_constant(leaf)) return std::nullopt;
            if (body.constant(leaf) > 0) return kCold;
            const std::uint32_t in_slow = slow.topology()->find(body.origin(leaf));
            if (in_slow == kNoLeaf) return kLava;
            if (!slow.is_constant(in_slow)) return std::nullopt;
            return slow.constant(in_slow) < 0 ? kSlow : kLava;
        },
        [&](Coord c) { return region_id(body.value(c), slow.value(c)); });
}

/// Regions of the heat cells from level sets, at the cells' centres.
IntGrid sampled_region(const Domain& heat, double ratio, const FloatGrid& body,
                       const FloatGrid& slow)
{
    const TopologyPtr all = box_topology({0, 0, 0}, heat.dims);
    return region_grid(
        heat, all->origins(), [](std::size_t) { return std::nullopt; },
        [&](Coord c) {
            GridReader<float> in_body(body), in_slow(slow);
            const Vec3d p = centre_of(c) * ratio;
            return region_id(in_body.sample(p), in_slow.sample(p));
        });
}

/// Regions of the heat cells from the boundaries themselves.
IntGrid implicit_region(const Domain& heat, double ratio, const Boundaries& boundaries)
{
    const auto columns =
        static_cast<std::size_t>(heat.dims.x) * static_cast<std::size_t>(heat.dims.y);
    std::vector<double> top(columns), bottom(columns, -INFINITY);
    parallel_for(columns, [&](std::size_t k) {
        const double x = (static_cast<double>(k / std::size_t(heat.dims.y)) + 0.5) * ratio,
                     y = (static_cast<double>(k % std::size_t(heat.dims.y)) + 0.5) * ratio;
        top[k] = boundaries.top(x, y);
        if (boundaries.bottom) bottom[k] = boundaries.bottom(x, y);
    });
    const TopologyPtr all = box_topology({0, 0, 0}, heat.dims);
    return region_grid(
        heat, all->origins(), [](std::size_t) { return std::nullopt; },
        [&](Coord c) {
            const Vec3d p = centre_of(c) * ratio;
            const std::size_t k = std::size_t(c.x) * std::size_t(heat.dims.y) + std::size_t(c.y);
            const double above_top = p.z - top[k], above_bottom = p.z - bottom[k];
            return region_id(boundaries.body(p, above_top, above_bottom),
                             boundaries.slow(p, above_top, above_bottom));
        });
}

FloatGrid empty_level_set(const Domain& domain)
{
    return FloatGrid(LeafTopology::build({}), domain.transform,
                     static_cast<float>(kBandVoxels * domain.transform.voxel));
}

void fill_from_boundaries(Result& result, double ratio, const Boundaries& boundaries,
                          const Progress& progress)
{
    const HeightField top(boundaries.top, result.domain.dims);
    std::optional<HeightField> bottom;
    if (boundaries.bottom) bottom.emplace(boundaries.bottom, result.domain.dims);
    progress.update(0.1);
    const auto below = [&](Vec3d p) { return bottom ? bottom->distance(p) : 0.0; };
    const auto body = [&](Vec3d p) {
        return boundaries.body(p, top.distance(p), boundaries.bottom_is_cold ? below(p) : 0.0);
    };
    const ImplicitBounds distance{.steepness = 1, .is_distance = true};
    result.body_sdf =
        level_set_from_function(result.domain, body, progress.slice(0.1, 0.5), distance);
    if (boundaries.has_slow()) {
        result.slow_sdf = level_set_from_function(
            result.domain,
            [&](Vec3d p) {
                const double slow =
                    boundaries.slow(p, boundaries.preset == Preset::Basin ? top.distance(p) : 0.0,
                                    boundaries.bottom_is_cold ? 0.0 : below(p));
                return slow > kBandVoxels + 1 ? slow : std::max(slow, body(p));  // cold wins
            },
            progress.slice(0.5, 0.9), distance);
    } else
        result.slow_sdf = empty_level_set(result.domain);
    result.region = fine_region(result.domain, result.body_sdf, result.slow_sdf);
    result.region_coarse = implicit_region(result.heat_domain, ratio, boundaries);
}

// --- meshes ---

/// Triangles whose outside stays hot, by direction or group.
std::vector<bool> slow_triangles(const Params& params, const Inputs& inputs, const TriMesh& mesh,
                                 bool inside_out)
{
    std::vector<bool> slow(mesh.triangles.size(), false);
    if (params.slow == SlowPart::FacingDown) {
        for (std::size_t i = 0; i < slow.size(); ++i) {
            const auto& t = mesh.triangles[i];
            const Vec3d a(mesh.vertices[t[0]]), b(mesh.vertices[t[1]]), c(mesh.vertices[t[2]]);
            const Vec3d n = normalized(cross(b - a, c - a)) * (inside_out ? -1.0 : 1.0);
            slow[i] = n.z < -params.slow_slope;
        }
        return slow;
    }
    const auto& names = inputs.mesh_groups;
    const auto named = std::find(names.begin(), names.end(), params.slow_group);
    const auto attribute = mesh.face_attributes.find("group");
    const auto* groups = attribute == mesh.face_attributes.end()
                             ? nullptr
                             : std::get_if<std::vector<std::int32_t>>(&attribute->second);
    if (named == names.end() || !groups || groups->size() != slow.size()) {
        std::string known;
        for (const std::string& name : names) known += (known.empty() ? "" : ", ") + name;
        throw InvalidInput(fmt::format(
            "lava: the mesh has no group \"{}\"; its groups are: {}", params.slow_group,
            known.empty() ? "none (OBJ files have groups: lines `g name` or `usemtl name`)"
                          : known));
    }
    const auto wanted = static_cast<std::int32_t>(named - names.begin());
    for (std::size_t i = 0; i < slow.size(); ++i) slow[i] = (*groups)[i] == wanted;
    return slow;
}

TriMesh part_of(const TriMesh& mesh, const std::vector<bool>& chosen, bool value)
{
    TriMesh part;
    part.vertices = mesh.vertices;
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i)
        if (chosen[i] == value) part.triangles.push_back(mesh.triangles[i]);
    return part;
}

/// The layer outside the body within `thickness` of its slow faces and nearer to those than to the
/// others.
FloatGrid slow_layer(const TriMesh& mesh, const std::vector<bool>& chosen, double thickness,
                     const FloatGrid& body, const Domain& domain, const Progress& progress)
{
    const TriMesh slow_faces = part_of(mesh, chosen, true), others = part_of(mesh, chosen, false);
    if (slow_faces.triangles.empty()) {
        log::warning("lava: no face of the mesh is slow; all of its surface is cold");
        return empty_level_set(domain);
    }
    const double voxel = domain.transform.voxel, band = thickness / voxel + kBandVoxels;
    const FloatGrid to_slow =
        distance_to_mesh(slow_faces, domain.transform, band, progress.slice(0, 0.4));
    const FloatGrid to_other =
        others.triangles.empty()
            ? FloatGrid(LeafTopology::build({}), domain.transform, to_slow.background())
            : distance_to_mesh(others, domain.transform, band, progress.slice(0.4, 0.8));
    const auto background = static_cast<float>(kBandVoxels * voxel);
    FloatGrid layer(to_slow.topology(), domain.transform, background);
    layer.expand();
    parallel_for(
        layer.leaf_count(),
        [&](std::size_t leaf) {
            const std::uint32_t in_body = body.topology()->find(layer.origin(leaf));
            const std::uint32_t in_other = to_other.topology()->find(layer.origin(leaf));
            for (int o = 0; o < kLeafSize; ++o) {
                const double near_slow = to_slow.at(leaf, o);
                const double near_other =
                    in_other == kNoLeaf ? to_other.background() : to_other.at(in_other, o);
                const double outside = in_body == kNoLeaf ? body.background() : body.at(in_body, o);
                const double d =
                    std::max({-outside, near_slow - thickness, (near_slow - near_other) / 2});
                layer.values(leaf)[o] = std::clamp(static_cast<float>(d), -background, background);
            }
        },
        64);
    return mend_distances(layer, domain, progress.slice(0.8, 1));
}

void fill_from_body(Result& result, FloatGrid body, FloatGrid slow, double ratio,
                    const Progress& progress)
{
    // Lava and slow part touch: their union has zeros along the contact that are no surface.
    result.body_sdf = slow.leaf_count() == 0
                          ? std::move(body)
                          : mend_distances(csg_union(body, slow), result.domain, progress);
    result.slow_sdf = std::move(slow);
    result.region = fine_region(result.domain, result.body_sdf, result.slow_sdf);
    result.region_coarse =
        sampled_region(result.heat_domain, ratio, result.body_sdf, result.slow_sdf);
}

/// The half-space below a height [voxels] outside the body.
FloatGrid ground_below(double height, const FloatGrid& body, const Domain& domain,
                       const Progress& progress)
{
    const FloatGrid ground =
        level_set_from_function(domain, [height](Vec3d p) { return p.z - height; }, progress,
                                {.steepness = 1, .is_distance = true});
    return mend_distances(csg_difference(ground, body), domain, progress);
}

void fill_from_mesh(Result& result, double ratio, const Params& params, const Inputs& inputs,
                    const Progress& progress)
{
    TriMesh mesh = *inputs.mesh;
    if (params.mesh_scale != 1)
        for (Vec3f& v : mesh.vertices) v = Vec3f(Vec3d(v) * params.mesh_scale);
    const double across = longest(mesh.bounds().size());
    if (across < 1e-3 || across > 1e5)
        log::warning(
            "lava: the mesh is {:.3g} m across; if its unit is not the metre, set "
            "--mesh-scale",
            across);

    const MeshReport report = inspect(mesh);
    const std::size_t faults = report.open_edges + report.non_manifold_edges;
    if (params.strict && (faults > 0 || report.misoriented_edges > 0))
        throw InvalidInput(fmt::format(
            "lava: the mesh has {} open, {} non-manifold and {} misoriented edges, expected a "
            "closed manifold; mend it in a mesh editor, or leave out --strict to have it repaired",
            report.open_edges, report.non_manifold_edges, report.misoriented_edges));
    if (faults > 0)
        log::warning("lava: the mesh has {} open and {} non-manifold edges; {}", report.open_edges,
                     report.non_manifold_edges,
                     report.open_edges > 0
                         ? "its holes are closed by winding number (--strict refuses such meshes)"
                         : "the outer surface is taken");
    if (report.misoriented_edges > 0)
        log::warning("lava: {} edges of the mesh join faces of opposite orientation",
                     report.misoriented_edges);
    constexpr std::uint64_t kMostCounted = 10000;
    const std::uint64_t crossing =
        count_self_intersections(mesh, kMostCounted, progress.slice(0, 0.05));
    if (crossing > 0)
        log::warning(
            "lava: the mesh intersects itself: {}{} pairs of its triangles meet without a common "
            "vertex; what any of its parts encloses counts as inside",
            crossing > kMostCounted ? "more than " : "", std::min(crossing, kMostCounted));

    FloatGrid body =
        report.open_edges > 0
            ? level_set_from_open_mesh(mesh, result.domain, progress.slice(0, 0.5))
            : level_set_from_mesh(mesh, result.domain.transform, progress.slice(0, 0.5));
    FloatGrid slow = empty_level_set(result.domain);
    const Progress rest = progress.slice(0.5, 0.9);
    if (params.slow == SlowPart::Below)
        slow = ground_below(
            (params.slow_below - result.domain.transform.origin.z) / result.domain.transform.voxel,
            body, result.domain, rest);
    else if (params.slow != SlowPart::None)
        slow = slow_layer(mesh, slow_triangles(params, inputs, mesh, mesh.signed_volume() < 0),
                          params.slow_thickness.value_or(2 * result.heat_domain.transform.voxel),
                          body, result.domain, rest);
    fill_from_body(result, std::move(body), std::move(slow), ratio, progress.slice(0.9, 1));
}

// --- volumes ---

/// The grid with voxel `first` as its voxel (0, 0, 0).
template <class T>
LeafGrid<T> moved(const LeafGrid<T>& grid, Coord first, const Transform& transform)
{
    const bool whole_leaves = leaf_origin(first) == first;
    std::vector<Coord> origins;
    for (const Coord& o : grid.topology()->origins()) {
        const Coord low = o - first;
        origins.push_back(leaf_origin(low));
        if (whole_leaves) continue;
        for (int k = 1; k < 8; ++k)
            origins.push_back(
                leaf_origin(low + Coord(k & 1 ? 7 : 0, k & 2 ? 7 : 0, k & 4 ? 7 : 0)));
    }
    LeafGrid<T> result(LeafTopology::build(std::move(origins)), transform, grid.background());
    result.expand();
    parallel_for(
        result.leaf_count(),
        [&](std::size_t leaf) {
            GridReader<T> reader(grid);
            for (int o = 0; o < kLeafSize; ++o) {
                const Coord c = leaf_coord(result.origin(leaf), o) + first;
                result.values(leaf)[o] = reader.value(c);
                if (reader.active(c)) result.mask(leaf).set(o);
            }
        },
        16);
    result.compress();
    return result;
}

/// Voxels of the slow part, or of lava and slow part together, as 0; all else inactive.
IntGrid chosen_voxels(const IntGrid& region, bool with_lava)
{
    IntGrid chosen(region.topology(), region.transform(), kCold);
    chosen.expand();
    parallel_for(
        chosen.leaf_count(),
        [&](std::size_t leaf) {
            for (int o = 0; o < kLeafSize; ++o) {
                const std::int32_t id = region.at(leaf, o);
                if (!region.mask(leaf).test(o) || !(id == kSlow || (with_lava && id == kLava)))
                    continue;
                chosen.values(leaf)[o] = 0;
                chosen.mask(leaf).set(o);
            }
        },
        64);
    chosen.compress();
    return chosen;
}

void require_region_ids(const IntGrid& region)
{
    std::size_t strange = 0;
    Coord first;
    std::int32_t value = 0;
    for (std::size_t leaf = 0; leaf < region.leaf_count(); ++leaf)
        region.mask(leaf).for_each([&](int o) {
            const std::int32_t id = region.at(leaf, o);
            if (id == kLava || id == kCold || id == kSlow) return;
            if (strange++ > 0) return;
            first = leaf_coord(region.origin(leaf), o);
            value = id;
        });
    if (strange > 0)
        throw InvalidInput(fmt::format(
            "lava: grid `region` has {} voxels of other values than 0 (lava), 1 (cold) and 2 "
            "(slow), the first is {} at ({}, {}, {}); map them to these ids",
            strange, value, first.x, first.y, first.z));
}

void fill_from_volume(Result& result, const Layout& layout, const Params& params,
                      const Inputs& inputs, const Progress& progress)
{
    const VolumeBody source = volume_body(inputs);
    const Transform& transform = result.domain.transform;
    FloatGrid body, slow = empty_level_set(result.domain);
    if (source.region) {
        require_region_ids(*source.region);
        const IntGrid region = moved(*source.region, layout.first, transform);
        body = level_set_from_voxels(chosen_voxels(region, true), 0, result.domain,
                                     progress.slice(0, 0.4));
        const IntGrid hot = chosen_voxels(region, false);
        if (hot.active_count() > 0)
            slow = level_set_from_voxels(hot, 0, result.domain, progress.slice(0.4, 0.6));
    } else {
        body = mend_distances(moved(*source.body, layout.first, transform), result.domain,
                              progress.slice(0, 0.4));
        if (source.slow && source.slow->leaf_count() > 0)
            slow = mend_distances(moved(*source.slow, layout.first, transform), result.domain,
                                  progress.slice(0.4, 0.6));
    }
    if (params.slow == SlowPart::Below) {
        const FloatGrid ground =
            ground_below((params.slow_below - transform.origin.z) / transform.voxel, body,
                         result.domain, progress.slice(0.6, 0.8));
        slow = slow.leaf_count() == 0 ? ground
                                      : mend_distances(csg_union(slow, ground), result.domain,
                                                       progress.slice(0.8, 0.9));
        body = mend_distances(csg_union(body, ground), result.domain, progress.slice(0.8, 0.9));
    }
    result.body_sdf = std::move(body);
    result.slow_sdf = std::move(slow);
    result.region = fine_region(result.domain, result.body_sdf, result.slow_sdf);
    result.region_coarse =
        sampled_region(result.heat_domain, layout.ratio, result.body_sdf, result.slow_sdf);
}

void count_regions(Result& result)
{
    const IntGrid& region = result.region;
    for (std::size_t leaf = 0; leaf < region.leaf_count(); ++leaf) {
        if (region.is_constant(leaf)) {
            const double n = region.mask(leaf).count();
            (region.constant(leaf) == kSlow ? result.slow_voxels : result.lava_voxels) += n;
            continue;
        }
        region.mask(leaf).for_each([&](int o) {
            (region.at(leaf, o) == kSlow ? result.slow_voxels : result.lava_voxels) += 1;
        });
    }
    result.cold_voxels = result.domain.voxel_count() - result.lava_voxels - result.slow_voxels;
}

}  // namespace

void validate(const Params& params)
{
    validate_described("lava", params);
    if (params.size && !(params.size->x > 0 && params.size->y > 0 && params.size->z > 0))
        throw InvalidParameter(fmt::format("lava: size = {} x {} x {} m, each must be > 0",
                                           params.size->x, params.size->y, params.size->z));
    const std::string_view preset =
        choice_names(params.preset)[static_cast<std::size_t>(params.preset)];
    if (params.size && from_file(params.preset))
        throw InvalidParameter(fmt::format(
            "lava: size goes with the built-in presets; with preset = {} the file gives the box",
            preset));
    if (params.preset == Preset::HeightMap) {
        if (!params.height_map.empty()) require_scale(params);
        if (params.height_high && params.height_low && *params.height_high <= *params.height_low)
            throw InvalidParameter(
                fmt::format("lava: height_high = {} m, must be above height_low = {} m",
                            *params.height_high, *params.height_low));
    }
    const bool below_only = params.preset == Preset::HeightMap || params.preset == Preset::Volume;
    if (params.slow != SlowPart::None &&
        (!from_file(params.preset) || (below_only && params.slow != SlowPart::Below)))
        throw InvalidParameter(
            fmt::format("lava: slow = {} does not go with preset = {}, {}",
                        choice_names(params.slow)[static_cast<std::size_t>(params.slow)], preset,
                        below_only ? "which takes none or below" : "which has its own slow part"));
    if (params.slow == SlowPart::Group && params.slow_group.empty())
        throw InvalidParameter("lava: slow = group needs slow_group, the name of a mesh group");
}

PresetDefaults preset_defaults(Preset preset)
{
    switch (preset) {
        case Preset::Chevron:
            return {60, 1e-3, 800};
        case Preset::Rosette:
            return {800, 1e-3, 800};
        case Preset::Fan:
            return {2000, 1e-3, 400};
        case Preset::Basin:
            return {3000, 1e-4, 400};
        // The scenes: long enough for heat to pass from the slow floor to the cold top.
        case Preset::Cliff:
            return {2000, 1e-3, 250};
        case Preset::Tower:
            return {2000, 1e-3, 400};
        case Preset::Coast:
            return {2000, 1e-3, 1200};
        case Preset::Slab:
            return {4000, 1e-3, 2000};
        case Preset::HeightMap:
            return {2000, 1e-3, std::nullopt};
        default:
            return {200, 1e-3, std::nullopt, true};
    }
}

Estimate estimate(const Params& params, const Inputs& inputs)
{
    validate(params);
    return estimate_of(lay_out(params, inputs));
}

Result run(const Inputs& inputs, const Params& params, std::uint64_t seed, const Progress& progress)
{
    validate(params);
    const Layout layout = lay_out(params, inputs);
    const Estimate need = estimate_of(layout);
    if (longest(layout.dims) > double(1 << 28) || need.voxels / kLeafSize > 2e9)
        throw LimitExceeded(fmt::format(
            "lava: voxel = {:.4g} m makes {:.4g} x {:.4g} x {:.4g} = {} voxels ({}), more than "
            "can be numbered; use a larger voxel",
            layout.voxel, layout.dims.x, layout.dims.y, layout.dims.z, count_text(need.voxels),
            bytes_text(need.bytes)));

    Result result;
    result.domain = {Coord(layout.dims), {layout.origin, layout.voxel}};
    result.heat_domain = {Coord(layout.heat_dims), {layout.origin, layout.ratio * layout.voxel}};
    progress.update(0);
    switch (params.preset) {
        case Preset::HeightMap:
            fill_from_boundaries(result, layout.ratio,
                                 height_map_boundaries(params, height_image(inputs), layout),
                                 progress);
            break;
        case Preset::Mesh:
            fill_from_mesh(result, layout.ratio, params, inputs, progress);
            break;
        case Preset::Volume:
            fill_from_volume(result, layout, params, inputs, progress);
            break;
        default:
            fill_from_boundaries(result, layout.ratio, preset_boundaries(params, layout.dims, seed),
                                 progress);
    }
    count_regions(result);
    const Coord d = result.domain.dims, c = result.heat_domain.dims;
    log::info(
        "lava: {} x {} x {} voxels of {:.4g} m, {} x {} x {} heat cells of {:.4g} m; {:.1f} % "
        "lava, {:.1f} % slow",
        d.x, d.y, d.z, layout.voxel, c.x, c.y, c.z, result.heat_domain.transform.voxel,
        100 * result.lava_voxels / need.voxels, 100 * result.slow_voxels / need.voxels);
    if (result.lava_voxels == 0)
        throw InvalidInput(fmt::format(
            "lava: no lava in the box of {} x {} x {} voxels of {:.4g} m: {} cold, {} slow; "
            "expected "
            "at least one voxel centre inside the body: use a smaller voxel, or check position and "
            "scale",
            d.x, d.y, d.z, layout.voxel, result.cold_voxels, result.slow_voxels));
    progress.update(1);
    return result;
}

}  // namespace sekitei::lava
