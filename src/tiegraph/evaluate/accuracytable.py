"""All accuracies of a survey as one table that spreadsheets open: one value a row."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

_AXES = ("east", "north", "up")
_GEOREF = {  # of world.json -> what the table calls it
    "rms_m": "residuals of the positions, m",
    "held_out_rms_m": "residuals of held out positions, m",
    "sigma": "sigma of the place in the world",
    "model_sigma": "sigma of positions inside the model, m",
}


def accuracy_csv(metrics: Iterable[Mapping[str, Any]], tables: Mapping[str, Mapping[str, Any]], world: dict) -> str:
    """CSV (about, item, quantity, value, unit) of the metrics, the tables {name: {"columns", "rows"}} by their first
    column, and what ``world`` (world.json) says of the georeference and of each frame's position."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(["about", "item", "quantity", "value", "unit"])
    for m in metrics:
        out.writerow(["survey", "", m["name"], _text(m["value"]), m["unit"]])
    out.writerows([about, item, name, _text(value), ""] for about, item, name, value in _georef(world))
    for about, table in tables.items():
        for first, *cells in table["rows"]:
            out.writerows([about, first, name, _text(v), ""] for name, v in zip(table["columns"][1:], cells))
    return text.getvalue()


def _georef(world: dict) -> Iterator[tuple[str, Any, str, Any]]:
    for name, about in _GEOREF.items():
        for key, value in (world.get(name) or {}).items():
            yield about, "", key, value
    for frame in world.get("frames", ()):
        for kind in ("residual_m", "held_out_m"):
            for axis, value in zip(_AXES, frame.get(kind) or ()):
                yield f"{kind.removesuffix('_m').replace('_', ' ')} of a frame, m", frame["frame"], axis, value


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
