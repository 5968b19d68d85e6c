"""Glue of the single-shot mode: a point cloud for each shot of a calibrated rig, without any sparse model; and the
cloud of each posed shot from its rig's frame into the world of the georeferenced model.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.cloud.fuse import Maps, fuse
from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.plan import CameraModel, DepthRange, ViewPlan
from tiegraph.dense.shot import Seen, ShotScale, depth_range, in_camera, plan_shot, shot_scale
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.pipeline.dense import colours
from tiegraph.pipeline.files import load_map, load_model, whole, world_origin, world_unit
from tiegraph.project.folder import must_be_empty
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.project.stages import Outcome
from tiegraph.scene.atomic import replacing, scratch_folder
from tiegraph.scene.cloudfile import read_cloud, write_cloud
from tiegraph.scene.colmapmodel import image_poses, tracks
from tiegraph.scene.composed import carries
from tiegraph.scene.names import shortened
from tiegraph.scene.posefile import write_tum
from tiegraph.scene.results import save_depth
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses, rig_from_sensor
from tiegraph.text import command

_FOLDER = "shots"
POSES = "poses.tum"


def shots(run: Run) -> Outcome:
    """One cloud a shot (``shots/<pass>_<number>.ply``, in the frame of the rig's first camera) and its depth maps.

    Finished shots are skipped. Raises InputError for a rig whose cameras are not all calibrated.
    """
    scene, sought = whole(run), run.settings.shots
    items = []
    for frame in range(scene.frames):
        views = shot_views(scene, frame)
        found = depth_range(views, sought.near_m, sought.far_m)
        items.append(_Shot(cloud_path(run.folder, scene, frame), views, found))
    todo = [item for item in items if not item.cloud.exists()]
    run.reporter.total(len(items), len(items) - len(todo))
    run.map(partial(_shot, folder=run.folder, settings=run.settings), todo)
    return Outcome({"shots": len(items)})


def shot_views(scene: Scene, frame: int) -> list[ViewPlan]:
    """The images of one frame with the poses of their sensors in the rig's frame: the dependent ones, if there are any.

    Raises InputError for a sensor without intrinsics or pose in the rig.
    """
    views, own = [], carries(scene)
    for image in np.flatnonzero((scene.frame == frame) & (own.all() | ~own)):
        sensor = scene.sensor_of(int(image))
        if sensor.sensor_from_rig is None or not np.isfinite(sensor.sensor_from_rig).all():
            raise InputError(f"sensor {sensor.name}: its pose in the rig is unknown; a shot needs it (rig.toml)")
        if sensor.camera is None or not sensor.camera.has_prior_focal_length:
            raise InputError(f"sensor {sensor.name}: its intrinsics are unknown; a shot needs them (rig.toml)")
        views.append(ViewPlan(scene.names[image], CameraModel.of(sensor.camera), sensor.sensor_from_rig))
    return views


def cloud_path(folder: Path, scene: Scene, frame: int) -> Path:
    """The file of a frame's cloud."""
    sequence = int(scene.sequence[frame])
    name = shortened(scene.sequences[sequence].replace("/", "_")) if sequence >= 0 else "shot"
    return folder / _FOLDER / f"{name}_{frame:06d}.ply"


@dataclass(frozen=True)
class _Shot:
    cloud: Path
    views: list[ViewPlan]
    depths: DepthRange


def _shot(item: _Shot, folder: Path, settings: Settings) -> None:
    path = item.cloud
    dense, tuning, images = settings.dense, settings.tuning.dense, folder / "images"
    plan = plan_shot(item.views, item.depths, dense, tuning)
    masks = folder / "masks" if (folder / "masks").is_dir() else None
    first = {n: depth_map(p, images, masks, dense, tuning, cv2.getNumThreads()) for n, p in plan.images.items()}
    for name, image in plan.images.items():
        save_depth(confirmed_map(image, first[name], first.get, dense, tuning)[0], depth_path(folder, name))
    drawn = partial(colours, plans=plan.images, images=images, settings=dense)
    maps = Maps(lambda name: load_map(depth_path(folder, name)), drawn)
    tiles = folder / _FOLDER / ".tiles"
    tiles.mkdir(parents=True, exist_ok=True)
    with scratch_folder(tiles) as scratch:
        try:
            fused = fuse(sorted(plan.images), maps, scratch, settings.cloud, settings.tuning.cloud)
        except ReconstructionError as error:
            raise ReconstructionError(f"{path.stem}: {error}") from None
        with replacing(path) as temporary:
            write_cloud(fused.clouds(), temporary)


def depth_path(folder: Path, name: str) -> Path:
    """The file of the depth map of an image of a shot."""
    return folder / _FOLDER / "depth" / f"{name}.npz"


def posed_shots(run: Run, folder: Path) -> tuple[list[Path], str]:
    """Write the clouds of the shots whose frames have a pose to ``folder`` as LAZ, and the poses as ``poses.tum`` (time
    = number of the shot, metres), the start values of `tiegraph stations`; the clouds, and notes.

    A model without scale gets that of the shots. Raises InputError without shots, poses or metres, and for a folder
    that exists and is not empty.
    """
    scene = whole(run)
    frames = [f for f in range(scene.frames) if cloud_path(run.folder, scene, f).exists()]
    if not frames:
        raise InputError(f"{run.folder} has no shots: run `tiegraph shots` first")
    if not run.path("world.json").exists() or not run.path("sparse", "world").exists():
        raise InputError(
            f"--posed {folder}: {run.folder} has no poses in the world yet: "
            f"`{command('run', 'IMAGES', '-o', run.folder, '--rig', 'RIG', '--until', 'georef')}` makes them"
        )
    must_be_empty(folder, "--posed")
    model = load_model(run.path("sparse", "world"))
    poses = np.where(carries(scene)[:, None, None], image_poses(model, scene), np.nan)
    unit, said = 1.0, ""
    if world_unit(run.folder) != "m":
        found = _scale_by_shots(run, scene, model, poses)
        if found is None:
            raise InputError(
                f"--posed {folder}: the model of {run.folder} has no scale, but shots are in metres: determine it by "
                "the rig, positions, control points or scale bars; its own points do not lie on the shots either"
            )
        unit = found.metres_per_unit
        said = (
            f"the model had no scale: {unit:.6g} m a unit by {found.points} of its points on the depth maps of "
            f"{found.shots} shots (relative sigma {found.sigma:.2g})"
        )
    world_from_rig = frame_poses(poses, scene, unit)
    world_from_rig[:, :3, 3] *= unit
    written = _write(run, folder, {f: world_from_rig[f] for f in frames}, scene)
    if not written:
        raise InputError(f"--posed {folder}: none of the {len(frames)} shots has a pose in {run.folder}")
    write_tum(folder / POSES, np.array(frames, float), world_from_rig[frames])
    return written, said


def _write(run: Run, folder: Path, poses: dict[int, np.ndarray], scene: Scene) -> list[Path]:
    origin, written = world_origin(run.folder), []
    for frame, pose in poses.items():
        if not np.isfinite(pose).all():
            continue
        source = cloud_path(run.folder, scene, frame)
        cloud = read_cloud(source)
        moved = replace(cloud.moved(pose), origin=origin)
        target = folder / f"{source.stem}.laz"
        write_cloud(moved, target, float(np.nanmedian(cloud.sigma_m)))
        written.append(target)
    return written


def _scale_by_shots(run: Run, scene: Scene, model: Any, poses: np.ndarray) -> ShotScale | None:
    """Metres in a unit of a model by the depth maps of its shots; None if it has no points on them."""
    xyz, image, point = tracks(model, scene)
    mounted = rig_from_sensor(scene)
    seen = []
    for k in np.flatnonzero(np.isfinite(poses).all(axis=(1, 2))):
        frame, local = int(scene.frame[k]), in_camera(poses[k], xyz[point[image == k]])
        for view in shot_views(scene, frame):
            path = depth_path(run.folder, view.name)
            if path.exists():
                seen.append(Seen(shot=frame, points=local, rig_from_camera=mounted[k], depth=load_map(path)))
    return shot_scale(seen)
