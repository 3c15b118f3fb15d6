"""Recipes: what runs again and why, errors with their place, manifest, replay, info, diff, verify."""

import json
import os
import re
import shutil
import time
import unittest

from support import (BAD_INPUT, DIFFER, DONE, LAVA, RECIPE, STAGES, USAGE, CliTest, SceneTest, files_in, run, spring_weather,
                     tables_before, temporaries)


def states(summary):
    return {s["name"]: s["state"] for s in summary["stages"]}


NAMES = ["lava", "cool", "joint", "weather", "rock", "picture"]


class RunningARecipe(CliTest):
    def setUp(self):
        super().setUp()
        self.recipe()

    def go(self, *options):
        return self.succeed("run", "rock.toml", "--json", *options).json()

    def test_a_second_run_does_nothing_and_touches_nothing(self):
        first = self.go()
        self.assertEqual(states(first), dict.fromkeys(NAMES, "run"))
        self.assertEqual([o["path"] for o in first["outputs"]], ["rock.vdb", "rock.ply", "rock.obj", "rock.png"])
        times = {p: p.stat().st_mtime_ns for p in (self.folder / "out").glob("rock.*")}
        self.assertEqual(len(times), 4)
        began = time.monotonic()
        second = self.go()
        self.assertLess(time.monotonic() - began, 2)
        self.assertEqual(states(second), dict.fromkeys(NAMES, "cached"))
        self.assertEqual(times, {p: p.stat().st_mtime_ns for p in times})
        self.assertEqual(first["outputs"], second["outputs"])
        self.assertEqual(temporaries(self.folder), [])

    def test_only_what_depends_on_a_change_runs_again(self):
        self.go()
        before = files_in(self.folder / "out")
        changed = self.go("--set", "joint.spacing=30cm")
        self.assertEqual(states(changed), {"lava": "cached", "cool": "cached", "joint": "run", "weather": "run", "rock": "run",
                                           "picture": "run"})
        reason = {s["name"]: s["reason"] for s in changed["stages"]}
        self.assertIn("spacing changed from 0.4 to 0.3", reason["joint"])
        self.assertIn("its input", reason["weather"])
        self.assertNotEqual(before["rock.vdb"], files_in(self.folder / "out")["rock.vdb"])
        back = self.go()
        self.assertEqual(states(back), dict.fromkeys(NAMES, "cached"))
        self.assertSameFiles(before, files_in(self.folder / "out"), "going back gives the old files")

    def test_the_same_value_written_differently_changes_nothing(self):
        self.go()
        self.recipe(RECIPE.replace('"40cm"', "0.4  # half a step").replace('["1.6m", "1.6m", "1.6m"]', "[1.6, 1.6, 1.6]"))
        self.assertEqual(states(self.go()), dict.fromkeys(NAMES, "cached"))

    def test_a_change_of_the_picture_makes_only_the_picture(self):
        self.go()
        self.assertEqual([n for n, s in states(self.go("--set", "picture.samples=3")).items() if s == "run"], ["picture"])

    def test_another_seed_runs_all_stages(self):
        first = self.go()
        second = self.go("--seed", "8")
        self.assertEqual(states(second)["joint"], "run")
        self.assertNotEqual(first["outputs"][0]["hash"], second["outputs"][0]["hash"])

    def test_a_lost_or_changed_output_is_made_again(self):
        self.go()
        before = files_in(self.folder / "out")
        (self.folder / "out/rock.obj").unlink()
        self.go()
        self.assertSameFiles(before, files_in(self.folder / "out"))

    def test_a_damaged_kept_result_is_made_again(self):
        self.go()
        before = files_in(self.folder / "out")
        kept = next((self.folder / "out/.sekitei").glob("joint-*.vdb"))
        content = bytearray(kept.read_bytes())
        content[len(content) // 2] ^= 1
        kept.write_bytes(content)
        again = self.go()
        self.assertEqual([n for n, s in states(again).items() if s == "run"], ["joint"])
        self.assertIn("damaged", next(s["reason"] for s in again["stages"] if s["name"] == "joint"))
        self.assertSameFiles(before, files_in(self.folder / "out"))

    def test_a_damaged_state_file_costs_only_time(self):
        self.go()
        before = files_in(self.folder / "out")
        (self.folder / "out/.sekitei/state.json").write_text("{\"last\": [")
        done = self.run_in_folder("run", "rock.toml", "--json", "--force")
        self.assertEqual(done.code, DONE, done)
        self.assertSameFiles(before, files_in(self.folder / "out"))

    def test_a_dry_run_tells_the_plan_and_writes_nothing(self):
        plan = self.go("--dry-run")
        self.assertEqual(states(plan), dict.fromkeys(NAMES, "run"))
        self.assertFalse((self.folder / "out").exists())
        for stage in plan["stages"]:
            self.assertTrue(stage["reason"], stage)
            for estimate in ("voxels", "memory", "disk"):
                self.assertGreater(stage[estimate], 0, stage)
        self.assertAlmostEqual(plan["stages"][0]["voxels"], 40**3, delta=40**3)
        text = self.succeed("run", "rock.toml", "--dry-run").err
        for name in NAMES:
            self.assertIn(name, text)
        self.go()
        before = {p: p.stat().st_mtime_ns for p in self.folder.rglob("*")}
        plan = self.go("--dry-run", "--set", "weather.cut=horizontal")
        self.assertEqual(states(plan), {"lava": "cached", "cool": "cached", "joint": "cached", "weather": "run", "rock": "run",
                                        "picture": "run"})
        self.assertIn("cut changed from", plan["stages"][3]["reason"])
        self.assertEqual(before, {p: p.stat().st_mtime_ns for p in self.folder.rglob("*")})

    def test_only_runs_a_stage_and_what_it_reads(self):
        self.assertEqual(list(states(self.go("--only", "joint"))), ["lava", "cool", "joint"])
        self.assertFalse((self.folder / "out/rock.vdb").exists())
        self.assertEqual(states(self.go())["joint"], "cached")
        self.refuse(USAGE, ["--only jonit", "lava, cool, joint"], "run", "rock.toml", "--only", "jonit")

    def test_two_stages_read_one(self):
        self.recipe(RECIPE + '\n[flat]\nstage = "weather"\nfrom = "joint"\ncut = "horizontal"\nwrite = "flat.vdb"\n'
                    '\n[flat_rock]\nstage = "mesh"\nfrom = ["flat"]\nwrite = "flat.ply"\n')
        done = self.go()
        self.assertEqual(states(done), dict.fromkeys([*NAMES, "flat", "flat_rock"], "run"))
        # Each branch alone gives the same files.
        branch = RECIPE.replace('"perpendicular"', '"horizontal"').replace("rock.vdb", "flat.vdb").replace("rock.ply", "flat.ply")
        self.recipe(branch, "branch.toml")
        self.succeed("run", "branch.toml", "--set", "out=branch", "-q")
        for name in ("flat.vdb", "flat.ply"):
            self.assertSameBytes(self.folder / "out" / name, self.folder / "branch" / name, name)
        self.recipe()
        self.succeed("run", "rock.toml", "--set", "out=plain", "-q")
        for name in ("rock.vdb", "rock.ply", "rock.png"):
            self.assertSameBytes(self.folder / "out" / name, self.folder / "plain" / name, name)

    def test_stages_that_bring_different_grids_of_one_name_are_told(self):
        self.recipe(RECIPE + '\n[flat]\nstage = "weather"\nfrom = "joint"\ncut = "horizontal"\n'
                    '\n[both]\nstage = "mesh"\nfrom = ["weather", "flat"]\nwrite = "both.ply"\n')
        done = self.run_in_folder("run", "rock.toml")
        self.assertEqual(done.code, USAGE, done)
        for word in ("rock.toml:", "both.from", "'weather'", "'flat'"):
            self.assertIn(word, done.err)

    def test_stages_may_stand_in_any_order(self):
        self.go()
        lines = RECIPE.split("\n\n")
        head, tables = lines[0], lines[1:]
        named = [t.replace("[cool]", '[cool]\nfrom = "lava"').replace("[joint]", '[joint]\nfrom = "cool"')
                 .replace("[weather]", '[weather]\nfrom = "joint"').replace('stage = "mesh"', 'stage = "mesh"\nfrom = "weather"')
                 for t in tables]
        self.recipe("\n\n".join([head, *reversed(named)]))
        self.assertEqual(states(self.go()), dict.fromkeys(NAMES, "cached"))

    def test_the_recipe_and_the_chain_of_commands_agree(self):
        from support import make_chain
        made = self.folder / "chain"
        made.mkdir()
        make_chain(made)
        self.go()
        self.assertSameBytes(self.folder / "out/rock.vdb", made / "weathered.vdb")
        self.assertSameBytes(self.folder / "out/rock.ply", made / "rock.ply")
        self.assertSameBytes(self.folder / "out/rock.png", made / "rock.png")

    def test_the_manifest_is_complete_and_verified(self):
        self.go()
        out = self.folder / "out"
        manifest = json.loads((out / "manifest.json").read_text())
        self.assertEqual({o["path"] for o in manifest["outputs"]}, {"rock.vdb", "rock.ply", "rock.obj", "rock.png"})
        self.assertEqual(sorted(f for f in files_in(out) if f != "manifest.json"), sorted(o["path"] for o in manifest["outputs"]))
        self.assertEqual([s["name"] for s in manifest["stages"]], NAMES)
        for entry in manifest["outputs"]:
            self.assertEqual(entry["bytes"], (out / entry["path"]).stat().st_size)
            self.assertRegex(entry["hash"], r"^[0-9a-f]{32}$")
            self.assertIn(entry["stage"], NAMES)
            self.assertIn(entry["kind"], ("scene", "mesh", "picture"))
        scene = next(o for o in manifest["outputs"] if o["kind"] == "scene")
        grids = {g["name"]: g for g in scene["grids"]}
        self.assertEqual(grids["temperature"]["unit"], "K")
        self.assertEqual(grids["density"]["class"], "fog volume")
        for lower, upper in zip(*grids["region"]["bounds_m"]):
            self.assertTrue(-0.05 < lower < upper < 1.65, grids["region"]["bounds_m"])
        mesh = next(o for o in manifest["outputs"] if o["path"] == "rock.ply")
        self.assertEqual((mesh["unit"], mesh["up"]), ("m", "z"))
        self.assertEqual(len(mesh["bounds_m"]), 2)
        text = (out / "manifest.json").read_text()
        for secret in (str(self.folder), os.uname().nodename, time.strftime("%Y-")):
            self.assertNotIn(secret, text, "no folder, host or date in files")
        self.succeed("verify", "out/manifest.json")
        for name in ("rock.vdb", "rock.ply", "rock.png"):
            content = bytearray((out / name).read_bytes())
            content[len(content) * 2 // 3] ^= 4
            (out / name).write_bytes(content)
            self.refuse(DIFFER, [name], "verify", "out/manifest.json")
            content[len(content) * 2 // 3] ^= 4
            (out / name).write_bytes(content)
        self.succeed("verify", "out/manifest.json")
        (out / "rock.png").unlink()
        self.refuse(DIFFER, ["rock.png", "missing"], "verify", "out/manifest.json")

    def test_a_foreign_file_in_the_way_is_kept(self):
        self.write("out/rock.ply", "somebody's work")
        self.refuse(USAGE, ["rock.ply", "--force"], "run", "rock.toml")
        self.assertEqual((self.folder / "out/rock.ply").read_text(), "somebody's work")
        self.go("--force")
        self.assertTrue((self.folder / "out/rock.ply").read_bytes().startswith(b"ply"))

    def test_an_output_changed_by_hand_is_kept(self):
        self.go()
        self.write("out/rock.obj", "retouched")
        self.refuse(USAGE, ["rock.obj", "--force"], "run", "rock.toml")
        self.go("--force")
        self.assertNotEqual((self.folder / "out/rock.obj").read_text(), "retouched")

    def test_a_foreign_manifest_in_the_way_is_kept(self):
        self.write("out/manifest.json", "{\"name\": \"a web application\"}")
        self.refuse(USAGE, ["manifest.json", "--force"], "run", "rock.toml")

    def test_two_runs_into_one_folder_at_once_are_refused(self):
        import fcntl
        self.go()
        with open(self.folder / "out/.sekitei/lock") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            self.refuse(4, ["in use", "out"], "run", "rock.toml")
        self.go()

    def test_outputs_go_to_folders_below_the_output_folder(self):
        self.recipe(RECIPE.replace('write = "rock.png"', 'write = "pictures/苔.png"'))
        self.go()
        self.assertTrue((self.folder / "out/pictures/苔.png").exists())

    def test_set_reaches_every_kind_of_value(self):
        plan = self.go("--dry-run", "--set", "seed=9", "--set", "lava.size=[\"1m\", 1, \"100cm\"]", "--set", "joint.arc=false",
                       "--set", "out=elsewhere", "--set", "weather.open_face=1,0,0", "--set", "rock.iso=0.4")
        self.assertEqual(plan["out"], "elsewhere")


class RecipeTest(CliTest):
    def check(self, words, text, code=USAGE, name="rock.toml"):
        self.recipe(text, name)
        done = self.refuse(code, words, "check", name)
        ran = self.refuse(code, words, "run", name)
        self.assertEqual(done.err, ran.err)
        return done


class Mistakes(RecipeTest):
    """Each with file, line and column; more in battery_test, row 38."""

    def test_one_bad_value_for_each_parameter_of_the_schema(self):
        stages = run("schema").json()["stages"]
        self.write("days.csv", spring_weather())
        for stage, described in stages.items():
            lines, wanted = [], []
            for name, p in described["properties"].items():
                if name in ("stage", "from", "write", "seed"):
                    continue
                if "enum" in p:
                    bad = '"nonsense"'
                elif "exclusiveMinimum" in p or "minimum" in p:
                    bad = repr(p.get("exclusiveMinimum", p.get("minimum")) - 1)
                    if p["type"] == "array":
                        bad = f"[{bad}, 1, 1]"
                else:
                    bad = "{ a = 1 }"
                lines.append(f"{name} = {bad}")
                wanted.append(name)
            if not lines:
                continue
            text = f"sekitei = 1\n{tables_before(stage)}" + "\n".join(lines) + "\n"
            self.recipe(text, "bad.toml")
            done = self.refuse(USAGE, [], "check", "bad.toml")
            first = text.split("\n").index(lines[0]) + 1
            for i, name in enumerate(wanted):
                self.assertRegex(done.err, rf"bad\.toml:{first + i}:\d+: {stage}.*\b{name}\b", f"{stage}.{name}: {lines[i]}")

    def test_all_mistakes_are_told_at_once_in_the_order_of_the_file(self):
        bad = (RECIPE.replace('preset = "slab"', 'preset = "slap"').replace("steps = 40", "stps = 40")
               .replace('"40cm"', '"40kg"').replace('"perpendicular"', "7").replace('from = "rock"', 'from = "rok"')
               .replace('write = "rock.png"', 'write = "rock.vdb"'))
        done = self.check(["slap", "stps", "40kg", "cut", "'rok'", "'rock'", "must end in"], bad)
        lines = [int(n) for n in re.findall(r"rock\.toml:(\d+):\d+", done.err)]
        self.assertGreaterEqual(len(lines), 6, done)
        self.assertEqual(lines, sorted(lines))

    def test_check_reads_several_recipes(self):
        self.recipe()
        self.recipe(RECIPE.replace("spacing", "spacin"), "bad.toml")
        done = self.refuse(USAGE, ["bad.toml:16:1"], "check", "rock.toml", "bad.toml")
        self.assertIn("rock.toml: good", done.err)

    def test_syntax_errors(self):
        self.check(["rock.toml:2:"], RECIPE.replace("seed = 7", "seed = = 7"))
        self.check(["rock.toml:"], RECIPE + '\n[open\n')
        self.check(["rock.toml:"], RECIPE + '\nx = "never closed\n')
        self.check(["rock.toml:"], RECIPE.encode() + b"\n# \xff\xfe\n")
        self.check(["rock.toml:"], b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR")
        self.check(["sekitei = 1"], "")

    def test_output_files(self):
        for bad, words in (('"rock.vdb"', ["already written", "'weather'"]), ('"./rock.ply"', ["already written", "'rock'"]),
                           ('"../rock.png"', ["inside the output folder"]), ('"/rock.png"', ["inside the output folder"]),
                           ('"a/../../rock.png"', ["inside the output folder"]), ('"rock.jpg"', ["rock.jpg", ".png"]),
                           ('"rock"', [".png"]), ('""', [".png"]), ('".sekitei/rock.png"', ["itself"]),
                           ('["a.png", "a.png"]', ["a.png", "already written"])):
            with self.subTest(bad=bad):
                self.check(["rock.toml:", "picture.write", *words], RECIPE.replace('write = "rock.png"', f"write = {bad}"))

    def test_names_of_stages_cannot_leave_the_folder(self):
        for name in ('"../../evil"', '"a/b"', '"/evil"', '".."', '""', '"a\\nb"', '"' + "x" * 300 + '"'):
            with self.subTest(name=name):
                self.check(["rock.toml:"], RECIPE.replace("[picture]", f"[{name}]"))
        self.assertEqual([p for p in self.folder.parent.glob("evil*")], [])

    def test_input_files_that_are_not_there(self):
        # Those of late stages too, before anything is computed.
        self.recipe('sekitei = 1\n[lava]\npreset = "mesh"\nmesh = "nowhere.ply"\n[cool]\nsteps = 9999999\n[joint]\nseeds = "none.csv"\n')
        missing = ["rock.toml:2:1", "nowhere.ply", "no such file", "rock.toml:7:1", "none.csv"]
        for command in (["check"], ["run"], ["run", "--dry-run"]):
            self.refuse(BAD_INPUT, missing, *command, "rock.toml")
        # A mistake in the recipe comes first: it may be why a file is missing.
        for command in ("check", "run"):
            self.refuse(USAGE, ["joint.spacing"], command, "rock.toml", "--set", "joint.spacing=-1")
        self.recipe('sekitei = 1\n[lava]\npreset = "slab"\nfoo = 1\n', "wrong.toml")
        self.refuse(USAGE, [*missing, "wrong.toml:4:1"], "check", "rock.toml", "wrong.toml")
        self.refuse(USAGE, [*missing, "wrong.toml:4:1"], "check", "wrong.toml", "rock.toml")
        self.write("nowhere.ply", "ply\n")
        for command in ("check", "run"):
            done = self.refuse(BAD_INPUT, ["rock.toml:7:1", "none.csv", "no such file"], command, "rock.toml")
            self.assertNotIn("nowhere.ply", done.err)

    def test_a_recipe_that_is_no_file(self):
        self.refuse(USAGE, ["nowhere.toml", "no such file"], "run", "nowhere.toml")
        self.refuse(USAGE, [str(self.folder), "folder"], "run", self.folder)
        os.mkfifo(self.folder / "pipe.toml")
        self.refuse(USAGE, ["pipe.toml"], "run", "pipe.toml")

    def test_bad_overrides_are_named(self):
        self.recipe()
        for override, words in (("joint.spacing=-3", ["--set joint.spacing=-3", "> 0"]),
                                ("joint.spacin=3", ["--set joint.spacin=3", "spacing"]),
                                ("jont.spacing=3", ["--set jont.spacing=3", "joint"]), ("spacing", ["--set spacing", "key=value"]),
                                ("=3", ["--set =3"]), ("seed=x", ["--set seed=x", "integer"]), ("cool.steps=", ["steps"]),
                                ("joint.spacing=1\n[evil]", ["--set"])):
            with self.subTest(override=override):
                self.refuse(USAGE, words, "run", "rock.toml", "--set", override)
                self.refuse(USAGE, words, "check", "rock.toml", "--set", override)
        self.refuse(USAGE, ["--seed", "seven"], "run", "rock.toml", "--seed", "seven")

    def test_parameter_files_have_places_too(self):
        self.write("p.toml", 'preset = "slab"\nvoxl = 3\nvoxel = "-4cm"\n')
        done = self.refuse(USAGE, ["p.toml:2:1", "voxl", "'voxel'", "p.toml:3:"], "lava", "--params", "p.toml", "-o", "x.vdb")
        self.assertNotIn("p.toml:1", done.err)


class Replay(SceneTest):
    def test_the_printed_recipe_makes_the_same_file(self):
        for path in (self.lava, self.cooled, self.joints, self.weathered):
            with self.subTest(file=path.name):
                text = self.succeed("replay", path).out
                self.write("again.toml", text)
                self.succeed("run", "again.toml", "--set", f"out=again-{path.stem}", "-q")
                self.assertSameBytes(self.folder / f"again-{path.stem}" / path.name, path, path.name)

    def test_every_value_can_be_written_out(self):
        text = self.succeed("replay", self.weathered, "--full").out
        schema = run("schema").json()["stages"]
        for stage in ("lava", "cool", "joint", "weather"):
            for name, p in schema[stage]["properties"].items():
                if "default" in p and p["default"] not in (None, ""):
                    self.assertRegex(text.decode(), rf"(?m)^{name} = ", f"{stage}.{name}")
        self.write("again.toml", text)
        self.succeed("run", "again.toml", "--set", "out=again", "-q")
        self.assertSameBytes(self.folder / "again/weathered.vdb", self.weathered)

    def test_files_read_by_a_stage_are_found_again(self):
        self.write("seeds.csv", "# x,y,z\n0.4,0.4,1.5\n1.2,0.4,1.5\n0.8,1.2,1.5\n")
        self.succeed("joint", self.cooled, "--seeds", "seeds.csv", "-o", "joints.vdb")
        self.write("again.toml", self.succeed("replay", "joints.vdb").out)
        self.succeed("run", "again.toml", "--set", "out=again", "-q")
        self.assertSameBytes(self.folder / "again/joints.vdb", self.folder / "joints.vdb")

    def test_a_stage_twice(self):
        self.succeed("joint", self.joints, "--spacing", "30cm", "--seed", 3, "-o", "twice.vdb")
        self.write("again.toml", self.succeed("replay", "twice.vdb").out)
        self.succeed("run", "again.toml", "--set", "out=again", "-q")
        self.assertSameBytes(self.folder / "again/twice.vdb", self.folder / "twice.vdb")

    def test_a_file_without_history_cannot_be_replayed(self):
        import foreign
        foreign.sphere(self.folder / "foreign.vdb")
        self.refuse(BAD_INPUT, ["foreign.vdb", "history"], "replay", "foreign.vdb")


class Inspecting(SceneTest):
    def test_info_tells_grids_units_and_history(self):
        info = self.succeed("info", self.weathered, "--json").json()[0]
        grids = {g["name"]: g for g in info["grids"]}
        for name in ("region", "temperature", "temperature_gradient", "centre_lines", "column", "component", "weathering", "density"):
            self.assertIn(name, grids)
            self.assertTrue(grids[name]["hash"], name)
        self.assertEqual(grids["temperature"]["unit"], "K")
        self.assertEqual(grids["temperature"]["stage"], "cool")
        self.assertAlmostEqual(grids["temperature"]["voxel_m"], 0.16)
        self.assertAlmostEqual(grids["column"]["voxel_m"], 0.04)
        self.assertTrue(grids["centre_lines"]["points"])
        self.assertEqual(info["domain"]["dims"], [40, 40, 40])
        self.assertEqual([h["stage"] for h in info["history"]], ["lava", "cool", "joint", "weather"])
        self.assertEqual({h["seed"] for h in info["history"]}, {7})
        self.assertEqual(info["history"][2]["params"]["spacing"], 0.4)
        text = self.succeed("info", self.weathered).out.decode()
        for word in ("density", "fog", "temperature", "K", "40 x 40 x 40", "history", "spacing=0.4", "joint (version"):
            self.assertIn(word, text)

    def test_info_of_a_mesh(self):
        mesh = self.succeed("info", self.mesh, "--json").json()[0]
        self.assertTrue(mesh["closed"])
        self.assertGreater(mesh["volume_m3"], 0)
        self.assertLess(mesh["volume_m3"], 1.7**3)
        self.assertIn("triangles", self.succeed("info", self.mesh).out.decode())

    def test_info_of_several_files_and_of_missing_ones(self):
        self.assertEqual(len(self.succeed("info", self.lava, self.mesh, "--json").json()), 2)
        self.refuse(BAD_INPUT, ["nowhere.vdb", "no such file"], "info", "nowhere.vdb")
        self.refuse(BAD_INPUT, ["nowhere.ply", "no such file"], "info", "nowhere.ply")

    def test_diff_tells_same_from_different(self):
        shutil.copy(self.joints, self.folder / "copy.vdb")
        self.assertEqual(self.succeed("diff", self.joints, "copy.vdb").out, b"")
        self.succeed("joint", self.cooled, "--spacing", "30cm", "--seed", 7, "-o", "other.vdb")
        done = self.run_in_folder("diff", self.joints, "other.vdb")
        self.assertEqual(done.code, DIFFER, done)
        self.assertIn("column", done.out.decode())
        self.assertIn("centre_lines", done.out.decode())
        self.assertNotIn("temperature", done.out.decode())
        found = self.run_in_folder("diff", self.joints, "other.vdb", "--json")
        self.assertEqual(found.code, DIFFER)
        self.assertTrue(found.json()["differences"])
        self.assertEqual(self.run_in_folder("diff", self.cooled, self.joints).code, DIFFER)

    def test_diff_takes_a_tolerance(self):
        self.succeed("cool", self.lava, "--steps", 41, "-o", "longer.vdb")
        self.assertEqual(self.run_in_folder("diff", self.cooled, "longer.vdb").code, DIFFER)
        self.succeed("diff", self.cooled, "longer.vdb", "--tolerance", "1e6")
        self.refuse(USAGE, ["--tolerance", ">= 0"], "diff", self.cooled, "longer.vdb", "--tolerance", "-1")

    def test_diff_compares_meshes(self):
        shutil.copy(self.mesh, self.folder / "copy.ply")
        self.succeed("diff", self.mesh, "copy.ply")
        self.succeed("mesh", self.weathered, "--iso", "0.3", "-o", "other.ply")
        self.assertEqual(self.run_in_folder("diff", self.mesh, "other.ply").code, DIFFER)
        self.refuse(USAGE, ["two scenes", "two meshes"], "diff", self.mesh, self.lava)

    def test_verify_finds_every_flipped_byte(self):
        good = self.cooled.read_bytes()
        self.succeed("verify", self.cooled)
        # Spread over the whole file: header, metadata, topology, values.
        for i in range(60):
            at = 8 + (len(good) - 9) * i // 59
            bad = bytearray(good)
            bad[at] ^= 1 << (i % 8)
            self.write("bad.vdb", bytes(bad))
            done = run("verify", "bad.vdb", cwd=self.folder, timeout=10)
            self.assertEqual(done.code, DIFFER, f"byte {at} of {len(good)}\n{done}")
            self.assertIn("bad.vdb", done.err)

    def test_verify_names_the_damaged_grid(self):
        report = self.succeed("verify", self.joints, self.weathered, "--json").json()
        self.assertEqual(len(report), 2)
        self.assertIn("column", report[0]["good"])
        self.refuse(BAD_INPUT, ["nowhere.vdb"], "verify", "nowhere.vdb")
        self.write("no.json", "[]")
        self.refuse(BAD_INPUT, ["no.json", "manifest"], "verify", "no.json")
        self.write("no.json", '{"outputs": [{"path": "../../etc/passwd", "hash": 3}]}')
        done = self.run_in_folder("verify", "no.json")
        self.assertIn(done.code, (BAD_INPUT, DIFFER), done)


if __name__ == "__main__":
    unittest.main()
