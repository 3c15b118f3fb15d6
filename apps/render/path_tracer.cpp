#include "apps/render/path_tracer.h"

#include <algorithm>
#include <cmath>

#include "apps/render/fast_math.h"
#include "apps/render/sampler.h"
#include "apps/render/tufts.h"
#include "apps/render/woods.h"
#include "core/math.h"
#include "core/parallel.h"
#include "solvers/rays/embree.h"

namespace sekitei::render {
namespace {

constexpr float kPi = 3.14159265f;
constexpr int kTile = 16;

float luminance(Vec3f c)
{
    return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z;
}
Vec3f times(Vec3f a, Vec3f b)
{
    return {a.x * b.x, a.y * b.y, a.z * b.z};
}

/// Two directions that complete n to a frame [Duff2017].
struct Frame {
    Vec3f x, y, n;
    explicit Frame(Vec3f normal) : n(normal)
    {
        const float sign = n.z >= 0 ? 1.0f : -1.0f, a = -1 / (sign + n.z), b = n.x * n.y * a;
        x = Vec3f(1 + sign * n.x * n.x * a, sign * b, -sign * n.x);
        y = Vec3f(b, sign + n.y * n.y * a, -n.y);
    }
    Vec3f world(Vec3f v) const { return x * v.x + y * v.y + n * v.z; }
    Vec3f local(Vec3f v) const { return {dot(v, x), dot(v, y), dot(v, n)}; }
};

/// Matt and rough-shining reflection in the frame of the shading normal.
class Scatter {
public:
    Scatter(const Material& m, Vec3f wo)
        : albedo_(m.albedo), wo_(wo), specular_(m.specular), alpha_(m.roughness * m.roughness)
    {
        fresnel_o_ = fresnel(wo.z);
        const float matt = luminance(albedo_) * (1 - fresnel_o_);
        chance_ = specular_ > 0 ? std::clamp(fresnel_o_ / (fresnel_o_ + matt), 0.1f, 0.9f) : 0;
    }

    /// Reflection times cosine, and the density of sample() there.
    Vec3f evaluate(Vec3f wi, float& density) const
    {
        density = 0;
        if (wi.z <= 0) return {};
        density = (1 - chance_) * wi.z / kPi;
        Vec3f f = albedo_ * ((1 - fresnel_o_) * (1 - fresnel(wi.z)) / kPi);
        if (specular_ > 0) {
            const Vec3f h = normalized(wo_ + wi);
            const float d = distribution(h), g1 = masking(wo_), g = g1 * masking(wi);
            f += Vec3f(fresnel(dot(h, wi)) * d * g / (4 * wo_.z * wi.z));
            density += chance_ * g1 * d / (4 * wo_.z);
        }
        return f * wi.z;
    }

    Vec3f sample(float choice, std::array<float, 2> u) const
    {
        const SinCos turn = sincos_turn(u[1]);
        if (choice >= chance_) {
            const float r = std::sqrt(u[0]);
            return {r * turn.cosine, r * turn.sine, std::sqrt(std::max(0.0f, 1 - u[0]))};
        }
        // A normal among those visible from wo, then mirror there [Heitz2018].
        const Vec3f stretched = normalized(Vec3f(alpha_ * wo_.x, alpha_ * wo_.y, wo_.z));
        const float r = std::sqrt(u[0]), t1 = r * turn.cosine, s = 0.5f * (1 + stretched.z);
        // The half disc is cut along a level direction.
        const Vec3f level{-stretched.y, stretched.x, 0};
        const Vec3f tx = dot(level, level) > 1e-12f ? normalized(level) : Vec3f(1, 0, 0);
        const Vec3f ty = cross(stretched, tx);
        const float t2 = (1 - s) * std::sqrt(std::max(0.0f, 1 - t1 * t1)) + s * r * turn.sine;
        const Vec3f n =
            tx * t1 + ty * t2 + stretched * std::sqrt(std::max(0.0f, 1 - t1 * t1 - t2 * t2));
        const Vec3f h = normalized(Vec3f(alpha_ * n.x, alpha_ * n.y, std::max(1e-6f, n.z)));
        return h * (2 * dot(wo_, h)) - wo_;
    }

private:
    float fresnel(float cosine) const
    {
        if (specular_ <= 0) return 0;
        const float c = 1 - std::clamp(cosine, 0.0f, 1.0f), c2 = c * c;
        return specular_ * (0.04f + 0.96f * c2 * c2 * c * (1 - 0.8f * alpha_));
    }
    float distribution(Vec3f h) const
    {
        const float a2 = alpha_ * alpha_, d = h.z * h.z * (a2 - 1) + 1;
        return a2 / (kPi * d * d);
    }
    float masking(Vec3f w) const
    {
        const float a2 = alpha_ * alpha_, c2 = w.z * w.z;
        return 2 * w.z / (w.z + std::sqrt(a2 + (1 - a2) * c2));
    }

