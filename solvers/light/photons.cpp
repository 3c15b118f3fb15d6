#include "solvers/light/photons.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/log.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/light/lobes.h"
#include "solvers/rays/embree.h"

namespace sekitei::light {
namespace {

using math::kPi;

constexpr float kNear = 1e-4f;  // rays start to see [m]
constexpr double kLift = 1e-5;  // ray origins above surfaces, in radii of the scene
constexpr double kMostAlbedo = 0.95;
constexpr int kMostBounces = 64;
constexpr double kSunRadius = 0.2665 * kPi / 180;  // of its disc as seen from here
constexpr std::size_t kChunk = 2048;

constexpr Stream kSunPhoton{"photons.sun"}, kSkyPhoton{"photons.sky"}, kBounce{"photons.bounce"};

/// The draws of one photon, by number.
class Draws {
public:
    Draws(std::uint64_t seed_of_day, Stream stream, std::uint64_t photon)
        : key_(hash2(hash2(seed_of_day, stream.id), photon))
    {
    }
    double operator()(std::uint64_t number) const { return uniform_of_key(key_, number); }

private:
    std::uint64_t key_;
};

std::uint64_t seed_of_day(std::uint64_t seed, std::uint64_t day)
{
    return hash2(seed, day);
}

void check_albedo(double albedo, const char* whose)
{
    if (!(albedo >= 0 && albedo <= kMostAlbedo))
        throw InvalidInput(fmt::format("photons: albedo of {} = {:.6g}, must be 0 to {}", whose,
                                       albedo, kMostAlbedo));
}

struct Square {
    double half, distance;
};
Square square_of(const PhotonParams& params, double radius)
{
    return {params.square_half.value_or(radius), params.square_distance.value_or(10 * radius)};
}

void check_square(const PhotonParams& params, double radius)
{
    if (params.sun_light == SunLight::Parallel) return;
    const double distance = square_of(params, radius).distance;
    if (distance < 3 * radius)
        throw InvalidParameter(fmt::format(
            "photons: square_distance = {:.6g} m, must be >= {:.6g} m, three radii of the scene",
            distance, 3 * radius));
    if (params.sun_light == SunLight::Square && distance > 100 * radius)
        throw InvalidParameter(fmt::format(
            "photons: square_distance = {:.6g} m, must be <= {:.6g} m, a hundred radii of the "
            "scene, "
            "beyond which hardly a direction finds it; sun_light = square_cone has no such limit",
            distance, 100 * radius));
}

/// Beams above the horizon, as a table to draw from.
struct Sun {
    std::vector<Vec3d> towards;
    std::vector<double> upto;  ///< summed irradiances
    double irradiance = 0;

