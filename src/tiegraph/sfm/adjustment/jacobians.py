"""Derivatives of a model's reprojection errors with respect to poses, rig, intrinsics and points."""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.geometry.transforms import skew
from tiegraph.scene.colmapmodel import matrix
from tiegraph.sfm.adjustment import lens, leverarmprior
from tiegraph.sfm.motion import Motion
from tiegraph.sfm.tuning import AdjustTuning, LensTuning


class Layout:
    """Columns of the unknowns: six for each frame (shift of its centre, rotation), six for each sensor, then the
    intrinsics."""

    def __init__(
        self,
        model: pycolmap.Reconstruction,
        free_intrinsics: bool | Collection[int],
        free_rig: bool | Collection[int],
    ) -> None:
        """``free_intrinsics``, ``free_rig``: ids of the cameras and rigs that are unknowns; True: all, False: none."""
        self.frame_ids = tuple(sorted(model.reg_frame_ids()))
        self.frame = {f: 6 * k for k, f in enumerate(self.frame_ids)}
        self.centres = np.stack([frame_pose(model.frame(f)).tgt_origin_in_src() for f in self.frame_ids])
        self.size = 6 * len(self.frame_ids)
        self.sensor: dict[int, int] = {}
        self.sensor_centre: dict[int, np.ndarray] = {}
        self.rigs = tuple(k for k in model.rigs if _chosen(k, free_rig))
        images = [model.image(i) for i in model.reg_image_ids()]
        for rig_id in self.rigs:
            for sensor, pose in model.rigs[rig_id].non_ref_sensors.items():
                if pose is not None:
                    self.sensor[sensor.id], self.sensor_centre[sensor.id] = self.size, pose.tgt_origin_in_src()
                    self.size += 6
        self.camera: dict[int, int] = {}
        self.params: dict[int, np.ndarray] = {}
        for camera_id in sorted(k for k in {i.camera_id for i in images} if _chosen(k, free_intrinsics)):
            camera = model.camera(camera_id)
            self.camera[camera_id], self.params[camera_id] = self.size, np.array(camera.params)
            self.size += len(camera.params)

    def prior(
        self,
        model: pycolmap.Reconstruction,
        tuning: AdjustTuning,
        nominal: Mapping[int, leverarmprior.NominalGeometry],
    ) -> sparse.csr_matrix:
        """(C, C) information matrix of the priors of lenses and of places in a rig.

        ``model``: the model of these unknowns; ``nominal``: geometry of nominal rigs by rig id.
        """
        parts = []
        for rig_id in self.rigs:
            keys, expected = leverarmprior.information(model.rigs[rig_id], tuning.lever_arms, nominal.get(rig_id))
            parts.append((np.array([self.sensor[k] + axis for k in keys for axis in range(3)], int), expected))
        for camera_id, column in self.camera.items():
            camera = model.camera(camera_id)
            columns = column + np.arange(len(camera.params))
            parts.append((columns, np.linalg.inv(_expected(camera, tuning.lens))))
        row = np.concatenate([np.repeat(at, len(at)) for at, _ in parts] or [np.zeros(0, int)])
        column = np.concatenate([np.tile(at, len(at)) for at, _ in parts] or [np.zeros(0, int)])
        value = np.concatenate([block.ravel() for _, block in parts] or [np.zeros(0)])
        return sparse.csr_matrix((value, (row, column)), shape=(self.size, self.size))


def _chosen(key: int, free: bool | Collection[int]) -> bool:
    return free if isinstance(free, bool) else key in free


def _expected(camera: pycolmap.Camera, tuning: LensTuning) -> np.ndarray:
    """Prior covariance of a camera's parameters. The adjustment has no priors for models other than OPENCV, but their
    sigmas need weak ones."""
    if camera.model == pycolmap.CameraModelId.OPENCV:
        return lens.covariance(camera.mean_focal_length(), tuning)
    pixels = set(camera.focal_length_idxs()) | set(camera.principal_point_idxs())
    wide = tuning.loose_focal * camera.mean_focal_length()
    return np.diag(np.square([wide if p in pixels else tuning.radial for p in range(len(camera.params))]))


@dataclass(frozen=True)
class System:
    """The linearised observations: two rows for each observation, images in the order of their ids."""

    cameras: sparse.csr_matrix  # (2O, C) by poses, rig, intrinsics
    points: sparse.csr_matrix  # (2O, 3P)
    residual: np.ndarray  # (2O,) projected minus measured, pixels
    image: np.ndarray  # (O,) id
    camera: np.ndarray  # (O,) id
    xy: np.ndarray  # (O, 2) measured, pixels
    by_point: np.ndarray  # (O, 2, 3) the values of ``points``
    lever: np.ndarray  # (O, 3) point minus the centre of the image, model axes


