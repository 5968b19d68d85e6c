"""Rig diagnostics: where each camera would stand by its own sightings, against where the rig puts it, frame by frame.

Points are made anew without the camera in question, so that a camera that fires late or sits loose cannot vouch for
itself: it is resected in what the other cameras saw (ALGORITHMS section 4 d).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation
from scipy.special import bdtr

from tiegraph.geometry import transforms
from tiegraph.geometry.align import MAD
from tiegraph.geometry.transforms import skew
from tiegraph.scene.colmapmodel import model_rigs, registered_images
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import Columns
from tiegraph.sfm.adjustment.jacobians import Layout, System, jacobians, sampled
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import DiagnosticsTuning

_OPEN = 1e-9  # of a point's information: along a single ray nothing is known
_ROUNDS, _CAUCHY = 5, 2.0  # of the robust step; its scale in sigmas
_MEDIAN = 1.1774  # of the length of a two-dimensional normal error, in its sigma

COLUMNS = (
    "frame", "pass", "camera", "points", "rms_px", "right_m", "down_m", "forward_m", "turn_x_deg", "turn_y_deg",
    "turn_z_deg", "sigma_m", "sigma_deg", "baseline_m", "axis_deg",
)  # fmt: skip


@dataclass(frozen=True)
class Resections(Columns):
    """K images resected in the points of their frame's other cameras, against the rig; lengths in metres.

    ``shift_m`` and ``turn_deg`` are in the rig frame: own place minus the rig's, own rotation after the rig's.
    """

    image: np.ndarray  # (K,) scene index
    points: np.ndarray  # (K,) inliers
    rms_px: np.ndarray  # (K,) of them
    shift_m: np.ndarray  # (K, 3)
    turn_deg: np.ndarray  # (K, 3) rotation vector
    sigma_m: np.ndarray  # (K, 3) expected of the shift
    sigma_deg: np.ndarray  # (K, 3) expected of the turn
    covariance: np.ndarray  # (K, 6, 6) of shift (m) and turn (rad)
    rig_pose: np.ndarray  # (K, 4, 4) sensor_from_rig of the model, metres

    def residual(self) -> np.ndarray:
        """(K, 6) shift (m) and turn (rad)."""
        return np.concatenate([self.shift_m, np.radians(self.turn_deg)], axis=1)


@dataclass(frozen=True)
class Deviation:
    """How far a camera's own places, or turns, are off those of its rig, over the frames."""

    median: tuple[float, float, float]  # rig frame
    scatter: float  # robust sigma about the median, largest of the three directions
    expected: float  # of the scatter, by what the images allow

    @property
    def size(self) -> float:
        """Length of the median."""
        return float(np.linalg.norm(self.median))


@dataclass(frozen=True)
class SensorDiagnostics:
    """One camera against its rig over the frames that could be resected."""

    sensor: int  # key over all rigs
    name: str
    frames: int
    place_m: Deviation
    turn_deg: Deviation
    scatter_ratio: float  # scatter about the median over what the images allow: 1 = as good as they are
    scatter_px: float  # what that scatter moves in an image
    sure_ratio: float  # the scatter ratio is at least this, but for a small chance: few frames tell little

    def rigid(self, tuning: DiagnosticsTuning) -> bool:
        """Whether the frames agree on one place, within what the images can tell and so many frames make sure of, or
        too little to be seen."""
        sure_px = self.scatter_px * self.sure_ratio / max(self.scatter_ratio, 1e-12)
        return self.sure_ratio <= tuning.max_ratio or sure_px <= tuning.min_scatter_px


def resect_all(
    reconstruction: pycolmap.Reconstruction, scene: Scene, metres_per_unit: float, tuning: Tuning
) -> Resections:
    """Resect each registered image of a rig of several sensors in the points its own sensor had no part in.

    Linearised where the model is: the points go to their minimum by the other sensors, and the image follows them, each
    sighting weighed by its own error and that of its point (Foerstner and Wrobel 2016, section 4.1.4).
    """
    several = (k for k, p in reconstruction.points3D.items() if p.track.length() > 1)
    enough = tuning.rig.diagnostics.min_points * reconstruction.num_reg_images()  # each is seen several times
    points, _ = sampled(several, max(tuning.rig.system.most_points, enough))
    if not points:
        return _gathered([])
    seen = jacobians(reconstruction, Layout(reconstruction, False, False), points)
    rigs, rows = model_rigs(reconstruction, scene), []
    others: dict[int, _PointsOf] = {}
    for index, image in registered_images(reconstruction, scene):
        sensors = rigs[scene.rig[scene.frame[index]]].sensors
        if len(sensors) < 2:
            continue
        if image.camera_id not in others:
            others[image.camera_id] = _PointsOf.others(seen, image.camera_id, tuning.adjust.robust_px)
        own = np.flatnonzero(seen.image == image.image_id)
        row = others[image.camera_id].resected(seen, own, tuning.rig.diagnostics)
        if row is None:
            continue
        extrinsics = sensors[scene.sensor[index]].sensor_from_rig
        rig_pose = np.eye(4) if extrinsics is None else extrinsics.copy()
        rig_from_model = rig_pose[:3, :3].T @ image.cam_from_world().rotation.matrix()
        rig_pose[:3, 3] *= metres_per_unit
        rows.append((index, row, np.kron(np.diag([metres_per_unit, 1.0]), rig_from_model), rig_pose))
    return _gathered(rows)


