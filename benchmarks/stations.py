"""Shots without poses joined, against truth: rendered stations round an object, scans of PandaSet, a hand-held Kinect.

python -m benchmarks.stations object|hall --seed 1 [--near 2]
python -m benchmarks.stations pandaset|rgbd_250 [--step 10] [--count 5] [--near 2] [--pairs]

Object and hall need tests/stations on the path (PYTHONPATH=.:tests). ``--near``: tried at first are only pairs that
follow each other so nearly, and the most alike one.
"""

from __future__ import annotations

import argparse
import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.lidar.scans import read_scan_poses
from tiegraph.stations.joined import join, prepared
from tiegraph.stations.loops import motion
from tiegraph.stations.pairs import Pair, Shot, Station, looked_through
from tiegraph.stations.tuning import Tuning

DATA = Path(os.environ.get("TIEGRAPH_DATA", "data"))
Scans = tuple[list[Shot], list[np.ndarray]]  # and world_from_shot of each


def stations_of_object(seed: int, count: int) -> Scans:
    """Stations all round, 0.3 to 0.8 mm of noise, each in a frame turned at random."""
    from stations.stations_world import views

    made = views(np.arange(count) * 360 / count, seed=seed, points=40_000)
    return [Shot(str(k), v.xyz, v.normal) for k, v in enumerate(made)], [v.world_from_station for v in made]


def stations_of_hall(seed: int, count: int) -> Scans:
    """Scanners along a hall of eight equal bays, 3 mm of noise, each in a frame turned at random."""
    from stations.stations_world import hall, scans

    aside = np.random.default_rng(seed).uniform(-1, 1, count)
    made = scans(hall(), np.column_stack([np.linspace(1.2, 14.8, count), aside, np.full(count, 1.5)]), seed)
    return [Shot(str(k), v.xyz) for k, v in enumerate(made)], [v.world_from_station for v in made]


def pandaset(step: int, count: int) -> Scans:
    """Every so many scans, their poses undone and hidden by random turns."""
    folder = DATA / "pandaset" / "lidar"
    poses, shots, truth = read_scan_poses(folder / "poses.json"), [], []
    for k in range(0, min(step * count, len(poses)), step):
        hidden = transforms.rigid(Rotation.random(random_state=k).as_matrix(), [3.0 * k, 5.0, 7.0])
        truth.append(poses[k] @ hidden)
        xyz = np.load(folder / f"{k:02d}.npz")["xyz_cm"] / 100
        shots.append(Shot(str(k), transforms.apply(transforms.invert(truth[-1]), xyz)))
    return shots, truth


def rgbd_250(step: int, count: int) -> Scans:
    """Every so many depth images from 0.4 to 4 m; their poses are good to centimetres."""
    folder, shots, truth = DATA / "rgbd_250", [], []
    inverse = np.linalg.inv(np.loadtxt(folder / "camera-intrinsics.txt"))
    for file in sorted(folder.glob("*.depth.png"))[: step * count : step]:
        depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) / 1000
        v, u = np.nonzero((depth > 0.4) & (depth < 4.0))
        shots.append(Shot(file.stem, np.column_stack([u, v, np.ones(len(u))]) @ inverse.T * depth[v, u, None]))
        truth.append(np.loadtxt(str(file).replace(".depth.png", ".pose.txt")))
    return shots, truth


def free_space(
    stations: list[Station], pairs: list[Pair], truth: list[np.ndarray], tuning: Tuning
) -> Iterator[dict[str, object]]:
    """Of every pair that has a place: how far it is from the true one, in coarse voxels, and what its free space says
    of it; and what that says of the true place."""
    for p in pairs:
        a, b = stations[p.first], stations[p.second]
        true = a.shift @ transforms.invert(truth[p.first]) @ truth[p.second] @ b.shift_back
        off = motion(p.first_from_second @ transforms.invert(true), transforms.apply(true, b.coarse.xyz))
        shares = [looked_through(a, b, fit) for fit in (p.first_from_second, true)]
        yield {
            "pair": [p.first, p.second],
            "off": round(off / a.coarse.side, 2),
            "through": round(shares[0], 3),
            "at the true place": round(shares[1], 3),
            "overlap": round(p.overlap, 2),
            "why_not": p.why_not,
        }


def main() -> None:
    """Join, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["object", "hall", "pandaset", "rgbd_250"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--step", type=int, default=10)
    parser.add_argument("--near", type=int)
    parser.add_argument("--pairs", action="store_true", help="every pair's free space beside the truth")
    given = parser.parse_args()
    readers = {"pandaset": pandaset, "rgbd_250": rgbd_250}
    made = {"object": stations_of_object, "hall": stations_of_hall}
    if given.what in made:
        shots, truth = made[given.what](given.seed, given.count)
    else:
        shots, truth = readers[given.what](given.step, given.count)
    tuning = Tuning()
    if given.near is not None:
        tuning = tuning.model_copy(update={"all_pairs": 2, "alike": 1, "following": given.near})
    stations = prepared(shots, tuning)[0]
    found = join(stations, tuning)
    if given.pairs:
        for told in free_space(stations, found.pairs, truth, tuning):
            print(json.dumps(told))  # noqa: T201
    there = [k for k, pose in enumerate(found.poses) if np.isfinite(pose).all()]
    some = [s.xyz[:: max(1, len(s.xyz) // 5000)] for s in shots]
    here = np.concatenate([transforms.apply(found.poses[k], some[k]) for k in there])
    true = np.concatenate([transforms.apply(truth[k], some[k]) for k in there])
    off = np.linalg.norm(umeyama(here, true, with_scale=False)(here) - true, axis=1)
    told = {
        "joined": len(there),
        "shots": len(shots),
        "rms_m": float(np.sqrt(np.mean(off**2))),
        "largest_m": float(off.max()),
        "pairs": dict(Counter("refused" if p.why_not else "believed" for p in found.pairs)),
    }
    print(json.dumps(told))  # noqa: T201


if __name__ == "__main__":
    main()
