#include "core/noise.h"

#include <algorithm>
#include <cmath>

#include "core/math.h"

namespace sekitei {
namespace {

/// Dot product of the lattice site's gradient with the offset d from it. The gradient points to one
/// of the twelve edge midpoints of a cube [Perlin2002].
double site(std::uint64_t key, std::int64_t x, std::int64_t y, std::int64_t z, Vec3d d)
{
    const std::uint64_t h =
        hash2(hash2(hash2(key, static_cast<std::uint64_t>(x)), static_cast<std::uint64_t>(y)),
              static_cast<std::uint64_t>(z)) >>
        40;
    const double u = h & 1 ? 1 : -1, v = h & 2 ? 1 : -1;
    switch ((h >> 2) % 3) {
        case 0:
            return u * d.x + v * d.y;
        case 1:
            return u * d.y + v * d.z;
        default:
            return u * d.z + v * d.x;
    }
}

/// The largest value eight gradients of this kind can sum to, near (0.36, 0.48, 0.50) of a cell.
constexpr double kLargest = 1.0363538112118029;

double fade(double t)
{
    return t * t * t * (t * (t * 6 - 15) + 10);
}
double lerp(double a, double b, double t)
{
    return a + t * (b - a);
}

}  // namespace

double gradient_noise(std::uint64_t key, Vec3d p)
{
    const Vec3d base{std::floor(p.x), std::floor(p.y), std::floor(p.z)};
    const Vec3d d = p - base;
    const auto x = static_cast<std::int64_t>(base.x), y = static_cast<std::int64_t>(base.y),
               z = static_cast<std::int64_t>(base.z);
    const double u = fade(d.x), v = fade(d.y), w = fade(d.z);
    double face[2];
    for (int k = 0; k < 2; ++k) {
        double edge[2];
        for (int j = 0; j < 2; ++j)
            edge[j] = lerp(site(key, x, y + j, z + k, d - Vec3d(0, j, k)),
                           site(key, x + 1, y + j, z + k, d - Vec3d(1, j, k)), u);
        face[k] = lerp(edge[0], edge[1], v);
    }
    return lerp(face[0], face[1], w) / kLargest;
}

double FractalNoise::operator()(Vec3d p) const
{
    const double gain = math::pow(2.0, -hurst);
    const std::uint64_t key = hash2(seed, stream.id);
    double sum = 0, weight = 1, total = 0, f = frequency;
    for (int octave = 0; octave < octaves; ++octave) {
        // Shift each octave so that lattice zeros of different octaves do not coincide.
        const std::uint64_t own = hash2(key, static_cast<std::uint64_t>(octave));
        const Vec3d shift{uniform_of_key(own, 0), uniform_of_key(own, 1), uniform_of_key(own, 2)};
        sum += weight * gradient_noise(own, p * f + shift);
        total += weight;
        weight *= gain;
        f *= 2;
    }
    return total > 0 ? std::clamp(sum / total, -1.0, 1.0) : 0;
}

}  // namespace sekitei
