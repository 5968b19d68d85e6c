"""Numbers in the notation of surveyors: units, sensible digits, spaces between thousands."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from tiegraph.report.texts import said, t
from tiegraph.text import printable

# An absolute path of two names or more, on Linux, macOS or Windows; ends where a space, a quote or a comma does.
_FOLDERS = re.compile(r"(?<![\w.:/\\])(?:/[^\s/:,;'\"()]+)+/(?=[^\s/:,;'\"()])|\b[A-Za-z]:\\(?:[^\s\\:,;'\"]+\\)+")
_NAMES = ("camera", "pass", "pass and camera", "rig", "image", "near image", "point")  # columns
_NO_NAMES = ("all", "(loose)", "(none)")
NONE = "–"  # an en dash: not known
_NOTHING = 1e-7  # smaller numbers are rounding errors


@dataclass(frozen=True)
class Table:
    """A table ready to print: texts, and which columns are numbers."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: tuple[bool, ...]
    title: str = ""


def count(value: Any) -> str:
    """A whole number with thin spaces between thousands."""
    return NONE if not is_number(value) else f"{round(value):,}".replace(",", "\u202f")


def number(value: Any, digits: int = 3) -> str:
    """A number with about three significant digits, never in powers of ten unless tiny."""
    if not is_number(value):
        return NONE
    value = float(value)
    if abs(value) < _NOTHING:
        return "0"
    magnitude = math.floor(math.log10(abs(value)))
    if magnitude >= digits - 1:
        return count(value)
    if magnitude < -5:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{digits - 1 - magnitude}f}"


def length(value: Any, unit: str = "m") -> str:
    """A length; below half a metre in centimetres or millimetres when the unit is metres."""
    if not is_number(value) or unit != "m" or abs(value) < _NOTHING:
        return f"{number(value)} {t(unit)}" if is_number(value) else NONE
    if abs(value) < 0.01:
        return f"{number(1000 * value, 2)} mm"
    if abs(value) < 0.5:
        return f"{100 * value:.1f} cm"
    return f"{number(value)} m"


def percent(share: Any) -> str:
    """A share 0..1 in percent; 100 % only when it is all."""
    if not is_number(share):
        return NONE
    text = f"{100 * share:.0f}" if share in (0, 1) or 0.1 < share < 0.99 else f"{100 * share:.1f}"
    return f"{'99.9' if text == '100.0' and share < 1 else text} %"


def seconds(value: Any) -> str:
    """A duration."""
    if not is_number(value):
        return NONE
    if value < 10:
        return f"{value:.1f} s"
    if value < 120:
        return f"{value:.0f} s"
    minutes, rest = divmod(round(value), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def size(value: Any) -> str:
    """Bytes in MB or GB."""
    if not is_number(value):
        return NONE
    return f"{value / 1e9:.2f} GB" if value >= 1e9 else f"{number(value / 1e6, 2)} MB"


def table(data: Any, title: str = "", key: str = "") -> Table | None:
    """A Table from {"columns": [..], "rows": [[..], ..]}; None if it is not one or has no rows. ``key``: numbers are
    marked with it, their row and their column, so that they can be compared with their source."""
    if not isinstance(data, dict) or not data.get("rows") or not data.get("columns"):
        return None
    heads = [str(c).replace("_", " ") for c in data["columns"]]
    rows = [list(row) if isinstance(row, (list, tuple)) else [row] for row in data["rows"]]
    columns = list(zip(*((row + [None] * len(heads))[: len(heads)] for row in rows)))
    numeric = tuple(all(v is None or _is_number(v) for v in column) for column in columns)
    printed = []
    for c, (head, column) in enumerate(zip(heads, columns)):
        names = head in _NAMES  # of cameras, passes and images: they stay in every language
        words = (text if names and text not in _NO_NAMES else said(text) for text in map(cell, column))
        texts = _column(column) if numeric[c] else list(words)
        if key and numeric[c]:
            texts = [text if text == NONE else marked(f"{key}.{r}.{c}", text) for r, text in enumerate(texts)]
        printed.append(texts)
    return Table(columns=tuple(map(said, heads)), rows=tuple(zip(*printed)), numeric=numeric, title=title)


def marked(key: str, text: str) -> Markup:
    """A figure on the page, with the key of its value: "world.predicted", "metrics.ghosts", "tables.<name>.0.3"."""
    return Markup('<data data-accuracy="{}">{}</data>').format(key, text)


def _column(values: Sequence[Any]) -> list[str]:
    """Numbers of one column with the same number of decimals, unless they are of very different size."""
    sizes = sorted(abs(v) for v in values if is_number(v) and abs(v) > _NOTHING)
    whole = all(not is_number(v) or float(v).is_integer() for v in values)
    if not sizes or whole or sizes[-1] > 3000 * sizes[0]:
        return [cell(v) for v in values]
    digits = min(max(0, 2 - math.floor(math.log10(sizes[len(sizes) // 2]))), 6)
    return [f"{v:,.{digits}f}".replace(",", "\u202f") if is_number(v) else NONE for v in values]


def shown(text: str) -> str:
    """A text with invisible characters escaped, and with absolute paths reduced to their last name: folders of the
    maker's machine are private."""
    return printable(_FOLDERS.sub("", text))


def cell(value: Any) -> str:
    """A value of a table as text."""
    value = value.item() if hasattr(value, "item") else value
    if value is None:
        return NONE
    if isinstance(value, bool):
        return t("yes") if value else t("no")
    if isinstance(value, int) or (isinstance(value, float) and value.is_integer() and abs(value) < 1e15):
        return count(value)
    if isinstance(value, float):
        return number(value)
    if isinstance(value, (list, tuple)):
        return ", ".join(cell(v) for v in value)
    return value if isinstance(value, str) else str(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Whether a value of a receipt is a finite number."""
    return _is_number(value) and math.isfinite(value)
