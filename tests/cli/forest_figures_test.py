"""Every recipe of a figure of forests: all its criteria hold, its pictures are there, and a second run does nothing."""

import re
import unittest

from support import DATA, CliTest


class Figures(CliTest):
    def test_every_figure(self):
        recipes = sorted((DATA / "recipes").glob("forest-fig*.toml"))
        self.assertEqual(len(recipes), 8)
        for recipe in recipes:
            with self.subTest(recipe=recipe.name):
                done = self.succeed("run", recipe, "--set", f"out={recipe.stem}", timeout=600)
                self.assertNotIn("MISSED", done.err)
                found = re.search("expectations ([0-9]+), held ([0-9]+)", done.err)
                self.assertGreaterEqual(int(found[1]), 2)
                self.assertEqual(found[1], found[2])
                again = self.succeed("run", recipe, "--set", f"out={recipe.stem}", timeout=600)
                self.assertLess(again.seconds, done.seconds / 2)


if __name__ == "__main__":
    unittest.main()
