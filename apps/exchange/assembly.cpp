#include "apps/exchange/assembly.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "apps/forest.h"
#include "apps/garden/plot.h"
#include "apps/habitat.h"
#include "apps/render/garden.h"
#include "apps/render/tufts.h"
#include "apps/specimens.h"
#include "apps/stage.h"
#include "apps/stages/rock.h"
#include "apps/stages/scenery.h"
#include "core/error.h"
#include "core/mesh_parts.h"
#include "core/parallel.h"

namespace sekitei::apps {
namespace {

using render::LeafColours;

/// What kinds of surfaces are made of.
const SurfaceMaterial& material_of(const std::string& kind)
{
    static const std::vector<std::pair<std::string, SurfaceMaterial>> kMaterials{
        {"rock", {"rock", {0.135f, 0.125f, 0.112f}, 0.85f}},
        {"ground", {"ground", {0.078f, 0.076f, 0.032f}, 1.0f}},
        {"water", {"water", {0.010f, 0.016f, 0.014f}, 0.06f, true}},
        {"obstacle", {"wood", {0.158f, 0.128f, 0.100f}, 0.8f}},
        {"bark", {"bark", {0.114f, 0.098f, 0.082f}, 0.9f}},
        {"leaves", {"leaf", {0.079f, 0.125f, 0.029f}, 0.6f, true}}};
    for (const auto& [name, material] : kMaterials)
        if (name == kind) return material;
    return material_of("obstacle");
}

Vec3f middle(const LeafColours& leaves)
{
    return (leaves.dark + leaves.bright) * 0.5f;
}

std::size_t add_material(Assembly& all, SurfaceMaterial material)
{
    for (std::size_t i = 0; i < all.materials.size(); ++i)
        if (all.materials[i].name == material.name) return i;
    all.materials.push_back(std::move(material));
    return all.materials.size() - 1;
}

std::size_t leaf_material(Assembly& all, const std::string& kind, const LeafColours& colours)
{
    return add_material(all, {kind.empty() ? "leaf" : "leaf_" + kind, middle(colours), 0.6f, true});
}

void add_surface(Assembly& all, std::string name, const std::string& kind, TriMesh mesh)
{
    if (mesh.triangles.empty()) return;
    Surface surface;
    surface.name = std::move(name);
    surface.kind = kind;
    surface.material = add_material(all, material_of(kind));
    surface.own = std::move(mesh);
    all.surfaces.push_back(std::move(surface));
}

/// The mesh of a garden as its stones and its soil; false where it has no soil.
bool add_garden(Assembly& all, const TriMesh& mesh)
{
    const auto found = mesh.face_attributes.find("surface");
    const auto* surface = found == mesh.face_attributes.end()
                              ? nullptr
                              : std::get_if<std::vector<std::int32_t>>(&found->second);
    if (!surface || surface->size() != mesh.triangles.size()) return false;
    std::vector<std::uint8_t> soil(surface->size()), stone(surface->size());
    for (std::size_t f = 0; f < soil.size(); ++f) {
        soil[f] = (*surface)[f] == garden::kGroundSurface;
        stone[f] = !soil[f];
    }
    if (std::ranges::find(soil, 1) == soil.end()) return false;
    add_surface(all, "rock", "rock", part_of(mesh, stone));
    add_surface(all, "ground", "ground", part_of(mesh, soil));
    return true;
}

// ---- copies -----------------------------------------------------------------------------------

/// Fills `order` and `first` from the prototype of each row, kSkipped: none.
constexpr double kNone = std::numeric_limits<double>::infinity();
constexpr std::uint32_t kSkipped = std::numeric_limits<std::uint32_t>::max();
void group(CopySet& set, const std::vector<std::uint32_t>& prototype)
{
    set.first.assign(set.prototypes.size() + 1, 0);
    for (const std::uint32_t p : prototype)
        if (p != kSkipped) ++set.first[p + 1];
    for (std::size_t p = 0; p < set.prototypes.size(); ++p) set.first[p + 1] += set.first[p];
    std::vector<std::uint32_t> next(set.first.begin(), set.first.end() - 1);
    set.order.resize(set.first.back());
    for (std::size_t row = 0; row < prototype.size(); ++row)
        if (prototype[row] != kSkipped)
            set.order[next[prototype[row]]++] = static_cast<std::uint32_t>(row);
}

/// What is known of units of points' attributes.
std::string unit_of_column(const std::string& set, const std::string& name)
{
    if (name == "age") return set == "moss" ? "d" : "";
    if (name == "height" || name == "crown_radius" || name == "cone_radius") return "m";
    if (name == "area") return "m2";
    return "";
}

/// Takes the attributes of the points, and looks whether every copy stands somewhere.
CopySet set_of(const std::string& name, const std::string& of, const Points& points)
{
    CopySet set;
    set.name = name;
    set.points = &points;
    set.orient = points.values<std::array<float, 4>>("orient");
    set.scale = points.values<Vec3f>("scale");
    set.pscale = points.values<float>("pscale");
    set.normal = points.values<Vec3f>("N");
    set.ids = points.values<std::int64_t>("id");
    if (points.position.size() >= kSkipped)
        throw LimitExceeded(fmt::format("export: {} points '{}', at most 4.29 billion are possible",
                                        points.position.size(), of));
    const double wrong = parallel_fold(
        points.position.size(), 4096, kNone,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const Vec3d p = points.position[i];
                double norm = 1;
                if (set.orient) {
                    norm = 0;
                    for (const float q : (*set.orient)[i]) norm += double(q) * double(q);
                }
                const double size = set.scale    ? double(dot((*set.scale)[i], (*set.scale)[i]))
                                    : set.pscale ? double((*set.pscale)[i])
                                                 : 1;
                if (!std::isfinite(dot(p, p)) || !std::isfinite(size) ||
                    !(norm > 1e-12 && norm < 1e12))
                    return double(i);
            }
            return kNone;
        },
        [](double a, double b) { return std::min(a, b); });
    if (std::isfinite(wrong))
        throw InvalidInput(fmt::format(
            "export: point {} of '{}' has a position, size or orientation that is none, must be "
            "finite, with an orientation",
            wrong, of));
    for (const auto& [attribute, values] : points.attributes) {
        if (attribute == "pscale" || attribute == "model") continue;
        const bool number =
            points.values<float>(attribute) || points.values<std::int32_t>(attribute);
        if (!number) continue;
        CopySet::Column column{{attribute, unit_of_column(name, attribute)}, &values};
        std::visit(
            [&](const auto& list) {
                using T = typename std::decay_t<decltype(list)>::value_type;
                if constexpr (std::is_arithmetic_v<T>) {
                    double low = INFINITY, high = -INFINITY;
                    for (const T x : list) {
                        if (!std::isfinite(static_cast<double>(x))) continue;
                        low = std::min(low, static_cast<double>(x));
                        high = std::max(high, static_cast<double>(x));
                    }
                    if (low <= high) column.info.low = low, column.info.high = high;
                }
            },
            values);
        set.columns.push_back(std::move(column));
    }
    return set;
}

