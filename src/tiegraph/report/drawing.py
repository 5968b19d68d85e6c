"""Drawings and pictures of the page: charts as SVG; images, masks and rasters as data URIs.

Text of a chart is the page's text (language, size, light and dark), and a phone can read it: a chart is 420 units wide
with text of 12, so that on a screen of 390 px it is as large as the small print around it. Colours are variables of the
style sheet. matplotlib is not used: its SVG has fixed colours and needs a font for every language.
"""

import base64
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from markupsafe import Markup, escape

from tiegraph.scene.decoding import read_pixels
from tiegraph.text import printable, round_above

WIDTH = 420.0
USED, LIGHT, ALERT = "var(--used)", "var(--light)", "var(--alert)"
_LEFT = 50.0  # room for the numbers beside a chart
_LONGEST = 20  # letters of a name beside a matrix; the end tells more: the camera


def pass_colour(number: int) -> str:
    """The colour of a pass, a camera, a row: the style sheet has eight."""
    return f"var(--pass{number % 8})"


def text(x: float, y: float, words: object, anchor: str = "start", look: str = "") -> str:
    """Words at a place; ``anchor``: start, middle or end."""
    shown = escape(printable(str(words)))
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{_class(look)}>{shown}</text>'


def text_width(words: str) -> float:
    """Approximate width of words, in units of the chart; Japanese letters are wider."""
    return sum(12.0 if ord(c) > 0x2E80 else 6.4 for c in words)


def line(points: Iterable[Sequence[float]], colour: str = "", look: str = "") -> str:
    """A line through points (x, y) of the drawing; gaps where one is not finite."""
    steps, pen = "", "M"
    for x, y in points:
        known = math.isfinite(x) and math.isfinite(y)
        steps += f"{pen}{x:.1f} {y:.1f}" if known else ""
        pen = "L" if known else "M"
    stroke = f' style="stroke:{colour}"' if colour else ""
    return f'<path d="{steps}" fill="none"{stroke}{_class(look)}/>'


def dots(points: np.ndarray, colour: str, size: float = 4.0) -> str:
    """Round dots at points (K, 2) of the drawing, as one path."""
    steps = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points if math.isfinite(x) and math.isfinite(y))
    return f'<path d="{steps}" style="stroke:{colour};stroke-width:{size:g};stroke-linecap:round"/>' if steps else ""


def box(x: float, y: float, width: float, height: float, colour: str) -> str:
    """A filled rectangle."""
    at = f'x="{x:.1f}" y="{y:.1f}" width="{max(width, 0):.1f}" height="{max(height, 0):.1f}"'
    return f'<rect {at} style="fill:{colour}"/>'


def picture(uri: str, left: float, width: float, height: float) -> str:
    """A picture (data URI, "" = none) at the top of a drawing, its pixels sharp, on the colour of a field."""
    size = f'y="0" width="{width:.1f}" height="{height:.1f}"'
    shown = f'<image x="{left:.1f}" {size} href="{uri}" class="pixels"/>' if uri else ""
    return box(left, 0, width, height, "var(--field)") + shown


def clipped(height: float, parts: Iterable[str]) -> str:
    """Parts of a drawing that end at its border."""
    return f'<svg width="{WIDTH:g}" height="{height:.1f}" overflow="hidden">{"".join(parts)}</svg>'


def svg(height: float, parts: Iterable[str], label: str) -> Markup:
    """The chart; ``label``: its description, for those who do not see it."""
    size = f'viewBox="0 0 {WIDTH:g} {height:.0f}"'
    body = "".join(parts)  # every part escapes what it was given
    return Markup(f'<svg class="chart" {size} role="img" aria-label="{escape(printable(label))}">{body}</svg>')


