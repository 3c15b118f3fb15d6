"""Forests that run for long: painted meanwhile, kept in a folder, killed, gone on with."""

import random
import shutil
import signal
import struct
import time
import unittest
import zlib

from support import BAD_INPUT, CANNOT_WRITE, DONE, INTERRUPTED, LIMIT, USAGE, CliTest, files_in, run, small_disk, start, stop, temporaries, wait_for

SMALL = ["--size", "192m", "--initial", "150", "--no-canopy"]


def grey(path, width, height, value):
    """A PNG of one grey, or of value(x, y) from the upper left, written as a paint program does: in place."""
    f = value if callable(value) else lambda x, y: value
    rows = b"".join(b"\0" + bytes(f(x, y) for x in range(width)) for y in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)) +
                     chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


class ForestRuns(CliTest):
    def trees(self, name, *options):
        """The instance file of a forest."""
        self.succeed("forest", *options, "-o", f"{name}.vdb", "--instances", f"{name}.ply", "--force", "-q")
        return (self.folder / f"{name}.ply").read_bytes()


class Painting(ForestRuns):
    def test_maps_painted_meanwhile_act_and_their_log_grows_the_same_forest(self):
        grey(self.folder / "low.png", 192, 192, 255)
        process = start(["forest", *SMALL, "--steps", "12", "--density", "low.png,1,1,1,1", "--watch-maps", "--edit-log", "log.toml",
                         "--step-seconds", "0.15", "-o", "painted.vdb", "--instances", "painted.ply", "-v"], cwd=self.folder)
        time.sleep(0.7)
        # A half-written file first, as a watcher may meet it.
        whole = self.folder / "new.png"
        grey(whole, 192, 192, lambda x, y: 0 if x < 96 else 255)
        (self.folder / "low.png").write_bytes(whole.read_bytes()[:60])
        time.sleep(0.3)
        (self.folder / "low.png").write_bytes(whole.read_bytes())
        out, err = process.communicate(timeout=120)
        self.assertEqual(process.returncode, DONE, err.decode())
        self.assertIn("painted anew", err.decode())
        log = (self.folder / "log.toml").read_text()
        self.assertEqual(log.count("[[edit]]"), 1, log)
        self.assertIn("map = 1", log)
        painted = (self.folder / "painted.ply").read_bytes()

        # The picture is the new one now, so that the log is begun with what was there before.
        again = self.trees("again", *SMALL, "--steps", "12", "--density", "1", "--edits", "log.toml")
        self.assertSameBytes(again, painted)
        self.assertNotEqual(self.trees("without", *SMALL, "--steps", "12"), painted)

    def test_watching_needs_a_log(self):
        self.refuse(USAGE, ["edit_log"], "forest", *SMALL, "--watch-maps", "-o", "a.vdb")


