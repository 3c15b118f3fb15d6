"""Light and moss on meshes: files beside files, pipes, recipes, and meshes that are broken, huge or odd."""

import datetime
import re
import unittest

import foreign
from support import BAD_INPUT, LIMIT, USAGE, CliTest, bash, files_in, small_disk

LIGHT = ["--site", "10cm", "--photons", "20k"]
MOSS = ["--days", "12", "--site", "10cm", "--photons", "4k", "--open-light", "25", "--initial-count", "20", "--soil", "humus"]
PICTURE = ["--width", "64", "--height", "48", "--samples", "2", "--bounces", "1"]

RECIPE = """\
sekitei = 1
seed = 1
out = "out"

[rock]
stage = "mesh"
file = "rock.ply"

[moss]
days = 12
site = "10cm"
photons = "4k"
open_light = 25
initial_count = 20
soil = "humus"
write = ["moss.vdb", "moss.ply"]

[numbers]
stage = "statistics"
from = "moss"
write = "moss.csv"
"""


def slab(scale=1.0):
    return foreign.box((0, 0, -0.2 * scale), (0.6 * scale, 0.4 * scale, 0))


def header(content):
    return content.split(b"end_header\n")[0].decode()


def points(content):
    """How many vertices a PLY file has."""
    return int(re.search(r"element vertex (\d+)", header(content))[1])


def year(day, latitude, count=3):
    """A weather file of a few clear days from a day on."""
    lines = [f"# latitude = {latitude} deg", "# longitude = 20 deg",
             "date,temperature [C],humidity [%],precipitation [mm],wind_speed [m/s],wind_direction [deg],global [W/m^2],diffuse [W/m^2]"]
    for d in range(count):
        lines.append(f"{day + datetime.timedelta(d)},2,85,1,2,180,{0 if latitude > 80 else 120},{0 if latitude > 80 else 40}")
    return "\n".join(lines) + "\n"


def changed(options, changes):
    """Options of which some are given anew."""
    words = dict(zip(options[::2], options[1::2]))
    kept = [w for name, value in words.items() if name not in changes for w in (name, value)]
    return [*kept, *changes]


class MeshTest(CliTest):
    def setUp(self):
        super().setUp()
        self.rock = self.mesh("rock.ply", *slab())

    def mesh(self, name, vertices, faces, form="binary_little_endian"):
        return self.write(name, foreign.ply(vertices, faces, form))

    def light(self, path, *options):
        return self.succeed("light", path, *changed(LIGHT, options))

    def moss(self, path, *options):
        return self.succeed("moss", path, *changed(MOSS, options))

    def grow(self):
        self.moss("rock.ply", "-o", "moss.vdb", "-q")

    def both(self, code, words, path, *options):
        """Both commands refuse a mesh."""
        self.refuse(code, words, "light", path, "-o", "x.vdb", *changed(LIGHT, options))
        self.refuse(code, words, "moss", path, "-o", "x.vdb", *changed(MOSS, options))

    def fine(self, path, *options):
        """Both commands take it; what light says."""
        self.moss(path, "-o", "good_moss.vdb", "--force", "-q", *options)
        return self.light(path, "-o", "good.vdb", "--force", "--json", *options)

    def sites(self, done):
        return done.json()["summary"]["sites"]


