#include "solvers/light/photons.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/clones.h"
#include "core/error.h"
#include "core/log.h"
#include "core/machine.h"
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
constexpr std::size_t kChunk = 1024, kWave = 32;
constexpr std::size_t kMapBytes = 60;  // a photon, most that PhotonMap holds while it is made

constexpr Stream kSunPhoton{"photons.sun"}, kSkyPhoton{"photons.sky"}, kBounce{"photons.bounce"};

/// The draws of all photons of a stream on a day: uniform01(hash2(seed, day), stream, photon, k),
/// with what they have in common worked out once.
class Draws {
public:
    Draws(std::uint64_t seed, std::uint64_t day, Stream stream)
        : base_(mix64(hash2(hash2(seed, day), stream.id)))
    {
    }
    class OfPhoton {
    public:
        explicit OfPhoton(std::uint64_t base) : base_(base) {}
        double operator()(std::uint64_t k) const
        {
            return static_cast<double>(mix64(base_ + k) >> 11) * 0x1p-53;
        }

    private:
        std::uint64_t base_;
    };
    OfPhoton operator[](std::uint64_t photon) const
    {
        return OfPhoton(mix64(mix64(base_ + photon)));
    }

private:
    std::uint64_t base_;
};

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
    if (params.sun_light == SunLight::Square && square_of(params, radius).half > 100 * radius)
        throw InvalidParameter(fmt::format(
            "photons: square_half = {:.6g} m, must be at most {:.6g} m, 100 radii of the scene, "
            "beyond which hardly a direction finds it; sun_light = square_cone has no such limit",
            square_of(params, radius).half, 100 * radius));
    if (params.sun_light == SunLight::Square && distance > 100 * radius)
        throw InvalidParameter(fmt::format(
            "photons: square_distance = {:.6g} m, must be <= {:.6g} m, a hundred radii of the "
            "scene, "
            "beyond which hardly a direction finds it; sun_light = square_cone has no such limit",
            distance, 100 * radius));
}

/// Beams above the horizon, as a table to draw from.
struct Sun {
    std::vector<Frame> towards;
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
            towards.emplace_back(beam.towards / size);
            upto.push_back(irradiance);
        }
        if (!(day.sky >= 0 && std::isfinite(day.sky)))
            throw InvalidInput(fmt::format("photons: sky = {:.6g} W/m^2, must be >= 0", day.sky));
    }
    const Frame& draw(double u) const
    {
        if (towards.size() == 1) return towards[0];
        const auto at = std::upper_bound(upto.begin(), upto.end() - 1, u * irradiance);
        return towards[static_cast<std::size_t>(at - upto.begin())];
    }
};

/// Rays of a source far away, many side by side: what they start from, and they themselves.
struct FarRays {
    static constexpr std::size_t kMost = 128;
    template <class T>
    using Row = std::array<T, kMost>;
    Row<double> x, y, z;         ///< towards the middle of the source
    Row<double> u, v;            ///< where in the source
    Row<double> across, around;  ///< where on the disc that covers the scene
    Row<float> origin_x, origin_y, origin_z, direction_x, direction_y, direction_z;
};

/// Enters through the disc that covers the scene, along a direction out of the source's cap.
SEKITEI_CLONES
void enter_through_disc(FarRays& rays, double cap, Vec3d centre, double radius)
{
    for (std::size_t i = 0; i < FarRays::kMost; ++i) {
        const Vec3d direction = -cap_direction(Frame(Vec3d(rays.x[i], rays.y[i], rays.z[i])), cap,
                                               rays.u[i], rays.v[i]);
        const Frame frame(direction);
        const Turn turn(rays.around[i]);
        const double off = radius * std::sqrt(rays.across[i]);
        const Vec3d origin = centre - direction * (2 * radius) + frame.a * (off * turn.cosine) +
                             frame.b * (off * turn.sine);
        rays.origin_x[i] = static_cast<float>(origin.x);
        rays.origin_y[i] = static_cast<float>(origin.y);
        rays.origin_z[i] = static_cast<float>(origin.z);
        rays.direction_x[i] = static_cast<float>(direction.x);
        rays.direction_y[i] = static_cast<float>(direction.y);
        rays.direction_z[i] = static_cast<float>(direction.z);
    }
}

