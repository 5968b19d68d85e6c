"""Cameras that are not at their places in the rig: in all shots, or varying from shot to shot."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.scene.sorting import evenly
from tiegraph.sfm.adjustment.jacobians import System, by_shift, frame_pose
from tiegraph.sfm.motion import Motion
from tiegraph.sfm.systematic.effects import Effect, EffectWeights, Score, posterior

_MOST_SHOTS = 40  # whose image shifts are used, evenly over the pass
_LEAST_OBSERVATIONS = 10  # of an image whose shift is used
_SOME = 1000  # observations for the pixels that a movement causes


def misplaced(
    model: pycolmap.Reconstruction,
    weighed: EffectWeights,
    held: Collection[int],
    off: Mapping[int, np.ndarray],
) -> tuple[list[Effect], np.ndarray]:
    """The deviations of the cameras of rigs (ids) held in the adjustment, as far as the images show them; (2O,) the
    part of the residuals that they explain.

    ``off``: rig id -> (6S, 6S) mean products of place (model units) and rotation of its S cameras beside the
    reference, where they are known from elsewhere."""
    out, explained = [], np.zeros(2 * len(weighed.seen.image))
    for rig_id in sorted(set(held) & set(model.rigs)):
        every = sorted(s.id for s, pose in model.rig(rig_id).non_ref_sensors.items() if pose is not None)
        cameras = [c for c in every if (weighed.seen.camera == c).any()]
        if not cameras:
            continue
        columns = sparse.hstack([of_mounting(model, weighed.seen, c) for c in cameras]).tocsr()
        told = weighed.score(columns)
        if rig_id in off:
            at = (6 * np.searchsorted(every, cameras)[:, None] + np.arange(6)).ravel()
            out.append(Effect(told.gradient, off[rig_id][np.ix_(at, at)]))
        elif (shown := _shown_off(cameras, told)) is not None:
            out.append(shown[0])
            explained += columns @ shown[1]
    return out, explained


def _shown_off(cameras: list[int], told: Score) -> tuple[Effect, np.ndarray] | None:
    """From the images, with the mean (6S,) of the shifts and rotations of S cameras; None where the
    images show none."""
    score, noise, information = told.score, told.ridged(), told.information
    place, turn, _ = two_sizes(score[None], noise[None], information[None])
    if place + turn <= 0:
        return None
    field = np.diag(np.tile(np.repeat([place, turn], 3), len(cameras)))
    mean, moment = posterior(score, noise, information, field)
    return Effect(told.gradient, moment), mean


def unrest(model: pycolmap.Reconstruction, weighed: EffectWeights) -> list[Effect]:
    """Movement of cameras in the rig from shot to shot, where the observations show any.

    All cameras are treated alike, including the reference; the part that the pose of a frame absorbs is accounted
    for.
    """
    shared = [own for own in _by_frame(model, weighed.seen) if len(own) > 1]
    if not shared:
        return []
    (place, turn, gain), gradient = _straying(weighed, shared)
    if gain <= 0:
        return []
    moment = np.tile(np.repeat([place, turn], 3), gradient.shape[1] // 6) * len(shared) / min(len(shared), _MOST_SHOTS)
    return [Effect(gradient * np.sqrt(moment), np.eye(len(moment)))]


@dataclass(frozen=True)
class Stray:
    """Movement of a camera in the rig from shot to shot, sigmas of a coordinate: model units, rad, and pixels in its
    images; ``gain`` in log likelihood over no movement."""

    place: float
    turn: float
    px: float
    gain: float


def strays_of(model: pycolmap.Reconstruction, weighed: EffectWeights, cameras: Collection[int]) -> dict[int, Stray]:
    """The movement of some cameras (ids), each as if the others were rigid."""
    frames, out = _by_frame(model, weighed.seen), {}
    for camera in cameras:
        own = [[i] for images in frames for i in images if model.image(i).camera_id == camera]
        if own:
            (place, turn, gain), _ = _straying(weighed, own)
            rows = np.flatnonzero(weighed.seen.camera == camera)
            moved = by_shift(weighed.seen, rows[:: max(1, len(rows) // _SOME)]) ** 2 @ np.repeat([place, turn], 3)
            out[camera] = Stray(
                place=float(place**0.5), turn=float(turn**0.5), px=float(np.sqrt(np.median(moved))), gain=float(gain)
            )
    return out


def _by_frame(model: pycolmap.Reconstruction, seen: System) -> list[list[int]]:
    """Images with enough observations, grouped by frame."""
    images, counts = np.unique(seen.image, return_counts=True)
    of_frame: dict[int, list[int]] = {}
    for image, count in zip(images.tolist(), counts.tolist()):
        if count >= _LEAST_OBSERVATIONS:
            of_frame.setdefault(model.image(image).frame_id, []).append(image)
    return [own for _, own in sorted(of_frame.items())]


def _straying(weighed: EffectWeights, groups: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    """For images in groups that are judged together: variances of a coordinate of place and rotation, the gain in log
    likelihood over none (3,), and their effect (C, 6K) on the gradient."""
    chosen = [groups[k] for k in evenly(len(groups), _MOST_SHOTS)]
    size = 6 * max(len(own) for own in chosen)
    gradient, score = [], np.zeros((len(chosen), size))
    noise, information = np.tile(np.eye(size), (len(chosen), 1, 1)), np.zeros((len(chosen), size, size))
    for k, own in enumerate(chosen):
        part = slice(0, 6 * len(own))
        told = weighed.score(_of_images(weighed.seen, own))
        score[k, part], noise[k, part, part], information[k, part, part] = told.score, told.ridged(), told.information
        gradient.append(told.gradient)
    return np.array(two_sizes(score, noise, information)), np.hstack(gradient)


def untimed(weighed: EffectWeights, motion: Motion, late_s: Mapping[int, float]) -> list[Effect]:
    """The effect of the unknown firing times of cameras (ids), with prior sigmas ``late_s``, s."""
    if not late_s:
        return []
    columns = [of_time(weighed.seen, motion, np.flatnonzero(weighed.seen.camera == k)) for k in sorted(late_s)]
    told, field = weighed.score(sparse.hstack(columns).tocsr()), np.diag([late_s[k] ** 2 for k in sorted(late_s)])
    return [Effect(told.gradient, posterior(told.score, told.ridged(), told.information, field)[1])]


def of_time(seen: System, motion: Motion, rows: np.ndarray) -> sparse.csr_matrix:
    """(2O, 1) derivatives of observations (R,) by the time at which their images were taken."""
    images, number = np.unique(seen.image[rows], return_inverse=True)
    rate = np.array([motion.rate(i) for i in images.tolist()]).reshape(-1, 6)[number]
    values = np.einsum("oij,oj->oi", by_shift(seen, rows), rate)
    at = (2 * rows[:, None] + np.arange(2)).ravel()
    return sparse.csr_matrix((values.ravel(), (at, np.zeros(len(at), int))), shape=(len(seen.residual), 1))


def _of_images(seen: System, images: list[int]) -> sparse.csr_matrix:
    """(2O, 6K) derivatives by the shift of the centre and the rotation of each of these images alone."""
    rows = np.flatnonzero(np.isin(seen.image, images))
    return _columns(seen, rows, by_shift(seen, rows), 6 * np.searchsorted(images, seen.image[rows]), 6 * len(images))


def of_mounting(model: pycolmap.Reconstruction, seen: System, camera: int) -> sparse.csr_matrix:
    """(2O, 6) derivatives by the shift and the rotation of a camera, along the axes of the rig."""
    rows = np.flatnonzero(seen.camera == camera)
    images, number = np.unique(seen.image[rows], return_inverse=True)
    frames = [model.frame(model.image(i).frame_id) for i in images.tolist()]
    axes = np.stack([frame_pose(f).rotation.matrix().T for f in frames])[number]
    shifted = by_shift(seen, rows)
    values = np.concatenate([shifted[:, :, :3] @ axes, shifted[:, :, 3:] @ axes], axis=2)
    return _columns(seen, rows, values, np.zeros(len(rows), int), 6)


def _columns(seen: System, rows: np.ndarray, values: np.ndarray, first: np.ndarray, width: int) -> sparse.csr_matrix:
    """(2O, width) matrix with the values (R, 2, 6) of some observations in six columns from ``first`` (R,)."""
    row = np.repeat((2 * rows[:, None] + np.arange(2)).ravel(), 6)
    column = np.repeat(first[:, None] + np.arange(6), 2, axis=0).ravel()
    return sparse.csr_matrix((values.ravel(), (row, column)), shape=(2 * len(seen.image), width))


def two_sizes(score: np.ndarray, noise: np.ndarray, information: np.ndarray) -> tuple[float, float, float]:
    """Maximum likelihood variances of place and rotation, three numbers each in turn, for scores (G, K) with this
    noise and information (G, K, K): the best of a coarse grid, then of a finer one around it; and the gain in log
    likelihood."""
    is_place = np.arange(score.shape[1]) % 6 < 3
    parts = [information[:, :, own] @ information[:, own] for own in (is_place, ~is_place)]
    sizes = [float(np.median(_trace(noise) / np.maximum(_trace(part), 1e-300))) for part in parts]

    def best(places: np.ndarray, turns: np.ndarray) -> tuple[float, float, float]:
        pairs = [(p, t) for p in places.tolist() for t in turns.tolist()]
        return max(
            ((p, t, _log_likelihood(score, noise + p * parts[0] + t * parts[1])) for p, t in pairs),
            key=lambda one: one[2],
        )

    coarse, finer = (
        np.append(0.0, np.geomspace(1e-3, 1e4, 15)),
        np.geomspace(0.4, 2.5, 5),
    )  # times its noise
    place, turn, _ = best(*(size * coarse for size in sizes))
    place, turn, likely = best(place * finer, turn * finer)
    return place, turn, likely - _log_likelihood(score, noise)


def _trace(matrices: np.ndarray) -> np.ndarray:
    return np.asarray(np.trace(matrices, axis1=1, axis2=2))


def _log_likelihood(score: np.ndarray, covariance: np.ndarray) -> float:
    solved = np.linalg.solve(covariance, score[:, :, None])[:, :, 0]
    return float(-0.5 * np.sum(score * solved) - 0.5 * np.sum(np.linalg.slogdet(covariance)[1]))
