#include <cstdio>

#include "apps/commands/commands.h"
#include "core/error.h"

namespace sekitei::apps {

void print(const std::string& text)
{
    if (std::fwrite(text.data(), 1, text.size(), stdout) != text.size() || std::fflush(stdout) != 0)
        throw IoError("cannot write to standard output");
}

const std::vector<CommandInfo>& tool_commands()
{
    static const std::vector<CommandInfo> kCommands{
        {"run", "run a recipe; only what changed is made anew"},
        {"check", "tell everything that is wrong with a recipe"},
        {"info", "say what a scene, mesh or file of points holds and how it was made"},
        {"replay", "print a recipe that makes a scene again"},
        {"diff", "compare two scenes or meshes"},
        {"explain", "say why a moss does or does not grow at one cell of a surface"},
        {"view", "write a web page that turns a scene, shows its fields and explains it"},
        {"verify", "compare files with their recorded hashes"},
        {"schema", "describe all stages for programs, or as a reference page"},
        {"specimens", "grow models of trees in several heights as meshes, for instancing"},
        {"tufts", "write the models of moss plants as meshes, for instancing"},
        {"completions", "print a completion script for bash, zsh or fish"},
    };
    return kCommands;
}

}  // namespace sekitei::apps
