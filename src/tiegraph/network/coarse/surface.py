"""Points of the surface that a coarse model sees: where the rays of its tracks meet.

The mapper of a coarse model places the images by the longest tracks only, which are a seventh of all. Poses and tracks
are there, so the others cost no adjustment: each is where its rays come nearest to each other.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.tuning.coarse import TracksTuning
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.rig import pixel_rays


def with_surface(
    model: CoarseModel, ties: PreviewMatches, features: Callable[[int], np.ndarray], tuning: TracksTuning
) -> CoarseModel:
    """The model with the points of all tracks that ``ties`` join between its images.

    ``features``: pixels (K, 2) of an image's preview. Of the rays of a point the worst are left out one after another,
    at most three, while they miss it by more than ``off_deg``; it needs ``images`` others, two of them
    ``angle_deg`` apart.
    """
    placed = model.placed()
    track, image, feature = ties.where(placed[ties.i] & placed[ties.j]).observations()
    centre = transforms.centre(model.cam_from_world)[image]
    towards = np.zeros((len(image), 3))
    for k in np.unique(image):
        own = image == k
        towards[own] = pixel_rays(model.cameras[k], features(int(k))[feature[own]]) @ model.cam_from_world[k, :3, :3]
    # (K,) bool: observations of tracks that have no image twice, which a wrong match has joined of two
    order = np.lexsort((image, track))
    twice = (np.diff(track[order]) == 0) & (np.diff(image[order]) == 0)
    use = np.isfinite(towards).all(axis=1) & ~np.isin(track, track[order[1:][twice]])
    points, off = np.zeros((0, 3)), np.zeros(len(track))
    for _ in range(4):  # with more than three wrong rays it is no point
        use &= ~_worst(track, np.where(use, off, 0.0), tuning.off_deg)
        use &= _held(track, towards, use, tuning)[track]
        points = _nearest(track, centre, np.where(use[:, None], towards, np.nan))
        # (K,) angle between the way to a point and a ray
        way = points[track] - centre
        along = np.einsum("kc,kc->k", way, towards) / np.maximum(np.linalg.norm(way, axis=1), 1e-12)
        off = np.degrees(np.arccos(np.clip(along, -1, 1)))
    use &= ~np.isin(track, track[use & (off > tuning.off_deg)])
    kept, point = np.unique(track[use], return_inverse=True)
    return replace(model, points=points[kept], image=image[use], point=point)


def _worst(track: np.ndarray, off: np.ndarray, limit: float) -> np.ndarray:
    """(K,) bool: of each track the ray that misses by most, if by more than the limit."""
    most = np.zeros(int(track.max(initial=-1)) + 1)
    np.maximum.at(most, track, off)
    return (off > limit) & (off == most[track])


def _nearest(track: np.ndarray, centre: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(T, 3) point nearest to the rays of each track by least squares, NaN = not to be used; anywhere without any."""
    use, number = np.isfinite(towards).all(axis=1), int(track.max(initial=-1)) + 1
    across = np.eye(3) - towards[use, :, None] * towards[use, None, :]
    normal, right = np.zeros((number, 3, 3)), np.zeros((number, 3))
    np.add.at(normal, track[use], across)
    np.add.at(right, track[use], np.einsum("kab,kb->ka", across, centre[use]))
    return np.linalg.solve(normal + 1e-9 * np.eye(3), right[:, :, None])[:, :, 0]


def _held(track: np.ndarray, towards: np.ndarray, use: np.ndarray, tuning: TracksTuning) -> np.ndarray:
    """(T,) bool: tracks with enough rays in use, two of them far enough apart: one from their mean by half of it."""
    number = int(track.max(initial=-1)) + 1
    count = np.bincount(track[use], minlength=number)
    mean = np.zeros((number, 3))
    np.add.at(mean, track[use], towards[use])
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    least = np.ones(number)
    np.minimum.at(least, track[use], np.einsum("kc,kc->k", towards[use], mean[track[use]]))
    return (count >= tuning.images) & (least < np.cos(np.radians(tuning.angle_deg / 2)))
