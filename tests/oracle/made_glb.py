"""Writes .glb files as Sekitei does, by hand: of any size, and with any mistake."""

import json
import struct

import numpy

FLOAT, UINT = 5126, 5125


def y_up(rows):
    rows = numpy.asarray(rows, numpy.float32)
    return numpy.stack([rows[:, 0], rows[:, 2], -rows[:, 1]], 1)


class Glb:
    def __init__(self):
        self.data, self.views, self.accessors, self.nodes, self.meshes, self.materials, self.fields = b"", [], [], [], [], [], {}

    def accessor(self, rows, kind, component=FLOAT):
        rows = numpy.ascontiguousarray(rows, numpy.float32 if component == FLOAT else numpy.uint32)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": rows.nbytes})
        told = {"bufferView": len(self.views) - 1, "componentType": component, "count": len(rows), "type": kind}
        if kind == "VEC3":
            told |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(told)
        self.data += rows.tobytes()
        return len(self.accessors) - 1

    def material(self, name, colour, **more):
        self.materials.append({"name": name, "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1], "metallicFactor": 0}, **more})
        return len(self.materials) - 1

    def mesh(self, co, triangles, material, normals=None, **attributes):
        """Vertices z up; attributes such as COLUMN_ID get their underscore here."""
        given = {"POSITION": self.accessor(y_up(co), "VEC3")}
        if normals is not None:
            given["NORMAL"] = self.accessor(y_up(normals), "VEC3")
        given |= {"_" + k: self.accessor(v, "SCALAR") for k, v in attributes.items()}
        self.meshes.append({"primitives": [{"attributes": given, "indices": self.accessor(numpy.ravel(triangles), "SCALAR", UINT),
                                            "material": material}]})
        return len(self.meshes) - 1

    def surface(self, name, kind, mesh):
        self.nodes.append({"name": name, "mesh": mesh, "extras": {"sekitei": {"kind": kind}}})

    def instances(self, name, species, mesh, places, turns, scales, ids, **attributes):
        """Places z up, turns as quaternions x y z w."""
        turns, scales, ids = numpy.asarray(turns, numpy.float32), numpy.asarray(scales, numpy.float32), numpy.asarray(ids, numpy.int64)
        given = {"TRANSLATION": self.accessor(y_up(places), "VEC3"),
                 "ROTATION": self.accessor(numpy.concatenate([y_up(turns[:, :3]), turns[:, 3:]], 1), "VEC4"),
                 "SCALE": self.accessor(scales[:, [0, 2, 1]], "VEC3"),
                 "_ID": self.accessor(numpy.stack([ids & 0xffffff, ids >> 24], 1), "VEC2")}
        given |= {"_" + k: self.accessor(v, "SCALAR") for k, v in attributes.items()}
        stand, prototype = name.split("/")
        self.nodes.append({"name": name, "mesh": mesh, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": given}},
                           "extras": {"sekitei": {"kind": "instances", "set": stand, "prototype": prototype, "species": species}}})

    def tree(self):
        return {"asset": {"version": "2.0", "generator": "Sekitei", "extras": {"sekitei": {"version": "0.1.0", "fields": self.fields,
                                                                                          "species": ["bryum", "hypnum"]}}},
                "extensionsUsed": ["EXT_mesh_gpu_instancing"], "scene": 0, "scenes": [{"nodes": [len(self.nodes)]}],
                "nodes": [*self.nodes, {"name": "sekitei", "children": list(range(len(self.nodes)))}], "meshes": self.meshes,
                "materials": self.materials, "accessors": self.accessors, "bufferViews": self.views,
                "buffers": [{"byteLength": len(self.data)}]}

    def bytes(self, tree=None):
        text = json.dumps(tree or self.tree()).encode()
        text += b" " * (-len(text) % 4)
        return (struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(self.data)) + struct.pack("<I4s", len(text), b"JSON") + text
                + struct.pack("<I4s", len(self.data), b"BIN\0") + self.data)


CONE = ([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0), (0, 0, 1)], [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)])


def rock_with_plants(count, seed=1):
    """Two steps of rock 4 x 2 x 1 m with columns 0 and 1, and `count` cones on them that lean and differ."""
    rng = numpy.random.default_rng(seed)
    made = Glb()
    made.fields["_LIGHT_S"] = {"name": "light_S", "unit": "W/m2", "low": 10.0, "high": 40.0}
    rock, moss = made.material("rock", (0.1, 0.1, 0.1)), made.material("moss_bryum", (0.1, 0.2, 0.04))
    corners = numpy.array([(x, y, z) for z in (0, 1) for y in (0, 2) for x in (0, 2)], float)
    sides = [(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5)]
    co = numpy.concatenate([corners, corners * (1, 1, 0.5) + (2, 0, 0)])
    triangles = numpy.concatenate([numpy.array(sides), numpy.array(sides) + 8])
    made.surface("rock", "rock", made.mesh(co, triangles, rock, COLUMN_ID=numpy.repeat([0, 1], 8), LIGHT_S=numpy.linspace(10, 40, 16),
                                           MOSS_COVER=numpy.tile([0, 1], 8)))
    places = rng.uniform((0, 0, 1), (2, 2, 1), (count, 3))
    turns = rng.normal(size=(count, 4))
    turns /= numpy.linalg.norm(turns, axis=1, keepdims=True)
    scales = rng.uniform(0.02, 0.1, (count, 3))
    made.instances("moss/bryum_0_lod1", "bryum", made.mesh(*CONE, moss), places, turns, scales, (1 << 30) + numpy.arange(count),
                   GROWTH=rng.uniform(0, 1, count), AGE=numpy.arange(count) % 300)
    return made, places, turns, scales