    explicit Sun(const Daylight& day)
    {
        for (std::size_t k = 0; k < day.beams.size(); ++k) {
            const Daylight::Beam& beam = day.beams[k];
            const double size = length(beam.towards);
            if (!(size > 0 && std::isfinite(size) && beam.irradiance >= 0 &&
                  std::isfinite(beam.irradiance)))
                throw InvalidInput(fmt::format(
                    "photons: beam {}: towards ({:.6g}, {:.6g}, {:.6g}), irradiance {:.6g} W/m^2; "
                    "must be a direction, and >= 0",
                    k, beam.towards.x, beam.towards.y, beam.towards.z, beam.irradiance));
            if (!(beam.towards.z > 0) || beam.irradiance == 0) continue;
            irradiance += beam.irradiance;
            towards.push_back(beam.towards / size);
            upto.push_back(irradiance);
        }
        if (!(day.sky >= 0 && std::isfinite(day.sky)))
            throw InvalidInput(
                fmt::format("photons: sky = {:.6g} W/m^2, must be >= 0", day.sky));
    }
    Vec3d draw(double u) const
    {
        if (towards.size() == 1) return towards[0];
        const auto at = std::upper_bound(upto.begin(), upto.end() - 1, u * irradiance);
        return towards[static_cast<std::size_t>(at - upto.begin())];
    }
};

/// Enters along `direction` through the disc that covers the scene.
Emitted through_disc(const PhotonScene& scene, Vec3d direction, double u, double v)
{
    const double radius = scene.radius();
    const Frame frame(direction);
    const Turn turn(v);
    const double off = radius * std::sqrt(u);
    const Vec3d origin = scene.centre() - direction * (2 * radius) + frame.a * (off * turn.cosine) +
                         frame.b * (off * turn.sine);
    return {Vec3f(origin), Vec3f(direction), 0, Source::Sun};
}

}  // namespace

void validate(const PhotonParams& params)
{
    validate_described("photons", params);
}

void validate(const PhotonParams& params, double radius)
{
    validate(params);
    check_square(params, radius);
    const Square square = square_of(params, radius);
    if (params.sun_light != SunLight::Parallel && square.distance < 8 * radius) {
        const double r = radius / square.distance;
        log::warning(
            "photons: square_distance = {:.4g} m is less than 8 radii of the scene ({:.4g} m): its "
            "light grows by {:.0f} % from the scene's centre to its top",
            square.distance, radius, 100 * (1 / ((1 - r) * (1 - r)) - 1));
    }
}

Daylight::Beam fixed_sun(double open, double elevation)
{
    if (!(open >= 0 && std::isfinite(open)))
        throw InvalidParameter(
            fmt::format("photons: light on open ground = {:.6g} W/m^2, must be >= 0", open));
    if (!(elevation > 0 && elevation <= kPi / 2 * (1 + 1e-12)))
        throw InvalidParameter(
            fmt::format("photons: elevation of the fixed sun = {:.6g} deg, must be > 0 and <= 90",
                        elevation * 180 / kPi));
    const double sine = math::sin(elevation);
    return {{0, -math::cos(elevation), sine}, open / sine};
}

double square_exitance(double irradiance, double half, double distance)
{
    const double x = half / distance, slope = x / std::sqrt(1 + x * x);
    return irradiance / (4 / kPi * slope * math::atan2(slope, 1));
}

/// Land and moss apart: Embree keeps balls and triangles in different trees anyway, and the land's
/// then stays as it is.
struct PhotonScene::Rays {
    std::vector<Vec3f> vertices;
    std::vector<rays::TriangleScene::Triangle> triangles;
    std::unique_ptr<rays::TriangleScene> land;
    RTCDevice device = nullptr;
    RTCScene moss = nullptr;

    ~Rays()
    {
        if (moss) rtcReleaseScene(moss);
        if (device) rtcReleaseDevice(device);
    }
};

PhotonScene::PhotonScene(const TriMesh& land, std::span<const float> albedo, double moss_albedo,
                         double moss_height, const Progress& progress)
    : rays_(std::make_unique<Rays>()),
      albedo_(albedo.begin(), albedo.end()),
      moss_albedo_(moss_albedo)
{
    if (albedo.size() != land.triangles.size())
        throw InvalidInput(fmt::format("photons: {} albedos for {} triangles, must be as many",
                                       albedo.size(), land.triangles.size()));
    for (std::size_t i = 0; i < albedo.size(); ++i)
        if (!(albedo[i] >= 0 && albedo[i] <= kMostAlbedo))
            check_albedo(albedo[i], fmt::format("site {}", i).c_str());
    check_albedo(moss_albedo, "moss");
    if (!(moss_height >= 0 && std::isfinite(moss_height)))
        throw InvalidParameter(
            fmt::format("photons: height of moss = {:.6g} m, must be >= 0", moss_height));
    rays_->vertices = land.vertices;
    rays_->triangles = land.triangles;
    rays_->land = std::make_unique<rays::TriangleScene>(
        rays_->vertices, rays_->triangles, "photons", progress, RTC_BUILD_QUALITY_HIGH);
    for (const auto& t : land.triangles)
        for (const std::uint32_t v : t) bounds_.add(Vec3d(land.vertices[v]));
    bounds_.lower -= Vec3d(moss_height);
    bounds_.upper += Vec3d(moss_height);
    centre_ = bounds_.centre();
    radius_ = length(bounds_.size()) / 2;
    if (!(radius_ > 0)) throw InvalidInput("photons: the mesh is a single point");
    lift_ = kLift * radius_;
}
PhotonScene::~PhotonScene() = default;

void PhotonScene::set_moss(std::span<const Sphere> moss)
{
    for (std::size_t i = 0; i < moss.size(); ++i) {
        const auto& [c, r] = moss[i];
        if (!(std::isfinite(c.x + c.y + c.z) && r > 0 && std::isfinite(r)))
            throw InvalidInput(fmt::format(
                "photons: moss {}: centre ({}, {}, {}) m, radius {} m; must be finite, and > 0", i,
                c.x, c.y, c.z, r));
    }
    moss_.assign(moss.begin(), moss.end());
    if (rays_->moss) rtcReleaseScene(rays_->moss);
    rays_->moss = nullptr;
    if (moss.empty()) return;
    if (!rays_->device) rays_->device = rtcNewDevice(nullptr);
    if (!rays_->device) throw LimitExceeded("photons: Embree could not start");
    RTCGeometry geometry = rtcNewGeometry(rays_->device, RTC_GEOMETRY_TYPE_SPHERE_POINT);
    static_assert(sizeof(Sphere) == 16);
    void* balls = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4,
                                          sizeof(Sphere), moss.size());
    if (balls) {
        std::memcpy(balls, moss.data(), moss.size_bytes());
        rtcSetGeometryBuildQuality(geometry, RTC_BUILD_QUALITY_LOW);
        rtcCommitGeometry(geometry);
        rays_->moss = rtcNewScene(rays_->device);
        rtcSetSceneBuildQuality(rays_->moss, RTC_BUILD_QUALITY_LOW);
        rtcSetSceneFlags(rays_->moss, RTC_SCENE_FLAG_ROBUST);
        rtcAttachGeometry(rays_->moss, geometry);
        rtcCommitScene(rays_->moss);
    }
    rtcReleaseGeometry(geometry);
    if (!balls || rtcGetDeviceError(rays_->device) != RTC_ERROR_NONE)
        throw LimitExceeded(
            fmt::format("photons: no memory for the rays of {} mosses", moss.size()));
}

