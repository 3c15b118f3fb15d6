#include "apps/render/tufts.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/render/copies.h"
#include "core/error.h"
#include "core/noise.h"
#include "core/random.h"
#include "solvers/rays/embree.h"

namespace sekitei::render {
namespace {

/// Colours of a species: of the shaded foot, of leaves, of young tips, of leaves that are dry.
struct Palette {
    std::string_view name;
    Vec3f foot, leaf, tip, straw;
    float transmit;  ///< share of the colour that shines through
};
constexpr std::array<Palette, 5> kPalettes{{
    {"bryum",
     {0.040f, 0.045f, 0.012f},
     {0.105f, 0.155f, 0.024f},
     {0.300f, 0.370f, 0.070f},
     {0.380f, 0.335f, 0.150f},
     0.45f},
    {"hypnum",
     {0.060f, 0.048f, 0.014f},
     {0.120f, 0.148f, 0.025f},
     {0.315f, 0.335f, 0.056f},
     {0.400f, 0.330f, 0.120f},
     0.45f},
    {"polytrichum",
     {0.050f, 0.028f, 0.014f},
     {0.039f, 0.094f, 0.025f},
     {0.100f, 0.196f, 0.048f},
     {0.300f, 0.245f, 0.105f},
     0.30f},
    {"grimmia",
     {0.028f, 0.032f, 0.020f},
     {0.092f, 0.108f, 0.066f},
     {0.215f, 0.235f, 0.165f},
     {0.290f, 0.275f, 0.200f},
     0.20f},
    {"",
     {0.038f, 0.045f, 0.014f},
     {0.120f, 0.175f, 0.035f},
     {0.280f, 0.340f, 0.080f},
     {0.380f, 0.335f, 0.150f},
     0.40f},
}};
constexpr Vec3f kBrown{0.095f, 0.055f, 0.022f};  // of old leaves
constexpr Vec3f kHair{0.46f, 0.46f, 0.42f};
constexpr Vec3f kStalk{0.165f, 0.062f, 0.022f};

const Palette& palette(const std::string& species)
{
    for (const Palette& p : kPalettes)
        if (p.name == species) return p;
    return kPalettes.back();
}

Vec3f mix(Vec3f a, Vec3f b, float t)
{
    return a * (1 - t) + b * t;
}
float smooth(float low, float high, float x)
{
    const float t = std::clamp((x - low) / (high - low), 0.0f, 1.0f);
    return t * t * (3 - 2 * t);
}

/// How a plant departs from its palette, which is that of half a year's moist growth: each 0..1.
struct Condition {
    float young = 0, old = 0, dry = 0, soaked = 0;
};

/// @param height  along the shoot, as in TuftShape
Vec3f leaf_colour(const Palette& of, const Condition& is, float height)
{
    const Vec3f fresh{of.tip.x * 0.92f, of.tip.y * 1.16f, of.tip.z * 0.90f};
    const Vec3f leaf = mix(of.leaf, fresh, 0.40f * is.young);
    const Vec3f tip = mix(mix(of.tip, fresh, is.young), of.leaf, 0.22f * is.old);
    Vec3f colour = mix(of.foot, leaf, smooth(0.0f, 0.5f, height));
    colour = mix(colour, tip, smooth(0.45f, 1.0f, height));
    // Brown climbs from the foot.
    colour = mix(colour, kBrown, 0.8f * is.old * (1 - smooth(0.2f, 0.9f, height)));
    colour = mix(colour, of.straw * (0.3f + 0.7f * height), 0.65f * is.dry);
    const Vec3f deep = mix(Vec3f(1), Vec3f(0.60f, 0.74f, 0.53f), is.soaked);
    return {colour.x * deep.x, colour.y * deep.y, colour.z * deep.z};
}

struct Placed {
    Vec3f x, y, z;  // images of the plant's axes, with its scale
    Vec3f position;
    std::uint32_t shape = 0;
    Vec3f tint;
    Condition state;
    Vec3f world(Vec3f p) const { return position + x * p.x + y * p.y + z * p.z; }
    Vec3f turned(Vec3f v) const { return normalized(x * v.x + y * v.y + z * v.z); }
};

Placed placed(const Tuft& t, std::size_t i, double size)
{
    const auto [qx, qy, qz, qw] = t.orient;
    const double norm = static_cast<double>(qx) * qx + static_cast<double>(qy) * qy +
                        static_cast<double>(qz) * qz + static_cast<double>(qw) * qw;
    if (!(std::isfinite(t.position.x) && std::isfinite(t.position.y) &&
          std::isfinite(t.position.z) && std::isfinite(t.scale) && norm > 1e-12 && norm < 1e12))
        throw InvalidInput(fmt::format(
            "render: moss {} at ({}, {}, {}) m with scale {} and orient ({}, {}, {}, {}), must be "
            "finite, with an orientation",
            i, t.position.x, t.position.y, t.position.z, t.scale, qx, qy, qz, qw));
    if (!(std::isfinite(t.growth) && std::isfinite(t.wetness)))
        throw InvalidInput(
            fmt::format("render: moss {} has growth {} and wetness {}, must be finite", i, t.growth,
                        t.wetness));
    const double s = size * static_cast<double>(t.scale) / norm;
    const double x = qx, y = qy, z = qz, w = qw;
    Placed p;
    p.x = Vec3f(Vec3d(w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)) * s);
    p.y = Vec3f(Vec3d(2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)) * s);
    p.z = Vec3f(Vec3d(2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z) * s);
    p.position = Vec3f(t.position);
    const auto age = static_cast<float>(std::max(t.age, 0)), turned = age / (age + 180);
    p.state = {std::max(0.0f, 1 - 2 * turned), std::max(0.0f, 2 * turned - 1),
               1 - smooth(0.35f, 0.80f, t.wetness), smooth(0.80f, 1.0f, t.wetness)};
    // Shoots draw together as they dry.
    p.x *= 1 - 0.12f * p.state.dry;
    p.z *= 1 - 0.12f * p.state.dry;
    return p;
}

