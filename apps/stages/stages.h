#pragma once

#include <array>
#include <memory>
#include <string>
#include <string_view>

#include "apps/stage.h"

/// One factory a process; each is defined in a file of its own.
namespace sekitei::apps {

/// Points as binary PLY: x y z as doubles, then every attribute.
std::string encode_points(const Points& points, const Progress& progress = {});

/// Which axis of a mesh file points to the sky.
enum class UpAxis { Z, Y };
constexpr std::array<std::string_view, 2> choice_names(UpAxis)
{
    return {"z", "y"};
}
/// Turns a mesh so that z points up: (x, y, z) with y up becomes (x, -z, y).
inline void raise_up(TriMesh& mesh, UpAxis up)
{
    if (up == UpAxis::Y)
        for (Vec3f& v : mesh.vertices) v = {v.x, -v.z, v.y};
}

std::unique_ptr<Stage> make_lava();
std::unique_ptr<Stage> make_cool();
std::unique_ptr<Stage> make_joint();
std::unique_ptr<Stage> make_weather();
std::unique_ptr<Stage> make_mesh();
std::unique_ptr<Stage> make_lantern();
std::unique_ptr<Stage> make_garden();
std::unique_ptr<Stage> make_light();
std::unique_ptr<Stage> make_wind();
std::unique_ptr<Stage> make_soil();
std::unique_ptr<Stage> make_moss();
std::unique_ptr<Stage> make_tree();
std::unique_ptr<Stage> make_forest();
std::unique_ptr<Stage> make_sketch();
std::unique_ptr<Stage> make_distribution();
std::unique_ptr<Stage> make_statistics();
std::unique_ptr<Stage> make_plot();
std::unique_ptr<Stage> make_export();
std::unique_ptr<Stage> make_compare();
std::unique_ptr<Stage> make_render();

}  // namespace sekitei::apps
