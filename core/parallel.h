#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstddef>
#include <memory>
#include <vector>

#if defined(__SANITIZE_THREAD__)
#include <sanitizer/tsan_interface.h>
#endif

/// Parallel loops whose result does not depend on the number of threads. All use of TBB is here.
namespace sekitei {

/// Limits every loop below to `threads` while it lives; 0 means all cores.
class ThreadLimit {
public:
    explicit ThreadLimit(std::size_t threads);
    ~ThreadLimit();
    ThreadLimit(const ThreadLimit&) = delete;
    ThreadLimit& operator=(const ThreadLimit&) = delete;

private:
    struct State;
    std::unique_ptr<State> state_;
};

/// Threads that loops use now.
std::size_t thread_count();

namespace detail {

/// Tells the thread sanitizer, which cannot see into the TBB library, that a loop's tasks come
/// after what stands before the loop and before what follows it. Tasks among themselves stay
/// unordered, so that a race between them is found. Nothing in other builds.
class LoopOrder {
public:
#if defined(__SANITIZE_THREAD__)
    LoopOrder()
    {
        __tsan_release(&before_);
    }
    ~LoopOrder()
    {
        __tsan_acquire(&after_);
    }
    class Task {
    public:
        explicit Task(LoopOrder& loop) : loop_(loop) { __tsan_acquire(&loop_.before_); }
        ~Task() { __tsan_release(&loop_.after_); }

    private:
        LoopOrder& loop_;
    };

private:
    char before_ = 0, after_ = 0;
#else
    struct Task {
        explicit Task(LoopOrder&) {}
    };
#endif
};

}  // namespace detail

/// Calls f(begin, end) on disjoint ranges that cover [0, count); the cut points are not fixed.
template <class F>
void parallel_for_range(std::size_t count, F&& f, std::size_t grain = 1)
{
    detail::LoopOrder order;
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, grain),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                          const detail::LoopOrder::Task task(order);
                          f(range.begin(), range.end());
                      });
}

/// Calls f(i) for each i in [0, count). Tasks write only what belongs to their own i.
template <class F>
void parallel_for(std::size_t count, F&& f, std::size_t grain = 1)
{
    parallel_for_range(
        count,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i != end; ++i) f(i);
        },
        grain);
}

/// Folds chunk results in index order: join(join(zero, map(0, chunk)), map(chunk, 2 chunk)), ...
///
/// Chunks have fixed bounds, so a floating-point sum is the same on any number of threads.
/// @param map   T(begin, end) for one chunk
/// @param join  T(T, T)
template <class T, class Map, class Join>
T parallel_fold(std::size_t count, std::size_t chunk, T zero, Map&& map, Join&& join)
{
    const std::size_t chunks = (count + chunk - 1) / chunk;
    std::vector<T> parts(chunks, zero);
    parallel_for(chunks, [&](std::size_t c) {
        parts[c] = map(c * chunk, std::min(count, (c + 1) * chunk));
    });
    T total = zero;
    for (const T& part : parts) total = join(total, part);
    return total;
}

/// Sum of f(i) over [0, count), ordered.
template <class F>
double parallel_sum(std::size_t count, F&& f, std::size_t chunk = 1024)
{
    return parallel_fold(
        count, chunk, 0.0,
        [&](std::size_t begin, std::size_t end) {
            double sum = 0;
            for (std::size_t i = begin; i != end; ++i) sum += f(i);
            return sum;
        },
        [](double a, double b) { return a + b; });
}

/// offsets[i] = sum of counts[0..i); one element longer than `counts`, the last is the total.
template <class T>
std::vector<T> prefix_sum(const std::vector<T>& counts)
{
    std::vector<T> offsets(counts.size() + 1, T{});
    for (std::size_t i = 0; i < counts.size(); ++i) offsets[i + 1] = offsets[i] + counts[i];
    return offsets;
}

}  // namespace sekitei
