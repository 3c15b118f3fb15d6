"""Builds a Blender scene of what Sekitei wrote.

    blender -P import_sekitei.py -- garden/manifest.json
    blender -b -P import_sekitei.py -- garden/manifest.json --render frame.png --samples 128

Reads the folder's .glb, which has surfaces with their fields and plants as instances; where there is none, its .ply meshes and
points. Volumes are opened as they are. Materials read the attributes of meshes and instances, so that columns differ, moist
rock is darker and moss grows where it grows. Blender 3.4 and later; needs nothing but Blender.
"""

import argparse
import json
import math
import os
import re
import struct
import sys
import traceback
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

try:
    import numpy as np
except ImportError:
    print("import_sekitei: error: this Blender's Python has no numpy; Debian's takes the first python3 of PATH: try PATH=/usr/bin:$PATH blender ...",
          file=sys.stderr, flush=True)
    os._exit(1)

EXIT_USAGE, EXIT_BAD_INPUT, EXIT_CANNOT_WRITE = 2, 3, 4  # as those of the program
VIEWPORT_COPIES = 100000  # of one prototype; a render shows all


class Problem(Exception):
    """What the user can mend."""

    def __init__(self, words, code=EXIT_BAD_INPUT):
        super().__init__(words)
        self.code = code


def say(words):
    print("import_sekitei: " + words, flush=True)


# ---------------------------------------------------------------- files


def read_bytes(path):
    try:
        return path.read_bytes()
    except OSError as error:
        raise Problem(f"{path}: {error.strerror or error}") from None


class Output:
    """A line of the manifest."""

    def __init__(self, folder, entry):
        self.path = folder / entry["path"]
        self.entry = entry
        self.kind = entry.get("kind", "")
        self.suffix = self.path.suffix.lower()

    def check(self):
        """Half a file would do worse than fail: Blender itself ends at half a volume."""
        if not self.path.is_file():
            raise Problem(f"{self.path}: no such file, but the manifest lists it")
        told, found = self.entry.get("bytes", self.entry.get("size")), self.path.stat().st_size
        if isinstance(told, int) and told != found:
            raise Problem(f"{self.path}: {found} bytes, the manifest says {told}: not the file that was written")
        return self.path


def read_manifest(path):
    """(version, outputs) of manifest.json, of the folder that has one, or of a single .glb or .ply."""
    path = Path(path)
    if path.is_dir():
        path /= "manifest.json"
    if path.suffix.lower() in (".glb", ".ply") and path.is_file():
        return None, [Output(path.parent, {"path": path.name, "kind": "mesh"})]
    try:
        manifest = json.loads(read_bytes(path))
    except ValueError as error:
        raise Problem(f"{path}: not a manifest: {error}") from None
    if not isinstance(manifest, dict) or not isinstance(manifest.get("sekitei"), str) or not isinstance(manifest.get("outputs"), list):
        raise Problem(f"{path}: not a manifest of Sekitei: 'sekitei' (its version) and 'outputs' are missing")
    check_version(path, manifest["sekitei"])
    outputs = manifest["outputs"]
    if not all(isinstance(o, dict) and isinstance(o.get("path"), str) for o in outputs):
        raise Problem(f"{path}: an output without a path")
    return manifest["sekitei"], [Output(path.parent, o) for o in outputs]


def check_version(path, version):
    match = re.fullmatch(r"(\d+)\.(\d+)(\..*)?", version)
    if not match or int(match[1]) > 1:
        raise Problem(f"{path}: version {version!r}, this script knows 0.x and 1.x: use the one that came with that Sekitei")


COMPONENTS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Glb:
    """A binary glTF file as Sekitei writes it."""

    def __init__(self, path):
        self.path = path
        content = read_bytes(path)
        if len(content) < 20 or content[:4] != b"glTF":
            raise Problem(f"{path}: not a .glb file")
        version, length, size, kind = struct.unpack_from("<III4s", content, 4)
        if version != 2:
            raise Problem(f"{path}: glTF version {version}, must be 2")
        if length != len(content) or kind != b"JSON" or 20 + size > length:
            raise Problem(f"{path}: damaged: {len(content)} bytes, its header says {length}")
        try:
            self.tree = json.loads(content[20:20 + size])
        except ValueError as error:
            raise Problem(f"{path}: damaged: {error}") from None
        asset = self.tree.get("asset", {})
        if not str(asset.get("generator", "")).startswith("Sekitei"):
            raise Problem(f"{path}: not made by Sekitei but by {asset.get('generator', 'nobody knows what')!r}; File > Import opens such files")
        self.about = asset.get("extras", {}).get("sekitei", {})
        if "version" in self.about:
            check_version(path, str(self.about["version"]))
        self.whole = "fields" in self.about
        unknown = set(self.tree.get("extensionsRequired", []))
        if unknown:
            raise Problem(f"{path}: requires {', '.join(sorted(unknown))}, unknown here")
        self.data = b""
        if 20 + size + 8 <= length:
            size2, kind = struct.unpack_from("<I4s", content, 20 + size)
            if kind != b"BIN\0" or 28 + size + size2 > length:
                raise Problem(f"{path}: damaged: its data are cut")
            self.data = memoryview(content)[28 + size:28 + size + size2]

    def array(self, number):
        """An accessor as rows of floats, or of whole numbers for indices."""
        try:
            accessor = self.tree["accessors"][number]
            view = self.tree["bufferViews"][accessor["bufferView"]]
            form, width, count = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]], accessor["count"]
            stride = view.get("byteStride", form.itemsize * width)
            start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
            rows = np.ndarray((count, width), form, self.data, start, (stride, form.itemsize))
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise Problem(f"{self.path}: accessor {number} is damaged: {error}") from None
        if accessor.get("normalized"):
            rows = rows / np.iinfo(form).max
        return rows[:, 0] if width == 1 else rows

    def name_of(self, attribute):
        """The plain name of a custom attribute: `_LIGHT_S` is light_S."""
        told = self.about.get("fields", {}).get(attribute, {})
        return plain_name(told.get("name") or attribute.lstrip("_").lower())


def plain_name(name):
    """Cycles takes some names for grids of volumes, and then reads nothing on meshes."""
    return name + "_value" if name in ("color", "density", "flame", "heat", "temperature", "velocity") else name


PLY_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2",
             "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "float": "<f4", "float32": "<f4", "double": "<f8",
             "float64": "<f8"}


