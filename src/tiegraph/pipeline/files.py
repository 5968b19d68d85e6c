"""Reading and writing the artefacts that several stages share."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.project.run import Run
from tiegraph.project.stages import write_atomic
from tiegraph.scene.images import read_pixels
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Ties


def scanned(run: Run) -> Scene:
    """The scene as the scan found it."""
    return Scene.from_json(run.path("scene.json").read_text())


def checked(run: Run) -> Scene:
    """The scene after `network`: rig checked against the images, sections cut."""
    return Scene.from_json(run.path("network", "scene.json").read_text())


def pairs_of(run: Run, name: str) -> Pairs:
    """The pair table of ``network.npz``, ``pairs.npz`` or ``match.npz``."""
    with np.load(run.path(name)) as data:
        return Pairs.from_npz(dict(data))


def ties_of(run: Run) -> Ties:
    """The preview matches that ``network`` saw."""
    with np.load(run.path("network", "ties.npz")) as data:
        return Ties.from_npz(dict(data))


def save_npz(path: Path, **arrays: Any) -> None:
    """Write a compressed NPZ atomically."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_atomic(path, buffer.getvalue())


def save_png(path: Path, image: np.ndarray) -> None:
    """Write an image (H, W) or (H, W, 3) BGR as PNG atomically."""
    write_atomic(path, cv2.imencode(".png", image)[1].tobytes())


def mask_path(folder: Path, name: str) -> Path:
    """Where the mask of an image is (COLMAP's naming)."""
    return folder / "masks" / f"{name}.png"


def classes_path(folder: Path, name: str) -> Path:
    """Where the classes of an image's pixels are (``masks.classes``, reduced size); not from every source."""
    return folder / "classes" / f"{name}.png"


FINAL = "remask"
"""Folder of the final masks and classes, laid out like the run folder."""


def read_image(path: Path, flag: int = cv2.IMREAD_GRAYSCALE) -> np.ndarray:
    """Pixels (H, W) u1, or (H, W, 3) with IMREAD_COLOR, as stored: the EXIF orientation was dealt with by the scan."""
    image = read_pixels(path, flag)
    if image is None:
        raise InputError(f"{path}: cannot be read any more; it was readable when scanned: run `scan` again")
    return image


def read_mask(folder: Path, name: str) -> np.ndarray:
    """Mask (H, W) bool of an image, True = use."""
    return read_image(mask_path(folder, name)) > 0
