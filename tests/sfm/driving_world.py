"""A vehicle with six cameras on a street: rig and lenses as they are, as they are given, and when each camera fires."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

# Places (x right, y down, z forward, metres), yaw in degrees and focal length of a car's six cameras.
PLACES = (
    [0, 0, 0],
    [-0.65, 0.27, 0.67],
    [-0.54, 0.22, -0.3],
    [0.02, 0.15, -1.1],
    [0.69, 0.27, -0.26],
    [0.6, 0.22, 0.63],
)
YAWS = (0.0, -57.0, -91.0, 179.0, 89.0, 58.0)
FOCAL_PX = (600.0, 300.0, 300.0, 300.0, 300.0, 300.0)
LATE_S = (0.0, -0.011, -0.031, -0.050, 0.031, 0.011)  # as the lidar's sweep fires them
INTERVAL_S = 0.1


@dataclass(frozen=True)
class Drive:
    """What is true, and what the rig file says otherwise."""

    late_s: Sequence[float] = (0.0,) * 6
    speed: float = 5.0  # m/s
    gain: float = 0.0  # m/s2
    weave_deg: float = 1.0  # of the heading, once in 3 s: nobody drives straight as a die
    frames: int = 24
    bent: tuple[int, float] = (0, 0.0)  # camera, degrees by which it is turned (to the right) and the file does not say
    longer: float = 1.0  # true levers over given ones
    zoom: tuple[int, float] = (0, 1.0)  # camera, true focal length over the given one
    noise_px: float = 0.4
    cameras: int = 6
    seed: int = 5

    def pose_at(self, time_s: float) -> np.ndarray:
        """world_from_rig (4, 4)."""
        along = self.speed * time_s + 0.5 * self.gain * time_s**2
        heading = np.radians(self.weave_deg) * np.sin(2 * np.pi * time_s / 3)
        aside = -self.speed * np.radians(self.weave_deg) * 3 / (2 * np.pi) * np.cos(2 * np.pi * time_s / 3)
        return transforms.rigid(orient(float(np.degrees(heading)), 0, 0), np.array([aside, 0.0, along]))


def driving_world(drive: Drive) -> tuple[pycolmap.Reconstruction, Scene]:
    """Model of the true frames with the rig and the lenses as given, for an adjustment to start from; its scene."""
    rng = np.random.default_rng(drive.seed)
    cameras, given, true = [], [], []
    for s in range(drive.cameras):
        f = FOCAL_PX[s]
        cameras.append(pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[f, f, 320.0, 240.0]))
        turn = drive.bent[1] if s == drive.bent[0] else 0.0
        place = np.array(PLACES[s], float)
        given.append(transforms.invert(transforms.rigid(orient(YAWS[s], 0, 0), place)))
        true.append(transforms.invert(transforms.rigid(orient(YAWS[s] + turn, 0, 0), drive.longer * place)))
    points = _street(rng, drive)
    model = _rigged(cameras, given)
    tracks: dict[int, list[tuple[int, int]]] = {}
    for f in range(drive.frames):
        frame = pycolmap.Frame(frame_id=f + 1, rig_id=1)
        images = []
        for s in range(drive.cameras):
            image = pycolmap.Image(name=f"cam{s}/{f:03d}.jpg", camera_id=s + 1, image_id=1 + drive.cameras * f + s)
            image.frame_id = f + 1
            pose = true[s] @ transforms.invert(drive.pose_at(INTERVAL_S * f + drive.late_s[s]))
            lens = copy(cameras[s])
            zoom = drive.zoom[1] if s == drive.zoom[0] else 1.0
            lens.params = [zoom * lens.params[0], zoom * lens.params[1], *lens.params[2:]]
            seen, xy = _sighted(lens, pose, points, rng, drive.noise_px)
            image.points2D = pycolmap.Point2DList([pycolmap.Point2D(p) for p in xy])
            for row, point in enumerate(seen):
                tracks.setdefault(int(point), []).append((image.image_id, row))
            frame.add_data_id(image.data_id)
            images.append(image)
        frame.rig_from_world = rigid3d(transforms.invert(drive.pose_at(INTERVAL_S * f)))
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(f + 1)
    for point, elements in tracks.items():
        if len(elements) > 2:
            model.add_point3D(points[point], pycolmap.Track([pycolmap.TrackElement(*e) for e in elements]))
    rig = Rig("car", tuple(Sensor(f"cam{s}", c, p) for s, (c, p) in enumerate(zip(cameras, given))), fixed=True)
    return model, _scene(rig, drive)


def with_sync(scene: Scene) -> Scene:
    """The same survey with a rig whose file says that its cameras fire at one instant."""
    return scene.with_(rigs=(replace(scene.rigs[0], synchronised=True),))


def true_scale(model: pycolmap.Reconstruction, drive: Drive) -> float:
    """Metres on the road of a unit of the model's path (reference camera)."""
    ends = (1, 1 + drive.cameras * (drive.frames - 1))
    centres = [model.image(k).projection_center() for k in ends]
    true = [drive.pose_at(INTERVAL_S * f)[:3, 3] for f in (0, drive.frames - 1)]
    return float(np.linalg.norm(true[1] - true[0]) / np.linalg.norm(centres[1] - centres[0]))


def _street(rng: np.random.Generator, drive: Drive) -> np.ndarray:
    end = float(drive.pose_at(INTERVAL_S * drive.frames)[2, 3])
    count = int(15 * (end + 40))
    points = rng.uniform([-16, -5, -25], [16, 2, end + 25], (count, 3))
    return points[np.abs(points[:, 0]) > 4]


def _rigged(cameras: Sequence[pycolmap.Camera], places: Sequence[np.ndarray]) -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    row = pycolmap.Rig(rig_id=1)
    for s, (camera, place) in enumerate(zip(cameras, places)):
        own = copy(camera)
        own.camera_id = s + 1
        model.add_camera(own)
        identity = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, s + 1)
        row.add_ref_sensor(identity) if s == 0 else row.add_sensor(identity, rigid3d(place))
    model.add_rig(row)
    return model


def _sighted(
    camera: pycolmap.Camera, pose: np.ndarray, points: np.ndarray, rng: np.random.Generator, noise_px: float
) -> tuple[np.ndarray, np.ndarray]:
    local = transforms.apply(pose, points)
    ahead = np.flatnonzero((local[:, 2] > 1) & (local[:, 2] < 22))
    xy = camera.img_from_cam(local[ahead])
    inside = ((xy > 0) & (xy < [camera.width, camera.height])).all(axis=1) & (rng.random(len(ahead)) < 0.6)
    return ahead[inside], xy[inside] + noise_px * rng.standard_normal((inside.sum(), 2))


def _scene(rig: Rig, drive: Drive) -> Scene:
    count = len(rig.sensors)
    table = sorted((f"cam{s}/{f:03d}.jpg", f, s) for f in range(drive.frames) for s in range(count))
    names, frame, sensor = zip(*table)
    time = INTERVAL_S * np.arange(drive.frames)
    return simple_scene(
        rig, list(names), np.array(frame), np.array(sensor), np.zeros(drive.frames), sequences=("road",), time_s=time
    )