def read_ply(path):
    """({attribute: values of vertices}, triangles, {attribute: values of faces}) of a binary PLY of triangles or points."""
    content = read_bytes(path)
    end = content.find(b"end_header\n")
    if not content.startswith(b"ply\n") or end < 0:
        raise Problem(f"{path}: not a PLY file")
    lines = [line.split() for line in content[:end].decode("ascii", "replace").split("\n")]
    if ["format", "binary_little_endian", "1.0"] not in lines:
        raise Problem(f"{path}: must be binary little-endian PLY, as Sekitei writes it")
    at, elements = end + len(b"end_header\n"), []
    for words in lines:
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    found = {"vertex": {}, "face": {}}
    triangles = np.zeros((0, 3), np.uint32)
    for name, count, properties in elements:
        try:
            form = np.dtype([part for words in properties for part in
                             ([(words[3] + "#", PLY_TYPES[words[1]]), (words[3], PLY_TYPES[words[2]], 3)] if words[0] == "list"
                              else [(words[1], PLY_TYPES[words[0]])])])
            rows = np.frombuffer(content, form, count, at)
        except (KeyError, ValueError, IndexError) as error:
            raise Problem(f"{path}: element {name}: {error}") from None
        at += count * form.itemsize
        for words in properties:
            if words[0] == "list":
                if count and (rows[words[3] + "#"] != 3).any():
                    raise Problem(f"{path}: faces must be triangles, as Sekitei writes them")
                triangles = rows[words[3]].astype(np.uint32)
            elif name in found:
                found[name][words[1]] = rows[words[1]]
    if not {"x", "y", "z"} <= found["vertex"].keys():
        raise Problem(f"{path}: vertices without x, y, z")
    return found["vertex"], triangles, found["face"]


# ---------------------------------------------------------------- space


def z_up(rows):
    """(x, y, z) of glTF, y up, is (x, -z, y) here."""
    return np.stack([rows[:, 0], -rows[:, 2], rows[:, 1]], 1)


def eulers(quaternions):
    """Angles about x, then y, then z of unit quaternions x y z w."""
    x, y, z, w = (quaternions.astype(np.float64) / np.linalg.norm(quaternions, axis=1, keepdims=True).clip(1e-12)).T
    sine = (2 * (w * y - z * x)).clip(-1, 1)
    about_x = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    about_z = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    locked = np.abs(sine) > 1 - 1e-9  # then only their sum or difference is known
    about_x[locked] = 0
    about_z[locked] = -2 * np.sign(sine[locked]) * np.arctan2(x[locked], w[locked])
    return np.stack([about_x, np.arcsin(sine), about_z], 1).astype(np.float32)


# ---------------------------------------------------------------- materials


# Linear colours where the file tells none.
COLOURS = {"rock": (0.095, 0.09, 0.085), "ground": (0.16, 0.115, 0.075), "water": (0.75, 0.88, 0.86), "obstacle": (0.24, 0.16, 0.09),
           "bark": (0.12, 0.085, 0.06), "leaves": (0.09, 0.2, 0.04), "moss": (0.08, 0.14, 0.028)}


class Nodes:
    """Writes a shader or geometry graph from left to right."""

    def __init__(self, tree):
        self.tree = tree
        tree.nodes.clear()

    def add(self, kind, inputs=None, **settings):
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        for name, value in (inputs or {}).items():
            self.connect(value, node.inputs[name])
        return node

    def connect(self, value, socket):
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif value is not None:
            socket.default_value = value

    def attribute(self, name, of_instance=False):
        node = self.add("ShaderNodeAttribute", attribute_name=name)
        node.attribute_type = "INSTANCER" if of_instance else "GEOMETRY"
        return node.outputs["Fac"]

    def math(self, operation, a, b=None):
        node = self.add("ShaderNodeMath", operation=operation)
        self.connect(a, node.inputs[0])
        self.connect(b, node.inputs[1])
        return node.outputs[0]

    def ramp(self, value, low, high, to_low=0.0, to_high=1.0):
        """`value` from low..high to to_low..to_high, held at both ends."""
        return self.add("ShaderNodeMapRange", {"Value": value, "From Min": low, "From Max": high, "To Min": to_low, "To Max": to_high},
                        clamp=True).outputs[0]

    def mix(self, share, a, b, blend="MIX"):
        """Colours; the older node is known to all versions."""
        return self.add("ShaderNodeMixRGB", {"Fac": share, "Color1": a, "Color2": b}, blend_type=blend).outputs[0]

    def scaled(self, colour, by):
        """A colour times a number."""
        node = self.add("ShaderNodeVectorMath", {"Scale": by}, operation="SCALE")
        self.connect(colour[:3] if isinstance(colour, tuple) else colour, node.inputs[0])
        return node.outputs[0]

    def noise(self, scale, detail=3.0, vector=None, rough=0.55):
        return self.add("ShaderNodeTexNoise", {"Scale": scale, "Detail": detail, "Roughness": rough, "Vector": vector}).outputs["Fac"]

    def random(self, number):
        """(number, colour) that look random, one for each whole number."""
        node = self.add("ShaderNodeTexWhiteNoise", noise_dimensions="1D")
        self.connect(self.math("ROUND", number), node.inputs["W"])
        return node.outputs["Value"], node.outputs["Color"]

    def bump(self, height, strength, distance, normal=None):
        return self.add("ShaderNodeBump", {"Height": height, "Strength": strength, "Distance": distance, "Normal": normal}).outputs[0]

    def principled(self, **inputs):
        """Names of inputs are those of Blender 3.4; later ones call some of them otherwise."""
        node = self.add("ShaderNodeBsdfPrincipled")
        for name, value in inputs.items():
            for known in {"Specular": ("Specular", "Specular IOR Level"), "Transmission": ("Transmission", "Transmission Weight")}.get(
                    name, (name,)):
                if known in node.inputs:
                    self.connect(value, node.inputs[known])
        return node.outputs[0]

    def blend(self, share, a, b):
        """Shaders."""
        node = self.add("ShaderNodeMixShader", {"Fac": share})
        self.tree.links.new(a, node.inputs[1])
        self.tree.links.new(b, node.inputs[2])
        return node.outputs[0]

    def end(self, shader, socket="Surface"):
        self.tree.links.new(shader, self.add("ShaderNodeOutputMaterial").inputs[socket])


def rgba(colour):
    return (*(float(c) for c in tuple(colour)[:3]), 1.0)


def first(names, *wanted):
    return next((w for w in wanted if w in names), None)


def position(n):
    """Place in the world [m], whatever object it is on."""
    return n.add("ShaderNodeNewGeometry").outputs["Position"]


