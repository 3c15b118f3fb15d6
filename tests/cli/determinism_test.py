"""The same input gives the same bytes: threads, runs, folders."""

import shutil
import unittest
from pathlib import Path

from support import DONE, RECIPE, CliTest, SceneTest, chain_commands, environment, files_in, make_chain, run

# Noise, horizontal cuts and collapse on boxes whose sides differ: more of the program than the small chain takes.
ROUGH = """\
sekitei = 1
seed = 11
out = "out"

[lava]
preset = "cliff"
size = ["2.4m", "1.6m", "2m"]
voxel = "5cm"

[cool]

[joint]
spacing = "30cm"

[weather]
cut = "perpendicular"
ramp = "cliff"
write = "rock.vdb"

[rock]
stage = "mesh"
write = ["rock.ply", "rock.glb", "rock.stl", "rock.off", "rock.obj"]

[picture]
stage = "render"
from = "rock"
width = 80
height = 60
samples = 4
write = "rock.png"

[heat]
stage = "render"
from = "cool"
slice = "temperature"
width = 240
write = "heat.png"
"""


class Determinism(SceneTest):
    def test_every_command_gives_the_same_file_on_one_and_two_threads(self):
        for command, source, target, options in chain_commands():
            for threads in (1, 2):
                self.succeed(command, *([self.scenes / source] if source else []), *options, "--seed", 7, "--threads", threads,
                             "-o", target, "--force")
                self.assertSameBytes(self.folder / target, self.scenes / target, f"{command} on {threads} threads")

    def test_two_chains_are_the_same(self):
        again = self.folder / "again"
        again.mkdir()
        make_chain(again)
        self.assertSameFiles(files_in(again), files_in(self.scenes))

    def test_the_working_folder_is_in_no_file(self):
        elsewhere = self.folder / "else where/苔"
        elsewhere.mkdir(parents=True)
        make_chain(elsewhere, cwd="/")
        self.assertSameFiles(files_in(elsewhere), files_in(self.scenes))
        for name, content in files_in(elsewhere).items():
            self.assertNotIn(str(self.folder).encode(), content, name)

    def test_a_recipe_gives_the_same_files_on_any_number_of_threads_anywhere(self):
        self.recipe(ROUGH, "rough.toml")
        self.succeed("run", "rough.toml", "-q", "--threads", 1, "--set", "out=one")
        self.succeed("run", "rough.toml", "-q", "--threads", 2, "--set", "out=two")
        one = files_in(self.folder / "one")
        self.assertEqual(len(one), 9)
        self.assertSameFiles(one, files_in(self.folder / "two"), "threads")
        moved = self.folder / "deep/er"
        moved.mkdir(parents=True)
        shutil.copy(self.folder / "rough.toml", moved / "renamed.toml")
        done = run("run", "deep/er/renamed.toml", "-q", "--set", f"out={self.folder}/three", cwd=self.folder,
                   env=environment(LC_ALL="de_DE.UTF-8", TZ="Asia/Tokyo"))
        self.assertEqual(done.code, DONE, done)
        self.assertSameFiles(one, files_in(self.folder / "three"), "folder, name, locale, time zone")

    def test_what_was_computed_before_does_not_show(self):
        # The same end by another way: changed and changed back, stage by stage.
        self.recipe(ROUGH, "rough.toml")
        self.succeed("run", "rough.toml", "-q", "--set", "out=straight")
        self.succeed("run", "rough.toml", "-q", "--set", "joint.spacing=40cm")
        self.succeed("run", "rough.toml", "-q", "--set", "weather.cut=horizontal", "--only", "weather")
        self.succeed("run", "rough.toml", "-q", "--only", "joint")
        self.succeed("run", "rough.toml", "-q")
        self.assertSameFiles(files_in(self.folder / "out"), files_in(self.folder / "straight"))


if __name__ == "__main__":
    unittest.main()