def sampled(points: Iterable[int], most: int) -> tuple[list[int], float]:
    """At most ``most`` ids of points in order, drawn at random with a fixed seed, and the share of all points that
    they are."""
    ids = np.array(sorted(points))
    share = min(1.0, most / max(len(ids), 1))
    if share < 1:
        ids = np.sort(np.random.default_rng(0).choice(ids, most, replace=False))
    return ids.tolist(), share


def jacobians(model: pycolmap.Reconstruction, layout: Layout, point_ids: list[int]) -> System:
    """Jacobians of all observations of these points, and residuals."""
    # Asking pycolmap for an image or an array of two numbers takes a microsecond, so each is asked for once.
    points = [model.point3D(k) for k in point_ids]
    elements = [point.track.elements for point in points]
    flat = np.array([(e.image_id, e.point2D_idx) for track in elements for e in track], np.int64).reshape(-1, 2)
    order = np.argsort(flat[:, 0], kind="stable")
    image, feature = flat[order].T
    point = np.repeat(np.arange(len(points)), [len(track) for track in elements])[order]
    xyz, xy = np.array([p.xyz for p in points]).reshape(-1, 3)[point], np.empty((len(image), 2))
    ids, first = np.unique(image, return_index=True)
    found, levers, cameras = [], [], []
    for image_id, rows in zip(ids.tolist(), np.split(np.arange(len(image)), first[1:])):
        own = model.image(image_id)
        at = np.empty((own.num_points2D(), 2))
        at[own.get_observation_point2D_idxs()] = [p.xy for p in own.get_observation_points2D()]
        xy[rows] = at[feature[rows]]
        found.append(of_image(layout, own, xyz[rows], xy[rows]))
        levers.append(xyz[rows] - own.projection_center())
        cameras.append(np.full(len(rows), own.camera_id))
    by_point = np.concatenate([part.of_point for part in found])
    columns = np.repeat(3 * point[:, None] + np.arange(3), 2, axis=0)  # (2O, 3)
    return System(
        cameras=_by_rows([(p.dense, np.tile(p.columns, (2 * len(p.dense), 1))) for p in found], layout.size),
        points=_by_rows([(by_point, columns)], 3 * len(point_ids)),
        residual=np.concatenate([part.residual.ravel() for part in found]),
        image=image,
        camera=np.concatenate(cameras),
        xy=xy,
        by_point=by_point,
        lever=np.concatenate(levers),
    )


def _by_rows(parts: list[tuple[np.ndarray, np.ndarray]], width: int) -> sparse.csr_matrix:
    """(2O, width) matrix of observations (O, 2, D) and their columns (2O, D), stacked."""
    each = np.concatenate([np.full(len(columns), columns.shape[1]) for _, columns in parts])
    data, index = (np.concatenate([part[k].ravel() for part in parts]) for k in (0, 1))
    return sparse.csr_matrix((data, index, np.append(0, np.cumsum(each))), shape=(len(each), width))


@dataclass(frozen=True)
class OfImage:
    """Jacobian (O, 2, D) over the columns (D,), Jacobian to the points (O, 2, 3) and residuals (O, 2) of one image."""

    dense: np.ndarray
    columns: np.ndarray
    of_point: np.ndarray
    residual: np.ndarray


def of_image(layout: Layout, image: pycolmap.Image, world: np.ndarray, measured: np.ndarray) -> OfImage:
    """The linearised observations of one image.

    ``world`` (O, 3): the points; ``measured`` (O, 2) pixels. A pose T = (R, c) moves as R Exp(-w) (X - c - v), so the
    unknown v is the shift of the centre itself.
    """
    camera, frame = image.camera, image.frame
    assert camera is not None and frame is not None
    pose = matrix(image.cam_from_world())
    in_camera = world @ pose[:3, :3].T + pose[:3, 3]
    to_camera = _by_point(camera, in_camera)
    of_point = to_camera @ pose[:3, :3]
    rig_from_world = matrix(frame_pose(frame))
    lever = world - frame_pose(frame).tgt_origin_in_src()
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
    return OfImage(dense=dense, columns=np.concatenate(columns), of_point=of_point, residual=residual)


def frame_pose(frame: pycolmap.Frame) -> pycolmap.Rigid3d:
    """rig_from_world of a registered frame."""
    pose = frame.rig_from_world
    assert pose is not None  # only registered frames come here
    return pose


