"""Pairs of images: the table of pairs, their origin, and why they were dropped; two-view matches of preview features;
COLMAP's list of image pairs as a user input. And observations: the points of a rough model that an image sees.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.names import plain_name
from tiegraph.scene.results import table
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import Arrays, Columns, blocks, freeze, spread, unite
from tiegraph.scene.textfile import delimiter_of_rows, filled_lines, split_cells, text_of
from tiegraph.text import csv_text, meant

SOURCES = ("sequence", "exhaustive", "file", "offsets", "poses", "retrieval", "model", "plugin")
# Why a pair was dropped, in the order of the filters: words and colour for reports and pictures.
REASON_LOOKS = {
    "kept": ("kept", "#1b6ca8"),
    "axes": ("axes too far apart", "#ececec"),
    "distance": ("too far apart", "#d9c7e8"),  # paper 003
    "baseline": ("base-to-distance ratio", "#b79ad1"),  # paper 003
    "sight": ("no line of sight", "#c9d8b6"),  # paper 003
    "overlap": ("too little shared surface", "#dfe7cf"),  # by poses of a model or a prior
    "offset": ("outside the frame offset", "#f0d9a8"),  # papers 000, 001
    "votes": ("cameras that hardly match", "#e3b7a0"),  # papers 000, 001
    "section": ("different sections", "#d08c8c"),  # paper 001
    "weak": ("too few preview matches", "#f2a65a"),
    "similar": ("base too short", "#9fd3c7"),  # paper 002
    "cut": ("cut by the design", "#8fb8de"),
    "match": ("not verified", "#c0392b"),  # matched at full resolution
}
REASONS = tuple(REASON_LOOKS)
_LINES = 100_000  # of a CSV file, written together
NUMBERS = ("score", "overlap", "baseline_m", "angle_deg", "h_over_b", "sigma_m")


def pair_key(i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(K,) one number for each pair i, j (K,), in the order of i, then j."""
    return i.astype(np.int64) << 32 | j


