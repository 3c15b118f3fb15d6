"""Every write, sync and rename that can fail: told, nothing half-written or left behind, and the next run is as if nothing had been.

A library of the test build is loaded before the program (fault_shim.cpp), which fails it at its n-th call. With the word
`all` on the command line commands of many files and the long recipe are failed at every call, too.
"""

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import unittest

from catalogue import COMMANDS, TELLING, make_inputs, words
from support import CANNOT_WRITE, DONE, FAULTS, PROGRAM, RECIPE, CliTest, environment, files_in, temporaries

ALL = "all" in sys.argv

# What each kind of call may fail with, in turn, and the words for it.
ERRORS = {"create": [(errno.EACCES, "permission denied"), (errno.ENOSPC, "no space"), (errno.EMFILE, "too many open files")],
          "write": [(errno.ENOSPC, "no space"), (errno.EIO, "input/output error"), (errno.EDQUOT, "quota"), (errno.EFBIG, "larger")],
          "overwrite": [(errno.ENOSPC, "no space"), (errno.EIO, "input/output error")],
          "reserve": [(errno.ENOSPC, "no space"), (errno.EDQUOT, "quota")],
          "truncate": [(errno.EIO, "input/output error")],
          "sync": [(errno.EIO, "input/output error"), (errno.ENOSPC, "no space"), (errno.EDQUOT, "quota")],
          "sync_folder": [(errno.EIO, "input/output error")],
          "rename": [(errno.EACCES, "permission denied"), (errno.EROFS, "read-only"), (errno.ENOSPC, "no space")]}

# Three stages and a mesh: some 100 calls in 50 ms.
SMALL = """\
sekitei = 1
out = "out"

[lava]
preset = "slab"
size = ["80cm", "80cm", "80cm"]
voxel = "8cm"
heat_cell = "16cm"
noise_amplitude = 0
write = "lava.vdb"

[cool]
steps = 4

[rock]
stage = "mesh"
from = "lava"
grid = "body_sdf"
write = ["rock.ply", "rock.obj"]
"""

# Lava to moss and picture, with a sequence, plants and numbers.
LONG = RECIPE + """
[moss]
from = "rock"
days = 6
site = "10cm"
photons = "2k"
open_light = 25
initial_count = 20
soil = "humus"
write = "moss.vdb"

[numbers]
stage = "statistics"
write = "moss.csv"
"""


def faults(how=None, at=None, kinds=None, log=None):
    """The environment in which the program fails so."""
    env = {"LD_PRELOAD": str(FAULTS), "ASAN_OPTIONS": os.environ.get("ASAN_OPTIONS", "") + ":verify_asan_link_order=0"}
    for name, value in (("HOW", how), ("AT", at), ("KINDS", kinds), ("LOG", log)):
        if value is not None:
            env[f"FAULT_{name}"] = str(value)
    return environment(**env)


def target_of(path):
    """The final name of a file that may have its temporary one."""
    return re.sub(r"^\.(.*)\.sekitei-[0-9.]+\.tmp$", r"\1", os.path.basename(path))


class FailureTest(CliTest):
    def setUp(self):
        super().setUp()
        # A program that the library does not reach would pass everything.
        self.assertTrue(FAULTS.exists(), f"{FAULTS} is missing: SEKITEI_FAULTS names the library that the test build makes")

    def run_failing(self, arguments, **fault):
        return self.run_in_folder(*arguments, env=faults(**fault))

    def calls(self, arguments):
        """(kind, path) of each call that the program makes; it must succeed."""
        log = self.folder.parent / f"{self.folder.name}.log"
        done = self.run_failing(arguments, log=log)
        self.assertEqual(done.code, DONE, done)
        found = [tuple(line.split(" ", 1)) for line in log.read_text().splitlines()]
        log.unlink()
        return found

    def check_told(self, done, kind, path, words, what):
        self.assertEqual(done.code, CANNOT_WRITE, what)
        self.assertRegex(done.err, "(?m)^error: cannot ", what)
        self.assertIn(words, done.err.lower(), what)
        name = target_of(path)
        if kind != "sync_folder":
            self.assertIn(os.path.basename(os.path.dirname(path)) if name == "lock" else name, done.err, what)
        self.assertNotIn("bug in Sekitei", done.err, what)
        self.assertEqual(temporaries(self.folder), [], what)