def climate(n, colour, rough, names, place):
    """Wet is darker and shinier; moss covers."""
    humid = first(names, "soil_rh", "wetness", "soil_theta", "soil_water")
    if humid:
        low, high = {"soil_rh": (0.72, 1.0), "soil_theta": (0.0, 0.3), "soil_water": (0.0, 8.0)}.get(humid, (0.0, 1.0))
        wet = n.ramp(n.attribute(humid), low, high)
        colour = n.scaled(colour, n.ramp(wet, 0.0, 1.0, 1.0, 0.55))
        rough = n.math("SUBTRACT", rough, n.math("MULTIPLY", wet, 0.3))
    if "moss_cover" in names:
        fleck = n.noise(30.0, 5.0, place, 0.7)
        share = n.ramp(n.math("ADD", n.attribute("moss_cover"), n.math("MULTIPLY", n.math("SUBTRACT", fleck, 0.5), 0.9)), 0.25, 0.6)
        green = n.mix(n.noise(4.0, 4.0, place), rgba((0.045, 0.09, 0.018)), rgba((0.12, 0.17, 0.03)))
        colour = n.mix(share, colour, green)
        rough = n.math("MAXIMUM", rough, share)
    return colour, rough


def rock_material(n, base, names):
    place = position(n)
    colour, rough = rgba(base), 0.82
    # Each column cooled by itself: a little darker or warmer than its neighbour.
    column = first(names, "column_id", "column")
    if column:
        value, tint = n.random(n.attribute(column))
        colour = n.mix(0.05, n.scaled(colour, n.ramp(value, 0.0, 1.0, 0.6, 1.2)), tint, "SOFT_LIGHT")
    if "component" in names:
        value, _ = n.random(n.math("ADD", n.attribute("component"), 0.5))
        colour = n.scaled(colour, n.ramp(value, 0.0, 1.0, 0.94, 1.06))
    if "surface" in names:
        # 0 joints, weathered brown; 1 fresh breaks, lighter and bluer; 2, 3 the rind where the flow met air and ground.
        kind = n.attribute("surface")
        rust = n.ramp(n.noise(1.7, 5.0, place, 0.65), 0.48, 0.7, 0.0, 0.55)
        joint = n.math("LESS_THAN", kind, 0.5)
        colour = n.mix(n.math("MULTIPLY", joint, rust), colour, rgba((0.15, 0.095, 0.055)))
        fresh = n.math("COMPARE", kind, 1.0)
        colour = n.mix(n.math("MULTIPLY", fresh, 0.35), colour, rgba((0.2, 0.21, 0.22)))
        rind = n.math("GREATER_THAN", kind, 1.5)
        colour = n.mix(n.math("MULTIPLY", rind, 0.35), colour, rgba((0.13, 0.1, 0.08)))
    # Stains, grain and pale crusts.
    colour = n.scaled(colour, n.ramp(n.noise(1.1, 5.0, place), 0.3, 0.7, 0.7, 1.3))
    grain = n.noise(32.0, 5.0, place, 0.7)
    colour = n.scaled(colour, n.ramp(grain, 0.3, 0.7, 0.65, 1.35))
    crust = n.ramp(n.noise(9.0, 6.0, place, 0.7), 0.6, 0.68, 0.0, 0.4)
    colour = n.mix(crust, colour, rgba((0.26, 0.26, 0.22)))
    colour, rough = climate(n, colour, rough, names, place)
    n.end(n.principled(**{"Base Color": colour, "Roughness": rough, "Specular": 0.3, "Normal": n.bump(grain, 0.6, 0.02)}))


def ground_material(n, base, names):
    """Earth and small stones; where the scene knows no moss of its own, a film of green in patches."""
    place = position(n)
    colour = n.scaled(rgba(base), n.ramp(n.noise(0.35, 5.0, place, 0.6), 0.3, 0.7, 0.6, 1.35))
    stones = n.add("ShaderNodeTexVoronoi", {"Scale": 28.0, "Vector": place})
    grain = n.add("ShaderNodeSeparateColor", {"Color": stones.outputs["Color"]}).outputs[0]
    colour = n.scaled(colour, n.ramp(grain, 0.0, 1.0, 0.7, 1.3))
    fine = n.noise(7.0, 6.0, place, 0.7)
    if "moss_cover" not in names:
        patches = n.math("ADD", n.noise(0.22, 4.0, place, 0.6), n.math("MULTIPLY", n.math("SUBTRACT", fine, 0.5), 0.5))
        colour = n.mix(n.ramp(patches, 0.44, 0.56, 0.0, 0.85), colour, n.mix(fine, rgba((0.035, 0.06, 0.012)), rgba((0.13, 0.15, 0.04))))
    colour, rough = climate(n, colour, 0.95, names, place)
    height = n.math("SUBTRACT", fine, n.math("MULTIPLY", stones.outputs["Distance"], 0.4))
    n.end(n.principled(**{"Base Color": colour, "Roughness": rough, "Specular": 0.2, "Normal": n.bump(height, 0.6, 0.03)}))


def water_material(n, base, names):
    """Glass with ripples, tinted where one looks through; the light that falls through it stays light."""
    ripples = n.bump(n.noise(1.6, 2.0, position(n)), 0.1, 0.02)
    through = n.add("ShaderNodeBsdfRefraction", {"Color": rgba((0.3, 0.42, 0.36)), "Roughness": 0.02, "IOR": 1.333, "Normal": ripples}).outputs[0]
    mirror = n.add("ShaderNodeBsdfGlossy", {"Color": rgba((1, 1, 1)), "Roughness": 0.02, "Normal": ripples}).outputs[0]
    glass = n.blend(n.add("ShaderNodeFresnel", {"IOR": 1.333, "Normal": ripples}).outputs[0], through, mirror)
    clear = n.add("ShaderNodeBsdfTransparent", {"Color": rgba((0.6, 0.75, 0.7))}).outputs[0]
    n.end(n.blend(n.add("ShaderNodeLightPath").outputs["Is Shadow Ray"], glass, clear))


def wood_material(n, base, names):
    place = n.add("ShaderNodeMapping", {"Vector": position(n), "Scale": (1.0, 1.0, 0.18)}).outputs[0]
    furrows = n.noise(38.0, 5.0, place, 0.65)
    colour = n.scaled(rgba(base), n.ramp(furrows, 0.3, 0.7, 0.45, 1.5))
    colour, rough = climate(n, colour, 0.9, names, position(n))
    n.end(n.principled(**{"Base Color": colour, "Roughness": rough, "Specular": 0.2, "Normal": n.bump(furrows, 0.7, 0.02)}))


def leaf_material(n, base, names):
    chance = n.add("ShaderNodeObjectInfo").outputs["Random"]
    colour = n.add("ShaderNodeHueSaturation", {"Hue": n.ramp(chance, 0.0, 1.0, 0.475, 0.52), "Saturation": 1.0,
                                               "Value": n.ramp(n.noise(60.0, 2.0, position(n)), 0.3, 0.7, 0.75, 1.3),
                                               "Color": rgba(base)}).outputs[0]
    upper = n.principled(**{"Base Color": colour, "Roughness": 0.5, "Specular": 0.3})
    through = n.add("ShaderNodeBsdfTranslucent", {"Color": n.mix(0.5, colour, rgba((0.25, 0.35, 0.03)))}).outputs[0]
    n.end(n.blend(0.35, upper, through))


