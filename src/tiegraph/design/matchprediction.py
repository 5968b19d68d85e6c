"""The expected matches of a pair, from the points of the coarse model that both images should see.

Only a part of the candidates is ever previewed, and a preview is a weak predictor of full resolution. The rate at which
a point is found again in a second image falls with the angle between the two rays and with the ratio of the distances:
this law is fitted to the previewed pairs, and all pairs are predicted by it in the same way.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from tiegraph.design.tuning import MatchPredictionTuning
from tiegraph.scene.pairs import Pairs, PreviewMatches, Visibility

_MIX = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))  # splitmix64


@dataclass(frozen=True)
class _Law:
    """Matches of a preview = by_chance + rate * sum over common points of exp(-(angle / a)^2 - (octaves / o)^2)."""

    angle_deg: float
    octaves: float
    rate: float
    by_chance: float

    def likely(self, angle_deg: np.ndarray, octaves: np.ndarray) -> np.ndarray:
        """(K,) probability that points are found again, 1 where angle and distance are equal."""
        return np.exp(-((angle_deg / self.angle_deg) ** 2) - (octaves / self.octaves) ** 2)


def verified_chance(expected: np.ndarray, tuning: MatchPredictionTuning) -> np.ndarray:
    """(P,) probability that pairs of so many expected preview matches are verified at full resolution."""
    return expected**2 / (expected**2 + tuning.even_matches**2)


def predict_matches(
    i: np.ndarray, j: np.ndarray, measured: np.ndarray, visibility: Visibility, tuning: MatchPredictionTuning
) -> tuple[np.ndarray, PreviewMatches]:
    """Ties and expected matches of pairs i < j (P,); ``measured`` (P,) preview matches, NaN = not previewed.

    Which of the common points match is drawn at random, with the probability of each point, and reproducibly.
    A measured count and the prediction by points are combined by their geometric mean.
    """
    law = _fitted(i, j, measured, visibility, tuning)
    image = np.repeat(np.arange(len(visibility.centre)), np.diff(visibility.start))
    # Whether a point is detected in an image is the same for all its pairs.
    detected = _uniform(visibility.point, image, image) < np.sqrt(law.rate)
    expected = np.full(len(i), np.nan)
    count, matches = np.zeros(len(i), int), [np.zeros((0, 2), np.uint16)]
    by_image = np.lexsort((j, i))
    for both in _in_common(i, j, visibility, by_image):
        likely = law.likely(*_geometry(both, visibility))
        size = np.bincount(both.number, minlength=len(both.pairs))
        promised = law.rate * np.bincount(both.number, likely, len(both.pairs))
        looked = measured[both.pairs]
        shared = np.sqrt((np.maximum(np.nan_to_num(looked) - law.by_chance, 0.0) + 1.0) * (promised + 1.0)) - 1.0
        foreseen = np.where(np.isfinite(looked), shared, promised)
        there = size > 0
        expected[both.pairs[there]] = np.maximum(foreseen, 1.0)[there]
        chosen = _chosen(both, visibility, detected, likely, foreseen / np.maximum(promised, 1e-9))
        count[both.pairs] = np.bincount(both.number[chosen], minlength=len(both.pairs))
        matches.append(np.stack([both.left[chosen], both.right[chosen]], axis=1).astype(np.uint16))
    order = by_image[np.isfinite(expected[by_image])]
    start = np.concatenate([[0], np.cumsum(count[order])])
    ties = PreviewMatches(i=i[order], j=j[order], start=start, matches=np.concatenate(matches))
    return expected, ties


@dataclass(frozen=True)
class _Common:
    """The points that one image shares with others, (K,) each: ``number`` of the pair among ``pairs`` (rows of the
    table), ``point``, its places ``left`` and ``right`` among those that the image and the ``other`` see."""

    image: int
    pairs: np.ndarray
    number: np.ndarray
    other: np.ndarray
    point: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def rows(self, visibility: Visibility) -> tuple[np.ndarray, np.ndarray]:
        """(K,) rows of the image and of the other in the table of observations."""
        return visibility.start[self.image] + self.left, visibility.start[self.other] + self.right


def _in_common(i: np.ndarray, j: np.ndarray, visibility: Visibility, by_image: np.ndarray) -> Iterator[_Common]:
    """The common points of the pairs i, j (P,), image by image; ``by_image`` (P,): their order by i, then j."""
    place = np.full(len(visibility.xyz), -1, np.int32)
    first = np.flatnonzero(np.r_[True, np.diff(i[by_image]) != 0]) if len(i) else np.zeros(0, int)
    for rows in np.split(by_image, first[1:]) if len(i) else ():
        image = int(i[rows[0]])
        own = visibility.of(image)
        place[own] = np.arange(len(own))
        begin, count = visibility.start[j[rows]], visibility.start[j[rows] + 1] - visibility.start[j[rows]]
        at = np.repeat(begin - (np.cumsum(count) - count), count) + np.arange(count.sum())
        left = place[visibility.point[at]]
        place[own] = -1
        hit = np.flatnonzero(left >= 0)
        number = np.repeat(np.arange(len(rows)), count)[hit]
        yield _Common(
            image=image,
            pairs=rows,
            number=number,
            other=j[rows][number],
            point=visibility.point[at[hit]],
            left=left[hit],
            right=at[hit] - begin[number],
        )


def _chosen(
    both: _Common, visibility: Visibility, detected: np.ndarray, likely: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Places of the common points that match: ``detected`` in both images, and drawn by ``likely`` ``times``."""
    left, right = both.rows(visibility)
    kept = np.flatnonzero(detected[left] & detected[right])
    chance = likely[kept] * times[both.number[kept]]
    return kept[_uniform(both.point[kept], both.image, both.other[kept]) < chance]


