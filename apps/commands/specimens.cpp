#include "apps/specimens.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <vector>

#include "apps/commands/commands.h"
#include "apps/console.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/mesh_io.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

struct File {
    std::string name, bytes;
};

/// All models of one kind and their index.
std::vector<File> specimens(const tree::Species& kind, const SpecimenWords& words,
                            std::uint64_t seed, const Progress& progress)
{
    std::vector<File> files;
    Json models = Json::array();
    const std::vector<Specimen> grown = grow_specimens(
        {kind}, {.variants = words.variants, .generations = words.generations, .seed = seed},
        kFileDetails, {}, progress);
    for (std::size_t m = 0; m < grown.size(); ++m) {
        const Specimen& s = grown[m];
        if (s.tips == 0) {
            if (m % words.generations.size() == 0 || grown[m - 1].tips > 0)
                log::warning("specimens: {} {} died out before generation {}", s.kind, s.variant,
                             s.generations);
            continue;
        }
        Json model{{"variant", s.variant},
                   {"generations", s.generations},
                   {"height_m", s.height_m},
                   {"crown_radius", s.crown_radius},
                   {"crown_base", s.crown_base},
                   {"leaf_area_m2", s.leaf_area},
                   {"trunk_diameter_m", s.trunk_diameter},
                   {"tips", s.tips}};
        for (std::size_t l = 0; l < kFileDetails.size(); ++l) {
            const std::string level(kFileDetails[l].name);
            const std::string name =
                fmt::format("{}_{}_{}_{}.ply", s.kind, s.variant, s.generations, level);
            model["files"][level] = name;
            model["triangles"][level] = s.mesh[l].triangles.size();
            files.push_back({name, encode_mesh(s.mesh[l], ".ply", progress)});
        }
        models.push_back(std::move(model));
    }
    const Json index{{"species", kind.name}, {"seed", seed}, {"models", std::move(models)}};
    files.push_back({kind.name + ".json", index.dump(2) + "\n"});
    return files;
}

}  // namespace

int command_specimens(const SpecimenWords& words, const Common& common)
{
    if (common.output.size() != 1 || !fs::is_directory(common.output.front()))
        throw InvalidParameter("specimens: say with -o FOLDER into which existing folder");
    if (words.generations.empty() || words.generations.front() < 1 ||
        !std::ranges::is_sorted(words.generations) ||
        std::ranges::adjacent_find(words.generations) != words.generations.end())
        throw InvalidParameter(
            "specimens: --generations: must be ages from 1 on, each larger than the one before");
    std::vector<tree::Species> kinds;
    for (const std::string& name : words.species) {
        kinds.push_back(specimen_kind(name));
        const std::string& called = kinds.back().name;
        if (called.empty() || called.find_first_of("/\\") != std::string::npos)
            throw InvalidParameter(fmt::format(
                "specimens: {}: its name '{}' must be one that files can have", name, called));
        for (std::size_t k = 0; k + 1 < kinds.size(); ++k)
            if (kinds[k].name == kinds.back().name)
                throw InvalidParameter(fmt::format("specimens: --species {} is given twice", name));
    }
    const fs::path folder = common.output.front();
    auto keep = [&](const std::string& name) {
        if (!common.force && fs::exists(folder / name))
            throw InvalidParameter(
                fmt::format("{} exists; replace it with --force", (folder / name).string()));
    };
    for (const tree::Species& kind : kinds) keep(kind.name + ".json");
    const Progress progress = console_progress("specimens");
    std::vector<File> files;
    for (const tree::Species& kind : kinds)
        for (File& file : specimens(kind, words, common.seed, progress)) {
            keep(file.name);
            files.push_back(std::move(file));
        }
    Json names = Json::array();
    for (const File& file : files) {
        write_file(folder / file.name, file.bytes, progress);
        names.push_back((folder / file.name).string());
    }
    if (common.json) print(Json{{"files", names}}.dump(2) + "\n");
    log::info("wrote {} files into {}", files.size(), folder.string());
    return 0;
}

}  // namespace sekitei::apps
