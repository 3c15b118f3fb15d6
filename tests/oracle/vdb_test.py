"""OpenVDB's own tools see in our scenes what `sekitei info` tells, voxel for voxel."""

import json
import math
import re
import subprocess
import unittest

import foreign
import oracle
from foreign import pyopenvdb
from habitat_test import HabitatTest
from support import SceneTest

# pyopenvdb as Debian builds it knows these value types only.
KNOWN = {"float", "bool", "vec3s"}


def printed(test, path):
    """What vdb_print -l tells of each grid: type, class, voxels, box and transform."""
    done = subprocess.run(["vdb_print", "-l", str(path)], capture_output=True, text=True, timeout=60)
    test.assertEqual(done.returncode, 0, done.stderr)
    found = {}
    for block in re.split(r"^Name: ", done.stdout, flags=re.M)[1:]:
        def value(pattern):
            match = re.search(pattern, block)
            return match and match.groups()
        box = value(r"Bounding box of active voxels: \[(.*?)\] -> \[(.*?)\]")
        rows = re.findall(r"^ +\[(.*?)\] *$", block.split("index to world:")[1], flags=re.M)
        found[block.split("\n", 1)[0]] = {
            "type": value(r"Type: Tree_(\w+?)_5_4_3")[0],
            "class": value(r"class: (.*)")[0],
            "voxels": int(value(r"Number of active voxels: +([\d,]+)")[0].replace(",", "")),
            "box": [[int(x) for x in side.split(",")] for side in box] if box else None,
            "matrix": [[float(x) for x in row.split(",")] for row in rows],
            "unit": (value(r"sekitei:unit: (.*)") or [""])[0],
            "points": int((value(r"sekitei:points: (\d+)") or [0])[0])}
    return found


class Printed(HabitatTest, SceneTest):
    """vdb_print on the scenes of a rock and of a habitat."""

    @classmethod
    def setUpClass(cls):
        HabitatTest.setUpClass.__func__(cls)
        habitat = [cls.light, cls.soil, cls.moss]
        SceneTest.setUpClass.__func__(cls)
        cls.all_scenes = [cls.lava, cls.cooled, cls.joints, cls.weathered, *habitat]

    def test_names_types_classes_and_boxes_are_those_info_tells(self):
        for path in self.all_scenes:
            told = {g["name"]: g for g in self.info(path)["grids"]}
            found = printed(self, path)
            self.assertEqual(sorted(found), sorted(told), path.name)
            for name, g in told.items():
                with self.subTest(file=path.name, grid=name):
                    f = found[name]
                    if g["points"]:
                        self.assertEqual(f["type"], "ptdataidx32")
                        self.assertEqual(f["points"], g["active_voxels"])
                        continue
                    self.assertEqual((f["type"], f["class"], f["voxels"], f["unit"]),
                                     (g["type"], g["class"], g["active_voxels"], g["unit"]))
                    voxel, offset = f["matrix"][0][0], f["matrix"][3][:3]
                    self.assertEqual([row[:3] for row in f["matrix"][:3]], [[voxel if i == k else 0 for k in range(3)] for i in range(3)])
                    self.assertAlmostEqual(voxel, g["voxel_m"], places=5)
                    for axis in range(3):
                        self.assertAlmostEqual((f["box"][0][axis] - 0.5) * voxel + offset[axis], g["bounds_m"][0][axis], places=3)
                        self.assertAlmostEqual((f["box"][1][axis] + 0.5) * voxel + offset[axis], g["bounds_m"][1][axis], places=3)

    def test_metadata_say_what_made_the_file(self):
        metadata = subprocess.run(["vdb_print", "-l", "-m", str(self.moss)], capture_output=True, text=True, timeout=60).stdout
        self.assertRegex(metadata, r"creator: Sekitei \d")
        history = json.loads(re.search(r"sekitei:history: (\[.*\])", metadata)[1])
        self.assertEqual([entry["stage"] for entry in history], ["lantern", "light", "wind", "soil", "moss"])