    Vec3f albedo_, wo_;
    float specular_, alpha_, fresnel_o_ = 0, chance_ = 0;
};

struct Sample {
    Vec3f radiance, albedo{1.0f}, normal;
    float depth = 0;
};

class Tracer {
public:
    Tracer(const World& world, const TraceParams& params, std::uint64_t seed)
        : world_(world),
          params_(params),
          rays_(world.rays),
          key_(hash2(seed, Stream("render.paths").id))
    {
        Bounds bounds;
        for (const Vec3f& v : world.mesh.vertices) bounds.add(Vec3d(v));
        const Vec3d most = max(bounds.upper, -bounds.lower);
        nudge_ = static_cast<float>(1e-5 * length(bounds.size()) +
                                    2e-6 * std::max({most.x, most.y, most.z}));
        far_ = static_cast<float>(
            1e3 * (length(bounds.size()) + length(world.camera.eye - bounds.centre())));
        pixel_angle_ = static_cast<float>(2 * world.camera.tan_y / params.height);
        limit_ = static_cast<float>(params.clamp) * world.sky.white();
    }

    Sample path(int x, int y, std::uint32_t sample, std::uint64_t& rays) const
    {
        Sampler numbers(hash2(key_, std::uint64_t(y) * 65536 + std::uint64_t(x)), sample);
        // A tent filter of two pixels' width, by sampling it.
        const auto jitter = numbers.next2();
        const double px = (x + 0.5 + tent(jitter[0])) / params_.width * 2 - 1;
        const double py = 1 - (y + 0.5 + tent(jitter[1])) / params_.height * 2;
        Vec3f direction = world_.camera.direction(px, py);
        Vec3f origin(world_.camera.eye);
        const Vec3f first_direction = direction;

        Sample out;
        Vec3f through(1.0f);
        float density = 0;
        for (int depth = 0;; ++depth) {
            SurfacePoint point;
            Vec3f geometric;
            float distance = 0;
            bool on_ground = false;
            std::optional<TuftHit> tuft;
            std::optional<WoodHit> tree;
            const bool met =
                nearest(origin, direction, point, geometric, distance, on_ground, tuft, tree);
            ++rays;
            if (!met) {
                if (depth == 0) {
                    out.radiance = seen_sky(direction);
                    return out;
                }
                const float other = world_.sky.density(direction);
                const float weight = density * density / (density * density + other * other);
                add(out.radiance, times(through, world_.sky.radiance(direction)) * weight, depth);
                break;
            }
            const Vec3f wo = -direction;
            point.seen = depth == 0;
            point.footprint =
                depth == 0 ? distance * pixel_angle_ / std::max(0.15f, std::abs(dot(geometric, wo)))
                           : 0;
            Material material = tree        ? world_.woods->material(*tree, point)
                                : tuft      ? world_.tufts->material(*tuft, point)
                                : on_ground ? world_.look.ground(point)
                                            : world_.look.surface(point);
            // Relief and smoothing may turn a normal away from the viewer: bend it back.
            const float facing = dot(material.normal, wo);
            if (facing < 0.03f)
                material.normal = normalized(material.normal + wo * (0.03f - facing));
            const Frame frame(material.normal);
            const Vec3f local_out = frame.local(wo);
            const Scatter scatter(material,
                                  {local_out.x, local_out.y, std::max(0.01f, local_out.z)});
            if (depth == 0) {
                out.radiance = material.glow;
                out.albedo = material.albedo + material.glow;
                out.normal = material.normal;
                out.depth = distance;
            }
            const Vec3f start = point.position + geometric * nudge_;
            const Vec3f behind = point.position - geometric * nudge_;
            const bool thin = luminance(material.transmit) > 0;
            const bool last = depth >= params_.bounces;
            // Among trees, what leaves pass on to one another is most of the light.
            const bool passes = tree && thin;
            const float back = passes ? 0.5f : 1.0f;

            auto lit = [&](Vec3f light, float& scatter_density) {
                scatter_density = 0;
                const float facing_light = dot(geometric, light);
                // A thin leaf passes on to its other side, evenly, what reaches this one.
                if (facing_light <= 0) return material.transmit * (-facing_light / kPi);
                return scatter.evaluate(frame.local(light), scatter_density);
            };
            const auto sun_numbers = numbers.next2(), sky_numbers = numbers.next2();
            if (world_.sky.has_sun()) {
                const Vec3f light = world_.sky.sample_sun(sun_numbers);
                float unused = 0;
                const Vec3f f = light.z > 0 || !world_.ground ? lit(light, unused) : Vec3f{};
                if (luminance(f) > 0) {
                    ++rays;
                    if (!hidden(thin && dot(geometric, light) < 0 ? behind : start, light))
                        add(out.radiance, times(times(through, f), world_.sky.sun_irradiance()),
                            depth);
                }
            }
            const auto [light, light_density] = world_.sky.sample(sky_numbers);
            float scatter_density = 0;
            const Vec3f f = lit(light, scatter_density);
            if (luminance(f) > 0 && !(world_.ground && light.z <= 0)) {
                ++rays;
                if (!hidden(thin && dot(geometric, light) < 0 ? behind : start, light)) {
                    const float a = light_density * light_density,
                                b = last ? 0 : back * back * scatter_density * scatter_density;
                    add(out.radiance,
                        times(times(through, f), world_.sky.radiance(light)) *
                            (a / (a + b) / light_density),
                        depth);
                }
            }
            if (last) break;

            const auto choice = numbers.next2(), where = numbers.next2();
            if (passes && choice[0] < 0.5f) {
                // Through the leaf, evenly to its other side; the light of the sky that comes this
                // way has been counted.
                const SinCos turn = sincos_turn(where[1]);
                const float r = std::sqrt(where[0]);
                direction = normalized(Frame(-geometric)
                                           .world({r * turn.cosine, r * turn.sine,
                                                   std::sqrt(std::max(1e-4f, 1 - where[0]))}));
                through = times(through, material.transmit) * 2.0f;
                density = 0;
                origin = behind;
            } else {
                const Vec3f local = scatter.sample(passes ? 2 * choice[0] - 1 : choice[0], where);
                const Vec3f reflected = scatter.evaluate(local, density);
                density *= back;
                if (!(density > 1e-8f)) break;
                direction = normalized(frame.world(local));
                if (dot(geometric, direction) <= 0) break;
                through = times(through, reflected) / density;
                origin = start;
            }
            // Crowns give little of their light to others, and rays among them cost the most.
            if (depth >= 1 || tree) {
                const float survive =
                    std::min(1.0f, 1.6f * std::sqrt(std::max({through.x, through.y, through.z})));
                if (choice[1] >= survive) break;
                through = through / survive;
            }
        }

        if (out.depth > 0 && std::isfinite(world_.haze)) {
            const auto clear =
                static_cast<float>(math::exp(-static_cast<double>(out.depth) / world_.haze));
            const Vec3f air = horizon(first_direction);
            out.radiance = out.radiance * clear + air * (1 - clear);
            out.albedo = out.albedo * clear + Vec3f(1 - clear);
        }
        return out;
    }

private:
    static double tent(float u)
    {
        const double v = static_cast<double>(u) * 2;
        return v < 1 ? std::sqrt(v) - 1 : 1 - std::sqrt(2 - v);
    }

