"""What the COLMAP competitors share: pycolmap with its defaults, as its user would run it; no masks.

The program writes ``--json`` again after each stage, so that a time-out or an abort of the native library loses only
the stage that was running.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
import zlib  # noqa: F401  pycolmap must not be the first to load zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pycolmap

SEED = 0


class Stages:
    """Measures stages and keeps the JSON file up to date."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.data: dict[str, Any] = {"status": "started", "stages": [], "models": []}
        self.save()

    def run(self, stage: str, function: Callable[[], Any]) -> Any:
        """Call ``function`` and note its wall time, CPU time (all threads) and the peak memory so far."""
        self.data["running"] = stage
        self.save()
        wall, before = time.monotonic(), _cpu_s()
        result = function()
        peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        row = {"stage": stage, "wall_s": time.monotonic() - wall, "cpu_s": _cpu_s() - before, "peak_mib": peak_mib}
        self.data["stages"].append(row)
        self.data.pop("running")
        self.save()
        return result

    def fail(self, reason: str) -> None:
        """Say why there is nothing to show."""
        self.data |= {"status": "failed", "reason": reason}
        self.save()

    def save(self) -> None:
        """Write the JSON file in one step."""
        temporary = self._path.with_suffix(".part")
        temporary.write_text(json.dumps(self.data))
        os.replace(temporary, self._path)


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def arguments(description: str) -> argparse.Namespace:
    """The command line every competitor has; it ignores what it has no use for."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="empty work folder")
    parser.add_argument("--json", type=Path, required=True, help="where the figures go")
    parser.add_argument("--cameras", type=Path, help="JSON: image folder -> COLMAP camera; default: guessed by COLMAP")
    for name in ("rig", "gnss", "trajectory", "times"):
        parser.add_argument(f"--{name}")
    parser.add_argument("--until", default="georef")
    parser.add_argument("--hold-rig", action="store_true", help="the extrinsics of the rig are not refined")
    parser.add_argument("options", nargs="*", help="passed on to the competitor as they are")
    return parser.parse_args()


def reconstruct(args: argparse.Namespace, match: Callable[[Path], None], with_rig: bool = False) -> None:
    """Extract, match, map with pycolmap's defaults: one camera a folder, incremental mapper.

    ``with_rig``: ``--rig`` is a rig_config.json, whose extrinsics the mapper refines (its default) unless they are
    calibrated. A set without a rig has nothing to be run on and fails with that reason.
    """
    stages = Stages(args.json)
    database, sparse, images, names = args.out / "database.db", args.out / "sparse", args.images, {}
    sparse.mkdir(parents=True, exist_ok=True)
    options = pycolmap.IncrementalPipelineOptions(random_seed=SEED)
    if with_rig:
        if args.rig is None:
            return stages.fail("the set has no rig")
        images, names = _folders_of_sensors(args.images, Path(args.rig), args.out / "images")
        options.ba_refine_sensor_from_rig = not args.hold_rig
    stages.run("features", lambda: _extract(database, images, args))
    if with_rig:
        with pycolmap.Database.open(str(database)) as opened:
            pycolmap.apply_rig_config(pycolmap.read_rig_config(args.rig), opened)
    stages.run("match", lambda: match(database))
    stages.data["pairs"] = pairs_of(database)
    models = stages.run("sparse", lambda: pycolmap.incremental_mapping(database, images, sparse, options))
    for key, model in (models or {}).items():
        for image in model.images.values():
            image.name = names.get(image.name, image.name)
        model.write(str(sparse / str(key)))
    stages.data["models"] = [str(sparse / str(key)) for key in models or {}]
    stages.data["software"] = {"pycolmap": pycolmap.__version__}
    if not stages.data["models"]:
        return stages.fail("no model")
    stages.data["status"] = "done"
    stages.save()


def _folders_of_sensors(images: Path, rig: Path, target: Path) -> tuple[Path, dict[str, str]]:
    """Links ``<sensor>/<pass>_<image>`` to images ``<pass>/<sensor>/<image>``, and the old names by the new ones.

    COLMAP takes what follows the prefix for the frame; with the pass before it, each pass would be a rig of its own.
    """
    sensors = {Path(c["image_prefix"]).name for r in json.loads(rig.read_text()) for c in r["cameras"]}
    names = {}
    for path in sorted(p for p in images.rglob("*") if p.is_file()):
        old = path.relative_to(images)
        sensor = next((part for part in old.parts[:-1] if part in sensors), None)
        if sensor is not None:
            new = f"{sensor}/{'_'.join(part for part in old.parts if part != sensor)}"
            (target / new).parent.mkdir(parents=True, exist_ok=True)
            (target / new).symlink_to(path.resolve())
            names[new] = old.as_posix()
    return target, names


def _extract(database: Path, images: Path, args: argparse.Namespace) -> None:
    pycolmap.extract_features(database, images, camera_mode=pycolmap.CameraMode.PER_FOLDER)
    if args.cameras:
        _give_calibration(database, json.loads(args.cameras.read_text()))


def _give_calibration(database: Path, cameras: dict[str, dict[str, Any]]) -> None:
    """Replace the guessed cameras by calibrated ones, found by the folder of the images."""
    with pycolmap.Database.open(str(database)) as opened:
        for image in opened.read_all_images():
            given = cameras[image.name.rpartition("/")[0]]
            camera = pycolmap.Camera(**given)
            camera.camera_id = image.camera_id
            camera.has_prior_focal_length = True
            opened.update_camera(camera)


def pairs_of(database: Path) -> dict[str, int]:
    """Number of pairs with raw matches, and of those with inliers of two-view geometry (empty rows do not count)."""
    with pycolmap.Database.open(str(database)) as opened:
        _, matches = opened.read_num_matches()
        _, inliers = opened.read_two_view_geometry_num_inliers()
    return {"matched": sum(n > 0 for n in matches), "verified": sum(n > 0 for n in inliers)}
