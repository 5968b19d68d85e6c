"""The accuracies on a report: each marked figure against its source, and those that stand there without a mark."""

from __future__ import annotations

import html
import json
import math
import re
from pathlib import Path

from tiegraph.scene.results import Accuracy

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "": 1.0, "°": 1.0, "%": 0.01, "units": 1.0, "単位": 1.0}
MARKED = re.compile(r'<data data-accuracy="([^"]+)">([^<]*)</data>')
WORDS = re.compile(
    r"sigma|rms|residual|accura|error|deviation|known to|off by|predicted|measured|median|rmse|scatter|max m"
)
LENGTH = re.compile(r"(?<![\w.])\d[\d.]*\s?(?:mm|cm|m)\b")
DISTANCE = re.compile(  # over which, not how well
    r"(?:over|at) [\d.]+ m\b|[\d.]+ m apart|images within [\d.]+ m|"
    r"(?:within|than) [\d.]+ m (?:of a registered|from the reference)|voxel \([\d.]+ m"
)


def source(folder: Path, key: str) -> float | None:
    """The value of a key: of the layers, of the metrics and tables of metrics.json, of a receipt's table."""
    data = json.loads((folder / "metrics.json").read_text())
    layers = Accuracy.from_dict(data["accuracy"]).values()
    if key in layers:
        return layers[key]
    kind, _, rest = key.partition(".")
    if kind == "metrics":
        return next(m["value"] for m in data["metrics"] if m["name"] == rest)
    name, row, column = rest.rsplit(".", 2)
    if kind == "receipts":
        stage, _, name = name.partition(".")
        data = json.loads((folder / "receipts" / f"{stage}.json").read_text())
    return data["tables"][name]["rows"][int(row)][int(column)]


def shown_value(text: str) -> tuple[float, float]:
    """The value that a text states in the unit of its source, and half of its last digit."""
    number, _, unit = html.unescape(text).replace("\u202f", "").replace("°", " °").partition(" ")
    digits = len(number.partition(".")[2]) if "e" not in number else 0
    half = 0.5 * 10.0**-digits if "e" not in number else 0.01 * float(number)
    return float(number) * UNITS[unit], half * UNITS[unit]


def check(folder: Path, page: str) -> set[str]:
    """Compare every marked figure with its source; its keys."""
    found = MARKED.findall(page)
    for key, text in found:
        value = source(folder, key)
        if text == "\u2013":
            assert value is None or not math.isfinite(value), key
            continue
        stated, half = shown_value(text)
        assert value is not None and abs(stated - value) <= 1.01 * half + 0.006 * abs(value), (key, text, value)
    return {key for key, _ in found}


def unmarked(page: str) -> list[str]:
    """Lengths in blocks that speak of accuracy, and numbers in columns that do, without a mark."""
    visible = re.sub(r"<style>.*?</style>|<script.*?</script>|data:[^\"]*", "", page, flags=re.S)
    out = []
    for table in re.findall(r"<table>.*?</table>", visible, re.S):
        heads = [html.unescape(h) for h in re.findall(r"<th[^>]*>(.*?)</th>", table)]
        for row in re.findall(r"<tr>(.*?)</tr>", table, re.S)[1:]:
            cells = re.findall(r"<td[^>]*>(.*?)</td>", row, re.S)
            out += [
                f"{h}: {c}" for h, c in zip(heads, cells) if WORDS.search(h.lower()) and re.fullmatch(r"[-\d.]+", c)
            ]
    bare = DISTANCE.sub("", MARKED.sub("", visible))
    blocks = re.findall(
        r"<(?:p|li|dd|td|span|b|figcaption)\b[^>]*>(.*?)</(?:p|li|dd|td|span|b|figcaption)>", bare, re.S
    )
    return out + [b for b in blocks if WORDS.search(b.lower()) and LENGTH.search(b)]
