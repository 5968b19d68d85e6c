"""Source ``retrieval``: ties that the order does not suggest, found by similarity and confirmed by previews.

Loose photographs: ``network.loose``. Passes: loops, where a camera returns to a place long after, or two passes meet
off the path that ``network.offsets`` follows. A single look-alike is no evidence: repeated walls give a fifth or more
of unrelated images the preview count of true pairs; the previews of the frames before and after must agree.

In a long survey repeated walls tie two places for one or two cameras and some frames; back at the same place, most
cameras of the rig see what the rig saw before. So the frame pairs of a loop are previewed by all cameras, and most of
them must exceed the noise floor of unrelated frames, each with the camera chosen at the other end of the loop.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.network.loose import BagsOfWords, scored_pairs, words_of
from tiegraph.network.passes import Context, Pass, Proposal, loose_images
from tiegraph.network.scorematrix import NoiseFloor, noise_floor
from tiegraph.network.tuning import Tuning
from tiegraph.scene.evidence import ENOUGH
from tiegraph.scene.graph import parts
from tiegraph.scene.pairs import REASONS, Pairs

NAMED = 5  # places listed singly in the notes
_STEPS = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)])  # strides to the neighbouring frame pairs
Ends = tuple[np.ndarray, np.ndarray]
"""Images i (K,), j (K,) of pairs."""


def retrieve(context: Context, known: Pairs | None = None) -> Proposal:
    """Pairs of loose photographs and loops of passes; ``known`` (kept) pairs and their surroundings are no loops."""
    words = words_of(context)
    loose = loose_images(context.scene)
    pairs = scored_pairs(context, loose, words)
    notes = (f"retrieval: {len(pairs.kept())} pairs of {len(loose)} loose photographs",) if len(loose) else ()
    return Proposal(pairs, notes) | loop_candidates(context, words, known)


def loop_candidates(context: Context, words: BagsOfWords, known: Pairs | None = None) -> Proposal:
    """Look-alikes far from the known pairs, confirmed by the previews of the frames around them.

    Dropped pairs carry ``weak``: previewed and not confirmed.
    """
    passes = [p for p in context.passes if len(p) > 1]
    if not passes:
        return Proposal(Pairs.empty())
    tuning = context.tuning
    line = timeline(passes, words, tuning)
    blocked = _blocked(line, known)
    look = Look(context=context, line=line, level=unrelated(context, line, blocked))
    (i, j), spent = _grown(look, _look_alikes(line, words, blocked, tuning.retrieval.look_alikes), blocked)
    count = context.cache.known(i, j)
    sure = _borne_out(look, (i, j))
    patch = _patches(line, i[sure], j[sure])
    large = np.bincount(patch) >= tuning.retrieval.patch
    if look.level is not None:
        large &= seen_by_the_rig(look, (i[sure], j[sure]), patch)
    sure[sure] = large[patch]
    patch = np.unique(patch[large[patch]], return_inverse=True)[1]
    measured = Pairs.make(i, j, "retrieval", score=count, dropped=np.where(sure, 0, REASONS.index("weak")))
    pairs = measured | _filled(line, i[sure], j[sure], count[sure])
    notes = _notes(line, passes, i[sure], j[sure], patch)
    if len(i) and not sure.any():
        notes = (f"retrieval: no loops: none of {len(i)} look-alikes is confirmed by its neighbouring frames",)
    if spent:
        notes += ("retrieval: the budget of previews was spent before every loop was followed to its end",)
    return Proposal(pairs, notes)


# ---------------------------------------------------------------- all passes in a row


@dataclass(frozen=True)
class Timeline:
    """All passes in a row: ``image_at[g, s]`` = image of sensor s at place g, -1 = none; of every place its pass, the
    stride of its samples and its cell; of every image its place (-1 = loose) and sensor."""

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
        """(K,) the place this number of frames (K,) later in the same pass; -1 = none."""
        there = np.clip(places + frames, 0, len(self.of_pass) - 1)
        return np.where((there == places + frames) & (self.of_pass[there] == self.of_pass[places]), there, -1)

    def moved(self, images: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """(K,) the image of the same camera this number of frames (K,) later; -1 = none."""
        there = self.stepped(self.place[images], frames)
        return np.where(there >= 0, self.image_at[there, self.sensor[images]], -1)


def timeline(passes: Sequence[Pass], words: BagsOfWords, tuning: Tuning) -> Timeline:
    """The passes in a row, sampled according to the similarity of their images."""
    sensors = max(len(p.images) for p in passes)
    length = np.array([len(p) for p in passes])
    image_at = np.full((length.sum(), sensors), -1, np.int64)
    reach = np.array([_reach(p, words, tuning) for p in passes])
    size = np.maximum(reach, -(-length.sum() // 3000))
    of_pass = np.repeat(np.arange(len(passes)), length)
    rank = np.concatenate([np.arange(n) for n in length])
    for k, p in enumerate(passes):
        image_at[of_pass == k, : len(p.images)] = p.images.T
    cells = -(-length // size)
    cell = (np.cumsum(cells) - cells)[of_pass] + rank // size[of_pass]
    place, sensor = np.full(len(words), -1, np.int64), np.zeros(len(words), np.int64)
    g, s = np.nonzero(image_at >= 0)
    place[image_at[g, s]], sensor[image_at[g, s]] = g, s
    return Timeline(
        image_at=image_at,
        of_pass=of_pass,
        rank=rank,
        stride=np.maximum(1, reach // tuning.retrieval.strides_a_reach)[of_pass],
        cell=cell,
        cell_pass=np.repeat(np.arange(len(passes)), cells),
        place=place,
        sensor=sensor,
    )


def _reach(p: Pass, words: BagsOfWords, tuning: Tuning) -> int:
    """Frames over which the images of a camera look alike."""
    steps = [s for s in tuning.ladder if s < len(p)]
    alike = []
    for step in steps:
        left, right = p.images[:, :-step].ravel(), p.images[:, step:].ravel()
        there = (left >= 0) & (right >= 0)
        alike.append(float(words.between(left[there], right[there]).mean()) if there.any() else 0.0)
    # A quarter of the similarity of consecutive frames above that of distant ones
    level = min(alike) + 0.25 * (alike[0] - min(alike))
    below = [s for s, value in zip(steps, alike) if value < level]
    return below[0] if below else steps[-1]


# ---------------------------------------------------------------- finding, growing, confirming


@dataclass(frozen=True)
class Look:
    """The data for judging the previews of pairs along the passes; ``level``: noise floor of unrelated images, None =
    unknown."""

    context: Context
    line: Timeline
    level: NoiseFloor | None

    @property
    def sure(self) -> float:
        """Matches from which a single preview ties."""
        return self.context.tuning.counts.sure * self.context.settings.min_matches


def _blocked(line: Timeline, known: Pairs | None) -> np.ndarray:
    """(C, C) bool: cells whose pairs are not new: near in one pass, or next to known pairs."""
    count = len(line.cell_pass)
    cell = np.arange(count)
    near = np.abs(cell[:, None] - cell) <= 3  # reaches
    blocked = near & (line.cell_pass[:, None] == line.cell_pass)
    if known is None:
        return blocked
    kept = known.kept()
    a, b = line.place[kept.i], line.place[kept.j]
    a, b = line.cell[a[(a >= 0) & (b >= 0)]], line.cell[b[(a >= 0) & (b >= 0)]]
    for da, db in _STEPS:
        x, y = np.clip(a + da, 0, count - 1), np.clip(b + db, 0, count - 1)
        same = (line.cell_pass[x] == line.cell_pass[a]) & (line.cell_pass[y] == line.cell_pass[b])
        blocked[x[same], y[same]] = blocked[y[same], x[same]] = True
    return blocked


def _look_alikes(line: Timeline, words: BagsOfWords, blocked: np.ndarray, count: int) -> np.ndarray:
    """Numbers of the pairs of sampled images with their ``count`` most similar images outside the blocked cells."""
    images = line.sampled()
    cell = line.cell[line.place[images]]
    other, _ = words.among(images).nearest(count, wanted=lambda rows: ~blocked[np.ix_(cell[rows], cell)])
    left = np.repeat(images, other.shape[1])[other.ravel() >= 0]
    return _numbers(left, images[other.ravel()[other.ravel() >= 0]], len(words))


def _numbers(i: np.ndarray, j: np.ndarray, images: int) -> np.ndarray:
    """Sorted unique numbers of pairs of images."""
    return np.unique(np.minimum(i, j).astype(np.int64) * images + np.maximum(i, j))


def _grown(look: Look, key: np.ndarray, blocked: np.ndarray) -> tuple[Ends, bool]:
    """Previewed pairs: those numbered ``key`` and the neighbours of every tie; whether the budget ended it."""
    line, images = look.line, len(look.line.place)
    budget = look.context.tuning.previews_an_image * len(line.sampled())
    done = np.zeros(0, np.int64)
    while len(key):
        if len(done) + len(key) > budget and len(done):
            return np.divmod(done, images), True
        look.context.cache.measure(*np.divmod(key, images))
        # Every first tie is examined from all sides; after that only confirmed ties spread.
        first = not len(done)
        done = np.union1d(done, key)
        hit = done[(_hits if first else _borne_out)(look, np.divmod(done, images))]
        a, b = _around(line, *np.divmod(hit, images))
        fine = (a >= 0) & (b >= 0) & (a != b)
        a, b = a[fine], b[fine]
        fresh = ~blocked[line.cell[line.place[a]], line.cell[line.place[b]]]
        key = np.setdiff1d(_numbers(a[fresh], b[fresh], images), done)
    return np.divmod(done, images), False


def _around(line: Timeline, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The 9 image pairs (K, 9), (K, 9) one stride around each pair, in the order of _STEPS; -1 = no image."""
    stride_i, stride_j = line.stride[line.place[i]], line.stride[line.place[j]]
    a = np.stack([line.moved(i, da * stride_i) for da, _ in _STEPS], axis=-1)
    b = np.stack([line.moved(j, db * stride_j) for _, db in _STEPS], axis=-1)
    return a, b


