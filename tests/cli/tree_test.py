"""Trees: grown, gone on with, felled, cut, beside rocks, drawn; and what cannot be."""

import json
import re
import struct
import unittest

from support import BAD_INPUT, DATA, DONE, LIMIT, USAGE, CliTest, run

# A tree of some 80 branches: a few milliseconds.
YOUNG = ["--generations", "12"]


class TreeTest(CliTest):
    def grow(self, *arguments, out="t.vdb", **options):
        """Grows trees; the summary."""
        done = self.succeed("tree", *arguments, "-o", out, "-q", "--json", "--force", **options)
        return done.json()["summary"]

    def points(self, scene, which):
        self.succeed("export", scene, "--points", which, "-o", "points.ply", "--force", "-q")
        return (self.folder / "points.ply").read_bytes()


class Growth(TreeTest):
    def test_the_tree_of_table_1(self):
        summary = self.grow("--no-ground")
        self.assertEqual((summary["tips"], summary["status"]), (834, "growing"))
        self.assertAlmostEqual(summary["height_m"], 10.59, places=2)
        self.assertAlmostEqual(summary["trunk_diameter_m"], 0.216, places=3)
        listed = self.succeed("info", "t.vdb").out.decode()
        for name in ("tree_skeleton", "trees", "tree_growth", "leaves", "canopy_lad", "canopy_RU", "tree_light"):
            self.assertIn(name, listed)

    def test_going_on_is_growing_at_once(self):
        for species in ("table-1", "pine", "pollard"):
            with self.subTest(species=species):
                kind = ["--species", species, "--seed", "3"]
                self.grow(*kind, "--generations", "20", out="once.vdb")
                self.grow(*kind, *YOUNG, out="young.vdb")
                self.grow("--from", "young.vdb", "--generations", "8", out="twice.vdb")
                for which in ("tree_skeleton", "trees", "tree_growth", "leaves"):
                    self.assertSameBytes(self.points("once.vdb", which), self.points("twice.vdb", which), which)
                self.assertEqual(run("diff", "once.vdb", "twice.vdb", cwd=self.folder).code, DONE)

    def test_waiting_buds_go_on_too(self):
        shoots = ["--model", "shoot", "--buds", "12", "--stagger", "9"]
        self.grow(*shoots, "--generations", "14", out="once.vdb")
        self.grow(*shoots, "--generations", "4", out="young.vdb")
        self.assertGreater(len(self.points("young.vdb", "tree_buds")), 400)
        for k in range(2):  # none is left after the first
            self.grow("--from", "young.vdb" if k == 0 else "more.vdb", "--generations", "5", out="more.vdb")
        self.assertSameBytes(self.points("once.vdb", "tree_skeleton"), self.points("more.vdb", "tree_skeleton"))

    def test_threads_do_not_show(self):
        for threads in (1, 2):
            self.grow("--seed", "2", "--wood", "--wood-voxel", "10cm", "--threads", threads, out=f"{threads}.vdb")
        self.assertSameBytes(self.folder / "1.vdb", self.folder / "2.vdb")

    def test_the_history_makes_the_same_file_again(self):
        self.grow(*YOUNG, "--seed", "5", "--tropism", "0.25", out="a.vdb")
        self.grow("--from", "a.vdb", "--generations", "5", "--death-threshold", "0.5", out="b.vdb")
        text = self.succeed("replay", "b.vdb").out
        self.write("again.toml", text)
        self.succeed("run", "again.toml", "--set", "out=again", "-q")
        self.assertSameBytes(self.folder / "b.vdb", self.folder / "again" / "b.vdb")
        # Files beside a scene are none of a recipe's business.
        self.grow(*YOUNG, "--skeleton", "side.json", out="side.vdb")
        self.write("side.toml", self.succeed("replay", "side.vdb").out)
        self.succeed("check", "side.toml")

    def test_a_sequence_shows_the_growth(self):
        self.grow("--generations", "8", "--sequence", "4", out="s.vdb")
        frames = sorted(p.name for p in self.folder.glob("s.*.vdb"))
        self.assertEqual(frames, ["s.0002.vdb", "s.0004.vdb", "s.0006.vdb", "s.0008.vdb"])
        self.grow("--generations", "4", out="four.vdb")
        self.assertSameBytes(self.points("four.vdb", "tree_skeleton"), self.points("s.0004.vdb", "tree_skeleton"))
        self.refuse(USAGE, ["sequence"], "tree", "--generations", "8", "--sequence", "4", "-o", "-")

    def test_numbers_of_every_generation(self):
        summary = self.grow(*YOUNG)
        self.succeed("statistics", "t.vdb", "-o", "t.csv", "-q")
        rows = [line.split(",") for line in (self.folder / "t.csv").read_text().split()]
        self.assertEqual(rows[0][:4], ["generation", "tips", "births", "deaths"])
        self.assertEqual(len(rows), 13)
        self.assertEqual(int(rows[-1][1]), summary["tips"])
        for before, after in zip(rows[1:], rows[2:]):
            self.assertEqual(int(after[2]), 2 * int(before[1]), "every tip has two children")
            self.assertEqual(int(after[1]), int(after[2]) - int(after[3]))

    def test_felling_leaves_the_neighbour(self):
        two = self.grow("--origin", "-1.2m,0,0; 1.2m,0,0", *YOUNG, out="two.vdb")
        one = self.grow("--from", "two.vdb", "--remove", "0", "--generations", "0", out="one.vdb")
        self.assertLess(one["tips"], two["tips"])
        self.assertGreater(one["tips"], 0)
        self.assertEqual(one["trees"], 2)
        self.grow("--from", "one.vdb", "--generations", "4", out="on.vdb")
        gone = self.grow("--from", "two.vdb", "--remove", "0,1", out="none.vdb")
        self.assertEqual((gone["status"], gone["tips"]), ("extinct", 0))
        self.refuse(USAGE, ["tree", "2"], "tree", "--from", "two.vdb", "--remove", "2", "-o", "x.vdb")
        self.refuse(USAGE, ["remove", "numbers"], "tree", "--from", "two.vdb", "--remove", "left", "-o", "x.vdb")

    def test_cutting_wakes_buds(self):
        self.grow("--generations", "20", "--no-ground", out="whole.vdb")
        cut = ["--from", "whole.vdb", "--prune-generation", "6", "--generations", "20"]
        self.assertEqual(self.grow(*cut)["status"], "extinct")
        self.assertGreater(self.grow(*cut, "--latent-share", "1")["tips"], 150)
        low = self.grow("--from", "whole.vdb", "--prune-above", "5m", "--generations", "0")
        self.assertLessEqual(low["height_m"], 5)

    def test_new_trees_among_old_ones(self):
        self.grow(*YOUNG, out="old.vdb")
        both = self.grow("--from", "old.vdb", "--origin", "3,0,0", "--species", "pine", "--generations", "6", out="both.vdb")
        self.assertEqual(both["trees"], 2)
        self.grow("--from", "both.vdb", "--generations", "1", out="more.vdb")

    def test_species_of_files_are_the_presets(self):
        for file in sorted((DATA / "trees").glob("*.toml")):
            with self.subTest(species=file.stem):
                for name, out in ((file.stem, "name.vdb"), (file, "file.vdb")):
                    self.grow("--species", name, *YOUNG, out=out)
                for which in ("tree_skeleton", "leaves"):
                    self.assertSameBytes(self.points("name.vdb", which), self.points("file.vdb", which))
        self.write("weed.toml", 'tropism = 0.9\nbranch_angel = 5\n')
        self.refuse(USAGE, ["weed.toml:2:1", "branch_angle"], "tree", "--species", "weed.toml", "-o", "x.vdb")