void add_moss(Assembly& all, const Scene& scene, const AssemblyOptions& options,
              const Progress& progress)
{
    const auto found = scene.points.find("moss");
    if (found == scene.points.end() || found->second.position.empty()) return;
    const Points& points = found->second;
    CopySet set = set_of("moss", "moss", points);
    const auto* species = points.values<std::int32_t>("species");
    const auto* growth = points.values<float>("growth");
    if (!set.orient || !set.pscale || !species)
        throw InvalidInput(
            "the points 'moss' need the attributes orient (quatf), pscale (float) and species "
            "(int32)");
    render::Stuff usual;
    if (all.species.empty()) all.species = usual.species;
    set.size = options.tuft_size.value_or(moss_size(scene).value_or(usual.moss_size));

    // Which mesh stands for a plant: sibling, density and whether it bears capsules.
    const std::size_t kinds = all.species.size();
    constexpr std::size_t kForms = 2 * render::kTuftModels * render::kTuftDensities;
    std::vector<std::uint32_t> form(points.position.size());
    const double wrong = parallel_fold(
        form.size(), 4096, kNone,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const std::int32_t kind = (*species)[i];
                if (kind < 0 || std::size_t(kind) >= kinds) return double(i);
                const float size = (*set.pscale)[i];
                // Without growth a plant is dense as its size says, and never ripe.
                const float grown = growth ? (*growth)[i] : std::min(2 * size, 1.9f);
                form[i] = !(size > 0) ? kSkipped
                                      : static_cast<std::uint32_t>(
                                            ((std::size_t(kind) * render::kTuftModels +
                                              std::size_t(render::tuft_sibling(
                                                  options.seed, set.ids ? (*set.ids)[i] : -1, i))) *
                                                 render::kTuftDensities +
                                             std::size_t(render::tuft_density(grown))) *
                                                2 +
                                            (grown >= render::kRipe ? 1 : 0));
            }
            return kNone;
        },
        [](double a, double b) { return std::min(a, b); });
    if (std::isfinite(wrong))
        throw InvalidInput(fmt::format("export: moss {} is of species {}, must be 0 to {}", wrong,
                                       (*species)[std::size_t(wrong)], double(kinds) - 1));
    std::vector<std::uint32_t> number(kinds * kForms, kSkipped);
    for (const std::uint32_t f : form)
        if (f != kSkipped) number[f] = 0;
    for (std::size_t f = 0; f < number.size(); ++f) {
        if (number[f] == kSkipped) continue;
        progress.check();
        number[f] = static_cast<std::uint32_t>(set.prototypes.size());
        const bool ripe = f % 2 == 1;
        const render::TuftModel which{int(f / 2 / render::kTuftDensities) % render::kTuftModels,
                                      options.moss_lod, int(f / 2) % render::kTuftDensities};
        const std::string& kind = all.species[f / kForms];
        render::TuftShape shape = render::tuft_shape(kind, which, ripe);
        // The material has the brightest colour of leaves: those of vertices darken it.
        Vec3f brightest(1e-3f);
        for (const float h : {0.0f, 0.5f, 1.0f})
            brightest = max(brightest, render::tuft_colour(kind, h));
        std::vector<Vec3f> colour;
        for (std::size_t v = 0; v < shape.height.size(); ++v) {
            const Vec3f c =
                render::tuft_colour(kind, shape.height[v]) * (0.8f + 0.2f * shape.tone[v]);
            colour.push_back(
                min(Vec3f(c.x / brightest.x, c.y / brightest.y, c.z / brightest.z), Vec3f(1.0f)));
        }
        CopiedModel model;
        model.species = kind;
        model.name = fmt::format("{}_{}_lod{}{}{}", kind, which.model, which.lod,
                                 which.density == 0   ? "_sparse"
                                 : which.density == 1 ? "_open"
                                                      : "",
                                 ripe ? "_ripe" : "");
        PrototypePart part;
        part.material = add_material(all, {"moss_" + kind, brightest, 0.65f, true});
        part.mesh.vertices = std::move(shape.vertices);
        part.mesh.triangles = std::move(shape.triangles);
        part.mesh.vertex_attributes["normal"] = std::move(shape.normals);
        part.mesh.vertex_attributes["color"] = std::move(colour);
        model.parts.push_back(std::move(part));
        set.prototypes.push_back(std::move(model));
    }
    for (std::uint32_t& f : form)
        if (f != kSkipped) f = number[f];
    group(set, form);

    // Mats creep over the stone.
    const auto hypnum = std::ranges::find(all.species, "hypnum");
    if (hypnum != all.species.end() && !all.surfaces.empty() &&
        all.surfaces.front().kind == "rock") {
        const auto kind = static_cast<std::int32_t>(hypnum - all.species.begin());
        std::vector<render::Tuft> mats;
        std::vector<std::size_t> row;
        for (std::size_t i = 0; i < species->size(); ++i) {
            if ((*species)[i] != kind || form[i] == kSkipped) continue;
            render::Tuft tuft;
            tuft.position = points.position[i];
            tuft.orient = (*set.orient)[i];
            tuft.scale = (*set.pscale)[i];
            tuft.species = kind + 1;
            mats.push_back(tuft);
            row.push_back(i);
        }
        if (!mats.empty()) {
            render::lay_mats(mats, all.species, set.size, all.surfaces.front().mesh(), progress);
            set.turned = *set.orient;
            for (std::size_t k = 0; k < row.size(); ++k) set.turned[row[k]] = mats[k].orient;
        }
    }
    if (!set.order.empty()) all.sets.push_back(std::move(set));
}

