#include "core/parallel.h"

#include <tbb/global_control.h>
#include <tbb/info.h>

namespace sekitei {

struct ThreadLimit::State {
    tbb::global_control control;
};

ThreadLimit::ThreadLimit(std::size_t threads)
{
    if (threads == 0) return;
    state_ = std::make_unique<State>(
        State{tbb::global_control(tbb::global_control::max_allowed_parallelism, threads)});
}

ThreadLimit::~ThreadLimit() = default;

std::size_t thread_count()
{
    return tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
}

}  // namespace sekitei
