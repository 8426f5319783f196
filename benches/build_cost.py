#!/usr/bin/env python3
"""What builds cost: processor time, the largest compiler, the folder that is left.

    python3 benches/build_cost.py              # clean builds of the program, with and without the viewer; the tests
    python3 benches/build_cost.py --rebuild    # then also a rebuild after one line of cli, network, refine and the solver

Works in target/build-cost, which is removed before. Times are of all processes together, so they hold on a machine that
does other things too.
"""

import argparse
import os
import re
import resource
import shutil
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TARGET = ROOT / "target/build-cost"
QUICK = ["--no-default-features", "--features", "program"]
LINES = ["src/cli/refine.rs", "engine/src/network/declare.rs", "engine/src/refine/mod.rs", "solver/src/minimise.rs"]


def spent():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def measure(name, arguments):
    before, begin = spent(), time.monotonic()
    environment = {**os.environ, "CARGO_TARGET_DIR": str(TARGET)}
    subprocess.run(["cargo", *arguments], cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL)
    size = sum(file.lstat().st_size for file in TARGET.rglob("*") if not file.is_dir())
    # The largest of all that ran so far.
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(
        f"{name:42} {spent() - before:7.0f} CPU s  {time.monotonic() - begin:7.0f} s  "
        f"largest so far {largest / 1e6:.2f} GB  target {size / 1e9:.2f} GB",
        flush=True,
    )


def clean():
    shutil.rmtree(TARGET, ignore_errors=True)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--rebuild", action="store_true", help="also rebuilds after one line")
    arguments = arguments.parse_args()
    clean()
    measure("cargo build --release, without the viewer", ["build", "--release", *QUICK])
    clean()
    measure("cargo build --release", ["build", "--release"])
    measure("cargo test --no-run after it", ["test", "--no-run"])
    measure("cargo test, its run", ["test"])
    if arguments.rebuild:
        measure("cargo build", ["build"])
        for line in LINES:
            file = ROOT / line
            text = file.read_text()
            try:
                # Into the body of its first function, so that code changes and lines move.
                body = re.search(r"\bfn [^;{]*\{\n", text).end()
                file.write_text(text[:body] + "    std::hint::black_box(1);\n" + text[body:])
                measure(f"cargo build after a line of {line}", ["build"])
            finally:
                file.write_text(text)
    clean()


if __name__ == "__main__":
    main()
