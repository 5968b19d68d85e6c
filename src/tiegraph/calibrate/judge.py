"""How good a calibration is: sigmas, held-out instants, coverage of the images, what the views leave open, and advice.

The parameters: those of each camera in COLMAP's order, then of each camera but the first the projection centre in the
rig (m) and the turn about the camera's own axes (rad). Ceres' tangent of a pose is half the rotation vector from the
left, then the translation of sensor_from_rig (EigenQuaternionManifold); ``_lever`` makes centre and turn of it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from tiegraph.calibrate.adjust import (
    LEAST_SCALE_PX,
    Adjusted,
    State,
    adjust,
    build,
    place_boards,
    problem,
    view_residuals,
)
from tiegraph.calibrate.board import Observations
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import CAUCHY_SIGMAS, skew

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


def precision(done: Adjusted) -> Precision:
    """Sigmas and correlations at the adjusted state, boards eliminated instant by instant."""
    normal, scatter, redundancy = _normal(done)
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


def _normal(done: Adjusted) -> tuple[np.ndarray, np.ndarray, float]:
    """Normal matrix (P, P) of the shared parameters, scatter (P, P) of the instants' gradients, and by how much more
    observations than redundant ones there are."""
    import pyceres

    model = build(done.seen, done.state)
    adjuster = problem(model, max(CAUCHY_SIGMAS * done.sigma_px, LEAST_SCALE_PX))
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


CELLS = 10
"""Along the longer side of an image, for the coverage and the mean residuals."""
_DOWN, _ACROSS = ("upper", "middle", "lower"), ("left", "centre", "right")


@dataclass(frozen=True)
class CameraVerdict:
    """Of one camera: views and corners, root mean square of a residual's coordinate (pixels) of the adjusted and of
    held-out instants, share of its image in which corners were seen, largest tilt of the board (deg)."""

    views: int
    corners: int
    rms_px: float
    held_out_px: float
    coverage: float
    tilt_deg: float


@dataclass(frozen=True)
class Verdict:
    """Of all cameras, in their order; what to do better, in words."""

    cameras: tuple[CameraVerdict, ...]
    precision: Precision
    advice: tuple[str, ...]


def judge(done: Adjusted) -> Verdict:
    """Sigmas, cross-validation, coverage and advice.

    Raises ReconstructionError if the views leave a focal length open.
    """
    exact = precision(done)
    # Largest angle, degrees, between the board's normal and the line of sight to its middle, of each camera
    tilts = [0.0] * len(done.seen.cameras)
    for view in done.seen.views:
        pose = done.state.camera_from_board(view)
        sight = pose[:3, :3] @ done.seen.board.points.mean(axis=0) + pose[:3, 3]
        cosine = abs(float(pose[:3, 2] @ sight)) / float(np.linalg.norm(sight))
        tilts[view.camera] = max(tilts[view.camera], float(np.degrees(np.arccos(min(cosine, 1.0)))))
    for number, images in enumerate(done.seen.cameras):
        share = relative_focal_sigma(done, exact, number)
        if not share <= 0.01:
            focal = done.state.cameras[number].mean_focal_length()
            raise ReconstructionError(
                f"{images.name}: these views do not determine its focal length: {focal:.0f} px with a sigma of "
                f"{100 * share:.2g} %. The board was tilted by {tilts[number]:.0f} degrees at most against the line of "
                "sight: take views with 30 to 45 degrees, to all four sides, and near ones that fill the image"
            )
    inside, held_out = view_residuals(done.seen, done.state), held_out_residuals(done)
    cameras = []
    for number, images in enumerate(done.seen.cameras):
        own = [k for k, view in enumerate(done.seen.views) if view.camera == number]
        longer = max(images.size)
        across, down = (max(1, round(CELLS * side / longer)) for side in images.size)
        corners = sum(len(inside[k]) for k in own)
        rms_px, held_px = (_rms([off[k] for k in own]) for off in (inside, held_out))
        covered = float((seen_cells(done.seen, number, (across, down)) > 0).mean())
        cameras.append(
            CameraVerdict(len(own), corners, rms_px, held_out_px=held_px, coverage=covered, tilt_deg=tilts[number])
        )
    return Verdict(tuple(cameras), exact, tuple(_advice(done, cameras, exact)))


def _rms(found: list[np.ndarray]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(found) ** 2)))


def held_out_residuals(done: Adjusted) -> list[np.ndarray]:
    """(K, 2) residuals of every view from cameras and rig that were adjusted without its instant, to which only the
    board's place was fitted, pixels."""
    out: dict[str, np.ndarray] = {}
    scale = max(CAUCHY_SIGMAS * done.sigma_px, LEAST_SCALE_PX)
    instants = done.seen.instants()
    for fold in range(min(5, len(instants))):
        held = set(instants[fold::5])
        kept, asked = done.seen.among(set(instants) - held), done.seen.among(held)
        found = adjust(kept, done.state.at(kept.instants()), (scale,))
        boards = {k: done.state.rig_from_board[k] for k in held}
        placed = place_boards(asked, State(found.cameras, found.sensor_from_rig, boards), scale)
        out |= {v.name: r for v, r in zip(asked.views, view_residuals(asked, placed))}
    return [out[view.name] for view in done.seen.views]


