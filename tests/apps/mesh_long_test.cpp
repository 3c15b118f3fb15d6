// Moss on meshes for a season and a year: under covers of every density, on a boulder under the
// sun's path, and beside the same bodies as cells.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "core/mesh_sites.h"
#include "grids/level_set.h"
#include "grids/surface_transfer.h"
#include "tests/apps/mesh_scenes.h"

namespace sekitei::apps {
namespace {

using namespace apps::testing;

const std::string kWeather = SEKITEI_DATA "/weather/morioka-normals.csv";

Scene scene_of(const std::string& file)
{
    return mesh_scene(read_mesh(SEKITEI_DATA "/meshes/" + file));
}

// ---- Shade ------------------------------------------------------------------------------------

/// Mosses on the floor (zone 1) after 120 days below a cover that lets `percent` of the light
/// through. They grow at half the pace, or they would stand at the cap under half of the covers.
double living_in_shade(int percent, const std::string& species, std::uint64_t seed)
{
    const Habitat habitat;
    Scene scene = scene_of(fmt::format("shade_{:03}.ply", percent));
    run_on_mesh(scene, "moss",
                {{"species", species},
                 {"days", 120},
                 {"growth_rate", 0.5},
                 {"photons", 65536},
                 {"site", 0.08},
                 {"rain_shelter", false},
                 {"runoff", false}},
                habitat.context(seed));
    const Points& zones = scene.points_of("zones");
    auto column = [&](const char* name) -> const std::vector<double>& {
        return std::get<std::vector<double>>(zones.attributes.at(name));
    };
    double sum = 0;
    for (std::size_t r = 0; r < zones.position.size(); ++r)
        if (column("day")[r] == 120 && column("zone")[r] == 1) sum += column("living")[r];
    return sum;
}

TEST(Shade, MossIsMostWhereAFifthOfTheSunComesThrough)
{
    const int covers[] = {0, 5, 10, 20, 40, 80, 100};
    for (const std::string species : {"bryum", "hypnum", "polytrichum"}) {
        double mean[7] = {};
        for (int k = 0; k < 7; ++k) {
            for (const std::uint64_t seed : {1, 2, 3}) {
                const double count = living_in_shade(covers[k], species, seed);
                std::printf("    %s, %d %%, seed %d: %.0f\n", species.c_str(), covers[k], int(seed),
                            count);
                std::fflush(stdout);
                mean[k] += count / 3;
            }
            std::printf("    %s, %d %%: %.1f\n", species.c_str(), covers[k], mean[k]);
        }
        EXPECT_EQ(mean[0], 0) << species;
        EXPECT_GE(mean[3], 5 * mean[5]) << species;
        EXPECT_GE(mean[3], 5 * mean[6]) << species;
        if (species != "bryum") continue;
        for (int k = 0; k < 7; ++k) EXPECT_LE(mean[k], mean[3]) << covers[k];
        EXPECT_LT(mean[2], mean[3]);
        EXPECT_LT(mean[4], mean[3]);
    }
}

// ---- A boulder --------------------------------------------------------------------------------

TEST(Rock, MossPrefersItsNorthAndItsCrevices)
{
    double cover[3][2] = {}, crevice = 0, convex = 0, light[2] = {}, humidity[2] = {};
    for (const std::uint64_t seed : {1, 2, 3}) {
        const Habitat habitat;
        // A skin of 2 cm of humus covers it all: bare stone holds 0.24 mm of water, on which none
        // of the three lives through a summer.
        Scene scene = scene_of("boulder.ply");
        auto& geology = std::get<std::vector<std::int32_t>>(
            scene.meshes.at("rock").face_attributes.at("geology"));
        std::fill(geology.begin(), geology.end(), 1);
        run_on_mesh(scene, "moss",
                    {{"weather", kWeather},
                     {"days", 365},
                     {"growth_rate", 0.02},
                     {"initial_count", 1000},
                     {"depth", 0.02},
                     {"photons", 65536},
                     {"site", 0.06}},
                    habitat.context(seed));
        const auto on_stone = [](Vec3d p) { return std::hypot(p.x, p.y) < 0.8 && p.z > 1e-3; };
        const auto north = [&](Vec3d n, Vec3d p) { return n.y > 0.5 && on_stone(p); };
        const auto south = [&](Vec3d n, Vec3d p) { return n.y < -0.5 && on_stone(p); };
        const double shine[2] = {site_mean(scene, "light_S", north),
                                 site_mean(scene, "light_S", south)};
        for (int side = 0; side < 2; ++side) light[side] += shine[side] / 3;
        const Points& moss = scene.points_of("moss");
        const auto& species = *moss.values<std::int32_t>("species");
        const auto& normal = *moss.values<Vec3f>("N");
        const std::vector<float>&area = site_values(scene, "area"),
              &view = site_values(scene, "sky_view"), &covered = site_values(scene, "moss_cover"),
              &wet = site_values(scene, "soil_rh");
        double sides[2] = {}, hollow[3] = {}, open[3] = {};
        for (std::size_t i = 0; i < area.size(); ++i) {
            const Vec3d n(site_values<Vec3f>(scene, "N")[i]),
                p = scene.points_of("sites").position[i];
            const double a = double(area[i]);
            if (north(n, p)) sides[0] += a;
            if (south(n, p)) sides[1] += a;
            if (!on_stone(p) || n.z <= 0) continue;
            double* where = view[i] < 0.4f ? hollow : view[i] > 0.6f ? open : nullptr;
            if (!where) continue;
            where[0] += a;
            where[1] += a * double(covered[i]);
            where[2] += a * double(wet[i]);
        }
        double count[3][2] = {};
        for (std::size_t i = 0; i < moss.position.size(); ++i) {
            const Vec3d n(normal[i]);
            if (north(n, moss.position[i])) count[species[i]][0] += 1;
            if (south(n, moss.position[i])) count[species[i]][1] += 1;
        }
        const double each = std::sqrt(3.0) / 2 * 1e-4;
        for (int s = 0; s < 3; ++s)
            for (int side = 0; side < 2; ++side) {
                cover[s][side] += count[s][side] * each / sides[side] / 3;
                std::printf("    seed %d, species %d, %s: %.0f on %.3f m2\n", int(seed), s,
                            side ? "south" : "north", count[s][side], sides[side]);
            }
        crevice += hollow[1] / hollow[0] / 3;
        convex += open[1] / open[0] / 3;
        humidity[0] += hollow[2] / hollow[0] / 3;
        humidity[1] += open[2] / open[0] / 3;
        std::printf(
            "    seed %d, living %zu, S north %.2f south %.2f, cover crevices %.4f convex %.4f\n",
            int(seed), living(scene), shine[0], shine[1], hollow[1] / hollow[0], open[1] / open[0]);
        std::fflush(stdout);
    }
    std::printf("    annual S: north %.2f, south %.2f\n", light[0], light[1]);
    std::printf("    rh_s: crevices %.4f, convex %.4f\n", humidity[0], humidity[1]);
    std::printf("    cover: crevices %.4f, convex %.4f\n", crevice, convex);
    EXPECT_LT(light[0], light[1]);
    for (int s = 0; s < 3; ++s) {
        std::printf("    species %d: cover north %.5f, south %.5f, ratio %.2f\n", s, cover[s][0],
                    cover[s][1], cover[s][0] / cover[s][1]);
        EXPECT_GT(cover[s][0], 0) << s;
        EXPECT_GE(cover[s][0], 2 * cover[s][1]) << s;
    }
    EXPECT_GE(crevice, convex);
}

// ---- Cells and meshes -------------------------------------------------------------------------

/// A ball with bumps.
TriMesh noisy(double radius)
{
    TriMesh mesh = shapes::ball({}, 1, 5);
    for (Vec3f& v : mesh.vertices) {
        const Vec3d p(v);
        const double bump =
            0.12 * std::sin(5 * p.x + 1) * std::cos(4 * p.y) + 0.08 * std::sin(7 * p.z);
        v = Vec3f(p * (radius * (1 + bump)));
    }
    return mesh;
}

void expect_twins(const char* name, const TriMesh& mesh)
{
    constexpr double kCell = 0.02, kSite = 0.04;
    Habitat habitat;
    // Dull days: in the sun of an open sky nothing would grow on such bodies.
    const Json weather{
        {"weather", habitat.weather(weather_csv(60, [](int d) {
             return Sky{.humidity = 88, .rain = d % 2 ? 8.0 : 0.0, .global = 45, .diffuse = 27};
         }))}};
    Scene cell_light;
    cell_light.put(
        "surface_sdf",
        level_set_from_mesh(mesh, Transform{mesh.bounds().lower - Vec3d(3 * kCell), kCell}, {}),
        "m", "test", GridClass::LevelSet);
    // The mesh floats: no ground throws light at it.
    Json no_ground = weather;
    no_ground["ground_albedo"] = 0;
    run(cell_light, "light", no_ground, habitat.context());
    const SurfaceCells cells = cells_of(cell_light);
    const MeshSites sites = mesh_sites(mesh, kSite, {});
    const SurfaceTransfer transfer = sites_to_cells(sites, cells, {});
    double surface = 0;
    for (const float a : cells.area) surface += double(a);
    auto difference = [&](const std::vector<float>& on_cells, const std::vector<float>& on_sites,
                          double& mean) {
        const std::vector<float> other = transfer.apply(on_sites, 0);
        double sum = 0;
        mean = 0;
        for (std::size_t i = 0; i < cells.size(); ++i) {
            sum += double(cells.area[i]) * std::abs(double(on_cells[i]) - double(other[i]));
            mean += double(cells.area[i]) * double(on_cells[i]) / surface;
        }
        return sum / surface;
    };

    Scene mesh_light = mesh_scene(mesh);
    Json light = weather;
    light.update({{"site", kSite}, {"photons", 8'000'000}, {"photon_radius", 0.05}});
    run_on_mesh(mesh_light, "light", light, habitat.context());
    double mean = 0;
    const double light_off = difference(cells.from_grid(cell_light.floats("light_S"), 0),
                                        site_values(mesh_light, "light_S"), mean);
    std::printf("    %s: %zu cells, %zu sites; S %.2f W/m2, mean |dS| %.2f = %.2f %%\n", name,
                cells.size(), sites.size(), mean, light_off, 100 * light_off / mean);
    EXPECT_LE(light_off, 0.05 * mean) << name;

    // The densest that mosses half a size apart come to by chance is 2.79 a square of their size:
    // so wide, there is one for each dx^2.
    const double size = std::sqrt(2.79) * kCell;
    const Json bare{{"initial_count", 0}, {"external_interval", 0}};
    const Json common{{"species", "bryum,hypnum,polytrichum"}, {"gemma_throw", 1.5 * kCell}};
    auto twins = [&](const Json& more, std::int64_t photons, std::uint64_t seed) {
        std::pair<Scene, Scene> both{cell_light, mesh_scene(mesh)};
        Json on_cells = common, on_mesh = weather;
        on_cells.update(more);
        run(both.first, "moss", on_cells, habitat.context(seed));
        on_mesh.update(on_cells);
        on_mesh.update(
            {{"site", kSite}, {"photons", photons}, {"photon_radius", 0.05}, {"size", size}});
        run_on_mesh(both.second, "moss", on_mesh, habitat.context(seed));
        return both;
    };

    // On bare ground: moss makes its own humidity, and never stands at the same places.
    const auto [a, b] = twins(bare, 262'144, 1);
    for (const char* field : {"rain_exposure", "sky_view", "soil_rh", "soil_theta", "suit_bryum",
                              "suit_hypnum", "suit_polytrichum"}) {
        const double off =
            difference(cells.from_grid(a.floats(field), 0), site_values(b, field), mean);
        std::printf("    %s: mean %s %.4f, mean difference %.4f\n", name, field, mean, off);
        if (std::string(field).starts_with("suit_")) {
            EXPECT_LE(off, 0.03) << name << ", " << field;
        }
    }
    double cover[2] = {};
    for (std::uint64_t seed = 1; seed <= 10; ++seed) {
        const auto [x, y] = twins(Json::object(), 32'768, seed);
        const double on_cells = apps::testing::cover(x),
                     on_sites = double(living(y)) * kCell * kCell / surface;
        cover[0] += on_cells / 10;
        cover[1] += on_sites / 10;
        std::printf("    %s, seed %d: cover %.4f on cells, %.4f on mesh (%zu)\n", name, int(seed),
                    on_cells, on_sites, living(y));
        std::fflush(stdout);
    }
    std::printf("    %s: cover %.4f and %.4f, ratio %.3f\n", name, cover[0], cover[1],
                cover[1] / cover[0]);
    EXPECT_NEAR(cover[1] / cover[0], 1, 0.15) << name;
}

TEST(Twin, APlane)
{
    expect_twins("plane", shapes::box({-0.5, -0.5, -0.2}, {0.5, 0.5, 0}));
}
TEST(Twin, ASphere)
{
    expect_twins("sphere", shapes::ball({}, 0.5, 5));
}
TEST(Twin, ANoisyRock)
{
    expect_twins("rock", noisy(0.4));
}

}  // namespace
}  // namespace sekitei::apps
