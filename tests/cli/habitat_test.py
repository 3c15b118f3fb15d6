"""From a stone lantern and a season's weather to moss: by hand, by recipe, in other programs, and with bad input."""

import json
import math
import re
import shutil
import signal
import struct
import subprocess
import tempfile
import unittest
from pathlib import Path

import foreign
from foreign import pyopenvdb
from support import (BAD_INPUT, DATA, INTERRUPTED, LIMIT, TERMINATED, USAGE, CliTest, bash, files_in, run, spring_weather, start, stop,
                     temporaries, wait_for)

# A lantern of some 770 cells: every stage takes a fraction of a second.
LANTERN = ["--layout", "pond", "--cell", "5cm"]
LIGHT = ["--weather", "days.csv"]
WIND = ["--garden-spacing", "1m", "--object-spacing", "20cm", "--settle", "0", "--duration", "0.5"]
PICTURE = ["--width", "64", "--height", "48", "--samples", "2", "--bounces", "1"]

RECIPE = """\
sekitei = 1
seed = 1
out = "out"

[lantern]
layout = "pond"
cell = "5cm"

[light]
weather = "days.csv"

[wind]
garden_spacing = "1m"
object_spacing = "20cm"
settle = 0
duration = 0.5

[soil]
write = "soil.vdb"

[moss]
every = "30d"
write = "moss.vdb"

[numbers]
stage = "statistics"
write = "moss.csv"

[curves]
stage = "plot"
from = "moss"
width = 300
height = 200
write = "cover.png"

[plants]
stage = "export"
from = "moss"
write = "moss.ply"
"""

UNITS = {"surface_sdf": "m", "surf_area": "m^2", "light_S": "W/m^2", "light_direct": "W/m^2", "light_sky": "W/m^2",
         "light_reflected": "W/m^2", "soil_h": "mm", "soil_water": "mm", "soil_Ts": "K", "soil_E": "mm/day", "soil_runoff": "mm/day"}
PLAIN = ["surf_normal", "sky_view", "rain_exposure", "geology", "soil_theta", "soil_beta", "soil_rh", "moss_species", "moss_growth",
         "moss_growth_max", "moss_age", "moss_cover", "seed_kind", "seed_species", "seed_age", "suit_bryum", "suit_hypnum",
         "suit_polytrichum", *(f"wind_ratio_{k}" for k in range(8))]
POINTS = ["air_tables", "daylight", "moss", "statistics", "weather"]


def make_habitat(folder, common=()):
    """The chain by hand, file by file."""
    (folder / "days.csv").write_text(spring_weather())
    for command, source, target, options in (("lantern", None, "lantern.vdb", LANTERN), ("light", "lantern.vdb", "light.vdb", LIGHT),
                                             ("wind", "light.vdb", "wind.vdb", WIND), ("soil", "wind.vdb", "soil.vdb", []),
                                             ("moss", "soil.vdb", "moss.vdb", ["--every", "30d"])):
        done = run(command, *([source] if source else []), "-o", target, "-q", *options, *common, cwd=folder)
        if done.code != 0:
            raise AssertionError(f"sekitei {command}: {done}")


class HabitatTest(CliTest):
    """A test with the scenes of a habitat, made once for all its methods."""

    @classmethod
    def setUpClass(cls):
        cls.scenes = Path(tempfile.mkdtemp(prefix="sekitei-habitat-"))
        cls.addClassCleanup(shutil.rmtree, cls.scenes, ignore_errors=True)
        make_habitat(cls.scenes)
        cls.lantern, cls.light, cls.wind, cls.soil, cls.moss = (
            cls.scenes / f"{name}.vdb" for name in ("lantern", "light", "wind", "soil", "moss"))

    def setUp(self):
        super().setUp()
        self.write("days.csv", spring_weather())

    def info(self, path):
        return self.succeed("info", path, "--json").json()[0]

    def states(self, *arguments):
        done = self.succeed("run", "habitat.toml", "--json", *arguments)
        return {stage["name"]: stage["state"] for stage in done.json()["stages"]}


