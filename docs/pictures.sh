#!/usr/bin/env bash
# Pictures of every shipped problem, each layout, into docs/pictures: docs/pictures.sh [PROGRAM [VIEWER]]
set -euo pipefail
cd "$(dirname "$0")/.."
program=${1:-target/release/trackbundle}
viewer=${2:-rerun}
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
mkdir -p docs/pictures

picture() { # FILE.rrd FILE.png
    RERUN_ANALYTICS=0 RUST_LOG=error "$viewer" --headless --bind 127.0.0.1 --port 0 --window-size 1000x625 \
        --screenshot-to "$2" "$1"
}

for problem in tiny suv-exact suv-noisy drive-60s; do
    "$program" refine "problems/$problem" --out "$place/result-$problem" --no-rrd --quiet
    for layout in overview shape; do
        "$program" view "problems/$problem" "$place/result-$problem" --layout "$layout" --rrd "$place/x.rrd" --quiet
        picture "$place/x.rrd" "docs/pictures/$problem-$layout.png"
    done
done
