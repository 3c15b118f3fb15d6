"""Forests: grown, gone on with, edited, drawn, counted; and what cannot be."""

import re
import runpy
import struct
import unittest
import zlib

from support import BAD_INPUT, CANNOT_WRITE, DATA, DONE, LIMIT, USAGE, CliTest, run, small_disk

def small(*more, steps=8):
    """1.6 ha with some 300 trees, a fraction of a second; `more` options come before these."""
    usual = {"--size": "128m", "--initial": "40", "--ages": "6", "--variants": "1", "--steps": str(steps)}
    given = {str(word).split("=")[0] for word in more}
    return [word for option, value in usual.items() if option not in given for word in (option, value)] + ["--no-canopy", *more]


def grey_png(rows):
    """A PNG of rows of 8-bit grey, the northern one first."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", len(rows[0]), len(rows), 8, 0, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"".join(b"\0" + bytes(r) for r in rows)))
            + chunk(b"IEND", b""))


class ForestTest(CliTest):
    def grow(self, *arguments, out="f.vdb", **options):
        """Grows a forest; the summary."""
        return self.succeed("forest", *arguments, "-o", out, "-q", "--json", "--force", **options).json()["summary"]

    def rows(self, scene):
        """The table of its steps, as dictionaries of numbers."""
        self.succeed("statistics", scene, "-o", "rows.csv", "--force", "-q")
        head, *rows = [line.split(",") for line in (self.folder / "rows.csv").read_text().split()]
        return [dict(zip(head, map(float, row))) for row in rows]

    def trees(self, scene):
        """Bytes of all that growth goes on from."""
        self.succeed("export", scene, "--points", "forest_trees", "-o", "trees.ply", "--force", "-q")
        return (self.folder / "trees.ply").read_bytes()


class Growth(ForestTest):
    def test_numbers_of_every_step(self):
        summary = self.grow(*small())
        rows = self.rows("f.vdb")
        self.assertEqual([row["step"] for row in rows], list(range(1, 9)))
        self.assertEqual(summary["status"], "growing")
        self.assertEqual(summary["trees"], rows[-1]["trees"] + rows[-1]["births"])
        for before, after in zip(rows, rows[1:]):
            died = sum(after[cause] for cause in ("competition", "environment", "age", "wind", "felled"))
            self.assertEqual(after["trees"], before["trees"] + before["births"] - died)
            self.assertEqual(after["trees"], sum(v for k, v in after.items() if re.search("_(to_3m|to_8m|to_12m|above)$", k)))

    def test_going_on_is_growing_at_once(self):
        self.write("e.toml", "[[edit]]\nstep = 3\nmap = 1\nvalue = 0\ndisc = [64, 64, 20]\n\n[[edit]]\nstep = 6\nfell = true\nmin_height = 9\n")
        options = ["--seed", "4", "--edits", "e.toml"]
        self.grow(*small(*options), out="once.vdb")
        self.grow(*small(*options, steps=5), out="five.vdb")
        self.succeed("forest", "five.vdb", *small(*options), "-o", "twice.vdb", "-q")
        self.assertSameBytes(self.trees("once.vdb"), self.trees("twice.vdb"))
        self.assertEqual(self.rows("once.vdb"), self.rows("twice.vdb"))

    def test_threads_and_tiles_do_not_show(self):
        files = []
        for threads, tile in ((1, 256), (2, 256), (2, 16)):
            self.grow(*small("--threads", threads, "--tile", tile), out=f"{threads}_{tile}.vdb")
            files.append(self.folder / f"{threads}_{tile}.vdb")
        self.assertSameBytes(files[0], files[1])
        self.assertEqual(run("diff", files[0], files[2], cwd=self.folder).code, DONE)
        self.assertSameBytes(self.trees(files[0]), self.trees(files[2]))

    def test_the_history_makes_the_same_file_again(self):
        self.write("p.png", grey_png([[255] * 64 + [0] * 64] * 128))
        self.grow(*small("--seed", "5", "--density", "p.png,1,1,1,1"), out="a.vdb")
        self.write("again.toml", self.succeed("replay", "a.vdb").out)
        self.succeed("run", "again.toml", "--set", "out=again", "-q")
        self.assertSameBytes(self.folder / "a.vdb", self.folder / "again" / "a.vdb")

    def test_maps_have_north_up(self):
        self.write("p.png", grey_png([[255] * 128] * 64 + [[0] * 128] * 64))  # nothing grows in the south
        self.grow(*small("--seeds-per-step", "0", "--density", "p.png,1,1,1,1", "--instances", "i.csv"))
        lines = [l for l in (self.folder / "i.csv").read_text().split("\n") if l and not l.startswith("#")]
        y = lines[0].split(",").index("y")
        places = [float(line.split(",")[y]) for line in lines[1:]]
        self.assertGreater(len(places), 20)
        self.assertGreater(min(places), 63)

    def test_a_sequence_shows_the_growth(self):
        self.grow(*small("--every", "3", steps=6), out="s.vdb")
        self.assertEqual(sorted(p.name for p in self.folder.glob("s.*.vdb")), ["s.0003.vdb", "s.0006.vdb"])
        self.grow(*small(steps=3), out="three.vdb")
        self.assertSameBytes(self.trees("three.vdb"), self.trees("s.0003.vdb"))

    def test_pictures_and_plots(self):
        self.grow(*small(), out="a.vdb")
        self.grow(*small("--density", "0.5"), out="b.vdb")
        self.succeed("distribution", "a.vdb", "-o", "a.png", "--px", "256", "-q")
        self.assertEqual((self.folder / "a.png").read_bytes()[16:24], struct.pack(">II", 256, 256))
        done = self.succeed("distribution", "a.vdb", "b.vdb", "-o", "ab.png", "--labels", "-q", "--json").json()["summary"]
        self.assertEqual(done["trees"], sum(self.rows(s)[-1]["trees"] for s in ("a.vdb", "b.vdb")))
        self.succeed("plot", "a.vdb", "-o", "p.png", "--columns", "trees,above,tall,tall_to_3m", "-q")
        self.succeed("plot", "a.vdb", "b.vdb", "-o", "d.png", "--over", "density", "-q")
        self.refuse(USAGE, ["'tree'", "trees"], "plot", "a.vdb", "-o", "x.png", "--columns", "tree")
        self.grow(*small("--density", "1,1,1,1,0.9"), out="c.vdb")
        self.refuse(BAD_INPUT, ["c", "1,1,1,1,0.9"], "plot", "a.vdb", "c.vdb", "-o", "x.png", "--over", "density")
        self.succeed("tree", "--generations", "3", "-o", "t.vdb", "-q")
        self.refuse(BAD_INPUT, ["forest_instances", "`sekitei forest`"], "distribution", "t.vdb", "-o", "x.png")

    def test_a_figure_of_the_paper(self):
        done = self.succeed("run", DATA / "recipes" / "forest-fig48.toml", "--set", "out=f", "--only", "compare", timeout=300)
        self.assertNotIn("MISSED", done.err)
        self.assertEqual(len(re.findall("holds *$", done.err, re.M)), 5, "a head and four criteria")

    def test_criteria_are_missed_where_they_do_not_hold(self):
        self.grow(*small("--density", "0.4"), out="thin.vdb")
        self.grow(*small(), out="dense.vdb")
        self.succeed("compare", "dense.vdb", "thin.vdb", "--figure", "55", "-o", "right.csv", "-q")
        right = (self.folder / "right.csv").read_text().split("\n")
        self.grow(*small(), out="thin.vdb")
        self.succeed("compare", "dense.vdb", "thin.vdb", "--figure", "55", "-o", "wrong.csv", "-q")
        wrong = (self.folder / "wrong.csv").read_text().split("\n")
        self.assertTrue(all(line.endswith("MISSED") for line in wrong[1:3]), wrong)
        self.assertNotEqual(right[1:3], wrong[1:3])
        (self.folder / "thin.vdb").rename(self.folder / "b.vdb")
        self.refuse(BAD_INPUT, ["figure = 55", "'thin'", "b, dense"], "compare", "dense.vdb", "b.vdb", "--figure", "55", "-o", "x.csv")
        self.refuse(BAD_INPUT, ["dense", "step 40"], "compare", "dense.vdb", "--figure", "51", "-o", "x.csv")
        self.refuse(USAGE, ["figure = 50", "48, 49"], "compare", "dense.vdb", "b.vdb", "--figure", "50", "-o", "x.csv")
        self.succeed("tree", "--generations", "3", "-o", "t.vdb", "-q")
        self.refuse(BAD_INPUT, ["forest_trees", "`sekitei forest`"], "compare", "dense.vdb", "t.vdb", "--figure", "55", "-o", "x.csv")

    def test_the_path_is_the_one_of_its_script(self):
        script = runpy.run_path(str(DATA / "forest" / "path.py"))
        self.assertEqual(script["png"](), (DATA / "forest" / "path.png").read_bytes())


class InvalidInput(ForestTest):
    def test_values_that_cannot_be(self):
        self.write("wide.toml", '[[species]]\nname = "fir"\nspread = 3.2\n')
        self.write("flat.toml", '[[species]]\nname = "fir"\nspread = 0\n')
        self.write("limits.toml", '[[species]]\nname = "fir"\nlimits = { water = [0.2, 0.1, 0.3, 0.4, 0.5, 0.6] }\n')
        self.write("watr.toml", '[[species]]\nname = "fir"\nlimits = { watr = [0, 0.1, 0.3, 0.4, 0.5, 0.6] }\n')
        for words, options in ((["r1 = 0.5", "r2"], ["--r1", "0.5"]), (["r2", "nan"], ["--r2", "nan"]), (["size", "-5"], ["--size=-5m"]),
                               (["size", "nan"], ["--size", "nan"]), (["128.5", "pixel"], ["--size", "128.5m"]),
                               (["slices", "65"], ["--slices", "65"]), (["slices", "1 to 64"], ["--slices", "0"]),
                               (["maturity"], ["--maturity", "1.5"]), (["seed_factor"], ["--seed-factor=-1"]),
                               (["seedling_height"], ["--seedling-height", "0"]), (["seeds_per_step"], ["--seeds-per-step", "nan"]),
                               (["table-5.1"], ["--species", "table-51"]), (["shrub", "shrubb"], ["--species", "table-5.1:shrubb"]),
                               (["spread = 3.2", "fir"], ["--species", "wide.toml"]), (["spread = 0"], ["--species", "flat.toml"]),
                               (["stands_below", "0.1"], ["--species", "limits.toml"]),
                               (["watr", "water"], ["--species", "watr.toml", "--environment", "water=0.5"]),
                               (["4 maps", "must be 5"], ["--density", "1,1,1,1"]), (["6 maps", "must be 5"], ["--density", "1,1,1,1,1,1"]),
                               (["initial", "2 numbers"], ["--initial", "5,5"]), (["steps"], ["--steps=-1"]),
                               (["inverted", "upright", "flat"], ["--orientation", "up"]), (["clip, wrap"], ["--border", "open"])):
            with self.subTest(options=options):
                self.refuse(USAGE, words, "forest", *small(*options), "-o", "x.vdb")
        # Good twins.
        self.grow(*small("--r1", "0.2", "--slices", "64", "--band", "64", "--maturity", "1", "--species", "table-5.1:tall,shrub"))

    def test_maps_that_do_not_fit(self):
        self.write("small.png", grey_png([[255] * 64] * 64))
        self.refuse(BAD_INPUT, ["small.png", "64 x 64", "128 x 128", "fit"], "forest", *small("--density", "small.png"), "-o", "x.vdb")
        self.grow(*small("--density", "small.png", "--fit"), out="fit.vdb")
        self.grow(*small(), out="one.vdb")
        self.assertSameBytes(self.trees("fit.vdb"), self.trees("one.vdb"))
        for value in ("1.5", "-0.1", "nan"):
            with self.subTest(value=value):
                self.refuse(USAGE, ["density", value], "forest", *small(f"--density={value}"), "-o", "x.vdb")
        self.refuse(BAD_INPUT, ["none.png"], "forest", *small("--density", "none.png"), "-o", "x.vdb")
        self.write("junk.png", b"junk" * 50)
        self.refuse(BAD_INPUT, ["junk.png"], "forest", *small("--density", "junk.png"), "-o", "x.vdb")

    def test_lists_of_trees(self):
        def listed(*trees):
            return self.write("list.csv", "species,x,y,height,uid\n" + "".join(f"{t}\n" for t in trees))
        listed("tall,10,10,2,1", "1,200,10,2,2", "shrub,50,50,9,3")
        done = self.succeed("forest", *small("--initial", "list.csv", steps=0), "-o", "l.vdb", "--json")
        self.assertEqual(done.json()["summary"]["trees"], 2)
        self.assertRegex(done.err, "warning.*1 .*outside")
        self.assertRegex(done.err, "warning.*1 .*(higher|clamped)")
        for tree, word in (("tall,10,10,0,1", "height"), ("tall,10,10,-1,1", "height"), ("tall,10,10,nan,1", "height"), ("oak,10,10,2,1", "oak")):
            with self.subTest(tree=tree):
                listed(tree)
                self.refuse(BAD_INPUT, ["list.csv:2", word], "forest", *small("--initial", "list.csv"), "-o", "x.vdb")
        listed("tall,10,10,2,77", "tall,20,20,2,77")
        self.refuse(BAD_INPUT, ["list.csv", "000000000000004d"], "forest", *small("--initial", "list.csv"), "-o", "x.vdb")

    def test_edits_are_named_with_their_place(self):
        for text, words in (("[[edit]]\nstep = 0\nmap = 1\nvalue = 0\n", ["e.toml:2", "step"]),
                            ("[[edit]]\nstep = 1\nmap = 6\nvalue = 0\n", ["e.toml:3", "map"]),
                            ("[[edit]]\nstep = 1\nmap = 1\nvalue = 2\n", ["e.toml:4", "value"]),
                            ("[[edit]]\nstep = 1\nmap = 1\nvalu = 1\n", ["e.toml:4", "value"]),
                            ("[[edit]\n", ["e.toml:1"])):
            with self.subTest(text=text):
                self.write("e.toml", text)
                self.refuse(USAGE, words, "forest", *small("--edits", "e.toml"), "-o", "x.vdb")

    def test_a_forest_that_dies_out_is_a_result(self):
        done = self.succeed("forest", *small("--density", "0.1", "--instances", "i.ply"), "-o", "dead.vdb", "--json")
        summary = done.json()["summary"]
        self.assertEqual((summary["status"], summary["trees"]), ("extinct", 0))
        self.assertLess(summary["step"], 8)
        self.assertRegex(done.err, f"after step {summary['step']}")
        self.assertEqual(self.rows("dead.vdb")[-1]["trees"], 0)
        self.assertIn(b"element vertex 0\n", (self.folder / "i.ply").read_bytes())
        self.succeed("distribution", "dead.vdb", "-o", "dead.png", "-q")
        self.succeed("plot", "dead.vdb", "-o", "plot.png", "-q")
        self.succeed("forest", *small("--initial", "0"), "-o", "never.vdb", "-q")

    def test_a_limit_keeps_the_last_whole_step(self):
        done = self.run_in_folder("forest", *small("--max-trees", "500", steps=40), "-o", "x.vdb", "--json", "-q")
        self.assertEqual(done.code, LIMIT, done)
        summary = done.json()["summary"]
        self.assertEqual(summary["status"], "limit")
        self.assertGreater(summary["trees"], 500)
        self.grow(*small(steps=summary["step"]), out="y.vdb")
        self.assertSameBytes(self.trees("x.vdb"), self.trees("y.vdb"))

    def test_memory_is_asked_for_before_it_is_taken(self):
        self.refuse(LIMIT, ["--memory", "--out-of-core"], "forest", "--size", "10km", "--memory", "1G", "-o", "x.vdb")


if __name__ == "__main__":
    unittest.main()
