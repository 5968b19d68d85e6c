"""The frame of a reference surface: from the world to (u, v, w) and back.

A frame is rigid, or it unrolls a profile, straight or a circle of radius R, that is swept along an axis c(s), a cubic
spline through nodes at equal distances, so that s is its arc length. Across the tangent t lie ``side`` = t x z, to the
right, and ``up`` = side x t: unlike a frame without torsion (Bishop 1975) this one keeps the crown above on ramps. A
point p belongs to the nearest place of the axis, (p - c(s)) . t(s) = 0, and has x = (p - c) . side, y = (p - c) . up.

    straight:  u = s,  v = y,                  w = x               a vertical surface along a curve in plan, on z = 0
    circle:    u = s,  v = R atan2(x, y),      w = R - |(x, y)|    a tube; v counts from the crown

(u, v, w) is right-handed: whoever w points to sees u grow to the right and v upwards. What has the length 1 along u
is 1 - k . (p - c) long in the world, with the curvature k = c''; what has it along v is 1 - w / R long on a tube.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms

_STEPS = 4  # of Newton's method to the nearest place of the axis
_BETWEEN = 8  # places of the axis between two nodes, at which that begins


@dataclass(frozen=True, eq=False)
class Frame:
    """A rigid frame (4, 4) surface_from_world; or nodes (N, 3) of an axis in the world, ``spacing`` apart along it, and
    the radius of the tube round it, infinite for a straight profile: then the matrix applies to what is unrolled."""

    surface_from_world: np.ndarray
    nodes: np.ndarray | None = None
    spacing: float = 0.0
    radius: float = np.inf

    @property
    def tube(self) -> bool:
        """Whether the profile is a circle."""
        return bool(np.isfinite(self.radius))

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
                xyz = np.stack([s, self.radius * np.arctan2(x, y), self.radius - np.hypot(x, y)], axis=-1)
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
            x, y = (self.radius - x) * np.sin(y / self.radius), (self.radius - x) * np.cos(y / self.radius)
        return c + x[..., None] * axes[..., 1, :] + y[..., None] * axes[..., 2, :]

    def gradients(self, u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """(..., 3, 3) rows: the gradients of u, v and w in the world at places (...), that of w of length 1. The roll
        of a tube's frame where a ramp bends is left out."""
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
        sine, cosine = (f(v / self.radius)[..., None] for f in (np.sin, np.cos))
        out, round_ = sine * out + cosine * round_, cosine * out - sine * round_
        r = np.maximum(self.radius - w, 1e-9 * self.radius)
        along = t / (1 - r * np.sum(out * k, axis=-1))[..., None]
        return turn @ np.stack([along, round_ * (self.radius / r)[..., None], -out], axis=-2)
