"""One small scene of every command, each a fraction of a second: what hashes_test pins and failure_test breaks.

A new stage or tool that writes files belongs in COMMANDS; then run `hashes_test.py --refresh`.
"""

import shlex

import foreign
from support import spring_weather

# Each reads what those before it made. Tools that only tell something are pinned by what they say.
COMMANDS = [shlex.split(line) for line in """
lava --preset slab --size 1.6m,1.6m,1.6m --voxel 4cm --heat-cell 16cm -o lava.vdb
lava --preset cliff --size 1.2m,0.8m,1m --voxel 5cm -o cliff.vdb
lava --preset height_map --height-map hill.png --metres-per-pixel 0.1 --height-low 0 --height-high 1 --voxel 10cm --heat-cell 20cm -o hill.vdb
lava --preset mesh --mesh slab.ply --voxel 2cm --heat-cell 4cm -o body.vdb
cool lava.vdb --steps 40 -o cooled.vdb
joint cooled.vdb --spacing 40cm -o joints.vdb
weather joints.vdb --cut perpendicular -o weathered.vdb
mesh weathered.vdb -o rock.ply -o rock.obj -o rock.glb -o rock.stl -o rock.off
mesh weathered.vdb -o beside.vdb
render rock.ply --width 64 --height 48 --samples 2 --bounces 1 -o rock.png
render cooled.vdb --slice temperature --width 200 -o heat.png
garden weathered.vdb --size 3m --cell 10cm --lantern 0.5,0.5,30 --pond -0.6,-0.6,1,0.8,0 --stones 0,0,0.1,20,0.5 -o garden.vdb
lantern --layout pond --cell 5cm -o lantern.vdb
light lantern.vdb --weather days.csv -o light.vdb
wind light.vdb --garden-spacing 1m --object-spacing 20cm --settle 0 --duration 0.3 -o wind.vdb
soil wind.vdb -o soil.vdb
moss soil.vdb --every 10d --checkpoint moss.state -o moss.vdb
moss soil.vdb --days 10 --species bryum -o alone.vdb
light slab.ply --site 10cm --photons 4k --debug-photons photons.ply -o slab_light.vdb
moss slab_light.vdb --days 6 --site 10cm --photons 2k --open-light 25 --initial-count 20 --soil humus --points plants.ply -o slab_moss.vdb
render slab_moss.vdb --width 64 --height 48 --samples 2 --bounces 1 -o plants.png
statistics moss.vdb -o moss.csv
plot moss.vdb --width 300 --height 200 -o cover.png
compare alone.vdb moss.vdb -o table.csv
export moss.vdb -o moss.ply
export moss.vdb --metres-per-pixel 20cm --to moss.glb --to plants.csv --to moss.obj --to moss.png
explain moss.vdb --at 0,20cm,0.3 --json
tree --generations 10 --species beech --skeleton skeleton.json --mesh bark.ply -o tree.vdb
tree --generations 6 --wood --wood-voxel 10cm -o wood.vdb
sketch tree.vdb wood.vdb --size 100 -o sketch.png
forest --size 96m --initial 30 --ages 6 --variants 1 --steps 6 --every 3 --instances trees.csv -o forest.vdb
export forest.vdb --to forest.glb --to forest.usda
forest --size 96m --initial 30 --ages 6 --variants 1 --steps 3 --no-canopy --out-of-core rows -o rows.vdb
distribution forest.vdb --px 128 -o map.png
specimens --variants 1 --generations 6 --species beech -o specimens
tufts --species bryum -o tufts
run rock.toml
view moss.vdb -o moss.html
view out -o run.html
replay moss.vdb
""".strip().split("\n")]

TELLING = ["explain", "replay"]  # on standard output; they neither take --force nor write
# What writes nothing, or words about files and the program alone.
UNPINNED = {"check", "info", "diff", "verify", "schema", "completions"}

RECIPE = """\
sekitei = 1
seed = 7
out = "out"

[lava]
preset = "cliff"
size = ["1.2m", "0.8m", "1m"]
voxel = "5cm"

[cool]

[joint]
spacing = "30cm"

[weather]
cut = "perpendicular"
write = "kept.vdb"

[rock]
stage = "mesh"
write = ["kept.ply", "kept.glb"]

[picture]
stage = "render"
width = 48
height = 48
samples = 1
write = "kept.png"
"""


def make_inputs(folder):
    """What the commands read that no command makes."""
    (folder / "days.csv").write_text(spring_weather(20))
    (folder / "slab.ply").write_bytes(foreign.ply(*foreign.box((0, 0, -0.2), (0.6, 0.4, 0)), "binary_little_endian"))
    (folder / "hill.png").write_bytes(foreign.png(16, 16, lambda x, y: 20000 + 1000 * x))
    (folder / "rock.toml").write_text(RECIPE)
    for name in ("rows", "specimens", "tufts"):
        (folder / name).mkdir()


def words(command, *more):
    """The words of a call that replaces what is there."""
    return [*command, *([] if command[0] in TELLING else ["--force", "-q"]), *more]
