"""Small folders of images for the tests of the scan stage."""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tiegraph.geometry.geodesy import geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.scan.scan import ScanInputs, build_scene, find_images, probe_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning
from tiegraph.scene.images import Probe
from tiegraph.scene.scene import Scene

TUNING = Tuning()
DATA = Path(os.environ.get("TIEGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))


def data(*parts: str) -> Path:
    """Path of a data set; skips the test if it is not there."""
    path = DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path


def picture(path: Path, size: tuple[int, int] = (64, 48), mode: str = "RGB", **save: Any) -> Path:
    """An image whose content depends on its path, so that no two files are equal."""
    rng = np.random.default_rng(zlib.crc32(str(path).encode()))
    path.parent.mkdir(parents=True, exist_ok=True)
    small = Image.fromarray(rng.integers(0, 255, (6, 8, 3), dtype=np.uint8)).resize(size, Image.Resampling.BILINEAR)
    small.convert(mode).save(path, **save)
    return path


def exif_of(**tags: object) -> Image.Exif:
    """EXIF block from any of the names below and lat, lon, alt."""
    exif = Image.Exif()
    base = {"make": 0x010F, "model": 0x0110, "orientation": 0x0112}
    detail = {"time": 0x9003, "subsec": 0x9291, "offset": 0x9011, "focal_35mm": 0xA405, "focal_mm": 0x920A,
              "plane_x": 0xA20E, "plane_unit": 0xA210, "width": 0xA002, "height": 0xA003, "exposure": 0x829A,
              "f_number": 0x829D, "iso": 0x8827}  # fmt: skip
    for name, value in tags.items():
        if name in base:
            exif[base[name]] = value
        elif name in detail:
            exif.get_ifd(0x8769)[detail[name]] = value
    gps = exif.get_ifd(0x8825)
    for name, key in (("lat", 2), ("lon", 4)):
        if name in tags:
            value = float(tags[name])  # type: ignore[arg-type]
            gps[key - 1] = ("N" if value >= 0 else "S") if name == "lat" else ("E" if value >= 0 else "W")
            degrees = abs(value)
            gps[key] = (int(degrees), int(degrees % 1 * 60), round(degrees * 60 % 1 * 60, 6))
    if "alt" in tags:
        gps[5], gps[6] = (b"\x01" if float(tags["alt"]) < 0 else b"\x00"), abs(float(tags["alt"]))  # type: ignore[arg-type]
    return exif


def papers_rig(root: Path, passes: tuple[str, ...] = ("up", "down"), cameras: int = 3, frames: int = 3) -> Path:
    """<pass>/cam<k>/<frame>.jpg as in paper 000 figure 3."""
    for name in passes:
        for camera in range(cameras):
            for frame in range(frames):
                picture(root / name / f"cam{camera}" / f"{frame:06d}.jpg")
    return root


class Survey:
    """A folder of images, opened once and scanned with any inputs: the whole scan stage without a pipeline."""

    def __init__(self, images: Path) -> None:
        self.images = images
        self.names = find_images(images)
        self.probes: Sequence[Probe] = [probe_image(images / n) for n in self.names]

    def scan(self, settings: ScanSettings | None = None, tuning: Tuning = TUNING, **inputs: Any) -> Scene:
        given = ScanInputs(self.images, **inputs)
        return build_scene(given, self.names, self.probes, settings or ScanSettings(), tuning)


def scan(images: Path, settings: ScanSettings | None = None, **inputs: Any) -> Scene:
    """A scan of a folder that is opened for it."""
    return Survey(images).scan(settings, **inputs)


ORIGIN = make_origin(35.69, 139.77, 40.0, "ENU")  # of the positions below


def gnss_csv(path: Path, time_s: np.ndarray, enu: np.ndarray, sigma: float = 0.05) -> Path:
    """Positions (N, 3) east, north and up of ORIGIN at times (N,)."""
    llh = geodetic_from_world(enu, ORIGIN)
    rows = [f"{t:.3f},{a:.10f},{o:.10f},{h:.4f},{sigma}" for t, (a, o, h) in zip(time_s, llh)]
    path.write_text("time,lat,lon,height,sigma\n" + "\n".join(rows) + "\n")
    return path


def times_csv(path: Path, frames: int, passes: tuple[str, ...] = ("up",), start: float = 100.0) -> Path:
    """Times of frames, one a second; 1000 s between the passes."""
    rows = [f"{p},{k:06d},{start + 1000 * n + k}" for n, p in enumerate(passes) for k in range(frames)]
    path.write_text("pass,frame,time\n" + "\n".join(rows) + "\n")
    return path


def in_enu(scene: Scene) -> np.ndarray:
    """(F, 3) positions of a scene in the ENU frame of these tests, metres."""
    out = np.full((scene.frames, 3), np.nan)
    known = np.isfinite(scene.world_from_rig[:, 0, 3])
    out[known] = world_from_geodetic(geodetic_from_world(scene.world_from_rig[known, :3, 3], scene.origin), ORIGIN)
    return out


def two_cameras_rig(folder: Path) -> str:
    """A rig file: cam1 half a metre to the right of cam0, and turned to the right."""
    path, row = folder / "rig.toml", '[[sensors]]\nname = "{}"\nposition_m = {}\nyaw_pitch_roll_deg = {}\n'
    path.write_text(row.format("cam0", [0.0] * 3, [0.0] * 3) + row.format("cam1", [0.5, 0.0, 0.0], [90.0, 0.0, 0.0]))
    return str(path)


def flu_rig(folder: Path) -> str:
    path = folder / "rig.toml"
    path.write_text(
        'axes = "flu"\nantenna_m = [0.9, 0.6, 0.3]\n[[sensors]]\nname = "cam0"\nposition_m = [0.1, 0, 0.2]\n'
        'yaw_pitch_roll_deg = [30, -5, 0]\n[[sensors]]\nname = "cam1"\nyaw_pitch_roll_deg = [100, 0, 0]\n'
    )
    return str(path)
