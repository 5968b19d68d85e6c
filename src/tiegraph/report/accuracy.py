"""The accuracy of a run in words, for the page and the terminal: every figure is taken from ``scene.results`` by key.

On the page each figure is marked with its key (``<data data-accuracy="world.predicted">``), so that a test can compare
all of them with the one source.
"""

import json
from collections.abc import Iterator
from pathlib import Path

from markupsafe import Markup, escape

from tiegraph.report import formatting
from tiegraph.report.formatting import is_number, marked
from tiegraph.report.texts import capital, said, t
from tiegraph.scene.results import LAYERS, MEASURED, PREDICTED, Accuracy, Figure
from tiegraph.text import known_to

_MEANS = {
    "world": "how far a point may be from its true coordinates",
    "shape": "how far the cameras may be off each other, wherever the whole stands",
    "point": "how far a point may be off its neighbours",
}
_WITHOUT = {
    "world.check_points": "No check points: the coordinates rest on the positions alone.",
    "world.held_out": "No positions held back from the fit: whether the model bends between them is not tested.",
    "point.reference_cloud": "No reference cloud: noise and ghosts of the cloud were not measured.",
}
_PLACEMENT = {  # name -> (words, unit, factor, where nothing is known)
    "position_m": ("position", "m", 1.0, 0.0), "height_m": ("height", "m", 1.0, 0.0),
    "yaw_deg": ("heading", "°", 1.0, 90.0), "tilt_deg": ("tilt", "°", 1.0, 90.0),
    "scale": ("scale", " %", 100.0, 100.0),
}  # fmt: skip


def sentences(accuracy: Accuracy) -> list[str]:
    """The answer to the tolerance, then a sentence for each layer: its predicted and measured values."""
    out, found = [], answer(accuracy)
    if found is not None:
        remedy = t(" Remedy: {}.", found["remedy"]) if found["remedy"] else ""
        text = "Tolerance of {} in the world: {}. Reason: {}.{}"
        out.append(t(text, found["asked"], found["said"], found["why"], remedy))
    for layer, name in LAYERS.items():
        figures = accuracy.of(layer)
        if layer == "world" and not figures:
            out.append(t("In the world: not known, because there is no control."))
            continue
        own = [f for f in figures if not f.by or f == accuracy.head(layer)]
        told = [t("{} for {}", _value(accuracy, f, PREDICTED), said(f.of)) for f in own] or [formatting.NONE]
        text = t("{}: predicted {}.{}", capital(t(name)), Markup(t("; ")).join(told), _measured(accuracy, figures))
        out.append(text + " " + holding(accuracy) if layer == "world" else text)
    return out


def _measured(accuracy: Accuracy, figures: list[Figure]) -> str:
    best, held = _best(figures), accuracy.figure("world.held_out")
    if best is not None:
        measured, predicted = (_value(accuracy, best, what) for what in (MEASURED, PREDICTED))
        return t(" Measured {} ({}) by {}, predicted {}.", measured, said(best.of), said(best.by), predicted)
    if held in figures:
        text = " Nothing independent measured it; {} are met within {}, which does not show a common error."
        return t(text, said(held.by), _value(accuracy, held, MEASURED))
    return t(" Nothing independent measured it.")


def terminal_lines(metrics_file: Path) -> list[str]:
    """The sentences as plain lines, of a metrics.json; [] without one that can be read."""
    try:
        accuracy = Accuracy.from_dict(json.loads(metrics_file.read_text(encoding="utf-8"))["accuracy"])
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [str(escape(line).striptags()) for line in sentences(accuracy)]


