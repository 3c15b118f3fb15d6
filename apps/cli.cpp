#include "apps/cli.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <system_error>
#include <thread>

#include "apps/commands/commands.h"
#include "apps/commands/export.h"
#include "apps/console.h"
#include "apps/stage.h"
#include "core/error.h"
#include "core/log.h"
#include "core/machine.h"
#include "core/parallel.h"
#include "core/units.h"

namespace sekitei::apps {
namespace {

/// Options shared by all commands, as words.
struct CommonWords {
    std::vector<std::string> output;
    std::optional<std::string> seed, threads, memory;  // "" is a mistake, not the default
    std::string params;
    bool force = false, json = false, quiet = false, verbose = false, fix_nan = false;
};

void add_common(CLI::App& command, CommonWords& words, bool writes)
{
    if (writes) {
        command
            .add_option("-o,--output", words.output,
                        "file to write, - for standard output; may be repeated")
            ->type_name("FILE")
            ->allow_extra_args(false)
            ->group("General");
        command.add_flag("--force", words.force, "replace existing files")->group("General");
        command
            .add_option("--seed", words.seed,
                        "seed of all random numbers (integer, 0 or larger; default 1)")
            ->type_name("N")
            ->group("General");
        command
            .add_option("--params", words.params,
                        "TOML file of parameters; options on the command line win")
            ->type_name("FILE")
            ->group("General");
        command
            .add_flag("--fix-nan", words.fix_nan,
                      "replace NaN and infinite voxels by the background")
            ->group("General");
    }
    command
        .add_option("--threads", words.threads,
                    "threads to use (default: all cores); the result is the same")
        ->type_name("N")
        ->group("General");
    command
        .add_option("--memory", words.memory,
                    "refuse work that needs more (default: what the machine has)")
        ->type_name("SIZE")
        ->group("General");
    command.add_flag("--json", words.json, "print one JSON summary on standard output")
        ->group("General");
    command.add_flag("-q,--quiet", words.quiet, "say only warnings and errors")->group("General");
    command.add_flag("-v,--verbose", words.verbose, "say more")->group("General");
}

std::uint64_t whole_number(const std::string& word, const char* option, std::uint64_t most)
{
    std::uint64_t value = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc{} || end != word.data() + word.size() || value > most)
        throw InvalidParameter(
            fmt::format("{} {}: must be an integer from 0 to {}", option, word, most));
    return value;
}

/// @param threads  receives the limit; 0 = all
Common understood(const CommonWords& words, std::size_t& threads)
{
    Common common;
    common.output = words.output;
    common.force = words.force;
    common.json = words.json;
    common.fix_nan = words.fix_nan;
    common.params_file = words.params;
    if (words.seed) common.seed = whole_number(*words.seed, "--seed", 0x7FFFFFFFFFFFFFFF);
    common.memory_limit = physical_memory();
    if (words.memory) {
        try {
            common.memory_limit = parse_bytes(*words.memory);
        } catch (const InvalidParameter& error) {
            throw InvalidParameter(fmt::format("--memory {}: {}", *words.memory, error.what()));
        }
    }
    if (words.threads) {
        threads = whole_number(*words.threads, "--threads", 1000000);
        if (threads == 0) throw InvalidParameter("--threads 0: must be at least 1");
        // More threads than cores only cost memory.
        threads = std::min<std::size_t>(threads, std::max(1u, std::thread::hardware_concurrency()));
    }
    log::set_level(words.quiet     ? log::Level::Warning
                   : words.verbose ? log::Level::Detail
                                   : log::Level::Info);
    return common;
}

/// One subcommand: its CLI11 object and what it does.
struct Command {
    CLI::App* app = nullptr;
    CommonWords common;
    std::vector<std::string> files, set, only, to;
    std::map<std::string, std::string> words;  // parameters of a stage
    std::map<std::string, bool> flags;
    std::string stage, shell, text, at, face;
    bool dry_run = false, full = false, markdown = false, man = false;
    std::string tolerance = "0", growth = "2", variants = "4", generations = "10,20,30,40";
    std::function<int(const Common&)> run;
};

/// For commands that write several files.
void add_folder(Command& c)
{
    c.app->add_option("-o,--output", c.common.output, "existing folder to write into")
        ->type_name("FOLDER")
        ->required()
        ->expected(1)
        ->group("General");
    c.app->add_flag("--force", c.common.force, "replace existing files")->group("General");
}

using Commands = std::vector<std::unique_ptr<Command>>;

Command& add_command(CLI::App& program, Commands& commands, const std::string& name,
                     const std::string& summary, bool writes, const char* group)
{
    auto command = std::make_unique<Command>();
    command->app = program.add_subcommand(name, summary)->group(group);
    add_common(*command->app, command->common, writes);
    commands.push_back(std::move(command));
    return *commands.back();
}

void add_stage_command(CLI::App& program, Commands& commands, const StageInfo& info)
{
    Command& c = add_command(program, commands, info.name, info.summary, true, "Processes");
    if (info.reads_scene)
        c.app
            ->add_option(info.reads_if_given ? "scene,--from" : "scene", c.files,
                         info.reads_many ? "scenes to read (.vdb)"
                         : info.output == OutputKind::Points
                             ? "scene (.vdb) and meshes; several scenes make sequences"
                         : info.output == OutputKind::Picture
                             ? "scene (.vdb) or mesh to look at, - for standard input"
                             : "scene to read (.vdb), - for standard input")
            ->type_name("FILE")
            ->expected(0, -1);
    if (info.name == "export")
        c.app
            ->add_option("--to", c.to,
                         "file to write by its suffix: .glb, .usda, .csv (instances), .obj, .ply, "
                         ".png (map), .vdb; or a folder for all of them; may be repeated")
            ->type_name("FILE")
            ->allow_extra_args(false)
            ->group("General");
    const auto stage = make_stage(info.name);
    for (const Param& p : stage->params()) {
        const std::string option = option_name(p.name);
        const std::string help =
            fmt::format("{} ({}; default {})", p.help, p.type_text(), p.value_text());
        if (p.kind == Param::Kind::Flag)
            c.app->add_flag(fmt::format("--{0},!--no-{0}", option), c.flags[p.name], help)
                ->group("Parameters");
        else
            c.app->add_option("--" + option, c.words[p.name], help)
                ->type_name("VALUE")
                ->allow_extra_args(false)
                ->group("Parameters");
    }
    c.run = [&c, name = info.name](const Common& common) {
        Words words;
        const auto described = make_stage(name);
        for (const Param& p : described->params()) {
            const CLI::Option* option = c.app->get_option("--" + option_name(p.name));
            if (option->count() == 0) continue;
            words.emplace_back(p.name, p.kind == Param::Kind::Flag
                                           ? (c.flags[p.name] ? "true" : "false")
                                           : c.words[p.name]);
        }
        // By itself `-o x.ply` is points, from before there was anything else.
        const bool points =
            c.to.empty() && !common.output.empty() &&
            std::ranges::all_of(common.output, [](auto& file) {
                return file == "-" || std::filesystem::path(file).extension() == ".ply";
            });
        if (name == "export" && !points) {
            std::vector<std::string> targets = common.output;
            targets.insert(targets.end(), c.to.begin(), c.to.end());
            return command_export(c.files, targets, words, common);
        }
        return command_stage(name, c.files, words, common);
    };
}

/// What the command line knows of itself.
CommandPages pages_of(const CLI::App& program)
{
    CommandPages pages;
    for (const CLI::App* app : program.get_subcommands([](const CLI::App*) { return true; })) {
        CommandPage page;
        page.name = app->get_name();
        page.summary = app->get_description();
        page.stage = std::any_of(stage_infos().begin(), stage_infos().end(),
                                 [&](const StageInfo& info) { return info.name == page.name; });
        ParamList params;
        const auto stage = page.stage ? make_stage(page.name) : nullptr;
        if (stage) params = stage->params();
        for (const CLI::Option* option : app->get_options()) {
            CommandPage::Option o;
            o.plain = option->get_positional();
            const auto& switched_off = option->get_fnames();
            for (const std::string& name : option->get_lnames())
                (std::ranges::count(switched_off, name) ? o.negative : o.name) = "--" + name;
            if (o.plain) o.name = option->get_name(true);
            for (const std::string& name : option->get_snames()) o.shortcut = "-" + name;
            if (option->get_expected_max() > 0) o.value = option->get_type_name();
            o.help = option->get_description();
            o.required = option->get_required();
            o.repeats = option->get_expected_max() > 2;
            o.common = option->get_group() == "General" || o.name == "--help";
            o.file = o.value == "FILE";
            o.folder = o.value == "FOLDER";
            if (const Param* param = o.plain ? nullptr : find_param(params, o.name.substr(2))) {
                o.choices = param->choices;
                if (param->optional && !o.choices.empty()) o.choices.emplace_back("auto");
                o.file = o.file || param->kind == Param::Kind::Path;
                o.common = false;
            }
            if (o.value == "SHELL") o.choices = {"bash", "zsh", "fish"};
            if (o.value == "COMMAND")
                for (const CLI::App* other :
                     program.get_subcommands([](const CLI::App*) { return true; }))
                    o.choices.push_back(other->get_name());
            page.options.push_back(std::move(o));
        }
        pages.push_back(std::move(page));
    }
    return pages;
}

void add_tool_commands(CLI::App& program, Commands& commands)
{
    auto summary = [](const std::string& name) {
        for (const CommandInfo& info : tool_commands())
            if (info.name == name) return info.summary;
        return std::string();
    };
    auto add = [&](const char* name) -> Command& {
        return add_command(program, commands, name, summary(name), false, "Tools");
    };
    {
        Command& c = add("run");
        c.app->add_option("recipe", c.files, "recipes (.toml), run one after the other")
            ->type_name("FILE")
            ->required();
        c.app->add_option("--set", c.set, "override a key: joint.spacing=30cm; may be repeated")
            ->type_name("KEY=VALUE")
            ->allow_extra_args(false);
        c.app->add_option("--only", c.only, "run this stage and what it reads; may be repeated")
            ->type_name("STAGE")
            ->allow_extra_args(false);
        c.app->add_flag("--dry-run", c.dry_run, "say what would run, why, and what it would take");
        c.app->add_flag("--force", c.common.force, "replace files that this recipe did not make");
        c.app->add_flag("--fix-nan", c.common.fix_nan,
                        "replace NaN and infinite voxels by the background");
        c.app->add_option("--seed", c.common.seed, "seed of the recipe")
            ->type_name("N")
            ->group("General");
        c.run = [&c](const Common& common) {
            std::vector<std::string> overrides = c.set;
            if (c.common.seed) overrides.push_back("seed=" + *c.common.seed);
            return command_run(c.files, overrides, {c.only.begin(), c.only.end()}, c.dry_run,
                               common);
        };
    }
    {
        Command& c = add("check");
        c.app->add_option("recipe", c.files, "recipes (.toml)")->type_name("FILE")->required();
        c.app->add_option("--set", c.set, "override a key")
            ->type_name("KEY=VALUE")
            ->allow_extra_args(false);
        c.run = [&c](const Common& common) { return command_check(c.files, c.set, common); };
    }
    {
        Command& c = add("info");
        c.app->add_option("file", c.files, "scenes (.vdb), meshes or points (.ply)")
            ->type_name("FILE")
            ->required();
        c.run = [&c](const Common& common) { return command_info(c.files, common); };
    }
    {
        Command& c = add("replay");
        c.app->add_option("file", c.files, "scene (.vdb)")
            ->type_name("FILE")
            ->required()
            ->expected(1);
        c.app->add_flag("--full", c.full,
                        "write every value, not only those that differ from the defaults");
        c.run = [&c](const Common&) { return command_replay(c.files.at(0), c.full); };
    }
    {
        Command& c = add("diff");
        c.app->add_option("files", c.files, "two scenes or two meshes")
            ->type_name("FILE")
            ->required()
            ->expected(2);
        c.app
            ->add_option("--tolerance", c.tolerance,
                         "largest difference that counts as equal (default 0)")
            ->type_name("NUMBER");
        c.run = [&c](const Common& common) {
            const double tolerance = parse_quantity(c.tolerance, "");
            if (tolerance < 0)
                throw InvalidParameter(fmt::format("--tolerance {}: must be >= 0", c.tolerance));
            return command_diff(c.files.at(0), c.files.at(1), tolerance, common);
        };
    }
    {
        Command& c = add("explain");
        c.app->add_option("file", c.files, "scene (.vdb) with a climate")
            ->type_name("FILE")
            ->required()
            ->expected(1);
        c.app->add_option("--at", c.at, "point whose nearest surface cell is meant: x,y,z")
            ->type_name("POINT")
            ->allow_extra_args(false);
        c.app->add_option("--face", c.face, "number of a face of the mesh beside the scene")
            ->type_name("NUMBER")
            ->allow_extra_args(false);
        c.run = [&c](const Common& common) {
            return command_explain(c.files.at(0), c.at, c.face, common);
        };
    }
    {
        Command& c = add("view");
        c.app
            ->add_option("input", c.files,
                         "folder with manifest.json; or scenes (.vdb) in their order, with further "
                         "meshes; or a .glb with the scene that explains it")
            ->type_name("FILE")
            ->required();
        c.app
            ->add_option("-o,--output", c.common.output,
                         "page to write (default: view.html in the folder, else beside the scene)")
            ->type_name("FILE.html")
            ->allow_extra_args(false)
            ->group("General");
        c.app->add_flag("--force", c.common.force, "replace an existing file")->group("General");
        c.app
            ->add_option("--moss-lod", c.text,
                         "detail of moss plants: 0 finest, 1, 2 coarsest (default 1)")
            ->type_name("N");
        c.run = [&c](const Common& common) {
            const int lod = c.text.empty() ? 1 : int(whole_number(c.text, "--moss-lod", 2));
            return command_view(c.files, lod, common);
        };
    }
    {
        Command& c = add("verify");
        c.app->add_option("files", c.files, "scenes (.vdb) or manifests (.json)")
            ->type_name("FILE")
            ->required();
        c.run = [&c](const Common& common) { return command_verify(c.files, common); };
    }
    {
        Command& c = add("schema");
        c.app->add_option("stage", c.stage, "one stage only; with --man any command")
            ->type_name("COMMAND");
        CLI::Option* markdown =
            c.app->add_flag("--markdown", c.markdown, "as a reference page for people");
        c.app
            ->add_flag("--man", c.man,
                       "as a man page: of the stage or tool named, else of the program; with -o of "
                       "everything")
            ->excludes(markdown);
        c.app
            ->add_option("-o,--output", c.common.output,
                         "with --man: existing folder to write all man pages into")
            ->type_name("FOLDER")
            ->expected(1)
            ->group("General");
        c.app->add_flag("--force", c.common.force, "replace existing files")->group("General");
        c.run = [&c, &program](const Common& common) {
            const SchemaForm form = c.man        ? SchemaForm::Man
                                    : c.markdown ? SchemaForm::Markdown
                                                 : SchemaForm::Json;
            return command_schema(c.stage, form, pages_of(program), common);
        };
    }
    {
        Command& c = add("specimens");
        add_folder(c);
        c.app
            ->add_option("--species", c.files,
                         "kinds of trees: names of presets or .toml files; may be repeated "
                         "(default: beech)")
            ->type_name("NAME")
            ->allow_extra_args(false);
        c.app->add_option("--variants", c.variants, "of each, 1 to 1000 (default 4)")
            ->type_name("N");
        c.app
            ->add_option("--generations", c.generations,
                         "ages at which a model is taken: height classes (default 10,20,30,40)")
            ->type_name("N,N,...");
        c.app->add_option("--seed", c.common.seed, "of the first variant (default 1)")
            ->type_name("N")
            ->group("General");
        c.run = [&c](const Common& common) {
            SpecimenWords words;
            words.species = c.files.empty() ? std::vector<std::string>{"beech"} : c.files;
            words.variants = static_cast<int>(whole_number(c.variants, "--variants", 1000));
            if (words.variants < 1) throw InvalidParameter("--variants 0: must be 1 to 1000");
            std::string rest = c.generations;
            while (!rest.empty()) {
                const std::size_t comma = std::min(rest.find(','), rest.size());
                words.generations.push_back(
                    static_cast<int>(whole_number(rest.substr(0, comma), "--generations", 500)));
                rest.erase(0, comma + 1);
            }
            return command_specimens(words, common);
        };
    }
    {
        Command& c = add("tufts");
        add_folder(c);
        c.app
            ->add_option("--species", c.files,
                         "bryum, hypnum, polytrichum, grimmia; any other name: cushions; may be "
                         "repeated (default: these four)")
            ->type_name("NAME")
            ->allow_extra_args(false);
        c.app
            ->add_option("--growth", c.growth,
                         "of the moss: fewer shoots below 1.4 and 0.7, no capsules below 2 "
                         "(number, 0 or larger; default 2)")
            ->type_name("NUMBER");
        c.run = [&c](const Common& common) {
            const double growth = parse_quantity(c.growth, "");
            if (growth < 0)
                throw InvalidParameter(fmt::format("--growth {}: must be >= 0", c.growth));
            if (c.files.empty()) c.files = {"bryum", "hypnum", "polytrichum", "grimmia"};
            return command_tufts(c.files, growth, common);
        };
    }
    {
        Command& c = add("completions");
        c.app->add_option("shell", c.shell, "bash, zsh or fish")->type_name("SHELL")->required();
        c.run = [&c, &program](const Common&) {
            return command_completions(c.shell, pages_of(program));
        };
    }
}

/// Adds the nearest known option or command to CLI11's message about an unknown one.
std::string helped(const CLI::ParseError& error, const CLI::App& program, int argc, char** argv)
{
    std::string message = error.what();
    std::vector<std::string> known;
    const CLI::App* app = &program;
    for (const CLI::App* sub : program.get_subcommands()) app = sub;
    for (const CLI::Option* option : app->get_options())
        for (const std::string& name : option->get_lnames()) known.push_back("--" + name);
    for (const CLI::App* sub : app->get_subcommands(nullptr)) known.push_back(sub->get_name());
    // No command was understood: the first word that is no option was meant as one.
    if (app == &program)
        for (int i = 1; i < argc; ++i) {
            const std::string word = argv[i];
            if (word.empty() || word[0] == '-') continue;
            const std::string near = nearest_name(word, known);
            return fmt::format("there is no command '{}'{}", word,
                               near.empty() ? "" : fmt::format("; did you mean '{}'?", near));
        }
    else
        message = app->get_name() + ": " + message;
    for (int i = 1; i < argc; ++i) {
        std::string word = argv[i];
        word = word.substr(0, word.find('='));
        // An option that CLI11 does not know may make it complain of the words that follow.
        if (!word.starts_with("--") || word == "--" || word.starts_with("--no-")) continue;
        if (std::find(known.begin(), known.end(), word) != known.end()) continue;
        const std::string near = nearest_name(word, known);
        return fmt::format("{}: there is no option {}{}", app->get_name(), word,
                           near.empty() ? "" : fmt::format("; did you mean '{}'?", near));
    }
    return message;
}

void complain(const std::string& text)
{
    clear_progress_line();
    const char *red = use_colour() ? "\033[31m" : "", *plain = use_colour() ? "\033[0m" : "";
    const std::string line = fmt::format("{}error:{} {}\n", red, plain, text);
    std::fwrite(line.data(), 1, line.size(), stderr);
}

int parse_and_run(int argc, char** argv)
{
    CLI::App program{
        "Sekitei grows natural scenery from its causes: lava cools, rock splits into columns, "
        "weather breaks them; sun, wind and water give the surface its climate, and moss settles "
        "where that suits it.",
        "sekitei"};
    program.set_version_flag("--version", std::string("sekitei ") + SEKITEI_VERSION);
    program.require_subcommand(1);
    program.get_formatter()->column_width(30);
    Commands commands;
    for (const StageInfo& info : stage_infos()) add_stage_command(program, commands, info);
    add_tool_commands(program, commands);
    try {
        program.parse(argc, argv);
    } catch (const CLI::Success& success) {  // --help, --version
        return program.exit(success);
    } catch (const CLI::ParseError& error) {
        throw InvalidParameter(helped(error, program, argc, argv) + "; see sekitei --help");
    }
    for (const auto& command : commands) {
        if (!command->app->parsed()) continue;
        std::size_t threads = 0;
        const Common common = understood(command->common, threads);
        const ThreadLimit limit(threads);
        return command->run(common);
    }
    return static_cast<int>(ExitCode::Usage);
}

/// TBB says so in words when the system gives it no thread.
bool no_thread(const std::exception& error)
{
    return std::string_view(error.what()).find("pthread_create") != std::string_view::npos;
}

void complain_of_threads(const std::exception& error)
{
    complain(fmt::format(
        "cannot start another thread: {}; use fewer --threads or give the process more memory",
        error.what()));
}

/// TBB's threads have nobody above them to catch: when one cannot start for want of memory, say so.
[[noreturn]] void on_terminate()
{
    try {
        if (const std::exception_ptr thrown = std::current_exception())
            std::rethrow_exception(thrown);
        complain("this is a bug in Sekitei: the program ended itself");
    } catch (const std::bad_alloc&) {
        complain("out of memory; make the voxels larger or give the process more memory");
        ::_exit(static_cast<int>(ExitCode::Limit));
    } catch (const std::system_error& error) {
        complain_of_threads(error);
        ::_exit(static_cast<int>(ExitCode::Limit));
    } catch (const std::exception& error) {
        complain(fmt::format("this is a bug in Sekitei: {}", error.what()));
    }
    ::_exit(static_cast<int>(ExitCode::Bug));
}

}  // namespace