/// Makes the photons of a day.
class Emitter {
public:
    Emitter(const PhotonScene& scene, const Daylight& day, const PhotonParams& params,
            std::uint64_t seed, std::uint64_t number_of_day)
        : sun_(day),
          kind_(params.sun_light),
          centre_(scene.centre()),
          radius_(scene.radius()),
          square_(square_of(params, scene.radius())),
          sun_draws_(seed, number_of_day, kSunPhoton),
          sky_draws_(seed, number_of_day, kSkyPhoton)
    {
        validate(params);
        check_square(params, radius_);
        // Share photons by the power that enters the scene's ball.
        const double disc = kPi * radius_ * radius_;
        const double sun_power = sun_.irradiance * disc, sky_power = 2 * day.sky * disc;
        const auto all = static_cast<std::uint64_t>(params.photons);
        if (sun_power > 0 && sky_power > 0) {
            const double share = sun_power / (sun_power + sky_power);
            suns_ = static_cast<std::uint64_t>(static_cast<double>(all) * share + 0.5);
            suns_ = std::clamp<std::uint64_t>(suns_, 1, std::max<std::uint64_t>(1, all - 1));
            skies_ = std::max<std::uint64_t>(1, all - suns_);
        } else if (sun_power + sky_power > 0)
            (sun_power > 0 ? suns_ : skies_) = all;
        if (skies_ > 0) sky_flux_ = static_cast<float>(sky_power / static_cast<double>(skies_));
        if (suns_ == 0) return;
        sun_flux_ = static_cast<float>(sun_power / static_cast<double>(suns_));
        lamp_power_ = square_exitance(sun_.irradiance, square_.half, square_.distance) * 4 *
                      square_.half * square_.half;
        // Directions farther off the lamp's axis than this miss the scene from all over the lamp.
        const double d2 = square_.distance * square_.distance, r2 = radius_ * radius_;
        if (kind_ == SunLight::Parallel || !(d2 > r2)) return;
        const double widest = math::atan2(square_.half * std::sqrt(2.0), square_.distance) +
                              math::atan2(radius_, std::sqrt(d2 - r2));
        const double cosine = widest < kPi / 2 ? math::cos(widest) * (1 - 1e-9) : 0;
        least_u_ = cosine * cosine;
    }

