#include <fmt/format.h>

#include <cmath>
#include <set>

#include "apps/commands/commands.h"
#include "apps/console.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/mesh_io.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

double distance(float a, float b)
{
    return std::abs(double(a) - double(b));
}
double distance(std::int32_t a, std::int32_t b)
{
    return std::abs(double(a) - double(b));
}
double distance(Vec3f a, Vec3f b)
{
    return length(Vec3d(a) - Vec3d(b));
}

/// How two grids of one type differ; empty if by no more than the tolerance.
template <class T>
std::string compare(const LeafGrid<T>& a, const LeafGrid<T>& b, double tolerance)
{
    if (!(a.transform() == b.transform()))
        return fmt::format("transforms differ: voxel {} m and {} m", a.transform().voxel,
                           b.transform().voxel);
    std::set<Coord> origins(a.topology()->origins().begin(), a.topology()->origins().end());
    origins.insert(b.topology()->origins().begin(), b.topology()->origins().end());
    GridReader<T> in_a(a), in_b(b);
    double worst = 0;
    std::uint64_t values = 0, states = 0;
    Coord where;
    for (const Coord& origin : origins)
        for (int offset = 0; offset < kLeafSize; ++offset) {
            const Coord c = leaf_coord(origin, offset);
            if (in_a.active(c) != in_b.active(c)) ++states;
            const double d = distance(in_a.value(c), in_b.value(c));
            if (!(d <= tolerance)) {
                ++values;
                if (!(d <= worst)) {
                    worst = d;
                    where = c;
                }
            }
        }
    if (values == 0 && states == 0) return "";
    return fmt::format(
        "{} values differ, by up to {} at voxel {},{},{}; {} voxels active in one only", values,
        worst, where.x, where.y, where.z, states);
}

std::vector<std::string> diff_scenes(const Scene& a, const Scene& b, double tolerance)
{
    std::vector<std::string> found;
    std::set<std::string> names;
    for (const auto& [name, grid] : a.grids) names.insert(name);
    for (const auto& [name, grid] : b.grids) names.insert(name);
    for (const std::string& name : names) {
        if (!a.grids.contains(name) || !b.grids.contains(name)) {
            found.push_back(fmt::format("grid '{}' is only in the {} file", name,
                                        a.grids.contains(name) ? "first" : "second"));
            continue;
        }
        const Grid &g = a.grids.at(name), &h = b.grids.at(name);
        if (g.type_name() != h.type_name()) {
            found.push_back(fmt::format("grid '{}': types differ: {} and {}", name, g.type_name(),
                                        h.type_name()));
            continue;
        }
        if (content_hash(g) == content_hash(h)) continue;
        std::string text = "contents differ";
        if (const auto* f = std::get_if<FloatGrid>(&g.values))
            text = compare(*f, std::get<FloatGrid>(h.values), tolerance);
        else if (const auto* i = std::get_if<IntGrid>(&g.values))
            text = compare(*i, std::get<IntGrid>(h.values), tolerance);
        else if (const auto* v = std::get_if<VectorGrid>(&g.values))
            text = compare(*v, std::get<VectorGrid>(h.values), tolerance);
        if (!text.empty()) found.push_back(fmt::format("grid '{}': {}", name, text));
    }
    std::set<std::string> points;
    for (const auto& [name, p] : a.points) points.insert(name);
    for (const auto& [name, p] : b.points) points.insert(name);
    for (const std::string& name : points) {
        if (!a.points.contains(name) || !b.points.contains(name))
            found.push_back(fmt::format("points '{}' are only in the {} file", name,
                                        a.points.contains(name) ? "first" : "second"));
        else if (content_hash(a.points.at(name)) != content_hash(b.points.at(name)))
            found.push_back(fmt::format("points '{}' differ: {} and {} points", name,
                                        a.points.at(name).position.size(),
                                        b.points.at(name).position.size()));
    }
    return found;
}

}  // namespace

int command_diff(const std::string& a, const std::string& b, double tolerance, const Common& common)
{
    std::vector<std::string> found;
    const Progress progress = console_progress("diff");
    auto is_scene = [](const std::string& name) {
        return std::filesystem::path(name).extension() == ".vdb";
    };
    if (is_scene(a) && is_scene(b))
        found = diff_scenes(read_vdb(a, {}, progress), read_vdb(b, {}, progress), tolerance);
    else if (!is_scene(a) && !is_scene(b)) {
        const TriMesh x = read_mesh(a), y = read_mesh(b);
        if (x.vertices.size() != y.vertices.size() || x.triangles.size() != y.triangles.size())
            found.push_back(fmt::format("{} and {} vertices, {} and {} triangles",
                                        x.vertices.size(), y.vertices.size(), x.triangles.size(),
                                        y.triangles.size()));
        else {
            double worst = 0;
            for (std::size_t i = 0; i < x.vertices.size(); ++i)
                worst = std::max(worst, distance(x.vertices[i], y.vertices[i]));
            if (worst > tolerance)
                found.push_back(fmt::format("vertices differ by up to {} m", worst));
            if (x.triangles != y.triangles) found.emplace_back("triangles differ");
            if (x.face_attributes != y.face_attributes ||
                x.vertex_attributes != y.vertex_attributes)
                found.emplace_back("attributes differ");
        }
    } else
        throw InvalidParameter("diff: compare two scenes (.vdb) or two meshes");
    if (common.json)
        print(Json{{"a", a}, {"b", b}, {"differences", found}}.dump(2) + "\n");
    else
        for (const std::string& line : found) print(line + "\n");
    return found.empty() ? 0 : static_cast<int>(ExitCode::Differ);
}

}  // namespace sekitei::apps
