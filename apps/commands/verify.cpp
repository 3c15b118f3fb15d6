#include <fmt/format.h>
#include <fmt/ranges.h>

#include "apps/commands/commands.h"
#include "apps/runner.h"
#include "core/error.h"
#include "core/log.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {

int command_verify(const std::vector<std::string>& files, const Common& common)
{
    std::vector<std::string> wrong;
    Json report = Json::array();
    for (const std::string& file : files) {
        std::vector<std::string> found;
        Json entry = {{"file", file}};
        if (std::filesystem::path(file).extension() == ".json") {
            for (const std::string& name : verify_manifest(file))
                found.push_back(fmt::format("{}: {}", file, name));
        } else if (!std::filesystem::exists(file))
            throw InvalidInput(fmt::format("{}: no such file", file));
        else if (std::filesystem::path(file).extension() != ".vdb")
            throw InvalidParameter(
                fmt::format("verify {}: takes scenes (.vdb) and manifests (.json)", file));
        else {
            try {
                const VerifyResult result = verify_vdb(file);
                for (const std::string& name : result.damaged)
                    found.push_back(
                        fmt::format("{}: grid '{}' does not have the recorded hash", file, name));
                for (const std::string& name : result.without_hash)
                    log::warning("{}: grid '{}' carries no hash and cannot be verified", file,
                                 name);
                entry["good"] = result.good;
                entry["without_hash"] = result.without_hash;
            } catch (const InvalidInput& error) {
                found.emplace_back(error.what());
            }
        }
        entry["wrong"] = found;
        report.push_back(entry);
        if (found.empty()) log::info("{}: good", file);
        wrong.insert(wrong.end(), found.begin(), found.end());
    }
    if (common.json) print(report.dump(2) + "\n");
    if (wrong.empty()) return 0;
    throw Error(ExitCode::Differ, fmt::format("{}", fmt::join(wrong, "\n")));
}

}  // namespace sekitei::apps