def layers(accuracy: Accuracy) -> list[dict[str, str]]:
    """The three layers in short, for readers who do not know them: ``name`` (of a layer in its first row), what it
    ``means``, ``predicted`` and ``measured`` of the same thing, ``by`` what. Measurements of another thing than
    the layer's own figure have a row of their own."""
    out = []
    for key, means in _MEANS.items():
        best, head = _best(accuracy.of(key)), accuracy.head(key)
        for k, row in enumerate([head] if best is None or best.key == head.key else [head, best]):
            values = {what: _value(accuracy, row, what) for what in (PREDICTED, MEASURED)}
            by = said(row.by) if row is best or row.by else t("nothing independent")
            named = {"name": "" if k else t(LAYERS[key]), "means": said(row.of) if k else t(means)}
            out.append({**named, **values, "by": by})
    return out


def holding(accuracy: Accuracy) -> str:
    """The control of the run in the world."""
    return t("Held in the world by {}.", said(accuracy.held_by))


def tiles(accuracy: Accuracy) -> Iterator[tuple[Markup, str]]:
    """(figure, label) of each layer."""
    for layer, name in LAYERS.items():
        best = _best(accuracy.of(layer))
        told = t("; measured {} ({})", _value(accuracy, best, MEASURED), said(best.of)) if best else ""
        yield _value(accuracy, accuracy.head(layer), PREDICTED), t("{}, predicted{}", t(name), told)


def table(accuracy: Accuracy) -> formatting.Table:
    """Every figure: predicted, measured, their ratio, by what, and what it does not prove."""
    rows = []
    for f in accuracy.figures:
        values = (_value(accuracy, f, PREDICTED), _value(accuracy, f, MEASURED))
        ratio = marked(f"{f.key}.ratio", formatting.number(f.ratio, 2)) if is_number(f.ratio) else formatting.NONE
        by = said(f.by) if f.by else formatting.NONE
        rows.append((t(LAYERS[f.layer]), said(f.of), *values, ratio, by, said(f.proves_not)))
    names = ("layer", "of", "predicted", "measured", "measured / predicted", "measured by", "does not prove")
    return formatting.Table(tuple(map(t, names)), tuple(rows), (False, False, True, True, True, False, False))


def without(accuracy: Accuracy) -> list[str]:
    """Missing references, and what therefore is not known."""
    return [t(text) for key, text in _WITHOUT.items() if not is_number(accuracy.figure(key).measured)]


def placement(accuracy: Accuracy) -> str:
    """Accuracy of the placement of the whole model; "" if it is not placed."""
    parts = [part for name in _PLACEMENT if (part := placement_part(accuracy, name))]
    text = "The model as a whole is placed, at its middle, with standard deviations of: {}."
    return t(text, Markup(t("; ")).join(parts)) if parts else ""


def placement_part(accuracy: Accuracy, name: str) -> str:
    """One of them in words: "tilt 1.4°"; "" if it is not known."""
    value, (words, unit, factor, most) = accuracy.placement.get(name), _PLACEMENT[name]
    if value is None or not is_number(value):
        return ""
    text = formatting.length(value) if unit == "m" else formatting.number(factor * value, 2) + unit
    if unit != "m" and known_to(factor * value, most, "") == "not known":
        return t("{} not known", t(words))
    return t("{} {}", t(words), marked(f"placement.{name}", text))


def answer(accuracy: Accuracy) -> dict[str, str] | None:
    """The answer to the tolerance in parts: asked, said, why, remedy; None if none was given."""
    given = accuracy.answer
    if given is None:
        return None
    asked = marked("tolerance", formatting.length(given.tolerance_m))
    return {"level": given.said, "asked": asked, "said": said(given.said), "why": said(given.why),
            "remedy": said(given.remedy) if given.remedy else ""}  # fmt: skip


def _best(figures: list[Figure]) -> Figure | None:
    return next((f for f in figures if f.independent and is_number(f.measured)), None)


def _value(accuracy: Accuracy, figure: Figure, what: str) -> Markup:
    value = getattr(figure, what)
    if not is_number(value):
        return Markup(formatting.NONE)
    return marked(f"{figure.key}.{what}", formatting.length(value, accuracy.unit))