/// Bark and leaves of a model as two parts.
std::vector<PrototypePart> parts_of(TriMesh mesh, std::size_t bark, std::size_t leaf)
{
    const auto& part = std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("part"));
    std::vector<PrototypePart> parts;
    for (const std::int32_t which : {0, 1}) {
        PrototypePart piece;
        piece.material = which == 0 ? bark : leaf;
        std::vector<std::uint32_t> now(mesh.vertices.size(), kSkipped);
        for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
            if (part[t] != which) continue;
            std::array<std::uint32_t, 3> corners{};
            for (std::size_t k = 0; k < 3; ++k) {
                std::uint32_t& v = now[mesh.triangles[t][k]];
                if (v == kSkipped) {
                    v = static_cast<std::uint32_t>(piece.mesh.vertices.size());
                    piece.mesh.vertices.push_back(mesh.vertices[mesh.triangles[t][k]]);
                }
                corners[k] = v;
            }
            piece.mesh.triangles.push_back(corners);
        }
        if (!piece.mesh.triangles.empty()) parts.push_back(std::move(piece));
    }
    return parts;
}

void add_forest_copies(Assembly& all, const Scene& scene, const AssemblyOptions& options,
                       const Progress& progress)
{
    const auto found = scene.points.find("forest_instances");
    if (found == scene.points.end() || found->second.position.empty()) return;
    const Points& points = found->second;
    CopySet set = set_of("forest", "forest_instances", points);
    const auto* model = points.values<std::int32_t>("model");
    if (!set.orient || !set.scale || !model)
        throw InvalidInput(
            "the points 'forest_instances' need the attributes orient (quatf), scale (vec3s) and "
            "model (int32)");
    const ForestModels models = forest_models(scene);
    std::vector<std::uint32_t> number(models.size(), kSkipped);
    for (std::size_t i = 0; i < model->size(); ++i) {
        const std::int32_t m = (*model)[i];
        if (m < 0 || std::size_t(m) >= number.size())
            throw InvalidInput(fmt::format("export: tree {} is of model {}, must be 0 to {}", i, m,
                                           double(number.size()) - 1));
        number[std::size_t(m)] = 0;
    }
    std::vector<tree::Species> kinds;
    for (const std::string& name : models.kinds) kinds.push_back(specimen_kind(name));
    const SpecimenDetail& detail = kFileDetails[std::size_t(options.trees)];
    std::vector<Specimen> grown = grow_specimens(
        kinds,
        {.variants = models.variants,
         .generations = models.generations,
         .seed = models.seed,
         .leaf_scale = options.leaf_scale},
        std::span(&detail, 1), [&](std::size_t m, std::size_t) { return number[m] != kSkipped; },
        progress);
    const std::size_t a_kind = std::size_t(models.variants) * models.generations.size();
    for (std::size_t m = 0; m < grown.size(); ++m) {
        if (number[m] == kSkipped) continue;
        const tree::Species& kind = kinds[m / a_kind];
        Specimen& specimen = grown[m];
        if (specimen.tips == 0)
            throw InvalidInput(
                fmt::format("export: the forest's model {}, {} number {}, died out before "
                            "generation {}",
                            m, kind.name, specimen.variant, specimen.generations));
        number[m] = static_cast<std::uint32_t>(set.prototypes.size());
        const TreeLook look = tree_look(kind, options.season);
        SurfaceMaterial bark = material_of("bark");
        bark.name = "bark_" + kind.name;
        bark.colour = {bark.colour.x * look.bark.x, bark.colour.y * look.bark.y,
                       bark.colour.z * look.bark.z};
        if (options.season == Season::Bare && kind.model != tree::Model::Conifer)
            drop_leaves(specimen.mesh[0]);
        CopiedModel made;
        made.species = kind.name;
        made.name = fmt::format("{}_{}_{}_{}", kind.name, specimen.variant, specimen.generations,
                                detail.name);
        made.parts = parts_of(std::move(specimen.mesh[0]), add_material(all, bark),
                              leaf_material(all, kind.name, look.leaves.front()));
        set.prototypes.push_back(std::move(made));
    }
    std::vector<std::uint32_t> prototype(model->size());
    for (std::size_t i = 0; i < prototype.size(); ++i)
        prototype[i] = number[std::size_t((*model)[i])];
    group(set, prototype);
    all.sets.push_back(std::move(set));
}

