"""What charts are drawn with: a plot area with axes, lines, dots, bars, and the SVG around them."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

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


def legend(entries: Sequence[tuple[str, str]], top: float, left: float = 0.0) -> tuple[str, float]:
    """Names with their colours in rows from ``top`` on, and where the next thing may stand."""
    x, y, parts = left, top, []
    for name, colour in entries:
        wide = text_width(name) + 26
        if x > left and x + wide > WIDTH:
            x, y = left, y + 18
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
