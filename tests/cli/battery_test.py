"""The battery: 44 kinds of bad input, each beside a good twin that must succeed.

A refusal names file, place and what was expected, has its own exit code, leaves nothing behind and takes less than 5 s and
1 GB (`refuse` of support.py). Tests are named by their row, `00` are good twins of several rows.

 1 empty volume             12 transforms                23 crossing itself       34 unstable step
 2 cut volume               13 voxel size                24 no faces              35 ranges of mosses
 3 no volume                14 far too many voxels       25 lying headers         36 weather
 4 newer format             15 lying bounds              26 flavours of PLY       37 too little weather
 5 flipped bit              16 different lattices        27 flavours of OBJ       38 recipes
 6 type of a grid           17 holes                     28 tiny and huge         39 folders
 7 missing grid             18 not a manifold            29 photons               40 full disks
 8 two grids of a name      19 no area, double vertices  30 sun and place         41 names, links, pipes
 9 empty grid               20 indices out of range      31 columns that fit not  42 signals, closed pipes
10 no numbers               21 vertices without numbers  32 no cooling surface    43 checkpoints
11 values beyond range      22 orientation               33 no lava               44 little of everything
"""

import datetime
import os
import random
import re
import resource
import shutil
import signal
import struct
import subprocess
import time
import unittest
from pathlib import Path

import foreign
from bad_file_test import BODY, Bodies
from foreign import pyopenvdb
from habitat_test import HEAD, LIGHT as DAYS, HabitatTest
from interrupt_test import CheckpointTest
from mesh_test import LIGHT, MOSS, MeshTest, slab, year
from recipe_test import RecipeTest
from support import (BAD_INPUT, CANNOT_WRITE, COOL, DATA, DIFFER, DONE, FAULTS, INTERRUPTED, JOINT, LAVA, LIMIT, RECIPE, RENDER, TERMINATED,
                     USAGE, WEATHER, CliTest, SceneTest, bash, environment, files_in, lava_with, run, small_disk, spring_weather, start, stop,
                     temporaries)

