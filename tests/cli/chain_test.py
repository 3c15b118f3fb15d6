"""Commands chained through files and pipes; help, output for people and for programs."""

import json
import re
import subprocess
import unittest

from support import (COOL, DATA, DONE, JOINT, LAVA, PROGRAM, RENDER, REQUIRED, SOURCE, STAGES, TOOLS, USAGE, WEATHER,
                     CliTest, SceneTest, bash, environment, run, spring_weather, tables_before)


class Chain(SceneTest):
    def test_pipes_give_the_bytes_of_files(self):
        script = (f"set -euo pipefail; \"$SEKITEI\" lava {' '.join(LAVA)} --seed 7 -q -o - "
                  f"| \"$SEKITEI\" cool - {' '.join(COOL)} --seed 7 -q -o - "
                  f"| \"$SEKITEI\" joint - {' '.join(JOINT)} --seed 7 -q -o - "
                  f"| tee joints.stream "
                  f"| \"$SEKITEI\" weather - {' '.join(WEATHER)} --seed 7 -q -o weathered.vdb; "
                  f"\"$SEKITEI\" joint - {' '.join(JOINT)} --seed 7 -q -o joints.vdb < {self.cooled}.stream; "
                  f"\"$SEKITEI\" mesh weathered.vdb -q -o - | tee rock.ply "
                  f"| \"$SEKITEI\" render - {' '.join(RENDER)} --seed 7 -q -o rock.png")
        made = bash(f"\"$SEKITEI\" cool {self.lava} {' '.join(COOL)} --seed 7 -q -o - > {self.cooled}.stream", self.folder)
        self.assertEqual(made.code, DONE, made)
        done = bash(script, self.folder)
        self.assertEqual(done.code, DONE, done)
        for name in ("joints.vdb", "weathered.vdb", "rock.ply", "rock.png"):
            self.assertSameBytes(self.folder / name, self.scenes / name, name)

    def test_a_file_on_standard_input_is_the_file(self):
        done = self.succeed("cool", "-", *COOL, "--seed", 7, "-o", "cooled.vdb", data=self.lava.read_bytes())
        self.assertEqual(done.out, b"")
        self.assertSameBytes(self.folder / "cooled.vdb", self.cooled)

    def test_one_command_writes_several_files(self):
        self.succeed("mesh", self.weathered, "-o", "a.ply", "-o", "a.obj", "-o", "a.stl", "-o", "a.off", "-o", "a.glb")
        self.assertSameBytes(self.folder / "a.ply", self.mesh)
        counts = set()
        for name in ("a.ply", "a.obj", "a.off"):
            info = self.succeed("info", name, "--json").json()[0]
            counts.add((info["vertices"], info["triangles"]))
            self.assertTrue(info["closed"], name)
        self.assertEqual(len(counts), 1, counts)

    def test_a_scene_is_drawn_like_its_mesh(self):
        self.succeed("render", self.weathered, *RENDER, "--seed", 7, "-o", "direct.png")
        self.assertSameBytes(self.folder / "direct.png", self.picture)

    def test_a_slice_shows_a_volume(self):
        self.succeed("render", self.cooled, "--slice", "temperature", "--width", "200", "-o", "slice.png")
        self.assertTrue((self.folder / "slice.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n"))

    def test_a_mesh_with_y_up_is_turned(self):
        corners = [(x, y, z) for x in (0, 1.0) for y in (0, 1.4) for z in (0, 0.7)]
        corners[7] = (1.3, 1.9, 0.9)  # no symmetry that could hide a wrong turn
        faces = [(1, 2, 4), (1, 4, 3), (5, 7, 8), (5, 8, 6), (1, 5, 6), (1, 6, 2), (3, 4, 8), (3, 8, 7), (1, 3, 7), (1, 7, 5),
                 (2, 6, 8), (2, 8, 4)]
        for name, turn in (("z.obj", lambda p: p), ("y.obj", lambda p: (p[0], p[2], -p[1]))):
            self.write(name, "".join("v %g %g %g\n" % turn(p) for p in corners) + "".join("f %d %d %d\n" % f for f in faces))
        for name, up in (("z", "z"), ("y", "y")):
            self.succeed("lava", "--preset", "mesh", "--mesh", f"{name}.obj", "--mesh-up", up, "--voxel", "6cm", "-o", f"{name}.vdb")
        self.assertEqual(self.succeed("diff", "z.vdb", "y.vdb").out, b"")
        self.succeed("lava", "--preset", "mesh", "--mesh", "y.obj", "--voxel", "6cm", "-o", "lying.vdb")
        self.assertEqual(self.run_in_folder("diff", "z.vdb", "lying.vdb").code, 6)

    def test_only_leaves_the_rest_in_the_manifest(self):
        self.recipe()
        self.succeed("run", "rock.toml")
        before = {entry["path"] for entry in json.loads((self.folder / "out/manifest.json").read_text())["outputs"]}
        self.succeed("run", "rock.toml", "--only", "weather")
        after = {entry["path"] for entry in json.loads((self.folder / "out/manifest.json").read_text())["outputs"]}
        self.assertEqual(before, after)
        self.succeed("verify", "out/manifest.json")

    def test_parameters_from_a_file_are_those_of_the_command_line(self):
        self.write("joint.toml", 'spacing = "40cm"\n')
        self.succeed("joint", self.cooled, "--params", "joint.toml", "--seed", 7, "-o", "joints.vdb")
        self.assertSameBytes(self.folder / "joints.vdb", self.joints)
        self.write("other.toml", 'spacing = "25cm"\n')
        self.succeed("joint", self.cooled, "--params", "other.toml", *JOINT, "--seed", 7, "-o", "again.vdb")
        self.assertSameBytes(self.folder / "again.vdb", self.joints, "the command line wins over the file")

    def test_units_mean_the_same_length(self):
        for spacing in ("0.4", "0.4m", "400mm", "0.4 m"):
            self.succeed("joint", self.cooled, "--spacing", spacing, "--seed", 7, "--force", "-o", "joints.vdb")
            self.assertSameBytes(self.folder / "joints.vdb", self.joints, spacing)

    def test_another_seed_gives_other_columns(self):
        self.succeed("joint", self.cooled, *JOINT, "--seed", 8, "-o", "other.vdb")
        self.assertEqual(self.run_in_folder("diff", self.joints, "other.vdb").code, 6)

    def test_what_a_stage_makes_replaces_what_was_there(self):
        self.succeed("joint", self.weathered, *JOINT, "--seed", 7, "-o", "twice.vdb")
        grids = [g["name"] for g in self.succeed("info", "twice.vdb", "--json").json()[0]["grids"]]
        self.assertEqual(len(grids), len(set(grids)), grids)
        self.assertIn("density", grids)


