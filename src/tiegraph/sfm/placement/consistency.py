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
from functools import cached_property

import numpy as np

from tiegraph.scene.scene import Scene
from tiegraph.scene.weakties import strongest_first
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


def suspect_frames(placed: Collection[int], scene: Scene, scores: ConsistencyVotes) -> tuple[SuspectFrames, ...]:
    """Of the frames that have a place those whose ties contradict it, by themselves or together with those they are
    tied to most, which agree among themselves. First the frames or groups whose ties contradict most, for a pass at a
    wrong place contradicts every frame of the others too; never the larger half."""
    near, believed, out = neighbours(scene, scores.tuning.near_steps), set(placed), []
    asked = [[frame] for frame in sorted(believed)] + _groups(scores, believed, len(near))
    told = [consistency_score(frames, believed, scores, near) for frames in asked]
    for k in sorted(range(len(asked)), key=lambda k: told[k].agree - told[k].against):
        own = [f for f in asked[k] if f in believed]
        if not told[k].contradiction() or not 0 < len(own) <= max(1, len(believed) // 2):
            continue
        why = consistency_score(own, believed, scores, near).contradiction()
        if why:
            together = f", asked together with the {len(own) - 1} it is tied to most" if len(own) > 1 else ""
            out.append(SuspectFrames(tuple(own), why + together))
            believed -= set(own)
    return tuple(out)


def _groups(scores: ConsistencyVotes, placed: set[int], frames: int) -> list[list[int]]:
    """Those that agreeing ties join, the strongest first."""
    ends = np.array(sorted({(min(pair), max(pair)) for pair in scores.agree}), int).reshape(-1, 2)
    strength = np.array([scores.agree.get((a, b), 0.0) + scores.agree.get((b, a), 0.0) for a, b in ends.tolist()])
    groups = strongest_first(ends[:, 0], ends[:, 1], strength, frames)
    return [own for group in groups if len(own := [f for f in group.tolist() if f in placed]) > 1]


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
