"""Writes a .glb such as `sekitei export` makes, of any size: make_glb.py TRIANGLES COPIES FILE."""

import json
import struct
import sys

import numpy as np


def sphere(rows, columns):
    """Positions and triangles of a bumpy stone, y up."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    polar, around = np.pi * v.ravel(), 2 * np.pi * u.ravel()
    d = np.stack([np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)], 1)
    r = 2 + 0.25 * np.sin(5 * d[:, 0] + 1) * np.sin(4 * d[:, 1]) + 0.12 * np.sin(11 * d[:, 2]) * np.sin(9 * d[:, 0])
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = (i * (columns + 1) + j).ravel()
    b, c, e = a + 1, a + columns + 1, a + columns + 2
    return d * r[:, None] * [1.3, 0.9, 1.0] + [0, 1.2, 0], np.concatenate([np.stack([a, e, c], 1), np.stack([a, b, e], 1)])


def normals(p, t):
    n = np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]])
    sums = np.stack([np.bincount(t.ravel(), np.repeat(n[:, k], 3), len(p)) for k in range(3)], 1)
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)


class Glb:
    def __init__(self):
        self.binary, self.views, self.accessors = bytearray(), [], []

    def put(self, values, bounds=False):
        values = np.ascontiguousarray(values, np.uint32 if values.dtype.kind in "iu" else np.float32)
        self.views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes})
        self.binary += values.tobytes()
        width = 1 if values.ndim == 1 else values.shape[1]
        entry = {"bufferView": len(self.views) - 1, "componentType": 5125 if values.dtype == np.uint32 else 5126,
                 "count": len(values), "type": ["SCALAR", "VEC2", "VEC3", "VEC4"][width - 1]}
        if bounds:
            entry |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self.accessors.append(entry)
        return len(self.accessors) - 1


def scene(triangles, copies, size=1.0):
    rows = int(np.sqrt(triangles / 4))
    p, t = sphere(rows, 2 * rows)
    n = normals(p, t)
    g, rng = Glb(), np.random.default_rng(7)
    light = 60 + 90 * np.clip(n @ [0.5, 0.6, 0.6], -0.4, 1)
    cover = np.clip(0.5 - n @ [0.3, 0.1, 0.7] + 0.3 * np.sin(6 * p[:, 0]), 0, 1)
    column = np.floor(4 * (p[:, 0] + 4)) * 16 + np.floor(4 * (p[:, 2] + 4))
    fields = {"_COLUMN_ID": ("column", "", column), "_LIGHT_S": ("light_S", "W/m2", light), "_SKY_VIEW": ("sky_view", "", 0.5 + 0.5 * n[:, 1]),
              "_TEMPERATURE": ("temperature", "K", 900 + 300 * p[:, 1]), "_MOSS_COVER": ("moss_cover", "", cover)}
    materials = [{"name": "rock", "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.2, 0.21, 1], "metallicFactor": 0, "roughnessFactor": 0.9}},
                 {"name": "ground", "pbrMetallicRoughness": {"baseColorFactor": [0.45, 0.4, 0.33, 1], "metallicFactor": 0, "roughnessFactor": 1}},
                 {"name": "moss_bryum", "pbrMetallicRoughness": {"baseColorFactor": [0.16, 0.26, 0.05, 1], "metallicFactor": 0, "roughnessFactor": 1}}]
    attributes = {"POSITION": g.put(p, True), "NORMAL": g.put(n)} | {k: g.put(v[2], True) for k, v in fields.items()}
    meshes = [{"name": "rock", "primitives": [{"attributes": attributes, "indices": g.put(t.ravel()), "material": 0}]}]
    q = np.array([[-9, 0, 9], [9, 0, 9], [9, 0, -9], [-9, 0, -9]], float)
    meshes.append({"name": "ground", "primitives": [{"attributes": {"POSITION": g.put(q, True), "NORMAL": g.put(np.tile([0.0, 1, 0], (4, 1)))},
                                                    "indices": g.put(np.array([0, 1, 2, 0, 2, 3])), "material": 1}]})
    s, f = sphere(10, 11)
    s = (s - [0, 1.2, 0]) / [5.2, 4, 4]
    s[:, 1] = np.maximum(s[:, 1], -0.05)
    meshes.append({"name": "bryum_0_lod1", "primitives": [{"attributes": {"POSITION": g.put(s, True), "NORMAL": g.put(normals(s, f))},
                                                          "indices": g.put(f.ravel()), "material": 2}]})
    nodes = [{"name": "rock", "mesh": 0, "extras": {"sekitei": {"kind": "rock"}}}, {"name": "ground", "mesh": 1, "extras": {"sekitei": {"kind": "ground"}}}]
    if copies:
        where = rng.integers(0, len(p), copies)
        up, at = n[where], p[where] + 0.004 * rng.standard_normal((copies, 3))
        turn = np.stack([up[:, 2], 0 * up[:, 0], -up[:, 0], 1 + up[:, 1]], 1)
        turn[np.linalg.norm(turn, axis=1) < 1e-6] = [1, 0, 0, 0]
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        size = size * (0.03 + 0.05 * rng.random(copies))
        of = np.arange(copies)
        nodes.append({"name": "moss/bryum_0_lod1", "mesh": 2, "extras": {"sekitei": {"kind": "instances", "set": "moss", "prototype": "bryum_0_lod1", "species": "bryum"}},
                      "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {
                          "TRANSLATION": g.put(at), "ROTATION": g.put(turn), "SCALE": g.put(np.repeat(size[:, None], 3, 1)),
                          "_ID": g.put(np.stack([of & 0xFFFFFF, of >> 24], 1).astype(float)), "_GROWTH": g.put(2 * rng.random(copies)), "_AGE": g.put(np.floor(400 * rng.random(copies)))}}}})
        fields |= {"_GROWTH": ("growth", "", np.array([0, 2])), "_AGE": ("age", "d", np.array([0, 400]))}
    nodes.append({"name": "sekitei", "children": list(range(len(nodes)))})
    told = {k: {"name": v[0], "unit": v[1], "low": float(v[2].min()), "high": float(v[2].max())} for k, v in fields.items()}
    document = {"asset": {"version": "2.0", "generator": "Sekitei", "extras": {"sekitei": {"version": "0", "fields": told, "species": ["bryum"]}}},
                "extensionsUsed": ["EXT_mesh_gpu_instancing"], "scene": 0, "scenes": [{"nodes": [len(nodes) - 1]}], "nodes": nodes, "meshes": meshes,
                "materials": materials, "accessors": g.accessors, "bufferViews": g.views, "buffers": [{"byteLength": len(g.binary)}]}
    if not copies:
        del document["extensionsUsed"]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + struct.pack("<IIII", 2, 28 + len(text) + len(g.binary), len(text), 0x4E4F534A) + text + struct.pack("<II", len(g.binary), 0x004E4942) + g.binary


if __name__ == "__main__":
    triangles, copies, name = sys.argv[1:]
    with open(name, "wb") as file:
        file.write(scene(int(triangles), int(copies)))
