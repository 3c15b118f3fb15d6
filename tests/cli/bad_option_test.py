"""Options and numbers that cannot be: range, limits, physics."""

import unittest

from support import BAD_INPUT, COOL, DONE, LAVA, RECIPE, USAGE, SceneTest, lava_with


class Numbers(SceneTest):
    def test_boxes_that_cannot_be(self):
        for value in ("0,0,0", "1,1", "1,1,1,1", "-1,1,1", "a,b,c", "1;1;1", "nan,1,1"):
            with self.subTest(value=value):
                self.refuse(USAGE, ["size"], *lava_with("--size", value))
        # Smaller than one heat cell.
        done = self.run_in_folder(*lava_with("--size", "1cm,1cm,1cm"))
        self.assertIn(done.code, (USAGE, BAD_INPUT, DONE), done)

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