    std::uint64_t suns() const { return suns_; }
    std::uint64_t count() const { return suns_ + skies_; }
    /// The flux of photons of a lamp whose directions were drawn so often.
    float lamp_flux(std::uint64_t tries) const
    {
        return static_cast<float>(lamp_power_ / static_cast<double>(tries));
    }
    /// Photons begin .. end, those of the sun first; counts directions drawn. Photons of a square
    /// lamp have no flux yet.
    void operator()(std::size_t begin, std::size_t end, Emitted* out, std::uint64_t& tries) const
    {
        FarRays rays{};
        while (begin < end) {
            if (begin < suns_ && kind_ != SunLight::Parallel) {
                *out++ = kind_ == SunLight::Square ? from_lamp(sun_draws_[begin], tries)
                                                   : aimed(sun_draws_[begin]);
                if (kind_ == SunLight::SquareCone) ++tries;
                ++begin;
                continue;
            }
            const bool sun = begin < suns_;
            const std::size_t count =
                std::min(FarRays::kMost, (sun ? std::min<std::size_t>(end, suns_) : end) - begin);
            for (std::size_t i = 0; i < count; ++i) {
                const auto draw = sun ? sun_draws_[begin + i] : sky_draws_[begin + i - suns_];
                const Vec3d n = sun ? sun_.draw(draw(0)).n : Vec3d(0, 0, 1);
                rays.x[i] = n.x, rays.y[i] = n.y, rays.z[i] = n.z;
                rays.u[i] = draw(sun), rays.v[i] = draw(sun + 1u);
                rays.across[i] = draw(sun + 2u), rays.around[i] = draw(sun + 3u);
            }
            static const double sun_cap = cap_of_cone(kSunRadius);
            enter_through_disc(rays, sun ? sun_cap : 1, centre_, radius_);
            for (std::size_t i = 0; i < count; ++i)
                *out++ = {{rays.origin_x[i], rays.origin_y[i], rays.origin_z[i]},
                          {rays.direction_x[i], rays.direction_y[i], rays.direction_z[i]},
                          sun ? sun_flux_ : sky_flux_,
                          sun ? Source::Sun : Source::Sky};
            if (sun) tries += count;
            begin += count;
        }
    }

private:
    Vec3d on_lamp(const Frame& frame, double u, double v) const
    {
        return centre_ - frame.n * square_.distance + frame.a * (square_.half * (2 * u - 1)) +
               frame.b * (square_.half * (2 * v - 1));
    }
    Emitted from_lamp(const Draws::OfPhoton& draw, std::uint64_t& tries) const
    {
        // The place on the lamp is drawn again with the direction: kept, as in the source, it would
        // make places that see less of the scene send as much as others.
        for (std::uint64_t k = 0;; k += 5) {
            ++tries;
            const double u = draw(k);
            if (u < least_u_) continue;
            const Frame frame(-sun_.draw(draw(k + 1)).n);
            const Vec3d origin = on_lamp(frame, draw(k + 3), draw(k + 4));
            const Vec3d direction = cosine_direction(frame, u, draw(k + 2));
            const Vec3d to_centre = centre_ - origin;
            const double along = dot(to_centre, direction);
            if (along > 0 && dot(to_centre, to_centre) - along * along <= radius_ * radius_)
                return {Vec3f(origin), Vec3f(direction), 0, Source::Sun};
        }
    }
    Emitted aimed(const Draws::OfPhoton& draw) const
    {
        const Frame frame(-sun_.draw(draw(0)).n);
        const Vec3d origin = on_lamp(frame, draw(1), draw(2));
        const Vec3d to_centre = centre_ - origin;
        const double d2 = dot(to_centre, to_centre), sine2 = radius_ * radius_ / d2;
        const double cap = sine2 / (1 + std::sqrt(1 - sine2));  // 1 - cos, without cancellation
        const Vec3d direction =
            cap_direction(Frame(to_centre / std::sqrt(d2)), cap, draw(3), draw(4));
        const double cosine = std::max(0.0, dot(direction, frame.n));
        const double flux = lamp_power_ * cosine * 2 * cap / static_cast<double>(suns_);
        return {Vec3f(origin), Vec3f(direction), static_cast<float>(flux), Source::Sun};
    }

    Sun sun_;
    SunLight kind_;
    Vec3d centre_;
    double radius_;
    Square square_;
    Draws sun_draws_, sky_draws_;
    std::uint64_t suns_ = 0, skies_ = 0;
    float sun_flux_ = 0, sky_flux_ = 0;
    double lamp_power_ = 0, least_u_ = 0;
};

/// Whether the line of a ray passes through a box: seen along each axis [Ericson2005, 5.3.3].
bool may_meet(Vec3d centre, Vec3d half, Vec3f origin, Vec3f direction)
{
    const Vec3d d(direction), across = cross(Vec3d(origin) - centre, d);
    const double x = std::abs(d.x), y = std::abs(d.y), z = std::abs(d.z);
    return std::abs(across.x) <= half.y * z + half.z * y &&
           std::abs(across.y) <= half.z * x + half.x * z &&
           std::abs(across.z) <= half.x * y + half.y * x;
}

void add(Ledger& all, const Ledger& part)
{
    all.emitted += part.emitted;
    all.missed += part.missed;
    all.absorbed += part.absorbed;
    all.escaped += part.escaped;
    all.lost += part.lost;
    all.stored += part.stored;
    all.reflected += part.reflected;
    all.photons += part.photons;
    all.tries += part.tries;
}

