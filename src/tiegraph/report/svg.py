"""Charts as SVG inside the page: text is the page's text (language, size, light and dark), and a phone can read it.

A chart is 420 units wide with text of 12, so that on a screen of 390 px it is as large as the small print around it.
Colours are variables of the style sheet. First what charts are drawn with, then the charts of the engineer's part.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from tiegraph.report.texts import t
from tiegraph.text import printable

WIDTH = 420.0
PASSES = 8  # colours --pass0 ... of the style sheet
_CHARACTER = 6.4  # mean width of a letter of 12 units
_WIDE = 12.0  # of a Japanese one


def pass_colour(number: int) -> str:
    """The colour of a pass, a camera, a row."""
    return f"var(--pass{number % PASSES})"


def text(x: float, y: float, words: object, anchor: str = "start", look: str = "") -> str:
    """Words at a place; ``anchor``: start, middle or end."""
    shown = escape(printable(str(words)))
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{_class(look)}>{shown}</text>'


def text_width(words: str) -> float:
    """About how wide words are, in units of the chart."""
    return sum(_WIDE if ord(c) > 0x2E80 else _CHARACTER for c in words)


def line(points: Iterable[Sequence[float]], colour: str = "", look: str = "") -> str:
    """A line through points (x, y) of the drawing; gaps where one is not finite."""
    parts, pen = [], "M"
    for x, y in points:
        if not (math.isfinite(x) and math.isfinite(y)):
            pen = "M"
            continue
        parts.append(f"{pen}{x:.1f} {y:.1f}")
        pen = "L"
    stroke = f' style="stroke:{colour}"' if colour else ""
    return f'<path d="{"".join(parts)}" fill="none"{stroke}{_class(look)}/>'


def dots(points: np.ndarray, colour: str, size: float = 4.0) -> str:
    """Round dots at points (K, 2) of the drawing, as one path."""
    steps = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points if math.isfinite(x) and math.isfinite(y))
    return f'<path d="{steps}" style="stroke:{colour};stroke-width:{size:g};stroke-linecap:round"/>' if steps else ""


def box(x: float, y: float, width: float, height: float, colour: str, look: str = "") -> str:
    """A filled rectangle."""
    at = f'x="{x:.1f}" y="{y:.1f}" width="{max(width, 0):.1f}" height="{max(height, 0):.1f}"'
    return f'<rect {at} style="fill:{colour}"{_class(look)}/>'


def svg(height: float, parts: Iterable[str], label: str) -> Markup:
    """The chart; ``label``: what it shows, for those who do not see it."""
    name = escape(printable(label))
    body = "".join(parts)
    return Markup(  # every part above escapes what it was given
        f'<svg class="chart" viewBox="0 0 {WIDTH:g} {height:.0f}" role="img" aria-label="{name}">{body}</svg>'
    )


@dataclass(frozen=True)
class Area:
    """Where a chart draws, in its units, and the values at the edges: x left and right, y bottom and top."""

    left: float
    top: float
    width: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(K, 2) places of the drawing of values (K,)."""
        u = self.left + (np.asarray(x, float) - self.x[0]) / _span(self.x) * self.width
        v = self.top + (self.y[1] - np.asarray(y, float)) / _span(self.y) * self.height
        return np.stack([u, v], axis=-1)

    def axes(self, x_label: str = "", y_label: str = "", whole: bool = False, x_ticks: bool = True) -> str:
        """Grid, ticks and names; ``whole``: x counts things."""
        bottom, right = self.top + self.height, self.left + self.width
        parts = []
        for value in ticks(*self.y):
            v = self.at(np.zeros(1), np.array([value]))[0, 1]
            parts.append(line([(self.left, v), (right, v)], look="grid"))
            parts.append(text(self.left - 5, v + 4, tick_text(value), "end"))
        for value in ticks(*self.x, most=6, whole=whole) if x_ticks else ():
            u = self.at(np.array([value]), np.zeros(1))[0, 0]
            parts.append(line([(u, bottom), (u, bottom + 4)], look="axis"))
            parts.append(text(u, bottom + 16, tick_text(value), "middle"))
        parts.append(line([(self.left, bottom), (right, bottom)], look="axis"))
        if x_label:
            parts.append(text(right, bottom + 31, x_label, "end", "name"))
        if y_label:
            parts.append(text(self.left, self.top - 7, y_label, "start", "name"))
        return "".join(parts)


