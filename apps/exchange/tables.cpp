#include <algorithm>
#include <cmath>
#include <limits>

#include "apps/exchange/assembly.h"
#include "apps/exchange/text.h"
#include "core/mesh_objects.h"

namespace sekitei::apps {
namespace {

template <class... Args>
void append(std::string& text, fmt::format_string<Args...> format, Args&&... args)
{
    fmt::format_to(std::back_inserter(text), format, std::forward<Args>(args)...);
}

/// Micrometres are enough for a place; no zeros behind.
void append_place(std::string& text, double x)
{
    const std::size_t first = text.size();
    append(text, "{:.6f}", x);
    std::size_t end = text.find_last_not_of('0') + 1;
    if (text[end - 1] == '.') --end;
    text.resize(end);
    if (std::string_view(text).substr(first) == "-0") text.replace(first, 2, "0");
}

/// Of all sets, in alphabetical order.
std::vector<std::string> column_names(const Assembly& assembly)
{
    std::vector<std::string> names;
    for (const CopySet& set : assembly.sets)
        for (const CopySet::Column& column : set.columns) names.push_back(column.info.name);
    std::ranges::sort(names);
    names.erase(std::unique(names.begin(), names.end()), names.end());
    return names;
}

}  // namespace

void write_instances_csv(const Assembly& assembly, const Sink& sink, const Progress& progress)
{
    TextOut out(sink, progress);
    out.put(
        "set,prototype,id,P_x,P_y,P_z,orient_x,orient_y,orient_z,orient_w,scale_x,scale_y,scale_z,"
        "pscale");
    const std::vector<std::string> names = column_names(assembly);
    for (const std::string& name : names) out.put(",{}", name);
    out.put("\n");
    for (const CopySet& set : assembly.sets) {
        std::vector<const Points::Attribute*> columns(names.size(), nullptr);
        for (const CopySet::Column& column : set.columns)
            columns[std::size_t(std::ranges::lower_bound(names, column.info.name) -
                                names.begin())] = column.values;
        std::vector<std::string> head;
        for (const CopiedModel& model : set.prototypes)
            head.push_back(fmt::format("{},{},", set.name, model.name));
        const std::vector<std::uint32_t> ends(set.first.begin() + 1, set.first.end());
        out.rows(set.count(), [&](std::size_t k, std::string& text) {
            const std::uint32_t row = set.order[k];
            const Placement at = set.at(row);
            text += head[std::size_t(std::upper_bound(ends.begin(), ends.end(), k) - ends.begin())];
            append(text, "{}", static_cast<std::uint64_t>(set.id(row)));
            for (int axis = 0; axis < 3; ++axis) {
                text += ',';
                append_place(text, at.position[axis]);
            }
            for (const float q : at.orient) append(text, ",{:.6g}", q + 0.0f);
            // A copy's size is pscale times scale.
            if (at.scale.x == at.scale.y && at.scale.x == at.scale.z)
                append(text, ",1,1,1,{:.7g}", at.scale.x);
            else
                append(text, ",{:.7g},{:.7g},{:.7g},1", at.scale.x, at.scale.y, at.scale.z);
            for (const Points::Attribute* values : columns) {
                text += ',';
                if (!values) continue;
                if (const auto* floats = std::get_if<std::vector<float>>(values))
                    append(text, "{:.7g}", (*floats)[row] + 0.0f);
                else if (const auto* whole = std::get_if<std::vector<std::int32_t>>(values))
                    append(text, "{}", (*whole)[row]);
            }
            text += '\n';
        });
    }
    out.flush();
}

void write_obj(const Assembly& assembly, const std::string& materials, const Sink& sink,
               const Progress& progress)
{
    TextOut out(sink, progress);
    out.put("# Sekitei: metres, z up\nmtllib {}\n", materials);
    ObjCounts counts;
    for (const Surface& surface : assembly.surfaces) {
        out.check();
        out.put("o {}\nusemtl {}\n", surface.name, assembly.materials[surface.material].name);
        out.flush();
        sink(obj_object(surface.mesh(), counts, progress));
    }
    out.flush();
}

std::string obj_materials(const Assembly& assembly)
{
    std::string text = "# Sekitei\n";
    for (const SurfaceMaterial& m : assembly.materials)
        append(text, "\nnewmtl {}\nKd {:.3f} {:.3f} {:.3f}\nPr {:.3g}\nPm 0\nillum 1\n", m.name,
               m.colour.x, m.colour.y, m.colour.z, m.roughness);
    return text;
}

TriMesh joined_surfaces(const Assembly& assembly)
{
    TriMesh all;
    std::vector<std::int32_t> part;
    /// Attributes of one mesh behind those of the ones before it, which may lack it.
    auto append_attribute = [](auto& to, const std::string& name, const auto& values,
                               std::size_t before) {
        using List = std::decay_t<decltype(values)>;
        auto [found, fresh] = to.try_emplace(name, List{});
        auto* list = std::get_if<List>(&found->second);
        if (!list) return;  // of another type there: that one is kept
        list->resize(before);
        list->insert(list->end(), values.begin(), values.end());
    };
    for (std::size_t s = 0; s < assembly.surfaces.size(); ++s) {
        const Surface& surface = assembly.surfaces[s];
        const TriMesh& mesh = surface.mesh();
        const std::size_t vertices = all.vertices.size(), faces = all.triangles.size();
        all.vertices.insert(all.vertices.end(), mesh.vertices.begin(), mesh.vertices.end());
        for (auto t : mesh.triangles) {
            for (std::uint32_t& v : t) v += static_cast<std::uint32_t>(vertices);
            all.triangles.push_back(t);
        }
        part.resize(all.triangles.size(), static_cast<std::int32_t>(s));
        for (const auto& [name, values] : mesh.vertex_attributes)
            std::visit(
                [&, called = name](const auto& list) {
                    append_attribute(all.vertex_attributes, called, list, vertices);
                },
                values);
        for (const auto& [name, values] : surface.fields)
            append_attribute(all.vertex_attributes, name, values, vertices);
        for (const auto& [name, values] : mesh.face_attributes)
            std::visit(
                [&, called = name](const auto& list) {
                    append_attribute(all.face_attributes, called, list, faces);
                },
                values);
    }
    auto even = [](auto& attributes, std::size_t count) {
        for (auto& [name, values] : attributes)
            std::visit([&](auto& list) { list.resize(count); }, values);
    };
    even(all.vertex_attributes, all.vertices.size());
    even(all.face_attributes, all.triangles.size());
    if (assembly.surfaces.size() > 1) all.face_attributes["part"] = std::move(part);
    return all;
}

}  // namespace sekitei::apps
