"""Poses of images, by their names, as poses of the frames' rigs."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import centre, rigid
from tiegraph.scan.priors.positions import Frames
from tiegraph.scan.priors.times import absent
from tiegraph.scan.tuning import TrajectoryTuning
from tiegraph.scene.names import plain_name
from tiegraph.scene.results import Trajectory
from tiegraph.scene.startplace import called


def poses_by_image(
    trajectory: Trajectory, path: Path, frames: Frames, notes: list[str], tuning: TrajectoryTuning, metric: bool = True
) -> np.ndarray:
    """world_from_rig (F, 4, 4) of the frames by the poses of their images; NaN where none has one.

    Of several images of a frame the rig's reference camera counts, else the first whose place on the rig is known. A
    world that is not ``metric`` is stretched to the lengths of the rigs, where frames with several images tell. What is
    not used is in the notes. Raises InputError if no name is that of an image here, or a name may be of several.
    """
    found = images_by_name(trajectory.names, path, frames.names)
    pose_of = {k: trajectory.world_from_rig[row] for k, row in found.items()}
    strange = sorted(set(range(len(trajectory))) - set(found.values()))
    if strange:
        name = trajectory.names[strange[0]]
        count, why = f"{len(strange)} of {len(trajectory)} poses", absent(name, frames.names)
        notes.append(f"{called(path)}: {count} are of images that are not here, such as {name}; {why}")
    if not metric:
        unit = _metres_per_unit(pose_of, frames, tuning.least_baselines)
        if unit is not None:
            pose_of = {k: rigid(p[:3, :3], unit * p[:3, 3]) for k, p in pose_of.items()}
            notes.append(f"{called(path)}: its unit is {unit:.4g} m by the distances between the rig's cameras")
    out = np.full((len(frames.rows), 4, 4), np.nan)
    for k, row in enumerate(frames.rows):
        for image in sorted(row.images, key=lambda i: frames.sensors[i]):
            on_rig = _on_rig(frames, k, image)
            if image in pose_of and on_rig is not None:
                out[k] = pose_of[image] @ on_rig
                break
    missing = int(np.isnan(out[:, 0, 0]).sum())
    lacking = f"; {missing} of {len(out)} frames have none" if missing else ""
    notes.append(f"{called(path)}: the trajectory is taken as poses of {len(pose_of)} images by their names{lacking}")
    return out


def _on_rig(frames: Frames, frame: int, image: int) -> np.ndarray | None:
    """sensor_from_rig (4, 4) of an image of a frame, None = unknown."""
    sensor = frames.sensors[image]
    return np.eye(4) if sensor == 0 else frames.rigs[frames.rows[frame].rig].sensors[sensor].sensor_from_rig


def _metres_per_unit(pose_of: dict[int, np.ndarray], frames: Frames, least: int) -> float | None:
    """Size of a world's unit by the rigs' baselines between images of one frame; None with fewer than ``least``."""
    ratios = []
    for k, row in enumerate(frames.rows):
        known = [(i, on_rig) for i in row.images if i in pose_of and (on_rig := _on_rig(frames, k, i)) is not None]
        for (a, of_a), (b, of_b) in combinations(known, 2):
            apart = float(np.linalg.norm(pose_of[a][:3, 3] - pose_of[b][:3, 3]))
            baseline = float(np.linalg.norm(centre(of_a) - centre(of_b)))
            if apart > 0 and baseline > 0:
                ratios.append(baseline / apart)
    return float(np.median(ratios)) if len(ratios) >= least else None


def images_by_name(given: Sequence[str], path: Path, names: Sequence[str]) -> dict[int, int]:
    """Row of ``given`` for each image of ``names`` that one is of: by the full path below the image folder, else by the
    end of it, with or without the file's suffix.

    As many first folders are left away of all, as few as do: where the image folder lies in one of the names, it lies
    in the others. Raises InputError, naming them, where a name may be of several images or two may be of one, and if
    none is here.
    """
    number = _numbers(names)
    hits = [
        next(((left, number[end]) for left, end in enumerate(_ends(name)) if end in number), None) for name in given
    ]
    level = min((hit[0] for hit in hits if hit is not None), default=None)
    if level is None:
        first = given[0]
        raise InputError(f"{path}: none of its {len(given)} images is here: {first} ...; {absent(first, names)}")
    found: dict[int, int] = {}
    for row, hit in enumerate(hits):
        if hit is None or hit[0] > level:
            continue
        name, images = given[row], hit[1]
        if len(images) > 1:
            both = " or ".join(names[k] for k in images[:2])
            raise InputError(
                f"{path}: {name} may be {both} ({len(images)} images end so): it must name images with their folders"
            )
        other = given[found.setdefault(images[0], row)]
        if other != name:
            raise InputError(
                f"{path}: {other} and {name} may both be {names[images[0]]}: give the folder above as that of the "
                "images, so that folders tell them apart"
            )
    return found


def _numbers(names: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Images by their names, by the ends of their paths, and by these without their suffix; a full name is of one."""
    found: dict[str, tuple[int, ...]] = {}
    for k, name in enumerate(names):
        for end in _ends(name):
            for key in {end, str(PurePosixPath(end).with_suffix(""))}:
                found[key] = (*found.get(key, ()), k)
    return {**found, **{name: (k,) for k, name in enumerate(names)}}


def _ends(name: str) -> list[str]:
    """A path, and what is left of it without its first folders."""
    parts = [p for p in plain_name(name).split("/") if p not in ("", "..")]
    return ["/".join(parts[k:]) for k in range(len(parts))]
