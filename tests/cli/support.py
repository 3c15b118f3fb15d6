"""What the tests of the program share: running it under limits, small scenes, broken files.

The program's path is in SEKITEI, the data folder in SEKITEI_DATA; ctest sets both.
"""

import contextlib
import datetime
import json
import os
import resource
import shutil
import signal
import subprocess
import tempfile
import threading
import time
import unittest
from pathlib import Path

PROGRAM = Path(os.environ.get("SEKITEI", "build/sekitei")).absolute()
DATA = Path(os.environ.get("SEKITEI_DATA", "data")).absolute()
SOURCE = DATA.parent
# The library of the test build that makes calls of the program fail.
FAULTS = Path(os.environ.get("SEKITEI_FAULTS", "build/fault_shim.so")).absolute()

# Programs with sanitizers in them are slower and larger, and reserve terabytes: limits of memory would end every one.
SANITIZED = "SEKITEI_SANITIZED" in os.environ
SLOWER, LARGER = (10, 4) if SANITIZED else (1, 1)

# Exit codes of core/error.h.
DONE, BUG, USAGE, BAD_INPUT, CANNOT_WRITE, LIMIT, DIFFER = range(7)
INTERRUPTED, TERMINATED = 130, 143

ROCK = ["lava", "cool", "joint", "weather", "mesh"]
HABITAT = ["lantern", "light", "wind", "soil", "moss"]
TREES = ["tree", "sketch"]
FOREST = ["forest", "distribution"]
STAGES = [*ROCK, "garden", *HABITAT, *TREES, *FOREST, "render", "statistics", "plot", "compare", "export"]
TOOLS = ["run", "check", "info", "replay", "diff", "explain", "verify", "view", "schema", "specimens", "tufts", "completions"]
# Values of parameters that a stage cannot do without, as in recipes; spring_weather() makes the file.
REQUIRED = {"light": {"weather": "days.csv"}}

# A body of 40 x 40 x 40 voxels on 10 x 10 x 10 heat cells: every stage takes a fraction of a second.
LAVA = ["--preset", "slab", "--size", "1.6m,1.6m,1.6m", "--voxel", "4cm", "--heat-cell", "16cm", "--noise-amplitude", "0"]
COOL = ["--steps", "40"]
JOINT = ["--spacing", "40cm"]
WEATHER = ["--cut", "perpendicular"]
RENDER = ["--width", "64", "--height", "48", "--samples", "2", "--bounces", "1"]

RECIPE = """\
sekitei = 1
seed = 7
out = "out"

[lava]
preset = "slab"
size = ["1.6m", "1.6m", "1.6m"]
voxel = "4cm"
heat_cell = "16cm"
noise_amplitude = 0

[cool]
steps = 40

[joint]
spacing = "40cm"

[weather]
cut = "perpendicular"
write = "rock.vdb"

[rock]
stage = "mesh"
write = ["rock.ply", "rock.obj"]

[picture]
stage = "render"
from = "rock"
width = 64
height = 48
samples = 2
bounces = 1
write = "rock.png"
"""


@contextlib.contextmanager
def small_disk(folder, options):
    """A file system of its own on `folder`; skips the test where mounting is not allowed."""
    folder.mkdir(exist_ok=True)
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True)
    if mounted.returncode != 0:
        raise unittest.SkipTest("needs the right to mount a tmpfs")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def spring_weather(days=70):
    """A CSV of a mild, moist spring with every wind, rain each third day."""
    lines = ["# latitude = 40 deg", "# longitude = 141 deg",
             "date,temperature [C],humidity [%],precipitation [mm],wind_speed [m/s],wind_direction [deg],sunshine [h]"]
    for d in range(days):
        date = datetime.date(2021, 5, 1) + datetime.timedelta(d)
        lines.append(f"{date},{14 + d % 9 / 2},{85 + d % 7},{0 if d % 3 else 12},{1.5 + d % 4},{45 * d % 360},{3 + d % 4}")
    return "\n".join(lines) + "\n"


