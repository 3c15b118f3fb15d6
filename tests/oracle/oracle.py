"""What the tests by other programs share: which programs they need, Blender without a window, pictures."""

import json
import os
import shutil
import struct
import subprocess
import sys
import unittest
import zlib

import numpy

SKIPPED = 77  # ctest's SKIP_RETURN_CODE


def main(*programs):
    """Runs the tests of the calling script; without one of `programs` they are skipped, or, by ./run oracle, have failed."""
    missing = [p for p in programs if not shutil.which(p)]
    if missing:
        print(f"skipped: {', '.join(missing)} not installed; ./run oracle installs every program these tests need")
        sys.exit(1 if os.environ.get("SEKITEI_ORACLE") == "required" else SKIPPED)
    unittest.main()


def run_blender(*arguments, **options):
    """Blender without a window. Debian's takes the first python3 of PATH for its own, which must be Debian's, with numpy."""
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    program = shutil.which("blender")
    env["PATH"] = "/usr/bin:" + env["PATH"]
    return subprocess.run([program, "--background", "--factory-startup", *map(str, arguments)], capture_output=True, text=True, env=env,
                          **options)


def blender(test, script, *arguments, timeout=300):
    """Runs a Python script in Blender; returns what it gave to `result(...)`."""
    head = """
import json, sys
import numpy
numpy.bool = bool  # Blender 3.4's glTF importer speaks to a numpy that still had it
import bpy
arguments = sys.argv[sys.argv.index("--") + 1:]
def result(value):
    print("RESULT " + json.dumps(value), flush=True)
"""
    path = test.write("in_blender.py", head + script)
    done = run_blender("--python-exit-code", 9, "--python", path, "--", *arguments, timeout=timeout)
    line = next((l for l in done.stdout.split("\n") if l.startswith("RESULT ")), None)
    test.assertIsNotNone(line, f"exit {done.returncode}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")
    test.assertEqual(done.returncode, 0, done.stderr[-3000:])
    return json.loads(line[7:])


def read_png(path):
    """Pixels of an 8 or 16-bit PNG as (height, width, channels) numbers in 0..1."""
    content = path.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n", path
    at, data = 8, b""
    while at < len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        chunk = content[at + 8:at + 8 + size]
        assert struct.unpack_from(">I", content, at + 8 + size)[0] == zlib.crc32(kind + chunk), f"{path}: {kind} is damaged"
        if kind == b"IHDR":
            width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", chunk)
            assert not interlaced and depth in (8, 16), path
            channels = {0: 1, 2: 3, 4: 2, 6: 4}[colour]
        elif kind == b"IDAT":
            data += chunk
        at += 12 + size
    pixel = channels * depth // 8
    rows = numpy.frombuffer(zlib.decompress(data), numpy.uint8).reshape(height, 1 + width * pixel)
    filters, rows = rows[:, 0], rows[:, 1:].astype(numpy.int64)
    image = numpy.zeros((height, width * pixel), numpy.int64)
    above = numpy.zeros(width * pixel, numpy.int64)
    for y in range(height):
        row = rows[y].copy()
        if filters[y] == 2:
            row = (row + above) & 255
        elif filters[y] == 1:
            row = row.reshape(width, pixel).cumsum(0).reshape(-1) & 255
        elif filters[y]:
            row = _unfilter(row, above, pixel, int(filters[y]))
        image[y] = above = row
    image = image.reshape(height, width, channels, depth // 8)
    return image[..., 0] / 255 if depth == 8 else (image[..., 0] * 256 + image[..., 1]) / 65535


def _unfilter(row, above, pixel, kind):
    """A row filtered by the mean (3) or Paeth's guess (4) of its neighbours."""
    row, above = row.tolist(), above.tolist()
    for x in range(len(row)):
        left, up = row[x - pixel] if x >= pixel else 0, above[x]
        if kind == 3:
            guess = (left + up) // 2
        else:
            corner = above[x - pixel] if x >= pixel else 0
            p = left + up - corner
            guess = min((abs(p - left), 0, left), (abs(p - up), 1, up), (abs(p - corner), 2, corner))[2]
        row[x] = (row[x] + guess) & 255
    return numpy.array(row, numpy.int64)


def shows_something(test, path, colours=200, spread=0.02):
    """Fails on a picture that is one colour, black, or has next to none of its pixels away from the commonest colour."""
    image = read_png(path)[..., :3]
    grey = image.mean(2)
    quantised = (image * 63).round().astype(int)
    _, counts = numpy.unique(quantised.reshape(-1, quantised.shape[-1]), axis=0, return_counts=True)
    told = f"{path.name}: {image.shape}, mean {grey.mean():.3f}, deviation {grey.std():.3f}, {len(counts)} colours, " \
           f"{counts.max() / counts.sum():.3f} of one colour"
    print(told)
    test.assertGreater(grey.mean(), 0.02, told)
    test.assertGreater(grey.std(), spread, told)
    test.assertGreater(len(counts), colours, told)
    test.assertLess(counts.max() / counts.sum(), 0.97, told)
    return image
