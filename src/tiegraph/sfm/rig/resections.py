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
from tiegraph.scene.colmapmodel import matrix, model_rigs
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import Columns
from tiegraph.sfm.rig.observations import Observations, model_observations, retriangulate
from tiegraph.sfm.tuning.rig import DiagnosticsTuning

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
    reconstruction: pycolmap.Reconstruction, scene: Scene, metres_per_unit: float, tuning: DiagnosticsTuning
) -> Resections:
    """Resect each registered image of a rig of several sensors in the points its own sensor had no part in."""
    seen = model_observations(reconstruction, scene)
    rows = []
    for key in np.unique(scene.sensor_key[seen.image]) if len(seen.image) else ():
        of_sensor = scene.sensor_key[seen.image] == key
        index = scene.rig[scene.frame[seen.image[of_sensor][0]]]
        if len(scene.rigs[index].sensors) < 2:
            continue
        others = retriangulate(seen.where(~of_sensor), tuning)
        own = seen.where(of_sensor & np.isfinite(others.xyz[seen.point]).all(axis=1))
        for image in np.unique(own.image):
            part = own.where(own.image == image)
            pose = seen.cam_from_world[image]
            sharp = others.sigma_px(part.point, pose, float(part.focal_px[0])) < tuning.max_point_spread_px
            part = part.where(sharp)
            camera = reconstruction.camera(reconstruction.find_image_with_name(scene.names[image]).camera_id)
            enough = len(part.image) >= tuning.min_points
            row = _resect(int(image), part, others.xyz, camera, tuning) if enough else None
            if row is not None:
                rows.append(row)
    return _against_rig(rows, seen, scene, reconstruction, metres_per_unit)


@dataclass(frozen=True)
class _Resected:
    """An image placed by points: covariance (6, 6) of half rotation angles, translation."""

    image: int
    inliers: int
    sigma_px: float
    cam_from_world: np.ndarray
    covariance: np.ndarray


def _resect(
    image: int,
    part: Observations,
    xyz: np.ndarray,
    camera: pycolmap.Camera,
    tuning: DiagnosticsTuning,
) -> _Resected | None:
    """The pose of an image by points alone; None with too few that agree."""
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = tuning.search_px
    options.ransac.random_seed = 0
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    points = xyz[part.point]
    found = pycolmap.estimate_and_refine_absolute_pose(part.xy, points, camera, options, refinement, True)
    if found is None or found["num_inliers"] < tuning.min_points or "covariance" not in found:
        return None
    own = matrix(found["cam_from_world"])
    points = points[found["inlier_mask"]]
    here = np.asarray(camera.img_from_cam(transforms.apply(own, points)))
    error = np.linalg.norm(here - part.xy[found["inlier_mask"]], axis=1)
    # One coordinate's sigma, from the median length of a two-dimensional normal error: 1.1774 sigma.
    sigma_px = float(np.median(error)) / 1.1774
    return _Resected(
        image=image,
        inliers=int(found["num_inliers"]),
        sigma_px=sigma_px,
        cam_from_world=own,
        covariance=found["covariance"] * max(sigma_px, tuning.least_sigma_px) ** 2,
    )


def _against_rig(
    rows: list[_Resected],
    seen: Observations,
    scene: Scene,
    reconstruction: pycolmap.Reconstruction,
    metres_per_unit: float,
) -> Resections:
    rigs = model_rigs(reconstruction, scene)
    count = len(rows)
    shift, turn = np.zeros((count, 3)), np.zeros((count, 3))
    covariance, rig_pose = np.zeros((count, 6, 6)), np.tile(np.eye(4), (count, 1, 1))
    for k, row in enumerate(rows):
        image, own = row.image, row.cam_from_world
        extrinsics = rigs[scene.rig[scene.frame[image]]].sensors[scene.sensor[image]].sensor_from_rig
        if extrinsics is not None:
            rig_pose[k] = transforms.rigid(extrinsics[:3, :3], metres_per_unit * extrinsics[:3, 3])
        rig_from_cam = rig_pose[k, :3, :3].T
        given = seen.cam_from_world[image]
        moved = given[:3, :3] @ (transforms.centre(own) - transforms.centre(given))
        shift[k] = rig_from_cam @ moved * metres_per_unit
        turn[k] = np.degrees(rig_from_cam @ Rotation.from_matrix(given[:3, :3] @ own[:3, :3].T).as_rotvec())
        # Half angles to rotation vector, pose to centre: R dc = -dt + dr x t (all in the camera); a body turned by a
        # sees the world turned by -a.
        change = np.zeros((6, 6))
        change[:3, :3] = -2 * metres_per_unit * rig_from_cam @ skew(own[:3, 3])
        change[:3, 3:] = -metres_per_unit * rig_from_cam
        change[3:, :3] = -2 * rig_from_cam
        covariance[k] = change @ row.covariance @ change.T
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)).reshape(count, 6)
    return Resections(
        image=np.array([row.image for row in rows], int),
        points=np.array([row.inliers for row in rows], int),
        rms_px=np.array([row.sigma_px for row in rows], float),
        shift_m=shift,
        turn_deg=turn,
        sigma_m=sigma[:, :3],
        sigma_deg=np.degrees(sigma[:, 3:]),
        covariance=covariance,
        rig_pose=rig_pose,
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