@dataclass(frozen=True, repr=False)
class Pairs(Columns, Arrays):
    """P pairs of images i < j, sorted and unique; columns (P,), read-only.

    ``source`` is a bit set over SOURCES (plugin: another package's), ``dropped`` an index into REASONS (0 = kept),
    ``score`` the preview matches (between previewed frames of a pass estimated from them; NaN = unknown), ``overlap``
    the predicted share of the surface in one image that the other also sees (larger of the two directions), ``inliers``
    the verified matches at full resolution (-1 = not matched). Lengths in metres when the poses are metric.
    """

    i: np.ndarray
    j: np.ndarray
    source: np.ndarray
    dropped: np.ndarray
    score: np.ndarray
    overlap: np.ndarray
    baseline_m: np.ndarray
    angle_deg: np.ndarray
    h_over_b: np.ndarray
    sigma_m: np.ndarray
    inliers: np.ndarray

    def __post_init__(self) -> None:
        whole = {"i": np.int32, "j": np.int32, "source": np.uint8, "dropped": np.uint8, "inliers": np.int32}
        freeze(self, {**whole, **dict.fromkeys(NUMBERS, np.float32)})
        if np.any(self.i >= self.j) or np.any(np.diff(self.key) <= 0):
            raise ValueError("pairs must have i < j and be sorted and unique: build them with Pairs.make")

    def __repr__(self) -> str:
        return f"Pairs({int(np.sum(self.dropped == 0))} kept of {len(self)})"

    def _repr_html_(self) -> str:
        return table(repr(self), self.funnel().items())

    @property
    def key(self) -> np.ndarray:
        """(P,) one number for each pair."""
        return pair_key(self.i, self.j)

    def isin(self, other: Pairs) -> np.ndarray:
        """(P,) bool: which pairs the other table has too."""
        return np.isin(self.key, other.key)

    @staticmethod
    def columns() -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(Pairs.__dataclass_fields__)

    @staticmethod
    def make(i: np.ndarray, j: np.ndarray, source: str | np.ndarray, **columns: np.ndarray) -> Pairs:
        """Pairs from any order of (i, j); self pairs are left out, of duplicates the one with the best score stays."""
        i, j = np.asarray(i, np.int64).ravel(), np.asarray(j, np.int64).ravel()
        bits = np.full(len(i), source_bit(source)) if isinstance(source, str) else np.asarray(source)
        full: dict[str, np.ndarray] = {n: np.full(len(i), np.nan) for n in NUMBERS}
        full |= {"inliers": np.full(len(i), -1), "dropped": np.zeros(len(i))}
        full |= {**{n: np.asarray(c) for n, c in columns.items()}, "source": bits}
        low, high = np.minimum(i, j), np.maximum(i, j)
        order = np.argsort(-np.nan_to_num(full["score"], nan=-1.0), kind="stable")
        order = order[(low != high)[order]]
        keep = order[np.unique(pair_key(low, high)[order], return_index=True)[1]]
        return Pairs(i=low[keep], j=high[keep], **{n: c[keep] for n, c in full.items()})

    @staticmethod
    def empty() -> Pairs:
        """No pairs."""
        return Pairs.make(np.zeros(0, int), np.zeros(0, int), "sequence")

    def __or__(self, other: Pairs) -> Pairs:
        """Both tables: sources are united, a pair kept in either is kept, known numbers win over NaN (self first)."""
        both = {n: np.concatenate([getattr(self, n), getattr(other, n)]) for n in self.columns()}
        order = np.lexsort((both["j"], both["i"]))
        both = {n: c[order] for n, c in both.items()}
        first = np.ones(len(order), bool)
        first[1:] = (np.diff(both["i"]) != 0) | (np.diff(both["j"]) != 0)
        at = np.flatnonzero(first)
        second = np.where(np.append(~first[1:], False)[at], at + 1, at)
        out = {n: both[n][at] for n in ("i", "j")}
        out["source"] = both["source"][at] | both["source"][second]
        kept = (both["dropped"][at] == 0) | (both["dropped"][second] == 0)
        out["dropped"] = np.where(kept, 0, both["dropped"][at])
        out["inliers"] = np.maximum(both["inliers"][at], both["inliers"][second])
        for n in NUMBERS:
            out[n] = np.where(np.isnan(both[n][at]), both[n][second], both[n][at])
        return Pairs(**out)

    def kept(self) -> Pairs:
        """Only the pairs that were not dropped."""
        return self.where(self.dropped == 0)

    def drop(self, mask: np.ndarray, reason: str) -> Pairs:
        """Mark kept rows of a mask (P,) as dropped for a reason; rows already dropped keep their first reason."""
        code = REASONS.index(reason)
        return replace(self, dropped=np.where(np.asarray(mask, bool) & (self.dropped == 0), code, self.dropped))

    def with_(self, **columns: np.ndarray) -> Pairs:
        """A copy with columns replaced."""
        return replace(self, **columns)

    def from_source(self, source: str) -> np.ndarray:
        """(P,) bool: whether a source proposed the pair."""
        return (self.source & source_bit(source)) > 0

    def matrix(self, images: int) -> np.ndarray:
        """(N, N) u1 correspondence matrix (paper 003): 0 never tested, 1 kept, 1 + reason if dropped."""
        out = np.zeros((images, images), np.uint8)
        out[self.i, self.j] = out[self.j, self.i] = 1 + self.dropped
        return out

    def degree(self, images: int) -> np.ndarray:
        """(N,) i4 number of kept pairs of each image."""
        kept = self.dropped == 0
        return np.bincount(np.concatenate([self.i[kept], self.j[kept]]), minlength=images).astype(np.int32)

    def funnel(self) -> dict[str, int]:
        """Candidates, how many each filter dropped (in filter order), and the remaining ones (paper 002, table 1)."""
        used, *dropped = np.bincount(self.dropped, minlength=len(REASONS)).tolist()
        return {"candidates": len(self), **{r: n for r, n in zip(REASONS[1:], dropped) if n}, "used": used}

    def to_text(self, names: tuple[str, ...]) -> str:
        """The kept pairs as a COLMAP pair list: two image names a line."""
        kept = self.kept()
        return "".join(f"{names[a]} {names[b]}\n" for a, b in zip(kept.i, kept.j))

    def to_csv(self, names: tuple[str, ...]) -> str:
        """All rows with names, sources, reason and numbers."""
        heads = ["image1", "image2", "source", "dropped", *NUMBERS, "inliers"]
        return csv_text(heads, self._rows(names))

    def to_pandas(self, names: tuple[str, ...]) -> Any:
        """All rows as a ``pandas.DataFrame`` with names, sources and reason in words."""
        import pandas as pd

        by = ["+".join(s for k, s in enumerate(SOURCES) if bits >> k & 1) for bits in self.source.tolist()]
        ends = {f"image{k + 1}": [names[n] for n in end.tolist()] for k, end in enumerate((self.i, self.j))}
        numbers = {n: getattr(self, n) for n in ("inliers", *NUMBERS)}
        return pd.DataFrame({**ends, "source": by, "dropped": [REASONS[k] for k in self.dropped.tolist()], **numbers})

    def to_networkx(self, names: tuple[str, ...]) -> Any:
        """The kept pairs as a ``networkx.Graph``: images are nodes, pairs are edges with the columns of the table."""
        import networkx as nx

        graph = nx.Graph()
        graph.add_nodes_from(names)
        for row in self.kept().to_pandas(names).to_dict("records"):
            graph.add_edge(row.pop("image1"), row.pop("image2"), **row)
        return graph

    def _rows(self, names: tuple[str, ...]) -> Iterator[list]:
        columns = [self.i, self.j, self.source, self.dropped, self.inliers, *(getattr(self, n) for n in NUMBERS)]
        for first in range(0, len(self), _LINES):  # as Python's own numbers: several times as fast, not all at once
            for i, j, source, dropped, inliers, *numbers in zip(*(c[first : first + _LINES].tolist() for c in columns)):
                by = "+".join(s for k, s in enumerate(SOURCES) if source >> k & 1)
                values = ("" if v != v else f"{v:.6g}" for v in numbers)
                yield [names[i], names[j], by, REASONS[dropped], *values, inliers]


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
        matches = np.concatenate([self.matches, other.matches])[spread(first, count)]
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


