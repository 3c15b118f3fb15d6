"""data/blender/import_sekitei.py in Blender: what it builds, how fast, what it refuses, what Cycles sees of it."""

import csv
import json
import os
import shutil

import foreign
import made_glb
import numpy
import oracle
from foreign import pyopenvdb
from habitat_test import make_habitat
from support import BAD_INPUT, CANNOT_WRITE, DATA, USAGE, CliTest

SCRIPT = DATA / "blender" / "import_sekitei.py"

# What the script has built, told by Blender: a second script of the same run.
LOOK = """
import bpy, json, numpy
def values(data, name):
    a = data.attributes[name]
    width = {"FLOAT": 1, "INT": 1, "FLOAT_VECTOR": 3, "FLOAT_COLOR": 4}[a.data_type]
    out = numpy.zeros(len(a.data) * width, numpy.float32)
    a.data.foreach_get({1: "value", 3: "vector", 4: "color"}[width], out)
    return out
told = {"surfaces": {}, "instances": {}, "prototypes": {}, "volumes": {}}
def box(o):
    co = [o.matrix_world @ v.co for v in o.data.vertices]
    return [[f(c[k] for c in co) for k in range(3)] for f in (min, max)]
for o in bpy.data.collections["surfaces"].objects if "surfaces" in bpy.data.collections else []:
    own = [a.name for a in o.data.attributes if a.name not in ("position", "material_index") and not a.name.startswith(".")]
    told["surfaces"][o.name] = {"kind": o["sekitei_kind"], "vertices": len(o.data.vertices), "triangles": len(o.data.polygons),
        "broken": o.data.validate(), "box": box(o), "materials": [m.name for m in o.data.materials],
        "ranges": {n: [float(values(o.data, n).min()), float(values(o.data, n).max())] for n in own
                   if o.data.attributes[n].data_type in ("FLOAT", "INT")},
        "reads": sorted({n.attribute_name for m in o.data.materials for n in m.node_tree.nodes if n.type == "ATTRIBUTE"})}
for o in bpy.data.collections["instances"].objects if "instances" in bpy.data.collections else []:
    told["instances"][o.name] = {"set": o["sekitei_set"], "species": o["sekitei_species"], "points": len(o.data.vertices),
        "attributes": sorted(a.name for a in o.data.attributes)}
for o in bpy.data.collections["prototypes"].objects if "prototypes" in bpy.data.collections else []:
    told["prototypes"][o.name] = [len(o.data.polygons), o.hide_render]
for o in bpy.data.collections["volumes"].objects if "volumes" in bpy.data.collections else []:
    told["volumes"][o.name] = {"grids": o["sekitei_grids"].split(), "rendered": not o.hide_render, "sequence": o.data.is_sequence}
drawn = bpy.context.evaluated_depsgraph_get().object_instances
copies = [(i.object.name, [list(r) for r in i.matrix_world]) for i in drawn if i.is_instance]
told["copies"] = len(copies)
told["matrices"] = [m for _, m in copies[:3000]]
told["camera"] = list(bpy.context.scene.camera.location)
told["sky"] = [n.sky_type for n in bpy.context.scene.world.node_tree.nodes if n.type == "TEX_SKY"]
print("TOLD " + json.dumps(told), flush=True)
"""


class ImportTest(CliTest):
    def imported(self, *arguments, timeout=300, code=0):
        """Runs the script and then LOOK; (what LOOK told, what was printed)."""
        look = self.write("look.py", LOOK)
        done = oracle.run_blender("-P", SCRIPT, "-P", look, "--", *arguments, timeout=timeout, cwd=self.folder)
        said = done.stdout + done.stderr
        self.assertEqual(done.returncode, code, said[-3000:])
        line = next((l for l in done.stdout.split("\n") if l.startswith("TOLD ")), None)
        self.assertEqual(line is not None, code == 0, said[-3000:])
        self.assertNotIn("Traceback", said)
        return json.loads(line[5:]) if line else None, said

    def manifest(self, *names, version="0.1.0", **more):
        outputs = [{"path": n, "kind": "mesh", "bytes": (self.folder / n).stat().st_size} for n in names]
        return self.write("manifest.json", json.dumps({"sekitei": version, "outputs": outputs, **more}))


