"""Reading and writing the artefacts that several stages share."""

import errno
import json
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pycolmap

from tiegraph.errors import UnreadableArtefact
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import PlacementError
from tiegraph.masks import NAMES
from tiegraph.project.run import Run
from tiegraph.project.stages import write_atomic
from tiegraph.scene.colmapmodel import read_model
from tiegraph.scene.decoding import read_pixels
from tiegraph.scene.pairs import Pairs, PreviewMatches, Visibility
from tiegraph.scene.results import DepthMap, load_depth, save_columns
from tiegraph.scene.scene import Scene

T = TypeVar("T")

_OURS = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)  # limits of the machine, not faults of a file


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Errors while an artefact is read are reported for the artefact, whose stage then makes it again."""
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        if isinstance(error, UnreadableArtefact) or (isinstance(error, OSError) and error.errno in _OURS):
            raise
        raise UnreadableArtefact(path, error) from error


def load_npz(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an NPZ file. Raises UnreadableArtefact."""
    with reading(path), np.load(path) as data:
        return dict(data)


def load_as(path: Path, make: Callable[[dict[str, np.ndarray]], T]) -> T:
    """The result of ``make`` for the arrays of an NPZ file. Raises UnreadableArtefact."""
    with reading(path):
        return make(load_npz(path))


def load_json(path: Path) -> Any:
    """The content of a JSON file. Raises UnreadableArtefact."""
    with reading(path):
        return json.loads(path.read_text())


def load_scene(path: Path) -> Scene:
    """A scene. Raises UnreadableArtefact."""
    with reading(path):
        return Scene.from_json(path.read_text())


def load_model(folder: Path) -> pycolmap.Reconstruction:
    """A COLMAP model. Raises UnreadableArtefact."""
    with reading(folder):
        return read_model(folder)


def load_map(path: Path) -> DepthMap:
    """A depth map. Raises UnreadableArtefact."""
    with reading(path):
        return load_depth(path)


def scanned(run: Run) -> Scene:
    """The scene as the scan found it."""
    return load_scene(run.path("scene.json"))


def whole(run: Run) -> Scene:
    """The same with the images that get poses by their rigs, which take no part in structure from motion."""
    path = run.path("whole.json")
    return load_scene(path) if path.exists() else scanned(run)


def checked(run: Run) -> Scene:
    """The scene after `network`: rig checked against the images, sections cut."""
    return load_scene(run.path("network", "scene.json"))


def pairs_of(run: Run, name: str) -> Pairs:
    """The pair table of ``candidates.npz``, ``coarse.npz``, ``network.npz``, ``pairs.npz`` or ``match.npz``."""
    return load_as(run.path(name), Pairs.from_npz)


def ties_of(run: Run, stage: str = "coarse") -> PreviewMatches:
    """The preview matches of ``candidates``, or with those added by ``coarse``."""
    return load_as(run.path(stage, "matches.npz"), PreviewMatches.from_npz)


def trusted_poses(folder: Path) -> np.ndarray | None:
    """The coarse model where it is trusted: cam_from_world (N, 4, 4), NaN elsewhere; or None."""
    path = folder / "coarse" / "model.npz"
    if not path.exists():
        return None
    with reading(path):
        data = load_npz(path)
        return np.where(data["trusted"][:, None, None], data["cam_from_world"], np.nan)


def visibility_of(run: Run) -> Visibility | None:
    """The surface seen by each image by all tracks of the coarse model, if there is one."""
    path = run.path("coarse", "visibility.npz")
    return load_as(path, Visibility.from_npz) if path.exists() else None


def save_npz(path: Path, **arrays: Any) -> None:
    """Write a compressed NPZ atomically."""
    save_columns(path, arrays)


def save_png(path: Path, image: np.ndarray) -> None:
    """Write an image (H, W) or (H, W, 3) BGR u1, or a mask (H, W) bool of one bit a pixel, as PNG atomically."""
    mask = image.dtype == bool
    pixels = np.where(image, 255, 0).astype(np.uint8) if mask else image
    write_atomic(path, cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_BILEVEL, int(mask)])[1].tobytes())


def mask_path(folder: Path, name: str) -> Path:
    """The file of an image's mask (COLMAP's naming)."""
    return folder / "masks" / f"{name}.png"


def classes_path(folder: Path, name: str) -> Path:
    """The file of the classes of an image's pixels (``masks``, reduced size); not from every source."""
    return folder / "classes" / f"{name}.png"


def class_shares(name: str, folder: Path) -> np.ndarray:
    """Shares of an image's pixels by class."""
    classes = read_image(classes_path(folder, name))
    return np.bincount(classes.ravel(), minlength=len(NAMES)) / classes.size


FINAL = "refine"
"""Folder of the final masks and classes, laid out like the run folder."""
CLOUD = "cloud.copc.laz"
"""The fused cloud, which is read by parts."""


def read_image(path: Path, flag: int = cv2.IMREAD_GRAYSCALE) -> np.ndarray:
    """Pixels (H, W) u1, or (H, W, 3) with IMREAD_COLOR, as stored: the scan has applied the EXIF orientation."""
    image = read_pixels(path, flag)
    if image is None:
        raise UnreadableArtefact(path, "it is no image now")
    return image


@lru_cache(maxsize=6)
def read_colours(path: Path) -> np.ndarray:
    """Pixels (H, W, 3) of an image, BGR; the last ones are kept, for a page asks for parts of one."""
    return read_image(path, cv2.IMREAD_COLOR)


def read_mask(folder: Path, name: str) -> np.ndarray:
    """Mask (H, W) bool of an image, True = use."""
    return read_image(mask_path(folder, name)) > 0


def world_origin(folder: Path) -> Origin | None:
    """The place of the world on the Earth: by the scene's positions, or by control points alone."""
    data = load_json(folder / "world.json").get("origin")
    return None if data is None else Origin.from_dict(data)


def world_unit(folder: Path) -> str:
    """Unit of lengths in the world: m, or "units" if the scale is unknown."""
    return "units" if load_json(folder / "world.json")["scale_source"] == "none" else "m"


def placement_error(folder: Path) -> PlacementError | None:
    """Accuracy of the placement; None = not placed."""
    data = load_json(folder / "world.json").get("placement_error")
    return None if data is None else PlacementError.from_dict(data)
