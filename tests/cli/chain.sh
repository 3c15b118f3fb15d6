#!/usr/bin/env bash
# The commands as a script would chain them: through files, through pipes, both the same bytes.
set -euo pipefail

sekitei=${SEKITEI:?the path of the program}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

fail() { printf 'chain.sh: %s\n' "$*" >&2; exit 1; }

lava=(--preset slab --size 1.6m,1.6m,1.6m --voxel 4cm --heat-cell 16cm --noise-amplitude 0 --seed 3)
cool=(--steps 40)
joint=(--spacing 40cm --seed 3)
weather=(--cut perpendicular --seed 3)
picture=(--width 64 --height 48 --samples 2 --bounces 1)

# Through files.
mkdir files pipes
"$sekitei" lava "${lava[@]}" -o files/lava.vdb -q
"$sekitei" cool files/lava.vdb "${cool[@]}" -o files/cooled.vdb -q
"$sekitei" joint files/cooled.vdb "${joint[@]}" -o files/joints.vdb -q
"$sekitei" weather files/joints.vdb "${weather[@]}" -o files/rock.vdb -q
"$sekitei" mesh files/rock.vdb -o files/rock.ply -q
"$sekitei" render files/rock.ply "${picture[@]}" -o files/rock.png -q

# Through pipes.
"$sekitei" lava "${lava[@]}" -o - -q |
    "$sekitei" cool - "${cool[@]}" -o - -q |
    "$sekitei" joint - "${joint[@]}" -o - -q |
    "$sekitei" weather - "${weather[@]}" -o pipes/rock.vdb -q
"$sekitei" mesh pipes/rock.vdb -o - -q | tee pipes/rock.ply |
    "$sekitei" render - "${picture[@]}" -o pipes/rock.png -q

for name in rock.vdb rock.ply rock.png; do
    cmp "files/$name" "pipes/$name" || fail "$name differs between files and pipes"
done

# An existing output is kept unless --force is given.
if "$sekitei" mesh files/rock.vdb -o files/rock.ply -q 2>refusal; then fail "replaced a file without --force"; fi
grep -q -- --force refusal || fail "the refusal does not name --force"
"$sekitei" mesh files/rock.vdb -o files/rock.ply -q --force
cmp files/rock.ply pipes/rock.ply || fail "rock.ply changed when it was made again"

# The file tells how to make it again.
"$sekitei" replay files/rock.vdb >again.toml
"$sekitei" run again.toml --set out=again -q
cmp files/rock.vdb again/rock.vdb || fail "replay made another file"
"$sekitei" verify files/rock.vdb again/manifest.json -q
"$sekitei" diff files/rock.vdb again/rock.vdb -q

# A command that fails stops the chain without leaving a file.
if "$sekitei" lava "${lava[@]}" --voxel 0 -o - -q 2>/dev/null | "$sekitei" cool - -o broken.vdb -q 2>/dev/null; then
    fail "a broken chain was reported as good"
fi
[ ! -e broken.vdb ] || fail "a broken chain left a file"
[ -z "$(find . -name '.*.tmp')" ] || fail "temporary files were left"
