#include "apps/stages/forest_scenery.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/forest.h"
#include "apps/specimens.h"
#include "core/error.h"
#include "core/math.h"
#include "core/noise.h"
#include "core/random.h"

namespace sekitei::apps {
namespace {

using render::LeafColours;

/// Of the levels of pictures.
constexpr std::array<SpecimenDetail, render::kTreeLevels> kDetails{{
    {"0", 50'000, 0.02, 0.03, true},
    {"1", 22'000, 0.04, 0.04, true},
    {"2", 8'000, 0.08, 0.08, true},
    {"3", 2'200, 0.16, 0.2, true},
    {"4", 600, 0.3, 0.4, true},
    {"5", 160, 0.5, 0.8, true},
}};

constexpr Vec3f kThrough{0.90f, 1.00f, 0.45f};  // of broad leaves

/// What a kind of tree looks like; each tree has one of its leaves.
struct Dress {
    std::string_view kind;
    Vec3f bark;
    std::vector<LeafColours> summer, autumn;
};

const Dress& dress_of(const std::string& kind)
{
    const LeafColours gold{{0.330f, 0.190f, 0.022f}, {0.520f, 0.360f, 0.045f}, {0.8f, 0.7f, 0.35f}},
        copper{{0.200f, 0.078f, 0.020f}, {0.370f, 0.180f, 0.040f}, {0.75f, 0.6f, 0.35f}},
        russet{{0.140f, 0.062f, 0.020f}, {0.270f, 0.140f, 0.040f}, {0.7f, 0.6f, 0.4f}},
        scarlet{{0.300f, 0.032f, 0.014f}, {0.480f, 0.095f, 0.022f}, {0.8f, 0.5f, 0.3f}},
        orange{{0.330f, 0.095f, 0.014f}, {0.500f, 0.210f, 0.025f}, {0.8f, 0.6f, 0.3f}},
        late{{0.080f, 0.088f, 0.018f}, {0.210f, 0.190f, 0.034f}, {0.9f, 0.9f, 0.4f}};
    const LeafColours needles{
        {0.022f, 0.046f, 0.022f}, {0.052f, 0.083f, 0.032f}, {0.25f, 0.30f, 0.15f}};
    static const std::vector<Dress> dresses{
        {"beech",
         {1.20f, 1.22f, 1.18f},
         {{{0.044f, 0.088f, 0.018f}, {0.118f, 0.172f, 0.034f}, kThrough},
          {{0.050f, 0.092f, 0.018f}, {0.132f, 0.178f, 0.034f}, kThrough}},
         {gold, copper, copper, late}},
        {"oak",
         {0.85f, 0.80f, 0.74f},
         {{{0.036f, 0.070f, 0.019f}, {0.094f, 0.130f, 0.032f}, kThrough}},
         {russet, russet, copper, late}},
        {"zelkova",
         {1.05f, 1.00f, 0.92f},
         {{{0.058f, 0.098f, 0.018f}, {0.152f, 0.188f, 0.036f}, kThrough}},
         {orange, copper, gold, scarlet}},
        {"cherry",
         {0.85f, 0.70f, 0.62f},
         {{{0.054f, 0.088f, 0.022f}, {0.126f, 0.160f, 0.040f}, kThrough}},
         {scarlet, orange, scarlet, copper}},
        {"willow",
         {0.95f, 0.92f, 0.85f},
         {{{0.085f, 0.125f, 0.036f}, {0.155f, 0.185f, 0.060f}, {0.85f, 0.95f, 0.45f}}},
         {gold, late}},
        {"pine", {1.35f, 0.88f, 0.66f}, {needles}, {needles}},
        {"azalea",
         {0.90f, 0.82f, 0.72f},
         {{{0.046f, 0.082f, 0.020f}, {0.120f, 0.160f, 0.036f}, kThrough},
          {{0.060f, 0.090f, 0.020f}, {0.145f, 0.165f, 0.036f}, kThrough}},
         {scarlet, late, late, russet}},
        {"",
         {1.0f, 1.0f, 1.0f},
         {{{0.048f, 0.092f, 0.022f}, {0.110f, 0.158f, 0.036f}, kThrough}},
         {copper, gold, late}}};
    for (const Dress& d : dresses)
        if (d.kind == kind) return d;
    return dresses.back();
}

/// Leaves of cherries in spring.
const LeafColours kBlossom{
    {0.560f, 0.340f, 0.380f}, {0.780f, 0.640f, 0.660f}, {0.60f, 0.52f, 0.54f}};

std::vector<LeafColours> leaves_of(const tree::Species& kind, Season season)
{
    if (season == Season::Blossom || (season == Season::Auto && kind.name == "cherry"))
        return {kBlossom};
    const Dress& dress =
        dress_of(kind.model == tree::Model::Conifer ? std::string("pine") : kind.name);
    return season == Season::Autumn ? dress.autumn : dress.summer;
}

/// Whether leaves of a low tree would be all that an eye sees.
bool in_the_way(const render::StandingTree& tree, Vec3d eye)
{
    const Vec3d d = eye - tree.position;
    const auto height = static_cast<double>(tree.scale.z), wide = static_cast<double>(tree.scale.x);
    return height < 8 && d.z > -0.5 && d.z < height + 0.5 &&
           std::hypot(d.x, d.y) < 1.0 + 0.75 * wide;
}

/// The ground of a forest at any place.
class Ground {
public:
    explicit Ground(const Scene& scene)
    {
        auto map = [&](const char* name) {
            return scene.has(name) ? &scene.floats(name) : nullptr;
        };
        terrain = map("terrain_height");
        light_ = map("ground_transmittance");
        Bounds trees;
        for (const Vec3d& p : scene.points.at("forest_instances").position) trees.add(p);
        for (const FloatGrid* m : {terrain, light_, map("canopy_height")})
            for (std::size_t leaf = 0; m && leaf < m->leaf_count(); ++leaf)
                m->mask(leaf).for_each([&](int offset) {
                    const Coord c = leaf_coord(m->origin(leaf), offset);
                    land.add(m->transform().world(Vec3d(c)));
                    land.add(m->transform().world(Vec3d(c) + Vec3d(1, 1, 0)));
                });
        if (land.empty()) land = trees;
        level_ = trees.empty() ? 0 : trees.lower.z;
        if (terrain) {
            const Transform& t = terrain->transform();
            low_ = t.voxels(land.lower);
            high_ = t.voxels(land.upper) - Vec3d(1);
        }
    }

    /// Edge of the pixels worth a vertex; infinite where one square does.
    double pixel() const
    {
        return terrain  ? terrain->transform().voxel
               : light_ ? 2 * light_->transform().voxel
                        : INFINITY;
    }
    /// Bilinear between the centres of the pixels, level beyond them.
    double height(Vec3d at) const
    {
        if (!terrain) return level_;
        const Vec3d p = terrain->transform().voxels(at) - Vec3d(0.5);
        const double x = std::floor(p.x), y = std::floor(p.y), fx = p.x - x, fy = p.y - y;
        auto value = [&](double i, double j) {
            return static_cast<double>(
                terrain->value(Coord(int(std::lround(std::clamp(i, low_.x, high_.x))),
                                     int(std::lround(std::clamp(j, low_.y, high_.y))), 0)));
        };
        return (value(x, y) * (1 - fx) + value(x + 1, y) * fx) * (1 - fy) +
               (value(x, y + 1) * (1 - fx) + value(x + 1, y + 1) * fx) * fy;
    }
    /// Light that crowns let through: the mean of the 5 by 5 pixels around.
    float light(Vec3d at) const
    {
        if (!light_) return 0.35f;
        const Vec3d p = light_->transform().voxels(at);
        const int x = int(std::floor(p.x)), y = int(std::floor(p.y));
        float sum = 0;
        for (int j = -2; j <= 2; ++j)
            for (int i = -2; i <= 2; ++i) sum += light_->value(Coord(x + i, y + j, 0));
        return sum / 25;
    }
    bool contains(Vec3d at) const
    {
        return at.x >= land.lower.x && at.x <= land.upper.x && at.y >= land.lower.y &&
               at.y <= land.upper.y;
    }

    Bounds land;
    const FloatGrid* terrain = nullptr;

private:
    const FloatGrid* light_ = nullptr;
    double level_ = 0;
    Vec3d low_, high_;
};

/// A leaf from its foot along `along`, bending down; its upper side is up.
void add_frond(TriMesh& mesh, Vec3d foot, Vec3d along, double half, double droop)
{
    const Vec3d side = normalized(cross(along, Vec3d(0, 0, 1))) * half;
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    for (const Vec3d& p : {foot, foot + along * 0.45 + side, foot + along - Vec3d(0, 0, droop),
                           foot + along * 0.45 - side})
        mesh.vertices.emplace_back(p);
    mesh.triangles.push_back({first, first + 1, first + 2});
    mesh.triangles.push_back({first, first + 2, first + 3});
}

/// What grows between the trees, of height 1.
enum class Herb { Grass, Fern, Broad };
constexpr int kHerbs = 3, kHerbVariants = 3;

TriMesh herb_mesh(Herb herb, int variant)
{
    TriMesh mesh;
    const std::uint64_t key =
        hash2(Stream("render.herbs").id, std::uint64_t(int(herb) * 16 + variant));
    std::uint64_t next = 0;
    auto draw = [&](double low, double high) {
        return low + (high - low) * uniform_of_key(key, next++);
    };
    auto away = [](double turn, double rise) {
        return Vec3d(math::cos(turn) * math::cos(rise), math::sin(turn) * math::cos(rise),
                     math::sin(rise));
    };
    const double about = 2 * math::kPi;
    if (herb == Herb::Grass)
        for (int i = 0; i < 34; ++i) {
            const double turn = draw(0, about), rise = draw(0.9, 1.5), long_ = draw(0.5, 1.1);
            add_frond(mesh, away(draw(0, about), 0) * draw(0, 0.28), away(turn, rise) * long_,
                      draw(0.012, 0.022), draw(0, 0.22) * long_);
        }
    else if (herb == Herb::Fern)
        for (int i = 0; i < 9; ++i) {
            const double turn = about * (i + draw(0, 0.7)) / 9, long_ = draw(0.9, 1.3),
                         rise = draw(0.6, 1.1);
            Vec3d at(0, 0, 0);
            for (int k = 1; k <= 11; ++k) {
                const double t = k / 11.0, now = rise - 1.25 * t * t;
                at += away(turn, now) * (long_ / 11);
                const double half = 0.30 * long_ * std::sqrt(1 - t) * std::min(1.0, 4 * t);
                for (const double s : {-1.0, 1.0})
                    add_frond(mesh, at, away(turn + s * 1.15, now - 0.15) * half, 0.045 * long_,
                              0.1 * half);
            }
        }
    else
        for (int i = 0; i < 16; ++i) {
            const double turn = draw(0, about), out = draw(0.05, 0.55), up = draw(0.15, 0.8);
            add_frond(mesh, away(turn, 0) * out + Vec3d(0, 0, up),
                      away(turn + draw(-0.6, 0.6), draw(-0.3, 0.5)) * draw(0.3, 0.5),
                      draw(0.09, 0.16), 0.1);
        }
    mesh.face_attributes["part"] = std::vector<std::int32_t>(mesh.triangles.size(), 1);
    return mesh;
}

std::vector<LeafColours> herb_leaves(Herb herb, Season season)
{
    const Vec3f through{0.8f, 0.9f, 0.4f};
    const bool late = season == Season::Autumn || season == Season::Bare;
    switch (herb) {
        case Herb::Grass:
            return {{{0.050f, 0.078f, 0.018f}, {0.135f, 0.160f, 0.040f}, through},
                    {{0.085f, 0.088f, 0.030f}, {0.210f, 0.185f, 0.070f}, through}};
        case Herb::Fern:
            if (late) return {{{0.120f, 0.060f, 0.018f}, {0.260f, 0.150f, 0.040f}, through}};
            return {{{0.045f, 0.085f, 0.018f}, {0.120f, 0.175f, 0.036f}, through}};
        case Herb::Broad:
            break;
    }
    return {{{0.040f, 0.075f, 0.020f}, {0.100f, 0.145f, 0.036f}, through}};
}

/// Puts herbs where the eye can tell them from the floor's own pattern.
void add_herbs(render::Stuff& stuff, const Ground& ground, Vec3d eye, std::size_t first_model,
               std::uint64_t seed)
{
    constexpr double kCell = 0.35, kReach = 60;
    const std::uint64_t key = hash2(seed, Stream("render.herbs").id);
    const int reach = int(kReach / kCell), cx = int(std::floor(eye.x / kCell)),
              cy = int(std::floor(eye.y / kCell));
    for (int j = cy - reach; j <= cy + reach; ++j)
        for (int i = cx - reach; i <= cx + reach; ++i) {
            const std::uint64_t own =
                hash2(key, (std::uint64_t(std::uint32_t(i)) << 32) | std::uint32_t(j));
            Vec3d at((i + uniform_of_key(own, 0)) * kCell, (j + uniform_of_key(own, 1)) * kCell, 0);
            const double far = std::hypot(at.x - eye.x, at.y - eye.y);
            // Fewer and larger ones with distance.
            const double larger = 1 + far / 25;
            if (far > kReach || far < 0.6 || (ground.terrain && !ground.contains(at)) ||
                uniform_of_key(own, 2) * larger * larger > 1)
                continue;
            const double light = ground.contains(at) ? static_cast<double>(ground.light(at)) : 1;
            const double patch = gradient_noise(key, at / 7.0),
                         small = gradient_noise(key + 1, at / 1.9);
            const double u = uniform_of_key(own, 3);
            Herb herb = Herb::Grass;
            double height = 0;
            if (u < 1.6 * light - 0.15 + 0.5 * small)
                height = 0.22 + 0.25 * uniform_of_key(own, 4);
            else if (patch > 0.08 && u < 0.45 + small) {
                herb = Herb::Fern;
                height = 0.28 + 0.30 * uniform_of_key(own, 4);
            } else if (u < 0.22 + 0.5 * small - 0.4 * patch) {
                herb = Herb::Broad;
                height = 0.12 + 0.16 * uniform_of_key(own, 4);
            } else {
                continue;
            }
            at.z = ground.height(at) - (ground.contains(at) ? 0.02 * height : 0.06);
            const auto size = static_cast<float>(height * std::sqrt(larger));
            const double half = math::kPi * uniform_of_key(own, 5);
            stuff.trees.push_back(
                {at,
                 {0, 0, static_cast<float>(math::sin(half)), static_cast<float>(math::cos(half))},
                 Vec3f(size),
                 static_cast<std::int32_t>(first_model + std::size_t(herb) * kHerbVariants +
                                           std::size_t(uniform_of_key(own, 6) * kHerbVariants)),
                 static_cast<std::int64_t>(own)});
        }
}

}  // namespace

render::LeafColours leaf_colours(const std::string& species, bool needles, Season season)
{
    if (season == Season::Autumn)
        return {{0.270f, 0.070f, 0.016f}, {0.420f, 0.235f, 0.030f}, {0.75f, 0.65f, 0.4f}};
    if (season == Season::Blossom || (season == Season::Auto && species == "cherry"))
        return {{0.620f, 0.400f, 0.440f}, {0.780f, 0.660f, 0.680f}, {0.60f, 0.52f, 0.54f}};
    if (species.empty()) return {};
    if (needles) return {{0.026f, 0.052f, 0.024f}, {0.055f, 0.085f, 0.034f}, {0.25f, 0.30f, 0.15f}};
    if (species == "willow")
        return {{0.085f, 0.125f, 0.036f}, {0.155f, 0.185f, 0.060f}, {0.85f, 0.95f, 0.45f}};
    return {{0.048f, 0.092f, 0.022f}, {0.110f, 0.158f, 0.036f}, {0.90f, 1.00f, 0.45f}};
}

TreeLook tree_look(const tree::Species& kind, Season season)
{
    return {leaves_of(kind, season), dress_of(kind.name).bark};
}

void drop_leaves(TriMesh& mesh)
{
    auto found = mesh.face_attributes.find("part");
    if (found == mesh.face_attributes.end()) return;
    auto& part = std::get<std::vector<std::int32_t>>(found->second);
    const auto bark = std::ranges::lower_bound(part, 1) - part.begin();
    part.resize(std::size_t(bark));
    mesh.triangles.resize(std::size_t(bark));
}

std::vector<std::string> forest_uses()
{
    return {"forest_instances", "terrain_height", "ground_transmittance", "canopy_height"};
}

void add_forest(render::Stuff& stuff, const Scene& scene, Season season, double leaf_scale,
                const std::optional<Vec3d>& eye, std::uint64_t seed, const Progress& progress)
{
    const auto found = scene.points.find("forest_instances");
    if (found == scene.points.end() || found->second.position.empty()) return;
    const Points& points = found->second;
    const auto* orient = points.values<std::array<float, 4>>("orient");
    const auto* scale = points.values<Vec3f>("scale");
    const auto* model = points.values<std::int32_t>("model");
    const auto* id = points.values<std::int64_t>("id");
    if (!orient || !scale || !model || !id)
        throw InvalidInput(
            "the points 'forest_instances' need the attributes orient (quatf), scale (vec3s), "
            "model (int32) and id (int64)");
    for (std::size_t i = 0; i < points.position.size(); ++i) {
        const render::StandingTree tree{points.position[i], (*orient)[i], (*scale)[i], (*model)[i],
                                        (*id)[i]};
        if (!eye || !in_the_way(tree, *eye)) stuff.trees.push_back(tree);
    }

    const ForestModels models = forest_models(scene);
    std::vector<tree::Species> kinds;
    for (const std::string& name : models.kinds) kinds.push_back(specimen_kind(name));
    const SpecimenParams params{.variants = models.variants,
                                .generations = models.generations,
                                .seed = models.seed,
                                .leaf_scale = leaf_scale};
    const std::size_t ages = models.generations.size(),
                      a_kind = std::size_t(std::max(0, models.variants)) * ages;
    stuff.models = kinds.size() * a_kind;
    const std::size_t herbs = stuff.models;
    if (const Ground ground(scene);
        eye && !scene.meshes.contains("rock") && eye->z - ground.height(*eye) < 12) {
        add_herbs(stuff, ground, *eye, herbs, seed);
        stuff.models += std::size_t(kHerbs) * kHerbVariants;
    }
    const std::size_t count = stuff.models;
    stuff.grow = [=](const std::vector<std::uint8_t>& levels) {
        std::vector<Specimen> grown = grow_specimens(
            kinds, params, kDetails,
            [&](std::size_t m, std::size_t d) { return (levels[m] >> d & 1) != 0; }, progress);
        std::vector<render::TreeModel> made(count);
        for (std::size_t m = herbs; m < count; ++m) {
            const auto herb = Herb((m - herbs) / kHerbVariants);
            made[m].mesh.fill(herb_mesh(herb, int((m - herbs) % kHerbVariants)));
            made[m].leaves = herb_leaves(herb, season);
        }
        for (std::size_t m = 0; m < grown.size(); ++m) {
            const tree::Species& kind = kinds[m / a_kind];
            if (grown[m].tips == 0 && levels[m] != 0)
                throw InvalidInput(
                    fmt::format("render: the forest's model {}, {} number {}, died out before "
                                "generation {}",
                                m, kind.name, grown[m].variant, grown[m].generations));
            std::ranges::move(grown[m].mesh, made[m].mesh.begin());
            TreeLook look = tree_look(kind, season);
            made[m].leaves = std::move(look.leaves);
            made[m].bark = look.bark;
            if (season == Season::Bare && kind.model != tree::Model::Conifer)
                for (TriMesh& mesh : made[m].mesh) drop_leaves(mesh);
        }
        return made;
    };
}

TriMesh forest_floor(const Scene& scene)
{
    if (!scene.points.contains("forest_instances")) return {};
    const Ground ground(scene);
    const Bounds& land = ground.land;
    if (land.empty()) return {};
    constexpr double kMost = 600;  // squares along a side
    const Vec3d size = max(land.size(), Vec3d(1e-3));
    const double step = std::max(ground.pixel(), std::max(size.x, size.y) / kMost);
    auto squares = [&](double length) {
        return std::isfinite(step) ? std::max(1, int(std::lround(length / step))) : 1;
    };
    const int nx = squares(size.x), ny = squares(size.y);
    TriMesh mesh;
    std::vector<float> brightness;
    double lowest = INFINITY, highest = -INFINITY;
    for (int j = 0; j <= ny; ++j)
        for (int i = 0; i <= nx; ++i) {
            Vec3d at(land.lower.x + size.x * i / nx, land.lower.y + size.y * j / ny, 0);
            at.z = ground.height(at);
            lowest = std::min(lowest, at.z);
            highest = std::max(highest, at.z);
            mesh.vertices.emplace_back(at);
            brightness.push_back(ground.light(at));
        }
    auto square = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
        mesh.triangles.push_back({a, b, c});
        mesh.triangles.push_back({a, c, d});
    };
    auto number = [&](int i, int j) { return static_cast<std::uint32_t>(j * (nx + 1) + i); };
    for (int j = 0; j < ny; ++j)
        for (int i = 0; i < nx; ++i)
            square(number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1));
    // Around it the ground falls gently to the plane that it lies on.
    const double out = std::max(3.0, 1.7 * (highest - lowest));
    std::vector<std::uint32_t> border;
    for (int i = 0; i < nx; ++i) border.push_back(number(i, 0));
    for (int j = 0; j < ny; ++j) border.push_back(number(nx, j));
    for (int i = nx; i > 0; --i) border.push_back(number(i, ny));
    for (int j = ny; j > 0; --j) border.push_back(number(0, j));
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    for (const std::uint32_t v : border) {
        const int i = int(v) % (nx + 1), j = int(v) / (nx + 1);
        Vec3d down(mesh.vertices[v]);
        down.x += out * ((i == nx) - (i == 0));
        down.y += out * ((j == ny) - (j == 0));
        down.z = lowest - 0.06;
        mesh.vertices.emplace_back(down);
        brightness.push_back(1);
    }
    const auto count = static_cast<std::uint32_t>(border.size());
    for (std::uint32_t k = 0; k < count; ++k) {
        const std::uint32_t next = (k + 1) % count;
        square(first + k, first + next, border[next], border[k]);
    }
    mesh.vertex_attributes["light"] = std::move(brightness);
    return mesh;
}

}  // namespace sekitei::apps