/// Photons of one chunk on their way, all by one bounce at a time: rays are asked for together.
class Chunk {
public:
    /// Makes photons begin .. end with source(begin, end, out, tries) and follows them.
    template <class Sourced, class MayMeet>
    void run(const PhotonScene& scene, std::size_t begin, std::size_t end, const Sourced& source,
             const MayMeet& may_meet, bool indirect, const Draws& draws)
    {
        ledger_ = {};
        found_.clear();
        path_.clear();
        const std::size_t count = end - begin;
        // Made side by side first: they do not wait for one another.
        source(begin, end, photons_.data(), ledger_.tries);
        std::size_t alive = 0;
        for (std::size_t i = 0; i < count; ++i) {
            const Emitted& photon = photons_[i];
            stored_[i] = 0;
            end_[i] = End::Missed;
            rays_[alive] = {photon.origin, photon.direction};
            who_[alive] = static_cast<std::uint16_t>(i);
            alive += may_meet(photon);
        }
        for (int bounce = 0; alive > 0; ++bounce) {
            scene.intersect({rays_.data(), alive}, hits_);
            std::size_t left = 0;
            for (std::size_t k = 0; k < alive; ++k) {
                const std::uint16_t who = who_[k];
                const bool goes_on = arrive(scene, who, rays_[k].direction, hits_[k], bounce,
                                            indirect, draws[begin + who], rays_[left]);
                who_[left] = who;
                left += goes_on;
            }
            alive = left;
        }
        account(count);
    }
    std::size_t size() const { return found_.size(); }
    const Ledger& ledger() const { return ledger_; }
    /// Copies what was stored, by path, then by bounce.
    void copy_to(Photon* out)
    {
        for (std::size_t k = 0; k < found_.size(); ++k) out[place_[path_[k]]++] = found_[k];
    }

private:
    enum class End : std::uint8_t { Missed, Absorbed, Escaped, Lost };

    /// Stores a hit; whether the photon goes on, along `next`.
    bool arrive(const PhotonScene& scene, std::uint16_t who, Vec3f direction,
                const PhotonScene::Hit& hit, int bounce, bool indirect, const Draws::OfPhoton& draw,
                PhotonScene::Ray& next)
    {
        if (hit.distance == INFINITY) {
            if (bounce > 0) end_[who] = End::Escaped;
            return false;
        }
        // Rays along a surface may meet it nowhere, or far away.
        const Vec3d off = hit.position - scene.centre();
        if (!(dot(off, off) <= 4 * scene.radius() * scene.radius())) {
            end_[who] = End::Lost;
            return false;
        }
        const Emitted& photon = photons_[who];
        found_.push_back({Vec3f(hit.position), direction, Vec3f(hit.normal), photon.flux,
                          hit.target, static_cast<std::uint8_t>(bounce), photon.source,
                          static_cast<std::uint8_t>(hit.on_moss),
                          static_cast<std::uint8_t>(hit.back)});
        path_.push_back(who);
        ++stored_[who];
        const auto first = static_cast<std::uint64_t>(bounce) * 3;
        if (!(draw(first) < scene.albedo_of(hit.on_moss, hit.target))) {
            end_[who] = End::Absorbed;
            return false;
        }
        if (!indirect || bounce == kMostBounces) {
            end_[who] = indirect ? End::Lost : End::Escaped;
            return false;
        }
        next = {scene.off_surface(hit.position, hit.normal),
                Vec3f(cosine_direction(Frame(hit.normal), draw(first + 1), draw(first + 2)))};
        return true;
    }

    /// Sums by path, in order.
    void account(std::size_t count)
    {
        std::uint32_t place = 0;
        for (std::size_t i = 0; i < count; ++i) {
            place_[i] = place;
            place += stored_[i];
            const double flux = photons_[i].flux;
            ledger_.emitted += flux;
            for (int k = 0; k < stored_[i]; ++k) ledger_.stored += flux;
            for (int k = end_[i] == End::Absorbed; k < stored_[i]; ++k) ledger_.reflected += flux;
            (end_[i] == End::Missed     ? ledger_.missed
             : end_[i] == End::Absorbed ? ledger_.absorbed
             : end_[i] == End::Escaped  ? ledger_.escaped
                                        : ledger_.lost) += flux;
        }
        ledger_.photons += count;
    }