def relative_focal_sigma(done: Adjusted, exact: Precision, camera: int) -> float:
    """Sigma of a camera's focal length over it, the larger of both directions."""
    found = done.state.cameras[camera]
    names = [n.strip() for n in found.params_info.split(",")]
    at = list(found.focal_length_idxs())
    return float(np.max(exact.of(camera, *(names[k] for k in at)) / np.abs(found.params[at])))


def seen_cells(seen: Observations, camera: int, cells: tuple[int, int]) -> np.ndarray:
    """(rows, columns) number of corners in each cell of a camera's image."""
    xy = np.concatenate([v.xy for v in seen.views if v.camera == camera])
    width, height = seen.cameras[camera].size
    across, down = cells
    return np.histogram2d(xy[:, 1], xy[:, 0], (down, across), ((0, height), (0, width)))[0]


def _advice(done: Adjusted, cameras: list[CameraVerdict], exact: Precision) -> list[str]:
    out = []
    for number, (images, verdict) in enumerate(zip(done.seen.cameras, cameras)):
        name = images.name
        empty = _empty_thirds(done.seen, number)
        if empty:
            out.append(f"{name}: no corner in the {' and the '.join(empty)} of the image: move the board there")
        if verdict.views < 10:  # the least of OpenCV's tutorial
            out.append(f"{name}: {verdict.views} views of the board: take 20")
        if verdict.tilt_deg < 20:
            out.append(f"{name}: the board was tilted by {verdict.tilt_deg:.0f} degrees at most: tilt it by 30 to 45")
        share = relative_focal_sigma(done, exact, number)
        if share > 0.001:
            out.append(f"{name}: the focal length has a sigma of {100 * share:.2g} %: more views, nearer and tilted")
        if verdict.held_out_px > 1.5 * verdict.rms_px:
            out.append(
                f"{name}: held-out instants are off by {verdict.held_out_px:.2f} px, the adjusted ones by "
                f"{verdict.rms_px:.2f} px: too few views for model {images.model}; take more, or a simpler model"
            )
    # The images whose corners fit much worse than those of the others of their camera
    rms = np.array([_rms([off]) for off in view_residuals(done.seen, done.state)])
    camera = np.array([view.camera for view in done.seen.views])
    usual = {int(c): float(np.median(rms[camera == c])) for c in np.unique(camera)}
    return out + [
        f"{view.name}: its corners are {off:.2f} px off (RMS), those of others {usual[view.camera]:.2f} px: is it "
        "blurred, or something before the board?"
        for view, off in zip(done.seen.views, rms)
        if off > 3 * usual[view.camera]
    ]


def _empty_thirds(seen: Observations, camera: int) -> list[str]:
    """Parts of the image, thirds across and down, without a corner; of fisheye images those that the lens may light."""
    count = seen_cells(seen, camera, (3, 3))
    width, height = seen.cameras[camera].size
    # Of half the shorter side: beyond it, what a fisheye lens may leave dark
    reach = 1.18 * min(width, height) / 2 if "FISHEYE" in seen.cameras[camera].model else np.inf
    return [
        f"{_DOWN[row]} {_ACROSS[column]}"
        for row, column in zip(*np.nonzero(count == 0))
        if np.hypot((column - 1) * width / 3, (row - 1) * height / 3) < reach
    ]
