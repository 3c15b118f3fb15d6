#!/usr/bin/env python3
"""Writes the scenes of moss on meshes beside this file: roof2x2.ply, shade_000.ply .. shade_100.ply, boulder.ply.

Metres, z up. The face attribute `geology` says what a face is made of: 1 humus, 2 sand, 3 rock; `zone` where it is: in
roof2x2 1 front floor, 2 back floor, 3 wall, 4 the roof's underside, 5 its top, in shade 1 the floor, elsewhere 0. Needs nothing but Python and
gives the same bytes every time. Made for Sekitei; the same licence as the program (Apache-2.0).
"""
import math
import os
import struct
import sys

HUMUS, SAND, ROCK = 1, 2, 3


class Mesh:
    def __init__(self):
        self.vertices, self.faces = [], []

    def box(self, lower, upper, geology):
        """A closed box with vertices of its own, cut into squares of about 1/9 m.

        Halved three times they make sites of 0.02 m with little waste; a long thin face would divide badly.
        """
        size = [upper[k] - lower[k] for k in range(3)]
        count = [max(1, round(9 * s)) for s in size]
        index = {}

        def vertex(at):
            if at not in index:
                index[at] = len(self.vertices)
                self.vertices.append(tuple(upper[k] if at[k] == count[k] else lower[k] + size[k] * at[k] / count[k]
                                           for k in range(3)))
            return index[at]

        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for side in (0, count[axis]):
                for i in range(count[u]):
                    for j in range(count[v]):
                        ring = []
                        for p, q in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                            at = [0, 0, 0]
                            at[axis], at[u], at[v] = side, p, q
                            ring.append(vertex(tuple(at)))
                        self.faces.append((tuple(ring if side else ring[::-1]), geology))

    def sheet(self, x0, x1, y0, y1, z, pieces, geology):
        """A level rectangle that looks up, cut across in pieces: long thin triangles divide badly."""
        base = len(self.vertices)
        for i in range(pieces + 1):
            y = y0 + (y1 - y0) * i / pieces
            self.vertices += [(x0, y, z), (x1, y, z)]
        for i in range(pieces):
            k = base + 2 * i
            self.faces.append(((k, k + 1, k + 3, k + 2), geology))

    def zone(self, face, zones):
        """The number of the first zone in which a face lies: (axis, sign of the normal, lower corner, upper corner)."""
        corners = [self.vertices[k] for k in face]
        a, b, c = corners[0], corners[1], corners[-1]
        u, v = [b[k] - a[k] for k in range(3)], [c[k] - a[k] for k in range(3)]
        normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        middle = [sum(p[k] for p in corners) / len(corners) for k in range(3)]
        for number, (axis, sign, lower, upper) in enumerate(zones, 1):
            inside = all(lower[k] - 1e-6 <= middle[k] <= upper[k] + 1e-6 for k in range(3))
            if inside and normal[axis] * sign > 0.99 * math.sqrt(sum(x * x for x in normal)):
                return number
        return 0

    def save(self, name, what, zones=()):
        head = ("ply\nformat binary_little_endian 1.0\ncomment %s\ncomment metres, z up; made by make_moss_scenes.py "
                "(Apache-2.0)\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\nelement face %d\n"
                "property list uchar ushort vertex_indices\nproperty uchar geology\n%send_header\n"
                % (what, len(self.vertices), len(self.faces), "property uchar zone\n" if zones else ""))
        out = [head.encode("ascii")]
        out += [struct.pack("<3f", *v) for v in self.vertices]
        for f, g in self.faces:
            out.append(struct.pack("<B%dHB" % len(f), len(f), *f, g))
            if zones:
                out.append(bytes([self.zone(f, zones)]))
        write(name, b"".join(out))


def write(name, data):
    folder = sys.argv[1] if len(sys.argv) > 1 else os.path.dirname(os.path.abspath(__file__))
    with open(os.path.join(folder, name), "wb") as file:
        file.write(data)


def roof():
    """A floor of 2 x 2 m, a wall along its far side, and a roof over the far half: three solids that touch."""
    mesh = Mesh()
    mesh.box((0, -2, -0.3), (2, 0, 0), HUMUS)
    mesh.box((0, 0, 0), (2, 0.1, 1.5), SAND)
    mesh.box((0, -1, 1.4), (2, 0, 1.5), SAND)
    mesh.save("roof2x2.ply", "roof over the far half of a floor, moss by reflected light",
              [(2, 1, (0, -2, 0), (2, -1, 0)), (2, 1, (0, -1, 0), (2, 0, 0)), (1, -1, (0, 0, 0), (2, 0, 1.4)),
               (2, -1, (0, -1, 1.4), (2, 0, 1.4)), (2, 1, (0, -1, 1.5), (2, 0, 1.5))])


