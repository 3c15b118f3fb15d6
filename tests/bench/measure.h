#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <ctime>
#include <functional>
#include <string>
#include <vector>

#include "core/hash.h"
#include "core/parallel.h"

/// What the benchmarks measure with.
namespace sekitei::bench {

inline double seconds_of(const std::function<void()>& work)
{
    const auto start = std::chrono::steady_clock::now();
    work();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

inline double median(std::vector<double> values)
{
    std::sort(values.begin(), values.end());
    return values[values.size() / 2];
}

/// Sixteen digits that tell equal results from others.
template <class T>
std::string hash_of(const std::vector<T>& values)
{
    return hash_hex({reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)})
        .substr(0, 16);
}

/// Of one case on so many threads.
struct Rounds {
    std::vector<double> seconds;    ///< passed
    std::vector<double> processor;  ///< seconds of processor, of all threads together
    std::string hash;               ///< of what the last round came to
};

/// Rounds of all cases that take turns, on two threads and on one; entry 2 c + threads - 1 is of
/// case c. A case has a number of `rounds`, its `work()` and the `hash()` of what that made.
template <class Case>
std::vector<Rounds> in_turn(const std::vector<Case>& cases)
{
    std::vector<Rounds> all(2 * cases.size());
    bool more = true;
    for (int round = 0; more; ++round) {
        more = false;
        for (std::size_t c = 0; c < cases.size(); ++c)
            for (const std::size_t threads : {2u, 1u}) {
                if (round >= cases[c].rounds) continue;
                more = true;
                const ThreadLimit limit(threads);
                Rounds& of = all[2 * c + threads - 1];
                const std::clock_t start = std::clock();
                of.seconds.push_back(seconds_of(cases[c].work));
                of.processor.push_back(static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
                of.hash = cases[c].hash();
            }
    }
    return all;
}

}  // namespace sekitei::bench
