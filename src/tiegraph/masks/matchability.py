"""Areas of the pictures that match and those that never do: features of neighbouring frames, without other knowledge.

A wall is found again in the next frame, water is not, however much texture it shows.

The distance of matches follows from two images: sky has no parallax, a wall that looks like sky has as much as others.
No lens is known yet. Two focal lengths are tried, and a match that is far by one of them is not called near: on walls,
kitchens and car parks every match is near by both, on clouds hardly one.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from tiegraph.masks import NAMES, OVEREXPOSED
from tiegraph.masks.frames import eroded, grey, read_small
from tiegraph.masks.tuning import Tuning

_SEED = 0
_CONFIDENCE, _TRIALS, _MOTION_TRIALS = 0.999, 1000, 200  # of RANSAC


@dataclass(frozen=True)
class Matchability:
    """Features of one image: ``xy`` (K, 2) f4 in shares of width and height; ``matched`` (K,) in the other; ``near``
    (K,) f4: its parallax as a share of what the scene's median depth would give it, 0 = infinitely far, NaN = unknown.
    """

    image: Path
    xy: np.ndarray
    matched: np.ndarray
    near: np.ndarray

    def pixels(self, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the matched features in an image of ``shape`` = (h, w)."""
        column, row = (self.xy[self.matched] * np.array(shape[1::-1], np.float32)).astype(int).T
        return row.clip(0, shape[0] - 1), column.clip(0, shape[1] - 1)


def pair_matchability(pair: tuple[Path, Path], tuning: Tuning) -> tuple[Matchability, ...]:
    """Which features of each of two images are found again in the other; () if there are too few."""
    a, b = (_features(path, tuning) for path in pair)
    if a is None or b is None:
        return ()
    (xy_a, seen_a, shape_a), (xy_b, seen_b, shape_b) = a, b
    likeness = seen_a @ seen_b.T
    partner = likeness.argmax(axis=1)
    rows = np.arange(len(seen_a))
    best = 2 - 2 * likeness[rows, partner]
    mutual = likeness.argmax(axis=0)[partner] == rows
    likeness[rows, partner] = -1
    good = mutual & (best < tuning.matchability.ratio**2 * (2 - 2 * likeness.max(axis=1)))
    moved = np.linalg.norm(xy_a - xy_b[partner], axis=1) > 2.0  # features at rest are the platform's
    chosen = np.flatnonzero(good & moved)
    if len(chosen) < tuning.matchability.min_inliers:
        return ()
    cv2.setRNGSeed(_SEED)
    try:  # which of the matches one epipolar geometry explains
        how = cv2.USAC_MAGSAC, tuning.matchability.epipolar_px, _CONFIDENCE, _TRIALS
        _, inliers = cv2.findFundamentalMat(xy_a[chosen], xy_b[partner[chosen]], *how)
    except cv2.error:  # where no geometry fits any sample, OpenCV 5 stops at an assertion of its own (model.empty())
        inliers = None
    found = chosen[:0] if inliers is None else chosen[inliers.ravel() > 0]
    if len(found) < tuning.matchability.min_inliers:
        return ()
    at_a, at_b = xy_a[found], xy_b[partner[found]]
    near = nearness(at_a, at_b, shape_a, tuning) if shape_a == shape_b else np.full(len(found), np.nan, np.float32)
    shown_a, shown_b = _shown(xy_a, at_a, at_b, shape_b, tuning), _shown(xy_b, at_b, at_a, shape_a, tuning)
    return (
        _seen(pair[0], xy_a / shape_a[::-1], found, near, shown_a),
        _seen(pair[1], xy_b / shape_b[::-1], partner[found], near, shown_b),
    )


def _shown(xy: np.ndarray, here: np.ndarray, there: np.ndarray, shape: tuple[int, int], tuning: Tuning) -> np.ndarray:
    """Which features (K, 2) the other image of ``shape`` can show, by the motion of neighbouring matches: features that
    left the image are no sign of water."""
    _, next_to = cKDTree(here).query(xy, tuning.witnesses)
    gone = xy + (there - here)[next_to].mean(axis=1)
    return ((gone >= 0) & (gone < shape[::-1])).all(axis=1)


def _seen(image: Path, xy: np.ndarray, found: np.ndarray, near: np.ndarray, shown: np.ndarray) -> Matchability:
    matched, every = np.zeros(len(xy), bool), np.full(len(xy), np.nan, np.float32)
    matched[found], every[found] = True, near
    kept = shown | matched
    return Matchability(image=image, xy=xy[kept].astype(np.float32), matched=matched[kept], near=every[kept])


def _features(path: Path, tuning: Tuning) -> tuple[np.ndarray, np.ndarray, tuple[int, int]] | None:
    image = grey(read_small(path, tuning.look_px))
    sift = cv2.SIFT_create(tuning.matchability.most_features, contrastThreshold=tuning.matchability.contrast)  # type: ignore[attr-defined]
    points, seen = sift.detectAndCompute(image, None)
    if seen is None or len(seen) < tuning.matchability.min_inliers:
        return None
    root = np.sqrt(seen / np.maximum(seen.sum(axis=1, keepdims=True), 1e-6))
    return np.array([p.pt for p in points], np.float32), root, (image.shape[0], image.shape[1])


