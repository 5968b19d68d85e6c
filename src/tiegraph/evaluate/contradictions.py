"""References against what was predicted: an error far beyond its sigma contradicts; what would explain it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from tiegraph.evaluate.clouds.nearest import CloudComparison
from tiegraph.evaluate.trajectory import PoseMatch, TrajectoryError
from tiegraph.evaluate.tuning import JudgeTuning
from tiegraph.geometry.align import umeyama

_AXES = "xyz"


@dataclass(frozen=True)
class Predicted:
    """Sigmas of a run, metres: of a camera ``inside_m`` the model (NaN = not known), of the scale (share; NaN: the
    scale is not known), of the place on the Earth ``placed_m`` (NaN: not placed), of a point of the cloud."""

    inside_m: float = float("nan")
    scale: float = float("nan")
    placed_m: float = float("nan")
    point_m: float = float("nan")

    @property
    def metric(self) -> bool:
        """Whether the model has a scale that can be held against a reference's."""
        return bool(np.isfinite(self.scale))


def against_poses(
    match: PoseMatch,
    result: TrajectoryError,
    predicted: Predicted,
    tuning: JudgeTuning,
    step_s: float = float("nan"),
) -> list[str]:
    """Sentences about reference poses (K) that the model contradicts; none where nothing was predicted.

    ``step_s``: the frames' interval, to say a lag in seconds.
    """
    if not np.isfinite(predicted.inside_m):
        return []
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    spread = float(np.sqrt(np.mean(np.sum((ref - ref.mean(axis=0)) ** 2, axis=1))))
    actual = result.se3.rmse_m if predicted.metric else result.sim3.rmse_m
    expected = float(np.hypot(predicted.inside_m, spread * predicted.scale if predicted.metric else 0.0))
    out = []
    if actual > tuning.beyond_sigmas * expected:
        why = _explained(match, actual, predicted.metric, tuning, step_s)
        why = why or "one of the two is wrong by more than it says"
        out.append(f"the reference poses and the model differ by {_m(actual)} (RMSE), predicted {_m(expected)}: {why}")
    elif result.absolute is not None and np.isfinite(predicted.placed_m):
        expected = float(np.hypot(expected, predicted.placed_m))
        if result.absolute.rmse_m > tuning.beyond_sigmas * expected:
            east, north, up = np.mean(est - ref, axis=0)
            out.append(
                f"the reference poses and the model differ by {_m(result.absolute.rmse_m)} on the Earth, predicted "
                f"{_m(expected)}, though their shapes agree to {_m(actual)}: the model stands {east:+.2f} m east, "
                f"{north:+.2f} m north, {up:+.2f} m up of it: another datum or origin?"
            )
    return out


def against_cloud(
    result: CloudComparison, reach_m: float, predicted: Predicted, aligned: bool, tuning: JudgeTuning
) -> list[str]:
    """Sentences about a reference cloud that the cloud contradicts: half its points are farther than predicted.

    What the reference's own spacing leaves between a point and its nearest counts as predicted, and what the scale's
    sigma moves a point by at ``reach_m``, the middle one of the reference's distances from its centre.
    """
    criteria = result.criteria
    if not np.isfinite(predicted.point_m):
        return []
    found = np.isfinite(result.whole.median_m)
    median = result.whole.median_m if found else criteria.reach_m
    parts = [predicted.point_m, np.nan_to_num(predicted.inside_m), max(criteria.spacing_m, criteria.voxel_m) / 2]
    parts.append(reach_m * np.nan_to_num(predicted.scale))
    parts.append(0.0 if aligned else np.nan_to_num(predicted.placed_m))
    expected = float(np.linalg.norm(parts))
    if median <= tuning.beyond_sigmas * expected:
        return []
    more = "" if found else "more than "
    return [
        f"the reference cloud and the cloud differ by {more}{_m(median)} (median), predicted {_m(expected)}: "
        "another frame or datum, or a place that has changed"
    ]


def _explained(match: PoseMatch, actual: float, metric: bool, tuning: JudgeTuning, step_s: float) -> str:
    """What of the reference would explain the difference, in words; "" if nothing does."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    tries = [(umeyama(est, ref), umeyama(est, ref).scale)] if metric else []
    if tries:
        fit, scale = tries[0]
        if _rms(fit(est) - ref) < actual / tuning.explained:
            return f"the reference is {scale:.4g} times as large as the model"
    found = min(_hypotheses(match, metric, tuning, step_s), default=(np.inf, ""))
    return found[1] if found[0] < actual / tuning.explained else ""


def _hypotheses(match: PoseMatch, metric: bool, tuning: JudgeTuning, step_s: float) -> Iterator[tuple[float, str]]:
    """(error left, what it would be) of a mirror image, an axis of another scale, and a lag."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    yield _left(est, -ref, metric), "the reference is a mirror image: one of its axes is negated, or two are exchanged"
    for axis in range(3):
        left, factor = _axis_scale(est, ref, axis, metric, tuning)
        text = f"the reference's {_AXES[axis]} axis differs in scale, it is {1 / factor:.3g} times that of the others"
        yield left, text
    yield _lag(match, metric, tuning.lag_rounds, step_s)


def _axis_scale(est: np.ndarray, ref: np.ndarray, axis: int, metric: bool, tuning: JudgeTuning) -> tuple[float, float]:
    """Error left and factor that an axis of the reference is to be multiplied by to agree best."""

    def left(log: float) -> float:
        return _left(est, _scaled(ref, axis, 10**log), metric)

    start = min(np.linspace(-tuning.axis_decades, tuning.axis_decades, tuning.axis_starts), key=left)
    reach = tuning.axis_bracket_decades
    best = minimize_scalar(left, bounds=(start - reach, start + reach), method="bounded")
    return float(best.fun), float(10**best.x)


def _lag(match: PoseMatch, metric: bool, rounds: int, step_s: float) -> tuple[float, str]:
    """Error left with the reference moved along its own way by one number of frames."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    speed = np.zeros_like(ref)
    for rows in match.sequences():
        if len(rows) > 2:
            at = match.order[rows].astype(float)
            speed[rows] = np.gradient(ref[rows], np.maximum.accumulate(at + 1e-9 * np.arange(len(at))), axis=0)
    frames = 0.0
    for _ in range(rounds):
        fit = umeyama(est, ref + frames * speed, with_scale=not metric)
        off = fit(est) - ref
        frames = float(np.sum(off * speed) / max(np.sum(speed**2), 1e-12))
    said = f"{frames:+.2f} frames" + (f" ({frames * step_s:+.3f} s)" if np.isfinite(step_s) else "")
    return _left(est, ref + frames * speed, metric), f"the reference's times are off by {said}"


def _scaled(points: np.ndarray, axis: int, factor: float) -> np.ndarray:
    out = points.copy()
    out[:, axis] *= factor
    return out


def _left(est: np.ndarray, ref: np.ndarray, metric: bool) -> float:
    """Root mean square distance after the best alignment."""
    return _rms(umeyama(est, ref, with_scale=not metric)(est) - ref)


def _rms(off: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _m(value: float) -> str:
    return f"{value:.3g} m" if value >= 0.01 else f"{1000 * value:.2g} mm"
