"""Corners and where they go: found, followed from image to image, and found in the other cameras of the rig."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.odometry.cameras import Cameras
from tiegraph.scene.sorting import Columns

CORNER_PX = 0.5
"""The middle of the first pixel, from the corner of the image, where COLMAP begins to count; OpenCV begins there."""
_EDGE_PX = 8  # closer to the edge of the image the window of a corner is cut
Images = Mapping[int, np.ndarray]
"""Camera -> its grey image (H, W) u1; a camera whose image is missing is not there."""


@dataclass(frozen=True)
class Tracks(Columns):
    """K corners in one frame: point (K,) its number in the map, camera (K,), xy (K, 2) pixels."""

    point: np.ndarray
    camera: np.ndarray
    xy: np.ndarray

    @staticmethod
    def none() -> "Tracks":
        """No corner."""
        return Tracks(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))

    def plus(self, other: "Tracks") -> "Tracks":
        """These and others."""
        both = zip((self.point, self.camera, self.xy), (other.point, other.camera, other.xy))
        return Tracks(*(np.concatenate(pair) for pair in both))


def followed(before: np.ndarray, after: np.ndarray, xy: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where corners (K, 2) of an image are in another (K, 2), from a guess (K, 2); and whether (K,) they were found."""
    if not len(xy):
        return np.zeros((0, 2)), np.zeros(0, bool)
    start, first = (np.array(v[:, None] - CORNER_PX, np.float32) for v in (xy, guess))
    how = {"winSize": (15, 15), "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}  # OpenCV's 21 is slower, and no better on KITTI
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, start, first.copy(), maxLevel=4, **how)
    # The way back starts where it should end: a short one, which a level or two will do for.
    back, returned, _ = cv2.calcOpticalFlowPyrLK(after, before, there, start.copy(), maxLevel=1, **how)
    off = np.linalg.norm((back - start)[:, 0], axis=1)
    place = there[:, 0].astype(float) + CORNER_PX
    height, width = after.shape
    inside = (place >= _EDGE_PX).all(axis=1) & (place < (width - _EDGE_PX, height - _EDGE_PX)).all(axis=1)
    return place, (found[:, 0] > 0) & (returned[:, 0] > 0) & (off < 1.0) & inside


def corners(image: np.ndarray, mask: np.ndarray | None, taken: np.ndarray) -> np.ndarray:
    """(N, 2) corners that fill an image up to 400, for more cost time and buy little; away from those it has (K, 2) and
    where the mask (H, W) is not 0."""
    spacing = 0.012 * max(image.shape)
    free = np.zeros(image.shape, np.uint8)
    free[_EDGE_PX:-_EDGE_PX, _EDGE_PX:-_EDGE_PX] = 255
    if mask is not None:
        free[mask == 0] = 0
    for x, y in np.rint(taken - CORNER_PX).astype(int).tolist():
        cv2.circle(free, (x, y), round(spacing), 0, -1)
    wanted = 400 - len(taken)
    if wanted <= 0:
        return np.zeros((0, 2))
    found = cv2.goodFeaturesToTrack(image, wanted, 0.002, spacing, mask=free)
    return np.zeros((0, 2)) if found is None else found[:, 0].astype(float) + CORNER_PX


def in_partners(
    cameras: Cameras,
    partners: Mapping[int, tuple[int, ...]],
    images: Images,
    tracks: Tracks,
    in_rig: np.ndarray,
) -> Tracks:
    """The corners as the other cameras of the rig see them at the same instant; in_rig (K, 3): about where they are."""
    out = Tracks.none()
    for camera, others in partners.items():
        for other in (o for o in others if camera in images and o in images):
            guess = np.full((len(tracks), 2), np.nan)
            at = tracks.camera == camera
            guess[at] = cameras.project(np.full(at.sum(), other), in_rig[at])
            there = at & cameras.inside(other, guess, _EDGE_PX)
            seen, guess = tracks.where(there), guess[there]
            if cameras.angle_deg(camera, other) < 5.0:
                place, found = followed(images[camera], images[other], seen.xy, guess)
            else:
                place, found = _followed_turned(cameras, (camera, other), images, seen.xy, guess)
            found &= _off_plane_px(cameras, camera, other, seen.xy, place) < 1.0
            out = out.plus(Tracks(seen.point[found], np.full(found.sum(), other), place[found]))
    return out


def _followed_turned(
    cameras: Cameras, pair: tuple[int, int], images: Images, xy: np.ndarray, guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``followed`` from one camera into another that looks elsewhere: its image is first turned to where the one looks,
    for at the edges of two wide images the same surface has shapes that no shift makes alike."""
    a, b = pair
    x, y = cameras.map_of(a, b)
    turned = cv2.remap(images[b], x, y, cv2.INTER_LINEAR)
    place, found = followed(images[a], turned, xy, cameras.turned(b, a, guess))
    there = np.full_like(place, np.nan)
    there[found] = cameras.turned(a, b, place[found])
    return there, found & cameras.inside(b, there, _EDGE_PX)


def _off_plane_px(cameras: Cameras, a: int, b: int, xy_a: np.ndarray, xy_b: np.ndarray) -> np.ndarray:
    """(K,) how far pixels in camera b are from the epipolar planes of pixels in a."""
    if not len(xy_a):
        return np.zeros(0)
    rays = [cameras.rays(np.full(len(xy), c), xy) for c, xy in ((a, xy_a), (b, xy_b))]
    way = cameras.rig_from_sensor[b, :3, 3] - cameras.rig_from_sensor[a, :3, 3]
    normal = np.cross(way, rays[0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.abs(np.sum(normal * rays[1], axis=1)) * cameras.models[b].mean_focal_length())
