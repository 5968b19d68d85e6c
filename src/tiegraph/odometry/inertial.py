"""An inertial unit beside the cameras: how the rig turned between frames, and where up is, each with its sigma.

Both become residuals of the windowed adjustment by COLMAP's own pose priors (``adjust``), with covariances that leave
free what is not measured: the way between two frames, the heading about the vertical. The gyroscope's turn also says
where a frame is expected. How the unit sits in the rig (``rig_from_imu``) and its bias follow from the turns that the
images say, online: until the rig has turned about two axes the unit tells nothing. The accelerometer is no odometer
here: mean over a while it tells the vertical, and its scatter how well; speeds are not states (unlike in VINS).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.odometry.tuning import InertialTuning
from tiegraph.odometry.worldmap import Keyframe
from tiegraph.scene.imufile import ImuFile


@dataclass(frozen=True)
class TurnPrior:
    """second_from_first (3, 3) in the rig's axes of two keyframes (their numbers), and its sigma, rad."""

    first: int
    second: int
    rotation: np.ndarray
    sigma_rad: float


@dataclass(frozen=True)
class UpPrior:
    """Where up is in the rig (3,) and in the world (3,) at a keyframe, and the sigma of that, rad."""

    keyframe: int
    in_rig: np.ndarray
    in_world: np.ndarray
    sigma_rad: float


Priors = tuple[Sequence[TurnPrior], Sequence[UpPrior]]
NO_PRIORS: Priors = ((), ())


