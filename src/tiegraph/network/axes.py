"""Which cameras can match according to the optical axes of a rig, within a pass and between passes.

The relation of two passes, heading and direction of one relative to the other, is stated only with many votes. Chance
alone leaves a few nodes above the threshold: on two synthetic passes that share nothing 2 to 8 effective votes and
yaws 1 to 2 standard deviations above those of cameras paired at random; of true ones hundreds of votes and 9 to 17.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.network.scorematrix import ScoreMatrix
from tiegraph.network.tuning import RigTuning, Tuning
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.rig import Rig

PAIRS_NAMED = 8


def allowed_within(rig: Rig, limit_deg: float) -> np.ndarray:
    """(S, S) bool: camera pairs of one pass whose axes permit a match; all, if the extrinsics are unknown."""
    angles = rig.axis_angles_deg()
    return ~(angles > limit_deg)


def vertical(rig: Rig) -> np.ndarray:
    """Unit vector (3,) in the rig frame about which a vehicle turns: normal of the plane of the side cameras' axes.

    With fewer than three side cameras, or axes that span no plane, the reference camera is assumed level.
    """
    axes = np.stack(
        [s.optical_axis() for s in rig.sensors if s.role != "up"] or [s.optical_axis() for s in rig.sensors]
    )
    up = np.array([0.0, -1.0, 0.0])
    if len(axes) < 3 or not np.isfinite(axes).all():
        return up
    _, size, rows = np.linalg.svd(axes)
    if size[1] < 0.5 or size[2] > 0.5 * size[1]:
        return up
    return rows[2] if rows[2] @ up >= 0 else -rows[2]


def angles_deg(rig: Rig, yaw_deg: float) -> np.ndarray:
    """(S, S) angles between axis c in one pass and axis d in a pass whose heading differs by ``yaw_deg``."""
    axes = np.stack([s.optical_axis() for s in rig.sensors])
    turn = Rotation.from_rotvec(np.radians(yaw_deg) * vertical(rig)).as_matrix()
    return np.degrees(np.arccos(np.clip(axes @ (axes @ turn.T).T, -1, 1)))


def yaw_between(rig: Rig, evidence: np.ndarray) -> float | None:
    """Heading difference in degrees that best explains which cameras (S, S) match; None without evidence.

    Matching cameras look in the same direction: the yaw with the greatest evidence-weighted cosine between axes.
    """
    side = np.array([s.role != "up" for s in rig.sensors])
    evidence = evidence * side[:, None] * side[None, :]
    if evidence.sum() <= 0:
        return None
    yaws = np.arange(0, 360, 12.0)
    score = [np.sum(evidence * np.cos(np.radians(angles_deg(rig, y)))) for y in yaws]
    return float(yaws[int(np.argmax(score))])


def predicted_shift(rig: Rig, a: int, b: int) -> np.ndarray:
    """(2,) motion in the picture from camera a to b of an object midway between their axes."""
    pose_a, pose_b = rig.sensors[a].sensor_from_rig, rig.sensors[b].sensor_from_rig
    assert pose_a is not None and pose_b is not None
    centres = transforms.centre(pose_a), transforms.centre(pose_b)
    baseline = float(np.linalg.norm(centres[1] - centres[0]))
    # Objects are assumed ten baselines away
    middle = rig.sensors[a].optical_axis() + rig.sensors[b].optical_axis()
    away = 10 * max(baseline, 1e-3) * middle / max(np.linalg.norm(middle), 1e-9)
    thing = 0.5 * (centres[0] + centres[1]) + away
    seen = [transforms.apply(pose, thing[None])[0] for pose in (pose_a, pose_b)]
    return seen[1][:2] / max(seen[1][2], 1e-3) - seen[0][:2] / max(seen[0][2], 1e-3)


def votes(excess: np.ndarray) -> float:
    """Effective number of independent votes (Kish) in evidence of any shape: (sum w)^2 / sum w^2."""
    total = float(excess.sum())
    return total * total / float(np.sum(excess.astype(float) ** 2)) if total > 0 else 0.0


def direction(scores: ScoreMatrix, excess: np.ndarray) -> tuple[bool, bool]:
    """Whether frames of q run opposite to those of p (sign of the rank correlation), and whether
    that is significant."""
    weight = excess.sum(axis=(0, 1)).astype(float)
    if weight.sum() <= 0:
        return False, False
    share = weight / weight.sum()
    m, n = scores.rows - share.sum(axis=1) @ scores.rows, scores.columns - share.sum(axis=0) @ scores.columns
    spread = float(np.sqrt((m**2 @ share.sum(axis=1)) * (n**2 @ share.sum(axis=0))))
    correlation = float(m @ share @ n) / max(spread, 1e-12)
    return correlation < 0, abs(correlation) * np.sqrt(votes(excess)) >= LIMIT


def yaw(scores: ScoreMatrix, excess: np.ndarray) -> float | None:
    """Heading of q relative to p in degrees from the matching cameras; None if rigs differ or the votes are too few."""
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
    return best if mean - float(cosine[level].mean()) >= LIMIT * sigma > 0 else None


def in_words(scores: ScoreMatrix, excess: np.ndarray, tuning: RigTuning) -> str:
    """The relation of pass q to pass p by evidence (S, T, A, B) above the threshold; empty if there is none."""
    turned, (backwards, sure) = yaw(scores, excess), direction(scores, excess)
    if turned is None and not sure:
        return ""
    way = ("runs back along" if backwards else "follows") if sure else "shares views with"
    heading = "" if turned is None else f", turned by about {turned:.0f} deg"
    weight = excess.sum(axis=(0, 1))
    frames, partly = [], False
    for p, ranks, own in ((scores.p, scores.rows, weight.sum(axis=1)), (scores.q, scores.columns, weight.sum(axis=0))):
        hot = ranks[own > tuning.rim * own.max()]
        partly |= bool(hot[-1] - hot[0] + 1 < (1 - 2 * tuning.rim) * len(p))
        frames.append(f"frames {hot[0] + 1} to {hot[-1] + 1} of {len(p)} of {p.name}")
    common = f"; common view: {' and '.join(frames)}" if partly else ""
    return f"{scores.q.name} {way} {scores.p.name}{heading} (voted by previews){common}"


def above(smooth: np.ndarray, min_matches: int) -> np.ndarray:
    """(S, T, A, B) smoothed matches above ``min_matches``, 0 if less or not measured."""
    return np.maximum(0, np.nan_to_num(smooth) - min_matches)


def without_chance(scores: ScoreMatrix, smooth: np.ndarray, min_matches: int, tuning: Tuning) -> np.ndarray:
    """``smooth`` lowered to chance between two passes when too few nodes of all are above ``min_matches``."""
    least = min(tuning.verdict.votes, tuning.rig.common_share * int(np.isfinite(scores.inliers).sum()))
    if scores.same or votes(above(smooth, min_matches)) >= least:
        return smooth
    chance = tuning.counts.floor * min_matches
    return np.where(np.isnan(smooth), smooth, np.minimum(smooth, chance)).astype(np.float32)


def strangers(couples: list[str]) -> tuple[str, ...]:
    """One note for all pairs of passes without a common view."""
    if not couples:
        return ()
    more = len(couples) - PAIRS_NAMED
    rest = f" and {more} more pairs of passes" if more > 0 else ""
    return (f"no common view was found: {', '.join(couples[:PAIRS_NAMED])}{rest}",)
