#pragma once

#include <string>
#include <string_view>

namespace sekitei {

/// Reads a number with a unit and converts it to `unit`.
///
/// "2cm" read in "m" is 0.02; "20C" in "K" is 293.15; "30d" in "s" is 2592000; "45deg" in "rad" is
/// pi / 4; "50%" in "" is 0.5. A bare number is already in `unit`.
/// @throws InvalidParameter  no number, a unit of another dimension, trailing text, NaN or infinity
double parse_quantity(std::string_view text, std::string_view unit);

/// Reads a count: "20k" is 20000, "1.5M" 1500000, "1G" a thousand million; else as parse_quantity()
/// without a unit.
/// @throws InvalidParameter
double parse_count(std::string_view text);

/// "0.02 m"; the shortest text that reads back as the same number.
std::string quantity_text(double value, std::string_view unit);

/// The spellings parse_quantity accepts for this unit, for help texts: "um mm cm m km in ft".
std::string accepted_units(std::string_view unit);

/// Bytes from "8G", "500MB", "2GiB" or a bare number.
/// @throws InvalidParameter
double parse_bytes(std::string_view text);

}  // namespace sekitei