class Words(SceneTest):
    def test_standard_output_carries_only_data(self):
        done = self.succeed("cool", self.lava, *COOL, "-o", "cooled.vdb", "-v")
        self.assertEqual(done.out, b"")
        done = self.succeed("mesh", self.weathered, "-o", "-", "-v")
        self.assertSameBytes(done.out, self.mesh)

    def test_json_is_one_object(self):
        for command, source, target, options in (("lava", None, "lava.vdb", LAVA), ("cool", self.lava, "cooled.vdb", COOL),
                                                 ("joint", self.cooled, "joints.vdb", JOINT),
                                                 ("weather", self.joints, "weathered.vdb", WEATHER),
                                                 ("mesh", self.weathered, "rock.ply", []),
                                                 ("render", self.mesh, "rock.png", RENDER)):
            done = self.succeed(command, *([source] if source else []), *options, "--seed", 7, "-o", target, "--json")
            summary = done.json()
            self.assertEqual(summary["stage"], command)
            self.assertEqual(summary["seed"], 7)
            self.assertEqual([o["path"] for o in summary["outputs"]], [target])
            self.assertEqual(summary["outputs"][0]["bytes"], (self.folder / target).stat().st_size)
            self.assertSameBytes(self.folder / target, self.scenes / target, "--json changes no file")

    def test_json_and_data_do_not_share_standard_output(self):
        self.refuse(USAGE, ["--json", "-o -"], "cool", self.lava, *COOL, "-o", "-", "--json")

    def test_quiet_is_silent(self):
        done = self.succeed("cool", self.lava, *COOL, "-o", "cooled.vdb", "-q")
        self.assertEqual((done.out, done.err), (b"", ""))
        self.recipe()
        done = self.succeed("run", "rock.toml", "-q")
        self.assertEqual((done.out, done.err), (b"", ""))

    def test_colours_and_bars_stay_off_what_is_not_a_terminal(self):
        done = self.run_in_folder("cool", "missing.vdb", "-o", "x.vdb", "-v")
        self.assertNotIn("\033", done.err)
        self.assertNotIn("\r", done.err)

    def test_no_color_is_respected_on_a_terminal(self):
        def on_terminal(env):
            # script(1) gives the program a terminal.
            done = subprocess.run(["script", "-qec", f"{PROGRAM} cool missing.vdb -o x.vdb", "/dev/null"], cwd=self.folder,
                                  env=env, stdin=subprocess.DEVNULL, capture_output=True, timeout=20)
            return done.stdout

        self.assertIn(b"\033[31m", on_terminal(environment()))
        plain = on_terminal(environment(NO_COLOR="1"))
        self.assertIn(b"error:", plain)
        self.assertNotIn(b"\033[", plain)

    def test_data_does_not_flood_a_terminal(self):
        done = subprocess.run(["script", "-qec", f"{PROGRAM} mesh {self.weathered} -o -", "/dev/null"], cwd=self.folder,
                              env=environment(), stdin=subprocess.DEVNULL, capture_output=True, timeout=20)
        self.assertLess(len(done.stdout), 2000)
        self.assertEqual(done.returncode, USAGE, done)

    def test_other_locales_change_neither_files_nor_numbers(self):
        for locale in ("C", "de_DE.UTF-8", "ja_JP.UTF-8", "nonsense"):
            self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "-o", "joints.vdb", "--force", env=environment(LC_ALL=locale))
            self.assertSameBytes(self.folder / "joints.vdb", self.joints, locale)
            info = self.succeed("info", "joints.vdb", env=environment(LC_ALL=locale)).out
            self.assertEqual(info, self.succeed("info", "joints.vdb", env=environment(LC_ALL="C")).out)


