#!/usr/bin/env python3
"""Runs the examples `bal` and `mvba` of the solver and Ceres side by side, and prints a table of ratios.

    python3 benches/side_by_side.py [--runs 3] [--textbook] [--fleet] [--ceres DIR] [--bal FILE ...]

Builds both (Ceres needs g++, make, libceres-dev, libopenblas0-pthread, as Debian has them), makes the
problems that it can make (with numpy) in target/peers, and runs each pair in turn, `--runs` times. BAL files
state no licence and are given by their paths. Times are those of setting up and solving, without reading the
file, as each program reports them; of several settings of Ceres the fastest counts. Ratios are Ceres / ours.
"""
import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
WORK = ROOT / "target" / "peers"
LIBRARY = {}


def run(command, **options):
    environment = dict(os.environ, OPENBLAS_NUM_THREADS="2", **LIBRARY)
    return subprocess.run(command, check=True, text=True, env=environment, stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, **options).stdout


def ours(example, file, loss):
    d = json.loads(run([ROOT / "target/release/examples" / example, file, "--threads", "2", "--json", "--loss", loss]))
    return {"wall": d["seconds"], "cpu": d["cpu_seconds"], "mib": d["peak_mib"], "cost": d["final_cost"],
            "iterations": d["iterations"]}


def ceres(program, file, loss, *settings):
    line = run([WORK / program, file, "--threads=2", f"--loss={loss}", *settings]).splitlines()[0]
    d = json.loads(line)
    return {"wall": d["wall_s"], "cpu": d["cpu_s"], "mib": d["rss_mib"], "cost": d["final"], "iterations": d["iters"]}


def fleet(runs):
    """20 vehicles of 60 points in 900 frames, by the program itself; nothing to compare with."""
    problem, result = WORK / "fleet", WORK / "fleet-result"
    if not problem.exists():
        subprocess.run([sys.executable, ROOT / "benches/peers/gen_fleet.py", "20", "60", "900", problem], check=True)
    found = []
    for _ in range(runs):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        begin = time.monotonic()
        run([ROOT / "target/release/trackbundle", "refine", problem, "--out", result, "--no-rrd", "--threads", "2"])
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        report = json.loads((result / "report.json").read_text())
        found.append({"wall": time.monotonic() - begin, "cpu": after.ru_utime + after.ru_stime - before.ru_utime
                      - before.ru_stime, "mib": after.ru_maxrss / 1024, "iterations": report["iterations"]})
    found = middle(found)
    print("fleet, whole command without recording: " + ", ".join(f"{k} {v:.1f}" for k, v in found.items()), flush=True)


def middle(results):
    return {key: statistics.median(r[key] for r in results) for key in results[0]}


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--runs", type=int, default=3)
    arguments.add_argument("--textbook", action="store_true", help="also points first, sparse, 600 frames (minutes)")
    arguments.add_argument("--fleet", action="store_true", help="also 20 vehicles in 900 frames")
    arguments.add_argument("--bal", nargs="*", default=[], type=Path)
    arguments.add_argument("--ceres", type=Path, help="folder of another libceres.so than the system's")
    arguments = arguments.parse_args()
    if arguments.ceres:
        LIBRARY["LD_LIBRARY_PATH"] = str(arguments.ceres)
    WORK.mkdir(parents=True, exist_ok=True)
    command = ["cargo", "build", "--release", "--no-default-features", "--features", "program", "--examples", "--bins"]
    subprocess.run(command, cwd=ROOT, check=True)
    sources = ROOT / "benches/peers"
    for program in ["ceres_bal", "ceres_mv"]:
        if not (WORK / program).exists():
            subprocess.run(["make", "-s", "-C", sources, program], check=True)
            (sources / program).rename(WORK / program)
    made = {}
    for frames in [150, 600, 1800]:
        made[f"mv-{frames}"] = ["gen_mv.py", frames, 400]
    made["city-96"] = ["gen_city_bal.py", 8, 12, 20000]
    made["city-300"] = ["gen_city_bal.py", 15, 20, 90000]
    for name, command in made.items():
        file = WORK / f"{name}.txt"
        if not file.exists():
            subprocess.run([sys.executable, sources / command[0], *map(str, command[1:]), file], check=True)

    if arguments.fleet:
        fleet(arguments.runs)
    schur = [f"--solver={kind}_schur" for kind in ["dense", "sparse", "iterative"]]
    rows = []
    for frames in [150, 600, 1800]:
        settings = [["--elim=cameras", "--solver=iterative_schur"]]
        rows.append((f"mv-{frames}, huber", "mvba", "ceres_mv", WORK / f"mv-{frames}.txt", "huber", settings))
    if arguments.textbook:
        settings = [["--elim=points", "--solver=sparse_schur"]]
        rows.append(("mv-600, huber, textbook", "mvba", "ceres_mv", WORK / "mv-600.txt", "huber", settings))
    for file in [*arguments.bal, WORK / "city-96.txt", WORK / "city-300.txt"]:
        for loss in ["none", "huber"]:
            rows.append((f"{file.stem}, {loss}", "bal", "ceres_bal", file, loss, [[s] for s in schur]))

    print("| work | wall s, ours : Ceres | ratio | CPU s, ours : Ceres | ratio | MiB, ours : Ceres | ratio "
          "| iterations | final cost, ours : Ceres |\n|---|---|---|---|---|---|---|---|---|")
    for name, example, program, file, loss, settings in rows:
        mine, theirs = [], [[] for _ in settings]
        for _ in range(1 if "textbook" in name else arguments.runs):
            mine.append(ours(example, file, loss))
            for results, setting in zip(theirs, settings):
                results.append(ceres(program, file, loss, *setting))
        a = middle(mine)
        b = min((middle(results) for results in theirs), key=lambda r: r["wall"])
        print(f"| {name} | {a['wall']:.3f} : {b['wall']:.3f} | {b['wall'] / a['wall']:.1f} "
              f"| {a['cpu']:.2f} : {b['cpu']:.2f} | {b['cpu'] / a['cpu']:.1f} "
              f"| {a['mib']:.0f} : {b['mib']:.0f} | {a['mib'] / b['mib']:.2f} "
              f"| {a['iterations']:.0f} : {b['iterations']:.0f} | {a['cost']:.8e} : {b['cost']:.8e} |", flush=True)


if __name__ == "__main__":
    main()
