"""Focal lengths of cameras of which nothing is known, from the images alone.

Two images determine the focal lengths f, g of their cameras by their fundamental matrix F: only with the right ones the
two singular values of K(g)^T F K(f) that are not zero are equal, because the product is then an essential matrix
(Mendonca and Cipolla 1999). One pair says little. The cost of all pairs is the sum of the roots of the values' relative
differences, so that false pairs count little. It has a minimum within 15 % of the adjusted focal length (canals, also
in fog and in the dark; Herz-Jesus-P8, fountain-P11, oppaiyama, sceaux, uav_bands, PandaSet); the mapper's adjustment
does the rest.

COLMAP's view graph calibration has the same aim, but it stays near the value from which it starts: from 1.2 longer
sides it ends at 0.5 to 1.3 for the six equal lenses of 0.48 of a canal.

Pairs in a straight line without rotation determine no focal length, and pairs of a plane a wrong one: both are left
out. A vehicle that drives straight on has no others of one camera, but those of two cameras of its rig, which are
turned. The cameras have one focal length unless their pairs deny it. If these do not agree (bootstrap), the guess
stays.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
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

Pair = tuple[np.ndarray, np.ndarray]
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

    The cameras of a rig that have the same image size are taken to have the same lens, unless their pairs deny it.
    Fisheye lenses and panoramas keep their guess.
    """
    rigs, notes, unknown = list(scene.rigs), [], list(_unknown(scene))
    if not unknown:
        return scene, []
    verified = read_verified(database, scene, refused)
    for index, sensors in unknown:
        camera = cast(pycolmap.Camera, rigs[index].sensors[sensors[0]].camera)
        size, first = (camera.width, camera.height), scene.first_sensor(index)
        pairs = _pairs(scene, verified, [first + k for k in sensors], tuning)
        lengths = focal_lengths(pairs, size, tuning)
        own = list(rigs[index].sensors)
        for length in sorted(set(lengths.values())):
            those = [sensors[k] for k in sorted(lengths) if lengths[k] == length]
            for k in those:
                own[k] = replace(own[k], camera=_with_focal_length(own[k].camera, length))
            names = ", ".join(own[k].name for k in those)
            notes.append(
                f"the focal length of {names} is not known: relative to each other the images are taken with about "
                f"{length:.0f} px ({length / max(size):.2f} of the longer side), from which the model starts"
            )
        rigs[index] = replace(rigs[index], sensors=tuple(own))
    for note in notes:
        _log.info("%s", note)
    return (scene.with_(rigs=tuple(rigs)) if notes else scene), notes


def focal_lengths(
    pairs: Mapping[tuple[int, int], Sequence[Pair]], size: tuple[int, int], tuning: FocalTuning, seed: int = 0
) -> dict[int, float]:
    """The focal lengths in pixels of the cameras, by number, that took image pairs with matches (K, 2), (K, 2) px in
    images of ``size`` (width, height); ``pairs``: by the cameras of both. Cameras whose focal length they do not
    determine are left out."""
    made = {key: [c for a, b in some if (c := _curve(a, b, size, key[0] == key[1], tuning)) is not None]
            for key, some in pairs.items()}  # fmt: skip
    costs = {key: np.sqrt(curves) for key, curves in made.items() if curves}
    if sum(len(c) for c in costs.values()) < tuning.least_pairs:
        return {}
    rng, cameras = np.random.default_rng(seed), sorted({k for key in pairs for k in key})
    whole = {key: c.sum(axis=0) for key, c in costs.items()}
    best = _best(whole, cameras)
    draws = [{key: c[rng.integers(0, len(c), len(c))].sum(axis=0) for key, c in costs.items()} for _ in range(_SAMPLES)]
    low, high = np.percentile(TRIED[[_best(draw, cameras) for draw in draws]], (10, 90), axis=0)
    sure = (best > 0) & (best < len(TRIED) - 1) & (high <= tuning.sure * low)
    found, one = {}, int(best[-1])  # of all cameras
    for k, own, is_sure in zip(cameras, best, sure):
        cost = _along(k, whole, dict(zip(cameras, best)))
        index = own if is_sure and (not sure[-1] or cost[own] < tuning.denied * cost[one]) else one
        if is_sure if index != one else sure[-1]:
            found[k] = float(TRIED[index] * max(size))
    return found