class Files(TreeTest):
    def test_skeletons_and_bark(self):
        for suffix in ("ply", "json", "obj"):
            summary = self.grow(*YOUNG, "--skeleton", f"s.{suffix}", "--mesh", "bark.ply")
        branches = summary["branches"]
        header = (self.folder / "s.ply").read_text().split("end_header")[0]
        self.assertIn(f"element vertex {branches + 1}\n", header)
        self.assertIn(f"element edge {branches}\n", header)
        data = json.loads((self.folder / "s.json").read_text())
        self.assertEqual((len(data["vertices"]), len(data["edges"])), (branches + 1, branches))
        self.assertEqual(sorted(data["vertices"][0]), sorted(["x", "y", "z", "radius", "generation", "order", "light", "alive",
                                                              "dead_age", "tree_id", "key"]))
        self.assertEqual(len({b for _, b in data["edges"]}), branches, "each branch ends at a vertex of its own")
        lines = [l.split()[1:] for l in (self.folder / "s.obj").read_text().split("\n") if l.startswith("l ")]
        self.assertEqual(sum(len(l) - 1 for l in lines), branches)
        self.assertIn("closed", self.succeed("info", "bark.ply").out.decode())
        self.refuse(USAGE, [".ply, .json or .obj"], "tree", "--skeleton", "s.txt", "-o", "x.vdb")
        self.refuse(USAGE, [".glb"], "tree", "--mesh", "s.txt", "-o", "x.vdb")
        self.write("side.toml", 'sekitei = 1\n[tree]\nskeleton = "s.ply"\n')
        self.refuse(USAGE, ["behind the recipe's back"], "check", "side.toml")

    def test_pictures(self):
        self.grow(*YOUNG, "--species", "cherry", out="a.vdb")
        self.grow(*YOUNG, "--tropism", "0", out="b.vdb")
        self.succeed("sketch", "a.vdb", "b.vdb", "-o", "s.png", "--size", "100", "-q")
        self.succeed("sketch", "a.vdb", "-o", "one.png", "--size", "100", "--view", "side", "-q")
        small = ["--width", "48", "--height", "40", "--samples", "2", "--bounces", "1", "-q"]
        seen = set()
        for season in ("auto", "green", "autumn", "bare"):
            self.succeed("render", "a.vdb", "-o", f"{season}.png", "--season", season, *small)
            seen.add((self.folder / f"{season}.png").read_bytes())
        self.assertEqual(len(seen), 4)
        self.succeed("render", "a.vdb", "-o", "slice.png", "--slice", "tree_light", "--width", "200", "-q")
        self.succeed("mesh", "a.vdb", "--grid", "canopy_lad", "--iso", "0.01", "-o", "crown.ply", "-q")
        done = self.run_in_folder("sketch", "s.png", "-o", "x.png")
        self.assertEqual(done.code, BAD_INPUT, done)

    def test_a_figure_of_the_paper(self):
        done = self.succeed("run", DATA / "recipes" / "tree-fig13.toml", "--set", "out=f")
        self.assertNotIn("MISSED", done.err)
        self.assertEqual(len(re.findall("holds *$", done.err, re.M)), 7, "a head and six criteria")
        self.assertTrue((self.folder / "f" / "sketch.png").exists())
        self.write("bad.toml", 'sekitei = 1\n[a]\nstage = "tree"\ngenerations = 2\n[z]\nstage = "tree"\ngenerations = 3\n'
                               '[compare]\nfrom = ["a", "z"]\nfigure = 13\n')
        self.refuse(USAGE, ["figure = 7"], "check", self.write("seven.toml", (self.folder / "bad.toml").read_text().replace("13", "7")))


