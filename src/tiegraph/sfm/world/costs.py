"""Own residuals for COLMAP's Ceres problem: positions with lever arm and clock, priors of vectors, lengths, an upright.

pycolmap hands out its problem and its own cost functions; the classes to extend them are in the package pyceres. Python
residuals need the interpreter's lock, so such a problem is solved with one thread (more wait for each other for ever).
Jacobians are analytic and tested against differences. A pose block is COLMAP's Rigid3d: quaternion x y z w of
frame_from_world and its translation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tiegraph.geometry.transforms import skew

pyceres: Any
try:
    import pyceres
except ImportError:  # the adjustment then says what to install
    pyceres = None

_Base: Any = object if pyceres is None else pyceres.CostFunction


def back_rotated(pose: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R^T (point - t) of a pose block (7,), its Jacobian to the block (3, 7) and R^T (3, 3).

    With the quaternion (u, w): R^T v = v - 2 w u x v + 2 u x (u x v). Off the unit sphere the formula goes on as it is;
    the solver only uses directions along it.
    """
    u, w, v = pose[:3], pose[3], point - pose[4:]
    cross = np.cross(u, v)
    place = v - 2 * w * cross + 2 * np.cross(u, cross)
    skew_u, skew_v = skew(np.array([u, v]))
    inverse = np.eye(3) - 2 * w * skew_u + 2 * skew_u @ skew_u
    by_u = 2 * w * skew_v + 2 * ((u @ v) * np.eye(3) + np.outer(u, v) - 2 * np.outer(v, u))
    return place, np.hstack([by_u, -2 * cross[:, None], -inverse]), inverse


class PositionCost(_Base):
    """Weighted sum of the antenna's places at some frames minus a measured position, over its sigma.

    r = sum_i (w_i + dt w'_i) R_i^T (l_i - t_i) - p, with l_i the lever arm in the model's frame of frame i: rotation
    and shift (``frame_from_rig``) take it there from the scene's rig frame. Blocks: poses (7 each), arm (3), clock (1).
    """

    def __init__(
        self,
        weights: np.ndarray,
        rates: np.ndarray,
        frame_from_rig: np.ndarray,
        position: np.ndarray,
        sigma: np.ndarray,
    ) -> None:
        super().__init__()
        self.weights, self.rates, self.turn = weights, rates, frame_from_rig
        self.position, self.weight = position, 1 / np.asarray(sigma, float)
        if pyceres is not None:
            self.set_num_residuals(3)
            self.set_parameter_block_sizes([7] * len(weights) + [3, 1])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobians; a Jacobian is None where its block is constant."""
        count = len(self.weights)
        arm, clock = np.asarray(parameters[count]), float(parameters[count + 1][0])
        total, speed, by_arm = np.zeros(3), np.zeros(3), np.zeros((3, 3))
        for k in range(count):
            weight = self.weights[k] + clock * self.rates[k]
            point = self.turn[k, :3, :3] @ arm + self.turn[k, :3, 3]
            place, by_pose, inverse = back_rotated(np.asarray(parameters[k]), point)
            total += weight * place
            speed += self.rates[k] * place
            by_arm += weight * inverse @ self.turn[k, :3, :3]
            if jacobians is not None and jacobians[k] is not None:
                jacobians[k][:] = (self.weight[:, None] * weight * by_pose).ravel()
        residuals[:] = self.weight * (total - self.position)
        if jacobians is not None and jacobians[count] is not None:
            jacobians[count][:] = (self.weight[:, None] * by_arm).ravel()
        if jacobians is not None and jacobians[count + 1] is not None:
            jacobians[count + 1][:] = self.weight * speed
        return True


class PriorCost(_Base):
    """A vector block minus its prior value, over its sigma."""

    def __init__(self, value: np.ndarray, sigma: np.ndarray) -> None:
        super().__init__()
        self.value, self.weight = np.array(value, float), 1 / np.broadcast_to(np.asarray(sigma, float), np.shape(value))
        if pyceres is not None:
            self.set_num_residuals(len(self.value))
            self.set_parameter_block_sizes([len(self.value)])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobian."""
        residuals[:] = self.weight * (parameters[0] - self.value)
        if jacobians is not None and jacobians[0] is not None:
            jacobians[0][:] = np.diag(self.weight).ravel()
        return True


class ZeroCost(_Base):
    """Nothing, of two residuals like a sighting: to Ceres its blocks (of these sizes) are neighbours all the same."""

    def __init__(self, sizes: Sequence[int]) -> None:
        super().__init__()
        self.sizes = list(sizes)
        if pyceres is not None:
            self.set_num_residuals(2)
            self.set_parameter_block_sizes(self.sizes)

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Zeros."""
        residuals[:] = 0.0
        for jacobian in jacobians or ():
            if jacobian is not None:
                jacobian[:] = 0.0
        return True


class LengthCost(_Base):
    """The distance of two points minus its measured length, over its sigma. Blocks: the points (3 each)."""

    def __init__(self, length: float, sigma: float) -> None:
        super().__init__()
        self.length, self.sigma = length, sigma
        if pyceres is not None:
            self.set_num_residuals(1)
            self.set_parameter_block_sizes([3, 3])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobians."""
        way = np.asarray(parameters[0]) - np.asarray(parameters[1])
        distance = float(np.linalg.norm(way))
        residuals[:] = (distance - self.length) / self.sigma
        for k, sign in enumerate((1.0, -1.0)):
            if jacobians is not None and jacobians[k] is not None:
                jacobians[k][:] = sign * way / (max(distance, 1e-12) * self.sigma)
        return True


class UpCost(_Base):
    """The vertical must stay where it was in a frame: components (rows of ``axes``) of R^T u, over one sigma (rad).

    ``up`` (3,) is the upward direction in the frame; ``axes`` (n, 3) are horizontal directions of the world along which
    it must not lean.
    """

    def __init__(self, up: np.ndarray, axes: np.ndarray, sigma: float) -> None:
        super().__init__()
        self.up, self.axes, self.sigma = up, np.atleast_2d(axes), sigma
        if pyceres is not None:
            self.set_num_residuals(len(self.axes))
            self.set_parameter_block_sizes([7])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobian."""
        pose = np.array(parameters[0])
        pose[4:] = 0.0  # a direction: the translation does not act
        place, by_pose, _ = back_rotated(pose, self.up)
        residuals[:] = self.axes @ place / self.sigma
        if jacobians is not None and jacobians[0] is not None:
            by_pose[:, 4:] = 0.0
            jacobians[0][:] = (self.axes @ by_pose / self.sigma).ravel()
        return True
