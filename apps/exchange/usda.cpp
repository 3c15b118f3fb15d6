#include <algorithm>
#include <cmath>
#include <set>

#include "apps/exchange/assembly.h"
#include "apps/exchange/text.h"
#include "core/mesh_formats.h"

namespace sekitei::apps {
namespace {

template <class... Args>
void append(std::string& text, fmt::format_string<Args...> format, Args&&... args)
{
    fmt::format_to(std::back_inserter(text), format, std::forward<Args>(args)...);
}

/// USD writes infinities and NaN in words that not every reader knows.
float finite(float x)
{
    return std::isfinite(x) ? x + 0.0f : 0.0f;
}

void put_scalar(std::string& text, float x)
{
    append(text, "{}", finite(x));
}
void put_scalar(std::string& text, std::int32_t x)
{
    append(text, "{}", x);
}
void put_scalar(std::string& text, Vec3f v)
{
    append(text, "({}, {}, {})", finite(v.x), finite(v.y), finite(v.z));
}

/// A primvar by interpolation: "vertex", "uniform" ...
template <class T>
void put_primvar(TextOut& out, const std::string& pad, const std::string& name,
                 const std::vector<T>& values, const char* interpolation)
{
    const char* const type = std::is_same_v<T, float>          ? "float"
                             : std::is_same_v<T, std::int32_t> ? "int"
                                                               : "float3";
    put_usd_list(out, pad, fmt::format("{}[] primvars:{}", type, usd_identifier(name)),
                 values.size(),
                 [&](std::size_t i, std::string& text) { put_scalar(text, values[i]); });
    out.put(" (\n{}    interpolation = \"{}\"\n{})\n", pad, interpolation, pad);
}

/// The prims of a file have names of their own below one parent.
class Names {
public:
    std::string take(const std::string& name)
    {
        std::string own = usd_identifier(name);
        for (int k = 1; !taken_.insert(own).second; ++k)
            own = fmt::format("{}_{}", usd_identifier(name), k);
        return own;
    }

private:
    std::set<std::string> taken_;
};

void put_mesh(TextOut& out, const std::string& pad, const std::string& name, const TriMesh& mesh,
              const std::map<std::string, std::vector<float>>& fields,
              const SurfaceMaterial& material)
{
    const std::string inner = pad + "    ";
    out.put("{}def Mesh \"{}\" (\n{}    prepend apiSchemas = [\"MaterialBindingAPI\"]\n{})\n{}{{\n",
            pad, name, pad, pad, pad);
    if (material.double_sided) out.put("{}uniform bool doubleSided = 1\n", inner);
    put_usd_triangles(out, inner, mesh, mesh.bounds());
    out.put("{}rel material:binding = </sekitei/materials/{}>\n", inner,
            usd_identifier(material.name));
    const auto texture = mesh_format::texture_of(mesh);
    for (const auto& [name_, attribute] : mesh.vertex_attributes) {
        if (name_ == mesh_format::kNormal) {
            if (const auto* normals = std::get_if<std::vector<Vec3f>>(&attribute)) {
                put_usd_list(
                    out, inner, "normal3f[] normals", normals->size(),
                    [&](std::size_t i, std::string& text) { put_scalar(text, (*normals)[i]); });
                out.put(" (\n{}    interpolation = \"vertex\"\n{})\n", inner, inner);
            }
            continue;
        }
        if (name_ == mesh_format::kColour) {
            if (const auto* colours = std::get_if<std::vector<Vec3f>>(&attribute)) {
                put_usd_list(out, inner, "color3f[] primvars:displayColor", colours->size(),
                             [&](std::size_t i, std::string& text) {
                                 const Vec3f c = (*colours)[i];
                                 put_scalar(text,
                                            Vec3f(c.x * material.colour.x, c.y * material.colour.y,
                                                  c.z * material.colour.z));
                             });
                out.put(" (\n{}    interpolation = \"vertex\"\n{})\n", inner, inner);
            }
            continue;
        }
        std::visit([&, called = name_](
                       const auto& values) { put_primvar(out, inner, called, values, "vertex"); },
                   attribute);
    }
    if (!mesh.vertex_attributes.contains(mesh_format::kColour))
        out.put("{}color3f[] primvars:displayColor = [({:.3f}, {:.3f}, {:.3f})]\n", inner,
                material.colour.x, material.colour.y, material.colour.z);
    for (const auto& [name_, values] : fields) put_primvar(out, inner, name_, values, "vertex");
    for (const auto& [name_, attribute] : mesh.face_attributes) {
        if (fields.contains(name_) || mesh.vertex_attributes.contains(name_)) continue;
        if (texture[0] && name_.starts_with("uv_")) continue;
        std::visit([&, called = name_](
                       const auto& values) { put_primvar(out, inner, called, values, "uniform"); },
                   attribute);
    }
    if (texture[0]) {
        put_usd_list(out, inner, "texCoord2f[] primvars:st", 3 * mesh.triangles.size(),
                     [&](std::size_t c, std::string& text) {
                         const Vec3f uv = (*texture[c % 3])[c / 3];
                         append(text, "({}, {})", finite(uv.x), finite(uv.y));
                     });
        out.put(" (\n{}    interpolation = \"faceVarying\"\n{})\n", inner, inner);
    }
    out.put("{}uniform token subdivisionScheme = \"none\"\n{}}}\n", inner, pad);
}

void put_materials(TextOut& out, const std::vector<SurfaceMaterial>& materials)
{
    out.put("    def Scope \"materials\"\n    {{\n");
    for (const SurfaceMaterial& m : materials) {
        const std::string name = usd_identifier(m.name);
        out.put(
            "        def Material \"{0}\"\n        {{\n"
            "            token outputs:surface.connect = "
            "</sekitei/materials/{0}/shader.outputs:surface>\n\n"
            "            def Shader \"shader\"\n            {{\n"
            "                uniform token info:id = \"UsdPreviewSurface\"\n"
            "                color3f inputs:diffuseColor = ({1:.3f}, {2:.3f}, {3:.3f})\n"
            "                float inputs:metallic = 0\n"
            "                float inputs:roughness = {4:.3g}\n"
            "                token outputs:surface\n            }}\n        }}\n",
            name, m.colour.x, m.colour.y, m.colour.z, m.roughness);
    }
    out.put("    }}\n");
}

void put_copies(TextOut& out, const CopySet& set, const std::string& name,
                const std::vector<SurfaceMaterial>& materials)
{
    // Whatever way a copy is turned, it stays within this.
    std::vector<double> reach(set.prototypes.size(), 0);
    for (std::size_t p = 0; p < reach.size(); ++p)
        for (const PrototypePart& part : set.prototypes[p].parts)
            for (const Vec3f& v : part.mesh.vertices)
                reach[p] = std::max(reach[p], length(Vec3d(v)));
    Bounds extent;
    for (std::size_t p = 0; p < reach.size(); ++p)
        for (std::uint32_t k = set.first[p]; k < set.first[p + 1]; ++k) {
            const Placement at = set.at(set.order[k]);
            const double r = reach[p] * double(std::max({at.scale.x, at.scale.y, at.scale.z}));
            extent.add(at.position - Vec3d(r));
            extent.add(at.position + Vec3d(r));
        }
    const std::string pad(8, ' ');
    const std::size_t count = set.count();
    out.put("\n    def PointInstancer \"{}\"\n    {{\n", name);
    out.put("{}float3[] extent = [({:.6g}, {:.6g}, {:.6g}), ({:.6g}, {:.6g}, {:.6g})]\n", pad,
            extent.lower.x, extent.lower.y, extent.lower.z, extent.upper.x, extent.upper.y,
            extent.upper.z);
    // Some readers refuse a sign here.
    put_usd_list(out, pad, "int64[] ids", count, [&](std::size_t k, std::string& text) {
        append(text, "{}", static_cast<std::uint64_t>(set.id(set.order[k])) & ~(1ull << 63));
    });
    out.put("\n");
    put_usd_list(out, pad, "quath[] orientations", count, [&](std::size_t k, std::string& text) {
        const auto q = set.at(set.order[k]).orient;  // the real part first
        append(text, "({:.5g}, {:.5g}, {:.5g}, {:.5g})", finite(q[3]), finite(q[0]), finite(q[1]),
               finite(q[2]));
    });
    out.put("\n");
    put_usd_list(out, pad, "point3f[] positions", count, [&](std::size_t k, std::string& text) {
        put_scalar(text, Vec3f(set.points->position[set.order[k]]));
    });
    out.put("\n");
    for (const CopySet::Column& column : set.columns)
        std::visit(
            [&](const auto& values) {
                using T = typename std::decay_t<decltype(values)>::value_type;
                if constexpr (std::is_same_v<T, float> || std::is_same_v<T, std::int32_t>) {
                    put_usd_list(
                        out, pad,
                        fmt::format("{}[] primvars:{}", std::is_same_v<T, float> ? "float" : "int",
                                    usd_identifier(column.info.name)),
                        count, [&](std::size_t k, std::string& text) {
                            put_scalar(text, values[set.order[k]]);
                        });
                    out.put(" (\n{}    interpolation = \"vertex\"\n{})\n", pad, pad);
                }
            },
            *column.values);
    std::vector<std::uint32_t> ends(set.first.begin() + 1, set.first.end());
    put_usd_list(out, pad, "int[] protoIndices", count, [&](std::size_t k, std::string& text) {
        append(text, "{}", std::upper_bound(ends.begin(), ends.end(), k) - ends.begin());
    });
    Names names;
    std::vector<std::string> prims;
    for (const CopiedModel& model : set.prototypes) prims.push_back(names.take(model.name));
    out.put("\n{}rel prototypes = [", pad);
    for (std::size_t p = 0; p < prims.size(); ++p)
        out.put("{}</sekitei/{}/prototypes/{}>", p > 0 ? ", " : "", name, prims[p]);
    out.put("]\n");
    put_usd_list(out, pad, "float3[] scales", count, [&](std::size_t k, std::string& text) {
        put_scalar(text, set.at(set.order[k]).scale);
    });
    out.put("\n\n{}def Scope \"prototypes\"\n{}{{\n", pad, pad);
    for (std::size_t p = 0; p < prims.size(); ++p) {
        out.check();
        out.put("            def Xform \"{}\"\n            {{\n", prims[p]);
        Names parts;
        for (const PrototypePart& part : set.prototypes[p].parts)
            put_mesh(out, std::string(16, ' '), parts.take(materials[part.material].name),
                     part.mesh, {}, materials[part.material]);
        out.put("            }}\n");
    }
    out.put("{}}}\n    }}\n", pad);
}

}  // namespace

void write_usda(const Assembly& assembly, const Sink& sink, const Progress& progress)
{
    TextOut out(sink, progress);
    out.put(
        "#usda 1.0\n(\n    defaultPrim = \"sekitei\"\n    doc = \"A scene by Sekitei\"\n"
        "    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\ndef Xform \"sekitei\"\n{{\n");
    Names names;
    names.take("materials");
    put_materials(out, assembly.materials);
    for (const Surface& surface : assembly.surfaces) {
        out.check();
        out.put("\n");
        put_mesh(out, "    ", names.take(surface.name), surface.mesh(), surface.fields,
                 assembly.materials[surface.material]);
    }
    for (const CopySet& set : assembly.sets)
        put_copies(out, set, names.take(set.name), assembly.materials);
    out.put("}}\n");
    out.flush();
}

}  // namespace sekitei::apps