def moss_material(n, base, names):
    """Plants differ a little; young ones are a lighter, yellower green; tips are lighter than what they grow from."""
    colour = rgba(base)
    if "tint" in names:
        colour = n.mix(1.0, colour, n.add("ShaderNodeAttribute", attribute_name="tint").outputs["Color"], "MULTIPLY")
    elif "height" in names:
        colour = n.scaled(colour, n.ramp(n.attribute("height"), 0.0, 1.0, 0.45, 1.35))
    young = n.ramp(n.attribute("growth", of_instance=True), 0.0, 1.5, 1.0, 0.0)
    colour = n.mix(n.math("MULTIPLY", young, 0.6), colour, rgba((1.5, 1.25, 0.9)), "MULTIPLY")
    chance = n.add("ShaderNodeObjectInfo").outputs["Random"]
    colour = n.add("ShaderNodeHueSaturation", {"Hue": n.ramp(chance, 0.0, 1.0, 0.485, 0.515), "Saturation": n.ramp(chance, 0.0, 1.0, 0.9, 1.1),
                                               "Value": n.ramp(chance, 0.0, 1.0, 0.75, 1.3), "Color": colour}).outputs[0]
    leaf = n.principled(**{"Base Color": colour, "Roughness": 0.75, "Specular": 0.15})
    through = n.add("ShaderNodeBsdfTranslucent", {"Color": colour}).outputs[0]
    n.end(n.blend(0.25, leaf, through))


def volume_material(n, grid):
    n.end(n.add("ShaderNodeVolumePrincipled", {"Color": rgba((0.6, 0.58, 0.55)), "Density": 8.0, "Density Attribute": grid}).outputs[0],
          "Volume")


MAKERS = {"rock": rock_material, "ground": ground_material, "water": water_material, "obstacle": wood_material, "wood": wood_material,
          "bark": wood_material, "leaves": leaf_material, "moss": moss_material}


def kind_of_material(name):
    """rock, ground, water, wood, bark, leaf_KIND and moss_SPECIES are what Sekitei calls its materials."""
    head = name.split("_")[0].lower()
    return {"leaf": "leaves"}.get(head, head) if {"leaf": "leaves"}.get(head, head) in MAKERS else "rock"


def make_material(name, kind, base, names):
    """A material that reads those attributes of `names` it knows; the same for meshes that have the same ones."""
    read = frozenset(names) & {"column_id", "column", "component", "surface", "soil_rh", "wetness", "soil_theta", "soil_water", "moss_cover",
                               "tint", "height"}
    for material in bpy.data.materials:
        if material.get("sekitei") == name and set(material["reads"].split()) == read:
            return material
    material = bpy.data.materials.new(name)
    material["sekitei"], material["reads"] = name, " ".join(sorted(read))
    material.diffuse_color = rgba(base)
    material.use_nodes = True
    MAKERS[kind](Nodes(material.node_tree), base, read)
    return material


# ---------------------------------------------------------------- meshes


class Part:
    """A piece of a mesh in one material."""

    def __init__(self, co, triangles, material=None, normals=None, uv=None, attributes=None, face_attributes=None):
        self.co = np.ascontiguousarray(co, np.float32)
        self.triangles = np.ascontiguousarray(triangles, np.uint32)
        self.material, self.normals, self.uv = material, normals, uv
        self.attributes, self.face_attributes = attributes or {}, face_attributes or {}

    def checked(self, path):
        if len(self.triangles) and self.triangles.max() >= len(self.co):
            raise Problem(f"{path}: a triangle names vertex {self.triangles.max()} of {len(self.co)}")
        if not np.isfinite(self.co).all():
            raise Problem(f"{path}: a vertex that is not a number")
        t = self.triangles
        whole = (t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])
        if not whole.all():
            self.triangles = t[whole]
            self.face_attributes = {k: v[whole] for k, v in self.face_attributes.items()}
        return self


def make_mesh(name, parts):
    """A mesh of several parts; attributes that some of them lack are 0 there."""
    mesh = bpy.data.meshes.new(name)
    firsts = np.cumsum([0, *(len(p.co) for p in parts)])
    co = np.concatenate([p.co for p in parts])
    triangles = np.concatenate([p.triangles + np.uint32(f) for p, f in zip(parts, firsts)])
    mesh.vertices.add(len(co))
    mesh.vertices.foreach_set("co", co.ravel())
    mesh.loops.add(triangles.size)
    mesh.loops.foreach_set("vertex_index", triangles.ravel().astype(np.int32))
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    if bpy.app.version < (3, 6):  # later ones know it from the starts
        mesh.polygons.foreach_set("loop_total", np.full(len(triangles), 3, np.int32))
    for p in parts:
        mesh.materials.append(p.material)
    if len(parts) > 1:
        mesh.polygons.foreach_set("material_index", np.repeat(np.arange(len(parts), dtype=np.int32), [len(p.triangles) for p in parts]))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(triangles), bool))
    if any(p.uv is not None for p in parts):
        uv = np.concatenate([p.uv if p.uv is not None else np.zeros((len(p.co), 2), np.float32) for p in parts])
        layer = mesh.uv_layers.new(name="UVMap")
        layer.data.foreach_set("uv", (uv * (1, -1) + (0, 1))[triangles.ravel()].astype(np.float32).ravel())
    for domain, of, counts in (("POINT", "attributes", [len(p.co) for p in parts]), ("FACE", "face_attributes", [len(p.triangles) for p in parts])):
        for key in sorted({k for p in parts for k in getattr(p, of)}):
            one = next(getattr(p, of)[key] for p in parts if key in getattr(p, of))
            values = np.concatenate([getattr(p, of).get(key, np.zeros((c, *one.shape[1:]), np.float32)) for p, c in zip(parts, counts)])
            add_attribute(mesh, key, values, domain)
    mesh.update(calc_edges=True)
    if len(triangles) and all(p.normals is not None for p in parts):
        mesh.normals_split_custom_set_from_vertices(np.concatenate([p.normals for p in parts]).astype(np.float32))
        if bpy.app.version < (4, 1):
            mesh.use_auto_smooth = True
    return mesh


