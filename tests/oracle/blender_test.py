"""Blender without a window opens volumes, meshes and glTF as its own importers do."""

import json
import struct

import oracle
from habitat_test import HabitatTest
from oracle import blender
from support import SceneTest

# Blender's words for the types of grids.
TYPES = {"float": "FLOAT", "int32": "INT", "vec3s": "VECTOR_FLOAT", "bool": "BOOLEAN"}

GRIDS = """
found = {}
for path in arguments:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.object.volume_import(filepath=path)
    volume = bpy.context.object.data
    volume.grids.load()
    found[path] = {g.name: {"type": g.data_type, "voxel": abs(g.matrix_object[0][0])} for g in volume.grids}
result(found)
"""

# Blender's own surface of the fog, and how much it encloses.
FOG = """
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.object.volume_import(filepath=arguments[0])
volume = bpy.context.object
mesh = bpy.data.meshes.new("skin")
skin = bpy.data.objects.new("skin", mesh)
bpy.context.collection.objects.link(skin)
made = skin.modifiers.new("skin", "VOLUME_TO_MESH")
made.object, made.grid_name, made.threshold = volume, "density", 0.5
made.resolution_mode = "GRID"
bpy.context.view_layer.update()
import bmesh
shape = bmesh.new()
shape.from_object(skin, bpy.context.evaluated_depsgraph_get())
corners = [[f(v.co[k] for v in shape.verts) for k in range(3)] for f in (min, max)]
result({"volume": shape.calc_volume(), "corners": corners})
"""

MESHES = """
found = {}
for path in arguments:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    kind = path.rsplit(".", 1)[1]
    if kind == "ply":
        bpy.ops.import_mesh.ply(filepath=path) if hasattr(bpy.ops.import_mesh, "ply") else bpy.ops.wm.ply_import(filepath=path)
    elif kind == "stl":
        bpy.ops.import_mesh.stl(filepath=path) if hasattr(bpy.ops.import_mesh, "stl") else bpy.ops.wm.stl_import(filepath=path)
    elif kind == "obj":
        bpy.ops.wm.obj_import(filepath=path, forward_axis="Y", up_axis="Z")
    else:
        bpy.ops.import_scene.gltf(filepath=path)
    things = [o for o in bpy.data.objects if o.type == "MESH"]
    corners = [o.matrix_world @ v.co for o in things for v in o.data.vertices]
    found[kind] = {"vertices": len(corners), "triangles": sum(len(o.data.polygons) for o in things),
                   "broken": sum(o.data.validate() for o in things),
                   "box": [[f(c[k] for c in corners) for k in range(3)] for f in (min, max)]}
result(found)
"""


class Volumes(HabitatTest, SceneTest):
    @classmethod
    def setUpClass(cls):
        HabitatTest.setUpClass.__func__(cls)
        cls.habitat = cls.moss
        SceneTest.setUpClass.__func__(cls)

    def test_volumes_have_the_grids_that_info_tells(self):
        paths = [self.cooled, self.joints, self.weathered, self.habitat]
        seen = blender(self, GRIDS, *paths)
        for path in paths:
            told = {g["name"]: g for g in self.info(path)["grids"]}
            found = seen[str(path)]
            self.assertEqual(sorted(found), sorted(told))
            for name, g in told.items():
                self.assertEqual(found[name]["type"], "POINTS" if g["points"] else TYPES[g["type"]], name)
                if not g["points"]:
                    self.assertAlmostEqual(found[name]["voxel"], g["voxel_m"], places=5, msg=name)

    def test_the_fog_encloses_what_our_mesh_does(self):
        seen = blender(self, FOG, self.weathered)
        told = self.succeed("info", self.mesh, "--json").json()[0]
        self.assertAlmostEqual(abs(seen["volume"]) / told["volume_m3"], 1, delta=0.02)
        for side in range(2):
            for axis in range(3):
                self.assertAlmostEqual(seen["corners"][side][axis], told["bounds_m"][side][axis], delta=0.04)


class Meshes(SceneTest):
    def test_meshes_have_the_vertices_triangles_and_place_that_info_tells(self):
        names = [f"rock.{kind}" for kind in ("ply", "obj", "stl", "glb")]
        self.succeed("mesh", self.weathered, *(word for name in names for word in ("-o", name)))
        told = self.succeed("info", "rock.ply", "--json").json()[0]
        seen = blender(self, MESHES, *(self.folder / name for name in names))
        for kind, found in seen.items():
            with self.subTest(kind=kind):
                self.assertEqual(found["triangles"], told["triangles"])
                self.assertFalse(found["broken"], "Blender found nothing to mend")
                # A glTF vertex stands once for each normal or id it has.
                self.assertGreaterEqual(found["vertices"], told["vertices"])
                if kind != "glb":
                    self.assertEqual(found["vertices"], told["vertices"])
                for side in range(2):
                    for axis in range(3):
                        self.assertAlmostEqual(found["box"][side][axis], told["bounds_m"][side][axis], places=4)


class Assemblies(HabitatTest):
    def test_an_importer_that_knows_no_instances_opens_the_rest(self):
        """Blender 3.4 draws each prototype once: what is there is whole."""
        self.succeed("export", self.moss, "--to", "moss.glb")
        content = (self.folder / "moss.glb").read_bytes()
        tree = json.loads(content[20:20 + struct.unpack_from("<I", content, 12)[0]])
        primitives = [p for node in tree["nodes"] if "mesh" in node for p in tree["meshes"][node["mesh"]]["primitives"]]
        self.assertGreater(len(primitives), 3)
        found = blender(self, MESHES, self.folder / "moss.glb")["glb"]
        self.assertEqual(found["triangles"], sum(tree["accessors"][p["indices"]]["count"] for p in primitives) // 3)
        self.assertFalse(found["broken"])


if __name__ == "__main__":
    oracle.main("blender")
