"""What is measured of a model: positions of the antenna, each connected to the poses of the frames around its time,
control points and known lengths."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from tiegraph.geometry.gravity import Up
from tiegraph.scene.control import Control, ScaleBars
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses, held_out_frames
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.tuning.world import FixTuning, WorldTuning
from tiegraph.sfm.world.marks import Target
from tiegraph.sfm.world.scale import BarsFound, LengthScale

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
class Measured:
    """A model that is to be placed, with everything that is measured of it."""

    images: np.ndarray  # cam_from_world (N, 4, 4)
    up: Up | None
    scene: Scene
    settings: GeorefSettings
    given: Measurements
    tuning: WorldTuning
    lengths: tuple[LengthScale, ...] = ()  # the first counts: scale bars where there are some, then the rig
    targets: list[Target] = field(default_factory=list)  # the control points in the model
    bars: BarsFound | None = None

    @property
    def length_scale(self) -> LengthScale | None:
        """The scale by known lengths, if they determine it reliably."""
        return next((s for s in self.lengths[:1] if not s.why_not), None)

    @property
    def metres_per_unit(self) -> float:
        """The scale by known lengths, 1 without any."""
        return self.lengths[0].metres_per_unit if self.lengths else 1.0

    def frames(self, metres_per_unit: float) -> np.ndarray:
        """world_from_rig (F, 4, 4), model units."""
        return frame_poses(self.images, self.scene, metres_per_unit)

    @cached_property
    def points(self) -> np.ndarray:
        """(C,) rows of the control points that are used."""
        control = self.given.control
        usable = [] if control is None else [not t.why_not and not c for t, c in zip(self.targets, control.check)]
        return np.flatnonzero(usable)

    @cached_property
    def modes(self) -> np.ndarray:
        """(F, 3, M) movement of the frames by each mode of the model's shape, model units."""
        shape, frames = self.given.shape, np.arange(self.scene.frames)
        return np.zeros((len(frames), 3, 0)) if shape is None else shape.at(frames)

    def time_order(self, fixes: Fixes) -> np.ndarray:
        """The order of the fixes (K,) in time, or along the passes where there are no times."""
        if np.isfinite(fixes.time_s).all():
            return np.argsort(fixes.time_s, kind="stable")
        return np.lexsort((self.scene.sequence_index[fixes.home], self.scene.sequence[fixes.home]))


@dataclass(frozen=True)
class Fixes:
    """K positions. The antenna at a fix is the weighted sum of its places at up to four frames."""

    frames: np.ndarray  # (K, 4) scene frames (repeated where fewer)
    weights: np.ndarray  # (K, 4)
    rates: np.ndarray  # (K, 4) derivatives of the weights by time, 1/s
    home: np.ndarray  # (K,) the nearest frame
    time_s: np.ndarray  # (K,)
    position: np.ndarray  # (K, 3) metres
    sigma: np.ndarray  # (K, 3) metres, as used
    stated: np.ndarray  # (K, 3) metres
    level: np.ndarray  # (K,) i4: fixes of one level share one factor of their sigma
    held: np.ndarray  # (K,) bool: held out for the check

    def __len__(self) -> int:
        return len(self.home)

    @property
    def at_frame(self) -> np.ndarray:
        """(K,) bool: at the instant of a frame, so that nothing is interpolated."""
        return np.asarray(np.abs(self.weights).max(axis=1) > 1 - 1e-6)

    def blurred(self, extra_m: np.ndarray) -> Fixes:
        """The same with (3,) metres added to the sigmas, in quadrature."""
        return replace(self, sigma=np.hypot(self.sigma, extra_m)) if np.any(extra_m) else self

    def widened(self, poses: np.ndarray, metres_per_unit: float) -> Fixes:
        """The same with the error of interpolation, from frame poses (F, 4, 4), added to the sigmas.

        A cubic between evenly spaced frames errs by 3/128 of the fourth difference, which a sharp turn makes as large
        as the third; a parabola at the ends of a pass by 1/16 of the third, which may be as large as the second.
        """
        share = {3: 3 / 128, 2: 1 / 16}  # of the difference of this order
        error = np.zeros(len(self))
        for k in np.flatnonzero(~self.at_frame):
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
            part = _of_track(scene, registered & (scene.sequence == track), rows, tuning)
            if part is not None:
                parts.append(part)
                left &= scene.sequence != track
    use = np.flatnonzero(left & np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1))
    one = np.eye(NODES)[np.zeros(len(use), int)]  # nothing is interpolated between loose photographs
    place = scene.world_from_rig[use, :3, 3], scene.position_sigma_m[use]
    parts.append((np.repeat(use[:, None], NODES, axis=1), one, 0 * one, scene.time_s[use], *place))
    frames, weights, rates, time_s, position, sigma = (np.concatenate(column) for column in zip(*parts))
    home = frames[np.arange(len(frames)), np.argmax(np.abs(weights), axis=1)]
    stated = np.where(np.isfinite(sigma), sigma, tuning.unknown_sigma_m)
    return Fixes(
        frames=frames,
        weights=weights,
        rates=rates,
        home=home,
        time_s=time_s,
        position=position,
        sigma=np.maximum(stated, tuning.floor_m),
        stated=stated,
        level=np.round(tuning.levels_per_octave * np.log2(np.maximum(stated[:, 0], 1e-3))).astype(int),
        held=held_out_frames(scene, tuning)[home],
    )


