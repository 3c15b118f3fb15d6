#pragma once

#include <filesystem>
#include <optional>
#include <set>
#include <string>

#include "core/progress.h"
#include "grids/scene.h"

/// All VDB files go through here, both ways, and nowhere else.
///
/// OpenVDB's writer reports success on a full disk and leaves half files under the final name; its
/// reader hangs, crashes or eats memory on damaged ones. So a file is written to a temporary name,
/// checked, synced, read back and renamed; and its UUID is a hash of all its other bytes, with one
/// hash a grid in `sekitei:bytes`, so that damage is found, and the grid named, before anything is
/// decoded. Files of other programs have random UUIDs: their float, int32 and vec3s grids are
/// decoded by our own code with every length checked (grids/vdb_format.h), their points in a
/// process of their own first, and other types are kept as bytes. A shell's `> file.vdb` of a
/// framed pipe is a file that read_vdb() accepts.
namespace sekitei {

struct ReadOptions {
    std::set<std::string> only;      ///< names of grids to load; empty = all
    std::set<std::string> if_there;  ///< with `only`: further ones that may be absent
    bool keep_foreign = true;        ///< load grids of other types to write them back
    bool check_hashes = true;
    bool fix_nan = false;     ///< replace NaN and infinity by the background, with a warning
    double memory_limit = 0;  ///< bytes; 0 = none. Checked against the file before loading
};

/// @throws InvalidInput   truncated, damaged, not a VDB, wrong version, hash mismatch, NaN voxels,
///                        non-uniform transform; names file, grid, value, expectation and remedy
/// @throws LimitExceeded  would need more memory than allowed
/// @throws Cancelled      from `progress`, looked at for every few megabytes
Scene read_vdb(const std::filesystem::path& path, const ReadOptions& options = {},
               const Progress& progress = {});

struct WriteOptions {
    bool half = false;  ///< 16-bit floats, for export
};

/// Writes grids, points and history. Equal scenes give equal bytes: the file's UUID is a hash of
/// its content.
/// @throws IoError    the target is left as it was
/// @throws Cancelled  from `progress`, looked at for every few megabytes; the same
void write_vdb(const std::filesystem::path& path, const Scene& scene,
               const WriteOptions& options = {}, const Progress& progress = {});

/// The framed form for pipes: magic, length, VDB bytes, hash trailer. Truncation is detected.
/// A cancelled write may have sent a part, which its reader refuses.
void write_vdb_stream(int file_descriptor, const Scene& scene, const Progress& progress = {});
Scene read_vdb_stream(int file_descriptor, const ReadOptions& options = {},
                      std::string already_read = "", const Progress& progress = {});

/// What a file holds, read without loading values.
struct VdbGridInfo {
    std::string name, type, grid_class, unit, stage, hash;
    std::uint64_t active_voxels = 0, bytes_on_disk = 0;
    std::uint64_t memory = 0;  ///< bytes once loaded, as the file says; 0 if it does not
    double voxel = 0;
    Vec3d lower, upper;  ///< world bounds of active voxels
    bool points = false;
    Json metadata;
};
struct VdbFileInfo {
    std::uint64_t bytes = 0;
    std::string uuid, creator;
    Domain domain;
    std::vector<VdbGridInfo> grids;
    std::vector<HistoryEntry> history;
};
VdbFileInfo inspect_vdb(const std::filesystem::path& path, const Progress& progress = {});

/// Reads everything and compares each grid with its sekitei:hash; returns the names that differ or
/// carry no hash.
struct VerifyResult {
    std::vector<std::string> damaged, without_hash, good;
};
VerifyResult verify_vdb(const std::filesystem::path& path);

}  // namespace sekitei
