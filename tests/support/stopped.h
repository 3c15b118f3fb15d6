#pragma once

#include <atomic>
#include <string>
#include <utility>

#include "apps/stage.h"

namespace sekitei::apps::testing {

/// A context that stops its stage once its progress has passed `fraction`.
struct Stopped {
    explicit Stopped(StageContext c, double fraction) : context(std::move(c))
    {
        context.progress = Progress(
            [this, fraction](const std::string&, double now) {
                if (now > fraction) stop = true;
            },
            &stop);
    }
    std::atomic<bool> stop = false;
    StageContext context;
};

}  // namespace sekitei::apps::testing
