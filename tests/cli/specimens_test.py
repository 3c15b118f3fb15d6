"""Models of trees for instancing: of height 1, whole, told of in an index."""

import json
import unittest

from support import DONE, USAGE, CliTest, run

YOUNG = ["--variants", "2", "--generations", "6,12", "--species", "beech", "--species", "pine"]


class Specimens(CliTest):
    def grow(self, *options):
        done = run("specimens", "-o", self.folder, *(options or YOUNG), "--json", "-q")
        self.assertEqual(done.code, DONE, done)
        return done.json()["files"]

    def test_models_are_of_height_one_and_the_index_knows_them(self):
        files = self.grow()
        self.assertEqual(len(files), 2 * (2 * 2 * 3 + 1))
        for kind in ("beech", "pine"):
            index = json.loads((self.folder / f"{kind}.json").read_text())
            self.assertEqual([(m["variant"], m["generations"]) for m in index["models"]], [(0, 6), (0, 12), (1, 6), (1, 12)])
            for model in index["models"]:
                self.assertLess(model["crown_base"], 1)
                self.assertGreater(model["trunk_diameter_m"], 0.003)
                triangles = [model["triangles"][level] for level in ("near", "middle", "far")]
                self.assertEqual(triangles, sorted(triangles, reverse=True))
                for level, name in model["files"].items():
                    info = run("info", self.folder / name, "--json")
                    self.assertEqual(info.code, DONE, info)
                    self.assertIn(b"property int part\n", (self.folder / name).read_bytes()[:4000])
                    (x0, y0, z0), (x1, y1, z1) = bounds(info.json())
                    self.assertLess(abs(z0), 0.1)
                    # Leaves stand a little out of their balls, and few large ones farther.
                    self.assertLess(abs(z1 - 1), 0.06 + 0.5 * (level != "near"), name)
                    radius = model["crown_radius"]
                    self.assertLess(max(-x0, -y0, x1, y1), radius * (1.15 if level == "near" else 1.6), name)
            first, last = index["models"][0], index["models"][1]
            self.assertLess(first["height_m"], last["height_m"])
            self.assertLess(first["trunk_diameter_m"], last["trunk_diameter_m"])
        seeds = {(self.folder / f"beech_{v}_12_near.ply").read_bytes() for v in (0, 1)}
        self.assertEqual(len(seeds), 2, "variants differ")

    def test_the_same_words_make_the_same_bytes_on_any_number_of_threads(self):
        words = ["--variants", "1", "--generations", "14", "--species", "oak"]
        made = []
        for threads in (1, 2):
            files = self.grow(*words, "--force", "--threads", threads)
            made.append([open(f, "rb").read() for f in files])
        self.assertEqual(*made)

    def test_mistakes_are_named(self):
        def refuse(words, *options, code=USAGE):
            self.refuse(code, words, "specimens", *options)
        refuse(["--output"])
        refuse(["folder"], "-o", self.folder / "none")
        refuse(["--variants"], "-o", self.folder, "--variants", "0")
        refuse(["--generations"], "-o", self.folder, "--generations", "20,10")
        refuse(["--generations"], "-o", self.folder, "--generations", "0")
        refuse(["baech", "beech"], "-o", self.folder, "--species", "baech")
        refuse(["twice"], "-o", self.folder, "--species", "oak", "--species", "oak")
        (self.folder / "shoot.toml").write_text('name = "bush"\nmodel = "shoot"\n')
        refuse(["single tree"], "-o", self.folder, "--species", self.folder / "shoot.toml")
        (self.folder / "beech.json").write_text("mine")
        refuse(["beech.json", "--force"], "-o", self.folder)
        self.assertEqual((self.folder / "beech.json").read_text(), "mine")
        self.assertEqual([p.name for p in self.folder.glob("*.ply")], [])


def bounds(info):
    """The first value called bounds, wherever it stands."""
    if isinstance(info, dict):
        for key, value in info.items():
            if key.startswith("bounds"):
                return value
        info = list(info.values())
    for value in info if isinstance(info, list) else []:
        found = bounds(value)
        if found:
            return found
    return None


if __name__ == "__main__":
    unittest.main()