class OutOfCore(ForestRuns):
    WORDS = [*SMALL, "--steps", "14", "--tile", "32"]

    def test_it_gives_the_bytes_of_memory_whatever_the_tiles_and_threads(self):
        expected = self.trees("memory", *SMALL, "--steps", "14")
        for tile, threads in ((32, 1), (64, 2), (1000, 2)):
            folder = self.folder / f"rows{tile}"
            folder.mkdir()
            found = self.trees("rows", *SMALL, "--steps", "14", "--tile", tile, "--threads", threads, "--out-of-core", folder)
            self.assertSameBytes(found, expected, f"tile {tile}")

    def test_killed_at_any_moment_it_goes_on_to_the_same_bytes(self):
        expected = self.trees("memory", *SMALL, "--steps", "14")
        whole = self.folder / "whole"
        whole.mkdir()
        began = time.monotonic()
        self.trees("whole", *self.WORDS, "--out-of-core", whole)
        seconds = time.monotonic() - began
        draw = random.Random(4)
        stopped = 0
        for i in range(8):
            which = (signal.SIGKILL, signal.SIGTERM)[i % 2]
            folder = self.folder / "rows"
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            process = start(["forest", *self.WORDS, "--out-of-core", "rows", "-o", "rows.vdb", "--instances", "rows.ply", "--force", "-q"],
                            cwd=self.folder)
            time.sleep(draw.uniform(0, seconds))
            code, waited, err = stop(process, which)
            stopped += code != DONE
            if which == signal.SIGTERM:
                self.assertLess(waited, 1.5, err)
            self.assertSameBytes(self.trees("rows", *self.WORDS, "--out-of-core", folder), expected, f"stop {i}: {code} {err}")
            self.assertEqual(temporaries(folder), [])
        self.assertGreater(stopped, 2)

    def test_a_longer_run_goes_on_from_a_shorter_one(self):
        expected = self.trees("memory", *SMALL, "--steps", "14")
        (self.folder / "rows").mkdir()
        self.trees("rows", *SMALL, "--steps", "9", "--tile", "64", "--out-of-core", "rows")
        self.assertSameBytes(self.trees("rows", *SMALL, "--steps", "14", "--tile", "64", "--out-of-core", "rows"), expected)
        self.refuse(USAGE, ["14", "already"], "forest", *SMALL, "--steps", "9", "--tile", "64", "--out-of-core", "rows", "-o", "x.vdb")

    def test_another_forest_and_damage_are_named(self):
        (self.folder / "rows").mkdir()
        self.trees("rows", *self.WORDS, "--out-of-core", "rows")
        self.refuse(USAGE, ["rows", "r2", "seed"], "forest", *self.WORDS, "--r2", "0.3", "--seed", "5", "--out-of-core", "rows", "-o", "x.vdb")
        self.refuse(USAGE, ["none", "no such folder"], "forest", *self.WORDS, "--out-of-core", "none", "-o", "x.vdb")
        row = self.folder / "rows" / "step-0014" / "row-0000.trees"
        whole = row.read_bytes()
        for broken in (whole[:-1], whole[:7], b"", whole[:200] + bytes([whole[200] ^ 4]) + whole[201:]):
            row.write_bytes(broken)
            self.refuse(BAD_INPUT, ["row 0 of step 14"], "forest", *self.WORDS, "--out-of-core", "rows", "-o", "x.vdb")
        row.write_bytes(whole)
        state = self.folder / "rows" / "state.json"
        text = state.read_text()
        state.write_text(text[:len(text) // 2])
        self.refuse(BAD_INPUT, ["state.json"], "forest", *self.WORDS, "--out-of-core", "rows", "-o", "x.vdb")
        state.write_text(text)
        self.succeed("forest", *self.WORDS, "--out-of-core", "rows", "-o", "x.vdb", "-q")

    def test_a_full_disk_leaves_the_last_whole_step(self):
        with small_disk(self.folder / "disk", "size=700k") as disk:
            done = run("forest", "--size", "256m", "--initial", "400", "--no-canopy", "--steps", "40", "--tile", "64", "--out-of-core", disk, "-o",
                       "x.vdb", "-q", cwd=self.folder)
            self.assertEqual(done.code, CANNOT_WRITE, done)
            self.assertIn("no space", done.err)
            # What is there can be read.
            self.assertTrue((disk / "state.json").exists())
            again = run("forest", "--size", "256m", "--initial", "400", "--no-canopy", "--steps", "40", "--tile", "64", "--out-of-core", disk, "-o",
                        "x.vdb", cwd=self.folder)
            self.assertEqual(again.code, CANNOT_WRITE, again)
            self.assertIn("goes on from step", again.err)

    def test_a_window_shows_the_trees_that_stand_in_it(self):
        (self.folder / "rows").mkdir()
        self.succeed("forest", *SMALL[:-1], "--steps", "14", "--tile", "64", "--out-of-core", "rows", "--window", "20,30,90,110", "-o",
                     "part.vdb", "-q")
        self.succeed("forest", *SMALL[:-1], "--steps", "14", "-o", "all.vdb", "-q")
        for name in ("part", "all"):
            self.succeed("export", f"{name}.vdb", "--points", "forest_instances", "-o", f"{name}.ply", "-q")
        part, every = rows_of(self.folder / "part.ply"), rows_of(self.folder / "all.ply")
        inside = [row for row in every if 20 <= row[0] < 90 and 30 <= row[1] < 110]
        self.assertGreater(len(inside), 200)
        self.assertEqual(len(part), len(inside))
        for a, b in zip(part, inside):
            self.assertLess(max(abs(p - q) for p, q in zip(a, b)), 1e-9)


def rows_of(path):
    """x, y, z of the points of a PLY of ours."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    sizes = {b"double": 8, b"float": 4, b"int": 4, b"uint": 4}
    width = sum(sizes[line.split()[1]] for line in head.splitlines() if line.startswith(b"property"))
    return [struct.unpack_from("<3d", body, at) for at in range(0, len(body), width)]


    def test_a_folder_is_worked_in_by_one_run_alone(self):
        (self.folder / "rows").mkdir()
        words = ["forest", "--size", "400m", "--initial", "600", "--no-canopy", "--steps", "40", "--tile", "64", "--out-of-core", "rows"]
        first = start([*words, "-o", "a.vdb", "-q"], cwd=self.folder)
        self.assertTrue(wait_for(lambda: (self.folder / "rows" / "state.json").exists()))
        self.refuse(CANNOT_WRITE, ["rows", "another run"], *words, "-o", "b.vdb")
        stop(first, signal.SIGKILL)
        self.succeed(*words, "-o", "a.vdb", "--force", "-q")


class Wind(ForestRuns):
    WORDS = [*SMALL, "--steps", "12", "--windthrow", "0.3", "--wind-speed", "15m/s", "--wind-azimuth", "90deg"]

    def test_trees_that_the_wind_throws_are_listed_the_same_everywhere(self):
        def fallen(*options):
            self.succeed("forest", *self.WORDS, "--fallen", "fallen.csv", "-o", "w.vdb", "--force", "-q", *options)
            return (self.folder / "fallen.csv").read_bytes()
        expected = fallen("--threads", "1")
        self.assertSameBytes(fallen("--threads", "2", "--tile", "32"), expected)
        (self.folder / "rows").mkdir()
        self.assertSameBytes(fallen("--out-of-core", "rows", "--tile", "64"), expected)
        lines = expected.decode().splitlines()
        self.assertEqual(lines[0], "id,step,species,x,y,azimuth_rad,length")
        self.assertGreater(len(lines), 20)
        for line in lines[1:]:
            # The wind comes from the east: trees fall to the west.
            self.assertAlmostEqual(abs(float(line.split(",")[5])), 3.14159, 4)
        self.succeed("statistics", "w.vdb", "-o", "w.csv", "-q")
        names, *rows = [line.split(",") for line in (self.folder / "w.csv").read_text().splitlines()]
        self.assertEqual(sum(int(row[names.index("wind")]) for row in rows), len(lines) - 1)

    def test_wind_needs_a_speed(self):
        self.refuse(USAGE, ["windthrow", "wind_speed"], "forest", *SMALL, "--windthrow", "0.3", "-o", "w.vdb")


class Limits(ForestRuns):
    def test_more_trees_than_memory_are_refused_before_they_are_sown(self):
        for words in (["--initial", "20000000", "--memory", "200M", "--max-trees", "1e9"], ["--initial", "20000000"]):
            done = run("forest", "--size", "100m", "--steps", "1", *words, "-o", "x.vdb", cwd=self.folder)
            self.assertEqual(done.code, LIMIT, done)
            self.assertLess(done.peak, 200e6)
            self.assertIn("initial", done.err)

    def test_seeds_without_end_stop_at_the_limit(self):
        done = run("forest", "--size", "200m", "--initial", "1000", "--steps", "25", "--seeds-per-step", "300", "--memory", "300M", "--no-canopy",
                   "-o", "x.vdb", cwd=self.folder)
        self.assertEqual(done.code, LIMIT, done)
        self.assertIn("seeds-per-step", done.err)


class Heroes(ForestRuns):
    def test_a_single_tree_stands_where_the_forest_had_it_about_as_high(self):
        for size, at in (("60m", "30,30"), ("96m", "48,48;48,48;20,70")):
            self.succeed("forest", "--size", size, "--initial", "60", "--steps", "25", "--heroes", at, "-o", "f.vdb", "--force", "-q")
            done = self.succeed("tree", "f.vdb", "-o", "h.vdb", "--force", "--json")
            summary = done.json()["summary"]
            self.assertNotIn("heroes_died", summary)
            self.assertGreater(summary["hero_height"], 0.6)
            self.assertEqual(summary["heroes"], 1 if size == "60m" else 2)
        self.refuse(USAGE, ["999", "outside"], "forest", *SMALL, "--heroes", "999,9", "-o", "x.vdb")


class GoingOn(ForestRuns):
    def test_a_scene_goes_on_to_the_bytes_of_one_run(self):
        expected = self.trees("one", *SMALL, "--steps", "12")
        self.succeed("forest", *SMALL, "--steps", "5", "-o", "first.vdb", "-q")
        self.succeed("forest", "--from", "first.vdb", *SMALL, "--steps", "12", "-o", "two.vdb", "--instances", "two.ply", "-q")
        self.assertSameBytes((self.folder / "two.ply").read_bytes(), expected)
        self.succeed("statistics", "two.vdb", "-o", "two.csv", "-q")
        self.succeed("statistics", "one.vdb", "-o", "one.csv", "-q")
        self.assertSameBytes((self.folder / "two.csv").read_bytes(), (self.folder / "one.csv").read_bytes())

    def test_what_differs_from_the_scene_is_named(self):
        self.succeed("forest", *SMALL, "--steps", "5", "-o", "first.vdb", "-q")
        self.refuse(USAGE, ["size", "192"], "forest", "--from", "first.vdb", "--size", "128m", "--steps", "12", "-o", "x.vdb")
        self.refuse(USAGE, ["steps", "5"], "forest", "--from", "first.vdb", *SMALL, "--steps", "4", "-o", "x.vdb")

    def test_a_recipe_goes_on_after_a_kill(self):
        self.recipe('sekitei = 1\nseed = 3\nout = "out"\n[forest]\nsize = ["400m"]\nsteps = 60\ncanopy = false\nwrite = "f.vdb"\n')
        self.succeed("run", "rock.toml", "-q", "--set", "out=good")
        good = files_in(self.folder / "good")
        process = start(["run", "rock.toml", "-q"], cwd=self.folder)
        time.sleep(1.0)
        stop(process, signal.SIGKILL)
        self.succeed("run", "rock.toml", "-q")
        self.assertSameFiles(files_in(self.folder / "out"), good)


if __name__ == "__main__":
    unittest.main()
