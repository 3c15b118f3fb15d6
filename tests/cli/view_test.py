"""`sekitei view`: what a page holds, what it is made of, and what cannot become one."""

import base64
import json
import re
import struct
import unittest
import zlib

from habitat_test import HabitatTest
from support import BAD_INPUT, CANNOT_WRITE, LIMIT, RECIPE, USAGE


class PageFile:
    """A page taken apart: its JSON, and its blocks as bytes."""

    def __init__(self, path):
        text = path.read_text("utf-8")
        self.text = text
        self.meta = json.loads(re.search(r'<script type="application/json" id="sekitei">(.*?)</script>', text, re.S)[1])
        self.blocks = []
        for about, content in zip(self.meta["blocks"], re.findall(r'<script type="text/plain" id="b\d+">(.*?)</script>', text)):
            data = base64.b64decode(content, validate=True)
            if about["packed"]:
                data = zlib.decompress(data)
            assert len(data) == about["size"], about
            n, width = len(data) // about["width"], about["width"]
            self.blocks.append(bytes(data[b * n + i] for i in range(n) for b in range(width)) if width > 1 else data)

    def glb(self, frame):
        """The .glb of a frame as the page puts it together: its JSON and the bytes of its views."""
        entry = self.meta["frames"][frame]["glb"]
        return json.loads(self.blocks[entry["json"]]), [(v["offset"], self.blocks[v["block"]]) for v in entry["views"]]

    def numbers(self, column):
        """A column of decimals as numbers."""
        if "digits" in column:
            mantissa, exponent = self.blocks[column["mantissa"]], self.blocks[column["exponent"]]
            m, e = struct.unpack(f"<{len(mantissa) // 2}h", mantissa), struct.unpack(f"<{len(exponent)}b", exponent)
            return [float(f"{a}e{b}") for a, b in zip(m, e)]
        fixed = self.blocks[column["fixed"]]
        return [0.0 if v == -32767 else v / 10 ** column["places"] for v in struct.unpack(f"<{len(fixed) // 2}h", fixed)]


