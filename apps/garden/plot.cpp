#include "apps/garden/plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "apps/garden/lantern.h"
#include "apps/ground.h"
#include "core/error.h"
#include "core/math.h"
#include "core/mesh_parts.h"
#include "core/noise.h"
#include "core/parallel.h"
#include "core/units.h"
#include "grids/level_set.h"
#include "grids/marching_tetrahedra.h"
#include "grids/surface_attributes.h"

namespace sekitei::garden {
namespace {

constexpr double kWaterVoxel = 0.05, kPixel = 1;  // [m]
constexpr double kShoreWidth = 0.7;               // over which banks rise and beds fall [m]
constexpr double kBorder = 1.5;                   // over which mounds fade to the plot's border [m]
constexpr double kUnderBank = 0.15;               // that water reaches under its banks [m]
constexpr double kRamp = 2.5;                     // over which a cut's floor meets the land [m]
constexpr double kBuried = 0.1;                   // below which stones are left out of the mesh [m]
constexpr double kFinestGround = 0.03;            // edge of the ground's triangles [m]

double smooth(double low, double high, double x)
{
    const double t = std::clamp((x - low) / (high - low), 0.0, 1.0);
    return t * t * (3 - 2 * t);
}

/// Rows of numbers: "1, 2; 3, 4".
/// @param units  of each column
/// @param usual  what columns that are left out have; as many as columns less those that must be
///               given
std::vector<std::vector<double>> rows(const std::string& name, const std::string& text,
                                      const std::vector<std::string>& units,
                                      const std::vector<double>& usual)
{
    std::vector<std::vector<double>> list;
    auto wrong = [&](const std::string& why) {
        return InvalidParameter(fmt::format("garden: {} = {}: {}", name, text, why));
    };
    const std::size_t least = units.size() - usual.size();
    for (std::size_t begin = 0; begin < text.size();) {
        const std::size_t end = std::min(text.find(';', begin), text.size());
        std::vector<double> row;
        const std::string part = text.substr(begin, end - begin);
        begin = end + 1;
        if (part.find_first_not_of(" \t") == std::string::npos) continue;
        for (std::size_t at = 0; at <= part.size();) {
            const std::size_t comma = std::min(part.find(',', at), part.size());
            if (row.size() == units.size())
                throw wrong(fmt::format("more than {} numbers", units.size()));
            try {
                row.push_back(parse_quantity(part.substr(at, comma - at), units[row.size()]));
            } catch (const InvalidParameter& error) {
                throw wrong(error.what());
            }
            if (!(std::abs(row.back()) <= 1e6)) throw wrong("a number beyond 1e6");
            at = comma + 1;
        }
        if (row.size() < least)
            throw wrong(
                fmt::format("{} numbers, must be {} to {}", row.size(), least, units.size()));
        while (row.size() < units.size()) row.push_back(usual[row.size() - least]);
        list.push_back(std::move(row));
    }
    return list;
}

/// Turns about the vertical, counter-clockwise from above.
struct Turn {
    double c = 1, s = 0;
    explicit Turn(double degrees)
        : c(math::cos(degrees * math::kPi / 180)), s(math::sin(degrees * math::kPi / 180))
    {
    }
    Vec3d operator()(Vec3d p) const { return {c * p.x - s * p.y, s * p.x + c * p.y, p.z}; }
    Vec3d back(Vec3d p) const { return {c * p.x + s * p.y, -s * p.x + c * p.y, p.z}; }
};

struct Stone {
    Vec3d place;  ///< z: how deep
    Turn turn;
    double scale;
    std::size_t scene;
};

struct Cut {
    Vec3d place;  ///< z: height of its floor
    double length, width;
    Turn turn;
};

struct Disc {
    double x, y, radius;
};

struct Pond {
    Vec3d place;
    double length, width;
    Turn turn;
};

/// The lists of the parameters.
struct Layout {
    double width, depth;  ///< of the plot [m]
    std::vector<Stone> stones;
    std::optional<std::array<double, 3>> lantern;  ///< x, y, turn
    std::optional<Pond> pond;
    std::vector<Disc> islets;
    std::vector<Cut> cuts;