def add_attribute(mesh, name, values, domain="POINT"):
    values = np.asarray(values)
    width = 1 if values.ndim == 1 else values.shape[1]
    if name == "tint" and width >= 3:
        values = np.concatenate([values[:, :3], np.ones((len(values), 1))], 1)
        attribute = mesh.attributes.new(name, "FLOAT_COLOR", domain)
        attribute.data.foreach_set("color", values.astype(np.float32).ravel())
    elif width == 1:
        whole = np.issubdtype(values.dtype, np.integer)
        attribute = mesh.attributes.new(name, "INT" if whole else "FLOAT", domain)
        attribute.data.foreach_set("value", values.astype(np.int32 if whole else np.float32))
    elif width == 3:
        attribute = mesh.attributes.new(name, "FLOAT_VECTOR", domain)
        attribute.data.foreach_set("vector", values.astype(np.float32).ravel())
    else:
        for axis in range(width):
            add_attribute(mesh, f"{name}_{'xyzw'[axis]}", values[:, axis], domain)


# ---------------------------------------------------------------- instances


def instancer_tree():
    """Geometry nodes that put a prototype on each point, turned and scaled by its attributes; nothing is made real."""
    name = "Sekitei instances"
    tree = bpy.data.node_groups.get(name)
    if tree:
        return tree
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    sockets = [("Geometry", "NodeSocketGeometry"), ("Prototype", "NodeSocketObject"), ("Viewport Share", "NodeSocketFloat")]
    if hasattr(tree, "interface"):  # Blender 4
        for label, kind in sockets:
            tree.interface.new_socket(label, in_out="INPUT", socket_type=kind)
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    else:
        for label, kind in sockets:
            tree.inputs.new(kind, label)
        tree.outputs.new("NodeSocketGeometry", "Geometry")
    n = Nodes(tree)
    given = n.add("NodeGroupInput")
    model = n.add("GeometryNodeObjectInfo", {"Object": given.outputs["Prototype"], "As Instance": True}, transform_space="ORIGINAL")
    chosen = n.add("FunctionNodeRandomValue", data_type="BOOLEAN")
    n.connect(given.outputs["Viewport Share"], next(s for s in chosen.inputs if s.name == "Probability" and s.enabled))
    drawn = next(s for s in chosen.outputs if s.enabled)
    # All of them unless drawn in the viewport.
    render = n.add("FunctionNodeBooleanMath", operation="NOT")
    n.connect(n.add("GeometryNodeIsViewport").outputs[0], render.inputs[0])
    kept = n.add("FunctionNodeBooleanMath", operation="OR")
    n.connect(render.outputs[0], kept.inputs[0])
    n.connect(drawn, kept.inputs[1])
    turned, sized = n.add("GeometryNodeInputNamedAttribute", {"Name": "rotation"}), n.add("GeometryNodeInputNamedAttribute", {"Name": "scale"})
    for node in (turned, sized):
        node.data_type = "FLOAT_VECTOR"
    copies = n.add("GeometryNodeInstanceOnPoints",
                   {"Points": given.outputs["Geometry"], "Selection": kept.outputs[0], "Instance": model.outputs["Geometry"],
                    "Rotation": next(s for s in turned.outputs if s.enabled), "Scale": next(s for s in sized.outputs if s.enabled)})
    n.add("NodeGroupOutput", {"Geometry": copies.outputs["Instances"]})
    for k, node in enumerate(tree.nodes):
        node.location = (200 * k, -120 * (k % 3))
    return tree


def make_instancer(name, prototype, places, rotations, scales, attributes, collection):
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(places))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(places, np.float32).ravel())
    add_attribute(mesh, "rotation", rotations)
    add_attribute(mesh, "scale", scales)
    for key, values in attributes.items():
        add_attribute(mesh, key, values)
    thing = put(collection, bpy.data.objects.new(name, mesh))
    modifier = thing.modifiers.new("Sekitei instances", "NODES")
    tree = modifier.node_group = instancer_tree()
    sockets = tree.interface.items_tree if hasattr(tree, "interface") else tree.inputs
    keys = {s.name: s.identifier for s in sockets if getattr(s, "in_out", "INPUT") == "INPUT"}
    modifier[keys["Prototype"]] = prototype
    modifier[keys["Viewport Share"]] = min(1.0, VIEWPORT_COPIES / max(1, len(places)))
    return thing


# ---------------------------------------------------------------- the scene


def put(collection, thing):
    collection.objects.link(thing)
    return thing


