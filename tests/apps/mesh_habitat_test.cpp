#include "apps/mesh_habitat.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>

#include "apps/habitat.h"
#include "core/error.h"
#include "core/image.h"
#include "core/math.h"
#include "core/parallel.h"
#include "grids/level_set.h"
#include "solvers/soil/mesh_depth.h"
#include "tests/apps/mesh_scenes.h"
#include "tests/support/roof.h"
#include "tests/support/stopped.h"

namespace sekitei::apps {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;
using namespace apps::testing;

/// A slab of 0.6 x 0.4 x 0.2 m whose top is z = 0.
TriMesh slab()
{
    return shapes::box({0, 0, -0.2}, {0.6, 0.4, 0});
}

/// Twelve dim days on a slab, with few photons on few sites.
Json quick(const Json& more = Json::object())
{
    Json values{{"days", 12},          {"site", 0.1},     {"photons", 4096},     {"open_light", 25},
                {"initial_count", 20}, {"soil", "humus"}, {"photon_radius", 0.1}};
    if (more.is_object()) values.update(more);
    return values;
}

Scene grown(TriMesh mesh, const Habitat& habitat, const Json& more = Json::object(),
            std::uint64_t seed = 7)
{
    Scene scene = mesh_scene(std::move(mesh));
    run_on_mesh(scene, "moss", quick(more), habitat.context(seed));
    return scene;
}

template <class T>
const std::vector<T>& of_moss(const Scene& scene, const std::string& name)
{
    return std::get<std::vector<T>>(scene.points_of("moss").attributes.at(name));
}

const std::vector<double>& of_zones(const Scene& scene, const std::string& name)
{
    return std::get<std::vector<double>>(scene.points_of("zones").attributes.at(name));
}

bool up(Vec3d normal, Vec3d)
{
    return normal.z > 0.9;
}

// ---- One ground for cells and meshes ----------------------------------------------------------

TEST(MeshGround, CellsAndSitesOfTheSameInputsHaveTheSameDays)
{
    Habitat habitat;
    Scene scene = plane(0.08);
    habitat.light(scene, weather_csv(6, [](int d) {
                      return Sky{.celsius = 5.0 + 3 * d,
                                 .humidity = 55.0 + 8 * d,
                                 .rain = d % 2 ? 6.0 : 0.0,
                                 .wind = 0.5 + d,
                                 .sunshine = 1.0 + d};
                  }));
    ClimateParams params;
    params.soil = "humus";
    const Climate climate(scene, params, habitat.folder.path(), {});
    const SurfaceCells& cells = climate.cells();
    const std::size_t n = cells.size();
    GroundSites sites;
    sites.area = cells.area;
    sites.sky_view = climate.coefficients().sky_view;
    sites.rain_exposure = climate.coefficients().rain_exposure;
    sites.geology.assign(n, 1);
    sites.depth = climate.ground().depth();
    sites.own = soil::preset_soils()[0];
    params.runoff = false;
    ClimateParams cell_params = params;
    const Climate dry(scene, cell_params, habitat.folder.path(), {});
    const Ground ground(params, *climate.weather().site, std::move(sites));

    std::vector<double> a = dry.ground().initial_water(), b = ground.initial_water();
    ASSERT_EQ(a, b);
    std::vector<float> cover(n);
    for (std::size_t i = 0; i < n; ++i) cover[i] = float(i % 5) / 4;
    ClimateDay on_cells;
    GroundDay on_sites;
    for (std::size_t d = 0; d < climate.weather().days.size(); ++d) {
        const std::vector<double> before = b;
        dry.advance(d, a, cover, on_cells, {});
        ground.advance(climate.weather().days[d], on_cells.light.total, b, cover, on_sites, {});
        for (std::size_t i = 0; i < n; ++i) {
            ASSERT_NEAR(b[i], a[i], 1e-12 * std::max(1.0, a[i]));
            ASSERT_NEAR(on_sites.ground.evaporation[i], on_cells.ground.evaporation[i], 1e-12);
            ASSERT_EQ(on_sites.ground.temperature[i], on_cells.ground.temperature[i]);
            ASSERT_EQ(on_sites.ground.humidity[i], on_cells.ground.humidity[i]);
            const soil::Day one = ground.day_at(i, on_sites, double(on_cells.light.total[i]),
                                                before[i], double(cover[i]));
            ASSERT_NEAR(one.water, b[i], 1e-12 * std::max(1.0, b[i]));
            ASSERT_NEAR(one.evaporation, on_sites.ground.evaporation[i], 1e-12);
            ASSERT_EQ(float(one.temperature), on_sites.ground.temperature[i]);
            ASSERT_EQ(float(one.humidity), on_sites.ground.humidity[i]);
        }
        EXPECT_NEAR(on_sites.balance_error, 0, 1e-12);
        EXPECT_NEAR(on_sites.rainfall, on_cells.rainfall, 1e-12 * on_cells.rainfall);
    }
}

TEST(MeshGround, ADayOnEachFaceIsTheSoilsDayByHand)
{
    const Habitat habitat;
    const Scene scene = grown(slab(), habitat,
                              {{"days", 1},
                               {"initial_count", 0},
                               {"sky_light", 10},
                               {"runoff", false},
                               {"initial_water", 0.3},
                               {"rain_days", 365},
                               {"wind_speed", 1.5}});
    const WeatherDay weather = steady_weather({}, 1).days[0];
    const soil::Soil humus = soil::preset_soils()[0];
    const std::vector<float>& light = site_values(scene, "light_S");
    const MeshSites sites = mesh_sites(slab(), 0.1, {});
    const std::vector<float> depth = soil::mesh_depth(sites, {}).depth;
    ASSERT_EQ(light.size(), sites.size());
    for (std::size_t i = 0; i < light.size(); ++i) {
        SCOPED_TRACE(fmt::format("site {}, normal z {}", i, sites.normal[i].z));
        ASSERT_EQ(site_values(scene, "soil_h")[i], depth[i]);
        ASSERT_EQ(depth[i], sites.normal[i].z > 0.5f ? 200.0f : 1.0f);
        const soil::Day day =
            soil::day({.light = double(light[i]),
                       .temperature = weather.temperature,
                       .humidity = weather.humidity,
                       .rain = 1861.2 / 365 * double(site_values(scene, "rain_exposure")[i]),
                       .wind = 1.5,
                       .sky_view = double(site_values(scene, "sky_view")[i]),
                       .depth = double(depth[i]),
                       .water = 0.3 * double(depth[i]) * humus.porosity},
                      {.sunshine = 0.75, .pressure = 1013}, humus, {});
        ASSERT_NEAR(site_values(scene, "soil_Ts")[i], day.temperature, 4e-5);
        ASSERT_NEAR(site_values(scene, "soil_rh")[i], day.humidity, 1e-6);
        ASSERT_NEAR(site_values(scene, "soil_water")[i], day.water, 1e-5);
        ASSERT_NEAR(site_values(scene, "soil_E")[i], day.evaporation, 1e-5);
    }
}

// ---- Weather without a file, means ------------------------------------------------------------

TEST(SteadyWeatherOfEveryDay, RainsOn180DaysAYear)
{
    const Weather weather = steady_weather({}, 2 * 365);
    double sum = 0;
    int rainy = 0;
    for (std::size_t d = 0; d < weather.days.size(); ++d) {
        const WeatherDay& day = weather.days[d];
        const bool rains = 180 * (d + 1) / 365 > 180 * d / 365;
        EXPECT_NEAR(day.precipitation, rains ? 10.34 : 0, 1e-12) << d;
        EXPECT_EQ(day.temperature, 288.15);
        EXPECT_EQ(day.humidity, 0.73);
        EXPECT_EQ(day.sunshine / day.possible_sunshine, 0.75);
        if (d < 365) sum += day.precipitation, rainy += day.precipitation > 0;
    }
    EXPECT_EQ(rainy, 180);
    EXPECT_NEAR(sum, 1861.2, 1e-9);
    EXPECT_EQ(weather.days[0].precipitation, 0);
    EXPECT_GT(weather.days[2].precipitation, 0);  // floor(180 * 3 / 365) = 1
    EXPECT_EQ(weather.days[365].year, 2002);
    EXPECT_EQ(weather.days[365].month * 100 + weather.days[365].day, 101);
}

TEST(SteadyWeatherOfEveryDay, AnyNumberOfRainyDaysSumsToTheYearsRain)
{
    for (const int days : {1, 7, 180, 364, 365}) {
        double sum = 0;
        int rainy = 0;
        for (const WeatherDay& day : steady_weather({.rainfall = 730, .rain_days = days}, 365).days)
            sum += day.precipitation, rainy += day.precipitation > 0;
        EXPECT_EQ(rainy, days);
        EXPECT_NEAR(sum, 730, 1e-9) << days;
    }
}

TEST(LightMean, TakesEachDayByItsShareUntilTheSpanIsFull)
{
    std::vector<float> mean{0, 100};
    const float first[] = {8, 0}, second[] = {4, 8}, third[] = {0, 8};
    light::running_mean(mean, first, 1, 2);
    EXPECT_THAT(mean, ::testing::ElementsAre(8, 0));  // what was before the first day is forgotten
    light::running_mean(mean, second, 2, 2);
    EXPECT_THAT(mean, ::testing::ElementsAre(6, 4));
    light::running_mean(mean, third, 3, 2);
    EXPECT_THAT(mean, ::testing::ElementsAre(3, 6));
}

// ---- The same bytes ---------------------------------------------------------------------------

TEST(MeshMoss, GivesTheSameBytesOnOneAndTwoThreads)
{
    const Habitat habitat;
    std::map<std::string, std::string> first;
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        const Scene scene =
            grown(roof::mesh(), habitat, {{"site", 0.2}, {"photons", 8192}, {"sky_light", 15}});
        if (threads == 1)
            first = hashes_of(scene);
        else
            EXPECT_EQ(hashes_of(scene), first);
        EXPECT_GT(living(scene), 30u);
    }
    EXPECT_GT(first.size(), 20u);
}