@dataclass(frozen=True)
class _Resected:
    """An image placed by points: shift of its centre and turn (6,), covariance of them, along the model's axes."""

    inliers: int
    sigma_px: float
    step: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class _PointsOf:
    """Points (P) at their minimum by the sightings of some cameras: steps (P, 3) to there, covariance (P, 3, 3) for
    sightings of 1 px, model units."""

    step: np.ndarray
    spread: np.ndarray

    @staticmethod
    def others(seen: System, camera: int, robust_px: float) -> _PointsOf:
        """By all cameras but one."""
        point = _numbers(seen)
        weight = (seen.camera != camera) / (1 + np.sum(seen.residual.reshape(-1, 2) ** 2, axis=1) / robust_px**2)
        count = seen.points.shape[1] // 3
        normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(normal, point, np.einsum("o,oki,okj->oij", weight, seen.by_point, seen.by_point))
        np.add.at(right, point, np.einsum("o,oki,ok->oi", weight, seen.by_point, seen.residual.reshape(-1, 2)))
        size = np.trace(normal, axis1=1, axis2=2)[:, None, None]
        known = normal + np.where(size > 0, _OPEN * size, 1.0) * np.eye(3)  # what one ray leaves open stays so
        spread = np.linalg.inv(known)
        spread[size[:, 0, 0] <= 0] = np.inf
        return _PointsOf(step=-np.linalg.solve(known, right[..., None])[..., 0], spread=spread)

    def resected(self, seen: System, rows: np.ndarray, tuning: DiagnosticsTuning) -> _Resected | None:
        """The image with these observations; None with too few."""
        point = _numbers(seen)[rows]
        known = np.isfinite(self.spread[point]).all(axis=(1, 2))
        rows, point = rows[known], point[known]
        if len(rows) < tuning.min_points:
            return None
        by_point = seen.by_point[rows]
        left = seen.residual.reshape(-1, 2)[rows] + np.einsum("oki,oi->ok", by_point, self.step[point])
        spread = np.eye(2) + by_point @ self.spread[point] @ np.swapaxes(by_point, 1, 2)
        root = np.linalg.inv(np.linalg.cholesky(spread))  # of the weights
        columns = root @ np.concatenate([-by_point, by_point @ skew(seen.lever[rows])], axis=2)
        left = np.einsum("oij,oj->oi", root, left)
        step, sigma = np.zeros(6), 1.0
        for _ in range(_ROUNDS):
            off = np.linalg.norm(left + columns @ step, axis=1)
            sigma = max(float(np.median(off)) / _MEDIAN, tuning.least_sigma_px)
            weight = 1 / (1 + (off / (_CAUCHY * sigma)) ** 2)
            normal = np.einsum("o,oki,okj->ij", weight, columns, columns)
            step = -np.linalg.lstsq(normal, np.einsum("o,oki,ok->i", weight, columns, left), rcond=None)[0]
        if np.linalg.matrix_rank(normal) < len(normal):
            return None
        return _Resected(inliers=len(rows), sigma_px=sigma, step=step, covariance=sigma**2 * np.linalg.inv(normal))


def _numbers(seen: System) -> np.ndarray:
    """(O,) the point of each observation."""
    return seen.points.indices[seen.points.indptr[:-1:2]] // 3


def _gathered(rows: list[tuple[int, _Resected, np.ndarray, np.ndarray]]) -> Resections:
    """Of scene indices, images, (6, 6) from the model's axes to the rig's in metres, rig poses."""
    moved = np.array([axes @ row.step for _, row, axes, _ in rows]).reshape(-1, 6)
    covariance = np.array([axes @ row.covariance @ axes.T for _, row, axes, _ in rows]).reshape(-1, 6, 6)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)).reshape(-1, 6)
    return Resections(
        image=np.array([index for index, *_ in rows], int),
        points=np.array([row.inliers for _, row, _, _ in rows], int),
        rms_px=np.array([row.sigma_px for _, row, _, _ in rows], float),
        shift_m=moved[:, :3],
        turn_deg=np.degrees(moved[:, 3:]),
        sigma_m=sigma[:, :3],
        sigma_deg=np.degrees(sigma[:, 3:]),
        covariance=covariance,
        rig_pose=np.array([pose for *_, pose in rows]).reshape(-1, 4, 4),
    )


