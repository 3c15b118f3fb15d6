"""Runs that are stopped at any moment: nothing half-written, and the next run ends as if nothing had been."""

import os
import random
import shutil
import signal
import subprocess
import time
import unittest
from pathlib import Path

from support import (BAD_INPUT, CANNOT_WRITE, DONE, PROGRAM, environment, INTERRUPTED, LAVA, RECIPE, TERMINATED, CliTest, files_in, run, start, stop, temporaries, wait_for)

# Long enough that most random moments fall into work: about a second on one core.
LONG = (RECIPE.replace("steps = 40", "steps = 40000").replace('write = "rock.vdb"', 'write = ["rock.vdb", "copy.vdb"]')
        .replace("samples = 2", "samples = 64"))
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


class RandomMoments(CliTest):
    KILLS = 12

    def check_no_half_file(self, out):
        """Everything under its final name is whole."""
        for path in out.glob("*.vdb") if out.exists() else []:
            self.assertEqual(run("verify", path).code, DONE, path)
        for name, content in files_in(out).items() if out.exists() else []:
            if name in self.good:
                self.assertSameBytes(content, self.good[name], f"{name} is neither absent nor whole")
            else:
                self.assertRegex(name, r"^\..*\.tmp$", "an unknown name")

    def test_a_killed_run_goes_on_to_the_same_end(self):
        self.recipe(LONG)
        began = time.monotonic()
        self.succeed("run", "rock.toml", "-q", "--set", "out=good")
        whole = time.monotonic() - began
        self.good = files_in(self.folder / "good")
        self.assertIn("manifest.json", self.good)
        draw = random.Random(2026)
        codes = []
        for i in range(self.KILLS):
            which = (signal.SIGKILL, signal.SIGINT, signal.SIGKILL, signal.SIGTERM)[i % 4]
            shutil.rmtree(self.folder / "out", ignore_errors=True)
            process = start(["run", "rock.toml", "-q"], cwd=self.folder)
            time.sleep(draw.uniform(0, whole))
            code, seconds, err = stop(process, which)
            what = f"stop {i}: signal {which}, exit {code}, {err}"
            if which == signal.SIGKILL:
                self.assertIn(code, (DONE, 137), what)
            else:
                self.assertIn(code, (DONE, 128 + which), what)
                self.assertLess(seconds, 1.5, what)
                self.assertEqual(temporaries(self.folder / "out"), [], what)
            codes.append(code)
            self.check_no_half_file(self.folder / "out")
            self.succeed("run", "rock.toml", "-q")
            self.assertSameFiles(files_in(self.folder / "out"), self.good, what)
            self.assertEqual(temporaries(self.folder / "out"), [], what)
        # Where the first run was slowed by others, later ones end before their moment comes.
        self.assertGreater(sum(c != DONE for c in codes), self.KILLS // 4, codes)

    def test_every_run_of_an_often_killed_one_comes_further(self):
        self.recipe(LONG)
        self.succeed("run", "rock.toml", "-q", "--set", "out=good")
        self.good = files_in(self.folder / "good")
        draw = random.Random(7)
        for _ in range(5):
            process = start(["run", "rock.toml", "-q"], cwd=self.folder)
            time.sleep(draw.uniform(0.05, 0.5))
            stop(process, signal.SIGKILL)
            self.check_no_half_file(self.folder / "out")
        self.succeed("run", "rock.toml", "-q")
        self.assertSameFiles(files_in(self.folder / "out"), self.good)

    def test_a_killed_change_leaves_the_old_files_or_the_new_ones(self):
        self.recipe(LONG)
        self.succeed("run", "rock.toml", "-q")
        old = files_in(self.folder / "out")
        self.succeed("run", "rock.toml", "-q", "--set", "out=good", "--set", "joint.spacing=30cm")
        new = files_in(self.folder / "good")
        draw = random.Random(11)
        for _ in range(4):
            process = start(["run", "rock.toml", "-q", "--set", "joint.spacing=30cm"], cwd=self.folder)
            time.sleep(draw.uniform(0, 0.6))
            stop(process, signal.SIGKILL)
            for name, content in files_in(self.folder / "out").items():
                if not name.endswith(".tmp"):
                    self.assertIn(content, (old[name], new[name]), name)
            self.succeed("run", "rock.toml", "-q", "--set", "joint.spacing=30cm")
            self.assertSameFiles(files_in(self.folder / "out"), new)
            self.succeed("run", "rock.toml", "-q")
            self.assertSameFiles(files_in(self.folder / "out"), old)


@unittest.skipUnless(shutil.which("strace"), "needs strace")
class EveryCall(CliTest):
    """strace stops or fails the program at a chosen write, sync or rename."""

    def inject(self, call, what, when):
        shutil.rmtree(self.folder / "out", ignore_errors=True)
        return subprocess.run(["strace", "-f", "-qq", "-o", "/dev/null", "-e", f"trace={call}", "-e", f"inject={call}:{what}:when={when}",
                               str(PROGRAM), "run", "rock.toml", "-q"], cwd=self.folder, env=environment(), capture_output=True, timeout=60)

    def setUp(self):
        super().setUp()
        self.recipe()
        self.succeed("run", "rock.toml", "-q", "--set", "out=good")
        self.good = files_in(self.folder / "good")
        if self.inject("getpid", "retval=1", 1).returncode != 0:
            self.skipTest("strace is not allowed here")
        self.assertSameFiles(files_in(self.folder / "out"), self.good)

    def check_and_go_on(self, what):
        for name, content in files_in(self.folder / "out").items():
            if not name.endswith(".tmp"):
                self.assertSameBytes(content, self.good[name], f"{what}: {name}")
        self.succeed("run", "rock.toml", "-q")
        self.assertSameFiles(files_in(self.folder / "out"), self.good, what)
        self.assertEqual(temporaries(self.folder / "out"), [], what)

    def moments(self, call, count):
        """Numbers of calls: `count` spread over all that a run makes and the last eight, where outputs get their names."""
        shutil.rmtree(self.folder / "out", ignore_errors=True)
        log = self.folder / "calls.log"
        subprocess.run(["strace", "-f", "-qq", "-o", str(log), "-e", f"trace={call}", str(PROGRAM), "run", "rock.toml", "-q"],
                       cwd=self.folder, env=environment(), check=True, timeout=60)
        threads = [line.split()[0] for line in log.read_text().splitlines()]
        last = threads.count(threads[0])
        return sorted({1 + i * (last - 1) // count for i in range(count)} | set(range(max(1, last - 7), last + 1)))

    def test_killed_at_any_write_sync_or_rename(self):
        for call in ("write", "fsync", "/rename.*"):
            stopped = 0
            for when in self.moments(call, 6):
                code = self.inject(call, "signal=KILL", when).returncode
                stopped += code != 0
                self.check_and_go_on(f"killed at {call} {when}")
            self.assertGreaterEqual(stopped, 4, call)

    def test_a_failure_of_any_write_sync_or_rename_is_told(self):
        for call, error in (("write", "ENOSPC"), ("fsync", "EIO"), ("/rename.*", "EACCES")):
            failed = 0
            for when in self.moments(call, 3):
                done = self.inject(call, f"error={error}", when)
                what = f"{error} at {call} {when}: {done}"
                self.assertIn(done.returncode, (DONE, CANNOT_WRITE), what)
                failed += done.returncode == CANNOT_WRITE
                self.assertEqual(temporaries(self.folder / "out"), [], what)
                self.check_and_go_on(what)
            self.assertGreaterEqual(failed, 2, call)


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