def legend(entries: Sequence[tuple[str, str]], top: float) -> tuple[str, float]:
    """Names with their colours in rows from ``top`` on, and the position below them."""
    x, y, parts = 0.0, top, []
    for name, colour in entries:
        wide = text_width(name) + 26
        if 0 < x and x + wide > WIDTH:
            x, y = 0.0, y + 18
        parts += [box(x, y - 9, 10, 10, colour), text(x + 15, y, name)]
        x += wide
    return "".join(parts), y + 18


@dataclass(frozen=True)
class Area:
    """Where a chart draws, from ``top`` on and so high, and the values at its edges: left and right, bottom and top."""

    top: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    def at(self, x: float | np.ndarray, y: float | np.ndarray) -> np.ndarray:
        """(..., 2) places of the drawing of values."""
        u = _LEFT + (np.asarray(x, float) - self.x[0]) / ((self.x[1] - self.x[0]) or 1.0) * (WIDTH - _LEFT - 4)
        v = self.top + (self.y[1] - np.asarray(y, float)) / ((self.y[1] - self.y[0]) or 1.0) * self.height
        return np.stack(np.broadcast_arrays(u, v), axis=-1)

    def axes(self, x_label: str, y_label: str, whole: bool = True) -> str:
        """Grid, ticks and names; ``whole``: x counts things."""
        bottom, right, parts = self.top + self.height, WIDTH - 4, []
        for value in ticks(*self.y):
            v = self.at(0, value)[1]
            parts += [line([(_LEFT, v), (right, v)], look="grid"), text(_LEFT - 5, v + 4, tick_text(value), "end")]
        for value in ticks(*self.x, most=6, whole=whole):
            u = self.at(value, 0)[0]
            parts += [line([(u, bottom), (u, bottom + 4)], look="axis")]
            parts += [text(u, bottom + 16, tick_text(value), "middle")]
        parts.append(line([(_LEFT, bottom), (right, bottom)], look="axis"))
        parts.append(text(right, bottom + 31, x_label, "end", "name") if x_label else "")
        return "".join(parts) + text(_LEFT, self.top - 7, y_label, "start", "name")