class Inertial:
    """The unit's measurements at the frames of a sequence; ``time_s``: frame -> its time on the unit's clock.

    ``rig_from_imu`` (3, 3): the axes of the unit in the rig, None = to be found.
    """

    def __init__(
        self, measured: ImuFile, time_s: Mapping[int, float], rig_from_imu: np.ndarray | None, tuning: InertialTuning
    ) -> None:
        self._measured, self._time_s, self._tuning = measured, time_s, tuning
        self._given = rig_from_imu is not None
        self.rig_from_imu = rig_from_imu
        self.axes_sigma_rad = 0.0 if self._given else np.inf
        self.bias = np.zeros(3)  # rad/s, along the unit's axes
        self._rates: list[np.ndarray] = []  # (2, 3) of the images along the rig's axes, of the unit along its own
        self._ups: dict[int, tuple[np.ndarray, float]] = {}

    @property
    def known(self) -> bool:
        """Whether axes and bias are known, so that the unit tells something."""
        return self.rig_from_imu is not None and len(self._rates) >= self._tuning.least_turns

    def learn(self, first: int, second: int, rotation: np.ndarray) -> None:
        """Take in what the images say of the turn second_from_first (3, 3) of two frames."""
        turned, lasted = self._integral(first, second, np.zeros(3)), self._lasted(first, second)
        if turned is None:
            return
        seen = -Rotation.from_matrix(rotation).as_rotvec() / lasted
        self._rates = [*self._rates, np.stack([seen, turned.as_rotvec() / lasted])][-self._tuning.learnt :]
        if len(self._rates) >= self._tuning.least_turns:
            self._calibrate()

    def _calibrate(self) -> None:
        """Axes by the rates about their means (Kabsch), which no bias changes; the bias by what is left (medians)."""
        of_rig, of_imu = np.stack(self._rates, axis=1)
        if not self._given:
            centred = [rates - rates.mean(axis=0) for rates in (of_rig, of_imu)]
            found, _ = Rotation.align_vectors(*centred)
            left = centred[0] - found.apply(centred[1])
            strength = np.linalg.svd(centred[1], compute_uv=False)[1]  # a turn about one axis leaves that about it free
            sigma = float(np.sqrt(np.sum(left**2) / len(left)) / max(strength, 1e-12))
            if sigma < self._tuning.axes_rad:
                self.rig_from_imu, self.axes_sigma_rad = found.as_matrix(), sigma
        if self.rig_from_imu is not None:
            self.bias = np.median(of_imu - of_rig @ self.rig_from_imu, axis=0)

    def turn(self, first: int, second: int) -> tuple[np.ndarray, float] | None:
        """second_from_first (3, 3) in the rig's axes, and its sigma, rad; None if the unit does not tell it."""
        turned = self._integral(first, second, self.bias) if self.known else None
        if turned is None or self.rig_from_imu is None:
            return None
        lasted, axes = self._lasted(first, second), self.rig_from_imu
        parts = (
            self._tuning.walk * np.sqrt(lasted),
            self._tuning.bias * lasted,
            self.axes_sigma_rad * turned.magnitude(),
        )
        return axes @ turned.inv().as_matrix() @ axes.T, float(np.linalg.norm(parts))

    def up(self, frame: int) -> tuple[np.ndarray, float] | None:
        """Where up is in the rig's axes at a frame (3,), and its sigma, rad; None if the unit does not tell it."""
        at, half, time_s = self._time_s.get(frame, np.nan), self._tuning.up_s / 2, self._measured.time_s
        if not self.known or not time_s[0] <= at - half <= at + half <= time_s[-1]:
            return None
        if frame not in self._ups:
            self._ups[frame] = self._up(at, half)
        direction, sigma = self._ups[frame]
        return np.asarray(self.rig_from_imu @ direction), float(np.hypot(sigma, self.axes_sigma_rad))

    def _up(self, at: float, half: float) -> tuple[np.ndarray, float]:
        """Where up is in the unit's axes at a time: the mean of the accelerations, turned there."""
        time_s = self._measured.time_s
        inside = np.flatnonzero(np.abs(time_s - at) <= half)
        turns = self._steps(time_s[inside], self.bias)
        here = turns[int(np.argmin(np.abs(time_s[inside] - at)))]
        force = (here.inv() * turns).apply(self._measured.force[inside])
        mean = force.mean(axis=0)
        scatter = np.sqrt(np.mean(np.sum((force - mean) ** 2, axis=1)) / 3)
        off = abs(np.linalg.norm(mean) - self._tuning.gravity)
        sigma = float(np.linalg.norm([self._tuning.up_rad, *np.array([scatter, off]) / self._tuning.gravity]))
        return mean / np.linalg.norm(mean), sigma

    def _lasted(self, first: int, second: int) -> float:
        return self._time_s[second] - self._time_s[first]

    def _integral(self, first: int, second: int, bias: np.ndarray) -> Rotation | None:
        """The unit's axes at the second frame in those at the first."""
        start, end = (self._time_s.get(f, np.nan) for f in (first, second))
        time_s = self._measured.time_s
        if not time_s[0] <= start < end <= time_s[-1]:
            return None
        inside = time_s[(time_s > start) & (time_s < end)]
        at = np.concatenate([[start], inside, [end]])
        if np.diff(at).max() > self._tuning.gap_s:
            return None
        return self._steps(at, bias)[-1]

    def _steps(self, at: np.ndarray, bias: np.ndarray) -> Rotation:
        """The unit's axes at times (N,) in those at the first, by the rates between (trapezoids)."""
        rates = np.stack([np.interp(at, self._measured.time_s, axis) for axis in self._measured.rate.T], axis=1) - bias
        steps = Rotation.from_rotvec((rates[1:] + rates[:-1]) / 2 * np.diff(at)[:, None])
        turns = [Rotation.identity()]
        for step in steps:
            turns.append(turns[-1] * step)
        return Rotation.concatenate(turns)


def priors_of(inertial: Inertial, keyframes: Sequence[Keyframe], numbers: Sequence[int]) -> Priors:
    """The turns between keyframes (their numbers, in order) that follow each other, and the vertical at each.

    Up in the world is the mean over all keyframes of the segment so far, by their weights: the first alone would lean
    all by its error.
    """
    turns = []
    for first, second in zip(numbers, numbers[1:]):
        told = inertial.turn(keyframes[first].frame, keyframes[second].frame)
        if told is not None:
            turns.append(TurnPrior(first, second, *told))
    segment = keyframes[numbers[0]].segment
    every = [n for n in range(numbers[-1] + 1) if keyframes[n].segment == segment]
    up = {n: told for n in every if (told := inertial.up(keyframes[n].frame)) is not None}
    if not up:
        return turns, ()
    in_world = np.sum([keyframes[n].rig_from_world[:3, :3].T @ v / sigma**2 for n, (v, sigma) in up.items()], axis=0)
    in_world = in_world / np.linalg.norm(in_world)
    return turns, [UpPrior(n, up[n][0], in_world, up[n][1]) for n in numbers if n in up]