def tables_before(stage):
    """The text of a recipe up to the table of `stage`, whose own keys may follow."""
    chain = ROCK if stage in (*ROCK, "render") else TREES if stage in TREES else FOREST if stage in FOREST else HABITAT
    names = chain[:chain.index(stage)] if stage in chain else chain
    return "".join(f"[{name}]\n" + "".join(f'{k} = "{v}"\n' for k, v in REQUIRED.get(name, {}).items()) for name in names) + (
        f'[{stage}]\n' + ('from = ["soil", "moss"]\n' if stage == "compare" else ""))


class Finished:
    """A run of the program that has ended."""

    def __init__(self, code, out, err, seconds, peak):
        self.code, self.out, self.err = code, out, err.decode("utf-8", "replace")
        self.seconds, self.peak = seconds, peak  # [s], [bytes]

    def json(self):
        return json.loads(self.out)

    def __str__(self):
        return f"exit {self.code} after {self.seconds:.2f} s, {self.peak / 1e6:.0f} MB\nstderr: {self.err[-2000:]}"


def environment(**changes):
    env = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "LC_ALL", "LANG")}
    env.update(changes)
    return env


def bearable(limits):
    """Those of `limits` that the program can meet; skips the test where it is about one that it cannot."""
    if SANITIZED and any(which == resource.RLIMIT_AS and value < 4 << 30 for which, value in limits):
        raise unittest.SkipTest("sanitizers reserve more memory than the limit that this is about")
    return [(which, value) for which, value in limits if not (SANITIZED and which == resource.RLIMIT_AS)]


def start(arguments, cwd=None, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, env=None, limits=(), program=None):
    """Starts the program; `limits` are pairs of resource.RLIMIT_* and a value."""
    limits = bearable(limits)

    def prepare():
        for which, value in limits:
            resource.setrlimit(which, (value, value))

    return subprocess.Popen([str(program or PROGRAM), *map(str, arguments)], cwd=cwd, stdin=stdin, stdout=stdout,
                            stderr=subprocess.PIPE, env=env or environment(), preexec_fn=prepare)


def run(*arguments, cwd=None, data=None, env=None, limits=(), timeout=120):
    """Runs the program to its end; `data` is what it reads on standard input."""
    limits = bearable(limits)
    with tempfile.TemporaryFile() as given, tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        if data is not None:
            given.write(data)
            given.seek(0)

        def prepare():
            for which, value in limits:
                resource.setrlimit(which, (value, value))

        began = time.monotonic()
        process = subprocess.Popen([str(PROGRAM), *map(str, arguments)], cwd=cwd, stdout=out, stderr=err,
                                   stdin=given if data is not None else subprocess.DEVNULL, env=env or environment(),
                                   preexec_fn=prepare)
        hung = threading.Timer(timeout * SLOWER, process.kill)
        hung.start()
        _, status, usage = os.wait4(process.pid, 0)
        hung.cancel()
        process.returncode = code = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        seconds = (time.monotonic() - began) / SLOWER
        return Finished(code, out.read(), err.read(), seconds, usage.ru_maxrss * 1024 / LARGER)


def lava_with(option, value):
    """The words for the small body of lava with another value of an option."""
    arguments = list(LAVA)
    if option in arguments:
        arguments[arguments.index(option) + 1] = value
    else:
        arguments += [option, value]
    return ["lava", *arguments, "-o", "x.vdb"]


def bash(script, cwd, env=None, timeout=120):
    """Runs a bash script in which $SEKITEI is the program."""
    env = env or environment()
    env["SEKITEI"] = str(PROGRAM)
    done = subprocess.run(["bash", "-c", script], cwd=cwd, env=env, capture_output=True, timeout=timeout * SLOWER)
    return Finished(done.returncode, done.stdout, done.stderr, 0, 0)


def files_in(folder, hidden=False):
    """Content of every file below a folder by relative path; those of .sekitei only if asked for."""
    found = {}
    for path in sorted(Path(folder).rglob("*")):
        name = path.relative_to(folder)
        if path.is_file() and (hidden or not any(part == ".sekitei" for part in name.parts)):
            found[str(name)] = path.read_bytes()
    return found


def temporaries(folder):
    return [str(p) for p in Path(folder).rglob(".*.tmp")]


