#include "apps/render/look.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "apps/render/fast_math.h"
#include "apps/render/garden.h"
#include "core/parallel.h"
#include "core/random.h"

namespace sekitei::render {
namespace {

/// Light on the soil of a garden, for what grows there by itself.
constexpr float kGardenLight = 0.26f;

float smooth(float low, float high, float x)
{
    const float t = std::clamp((x - low) / (high - low), 0.0f, 1.0f);
    return t * t * (3 - 2 * t);
}
Vec3f mix(Vec3f a, Vec3f b, float t)
{
    return a * (1 - t) + b * t;
}

std::uint32_t scramble(std::uint32_t x)
{
    x ^= x >> 16;
    x *= 0x7FEB352Du;
    x ^= x >> 15;
    x *= 0x846CA68Bu;
    return x ^ (x >> 16);
}
std::uint32_t site_hash(std::uint32_t key, int x, int y, int z)
{
    return scramble(key + static_cast<std::uint32_t>(x) * 0x8DA6B343u +
                    static_cast<std::uint32_t>(y) * 0xD8163841u +
                    static_cast<std::uint32_t>(z) * 0xCB1AB31Fu);
}

struct Noise {
    float value = 0;
    Vec3f gradient;
};

/// Gradient noise [Perlin2002] in about [-1, 1] with its gradient, single precision.
Noise noise(std::uint32_t key, Vec3f p)
{
    const Vec3f base{std::floor(p.x), std::floor(p.y), std::floor(p.z)}, d = p - base;
    const int x = static_cast<int>(base.x), y = static_cast<int>(base.y),
              z = static_cast<int>(base.z);
    Vec3f w, dw;
    for (int i = 0; i < 3; ++i) {
        const float t = d[i];
        w[i] = t * t * t * (t * (t * 6 - 15) + 10);
        dw[i] = 30 * t * t * (t * (t - 2) + 1);
    }
    Noise sum;
    for (int corner = 0; corner < 8; ++corner) {
        const int cx = corner & 1, cy = corner >> 1 & 1, cz = corner >> 2;
        const std::uint32_t h = site_hash(key, x + cx, y + cy, z + cz);
        // One of twelve edge midpoints.
        const float a = h & 1 ? 1.0f : -1.0f, b = h & 2 ? 1.0f : -1.0f;
        const std::uint32_t axis = (h >> 8) % 3;
        const Vec3f g = axis == 0 ? Vec3f(0, a, b) : axis == 1 ? Vec3f(a, 0, b) : Vec3f(a, b, 0);
        const float dx = d.x - static_cast<float>(cx), dy = d.y - static_cast<float>(cy),
                    dz = d.z - static_cast<float>(cz);
        const float height = g.x * dx + g.y * dy + g.z * dz;
        const float wx = cx ? w.x : 1 - w.x, wy = cy ? w.y : 1 - w.y, wz = cz ? w.z : 1 - w.z;
        const float weight = wx * wy * wz;
        sum.value += weight * height;
        sum.gradient += g * weight;
        sum.gradient.x += (cx ? dw.x : -dw.x) * wy * wz * height;
        sum.gradient.y += wx * (cy ? dw.y : -dw.y) * wz * height;
        sum.gradient.z += wx * wy * (cz ? dw.z : -dw.z) * height;
    }
    return sum;
}

/// How much of a pattern of this wavelength a pixel can show.
float visible(float wavelength, float footprint)
{
    return smooth(1.2f, 3.5f, wavelength / std::max(footprint, 1e-12f));
}

/// Tilts n by the slope of a relief.
Vec3f tilted(Vec3f n, Vec3f slope)
{
    return normalized(n - (slope - n * dot(n, slope)));
}

/// Stones lying on a plane: the one that covers (x, y), as height slope and a number of its own.
struct Stone {
    float cover = 0;  // 0 between stones, 1 on one
    float id = 0;
    float slope_x = 0, slope_y = 0;
};
Stone stones(std::uint32_t key, float x, float y)
{
    const float bx = std::floor(x), by = std::floor(y);
    Stone best;
    float nearest = 1e9f;
    for (int j = -1; j <= 1; ++j)
        for (int i = -1; i <= 1; ++i) {
            const int cx = static_cast<int>(bx) + i, cy = static_cast<int>(by) + j;
            const std::uint32_t h = site_hash(key, cx, cy, 0), h2 = scramble(h + 1);
            const float px = static_cast<float>(cx) + 0.5f +
                             (static_cast<float>(h & 0xFFFF) * 0x1p-16f - 0.5f) * 0.8f;
            const float py = static_cast<float>(cy) + 0.5f +
                             (static_cast<float>(h >> 16) * 0x1p-16f - 0.5f) * 0.8f;
            const float radius = 0.22f + 0.30f * static_cast<float>(h2 & 0xFFFF) * 0x1p-16f;
            const SinCos turn = sincos_turn(static_cast<float>(h2 >> 16) * 0x1p-16f);
            const float stretch = 1.3f;
            const float ex = ((x - px) * turn.cosine + (y - py) * turn.sine) / (radius * stretch);
            const float ey = ((y - py) * turn.cosine - (x - px) * turn.sine) * stretch / radius;
            const float d = ex * ex + ey * ey;
            if (d >= nearest) continue;
            nearest = d;
            best.id = static_cast<float>(scramble(h2) >> 8) * 0x1p-24f;
            best.cover = 1 - smooth(0.75f, 1.0f, d);
            // A flattened dome.
            const float steep = d < 1 ? -1.6f * d * d : 0;
            const float sx = steep * ex, sy = steep * ey;
            best.slope_x = sx * turn.cosine - sy * turn.sine;
            best.slope_y = sx * turn.sine + sy * turn.cosine;
        }
    return best;
}

/// The unit eigenvector of the smallest eigenvalue of a symmetric matrix, by Jacobi rotations.
Vec3d least_axis(std::array<std::array<double, 3>, 3> a)
{
    std::array<std::array<double, 3>, 3> v{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    for (int sweep = 0; sweep < 12; ++sweep)
        for (std::size_t p = 0; p < 2; ++p)
            for (std::size_t q = p + 1; q < 3; ++q) {
                if (std::abs(a[p][q]) < 1e-300) continue;
                const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
                const double t =
                    (theta >= 0 ? 1 : -1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
                const double c = 1 / std::sqrt(t * t + 1), s = t * c;
                for (std::size_t k = 0; k < 3; ++k) {
                    const double x = a[k][p], y = a[k][q];
                    a[k][p] = c * x - s * y;
                    a[k][q] = s * x + c * y;
                }
                for (std::size_t k = 0; k < 3; ++k) {
                    const double x = a[p][k], y = a[q][k];
                    a[p][k] = c * x - s * y;
                    a[q][k] = s * x + c * y;
                }
                for (std::size_t k = 0; k < 3; ++k) {
                    const double x = v[k][p], y = v[k][q];
                    v[k][p] = c * x - s * y;
                    v[k][q] = s * x + c * y;
                }
            }
    std::size_t least = 0;
    for (std::size_t k = 1; k < 3; ++k)
        if (a[k][k] < a[least][least]) least = k;
    return {v[0][least], v[1][least], v[2][least]};
}

/// Integers under this name, of triangles or else of vertices.
const std::vector<std::int32_t>* integers(const TriMesh& mesh, const char* name, bool& per_face)
{
    for (const bool face : {true, false}) {
        const auto& attributes = face ? mesh.face_attributes : mesh.vertex_attributes;
        const auto found = attributes.find(name);
        if (found == attributes.end()) continue;
        const auto* values = std::get_if<std::vector<std::int32_t>>(&found->second);
        if (!values || values->size() != (face ? mesh.triangles.size() : mesh.vertices.size()))
            continue;
        per_face = face;
        return values;
    }
    return nullptr;
}

std::uint32_t heaviest_corner(const TriMesh& mesh, const SurfacePoint& p)
{
    const float w = 1 - p.u - p.v;
    const int k = w >= p.u && w >= p.v ? 0 : p.u >= p.v ? 1 : 2;
    return mesh.triangles[p.triangle][static_cast<std::size_t>(k)];
}

}  // namespace

Material ColourLook::surface(const SurfacePoint& p) const
{
    if (p.triangle >= first_bright_) return {Vec3f(0), p.normal, 1, 0, {}, colours_[p.triangle]};
    if (!per_vertex_) return {colours_[p.triangle], p.normal, 1, 0};
    const auto& t = mesh_.triangles[p.triangle];
    return {colours_[t[0]] * (1 - p.u - p.v) + colours_[t[1]] * p.u + colours_[t[2]] * p.v,
            p.normal, 1, 0};
}

RockLook::RockLook(const TriMesh& mesh, std::uint64_t seed, const Progress& progress)
    : mesh_(mesh), key_(static_cast<std::uint32_t>(hash2(seed, Stream("render.rock").id)))
{
    surface_ = integers(mesh, "surface", surface_per_face_);
    has_soil_ = surface_ && std::find(surface_->begin(), surface_->end(), 6) != surface_->end();
    find_columns(seed, progress);
    measure_columns(progress);
    find_joints(progress);
}

void RockLook::find_columns(std::uint64_t seed, const Progress& progress)
{
    columns_.resize(1);
    const auto* ids = integers(mesh_, "column", slots_per_face_);
    if (!ids) return;
    auto distinct = [](std::vector<std::int32_t>& values) {
        std::sort(values.begin(), values.end());
        values.erase(std::unique(values.begin(), values.end()), values.end());
    };
    std::vector<std::int32_t> known;
    constexpr std::size_t kBlock = 1 << 20;  // no long sort: nobody could stop it
    for (std::size_t begin = 0; begin < ids->size(); begin += kBlock) {
        progress.check();
        std::vector<std::int32_t> block(
            ids->begin() + std::ptrdiff_t(begin),
            ids->begin() + std::ptrdiff_t(std::min(ids->size(), begin + kBlock)));
        distinct(block);
        known.insert(known.end(), block.begin(), block.end());
    }
    distinct(known);
    columns_.resize(known.size() + 1);
    constexpr Stream kLook{"render.column"};
    for (std::size_t i = 0; i < known.size(); ++i) {
        Column& c = columns_[i + 1];
        if (known[i] < 0) continue;  // massive rock has no columns
        auto draw = [&](std::uint64_t k) {
            return static_cast<float>(
                uniform01(seed, kLook, static_cast<std::uint64_t>(known[i]), k));
        };
        c.value = 0.80f + 0.40f * draw(0);
        c.warmth = draw(1) - 0.5f;
        c.roughness = 0.16f * (draw(2) - 0.5f);
        c.shift = Vec3f(draw(3), draw(4), draw(5)) * 64.0f;
        c.pitch = 0.05f + 0.04f * draw(6);  // of the width; [m] once that is known
    }
    slots_.resize(ids->size());
    parallel_for(
        ids->size(),
        [&](std::size_t i) {
            progress.check();
            slots_[i] = static_cast<std::uint32_t>(
                std::lower_bound(known.begin(), known.end(), (*ids)[i]) - known.begin() + 1);
        },
        4096);
}

void RockLook::measure_columns(const Progress& progress)
{
    Bounds bounds;
    for (const auto& t : mesh_.triangles)
        for (const std::uint32_t v : t) bounds.add(Vec3d(mesh_.vertices[v]));
    width_ = static_cast<float>(std::max(length(bounds.size()) / 24, 1e-9));
    if (slots_.empty()) return;

    // Axis: least eigenvector of the wall normals' covariance, weighted by area.
    struct Sum {
        std::array<std::array<double, 3>, 3> normals{};
        Vec3d centre;
        double area = 0, spread = 0;
    };
    std::vector<Sum> sums(columns_.size());
    auto visit = [&](auto&& f) {
        for (std::size_t i = 0; i < mesh_.triangles.size(); ++i) {
            progress.check();
            const auto& t = mesh_.triangles[i];
            const std::uint32_t slot = slots_[slots_per_face_ ? i : t[0]];
            if (surface_ && (*surface_)[surface_per_face_ ? i : t[0]] != 0) continue;
            const Vec3d a(mesh_.vertices[t[0]]), b(mesh_.vertices[t[1]]), c(mesh_.vertices[t[2]]);
            f(slot, cross(b - a, c - a), (a + b + c) / 3.0);
        }
    };
    visit([&](std::uint32_t slot, Vec3d normal, Vec3d centre) {
        Sum& s = sums[slot];
        const double area = length(normal);
        if (!(area > 0)) return;
        s.area += area;
        s.centre += centre * area;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j)
                s.normals[static_cast<std::size_t>(i)][static_cast<std::size_t>(j)] +=
                    normal[i] * normal[j] / area;
    });
    std::vector<Vec3d> axes(columns_.size(), Vec3d(0, 0, 1));
    for (std::size_t i = 1; i < columns_.size(); ++i) {
        if (!(sums[i].area > 0)) continue;
        sums[i].centre = sums[i].centre / sums[i].area;
        // A slight preference for the vertical decides where one wall alone is seen.
        sums[i].normals[2][2] -= 1e-3 * sums[i].area;
        axes[i] = least_axis(sums[i].normals);
        if (axes[i].z < 0) axes[i] = -axes[i];
        columns_[i].axis = Vec3f(axes[i]);
    }
    // Width: walls lie about half a width from the axis; the median over columns is robust.
    visit([&](std::uint32_t slot, Vec3d normal, Vec3d centre) {
        Sum& s = sums[slot];
        const Vec3d d = centre - s.centre, across = d - axes[slot] * dot(d, axes[slot]);
        s.spread += dot(across, across) * length(normal);
    });
    std::vector<double> widths;
    for (std::size_t i = 1; i < columns_.size(); ++i)
        if (columns_[i].pitch > 0 && sums[i].area > 0)
            widths.push_back(2 * std::sqrt(sums[i].spread / sums[i].area));
    if (!widths.empty()) {
        std::nth_element(widths.begin(), widths.begin() + std::ptrdiff_t(widths.size() / 2),
                         widths.end());
        const double median = widths[widths.size() / 2];
        if (median > 0) width_ = static_cast<float>(median);
    }
    for (Column& c : columns_) c.pitch *= width_;
}

void RockLook::find_joints(const Progress& progress)
{
    if (slots_.empty() || !slots_per_face_) return;
    const std::size_t count = mesh_.vertices.size();
    std::vector<std::uint32_t> first(count, 0);
    joint_.assign(count, 0);
    for (std::size_t i = 0; i < mesh_.triangles.size(); ++i) {
        progress.check();
        for (const std::uint32_t v : mesh_.triangles[i]) {
            if (first[v] == 0)
                first[v] = slots_[i];
            else if (first[v] != slots_[i])
                joint_[v] = 1;
        }
    }
    // The border follows triangles in a zigzag: spread it over the neighbours into a soft line.
    std::vector<float> sum(count), weight(count);
    for (int pass = 0; pass < 2; ++pass) {
        std::fill(sum.begin(), sum.end(), 0.0f);
        std::fill(weight.begin(), weight.end(), 0.0f);
        for (const auto& t : mesh_.triangles) {
            progress.check();
            const float all = joint_[t[0]] + joint_[t[1]] + joint_[t[2]];
            for (const std::uint32_t v : t) {
                sum[v] += all;
                weight[v] += 3;
            }
        }
        for (std::size_t v = 0; v < count; ++v)
            if (weight[v] > 0) joint_[v] = sum[v] / weight[v];
    }
}

RockLook::Where RockLook::where(const SurfacePoint& p) const
{
    Where w;
    const auto& t = mesh_.triangles[p.triangle];
    if (surface_)
        w.surface = (*surface_)[surface_per_face_ ? p.triangle : heaviest_corner(mesh_, p)];
    if (slots_.empty()) return w;
    const std::array<float, 3> share{1 - p.u - p.v, p.u, p.v};
    if (slots_per_face_) {
        w.column = slots_[p.triangle];
        for (std::size_t k = 0; k < 3; ++k) w.joint += share[k] * joint_[t[k]];
        return w;
    }
    w.column = slots_[heaviest_corner(mesh_, p)];
    float own = 0;
    for (std::size_t k = 0; k < 3; ++k)
        if (slots_[t[k]] == w.column) own += share[k];
    w.joint = own < 1 ? std::clamp(2 - 2 * own, 0.0f, 1.0f) : 0;
    return w;
}

Material RockLook::surface(const SurfacePoint& p) const
{
    const Where at = where(p);
    const Column& column = columns_[at.column];

    // The surface's history: colour, how weathered, shine.
    struct Class {
        Vec3f colour;
        float weathered, roughness, rubble;
    };
    static constexpr std::array<Class, 8> kClasses{{
        {{0.134f, 0.124f, 0.112f}, 0.80f, 0.62f, 0.5f},   // joint wall
        {{0.088f, 0.093f, 0.098f}, 0.15f, 0.50f, 0.9f},   // cut face
        {{0.165f, 0.108f, 0.078f}, 0.60f, 0.85f, 2.2f},   // cooling contact
        {{0.112f, 0.108f, 0.104f}, 0.40f, 0.70f, 1.2f},   // slow contact
        {{0.138f, 0.130f, 0.112f}, 1.00f, 0.75f, 1.3f},   // terrain
        {{0.140f, 0.138f, 0.136f}, 0.05f, 0.65f, 0.35f},  // domain edge
        {{0.060f, 0.050f, 0.035f}, 0.00f, 1.00f, 1.0f},   // soil, see below
        {{0.235f, 0.225f, 0.205f}, 0.70f, 0.80f, 0.30f},  // dressed granite
    }};
    constexpr int kSoil = 6, kDressed = 7;
    if (at.surface == kSoil) return ground_cover(p, kGardenLight, key_);
    const Class& look =
        kClasses[at.surface >= 0 && at.surface <= kDressed ? static_cast<std::size_t>(at.surface)
                                                           : 0];

    Vec3f colour = look.colour * column.value;
    colour.x *= 1 + 0.10f * column.warmth;
    colour.z *= 1 - 0.14f * column.warmth;
    Material m;
    m.normal = p.normal;
    m.roughness = std::clamp(look.roughness + column.roughness, 0.3f, 1.0f);
    m.specular = 1;
    const float crack = smooth(0.15f, 0.50f, at.joint);
    if (!p.seen) {
        m.albedo = colour * (1 - 0.6f * crack);
        m.roughness = 1;
        m.specular = 0;
        return m;
    }

    // Mottling and relief from one stack of octaves, finer ones with the column's own pattern.
    const Vec3f q = p.position / width_;
    const Vec3f own = q + column.shift;
    const float pixel = p.footprint / width_;
    float mottle = 0, fine = 0;
    Vec3f slope;
    static constexpr std::array<float, 6> kWavelength{0.83f,  0.34f,  0.137f,
                                                      0.056f, 0.023f, 0.0092f};
    static constexpr std::array<float, 6> kMottle{0.42f, 0.34f, 0.28f, 0.22f, 0.20f, 0.20f};
    static constexpr std::array<float, 6> kSlope{0.05f, 0.085f, 0.12f, 0.13f, 0.14f, 0.16f};
    for (std::size_t i = 0; i < kWavelength.size(); ++i) {
        const float shown = visible(kWavelength[i], pixel);
        if (shown <= 0) break;
        const Noise n = noise(key_ + static_cast<std::uint32_t>(i), own / kWavelength[i]);
        mottle += shown * kMottle[i] * n.value;
        if (i >= 3) fine += shown * n.value;
        slope += n.gradient * (shown * kSlope[i] * look.rubble);
    }

    // Striae: bands across the column's axis, wavering, here clearer and there gone.
    const bool wall = at.surface == 0 && column.pitch > 0;
    if (wall) {
        const float shown = visible(column.pitch / width_, pixel);
        if (shown > 0) {
            const Noise waver = noise(key_ + 20, own * 1.1f);
            const float along = dot(p.position, column.axis) / column.pitch + 1.4f * waver.value;
            const SinCos wave = sincos_turn(along - std::floor(along));
            const float strength = shown * smooth(-0.25f, 0.45f, waver.gradient.z * 0.5f + 0.15f);
            slope += column.axis * (0.16f * strength * wave.cosine);
            mottle += 0.10f * strength * wave.sine;
        }
    }

    // Stains: wide warm patches of iron; dark streaks that water leaves on steep faces.
    const float warm = noise(key_ + 21, q * 0.55f).value;
    const float steep = 1 - smooth(0.25f, 0.6f, std::abs(p.normal.z));
    float streak = 0;
    if (look.weathered > 0.2f)
        streak = steep * look.weathered *
                 smooth(0.05f, 0.55f,
                        noise(key_ + 22, Vec3f(q.x * 3.1f, q.y * 3.1f, q.z * 0.28f)).value +
                            0.35f * mottle);
    colour *= 1 + 0.95f * std::clamp(mottle, -0.7f, 0.7f);
    const float iron = smooth(0.1f, 0.6f, warm + 0.5f * mottle) * look.weathered;
    colour = mix(colour, Vec3f(colour.x * 1.20f, colour.y * 0.97f, colour.z * 0.76f), iron);
    colour *= 1 - 0.42f * streak;

    // Crust of crystals: sparse light grains.
    colour *= 1 + 0.25f * smooth(0.35f, 0.9f, fine);

    // Lichen, in blotches with ragged rims; dust and a little green where it is flat.
    const float up = smooth(0.35f, 0.85f, p.normal.z);
    if (look.weathered > 0.3f) {
        const float ground = (at.surface == 4 ? 0.20f : -0.02f) + 0.16f * up;
        const float blotch = noise(key_ + 23, q * 1.9f).value +
                             0.5f * noise(key_ + 24, q * 7.3f).value + 0.5f * mottle + ground;
        const float pale = smooth(0.42f, 0.62f, blotch);
        const float orange =
            smooth(0.50f, 0.66f, noise(key_ + 25, q * 4.1f).value + 0.6f * mottle + 0.5f * ground);
        colour = mix(colour, Vec3f(0.25f, 0.255f, 0.20f) * (1 + 0.8f * mottle), 0.62f * pale);
        colour = mix(colour, Vec3f(0.30f, 0.175f, 0.055f) * (1 + 0.8f * mottle), 0.45f * orange);
        m.roughness = std::min(1.0f, m.roughness + 0.25f * std::max(pale, orange));
    }
    const float dust = up * look.weathered * smooth(-0.35f, 0.4f, mottle + 0.4f * warm);
    colour = mix(colour, Vec3f(0.125f, 0.120f, 0.078f), 0.45f * dust);

    colour *= 1 - 0.82f * crack;
    for (int i = 0; i < 3; ++i) colour[i] = std::clamp(colour[i], 0.012f, 0.6f);
    m.albedo = colour;
    m.normal = tilted(p.normal, slope);
    return m;
}

Material RockLook::ground(const SurfacePoint& p) const
{
    Material m;
    m.normal = p.normal;
    m.specular = 0;
    const Vec3f q = p.position / width_;
    const float pixel = p.footprint / width_;
    // Soil, dry grass in patches, and two sizes of stones that lie closer where the soil is bare.
    float patch = 0, tone = 0;
    Vec3f slope;
    static constexpr std::array<float, 4> kPatch{60, 17, 5.1f, 1.6f};
    for (std::size_t i = 0; i < kPatch.size(); ++i) {
        const float shown = visible(kPatch[i], pixel);
        if (shown <= 0) break;
        const Noise n = noise(key_ + 40 + static_cast<std::uint32_t>(i), q / kPatch[i]);
        patch += 0.55f * shown * n.value;
        slope += Vec3f(n.gradient.x, n.gradient.y, 0) * (0.03f * shown);
    }
    const float grass = smooth(-0.10f, 0.35f, patch);
    Vec3f colour = mix(Vec3f(0.120f, 0.107f, 0.088f), Vec3f(0.108f, 0.113f, 0.052f), grass);
    if (!p.seen) {
        m.albedo = colour;
        return m;
    }
    static constexpr std::array<float, 4> kTone{0.6f, 0.22f, 0.08f, 0.03f};
    for (std::size_t i = 0; i < kTone.size(); ++i) {
        const float shown = visible(kTone[i], pixel);
        if (shown <= 0) break;
        const Noise n = noise(key_ + 50 + static_cast<std::uint32_t>(i), q / kTone[i]);
        tone += 0.32f * shown * n.value;
        slope += Vec3f(n.gradient.x, n.gradient.y, 0) * (0.09f * shown);
    }
    colour *= 1 + tone;
    static constexpr std::array<float, 3> kStone{0.07f, 0.19f, 0.62f};
    static constexpr std::array<float, 3> kDensity{0.55f, 0.30f, 0.10f};
    for (std::size_t i = 0; i < kStone.size(); ++i) {
        const float shown = visible(kStone[i], pixel);
        if (shown <= 0) continue;
        const Stone s =
            stones(key_ + 60 + static_cast<std::uint32_t>(i), q.x / kStone[i], q.y / kStone[i]);
        const float bare = kDensity[i] * (1.25f - grass);
        if (s.id > bare) continue;
        const float cover = s.cover * shown;
        const float value = 0.6f + 0.9f * s.id / bare;
        colour = mix(colour, Vec3f(0.125f, 0.120f, 0.113f) * (value * (1 + 0.8f * tone)), cover);
        slope = slope * (1 - 0.7f * cover) + Vec3f(s.slope_x, s.slope_y, 0) * cover;
    }
    for (int i = 0; i < 3; ++i) colour[i] = std::clamp(colour[i], 0.02f, 0.6f);
    m.albedo = colour;
    m.normal = tilted(p.normal, slope);
    return m;
}

}  // namespace sekitei::render
