"""What the two COLMAP competitors share: pycolmap with its defaults, as its user would run it; no masks, no rig.

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
    parser.add_argument("options", nargs="*", help="passed on to the competitor as they are")
    return parser.parse_args()


def reconstruct(args: argparse.Namespace, match: Callable[[Path], None]) -> None:
    """Extract, match, map with pycolmap's defaults: one camera a folder, incremental mapper."""
    stages = Stages(args.json)
    database, sparse = args.out / "database.db", args.out / "sparse"
    sparse.mkdir(parents=True, exist_ok=True)
    stages.run("features", lambda: _extract(database, args))
    stages.run("match", lambda: match(database))
    stages.data["pairs"] = pairs_of(database)
    options = pycolmap.IncrementalPipelineOptions(random_seed=SEED)
    models = stages.run("sparse", lambda: pycolmap.incremental_mapping(database, args.images, sparse, options))
    stages.data["models"] = [str(sparse / str(key)) for key in models or {}]
    stages.data["software"] = {"pycolmap": pycolmap.__version__}
    stages.data["status"] = "done" if stages.data["models"] else "failed"
    if not stages.data["models"]:
        stages.data["reason"] = "no model"
    stages.save()


def _extract(database: Path, args: argparse.Namespace) -> None:
    pycolmap.extract_features(database, args.images, camera_mode=pycolmap.CameraMode.PER_FOLDER)
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
