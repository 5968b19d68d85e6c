"""Lens errors beyond the camera model: a smooth field of shifts over the image of each camera."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.sfm.adjustment.jacobians import System
from tiegraph.sfm.systematic.effects import Effect, EffectWeights, likeliest, posterior

_BINS = (12, 8)  # of an image, along its longer side and the other
_REACHES = (0.1, 0.2, 0.4, 0.8)  # of the image's diagonal: correlation lengths of a lens error
_TOLD_SIGMAS = 4.0  # bins that are off by more are listed


@dataclass(frozen=True)
class LensError:
    """The error of a lens beyond its model: its RMS ``rms_px``, correlation length, worst bins, and effect."""

    camera: int
    rms_px: float
    reach_px: float
    worst: tuple[tuple[float, ...], ...]  # rows x, y of the bin's middle, mean dx, dy of the residuals, sigmas


def lens_errors(
    model: pycolmap.Reconstruction, weighed: EffectWeights
) -> tuple[list[tuple[LensError, Effect]], np.ndarray]:
    """The shared error of each camera whose residuals show one over the image, and (2O,) the part of the residuals
    that it explains."""
    out, explained = [], np.zeros(2 * len(weighed.seen.image))
    for key in np.unique(weighed.seen.camera).tolist():
        found = _lens_error(model.camera(key), weighed)
        if found is not None:
            out.append(found[:2])
            explained += found[2]
    return out, explained


def _lens_error(camera: pycolmap.Camera, weighed: EffectWeights) -> tuple[LensError, Effect, np.ndarray] | None:
    bins = _bins(camera, weighed.seen)
    middle, told = bins.middle, weighed.score(bins.columns)
    gradient, score, noise, information = told.gradient, told.score, told.ridged(), told.information
    best: tuple[float, float, float] = (0.0, 0.0, 0.0)
    for reach in _REACHES:
        field = _field(camera, middle, reach)
        gain, variance = likeliest(score, noise, information @ field @ information)
        best = max(best, (gain, variance, reach))
    _, variance, reach = best
    weights = np.bincount(bins.number, weighed.weight(bins.rows), len(middle))
    sums, sigma = (v.reshape(-1, 2) for v in (score, np.sqrt(np.diag(noise))))
    times = np.linalg.norm(sums / sigma, axis=1)
    order = [k for k in np.argsort(-times) if times[k] > _TOLD_SIGMAS][:3]
    worst = tuple((*middle[k].tolist(), *(-sums[k] / weights[k]).tolist(), float(times[k])) for k in order)
    if variance <= 0:
        return None
    field = variance * _field(camera, middle, reach)
    mean, moment = posterior(score, noise, information, field)
    reach *= float(np.hypot(camera.width, camera.height))
    found = LensError(camera=camera.camera_id, rms_px=float(np.sqrt(2 * variance)), reach_px=reach, worst=worst)
    return found, Effect(gradient, moment), bins.columns @ mean


@dataclass(frozen=True)
class _Bins:
    """A grid over the images of a camera: its observations (N,), the bin of each (N,), the centres (B, 2) of the
    bins, px, and the derivatives (2O, 2B) by a shift of each bin."""

    rows: np.ndarray
    number: np.ndarray
    middle: np.ndarray
    columns: sparse.csr_matrix


def _bins(camera: pycolmap.Camera, seen: System) -> _Bins:
    across, down = _BINS if camera.width >= camera.height else _BINS[::-1]
    size = np.array([camera.width / across, camera.height / down])
    rows = np.flatnonzero(seen.camera == camera.camera_id)
    cell = np.clip((seen.xy[rows] / size).astype(int), 0, [across - 1, down - 1])
    used, number = np.unique(cell[:, 1] * across + cell[:, 0], return_inverse=True)
    both = 2 * rows[:, None] + np.arange(2)
    columns = sparse.csr_matrix(
        (np.ones(both.size), (both.ravel(), (2 * number[:, None] + np.arange(2)).ravel())),
        shape=(2 * len(seen.xy), 2 * len(used)),
    )
    middle = (np.stack([used % across, used // across], axis=1) + 0.5) * size
    return _Bins(rows=rows, number=number, middle=middle, columns=columns)


def _field(camera: pycolmap.Camera, middle: np.ndarray, reach: float) -> np.ndarray:
    """(2B, 2B) correlations of the shifts of bins; ``reach``: correlation length as a share of the image's diagonal."""
    apart = np.linalg.norm(middle[:, None] - middle[None], axis=2) / np.hypot(camera.width, camera.height)
    return np.kron(np.exp(-0.5 * (apart / reach) ** 2), np.eye(2))


@dataclass(frozen=True)
class AssumedErrors:
    """Shared errors assumed in planning: lens errors, px, as in ``LensError``, by camera id, and their correlation
    length as a share of the image's diagonal; and the ratio of sigmas with correlated errors within a point to those
    with independent errors."""

    lens_px: Mapping[int, float]
    reach: float
    tracks: float = 1.0

    def effects(self, model: pycolmap.Reconstruction, weighed: EffectWeights) -> list[Effect]:
        """The effects of the lens errors."""
        out = []
        for key in np.unique(weighed.seen.camera).tolist():
            bins = _bins(model.camera(key), weighed.seen)
            field = self.lens_px[key] ** 2 / 2 * _field(model.camera(key), bins.middle, self.reach)
            out.append(Effect(weighed.score(bins.columns).gradient, field))
        return out
