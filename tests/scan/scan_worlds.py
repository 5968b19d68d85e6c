"""Small folders of images for the tests of the scan stage."""

from __future__ import annotations

import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tiegraph.scan.scan import ScanInputs, build_scene, find_images, probe_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import ImageTuning

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


def scan(images: Path, settings: ScanSettings | None = None, **inputs: object) -> Scene:
    """The whole scan stage without a pipeline."""
    names = find_images(images)
    probes = [probe_image(images / n, ImageTuning()) for n in names]
    return build_scene(ScanInputs(images, **inputs), names, probes, settings or ScanSettings(), TUNING)  # type: ignore[arg-type]