class ByHand(HabitatTest):
    def test_grids_have_units_metadata_and_history(self):
        told = self.info(self.moss)
        grids = {g["name"]: g for g in told["grids"]}
        for name, unit in UNITS.items():
            self.assertEqual(grids[name]["unit"], unit, name)
        cells = grids["surf_area"]["active_voxels"]
        for name in [*UNITS, *PLAIN]:
            self.assertIn(name, grids)
            self.assertEqual(grids[name]["class"], "level set" if name == "surface_sdf" else "unknown", name)
            self.assertAlmostEqual(grids[name]["voxel_m"], 0.05, msg=name)
            if name != "surface_sdf":
                self.assertEqual(grids[name]["active_voxels"], cells, f"{name} is active exactly on the cells")
        for name in POINTS:
            self.assertIn(name, grids)
        self.assertEqual([h["stage"] for h in told["history"]], ["lantern", "light", "wind", "soil", "moss"])
        self.assertTrue(told["history"][1]["inputs"]["days.csv"], "the weather's content is on record")
        self.succeed("verify", self.moss)

    def test_moss_grows_here_and_less_where_it_is_too_bright(self):
        rows = self.table(self.moss)
        last = {r["species"]: r for r in rows if r["day"] == "70"}
        self.assertEqual(sorted(last), ["bryum", "hypnum", "polytrichum"])
        self.assertGreater(int(last["bryum"]["living"]), 0)
        for r in rows:
            self.assertLess(abs(float(r["balance_error"])), 1e-9)
        self.assertEqual(len(rows), 70 * 3)

    def table(self, scene):
        text = self.succeed("statistics", scene, "-o", "-").out.decode()
        names = [re.sub(r" \[.*", "", n) for n in text.split("\n")[0].split(",")]
        return [dict(zip(names, line.split(","))) for line in text.strip().split("\n")[1:]]

    def test_pipes_give_the_same_bytes_as_files(self):
        done = bash('set -euo pipefail\n"$SEKITEI" lantern --layout pond --cell 5cm -o - | "$SEKITEI" light - --weather days.csv -o - '
                    f'| "$SEKITEI" wind - {" ".join(WIND)} -o - | "$SEKITEI" soil - -o - | "$SEKITEI" moss - --every 30d -o moss.vdb\n'
                    '"$SEKITEI" statistics moss.vdb -o - | head -1\n"$SEKITEI" export - -o - < moss.vdb > a.ply\n'
                    '"$SEKITEI" export moss.vdb -o b.ply\ncmp a.ply b.ply', self.folder)
        self.assertEqual(done.code, 0, done)
        self.assertSameBytes(self.folder / "moss.vdb", self.moss, "pipes")
        self.assertIn("cover [m^2]", done.out.decode())

    def test_every_writes_a_numbered_sequence(self):
        names = sorted(p.name for p in self.scenes.glob("moss.*.vdb"))
        self.assertEqual(names, ["moss.0030.vdb", "moss.0060.vdb", "moss.0070.vdb"])
        self.assertSameBytes(self.scenes / "moss.0070.vdb", self.moss, "the last of the sequence is the result")
        self.assertEqual([len(self.table(self.scenes / n)) for n in names], [30 * 3, 60 * 3, 70 * 3])
        self.succeed("moss", self.soil, "--days", "30", "-o", "short.vdb")
        for name in ("moss_growth", "soil_Ts"):
            a, b = (pyopenvdb.read(str(p), name) for p in (self.folder / "short.vdb", self.scenes / "moss.0030.vdb"))
            self.assertEqual([v.value for v in a.citerOnValues()], [v.value for v in b.citerOnValues()], name)

    def test_a_sequence_replaces_nothing_unasked(self):
        self.write("m.0060.vdb", "mine")
        self.refuse(USAGE, ["m.0060.vdb", "--force"], "moss", self.soil, "--every", "30d", "-o", "m.vdb")
        self.refuse(USAGE, ["--every", "-o"], "moss", self.soil, "--every", "30d", "-o", "-")
        self.refuse(USAGE, ["every"], "moss", self.soil, "--every", "1.5d", "-o", "n.vdb")
        self.refuse(USAGE, ["every"], "moss", self.soil, "--every", "-1", "-o", "n.vdb")
        self.succeed("moss", self.soil, "--every", "30d", "-o", "m.vdb", "--force")
        self.assertSameBytes(self.folder / "m.0060.vdb", self.scenes / "moss.0060.vdb", "the sequence")

    def test_replay_makes_the_same_file_again(self):
        recipe = self.succeed("replay", self.moss).out
        self.write("again.toml", recipe)
        self.succeed("run", "again.toml", "-q", "--set", "out=again")
        made = next((self.folder / "again").glob("moss.vdb"))
        self.assertSameBytes(made, self.moss, "replay")
        self.succeed("diff", made, self.moss)

    def test_explain_multiplies_its_factors(self):
        told = self.succeed("explain", self.moss, "--at", "0,20cm,0.3", "--json").json()
        self.assertAlmostEqual(told["light_S"], told["light_direct"] + told["light_sky"] + told["light_reflected"], delta=1e-3)
        self.assertEqual([s["name"] for s in told["species"]], ["bryum", "hypnum", "polytrichum"])
        for s in told["species"]:
            factors = {k: s[k] for k in ("temperature", "humidity", "light", "gate")}
            self.assertAlmostEqual(s["G"], math.prod(factors.values()), places=9)
            self.assertEqual(s["limiting"], min(factors, key=factors.get))
        words = self.succeed("explain", self.moss, "--at", "0,20cm,0.3").out.decode()
        for word in ("light S", "T_s", "rh_s", "wind", "limits", "W/m2", "mm/day", "NW"):
            self.assertIn(word, words)

    def test_pictures_and_comparisons(self):
        self.succeed("plot", self.moss, "--columns", "cover", "-o", "cover.png")
        self.succeed("render", self.moss, "-o", "plants.png", *PICTURE)
        self.succeed("render", self.moss, "--no-moss", "-o", "bare.png", *PICTURE)
        self.assertNotEqual((self.folder / "plants.png").read_bytes(), (self.folder / "bare.png").read_bytes())
        self.succeed("render", self.moss, "--field", "soil_humidity", "-o", "field.png", "--width", "300", *PICTURE[2:])
        self.assertEqual(struct.unpack(">II", (self.folder / "field.png").read_bytes()[16:24]), (300, 48))
        shutil.copy(self.moss, self.folder / "nothing.vdb")
        shutil.copy(self.moss, self.folder / "pond.vdb")
        done = self.succeed("compare", "nothing.vdb", "pond.vdb", "-o", "table.csv")
        self.assertIn("pond", (self.folder / "table.csv").read_text() + done.err)

    def test_threads_change_nothing(self):
        one, two = self.folder / "one", self.folder / "two"
        for folder, threads in ((one, "1"), (two, "2")):
            folder.mkdir()
            make_habitat(folder, ["--threads", threads])
        self.assertSameFiles(files_in(one), files_in(two), "1 and 2 threads")
        self.assertSameBytes(one / "moss.vdb", self.moss, "as always")

    def test_the_seed_and_the_weather_matter(self):
        for name, options in (("seed", ["--seed", "2"]), ("clock", ["--growth-rate", "0.5"])):
            self.succeed("moss", self.soil, "--every", "30d", "-o", f"{name}.vdb", *options)
            self.assertEqual(self.run_in_folder("diff", f"{name}.vdb", self.moss).code, 6, name)

    def test_no_light_no_water_or_no_warmth_gives_no_moss(self):
        def living(weather):
            self.write("other.csv", weather)
            self.succeed("light", self.lantern, "--weather", "other.csv", "-o", "l.vdb", "--force")
            self.succeed("moss", "l.vdb", "-o", "m.vdb", "--force")
            return sum(int(r["living"]) for r in self.table("m.vdb") if r["day"] == "70")

        self.assertGreater(living(spring_weather()), 0, "the good twin")
        rows = spring_weather().split("\n")

        def changed(column, value):
            out = []
            for line in rows:
                cells = line.split(",")
                if line[:1].isdigit():
                    cells[column] = value
                out.append(",".join(cells))
            return "\n".join(out)

        self.assertEqual(living(changed(1, "-25")), 0, "frost")
        dry = [",".join([*line.split(",")[:2], "20", "0", *line.split(",")[4:]]) if line[:1].isdigit() else line for line in rows]
        self.assertEqual(living("\n".join(dry)), 0, "drought")
        night = [line.replace("latitude = 40", "latitude = -85") for line in rows]
        night = [",".join([*line.split(",")[:6], "0"]) if line[:1].isdigit() else line for line in night]
        self.assertEqual(living("\n".join(night)), 0, "polar night")