    std::array<Emitted, kChunk> photons_;
    std::array<PhotonScene::Ray, kChunk> rays_;
    std::array<PhotonScene::Hit, kChunk> hits_;
    std::array<std::uint16_t, kChunk> who_;  // number in the chunk of a ray's photon
    std::array<std::uint8_t, kChunk> stored_;
    std::array<End, kChunk> end_;
    std::array<std::uint32_t, kChunk> place_;
    std::vector<Photon> found_;
    std::vector<std::uint16_t> path_;  // of what was found
    Ledger ledger_;
};

/// Refuses what this machine could not hold, rather than be killed half way.
void check_memory(double photons, const std::string& what, double bytes)
{
    const double there = physical_memory();
    if (bytes > there)
        throw LimitExceeded(fmt::format(
            "photons: photons = {:.6g} {}, which needs about {} of memory; this machine has {}. "
            "Send fewer.",
            photons, what, bytes_text(bytes), bytes_text(there)));
}

/// Follows `count` photons; source(begin, end, out, tries) makes them.
template <class Sourced>
Shot follow_all(const PhotonScene& scene, std::size_t count, const Sourced& source, bool indirect,
                std::uint64_t seed, std::uint64_t day, const Progress& progress)
{
    const Draws draws(seed, day, kBounce);
    Shot shot;
    // Balls of moss may stand out of the land's box.
    Bounds box = scene.bounds();
    for (const auto& [c, r] : scene.moss()) {
        box.add(Vec3d(c) - Vec3d(r));
        box.add(Vec3d(c) + Vec3d(r));
    }
    const Vec3d middle = box.centre(), half = box.size() / 2.0 + Vec3d(1e-5 * scene.radius());
    auto meets = [&](const Emitted& e) { return may_meet(middle, half, e.origin, e.direction); };
    // Chunks take turns in few buffers, which stay in cache; they are joined in order.
    const std::size_t chunks = (count + kChunk - 1) / kChunk;
    std::vector<Chunk> buffers(std::min(kWave, chunks));
    for (std::size_t first = 0; first < chunks; first += kWave) {
        const std::size_t wave = std::min(kWave, chunks - first);
        parallel_for(wave, [&](std::size_t w) {
            progress.check();
            const std::size_t begin = (first + w) * kChunk, end = std::min(count, begin + kChunk);
            buffers[w].run(scene, begin, end, source, meets, indirect, draws);
        });
        std::array<std::size_t, kWave + 1> start{shot.photons.size()};
        for (std::size_t w = 0; w < wave; ++w) {
            start[w + 1] = start[w] + buffers[w].size();
            add(shot.ledger, buffers[w].ledger());
        }
        if (start[wave] > shot.photons.capacity()) {
            // As many again from the chunks to come as from those until now, and a little more.
            const std::size_t done = first + wave;
            const double all =
                static_cast<double>(start[wave]) *
                (1 + 17.0 / 16 * static_cast<double>(chunks - done) / static_cast<double>(done));
            check_memory(static_cast<double>(count),
                         fmt::format("leave {} stored", count_text(all)),
                         all * static_cast<double>(sizeof(Photon) + kMapBytes));
            shot.photons.reserve(static_cast<std::size_t>(all));
        }
        shot.photons.resize(start[wave]);
        parallel_for(
            wave, [&](std::size_t w) { buffers[w].copy_to(shot.photons.data() + start[w]); }, 8);
    }
    return shot;
}