def ticks(low: float, high: float, most: int = 5, whole: bool = False) -> list[float]:
    """Round values between two, at most about ``most``."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return []
    step = round_above((high - low) / most)
    step = max(step, 1.0) if whole else step
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def tick_text(value: float) -> str:
    """A round value as text."""
    return f"{value:,.0f}".replace(",", "\u202f") if abs(value) >= 1000 else f"{round(value, 9):g}"


def bars(rows: Sequence[tuple[str, Sequence[tuple[float, str]], str]], label: str) -> Markup:
    """Rows (name, parts (value, colour) one after the other, text at the end) as bars."""
    top = max([sum(v for v, _ in parts) for _, parts, _ in rows] + [1e-9])
    parts, y = [], 14.0
    for name, values, said in rows:
        parts += [text(0, y, name), text(WIDTH, y, said, "end", "value")]
        x = 0.0
        for value, colour in values:
            parts.append(box(x, y + 4, WIDTH * value / top, 7, colour))
            x += WIDTH * value / top
        y += 26
    return svg(y, parts, label)


@dataclass(frozen=True, eq=False)
class Series:
    """Values (K,) at places (K,) on the axis below; whether neighbours are joined."""

    name: str
    colour: str
    x: np.ndarray
    y: np.ndarray
    joined: bool = True


def plot(panels: Sequence[tuple[str, Sequence[Series]]], x_label: str, label: str, whole: bool = True) -> Markup:
    """Panels (name, series), one below the other over one axis and with one legend. Zero is in the middle if values
    may have both signs; values far beyond nearly all others are drawn at the border."""
    names = dict.fromkeys((s.name, s.colour) for _, series in panels for s in series)
    drawn, y = legend(list(names), 14)
    parts, every = [drawn], np.concatenate([s.x for _, series in panels for s in series])
    half, height = (0.5 if whole else 0.0), 150.0 if len(panels) < 3 else 84.0
    span = float(every.min()) - half, float(every.max()) + half
    for k, (name, series) in enumerate(panels):
        values = np.concatenate([s.y for s in series])
        most = 1.3 * float(np.nanpercentile(np.abs(values), 98)) + 1e-6
        below = -most if np.nanmin(values) < 0 else 0.0
        area = Area(top=y + 16, height=height, x=span, y=(below, most))
        parts.append(area.axes(x_label if k + 1 == len(panels) else "", name, whole))
        for s in series:
            at = area.at(s.x, np.clip(s.y, *area.y))
            parts += [line(at, s.colour, "thin") if s.joined else "", dots(at, s.colour, 4)]
        y += height + 44
    return svg(y + 10, parts, label)


def histogram(values: np.ndarray, few: int, x_label: str, y_label: str) -> Markup:
    """Histogram of counts; items with fewer than ``few`` are red."""
    step = max(1, -(-(int(values.max(initial=1)) + 1) // 40))
    count = np.bincount(values // step, minlength=1)
    most = 1.08 * max(int(count.max(initial=1)), 1)
    area = Area(top=20, height=120, x=(0, step * len(count)), y=(0, most))
    parts = [area.axes(x_label, y_label)]
    for k, number in enumerate(count):
        (x, y), (right, bottom) = area.at(np.array([k, k + 1]) * step, np.array([number, 0]))
        parts.append(box(x + 0.5, y, right - x - 1, bottom - y, ALERT if (k + 1) * step <= few else USED))
    return svg(184, parts, f"{x_label} / {y_label}")


def arrows(size: tuple[int, int], at: np.ndarray, moved: np.ndarray, factor: float, label: str) -> Markup:
    """Mean residuals (K, 2) in cells at (K, 2) of an image of ``size`` (width, height), ``factor`` times enlarged."""
    zoom = WIDTH / size[0]
    parts = [picture("", 0, WIDTH, zoom * size[1])]
    for start, step in zip(zoom * at, zoom * factor * moved):
        end = start + step
        head = [end + 0.35 * np.array([[-1, side], [-side, -1]]) @ step for side in (0.6, -0.6)]
        parts += [line([start, end], USED, "thin"), line([head[0], end, head[1]], USED, "thin")]
    return svg(zoom * size[1], [clipped(zoom * size[1], parts)], label)


def matrix(
    uri: str, names: Sequence[tuple[float, str]], edges: Sequence[float], key: Sequence[tuple[str, str]], label: str
) -> Markup:
    """A square picture (data URI) with the names of its blocks (middle as a share, name), borders and a key."""
    names = [(m, n if len(n) <= _LONGEST else "…" + n[1 - _LONGEST :]) for m, n in names]
    left = 1.2 * max([text_width(n) for _, n in names], default=0.0) + 6  # in a wide font
    side = WIDTH - left
    parts = [picture(uri, left, side, side)]
    for place in (edge * side for edge in edges):
        parts.append(line([(left, place), (WIDTH, place)], look="grid"))
        parts.append(line([(left + place, 0), (left + place, side)], look="grid"))
    parts += [text(left - 5, m * side + 4, n, "end") for m, n in names]
    drawn, y = legend(key, side + 18)
    return svg(y, [*parts, drawn], label)


def _class(look: str) -> str:
    return f' class="{look}"' if look else ""


_WIDTH_PX = 1400  # of a picture of a file
_IGNORED = "#d2283c"  # masked pixels
CLASSES = (  # by number, as in the masks stage: name, colour; pixels used by their class may be left out too
    ("used", _IGNORED),
    ("sky", "#2a78d6"),
    ("water", "#12a594"),
    ("platform", "#d2283c"),
    ("overexposed", "#e8b200"),
)


def png(rgb: np.ndarray) -> Markup:
    """An (H, W, 3) u1 picture, or one with alpha (H, W, 4), as a PNG data URI."""
    return _encoded(rgb, "png", [cv2.IMWRITE_PNG_COMPRESSION, 9])


def jpeg(rgb: np.ndarray) -> Markup:
    """An (H, W, 3) u1 picture as a JPEG data URI."""
    return _encoded(rgb, "jpeg", [cv2.IMWRITE_JPEG_QUALITY, 82])


def _encoded(rgb: np.ndarray, kind: str, options: list[int]) -> Markup:
    bgr = rgb[..., [2, 1, 0, 3][: rgb.shape[2]]]
    return _data_uri(cv2.imencode(f".{kind}", np.ascontiguousarray(bgr), options)[1].tobytes(), kind)


def _data_uri(data: bytes, kind: str) -> Markup:
    """Not escaped: it may look like a path."""
    return Markup(f"data:image/{kind};base64,{base64.b64encode(data).decode()}")


def rgb_of(colour: str) -> list[int]:
    """Red, green and blue of a colour such as #2a78d6."""
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def file_uri(path: Path) -> Markup | None:
    """A picture file (PNG or JPEG) as a data URI, scaled down to a width of 1400; None if it cannot be read."""
    data = path.read_bytes() if path.exists() else b""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if image is None:
        return None
    kind = {".png": "png", ".jpg": "jpeg"}.get(path.suffix.lower())
    if image.shape[1] <= _WIDTH_PX and kind:
        return _data_uri(data, kind)
    return png(_shrunk(image, _WIDTH_PX)[..., ::-1])


