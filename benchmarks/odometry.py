"""Visual odometry on stereo, a ring and a hand-held camera, beside two open programs from PyPI.

    TIEGRAPH_DATA=... python -m benchmarks.odometry --work DIR [--competitors PYTHON] [--reference SET=RUN] [-o FILE]

``PYTHON``: an interpreter with toy-vo, pyorbslam3 and opencv-python-headless. Drift by KITTI's metric (Geiger et al.
2012) over sub-paths of 10, 20, ... 50 m where there is a scale and so much path, for KITTI's own 100 to 800 m are
longer than these sets; and the absolute error (ATE) after a rigid alignment, or a similarity of a single camera.
``bridge_stereo`` has neither truth nor calibration: a guess is given (1000 px, 0.3 m). How far it is followed and how
fast is told, how it agrees with itself, and with a run of `tiegraph run` on the images in DIR/bridge_stereo/images
(``--reference bridge_stereo=RUN``), all but its scale and whatever a wrong guess bends alike in all of them.

Where there is truth errors over stated sigmas are told (``odometrychecks``). KITTI's is wrong by some 0.1 degrees a
frame in its first twelve (essential matrices of SIFT matches of the left images alone say so too), so they are not
looked at there, and the drift is told without them beside the usual.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import odometrychecks
from benchmarks.datasets import data_root
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.posefile import read_poses
from tiegraph.scene.rig import Rig, Sensor

_PATIENCE_S = 400.0
COMPETITORS = ("orbslam3", "toyvo")
LENGTHS_M = (10.0, 20.0, 30.0, 40.0, 50.0)


@dataclass(frozen=True)
class Sequence:
    """files[f][c], the rig, and world_from_rig (F, 4, 4) if known, rightly from frame ``known_from`` on; ``metric``:
    the rig tells a scale."""

    files: list[list[Path]]
    rig: Rig
    truth: np.ndarray | None
    known_from: int = 0

    @property
    def metric(self) -> bool:
        """Whether lengths are in metres."""
        return len(self.rig.sensors) > 1


def _pinhole(width: int, height: int, params: list[float], model: str = "PINHOLE") -> pycolmap.Camera:
    camera = pycolmap.Camera(model=model, width=width, height=height, params=params)
    camera.has_prior_focal_length = True
    return camera


def _stereo(camera: pycolmap.Camera, base_m: float) -> Rig:
    right = transforms.rigid(np.eye(3), [-base_m, 0, 0])
    sensors = (Sensor("cam0", camera, np.eye(4), folder="cam0"), Sensor("cam1", camera, right, folder="cam1"))
    return Rig("stereo", sensors, fixed=True)


def _kitti(root: Path) -> Sequence:
    folder = root / "kitti_stereo" / "KITTI_sequence_1"
    left, right = np.loadtxt(folder / "calib.txt").reshape(-1, 3, 4)
    truth = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    files = [[folder / f"image_{c}" / f"{k:06d}.jpg" for c in "lr"] for k in range(len(truth))]
    camera = _pinhole(*_size(files[0][0]), [left[0, 0], left[1, 1], left[0, 2], left[1, 2]])
    rig = _stereo(camera, -right[0, 3] / right[0, 0])
    return Sequence(files, rig, transforms.rigid(truth[:, :, :3], truth[:, :, 3]), known_from=12)


def _bridge(root: Path) -> Sequence:
    folder = root / "bridge_stereo"
    lists = [sorted((folder / name).glob("*.*")) for name in ("bridge-l", "bridge-r")]
    width, height = _size(lists[0][0])
    return Sequence(
        [list(pair) for pair in zip(*lists)],
        _stereo(_pinhole(width, height, [1000.0, 1000.0, width / 2, height / 2 + 0.5]), 0.3),
        None,
    )


def _canal(root: Path, name: str = "canal", sweep: str = "up") -> Sequence:
    folder = root / name
    interior = json.loads((folder / "gt" / "intrinsics.json").read_text())
    places = json.loads((folder / "gt" / "rig.json").read_text())
    body = {
        n: transforms.from_quaternion_wxyz(p["cam_from_body_qwxyz"], p["cam_from_body_t"]) for n, p in places.items()
    }
    sensors = []
    for own in sorted(body):
        k = interior[own]
        params = [k[p] for p in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")]
        pose = body[own] @ transforms.invert(body["cam0"])
        sensors.append(Sensor(own, _pinhole(k["width"], k["height"], params, k["model"]), pose, folder=own))
    count = len(list((folder / "images" / sweep / "cam0").iterdir()))
    files = [[folder / "images" / sweep / s.name / f"{f:06d}.jpg" for s in sensors] for f in range(count)]
    truth = read_poses(folder / "gt" / f"cam_{sweep}_0.tum").poses
    return Sequence(files, Rig("ring", tuple(sensors), fixed=True), truth)


def _handheld(root: Path) -> Sequence:
    folder = root / "rgbd_250"
    files = sorted(folder.glob("*.color.jpg"))
    truth = np.stack([np.loadtxt(str(f).replace(".color.jpg", ".pose.txt")) for f in files])
    camera = _pinhole(640, 480, [585.0, 585.0, 320.0, 240.0])
    return Sequence([[f] for f in files], Rig("camera", (Sensor("cam0", camera, np.eye(4), folder="cam0"),)), truth)


def _size(path: Path) -> tuple[int, int]:
    from PIL import Image

    with Image.open(path) as image:
        return image.size


SETS: dict[str, Callable[[Path], Sequence]] = {
    "kitti_stereo": _kitti,
    "bridge_stereo": _bridge,
    "canal": _canal,
    "canal down": lambda root: _canal(root, sweep="down"),
    "canal_demo": lambda root: _canal(root, "canal_demo"),
    "canal_demo down": lambda root: _canal(root, "canal_demo", "down"),
    "rgbd_250": _handheld,
}


# --- programs -------------------------------------------------------------------------------------------------------


def ours(sequence: Sequence, work: Path) -> dict:
    """`tiegraph odometry` as its user runs it; the frames a second are those of the odometry without the scan."""
    for number, files in enumerate(sequence.files):
        for sensor, file in zip(sequence.rig.sensors, files):
            link = work / "images" / sensor.folder / f"{number:06d}{file.suffix}"
            link.parent.mkdir(parents=True, exist_ok=True)
            link.unlink(missing_ok=True)
            link.symlink_to(file)
    write_rig_toml(sequence.rig, work / "rig.toml")
    for left in (work / "vo.tum", work / "vo.csv"):
        left.unlink(missing_ok=True)
    command = [sys.executable, "-m", "tiegraph", "odometry", str(work / "images"), "--rig", str(work / "rig.toml")]
    done, cpu_s = _timed([*command, "-o", str(work / "vo.tum"), "--json"])
    last = json.loads(done.strip().splitlines()[-1])
    table = np.genfromtxt(work / "vo.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    found = read_poses(work / "vo.tum")
    poses: list = [None] * len(sequence.files)
    for at, pose in zip(found.time_s, found.poses):
        poses[int(round(at))] = pose.tolist()
    sigma = np.linalg.norm([table[f"sigma_{a}"] for a in "xyz"], axis=0)
    return {
        "poses": poses, "frames_per_s": last["frames_per_s"], "cpu_s_per_frame": cpu_s / len(poses),
        "sigma_last": float(sigma[np.isfinite(sigma)][-1]), "said": last["said"],
    }  # fmt: skip


def other(name: str, python: str, sequence: Sequence, work: Path) -> dict:
    """A competitor, by its own interpreter."""
    sensors = sequence.rig.sensors
    job = {
        "files": [[str(f) for f in files] for files in sequence.files],
        "matrices": [s.camera.calibration_matrix().tolist() for s in sensors if s.camera is not None],
        "sizes": [[s.camera.width, s.camera.height] for s in sensors if s.camera is not None],
        "sensor_from_rig": [np.asarray(s.sensor_from_rig).tolist() for s in sensors],
    }
    (work / "job.json").write_text(json.dumps(job))
    result = work / f"{name}.json"
    module = f"benchmarks.competitors.odometry_{name}"
    _timed([python, "-m", module, str(work / "job.json"), str(result)], {"PYTHONPATH": str(Path(__file__).parents[1])})
    return json.loads(result.read_text())


def _timed(command: list[str], environment: dict[str, str] | None = None) -> tuple[str, float]:
    before = os.times()
    environment = {**os.environ, **(environment or {})}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=_PATIENCE_S)
    if done.returncode:
        raise RuntimeError((done.stderr or done.stdout).strip().splitlines()[-1])
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return done.stdout, used


# --- figures --------------------------------------------------------------------------------------------------------


def figures(sequence: Sequence, made: dict) -> dict:
    """Share of frames with a pose, drift or absolute error, speed."""
    there = np.array([p is not None for p in made["poses"]])
    out = {k: made[k] for k in ("frames_per_s", "cpu_s_per_frame", "sigma_last", "said") if k in made}
    out |= {"frames": len(there), "posed": int(there.sum())}
    if sequence.truth is None or there.sum() < 3:
        return out
    found = np.array([p for p in made["poses"] if p is not None], float)
    truth = transforms.invert(sequence.truth[0]) @ sequence.truth
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    fit = umeyama(found[:, :3, 3], truth[there, :3, 3], with_scale=not sequence.metric)
    off = np.linalg.norm(fit(found[:, :3, 3]) - truth[there, :3, 3], axis=1)
    out |= {"path_m": float(path[-1]), "ate_m": float(np.sqrt(np.mean(off**2)))}
    if sequence.metric:
        out |= drift(found, truth[there], path[there])
        sure = np.flatnonzero(there) >= sequence.known_from
        if not sure.all():
            out[f"from frame {sequence.known_from}"] = drift(found[sure], truth[there][sure], path[there][sure])
    return out


def checks(sequence: Sequence, reference: Path | None) -> dict:
    """Errors over sigmas where there is truth, else how the path agrees with itself and with a run."""
    if sequence.truth is not None:
        own = (sequence.files, sequence.rig, sequence.truth)
        return {"errors_over_sigmas": odometrychecks.sigma_check(*own, first=sequence.known_from)}
    return {"agreement": odometrychecks.with_itself(sequence.files, sequence.rig, reference)}


def drift(found: np.ndarray, truth: np.ndarray, path: np.ndarray) -> dict:
    """KITTI's: mean over all sub-paths of the lengths, in % of the length and degrees in 100 m."""
    moved, turned = [], []
    for length in LENGTHS_M:
        for first in range(len(path)):
            last = int(np.searchsorted(path, path[first] + length))
            if last < len(path):
                steps = [transforms.invert(p[first]) @ p[last] for p in (found, truth)]
                rest = transforms.invert(steps[0]) @ steps[1]
                moved.append(100 * np.linalg.norm(rest[:3, 3]) / length)
                turned.append(100 * float(transforms.angle_deg(rest[:3, :3], np.eye(3))) / length)
    return {"drift_percent": float(np.mean(moved)), "drift_deg_per_100m": float(np.mean(turned))} if moved else {}


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--competitors", help="Python with the competitors")
    parser.add_argument("--sets", nargs="+", default=list(SETS), choices=list(SETS))
    parser.add_argument("--reference", nargs="*", default=[], help="SET=RUN: a run on the same images")
    parser.add_argument("-o", "--out", type=Path, default=Path(__file__).parent / "results" / "odometry.json")
    args = parser.parse_args()
    references = {name: Path(run) for name, run in (r.split("=", 1) for r in args.reference)}
    results = json.loads(args.out.read_text()) if args.out.exists() else {}
    for name in args.sets:
        sequence, work = SETS[name](data_root()), args.work / name
        work.mkdir(parents=True, exist_ok=True)
        row = results.setdefault(name, {})
        for program in ("tiegraph", *(COMPETITORS if args.competitors else ())):
            load, begun = os.getloadavg()[0], time.time()
            try:
                own = program == "tiegraph"
                made = ours(sequence, work) if own else other(program, args.competitors, sequence, work)
                row[program] = figures(sequence, made) | (checks(sequence, references.get(name)) if own else {})
            except Exception as error:  # a competitor that cannot
                row[program] = {"failed": str(error)[-200:]}
            row[program] |= {"load_before": round(load, 1), "wall_s": round(time.time() - begun, 1)}
            sys.stdout.write(f"{name:14s} {program:9s} {json.dumps(row[program])}\n")
        args.out.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
