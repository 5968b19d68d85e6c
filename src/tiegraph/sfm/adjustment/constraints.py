"""What is known with a sigma of poses and rigs, as residuals beside the reprojection errors in Ceres' problem (paper
001: fixed baselines and axes)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyceres
import pycolmap
import pycolmap.cost_functions
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import matrix, rigid3d
from tiegraph.scene.rig import Rig, SensorPair
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment import lens, leverarmprior
from tiegraph.sfm.adjustment.leverarmprior import NominalGeometry
from tiegraph.sfm.tuning import AdjustTuning
from tiegraph.sfm.tuning.rig import RigTuning


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


NOTHING = PoseConstraints()
_EXACT = (1e-4, 1e-3)  # m, deg: a sigma of 0 means "exactly"; these are the smallest that the solver can handle


def add_priors(
    adjuster: Any,
    model: pycolmap.Reconstruction,
    soft: PoseConstraints,
    tuning: AdjustTuning,
    given: Mapping[int, pycolmap.Camera] | None = None,
) -> list[Any]:
    """Add the priors of poses, of the lenses and of the rig's shape to the problem of an adjuster over ``model``; keep
    the returned objects until it is solved.

    The reprojection errors are in pixels and not divided by their sigma. To have the right weight relative to them,
    the priors are multiplied by that sigma, ``robust_px``. ``given``: as in ``lens.add_priors``.
    """
    problem, robust_px = adjuster.problem, tuning.robust_px
    costs, kept = pycolmap.cost_functions, []

    def add(cost: Any, *blocks: np.ndarray | None) -> None:
        unknown = [b for b in blocks if b is not None]
        there = all(problem.has_parameter_block(b) for b in unknown)
        if there and not all(problem.is_parameter_block_constant(b) for b in unknown):  # see ``leverarmprior``
            problem.add_residual_block(cost, None, unknown)
            kept.append(cost)

    for tie in soft.relative_poses:
        cost = costs.RelativePosePriorCost(tie.covariance / robust_px**2, rigid3d(tie.second_from_first))
        add(cost, _pose(model, tie.second), _pose(model, tie.first))
    for prior in soft.sensors:
        cost = costs.AbsolutePosePriorCost(prior.covariance / robust_px**2, rigid3d(prior.sensor_from_rig))
        add(cost, _extrinsics(model, prior.rig_id, prior.camera_id))
    for known in soft.places:
        cost = costs.AbsolutePosePositionPriorCost(np.diag((known.sigma / robust_px) ** 2), known.place)
        add(cost, _pose(model, known.image))
    for pair in soft.pairs:
        found = [_extrinsics(model, pair.rig_id, c) for c in pair.cameras]
        add(_PairCost(pair, [b is not None for b in found], robust_px), *found)
    kept += lens.add_priors(problem, model, given or {}, tuning)
    return kept + leverarmprior.add_priors(problem, model, soft.nominal, tuning)


def _pose(model: pycolmap.Reconstruction, image_id: int) -> np.ndarray:
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


class _PairCost(pyceres.CostFunction):  # type: ignore[misc, name-defined]
    """Paper 001's constraint as a Ceres cost; a reference sensor is not ``free`` and has no block. Derivatives are
    numeric: there are few."""

    def __init__(self, pair: PairPrior, free: Sequence[bool], weight: float) -> None:
        super().__init__()
        self.pair, self.free, self.weight = pair, free, weight
        self.set_num_residuals(2)
        self.set_parameter_block_sizes([7] * sum(free))

    def _sigmas(self, flat: np.ndarray) -> np.ndarray:
        given = iter(flat.reshape(-1, 7))
        first, second = (next(given) if f else _IDENTITY for f in self.free)
        return pair_residuals(first, second, self.pair)

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residuals and their central differences; a Jacobian is None where its block is constant."""
        at = np.concatenate([np.array(p) for p in parameters])
        residuals[:] = self.weight * self._sigmas(at)
        if jacobians is not None:
            steps = _STEP * np.eye(len(at))
            slopes = np.stack([(self._sigmas(at + s) - self._sigmas(at - s)) / (2 * _STEP) for s in steps], axis=1)
            for k, jacobian in enumerate(jacobians):
                if jacobian is not None:
                    jacobian[:] = self.weight * slopes[:, 7 * k : 7 * k + 7].ravel()
        return True


