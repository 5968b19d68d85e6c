"""How well the bundle adjustment knows the frames' positions: normal equations with rig and intrinsics, free gauge."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.geometry.transforms import skew
from tiegraph.sfm.model import matrix

MAX_POINTS = 20_000  # a random part of the points is enough for the sigmas; the normal equations are scaled up
_SEED = 0
_RIDGE = 1e-9  # of the median stiffness: a frame that no point holds gets a huge sigma instead of a singular matrix
_PRIOR_FOCAL = 0.2  # weak prior sigma of intrinsics, in parts of the focal length
_PRIOR_EXTRA = 0.5  # weak prior sigma of distortion parameters


@dataclass(frozen=True)
class PositionSigma:
    """One-sigma position uncertainty of frames, model units, after the best similarity to the truth (free gauge)."""

    frame_ids: tuple[int, ...]  # of the model
    sigma: np.ndarray  # (F, 3) along the model's axes
    pixel_sigma: float  # a posteriori sigma of one image coordinate, pixels

    @property
    def median(self) -> float:
        """Median of the frames' root sum of squares."""
        return float(np.median(np.linalg.norm(self.sigma, axis=1)))

    @property
    def p90(self) -> float:
        """90th percentile of the frames' root sum of squares."""
        return float(np.percentile(np.linalg.norm(self.sigma, axis=1), 90))


def position_sigma(
    model: pycolmap.Reconstruction, free_intrinsics: bool = True, free_rig: bool = True
) -> PositionSigma:
    """Position sigmas of the registered frames from the normal equations of the bundle adjustment.

    Points are eliminated (Schur), intrinsics and rig extrinsics are unknowns unless told otherwise. The gauge is taken
    out by the S-transformation over all positions, so a sigma is that of a position after the best alignment to the
    truth. False matches and correlated key point errors are not in it: it is a lower bound. (pycolmap's
    estimate_ba_covariance refuses rigs.) Raises ValueError for a model without redundancy.
    """
    layout = Layout(model, free_intrinsics, free_rig)
    if len(layout.frame_ids) < 3:
        raise ValueError("needs at least 3 frames")
    points, share = _sample(model)
    jc, jp, residual = _jacobians(model, layout, points)
    redundancy = len(residual) - (layout.size - 7) - 3 * len(points)
    if redundancy <= 0:
        raise ValueError("no redundancy")
    # A robust variance: the adjustment was robust too, and a few bad observations must not widen every sigma.
    variance = max((1.4826 * float(np.median(np.abs(residual)))) ** 2 * len(residual) / redundancy, 1e-12)
    normal = reduced(jc, jp) / share / variance + layout.prior()
    covariance = positions_free_gauge(normal, layout)
    diagonal = np.clip(np.diag(covariance), 0, None).reshape(-1, 3)
    return PositionSigma(layout.frame_ids, np.sqrt(diagonal), float(np.sqrt(variance)))


class Layout:
    """Columns of the unknowns: six a frame (shift of its centre, rotation), six a sensor, then the intrinsics."""

    def __init__(self, model: pycolmap.Reconstruction, free_intrinsics: bool, free_rig: bool) -> None:
        self.frame_ids = tuple(sorted(model.reg_frame_ids()))
        self.frame = {f: 6 * k for k, f in enumerate(self.frame_ids)}
        self.centres = np.stack([_pose(model.frame(f)).tgt_origin_in_src() for f in self.frame_ids])
        self.size = 6 * len(self.frame_ids)
        self.sensor: dict[int, int] = {}
        self.sensor_centre: dict[int, np.ndarray] = {}
        images = [model.image(i) for i in model.reg_image_ids()]
        for rig in model.rigs.values() if free_rig else ():
            for sensor, pose in rig.non_ref_sensors.items():
                if pose is not None:
                    self.sensor[sensor.id], self.sensor_centre[sensor.id] = self.size, pose.tgt_origin_in_src()
                    self.size += 6
        self.camera: dict[int, int] = {}
        self.params: dict[int, np.ndarray] = {}
        self._prior: list[tuple[int, float]] = []
        for camera_id in sorted({i.camera_id for i in images}) if free_intrinsics else ():
            camera = model.camera(camera_id)
            self.camera[camera_id], self.params[camera_id] = self.size, np.array(camera.params)
            pixels = set(camera.focal_length_idxs()) | set(camera.principal_point_idxs())
            for p in range(len(camera.params)):
                sigma = _PRIOR_FOCAL * camera.mean_focal_length() if p in pixels else _PRIOR_EXTRA
                self._prior.append((self.size + p, 1 / sigma**2))
            self.size += len(camera.params)

    def prior(self) -> np.ndarray:
        """Diagonal information of the weak priors on intrinsics."""
        out = np.zeros((self.size, self.size))
        for column, weight in self._prior:
            out[column, column] = weight
        return out


