"""Passes as tables of images (which image a sensor took in the k-th frame of a pass), the previews matched so far, and
what a source of pairs is given and gives."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene

MatchFunction = Callable[[np.ndarray], Sequence[Any]]  # pairs (P, 2) -> P features.preview.PreviewMatch
Descriptors = Callable[[], Sequence[np.ndarray]]  # root-SIFT (K, 128) u1 of every image


@dataclass(frozen=True)
class Pass:
    """Consecutive frames of one rig: ``images[s, k]`` = image of sensor s in the k-th frame, -1 = none."""

    name: str
    sequence: int
    rig_index: int
    rig: Rig
    frames: np.ndarray  # (n,) i4 frame indices in order
    images: np.ndarray  # (S, n) i4

    def __len__(self) -> int:
        return len(self.frames)


def find_passes(scene: Scene) -> tuple[Pass, ...]:
    """The passes of a scene; two rigs on one sequence are two passes, because their frames are not
    numbered together."""
    found = []
    ids = sorted({(int(t), int(r)) for t, r in zip(scene.sequence, scene.rig) if t >= 0})
    image_of = image_table(scene)
    for sequence, rig in ids:
        frames = scene.in_order((scene.sequence == sequence) & (scene.rig == rig))
        images = image_of[frames, : len(scene.rigs[rig].sensors)].T
        name = scene.sequences[sequence] if sequence < len(scene.sequences) else f"pass {sequence}"
        several = sum(t == sequence for t, _ in ids) > 1
        name = f"{name} (rig {rig + 1}, {scene.rigs[rig].name})" if several else name
        found.append(
            Pass(name=name, sequence=sequence, rig_index=rig, rig=scene.rigs[rig], frames=frames, images=images)
        )
    return tuple(found)


def image_table(scene: Scene) -> np.ndarray:
    """(F, S) i4 image of each sensor of a frame's rig, -1 = none."""
    table = np.full((scene.frames, max((len(r.sensors) for r in scene.rigs), default=1)), -1, np.int32)
    table[scene.frame, scene.sensor] = np.arange(len(scene))
    return table


def loose_images(scene: Scene) -> np.ndarray:
    """Indices of the images that belong to no pass."""
    return np.flatnonzero(scene.sequence[scene.frame] < 0)


def places(own: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """(K,) places of the asked numbers (K,) among own sorted ones; -1 = not there."""
    at = np.minimum(np.searchsorted(own, asked), max(len(own) - 1, 0))
    return np.where(own[at] == asked, at, -1) if len(own) else np.full(len(asked), -1)


class MatchCache:
    """Preview counts measured so far; each pair is matched once, many at a time. ``known``: earlier measurements.

    This is the only mutable object here: all sources share it, so that no pair is matched twice.
    """

    def __init__(self, match: MatchFunction, images: int, known: PreviewMatches | None = None) -> None:
        known = PreviewMatches.empty() if known is None else known
        self._match = match
        self._images = images
        self._keys = self._key(known.i, known.j)
        self._counts = known.counts().astype(np.float32)
        self._matches = {int(key): known.of(t) for t, key in enumerate(self._keys) if self._counts[t]}

    def __len__(self) -> int:
        return len(self._keys)

    def _key(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return np.minimum(i, j).astype(np.int64) * self._images + np.maximum(i, j)

    def measure(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Inliers (K,) f4 of image pairs (K,), (K,)."""
        asked = np.unique(self._key(np.asarray(i), np.asarray(j)))
        new = asked[places(self._keys, asked) < 0]
        if len(new):
            self._remember(new, self._matched(new))
        return self.known(i, j)

    def results(self, i: np.ndarray, j: np.ndarray) -> list[Any]:
        """Complete results of image pairs (K,), (K,) with i < j, matched again; their counts and matches are
        remembered."""
        keys = self._key(np.asarray(i), np.asarray(j))
        unique, place = np.unique(keys, return_inverse=True)
        found = self._matched(unique)
        new = places(self._keys, unique) < 0
        self._remember(unique[new], [r for r, n in zip(found, new) if n])
        return [found[k] for k in place]

    def _matched(self, keys: np.ndarray) -> Sequence[Any]:
        return self._match(np.stack([keys // self._images, keys % self._images], axis=1).astype(np.int32))

    def _remember(self, keys: np.ndarray, results: Sequence[Any]) -> None:
        counts = np.array([r.inliers for r in results], np.float32)
        self._matches.update((int(k), r.matches) for k, r in zip(keys, results) if r.inliers)
        order = np.argsort(np.concatenate([self._keys, keys]), kind="stable")
        self._keys = np.concatenate([self._keys, keys])[order]
        self._counts = np.concatenate([self._counts, counts])[order]

    def known(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Inliers (K,) f4 of image pairs; NaN = not measured."""
        row = places(self._keys, self._key(np.asarray(i), np.asarray(j)))
        return np.append(self._counts, np.float32(np.nan))[row]

    def matches(self) -> PreviewMatches:
        """The matches of all measured pairs."""
        nothing = np.zeros((0, 2), np.uint16)
        matches = [self._matches.get(int(k), nothing) for k in self._keys]
        return PreviewMatches.make(self._keys // self._images, self._keys % self._images, matches)

    def matches_of(self, i: int, j: int) -> np.ndarray:
        """The matches (K, 2) of a measured pair i < j that has any."""
        return self._matches[i * self._images + j]

    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All measured pairs: i (K,), j (K,), inliers (K,)."""
        return self._keys // self._images, self._keys % self._images, self._counts


@dataclass(frozen=True)
class Context:
    """The input of a source."""

    scene: Scene
    passes: tuple[Pass, ...]
    cache: MatchCache
    settings: CandidatesSettings
    tuning: Tuning
    descriptors: Descriptors  # of all previews


@dataclass(frozen=True)
class Proposal:
    """The pairs that a source proposes, and notes."""

    pairs: Pairs
    notes: tuple[str, ...] = ()
    apart: bool = False  # according to the images the poses of different passes are not in one world
    stranger: str = ""  # the pair of passes, if it has no common view

    def __or__(self, other: "Proposal") -> "Proposal":
        return Proposal(
            pairs=self.pairs | other.pairs,
            notes=self.notes + other.notes,
            apart=self.apart or other.apart,
        )