def legend(entries: Sequence[tuple[str, str]], top: float) -> tuple[str, float]:
    """Names with their colours in rows from ``top`` on, and where the next thing may stand."""
    x, y, parts = 0.0, top, []
    for name, colour in entries:
        wide = text_width(name) + 26
        if 0 < x and x + wide > WIDTH:
            x, y = 0.0, y + 18
        parts.append(box(x, y - 9, 10, 10, colour))
        parts.append(text(x + 15, y, name))
        x += wide
    return "".join(parts), y + 18


def ticks(low: float, high: float, most: int = 5, whole: bool = False) -> list[float]:
    """Round values between two, at most about ``most``."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return []
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= raw * 0.999)
    step = max(step, 1.0) if whole else step
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def tick_text(value: float) -> str:
    """A round value as text."""
    return f"{value:,.0f}".replace(",", "\u202f") if abs(value) >= 1000 else f"{round(value, 9):g}"


def _span(ends: tuple[float, float]) -> float:
    return (ends[1] - ends[0]) or 1.0


def _class(look: str) -> str:
    return f' class="{look}"' if look else ""


_ROW = 26.0
USED, LIGHT, ALERT, SOFT = "var(--used)", "var(--light)", "var(--alert)", "var(--soft)"
_LONGEST = 20  # letters of a name beside a matrix; the end tells more: the camera
_WIDER = 1.2  # than the mean letter, in a wide font


def bars(rows: Sequence[tuple[str, Sequence[tuple[float, str]], str]], label: str) -> Markup:
    """Rows (name, parts (value, colour) one after the other, text at the end) as bars."""
    top = max([sum(v for v, _ in parts) for _, parts, _ in rows] + [1e-9])
    parts, y = [], 14.0
    for name, values, said in rows:
        parts += [text(0, y, name), text(WIDTH, y, said, "end", "value")]
        x = 0.0
        for value, colour in values:
            wide = WIDTH * value / top
            parts.append(box(x, y + 4, wide, 7, colour))
            x += wide
        y += _ROW
    return svg(y, parts, label)


def residuals(
    frames: np.ndarray, enu_m: np.ndarray, used: np.ndarray, track: np.ndarray, names: Sequence[str]
) -> Markup:
    """Residuals (K, 3) of the frames' positions, one panel a component; outliers, not ``used`` (K,), in red."""
    shown = [k for k in np.unique(track)]
    entries = [(names[k] if 0 <= k < len(names) else t("frames"), pass_colour(int(k))) for k in shown]
    entries += [(t("outlier"), ALERT)] if not used.all() else []
    top, y = legend(entries, 14)
    parts, span = [top], (float(frames.min()) - 0.5, float(frames.max()) + 0.5)
    for c, name in enumerate((t("east, m"), t("north, m"), t("up, m"))):
        most = 1.15 * max(float(np.nanmax(np.abs(enu_m[:, c]))), 1e-6)
        last = c == 2
        area = Area(left=46, top=y + 16, width=WIDTH - 50, height=84, x=span, y=(-most, most))
        parts.append(area.axes(t("frame") if last else "", name, whole=True))
        at = area.at(frames, enu_m[:, c])
        parts.append(line(area.at(np.array(span), np.zeros(2)), look="axis"))
        parts += [dots(at[used & (track == k)], pass_colour(int(k))) for k in shown]
        parts.append(dots(at[~used], ALERT, 6))
        y += 128
    return svg(y + 10, parts, t("Fit to the given positions"))


