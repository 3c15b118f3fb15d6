"""Stopped work goes on where it was; signals and damaged checkpoints are in battery_test, rows 42 and 43."""

import signal
import time
import unittest

from support import DONE, INTERRUPTED, CliTest, files_in, start, stop, wait_for

COOLING = """\
sekitei = 1
out = "out"

[lava]
preset = "slab"
size = ["1.6m", "1.6m", "1.6m"]
voxel = "4cm"
heat_cell = "4cm"
noise_amplitude = 0

# So slow that the last step still moves every temperature: one step too many or too few shows.
[cool]
steps = 120000
alpha = 0.0002
write = "cooled.vdb"
"""


class CheckpointTest(CliTest):
    def interrupted(self, which=signal.SIGINT):
        """The checkpoint of a cool stage that was stopped on its way."""
        self.recipe(COOLING, "cooling.toml")
        process = start(["run", "cooling.toml", "-q"], cwd=self.folder)
        kept = self.folder / "out/.sekitei"
        self.assertTrue(wait_for(lambda: list(kept.glob("lava-*.json"))), "lava is done")
        time.sleep(0.4)
        self.assertIsNone(process.poll(), "cool should still be at work")
        code, _, err = stop(process, which)
        self.assertEqual(code, 128 + which, err)
        found = list(kept.glob("cool-*.checkpoint"))
        self.assertEqual(len(found), 1, "one checkpoint is left")
        return found[0]


class Checkpoints(CheckpointTest):
    def test_an_interrupted_stage_goes_on_where_it_was(self):
        self.recipe(COOLING, "cooling.toml")
        began = time.monotonic()
        self.succeed("run", "cooling.toml", "-q", "--set", "out=good")
        whole = time.monotonic() - began
        checkpoint = self.interrupted()
        # Where it went on is seen from the time it takes: stopping again and again must come to an end.
        for _ in range(20):
            process = start(["run", "cooling.toml", "-q"], cwd=self.folder)
            time.sleep(0.3 * whole)
            code, _, err = stop(process, signal.SIGINT)
            if code == DONE:
                break
            self.assertEqual(code, INTERRUPTED, err)
        self.assertEqual(code, DONE, "twenty runs of a third of the time each did not end it")
        self.assertFalse(checkpoint.exists(), "a finished stage needs none")
        self.assertSameFiles(files_in(self.folder / "out"), files_in(self.folder / "good"))


if __name__ == "__main__":
    unittest.main()
