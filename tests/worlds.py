"""Synthetic surveys with exact truth, rendered in a moment: a textured corridor seen by a rig, with a return pass.

The corridor runs along x between two walls with boxes before them, on a textured floor, below a plain sky. Nothing
repeats: every face has its own random texture. The renderer casts one ray a (sub)pixel, so that poses, depths and
calibration are exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin, geodetic_from_world
from tiegraph.scene.rig import Rig, Sensor

SKY_BGR = (235, 215, 190)
ORIGIN = Origin(35.6965, 139.7695, 40.0)
START_TIME_S = 36000.0
_OVERSAMPLE = 2
_HEADING_DEG = 80.0  # of the rig's cameras, from the direction of travel
_TABLE = 256  # side of the random tables behind the textures; they repeat after this many cells, farther than any face


@dataclass(frozen=True)
class Corridor:
    """Axis-aligned boxes (B, 2, 3) low and high corners; every face has a texture of its own, drawn from ``seed``."""

    boxes_m: np.ndarray
    seed: int

    def render(self, camera: pycolmap.Camera, cam_from_world: np.ndarray) -> np.ndarray:
        """Image (H, W, 3) u1 BGR of a pinhole camera, antialiased."""
        n = _OVERSAMPLE
        depth, face, direction = self._cast(camera, cam_from_world, n)
        hit = np.isfinite(depth)
        centre = transforms.centre(cam_from_world).astype(np.float32)
        points = centre[:, None, None] + np.where(hit, depth, 0) * direction
        colour = np.where(hit, self._texture(points, face), np.array(SKY_BGR, np.float32)[:, None, None])
        image = sum(colour[:, i::n, j::n] for i in range(n) for j in range(n)) / np.float32(n * n)
        return np.clip(image + 0.5, 0, 255).astype(np.uint8).transpose(1, 2, 0).copy()

    def depth_m(self, camera: pycolmap.Camera, cam_from_world: np.ndarray) -> np.ndarray:
        """Depth (H, W) f4 along the optical axis at the pixel centres, inf = sky."""
        return self._cast(camera, cam_from_world, 1)[0]

    def _cast(self, camera: pycolmap.Camera, cam_from_world: np.ndarray, n: int) -> tuple[np.ndarray, ...]:
        """Depth (h, w), face (h, w) = 6 * box + 2 * axis + side, direction (3, h, w) at n x n points a pixel. Planes of
        one axis each: numpy is slow along an axis of three."""
        k = camera.calibration_matrix()
        u, v = ((np.arange(length * n) + 0.5) / n for length in (camera.width, camera.height))
        x, y = np.meshgrid((u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1])
        world_from_cam = transforms.invert(cam_from_world)
        # Depth 1 along the axis = length 1 of these directions, so the ray parameter is the depth itself.
        direction = np.stack([x, y, np.ones_like(x)], axis=-1) @ world_from_cam[:3, :3].T
        direction = np.moveaxis(direction, -1, 0).astype(np.float32, order="C")
        origin = world_from_cam[:3, 3].astype(np.float32)
        with np.errstate(divide="ignore"):
            inverse = 1 / direction
        depth, face = np.full(x.shape, np.inf, np.float32), np.full(x.shape, -1)
        for box in range(len(self.boxes_m)):
            window = self._window(box, k, cam_from_world, x.shape, n)
            if window is not None:
                self._enter(box, origin, inverse[(slice(None), *window)], depth[window], face[window])
        return depth, face, direction

    def _window(
        self, box: int, k: np.ndarray, cam_from_world: np.ndarray, shape: tuple[int, ...], n: int
    ) -> tuple[slice, slice] | None:
        """Rows and columns where a box can be seen; None = nowhere."""
        corners = self.boxes_m[box][[[i, j, m] for i in (0, 1) for j in (0, 1) for m in (0, 1)], [0, 1, 2]]
        seen = transforms.apply(cam_from_world, corners)
        if (seen[:, 2] <= 0).all():
            return None
        if (seen[:, 2] < 0.01).any():
            return slice(0, shape[0]), slice(0, shape[1])
        pixel = (seen @ k.T)[:, :2] / seen[:, 2:] * n
        low, high = np.floor(pixel.min(axis=0)).astype(int), np.ceil(pixel.max(axis=0)).astype(int)
        low, high = np.maximum(low, 0), np.minimum(high, shape[::-1])
        return (slice(low[1], high[1]), slice(low[0], high[0])) if (low < high).all() else None

    def _enter(self, box: int, origin: np.ndarray, inverse: np.ndarray, depth: np.ndarray, face: np.ndarray) -> None:
        """Put a box into the views ``depth`` and ``face`` where its surface is the nearest so far (slab method);
        ``inverse`` (3, h, w): of the directions."""
        low, high = (c[:, None, None] for c in self.boxes_m[box].astype(np.float32))
        t0, t1 = (low - origin[:, None, None]) * inverse, (high - origin[:, None, None]) * inverse
        near, far = np.minimum(t0, t1), np.maximum(t0, t1)
        enter = np.maximum(np.maximum(near[0], near[1]), near[2])
        leave = np.minimum(np.minimum(far[0], far[1]), far[2])
        closer = (enter > 0) & (enter < leave) & (enter < depth)
        depth[closer] = enter[closer]
        axis = near[:, closer].argmax(axis=0)
        face[closer] = 6 * box + 2 * axis + (np.take_along_axis(inverse[:, closer], axis[None], axis=0)[0] < 0)

    def _texture(self, points: np.ndarray, face: np.ndarray) -> np.ndarray:
        """BGR (3, h, w) f4 of surface points (3, h, w): blocks of two sizes and smooth noise, all random."""
        axis = face // 2 % 3
        u = np.where(axis == 0, points[1], points[0])
        v = np.where(axis == 2, points[1], points[2])
        rng = np.random.default_rng(self.seed)
        tables = rng.random((4, _TABLE, _TABLE), np.float32)
        shift = (_TABLE * rng.random((2, 6 * len(self.boxes_m)), np.float32))[:, face]
        tint = (rng.random((6 * len(self.boxes_m), 3), np.float32) - 0.5).T[:, face]
        grey = 0.30 * _blocks(tables[0], u / 0.9 + shift[0], v / 0.9 + shift[1])
        grey += 0.30 * _blocks(tables[1], u / 0.31 + shift[0], v / 0.31 + shift[1])
        grey += 0.25 * _smooth(tables[2], u / 0.23 + shift[0], v / 0.23 + shift[1])
        grey += 0.15 * _smooth(tables[3], u / 0.09 + shift[0], v / 0.09 + shift[1])
        return np.clip(128 + 400 * (grey - 0.5) + 40 * tint, 0, 255)


def _blocks(table: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    row, column = (np.floor(c).astype(np.int32) % _TABLE for c in (y, x))
    return table.ravel()[row * _TABLE + column]


def _smooth(table: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x, y = (c - _TABLE * np.floor(c / _TABLE) for c in (x, y))
    return cv2.remap(table, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


@dataclass(frozen=True)
class Survey:
    """A rendered survey. ``cam_from_world``: name -> (4, 4); world = east, north, up about ORIGIN, metres."""

    images: Path
    world: Corridor
    rig: Rig  # calibrated: cameras and extrinsics as rendered
    cam_from_world: Mapping[str, np.ndarray]
    world_from_rig: Mapping[str, np.ndarray]  # "<pass>/<frame>" -> (4, 4)
    times_s: Mapping[str, float]  # "<pass>/<frame>" -> time

    def centres_m(self, names: list[str]) -> np.ndarray:
        """True projection centres (N, 3)."""
        return np.stack([transforms.centre(self.cam_from_world[n]) for n in names])


def corridor(seed: int = 0, length_m: float = 16.0) -> Corridor:
    """Walls at y = +-4 m, 4 m high, boxes of 0.5-1.3 m depth before them, floor at z = 0."""
    rng = np.random.default_rng(seed)
    low, high = -6.0, length_m + 6.0
    boxes = [((low, -9, -1), (high, 9, 0)), ((low, 4, 0), (high, 5, 4)), ((low, -5, 0), (high, -4, 4))]
    boxes += [((high, -5, 0), (high + 1, 5, 4)), ((low - 1, -5, 0), (low, 5, 4))]
    for side in (-1, 1):
        x = low + rng.uniform(0, 1)
        while x < high - 2:
            width, depth, top = rng.uniform((0.6, 0.5, 1.0), (1.6, 1.3, 3.5))
            boxes.append(
                ((x, min(side * 4, side * (4 - depth)), 0), (x + width, max(side * 4, side * (4 - depth)), top))
            )
            x += width + rng.uniform(0.6, 2.0)
    return Corridor(np.array(boxes, float), seed)


def two_camera_rig(width: int = 320, height: int = 240) -> Rig:
    """cam0 looks to port, cam1 to starboard of a rig that moves along its own +x; 10 degrees forward, 74 wide."""
    focal = 0.66 * width
    params = [focal, focal, width / 2, height / 2]
    sensors: list[Sensor] = []
    reference = None
    for name, heading_deg in (("cam0", _HEADING_DEG), ("cam1", -_HEADING_DEG)):
        camera = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=params)
        camera.has_prior_focal_length = True
        a = np.radians(heading_deg)
        # Rows are the camera's axes in the body frame (x forward, y port, z up): right, down, forward.
        rotation = np.array([[np.sin(a), -np.cos(a), 0], [0, 0, -1], [np.cos(a), np.sin(a), 0]])
        centre = np.array([0.1, 0.25 * np.sign(heading_deg), 0.0])
        cam_from_body = transforms.rigid(rotation, -rotation @ centre)
        reference = cam_from_body if reference is None else reference
        sensors.append(Sensor(name, camera, cam_from_body @ transforms.invert(reference), folder=name))
    return Rig("pair", tuple(sensors), fixed=True)


def body_poses(track: str, frames: int, seed: int) -> np.ndarray:
    """(F, 4, 4) world_from_body: along the corridor, or back along it on the other side, with some sway."""
    rng = np.random.default_rng([seed, 0 if track == "up" else 1])
    s = np.arange(frames) * 1.5
    sway, yaw = 0.25 * np.sin(s / 3 + rng.uniform(0, 6)), np.radians(rng.uniform(-3, 3, frames))
    x, y = (s, -0.6 + sway) if track == "up" else (s[::-1] + 0.6, 0.6 + sway)
    yaw = yaw + (0 if track == "up" else np.pi)
    rotation = np.zeros((frames, 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(yaw)
    rotation[:, 1, 0], rotation[:, 0, 1] = np.sin(yaw), -np.sin(yaw)
    rotation[:, 2, 2] = 1
    return transforms.rigid(rotation, np.stack([x, y, np.full(frames, 1.7) + rng.uniform(-0.05, 0.05, frames)], axis=1))


def make_survey(
    folder: Path,
    passes: tuple[str, ...] = ("up", "down"),
    frames: int = 6,
    size: tuple[int, int] = (320, 240),
    seed: int = 0,
) -> Survey:
    """Render ``folder``/<pass>/cam<k>/<frame>.jpg: 2 cameras x ``frames`` x passes; "down" is the way back."""
    rig, world = two_camera_rig(*size), corridor(seed, length_m=1.5 * frames)
    # The rig frame is that of its first sensor; the body poses are turned into it.
    poses, rigs, times = {}, {}, {}
    for k, track in enumerate(passes):
        for f, world_from_body in enumerate(body_poses(track, frames, seed)):
            key = f"{track}/{f:06d}"
            rigs[key] = world_from_body @ body_from_rig()
            times[key] = START_TIME_S + 200.0 * k + f
            for sensor in rig.sensors:
                name = f"{track}/{sensor.name}/{f:06d}.jpg"
                assert sensor.sensor_from_rig is not None and sensor.camera is not None
                poses[name] = sensor.sensor_from_rig @ transforms.invert(rigs[key])
                image = world.render(sensor.camera, poses[name])
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(folder / name), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return Survey(folder, world, rig, poses, rigs, times)


def body_from_rig() -> np.ndarray:
    """(4, 4) from the rig frame (cam0: right, down, forward) to the body frame (forward, port, up)."""
    a = np.radians(_HEADING_DEG)
    rotation = np.array([[np.sin(a), -np.cos(a), 0], [0, 0, -1], [np.cos(a), np.sin(a), 0]])
    return transforms.rigid(rotation.T, np.array([0.1, 0.25, 0.0]))


def write_gnss(survey: Survey, path: Path, sigma_m: float = 0.02, seed: int = 0) -> Path:
    """GNSS of the rig's reference camera at every frame, with noise: time,lat,lon,height,sigma_h,sigma_v."""
    rng = np.random.default_rng(seed)
    rows = ["time,lat,lon,height,sigma_h,sigma_v"]
    for key in sorted(survey.times_s, key=lambda k: survey.times_s[k]):
        at = survey.world_from_rig[key][:3, 3] + rng.normal(0, sigma_m, 3)
        lat, lon, height = geodetic_from_world(at, ORIGIN)[0]
        rows.append(f"{survey.times_s[key]:.3f},{lat:.10f},{lon:.10f},{height:.4f},{sigma_m},{sigma_m}")
    path.write_text("\n".join(rows) + "\n")
    return path


def write_times(survey: Survey, path: Path) -> Path:
    """Times of the frames: pass,frame,time."""
    rows = [f"{key.replace('/', ',')},{time_s:.3f}" for key, time_s in sorted(survey.times_s.items())]
    path.write_text("\n".join(["pass,frame,time", *rows]) + "\n")
    return path
