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
from tiegraph.geometry.align import rms_length, robust_sigma
from tiegraph.geometry.coarse import motions
from tiegraph.stations.station import Level, Station, engine
from tiegraph.stations.tuning import PairTuning, Tuning

_TURN, _SHIFT = 1e-6, 1e-5  # rad and voxels: GICP has converged


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
        rotation_epsilon=_TURN,
        translation_epsilon=_SHIFT,
    )
    fit = np.array(found.T_target_source)
    fit[:3, 3] *= target.side
    return fit


def met(target: Level, source: Level, fit: np.ndarray, tuning: PairTuning) -> Met:
    """Which points of the source lie on the target."""
    moved = transforms.apply(fit, source.xyz)
    reach = tuning.meet * target.side
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


@dataclass(frozen=True)
class Held:
    """How well the surfaces hold a fit: ``information`` (6, 6) of turn (rad) and shift (m) about ``middle`` (3,) in the
    target's frame, and smallest over largest eigenvalue of the equations, all unknowns in metres of motion."""

    middle: np.ndarray
    information: np.ndarray
    open_share: float


def held(target: Level, source: Level, fit: np.ndarray, found: Met) -> Held:
    """By the equations of points against planes; points of a sixth of the longest side err together (a sandwich of
    clusters)."""
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
    return Held(middle, np.linalg.inv(covariance), float(values[0] / values[-1]))


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
        fit = refined(a.coarse, b.coarse, motion.target_from_source)
        places.append((met(a.coarse, b.coarse, fit, tuning.pair).agree(limit), fit))
    if not places:
        return None
    places.sort(key=lambda p: -p[0])
    (agree, best), others = places[0], places[1:]
    pair = from_start(first, second, stations, best, tuning)
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


def from_start(first: int, second: int, stations: Sequence[Station], start: np.ndarray, tuning: Tuning) -> Pair:
    """Two stations from a start (4, 4), refined level by level and judged at each."""
    a, b, limits, fit = stations[first], stations[second], tuning.pair, np.asarray(start, float)
    for target, source in zip(a.levels, b.levels):
        fit = refined(target, source, fit)
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
    fine = held(target, source, fit, found)
    through = looked_through(a, b, fit)
    pair = replace(pair, middle=fine.middle, information=fine.information, through=through)
    coarse = held(a.coarse, b.coarse, fit, met(a.coarse, b.coarse, fit, limits))
    # A plane, sphere, cylinder or edge has 0.00007 to 0.0004, a relief of 10 mm on 0.4 m 0.0024, an object 0.007.
    if coarse.open_share < 0.001:
        return pair.refused(
            f"the surfaces slide along each other (held to {coarse.open_share:.1g} of what a corner holds)"
        )
    # Residuals of a whole cell have one sign there, and tens of thousands of points hold no better than one.
    if pair.sigma_m > 0.4 * pair.residual_m:
        return pair.refused("the distances between the surfaces are no noise: they are not the same surface")
    return pair


def _not_the_same(found: Met, rough: float, limits: PairTuning) -> str:
    if found.overlap < limits.least_overlap or len(found.source) < limits.least_points:
        return f"only {found.overlap:.0%} overlap at best"
    if found.sigma_m > limits.residual * rough:
        return f"the surfaces differ by {found.sigma_m:.2g} m where they are rough to {rough:.2g} m"
    return ""


# --- what one station saw where another looked through ---------------------------------------------------------------


def looked_through(a: Station, b: Station, a_from_b: np.ndarray) -> float:
    """Share of the points of either station that stand in free space of the other, of those that are in its view; the
    larger of both. NaN where it is not known from where a cloud was taken, or too few points are in view."""
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
    """Lengths (N,) and directions (N, 3) of vectors (N, 3)."""
    length = np.linalg.norm(xyz, axis=1)
    return length, xyz / np.maximum(length, 1e-12)[:, None]
