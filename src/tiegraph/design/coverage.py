"""Coverage: is the network of pairs connected, and where is it weak. Seconds on a field laptop (paper 003).

Pairs alone do not show it: where hardly anything matches, many pairs are tried. So the existing matches of the previews
are used. A pair that may fail at full resolution does not count: on small images an essential matrix
finds twenty inliers in noise. Pairs that are almost sure to be verified join features to tracks, and frames that share
few of these with all the others are named.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.design.matchprediction import verified_chance
from tiegraph.design.tuning import Tuning
from tiegraph.scene.graph import (
    WeaklyTied,
    component_notes,
    components,
    cuts,
    frame_links,
    groups,
    named,
    parts,
    two_links,
    weakly_tied,
)
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.scene import Scene
from tiegraph.text import some

_COLUMNS = ["kind", "where", "frames at stake", "independent links", "matched points"]
_LISTED = 200  # weak links in the table, worst first


@dataclass(frozen=True)
class Coverage:
    """``lines`` for people, worst first; ``table`` of the weak links {"columns", "rows"}; ``counts`` by name;
    ``sound``: everything is connected and nothing depends on a single link."""

    lines: tuple[str, ...]
    table: dict[str, Any]
    counts: dict[str, int]

    @property
    def sound(self) -> bool:
        """Whether nothing is missing and nothing depends on one link."""
        weak = ("alone", "bridges", "joints", "weak_groups", "on_few_points")
        return not any(self.counts[k] for k in weak) and (self.counts["components"] <= 1)


def on_few_points(pairs: Pairs, scene: Scene, ties: PreviewMatches, tuning: Tuning) -> tuple[WeaklyTied, ...]:
    """Frames, and groups of frames, that the kept pairs tie to all others by few points, by the matches of previews.

    Nothing if no kept pair was previewed: then only the pairs can be judged.
    """
    kept = pairs.kept()
    own = ties.where(np.isin(np.arange(len(ties)), ties.find(kept.i, kept.j)))
    if not len(own):
        return ()
    sure = own.where(verified_chance(own.counts(), tuning.match_prediction) >= tuning.holding.sure)
    track, image = sure.tracks()
    everywhere = np.ones(scene.frames, bool)
    return weakly_tied(track, scene.frame[image], everywhere, tuning.few_points, tuning.few_points_alone)


def unknown_across(pairs: Pairs, scene: Scene, ties: PreviewMatches, weak: Sequence[WeaklyTied]) -> np.ndarray:
    """(P,) bool: kept pairs without a preview that tie weakly tied frames to others: perhaps their only ties."""
    side = np.full(scene.frames, -1)
    for number, group in enumerate(weak):
        side[list(group.frames)] = number
    across = side[scene.frame[pairs.i]] != side[scene.frame[pairs.j]]
    return across & (pairs.dropped == 0) & (ties.find(pairs.i, pairs.j) < 0)


def coverage(pairs: Pairs, scene: Scene, weak: Sequence[WeaklyTied] = ()) -> Coverage:
    """Weak places of the kept pairs: images without pair, separate components, single links, joints, loose groups,
    and ``weak``, groups with few points (``on_few_points``).

    The images of a frame are one node, because the rig connects them. A single link (bridge) is a pair, or pairs that
    share one image, without which frames come apart; a joint (articulation point) is a frame without which they do.
    """
    kept = pairs.kept()
    links = frame_links(kept.i, kept.j, scene)
    found = cuts(links.a, links.b, scene.frames, links.independent > 1)
    bridges = np.flatnonzero(found.bridge)
    bridges = bridges[np.argsort(-found.side[bridges], kind="stable")]
    joints = np.flatnonzero(found.joint)
    joints = joints[np.argsort(-found.falls[joints], kind="stable")]
    rows: list[list[Any]] = []
    loose = _loose_groups(kept, scene)
    rows += [[kind, name, frames, count, None] for kind, name, frames, count in loose]
    rows += [["few points", named(g, scene.frame_names), len(g.frames), None, g.points] for g in weak]
    for k in bridges[:_LISTED]:
        pair = links.row[k]
        where = f"{scene.names[kept.i[pair]]} - {scene.names[kept.j[pair]]}"
        rows.append(["single link", where, int(found.side[k]), 1, None])
    for k in joints[:_LISTED]:
        rows.append(["joint", scene.frame_names[k], int(found.falls[k]), 1, None])
    lines = component_notes(pairs, scene) + _lines(rows, len(bridges), len(joints))
    size = np.bincount(components(pairs, len(scene)), minlength=1)
    counts = {
        "images": len(scene),
        "pairs": len(kept),
        "components": int(parts(links.a, links.b, scene.frames).max(initial=-1)) + 1,
        "alone": int(np.sum(size == 1)) if len(scene) > 1 else 0,
        "bridges": len(bridges),
        "joints": len(joints),
        "weak_groups": len(loose),
        "on_few_points": sum(len(group.frames) for group in weak),
    }
    return Coverage(lines or (_fine(counts),), {"columns": list(_COLUMNS), "rows": rows}, counts)


def _fine(counts: dict[str, int]) -> str:
    return f"{counts['pairs']} pairs connect {counts['images']} images; no place depends on a single link"


def _loose_groups(kept: Pairs, scene: Scene) -> list[tuple[str, str, int, int]]:
    """Cameras, passes and sections tied to the rest by fewer than two pairs without a common image."""
    out = []
    for group in groups(scene):
        count = len(two_links(kept.i, kept.j, group.member, np.zeros(len(kept))))
        if count < 2:
            out.append((group.kind, group.name, len(np.unique(scene.frame[group.member])), count))
    return out


def _lines(rows: list[list[Any]], bridges: int, joints: int) -> tuple[str, ...]:
    out = []
    for kind in ("section", "pass", "camera"):
        for count, words in ((0, "no pair ties"), (1, "only one independent link ties")):
            names = [str(r[1]) for r in rows if r[0] == kind and r[3] == count]
            if names:
                out.append(f"{words} {kind} {some(names, 10)} to the others")
    few = [f"{r[1]}: {r[4]}" for r in rows if r[0] == "few points"]
    if few:
        out.append(f"hardly tied to the others, matched points that they share with them: {some(few, 5)}")
    single = [f"{r[1]} ({_frames(r[2])})" for r in rows if r[0] == "single link"]
    if bridges:
        words = f"{bridges} single {_plural('link', bridges)}, frames that depend on it in brackets"
        out.append(f"{words}: {some(single, 5, bridges)}")
    joint = [f"{r[1]} ({_frames(r[2])})" for r in rows if r[0] == "joint"]
    if joints:
        words = f"{joints} {_plural('joint', joints)} (in brackets the frames lost without this frame)"
        out.append(f"{words}: {some(joint, 5, joints)}")
    return tuple(out)


def _plural(word: str, count: int) -> str:
    return word if count == 1 else word + "s"


def _frames(count: int) -> str:
    return f"{count} {_plural('frame', count)}"
