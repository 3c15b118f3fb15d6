#include "solvers/soil/geology.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::soil {
namespace {

constexpr std::int32_t kUnlike = -1;

int hex_digit(char c)
{
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
}

std::string_view trimmed(std::string_view text)
{
    while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
    while (!text.empty() && text.back() == ' ') text.remove_suffix(1);
    return text;
}

/// 1 + index of a soil by its name.
std::int32_t number_of(std::string_view soil, std::span<const Soil> soils)
{
    std::string known;
    for (std::size_t i = 0; i < soils.size(); ++i) {
        if (soils[i].name == soil) return static_cast<std::int32_t>(i + 1);
        known += (i == 0 ? "" : ", ") + soils[i].name;
    }
    throw InvalidParameter(
        fmt::format("geology: soil '{}' is not known, must be one of {}", soil, known));
}

/// A picture repeated over the plane; v runs upwards.
Vec3d sample(const Image8& image, double u, double v)
{
    // The first texel's centre lies half a texel from the corner.
    const double x = (u - std::floor(u)) * image.width - 0.5;
    const double y = (std::ceil(v) - v) * image.height - 0.5;
    const double fx = x - std::floor(x), fy = y - std::floor(y);
    const auto wrapped = [](double at, int size) {
        const int i = static_cast<int>(std::floor(at)) % size;
        return i < 0 ? i + size : i;
    };
    const int x0 = wrapped(x, image.width), x1 = (x0 + 1) % image.width;
    const int y0 = wrapped(y, image.height), y1 = (y0 + 1) % image.height;
    Vec3d colour;
    for (int c = 0; c < 3; ++c)
        colour[c] = ((image.at(x0, y0, c) * (1 - fx) + image.at(x1, y0, c) * fx) * (1 - fy) +
                     (image.at(x0, y1, c) * (1 - fx) + image.at(x1, y1, c) * fx) * fy) /
                    255;
    return colour;
}

/// Texture coordinates at the centroids of sites.
class Coordinates {
public:
    /// @throws InvalidInput  the mesh has none
    Coordinates(const TriMesh& mesh, const MeshSites& sites, std::string_view name)
        : mesh_(mesh), sites_(sites)
    {
        for (std::size_t k = 0; k < 3; ++k) {
            const auto found = mesh.face_attributes.find("uv_" + std::to_string(k));
            corner_[k] = found == mesh.face_attributes.end()
                             ? nullptr
                             : std::get_if<std::vector<Vec3f>>(&found->second);
            if (!corner_[k] || corner_[k]->size() != mesh.triangles.size())
                throw InvalidInput(fmt::format(
                    "{}: the mesh has a texture but no texture coordinates, and no face attribute "
                    "'geology' says what it is made of",
                    name));
        }
    }

    Vec3d at(std::size_t site) const
    {
        const std::uint32_t face = sites_.face[site];
        const auto& [i, j, k] = mesh_.triangles[face];
        const Vec3d a(mesh_.vertices[i]), b = Vec3d(mesh_.vertices[j]) - a,
                                          c = Vec3d(mesh_.vertices[k]) - a,
                                          p = Vec3d(sites_.position[site]) - a;
        const Vec3d normal = cross(b, c);
        const double square = dot(normal, normal);
        const double second = dot(cross(p, c), normal) / square,
                     third = dot(cross(b, p), normal) / square;
        return Vec3d((*corner_[0])[face]) * (1 - second - third) +
               Vec3d((*corner_[1])[face]) * second + Vec3d((*corner_[2])[face]) * third;
    }

private:
    const TriMesh& mesh_;
    const MeshSites& sites_;
    std::array<const std::vector<Vec3f>*, 3> corner_{};
};

}  // namespace

std::vector<SoilColour> soil_colours(std::string_view text)
{
    std::vector<SoilColour> colours;
    for (std::string_view rest = text; !trimmed(rest).empty();) {
        const std::string_view entry = trimmed(rest.substr(0, rest.find(',')));
        rest.remove_prefix(std::min(rest.find(','), rest.size() - 1) + 1);
        const std::size_t hash = entry.find('#');
        SoilColour one;
        bool good = hash != std::string_view::npos && entry.size() - hash == 7;
        if (good) one.soil = trimmed(entry.substr(0, hash));
        for (std::size_t i = 0; good && i < 3; ++i) {
            const int high = hex_digit(entry[hash + 1 + 2 * i]),
                      low = hex_digit(entry[hash + 2 + 2 * i]);
            good = high >= 0 && low >= 0;
            if (good) one.colour[i] = static_cast<std::uint8_t>(16 * high + low);
        }
        if (!good || one.soil.empty())
            throw InvalidParameter(fmt::format(
                "geology: colours has '{}', must be a soil and its colour, as in 'sand #C39143'",
                entry));
        colours.push_back(std::move(one));
    }
    if (colours.empty())
        throw InvalidParameter("geology: colours is empty, must name a soil and its colour");
    return colours;
}

