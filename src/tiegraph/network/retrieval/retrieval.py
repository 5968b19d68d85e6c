"""Source ``retrieval``: ties that the order does not suggest, found by similarity and confirmed by previews.

Loose photographs: ``network.loose``. Passes: loops, where a camera returns to a place long after, or two passes meet
off the path that ``network.offsets`` follows. A single look-alike is no evidence: repeated walls give a fifth or more
of unrelated images the preview count of true pairs; the previews of the frames before and after must agree.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tiegraph.network.offsets.background import noise_floor
from tiegraph.network.offsets.curves import Proposal
from tiegraph.network.passes import MatchCache, Pass, loose_images
from tiegraph.network.retrieval.loose import scored_pairs
from tiegraph.network.retrieval.timeline import Timeline, timeline
from tiegraph.network.retrieval.vocabulary import BagsOfWords, bags_of_words
from tiegraph.network.scorematrix import NoiseFloor
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.network.tuning.retrieval import LoopSearchTuning, VocabularyTuning
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.scene import Scene

NAMED = 5  # places listed singly in the notes
_STEPS = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)])  # strides to the neighbouring frame pairs


def nearest_images(
    descriptors: Sequence[np.ndarray], count: int, tuning: VocabularyTuning
) -> tuple[np.ndarray, np.ndarray]:
    """The ``count`` most similar images of each of N images with descriptors (K, 128) u1: indices (N, C) i4, -1 = no
    more, and cosines (N, C) f4, best first. Linear memory; 4000 images of 800 features take half a minute."""
    return bags_of_words(descriptors, tuning).nearest(count)


def retrieve(
    scene: Scene,
    passes: Sequence[Pass],
    cache: MatchCache,
    settings: CandidatesSettings,
    tuning: Tuning,
    descriptors: Callable[[], Sequence[np.ndarray]],
    known: Pairs | None = None,
) -> Proposal:
    """Pairs of loose photographs and loops of passes; ``known`` (kept) pairs and their surroundings are no loops.

    ``descriptors()`` gives root-SIFT (K, 128) u1 of the preview of every image.
    """
    words = bags_of_words(descriptors(), tuning.retrieval.vocabulary)
    loose = loose_images(scene)
    pairs = scored_pairs(scene, loose, cache, settings, tuning, words)
    notes: tuple[str, ...] = ()
    if len(loose):
        notes = (f"retrieval: {len(pairs.kept())} pairs of {len(loose)} loose photographs",)
    loops = loop_candidates(passes, words, cache, settings, tuning, known)
    return Proposal(pairs, notes) | loops


def loop_candidates(
    passes: Sequence[Pass],
    words: BagsOfWords,
    cache: MatchCache,
    settings: CandidatesSettings,
    tuning: Tuning,
    known: Pairs | None = None,
) -> Proposal:
    """Look-alikes far from the known pairs, confirmed by the previews of the frames around them.

    Dropped pairs carry ``weak``: previewed and not confirmed.
    """
    passes = [p for p in passes if len(p) > 1]
    if not passes:
        return Proposal(Pairs.empty())
    looks = tuning.retrieval
    line = timeline(passes, words, looks.loops)
    blocked = _blocked(line, known, 3)  # frames closer than three reaches are no loop
    level = unrelated(line, blocked, cache, settings.min_matches, tuning)
    look = _Look(line=line, cache=cache, min_matches=settings.min_matches, level=level, tuning=tuning)
    i, j, spent = _grown(look, _look_alikes(line, words, blocked, looks.loops.look_alikes), blocked)
    count = cache.known(i, j)
    sure = _borne_out(look, (i, j))
    patch = _patches(line, i[sure], j[sure])
    large = np.bincount(patch) >= looks.loops.patch
    if level is not None:
        large &= seen_by_the_rig(line, (i[sure], j[sure]), patch, cache, level, looks.loops)
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


# ---------------------------------------------------------------- finding, growing, confirming


@dataclass(frozen=True)
class _Look:
    """The data for judging the previews of pairs along the passes; ``level``: noise floor of unrelated images, None =
    unknown."""

    line: Timeline
    cache: MatchCache
    min_matches: int
    level: NoiseFloor | None
    tuning: Tuning

    @property
    def sure(self) -> float:
        """Matches from which a single preview ties."""
        return self.tuning.retrieval.sure_alike * self.min_matches


def _blocked(line: Timeline, known: Pairs | None, near_reaches: int) -> np.ndarray:
    """(C, C) bool: cells whose pairs are not new: near in one pass, or next to known pairs."""
    count = len(line.cell_pass)
    cell = np.arange(count)
    near = np.abs(cell[:, None] - cell) <= near_reaches
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


def _look_alikes(line: Timeline, words: BagsOfWords, blocked: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs i < j (K,), (K,) of sampled images with their ``count`` most similar images outside the blocked cells."""
    images = line.sampled()
    cell = line.cell[line.place[images]]
    other, _ = words.among(images).nearest(count, wanted=lambda rows: ~blocked[np.ix_(cell[rows], cell)])
    left = np.repeat(images, other.shape[1])[other.ravel() >= 0]
    return _unique(left, images[other.ravel()[other.ravel() >= 0]], len(words))


