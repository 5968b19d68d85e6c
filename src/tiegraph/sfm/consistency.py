"""Which frames, alone or together, stand where their verified matches say they do not.

A repeated wall can hold a frame, a block or a whole pass at a wrong place with ties that agree with each other, and a
bad start lets a frame slide along a straight path. The verified matches that the mapper had to reject reveal it: the
points that other frames made of them are not where this frame sees them (``verified``). A frame is in doubt if the
model rejects clearly more of its matches than it explains.

Frames are tested singly and in the groups that their agreeing ties join: each of three wrongly placed frames has most
of its ties with the other two, which agree. The continuity of a pass is no evidence: photographs of a yard are
numbered with jumps. Testing the neighbours on a pass first, asking for two agreeing frames or counting whole pairs by
the share that agrees finds no more (``slid.py`` in ``benchmarks/sfm/README.md``).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import coo_array, csr_array, triu

from tiegraph.scene.graph import strongest_first
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.placement import ConsistencyTuning, PlacementTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches, agreement, image_observations, read_verified

_LEAST = 5  # frames in a table


@dataclass(frozen=True)
class ConsistencyVotes:
    """(F, F) matches between frames that a model explains (``agree``) or contradicts (``against``), from the points
    of the row's frame."""

    agree: csr_array
    against: csr_array


def consistency_votes(verified: VerifiedMatches, agreed: np.ndarray, scene: Scene) -> ConsistencyVotes:
    """Sum the votes of image pairs (``verified.agreement``) over pairs of frames."""
    first, second = scene.frame[verified.pairs].T
    apart = first != second
    at = np.concatenate([first, second]), np.concatenate([second, first])
    agree, against = (
        coo_array((np.tile(apart, 2) * v, at), (scene.frames, scene.frames)).tocsr()
        for v in (agreed[:, :2].T.ravel(), (agreed[:, 2:] - agreed[:, :2]).T.ravel())
    )
    return ConsistencyVotes(agree, against)


def contradiction(
    frames: Collection[int], believed: np.ndarray, votes: ConsistencyVotes, least: float, ratio: float
) -> tuple[float, str]:
    """The excess of contradicting over agreeing matches between frames and trusted others (F,) bool, and the reason
    why that speaks against their place; "" if they are fewer than ``least`` or ``ratio`` times the agreeing ones."""
    others, own = believed.astype(float), list(frames)
    others[own] = 0
    agree, against = (float((table[own] @ others).sum()) for table in (votes.agree, votes.against))
    doubtful = against >= least and against > ratio * agree
    why = f"most of its matches contradict its place in the model ({against:.0f} to {agree:.0f})" if doubtful else ""
    return against - agree, why


def suspect_frames(
    placed: Collection[int], votes: ConsistencyVotes, least: float, ratio: float
) -> dict[tuple[int, ...], str]:
    """Placed frames whose matches contradict their place, with the reason: singly, or together with the frames they
    are tied to most. Frames with the most contradictions come first, because a pass at a wrong place makes every
    other frame contradict too. Never the larger half."""
    believed = np.zeros(votes.agree.shape[0], bool)
    believed[list(placed)] = True
    half = max(1, len(placed) // 2)
    out: dict[tuple[int, ...], str] = {}
    asked = [[frame] for frame in sorted(placed)] + list(_groups(votes, believed, half))
    told = [(*contradiction(frames, believed, votes, least, ratio), frames) for frames in asked]
    for _, why, frames in sorted(told, key=lambda one: -one[0]):
        own = [f for f in frames if believed[f]]
        if not why or not 0 < len(own) <= max(1, int(believed.sum()) // 2):
            continue
        if why := contradiction(own, believed, votes, least, ratio)[1]:
            together = f", tested together with the {len(own) - 1} frames it is tied to most" if len(own) > 1 else ""
            out[tuple(own)] = why + together
            believed[own] = False
    return out


def _groups(votes: ConsistencyVotes, placed: np.ndarray, most: int) -> Iterator[list[int]]:
    """Groups of frames that agreeing ties join, up to this size."""
    strength = triu(votes.agree + votes.agree.T, 1, format="coo")
    strength.eliminate_zeros()
    for group in strongest_first(strength.row, strength.col, strength.data, len(placed)):
        own = group[placed[group]].tolist()
        if 1 < len(own) <= most:
            yield own


@dataclass(frozen=True)
class MatchSource:
    """The database with the verified matches, and pairs (scene indices) that do not count."""

    database: Path
    refused: Sequence[tuple[int, int]] = ()

    def read(self, scene: Scene) -> VerifiedMatches:
        """Read the matches."""
        return read_verified(self.database, scene, self.refused)


@dataclass(frozen=True)
class Explained:
    """Which verified matches a model explains, by pair of images (``agreement``), and why frames are in doubt: single
    frames, and ``parts`` that are wrong together."""

    scene: Scene
    verified: VerifiedMatches
    seen: ImageObservations
    agreed: np.ndarray
    votes: ConsistencyVotes
    parts: Mapping[tuple[int, ...], str]
    tuning: ConsistencyTuning

    @property
    def doubts(self) -> dict[int, str]:
        """Reasons by frame."""
        return {f: why for frames, why in self.parts.items() for f in frames}

    def in_doubt(self, ratio: float) -> "Explained":
        """With the parts that so many times as many matches contradict as agree with."""
        placed = {int(self.scene.frame[k]) for k in self.seen.cameras}
        return replace(self, parts=suspect_frames(placed, self.votes, self.tuning.min_votes, ratio))

    def percent(self) -> float:
        """Percentage of the matches with a verdict that the model explains."""
        return float(50 * self.agreed[:, :2].sum() / max(self.agreed[:, 2].sum(), 1.0))

    def of_frames(self) -> np.ndarray:
        """(F, 2): explained matches of each frame with others, and all of them."""
        agree, against = (np.asarray(table.sum(axis=1)) for table in (self.votes.agree, self.votes.against))
        return np.column_stack([agree, agree + against])

    def table(self) -> dict:
        """Table of the frames whose matches with others the model explains least."""
        matches = self.of_frames()
        share = matches[:, 0] / np.maximum(matches[:, 1], 1)
        least = [f for f in np.argsort(share, kind="stable").tolist() if matches[f, 1] > 0][:_LEAST]
        rows = [[self.scene.frame_names[f], int(matches[f, 1]), round(100 * float(share[f]), 1)] for f in least]
        return {"columns": ["frame", "matches", "explained %"], "rows": rows}


def explained(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: PlacementTuning
) -> Explained:
    """Test a model against all its verified matches."""
    seen = image_observations(model, scene, tuning.agreement)
    agreed = agreement(verified, seen)
    votes = consistency_votes(verified, agreed, scene)
    found = Explained(
        scene=scene, verified=verified, seen=seen, agreed=agreed, votes=votes, parts={}, tuning=tuning.consistency
    )
    return found.in_doubt(tuning.consistency.loses)