class Files(MeshTest):
    def test_a_scene_and_its_mesh_lie_side_by_side(self):
        self.light("rock.ply", "-o", "light.vdb")
        info = self.succeed("info", "light.vdb", "--json").json()[0]
        grids = {g["name"]: g for g in info["grids"]}
        for name in ("light_S", "light_direct", "light_sky", "light_indirect", "sky_view", "rain_exposure", "surface_sdf", "sites"):
            self.assertIn(name, grids)
        text = header((self.folder / "light.ply").read_bytes())
        for name in ("light_S", "light_direct", "light_indirect", "sky_view"):
            self.assertIn(f"property float {name}", text)
        self.light("rock.ply", "-o", "alone.ply")
        self.assertFalse((self.folder / "alone.vdb").exists())
        self.assertSameBytes(self.folder / "alone.ply", self.folder / "light.ply")
        self.grow()
        text = header((self.folder / "moss.ply").read_bytes())
        for name in ("soil_theta", "soil_beta", "soil_Ts", "soil_rh", "soil_E", "soil_h", "soil_water", "moss_cover", "geology"):
            self.assertRegex(text, rf"property \w+ {name}\n")
        for made in ("light.vdb", "moss.vdb"):
            self.succeed("verify", made)

    def test_photons_and_mosses_as_points(self):
        done = self.light("rock.ply", "-o", "light.ply", "--debug-photons", "photons.ply", "--json")
        content = (self.folder / "photons.ply").read_bytes()
        self.assertEqual(points(content), done.json()["summary"]["stored"])
        self.assertRegex(header(content), r"property \w+ flux\n")
        self.assertRegex(header(content), r"property \w+ bounce\n")
        done = self.moss("rock.ply", "-o", "moss.ply", "--points", "plants.ply", "--json")
        living = sum(int(done.json()["summary"][s].split()[0]) for s in ("bryum", "hypnum", "polytrichum"))
        content = (self.folder / "plants.ply").read_bytes()
        self.assertEqual(points(content), living)
        self.assertGreater(living, 10)
        for name in ("species", "growth", "growth_max", "age", "id", "host", "S", "suit", "interior", "wetness", "pscale"):
            self.assertRegex(header(content), rf"property \w+ {name}\n")
        self.moss("rock.ply", "-o", "scene.vdb")
        self.succeed("export", "scene.vdb", "-o", "exported.ply")
        self.assertSameBytes(self.folder / "exported.ply", content)

    def test_what_was_kept_is_what_was_made(self):
        self.succeed("light", self.mesh("slab.ply", *slab()), "--site", "10cm", "--photons", "30k", "--keep-photons", "-o", "kept.vdb")
        self.succeed("verify", "kept.vdb")

    def test_a_scene_and_its_mesh_are_both_new_or_both_old(self):
        self.light("rock.ply", "-o", "whole.vdb")
        sizes = sorted((self.folder / name).stat().st_size for name in ("whole.vdb", "whole.ply"))
        with small_disk(self.folder / "disk", f"size={(sum(sizes) - 4096) // 4096 * 4}k") as disk:
            for name in ("x.vdb", "x.ply"):
                (disk / name).write_bytes(b"old")
            self.refuse(4, ["no space"], "light", "rock.ply", *LIGHT, "--force", "-o", disk / "x.vdb")
            self.assertEqual({p.name: p.read_bytes() for p in disk.iterdir()}, {"x.vdb": b"old", "x.ply": b"old"})

    def test_info_tells_of_points(self):
        stored = self.light("rock.ply", "-o", "light.ply", "--debug-photons", "photons.ply", "--json").json()["summary"]["stored"]
        told = self.succeed("info", "photons.ply", "--json").json()[0]
        self.assertEqual(told["points"], stored)
        self.assertEqual(told["bytes"], (self.folder / "photons.ply").stat().st_size)
        for axis, (lower, upper) in enumerate(((0, 0.6), (0, 0.4), (-0.2, 0))):
            self.assertAlmostEqual(told["bounds_m"][0][axis], lower, delta=0.05)
            self.assertAlmostEqual(told["bounds_m"][1][axis], upper, delta=0.05)
        of = {a["name"]: a for a in told["attributes"]}
        self.assertEqual(of["bounce"]["type"], "int")
        self.assertEqual(of["flux"]["type"], "float")
        self.assertGreaterEqual(of["bounce"]["min"], 0)
        self.assertGreater(of["flux"]["max"], 0)
        self.moss("rock.ply", "-o", "moss.ply", "--points", "plants.ply")
        told = self.succeed("info", "plants.ply", "--json").json()[0]
        self.assertEqual(told["points"], points((self.folder / "plants.ply").read_bytes()))
        of = {a["name"]: a for a in told["attributes"]}
        self.assertEqual((of["species"]["type"], of["id"]["type"]), ("int", "double"))
        self.assertLessEqual(of["species"]["max"], 2)
        text = self.succeed("info", "plants.ply", "moss.ply").out.decode()
        self.assertIn(f"{told['points']} points, ", text)
        self.assertRegex(text, rf"\ngrowth +float +{of['growth']['min']:.7g} +{of['growth']['max']:.7g}\n")
        self.assertIn("triangles", text)

    def test_info_tells_of_points_of_others(self):
        head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty double z\nproperty uint8 red\nproperty float32 heat\n"
        rows = "1 -2 3 255 nan\n0.5 4 -3 7 -8.5\n0 0 0 9 2\n"
        for faces in ("", "element face 0\nproperty list uchar int vertex_indices\n"):
            self.write("dots.ply", head + faces + "end_header\n" + rows)
            told = self.succeed("info", "dots.ply", "--json").json()[0]
            self.assertEqual(told["points"], 3)
            self.assertEqual(told["bounds_m"], [[0, -2, -3], [1, 4, 3]])
            self.assertEqual(told["attributes"], [{"name": "red", "type": "uchar", "min": 7, "max": 255},
                                                  {"name": "heat", "type": "float", "min": -8.5, "max": 2, "not_finite": 1}])
        self.assertRegex(self.succeed("info", "dots.ply").out.decode(), r"heat +float +-8.5 +2  1 are not finite\n")
        self.write("none.ply", head.replace("vertex 3", "vertex 0") + "end_header\n")
        told = self.succeed("info", "none.ply", "--json").json()[0]
        self.assertEqual((told["points"], told["attributes"][0]), (0, {"name": "red", "type": "uchar"}))
        self.assertNotIn("bounds_m", told)
        self.assertRegex(self.succeed("info", "none.ply").out.decode(), r"0 points\n[^0-9]*red +uchar +none +none")
        self.refuse(BAD_INPUT, ["cut.ply", "truncated"], "info", self.write("cut.ply", head + "end_header\n" + rows[:20]))

    def test_counts_take_thousands_and_millions(self):
        wanted = self.light("rock.ply", "-o", "a.ply", "--json").json()["summary"]["photons"]
        self.assertEqual(wanted, 20000)
        self.succeed("light", "rock.ply", "--site", "10cm", "--photons", "20000", "-o", "b.ply")
        self.assertSameBytes(self.folder / "a.ply", self.folder / "b.ply")
        self.refuse(USAGE, ["photons", "20m"], "light", "rock.ply", "--photons", "20m", "-o", "x.ply")
        self.refuse(USAGE, ["photons"], "light", "rock.ply", "--photons", "1.5", "-o", "x.ply")

    def test_nothing_that_is_there_is_replaced_unasked(self):
        for there, command in (("light.ply", ["light", "rock.ply", *LIGHT, "-o", "light.vdb"]),
                               ("light.vdb", ["light", "rock.ply", *LIGHT, "-o", "light.vdb"]),
                               ("p.ply", ["light", "rock.ply", *LIGHT, "-o", "light.ply", "--debug-photons", "p.ply"]),
                               ("p.ply", ["moss", "rock.ply", *MOSS, "-o", "moss.vdb", "--points", "p.ply"]),
                               ("moss.ply", ["moss", "rock.ply", *MOSS, "-o", "moss.vdb"]),
                               ("rock.ply", ["light", "rock.ply", *LIGHT, "-o", "rock.vdb"])):
            with self.subTest(there=there, command=command[0]):
                if there != "rock.ply":
                    self.write(there, "mine")
                self.refuse(USAGE, [there, "--force"], *command)
                if there != "rock.ply":
                    self.succeed(*command, "--force")
                for path in self.folder.iterdir():
                    if path.name != "rock.ply":
                        path.unlink()
        self.refuse(USAGE, ["twice"], "light", "rock.ply", *LIGHT, "-o", "x.ply", "--debug-photons", "x.ply")
        self.refuse(USAGE, ["twice"], "moss", "rock.ply", *MOSS, "-o", "x.vdb", "--points", "x.ply")
        self.refuse(4, ["none"], "light", "rock.ply", *LIGHT, "-o", "x.ply", "--debug-photons", "none/p.ply")

    def test_a_scene_without_its_mesh_is_told_of(self):
        self.light("rock.ply", "-o", "light.vdb")
        self.moss("light.vdb", "-o", "moss.vdb", "-q")
        (self.folder / "light.ply").unlink()
        self.refuse(BAD_INPUT, ["light.vdb", "light.ply"], "moss", "light.vdb", *MOSS, "-o", "x.vdb")
        self.succeed("explain", "light.vdb", "--face", "0")  # what needs no mesh goes on

    def test_pipes_carry_the_mesh(self):
        self.light("rock.ply", "-o", "light.ply")
        done = self.succeed("light", "-", *LIGHT, "-o", "-", data=self.rock.read_bytes())
        self.assertSameBytes(done.out, self.folder / "light.ply", "light through a pipe")
        self.moss("light.ply", "-o", "moss.ply")
        chain = bash(f"set -o pipefail; \"$SEKITEI\" light rock.ply {' '.join(LIGHT)} -q -o - | "
                     f"\"$SEKITEI\" moss - {' '.join(MOSS)} -q -o - > piped.ply", self.folder)
        self.assertEqual(chain.code, 0, chain)
        self.assertSameBytes(self.folder / "piped.ply", self.folder / "moss.ply", "two commands")
        self.refuse(BAD_INPUT, ["standard input"], "light", "-", *LIGHT, "-o", "x.ply", data=self.rock.read_bytes()[:300])
        self.refuse(BAD_INPUT, ["standard input", "empty"], "light", "-", *LIGHT, "-o", "x.ply", data=b"")

    def test_explain_tells_of_a_face(self):
        self.grow()
        json_of = lambda *where: self.succeed("explain", "moss.vdb", *where, "--json").json()
        face = json_of("--face", "7")
        self.assertIn("light_S", face)
        self.assertIn("mosses", face)
        at = json_of("--at", ",".join(map(str, face["site_m"])))
        self.assertEqual(at["site_m"], face["site_m"])
        self.assertEqual(at["light_S"], face["light_S"])
        count = points((self.folder / "moss.ply").read_bytes())
        self.assertGreater(count, 8)
        text = self.succeed("explain", "moss.vdb", "--face", "7").out.decode()
        self.assertIn("face 7", text)
        faces = int(re.search(r"element face (\d+)", header((self.folder / "moss.ply").read_bytes()))[1])
        expected = f"must be a whole number from 0 to {faces - 1}, for the mesh has {faces} faces"
        for wrong in ("-1", "100000000", str(faces), "1" + 40 * "0", "1.5", "seven", "7x"):
            done = self.refuse(USAGE, f"error: --face {wrong}: {expected}\n", "explain", "moss.vdb", "--face", wrong)
            self.assertEqual(len(done.err.splitlines()), 1, done.err)
        self.succeed("explain", "moss.vdb", "--face", str(faces - 1))
        self.refuse(USAGE, ["--at", "--face"], "explain", "moss.vdb", "--face", "7", "--at", "0,0,0")
        self.refuse(USAGE, ["--at", "--face"], "explain", "moss.vdb")

    def test_the_result_can_be_drawn(self):
        self.grow()
        for source in ("moss.vdb", "moss.ply"):
            self.succeed("render", source, "-o", "x.png", "--force", *PICTURE)
        self.succeed("render", "moss.vdb", "--field", "light_S", "-o", "light.png", *PICTURE)

    def test_plants_are_drawn_at_their_own_size_and_kept_photons_as_dots(self):
        def pixels(source, *options):
            self.succeed("render", source, "-o", "x.png", "--force", *PICTURE, *options)
            content = (self.folder / "x.png").read_bytes()
            return content[content.index(b"IDAT"):]  # what goes before tells the command

        # 1.15 sizes of 1 cm, however large the sites are.
        self.grow()
        self.assertEqual(pixels("moss.vdb"), pixels("moss.vdb", "--tuft-size", "1.15cm"))
        self.assertNotEqual(pixels("moss.vdb"), pixels("moss.vdb", "--tuft-size", "16cm"))
        self.light("rock.ply", "-o", "plain.vdb")
        self.light("rock.ply", "--keep-photons", "-o", "light.vdb")
        self.assertEqual(pixels("light.vdb", "--no-photons"), pixels("plain.vdb"))
        dots = pixels("light.vdb")
        self.assertNotEqual(dots, pixels("plain.vdb"))
        self.assertNotEqual(dots, pixels("light.vdb", "--photon-size", "5cm"))

    def test_the_seed_and_threads(self):
        for name, options in (("one", ["--threads", 1]), ("two", ["--threads", 2]), ("other", ["--seed", 2])):
            self.moss("rock.ply", "-o", f"{name}.vdb", *options)
        for suffix in ("vdb", "ply"):
            self.assertSameBytes(self.folder / f"one.{suffix}", self.folder / f"two.{suffix}", "threads")
        self.assertNotEqual((self.folder / "one.vdb").read_bytes(), (self.folder / "other.vdb").read_bytes())

    def test_replay_makes_the_same_files_again(self):
        self.grow()
        self.write("again.toml", self.succeed("replay", "moss.vdb").out)
        self.succeed("run", "again.toml", "-q", "--set", "out=again")
        self.assertSameBytes(self.folder / "again/moss.vdb", self.folder / "moss.vdb", "replay")

    def test_weather_of_a_place(self):
        self.write("days.csv", year(datetime.date(2021, 6, 20), 40))
        self.light("rock.ply", "--weather", "days.csv", "-o", "light.vdb")
        self.moss("light.vdb", "--days", "3", "-o", "moss.vdb")
        self.moss("rock.ply", "--weather", "days.csv", "--days", "3", "-o", "direct.vdb")
        self.refuse(USAGE, ["days", "repeat"], "moss", "rock.ply", *MOSS, "--weather", "days.csv", "-o", "x.vdb")
        self.refuse(USAGE, ["latitude"], "light", "rock.ply", "--weather", "days.csv", "--latitude", "91", "-o", "x.vdb")


