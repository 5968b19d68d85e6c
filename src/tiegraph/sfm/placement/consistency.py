"""Is every frame where its images say it is? What COLMAP's statistics do not show, asked of each frame and block.

A repeated wall holds a frame, a block or a whole pass at the wrong place with ties that agree among themselves, and a
bad start lets it slide along a straight path. What gives it away are the verified matches that the mapper had to throw
out, those to the neighbours in the pass above all: the points that others made of them are not where it sees them.
Frames are asked one by one and in the groups that their agreeing ties join: each of three frames that stand wrong
together has most of its ties with the other two, which agree. How a pass goes on says nothing: who numbers photographs
of a yard makes jumps too, and what stands beyond one on false ties has its neighbours' true ones against it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.scene.scene import Scene
from tiegraph.scene.weakties import strongest_first
from tiegraph.sfm.tuning.placement import ConsistencyTuning
from tiegraph.sfm.verified import VerifiedMatches


@dataclass(frozen=True)
class ConsistencyVotes:
    """What ties say of a model: matches of frame a with b that agree and that contradict, as a tells: by a, then b."""

    agree: Mapping[int, Mapping[int, float]]
    contradict: Mapping[int, Mapping[int, float]]
    tuning: ConsistencyTuning

    def of(self, frame: int, others: set[int] | None = None) -> list[float]:
        """Agreeing and contradicting matches of a frame with others."""
        tables = (table.get(frame, {}) for table in (self.agree, self.contradict))
        return [sum((v for other, v in own.items() if others is None or other in others), 0.0) for own in tables]

    def partners(self, frame: int, others: set[int]) -> set[int]:
        """Those of the others whose ties to a frame agree."""
        return self.agree.get(frame, {}).keys() & others


def consistency_votes(
    verified: VerifiedMatches, agreed: np.ndarray, scene: Scene, tuning: ConsistencyTuning
) -> ConsistencyVotes:
    """Sum the image pairs (``verified.agreement``) over pairs of frames."""
    agree: dict[int, dict[int, float]] = {}
    contradict: dict[int, dict[int, float]] = {}
    for (i, j), (*own, total) in zip(scene.frame[verified.pairs].tolist(), agreed.tolist()):
        for a, b, part in ((i, j, own[0]), (j, i, own[1])):
            if a != b and total and not tuning.contradicts * total <= part < tuning.agrees * total:
                table = (agree if part >= tuning.agrees * total else contradict).setdefault(a, {})
                table[b] = table.get(b, 0.0) + total
    return ConsistencyVotes(agree, contradict, tuning)


def contradiction(
    frames: Collection[int], believed: set[int], votes: ConsistencyVotes, near: Sequence[set[int]]
) -> tuple[float, str]:
    """By how many matches the ties of frames to believed others contradict their place more than they agree, and why
    that speaks against it; "" if it does not. ``near``: the neighbours of every frame on its pass, which are asked
    first: false ties bind what is far apart."""
    others, sums, partners = believed - set(frames), np.zeros(4), set[int]()
    for frame in frames:
        sums += [*votes.of(frame, others), *votes.of(frame, near[frame] & others)]
        partners |= votes.partners(frame, others)
    (agree, against, agree_near, against_near), tuning, why = sums.tolist(), votes.tuning, ""
    lone = max(tuning.min_votes, tuning.lone_against * (agree + against))
    if against_near >= tuning.min_votes and against_near > agree_near:
        why = f"its ties to its neighbours contradict its place ({against_near:.0f} matches to {agree_near:.0f})"
    elif against >= tuning.min_votes and against > agree:
        why = f"most of its ties contradict its place ({against:.0f} matches to {agree:.0f})"
    elif len(partners) < tuning.min_partners and against >= lone:
        why = (
            f"no more than {len(partners)} frame agrees with its place ({agree:.0f} matches), and {against:.0f} "
            "matches with others contradict it"
        )
    return against - agree, why


def suspect_frames(placed: Collection[int], scene: Scene, votes: ConsistencyVotes) -> dict[tuple[int, ...], str]:
    """Of the frames that have a place those whose ties contradict it, and why: by themselves, or together with those
    they are tied to most, which agree among themselves. First those whose ties contradict most, for a pass at a wrong
    place contradicts every frame of the others too; never the larger half."""
    near, believed = neighbours(scene, votes.tuning.near_steps), set(placed)
    out: dict[tuple[int, ...], str] = {}
    asked = [[frame] for frame in sorted(believed)] + _groups(votes, believed, len(near))
    told = [(*contradiction(frames, believed, votes, near), frames) for frames in asked]
    for _, why, frames in sorted(told, key=lambda one: -one[0]):
        own = [f for f in frames if f in believed]
        if not why or not 0 < len(own) <= max(1, len(believed) // 2):
            continue
        if why := contradiction(own, believed, votes, near)[1]:
            together = f", asked together with the {len(own) - 1} it is tied to most" if len(own) > 1 else ""
            out[tuple(own)] = why + together
            believed -= set(own)
    return out


def _groups(votes: ConsistencyVotes, placed: set[int], frames: int) -> list[list[int]]:
    """Those that agreeing ties join, up to half of all."""
    strength: dict[tuple[int, int], float] = {}
    for a, own in votes.agree.items():
        for b, value in own.items():
            strength[min(a, b), max(a, b)] = strength.get((min(a, b), max(a, b)), 0.0) + value
    ends = np.array(sorted(strength), int).reshape(-1, 2)
    groups = strongest_first(ends[:, 0], ends[:, 1], np.array([strength[a, b] for a, b in ends.tolist()]), frames)
    return [own for group in groups if 1 < len(own := [f for f in group.tolist() if f in placed]) <= len(placed) // 2]


def neighbours(scene: Scene, near_steps: int) -> list[set[int]]:
    """The frames within so many steps of each on its pass, without itself."""
    order = np.lexsort((scene.sequence_index, scene.sequence))
    key = (
        scene.sequence[order].astype(np.int64) * (4 * near_steps + int(scene.sequence_index.max(initial=0)))
        + scene.sequence_index[order]
    )
    low, high = np.searchsorted(key, key - near_steps), np.searchsorted(key, key + near_steps, side="right")
    out: list[set[int]] = [set() for _ in range(scene.frames)]
    for place, frame in enumerate(order.tolist()):
        if scene.sequence[frame] >= 0:
            out[frame] = set(order[low[place] : high[place]].tolist()) - {frame}
    return out
