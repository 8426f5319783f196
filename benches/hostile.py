#!/usr/bin/env python3
"""Hostile studies of the program: damaged folders, and processes that die while they write.

    python3 benches/hostile.py folders PROGRAM [--count 1000] [--seed 1]
    python3 benches/hostile.py kills PROGRAM            (Linux, with strace)
    python3 benches/hostile.py moments PROGRAM [--count 200]
    python3 benches/hostile.py full PROGRAM MOUNT       (MOUNT: an empty tmpfs that may be filled)

PROGRAM is a release build. Each prints what it tried and what went wrong, and leaves an input that failed in hostile-failed/.
"""
import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TINY = ROOT / "problems/tiny"
SCENARIO = """format = 1
name = "small"
seed = 3
[camera]
preset = "dji-mini-2"
[film]
frames = 8
rate_hz = 5.0
[flight]
altitude_m = 40.0
[[vehicle]]
id = "car1"
speed_mps = 6.0
points = 10
[targets]
count = 6
spread_m = 25.0
"""
STUDY = """format = 1
name = "small"
scenario = "scenario.toml"
runs = 2
[[axis]]
parameter = "flight.altitude_m"
values = [40.0, 60.0]
[wanted]
track_m = 0.2
"""
SOFT = ["0", "-1", "1e308", "-1e308", "5e-324", "1e300", "1e155", "1e70", "1e18", "1e-300", "0.5", "2", "999999999999"]
HARD = ["", "nan", "inf", "-inf", "x", "1,5", "0x1f", "\u0661", "9" * 5000, "\"", "\"\"", "1e", "--1", "1_000", "\x00", "true"]


def seeds(program, place):
    """Folders to damage: the smallest problem, and a simulated one with targets, terrain and references."""
    (place / "scenario.toml").write_text(SCENARIO)
    (place / "study.toml").write_text(STUDY)
    run([program, "simulate", "scenario.toml", "--out", "small"], place)
    shutil.copytree(TINY, place / "tiny")
    for name in ["tiny", "small"]:
        code, told = run([program, "refine", name, "--out", f"{name}-result", "--no-rrd", "-q"], place)
        assert code == 0, told


def run(command, place, limit_s=120):
    try:
        done = subprocess.run([str(part) for part in command], cwd=place, capture_output=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        return "hang", ""
    return done.returncode, (done.stdout + done.stderr).decode(errors="replace")


def damage_table(text, rng, values):
    lines = text.split("\n")
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        at = rng.randrange(len(lines))
        kind = rng.randrange(7)
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines.insert(at, lines[rng.randrange(len(lines))] if lines else "")
        elif kind == 2 and len(lines) > 2:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        else:
            cells = re.split(r"([,= ]+)", lines[at])
            if cells:
                cells[rng.randrange(len(cells))] = rng.choice(values)
            lines[at] = "".join(cells)
        if not lines:
            lines = [""]
    if rng.random() < 0.1:
        # A whole column in other units.
        column, factor = rng.randrange(1, 8), rng.choice([1000, 1e-3, 1e9, -1, 0])
        for at in range(1, len(lines)):
            cells = lines[at].split(",")
            if column < len(cells):
                try:
                    cells[column] = repr(float(cells[column]) * factor)
                except ValueError:
                    pass
                lines[at] = ",".join(cells)
    return "\n".join(lines)


def damage(folder, rng):
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix != ".ply" or rng.random() < 0.2 and path.is_file())
    path = rng.choice(files)
    kind = rng.random()
    data = path.read_bytes()
    if kind < 0.45:
        path.write_bytes(damage_table(data.decode(errors="replace"), rng, SOFT).encode())
    elif kind < 0.75:
        path.write_bytes(damage_table(data.decode(errors="replace"), rng, SOFT + HARD).encode(errors="replace"))
    elif kind < 0.9 and data:
        changed = bytearray(data)
        for _ in range(rng.choice([1, 2, 8])):
            at = rng.randrange(len(changed))
            changed[at:at + rng.choice([0, 1, 1, 4])] = bytes(rng.randrange(256) for _ in range(rng.choice([0, 1, 1, 3])))
            if not changed:
                break
        path.write_bytes(bytes(changed))
    elif kind < 0.93:
        path.write_bytes(data[:rng.randrange(len(data) + 1)])
    elif kind < 0.95:
        path.unlink()
    elif kind < 0.97:
        path.unlink()
        path.mkdir()
    elif kind < 0.985:
        path.write_bytes(data.decode(errors="replace").encode("utf-16"))
    else:
        path.write_bytes(data.replace(b"\n", b"\r"))
    return path.name


