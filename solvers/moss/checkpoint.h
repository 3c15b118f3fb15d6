#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace sekitei::moss {

/// What a run needs to go on after an interruption.
template <class State>
struct CheckpointOf {
    std::uint64_t seed = 0;
    /// Parameters and inputs it belongs to: text of any kind, best a JSON object of values and
    /// hashes, whose members a refusal names.
    std::string recipe;
    State population;
    /// What other solvers carry from day to day, by name: soil water.
    std::map<std::string, std::vector<double>> fields;

    friend bool operator==(const CheckpointOf&, const CheckpointOf&) = default;
};

}  // namespace sekitei::moss
