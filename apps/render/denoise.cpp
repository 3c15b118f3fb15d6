#include <algorithm>
#include <cmath>

#include "apps/render/path_tracer.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::render {
namespace {

float luminance(Vec3f c)
{
    return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z;
}

/// exp(-x) to 1 %, for weights: (1 - x / 8)^8.
float falling(float x)
{
    const float a = std::max(0.0f, 1 - x * 0.125f), b = a * a, c = b * b;
    return c * c;
}

}  // namespace

void denoise(Film& film, const Progress& progress)
{
    const int width = film.width, height = film.height;
    const std::size_t pixels = film.radiance.size();
    auto index = [&](int x, int y) { return std::size_t(y) * std::size_t(width) + std::size_t(x); };

    std::vector<Vec3f> light(pixels), next(pixels);
    std::vector<float> variance(pixels), next_variance(pixels);
    for (std::size_t i = 0; i < pixels; ++i)
        for (int c = 0; c < 3; ++c)
            light[i][c] = film.radiance[i][c] / std::max(0.02f, film.albedo[i][c]);
    // The variance itself is noisy: mean over three by three.
    parallel_for(static_cast<std::size_t>(height), [&](std::size_t row) {
        const int y = static_cast<int>(row);
        for (int x = 0; x < width; ++x) {
            float sum = 0, weight = 0;
            for (int j = std::max(0, y - 1); j <= std::min(height - 1, y + 1); ++j)
                for (int i = std::max(0, x - 1); i <= std::min(width - 1, x + 1); ++i) {
                    const float w = (i == x ? 2.0f : 1.0f) * (j == y ? 2.0f : 1.0f);
                    sum += w * film.variance[index(i, j)];
                    weight += w;
                }
            variance[index(x, y)] = sum / weight;
        }
    });

    constexpr int kPasses = 3;
    constexpr float kKernel[3] = {0.375f, 0.25f, 0.0625f};
    for (int pass = 0; pass < kPasses; ++pass) {
        const int step = 1 << pass;
        parallel_for(static_cast<std::size_t>(height), [&](std::size_t row) {
            const int y = static_cast<int>(row);
            for (int x = 0; x < width; ++x) {
                const std::size_t i = index(x, y);
                const Vec3f normal = film.normal[i];
                const float depth = film.depth[i], own = luminance(light[i]);
                const float spread = 1.5f * std::sqrt(variance[i]) + 1e-6f * own + 1e-20f;
                Vec3f sum{};
                float weight = 0, squares = 0;
                for (int j = -2; j <= 2; ++j)
                    for (int k = -2; k <= 2; ++k) {
                        const int qx = x + k * step, qy = y + j * step;
                        if (qx < 0 || qy < 0 || qx >= width || qy >= height) continue;
                        const std::size_t q = index(qx, qy);
                        if ((depth > 0) != (film.depth[q] > 0)) continue;
                        const Vec3f turn = normal - film.normal[q];
                        const float apart = std::abs(depth - film.depth[q]) /
                                            (0.01f * depth * static_cast<float>(step) + 1e-12f);
                        const float differ = std::abs(own - luminance(light[q])) / spread;
                        const float w = kKernel[std::abs(j)] * kKernel[std::abs(k)] *
                                        falling(18 * dot(turn, turn) + 0.5f * apart + differ);
                        sum += light[q] * w;
                        squares += w * w * variance[q];
                        weight += w;
                    }
                next[i] = sum / weight;
                next_variance[i] = squares / (weight * weight);
            }
        });
        light.swap(next);
        variance.swap(next_variance);
        progress.update(double(pass + 1) / kPasses);
    }
    for (std::size_t i = 0; i < pixels; ++i)
        for (int c = 0; c < 3; ++c)
            film.radiance[i][c] = light[i][c] * std::max(0.02f, film.albedo[i][c]);
}

}  // namespace sekitei::render