def _sample(model: pycolmap.Reconstruction) -> tuple[list[int], float]:
    ids = np.array(sorted(model.point3D_ids()))
    share = min(1.0, MAX_POINTS / max(len(ids), 1))
    if share < 1:
        ids = np.sort(np.random.default_rng(_SEED).choice(ids, MAX_POINTS, replace=False))
    return ids.tolist(), share


def _jacobians(
    model: pycolmap.Reconstruction, layout: Layout, point_ids: list[int]
) -> tuple[sparse.csr_matrix, sparse.csr_matrix, np.ndarray]:
    """Jacobians of all observations to poses and intrinsics (2O, C) and to points (2O, 3P), and residuals (2O,)."""
    seen: dict[int, list[tuple[int, np.ndarray, np.ndarray]]] = {}
    for k, point_id in enumerate(point_ids):
        point = model.point3D(point_id)
        for element in point.track.elements:
            xy = model.image(element.image_id).point2D(element.point2D_idx).xy
            seen.setdefault(element.image_id, []).append((k, point.xyz, xy))
    parts_c, parts_p, residuals = [], [], []
    for image_id, rows in sorted(seen.items()):
        dense, columns, of_point, residual = of_image(model, layout, model.image(image_id), rows)
        count = len(residual)
        index = np.repeat(np.arange(2 * count), len(columns))
        parts_c.append(
            sparse.csr_matrix((dense.ravel(), (index, np.tile(columns, 2 * count))), shape=(2 * count, layout.size))
        )
        number = np.array([k for k, _, _ in rows])
        three = np.repeat(3 * number[:, None] + np.arange(3), 2, axis=0)
        index = np.repeat(np.arange(2 * count), 3)
        parts_p.append(
            sparse.csr_matrix((of_point.ravel(), (index, three.ravel())), shape=(2 * count, 3 * len(point_ids)))
        )
        residuals.append(residual.ravel())
    return sparse.vstack(parts_c).tocsr(), sparse.vstack(parts_p).tocsr(), np.concatenate(residuals)


