"""Signals and checkpoints: work ends within a second and goes on where it was; another run's checkpoint is refused."""

import signal
import time
import unittest

from support import BAD_INPUT, DONE, INTERRUPTED, TERMINATED, CliTest, files_in, run, start, stop, wait_for

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


class Signals(CliTest):
    def started(self, *arguments):
        """A command at work on something that takes long."""
        run("lava", "--preset", "slab", "--size", "2.4m,2.4m,2.4m", "--voxel", "4cm", "--heat-cell", "4cm", "-o", self.folder / "lava.vdb", "-q")
        process = start(["cool", "lava.vdb", "--steps", "9999999", "-o", "cooled.vdb", *arguments], cwd=self.folder)
        time.sleep(0.5)
        self.assertIsNone(process.poll(), "it should still be at work")
        return process

    def test_signals_end_a_command_within_a_second(self):
        for which, expected in ((signal.SIGINT, INTERRUPTED), (signal.SIGTERM, TERMINATED)):
            process = self.started()
            code, seconds, err = stop(process, which)
            self.assertEqual(code, expected, err)
            self.assertLess(seconds, 1, "it should stop within a second")
            self.assertIn("interrupted", err)
            self.assertEqual(sorted(p.name for p in self.folder.iterdir()), ["lava.vdb"])
            (self.folder / "lava.vdb").unlink()

    def test_the_old_file_survives(self):
        self.write("cooled.vdb", "the old file")
        process = self.started("--force")
        code, _, _ = stop(process, signal.SIGINT)
        self.assertEqual(code, INTERRUPTED)
        self.assertEqual((self.folder / "cooled.vdb").read_text(), "the old file")

    def test_a_second_signal_ends_at_once(self):
        process = self.started()
        process.send_signal(signal.SIGINT)
        code, _, _ = stop(process, signal.SIGINT)
        self.assertEqual(code, INTERRUPTED)


class Checkpoints(CliTest):
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

    def test_a_damaged_checkpoint_is_refused_by_name(self):
        checkpoint = self.interrupted()
        good = checkpoint.read_bytes()
        flipped = bytearray(good)
        flipped[len(good) // 2] ^= 8
        for bad in (bytes(flipped), good[:-1], good[:100], b"", b"other words\n" * 50):
            checkpoint.write_bytes(bad)
            done = self.refuse(BAD_INPUT, [checkpoint.name], "run", "cooling.toml", "-q")
            self.assertIn("remove", done.err, "it says how to go on")
        checkpoint.write_bytes(good)
        self.succeed("run", "cooling.toml", "-q")
        self.succeed("run", "cooling.toml", "-q", "--set", "out=good")
        self.assertSameFiles(files_in(self.folder / "out"), files_in(self.folder / "good"))

    def test_a_checkpoint_of_another_run_is_refused_and_says_why(self):
        checkpoint = self.interrupted()
        foreign = checkpoint.read_bytes()
        process = start(["run", "cooling.toml", "-q", "--set", "cool.alpha=0.05"], cwd=self.folder)
        time.sleep(0.5)
        stop(process, signal.SIGINT)
        others = [p for p in checkpoint.parent.glob("cool-*.checkpoint") if p != checkpoint]
        self.assertEqual(len(others), 1, "another run has a checkpoint of its own")
        others[0].write_bytes(foreign)
        self.refuse(BAD_INPUT, [others[0].name, "alpha"], "run", "cooling.toml", "-q", "--set", "cool.alpha=0.05")


if __name__ == "__main__":
    unittest.main()