def thumbnail(
    image: Path, mask: Path, classes: Path | None = None, width: int = 320
) -> tuple[Markup, float | None] | None:
    """The image with ignored areas in red, or in the colours of their ``classes``, and the share of usable pixels (None
    without a mask); None if it cannot be read."""
    picture = read_pixels(image, cv2.IMREAD_COLOR)
    if picture is None:
        return None
    picture = _shrunk(picture, width)[..., ::-1]
    use = read_pixels(mask)
    if use is None:
        return jpeg(picture), None
    labels = None if classes is None else read_pixels(classes)
    size = picture.shape[1::-1]
    small = cv2.resize(np.zeros_like(use) if labels is None else labels, size, interpolation=cv2.INTER_NEAREST)
    colours = np.array([rgb_of(colour) for _, colour in CLASSES])[np.minimum(small, len(CLASSES) - 1)]
    kept = cv2.resize(use, size, interpolation=cv2.INTER_NEAREST) > 0
    shown = np.where(kept[..., None], picture, (0.45 * picture + 0.55 * colours).astype(np.uint8))
    return jpeg(shown), float(np.mean(use > 0))


def mask_share(mask: Path) -> float | None:
    """Share of usable pixels of a mask file; None if it cannot be read."""
    use = read_pixels(mask, cv2.IMREAD_REDUCED_GRAYSCALE_2)
    return None if use is None else float(np.mean(use > 127))


def _shrunk(picture: np.ndarray, width: int) -> np.ndarray:
    if picture.shape[1] <= width:
        return picture
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def shown_colours(xyz: np.ndarray, rgb: np.ndarray) -> np.ndarray:
    """Colours (N, 3) u1, stretched so that the brightest 2 % are white, at most 1.7 times; by height without any."""
    if not len(rgb) or np.ptp(rgb) <= 8:
        return by_height(xyz[:, 2])
    return np.clip(rgb * min(1.7, 250 / max(float(np.quantile(rgb.max(axis=1), 0.98)), 1.0)), 0, 255).astype(np.uint8)


def by_height(z: np.ndarray) -> np.ndarray:
    """Colours (N, 3) u1 by height, for clouds without colour."""
    low, high = np.quantile(z, [0.02, 0.98]) if len(z) else (0.0, 1.0)
    level = (255 * np.clip((z - low) / max(high - low, 1e-9), 0, 1)).astype(np.uint8)
    return cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_VIRIDIS).reshape(256, 3)[:, ::-1][level]
