#!/usr/bin/env python3
"""Writes laccolith.obj: a closed dome of lava on a flat base, metres, z up.

An icosphere is flattened into a dome, its base cut level, and its plan bent by a few sine lobes so that it has no
symmetry. Closed, 1280 triangles. Made for Sekitei; the same licence as the program (Apache-2.0).
"""
import math
import sys

GOLDEN = (1 + math.sqrt(5)) / 2


def icosphere(levels):
    vertices = [(-1, GOLDEN, 0), (1, GOLDEN, 0), (-1, -GOLDEN, 0), (1, -GOLDEN, 0),
                (0, -1, GOLDEN), (0, 1, GOLDEN), (0, -1, -GOLDEN), (0, 1, -GOLDEN),
                (GOLDEN, 0, -1), (GOLDEN, 0, 1), (-GOLDEN, 0, -1), (-GOLDEN, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2),
             (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11),
             (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    for _ in range(levels):
        middle, finer = {}, []

        def between(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                vertices.append(tuple((p + q) / 2 for p, q in zip(vertices[a], vertices[b])))
                middle[key] = len(vertices) - 1
            return middle[key]

        for a, b, c in faces:
            ab, bc, ca = between(a, b), between(b, c), between(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    unit = []
    for v in vertices:
        length = math.sqrt(sum(x * x for x in v))
        unit.append(tuple(x / length for x in v))
    return unit, faces


def dome(v):
    x, y, z = v
    angle = math.atan2(y, x)
    reach = 1 + 0.12 * math.sin(2 * angle + 0.7) + 0.07 * math.sin(3 * angle + 2.1)
    height = 2.6 * max(z, -0.35) + 0.91  # the lower cap becomes a level base at z = 0
    return 6.0 * reach * x, 4.6 * reach * y, height


unit, faces = icosphere(3)
out = sys.stdout if len(sys.argv) < 2 else open(sys.argv[1], "w", encoding="ascii")
out.write("# a dome of lava, metres, z up; made by make_laccolith.py (Apache-2.0)\no laccolith\n")
for v in unit:
    out.write("v %.4f %.4f %.4f\n" % dome(v))
for f in faces:
    out.write("f %d %d %d\n" % tuple(i + 1 for i in f))
