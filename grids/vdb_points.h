#pragma once

#include <string>

#include "grids/scene.h"
#include "grids/vdb_format.h"

/// Points as OpenVDB point grids. The only place where OpenVDB itself reads and writes.
namespace sekitei::vdb {

/// A point grid with the attributes of `points`, and beside the usual P: `sekitei_position`
/// (doubles) and `sekitei_index` (their order), so that nothing is lost.
/// @throws InvalidInput  a position that is not finite, an attribute of the wrong length or name
RawGrid encode_points(const std::string& name, const Points& points);

/// Points of a grid that OpenVDB is known to read: our own after its hash was checked, or one that
/// survived decode_untrusted_points(). Foreign grids: positions from P, attributes of known types.
/// @throws InvalidInput  OpenVDB refuses it
Points decode_points(const RawGrid& grid, const std::string& where);

/// Decodes a grid nobody vouches for in a process of its own first, with bounded memory and time:
/// OpenVDB 10 can crash, spin or allocate without end on a damaged one.
/// @throws InvalidInput  it did
Points decode_untrusted_points(const RawGrid& grid, const std::string& where, double memory);

}  // namespace sekitei::vdb