bool PhotonScene::intersect(Vec3f origin, Vec3f direction, Hit& hit, bool moss_too) const
{
    constexpr float kFar = INFINITY;
    const Vec3d o(origin), d(direction);
    rays::Hit on_land;
    const bool land = rays_->land->intersect(origin, direction, kNear, kFar, on_land);
    if (rays_->moss && moss_too) {
        const float most = land ? static_cast<float>(on_land.distance) : kFar;
        RTCRayHit query;
        if (rays::first_hit(rays_->moss, rays::ray_of(origin, direction, kNear, most), query)) {
            hit.target = query.hit.primID;
            hit.on_moss = true;
            const Vec3d c(moss_[hit.target].centre), off = o - c;
            const double r = static_cast<double>(moss_[hit.target].radius);
            // Roots of |o + t d - c| = r; Embree tells which of them.
            const double a = dot(d, d), half_b = dot(off, d);
            const double root =
                std::sqrt(std::max(0.0, half_b * half_b - a * (dot(off, off) - r * r)));
            const double in = (-half_b - root) / a, out = (-half_b + root) / a;
            const auto met = static_cast<double>(query.ray.tfar);
            hit.back = std::abs(out - met) < std::abs(in - met);
            hit.distance = hit.back ? out : in;
            hit.position = o + d * hit.distance;
            hit.normal = normalized(hit.position - c) * (hit.back ? -1.0 : 1.0);
            return true;
        }
    }
    if (!land) return false;
    hit.target = on_land.triangle;
    hit.on_moss = false;
    hit.distance = on_land.distance;
    hit.position = o + d * hit.distance;
    const auto& t = rays_->triangles[hit.target];
    const Vec3d a(rays_->vertices[t[0]]);
    const Vec3d n =
        normalized(cross(Vec3d(rays_->vertices[t[1]]) - a, Vec3d(rays_->vertices[t[2]]) - a));
    hit.back = dot(n, d) > 0;
    hit.normal = hit.back ? -n : n;
    return true;
}

bool PhotonScene::occluded(Vec3f origin, Vec3f direction, bool moss_too) const
{
    return rays_->land->occluded(origin, direction, kNear, INFINITY) ||
           (moss_too && rays_->moss &&
            rays::any_hit(rays_->moss, rays::ray_of(origin, direction, kNear, INFINITY)));
}

