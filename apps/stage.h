#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/image.h"
#include "core/mesh_io.h"
#include "core/params.h"
#include "core/progress.h"
#include "grids/scene.h"

/// A process as users meet it: one command and one kind of recipe table.
namespace sekitei::apps {

enum class OutputKind { Scene, Mesh, Picture, Table, Points };

struct StageInfo {
    std::string name;     ///< the command: "joint"
    std::string version;  ///< changes when results change; part of every cache key
    std::string summary;
    OutputKind output = OutputKind::Scene;
    bool reads_scene = true;         ///< false: makes a scene from nothing
    std::vector<std::string> needs;  ///< grids, points or meshes it cannot do without
    std::vector<std::string> makes;  ///< grids, points or meshes it may put
    bool reads_many = false;         ///< run_many() on one scene for each that it reads
    /// Whose parameters it looks up in the scene's history: "soil" for all of a stage's,
    /// "lava.preset" for one.
    std::vector<std::string> recalls{};
    bool reads_mesh = false;  ///< works on the triangles of a mesh `rock` too, and passes them on
    bool reads_if_given = false;  ///< reads a scene where one is named, else makes one
};

/// What a stage would need, found before anything is allocated.
struct Need {
    double voxels = 0;  ///< active voxels worked on
    double memory = 0;  ///< bytes at the peak
    double disk = 0;    ///< bytes of its result
};

/// What is known of a scene without loading it.
struct SceneOutline {
    Domain domain, heat_domain;
    double lava_voxels = 0;
    double surface_cells = 0;  ///< of a surface with a climate
};

struct StageContext {
    std::uint64_t seed = 0;
    Progress progress;
    double memory_limit = 0;  ///< bytes, 0 = none
    bool fix_nan = false;
    std::filesystem::path folder;      ///< relative paths in parameters start here
    std::filesystem::path checkpoint;  ///< file for a long stage's own state; empty = none
    /// Takes one scene of a sequence and its number; empty where nobody asks for a sequence.
    std::function<void(int number, const Scene& scene)> frame;
};

class Stage {
public:
    virtual ~Stage() = default;
    virtual const StageInfo& info() const = 0;
    /// Told before anything else where what it reads brings a mesh `rock`.
    virtual void meets_mesh(bool /*there*/) {}
    /// Told before anything else whether what it reads brings trees and no rock.
    virtual void meets_trees(bool /*alone*/) {}
    /// The same of a forest.
    virtual void meets_forest(bool /*alone*/) {}
    /// Whether it reads a scene with its present parameters.
    virtual bool reads_scene() { return info().reads_scene; }
    /// What it reads of a scene with its present parameters.
    virtual std::vector<std::string> needs() { return info().needs; }
    /// What it reads besides where it is there.
    virtual std::vector<std::string> uses() { return {}; }
    /// What it may put with its present parameters.
    virtual std::vector<std::string> makes() { return info().makes; }
    /// Files it reads besides those that path parameters name, as written.
    virtual std::vector<std::filesystem::path> files() { return {}; }
    /// Files that it writes itself besides its result, as written; not in recipes.
    virtual std::vector<std::filesystem::path> side_files() { return {}; }
    /// Folders where it keeps what is too large for memory; not in recipes.
    virtual std::vector<std::filesystem::path> side_folders() { return {}; }
    /// Every how many steps it hands a scene to StageContext::frame; 0: never.
    virtual int frame_interval();
    /// Bound to this object; set values through it.
    virtual ParamList params() = 0;
    /// @throws InvalidParameter
    virtual void validate() = 0;
    /// Judges what depends on what it reads, once it was told of that; after validate().
    /// @throws InvalidParameter
    virtual void check_reading() {}
    /// Reads the small files that parameters name, so that their mistakes are told before anything
    /// is computed.
    /// @throws InvalidInput, InvalidParameter
    virtual void check_files(const StageContext&) {}
    /// May refine `outline` (a body of lava sets the domain). Reads headers of input files at most.
    virtual Need estimate(SceneOutline& outline, const StageContext& context) = 0;
    /// Adds or replaces what it makes in `scene`; returns numbers worth a summary.
    virtual Json run(Scene& scene, const StageContext& context) = 0;
    /// In place of run() where StageInfo::reads_many; scenes with the names of what made them.
    virtual Json run_many(const std::vector<std::pair<std::string, Scene>>& scenes,
                          const StageContext& context);
    /// Scene stages that read many leave theirs here.
    Scene new_scene;
    /// Picture stages leave their result here.
    Image8 picture;
    /// Table stages leave theirs here, as lines of comma-separated values; Points as PLY.
    std::string table;
    /// Why it stopped before its end, where a limit made it; its result is kept, and then the
    /// command ends with ExitCode::Limit.
    std::string stopped;

    /// Absolute form of a path parameter.
    static std::filesystem::path resolve(const StageContext& context,
                                         const std::filesystem::path& path)
    {
        return path.empty() || path.is_absolute() ? path : context.folder / path;
    }
};

/// All processes, in the order a cliff is made.
const std::vector<StageInfo>& stage_infos();
/// @throws InvalidParameter  unknown name, with the nearest one
std::unique_ptr<Stage> make_stage(const std::string& name);
const StageInfo& stage_info(const std::string& name);

/// Hashes of all files that path parameters of `stage` name, by the path as written.
/// @throws InvalidInput  a file is missing
Json input_hashes(Stage& stage, const StageContext& context);

/// History entry for what `stage` is about to do.
HistoryEntry history_of(Stage& stage, const StageContext& context);

/// The parameters a stage had when it last worked on this scene; null when it never did.
const Json* params_of(const Scene& scene, const std::string& stage);

/// Tells what reading a mesh file had to mend.
void log_mesh_report(const std::filesystem::path& file, const MeshReadReport& report);

/// Tells of the pictures that a mesh's materials name, since only `moss --texture` looks at one.
void tell_of_textures(const std::filesystem::path& file, const MeshReadReport& report);

/// "; run `sekitei light` first" for a grid, points or mesh that only other stages make; empty
/// where none does.
std::string maker_hint(const std::string& item);

/// @throws InvalidInput  what `stage` cannot do without and `scene` has not, what it has, and which
///                       stage makes that
void require_needs(Stage& stage, const Scene& scene);

/// Whether a mesh is part of what it makes: one that goes beside its scene file.
bool makes_mesh(Stage& stage);

/// What a file is to blame for begins with its name; the name is not repeated.
InvalidInput named_after(const std::string& file, const InvalidInput& error);

/// Whether a message is about one of the files that `stage` reads besides its scene.
bool blames_own_file(Stage& stage, const StageContext& context, std::string_view message);

/// Tells people a table of comma-separated values, its columns aligned.
void show_table(const std::string& csv);

/// The file of one scene of a sequence: "moss.vdb" and 30 give "moss.0030.vdb".
std::filesystem::path frame_path(const std::filesystem::path& file, int number);

/// Warns of each of these parameters whose value is not the default although nothing reads it now.
/// @param why  "with cut = none"
void warn_unused(Stage& stage, const std::vector<std::string>& names, const std::string& why);

/// @throws LimitExceeded  naming what is needed, the limit and the option to raise it
void check_memory(const std::string& who, double bytes, double limit,
                  std::string_view instead = "make the voxels larger");

}  // namespace sekitei::apps