std::vector<Emitted> emit_all(const Emitter& emitter, std::uint64_t& tries,
                              const Progress& progress)
{
    const auto count = static_cast<double>(emitter.count());
    check_memory(count, "are kept until all are drawn", count * sizeof(Emitted));
    std::vector<Emitted> photons(emitter.count());
    // Few at a time: a large lamp draws thousands of directions for each.
    tries = parallel_fold(
        photons.size(), kChunk / 16, std::uint64_t{0},
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            std::uint64_t drawn = 0;
            emitter(begin, end, &photons[begin], drawn);
            return drawn;
        },
        [](std::uint64_t a, std::uint64_t b) { return a + b; });
    return photons;
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
    /// Of each triangle: where it lies, normal . (x - centre) = offset. One look at 16 bytes
    /// instead of four at more; as exact as the positions that come of it.
    struct Plane {
        Vec3f normal;
        float offset;
    };
    std::vector<Plane> planes;
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
    for (const auto& t : land.triangles) {
        const Vec3d a(land.vertices[t[0]]), b(land.vertices[t[1]]), c(land.vertices[t[2]]);
        for (const Vec3d corner : {a, b, c}) bounds_.add(corner);
    }
    bounds_.lower -= Vec3d(moss_height);
    bounds_.upper += Vec3d(moss_height);
    centre_ = bounds_.centre();
    radius_ = length(bounds_.size()) / 2;
    if (!(radius_ > 0)) throw InvalidInput("photons: the mesh is a single point");
    lift_ = kLift * radius_;
    rays_->planes.resize(land.triangles.size());
    for (std::size_t i = 0; i < land.triangles.size(); ++i) {
        const auto& t = land.triangles[i];
        const Vec3d a(land.vertices[t[0]]), b(land.vertices[t[1]]), c(land.vertices[t[2]]);
        const Vec3d n = normalized(cross(b - a, c - a));
        rays_->planes[i] = {Vec3f(n), static_cast<float>(dot(n, (a + b + c) / 3.0 - centre_))};
    }
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

/// Where a ray meets the plane of a triangle.
void PhotonScene::land_hit(Vec3f origin, Vec3f direction, std::uint32_t triangle, Hit& hit) const
{
    const Vec3d o(origin), d(direction);
    const Rays::Plane& plane = rays_->planes[triangle];
    const Vec3d n(plane.normal);
    const double towards = dot(n, d);
    hit.target = triangle;
    hit.on_moss = false;
    hit.back = towards > 0;
    hit.normal = hit.back ? -n : n;
    hit.distance = (static_cast<double>(plane.offset) - dot(n, o - centre_)) / towards;
    hit.position = o + d * hit.distance;
}

/// Where a ray meets a ball: at the root of |o + t d - c| = r next to `met`.
void PhotonScene::moss_hit(Vec3f origin, Vec3f direction, std::uint32_t plant, float met,
                           Hit& hit) const
{
    const Vec3d o(origin), d(direction);
    const Vec3d c(moss_[plant].centre), off = o - c;
    const auto r = static_cast<double>(moss_[plant].radius);
    const double a = dot(d, d), half_b = dot(off, d);
    const double root = std::sqrt(std::max(0.0, half_b * half_b - a * (dot(off, off) - r * r)));
    const double in = (-half_b - root) / a, out = (-half_b + root) / a;
    const auto near = static_cast<double>(met);
    hit.target = plant;
    hit.on_moss = true;
    hit.back = std::abs(out - near) < std::abs(in - near);
    hit.distance = hit.back ? out : in;
    hit.position = o + d * hit.distance;
    hit.normal = normalized(hit.position - c) * (hit.back ? -1.0 : 1.0);
}

bool PhotonScene::intersect(Vec3f origin, Vec3f direction, Hit& hit, bool moss_too) const
{
    constexpr float kFar = INFINITY;
    std::uint32_t triangle = 0;
    const bool land = rays_->land->intersect(origin, direction, kNear, kFar, triangle);
    if (land) land_hit(origin, direction, triangle, hit);
    if (!rays_->moss || !moss_too) return land;
    const float most = land ? static_cast<float>(hit.distance) : kFar;
    RTCRayHit query;
    if (!rays::first_hit(rays_->moss, rays::ray_of(origin, direction, kNear, most), query))
        return land;
    moss_hit(origin, direction, query.hit.primID, query.ray.tfar, hit);
    return true;
}