def _unique(i: np.ndarray, j: np.ndarray, images: int) -> tuple[np.ndarray, np.ndarray]:
    key = np.unique(np.minimum(i, j).astype(np.int64) * images + np.maximum(i, j))
    return key // images, key % images


def _grown(
    look: _Look, seeds: tuple[np.ndarray, np.ndarray], blocked: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Previewed pairs: the given ones, and the neighbours of every tie until nothing new ties; whether the budget of
    previews was spent before."""
    line, images = look.line, len(look.line.place)
    budget = look.tuning.retrieval.loops.previews_an_image * len(line.sampled())
    done = np.zeros(0, np.int64)
    key = seeds[0] * images + seeds[1]
    first = True
    while len(key):
        if len(done) + len(key) > budget and len(done):
            return done // images, done % images, True
        look.cache.measure(key // images, key % images)
        done = np.union1d(done, key)
        # Every first tie is examined from all sides; after that only confirmed ties spread.
        hit = key[_hits(look, (key // images, key % images))]
        if not first:
            own = _borne_out(look, (done // images, done % images))
            hit = done[own]
        first = False
        a, b = _around(line, hit // images, hit % images)
        fine = (a >= 0) & (b >= 0) & (a != b)
        a, b = a[fine], b[fine]
        fresh = ~blocked[line.cell[line.place[a]], line.cell[line.place[b]]]
        a, b = _unique(a[fresh], b[fresh], images)
        key = np.setdiff1d(a * images + b, done)
    return done // images, done % images, False


def _around(line: Timeline, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The 9 image pairs (K, 9), (K, 9) one stride around each pair, in the order of _STEPS; -1 = no image."""
    stride_i, stride_j = line.stride[line.place[i]], line.stride[line.place[j]]
    a = np.stack([line.moved(i, da * stride_i) for da, _ in _STEPS], axis=-1)
    b = np.stack([line.moved(j, db * stride_j) for _, db in _STEPS], axis=-1)
    return a, b


def _hits(look: _Look, ends: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(K,) bool: previews that tie singly, above the noise floor of unrelated images."""
    count, level = look.cache.known(*ends), look.level
    if level is None:
        return count >= look.sure
    cameras = look.line.sensor[ends[0]], look.line.sensor[ends[1]]
    return level.above(np.clip(count, level.lowest, level.highest), cameras) >= look.sure


def _borne_out(look: _Look, ends: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(K,) bool: previews that tie, and so does the weighted mean of those around them, without themselves.

    The weights are a Gaussian over the 3 x 3 neighbouring frame pairs, as on the lattice of ``offsets``. If one in
    five unrelated pairs ties, one in 75 is confirmed (simulated).
    """
    line, counts = look.line, look.tuning.counts
    a, b = _around(line, *ends)
    count = look.cache.known(np.maximum(a, 0).ravel(), np.maximum(b, 0).ravel()).reshape(a.shape)
    seen = np.isfinite(count) & (a >= 0) & (b >= 0)
    limited = np.clip(np.nan_to_num(count), counts.floor * look.min_matches, counts.ceiling * look.min_matches)
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
    graph = coo_array((np.ones(len(row)), (row, column)), shape=(len(key), len(key)))
    label = connected_components(graph.tocsr(), directed=False)[1] if len(key) else np.zeros(0, int)
    return label[at]


def _filled(line: Timeline, i: np.ndarray, j: np.ndarray, count: np.ndarray) -> Pairs:
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


# --- significance
# --------------------------------------------------------------------------------------------------------
# Is a loop real? Its previews must exceed those of unrelated frames of this survey, for the whole rig.
#
# Repeated walls tie two places for one or two cameras and some frames; back at the same place, most cameras of the
# rig see what the rig saw before. So the frame pairs of a loop are previewed by all cameras, including those not
# involved in finding it.
#
# A loop far from the path is accepted if most cameras of the rig support it, each with the camera chosen at the other
# end of the loop.


def unrelated(
    line: Timeline, blocked: np.ndarray, cache: MatchCache, min_matches: int, tuning: Tuning
) -> NoiseFloor | None:
    """The noise floor of previews of unrelated places; None in a short survey, where it is unknown. ``blocked`` (C,
    C): cells that are near each other, or known to tie."""
    background = tuning.offsets.background
    if len(line.of_pass) < background.long_frames:
        return None
    rng = np.random.default_rng(0)
    c, d = np.triu_indices(line.image_at.shape[1])
    c, d = np.repeat(c, background.samples), np.repeat(d, background.samples)
    a, b = rng.integers(0, len(line.of_pass), (2, len(c)))
    left, right = line.image_at[a, c], line.image_at[b, d]
    fine = (left >= 0) & (right >= 0) & ~blocked[line.cell[a], line.cell[b]]
    if fine.sum() < background.enough:
        return None
    c, d, count = c[fine], d[fine], cache.measure(left[fine], right[fine])
    shape = (line.image_at.shape[1],) * 2
    return noise_floor((np.r_[c, d], np.r_[d, c]), np.tile(count, 2), shape, min_matches, tuning)


def seen_by_the_rig(
    line: Timeline,
    ends: tuple[np.ndarray, np.ndarray],
    patch: np.ndarray,
    cache: MatchCache,
    floor: NoiseFloor,
    tuning: LoopSearchTuning,
) -> np.ndarray:
    """(P,) bool: patches of image pairs ``ends`` i (K,), j (K,) that most cameras of the rig confirm; ``patch`` (K,).

    The largest ones are tested; the others are rejected.
    """
    size = np.bincount(patch)
    most = max(1, len(line.of_pass) // 16)
    out = np.zeros(len(size), bool)
    for k in np.argsort(-size, kind="stable")[:most]:
        a, b = _frame_pairs(line, ends[0][patch == k], ends[1][patch == k], 12)
        out[k] = _share_speaking(line, (a, b), cache, floor, tuning.speaks) >= tuning.most_cameras
    return out


def _frame_pairs(line: Timeline, i: np.ndarray, j: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """A few places a (K,), b (K,) along a patch of image pairs, each the one with most image pairs."""
    a, b = line.place[i], line.place[j]
    a, b = np.minimum(a, b), np.maximum(a, b)
    key, votes = np.unique(a * len(line.of_pass) + b, return_counts=True)
    a, b = key // len(line.of_pass), key % len(line.of_pass)
    chosen = [part[np.argmax(votes[part])] for part in np.array_split(np.arange(len(key)), min(most, len(key)))]
    return a[chosen], b[chosen]


def _share_speaking(
    line: Timeline, places: tuple[np.ndarray, np.ndarray], cache: MatchCache, floor: NoiseFloor, speaks: float
) -> float:
    """Share of the cameras that tie at ``places`` a (K,), b (K,) with a camera of the other place; the lower one of
    both.

    One end of the loop chooses the camera, and the other end tests whether they tie: the best of several chances
    would support any two places, and neighbouring frames see the same wall.
    """
    a, b = places
    left, right = np.broadcast_arrays(line.image_at[a][:, :, None], line.image_at[b][:, None, :])  # (K, S, S)
    there = (left >= 0) & (right >= 0)
    count = np.full(left.shape, np.nan)
    count[there] = cache.measure(left[there], right[there])
    high = floor.highest
    above = (np.clip(count, floor.lowest, high) - floor.told) / (high - floor.told)
    middle = len(a) // 2
    halves = [_mean(above[:middle]), _mean(above[middle:])] if middle else [_mean(above)] * 2
    shares = []
    for axis in (1, 2):
        told = [_at_best(choose, judge, axis - 1) for choose, judge in (halves, halves[::-1])]
        cameras = there.any(axis=(0, axis))
        shares.append(float(np.mean((np.mean(told, axis=0) >= speaks)[cameras])))
    return min(shares)


def _mean(above: np.ndarray) -> np.ndarray:
    """(S, S) mean of the known values (K, S, S), -1 where there are none."""
    known = np.isfinite(above)
    return np.where(known.any(axis=0), np.nansum(above, axis=0) / np.maximum(known.sum(axis=0), 1), -1.0)


def _at_best(choose: np.ndarray, judge: np.ndarray, axis: int) -> np.ndarray:
    """(S,) of ``judge`` (S, S) where ``choose`` is highest along an axis."""
    best = np.argmax(choose, axis=axis, keepdims=True)
    return np.take_along_axis(judge, best, axis).squeeze(axis)