TEST(MeshMoss, TheSeedMovesMossAndNoise)
{
    const Habitat habitat;
    const auto a = hashes_of(grown(slab(), habitat, {}, 1)),
               b = hashes_of(grown(slab(), habitat, {}, 2));
    EXPECT_NE(a.at("points moss"), b.at("points moss"));
    EXPECT_NE(a.at("grid light_S"), b.at("grid light_S"));
    EXPECT_EQ(a.at("grid sky_view"), b.at("grid sky_view"));
}

TEST(MeshMoss, AMaskOfOnesChangesNothingAndNothingGrowsWhereItIsZero)
{
    const Habitat habitat;
    TriMesh ones = slab();
    ones.vertex_attributes["paint"] = std::vector<float>(ones.vertices.size(), 1);
    EXPECT_EQ(hashes_of(grown(ones, habitat, {{"mask", "paint"}})),
              hashes_of(grown(ones, habitat)));

    TriMesh half = slab();
    std::vector<std::int32_t> paint(half.triangles.size(), 1);
    std::size_t top = 0;
    for (std::size_t t = 0; t < paint.size(); ++t) {
        const auto& [a, b, c] = half.triangles[t];
        const bool flat =
            half.vertices[a].z == 0 && half.vertices[b].z == 0 && half.vertices[c].z == 0;
        if (flat && top++ == 0) paint[t] = 0;
    }
    half.face_attributes["paint"] = paint;
    const Scene scene = grown(half, habitat, {{"mask", "paint"}, {"days", 15}});
    const std::vector<std::int32_t>& face = site_values<std::int32_t>(scene, "face");
    std::size_t on_ones = 0;
    for (const std::int64_t host : of_moss<std::int64_t>(scene, "host")) {
        if (host >= 0) continue;
        const auto site = static_cast<std::size_t>(-1 - host);
        ASSERT_EQ(paint[std::size_t(face[site])], 1) << "moss on site " << site;
        ++on_ones;
    }
    EXPECT_GT(on_ones, 20u);
    for (std::size_t i = 0; i < face.size(); ++i)
        if (paint[std::size_t(face[i])] == 0) {
            EXPECT_EQ(site_values(scene, "suit_bryum")[i], 0);
        }
}