std::vector<Emitted> emit(const PhotonScene& scene, const Daylight& daylight,
                          const PhotonParams& params, std::uint64_t seed, std::uint64_t day,
                          std::uint64_t& tries)
{
    validate(params);
    const double radius = scene.radius();
    check_square(params, radius);
    const Sun sun(daylight);

    // Share photons by the power that enters the scene's ball.
    const double sun_power = sun.irradiance * kPi * radius * radius;
    const double sky_power = daylight.sky * 2 * kPi * radius * radius;
    std::int64_t suns = 0, skies = 0;
    if (sun_power > 0 && sky_power > 0) {
        const auto all = static_cast<double>(params.photons);
        suns =
            static_cast<std::int64_t>(std::floor(all * sun_power / (sun_power + sky_power) + 0.5));
        suns = std::clamp<std::int64_t>(suns, 1, std::max<std::int64_t>(1, params.photons - 1));
        skies = std::max<std::int64_t>(1, params.photons - suns);
    } else
        (sun_power > 0 ? suns : skies) = sun_power + sky_power > 0 ? params.photons : 0;
    const auto sun_count = static_cast<std::size_t>(suns),
               sky_count = static_cast<std::size_t>(skies);
    std::vector<Emitted> photons(sun_count + sky_count);
    const std::uint64_t key = seed_of_day(seed, day);

    // The sun, straight or from a lamp.
    const Square square = square_of(params, radius);
    const double lamp_power = sun_count == 0
                                  ? 0
                                  : square_exitance(sun.irradiance, square.half, square.distance) *
                                        4 * square.half * square.half;
    auto straight = [&](const Draws& draw) {
        Emitted photon =
            through_disc(scene, -cone_direction(sun.draw(draw(0)), kSunRadius, draw(1), draw(2)),
                         draw(3), draw(4));
        photon.flux = static_cast<float>(sun_power / static_cast<double>(suns));
        return photon;
    };
    auto on_lamp = [&](const Frame& frame, double u, double v) {
        return scene.centre() - frame.n * square.distance + frame.a * (square.half * (2 * u - 1)) +
               frame.b * (square.half * (2 * v - 1));
    };
    // Directions farther off the lamp's axis than this miss the scene from everywhere on it.
    const double corner = square.half * std::sqrt(2.0);
    const double widest =
        math::atan2(corner, square.distance) +
        math::atan2(radius,
                    std::sqrt(square.distance * square.distance -
                              std::min(radius * radius, 0.99 * square.distance * square.distance)));
    const double least_cosine = widest < kPi / 2 ? math::cos(widest) * (1 - 1e-9) : 0;
    auto from_lamp = [&](const Draws& draw, std::uint64_t& drawn) {
        // The place on the lamp is drawn again with the direction: kept, as in the source, it would
        // make places that see less of the scene send as much as others.
        for (std::uint64_t first = 0;; first += 5) {
            ++drawn;
            const double u = draw(first);
            if (u < least_cosine * least_cosine) continue;
            const Frame frame(-sun.draw(draw(first + 1)));
            const Vec3d origin = on_lamp(frame, draw(first + 3), draw(first + 4));
            const Vec3d direction = cosine_direction(frame, u, draw(first + 2));
            const Vec3d to_centre = scene.centre() - origin;
            const double along = dot(to_centre, direction);
            if (along > 0 && dot(to_centre, to_centre) - along * along <= radius * radius)
                return Emitted{Vec3f(origin), Vec3f(direction), 0, Source::Sun};
        }
    };
    auto into_cone = [&](const Draws& draw) {
        const Frame frame(-sun.draw(draw(0)));
        const Vec3d origin = on_lamp(frame, draw(1), draw(2));
        const Vec3d to_centre = scene.centre() - origin;
        const double d2 = dot(to_centre, to_centre), sine2 = radius * radius / d2;
        // 1 - cos without cancellation
        const double cap = sine2 / (1 + std::sqrt(1 - sine2));
        const Vec3d direction =
            cap_direction(Frame(to_centre / std::sqrt(d2)), cap, draw(3), draw(4));
        const double cosine = std::max(0.0, dot(direction, frame.n));
        const double flux = lamp_power * cosine * 2 * cap / static_cast<double>(suns);
        return Emitted{Vec3f(origin), Vec3f(direction), static_cast<float>(flux), Source::Sun};
    };
    tries = parallel_fold(
        sun_count, kChunk, std::uint64_t{0},
        [&](std::size_t begin, std::size_t end) {
            std::uint64_t drawn = 0;
            for (std::size_t i = begin; i < end; ++i) {
                const Draws draw(key, kSunPhoton, i);
                switch (params.sun_light) {
                    case SunLight::Parallel:
                        photons[i] = straight(draw);
                        ++drawn;
                        break;
                    case SunLight::Square:
                        photons[i] = from_lamp(draw, drawn);
                        break;
                    case SunLight::SquareCone:
                        photons[i] = into_cone(draw);
                        ++drawn;
                        break;
                }
            }
            return drawn;
        },
        [](std::uint64_t a, std::uint64_t b) { return a + b; });
    if (params.sun_light == SunLight::Square && sun_count > 0) {
        const auto flux = static_cast<float>(lamp_power / static_cast<double>(tries));
        parallel_for(
            sun_count, [&](std::size_t i) { photons[i].flux = flux; }, 16384);
    }

    // The sky: uniform over its half sphere.
    const auto sky_flux =
        static_cast<float>(sky_power / static_cast<double>(std::max<std::int64_t>(1, skies)));
    parallel_for(
        sky_count,
        [&](std::size_t i) {
            const Draws draw(key, kSkyPhoton, i);
            const Vec3d towards = cap_direction(Frame(Vec3d(0, 0, 1)), 1, draw(0), draw(1));
            Emitted& photon = photons[sun_count + i];
            photon = through_disc(scene, -towards, draw(2), draw(3));
            photon.flux = sky_flux;
            photon.source = Source::Sky;
        },
        kChunk);
    return photons;
}

