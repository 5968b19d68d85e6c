"""All accuracies of a survey as one table that spreadsheets open: one value a row."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from typing import Any

from tiegraph.scene.accuracy import MEASURED, PREDICTED, Accuracy

_AXES = ("east", "north", "up")


def accuracy_csv(said: Mapping[str, Any], tables: Mapping[str, Mapping[str, Any]], world: dict) -> str:
    """CSV (about, item, quantity, value, unit) of what metrics.json says (``said``: its layers and metrics), of the
    tables {name: {"columns", "rows"}} by their first column, and of each frame's position by ``world`` (world.json)."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(["about", "item", "quantity", "value", "unit"])
    for key, value in Accuracy.from_dict(said["accuracy"]).values().items():
        unit = said["accuracy"]["unit"] if key.endswith((PREDICTED, MEASURED)) else ""
        out.writerow(["accuracy", "", key, _text(value), unit])
    for m in said["metrics"]:
        out.writerow(["survey", "", m["name"], _text(m["value"]), m["unit"]])
    out.writerows([about, item, name, _text(value), ""] for about, item, name, value in _frames(world))
    for about, table in tables.items():
        for first, *cells in table["rows"]:
            out.writerows([about, first, name, _text(v), ""] for name, v in zip(table["columns"][1:], cells))
    return text.getvalue()


def _frames(world: dict) -> Iterator[tuple[str, Any, str, Any]]:
    for frame in world.get("frames", ()):
        for kind in ("residual_m", "held_out_m"):
            for axis, value in zip(_AXES, frame.get(kind) or ()):
                yield f"{kind.removesuffix('_m').replace('_', ' ')} of a frame, m", frame["frame"], axis, value


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
