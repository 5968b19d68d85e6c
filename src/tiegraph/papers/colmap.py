"""COLMAP alone, as its user would run it: the papers' conventional method, and what they compare themselves with.

Features, a matcher of its own (paper 000, section a: every image against every other) and the incremental mapper, all
with pycolmap's defaults: one camera a folder, no masks, no rig. What was done and what it cost is written again after
each step, so that an abort of the native library loses only the step that was running. Errors in COLMAP's threads end
the process: call it in one of its own.
"""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pycolmap

from tiegraph.papers.measured import Stages, pairs_of


@dataclass(frozen=True)
class Given:
    """What COLMAP is given beside the images, where it is given something.

    ``cameras``: image folder -> calibrated camera, else guessed. ``rig``: a rig_config.json, whose extrinsics the
    mapper refines unless they are ``held``. ``names``: of images in the model, where they lie under others. ``mixed``:
    cameras are told apart by EXIF and not by folder. ``seed`` of the mapper's random choices: with others, and with
    other threads, other models come out of the same images.
    """

    cameras: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    rig: Path | None = None
    held: bool = False
    names: Mapping[str, str] = field(default_factory=dict)
    mixed: bool = False
    seed: int = 0


Models = dict[int, pycolmap.Reconstruction]


def incremental(database: Path, images: Path, sparse: Path, given: Given) -> Models:
    """The models of COLMAP's incremental mapper by number."""
    options = pycolmap.IncrementalPipelineOptions(random_seed=given.seed)
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
    """Extract, match and map into ``out``: ``database.db``, unless it is there, and ``sparse/<number>``."""
    database, sparse = out / "database.db", out / "sparse"
    sparse.mkdir(parents=True, exist_ok=True)
    if not database.exists():
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


def exhaustive(
    images: Path, out: Path, record: Path, seed: int = 0, first: Path | None = None, *, send: Callable[[Any], None]
) -> None:
    """All of it with defaults, in a child process (``child.run_in_child``); the JSON file is ``record``. Features and
    matches, with what they cost, come from ``first``, the folder of another seed."""
    stages = Stages(record)
    if first is not None:
        stages.go_on(first / record.name)
        shutil.copy(first / "database.db", out)
    reconstruct(stages, images, out, given=Given(seed=seed))


def _extract(database: Path, images: Path, given: Given) -> None:
    mode = pycolmap.CameraMode.AUTO if given.mixed else pycolmap.CameraMode.PER_FOLDER
    pycolmap.extract_features(database, images, camera_mode=mode)
    if not given.cameras:
        return
    with pycolmap.Database.open(str(database)) as opened:
        for image in opened.read_all_images():
            camera = pycolmap.Camera(**given.cameras[image.name.rpartition("/")[0]])
            camera.camera_id = image.camera_id
            camera.has_prior_focal_length = True
            opened.update_camera(camera)
