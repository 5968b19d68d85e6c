"""Source ``retrieval``: ties that no order tells of, found by likeness and confirmed by previews.

Loose photographs: ``network.loose``. Passes: loops, where a camera comes back to a place long after, or two passes meet
off the path that ``network.offsets`` follows. One look-alike is not believed: repeated walls give a fifth or more of
unrelated images the preview count of true pairs; the previews of the frames before and after must agree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tiegraph.network.looks.loose import CEILING, FLOOR, SURE, scored_pairs
from tiegraph.network.looks.words import ImageWords, image_words
from tiegraph.network.passes import Pass, PreviewBook, loose_images
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.scene import Scene

LADDER = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)  # frame distances at which likeness along a pass is measured
REACH_SHARE = 0.25  # of the likeness of consecutive frames, above that of distant ones, that ends the reach
STRIDES_A_REACH = 3  # sampled frames within a reach
NEAR_REACHES = 3  # frames of one pass closer than this many reaches are no loop
LOOK_ALIKES = 4  # far images that each sampled image is previewed with
# Pairs borne out side by side, or none of them is believed. Simulated, four seeds of 300 frames: false patches reach 9
# where one unrelated preview in five hits, 12 where three in ten do. On ``canal`` it costs two patches of 6 and 9.
PATCH = 10
NAMED = 5  # places named one by one in the notes
PREVIEWS_AN_IMAGE = 16  # sampled: the most that looking for loops may take
MAX_CELLS = 3000  # cells along all passes in which known ties are marked
# Gaussian of 0.8 strides over the 3 x 3 neighbouring frame pairs, as on the lattice of ``network.lattice``.
_STEPS = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)])
_WEIGHT = np.where(np.any(_STEPS, axis=1), np.exp(-np.sum(_STEPS**2, axis=1) / (2 * 0.8**2)), 0)


@dataclass(frozen=True)
class RetrievalResult:
    """Pairs of the source, and what people should know."""

    pairs: Pairs
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Timeline:
    """All passes one after another: ``image_at[g, s]`` = image of sensor s at place g, -1 = none; of every place its
    pass, the stride of its samples and its cell; of every image its place (-1 = loose) and sensor."""

    image_at: np.ndarray  # (G, S)
    of_pass: np.ndarray  # (G,)
    rank: np.ndarray  # (G,) frame of the pass
    stride: np.ndarray  # (G,)
    cell: np.ndarray  # (G,)
    cell_pass: np.ndarray  # (C,)
    place: np.ndarray  # (N,)
    sensor: np.ndarray  # (N,)

    def sampled(self) -> np.ndarray:
        """Images of every stride-th frame."""
        images = self.image_at[self.rank % self.stride == 0]
        return np.sort(images[images >= 0])

    def stepped(self, places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """(K,) the place some frames on (K,) in the same pass; -1 = none."""
        there = np.clip(places + frames, 0, len(self.of_pass) - 1)
        return np.where((there == places + frames) & (self.of_pass[there] == self.of_pass[places]), there, -1)

    def moved(self, images: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """(K,) the image of the same camera some frames on (K,); -1 = none."""
        there = self.stepped(self.place[images], frames)
        return np.where(there >= 0, self.image_at[there, self.sensor[images]], -1)


def nearest_images(descriptors: Sequence[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """The ``count`` images that look most like each of N images with descriptors (K, 128) u1: indices (N, C) i4,
    -1 = no more, and cosines (N, C) f4, best first. Linear memory; 4000 images of 800 features take half a minute."""
    return image_words(descriptors).nearest(count)


def retrieve(
    scene: Scene,
    passes: Sequence[Pass],
    book: PreviewBook,
    settings: NetworkSettings,
    descriptors: Callable[[], Sequence[np.ndarray]],
    known: Pairs | None = None,
) -> RetrievalResult:
    """Pairs of loose photographs and loops of passes; ``known`` pairs (kept ones) and what lies near them are no loops.

    ``descriptors()`` gives root-SIFT (K, 128) u1 of the preview of every image.
    """
    words = image_words(descriptors())
    loose = loose_images(scene)
    pairs = scored_pairs(scene, loose, book, settings, words)
    notes: tuple[str, ...] = ()
    if len(loose):
        notes = (f"retrieval: {len(pairs.kept())} pairs of {len(loose)} loose photographs",)
    loops = loop_candidates(passes, words, book, settings, known)
    return RetrievalResult(pairs | loops.pairs, notes + loops.notes)


def loop_candidates(
    passes: Sequence[Pass],
    words: ImageWords,
    book: PreviewBook,
    settings: NetworkSettings,
    known: Pairs | None = None,
) -> RetrievalResult:
    """Pairs far from the known ones whose images look alike, confirmed by the previews of the frames around them.

    Dropped pairs carry ``weak``: previewed and not confirmed.
    """
    passes = [p for p in passes if len(p) > 1]
    if not passes:
        return RetrievalResult(Pairs.empty(), ())
    line = _timeline(passes, words)
    blocked = _blocked(line, known)
    i, j = _look_alikes(line, words, blocked)
    i, j, spent = _grown(line, i, j, blocked, book, settings)
    count = book.known(i, j)
    sure = _borne_out(line, i, j, book, settings.min_matches)
    patch = _patches(line, i[sure], j[sure])
    large = np.bincount(patch) >= PATCH
    sure[sure] = large[patch]
    patch = np.unique(patch[large[patch]], return_inverse=True)[1]
    measured = Pairs.make(i, j, "retrieval", score=count, dropped=np.where(sure, 0, REASONS.index("weak")))
    pairs = measured | _filled(line, i[sure], j[sure], count[sure])
    notes = _notes(line, passes, i[sure], j[sure], patch)
    if len(i) and not sure.any():
        notes = (f"retrieval: no loops: none of {len(i)} look-alikes is confirmed by its neighbouring frames",)
    if spent:
        notes += ("retrieval: the budget of previews was spent before every loop was followed to its end",)
    return RetrievalResult(pairs, notes)


# ---------------------------------------------------------------- places along the passes


def _timeline(passes: Sequence[Pass], words: ImageWords) -> _Timeline:
    sensors = max(len(p.images) for p in passes)
    length = np.array([len(p) for p in passes])
    image_at = np.full((length.sum(), sensors), -1, np.int64)
    reach = np.array([_reach(p, words) for p in passes])
    size = np.maximum(reach, -(-length.sum() // MAX_CELLS))
    of_pass = np.repeat(np.arange(len(passes)), length)
    rank = np.concatenate([np.arange(n) for n in length])
    for k, p in enumerate(passes):
        image_at[of_pass == k, : len(p.images)] = p.images.T
    cells = -(-length // size)
    cell = (np.cumsum(cells) - cells)[of_pass] + rank // size[of_pass]
    place, sensor = np.full(len(words), -1, np.int64), np.zeros(len(words), np.int64)
    g, s = np.nonzero(image_at >= 0)
    place[image_at[g, s]], sensor[image_at[g, s]] = g, s
    stride = np.maximum(1, reach // STRIDES_A_REACH)[of_pass]
    cell_pass = np.repeat(np.arange(len(passes)), cells)
    return _Timeline(image_at, of_pass, rank, stride, cell, cell_pass, place, sensor)


def _reach(p: Pass, words: ImageWords) -> int:
    """Frames over which the images of a camera look alike."""
    steps = [s for s in LADDER if s < len(p)]
    alike = []
    for step in steps:
        left, right = p.images[:, :-step].ravel(), p.images[:, step:].ravel()
        there = (left >= 0) & (right >= 0)
        alike.append(float(words.between(left[there], right[there]).mean()) if there.any() else 0.0)
    level = min(alike) + REACH_SHARE * (alike[0] - min(alike))
    below = [s for s, value in zip(steps, alike) if value < level]
    return below[0] if below else steps[-1]


def _blocked(line: _Timeline, known: Pairs | None) -> np.ndarray:
    """(C, C) bool: cells in which a pair is no news: near in one pass, or next to known pairs."""
    count = len(line.cell_pass)
    cell = np.arange(count)
    near = np.abs(cell[:, None] - cell) <= NEAR_REACHES
    blocked = near & (line.cell_pass[:, None] == line.cell_pass)
    if known is None:
        return blocked
    kept = known.kept()
    a, b = line.place[kept.i], line.place[kept.j]
    a, b = line.cell[a[(a >= 0) & (b >= 0)]], line.cell[b[(a >= 0) & (b >= 0)]]
    for da in (-1, 0, 1):
        for db in (-1, 0, 1):
            x, y = np.clip(a + da, 0, count - 1), np.clip(b + db, 0, count - 1)
            same = (line.cell_pass[x] == line.cell_pass[a]) & (line.cell_pass[y] == line.cell_pass[b])
            blocked[x[same], y[same]] = blocked[y[same], x[same]] = True
    return blocked


# ---------------------------------------------------------------- finding, growing, confirming


def _look_alikes(line: _Timeline, words: ImageWords, blocked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs i < j (K,), (K,) of sampled images that look most alike outside the blocked cells."""
    images = line.sampled()
    cell = line.cell[line.place[images]]
    other, _ = words.among(images).nearest(LOOK_ALIKES, wanted=lambda rows: ~blocked[np.ix_(cell[rows], cell)])
    left = np.repeat(images, other.shape[1])[other.ravel() >= 0]
    return _unique(left, images[other.ravel()[other.ravel() >= 0]], len(words))