    void add(Vec3f& sum, Vec3f light, int depth) const
    {
        const float l = luminance(light);
        if (!(l < 1e30f)) return;
        if (depth > 0 && l > limit_) light = light * (limit_ / l);
        sum += light;
    }

    bool hidden(Vec3f from, Vec3f direction) const
    {
        return rays_.occluded(from, direction, 0, far_) ||
               (world_.tufts && world_.tufts->occluded(from, direction, far_)) ||
               (world_.woods && world_.woods->occluded(from, direction, far_));
    }

    bool nearest(Vec3f origin, Vec3f direction, SurfacePoint& point, Vec3f& geometric,
                 float& distance, bool& on_ground, std::optional<TuftHit>& tuft,
                 std::optional<WoodHit>& tree) const
    {
        const bool met =
            nearest_plant(origin, direction, point, geometric, distance, on_ground, tuft);
        WoodHit hit;
        if (!world_.woods ||
            !world_.woods->intersect(origin, direction, met ? distance : far_, hit))
            return met;
        tree = hit;
        on_ground = false;
        distance = static_cast<float>(hit.distance);
        world_.woods->place(hit, point.position, geometric, point.normal);
        if (dot(geometric, direction) > 0) {
            geometric = -geometric;
            point.normal = -point.normal;
        }
        point.normal = world_.woods->rounded(hit, point.position, point.normal);
        return true;
    }

