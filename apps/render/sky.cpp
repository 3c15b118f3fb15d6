#include "apps/render/sky.h"

#include <algorithm>
#include <cmath>

#include "apps/render/fast_math.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::render {
namespace {

using math::kPi;

// The air: scattering coefficients at sea level for 680, 550 and 440 nm [1/m] and scale heights [m]
// [Bruneton2008, Hillaire2020].
constexpr double kEarth = 6360e3, kTop = 70e3, kObserver = 80;
constexpr double kAirHeight = 8000, kHazeHeight = 1200, kOzoneHeight = 25e3, kOzoneDepth = 15e3;
constexpr Vec3d kAir{5.802e-6, 13.558e-6, 33.1e-6};
constexpr Vec3d kOzone{0.650e-6, 1.881e-6, 0.085e-6};
constexpr Vec3d kHazeColour{0.759, 1, 1.336};  // wavelength^-1.3 [Preetham1999]
constexpr double kHazeAlbedo = 0.92, kHazeForward = 0.78;
constexpr double kGroundAlbedo = 0.2;
// Star light and airglow, so that a night is dark and not black.
constexpr Vec3f kNight{0.9e-6f, 1.3e-6f, 2.4e-6f};

Vec3d operator*(Vec3d a, Vec3d b) = delete;

Vec3d times(Vec3d a, Vec3d b)
{
    return {a.x * b.x, a.y * b.y, a.z * b.z};
}
Vec3d exp_minus(Vec3d a)
{
    return {math::exp(-a.x), math::exp(-a.y), math::exp(-a.z)};
}
float luminance(Vec3f c)
{
    return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z;
}

/// Depth along a ray that leaves at height h with cosine mu, over the vertical depth at the ground
/// [Schuler2012]; only for rays that miss the earth.
double chapman(double scale, double h, double mu)
{
    const double ground = kEarth / scale, x = h / scale;
    const double c = std::sqrt(ground + x);
    if (mu >= 0) return c / (c * mu + 1) * math::exp(-x);
    const double lowest = std::sqrt(std::max(0.0, 1 - mu * mu)) * (ground + x);
    const double c0 = std::sqrt(lowest);
    return 2 * c0 * math::exp(ground - lowest) - c / (1 - c * mu) * math::exp(-x);
}

struct Air {
    Vec3d haze;  // scattering at the ground [1/m]

    explicit Air(double turbidity)
    {
        const double depth = std::max(0.0, turbidity - 1) * kAir.y * kAirHeight;
        haze = kHazeColour * (depth / kHazeHeight);
    }

    Vec3d scattering_air(double h) const { return kAir * math::exp(-h / kAirHeight); }
    Vec3d scattering_haze(double h) const { return haze * math::exp(-h / kHazeHeight); }
    static Vec3d ozone(double h)
    {
        return kOzone * std::max(0.0, 1 - std::abs(h - kOzoneHeight) / kOzoneDepth);
    }

    /// Share of light from outside that arrives at height h from the direction with cosine mu.
    Vec3d transmittance(double h, double mu) const
    {
        const double r = kEarth + h, sine2 = std::max(0.0, 1 - mu * mu);
        if (mu < 0 && r * r * sine2 < kEarth * kEarth) return {};
        // The ozone layer as a thin shell.
        double ozone_path = 0;
        if (h < kOzoneHeight || mu < 0) {
            const double s = r / (kEarth + kOzoneHeight);
            const double shell = std::sqrt(std::max(1e-4, 1 - s * s * sine2));
            ozone_path = (h < kOzoneHeight ? 1 : 2) * kOzoneDepth / shell;
        }
        return exp_minus(kAir * (kAirHeight * chapman(kAirHeight, h, mu)) +
                         haze * (kHazeHeight / kHazeAlbedo * chapman(kHazeHeight, h, mu)) +
                         kOzone * ozone_path);
    }
};

double phase_air(double c)
{
    return 3 / (16 * kPi) * (1 + c * c);
}
double phase_haze(double c)
{
    constexpr double g = kHazeForward;
    const double d = 1 + g * g - 2 * g * c;
    return 3 / (8 * kPi) * (1 - g * g) * (1 + c * c) / ((2 + g * g) * d * std::sqrt(d));
}

/// One view ray through the air, in steps that grow with distance.
struct March {
    const Air& air;
    Vec3d sun;

