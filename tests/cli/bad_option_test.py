"""Options and numbers that cannot be: range, limits, physics."""

import unittest

import foreign
from support import (BAD_INPUT, COOL, DONE, JOINT, LAVA, LIMIT, RECIPE, STAGES, USAGE, WEATHER, SceneTest, run)


class Numbers(SceneTest):
    def lava_with(self, option, value):
        arguments = list(LAVA)
        if option in arguments:
            arguments[arguments.index(option) + 1] = value
        else:
            arguments += [option, value]
        return ["lava", *arguments, "-o", "x.vdb"]

    def test_13_voxel_sizes_that_cannot_be(self):
        for value in ("0", "-1", "-4cm", "nan", "inf", "1e999", "", "four", "4K", "4cm4", "0x10"):
            with self.subTest(value=value):
                self.refuse(USAGE, ["--voxel"], *self.lava_with("--voxel", value))
        self.refuse(USAGE, ["voxel", "> 0"], *self.lava_with("--voxel", "0"))
        self.succeed(*self.lava_with("--voxel", "5cm"))

    def test_14_far_too_many_voxels(self):
        for value in ("1e-9", "1e-30", "1e-300"):
            done = self.refuse(LIMIT, ["voxel"], *self.lava_with("--voxel", value))
        self.refuse(LIMIT, ["voxel"], *self.lava_with("--size", "1e9,1e9,1e9"))
        done = self.run_in_folder(*self.lava_with("--heat-cell", "1e-7"), timeout=20)
        self.assertIn(done.code, (LIMIT, USAGE), done)

    def test_14_the_memory_limit_names_what_is_needed(self):
        for command, source in (("cool", self.lava), ("joint", self.cooled), ("weather", self.joints)):
            self.refuse(LIMIT, ["--memory", "20 kB"], command, source, "--memory", "20kB", "-o", "x.vdb")
        self.refuse(LIMIT, ["--memory"], *self.lava_with("--memory", "10kB"))
        self.succeed("cool", self.lava, "--memory", "1G", "-o", "x.vdb")
        for value in ("0", "-1", "lots", "1XB", ""):
            self.refuse(USAGE, ["--memory"], "cool", self.lava, "--memory", value, "-o", "y.vdb")

    def test_boxes_that_cannot_be(self):
        for value in ("0,0,0", "1,1", "1,1,1,1", "-1,1,1", "a,b,c", "1;1;1", "nan,1,1"):
            with self.subTest(value=value):
                self.refuse(USAGE, ["size"], *self.lava_with("--size", value))
        # Smaller than one heat cell.
        done = self.run_in_folder(*self.lava_with("--size", "1cm,1cm,1cm"))
        self.assertIn(done.code, (USAGE, BAD_INPUT, DONE), done)

    def test_11_temperatures_beyond_all_numbers(self):
        for option, value in (("--lava-temperature", "1e39"), ("--lava-temperature", "1e308"), ("--cold-temperature", "1e39"),
                              ("--lava-temperature", "-1"), ("--lava-temperature", "-300C")):
            with self.subTest(option=option, value=value):
                self.refuse(USAGE, [option.strip("-").replace("-", "_").split("_")[0], "K"], "cool", self.lava, option, value, "-o", "x.vdb")
        self.succeed("cool", self.lava, "--lava-temperature", "1200C", "--steps", 10, "-o", "x.vdb")

    def test_31_columns_that_do_not_fit(self):
        self.refuse(USAGE, ["spacing", "> 0"], "joint", self.cooled, "--spacing", "-10cm", "-o", "x.vdb")
        self.refuse(USAGE, ["seed_radius", "> 0"], "joint", self.cooled, "--seed-radius", "0", "-o", "x.vdb")
        self.refuse(USAGE, ["radius"], "joint", self.cooled, "--count", 400, "--seed-radius", "1m", "-o", "x.vdb")
        self.refuse(USAGE, ["count", "1 to"], "joint", self.cooled, "--count", "0", "-o", "x.vdb")
        done = self.run_in_folder("joint", self.cooled, "--spacing", "100m", "-o", "x.vdb")
        self.assertIn(done.code, (USAGE, DONE), done)
        if done.code == USAGE:
            self.assertIn("100", done.err)
        self.succeed("joint", self.cooled, "--count", 9, "-o", "y.vdb")

    def test_31_a_spacing_below_the_voxels_is_named(self):
        for spacing in ("1um", "1mm", "5cm"):
            self.refuse(USAGE, ["spacing", "voxels wide"], "joint", self.cooled, "--spacing", spacing, "-o", "x.vdb")

    def test_32_lava_that_is_as_hot_as_its_surroundings(self):
        self.refuse(BAD_INPUT, ["cooling surface"], "cool", self.lava, "--lava-temperature", "500", "--cold-temperature", "500",
                    "--slow-temperature", "500", "-o", "x.vdb")
        # No step taken: the lava is isothermal, but its contact with the cold is not.
        self.succeed("cool", self.lava, "--steps", "1", "-o", "x.vdb")

    def test_34_unstable_steps(self):
        self.refuse(USAGE, ["alpha", "1/6"], "cool", self.lava, "--alpha", "0.2", "-o", "x.vdb")
        self.refuse(USAGE, ["alpha", "> 0"], "cool", self.lava, "--alpha", "0", "-o", "x.vdb")
        self.succeed("cool", self.lava, "--alpha", "0.1666", "-o", "x.vdb")
        self.succeed("cool", self.lava, "--alpha", "0.17", "--allow-unstable", "--steps", "3", "-o", "y.vdb")
        done = self.run_in_folder("cool", self.lava, "--alpha", "100", "--allow-unstable", "--steps", "10000", "-o", "z.vdb", timeout=20)
        self.assertEqual(done.code, BAD_INPUT, done)
        self.assertIn("alpha", done.err)
        self.assertFalse((self.folder / "z.vdb").exists())

    def test_pictures(self):
        for option, value in (("--width", "0"), ("--width", "100000"), ("--height", "-3"), ("--samples", "0"), ("--samples", "1e15"),
                              ("--samples", "2.5"), ("--sun-elevation", "91"), ("--field-of-view", "0"), ("--turbidity", "0"),
                              ("--zoom", "-1"), ("--axis", "w"), ("--eye", "1,2")):
            with self.subTest(option=option, value=value):
                self.refuse(USAGE, [option.strip("-").replace("-", "_")], "render", self.mesh, option, value, "-o", "x.png")
        self.refuse(USAGE, ["x.jpg", ".png"], "render", self.mesh, "-o", "x.jpg")
        self.refuse(BAD_INPUT, ["moss"], "render", self.mesh, "--field", "moss", "-o", "x.png")
        for at in ("99m", "-99m"):
            self.refuse(USAGE, ["at"], "render", self.cooled, "--slice", "temperature", "--at", at, "-o", "x.png")
        # Night is no mistake.
        self.succeed("render", self.mesh, "--width", 32, "--height", 32, "--samples", 1, "--sun-elevation", "-20", "-o", "x.png")

    def test_a_surface_that_is_nowhere(self):
        self.refuse(BAD_INPUT, ["iso = 7", "density"], "mesh", self.weathered, "--iso", "7", "-o", "x.ply")
        self.refuse(BAD_INPUT, ["density"], "mesh", self.weathered, "--iso", "-1", "-o", "x.ply")
        self.refuse(USAGE, ["iso"], "mesh", self.weathered, "--iso", "nan", "-o", "x.ply")


