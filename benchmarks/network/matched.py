"""The covariance of positions by the normal equations of a model: a check of the program's own (tests/sfm)."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix

from tiegraph.sfm.adjustment.jacobians import Layout
from tiegraph.sfm.adjustment.normal import Normal


def positions_free_gauge(normal: csc_matrix, layout: Layout) -> np.ndarray:
    """Covariance (3F, 3F) of the positions by the normal matrix (C, C), with similarities of the whole taken out."""
    factor = Normal(normal, layout)
    at = np.arange(6 * len(layout.centres)).reshape(-1, 6)[:, :3].ravel()
    columns = csc_matrix((np.ones(len(at)), (at, np.arange(len(at)))), shape=(layout.size, len(at)))
    sides = factor.asked(columns)
    return np.asarray(sides.T @ factor.solve(sides))