TEST(MeshMoss, AMaskBeyondItsRangeIsNamed)
{
    const Habitat habitat;
    for (const float value : {-0.1f, 1.5f, std::nanf("")}) {
        TriMesh mesh = slab();
        std::vector<float> paint(mesh.triangles.size(), 0.5f);
        paint[7] = value;
        mesh.face_attributes["paint"] = paint;
        EXPECT_THAT(
            [&] {
                grown(mesh, habitat, {{"mask", "paint"}});
            },
            ThrowsMessage<InvalidInput>(AllOf(HasSubstr("'paint'"), HasSubstr("face 7"),
                                              HasSubstr("0 to 1"),
                                              HasSubstr(fmt::format("{}", value)))));
    }
    TriMesh mesh = slab();
    mesh.vertex_attributes["flow"] = std::vector<Vec3f>(mesh.vertices.size());
    EXPECT_THAT(
        [&] {
            grown(mesh, habitat, {{"mask", "flow"}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("vector")));
    EXPECT_THAT(
        [&] {
            grown(mesh, habitat, {{"mask", "pant"}});
        },
        ThrowsMessage<InvalidInput>(AllOf(HasSubstr("'pant'"), HasSubstr("flow"))));
}

TEST(MeshMoss, VertexAttributesAreLinearOverEachFace)
{
    TriMesh mesh = slab();
    std::vector<float> height;
    for (const Vec3f v : mesh.vertices) height.push_back(2 * v.x - v.y + 3 * v.z);
    mesh.vertex_attributes["height"] = height;
    const MeshSites sites = mesh_sites(mesh, 0.1, {});
    const std::vector<float> found = attribute_at_sites(mesh, sites, "height");
    for (std::size_t i = 0; i < found.size(); ++i) {
        const Vec3f p = sites.position[i];
        EXPECT_NEAR(found[i], 2 * p.x - p.y + 3 * p.z, 1e-6);
    }
}

// ---- Checkpoints ------------------------------------------------------------------------------

class MeshCheckpoint : public ::testing::Test {
protected:
    MeshCheckpoint()
    {
        mesh = slab();
        std::vector<std::int32_t> zone;
        for (std::size_t t = 0; t < mesh.triangles.size(); ++t) zone.push_back(int(t / 2));
        mesh.face_attributes["zone"] = zone;
    }
    static Json params(const Json& more = Json::object())
    {
        Json values = quick({{"days", 20}, {"checkpoint", "moss.checkpoint"}, {"ema_days", 10}});
        if (more.is_object()) values.update(more);
        return values;
    }
    /// Leaves a checkpoint of day 10 by stopping a run soon after.
    void interrupt()
    {
        Scene scene = mesh_scene(mesh);
        Stopped stopped(habitat.context(), 0.6);
        EXPECT_THROW(run_on_mesh(scene, "moss", params(), stopped.context), Cancelled);
        ASSERT_TRUE(std::filesystem::exists(habitat.folder / "moss.checkpoint"));
    }
    Habitat habitat;
    TriMesh mesh;
};

TEST_F(MeshCheckpoint, TwiceTenDaysAreTwentyDays)
{
    Scene whole = mesh_scene(mesh);
    run_on_mesh(whole, "moss", params({{"checkpoint", ""}}), habitat.context());
    interrupt();
    Scene resumed = mesh_scene(mesh);
    int reports = 0;
    std::atomic<bool> never = false;
    StageContext context = habitat.context();
    context.progress = Progress(
        [&](const std::string&, double now) { reports += now > 0.11 && now < 0.5; }, &never);
    run_on_mesh(resumed, "moss", params(), context);
    EXPECT_EQ(reports, 0) << "it lived the first ten days once more";
    EXPECT_EQ(hashes_of(resumed), hashes_of(whole));
    EXPECT_GT(living(whole), 20u);
    EXPECT_TRUE(whole.points.contains("zones"));
}

TEST_F(MeshCheckpoint, ARecipesOwnIsRemovedOnceTheResultIsThere)
{
    StageContext context = habitat.context();
    context.checkpoint = habitat.folder / "own.checkpoint";
    Scene scene = mesh_scene(mesh);
    {
        Stopped stopped(context, 0.6);
        EXPECT_THROW(run_on_mesh(scene, "moss", params({{"checkpoint", ""}}), stopped.context),
                     Cancelled);
    }
    EXPECT_TRUE(std::filesystem::exists(context.checkpoint));
    Scene resumed = mesh_scene(mesh);
    run_on_mesh(resumed, "moss", params({{"checkpoint", ""}}), context);
    EXPECT_FALSE(std::filesystem::exists(context.checkpoint));
}

TEST_F(MeshCheckpoint, OfAnotherRunIsRefusedAndSaysWhatDiffers)
{
    interrupt();
    auto refused = [&](const TriMesh& on, const Json& more, std::uint64_t seed,
                       const std::string& words) {
        Scene scene = mesh_scene(on);
        const auto before = hashes_of(scene);
        EXPECT_THAT(
            [&] { run_on_mesh(scene, "moss", params(more), habitat.context(seed)); },
            ThrowsMessage<InvalidInput>(AllOf(HasSubstr("moss.checkpoint"), HasSubstr(words))));
        EXPECT_EQ(hashes_of(scene), before);
    };
    refused(mesh, {}, 8, "seed 7");
    refused(shapes::box({0, 0, -0.21}, {0.6, 0.4, 0}), {}, 7, "mesh");
    refused(mesh, {{"growth_rate", 0.5}}, 7, "growth_rate");
    refused(mesh, {{"photons", 4097}}, 7, "photons");
    refused(mesh, {{"open_light", 26}}, 7, "open_light");
    refused(mesh, {{"soil", "sand"}}, 7, "soil");
    refused(mesh, {{"species", "bryum"}}, 7, "species");
    TriMesh painted = mesh;
    painted.vertex_attributes["paint"] = std::vector<float>(mesh.vertices.size(), 0.5f);
    refused(painted, {{"mask", "paint"}}, 7, "ma");
}

TEST_F(MeshCheckpoint, ADamagedOneIsRefused)
{
    interrupt();
    const std::string good = read_file(habitat.folder / "moss.checkpoint");
    for (const std::size_t length :
         {std::size_t(0), std::size_t(7), good.size() / 2, good.size() - 1}) {
        write_file(habitat.folder / "moss.checkpoint", good.substr(0, length));
        Scene scene = mesh_scene(mesh);
        EXPECT_THAT([&] { run_on_mesh(scene, "moss", params(), habitat.context()); },
                    ThrowsMessage<InvalidInput>(HasSubstr("moss.checkpoint")));
    }
}

// ---- Light ------------------------------------------------------------------------------------

TEST(MeshMoss, WithoutLightThereIsNone)
{
    const Habitat habitat;
    const Scene scene = grown(slab(), habitat, {{"open_light", 0}, {"sky_light", 0}});
    EXPECT_EQ(living(scene), 0u);
    for (const float light : site_values(scene, "light_S")) EXPECT_EQ(light, 0);
    EXPECT_GT(living(grown(slab(), habitat)), 20u);
    // Without the gate it grows in the dark, as the paper's formula has it.
    EXPECT_GT(living(grown(slab(), habitat,
                           {{"open_light", 0}, {"sky_light", 0}, {"light_gate", false}})),
              0u);
}

TEST(MeshMoss, UnderAShelterItLivesByBouncesAlone)
{
    const Habitat habitat;
    const TriMesh mesh = roof::joined(
        {shapes::box({0, 0, -0.2}, {1, 0.6, 0}), shapes::box({-0.2, -0.2, 0.15}, {0.5, 0.8, 0.2})});
    std::size_t below[2];
    for (const bool indirect : {true, false}) {
        const Scene scene = grown(mesh, habitat,
                                  {{"open_light", 150},
                                   {"albedo", 0.5},
                                   {"photons", 8192},
                                   {"photon_radius", 0.05},
                                   {"indirect", indirect},
                                   {"rain_shelter", false},
                                   {"initial_count", 60}});
        std::size_t& count = below[indirect ? 0 : 1];
        count = 0;
        for (const Vec3d& p : scene.points_of("moss").position)
            count += p.z < 0.14 && p.z > -0.001 && p.x < 0.44;
        const auto shaded = [](Vec3d n, Vec3d p) { return n.z > 0.9 && p.z < 0.1 && p.x < 0.44; };
        if (indirect)
            EXPECT_GT(site_mean(scene, "light_S", shaded), 1);
        else
            EXPECT_EQ(site_mean(scene, "light_S", shaded), 0);
    }
    EXPECT_GT(below[0], 5u);
    EXPECT_EQ(below[1], 0u);
}

TEST(MeshMoss, LightOfAnOpenPlateIsThatOfTheDay)
{
    const Habitat habitat;
    for (const double elevation : {90.0, 35.0}) {
        Scene scene = mesh_scene(slab());
        run_on_mesh(scene, "light",
                    {{"site", 0.05},
                     {"photons", 200'000},
                     {"photon_radius", 0.05},
                     {"open_light", 120},
                     {"sun_elevation", elevation},
                     {"sky_light", 40}},
                    habitat.context());
        EXPECT_NEAR(site_mean(scene, "light_direct", up), 120, 1.5) << elevation;
        EXPECT_NEAR(site_mean(scene, "light_sky", up), 40, 1);
        EXPECT_NEAR(site_mean(scene, "sky_view", up), 1, 1e-6);
        EXPECT_NEAR(site_mean(scene, "light_S", up), 160, 2);
        // The sun stands in the south: the north side sees half the sky and no sun.
        const auto north = [](Vec3d n, Vec3d) { return n.y > 0.9; };
        // But for the sun's disc, half of which looks over the edge when it stands overhead.
        EXPECT_NEAR(site_mean(scene, "light_direct", north), elevation == 90 ? 0.12 : 0, 0.05);
        EXPECT_NEAR(site_mean(scene, "light_sky", north), 20, 1);
        const auto south = [](Vec3d n, Vec3d) { return n.y < -0.9; };
        EXPECT_NEAR(site_mean(scene, "light_direct", south),
                    120 / std::tan(elevation * math::kPi / 180), 3);
    }
}

TEST(MeshMoss, CellsOfAClosedBoxHaveTheLightOfItsSites)
{
    const Habitat habitat;
    Scene scene = mesh_scene(slab());
    run_on_mesh(scene, "light",
                {{"site", 0.04},
                 {"photons", 100'000},
                 {"photon_radius", 0.05},
                 {"cell", 0.02},
                 {"open_light", 100},
                 {"sun_elevation", 50},
                 {"sky_light", 30}},
                habitat.context());
    const SurfaceCells cells = cells_of(scene);
    for (const char* name : {"light_S", "light_direct", "light_sky", "sky_view"}) {
        const std::vector<float> values = cells.from_grid(scene.floats(name), -1);
        for (int axis = 0; axis < 3; ++axis)
            for (const double side : {-1.0, 1.0}) {
                SCOPED_TRACE(fmt::format("{}, axis {}, side {}", name, axis, side));
                double sum = 0, area = 0;
                for (std::size_t i = 0; i < cells.size(); ++i)
                    if (side * double(cells.normal[i][axis]) > 0.95) {
                        sum += double(values[i]) * double(cells.area[i]);
                        area += double(cells.area[i]);
                    }
                const double on_sites =
                    site_mean(scene, name, [&](Vec3d n, Vec3d) { return side * n[axis] > 0.95; });
                EXPECT_NEAR(sum / area, on_sites, 0.04 * std::max(1.0, on_sites));
            }
    }
}

/// What is warned of while it lives.
class Warnings {
public:
    Warnings() : level_(log::level())
    {
        log::set_level(log::Level::Warning);
        log::set_sink([this](log::Level, const std::string& line) { text += line + "\n"; });
    }
    ~Warnings()
    {
        log::set_sink({});
        log::set_level(level_);
    }
    std::string text;

private:
    log::Level level_;
};

TEST(MeshMoss, AnOpenSheetHasNoCellsAndIsToldOf)
{
    const Habitat habitat;
    TriMesh sheet;
    sheet.vertices = {{0, 0, 0}, {0.5f, 0, 0}, {0.5f, 0.5f, 0}, {0, 0.5f, 0}};
    sheet.triangles = {{0, 1, 2}, {0, 2, 3}};
    const Warnings warnings;
    const Scene scene = grown(sheet, habitat);
    EXPECT_TRUE(scene.grids.empty());
    EXPECT_THAT(warnings.text, HasSubstr("encloses nothing"));
    EXPECT_GT(living(scene), 5u);
    for (const float h : site_values(scene, "soil_h")) EXPECT_EQ(h, 1000);
}

// ---- Numbers ----------------------------------------------------------------------------------

TEST(MeshMoss, ZonesAndStatisticsCountWhatLives)
{
    const Habitat habitat;
    TriMesh mesh = roof::mesh();
    std::vector<std::int32_t> zone;
    for (const auto& [a, b, c] : mesh.triangles) {
        const Vec3d n = normalized(cross(Vec3d(mesh.vertices[b]) - Vec3d(mesh.vertices[a]),
                                         Vec3d(mesh.vertices[c]) - Vec3d(mesh.vertices[a])));
        zone.push_back(n.z > 0.9 ? 4 : n.z < -0.9 ? -2 : 9);
    }
    mesh.face_attributes["zone"] = zone;
    const Scene scene =
        grown(mesh, habitat, {{"site", 0.2}, {"photons", 8192}, {"initial_count", 60}});
    const double last = 12;
    double count[3] = {}, growth[3] = {}, living_now[3] = {}, growth_now[3] = {}, rows[3] = {};
    for (std::size_t r = 0; r < of_zones(scene, "day").size(); ++r)
        if (of_zones(scene, "day")[r] == last) {
            const auto s = std::size_t(of_zones(scene, "species")[r]);
            count[s] += of_zones(scene, "living")[r];
            growth[s] += of_zones(scene, "growth")[r];
        }
    const std::vector<std::int32_t>& species = of_moss<std::int32_t>(scene, "species");
    for (std::size_t i = 0; i < species.size(); ++i) {
        living_now[species[i]] += 1;
        growth_now[species[i]] += double(of_moss<float>(scene, "growth")[i]);
    }
    for (std::size_t r = 0; r < column(scene, "day").size(); ++r)
        if (column(scene, "day")[r] == last && column(scene, "species")[r] >= 0)
            rows[std::size_t(column(scene, "species")[r])] = column(scene, "living")[r];
    for (int s = 0; s < 3; ++s) {
        EXPECT_EQ(count[s], living_now[s]);
        EXPECT_EQ(rows[s], living_now[s]);
        EXPECT_NEAR(growth[s], growth_now[s], 1e-3);
        EXPECT_GT(living_now[s], 0);
    }
    EXPECT_EQ(of_zones(scene, "day").size(), 12u * 3 * 3);
    EXPECT_EQ(std::set<double>(of_zones(scene, "zone").begin(), of_zones(scene, "zone").end()),
              (std::set<double>{-2, 4, 9}));
    // A zone travels on with the faces.
    EXPECT_EQ(
        std::get<std::vector<std::int32_t>>(scene.meshes.at("rock").face_attributes.at("zone"))
            .size(),
        scene.meshes.at("rock").triangles.size());
}

TEST(MeshMoss, TheOpenZoneHasTheDaysLight)
{
    const Habitat habitat;
    TriMesh mesh = slab();
    std::vector<std::int32_t> zone(mesh.triangles.size(), 0);
    zone[10] = zone[11] = 1;  // +z
    mesh.face_attributes["zone"] = zone;
    const Scene scene =
        grown(mesh, habitat, {{"days", 3}, {"photons", 60'000}, {"initial_count", 0}});
    for (std::size_t r = 0; r < of_zones(scene, "day").size(); ++r) {
        if (of_zones(scene, "zone")[r] != 1) continue;
        EXPECT_NEAR(of_zones(scene, "light")[r], 25, 0.5);
        EXPECT_LT(of_zones(scene, "light_sd")[r], 1.5);
        EXPECT_NEAR(of_zones(scene, "theta")[r], of_zones(scene, "theta_median")[r], 1e-3);
    }
}

TEST(MeshMoss, PhotonsOfEveryDayAreAccountedFor)
{
    const Habitat habitat;
    const Scene scene =
        grown(roof::mesh(), habitat, {{"site", 0.2}, {"albedo", 0.5}, {"sky_light", 20}});
    for (std::size_t r = 0; r < column(scene, "day").size(); ++r) {
        const double emitted = column(scene, "emitted")[r];
        EXPECT_GT(emitted, 0);
        EXPECT_NEAR(column(scene, "missed")[r] + column(scene, "absorbed")[r] +
                        column(scene, "escaped")[r] + column(scene, "lost")[r],
                    emitted, 1e-9 * emitted);
        EXPECT_GT(column(scene, "stored")[r], 1000);
        EXPECT_LT(column(scene, "stored")[r], 2 * 4096);
        EXPECT_EQ(column(scene, "lost")[r], 0);
    }
    const std::string csv = statistics_csv(scene.points_of("statistics"), {"bryum", "hypnum", "p"});
    for (const Column& c : Statistics::photon_columns())
        EXPECT_THAT(csv.substr(0, csv.find('\n')), HasSubstr("," + c.name)) << c.name;
}

TEST(MeshMoss, WaterOfEveryDayIsAccountedFor)
{
    const Habitat habitat;
    Scene scene = mesh_scene(roof::mesh());
    const Json summary =
        run_on_mesh(scene, "moss", quick({{"site", 0.2}, {"runoff", true}, {"rain_days", 365}}),
                    habitat.context());
    EXPECT_LT(std::abs(summary["largest_balance_error"].get<double>()), 1e-9);
}

TEST(MeshMoss, OwnEnergyIsTheSoilsDayInThePlantsLight)
{
    const Habitat habitat;
    Json own{{"days", 1},       {"initial_count", 40},   {"runoff", false},
             {"sky_light", 10}, {"rain_shelter", false}, {"initial_water", 0.5},
             {"site", 0.2},     {"photon_radius", 0.05}, {"species", "bryum"}};
    const Scene plain = grown(slab(), habitat, own);
    own["own_energy"] = true;
    const Scene scene = grown(slab(), habitat, own);
    const moss::Species bryum = moss::preset_species()[0];
    moss::Rules rules;
    rules.light_gate = true;
    ASSERT_EQ(living(plain), living(scene));
    int otherwise = 0;
    for (std::size_t i = 0; i < living(scene); ++i) {
        const auto site = static_cast<std::size_t>(-1 - of_moss<std::int64_t>(scene, "host")[i]);
        const double light = double(of_moss<float>(scene, "S")[i]);
        ASSERT_EQ(light, of_moss<float>(plain, "S")[i]);
        // Without it: the light is the plant's own, all else its site's.
        EXPECT_NEAR(of_moss<float>(plain, "suit")[i],
                    moss::fitness(bryum, rules, double(site_values(plain, "soil_Ts")[site]),
                                  double(site_values(plain, "soil_rh")[site]), light)
                        .total(),
                    2e-5);
        const double depth = double(site_values(scene, "soil_h")[site]);
        const soil::Day day =
            soil::day({.light = light,
                       .temperature = 288.15,
                       .humidity = 0.73,
                       .rain = 0,
                       .wind = 0.2,
                       .sky_view = double(site_values(scene, "sky_view")[site]),
                       .cover = double(site_values(scene, "moss_cover")[site]),
                       .depth = depth,
                       .water = 0.5 * depth * 0.49},
                      {.sunshine = 0.75, .pressure = 1013}, soil::preset_soils()[0], {});
        const float suit = of_moss<float>(scene, "suit")[i];
        EXPECT_NEAR(suit, moss::fitness(bryum, rules, day.temperature, day.humidity, light).total(),
                    2e-5);
        otherwise += std::abs(suit - of_moss<float>(plain, "suit")[i]) > 1e-3f;
    }
    EXPECT_GT(otherwise, 5);
}

TEST(MeshMoss, OwnEnergyHasTheGroundOfTheMorning)
{
    // On humus that many settlers cover, day 8 begins with the water and the cover of day 7.
    const Habitat habitat;
    Json own{{"days", 7},
             {"initial_count", 300},
             {"runoff", false},
             {"sky_light", 10},
             {"rain_shelter", false},
             {"rainfall", 0},
             {"own_energy", true},
             {"species", "bryum"},
             {"site", 0.2},
             {"photon_radius", 0.05}};
    const Scene before = grown(slab(), habitat, own);
    own["days"] = 8;
    const Scene after = grown(slab(), habitat, own);
    const moss::Species bryum = moss::preset_species()[0];
    moss::Rules rules;
    rules.light_gate = true;
    int changed = 0;
    for (std::size_t i = 0; i < living(after); ++i) {
        const auto site = static_cast<std::size_t>(-1 - of_moss<std::int64_t>(after, "host")[i]);
        if (site >= site_values(after, "soil_h").size()) continue;  // stands on another moss
        const double light = double(of_moss<float>(after, "S")[i]);
        auto suit = [&](const Scene& ground) {
            const soil::Day day =
                soil::day({.light = light,
                           .temperature = 288.15,
                           .humidity = 0.73,
                           .rain = 0,
                           .wind = 0.2,
                           .sky_view = double(site_values(after, "sky_view")[site]),
                           .cover = double(site_values(ground, "moss_cover")[site]),
                           .depth = double(site_values(after, "soil_h")[site]),
                           .water = double(site_values(ground, "soil_water")[site])},
                          {.sunshine = 0.75, .pressure = 1013}, soil::preset_soils()[0], {});
            return moss::fitness(bryum, rules, day.temperature, day.humidity, light).total();
        };
        EXPECT_NEAR(of_moss<float>(after, "suit")[i], suit(before), 2e-5);
        changed += std::abs(suit(before) - suit(after)) > 1e-4;
    }
    EXPECT_GT(changed, 20);
}

// ---- Wind, geology ----------------------------------------------------------------------------

TEST(MeshMoss, TheWindOfCellsReachesTheSites)
{
    const Habitat habitat;
    Scene scene = mesh_scene(slab());
    scene.put("surface_sdf",
              level_set_from_mesh(slab(), Transform{{-0.15, -0.15, -0.35}, 0.05}, {}), "m",
              "lantern", GridClass::LevelSet);
    const SurfaceCells cells = surface_cells(scene.floats("surface_sdf"), {});
    scene.put("surf_normal", cells.to_grid(cells.normal), "", "scenery", "covariant normalize");
    scene.put("surf_area", cells.to_grid(cells.area), "m^2", "scenery");
    for (int k = 0; k < 8; ++k) {
        std::vector<float> ratio(cells.size());
        for (std::size_t i = 0; i < ratio.size(); ++i)
            ratio[i] = k == 0 ? 0.5f + float(cells.position[i].x) : 9.0f;
        scene.put(fmt::format("wind_ratio_{}", k), cells.to_grid(ratio), "", "wind");
    }
    wind::AirTables tables;
    tables.speed.fill(0.8);
    scene.points["air_tables"] = table_points(tables);
    run_on_mesh(scene, "moss",
                quick({{"days", 1},
                       {"initial_count", 0},
                       {"wind_speed", 4},
                       {"runoff", false},
                       {"rain_shelter", false}}),
                habitat.context());
    std::size_t seen = 0;
    for (std::size_t i = 0; i < site_values(scene, "area").size(); ++i) {
        const Vec3d p = scene.points_of("sites").position[i];
        if (site_values<Vec3f>(scene, "N")[i].z < 0.9f || p.x < 0.1 || p.x > 0.5) continue;
        ++seen;
        const double depth = double(site_values(scene, "soil_h")[i]);
        const soil::Day day =
            soil::day({.light = double(site_values(scene, "light_S")[i]),
                       .temperature = 288.15,
                       .humidity = 0.73,
                       .wind = 4 * 0.8 * (0.5 + p.x),
                       .sky_view = double(site_values(scene, "sky_view")[i]),
                       .depth = depth,
                       .water = 0.5 * depth * 0.49},
                      {.sunshine = 0.75, .pressure = 1013}, soil::preset_soils()[0], {});
        EXPECT_NEAR(site_values(scene, "soil_Ts")[i], day.temperature, 0.02);
        EXPECT_NEAR(site_values(scene, "soil_E")[i], day.evaporation,
                    1e-6 * std::abs(day.evaporation));
    }
    EXPECT_GT(seen, 10u);
    // The grids lie on the cells that were there.
    EXPECT_EQ(cells_of(scene).size(), cells.size());
}

TEST(MeshMoss, ATextureSaysWhichSoilLiesWhere)
{
    const Habitat habitat;
    Image8 image;
    image.width = 2, image.height = 1, image.channels = 3;
    image.pixels = {0x6F, 0x4B, 0x3E, 0xC3, 0x91, 0x43};  // humus to the left, sand to the right
    write_png(habitat.folder / "soil.png", image);
    TriMesh mesh = slab();
    for (int corner = 0; corner < 3; ++corner) {
        std::vector<Vec3f> uv;
        for (const auto& t : mesh.triangles) {
            const float x = mesh.vertices[t[std::size_t(corner)]].x;
            uv.push_back({0.25f + x / 0.6f * 0.5f, 0.5f, 0});
        }
        mesh.face_attributes[fmt::format("uv_{}", corner)] = uv;
    }
    const Scene scene = grown(mesh, habitat, {{"texture", "soil.png"}, {"days", 1}});
    std::size_t humus = 0, sand = 0;
    for (std::size_t i = 0; i < site_values(scene, "area").size(); ++i) {
        const double x = scene.points_of("sites").position[i].x;
        const int geology = site_values<std::int32_t>(scene, "geology")[i];
        if (x < 0.2) {
            EXPECT_EQ(geology, 1);
            ++humus;
        }
        if (x > 0.4) {
            EXPECT_EQ(geology, 2);
            ++sand;
        }
    }
    EXPECT_GT(humus, 10u);
    EXPECT_GT(sand, 10u);
    EXPECT_THAT(
        [&] {
            grown(slab(), habitat, {{"texture", "soil.png"}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("the mesh")));
    EXPECT_THAT(
        [&] {
            grown(mesh, habitat, {{"texture", "none.png"}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("none.png")));
}

TEST(MeshMoss, AGeologyBeyondTheKnownIsNamedWithItsFace)
{
    const Habitat habitat;
    const int beyond = int(soil::preset_soils().size()) + 1;
    for (const int bad : {-1, beyond, 99, 101}) {
        TriMesh mesh = slab();
        std::vector<std::int32_t> geology(mesh.triangles.size(), 3);
        geology[5] = bad;
        mesh.face_attributes["geology"] = geology;
        EXPECT_THAT([&] { grown(mesh, habitat); },
                    ThrowsMessage<InvalidInput>(AllOf(HasSubstr("geology"), HasSubstr("face 5"),
                                                      HasSubstr(std::to_string(bad)))));
    }
    TriMesh mesh = slab();
    std::vector<std::int32_t> geology(mesh.triangles.size(), 3);
    geology[0] = 0, geology[1] = 100;
    mesh.face_attributes["geology"] = geology;
    const Scene scene = grown(mesh, habitat, {{"days", 1}});
    for (std::size_t i = 0; i < site_values(scene, "area").size(); ++i) {
        const int face = site_values<std::int32_t>(scene, "face")[i];
        EXPECT_EQ(site_values<std::int32_t>(scene, "geology")[i], face == 0   ? 1
                                                                  : face == 1 ? 100
                                                                              : 3);
        if (face > 1) {
            EXPECT_EQ(site_values(scene, "soil_h")[i], 20);
        }
    }
}

TEST(MeshMoss, ASunOnItsPathNeedsAPlace)
{
    const Habitat habitat;
    EXPECT_THAT(
        [&] {
            grown(slab(), habitat, {{"sun", "path"}});
        },
        ThrowsMessage<InvalidParameter>(HasSubstr("weather")));
}

}  // namespace
}  // namespace sekitei::apps
