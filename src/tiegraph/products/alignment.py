"""Which curved surface fits the points of a survey: a tube round the path of its cameras, or a wall beside it.

The axis is an alignment as roads and railways have it: its curvature in plan, and of a tube its slope, are piecewise
linear in the arc length, so that it consists of straights, arcs, clothoids and vertical parabolas. The pieces are
several diameters or wall heights long. A shorter wave, a bulge or noise cannot be followed: it is a deviation.

Start, heading, curvatures, slopes and radius are fitted to the path first, then to the points: by least squares of the
distances at fixed nearest places of the axis, which are then taken anew (tangent distance minimisation, Wang, Pottmann
and Liu 2006, section 3), with Cauchy's loss, so that floors, doors and bulges count little.
"""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from tiegraph.errors import ReconstructionError
from tiegraph.products.frame import Frame
from tiegraph.products.tuning import ChooseTuning
from tiegraph.scene.results import Cloud

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


def tunnel(path: np.ndarray, cloud: Cloud, tuning: ChooseTuning) -> list[Found]:
    """The tube round a path (N, 3). Raises ReconstructionError for a path that is too short, without motion, or comes
    back to itself, for a bend tighter than the tube, and for too few points on it."""
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
    return [(axis, _share(on, tuning, f"the tube of radius {axis.radius:.3g} round the path"))]


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
