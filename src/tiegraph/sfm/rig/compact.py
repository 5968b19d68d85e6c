"""What is expected of a rig before the images speak: its cameras look outwards from one body.

A camera that shares hardly a point with the others, the up camera of a boat, has its lever arm from a handful of
tracks: on canal from 16 of them, with a sigma of 44 mm in a rig of 60 mm. What the other cameras' places have in
common, a middle and a distance from it along their optical axes, is what is expected of it, with the spread that they
have around it (empirical Bayes: Efron and Morris 1975). A robust loss lets go of it where a camera stands apart, and
where the images tell the place they outweigh it.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
import pycolmap

from tiegraph.sfm.lens import SIGMA_PX, available
from tiegraph.sfm.model import rigid3d

LEAST_OTHERS = 4  # cameras whose places tell something: twelve coordinates for the four unknowns of the rule
UNEVEN = 1 / 3  # of the distance along the axis: no housing is a sphere
_ANY_RAD = 30.0  # nothing is expected of the turn
_CAUCHY = 2.0  # sigmas


def expected_centres(rig: pycolmap.Rig) -> dict[int, tuple[np.ndarray, float]]:
    """Camera id -> where the other cameras let expect its centre in the rig (3,), and sigma of each coordinate.

    In model units; not for the reference. Empty for rigs of fewer than five cameras and for those of one centre.
    """
    poses = {i.id: pose.inverse() for i, pose in rig.non_ref_sensors.items() if pose is not None}
    centres = np.array([np.zeros(3), *(p.translation for p in poses.values())])
    axes = np.array([[0.0, 0, 1], *(p.rotation.matrix()[:, 2] for p in poses.values())])
    out = {}
    for row, key in enumerate(poses, start=1) if len(poses) >= LEAST_OTHERS else ():
        others = np.arange(len(centres)) != row
        out[key] = _outward(centres[others], axes[others], axes[row])
    return {k: (centre, sigma) for k, (centre, sigma) in out.items() if sigma > 0}


def _outward(centres: np.ndarray, axes: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, float]:
    """Middle and distance along the axis that fit these cameras (N, 3) best, for a camera with another axis (3,)."""
    around, along = axes - axes.mean(axis=0), centres - centres.mean(axis=0)
    distance = max(float(np.sum(around * along) / max(np.sum(around**2), 1e-12)), 0.0)
    left = along - distance * around
    variance = float(np.sum(left**2)) / (left.size - 4) + (UNEVEN * distance) ** 2
    return centres.mean(axis=0) + distance * (axis - axes.mean(axis=0)), float(np.sqrt(variance))


def information(rig: pycolmap.Rig) -> dict[int, float]:
    """Camera id -> information of each coordinate of its centre that this expectation adds, 1 / model units squared."""
    centres = {i.id: pose.inverse().translation for i, pose in rig.non_ref_sensors.items() if pose is not None}
    out = {}
    for key, (expected, sigma) in expected_centres(rig).items():
        off = float(np.linalg.norm(centres[key] - expected)) / sigma
        out[key] = 1 / (1 + (off / _CAUCHY) ** 2) / sigma**2
    return out


def add_priors(problem: Any, model: pycolmap.Reconstruction, known: Collection[tuple[int, int]]) -> list[Any]:
    """Expect the free sensors of the problem near the others of their rig; keep what is returned until it has solved.

    ``known``: (rig id, camera id) of sensors of which more is known.
    """
    if not available():
        return []
    import pyceres
    import pycolmap.cost_functions

    kept: list[Any] = []
    for rig_id, rig in model.rigs.items():
        expected = expected_centres(rig)
        for identity, pose in rig.non_ref_sensors.items():
            if identity.id not in expected or (rig_id, identity.id) in known:
                continue
            block = pose.params
            if not problem.has_parameter_block(block) or problem.is_parameter_block_constant(block):
                continue
            centre, sigma = expected[identity.id]
            turn = pose.rotation.matrix()
            about = np.vstack([np.column_stack([turn, -turn @ centre]), [0.0, 0, 0, 1]])
            covariance = np.diag([_ANY_RAD**2] * 3 + [sigma**2] * 3) / SIGMA_PX**2
            cost = pycolmap.cost_functions.AbsolutePosePriorCost(covariance, rigid3d(about))
            loss = pyceres.CauchyLoss(_CAUCHY * SIGMA_PX)
            problem.add_residual_block(cost, loss, [block])
            kept += [cost, loss]
    return kept