class Values(HabitatTest):
    """python3-openvdb on a habitat: values, not only names."""

    def grids(self, path):
        return [g for g in self.info(path)["grids"] if g["type"] in KNOWN and not g["points"]]

    def differing(self, copy):
        """Names of the grids in which the scene and a copy differ."""
        lines = self.run_in_folder("diff", self.moss, copy, "--json").json()["differences"]
        return {name for line in lines for name in re.findall(r"'(\w+)'", line)}

    def test_a_copy_that_pyopenvdb_writes_has_the_same_values(self):
        told = self.grids(self.moss)
        self.assertGreater(len(told), 20)
        grids = [pyopenvdb.read(str(self.moss), g["name"]) for g in told]
        copy = foreign.write(self.folder / "copy.vdb", *grids)
        found = {g["name"]: g for g in self.info(copy)["grids"]}
        for g in told:
            self.assertEqual((found[g["name"]]["type"], found[g["name"]]["class"], found[g["name"]]["active_voxels"]),
                             (g["type"], g["class"], g["active_voxels"]))
        self.assertEqual(self.differing(copy) & {g["name"] for g in told}, set())
        # One voxel moved by a thousandth is a difference: equality above means something.
        accessor = grids[[g["name"] for g in told].index("light_S")].getAccessor()
        at, value = next((i.min, i.value) for i in pyopenvdb.read(str(self.moss), "light_S").citerOnValues())
        accessor.setValueOn(at, value + 1e-3)
        foreign.write(copy, *grids)
        self.assertIn("light_S", self.differing(copy))

    def test_values_at_a_cell_are_those_explain_tells(self):
        normals = pyopenvdb.read(str(self.moss), "surf_normal")
        cells = [i.min for i in normals.citerOnValues()]
        for cell in cells[::len(cells) // 7]:
            centre = normals.transform.indexToWorld(cell)
            told = self.succeed("explain", self.moss, "--at", ",".join(f"{x:.6f}" for x in centre), "--json").json()
            for axis in range(3):
                self.assertAlmostEqual(told["cell_m"][axis], centre[axis], places=6)
            names = {g["name"]: g for g in self.grids(self.moss)}
            seen = 0
            for name in names.keys() & told.keys():
                value = pyopenvdb.read(str(self.moss), name).getConstAccessor().getValue(cell)
                self.assertEqual(value, told[name], f"{name} at {cell}")
                seen += 1
            self.assertGreater(seen, 10)
            self.assertEqual(list(normals.getConstAccessor().getValue(cell)), told["normal"])

    def test_metadata_class_and_transform(self):
        for g in self.grids(self.moss):
            grid = pyopenvdb.read(str(self.moss), g["name"])
            self.assertEqual(grid.gridClass, g["class"])
            self.assertEqual(grid.metadata.get("sekitei:unit", ""), g["unit"])
            self.assertEqual(grid["sekitei:hash"], g["hash"])
            self.assertEqual(grid.metadata["file_voxel_count"], g["active_voxels"])
            self.assertAlmostEqual(grid.transform.voxelSize()[0], g["voxel_m"])
        self.assertIn("Sekitei", pyopenvdb.readMetadata(str(self.moss))["creator"])

    def test_the_surface_is_a_level_set(self):
        sdf = pyopenvdb.read(str(self.moss), "surface_sdf")
        self.assertEqual(sdf.gridClass, pyopenvdb.GridClass.LEVEL_SET)
        low, high = sdf.evalMinMax()
        self.assertTrue(low < 0 < high)
        # Distances grow by at most the way walked.
        accessor, voxel = sdf.getConstAccessor(), sdf.transform.voxelSize()[0]
        for i, x in enumerate(sdf.citerOnValues()):
            if i % 97 or x.count > 1:
                continue
            a, b, c = x.min
            self.assertLessEqual(abs(accessor.getValue((a + 1, b, c)) - x.value), 1.75 * voxel)


class Rock(SceneTest):
    """python3-openvdb on the scenes of a rock."""

    def test_pyopenvdb_reads_the_values(self):
        temperature = pyopenvdb.read(str(self.cooled), "temperature")
        low, high = temperature.evalMinMax()
        self.assertGreaterEqual(low, 200 - 1e-3)
        self.assertLessEqual(high, 2000 + 1e-3)
        self.assertGreater(high, low)
        gradient = pyopenvdb.read(str(self.cooled), "temperature_gradient")
        lengths = [math.sqrt(sum(x * x for x in i.value)) for i in gradient.citerOnValues()]
        self.assertTrue(lengths)
        for length in lengths:
            self.assertAlmostEqual(length, 1, places=5)
        density = pyopenvdb.read(str(self.weathered), "density")
        self.assertEqual(density.gridClass, "fog volume")
        low, high = density.evalMinMax()
        self.assertGreater(low, 0)
        self.assertLessEqual(high, 1)


if __name__ == "__main__":
    oracle.main("vdb_print")
