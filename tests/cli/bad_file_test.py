"""Files that are broken, foreign or not what a stage needs, each beside a good twin."""

import json
import os
import random
import resource
import struct
import unittest

import foreign
from foreign import pyopenvdb
from support import BAD_INPUT, DIFFER, DONE, LIMIT, USAGE, SceneTest, run

BODY = ["--voxel", "8cm", "--heat-cell", "16cm"]


class Volumes(SceneTest):
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
        foreign.write(path, foreign.level_set("rock"), foreign.level_set("stone", radius=0.3))
        self.succeed("mesh", path, "--grid", "rock", "-o", "x.ply")

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
        path = foreign.write(self.folder / "body.vdb", foreign.level_set("body_sdf"), foreign.level_set("slow_sdf", voxel=0.05, radius=0.2))
        done = self.run_in_folder("lava", "--preset", "volume", "--volume", path, "-o", "x.vdb", *BODY)
        if done.code == DONE:  # level sets may be resampled in space, never voxel by voxel
            same = foreign.write(self.folder / "same.vdb", foreign.level_set("body_sdf"), foreign.level_set("slow_sdf", radius=0.2))
            self.succeed("lava", "--preset", "volume", "--volume", same, "-o", "y.vdb", *BODY)
            a, b = (self.succeed("info", name, "--json").json()[0]["grids"] for name in ("x.vdb", "y.vdb"))
            counts = [next(g["active_voxels"] for g in grids if g["name"] == "region") for grids in (a, b)]
            self.assertAlmostEqual(counts[0], counts[1], delta=0.02 * counts[1])
        else:
            self.assertEqual(done.code, BAD_INPUT, done)
            self.assertIn("slow_sdf", done.err)

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

    def test_foreign_grids_travel_through(self):
        path = foreign.write(self.folder / "body.vdb", foreign.level_set("body_sdf"))
        self.succeed("lava", "--preset", "volume", "--volume", path, "-o", "x.vdb", *BODY)
        self.succeed("cool", "x.vdb", "--steps", "20", "-o", "y.vdb")
        names = {g["name"] for g in self.succeed("info", "y.vdb", "--json").json()[0]["grids"]}
        self.assertLessEqual({"region", "temperature"}, names)

    def test_paths_that_are_no_files(self):
        os.mkfifo(self.folder / "pipe.vdb")
        for path, word in ((self.folder, "folder"), ("pipe.vdb", "pipe"), ("/dev/zero", "device"), ("nowhere.vdb", "no such file"),
                           ("", "")):
            self.refuse(BAD_INPUT, [word], "cool", path, "-o", "out.vdb")


class Meshes(SceneTest):
    def body(self, path, *options):
        return ["lava", "--preset", "mesh", "--mesh", path, "-o", "body.vdb", "--force", *BODY, *options]

    def voxels(self, path, *options):
        return self.succeed(*self.body(path, *options), "--json").json()["summary"]["voxels"]

    def box_volume(self):
        v, f = foreign.box()
        return self.voxels(self.write("good.ply", foreign.ply(v, f)))

    def test_00_the_good_twin(self):
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

    def test_18_a_mesh_that_is_not_a_manifold(self):
        v, f = foreign.box()
        v = v + [[0.8, 0.8, 2.0]]
        path = self.write("fin.ply", foreign.ply(v, [*f, (4, 7, 8)]))
        done = self.succeed(*self.body(path))
        self.assertIn("manifold", done.err)
        self.refuse(BAD_INPUT, ["manifold"], *self.body(path, "--strict"))

    def test_19_triangles_without_area_and_double_vertices_are_counted(self):
        v, f = foreign.box()
        path = self.write("dirty.ply", foreign.ply([*v, v[0], v[5]], [*f, (0, 0, 1), (0, 8, 3), (5, 9, 5)]))
        done = self.succeed(*self.body(path), "--json")
        self.assertEqual(done.json()["summary"]["voxels"], self.box_volume())
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

    def test_21_vertices_that_are_no_numbers(self):
        v, f = foreign.box()
        for value in (float("nan"), float("inf")):
            bad = [list(x) for x in v]
            bad[3][1] = value
            for form in ("ascii", "binary_little_endian"):
                self.refuse(BAD_INPUT, ["nan.ply"], *self.body(self.write("nan.ply", foreign.ply(bad, f, form))))
                self.refuse(BAD_INPUT, ["nan.ply"], "render", "nan.ply", "-o", "x.png")

    def test_22_inverted_and_mixed_orientation_is_mended(self):
        v, f = foreign.box()
        wanted = self.box_volume()
        for faces in ([t[::-1] for t in f], [t[::-1] if i % 3 == 0 else t for i, t in enumerate(f)]):
            path = self.write("turned.ply", foreign.ply(v, faces))
            done = self.succeed(*self.body(path), "--json")
            self.assertEqual(done.json()["summary"]["voxels"], wanted)
            self.assertIn("warning", done.err)

    def test_23_surfaces_that_cross_themselves(self):
        v, f = foreign.box()
        w, g = foreign.box((0.6, 0.6, 0.6), (1.5, 1.5, 1.5))
        path = self.write("crossing.ply", foreign.ply(v + w, f + [tuple(i + 8 for i in t) for t in g]))
        union = 1.2 * 1.1 * 1.0 + 0.9**3 - 0.8 * 0.7 * 0.6
        self.assertAlmostEqual(self.voxels(path) * 0.08**3, union, delta=0.2)

    def test_24_no_faces_one_face_or_points(self):
        v, f = foreign.box()
        for faces in ([], f[:1]):
            self.refuse(BAD_INPUT, ["few.ply"], *self.body(self.write("few.ply", foreign.ply(v, faces))))
        points = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 1 1\n"
        self.refuse(BAD_INPUT, ["points.ply"], *self.body(self.write("points.ply", points)))
        for name in ("empty.ply", "empty.obj", "empty.stl", "empty.off"):
            self.refuse(BAD_INPUT, [name], *self.body(self.write(name, b"")))

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

    def test_broken_text(self):
        for name, content in (("words.off", "OFF\n3 1 0\n0 0 0\n1 0 zero\n0 1 0\n3 0 1 2\n"),
                              ("short.off", "OFF\n8 12 0\n0 0 0\n"), ("nothing.obj", "# nothing\n"), ("nothing.stl", "solid x\nendsolid x\n"),
                              ("bytes.ply", os.urandom(3000)), ("bytes.obj", os.urandom(3000)), ("bytes.stl", os.urandom(3000)),
                              ("head.ply", "ply\n"), ("head2.ply", "ply\nformat ascii 1.0\nelement vertex x\nend_header\n"),
                              ("picture.ply", foreign.png(4, 4, lambda x, y: 0))):
            with self.subTest(name=name):
                self.refuse(BAD_INPUT, [name], *self.body(self.write(name, content)))

    def test_cut_and_flipped_meshes_never_crash(self):
        good = self.mesh.read_bytes()
        draw = random.Random(3)
        for i in range(40):
            if i % 2:
                bad = good[:draw.randrange(len(good))]
            else:
                bad = bytearray(good)
                for _ in range(3):
                    bad[draw.randrange(min(len(good), 600 if i % 4 else len(good)))] ^= 1 << draw.randrange(8)
            path = self.write("bad.ply", bytes(bad))
            done = run("info", path, timeout=10, limits=[(resource.RLIMIT_AS, 6 << 30)])
            self.assertIn(done.code, (DONE, BAD_INPUT) if i % 2 == 0 else (BAD_INPUT,), done)
            self.assertLess(done.peak, 1 << 30)

    def test_a_mesh_where_a_scene_is_needed(self):
        self.refuse(BAD_INPUT, ["rock.ply", "--preset mesh"], "cool", self.mesh, "-o", "x.vdb")
        self.refuse(USAGE, ["mesh", "file"], "lava", "--preset", "mesh", "-o", "x.vdb")