def not_numbers(folder):
    """Files of a result with what is no number in them."""
    found = []
    for path in folder.rglob("*"):
        if path.suffix == ".csv":
            for line in path.read_text(errors="replace").splitlines()[1:]:
                if re.search(r"(^|,)(NaN|nan|-inf)(,|$)", line):
                    found.append(path.name)
                    break
        elif path.suffix in (".json", ".html"):
            if re.search(r"\bNaN\b", path.read_text(errors="replace")):
                found.append(path.name)
    return found


def folders(options):
    place = Path(tempfile.mkdtemp(prefix="hostile-"))
    seeds(options.program, place)
    rng = random.Random(options.seed)
    failed, codes = [], {}
    for number in range(options.count):
        name = rng.choice(["tiny", "tiny", "small"])
        work = place / "work"
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        command = rng.choice(["check", "check", "initialise", "refine", "refine", "refine", "refine", "evaluate", "evaluate", "simulate", "study", "plan"])
        if command in ("simulate", "study", "plan"):
            (work / "p").mkdir()
            for file in ("scenario.toml", "study.toml"):
                shutil.copy(place / file, work / "p" / file)
            if command == "simulate":
                (work / "p/study.toml").unlink()
        else:
            shutil.copytree(place / name, work / "p")
            if command == "evaluate":
                shutil.copytree(place / f"{name}-result", work / "r")
        target = work / "r" if command == "evaluate" and rng.random() < 0.6 else work / "p"
        what = damage(target, rng)
        arguments = {
            "check": ["check", "p"],
            "initialise": ["initialise", "p", "--out", "o", "--no-rrd"],
            "refine": ["refine", "p", "--out", "o", "--no-rrd", "--evaluation", "e"],
            "evaluate": ["evaluate", "p", "r", "--out", "e"],
            "simulate": ["simulate", "p/scenario.toml", "--out", "o"],
            "study": ["study", "p/study.toml", "--out", "o"],
            "plan": ["plan", "p/study.toml", "--out", "o"],
        }[command]
        code, told = run([options.program, *arguments], work)
        codes[code] = codes.get(code, 0) + 1
        wrong = []
        if code not in (0, 1, 2, 3, 4) or "panicked" in told or "memory allocation" in told:
            wrong.append(f"exit {code}" + (", panic" if "panicked" in told else ""))
        if code not in (0, 1) and not told.strip():
            wrong.append("no message")
        hidden = [path.name for path in work.iterdir() if path.name.startswith(".")]
        if hidden:
            wrong.append(f"left {hidden}")
        if code in (2, 3) and any((work / made).exists() for made in "oe"):
            wrong.append("written though refused")
        for made in "oe":
            if (work / made).exists():
                wrong += [f"no number in {made}/{file}" for file in not_numbers(work / made)]
                report = work / made / "report.json"
                if report.exists():
                    listed = json.loads(report.read_text())["files"]
                    if sorted(listed) != sorted(path.name for path in (work / made).iterdir()):
                        wrong.append("files are not those that are listed")
        if wrong:
            kept = Path("hostile-failed") / f"{options.seed}-{number}"
            shutil.rmtree(kept, ignore_errors=True)
            shutil.copytree(work, kept)
            (kept / "told.txt").write_text(f"{arguments}\n{wrong}\n{told}")
            failed.append((number, command, what, wrong))
            print(number, command, what, wrong, flush=True)
        if (number + 1) % 500 == 0:
            print(f"{number + 1} folders, {len(failed)} failed, exit codes {codes}", flush=True)
    print(f"{options.count} folders, {len(failed)} failed, exit codes {dict(sorted(codes.items(), key=str))}")
    shutil.rmtree(place)
    return bool(failed)


def state(place, name="o"):
    """`absent`, `whole` with its trust, or what is wrong."""
    folder = place / name
    if not folder.exists():
        return "absent"
    try:
        report = json.loads((folder / "report.json").read_text())
    except (OSError, ValueError) as error:
        return f"broken: {error}"
    there = sorted(path.name for path in folder.iterdir())
    if there != sorted(report["files"]):
        return f"broken: {there}"
    return f"whole, {report['verdict']['trust']}"


def after(place, command):
    """Wrong states, after a death and after the run that follows it."""
    wrong = []
    seen = state(place)
    if seen.startswith("broken"):
        wrong.append(seen)
    code, told = run(command, place)
    if code != 0:
        wrong.append(f"the next run: exit {code}: {told[-200:]}")
    left = [path.name for path in place.iterdir() if path.name not in ("o", "tiny")]
    if left:
        wrong.append(f"left after the next run: {left}")
    return seen, wrong


