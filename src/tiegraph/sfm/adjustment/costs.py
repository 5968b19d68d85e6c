"""Residuals written in Python for COLMAP's Ceres problem.

pycolmap hands out its problem and its own cost functions; the classes to extend them are in the package pyceres. Python
residuals need the interpreter's lock, so such a problem is solved with one thread (more wait for each other for ever).
"""

from collections.abc import Sequence

import numpy as np
import pyceres

from tiegraph.geometry.transforms import skew


class Cost(pyceres.CostFunction):  # type: ignore[misc, name-defined]
    """A residual of ours; ``_begin`` is the last that its constructor does."""

    def _begin(self, residuals: int, sizes: Sequence[int]) -> None:
        """Say how many residuals there are, over blocks of which sizes; and make the first call, asking for Jacobians.

        pyceres sets up its arrays at that call, and reads where the Jacobians go whether they are asked for or not.
        Ceres asks for none where all blocks are constant (a position of frames that see no point): it ended by SIGSEGV.
        """
        self.set_num_residuals(residuals)
        self.set_parameter_block_sizes(list(sizes))
        self.evaluate(*(np.zeros(size) for size in sizes))


def centres_of(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) centres -R^T t of pose blocks (N, 7), quaternion x y z w and translation, and (N, 3, 7) their Jacobians.

    With the quaternion (u, w): R^T v = v - 2 w u x v + 2 u x (u x v). Off the unit sphere the formula goes on as it is;
    the solver only uses directions along it.
    """
    u, w, v = poses[:, :3], poses[:, 3, None, None], -poses[:, 4:]
    across, unit = skew(u), np.eye(3)
    inverse = unit + 2 * (across - w * unit) @ across
    outer = u[:, :, None] * v[:, None, :]
    out = np.empty((len(poses), 3, 7))
    out[:, :, :3] = 2 * (w * skew(v) + np.sum(u * v, axis=1)[:, None, None] * unit + outer)
    out[:, :, :3] -= 4 * np.swapaxes(outer, 1, 2)
    out[:, :, 3] = 2 * (skew(v) @ u[:, :, None])[:, :, 0]
    out[:, :, 4:] = -inverse
    return (inverse @ v[:, :, None])[:, :, 0], out