    bool holds(double x, double y) const
    {
        return std::abs(x) <= width / 2 && std::abs(y) <= depth / 2;
    }
};

Layout layout_of(const PlotParams& p)
{
    if (p.size.empty() || p.size.size() > 2)
        throw InvalidParameter(
            fmt::format("garden: size: {} numbers, must be one or two", p.size.size()));
    Layout layout{p.size.front(), p.size.back(), {}, {}, {}, {}, {}};
    for (const auto& r : rows("stones", p.stones, {"m", "m", "m", "deg", "", ""}, {0, 0, 1, 0})) {
        if (!(r[4] > 0 && r[4] <= 1000))
            throw InvalidParameter(fmt::format(
                "garden: stones = {}: scale {}, must be > 0 and at most 1000", p.stones, r[4]));
        if (!(r[5] >= 0 && r[5] == std::floor(r[5])))
            throw InvalidParameter(fmt::format(
                "garden: stones = {}: scene {}, must be a number from 0", p.stones, r[5]));
        layout.stones.push_back({{r[0], r[1], r[2]}, Turn(r[3]), r[4], std::size_t(r[5])});
    }
    const auto lanterns = rows("lantern", p.lantern, {"m", "m", "deg"}, {0});
    if (lanterns.size() > 1)
        throw InvalidParameter(fmt::format("garden: lantern = {}: must be one place", p.lantern));
    if (!lanterns.empty()) layout.lantern = {lanterns[0][0], lanterns[0][1], lanterns[0][2]};
    const auto ponds = rows("pond", p.pond, {"m", "m", "m", "m", "deg"}, {0});
    if (ponds.size() > 1)
        throw InvalidParameter(fmt::format("garden: pond = {}: must be one pond", p.pond));
    for (const auto& r : ponds) {
        if (!(r[2] > 0 && r[3] > 0))
            throw InvalidParameter(fmt::format(
                "garden: pond = {}: length {} m and width {} m, must be > 0", p.pond, r[2], r[3]));
        layout.pond = {{r[0], r[1], 0}, r[2], r[3], Turn(r[4])};
    }
    for (const auto& r : rows("islet", p.islet, {"m", "m", "m"}, {})) {
        if (!(r[2] > 0))
            throw InvalidParameter(
                fmt::format("garden: islet = {}: radius {} m, must be > 0", p.islet, r[2]));
        layout.islets.push_back({r[0], r[1], r[2]});
    }
    for (const auto& r : rows("cuts", p.cuts, {"m", "m", "m", "m", "m", "deg"}, {0})) {
        if (!(r[3] > 0 && r[4] > 0))
            throw InvalidParameter(fmt::format(
                "garden: cuts = {}: length {} m and width {} m, must be > 0", p.cuts, r[3], r[4]));
        layout.cuts.push_back({{r[0], r[1], r[2]}, r[3], r[4], Turn(r[5])});
    }
    return layout;
}

/// The ground in coordinates of the plot, before anything stands on it.
class Ground {
public:
    Ground(const PlotParams& p, const Layout& layout, const Image16* land, std::uint64_t seed)
        : p_(p), layout_(layout), land_(land)
    {
        relief_ = FractalNoise{seed, Stream("garden.relief"), 1 / p.relief_wavelength, 0.8, 4};
        shore_ = FractalNoise{seed, Stream("garden.shore"), 1, 0.8, 3};
        if (!layout.pond) return;
        const Pond& pond = *layout.pond;
        level_ = land_at(pond.place.x, pond.place.y) - p.bank;
        shore_.frequency = 2.2 / std::max(pond.length, pond.width);
    }

    double level() const { return level_; }