Shot trace(const PhotonScene& scene, std::span<const Emitted> emitted, bool indirect,
           std::uint64_t seed, std::uint64_t day, const Progress& progress)
{
    const std::uint64_t key = seed_of_day(seed, day);
    const std::size_t chunks = (emitted.size() + kChunk - 1) / kChunk;
    std::vector<std::vector<Photon>> stored(chunks);
    std::vector<Ledger> ledgers(chunks);
    parallel_for(chunks, [&](std::size_t c) {
        progress.check();
        std::vector<Photon>& out = stored[c];
        out.reserve(kChunk);
        Ledger sum;
        for (std::size_t i = c * kChunk; i < std::min(emitted.size(), (c + 1) * kChunk); ++i) {
            const Draws draw(key, kBounce, i);
            const double flux = emitted[i].flux;
            Vec3f origin = emitted[i].origin, direction = emitted[i].direction;
            sum.emitted += flux;
            for (int bounce = 0;; ++bounce) {
                PhotonScene::Hit hit;
                if (!scene.intersect(origin, direction, hit)) {
                    (bounce == 0 ? sum.missed : sum.escaped) += flux;
                    break;
                }
                if (!std::isfinite(hit.position.x + hit.position.y + hit.position.z)) {
                    sum.lost += flux;
                    break;
                }
                out.push_back({Vec3f(hit.position), direction, Vec3f(hit.normal), emitted[i].flux,
                               hit.target, static_cast<std::uint8_t>(bounce), emitted[i].source,
                               static_cast<std::uint8_t>(hit.on_moss),
                               static_cast<std::uint8_t>(hit.back)});
                sum.stored += flux;
                const auto first = static_cast<std::uint64_t>(bounce) * 3;
                if (!(draw(first) < scene.albedo_of(hit.on_moss, hit.target))) {
                    sum.absorbed += flux;
                    break;
                }
                sum.reflected += flux;
                if (!indirect || bounce == kMostBounces) {
                    (indirect ? sum.lost : sum.escaped) += flux;
                    break;
                }
                origin = scene.off_surface(hit.position, hit.normal);
                direction =
                    Vec3f(cosine_direction(Frame(hit.normal), draw(first + 1), draw(first + 2)));
            }
        }
        sum.photons = std::min(emitted.size(), (c + 1) * kChunk) - c * kChunk;
        ledgers[c] = sum;
    });

    // Join the chunks in order.
    Shot shot;
    std::vector<std::size_t> counts(chunks);
    for (std::size_t c = 0; c < chunks; ++c) counts[c] = stored[c].size();
    const std::vector<std::size_t> offset = prefix_sum(counts);
    shot.photons.resize(offset.back());
    parallel_for(chunks, [&](std::size_t c) {
        std::ranges::copy(stored[c], shot.photons.begin() + static_cast<std::ptrdiff_t>(offset[c]));
        std::vector<Photon>().swap(stored[c]);
    });
    Ledger& all = shot.ledger;
    for (const Ledger& part : ledgers) {
        all.emitted += part.emitted;
        all.missed += part.missed;
        all.absorbed += part.absorbed;
        all.escaped += part.escaped;
        all.lost += part.lost;
        all.stored += part.stored;
        all.reflected += part.reflected;
        all.photons += part.photons;
    }
    return shot;
}

Shot shoot(const PhotonScene& scene, const Daylight& daylight, const PhotonParams& params,
           std::uint64_t seed, std::uint64_t day, const Progress& progress)
{
    std::uint64_t tries = 0;
    const std::vector<Emitted> emitted = emit(scene, daylight, params, seed, day, tries);
    Shot shot = trace(scene, emitted, params.indirect, seed, day, progress);
    shot.ledger.tries = tries;
    if (shot.ledger.lost > 1e-6 * shot.ledger.emitted)
        log::warning("photons: {:.3g} of {:.3g} W were lost on day {}", shot.ledger.lost,
                     shot.ledger.emitted, day);
    return shot;
}

}  // namespace sekitei::light
