"""References against what was predicted: an error far beyond its sigma contradicts; what would explain it."""

from collections.abc import Iterator, Sequence

import numpy as np
import scipy

from tiegraph.evaluate.trajectory import PoseMatch
from tiegraph.evaluate.tuning import JudgeTuning
from tiegraph.geometry.align import rms_length, umeyama
from tiegraph.scene.accuracy import Figure
from tiegraph.scene.evidence import RARELY, fits_better

_AXES = "xyz"


def against_poses(
    match: PoseMatch,
    figures: Sequence[Figure],
    metric: bool,
    tuning: JudgeTuning,
    step_s: float = float("nan"),
    registered: float = 1.0,
) -> list[str]:
    """Sentences about reference poses (K) that the model contradicts by ``figures`` (``accuracy.pose_figures``).

    ``metric``: the model's own scale is known; ``step_s``: the frames' interval, to say a lag in seconds;
    ``registered``: share of the images that are.
    """
    by_key = {f.key: f for f in figures}
    whole, placed = by_key["shape.whole"], by_key.get("world.reference_poses")
    if beyond(whole, tuning):
        why = (
            _explained(match, metric, tuning, step_s, registered >= tuning.whole)
            or "one of the two is wrong by more than it says"
        )
        return [f"the reference poses and the model differ by {_said(whole, metric)}: {why}"]
    if placed is not None and beyond(placed, tuning):
        east, north, up = np.mean(match.estimate[:, :3, 3] - match.reference[:, :3, 3], axis=0)
        return [
            f"the reference poses and the model differ by {_said(placed, True)} on the Earth, though their shapes "
            "agree: "
            f"the model stands {east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up of it: another datum or origin?"
        ]
    return []


def against_cloud(figure: Figure, tuning: JudgeTuning) -> list[str]:
    """Sentences about a reference cloud that the cloud contradicts: half its points are farther than predicted."""
    if not beyond(figure, tuning):
        return []
    return [
        f"the reference cloud and the cloud differ by {_said(figure, True)} (median): "
        "another frame or datum, or a place that has changed"
    ]


def beyond(figure: Figure, tuning: JudgeTuning) -> bool:
    """Whether what was measured contradicts what was predicted; never where one of them is not known."""
    return figure.measured > tuning.beyond_sigmas * figure.predicted


def _said(figure: Figure, metric: bool) -> str:
    values = (_m(v) if metric else f"{v:.3g} units" for v in (figure.measured, figure.predicted))
    return ", predicted ".join(values)


def _explained(match: PoseMatch, metric: bool, tuning: JudgeTuning, step_s: float, whole: bool) -> str:
    """What of the reference would explain the difference better than chance does, in words; "" if nothing does."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    actual, free = _left(est, ref, metric), 3 * min(len(est), tuning.counted) - 7  # unknowns of a similarity
    if metric and fits_better(actual, _left(est, ref, False), free):
        return f"the reference is {umeyama(est, ref).scale:.4g} times as large as the model, {RARELY}"
    left, why = min(_hypotheses(match, metric, tuning, step_s, whole))
    return f"{why}, {RARELY}" if fits_better(actual, left, free) else ""


def _hypotheses(
    match: PoseMatch, metric: bool, tuning: JudgeTuning, step_s: float, whole: bool
) -> Iterator[tuple[float, str]]:
    """(error left, what it would be) of a mirror image of a ``whole`` model, an axis of another scale, and a lag."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    if whole:
        yield (
            _left(est, -ref, metric),
            "the reference is a mirror image: one of its axes is negated, or two are exchanged",
        )
    for axis in range(3):
        left, factor = _axis_scale(est, ref, axis, metric, tuning)
        text = f"the reference's {_AXES[axis]} axis differs in scale, it is {1 / factor:.3g} times that of the others"
        yield left, text
    yield _lag(match, metric, tuning.lag_rounds, step_s)


def _axis_scale(est: np.ndarray, ref: np.ndarray, axis: int, metric: bool, tuning: JudgeTuning) -> tuple[float, float]:
    """Error left and factor that an axis of the reference is to be multiplied by to agree best."""

    def left(log: float) -> float:
        return _left(est, ref * np.where(np.arange(3) == axis, 10**log, 1.0), metric)

    start = min(np.linspace(-tuning.axis_decades, tuning.axis_decades, tuning.axis_starts), key=left)
    reach = tuning.axis_bracket_decades
    best = scipy.optimize.minimize_scalar(left, bounds=(start - reach, start + reach), method="bounded")
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


def _left(est: np.ndarray, ref: np.ndarray, metric: bool) -> float:
    """Root mean square distance after the best alignment."""
    return rms_length(umeyama(est, ref, with_scale=not metric)(est) - ref)


def _m(value: float) -> str:
    if value >= 1000:
        return f"{value:.0f} m"
    return f"{value:.3g} m" if value >= 0.01 else f"{1000 * value:.2g} mm"