def of_image(
    model: pycolmap.Reconstruction, layout: Layout, image: pycolmap.Image, rows: list
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Jacobian (O, 2, D) over the columns (D,), Jacobian to the points (O, 2, 3) and residuals (O, 2) of one image.

    A pose T = (R, c) moves as R Exp(-w) (X - c - v): the unknown v is the shift of the centre itself.
    """
    camera, frame = image.camera, image.frame
    assert camera is not None and frame is not None
    pose = matrix(image.cam_from_world())
    world, measured = np.stack([x for _, x, _ in rows]), np.stack([xy for _, _, xy in rows])
    in_camera = world @ pose[:3, :3].T + pose[:3, 3]
    to_camera = _by_point(camera, in_camera)
    of_point = to_camera @ pose[:3, :3]
    rig_from_world = matrix(_pose(frame))
    lever = world - _pose(frame).tgt_origin_in_src()
    parts = [-of_point, of_point @ skew(lever)]
    columns = [layout.frame[image.frame_id] + np.arange(6)]
    if image.camera_id in layout.sensor:
        rotation = pose[:3, :3] @ rig_from_world[:3, :3].T  # sensor from rig
        in_rig = world @ rig_from_world[:3, :3].T + rig_from_world[:3, 3]
        of_rig = to_camera @ rotation
        parts += [-of_rig, of_rig @ skew(in_rig - layout.sensor_centre[image.camera_id])]
        columns.append(layout.sensor[image.camera_id] + np.arange(6))
    if image.camera_id in layout.camera:
        parts.append(_by_params(camera, in_camera))
        columns.append(layout.camera[image.camera_id] + np.arange(len(camera.params)))
    dense = np.concatenate(parts, axis=2)
    residual = camera.img_from_cam(in_camera) - measured
    bad = ~(np.isfinite(dense).all(axis=(1, 2)) & np.isfinite(residual).all(axis=1))
    dense[bad], residual[bad] = 0.0, 0.0
    of_point = np.where(bad[:, None, None], 0.0, of_point)
    return dense, np.concatenate(columns), of_point, residual


def _pose(frame: pycolmap.Frame) -> pycolmap.Rigid3d:
    pose = frame.rig_from_world
    assert pose is not None  # only registered frames come here
    return pose


def _by_point(camera: pycolmap.Camera, xyz: np.ndarray) -> np.ndarray:
    """(O, 2, 3) of pixels by camera-frame coordinates, central differences: right for every camera model."""
    out = np.empty((len(xyz), 2, 3))
    step = 1e-5 * np.linalg.norm(xyz, axis=1, keepdims=True)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        out[:, :, axis] = (camera.img_from_cam(xyz + shift) - camera.img_from_cam(xyz - shift)) / (2 * step)
    return out


def _by_params(camera: pycolmap.Camera, xyz: np.ndarray) -> np.ndarray:
    """(O, 2, K) of pixels by the camera's parameters, central differences."""
    params = np.array(camera.params)
    out = np.empty((len(xyz), 2, len(params)))
    for k, value in enumerate(params):
        step = 1e-5 * max(abs(value), 1.0)
        ends = []
        for sign in (1, -1):
            moved = copy.copy(camera)
            moved.params = params + sign * step * np.eye(len(params))[k]
            ends.append(moved.img_from_cam(xyz))
        out[:, :, k] = (ends[0] - ends[1]) / (2 * step)
    return out


def reduced(jc: sparse.csr_matrix, jp: sparse.csr_matrix) -> np.ndarray:
    """Reduced camera system: Jc'Jc - Jc'Jp (Jp'Jp)^-1 Jp'Jc, dense."""
    points = jp.shape[1] // 3
    blocks = (jp.T @ jp).tobsr(blocksize=(3, 3))
    dense = np.zeros((points, 3, 3))
    dense[blocks.indices] = blocks.data  # block diagonal: an observation touches one point
    inverse = np.linalg.pinv(dense, hermitian=True)
    h_inv = sparse.bsr_matrix((inverse, np.arange(points), np.arange(points + 1)), shape=(3 * points, 3 * points))
    cross = (jc.T @ jp).tocsr()
    return (jc.T @ jc - cross @ h_inv @ cross.T).toarray()


def positions_free_gauge(normal: np.ndarray, layout: Layout) -> np.ndarray:
    """Covariance (3F, 3F) of the positions, with similarities of the whole taken out (S-transformation).

    The seven gauge directions span the null space of ``normal`` (6 of them where a fixed rig holds the scale). Any
    generalised inverse will do, the projector removes what differs: here they get unit stiffness.
    """
    frames = len(layout.centres)
    local = layout.centres - layout.centres.mean(axis=0)
    size = max(float(np.sqrt(np.mean(np.sum(local**2, axis=1)))), 1e-12)
    at = np.arange(6 * frames).reshape(frames, 6)
    positions, rotations = at[:, :3].ravel(), at[:, 3:]
    gauge = np.zeros((layout.size, 7))
    gauge[positions] = np.concatenate(
        [np.tile(np.eye(3), (frames, 1)), -skew(local / size).reshape(-1, 3), (local / size).reshape(-1, 1)], axis=1
    )
    gauge[rotations, 3:6] = np.eye(3)
    for sensor, column in layout.sensor.items():
        gauge[column : column + 3, 6] = layout.sensor_centre[sensor] / size
    stiff = np.sqrt(np.maximum(np.diag(normal), np.max(np.diag(normal)) * 1e-18))
    scaled = normal / stiff[:, None] / stiff[None, :]  # unit diagonal: numbers of like size whatever the unit
    unit = np.full(layout.size, 1.0)
    unit[positions] = size
    for column in layout.sensor.values():
        unit[column : column + 3] = size
    basis = np.linalg.qr(gauge * (unit * stiff)[:, None])[0]
    inverse = np.linalg.inv(scaled + basis @ basis.T + _RIDGE * np.eye(layout.size))
    covariance = (inverse / stiff[:, None] / stiff[None, :])[np.ix_(positions, positions)]
    q = np.linalg.qr(gauge[positions])[0]
    covariance -= q @ (q.T @ covariance)
    return covariance - (covariance @ q) @ q.T
