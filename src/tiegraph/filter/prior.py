"""Matches against a model of the survey that is known to be roughly right: that of the previews.

A rough model says more than loops of rotations: a wall that repeats along the way of travel gives false matches with
the right rotation and on the right epipolar lines, but at impossible distances.
"""

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.filter.bearings import Matches
from tiegraph.filter.tuning import PriorTuning
from tiegraph.geometry import transforms
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Prior:
    """A rough model: cam_from_world (N, 4, 4), NaN = not there or not trusted; reach (N, 2): nearest and farthest
    points each image sees, same units."""

    cam_from_world: np.ndarray
    reach: np.ndarray
    mount_deg: np.ndarray | None = None  # (N,) by which an image's place in its rig may be turned; None = by nothing

    def tolerance_deg(self, i: int, j: int, same_sensor: bool, least_deg: float) -> float:
        """How far a true match of two images may be off course. Of one sensor the error of its mounting cancels as far
        as the images are not turned against each other: below a bridge two passes are, by half a turn."""
        if self.mount_deg is None:
            return least_deg
        turn = transforms.angle_deg(self.cam_from_world[i, :3, :3], self.cam_from_world[j, :3, :3])
        lever = 2 * np.sin(np.radians(turn) / 2) if same_sensor else 1.0
        return float(least_deg + lever * max(self.mount_deg[i], self.mount_deg[j]))

    def known(self) -> np.ndarray:
        """(N,) bool: images it can judge."""
        return np.all(np.isfinite(self.cam_from_world), axis=(1, 2)) & np.all(np.isfinite(self.reach), axis=1)


def held_by_rig(prior: Prior, scene: Scene, tuning: PriorTuning) -> Prior:
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
    told = (seeing >= tuning.min_seeing * of)[scene.sensor_key]
    held = placed & ~known & beside & told
    nearest, farthest = prior.reach[known, 0].min(), prior.reach[known, 1].max()
    reach = np.where(held[:, None], (nearest / tuning.any_distance, farthest * tuning.any_distance), prior.reach)
    return replace(prior, reach=reach, mount_deg=np.where(held, tuning.mount_deg, 0.0))


def agreement(pair: tuple[int, int], matches: Matches, prior: Prior, tuning: PriorTuning) -> float:
    """Share of the verified matches of an image pair that a surface within reach explains; NaN without any."""
    i, j = pair
    a, b = matches.rays(i, j)
    if not len(a):
        return float("nan")
    j_from_i = prior.cam_from_world[j] @ transforms.invert(prior.cam_from_world[i])
    off = off_course_deg(a, b, j_from_i, prior.reach[i], tuning)
    back = off_course_deg(b, a, transforms.invert(j_from_i), prior.reach[j], tuning)
    same = bool(matches.sensor[i] == matches.sensor[j])
    return float(np.mean(np.maximum(off, back) <= prior.tolerance_deg(i, j, same, tuning.tolerance_deg)))


def off_course_deg(
    a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: np.ndarray, tuning: PriorTuning
) -> np.ndarray:
    """(M,) least angle in degrees between rays b (M, 3) and where the points on rays a (M, 3), at all distances within
    ``reach`` (2,) times ``margin``, would be seen."""
    near, far = reach[0] / tuning.margin, reach[1] * tuning.margin
    distance = np.geomspace(near, far, tuning.steps)
    course = distance[:, None, None] * (a @ b_from_a[:3, :3].T) + b_from_a[:3, 3]  # (steps, M, 3)
    course /= np.maximum(np.linalg.norm(course, axis=2, keepdims=True), 1e-12)
    along = np.diff(course, axis=0)
    share = np.sum((b - course[:-1]) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-18)
    nearest = course[:-1] + np.clip(share, 0, 1)[..., None] * along
    nearest /= np.linalg.norm(nearest, axis=2, keepdims=True)
    cosine = np.max(np.sum(nearest * b, axis=2), axis=0)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))
