"""Matches against a model of the survey that is known to be roughly right: that of the previews.

A rough model says more than loops of rotations: a wall that repeats along the way of travel gives false matches with
the right rotation and on the right epipolar lines, but at impossible distances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.scene.scene import Scene
from tiegraph.verify.bearings import Calibration, load

STEPS = 24  # distances between the nearest and the farthest at which a ray is followed
MARGIN = 2.0  # distances outside those of the image's model points by this factor are still possible
TOLERANCE_DEG = 1.0  # preview key points are good to 0.2 deg, their model's rotations to 0.15 deg (canal)
# Share of a pair's matches that must agree with the model. On ``canal`` (chosen there) it keeps 99.1 % of the pairs
# most of whose matches are true and 4 of 217 of which hardly any is; on ``canal_demo`` 98.6 % and 0 of 4.
MIN_SHARE = 0.25
SEEING = 0.5  # share of a sensor's images that see points, from which its place in the rig is the model's own
# What a mounting that no point holds may be off: the up camera of ``canal_demo`` 1 to 1.5 deg by a wrong focal length.
MOUNT_DEG = 1.5
ANY = 10.0  # times nearer than the nearest point of the model, and farther than the farthest: any distance
MAX_REFUSED = 0.2  # of the judged pairs: a model that contradicts more of them is wrong itself


@dataclass(frozen=True)
class Prior:
    """A rough model: cam_from_world (N, 4, 4), NaN = not there or not trusted; reach (N, 2): nearest and farthest
    points each image sees, same units."""

    cam_from_world: np.ndarray
    reach: np.ndarray
    mount_deg: np.ndarray | None = None  # (N,) by which an image's place in its rig may be turned; None = by nothing

    def tolerance_deg(self, i: int, j: int, same_sensor: bool) -> float:
        """How far a true match of two images may be off course. Of one sensor the error of its mounting cancels as far
        as the images are not turned against each other: below a bridge two passes are, by half a turn."""
        if self.mount_deg is None:
            return TOLERANCE_DEG
        turn = transforms.angle_deg(self.cam_from_world[i, :3, :3], self.cam_from_world[j, :3, :3])
        lever = 2 * np.sin(np.radians(turn) / 2) if same_sensor else 1.0
        return float(TOLERANCE_DEG + lever * max(self.mount_deg[i], self.mount_deg[j]))

    def known(self) -> np.ndarray:
        """(N,) bool: images it can judge."""
        return np.isfinite(self.cam_from_world).all(axis=(1, 2)) & np.isfinite(self.reach).all(axis=1)


def held_by_rig(prior: Prior, scene: Scene) -> Prior:
    """The prior with any distance as the reach of images that see too few points to tell theirs, but whose place is
    known: by the others of their frame, if most images of their sensor see points.

    That is what an up camera is below a bridge. Loops have little to say there: few images tie to it, and the beams of
    one bridge are alike. On ``canal`` four of the five false pairs that were left have at most 7 % of their matches on
    course at any distance, the thirteen true ones 55 % and more; the fifth is of two passes: a wider tolerance.
    """
    placed, known = np.isfinite(prior.cam_from_world).all(axis=(1, 2)), prior.known()
    if not known.any() or known[placed].all():
        return prior
    beside = np.bincount(scene.frame[known], minlength=scene.frames)[scene.frame] > 0
    sensors = len(scene.all_sensors)
    seeing, of = (np.bincount(scene.sensor_key[m], minlength=sensors) for m in (known, placed))
    told = (seeing >= SEEING * of)[scene.sensor_key]
    held = placed & ~known & beside & told
    nearest, farthest = prior.reach[known, 0].min(), prior.reach[known, 1].max()
    reach = np.where(held[:, None], (nearest / ANY, farthest * ANY), prior.reach)
    return replace(prior, reach=reach, mount_deg=np.where(held, MOUNT_DEG, 0.0))


def agreement(item: tuple[int, int], database: str, calibration: Calibration, prior: Prior) -> float:
    """Share of the verified matches of an image pair (i, j) that a surface within reach explains; NaN without any.

    ``calibration`` with units that are images (rays in the sensor's own frame).
    """
    i, j = item
    rays = load((i, j, ((i, j),)), database, calibration)
    if not len(rays.pair):
        return float("nan")
    j_from_i = prior.cam_from_world[j] @ transforms.invert(prior.cam_from_world[i])
    off = off_course_deg(rays.ray_m, rays.ray_n, j_from_i, prior.reach[i])
    back = off_course_deg(rays.ray_n, rays.ray_m, transforms.invert(j_from_i), prior.reach[j])
    tolerance = prior.tolerance_deg(i, j, bool(calibration.sensor[i] == calibration.sensor[j]))
    return float(np.mean(np.maximum(off, back) <= tolerance))


def off_course_deg(a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """(M,) least angle in degrees between rays b (M, 3) and where the points on rays a (M, 3), at all distances within
    ``reach`` (2,) times MARGIN, would be seen."""
    near, far = reach[0] / MARGIN, reach[1] * MARGIN
    distance = np.geomspace(near, far, STEPS)
    course = distance[:, None, None] * (a @ b_from_a[:3, :3].T) + b_from_a[:3, 3]  # (STEPS, M, 3)
    course /= np.maximum(np.linalg.norm(course, axis=2, keepdims=True), 1e-12)
    along = np.diff(course, axis=0)
    share = np.sum((b - course[:-1]) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-18)
    nearest = course[:-1] + np.clip(share, 0, 1)[..., None] * along
    nearest /= np.linalg.norm(nearest, axis=2, keepdims=True)
    cosine = np.max(np.sum(nearest * b, axis=2), axis=0)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))