def _hits(look: Look, ends: Ends) -> np.ndarray:
    """(K,) bool: previews that tie singly, above the noise floor of unrelated images."""
    count, level = look.context.cache.known(*ends), look.level
    if level is None:
        return count >= look.sure
    cameras = look.line.sensor[ends[0]], look.line.sensor[ends[1]]
    return level.above(np.clip(count, level.lowest, level.highest), cameras) >= look.sure


def _borne_out(look: Look, ends: Ends) -> np.ndarray:
    """(K,) bool: previews that tie, and so does the Gaussian mean of the eight frame pairs around them.

    If one in five unrelated pairs ties, one in 75 is confirmed (simulated).
    """
    line, counts, least = look.line, look.context.tuning.counts, look.context.settings.min_matches
    a, b = _around(line, *ends)
    count = look.context.cache.known(np.maximum(a, 0).ravel(), np.maximum(b, 0).ravel()).reshape(a.shape)
    seen = np.isfinite(count) & (a >= 0) & (b >= 0)
    limited = np.clip(np.nan_to_num(count), counts.floor * least, counts.ceiling * least)
    near = np.exp(-np.sum(_STEPS**2, axis=1) / (2 * counts.sigma_nodes**2))
    weight = np.where(np.any(_STEPS, axis=1), near, 0)
    mean = (limited * seen) @ weight / np.maximum(seen @ weight, 1e-9)
    if look.level is not None:
        mean = look.level.above(mean, (line.sensor[ends[0]], line.sensor[ends[1]]))
    return (mean >= look.sure) & _hits(look, ends)