class CliTest(unittest.TestCase):
    """A test with a folder of its own, in which the program runs unless told otherwise."""

    def setUp(self):
        self.folder = Path(tempfile.mkdtemp(prefix="sekitei-test-"))
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)

    def run_in_folder(self, *arguments, **options):
        options.setdefault("cwd", self.folder)
        return run(*arguments, **options)

    def succeed(self, *arguments, **options):
        """Runs the program, which must exit 0."""
        done = self.run_in_folder(*arguments, **options)
        self.assertEqual(done.code, DONE, f"sekitei {' '.join(map(str, arguments))}\n{done}")
        return done

    def refuse(self, code, words, *arguments, **options):
        """Runs the program, which must say each of `words`, exit with `code` and leave nothing behind.

        A refusal also takes less than 5 s and 1 GB, with a hard limit above that so that a
        runaway reader ends.
        """
        options.setdefault("limits", [(resource.RLIMIT_AS, 6 << 30)])
        options.setdefault("timeout", 20)
        before = {p: p.stat().st_mtime_ns for p in self.folder.rglob("*") if p.is_file()}
        done = self.run_in_folder(*arguments, **options)
        what = f"sekitei {' '.join(map(str, arguments))[:400]}\n{done}"
        self.assertEqual(done.code, code, what)
        for word in [words] if isinstance(words, str) else words:
            self.assertIn(word.lower(), done.err.lower(), what)
        self.assertIn("error:", done.err, what)
        self.assertNotIn("bug in Sekitei", done.err, what)
        self.assertLess(done.seconds, 5, what)
        self.assertLess(done.peak, 1 << 30, what)
        after = {p: p.stat().st_mtime_ns for p in self.folder.rglob("*") if p.is_file()}
        self.assertEqual(before, after, f"files appeared, changed or went away\n{what}")
        return done

    def write(self, name, content):
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    def recipe(self, text=RECIPE, name="rock.toml"):
        return self.write(name, text)

    def assertSameBytes(self, a, b, message=""):
        a, b = (p.read_bytes() if isinstance(p, Path) else p for p in (a, b))
        if a == b:
            return
        at = next((i for i, (x, y) in enumerate(zip(a, b)) if x != y), min(len(a), len(b)))
        self.fail(f"{message}: {len(a)} and {len(b)} bytes, first difference at byte {at}")

    def assertSameFiles(self, a, b, message=""):
        """Two folders as files_in() returns them."""
        self.assertEqual(sorted(a), sorted(b), message)
        for name in a:
            self.assertSameBytes(a[name], b[name], f"{message} {name}")


class SceneTest(CliTest):
    """A test with the scenes of a whole chain, made once for all its methods, in cls.scenes."""

    @classmethod
    def setUpClass(cls):
        cls.scenes = Path(tempfile.mkdtemp(prefix="sekitei-scenes-"))
        cls.addClassCleanup(shutil.rmtree, cls.scenes, ignore_errors=True)
        make_chain(cls.scenes)
        cls.lava, cls.cooled, cls.joints, cls.weathered, cls.mesh, cls.picture = (
            cls.scenes / name for name in ("lava.vdb", "cooled.vdb", "joints.vdb", "weathered.vdb", "rock.ply", "rock.png"))


def chain_commands():
    """The six commands of the small chain, without their outputs."""
    return [("lava", None, "lava.vdb", LAVA), ("cool", "lava.vdb", "cooled.vdb", COOL),
            ("joint", "cooled.vdb", "joints.vdb", JOINT), ("weather", "joints.vdb", "weathered.vdb", WEATHER),
            ("mesh", "weathered.vdb", "rock.ply", []), ("render", "rock.ply", "rock.png", RENDER)]


def make_chain(folder, common=(), cwd=None):
    """Runs the small chain file by file; `common` goes to every command."""
    folder = Path(folder)
    for command, source, target, options in chain_commands():
        done = run(command, *([folder / source] if source else []), "-o", folder / target, "--seed", 7, "-q", *options, *common,
                   cwd=cwd or folder)
        if done.code != 0:
            raise AssertionError(f"sekitei {command}: {done}")


def wait_for(condition, seconds=20):
    """Whether `condition` came true in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.002)
    return False


def stop(process, which=signal.SIGKILL):
    """Sends a signal and waits; (exit code as a shell shows it, seconds until the end, standard error)."""
    began = time.monotonic()
    process.send_signal(which)
    _, err = process.communicate(timeout=60)
    code = process.returncode
    return (128 - code if code < 0 else code), time.monotonic() - began, err.decode("utf-8", "replace")
