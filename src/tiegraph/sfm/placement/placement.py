"""Is every frame where its images say it is? What COLMAP's statistics do not show, asked of each frame and block.

A repeated wall holds a frame, a block or a whole pass at the wrong place with ties that agree among themselves. What
gives it away: the course of the pass jumps, and the verified ties to the neighbours in the pass, which the mapper had
to throw out, all disagree. Such frames are placed again from the ties of their neighbours, or left out with the reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiegraph.scene.scene import Scene
from tiegraph.sfm.placement.steps import Course, Piece, pieces
from tiegraph.sfm.placement.verified import Verified

NEAR = 3  # steps of a pass within which a tie is one of the neighbours'
AGREES, CONTRADICTS = 0.5, 0.25  # share of a pair's matches that the model explains
MIN_VOTES = 30.0  # matches that make an opinion of two frames


@dataclass(frozen=True)
class Votes:
    """What the ties of frame pairs say of a model: agreeing and contradicting matches by (a, b), a < b."""

    agree: Mapping[tuple[int, int], float]
    contradict: Mapping[tuple[int, int], float]

    def of(self, frame: int, others: set[int] | None = None) -> tuple[float, float]:
        """Agreeing and contradicting matches of a frame with others."""
        sums = [0.0, 0.0]
        for side, table in enumerate(self._beside):
            own = table.get(frame, {})
            sums[side] = float(sum(v for other, v in own.items() if others is None or other in others))
        return sums[0], sums[1]

    @cached_property
    def _beside(self) -> tuple[dict[int, dict[int, float]], ...]:
        """Both tables by frame: asking every frame must not read every pair."""
        out = []
        for table in (self.agree, self.contradict):
            by_frame: dict[int, dict[int, float]] = {}
            for (a, b), value in table.items():
                by_frame.setdefault(a, {})[b] = value
                by_frame.setdefault(b, {})[a] = value
            out.append(by_frame)
        return tuple(out)


def votes(verified: Verified, agreed: np.ndarray, scene: Scene) -> Votes:
    """Sum the image pairs (``verified.agreement``) over pairs of frames."""
    share = agreed[:, 0] / np.maximum(agreed[:, 1], 1)
    agree: dict[tuple[int, int], float] = {}
    contradict: dict[tuple[int, int], float] = {}
    for (i, j), (_, total), part in zip(verified.pairs.tolist(), agreed, share):
        a, b = sorted((int(scene.frame[i]), int(scene.frame[j])))
        if a == b or total == 0:
            continue
        if part >= AGREES:
            agree[a, b] = agree.get((a, b), 0.0) + float(total)
        elif part < CONTRADICTS:
            contradict[a, b] = contradict.get((a, b), 0.0) + float(total)
    return Votes(agree, contradict)


@dataclass(frozen=True)
class Doubt:
    """Frames that stand together at a doubtful place, and why."""

    frames: tuple[int, ...]
    why: str


@dataclass(frozen=True)
class Judgement:
    """The frames of the main block and the doubtful ones."""

    main: tuple[int, ...]
    doubts: tuple[Doubt, ...]


def judge(positions: np.ndarray, scene: Scene, way: Course, said: Votes) -> Judgement:
    """Blocks that a jump tears from the largest one, and single frames whose neighbours' ties all disagree."""
    cut = pieces(positions, scene, way)
    blocks = _blocks(cut, said)
    blocks.sort(key=lambda block: -sum(len(p.frames) for p in block))
    doubts = [Doubt(tuple(sorted(f for p in block for f in p.frames)), _torn(block, way)) for block in blocks[1:]]
    main = {f for p in blocks[0] for f in p.frames} if blocks else set()
    unordered = {f for f in np.flatnonzero(np.isfinite(positions).all(axis=1)).tolist()} - {
        f for block in blocks for p in block for f in p.frames
    }
    main |= unordered
    near = _near(scene)
    for frame in sorted(main):
        why = _contradicted(frame, said, near[frame] & main)
        if why:
            doubts.append(Doubt((frame,), why))
    single = {f for d in doubts for f in d.frames}
    return Judgement(tuple(sorted(main - single)), tuple(doubts))


def _torn(block: list[Piece], way: Course) -> str:
    usual = np.mean([way.usual[p.track] for p in block])
    return f"the course of its pass jumps there (a usual step is {usual:.3g} units)"


def _near(scene: Scene) -> list[set[int]]:
    """The frames within NEAR steps of each on its pass, without itself."""
    order = np.lexsort((scene.step, scene.track))
    key = scene.track[order].astype(np.int64) * (4 * NEAR + int(scene.step.max(initial=0))) + scene.step[order]
    low, high = np.searchsorted(key, key - NEAR), np.searchsorted(key, key + NEAR, side="right")
    out: list[set[int]] = [set() for _ in range(scene.frames)]
    for place, frame in enumerate(order.tolist()):
        if scene.track[frame] >= 0:
            out[frame] = set(order[low[place] : high[place]].tolist()) - {frame}
    return out


def _contradicted(frame: int, said: Votes, near: set[int]) -> str:
    """Why the ties of a frame speak against its place; "" if they do not. ``near``: believed frames close by."""
    by_near, against_near = said.of(frame, near)
    agree, against = said.of(frame)
    if against_near >= MIN_VOTES and against_near > by_near:
        return f"its ties to its neighbours contradict its place ({against_near:.0f} matches to {by_near:.0f})"
    if against >= MIN_VOTES and against > agree:
        return f"most of its ties contradict its place ({against:.0f} matches to {agree:.0f})"
    return ""


def _blocks(cut: list[Piece], said: Votes) -> list[list[Piece]]:
    """Pieces joined by agreeing ties, strongest first; two pieces of one pass that a jump parts never join."""
    owner = {f: k for k, p in enumerate(cut) for f in p.frames}
    weight: dict[tuple[int, int], float] = {}
    for (a, b), value in said.agree.items():
        if a in owner and b in owner and owner[a] != owner[b]:
            key = (min(owner[a], owner[b]), max(owner[a], owner[b]))
            weight[key] = weight.get(key, 0.0) + value
    block = {k: [k] for k in range(len(cut))}
    home = {k: k for k in range(len(cut))}
    for (a, b), value in sorted(weight.items(), key=lambda item: -item[1]):
        one, two = home[a], home[b]
        tracks = {cut[k].track for k in block[one]}
        if one == two or value < MIN_VOTES or tracks & {cut[k].track for k in block[two]}:
            continue
        for k in block[two]:
            home[k] = one
        block[one] += block.pop(two)
    return [[cut[k] for k in members] for members in block.values()]