    /// @param further  isotropic source per scattering coefficient at (height, sun's cosine)
    /// @return radiance; `spread` gets the share of unit isotropic light scattered into the ray
    template <class Further>
    Vec3d operator()(double h0, Vec3d direction, int steps, bool isotropic, Further&& further,
                     Vec3d* spread = nullptr) const
    {
        const double r0 = kEarth + h0, mu = direction.z;
        const double top = kEarth + kTop;
        double end = -r0 * mu + std::sqrt(std::max(0.0, r0 * r0 * (mu * mu - 1) + top * top));
        const double to_ground = r0 * r0 * (mu * mu - 1) + kEarth * kEarth;
        bool ground = false;
        if (mu < 0 && to_ground >= 0) {
            end = -r0 * mu - std::sqrt(to_ground);
            ground = true;
        }
        const double cosine = dot(direction, sun);
        const double air_phase = isotropic ? 1 / (4 * kPi) : phase_air(cosine);
        const double haze_phase = isotropic ? 1 / (4 * kPi) : phase_haze(cosine);
        Vec3d sum, through(1.0);
        if (spread) *spread = {};
        for (int i = 0; i < steps; ++i) {
            const double a = double(i) / steps, b = double(i + 1) / steps;
            const double t0 = end * a * a, t1 = end * b * b, t = (t0 + t1) / 2;
            const Vec3d p = Vec3d(0, 0, r0) + direction * t;
            const double r = length(p), h = std::max(0.0, r - kEarth), sun_mu = dot(p, sun) / r;
            const Vec3d sa = air.scattering_air(h), sh = air.scattering_haze(h);
            const Vec3d extinction = sa + sh / kHazeAlbedo + Air::ozone(h);
            const Vec3d step = exp_minus(extinction * (t1 - t0));
            const Vec3d lit = air.transmittance(h, sun_mu);
            const Vec3d source =
                times(sa * air_phase + sh * haze_phase, lit) + times(sa + sh, further(h, sun_mu));
            auto gathered = [&](Vec3d s) {  // exact for a source constant over the step
                Vec3d g;
                for (int k = 0; k < 3; ++k)
                    g[k] = extinction[k] > 1e-14 ? s[k] * (1 - step[k]) / extinction[k]
                                                 : s[k] * (t1 - t0);
                return times(g, through);
            };
            sum += gathered(source);
            if (spread) *spread += gathered((sa + sh) / (4 * kPi));
            through = times(through, step);
        }
        if (ground) {
            const Vec3d p = Vec3d(0, 0, r0) + direction * end;
            const double sun_mu = dot(p, sun) / length(p);
            if (sun_mu > 0)
                sum +=
                    times(through, air.transmittance(0, sun_mu) * (kGroundAlbedo / kPi * sun_mu));
        }
        return sum;
    }
};

/// Light scattered more than once, as an isotropic source [Hillaire2020], on a small table.
class Further {
public:
    Further(const Air& air, Vec3d sun) : middle_(math::acos(sun.z))
    {
        parallel_for(kHeights * kAngles, [&](std::size_t i) {
            const int height = static_cast<int>(i) / kAngles, angle = static_cast<int>(i) % kAngles;
            const double theta = middle_ + (angle - kAngles / 2) * kStep;
            const Vec3d local{math::sin(theta), 0, math::cos(theta)};
            const March march{air, local};
            Vec3d second, spread_sum;
            constexpr int kRings = 8, kAround = 8;
            for (int ring = 0; ring < kRings; ++ring)
                for (int k = 0; k < kAround; ++k) {
                    const double z = -1 + 2 * (ring + 0.5) / kRings, s = std::sqrt(1 - z * z),
                                 phi = 2 * kPi * (k + 0.5) / kAround;
                    Vec3d spread;
                    second += march(
                        height_of(height), {s * math::cos(phi), s * math::sin(phi), z}, 12, true,
                        [](double, double) { return Vec3d{}; }, &spread);
                    spread_sum += spread;
                }
            constexpr double kCount = kRings * kAround;
            for (int c = 0; c < 3; ++c)
                table_[i][c] =
                    second[c] / kCount / (1 - std::min(0.95, spread_sum[c] * (4 * kPi) / kCount));
        });
    }

