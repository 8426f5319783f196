#!/usr/bin/env python3
"""Holds `trackbundle evaluate` against `evo` (https://github.com/MichaelGrupp/evo).

    python3 tests/evo/compare.py target/release/trackbundle [--golden]

makes a virtual environment (--venv, by default in the folder for temporary files), installs evo 1.38.1 into it, and runs itself there.
For a film at 29.97 Hz with a receiver at 5 Hz, and for a film at 5 Hz with a receiver at 29.97 Hz, their times
interleaved, the absolute position errors (rmse, mean, median, std, min, max, sse) of `evaluate --json` are compared with those that
evo computes from TUM files of the same positions: nearest in time with the same maximum difference, and interpolated
(evo is given the reference between its samples, which this script computes by its own road), without an alignment,
rigid and similarity. They must be equal to 1e-9, relative to values above 1.

`--exports DIR` takes a folder that `evaluate --out` wrote: `evo_ape` computes the same distances from its TUM and its
KITTI files, and `evo_res` and `evo_traj` open the others.

`--golden` writes the numbers of evo to tests/evo/golden.json, which tests/program/evo.rs holds the program to without Python.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

EVO = "evo==1.38.1"
MAX_GAPS = [0.004, 0.02, 0.2]
ALIGNMENTS = {"none": (False, False), "rigid": (True, False), "similarity": (True, True)}
NAMES = ["rmse", "mean", "median", "std", "min", "max", "sse"]
HERE = Path(__file__).resolve().parent


def road(t):
    """Where the vehicle is at a time: the same formula as in tests/program/evo.rs."""
    return (7.0 * t + 9.0 * math.sin(0.41 * t), 14.0 * math.sin(0.29 * t + 0.5), 0.3 * math.sin(0.2 * t))


def film_track(rate, count):
    """Times and positions of a result that is somewhat turned, too large, and off."""
    rows = []
    for k in range(count):
        t = k / rate
        x, y, z = road(t)
        wobble = [0.05 * math.sin(11.0 * t + axis) for axis in range(3)]
        rows.append((t, 1.01 * x - 0.02 * y + 0.4 + wobble[0], 1.01 * y + 0.02 * x - 0.3 + wobble[1], z + 0.2 + wobble[2]))
    return [tuple(round(v, 6) for v in row) for row in rows]


def receiver_track(rate, count, first):
    """Times and positions of a receiver, from `first` on."""
    rows = []
    for k in range(count):
        t = first + k / rate
        x, y, z = road(t)
        rows.append((t, x + 0.02 * math.sin(3.0 * t), y + 0.02 * math.cos(2.0 * t), z))
    return [tuple(round(v, 6) for v in row) for row in rows]


TRACKS = {
    "film30": (film_track(29.97, 600), receiver_track(5.0, 100, 0.513)),
    "film5": (film_track(5.0, 100), receiver_track(29.97, 660, -1.013)),
}


def write_problem(folder, film, receiver):
    """A problem and a result folder with these tracks."""
    problem, result = folder / "problem", folder / "result"
    (problem / "reference").mkdir(parents=True)
    result.mkdir()
    (problem / "problem.toml").write_text(
        'format = 1\nname = "p"\n[camera]\nmodel = "pinhole"\nwidth = 100\nheight = 100\nfx = 100.0\nfy = 100.0\n'
        'cx = 50.0\ncy = 50.0\n[terrain]\nplane_z = 0.0\n[[vehicle]]\nid = "a"\n'
    )
    rows = list(enumerate(film))
    (problem / "frames.csv").write_text("frame,time_s\n" + "".join(f"{k},{r[0]}\n" for k, r in rows))
    (problem / "camera_poses.csv").write_text(
        "frame,x,y,z,qw,qx,qy,qz\n" + "".join(f"{k},0,0,50,0,1,0,0\n" for k, _ in rows)
    )
    (problem / "vehicle_observations.csv").write_text(
        "frame,vehicle,point,u,v\n" + "".join(f"{k},a,p,50,50\n" for k, _ in rows)
    )
    (problem / "reference" / "gnss.csv").write_text(
        "vehicle,time_s,x,y,z\n" + "".join("a,{},{},{},{}\n".format(*r) for r in receiver)
    )
    (result / "trajectories.csv").write_text(
        "vehicle,frame,time_s,x,y,z\n" + "".join("a,{},{},{},{},{}\n".format(k, *r) for k, r in rows)
    )
    return problem, result


def between(samples, times):
    """The samples between their times: cubics with positions and tangents, those of parabolas (docs/evaluate.md)."""
    import numpy as np

    t = np.array([s[0] for s in samples])
    p = np.array([s[1:] for s in samples])
    slope = np.diff(p, axis=0) / np.diff(t)[:, None]
    h = np.diff(t)[:, None]
    tangent = np.empty_like(p)
    tangent[1:-1] = (h[1:] * slope[:-1] + h[:-1] * slope[1:]) / (h[:-1] + h[1:])
    tangent[0] = 2 * slope[0] - tangent[1]
    tangent[-1] = 2 * slope[-1] - tangent[-2]
    found = {}
    for time in times:
        if not t[0] <= time <= t[-1]:
            continue
        k = min(np.searchsorted(t, time, side="right") - 1, len(t) - 2)
        step = t[k + 1] - t[k]
        s = (time - t[k]) / step
        found[time] = (
            p[k]
            + (3 * s**2 - 2 * s**3) * (p[k + 1] - p[k])
            + (s**3 - 2 * s**2 + s) * step * tangent[k]
            + (s**3 - s**2) * step * tangent[k + 1]
        )
    return found


def trajectory(rows):
    import numpy as np
    from evo.core.trajectory import PoseTrajectory3D

    rows = np.array(rows)
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
    return PoseTrajectory3D(rows[:, 1:4], quaternions, rows[:, 0])


def by_evo(film, receiver, association, max_gap, alignment):
    """Statistics of the absolute position error, as evo_ape computes them."""
    from evo.core import metrics, sync
    from evo.main_ape import ape

    if association == "interpolated":
        found = between(receiver, [row[0] for row in film])
        film = [row for row in film if row[0] in found]
        reference, estimate = trajectory([(t, *found[t]) for t in (r[0] for r in film)]), trajectory(film)
    else:
        reference, estimate = trajectory(receiver), trajectory(film)
        reference, estimate = sync.associate_trajectories(reference, estimate, max_diff=max_gap)
    align, scale = ALIGNMENTS[alignment]
    found = ape(reference, estimate, metrics.PoseRelation.translation_part, align=align, correct_scale=scale)
    return {"count": len(found.np_arrays["error_array"]), **{name: float(found.stats[name]) for name in NAMES}}


def by_program(program, problem, result, association, max_gap, alignment):
    command = [program, "evaluate", problem, result, "--json", "--quiet", "--association", association]
    command += ["--alignment", alignment] + (["--max-gap", str(max_gap)] if max_gap is not None else [])
    found = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    return json.loads(found.stdout)["vehicles"][0]["track"]["distances"]


def compare_statistics(program, golden):
    kept, worst = [], 0.0
    for name, (film, receiver) in TRACKS.items():
        with tempfile.TemporaryDirectory() as folder:
            problem, result = write_problem(Path(folder), film, receiver)
            settings = [("interpolated", None)] + [("nearest", gap) for gap in MAX_GAPS]
            for association, max_gap in settings:
                for alignment in ALIGNMENTS:
                    wanted = by_evo(film, receiver, association, max_gap, alignment)
                    found = by_program(program, problem, result, association, max_gap, alignment)
                    off = max(abs(found[n] - wanted[n]) / max(1.0, abs(wanted[n])) for n in NAMES)
                    same = found["count"] == wanted["count"] and off <= 1e-9
                    worst = max(worst, off)
                    print(f"{name} {association} {max_gap} {alignment}: {wanted['count']} pairs, off by {off:.1e}")
                    if not same:
                        sys.exit(f"evo: {wanted}\ntrackbundle: {found}")
                    kept.append(
                        {"tracks": name, "association": association, "max_gap_s": max_gap, "alignment": alignment, **wanted}
                    )
    print(f"{len(kept)} comparisons, off by {worst:.1e} at most")
    if golden:
        (HERE / "golden.json").write_text("[\n" + ",\n".join(json.dumps(row) for row in kept) + "\n]\n")


def compare_pairs(folder, programs, environment):
    """Distances of every vehicle by `evo_ape` from TUM and KITTI files, against those of evaluation.json."""
    from evo.tools import file_interface

    for vehicle in json.loads((folder / "evaluation.json").read_text())["vehicles"]:
        name, wanted = vehicle["vehicle"], vehicle["track"]["distances"]
        # Times of the nearest are no farther apart than this; those of interpolated places are equal.
        gap = ["--t_max_diff", str(max(vehicle["track"]["max_gap_s"], 1e-9))]
        for kind, track, more in [("tum", "track", gap), ("kitti", "poses", [])]:
            with tempfile.TemporaryDirectory() as place:
                saved = Path(place) / "saved.zip"
                files = [folder / f"reference_{name}.{kind}", folder / f"{track}_{name}.{kind}"]
                command = [programs / "evo_ape", kind, *files, *more, "--save_results", saved]
                subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
                found = file_interface.load_res_file(saved)
                ours = file_interface.load_res_file(folder / f"evo_{name}.zip")
                assert len(found.np_arrays["error_array"]) == wanted["count"], f"{name} {kind}"
                off = max(abs(found.stats[n] - wanted[n]) / max(1.0, abs(wanted[n])) for n in NAMES)
                assert off <= 1e-9, f"{name} {kind}: evo {found.stats}, trackbundle {wanted}"
                if kind == "tum":
                    assert set(found.np_arrays) <= set(ours.np_arrays), sorted(found.np_arrays)
                    for array, values in found.np_arrays.items():
                        apart = max(abs(values - ours.np_arrays[array]))
                        assert apart <= 1e-9, f"{name} {array}: {apart}"
                print(f"{name} {kind}: {wanted['count']} pairs, off by {off:.1e}")


def open_exports(folder):
    """Every file of the folder, by the programs of evo."""
    import numpy as np
    from evo.tools import file_interface

    programs = Path(sys.executable).parent
    home = tempfile.mkdtemp()
    environment = dict(os.environ, HOME=home, MPLBACKEND="Agg")
    opened = 0
    compare_pairs(Path(folder), programs, environment)
    for path in sorted(Path(folder).iterdir()):
        command = {
            ".zip": ["evo_res", path],
            ".tum": ["evo_traj", "tum", path],
            ".kitti": ["evo_traj", "kitti", path],
        }.get(path.suffix)
        if command is None:
            continue
        subprocess.run([programs / command[0], *command[1:]], check=True, env=environment)
        opened += 1
        if path.suffix == ".zip":
            result = file_interface.load_res_file(path, load_trajectories=True)
            errors = result.np_arrays["error_array"]
            again = {
                "rmse": math.sqrt(np.mean(errors**2)),
                "mean": np.mean(errors),
                "median": np.median(errors),
                "std": np.std(errors),
                "min": np.min(errors),
                "max": np.max(errors),
                "sse": np.sum(errors**2),
            }
            assert set(result.stats) == set(NAMES), result.stats
            for name in NAMES:
                assert abs(result.stats[name] - again[name]) <= 1e-9 * max(1.0, abs(again[name])), name
            tracks = [result.trajectories[result.info[key]] for key in ("ref_name", "est_name")]
            apart = np.linalg.norm(tracks[1].positions_xyz - tracks[0].positions_xyz, axis=1)
            assert np.allclose(apart, errors, rtol=0, atol=1e-9)
            lengths = {name: len(array) for name, array in result.np_arrays.items() if array.ndim == 1}
            assert set(lengths.values()) == {len(errors)}, lengths
    assert opened > 0, "nothing to open"
    print(f"{opened} files were opened")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--golden", action="store_true")
    parser.add_argument("--exports")
    parser.add_argument("--venv", default=os.path.join(tempfile.gettempdir(), "trackbundle-evo"))
    arguments = parser.parse_args()
    python = Path(arguments.venv) / "bin" / "python"
    if Path(sys.prefix).resolve() != Path(arguments.venv).resolve():
        if not (Path(arguments.venv) / "bin" / "evo_ape").exists():
            venv.create(arguments.venv, with_pip=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", EVO], check=True)
        os.execv(python, [python, __file__, *sys.argv[1:]])
    compare_statistics(arguments.program, arguments.golden)
    if arguments.exports:
        open_exports(arguments.exports)


if __name__ == "__main__":
    main()