def histogram(values: np.ndarray, few: int, x_label: str, y_label: str) -> Markup:
    """How many things have how many; what has fewer than ``few`` is red."""
    most = int(values.max(initial=1))
    step = max(1, -(-(most + 1) // 40))
    count = np.bincount(values // step, minlength=1)
    area = Area(
        left=40,
        top=20,
        width=WIDTH - 46,
        height=120,
        x=(0, step * len(count)),
        y=(0, 1.08 * max(int(count.max(initial=1)), 1)),
    )
    parts = [area.axes(x_label, y_label, whole=True)]
    for k, number in enumerate(count):
        (x, y), (right, bottom) = area.at(np.array([k, k + 1]) * step, np.array([number, 0]))
        parts.append(box(x + 0.5, y, right - x - 1, bottom - y, ALERT if (k + 1) * step <= few else USED))
    return svg(184, parts, f"{x_label} / {y_label}")


def shares(rows: Sequence[Sequence[float]]) -> Markup:
    """(distance m, accuracy %, completeness %, F %) as grouped bars."""
    kinds = ((t("accuracy"), LIGHT), (t("completeness"), USED), (t("F-score"), "var(--dark)"))
    top, y = legend(kinds, 14)
    area = Area(left=30, top=y + 12, width=WIDTH - 30, height=120, x=(-0.5, len(rows) - 0.5), y=(0, 110))
    parts = [top, area.axes("", t("% of points"), x_ticks=False)]
    for k, row in enumerate(rows):
        for c, (_, colour) in enumerate(kinds):
            value = float(row[c + 1] or 0)
            (x, v), (right, bottom) = area.at(
                np.array([k + 0.27 * (c - 1.5), k + 0.27 * (c - 0.5)]), np.array([value, 0])
            )
            parts.append(box(x + 1, v, right - x - 2, bottom - v, colour))
            parts.append(text((x + right) / 2, v - 3, f"{value:.0f}", "middle", "tiny"))
        parts.append(text((x + right) / 2 - 27, bottom + 16, f"{row[0]:g} m", "middle"))
    return svg(area.top + 146, parts, t("Cloud against reference"))


def along(series: Sequence[tuple[str, np.ndarray, np.ndarray, float]], y_label: str, label: str) -> Markup:
    """Values along the frames, (name, frames, values, half width of its band) a series, and their bands about zero."""
    top, y = legend([(name, pass_colour(k)) for k, (name, *_) in enumerate(series)], 14)
    frames = np.concatenate([f for _, f, _, _ in series])
    size = np.abs(np.concatenate([v for _, _, v, _ in series]))
    most = 1.3 * float(np.percentile(size, 98)) + 1e-6
    area = Area(
        left=50,
        top=y + 16,
        width=WIDTH - 54,
        height=150,
        x=(float(frames.min()) - 0.5, float(frames.max()) + 0.5),
        y=(-most, most),
    )
    parts = [top, area.axes(t("frame"), y_label, whole=True)]
    for k, (_, _, _, band) in enumerate(series):
        edge = area.at(np.array(area.x), np.array([min(band, most), -min(band, most)]))
        parts.append(box(edge[0, 0], edge[0, 1], area.width, edge[1, 1] - edge[0, 1], pass_colour(k), "band"))
    for k, (_, at, values, _) in enumerate(series):
        inside = np.clip(values, -most, most)
        parts += [line(area.at(at, inside), pass_colour(k), "thin"), dots(area.at(at, inside), pass_colour(k), 3)]
    return svg(area.top + 188, parts, label)


def arrows(size: tuple[int, int], at: np.ndarray, moved: np.ndarray, factor: float, label: str) -> Markup:
    """Mean residuals (K, 2) in cells at (K, 2) of an image of ``size`` (width, height), ``factor`` times enlarged."""
    zoom = WIDTH / size[0]
    inner = f'<svg width="{WIDTH:g}" height="{zoom * size[1]:.1f}" overflow="hidden">'  # arrows end at the border
    parts = [inner, box(0, 0, WIDTH, zoom * size[1], "var(--field)")]
    for start, step in zip(zoom * at, zoom * factor * moved):
        end = start + step
        turn = 0.35 * np.array([[-1, 0.6], [-0.6, -1]]) @ step
        back = 0.35 * np.array([[-1, -0.6], [0.6, -1]]) @ step
        parts.append(line([start, end], USED, "thin"))
        parts.append(line([end + turn, end, end + back], USED, "thin"))
    return svg(zoom * size[1], [*parts, "</svg>"], label)


def matrix(
    picture: str, names: Sequence[tuple[float, str]], edges: Sequence[float], key: Sequence[tuple[str, str]], label: str
) -> Markup:
    """A square picture (data URI) with the names of its blocks (middle as a share, name), borders and a key."""
    names = [(m, n if len(n) <= _LONGEST else "…" + n[1 - _LONGEST :]) for m, n in names]
    left = _WIDER * max([text_width(n) for _, n in names], default=0.0) + 6
    side = WIDTH - left
    parts = [box(left, 0, side, side, "var(--field)")]
    parts.append(
        f'<image x="{left:.1f}" y="0" width="{side:.1f}" height="{side:.1f}" href="{picture}" class="pixels"/>'
    )
    for edge in edges:
        place = edge * side
        parts.append(line([(left, place), (WIDTH, place)], look="grid"))
        parts.append(line([(left + place, 0), (left + place, side)], look="grid"))
    parts += [text(left - 5, m * side + 4, n, "end") for m, n in names]
    drawn, y = legend(key, side + 18)
    return svg(y, [*parts, drawn], label)
