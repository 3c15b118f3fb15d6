"""The installed product: another project builds against it, the program runs from anywhere, packages hold what they should.

ctest sets SEKITEI_BUILD (the build folder), SEKITEI_SOURCE, SEKITEI_VERSION; a first argument names the class to run.
"""

import gzip
import json
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

BUILD = Path(os.environ.get("SEKITEI_BUILD", "build")).absolute()
SOURCE = Path(os.environ.get("SEKITEI_SOURCE", ".")).absolute()
VERSION = os.environ.get("SEKITEI_VERSION", "0.1.0")
CONSUMER = SOURCE / "tests" / "install" / "consumer"
COMPILER = os.environ.get("SEKITEI_CXX", "c++")


def run(*words, ok=True, **more):
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, timeout=500, **more)
    if ok and done.returncode != 0:
        raise AssertionError(f"{' '.join(map(str, words))}: exit {done.returncode}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return done


def contents(folder):
    """Every file below with its size and time: what a program that writes there would change."""
    return {str(p.relative_to(folder)): (p.lstat().st_size, p.lstat().st_mtime_ns) for p in sorted(folder.rglob("*")) if not p.is_dir()}


def need(*tools):
    """Tests of the label oracle are skipped where a program is missing, but not by ./run oracle, which installs all."""
    missing = [tool for tool in tools if not shutil.which(tool)]
    if missing and os.environ.get("SEKITEI_ORACLE") == "required":
        raise AssertionError(f"missing: {', '.join(missing)}; see packages_oracle in ./run")
    if missing:
        raise unittest.SkipTest(f"missing: {', '.join(missing)}")


class WithFolder(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = Path(tempfile.mkdtemp(prefix="sekitei-install-"))

    @classmethod
    def tearDownClass(cls):
        for path in [cls.folder, *cls.folder.rglob("*")]:
            if path.is_dir() and not path.is_symlink():
                path.chmod(0o755)
        shutil.rmtree(cls.folder)


class Installation(WithFolder):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        first = cls.folder / "first" / "prefix"
        run("cmake", "--install", BUILD, "--prefix", first)
        # Nothing may remember where it was installed to.
        cls.prefix = cls.folder / "moved here"
        first.rename(cls.prefix)
        cls.program = cls.prefix / "bin" / "sekitei"
        cls.data = cls.prefix / "share" / "sekitei"

    def test_a_project_finds_builds_and_runs_with_the_libraries(self):
        build = self.folder / "consumer"
        flags = os.environ.get("SEKITEI_SANITIZE", "")
        extra = [f"-DCMAKE_CXX_FLAGS=-fsanitize={flags}"] if flags else []
        run("cmake", "-G", "Ninja", "-S", CONSUMER, "-B", build, f"-DCMAKE_PREFIX_PATH={self.prefix}", f"-DCMAKE_CXX_COMPILER={COMPILER}",
            "-DCMAKE_BUILD_TYPE=Debug", *extra)
        run("cmake", "--build", build)
        out = self.folder / "out"
        out.mkdir()
        done = run(build / "lava_block", out)
        self.assertRegex(done.stdout, r"refused: .*alpha = 1")
        self.assertRegex(done.stdout, r"40 steps, \d{4,} triangles, temperature [0-9a-f]{32}")
        # The installed program reads what the libraries wrote.
        told = json.loads(run(self.program, "info", "--json", out / "block.vdb").stdout)
        self.assertEqual({g["name"] for g in told[0]["grids"]}, {"body_sdf", "temperature"})
        self.assertEqual(Path((build / "data_folder.txt").read_text()), self.data)
        # Nothing of the build or the source was used.
        commands = re.sub(re.escape(str(CONSUMER)), "", (build / "build.ninja").read_text())
        for tree in (BUILD, SOURCE):
            self.assertNotIn(str(tree) + "/", commands)

    def test_another_minor_version_is_not_taken(self):
        folder = self.folder / "too-new"
        folder.mkdir()
        (folder / "CMakeLists.txt").write_text("cmake_minimum_required(VERSION 3.25)\nproject(x LANGUAGES CXX)\nfind_package(Sekitei 0.99 REQUIRED)\n")
        done = run("cmake", "-G", "Ninja", "-S", folder, "-B", folder / "b", f"-DCMAKE_PREFIX_PATH={self.prefix}", ok=False)
        self.assertNotEqual(done.returncode, 0)
        self.assertIn(VERSION, done.stderr)

    def test_a_recipe_runs_from_the_installed_folder_and_writes_where_the_user_is(self):
        here = self.folder / "user"
        here.mkdir()
        before = contents(self.prefix)
        for folder in [self.data, *self.data.rglob("*")]:
            folder.chmod(folder.stat().st_mode & ~0o222)
        recipe = self.data / "recipes" / "laccolith.toml"  # its mesh is ../meshes/laccolith.obj
        settings = ["--set", "lava.voxel=25cm", "--set", "picture.width=64", "--set", "picture.height=48", "--set", "picture.samples=1"]
        run(self.program, "run", recipe, *settings, cwd=here)
        self.assertTrue((here / "out" / "laccolith" / "manifest.json").exists())
        run(self.program, "verify", "out/laccolith/manifest.json", cwd=here)
        run(self.program, "check", *sorted((self.data / "recipes").glob("*.toml")), cwd=here)
        self.assertEqual(contents(self.prefix), before, "the installation was written to")

    def test_man_pages_and_completions_lie_where_they_are_looked_for(self):
        share = self.prefix / "share"
        pages = {p.name for p in (share / "man" / "man1").iterdir()}
        for command in re.findall(r"^  ([a-z]+)  ", run(self.program, "--help").stdout, re.M):
            self.assertIn(f"sekitei-{command}.1.gz", pages)
        self.assertIn("sekitei.1.gz", pages)
        text = gzip.decompress((share / "man" / "man1" / "sekitei-joint.1.gz").read_bytes()).decode()
        self.assertIn("spacing", text)
        self.assertTrue((share / "man" / "man7" / "sekitei-scene.7.gz").exists())
        for path, word in (("bash-completion/completions/sekitei", "complete -o filenames -F _sekitei sekitei"),
                           ("zsh/site-functions/_sekitei", "#compdef sekitei"), ("fish/vendor_completions.d/sekitei.fish", "complete -c sekitei")):
            self.assertIn(word, (share / path).read_text())

    def test_documentation_and_licence_are_there_and_links_lead_on(self):
        pages = self.prefix / "share" / "doc" / "sekitei"
        for page in ("README.md", "docs/reference.md", "CHANGELOG.md", "solvers/joints/README.md", "data/recipes/cliff.toml"):
            self.assertTrue((pages / page).exists(), page)
        self.assertTrue((self.data / "LICENSE").read_text().lstrip().startswith("Apache License"))


class Packages(WithFolder):
    """What `cpack -G DEB` makes."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        need("dpkg-deb", "dpkg-shlibdeps")
        run("cpack", "-G", "DEB", "--config", BUILD / "CPackConfig.cmake", "-B", cls.folder)
        cls.architecture = run("dpkg", "--print-architecture").stdout.strip()
        cls.packages = {"sekitei": cls.architecture, "libsekitei-dev": cls.architecture, "sekitei-doc": "all"}

    def file(self, name):
        return self.folder / f"{name}_{VERSION}_{self.packages[name]}.deb"

    def field(self, name, field):
        return run("dpkg-deb", "-f", self.file(name), field).stdout.strip()

    def test_each_says_what_it_is_and_depends_on(self):
        for name in self.packages:
            self.assertEqual(self.field(name, "Version"), VERSION)
            self.assertRegex(self.field(name, "Maintainer"), r"^[^<]+ <[^ @]+@[^ @]+>$")
            self.assertGreater(len(self.field(name, "Description").splitlines()), 2)
        depends = self.field("sekitei", "Depends")
        for library in ("libopenvdb10.0", "libembree3-3", "libtbb12", "libopenmeshcore9.0|libopenmesh9.0|libopenmesh", "libfmt9", "libc6", "libstdc++6", "libpng16-16"):
            self.assertRegex(depends, "|".join(re.escape(one) for one in library.split("|")))
        self.assertIn(f"sekitei (= {VERSION})", self.field("libsekitei-dev", "Depends"))
        self.assertIn("libopenvdb-dev", self.field("libsekitei-dev", "Depends"))

    def test_the_program_runs_from_an_unpacked_package(self):
        root = self.folder / "root"
        for name in self.packages:
            run("dpkg-deb", "-x", self.file(name), root)
        program = root / "usr" / "bin" / "sekitei"
        self.assertEqual(run(program, "--version").stdout.strip(), f"sekitei {VERSION}")
        run(program, "check", root / "usr" / "share" / "sekitei" / "recipes" / "cliff.toml")
        for path in ("usr/share/man/man1/sekitei.1.gz", "usr/include/sekitei/core/mesh.h", "usr/share/doc/sekitei/docs/reference.md",
                     "usr/share/doc/sekitei/data/recipes/cliff.toml"):
            self.assertTrue((root / path).exists(), path)
        self.assertTrue(list((root / "usr" / "lib").rglob("SekiteiConfig.cmake")))
        for name in self.packages:
            folder = root / "usr" / "share" / "doc" / name
            self.assertIn("Apache-2.0", (folder / "copyright").read_text())
            self.assertIn(f"({VERSION})", gzip.decompress((folder / "changelog.gz").read_bytes()).decode())
        for path in root.rglob("*"):
            mode = stat.S_IMODE(path.lstat().st_mode)
            if not path.is_symlink():
                self.assertIn(mode, (0o755, 0o644), path)

    def test_lintian_finds_no_error(self):
        need("lintian")
        done = run("lintian", "--allow-root", "--fail-on", "error", "--no-tag-display-limit", *map(self.file, self.packages), ok=False)
        self.assertEqual([line for line in done.stdout.splitlines() if line.startswith("E:")], [], done.stdout)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


class Pages(WithFolder):
    """Man pages and completions in the hands of the programs that read them."""

    PROGRAM = Path(os.environ.get("SEKITEI", BUILD / "sekitei"))

    def test_man_pages_are_without_fault(self):
        need("mandoc", "groff")
        run(self.PROGRAM, "schema", "--man", "-o", self.folder)
        pages = sorted(self.folder.glob("*.[17]"))
        self.assertGreater(len(pages), 25)
        said = run("mandoc", "-T", "lint", "-W", "warning", *pages, ok=False).stdout
        # Pages have no date, so that equal programs write equal pages.
        self.assertEqual([line for line in said.splitlines() if "missing date" not in line], [])
        for page in pages:
            shown = run("groff", "-man", "-Tutf8", "-ww", "-z", page)
            self.assertEqual(shown.stderr, "", page)
        # No option is lost on the way.
        for command in ("lava", "moss", "run", "schema"):
            shown = run("mandoc", "-T", "ascii", self.folder / f"sekitei-{command}.1").stdout
            shown = re.sub(r".\x08", "", shown)
            for option in set(re.findall(r"--[a-z][a-z-]+", run(self.PROGRAM, command, "--help").stdout)):
                self.assertIn(option, shown, command)

    def test_fish_completes(self):
        need("fish")
        script = self.folder / "sekitei.fish"
        script.write_text(run(self.PROGRAM, "completions", "fish").stdout)

        def complete(line):
            done = run("fish", "--no-config", "-c", f"source {script}; complete -C '{line}'", env={**os.environ, "HOME": str(self.folder)})
            return [offer.split("\t")[0] for offer in done.stdout.splitlines()]

        self.assertEqual(complete("sekitei joi"), ["joint"])
        self.assertEqual(complete("sekitei joint --spac"), ["--spacing"])
        self.assertEqual(sorted(complete("sekitei weather --cut ")), ["horizontal", "none", "perpendicular"])
        self.assertIn("fish", complete("sekitei completions "))

    def test_zsh_completes(self):
        need("zsh")
        (self.folder / "_sekitei").write_text(run(self.PROGRAM, "completions", "zsh").stdout)
        (self.folder / "here.vdb").write_text("")
        # compadd tells what a menu would offer.
        script = ("autoload -Uz compinit; fpath=($PWD $fpath); compinit -u -d $PWD/dump; zmodload zsh/zpty\n"
                  "zpty shell zsh -f -i; zpty -w shell \"PS1=; fpath=($PWD \\$fpath); autoload -Uz compinit; compinit -u -d $PWD/dump; cd $PWD\"\n"
                  "zpty -w shell \"zstyle ':completion:*' list-prompt ''; bindkey '^I' complete-word\"\n"
                  "sleep 1; zpty -w -n shell $'sekitei weather here.vdb --cut perp\\t'; sleep 2\n"
                  "zpty -r -m shell text '*perpendicular*' && print -r -- FOUND $text\nzpty -d shell\n")
        done = run("zsh", "-f", "-c", script, cwd=self.folder, env={**os.environ, "TERM": "dumb"})
        self.assertIn("perpendicular", done.stdout)


if __name__ == "__main__":
    unittest.main(argv=[sys.argv[0], *sys.argv[1:]])
