"""What two passes have in common: heading and direction of one against the other, said only where votes are many.

Chance alone leaves a few nodes above the threshold: on two synthetic passes that share nothing 2 to 8 effective votes
and yaws 1 to 2 standard deviations above those of cameras paired at random; of true ones hundreds of votes and 9 to 17.
"""

import numpy as np

from tiegraph.network.rig.axes import angles_deg, yaw_between
from tiegraph.network.scorematrix import ScoreMatrix
from tiegraph.network.tuning import Tuning
from tiegraph.network.tuning.rig import CommonViewTuning, RigTuning

PAIRS_NAMED = 8


def votes(excess: np.ndarray) -> float:
    """Effective number of independent votes (Kish) in evidence of any shape: (sum w)^2 / sum w^2."""
    total = float(excess.sum())
    return total * total / float(np.sum(excess.astype(float) ** 2)) if total > 0 else 0.0


def direction(scores: ScoreMatrix, excess: np.ndarray, tuning: CommonViewTuning) -> tuple[bool, bool]:
    """Whether frames of q run against those of p (sign of the rank correlation), and whether that is significant."""
    weight = excess.sum(axis=(0, 1)).astype(float)
    if weight.sum() <= 0:
        return False, False
    share = weight / weight.sum()
    m, n = scores.rows - share.sum(axis=1) @ scores.rows, scores.columns - share.sum(axis=0) @ scores.columns
    spread = float(np.sqrt((m**2 @ share.sum(axis=1)) * (n**2 @ share.sum(axis=0))))
    correlation = float(m @ share @ n) / max(spread, 1e-12)
    return correlation < 0, abs(correlation) * np.sqrt(votes(excess)) >= tuning.direction_sigmas


def yaw(scores: ScoreMatrix, excess: np.ndarray, tuning: RigTuning) -> float | None:
    """Heading of q against p in degrees by which cameras match; None where rigs differ or the votes are too few."""
    p, q = scores.p, scores.q
    if p.rig_index != q.rig_index or not p.rig.known() or len(p.images) < 2:
        return None
    side = np.array([s.role != "up" for s in p.rig.sensors])
    level = side[:, None] & side[None, :]
    evidence = excess.sum(axis=(2, 3)) * level
    best = yaw_between(p.rig, evidence)
    if best is None:
        return None
    cosine = np.cos(np.radians(angles_deg(p.rig, best)))
    mean = float(np.sum(evidence * cosine) / evidence.sum())
    sigma = float(cosine[level].std()) / np.sqrt(votes(excess[level]))
    return best if mean - float(cosine[level].mean()) >= tuning.common_view.yaw_sigmas * sigma > 0 else None


def in_words(scores: ScoreMatrix, excess: np.ndarray, tuning: RigTuning) -> str:
    """How pass q lies to pass p by evidence (S, T, A, B) above the threshold; empty where there is nothing to say."""
    turned, (backwards, sure) = yaw(scores, excess, tuning), direction(scores, excess, tuning.common_view)
    if turned is None and not sure:
        return ""
    way = ("runs back along" if backwards else "follows") if sure else "shares views with"
    heading = "" if turned is None else f", turned by about {turned:.0f} deg"
    frames = _frames(scores, excess, tuning.common_view)
    return f"{scores.q.name} {way} {scores.p.name}{heading} (voted by previews){frames}"


def _frames(scores: ScoreMatrix, excess: np.ndarray, tuning: CommonViewTuning) -> str:
    """The frames in common, where they are not nearly all of both passes."""
    weight = excess.sum(axis=(0, 1))
    said, partly = [], False
    for p, ranks, own in ((scores.p, scores.rows, weight.sum(axis=1)), (scores.q, scores.columns, weight.sum(axis=0))):
        hot = ranks[own > tuning.rim * own.max()]
        partly |= bool(hot[-1] - hot[0] + 1 < tuning.whole * len(p))
        said.append(f"frames {hot[0] + 1} to {hot[-1] + 1} of {len(p)} of {p.name}")
    return f"; common view: {' and '.join(said)}" if partly else ""


def above(smooth: np.ndarray, min_matches: int) -> np.ndarray:
    """(S, T, A, B) smoothed matches above ``min_matches``, 0 where less or not measured."""
    return np.maximum(0, np.nan_to_num(smooth) - min_matches)


def without_chance(scores: ScoreMatrix, smooth: np.ndarray, min_matches: int, tuning: Tuning) -> np.ndarray:
    """``smooth`` lowered to chance between two passes when too few nodes of all are above ``min_matches``."""
    view = tuning.rig.common_view
    least = min(view.least_votes, view.least_share * int(np.isfinite(scores.inliers).sum()))
    if scores.same or votes(above(smooth, min_matches)) >= least:
        return smooth
    chance = tuning.counts.floor * min_matches
    return np.where(np.isnan(smooth), smooth, np.minimum(smooth, chance)).astype(np.float32)


def strangers(couples: list[str]) -> tuple[str, ...]:
    """One note for all couples of passes without a common view."""
    if not couples:
        return ()
    more = len(couples) - PAIRS_NAMED
    rest = f" and {more} more couples of passes" if more > 0 else ""
    return (f"no common view was found: {', '.join(couples[:PAIRS_NAMED])}{rest}",)