def _best(costs: Mapping[tuple[int, int], np.ndarray], cameras: Sequence[int]) -> np.ndarray:
    """Indices (N + 1,) of the focal lengths of least cost of each camera, and of the one of all cameras, from which
    each is sought in turn. ``costs`` are (T,) of one camera's pairs, (T, T) of those of two."""
    one = int(sum(c if c.ndim == 1 else c.diagonal() for c in costs.values()).argmin())  # type: ignore[union-attr]
    best = dict.fromkeys(cameras, one)
    for _ in cameras:
        for k in cameras:
            if (cost := _along(k, costs, best)).any():
                best[k] = int(cost.argmin())
    return np.array([*best.values(), one])


def _along(k: int, costs: Mapping[tuple[int, int], np.ndarray], best: Mapping[int, int]) -> np.ndarray:
    """(T,) the cost over the focal length of a camera, with the best ones of the others."""
    terms = (c if a == b else c[:, best[b]] if a == k else c[best[a]] for (a, b), c in costs.items() if k in (a, b))
    return sum(terms, np.zeros(len(TRIED)))


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
) -> dict[tuple[int, int], list[Pair]]:
    """The matches of the pairs of one camera's images that have most of them, equally many pairs of each camera, and
    as many of two cameras; cameras by their place in ``keys``. What a rig takes at one time has one geometry in all its
    frames, and so has what cameras take that stand still and have no pairs of their own: that is no more than one
    witness, and is left out."""
    found: dict[tuple[int, int], list[Pair]] = {}
    if not len(verified.pairs):
        return found
    of, count = scene.sensor_key[verified.pairs], np.array([len(m) for m in verified.matches])
    place = {key: k for k, key in enumerate(keys)}
    frame = scene.frame[verified.pairs]
    use = np.isin(of, keys).all(axis=1) & (count >= tuning.least_matches) & (frame[:, 0] != frame[:, 1])
    cameras = np.sort(of[use], axis=1)
    kinds, kind = np.unique(cameras, axis=0, return_inverse=True)
    alone = kinds[:, 0] == kinds[:, 1]
    moves = np.isin(kinds, kinds[alone]).all(axis=1)
    share = max(1, tuning.pairs // len(keys)), max(1, tuning.pairs // max(1, np.count_nonzero(moves & ~alone)))
    for n in np.flatnonzero(moves):
        first, second = kinds[n]
        some = np.flatnonzero(use)[kind.ravel() == n]
        out = found.setdefault((place[first], place[second]), [])
        for k in some[np.argsort(-count[some], kind="stable")][: share[int(first != second)]]:
            ends = zip(verified.pairs[k], verified.matches[k].T)
            a, b = (verified.xy[int(i)][m] for i, m in sorted(ends, key=lambda e: scene.sensor_key[e[0]]))
            out.append((a, b))
    return found


def _curve(
    a: np.ndarray, b: np.ndarray, size: tuple[int, int], one_lens: bool, tuning: FocalTuning
) -> np.ndarray | None:
    """Relative difference of the two singular values for the tried focal lengths, (T,) of one lens, (T, T) of two;
    None if the matches (K, 2), (K, 2) px show a plane or no rotation."""
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
    other = k if one_lens else k[None]
    values = np.linalg.svd(other.swapaxes(-1, -2) @ matrix @ (k if one_lens else k[:, None]), compute_uv=False)
    cost = (values[..., 0] - values[..., 1]) / (values[..., 0] + values[..., 1])
    return cost if (cost if one_lens else cost.diagonal()).max() > tuning.tells else None


def _with_focal_length(given: pycolmap.Camera | None, focal_px: float) -> pycolmap.Camera:
    camera = copy(cast(pycolmap.Camera, given))
    params = np.array(camera.params)
    params[list(camera.focal_length_idxs())] = focal_px
    camera.params = list(params)
    return camera