class Words(SceneTest):
    def test_no_output_and_no_input(self):
        self.refuse(USAGE, ["-o FILE"], "lava", *LAVA)
        self.refuse(USAGE, ["cool", ".vdb"], "cool", "-o", "x.vdb")
        self.refuse(USAGE, ["extra.vdb"], "lava", "extra.vdb", "-o", "x.vdb")
        self.refuse(USAGE, ["more.vdb"], "cool", self.lava, "more.vdb", "-o", "x.vdb")
        self.refuse(USAGE, ["x.ply", ".vdb"], "cool", self.lava, "-o", "x.ply")
        self.refuse(USAGE, ["x.txt", ".ply"], "mesh", self.weathered, "-o", "x.txt")
        self.refuse(USAGE, ["--output"], "cool", self.lava, "-o")

    def test_general_options(self):
        for option, value in (("--seed", "-1"), ("--seed", "x"), ("--seed", ""), ("--threads", ""), ("--seed", "1.5"), ("--seed", "99999999999999999999"), ("--threads", "0"),
                              ("--threads", "-2"), ("--threads", "two"), ("--threads", "99999999999")):
            with self.subTest(option=option, value=value):
                self.refuse(USAGE, [option], "cool", self.lava, option, value, "-o", "x.vdb")
        self.succeed("cool", self.lava, *COOL, "--threads", "10000", "--seed", "9223372036854775807", "-o", "x.vdb")
        self.assertSameBytes(self.cooled, self.succeed("cool", self.lava, *COOL, "--seed", 7, "-o", "y.vdb") and self.folder / "y.vdb")

    def test_very_long_and_strange_words(self):
        long = "x" * 60_000
        recipe = self.recipe(RECIPE.replace("steps = 40", "steps = 9999999"))
        (self.folder / "circle").symlink_to("circle")
        for arguments in (["cool", long, "-o", "x.vdb"], ["cool", self.lava, "-o", long + ".vdb"], ["cool", self.lava, "-o", "x.vdb", "--steps", long],
                          [long], ["--" + long], ["lava", "--preset", long, "-o", "x.vdb"], ["cool", "\udcff\udcfe", "-o", "x.vdb"],
                          ["lava", "--preset", "\udcff", "-o", "x.vdb"], ["lava", "--preset", "mesh", "--mesh", long, "-o", "x.vdb"],
                          ["weather", self.joints, "--terrain-map", long, "-o", "x.vdb"], ["info", long], ["verify", long + ".vdb"],
                          ["run", long], ["diff", long, long], ["joint", self.cooled, "--seeds", long + "/" + long, "-o", "x.vdb"],
                          ["lava", "--params", long, "-o", "x.vdb"], ["completions", long], ["schema", long], ["replay", long],
                          ["run", recipe, "--set", f"out={long}"], ["run", recipe, "--set", f"rock.write={long}.ply"],
                          ["run", recipe, "--set", f"joint.seeds={long}"], ["run", recipe, "--set", long], ["run", recipe, "--only", long],
                          ["run", recipe, "--set", "out=\udcff\x01"], ["check", recipe, "--set", "rock.write=\udcff.ply"],
                          ["run", recipe, "--set", "rock.write=/dev/null/x.ply"], ["run", recipe, "--set", "out=circle"], ["cool", self.lava, "--steps", "\x01\x1b[31m", "-o", "x.vdb"]):
            done = self.run_in_folder(*arguments, timeout=20)
            self.assertIn(done.code, (USAGE, BAD_INPUT, 4), f"{str(arguments)[:200]} {str(done)[:2000]}")
            self.assertNotIn("bug in Sekitei", done.err)

    def test_schema_and_info_of_nothing(self):
        self.refuse(USAGE, ["molten", "lava"], "schema", "molten")
        self.refuse(USAGE, ["info"], "info")
        self.refuse(USAGE, [], "diff", self.lava)


if __name__ == "__main__":
    unittest.main()
