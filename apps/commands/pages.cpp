#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <map>

#include "apps/commands/commands.h"
#include "apps/scene_items.h"
#include "apps/stage.h"

namespace sekitei::apps {
namespace {

constexpr const char* kScenePage = "sekitei-scene.7";

std::string capital(std::string text)
{
    if (!text.empty())
        text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
    return text;
}

/// Which stages make an item and which read it, each by its command.
struct Users {
    std::vector<std::string> makers, readers;
};

std::map<std::string, Users> users_of_items()
{
    std::map<std::string, Users> users;
    auto add = [](std::vector<std::string>& list, const std::string& name) {
        if (std::find(list.begin(), list.end(), name) == list.end()) list.push_back(name);
    };
    for (const StageInfo& info : stage_infos()) {
        const StageItems items = items_of_stage(info.name);
        auto each = [&](const std::vector<std::string>& names, auto member) {
            for (const std::string& name : names)
                if (const SceneItem* item = find_scene_item(name))
                    add(users[item->name].*member, info.name);
        };
        each(items.makes, &Users::makers);
        each(items.needs, &Users::readers);
        each(items.uses, &Users::readers);
    }
    return users;
}

const char* class_text(GridClass grid_class)
{
    return grid_class == GridClass::LevelSet    ? "level set"
           : grid_class == GridClass::FogVolume ? "fog volume"
                                                : "";
}

// ---- Markdown
// -------------------------------------------------------------------------------------

/// For a cell of a table.
std::string cell(std::string text)
{
    for (std::size_t at = 0; (at = text.find('|', at)) != std::string::npos; at += 2)
        text.insert(at, "\\");
    for (std::size_t at = 0; (at = text.find('<', at)) != std::string::npos; at += 4)
        text.replace(at, 1, "&lt;");
    return text;
}

std::string code_list(const std::vector<std::string>& names)
{
    return fmt::format("`{}`", fmt::join(names, "`, `"));
}

std::string option_row(const CommandPage::Option& option)
{
    std::string name = option.plain ? option.name : "";
    for (const std::string& word : {option.shortcut, option.name, option.negative})
        if (!option.plain && !word.empty()) name += (name.empty() ? "" : ", ") + word;
    if (!option.value.empty() && !option.plain) name += " " + option.value;
    std::string help = option.help;
    if (option.required) help += "; must be given";
    return fmt::format("| `{}` | {} |\n", name, cell(help));
}

std::string markdown_stage(const CommandPage& page)
{
    const StageItems items = items_of_stage(page.name);
    const StageInfo& info = stage_info(page.name);
    std::string text;
    auto line = [&](const char* word, const std::vector<std::string>& names) {
        if (!names.empty())
            text += fmt::format("{}{} {}.", text.empty() ? "" : " ", word, code_list(names));
    };
    // As the table of the scene names them.
    auto known = [](const std::vector<std::string>& names) {
        std::vector<std::string> list;
        for (const std::string& name : names) {
            const SceneItem* item = find_scene_item(name);
            const std::string& word = item ? item->name : name;
            if (std::find(list.begin(), list.end(), word) == list.end()) list.push_back(word);
        }
        return list;
    };
    // What a stage can do without, and what it makes of a mesh or with switches, comes second.
    auto without = [](std::vector<std::string> names, const std::vector<std::string>& told) {
        std::erase_if(names, [&](const std::string& name) {
            return std::find(told.begin(), told.end(), name) != told.end();
        });
        return names;
    };
    const std::vector<std::string> needs = known(info.needs), makes = known(info.makes);
    line("Needs", needs);
    line("Needs as what it reads and its parameters demand", without(items.needs, needs));
    line("Reads where they are there", without(without(items.uses, needs), items.needs));
    line("Makes", makes);
    line("May make", without(items.makes, makes));
    if (!text.empty()) text += "\n\n";
    const auto stage = make_stage(page.name);
    if (const ParamList params = stage->params(); !params.empty()) {
        text += "| parameter | default | values | meaning |\n|---|---|---|---|\n";
        for (const Param& p : params)
            text += fmt::format("| `{}` | {} | {} | {} |\n", p.name, cell(p.value_text()),
                                cell(p.type_text()), cell(p.help));
        text += "\n";
    }
    return text;
}

std::string markdown_tool(const CommandPage& page)
{
    std::string rows;
    for (const CommandPage::Option& option : page.options)
        if (option.plain || !option.common) rows += option_row(option);
    std::vector<std::string> common;
    for (const CommandPage::Option& option : page.options)
        if (!option.plain && option.common) common.push_back(option.name);
    std::string text = rows.empty() ? "" : "| option | meaning |\n|---|---|\n" + rows + "\n";
    return text + fmt::format("And {}.\n\n", code_list(common));
}

/// Rows of the options that many commands share, each as the first command says it.
std::string markdown_common(const CommandPages& pages)
{
    std::vector<std::string> met;
    std::string text = "| option | meaning |\n|---|---|\n";
    for (const CommandPage& page : pages)
        for (const CommandPage::Option& option : page.options) {
            if (!page.stage || !option.common || option.plain) continue;
            if (std::find(met.begin(), met.end(), option.name) != met.end()) continue;
            met.push_back(option.name);
            text += option_row(option);
        }
    return text + "\n";
}

std::string markdown_scene()
{
    std::string text =
        "## Scene\n\nWhat a scene (a `.vdb` file with a mesh beside it) may hold. World space is "
        "right-handed, z up, in metres, north +y;\ntypes are those of OpenVDB. `<...>` stands for "
        "a name or number. Grids of other programs pass through every command.\n\n";
    const std::map<std::string, Users> users = users_of_items();
    auto who = [&](const SceneItem& item) {
        const auto found = users.find(item.name);
        const Users none, &of = found == users.end() ? none : found->second;
        return fmt::format("{} | {}", fmt::join(of.makers, ", "), fmt::join(of.readers, ", "));
    };
    text +=
        "### Grids\n\n| grid | type | unit | class | meaning | made by | read by "
        "|\n|---|---|---|---|---|---|---|\n";
    for (const SceneItem& item : scene_items())
        if (item.kind == SceneItem::Kind::Grid)
            text +=
                fmt::format("| `{}` | {} | {} | {} | {} | {} |\n", item.name, item.type, item.unit,
                            class_text(item.grid_class), cell(item.meaning), who(item));
    text +=
        "\n### Points and meshes\n\n| name | meaning | made by | read by |\n|---|---|---|---|\n";
    for (const SceneItem& item : scene_items())
        if (item.kind != SceneItem::Kind::Grid)
            text += fmt::format("| `{}`{} | {} | {} |\n", item.name,
                                item.kind == SceneItem::Kind::Mesh ? " (mesh)" : "",
                                cell(item.meaning), who(item));
    for (const SceneItem& item : scene_items()) {
        if (item.kind == SceneItem::Kind::Grid) continue;
        text += fmt::format("\n#### {} of `{}`\n\n",
                            item.kind == SceneItem::Kind::Mesh ? "Face attributes" : "Attributes",
                            item.name);
        if (item.name == "rock" || item.name == "sites")
            text += "Every field of the surface, as the grid of its name, and:\n\n";
        text += "| attribute | type | unit | meaning |\n|---|---|---|---|\n";
        for (const SceneItem::Attribute& a : item.attributes)
            text +=
                fmt::format("| `{}` | {} | {} | {} |\n", a.name, a.type, a.unit, cell(a.meaning));
    }
    return text;
}

std::string markdown_command(const CommandPage& page)
{
    return fmt::format("## {}\n\n{}.\n\n", page.name, capital(page.summary)) +
           (page.stage ? markdown_stage(page) : markdown_tool(page));
}

// ---- man(1)
// ---------------------------------------------------------------------------------------

/// Text of a man page: nothing in it is a request, hyphens of options are minus signs.
std::string roff(const std::string& text)
{
    std::string out;
    for (const char c : text) {
        if (c == '\\')
            out += "\\e";
        else if (c == '-')
            out += "\\-";
        else if (c == '\'')
            out += "\\(aq";
        else if (c == '`')
            out += "\\(ga";
        else if (c == '^')
            out += "\\(ha";
        else if (c == '~')
            out += "\\(ti";
        else if (c == '.' && out.empty())
            out += "\\&.";
        else
            out += c;
    }
    return out;
}

std::string bold(const std::string& text)
{
    return "\\fB" + roff(text) + "\\fR";
}

std::string italic(const std::string& text)
{
    return "\\fI" + roff(text) + "\\fR";
}

std::string man_head(const std::string& name, int section, const std::string& summary)
{
    std::string title = name;
    for (char& c : title) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    return fmt::format(".TH {} {} \"\" \"Sekitei {}\" \"Sekitei\"\n.SH NAME\n{} \\- {}\n",
                       roff(title), section, SEKITEI_VERSION, roff(name), roff(summary));
}

std::string man_option(const CommandPage::Option& option)
{
    std::string head;
    for (const std::string& word : {option.shortcut, option.name, option.negative})
        if (!word.empty()) head += (head.empty() ? "" : ", ") + bold(word);
    if (option.plain)
        head = italic(option.name);
    else if (!option.value.empty())
        head += " " + italic(option.value);
    return fmt::format(".TP\n{}\n{}\n", head, roff(option.help));
}

std::string man_items(const char* word, const std::vector<std::string>& names)
{
    std::vector<std::string> bolds;
    for (const std::string& name : names) bolds.push_back(bold(name));
    return names.empty() ? "" : fmt::format(".TP\n{}\n{}\n", word, fmt::join(bolds, ", "));
}

std::string man_exit_status()
{
    return ".SH EXIT STATUS\n"
           "0 done; 1 a bug in Sekitei; 2 bad command line or recipe; 3 bad input file; 4 cannot "
           "write; 5 a limit of memory, time or voxels; 6 files differ; 130 and 143 interrupted, "
           "can be resumed.\n";
}

std::string man_command(const CommandPage& page)
{
    std::string text = man_head("sekitei-" + page.name, 1, page.summary);
    text += fmt::format(".SH SYNOPSIS\n{} {}", bold("sekitei"), bold(page.name));
    std::string plain, own, common;
    for (const CommandPage::Option& option : page.options) {
        if (option.plain) {
            text += fmt::format(" {}{}{}{}", option.required ? "" : "[", italic(option.name),
                                option.repeats ? " ..." : "", option.required ? "" : "]");
            plain += man_option(option);
        } else
            (option.common ? common : own) += man_option(option);
    }
    text += fmt::format(" [{}]\n.SH DESCRIPTION\n{}.\n", italic("options"),
                        roff(capital(page.summary)));
    if (page.stage) {
        const StageItems items = items_of_stage(page.name);
        text += man_items("Needs", items.needs) +
                man_items("Reads where they are there", items.uses) +
                man_items("Makes", items.makes);
    }
    text += plain;
    if (!own.empty())
        text += (page.stage ? ".SH PARAMETERS\nRecipes write them with underscores.\n"
                            : ".SH OPTIONS\n") +
                own;
    if (!common.empty()) text += ".SH GENERAL OPTIONS\n" + common;
    return text + man_exit_status() + ".SH SEE ALSO\n" + bold("sekitei") + "(1), " +
           bold("sekitei-scene") + "(7)\n";
}

std::string man_program(const CommandPages& pages)
{
    std::string text = man_head("sekitei", 1, "grow natural scenery from its causes");
    text += fmt::format(
        ".SH SYNOPSIS\n{0} {1} [{2} ...] [{3}]\n.SH DESCRIPTION\n"
        "Lava cools, rock splits into columns, weather breaks them; sun, wind and water give every "
        "surface its climate, and moss settles where that suits it; trees reach for light, and "
        "forests sort themselves into layers.\n.PP\n"
        "Every command reads a scene, adds what it makes and writes a scene; {4} is standard input "
        "or output. Numbers take units: 2cm, 20C, 3m/s, 30d, 45deg. A recipe chains stages: {5}.\n",
        bold("sekitei"), italic("command"), italic("file"), italic("options"), bold("-"),
        bold("sekitei run recipe.toml"));
    for (const bool stages : {true, false}) {
        text += stages ? ".SH PROCESSES\n" : ".SH TOOLS\n";
        for (const CommandPage& page : pages)
            if (page.stage == stages)
                text += fmt::format(".TP\n{}(1)\n{}\n", bold("sekitei-" + page.name),
                                    roff(page.summary));
    }
    return text + man_exit_status() +
           fmt::format(".SH ENVIRONMENT\n.TP\n{}\nno colours in messages\n.SH SEE ALSO\n{}(7)\n",
                       bold("NO_COLOR"), bold("sekitei-scene"));
}

std::string man_scene()
{
    std::string text = man_head("sekitei-scene", 7, "what scenes of Sekitei hold");
    text +=
        ".SH DESCRIPTION\nA scene is one OpenVDB file, with a mesh beside it where it is about "
        "one. World space is right\\-handed, z up, in metres, north +y.\n";
    const std::map<std::string, Users> users = users_of_items();
    for (const bool grids : {true, false}) {
        text += grids ? ".SH GRIDS\n" : ".SH POINTS AND MESHES\n";
        for (const SceneItem& item : scene_items()) {
            if ((item.kind == SceneItem::Kind::Grid) != grids) continue;
            std::vector<std::string> words{item.type};
            if (!item.unit.empty()) words.push_back(item.unit);
            if (item.grid_class != GridClass::Unknown)
                words.emplace_back(class_text(item.grid_class));
            text +=
                fmt::format(".TP\n{} ({})\n{}", bold(item.name),
                            roff(fmt::format("{}", fmt::join(words, ", "))), roff(item.meaning));
            if (const auto found = users.find(item.name); found != users.end()) {
                if (!found->second.makers.empty())
                    text += fmt::format("; made by {}", fmt::join(found->second.makers, ", "));
                if (!found->second.readers.empty())
                    text += fmt::format("; read by {}", fmt::join(found->second.readers, ", "));
            }
            text += "\n";
            for (const SceneItem::Attribute& a : item.attributes)
                text += fmt::format(".RS\n.TP\n{} ({}{}{})\n{}\n.RE\n", bold(a.name), a.type,
                                    a.unit.empty() ? "" : ", ", roff(a.unit),
                                    a.meaning.empty() ? "\\&" : roff(a.meaning));
        }
    }
    return text + ".SH SEE ALSO\n" + bold("sekitei") + "(1)\n";
}

}  // namespace

std::string markdown_reference(const CommandPages& pages, const std::string& only)
{
    std::string text =
        "# Reference\n\nEvery command with its parameters, and everything that a scene may hold. "
        "Parameters of stages are recipe keys and, with\n"
        "`--` and hyphens, options of the command of the same name. Made by `sekitei schema "
        "--markdown`; `sekitei schema --man -o FOLDER`\n"
        "writes the same as man pages.\n\n"
        "A scene about a mesh, as `light` and `moss` make of one, has its mesh beside it: "
        "`-o x.vdb` and the recipe\n"
        "line `write = \"x.vdb\"` write x.ply too. A list writes only what it names: "
        "`write = [\"x.vdb\"]` leaves the\n"
        "mesh out, and nothing can draw such a scene; `write = [\"x.vdb\", \"x.ply\"]` names "
        "both.\n\n";
    std::vector<std::string> stages, tools;
    for (const CommandPage& page : pages)
        (page.stage ? stages : tools).push_back(fmt::format("[{0}](#{0})", page.name));
    text +=
        fmt::format("Processes: {}.\n\nTools: {}.\n\n[Scene](#scene): grids, points, meshes.\n\n",
                    fmt::join(stages, ", "), fmt::join(tools, ", "));
    text += "Options that processes share:\n\n" + markdown_common(pages);
    for (const CommandPage& page : pages)
        if (only.empty() || page.name == only) text += markdown_command(page);
    if (only.empty())
        text += markdown_scene();
    else
        text.pop_back();
    return text;
}

std::string man_page(const CommandPages& pages, const std::string& name)
{
    for (const CommandPage& page : pages)
        if (name == "sekitei-" + page.name + ".1") return man_command(page);
    return name == kScenePage ? man_scene() : man_program(pages);
}

std::vector<std::string> man_page_names(const CommandPages& pages)
{
    std::vector<std::string> names{"sekitei.1"};
    for (const CommandPage& page : pages) names.push_back("sekitei-" + page.name + ".1");
    names.emplace_back(kScenePage);
    return names;
}

}  // namespace sekitei::apps
