#include "core/parallel.h"

#include <tbb/global_control.h>
#include <tbb/info.h>

namespace sekitei {

// Built in place: a global_control can be copied, but the limit of the copy ends with the original.
struct ThreadLimit::State {
    explicit State(std::size_t threads)
        : control(tbb::global_control::max_allowed_parallelism, threads)
    {
    }
    tbb::global_control control;
};

ThreadLimit::ThreadLimit(std::size_t threads)
{
    if (threads > 0) state_ = std::make_unique<State>(threads);
}

ThreadLimit::~ThreadLimit() = default;

std::size_t thread_count()
{
    return tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
}

}  // namespace sekitei
