"""A camera head that is driven through the corridor of ``worlds``: rendered once for all tests of a process."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import Cameras
from tiegraph.odometry.odometry import Odometry, OdometryPath, path_of
from tiegraph.odometry.tuning import Tuning
from tiegraph.scene.rig import Rig, Sensor
from worlds import corridor

SIZE = (320, 240)
FRAMES = 24
BASELINE_M = 0.3
_STEP_M = 0.2
_NOISE = 2.0  # grey levels


def camera() -> pycolmap.Camera:
    """Pinhole, 65 degrees wide."""
    width, height = SIZE
    params = [250.0, 250.0, width / 2 + 2, height / 2 - 3]
    made = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=params)
    made.has_prior_focal_length = True
    return made


def stereo() -> Cameras:
    """Two cameras side by side that look forward."""
    right = transforms.rigid(np.eye(3), [-BASELINE_M, 0, 0])
    return Cameras(("left", "right"), (camera(), camera()), np.stack([np.eye(4), right]))


def apart(aside_deg: float, radius_m: float) -> Cameras:
    """Two cameras turned to the left and to the right, on a circle."""
    turns = [Rotation.from_euler("y", a, degrees=True).as_matrix() for a in (aside_deg, -aside_deg)]
    poses = [transforms.rigid(t, [0, 0, radius_m]) for t in turns]
    both = np.stack([p @ transforms.invert(poses[0]) for p in poses])
    return Cameras(("port", "starboard"), (camera(), camera()), both)


def rig_of(cameras: Cameras) -> Rig:
    """The cameras as a rig of a survey."""
    each = zip(cameras.names, cameras.models, cameras.sensor_from_rig)
    return Rig("head", tuple(Sensor(n, m, p, folder=n) for n, m, p in each), fixed=True)


def single() -> Cameras:
    """The left one alone."""
    return Cameras(("left",), (camera(),), np.eye(4)[None])


def truth(frame: int) -> np.ndarray:
    """(4, 4) world_from_rig: along the corridor, swaying and turning a little."""
    at = _STEP_M * frame
    yaw, roll = 0.12 * np.sin(at / 1.3), 0.03 * np.sin(at / 0.7)
    forward = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # camera's right, down, forward in the corridor's axes
    turn = Rotation.from_euler("yz", [yaw, roll]).as_matrix()
    return transforms.rigid(forward @ turn, [at, 0.3 * np.sin(at), 1.6 + 0.05 * np.cos(2 * at)])


@cache
def _rendered(frame: int, sensor_from_rig: tuple[float, ...]) -> np.ndarray:
    pose = np.reshape(sensor_from_rig, (4, 4))
    colour = corridor(3, length_m=20.0).render(camera(), pose @ transforms.invert(truth(frame)))
    seed = [frame, int(1000 * abs(pose[0, 3]))]
    noise = np.random.default_rng(seed).normal(0, _NOISE, colour.shape[:2])
    return np.clip(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY) + noise, 0, 255).astype(np.uint8)


def images(cameras: Cameras, frame: int) -> dict[int, np.ndarray]:
    """Camera -> grey image of a frame of the drive."""
    return {c: _rendered(frame, tuple(pose.ravel().tolist())) for c, pose in enumerate(cameras.sensor_from_rig)}


def drive(
    cameras: Cameras, frames: list[int], dark: tuple[int, ...] = (), tuning: Tuning | None = None
) -> OdometryPath:
    """The odometry of a drive over frames, at some places of which the images are black."""
    tuning = tuning or Tuning()

    def seen(place: int) -> dict[int, np.ndarray]:
        found = images(cameras, frames[place])
        return {c: np.zeros_like(i) for c, i in found.items()} if place in dark else found

    odometry = Odometry(cameras, lambda place, c: seen(place)[c], tuning)
    for place in range(len(frames)):
        odometry.add(place, seen(place))
    odometry.finish()
    return path_of(odometry, range(len(frames)), tuning.map)


def true_path(frames: list[int]) -> np.ndarray:
    """(F, 4, 4) in the world of the first."""
    poses = np.stack([truth(f) for f in frames])
    return transforms.invert(poses[0]) @ poses