# Through one gap the sun's disc lights a disc of radius height tan(0.2665 deg) on the floor. At 1.1166 pitches the first
# harmonic of the pattern of gaps vanishes (the second zero of the Bessel function J1): at any point the light is within 8 % of
# the mean, under 20 % of the light within 6 %. The mean over 0.10 m that makes an irradiance of photons leaves 0.01 %.
PITCH = 0.010
HEIGHT = 1.1166 * PITCH / math.tan(math.radians(0.2665))  # 2.4 m; light thrown back by the slats is lost, too
BEYOND = 0.02  # the cover reaches beyond the floor, for the slanting part of the beam


def shade(per_cent):
    """A humus floor under slats that let `per_cent` of a vertical beam through.

    Slats are sheets that look up: they have no underside on which moss could live in their own shade, and their tops stand in
    full sun.
    """
    mesh = Mesh()
    mesh.box((0, -2, -0.3), (2, 0, 0), HUMUS)
    if per_cent == 0:
        mesh.sheet(-BEYOND, 2 + BEYOND, -2 - BEYOND, BEYOND, HEIGHT, 1, ROCK)
    elif per_cent < 100:
        width = PITCH * (1 - per_cent / 100)
        for i in range(round((2 + 2 * BEYOND) / PITCH)):
            left = -BEYOND + i * PITCH
            mesh.sheet(left, left + width, -2 - BEYOND, BEYOND, HEIGHT, 9, ROCK)
    mesh.save("shade_%03d.ply" % per_cent, "a floor under slats that let %d %% of a vertical beam through" % per_cent,
              [(2, 1, (0, -2, 0), (2, 0, 0))])


def icosphere(levels):
    golden = (1 + math.sqrt(5)) / 2
    vertices = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0), (0, -1, golden), (0, 1, golden),
                (0, -1, -golden), (0, 1, -golden), (golden, 0, -1), (golden, 0, 1), (-golden, 0, -1), (-golden, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
             (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7),
             (9, 8, 1)]
    vertices = [unit(v) for v in vertices]
    for _ in range(levels):
        middle, finer = {}, []

        def between(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                vertices.append(unit(tuple(p + q for p, q in zip(vertices[a], vertices[b]))))
                middle[key] = len(vertices) - 1
            return middle[key]

        for a, b, c in faces:
            ab, bc, ca = between(a, b), between(b, c), between(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    return vertices, faces


def unit(v):
    length = math.sqrt(sum(x * x for x in v))
    return tuple(x / length for x in v)


def waves(v, frequency, seed):
    """A smooth number of about -1 .. 1: six plane waves of one length in directions spread over the sphere."""
    total = 0.0
    for k in range(6):
        z = 1 - (2 * k + 1) / 6
        turn = 2.399963 * k + seed
        r = math.sqrt(1 - z * z)
        along = v[0] * r * math.cos(turn) + v[1] * r * math.sin(turn) + v[2] * z
        total += math.sin(frequency * along + 1.7 * seed + 2.1 * k)
    return total / math.sqrt(12)


def boulder(levels):
    """A closed boulder, radius 0.5 m and uneven, with crevices, sunk 6 cm into a slab of humus."""
    mesh = Mesh()
    vertices, faces = icosphere(levels)
    for v in vertices:
        crack = math.exp(-(waves(v, 5.0, 4.2) / 0.16) ** 2)  # where the waves change sign
        radius = 0.5 * (1 + 0.09 * waves(v, 2.3, 0.4) + 0.025 * waves(v, 9.0, 2.9) - 0.20 * crack)
        mesh.vertices.append(tuple(radius * x for x in v))
    floor = min(v[2] for v in mesh.vertices) + 0.06
    mesh.vertices = [(x, y, z - floor) for x, y, z in mesh.vertices]
    mesh.faces = [(f, ROCK) for f in faces]
    mesh.box((-1.2, -1.2, -0.3), (1.2, 1.2, 0), HUMUS)
    mesh.save("boulder.ply", "a boulder with crevices on a slab of humus")


roof()
for share in (0, 5, 10, 20, 40, 80, 100):
    shade(share)
boulder(5)
