#include "apps/explain.h"

#include <fmt/format.h>

#include <charconv>
#include <optional>

#include "apps/commands/commands.h"
#include "apps/habitat.h"
#include "core/error.h"
#include "core/units.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

/// "1,0.5,20cm" as a point [m].
Vec3d point_of(const std::string& text)
{
    const std::vector<std::string> words = split_names(text);
    if (words.size() != 3) throw InvalidParameter(fmt::format("--at {}: must be x,y,z", text));
    Vec3d p;
    for (int axis = 0; axis < 3; ++axis) try {
            p[axis] = parse_quantity(words[std::size_t(axis)], "m");
        } catch (const InvalidParameter& error) {
            throw InvalidParameter(fmt::format("--at {}: {}", text, error.what()));
        }
    return p;
}

/// The face that --face names of `count`.
std::size_t face_of(const std::string& word, std::size_t count)
{
    std::size_t face = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), face);
    if (error != std::errc{} || end != word.data() + word.size() || face >= count)
        throw InvalidParameter(
            fmt::format("--face {}: must be a whole number from 0 to {}, for the mesh has {} faces",
                        word, count - 1, count));
    return face;
}

}  // namespace

int command_explain(const std::string& file, const std::string& at, const std::string& face,
                    const Common& common)
{
    if (at.empty() == face.empty())
        throw InvalidParameter("explain: which place? give --at x,y,z or --face NUMBER");
    std::optional<Vec3d> asked;
    if (face.empty()) asked = point_of(at);
    ReadOptions options;
    options.memory_limit = common.memory_limit;
    const Scene scene = read_vdb(file, options);
    const Explainer explainer(scene, file, !face.empty());
    const std::size_t place = asked ? explainer.nearest(*asked) : face_of(face, explainer.size());
    print(common.json ? explain_json(explainer, place, asked).dump(2) + "\n"
                      : explain_text(explainer, place, asked));
    return 0;
}

}  // namespace sekitei::apps
