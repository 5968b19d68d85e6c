"""COLMAP alone, as its user would run it: the papers' conventional method, and what they compare themselves with.

Features, a matcher of its own (paper 000, section a: every image against every other) and the incremental mapper, all
with pycolmap's defaults: one camera a folder, no masks, no rig. What was done and what it cost is written again after
each step, so that an abort of the native library loses only the step that was running. Errors in COLMAP's threads end
the process: call it in one of its own.
"""

from __future__ import annotations

import json
import os
import resource
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pycolmap

SEED = 0

DONE, FAILED = "done", "failed"


class Stages:
    """Measures stages and keeps a JSON file: ``status``, ``stages`` (wall_s, cpu_s, peak_mib), ``models``."""

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

    def end(self, reason: str = "") -> None:
        """The last word: done, or (``reason``) why there is nothing to show."""
        self.data |= {"status": FAILED, "reason": reason} if reason else {"status": DONE}
        self.save()

    def save(self) -> None:
        """Write the JSON file in one step."""
        temporary = self._path.with_suffix(".part")
        temporary.write_text(json.dumps(self.data))
        os.replace(temporary, self._path)


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


@dataclass(frozen=True)
class Given:
    """What COLMAP is given beside the images, where it is given something.

    ``cameras``: image folder -> calibrated camera, else guessed. ``rig``: a rig_config.json, whose extrinsics the
    mapper refines unless they are ``held``. ``names``: of images in the model, where they lie under others.
    """

    cameras: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    rig: Path | None = None
    held: bool = False
    names: Mapping[str, str] = field(default_factory=dict)


Models = dict[int, pycolmap.Reconstruction]


def incremental(database: Path, images: Path, sparse: Path, given: Given) -> Models:
    """The models of COLMAP's incremental mapper by number."""
    options = pycolmap.IncrementalPipelineOptions(random_seed=SEED)
    options.ba_refine_sensor_from_rig = not given.held
    return pycolmap.incremental_mapping(database, images, sparse, options)


def reconstruct(
    stages: Stages,
    images: Path,
    out: Path,
    match: Callable[[Path], None] = pycolmap.match_exhaustive,
    given: Given = Given(),
    mapped: Callable[[Path, Path, Path, Given], Models] = incremental,
) -> None:
    """Extract, match and map into ``out``: ``database.db`` and ``sparse/<number>``."""
    database, sparse = out / "database.db", out / "sparse"
    sparse.mkdir(parents=True, exist_ok=True)
    stages.run("features", lambda: _extract(database, images, given))
    if given.rig is not None:
        with pycolmap.Database.open(str(database)) as opened:
            pycolmap.apply_rig_config(pycolmap.read_rig_config(given.rig), opened)
    stages.run("match", lambda: match(database))
    stages.data["pairs"] = pairs_of(database)
    models = stages.run("sparse", lambda: mapped(database, images, sparse, given)) or {}
    for key, model in models.items():
        for image in model.images.values():
            image.name = given.names.get(image.name, image.name)
        model.write(str(sparse / str(key)))
    stages.data["models"] = [str(sparse / str(key)) for key in models]
    stages.data["software"] = {"pycolmap": pycolmap.__version__}
    stages.end("" if models else "no model")


def exhaustive(images: Path, out: Path, record: Path, send: Callable[[Any], None]) -> None:
    """All of it with defaults, in a child process (``child.run_in_child``); the JSON file is ``record``."""
    reconstruct(Stages(record), images, out)


def _extract(database: Path, images: Path, given: Given) -> None:
    pycolmap.extract_features(database, images, camera_mode=pycolmap.CameraMode.PER_FOLDER)
    if given.cameras:
        _give_calibration(database, given.cameras)


def _give_calibration(database: Path, cameras: Mapping[str, Mapping[str, Any]]) -> None:
    """Replace the guessed cameras by calibrated ones, found by the folder of the images."""
    with pycolmap.Database.open(str(database)) as opened:
        for image in opened.read_all_images():
            camera = pycolmap.Camera(**cameras[image.name.rpartition("/")[0]])
            camera.camera_id = image.camera_id
            camera.has_prior_focal_length = True
            opened.update_camera(camera)


def pairs_of(database: Path) -> dict[str, int]:
    """Number of pairs with raw matches, and of those with inliers of two-view geometry (empty rows do not count)."""
    with pycolmap.Database.open(str(database)) as opened:
        _, matches = opened.read_num_matches()
        _, inliers = opened.read_two_view_geometry_num_inliers()
    return {"matched": sum(n > 0 for n in matches), "verified": sum(n > 0 for n in inliers)}