def fresh(options, replaces):
    """A place with the smallest problem, and an old result if one is to be replaced; and the command."""
    place = Path(tempfile.mkdtemp(prefix="hostile-"))
    shutil.copytree(TINY, place / "tiny")
    command = [str(options.program), "refine", "tiny", "--out", "o", "--no-rrd", "-q", "--threads", "1"]
    if replaces:
        code, told = run(command, place)
        assert code == 0, told
    return place, command


def judged(seen, wrong, replaces, seen_all):
    """What is wrong after a death, and the count of what was found."""
    if replaces and seen == "absent":
        wrong.append("neither the old nor the new result")
    seen_all[seen] = seen_all.get(seen, 0) + 1
    return wrong


def kills(options):
    calls = "mkdir,mkdirat,openat,write,rename,renameat,renameat2,unlink,unlinkat,rmdir,flock"
    failed, tried, seen_all = 0, 0, {}
    for replaces in (False, True):
        number = 0
        while True:
            number += 1
            place, command = fresh(options, replaces)
            code, _ = run(["strace", "-f", "-qq", "-o", "/dev/null", "-e", f"trace={calls}", "-e",
                           f"inject={calls}:signal=SIGKILL:when={number}", *command], place)
            if code == 0:
                shutil.rmtree(place)
                break
            tried += 1
            wrong = judged(*after(place, command), replaces, seen_all)
            if wrong:
                failed += 1
                print(f"killed at call {number}, replaces {replaces}: {wrong}", flush=True)
            shutil.rmtree(place)
    print(f"killed at {tried} system calls: {failed} wrong; found after it: {seen_all}")
    return bool(failed)


def moments(options):
    rng = random.Random(options.seed)
    failed, seen_all = 0, {}
    for number in range(options.count):
        replaces = rng.random() < 0.5
        place, command = fresh(options, replaces)
        # In a container the program is always process 1.
        wrapped = ["unshare", "-p", "-f", *command] if options.container else command
        child = subprocess.Popen(wrapped, cwd=place, stderr=subprocess.DEVNULL, start_new_session=True)
        time.sleep(rng.random() * options.within)
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        time.sleep(0.02)
        wrong = judged(*after(place, command), replaces, seen_all)
        if wrong:
            failed += 1
            print(number, wrong, flush=True)
        shutil.rmtree(place)
    print(f"killed at {options.count} random moments: {failed} wrong; found after it: {seen_all}")
    return bool(failed)


def full(options):
    """Fills a small disk to many levels; a result is whole or absent, an old one stays."""
    mount, failed, codes = Path(options.mount), 0, {}
    shutil.copytree(TINY, mount / "tiny")
    command = [options.program, "refine", "tiny", "--out", "o", "-q"]
    reference = Path(tempfile.mkdtemp(prefix="full-"))
    shutil.copytree(TINY, reference / "tiny")
    assert run(command, reference)[0] == 0
    size = sum(path.stat().st_size + 8192 for path in (reference / "o").iterdir())
    for number in range(options.count):
        free = int(2.2 * size * number / options.count)
        shutil.rmtree(mount / "o", ignore_errors=True)
        filler = mount / "filler"
        filler.unlink(missing_ok=True)
        there = shutil.disk_usage(mount).free
        with open(filler, "wb") as out:
            out.write(b"x" * max(0, there - free))
        code, told = run(command, mount)
        seen = state(mount)
        codes[(code, seen)] = codes.get((code, seen), 0) + 1
        wrong = []
        if seen.startswith("broken"):
            wrong.append(seen)
        if code != 0 and "No space left" not in told:
            wrong.append(f"exit {code}: {told[-200:]}")
        if code == 0 and seen == "absent":
            wrong.append("done, and nothing there")
        left = [path.name for path in mount.iterdir() if path.name not in ("o", "tiny", "filler")]
        if left:
            wrong.append(f"left {left}")
        if wrong:
            failed += 1
            print(free, wrong, flush=True)
    print(f"{options.count} fill levels up to {int(2.2 * size)} bytes: {failed} wrong; {codes}")
    return bool(failed)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["folders", "kills", "moments", "full"])
    parser.add_argument("program", type=lambda path: Path(path).resolve())
    parser.add_argument("mount", nargs="?")
    parser.add_argument("--count", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--within", type=float, default=0.15, help="moments: seconds within which it is killed")
    parser.add_argument("--container", action="store_true", help="moments: as process 1 of a name space of its own")
    options = parser.parse_args()
    options.count = options.count or {"folders": 1000, "moments": 200, "full": 50}.get(options.what)
    sys.exit({"folders": folders, "kills": kills, "moments": moments, "full": full}[options.what](options))


main()
