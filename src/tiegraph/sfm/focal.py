"""Focal lengths of cameras of which nothing is known, from the images alone.

Two images of one camera determine its focal length f by their fundamental matrix F: only with the right f the two
singular values of K(f)^T F K(f) that are not zero are equal, because the product is then an essential matrix (Mendonca
and Cipolla 1999). One pair says little. The cost of all pairs, each with a limit so that false ones do not count, has a
minimum within 15 % of the adjusted focal length (two canals, also in fog and in the dark; Herz-Jesus-P8 and P25,
fountain-P11, oppaiyama, sceaux); the mapper's adjustment does the rest.

COLMAP's view graph calibration has the same aim, but it stays near the value from which it starts: from 1.2 longer
sides it ends at 0.5 to 1.3 for the six equal lenses of 0.48 of a canal.

Pairs in a straight line without rotation determine no focal length, and pairs of a plane a wrong one: both are left
out. If the remaining pairs do not agree (bootstrap), the guess stays.
"""

import logging
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pycolmap

from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning import FocalTuning
from tiegraph.sfm.verified import VerifiedMatches, read_verified

_log = logging.getLogger(__name__)

TRIED = np.geomspace(0.25, 4.0, 57)
"""Focal lengths that are tried, in longer sides of the image: 127 to 14 degrees of view, in steps of 5 %."""
_SAMPLES = 100  # of the bootstrap
_CONFIDENCE, _TRIALS = 0.999, 1000  # of RANSAC


def with_focal_lengths(
    scene: Scene, database: Path, refused: Sequence[tuple[int, int]], tuning: FocalTuning
) -> tuple[Scene, list[str]]:
    """The scene with the focal lengths that the verified matches of a database, without those of ``refused`` pairs,
    determine for cameras of unknown focal length; notes.

    The cameras of a rig that have the same image size are taken to have the same lens. Fisheye lenses and panoramas
    keep their guess.
    """
    rigs, notes, unknown = list(scene.rigs), [], list(_unknown(scene))
    if not unknown:
        return scene, []
    verified = read_verified(database, scene, refused)
    for index, sensors in unknown:
        camera = cast(pycolmap.Camera, rigs[index].sensors[sensors[0]].camera)
        size, first = (camera.width, camera.height), scene.first_sensor(index)
        pairs = _pairs(scene, verified, [first + k for k in sensors], tuning)
        found = focal_length(pairs, size, tuning)
        if found is None:
            continue
        own = list(rigs[index].sensors)
        for k in sensors:
            own[k] = replace(own[k], camera=_with_focal_length(own[k].camera, found))
        rigs[index] = replace(rigs[index], sensors=tuple(own))
        names = ", ".join(own[k].name for k in sensors)
        notes.append(
            f"the focal length of {names} is not known: relative to each other the images are taken with about "
            f"{found:.0f} px ({found / max(size):.2f} of the longer side), from which the model starts"
        )
    for note in notes:
        _log.info("%s", note)
    return (scene.with_(rigs=tuple(rigs)) if notes else scene), notes


def focal_length(
    pairs: Sequence[tuple[np.ndarray, np.ndarray]], size: tuple[int, int], tuning: FocalTuning, seed: int = 0
) -> float | None:
    """The focal length in pixels of the lens that took image pairs with matches (K, 2), (K, 2) px in images of
    ``size`` (width, height); None if they do not determine it."""
    curves = [c for a, b in pairs if (c := _curve(a, b, size, tuning)) is not None]
    if len(curves) < tuning.least_pairs:
        return None
    cost = np.minimum(curves, tuning.cap)
    samples = np.random.default_rng(seed).integers(0, len(cost), (_SAMPLES, len(cost)))
    low, high = np.percentile(TRIED[cost[samples].mean(axis=1).argmin(axis=1)], (10, 90))
    best = int(cost.mean(axis=0).argmin())
    if best in (0, len(TRIED) - 1) or high > tuning.sure * low:
        return None
    return float(TRIED[best] * max(size))


def _unknown(scene: Scene) -> Iterator[tuple[int, list[int]]]:
    """Rig by rig the sensors (numbers in the rig) of unknown focal length that have one image size."""
    for index, rig in enumerate(scene.rigs):
        same: dict[tuple[int, int], list[int]] = {}
        for k, sensor in enumerate(rig.sensors):
            camera = sensor.camera
            if camera is not None and not camera.has_prior_focal_length and "FISHEYE" not in camera.model.name:
                same.setdefault((camera.width, camera.height), []).append(k)
        yield from ((index, sensors) for sensors in same.values())


def _pairs(
    scene: Scene, verified: VerifiedMatches, keys: Sequence[int], tuning: FocalTuning
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The matches of the pairs of one camera's images that have most of them, equally many pairs of each camera."""
    if not len(verified.pairs):
        return []
    of, count = scene.sensor_key[verified.pairs], np.array([len(m) for m in verified.matches])
    out = []
    for key in keys:
        own = np.flatnonzero((of == key).all(axis=1) & (count >= tuning.least_matches))
        for k in own[np.argsort(-count[own], kind="stable")][: max(1, tuning.pairs // len(keys))]:
            (i, j), matches = verified.pairs[k], verified.matches[k]
            out.append((verified.xy[int(i)][matches[:, 0]], verified.xy[int(j)][matches[:, 1]]))
    return out


def _curve(a: np.ndarray, b: np.ndarray, size: tuple[int, int], tuning: FocalTuning) -> np.ndarray | None:
    """Relative difference (T,) of the two singular values for the tried focal lengths; None if the matches (K, 2),
    (K, 2) px show a plane or no rotation."""
    a, b, error = np.asarray(a, float), np.asarray(b, float), tuning.error * max(size)
    try:
        matrix, inliers = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, error, _CONFIDENCE, _TRIALS)
        _, flat = cv2.findHomography(a, b, cv2.USAC_MAGSAC, error, None, _TRIALS, _CONFIDENCE)
    except cv2.error:  # where no geometry fits any sample, OpenCV 5 stops at an assertion of its own (model.empty())
        return None
    if matrix is None or matrix.shape != (3, 3) or (flat is not None and flat.sum() > tuning.flat * inliers.sum()):
        return None
    k = np.zeros((len(TRIED), 3, 3))
    k[:, 0, 0] = k[:, 1, 1] = TRIED * max(size)
    k[:, 0, 2], k[:, 1, 2], k[:, 2, 2] = size[0] / 2, size[1] / 2, 1
    values = np.linalg.svd(k.transpose(0, 2, 1) @ matrix @ k, compute_uv=False)
    cost = (values[:, 0] - values[:, 1]) / (values[:, 0] + values[:, 1])
    return cost if cost.max() > tuning.cap else None


def _with_focal_length(given: pycolmap.Camera | None, focal_px: float) -> pycolmap.Camera:
    camera = copy(cast(pycolmap.Camera, given))
    params = np.array(camera.params)
    params[list(camera.focal_length_idxs())] = focal_px
    camera.params = list(params)
    return camera
