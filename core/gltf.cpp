#include "core/gltf.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/log.h"
#include "core/mesh_formats.h"
#include "core/parallel.h"

namespace sekitei::gltf {
namespace {

using Json = nlohmann::json;
using mesh_format::kColour;
using mesh_format::kNormal;

enum : int { kFloat = 5126, kUnsignedInt = 5125, kArrayBuffer = 34962, kElementBuffer = 34963 };

static_assert(std::endian::native == std::endian::little, "glTF is written as it lies in memory");

void append32(std::string& out, std::uint64_t bits)
{
    for (int i = 0; i < 4; ++i) out += static_cast<char>(bits >> 8 * i & 0xFF);
}

/// The corners of triangles as glTF vertices: one for each vertex, set of face identities and place
/// in the texture.
struct Split {
    std::vector<std::uint32_t> indices;  ///< three a triangle
    std::vector<std::uint32_t> vertex;   ///< of the mesh, for each glTF vertex
    std::vector<std::uint32_t> corner;   ///< one that uses it, 3 t + k: its faces' attributes

    std::uint32_t triangle(std::size_t i) const { return corner[i] / 3; }
};

using Texture = decltype(mesh_format::texture_of(std::declval<const TriMesh&>()));

Split split(const TriMesh& mesh, const std::vector<const std::vector<std::int32_t>*>& identities,
            const Texture& texture, const Progress& progress)
{
    // Copies of a vertex form a short list: a mesh vertex meets few columns.
    constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
    if (mesh.triangles.size() > kNone / 3)
        throw LimitExceeded(fmt::format("glb: {} triangles, at most 1.43 billion are possible",
                                        mesh.triangles.size()));
    Split out;
    std::vector<std::uint32_t> first(mesh.vertices.size(), kNone), next;
    out.indices.reserve(3 * mesh.triangles.size());
    for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) {
        if (t % 4096 == 0) progress.check();
        for (std::uint32_t k = 0; k < 3; ++k) {
            const std::uint32_t v = mesh.triangles[t][k], corner = 3 * t + k;
            auto same = [&](std::uint32_t copy) {
                const std::uint32_t other = out.corner[copy];
                return std::all_of(
                           identities.begin(), identities.end(),
                           [&](const auto* ids) { return (*ids)[other / 3] == (*ids)[t]; }) &&
                       (!texture[0] || (*texture[other % 3])[other / 3] == (*texture[k])[t]);
            };
            std::uint32_t* link = &first[v];
            while (*link != kNone && !same(*link)) link = &next[*link];
            if (*link == kNone) {
                const auto copy = static_cast<std::uint32_t>(out.vertex.size());
                *link = copy;  // before `next` grows and moves
                out.vertex.push_back(v);
                out.corner.push_back(corner);
                next.push_back(kNone);
                out.indices.push_back(copy);
            } else
                out.indices.push_back(*link);
        }
    }
    return out;
}

std::vector<Vec3f> smooth_normals(const TriMesh& mesh, const Split& corners)
{
    std::vector<Vec3d> sum(corners.vertex.size());
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
        const Vec3d a(mesh.vertices[mesh.triangles[t][0]]);
        const Vec3d n = cross(Vec3d(mesh.vertices[mesh.triangles[t][1]]) - a,
                              Vec3d(mesh.vertices[mesh.triangles[t][2]]) - a);
        for (std::size_t k = 0; k < 3; ++k) sum[corners.indices[3 * t + k]] += n;
    }
    std::vector<Vec3f> normals(sum.size());
    for (std::size_t i = 0; i < sum.size(); ++i) normals[i] = Vec3f(normalized(sum[i]));
    return normals;
}

/// glTF wants unit vectors without exception.
Vec3f unit_y_up(Vec3f v)
{
    const Vec3d n = normalized(Vec3d(y_up(v)));
    return Vec3f(dot(n, n) > 0.5 ? n : Vec3d(0, 1, 0));
}

}  // namespace

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

int File::floats(std::size_t count, int components, Use use, const std::string& name, Fill fill,
                 const std::optional<Range>& range)
{
    accessors_.push_back({count, components, use, name, std::move(fill), nullptr, range});
    return static_cast<int>(accessors_.size()) - 1;
}

int File::indices(std::shared_ptr<const std::vector<std::uint32_t>> values)
{
    const std::size_t count = values->size();
    accessors_.push_back({count, 1, Use::Indices, "indices", {}, std::move(values), {}});
    return static_cast<int>(accessors_.size()) - 1;
}

