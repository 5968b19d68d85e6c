"""The results of frame-offset voting: curves, pairs, and functions shared by its two modes (local and constant)."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tiegraph.network.rig import axes
from tiegraph.network.rig.axes import angles_deg
from tiegraph.network.scorematrix import ScoreMatrix
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import CountsTuning
from tiegraph.network.tuning.rig import RigTuning
from tiegraph.scene.pairs import Pairs
from tiegraph.text import csv_text


@dataclass(frozen=True)
class OffsetCurve:
    """Votes against frame offset for two cameras: offset = n - m, or n + m when the other pass runs the other way.

    offsets (K,) i4; votes (K,) f4 mean preview matches above chance; best: offset with most votes; accepted: whether
    the camera pair gave candidates.
    """

    pass_a: str
    pass_b: str
    sensor_a: str
    sensor_b: str
    offsets: np.ndarray
    votes: np.ndarray
    best: int
    accepted: bool
    reversed: bool


@dataclass(frozen=True)
class Proposal:
    """The pairs that a source proposes, and notes."""

    pairs: Pairs
    notes: tuple[str, ...] = ()
    curves: tuple[OffsetCurve, ...] = ()
    apart: bool = False  # according to the images the poses of different passes are not in one world
    stranger: str = ""  # the pair of passes, if it has no common view

    def __or__(self, other: "Proposal") -> "Proposal":
        return Proposal(
            pairs=self.pairs | other.pairs,
            notes=self.notes + other.notes,
            curves=self.curves + other.curves,
            apart=self.apart or other.apart,
        )


def facing(scores: ScoreMatrix, excess: np.ndarray, settings: CandidatesSettings, tuning: RigTuning) -> np.ndarray:
    """(S, T) bool: camera pairs whose axes permit a match at the heading of q relative to p; all,
    if that is unknown."""
    yaw = axes.yaw(scores, excess, tuning)
    if yaw is None:
        return np.ones(excess.shape[:2], bool)
    return angles_deg(scores.p.rig, yaw) <= settings.axes_deg


def curves_of(
    scores: ScoreMatrix,
    backwards: bool,
    accepted: np.ndarray,
    min_matches: int,
    tuning: CountsTuning,
    best: np.ndarray | None = None,
) -> tuple[OffsetCurve, ...]:
    """One curve for each camera pair; ``best`` (S, T) is the voted offset, if there is one."""
    p, q = scores.p, scores.q
    out = []
    for c, d in np.argwhere(scores.allowed):
        if scores.same and c >= d:
            continue
        offsets, votes = votes_of(scores, (int(c), int(d)), backwards, min_matches, tuning)
        if not len(offsets):
            continue
        winner = int(offsets[np.argmax(votes)] if best is None else best[c, d])
        curve = OffsetCurve(
            pass_a=p.name,
            pass_b=q.name,
            sensor_a=p.rig.sensors[c].name,
            sensor_b=q.rig.sensors[d].name,
            offsets=offsets,
            votes=votes,
            best=winner,
            accepted=bool(accepted[c, d]),
            reversed=backwards,
        )
        out.append(curve)
    return tuple(out)


def votes_of(
    scores: ScoreMatrix,
    cameras: tuple[int, int],
    backwards: bool,
    min_matches: int,
    tuning: CountsTuning,
    total: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (K,) and matches above chance at each, mean over the previewed frames (or their sum)."""
    inliers = scores.inliers[cameras]
    m, n = np.meshgrid(scores.rows, scores.columns, indexing="ij")
    offset = (n + m if backwards else n - m)[np.isfinite(inliers)]
    value = np.maximum(0, inliers[np.isfinite(inliers)] - tuning.floor * min_matches)
    offsets, at = np.unique(offset, return_inverse=True)
    votes = np.bincount(at, value, minlength=len(offsets)).astype(np.float64)
    if not total:
        votes = votes / np.maximum(np.bincount(at, minlength=len(offsets)), 1)
    return offsets.astype(np.int32), votes.astype(np.float32)


def curves_csv(curves: Iterable[OffsetCurve]) -> str:
    """CSV of the curves, one row for each offset of two cameras."""
    heads = ["pass1", "camera1", "pass2", "camera2", "direction", "offset", "votes", "best", "accepted"]
    rows = (
        [c.pass_a, c.sensor_a, c.pass_b, c.sensor_b, "back" if c.reversed else "same", offset, f"{votes:.6g}",
         int(offset == c.best), int(c.accepted)]
        for c in curves
        for offset, votes in zip(c.offsets, c.votes)
    )  # fmt: skip
    return csv_text(heads, rows)
