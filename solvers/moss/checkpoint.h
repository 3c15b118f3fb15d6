#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "core/error.h"

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

    /// @param where  the file, for the message
    /// @throws InvalidInput  there is none of this name
    const std::vector<double>& field(const std::string& name, const std::string& where) const
    {
        if (const auto found = fields.find(name); found != fields.end()) return found->second;
        throw InvalidInput(where + ": the checkpoint has no field '" + name + "'");
    }

    friend bool operator==(const CheckpointOf&, const CheckpointOf&) = default;
};

}  // namespace sekitei::moss
