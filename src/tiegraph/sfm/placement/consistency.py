"""Is every frame where its images say it is? What COLMAP's statistics do not show, asked of each frame and block.

A repeated wall holds a frame, a block or a whole pass at the wrong place with ties that agree among themselves. What
gives it away are the verified ties to the neighbours in the pass, which the mapper had to throw out: they all disagree.
A jump in the course of a pass is a reason to ask, never one to leave a frame out: whoever numbers photographs of a yard
makes jumps too. Frames whose ties contradict their place, or hardly hold it where the course jumps, are left out with
the reason. Frames are asked one by one and in the groups that their agreeing ties join: each of three frames that stand
wrong together has most of its ties with the other two, which agree.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiegraph.scene.scene import Scene
from tiegraph.scene.weakties import strongest_first
from tiegraph.sfm.placement.continuity import MotionContinuity, Segment, segments
from tiegraph.sfm.tuning.placement import ConsistencyTuning
from tiegraph.sfm.verified import VerifiedMatches


@dataclass(frozen=True)
class ConsistencyVotes:
    """What ties say of a model: agreeing and contradicting matches by (a, b): of frame a with frame b, as a tells."""

    agree: Mapping[tuple[int, int], float]
    contradict: Mapping[tuple[int, int], float]
    tuning: ConsistencyTuning

    def of(self, frame: int, others: set[int] | None = None) -> tuple[float, float]:
        """Agreeing and contradicting matches of a frame with others."""
        sums = [0.0, 0.0]
        for side, table in enumerate(self._beside):
            own = table.get(frame, {})
            sums[side] = float(sum(v for other, v in own.items() if others is None or other in others))
        return sums[0], sums[1]

    def partners(self, frame: int, others: set[int]) -> set[int]:
        """Those of the others whose ties to a frame agree."""
        return self._beside[0].get(frame, {}).keys() & others

    @cached_property
    def _beside(self) -> tuple[dict[int, dict[int, float]], ...]:
        """Both tables by frame: asking every frame must not read every pair."""
        out: list[dict[int, dict[int, float]]] = []
        for table in (self.agree, self.contradict):
            out.append({})
            for (a, b), value in table.items():
                out[-1].setdefault(a, {})[b] = value
        return tuple(out)


def consistency_votes(
    verified: VerifiedMatches, agreed: np.ndarray, scene: Scene, tuning: ConsistencyTuning
) -> ConsistencyVotes:
    """Sum the image pairs (``verified.agreement``) over pairs of frames."""
    agree: dict[tuple[int, int], float] = {}
    contradict: dict[tuple[int, int], float] = {}
    for ends, (*own, total) in zip(scene.frame[verified.pairs].tolist(), agreed.tolist()):
        if ends[0] == ends[1] or total == 0:
            continue
        for pair, part in zip((tuple(ends), tuple(ends[::-1])), own):
            if part >= tuning.agrees * total:
                agree[pair] = agree.get(pair, 0.0) + total
            elif part < tuning.contradicts * total:
                contradict[pair] = contradict.get(pair, 0.0) + total
    return ConsistencyVotes(agree, contradict, tuning)


@dataclass(frozen=True)
class SuspectFrames:
    """Frames that stand together at a doubtful place, and why."""

    frames: tuple[int, ...]
    why: str


@dataclass(frozen=True)
class ConsistencyCheck:
    """The frames of the main block, the doubtful ones, and those of the main block that stand beyond a jump."""

    main: tuple[int, ...]
    suspects: tuple[SuspectFrames, ...]
    beyond: tuple[int, ...] = ()


@dataclass(frozen=True)
class ConsistencyScore:
    """What the ties of some frames to believed ones say of their place, in matches, and how many of these agree."""

    agree: float
    against: float
    agree_near: float  # the neighbours on the pass alone
    against_near: float
    partners: int
    tuning: ConsistencyTuning

    def contradiction(self) -> str:
        """Why they speak against the place; "" if they do not.

        The neighbours on the pass are asked first: false ties bind what is far apart.
        """
        least = self.tuning.min_votes
        if self.against_near >= least and self.against_near > self.agree_near:
            return (
                f"its ties to its neighbours contradict its place ({self.against_near:.0f} matches to "
                f"{self.agree_near:.0f})"
            )
        if self.against >= least and self.against > self.agree:
            return f"most of its ties contradict its place ({self.against:.0f} matches to {self.agree:.0f})"
        alone = self.partners < self.tuning.min_partners
        if alone and self.against >= max(least, self.tuning.lone_against * (self.agree + self.against)):
            return (
                f"no more than {self.partners} frame agrees with its place ({self.agree:.0f} matches), and "
                f"{self.against:.0f} matches with others contradict it"
            )
        return ""

    def holds(self) -> bool:
        """Whether they hold the place by themselves, whatever the course of a pass says."""
        enough = self.agree >= self.tuning.min_votes and self.partners >= self.tuning.min_partners
        return enough and not self.contradiction()


def consistency_score(
    frames: Collection[int], believed: set[int], scores: ConsistencyVotes, near: Sequence[set[int]]
) -> ConsistencyScore:
    """Of the ties of frames to believed ones; ``near``: the neighbours of every frame on its pass (``neighbours``)."""
    others = believed - set(frames)
    sums = np.zeros(4)
    partners: set[int] = set()
    for frame in frames:
        sums += [*scores.of(frame, others), *scores.of(frame, near[frame] & others)]
        partners |= scores.partners(frame, others)
    agree, against, agree_near, against_near = sums.tolist()
    return ConsistencyScore(
        agree=agree,
        against=against,
        agree_near=agree_near,
        against_near=against_near,
        partners=len(partners),
        tuning=scores.tuning,
    )


def check_consistency(
    positions: np.ndarray, scene: Scene, continuity: MotionContinuity, scores: ConsistencyVotes
) -> ConsistencyCheck:
    """Blocks that a jump parts from the rest and that their ties do not hold there, and frames whose ties contradict
    their place, by themselves or together with those they are tied to most."""
    blocks = [
        sorted(f for _, frames in block for f in frames)
        for block in _blocks(segments(positions, scene, continuity), scores)
    ]
    blocks.sort(key=lambda block: -len(block))
    near = neighbours(scene, scores.tuning.near_steps)
    main = set(blocks[0]) if blocks else set()
    main |= set(np.flatnonzero(np.isfinite(positions).all(axis=1)).tolist()) - {f for block in blocks for f in block}
    beyond, parted = _held(blocks[1:], main, scores, near)
    main |= set(beyond)
    suspects = [SuspectFrames(tuple(block), _torn(consistency_score(block, main, scores, near))) for block in parted]
    for frame in sorted(main):
        why = consistency_score([frame], main, scores, near).contradiction()
        if why:
            suspects.append(SuspectFrames((frame,), why))
    suspects += _wrong_together(main, {f for d in suspects for f in d.frames}, scores, near)
    doubted = {f for d in suspects for f in d.frames}
    return ConsistencyCheck(tuple(sorted(main - doubted)), tuple(suspects), tuple(sorted(set(beyond) - doubted)))


def _wrong_together(
    main: set[int], doubted: set[int], scores: ConsistencyVotes, near: Sequence[set[int]]
) -> list[SuspectFrames]:
    """Groups of frames that agree among themselves and that their ties to the others contradict, each before those it
    is part of; never the larger half. ``doubted``: frames that are in doubt by themselves."""
    ends = np.array(sorted(scores.agree), int).reshape(-1, 2)
    believed, out = main - doubted, []
    strength = np.array([scores.agree[a, b] for a, b in ends.tolist()])
    for group in strongest_first(ends[:, 0], ends[:, 1], strength, len(near)):
        own = [f for f in group.tolist() if f in believed]
        if not 1 < len(own) <= len(believed) // 2:
            continue
        why = consistency_score(own, believed, scores, near).contradiction()
        if why:
            out.append(SuspectFrames(tuple(own), f"{why}, asked together with the {len(own) - 1} it is tied to most"))
            believed = believed - set(own)
    return out


def _held(
    blocks: list[list[int]], main: set[int], scores: ConsistencyVotes, near: Sequence[set[int]]
) -> tuple[list[int], list[list[int]]]:
    """Frames of the blocks that their ties hold where they are, and the other blocks; each lets the next lean on it."""
    beyond: list[int] = []
    while True:
        held = [b for b in blocks if consistency_score(b, main | set(beyond), scores, near).holds()]
        if not held:
            return beyond, blocks
        beyond += [f for b in held for f in b]
        blocks = [b for b in blocks if b not in held]


def _torn(ties: ConsistencyScore) -> str:
    """Why a block beyond a jump is in doubt: by what its ties say."""
    return ties.contradiction() or (
        f"the course of its pass jumps there and its ties hardly hold it ({ties.agree:.0f} matches with "
        f"{ties.partners} frames agree)"
    )


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


def _blocks(cut: list[Segment], scores: ConsistencyVotes) -> list[list[Segment]]:
    """Pieces joined by agreeing ties, strongest first; two pieces of one pass that a jump parts never join."""
    owner = {f: k for k, (_, frames) in enumerate(cut) for f in frames}
    weight: dict[tuple[int, int], float] = {}
    for (a, b), value in scores.agree.items():
        if a in owner and b in owner and owner[a] != owner[b]:
            key = (min(owner[a], owner[b]), max(owner[a], owner[b]))
            weight[key] = weight.get(key, 0.0) + value
    block = {k: [k] for k in range(len(cut))}
    home = {k: k for k in range(len(cut))}
    for (a, b), value in sorted(weight.items(), key=lambda item: -item[1]):
        one, two = home[a], home[b]
        tracks = {cut[k][0] for k in block[one]}
        if one == two or value < scores.tuning.min_votes or tracks & {cut[k][0] for k in block[two]}:
            continue
        for k in block[two]:
            home[k] = one
        block[one] += block.pop(two)
    return [[cut[k] for k in members] for members in block.values()]
