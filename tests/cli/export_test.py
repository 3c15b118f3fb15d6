"""Scenes as files of other programs: every suffix, folders, sequences, recipes, and what is refused."""

import json
import re
import shutil
import struct
import tempfile
import unittest
from pathlib import Path

from habitat_test import LANTERN, LIGHT, WIND
from support import (BAD_INPUT, CANNOT_WRITE, DONE, LIMIT, USAGE, CliTest, files_in, make_chain, run, spring_weather, temporaries)

RECIPE = """\
sekitei = 1
seed = 7
out = "out"

[lava]
preset = "slab"
size = ["1.6m", "1.6m", "1.6m"]
voxel = "8cm"
heat_cell = "16cm"

[cool]
steps = 20

[joint]
spacing = "40cm"

[weather]
cut = "perpendicular"

[files]
stage = "export"
metres_per_pixel = "5cm"
write = ["rock.glb", "rock.usda", "rock.obj", "height.png", "rock.vdb"]
"""


def document(path):
    """The JSON of a binary glTF file."""
    content = Path(path).read_bytes()
    magic, version, length, size = struct.unpack("<4I", content[:16])
    assert (magic, version, length) == (0x46546C67, 2, len(content))
    return json.loads(content[20:20 + size])


def names(path):
    return [node["name"] for node in document(path)["nodes"]]


