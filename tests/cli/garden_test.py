"""A garden in which each stage feels the others: by recipe, step by step, and with bad input."""

import csv
import json
import unittest

from support import BAD_INPUT, LIMIT, USAGE, CliTest, files_in, spring_weather

# A garden of some 4000 cells with a small rock, a pond, a forest of 24 x 16 m and one tree.
RECIPE = """\
sekitei = 1
seed = 5
out = "out"

[lava]
preset = "coast"
size = ["1.2m", "1.2m", "0.9m"]
voxel = "5cm"

[cool]
steps = 40

[joint]
spacing = "30cm"

[weather]
cut = "horizontal"

[garden]
from = ["weather"]
size = ["5m", "4m"]
cell = "8cm"
stones = "-1.2,0.8,0.2,30"
pond = "0.8,-0.4,2.4,1.6"
islet = "0.9,-0.4,0.3"
relief_wavelength = "2m"

[forest]
from = "garden"
size = ["24m", "16m"]
corner = ["-12m", "4m", 0]
initial = "20"
steps = 12

[trees]
stage = "tree"
from = "forest"
species = "beech"
origin = "-2m,1.2m"
generations = 14
obstacle_albedo = 0.9

[light]
weather = "days.csv"
surface = "surface_sdf"

[wind]
garden_spacing = "2m"
object_spacing = "50cm"
settle = 0
duration = 0.5

[soil]

[moss]
surface = "cells"
write = "garden.vdb"

[bare_light]
stage = "light"
from = "garden"
weather = "days.csv"
surface = "surface_sdf"

[bare_wind]
stage = "wind"
garden_size = ["SIZE_X", "SIZE_Y", "SIZE_Z"]
garden_spacing = "2m"
object_spacing = "50cm"
settle = 0
duration = 0.5

[coupling]
stage = "compare"
from = ["wind", "bare_wind"]
coupling = true
write = "coupling.csv"

[picture]
stage = "render"
from = "moss"
width = 64
height = 48
samples = 2
bounces = 1
eye = ["0m", "-6m", "2m"]
target = ["0m", "0m", "0m"]
write = "garden.png"
""".replace('garden_size = ["SIZE_X", "SIZE_Y", "SIZE_Z"]\n', "")


class Garden(CliTest):
    def setUp(self):
        super().setUp()
        self.write("days.csv", spring_weather(12))
        self.recipe(RECIPE, "garden.toml")

    def states(self, *more):
        done = self.succeed("run", "garden.toml", "--json", *more)
        return {s["name"]: s["state"] for s in done.json()["stages"]}, done

    def test_everything_feels_everything_else(self):
        """Leaves shade and slow, water moistens; nothing runs twice; another moss runs moss and picture alone."""
        states, _ = self.states()
        self.assertEqual(set(states.values()), {"run"})
        with open(self.folder / "out" / "coupling.csv", encoding="utf-8", newline="") as file:
            lines = list(csv.DictReader(file))
        held = {line["measure"].split(",")[0].split("[")[0].strip(): line["holds"] for line in lines if line["expected"]}
        self.assertEqual(set(held.values()), {"holds"}, lines)
        for measure in ("light on ground and stones", "wind before the garden", "air that touched water before the garden"):
            self.assertIn(measure, held)
        shade = next(line for line in lines if line["measure"].startswith("light"))
        self.assertLess(float(shade["value"]), 0.95 * float(shade["first"]))

        before = files_in(self.folder / "out")
        states, done = self.states()
        self.assertEqual(set(states.values()), {"cached"})
        self.assertLess(done.seconds, 5)
        self.assertSameFiles(before, files_in(self.folder / "out"))

        states, _ = self.states("--set", "moss.species=grimmia")
        self.assertEqual({name for name, state in states.items() if state == "run"}, {"moss", "picture"})
        self.succeed("verify", "out/manifest.json")

    def test_by_hand_as_by_recipe(self):
        """The same rock placed by a command gives the grids that the recipe's stage gave."""
        self.recipe(RECIPE.split("[forest]")[0].replace('[weather]\n', '[weather]\nwrite = "rock.vdb"\n')
                    + 'write = "plot.vdb"\n', "plot.toml")
        self.succeed("run", "plot.toml")
        self.succeed("garden", "out/rock.vdb", "--size", "5m,4m", "--cell", "8cm", "--stones=-1.2,0.8,0.2,30", "--pond", "0.8,-0.4,2.4,1.6",
                     "--islet", "0.9,-0.4,0.3", "--relief-wavelength", "2m", "--seed", "5", "-o", "by-hand.vdb")
        self.succeed("diff", "out/plot.vdb", "by-hand.vdb")
        self.assertSameBytes(self.folder / "out" / "plot.ply", self.folder / "by-hand.ply")
        grids = {g["name"]: g for g in self.succeed("info", "by-hand.vdb", "--json").json()[0]["grids"]}
        self.assertNotIn("density", grids, "the rock's own volume stays where it was made")
        for name in ("surface_sdf", "geology", "soil_h", "water_surface", "ground_height", "blocked_height", "plantable"):
            self.assertIn(name, grids)

    def test_without_rocks(self):
        self.succeed("garden", "--size", "3m", "--cell", "10cm", "--lantern", "0,0,30", "-o", "lantern.vdb")

    def test_bad_input(self):
        self.succeed("garden", "--size", "3m", "--cell", "10cm", "-o", "plot.vdb")
        self.refuse(USAGE, ["stones", "scene 0, but none is given"], "garden", "--stones", "0,0", "-o", "x.vdb")
        self.refuse(USAGE, ["pond", "0 m", "must be > 0"], "garden", "--pond", "0,0,0,1", "-o", "x.vdb")
        self.refuse(USAGE, ["cell", "0.005 to 1"], "garden", "--cell", "0", "-o", "x.vdb")
        self.refuse(USAGE, ["soil", "humsu", "did you mean 'humus'"], "garden", "--soil", "humsu", "-o", "x.vdb")
        self.refuse(USAGE, ["no place for their rocks"], "garden", "plot.vdb", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["density"], "garden", "plot.vdb", "--stones", "0,0", "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["nothing.png"], "garden", "--height-map", "nothing.png", "--metres-per-pixel", "1m", "--height-low", "0m",
                    "--height-high", "1m", "-o", "x.vdb")
        self.refuse(LIMIT, ["memory"], "garden", "--size", "1000m", "--cell", "5mm", "--memory", "2G", "-o", "x.vdb")
        self.refuse(USAGE, ["takes all of the plot"], "garden", "--size", "2m", "--pond", "0,0,9,9", "-o", "x.vdb")
        self.write("bad.toml", RECIPE.replace('"-1.2,0.8,0.2,30"', '"-1.2"'))
        self.refuse(USAGE, ["bad.toml", "stones", "1 numbers"], "check", "bad.toml")


if __name__ == "__main__":
    unittest.main(verbosity=2)