class Recipes(MeshTest):
    def states(self, *options):
        summary = self.succeed("run", "moss.toml", "--json", "-q", *options).json()
        return {s["name"]: s["state"] for s in summary["stages"]}

    def test_a_second_run_finds_everything(self):
        self.recipe(RECIPE, "moss.toml")
        self.assertEqual(set(self.states().values()), {"run"})
        first = files_in(self.folder / "out")
        self.assertEqual({"moss.vdb", "moss.ply", "moss.csv", "manifest.json"}, set(first))
        self.assertNotIn("run", self.states().values())
        self.assertSameFiles(files_in(self.folder / "out"), first, "a second run")
        self.succeed("verify", "out/manifest.json")
        # What a hand does is what the recipe does.
        self.grow()
        for name in ("moss.vdb", "moss.ply"):
            self.assertSameBytes(self.folder / name, first[name], f"{name} by hand")
        # Another mesh is another run.
        self.mesh("rock.ply", *foreign.box((0, 0, -0.2), (0.6, 0.5, 0)))
        self.assertEqual(self.states()["moss"], "run")

    def test_a_scene_written_alone_has_its_mesh_beside_it(self):
        self.recipe(RECIPE, "moss.toml")
        self.succeed("run", "moss.toml", "-q", "--set", "out=both")
        both = files_in(self.folder / "both")
        alone = RECIPE.replace('["moss.vdb", "moss.ply"]', '"moss.vdb"')
        self.recipe(alone, "moss.toml")
        self.states()
        self.assertSameFiles(files_in(self.folder / "out"), both, "as if both were named")
        self.succeed("render", "out/moss.vdb", "-o", "x.png", *PICTURE)
        self.assertNotIn("run", self.states().values())
        # Somebody else's file is not replaced.
        self.write("mine/moss.ply", "mine")
        self.refuse(USAGE, ["moss.ply", "--force"], "run", "moss.toml", "--set", "out=mine")
        # A list is taken at its word.
        self.recipe(RECIPE.replace('["moss.vdb", "moss.ply"]', '["moss.vdb"]'), "moss.toml")
        self.succeed("run", "moss.toml", "-q", "--set", "out=list")
        self.assertEqual({"moss.vdb", "moss.csv", "manifest.json"}, set(files_in(self.folder / "list")))
        # A name that another stage writes stays that stage's, and that is told.
        self.recipe(alone.replace('file = "rock.ply"', 'file = "rock.ply"\nwrite = "./moss.ply"'), "moss.toml")
        done = self.succeed("run", "moss.toml", "-q", "--set", "out=taken")
        self.assertRegex(done.err, r"warning: moss\.toml:17:\d+: moss\.write: .*moss\.ply.*'rock'")
        self.assertNotIn("light_S", header((self.folder / "taken/moss.ply").read_bytes()))
        # Cells have no mesh.
        self.recipe('sekitei = 1\nout = "cells"\n[lava]\npreset = "slab"\nsize = ["1.6m", "1.6m", "1.6m"]\nvoxel = "8cm"\nwrite = "lava.vdb"\n', "cells.toml")
        self.succeed("run", "cells.toml", "-q")
        self.assertEqual({"lava.vdb", "manifest.json"}, set(files_in(self.folder / "cells")))

    def test_a_kept_mesh_that_is_damaged_or_gone_is_made_again(self):
        self.recipe(RECIPE, "moss.toml")
        self.states()
        first = files_in(self.folder / "out")
        for damage in (lambda b: b[:-40] + b"\1" * 40, lambda b: b[:len(b) // 2], lambda b: b"", None):
            kept = next((self.folder / "out/.sekitei").glob("moss-*.ply"))
            if damage:
                kept.write_bytes(damage(kept.read_bytes()))
            else:
                kept.unlink()
            self.assertEqual(self.states()["moss"], "run")
            self.assertSameFiles(files_in(self.folder / "out"), first, "made again")

    def test_light_needs_no_weather_on_a_mesh(self):
        text = 'sekitei = 1\nout = "out"\n[rock]\nstage = "mesh"\nfile = "rock.ply"\n[light]\nsite = "10cm"\nphotons = "20k"\nwrite = "light.ply"\n'
        self.recipe(text, "light.toml")
        self.succeed("check", "light.toml")
        self.succeed("run", "light.toml", "-q")
        self.light("rock.ply", "-o", "light.ply")
        self.assertSameBytes(self.folder / "out/light.ply", self.folder / "light.ply", "by hand")
        # Cells do.
        self.recipe('sekitei = 1\n[lantern]\n[light]\nwrite = "light.vdb"\n', "cells.toml")
        for command in ("check", "run"):
            self.refuse(USAGE, ["cells.toml:3", "weather"], command, "cells.toml")

    def test_side_files_have_no_place_in_recipes(self):
        self.recipe(RECIPE.replace("days = 12", 'days = 12\npoints = "plants.ply"'), "moss.toml")
        self.refuse(USAGE, ["moss.toml:", "plants.ply", "export"], "run", "moss.toml")
        self.refuse(USAGE, ["moss.toml:", "plants.ply", "export"], "check", "moss.toml")
        self.recipe('sekitei = 1\nout = "out"\n[rock]\nstage = "mesh"\nfile = "rock.ply"\n[light]\ndebug_photons = "p.ply"\n', "light.toml")
        self.refuse(USAGE, ["light.toml:", "p.ply"], "run", "light.toml")

    def test_mistakes_are_told_before_anything_runs(self):
        for was, now, words in (('file = "rock.ply"', 'file = "none.ply"', ["none.ply"]), ("days = 12", "days = 0", ["days"]),
                                ("photons = \"4k\"", "photons = 0", ["photons"]), ('site = "10cm"', 'site = "0cm"', ["site"]),
                                ("open_light = 25", "open_light = -1", ["open_light"]), ("days = 12", "dais = 12", ["dais", "days"]),
                                ("days = 12", "sun = \"pth\"", ["pth", "path"])):
            self.recipe(RECIPE.replace(was, now), "moss.toml")
            done = self.run_in_folder("check", "moss.toml")
            self.assertIn(done.code, (USAGE, BAD_INPUT), done)
            for word in ("moss.toml:", *words):
                self.assertIn(word, done.err)
        self.assertFalse((self.folder / "out").exists())


class Broken(MeshTest):
    """What battery_test has no row for."""

    def test_numbers_that_no_moss_or_light_has(self):
        for option, value in (("--open-light", "1e300"), ("--sky-light", "1e4"), ("--photon-radius", "1e9"), ("--albedo", "0.97")):
            self.both(USAGE, [option[2:].replace("-", "_")], "rock.ply", option, value)
        for option, value in (("--size", "1e9"), ("--growth-rate", "1e9"), ("--spore-throw", "1e9"), ("--initial-growth", "1e9")):
            self.refuse(USAGE, [option[2:].replace("-", "_")], "moss", "rock.ply", *MOSS, option, value, "-o", "x.vdb")

    def test_voxels_too_small_for_this_machine_are_refused_at_once(self):
        for value in ("1e-7", "1e-4"):
            self.both(LIMIT, ["cell", "--memory"], "rock.ply", "--cell", value, "--memory", "500M")

    def test_textures_and_attributes(self):
        self.write("soil.png", foreign.png(4, 4, lambda x, y: 0))
        self.refuse(BAD_INPUT, ["geology"], "moss", "rock.ply", *MOSS, "--texture", "soil.png", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["gone.png"], "moss", "rock.ply", *MOSS, "--texture", "gone.png", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["paint"], "moss", "rock.ply", *MOSS, "--mask", "paint", "-o", "x.vdb")

    def test_a_texture_that_materials_name_is_told_of(self):
        v, f = slab()
        text = "mtllib stone.mtl\nusemtl stone\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in v) + "vt 0 0\nvt 1 0\nvt 0 1\n"
        self.write("in/stone.obj", text + "".join("f " + " ".join(f"{i + 1}/{k + 1}" for k, i in enumerate(t)) + "\n" for t in f))
        self.write("in/stone.mtl", "newmtl stone\nmap_Kd stone.png\n")
        self.write("in/stone.png", foreign.png(4, 4, lambda x, y: 0))
        grow = ["moss", "in/stone.obj", *MOSS, "--force", "-o"]
        words = "in/stone.obj: its materials name the texture in/stone.png, which is not used by itself"
        done = self.succeed(*grow, "plain.vdb")
        self.assertIn(words, done.err)
        self.assertIn("--texture in/stone.png", done.err)
        self.assertIn(words, self.succeed("mesh", "--file", "in/stone.obj", "-o", "x.ply").err)
        # Not where it is used, nor where none could be.
        self.assertNotIn(words, self.run_in_folder(*grow, "x.vdb", "--texture", "in/stone.png").err)
        self.assertNotIn(words, self.light("in/stone.obj", "-o", "light.vdb").err)
        for mtl, told in (("newmtl stone\nmap_Kd rock.jpg\n", ["in/rock.jpg (which is not there)", "--texture in/rock.png, once it is a PNG"]),
                          (None, ["in/stone.mtl", "--texture FILE.png"])):
            if mtl:
                self.write("in/stone.mtl", mtl)
            else:
                (self.folder / "in/stone.mtl").unlink()
            err = self.succeed(*grow, "x.vdb").err
            for word in told:
                self.assertIn(word, err)
        self.write("in/stone.mtl", "newmtl stone\nKd 1 1 1\n")
        self.assertNotIn("--texture", self.succeed(*grow, "x.vdb").err)
        # Told, it changes nothing.
        self.assertSameBytes(self.folder / "x.ply", self.folder / "plain.ply")

    def test_checkpoints(self):
        self.moss("rock.ply", "--checkpoint", "c.state", "-o", "a.vdb", "--days", "12")
        state = (self.folder / "c.state").read_bytes()
        self.assertGreater(len(state), 100)
        self.moss("rock.ply", "--checkpoint", "c.state", "-o", "b.vdb")
        self.assertSameBytes(self.folder / "a.vdb", self.folder / "b.vdb", "from day 10")
        again = ["moss", "rock.ply", *MOSS, "--checkpoint", "c.state", "-o", "x.vdb"]
        self.refuse(BAD_INPUT, ["c.state", "seed"], *again, "--seed", "5")
        self.refuse(BAD_INPUT, ["c.state", "growth_rate"], *again, "--growth-rate", "0.5")
        self.mesh("rock.ply", *foreign.box((0, 0, -0.2), (0.6, 0.41, 0)))
        self.refuse(BAD_INPUT, ["c.state", "mesh"], *again)
        self.mesh("rock.ply", *slab())
        for damage in (b"", state[:100], state[:-1], state[:60] + b"?" + state[61:], b"x" + state):
            self.write("c.state", damage)
            self.refuse(BAD_INPUT, ["c.state"], *again)


if __name__ == "__main__":
    unittest.main()