    /// About how far within the water's edge [m]; negative on land.
    double water(double x, double y) const
    {
        if (!layout_.pond) return -std::numeric_limits<double>::infinity();
        const Pond& pond = *layout_.pond;
        const Vec3d q = pond.turn.back(Vec3d(x, y, 0) - Vec3d(pond.place.x, pond.place.y, 0));
        const double a = q.x / (pond.length / 2), b = q.y / (pond.width / 2);
        const double bend = 1 + 2 * p_.shore * shore_({x, y, 0.37});
        double inside = (bend - std::sqrt(a * a + b * b)) * std::min(pond.length, pond.width) / 2;
        for (const Disc& islet : layout_.islets) {
            const double dx = x - islet.x, dy = y - islet.y;
            const double round = islet.radius * (1 + p_.shore * shore_({3 * x, 3 * y, 7.1}));
            inside = std::min(inside, std::sqrt(dx * dx + dy * dy) - round);
        }
        return inside;
    }

    /// [m]
    double height(double x, double y) const
    {
        double z = land_at(x, y);
        if (p_.relief > 0) {
            const double edge =
                std::min(layout_.width / 2 - std::abs(x), layout_.depth / 2 - std::abs(y));
            if (edge > 0)
                z += p_.relief * smooth(0, kBorder, edge) *
                     (0.5 + 0.5 * std::clamp(2 * relief_({x, y, 0.21}), -1.0, 1.0));
        }
        const double in = water(x, y);
        if (in > 0) return level_ - 0.02 - p_.depth * smooth(0, kShoreWidth, in);
        // A bank rises at once a little, and then slowly.
        if (in > -kShoreWidth)
            z = level_ + 0.03 * smooth(0, 0.06, -in) +
                (z - level_ - 0.03) * smooth(0.03, kShoreWidth, -in);
        return z;
    }

private:
    /// The land without mounds and water.
    double land_at(double x, double y) const
    {
        double z = terrain(x, y);
        for (const Cut& cut : layout_.cuts) {
            const Vec3d q = cut.turn.back(Vec3d(x - cut.place.x, y - cut.place.y, 0));
            const double inside =
                std::min(cut.length / 2 - std::abs(q.x), cut.width / 2 - std::abs(q.y));
            z += (std::min(z, cut.place.z) - z) * smooth(-kRamp, 0, inside);
        }
        return z;
    }
    double terrain(double x, double y) const
    {
        if (!land_) return p_.centre.z;
        const double per = *p_.metres_per_pixel;
        const double u = std::clamp((x + p_.centre.x) / per - 0.5, 0.0, land_->width - 1.0),
                     v = std::clamp((y + p_.centre.y) / per - 0.5, 0.0, land_->height - 1.0);
        const int i = std::min(int(u), land_->width - 2), j = std::min(int(v), land_->height - 2);
        auto grey = [&](int di, int dj) {
            return double(land_->at(i + di, land_->height - 1 - (j + dj))) / 65535;
        };
        // Smooth between pixels: a facet's edges would show.
        const double s = smooth(0, 1, u - i) * 0.5 + (u - i) * 0.5,
                     t = smooth(0, 1, v - j) * 0.5 + (v - j) * 0.5;
        const double low = grey(0, 0) * (1 - s) + grey(1, 0) * s,
                     high = grey(0, 1) * (1 - s) + grey(1, 1) * s;
        return *p_.height_low + (*p_.height_high - *p_.height_low) * (low * (1 - t) + high * t);
    }

