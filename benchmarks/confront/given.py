"""What a user hands over, in memory, so that a fault can change it: images, rig, positions, times; and the truth."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
import pycolmap

from benchmarks.datasets import Dataset
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin, geodetic_from_world, world_from_geodetic
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.rig import Rig, Sensor

_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 95]


@dataclass(frozen=True)
class Picture:
    """An image file, and what is done to it: blurred, or made anew a ``share`` of the way to the picture ``after``;
    ``keystone_px``: seen by a lens about another axis than its calibration says, so far off in the corners."""

    file: Path
    blur_px: float = 0.0
    keystone_px: float = 0.0
    after: Path | None = None
    share: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether the file itself is the image."""
        return self.blur_px <= 0 and self.after is None and not self.keystone_px


@dataclass(frozen=True)
class Positions:
    """Rows of a receiver: time (G,) s, place (G, 3) east, north, up metres about ``origin``, sigma (G, 2) in plan, in
    height."""

    time_s: np.ndarray
    enu_m: np.ndarray
    sigma_m: np.ndarray
    origin: Origin


@dataclass(frozen=True)
class Truth:
    """What only the judge sees.

    ``cam_from_world``: image -> (4, 4), an image without one has no true place in the survey. ``origin``: where that
    world is on the Earth, None = not known. ``focal_px``: sensor -> focal length. ``sigma_m``, ``sigma_deg``: how well
    the truth itself is known (of a position; of an orientation).
    """

    cam_from_world: Mapping[str, np.ndarray]
    origin: Origin | None = None
    focal_px: Mapping[str, float] = field(default_factory=dict)
    sigma_m: float = 0.0
    sigma_deg: float = 0.0


@dataclass(frozen=True)
class Given:
    """What a user hands over. ``times``: image -> seconds. ``strangers``: images that do not belong to the survey."""

    images: Mapping[str, Picture]
    truth: Truth
    rig: Rig | None = None
    positions: Positions | None = None
    times: Mapping[str, float] = field(default_factory=dict)
    strangers: tuple[str, ...] = ()

    def folders(self) -> dict[str, str]:
        """Image -> the folder of its camera, as the rig names it ("" for the only camera)."""
        known = {s.folder for s in self.rig.sensors} if self.rig else set()
        out = {}
        for name in self.images:
            parts = PurePosixPath(name).parts[:-1]
            out[name] = next((p for p in reversed(parts) if p in known), "")
        return out

    def in_order(self) -> list[tuple[str, str]]:
        """(pass, frame) of every frame in the order of the names: the part before the camera's folder, the rest."""
        return sorted({self.frame_of(n) for n in self.images})

    def frame_of(self, name: str) -> tuple[str, str]:
        """(pass, frame) of an image, by its name."""
        parts = list(PurePosixPath(name).parts)
        folder = self.folders_of_rig()
        rest = [p for p in parts[:-1] if p not in folder]
        return "/".join(rest), parts[-1]

    def folders_of_rig(self) -> set[str]:
        """Names of the folders of cameras."""
        return {s.folder for s in self.rig.sensors} if self.rig else set()


def of_dataset(dataset: Dataset, focal_px: Mapping[str, float] | None = None) -> Given:
    """The survey of ``benchmarks/datasets.py`` in memory; ``focal_px`` by sensor where the set gives no calibration."""
    images = {n: Picture(dataset.images / n) for n in sorted(dataset.cam_from_world)}
    rig = _rig(dataset) if dataset.rig else None
    known = dict(focal_px or {})
    for sensor in rig.sensors if rig else ():
        if sensor.camera is not None:
            known.setdefault(sensor.name, sensor.camera.mean_focal_length())
    truth = Truth(dict(dataset.cam_from_world), dataset.truth_origin, known)
    times = _times(dataset.times) if dataset.times else {}
    return Given(images, truth, rig, read_positions(dataset.gnss) if dataset.gnss else None, times)


def _rig(dataset: Dataset) -> Rig:
    (spec,) = read_rig_file(dataset.rig, RigTuning())
    sensors, first = [], spec.sensors[0].body_from_sensor
    for sensor in spec.sensors:
        folder = sensor.name if sensor.folder is None else sensor.folder
        camera = dataset.cameras.get(folder)
        pose = None
        if first is not None and sensor.body_from_sensor is not None:
            pose = transforms.invert(sensor.body_from_sensor) @ first
        sensors.append(Sensor(sensor.name, camera, pose, sensor.role, folder))
    return Rig(spec.name, tuple(sensors), fixed=bool(spec.fixed), nominal=bool(spec.nominal))


def _times(path: Path) -> dict[str, float]:
    with path.open(newline="") as stream:
        return {row["image"]: float(row["time"]) for row in csv.DictReader(stream)}