class ByRecipe(HabitatTest):
    def setUp(self):
        super().setUp()
        self.recipe(RECIPE, "habitat.toml")

    def test_a_recipe_makes_what_the_commands_make_and_only_once(self):
        first = self.states()
        self.assertEqual(set(first.values()), {"run"})
        out = self.folder / "out"
        for name in ("soil.vdb", "moss.vdb", "moss.0030.vdb", "moss.0060.vdb", "moss.0070.vdb"):
            self.assertSameBytes(out / name, self.scenes / name, f"recipe and commands: {name}")
        for command, name, options in (("statistics", "moss.csv", []), ("plot", "cover.png", ["--width", "300", "--height", "200"]),
                                       ("export", "moss.ply", [])):
            self.succeed(command, self.moss, *options, "-o", name)
            self.assertSameBytes(out / name, self.folder / name, command)
        manifest = json.loads((out / "manifest.json").read_text())
        self.assertEqual({o["path"] for o in manifest["outputs"]}, {n for n in files_in(out) if n != "manifest.json"})
        self.succeed("verify", out / "manifest.json")

        before = files_in(out)
        times = {p: p.stat().st_mtime_ns for p in out.glob("*.vdb")}
        self.assertEqual(set(self.states().values()), {"cached"})
        self.assertEqual(times, {p: p.stat().st_mtime_ns for p in out.glob("*.vdb")}, "nothing is written twice")
        self.assertSameFiles(files_in(out), before)

        (out / "moss.0030.vdb").unlink()
        again = self.states()
        self.assertEqual({n for n, s in again.items() if s == "run"}, {"moss"}, "a scene of the sequence was missing")
        self.assertSameFiles(files_in(out), before)

        changed = self.states("--set", "moss.growth_rate=0.5")
        self.assertEqual({n for n, s in changed.items() if s == "run"}, {"moss", "numbers", "curves", "plants"})
        self.states()
        days = (self.folder / "days.csv")
        days.write_text(days.read_text().replace("2021-05-03,15.0", "2021-05-03,16.0"))
        warmer = self.states()
        self.assertEqual({n: warmer[n] for n in ("lantern", "light", "soil", "moss", "numbers")},
                         {"lantern": "cached", "light": "run", "soil": "run", "moss": "run", "numbers": "run"})
        self.assertEqual(warmer["wind"], "cached", "the wind depends on the surface, not on the weather")

    def test_a_plan_says_how_large_each_stage_is(self):
        cells = self.info(self.moss)["grids"]
        cells = next(g["active_voxels"] for g in cells if g["name"] == "surf_area")
        for made in (False, True):
            if made:
                self.succeed("run", "habitat.toml", "-q")
            plan = self.succeed("run", "habitat.toml", "--dry-run", "--json").json()["stages"]
            for stage in plan:
                if stage["name"] in ("light", "wind", "soil", "moss"):
                    self.assertTrue(cells / 5 < stage["voxels"] < cells * 5, stage)
                self.assertTrue(1e5 < stage["memory"] < 2e9, stage)
                self.assertEqual(stage["state"], "cached" if made else "run")
            if not made:
                self.assertFalse((self.folder / "out").exists())

    def interrupted(self, stage, text, clean, signals=(signal.SIGINT, signal.SIGTERM)):
        """Stops a run while `stage` works, runs it to the end, and compares with a clean run."""
        self.recipe(text, "habitat.toml")
        cache = self.folder / "out" / ".sekitei"
        kept = []
        for which in signals:
            shutil.rmtree(self.folder / "out", ignore_errors=True)
            process = start(["run", "habitat.toml", "-q"], cwd=self.folder)
            self.assertTrue(wait_for(lambda: list(cache.glob(f"{stage}-*.checkpoint")), 60), f"{stage} never wrote a checkpoint")
            code, seconds, err = stop(process, which)
            self.assertEqual(code, {signal.SIGINT: INTERRUPTED, signal.SIGTERM: TERMINATED}[which], err)
            self.assertLess(seconds, 2, err)
            self.assertEqual(temporaries(self.folder / "out"), [])
            kept = list(cache.glob(f"{stage}-*.checkpoint"))
            self.assertTrue(kept)
            again = self.succeed("run", "habitat.toml", "-v")
            self.assertIn("going on", again.err)
            self.assertSameFiles(files_in(self.folder / "out"), clean, f"{stage} after signal {which}")
            self.assertEqual(list(cache.glob("*.checkpoint")), [])
        return kept[0].name

    def test_moss_goes_on_after_an_interruption_and_refuses_a_damaged_checkpoint(self):
        text = RECIPE.replace('weather = "days.csv"', 'weather = "days.csv"\ndays = "4000d"\nrepeat_year = true').replace(
            'every = "30d"', 'every = "500d"')
        self.write("days.csv", spring_weather(365))
        self.recipe(text, "habitat.toml")
        self.succeed("run", "habitat.toml", "-q")
        clean = files_in(self.folder / "out")
        name = self.interrupted("moss", text, clean)
        shutil.rmtree(self.folder / "out" / ".sekitei")
        self.write(f"out/.sekitei/{name}", b"not a checkpoint")
        done = self.run_in_folder("run", "habitat.toml", "--force")
        self.assertEqual(done.code, BAD_INPUT, done)
        self.assertIn(name, done.err)

    def test_wind_goes_on_after_an_interruption(self):
        text = RECIPE.replace("settle = 0", "settle = 20").replace("duration = 0.5", "duration = 60")
        self.recipe(text, "habitat.toml")
        self.succeed("run", "habitat.toml", "-q", "--set", "out=good")
        self.interrupted("wind", text, files_in(self.folder / "good"))

    def test_light_stops_at_once(self):
        # Hundreds of rays for each of some 20,000 cells.
        self.succeed("lantern", "--cell", "1cm", "-o", "fine.vdb")
        for which, code in ((signal.SIGINT, INTERRUPTED), (signal.SIGTERM, TERMINATED)):
            process = start(["light", "fine.vdb", "--weather", "days.csv", "--sky", "reinhart", "--sky-split", "8", "-o", "x.vdb"],
                            cwd=self.folder)
            self.assertFalse(wait_for(lambda: process.poll() is not None, 1.5), "it should still be at work")
            got, seconds, err = stop(process, which)
            self.assertEqual(got, code, err)
            self.assertLess(seconds, 2, err)
            self.assertEqual(sorted(p.name for p in self.folder.glob("*x.vdb*")), [])


