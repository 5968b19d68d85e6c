"""Glue of the single-shot mode: a point cloud for each shot of a calibrated rig, without any sparse model."""

import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from tiegraph.cloud.fuse import Maps, fuse
from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.plan import CameraModel, DepthRange, ViewPlan
from tiegraph.dense.shot import depth_range, plan_shot
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.pipeline.dense import coloured
from tiegraph.pipeline.files import load_map, whole
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.project.stages import Outcome, remove
from tiegraph.scene.atomic import replacing
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.hanging import carries
from tiegraph.scene.names import shortened
from tiegraph.scene.results import save_depth
from tiegraph.scene.scene import Scene

_FOLDER = "shots"


def shots(run: Run) -> Outcome:
    """One cloud a shot (``shots/<pass>_<number>.ply``, in the frame of the rig's first camera) and its depth maps.

    Finished shots are skipped. Raises InputError for a rig whose cameras are not all calibrated.
    """
    scene, sought, tuning = whole(run), run.settings.shots, run.settings.tuning.dense.shots
    items = []
    for frame in range(scene.frames):
        views = shot_views(scene, frame)
        found = depth_range(views, sought.near_m, sought.far_m, tuning)
        items.append(_Shot(cloud_path(run.folder, scene, frame), views, found))
    todo = [item for item in items if not item.cloud.exists()]
    run.reporter.total(len(items), len(items) - len(todo))
    run.map(partial(_shot, folder=run.folder, settings=run.settings), todo)
    remove(run.path(_FOLDER, ".tiles"))
    return Outcome({"shots": len(items)})


def shot_views(scene: Scene, frame: int) -> list[ViewPlan]:
    """The images of one frame with the poses of their sensors in the rig's frame: those that hang, if any do.

    Raises InputError for a sensor without intrinsics or place in the rig.
    """
    views, own = [], carries(scene)
    for image in np.flatnonzero((scene.frame == frame) & (own.all() | ~own)):
        sensor = scene.sensor_of(int(image))
        if sensor.sensor_from_rig is None or not np.isfinite(sensor.sensor_from_rig).all():
            raise InputError(f"sensor {sensor.name}: its place in the rig is unknown; a shot needs it (rig.toml)")
        if sensor.camera is None or not sensor.camera.has_prior_focal_length:
            raise InputError(f"sensor {sensor.name}: its intrinsics are unknown; a shot needs them (rig.toml)")
        views.append(ViewPlan(scene.names[image], CameraModel.of(sensor.camera), sensor.sensor_from_rig))
    return views


def cloud_path(folder: Path, scene: Scene, frame: int) -> Path:
    """Where the cloud of a frame is."""
    sequence = int(scene.sequence[frame])
    name = shortened(scene.sequences[sequence].replace("/", "_")) if sequence >= 0 else "shot"
    return folder / _FOLDER / f"{name}_{frame:06d}.ply"


@dataclass(frozen=True)
class _Shot:
    """One shot: where its cloud goes, its images, and the depths that are looked for."""

    cloud: Path
    views: list[ViewPlan]
    depths: DepthRange


def _shot(item: _Shot, folder: Path, settings: Settings) -> None:
    """Depth maps and cloud of one shot."""
    path = item.cloud
    dense, tuning, images = settings.dense, settings.tuning.dense, folder / "images"
    plan = plan_shot(item.views, item.depths, dense, tuning)
    masks = folder / "masks" if (folder / "masks").is_dir() else None
    first = {n: depth_map(p, images, masks, dense, tuning, cv2.getNumThreads()) for n, p in plan.images.items()}
    for name, image in plan.images.items():
        save_depth(confirmed_map(image, first[name], first.get, dense, tuning)[0], depth_path(folder, name))
    colours = coloured(plan.images, images, dense, tuning.views)
    maps = Maps(lambda name: load_map(depth_path(folder, name)), colours)
    tiles = folder / _FOLDER / ".tiles"
    tiles.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=tiles) as scratch:
        try:
            fused = fuse(sorted(plan.images), maps, Path(scratch), settings.cloud, settings.tuning.cloud)
        except ReconstructionError as error:
            raise ReconstructionError(f"{path.stem}: {error}") from None
        with replacing(path) as temporary:
            write_cloud(fused.clouds(), temporary)


def depth_path(folder: Path, name: str) -> Path:
    """Where the depth map of an image of a shot is."""
    return folder / _FOLDER / "depth" / f"{name}.npz"