void add_leaves(Assembly& all, const Scene& scene, const AssemblyOptions& options)
{
    const auto found = scene.points.find("leaves");
    if (options.season == Season::Bare || found == scene.points.end() ||
        found->second.position.empty())
        return;
    const Points& points = found->second;
    CopySet set = set_of("leaves", "leaves", points);
    if (!set.pscale || !(set.orient || set.normal))
        throw InvalidInput(
            "the points 'leaves' need the attributes pscale (float) and orient (quatf) or N "
            "(vec3s)");
    const auto* species = points.values<std::int32_t>("species");
    const std::vector<LeafKind> kinds = leaf_kinds(scene);
    std::vector<std::uint32_t> number(kinds.size(), kSkipped), prototype(points.position.size());
    for (std::size_t i = 0; i < prototype.size(); ++i) {
        const std::size_t kind =
            species
                ? std::min<std::size_t>(std::size_t(std::max(0, (*species)[i])), kinds.size() - 1)
                : 0;
        prototype[i] = (*set.pscale)[i] > 0 ? static_cast<std::uint32_t>(kind) : kSkipped;
        if (prototype[i] != kSkipped) number[kind] = 0;
    }
    // Points know half the edge of a square of a leaf's area.
    set.size = 2 * options.leaf_scale;
    for (std::size_t k = 0; k < kinds.size(); ++k) {
        if (number[k] == kSkipped) continue;
        CopiedModel leaf;
        leaf.species = kinds[k].species;
        leaf.name = leaf.species.empty() ? "leaf" : leaf.species;
        // Two trees may be of one kind.
        const auto same = std::ranges::find(set.prototypes, leaf.name, &CopiedModel::name);
        number[k] = static_cast<std::uint32_t>(same - set.prototypes.begin());
        if (same != set.prototypes.end()) continue;
        PrototypePart part;
        part.material = leaf_material(all, leaf.species,
                                      leaf_colours(leaf.species, kinds[k].needles, options.season));
        if (set.orient)
            add_leaf(part.mesh, {}, {0, 0, 0, 1}, 1,
                     leaf_slenderness(leaf.species, kinds[k].needles));
        else {
            part.mesh.vertices = {
                {-0.5f, -0.5f, 0}, {0.5f, -0.5f, 0}, {0.5f, 0.5f, 0}, {-0.5f, 0.5f, 0}};
            part.mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
        }
        leaf.parts.push_back(std::move(part));
        set.prototypes.push_back(std::move(leaf));
    }
    for (std::uint32_t& p : prototype)
        if (p != kSkipped) p = number[p];
    group(set, prototype);
    if (!set.order.empty()) all.sets.push_back(std::move(set));
}