    Vec3d operator()(double h, double sun_mu) const
    {
        const double a =
            std::clamp((math::acos(sun_mu) - middle_) / kStep + kAngles / 2, 0.0, kAngles - 1.001);
        const double b = std::clamp(std::sqrt(h / kTop) * (kHeights - 1), 0.0, kHeights - 1.001);
        const int i = static_cast<int>(b), j = static_cast<int>(a);
        auto at = [&](int y, int x) { return table_[static_cast<std::size_t>(y * kAngles + x)]; };
        const double fy = b - i, fx = a - j;
        return (at(i, j) * (1 - fx) + at(i, j + 1) * fx) * (1 - fy) +
               (at(i + 1, j) * (1 - fx) + at(i + 1, j + 1) * fx) * fy;
    }

private:
    static constexpr int kHeights = 8, kAngles = 13;
    static constexpr double kStep = kPi / 180;
    static double height_of(int i)
    {
        const double s = double(i) / (kHeights - 1);
        return std::max(kObserver, kTop * s * s * 0.98);
    }
    double middle_;
    std::array<Vec3d, kHeights * kAngles> table_{};
};

}  // namespace

void Sky::set_sun(Vec3d direction, double radius, Vec3f irradiance)
{
    const Vec3d d = normalized(direction);
    sun_ = Vec3f(d);
    const Vec3d level{d.x, d.y, 0};
    flat_ = length(level) > 1e-9 ? Vec3f(normalized(level)) : Vec3f(1, 0, 0);
    sun_x_ = Vec3f(-flat_.y, flat_.x, 0);
    sun_y_ = cross(sun_, sun_x_);
    sun_cos_ = static_cast<float>(math::cos(radius));
    sun_irradiance_ = irradiance;
}

Sky Sky::day(Vec3d sun_direction, double sun_radius, double turbidity, bool below)
{
    Sky sky;
    const Vec3d sun = normalized(sun_direction);
    const Air air(turbidity);
    // What stands above the horizon of the disc lights the scene; light from its middle.
    const double elevation = kPi / 2 - math::acos(sun.z);
    const double risen = sun_radius > 0 ? std::clamp(0.5 + elevation / (2 * sun_radius), 0.0, 1.0)
                                        : (elevation > 0 ? 1.0 : 0.0);
    const Vec3d arriving = air.transmittance(kObserver, std::max(sun.z, 0.0)) * risen;
    sky.set_sun(sun, sun_radius, Vec3f(arriving));

    const Further further(air, sun);
    const March march{air, {std::sqrt(std::max(0.0, 1 - sun.z * sun.z)), 0, sun.z}};
    sky.table_.resize(kElevations * kAzimuths);
    parallel_for(kElevations, [&](std::size_t row) {
        const double s = double(row) / (kElevations - 1), angle = kPi / 2 * s * s;
        // The lowest row looks a hair above the horizon, where the air is not yet cut by the earth.
        const double z = std::max(0.003, math::sin(angle)), flat = std::sqrt(1 - z * z);
        for (int k = 0; k < kAzimuths; ++k) {
            const double phi = kPi * k / (kAzimuths - 1);
            const Vec3d d{flat * math::cos(phi), flat * math::sin(phi), z};
            sky.table_[row * kAzimuths + static_cast<std::size_t>(k)] =
                Vec3f(march(kObserver, d, 40, false, further)) + kNight;
        }
    });
    sky.finish(below);
    return sky;
}

Sky Sky::uniform(float radiance, bool below)
{
    Sky sky;
    sky.is_uniform_ = true;
    sky.uniform_ = radiance;
    sky.finish(below);
    return sky;
}

void Sky::finish(bool below)
{
    // Integrate over equal-area cells: horizontal irradiance first, it colours the lower half.
    constexpr double kCell = 4 * kPi / (kRows * kColumns);
    auto middle = [](int row, int column) {
        const double z = -1 + 2 * (row + 0.5) / kRows, s = std::sqrt(1 - z * z),
                     phi = 2 * kPi * (column + 0.5) / kColumns;
        return Vec3f(static_cast<float>(s * math::cos(phi)), static_cast<float>(s * math::sin(phi)),
                     static_cast<float>(z));
    };
    Vec3d irradiance;
    for (int row = kRows / 2; row < kRows; ++row)
        for (int column = 0; column < kColumns; ++column) {
            const Vec3f d = middle(row, column);
            irradiance += Vec3d(radiance(d)) * (static_cast<double>(d.z) * kCell);
        }
    const double sun_flat = std::max(0.0f, sun_.z);
    below_ = Vec3f((irradiance + Vec3d(sun_irradiance_) * sun_flat) * (kGroundAlbedo / kPi));
    white_ = luminance(Vec3f(irradiance) * 1.2f + sun_irradiance_ * 0.5f) / static_cast<float>(kPi);
    if (is_uniform_) white_ = uniform_;

    density_.assign(kRows * kColumns, 0);
    cumulative_.assign(kRows * kColumns + 1, 0);
    double total = 0, greatest = 0;
    for (int row = 0; row < kRows; ++row)
        for (int column = 0; column < kColumns; ++column) {
            const float l = luminance(radiance(middle(row, column)));
            const bool met = below || row >= kRows / 2;
            density_[static_cast<std::size_t>(row * kColumns + column)] = met ? l : 0;
            greatest = std::max(greatest, met ? double(l) : 0.0);
        }
    // A floor keeps the weight of any direction bounded.
    for (std::size_t i = 0; i < density_.size(); ++i) {
        if (below || i >= density_.size() / 2)
            density_[i] =
                std::max(density_[i], greatest > 0 ? static_cast<float>(greatest * 0.02) : 1.0f);
        total += density_[i];
        cumulative_[i + 1] = static_cast<float>(total);
    }
    for (float& c : cumulative_) c = static_cast<float>(c / total);
    for (float& d : density_) d = static_cast<float>(d / (total * kCell));
}

