"""Sigmas and correlations of interiors and relative orientations.

The parameters: those of each camera in COLMAP's order, then of each camera but the first the projection centre in the
rig (m) and the turn about the camera's own axes (rad). Ceres' tangent of a pose is half the rotation vector from the
left, then the translation of sensor_from_rig (EigenQuaternionManifold); ``_lever`` makes centre and turn of it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from tiegraph.calibrate.adjust import Adjusted, State, build, problem
from tiegraph.calibrate.tuning import AdjustTuning
from tiegraph.geometry import transforms
from tiegraph.geometry.align import CAUCHY_SIGMAS
from tiegraph.geometry.transforms import skew

_POSE = 6


@dataclass(frozen=True)
class Parameter:
    """One unknown: camera's number, name with its unit, value."""

    camera: int
    name: str
    value: float


@dataclass(frozen=True)
class Precision:
    """Parameters (P) with sigmas (P,) and correlations (P, P). The unit of an angle is the degree."""

    parameters: tuple[Parameter, ...]
    sigma: np.ndarray
    correlation: np.ndarray

    def of(self, camera: int, *names: str) -> np.ndarray:
        """Sigmas of a camera's parameters of these names."""
        found = {p.name: s for p, s in zip(self.parameters, self.sigma) if p.camera == camera}
        return np.array([found[n] for n in names])


PLACE = ("x m", "y m", "z m")
TURN = ("turn x deg", "turn y deg", "turn z deg")


def precision(done: Adjusted, tuning: AdjustTuning) -> Precision:
    """Sigmas and correlations at the adjusted state, boards eliminated instant by instant."""
    normal, scatter, redundancy = _normal(done, tuning)
    root = np.sqrt(np.diag(normal) + 1e-300)
    # Of a parameter's own stiffness: one that no view holds gets a huge sigma, not a singular matrix
    inverse = np.linalg.inv(normal / np.outer(root, root) + 1e-14 * np.eye(len(root))) / np.outer(root, root)
    classical = done.sigma_px**2 * redundancy * inverse
    clustered = inverse @ scatter @ inverse
    lever = _lever(done.state)
    classical, clustered = (lever @ c @ lever.T for c in (classical, clustered))
    wider = np.sqrt(np.maximum(np.diag(clustered) / np.diag(classical), 1.0))
    sigma = wider * np.sqrt(np.diag(classical))
    correlation = classical / np.sqrt(np.outer(np.diag(classical), np.diag(classical)))
    return Precision(parameters(done.state), sigma, correlation)


def _normal(done: Adjusted, tuning: AdjustTuning) -> tuple[np.ndarray, np.ndarray, float]:
    """Normal matrix (P, P) of the shared parameters, scatter (P, P) of the instants' gradients, and by how much more
    observations than redundant ones there are."""
    import pyceres

    model = build(done.seen, done.state)
    adjuster = problem(model, tuning, max(CAUCHY_SIGMAS * done.sigma_px, tuning.least_scale_px))
    keep: list[Any] = [model.camera(k + 1) for k in range(len(done.state.cameras))]
    sensors: dict[Any, Any] = dict(model.rigs[1].non_ref_sensors.items())
    ordered = sorted(sensors, key=lambda s: s.id)
    frames: list[Any] = [model.frame(f).rig_from_world for f in sorted(model.reg_frame_ids())]
    blocks = [c.params for c in keep] + [sensors[s].params for s in ordered] + [f.params for f in frames]
    options = pyceres.EvaluateOptions()
    options.set_parameter_blocks([np.asarray(b) for b in blocks])
    rows, columns, values = adjuster.problem.evaluate_jacobian(options).to_tuple()
    residual = np.asarray(adjuster.problem.evaluate_residuals(options))
    jacobian = sparse.csr_matrix((values, (rows, columns)))
    shared = jacobian.shape[1] - _POSE * len(frames)
    normal, scatter = np.zeros((shared, shared)), np.zeros((shared, shared))
    for number in range(len(frames)):
        own = jacobian[:, shared + _POSE * number : shared + _POSE * (number + 1)]
        at = np.unique(own.nonzero()[0])
        basis, _ = np.linalg.qr(own[at].toarray())
        left = jacobian[at, :shared].toarray()
        left -= basis @ (basis.T @ left)
        gradient = left.T @ residual[at]
        normal += left.T @ left
        scatter += np.outer(gradient, gradient)
    count = len(residual)
    free = max(count - jacobian.shape[1], 1)
    clusters = len(frames) / max(len(frames) - 1, 1)
    return normal, clusters * scatter, count / free


def _lever(state: State) -> np.ndarray:
    """(P, P) from Ceres' tangents of all blocks to the parameters."""
    size = sum(len(c.params) for c in state.cameras)
    out = np.eye(size + _POSE * (len(state.cameras) - 1))
    for pose in state.sensor_from_rig[1:]:
        turn, place = pose[:3, :3].T, pose[:3, 3]
        block = np.zeros((_POSE, _POSE))
        block[:3, :3] = -2 * turn @ skew(place)
        block[:3, 3:] = -turn
        block[3:, :3] = np.degrees(2.0) * np.eye(3)
        out[size : size + _POSE, size : size + _POSE] = block
        size += _POSE
    return out


def parameters(state: State) -> tuple[Parameter, ...]:
    """Names and values of the unknowns, in their order."""
    out = []
    for number, camera in enumerate(state.cameras):
        names = [n.strip() for n in camera.params_info.split(",")]
        out += [Parameter(number, n, float(v)) for n, v in zip(names, camera.params)]
    for number, pose in enumerate(state.sensor_from_rig[1:], 1):
        turns = np.degrees(Rotation.from_matrix(pose[:3, :3].T).as_rotvec())
        values = (*transforms.centre(pose), *turns)
        out += [Parameter(number, n, float(v)) for n, v in zip((*PLACE, *TURN), values)]
    return tuple(out)