// ---- fields -----------------------------------------------------------------------------------

/// Whether a grid has its values on surface cells.
template <class T>
bool on_cells(const LeafGrid<T>& grid, const FloatGrid& cells)
{
    const Transform &a = grid.transform(), &b = cells.transform();
    if (a.voxel != b.voxel || !(a.origin == b.origin)) return false;
    std::uint64_t active = 0;
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf) {
        const LeafMask& mine = grid.mask(leaf);
        if (mine.none()) continue;
        const std::uint32_t other = cells.topology()->find(grid.origin(leaf));
        if (other == kNoLeaf) return false;
        const LeafMask& theirs = cells.mask(other);
        for (std::size_t w = 0; w < 8; ++w)
            if (mine.words[w] & ~theirs.words[w]) return false;
        active += std::uint64_t(mine.count());
    }
    return active > 0;
}

/// Grids whose values belong to a surface.
std::vector<std::string> surface_fields(const Scene& scene)
{
    std::vector<std::string> names;
    const auto area = scene.grids.find("surf_area");
    const auto* cells =
        area == scene.grids.end() ? nullptr : std::get_if<FloatGrid>(&area->second.values);
    for (const auto& [name, grid] : scene.grids) {
        // What seeds wait for is of use to growth alone.
        if (name == "surf_area" || name == "moss_id" || name.starts_with("seed_")) continue;
        if (name == "temperature" && std::holds_alternative<FloatGrid>(grid.values))
            names.push_back(name);
        else if (cells &&
                 std::visit(
                     [&](const auto& values) {
                         if constexpr (std::is_same_v<std::decay_t<decltype(values)>, FloatGrid> ||
                                       std::is_same_v<std::decay_t<decltype(values)>, IntGrid>)
                             return on_cells(values, *cells);
                         else
                             return false;
                     },
                     grid.values))
            names.push_back(name);
    }
    return names;
}

