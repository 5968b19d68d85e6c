"""Charts of the engineer's part: time and memory, pairs by step, ties, residuals, the rig, the lens, a reference."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from tiegraph.report.svg.drawing import WIDTH, Area, box, dots, legend, line, pass_colour, svg, text, text_width
from tiegraph.report.texts import t

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