class InOtherPrograms(HabitatTest):
    def test_openvdb_reads_every_grid_by_name(self):
        for g in self.info(self.moss)["grids"]:
            if g["type"] not in ("float", "vec3s"):
                continue
            with self.subTest(grid=g["name"]):
                grid = pyopenvdb.read(str(self.moss), g["name"])
                self.assertEqual(grid.activeVoxelCount(), g["active_voxels"])
                self.assertEqual(grid.metadata.get("sekitei:unit", ""), g["unit"])
                self.assertTrue(grid["sekitei:hash"])
                if g["type"] == "float" and g["name"] != "surface_sdf":
                    low, high = grid.evalMinMax()
                    self.assertTrue(math.isfinite(low) and math.isfinite(high), g["name"])
        humidity = pyopenvdb.read(str(self.moss), "soil_rh")
        self.assertTrue(all(0 < v.value <= 1 for v in humidity.citerOnValues()))
        direct, sky, reflected, total = ({v.min: v.value for v in pyopenvdb.read(str(self.moss), f"light_{n}").citerOnValues()}
                                         for n in ("direct", "sky", "reflected", "S"))
        for at, value in total.items():
            self.assertAlmostEqual(value, direct[at] + sky[at] + reflected[at], places=3)

    def test_vdb_print_lists_grids_and_points(self):
        done = subprocess.run(["vdb_print", "-l", str(self.moss)], capture_output=True, text=True, timeout=30)
        self.assertEqual(done.returncode, 0, done.stderr)
        for name in [*UNITS, *PLAIN, *POINTS]:
            self.assertIn(name, done.stdout)

    def moss_points(self):
        self.succeed("export", self.moss, "-o", "moss.ply", "--force")
        return (self.folder / "moss.ply").read_bytes()

    def test_exported_points_are_plain_ply_on_the_surface(self):
        content = self.moss_points()
        head, body = content.split(b"end_header\n", 1)
        properties = [line.split()[1:] for line in head.decode().split("\n") if line.startswith("property")]
        form = "<" + "".join({"float": "f", "double": "d", "int": "i"}[kind] for kind, _ in properties)
        names = [name for _, name in properties]
        for name in ("x", "nx", "orient_w", "pscale", "species", "age", "id", "growth"):
            self.assertIn(name, names)
        rows = [dict(zip(names, r)) for r in struct.iter_unpack(form, body)]
        self.assertIn(f"element vertex {len(rows)}\n", head.decode())
        living = pyopenvdb.read(str(self.moss), "moss_growth")
        self.assertTrue(0 < len(rows) <= living.activeVoxelCount())
        sdf = pyopenvdb.read(str(self.moss), "surface_sdf").getConstAccessor()
        for r in rows:
            self.assertAlmostEqual(sum(r[f"orient_{c}"] ** 2 for c in "xyzw"), 1, places=4)
            self.assertAlmostEqual(r["nx"] ** 2 + r["ny"] ** 2 + r["nz"] ** 2, 1, places=4)
            self.assertTrue(0 <= r["pscale"] <= 1)
            at = living.transform.worldToIndex((r["x"], r["y"], r["z"]))
            self.assertLess(abs(sdf.getValue(tuple(math.floor(c + 0.5) for c in at))), 0.1, "roots stand on the surface")


