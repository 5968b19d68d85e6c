"""Coverage: does the network of pairs hold together, and where is it weak. Seconds on a field laptop (paper 003)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.scene.graph import component_notes, components, cuts, frame_links, groups, parts, some, two_links
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

_COLUMNS = ["kind", "where", "frames at stake", "independent links"]
_LISTED = 200  # weak links in the table, worst first


@dataclass(frozen=True)
class Coverage:
    """``lines`` for people, worst first; ``table`` of the weak links {"columns", "rows"}; ``counts`` by name;
    ``sound``: everything is connected and nothing hangs on a single link."""

    lines: tuple[str, ...]
    table: dict[str, Any]
    counts: dict[str, int]

    @property
    def sound(self) -> bool:
        """Whether nothing is missing and nothing hangs on one link."""
        return not any(self.counts[k] for k in ("alone", "bridges", "joints", "weak_groups")) and (
            self.counts["components"] <= 1
        )


def coverage(pairs: Pairs, scene: Scene) -> Coverage:
    """Weak places of the kept pairs: images without pair, parts that are apart, single links, joints, loose groups.

    The images of a frame are one node, for the rig holds them. A single link (bridge) is a pair, or pairs that share
    one image, without which frames come apart; a joint (articulation point) is a frame without which they do.
    """
    kept = pairs.kept()
    links = frame_links(kept.i, kept.j, scene)
    found = cuts(links.a, links.b, scene.frames, links.independent > 1)
    bridges = np.flatnonzero(found.bridge)
    bridges = bridges[np.argsort(-found.side[bridges], kind="stable")]
    joints = np.flatnonzero(found.joint)
    joints = joints[np.argsort(-found.falls[joints], kind="stable")]
    first_image = _first_images(scene)
    rows: list[list[Any]] = []
    loose = _loose_groups(kept, scene)
    rows += [[kind, name, frames, count] for kind, name, frames, count in loose]
    for k in bridges[:_LISTED]:
        pair = links.row[k]
        where = f"{scene.names[kept.i[pair]]} - {scene.names[kept.j[pair]]}"
        rows.append(["single link", where, int(found.side[k]), 1])
    for k in joints[:_LISTED]:
        rows.append(["joint", scene.names[first_image[k]], int(found.falls[k]), 1])
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
    }
    return Coverage(lines or (_fine(counts),), {"columns": list(_COLUMNS), "rows": rows}, counts)


def _fine(counts: dict[str, int]) -> str:
    return f"{counts['pairs']} pairs hold {counts['images']} images together; no place hangs on a single link"


def _first_images(scene: Scene) -> np.ndarray:
    """(F,) the first image of each frame."""
    out = np.zeros(scene.frames, int)
    out[scene.frame[::-1]] = np.arange(len(scene))[::-1]
    return out


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
                out.append(f"{words} {kind} {some(names)} to the others")
    named = [f"{r[1]} ({_frames(r[2])})" for r in rows if r[0] == "single link"]
    if bridges:
        out.append(
            f"{bridges} single {_plural('link', bridges)}, frames that hang on it in brackets: {_first(named, bridges)}"
        )
    named = [f"{r[1]} ({_frames(r[2])})" for r in rows if r[0] == "joint"]
    if joints:
        words = f"{joints} {_plural('joint', joints)} (in brackets what falls off without this frame)"
        out.append(f"{words}: {_first(named, joints)}")
    return tuple(out)


def _first(named: list[str], total: int, limit: int = 5) -> str:
    return ", ".join(named[:limit]) + (f" and {total - limit} more" if total > limit else "")


def _plural(word: str, count: int) -> str:
    return word if count == 1 else word + "s"


def _frames(count: int) -> str:
    return f"{count} {_plural('frame', count)}"
