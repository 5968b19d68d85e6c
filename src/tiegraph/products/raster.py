"""Cloud Optimized GeoTIFFs of the rasters over a reference surface, written window by window.

Contour lines as a GeoPackage. And small pictures of rasters, as `report.html` shows them: the orthophoto, and heights
as colours in relief.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio
import rasterio.shutil
from rasterio.enums import ColorInterp, Resampling
from rasterio.windows import Window as Part

from tiegraph.errors import EngineMissing
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import ENU, Origin, geodetic_from_world, parse_crs
from tiegraph.limits import need_room
from tiegraph.products.surface import MAP, NODATA, Surface, Window
from tiegraph.products.terrain import Line
from tiegraph.scene.atomic import remove, replacing
from tiegraph.scene.vectors import Layer, collection, feature, gdal, style, write_layer, write_styles
from tiegraph.text import round_above

_BLOCK = 512  # pixels along the edge of a block of the file
_OVER_RAW = 1.5  # a file with its overviews takes so many times the bytes of its pixels at most
PICTURE_PX = 1400
"""Width of a picture at most."""
_TAILS = (0.5, 99.5)  # percentiles of the heights between which the colours spread
_BAR, _STEPS = 44, 5  # height of the strip with the scale, pixels; numbers on it
_FONT, _LETTERS = cv2.FONT_HERSHEY_SIMPLEX, 0.5
_BITS = 4  # of a pixel's fraction, in OpenCV's coordinates
_LABELLED_PX = 160  # an index line of this length has its height beside it
_INK = (40, 40, 40)
_LINE = {"line_color": "150,90,40,255", "line_width": "0.15", "line_width_unit": "MM"}
_STYLE = style("SimpleLine", 1.0, _LINE, by=("outlineWidth", "if(&quot;index&quot;, 0.4, 0.15)"))


@dataclass(frozen=True)
class Kind:
    """A raster: type of its numbers, its bands and their meanings, the value for none, the resampling of
    overviews, and whether it is in units of the world."""

    dtype: str
    bands: tuple[str, ...]
    nodata: float | None = None
    overviews: str = "average"
    lengths: bool = False


KINDS = {
    "dsm": Kind("float32", ("w: height over the reference surface",), NODATA, lengths=True),
    "sigma": Kind("float32", ("standard deviation of w",), NODATA, lengths=True),
    "dtm": Kind("float32", ("w of the terrain below trees, cars and houses",), NODATA, lengths=True),
    "dtm_sigma": Kind("float32", ("standard deviation of w of the terrain",), NODATA, lengths=True),
    "ortho": Kind("uint8", ("red", "green", "blue", "alpha")),
    "source": Kind("uint16", ("image that gave the colour, a row of source.csv",), 0, overviews="nearest"),
    "hillshade": Kind("uint8", ("shaded w, light from the upper left",), 0),
}


@dataclass(frozen=True)
class Place:
    """Georeference of the rasters: the origin of the world on the Earth, if any, the unit of its lengths ("m" or
    "units"), and a text ``said`` on the accuracy."""

    origin: Origin | None
    unit: str = "m"
    said: str = ""

    def has_terrain(self, surface: Surface) -> bool:
        """Whether a surface has a terrain: a map with a scale at which a house differs from a hill."""
        return surface.name == MAP and self.unit == "m"

    def crs(self, surface: Surface) -> rasterio.crs.CRS:
        """Of a level surface that of the world, if it has one; else a local one. Raises InputError for one without
        metres."""
        if surface.level and self.origin is not None and self.origin.crs != ENU:
            return rasterio.crs.CRS.from_wkt(parse_crs(self.origin.crs).to_wkt())
        axes = " and ".join(surface.axes[:2])
        unit = "" if self.unit == "m" else " in units of the model"  # GeoTIFF knows no unit without a length
        name = f"tiegraph {surface.name}: {axes}{unit}"
        return rasterio.crs.CRS.from_wkt(f'LOCAL_CS["{name}",UNIT["metre",1],AXIS["u",EAST],AXIS["v",NORTH]]')

    def frame(self, surface: Surface) -> dict:
        """How coordinates of the CRS (of the world, if it has none) become (u, v, w) of the files, JSON-ready:
        ``surface_from_crs`` (4, 4), or of a curved surface ``axis``, rows of u and x, y, z (of a wall x, y), and
        ``radius``, None of a wall; with ``profile`` if a tube is no circle: distances from the axis at equal angles."""
        shift, frame = np.zeros(3) if self.origin is None else np.asarray(self.origin.shift_m), surface.frame
        if frame.nodes is not None:
            axis = np.c_[frame.stations, frame.nodes + shift][:, : 4 if frame.tube else 3]
            profile = {} if np.ptp(frame.profile) == 0 else {"profile": frame.around[1].tolist()}
            return {"axis": axis.tolist(), "radius": frame.radius if frame.tube else None, **profile}
        to_world = transforms.rigid(np.eye(3), -shift)
        matrix = surface.file_from_uvw @ frame.surface_from_world @ to_world
        return {"surface_from_crs": matrix.tolist()}

    def described(self, surface: Surface) -> dict:
        """The content of ``frame.json``, JSON-ready."""
        return {
            "surface": surface.name,
            "axes": dict(zip("uvw", surface.axes)),
            "crs": None if self.origin is None else self.origin.crs,
            "unit": self.unit,
            **self.frame(surface),
            "pixel": surface.pixel_m,
            "size": list(surface.shape[::-1]),
            "upper_left_uv": [surface.low[0] + surface.offset[0], surface.high[1] + surface.offset[1]],
        }


def write_raster(
    path: Path, parts: Iterable[tuple[Window, np.ndarray]], surface: Surface, place: Place, scratch: Path
) -> None:
    """Write the raster whose kind is the name of ``path``, of windows and their values (bands, rows, columns); one band
    may be without its axis.

    Lengths that are NaN become nodata. ``scratch``: a folder for its raw pixels until it is done. Raises
    InputError for a full disk, before GDAL meets it: GDAL only logs failed writes.
    """
    kind, raw = KINDS[path.stem], scratch / f"{path.stem}.tif"
    rows, columns = surface.shape
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch.mkdir(parents=True, exist_ok=True)
    need_room(raw, int(_OVER_RAW * rows * columns * np.dtype(kind.dtype).itemsize * len(kind.bands)))
    left, top = (surface.low + surface.offset)[0], (surface.high + surface.offset)[1]
    profile = {
        "driver": "GTiff", "height": rows, "width": columns, "count": len(kind.bands), "dtype": kind.dtype,
        "crs": place.crs(surface), "transform": rasterio.Affine(surface.pixel_m, 0, left, 0, -surface.pixel_m, top),
        "nodata": kind.nodata, "tiled": True, "blockxsize": _BLOCK, "blockysize": _BLOCK, "bigtiff": "IF_SAFER",
    }  # fmt: skip
    with replacing(raw) as temporary, rasterio.open(temporary, "w", **profile) as out:
        out.descriptions = kind.bands
        if kind.lengths:
            out.units = (place.unit,)
        if "alpha" in kind.bands:
            out.colorinterp = [ColorInterp[name] for name in kind.bands]
        told: dict = {"software": "tiegraph", "surface": surface.name, "accuracy": place.said, "unit": place.unit}
        out.update_tags(**told | {k: json.dumps(v) for k, v in place.frame(surface).items()})
        for window, values in parts:
            known = np.where(np.isfinite(values), values, NODATA) if kind.lengths else values
            known = known.reshape(len(kind.bands), window.rows, window.columns)
            part = Part(window.column, window.row, window.columns, window.rows)  # type: ignore[call-arg]
            out.write(known.astype(kind.dtype), window=part)
    need_room(path, int(_OVER_RAW * raw.stat().st_size))
    packed = {"compress": "DEFLATE", "predictor": "YES", "blocksize": _BLOCK, "bigtiff": "IF_SAFER"}
    made = {"overview_resampling": kind.overviews, "statistics": "YES", "num_threads": "1"}
    with replacing(path) as temporary:
        rasterio.shutil.copy(raw, temporary, driver="COG", **packed, **made)
    remove(raw)


def read_window(path: Path, window: Window, step: int = 1) -> np.ndarray:
    """Lengths (rows, columns) f4 of a raster in a window, or of its overview for blocks of ``step`` pixels; NaN where
    they are not known, and beyond the raster."""
    with rasterio.open(path) as raster:
        top, left = max(window.row, 0), max(window.column, 0)
        rows = max(min(window.row + window.rows, raster.height) - top, 0)
        columns = max(min(window.column + window.columns, raster.width) - left, 0)
        out = np.full((-(-window.rows // step), -(-window.columns // step)), np.nan, np.float32)
        if rows and columns:
            shape = -(-rows // step), -(-columns // step)
            found = raster.read(1, window=Part(left, top, columns, rows), out_shape=shape)  # type: ignore[call-arg]
            at = (top - window.row) // step, (left - window.column) // step
            out[at[0] : at[0] + shape[0], at[1] : at[1] + shape[1]] = np.where(found == NODATA, np.nan, found)
        return out


def averages(path: Path, width: int, height: float = np.inf) -> tuple[np.ndarray, rasterio.Affine]:
    """Averages (bands, rows, columns) of a raster of so many pixels in width and height at most, NaN where lengths are
    not known, and their transform to the coordinates of the file."""
    with rasterio.open(path) as raster:
        step = max(1.0, raster.width / width, raster.height / height)
        rows, columns = max(2, int(raster.height / step)), max(2, int(raster.width / step))
        found = raster.read(out_shape=(raster.count, rows, columns), resampling=Resampling.average).astype(float)
        of_file, across, down = raster.transform, raster.width / columns, raster.height / rows
    to_file = rasterio.Affine(of_file.a * across, 0, of_file.c, 0, of_file.e * down, of_file.f)
    return np.where(found == NODATA, np.nan, found), to_file


def hillshade(w: np.ndarray, pixel_m: float) -> np.ndarray:
    """Shades (rows, columns) u1, 1 to 255, 0 = not known, of heights (rows + 2, columns + 2) with a margin of a pixel;
    light from the upper left, 45 deg high."""
    right, down = (cv2.Sobel(w, cv2.CV_64F, *axis)[1:-1, 1:-1] / (8 * pixel_m) for axis in ((1, 0), (0, 1)))  # Horn's
    shade = (1 + (right + down) / np.sqrt(2)) / np.sqrt(2 * (1 + right**2 + down**2))
    return np.where(np.isfinite(shade), 1 + np.clip(shade, 0, 1) * 254, 0).astype(np.uint8)


# --- pictures ---------------------------------------------------------------------------------------------------------


def overview(path: Path, width: int, unit: str) -> bytes:
    """A JPEG file of an RGBA raster on white, at most so many pixels wide, with a scale bar in ``unit`` below: a tenth
    of its width or somewhat more."""
    rgba, to_file = averages(path, width)
    pixel, columns = to_file.a, rgba.shape[2]
    strip = np.full((_BAR, columns, 3), 255, np.uint8)
    length = round_above(columns * pixel / 10)
    cv2.rectangle(strip, (4, 8), (4 + round(length / pixel), 12), _INK, cv2.FILLED)
    _write(strip, f"{length:g} {unit}", np.array([4 + round(length / pixel / 2), 30]))
    return _jpeg(np.concatenate([np.rint(255 + (rgba[2::-1] - 255) * rgba[3] / 255).transpose(1, 2, 0), strip]))


def relief(path: Path, width: int, unit: str, lines: Sequence[Line] = ()) -> bytes:
    """A JPEG file of a raster of lengths as shaded colours with their scale below, at most so many pixels wide, with
    contour lines on it."""
    (w,), to_file = averages(path, width)
    known = np.isfinite(w)
    low, high = np.percentile(w[known], _TAILS) if known.any() else (0.0, 1.0)
    high = max(high, low + 1e-6)
    tint = _tints((np.nan_to_num(w, nan=low) - low) / (high - low))
    shade = hillshade(np.pad(np.where(known, w, np.nan), 1, mode="edge"), to_file.a)[..., None] / 255.0
    light = np.where(shade > 0, 0.35 + 0.9 * shade, 1.0)  # no shade at the edge of the known area
    drawn = np.where(known[..., None], np.clip(tint * light, 0, 255), 255).astype(np.uint8)
    for line in lines:
        at = (line.uv - [to_file.c, to_file.f]) / [to_file.a, -to_file.a]
        vertices = np.rint((at - 0.5) * (1 << _BITS)).astype(np.int32)
        thick = 2 if line.index else 1
        cv2.polylines(drawn, [vertices], False, _INK, thickness=thick, lineType=cv2.LINE_AA, shift=_BITS)
        if line.index and np.linalg.norm(np.diff(at, axis=0), axis=1).sum() > _LABELLED_PX:
            _write(drawn, f"{line.w:g}", at[len(at) // 2].astype(int))
    return _jpeg(np.concatenate([drawn, _scale(drawn.shape[1], low, high, unit)]))


def hangs(path: Path, surface: Surface, unit: str) -> str:
    """How low an underside hangs by its raster of heights, in words."""
    heights = averages(path, PICTURE_PX)[0]
    if not np.isfinite(heights).any():
        return f"{surface.name}: no height is known"
    low, middle = np.nanquantile(heights, [0.01, 0.5])
    above = surface.zero and f" above {surface.zero}"
    return f"{surface.name}: 99 % of it hang {low:.2f} {unit}{above} or higher, half {middle:.2f} {unit}"


def _jpeg(bgr: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", bgr.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()


def _tints(share: np.ndarray) -> np.ndarray:
    """BGR (rows, columns, 3) of values (rows, columns), 0 to 1."""
    return cv2.applyColorMap(np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8), cv2.COLORMAP_VIRIDIS).astype(float)


def _write(bgr: np.ndarray, text: str, middle: np.ndarray) -> None:
    """Write a text about a pixel, on a white ground."""
    (wide, high), below = cv2.getTextSize(text, _FONT, _LETTERS, 1)
    x = int(np.clip(middle[0] - wide // 2, 0, max(0, bgr.shape[1] - wide)))
    y = int(np.clip(middle[1] + high // 2, high, max(high, bgr.shape[0] - below)))
    cv2.rectangle(bgr, (x - 2, y - high - 2), (x + wide + 2, y + below), (255, 255, 255), cv2.FILLED)
    cv2.putText(bgr, text, (x, y), _FONT, _LETTERS, _INK, 1, cv2.LINE_AA)


def _scale(width: int, low: float, high: float, unit: str) -> np.ndarray:
    """The strip (rows, width, 3) BGR with the scale of the colours."""
    strip = np.full((_BAR, width, 3), 255, np.uint8)
    strip[6:20] = _tints(np.broadcast_to(np.linspace(0, 1, width), (14, width)))
    digits = max(0, 2 - int(np.floor(np.log10(high - low))))
    steps = _STEPS if width >= 500 else 2
    for k in range(steps):
        share = k / (steps - 1)
        text = f"{low + share * (high - low):.{digits}f}{f' {unit}' if k == steps - 1 else ''}"
        _write(strip, text, np.array([round(share * width), 32]))
    return strip


def write_lines(path: Path, lines: Sequence[Line], surface: Surface, place: Place) -> str:
    """Write contour lines as a GeoPackage in the CRS of the map with a style for QGIS, or as GeoJSON in degrees where
    pyogrio is missing; the name of the file, or why there is none."""
    places = [np.c_[line.uv, np.full(len(line.uv), line.w)] for line in lines]
    try:
        raw = gdal("contours.gpkg", "")
    except EngineMissing:
        if place.origin is None:
            return "not written: that needs pyogrio, pip install 'tiegraph[gis]'"
        shift, origin = np.asarray(place.origin.shift_m), place.origin
        path = path.with_suffix(".geojson")
        turned = [geodetic_from_world(xyz - shift, origin)[:, [1, 0, 2]] for xyz in places]
        with replacing(path) as temporary:
            temporary.write_text(collection(_features(lines, [np.round(xyz, 9) for xyz in turned])), encoding="utf-8")
        return path.name
    with replacing(path) as temporary:
        write_layer(raw, temporary, "contours", _features(lines, places), place.crs(surface).to_wkt())
        write_styles(raw, temporary, {"contours": _STYLE})
    return path.name


def _features(lines: Sequence[Line], places: list[np.ndarray]) -> Layer:
    about = [{"elevation_m": line.w, "index": line.index, "sigma_m": round(line.sigma, 4)} for line in lines]
    return [feature("LineString", xyz, values) for xyz, values in zip(places, about)]
