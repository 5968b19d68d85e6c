"""Own residuals for COLMAP's Ceres problem: positions with lever arm and clock, lengths, an upright.

Jacobians are analytic and tested against differences. A pose block is COLMAP's Rigid3d: quaternion x y z w of
frame_from_world and its translation.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tiegraph.geometry.transforms import skew
from tiegraph.sfm.adjustment.costs import Cost

_UNIT = np.eye(3)


def back_rotated(pose: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R^T (point - t) of pose blocks (..., 7) and points (..., 3), and R^T (..., 3, 3).

    With the quaternion (u, w): R^T v = v - 2 w u x v + 2 u x (u x v). Off the unit sphere the formula goes on as it is;
    the solver only uses directions along it.
    """
    across = skew(pose[..., :3])
    inverse = _UNIT + 2 * (across - pose[..., 3, None, None] * _UNIT) @ across
    return (inverse @ (point - pose[..., 4:])[..., None])[..., 0], inverse


def by_pose(pose: np.ndarray, point: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """(..., 3, 7) Jacobian of ``back_rotated`` to the blocks; ``inverse``: its R^T."""
    u, w, v = pose[..., :3], pose[..., 3, None, None], point - pose[..., 4:]
    across, outer = skew(v), u[..., :, None] * v[..., None, :]
    out = np.empty((*u.shape[:-1], 3, 7))
    out[..., :3] = 2 * (w * across + np.sum(u * v, axis=-1)[..., None, None] * _UNIT + outer)
    out[..., :3] -= 4 * np.swapaxes(outer, -1, -2)
    out[..., 3] = 2 * (across @ u[..., None])[..., 0]  # v x u
    out[..., 4:] = -inverse
    return out


class PositionCost(Cost):
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
        self._begin(3, [7] * len(weights) + [3, 1])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobians; a Jacobian is None where its block is constant."""
        count = len(self.weights)
        arm, clock = np.asarray(parameters[count]), float(parameters[count + 1][0])
        pose, turn = np.array(parameters[:count]), self.turn[:, :3, :3]
        point, weights = turn @ arm + self.turn[:, :3, 3], self.weights + clock * self.rates
        place, inverse = back_rotated(pose, point)
        residuals[:] = self.weight * (weights @ place - self.position)
        if jacobians is None:
            return True
        slopes = (weights[:, None, None] * self.weight[:, None]) * by_pose(pose, point, inverse)
        by_arm = self.weight[:, None] * np.tensordot(weights, inverse @ turn, axes=1)
        for jacobian, slope in zip(jacobians, (*slopes, by_arm, self.weight * (self.rates @ place))):
            if jacobian is not None:
                jacobian[:] = slope.ravel()
        return True


class ZeroCost(Cost):
    """Nothing, of two residuals like a sighting: to Ceres its blocks (of these sizes) are neighbours all the same."""

    def __init__(self, sizes: Sequence[int]) -> None:
        super().__init__()
        self._begin(2, sizes)

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Zeros."""
        residuals[:] = 0.0
        for jacobian in jacobians or ():
            if jacobian is not None:
                jacobian[:] = 0.0
        return True


class LengthCost(Cost):
    """The distance of two points minus its measured length, over its sigma. Blocks: the points (3 each)."""

    def __init__(self, length: float, sigma: float) -> None:
        super().__init__()
        self.length, self.sigma = length, sigma
        self._begin(1, [3, 3])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobians."""
        way = np.asarray(parameters[0]) - np.asarray(parameters[1])
        distance = float(np.linalg.norm(way))
        residuals[:] = (distance - self.length) / self.sigma
        for k, sign in enumerate((1.0, -1.0)):
            if jacobians is not None and jacobians[k] is not None:
                jacobians[k][:] = sign * way / (max(distance, 1e-12) * self.sigma)
        return True


class UpCost(Cost):
    """The vertical must stay where it was in a frame: components (rows of ``axes``) of R^T u, over one sigma (rad).

    ``up`` (3,) is the upward direction in the frame; ``axes`` (n, 3) are horizontal directions of the world along which
    it must not lean.
    """

    def __init__(self, up: np.ndarray, axes: np.ndarray, sigma: float) -> None:
        super().__init__()
        self.up, self.axes, self.sigma = up, np.atleast_2d(axes), sigma
        self._begin(len(self.axes), [7])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobian."""
        pose = np.array(parameters[0])
        pose[4:] = 0.0  # a direction: the translation does not act
        place, inverse = back_rotated(pose, self.up)
        residuals[:] = self.axes @ place / self.sigma
        if jacobians is not None and jacobians[0] is not None:
            slope = by_pose(pose, self.up, inverse)
            slope[:, 4:] = 0.0
            jacobians[0][:] = (self.axes @ slope / self.sigma).ravel()
        return True
