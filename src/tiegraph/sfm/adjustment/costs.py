"""Residuals written in Python for COLMAP's Ceres problem.

pycolmap hands out its problem and its own cost functions; the classes to extend them are in the package pyceres. Python
residuals need the interpreter's lock, so such a problem is solved with one thread (more wait for each other for ever).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyceres


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


class PriorCost(Cost):
    """A vector block minus its prior value, over its sigma."""

    def __init__(self, value: np.ndarray, sigma: np.ndarray) -> None:
        super().__init__()
        self.value, self.weight = np.array(value, float), 1 / np.broadcast_to(np.asarray(sigma, float), np.shape(value))
        self._begin(len(self.value), [len(self.value)])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobian."""
        residuals[:] = self.weight * (parameters[0] - self.value)
        if jacobians is not None and jacobians[0] is not None:
            jacobians[0][:] = np.diag(self.weight).ravel()
        return True
