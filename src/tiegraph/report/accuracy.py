"""The accuracy of a run in words, for the page and the terminal: every figure is taken from ``scene.accuracy`` by key.

On the page each figure is marked with its key (``<data data-accuracy="world.predicted">``), so that a test can hold all
of them against the one source.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from markupsafe import Markup

from tiegraph.report import formatting
from tiegraph.report.formatting import marked
from tiegraph.scene.accuracy import LAYERS, MEASURED, PREDICTED, Accuracy, Figure
from tiegraph.text import known_to

_DISTANCES = (("10m", "over 10 m"), ("100m", "over 100 m"), ("whole", "over the whole"))
_PLACEMENT = {  # name -> (words, unit, factor, where nothing is known)
    "position_m": ("position", "m", 1.0, 0.0), "height_m": ("height", "m", 1.0, 0.0),
    "yaw_deg": ("heading", "°", 1.0, 90.0), "tilt_deg": ("tilt", "°", 1.0, 90.0),
    "scale": ("scale", " %", 100.0, 100.0),
}  # fmt: skip


def sentences(accuracy: Accuracy) -> list[Markup]:
    """The answer to the tolerance, then the three layers, one sentence each or two."""
    return [*_answer(accuracy), _world(accuracy), _shape(accuracy), _point(accuracy)]


def terminal_lines(metrics_file: Path) -> list[str]:
    """The same as plain lines, of a metrics.json; [] without one that can be read."""
    try:
        accuracy = Accuracy.from_dict(json.loads(metrics_file.read_text(encoding="utf-8"))["accuracy"])
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [str(line.striptags()) for line in sentences(accuracy)]


def tiles(accuracy: Accuracy) -> Iterator[tuple[Markup, Markup]]:
    """(figure, label) of each layer."""
    for layer, name in LAYERS.items():
        best = _best(accuracy.of(layer))
        told = Markup("; measured {} ({})").format(_value(accuracy, best, MEASURED), best.of) if best else ""
        yield _value(accuracy, accuracy.head(layer), PREDICTED), Markup("{}, predicted{}").format(name, told)


def table(accuracy: Accuracy) -> formatting.Table:
    """Every figure: predicted, measured, their ratio, by what, and what it does not prove."""
    rows = []
    for f in accuracy.figures:
        values = (_value(accuracy, f, PREDICTED), _value(accuracy, f, MEASURED))
        known = f"{f.key}.ratio" in accuracy.values()
        ratio = marked(f"{f.key}.ratio", formatting.number(f.ratio, 2)) if known else formatting.NONE
        rows.append((LAYERS[f.layer], f.of, *values, ratio, f.by or formatting.NONE, f.proves_not))
    columns = ("layer", "of", "predicted", "measured", "measured / predicted", "measured by", "does not prove")
    return formatting.Table(columns, tuple(rows), (False, False, True, True, True, False, False))


def placement(accuracy: Accuracy) -> Markup:
    """How the model as a whole is known to stand; "" where it is not placed."""
    parts = [part for name in _PLACEMENT if (part := placement_part(accuracy, name))]
    text = "The model as a whole is placed, at its middle, with standard deviations of: {}."
    return Markup(text).format(Markup("; ").join(parts)) if parts else Markup()


def placement_part(accuracy: Accuracy, name: str) -> Markup:
    """One of them in words: "tilt 1.4°"; "" if it is not known."""
    value, (words, unit, factor, most) = accuracy.placement.get(name), _PLACEMENT[name]
    if value is None or not formatting.is_number(value):
        return Markup()
    text = formatting.length(value) if unit == "m" else formatting.number(factor * value, 2) + unit
    if unit != "m" and known_to(factor * value, most, "") == "not known":
        return Markup("{} not known").format(words)
    return Markup("{} {}").format(words, marked(f"placement.{name}", text))


def _answer(accuracy: Accuracy) -> Iterator[Markup]:
    answer = accuracy.answer
    if answer is None:
        return
    asked = marked("tolerance", formatting.length(answer.tolerance_m))
    remedy = f" What would make it yes: {answer.remedy}." if answer.remedy else ""
    yield Markup("Tolerance of {} in the world: {}. Reason: {}.{}").format(asked, answer.said, answer.why, remedy)


def _world(accuracy: Accuracy) -> Markup:
    first, most = accuracy.figure("world"), accuracy.figure("world.nine_in_ten")
    if not accuracy.of("world"):
        return Markup("In the world: not known, for nothing holds it there.")
    known = [_value(accuracy, f, PREDICTED) for f in (first, most)]
    text = Markup("In the world: {} predicted of a point of the cloud (median), {} of nine in ten; held by {}.")
    return text.format(*known, accuracy.held_by) + _measured(accuracy, accuracy.of("world"))


def _shape(accuracy: Accuracy) -> Markup:
    figures = {name: accuracy.figure(f"shape.{name}") for name, _ in _DISTANCES}
    said = []
    for what in (PREDICTED, MEASURED):
        keys = accuracy.values()
        parts = [
            Markup("{} {}").format(_value(accuracy, figures[name], what), words)
            for name, words in _DISTANCES
            if f"shape.{name}.{what}" in keys
        ]
        said.append(Markup(", ").join(parts))
    by = figures["whole"].by
    text = Markup("In shape (of the cameras): {} predicted. ").format(said[0] or "nothing")
    told = Markup("Measured {} by {}.").format(said[1], by) if said[1] else Markup("Nothing independent measured it.")
    return text + told


def _point(accuracy: Accuracy) -> Markup:
    text = Markup("Of a point, against its neighbours: {} predicted (median).")
    known = text.format(_value(accuracy, accuracy.figure("point"), PREDICTED))
    return known + _measured(accuracy, accuracy.of("point"))


def _measured(accuracy: Accuracy, figures: Sequence[Figure]) -> Markup:
    """What the best evidence of a layer says."""
    best = _best(figures)
    if best is not None:
        text = Markup(" Measured {} ({}) by {}, predicted {}.")
        values = (_value(accuracy, best, what) for what in (MEASURED, PREDICTED))
        measured, predicted = values
        return text.format(measured, best.of, best.by, predicted)
    held = accuracy.figure("world.held_out")
    if held in figures:
        text = Markup(" Nothing independent measured it; {} are met within {}, which an error of all does not show in.")
        return text.format(held.by, _value(accuracy, held, MEASURED))
    return Markup(" Nothing independent measured it.")


def _best(figures: Sequence[Figure]) -> Figure | None:
    return next((f for f in figures if f.independent and formatting.is_number(f.measured)), None)


def _value(accuracy: Accuracy, figure: Figure, what: str) -> Markup:
    value = getattr(figure, what)
    if not formatting.is_number(value):
        return Markup(formatting.NONE)
    return marked(f"{figure.key}.{what}", formatting.length(value, accuracy.unit))