void PhotonScene::intersect(std::span<const Ray> rays, std::span<Hit> hits) const
{
    constexpr std::size_t kLanes = 8;
    for (std::size_t first = 0; first < rays.size(); first += kLanes) {
        const std::size_t lanes = std::min(kLanes, rays.size() - first);
        alignas(32) std::array<int, kLanes> valid{};
        RTCRayHit8 query;
        auto load = [&](std::size_t k, float far) {
            const Ray& ray = rays[first + k];
            query.ray.org_x[k] = ray.origin.x;
            query.ray.org_y[k] = ray.origin.y;
            query.ray.org_z[k] = ray.origin.z;
            query.ray.dir_x[k] = ray.direction.x;
            query.ray.dir_y[k] = ray.direction.y;
            query.ray.dir_z[k] = ray.direction.z;
            query.ray.tnear[k] = kNear;
            query.ray.tfar[k] = far;
            query.ray.time[k] = 0;
            query.ray.mask[k] = 0xFFFFFFFFu;
            query.ray.id[k] = 0;
            query.ray.flags[k] = 0;
            query.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
            query.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
        };
        for (std::size_t k = 0; k < lanes; ++k) {
            load(k, INFINITY);
            valid[k] = -1;
        }
        rays_->land->intersect(valid.data(), query);
        for (std::size_t k = 0; k < lanes; ++k) {
            const auto& [origin, direction] = rays[first + k];
            if (query.hit.geomID[k] == RTC_INVALID_GEOMETRY_ID)
                hits[first + k].distance = INFINITY;
            else
                land_hit(origin, direction, query.hit.primID[k], hits[first + k]);
        }
        if (!rays_->moss) continue;
        for (std::size_t k = 0; k < lanes; ++k)
            load(k, static_cast<float>(hits[first + k].distance));
        rays::first_hits(rays_->moss, valid.data(), query);
        for (std::size_t k = 0; k < lanes; ++k) {
            const auto& [origin, direction] = rays[first + k];
            if (query.hit.geomID[k] != RTC_INVALID_GEOMETRY_ID)
                moss_hit(origin, direction, query.hit.primID[k], query.ray.tfar[k],
                         hits[first + k]);
        }
    }
}

bool PhotonScene::occluded(Vec3f origin, Vec3f direction, bool moss_too) const
{
    return rays_->land->occluded(origin, direction, kNear, INFINITY) ||
           (moss_too && rays_->moss &&
            rays::any_hit(rays_->moss, rays::ray_of(origin, direction, kNear, INFINITY)));
}

std::vector<Emitted> emit(const PhotonScene& scene, const Daylight& daylight,
                          const PhotonParams& params, std::uint64_t seed, std::uint64_t day,
                          std::uint64_t& tries, const Progress& progress)
{
    const Emitter emitter(scene, daylight, params, seed, day);
    std::vector<Emitted> photons = emit_all(emitter, tries, progress);
    if (params.sun_light == SunLight::Square && emitter.suns() > 0) {
        // How bright a lamp's photons are is known when all of its directions are drawn.
        const float flux = emitter.lamp_flux(tries);
        parallel_for(
            emitter.suns(), [&](std::size_t i) { photons[i].flux = flux; }, 16384);
    }
    return photons;
}

Shot trace(const PhotonScene& scene, std::span<const Emitted> emitted, bool indirect,
           std::uint64_t seed, std::uint64_t day, const Progress& progress)
{
    auto source = [&](std::size_t begin, std::size_t end, Emitted* out, std::uint64_t&) {
        std::copy(emitted.begin() + static_cast<std::ptrdiff_t>(begin),
                  emitted.begin() + static_cast<std::ptrdiff_t>(end), out);
    };
    return follow_all(scene, emitted.size(), source, indirect, seed, day, progress);
}

Shot shoot(const PhotonScene& scene, const Daylight& daylight, const PhotonParams& params,
           std::uint64_t seed, std::uint64_t day, const Progress& progress)
{
    Shot shot;
    if (params.sun_light == SunLight::Square) {
        std::uint64_t tries = 0;
        const std::vector<Emitted> emitted =
            emit(scene, daylight, params, seed, day, tries, progress);
        shot = trace(scene, emitted, params.indirect, seed, day, progress);
        shot.ledger.tries = tries;
    } else {
        const Emitter emitter(scene, daylight, params, seed, day);
        shot = follow_all(scene, emitter.count(), emitter, params.indirect, seed, day, progress);
    }
    if (shot.ledger.lost > 1e-6 * shot.ledger.emitted)
        log::warning("photons: {:.3g} of {:.3g} W were lost on day {}", shot.ledger.lost,
                     shot.ledger.emitted, day);
    return shot;
}

}  // namespace sekitei::light