def _unique(i: np.ndarray, j: np.ndarray, images: int) -> tuple[np.ndarray, np.ndarray]:
    key = np.unique(np.minimum(i, j).astype(np.int64) * images + np.maximum(i, j))
    return key // images, key % images


def _grown(
    line: _Timeline, i: np.ndarray, j: np.ndarray, blocked: np.ndarray, book: PreviewBook, settings: NetworkSettings
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Pairs previewed: the given ones, and the neighbours of every hit until nothing new hits; whether the budget of
    previews was spent before."""
    images = len(line.place)
    budget = PREVIEWS_AN_IMAGE * len(line.sampled())
    done = np.zeros(0, np.int64)
    key = i * images + j
    first = True
    while len(key):
        if len(done) + len(key) > budget and len(done):
            return done // images, done % images, True
        count = book.measure(key // images, key % images)
        done = np.union1d(done, key)
        # Every first hit is looked at from all sides; from there on only what its surroundings bear out spreads.
        hit = key[count >= SURE * settings.min_matches]
        if not first:
            own = _borne_out(line, done // images, done % images, book, settings.min_matches)
            hit = done[own]
        first = False
        a, b = _around(line, hit // images, hit % images)
        fine = (a >= 0) & (b >= 0) & (a != b)
        a, b = a[fine], b[fine]
        fresh = ~blocked[line.cell[line.place[a]], line.cell[line.place[b]]]
        a, b = _unique(a[fresh], b[fresh], images)
        key = np.setdiff1d(a * images + b, done)
    return done // images, done % images, False


def _around(line: _Timeline, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The 9 image pairs (K, 9), (K, 9) one stride around each pair, in the order of _STEPS; -1 = no image."""
    stride_i, stride_j = line.stride[line.place[i]], line.stride[line.place[j]]
    a = np.stack([line.moved(i, da * stride_i) for da, _ in _STEPS], axis=-1)
    b = np.stack([line.moved(j, db * stride_j) for _, db in _STEPS], axis=-1)
    return a, b


def _borne_out(line: _Timeline, i: np.ndarray, j: np.ndarray, book: PreviewBook, min_matches: int) -> np.ndarray:
    """(K,) bool: previews that tie and so does the weighted mean of those around them, themselves left out.

    Of unrelated pairs with one hit in five, one in 75 is borne out (simulated).
    """
    a, b = _around(line, i, j)
    count = book.known(np.maximum(a, 0).ravel(), np.maximum(b, 0).ravel()).reshape(a.shape)
    seen = np.isfinite(count) & (a >= 0) & (b >= 0)
    level = np.clip(np.nan_to_num(count), FLOOR * min_matches, CEILING * min_matches)
    mean = (level * seen) @ _WEIGHT / np.maximum(seen @ _WEIGHT, 1e-9)
    return (mean >= SURE * min_matches) & (book.known(i, j) >= SURE * min_matches)


def _patches(line: _Timeline, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(K,) patch of frame pairs side by side that each pair of images lies in, of whatever cameras."""
    count = len(line.of_pass)
    a, b = np.minimum(line.place[i], line.place[j]), np.maximum(line.place[i], line.place[j])
    key, at = np.unique(a * count + b, return_inverse=True)
    a, b = key // count, key % count
    edges = [np.zeros((2, 0), np.int64)]
    for da, db in _STEPS:
        x, y = line.stepped(a, da * line.stride[a]), line.stepped(b, db * line.stride[b])
        near = np.minimum(np.searchsorted(key, x * count + y), len(key) - 1) if len(key) else np.zeros(0, int)
        there = np.flatnonzero((x >= 0) & (y >= 0) & (key[near] == x * count + y))
        edges.append(np.stack([there, near[there]]))
    row, column = np.concatenate(edges, axis=1)
    graph = coo_array((np.ones(len(row)), (row, column)), shape=(len(key), len(key)))
    label = connected_components(graph.tocsr(), directed=False)[1] if len(key) else np.zeros(0, int)
    return label[at]


def _filled(line: _Timeline, i: np.ndarray, j: np.ndarray, count: np.ndarray) -> Pairs:
    """The frames between the sampled ones take the count of the nearest sampled pair."""
    parts = [(i, j, count)]
    most = int(line.stride.max(initial=1)) // 2
    for da in range(-most, most + 1):
        for db in range(-most, most + 1):
            wanted = (2 * abs(da) <= line.stride[line.place[i]]) & (2 * abs(db) <= line.stride[line.place[j]])
            a, b = line.moved(i[wanted], np.full(wanted.sum(), da)), line.moved(j[wanted], np.full(wanted.sum(), db))
            there = (a >= 0) & (b >= 0) & (a != b)
            parts.append((a[there], b[there], count[wanted][there]))
    a, b, score = (np.concatenate(column) for column in zip(*parts))
    return Pairs.make(a, b, "retrieval", score=score)


def _notes(line: _Timeline, passes: Sequence[Pass], i: np.ndarray, j: np.ndarray, patch: np.ndarray) -> tuple[str, ...]:
    """What was found where: the largest patches of confirmed pairs (K,), (K,)."""
    out = []
    size = np.bincount(patch)
    order = np.argsort(-size, kind="stable")
    for k in order[:NAMED]:
        a, b = line.place[i[patch == k]], line.place[j[patch == k]]
        a, b = np.minimum(a, b), np.maximum(a, b)
        p, q = line.of_pass[a[0]], line.of_pass[b[0]]
        ends = [f"{passes[o].name} frames {line.rank[x].min()}..{line.rank[x].max()}" for o, x in ((p, a), (q, b))]
        out.append(f"retrieval: {ends[0]} and {ends[1]} see the same place ({size[k]} confirmed previews)")
    if len(size) > NAMED:
        rest = int(np.sort(size)[:-NAMED].sum())
        out.append(f"retrieval: {len(size) - NAMED} more such places ({rest} confirmed previews)")
    return tuple(out)