class Help(CliTest):
    @classmethod
    def setUpClass(cls):
        cls.schema = run("schema").json()["stages"]

    def test_every_command_has_help(self):
        overview = self.succeed("--help").out.decode()
        for command in STAGES + TOOLS:
            self.assertIn(f"  {command} ", overview)
            done = self.succeed(command, "--help")
            self.assertEqual(done.err, "")
            for option in ("--help", "--threads", "--memory", "--json", "--quiet"):
                self.assertIn(option, done.out.decode(), command)

    def test_help_of_a_stage_shows_unit_range_and_default_of_every_parameter(self):
        for stage, described in self.schema.items():
            text = self.succeed(stage, "--help").out.decode()
            # One entry an option: from its name to the next line that starts with an option.
            entries = re.split(r"\n(?=  (?:-|\s*--))", text)
            for name, p in described["properties"].items():
                if name in ("stage", "from", "write", "seed"):
                    continue
                with self.subTest(stage=stage, parameter=name):
                    option = "--" + name.replace("_", "-")
                    found = [e for e in entries if re.search(rf"(^|\s|,){re.escape(option)}(\s|,|$)", e.split("(")[0])]
                    self.assertTrue(found, f"{option} is not in the help of {stage}")
                    entry = re.sub(r"\s+", " ", found[0])
                    self.assertIn(p["description"], entry)
                    if "unit" in p:
                        self.assertIn(f"[{p['unit']}]", entry)
                    for key in ("minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum"):
                        if key in p:
                            bound = {f"{p[key]:.10g}", f"{p[key]:.17g}"}
                            self.assertRegex(entry, rf"[^\d.-]({'|'.join(map(re.escape, bound))})\b")
                    default = p["default"]
                    self.assertRegex(entry, r"default \S+", entry)
                    if default is None:
                        self.assertIn("default auto", entry)
                    elif isinstance(default, (int, float)) and not isinstance(default, bool):
                        shown = float(re.search(r"default ([-+.\deE]+)", entry)[1])
                        self.assertEqual(shown, default)
                    elif isinstance(default, str):
                        self.assertIn(f"default {default or 'none'}", entry)
                    for choice in p.get("enum", []):
                        self.assertIn(choice, entry)

    def test_every_default_of_the_schema_is_accepted(self):
        self.write("days.csv", spring_weather())
        for stage, described in self.schema.items():
            lines = []
            for name, p in described["properties"].items():
                if name in ("stage", "from", "write", "seed") or p["default"] is None:
                    continue
                lines.append(f"{name} = {json.dumps(REQUIRED.get(stage, {}).get(name, p['default']))}")
            self.write("defaults.toml", f"sekitei = 1\n{tables_before(stage)}" + "\n".join(lines) + "\n")
            self.succeed("check", "defaults.toml")

    def test_the_reference_page_is_the_programs_own(self):
        page = SOURCE / "docs" / "reference.md"
        self.assertTrue(page.exists(), f"make it with: {PROGRAM.name} schema --markdown > docs/reference.md")
        printed = self.succeed("schema", "--markdown").out
        self.assertSameBytes(page.read_bytes(), printed, "refresh it with: build/sekitei schema --markdown > docs/reference.md")

    def test_the_schema_is_one_json_document_of_all_stages(self):
        self.assertEqual(sorted(self.schema), sorted(STAGES))
        for stage in STAGES:
            alone = self.succeed("schema", stage).json()["stages"]
            self.assertEqual(alone, {stage: self.schema[stage]})

    def test_recipes_of_the_data_folder_are_good(self):
        recipes = sorted((DATA / "recipes").glob("*.toml"))
        self.assertTrue(recipes)
        self.succeed("check", *recipes)

    def test_the_version_is_told(self):
        self.assertRegex(self.succeed("--version").out.decode(), r"^sekitei \d+\.\d+")

    def test_misspelt_commands_and_options_get_the_nearest(self):
        self.refuse(USAGE, ["joitn", "joint"], "joitn")
        self.refuse(USAGE, ["--spacin", "--spacing"], "joint", "x.vdb", "-o", "y.vdb", "--spacin", "3cm")
        self.refuse(USAGE, ["command"])
        self.refuse(USAGE, ["chevrn", "chevron"], "lava", "--preset", "chevrn", "-o", "x.vdb")
        self.refuse(USAGE, ["4metr", "mm cm m km"], "lava", "--voxel", "4metr", "-o", "x.vdb")

    def test_bash_completes_commands_options_and_choices(self):
        script = ('source <("$SEKITEI" completions bash)\n'
                  'complete_line() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); _sekitei; echo "${COMPREPLY[*]}"; }\n'
                  'complete_line sekitei jo\n'
                  'complete_line sekitei joint --spac\n'
                  'complete_line sekitei weather x.vdb --cut h\n'
                  'complete_line sekitei run --dry\n'
                  'complete -p sekitei\n')
        done = bash(script, self.folder)
        self.assertEqual(done.code, DONE, done)
        self.assertEqual(done.out.decode().splitlines()[:4], ["joint", "--spacing", "horizontal", "--dry-run"])
        self.assertIn("-F _sekitei", done.out.decode())

    def test_every_option_of_a_stage_completes(self):
        for stage, described in self.schema.items():
            done = bash('source <("$SEKITEI" completions bash)\n'
                        f'COMP_WORDS=(sekitei {stage} --); COMP_CWORD=2; _sekitei; printf "%s\\n" "${{COMPREPLY[@]}}"', self.folder)
            offered = set(done.out.decode().split())
            for name in described["properties"]:
                if name not in ("stage", "from", "write"):
                    self.assertIn("--" + name.replace("_", "-"), offered, stage)

    def test_other_shells_get_scripts(self):
        for shell, word in (("zsh", "#compdef sekitei"), ("fish", "complete -c sekitei")):
            self.assertIn(word, self.succeed("completions", shell).out.decode())
        self.refuse(USAGE, ["tcsh", "bash, zsh or fish"], "completions", "tcsh")


if __name__ == "__main__":
    unittest.main()
