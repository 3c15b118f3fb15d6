"""F3D, a viewer built on VTK, draws our meshes: not empty, and the same thing from every format."""

import re
import subprocess

import numpy
import oracle
from support import SceneTest


class Drawn(SceneTest):
    def drawn(self, path, up):
        """(picture, what F3D tells) from a corner above."""
        picture = self.folder / (path.name + ".png")
        done = subprocess.run(["xvfb-run", "-a", "f3d", "--dry-run", "--verbose", str(path), f"--output={picture}", "--resolution=400,300",
                               f"--up={up}", "--bg-color=1,0,1", "--camera-azimuth-angle=35", "--camera-elevation-angle=30"],
                              capture_output=True, text=True, timeout=120)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertTrue(picture.is_file(), done.stdout + done.stderr)
        return oracle.shows_something(self, picture, colours=4, spread=0.03), done.stdout

    def test_every_format_shows_the_same_rock(self):
        names = [f"rock.{kind}" for kind in ("ply", "obj", "stl", "glb")]
        self.succeed("mesh", self.weathered, *(word for name in names for word in ("-o", name)))
        exported = [f"scene.{kind}" for kind in ("ply", "obj", "glb")]
        self.succeed("export", self.weathered, *(word for name in exported for word in ("--to", name)))
        shapes = {}
        for name in names + exported:
            image, _ = self.drawn(self.folder / name, "+Y" if name.endswith("glb") else "+Z")
            shapes[name] = numpy.abs(image - image[0, 0]).max(2) > 0.1
        whole = shapes["rock.ply"]
        self.assertTrue(0.08 < whole.mean() < 0.8, f"the rock covers {whole.mean():.2f} of the picture")
        self.assertFalse(whole[:5].any() or whole[-5:].any() or whole[:, :5].any() or whole[:, -5:].any(), "all of it is seen")
        for name, shape in shapes.items():
            self.assertLess((shape != whole).mean(), 0.01, f"{name} has another outline than rock.ply")

    def test_it_counts_and_ranges_what_info_tells(self):
        self.succeed("mesh", self.weathered, "-o", "rock.ply", "-o", "rock.glb")
        told = self.succeed("info", "rock.ply", "--json").json()[0]
        row = numpy.dtype([("sides", "u1"), ("corners", "<i4", 3), ("column", "<i4"), ("component", "<i4"), ("surface", "<i4")])
        faces = numpy.frombuffer((self.folder / "rock.ply").read_bytes()[-row.itemsize * told["triangles"]:], row)
        self.assertTrue((faces["sides"] == 3).all())
        ranges = {name: [int(faces[name].min()), int(faces[name].max())] for name in ("column", "component", "surface")}
        for name, up in (("rock.ply", "+Z"), ("rock.glb", "+Y")):
            _, words = self.drawn(self.folder / name, up)
            self.assertEqual(int(re.search(r"Number of polygons: (\d+)", words)[1]), told["triangles"], words)
            if name == "rock.ply":
                self.assertEqual(int(re.search(r"Number of points: (\d+)", words)[1]), told["vertices"], words)
                continue
            found = {k: [float(low), float(high)] for k, low, high in re.findall(r"(_\w+) : float : \[(\S+), (\S+)\]", words)}
            for ours, theirs in (("column", "_COLUMN_ID"), ("component", "_COMPONENT"), ("surface", "_SURFACE")):
                self.assertEqual(found[theirs], ranges[ours], words)


if __name__ == "__main__":
    oracle.main("f3d", "xvfb-run")
