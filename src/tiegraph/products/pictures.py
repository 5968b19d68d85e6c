"""Small pictures of the rasters, as `report.html` shows them: the orthophoto, and heights as colours in relief."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.enums import Resampling

from tiegraph.products.contours import Line
from tiegraph.products.raster import hillshade
from tiegraph.products.surface import NODATA

PICTURE_PX = 1400
"""Width of a picture at most."""
_QUALITY = 85
_TAILS = (0.5, 99.5)  # percentiles of the heights between which the colours spread
_BAR, _STEPS = 44, 5  # height of the strip with the scale, pixels; numbers on it
_FONT, _LETTERS = cv2.FONT_HERSHEY_SIMPLEX, 0.5
_BITS = 4  # of a pixel's fraction, in OpenCV's coordinates
_LABELLED_PX = 160  # an index line of this length has its height beside it
_INK = (40, 40, 40)


def overview(path: Path, width: int) -> bytes:
    """A JPEG file of an RGBA raster on white, at most so many pixels wide."""
    with rasterio.open(path) as raster:
        rgba = raster.read(out_shape=(4, *_shape(raster, width)), resampling=Resampling.average).astype(float)
    return _jpeg(np.rint(255 + (rgba[2::-1] - 255) * rgba[3] / 255).transpose(1, 2, 0))


def relief(path: Path, width: int, unit: str, lines: Sequence[Line] = ()) -> bytes:
    """A JPEG file of a raster of lengths as shaded colours with their scale below, at most so many pixels wide, with
    contour lines on it."""
    with rasterio.open(path) as raster:
        shape = _shape(raster, width)
        w = raster.read(1, out_shape=shape, resampling=Resampling.average).astype(float)
        to_file, pixel = raster.transform, raster.transform.a * raster.width / shape[1]
    w[w == NODATA] = np.nan
    known = np.isfinite(w)
    low, high = np.percentile(w[known], _TAILS) if known.any() else (0.0, 1.0)
    high = max(high, low + 1e-6)
    tint = _tints((np.nan_to_num(w, nan=low) - low) / (high - low))
    shade = hillshade(np.pad(np.where(known, w, np.nan), 1, mode="edge"), pixel)[..., None] / 255.0
    light = np.where(shade > 0, 0.35 + 0.9 * shade, 1.0)  # no shade at the edge of the known area
    drawn = np.where(known[..., None], np.clip(tint * light, 0, 255), 255).astype(np.uint8)
    for line in lines:
        _draw(drawn, (line.uv - [to_file.c, to_file.f]) / [pixel, -pixel], line)
    return _jpeg(np.concatenate([drawn, _scale(drawn.shape[1], low, high, unit)]))


def _shape(raster: rasterio.io.DatasetReader, width: int) -> tuple[int, int]:
    step = max(1.0, raster.width / width)
    return max(1, int(raster.height / step)), max(1, int(raster.width / step))


def _jpeg(bgr: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", bgr.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


def _tints(share: np.ndarray) -> np.ndarray:
    """BGR (rows, columns, 3) of values (rows, columns), 0 to 1."""
    return cv2.applyColorMap(np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8), cv2.COLORMAP_VIRIDIS).astype(float)


def _draw(bgr: np.ndarray, at: np.ndarray, line: Line) -> None:
    """Draw a contour line at pixels (N, 2), an index line thick and with its height."""
    vertices = np.rint((at - 0.5) * (1 << _BITS)).astype(np.int32)
    thick = 2 if line.index else 1
    cv2.polylines(bgr, [vertices], False, _INK, thickness=thick, lineType=cv2.LINE_AA, shift=_BITS)
    if line.index and np.linalg.norm(np.diff(at, axis=0), axis=1).sum() > _LABELLED_PX:
        _write(bgr, f"{line.w:g}", at[len(at) // 2].astype(int))


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
