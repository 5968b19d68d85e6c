"""Glue of posed shots: the cloud of each shot from its rig's frame into the world of the georeferenced model."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.dense.shotscale import Seen, ShotScale, in_camera, shot_scale
from tiegraph.errors import InputError
from tiegraph.pipeline.files import load_map, load_model, whole, world_origin, world_unit
from tiegraph.pipeline.shots import cloud_path, depth_path, shot_views
from tiegraph.project.run import Run
from tiegraph.scan.priors.trajectory import write_tum
from tiegraph.scene.cloudfile import read_cloud, write_cloud
from tiegraph.scene.colmapmodel import tracks
from tiegraph.scene.hanging import carries
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses, image_poses, rig_from_sensor

POSES = "poses.tum"


def posed_shots(run: Run, folder: Path) -> tuple[list[Path], str]:
    """Write the clouds of the shots whose frames have a pose to ``folder`` as LAZ, and the poses as ``poses.tum`` (time
    = number of the shot, metres), from which `tiegraph stations` starts; the clouds, and what is to be said.

    A model without scale gets that of the shots. Raises InputError without shots, poses or metres, and for a folder
    that is there and not empty.
    """
    scene = whole(run)
    frames = [f for f in range(scene.frames) if cloud_path(run.folder, scene, f).exists()]
    if not frames:
        raise InputError(f"{run.folder} has no shots: run `tiegraph shots` first")
    if not run.path("world.json").exists() or not run.path("sparse", "world").exists():
        raise InputError(
            f"--posed {folder}: {run.folder} has no poses in the world yet: `tiegraph run IMAGES -o {run.folder} "
            "--rig RIG --until georef` makes them"
        )
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"--posed {folder} is there already: give a new folder")
    model = load_model(run.path("sparse", "world"))
    poses = np.where(carries(scene)[:, None, None], image_poses(model, scene), np.nan)
    unit, said = 1.0, ""
    if world_unit(run) != "m":
        found = _scale_by_shots(run, scene, model, poses)
        if found is None:
            raise InputError(
                f"--posed {folder}: the model of {run.folder} has no scale, and shots are in metres: fix it by the "
                "rig, positions, control points or scale bars; its own points do not fall onto the shots either"
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
    """The clouds of the frames that have a pose."""
    origin, written = world_origin(run), []
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
    """Metres in a unit of a model by the depth maps of its shots; None where it has no points on them."""
    xyz, image, point = tracks(model, scene)
    mounted, tuning = rig_from_sensor(scene), run.settings.tuning.dense.shot_scale
    seen = []
    for k in np.flatnonzero(np.isfinite(poses).all(axis=(1, 2))):
        frame, local = int(scene.frame[k]), in_camera(poses[k], xyz[point[image == k]])
        for view in shot_views(scene, frame):
            path = depth_path(run.folder, view.name)
            if path.exists():
                seen.append(Seen(shot=frame, points=local, rig_from_camera=mounted[k], depth=load_map(path)))
    return shot_scale(seen, tuning)
