"""Glue of posed shots: the cloud of each shot from its rig's frame into the world of the georeferenced model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.pipeline.files import load_model, scanned
from tiegraph.pipeline.placed import world_origin, world_unit
from tiegraph.pipeline.shots import cloud_path
from tiegraph.project.run import Run
from tiegraph.scene.cloudfile import read_cloud, write_cloud
from tiegraph.sfm.model import frame_poses, image_poses


def posed_shots(run: Run, folder: Path) -> list[Path]:
    """Write the clouds of the shots whose frames have a pose to ``folder`` as LAZ; their files.

    Raises InputError without shots, poses or metres, and for a folder that is there and not empty.
    """
    scene = scanned(run)
    frames = [f for f in range(scene.frames) if cloud_path(run.folder, scene, f).exists()]
    if not frames:
        raise InputError(f"{run.folder} has no shots: run `tiegraph shots` first")
    if not run.path("world.json").exists() or not run.path("sparse", "world").exists():
        raise InputError(
            f"--posed {folder}: {run.folder} has no poses in the world yet: `tiegraph run IMAGES -o {run.folder} "
            "--rig RIG --until georef` makes them"
        )
    if world_unit(run) != "m":
        raise InputError(
            f"--posed {folder}: the model of {run.folder} has no scale, and shots are in metres: fix it by the rig, "
            "positions, control points or scale bars"
        )
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"--posed {folder} is there already: give a new folder")
    world_from_rig = frame_poses(image_poses(load_model(run.path("sparse", "world")), scene), scene)
    origin, written = world_origin(run), []
    for frame in frames:
        pose = world_from_rig[frame]
        if not np.isfinite(pose).all():
            continue
        source = cloud_path(run.folder, scene, frame)
        cloud = read_cloud(source)
        normal = (cloud.normal @ pose[:3, :3].T).astype(np.float32)
        moved = replace(cloud, xyz_m=transforms.apply(pose, cloud.xyz_m), normal=normal, origin=origin)
        target = folder / f"{source.stem}.laz"
        write_cloud(moved, target, float(np.nanmedian(cloud.sigma_m)))
        written.append(target)
    if not written:
        raise InputError(f"--posed {folder}: none of the {len(frames)} shots has a pose in {run.folder}")
    return written