class Importer:
    def __init__(self, options):
        self.options = options
        self.scene = bpy.context.scene
        if not bpy.data.filepath:  # what an empty Blender starts with
            for name in ("Cube", "Light", "Camera"):
                if name in bpy.data.objects:
                    bpy.data.objects.remove(bpy.data.objects[name])
            for collection in self.scene.collection.children:
                if not collection.all_objects:
                    bpy.data.collections.remove(collection)
        self.root = bpy.data.collections.new("Sekitei")
        self.scene.collection.children.link(self.root)
        self.collections = {}
        self.boxes = {}  # kind: (lowest corner, highest corner) of all its vertices
        self.copies = 0
        self.surfaces = []

    def collection(self, name):
        if name not in self.collections:
            made = self.collections[name] = bpy.data.collections.new(name)
            self.root.children.link(made)
        return self.collections[name]

    def grow(self, kind, co):
        if len(co):
            low, high = co.min(0).astype(float), co.max(0).astype(float)
            if kind in self.boxes:
                low, high = np.minimum(low, self.boxes[kind][0]), np.maximum(high, self.boxes[kind][1])
            self.boxes[kind] = (low, high)

    def box(self, *kinds):
        boxes = [self.boxes[k] for k in kinds if k in self.boxes]
        return (np.min([b[0] for b in boxes], 0), np.max([b[1] for b in boxes], 0)) if boxes else None

    def add_surface(self, name, kind, parts):
        for p in parts:
            self.grow(kind, p.co)
        thing = put(self.collection("surfaces"), bpy.data.objects.new(name, make_mesh(name, parts)))
        thing["sekitei_kind"] = kind
        self.surfaces.append(thing)
        return thing

    def add_prototype(self, name, mesh):
        """Stands in no picture by itself."""
        collection = self.collection("prototypes")
        thing = put(collection, bpy.data.objects.new(name, mesh))
        thing.hide_render = thing.hide_viewport = True
        return thing

    # -- from .glb

    def read_glbs(self, paths):
        """Where one has the whole scene, meshes by themselves stand in it already."""
        files = [Glb(path) for path in paths]
        for glb in [f for f in files if f.whole] or files:
            self.read_glb(glb)
        if not self.surfaces and not self.copies:
            raise Problem(f"{paths[0]}: nothing to show")

    def read_glb(self, glb):
        path = glb.path
        nodes, seen = glb.tree.get("nodes", []), set()
        scenes = glb.tree.get("scenes") or [{"nodes": list(range(len(nodes)))}]
        stack = [(k, np.eye(4)) for k in scenes[glb.tree.get("scene", 0)].get("nodes", [])]
        prototypes = {}
        while stack:
            number, above = stack.pop(0)
            if not 0 <= number < len(nodes) or number in seen:
                raise Problem(f"{path}: node {number} is missing or stands twice")
            seen.add(number)
            node = nodes[number]
            place = above @ self.matrix(node)
            stack += [(k, place) for k in node.get("children", [])]
            if "mesh" not in node:
                continue
            extras = node.get("extras", {}).get("sekitei", {})
            copies = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
            name = node.get("name", f"node {number}")
            if copies is None:
                kind = extras.get("kind", "rock")
                thing = self.add_surface(name, kind, self.parts(glb, node["mesh"], kind))
            else:
                if node["mesh"] not in prototypes:
                    mesh = make_mesh(extras.get("prototype", name), self.parts(glb, node["mesh"], extras.get("set", "moss")))
                    prototypes[node["mesh"]] = self.add_prototype(mesh.name, mesh)
                thing = self.add_copies(glb, name, extras, prototypes[node["mesh"]], copies["attributes"])
            turn = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
            thing.matrix_world = Matrix((turn @ place @ turn.T).tolist())

    @staticmethod
    def matrix(node):
        if "matrix" in node:
            return np.array(node["matrix"], float).reshape(4, 4).T
        x, y, z, w = node.get("rotation", (0, 0, 0, 1))
        turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                         [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                         [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
        made = np.eye(4)
        made[:3, :3] = turn * node.get("scale", (1, 1, 1))
        made[:3, 3] = node.get("translation", (0, 0, 0))
        return made

    def parts(self, glb, number, kind):
        """The primitives of a mesh."""
        try:
            primitives = glb.tree["meshes"][number]["primitives"]
        except (KeyError, IndexError, TypeError):
            raise Problem(f"{glb.path}: mesh {number} is missing") from None
        made = []
        for primitive in primitives:
            given = primitive["attributes"]
            if primitive.get("mode", 4) != 4 or "POSITION" not in given:
                raise Problem(f"{glb.path}: mesh {number} is not made of triangles")
            co = z_up(glb.array(given["POSITION"]))
            triangles = glb.array(primitive["indices"]).reshape(-1, 3) if "indices" in primitive else np.arange(len(co)).reshape(-1, 3)
            attributes = {glb.name_of(k): glb.array(v) for k, v in given.items() if k.startswith("_")}
            if "COLOR_0" in given:
                attributes["tint"] = glb.array(given["COLOR_0"])
            for key, values in attributes.items():
                if len(values) != len(co):
                    raise Problem(f"{glb.path}: mesh {number}: {key} has {len(values)} values for {len(co)} vertices")
            told = glb.tree.get("materials", [{}])[primitive["material"]] if "material" in primitive else {}
            name = told.get("name", kind)
            what = kind_of_material(name) if "name" in told else kind if kind in MAKERS else "rock"
            base = told.get("pbrMetallicRoughness", {}).get("baseColorFactor", COLOURS.get(what, (0.5, 0.5, 0.5)))
            made.append(Part(co, triangles, make_material(name, what, base, attributes),
                             z_up(glb.array(given["NORMAL"])) if "NORMAL" in given else None,
                             glb.array(given["TEXCOORD_0"]) if "TEXCOORD_0" in given else None, attributes).checked(glb.path))
        return made

    def add_copies(self, glb, name, extras, prototype, given):
        places = z_up(glb.array(given["TRANSLATION"]))
        count = len(places)
        turns = np.tile(np.array([0, 0, 0, 1], np.float32), (count, 1))
        if "ROTATION" in given:
            q = glb.array(given["ROTATION"])
            turns = np.concatenate([z_up(q[:, :3]), q[:, 3:]], 1)
        scales = np.ones((count, 3), np.float32)
        if "SCALE" in given:
            s = glb.array(given["SCALE"])
            scales = s[:, [0, 2, 1]]
        attributes = {glb.name_of(k): glb.array(v) for k, v in given.items() if k.startswith("_")}
        if "id" in attributes and attributes["id"].ndim == 2:  # 24 bits in each of two floats; Blender knows 31
            low, high = attributes["id"].T.astype(np.int64)
            attributes["id"] = (low + (high << 24) & 0x7fffffff).astype(np.int32)
        for key, values in (("ROTATION", turns), ("SCALE", scales), *attributes.items()):
            if len(values) != count:
                raise Problem(f"{glb.path}: {name}: {key} has {len(values)} values for {count} copies")
        if not all(np.isfinite(v).all() for v in (places, turns, scales)):
            raise Problem(f"{glb.path}: {name}: a place that is not a number")
        self.copies += count
        self.grow(extras.get("set", "copies"), places)
        thing = make_instancer(name, prototype, places, eulers(turns), scales, attributes, self.collection("instances"))
        thing["sekitei_set"], thing["sekitei_species"] = extras.get("set", ""), extras.get("species", "")
        return thing

    # -- from .ply

    def read_plies(self, paths, grids):
        for path in paths:
            vertices, triangles, faces = read_ply(path)
            co = np.stack([vertices[a] for a in "xyz"], 1)
            if len(triangles):
                self.add_ply_mesh(path, co, vertices, triangles, faces)
            elif {"orient_w", "pscale", "species"} <= vertices.keys():
                self.add_ply_moss(path, co, vertices, grids)
            else:
                say(f"{path.name}: {len(co)} points that are not plants: left out")
        if not self.surfaces and not self.copies:
            raise Problem("nothing to show: neither a .glb nor a .ply with a mesh or plants is among the outputs")

    def add_ply_mesh(self, path, co, vertices, triangles, faces):
        name = path.stem
        kind = next((k for k in ("ground", "water", "bark", "leaves") if k in name.lower()), "rock")
        plain = {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha"}
        attributes = {plain_name(k): v for k, v in vertices.items() if k not in plain}
        faces = {plain_name(k): v for k, v in faces.items() if k not in plain}
        if "red" in vertices:
            attributes["tint"] = np.stack([vertices[c] / (255 if vertices[c].dtype.kind == "u" else 1) for c in ("red", "green", "blue")], 1)
        material = make_material(kind, kind, COLOURS[kind], {**attributes, **faces})
        normals = np.stack([vertices[c] for c in ("nx", "ny", "nz")], 1) if "nx" in vertices else None
        self.add_surface(name, kind, [Part(co, triangles, material, normals, None, attributes, faces).checked(path)])

    def add_ply_moss(self, path, co, points, grids):
        """Models stand in data/species beside this script; without them a cushion stands for each plant."""
        folder = Path(__file__).resolve().parent.parent / "species"
        cell = next((g["voxel_m"] for g in grids if g.get("name") in ("moss_growth", "surf_area")), 0.05)
        size = self.options.moss_size or 1.6 * cell
        kinds = sorted(p.stem for p in folder.glob("*.toml")) if folder.is_dir() else []
        names = self.options.species.split(",") if self.options.species else ["bryum", "hypnum", "polytrichum", "grimmia"]
        turns = eulers(np.stack([points["orient_" + c] for c in "xyzw"], 1))
        scales = np.repeat((points["pscale"] * size).astype(np.float32)[:, None], 3, 1)
        attributes = {k: points[k].astype(np.float32) for k in ("growth", "age", "species", "wetness") if k in points}
        ids = points["id"].astype(np.int64) if "id" in points else np.arange(len(co))
        attributes["id"] = (ids & 0x7fffffff).astype(np.int32)
        model = ids % 3
        for s in np.unique(points["species"]):
            species = names[s] if s < len(names) else f"species {s}"
            for m in range(3):
                rows = (points["species"] == s) & (model == m) & (points["pscale"] > 0)
                if not rows.any():
                    continue
                title = f"{species}_{m}_lod1"
                source = folder / f"{title}.ply"
                prototype = self.add_prototype(title, self.plant(title, source if species in kinds and source.is_file() else None, species))
                made = make_instancer(f"{path.stem}/{title}", prototype, co[rows], turns[rows], scales[rows],
                                      {k: v[rows] for k, v in attributes.items()}, self.collection("instances"))
                made["sekitei_set"], made["sekitei_species"] = "moss", species
                self.copies += int(rows.sum())
        self.grow("moss", co)

    @staticmethod
    def plant(title, source, species):
        if source:
            vertices, triangles, _ = read_ply(source)
            co = np.stack([vertices[a] for a in "xyz"], 1)
            extra = {k: vertices[k] for k in ("height", "tone") if k in vertices}
        else:  # half a sphere that grows along +y
            ring = np.array([(math.cos(a) * math.cos(h), math.sin(h), -math.sin(a) * math.cos(h))
                             for h in np.radians((0, 45)) for a in np.radians(range(0, 360, 45))])
            co = 0.5 * np.concatenate([ring, [(0, 1, 0)]])
            quads = [(k, (k + 1) % 8, 8 + (k + 1) % 8, 8 + k) for k in range(8)]
            triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d), (d, c, 16))]
            extra = {"height": co[:, 1]}
        return make_mesh(title, [Part(co, triangles, make_material("moss_" + species, "moss", COLOURS["moss"], extra), None, None, extra)])

    # -- volumes

    def read_volumes(self, outputs):
        groups = {}
        for output in outputs:
            match = re.fullmatch(r"(.*)\.(\d{4,})", output.path.stem)
            groups.setdefault(match[1] if match else output.path.stem, {})[int(match[2]) if match else None] = output
        for name, frames in groups.items():
            steps = sorted(f for f in frames if f is not None)
            whole = frames.get(None) or frames[steps[0]]
            data = bpy.data.volumes.new(name)
            data.filepath = str(whole.check().resolve())
            if not data.grids.load():
                raise Problem(f"{whole.path}: {data.grids.error_message}")
            shown = [g.name for g in data.grids if g.data_type == "FLOAT"]
            if not shown:
                bpy.data.volumes.remove(data)
                continue
            classes = {g["name"]: g.get("class") for g in whole.entry.get("grids", [])}
            fogs = [g for g in shown if classes.get(g) == "fog volume"]
            grid = first(shown, self.options.grid) or first(fogs, "density") or (fogs or shown)[0]
            material = bpy.data.materials.new("volume " + grid)
            material.use_nodes = True
            volume_material(Nodes(material.node_tree), grid)
            data.materials.append(material)
            data.grids.active_index = [g.name for g in data.grids].index(grid)
            if None not in frames and len(steps) > 1 and steps == list(range(steps[0], steps[0] + len(steps))):
                data.is_sequence, data.frame_start, data.frame_duration = True, 1, len(steps)
                data.frame_offset = steps[0] - 1
            thing = put(self.collection("volumes"), bpy.data.objects.new(name + " (volume)", data))
            thing.hide_render = not self.options.render_volumes
            thing.hide_viewport = thing.hide_render
            thing["sekitei_grids"] = " ".join(sorted(shown))

    # -- light, ground, camera

    def set_the_stage(self):
        world = self.scene.world = bpy.data.worlds.new("Sekitei sky")
        world.use_nodes = True
        azimuth, elevation = (math.radians(a) for a in self.options.sun)  # clockwise from north, which is +y
        n = Nodes(world.node_tree)
        sky = n.add("ShaderNodeTexSky")
        for kind in ("NISHITA", "MULTIPLE_SCATTERING"):
            if kind in sky.bl_rna.properties["sky_type"].enum_items:
                sky.sky_type = kind
                sky.sun_disc = False  # the lamp below is it: less noise
                sky.sun_elevation, sky.sun_rotation = elevation, azimuth
        light = n.add("ShaderNodeBackground", {"Color": sky.outputs[0], "Strength": 0.16})
        n.tree.links.new(light.outputs[0], n.add("ShaderNodeOutputWorld").inputs["Surface"])
        lamp = bpy.data.lights.new("Sun", "SUN")
        lamp.energy, lamp.angle, lamp.color = 3.6, math.radians(0.8), (1.0, 0.93, 0.82)
        sun = put(self.root, bpy.data.objects.new("Sun", lamp))
        sun.rotation_euler = (math.pi / 2 - elevation, 0, math.pi - azimuth)

        low, high = self.box(*self.boxes)
        if not self.options.no_ground:
            self.add_plain(low, high)
        self.add_camera(low, high)
        scene = self.scene
        scene.render.engine = "CYCLES"
        scene.cycles.samples = self.options.samples
        scene.cycles.use_adaptive_sampling, scene.cycles.adaptive_threshold = True, 0.01
        scene.cycles.max_bounces, scene.cycles.transparent_max_bounces = 8, 16
        scene.cycles.sample_clamp_direct, scene.cycles.sample_clamp_indirect = 20, 6  # glints of the sun on water and leaves
        scene.cycles.blur_glossy = 1.0
        scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
        try:
            scene.cycles.denoiser, scene.cycles.use_denoising = "OPENIMAGEDENOISE", True
        except TypeError:  # Debian's Blender has none
            scene.cycles.use_denoising = False
        for view in ("AgX", "Filmic"):
            try:
                scene.view_settings.view_transform = view
                break
            except TypeError:  # not in this Blender
                continue
        for look in ("AgX - Medium High Contrast", "Medium High Contrast"):
            try:
                scene.view_settings.look = look
                break
            except TypeError:
                continue
        scene.view_settings.exposure = self.options.exposure
        scene.render.resolution_x, scene.render.resolution_y = self.options.width, self.options.height
        scene.render.resolution_percentage = 100
        scene.unit_settings.system = "METRIC"

    def add_plain(self, low, high):
        """Earth out to the horizon, under all that is there; a lawn or gravel of the scene lies on it."""
        ground = self.box("ground")
        z = self.options.ground if self.options.ground is not None else (ground[0][2] - 0.01 if ground else float(low[2]))
        radius, middle = 40 * float(np.linalg.norm(high - low)), (low + high) / 2
        angles = np.linspace(0, 2 * math.pi, 64, endpoint=False)
        rim = np.stack([middle[0] + radius * np.cos(angles), middle[1] + radius * np.sin(angles), np.full(64, z)], 1)
        triangles = [(64, k, (k + 1) % 64) for k in range(64)]
        co = np.concatenate([rim, [(middle[0], middle[1], z)]])
        mesh = make_mesh("plain", [Part(co, triangles, make_material("ground", "ground", COLOURS["ground"], ()))])
        put(self.root, bpy.data.objects.new("plain", mesh))

    def add_camera(self, low, high):
        data = bpy.data.cameras.new("Camera")
        data.angle = math.radians(self.options.field_of_view)
        if self.options.camera:
            eye, target = Vector(self.options.camera[:3]), Vector(self.options.camera[3:])
        else:
            # From the south-south-west, so near that what is not ground or forest fills the picture.
            low, high = self.box("rock", "obstacle") or self.box("bark", "leaves") or (low, high)
            middle, reach = Vector((low + high) / 2), float(np.linalg.norm(high - low)) / 2
            side = Vector((-0.5, -1.0, 0.24)).normalized()
            narrow = min(data.angle, 2 * math.atan(math.tan(data.angle / 2) * self.options.height / self.options.width))
            eye, target = middle + side * (0.85 * reach / math.sin(narrow / 2)), middle
        if (eye - target).length < 1e-6:
            raise Problem("--camera: eye and target are one point", EXIT_USAGE)
        camera = put(self.root, bpy.data.objects.new("Camera", data))
        camera.location = eye
        camera.rotation_euler = (target - eye).to_track_quat("-Z", "Y").to_euler()
        data.clip_start, data.clip_end = 0.02, 1000 + 200 * float(np.linalg.norm(high - low))
        self.scene.camera = camera
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.spaces.active.region_3d.view_perspective = "CAMERA"
                    area.spaces.active.clip_end = data.clip_end


