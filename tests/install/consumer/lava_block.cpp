// Makes a block of lava, cools it, writes it as a scene with its surface as a mesh, and reads both
// back. lava_block FOLDER: prints what it found; ends with 1 where something is not as it should
// be.

#include <cstdio>
#include <exception>
#include <filesystem>

#include "core/error.h"
#include "core/mesh_io.h"
#include "grids/marching_tetrahedra.h"
#include "grids/vdb_file.h"
#include "solvers/cooling/cooling.h"
#include "solvers/lava/lava.h"

using namespace sekitei;

namespace {

int failures = 0;

void expect(bool good, const char* what)
{
    if (good) return;
    std::fprintf(stderr, "not so: %s\n", what);
    ++failures;
}

}  // namespace

int main(int argc, char** argv)
try {
    const std::filesystem::path folder = argc > 1 ? argv[1] : ".";
    lava::Params body;
    body.preset = lava::Preset::Slab;
    body.size = Vec3d(1.6, 1.6, 1.6);
    body.voxel = 0.04;
    body.heat_cell = 0.16;
    lava::Result lava = lava::run({}, body, 7, {});
    cooling::Params heat;
    heat.steps = 40;
    cooling::Result cool = cooling::run({lava.region_coarse, lava.heat_domain}, heat, {}, {});
    const TriMesh surface = marching_tetrahedra(lava.body_sdf, 0, {});

    Scene scene;
    scene.domain = lava.domain;
    scene.heat_domain = lava.heat_domain;
    scene.put("body_sdf", std::move(lava.body_sdf), "m", "lava", GridClass::LevelSet);
    scene.put("temperature", std::move(cool.temperature), "K", "cool");
    const std::string before = content_hash(scene.grids.at("temperature"));
    write_vdb(folder / "block.vdb", scene);
    write_mesh(folder / "block.ply", surface);

    const Scene again = read_vdb(folder / "block.vdb");
    expect(content_hash(again.grids.at("temperature")) == before, "the temperature comes back");
    expect(again.grids.at("temperature").unit == "K", "with its unit");
    expect(again.domain.dims.x == 40, "and the box of 40 voxels");
    const TriMesh mesh = read_mesh(folder / "block.ply");
    expect(mesh.triangles.size() > 1000, "the mesh has faces");
    expect(mesh.triangles.size() == surface.triangles.size(), "all of them come back");
    try {
        heat.alpha = 1;
        cooling::run({lava.region_coarse, lava.heat_domain}, heat, {}, {});
        expect(false, "an unstable step is refused");
    } catch (const InvalidInput& error) {
        std::printf("refused: %s\n", error.what());
    }
    std::printf("%d steps, %zu triangles, temperature %s\n", cool.steps, mesh.triangles.size(),
                before.c_str());
    return failures == 0 ? 0 : 1;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