/// Where a plant's mesh stands among those of all species.
std::uint32_t slot(const Tuft& t, const TuftModel& which)
{
    int i = t.species - 1;
    i = i * kTuftModels + which.model;
    i = i * kTuftLods + which.lod;
    i = i * kTuftDensities + which.density;
    return static_cast<std::uint32_t>(2 * i + (t.growth >= kRipe ? 1 : 0));
}
constexpr std::size_t kSlots = 2 * kTuftModels * kTuftLods * kTuftDensities;  // of a species

TuftShape with_capsules(TuftShape shape, const TuftShape& more)
{
    const auto first = static_cast<std::uint32_t>(shape.vertices.size());
    auto append = [](auto& list, const auto& tail) {
        list.insert(list.end(), tail.begin(), tail.end());
    };
    append(shape.vertices, more.vertices);
    append(shape.normals, more.normals);
    append(shape.height, more.height);
    append(shape.tone, more.tone);
    for (auto t : more.triangles) {
        for (std::uint32_t& v : t) v += first;
        shape.triangles.push_back(t);
    }
    return shape;
}

std::uint64_t key_of(std::uint64_t seed)
{
    return hash2(seed, Stream("render.tufts").id);
}
/// Where the random numbers of a plant begin.
std::uint64_t own_number(std::int64_t id, std::size_t place)
{
    return 4 * (id >= 0 ? static_cast<std::uint64_t>(id) : place);
}
int sibling(std::uint64_t key, std::uint64_t own)
{
    return static_cast<int>(uniform_of_key(key, own) * kTuftModels);
}

}  // namespace

TuftShape tuft_shape(const std::string& species, const TuftModel& which, bool ripe)
{
    TuftShape shape = tuft_shape(species, which);
    return ripe ? with_capsules(std::move(shape), tuft_capsules(species, which)) : shape;
}

int tuft_sibling(std::uint64_t seed, std::int64_t id, std::size_t place)
{
    return sibling(key_of(seed), own_number(id, place));
}

Vec3f tuft_colour(const std::string& species, float height)
{
    return height > 1.5f   ? kStalk
           : height > 1.1f ? kHair
                           : leaf_colour(palette(species), {}, height);
}

