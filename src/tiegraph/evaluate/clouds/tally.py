"""Distances of any number of judged points in a file: shares below limits and exact quantiles, in bounded memory."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_PART = 1_000_000  # rows read at once
_ROW = np.dtype([("distance_m", "<f4"), ("group", "u1", 2), ("counts", "?")])
_HALF = 1 << 16


@dataclass(frozen=True)
class Judged:
    """Of points (N,): the distance to the other cloud (inf: further than looked for), the numbers (N, 2) of their band
    and section, and whether they count."""

    distance: np.ndarray
    group: np.ndarray
    counts: np.ndarray

    def tobytes(self) -> bytes:
        """As rows of the file that ``Tally`` reads."""
        rows = np.zeros(len(self.distance), _ROW)
        rows["distance_m"], rows["group"], rows["counts"] = self.distance, self.group, self.counts
        return rows.tobytes()


@dataclass(frozen=True)
class Tally:
    """The rows of a file, or those of them with one ``number`` of a ``group`` (0 band, 1 section)."""

    path: Path
    group: int = 0
    number: int | None = None

    def where(self, group: int, number: int) -> "Tally":
        """Those of one band or section."""
        return Tally(self.path, group, number)

    def count(self) -> tuple[int, int]:
        """Points that count, and points."""
        counted = total = 0
        for rows in self._rows():
            counted += int(rows["counts"].sum())
            total += len(rows)
        return counted, total

    def below(self, limits: Sequence[float]) -> np.ndarray:
        """(L,) shares 0..1 of the points that count that are nearer than the limits; 0 without points."""
        found, points = np.zeros(len(limits), np.int64), 0
        for distance in self._distances():
            found += [int(np.sum(distance < limit)) for limit in limits]
            points += len(distance)
        return found / max(points, 1)

    def beyond(self, limit: float) -> float:
        """Share 0..1 of the points that count that are further."""
        found = [(int(np.sum(distance > limit)), len(distance)) for distance in self._distances()]
        return sum(n for n, _ in found) / max(sum(n for _, n in found), 1)

    def quantiles(self, shares: Sequence[float]) -> list[float]:
        """Of the points that count, as ``numpy.quantile`` of all their distances; NaN without points or beyond what was
        looked for.

        Distances are positive, so that their 32 bits are in the order of their values: the upper half of the bits is
        counted first, then the lower half of those values whose rank is asked for.
        """
        upper = np.zeros(_HALF, np.int64)
        for bits in self._bits():
            upper += np.bincount(bits >> 16, minlength=_HALF)
        to = np.cumsum(upper)
        if not to[-1]:
            return [float("nan")] * len(shares)
        at = np.array(shares) * (to[-1] - 1)
        ranks = np.stack([np.floor(at), np.ceil(at)]).astype(np.int64)
        bins = np.searchsorted(to, ranks, side="right")
        lower = {int(b): np.zeros(_HALF, np.int64) for b in np.unique(bins)}
        for bits in self._bits():
            for b, counts in lower.items():
                counts += np.bincount(bits[bits >> 16 == b] & (_HALF - 1), minlength=_HALF)
        ends = np.zeros(bins.shape, np.float32)
        for k, upper_half in np.ndenumerate(bins):
            b = int(upper_half)
            rest = np.searchsorted(np.cumsum(lower[b]), ranks[k] - (to[b] - upper[b]), side="right")
            ends[k] = np.array([b << 16 | rest], np.uint32).view(np.float32)[0]
        with np.errstate(invalid="ignore"):  # between two distances that were not found
            found = ends[0] + (ends[1].astype(float) - ends[0]) * (at - ranks[0])
        return [float(v) if np.isfinite(v) else float("nan") for v in found]

    def _rows(self) -> Iterator[np.ndarray]:
        count = self.path.stat().st_size // _ROW.itemsize
        for start in range(0, count, _PART):
            rows = np.fromfile(self.path, _ROW, min(_PART, count - start), offset=start * _ROW.itemsize)
            yield rows if self.number is None else rows[rows["group"][:, self.group] == self.number]

    def _distances(self) -> Iterator[np.ndarray]:
        for rows in self._rows():
            yield np.ascontiguousarray(rows["distance_m"][rows["counts"]])

    def _bits(self) -> Iterator[np.ndarray]:
        for distance in self._distances():
            yield distance.view(np.uint32)
