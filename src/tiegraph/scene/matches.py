"""Two-view matches of preview features, and observations: the points of a rough model that an image sees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.scene.pairs import pair_key
from tiegraph.scene.sorting import Arrays, blocks, freeze, unite


@dataclass(frozen=True)
class PreviewMatches(Arrays):
    """Preview matches of T image pairs i < j, sorted and unique, read-only.

    ``matches`` (M, 2) u2: feature of image i, feature of image j (rows of the two images' previews), inliers of one
    two-view geometry; the matches of pair t are rows ``start[t]`` to ``start[t + 1]``. A pair previewed without
    success has none.
    """

    i: np.ndarray  # (T,) i4
    j: np.ndarray  # (T,) i4
    start: np.ndarray  # (T + 1,) i8
    matches: np.ndarray  # (M, 2) u2

    def __post_init__(self) -> None:
        freeze(self, {"i": np.int32, "j": np.int32, "start": np.int64, "matches": np.uint16})
        key = pair_key(self.i, self.j)
        if np.any(self.i >= self.j) or np.any(np.diff(key) <= 0) or len(self.start) != len(self.i) + 1:
            raise ValueError("ties must have i < j and be sorted and unique: build them with PreviewMatches.make")

    @staticmethod
    def make(i: np.ndarray, j: np.ndarray, matches: Sequence[np.ndarray]) -> PreviewMatches:
        """Ties from any order of pairs (T,), (T,) with i < j and the matches (K, 2) of each; the first of repeated
        pairs stays."""
        i, j = np.asarray(i, np.int64).ravel(), np.asarray(j, np.int64).ravel()
        order = np.unique(pair_key(i, j), return_index=True)[1]
        chosen = [np.asarray(matches[k], np.uint16).reshape(-1, 2) for k in order]
        start = np.concatenate([[0], np.cumsum([len(m) for m in chosen])])
        rows = np.concatenate([np.zeros((0, 2), np.uint16), *chosen])
        return PreviewMatches(i=i[order], j=j[order], start=start, matches=rows)

    @staticmethod
    def empty() -> PreviewMatches:
        """No ties."""
        return PreviewMatches.make(np.zeros(0, int), np.zeros(0, int), [])

    def __len__(self) -> int:
        return len(self.i)

    def __or__(self, other: PreviewMatches) -> PreviewMatches:
        """The pairs of both; of a pair in both, the matches of the first."""
        i, j = np.concatenate([self.i, other.i]), np.concatenate([self.j, other.j])
        order = np.unique(pair_key(i, j), return_index=True)[1]
        first = np.concatenate([self.start[:-1], len(self.matches) + other.start[:-1]])[order]
        count = np.concatenate([self.counts(), other.counts()])[order]
        start = np.concatenate([[0], np.cumsum(count)])
        rows = np.repeat(first - start[:-1], count) + np.arange(start[-1])
        matches = np.concatenate([self.matches, other.matches])[rows]
        return PreviewMatches(i=i[order], j=j[order], start=start, matches=matches)

    def counts(self) -> np.ndarray:
        """(T,) matches of each pair."""
        return np.diff(self.start)

    def of(self, t: int) -> np.ndarray:
        """(K, 2) matches of the t-th pair."""
        return self.matches[self.start[t] : self.start[t + 1]]

    def where(self, mask: np.ndarray) -> PreviewMatches:
        """The pairs of a mask (T,) bool."""
        mask, count = np.asarray(mask, bool), self.counts()
        start = np.concatenate([[0], np.cumsum(count[mask])])
        matches = self.matches[np.repeat(mask, count)]
        return PreviewMatches(i=self.i[mask], j=self.j[mask], start=start, matches=matches)

    def observations(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(K,) each: track, image and feature (row of the image's preview) of every feature that has a match; features
        connected by matches are one track."""
        width = int(self.matches.max(initial=0)) + 1
        used = np.zeros((int(self.j.max(initial=-1)) + 1) * width, bool)
        for ends in self._ends(width):
            used[ends] = True
        feature = np.flatnonzero(used)
        number = np.cumsum(used, dtype=np.int32) - 1
        links = ((number[one], number[other]) for one, other in self._ends(width))
        track = unite(np.arange(len(feature), dtype=np.int32), links)
        return np.cumsum(track == np.arange(len(track)))[track] - 1, feature // width, feature % width

    def _ends(self, width: int) -> Iterator[np.ndarray]:
        """(2, K) i8 features of matches, a block of pairs at a time; those of an image are ``width`` numbers."""
        for own in blocks(self.start):
            image = np.repeat(np.stack([self.i[own], self.j[own]]).astype(np.int64), self.counts()[own], axis=1)
            yield image * width + self.matches[self.start[own.start] : self.start[own.stop]].T

    def tracks(self) -> tuple[np.ndarray, np.ndarray]:
        """(K,), (K,) track and image of ``observations``."""
        track, image, _ = self.observations()
        return track, image

    def find(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) row of image pairs (K,), (K,) in any order of their ends; -1 = not previewed."""
        own, asked = pair_key(self.i, self.j), pair_key(np.minimum(i, j), np.maximum(i, j))
        at = np.minimum(np.searchsorted(own, asked), max(len(own) - 1, 0))
        return np.where(own[at] == asked, at, -1) if len(own) else np.full(len(asked), -1)

    def known(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) f4 matches of image pairs (K,), (K,); NaN = not previewed."""
        row = self.find(i, j)
        count = np.append(self.counts(), 0)[row]
        return np.where(row >= 0, count, np.nan).astype(np.float32)


@dataclass(frozen=True)
class Visibility(Arrays):
    """Points each image sees: those of image k are ``point[start[k]:start[k + 1]]``, increasing."""

    start: np.ndarray  # (N + 1,)
    point: np.ndarray  # (S,) rows of xyz
    xyz: np.ndarray  # (P, 3) in the model's frame and units
    centre: np.ndarray  # (N, 3) of the images, NaN = not in the model

    def of(self, image: int) -> np.ndarray:
        """Points of an image."""
        return self.point[self.start[image] : self.start[image + 1]]
