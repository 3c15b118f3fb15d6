#!/usr/bin/env python3
"""Writes path.png, the lowest density map of 512 m x 512 m in which a path winds from south to north: black where the centre
of a pixel lies less than 6 m east or west of x = 256 + 64 sin(2 pi y / 512), else white; north up."""

import math
import struct
import sys
import zlib

SIZE = 512


def row(y):
    """The pixels from west to east whose centres are at y."""
    middle = 256 + 64 * math.sin(2 * math.pi * y / 512)
    return bytes(0 if abs(i + 0.5 - middle) < 6 else 255 for i in range(SIZE))


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png():
    rows = b"".join(b"\0" + row(j + 0.5) for j in reversed(range(SIZE)))
    header = struct.pack(">IIBBBBB", SIZE, SIZE, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


if __name__ == "__main__":
    with open(sys.argv[1] if len(sys.argv) > 1 else "path.png", "wb") as file:
        file.write(png())