HEAD = "# latitude = 40 deg\n# longitude = 141 deg\ndate,temperature [C],humidity [%],precipitation [mm],wind_speed [m/s],sunshine [h]\n"


class Unread(HabitatTest):
    def test_what_nothing_reads_is_told(self):
        for words, options in ((["fence_height", "without a fence"], ["lantern", "--fence-height", "1m"]),
                               (["pond_width", "without a pond"], ["lantern", "--layout", "fence", "--pond-width", "1m"]),
                               (["canopy_drag", "trees"], ["lantern", "--canopy-drag", "1"]),
                               (["repeat_year", "without days"], ["light", self.lantern, *LIGHT, "--repeat-year"]),
                               (["links", "bounces = 0"], ["light", self.lantern, *LIGHT, "--bounces", "0", "--links", "4"]),
                               (["settling_speed", "spore_wind"], ["moss", self.soil, "--settling-speed", "0.1"]),
                               (["light_compensation", "light_gate"], ["moss", self.soil, "--no-light-gate", "--light-compensation", "3"])):
            coarse = ["--cell", "5cm"] if options[0] == "lantern" else []
            done = self.succeed(*options, *coarse, "-o", "x.vdb", "--force")
            for word in ("warning:", *words):
                self.assertIn(word, done.err)
        for quiet in (["lantern", "--layout", "fence", "--fence-height", "1m", "--cell", "5cm"],
                      ["moss", self.soil, "--spore-wind", "--settling-speed", "0.1"]):
            self.assertNotIn("warning:", self.succeed(*quiet, "-o", "x.vdb", "--force").err)


