"""The same bytes everywhere: one small scene of every command, its content pinned in hashes.json.

`SEKITEI=build/sekitei python3 tests/cli/hashes_test.py --refresh` pins what the program makes now; a change of hashes.json
says which results a change of the program moves. The pins hold for every compiler, build type and processor.
"""

import hashlib
import json
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest
import zlib
from pathlib import Path

from catalogue import COMMANDS, TELLING, UNPINNED, make_inputs, words
from support import DONE, FAULTS, PROGRAM, STAGES, TOOLS, CliTest, environment, files_in, run

PINS = Path(__file__).with_name("hashes.json")


def short(data):
    return hashlib.sha256(data).hexdigest()[:16]


def png_content(data):
    """Header and pixels, however they are packed."""
    at, kept, packed = 8, b"", b""
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + length]
        kept += body if kind == b"IHDR" else b""
        packed += body if kind == b"IDAT" else b""
        at += 12 + length
    return kept + zlib.decompress(packed)


class Made:
    """Everything that the commands make in a folder."""

    def __init__(self, folder, options=(), env=None, wrap=()):
        folder.mkdir(parents=True)
        make_inputs(folder)
        given = set(files_in(folder))
        self.told, self.maker = {}, {}
        for command in COMMANDS:
            before = set(files_in(folder))
            done = subprocess.run([*wrap, str(PROGRAM), *words(command, *options)], cwd=folder, env=env or environment(),
                                  stdin=subprocess.DEVNULL, capture_output=True)
            if done.returncode != DONE:
                raise AssertionError(f"sekitei {' '.join(command)}: exit {done.returncode}\n{done.stderr.decode()[-2000:]}")
            if command[0] in TELLING:
                self.told[f"{command[0]}.txt"] = done.stdout
                self.maker[f"{command[0]}.txt"] = command
            for name in set(files_in(folder)) - before:
                self.maker[name] = command
        self.files = {n: c for n, c in files_in(folder).items() if n not in given and not n.endswith("lock")} | self.told
        self.folder = folder

    def content(self):
        """Hashes of what matters: values of grids, pixels; of anything else the bytes."""
        found = {}
        for name, data in sorted(self.files.items()):
            if name.endswith(".vdb"):
                told = json.loads(run("info", name, "--json", cwd=self.folder).out)
                found[name] = {g["name"]: g["hash"] for g in told[0]["grids"]}
            elif name.endswith(".png"):
                found[name] = short(png_content(data))
            elif not name.endswith(("manifest.json", ".html")):  # of the version, of the viewer's code
                found[name] = short(data)
        return found


def processor_of_old():
    """What makes Embree and the C library take the code for processors of 2004."""
    words = ",".join(f"-{word}" for word in ("AVX512F", "AVX2", "AVX", "FMA", "FMA4", "BMI2", "ERMS", "SSE4_2", "SSE4_1", "SSSE3"))
    return {"LD_PRELOAD": str(FAULTS), "EMBREE_CONFIG": "isa=sse2", "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={words}"}


class Hashes(CliTest):
    @classmethod
    def setUpClass(cls):
        cls.place = Path(tempfile.mkdtemp(prefix="sekitei-hashes-"))
        cls.addClassCleanup(shutil.rmtree, cls.place, ignore_errors=True)
        cls.made = Made(cls.place / "one", ["--threads", "1"])

    def test_every_command_has_its_scene(self):
        for told in (self.succeed("schema").json()["stages"], STAGES, set(TOOLS) - UNPINNED):
            self.assertEqual(sorted(set(told) - {c[0] for c in COMMANDS}), [], "not in catalogue.py")

    def test_contents_are_those_pinned(self):
        pinned, now = json.loads(PINS.read_text()), self.made.content()
        wrong = []
        for name in sorted({*pinned, *now}):
            was, is_now = pinned.get(name), now.get(name)
            if was != is_now:
                if isinstance(was, dict) and isinstance(is_now, dict):
                    which = sorted(g for g in {*was, *is_now} if was.get(g) != is_now.get(g))
                    name = f"{name} ({', '.join(which)})"
                maker = " ".join(self.made.maker.get(name.split(" ")[0], ["nothing"]))
                wrong.append(f"{name}, made by `{maker}`" + ("" if was else ": not pinned" if is_now else ": gone"))
        self.assertEqual(wrong, [], "other content than in hashes.json; if that is meant, run hashes_test.py --refresh")

    def same(self, what, folder, options=(), env=None, wrap=()):
        """Another pass makes the same bytes, in every file."""
        made = Made(folder, options, env and environment(**env), wrap)
        self.assertEqual(sorted(made.files), sorted(self.made.files), what)
        wrong = [f"{n}, made by `{' '.join(made.maker[n])}`" for n in made.files if made.files[n] != self.made.files[n]]
        self.assertEqual(wrong, [], f"other bytes with {what}")

    def test_two_threads_and_german_numbers_in_another_folder(self):
        locales = self.folder / "locales"
        locales.mkdir()
        made = shutil.which("localedef") and subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(locales / "de_DE.UTF-8")],
                                                            capture_output=True).returncode in (0, 1)
        env = {"LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8", "LOCPATH": str(locales), "TZ": "Asia/Tokyo"}
        if made:  # a comma, or the test shows nothing
            told = subprocess.run(["/usr/bin/python3", "-c", "import locale; locale.setlocale(locale.LC_ALL, ''); print(locale.str(1.5))"],
                                  env=environment(**env), capture_output=True, text=True)
            self.assertEqual(told.stdout, "1,5\n", told.stderr)
        self.same("two threads, another folder and locale", self.folder / "else where/苔", ["--threads", "2"], env)
        if not made:
            self.skipTest("no German locale: localedef needs the package locales")

    def test_three_threads_and_fixed_addresses(self):
        wrap = ["setarch", "-R"]
        if subprocess.run([*wrap, "true"], capture_output=True).returncode != 0:
            wrap = []
        self.same("three threads, addresses not random", self.folder / "three", ["--threads", "3"], wrap=wrap)
        if not wrap:
            self.skipTest("setarch -R is not allowed here")

    def test_eight_threads_and_a_processor_of_old(self):
        self.same("eight threads, the code for another processor", self.folder / "eight", ["--threads", "8"], processor_of_old())


def refresh():
    with tempfile.TemporaryDirectory(prefix="sekitei-hashes-") as place:
        content = Made(Path(place) / "one").content()
    before = json.loads(PINS.read_text()) if PINS.exists() else {}
    PINS.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")
    changed = sorted(n for n in {*before, *content} if before.get(n) != content.get(n))
    print(f"{len(content)} files pinned, {len(changed)} changed: {', '.join(changed)}")


if __name__ == "__main__":
    if "--refresh" in sys.argv:
        refresh()
    else:
        unittest.main()
