"""Poses that are known with a sigma, as residuals beside the reprojection errors in Ceres' problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyceres
import pycolmap
import pycolmap.cost_functions
from scipy.spatial.transform import Rotation

from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.sfm.adjustment import lens, leverarmprior
from tiegraph.sfm.adjustment.leverarmprior import NominalGeometry
from tiegraph.sfm.tuning import AdjustTuning


@dataclass(frozen=True)
class RelativePosePrior:
    """Image ``second`` relative to ``first`` (COLMAP image ids, each in a frame of its own): relative pose and
    covariance."""

    first: int
    second: int
    second_from_first: np.ndarray  # (4, 4) model units
    covariance: np.ndarray  # (6, 6) of a small change from the left: rotation vector (rad), translation (model units)


@dataclass(frozen=True)
class SensorPrior:
    """Extrinsics of a sensor of a rig: sensor_from_rig (4, 4) in model units, covariance as of
    ``RelativePosePrior``."""

    rig_id: int
    camera_id: int
    sensor_from_rig: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class PairPrior:
    """Two sensors of a rig: the length of their baseline and the angle between their axes; None = not known."""

    rig_id: int
    cameras: tuple[int, int]
    length: float | None = None  # model units
    length_sigma: float = 0.0
    angle_rad: float | None = None
    angle_sigma_rad: float = 0.0


@dataclass(frozen=True)
class PlacePrior:
    """The place of the frame of an image (COLMAP id): ``place`` (3,) and sigmas (3,) along the axes, model units."""

    image: int
    place: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True)
class PoseConstraints:
    """All priors with a sigma of one adjustment; true in a boolean context if one of them is a length.

    ``nominal``: geometry of nominal rigs by rig id (``leverarmprior``); it does not determine the scale.
    """

    relative_poses: Sequence[RelativePosePrior] = ()
    sensors: Sequence[SensorPrior] = ()
    pairs: Sequence[PairPrior] = ()
    places: Sequence[PlacePrior] = ()
    nominal: Mapping[int, NominalGeometry] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.relative_poses or self.sensors or self.pairs or self.places)


def add_priors(
    adjuster: Any,
    model: pycolmap.Reconstruction,
    soft: PoseConstraints | None,
    tuning: AdjustTuning,
    given: Mapping[int, pycolmap.Camera] | None = None,
) -> list[Any]:
    """Add the priors of the rig file, of the lenses and of the rig's shape; keep the returned objects until the
    problem is solved.

    ``given``: as in ``lens.add_priors``.
    """
    soft = PoseConstraints() if soft is None else soft
    kept = _add_constraints(adjuster, model, soft, tuning.robust_px)
    kept += lens.add_priors(adjuster.problem, model, given or {}, tuning)
    return kept + leverarmprior.add_priors(adjuster.problem, model, soft.nominal, tuning)


def _add_constraints(
    adjuster: Any, model: pycolmap.Reconstruction, soft: PoseConstraints, robust_px: float
) -> list[Any]:
    """Add the residuals to the problem of an adjuster over ``model``; keep the returned objects until it is solved.

    The reprojection errors are in pixels and not divided by their sigma. To have the right weight relative to them,
    the priors are multiplied by that sigma, ``robust_px``.
    """
    problem = adjuster.problem
    kept: list[Any] = []

    def add(cost: Any, *blocks: np.ndarray) -> None:
        there = all(problem.has_parameter_block(b) for b in blocks)
        if there and not all(problem.is_parameter_block_constant(b) for b in blocks):  # see ``leverarmprior``
            problem.add_residual_block(cost, None, list(blocks))
            kept.append(cost)

    for tie in soft.relative_poses:
        a, b = pose_block(model, tie.first), pose_block(model, tie.second)
        add(
            pycolmap.cost_functions.RelativePosePriorCost(
                tie.covariance / robust_px**2, rigid3d(tie.second_from_first)
            ),
            b,
            a,
        )
    for prior in soft.sensors:
        block = _extrinsics(model, prior.rig_id, prior.camera_id)
        if block is not None:
            covariance = prior.covariance / robust_px**2
            add(pycolmap.cost_functions.AbsolutePosePriorCost(covariance, rigid3d(prior.sensor_from_rig)), block)
    for known in soft.places:
        covariance = np.diag((known.sigma / robust_px) ** 2)
        cost = pycolmap.cost_functions.AbsolutePosePositionPriorCost(covariance, known.place)
        add(cost, pose_block(model, known.image))
    for pair in soft.pairs:
        found = [_extrinsics(model, pair.rig_id, c) for c in pair.cameras]
        blocks = [b for b in found if b is not None]
        if blocks:
            add(_pair_cost(pair, [b is not None for b in found], robust_px), *blocks)
    return kept


def pose_block(model: pycolmap.Reconstruction, image_id: int) -> np.ndarray:
    """The memory (7,) of the pose of an image's frame, as Ceres knows it."""
    pose = model.frame(model.image(image_id).frame_id).rig_from_world
    assert pose is not None
    return np.asarray(pose.params)


def _extrinsics(model: pycolmap.Reconstruction, rig_id: int, camera_id: int) -> np.ndarray | None:
    """The memory (7,) of a sensor's extrinsics in the model, None for a reference; pycolmap's accessor by id returns
    a copy."""
    for identity, pose in model.rigs[rig_id].non_ref_sensors.items() if rig_id in model.rigs else ():
        if identity.id == camera_id and pose is not None:
            return np.asarray(pose.params)
    return None


def pair_residuals(first: np.ndarray, second: np.ndarray, pair: PairPrior) -> np.ndarray:
    """(2,) baseline and axis angle of two poses (7: quaternion x y z w, translation) against the prior, in sigmas."""
    rotations = [Rotation.from_quat(p[:4]).as_matrix() for p in (first, second)]
    centres = [-r.T @ p[4:] for r, p in zip(rotations, (first, second))]
    out = np.zeros(2)
    if pair.length is not None:
        out[0] = (np.linalg.norm(centres[0] - centres[1]) - pair.length) / pair.length_sigma
    if pair.angle_rad is not None:
        a, b = rotations[0][2], rotations[1][2]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        out[1] = (angle - pair.angle_rad) / pair.angle_sigma_rad
    return out


_IDENTITY = np.array([0.0, 0, 0, 1, 0, 0, 0])
_STEP = 1e-7


def _pair_cost(pair: PairPrior, free: Sequence[bool], weight: float) -> Any:
    """Paper 001's constraint as a Ceres cost; the reference sensor has no block. Derivatives are numeric: there are
    few."""

    class PairCost(pyceres.CostFunction):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(2)
            self.set_parameter_block_sizes([7] * sum(free))

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            given = iter(np.array(p) for p in parameters)
            both = [next(given) if f else _IDENTITY for f in free]
            residuals[:] = weight * pair_residuals(both[0], both[1], pair)
            if jacobians is not None:
                for block, side in enumerate(k for k, f in enumerate(free) if f):
                    if jacobians[block] is not None:
                        jacobians[block][:] = weight * _differences(both, side, pair).ravel()
            return True

    return PairCost()


def _differences(both: Sequence[np.ndarray], side: int, pair: PairPrior) -> np.ndarray:
    out = np.zeros((2, 7))
    for k in range(7):
        ends = []
        for sign in (1.0, -1.0):
            moved = [b.copy() for b in both]
            moved[side][k] += sign * _STEP
            ends.append(pair_residuals(moved[0], moved[1], pair))
        out[:, k] = (ends[0] - ends[1]) / (2 * _STEP)
    return out
