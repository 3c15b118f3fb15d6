#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "apps/commands/commands.h"
#include "core/error.h"

namespace sekitei::apps {
namespace {

using Option = CommandPage::Option;

std::vector<std::string> names_of(const CommandPages& pages)
{
    std::vector<std::string> names;
    for (const CommandPage& page : pages) names.push_back(page.name);
    return names;
}

/// All spellings of an option.
std::vector<std::string> words_of(const Option& option)
{
    std::vector<std::string> words;
    for (const std::string& word : {option.name, option.shortcut, option.negative})
        if (!word.empty()) words.push_back(word);
    return words;
}

/// For a word between apostrophes, in any of the shells.
std::string quoted(std::string text)
{
    for (std::size_t at = 0; (at = text.find('\'', at)) != std::string::npos; at += 4)
        text.replace(at, 1, "'\\''");
    return text;
}

/// What bash offers where `option` wants a word; empty: nothing is known.
std::string bash_action(const Option& option)
{
    if (!option.choices.empty())
        return fmt::format("COMPREPLY=($(compgen -W '{}' -- \"$word\"))",
                           fmt::join(option.choices, " "));
    if (option.folder) return "COMPREPLY=($(compgen -d -- \"$word\"))";
    if (option.file) return "COMPREPLY=($(compgen -f -- \"$word\"))";
    return "COMPREPLY=()";
}

std::string bash_script(const CommandPages& pages)
{
    std::string text = fmt::format(
        "# bash completion for sekitei\n_sekitei() {{\n"
        "    local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}}\n"
        "    # bash splits --option=word at the equals sign\n"
        "    [ \"$word\" = = ] && word=\n"
        "    [ \"$before\" = = ] && before=${{COMP_WORDS[COMP_CWORD-2]}}\n"
        "    if [ \"$COMP_CWORD\" = 1 ]; then\n"
        "        COMPREPLY=($(compgen -W '{} --help --version' -- \"$word\"))\n"
        "        return\n    fi\n    case ${{COMP_WORDS[1]}}:$before in\n",
        fmt::join(names_of(pages), " "));
    for (const CommandPage& page : pages)
        for (const Option& option : page.options) {
            if (option.plain || option.value.empty()) continue;
            std::vector<std::string> patterns;
            for (const std::string& word : words_of(option))
                patterns.push_back(page.name + ":" + word);
            text += fmt::format("    {}) {}; return ;;\n", fmt::join(patterns, "|"),
                                bash_action(option));
        }
    text += "    esac\n    case ${COMP_WORDS[1]} in\n";
    for (const CommandPage& page : pages) {
        std::vector<std::string> words;
        std::string plain = "COMPREPLY=()";
        for (const Option& option : page.options) {
            if (option.plain)
                plain = bash_action(option);
            else
                for (const std::string& word : words_of(option)) words.push_back(word);
        }
        text += fmt::format(
            "    {}) if [[ $word == -* ]]; then COMPREPLY=($(compgen -W '{}' -- \"$word\")); else "
            "{}; fi ;;\n",
            page.name, fmt::join(words, " "), plain);
    }
    return text + "    esac\n}\ncomplete -o filenames -F _sekitei sekitei\n";
}

/// For the text in brackets of an _arguments specification.
std::string zsh_text(const std::string& text)
{
    std::string out;
    for (const char c : text) {
        if (c == '[' || c == ']' || c == ':' || c == '\\') out += '\\';
        out += c;
    }
    return quoted(out);
}

std::string zsh_action(const Option& option)
{
    if (!option.choices.empty()) return fmt::format("({})", fmt::join(option.choices, " "));
    return option.folder ? "_files -/" : option.file ? "_files" : " ";
}

std::string zsh_script(const CommandPages& pages)
{
    std::string text =
        "#compdef sekitei\n_sekitei() {\n    local context state state_descr line\n    typeset -A "
        "opt_args\n"
        "    _arguments -C '--help[print help]' '--version[print the version]' "
        "'1:command:->command' '*::argument:->argument'\n"
        "    case $state in\n    command)\n        local -a commands\n        commands=(\n";
    for (const CommandPage& page : pages)
        text += fmt::format("            '{}:{}'\n", page.name, zsh_text(page.summary));
    text +=
        "        )\n        _describe command commands ;;\n    argument)\n        case $words[1] "
        "in\n";
    for (const CommandPage& page : pages) {
        text += fmt::format("        {})\n            _arguments \\\n", page.name);
        for (const Option& option : page.options) {
            const std::string help = zsh_text(option.help);
            const std::string action =
                option.value.empty()
                    ? ""
                    : fmt::format(":{}:{}", zsh_text(option.value), zsh_action(option));
            if (option.plain)
                text += fmt::format("                '{}:{}:{}' \\\n", option.repeats ? "*" : "",
                                    option.name, zsh_action(option));
            else
                for (const std::string& word : words_of(option))
                    text += fmt::format("                '{}{}[{}]{}' \\\n",
                                        option.repeats ? "*" : "", word, help, action);
        }
        text += "                && return 0 ;;\n";
    }
    return text +
           "        esac ;;\n    esac\n}\n"
           "# As a file on fpath it is called, by source it is told of\n"
           "if [ \"$funcstack[1]\" = _sekitei ]; then _sekitei \"$@\"; else compdef _sekitei "
           "sekitei; fi\n";
}

std::string fish_script(const CommandPages& pages)
{
    std::string text = "# fish completion for sekitei\n";
    const std::string commands = fmt::format("{}", fmt::join(names_of(pages), " "));
    const std::string none = fmt::format("-n 'not __fish_seen_subcommand_from {}'", commands);
    text += fmt::format("complete -c sekitei {} -f -l help -d 'print help'\n", none);
    text += fmt::format("complete -c sekitei {} -f -l version -d 'print the version'\n", none);
    for (const CommandPage& page : pages)
        text += fmt::format("complete -c sekitei {} -f -a {} -d '{}'\n", none, page.name,
                            quoted(page.summary));
    for (const CommandPage& page : pages) {
        const std::string here = fmt::format("-n '__fish_seen_subcommand_from {}'", page.name);
        for (const Option& option : page.options) {
            if (option.plain) {
                if (!option.choices.empty())
                    text += fmt::format("complete -c sekitei {} -f -a '{}'\n", here,
                                        fmt::join(option.choices, " "));
                continue;
            }
            std::string what;
            if (!option.choices.empty())
                what = fmt::format(" -x -a '{}'", fmt::join(option.choices, " "));
            else if (option.folder)
                what = " -x -a '(__fish_complete_directories)'";
            else if (option.file)
                what = " -r -F";
            else if (!option.value.empty())
                what = " -x";
            text += fmt::format("complete -c sekitei {} -l {}{}{} -d '{}'\n", here,
                                option.name.substr(2),
                                option.shortcut.empty() ? "" : " -s " + option.shortcut.substr(1),
                                what, quoted(option.help));
            if (!option.negative.empty())
                text += fmt::format("complete -c sekitei {} -l {} -d '{}'\n", here,
                                    option.negative.substr(2), quoted("not: " + option.help));
        }
    }
    return text;
}

}  // namespace

int command_completions(const std::string& shell, const CommandPages& pages)
{
    if (shell == "bash")
        print(bash_script(pages));
    else if (shell == "zsh")
        print(zsh_script(pages));
    else if (shell == "fish")
        print(fish_script(pages));
    else
        throw InvalidParameter(
            fmt::format("completions: '{}' is not known, expected bash, zsh or fish", shell));
    return 0;
}

}  // namespace sekitei::apps
