#!/bin/sh
# Looks at a run as a person would: the page in a browser, the recording in the viewer, the netCDF files in xarray.
#
#   tests/look.sh [DIRECTORY]     pictures and the run go to DIRECTORY (default: target/look)
#
# Needs, on Debian:
#   apt-get install chromium fonts-dejavu-core mesa-vulkan-drivers libvulkan1 libgl1-mesa-dri libegl1 libgl1 \
#       libxkbcommon-x11-0 libxcursor1 libxi6 libxrandr2
#   python3 -m venv venv && venv/bin/pip install rerun-sdk==0.36.3 pillow xarray scipy pandas
# and PYTHON=venv/bin/python in the environment. ISOBAR is the program, if it is not the release build; it needs the feature
# `rerun` (cargo build --release --features rerun).
set -eu
cd "$(dirname "$0")/.."
out=${1:-target/look}
python=${PYTHON:-python3}
isobar=${ISOBAR:-${CARGO_TARGET_DIR:-target}/release/isobar}
mkdir -p "$out"
[ -n "${KEEP_RUN:-}" ] || "$isobar" run quickstart --out "$out/runs" --overwrite --quiet
"$isobar" compare "$out/runs/quickstart" --out "$out/comparison.html" --overwrite > /dev/null
"$python" tests/look/pages.py "$out/runs/quickstart/report.html" "$out/comparison.html" "$out"
"$python" tests/look/recording.py "$out/runs/quickstart/recording.rrd" "$out"
"$python" tests/look/netcdf.py "$out/runs/quickstart"
"$python" src/examples/read_run.py "$out/runs/quickstart"
echo "all well; now look at the pictures in $out"