Vec3d lab_of_srgb(Vec3d srgb)
{
    for (int c = 0; c < 3; ++c)
        srgb[c] = srgb[c] <= 0.04045 ? srgb[c] / 12.92 : math::pow((srgb[c] + 0.055) / 1.055, 2.4);
    // Each row sums to the white point, so that white has exactly a = b = 0.
    constexpr double kXyz[3][3] = {{0.4124564, 0.3575761, 0.1804375},
                                   {0.2126729, 0.7151522, 0.0721750},
                                   {0.0193339, 0.1191920, 0.9503041}};
    Vec3d f;
    for (int row = 0; row < 3; ++row) {
        const double white = kXyz[row][0] + kXyz[row][1] + kXyz[row][2];
        const double t =
            (kXyz[row][0] * srgb.x + kXyz[row][1] * srgb.y + kXyz[row][2] * srgb.z) / white;
        constexpr double kKnee = 6.0 / 29;
        f[row] =
            t > kKnee * kKnee * kKnee ? math::pow(t, 1.0 / 3) : t / (3 * kKnee * kKnee) + 4.0 / 29;
    }
    return {116 * f.y - 16, 500 * (f.x - f.y), 200 * (f.y - f.z)};
}

std::vector<std::int32_t> geology(const TriMesh& mesh, const MeshSites& sites,
                                  const Image8* texture, std::span<const Soil> soils,
                                  const GeologyParams& params, std::string_view mesh_name,
                                  const Progress& progress)
{
    validate_described("geology", params);
    std::vector<std::int32_t> found(sites.size(), kUnlike);

    if (const auto own = mesh.face_attributes.find("geology"); own != mesh.face_attributes.end()) {
        const auto* values = std::get_if<std::vector<std::int32_t>>(&own->second);
        if (!values || values->size() != mesh.triangles.size())
            throw InvalidInput(fmt::format(
                "{}: the face attribute 'geology' must be one integer for each triangle",
                mesh_name));
        for (std::size_t i = 0; i < found.size(); ++i) found[i] = (*values)[sites.face[i]];
        return found;
    }
    if (!texture || texture->pixels.empty())
        throw InvalidInput(
            fmt::format("{}: nothing says what the mesh is made of: give it a face attribute "
                        "'geology' or a texture",
                        mesh_name));
    if (texture->channels < 3)
        throw InvalidInput(fmt::format("{}: the texture has {} channels, must be RGB or RGBA",
                                       mesh_name, texture->channels));
    const Coordinates coordinates(mesh, sites, mesh_name);

    const std::vector<SoilColour> colours = soil_colours(params.colours);
    std::vector<std::int32_t> number;
    std::vector<Vec3d> lab;
    for (const SoilColour& c : colours) {
        number.push_back(number_of(c.soil, soils));
        lab.push_back(lab_of_srgb(Vec3d(c.colour[0], c.colour[1], c.colour[2]) / 255.0));
    }
    const std::int32_t fallback =
        params.fallback.empty() ? kUnlike : number_of(params.fallback, soils);

    parallel_for_range(
        sites.size(),
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            for (std::size_t i = begin; i != end; ++i) {
                const Vec3d uv = coordinates.at(i);
                if (!std::isfinite(uv.x) || !std::isfinite(uv.y)) continue;
                const Vec3d here = lab_of_srgb(sample(*texture, uv.x, uv.y));
                double nearest = std::numeric_limits<double>::infinity();
                std::size_t best = 0;
                for (std::size_t k = 0; k < lab.size(); ++k)
                    if (const double d = length(here - lab[k]); d < nearest) {
                        nearest = d;
                        best = k;
                    }
                found[i] = nearest <= params.farthest ? number[best] : fallback;
            }
        },
        1024);

    // Say what the first unlike colour is and how far it lies from each soil's.
    const auto bad = std::find(found.begin(), found.end(), kUnlike);
    if (bad == found.end()) return found;
    const auto site = static_cast<std::size_t>(bad - found.begin());
    const Vec3d uv = coordinates.at(site);
    const Vec3f p = sites.position[site];
    const std::string where = fmt::format("{}: face {} at ({:.4g}, {:.4g}, {:.4g})", mesh_name,
                                          sites.face[site], p.x, p.y, p.z);
    if (!std::isfinite(uv.x) || !std::isfinite(uv.y))
        throw InvalidInput(
            fmt::format("{} has texture coordinates ({}, {}), must be finite", where, uv.x, uv.y));
    const Vec3d colour = sample(*texture, uv.x, uv.y);
    std::string distances;
    for (std::size_t k = 0; k < lab.size(); ++k)
        distances += fmt::format("{}{:.1f} from {}", k == 0 ? "" : ", ",
                                 length(lab_of_srgb(colour) - lab[k]), colours[k].soil);
    throw InvalidInput(fmt::format(
        "{} has the colour #{:02X}{:02X}{:02X}, {}, must be within {} of one: add its colour to "
        "the soils or choose a fallback",
        where, std::lround(colour.x * 255), std::lround(colour.y * 255),
        std::lround(colour.z * 255), distances, params.farthest));
}

}  // namespace sekitei::soil
