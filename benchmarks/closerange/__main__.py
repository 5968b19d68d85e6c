"""Calibrate a simulated rig like paper 004's, take 12 shots round an object with and without texture, and compare what
the documented commands (docs/closerange.md) make of the images with the truth.

    PYTHONPATH=tests python -m benchmarks.closerange --store WORK -o benchmarks/results/closerange.json

Images are rendered once into WORK. A cloud is judged by the distance of its points to the true surface: by itself with
the true pose of its station; posed and joined, after one rotation and shift of all stations together: by their places,
and by laying all points on the surface.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from benchmarks.closerange import world
from calibrate.board_world import boards_of_rig, render_rig
from tiegraph.calibrate.adjust import State
from tiegraph.calibrate.board import read_board
from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.tuning import Tuning as ScanTuning
from tiegraph.scene.cloudfile import read_cloud
from tiegraph.scene.posefile import read_poses

BOARD = "charuco:12x9:0.025:0.018"
_INSTANTS, _BOARD_SEED = 50, 2
_BLUNDER_MM = 5.0
_SAMPLE, _ROUNDS = 100_000, 6  # points and steps of the fit onto the surface
_WIDE = world.NAMES.index("wide")


def rendered(store: Path) -> None:
    """Images of the board, and of the object with both surfaces, where they are not there."""
    board = read_board(BOARD)
    cameras, sensors = world.cameras(), world.sensor_from_rig()
    if not (store / "boards").is_dir():
        poses = boards_of_rig(board, list(cameras), list(sensors), count=_INSTANTS, seed=_BOARD_SEED)
        render_rig(store / "boards.tmp", board, State(cameras, sensors, poses), list(world.NAMES))
        (store / "boards.tmp").rename(store / "boards")
    for camera, name in enumerate(world.NAMES):
        for station in range(world.STATIONS):
            files = {s: store / s / "images" / name / f"{station:03d}.png" for s in world.SURFACES}
            if all(f.exists() for f in files.values()):
                continue
            for surface, pixels in world.images(station, camera).items():
                files[surface].parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(files[surface]), pixels)


def commands(store: Path, surface: str) -> list[tuple[str, list[str]]]:
    """(step, arguments of tiegraph) as docs/closerange.md lists them."""
    images, out, rig = store / surface / "images", store / surface / "out", store / "rig.toml"
    here = [str(images), "-o", str(out), "--rig", str(rig)]
    depths = ["--near", str(world.NEAR_M), "--far", str(world.FAR_M), "--preset", "close-range"]
    posed, joined = store / surface / "posed", store / surface / "joined"
    return [
        ("shots", ["shots", *here, *depths]),
        ("poses", ["run", *here, "--until", "georef", "--preset", "close-range"]),
        ("posed", ["shots", *here, *depths, "--posed", str(posed)]),
        ("stations", ["stations", str(out), "-o", str(joined), "--poses", str(posed / "poses.tum")]),
    ]


def said_by(arguments: list[str]) -> tuple[float, str]:
    """CPU seconds of a command and what it wrote; raises nothing: a command may refuse."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-m", "tiegraph", *arguments], capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    text = (done.stdout + done.stderr).strip()
    sys.stderr.write(f"{' '.join(arguments[:1])}: {spent:.0f} s CPU, exit code {done.returncode}\n")
    return round(spent, 1), text if done.returncode == 0 else f"exit code {done.returncode}: {text.splitlines()[-1]}"


def calibration(rig: Path) -> dict[str, Any]:
    """Errors of the calibrated cameras and of their places in the rig against the truth."""
    (spec,) = read_rig_file(rig, ScanTuning().rig)
    first = next(s for s in spec.sensors if s.name == world.NAMES[0])
    rows = {}
    for k, (name, truth) in enumerate(zip(world.NAMES, world.cameras())):
        sensor = next(s for s in spec.sensors if s.name == name)
        made = pycolmap.Camera(model="OPENCV", width=world.SIZE[0], height=world.SIZE[1], params=list(sensor.params))
        pose = np.linalg.inv(sensor.body_from_sensor) @ first.body_from_sensor
        true = world.sensor_from_rig()[k]
        rows[name] = {
            "focal_%": round(100 * abs(made.mean_focal_length() / truth.mean_focal_length() - 1), 4),
            "principal_point_px": round(float(np.linalg.norm(np.array(made.params[2:4]) - truth.params[2:4])), 3),
            "rotation_deg": round(float(transforms.angle_deg(pose[:3, :3], true[:3, :3])), 4),
            "translation_mm": round(1000 * float(np.linalg.norm(transforms.centre(pose) - transforms.centre(true))), 4),
        }
    return rows


def surface_error(points: np.ndarray) -> dict[str, float]:
    """Distances (mm) of points (P, 3), true world, to the true surface: of those of the body, and of all."""
    off = 1000 * world.distance_m(points)
    inner, body = np.abs(off) < _BLUNDER_MM, world.on_body(points)
    good = off[inner & body]
    return {
        "points": len(points),
        "body_median_mm": round(float(np.median(np.abs(good))), 3),
        "body_rms_mm": round(float(np.sqrt(np.mean(good**2))), 3),
        "body_bias_mm": round(float(np.median(good)), 3),
        "all_median_mm": round(float(np.median(np.abs(off[inner]))), 3),
        f"beyond_{_BLUNDER_MM:g}_mm_%": round(100 * float(np.mean(~inner)), 3),
    }


def rigid_between(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) target_from_source of matched points (P, 3), least squares."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return transforms.rigid(turn, target.mean(axis=0) - turn @ source.mean(axis=0))