struct Tufts::State {
    std::vector<TuftShape> shapes;  // kSlots a species, made when first needed
    std::vector<std::string> species;
    std::vector<Placed> placed;
    std::uint64_t key = 0;
    double size = 1;
    std::size_t triangles = 0;

    std::atomic<std::int64_t> bytes{0};
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;
    std::vector<RTCScene> prototypes;

    ~State()
    {
        if (scene) rtcReleaseScene(scene);
        for (RTCScene s : prototypes)
            if (s) rtcReleaseScene(s);
        if (device) rtcReleaseDevice(device);
    }
    void build(const Progress& progress);
};

void Tufts::State::build(const Progress& progress)
{
    device = rtcNewDevice(nullptr);
    if (!device) throw LimitExceeded("render: Embree could not start");
    rtcSetDeviceMemoryMonitorFunction(
        device,
        [](void* total, ssize_t change, bool) {
            static_cast<std::atomic<std::int64_t>*>(total)->fetch_add(change);
            return true;
        },
        &bytes);
    for (const TuftShape& shape : shapes) {
        prototypes.push_back(nullptr);
        if (shape.triangles.empty()) continue;
        RTCScene prototype = prototypes.back() = rtcNewScene(device);
        rtcSetSceneFlags(prototype, RTC_SCENE_FLAG_ROBUST);
        RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        void* points =
            rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                    sizeof(Vec3f), shape.vertices.size());
        void* corners =
            rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                    sizeof(shape.triangles[0]), shape.triangles.size());
        if (points && corners) {
            std::memcpy(points, shape.vertices.data(), shape.vertices.size() * sizeof(Vec3f));
            std::memcpy(corners, shape.triangles.data(),
                        shape.triangles.size() * sizeof(shape.triangles[0]));
            rtcCommitGeometry(geometry);
            rtcAttachGeometry(prototype, geometry);
            rtcCommitScene(prototype);
        }
        rtcReleaseGeometry(geometry);
    }
    scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    for (std::size_t i = 0; i < placed.size(); ++i) {
        if (i % 1024 == 0) progress.check();
        const Placed& p = placed[i];
        RTCGeometry instance = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(instance, prototypes[p.shape]);
        const std::array<float, 12> matrix{p.x.x, p.x.y,        p.x.z,        p.y.x,
                                           p.y.y, p.y.z,        p.z.x,        p.z.y,
                                           p.z.z, p.position.x, p.position.y, p.position.z};
        rtcSetGeometryTransform(instance, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, matrix.data());
        rtcCommitGeometry(instance);
        rtcAttachGeometryByID(scene, instance, static_cast<unsigned>(i));
        rtcReleaseGeometry(instance);
    }
    rtcCommitScene(scene);
    if (rtcGetDeviceError(device) != RTC_ERROR_NONE)
        throw LimitExceeded("render: no memory for the rays of " +
                            count_text(static_cast<double>(placed.size())) + " moss plants");
}

