#!/usr/bin/env python3
"""Write a problem folder with many vehicles under one camera.

    gen_fleet.py VEHICLES POINTS FRAMES DIR [--seed S] [--vis 0.93] [--outliers 0.02]

One drone camera, 30 Hz, hovers 80 m above a junction and wanders; each car is POINTS rigid points on a
box and drives its own smooth path. A point is seen in a frame with probability --vis; 1 px noise, and a
share --outliers of the pixels are off by a further 30 px (sigma). 40 surveyed targets. Camera poses start
0.3 m and 0.5 deg off, vehicle poses 0.25 m and 2 deg, each together for the whole film.
"""
import argparse
from pathlib import Path

import numpy as np

from gen_mv import exp_so3, quat, smooth


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("vehicles", type=int)
    ap.add_argument("points", type=int)
    ap.add_argument("frames", type=int)
    ap.add_argument("dir", type=Path)
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--vis", type=float, default=0.93)
    ap.add_argument("--outliers", type=float, default=0.02)
    a = ap.parse_args()
    rng = np.random.default_rng(a.seed)
    V, N, T, dt = a.vehicles, a.points, a.frames, 1 / 30.0
    f, cx, cy, deg = 2680.0, 1920.0, 1080.0, np.pi / 180
    tt = np.arange(T) * dt
    a.dir.mkdir(parents=True, exist_ok=True)

    Rc = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]) @ exp_so3(smooth(rng, T, 0.5 * deg, 10))
    tc = np.stack([4 * np.sin(tt / 5), 3 * np.cos(tt / 7), 80 + np.sin(tt / 4)], 1) + smooth(rng, T, 0.05, 8)
    uv = lambda X: f * X[..., :2] / X[..., 2:] + [cx, cy]
    noise = lambda n: rng.normal(0, 1.0, (n, 2)) + (rng.random(n) < a.outliers)[:, None] * rng.normal(0, 30.0, (n, 2))
    table = lambda name, header, rows: (a.dir / name).write_text(header + "\n" + "".join(rows))
    pose = lambda t, q: ",".join(f"{x:.9g}" for x in t) + "," + ",".join(f"{x:.12g}" for x in q)

    table("frames.csv", "frame,time_s", [f"{t},{t * dt:.6f}\n" for t in range(T)])
    Rc0 = Rc @ exp_so3(rng.normal(0, 0.5 * deg, (1, 3)))
    tc0 = tc + rng.normal(0, 0.3, 3)
    table("camera_poses.csv", "frame,x,y,z,qw,qx,qy,qz",
          [f"{t},{pose(tc0[t], q)}\n" for t, q in enumerate(quat(Rc0))])

    G = np.column_stack([rng.uniform(-50, 50, 40), rng.uniform(-28, 28, 40), rng.normal(0, 0.05, 40)])
    table("targets.csv", "target,x,y,z,sigma_x,sigma_y,sigma_z",
          [f"T{i:02d}," + ",".join(f"{x + e:.5f}" for x, e in zip(g, rng.normal(0, 0.015, 3))) + ",0.015,0.015,0.015\n"
           for i, g in enumerate(G)])
    z = uv(np.einsum("tji,tnj->tni", Rc, G[None] - tc[:, None]))
    t, j = np.nonzero((z[..., 0] > 0) & (z[..., 0] < 2 * cx) & (z[..., 1] > 0) & (z[..., 1] < 2 * cy))
    z = z[t, j] + noise(len(t))
    table("target_observations.csv", "frame,target,u,v",
          [f"{t},T{j:02d},{u:.3f},{v:.3f}\n" for t, j, (u, v) in zip(t, j, z)])

    poses, observations, truth = [], [], []
    for b in range(V):
        dim = np.array([4.5, 1.8, 1.5]) * rng.uniform(0.9, 1.1, 3)
        s = (rng.random((N, 3)) - 0.5) * dim
        face = rng.integers(0, 5, N)
        axis, side = np.array([2, 0, 0, 1, 1])[face], np.array([1, 1, -1, 1, -1])[face]
        s[np.arange(N), axis] = side * dim[axis] / 2
        s[:, 2] += dim[2] / 2
        s[0] = [0, 0, dim[2]]
        # About the junction on an ellipse of its own, each at its own pace.
        rate, phase = rng.uniform(0.05, 0.25) * rng.choice([-1, 1]), rng.uniform(0, 2 * np.pi)
        axes = rng.uniform([12, 8], [40, 22])
        angle = phase + rate * tt + 0.1 * np.sin(tt / 3)
        tv = np.column_stack([axes * np.column_stack([np.cos(angle), np.sin(angle)]), np.zeros(T)])
        step = np.gradient(tv[:, :2], axis=0)
        yaw = np.arctan2(step[:, 1], step[:, 0])
        Rv = exp_so3(np.stack([0 * yaw, 0 * yaw, yaw], 1)) @ exp_so3(smooth(rng, T, 0.3 * deg, 15) * [1, 1, 0])
        X = np.einsum("tij,nj->tni", Rv, s) + (tv - tc)[:, None]
        t, j = np.nonzero(rng.random((T, N)) < a.vis)
        z = uv(np.einsum("tji,tnj->tni", Rc, X)[t, j]) + noise(len(t))
        observations += [f"{t},car{b + 1},p{j:04d},{u:.3f},{v:.3f}\n" for t, j, (u, v) in zip(t, j, z)]
        Rv0 = Rv @ exp_so3(rng.normal(0, 2 * deg, (1, 3)) * [0.5, 0.5, 1])
        poses += [f"{t},car{b + 1},{pose(p, q)}\n" for t, (p, q) in enumerate(zip(tv + rng.normal(0, 0.25, 3), quat(Rv0)))]
        marker = np.einsum("tij,j->ti", Rv, s[0]) + tv
        truth += [f"car{b + 1},{t},{x:.5f},{y:.5f},{h:.5f}\n" for t, (x, y, h) in enumerate(marker)]
    table("vehicle_observations.csv", "frame,vehicle,point,u,v", observations)
    table("vehicle_poses.csv", "frame,vehicle,x,y,z,qw,qx,qy,qz", poses)
    (a.dir / "truth").mkdir(exist_ok=True)
    table("truth/markers.csv", "vehicle,frame,x,y,z", truth)
    vehicles = "".join(f'\n[[vehicle]]\nid = "car{b + 1}"\nmarker = "p0000"\nheight_m = 1.5\nheight_sigma_m = 0.15\n' for b in range(V))
    (a.dir / "problem.toml").write_text(f"""format = 1
name = "{a.dir.name}"

[camera]
model = "pinhole"
width = 3840
height = 2160
fx = {f}
fy = {f}
cx = {cx}
cy = {cy}

[noise]
camera_position_m = 0.3
camera_rotation_deg = 0.5
vehicle_position_m = 0.25
vehicle_rotation_deg = 2.0

[terrain]
plane_z = 0.0
sigma_m = 0.02
{vehicles}""")
    print(f"{a.dir}: {V} vehicles, {T} frames, {len(observations)} observations")


if __name__ == "__main__":
    main()