class Made(ImportTest):
    """Files made by hand, whose every place is known."""

    def test_copies_stand_turn_and_scale_as_the_file_says(self):
        made, places, turns, scales = made_glb.rock_with_plants(2000)
        self.write("s.glb", made.bytes())
        told, _ = self.imported(self.manifest("s.glb"))
        rock = told["surfaces"]["rock"]
        self.assertEqual((rock["kind"], rock["vertices"], rock["triangles"]), ("rock", 16, 24))
        self.assertEqual(rock["box"], [[0, 0, 0], [4, 2, 1]])
        self.assertEqual(rock["ranges"]["column_id"], [0, 1])
        self.assertEqual(rock["ranges"]["light_S"], [10, 40])
        self.assertTrue({"column_id", "moss_cover"} <= set(rock["reads"]), rock["reads"])
        plants = told["instances"]["moss/bryum_0_lod1"]
        self.assertEqual((plants["set"], plants["species"], plants["points"]), ("moss", "bryum", 2000))
        self.assertTrue({"growth", "age", "id", "rotation", "scale"} <= set(plants["attributes"]), plants)
        self.assertEqual(told["prototypes"], {"bryum_0_lod1": [4, True]})
        self.assertEqual(told["copies"], 2000)
        found = numpy.array(told["matrices"])
        self.assertLess(numpy.abs(found[:, :3, :3] - turned(turns) * scales[:, None]).max(), 1e-6)
        self.assertLess(numpy.abs(found[:, :3, 3] - places).max(), 1e-6)
        self.assertEqual(told["sky"], ["NISHITA"])

    def test_300_000_copies_open_in_seconds_and_stay_copies(self):
        self.write("s.glb", made_glb.rock_with_plants(300000)[0].bytes())
        manifest = self.manifest("s.glb")
        before = os.times()
        done = oracle.run_blender("-P", SCRIPT, "--", manifest, "--save", self.folder / "s.blend", timeout=120)
        after = os.times()
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("300000 copies", done.stdout)
        # Of processor, Blender's own start included: other work on the machine does not count.
        self.assertLess(after.children_user + after.children_system - before.children_user - before.children_system, 10)
        # 300 000 made-real cones would be 1.5 million vertices, 18 MB of places alone beside the 16 MB of the copies' own.
        self.assertLess((self.folder / "s.blend").stat().st_size, 300000 * 60)

    def test_what_is_wrong_is_named(self):
        whole = made_glb.rock_with_plants(10)[0]
        tree = whole.tree()
        self.write("s.glb", whole.bytes())
        foreign = whole.tree()
        foreign["asset"]["generator"] = "Another program"
        newer = whole.tree()
        newer["asset"]["extras"]["sekitei"]["version"] = "9.0.0"
        cut = json.loads(json.dumps(tree))
        cut["bufferViews"][0]["byteOffset"] = 1 << 20
        uneven = json.loads(json.dumps(tree))
        instancing = uneven["nodes"][1]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
        uneven["accessors"][instancing["SCALE"]]["count"] = 9
        for name, content in (("foreign", whole.bytes(foreign)), ("newer", whole.bytes(newer)), ("cut", whole.bytes(cut)),
                              ("uneven", whole.bytes(uneven)), ("short", whole.bytes()[:-40]), ("text", b"solid rock\n" * 9)):
            self.write(name + ".glb", content)
        good = self.manifest("s.glb")
        (self.folder / "good").mkdir()
        good.rename(self.folder / "good" / "manifest.json")
        shutil.copy(self.folder / "s.glb", self.folder / "good")
        self.write("list.json", "[1, 2]")
        self.write("broken.json", '{"sekitei": "0.1.0", "outputs": [')
        self.write("newer.json", json.dumps({"sekitei": "7.0.0", "outputs": []}))
        self.write("empty.json", json.dumps({"sekitei": "0.1.0", "outputs": []}))
        self.write("gone.json", json.dumps({"sekitei": "0.1.0", "outputs": [{"path": "gone.glb", "bytes": 3}]}))
        self.write("half.json", json.dumps({"sekitei": "0.1.0", "outputs": [{"path": "s.glb", "bytes": 3}]}))
        cases = [(["nothing/manifest.json"], BAD_INPUT, "nothing/manifest.json: No such file"),
                 (["list.json"], BAD_INPUT, "not a manifest of Sekitei"),
                 (["broken.json"], BAD_INPUT, "not a manifest"), (["newer.json"], BAD_INPUT, "version '7.0.0'"),
                 (["empty.json"], BAD_INPUT, "nothing to show"), (["gone.json"], BAD_INPUT, "gone.glb: no such file"),
                 (["half.json"], BAD_INPUT, "the manifest says 3"), (["foreign.glb"], BAD_INPUT, "Another program"),
                 (["newer.glb"], BAD_INPUT, "version '9.0.0'"), (["cut.glb"], BAD_INPUT, "accessor 0 is damaged"),
                 (["uneven.glb"], BAD_INPUT, "9 values for 10 copies"), (["short.glb"], BAD_INPUT, "damaged"),
                 (["text.glb"], BAD_INPUT, "not a .glb"),
                 (["good/manifest.json", "--camera", "1,2"], USAGE, "6 numbers"),
                 (["good/manifest.json", "--samples", "0"], USAGE, "1 or more"),
                 (["good/manifest.json", "--render", "no/such/frame.png"], CANNOT_WRITE, "no such folder")]
        # One Blender for all: each of its starts takes a second.
        driver = self.write("driver.py", f"""
import contextlib, importlib.util, io, json, sys, bpy
spec = importlib.util.spec_from_file_location("import_sekitei", {str(SCRIPT)!r})
script = importlib.util.module_from_spec(spec)
spec.loader.exec_module(script)
told = []
for arguments in {[c[0] for c in cases]!r} + [["good"], ["good/manifest.json"], ["good/s.glb"]]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    words = io.StringIO()
    with contextlib.redirect_stderr(words):
        try:
            script.build(script.parse(arguments))
            told.append([0, ""])
        except script.Problem as problem:
            told.append([problem.code, str(problem)])
        except SystemExit as end:
            told.append([end.code, words.getvalue()])
print("TOLD " + json.dumps(told), flush=True)
""")
        done = oracle.run_blender("--python-exit-code", 9, "-P", driver, timeout=200, cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stdout[-2000:] + done.stderr[-3000:])
        told = json.loads(next(l for l in done.stdout.split("\n") if l.startswith("TOLD "))[5:])
        for (arguments, code, words), (found, said) in zip(cases, told):
            with self.subTest(arguments=arguments):
                self.assertEqual(found, code, said)
                self.assertIn(words, said)
        self.assertEqual([code for code, _ in told[len(cases):]], [0, 0, 0], "the good twins")
        # And by Blender's own exit code.
        _, said = self.imported("list.json", code=BAD_INPUT)
        self.assertIn("import_sekitei: error: list.json: not a manifest of Sekitei", said)
        self.imported("good", "--camera", "1", code=USAGE)


