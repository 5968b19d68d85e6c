"""Measured positions of the antenna, each connected to the poses of the frames around its time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.scene.control import Control, ScaleBars
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import held_out_frames
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.tuning.world import FixTuning

NODES = 4  # frames that carry a position between frames: a cubic through them


@dataclass(frozen=True)
class PositionRows:
    """What a receiver wrote, in the world: time_s (G,), position_m (G, 3), sigma_m (G, 3), NaN = not given."""

    time_s: np.ndarray
    position_m: np.ndarray
    sigma_m: np.ndarray


@dataclass(frozen=True)
class Measurements:
    """Measurements beside the scene: the receiver's rows, control points, scale bars; sigmas of the model itself."""

    rows: PositionRows | None = None
    control: Control | None = None
    shape: Shape | None = None  # how far the model may be bent, given its images
    model_scale_sigma: float = float("nan")  # of all its lengths together, relative; NaN = undetermined
    firm_frames: float = float("inf")  # frames of a model with enough points
    bars: ScaleBars | None = None


@dataclass(frozen=True)
class Fixes:
    """K positions. The antenna at a fix is the weighted sum of its places at up to four frames.

    frames (K, 4) scene frames (repeated where fewer), weights and rates (K, 4): rates are the weights' derivatives by
    time, 1/s; home (K,) the nearest frame; position (K, 3), sigma as used and as stated (K, 3) metres; level (K,) i4:
    fixes of one level share one factor of their sigma; held (K,) bool held out for the check.
    """

    frames: np.ndarray
    weights: np.ndarray
    rates: np.ndarray
    home: np.ndarray
    time_s: np.ndarray
    position: np.ndarray
    sigma: np.ndarray
    stated: np.ndarray
    level: np.ndarray
    held: np.ndarray

    def __len__(self) -> int:
        return len(self.home)

    def where(self, mask: np.ndarray) -> Fixes:
        """The fixes of a mask (K,)."""
        return Fixes(**{name: getattr(self, name)[mask] for name in Fixes.__dataclass_fields__})

    def blurred(self, extra_m: np.ndarray) -> Fixes:
        """The same with (3,) metres added to the sigmas, in quadrature."""
        return replace(self, sigma=np.hypot(self.sigma, extra_m)) if np.any(extra_m) else self

    def stretched(self, factor: np.ndarray) -> Fixes:
        """The same with sigmas multiplied by a factor (K,)."""
        return replace(self, sigma=self.sigma * factor[:, None])

    def widened(self, poses: np.ndarray, metres_per_unit: float, tuning: FixTuning) -> Fixes:
        """The same with the error of interpolation, from frame poses (F, 4, 4), added to the sigmas.

        A cubic between evenly spaced frames errs by 0.023 of the fourth difference, which a sharp turn makes as large
        as the third; a parabola at the ends of a pass by 0.06 of the third, which may be as large as the second.
        """
        share = {3: tuning.cubic_error, 2: tuning.parabola_error}  # of the difference of this order
        error = np.zeros(len(self))
        for k in np.flatnonzero(np.abs(self.weights).max(axis=1) < 1 - 1e-6):
            at = poses[list(dict.fromkeys(self.frames[k].tolist())), :3, 3]
            order = min(len(at) - 1, 3)
            error[k] = share.get(order, 0.0) * float(np.linalg.norm(np.diff(at, order, axis=0)[-1]))
        return replace(self, sigma=np.hypot(self.sigma, metres_per_unit * error[:, None]))

    def blend(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K, 4, 4) weighted sums of frame poses (F, 4, 4) and their derivatives by time (K, 4, 4).

        Not rigid between frames: the sums of rotations carry a lever arm along with the positions.
        """
        there = np.nan_to_num(poses)[self.frames]
        moved = np.einsum("kn,knij->kij", self.weights, there)
        return moved, np.einsum("kn,knij->kij", self.rates, there)


def make_fixes(scene: Scene, registered: np.ndarray, given: Measurements, tuning: FixTuning) -> Fixes:
    """Fixes from the receiver's rows, or from the scene's prior positions where no row has a time.

    ``registered`` (F,) frames with a pose.
    """
    rows, parts, left = given.rows, [], registered.copy()
    if rows is not None and tuning.rows_per_frame and np.isfinite(scene.time_s).any():
        for track in np.unique(scene.sequence[scene.sequence >= 0]):
            part = _of_track(scene, registered, rows, int(track), tuning)
            if part is not None:
                parts.append(part)
                left &= scene.sequence != track
    fixes = _joined([*parts, _of_frames(scene, left)])  # nothing is interpolated between loose photographs
    stated = np.where(np.isfinite(fixes.sigma), fixes.sigma, tuning.unknown_sigma_m)
    level = np.round(tuning.levels_per_octave * np.log2(np.maximum(stated[:, 0], 1e-3))).astype(int)
    sigma = np.maximum(stated, tuning.floor_m)
    held = held_out_frames(scene, tuning)[fixes.home]
    return replace(fixes, sigma=sigma, stated=stated, level=level, held=held)


def _of_frames(scene: Scene, registered: np.ndarray) -> Fixes:
    position = scene.world_from_rig[:, :3, 3]
    use = np.flatnonzero(registered & np.isfinite(position).all(axis=1))
    weights = np.zeros((len(use), NODES))
    weights[:, 0] = 1.0
    frames = np.repeat(use[:, None], NODES, axis=1)
    return _fixes(
        frames, weights, np.zeros_like(weights), scene.time_s[use], position[use], scene.position_sigma_m[use]
    )


def _of_track(scene: Scene, registered: np.ndarray, rows: PositionRows, track: int, tuning: FixTuning) -> Fixes | None:
    mine = np.flatnonzero((scene.sequence == track) & registered & np.isfinite(scene.time_s))
    mine = mine[np.argsort(scene.time_s[mine], kind="stable")]
    time = scene.time_s[mine]
    mine, time = mine[np.concatenate([[True], np.diff(time) > 1e-6])] if len(mine) else mine, np.unique(time)
    if len(mine) < 2:
        return None
    reach = tuning.max_step * float(np.median(np.diff(time)))
    inside = np.flatnonzero((rows.time_s >= time[0] - 1e-6) & (rows.time_s <= time[-1] + 1e-6))
    left = np.clip(np.searchsorted(time, rows.time_s[inside], side="right") - 1, 0, len(time) - 2)
    near = time[left + 1] - time[left] <= reach
    inside, left = inside[near], left[near]
    t = rows.time_s[inside]
    at_frame = np.minimum(np.abs(t - time[left]), np.abs(t - time[left + 1])) < 1e-3
    thin = _thinned(left, at_frame, tuning.rows_per_frame)
    inside, left = inside[thin], left[thin]
    if not len(inside):
        return None
    table = [_nodes(time, int(k), float(t), reach) for k, t in zip(left, rows.time_s[inside])]
    frames = np.array([mine[n] for n, _, _ in table])
    weights, rates = np.array([w for _, w, _ in table]), np.array([r for _, _, r in table])
    return _fixes(frames, weights, rates, rows.time_s[inside], rows.position_m[inside], rows.sigma_m[inside])


def _thinned(left: np.ndarray, at_frame: np.ndarray, most: int) -> np.ndarray:
    """(R,) bool: rows at frames, and at most so many of each interval."""
    keep = at_frame.copy()
    for k in np.unique(left):
        of = np.flatnonzero(left == k)
        keep[of[np.unique(np.linspace(0, len(of) - 1, min(most, len(of))).astype(int))]] = True
    return keep


def _nodes(time: np.ndarray, left: int, t: float, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Four frames as indices into ``time``, their Lagrange weights at t and the weights' derivatives."""
    first, last = left, left + 1
    if left > 0 and time[left] - time[left - 1] <= reach:
        first -= 1
    if last + 1 < len(time) and time[last + 1] - time[last] <= reach:
        last += 1
    at = np.arange(first, last + 1)
    weights, rates = _lagrange(time[at], t)
    fill = NODES - len(at)
    return np.append(at, np.full(fill, at[-1])), np.append(weights, np.zeros(fill)), np.append(rates, np.zeros(fill))


def _lagrange(nodes: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n,) of the interpolating polynomial at t and their derivatives."""
    count = len(nodes)
    weights, rates = np.ones(count), np.zeros(count)
    for i in range(count):
        others = [j for j in range(count) if j != i]
        scale = float(np.prod([nodes[i] - nodes[j] for j in others]))
        weights[i] = np.prod([t - nodes[j] for j in others]) / scale
        rates[i] = sum(np.prod([t - nodes[j] for j in others if j != k]) for k in others) / scale
    return weights, rates


def _fixes(frames: np.ndarray, weights: np.ndarray, rates: np.ndarray, *columns: np.ndarray) -> Fixes:
    time, position, sigma = columns
    home = frames[np.arange(len(frames)), np.argmax(np.abs(weights), axis=1)]
    empty = np.zeros(len(frames))
    return Fixes(
        frames=frames,
        weights=weights,
        rates=rates,
        home=home,
        time_s=time,
        position=position,
        sigma=sigma,
        stated=sigma,
        level=empty.astype(int),
        held=empty.astype(bool),
    )


def _joined(parts: list[Fixes]) -> Fixes:
    return Fixes(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in Fixes.__dataclass_fields__})
