"""All stations in one frame: pairs, loops, adjustment, further pairs by the poses, and the frame of the world."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import robust_sigma
from tiegraph.stations.loops import Part, adjusted, contradicted, motion, parts, taken_apart
from tiegraph.stations.pairs import (
    LEAST_OVERLAP,
    LEAST_POINTS,
    MEET,
    Level,
    Pair,
    Sample,
    Shot,
    Station,
    common_side,
    from_shapes,
    from_start,
    met,
    station_of,
)
from tiegraph.stations.tuning import Tuning


@dataclass(frozen=True)
class Joined:
    """K stations in one frame. ``poses`` (K, 4, 4) world_from_shot, in the frames that the shots came in; NaN = left
    out, with the reason in ``left_out``; ``sigma_m`` (K,) of the middle of each cloud against the first of its part,
    NaN = no pair holds it; all ``pairs`` that have a place; ``loop_m`` (P, 2) of those believed, in their order: by
    what their loop does not close before and after the adjustment."""

    poses: np.ndarray
    sigma_m: np.ndarray
    pairs: list[Pair]
    loop_m: np.ndarray
    left_out: dict[int, str]

    @property
    def believed(self) -> list[Pair]:
        """The pairs that the poses were made of."""
        return [p for p in self.pairs if not p.why_not]


def prepared(shots: Sequence[Shot], tuning: Tuning) -> tuple[list[Station], dict[str, str]]:
    """Shots ready to be joined, and why others are not, by name.

    Raises ValueError if fewer than two can be.
    """
    side = common_side(shots, tuning)
    if not side > 0:
        raise ValueError("the points of the clouds stand in one place: no surface")
    out: list[Station] = []
    why: dict[str, str] = {}
    for shot in shots:
        try:
            out.append(station_of(shot, side, tuning))
        except ValueError as error:
            why[shot.name] = str(error)
    if len(out) < 2:
        raise ValueError("; ".join(f"{n}: {w}" for n, w in why.items()))
    return out, why


def join(
    stations: Sequence[Station], tuning: Tuning, told: Callable[[int, int], None] = lambda done, most: None
) -> Joined:
    """Put stations into one frame; ``told`` hears how many pairs of how many are done.

    The frame is that of the known poses, if there are some; else that of the first station of the largest part that
    hangs together. Raises ValueError if no two join and no pose is known.
    """
    agreeing = _points_shown(stations), stations[0].coarse.side
    pairs = contradicted(_first_pairs(stations, tuning, told), *agreeing)
    found = _adjusted_parts(pairs, len(stations))
    for _ in range(3):  # further pairs that the adjusted poses say overlap, until there are none
        more = _further(stations, pairs, found)
        if not more:
            break
        anew = {(p.first, p.second) for p in more}
        pairs = contradicted([p for p in pairs if (p.first, p.second) not in anew] + more, *agreeing)
        found = _adjusted_parts(pairs, len(stations))
    left = {ends: float(row[1]) for ends, row in _loops_m(found).items()}
    pairs = taken_apart(pairs, left, *agreeing)
    found = _adjusted_parts(pairs, len(stations))
    poses, left_out = _in_world(stations, found)
    loops = _loops_m(found)
    rows = np.array([loops[p.first, p.second] for p in pairs if not p.why_not]).reshape(-1, 2)
    sigma = np.full(len(stations), np.nan)
    for part in found:
        for k in part.members if len(part.members) > 1 else ():
            sigma[k] = np.sqrt(np.trace(part.covariance[k, 3:, 3:]) / 3)
    return Joined(poses=poses, sigma_m=sigma, pairs=pairs, loop_m=rows, left_out=left_out)


def _loops_m(found: Sequence[Part]) -> dict[tuple[int, int], np.ndarray]:
    """By how much the loop of each believed pair does not close before and after the adjustment (2,), metres."""
    return {(p.first, p.second): row for part in found for p, row in zip(part.pairs, part.loop_m)}


def _points_shown(stations: Sequence[Station]) -> list[np.ndarray]:
    return [s.coarse.xyz[:: max(1, len(s.coarse.xyz) // 200)] for s in stations]


def _first_pairs(stations: Sequence[Station], tuning: Tuning, told: Callable[[int, int], None]) -> list[Pair]:
    """Pairs by known poses where both have one, else by shapes: all, or of many stations those alike or following."""
    asked = list(combinations(range(len(stations)), 2))
    if len(stations) > tuning.all_pairs:
        usual = np.array([s.shape.described.mean(axis=0) for s in stations])
        off = np.linalg.norm(usual[:, None] - usual, axis=2)
        rank = np.argsort(np.argsort(off, axis=1, kind="stable"), axis=1)
        least = np.minimum(rank, rank.T)
        asked = [(i, j) for i, j in asked if least[i, j] <= tuning.alike or j - i <= tuning.following]
    out = []
    for done, (i, j) in enumerate(asked, 1):
        known, other = stations[i].known, stations[j].known
        if known is not None and other is not None:
            pair = _by_poses(stations, i, j, transforms.invert(known) @ other)
        else:
            pair = from_shapes(i, j, stations, tuning)
        if pair is not None:
            out.append(pair)
        told(done, len(asked))
    return out


def _by_poses(stations: Sequence[Station], i: int, j: int, start: np.ndarray) -> Pair | None:
    """A pair from poses; None if these say that the clouds do not overlap."""
    a, b = stations[i], stations[j]
    if met(a.coarse, b.coarse, start).overlap < LEAST_OVERLAP / 2:
        return None
    return from_start(i, j, stations, start)


def _further(stations: Sequence[Station], pairs: Sequence[Pair], found: Sequence[Part]) -> list[Pair]:
    """Pairs that overlap by the adjusted poses and have not been believed yet, laid on each other from there."""
    close, points = stations[0].coarse.side, _points_shown(stations)
    believed = {(p.first, p.second) for p in pairs if not p.why_not}
    out = []
    for part in found:
        for i, j in combinations(sorted(part.members), 2):
            start = transforms.invert(part.poses[i]) @ part.poses[j]
            pair = None if (i, j) in believed else _by_poses(stations, i, j, start)
            if pair is None or pair.why_not:
                continue
            if motion(pair.first_from_second @ transforms.invert(start), points[i]) <= close:
                out.append(pair)
    return out


def _adjusted_parts(pairs: list[Pair], count: int) -> list[Part]:
    """The parts that hang together, largest first, each adjusted in the frame of its first station."""
    label = parts(count, pairs)
    members = [np.flatnonzero(label == k).tolist() for k in range(label.max() + 1)]
    members.sort(key=lambda m: (-len(m), m[0]))
    return [adjusted(m, [p for p in pairs if not p.why_not and p.first in m], count) for m in members]


def _in_world(stations: Sequence[Station], found: list[Part]) -> tuple[np.ndarray, dict[int, str]]:
    """world_from_shot (K, 4, 4), and why some have none. Raises ValueError if none can be joined."""
    held = [part for part in found if any(stations[k].known is not None for k in part.members)]
    largest = found[0]
    if not held and len(largest.members) < 2:
        raise ValueError("no two clouds could be laid on each other")
    poses = np.full((len(stations), 4, 4), np.nan)
    left_out: dict[int, str] = {}
    for part in found:
        if held and part not in held:
            why = "hangs on no cloud with a known pose"
        elif not held and part is not largest:
            why = "hangs on none of the others"
        else:
            world = _laid_on_known(stations, part) if held else stations[part.members[0]].shift_back
            for k in part.members:
                poses[k] = world @ part.poses[k] @ stations[k].shift
            continue
        if len(part.members) > 1:
            why = f"{why} (only on {len(part.members) - 1} that do not either)"
        left_out |= dict.fromkeys(part.members, why)
    return poses, left_out


def _laid_on_known(stations: Sequence[Station], part: Part) -> np.ndarray:
    """world_from_part (4, 4): one motion that leaves the known poses of its stations on the average."""
    known = {k: stations[k].known for k in part.members}
    single = [pose @ transforms.invert(part.poses[k]) for k, pose in known.items() if pose is not None]
    turn = Rotation.from_matrix([m[:3, :3] for m in single]).mean().as_matrix()
    places = [(pose[:3, 3], part.poses[k, :3, 3]) for k, pose in known.items() if pose is not None]
    return transforms.rigid(turn, np.mean([there - turn @ here for there, here in places], axis=0))


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
            found.append(_off(a.sample, b.levels[-1], fit))
    rows = np.concatenate(found)
    return _bands(rows[np.isfinite(rows[:, 0])], tuning.precision.bands)


def _off(sample: Sample, level: Level, fit: np.ndarray) -> np.ndarray:
    """(M, 3) distance from the station, along the line of sight from the other's surface, and sigma stated, of the
    points that lie on it and see it not too obliquely."""
    moved = transforms.apply(fit, sample.xyz)
    away, at = level.tree.query(moved, distance_upper_bound=MEET * level.side)
    near = np.flatnonzero(np.isfinite(away))
    normal = level.normal[at[near]]
    sight = sample.ray[near] @ fit[:3, :3].T
    straight = np.abs(np.einsum("ij,ij->i", normal, sight))
    off = np.einsum("ij,ij->i", normal, moved[near] - level.xyz[at[near]])
    seen = straight > np.cos(np.radians(60.0))
    return np.column_stack([sample.distance_m[near], off / np.maximum(straight, 1e-3), sample.sigma_m[near]])[seen]


def _bands(rows: np.ndarray, most: int) -> list[Band]:
    """Bands of equal width over what 98 % of the points are in, those with enough of them."""
    if len(rows) < LEAST_POINTS:
        return []
    low, high = np.percentile(rows[:, 0], [1, 99])
    edges = np.linspace(low, high, most + 1)
    out = []
    for low, high in zip(edges, edges[1:]):
        inside = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if len(inside) < LEAST_POINTS:
            continue
        stated = inside[np.isfinite(inside[:, 2]), 2]
        usual = float(np.median(stated)) if len(stated) else np.nan
        sigma = robust_sigma(inside[:, 1] - np.median(inside[:, 1]))
        out.append(Band(from_m=float(low), to_m=float(high), points=len(inside), sigma_m=sigma, stated_m=usual))
    return out
