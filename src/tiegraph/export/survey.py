"""What the formats are written from, and what all of them leave beside: the way back to the CRS."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pycolmap

from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import PlacementError, Similarity
from tiegraph.scene.names import shortened
from tiegraph.scene.scene import Scene

OFFSET = "offset.json"


@dataclass(frozen=True)
class Survey:
    """A finished survey. ``model``: in the world, with the cameras and names that the images have in the folder.

    ``names``: the scene's by the folder's; ``masks``, ``depths``: files of the folder by its names; ``ties``: pairs of
    the scene's names with their verified matches; ``camera``: the one asked for, "" = all, or the rig.
    """

    scene: Scene
    model: pycolmap.Reconstruction
    unit: str = "m"
    origin: Origin | None = None
    error: PlacementError | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    masks: Mapping[str, str] = field(default_factory=dict)
    depths: Mapping[str, str] = field(default_factory=dict)
    ties: Sequence[tuple[str, str, int]] = ()
    camera: str = ""

    def images(self) -> list[pycolmap.Image]:
        """The images with a pose, in the order of their names."""
        return sorted((self.model.image(k) for k in self.model.reg_image_ids()), key=lambda i: i.name)

    def index(self, image: pycolmap.Image) -> int:
        """Number of an image in the scene."""
        return self.scene.image_index[self.names.get(image.name, image.name)]


@dataclass(frozen=True)
class Exporter:
    """How a format is written: ``write`` makes its files and returns how many things these describe.

    ``lens`` gives, of cameras by id, those whose images can stay, in the format's words; None: the format has no
    images. ``flat``: all images lie in one folder. ``mask``: name of the mask of an image {name} = {stem} + suffix.
    ``opened``: how to open it, {folder} = where it is.
    """

    write: Callable[[Survey, Path], int]
    opened: str
    lens: Callable[[Mapping[int, pycolmap.Camera]], dict[int, pycolmap.Camera]] | None = None
    flat: bool = True
    mask: str = "masks/{name}.png"
    depth: bool = False


def offset_of(origin: Origin | None, unit: str, world_from_local: Similarity | None = None) -> dict[str, Any]:
    """The content of ``offset.json``: what brings the coordinates of a folder to those of the CRS."""
    shift = (0.0, 0.0, 0.0) if origin is None else origin.shift_m
    back = Similarity(translation=np.array(shift, float)) @ (world_from_local or Similarity())
    crs = None if origin is None else origin.crs
    said = {"crs": crs, "unit": unit, "shift": list(shift), "crs_from_local": back.matrix.tolist()}
    if origin is not None:
        said["world_zero"] = {"lat_deg": origin.lat_deg, "lon_deg": origin.lon_deg, "height_m": origin.height_m}
    return said


def write_offset(survey: Survey, target: Path, world_from_local: Similarity | None = None) -> None:
    """Write ``offset.json``."""
    write_json(target / OFFSET, offset_of(survey.origin, survey.unit, world_from_local))


def write_json(path: Path, data: object) -> None:
    """Write JSON, with lines for people; no NaN."""
    path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def unique_names(names: Sequence[str], changed: Mapping[str, str]) -> dict[str, str]:
    """A base name for each image, which holds its folders (up/cam0/1.jpg: up_cam0_1.jpg), unique without its suffix and
    in any case; ``changed``: the suffixes of images that get another one."""
    out: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        path = PurePosixPath(name)
        stem, number = re.sub(r"[^\w-]", "_", str(path.with_suffix(""))), 1
        stem = shortened(stem, 180).replace(".", "_")
        own = stem
        while own.lower() in taken:
            number += 1
            own = f"{stem}_{number}"
        taken.add(own.lower())
        out[name] = own + changed.get(name, path.suffix)
    return out
