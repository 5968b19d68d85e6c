"""Evidence between the frames of two passes, ready to be drawn: one surface for the rig and one a camera pair."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from tiegraph.network.scorematrix import ScoreMatrix
from tiegraph.network.tuning import Tuning

MAX_CAMERA_PAIRS = 12  # of a couple of passes: those with the most evidence
MAX_NODES = 600  # of either pass, which is more than a panel has pixels: all of two long ones took 20 GiB to draw


@dataclass(frozen=True)
class OffsetSurface:
    """Evidence that frames of two passes see the same, what is kept of it, and the path through it.

    rows (A,), columns (B,): ranks of the frames of pass a and b; evidence (A, B) f4 preview matches above chance, of
    all cameras together for the rig, NaN = not looked at; kept (A, B) bool; path (A,) rank in pass b that a row shares
    most with, NaN = none (and within one pass); sensors: the camera pair, "" = the whole rig.
    """

    pass_a: str
    pass_b: str
    rows: np.ndarray
    columns: np.ndarray
    evidence: np.ndarray
    kept: np.ndarray
    path: np.ndarray
    sensors: str = ""


def surfaces_of(scores: ScoreMatrix, smooth: np.ndarray, threshold: float, tuning: Tuning) -> tuple[OffsetSurface, ...]:
    """The surface of the rig and of its strongest camera pairs; ``smooth`` (S, T, A, B) as ``ScoreMatrix.smoothed``,
    kept where it reaches ``threshold``. Of long passes every so many-th node."""
    surface = tuning.offsets.surface
    every = -(-max(smooth.shape[2:]) // MAX_NODES)
    thin = np.index_exp[:, :, ::every, ::every]
    rows, columns = scores.rows[::every], scores.columns[::every]
    scores, smooth = replace(scores, rows=rows, columns=columns, inliers=scores.inliers[thin]), smooth[thin]
    kept = np.nan_to_num(smooth) >= threshold
    excess = _excess(scores, threshold, tuning)
    if scores.same:  # a frame and itself
        excess = np.where(np.equal.outer(scores.rows, scores.columns), np.nan, excess)
    # Cameras that share next to nothing were looked at on a coarser grid: they would only add its pattern.
    looked = np.isfinite(excess).sum(axis=(2, 3))
    voted = looked >= surface.coarse * looked.max(initial=0)
    total = np.nansum(excess[voted], axis=0)
    seen = np.isfinite(excess[voted]).any(axis=0)
    path = np.full(len(scores.rows), np.nan)
    if not scores.same:
        node = minimum_cost_path(total, np.any(kept, axis=(0, 1)), surface.bend)
        path = np.where(np.isnan(node), np.nan, scores.columns[np.nan_to_num(node).astype(int)])
    out = [_surface(scores, np.where(seen, total, np.nan), np.any(kept, axis=(0, 1)), path, "")]
    weight = np.nansum(np.where(kept, excess, 0), axis=(2, 3))
    for flat in np.argsort(-weight, axis=None, kind="stable"):
        c, d = (int(x) for x in np.unravel_index(flat, weight.shape))
        if len(out) > MAX_CAMERA_PAIRS or weight[c, d] <= surface.faint * weight.max() or weight.size == 1:
            break
        if not (scores.same and c > d):
            names = scores.p.rig.sensors[c].name, scores.q.rig.sensors[d].name
            out.append(_surface(scores, excess[c, d], kept[c, d], path, " \N{EN DASH} ".join(names)))
    return tuple(out)


def _excess(scores: ScoreMatrix, threshold: float, tuning: Tuning) -> np.ndarray:
    """(S, T, A, B) f4 matches above chance, smoothed over frames but not cut off so soon as for the decision."""
    known = np.isfinite(scores.inliers)
    low, high = tuning.counts.floor * threshold, tuning.offsets.surface.ceiling * threshold
    above = np.where(known, np.clip(scores.inliers, low, high) - low, 0)
    sigma = (0, 0, tuning.counts.sigma_nodes, tuning.counts.sigma_nodes)
    weight = gaussian_filter(known.astype(np.float32), sigma, mode="constant")
    mean = gaussian_filter(above.astype(np.float32), sigma, mode="constant") / np.maximum(weight, 1e-6)
    return np.where(known, mean, np.nan).astype(np.float32)


def _surface(
    scores: ScoreMatrix, evidence: np.ndarray, kept: np.ndarray, path: np.ndarray, sensors: str
) -> OffsetSurface:
    return OffsetSurface(
        pass_a=scores.p.name,
        pass_b=scores.q.name,
        rows=scores.rows,
        columns=scores.columns,
        evidence=evidence.astype(np.float32),
        kept=kept,
        path=path,
        sensors=sensors,
    )


def minimum_cost_path(evidence: np.ndarray, kept: np.ndarray, bend: float) -> np.ndarray:
    """(A,) column of the strongest path through evidence (A, B) from the first to the last row; NaN in rows of which
    nothing is ``kept`` (A, B). Dynamic programme; moving aside has a price (``bend``), so that a lone peak does not
    catch it."""
    gain = np.nan_to_num(evidence)
    rows, columns = gain.shape
    lane = bend * float(gain.max(initial=0)) * np.arange(columns)
    cost, came = -gain[0], np.zeros((rows, columns), int)
    for a in range(1, rows):
        left, left_at = _running_least(cost - lane)
        right, right_at = _running_least((cost + lane)[::-1])
        right, right_at = right[::-1], columns - 1 - right_at[::-1]
        from_left = left + lane <= right - lane
        came[a] = np.where(from_left, left_at, right_at)
        cost = np.where(from_left, left + lane, right - lane) - gain[a]
    path = np.zeros(rows, int)
    path[-1] = int(np.argmin(cost))
    for a in range(rows - 1, 0, -1):
        path[a - 1] = came[a, path[a]]
    return np.where(kept.any(axis=1), path.astype(float), np.nan)


def _running_least(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least value up to each place, and where it stands."""
    least = np.minimum.accumulate(values)
    return least, np.maximum.accumulate(np.where(values == least, np.arange(len(values)), 0))
