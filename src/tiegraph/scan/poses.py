"""Poses of images, by their names, as poses of the frames' rigs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scan.positions import Frames
from tiegraph.scan.times import absent, plain_name
from tiegraph.scene.results import Trajectory


def poses_by_image(trajectory: Trajectory, path: Path, frames: Frames, notes: list[str]) -> np.ndarray:
    """world_from_rig (F, 4, 4) of the frames by the poses of their images; NaN where none has one.

    Of several images of a frame the rig's reference camera counts, else the first whose place on the rig is known. What
    is not used is in the notes. Raises InputError if no name is that of an image here.
    """
    number = _numbers(frames.names)
    pose_of: dict[int, np.ndarray] = {}
    strange = []
    for name, pose in zip(trajectory.names, trajectory.world_from_rig):
        k = _find(name, number)
        if k is None:
            strange.append(name)
        else:
            pose_of[k] = pose
    if strange:
        why = absent(strange[0], frames.names)
        if not pose_of:
            raise InputError(f"{path}: none of its {len(strange)} images is here: {strange[0]} ...; {why}")
        notes.append(f"{path.name}: {len(strange)} of {len(trajectory)} poses are of images that are not here, such as "
                     f"{strange[0]}; {why}")  # fmt: skip
    out = np.full((len(frames.rows), 4, 4), np.nan)
    for k, row in enumerate(frames.rows):
        sensors = frames.rigs[row.rig].sensors
        for image in sorted(row.images, key=lambda i: frames.sensors[i]):
            on_rig = np.eye(4) if frames.sensors[image] == 0 else sensors[frames.sensors[image]].sensor_from_rig
            if image in pose_of and on_rig is not None:
                out[k] = pose_of[image] @ on_rig
                break
    missing = int(np.isnan(out[:, 0, 0]).sum())
    lacking = f"; {missing} of {len(out)} frames have none" if missing else ""
    notes.append(f"{path.name}: the trajectory is taken as poses of {len(pose_of)} images by their names{lacking}")
    return out


def _numbers(names: Sequence[str]) -> dict[str, int]:
    """Image by its name, by every end of its path that no other has, and by these without their suffix."""
    found: dict[str, int] = {}
    for k, name in enumerate(names):
        for end in _ends(name):
            for key in {end, str(PurePosixPath(end).with_suffix(""))}:
                found[key] = k if key not in found else -1
    return {**{key: k for key, k in found.items() if k >= 0}, **{name: k for k, name in enumerate(names)}}


def _find(name: str, number: dict[str, int]) -> int | None:
    return next((number[end] for end in _ends(name) if end in number), None)


def _ends(name: str) -> list[str]:
    """A path, and what is left of it without its first folders."""
    parts = [p for p in plain_name(name).split("/") if p not in ("", "..")]
    return ["/".join(parts[k:]) for k in range(len(parts))]
