#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>

#include "core/error.h"
#include "core/log.h"
#include "core/mesh_formats.h"

namespace sekitei::mesh_format {
namespace {

using Json = nlohmann::json;

enum : int { kFloat = 5126, kUnsignedInt = 5125, kArrayBuffer = 34962, kElementBuffer = 34963 };

void append32(std::string& out, std::uint32_t bits)
{
    for (int i = 0; i < 4; ++i) out += static_cast<char>(bits >> 8 * i & 0xFF);
}

/// z up becomes y up.
Vec3f y_up(Vec3f v)
{
    return {v.x, v.z, -v.y};
}

/// A custom attribute's name begins with an underscore and is written in capitals. The owning
/// column has the name other programs know it by.
std::string semantic(const std::string& name)
{
    if (name == "column") return "_COLUMN_ID";
    std::string out = "_";
    for (const char c : name) {
        const bool letter = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
        const bool digit = c >= '0' && c <= '9';
        out += letter ? static_cast<char>(c & ~0x20) : digit ? c : '_';
    }
    return out;
}

/// The corners of triangles as glTF vertices: one for each vertex and set of face identities.
struct Split {
    std::vector<std::uint32_t> indices;   ///< three a triangle
    std::vector<std::uint32_t> vertex;    ///< of the mesh, for each glTF vertex
    std::vector<std::uint32_t> triangle;  ///< one that uses it: where its face identities come from
};

Split split(const TriMesh& mesh, const std::vector<const std::vector<std::int32_t>*>& identities,
            const Progress& progress)
{
    // Copies of a vertex form a short list: a mesh vertex meets few columns.
    constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
    Split out;
    std::vector<std::uint32_t> first(mesh.vertices.size(), kNone), next;
    out.indices.reserve(3 * mesh.triangles.size());
    for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) {
        progress.check();
        for (const std::uint32_t v : mesh.triangles[t]) {
            auto same = [&](std::uint32_t copy) {
                return std::all_of(identities.begin(), identities.end(), [&](const auto* ids) {
                    return (*ids)[out.triangle[copy]] == (*ids)[t];
                });
            };
            std::uint32_t* link = &first[v];
            while (*link != kNone && !same(*link)) link = &next[*link];
            if (*link == kNone) {
                const auto copy = static_cast<std::uint32_t>(out.vertex.size());
                *link = copy;  // before `next` grows and moves
                out.vertex.push_back(v);
                out.triangle.push_back(t);
                next.push_back(kNone);
                out.indices.push_back(copy);
            } else
                out.indices.push_back(*link);
        }
    }
    return out;
}

class Writer {
public:
    explicit Writer(const Progress& progress) : progress_(progress) {}

    /// Adds an accessor over `count` elements of `components` floats each.
    template <class Value>
    int floats(std::size_t count, int components, const std::string& name, const Value& value,
               bool bounds = false)
    {
        std::vector<double> lower(std::size_t(components), INFINITY),
            upper(std::size_t(components), -INFINITY);
        const std::size_t offset = data_.size();
        std::size_t replaced = 0;
        for (std::size_t i = 0; i < count; ++i) {
            progress_.check();
            for (int k = 0; k < components; ++k) {
                float x = value(i, k);
                if (!std::isfinite(x)) {
                    x = std::isnan(x) ? 0
                        : x > 0       ? std::numeric_limits<float>::max()
                                      : std::numeric_limits<float>::lowest();
                    ++replaced;
                }
                x += 0.0f;  // no negative zero: it would print as -0.0
                lower[std::size_t(k)] = std::min(lower[std::size_t(k)], double(x));
                upper[std::size_t(k)] = std::max(upper[std::size_t(k)], double(x));
                append32(data_, std::bit_cast<std::uint32_t>(x));
            }
        }
        if (replaced > 0)
            log::warning(
                "glb: {} values of {} are not finite, which glTF forbids; written as 0 or "
                "the largest float",
                replaced, name);
        static constexpr const char* kShapes[] = {"", "SCALAR", "VEC2", "VEC3"};
        Json accessor = {{"bufferView", view(offset, kArrayBuffer)},
                         {"componentType", int(kFloat)},
                         {"count", count},
                         {"type", kShapes[components]}};
        if (bounds) {
            accessor["min"] = lower;
            accessor["max"] = upper;
        }
        accessors_.push_back(std::move(accessor));
        return static_cast<int>(accessors_.size()) - 1;
    }

    int indices(const std::vector<std::uint32_t>& values)
    {
        const std::size_t offset = data_.size();
        for (const std::uint32_t i : values) {
            progress_.check();
            append32(data_, i);
        }
        accessors_.push_back({{"bufferView", view(offset, kElementBuffer)},
                              {"componentType", int(kUnsignedInt)},
                              {"count", values.size()},
                              {"type", "SCALAR"}});
        return static_cast<int>(accessors_.size()) - 1;
    }