def rig_priors(
    model: pycolmap.Reconstruction, scene: Scene, rigs: Collection[int], tuning: RigTuning
) -> PoseConstraints:
    """Priors of the rigs (scene indices) of a metric model, and of nominal rigs of any model.

    Sensors without a sigma in a rig where others have one stay as given.
    """
    sensors: list[SensorPrior] = []
    pairs: list[PairPrior] = []
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        if index in rigs and index + 1 in model.rigs:
            sigma = [[s.sigma_m or 0.0, s.sigma_deg or 0.0] for s in rig.sensors]
            if not any(s.soft() for s in rig.sensors[1:]):
                sigma = [[tuning.prior_test.freed_m, tuning.prior_test.freed_deg]] * len(rig.sensors)
            sensors += sensor_priors(model.rigs[index + 1], rig, first, np.maximum(sigma, _EXACT))
            pairs += [_pair(pair, rig, index + 1, first) for pair in rig.pairs]
    return PoseConstraints(sensors=sensors, pairs=pairs, nominal=nominal_geometry(model, scene))


def sensor_priors(row: pycolmap.Rig, rig: Rig, first: int, sigma: np.ndarray) -> list[SensorPrior]:
    """The extrinsics of a rig, relative to the reference of the model's rig ``row``, with sigmas (S, 2) of places
    (lengths of ``rig``) and rotations (deg); ``first``: key of its first sensor."""
    reference = row.ref_sensor_id.id - 1 - first
    base = rig.sensors[reference].sensor_from_rig
    return [
        SensorPrior(
            rig_id=row.rig_id,
            camera_id=first + k + 1,
            sensor_from_rig=sensor.sensor_from_rig @ transforms.invert(base),
            covariance=_covariance(*sigma[k].tolist()),
        )
        for k, sensor in enumerate(rig.sensors)
        if k != reference and sensor.sensor_from_rig is not None and base is not None
    ]


def _covariance(shift: float, turn_deg: float) -> np.ndarray:
    """(6, 6) of a pose: rotation vector, translation."""
    return np.diag(np.repeat([np.radians(turn_deg), shift], 3) ** 2)


def of_one_shot(model: pycolmap.Reconstruction, scene: Scene, tuning: RigTuning) -> tuple[RelativePosePrior, ...]:
    """Constraints between the images of one frame of the scene that are separate frames of a metric model.

    Cameras that fire at different times are at the place the motion had reached when they fired. Bending the path
    over its length changes nothing there. Without this constraint an adjustment with positions took PandaSet, whose
    back camera shares few points with the others, from 22 to 59 mm.
    """
    covariance = _covariance(tuning.prior_test.given_m, tuning.prior_test.given_deg)
    first: dict[int, int] = {}
    tied: dict[int, RelativePosePrior] = {}
    for index in np.argsort(scene.sensor, kind="stable"):
        image = model.find_image_with_name(scene.names[index])
        if image is None or not image.has_pose or image.frame_id in tied:
            continue
        reference = model.image(first.setdefault(int(scene.frame[index]), image.image_id))
        if reference.frame_id != image.frame_id:
            poses = (model.frame(i.frame_id).rig_from_world for i in (reference, image))
            a, b = (matrix(p) for p in poses if p is not None)
            tied[image.frame_id] = RelativePosePrior(
                first=reference.image_id,
                second=image.image_id,
                second_from_first=b @ transforms.invert(a),
                covariance=covariance,
            )
    return tuple(tied.values())


def nominal_geometry(model: pycolmap.Reconstruction, scene: Scene) -> dict[int, NominalGeometry]:
    """Centres of the cameras of nominal rigs, by rig id and camera id, in the frame of the model's reference, metres.

    Of derived rigs there are none: a lever arm of a rough model, taken for a drawing, held the up camera of canal_demo
    60 mm from its place and the others 20 mm; without it 9 mm.
    """
    out: dict[int, NominalGeometry] = {}
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        if rig.nominal and not rig.derived and index + 1 in model.rigs:
            reference = rig.sensors[model.rigs[index + 1].ref_sensor_id.id - 1 - first].sensor_from_rig
            out[index + 1] = {
                first + k + 1: transforms.centre(s.sensor_from_rig @ transforms.invert(reference))
                for k, s in enumerate(rig.sensors)
                if s.sensor_from_rig is not None and reference is not None
            }
    return out


def _pair(pair: SensorPair, rig: Rig, rig_id: int, first: int) -> PairPrior:
    a, b = (first + rig.index(name) + 1 for name in pair.sensors)
    return PairPrior(
        rig_id=rig_id,
        cameras=(a, b),
        length=pair.baseline_m,
        length_sigma=max(pair.baseline_sigma_m or 0.0, _EXACT[0]),
        angle_rad=None if pair.axis_deg is None else float(np.radians(pair.axis_deg)),
        angle_sigma_rad=float(np.radians(max(pair.axis_sigma_deg or 0.0, _EXACT[1]))),
    )
