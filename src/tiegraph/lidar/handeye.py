"""Where a LiDAR stands on a camera rig, and what its clock is off: hand-eye calibration of two trajectories.

Between two frames the rig moved by A and the LiDAR by L; A X = X L for its place X on the rig (Tsai and Lenz 1989,
Park and Martin 1994). The LiDAR's poses are interpolated at the frames' times plus the clock offset, which is unknown
too, as is the scale of the run. Steps over a few frames enter, not whole poses: so the drift of neither side does harm.
Turns tell the turn of X, and the clock; the lever arm is told by turns alone, so a path on which the rig hardly turns
leaves it open, and that is said with the direction. Sigmas: the larger of the adjustment's, for residuals as large as
they are, and of the jackknife over parts of the time.

Two trajectories of a few seconds hardly tell the lever arm. What both sides have measured tells more
(``tie_by_points``): with one world laid on the other, every frame has the LiDAR's place on the rig (``settled``). What
is left of the clock's sigma times the speed is in its sigma.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import CAUCHY_SIGMAS, MAD, Similarity, l1_mean_rotation, rms_length
from tiegraph.lidar.odometry import PointTie
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.sorting import Columns

_TURN, _PLACE, _SCALE, _CLOCK = slice(0, 3), slice(3, 6), 6, 7  # of the parameters
_CLOCK_OPEN = "the clock offset"
_SEARCH_S = 2.0  # clock offsets tried, on both sides of the start
_LEAST_FRAMES = 4  # within the LiDAR's times: fewer hold no place
# Sigma of the lever arm before anything is measured: LiDAR and cameras stand on one boat, car or person. It keeps what
# the motion leaves open near zero.
_PRIOR_PLACE_M = 2.0


@dataclass(frozen=True)
class Poses(Columns):
    """T poses world_from_body (T, 4, 4) at growing times (T,), s; ``group`` (T,): the pass of each."""

    time_s: np.ndarray
    poses: np.ndarray
    group: np.ndarray

    @property
    def interval(self) -> float:
        """The usual time between two poses, s."""
        return float(np.median(np.diff(self.time_s)))

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """(K, 4, 4) poses at times (K,), s; NaN outside its own."""
        return transforms.interpolate(self.time_s, self.poses, time_s)

    def inside(self, time_s: np.ndarray) -> np.ndarray:
        """(K,) bool: times (K,), s, that it covers."""
        return (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])


@dataclass(frozen=True)
class HandEye:
    """A LiDAR on a rig. LiDAR time = frame time + ``clock_s``; ``scale``: metres of the LiDAR in a unit of the run;
    sigmas of turn (3,) about the rig's axes, degrees, of place (3,), of clock and scale; NaN = given. ``left_open``:
    what the motion does not tell, in words; ``frames`` used; RMS of relative turns and steps."""

    rig_from_lidar: np.ndarray
    clock_s: float
    scale: float
    turn_sigma_deg: np.ndarray
    place_sigma_m: np.ndarray
    clock_sigma_s: float
    scale_sigma: float
    left_open: tuple[str, ...]
    fit: "Fit"
    tie: PointTie | None = None


@dataclass(frozen=True)
class Fit:
    """What the calibration rests on."""

    frames: np.ndarray  # (F,) bool: within the LiDAR's times
    turn_rms_deg: float
    step_rms_m: float


def hand_eye(
    rig: Poses, lidar: Poses, rig_from_lidar: np.ndarray | None = None, clock_s: float | None = None
) -> HandEye:
    """The place (4, 4) of a LiDAR on a rig, and its clock, by their trajectories; what is given is held.

    Raises InputError where too few frames were taken within the LiDAR's times.
    """
    found = _Problem(rig, lidar, rig_from_lidar, clock_s)
    values = found.best()
    for _ in range(4):  # of measuring the sigmas
        found.measure(values)
        values = found.refine(values)
    sigma, place_cov = found.sigmas(values)
    turns, steps = found.residuals(values)
    place = transforms.rigid(Rotation.from_rotvec(values[_TURN]).as_matrix(), values[_PLACE])
    held = np.isnan(sigma)
    return HandEye(
        rig_from_lidar=place,
        clock_s=float(values[_CLOCK]),
        scale=float(np.exp(values[_SCALE])),
        turn_sigma_deg=np.degrees(sigma[_TURN]),
        place_sigma_m=sigma[_PLACE],
        clock_sigma_s=float(sigma[_CLOCK]),
        scale_sigma=float(np.exp(values[_SCALE]) * sigma[_SCALE]),
        left_open=_left_open(sigma, place_cov) if not held.all() else (),
        fit=Fit(found.inside(values[_CLOCK]), float(np.degrees(rms_length(turns))), rms_length(steps)),
    )


def settled(rig: Poses, lidar: Poses, found: HandEye, tie: PointTie) -> HandEye:
    """The LiDAR's place on the rig at all frames by a tie of the two worlds; unchanged where the tie tells less than
    the motion does, or contradicts it."""
    frames = rig.where(lidar.inside(rig.time_s + found.clock_s))
    there = lidar.at(frames.time_s + found.clock_s)
    world = tie.lidar_from_run
    placed = transforms.rigid(world.rotation @ frames.poses[:, :3, :3], world(frames.poses[:, :3, 3]))
    each = transforms.invert(placed) @ there
    turn, place = l1_mean_rotation(each[:, :3, :3]), np.median(each[:, :3, 3], axis=0)
    ahead = lidar.at(frames.time_s + found.clock_s + lidar.interval)
    speed = np.linalg.norm(np.nanmean(ahead[:, :3, 3] - there[:, :3, 3], axis=0)) / lidar.interval
    alike = np.sqrt(len(each))
    scatter = MAD * np.median(np.abs(each[:, :3, 3] - place), axis=0) / alike
    late = 0.0 if np.isnan(found.clock_sigma_s) else float(speed * found.clock_sigma_s)
    place_sigma = np.sqrt(tie.place_sigma_m**2 + scatter**2 + late**2)
    off = np.degrees(Rotation.from_matrix(each[:, :3, :3] @ turn.T).magnitude())
    turn_sigma = np.full(3, np.hypot(tie.turn_sigma_deg, np.median(off) / alike))
    both = np.hypot(found.place_sigma_m, place_sigma)
    apart = np.abs(place - found.rig_from_lidar[:3, 3]) > LIMIT * both
    if apart.any() or not place_sigma.max() < found.place_sigma_m.max():
        return found
    return replace(
        found,
        rig_from_lidar=transforms.rigid(turn, place),
        scale=world.scale,
        scale_sigma=tie.scale_sigma,
        place_sigma_m=place_sigma,
        turn_sigma_deg=turn_sigma,
        left_open=tuple(o for o in found.left_open if o.startswith(_CLOCK_OPEN)),
        tie=tie,
    )


def rig_in_lidar_world(lidar: Poses, time_s: np.ndarray, found: HandEye) -> np.ndarray:
    """(F, 4, 4) poses of the rig at frames' times (F,) by the LiDAR, in its world; NaN outside its times."""
    return lidar.at(time_s + found.clock_s) @ transforms.invert(found.rig_from_lidar)


