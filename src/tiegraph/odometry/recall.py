"""Known places seen again: after a loss, to join segments, and to close loops.

Which keyframes may show the place is told by thumbnails, small blurred images (Klein and Murray 2008); what they see is
described by upright SIFT at its corners only when it is asked for, and the pose is that of the matched points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.odometry.cameras import Cameras
from tiegraph.odometry.follow import Images, Tracks
from tiegraph.odometry.resect import resect
from tiegraph.odometry.tuning import PoseTuning, RecallTuning
from tiegraph.odometry.worldmap import Keyframe, WorldMap

Read = Callable[[int, int], "np.ndarray | None"]
"""The grey image (H, W) of a frame and camera, None if it cannot be read."""


@dataclass(frozen=True)
class Recalled:
    """rig_from_world (4, 4) in the world of a keyframe, and what is seen of the map again: points of the map, each with
    its row (M,) in the corners that were given."""

    rig_from_world: np.ndarray
    seen: Tracks
    row: np.ndarray


def thumbnails(images: Images, tuning: RecallTuning) -> dict[int, np.ndarray]:
    """Camera -> small image of mean 0 and length 1."""
    out = {}
    for camera, image in images.items():
        reduced = cv2.resize(image, tuning.thumbnail, interpolation=cv2.INTER_AREA)
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
        good = sorted((s for s in scores if s[0] >= self._tuning.alike), key=lambda s: (-s[0], s[1]))
        return [k for _, k in good[: self._tuning.candidates]]

    def find(self, images: Images, corners: Tracks, numbers: Sequence[int]) -> Recalled | None:
        """The place of a frame with corners (their points do not matter), by the first keyframe that tells it."""
        described = self._describe(images, corners) if numbers else np.zeros((0, 128), np.float32)
        for number in numbers:
            found = self._by(number, corners, described)
            if found is not None:
                return found
        return None

    def _by(self, number: int, corners: Tracks, described: np.ndarray) -> Recalled | None:
        seen, known = self._of(number)
        if len(seen) < self._tuning.least_points or len(corners) < 2:
            return None
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(known, described, k=2)
        best = [p[0] for p in pairs if len(p) == 2 and p[0].distance < self._tuning.ratio * p[1].distance]
        if len(best) < self._tuning.least_points:
            return None
        ours, theirs = np.array([m.trainIdx for m in best]), np.array([m.queryIdx for m in best])
        point, camera, xy = seen.point[theirs], corners.camera[ours], corners.xy[ours]
        found = resect(self._world.cameras, camera, xy, self._world.xyz[point], None, self._pose)
        if found is None:
            return None
        _, once = np.unique(np.where(found.inlier, point, -1), return_index=True)
        keep = np.isin(np.arange(len(point)), once) & found.inlier
        return Recalled(found.rig_from_world, Tracks(point, camera, xy).where(keep), ours[keep])

    def _of(self, number: int) -> tuple[Tracks, np.ndarray]:
        """Points with places that a keyframe sees, and their descriptors."""
        if number not in self._described:
            frame: Keyframe = self._world.keyframes[number]
            cameras = np.unique(frame.seen.camera).tolist()
            read = ((c, self._read(frame.frame, c)) for c in cameras)
            images = {c: image for c, image in read if image is not None}
            self._described[number] = frame.seen, self._describe(images, frame.seen)
        seen, described = self._described[number]
        placed = ~np.isnan(self._world.xyz[seen.point, 0])
        return seen.where(placed), described[placed]

    def _describe(self, images: Images, corners: Tracks) -> np.ndarray:
        out = np.zeros((len(corners), 128), np.float32)
        for camera, image in images.items():
            at = np.flatnonzero(corners.camera == camera)
            points = [cv2.KeyPoint(x, y, self._tuning.patch_px) for x, y in corners.xy[at].tolist()]
            kept, described = self._sift.compute(image, points)
            if len(kept) == len(at) and described is not None:
                out[at] = described
        return out


def scale_to(cameras: Cameras, recalled: Recalled, world: WorldMap, own: Tracks, pose: np.ndarray) -> float:
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