Tufts::Tufts(const std::vector<Tuft>& tufts, const std::vector<std::string>& species, double size,
             std::uint64_t seed, const TuftView& view, const Progress& progress)
    : state_(std::make_unique<State>())
{
    State& s = *state_;
    s.species = species;
    s.size = size;
    s.key = key_of(seed);
    s.shapes.resize(species.size() * kSlots);
    for (std::size_t i = 0; i < tufts.size(); ++i) {
        const Tuft& t = tufts[i];
        Placed p = placed(t, i, size);
        if (t.species < 1 || static_cast<std::size_t>(t.species) > species.size())
            throw InvalidInput(fmt::format("render: moss {} is of species {}, must be 1 to {}", i,
                                           t.species, species.size()));
        if (!(t.scale > 0)) continue;
        const std::uint64_t own = own_number(t.id, i);
        TuftModel which;
        which.model = sibling(s.key, own);
        which.density = tuft_density(t.growth);
        const double far = length(t.position - view.eye) * view.pixel;
        which.lod = tuft_lod(far > 0 ? size * static_cast<double>(t.scale) / far : INFINITY);
        p.shape = slot(t, which);
        if (TuftShape& shape = s.shapes[p.shape]; shape.triangles.empty()) {
            const std::string& name = species[static_cast<std::size_t>(t.species - 1)];
            shape = tuft_shape(name, which, t.growth >= kRipe);
        }
        s.triangles += s.shapes[p.shape].triangles.size();
        // Brighter or darker, yellower or bluer: each by itself, and in patches.
        auto patch = [&](std::uint64_t k, double wavelength) {
            return gradient_noise(hash2(s.key, k), Vec3d(t.position) / (size * wavelength));
        };
        const double bright =
            1 + 0.30 * (uniform_of_key(s.key, own + 1) - 0.5) + 0.45 * patch(1, 9);
        const double warm = 0.22 * (uniform_of_key(s.key, own + 2) - 0.5) + 0.55 * patch(2, 14) +
                            0.25 * patch(3, 4);
        p.tint = Vec3f(Vec3d(bright * (1 + 0.36 * warm), bright * (1 + 0.06 * warm),
                             bright * (1 - 0.4 * warm)));
        s.placed.push_back(p);
    }
    if (!s.placed.empty()) s.build(progress);
}

Tufts::~Tufts() = default;

bool Tufts::intersect(Vec3f origin, Vec3f direction, float far, TuftHit& hit) const
{
    if (!state_->scene) return false;
    RTCRayHit query;
    if (!rays::first_hit(state_->scene, rays::ray_of(origin, direction, 0, far), query))
        return false;
    hit.tuft = query.hit.instID[0];
    hit.triangle = query.hit.primID;

    const Placed& p = state_->placed[hit.tuft];
    refine(hit, p, state_->shapes[p.shape], origin, direction, query.ray.tfar);
    return true;
}

bool Tufts::occluded(Vec3f origin, Vec3f direction, float far) const
{
    if (!state_->scene) return false;
    return rays::any_hit(state_->scene, rays::ray_of(origin, direction, 0, far));
}

void Tufts::place(const TuftHit& hit, Vec3f& position, Vec3f& geometric, Vec3f& soft) const
{
    const Placed& p = state_->placed[hit.tuft];
    place_hit(hit, p, state_->shapes[p.shape], position, geometric, soft);
}

Material Tufts::material(const TuftHit& hit, const SurfacePoint& point) const
{
    const Placed& p = state_->placed[hit.tuft];
    const TuftShape& shape = state_->shapes[p.shape];
    const auto& t = shape.triangles[hit.triangle];
    auto at = [&](const std::vector<float>& values) {
        return values[t[0]] * (1 - hit.u - hit.v) + values[t[1]] * hit.u + values[t[2]] * hit.v;
    };
    const float height = at(shape.height), tone = shape.tone[t[0]];
    const Palette& of = palette(state_->species[p.shape / kSlots]);

    Material m;
    m.normal = point.normal;
    m.roughness = 0.55f + 0.20f * p.state.dry - 0.20f * p.state.soaked;
    m.specular = point.seen ? 0.35f - 0.20f * p.state.dry + 0.25f * p.state.soaked : 0;
    if (height > 1.5f) {
        m.albedo = kStalk * (1 + 0.5f * tone);
        return m;
    }
    Vec3f colour = leaf_colour(of, p.state, height) * (1 + 0.22f * tone);
    colour = {colour.x * p.tint.x, colour.y * p.tint.y, colour.z * p.tint.z};
    if (height > 1.1f) colour = kHair;
    for (int i = 0; i < 3; ++i) colour[i] = std::clamp(colour[i], 0.006f, 0.7f);
    m.albedo = colour;
    m.transmit = colour * of.transmit;
    return m;
}

std::size_t Tufts::memory_bytes() const
{
    return static_cast<std::size_t>(std::max<std::int64_t>(0, state_->bytes.load())) +
           state_->placed.capacity() * sizeof(Placed);
}

std::size_t Tufts::triangles() const
{
    return state_->triangles;
}

}  // namespace sekitei::render
