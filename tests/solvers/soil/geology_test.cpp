#include "solvers/soil/geology.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"

namespace sekitei::soil {
namespace {

using testing::AllOf;
using testing::Each;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr std::int32_t kHumus = 1, kSand = 2, kAsphalt = 4;  // in preset_soils()

using Colour = std::array<std::uint8_t, 3>;

/// Four texels: their colours by row from the top.
Image8 picture(int width, const std::vector<Colour>& colours)
{
    Image8 image(width, static_cast<int>(colours.size()) / width, 3);
    for (std::size_t i = 0; i < colours.size(); ++i)
        for (std::size_t c = 0; c < 3; ++c) image.pixels[3 * i + c] = colours[i][c];
    return image;
}

/// A triangle whose centroid has the texture coordinates (u, v).
TriMesh spot(double u, double v)
{
    TriMesh mesh;
    mesh.vertices = {{0, 0, 0}, {2, 0, 0}, {0, 3, 1}};
    mesh.triangles = {{0, 1, 2}};
    const auto corner = [&](double du, double dv) {
        return std::vector<Vec3f>{Vec3f(Vec3d(u + du, v + dv, 0))};
    };
    mesh.face_attributes["uv_0"] = corner(0.001, -0.002);
    mesh.face_attributes["uv_1"] = corner(-0.003, 0);
    mesh.face_attributes["uv_2"] = corner(0.002, 0.002);
    return mesh;
}

std::vector<std::int32_t> of(const TriMesh& mesh, const Image8* texture,
                             const GeologyParams& params = {}, double edge = 10)
{
    return geology(mesh, mesh_sites(mesh, edge, Progress()), texture, preset_soils(), params,
                   "rock.ply", Progress());
}

Vec3d lab(int r, int g, int b)
{
    return lab_of_srgb(Vec3d(r, g, b) / 255.0);
}

TEST(Geology, LabOfKnownColours)
{
    // CIE 15 from sRGB's primaries at D65: printed in every table of conversions.
    const std::pair<Colour, Vec3d> known[] = {{{255, 0, 0}, {53.2408, 80.0925, 67.2032}},
                                              {{0, 255, 0}, {87.7347, -86.1827, 83.1793}},
                                              {{0, 0, 255}, {32.2970, 79.1875, -107.8602}},
                                              {{255, 255, 0}, {97.1393, -21.5537, 94.4780}},
                                              {{255, 255, 255}, {100, 0, 0}},
                                              {{0, 0, 0}, {0, 0, 0}}};
    for (const auto& [rgb, expected] : known)
        EXPECT_LT(length(lab(rgb[0], rgb[1], rgb[2]) - expected), 2e-3)
            << int(rgb[0]) << ' ' << int(rgb[1]) << ' ' << int(rgb[2]);
    // Greys have no colour; their lightness by the definition: Y of #7D7D7D is 0.205079.
    EXPECT_LT(length(lab(125, 125, 125) - Vec3d(116 * std::cbrt(0.20507874) - 16, 0, 0)), 1e-4);
    // The straight parts of both curves: a tenth of a per cent of white.
    EXPECT_NEAR(lab_of_srgb(Vec3d(0.01292)).x, 24389.0 / 27 * 0.001, 1e-9);
}

TEST(Geology, EachSoilsOwnColourAndItsNeighbourhood)
{
    for (const auto& [rgb, soil] :
         {std::pair(Colour{0x6F, 0x4B, 0x3E}, kHumus), std::pair(Colour{0xC3, 0x91, 0x43}, kSand),
          std::pair(Colour{0x7D, 0x7D, 0x7D}, kAsphalt),
          std::pair(Colour{0x50, 0x3A, 0x30}, kHumus), std::pair(Colour{0xE0, 0xB0, 0x70}, kSand),
          std::pair(Colour{0x60, 0x64, 0x68}, kAsphalt)}) {
        const Image8 image = picture(1, {rgb});
        EXPECT_THAT(of(spot(0.3, 0.7), &image), ElementsAre(soil));
    }
}

TEST(Geology, TexelsLieWhereTheyShouldAndRepeat)
{
    const Colour humus{0x6F, 0x4B, 0x3E}, sand{0xC3, 0x91, 0x43}, grey{0x7D, 0x7D, 0x7D};
    const Image8 image = picture(2, {humus, sand, grey, sand});  // two rows, the first on top
    for (const double whole : {0.0, 1.0, -3.0}) {
        EXPECT_THAT(of(spot(whole + 0.25, 0.75 - whole), &image), ElementsAre(kHumus));
        EXPECT_THAT(of(spot(whole + 0.75, 0.75 + whole), &image), ElementsAre(kSand));
        EXPECT_THAT(of(spot(whole + 0.25, 0.25 + whole), &image), ElementsAre(kAsphalt));
    }
    // Between texels, over the border too: at u = 0 the columns 1 and 0 have equal parts, and left
    // of it the last column has more.
    EXPECT_THAT(of(spot(0.97, 0.75), &image), ElementsAre(kSand));
    EXPECT_THAT(of(spot(0.03, 0.75), &image), ElementsAre(kHumus));
    EXPECT_THAT(of(spot(0.25, 0.47), &image), ElementsAre(kAsphalt));
    EXPECT_THAT(of(spot(0.25, 0.03), &image), ElementsAre(kAsphalt));
    EXPECT_THAT(of(spot(0.25, 0.97), &image), ElementsAre(kHumus));
}

TEST(Geology, MixesAreBilinearInSrgb)
{
    // A quarter of the way from black to white, sRGB 64: told by the error's colour.
    const Image8 image = picture(2, {{0, 0, 0}, {255, 255, 255}});
    GeologyParams params;
    params.colours = "sand #FF0000";
    params.farthest = 1;
    EXPECT_THAT([&] { of(spot(0.375, 0.5), &image, params); },
                ThrowsMessage<InvalidInput>(HasSubstr("the colour #404040")));
}

TEST(Geology, SitesOfOneFaceFollowTheTexture)
{
    const Colour humus{0x6F, 0x4B, 0x3E}, sand{0xC3, 0x91, 0x43};
    Image8 image(64, 1, 3);
    for (int x = 0; x < 64; ++x)
        for (int c = 0; c < 3; ++c)
            image.at(x, 0, c) = (x < 24 ? humus : sand)[static_cast<std::size_t>(c)];
    TriMesh mesh;  // u = x / 4, v = y / 4
    mesh.vertices = {{0, 0, 7}, {4, 0, 7}, {4, 4, 7}, {0, 4, 7}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    mesh.face_attributes["uv_0"] = std::vector<Vec3f>{{0, 0, 0}, {0, 0, 0}};
    mesh.face_attributes["uv_1"] = std::vector<Vec3f>{{1, 0, 0}, {1, 1, 0}};
    mesh.face_attributes["uv_2"] = std::vector<Vec3f>{{1, 1, 0}, {0, 1, 0}};
    const MeshSites sites = mesh_sites(mesh, 0.25, Progress());
    for (const std::size_t threads : {1, 4}) {
        const ThreadLimit limit(threads);
        const auto found =
            geology(mesh, sites, &image, preset_soils(), {}, "floor.obj", Progress());
        for (std::size_t i = 0; i < sites.size(); ++i)
            if (const float x = sites.position[i].x; x > 0.04F && x < 3.96F) {
                ASSERT_EQ(found[i], x < 1.5F ? kHumus : kSand) << x;
            }
    }
}

TEST(Geology, TheAttributeBeatsTheTexture)
{
    TriMesh mesh = spot(0.5, 0.5);
    mesh.face_attributes["geology"] = std::vector<std::int32_t>{3};
    const Image8 image = picture(1, {{0xC3, 0x91, 0x43}});
    EXPECT_THAT(of(mesh, &image, {}, 0.5), Each(3));
    EXPECT_THAT(of(mesh, nullptr, {}, 0.5), Each(3));
    mesh.face_attributes["geology"] = std::vector<float>{3};
    EXPECT_THAT([&] { of(mesh, &image); },
                ThrowsMessage<InvalidInput>(HasSubstr("must be one integer for each triangle")));
}

TEST(Geology, AColourUnlikeAllIsAnErrorOrTheFallback)
{
    const Image8 image = picture(1, {{0, 0, 255}});
    EXPECT_THAT([&] { of(spot(0.5, 0.5), &image); },
                ThrowsMessage<InvalidInput>(AllOf(
                    HasSubstr("rock.ply: face 0 at (0.6667, 1, 0.3333) has the colour #0000FF"),
                    HasSubstr("from humus"), HasSubstr("from sand"), HasSubstr("from asphalt"),
                    HasSubstr("within 40"))));
    GeologyParams params;
    params.fallback = "rock";
    EXPECT_THAT(of(spot(0.5, 0.5), &image, params), ElementsAre(3));
    // The border itself.
    const double distance = length(lab(0, 0, 255) - lab(0x7D, 0x7D, 0x7D));
    params = {};
    params.colours = "asphalt #7D7D7D";
    params.farthest = distance + 1e-9;
    EXPECT_THAT(of(spot(0.5, 0.5), &image, params), ElementsAre(kAsphalt));
    params.farthest = distance - 1e-9;
    EXPECT_THROW(of(spot(0.5, 0.5), &image, params), InvalidInput);
}

TEST(Geology, NamesWhatIsMissing)
{
    TriMesh bare = spot(0.5, 0.5);
    bare.face_attributes.clear();
    const Image8 image = picture(1, {{0, 0, 255}}), grey(2, 2, 1);
    EXPECT_THAT([&] { of(bare, nullptr); },
                ThrowsMessage<InvalidInput>(HasSubstr("rock.ply: nothing says what")));
    EXPECT_THAT([&] { of(bare, &image); },
                ThrowsMessage<InvalidInput>(HasSubstr("rock.ply: the mesh has a texture but no")));
    EXPECT_THAT([&] { of(spot(0, 0), &grey); },
                ThrowsMessage<InvalidInput>(HasSubstr("1 channels, must be RGB")));
    EXPECT_THAT(
        [&] { of(spot(NAN, 0), &image); },
        ThrowsMessage<InvalidInput>(HasSubstr("face 0 at (0.6667, 1, 0.3333) has texture")));
    GeologyParams params;
    params.fallback = "gravel";
    EXPECT_THAT([&] { of(spot(0, 0), &image, params); },
                ThrowsMessage<InvalidParameter>(
                    HasSubstr("soil 'gravel' is not known, must be one of humus, sand, rock")));
    params = {.colours = "sand #C3914G"};
    EXPECT_THAT([&] { of(spot(0, 0), &image, params); },
                ThrowsMessage<InvalidParameter>(HasSubstr("colours has 'sand #C3914G'")));
    for (const char* text :
         {"", " ", "sand", "#112233", "sand #12345", "sand #1122334", "a #112233,,"})
        EXPECT_THROW(soil_colours(text), InvalidParameter) << text;
    const auto colours = soil_colours(" dry sand #c39143 ,humus #000102,");
    ASSERT_EQ(colours.size(), 2u);
    EXPECT_EQ(colours[0].soil, "dry sand");
    EXPECT_EQ(colours[0].colour, (Colour{0xC3, 0x91, 0x43}));
    EXPECT_EQ(colours[1].colour, (Colour{0, 1, 2}));
}

}  // namespace
}  // namespace sekitei::soil
