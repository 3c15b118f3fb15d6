"""Runs that are stopped at any moment, from lava to moss and picture: nothing half-written, and the next run ends as if nothing had been.

The suite stops a run 15 times; a number on the command line says how often instead.
"""

import random
import shutil
import signal
import sys
import time
import unittest

from support import DIFFER, DONE, RECIPE, CliTest, files_in, start, stop, temporaries

STOPS = next((int(a) for a in sys.argv[1:] if a.isdigit()), 15)

# Every kind of stage and output: scenes, a scene with its mesh, checkpoints, points, tables, pictures.
MOSSY = RECIPE.replace("steps = 40", "steps = 4000").replace('"4cm"', '"8cm"').replace('"rock.vdb"', '["rock.vdb", "copy.vdb"]') + """
[moss]
from = "rock"
days = 30
site = "10cm"
photons = "3k"
open_light = 25
initial_count = 20
soil = "humus"
write = "moss.vdb"

[plants]
stage = "export"
write = "plants.ply"

[numbers]
stage = "statistics"
from = "moss"
write = "moss.csv"

[view]
stage = "render"
from = "moss"
width = 64
height = 48
samples = 16
bounces = 1
write = "moss.png"
"""

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGKILL, signal.SIGINT)


class Stopped(CliTest):
    def setUp(self):
        super().setUp()
        self.recipe(MOSSY)
        self.run_words = ["run", "rock.toml", "-q"]

    def whole(self, name, *changes):
        """The files of an uninterrupted run, and its seconds."""
        began = time.monotonic()
        self.succeed(*self.run_words, "--set", f"out={name}", *changes)
        return files_in(self.folder / name), time.monotonic() - began

    def check_what_stands(self, wanted, what):
        """Whatever has its final name is whole, by its bytes and by `verify`."""
        out = self.folder / "out"
        standing = files_in(out) if out.exists() else {}
        for name, content in standing.items():
            if name in wanted[0]:
                self.assertIn(content, [files[name] for files in wanted], f"{name} is not whole: {what}")
            else:
                self.assertRegex(name, r"^\..*\.tmp$", f"an unknown name: {what}")
        scenes = [f"out/{n}" for n in standing if n.endswith(".vdb") and not n.startswith(".")]
        if scenes:
            self.succeed("verify", *scenes)
        if "manifest.json" in standing:
            # An old manifest may speak of files that are new already: it is the last to change.
            done = self.run_in_folder("verify", "out/manifest.json")
            self.assertIn(done.code, (DONE,) if len(wanted) == 1 else (DONE, DIFFER), f"{what}\n{done}")

    def stop_at(self, moment, which, what, *changes):
        """Stops a run after so many seconds; whether it was still at work."""
        process = start([*self.run_words, *changes], cwd=self.folder)
        time.sleep(moment)
        code, _, err = stop(process, which)
        self.assertIn(code, (DONE, 128 + which), f"{what}: exit {code}, {err}")
        if which != signal.SIGKILL and self.folder.joinpath("out").exists():
            self.assertEqual(temporaries(self.folder / "out"), [], what)
        return code != DONE

    def check_end(self, good, what, *changes):
        self.succeed(*self.run_words, *changes)
        self.assertSameFiles(files_in(self.folder / "out"), good, what)
        self.assertEqual(temporaries(self.folder / "out"), [], what)
        self.succeed("verify", "out/manifest.json")

    def test_a_run_stopped_at_random_goes_on_to_the_same_end(self):
        good, seconds = self.whole("good")
        self.assertEqual(len(good), 11)
        draw, stopped = random.Random(2026), 0
        for i in range(STOPS):
            which = SIGNALS[i % 4]
            shutil.rmtree(self.folder / "out", ignore_errors=True)
            what = f"stop {i}, signal {which}"
            # One in four is stopped again and again.
            for _ in range(1 if i % 4 else 3):
                if self.stop_at(draw.uniform(0, seconds), which, what):
                    stopped += 1
                else:  # the first run was slowed by others
                    seconds *= 0.8
                self.check_what_stands([good], what)
            self.check_end(good, what)
        self.assertGreater(stopped, STOPS // 4)

    def test_a_change_stopped_at_random_leaves_old_files_or_new_ones(self):
        change = ["--set", "joint.spacing=30cm"]
        new, seconds = self.whole("new", *change)
        old, _ = self.whole("out")
        draw = random.Random(11)
        for i in range(max(2, STOPS // 10)):
            self.stop_at(draw.uniform(0, seconds), SIGNALS[i % 4], f"change {i}", *change)
            self.check_what_stands([old, new], f"change {i}")
            self.check_end(new, f"change {i}", *change)
            self.check_end(old, f"change {i}, back")


if __name__ == "__main__":
    unittest.main(argv=[a for a in sys.argv if not a.isdigit()])