/// Vertices of a mesh that an edge joins.
struct Neighbours {
    std::vector<std::uint32_t> first, list;

    explicit Neighbours(const TriMesh& mesh) : first(mesh.vertices.size() + 1, 0)
    {
        for (const auto& t : mesh.triangles)
            for (const std::uint32_t v : t) first[v + 1] += 2;
        for (std::size_t v = 0; v + 1 < first.size(); ++v) first[v + 1] += first[v];
        list.resize(first.back());
        std::vector<std::uint32_t> next(first.begin(), first.end() - 1);
        for (const auto& t : mesh.triangles)
            for (std::size_t k = 0; k < 3; ++k) {
                list[next[t[k]]++] = t[(k + 1) % 3];
                list[next[t[k]]++] = t[(k + 2) % 3];
            }
    }
};

/// Gives vertices that know nothing the mean of their neighbours that do, ring by ring; where no
/// edge leads, that of all. Kinds have no mean: theirs is that of the neighbour of lowest number.
void fill(std::vector<float>& values, const Neighbours& near, bool kinds)
{
    std::vector<std::uint32_t> missing;
    double sum = 0;
    std::size_t known = 0;
    std::optional<float> any;
    for (std::size_t v = 0; v < values.size(); ++v) {
        if (std::isnan(values[v])) {
            missing.push_back(static_cast<std::uint32_t>(v));
            continue;
        }
        sum += static_cast<double>(values[v]);
        ++known;
        if (!any) any = values[v];
    }
    std::vector<std::pair<std::uint32_t, float>> found;
    while (!missing.empty()) {
        found.clear();
        for (const std::uint32_t v : missing) {
            double total = 0;
            std::size_t count = 0;
            std::uint32_t lowest = kSkipped;
            for (std::uint32_t k = near.first[v]; k < near.first[v + 1]; ++k) {
                const std::uint32_t other = near.list[k];
                if (std::isnan(values[other])) continue;
                total += static_cast<double>(values[other]);
                ++count;
                lowest = std::min(lowest, other);
            }
            if (count > 0)
                found.emplace_back(
                    v, kinds ? values[lowest] : static_cast<float>(total / double(count)));
        }
        if (found.empty()) break;
        for (const auto& [v, value] : found) values[v] = value;
        std::erase_if(missing, [&](std::uint32_t v) { return !std::isnan(values[v]); });
    }
    for (const std::uint32_t v : missing)
        values[v] = kinds ? *any : static_cast<float>(sum / double(known));
}

void add_fields(Assembly& all, const Scene& scene, const std::vector<std::string>& names,
                const Progress& progress)
{
    for (std::size_t s = 0; s < all.surfaces.size(); ++s) {
        Surface& surface = all.surfaces[s];
        if (surface.kind == "water" || surface.kind == "bark") continue;
        const TriMesh& mesh = surface.mesh();
        std::optional<Neighbours> near;
        for (std::size_t k = 0; k < names.size(); ++k) {
            progress.update((double(s) + double(k) / double(names.size())) /
                            double(all.surfaces.size()));
            const std::string& name = names[k];
            if (mesh.vertex_attributes.contains(name) || mesh.face_attributes.contains(name))
                continue;
            const Grid& grid = scene.grids.at(name);
            std::vector<float> values = field_at_vertices(mesh, grid, name);
            const auto missing =
                std::ranges::count_if(values, [](float x) { return !std::isfinite(x); });
            // What stands by the surface the field is of has few of its cells near.
            if (std::size_t(missing) >
                (surface.kind == "rock" ? values.size() - 1 : values.size() / 10 * 9))
                continue;
            if (missing > 0) {
                for (float& x : values)
                    if (!std::isfinite(x)) x = std::numeric_limits<float>::quiet_NaN();
                if (!near) near.emplace(mesh);
                fill(values, *near, std::holds_alternative<IntGrid>(grid.values));
            }
            surface.fields[name] = std::move(values);
        }
    }
}