class Pictures(SceneTest):
    def map(self, path, *options):
        return ["lava", "--preset", "height_map", "--height-map", path, "--metres-per-pixel", "0.1", "--height-low", "0",
                "--height-high", "1", "--voxel", "10cm", "--heat-cell", "20cm", "-o", "x.vdb", "--force", *options]

    def test_the_good_twin(self):
        path = self.write("hill.png", foreign.png(16, 16, lambda x, y: 20000 + 1000 * x))
        self.succeed(*self.map(path))

    def test_broken_pictures(self):
        good = foreign.png(16, 16, lambda x, y: 20000 + 1000 * x)
        bad = bytearray(good)
        bad[60] ^= 0xFF
        huge = bytearray(good)
        huge[16:24] = struct.pack(">II", 2**31 - 1, 2**31 - 1)
        for name, content in (("empty.png", b""), ("cut.png", good[:70]), ("head.png", good[:20]), ("flipped.png", bytes(bad)),
                              ("huge.png", bytes(huge)), ("words.png", b"not a picture at all"), ("mesh.png", b"ply\nformat ascii 1.0\n")):
            with self.subTest(name=name):
                self.refuse(BAD_INPUT, [name], *self.map(self.write(name, content)))
        self.refuse(BAD_INPUT, ["nowhere.png"], *self.map("nowhere.png"))
        self.refuse(USAGE, ["needs a file: height_map"], "lava", "--preset", "height_map", "-o", "x.vdb")

    def test_a_terrain_map_is_checked_too(self):
        path = self.write("words.png", b"not a picture at all")
        self.refuse(BAD_INPUT, ["words.png"], "weather", self.joints, "--terrain-map", path, "-o", "x.vdb")
        self.write("hill.png", foreign.png(16, 16, lambda x, y: 20000 + 1000 * x))
        self.succeed("weather", self.joints, "--terrain-map", "hill.png", "-o", "x.vdb")
        self.refuse(USAGE, ["height map", "metres_per_pixel"], "lava", "--preset", "height_map", "--height-map", "hill.png",
                    "-o", "y.vdb")


class SeedFiles(SceneTest):
    def test_points_of_a_table(self):
        for content, words in (("1,2\n", ["s.csv:1", "x,y,z"]), ("0.5,0.5,1\n1,b,3\n", ["s.csv:2", "1,b,3"]),
                               ("", ["s.csv", "no points"]), ("1,2,nan\n", ["s.csv:1"]), ("1,2,1e999\n", ["s.csv:1"]),
                               (os.urandom(100), ["s.csv"])):
            self.write("s.csv", content)
            self.refuse(BAD_INPUT, words, "joint", self.cooled, "--seeds", "s.csv", "-o", "x.vdb")
        self.write("s.csv", "# x,y,z\r\n0.4, 0.4, 1.5\r\n1.2\t0.4\t1.5\r\n\r\n0.8,1.2,1.5")
        done = self.succeed("joint", self.cooled, "--seeds", "s.csv", "-o", "x.vdb", "--json")
        self.assertEqual(done.json()["summary"]["columns"], 3)


if __name__ == "__main__":
    unittest.main()
