"""How precise points are by their distance: how far, along the line of sight, from surfaces that others saw."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.align import robust_sigma
from tiegraph.stations.pairs import Pair
from tiegraph.stations.station import Level, Sample, Station
from tiegraph.stations.tuning import PrecisionTuning, Tuning


@dataclass(frozen=True)
class Band:
    """Points at some distance from what took them: robust sigma of their distance along the line of sight from the
    others' surfaces, and the median of the sigma that the shots state (NaN = none), metres."""

    from_m: float
    to_m: float
    points: int
    sigma_m: float
    stated_m: float


def by_distance(stations: Sequence[Station], poses: np.ndarray, pairs: Sequence[Pair], tuning: Tuning) -> list[Band]:
    """Precision by distance, of the points as measured against the means of many points of another cloud.

    ``poses`` (K, 4, 4) of the shots, NaN = left out; [] where no distance is known.
    """
    found = [np.zeros((0, 3))]
    for pair in pairs:
        if not np.isfinite(poses[[pair.first, pair.second]]).all():
            continue
        for own, other in ((pair.first, pair.second), (pair.second, pair.first)):
            a, b = stations[own], stations[other]
            fit = b.shift @ transforms.invert(poses[other]) @ poses[own] @ a.shift_back
            found.append(_off(a.sample, b.levels[-1], fit, tuning))
    rows = np.concatenate(found)
    return _bands(rows[np.isfinite(rows[:, 0])], tuning.precision)


def _off(sample: Sample, level: Level, fit: np.ndarray, tuning: Tuning) -> np.ndarray:
    """(M, 3) distance from the station, along the line of sight from the other's surface, and sigma stated, of the
    points that lie on it and see it not too obliquely."""
    moved = transforms.apply(fit, sample.xyz)
    away, at = level.tree.query(moved, distance_upper_bound=tuning.pair.meet * level.side)
    near = np.flatnonzero(np.isfinite(away))
    normal = level.normal[at[near]]
    sight = sample.ray[near] @ fit[:3, :3].T
    straight = np.abs(np.einsum("ij,ij->i", normal, sight))
    off = np.einsum("ij,ij->i", normal, moved[near] - level.xyz[at[near]])
    seen = straight > np.cos(np.radians(tuning.precision.oblique_deg))
    return np.column_stack([sample.distance_m[near], off / np.maximum(straight, 1e-3), sample.sigma_m[near]])[seen]


def _bands(rows: np.ndarray, tuning: PrecisionTuning) -> list[Band]:
    """Bands of equal width over what 98 % of the points are in, those with enough of them."""
    if len(rows) < tuning.least_points:
        return []
    low, high = np.percentile(rows[:, 0], [1, 99])
    edges = np.linspace(low, high, tuning.bands + 1)
    out = []
    for low, high in zip(edges, edges[1:]):
        inside = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if len(inside) < tuning.least_points:
            continue
        stated = inside[np.isfinite(inside[:, 2]), 2]
        sigma = robust_sigma(inside[:, 1] - np.median(inside[:, 1]))
        out.append(
            Band(
                from_m=float(low),
                to_m=float(high),
                points=len(inside),
                sigma_m=sigma,
                stated_m=float(np.median(stated)) if len(stated) else np.nan,
            )
        )
    return out