def _patches(line: Timeline, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(K,) patch of adjacent frame pairs to which each pair of images belongs, whatever the cameras."""
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
    return parts(row, column, len(key))[at]


def _filled(line: Timeline, i: np.ndarray, j: np.ndarray, count: np.ndarray) -> Pairs:
    """The frames between the sampled ones take the count of the nearest sampled pair."""
    found = [(i, j, count)]
    most = int(line.stride.max(initial=1)) // 2
    for da in range(-most, most + 1):
        for db in range(-most, most + 1):
            wanted = (2 * abs(da) <= line.stride[line.place[i]]) & (2 * abs(db) <= line.stride[line.place[j]])
            a, b = line.moved(i[wanted], np.full(wanted.sum(), da)), line.moved(j[wanted], np.full(wanted.sum(), db))
            there = (a >= 0) & (b >= 0) & (a != b)
            found.append((a[there], b[there], count[wanted][there]))
    a, b, score = (np.concatenate(column) for column in zip(*found))
    return Pairs.make(a, b, "retrieval", score=score)


def _notes(line: Timeline, passes: Sequence[Pass], i: np.ndarray, j: np.ndarray, patch: np.ndarray) -> tuple[str, ...]:
    """The places of the largest patches of confirmed pairs (K,), (K,)."""
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


# ---------------------------------------------------------------- is a loop of a long survey real


def unrelated(context: Context, line: Timeline, blocked: np.ndarray) -> NoiseFloor | None:
    """The noise floor of previews of unrelated places; None in a short survey, where it is unknown. ``blocked`` (C,
    C): cells that are near each other, or known to tie."""
    if len(line.of_pass) < context.tuning.offsets.long_frames:
        return None
    rng = np.random.default_rng(0)
    c, d = np.triu_indices(line.image_at.shape[1])
    c, d = (np.repeat(ends, context.tuning.verdict.sample) for ends in (c, d))
    a, b = rng.integers(0, len(line.of_pass), (2, len(c)))
    left, right = line.image_at[a, c], line.image_at[b, d]
    fine = (left >= 0) & (right >= 0) & ~blocked[line.cell[a], line.cell[b]]
    if fine.sum() < ENOUGH:
        return None
    c, d, count = c[fine], d[fine], context.cache.measure(left[fine], right[fine])
    shape = (line.image_at.shape[1],) * 2
    least = context.settings.min_matches
    return noise_floor((np.r_[c, d], np.r_[d, c]), np.tile(count, 2), shape, least, context.tuning)


def seen_by_the_rig(look: Look, ends: Ends, patch: np.ndarray) -> np.ndarray:
    """(P,) bool: patches of image pairs ``ends`` that most cameras of the rig confirm; ``patch`` (K,).

    The largest ones are tested; the others are rejected.
    """
    least = look.context.tuning.counts.tie_share
    size = np.bincount(patch)
    most = max(1, len(look.line.of_pass) // 16)
    out = np.zeros(len(size), bool)
    for k in np.argsort(-size, kind="stable")[:most]:
        places = _frame_pairs(look.line, ends[0][patch == k], ends[1][patch == k], 12)
        out[k] = _share_speaking(look, places, least) > 0.5  # simulated: false loops 0.17 to 0.5, true ones 0.83 to 1
    return out


def _frame_pairs(line: Timeline, i: np.ndarray, j: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """A few places a (K,), b (K,) along a patch of image pairs, each the one with most image pairs."""
    a, b = line.place[i], line.place[j]
    a, b = np.minimum(a, b), np.maximum(a, b)
    key, votes = np.unique(a * len(line.of_pass) + b, return_counts=True)
    a, b = key // len(line.of_pass), key % len(line.of_pass)
    chosen = [part[np.argmax(votes[part])] for part in np.array_split(np.arange(len(key)), min(most, len(key)))]
    return a[chosen], b[chosen]


def _share_speaking(look: Look, places: tuple[np.ndarray, np.ndarray], speaks: float) -> float:
    """Share of the cameras that tie at ``places`` with a camera of the other place; the lower one of both.

    One end of the loop chooses the camera, and the other end tests it: the best of several chances would support any
    two places, and neighbouring frames see the same wall.
    """
    (a, b), line, floor = places, look.line, look.level
    assert floor is not None
    left, right = np.broadcast_arrays(line.image_at[a][:, :, None], line.image_at[b][:, None, :])  # (K, S, S)
    there = (left >= 0) & (right >= 0)
    count = np.full(left.shape, np.nan)
    count[there] = look.context.cache.measure(left[there], right[there])
    high = floor.highest
    above = (np.clip(count, floor.lowest, high) - floor.mean) / (high - floor.mean)
    middle = len(a) // 2
    halves = [_mean(above[:middle]), _mean(above[middle:])] if middle else [_mean(above)] * 2
    shares = []
    for axis in (1, 2):
        best = [np.argmax(half, axis=axis - 1, keepdims=True) for half in halves]
        told = [np.take_along_axis(half, b, axis - 1).squeeze(axis - 1) for half, b in zip(halves[::-1], best)]
        cameras = there.any(axis=(0, axis))
        shares.append(float(np.mean((np.mean(told, axis=0) >= speaks)[cameras])))
    return min(shares)


def _mean(above: np.ndarray) -> np.ndarray:
    """(S, S) mean of the known values (K, S, S), -1 where there are none."""
    known = np.isfinite(above)
    return np.where(known.any(axis=0), np.nansum(above, axis=0) / np.maximum(known.sum(axis=0), 1), -1.0)