class Rows01to16(SceneTest):
    """Volumes and voxels."""

    def refuse_volume(self, words, path, grid=None):
        """Every command that reads scenes names the fault."""
        self.refuse(BAD_INPUT, words, "cool", path, "-o", "out.vdb")
        self.refuse(BAD_INPUT, words, "lava", "--preset", "volume", "--volume", path, "-o", "out.vdb", *BODY)

    def refuse_file(self, words, content, name="bad.vdb"):
        path = self.write(name, content)
        self.refuse(BAD_INPUT, words, "info", path)
        self.refuse(DIFFER, words, "verify", path)
        self.refuse(BAD_INPUT, words, "mesh", path, "-o", "out.ply")
        self.refuse_volume(words, path)

    def test_00_the_good_twin_of_files(self):
        for command in (["info", self.lava], ["verify", self.lava, self.joints], ["mesh", self.weathered, "-o", "x.ply"],
                        ["cool", self.lava, *COOL, "-o", "x.vdb"],
                        ["lava", "--preset", "volume", "--volume", foreign.write(self.folder / "body.vdb", foreign.level_set("body_sdf")), "-o",
                         "y.vdb", *BODY]):
            self.succeed(*command)
        self.succeed("cool", "-", *COOL, "-o", "z.vdb", data=self.lava.read_bytes())

    def test_01_an_empty_file(self):
        self.refuse_file(["bad.vdb", "empty"], b"")
        self.refuse(BAD_INPUT, ["empty"], "cool", "-", "-o", "out.vdb", data=b"")

    def test_02_a_cut_file_is_named_as_cut(self):
        good = self.joints.read_bytes()
        for length in (8, 20, 64, 200, 1000, len(good) // 2, len(good) - 1):
            with self.subTest(length=length):
                path = self.write("cut.vdb", good[:length])
                for command in (["info", path], ["mesh", path, "-o", "x.ply"], ["cool", path, "-o", "x.vdb"]):
                    done = self.refuse(BAD_INPUT, ["cut.vdb", "truncated"], *command)
                self.refuse(DIFFER, ["cut.vdb", "truncated"], "verify", path)
        self.assertIn(str(len(good)), done.err)
        self.assertIn(str(len(good) - 1), done.err)

    def test_02_a_hundred_cuts_of_our_file_and_a_foreign_one(self):
        draw = random.Random(29)
        foreign.write(self.folder / "sphere.vdb", foreign.level_set(), foreign.fog())
        for good in (self.lava.read_bytes(), (self.folder / "sphere.vdb").read_bytes()):
            for _ in range(50):
                length = draw.randrange(len(good))
                self.write("cut.vdb", good[:length])
                done = run("verify", "cut.vdb", cwd=self.folder, timeout=10, limits=[(resource.RLIMIT_AS, 6 << 30)])
                self.assertEqual(done.code, DIFFER, f"cut at {length}: {done}")
                self.assertLess(done.peak, 1 << 30)

    def test_02_a_cut_pipe_is_noticed(self):
        stream = self.succeed("cool", self.lava, "-o", "-").out
        self.succeed("joint", "-", "--spacing", "40cm", "-o", "good.vdb", data=stream)
        for length in (0, 2, 8, 20, 100, len(stream) // 2, len(stream) - 40, len(stream) - 1):
            with self.subTest(length=length):
                self.refuse(BAD_INPUT, [], "joint", "-", "--spacing", "40cm", "-o", "x.vdb", data=stream[:length])
        bad = bytearray(stream)
        bad[len(bad) // 2] ^= 16
        self.refuse(BAD_INPUT, [], "joint", "-", "--spacing", "40cm", "-o", "x.vdb", data=bytes(bad))

    def test_03_another_kind_of_file(self):
        for content in (foreign.png(4, 4, lambda x, y: 0), b"ply\n" * 100, b"sekitei = 1\n" * 50, os.urandom(5000)):
            self.refuse_file(["bad.vdb", "not a vdb"], content)
        self.refuse(BAD_INPUT, ["not"], "cool", "-", "-o", "x.vdb", data=b"\x89PNG\r\n\x1a\n" * 100)

    def test_04_a_newer_format(self):
        good = bytearray(self.lava.read_bytes())
        for version in (225, 1000, 0x7FFFFFFF, 0xFFFFFFFF):
            good[8:12] = struct.pack("<I", version)
            self.refuse_file(["bad.vdb", "version", "224"], bytes(good))

    def test_05_a_flipped_bit_names_the_grid(self):
        good = self.lava.read_bytes()
        bad = bytearray(good)
        bad[-200] ^= 1  # in the values of the last grid
        path = self.write("flipped.vdb", bytes(bad))
        self.refuse(DIFFER, ["flipped.vdb", "hash"], "verify", path)
        draw = random.Random(5)
        refused = 0
        for _ in range(40):
            bad = bytearray(good)
            bad[draw.randrange(12, len(good))] ^= 1 << draw.randrange(8)
            path = self.write("flipped.vdb", bytes(bad))
            done = run("verify", path, timeout=10, limits=[(resource.RLIMIT_AS, 6 << 30)])
            self.assertEqual(done.code, DIFFER, done)
            self.assertLess(done.peak, 1 << 30)
            done = run("cool", path, "-o", self.folder / "out.vdb", timeout=10, limits=[(resource.RLIMIT_AS, 6 << 30)])
            # What cool does not look at, such as the name of the writing program, may pass.
            self.assertIn(done.code, (BAD_INPUT, DONE), done)
            refused += done.code == BAD_INPUT
            (self.folder / "out.vdb").unlink(missing_ok=True)
        self.assertGreater(refused, 30)

    def test_06_a_grid_of_another_type(self):
        wrong = foreign.level_set("region_coarse")
        path = foreign.write(self.folder / "wrong.vdb", wrong)
        self.refuse(BAD_INPUT, ["region_coarse", "float", "int32"], "cool", path, "-o", "x.vdb")
        vectors = pyopenvdb.Vec3SGrid()
        vectors.name = "density"
        vectors.fill((0, 0, 0), (9, 9, 9), (1, 2, 3))
        path = foreign.write(self.folder / "vectors.vdb", vectors)
        self.refuse(BAD_INPUT, ["density", "vec3s", "float"], "mesh", path, "-o", "x.ply")
        self.refuse(BAD_INPUT, ["region", "int32", "float"], "mesh", self.lava, "--grid", "region", "-o", "x.ply")
        self.succeed("mesh", self.lava, "--grid", "body_sdf", "-o", "x.ply")

    def test_07_a_missing_grid_lists_those_present(self):
        self.refuse(BAD_INPUT, ["lava.vdb", "temperature_gradient", "region_coarse", "body_sdf"], "joint", self.lava, "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["centre_lines", "temperature"], "weather", self.cooled, "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["density", "column"], "mesh", self.joints, "-o", "x.ply")
        self.refuse(BAD_INPUT, ["densty", "density"], "mesh", self.weathered, "--grid", "densty", "-o", "x.ply")
        self.refuse(BAD_INPUT, ["heat", "temperature"], "render", self.cooled, "--slice", "heat", "-o", "x.png")
        path = foreign.sphere(self.folder / "sphere.vdb")
        self.refuse(BAD_INPUT, ["region_coarse", "sphere"], "cool", path, "-o", "x.vdb")
        self.succeed("mesh", path, "--grid", "sphere", "-o", "x.ply")

    def test_08_two_grids_of_one_name(self):
        a, b = foreign.level_set("rock"), foreign.level_set("rock", radius=0.3)
        path = foreign.write(self.folder / "twins.vdb", a, b)
        self.refuse(BAD_INPUT, ["twins.vdb", "rock"], "mesh", path, "--grid", "rock", "-o", "x.ply")
        # What the message says mends it.
        for name in ("rock[0]", "rock[1]"):
            self.refuse(BAD_INPUT, [name], "mesh", path, "--grid", "rock", "-o", "x.ply")
            self.succeed("mesh", path, "--grid", name, "-o", f"{name}.ply")
        for name, alone in (("rock[0]", a), ("rock[1]", b)):
            foreign.write(path, alone)
            self.succeed("mesh", path, "--grid", "rock", "-o", f"{name}_alone.ply")
            self.assertSameBytes(self.folder / f"{name}.ply", self.folder / f"{name}_alone.ply", name)

    def test_09_an_empty_grid(self):
        empty = pyopenvdb.FloatGrid()
        empty.name = "density"
        path = foreign.write(self.folder / "empty.vdb", empty)
        self.refuse(BAD_INPUT, ["density"], "mesh", path, "--grid", "density", "-o", "x.ply")
        self.refuse(BAD_INPUT, ["density"], "lava", "--preset", "volume", "--volume", path, "-o", "x.vdb", *BODY)
        none = foreign.write(self.folder / "none.vdb")
        self.refuse(BAD_INPUT, ["none.vdb"], "lava", "--preset", "volume", "--volume", none, "-o", "x.vdb", *BODY)
        self.succeed("info", none)
        foreign.write(path, foreign.fog())
        self.succeed("mesh", path, "--grid", "density", "-o", "x.ply")

    def test_10_values_that_are_no_numbers(self):
        for value, word in ((float("nan"), "nan"), (float("inf"), "inf")):
            grid = foreign.level_set("rock")
            for x in range(3):
                grid.getAccessor().setValueOn((5 + x, 4, 3), value)
            path = foreign.write(self.folder / "nan.vdb", grid)
            words = ["nan.vdb", "rock", "3 voxels", "(5, 4, 3)", "--fix-nan"]
            self.refuse(BAD_INPUT, words, "mesh", path, "--grid", "rock", "-o", "x.ply")
            done = self.succeed("mesh", path, "--grid", "rock", "--fix-nan", "-o", f"{word}.ply")
            self.assertIn("warning", done.err)
            self.refuse(BAD_INPUT, ["nan.vdb", "--fix-nan"], "lava", "--preset", "volume", "--volume", path, "-o", "x.vdb", *BODY)

    def test_11_temperatures_beyond_all_numbers(self):
        for option, value in (("--lava-temperature", "1e39"), ("--lava-temperature", "1e308"), ("--cold-temperature", "1e39"),
                              ("--lava-temperature", "-1"), ("--lava-temperature", "-300C")):
            with self.subTest(option=option, value=value):
                self.refuse(USAGE, [option.strip("-").replace("-", "_").split("_")[0], "K"], "cool", self.lava, option, value, "-o", "x.vdb")
        self.succeed("cool", self.lava, "--lava-temperature", "1200C", "--steps", 10, "-o", "x.vdb")

    def test_11_temperatures_of_a_volume(self):
        grid = pyopenvdb.read(str(self.cooled), "temperature")
        warm = next(grid.iterOnValues())
        for value, words in ((1e38, ["1e+38 K"]), (-3e37, ["-3e+37 K"]), (1e-42, ["1e-42 K"]), (float(warm.value) + 1, None)):
            warm.value = value
            path = foreign.write(self.folder / "hot.vdb", grid)
            picture = ["render", path, "--slice", "temperature", "-o", "x.png"]
            if words:
                self.refuse(BAD_INPUT, ["hot.vdb", "grid temperature", "1 voxel", "expected", *words], *picture)
            else:
                self.assertIn("another program", self.succeed(*picture).err)

    def test_12_transforms_that_are_not_cubes(self):
        matrices = {"stretched": [[0.1, 0, 0, 0], [0, 0.1, 0, 0], [0, 0, 0.2, 0], [0, 0, 0, 1]],
                    "sheared": [[0.1, 0.05, 0, 0], [0, 0.1, 0, 0], [0, 0, 0.1, 0], [0, 0, 0, 1]],
                    "rotated": [[0, 0.1, 0, 0], [-0.1, 0, 0, 0], [0, 0, 0.1, 0], [0, 0, 0, 1]]}
        for kind, matrix in matrices.items():
            with self.subTest(kind=kind):
                grid = foreign.fog()
                grid.transform = pyopenvdb.createLinearTransform(matrix)
                path = foreign.write(self.folder / f"{kind}.vdb", grid)
                self.refuse(BAD_INPUT, [kind, "density"], "mesh", path, "--grid", "density", "-o", "x.ply")
        grid = foreign.fog()
        grid.transform = pyopenvdb.createFrustumTransform(taper=0.5, depth=10, xyzMin=(0, 0, 0), xyzMax=(100, 100, 100))
        path = foreign.write(self.folder / "frustum.vdb", grid)
        self.refuse(BAD_INPUT, ["frustum.vdb", "density"], "mesh", path, "--grid", "density", "-o", "x.ply")
        good = foreign.write(self.folder / "cubes.vdb", foreign.fog())
        self.succeed("mesh", good, "--grid", "density", "-o", "x.ply")

    def test_13_voxel_sizes_that_cannot_be(self):
        for value in ("0", "-1", "-4cm", "nan", "inf", "1e999", "", "four", "4K", "4cm4", "0x10"):
            with self.subTest(value=value):
                self.refuse(USAGE, ["--voxel"], *lava_with("--voxel", value))
        self.refuse(USAGE, ["voxel", "> 0"], *lava_with("--voxel", "0"))
        self.succeed(*lava_with("--voxel", "5cm"))

    def test_14_far_too_many_voxels(self):
        for value in ("1e-9", "1e-30", "1e-300"):
            done = self.refuse(LIMIT, ["voxel"], *lava_with("--voxel", value))
        self.refuse(LIMIT, ["voxel"], *lava_with("--size", "1e9,1e9,1e9"))
        done = self.run_in_folder(*lava_with("--heat-cell", "1e-7"), timeout=20)
        self.assertIn(done.code, (LIMIT, USAGE), done)

    def test_14_the_memory_limit_names_what_is_needed(self):
        for command, source in (("cool", self.lava), ("joint", self.cooled), ("weather", self.joints)):
            self.refuse(LIMIT, ["--memory", "20 kB"], command, source, "--memory", "20kB", "-o", "x.vdb")
        self.refuse(LIMIT, ["--memory"], *lava_with("--memory", "10kB"))
        self.succeed("cool", self.lava, "--memory", "1G", "-o", "x.vdb")
        for value in ("0", "-1", "lots", "1XB", ""):
            self.refuse(USAGE, ["--memory"], "cool", self.lava, "--memory", value, "-o", "y.vdb")

    def test_15_metadata_that_lies_about_the_bounds(self):
        grid = foreign.fog()
        grid["file_bbox_min"], grid["file_bbox_max"] = (-2**31, -2**31, -2**31), (2**31 - 1, 2**31 - 1, 2**31 - 1)
        grid["file_voxel_count"] = 2**62
        path = foreign.write(self.folder / "lies.vdb", grid)
        self.succeed("mesh", path, "--grid", "density", "-o", "lies.ply")
        foreign.write(self.folder / "true.vdb", foreign.fog())
        self.succeed("mesh", "true.vdb", "--grid", "density", "-o", "true.ply")
        self.assertSameBytes(self.folder / "lies.ply", self.folder / "true.ply")

    def test_15_voxels_at_the_ends_of_the_integers(self):
        grid = foreign.fog()
        for c in ((2**31 - 1,) * 3, (-2**31,) * 3):
            grid.getAccessor().setValueOn(c, 1.0)
        path = foreign.write(self.folder / "far.vdb", grid)
        done = self.run_in_folder("mesh", path, "--grid", "density", "-o", "x.ply", limits=[(resource.RLIMIT_AS, 6 << 30)], timeout=20)
        self.assertIn(done.code, (DONE, BAD_INPUT, LIMIT), done)
        self.assertLess(done.seconds, 5)

    def test_16_grids_on_different_lattices(self):
        """There is no --resample: where two volumes lie on different lattices is for the user to mend."""
        path = self.folder / "body.vdb"
        foreign.write(path, foreign.level_set("body_sdf"), foreign.level_set("slow_sdf", voxel=0.05, radius=0.2))
        command = ["lava", "--preset", "volume", "--volume", path, "-o", "x.vdb", *BODY]
        self.refuse(BAD_INPUT, ["body.vdb", "body_sdf", "slow_sdf", "transform", "resample"], *command)
        foreign.write(path, foreign.level_set("body_sdf"), foreign.level_set("slow_sdf", radius=0.2))
        self.succeed(*command)


class Rows17to30(Bodies, MeshTest):
    """Meshes as bodies of lava (`body`) and under light and moss (`both`, `fine`); light of a place."""

    def test_00_the_good_twin_of_light_and_moss(self):
        for form in ("ascii", "binary_little_endian", "binary_big_endian"):
            self.assertEqual(self.sites(self.fine(self.mesh("good.ply", *slab(), form))), self.sites(self.fine("rock.ply")))

    def test_00_the_good_twin_of_bodies(self):
        v, f = foreign.box()
        for form in ("ascii", "binary_little_endian", "binary_big_endian"):
            count = self.voxels(self.write("box.ply", foreign.ply(v, f, form)))
            self.assertAlmostEqual(count * 0.08**3, 1.2 * 1.1 * 1.0, delta=0.15)

    def test_17_a_mesh_with_holes_is_mended_and_told(self):
        v, f = foreign.torus()
        whole = self.voxels(self.write("whole.ply", foreign.ply(v, f)))
        path = self.write("holes.ply", foreign.ply(v, f[:40] + f[42:300] + f[302:]))
        done = self.succeed(*self.body(path), "--json")
        self.assertAlmostEqual(done.json()["summary"]["voxels"], whole, delta=0.1 * whole)
        self.assertRegex(done.err, r"\b8\b.*open|open.*\b8\b")
        self.refuse(BAD_INPUT, ["open", "8"], *self.body(path, "--strict"))

    def test_17_holes(self):
        v, f = foreign.torus(centre=(0, 0, 0.3))
        whole = self.sites(self.fine(self.mesh("whole.ply", v, f)))
        done = self.fine(self.mesh("holes.ply", v, f[:40] + f[42:300] + f[302:]))
        self.assertGreater(self.sites(done), 0.9 * whole)

    def test_17_a_single_sheet_has_light_but_no_cells(self):
        v = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
        done = self.fine(self.mesh("sheet.ply", v, [(0, 1, 2), (0, 2, 3)]))
        self.assertIn("warning", done.err)
        self.assertIn("encloses nothing", done.err)

    def test_17_a_scan_with_4272_open_edges(self):
        v, f = foreign.torus(200, 60)
        whole = self.voxels(self.write("whole.ply", foreign.ply(v, f, "binary_little_endian")))
        kept = [t for i, t in enumerate(f) if i % 16 or i >= 16 * 1424]
        path = self.write("scan.ply", foreign.ply(v, kept, "binary_little_endian"))
        done = self.succeed(*self.body(path), "--json")
        self.assertRegex(done.err, r"\b4272\b")
        self.assertAlmostEqual(done.json()["summary"]["voxels"], whole, delta=0.1 * whole)
        self.refuse(BAD_INPUT, ["4272"], *self.body(path, "--strict"))

    @unittest.skipUnless(Path("/usr/share/glmark2/models/bunny.obj").exists(), "needs the package glmark2-data")
    def test_17_a_bunny(self):
        path = Path("/usr/share/glmark2/models/bunny.obj")
        told = self.succeed("info", path, "--json").json()[0]
        size = max(b - a for a, b in zip(*told["bounds_m"]))
        done = self.succeed(*self.body(path, "--mesh-scale", 1 / size), "--json")
        self.assertGreater(done.json()["summary"]["voxels"], 100)
        self.fine(path, "--site", f"{size / 10}m", "--photon-radius", f"{size / 5}m", "--cell", f"{size / 20}m")

    def test_18_a_mesh_that_is_not_a_manifold(self):
        v, f = foreign.box()
        v = v + [[0.8, 0.8, 2.0]]
        path = self.write("fin.ply", foreign.ply(v, [*f, (4, 7, 8)]))
        done = self.succeed(*self.body(path))
        self.assertIn("manifold", done.err)
        self.refuse(BAD_INPUT, ["manifold"], *self.body(path, "--strict"))

    def test_18_not_a_manifold(self):
        v, f = slab()
        self.fine(self.mesh("fin.ply", v + [[0.3, 0.2, 0.3]], [*f, (4, 7, 8)]))

    def test_18_2094_fins(self):
        v, f = foreign.torus(200, 60)
        v, fins = list(v), []
        for a, b, _ in f[:2094]:
            fins.append((a, b, len(v)))
            v.append([v[a][0], v[a][1], v[a][2] + 0.001])
        path = self.write("fins.ply", foreign.ply(v, f + fins, "binary_little_endian"))
        self.assertRegex(self.succeed(*self.body(path)).err, "manifold")
        self.refuse(BAD_INPUT, ["manifold"], *self.body(path, "--strict"))

    def test_19_triangles_without_area_and_double_vertices_are_counted(self):
        v, f = foreign.box()
        path = self.write("dirty.ply", foreign.ply([*v, v[0], v[5]], [*f, (0, 0, 1), (0, 8, 3), (5, 9, 5)]))
        done = self.succeed(*self.body(path), "--json")
        self.assertEqual(done.json()["summary"]["voxels"], self.box_volume())
        self.assertRegex(done.err, r"3 .*area")

    def test_19_no_area_and_double_vertices(self):
        v, f = slab()
        done = self.fine(self.mesh("dirty.ply", [*v, v[0], v[5]], [*f, (0, 0, 1), (0, 8, 3), (5, 9, 5)]))
        self.assertEqual(self.sites(done), self.sites(self.fine("rock.ply")))
        self.assertRegex(done.err, r"3 .*area")

    def test_20_indices_out_of_range_have_a_line(self):
        v, f = foreign.box()
        for bad in ((0, 1, 8), (0, -1, 2), (0, 1, 2**31 - 1)):
            text = foreign.ply(v, [*f[:5], bad, *f[6:]])
            line = 1 + text.decode().split("\n").index("3 " + " ".join(map(str, bad)))
            self.refuse(BAD_INPUT, [f"bad.ply:{line}", str([i for i in bad if not 0 <= i < 8][0])],
                        *self.body(self.write("bad.ply", text)))
        binary = foreign.ply(v, [*f[:5], (0, 1, 99), *f[6:]], "binary_little_endian")
        self.refuse(BAD_INPUT, ["bad.ply", "99"], *self.body(self.write("bad.ply", binary)))
        for bad in ("f 1 2 99", "f 1 2 0", "f 1 2 -99", "f 1 2 x"):
            obj = "".join(f"v {x} {y} {z}\n" for x, y, z in v) + bad + "\n"
            self.refuse(BAD_INPUT, ["bad.obj:9"], *self.body(self.write("bad.obj", obj)))
        off = "OFF\n8 1 0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in v) + "3 0 1 8\n"
        self.refuse(BAD_INPUT, ["bad.off:11", "8"], *self.body(self.write("bad.off", off)))

    def test_20_indices_out_of_range(self):
        v, f = slab()
        for bad in ((0, 1, 8), (0, -1, 2)):
            self.both(BAD_INPUT, ["bad.ply", str([i for i in bad if not 0 <= i < 8][0])], self.mesh("bad.ply", v, [*f[:5], bad, *f[6:]], "ascii"))

    def test_21_vertices_that_are_no_numbers(self):
        v, f = foreign.box()
        for value in (float("nan"), float("inf")):
            bad = [list(x) for x in v]
            bad[3][1] = value
            for form in ("ascii", "binary_little_endian"):
                self.refuse(BAD_INPUT, ["nan.ply"], *self.body(self.write("nan.ply", foreign.ply(bad, f, form))))
                self.refuse(BAD_INPUT, ["nan.ply"], "render", "nan.ply", "-o", "x.png")

    def test_21_no_numbers(self):
        v, f = slab()
        for value in (float("nan"), float("inf")):
            bad = [list(x) for x in v]
            bad[3][1] = value
            self.both(BAD_INPUT, ["nan.ply"], self.mesh("nan.ply", bad, f))

    def test_22_inverted_and_mixed_orientation_is_mended(self):
        v, f = foreign.box()
        wanted = self.box_volume()
        for faces in ([t[::-1] for t in f], [t[::-1] if i % 3 == 0 else t for i, t in enumerate(f)]):
            path = self.write("turned.ply", foreign.ply(v, faces))
            done = self.succeed(*self.body(path), "--json")
            self.assertEqual(done.json()["summary"]["voxels"], wanted)
            self.assertIn("warning", done.err)

    def test_22_turned_faces(self):
        v, f = slab()
        wanted = self.light("rock.ply", "-o", "wanted.ply", "--json").json()["summary"]["mean_light"]
        for faces in ([t[::-1] for t in f], [t[::-1] if i % 3 == 0 else t for i, t in enumerate(f)]):
            done = self.fine(self.mesh("turned.ply", v, faces))
            self.assertIn("warning", done.err)
            self.assertAlmostEqual(done.json()["summary"]["mean_light"], wanted, delta=0.02 * wanted)

    def test_23_surfaces_that_cross_themselves(self):
        v, f = foreign.box()
        w, g = foreign.box((0.6, 0.6, 0.6), (1.5, 1.5, 1.5))
        path = self.write("crossing.ply", foreign.ply(v + w, f + [tuple(i + 8 for i in t) for t in g]))
        union = 1.2 * 1.1 * 1.0 + 0.9**3 - 0.8 * 0.7 * 0.6
        self.assertAlmostEqual(self.voxels(path) * 0.08**3, union, delta=0.2)

    def test_23_crossing_itself(self):
        v, f = slab()
        w, g = foreign.box((0.3, 0.2, -0.1), (0.8, 0.6, 0.2))
        self.fine(self.mesh("crossing.ply", v + w, f + [tuple(i + 8 for i in t) for t in g]))

    def test_24_no_faces_one_face_or_points(self):
        v, f = foreign.box()
        for faces in ([], f[:1]):
            self.refuse(BAD_INPUT, ["few.ply"], *self.body(self.write("few.ply", foreign.ply(v, faces))))
        points = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 1 1\n"
        self.refuse(BAD_INPUT, ["points.ply"], *self.body(self.write("points.ply", points)))
        for name in ("empty.ply", "empty.obj", "empty.stl", "empty.off"):
            self.refuse(BAD_INPUT, [name], *self.body(self.write(name, b"")))

    def test_24_no_faces_one_face_or_points_under_light_and_moss(self):
        v, f = slab()
        self.both(BAD_INPUT, ["none.ply"], self.mesh("none.ply", v, []))
        self.fine(self.mesh("one.ply", v, f[10:11]))
        dots = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 1 1\n"
        self.both(BAD_INPUT, ["points.ply"], self.write("points.ply", dots))
        for name in ("empty.ply", "empty.obj", "empty.stl", "empty.off"):
            self.both(BAD_INPUT, [name], self.write(name, b""))
        self.both(BAD_INPUT, ["gone.ply"], "gone.ply")

    def test_25_headers_that_promise_too_much(self):
        v, f = foreign.box()
        for form in ("ascii", "binary_little_endian"):
            text = foreign.ply(v, f, form).replace(b"element vertex 8", b"element vertex 1000000000000")
            self.refuse(BAD_INPUT, ["huge.ply"], *self.body(self.write("huge.ply", text)))
            self.refuse(BAD_INPUT, ["huge.ply"], "info", "huge.ply")
            text = foreign.ply(v, f, form).replace(b"element face 12", b"element face 99999999999999999999999")
            self.refuse(BAD_INPUT, ["huge.ply"], *self.body(self.write("huge.ply", text)))
        self.refuse(BAD_INPUT, ["huge.off"], *self.body(self.write("huge.off", "OFF\n4000000000 4000000000 0\n0 0 0\n")))
        self.refuse(BAD_INPUT, ["huge.stl"], *self.body(self.write("huge.stl", b"\0" * 80 + struct.pack("<I", 0xFFFFFFF0) + b"\0" * 100)))

    def test_25_headers_that_promise_too_much_under_light_and_moss(self):
        v, f = slab()
        for form in ("ascii", "binary_little_endian"):
            good = foreign.ply(v, f, form)
            self.both(BAD_INPUT, ["huge.ply"], self.write("huge.ply", good.replace(b"element vertex 8", b"element vertex 1000000000000")))
            self.both(BAD_INPUT, ["huge.ply"], self.write("huge.ply", good.replace(b"element face 12", b"element face 99999999999")))

    def test_26_every_flavour_of_ply(self):
        v, f = foreign.box()
        wanted = self.box_volume()
        text = foreign.ply(v, f)
        head, body = text.split(b"end_header\n")
        self.assertEqual(self.voxels(self.write("crlf.ply", text.replace(b"\n", b"\r\n"))), wanted)
        self.assertEqual(self.voxels(self.write("comment.ply", foreign.ply(v, f, comment="comment made by hand\nobj_info x\n"))), wanted)
        self.assertEqual(self.voxels(self.write("big.ply", foreign.ply(v, f, "binary_big_endian"))), wanted)
        coloured = head.replace(b"property float z\n", b"property float z\nproperty uchar red\nproperty list uchar float weights\n")
        lines = body.split(b"\n")
        lines = [line + b" 7 2 0.5 0.5" if i < 8 else line for i, line in enumerate(lines)]
        self.assertEqual(self.voxels(self.write("extra.ply", coloured + b"end_header\n" + b"\n".join(lines))), wanted)
        doubles = head.replace(b"float", b"double").replace(b"vertex_indices", b"vertex_index")
        self.assertEqual(self.voxels(self.write("double.ply", doubles + b"end_header\n" + body)), wanted)

    def test_26_27_flavours(self):
        v, f = slab()
        wanted = self.sites(self.fine("rock.ply"))
        text = foreign.ply(v, f)
        self.assertEqual(self.sites(self.fine(self.write("crlf.ply", text.replace(b"\n", b"\r\n")))), wanted)
        quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
        self.assertEqual(self.sites(self.fine(self.mesh("quads.ply", v, quads, "ascii"))), wanted)
        obj = "".join(f"v {x} {y} {z}\n" for x, y, z in v) + "\n".join("f " + " ".join(str(i - 8) for i in q) for q in quads)
        self.assertEqual(self.sites(self.fine(self.write("quads.obj", obj))), wanted)
        hexagon = [[0.3, 0, 0], [0.15, 0.26, 0], [-0.15, 0.26, 0], [-0.3, 0, 0], [-0.15, -0.26, 0], [0.15, -0.26, 0]]
        self.fine(self.mesh("hexagon.ply", hexagon, [(0, 1, 2, 3, 4, 5)], "ascii"))

    def test_27_every_flavour_of_obj(self):
        v, _ = foreign.box()
        quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
        vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in v)
        wanted = self.box_volume()

        def faces(form, end="\n"):
            return end.join("f " + " ".join(form(i) for i in q) for q in quads)

        for name, content in (("quads", vertices + faces(lambda i: f"{i + 1}") + "\n"),
                              ("negative", vertices + faces(lambda i: f"{i - 8}") + "\n"),
                              ("slashes", vertices + "vn 0 0 1\nvt 0 0\n" + faces(lambda i: f"{i + 1}/1/1") + "\n"),
                              ("normals", vertices + "vn 0 0 1\n" + faces(lambda i: f"{i + 1}//1") + "\n"),
                              ("no_newline", vertices + faces(lambda i: f"{i + 1}")),
                              ("crlf", (vertices + faces(lambda i: f"{i + 1}") + "\n").replace("\n", "\r\n")),
                              ("long_line", "# " + "x" * 10_000_000 + "\n" + vertices + faces(lambda i: f"{i + 1}") + "\n"),
                              ("groups", "mtllib none.mtl\no box\ng top\nusemtl stone\ns off\n" + vertices + faces(lambda i: f"{i + 1}"))):
            with self.subTest(name=name):
                self.assertEqual(self.voxels(self.write(f"{name}.obj", content)), wanted)

    def test_28_tiny_and_huge_meshes_are_warned_of(self):
        for scale in (1e-6, 1e6):
            v, f = foreign.box()
            v = [[x * scale for x in p] for p in v]
            path = self.write("scaled.ply", foreign.ply(v, f, "binary_little_endian"))
            done = self.succeed(*self.body(path, "--mesh-scale", 1 / scale))
            self.assertIn("warning", done.err)
            self.assertIn("--mesh-scale", done.err)
            self.succeed("info", path)

    def test_28_tiny_meshes(self):
        # What the message says mends it.
        self.both(BAD_INPUT, ["tiny.ply", "6e-07 m across", "sekitei mesh --file", "--scale"], self.mesh("tiny.ply", *slab(1e-6)))
        self.succeed("mesh", "--file", "tiny.ply", "--scale", "1e6", "-o", "metres.ply")
        self.assertEqual(self.sites(self.fine("metres.ply")), self.sites(self.fine("rock.ply")))
        self.fine(self.mesh("small.ply", *slab(1e-2)), "--site", "1mm", "--photon-radius", "2mm", "--cell", "1mm")

    def test_28_huge_meshes_need_more_sites_than_there_are(self):
        self.both(LIMIT, ["sites", "site", "sekitei mesh --file", "--scale"], self.mesh("huge.ply", *slab(1e6)))
        self.fine(self.mesh("large.ply", *slab(1e2)), "--site", "10m", "--photon-radius", "20m", "--cell", "2m")

    def test_29_photons(self):
        for value in ("0", "-1", "1e19"):
            self.both(USAGE, ["photons"], "rock.ply", "--photons", value)
        for value in ("1e15", "1000G"):
            self.both(LIMIT, ["photons"], "rock.ply", "--photons", value)
        self.refuse(LIMIT, ["light", "--memory", "photons"], "light", "rock.ply", "--site", "10cm", "--photons", "1G", "--memory", "1G", "-o", "x.ply")
        self.fine("rock.ply", "--photons", "1")

    def test_30_sun_and_place(self):
        self.write("night.csv", year(datetime.date(2021, 12, 20), 85))
        self.write("summer.csv", year(datetime.date(2021, 6, 20), 40))
        dark = self.light("rock.ply", "--weather", "night.csv", "-o", "night.ply", "--json").json()["summary"]
        self.assertEqual(dark["mean_light"], 0)
        self.moss("rock.ply", "--weather", "night.csv", "--days", "3", "-o", "night_moss.vdb")
        day = self.light("rock.ply", "--weather", "summer.csv", "-o", "summer.ply", "--json").json()["summary"]
        self.assertGreater(day["mean_light"], 20)
        for option, value in (("--latitude", "91"), ("--sun-elevation", "0"), ("--sun-elevation", "-5"), ("--sun-elevation", "91"),
                              ("--open-light", "-1"), ("--sky-light", "-1"), ("--photon-radius", "0"), ("--site", "0"), ("--site", "-1")):
            self.both(USAGE, [option[2:].replace("-", "_")], "rock.ply", option, value)
        self.refuse(USAGE, ["albedo"], "moss", "rock.ply", *MOSS, "--albedo", "1.1", "-o", "x.vdb")
        self.refuse(USAGE, ["cap"], "moss", "rock.ply", *MOSS, "--cap", "0", "-o", "x.vdb")
        self.refuse(USAGE, ["weather"], "light", "rock.ply", *LIGHT, "--sun", "path", "-o", "x.vdb")
        self.refuse(USAGE, ["square_distance"], "light", "rock.ply", *LIGHT, "--sun-light", "square", "--square-distance", "20cm", "-o", "x.vdb")
        self.fine("rock.ply", "--sun-elevation", "0.5")
        self.light("rock.ply", "--sun-light", "square", "-o", "square.ply")


class Rows31to34(SceneTest):
    """Columns and heat."""

    def test_31_columns_that_do_not_fit(self):
        self.refuse(USAGE, ["spacing", "> 0"], "joint", self.cooled, "--spacing", "-10cm", "-o", "x.vdb")
        self.refuse(USAGE, ["seed_radius", "> 0"], "joint", self.cooled, "--seed-radius", "0", "-o", "x.vdb")
        self.refuse(USAGE, ["radius"], "joint", self.cooled, "--count", 400, "--seed-radius", "1m", "-o", "x.vdb")
        self.refuse(USAGE, ["count", "1 to"], "joint", self.cooled, "--count", "0", "-o", "x.vdb")
        done = self.run_in_folder("joint", self.cooled, "--spacing", "100m", "-o", "x.vdb")
        self.assertIn(done.code, (USAGE, DONE), done)
        if done.code == USAGE:
            self.assertIn("100", done.err)
        self.succeed("joint", self.cooled, "--count", 9, "-o", "y.vdb")

    def test_31_a_spacing_below_the_voxels_is_named(self):
        for spacing in ("1um", "1mm", "5cm"):
            self.refuse(USAGE, ["spacing", "voxels wide"], "joint", self.cooled, "--spacing", spacing, "-o", "x.vdb")

    def test_32_lava_that_is_as_hot_as_its_surroundings(self):
        self.refuse(BAD_INPUT, ["cooling surface"], "cool", self.lava, "--lava-temperature", "500", "--cold-temperature", "500",
                    "--slow-temperature", "500", "-o", "x.vdb")
        # No step taken: the lava is isothermal, but its contact with the cold is not.
        self.succeed("cool", self.lava, "--steps", "1", "-o", "x.vdb")

    def test_33_no_lava_in_any_voxel(self):
        outside = pyopenvdb.FloatGrid(0.3)  # positive is outside
        outside.name = "body_sdf"
        outside.fill((0, 0, 0), (9, 9, 9), 0.2)
        outside.gridClass = pyopenvdb.GridClass.LEVEL_SET
        path = foreign.write(self.folder / "outside.vdb", outside)
        self.refuse(BAD_INPUT, ["outside.vdb", "lava"], "lava", "--preset", "volume", "--volume", path, "-o", "x.vdb")
        inside = foreign.level_set("body_sdf", centre=(5000, -3000, 80))
        path = foreign.write(self.folder / "inside.vdb", inside)
        self.succeed("lava", "--preset", "volume", "--volume", path, "-o", "x.vdb", *BODY)

    def test_34_unstable_steps(self):
        self.refuse(USAGE, ["alpha", "1/6"], "cool", self.lava, "--alpha", "0.2", "-o", "x.vdb")
        self.refuse(USAGE, ["alpha", "> 0"], "cool", self.lava, "--alpha", "0", "-o", "x.vdb")
        self.succeed("cool", self.lava, "--alpha", "0.1666", "-o", "x.vdb")
        self.succeed("cool", self.lava, "--alpha", "0.17", "--allow-unstable", "--steps", "3", "-o", "y.vdb")
        done = self.run_in_folder("cool", self.lava, "--alpha", "100", "--allow-unstable", "--steps", "10000", "-o", "z.vdb", timeout=20)
        self.assertEqual(done.code, BAD_INPUT, done)
        self.assertIn("alpha", done.err)
        self.assertFalse((self.folder / "z.vdb").exists())


class Rows35to37(HabitatTest):
    """Mosses and weather."""

    def test_35_species_files_are_checked_by_line(self):
        good = (DATA / "species" / "bryum.toml").read_text()
        line = {name: next(i for i, l in enumerate(good.split("\n"), 1) if l.startswith(name)) for name in
                ("temperature_low", "temperature_high", "temperature_softness", "growth_threshold")}
        self.write("own.toml", good)
        self.succeed("moss", self.soil, "--species", "own.toml,hypnum", "-o", "own.vdb")
        self.assertIn("suit_own", {g["name"] for g in self.info("own.vdb")["grids"]})

        def bad(name, value, words):
            self.write("bad.toml", re.sub(rf"(?m)^{name} = .*$", f"{name} = {value}", good))
            self.refuse(USAGE, [f"bad.toml:{line[name]}:", *words], "moss", self.soil, "--species", "bad.toml", "-o", "x.vdb")

        bad("temperature_high", '"1C"', ["temperature_high = 274.15", "> temperature_low"])
        bad("temperature_high", '"-3C"', ["temperature_high", "temperature_low"])
        bad("temperature_softness", "0", ["temperature_softness = 0", "> 0"])
        bad("temperature_softness", "1.5", ["temperature_softness = 1.5", "<= 1"])
        bad("growth_threshold", "1", ["growth_threshold"])
        bad("temperature_low", '"warm"', ["temperature_low"])
        self.write("bad.toml", good.replace("humidity_low", "humidty_low"))
        self.refuse(USAGE, ["bad.toml:", "humidty_low", "humidity_low"], "moss", self.soil, "--species", "bad.toml", "-o", "x.vdb")
        self.write("earth.toml", (DATA / "soils" / "humus.toml").read_text().replace("porosity = 0.490", "porosity = -1"))
        self.refuse(USAGE, ["earth.toml:6:", "porosity = -1"], "soil", self.wind, "--soil", "earth.toml", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["none.toml"], "moss", self.soil, "--species", "none.toml", "-o", "x.vdb")

    def bad(self, content, words, code=BAD_INPUT, *options):
        self.write("w.csv", content)
        done = self.refuse(code, words, "light", self.lantern, "--weather", "w.csv", "-o", "x.vdb", *options)
        self.assertNotIn("lantern.vdb", done.err, "the scene is not to blame")
        return done

    def test_36_00_the_good_twin(self):
        for content in (HEAD, "\ufeff" + HEAD, HEAD.replace(",", ";")):
            separator = ";" if ";" in content else ","
            self.write("w.csv", content + separator.join(["2023-01-01", "1", "70", "0", "2", "3"]) + "\n")
            self.succeed("light", self.lantern, "--weather", "w.csv", "-o", "x.vdb", "--force")

    def test_36_each_mistake_is_named_with_its_place(self):
        day = "2023-01-01,1,70,0,2,3\n"
        self.bad(HEAD + day + "2023-01-03,1,70,0,2,3\n", ["w.csv:5:1", "2023-01-02", "interpolate"])
        self.bad(HEAD + "2023-02-28,1,70,0,2,3\n2023-02-30,1,70,0,2,3\n", ["w.csv:5:1", "2023-02-30"])
        self.bad(HEAD + "2023-01-01,1,70,0,-1,3\n", ["w.csv:4:", "wind_speed", "-1"])
        self.bad(HEAD + "2023-01-01,1,130,0,2,3\n", ["w.csv:4:", "humidity", "130"])
        self.bad(HEAD + "2023-01-01,warm,70,0,2,3\n", ["w.csv:4:12", "warm"])
        self.bad(HEAD + "2023-01-01,nan,70,0,2,3\n", ["w.csv:4:12"])
        self.bad(HEAD + "2023-01-01,1,70,0,2,23\n", ["w.csv:4:", "sunshine", "latitude"])
        self.bad(HEAD.encode() + "2023-01-01,1,70,0,2,3 雨\n".encode("shift_jis"), ["w.csv:4:", "UTF-8"])
        self.bad((HEAD + day).encode("utf-16"), ["w.csv", "UTF-16"])
        self.bad("", ["w.csv", "empty"])
        self.bad(HEAD, ["w.csv:", "no days"])
        self.bad(HEAD.replace("humidity [%],", "") + "2023-01-01,1,0,2,3\n", ["w.csv:3", "humidity is missing"])
        self.bad(HEAD.replace("temperature [C]", "temprature [C]") + day, ["w.csv:3", "temprature", "temperature"])
        self.bad(HEAD.replace("[C]", "[X]") + day, ["w.csv:3", "X"])
        self.bad(HEAD.replace("# latitude = 40 deg\n", "") + day, ["w.csv", "latitude"])
        self.bad(bytes(range(256)) * 20, ["w.csv"])
        self.refuse(BAD_INPUT, ["none.csv"], "light", self.lantern, "--weather", "none.csv", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["folder"], "light", self.lantern, "--weather", self.folder, "-o", "x.vdb")
        self.refuse(USAGE, ["weather"], "light", self.lantern, "-o", "x.vdb")

    def test_36_all_mistakes_are_listed_at_once(self):
        done = self.bad(HEAD + "2023-01-01,1,130,0,-1,3\n2023-01-02,x,70,-2,2,30\n", [])
        self.assertEqual(sorted(set(re.findall(r"w\.csv:(\d+):\d+", done.err))), ["4", "5"])
        self.assertEqual(len(re.findall(r"w\.csv:\d+:\d+", done.err)), 5, done.err)

    def test_36_a_line_that_is_wrong_on_each_of_its_days_is_told_briefly(self):
        done = self.refuse(BAD_INPUT, ["more like it", "latitude"], "light", self.lantern, "--weather",
                           DATA / "weather" / "morioka-normals.csv", "--latitude", "80", "-o", "x.vdb")
        self.assertLess(done.err.count("\n"), 60)

    def test_37_length_and_place(self):
        self.refuse(USAGE, ["days = 71", "70", "--repeat-year"], "light", self.lantern, *DAYS, "--days", "71", "-o", "x.vdb")
        self.refuse(USAGE, ["whole year"], "light", self.lantern, *DAYS, "--days", "71", "--repeat-year", "-o", "x.vdb")
        self.refuse(USAGE, ["first_day = 70", "70 days"], "light", self.lantern, *DAYS, "--first-day", "70", "-o", "x.vdb")
        self.refuse(USAGE, ["latitude = 91", "-90 to 90"], "light", self.lantern, *DAYS, "--latitude", "91", "-o", "x.vdb")
        self.refuse(USAGE, ["longitude", "-180 to 180"], "light", self.lantern, *DAYS, "--longitude", "200", "-o", "x.vdb")
        self.refuse(USAGE, ["days = 71", "70", "--repeat-year"], "moss", self.soil, "--days", "71", "-o", "x.vdb")
        self.refuse(USAGE, ["whole year"], "moss", self.soil, "--days", "71", "--repeat-year", "-o", "x.vdb")
        self.succeed("light", self.lantern, *DAYS, "--days", "70", "-o", "all.vdb")
        self.write("year.csv", spring_weather(365))
        self.succeed("light", self.lantern, "--weather", "year.csv", "--days", "400", "--repeat-year", "-o", "repeated.vdb")


class Rows38(RecipeTest):
    """Recipes; every key of every stage is in recipe_test."""

    def test_38_a_good_recipe_is_good(self):
        self.recipe()
        done = self.succeed("check", "rock.toml", "--json")
        self.assertEqual(done.json()[0]["errors"], [])

    def test_38_unknown_keys_get_the_nearest(self):
        self.check(["rock.toml:16:1", "joint.spacin", "spacing"], RECIPE.replace("spacing =", "spacin  ="))
        self.check(["rock.toml:3:1", "owt", "sekitei, seed, out"], RECIPE.replace("out =", "owt ="))
        self.check(["rock.toml:15:1", "jont", "joint"], RECIPE.replace("[joint]", "[jont]"))
        self.check(["rock.toml:", "meshh", "mesh"], RECIPE.replace('"mesh"', '"meshh"'))

    def test_38_wrong_types_and_ranges(self):
        for good, bad, words in (('spacing = "40cm"', "spacing = true", ["joint", "spacing", "true", "number [m], > 0"]),
                                 ('spacing = "40cm"', 'spacing = -0.4', ["spacing = -0.4 m", "must be > 0"]),
                                 ('spacing = "40cm"', 'spacing = nan', ["spacing", "finite"]),
                                 ('spacing = "40cm"', 'spacing = "40K"', ["40K", "m"]),
                                 ('spacing = "40cm"', 'spacing = 1979-05-27', ["spacing", "date"]),
                                 ('spacing = "40cm"', 'spacing = [1, 2]', ["spacing", "number"]),
                                 ('steps = 40', "steps = 4.5", ["steps", "4.5", "integer"]),
                                 ('steps = 40', "steps = 99999999999999", ["steps", "0 to"]),
                                 ('steps = 40', "steps = -1", ["steps", "0 to"]),
                                 ('cut = "perpendicular"', 'cut = "perpendiclar"', ["cut", "perpendicular", "did you mean"]),
                                 ('cut = "perpendicular"', 'cut = 3', ["cut", "none, horizontal, perpendicular"]),
                                 ('size = ["1.6m", "1.6m", "1.6m"]', 'size = ["1.6m", "1.6m"]', ["size", "three numbers"]),
                                 ('seed = 7', 'seed = "seven"', ["rock.toml:2:8", "seed", "integer"]),
                                 ('seed = 7', 'seed = -7', ["rock.toml:2:8", "seed", "integer"]),
                                 ('out = "out"', 'out = 3', ["rock.toml:3:7", "out"]),
                                 ('out = "out"', 'out = []', ["rock.toml:3:7", "out"]),
                                 ('sekitei = 1', 'sekitei = 2', ["rock.toml:1:11", "version 1"]),
                                 ('sekitei = 1', '', ["sekitei = 1"]),
                                 ('write = "rock.png"', 'write = 5', ["write", "name"])):
            with self.subTest(bad=bad):
                self.check(["rock.toml:", *words], RECIPE.replace(good, bad))

    def test_38_duplicate_tables(self):
        self.check(["rock.toml:34:", "cool"], RECIPE.rstrip("\n") + "\n[cool]\nsteps = 3\n")
        self.check(["rock.toml:"], RECIPE.replace("seed = 7", "seed = 7\nseed = 8"))

    def test_38_stages_that_read_each_other(self):
        self.check(["rock.toml:12:1", "cool", "joint", "wait for each other"], RECIPE.replace("steps = 40", 'from = "joint"'))
        self.check(["wait for each other"], RECIPE.replace("steps = 40", 'from = "cool"'))

    def test_38_a_stage_that_is_not_there(self):
        self.check(["picture.from", "'rokc'", "did you mean 'rock'"], RECIPE.replace('from = "rock"', 'from = "rokc"'))
        self.check(["cool", "needs 'region_coarse'", "lava"], "sekitei = 1\n[cool]\n")
        self.check(["weather", "'column'", "joint"], "sekitei = 1\n[lava]\n[cool]\n[weather]\n")
        self.check(["no stage", "[lava]"], "sekitei = 1\n")
        self.check(["lava.from", "reads no other"], RECIPE.replace("[lava]", '[lava]\nfrom = "cool"'))

    def test_38_huge_and_deeply_nested_recipes_are_refused_quickly(self):
        path = self.folder / "huge.toml"
        with path.open("w") as file:
            file.write("sekitei = 1\n")
            line = "# " + "x" * 997 + "\n"
            for _ in range(1000):
                file.write(line * 100)
        self.assertGreater(path.stat().st_size, 100_000_000)
        self.assertLess(self.refuse(USAGE, ["huge.toml", "MB"], "check", "huge.toml").seconds, 2)
        self.assertLess(self.refuse(USAGE, ["huge.toml", "MB"], "run", "huge.toml").seconds, 2)
        path.unlink()
        self.check(["rock.toml:"], "a = " + "[" * 100_000)
        self.check(["rock.toml:"], RECIPE + "\nx = " + "[" * 20_000 + "]" * 20_000 + "\n")
        self.check(["rock.toml:"], "a" + ".a" * 100_000 + " = 1\n")
        self.check(["rock.toml:"], "sekitei = 1\n" + "".join(f"[s{i}]\n" for i in range(5_000)))


class Rows39to42(SceneTest):
    """Where results go; failure_test and kill_test fail and stop the program at every call and at random."""

    def test_39_folders_that_cannot_take_a_file(self):
        self.write("file", "a file")
        (self.folder / "folder.vdb").mkdir()
        for target, words in (("missing/out.vdb", ["missing", "no such folder"]), ("file/out.vdb", ["file", "expected a folder"]),
                              ("folder.vdb", ["folder.vdb", "folder"])):
            with self.subTest(target=target):
                # Said before anything is computed: ten million steps take longer than a refusal may.
                self.refuse(CANNOT_WRITE, words, "cool", self.lava, "--steps", "9999999", "-o", target)
        self.recipe()
        self.refuse(CANNOT_WRITE, ["file"], "run", "rock.toml", "--set", "out=file")
        self.refuse(CANNOT_WRITE, ["file"], "run", "rock.toml", "--set", "out=file/below")
        self.succeed("run", "rock.toml", "--set", "out=new/folder/below", "--only", "lava", "-q")

    def test_39_a_read_only_folder(self):
        with small_disk(self.folder / "disk", "size=4m") as disk:
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
            self.refuse(CANNOT_WRITE, ["disk", "read-only"], "cool", self.lava, "--steps", "9999999", "-o", "disk/out.vdb")
            self.recipe()
            self.refuse(CANNOT_WRITE, ["disk", "read-only"], "run", "rock.toml", "--set", "out=disk/out")

    def test_39_a_folder_of_somebody_else(self):
        if os.getuid() == 0:
            self.skipTest("root may write everywhere")
        (self.folder / "closed").mkdir(mode=0o555)
        self.refuse(CANNOT_WRITE, ["closed", "permission"], "cool", self.lava, "-o", "closed/out.vdb")

    def test_40_a_full_disk_names_need_and_space_and_keeps_the_old_file(self):
        with small_disk(self.folder / "disk", "size=64k") as disk:
            (disk / "out.vdb").write_bytes(b"old")
            for command, source, options, name in (("lava", None, LAVA, "out.vdb"), ("cool", self.lava, COOL, "out.vdb"),
                                                   ("joint", self.cooled, JOINT, "out.vdb"),
                                                   ("weather", self.joints, WEATHER, "out.vdb"), ("mesh", self.weathered, [], "out.ply"),
                                                   ("mesh", self.weathered, [], "out.obj"), ("mesh", self.weathered, [], "out.glb")):
                with self.subTest(command=command, name=name):
                    self.refuse(CANNOT_WRITE, [name, "no space", "needed", "free"], command, *([source] if source else []),
                                       *options, "--force", "-o", disk / name)
            self.assertEqual((disk / "out.vdb").read_bytes(), b"old")
            self.assertEqual([p.name for p in disk.iterdir()], ["out.vdb"])
        with small_disk(self.folder / "disk", "size=8m"):
            self.succeed("cool", self.lava, *COOL, "-o", "disk/out.vdb")

    def test_40_a_disk_that_fills_at_any_byte_of_a_run(self):
        self.recipe()
        self.succeed("run", "rock.toml", "-q", "--set", "out=good")
        good = files_in(self.folder / "good")
        whole = sum(len(c) for c in files_in(self.folder / "good", hidden=True).values())
        (self.folder / "disk").mkdir()
        for share in (0.02, 0.2, 0.4, 0.6, 0.8, 0.9, 0.97):
            with self.subTest(share=share), small_disk(self.folder / "disk", f"size={int(whole * share) // 4096 * 4}k") as disk:
                done = self.run_in_folder("run", "rock.toml", "-q", "--set", f"out={disk}/out")
                self.assertEqual(done.code, CANNOT_WRITE, done)
                self.assertIn("no space", done.err)
                self.assertEqual(temporaries(disk), [])
                for name, content in files_in(disk / "out").items():
                    self.assertSameBytes(content, good[name], name)
                # More room, and it goes on to the same end.
                subprocess.run(["mount", "-o", f"remount,size={whole * 4}", str(disk)], check=True)
                self.succeed("run", "rock.toml", "-q", "--set", f"out={disk}/out")
                self.assertSameFiles(files_in(disk / "out"), good)

    def test_40_devices_and_full_pipes(self):
        (self.folder / "device.vdb").symlink_to("/dev/full")
        self.refuse(CANNOT_WRITE, ["pipe or device"], "cool", self.lava, "-o", "device.vdb", "--force")
        for arguments in (f"mesh {self.weathered} -o -", f"cool {self.lava} -o -", f"info {self.lava}", "schema", "completions bash",
                          f"cool {self.lava} -o x.vdb --force --json", f"replay {self.lava}", f"render {self.mesh} --width 64 --samples 1 -o -"):
            done = bash(f'"$SEKITEI" {arguments} > /dev/full', self.folder)
            self.assertEqual(done.code, CANNOT_WRITE, f"{arguments}: {done}")
            self.assertRegex(done.err, "cannot write to (standard output|the pipe)")

    def test_41_names(self):
        for name in ("苔.vdb", "with space.vdb", "-dash.vdb", "x" * 251 + ".vdb", "é" * 125 + "x.vdb", "a\nb.vdb", "*.vdb", ".hidden.vdb",
                     "%n%s.vdb"):
            with self.subTest(name=name):
                self.succeed("cool", self.lava, *COOL, "--seed", 7, "-o", f"./{name}")
                self.assertSameBytes(self.folder / name, self.cooled)
                self.succeed("joint", f"./{name}", *JOINT, "-o", "next.vdb", "--force")
                self.succeed("info", f"./{name}")
        self.assertEqual(temporaries(self.folder), [])
        self.refuse(CANNOT_WRITE, ["256 bytes"], "cool", self.lava, "-o", "x" * 252 + ".vdb")

    def test_41_symbolic_links_are_followed_and_stay(self):
        (self.folder / "elsewhere").mkdir()
        (self.folder / "link.vdb").symlink_to("elsewhere/real.vdb")
        self.succeed("cool", self.lava, *COOL, "--seed", 7, "-o", "link.vdb")
        self.assertTrue((self.folder / "link.vdb").is_symlink())
        self.assertSameBytes(self.folder / "elsewhere/real.vdb", self.cooled)
        self.refuse(USAGE, ["link.vdb", "--force"], "cool", self.lava, "-o", "link.vdb")
        (self.folder / "broken.vdb").symlink_to("nowhere/real.vdb")
        self.refuse(CANNOT_WRITE, ["broken.vdb", "no such folder"], "cool", self.lava, "-o", "broken.vdb")
        (self.folder / "circle.vdb").symlink_to("circle.vdb")
        self.refuse(CANNOT_WRITE, ["circle.vdb"], "cool", self.lava, "-o", "circle.vdb")

    def test_41_pipes_with_names_are_refused_and_do_not_hang(self):
        os.mkfifo(self.folder / "pipe.vdb")
        self.refuse(CANNOT_WRITE, ["pipe.vdb", "use -"], "cool", self.lava, "-o", "pipe.vdb", "--force")

    def test_41_output_may_be_the_input_only_by_force(self):
        shutil.copy(self.lava, self.folder / "scene.vdb")
        self.refuse(USAGE, ["scene.vdb", "--force"], "cool", "scene.vdb", "-o", "scene.vdb")
        self.refuse(USAGE, ["--force"], "cool", "scene.vdb", "-o", "./scene.vdb")
        os.link(self.folder / "scene.vdb", self.folder / "hard.vdb")
        self.succeed("cool", "scene.vdb", *COOL, "--seed", 7, "-o", "scene.vdb", "--force")
        self.assertSameBytes(self.folder / "scene.vdb", self.cooled)
        self.assertSameBytes(self.folder / "hard.vdb", self.lava, "another name of the old file keeps the old content")

    def test_41_an_existing_file_is_replaced_only_by_force(self):
        self.write("out.vdb", "precious")
        self.refuse(USAGE, ["out.vdb", "--force"], "cool", self.lava, "-o", "out.vdb")
        self.succeed("cool", self.lava, *COOL, "--seed", 7, "-o", "out.vdb", "--force")
        self.assertSameBytes(self.folder / "out.vdb", self.cooled)

    def test_41_a_mesh_beside_a_scene_is_replaced_only_by_force_too(self):
        self.write("rock.ply", "precious")
        self.refuse(USAGE, ["rock.ply", "--force"], "mesh", self.weathered, "-o", "rock.vdb")
        self.succeed("mesh", self.weathered, "-o", "rock.vdb", "--force")
        self.assertSameBytes(self.folder / "rock.ply", self.mesh)
        grids = {g["name"] for g in self.succeed("info", "rock.vdb", "--json").json()[0]["grids"]}
        self.assertIn("temperature", grids, "a scene keeps what the command did not make")

    def test_41_two_outputs_of_one_name_are_told(self):
        self.refuse(USAGE, ["twice"], "mesh", self.weathered, "-o", "a.ply", "-o", "./a.ply")
        self.refuse(USAGE, ["twice"], "mesh", self.weathered, "-o", "-", "-o", "-")

    def test_42_a_reader_that_goes_away(self):
        for arguments in (f"mesh {self.weathered} -o -", f"cool {self.lava} -o -", "schema", f"info {self.weathered}"):
            done = bash(f'"$SEKITEI" {arguments} -q | head -c 100 > taken; echo "${{PIPESTATUS[0]}}"', self.folder)
            self.assertIn(int(done.out), (DONE, CANNOT_WRITE, 141), f"{arguments}: {done}")
            self.assertNotIn("terminate", done.err)
            self.assertNotIn("bug", done.err)
        self.assertEqual(temporaries(self.folder), [])

    def test_42_closed_standard_input(self):
        done = bash('"$SEKITEI" cool - -o x.vdb <&-', self.folder)
        self.assertEqual(done.code, 3, done)
        self.succeed("cool", self.lava, *COOL, "-o", "y.vdb")
        done = bash(f'"$SEKITEI" cool {self.lava} {" ".join(COOL)} --seed 7 -o z.vdb <&-', self.folder)
        self.assertEqual(done.code, DONE, done)
        self.assertSameBytes(self.folder / "z.vdb", self.cooled)


class Rows42Signals(CliTest):
    """Random moments of a whole run are in kill_test, each of its calls in failure_test."""

    def started(self, *arguments):
        """A command at work on something that takes long."""
        run("lava", "--preset", "slab", "--size", "2.4m,2.4m,2.4m", "--voxel", "4cm", "--heat-cell", "4cm", "-o", self.folder / "lava.vdb", "-q")
        process = start(["cool", "lava.vdb", "--steps", "9999999", "-o", "cooled.vdb", *arguments], cwd=self.folder)
        time.sleep(0.5)
        self.assertIsNone(process.poll(), "it should still be at work")
        return process

    def test_42_signals_end_a_command_within_a_second(self):
        for which, expected in ((signal.SIGINT, INTERRUPTED), (signal.SIGTERM, TERMINATED)):
            process = self.started()
            code, seconds, err = stop(process, which)
            self.assertEqual(code, expected, err)
            self.assertLess(seconds, 1, "it should stop within a second")
            self.assertIn("interrupted", err)
            self.assertEqual(sorted(p.name for p in self.folder.iterdir()), ["lava.vdb"])
            (self.folder / "lava.vdb").unlink()

    def test_42_the_old_file_survives(self):
        self.write("cooled.vdb", "the old file")
        process = self.started("--force")
        code, _, _ = stop(process, signal.SIGINT)
        self.assertEqual(code, INTERRUPTED)
        self.assertEqual((self.folder / "cooled.vdb").read_text(), "the old file")

    def test_42_a_second_signal_ends_at_once(self):
        process = self.started()
        process.send_signal(signal.SIGINT)
        code, _, _ = stop(process, signal.SIGINT)
        self.assertEqual(code, INTERRUPTED)


class Rows43(CheckpointTest):
    """Checkpoints of recipes."""

    def test_43_a_damaged_checkpoint_is_refused_by_name(self):
        checkpoint = self.interrupted()
        good = checkpoint.read_bytes()
        flipped = bytearray(good)
        flipped[len(good) // 2] ^= 8
        for bad in (bytes(flipped), good[:-1], good[:100], b"", b"other words\n" * 50):
            checkpoint.write_bytes(bad)
            done = self.refuse(BAD_INPUT, [checkpoint.name], "run", "cooling.toml", "-q")
            self.assertIn("remove", done.err, "it says how to go on")
        checkpoint.write_bytes(good)
        self.succeed("run", "cooling.toml", "-q")
        self.succeed("run", "cooling.toml", "-q", "--set", "out=good")
        self.assertSameFiles(files_in(self.folder / "out"), files_in(self.folder / "good"))

    def test_43_a_checkpoint_of_another_run_is_refused_and_says_why(self):
        checkpoint = self.interrupted()
        foreign = checkpoint.read_bytes()
        process = start(["run", "cooling.toml", "-q", "--set", "cool.alpha=0.05"], cwd=self.folder)
        time.sleep(0.5)
        stop(process, signal.SIGINT)
        others = [p for p in checkpoint.parent.glob("cool-*.checkpoint") if p != checkpoint]
        self.assertEqual(len(others), 1, "another run has a checkpoint of its own")
        others[0].write_bytes(foreign)
        self.refuse(BAD_INPUT, [others[0].name, "alpha"], "run", "cooling.toml", "-q", "--set", "cool.alpha=0.05")


class Rows43Moss(HabitatTest):
    """Checkpoints that a command was given."""

    def test_43_a_checkpoint_by_hand_belongs_to_one_run(self):
        text = ["moss", self.soil, "--checkpoint", "c.state"]
        self.succeed(*text, "-o", "a.vdb")
        state = (self.folder / "c.state").read_bytes()
        self.succeed(*text, "-o", "b.vdb")
        self.assertEqual([], [n for n in ("moss_growth", "seed_age") if self.run_in_folder("diff", "a.vdb", "b.vdb").code])
        self.refuse(BAD_INPUT, ["c.state", "seed"], *text, "--seed", "5", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["c.state"], *text, "--growth-rate", "0.5", "-o", "x.vdb")
        for damage in (b"", state[:100], state[:-1], state[:60] + b"?" + state[61:], b"x" + state):
            self.write("c.state", damage)
            self.refuse(BAD_INPUT, ["c.state"], *text, "-o", "x.vdb")


class Rows44(SceneTest):
    """Little of everything."""

    def test_44_closed_standard_output_and_error(self):
        done = bash(f'"$SEKITEI" info {self.lava} >&-', self.folder)
        self.assertEqual(done.code, CANNOT_WRITE, done)
        for closed in (">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"):
            done = bash(f'"$SEKITEI" joint {self.cooled} {" ".join(JOINT)} --seed 7 -v -o x.vdb --force {closed}', self.folder)
            self.assertEqual(done.code, DONE, f"{closed} {done}")
            self.assertSameBytes(self.folder / "x.vdb", self.joints, closed)
        self.recipe()
        for i, closed in enumerate((">&-", "2>&-", "<&- >&- 2>&-")):
            done = bash(f'"$SEKITEI" run rock.toml -v --set out=out{i} {closed}', self.folder)
            self.assertEqual(done.code, DONE, f"{closed} {done}")
            self.assertEqual((self.folder / f"out{i}/.sekitei/lock").stat().st_size, 0, "words went into a file")
            self.assertSameBytes(self.folder / f"out{i}/rock.vdb", self.weathered, closed)

    def test_44_little_address_space(self):
        # The whole chain in 2 GB of address space gives the same files.
        limits = [(resource.RLIMIT_AS, 2 << 30)]
        self.succeed("lava", *LAVA, "--seed", 7, "-o", "lava.vdb", limits=limits)
        self.succeed("cool", "lava.vdb", *COOL, "--seed", 7, "-o", "cooled.vdb", limits=limits)
        self.succeed("joint", "cooled.vdb", *JOINT, "--seed", 7, "-o", "joints.vdb", limits=limits)
        self.succeed("weather", "joints.vdb", *WEATHER, "--seed", 7, "-o", "weathered.vdb", limits=limits)
        self.succeed("mesh", "weathered.vdb", "-o", "rock.ply", limits=limits)
        self.succeed("render", "rock.ply", *RENDER, "--seed", 7, "-o", "rock.png", limits=limits)
        for name in ("lava.vdb", "cooled.vdb", "joints.vdb", "weathered.vdb", "rock.ply", "rock.png"):
            self.assertSameBytes(self.folder / name, self.scenes / name)

    def test_44_too_little_address_space_is_a_limit(self):
        for megabytes in (60, 120, *range(140, 180, 3), 200, 250, 300):
            limits = [(resource.RLIMIT_AS, megabytes << 20)]
            if run("--version", limits=limits).code != DONE:
                continue  # the loader or a library gives up before main() begins
            done = self.run_in_folder("joint", self.cooled, *JOINT, "-o", f"x{megabytes}.vdb", limits=limits)
            self.assertIn(done.code, (DONE, LIMIT), f"{megabytes} MB: {done}")
            self.assertEqual(temporaries(self.folder), [])

    def test_44_few_open_files_and_little_stack(self):
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "-o", "x.vdb", limits=[(resource.RLIMIT_NOFILE, 16), (resource.RLIMIT_STACK, 1 << 20)])
        self.assertSameBytes(self.folder / "x.vdb", self.joints)

    def test_44_files_of_a_limited_size(self):
        done = self.run_in_folder("joint", self.cooled, *JOINT, "-o", "x.vdb", limits=[(resource.RLIMIT_FSIZE, 20_000)])
        self.assertEqual(done.code, CANNOT_WRITE, done)
        self.assertEqual(list(self.folder.iterdir()), [])

    def test_44_ten_thousand_threads(self):
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "--threads", "10000", "-o", "x.vdb")
        self.assertSameBytes(self.folder / "x.vdb", self.joints)

    def test_44_an_empty_environment(self):
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "-o", "x.vdb", env={"PATH": ""})
        self.assertSameBytes(self.folder / "x.vdb", self.joints)
        nowhere = environment(HOME="/nonexistent", TMPDIR="/nonexistent", TERM="nonsense", LC_ALL="nonsense")
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "-o", "y.vdb", env=nowhere)
        self.assertSameBytes(self.folder / "y.vdb", self.joints)

    def test_44_one_processor(self):
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "-o", "good.vdb")
        done = bash(f'taskset -c $(taskset -cp $$ | grep -o "[0-9]*$") "$SEKITEI" joint {self.cooled} {" ".join(JOINT)} --seed 7 -o x.vdb',
                    self.folder)
        self.assertEqual(done.code, DONE, done)
        self.assertSameBytes(self.folder / "x.vdb", self.joints)

    def test_44_a_clock_that_jumps(self):
        """The clock on the wall says another year at each look."""
        self.recipe()
        for out, jumps in (("good", "0"), ("out", "1"), ("out", "1")):
            env = environment(LD_PRELOAD=str(FAULTS), FAULT_CLOCK=jumps, ASAN_OPTIONS=os.environ.get("ASAN_OPTIONS", "") + ":verify_asan_link_order=0")
            self.succeed("run", "rock.toml", "-q", "--set", f"out={out}", env=env)
        self.assertSameFiles(files_in(self.folder / "out"), files_in(self.folder / "good"))


if __name__ == "__main__":
    unittest.main()
