"""Files that are broken, foreign or not what a stage needs: what battery_test has no row for."""

import os
import random
import resource
import struct
import unittest

import foreign
from support import BAD_INPUT, DONE, USAGE, SceneTest, run

BODY = ["--voxel", "8cm", "--heat-cell", "16cm"]


class Volumes(SceneTest):

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


class Bodies:
    """Lava whose body is a mesh."""

    def body(self, path, *options):
        return ["lava", "--preset", "mesh", "--mesh", path, "-o", "body.vdb", "--force", *BODY, *options]

    def voxels(self, path, *options):
        return self.succeed(*self.body(path, *options), "--json").json()["summary"]["voxels"]

    def box_volume(self):
        v, f = foreign.box()
        return self.voxels(self.write("good.ply", foreign.ply(v, f)))


class Meshes(Bodies, SceneTest):
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