template <class T>
void widen(FieldInfo& info, const std::vector<T>& values, bool fresh)
{
    double low = fresh ? INFINITY : info.low, high = fresh ? -INFINITY : info.high;
    for (const T x : values) {
        if (!std::isfinite(static_cast<double>(x))) continue;
        low = std::min(low, static_cast<double>(x));
        high = std::max(high, static_cast<double>(x));
    }
    if (low <= high) info.low = low, info.high = high;
}

/// Names, units and ranges of all that surfaces know.
void describe_fields(Assembly& all, const Scene& scene)
{
    for (const Surface& surface : all.surfaces) {
        auto take = [&](const std::string& name, const auto& values) {
            const auto [field, fresh] = all.fields.try_emplace(name);
            if (fresh) {
                field->second.name = name;
                if (const auto grid = scene.grids.find(name); grid != scene.grids.end())
                    field->second.unit = grid->second.unit;
                if (name == "radius") field->second.unit = "m";
            }
            widen(field->second, values, fresh);
        };
        for (const auto* attributes :
             {&surface.mesh().vertex_attributes, &surface.mesh().face_attributes})
            for (const auto& [name, attribute] : *attributes)
                std::visit(
                    [&, called = name](const auto& values) {
                        if constexpr (!std::is_same_v<std::decay_t<decltype(values)>,
                                                      std::vector<Vec3f>>)
                            take(called, values);
                    },
                    attribute);
        for (const auto& [name, values] : surface.fields) take(name, values);
    }
}

}  // namespace

Placement CopySet::at(std::size_t row) const
{
    Placement p;
    p.position = points->position[row];
    if (!turned.empty() || orient) {
        p.orient = turned.empty() ? (*orient)[row] : turned[row];
        double norm = 0;
        for (const float q : p.orient) norm += double(q) * double(q);
        const double by = 1 / std::sqrt(norm);
        for (float& q : p.orient) q = static_cast<float>(double(q) * by);
    } else if (normal) {
        // The shortest turn that takes +z to the normal.
        const Vec3d n = normalized(Vec3d((*normal)[row]));
        const double w = 1 + n.z;
        if (w > 1e-6) {
            const double by = 1 / std::sqrt(n.x * n.x + n.y * n.y + w * w);
            p.orient = {static_cast<float>(-n.y * by), static_cast<float>(n.x * by), 0,
                        static_cast<float>(w * by)};
        } else
            p.orient = {1, 0, 0, 0};
    }
    if (scale)
        p.scale = Vec3f(Vec3d((*scale)[row]) * size);
    else
        p.scale = Vec3f(static_cast<float>(size * (pscale ? double((*pscale)[row]) : 1.0)));
    return p;
}

std::int64_t CopySet::id(std::size_t row) const
{
    return ids ? (*ids)[row] : static_cast<std::int64_t>(row);
}

std::size_t Assembly::triangles() const
{
    std::size_t count = 0;
    for (const Surface& surface : surfaces) count += surface.mesh().triangles.size();
    for (const CopySet& set : sets)
        for (const CopiedModel& model : set.prototypes)
            for (const PrototypePart& part : model.parts) count += part.mesh.triangles.size();
    return count;
}

std::size_t Assembly::copies() const
{
    std::size_t count = 0;
    for (const CopySet& set : sets) count += set.count();
    return count;
}

Bounds Assembly::bounds() const
{
    Bounds box;
    for (const Surface& surface : surfaces) {
        const Bounds own = surface.mesh().bounds();
        if (own.empty()) continue;
        box.add(own.lower);
        box.add(own.upper);
    }
    for (const CopySet& set : sets)
        for (const std::uint32_t row : set.order) box.add(set.points->position[row]);
    return box;
}

