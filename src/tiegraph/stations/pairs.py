"""Clouds of shots made ready (thinned, with normals and descriptors), two of them laid on each other, and why that is
believed or not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.errors import optional
from tiegraph.geometry import transforms
from tiegraph.geometry.coarse import Shape, motions, normals, shape_of, side_for, thinned
from tiegraph.geometry.transforms import rms_length, robust_sigma
from tiegraph.stations.tuning import Tuning

MEET = 1.2
"""To the nearest point at most, in voxels of the level, to be counted as overlap: the means of two grids on one surface
are at most so far apart."""
LEAST_POINTS = 200
"""Of a thinned cloud that lie on the other, of a cloud altogether, and of a band of distances."""
LEAST_OVERLAP = 0.2
"""Share of the points of the cloud that overlaps more. Stations are planned for 30 to 60 %."""
_UPWARDS = np.array([0.36, 0.48, 0.8])  # walls have a side too
_LEVELS = 1.0, 0.5, 0.25  # coarse voxels of the refinement, one after another: the last has 40 000 points a cloud
_RESIDUAL = 2.0  # robust sigma of the distances between surfaces over their own roughness, at most


@dataclass(frozen=True)
class Shot:
    """Points (N, 3) of a shot; normals (N, 3) of its file, None = it has none; the sigma (N,) that it states, NaN =
    none. ``known``: its pose (4, 4) in the world, None = unknown. ``own_frame``: its points are in the frame of what
    took it, so that their distance from there is known."""

    name: str
    xyz: np.ndarray
    normal: np.ndarray | None = None
    sigma_m: np.ndarray | None = None
    known: np.ndarray | None = None
    own_frame: bool = True

    def seen_from(self) -> tuple[np.ndarray, bool]:
        """(N, 3) directions in which the surface was seen from, and whether that is sure: else towards the origin of
        the shot's own frame, or in a world upwards."""
        if self.normal is not None:
            return self.normal, True
        return -self.xyz if self.own_frame else np.broadcast_to(_UPWARDS, self.xyz.shape), False


@dataclass(frozen=True)
class Sample:
    """Some points as measured (M, 3), about the middle of the cloud; their lines of sight (M, 3), distance from what
    took them and the sigma they state (M,), metres; NaN = unknown."""

    xyz: np.ndarray
    ray: np.ndarray
    distance_m: np.ndarray
    sigma_m: np.ndarray


class Level:
    """A thinned cloud (N, 3) about its middle: normals, a tree, and its own roughness."""

    def __init__(self, xyz: np.ndarray, side: float, neighbours: int) -> None:
        self.xyz, self.side = xyz, side
        self.tree = cKDTree(xyz)
        self.normal = normals(xyz, neighbours)
        near = xyz[self.tree.query(xyz, k=min(9, len(xyz)))[1][:, 1:]] - xyz[:, None]
        off = np.einsum("nki,ni->nk", near, self.normal)
        self.rough = robust_sigma(off - off.mean(axis=1, keepdims=True))
        # In voxels, because small_gicp's covariances and limits are absolute numbers.
        gicp = engine()
        self.gicp = gicp.PointCloud(xyz / side)
        self.gicp_tree = gicp.KdTree(self.gicp)
        gicp.estimate_covariances(self.gicp, self.gicp_tree, neighbours)


@dataclass(frozen=True)
class Station:
    """A shot ready to be laid on others. Its points are about their ``middle`` (3,); ``known``: world_from_station
    (4, 4) of the points about the middle; ``eye`` (3,) from where they were seen, about the middle, None = unknown."""

    name: str
    middle: np.ndarray
    shape: Shape
    levels: list[Level]
    sample: Sample
    known: np.ndarray | None = None
    eye: np.ndarray | None = None

    @property
    def coarse(self) -> Level:
        """The thinnest level."""
        return self.levels[0]

    @property
    def shift(self) -> np.ndarray:
        """(4, 4) from the shot's own frame to that about the middle."""
        out = np.eye(4)
        out[:3, 3] = -self.middle
        return out

    @property
    def shift_back(self) -> np.ndarray:
        """(4, 4) inverse of ``shift``."""
        return transforms.invert(self.shift)


def common_side(shots: Sequence[Shot], tuning: Tuning) -> float:
    """Side of the coarse voxels: one for all, that of the median cloud."""
    return float(np.median([side_for(s.xyz, tuning.coarse.points) for s in shots]))


def station_of(shot: Shot, side: float, tuning: Tuning) -> Station:
    """Make a shot ready. Raises ValueError if too few points are left of it."""
    middle = np.median(shot.xyz, axis=0)
    xyz = shot.xyz - middle
    shape = shape_of(xyz, side, tuning.coarse, *shot.seen_from())
    if len(shape.xyz) < LEAST_POINTS:
        raise ValueError(
            f"only {len(shape.xyz)} voxels of {side:.3g} m have points: its surface is too small beside the others'"
        )
    levels = [Level(thinned(xyz, side * share)[0], side * share, tuning.coarse.normal_neighbours) for share in _LEVELS]
    known = None
    if shot.known is not None:
        known = shot.known.copy()
        known[:3, 3] += shot.known[:3, :3] @ middle
    return Station(
        name=shot.name,
        middle=middle,
        shape=shape,
        levels=levels,
        sample=_sample(shot, middle),
        known=known,
        eye=-middle if shot.own_frame else None,
    )