def _geometry(both: _Common, visibility: Visibility) -> tuple[np.ndarray, np.ndarray]:
    """(K,) angles between the rays of two images to their common points, degrees; octaves between the distances.

    Coordinate by coordinate: columns of three numbers would take three times as long.
    """
    own = visibility.xyz[visibility.of(both.image)] - visibility.centre[both.image]
    rays = [
        (own[:, k][both.left], visibility.xyz[:, k][both.point] - visibility.centre[:, k][both.other]) for k in range(3)
    ]
    far_a = np.maximum(np.sqrt(sum(np.square(own).T))[both.left], 1e-12)
    far_b = np.maximum(np.sqrt(sum(np.square(b) for _, b in rays)), 1e-12)
    cosine = sum(a * b for a, b in rays) / (far_a * far_b)
    octaves = np.abs(np.log2(far_a / far_b))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), octaves


def _fitted(
    i: np.ndarray, j: np.ndarray, measured: np.ndarray, visibility: Visibility, tuning: MatchPredictionTuning
) -> _Law:
    """The law that explains the previewed pairs best (weighted least squares, no number below zero)."""
    known = np.flatnonzero(np.isfinite(measured))
    if len(known) > tuning.sample:
        known = np.random.default_rng(0).choice(known, tuning.sample, replace=False)
    rows, columns = tuning.cells
    cells = rows * columns
    cell_deg, cell_octaves = min(tuning.angles_deg) / 2, min(tuning.octaves) / 2
    table = np.zeros((len(known), cells), np.float32)
    for both in _in_common(i[known], j[known], visibility, np.lexsort((j[known], i[known]))):
        angle, octaves = _geometry(both, visibility)
        row = np.minimum((angle / cell_deg).astype(int), rows - 1)
        cell = row * columns + np.minimum((octaves / cell_octaves).astype(int), columns - 1)
        size = len(both.pairs) * cells
        table[both.pairs] = np.bincount(both.number * cells + cell, minlength=size).reshape(-1, cells)
    filled = table.any(axis=1)
    best, least = (
        _Law(angle_deg=20.0, octaves=0.7, rate=0.5, by_chance=0.0),  # 0.7 found in each image, as SIFT repeats
        np.inf,
    )
    if filled.sum() < tuning.least_previewed:
        return best
    table, count = table[filled], measured[known][filled]
    weight = 1.0 / np.sqrt(np.maximum(count, 5.0))
    angle = (np.arange(rows)[:, None] + 0.5) * cell_deg
    octave = (np.arange(columns)[None] + 0.5) * cell_octaves
    for a in tuning.angles_deg:
        for o in tuning.octaves:
            likely = table @ np.exp(-((angle / a) ** 2) - (octave / o) ** 2).ravel()
            found, residual = scipy.optimize.nnls(
                np.stack([likely, np.ones(len(count))], axis=1) * weight[:, None], count * weight
            )
            if residual < least and found[0] > 0:
                best, least = _Law(angle_deg=a, octaves=o, rate=float(found[0]), by_chance=float(found[1])), residual
    return best


def _uniform(point: np.ndarray, a: int | np.ndarray, b: int | np.ndarray) -> np.ndarray:
    """(K,) numbers in [0, 1) that depend on points and pair alone."""
    with np.errstate(over="ignore"):
        x = point.astype(np.uint64) * _MIX[0]
        x = x + np.asarray(a, np.uint64) * _MIX[1] + np.asarray(b, np.uint64) * _MIX[2]
        x = (x ^ (x >> np.uint64(30))) * _MIX[1]
        x = (x ^ (x >> np.uint64(27))) * _MIX[2]
        x ^= x >> np.uint64(31)
    return (x >> np.uint64(11)).astype(np.float64) / float(1 << 53)


def expected_matches(pairs: Pairs, ties: PreviewMatches | None) -> np.ndarray:
    """(P,) preview matches of each pair, measured or expected, at least 1.

    Counted matches first; else the score; else in proportion to the predicted overlap, as for previewed pairs;
    else the median of the known ones.
    """
    counted = counted_matches(pairs, ties)
    measured = np.where(np.isnan(counted), pairs.score, counted)
    both = np.isfinite(pairs.overlap) & np.isfinite(measured) & (pairs.overlap > 0)
    a, b = pairs.overlap[both], measured[both]
    by_overlap = pairs.overlap * (float(a @ b) / float(a @ a) if len(a) else 60.0)  # only ratios matter then
    usual = float(np.nanmedian(measured)) if np.isfinite(measured).any() else 1.0
    out = np.where(np.isfinite(measured), measured, by_overlap)
    return np.maximum(np.where(np.isfinite(out), out, usual), 1.0)


def counted_matches(pairs: Pairs, ties: PreviewMatches | None) -> np.ndarray:
    """(P,) preview matches of the pairs that were previewed, NaN for the others."""
    if ties is None or not len(ties):
        return np.full(len(pairs), np.nan)
    row = ties.find(pairs.i, pairs.j)
    return np.where(row >= 0, ties.counts()[row], np.nan)
