"""Known places seen again: after a loss, to join segments, and to close loops.

Which keyframes may show the place is told by thumbnails, small blurred images (Klein and Murray 2008); what they see is
described by upright SIFT at its corners only when it is asked for, and the pose is that of the matched points.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import CORNER_PX, Images, Tracks
from tiegraph.odometry.covariance import resection_covariance
from tiegraph.odometry.tuning import PoseTuning, RecallTuning
from tiegraph.odometry.worldmap import Keyframe, Resection, WorldMap, resect

Read = Callable[[int, int], "np.ndarray | None"]
"""The grey image (H, W) of a frame and camera, None if it cannot be read."""


@dataclass(frozen=True)
class Recalled:
    """rig_from_world (4, 4) in the world of a keyframe, and what is seen of the map again: points of the map, each with
    its row (M,) in the corners that were given."""

    rig_from_world: np.ndarray
    seen: Tracks
    row: np.ndarray


def thumbnails(images: Images) -> dict[int, np.ndarray]:
    """Camera -> small image of mean 0 and length 1, of about the size of Klein and Murray's (2008)."""
    out = {}
    for camera, image in images.items():
        reduced = cv2.resize(image, (40, 24), interpolation=cv2.INTER_AREA)
        small = np.asarray(cv2.GaussianBlur(reduced, (0, 0), 1.0), np.float32)
        small -= small.mean()
        out[camera] = small / max(float(np.linalg.norm(small)), 1e-6)
    return out


def likeness(a: dict[int, np.ndarray], b: dict[int, np.ndarray]) -> float:
    """Mean correlation of the thumbnails of the cameras that both have; -1 for none."""
    both = sorted(a.keys() & b.keys())
    return float(np.mean([np.sum(a[c] * b[c]) for c in both])) if both else -1.0


class Recall:
    """Finds a frame's place in the map by keyframes. Described corners of keyframes are kept."""

    def __init__(self, world: WorldMap, read: Read, tuning: RecallTuning, pose: PoseTuning) -> None:
        self._world, self._read, self._tuning = world, read, tuning
        loose = {"inlier_px": tuning.inlier_px, "least_points": tuning.least_points}
        self._pose = pose.model_copy(update=loose)
        self._described: dict[int, tuple[Tracks, np.ndarray]] = {}
        self._sift = cv2.SIFT.create()

    def most_alike(self, thumbs: dict[int, np.ndarray], numbers: Sequence[int]) -> list[int]:
        """Of some keyframes those whose thumbnails are most like these, the best first."""
        scores = [(likeness(thumbs, self._world.keyframes[k].thumbnails), k) for k in numbers]
        good = sorted((s for s in scores if s[0] >= 0.6), key=lambda s: (-s[0], s[1]))
        return [k for _, k in good[:3]]

    def find(self, images: Images, corners: Tracks, numbers: Sequence[int]) -> Recalled | None:
        """The place of a frame with corners (their points do not matter), by the first keyframe that tells it."""
        if not numbers or len(corners) < self._tuning.least_points:
            return None
        described = [self._describe(images, corners, scale) for scale in (0.71, 1.0, 1.41)]  # it may stand nearer
        found = (self._by(number, corners, described) for number in numbers)
        return next((recalled for recalled in found if recalled is not None), None)

    def _by(self, number: int, corners: Tracks, described: Sequence[np.ndarray]) -> Recalled | None:
        seen, known = self._of(number)
        if len(seen) < self._tuning.least_points:
            return None
        theirs, ours = _matches(known, described)
        if len(ours) < self._tuning.least_points:
            return None
        point, camera, xy = seen.point[theirs], corners.camera[ours], corners.xy[ours]
        xyz = self._world.xyz[point]
        found = resect(self._world.cameras, camera, xy, xyz, None, self._pose)
        if found is None or not self._sure(found, camera, xy, xyz):
            return None
        first = np.unique(np.where(found.inlier, point, -1), return_index=True)[1]
        keep = np.isin(np.arange(len(point)), first) & found.inlier
        return Recalled(found.rig_from_world, Tracks(point, camera, xy).where(keep), ours[keep])

    def _sure(self, found: Resection, camera: np.ndarray, xy: np.ndarray, xyz: np.ndarray) -> bool:
        """Whether the points tell where the frame is: far ones in a corner of the image do not."""
        good, pose = found.inlier, found.rig_from_world
        seen = Tracks(np.arange(good.sum()), camera[good], xy[good])
        loss = self._tuning.inlier_px
        sigma = np.sqrt(np.trace(resection_covariance(self._world.cameras, pose, seen, xyz[good], loss)[:3, :3]))
        away = np.median(np.linalg.norm(transforms.apply(pose, xyz[good]), axis=1))
        return bool(sigma < 0.01 * away)

    def _of(self, number: int) -> tuple[Tracks, np.ndarray]:
        """Points with places that a keyframe sees, and their descriptors."""
        if number not in self._described:
            frame: Keyframe = self._world.keyframes[number]
            cameras = np.unique(frame.seen.camera).tolist()
            read = ((c, self._read(frame.frame, c)) for c in cameras)
            images = {c: image for c, image in read if image is not None}
            self._described[number] = frame.seen, self._describe(images, frame.seen, 1.0)
        seen, described = self._described[number]
        placed = ~np.isnan(self._world.xyz[seen.point, 0])
        return seen.where(placed), described[placed]

    def _describe(self, images: Images, corners: Tracks, scale: float) -> np.ndarray:
        out = np.zeros((len(corners), 128), np.float32)
        for camera, image in images.items():
            at = np.flatnonzero(corners.camera == camera)
            points = [cv2.KeyPoint(x, y, 12 * scale) for x, y in (corners.xy[at] - CORNER_PX).tolist()]
            kept, described = self._sift.compute(image, points)
            if len(kept) == len(at) and described is not None:
                out[at] = described / np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-6)
        return out


def _matches(known: np.ndarray, described: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Rows of known descriptors (K, 128) and of those of corners (N, 128), at several scales, that are each other's
    nearest, and much nearer than the next."""
    alike = np.max([known @ d.T for d in described], axis=0)
    best = np.argmax(alike, axis=1)
    rows = np.arange(len(known))
    nearest = alike[rows, best]
    alike[rows, best] = -1.0
    second = alike.max(axis=1)
    alike[rows, best] = nearest
    # Lowe (2004): 0.8 of the distance of the next; of unit vectors its square is twice what the product lacks to one
    clear = (1 - nearest < 0.8**2 * (1 - second)) & (np.argmax(alike, axis=0)[best] == rows)
    return rows[clear], best[clear]


def scale_to(recalled: Recalled, world: WorldMap, own: Tracks, pose: np.ndarray) -> float:
    """Old unit of length over the new one, by points that a frame sees in both: of the map (``recalled``) and of its
    own corners (``own``), whose map has the frame at ``pose``; NaN if they share none."""
    mine = world.xyz[own.point[recalled.row]]
    theirs = world.xyz[recalled.seen.point]
    both = ~np.isnan(mine[:, 0]) & ~np.isnan(theirs[:, 0])
    if not both.any():
        return float("nan")
    depth = [
        np.linalg.norm(p[both] @ m[:3, :3].T + m[:3, 3], axis=1)
        for p, m in ((theirs, recalled.rig_from_world), (mine, pose))
    ]
    return float(np.median(depth[0] / depth[1]))
