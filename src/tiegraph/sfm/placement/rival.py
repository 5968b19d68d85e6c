"""Where else a frame could stand: its rig as a whole resected in the points that speak against its place.

A repeated wall, or a frame that slid, leaves two places that matches agree with. Where the second has so many that the
first does not clearly win, people must hear of both, and the sigma of the frame must cover them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import matrix, rigid3d
from tiegraph.scene.scene import Scene
from tiegraph.sfm.placement.doubtful import Explained
from tiegraph.sfm.verified import sightings
from tiegraph.text import some

_NAMED = 3  # frames that a sentence names


@dataclass(frozen=True)
class Rival:
    """Another place of a frame: the ``step`` (3,) there, model units, and the sightings that agree here and there."""

    step: np.ndarray
    here: int
    there: int


def rivals(found: Explained) -> dict[int, Rival]:
    """By frame (scene index) those that matches speak for nearly as much as for where it stands, or more."""
    out, least = {}, found.tuning.agrees
    agree, all_ = found.of_frames().T
    for frame in np.flatnonzero(all_ - agree > least * agree).tolist():
        rival = _rival(found, frame)
        if rival is not None and rival.there > least * rival.here:
            out[frame] = rival
    return out


def told(found: Mapping[int, Rival], scene: Scene) -> list[str]:
    """A sentence on them, if there are any."""
    each = [
        f"{scene.frame_names[f]}: {r.here} matches agree with its place, {r.there} with one "
        f"{np.linalg.norm(r.step):.3g} units of the model away"
        for f, r in found.items()
    ]
    said = f"by their matches {len(found)} frames could stand elsewhere too, and their sigmas cover both places"
    return [f"{said} ({some(each, _NAMED)})"] if each else []


def _rival(found: Explained, frame: int) -> Rival | None:
    told, seen = sightings(found.verified, found.seen, frame), found.seen
    off = ~told.there
    images = sorted(set(told.image[off].tolist()))
    if off.sum() < found.tuning.min_votes:
        return None
    poses = [seen.cam_from_world[k] for k in images]
    cameras = [seen.cameras[k] for k in images]
    options = pycolmap.RANSACOptions(random_seed=0)
    options.max_error = seen.tuning.tolerance_rad * float(np.median([c.mean_focal_length() for c in cameras]))
    made = pycolmap.estimate_generalized_absolute_pose(
        told.xy[off], told.xyz[off], np.searchsorted(images, told.image[off]).tolist(),
        [rigid3d(p @ transforms.invert(poses[0])) for p in poses], cameras, options,
    )  # fmt: skip
    if made is None or made["num_inliers"] < found.tuning.min_votes:
        return None
    step = transforms.centre(matrix(made["rig_from_world"])) - transforms.centre(poses[0])
    return Rival(step, int(told.there.sum()), int(made["num_inliers"]))