def sensor_diagnostics(found: Resections, scene: Scene, tuning: DiagnosticsTuning) -> tuple[SensorDiagnostics, ...]:
    """Robust scatter of each camera of a rig of several sensors; too few frames: missing."""
    keys = scene.sensor_key[found.image]
    out = []
    for key in np.unique(keys):
        of = found.where(keys == key)
        if len(of.image) < tuning.min_frames:
            continue
        place, turn = _deviation(of.shift_m, of.sigma_m), _deviation(of.turn_deg, of.sigma_deg)
        about = of.residual() - np.concatenate([place.median, np.radians(turn.median)])
        chi = np.einsum("ki,kij,kj->k", about, np.linalg.inv(of.covariance), about) / 6
        ratio = float(np.sqrt(np.median(chi)))
        # An adjusted pose of n points is good to about sqrt(6 / 2n) of the pixel error in the image.
        pixel = float(np.median(of.rms_px * np.sqrt(3 / of.points)))
        out.append(
            SensorDiagnostics(
                sensor=int(key),
                name=scene.all_sensors[key].name,
                frames=len(of.image),
                place_m=place,
                turn_deg=turn,
                scatter_ratio=ratio,
                scatter_px=ratio * pixel,
                sure_ratio=float(np.sqrt(median_at_least(chi, tuning.chance))),
            )
        )
    return tuple(out)


def median_at_least(values: np.ndarray, chance: float) -> float:
    """What the median of a distribution exceeds, but for ``chance``, given (n,) draws; 0 if they are too few to say.

    The k-th smallest draw lies above the median if fewer than k draws lie below it, each with probability 1/2: the sign
    test turned round, which asks nothing of the distribution (residuals of resections have long tails).
    """
    count = len(values)
    below = int(np.argmax(bdtr(np.arange(count + 1), count, 0.5) >= chance))  # the smallest b: P(draws below <= b)
    return float(np.sort(values)[below - 1]) if below > 0 else 0.0


def _deviation(values: np.ndarray, sigma: np.ndarray) -> Deviation:
    """Of (K, 3) shifts or turns and what is expected of each."""
    median = np.median(values, axis=0)
    spread = MAD * np.median(np.abs(values - median), axis=0)
    return Deviation(
        median=(float(median[0]), float(median[1]), float(median[2])),
        scatter=float(np.max(spread)),
        expected=float(np.max(np.median(sigma, axis=0))),
    )


def table_rows(found: Resections, scene: Scene) -> list[list[Any]]:
    """Rows of COLUMNS; baseline and axis: between the camera and the reference, both resected, against the rig.

    An empty cell: the reference of that frame could not be resected, or is the camera itself.
    """
    row_of = {int(k): n for n, k in enumerate(found.image)}
    reference = {int(scene.frame[k]): n for k, n in row_of.items() if scene.sensor[k] == 0}
    out = []
    for n, image in enumerate(found.image):
        frame = int(scene.frame[image])
        track = int(scene.sequence[frame])
        first = reference.get(frame)
        baseline, axis = (None, None) if first in (None, n) else _pair_residual(found, int(first or 0), n)
        numbers = [*found.shift_m[n], *found.turn_deg[n], np.max(found.sigma_m[n]), np.max(found.sigma_deg[n])]
        head = [frame, scene.sequences[track] if track >= 0 else "", scene.sensor_of(int(image)).name]
        body = [int(found.points[n]), round(float(found.rms_px[n]), 3), *(round(float(v), 5) for v in numbers)]
        out.append([*head, *body, baseline, axis])
    return out


def _pair_residual(found: Resections, first: int, other: int) -> tuple[float | None, float | None]:
    """Baseline (m) and angle between the axes (deg) of two resected cameras, minus those of the rig."""
    extrinsics = found.rig_pose[[first, other]]
    centres, axes = transforms.centre(extrinsics), extrinsics[:, 2, :3]
    moved = centres + found.shift_m[[first, other]]
    turned = Rotation.from_rotvec(np.radians(found.turn_deg[[first, other]])).apply(axes)
    lengths = [float(np.linalg.norm(c[1] - c[0])) for c in (centres, moved)]
    angles = [float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a[0], a[1])), a[0] @ a[1]))) for a in (axes, turned)]
    return round(lengths[1] - lengths[0], 5), round(angles[1] - angles[0], 5)