void File::write(Json document, const std::function<void(std::string_view)>& sink,
                 const Progress& progress) const
{
    static constexpr const char* kShapes[] = {"", "SCALAR", "VEC2", "VEC3", "VEC4"};
    Json accessors = Json::array(), views = Json::array();
    std::uint64_t size = 0;
    for (const Accessor& a : accessors_) {
        Json view = {{"buffer", 0}, {"byteOffset", size}, {"byteLength", a.bytes()}};
        if (a.use != Use::Copies)
            view["target"] = a.use == Use::Indices ? int(kElementBuffer) : int(kArrayBuffer);
        views.push_back(std::move(view));
        Json accessor = {{"bufferView", accessors.size()},
                         {"componentType", a.indices ? int(kUnsignedInt) : int(kFloat)},
                         {"count", a.count},
                         {"type", kShapes[a.components]}};
        if (a.range) {
            accessor["min"] = a.range->first;
            accessor["max"] = a.range->second;
        }
        accessors.push_back(std::move(accessor));
        size += a.bytes();
    }
    document["accessors"] = std::move(accessors);
    document["bufferViews"] = std::move(views);
    document["buffers"] = {{{"byteLength", size}}};
    std::string text = document.dump(-1, ' ', false, Json::error_handler_t::replace);
    text.resize((text.size() + 3) / 4 * 4, ' ');
    const std::uint64_t total = 12 + 8 + text.size() + 8 + size;
    if (total > std::numeric_limits<std::uint32_t>::max())
        throw LimitExceeded(fmt::format("glb: {} of data, at most 4.29 GB: split the mesh",
                                        bytes_text(static_cast<double>(total))));
    std::string head;
    append32(head, 0x46546C67);  // "glTF"
    append32(head, 2);
    append32(head, total);
    append32(head, text.size());
    append32(head, 0x4E4F534A);  // "JSON"
    head += text;
    append32(head, size);
    append32(head, 0x004E4942);  // "BIN"
    sink(head);

    constexpr std::size_t kBlock = 1 << 18;  // elements
    std::vector<float> block;
    std::uint64_t written = 0;
    for (const Accessor& a : accessors_) {
        double replaced = 0;
        const auto components = static_cast<std::size_t>(a.components);
        for (std::size_t begin = 0; begin < a.count; begin += kBlock) {
            progress.update(size > 0 ? double(written) / double(size) : 1);
            const std::size_t end = std::min(a.count, begin + kBlock);
            if (a.indices) {
                sink({reinterpret_cast<const char*>(a.indices->data() + begin), 4 * (end - begin)});
            } else {
                block.resize((end - begin) * components);
                replaced += parallel_fold(
                    end - begin, 8192, 0.0,
                    [&](std::size_t from, std::size_t to) {
                        float* const values = block.data() + from * components;
                        a.fill(begin + from, begin + to, values);
                        double count = 0;
                        for (std::size_t i = 0; i < (to - from) * components; ++i) {
                            float& x = values[i];
                            if (!std::isfinite(x)) {
                                x = std::isnan(x) ? 0
                                    : x > 0       ? std::numeric_limits<float>::max()
                                                  : std::numeric_limits<float>::lowest();
                                ++count;
                            }
                            x += 0.0f;  // no negative zero: it would print as -0.0
                        }
                        return count;
                    },
                    [](double x, double y) { return x + y; });
                sink({reinterpret_cast<const char*>(block.data()), 4 * block.size()});
            }
            written += 4 * (end - begin) * components;
        }
        if (replaced > 0)
            log::warning(
                "glb: {} values of {} are not finite, which glTF forbids; written as 0 or "
                "the largest float",
                replaced, a.name);
    }
}

