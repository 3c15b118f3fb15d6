#pragma once

#include <memory>

#include "apps/stage.h"

/// One factory a process; each is defined in a file of its own.
namespace sekitei::apps {

std::unique_ptr<Stage> make_lava();
std::unique_ptr<Stage> make_cool();
std::unique_ptr<Stage> make_joint();
std::unique_ptr<Stage> make_weather();
std::unique_ptr<Stage> make_mesh();
std::unique_ptr<Stage> make_lantern();
std::unique_ptr<Stage> make_light();
std::unique_ptr<Stage> make_wind();
std::unique_ptr<Stage> make_soil();
std::unique_ptr<Stage> make_moss();
std::unique_ptr<Stage> make_statistics();
std::unique_ptr<Stage> make_plot();
std::unique_ptr<Stage> make_export();
std::unique_ptr<Stage> make_compare();
std::unique_ptr<Stage> make_render();

/// The lava preset a scene was made with, from its history; null when it has none.
inline const Json* lava_params(const Scene& scene)
{
    for (auto entry = scene.history.rbegin(); entry != scene.history.rend(); ++entry)
        if (entry->stage == "lava") return &entry->params;
    return nullptr;
}

}  // namespace sekitei::apps