RECIPE = """\
sekitei = 1
seed = 7
out = "out"

[lava]
preset = "slab"
size = ["1.6m", "1.6m", "1.6m"]
voxel = "4cm"
heat_cell = "16cm"
noise_amplitude = 0

[cool]
steps = 40

[joint]
spacing = "40cm"

[weather]
cut = "perpendicular"
write = "rock.vdb"

[rock]
stage = "mesh"
write = "rock.ply"
"""


class Folder(ImportTest):
    """A folder of `sekitei run` without a .glb: volumes, and meshes from PLY."""

    def test_volumes_and_meshes_of_a_run(self):
        self.write("rock.toml", RECIPE)
        self.succeed("run", "rock.toml")
        told, _ = self.imported("out/manifest.json")
        described = self.succeed("info", "out/rock.ply", "--json").json()[0]
        rock = told["surfaces"]["rock"]
        self.assertEqual((rock["vertices"], rock["triangles"]), (described["vertices"], described["triangles"]))
        for side in range(2):
            for axis in range(3):
                self.assertAlmostEqual(rock["box"][side][axis], described["bounds_m"][side][axis], places=5)
        self.assertTrue({"column", "component", "surface"} <= rock["ranges"].keys())
        self.assertTrue({"column", "surface"} <= set(rock["reads"]))
        volume = told["volumes"]["rock (volume)"]
        grids = self.succeed("info", "out/rock.vdb", "--json").json()[0]["grids"]
        floats = {g["name"] for g in grids if g["type"] == "float" and not g["points"]}
        self.assertEqual(set(volume["grids"]), floats)
        self.assertFalse(volume["rendered"])
        none, _ = self.imported("out", "--no-volumes")
        self.assertEqual(none["volumes"], {})

    def test_numbered_volumes_are_a_sequence_if_none_is_missing(self):
        self.write("s.glb", made_glb.rock_with_plants(5)[0].bytes())
        fog = foreign.write(self.folder / "day.0001.vdb", foreign.fog())
        for name in ("day.0002.vdb", "day.0003.vdb", "moss.0030.vdb", "moss.0060.vdb"):
            shutil.copy(fog, self.folder / name)
        names = sorted(p.name for p in self.folder.glob("*.vdb"))
        told, _ = self.imported(self.manifest("s.glb", *names), "--render-volumes")
        found = {name: (v["sequence"], v["rendered"], v["grids"]) for name, v in told["volumes"].items()}
        self.assertEqual(found, {"day (volume)": (True, True, ["density"]), "moss (volume)": (False, True, ["density"])})

    def test_half_a_volume_is_refused_before_blender_dies_of_it(self):
        self.write("rock.toml", RECIPE)
        self.succeed("run", "rock.toml")
        whole = (self.folder / "out/rock.vdb").read_bytes()
        (self.folder / "out/rock.vdb").write_bytes(whole[:len(whole) // 2])
        _, said = self.imported("out", code=BAD_INPUT)
        self.assertIn("rock.vdb", said)


def turned(quaternions):
    """Rotation matrices of quaternions x y z w."""
    x, y, z, w = numpy.asarray(quaternions, float).T
    return numpy.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]).transpose(2, 0, 1)


