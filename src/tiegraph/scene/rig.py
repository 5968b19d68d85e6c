"""Sensors and rigs: a lone camera is a rig of one, loose photographs are a rig of one with many shots.

And their pixels: rays (the only place that calls COLMAP's cameras for them), and marks in the user's image, in the
prepared one, and in copies, which are smaller or larger, or rotated by EXIF although the survey's images are not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated

import numpy as np
import pycolmap
from pydantic import PlainSerializer, PlainValidator, TypeAdapter

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import unit_rays

ROLES = ("side", "up", "wide")


def camera_to_dict(camera: pycolmap.Camera | None) -> dict | None:
    """JSON-ready form of a COLMAP camera."""
    if camera is None:
        return None
    return {
        "model": camera.model.name,
        "width": int(camera.width),
        "height": int(camera.height),
        "params": [float(p) for p in camera.params],
        "prior_focal": bool(camera.has_prior_focal_length),
    }


def camera_from_dict(data: dict | None) -> pycolmap.Camera | None:
    """Inverse of ``camera_to_dict``."""
    if data is None:
        return None
    camera = pycolmap.Camera(model=data["model"], width=data["width"], height=data["height"], params=data["params"])
    camera.has_prior_focal_length = data["prior_focal"]
    return camera


Camera = Annotated[pycolmap.Camera, PlainValidator(camera_from_dict), PlainSerializer(camera_to_dict)]
Matrix = Annotated[np.ndarray, PlainValidator(np.array), PlainSerializer(np.ndarray.tolist)]
Circle = tuple[float, float, float]
"""Image circle of a fisheye lens: centre x, y and radius, pixels."""


@dataclass(frozen=True)
class LensView:
    """For a view cut out of a fisheye image: the sensor that took it and its camera, cropped, and the rotation
    view_from_lens, row by row."""

    name: str
    lens: Camera
    rotation: tuple[float, ...]


@dataclass(frozen=True)
class Source:
    """How the files of a sensor become its prepared images, if they are not simply linked."""

    camera: Camera | None = None  # camera of the file before cropping and undistortion; None = not known
    crop_px: tuple[int, int, int, int] = (0, 0, 0, 0)  # cut off left, top, right, bottom
    upright: bool = True  # rotate by the EXIF orientation; False: keep the sensor's own rows and columns
    levels: tuple[float, float] = (0, 255)  # of a deeper file: values for 0 and 255, in all images alike
    panorama: tuple[float, ...] = ()  # of a view of an equirectangular panorama: view_from_panorama (3, 3), row by row
    view: LensView | None = None  # the file, cropped, is a fisheye image; the image is a view of it
    circle_px: Circle | None = None  # image circle in the cropped file; None = the whole file
    part: int | None = None  # which of the two images side by side in the file this is; None = the file is one

    @property
    def rendered(self) -> bool:
        """Whether the image is one of several views of its file, made with a known lens."""
        return bool(self.panorama) or self.view is not None


@dataclass(frozen=True)
class Sensor:
    """One camera of a rig."""

    name: str
    camera: Camera | None = None  # None until scan has seen an image of it
    sensor_from_rig: Matrix | None = None  # (4, 4); None = unknown
    role: str = "side"  # "up": looks at the sky or the bridge above; "wide": carries structure from motion alone
    folder: str = ""  # its folder below each pass
    source: Source | None = None  # None: the files are the images
    sigma_deg: float | None = None  # of each axis of the given rotation; None = not given
    sigma_m: float | None = None  # of each coordinate of the given position
    camera_sigma_px: float | None = None  # of the given focal length, to be adjusted; None = exact, or not given

    def soft(self) -> bool:
        """Whether its extrinsics are given with a sigma, to be adjusted about."""
        return self.sensor_from_rig is not None and bool(self.sigma_deg or self.sigma_m)

    def optical_axis(self) -> np.ndarray:
        """Unit vector (3,) of the viewing direction in the rig frame; NaN if the extrinsics are unknown."""
        if self.sensor_from_rig is None:
            return np.full(3, np.nan)
        return self.sensor_from_rig[2, :3].copy()


PAIR_KEYS = ("baseline_m", "baseline_sigma_m", "axis_deg", "axis_sigma_deg")


@dataclass(frozen=True)
class SensorPair:
    """A measurement between two sensors of a rig (paper 001: fixed baseline and optical axes); None = not measured."""

    sensors: tuple[str, str]
    baseline_m: float | None = None
    baseline_sigma_m: float | None = None
    axis_deg: float | None = None
    axis_sigma_deg: float | None = None


@dataclass(frozen=True)
class Rig:
    """Sensors bolted together; ``sensors[0]`` is the reference: its frame is the rig frame."""

    name: str
    sensors: tuple[Sensor, ...]
    fixed: bool = False  # True: the extrinsics are calibrated and must not be refined
    nominal: bool = False  # True: the extrinsics are a preset or a guess (off by degrees)
    derived: bool = False  # True: nominal by the images of the survey, in no unit: no statement on lever arms
    antenna_m: tuple[float, float, float] | None = None  # GNSS antenna in the rig frame (lever arm)
    pairs: tuple[SensorPair, ...] = ()
    synchronised: bool = False  # True: stated to fire at one instant; False: unknown

    def soft(self) -> bool:
        """Whether some of its geometry is given with a sigma, to be adjusted about; a nominal rig's is a guess."""
        return not (self.fixed or self.nominal) and (bool(self.pairs) or any(s.soft() for s in self.sensors[1:]))

    @property
    def mounted(self) -> int:
        """Number of sensors with extrinsics."""
        return sum(s.sensor_from_rig is not None for s in self.sensors)

    def known(self) -> bool:
        """Whether every sensor has extrinsics."""
        return self.mounted == len(self.sensors)

    def measured(self) -> bool:
        """Whether it comes from a calibration: stated, or with measured intrinsics and not called nominal."""
        given = all(s.camera is not None and calibrated(s.camera) and not s.camera_sigma_px for s in self.sensors)
        return self.fixed or (not self.nominal and given)

    def stitched(self) -> bool:
        """Whether its cameras are views of panoramas: differences between them come from the stitching."""
        return all(s.source is not None and s.source.panorama for s in self.sensors)

    def axis_angles_deg(self) -> np.ndarray:
        """(S, S) angles between the optical axes, NaN where unknown."""
        axes = np.stack([s.optical_axis() for s in self.sensors])
        return np.degrees(np.arccos(np.clip(axes @ axes.T, -1, 1)))

    def scaled(self, factor: float) -> "Rig":
        """With the lengths of its extrinsics times a factor."""
        poses = [s.sensor_from_rig for s in self.sensors]
        found = [None if p is None else transforms.rigid(p[:3, :3], factor * p[:3, 3]) for p in poses]
        return replace(self, sensors=tuple(replace(s, sensor_from_rig=p) for s, p in zip(self.sensors, found)))

    def units(self, given: "Rig") -> float:
        """Its units in one of the same rig as given, by the median baseline."""
        pairs = [(s.sensor_from_rig, g.sensor_from_rig) for s, g in zip(self.sensors, given.sensors)]
        known = [(a, b) for a, b in pairs if a is not None and b is not None and np.linalg.norm(b[:3, 3]) > 0]
        ratios = [np.linalg.norm(a[:3, 3]) / np.linalg.norm(b[:3, 3]) for a, b in known]
        return float(np.median(ratios)) if ratios else 1.0

    def index(self, sensor_name: str) -> int:
        """Index of a sensor by name."""
        return [s.name for s in self.sensors].index(sensor_name)