std::vector<std::string> assembly_uses()
{
    std::vector<std::string> names = scenery_uses();
    for (std::string& name : forest_uses()) names.push_back(std::move(name));
    for (const char* name : {"rock", "moss", "density", "column", "component", "surface",
                             "surface_sdf", "temperature"})
        names.emplace_back(name);
    return names;
}

Assembly assemble(const Scene& scene, const AssemblyOptions& options, const Progress& progress,
                  std::vector<std::pair<std::string, TriMesh>> meshes)
{
    Assembly all;
    all.species = species_names(scene);
    bool garden = false;
    const auto given = std::ranges::find(meshes, "rock", &std::pair<std::string, TriMesh>::first);
    if (given != meshes.end()) {
        garden = add_garden(all, given->second);
        if (!garden) add_surface(all, "rock", "rock", std::move(given->second));
        meshes.erase(given);
    } else if (const auto rock = scene.meshes.find("rock"); rock != scene.meshes.end()) {
        garden = add_garden(all, rock->second);
        if (!garden && !rock->second.triangles.empty()) {
            Surface surface;
            surface.name = surface.kind = "rock";
            surface.material = add_material(all, material_of("rock"));
            surface.given = &rock->second;
            all.surfaces.push_back(std::move(surface));
        }
    } else if (scene.has("density") || scene.has("surface_sdf")) {
        TriMesh mesh = surface_of(scene, scene.has("density") ? "density" : "surface_sdf", {},
                                  options.memory_limit, progress.slice(0, 0.2));
        garden = add_garden(all, mesh);
        if (!garden) add_surface(all, "rock", "rock", std::move(mesh));
    }
    const bool rock = !all.surfaces.empty();
    // Fields at vertices, corners split between columns, and rows by prototype.
    const std::vector<std::string> names =
        options.fields ? surface_fields(scene) : std::vector<std::string>{};
    double bytes = 0;
    for (const Surface& surface : all.surfaces)
        bytes += double(surface.mesh().vertices.size()) * (60 + 4 * double(names.size())) +
                 double(surface.mesh().triangles.size()) * 36;
    for (const char* name : {"moss", "forest_instances", "leaves"})
        if (const auto set = scene.points.find(name); set != scene.points.end())
            bytes += double(set->second.position.size()) * 24;
    check_memory("export", bytes + 3e7, options.memory_limit,
                 "leave the fields out with --no-fields");
    if (!rock || (scene.has("terrain_height") && !garden)) {
        TriMesh ground = forest_floor(scene);
        // What the crowns let through is what brightens it in pictures.
        if (auto light = ground.vertex_attributes.extract("light")) {
            light.key() = "ground_transmittance";
            ground.vertex_attributes.insert(std::move(light));
        }
        add_surface(all, "ground", "ground", std::move(ground));
    }
    add_surface(all, "water", "water", water_mesh(scene, -1e30));
    add_surface(all, "obstacle", "obstacle", obstacle_mesh(scene));
    add_surface(all, "bark", "bark", bark_mesh(scene, progress.slice(0.2, 0.3)));
    for (auto& [name, mesh] : meshes) {
        const bool known = name == "ground" || name == "water" || name == "bark";
        add_surface(all, name, known ? name : "obstacle", std::move(mesh));
    }
    add_moss(all, scene, options, progress.slice(0.3, 0.4));
    add_forest_copies(all, scene, options, progress.slice(0.4, 0.7));
    add_leaves(all, scene, options);
    if (all.surfaces.empty() && all.sets.empty()) {
        std::vector<std::string> present;
        for (const auto& [name, grid] : scene.grids) present.push_back(name);
        for (const auto& [name, points] : scene.points) present.push_back(name);
        throw InvalidInput(fmt::format(
            "export: nothing to draw: no rock (density, surface_sdf), obstacle, water, trees, "
            "forest, moss or leaves; the scene has {}",
            present.empty() ? "nothing" : fmt::format("{}", fmt::join(present, ", "))));
    }
    add_fields(all, scene, names, progress.slice(0.7, 1));
    describe_fields(all, scene);
    return all;
}

}  // namespace sekitei::apps
