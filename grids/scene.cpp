#include "grids/scene.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "core/error.h"
#include "core/hash.h"
#include "grids/vdb_format.h"

namespace sekitei {
namespace {

template <class... F>
struct Overloaded : F... {
    using F::operator()...;
};
template <class... F>
Overloaded(F...) -> Overloaded<F...>;

/// "float" from "Tree_float_5_4_3"; other tree shapes keep their whole name.
std::string short_type(const std::string& type)
{
    constexpr std::string_view kBegin = "Tree_", kEnd = "_5_4_3";
    if (type.starts_with(kBegin) && type.ends_with(kEnd))
        return type.substr(kBegin.size(), type.size() - kBegin.size() - kEnd.size());
    return type;
}

std::string names_present(const Scene& scene)
{
    std::vector<std::string> names;
    for (const auto& [name, grid] : scene.grids) names.push_back(name);
    for (const auto& [name, points] : scene.points) names.push_back(name + " (points)");
    return names.empty() ? "there are none" : fmt::format("present: {}", fmt::join(names, ", "));
}

template <class G>
const G& grid_of(const Scene& scene, const std::string& name, const char* wanted)
{
    const auto found = scene.grids.find(name);
    if (found == scene.grids.end())
        throw InvalidInput(
            scene.points.contains(name)
                ? fmt::format("{} holds points, expected a grid of type {}", name, wanted)
                : fmt::format("no grid is called {}, {}", name, names_present(scene)));
    const G* grid = std::get_if<G>(&found->second.values);
    if (!grid)
        throw InvalidInput(fmt::format("grid {} has type {}, expected {}", name,
                                       found->second.type_name(), wanted));
    return *grid;
}

/// Independent of how leaves are represented: constant or not, present or left out as background.
template <class T>
std::string hash_of(const LeafGrid<T>& grid, const Progress& progress)
{
    std::vector<std::uint64_t> leaves(grid.leaf_count());
    std::vector<std::uint8_t> counts(grid.leaf_count());
    parallel_for(
        grid.leaf_count(),
        [&](std::size_t i) {
            progress.check();
            const vdb::LeafKind kind = vdb::leaf_kind(grid, i);
            if (kind == vdb::LeafKind::Empty) return;
            counts[i] = 1;
            const Coord origin = grid.origin(i);
            const LeafMask& mask = grid.mask(i);
            std::uint64_t h = hash64(&origin, sizeof origin);
            h = hash64(&mask, sizeof mask, h);
            std::array<T, kLeafSize> values;
            const int stored = kind == vdb::LeafKind::Tile ? 1 : kLeafSize;
            for (int v = 0; v < stored; ++v) {
                const T x = grid.at(i, v);
                values[std::size_t(v)] = mask.test(v) ? x : vdb::without_sign_of_zero(x);
            }
            leaves[i] = hash64(values.data(), std::size_t(stored) * sizeof(T), h);
        },
        64);
    Hasher hasher;
    hasher.add(vdb::tree_type<T>());
    hasher.add_value(grid.transform().origin);
    hasher.add_value(grid.transform().voxel);
    hasher.add_value(vdb::without_sign_of_zero(grid.background()));
    for (std::size_t i = 0; i < leaves.size(); ++i)
        if (counts[i]) hasher.add_value(leaves[i]);
    return hasher.hex();
}

}  // namespace

std::string Grid::type_name() const
{
    return std::visit(Overloaded{[](const FloatGrid&) { return std::string("float"); },
                                 [](const IntGrid&) { return std::string("int32"); },
                                 [](const VectorGrid&) { return std::string("vec3s"); },
                                 [](const std::shared_ptr<const ForeignGrid>& g) {
                                     return g ? short_type(g->raw.type) : std::string("nothing");
                                 }},
                      values);
}

std::uint64_t Grid::active_count() const
{
    return std::visit(Overloaded{[](const auto& g) { return g.active_count(); },
                                 [](const std::shared_ptr<const ForeignGrid>& g) {
                                     return g ? g->active : std::uint64_t{0};
                                 }},
                      values);
}

const FloatGrid& Scene::floats(const std::string& name) const
{
    return grid_of<FloatGrid>(*this, name, "float");
}

const IntGrid& Scene::ints(const std::string& name) const
{
    return grid_of<IntGrid>(*this, name, "int32");
}

const VectorGrid& Scene::vectors(const std::string& name) const
{
    return grid_of<VectorGrid>(*this, name, "vec3s");
}

const Points& Scene::points_of(const std::string& name) const
{
    const auto found = points.find(name);
    if (found == points.end())
        throw InvalidInput(
            has(name)
                ? fmt::format("{} has type {}, expected points", name, grids.at(name).type_name())
                : fmt::format("no points are called {}, {}", name, names_present(*this)));
    return found->second;
}

void Scene::put(const std::string& name, FloatGrid grid, std::string unit, std::string stage,
                GridClass grid_class)
{
    grids[name] = Grid{.values = std::move(grid),
                       .grid_class = grid_class,
                       .unit = std::move(unit),
                       .stage = std::move(stage),
                       .vector_type = {}};
}

void Scene::put(const std::string& name, IntGrid grid, std::string stage)
{
    grids[name] = Grid{.values = std::move(grid),
                       .grid_class = GridClass::Unknown,
                       .unit = {},
                       .stage = std::move(stage),
                       .vector_type = {}};
}

void Scene::put(const std::string& name, VectorGrid grid, std::string unit, std::string stage,
                std::string vector_type)
{
    grids[name] = Grid{.values = std::move(grid),
                       .grid_class = GridClass::Unknown,
                       .unit = std::move(unit),
                       .stage = std::move(stage),
                       .vector_type = std::move(vector_type)};
}

std::string content_hash(const Grid& grid, const Progress& progress)
{
    return std::visit(Overloaded{[&](const auto& g) { return hash_of(g, progress); },
                                 [](const std::shared_ptr<const ForeignGrid>& g) {
                                     Hasher hasher;
                                     if (!g) return hasher.hex();
                                     hasher.add(g->raw.type);
                                     hasher.add(g->raw.map);
                                     hasher.add(g->raw.topology);
                                     hasher.add(g->raw.buffers);
                                     return hasher.hex();
                                 }},
                      grid.values);
}

namespace {

template <class T>
void add_plain(Hasher& hasher, const std::vector<T>& values)
{
    std::array<T, 1024> part;
    for (std::size_t begin = 0; begin < values.size(); begin += part.size()) {
        const std::size_t count = std::min(part.size(), values.size() - begin);
        for (std::size_t i = 0; i < count; ++i) part[i] = plain_zero(values[begin + i]);
        hasher.add(part.data(), count * sizeof(T));
    }
}

}  // namespace

std::string content_hash(const Points& points)
{
    Hasher hasher;
    hasher.add("points");
    hasher.add_value(static_cast<std::uint64_t>(points.position.size()));
    add_plain(hasher, points.position);
    for (const auto& [name, attribute] : points.attributes) {
        hasher.add(name);
        hasher.add_value(static_cast<std::uint64_t>(attribute.index()));
        std::visit([&](const auto& v) { add_plain(hasher, v); }, attribute);
    }
    return hasher.hex();
}

}  // namespace sekitei
