#include "apps/forest_folder.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cstring>

#include "apps/forest.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/json.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

constexpr int kVersion = 1;
constexpr const char* kState = "state.json";

Json fallen_json(const std::vector<forest::Fallen>& list)
{
    Json rows = Json::array();
    for (const forest::Fallen& f : list)
        rows.push_back({f.uid, f.step, f.species, f.x, f.y, f.azimuth, f.length});
    return rows;
}

std::vector<forest::Fallen> fallen_of(const Json& rows)
{
    std::vector<forest::Fallen> list;
    for (const Json& r : rows)
        list.push_back({r.at(0).get<std::uint64_t>(), r.at(1).get<int>(), r.at(2).get<int>(),
                        r.at(3).get<double>(), r.at(4).get<double>(), r.at(5).get<double>(),
                        r.at(6).get<double>()});
    return list;
}

/// Members that two objects do not share.
std::vector<std::string> differences(const Json& a, const Json& b)
{
    std::vector<std::string> names;
    for (const auto& [name, value] : a.items())
        if (!b.contains(name) || b.at(name) != value) names.push_back(name);
    for (const auto& [name, value] : b.items())
        if (!a.contains(name)) names.push_back(name);
    return names;
}

Json state_json(const ForestState& state)
{
    Json growth = Json::array();
    for (const forest::StepStatistics& row : state.growth) growth.push_back(row_json(row));
    return {{"step", state.step}, {"growth", growth}, {"fallen", fallen_json(state.fallen)}};
}

ForestState state_of(const Json& json)
{
    ForestState state;
    json.at("step").get_to(state.step);
    for (const Json& row : json.at("growth")) state.growth.push_back(row_of(row));
    state.fallen = fallen_of(json.at("fallen"));
    return state;
}

constexpr std::string_view kMagic = "SKFORCK1";

}  // namespace

std::string encode_forest(const Json& identity, const ForestState& state,
                          const std::vector<forest::Tree>& trees)
{
    const std::string text =
        Json{{"identity", identity}, {"state", state_json(state)}, {"trees", trees.size()}}.dump();
    std::string bytes(kMagic);
    const std::uint64_t length = text.size();
    bytes.append(reinterpret_cast<const char*>(&length), sizeof length);
    bytes += text;
    bytes.append(reinterpret_cast<const char*>(trees.data()), trees.size() * sizeof(trees[0]));
    const std::uint64_t hash = hash64(bytes.data(), bytes.size());
    bytes.append(reinterpret_cast<const char*>(&hash), sizeof hash);
    return bytes;
}

std::optional<std::pair<ForestState, std::vector<forest::Tree>>> decode_forest(
    std::string_view bytes, const Json& identity, const std::string& where)
{
    auto damaged = [&] {
        return InvalidInput(where + ": a damaged checkpoint of a forest; remove it to begin anew");
    };
    std::uint64_t length = 0, hash = 0;
    const std::size_t head = kMagic.size() + sizeof length;
    if (bytes.size() < head + sizeof hash || !bytes.starts_with(kMagic)) throw damaged();
    std::memcpy(&length, bytes.data() + kMagic.size(), sizeof length);
    std::memcpy(&hash, bytes.data() + bytes.size() - sizeof hash, sizeof hash);
    if (hash != hash64(bytes.data(), bytes.size() - sizeof hash) ||
        length > bytes.size() - head - sizeof hash)
        throw damaged();
    try {
        const Json json = parse_json(bytes.substr(head, length));
        if (json.at("identity") != identity) return std::nullopt;
        std::pair<ForestState, std::vector<forest::Tree>> found{state_of(json.at("state")), {}};
        const auto count = json.at("trees").get<std::uint64_t>();
        const std::size_t room = bytes.size() - head - length - sizeof hash;
        if (room % sizeof(forest::Tree) != 0 || room / sizeof(forest::Tree) != count)
            throw damaged();
        found.second.resize(count);
        if (count > 0) std::memcpy(found.second.data(), bytes.data() + head + length, room);
        return found;
    } catch (const Json::exception&) {
        throw damaged();
    }
}

ForestFolder::ForestFolder(fs::path folder, Json identity, Progress progress)
    : folder_(std::move(folder)), identity_(std::move(identity)), progress_(std::move(progress))
{
    if (!fs::is_directory(folder_))
        throw InvalidParameter(fmt::format(
            "forest: out_of_core = {}: no such folder; make it first", folder_.string()));
    lock_.emplace(folder_,
                  fmt::format("forest: out_of_core = {}: another run works in this folder; "
                              "wait for it or give another folder",
                              folder_.string()));
    const fs::path file = folder_ / kState;
    if (!fs::exists(file)) return;
    try {
        const Json json = parse_json(read_file(file));
        if (json.at("sekitei_forest").get<int>() != kVersion)
            throw InvalidInput(fmt::format("{}: of another version", file.string()));
        if (const auto other = differences(json.at("identity"), identity_); !other.empty())
            throw InvalidParameter(fmt::format(
                "forest: out_of_core = {}: it holds a forest that was grown with other values of: "
                "{}; give those, another folder, or remove what is in it",
                folder_.string(), fmt::join(other, ", ")));
        state_ = state_of(json.at("state"));
    } catch (const Json::exception& error) {
        throw InvalidInput(fmt::format("{}: damaged ({}); remove the folder's files to begin anew",
                                       file.string(), error.what()));
    }
    remove_other_steps(state_->step);
}

fs::path ForestFolder::step_folder(int step) const
{
    return folder_ / fmt::format("step-{:04}", step);
}

/// Half a step that was interrupted, or one that is done with.
void ForestFolder::remove_other_steps(int step) const
{
    for (const auto& entry : fs::directory_iterator(folder_)) {
        const std::string name = entry.path().filename().string();
        if (name.starts_with("step-") && entry.path() != step_folder(step)) {
            std::error_code ignored;
            fs::remove_all(entry.path(), ignored);
        }
    }
}

void ForestFolder::keep(const State& state)
{
    write_file(
        folder_ / kState,
        Json{{"sekitei_forest", kVersion}, {"identity", identity_}, {"state", state_json(state)}}
                .dump() +
            "\n",
        progress_);
    state_ = state;
    remove_other_steps(state.step);
}

std::string ForestFolder::load(int step, int row)
{
    return read_file(step_folder(step) / fmt::format("row-{:04}.trees", row), 1ull << 40,
                     progress_);
}

void ForestFolder::save(int step, int row, const std::string& bytes)
{
    std::error_code error;
    fs::create_directory(step_folder(step), error);
    if (error)
        throw IoError(fmt::format("cannot make the folder {}: {}", step_folder(step).string(),
                                  error.message()));
    write_file(step_folder(step) / fmt::format("row-{:04}.trees", row), bytes, progress_);
}

}  // namespace sekitei::apps
