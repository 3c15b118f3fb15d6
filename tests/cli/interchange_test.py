"""Other programs open our files and see what `info` tells; we open theirs. More of them: tests/oracle."""

import json
import math
import unittest

import foreign
from foreign import pyopenvdb
from support import CliTest, SceneTest, run

# pyopenvdb as Debian builds it knows these value types only.
KNOWN = {"float", "bool", "vec3s"}

class Outwards(SceneTest):
    def test_pyopenvdb_sees_what_info_tells(self):
        for path in (self.lava, self.cooled, self.joints, self.weathered):
            described = {g["name"]: g for g in self.succeed("info", path, "--json").json()[0]["grids"]}
            for name, g in described.items():
                if g["type"] not in KNOWN or g["points"]:
                    continue
                with self.subTest(file=path.name, grid=name):
                    grid = pyopenvdb.read(str(path), name)
                    self.assertEqual(grid.activeVoxelCount(), g["active_voxels"])
                    self.assertEqual(grid.gridClass, g["class"])
                    self.assertAlmostEqual(grid.transform.voxelSize()[0], g["voxel_m"])
                    lower, upper = grid.evalActiveVoxelBoundingBox()
                    for axis in range(3):
                        half = g["voxel_m"] / 2
                        for index, world in ((lower, g["bounds_m"][0]), (upper, g["bounds_m"][1])):
                            centre = grid.transform.indexToWorld(index)[axis]
                            self.assertLessEqual(abs(centre - world[axis]), half * 1.01, "bounds agree to half a voxel")
                    self.assertTrue(grid["sekitei:hash"])
                    self.assertEqual(grid.metadata.get("sekitei:unit", ""), g["unit"])

    def test_the_mesh_is_plain_ply_and_faces_outwards(self):
        vertices, faces = foreign.read_ply(self.mesh.read_bytes())
        info = self.succeed("info", self.mesh, "--json").json()[0]
        self.assertEqual((len(vertices), len(faces)), (info["vertices"], info["triangles"]))
        self.assertTrue(all(len(f) == 3 and 0 <= min(f) <= max(f) < len(vertices) for f in faces))
        self.assertAlmostEqual(foreign.signed_volume(vertices, faces), info["volume_m3"], places=4)
        self.assertGreater(info["volume_m3"], 1)

    def test_glb_is_well_formed(self):
        import struct
        self.succeed("mesh", self.weathered, "-o", "rock.glb")
        content = (self.folder / "rock.glb").read_bytes()
        magic, version, length = struct.unpack_from("<4sII", content)
        self.assertEqual((magic, version, length), (b"glTF", 2, len(content)))
        size, kind = struct.unpack_from("<I4s", content, 12)
        self.assertEqual(kind, b"JSON")
        tree = json.loads(content[20:20 + size])
        binary = struct.unpack_from("<I4s", content, 20 + size)
        self.assertEqual(binary[1], b"BIN\0")
        self.assertEqual(tree["asset"]["version"], "2.0")
        for view in tree["bufferViews"]:
            self.assertLessEqual(view.get("byteOffset", 0) + view["byteLength"], binary[0])
        info = self.succeed("info", self.mesh, "--json").json()[0]
        indices = sum(tree["accessors"][p["indices"]]["count"] for m in tree["meshes"] for p in m["primitives"])
        self.assertEqual(indices, 3 * info["triangles"])
        # y is up: the extent along y is the one along z of the scene.
        position = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
        self.assertAlmostEqual(position["max"][1], info["bounds_m"][1][2], places=4)


class Inwards(CliTest):
    def test_a_level_set_of_another_program_becomes_rock(self):
        path = foreign.write(self.folder / "sphere.vdb", foreign.level_set("body_sdf", radius=0.6, voxel=0.05))
        self.succeed("lava", "--preset", "volume", "--volume", path, "--voxel", "5cm", "-o", "lava.vdb")
        self.succeed("mesh", "lava.vdb", "--grid", "body_sdf", "-o", "body.ply")
        volume = self.succeed("info", "body.ply", "--json").json()[0]["volume_m3"]
        self.assertAlmostEqual(volume, 4 / 3 * math.pi * 0.6**3, delta=0.05)

    def test_a_foreign_volume_is_meshed_like_the_sphere_it_is(self):
        path = foreign.write(self.folder / "sphere.vdb", foreign.level_set("rock", radius=0.5, voxel=0.04))
        self.succeed("mesh", path, "--grid", "rock", "-o", "rock.ply")
        mesh = self.succeed("info", "rock.ply", "--json").json()[0]
        self.assertTrue(mesh["closed"])
        self.assertAlmostEqual(foreign.signed_volume(*foreign.read_ply((self.folder / "rock.ply").read_bytes())),
                               4 / 3 * math.pi * 0.5**3, delta=0.01)
        self.assertAlmostEqual(mesh["area_m2"], 4 * math.pi * 0.5**2, delta=0.1)

    def test_a_foreign_file_has_no_hashes_and_verify_says_so(self):
        path = foreign.write(self.folder / "sphere.vdb", foreign.level_set(), foreign.fog())
        done = self.succeed("verify", path)
        self.assertIn("carries no hash", done.err)
        info = self.succeed("info", path, "--json").json()[0]
        self.assertEqual({g["name"]: g["class"] for g in info["grids"]}, {"sphere": "level set", "density": "fog volume"})
        self.assertEqual({g["name"]: g["active_voxels"] for g in info["grids"]}["density"], 12**3)
        self.assertEqual(info["history"], [])

    def test_half_floats_of_another_program_are_read(self):
        grid = foreign.fog(value=0.5)
        grid.saveFloatAsHalf = True
        path = foreign.write(self.folder / "half.vdb", grid)
        self.succeed("mesh", path, "--grid", "density", "-o", "half.ply")


if __name__ == "__main__":
    unittest.main()