def parse(arguments):
    def numbers(count):
        def of(text):
            found = [float(x) for x in text.split(",")]
            if len(found) != count or not all(map(math.isfinite, found)):
                raise argparse.ArgumentTypeError(f"{text!r}: must be {count} numbers with commas between")
            return found
        return of

    def at_least_one(text):
        if int(text) < 1:
            raise argparse.ArgumentTypeError(f"{text}: must be 1 or more")
        return int(text)

    p = argparse.ArgumentParser(prog="blender [-b] -P import_sekitei.py --", description="Builds a Blender scene of what Sekitei wrote.")
    p.add_argument("manifest", help="manifest.json, the folder that has one, or a single .glb or .ply of Sekitei")
    p.add_argument("--render", metavar="FILE.png", type=Path, help="render with Cycles")
    p.add_argument("--save", metavar="FILE.blend", type=Path, help="save the scene")
    p.add_argument("--samples", type=at_least_one, default=128, help="paths for each pixel (default 128)")
    p.add_argument("--width", type=at_least_one, default=1200)
    p.add_argument("--height", type=at_least_one, default=750)
    p.add_argument("--camera", type=numbers(6), metavar="EX,EY,EZ,TX,TY,TZ", help="eye and target in metres, z up; default: by the bounds")
    p.add_argument("--field-of-view", type=float, default=38, metavar="DEGREES")
    p.add_argument("--sun", type=numbers(2), default=[215, 34], metavar="AZIMUTH,ELEVATION", help="degrees, clockwise from north (+y)")
    p.add_argument("--exposure", type=float, default=0, metavar="STOPS")
    p.add_argument("--ground", type=float, metavar="Z", help="height of the plain around the scene; default: under it")
    p.add_argument("--no-ground", action="store_true", help="no plain around the scene")
    p.add_argument("--no-volumes", action="store_true", help="leave .vdb files out")
    p.add_argument("--render-volumes", action="store_true", help="volumes are shown, by their fog")
    p.add_argument("--grid", help="grid by which volumes are shown (default: density or the first fog)")
    p.add_argument("--moss-size", type=float, metavar="METRES", help="diameter of a full-grown plant of points without a .glb")
    p.add_argument("--species", help="names of the mosses of such points, by number, with commas between")
    return p.parse_args(arguments)


