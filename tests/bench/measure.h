#pragma once

#include <algorithm>
#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include "core/hash.h"

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

}  // namespace sekitei::bench
