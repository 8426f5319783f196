#!/usr/bin/env python3
"""Cloud-to-cloud distances of this package against the k-d tree of scipy, point by point.

In a virtual environment:

    python3 -m venv venv && venv/bin/pip install numpy scipy
    cargo build --release --no-default-features --example cloud_distances
    venv/bin/python tests/clouds/compare.py target/release/examples/cloud_distances

20,000 and 400 points against a real scan and against 20,000 random points, both directions, and the
same shifted to UTM coordinates. Wanted: equal to 1e-12 m on the same coordinates, and the shifted distances
to 1e-8 m of those that are not. `--golden FILE` writes the 400-point case that the tests of
`engine/src/cloud/index.rs` hold.
"""

import pathlib
import subprocess
import sys
import tempfile

import numpy as np
from scipy.spatial import cKDTree

UTM = np.array([500_000.0, 3_900_000.0, 0.0])
HERE = pathlib.Path(__file__).resolve().parents[2]


def scan():
    text = (HERE / "problems/suv-exact/reference/car1.ply").read_text().split("end_header\n")[1]
    return np.array([[float(v) for v in row.split()] for row in text.splitlines()])


def ours(program, start, end):
    with tempfile.TemporaryDirectory() as folder:
        names = []
        for name, points in (("from", start), ("to", end)):
            path = pathlib.Path(folder) / name
            path.write_text("".join(" ".join(repr(float(v)) for v in p) + "\n" for p in points))
            names.append(str(path))
        rows = subprocess.run([program, *names], check=True, capture_output=True, text=True).stdout
    table = [row.split() for row in rows.splitlines()]
    return np.array([int(row[0]) for row in table]), np.array([float(row[1]) for row in table])


def main():
    program = sys.argv[1]
    draw = np.random.default_rng(7)
    box = lambda count: draw.uniform([-2.6, -1.2, -0.2], [2.6, 1.2, 2.0], size=(count, 3))
    body = scan()
    many, few = box(20_000), box(400)
    near = body[draw.integers(0, len(body), 400)] + 0.02 * draw.standard_normal((400, 3))
    cases = {
        "20000 to 400": (many, few),
        "400 to 20000": (few, many),
        "20000 to the scan": (many, body),
        "400 near the scan": (near, body),
        "the scan to 400": (body, near),
    }
    worst = 0.0
    for name, (start, end) in cases.items():
        distance, _ = cKDTree(end).query(start)
        index, found = ours(program, start, end)
        same = np.abs(found - distance).max()
        own = np.abs(found - np.linalg.norm(end[index] - start, axis=1)).max()
        far, _ = cKDTree(end + UTM).query(start + UTM)
        _, found_far = ours(program, start + UTM, end + UTM)
        same_far = np.abs(found_far - far).max()
        shifted = np.abs(found_far - found).max()
        print(f"{name:20s} {len(start):6d} points: {same:.1e} of scipy, {own:.1e} of its own index; "
              f"in UTM {same_far:.1e} of scipy, {shifted:.1e} of the same unshifted")
        worst = max(worst, same / 1e-12, own / 1e-12, same_far / 1e-12, shifted / 1e-8)
    if "--golden" in sys.argv:
        index = np.arange(400)
        start = np.stack([2.5 * np.sin(index), np.cos(1.7 * index), 0.8 + 0.8 * np.sin(2.3 * index)], axis=1)
        distance, which = cKDTree(body).query(start)
        rows = [f"{w} {d:.17e}\n" for w, d in zip(which, distance)]
        pathlib.Path(sys.argv[sys.argv.index("--golden") + 1]).write_text("".join(rows))
    print("as wanted" if worst <= 1.0 else "NOT as wanted")
    sys.exit(worst > 1.0)


main()
