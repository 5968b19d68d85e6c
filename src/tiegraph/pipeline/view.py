"""Glue of the view: a finished run, read for a page that shows it."""

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import laspy
import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import Origin, world_from_geodetic
from tiegraph.pipeline import files
from tiegraph.pipeline.dense import depth_path
from tiegraph.pipeline.georef import stated
from tiegraph.pipeline.products import FOLDER
from tiegraph.products.raster import averages, hillshade
from tiegraph.products.surface import MAP
from tiegraph.project.folder import check_format
from tiegraph.project.run import Run
from tiegraph.scene.cloudfile import shift_of
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.copc import copc_box
from tiegraph.scene.vectors import read_shapes
from tiegraph.targets.marks import seen_in
from tiegraph.text import finite
from tiegraph.view import layers

_SHEETS = (("ortho", "dsm", "orthophoto"), ("dsm", "dsm", "surface model"), ("dtm", "dtm", "terrain"))
_MESH_PX, _PICTURE_PX = 256, 2048  # pixels along a raster at most, of its heights and of its colours
_COMPARED = 40  # images of a pick whose depth maps are asked: a tenth of a second each


@dataclass(frozen=True, eq=False)
class Sheet:
    """A raster drawn on heights: what it is called, its file and that of the heights, and what frame.json says."""

    name: str
    colours: Path
    heights: Path
    frame: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Viewed:
    """A finished run. ``middle`` (3,) of the cloud in the CRS: what is local is counted from there; ``images``: posed,
    by name; ``known``: the accuracy of the model."""

    run: Run
    origin: Origin | None
    unit: str
    box: np.ndarray  # (2, 3) least and largest coordinates of the cloud in the CRS
    points: int
    images: dict[str, layers.View]
    known: layers.Known

    @cached_property
    def middle(self) -> np.ndarray:
        """(3,) in the CRS."""
        return self.box.mean(axis=0).round(3)

    @cached_property
    def names(self) -> list[str]:
        """Of the images, by number."""
        return list(self.images)

    @cached_property
    def sheets(self) -> list[Sheet]:
        """The rasters that there are."""
        found = []
        for path in sorted(self.run.path(FOLDER).glob("*/frame.json")):
            frame, folder = files.load_json(path), path.parent
            if "surface_from_crs" not in frame:  # an unrolled raster is on no plane
                continue
            for colours, heights, said in _SHEETS:
                paths = folder / f"{colours}.tif", folder / f"{heights}.tif"
                if all(p.exists() for p in paths):
                    found.append(Sheet(f"{folder.name}: {said}", *paths, frame=frame))
        return found

    def layers(self) -> dict[str, Any]:
        """All that the page lists, JSON-ready."""
        pairs = files.pairs_of(self.run, "match.npz")
        index = {name: k for k, name in enumerate(self.images)}
        rows = {k: index[name] for k, name in enumerate(files.checked(self.run).names) if name in index}
        low, high = (self.box - self.middle).tolist()
        return finite({
            "name": self.run.folder.name, "points": self.points, "unit": self.unit,
            "crs": None if self.origin is None else self.origin.crs,
            "middle": self.middle, "low": low, "high": high,
            "cameras": layers.cameras(self.names, list(self.images.values()), self._shift - self.middle),
            "ties": layers.ties(pairs, rows),
            "sheets": [sheet.name for sheet in self.sheets],
            "contours": self._contours is not None,
        })  # fmt: skip

    def pixels(self, image: int) -> np.ndarray:
        """(H, W, 3) of an image, BGR. Raises ValueError for a number that is none."""
        if not 0 <= image < len(self.images):
            raise ValueError("no such image")
        return files.read_colours(self.run.path("images", self.names[image]))

    def pick(self, local: np.ndarray) -> dict[str, Any]:
        """The point of the cloud nearest to a local place (3,), JSON-ready: its coordinates, its sigmas, and the images
        that see it with its pixel and whether something hides it there. Raises ValueError where no point is near."""
        place = local + self.middle - self._shift
        step = max(float(np.ptp(self.box, axis=0).max()) * 1e-6, 1e-9)
        for reach in step * 8.0 ** np.arange(6):
            cloud = copc_box(self.run.path(files.CLOUD), self.origin, place - reach, place + reach)
            row = layers.nearest(cloud, place)
            if row is not None:
                break
        else:
            raise ValueError("no point of the cloud is near")
        xyz = cloud.xyz_m[row]
        seen = seen_in(dict(enumerate(self.images.values())), xyz)
        return finite({
            "local": xyz + self._shift - self.middle,
            **layers.coordinates(xyz, self.origin),
            "sigma": layers.sigmas(xyz, float(cloud.sigma_m[row]), self.known),
            "views": int(cloud.views[row]),
            "images": [
                {"image": k, "xy": xy, "hidden": self._hidden(k, xyz) if n < _COMPARED else None}
                for n, (k, xy) in enumerate(seen.items())
            ],
        })  # fmt: skip

    def apart(self, ends: np.ndarray, points: np.ndarray) -> dict[str, Any]:
        """Distance, in level, and difference of height of two local places (2, 3), JSON-ready; the sigma of the first
        by those of both ``points`` (2,)."""
        x, y, z = np.diff(ends, axis=0)[0]
        away = float(np.linalg.norm([x, y, z]))
        sigma = layers.distance_sigma(away, points, self.known)
        return finite({"distance": away, "sigma": sigma, "level": float(np.hypot(x, y)), "height": float(z)})

    def mesh(self, sheet: int) -> np.ndarray:
        """Rows and columns (2,) f4, and the local places (rows x columns x 3) f4 of a raster."""
        asked = self._sheet(sheet)
        xyz = layers.mesh(_small(asked.heights, _MESH_PX)[0], asked.frame, self.middle)
        return np.r_[np.array(xyz.shape[:2], np.float32), xyz.ravel()]

    def picture(self, sheet: int) -> bytes:
        """A PNG of the colours of a raster, transparent where nothing is known."""
        asked = self._sheet(sheet)
        if asked.colours != asked.heights:
            rgba = _small(asked.colours, _PICTURE_PX).astype(np.uint8)
            return cv2.imencode(".png", rgba[[2, 1, 0, 3]].transpose(1, 2, 0))[1].tobytes()
        w = _small(asked.heights, _PICTURE_PX)[0]
        pixel = asked.frame["pixel"] * max(asked.frame["size"]) / max(w.shape)
        return cv2.imencode(".png", layers.tinted(w, hillshade(np.pad(w, 1, mode="edge"), pixel)))[1].tobytes()

    def contours(self) -> np.ndarray:
        """(N, 3) f4 local vertices of the contour lines, NaN after each."""
        if self._contours is None:
            raise ValueError("no contour lines")
        lines = read_shapes(self._contours, "line", 3).parts
        if self.origin is not None and self._contours.suffix == ".geojson":  # degrees
            lines = [world_from_geodetic(p[:, [1, 0, 2]], self.origin) + self._shift for p in lines]
        return layers.strung(lines, self.middle)

    @property
    def _contours(self) -> Path | None:
        named = (self.run.path(FOLDER, MAP, f"contours.{kind}") for kind in ("gpkg", "geojson"))
        return next((p for p in named if p.exists()), None)

    @property
    def _shift(self) -> np.ndarray:
        return shift_of(self.origin)

    def _sheet(self, number: int) -> Sheet:
        if not 0 <= number < len(self.sheets):
            raise ValueError("no such raster")
        return self.sheets[number]

    def _hidden(self, image: int, place: np.ndarray) -> bool | None:
        path = depth_path(self.run.folder, self.names[image])
        if not path.exists():
            return None
        with files.reading(path), np.load(path) as depth:
            return layers.hidden(place, depth["depth_m"], depth["K"], depth["cam_from_world"])


def open_view(run: Run) -> Viewed:
    """A finished run. Raises InputError for one without a cloud."""
    check_format(run.folder)
    path = run.path(files.CLOUD)
    if not path.exists():
        raise InputError(f"{path} is not there, the run has no cloud yet: tiegraph cloud {run.folder}")
    with files.reading(path), laspy.open(path) as cloud:
        header = cloud.header
    model = files.load_model(run.path("sparse", "world"))  # to the end: it owns its cameras
    posed = sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)
    inside = (files.load_json(run.path("world.json")).get("model_sigma") or {}).get("median", 0.0)
    predicted = stated(run, {}).predicted
    return Viewed(
        run=run,
        origin=files.world_origin(run.folder),
        unit=files.world_unit(run.folder),
        box=np.array([header.mins, header.maxs]),
        points=header.point_count,
        images={i.name: (matrix(i.cam_from_world()), copy(i.camera)) for i in posed},
        known=layers.Known(inside, files.placement_error(run.folder), scale=predicted.scale, between=predicted.between),
    )


def _small(path: Path, most: int) -> np.ndarray:
    with files.reading(path):
        return averages(path, most, most)[0]