    const PlotParams& p_;
    const Layout& layout_;
    const Image16* land_;
    FractalNoise relief_, shore_;
    double level_ = 0;
};

/// Lines from -reach to reach: `step` apart within the half width, farther and farther beyond.
std::vector<double> lines(double half, double reach, double step, double widest)
{
    std::vector<double> positive;
    const int inner = std::max(1, int(std::ceil(half / step)));
    for (int k = 0; k <= inner; ++k) positive.push_back(half * k / inner);
    for (double gap = half / inner; positive.back() < reach;) {
        gap = std::min(gap * 1.18, widest);
        positive.push_back(std::min(positive.back() + gap, reach));
    }
    std::vector<double> all;
    for (std::size_t k = positive.size(); k-- > 1;) all.push_back(-positive[k]);
    all.insert(all.end(), positive.begin(), positive.end());
    return all;
}

/// Ground over a lattice of lines, in the world.
TriMesh sheet(const Ground& ground, Vec3d centre, const std::vector<double>& xs,
              const std::vector<double>& ys, const Progress& progress)
{
    TriMesh mesh;
    const std::size_t nx = xs.size(), ny = ys.size();
    mesh.vertices.resize(nx * ny);
    parallel_for(
        ny,
        [&](std::size_t j) {
            progress.check();
            for (std::size_t i = 0; i < nx; ++i)
                mesh.vertices[j * nx + i] =
                    Vec3f(Vec3d(centre.x + xs[i], centre.y + ys[j], ground.height(xs[i], ys[j])));
        },
        4);
    mesh.triangles.reserve(2 * (nx - 1) * (ny - 1));
    for (std::size_t j = 0; j + 1 < ny; ++j)
        for (std::size_t i = 0; i + 1 < nx; ++i) {
            const auto a = std::uint32_t(j * nx + i), b = a + 1, c = a + std::uint32_t(nx),
                       d = c + 1;
            // The shorter diagonal follows banks better.
            const auto bend = [&](std::uint32_t u, std::uint32_t v) {
                return std::abs(mesh.vertices[u].z - mesh.vertices[v].z);
            };
            if (bend(a, d) <= bend(b, c)) {
                mesh.triangles.push_back({a, b, d});
                mesh.triangles.push_back({a, d, c});
            } else {
                mesh.triangles.push_back({a, b, c});
                mesh.triangles.push_back({b, d, c});
            }
        }
    return mesh;
}

/// A sheet closed by walls and a floor at `bottom`.
void close_below(TriMesh& mesh, std::size_t nx, std::size_t ny, float bottom)
{
    const auto top = std::uint32_t(mesh.vertices.size());
    for (std::uint32_t v = 0; v < top; ++v) {
        Vec3f p = mesh.vertices[v];
        p.z = bottom;
        mesh.vertices.push_back(p);
    }
    const std::size_t faces = mesh.triangles.size();
    for (std::size_t f = 0; f < faces; ++f) {
        const auto t = mesh.triangles[f];
        mesh.triangles.push_back({t[0] + top, t[2] + top, t[1] + top});
    }
    auto wall = [&](std::uint32_t a, std::uint32_t b) {
        mesh.triangles.push_back({b, a, a + top});
        mesh.triangles.push_back({b, a + top, b + top});
    };
    const auto w = std::uint32_t(nx), h = std::uint32_t(ny);
    for (std::uint32_t i = 0; i + 1 < w; ++i) {
        wall(i, i + 1);
        wall((h - 1) * w + i + 1, (h - 1) * w + i);
    }
    for (std::uint32_t j = 0; j + 1 < h; ++j) {
        wall((j + 1) * w, j * w);
        wall(j * w + w - 1, (j + 1) * w + w - 1);
    }
}

/// Face attributes that pieces of the mesh `rock` have.
struct Faces {
    std::vector<std::int32_t> column, component, surface;

