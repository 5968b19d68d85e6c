"""Two stations laid on each other, and why that is believed or not.

What one station saw where another looked through: a sign that they were laid on each other in a wrong place. A measured
point says that nothing stands between it and what took it. Points of another cloud that a fit puts there contradict the
fit, however well the surfaces meet elsewhere. Points behind a surface say nothing: they were hidden.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.geometry.coarse.consistent import motions
from tiegraph.stations.fine import Met, held, met, refined
from tiegraph.stations.station import Station
from tiegraph.stations.tuning import PairTuning, SightTuning, Tuning


@dataclass(frozen=True)
class Pair:
    """``first_from_second`` (4, 4) of stations about their middles; share that overlaps, robust sigma of the distance
    between the surfaces and their own roughness, metres; ``information`` (6, 6) of turn and shift about ``middle`` (3,)
    in the first's frame. ``why_not``: why it is not believed, "" = it is. ``through``: share of what one saw that
    stands where the other looked through, NaN = not known."""

    first: int
    second: int
    first_from_second: np.ndarray
    overlap: float
    residual_m: float
    middle: np.ndarray
    information: np.ndarray
    why_not: str = ""
    through: float = np.nan

    @property
    def sigma_m(self) -> float:
        """Of the shift in the middle of the overlap, the largest of any direction."""
        return float(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(self.information)[3:, 3:])[-1]))

    def refused(self, why: str) -> "Pair":
        """The pair, not believed."""
        return replace(self, why_not=why)


def from_shapes(first: int, second: int, stations: Sequence[Station], tuning: Tuning) -> Pair | None:
    """Two stations without a start; None if no place shows at all."""
    a, b = stations[first], stations[second]
    limit = tuning.pair.residual * float(np.hypot(a.coarse.rough, b.coarse.rough))
    places = []
    for motion in motions(b.shape, a.shape, a.coarse.side, tuning.coarse):
        fit = refined(a.coarse, b.coarse, motion.target_from_source, tuning.pair)
        places.append((met(a.coarse, b.coarse, fit, tuning.pair).agree(limit), fit))
    if not places:
        return None
    places.sort(key=lambda p: -p[0])
    (agree, best), others = places[0], places[1:]
    pair = from_start(first, second, stations, best, tuning)
    if pair.why_not:
        return pair
    apart = tuning.coarse.apart * a.coarse.side
    rival = max((share for share, fit in others if _apart(fit, best, b.coarse.xyz) > apart), default=0.0)
    if rival > tuning.pair.rival * agree:
        return pair.refused(f"fits in another place too: {agree:.0%} of the surface agree here, {rival:.0%} there")
    return pair


def _apart(fit: np.ndarray, other: np.ndarray, xyz: np.ndarray) -> float:
    """The largest distance between points (N, 3) moved by one and the other fit (4, 4)."""
    return float(np.linalg.norm(transforms.apply(fit, xyz) - transforms.apply(other, xyz), axis=1).max())


def from_start(first: int, second: int, stations: Sequence[Station], start: np.ndarray, tuning: Tuning) -> Pair:
    """Two stations from a start (4, 4), refined level by level and judged at each."""
    a, b, limits, fit = stations[first], stations[second], tuning.pair, np.asarray(start, float)
    for target, source in zip(a.levels, b.levels):
        fit = refined(target, source, fit, limits)
        found = met(target, source, fit, limits)
        rough = float(np.hypot(target.rough, source.rough))
        why = _not_the_same(found, rough, limits)
        if why:
            break
    pair = Pair(
        first=first,
        second=second,
        first_from_second=fit,
        overlap=found.overlap,
        residual_m=found.sigma_m,
        middle=np.zeros(3),
        information=np.eye(6),
        why_not=why,
    )
    if why:
        return pair
    fine = held(target, source, fit, found, limits)
    through = looked_through(a, b, fit, tuning.sight)
    pair = replace(pair, middle=fine.middle, information=fine.information, through=through)
    coarse = held(a.coarse, b.coarse, fit, met(a.coarse, b.coarse, fit, limits), limits)
    if coarse.open_share < limits.open_share:
        return pair.refused(
            f"the surfaces slide along each other (held to {coarse.open_share:.1g} of what a corner holds)"
        )
    if pair.sigma_m > limits.systematic * pair.residual_m:
        return pair.refused("the distances between the surfaces are no noise: they are not the same surface")
    return pair


def _not_the_same(found: Met, rough: float, limits: PairTuning) -> str:
    if found.overlap < limits.least_overlap or len(found.source) < limits.least_points:
        return f"only {found.overlap:.0%} overlap at best"
    if found.sigma_m > limits.residual * rough:
        return f"the surfaces differ by {found.sigma_m:.2g} m where they are rough to {rough:.2g} m"
    return ""


# --- what one station saw where another looked through ---------------------------------------------------------------


def looked_through(a: Station, b: Station, a_from_b: np.ndarray, tuning: SightTuning) -> float:
    """Share of the points of either station that stand in free space of the other, of those that are in its view; the
    larger of both. NaN where it is not known from where a cloud was taken, or too few points are in view."""
    both = [_share(a, b, a_from_b, tuning), _share(b, a, transforms.invert(a_from_b), tuning)]
    return float(np.nanmax(both)) if np.isfinite(both).any() else np.nan


def _share(looking: Station, other: Station, fit: np.ndarray, tuning: SightTuning) -> float:
    """Of the other's points in view of the one that looks: the share nearer than all its own in their direction."""
    eye, side = looking.eye, looking.coarse.side
    if eye is None:
        return np.nan
    own, ray = _distances(looking.coarse.xyz - eye)
    away, towards = _distances(transforms.apply(fit, other.coarse.xyz) - eye)
    apart, at = cKDTree(ray).query(towards, k=tuning.neighbours)
    view = (apart * own[at] < tuning.apart * side).all(axis=1)  # chords as lengths at the distance of the own point
    if np.count_nonzero(view) < tuning.least_points:
        return np.nan
    before = away[view] < own[at[view]].min(axis=1) - tuning.before * side
    return float(before.mean())


def _distances(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (N,) and directions (N, 3) of vectors (N, 3)."""
    length = np.linalg.norm(xyz, axis=1)
    return length, xyz / np.maximum(length, 1e-12)[:, None]
