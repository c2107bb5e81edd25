#!/bin/sh
# A run on a disk that fills up, and its end once there is space. Needs the right to mount:
#   sudo tests/disk_full.sh target/release/isobar
set -eu
isobar=$(realpath "$1")
scenario=$(realpath "$(dirname "$0")/common/valid.toml")
place=$(mktemp -d)
mount -t tmpfs -o size=1m tmpfs "$place"
trap 'cd /; umount "$place"; rmdir "$place"' EXIT
cd "$place"
if "$isobar" run "$scenario" --cycles 300 --checkpoint-cycles 1 --no-rerun --quiet > said 2>&1; then
    echo "the disk was not full"; exit 1
fi
cat said
grep -q "No space left on device" said && grep -q "isobar resume" said
test ! -e out/valid
mount -o remount,size=64m "$place"
"$isobar" resume out/valid --quiet > said
mkdir elsewhere
"$isobar" run "$scenario" --cycles 300 --no-rerun --quiet --out elsewhere > said
for file in out/valid/*.nc; do cmp "$file" "elsewhere/valid/$(basename "$file")"; done
echo "the run was resumed, and its files are those of an undisturbed one"