Vec3f Sky::table_radiance(Vec3f d) const
{
    // Rows are even in the square root of the elevation, which the horizon needs.
    const float flat = std::sqrt(std::max(0.0f, 1 - d.z * d.z));
    const float row = std::sqrt(std::max(0.0f, atan2_turn(d.z, flat)) * 4) * (kElevations - 1);
    const float along = d.x * flat_.x + d.y * flat_.y, across = d.y * flat_.x - d.x * flat_.y;
    const float column = atan2_turn(std::abs(across), along) * 2 * (kAzimuths - 1);
    const int i = std::clamp(static_cast<int>(row), 0, kElevations - 2),
              j = std::clamp(static_cast<int>(column), 0, kAzimuths - 2);
    const float fy = std::min(1.0f, row - static_cast<float>(i)),
                fx = std::min(1.0f, column - static_cast<float>(j));
    auto at = [&](int y, int x) { return table_[static_cast<std::size_t>(y * kAzimuths + x)]; };
    return (at(i, j) * (1 - fx) + at(i, j + 1) * fx) * (1 - fy) +
           (at(i + 1, j) * (1 - fx) + at(i + 1, j + 1) * fx) * fy;
}

Vec3f Sky::radiance(Vec3f d) const
{
    if (is_uniform_) return Vec3f(uniform_);
    if (d.z >= 0) return table_radiance(d);
    // Without a ground plane: land that fades into the horizon.
    const float share = std::min(1.0f, -d.z / 0.06f);
    return table_radiance({d.x, d.y, 0}) * (1 - share) + below_ * share;
}

std::size_t Sky::cell(Vec3f d) const
{
    const int row = std::clamp(static_cast<int>((d.z + 1) * 0.5f * kRows), 0, kRows - 1);
    float turn = atan2_turn(d.y, d.x);
    if (turn < 0) turn += 1;
    const int column = std::clamp(static_cast<int>(turn * kColumns), 0, kColumns - 1);
    return static_cast<std::size_t>(row * kColumns + column);
}

float Sky::density(Vec3f d) const
{
    return density_[cell(d)];
}

std::pair<Vec3f, float> Sky::sample(std::array<float, 2> u) const
{
    const auto found = std::upper_bound(cumulative_.begin() + 1, cumulative_.end() - 1, u[0]);
    const auto i = static_cast<std::size_t>(found - cumulative_.begin()) - 1;
    const float low = cumulative_[i], high = cumulative_[i + 1];
    const float within = high > low ? std::clamp((u[0] - low) / (high - low), 0.0f, 1.0f) : 0.5f;
    const auto row = static_cast<float>(i / kColumns), column = static_cast<float>(i % kColumns);
    const float z = std::clamp(-1 + 2 * (row + u[1]) / kRows, -1.0f, 1.0f);
    const SinCos turn = sincos_turn((column + within) / kColumns);
    const float s = std::sqrt(std::max(0.0f, 1 - z * z));
    return {Vec3f(s * turn.cosine, s * turn.sine, z), density_[i]};
}

Vec3f Sky::sample_sun(std::array<float, 2> u) const
{
    const float c = 1 - u[0] * (1 - sun_cos_), s = std::sqrt(std::max(0.0f, 1 - c * c));
    const SinCos turn = sincos_turn(u[1]);
    return sun_ * c + sun_x_ * (s * turn.cosine) + sun_y_ * (s * turn.sine);
}

Vec3f Sky::sun_disc(Vec3f d) const
{
    if (sun_cos_ >= 1 || dot(d, sun_) < sun_cos_) return {};
    return sun_irradiance_ / (2 * static_cast<float>(kPi) * (1 - sun_cos_));
}

}  // namespace sekitei::render
