#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/exchange/assembly.h"
#include "core/gltf.h"

namespace sekitei::apps {
namespace {

using gltf::File;
using gltf::semantic;

/// Three digits are enough for a colour.
double rounded(float x)
{
    return std::round(static_cast<double>(x) * 1000) / 1000;
}

Json material_json(const SurfaceMaterial& material)
{
    Json json = {
        {"name", material.name},
        {"pbrMetallicRoughness",
         {{"baseColorFactor",
           {rounded(material.colour.x), rounded(material.colour.y), rounded(material.colour.z), 1}},
          {"metallicFactor", 0},
          {"roughnessFactor", rounded(material.roughness)}}}};
    if (material.double_sided) json["doubleSided"] = true;
    return json;
}

Json field_json(const FieldInfo& field)
{
    return {{"name", field.name}, {"unit", field.unit}, {"low", field.low}, {"high", field.high}};
}

/// Accessors of the copies of one prototype.
Json copies_json(File& file, const CopySet& set, std::size_t prototype)
{
    const std::uint32_t* const rows = set.order.data() + set.first[prototype];
    const std::size_t count = set.first[prototype + 1] - set.first[prototype];
    auto add = [&](int components, const std::string& name, auto put) {
        return file.floats(count, components, File::Use::Copies, name,
                           [=](std::size_t begin, std::size_t end, float* to) {
                               for (std::size_t i = begin; i < end; ++i, to += components)
                                   put(rows[i], to);
                           });
    };
    // A copy's own space is turned like the world: R becomes C R C', S swaps y and z.
    Json attributes;
    attributes["TRANSLATION"] = add(3, "TRANSLATION", [&set](std::size_t row, float* to) {
        const Vec3f p = gltf::y_up(Vec3f(set.points->position[row]));
        to[0] = p.x;
        to[1] = p.y;
        to[2] = p.z;
    });
    attributes["ROTATION"] = add(4, "ROTATION", [&set](std::size_t row, float* to) {
        const auto q = set.at(row).orient;
        const Vec3f v = gltf::y_up({q[0], q[1], q[2]});
        to[0] = v.x;
        to[1] = v.y;
        to[2] = v.z;
        to[3] = q[3];
    });
    attributes["SCALE"] = add(3, "SCALE", [&set](std::size_t row, float* to) {
        const Vec3f s = set.at(row).scale;
        to[0] = s.x;
        to[1] = s.z;
        to[2] = s.y;
    });
    attributes["_ID"] = add(2, "_ID", [&set](std::size_t row, float* to) {
        const auto id = static_cast<std::uint64_t>(set.id(row));
        to[0] = static_cast<float>(id & 0xFFFFFF);
        to[1] = static_cast<float>(id >> 24 & 0xFFFFFF);
    });
    for (const CopySet::Column& column : set.columns) {
        const std::string name = semantic(column.info.name);
        if (attributes.contains(name)) continue;
        const auto* floats = std::get_if<std::vector<float>>(column.values);
        const auto* whole = std::get_if<std::vector<std::int32_t>>(column.values);
        attributes[name] = add(1, column.info.name, [=](std::size_t row, float* to) {
            *to = floats ? (*floats)[row] : static_cast<float>((*whole)[row]);
        });
    }
    return attributes;
}

}  // namespace

void write_glb(const Assembly& assembly, const Sink& sink, const Progress& progress)
{
    File file;
    Json nodes = Json::array({{{"name", "sekitei"}}}), meshes = Json::array(),
         materials = Json::array(), children = Json::array();
    for (const SurfaceMaterial& material : assembly.materials)
        materials.push_back(material_json(material));
    auto add_node = [&](const std::string& name, Json primitives, Json extras) -> Json& {
        meshes.push_back({{"name", name}, {"primitives", std::move(primitives)}});
        children.push_back(nodes.size());
        nodes.push_back({{"name", name},
                         {"mesh", meshes.size() - 1},
                         {"extras", {{"sekitei", std::move(extras)}}}});
        return nodes.back();
    };
    auto primitive_of = [&](const TriMesh& mesh, std::size_t material,
                            const std::vector<gltf::VertexField>& fields) {
        Json primitive = gltf::add_primitive(file, mesh, fields, true, progress);
        primitive["material"] = material;
        return primitive;
    };
    for (const Surface& surface : assembly.surfaces) {
        std::vector<gltf::VertexField> fields;
        for (const auto& [name, values] : surface.fields) fields.emplace_back(name, &values);
        add_node(surface.name,
                 Json::array({primitive_of(surface.mesh(), surface.material, fields)}),
                 {{"kind", surface.kind}});
    }
    Json copies = Json::object();
    for (const CopySet& set : assembly.sets) {
        Json columns = Json::object();
        for (const CopySet::Column& column : set.columns)
            columns[semantic(column.info.name)] = field_json(column.info);
        copies[set.name] = {{"count", set.count()}, {"attributes", std::move(columns)}};
        for (std::size_t p = 0; p < set.prototypes.size(); ++p) {
            const CopiedModel& model = set.prototypes[p];
            if (set.first[p] == set.first[p + 1] || model.parts.empty()) continue;
            Json primitives = Json::array();
            for (const PrototypePart& part : model.parts)
                primitives.push_back(primitive_of(part.mesh, part.material, {}));
            Json& node = add_node(set.name + "/" + model.name, std::move(primitives),
                                  {{"kind", "instances"},
                                   {"set", set.name},
                                   {"prototype", model.name},
                                   {"species", model.species}});
            node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = copies_json(file, set, p);
        }
    }
    nodes[0]["children"] = std::move(children);
    Json fields = Json::object();
    for (const auto& [name, field] : assembly.fields)
        if (name.rfind("uv_", 0) != 0) fields[semantic(name)] = field_json(field);
    Json document = {{"asset",
                      {{"version", "2.0"},
                       {"generator", "Sekitei"},
                       {"extras",
                        {{"sekitei",
                          {{"version", SEKITEI_VERSION},
                           {"fields", std::move(fields)},
                           {"instances", std::move(copies)},
                           {"species", assembly.species}}}}}}},
                     {"scene", 0},
                     {"scenes", {{{"name", "sekitei"}, {"nodes", {0}}}}},
                     {"nodes", std::move(nodes)},
                     {"meshes", std::move(meshes)},
                     {"materials", std::move(materials)}};
    if (!assembly.sets.empty()) document["extensionsUsed"] = {"EXT_mesh_gpu_instancing"};
    file.write(std::move(document), sink, progress);
}

std::string encode_glb(const Assembly& assembly, const Progress& progress)
{
    std::string bytes;
    write_glb(
        assembly, [&](std::string_view part) { bytes += part; }, progress);
    return bytes;
}

}  // namespace sekitei::apps
