#include "apps/render/render.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "apps/render/camera.h"
#include "apps/render/colour.h"
#include "apps/render/corner_normals.h"
#include "apps/render/garden.h"
#include "apps/render/look.h"
#include "apps/render/path_tracer.h"
#include "apps/render/sky.h"
#include "apps/render/text.h"
#include "apps/render/tufts.h"
#include "apps/render/woods.h"
#include "core/error.h"
#include "core/log.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/rays/embree.h"

namespace sekitei::render {
namespace {

constexpr double kDegree = math::kPi / 180;
constexpr double kCrease = 38 * kDegree;

/// Exposure that shows rock in open light a little below middle grey.
constexpr float kRockExposure = 2.1f;

/// Distance at which air veils a forest seen from above, by its size: depth among crowns that are
/// all alike. Air in the shade below them hardly shines.
constexpr double kForestHaze = 9;

/// One of so many leaves hides light from an eye below the crowns.
constexpr std::size_t kShadeEvery = 4;

/// Bounds of what triangles use.
Bounds used_bounds(const TriMesh& mesh)
{
    Bounds bounds;
    for (const auto& t : mesh.triangles)
        for (const std::uint32_t v : t)
            if (v < mesh.vertices.size()) bounds.add(Vec3d(mesh.vertices[v]));
    return bounds;
}

Vec3d direction_of(double azimuth_deg, double elevation_deg)
{
    const double a = azimuth_deg * kDegree, e = elevation_deg * kDegree;
    return {math::sin(a) * math::cos(e), math::cos(a) * math::cos(e), math::sin(e)};
}

/// A mesh attribute as colours.
struct Shown {
    std::vector<Vec3f> colours;
    bool per_vertex = false;
    bool ids = false, vectors = false;
    double low = 0, high = 1;
    std::vector<std::int32_t> names;
};

Shown show_attribute(const TriMesh& mesh, const std::string& name)
{
    const TriMesh::Attribute* attribute = nullptr;
    Shown shown;
    if (const auto v = mesh.vertex_attributes.find(name); v != mesh.vertex_attributes.end()) {
        attribute = &v->second;
        shown.per_vertex = true;
    }
    // Names belong to whole triangles where both are there.
    if (const auto f = mesh.face_attributes.find(name); f != mesh.face_attributes.end())
        if (!attribute || std::holds_alternative<std::vector<std::int32_t>>(f->second)) {
            attribute = &f->second;
            shown.per_vertex = false;
        }
    if (!attribute) {
        std::vector<std::string> known;
        for (const auto& [key, value] : mesh.vertex_attributes) known.push_back(key);
        for (const auto& [key, value] : mesh.face_attributes) known.push_back(key);
        std::sort(known.begin(), known.end());
        known.erase(std::unique(known.begin(), known.end()), known.end());
        throw InvalidInput(fmt::format(
            "render: field = {}, the mesh has {}", name,
            known.empty() ? "no attributes" : fmt::format("{}", fmt::join(known, ", "))));
    }
    const std::size_t expected = shown.per_vertex ? mesh.vertices.size() : mesh.triangles.size();
    const std::size_t found = std::visit([](const auto& v) { return v.size(); }, *attribute);
    if (found != expected)
        throw InvalidInput(fmt::format("render: field {} has {} values, the mesh has {} {}", name,
                                       found, expected,
                                       shown.per_vertex ? "vertices" : "triangles"));
    shown.colours.resize(expected);
    if (const auto* floats = std::get_if<std::vector<float>>(attribute)) {
        double low = INFINITY, high = -INFINITY;
        for (const float v : *floats)
            if (std::isfinite(v)) {
                low = std::min(low, static_cast<double>(v));
                high = std::max(high, static_cast<double>(v));
            }
        if (!(low <= high)) low = high = 0;
        shown.low = low;
        shown.high = high;
        const double span = high > low ? high - low : 1;
        parallel_for(
            expected,
            [&](std::size_t i) {
                const auto v = static_cast<double>((*floats)[i]);
                shown.colours[i] =
                    std::isfinite(v) ? colour_of_value((v - low) / span) : Vec3f(0.3f);
            },
            4096);
    } else if (const auto* ints = std::get_if<std::vector<std::int32_t>>(attribute)) {
        shown.ids = true;
        shown.names = *ints;
        std::sort(shown.names.begin(), shown.names.end());
        shown.names.erase(std::unique(shown.names.begin(), shown.names.end()), shown.names.end());
        parallel_for(
            expected, [&](std::size_t i) { shown.colours[i] = colour_of_id((*ints)[i]); }, 4096);
    } else {
        shown.vectors = true;
        const auto& vectors = std::get<std::vector<Vec3f>>(*attribute);
        for (std::size_t i = 0; i < expected; ++i)
            shown.colours[i] = colour_of_direction(vectors[i]);
    }
    return shown;
}

/// Bytes of a film; the dither hides steps in smooth skies and is addressed by pixel.
template <class ToDisplay>
Image8 develop(const Film& film, std::uint64_t seed, ToDisplay&& to_display)
{
    Image8 image(film.width, film.height, 3);
    constexpr Stream kDither{"render.dither"};
    const std::uint64_t key = hash2(seed, kDither.id);
    parallel_for(static_cast<std::size_t>(film.height), [&](std::size_t row) {
        for (std::size_t x = 0; x < static_cast<std::size_t>(film.width); ++x) {
            const std::size_t i = row * static_cast<std::size_t>(film.width) + x;
            const Vec3f c = to_display(film.radiance[i]);
            const double dither = uniform_of_key(key, i) - 0.5;
            for (int k = 0; k < 3; ++k)
                image.pixels[i * 3 + static_cast<std::size_t>(k)] =
                    srgb_byte(static_cast<double>(c[k]), dither);
        }
    });
    return image;
}

/// Bounds the camera looks at: what the ground buries does not count.
Bounds shown_bounds(const TriMesh& mesh, const Params& params)
{
    Bounds bounds = used_bounds(mesh);
    if (params.ground && params.ground_height) {
        if (*params.ground_height >= bounds.upper.z)
            throw InvalidParameter(
                fmt::format("render: ground_height = {} m, must be below the top of the mesh, {} m",
                            *params.ground_height, bounds.upper.z));
        bounds.lower.z = std::max(bounds.lower.z, *params.ground_height);
    }
    return bounds;
}

float stops_of(const Params& params)
{
    return static_cast<float>(math::exp(params.exposure * 0.69314718055994531));
}

/// How much brighter a picture is made in which trees leave little light: at most 4.5 stops.
float lift_of(const Film& film, float gain)
{
    double sum = 0;
    std::size_t count = 0;
    for (std::size_t i = 0; i < film.radiance.size(); ++i) {
        if (!(film.depth[i] > 0)) continue;
        const Vec3f c = film.radiance[i];
        const auto l = static_cast<double>(0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z);
        sum += math::log(l * static_cast<double>(gain) + 0.002);
        ++count;
    }
    if (count == 0) return 1;
    constexpr double kKey = 0.10;
    const double mean = math::exp(sum / double(count));
    return static_cast<float>(std::clamp(math::exp(0.75 * math::log(kKey / mean)), 1.0, 22.6));
}

/// A film of daylight as a picture.
Image8 develop_day(const Film& film, const Sky& sky, const Params& params, std::uint64_t seed,
                   bool lifted = false)
{
    float gain = kRockExposure * stops_of(params) / std::max(sky.white(), 1e-12f);
    if (lifted) {
        const float lift = lift_of(film, gain / stops_of(params));
        log::detail("render: {:.2f} times as bright, for the shade of trees", lift);
        gain *= lift;
    }
    return develop(film, seed, [&](Vec3f c) { return tone_map(c * gain); });
}

Film film_of(const World& world, const Params& params, std::uint64_t seed, const Progress& progress)
{
    const TraceParams trace_params{.width = params.width,
                                   .height = params.height,
                                   .samples = params.samples,
                                   .bounces = params.bounces};
    return trace(world, trace_params, seed, progress.slice(0.02, 0.95));
}

/// The trees, of models no finer than can be seen; null without trees.
std::unique_ptr<Woods> woods_of(const Stuff& stuff, const TuftView& view, bool above,
                                std::uint64_t seed, const Progress& progress)
{
    if (stuff.trees.empty()) return nullptr;
    const std::vector<std::uint8_t> levels = tree_levels(stuff.trees, stuff.models, view);
    std::vector<std::uint8_t> needed(stuff.models);
    for (std::size_t i = 0; i < levels.size(); ++i)
        needed[std::size_t(stuff.trees[i].model)] |= static_cast<std::uint8_t>(1u << levels[i]);
    return std::make_unique<Woods>(stuff.trees, stuff.grow(needed), levels, seed,
                                   above ? 1 : kShadeEvery, progress);
}

/// Values of one attribute of the points, checked; null where there are none.
template <class T>
const std::vector<T>* attribute_if(const Points& points, const char* what, const char* name,
                                   const char* type)
{
    const auto found = points.attributes.find(name);
    if (found == points.attributes.end()) return nullptr;
    const auto* values = std::get_if<std::vector<T>>(&found->second);
    if (!values)
        throw InvalidInput(fmt::format("render: attribute {} of {} is of another type, must be {}",
                                       name, what, type));
    if (values->size() != points.position.size())
        throw InvalidInput(fmt::format("render: attribute {} of {} has {} values, must have {}",
                                       name, what, values->size(), points.position.size()));
    return values;
}

template <class T>
const std::vector<T>& attribute(const Points& points, const char* what, const char* name,
                                const char* type)
{
    const auto* values = attribute_if<T>(points, what, name, type);
    if (!values)
        throw InvalidInput(fmt::format("render: points of {} have no attribute {}", what, name));
    return *values;
}

/// Light from everywhere and a large soft sun over the camera's left shoulder: shape without drama.
Sky soft_light(const Params& params)
{
    Sky sky = Sky::uniform(0.72f, true);
    sky.set_sun(direction_of(params.view_azimuth - 50, 50), 12 * kDegree, Vec3f(1.1f));
    return sky;
}

/// Photons by the number of their reflections.
struct PhotonKind {
    const char* name;
    Vec3f colour;
};
constexpr std::array<PhotonKind, 3> kPhotonKinds{{
    {"direct", {1.0f, 0.90f, 0.42f}},
    {"reflected once", {1.0f, 0.32f, 0.04f}},
    {"reflected again", {0.85f, 0.035f, 0.06f}},
}};

}  // namespace

void validate(const Params& params)
{
    validate_described("render", params);
}

Image8 run(const TriMesh& mesh, const Params& params, std::uint64_t seed, const Progress& progress)
{
    validate(params);
    if (mesh.triangles.empty())
        throw InvalidInput("render: the mesh has no triangles, must have at least one");
    std::optional<Shown> shown;
    if (!params.field.empty()) shown = show_attribute(mesh, params.field);
    const Bounds bounds = shown_bounds(mesh, params);
    const double size = length(bounds.size());
    progress.update(0);

    const rays::TriangleScene rays(mesh.vertices, mesh.triangles, "render",
                                   progress);  // checks the mesh
    const std::vector<Vec3f> normals = corner_normals(mesh, kCrease, progress);
    progress.check();
    const Vec3d sun = direction_of(params.sun_azimuth, params.sun_elevation);
    const double sun_radius = params.sun_size / 2 * kDegree;
    std::optional<double> ground;
    if (params.ground) ground = params.ground_height.value_or(bounds.lower.z);

    // Light and look: rock by day, or a field in soft light before a plain backdrop.
    Sky sky;
    std::unique_ptr<Look> look;
    if (shown) {
        sky = soft_light(params);
        look = std::make_unique<ColourLook>(mesh, shown->colours, shown->per_vertex, Vec3f(0.8f));
        ground.reset();
    } else {
        sky = Sky::day(sun, sun_radius, params.turbidity, !params.ground);
        look = std::make_unique<RockLook>(mesh, seed, progress);
    }
    World world{.mesh = mesh,
                .rays = rays,
                .normals = normals,
                .look = *look,
                .sky = sky,
                .camera = make_camera(params, bounds),
                .ground = ground,
                .haze = shown ? INFINITY : params.haze.value_or(std::max(size, 1e-6) * 45),
                .hills = params.hills && params.ground && !shown,
                .backdrop = {}};
    if (shown) world.backdrop = Vec3f(0.93f);
    Film film = film_of(world, params, seed, progress);
    log::detail("render: {} triangles, {} rays, {} for Embree",
                count_text(static_cast<double>(mesh.triangles.size())),
                count_text(static_cast<double>(film.rays)),
                bytes_text(static_cast<double>(rays.memory_bytes())));
    if (params.denoise) denoise(film, progress.slice(0.95, 0.99));

    const float stops = stops_of(params);
    Image8 image;
    if (shown) {
        image = develop(film, seed, [&](Vec3f c) { return c * stops; });
        const int scale = std::max(1, params.height / 300), margin = 10 * scale;
        const int bar = std::min(params.height - 2 * margin, 190 * scale);
        const Rgb ink{40, 40, 40};
        if (shown->ids)
            draw_id_legend(image, margin, margin, bar, shown->names, params.field, scale, ink);
        else if (!shown->vectors)
            draw_colour_bar(image, margin, margin, bar, shown->low, shown->high, params.field,
                            scale, ink);
        else
            draw_text(image, margin, margin, params.field, scale, ink);
    } else {
        image = develop_day(film, sky, params, seed);
    }
    progress.update(1);
    return image;
}

std::vector<Tuft> tufts_of(const Points& moss)
{
    const auto& orient = attribute<std::array<float, 4>>(moss, "moss", "orient", "four floats");
    const auto& scale = attribute<float>(moss, "moss", "pscale", "float");
    const auto& species = attribute<std::int32_t>(moss, "moss", "species", "int32");
    const auto* growth = attribute_if<float>(moss, "moss", "growth", "float");
    const auto* wetness = attribute_if<float>(moss, "moss", "wetness", "float");
    const auto* age = attribute_if<std::int32_t>(moss, "moss", "age", "int32");
    const auto* id = attribute_if<std::int64_t>(moss, "moss", "id", "int64");
    std::vector<Tuft> tufts(moss.position.size());
    for (std::size_t i = 0; i < tufts.size(); ++i) {
        Tuft& t = tufts[i];
        t.position = moss.position[i];
        t.orient = orient[i];
        t.scale = scale[i];
        t.species = species[i];
        t.growth = growth ? (*growth)[i] : std::min(2 * scale[i], t.growth);
        if (wetness) t.wetness = (*wetness)[i];
        if (age) t.age = (*age)[i];
        if (id) t.id = (*id)[i];
    }
    return tufts;
}

Image8 run(const Stuff& stuff, const Params& params, std::uint64_t seed, const Progress& progress)
{
    validate(params);
    if (!(stuff.moss_size > 0 && stuff.moss_size < 1e6))
        throw InvalidParameter(
            fmt::format("render: moss_size = {} m, must be > 0", stuff.moss_size));
    if (stuff.pieces.empty())
        throw InvalidInput("render: the garden has no meshes, must have at least one");
    const bool plain = stuff.pieces.size() == 1 && stuff.moss.empty() && stuff.trees.empty() &&
                       stuff.pieces[0].substance == Substance::Rock;
    if (plain || !params.field.empty()) return run(*stuff.pieces[0].mesh, params, seed, progress);

    const TriMesh mesh = joined(stuff.pieces);
    Bounds bounds = shown_bounds(mesh, params);
    for (const StandingTree& t : stuff.trees)
        bounds.add(t.position + Vec3d(0, 0, static_cast<double>(t.scale.z)));
    const double size = length(bounds.size());
    progress.update(0);
    const rays::TriangleScene rays(mesh.vertices, mesh.triangles, "render", progress);
    const std::vector<Vec3f> normals = corner_normals(mesh, kCrease, progress);
    const GardenLook look(stuff.pieces, seed, progress);
    std::vector<Tuft> moss = stuff.moss;
    lay_mats(moss, stuff.species, stuff.moss_size, mesh, rays);
    const Camera camera = make_camera(params, bounds);
    const TuftView view{camera.eye, 2 * camera.tan_y / params.height};
    const Tufts tufts(moss, stuff.species, stuff.moss_size, seed, view, progress);
    const bool above = !stuff.trees.empty() && camera.eye.z > bounds.upper.z;
    const std::unique_ptr<Woods> woods = woods_of(stuff, view, above, seed, progress);
    const Sky sky = Sky::day(direction_of(params.sun_azimuth, params.sun_elevation),
                             params.sun_size / 2 * kDegree, params.turbidity, !params.ground);
    World world{.mesh = mesh,
                .rays = rays,
                .normals = normals,
                .look = look,
                .sky = sky,
                .camera = camera,
                .ground = {},
                .haze = params.haze.value_or(std::max(size, 1e-6) * (above ? kForestHaze : 45)),
                .hills = params.hills && params.ground,
                .backdrop = {},
                .tufts = &tufts,
                .woods = woods.get()};
    if (params.ground) world.ground = params.ground_height.value_or(bounds.lower.z);
    Film film = film_of(world, params, seed, progress);
    log::detail("render: {} triangles and {} moss plants of {} triangles, {} rays, {} for Embree",
                count_text(static_cast<double>(mesh.triangles.size())),
                count_text(static_cast<double>(stuff.moss.size())),
                count_text(static_cast<double>(tufts.triangles())),
                count_text(static_cast<double>(film.rays)),
                bytes_text(static_cast<double>(rays.memory_bytes() + tufts.memory_bytes())));
    if (woods)
        log::detail("render: {} trees of {} triangles, {}",
                    count_text(static_cast<double>(stuff.trees.size())),
                    count_text(static_cast<double>(woods->triangles())),
                    bytes_text(static_cast<double>(woods->memory_bytes())));
    if (params.denoise) denoise(film, progress.slice(0.95, 0.99));
    const Image8 image = develop_day(film, sky, params, seed, woods != nullptr);
    progress.update(1);
    return image;
}

std::vector<PhotonDot> photons_of(const Points& photons)
{
    const auto& normal = attribute<Vec3f>(photons, "photons", "N", "vector");
    const auto& bounce = attribute<std::int32_t>(photons, "photons", "bounce", "int32");
    std::vector<PhotonDot> dots(photons.position.size());
    for (std::size_t i = 0; i < dots.size(); ++i)
        dots[i] = {photons.position[i], normal[i], bounce[i]};
    return dots;
}

double photon_dot_size(const TriMesh& mesh)
{
    return std::max(length(used_bounds(mesh).size()) / 240, 1e-6);
}

Image8 run(const TriMesh& mesh, const std::vector<PhotonDot>& photons, double size,
           const Params& params, std::uint64_t seed, const Progress& progress)
{
    validate(params);
    if (!(size > 0 && size < 1e6))
        throw InvalidParameter(fmt::format("render: photon_size = {} m, must be > 0", size));
    progress.update(0);

    // The surface, then a flat hexagon for each photon, hardly above it.
    TriMesh all = joined({{&mesh, Substance::Rock}});
    const std::size_t first_dot = all.triangles.size();
    std::vector<Vec3f> colours(first_dot, Vec3f(0.075f, 0.082f, 0.095f));
    std::array<bool, kPhotonKinds.size()> there{};
    for (std::size_t i = 0; i < photons.size(); ++i) {
        if (i % 4096 == 0) progress.check();
        const PhotonDot& photon = photons[i];
        const Vec3d n = normalized(Vec3d(photon.normal));
        if (!std::isfinite(dot(photon.position, photon.position)) || !(dot(n, n) > 0.5))
            throw InvalidInput(
                fmt::format("render: photon {} has no finite place or no normal", i));
        const Vec3d u = normalized(std::abs(n.z) < 0.9 ? cross(n, Vec3d(0, 0, 1))
                                                       : cross(n, Vec3d(1, 0, 0))),
                    v = cross(n, u), centre = photon.position + n * (0.04 * size);
        const auto corner = static_cast<std::uint32_t>(all.vertices.size());
        for (int k = 0; k < 6; ++k) {
            const double turn = k * math::kPi / 3;
            all.vertices.emplace_back(centre +
                                      (u * math::cos(turn) + v * math::sin(turn)) * (size / 2));
        }
        const auto kind = static_cast<std::size_t>(std::clamp(photon.bounce, 0, 2));
        there[kind] = true;
        for (std::uint32_t k = 1; k < 5; ++k) {
            all.triangles.push_back({corner, corner + k, corner + k + 1});
            colours.push_back(kPhotonKinds[kind].colour);
        }
    }

    const rays::TriangleScene rays(all.vertices, all.triangles, "render", progress);
    const std::vector<Vec3f> normals = corner_normals(all, kCrease, progress);
    const ColourLook look(all, std::move(colours), false, Vec3f(0.075f), first_dot);
    const Sky sky = soft_light(params);
    const World world{.mesh = all,
                      .rays = rays,
                      .normals = normals,
                      .look = look,
                      .sky = sky,
                      .camera = make_camera(params, shown_bounds(mesh, params)),
                      .ground = {},
                      .haze = INFINITY,
                      .hills = false,
                      .backdrop = Vec3f(0.012f)};
    Film film = film_of(world, params, seed, progress);
    if (params.denoise) denoise(film, progress.slice(0.95, 0.99));
    const float stops = stops_of(params);
    Image8 image = develop(film, seed, [&](Vec3f c) { return c * stops; });
    const int scale = std::max(1, params.height / 300), margin = 10 * scale;
    int line = margin;
    for (std::size_t kind = 0; kind < kPhotonKinds.size(); ++kind) {
        if (!there[kind]) continue;
        const Vec3d c(kPhotonKinds[kind].colour);
        draw_text(image, margin, line, kPhotonKinds[kind].name, scale,
                  {srgb_byte(c.x), srgb_byte(c.y), srgb_byte(c.z)});
        line += (kGlyphHeight + 2) * scale;
    }
    progress.update(1);
    return image;
}

}  // namespace sekitei::render