class Commands(FailureTest):
    def fail_at_every_call(self, command, limit=None):
        """Fails a command whose outputs are there already, call by call, each time from the same start."""
        arguments = words(command)
        before = files_in(self.folder)
        self.calls(arguments)
        new = files_in(self.folder)
        # What a command goes on from is its own business, as long as it comes to the same end.
        inner = {n for n in new if new[n] != before.get(n) and n.startswith("rows/")}
        made = sorted(n for n in new if new[n] != before.get(n) and n not in inner)

        def back_to_old():
            for name, content in files_in(self.folder).items():
                if name not in new or name in made or name in inner:
                    (self.folder / name).unlink()
            for name in made:
                self.write(name, before.get(name, b"old"))

        back_to_old()
        old = files_in(self.folder)
        calls = self.calls(arguments)  # that of a fresh start with old files there
        self.assertSameFiles(files_in(self.folder), new)
        chosen = range(1, len(calls) + 1)
        if limit and len(chosen) > limit:
            chosen = sorted({1 + i * (len(calls) - 1) // (limit - 1) for i in range(limit)})
        for n in chosen:
            kind, path = calls[n - 1]
            number, words_of_it = ERRORS[kind][n % len(ERRORS[kind])]
            back_to_old()
            done = self.run_failing(arguments, how=number, at=n)
            what = f"sekitei {' '.join(arguments)}: {errno.errorcode[number]} at call {n}, {kind} {path}\n{done}"
            self.check_told(done, kind, path, words_of_it, what)
            standing = files_in(self.folder)
            self.assertLessEqual(set(made), set(standing), f"an old file is gone: {what}")
            for name, content in standing.items():
                if name in made:
                    self.assertIn(content, (old[name], new[name]), f"{name} is neither old nor new: {what}")
                    if name.endswith(target_of(path)) and kind != "sync_folder":
                        self.assertEqual(content, old[name], f"{name} is not the old one: {what}")
                elif not inner or not name.startswith("rows/"):
                    self.assertEqual(content, old.get(name), f"{name}: {what}")
            if n == chosen[len(chosen) // 2] or files_in(self.folder) != old:
                done = self.run_in_folder(*arguments)
                self.assertEqual(done.code, DONE, f"after {what}\n{done}")
                self.assertSameFiles(files_in(self.folder), new, f"after {what}")
        back_to_old()
        self.succeed(*arguments)
        self.assertSameFiles(files_in(self.folder), new)
        return {kind for kind, _ in calls}

    def test_every_command_at_every_call(self):
        make_inputs(self.folder)
        # The suite takes a few calls of one command of each way to write, `all` every call of every command.
        few = {"lava --preset slab": None, "mesh weathered.vdb -o beside": None, "mesh weathered.vdb -o rock": 10, "render rock": None,
               "moss soil.vdb --every": 12, "light slab": 12, "statistics": None, "tree --generations 10": 10, "forest --size": 10,
               "specimens": 8, "tufts": 6}
        for command in COMMANDS:
            line = " ".join(command)
            with self.subTest(command=line):
                chosen = [limit for start, limit in few.items() if line.startswith(start)]
                if command[0] in TELLING or command[0] == "run" or not (chosen or ALL):
                    self.succeed(*words(command))
                    continue
                kinds = self.fail_at_every_call(command, None if ALL else chosen[0])
                self.assertLessEqual({"create", "write", "sync", "rename", "sync_folder"}, kinds)

    def test_odd_file_systems_change_nothing(self):
        """Half writes, calls that a signal interrupts, file systems that can neither reserve nor sync a folder."""
        make_inputs(self.folder)
        lava = words(COMMANDS[0])
        self.succeed(*lava)
        good = files_in(self.folder)
        for fault in ({"how": "short", "kinds": "write"}, {"how": "short", "kinds": "overwrite"},
                      {"how": "interrupt", "kinds": "write,overwrite,sync,sync_folder,create"},
                      {"how": errno.EOPNOTSUPP, "kinds": "reserve"}, {"how": errno.EINVAL, "kinds": "sync_folder"}):
            (self.folder / "lava.vdb").unlink()
            done = self.run_failing(lava, at=0, **fault)
            self.assertEqual(done.code, DONE, f"{fault} {done}")
            self.assertSameFiles(files_in(self.folder), good, str(fault))


class Recipes(FailureTest):
    def go(self, recipe):
        self.recipe(recipe)
        self.arguments = ["run", "rock.toml", "-q"]
        self.succeed(*self.arguments, "--set", "out=good")
        self.good = files_in(self.folder / "good")
        calls = self.calls(self.arguments)
        self.assertSameFiles(files_in(self.folder / "out"), self.good)
        return calls

    def inject(self, calls, n, how, kinds=None):
        shutil.rmtree(self.folder / "out")
        done = self.run_failing(self.arguments, how=how, at=n, kinds=kinds)
        kind, path = calls[n - 1]
        what = f"{how} at call {n}, {kind} {path}\n{done}"
        for name, content in files_in(self.folder / "out").items():
            if not name.endswith(".tmp"):
                self.assertSameBytes(content, self.good[name], f"{name} is neither absent nor whole: {what}")
        return done, what

    def check_next_run(self, what):
        if self.folder.joinpath("out/manifest.json").exists():
            self.succeed("verify", "out/manifest.json")
        done = self.run_in_folder(*self.arguments)
        self.assertEqual(done.code, DONE, f"after {what}\n{done}")
        self.assertSameFiles(files_in(self.folder / "out"), self.good, f"after {what}")
        self.assertEqual(temporaries(self.folder), [], what)

    def fail_everywhere(self, recipe):
        calls = self.go(recipe)
        for n, (kind, path) in enumerate(calls, 1):
            number, words_of_it = ERRORS[kind][n % len(ERRORS[kind])]
            done, what = self.inject(calls, n, number)
            self.check_told(done, kind, path, words_of_it, what)
            self.check_next_run(what)

    def kill_everywhere(self, recipe, step=1):
        kinds = "write,overwrite,sync,rename,sync_folder"
        calls = [c for c in self.go(recipe) if c[0] in kinds.split(",")]
        for n in range(1, len(calls) + 1, step):
            done, what = self.inject(calls, n, "kill", kinds)
            self.assertEqual(done.code, -signal.SIGKILL, what)
            self.check_next_run(what)

    def test_a_run_failed_at_every_call(self):
        self.fail_everywhere(SMALL)

    def test_a_run_killed_at_every_third_call(self):
        self.kill_everywhere(SMALL, 1 if ALL else 3)

    @unittest.skipUnless(ALL, "takes minutes: ./run validate")
    def test_a_run_from_lava_to_moss_failed_and_killed_at_every_call(self):
        self.fail_everywhere(LONG)
        self.kill_everywhere(LONG)

    @unittest.skipUnless(shutil.which("strace"), "needs strace")
    def test_the_library_sees_every_call(self):
        """strace, which sees all that the kernel is asked for, counts the same."""
        calls = self.go(SMALL)
        shutil.rmtree(self.folder / "out")
        log = self.folder / "calls.log"
        # Every call by which a file can be changed; on descriptors those that are files (-y names them).
        names = ("write,pwrite64,writev,pwritev,pwritev2,sendfile,copy_file_range,splice,fallocate,ftruncate,truncate,fsync,fdatasync,"
                 "sync_file_range,msync,rename,renameat,renameat2,link,linkat")
        done = subprocess.run(["strace", "-f", "-qq", "-y", "-o", str(log), "-e", f"trace={names}", str(PROGRAM), *self.arguments],
                              cwd=self.folder, env=environment(), capture_output=True)
        if done.returncode != DONE:
            self.skipTest("strace is not allowed here")
        seen = [m[1] for m in re.finditer(r"(?m)^\d+ +(\w+)\((?!\d+<(?:pipe|socket|anon|/dev/|/tmp/sekitei-out))", log.read_text())]
        named = {"write": "write", "overwrite": "pwrite64", "reserve": "fallocate", "truncate": "ftruncate", "sync": "fsync",
                 "sync_folder": "fsync", "rename": "rename"}
        expected = sorted(named[kind] for kind, _ in calls if kind != "create")
        self.assertEqual(sorted(seen), expected)


if __name__ == "__main__":
    unittest.main(argv=[a for a in sys.argv if a != "all"])
