#!/usr/bin/env python3
"""Write a bundle-adjustment problem from the frames of a real film, in the format of *Bundle Adjustment in the Large*.

    film_bal.py 'IMAGES/*.pgm' OUT [--work DIR] [--seed S]

Structure from motion is COLMAP's (`pip install pycolmap pillow numpy`), with one radial camera for all frames. What
it found is moved away from its minimum: attitudes by 2 mrad, positions and points by 0.5 % of the median depth, focal
lengths by 1 %. The film of docs/performance.md is `cube` of Debian's package visp-images-data, 80 frames:

    film_bal.py '/usr/share/visp-images-data/ViSP-images/cube/image.*.pgm' film-80.txt
"""
import argparse
import glob
import tempfile
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image


def reconstruct(images, work):
    (work / "images").mkdir(parents=True, exist_ok=True)
    for file in images:
        Image.open(file).convert("L").save(work / "images" / (Path(file).stem + ".png"))
    database = work / "database.db"
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "RADIAL"
    pycolmap.extract_features(database, work / "images", camera_mode=pycolmap.CameraMode.SINGLE,
                              reader_options=reader, device=pycolmap.Device.cpu)
    pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    found = pycolmap.incremental_mapping(database, work / "images", work)
    return max(found.values(), key=lambda r: r.num_reg_images())


def rotation_vector(r):
    angle = np.arccos(np.clip((np.trace(r) - 1) / 2, -1, 1))
    axis = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    return axis if angle < 1e-9 else angle / np.sin(angle) * axis


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images")
    parser.add_argument("out", type=Path)
    parser.add_argument("--work", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    with tempfile.TemporaryDirectory() as scratch:
        found = reconstruct(sorted(glob.glob(arguments.images)), arguments.work or Path(scratch))
        f, cx, cy, k1, k2 = next(iter(found.cameras.values())).params
        points = sorted(found.points3D)
        index = {point: i for i, point in enumerate(points)}
        # COLMAP's camera looks along z with y down, that of the format along -z with y up.
        flip = np.diag([1.0, -1.0, -1.0])
        cameras, observations, depths = [], [], []
        for camera, image in enumerate(found.images[i] for i in sorted(found.images)):
            pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
            r, t = pose.rotation.matrix(), pose.translation
            cameras.append((flip @ r, flip @ t))
            for seen in image.points2D:
                if seen.has_point3D():
                    depths.append((r @ found.points3D[seen.point3D_id].xyz + t)[2])
                    observations.append((index[seen.point3D_id], camera, seen.xy[0] - cx, cy - seen.xy[1]))
        depth = np.median(depths)
        observations.sort()
        with arguments.out.open("w") as out:
            out.write(f"{len(cameras)} {len(points)} {len(observations)}\n")
            for point, camera, u, v in observations:
                out.write(f"{camera} {point}     {u:.6e} {v:.6e}\n")
            for r, t in cameras:
                turned = rotation_vector(r) + rng.normal(0, 2e-3, 3)
                moved = t + rng.normal(0, 5e-3 * depth, 3)
                focal = f * (1 + rng.normal(0, 0.01))
                out.writelines(f"{x:.16e}\n" for x in [*turned, *moved, focal, k1, k2])
            for point in points:
                moved = found.points3D[point].xyz + rng.normal(0, 5e-3 * depth, 3)
                out.writelines(f"{x:.16e}\n" for x in moved)
        print(f"{len(cameras)} cameras, {len(points)} points, {len(observations)} observations")


if __name__ == "__main__":
    main()
