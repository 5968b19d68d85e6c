"""Is every frame where its images say it is? What COLMAP's statistics do not show, asked of each frame and block.

A repeated wall holds a frame, a block or a whole pass at the wrong place with ties that agree among themselves, and a
bad start lets it slide along a straight path. What gives it away are the verified matches that the mapper had to throw
out: the points that others made of them are not where it sees them. A place of whose matches the model leaves clearly
more than it explains is in doubt.

Frames are asked one by one and in the groups that their agreeing ties join: each of three frames that stand wrong
together has most of its ties with the other two, which agree. How a pass goes on says nothing: who numbers photographs
of a yard makes jumps too. Nor is more told by asking the neighbours on a pass first, by asking for two frames that
agree or by counting whole pairs by the share that agrees (``slid.py`` in ``benchmarks/sfm/README.md``).
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, triu

from tiegraph.scene.scene import Scene
from tiegraph.scene.weakties import strongest_first
from tiegraph.sfm.tuning.placement import ConsistencyTuning
from tiegraph.sfm.verified import VerifiedMatches


@dataclass(frozen=True)
class ConsistencyVotes:
    """Matches between frames that a model explains (``agree``) and that it does not (``against``), as the row's frame
    tells (F, F)."""

    agree: csr_array
    against: csr_array


def consistency_votes(verified: VerifiedMatches, agreed: np.ndarray, scene: Scene) -> ConsistencyVotes:
    """Sum the image pairs (``verified.agreement``) over pairs of frames."""
    first, second = scene.frame[verified.pairs].T
    apart = first != second
    at = np.concatenate([first, second]), np.concatenate([second, first])
    agree, against = (
        coo_array((np.tile(apart, 2) * v, at), (scene.frames, scene.frames)).tocsr()
        for v in (agreed[:, :2].T.ravel(), (agreed[:, 2:] - agreed[:, :2]).T.ravel())
    )
    return ConsistencyVotes(agree, against)


def contradiction(
    frames: Collection[int], believed: np.ndarray, votes: ConsistencyVotes, tuning: ConsistencyTuning
) -> tuple[float, str]:
    """By how many matches frames and believed others (F,) bool contradict each other more than they agree, and why that
    speaks against their place; "" if it does not, or not clearly."""
    others, own = believed.astype(float), list(frames)
    others[own] = 0
    agree, against = (float((table[own] @ others).sum()) for table in (votes.agree, votes.against))
    doubtful = against >= tuning.min_votes and against > tuning.loses * agree
    why = f"most of its matches contradict its place ({against:.0f} to {agree:.0f})" if doubtful else ""
    return against - agree, why


def suspect_frames(
    placed: Collection[int], votes: ConsistencyVotes, tuning: ConsistencyTuning
) -> dict[tuple[int, ...], str]:
    """Of the frames that have a place those whose matches contradict it, and why: by themselves, or together with those
    they are tied to most, which agree among themselves. First those whose matches contradict most, for a pass at a
    wrong place contradicts every frame of the others too; never the larger half."""
    believed = np.zeros(votes.agree.shape[0], bool)
    believed[list(placed)] = True
    half = max(1, len(placed) // 2)
    out: dict[tuple[int, ...], str] = {}
    asked = [[frame] for frame in sorted(placed)] + list(_groups(votes, believed, half))
    told = [(*contradiction(frames, believed, votes, tuning), frames) for frames in asked]
    for _, why, frames in sorted(told, key=lambda one: -one[0]):
        own = [f for f in frames if believed[f]]
        if not why or not 0 < len(own) <= max(1, int(believed.sum()) // 2):
            continue
        if why := contradiction(own, believed, votes, tuning)[1]:
            together = f", asked together with the {len(own) - 1} it is tied to most" if len(own) > 1 else ""
            out[tuple(own)] = why + together
            believed[own] = False
    return out


def _groups(votes: ConsistencyVotes, placed: np.ndarray, most: int) -> Iterator[list[int]]:
    """Those that agreeing ties join, up to so many."""
    strength = triu(votes.agree + votes.agree.T, 1, format="coo")
    strength.eliminate_zeros()
    for group in strongest_first(strength.row, strength.col, strength.data, len(placed)):
        own = group[placed[group]].tolist()
        if 1 < len(own) <= most:
            yield own