def lidar_from_run(rig: Poses, by_lidar: np.ndarray, scale: float) -> Similarity:
    """What takes the run's world to the LiDAR's, by the rig's poses in both; robust against single frames."""
    rotation = l1_mean_rotation(by_lidar[:, :3, :3] @ np.swapaxes(rig.poses[:, :3, :3], 1, 2))
    moved = scale * rig.poses[:, :3, 3] @ rotation.T
    return Similarity(scale, rotation, np.median(by_lidar[:, :3, 3] - moved, axis=0))


class _Problem:
    """Relative motions of both sides, and what is known of them."""

    def __init__(self, rig: Poses, lidar: Poses, rig_from_lidar: np.ndarray | None, clock_s: float | None) -> None:
        self.rig, self.rig_from_lidar, self.clock_s = rig, rig_from_lidar, clock_s
        self.path = lidar
        self.sigma = np.radians(0.05), 0.01  # a first guess; then they are measured by the residuals
        self.free = np.ones(8, bool)
        self.free[:6] = rig_from_lidar is None
        self.free[_CLOCK] = clock_s is None
        self._pairs(clock_s or 0.0, np.ones(len(rig.time_s), bool))

    def inside(self, clock_s: float) -> np.ndarray:
        """(F,) bool: frames within the LiDAR's times."""
        return self.path.inside(self.rig.time_s + clock_s)

    def _pairs(self, clock_s: float, kept: np.ndarray) -> bool:
        """The motions between frames that are inside for an offset; False if there are too few."""
        rows = np.flatnonzero(self.inside(clock_s) & kept)
        ends = [np.zeros((2, 0), int)]
        for span in (1, 2, 4, 8):  # frames: drift of either side matters little over them
            pair = np.stack([rows[:-span], rows[span:]])
            ends.append(pair[:, self.rig.group[pair[0]] == self.rig.group[pair[1]]])
        self.first, self.last = np.concatenate(ends, axis=1)
        self.frames = len(rows)
        step = transforms.invert(self.rig.poses[self.first]) @ self.rig.poses[self.last]
        self.turn, self.step = Rotation.from_matrix(step[:, :3, :3]) if len(step) else None, step[:, :3, 3]
        return len(rows) >= _LEAST_FRAMES and len(self.first) >= _LEAST_FRAMES - 1

    def _moved(self, clock_s: float) -> np.ndarray:
        poses = self.path.at(np.clip(self.rig.time_s + clock_s, *self.path.time_s[[0, -1]]))
        return transforms.invert(poses[self.first]) @ poses[self.last]

    def residuals(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, 3) turns, rad, and (P, 3) steps, m, by which A X and X L differ."""
        assert self.turn is not None
        moved = self._moved(values[_CLOCK])
        turn = Rotation.from_rotvec(values[_TURN])
        turns = ((self.turn * turn).inv() * (turn * Rotation.from_matrix(moved[:, :3, :3]))).as_rotvec()
        place = values[_PLACE]
        there = self.turn.apply(place) + np.exp(values[_SCALE]) * self.step
        return turns, there - turn.apply(moved[:, :3, 3]) - place

    def _weighted(self, values: np.ndarray) -> np.ndarray:
        turns, steps = self.residuals(values)
        prior = values[_PLACE] / _PRIOR_PLACE_M if self.free[0] else np.zeros(0)
        return np.concatenate([(turns / self.sigma[0]).ravel(), (steps / self.sigma[1]).ravel(), prior])

    def best(self) -> np.ndarray:
        """The best of starts with different clock offsets, refined."""
        reach = np.arange(0, _SEARCH_S + 1e-9, 0.05)
        clocks = np.concatenate([-reach[:0:-1], reach]) if self.clock_s is None else [self.clock_s]
        all_kept = np.ones(len(self.rig.time_s), bool)
        starts = []
        for clock in clocks:
            if self._pairs(float(clock), all_kept):
                values = self._start(float(clock))
                starts.append((self._cost(values), float(clock), values))
        refined = []
        for _, clock, values in sorted(starts, key=lambda s: s[:2])[:3]:
            self._pairs(clock, all_kept)
            values = self.refine(values)
            cost = self._cost(values)
            if self._pairs(float(values[_CLOCK]), all_kept):
                refined.append((cost, clock, values))
        if not refined:
            (start, end), (first, last) = ((p.time_s.min(), p.time_s.max()) for p in (self.rig, self.path))
            raise InputError(
                f"the frames' times, {start:.3f} to {end:.3f} s, and the LiDAR's, {first:.3f} to "
                f"{last:.3f} s, have less than {_LEAST_FRAMES} frames in common, with an offset of up "
                f"to {_SEARCH_S:g} s: give what is to be added to the frames' times by --clock-s"
            )
        best = min(refined, key=lambda s: s[:2])
        self._pairs(float(best[2][_CLOCK]), all_kept)
        return best[2]

    def _cost(self, values: np.ndarray) -> float:
        return float(np.log1p((self._weighted(values) / CAUCHY_SIGMAS) ** 2).mean())

    def _start(self, clock_s: float) -> np.ndarray:
        """Turn by the directions of turns and steps on both sides, then lever arm and scale by least squares."""
        assert self.turn is not None
        moved = self._moved(clock_s)
        turns = self.turn.as_rotvec(), Rotation.from_matrix(moved[:, :3, :3]).as_rotvec()
        scale = np.linalg.norm(moved[:, :3, 3], axis=1).sum() / max(np.linalg.norm(self.step, axis=1).sum(), 1e-12)
        values = np.array([0, 0, 0, 0, 0, 0, np.log(max(scale, 1e-12)), clock_s])
        if self.rig_from_lidar is not None:
            values[_TURN] = Rotation.from_matrix(self.rig_from_lidar[:3, :3]).as_rotvec()
            values[_PLACE] = self.rig_from_lidar[:3, 3]
            return values
        outer = (turns[0] / self.sigma[0] ** 2).T @ turns[1]
        outer += (scale * self.step / self.sigma[1] ** 2).T @ moved[:, :3, 3]
        u, _, vt = np.linalg.svd(outer)
        turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        values[_TURN] = Rotation.from_matrix(turn).as_rotvec()
        left = (self.turn.as_matrix() - np.eye(3)).reshape(-1, 3)
        right = (moved[:, :3, 3] @ turn.T - scale * self.step).ravel()
        weight = (self.sigma[1] / _PRIOR_PLACE_M) ** 2
        values[_PLACE] = np.linalg.solve(left.T @ left + weight * np.eye(3), left.T @ right)
        return values

    def refine(self, values: np.ndarray) -> np.ndarray:
        """Robust least squares over what is not given.

        The slope along the clock is that over an interval of the scans: over less it would be their noise.
        """
        free = self.free

        def wrapped(part: np.ndarray) -> np.ndarray:
            full = values.copy()
            full[free] = part
            return self._weighted(full)

        steps = np.array([*[1e-5] * 6, 1e-5, self.path.interval])[free]

        def slopes(part: np.ndarray) -> np.ndarray:
            sides = [wrapped(part + s) - wrapped(part - s) for s in np.diag(steps)]
            return np.stack(sides, axis=1) / (2 * steps)

        scale = np.array([0.01, 0.01, 0.01, 0.1, 0.1, 0.1, 0.01, 0.01])[free]
        loss = {"loss": "cauchy", "f_scale": CAUCHY_SIGMAS}
        done = scipy.optimize.least_squares(wrapped, values[free], slopes, x_scale=scale, **loss)
        out = values.copy()
        out[free] = done.x
        self.jacobian, self.weight = slopes(done.x), 1 / (1 + (wrapped(done.x) / CAUCHY_SIGMAS) ** 2)
        return out

    def measure(self, values: np.ndarray) -> None:
        """Sigmas of turns and steps by their residuals."""
        turns, steps = self.residuals(values)
        share = np.sqrt(turns.size / max(turns.size - self.free.sum() / 2, 1))
        self.sigma = (
            max(MAD * share * float(np.median(np.abs(turns))), np.radians(0.002)),
            max(MAD * share * float(np.median(np.abs(steps))), 0.0005),
        )

    def sigmas(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(8,) of the parameters, NaN = given, and (3, 3) covariance of the lever arm."""
        rows = self.jacobian * np.sqrt(self.weight)[:, None]
        again = len(self.first) / max(self.frames - 1, 1)  # motions over several frames share these
        formal = np.linalg.pinv(rows.T @ rows) * again
        spread = self._jackknife(values)
        ratio = np.sqrt(np.maximum(np.diag(spread) / np.diag(formal), 1))
        both = formal * np.outer(ratio, ratio)
        sigma = np.full(8, np.nan)
        sigma[self.free] = np.sqrt(np.diag(both))
        return sigma, both[3:6, 3:6] if self.free[0] else np.zeros((3, 3))

    def _jackknife(self, values: np.ndarray) -> np.ndarray:
        """Covariance of the free parameters by leaving parts of the time out."""
        inside = np.flatnonzero(self.inside(values[_CLOCK]))
        parts = min(6, len(inside) - _LEAST_FRAMES + 1)
        blocks = np.array_split(inside, parts) if parts >= 3 else []
        kept = self.first, self.last, self.turn, self.step, self.jacobian, self.weight
        out = []
        for block in blocks:
            mask = np.ones(len(self.rig.time_s), bool)
            mask[block] = False
            if self._pairs(float(values[_CLOCK]), mask):
                out.append(self.refine(values)[self.free])
        self.first, self.last, self.turn, self.step, self.jacobian, self.weight = kept
        self.frames = len(inside)
        if len(out) < 3:
            return np.zeros((int(self.free.sum()),) * 2)
        away = np.array(out) - np.mean(out, axis=0)
        return (len(out) - 1) / len(out) * away.T @ away


def _left_open(sigma: np.ndarray, place_cov: np.ndarray) -> tuple[str, ...]:
    out = []
    if sigma[_CLOCK] > 0.1:
        out.append(f"{_CLOCK_OPEN} (sigma {sigma[_CLOCK]:.2g} s)")
    for axis, turn in zip("xyz", np.degrees(sigma[_TURN])):
        if turn > 2.0:
            out.append(f"the turn about {axis} of the rig (sigma {turn:.2g} degrees)")
    values, axes = np.linalg.eigh(place_cov)
    for variance, axis in zip(values[::-1], axes.T[::-1]):
        if np.sqrt(max(variance, 0)) > 0.5:
            said = ", ".join(f"{a:+.2f}" for a in axis)
            out.append(f"the lever arm along ({said}) of the rig (sigma {np.sqrt(variance):.2g} m)")
    return tuple(out)