    bool nearest_plant(Vec3f origin, Vec3f direction, SurfacePoint& point, Vec3f& geometric,
                       float& distance, bool& on_ground, std::optional<TuftHit>& tuft) const
    {
        const bool met = nearest_solid(origin, direction, point, geometric, distance, on_ground);
        TuftHit hit;
        if (!world_.tufts ||
            !world_.tufts->intersect(origin, direction, met ? distance : far_, hit))
            return met;
        tuft = hit;
        on_ground = false;
        distance = static_cast<float>(hit.distance);
        world_.tufts->place(hit, point.position, geometric, point.normal);
        if (dot(geometric, direction) > 0) geometric = -geometric;
        // Half the leaf's own face, half the cushion's: soft, yet every leaf is seen.
        point.normal = normalized(geometric + point.normal);
        if (!(dot(point.normal, point.normal) > 0.5f)) point.normal = geometric;
        return true;
    }

    bool nearest_solid(Vec3f origin, Vec3f direction, SurfacePoint& point, Vec3f& geometric,
                       float& distance, bool& on_ground) const
    {
        float reach = far_;
        if (world_.ground && direction.z != 0) {
            const double t =
                (*world_.ground - static_cast<double>(origin.z)) / static_cast<double>(direction.z);
            if (t > static_cast<double>(nudge_) && t < 1e12) {
                on_ground = true;
                distance = static_cast<float>(t);
                point.position = origin + direction * distance;
                point.position.z = static_cast<float>(*world_.ground);
                geometric = point.normal =
                    Vec3f(0, 0, static_cast<double>(origin.z) >= *world_.ground ? 1.0f : -1.0f);
                reach = std::min(far_, distance);
            }
        }
        rays::Hit hit;
        if (!rays_.intersect(origin, direction, 0, reach, hit)) return on_ground;
        on_ground = false;
        const auto& t = world_.mesh.triangles[hit.triangle];
        const Vec3f a = world_.mesh.vertices[t[0]], e1 = world_.mesh.vertices[t[1]] - a,
                    e2 = world_.mesh.vertices[t[2]] - a;
        point.triangle = hit.triangle;
        point.u = hit.u;
        point.v = hit.v;
        point.position = a + e1 * hit.u + e2 * hit.v;
        distance = static_cast<float>(hit.distance);
        geometric = normalized(cross(e1, e2));
        const Vec3f* corner = world_.normals.data() + std::size_t(hit.triangle) * 3;
        point.normal =
            normalized(corner[0] * (1 - hit.u - hit.v) + corner[1] * hit.u + corner[2] * hit.v);
        if (dot(geometric, direction) > 0) {
            geometric = -geometric;
            point.normal = -point.normal;
        }
        if (!(dot(point.normal, point.normal) > 0.5f)) point.normal = geometric;
        return true;
    }

    /// Air light towards this azimuth.
    Vec3f horizon(Vec3f d) const
    {
        if (world_.backdrop) return *world_.backdrop;
        return world_.sky.radiance(
            normalized(Vec3f(d.x, d.y, 0.012f * length(Vec3f(d.x, d.y, 0)))));
    }

    /// What the camera sees where it meets nothing: sky, the sun, far ridges in haze.
    Vec3f seen_sky(Vec3f d) const
    {
        if (world_.backdrop) return *world_.backdrop;
        Vec3f light = world_.sky.radiance(d);
        const Vec3f disc = world_.sky.sun_disc(d);
        // The disc is far brighter than paper; what survives of it still whitens its pixels.
        const float glare = luminance(disc), most = 40 * world_.sky.white();
        light += glare > most ? disc * (most / glare) : disc;
        if (!world_.hills || d.z > 0.3f || d.z < -0.02f) return light;
        const float turn = atan2_turn(d.y, d.x) + 0.5f;
        for (int ridge = 2; ridge >= 0; --ridge) {
            const float height = ridge_height(ridge, turn);
            if (d.z > height) continue;
            // Rock lit by the sky, seen through ever less air the nearer the ridge.
            static constexpr float kClear[3] = {0.50f, 0.30f, 0.16f};
            // Mist fills the foot of each.
            const float clear =
                kClear[ridge] * std::clamp(0.25f + 0.75f * d.z / height, 0.0f, 1.0f);
            const Vec3f rock = Vec3f(0.62f, 0.78f, 1.0f) * (world_.sky.white() * 0.22f);
            light = horizon(d) * (1 - clear) + rock * clear;
        }
        return light;
    }

