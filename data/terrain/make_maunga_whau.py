#!/usr/bin/env python3
"""Makes maunga-whau.png from volcano.json of the npm package vega-datasets 3.2.1.

    npm install vega-datasets@3.2.1
    python3 make_maunga_whau.py node_modules/vega-datasets/data/volcano.json maunga-whau.png

16-bit grey, black = 94 m, white = 195 m, north up. Standard library only.
"""
import json
import struct
import sys
import zlib

LOW, HIGH = 94, 195  # least and largest height [m]


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def main(source, target):
    with open(source, encoding="utf-8") as file:
        volcano = json.load(file)
    columns, rows, heights = volcano["width"], volcano["height"], volcano["values"]
    if (columns, rows, min(heights), max(heights)) != (87, 61, LOW, HIGH):
        sys.exit(f"{source}: not the map of 87 x 61 heights from {LOW} to {HIGH} m")
    # The file's lines run from south to north, the first along the western edge.
    width, height = rows, columns
    lines = bytearray()
    for row in range(height):
        lines.append(0)  # no filter
        for column in range(width):
            metres = heights[column * columns + columns - 1 - row]
            lines += struct.pack(">H", ((metres - LOW) * 65535 + (HIGH - LOW) // 2) // (HIGH - LOW))
    with open(target, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        file.write(chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)))
        file.write(chunk(b"IDAT", zlib.compress(bytes(lines), 9)))
        file.write(chunk(b"IEND", b""))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2])
