#include <fmt/format.h>
#include <fmt/ranges.h>

#include "apps/commands/commands.h"
#include "apps/stage.h"
#include "core/error.h"

namespace sekitei::apps {
namespace {

const std::vector<std::string> kCommonOptions{"--output", "--force",   "--seed",    "--threads",
                                              "--memory", "--quiet",   "--verbose", "--json",
                                              "--params", "--fix-nan", "--help"};

std::vector<std::string> all_commands()
{
    std::vector<std::string> names;
    for (const StageInfo& info : stage_infos()) names.push_back(info.name);
    for (const CommandInfo& info : tool_commands()) names.push_back(info.name);
    return names;
}

std::vector<std::string> options_of(const std::string& stage_name)
{
    std::vector<std::string> options = kCommonOptions;
    const auto stage = make_stage(stage_name);
    for (const Param& p : stage->params()) options.push_back("--" + option_name(p.name));
    return options;
}

/// bash, and zsh through its bashcompinit: words after an option that takes names are those names.
std::string bash_script()
{
    std::string text = fmt::format(
        "_sekitei() {{\n    local word=${{COMP_WORDS[COMP_CWORD]}} "
        "before=${{COMP_WORDS[COMP_CWORD-1]}}\n"
        "    if [ \"$COMP_CWORD\" = 1 ]; then\n        COMPREPLY=($(compgen -W \"{}\" -- "
        "\"$word\"))\n        return\n    fi\n"
        "    case ${{COMP_WORDS[1]}}:$before in\n",
        fmt::join(all_commands(), " "));
    for (const StageInfo& info : stage_infos()) {
        const auto stage = make_stage(info.name);
        for (const Param& p : stage->params())
            if (!p.choices.empty())
                text += fmt::format(
                    "    {}:--{}) COMPREPLY=($(compgen -W \"{}\" -- \"$word\")); return ;;\n",
                    info.name, option_name(p.name), fmt::join(p.choices, " "));
    }
    text += "    esac\n    case ${COMP_WORDS[1]} in\n";
    for (const StageInfo& info : stage_infos())
        text += fmt::format(
            "    {}) [[ $word == -* ]] && COMPREPLY=($(compgen -W \"{}\" -- \"$word\")) && return "
            ";;\n",
            info.name, fmt::join(options_of(info.name), " "));
    text += fmt::format(
        "    *) [[ $word == -* ]] && COMPREPLY=($(compgen -W \"{}\" -- \"$word\")) && return ;;\n  "
        "  esac\n"
        "    COMPREPLY=($(compgen -f -- \"$word\"))\n}}\ncomplete -o filenames -F _sekitei "
        "sekitei\n",
        "--set --only --dry-run --at --full --markdown --tolerance --moss-lod " +
            fmt::format("{}", fmt::join(kCommonOptions, " ")));
    return text;
}

/// For a word between apostrophes.
std::string quoted(std::string text)
{
    for (std::size_t at = 0; (at = text.find('\'', at)) != std::string::npos; at += 2)
        text.insert(at, "\\");
    return text;
}

std::string fish_script()
{
    std::string text;
    const std::string commands = fmt::format("{}", fmt::join(all_commands(), " "));
    for (const StageInfo& info : stage_infos())
        text += fmt::format(
            "complete -c sekitei -n 'not __fish_seen_subcommand_from {}' -a {} -d '{}'\n", commands,
            info.name, quoted(info.summary));
    for (const CommandInfo& info : tool_commands())
        text += fmt::format(
            "complete -c sekitei -n 'not __fish_seen_subcommand_from {}' -a {} -d '{}'\n", commands,
            info.name, quoted(info.summary));
    for (const StageInfo& info : stage_infos()) {
        const auto stage = make_stage(info.name);
        for (const Param& p : stage->params()) {
            text += fmt::format(
                "complete -c sekitei -n '__fish_seen_subcommand_from {}' -l {} -d '{}'{}\n",
                info.name, option_name(p.name), quoted(p.help),
                p.choices.empty() ? "" : fmt::format(" -xa '{}'", fmt::join(p.choices, " ")));
        }
    }
    return text;
}

}  // namespace

int command_completions(const std::string& shell)
{
    if (shell == "bash")
        print(bash_script());
    else if (shell == "zsh")
        print("autoload -U +X bashcompinit && bashcompinit\n" + bash_script());
    else if (shell == "fish")
        print(fish_script());
    else
        throw InvalidParameter(
            fmt::format("completions: '{}' is not known, expected bash, zsh or fish", shell));
    return 0;
}

}  // namespace sekitei::apps