Json add_primitive(File& file, const TriMesh& mesh, const std::vector<VertexField>& fields,
                   bool normals, const Progress& progress)
{
    std::vector<const std::vector<std::int32_t>*> identities;
    for (const auto& [name, attribute] : mesh.face_attributes)
        if (const auto* ids = std::get_if<std::vector<std::int32_t>>(&attribute))
            identities.push_back(ids);
    const Texture texture = mesh_format::texture_of(mesh);
    const auto corners = std::make_shared<const Split>(split(mesh, identities, texture, progress));
    const std::size_t count = corners->vertex.size();

    Json attributes;
    auto add = [&](const std::string& name, const std::string& shown, int components,
                   File::Fill fill, const std::optional<Range>& range = {}) {
        if (attributes.contains(name))
            throw InvalidInput(
                fmt::format("glb: two attributes would be called {}: rename one of them", name));
        attributes[name] =
            file.floats(count, components, File::Use::Vertices, shown, std::move(fill), range);
    };
    /// One value or vector for each glTF vertex.
    auto scalars = [&](const std::string& name, const std::string& shown, auto value) {
        add(name, shown, 1, [=](std::size_t begin, std::size_t end, float* to) {
            for (std::size_t i = begin; i < end; ++i) *to++ = value(i);
        });
    };
    auto vectors = [&](const std::string& name, const std::string& shown, auto value,
                       const std::optional<Range>& range = {}) {
        add(
            name, shown, 3,
            [=](std::size_t begin, std::size_t end, float* to) {
                for (std::size_t i = begin; i < end; ++i) {
                    const Vec3f v = value(i);
                    *to++ = v.x;
                    *to++ = v.y;
                    *to++ = v.z;
                }
            },
            range);
    };

    const Vec3f* const positions = mesh.vertices.data();
    Vec3f lower(std::numeric_limits<float>::infinity()), upper(-lower.x);
    for (const std::uint32_t v : corners->vertex) {
        const Vec3f p = y_up(positions[v]) + Vec3f(0);
        lower = min(lower, p);
        upper = max(upper, p);
    }
    auto numbers = [](Vec3f v) {
        return std::vector<double>{double(v.x), double(v.y), double(v.z)};
    };
    vectors(
        "POSITION", "POSITION", [=](std::size_t i) { return y_up(positions[corners->vertex[i]]); },
        Range{numbers(lower), numbers(upper)});

    if (normals && !mesh.vertex_attributes.contains(kNormal)) {
        const auto own = std::make_shared<const std::vector<Vec3f>>(smooth_normals(mesh, *corners));
        vectors("NORMAL", "NORMAL", [=](std::size_t i) { return unit_y_up((*own)[i]); });
    }
    if (texture[0])
        add("TEXCOORD_0", "TEXCOORD_0", 2, [=](std::size_t begin, std::size_t end, float* to) {
            for (std::size_t i = begin; i < end; ++i) {
                const std::uint32_t c = corners->corner[i];
                const Vec3f uv = (*texture[c % 3])[c / 3];
                *to++ = uv.x;
                *to++ = 1 - uv.y;  // pictures begin at the top
            }
        });

    // A surface may carry one name twice, on vertices and on faces: identities are the faces' own,
    // measures are sharper at vertices.
    auto identity = [&](const std::string& name) {
        const auto found = mesh.face_attributes.find(name);
        return found != mesh.face_attributes.end() &&
               std::holds_alternative<std::vector<std::int32_t>>(found->second);
    };
    for (const auto& [name, attribute] : mesh.vertex_attributes) {
        if (identity(name)) continue;
        if (const auto* list = std::get_if<std::vector<Vec3f>>(&attribute)) {
            auto vector = [=](std::size_t i) { return (*list)[corners->vertex[i]]; };
            if (name == kNormal)
                vectors("NORMAL", "NORMAL", [=](std::size_t i) { return unit_y_up(vector(i)); });
            else if (name == kColour)
                vectors("COLOR_0", "COLOR_0", [=](std::size_t i) {
                    return min(max(vector(i), Vec3f(0.0f)), Vec3f(1.0f));
                });
            else
                vectors(semantic(name), name, vector);
        } else if (const auto* values = std::get_if<std::vector<float>>(&attribute))
            scalars(semantic(name), name,
                    [=](std::size_t i) { return (*values)[corners->vertex[i]]; });
        else {
            const auto* ids = std::get_if<std::vector<std::int32_t>>(&attribute);
            scalars(semantic(name), name,
                    [=](std::size_t i) { return static_cast<float>((*ids)[corners->vertex[i]]); });
        }
    }
    for (const auto& [name, values] : fields) {
        const std::vector<float>* const list = values;
        scalars(semantic(name), name, [=](std::size_t i) { return (*list)[corners->vertex[i]]; });
    }

    // Identities of faces hold for the split vertices; measures are the mean over the faces around.
    for (const auto& [name, attribute] : mesh.face_attributes) {
        if (const auto* ids = std::get_if<std::vector<std::int32_t>>(&attribute)) {
            scalars(semantic(name), name, [=](std::size_t i) {
                return static_cast<float>((*ids)[corners->triangle(i)]);
            });
            continue;
        }
        if (mesh.vertex_attributes.contains(name)) continue;
        const auto is = [called = name](const char* other) { return called == other; };
        if (texture[0] &&
            std::any_of(std::begin(mesh_format::kTexture), std::end(mesh_format::kTexture), is))
            continue;
        const auto* measures = std::get_if<std::vector<float>>(&attribute);
        std::vector<Vec3d> sum(count);
        std::vector<double> faces(count, 0);
        for (std::size_t c = 0; c < corners->indices.size(); ++c) {
            if (c % 4096 == 0) progress.check();
            const std::uint32_t i = corners->indices[c];
            sum[i] += measures ? Vec3d((*measures)[c / 3], 0, 0)
                               : Vec3d(std::get<std::vector<Vec3f>>(attribute)[c / 3]);
            faces[i] += 1;
        }
        const auto mean = std::make_shared<std::vector<Vec3f>>(count);
        for (std::size_t i = 0; i < count; ++i) (*mean)[i] = Vec3f(sum[i] / faces[i]);
        if (measures)
            scalars(semantic(name), name, [=](std::size_t i) { return (*mean)[i].x; });
        else
            vectors(semantic(name), name, [=](std::size_t i) { return (*mean)[i]; });
    }
    // The list of indices lives with the rest.
    const int list =
        file.indices(std::shared_ptr<const std::vector<std::uint32_t>>(corners, &corners->indices));
    return {{"attributes", std::move(attributes)}, {"indices", list}, {"mode", 4}};
}

}  // namespace sekitei::gltf