def build(options):
    for path in (options.render, options.save):
        if path and not path.resolve().parent.is_dir():
            raise Problem(f"cannot write {path}: no such folder", EXIT_CANNOT_WRITE)
    version, outputs = read_manifest(options.manifest)
    importer = Importer(options)
    meshes = [o for o in outputs if o.suffix == ".glb"]
    if meshes:
        importer.read_glbs([o.check() for o in meshes])
    else:
        grids = [g for o in outputs for g in o.entry.get("grids", [])]
        importer.read_plies([o.check() for o in outputs if o.suffix == ".ply"], grids)
    if not options.no_volumes:
        importer.read_volumes([o for o in outputs if o.suffix == ".vdb"])
    importer.set_the_stage()
    say(f"{len(importer.surfaces)} surfaces, {sum(len(s.data.polygons) for s in importer.surfaces)} triangles, {importer.copies} copies, "
        f"{len(importer.collection('volumes').objects)} volumes" + (f", Sekitei {version}" if version else ""))
    if options.save:
        bpy.ops.wm.save_as_mainfile(filepath=str(options.save.resolve()))
    if options.render:
        options.render.unlink(missing_ok=True)
        importer.scene.render.image_settings.file_format = "PNG"
        importer.scene.render.filepath = str(options.render.resolve())
        bpy.ops.render.render(write_still=True)
        if not options.render.is_file():
            raise Problem(f"cannot write {options.render}", EXIT_CANNOT_WRITE)
    return importer


def main():
    arguments = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else []
    code = 0
    try:
        build(parse(arguments))
    except Problem as problem:
        print(f"import_sekitei: error: {problem}", file=sys.stderr, flush=True)
        code = problem.code
        if not bpy.app.background:
            words = str(problem)
            bpy.app.timers.register(lambda: bpy.context.window_manager.popup_menu(lambda menu, _: menu.layout.label(text=words),
                                                                                 title="Sekitei", icon="ERROR"))
    except SystemExit as end:  # argparse has told why
        code = end.code or 0
        if code == 0:
            sys.exit(0)
    except Exception:
        traceback.print_exc()
        code = 1
    if bpy.app.background and code:
        sys.stdout.flush()
        os._exit(code)  # Blender would end with 0


if __name__ == "__main__":
    main()