def choose_pairs(cameras: Sequence[Sequence[Path]], tuning: Tuning) -> list[list[tuple[Path, Path]]]:
    """Neighbouring images of each camera, spread over its sequence, ``samples`` of all cameras together."""
    each, chosen = tuning.each(len(cameras)), []
    for images in cameras:
        starts = np.unique(np.linspace(0, max(0, len(images) - 2), min(each, max(0, len(images) - 1))).astype(int))
        chosen.append([(images[k], images[k + 1]) for k in starts])
    return chosen


def nearness(a: np.ndarray, b: np.ndarray, shape: tuple[int, int], tuning: Tuning) -> np.ndarray:
    """Parallax (K,) f4 of matches ``a``, ``b`` (K, 2) pixels of two images of ``shape`` = (h, w), as a share of that at
    the median depth of all: 0 = infinitely far, 1 = as near as the scene; NaN where it cannot be told."""
    found = np.stack([_by_focal(a, b, shape, f * max(shape), tuning) for f in tuning.matchability.focals])
    least = np.abs(found).argmin(axis=0)  # NaN counts as least: it is unknown if any does not know it
    return found[least, np.arange(len(a))].astype(np.float32)


def _by_focal(a: np.ndarray, b: np.ndarray, shape: tuple[int, int], focal: float, tuning: Tuning) -> np.ndarray:
    unknown = np.full(len(a), np.nan)
    centre = np.array(shape[::-1]) / 2
    ray_a, ray_b = (a - centre) / focal, (b - centre) / focal
    every = slice(None, None, -(-len(a) // 200))
    cv2.setRNGSeed(_SEED)
    try:
        options = cv2.RANSAC, _CONFIDENCE, tuning.matchability.epipolar_px / focal, _MOTION_TRIALS
        essential, inliers = cv2.findEssentialMat(ray_a[every], ray_b[every], np.eye(3), *options)
        if essential is None or essential.shape != (3, 3):
            return unknown
        count, rotation, towards, _ = cv2.recoverPose(essential, ray_a[every], ray_b[every], np.eye(3), mask=inliers)
    except cv2.error:  # no geometry fits
        return unknown
    if count < 8:
        return unknown
    far = np.column_stack([ray_a, np.ones(len(a))]) @ rotation.T
    x, y, z = towards.ravel()
    with np.errstate(all="ignore"):
        lever = (np.array([x, y]) * far[:, 2:] - far[:, :2] * z) / far[:, 2:] ** 2
        length = np.linalg.norm(lever, axis=1)
        inverse = ((ray_b - far[:, :2] / far[:, 2:]) * lever).sum(axis=1) / length**2
        middle = np.nanmedian(inverse)
        # Px by which the scene's median depth must move a match
        known = (middle > 0) & (focal * length * middle > 3.0) & (far[:, 2] > 0)
        return np.where(known, inverse / middle, np.nan)


@dataclass(frozen=True)
class MatchCounts:
    """Verified matches of some images: ``inside`` (5,) by their class; of those well inside of sky with a known
    distance, how many are ``near`` and how many ``far``. ``told``: of all, how many have a known one; ``area``: of
    these images, in images; ``room``: of it, the part well inside of sky; ``white``: the overexposed part."""

    inside: np.ndarray = field(default_factory=lambda: np.zeros(len(NAMES), int))
    near: int = 0
    far: int = 0
    told: int = 0
    area: int = 0
    room: float = 0.0
    white: float = 0.0

    def __add__(self, other: "MatchCounts") -> "MatchCounts":
        return MatchCounts(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})


def matches_in(labels: np.ndarray, sky: np.ndarray, matchability: Matchability, tuning: Tuning) -> MatchCounts:
    """The matches of an image by its classes (h, w) u1 and its sky (h, w) bool."""
    at = matchability.pixels(labels.shape)
    inner = eroded(sky, tuning.reach_px)
    distance = matchability.near[matchability.matched]
    told = np.isfinite(distance)
    near = distance[inner[at] & told]
    return MatchCounts(
        np.bincount(labels[at], minlength=len(NAMES)),
        near=int((near > tuning.matchability.near).sum()),
        far=int((near <= tuning.matchability.near).sum()),
        told=int(told.sum()),
        area=1,
        room=float(inner.mean()),
        white=float((labels == OVEREXPOSED).mean()),
    )


def moves(found: Sequence[Sequence[Matchability]], tuning: Tuning) -> bool:
    """Whether enough pairs of frames, ``found`` of each, verify that the cameras move; fixed parts in a rig that
    does not are the scene."""
    return sum(len(pair) > 0 for pair in found) > tuning.matchability.min_moving * len(found)


def without_sky(ties: Mapping[int, MatchCounts], tuning: Tuning) -> set[int]:
    """The cameras whose sky is refuted, because its matches are near and as dense as those of a surface. All cameras
    are judged together: above one is sky if it is above the others. (`canal_demo`: where each judged alone, one lost a
    true sky beside pale walls, 92 -> 79 % IoU.)"""
    every = sum(ties.values(), MatchCounts())
    dense = every.near * every.area > tuning.dense * every.told * every.room
    refuted = every.near + every.far >= tuning.witnesses and every.near > every.far and dense
    return set(ties) if refuted else set()


def white_ties(ties: Iterable[MatchCounts], tuning: Tuning) -> bool:
    """Whether overexposed areas match as a surface does: white paint and paper, not a burnt-out sky or deck."""
    every = sum(ties, MatchCounts())
    here, all_of_them = int(every.inside[OVEREXPOSED]), int(every.inside.sum())
    return here >= tuning.witnesses and here * every.area > tuning.dense * all_of_them * every.white