def _sample(shot: Shot, middle: np.ndarray) -> Sample:
    some = slice(None, None, max(1, len(shot.xyz) // 20_000))
    xyz = shot.xyz[some]
    unknown = np.full(len(xyz), np.nan)
    distance = np.linalg.norm(xyz, axis=1) if shot.own_frame else unknown
    return Sample(
        xyz=xyz - middle,
        ray=xyz / np.maximum(distance, 1e-12)[:, None],
        distance_m=distance,
        sigma_m=unknown if shot.sigma_m is None else shot.sigma_m[some],
    )


def engine() -> Any:
    """The module small_gicp. Raises EngineMissing without it."""
    return optional("small_gicp", "stations", "the registration of clouds")


def spacing_of(xyz: np.ndarray, from_origin: bool) -> np.ndarray:
    """(N,) the usual spacing of points (N, 3) as far away as each: a stray point has that of its distance, not its own.

    ``from_origin``: the points are in the frame of what took them; else one spacing for all.
    """
    some = slice(None, None, max(1, len(xyz) // 10_000))
    third = cKDTree(xyz).query(xyz[some], k=min(4, len(xyz)))[0][:, -1]  # a disc that wide holds three others
    if not from_origin:
        return np.full(len(xyz), float(np.median(third)))
    away = np.linalg.norm(xyz, axis=1)
    order = np.argsort(away[some], kind="stable")
    parts = np.array_split(order, min(20, len(order)))
    middle = [float(np.median(away[some][p])) for p in parts]
    return np.interp(away, middle, [float(np.median(third[p])) for p in parts])


@dataclass(frozen=True)
class Met:
    """Points of one level that lie on the surface of another: rows of the source and the target (M,), residuals (M,)
    along the target's normals, metres; and the share of either cloud, the larger."""

    source: np.ndarray
    target: np.ndarray
    residual_m: np.ndarray
    overlap: float

    @property
    def sigma_m(self) -> float:
        """Robust sigma of the residuals."""
        return robust_sigma(self.residual_m) if len(self.residual_m) else np.inf

    def agree(self, limit_m: float) -> float:
        """The overlap that agrees to within a limit."""
        return self.overlap * float(np.mean(np.abs(self.residual_m) < limit_m)) if len(self.residual_m) else 0.0


def refined(target: Level, source: Level, start: np.ndarray) -> np.ndarray:
    """target_from_source (4, 4) after GICP from a start."""
    scaled = start.copy()
    scaled[:3, 3] /= target.side
    found = engine().align(
        target.gicp,
        source.gicp,
        target.gicp_tree,
        scaled,
        registration_type="GICP",
        max_correspondence_distance=2.5,
        num_threads=1,
        max_iterations=40,
        rotation_epsilon=1e-6,  # rad
        translation_epsilon=1e-5,  # voxels
    )
    fit = np.array(found.T_target_source)
    fit[:3, 3] *= target.side
    return fit


def met(target: Level, source: Level, fit: np.ndarray) -> Met:
    """Which points of the source lie on the target."""
    moved = transforms.apply(fit, source.xyz)
    reach = MEET * target.side
    away, at = target.tree.query(moved, distance_upper_bound=reach)
    near = np.flatnonzero(np.isfinite(away))
    turned = source.normal[near] @ fit[:3, :3].T
    alike = np.abs(np.einsum("ij,ij->i", turned, target.normal[at[near]])) > np.cos(np.radians(30.0))
    rows, planes = near[alike], at[near[alike]]
    residual = np.einsum("ij,ij->i", target.normal[planes], target.xyz[planes] - moved[rows])
    back = transforms.apply(transforms.invert(fit), target.xyz)
    other = float(np.isfinite(source.tree.query(back, distance_upper_bound=reach)[0]).mean()) if len(rows) else 0.0
    share = len(rows) / len(source.xyz)
    overlap = max(share, min(other, share * len(source.xyz) / len(target.xyz)))
    return Met(source=rows, target=planes, residual_m=residual, overlap=overlap)


def held(target: Level, source: Level, fit: np.ndarray, found: Met) -> tuple[np.ndarray, np.ndarray, float]:
    """How well the surfaces hold a fit: middle (3,) of the overlap in the target's frame, information (6, 6) of turn
    (rad) and shift (m) about it, and smallest over largest eigenvalue of the equations, all unknowns in metres.

    By the equations of points against planes; those of a sixth of the longest side err together.
    """
    xyz = transforms.apply(fit, source.xyz[found.source])
    normal = target.normal[found.target]
    middle = xyz.mean(axis=0)
    from_middle = xyz - middle
    extent = rms_length(from_middle)
    design = np.column_stack([np.cross(from_middle, normal) / extent, normal])
    keep = np.abs(found.residual_m) < 3 * found.sigma_m
    design, residual, from_middle = design[keep], found.residual_m[keep], from_middle[keep]
    matrix = design.T @ design
    values = np.linalg.eigvalsh(matrix)
    side = np.ptp(from_middle, axis=0).max() / 6
    _, cell = np.unique(np.floor(from_middle / side).astype(int), axis=0, return_inverse=True)
    pull = np.zeros((cell.max() + 1, 6))
    np.add.at(pull, cell.ravel(), design * (residual - residual.mean())[:, None])
    inverse = np.linalg.pinv(matrix)
    formal = inverse * found.sigma_m**2
    unit = np.r_[np.full(3, 1 / extent), np.ones(3)]
    covariance = (inverse @ (pull.T @ pull) @ inverse + formal) * np.outer(unit, unit)
    return middle, np.linalg.inv(covariance), float(values[0] / values[-1])


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
    limit = _RESIDUAL * float(np.hypot(a.coarse.rough, b.coarse.rough))
    places = []
    for motion in motions(b.shape, a.shape, a.coarse.side, tuning.coarse):
        fit = refined(a.coarse, b.coarse, motion.target_from_source)
        places.append((met(a.coarse, b.coarse, fit).agree(limit), fit))
    if not places:
        return None
    places.sort(key=lambda p: -p[0])
    (agree, best), others = places[0], places[1:]
    pair = from_start(first, second, stations, best)
    if pair.why_not:
        return pair
    apart = tuning.coarse.apart * a.coarse.side
    here = transforms.apply(best, b.coarse.xyz)
    away = [np.linalg.norm(transforms.apply(fit, b.coarse.xyz) - here, axis=1).max() for _, fit in others]
    rival = max((share for (share, _), far in zip(others, away) if far > apart), default=0.0)
    # A surface of eight equal waves, shifted by one, has 0.75 to 0.85; other places of bumpy objects 0.5.
    if rival > 0.7 * agree:
        return pair.refused(f"fits in another place too: {agree:.0%} of the surface agree here, {rival:.0%} there")
    return pair


def from_start(first: int, second: int, stations: Sequence[Station], start: np.ndarray) -> Pair:
    """Two stations from a start (4, 4), refined level by level and judged at each."""
    a, b, fit = stations[first], stations[second], np.asarray(start, float)
    for target, source in zip(a.levels, b.levels):
        fit = refined(target, source, fit)
        found = met(target, source, fit)
        rough, why = float(np.hypot(target.rough, source.rough)), ""
        if found.overlap < LEAST_OVERLAP or len(found.source) < LEAST_POINTS:
            why = f"only {found.overlap:.0%} overlap at best"
        elif found.sigma_m > _RESIDUAL * rough:
            why = f"the surfaces differ by {found.sigma_m:.2g} m where they are rough to {rough:.2g} m"
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
    middle, information, _ = held(target, source, fit, found)
    pair = replace(pair, middle=middle, information=information, through=looked_through(a, b, fit))
    _, _, open_share = held(a.coarse, b.coarse, fit, met(a.coarse, b.coarse, fit))
    # A plane, sphere, cylinder or edge has 0.00007 to 0.0004, a relief of 10 mm on 0.4 m 0.0024, an object 0.007.
    if open_share < 0.001:
        return pair.refused(f"the surfaces slide along each other (held to {open_share:.1g} of what a corner holds)")
    # Residuals of a whole cell have one sign there, and tens of thousands of points hold no better than one.
    if pair.sigma_m > 0.4 * pair.residual_m:
        return pair.refused("the distances between the surfaces are no noise: they are not the same surface")
    return pair


def looked_through(a: Station, b: Station, a_from_b: np.ndarray) -> float:
    """Share of the points of either station in the view of the other that stand in its free space; the larger of both.

    Nothing stands between a measured point and what took it, so points that a fit puts there contradict the fit,
    however well the surfaces meet elsewhere. Points behind a surface say nothing. NaN where it is not known from where
    a cloud was taken, or too few points are in view.
    """
    both = [_share(a, b, a_from_b), _share(b, a, transforms.invert(a_from_b))]
    return float(np.nanmax(both)) if np.isfinite(both).any() else np.nan


def _share(looking: Station, other: Station, fit: np.ndarray) -> float:
    """Of the other's points in view of the one that looks: the share nearer than all its own in their direction."""
    eye, side = looking.eye, looking.coarse.side
    if eye is None:
        return np.nan
    own, ray = _distances(looking.coarse.xyz - eye)
    away, towards = _distances(transforms.apply(fit, other.coarse.xyz) - eye)
    apart, at = cKDTree(ray).query(towards, k=4)
    view = (apart * own[at] < 1.5 * side).all(axis=1)  # chords as lengths at the distance of the own point
    if np.count_nonzero(view) < 50:
        return np.nan
    before = away[view] < own[at[view]].min(axis=1) - 3 * side
    return float(before.mean())


def _distances(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    length = np.linalg.norm(xyz, axis=1)
    return length, xyz / np.maximum(length, 1e-12)[:, None]
