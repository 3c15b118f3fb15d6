#pragma once

#include <string>

#include "solvers/wind/wind.h"

/// Wind that was found before an interruption.
namespace sekitei::apps {

/// A checkpoint: hash of the rest, then CBOR of what it belongs to and of the state.
/// @param identity  of the scene and the parameters
std::string encode_wind(const wind::State& state, const std::string& identity);
/// @param where  for messages
/// @throws InvalidInput  damaged, or of another identity
wind::State decode_wind(const std::string& bytes, const std::string& where,
                        const std::string& identity);

}  // namespace sekitei::apps
