#!/usr/bin/env python3
"""Makes the maps of the recipes garden.toml and landscape.toml.

    python3 make_garden_maps.py

stone-group.png: heights of a group of three stones, as gardeners set them: a high one, a companion that leans on it, a low
one apart; black 0, white 1 of the highest. Drawn by the formula below.
maunga-whau-moisture.png: how moist the ground of maunga-whau.png is, 0 to 1: the topographic wetness index
ln(a / tan(slope)) [Beven1979], a the area upslope per metre of contour, by steepest descent among eight
neighbours (D8) after pits are filled, from its 2nd to its 98th percentile, smoothed once.
Standard library only; 16-bit grey, north up.
"""
import math
import struct
import zlib
from pathlib import Path

HERE = Path(__file__).parent
PIXEL = 10.0  # of maunga-whau.png [m]


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_png(path, rows):
    """Rows from the north of values 0..1."""
    lines = bytearray()
    for row in rows:
        lines.append(0)  # no filter
        for value in row:
            lines += struct.pack(">H", round(65535 * min(1.0, max(0.0, value))))
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        file.write(chunk(b"IHDR", struct.pack(">IIBBBBB", len(rows[0]), len(rows), 16, 0, 0, 0, 0)))
        file.write(chunk(b"IDAT", zlib.compress(bytes(lines), 9)))
        file.write(chunk(b"IEND", b""))


def read_png(path):
    """Rows of a 16-bit grey picture without filters, as make_maunga_whau.py writes it."""
    data = path.read_bytes()
    at, packed = 8, b""
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + size]
        if kind == b"IHDR":
            width, height = struct.unpack(">II", body[:8])
        if kind == b"IDAT":
            packed += body
        at += 12 + size
    lines = zlib.decompress(packed)
    stride = 1 + 2 * width
    return [list(struct.unpack(f">{width}H", lines[r * stride + 1:(r + 1) * stride])) for r in range(height)]


def stone_group(width=96, height=72):
    # x, y of the foot in shares of the map, height, radius, how steep its side is, where it leans
    stones = [(0.42, 0.58, 0.96, 0.25, 2.4, 0.30), (0.69, 0.46, 0.58, 0.19, 3.0, -0.35), (0.19, 0.28, 0.36, 0.14, 3.0, 0.25)]
    rows = []
    for j in range(height):
        y = (height - 0.5 - j) / height * 0.75
        row = []
        for i in range(width):
            x = (i + 0.5) / width
            value = 0.0
            for px, py, top, radius, steep, lean in stones:
                dx, dy = x - px, y - py * 0.75
                wave = 1 + 0.12 * math.sin(3 * math.atan2(dy, dx) + 7 * px) + 0.07 * math.sin(7 * math.atan2(dy, dx) + 3 * py)
                r = math.hypot(dx, dy) / (radius * wave)
                tilt = 1 + lean * (dx + 0.5 * dy) / radius
                value = max(value, top * tilt * max(0.0, 1 - r ** steep))
            row.append(value)
        rows.append(row)
    return rows


def moisture(heights):
    """Rows from the north of metres."""
    height, width = len(heights), len(heights[0])
    around = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]
    inside = lambda j, i: 0 <= j < height and 0 <= i < width
    # Pits are filled to just above where they would run over [Planchon2002].
    z = [[heights[j][i] if j in (0, height - 1) or i in (0, width - 1) else 1e9 for i in range(width)] for j in range(height)]
    changed = True
    while changed:
        changed = False
        for j in range(height):
            for i in range(width):
                for dj, di in around:
                    if not inside(j + dj, i + di) or z[j][i] <= heights[j][i]:
                        continue
                    sill = z[j + dj][i + di] + 0.01 * math.hypot(dj, di)
                    level = heights[j][i] if heights[j][i] >= sill else sill
                    if level < z[j][i]:
                        z[j][i] = level
                        changed = True
    area = [[PIXEL * PIXEL] * width for _ in range(height)]
    for _, j, i in sorted(((z[j][i], j, i) for j in range(height) for i in range(width)), reverse=True):
        falls = [((z[j][i] - z[j + dj][i + di]) / math.hypot(dj, di), dj, di) for dj, di in around if inside(j + dj, i + di)]
        steepest, dj, di = max(falls)
        if steepest > 0:
            area[j + dj][i + di] += area[j][i]
    index = [[0.0] * width for _ in range(height)]
    for j in range(height):
        for i in range(width):
            gx = (heights[j][min(i + 1, width - 1)] - heights[j][max(i - 1, 0)]) / (PIXEL * (min(i + 1, width - 1) - max(i - 1, 0)))
            gy = (heights[min(j + 1, height - 1)][i] - heights[max(j - 1, 0)][i]) / (PIXEL * (min(j + 1, height - 1) - max(j - 1, 0)))
            index[j][i] = math.log(area[j][i] / PIXEL / max(math.hypot(gx, gy), 0.02))
    soft = [[sum(index[j + dj][i + di] for dj, di in around + [(0, 0)] if inside(j + dj, i + di))
             / sum(1 for dj, di in around + [(0, 0)] if inside(j + dj, i + di)) for i in range(width)] for j in range(height)]
    ranked = sorted(v for row in soft for v in row)
    low, high = ranked[len(ranked) // 50], ranked[-len(ranked) // 50]
    return [[(v - low) / (high - low) for v in row] for row in soft]


if __name__ == "__main__":
    write_png(HERE / "stone-group.png", stone_group())
    land = [[94 + (195 - 94) * grey / 65535 for grey in row] for row in read_png(HERE / "maunga-whau.png")]
    write_png(HERE / "maunga-whau-moisture.png", moisture(land))