class BadInput(TreeTest):
    def test_values_that_cannot_be(self):
        for words, options in ((["patch_rows = 7", "even"], ["--patch-rows", "7"]), (["patch_rows", "2 to"], ["--patch-rows", "0"]),
                               (["patch_columns", "3 to"], ["--patch-columns", "2"]), (["ball_radius"], ["--ball-radius", "0"]),
                               (["ball_radius"], ["--ball-radius", "-1"]), (["tropism", "0 to 1"], ["--tropism", "1.5"]),
                               (["transmission", "0 to 1"], ["--transmission", "-0.1"]),
                               (["branch_angle", "> 0 and < 90"], ["--branch-angle", "90"]),
                               (["branch_angle"], ["--branch-angle", "0"]), (["first_length", "> 0"], ["--first-length", "0"]),
                               (["light_ratio_upper"], ["--light-ratio-upper", "-1"]),
                               (["light_ratio_lower"], ["--light-ratio-lower", "-1"]),
                               (["light_ratio"], ["--light-ratio-upper", "0", "--light-ratio-lower", "0"]),
                               (["tropism"], ["--tropism", "nan"]), (["generations"], ["--generations", "-1"]),
                               (["generations", "500"], ["--generations", "501"]), (["--branch-angle"], ["--branch-angel", "3"]),
                               (["dichotomy, shoot, conifer"], ["--model", "pinus"]),
                               (["beech", "table-1"], ["--species", "beach"]), (["transmission", "sweep"], ["--transmission", "0",
                                                                                                      "--method", "grid"]),
                               (["origin"], ["--origin", "0"]), (["origin", "zebra"], ["--origin", "0,0,zebra"]),
                               (["origins"], ["--origin", "1,2,3; 1,2,3"]), (["every and sequence"], ["--every", "2", "--sequence", "2"])):
            with self.subTest(options=options):
                self.refuse(USAGE, words, "tree", *options, "-o", "x.vdb")

    def test_what_is_strange_but_can_be(self):
        none = self.grow("--generations", "0")
        self.assertEqual((none["branches"], none["generation"]), (1, 0))
        for tau in ("0", "1"):
            done = self.succeed("tree", *YOUNG, "--transmission", tau, "-o", f"{tau}.vdb")
            self.assertIn("warning", done.err)
        dead = self.grow("--death-threshold", "3", out="dead.vdb")
        self.assertEqual((dead["status"], dead["tips"], dead["generation"]), ("extinct", 0, 1))
        self.succeed("sketch", "dead.vdb", "-o", "dead.png", "-q")
        again = self.grow("--from", "dead.vdb", "--generations", "3")
        self.assertEqual(again["status"], "extinct")

    def test_side_files_leave_no_trace_in_the_scene(self):
        self.grow(*YOUNG, out="plain.vdb")
        self.grow(*YOUNG, "--mesh", self.folder / "bark.ply", "--skeleton", "s.json", out="more.vdb")
        self.assertSameBytes(self.folder / "plain.vdb", self.folder / "more.vdb")

    def test_a_dead_tree_has_empty_files(self):
        for name in ("bark.ply", "bark.obj", "bark.stl", "bark.off"):
            self.grow("--death-threshold", "5", "--mesh", name, "--skeleton", "s.ply")
            self.assertTrue((self.folder / name).exists(), name)

    def test_voxels_that_do_not_fit_are_refused_at_once(self):
        self.refuse(LIMIT, ["--memory", "voxel"], "tree", *YOUNG, "--voxel", "1mm", "--memory", "1G", "-o", "x.vdb")

    def test_leaves_that_let_all_light_pass_cost_nothing(self):
        done = self.run_in_folder("tree", "--transmission", "1", "--max-tips", "30000", "--no-leaves", "-o", "x.vdb")
        self.assertEqual(done.code, LIMIT, done)
        self.assertLess(done.seconds, 8)

    def test_felling_needs_trees(self):
        self.refuse(USAGE, ["remove", "--from"], "tree", *YOUNG, "--remove", "1", "-o", "x.vdb")

    def test_a_limit_keeps_the_last_whole_generation(self):
        done = self.run_in_folder("tree", "--max-tips", "20", "-o", "x.vdb", "-q", "--json")
        self.assertEqual(done.code, LIMIT, done)
        summary = done.json()["summary"]
        self.assertEqual(summary["status"], "limit")
        self.assertGreater(summary["tips"], 20)
        self.grow("--generations", summary["generation"], out="y.vdb")
        self.assertSameBytes(self.points("x.vdb", "tree_skeleton"), self.points("y.vdb", "tree_skeleton"))
        self.write("l.toml", 'sekitei = 1\n[tree]\nmax_tips = 20\nwrite = "l.vdb"\n')
        for _ in range(2):  # kept results tell of it as well
            done = self.run_in_folder("run", "l.toml", "--set", "out=l", "-q")
            self.assertEqual(done.code, LIMIT, done)
            self.assertSameBytes(self.points("l/l.vdb", "tree_skeleton"), self.points("x.vdb", "tree_skeleton"))

    def test_obstacles(self):
        boulder = DATA / "meshes" / "boulder.ply"
        self.refuse(BAD_INPUT, ["obstacle"], "tree", "--obstacle", boulder, "--origin", "0,0,0.4", "-o", "x.vdb")
        done = self.succeed("tree", *YOUNG, "--obstacle", boulder, "--origin", "0,0,0.4; 3,0,0", "-o", "x.vdb", "--json")
        self.assertIn("warning", done.err)
        on_top = self.grow(*YOUNG, "--obstacle", boulder, "--origin", "0,0", out="top.vdb")
        self.succeed("tree", *YOUNG, "--obstacle", boulder, "--origin", "50,0", "-o", "far.vdb", "-q")
        self.succeed("tree", *YOUNG, "--origin", "50,0,0", "-o", "plain.vdb", "-q")
        self.assertSameBytes(self.points("far.vdb", "trees"), self.points("plain.vdb", "trees"))
        x, y, z = struct.unpack_from("<3d", self.points("top.vdb", "trees").split(b"end_header\n", 1)[1])
        self.assertTrue(0.5 < z < 0.93, "the boulder's top")
        self.assertEqual(on_top["status"], "growing")
        for name, text in (("none.vdb", "none.vdb"), (self.write("junk.vdb", b"junk" * 99), "junk.vdb")):
            self.refuse(BAD_INPUT, [text], "tree", "--obstacle", name, "-o", "x.vdb", "--force")
        self.grow(*YOUNG, out="fog.vdb")
        self.refuse(BAD_INPUT, ["fog.vdb", "level set"], "tree", "--obstacle", "fog.vdb", "-o", "y.vdb")
        # A roof over half of the sky drives the tree to the other side.
        self.succeed("lava", "--preset", "slab", "--size", "1.6m,1.6m,1.6m", "--voxel", "4cm", "-o", "lava.vdb", "-q")
        self.grow(*YOUNG, "lava.vdb", "--origin", "5,5,0", out="beside.vdb")
        self.assertIn("region", self.succeed("info", "beside.vdb").out.decode())

    def test_a_scene_that_lost_its_parameters(self):
        self.grow(*YOUNG)
        self.write("wrong.vdb", (self.folder / "t.vdb").read_bytes()[:-100])
        self.refuse(BAD_INPUT, ["wrong.vdb"], "tree", "--from", "wrong.vdb", "-o", "x.vdb")


if __name__ == "__main__":
    unittest.main()
