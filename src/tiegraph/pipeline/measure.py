"""Glue of measurements in a finished map: profiles along a line, volumes inside polygons."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import rasterio

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import ENU, Origin, world_from_geodetic
from tiegraph.pipeline.files import load_json, placement_error, reading, world_origin, world_unit
from tiegraph.pipeline.products import FOLDER
from tiegraph.products import volumes
from tiegraph.products.raster import read_window
from tiegraph.products.surface import MAP, Window
from tiegraph.products.tuning import VolumeTuning
from tiegraph.project.folder import check_format
from tiegraph.project.stages import write_atomic
from tiegraph.scene.atomic import replacing
from tiegraph.scene.cloudfile import shift_of
from tiegraph.scene.vectors import Shapes, feature, gdal, read_shapes, write_layer
from tiegraph.text import csv_text, finite, some

BASES = ("plane", "lowest")
MOST_PIXELS = 4_000_000
"""Pixels of the window around a polygon at most, some 1 GB; a larger one is measured in an overview."""
_PARTS = {
    "noise": "noise",
    "base": "of the base",
    "world": "of the place, tilt and scale in the world",
    "shape": "of the shape of the model",
    "near_base": "of ground on the base",
}
_SAME_M = 1e-3  # where surface and terrain are nearer the ground was seen
_SEEN = (0.5, 0.98)  # shares of a polygon: below the first it is refused, below the second there is a note


@dataclass(frozen=True, eq=False)
class MapFiles:
    """The rasters of the map of a run folder: edge of a pixel, rows and columns, the upper left corner (2,) in the CRS,
    the shift (3,) from the world to that, and the origin of the world."""

    folder: Path
    origin: Origin | None
    unit: str
    pixel: float
    shape: tuple[int, int]
    corner: np.ndarray
    shift: np.ndarray

    def path(self, name: str) -> Path:
        """The file of a raster."""
        return self.folder / FOLDER / MAP / f"{name}.tif"

    def read(self, name: str, window: Window, step: int = 1) -> np.ndarray:
        """Lengths of a raster as files have them; NaN where it is not there."""
        if not self.path(name).exists():
            return np.full((-(-window.rows // step), -(-window.columns // step)), np.nan, np.float32)
        with reading(self.path(name)):
            return read_window(self.path(name), window, step)

    def pixels(self, places: np.ndarray) -> np.ndarray:
        """Columns and rows (N, 2), from the corner, of places (N, 2) in the CRS."""
        return (places - self.corner) / self.pixel * [1, -1]

    def inside(self, places: np.ndarray) -> np.ndarray:
        """(N,) whether places (N, 2) in the CRS lie on the rasters."""
        at = self.pixels(places)
        return np.all((at >= 0) & (at <= self.shape[::-1]), axis=1)

    def extent(self) -> str:
        """The extent of the map, in words."""
        far = self.corner + np.array([self.shape[1], -self.shape[0]]) * self.pixel
        east, north = (f"{a:.2f} to {b:.2f}" for a, b in ((self.corner[0], far[0]), (far[1], self.corner[1])))
        return f"the map reaches from {east} east and from {north} north"


def open_map(folder: Path) -> MapFiles:
    """The map of a run folder. Raises InputError if it has none."""
    check_format(folder)
    path = folder / FOLDER / MAP / "dsm.tif"
    if not path.exists():
        raise InputError(f"{folder} has no map yet: tiegraph products {folder} --products.make map")
    origin = world_origin(folder)
    with reading(path), rasterio.open(path) as raster:
        shape, to_crs = raster.shape, raster.transform
    corner, shift = np.array([to_crs.c, to_crs.f]), shift_of(origin)
    return MapFiles(folder, origin, world_unit(folder), pixel=float(to_crs.a), shape=shape, corner=corner, shift=shift)


def line_of(given: Sequence[str], map_: MapFiles) -> np.ndarray:
    """Vertices (N, 2) in the CRS of a line that is given as places "E,N", or as a file that has one."""
    if len(given) == 1 and Path(given[0]).suffix and not _pair(given[0]):
        parts = _in_crs(read_shapes(Path(given[0]), "line"), Path(given[0]), map_)
        if len(parts) > 1:
            raise InputError(f"--line {given[0]}: the file has {len(parts)} lines, and a profile is along one")
        return parts[0]
    found = [_pair(text) for text in given]
    wrong = next((text for text, pair in zip(given, found) if not pair), None)
    if wrong is not None or len(found) < 2:
        raise InputError(f"--line {wrong or ' '.join(given)}: give two places or more as E,N E,N or a file with a line")
    return np.array(found)


def _pair(text: str) -> tuple[float, ...]:
    try:
        east, north = (float(part) for part in text.split(","))
    except ValueError:
        return ()
    return (east, north) if np.isfinite([east, north]).all() else ()


def _in_crs(shapes: Shapes, path: Path, map_: MapFiles) -> list[np.ndarray]:
    """Vertices in the CRS of the survey. Raises InputError for those of another."""
    if shapes.crs is None:
        return shapes.parts
    theirs = pyproj.CRS.from_user_input(shapes.crs)
    place, degrees_of = map_.origin, pyproj.CRS.from_epsg(4326)
    if theirs.is_geographic and place is not None and theirs.to_2d().equals(degrees_of, ignore_axis_order=True):
        flat = np.full(1, place.height_m)
        degrees = (np.c_[p[:, ::-1], np.repeat(flat, len(p))] for p in shapes.parts)
        return [(world_from_geodetic(d, place) + map_.shift)[:, :2] for d in degrees]
    if place is None or place.crs == ENU:
        if theirs.is_projected or theirs.is_geographic:
            raise InputError(f"{path} is in {theirs.name}, and the survey has a CRS of its own: give it without one")
        return shapes.parts
    ours = pyproj.CRS.from_user_input(place.crs)
    ours = ours.sub_crs_list[0] if ours.is_compound else ours
    theirs = theirs.sub_crs_list[0] if theirs.is_compound else theirs
    if not theirs.equals(ours, ignore_axis_order=True):
        raise InputError(f"{path} is in {theirs.name}, the survey in {place.crs} ({ours.name}): save it in that CRS")
    return shapes.parts


def make_profile(folder: Path, line: Sequence[str], out: Path) -> volumes.Profile:
    """Write heights along a line of a map as CSV, or as points of a GeoPackage, and as SVG. Raises InputError without
    a map, for an unfit line or CRS, EngineMissing for a GeoPackage without pyogrio."""
    raw = gdal(out.name, "give a file that ends in .csv") if out.suffix == ".gpkg" else None
    map_ = open_map(folder)
    vertices = line_of(line, map_)
    distance, places = volumes.along(vertices, map_.pixel)
    if not map_.inside(places).any():
        raise InputError(f"the line lies outside: {map_.extent()}")
    at = map_.pixels(places)
    names = {"dsm": "dsm", "dsm_sigma": "sigma", "dtm": "dtm", "dtm_sigma": "dtm_sigma"}
    values = {column: volumes.sampled(partial(map_.read, name), at) for column, name in names.items()}
    profile = volumes.Profile(distance, places, values, unit=map_.unit)
    names_of, rows = profile.table
    if raw is None:
        write_atomic(out, csv_text(names_of, rows))
    else:
        points = [feature("Point", place, dict(zip(names_of, row))) for place, row in zip(places, rows)]
        with rasterio.open(map_.path("dsm")) as raster, replacing(out) as temporary:
            write_layer(raw, temporary, "profile", points, raster.crs.to_wkt())
    write_atomic(out.with_suffix(".svg"), volumes.chart(profile))
    return profile


def measure_volumes(
    folder: Path, polygon: Path, tuning: VolumeTuning, base: str = "plane", surface: str = "dsm"
) -> list[dict[str, Any]]:
    """Volumes inside each polygon of a file, JSON-ready. ``base``: plane, lowest, a height in the CRS, or the run
    folder of another survey; ``surface``: dsm or dtm. Raises InputError for no map, polygons that are none, cross
    themselves, lie outside or where no heights are known, and another CRS."""
    map_ = open_map(folder)
    if not map_.path(surface).exists():
        raise InputError(f"{folder} has no terrain model: tiegraph products {folder}")
    other = None if base in BASES or _height(base) is not None else _other(Path(base), map_)
    parts = _in_crs(read_shapes(polygon, "polygon"), polygon, map_)
    for part in parts:
        _check(part, polygon, map_)
    return [_measured(part - map_.shift[:2], (map_, other), base, surface, tuning) for part in parts]


def _height(base: str) -> float | None:
    try:
        found = float(base)
    except ValueError:
        return None
    return found if np.isfinite(found) else None


def _other(folder: Path, map_: MapFiles) -> MapFiles:
    if not folder.is_dir():
        raise InputError(f"--base {folder}: give plane, lowest, a height, or the run folder of another survey")
    other = open_map(folder)
    ours, theirs = (None if m.origin is None else m.origin.crs for m in (map_, other))
    if ours is None or ours == ENU or ours != theirs or other.unit != map_.unit:
        names = " and ".join(str(c or "none") for c in (ours, theirs))
        raise InputError(f"--base {folder}: both surveys must lie in one CRS of the Earth, and these are in {names}")
    return other


def _check(polygon: np.ndarray, path: Path, map_: MapFiles) -> None:
    sides = volumes.crossing(polygon)
    if sides is not None:
        a, b = (f"{polygon[k][0]:.2f}, {polygon[k][1]:.2f}" for k in sides)
        raise InputError(f"{path}: the polygon crosses itself: the sides that begin at ({a}) and ({b}) meet")
    if not map_.inside(polygon).all():
        east, north = polygon[np.argmin(map_.inside(polygon))]
        raise InputError(f"{path}: ({east:.2f}, {north:.2f}) of the polygon lies outside: {map_.extent()}")


def _measured(
    polygon: np.ndarray, maps: tuple[MapFiles, MapFiles | None], base: str, surface: str, tuning: VolumeTuning
) -> dict[str, Any]:
    """Of a polygon in the world, on the first of the maps."""
    map_ = maps[0]
    window, step = _window(polygon, map_, tuning)
    patch = _patch(map_, surface, window, step)
    known = _known(map_, polygon)
    ground = _ground(map_, window, step)
    under, height = _other_surface(patch, polygon, maps, surface), _height(base)
    if under is None and height is not None:
        under = volumes.level(patch, height - map_.shift[2], f"level at {height:.3f}")
    elif under is None:
        under = (volumes.plane if base == "plane" else volumes.lowest)(ground, polygon, known, tuning)
    area = patch.share(polygon)
    seen = float(area[np.isfinite(patch.w - under.w)].sum() / area.sum())
    if seen < _SEEN[0]:
        raise InputError(f"heights are known on {seen:.0%} of the polygon: draw it where the map shows ground")
    found = volumes.volumes(patch, under, polygon, known, tuning)
    notes = []
    if seen < _SEEN[1]:
        notes.append(f"heights are known on {seen:.0%} of the polygon, and volumes are of that part")
    if known.placed is None:
        notes.append("the accuracy of the survey in the world is unknown: sigmas do not include it")
    if step > 1:
        notes.append(f"measured in pixels of {patch.pixel:g} {map_.unit}, because the polygon is large")
    return finite({
        "unit": map_.unit, "area": volumes.area_of(polygon), "seen": seen, "surface": surface, "base": under.said,
        **{k: {"value": v.value, "sigma": v.sigma, "parts": v.parts} for k, v in found.items()}, "notes": notes,
    })  # fmt: skip


def _window(polygon: np.ndarray, map_: MapFiles, tuning: VolumeTuning) -> tuple[Window, int]:
    """The pixels around a polygon for its volume, and how many of them along an edge are combined."""
    at = map_.pixels(polygon + map_.shift[:2])
    step, size = 1, np.ptp(at, axis=0)
    while np.prod(size / step + 2) > MOST_PIXELS:
        step *= 2
    wide = step * 3 * tuning.local_px
    left, top = (int(np.floor(v / step)) * step - wide for v in at.min(axis=0))
    right, low = (int(np.ceil(v / step)) * step + wide for v in at.max(axis=0))
    left, top = max(left, 0), max(top, 0)
    rows, columns = ((min(b, size) - a) // step * step for a, b, size in zip((top, left), (low, right), map_.shape))
    return Window(top, left, rows=rows, columns=columns), step


def _patch(map_: MapFiles, name: str, window: Window, step: int) -> volumes.Patch:
    w, spread = (map_.read(n, window, step).astype(float) for n in (name, _sigma(name)))
    corner = map_.corner + np.array([window.column, -window.row]) * map_.pixel - map_.shift[:2]
    return volumes.Patch(w - map_.shift[2], spread, corner=corner, pixel=map_.pixel * step)


def _sigma(name: str) -> str:
    return "sigma" if name == "dsm" else f"{name}_sigma"


def _ground(map_: MapFiles, window: Window, step: int) -> volumes.Patch:
    """The surface where it is the terrain, or everywhere if there is no terrain model."""
    surface = _patch(map_, "dsm", window, step)
    if not map_.path("dtm").exists():
        return surface
    terrain = _patch(map_, "dtm", window, step)
    seen = np.abs(surface.w - terrain.w) < _SAME_M
    return replace(surface, w=np.where(seen, surface.w, np.nan))


def _known(map_: MapFiles, polygon: np.ndarray) -> volumes.Known:
    """Of three axes a height is one."""
    world = load_json(map_.folder / "world.json")
    between = np.array([[0.0, 0.0], *(world.get("between_frames") or [])])
    over = np.interp(np.linalg.norm(np.ptp(polygon, axis=0)), *between.T) / np.sqrt(3)
    whole = (world.get("model_sigma") or {}).get("median", 0.0) / np.sqrt(3)
    return volumes.Known(placement_error(map_.folder), over_polygon=float(over), whole=float(whole))


def _other_surface(
    patch: volumes.Patch, polygon: np.ndarray, maps: tuple[MapFiles, MapFiles | None], surface: str
) -> volumes.Base | None:
    map_, other = maps
    if other is None:
        return None
    east, north = patch.places()
    at = other.pixels(np.stack([east.ravel(), north.ravel()], axis=-1) + map_.shift[:2])
    names = surface, _sigma(surface)
    w, sigma = (volumes.sampled(partial(other.read, name), at).reshape(patch.w.shape) for name in names)
    theirs = replace(patch, w=w - map_.shift[2], sigma=sigma)
    known = _known(other, polygon)
    if known.placed is not None:  # in our world
        known = replace(known, placed=replace(known.placed, middle=known.placed.middle + other.shift - map_.shift))
    return volumes.epoch(theirs, known, f"{surface} of {other.folder}")


def said(found: dict[str, Any]) -> str:
    """The measurements of a polygon, in a sentence."""
    unit = found["unit"]
    each = ", ".join(f"{n} {found[n]['value']:.2f} ± {found[n]['sigma']:.2f} {unit}3" for n in ("cut", "fill", "net"))
    why = found["net"]["parts"]
    largest = max(why, key=lambda k: why[k])
    text = f"{each} on {found['area']:.2f} {unit}2; base: {found['base']}; most of the sigma is of: {largest}"
    return f"{text}. {some(found['notes'], joint='. ')}" if found["notes"] else text