class Exported(ImportTest):
    """Folders of `sekitei export`; the table of instances, a file of its own, says where copies stand."""

    def export(self, scene):
        """The folder, and its rows of instances."""
        self.succeed("export", scene, "--to", "out/", "--to", "instances.csv")
        with open(self.folder / "instances.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        manifest = json.loads((self.folder / "out/manifest.json").read_text())
        self.assertEqual(sum(o["path"].endswith(".glb") for o in manifest["outputs"]), 1, manifest)
        return self.folder / "out/manifest.json", rows

    def assertCopies(self, told, rows):
        """Each copy that Blender draws stands, turns and scales as its row says."""
        self.assertEqual(told["copies"], len(rows))
        counts = {}
        for row in rows:
            name = f"{row['set']}/{row['prototype']}"
            counts[name] = counts.get(name, 0) + 1
        self.assertEqual({name: i["points"] for name, i in told["instances"].items()}, counts)
        number = lambda names: numpy.array([[float(row[n]) for n in names] for row in rows])
        places = number(("P_x", "P_y", "P_z"))
        scales = number(("scale_x", "scale_y", "scale_z")) * number(("pscale",))
        wanted = turned(number(("orient_x", "orient_y", "orient_z", "orient_w"))) * scales[:, None]
        size = numpy.abs(wanted).max()
        for matrix in numpy.array(told["matrices"])[:500]:
            away = numpy.linalg.norm(places - matrix[:3, 3], axis=1)
            near = away < 1e-4
            self.assertTrue(near.any(), f"a copy at {matrix[:3, 3]}, {away.min()} m from any in the table")
            self.assertLess(min(numpy.abs(w - matrix[:3, :3]).max() for w in wanted[near]), 1e-4 * size)

    def test_a_garden_of_moss(self):
        make_habitat(self.folder)
        manifest, rows = self.export("moss.vdb")
        self.assertGreater(len(rows), 50)
        frame = ["--render", self.folder / "frame.png", "--width", 200, "--height", 125, "--samples", 8, "--field-of-view", 50]
        told, _ = self.imported(manifest, *frame)
        self.assertCopies(told, rows)
        kinds = {s["kind"] for s in told["surfaces"].values()}
        self.assertTrue({"rock", "water"} <= kinds, kinds)
        rock = next(s for s in told["surfaces"].values() if s["kind"] == "rock")
        self.assertFalse(rock["broken"])
        self.assertTrue({"moss_cover", "soil_rh"} <= set(rock["reads"]), rock["reads"])
        for name in ("light_S", "sky_view", "soil_rh", "soil_Ts", "moss_cover"):
            low, high = pyopenvdb.read(str(self.folder / "moss.vdb"), name).evalMinMax()
            found = rock["ranges"][name]
            self.assertTrue(low - 1e-3 <= found[0] <= found[1] <= high + 1e-3, f"{name}: {found} of {low}..{high}")
            self.assertGreater(found[1], found[0], name)
        for i in told["instances"].values():
            self.assertEqual(i["set"], "moss")
            self.assertIn(i["species"], ("bryum", "hypnum", "polytrichum"))
            self.assertTrue({"growth", "age", "id"} <= set(i["attributes"]), i)
        self.assertEqual(len(told["volumes"]), sum(o["path"].endswith(".vdb") for o in json.loads(manifest.read_text())["outputs"]))
        oracle.shows_something(self, self.folder / "frame.png")

    def test_a_tree(self):
        self.succeed("tree", "--species", "beech", "--generations", "14", "-o", "tree.vdb")
        manifest, rows = self.export("tree.vdb")
        self.assertGreater(len(rows), 100)
        told, _ = self.imported(manifest, "--no-volumes")
        self.assertCopies(told, rows)
        bark = next(s for s in told["surfaces"].values() if s["kind"] == "bark")
        self.assertGreater(bark["triangles"], 1000)
        self.assertGreater(bark["box"][1][2], 1, "a tree stands upright")
        self.assertTrue(all(i["set"] == "leaves" for i in told["instances"].values()))

    def test_a_forest(self):
        self.succeed("forest", "--size", "40m", "--initial", "20", "--steps", "8", "-o", "forest.vdb")
        manifest, rows = self.export("forest.vdb")
        self.assertGreater(len(rows), 5)
        told, _ = self.imported(manifest, "--no-volumes")
        self.assertCopies(told, rows)
        self.assertTrue(all(i["set"] == "forest" for i in told["instances"].values()))


class Seen(ImportTest):
    """What Cycles makes of it."""

    def test_a_frame_is_not_empty_and_shows_plants_and_sky(self):
        self.write("s.glb", made_glb.rock_with_plants(3000)[0].bytes())
        manifest = self.manifest("s.glb")
        camera = "2,-5,1.6,2,1,1.1"
        self.imported(manifest, "--render", "frame.png", "--width", 160, "--height", 100, "--samples", 6, "--camera", camera)
        image = oracle.shows_something(self, self.folder / "frame.png", spread=0.05)
        top, middle = image[:8].mean((0, 1)), image[50:60, 20:78].mean((0, 1))
        self.assertGreater(top[2], top[0], "the sky above is blue")
        self.assertGreater(middle[1], middle[2] * 1.2, "cones of moss on the left step are green")


if __name__ == "__main__":
    oracle.main("blender")
