#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "apps/folder_lock.h"
#include "core/params.h"
#include "core/progress.h"
#include "solvers/forest/forest.h"

namespace sekitei::apps {

/// How far a forest has grown.
struct ForestState {
    int step = 0;
    std::vector<forest::StepStatistics> growth;
    std::vector<forest::Fallen> fallen;
};

/// All of a forest in memory, to go on from after an interruption.
/// @param identity  what the forest is grown with: a JSON object of values and hashes
std::string encode_forest(const Json& identity, const ForestState& state,
                          const std::vector<forest::Tree>& trees);
/// @param where  the file, for messages
/// @return nothing where it belongs to another identity
/// @throws InvalidInput  damaged
std::optional<std::pair<ForestState, std::vector<forest::Tree>>> decode_forest(
    std::string_view bytes, const Json& identity, const std::string& where);

/// A folder that holds a forest too large for memory, after its last complete step.
///
///     state.json              what it was grown with, its growth so far, the step
///     step-0031/row-0007.trees
///
/// Rows of the next step are written into a folder of their own. state.json, written when all of
/// them are there, names the step that counts; only then the older one goes. Killed at any time,
/// the folder holds the last complete step.
class ForestFolder : public forest::RowStore {
public:
    using State = ForestState;

    /// @param identity  what the forest is grown with: a JSON object of values and hashes
    /// @throws InvalidParameter  there is no such folder, or it holds another forest: names what
    ///                           differs
    /// @throws InvalidInput      state.json is damaged
    /// @throws IoError           another run works in it, or it cannot be written
    ForestFolder(std::filesystem::path folder, Json identity, Progress progress);

    /// What it holds; empty for a new folder.
    const std::optional<State>& state() const { return state_; }
    /// All rows of a step are there: from now on this step counts.
    /// @throws IoError
    void keep(const State& state);

    std::string load(int step, int row) override;
    void save(int step, int row, const std::string& bytes) override;
    void complete(int) override {}

private:
    std::filesystem::path step_folder(int step) const;
    void remove_other_steps(int step) const;

    std::optional<FolderLock> lock_;
    std::filesystem::path folder_;
    Json identity_;
    Progress progress_;
    std::optional<State> state_;
};

}  // namespace sekitei::apps