    void add(std::size_t count, std::int32_t kind)
    {
        column.insert(column.end(), count, -1);
        component.insert(component.end(), count, -1);
        surface.insert(surface.end(), count, kind);
    }
    /// Those of a stone, its numbers raised by `first` where they are some.
    void add(const TriMesh& stone, std::int32_t first)
    {
        auto take = [&](const char* name, std::vector<std::int32_t>& to, std::int32_t raise) {
            const auto found = stone.face_attributes.find(name);
            const auto* values = found == stone.face_attributes.end()
                                     ? nullptr
                                     : std::get_if<std::vector<std::int32_t>>(&found->second);
            for (std::size_t f = 0; f < stone.triangles.size(); ++f)
                to.push_back(!values             ? (raise > 0 ? -1 : 0)
                             : (*values)[f] >= 0 ? (*values)[f] + raise
                                                 : (*values)[f]);
        };
        take("column", column, first);
        take("component", component, first);
        take("surface", surface, 0);
    }
};

/// Numbers of one stone's columns lie so far from those of the next.
constexpr std::int32_t kMostColumns = 1 << 20;

TriMesh surface_of(const Scene& rock, std::size_t number, const Progress& progress)
{
    const FloatGrid& density = rock.floats("density");
    TriMesh mesh = marching_tetrahedra(density, 0.5, progress);
    if (mesh.triangles.empty())
        throw InvalidInput(
            fmt::format("garden: scene {}: the grid 'density' nowhere crosses 0.5; nothing is left "
                        "of the rock",
                        number));
    if (rock.has("column") && rock.has("component") && rock.has("surface"))
        add_surface_attributes(
            mesh,
            SurfaceGrids{density, 0.5, rock.ints("column"), rock.ints("component"),
                         rock.ints("surface"), nullptr, nullptr},
            progress);
    return mesh;
}

/// A grid of one layer, index z = 0.
FloatGrid layer(int x0, int y0, int x1, int y1, float background, const auto& value)
{
    std::vector<Coord> origins;
    auto first = [](int c) { return c & ~(kLeafEdge - 1); };
    for (int x = first(x0); x < x1; x += kLeafEdge)
        for (int y = first(y0); y < y1; y += kLeafEdge) origins.push_back({x, y, 0});
    auto grid = FloatGrid::uninitialised(LeafTopology::build(std::move(origins)),
                                         Transform{{0, 0, 0}, kPixel}, background);
    parallel_for(grid.leaf_count(), [&](std::size_t leaf) {
        float* const values = grid.values(leaf);
        for (int offset = 0; offset < kLeafSize; ++offset) {
            const Coord c = leaf_coord(grid.origin(leaf), offset);
            values[offset] = background;
            if (c.z != 0 || c.x < x0 || c.y < y0 || c.x >= x1 || c.y >= y1) continue;
            values[offset] = value(c.x, c.y);
            grid.mask(leaf).set(offset);
        }
    });
    grid.compress();
    return grid;
}

}  // namespace

double plot_cells(const PlotParams& p)
{
    return p.size.empty() ? 0 : 1.4 * p.size.front() * p.size.back() / (p.cell * p.cell);
}

void validate(const PlotParams& p, std::size_t scenes)
{
    validate_described("garden", p);
    const Layout layout = layout_of(p);
    for (std::size_t k = 0; k < layout.stones.size(); ++k) {
        const Stone& stone = layout.stones[k];
        if (stone.scene >= scenes)
            throw InvalidParameter(fmt::format(
                "garden: stones: stone {} is of scene {}, but {} given; scenes count from 0", k,
                stone.scene, scenes == 0 ? "none is" : fmt::format("{} are", scenes)));
        if (!layout.holds(stone.place.x, stone.place.y))
            throw InvalidParameter(fmt::format(
                "garden: stones: stone {} stands at {}, {} m, outside the plot of {} x {} m", k,
                stone.place.x, stone.place.y, layout.width, layout.depth));
    }
    if (layout.lantern && !layout.holds((*layout.lantern)[0], (*layout.lantern)[1]))
        throw InvalidParameter(fmt::format("garden: lantern = {}: outside the plot of {} x {} m",
                                           p.lantern, layout.width, layout.depth));
    if (layout.pond && !layout.holds(layout.pond->place.x, layout.pond->place.y))
        throw InvalidParameter(fmt::format("garden: pond = {}: outside the plot of {} x {} m",
                                           p.pond, layout.width, layout.depth));
    if (!layout.pond && !layout.islets.empty())
        throw InvalidParameter("garden: islet: there is no pond; give one");
    const bool sized = p.metres_per_pixel && p.height_low && p.height_high;
    if (!p.height_map.empty() && !sized)
        throw InvalidParameter(
            "garden: height_map: needs metres_per_pixel, height_low and height_high");
    if (p.height_map.empty() && (p.metres_per_pixel || p.height_low || p.height_high))
        throw InvalidParameter(
            "garden: metres_per_pixel, height_low, height_high: there is no height_map");
    if (p.height_low && p.height_high && !(*p.height_low < *p.height_high))
        throw InvalidParameter(
            fmt::format("garden: height_low = {} m, must be below height_high = "
                        "{} m",
                        *p.height_low, *p.height_high));
}

Scene make_plot(const PlotParams& p, std::span<const Scene* const> rocks, const Image16* land,
                std::uint64_t seed, double most_cells, const Progress& progress)
{
    const Layout layout = layout_of(p);
    if (land && (land->width < 2 || land->height < 2))
        throw InvalidInput(fmt::format("{}: {} x {} pixels, must be at least 2 x 2",
                                       p.height_map.string(), land->width, land->height));
    const Ground ground(p, layout, land, seed);
    const Vec3d centre(p.centre.x, p.centre.y, 0);

    // --- what stands there, as finely as it was made ---
    TriMesh standing, shown;
    Faces faces;
    std::vector<TriMesh> surfaces(rocks.size());
    for (std::size_t k = 0; k < rocks.size(); ++k)
        surfaces[k] = surface_of(*rocks[k], k,
                                 progress.slice(0.1 * double(k) / double(rocks.size()),
                                                0.1 * double(k + 1) / double(rocks.size())));
    std::vector<Vec3d> tops;  // of stones, for the forest: x, y, height above the ground
    for (std::size_t k = 0; k < layout.stones.size(); ++k) {
        const Stone& stone = layout.stones[k];
        TriMesh mesh = surfaces[stone.scene];
        const Bounds box = mesh.bounds();
        const Vec3d foot(box.centre().x, box.centre().y, box.lower.z);
        // The lowest ground around it: a stone leaves no gap below.
        double low = std::numeric_limits<double>::infinity();
        const double reach = 0.4 * stone.scale * std::min(box.size().x, box.size().y);
        for (int a = 0; a < 9; ++a) {
            const double angle = a * math::kPi / 4, r = a == 8 ? 0 : reach;
            low = std::min(low, ground.height(stone.place.x + r * math::cos(angle),
                                              stone.place.y + r * math::sin(angle)));
        }
        const Vec3d at(centre.x + stone.place.x, centre.y + stone.place.y, low - stone.place.z);
        for (Vec3f& v : mesh.vertices) {
            const Vec3d q = at + stone.turn((Vec3d(v) - foot) * stone.scale);
            v = Vec3f(q);
            tops.push_back(q);
        }
        append(standing, mesh);
        // What the ground hides is of no use to anybody who looks at it.
        auto buried = [&](std::uint32_t v) {
            const Vec3d q(mesh.vertices[v]);
            return q.z < ground.height(q.x - centre.x, q.y - centre.y) - kBuried;
        };
        std::vector<std::uint8_t> seen(mesh.triangles.size());
        for (std::size_t f = 0; f < seen.size(); ++f) {
            const auto& t = mesh.triangles[f];
            seen[f] = !(buried(t[0]) && buried(t[1]) && buried(t[2]));
        }
        mesh = part_of(mesh, seen);
        faces.add(mesh, std::int32_t(k) * kMostColumns);
        append(shown, mesh);
    }
    if (layout.lantern) {
        const auto [x, y, degrees] = *layout.lantern;
        TriMesh mesh = lantern(0.4);
        const Turn turn(degrees);
        // Its base stands on the highest ground below it, as one sets a stone.
        double high = -std::numeric_limits<double>::infinity();
        for (const double dx : {-0.25, 0.0, 0.25})
            for (const double dy : {-0.25, 0.0, 0.25})
                high = std::max(high, ground.height(x + dx, y + dy));
        for (Vec3f& v : mesh.vertices)
            v = Vec3f(Vec3d(centre.x + x, centre.y + y, high - 0.02) + turn(Vec3d(v)));
        faces.add(mesh.triangles.size(), kDressedSurface);
        append(standing, mesh);
        append(shown, mesh);
    }

    // --- the box and its ground ---
    Scene scene;
    const double v = p.cell, half_x = layout.width / 2, half_y = layout.depth / 2;
    std::vector<double> xs = lines(half_x + 6 * v, half_x + 6 * v, 1.2 * v, v),
                        ys = lines(half_y + 6 * v, half_y + 6 * v, 1.2 * v, v);
    TriMesh earth = sheet(ground, centre, xs, ys, progress.slice(0.1, 0.2));
    double low = std::numeric_limits<double>::infinity(), top = -low;
    for (const Vec3f& q : earth.vertices) {
        if (ground.water(double(q.x) - centre.x, double(q.y) - centre.y) <= 0)
            low = std::min(low, double(q.z));
        top = std::max(top, double(q.z));
    }
    for (const Vec3f& q : standing.vertices) top = std::max(top, double(q.z));
    if (!std::isfinite(low))
        throw InvalidParameter("garden: pond: it takes all of the plot; make the plot larger");
    // Where there is water, cells begin at its level; a plane at multiples of the cell, through
    // their centres, would be inside or outside by rounding.
    const double floor = layout.pond ? ground.level() : low - 2 * v;
    const Transform transform{{centre.x - half_x - v / 4, centre.y - half_y - v / 4, floor}, v};
    scene.domain = {{int(std::ceil(layout.width / v)), int(std::ceil(layout.depth / v)),
                     int(std::ceil((top - floor) / v)) + 3},
                    transform};
    const double cells = plot_cells(p) + 2 * standing.area() / (v * v);
    if (cells > most_cells)
        throw LimitExceeded(fmt::format(
            "garden: about {:.3g} cells of {} m, {:.3g} fit into the memory; make the cells larger "
            "with --cell or the plot smaller with --size",
            cells, v, most_cells));
    const float bottom = float(std::min(floor, low) - p.depth - 12 * v);
    close_below(earth, xs.size(), ys.size(), bottom);
    const FloatGrid ground_sdf = level_set_from_mesh(earth, transform, progress.slice(0.2, 0.4));
    earth = {};
    FloatGrid surface = ground_sdf, stone_sdf;
    if (!standing.triangles.empty()) {
        stone_sdf = level_set_from_mesh(standing, transform, progress.slice(0.4, 0.6));
        surface = mend_distances(csg_union(stone_sdf, ground_sdf), progress.slice(0.6, 0.8));
    }

    // --- what each voxel near the surface is made of ---
    const int soil = apps::geology_of_soil(p.soil), rock = apps::geology_of_soil("rock");
    const float soil_mm = float(p.soil_depth * 1000);
    IntGrid geology = IntGrid::uninitialised(surface.topology(), transform, 0);
    FloatGrid depth = FloatGrid::uninitialised(surface.topology(), transform, 0.0f);
    parallel_for(surface.leaf_count(), [&](std::size_t leaf) {
        GridReader<float> of_stone(stone_sdf), of_ground(ground_sdf);
        for (int offset = 0; offset < kLeafSize; ++offset) {
            std::int32_t what = 0;
            if (surface.mask(leaf).test(offset)) {
                const Coord c = leaf_coord(surface.origin(leaf), offset);
                const bool stone =
                    !standing.triangles.empty() && of_stone.value(c) < of_ground.value(c);
                what = stone ? rock : soil;
                geology.mask(leaf).set(offset);
                depth.mask(leaf).set(offset);
            }
            geology.values(leaf)[offset] = what;
            depth.values(leaf)[offset] = what == 0              ? 0
                                         : apps::is_stone(what) ? apps::kSkinDepth
                                                                : soil_mm;
        }
    });
    geology.compress();
    depth.compress();
    scene.put("surface_sdf", std::move(surface), "m", "garden", GridClass::LevelSet);
    scene.put("geology", std::move(geology), "garden");
    scene.put("soil_h", std::move(depth), "mm", "garden");

    if (layout.pond) {
        const Pond& pond = *layout.pond;
        const double reach = (1 + 2 * p.shore) * std::max(pond.length, pond.width) / 2 + 0.5;
        const Vec3d at = centre + Vec3d(pond.place.x, pond.place.y, 0);
        const Transform lattice{{at.x, at.y, ground.level()}, kWaterVoxel};
        const int n = int(std::ceil(reach / kWaterVoxel / kLeafEdge)) * kLeafEdge;
        std::vector<Coord> origins;
        for (int x = -n; x < n; x += kLeafEdge)
            for (int y = -n; y < n; y += kLeafEdge) origins.push_back({x, y, -kLeafEdge});
        IntGrid water = IntGrid::uninitialised(LeafTopology::build(std::move(origins)), lattice, 0);
        parallel_for(water.leaf_count(), [&](std::size_t leaf) {
            for (int offset = 0; offset < kLeafSize; ++offset) {
                const Coord c = leaf_coord(water.origin(leaf), offset);
                const Vec3d w = lattice.world(centre_of(c)) - centre;
                const bool wet = c.z == -1 && ground.water(w.x, w.y) > -kUnderBank;
                water.values(leaf)[offset] = wet;
                if (wet) water.mask(leaf).set(offset);
            }
        });
        water.compress();
        scene.put("water_surface", std::move(water), "garden");
    }

    // --- maps for a forest ---
    int x0 = int(std::floor(centre.x - half_x)), y0 = int(std::floor(centre.y - half_y)),
        x1 = int(std::ceil(centre.x + half_x)), y1 = int(std::ceil(centre.y + half_y));
    auto middle = [&](int x, int y) { return Vec3d(x + 0.5, y + 0.5, 0) * kPixel - centre; };
    FloatGrid blocked = layer(x0, y0, x1, y1, 0, [](int, int) { return 0.0f; });
    blocked.expand();
    for (const Vec3d& q : tops) {
        const Coord c(int(std::floor(q.x)), int(std::floor(q.y)), 0);
        const std::uint32_t leaf = blocked.topology()->find(leaf_origin(c));
        if (leaf == kNoLeaf) continue;
        float& most = blocked.values(leaf)[leaf_offset(c)];
        most = std::max(most, float(q.z - ground.height(q.x - centre.x, q.y - centre.y)));
    }
    blocked.compress();
    scene.put("blocked_height", std::move(blocked), "m", "garden");
    scene.put("plantable", layer(x0, y0, x1, y1, 1, [](int, int) { return 0.0f; }), "", "garden");
    if (land) {
        x0 = std::min(x0, 0), y0 = std::min(y0, 0);
        x1 = std::max(x1, int(std::floor(land->width * *p.metres_per_pixel)));
        y1 = std::max(y1, int(std::floor(land->height * *p.metres_per_pixel)));
    }
    scene.put("ground_height",
              layer(x0, y0, x1, y1, float(p.centre.z),
                    [&](int x, int y) {
                        const Vec3d q = middle(x, y);
                        return float(ground.height(q.x, q.y));
                    }),
              "m", "garden");

    // --- the mesh: ground as far as pictures look ---
    const double step =
                     std::max({kFinestGround, 1.2 * v, std::max(layout.width, layout.depth) / 500}),
                 widest = land ? std::max(step, 0.5 * *p.metres_per_pixel)
                               : std::numeric_limits<double>::infinity();
    const TriMesh wide =
        sheet(ground, centre, lines(half_x, half_x + p.land, step, widest),
              lines(half_y, half_y + p.land, step, widest), progress.slice(0.8, 0.95));
    faces.add(wide.triangles.size(), kGroundSurface);
    append(shown, wide);
    shown.face_attributes = {{"column", std::move(faces.column)},
                             {"component", std::move(faces.component)},
                             {"surface", std::move(faces.surface)}};
    scene.meshes["rock"] = std::move(shown);
    return scene;
}

}  // namespace sekitei::garden
