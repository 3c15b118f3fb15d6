"""Models of moss plants: written where asked, the shipped ones among them."""

import unittest

from support import DATA, DONE, USAGE, SceneTest, run


class Tufts(SceneTest):
    def test_the_shipped_models_are_made_again_and_nothing_is_replaced_unasked(self):
        done = run("tufts", "-o", self.folder, "--json")
        self.assertEqual(done.code, DONE, done)
        files = sorted(self.folder.glob("*_lod?.ply"))
        self.assertEqual(sorted(done.json()["files"]), [str(f) for f in files])
        self.assertEqual([f.name for f in files], sorted(f.name for f in (DATA / "species").glob("*.ply")))
        for f in files:
            self.assertEqual(f.read_bytes(), (DATA / "species" / f.name).read_bytes(), f.name)
        self.refuse(USAGE, ["exists", "--force"], "tufts", "-o", self.folder)
        self.assertEqual(run("tufts", "-o", self.folder, "--force").code, DONE)

    def test_young_moss_has_fewer_shoots_and_no_capsules(self):
        done = run("tufts", "-o", self.folder, "--species", "sphagnum", "--growth", "0.5")
        self.assertEqual(done.code, DONE, done)
        files = list(self.folder.glob("sphagnum*.ply"))
        self.assertEqual(len(files), 9)
        young = (self.folder / "sphagnum_0_lod0.ply").stat().st_size
        run("tufts", "-o", self.folder, "--species", "sphagnum", "--force")
        self.assertEqual(len(list(self.folder.glob("sphagnum*capsules*.ply"))), 9)
        self.assertLess(young, 0.6 * (self.folder / "sphagnum_0_lod0.ply").stat().st_size)

    def test_mistakes_are_named(self):
        self.refuse(USAGE, ["--output"], "tufts")
        self.refuse(USAGE, ["folder"], "tufts", "-o", self.folder / "none")
        self.refuse(USAGE, ["--growth -1"], "tufts", "-o", self.folder, "--growth", "-1")
        self.refuse(USAGE, ["nan"], "tufts", "-o", self.folder, "--growth", "nan")
        self.refuse(USAGE, ["../x"], "tufts", "-o", self.folder, "--species", "../x")


if __name__ == "__main__":
    unittest.main()