def truth_of_frames() -> np.ndarray:
    """(12, 4, 4) true world from the frame in which shots are: of the wide camera."""
    return world.stations() @ transforms.invert(world.sensor_from_rig()[_WIDE])


def judged(store: Path, surface: str) -> dict[str, Any]:
    """The clouds of a surface against the truth: by themselves, posed, and joined."""
    folder, truth = store / surface, truth_of_frames()
    shots = {_number(p): read_cloud(p).xyz_m for p in sorted((folder / "out" / "shots").glob("*.ply"))}
    out: dict[str, Any] = {"shots": len(shots)}
    if shots:
        own = np.concatenate([transforms.apply(truth[k], xyz) for k, xyz in shots.items()])
        out["shots with true poses"] = surface_error(own)
    for step, poses, clouds in (
        ("posed", folder / "posed" / "poses.tum", sorted((folder / "posed").glob("*.laz"))),
        ("joined", folder / "joined" / "stations.tum", [folder / "joined" / "cloud.laz"]),
    ):
        out[step] = _placed(poses, clouds) if poses.exists() else None
    return out


def _number(path: Path) -> int:
    return int(path.stem.split("_")[-1])


def _placed(poses: Path, clouds: list[Path]) -> dict[str, Any]:
    """Poses of shots against the true ones, and clouds in their frame against the surface, both after the rotation and
    shift that bring the poses to the truth."""
    found = read_poses(poses)
    true = truth_of_frames()[found.time_s.round().astype(int)]
    truth_from_run = _by_places(found.poses, true)
    moved = truth_from_run @ found.poses
    turned = transforms.angle_deg(moved[:, :3, :3], true[:, :3, :3])
    points = transforms.apply(truth_from_run, np.concatenate([read_cloud(c).xyz_m for c in clouds]))
    return {
        "stations": len(true),
        "place_rms_mm": round(1000 * float(np.sqrt(np.sum((moved - true)[:, :3, 3] ** 2, axis=1).mean())), 3),
        "turn_rms_deg": round(float(np.sqrt(np.mean(turned**2))), 4),
        "scale_off_%": round(100 * (_size(found.poses) / _size(true) - 1), 4),
        "by the stations": surface_error(points),
        "laid on the surface": surface_error(transforms.apply(_onto_surface(points), points)),
    }


def _onto_surface(points: np.ndarray) -> np.ndarray:
    """(4, 4) that lays points (P, 3) on the true surface of the body: their common frame is free in a survey without
    control, and places of a dozen stations tell it less well than the shape does."""
    rng, moved = np.random.default_rng(0), np.eye(4)
    sample = points[rng.choice(len(points), min(_SAMPLE, len(points)), replace=False)]
    for _ in range(_ROUNDS):
        there = transforms.apply(moved, sample)
        off = world.distance_m(there)
        good = (np.abs(off) < _BLUNDER_MM / 1000) & world.on_body(there)
        normal = world.normals(there[good])
        columns = np.hstack([np.cross(there[good], normal), normal])
        step = np.linalg.lstsq(columns, -off[good], rcond=None)[0]
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        moved = transforms.rigid(turn, step[3:]) @ moved
    return moved


def _by_places(poses: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(4, 4) by the places of the stations, and of a point half a metre before each."""
    before = np.array([0, 0, 0.5, 1.0])
    a, b = (np.concatenate([p[:, :3, 3], (p @ before)[:, :3]]) for p in (poses, true))
    return rigid_between(a, b)


def _size(poses: np.ndarray) -> float:
    places = poses[:, :3, 3]
    return float(np.sqrt(np.mean((places - places.mean(axis=0)) ** 2)))


def registered(store: Path, surface: str) -> dict[str, Any]:
    """What the run counts."""
    out: dict[str, Any] = {}
    for stage, names in (("scan", ("images", "hanging")), ("sparse", ("images", "registered", "points"))):
        path = store / surface / "out" / "receipts" / f"{stage}.json"
        counts = json.loads(path.read_text()).get("counts", {}) if path.exists() else {}
        out[stage] = {n: counts.get(n) for n in names}
    return out


def run(store: Path) -> dict[str, Any]:
    """Everything, from images to the table."""
    rendered(store)
    for path in (store / "rig.toml", store / "rig_calibration"):
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    boards, rig = str(store / "boards"), str(store / "rig.toml")
    spent, _ = said_by(["calibrate", boards, "--board", BOARD, "--wide", "wide", "-o", rig])
    results: dict[str, Any] = {"calibration": {"cpu_s": spent, **calibration(store / "rig.toml")}}
    for surface in world.SURFACES:
        for folder in ("out", "posed", "joined"):
            shutil.rmtree(store / surface / folder, ignore_errors=True)
        steps = {}
        for step, arguments in commands(store, surface):
            if step == "stations" and not Path(arguments[-1]).exists():
                arguments = arguments[:-2]  # no poses: the clouds alone must tell
            steps[step] = said_by(arguments)
        results[surface] = {
            **registered(store, surface),
            **judged(store, surface),
            "cpu_s": {step: spent for step, (spent, _) in steps.items()},
            "said": {step: text[-300:] for step, (_, text) in steps.items()},
        }
    return results


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True, help="folder for images and results")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    args.store.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    results = run(args.store)
    results["wall_s"] = round(time.monotonic() - started)
    text = json.dumps(results, indent=1) + "\n"
    sys.stdout.write(text)
    if args.output:
        args.output.write_text(text)


if __name__ == "__main__":
    main()
