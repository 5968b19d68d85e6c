"""The frame of a reference surface: from the world to (u, v, w) and back; and which curved one fits a survey.

A frame is rigid, or it unrolls a profile, straight or closed, that is swept along an axis c(s), a cubic spline through
nodes at equal distances, so that s is its arc length. Across the tangent t lie ``side`` = t x z, to the
right, and ``up`` = side x t: unlike a frame without torsion (Bishop 1975) this one keeps the crown above on ramps. A
point p belongs to the nearest place of the axis, (p - c(s)) . t(s) = 0, and has x = (p - c) . side, y = (p - c) . up.

    straight:  u = s,  v = y,         w = x                   a vertical surface along a curve in plan, on z = 0
    closed:    u = s,  v = l(a),      w = r(a) - |(x, y)|     a tube; a = atan2(x, y), 0 at the crown

r is the distance of the profile from the axis, linear between equal angles, and l its length from the crown: of a
circle r = R and l = R a.

(u, v, w) is right-handed: whoever w points to sees u grow to the right and v upwards. What has the length 1 along u
is 1 - k . (p - c) long in the world, with the curvature k = c''; what has it along v is 1 - w / r long on a tube.

A curved surface is a tube round the path of the cameras, or a wall beside it. Its axis is an alignment as roads and
railways have it: its curvature in plan, and of a tube its slope, are piecewise linear in the arc length, so that it
consists of straights, arcs, clothoids and vertical parabolas. The pieces are several diameters or wall heights long. A
shorter wave, a bulge or noise cannot be followed: it is a deviation.

Start, heading, curvatures, slopes and radius are fitted to the path first, then to the points: by least squares of the
distances at fixed nearest places of the axis, which are then taken anew (tangent distance minimisation, Wang, Pottmann
and Liu 2006, section 3), with Cauchy's loss, so that floors, doors and bulges count little. A profile that is not a
circle is the median distance of the points from that axis at each angle.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.products.tuning import ChooseTuning
from tiegraph.scene.results import Cloud

_STEPS = 4  # of Newton's method to the nearest place of the axis
_BETWEEN = 8  # places of the axis between two nodes, at which that begins


@dataclass(frozen=True, eq=False)
class Frame:
    """A rigid frame (4, 4) surface_from_world; or nodes (N, 3) of an axis in the world, ``spacing`` apart along it, and
    the radius of the tube round it, infinite for a straight profile: then the matrix applies to what is unrolled.
    ``profile`` (M,) is the distance of a tube from its axis at equal angles from -180 to 180 deg, in radii."""

    surface_from_world: np.ndarray
    nodes: np.ndarray | None = None
    spacing: float = 0.0
    radius: float = np.inf
    profile: np.ndarray = field(default_factory=lambda: np.ones(2))

    @property
    def tube(self) -> bool:
        """Whether the profile is closed."""
        return bool(np.isfinite(self.radius))

    @cached_property
    def around(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(M,) angles of the profile of a tube, its distances r from the axis and its lengths v from the crown."""
        a, r = np.linspace(-np.pi, np.pi, len(self.profile)), self.radius * self.profile
        v = np.r_[0.0, np.cumsum(np.hypot((r[1:] + r[:-1]) / 2 * np.diff(a), np.diff(r)))]
        return a, r, v - np.interp(0.0, a, v)

    @property
    def stations(self) -> np.ndarray:
        """(N,) s of the nodes, none of a rigid frame."""
        return self.spacing * np.arange(0 if self.nodes is None else len(self.nodes))

    @cached_property
    def _curves(self) -> tuple[CubicSpline, CubicSpline, CubicSpline]:
        axis = CubicSpline(self.stations, self.nodes)
        return axis, axis.derivative(), axis.derivative(2)

    @cached_property
    def _starts(self) -> tuple[np.ndarray, cKDTree]:
        s = np.linspace(0, self.stations[-1], _BETWEEN * len(self.stations))
        return s, cKDTree(self._curves[0](s))

    def axis(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The axis at s (...), straight on beyond its ends: places c (..., 3), rows t, side and up (..., 3, 3), and
        the curvature vector k (..., 3) in 1 / length."""
        on = np.clip(s, 0, self.stations[-1])
        c, t, k = (curve(on) for curve in self._curves)
        t = t / np.linalg.norm(t, axis=-1, keepdims=True)
        side = np.stack([t[..., 1], -t[..., 0], np.zeros_like(on)], axis=-1)
        side /= np.linalg.norm(side, axis=-1, keepdims=True)
        beyond = (s - on)[..., None]
        return c + beyond * t, np.stack([t, side, np.cross(side, t)], axis=-2), np.where(beyond == 0, k, 0.0)

    def across(self, xyz: np.ndarray) -> np.ndarray:
        """(..., 3) s, x and y of world points (..., 3)."""
        flat = xyz if self.tube else xyz * [1.0, 1.0, 0.0]
        starts, tree = self._starts
        s = starts[tree.query(flat)[1]]
        for _ in range(_STEPS):
            c, axes, k = self.axis(s)
            off = flat - c
            s = s + np.sum(off * axes[..., 0, :], axis=-1) / np.maximum(1 - np.sum(off * k, axis=-1), 0.1)
        c, axes, _ = self.axis(s)
        off = np.einsum("...ij,...j->...i", axes, xyz - c)
        return np.stack([s, off[..., 1], off[..., 2]], axis=-1)

    def uvw(self, xyz: np.ndarray) -> np.ndarray:
        """(..., 3) u, v and w of world points (..., 3)."""
        if self.nodes is not None:
            s, x, y = np.moveaxis(self.across(xyz), -1, 0)
            xyz = np.stack([s, y, x], axis=-1)
            if self.tube:
                (a, r, v), at = self.around, np.arctan2(x, y)
                xyz = np.stack([s, np.interp(at, a, v), np.interp(at, a, r) - np.hypot(x, y)], axis=-1)
        return transforms.apply(self.surface_from_world, xyz)

    def in_world(self, u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """World points (..., 3) at u, v and w of one shape (...): the inverse of ``uvw``."""
        world_from_surface = transforms.invert(self.surface_from_world)
        xyz = transforms.transformed(world_from_surface[:3], np.stack([u, v, w], axis=-1))
        if self.nodes is None:
            return xyz
        c, axes, _ = self.axis(xyz[..., 0])
        x, y = xyz[..., 2], xyz[..., 1]
        if self.tube:
            a, r, v = self.around
            at = np.interp(y, v, a)
            x, y = (np.interp(at, a, r) - x) * np.stack([np.sin(at), np.cos(at)])
        return c + x[..., None] * axes[..., 1, :] + y[..., None] * axes[..., 2, :]

    def gradients(self, u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """(..., 3, 3) rows: the gradients of u, v and w in the world at places (...). The roll of a tube's frame where
        a ramp bends is left out."""
        turn = self.surface_from_world[:3, :3]
        if self.nodes is None:
            return np.broadcast_to(turn, (*np.shape(w), 3, 3))
        s, v, w = np.moveaxis(
            transforms.apply(transforms.invert(self.surface_from_world), np.stack([u, v, w], -1)), -1, 0
        )
        _, axes, k = self.axis(s)
        t, out, round_ = np.moveaxis(axes, -2, 0)
        if not self.tube:
            return turn @ np.stack([t / (1 - w * np.sum(out * k, axis=-1))[..., None], round_, out], axis=-2)
        angles, radii, lengths = self.around
        a = np.interp(v, lengths, angles)
        part = np.clip(np.searchsorted(angles, a, side="right") - 1, 0, len(angles) - 2)
        longer, farther = (np.diff(x)[part] / np.diff(angles)[part] for x in (lengths, radii))
        sine, cosine = np.sin(a)[..., None], np.cos(a)[..., None]
        out, round_ = sine * out + cosine * round_, cosine * out - sine * round_
        r = np.maximum(np.interp(a, angles, radii) - w, 1e-9 * self.radius)
        along = t / (1 - r * np.sum(out * k, axis=-1))[..., None]
        round_ = round_ / r[..., None]
        return turn @ np.stack([along, longer[..., None] * round_, farther[..., None] * round_ - out], axis=-2)


Found = tuple[Frame, float]
"""The frame of a surface, and the share of the points that lie on it."""
Residual = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""Distances of points from a surface, by their x and y (N,) across its axis and its radius."""
_REFITTED = 6  # times the nearest places are taken anew
_STIFF = 1e-3  # weight of changes of curvature and slope, which continue where there are no points
_NODES = 32  # of the axis on a piece of the alignment
_MOST_PIECES = 100  # a longer survey has longer ones
_ENDS = 1e-3  # share of the points beyond each end of the axis
TIGHTEST = 0.7
"""Largest distance from the axis beside the radius of its bend: lengths along u are 1.7 times as long there."""
_LEVEL = np.array([1.0, 1.0, 0.0])


def tunnel(path: np.ndarray, cloud: Cloud, tuning: ChooseTuning, circle: bool = True) -> list[Found]:
    """The tube round a path (N, 3), a circle or of the profile that the points have. Raises ReconstructionError for a
    path that is too short, without motion, or comes back to itself, for a bend tighter than the tube, and for too few
    points on it."""
    far = cKDTree(path).query(cloud.xyz_m)[0]
    away = float(np.median(far))
    near, spacing = cloud.xyz_m[far < 3 * away], tuning.smooth * 2 * away
    axis = _along(path, away, spacing, radius=away)
    for _ in range(2):  # the second time on the range of the points
        axis = _fitted(axis, spacing, near, lambda x, y, radius: np.hypot(x, y) - radius, away)
        s, _, w = axis.uvw(cloud.xyz_m).T
        on = np.abs(w) < tuning.flatness * axis.radius
        axis = _covered(axis, s[on])
    bend = 1 / np.linalg.norm(axis.axis(axis.stations)[2], axis=1).max()
    if axis.radius > TIGHTEST * bend:
        raise _refused(
            f"the tube of radius {axis.radius:.3g} bends with a radius of {bend:.3g} and would overlap itself",
            "make the survey of its straighter parts",
        )
    if not circle:
        axis = _profiled(axis, near, tuning.a_median)
        on = np.abs(axis.uvw(cloud.xyz_m)[:, 2]) < tuning.flatness * axis.radius
    return [(axis, _share(on, tuning, f"the tube of radius {axis.radius:.3g} round the path"))]


def _profiled(axis: Frame, xyz: np.ndarray, a_median: int) -> Frame:
    """A tube with the profile of points (N, 3): the medians of equally many at neighbouring angles."""
    s, x, y = axis.across(xyz).T
    along = (s > 0) & (s < axis.stations[-1])
    a, r = np.arctan2(x, y)[along], np.hypot(x, y)[along]
    groups = np.array_split(np.argsort(a), max(3, len(a) // a_median))
    at, angles = np.array([np.median(a[g]) for g in groups]), np.linspace(-np.pi, np.pi, 2 * len(groups) + 1)
    profile = np.zeros(len(angles))
    for _ in range(3):  # each time about the last one, across which the points of a group scatter less
        off = r - np.interp(a, angles, profile)
        profile += np.interp(angles, at, [np.median(off[g]) for g in groups], period=2 * np.pi)
    return replace(axis, profile=profile / axis.radius)


def walls(path: np.ndarray, cloud: Cloud, tuning: ChooseTuning) -> list[Found]:
    """The vertical surfaces on both sides of a path (N, 3), the one with more points first. Raises ReconstructionError
    for a path that is too short, without motion, or comes back to itself, and if neither side has a wall."""
    upright = np.abs(cloud.normal[:, 2]) < np.sin(np.radians(tuning.upright_deg))
    xyz, normal = cloud.xyz_m[upright], cloud.normal[upright]
    if len(xyz) <= (least := tuning.least_share * len(cloud)):
        _share(upright, tuning, "what stands upright")
    away = float(np.median(cKDTree(path[:, :2]).query(xyz[:, :2])[0]))
    spacing = tuning.smooth * float(np.ptp(np.quantile(xyz[:, 2], [0.05, 0.95])))
    beside = _along(path * _LEVEL, away, spacing)
    found = []
    for sign in (1, -1):
        s, x, _ = beside.across(xyz).T
        facing = _facing(beside, s, normal, -sign, tuning) & (x * sign > 0)
        if facing.sum() < least:
            continue
        far = sign * (np.bincount((np.abs(x[facing]) / (away / 10)).astype(int)).argmax() + 0.5) * away / 10
        axes = beside.axis(beside.stations)[1]
        axis = _polyline(beside.nodes + far * axes[:, 1])  # type: ignore[operator]
        axis = _covered(axis, axis.stations)
        for _ in range(2):
            near = facing & (np.abs(axis.across(xyz)[:, 1]) < tuning.reach * abs(far))
            axis = _fitted(axis, spacing, xyz[near], lambda x, y, radius: x, np.inf)
            s, x, _ = axis.across(xyz).T
            on = _facing(axis, s, normal, -sign, tuning) & (np.abs(x) < tuning.flatness * abs(far))
            if on.sum() < least:
                break
            axis = _covered(axis, s[on])
        else:
            nodes = axis.nodes if sign < 0 else axis.nodes[::-1]  # type: ignore[index]
            found.append((Frame(np.eye(4), nodes, axis.spacing), float(on.sum() / len(cloud))))
    if not found:
        few = f"neither side of the path has a wall with {tuning.least_share:.0%} of the points"
        raise _refused(few, "products.make = auto finds planes")
    return sorted(found, key=lambda f: -f[1])


def _refused(what: str, remedy: str) -> ReconstructionError:
    return ReconstructionError(f"nothing can be unrolled: {what}; {remedy}, or leave out products.unroll")


def _share(on: np.ndarray, tuning: ChooseTuning, said: str) -> float:
    """Of the points on a surface, if that is enough."""
    share = float(np.mean(on)) if len(on) else 0.0
    if share <= tuning.least_share:
        few = f"{said} has {share:.1%} of the points, not more than {tuning.least_share:.0%}"
        raise _refused(few, "products.make = auto finds planes")
    return share


def _facing(axis: Frame, s: np.ndarray, normal: np.ndarray, sign: int, tuning: ChooseTuning) -> np.ndarray:
    """Which points at s (N,) have normals (N, 3) to a side of the axis."""
    side = axis.axis(s)[1][:, 1]
    return sign * np.sum(normal * side, axis=1) > np.cos(np.radians(tuning.upright_deg))


def _along(path: np.ndarray, away: float, spacing: float, radius: float = np.inf) -> Frame:
    """The alignment of a path whose surface is so far away, straight on by that at both ends; of one turn at most."""
    extent = float(np.linalg.norm(np.ptp(path, axis=0)))
    if not extent > away / 2:
        short = f"the path of the cameras extends over {extent:.3g}, and the surface is {away:.3g} away from it"
        raise _refused(short, "a longer path is needed")
    kept = [0]
    for k, place in enumerate(path):  # without standstills, whose noise would count as length
        if np.linalg.norm(place - path[kept[-1]]) > away / 4:
            kept.append(k)
    places = path[kept]
    step = np.diff(places, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    if np.isinf(radius):  # a second turn round a tower sees the same wall
        places = places[: 1 + np.count_nonzero(np.maximum.accumulate(np.abs(heading - heading[0])) < 2 * np.pi)]
    near = cKDTree(places).query_pairs(away, output_type="ndarray")
    back = near[np.ptp(near, axis=1) * float(np.median(np.linalg.norm(step, axis=1))) > 2 * np.pi * away]
    back = back if np.isfinite(radius) else back[step[np.minimum(back, len(step) - 1)].prod(axis=1).sum(axis=1) < 0]
    if len(back):
        twice = f"the path comes back to itself: it passes {np.round(places[back[0, 0]], 1).tolist()} twice"
        raise _refused(twice, "put each pass into a folder of its own")
    first, last = (away * v / np.linalg.norm(v) for v in (places[1] - places[0], places[-1] - places[-2]))
    axis = _polyline(np.r_[[places[0] - first], places, [places[-1] + last]], radius)
    axis = _fitted(axis, spacing, places, lambda x, y, _: np.r_[x, y], radius)
    off = float(np.linalg.norm(axis.across(places)[:, 1:], axis=1).max())
    if off > away / 2:
        raise _refused(
            f"the path leaves its smooth axis by {off:.3g}, as it bends within less than {spacing:.3g}",
            "make the survey of its straighter parts",
        )
    return axis


def _polyline(places: np.ndarray, radius: float = np.inf) -> Frame:
    """A frame whose axis goes through places (N, 3)."""
    s = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))]
    at = np.linspace(0, s[-1], max(4, 2 * len(s)))
    nodes = np.stack([np.interp(at, s, x) for x in places.T], axis=1)
    return Frame(np.eye(4), nodes, spacing=at[1], radius=radius)


def _covered(axis: Frame, s: np.ndarray) -> Frame:
    """The part of an axis along which points lie, by their s; round a tower once at most."""
    if not len(s):
        return axis
    first, last = np.clip(np.quantile(s, [_ENDS, 1 - _ENDS]), 0, axis.stations[-1])
    if not axis.tube:
        t = axis.axis(np.linspace(first, last, 4 * len(axis.stations)))[1][:, 0]
        heading = np.unwrap(np.arctan2(t[:, 1], t[:, 0]))
        cut = max(0.0, 1 - 2 * np.pi / max(abs(heading[-1] - heading[0]), 1e-9)) * (last - first) / 2
        first, last = first + cut, last - cut
    at = np.linspace(first, last, max(4, len(axis.stations)))
    return Frame(np.eye(4), axis.axis(at)[0], spacing=at[1] - at[0], radius=axis.radius)


def _fitted(axis: Frame, spacing: float, xyz: np.ndarray, residual: Residual, radius: float) -> Frame:
    """The alignment that fits points (N, 3), begun at an axis; its pieces are about ``spacing`` long. One whose
    ``radius`` is infinite is level."""
    nodes = axis.nodes
    assert nodes is not None
    length, level = axis.stations[-1], np.isinf(radius)
    knots = np.linspace(0, length, 1 + int(np.clip(round(length / spacing), 1, _MOST_PIECES)))
    grid = np.linspace(0, length, 1 + _NODES * (len(knots) - 1))
    hats = make_interp_spline(knots, np.eye(len(knots)), k=1)
    ramps = hats.antiderivative()
    count, on_grid = len(knots), (ramps(grid), hats(grid))

    def placed(p: np.ndarray) -> np.ndarray:
        """(M, 3) the axis on the grid by start (3,), radius, heading, curvatures and slopes at the knots."""
        heading, slope = p[4] + on_grid[0] @ p[5 : 5 + count], on_grid[1] @ p[5 + count :]
        t = np.stack([np.cos(slope) * np.cos(heading), np.cos(slope) * np.sin(heading), np.sin(slope)], axis=-1)
        return p[:3] + CubicSpline(grid, t).antiderivative()(grid)

    step, middle = np.diff(nodes, axis=0), (axis.stations[:-1] + axis.stations[1:]) / 2
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    slope = np.arctan2(step[:, 2], np.hypot(step[:, 0], step[:, 1]))
    turns = np.linalg.lstsq(np.c_[np.ones(len(middle)), ramps(middle)], heading, rcond=None)[0]
    slopes = np.linalg.lstsq(hats(middle), slope, rcond=None)[0]
    found = np.r_[nodes[0], 0.0 if level else radius, turns, slopes]
    free = np.ones(len(found), bool)
    if level:
        free[[2, 3]] = free[5 + count :] = False
    for _ in range(_REFITTED):
        s = axis.across(xyz)[:, 0]
        use = (s >= 0) & (s <= length)
        frames, ahead = axis.axis(s[use])[1], axis.axis(np.zeros(1))[1][0, 0]
        start = found[:3].copy()

        def off(p: np.ndarray) -> np.ndarray:
            whole = found.copy()
            whole[free] = p
            d = xyz[use] - CubicSpline(grid, placed(whole))(s[use])  # noqa: B023
            _, x, y = np.einsum("nij,nj->in", frames, d)  # noqa: B023
            slid = ahead @ (whole[:3] - start)  # noqa: B023 along itself, which no distance tells
            stiff = np.diff(whole[5:].reshape(2, count)) * [[spacing**2], [spacing]]
            return np.r_[residual(x, y, whole[3]), slid, _STIFF * stiff.ravel()]

        scale = 1.4826 * float(np.median(np.abs(off(found[free])))) + 1e-6 * spacing
        found[free] = least_squares(off, found[free], loss="cauchy", f_scale=scale, x_scale="jac", max_nfev=20).x
        axis = Frame(np.eye(4), placed(found), spacing=grid[1], radius=np.inf if level else float(found[3]))
    return axis