class View(HabitatTest):
    def test_page_has_the_scene_and_needs_nothing_else(self):
        told = self.succeed("view", self.moss, "-o", "page.html", "--json").json()
        page = PageFile(self.folder / "page.html")
        self.assertEqual(told, {"page": "page.html", "bytes": len(page.text.encode()), "moments": 1})
        self.assertEqual(re.findall(r'<(?:script|link|img|iframe)[^>]*(?:src|href)="(?!data:)[^"]*"', page.text), [], "no other files")
        self.assertNotRegex(page.text, r"@import|url\((?!data:)")
        self.succeed("export", self.moss, "--to", "moss.glb")
        content = (self.folder / "moss.glb").read_bytes()
        size = struct.unpack_from("<I", content, 12)[0]
        document, views = page.glb(0)
        self.assertEqual(document, json.loads(content[20:20 + size]), "the .glb of `export`")
        for offset, data in views:
            self.assertEqual(data, content[28 + size + offset:28 + size + offset + len(data)])

    def test_explains_every_cell_as_explain_does(self):
        self.succeed("view", self.moss, "-o", "page.html")
        page = PageFile(self.folder / "page.html")
        table = page.meta["frames"][0]["explain"]
        position = struct.unpack(f"<{3 * table['count']}d", page.blocks[table["position"]])
        measures = {m["name"]: page.numbers(m["column"]) for m in table["measures"]}
        for cell in (0, 123, table["count"] - 1):
            at = position[3 * cell:3 * cell + 3]
            said = self.succeed("explain", self.moss, "--at", ",".join(map(repr, at)), "--json").json()
            self.assertLess(said["away_m"], 1e-9)
            for name, values in measures.items():
                self.assertEqual(values[cell], float(f"{said[name]:.4g}"), f"{name} of cell {cell}")
            self.assertGreaterEqual(len(measures), 15)
            for species, entry in zip(table["species"], said["species"]):
                self.assertEqual(species["name"], entry["name"])
                for factor, column in zip(["temperature", "humidity", "light", "gate", "G"], species["numbers"]):
                    self.assertEqual(page.numbers(column)[cell], float(f"{entry[factor]:.3f}"))
                self.assertEqual(page.numbers(species["mean"])[cell], float(f"{entry['mean_G']:.3f}"))
                self.assertEqual(table["factors"][page.blocks[species["flags"]][cell] & 3], entry["limiting"])

    def test_moments_share_what_stays_the_same(self):
        frames = sorted(p.name for p in self.scenes.glob("moss.0*.vdb"))
        self.assertGreaterEqual(len(frames), 3)
        self.succeed("view", *frames[:3], "-o", self.folder / "three.html", cwd=self.scenes)
        self.succeed("view", frames[0], "-o", self.folder / "one.html", cwd=self.scenes)
        three, one = PageFile(self.folder / "three.html"), PageFile(self.folder / "one.html")
        self.assertEqual([f["label"] for f in three.meta["frames"]], [f"day {int(name.split('.')[1])}" for name in frames[:3]])
        self.assertEqual([f["explain"]["file"] for f in three.meta["frames"]], frames[:3])
        rock = {three.meta["frames"][k]["glb"]["views"][0]["block"] for k in range(3)}
        self.assertEqual(len(rock), 1, "the rock's places are there once")
        bytes_of = lambda page: sum(len(b) for b in page.blocks)
        self.assertLess(bytes_of(three), 2.2 * bytes_of(one))

    def test_same_bytes_on_any_number_of_threads(self):
        for threads in ("1", "3"):
            self.succeed("view", self.moss, "-o", f"page{threads}.html", "--threads", threads)
        self.assertEqual((self.folder / "page1.html").read_bytes(), (self.folder / "page3.html").read_bytes())

    def test_folder_of_a_recipe(self):
        self.write("habitat.toml", """\
sekitei = 1
out = "out"
[lantern]
layout = "pond"
cell = "5cm"
[light]
weather = "days.csv"
[wind]
garden_spacing = "1m"
object_spacing = "20cm"
settle = 0
duration = 0.5
[soil]
[moss]
every = "30d"
write = "moss.vdb"
""")
        self.succeed("run", "habitat.toml", "-q")
        self.succeed("view", "out")
        page = PageFile(self.folder / "out" / "view.html")
        self.assertEqual(page.meta["title"], "out")
        self.assertEqual([f["label"] for f in page.meta["frames"]], ["day 30", "day 60", "day 70"])
        self.refuse(USAGE, ["view.html exists", "--force"], "view", "out")
        self.succeed("view", "out/manifest.json", "--force")
        with self.subTest("a file that the manifest names is gone"):
            (self.folder / "out" / "moss.0060.vdb").unlink()
            self.refuse(BAD_INPUT, ["manifest.json", "moss.0060.vdb", "missing"], "view", "out", "--force")

    def test_glb_with_the_scene_that_explains_it(self):
        self.succeed("export", self.moss, "--to", "garden.glb")
        self.succeed("view", "garden.glb")
        self.assertIsNone(PageFile(self.folder / "garden.html").meta["frames"][0]["explain"])
        self.succeed("view", "garden.glb", self.moss, "--force")
        self.assertGreater(PageFile(self.folder / "garden.html").meta["frames"][0]["explain"]["count"], 500)

    def test_what_cannot_be_shown(self):
        (self.folder / "empty").mkdir()
        self.refuse(BAD_INPUT, ["empty", "no manifest.json"], "view", "empty")
        self.refuse(USAGE, ["input"], "view")
        self.refuse(BAD_INPUT, ["nowhere.vdb", "no such file"], "view", "nowhere.vdb")
        self.refuse(USAGE, ["days.csv", ".vdb"], "view", "days.csv")
        self.refuse(USAGE, ["page.png", ".html"], "view", self.moss, "-o", "page.png")
        self.refuse(CANNOT_WRITE, ["nowhere"], "view", self.moss, "-o", "nowhere/page.html")
        self.refuse(USAGE, ["--moss-lod 7"], "view", self.moss, "-o", "page.html", "--moss-lod", "7")
        for text, words in (("{", "not a manifest"), ('{"outputs": [{}]}', "an output without path"), ('{"outputs": []}', "nothing to show"),
                            ('{"outputs": [{"path": "gone.vdb"}]}', "gone.vdb")):
            self.write("manifest.json", text)
            self.refuse(BAD_INPUT, ["manifest.json", words], "view", "manifest.json")

    def test_damaged_scenes_are_refused(self):
        scene = self.moss.read_bytes()
        (self.folder / "half.vdb").write_bytes(scene[:len(scene) // 2])
        self.refuse(BAD_INPUT, ["half.vdb"], "view", "half.vdb")
        self.succeed("export", self.moss, "--to", "good.glb")
        good = (self.folder / "good.glb").read_bytes()
        size = struct.unpack_from("<I", good, 12)[0]
        for name, content, words in (
                ("empty.glb", b"", "an empty file"), ("png.glb", b"\x89PNG\r\n\x1a\n" + bytes(40), "not a glTF binary"),
                ("cut.glb", good[:-100], "truncated"), ("one.glb", good[:4] + b"\1" + good[5:], "version 1"),
                ("json.glb", good[:20] + b"[" + good[21:], "JSON cannot be read"),
                ("long.glb", good[:20] + re.sub(rb'("byteLength":)\d', rb"\g<1>9", good[20:20 + size]) + good[20 + size:], "are missing")):
            (self.folder / name).write_bytes(content)
            done = self.refuse(BAD_INPUT, [name], "view", name)
            self.assertRegex(done.err, words, name)
        self.succeed("view", "good.glb")


if __name__ == "__main__":
    unittest.main()