class Export(CliTest):
    @classmethod
    def setUpClass(cls):
        cls.scenes = Path(tempfile.mkdtemp(prefix="sekitei-export-"))
        cls.addClassCleanup(shutil.rmtree, cls.scenes, ignore_errors=True)
        make_chain(cls.scenes)
        (cls.scenes / "days.csv").write_text(spring_weather())
        cls.rock, cls.mesh, cls.moss, cls.forest = (cls.scenes / n for n in ("weathered.vdb", "rock.ply", "moss.vdb", "forest.vdb"))
        for command, source, target, options in (("lantern", [], "lantern.vdb", LANTERN), ("light", ["lantern.vdb"], "light.vdb", LIGHT),
                                                 ("wind", ["light.vdb"], "wind.vdb", WIND), ("soil", ["wind.vdb"], "soil.vdb", []),
                                                 ("moss", ["soil.vdb"], "moss.vdb", []),
                                                 ("forest", [], "forest.vdb", ["--size", "24m", "--initial", "8", "--steps", "12"])):
            done = run(command, *source, *options, "-o", target, "-q", cwd=cls.scenes)
            assert done.code == DONE, done

    def test_a_rock_with_columns_goes_out_in_every_form(self):
        self.succeed("export", self.rock, "--to", "a.glb", "--to", "a.usda", "--to", "a.obj", "--to", "a.ply", "--to", "a.png")
        node, = (n for n in document(self.folder / "a.glb")["nodes"] if n["name"] == "rock")
        self.assertEqual(node["extras"]["sekitei"]["kind"], "rock")
        glb = document(self.folder / "a.glb")
        attributes = glb["meshes"][node["mesh"]]["primitives"][0]["attributes"]
        for name in ("POSITION", "NORMAL", "_COLUMN_ID", "_COMPONENT", "_SURFACE", "_TEMPERATURE"):
            self.assertIn(name, attributes)
        fields = glb["asset"]["extras"]["sekitei"]["fields"]
        self.assertEqual(fields["_TEMPERATURE"]["unit"], "K")
        self.assertLess(fields["_TEMPERATURE"]["low"], fields["_TEMPERATURE"]["high"])
        info = self.succeed("info", self.mesh, "--json").json()[0]
        indices = glb["accessors"][glb["meshes"][node["mesh"]]["primitives"][0]["indices"]]
        self.assertEqual(indices["count"], 3 * info["triangles"], "the mesh that `mesh` makes")
        obj = (self.folder / "a.obj").read_text()
        self.assertIn("mtllib a.mtl\no rock\nusemtl rock\n", obj)
        self.assertRegex(obj, r"\ng column_000\d\d\n")
        self.assertIn("newmtl rock\n", (self.folder / "a.mtl").read_text())
        self.assertIn("int[] primvars:column = [", (self.folder / "a.usda").read_text())
        self.assertIn(b"property float temperature\n", (self.folder / "a.ply").read_bytes()[:2000])
        notes = json.loads((self.folder / "a.json").read_text())
        width, height = struct.unpack(">II", (self.folder / "a.png").read_bytes()[16:24])
        self.assertEqual((notes["width"], notes["height"]), (width, height))
        self.assertAlmostEqual(notes["high"], info["bounds"][1][2] if "bounds" in info else notes["high"], places=3)
        # A mesh given besides stands in for the surface; one of another name stands beside it.
        shutil.copy(self.mesh, self.folder / "bench.ply")
        self.succeed("export", self.rock, self.mesh, "bench.ply", "--to", "b.glb")
        self.assertEqual(names(self.folder / "b.glb"), ["sekitei", "rock", "bench"])
        self.succeed("export", self.mesh, "--to", "c.glb")
        self.assertEqual(names(self.folder / "c.glb"), ["sekitei", "rock"])

    def test_a_garden_has_moss_and_leaves_as_instances(self):
        self.succeed("export", self.moss, "--to", "g.glb", "--to", "g.csv")
        table = [line.split(",") for line in (self.folder / "g.csv").read_text().splitlines()]
        sets = {row[0] for row in table[1:]}
        self.assertIn("moss", sets)
        self.assertEqual({n.split("/")[0] for n in names(self.folder / "g.glb") if "/" in n}, sets)
        counts = document(self.folder / "g.glb")["asset"]["extras"]["sekitei"]["instances"]
        for name in sets:
            self.assertEqual(counts[name]["count"], sum(row[0] == name for row in table))
        fields = document(self.folder / "g.glb")["asset"]["extras"]["sekitei"]["fields"]
        for name in ("_LIGHT_S", "_SOIL_RH", "_SOIL_TS", "_MOSS_COVER", "_MOSS_SPECIES", "_SUIT_BRYUM"):
            self.assertIn(name, fields)
        self.assertIn("water", names(self.folder / "g.glb"), "the lantern's pond")
        # The old form: points.
        self.succeed("export", self.moss, "-o", "moss.ply")
        self.succeed("export", self.moss, "--points", "moss", "--to", "moss2.ply")
        self.assertSameBytes(self.folder / "moss.ply", self.folder / "moss2.ply")
        self.succeed("export", self.moss, "--to", "surface.ply")
        self.assertIn(b"element face", (self.folder / "surface.ply").read_bytes()[:6000])

    def test_trees_come_in_three_degrees_of_detail(self):
        sizes = []
        for detail in ("near", "middle", "far"):
            self.succeed("export", self.forest, "--trees", detail, "--to", f"{detail}.glb")
            self.assertTrue(all(n.endswith("_" + detail) for n in names(self.folder / f"{detail}.glb") if "/" in n))
            sizes.append((self.folder / f"{detail}.glb").stat().st_size)
        self.assertEqual(sizes, sorted(sizes, reverse=True))
        self.assertIn("ground", names(self.folder / "far.glb"))

    def test_a_folder_gets_everything_and_a_manifest_that_verify_accepts(self):
        self.succeed("export", self.moss, "--to", "garden/")
        manifest = json.loads((self.folder / "garden" / "manifest.json").read_text())
        listed = {entry["path"] for entry in manifest["outputs"]}
        self.assertEqual(listed | {"manifest.json"}, set(files_in(self.folder / "garden")))
        for suffix in ("glb", "usda", "csv", "obj", "mtl", "ply", "vdb"):
            self.assertIn(f"moss.{suffix}", listed)
        self.assertLessEqual({"moss_moss.ply", "moss_height.png", "moss_height.json", "moss_light_S.png"}, listed)
        self.succeed("verify", "garden/manifest.json")
        self.refuse(USAGE, ["manifest.json", "--force"], "export", self.moss, "--to", "garden/")
        before = files_in(self.folder / "garden")
        self.succeed("export", self.moss, "--to", "garden", "--force", "--threads", "1")
        self.assertSameFiles(before, files_in(self.folder / "garden"))
        with open(self.folder / "garden" / "moss.glb", "r+b") as file:
            file.seek(2000)
            file.write(b"!!")
        self.assertNotEqual(self.run_in_folder("verify", "garden/manifest.json").code, DONE)

    def test_several_scenes_are_a_sequence(self):
        self.succeed("export", self.rock, self.moss, "--to", "film.vdb", "--half", "--to", "film.glb")
        for number, scene in ((1, self.rock), (2, self.moss)):
            film = self.folder / f"film.000{number}.vdb"
            self.assertLess(film.stat().st_size, scene.stat().st_size, "half the digits")
            there, source = (self.succeed("info", f, "--json").json()[0]["grids"] for f in (film, scene))
            self.assertEqual([g["name"] for g in there], [g["name"] for g in source])
            self.assertIn("rock", names(self.folder / f"film.000{number}.glb"))

    def test_a_recipe_writes_the_same_files_and_only_what_changed(self):
        self.write("rock.toml", RECIPE)
        self.succeed("run", "rock.toml")
        out = self.folder / "out"
        made = files_in(out)
        self.assertEqual(set(made) - {"manifest.json"},
                         {"rock.glb", "rock.usda", "rock.obj", "rock.mtl", "height.png", "height.json", "rock.vdb"})
        manifest = json.loads((out / "manifest.json").read_text())
        self.assertEqual({e["path"] for e in manifest["outputs"]}, set(made) - {"manifest.json"})
        self.succeed("verify", out / "manifest.json")
        summary = self.succeed("run", "rock.toml", "--json").json()
        self.assertEqual({s["state"] for s in summary["stages"]}, {"cached"})
        self.assertSameFiles(made, files_in(out))
        (out / "rock.glb").unlink()
        self.succeed("run", "rock.toml")
        self.assertSameFiles(made, files_in(out))
        # The same as by hand, from the scene that the recipe wrote.
        self.succeed("export", out / "rock.vdb", "--to", "hand.glb", "--to", "hand.usda", "--seed", 7)
        self.assertSameBytes(out / "rock.glb", self.folder / "hand.glb")
        self.assertSameBytes(out / "rock.usda", self.folder / "hand.usda")
        self.assertRegex(self.succeed("run", "rock.toml", "--set", "files.fields=false").err, r"files\s")
        self.assertNotIn("_TEMPERATURE", json.dumps(document(out / "rock.glb")))

    def test_mistakes_are_named_before_anything_is_written(self):
        self.refuse(USAGE, ["garden.fbx", ".glb", ".usda"], "export", self.rock, "--to", "garden.fbx")
        self.refuse(USAGE, ["--to"], "export", self.rock)
        self.refuse(USAGE, ["which scene"], "export", "--to", "a.glb")
        self.refuse(USAGE, ["written twice"], "export", self.rock, "--to", "a.glb", "--to", "a.glb")
        self.refuse(USAGE, ["--to -"], "export", self.rock, "--to", "-")
        self.refuse(USAGE, ["trees", "near"], "export", self.rock, "--trees", "nearest", "--to", "a.glb")
        self.refuse(USAGE, ["did you mean 'height'"], "export", self.rock, "--map", "hight", "--to", "a.png")
        self.refuse(USAGE, ["moss_lod", "0 to 2"], "export", self.rock, "--moss-lod", "3", "--to", "a.glb")
        self.refuse(BAD_INPUT, ["none.vdb", "no such file"], "export", "none.vdb", "--to", "a.glb")
        self.refuse(BAD_INPUT, ["nothing to draw"], "export", self.scenes / "lava.vdb", "--to", "a.glb")
        self.refuse(BAD_INPUT, ["moss, forest or leaves"], "export", self.rock, "--to", "a.csv")
        self.refuse(CANNOT_WRITE, ["no such folder"], "export", self.rock, "--to", "none/a.glb")
        self.refuse(CANNOT_WRITE, ["no such folder"], "export", self.rock, "--to", "none/more/")
        self.refuse(BAD_INPUT, ["nothing to draw"], "export", self.scenes / "lava.vdb", "--to", "new/")
        self.assertFalse((self.folder / "new").exists())
        self.refuse(LIMIT, ["memory", "--memory"], "export", self.rock, "--memory", "5M", "--to", "a.glb")
        self.write("a.glb", "mine")
        self.refuse(USAGE, ["a.glb", "--force"], "export", self.rock, "--to", "a.glb")
        shutil.copy(self.rock, self.folder / "own.vdb")
        self.refuse(USAGE, ["own.vdb"], "export", "own.vdb", "--to", "own.vdb", "--force")
        self.write("bad.toml", RECIPE.replace('"rock.usda"', '"rock.fbx"'))
        self.refuse(USAGE, ["files.write", "rock.fbx", ".glb"], "run", "bad.toml")
        self.assertEqual(temporaries(self.folder), [])


if __name__ == "__main__":
    unittest.main()