    std::string finish(Json attributes, int index_accessor)
    {
        // The default material of glTF is a white mirror; rock is neither.
        const Json material = {{"name", "rock"},
                               {"pbrMetallicRoughness",
                                {{"baseColorFactor", {0.5, 0.5, 0.5, 1.0}},
                                 {"metallicFactor", 0},
                                 {"roughnessFactor", 1}}}};
        const Json document = {
            {"asset", {{"version", "2.0"}, {"generator", "Sekitei " SEKITEI_VERSION}}},
            {"scene", 0},
            {"scenes", {{{"nodes", {0}}}}},
            {"nodes", {{{"mesh", 0}}}},
            {"materials", {material}},
            {"meshes",
             {{{"primitives",
                {{{"attributes", std::move(attributes)},
                  {"indices", index_accessor},
                  {"material", 0},
                  {"mode", 4}}}}}}},
            {"accessors", accessors_},
            {"bufferViews", views_},
            {"buffers", {{{"byteLength", data_.size()}}}}};
        std::string text = document.dump();
        text.resize((text.size() + 3) / 4 * 4, ' ');
        const std::uint64_t total = 12 + 8 + text.size() + 8 + data_.size();
        if (total > std::numeric_limits<std::uint32_t>::max())
            throw LimitExceeded(fmt::format("glb: {} of data, at most 4.29 GB: split the mesh",
                                            bytes_text(static_cast<double>(total))));
        std::string out;
        out.reserve(total);
        append32(out, 0x46546C67);  // "glTF"
        append32(out, 2);
        append32(out, static_cast<std::uint32_t>(total));
        append32(out, static_cast<std::uint32_t>(text.size()));
        append32(out, 0x4E4F534A);  // "JSON"
        out += text;
        append32(out, static_cast<std::uint32_t>(data_.size()));
        append32(out, 0x004E4942);  // "BIN"
        out += data_;
        return out;
    }

private:
    const Progress& progress_;
    std::string data_;
    Json accessors_ = Json::array(), views_ = Json::array();

    std::size_t view(std::size_t offset, int target)
    {
        views_.push_back({{"buffer", 0},
                          {"byteOffset", offset},
                          {"byteLength", data_.size() - offset},
                          {"target", target}});
        return views_.size() - 1;
    }
};

}  // namespace

std::string write_glb(const TriMesh& mesh, const Progress& progress)
{
    std::vector<const std::vector<std::int32_t>*> identities;
    for (const auto& [name, attribute] : mesh.face_attributes)
        if (const auto* ids = std::get_if<std::vector<std::int32_t>>(&attribute))
            identities.push_back(ids);
    const Split corners = split(mesh, identities, progress);
    const std::size_t count = corners.vertex.size();

    Writer writer(progress);
    Json attributes;
    auto taken = [&](const std::string& name) {
        if (attributes.contains(name))
            throw InvalidInput(
                fmt::format("glb: two attributes would be called {}: rename one of them", name));
        return name;
    };
    attributes["POSITION"] = writer.floats(
        count, 3, "POSITION",
        [&](std::size_t i, int k) { return y_up(mesh.vertices[corners.vertex[i]])[k]; }, true);

    // A surface may carry one name twice, on vertices and on faces: identities are the faces' own,
    // measures are sharper at vertices.
    auto identity = [&](const std::string& name) {
        const auto found = mesh.face_attributes.find(name);
        return found != mesh.face_attributes.end() &&
               std::holds_alternative<std::vector<std::int32_t>>(found->second);
    };
    for (const auto& [name, values] : mesh.vertex_attributes) {
        if (identity(name)) continue;
        const TriMesh::Attribute& attribute = values;  // clang 14 captures no structured bindings
        if (const auto* vectors = std::get_if<std::vector<Vec3f>>(&attribute)) {
            auto vector = [&](std::size_t i) { return (*vectors)[corners.vertex[i]]; };
            if (name == kNormal)
                attributes["NORMAL"] = writer.floats(count, 3, "NORMAL", [&](std::size_t i, int k) {
                    // glTF wants unit vectors without exception
                    const Vec3d n = normalized(Vec3d(y_up(vector(i))));
                    return Vec3f(dot(n, n) > 0.5 ? n : Vec3d(0, 1, 0))[k];
                });
            else if (name == kColour)
                attributes["COLOR_0"] = writer.floats(
                    count, 3, "COLOR_0",
                    [&](std::size_t i, int k) { return std::clamp(vector(i)[k], 0.0f, 1.0f); });
            else
                attributes[taken(semantic(name))] = writer.floats(
                    count, 3, name, [&](std::size_t i, int k) { return vector(i)[k]; });
        } else
            attributes[taken(semantic(name))] =
                writer.floats(count, 1, name, [&](std::size_t i, int) {
                    const std::uint32_t v = corners.vertex[i];
                    const auto* numbers = std::get_if<std::vector<float>>(&attribute);
                    return numbers ? (*numbers)[v]
                                   : static_cast<float>(
                                         std::get<std::vector<std::int32_t>>(attribute)[v]);
                });
    }

    // Identities of faces hold for the split vertices; measures are the mean over the faces around.
    for (const auto& [name, attribute] : mesh.face_attributes) {
        if (const auto* ids = std::get_if<std::vector<std::int32_t>>(&attribute)) {
            attributes[taken(semantic(name))] =
                writer.floats(count, 1, name, [&](std::size_t i, int) {
                    return static_cast<float>((*ids)[corners.triangle[i]]);
                });
            continue;
        }
        if (mesh.vertex_attributes.contains(name)) continue;
        const auto* numbers = std::get_if<std::vector<float>>(&attribute);
        const int components = numbers ? 1 : 3;
        std::vector<Vec3d> sum(count);
        std::vector<double> faces(count, 0);
        for (std::size_t c = 0; c < corners.indices.size(); ++c) {
            progress.check();
            const std::uint32_t i = corners.indices[c];
            sum[i] += numbers ? Vec3d((*numbers)[c / 3], 0, 0)
                              : Vec3d(std::get<std::vector<Vec3f>>(attribute)[c / 3]);
            faces[i] += 1;
        }
        attributes[taken(semantic(name))] = writer.floats(
            count, components, name,
            [&](std::size_t i, int k) { return static_cast<float>(sum[i][k] / faces[i]); });
    }
    const int indices = writer.indices(corners.indices);
    return writer.finish(std::move(attributes), indices);
}

}  // namespace sekitei::mesh_format
