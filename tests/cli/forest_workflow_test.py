"""The Snakemake workflow of many forests: two small ones, once, again, and after a change."""

import csv
import os
import shutil
import subprocess
import unittest

from support import DATA, PROGRAM, CliTest, environment

WORKFLOW = DATA / "workflows" / "forest-stands" / "Snakefile"


@unittest.skipIf(not shutil.which("snakemake") and not os.environ.get("CI"), "snakemake is not installed")
class Workflow(CliTest):
    def snakemake(self, **config):
        """Runs the workflow; what it said."""
        settings = {"sekitei": PROGRAM, "out": "out", "seeds": "[1]", "densities": "[0.5,1]", "size": "64m", "initial": "20", "steps": "4",
                    "options": "--ages 6 --variants 1", **config}
        done = subprocess.run(["snakemake", "-s", str(WORKFLOW), "-j2", "--config", *(f"{k}={v}" for k, v in settings.items())],
                              cwd=self.folder, env=environment(HOME=str(self.folder), XDG_CACHE_HOME=str(self.folder / "cache")),
                              capture_output=True, text=True, timeout=300)
        self.assertEqual(done.returncode, 0, done.stdout[-3000:] + done.stderr[-3000:])
        return done.stdout + done.stderr

    def results(self):
        return {p.relative_to(self.folder): p.stat().st_mtime_ns for p in sorted((self.folder / "out").rglob("*")) if p.is_file()}

    def table(self):
        with open(self.folder / "out/stands.csv", newline="") as file:
            return list(csv.DictReader(file))

    def test_forests_are_grown_once_and_joined(self):
        self.snakemake()
        names = {str(p) for p in self.results()}
        self.assertEqual(names, {"out/stands.csv", "out/sheet.png", "out/trees.png", "out/tall.png",
                                 *(f"out/stands/density{d}_seed1.{kind}" for d in ("0.5", "1") for kind in ("vdb", "csv"))})
        rows = self.table()
        self.assertEqual([(r["density"], r["seed"], r["step"]) for r in rows], [(d, "1", str(n)) for d in ("0.5", "1") for n in range(1, 5)])
        self.assertNotEqual(rows[3]["trees"], rows[7]["trees"])
        # What a job grew is what the program grows.
        self.succeed("forest", "--size", "64m", "--initial", "20", "--steps", "4", "--ages", "6", "--variants", "1", "--density", "0.5",
                     "--seed", "1", "--no-canopy", "-o", "own.vdb", "-q")
        self.assertSameBytes(self.folder / "own.vdb", self.folder / "out/stands/density0.5_seed1.vdb")
        # A second run does nothing; another seed is grown beside.
        before = self.results()
        self.assertIn("Nothing to be done", self.snakemake())
        self.assertEqual(before, self.results())
        self.snakemake(seeds="[1,2]")
        after = self.results()
        kept = [p for p in before if p.parent.name == "stands"]
        self.assertEqual([before[p] for p in kept], [after[p] for p in kept])
        self.assertEqual(len(self.table()), 16)


if __name__ == "__main__":
    unittest.main()