int run_command_line(int argc, char** argv)
{
    hold_standard_descriptors();
    std::set_terminate(on_terminate);
    install_signal_handlers();
    log::set_sink([](log::Level level, const std::string& line) {
        clear_progress_line();
        const char *yellow = use_colour() ? "\033[33m" : "", *plain = use_colour() ? "\033[0m" : "";
        const std::string text = level == log::Level::Warning
                                     ? fmt::format("{}warning:{} {}\n", yellow, plain, line)
                                     : line + "\n";
        std::fwrite(text.data(), 1, text.size(), stderr);
    });
    try {
        return parse_and_run(argc, argv);
    } catch (const Cancelled&) {
        complain("interrupted; nothing half-written is left");
        return interrupted_exit_code();
    } catch (const Error& error) {
        complain(error.what());
        return static_cast<int>(error.code());
    } catch (const std::bad_alloc&) {
        complain("out of memory; make the voxels larger or give the process more memory");
        return static_cast<int>(ExitCode::Limit);
    } catch (const std::filesystem::filesystem_error& error) {
        // A path that cannot even be looked at.
        complain(fmt::format("{}: {}", error.path1().string(), error.code().message()));
        return static_cast<int>(ExitCode::BadInput);
    } catch (const std::exception& error) {
        if (no_thread(error)) {
            complain_of_threads(error);
            return static_cast<int>(ExitCode::Limit);
        }
        complain(fmt::format("this is a bug in Sekitei: {}", error.what()));
        return static_cast<int>(ExitCode::Bug);
    }
}

}  // namespace sekitei::apps