    /// Elevation of a far ridge, as sine, by midpoints of a periodic value noise over the azimuth.
    float ridge_height(int ridge, float turn) const
    {
        static constexpr float kBase[3] = {0.014f, 0.032f, 0.052f};
        static constexpr float kRelief[3] = {0.020f, 0.034f, 0.046f};
        float sum = 0, weight = 1;
        int cells = 9 + 4 * ridge;
        for (int octave = 0; octave < 7; ++octave) {
            const float p = turn * static_cast<float>(cells), base = std::floor(p), f = p - base;
            auto value = [&](int i) {
                return static_cast<float>(
                    uniform_of_key(hash2(key_, static_cast<std::uint64_t>(ridge * 16 + octave)),
                                   static_cast<std::uint64_t>(i % cells)));
            };
            const int i = static_cast<int>(base);
            const float s = f * f * (3 - 2 * f);
            sum += weight * (value(i) * (1 - s) + value(i + 1) * s - 0.5f);
            weight *= 0.48f;
            cells *= 2;
        }
        return kBase[ridge] + kRelief[ridge] * sum;
    }

    const World& world_;
    const TraceParams& params_;
    const rays::TriangleScene& rays_;
    std::uint64_t key_;
    float nudge_ = 0, far_ = 0, pixel_angle_ = 0, limit_ = 0;
};

}  // namespace

Film trace(const World& world, const TraceParams& params, std::uint64_t seed,
           const Progress& progress)
{
    const Tracer tracer(world, params, seed);
    Film film;
    film.width = params.width;
    film.height = params.height;
    const std::size_t pixels = std::size_t(params.width) * std::size_t(params.height);
    film.radiance.resize(pixels);
    film.albedo.resize(pixels);
    film.normal.resize(pixels);
    film.depth.resize(pixels);
    film.variance.resize(pixels);

    const int columns = (params.width + kTile - 1) / kTile,
              rows = (params.height + kTile - 1) / kTile;
    std::vector<std::uint64_t> rays(static_cast<std::size_t>(columns * rows));
    auto pixel = [&](int x, int y, std::uint64_t& count) {
        const std::size_t i = std::size_t(y) * std::size_t(params.width) + std::size_t(x);
        Vec3d radiance, albedo, normal;
        double depth = 0, sum = 0, squares = 0;
        for (int s = 0; s < params.samples; ++s) {
            const Sample one = tracer.path(x, y, static_cast<std::uint32_t>(s), count);
            radiance += Vec3d(one.radiance);
            albedo += Vec3d(one.albedo);
            normal += Vec3d(one.normal);
            depth += static_cast<double>(one.depth);
            const auto l = static_cast<double>(luminance(one.radiance) /
                                               std::max(0.02f, luminance(one.albedo)));
            sum += l;
            squares += l * l;
        }
        const double n = params.samples;
        film.radiance[i] = Vec3f(radiance / n);
        film.albedo[i] = Vec3f(albedo / n);
        film.normal[i] = Vec3f(normal / n);
        film.depth[i] = static_cast<float>(depth / n);
        film.variance[i] = static_cast<float>(std::max(0.0, squares / n - sum * sum / (n * n)) / n);
    };
    for (int row = 0; row < rows; ++row) {
        parallel_for(static_cast<std::size_t>(columns), [&](std::size_t column) {
            std::uint64_t& count = rays[static_cast<std::size_t>(row * columns) + column];
            const int x0 = static_cast<int>(column) * kTile, y0 = row * kTile;
            for (int y = y0; y < std::min(y0 + kTile, params.height); ++y)
                for (int x = x0; x < std::min(x0 + kTile, params.width); ++x) {
                    if ((x - x0) % 4 == 0) progress.check();
                    pixel(x, y, count);
                }
        });
        progress.update(double(row + 1) / rows);
    }
    for (const std::uint64_t r : rays) film.rays += r;
    return film;
}

}  // namespace sekitei::render
