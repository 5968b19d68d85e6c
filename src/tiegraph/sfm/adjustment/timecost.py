"""Ceres cost of a camera that fires at its own time: one offset a camera, shared by all frames of a rig that moves.

A tie says where the second image of a frame stands against the first: by the extrinsics, moved by offset x motion of
the frame, and by a constant error of the mounting. Offset and constant are unknowns of the adjustment.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pyceres
import pycolmap
import pycolmap.cost_functions
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.sfm.adjustment.costs import PriorCost

_STEPS = np.array([1e-5, *[1e-6] * 6])
_ASIDE = np.concatenate([np.zeros((1, 7)), np.diag(_STEPS), -np.diag(_STEPS)])


@dataclass(frozen=True)
class TimeOffsetPrior:
    """Image ``second`` of a frame against ``first``, a camera of the reference's time (COLMAP ids); model units."""

    first: int
    second: int
    sensor: int  # whose unknowns it is about
    sensor_from_first: np.ndarray  # (4, 4) extrinsics
    columns: np.ndarray  # (6,) place (model units) and attitude (rad) a second, in the frame of ``first``
    covariance: np.ndarray  # (6, 6) of a small change from the left: rotation vector, translation


@dataclass(frozen=True)
class TimeOffsetPriors:
    """Ties and, by sensor, unknowns (7,): offset in s, constant place (model units), turn (rad), frame of ``first``."""

    priors: Sequence[TimeOffsetPrior]
    unknowns: dict[int, np.ndarray]  # changed by the adjustment
    sigma: np.ndarray  # (7,) of what is expected of them: zero


def expected(tie: TimeOffsetPrior, unknowns: np.ndarray) -> np.ndarray:
    """second_from_first (4, 4) of a tie under unknowns (7,)."""
    return _expected(tie.sensor_from_first, tie.columns, unknowns)


def _expected(sensor_from_first: np.ndarray, columns: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """second_from_first (..., 4, 4) of extrinsics (..., 4, 4), motions (..., 6) and unknowns (..., 7)."""
    moved = unknowns[..., :1] * columns
    later = transforms.rigid(_turns(moved[..., 3:]), moved[..., :3])
    # The constant turns the camera about its own centre.
    turn, lever = _turns(unknowns[..., 4:]), transforms.centre(sensor_from_first)
    mounting = transforms.rigid(turn, unknowns[..., 1:4] + lever - np.einsum("...ij,...j->...i", turn, lever))
    return sensor_from_first @ transforms.invert(later @ mounting)


def _turns(vectors: np.ndarray) -> np.ndarray:
    """(..., 3, 3) of rotation vectors (..., 3), rad."""
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(*vectors.shape, 3)


class TiesOfOne:
    """The ties of one camera: they share its unknowns, and Ceres asks one after another at the same ones.

    All are worked out at the first question, for scipy's calls take longer than what they calculate.
    """

    def __init__(self, ties: Sequence[TimeOffsetPrior]) -> None:
        self._sensor_from_first = np.stack([tie.sensor_from_first for tie in ties])[:, None]
        self._columns = np.stack([tie.columns for tie in ties])[:, None]
        self._asked: tuple[bytes, int] | None = None
        self._quaternions = self._places = np.zeros(0)

    def at(self, tie: int, unknowns: np.ndarray) -> list[pycolmap.Rigid3d]:
        """second_from_first of one tie under unknowns (K, 7), the same for all."""
        asked = unknowns.tobytes(), len(unknowns)
        if asked != self._asked:
            poses = _expected(self._sensor_from_first, self._columns, unknowns)
            turns = transforms.quaternion_xyzw(poses[..., :3, :3].reshape(-1, 3, 3))
            self._quaternions, self._places = turns.reshape(*poses.shape[:2], 4), poses[..., :3, 3]
            self._asked = asked
        both = zip(self._quaternions[tie], self._places[tie])
        return [pycolmap.Rigid3d(pycolmap.Rotation3d(q), t) for q, t in both]


def pose_block(model: pycolmap.Reconstruction, image_id: int) -> np.ndarray:
    """The memory (7,) of the pose of an image's frame, as Ceres knows it."""
    pose = model.frame(model.image(image_id).frame_id).rig_from_world
    assert pose is not None
    return np.asarray(pose.params)


def add_time_offsets(problem: Any, model: pycolmap.Reconstruction, timed: TimeOffsetPriors, weight: float) -> list[Any]:
    """Add the ties and what is expected of their unknowns; ``weight`` times each residual. Keep what is returned."""
    costs: list[Any] = []
    of_one: dict[int, list[TimeOffsetPrior]] = {}
    for tie in timed.priors:
        of_one.setdefault(tie.sensor, []).append(tie)
    together = {sensor: TiesOfOne(ties) for sensor, ties in of_one.items()}
    numbers = {sensor: itertools.count() for sensor in of_one}
    for tie in timed.priors:
        at = partial(together[tie.sensor].at, next(numbers[tie.sensor]))
        blocks = [pose_block(model, i) for i in (tie.second, tie.first)]
        if all(problem.has_parameter_block(b) for b in blocks):
            costs.append(_tie_cost(at, tie.covariance, weight))
            problem.add_residual_block(costs[-1], None, [*blocks, timed.unknowns[tie.sensor]])
    for unknowns in timed.unknowns.values():
        if problem.has_parameter_block(unknowns):
            costs.append(PriorCost(np.zeros(7), timed.sigma / weight))
            problem.add_residual_block(costs[-1], None, [unknowns])
    return costs


def _tie_cost(at: Callable[[np.ndarray], list[pycolmap.Rigid3d]], covariance: np.ndarray, weight: float) -> Any:
    """The cost of one tie; ``at``: second_from_first by unknowns (K, 7)."""
    covariance = covariance / weight**2

    class TieCost(pyceres.CostFunction):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(6)
            self.set_parameter_block_sizes([7, 7, 7])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            second, first, unknowns = (np.array(p) for p in parameters)
            slope = jacobians is not None and jacobians[2] is not None

            def against(prior: pycolmap.Rigid3d) -> tuple[np.ndarray, list[np.ndarray]]:
                cost = pycolmap.cost_functions.RelativePosePriorCost(covariance, prior)
                value, slopes = cost.evaluate(second, first)
                return np.asarray(value).ravel(), slopes

            here, *beside = at(unknowns + _ASIDE if slope else unknowns[None])
            value, slopes = against(here)
            residuals[:] = value
            if jacobians is not None:
                for block in (0, 1):
                    if jacobians[block] is not None:
                        jacobians[block][:] = np.asarray(slopes[block]).ravel()
                if slope:
                    up, down = np.array([against(prior)[0] for prior in beside]).reshape(2, 7, 6)
                    jacobians[2][:] = ((up - down) / (2 * _STEPS[:, None])).T.ravel()
            return True

    return TieCost()
