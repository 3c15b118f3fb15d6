"""Files of other programs, whole and broken: VDB through pyopenvdb, meshes and pictures by hand."""

import math
import struct
import zlib
from pathlib import Path

import numpy

numpy.bool = bool  # pyopenvdb was built against a numpy that still had it
import pyopenvdb  # noqa: E402


def level_set(name="sphere", radius=0.5, voxel=0.08, centre=(0.8, 0.8, 0.8)):
    """A sphere whose inside is negative [m]."""
    grid = pyopenvdb.createLevelSetSphere(radius=radius, center=centre, voxelSize=voxel, halfWidth=3)
    grid.name = name
    return grid


def fog(name="density", size=12, value=1.0, voxel=0.1):
    grid = pyopenvdb.FloatGrid()
    grid.name = name
    grid.gridClass = pyopenvdb.GridClass.FOG_VOLUME
    grid.transform = pyopenvdb.createLinearTransform(voxel)
    grid.fill((0, 0, 0), (size - 1, size - 1, size - 1), value)
    return grid


def write(path, *grids, **metadata):
    pyopenvdb.write(str(path), list(grids), metadata or None)
    return Path(path)


def sphere(path):
    return write(path, level_set())


def ply(vertices, faces, form="ascii", comment=""):
    """A PLY file; `form` is ascii, binary_little_endian or binary_big_endian."""
    head = (f"ply\nformat {form} 1.0\n{comment}element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
            f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n").encode()
    if form == "ascii":
        lines = [" ".join(f"{x:.9g}" for x in v) for v in vertices] + [" ".join(map(str, [len(f), *f])) for f in faces]
        return head + ("\n".join(lines) + "\n").encode()
    order = "<" if form == "binary_little_endian" else ">"
    return (head + b"".join(struct.pack(order + "3f", *v) for v in vertices)
            + b"".join(struct.pack(order + "B" + "i" * len(f), len(f), *f) for f in faces))


def read_ply(content):
    """Vertices, faces of a binary PLY, by rules that know nothing of the program; nothing may be left over."""
    sizes = {"float": "f", "int": "i", "uchar": "B", "double": "d", "float32": "f", "int32": "i", "uint8": "B", "uint": "I"}
    head, body = content.split(b"end_header\n", 1)
    assert b"format binary_little_endian 1.0" in head, head
    elements = []
    for words in (line.split() for line in head.decode().split("\n")[1:]):
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    at, found = 0, {"vertex": [], "face": []}
    for name, count, properties in elements:
        for _ in range(count):
            row = []
            for p in properties:
                form = sizes[p[1] if p[0] == "list" else p[0]]
                value = struct.unpack_from("<" + form, body, at)
                at += struct.calcsize("<" + form)
                if p[0] == "list":
                    form = f"<{value[0]}{sizes[p[2]]}"
                    value = [struct.unpack_from(form, body, at)]
                    at += struct.calcsize(form)
                row.append(value[0])
            if name == "vertex":
                found[name].append(row[:3])
            elif name == "face":
                found[name].append(row[0])
    assert at == len(body), f"{len(body) - at} bytes are left"
    return found["vertex"], found["face"]


def signed_volume(vertices, faces):
    """Positive where triangles face outwards [m^3]."""
    total = 0
    for a, b, c in ((vertices[i] for i in f) for f in faces):
        total += (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])) / 6
    return total


def box(lower=(0.2, 0.2, 0.2), upper=(1.4, 1.3, 1.2)):
    """Eight vertices and twelve triangles that face outwards."""
    v = [[(lower, upper)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return v, [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]


def png(width, height, grey):
    """A 16-bit grey PNG; grey(x, y) gives 0 to 65535."""
    rows = b"".join(b"\0" + b"".join(struct.pack(">H", grey(x, y)) for x in range(width)) for y in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def torus(rings=24, sides=12, major=0.5, minor=0.2, centre=(0.8, 0.8, 0.8)):
    v, f = [], []
    for i in range(rings):
        a = 2 * math.pi * i / rings
        for j in range(sides):
            b = 2 * math.pi * j / sides
            r = major + minor * math.cos(b)
            v.append((centre[0] + r * math.cos(a), centre[1] + r * math.sin(a), centre[2] + minor * math.sin(b)))
            p, q = i * sides + j, (i + 1) % rings * sides + j
            p1, q1 = i * sides + (j + 1) % sides, (i + 1) % rings * sides + (j + 1) % sides
            f += [(p, q, q1), (p, q1, p1)]
    return v, f