class BadWeather(HabitatTest):

    def test_the_place_may_be_given_in_part(self):
        for options in ([], ["--longitude", "141"], ["--latitude", "40"]):
            self.succeed("light", self.lantern, *LIGHT, "--days", "3", *options, "-o", "x.vdb", "--force")
            grid = pyopenvdb.read(str(self.folder / "x.vdb"), "light_S")
            values = [v.value for v in grid.citerOnValues()]
            good = values if not options else good
            self.assertEqual(values, good, options)
        self.succeed("light", self.lantern, *LIGHT, "--days", "3", "--longitude", "-60", "-o", "x.vdb", "--force")

    def test_polar_night_is_dark_and_legal(self):
        dark = HEAD.replace("latitude = 40", "latitude = 85") + "".join(f"2023-12-{d},-20,70,0,2,0\n" for d in range(10, 20))
        self.write("dark.csv", dark)
        self.succeed("light", self.lantern, "--weather", "dark.csv", "-o", "dark.vdb")
        low, high = pyopenvdb.read(str(self.folder / "dark.vdb"), "light_S").evalMinMax()
        self.assertEqual((low, high), (0, 0))
        self.succeed("moss", "dark.vdb", "-o", "cold.vdb")


class BadScenes(HabitatTest):
    def test_a_stage_without_its_input_names_the_stage_to_run(self):
        lantern, light = self.lantern, self.light
        for command, scene, target, words in (
                ("wind", lantern, "x.vdb", ["surf_", "surface_sdf", "`sekitei light`"]),
                ("soil", lantern, "x.vdb", ["`sekitei light`"]), ("moss", lantern, "x.vdb", ["`sekitei light`"]),
                ("statistics", light, "x.csv", ["statistics", "`sekitei soil` or `sekitei moss`"]),
                ("plot", light, "x.png", ["statistics", "`sekitei soil` or `sekitei moss`"]),
                ("export", light, "x.ply", ["moss", "`sekitei moss`"])):
            with self.subTest(command=command):
                self.refuse(BAD_INPUT, [scene.name, *words], command, scene, "-o", target)
        self.refuse(BAD_INPUT, ["lantern.vdb", "surf_", "`sekitei light`"], "explain", lantern, "--at", "0,0,1")
        self.refuse(USAGE, ["--at", "x,y,z"], "explain", self.moss, "--at", "0,1")
        self.refuse(USAGE, ["--at", "north"], "explain", self.moss, "--at", "0,north,1")
        self.refuse(USAGE, ["two scenes"], "compare", self.moss, "-o", "x.csv")
        self.refuse(BAD_INPUT, ["light.vdb", "statistics"], "compare", self.moss, light, "-o", "x.csv")
        self.refuse(BAD_INPUT, ["mos", "moss"], "export", self.moss, "--points", "mos", "-o", "x.ply")

    def test_names_that_do_not_exist_get_the_nearest(self):
        self.refuse(USAGE, ["brium", "bryum"], "moss", self.soil, "--species", "brium", "-o", "x.vdb")
        self.refuse(USAGE, ["none", "species"], "moss", self.soil, "--species", ",", "-o", "x.vdb")
        self.refuse(USAGE, ["bryum", "two species"], "moss", self.soil, "--species", "bryum,bryum", "-o", "x.vdb")
        self.refuse(USAGE, ["humsu", "humus"], "soil", self.wind, "--soil", "humsu", "-o", "x.vdb")
        self.refuse(USAGE, ["covr", "cover"], "plot", self.moss, "--columns", "covr", "-o", "x.png")
        self.refuse(USAGE, ["mpss", "mps"], "wind", self.light, "--solver", "mpss", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["soil_humidty", "soil_humidity"], "render", self.moss, "--field", "soil_humidty", "-o", "x.png", *PICTURE)
        self.refuse(BAD_INPUT, ["body", "surface_sdf"], "light", self.lantern, *LIGHT, "--surface", "body", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["water_surface", "float"], "light", self.lantern, *LIGHT, "--surface", "water_surface", "-o", "x.vdb")

    def test_limits(self):
        self.refuse(LIMIT, ["light", "--memory"], "light", self.lantern, *LIGHT, "--cell", "1um", "-o", "x.vdb")
        self.refuse(LIMIT, ["--memory"], "moss", self.soil, "--memory", "10M", "-o", "x.vdb")
        self.refuse(LIMIT, ["object_spacing = 0.0002", "cells"], "wind", self.light, "--object-spacing", "0.2mm", "-o", "x.vdb")
        self.refuse(USAGE, ["depth"], "soil", self.wind, "--depth", "0", "-o", "x.vdb")
        self.refuse(USAGE, ["gemma_age_high", "gemma_age_low"], "moss", self.soil, "--gemma-age-low", "70d", "-o", "x.vdb")

    def test_surfaces_that_are_none(self):
        sphere = foreign.level_set("surface_sdf", radius=0.4, voxel=0.05)
        self.succeed("light", foreign.write(self.folder / "ball.vdb", sphere), *LIGHT, "--days", "3", "-o", "ball_light.vdb")
        self.succeed("moss", "ball_light.vdb", "-o", "ball_moss.vdb")

        empty = pyopenvdb.FloatGrid(0.15)
        empty.name, empty.gridClass = "surface_sdf", pyopenvdb.GridClass.LEVEL_SET
        empty.transform = pyopenvdb.createLinearTransform(0.05)
        self.refuse(BAD_INPUT, ["empty.vdb", "no_surface_cells"], "light", foreign.write(self.folder / "empty.vdb", empty), *LIGHT, "-o", "x.vdb")
        outside = empty.deepCopy()
        outside.fill((0, 0, 0), (5, 5, 5), 0.1)
        self.refuse(BAD_INPUT, ["outside.vdb", "no_surface_cells"], "light", foreign.write(self.folder / "outside.vdb", outside), *LIGHT,
                    "-o", "x.vdb")
        nan = sphere.deepCopy()
        nan.fill((16, 16, 23), (16, 16, 24), float("nan"))
        self.refuse(BAD_INPUT, ["nan.vdb", "surface_sdf"], "light", foreign.write(self.folder / "nan.vdb", nan), *LIGHT, "-o", "x.vdb")
        fog = foreign.fog("surface_sdf", value=0.2)
        self.refuse(BAD_INPUT, ["fog.vdb", "surface_sdf"], "light", foreign.write(self.folder / "fog.vdb", fog), *LIGHT, "-o", "x.vdb")

    def test_check_lists_all_mistakes_of_a_habitat(self):
        self.write("low.toml", "temperature_low = \"20C\"\ntemperature_high = \"10C\"\n")
        self.recipe(RECIPE.replace('layout = "pond"', 'layout = "pnd"').replace('object_spacing = "20cm"', "object_spacing = -1")
                    .replace("[soil]", '[soil]\nsoil = "humsu"\ndepth = "0mm"').replace('every = "30d"', 'every = -3\nspecies = "brium"')
                    .replace('from = "moss"\nwidth', 'from = "mos"\ncolumns = "covr"\nwidth').replace('"cover.png"', '"cover.csv"'), "bad.toml")
        done = self.refuse(USAGE, ["pnd", "object_spacing", "humsu", "humus", "depth", "every", "brium", "bryum", "'mos'", "covr", "cover.csv"],
                           "check", "bad.toml")
        text = (self.folder / "bad.toml").read_text().split("\n")
        for key in ("layout", "object_spacing", "soil", "depth", "every", "species", "columns"):
            line = next(i for i, l in enumerate(text, 1) if l.startswith(f"{key} ="))
            self.assertIn(f"bad.toml:{line}:", done.err, key)
        self.recipe(RECIPE.replace('"days.csv"', '"none.csv"').replace("[soil]", '[soil]\nsoil = "none.toml"')
                    .replace('every = "30d"', 'species = "low.toml"'), "files.toml")
        self.refuse(USAGE, ["none.csv", "none.toml", "low.toml:2:", "temperature_low"], "check", "files.toml")
        self.recipe(RECIPE.replace('"days.csv"', '"wild.csv"'), "wild.toml")
        self.write("wild.csv", HEAD + "2023-01-01,1,130,0,-1,3\n")
        for command in (["check", "wild.toml"], ["run", "wild.toml"], ["run", "wild.toml", "--dry-run"]):
            self.refuse(BAD_INPUT, ["wild.csv:4:14", "wild.csv:4:", "wind_speed"], *command)
        self.recipe(RECIPE.replace('write = "moss.vdb"\n', ""), "frames.toml")
        self.refuse(USAGE, ["every", "write"], "check", "frames.toml")
        self.recipe(RECIPE.replace("[light]\nweather = \"days.csv\"\n\n", ""), "gap.toml")
        self.refuse(USAGE, ["wind: needs 'surf_normal'", "`light`"], "check", "gap.toml")
        self.recipe(RECIPE + '[table]\nstage = "compare"\nfrom = "moss"\n', "one.toml")
        self.refuse(USAGE, ["table.from", "two stages"], "check", "one.toml")


if __name__ == "__main__":
    unittest.main()