def source_bit(source: str) -> int:
    """Bit of a pair source."""
    return 1 << SOURCES.index(source)


def read_pair_list(path: Path, scene: Scene) -> tuple[Pairs, tuple[str, ...]]:
    """Pairs of a COLMAP pair list: two image names a line, ``#`` starts a comment; self pairs and repeats are counted.

    Raises InputError naming file, line and name for an unknown image, a line without exactly two names, an unreadable
    file, or a file without pairs.
    """
    rows: dict[tuple[int, int], int] = {}
    ignored: dict[str, list[int]] = {"self pairs": [], "repeated pairs": []}  # lines of each
    for number, words in pair_lines(path):
        i, j = sorted(_image_of(plain_name(word), f"{path}, line {number}", scene) for word in words)
        if i == j:
            ignored["self pairs"].append(number)
        elif rows.setdefault((i, j), number) != number:
            ignored["repeated pairs"].append(number)
    if not rows:
        lines = ignored["self pairs"]
        raise InputError(
            f"{path}, line {lines[0]}: its {len(lines)} lines pair images with themselves; name two images a line"
        )
    both = np.array(list(rows))
    said = ", ".join(f"{len(v)} {kind} (line {v[0]}{' ...' if len(v) > 1 else ''})" for kind, v in ignored.items() if v)
    note = f"file: {len(rows)} pairs from {path.name}" + (f"; ignored: {said}" if said else "")
    return Pairs.make(both[:, 0], both[:, 1], "file"), (note,)


def pair_lines(path: Path) -> list[tuple[int, list[str]]]:
    """(line number, two image names, separated by blanks, or by tabs, commas or semicolons if names have blanks) of a
    pair list, without comments.

    Raises InputError naming file and line for a file without text or pairs, or a line with other than two names.
    """
    text, _ = text_of(path, "pair list")
    lines = [(k, line.split("#", 1)[0].strip()) for k, line in filled_lines(text)]
    out = [(k, split_cells(line, delimiter_of_rows(line))) for k, line in lines if line]
    if not out:
        raise InputError(f"{path}: contains no pairs; expected two image names a line")
    for k, words in out:
        if len(words) != 2:
            found = f"{len(words)} words: {' '.join(words)!r:.99}"
            raise InputError(f"{path}, line {k}: expected two image names, found {found}")
    return out


def _image_of(name: str, place: str, scene: Scene) -> int:
    if name in scene.image_index:
        return scene.image_index[name]
    lost = next((d.reason for d in scene.dropped if d.name == name), None)
    why = f" (left out by scan: {lost})" if lost else meant(name, scene.names, 0.3)
    raise InputError(f"{place}: the survey has no image {name!r}{why}")