def _of_track(scene: Scene, own: np.ndarray, rows: PositionRows, tuning: FixTuning) -> tuple[np.ndarray, ...] | None:
    """The first columns of the fixes between the frames of a pass (F,) bool; None without any."""
    mine = np.flatnonzero(own & np.isfinite(scene.time_s))
    time, first = np.unique(scene.time_s[mine], return_index=True)
    mine = mine[first]
    if len(mine) < 2:
        return None
    reach = tuning.max_step * float(np.median(np.diff(time)))
    inside = np.flatnonzero((rows.time_s >= time[0] - 1e-6) & (rows.time_s <= time[-1] + 1e-6))
    left = np.clip(np.searchsorted(time, rows.time_s[inside], side="right") - 1, 0, len(time) - 2)
    near = time[left + 1] - time[left] <= reach
    inside, left = inside[near], left[near]
    t = rows.time_s[inside]
    keep = np.minimum(np.abs(t - time[left]), np.abs(t - time[left + 1])) < 1e-3  # all rows at frames
    for k in np.unique(left):
        of = np.flatnonzero(left == k)
        keep[of[np.unique(np.linspace(0, len(of) - 1, min(tuning.rows_per_frame, len(of))).astype(int))]] = True
    inside, left, t = inside[keep], left[keep], t[keep]
    if not len(inside):
        return None
    nodes, weights, rates = (np.array(v) for v in zip(*(_nodes(time, k, at, reach) for k, at in zip(left, t))))
    return mine[nodes], weights, rates, t, rows.position_m[inside], rows.sigma_m[inside]


def _nodes(time: np.ndarray, left: int, t: float, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Four frames as indices into ``time``, their weights in the interpolating polynomial at t (Lagrange), and the
    weights' derivatives."""
    first, last = left, left + 1
    if left > 0 and time[left] - time[left - 1] <= reach:
        first -= 1
    if last + 1 < len(time) and time[last + 1] - time[last] <= reach:
        last += 1
    count = last + 1 - first
    at = np.append(np.arange(first, last + 1), np.full(NODES - count, last))
    weights, rates, off = np.zeros(NODES), np.zeros(NODES), t - time[at[:count]]
    for i in range(count):
        others = [j for j in range(count) if j != i]
        scale = float(np.prod([time[at[i]] - time[at[j]] for j in others]))
        weights[i] = np.prod(off[others]) / scale
        rates[i] = sum(np.prod(off[[j for j in others if j != k]]) for k in others) / scale
    return at, weights, rates
