"""Whether a run holds a tolerance in the world: yes, no, or it cannot be told; why, and what would make it yes."""

from __future__ import annotations

import numpy as np

from tiegraph.evaluate.accuracy import Hold, Predicted, Stated
from tiegraph.scene.accuracy import Accuracy, Answer, Figure

YES, NO, OPEN = "yes", "no", "cannot be told"
_CHECK = "check points, spread over the survey and not used in the adjustment; one or two are too few"


def answered(tolerance_m: float, accuracy: Accuracy, stated: Stated, contradicted: bool, min_checks: int) -> Answer:
    """The answer to a tolerance of a point in the world, metres.

    Held: the standard deviation of nine in ten points of the cloud is within it, and so is what was measured
    independently (root mean square). Not held: what was measured is beyond it, or, where nothing was, the standard
    deviation of half of the points is. Fewer than ``min_checks`` check points hold nothing, but may refuse it. The text
    names no figures: they stand beside it, in the layers.
    """
    measured = [f for f in accuracy.of("world") if f.independent and np.isfinite(f.measured)]
    enough = [f for f in measured if f.key != "world.check_points" or stated.hold.checks >= min_checks]
    beyond = next((f for f in measured if f.measured > tolerance_m), None)
    said, why, remedy = _judged(tolerance_m, stated, beyond, enough)
    if said == YES and contradicted:
        said, why, remedy = OPEN, "the survey contradicts itself", "what settles the contradictions stated above"
    return Answer(tolerance_m=tolerance_m, said=said, why=why, remedy=remedy)


def _judged(tolerance_m: float, stated: Stated, beyond: Figure | None, measured: list[Figure]) -> tuple[str, str, str]:
    """The answer, why, and what would make it yes."""
    predicted, hold = stated.predicted, stated.hold
    if not predicted.metric:
        return OPEN, "nothing tells the scale", "positions, control points, or the size of the rig"
    if not np.isfinite(predicted.placed_m):
        return OPEN, "nothing holds the survey in the world", "control points, or positions of its frames"
    if beyond is not None:
        return NO, f"{beyond.by} measured more", _remedy(predicted, hold)
    half, most = predicted.world_m <= tolerance_m, predicted.world_90_m <= tolerance_m
    if most and measured:
        return YES, f"predicted of nine in ten points, and {measured[0].by} measured no more", ""
    if most:
        return OPEN, "predicted of nine in ten points, but nothing independent measured it", _CHECK
    if not np.isfinite(predicted.world_m):
        return OPEN, "nothing is predicted of the cloud's points", _CHECK
    share = "half of the points, not of nine in ten" if half else "less than half of the points"
    if half or measured:
        here = f"; {measured[0].by} measured no more, which is not the cloud as a whole" if measured else ""
        return OPEN, f"predicted of {share}{here}", _remedy(predicted, hold)
    return NO, f"predicted of {share}, and nothing independent says otherwise", _remedy(predicted, hold)


def _remedy(predicted: Predicted, hold: Hold) -> str:
    """What would bring the largest part of the error down."""
    # of points: what turns and stretches the whole moves them more than cameras
    placed = float(np.sqrt(max(predicted.world_m**2 - np.nan_to_num(predicted.point_m) ** 2, 0.0)))
    parts = {"placed": placed, "inside": predicted.inside_m, "point": predicted.point_m}
    largest = max(parts, key=lambda name: np.nan_to_num(parts[name]))
    if largest == "point":
        return "images nearer to the surface or with more pixels, and more of them of each point"
    if largest == "inside":
        return "more overlap between images, a second pass, and ties between passes"
    if not hold.control:
        lost = f", positions under the bridge ({hold.covered} frames have none)" if hold.covered else ""
        return f"control points on both sides and at both ends of the way{lost}"
    return "more control points, to the sides and at the ends of the way"