def calibrated(camera: pycolmap.Camera) -> bool:
    """Whether a camera's intrinsics were measured. EXIF gives a focal length too, but the middle as principal point."""
    middle = camera.principal_point_x == camera.width / 2 and camera.principal_point_y == camera.height / 2
    return camera.has_prior_focal_length and not middle


@cache
def _rigs() -> TypeAdapter[Rig]:
    return TypeAdapter(Rig)


def rig_to_dict(rig: Rig) -> dict:
    """JSON-ready form of a rig."""
    return _rigs().dump_python(rig, mode="json")


def rig_from_dict(data: dict) -> Rig:
    """Inverse of ``rig_to_dict``; missing values are those of a new rig."""
    return _rigs().validate_python(data)


def on_plane(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """(K, 2) places on the plane z = 1 of the camera's frame of pixels (K, 2); NaN where its lens has no inverse.

    For pixels 90 degrees off the axis of a fisheye lens and more, which have none, COLMAP gives places far inside.
    """
    xy = np.asarray(xy, float)
    plane = np.asarray(camera.cam_from_img(xy), float)
    if "FISHEYE" in camera.model.name and len(plane):
        back = np.asarray(camera.img_from_cam(np.column_stack([plane, np.ones(len(plane))])), float)
        plane[~(np.abs(back - xy).max(axis=1) < 0.5)] = np.nan  # between a pixel and its back-projection
    return plane


def pixel_rays(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """(K, 3) unit rays of pixels (K, 2) in the camera's frame; NaN where its lens has no inverse."""
    return unit_rays(on_plane(camera, xy))


def rays_or_axis(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """As ``pixel_rays``, with the optical axis where the lens has no inverse."""
    return unit_rays(np.nan_to_num(on_plane(camera, xy)))


EDGE_PX = 1.0  # tolerance of a mark outside its image: programs count from the pixel's centre or corner


@dataclass(frozen=True)
class Copy:
    """The images in which marks were made: ``size`` times as large as the user's, and ``turned`` if EXIF rotates the
    survey's (or not, if the survey's are left as the sensor has them)."""

    size: float = 1.0
    turned: bool = False

    def pixel(self, xy: tuple[float, float], sensor: Sensor, orientation: int) -> tuple[float, float]:
        """Pixel in the image of the sensor, upright if that is, of a mark in the copy."""
        x, y = xy[0] / self.size, xy[1] / self.size
        camera, source = file_camera(sensor), sensor.source or Source()
        if not self.turned or camera is None:
            return x, y
        size = (camera.height, camera.width) if orientation >= 5 else (camera.width, camera.height)  # of the copy
        turn = orientation if source.upright else {6: 8, 8: 6}.get(orientation, orientation)  # EXIF's, to upright
        x = size[0] - x if turn in (2, 3, 7, 8) else x
        y = size[1] - y if turn in (3, 4, 6, 7) else y
        return (y, x) if turn >= 5 else (x, y)

    def like(self, other: "Copy") -> bool:
        """Whether it has nearly the same size and the same orientation."""
        return self.turned == other.turned and 0.9 < self.size / other.size < 1 / 0.9

    def __str__(self) -> str:
        return f"{self.size:.4g} times as large" + (
            ", with another EXIF orientation than the survey's" if self.turned else ""
        )


AS_IS = Copy()


def file_camera(sensor: Sensor) -> pycolmap.Camera | None:
    """The camera of the user's image; None if its size is unknown."""
    source = sensor.source or Source()
    return None if source.rendered else source.camera or sensor.camera


def within(xy: Sequence[float], camera: pycolmap.Camera | None) -> bool:
    """Whether a pixel is in the image of a camera, or at its edge; it is if the camera is unknown."""
    return (
        camera is None or -EDGE_PX <= xy[0] <= camera.width + EDGE_PX and -EDGE_PX <= xy[1] <= camera.height + EDGE_PX
    )


def prepared_pixel(xy: tuple[float, float], sensor: Sensor) -> tuple[float, float]:
    """Pixel in the prepared image of a mark in the user's upright image: cropped and undistorted like it."""
    return _moved(xy, sensor, 1)


def source_pixel(xy: tuple[float, float], sensor: Sensor) -> tuple[float, float]:
    """Pixel in the user's upright image of a pixel of the prepared one: the inverse of ``prepared_pixel``."""
    return _moved(xy, sensor, -1)


def _moved(xy: tuple[float, float], sensor: Sensor, way: int) -> tuple[float, float]:
    """From the user's image into the prepared one, or back (``way`` -1)."""
    source = sensor.source or Source()
    if source.view is not None:  # a mark of a view
        return xy
    user, own = source.camera, sensor.camera
    if user is not None and own is not None and not user.is_undistorted() and own.is_undistorted():
        one, other = (user, own)[::way]
        place = on_plane(one, np.array([xy]))[0]
        moved = other.img_from_cam(np.append(place, 1.0)) if np.isfinite(place).all() else None
        if moved is not None:
            return float(moved[0]), float(moved[1])
    left, top, _, _ = source.crop_px
    return xy[0] - way * left, xy[1] - way * top