def _by_point(camera: pycolmap.Camera, xyz: np.ndarray) -> np.ndarray:
    """(O, 2, 3) derivatives of pixels by camera-frame coordinates, by central differences: valid for every camera
    model."""
    out = np.empty((len(xyz), 2, 3))
    step = 1e-5 * np.linalg.norm(xyz, axis=1, keepdims=True)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        ends = [np.asarray(camera.img_from_cam(xyz + sign * shift)) for sign in (1, -1)]
        out[:, :, axis] = (ends[0] - ends[1]) / (2 * step)
    return out


def _by_params(camera: pycolmap.Camera, xyz: np.ndarray) -> np.ndarray:
    """(O, 2, K) derivatives of pixels by the camera's parameters, by central differences."""
    params = np.array(camera.params)
    out = np.empty((len(xyz), 2, len(params)))
    for k, value in enumerate(params):
        step = 1e-5 * max(abs(value), 1.0)
        ends = []
        for sign in (1, -1):
            moved = copy.copy(camera)
            moved.params = params + sign * step * np.eye(len(params))[k]
            ends.append(np.asarray(moved.img_from_cam(xyz)))
        out[:, :, k] = (ends[0] - ends[1]) / (2 * step)
    return out


def by_shift(seen: System, rows: np.ndarray) -> np.ndarray:
    """(R, 2, 6) derivatives of observations by the shift of the image's centre and its rotation, model axes."""
    by_point = seen.by_point[rows]
    return np.concatenate([-by_point, by_point @ skew(seen.lever[rows])], axis=2)


def of_lens(model: pycolmap.Reconstruction, seen: System, camera_id: int) -> sparse.csr_matrix:
    """(2O, K) derivatives of all observations by the parameters of one camera."""
    rows = np.flatnonzero(seen.camera == camera_id)
    images, number = np.unique(seen.image[rows], return_inverse=True)
    turns = np.array([matrix(model.image(i).cam_from_world())[:3, :3] for i in images.tolist()]).reshape(-1, 3, 3)
    camera = model.camera(camera_id)
    values = _by_params(camera, np.einsum("oij,oj->oi", turns[number], seen.lever[rows]))
    at = np.repeat((2 * rows[:, None] + np.arange(2)).ravel(), len(camera.params))
    column = np.tile(np.arange(len(camera.params)), 2 * len(rows))
    return sparse.csr_matrix((values.ravel(), (at, column)), shape=(len(seen.residual), len(camera.params)))


def of_time(seen: System, motion: Motion, rows: np.ndarray) -> sparse.csr_matrix:
    """(2O, 1) derivatives of observations (R,) by the time at which their images were taken."""
    images, number = np.unique(seen.image[rows], return_inverse=True)
    rate = np.array([motion.rate(i) for i in images.tolist()]).reshape(-1, 6)[number]
    values = np.einsum("oij,oj->oi", by_shift(seen, rows), rate)
    at = (2 * rows[:, None] + np.arange(2)).ravel()
    return sparse.csr_matrix((values.ravel(), (at, np.zeros(len(at), int))), shape=(len(seen.residual), 1))


def of_images(seen: System, images: list[np.ndarray]) -> sparse.csr_matrix:
    """(2O, 6K) derivatives of observations (R,) of each of K images by the shift of its centre and its rotation."""
    rows, first = np.concatenate(images), 6 * np.repeat(np.arange(len(images)), [len(r) for r in images])
    return _columns(seen, rows, by_shift(seen, rows), first, 6 * len(images))


def of_mounting(model: pycolmap.Reconstruction, seen: System, camera: int) -> sparse.csr_matrix:
    """(2O, 6) derivatives by the shift and the rotation of a camera, along the axes of the rig."""
    rows = np.flatnonzero(seen.camera == camera)
    images, number = np.unique(seen.image[rows], return_inverse=True)
    frames = [model.frame(model.image(i).frame_id) for i in images.tolist()]
    axes = np.array([frame_pose(f).rotation.matrix().T for f in frames]).reshape(-1, 3, 3)[number]
    shifted = by_shift(seen, rows)
    values = np.concatenate([shifted[:, :, :3] @ axes, shifted[:, :, 3:] @ axes], axis=2)
    return _columns(seen, rows, values, np.zeros(len(rows), int), 6)


def _columns(seen: System, rows: np.ndarray, values: np.ndarray, first: np.ndarray, width: int) -> sparse.csr_matrix:
    """(2O, width) matrix with the values (R, 2, 6) of some observations in six columns from ``first`` (R,)."""
    row = np.repeat((2 * rows[:, None] + np.arange(2)).ravel(), 6)
    column = np.repeat(first[:, None] + np.arange(6), 2, axis=0).ravel()
    return sparse.csr_matrix((values.ravel(), (row, column)), shape=(2 * len(seen.image), width))