def read_positions(path: Path) -> Positions:
    """A GNSS file with the columns time, lat, lon, height, sigma_h, sigma_v, about its first row."""
    with path.open(newline="") as stream:
        rows = [[float(r[c]) for c in _COLUMNS] for r in csv.DictReader(stream)]
    table = np.array(rows)
    origin = Origin(*(float(v) for v in table[0, 1:4]))
    return Positions(table[:, 0], world_from_geodetic(table[:, 1:4], origin), table[:, 4:6], origin)


_COLUMNS = ("time", "lat", "lon", "height", "sigma_h", "sigma_v")


def write(given: Given, folder: Path, images: Path | None = None) -> dict[str, Path]:
    """Write what a user hands over below ``folder``: {"images": ..., "rig": ..., "gnss": ..., "times": ...}.

    ``images``: a folder that holds these very images already.
    """
    folder.mkdir(parents=True, exist_ok=True)
    out = {"images": images or _write_images(given, folder / "images")}
    if given.rig is not None:
        out["rig"] = folder / "rig.toml"
        write_rig_toml(given.rig, out["rig"])
    if given.positions is not None:
        out["gnss"] = folder / "gnss.csv"
        write_positions(given.positions, out["gnss"])
    if given.times:
        out["times"] = folder / "times.csv"
        rows = [f"{name},{time_s:.6f}" for name, time_s in given.times.items()]
        out["times"].write_text("\n".join(["image,time", *rows]) + "\n")
    return out


def write_positions(positions: Positions, path: Path) -> None:
    """A GNSS file that ``read_positions`` reads."""
    places = geodetic_from_world(positions.enu_m, positions.origin)
    rows = [",".join(_COLUMNS)]
    for t, (lat, lon, height), (plan, up) in zip(positions.time_s, places, positions.sigma_m):
        rows.append(f"{t:.6f},{lat:.10f},{lon:.10f},{height:.4f},{plan:.4f},{up:.4f}")
    path.write_text("\n".join(rows) + "\n")


def _write_images(given: Given, folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    for name, picture in given.images.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if picture.plain:
            shutil.copyfile(picture.file, target)
        else:
            cv2.imwrite(str(target), made(picture), _QUALITY)
    return folder


def made(picture: Picture) -> np.ndarray:
    """The pixels (H, W[, 3]) of a picture that is not a file as it is."""
    pixels = cv2.imread(str(picture.file), cv2.IMREAD_UNCHANGED)
    if picture.after is not None:
        pixels = between(pixels, cv2.imread(str(picture.after), cv2.IMREAD_UNCHANGED), picture.share)
    if picture.blur_px > 0:
        pixels = _smeared(pixels, picture.blur_px)
    return _keystone(pixels, picture.keystone_px) if picture.keystone_px else pixels


def _keystone(pixels: np.ndarray, corner_px: float) -> np.ndarray:
    """The homography (1 0 0; 0 1 0; k 0 1) about the middle: the corners move up and down by ``corner_px``."""
    height, width = pixels.shape[:2]
    k = 4 * corner_px / (width * height)
    y, x = (np.mgrid[:height, :width] - np.array([[[height - 1]], [[width - 1]]]) / 2).astype(np.float32)
    seen = [(v / (1 - k * x) + m).astype(np.float32) for v, m in ((x, (width - 1) / 2), (y, (height - 1) / 2))]
    return cv2.remap(pixels, *seen, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def _smeared(pixels: np.ndarray, length_px: float) -> np.ndarray:
    """Motion blur along the rows, as of a shaken or panned camera."""
    n = 2 * max(1, round(length_px / 2)) + 1  # odd: an even kernel also shifts the picture, by half a pixel
    return cv2.blur(pixels, (n, 2 * (n // 8) + 1))


def between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """The picture a ``share`` (0 ... 1) of the way from ``a`` to ``b``, both warped along their optical flow."""
    a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
    grey = [p if p.ndim == 2 else cv2.cvtColor(p, cv2.COLOR_BGR2GRAY) for p in (a, b)]
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    ab, ba = flow.calc(grey[0], grey[1], None), flow.calc(grey[1], grey[0], None)
    y, x = np.mgrid[: a.shape[0], : a.shape[1]].astype(np.float32)
    # The flow at the new picture's pixel is taken from where it came from, to first order.
    one = cv2.remap(a, x - share * ab[..., 0], y - share * ab[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    two = cv2.remap(
        b, x - (1 - share) * ba[..., 0], y - (1 - share) * ba[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )
    return np.asarray(cv2.addWeighted(one, 1 - share, two, share, 0))


def pinhole(width: int, height: int, focal_px: float) -> pycolmap.Camera:
    """A calibrated pinhole; its principal point is not the middle, which says that it was measured."""
    params = [focal_px, focal_px, width / 2 + 0.25, height / 2 - 0.25]
    camera = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=params)
    camera.has_prior_focal_length = True
    return camera
