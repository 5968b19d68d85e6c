"""The accuracy of a run in words, for the page and the terminal: every figure is taken from ``scene.accuracy`` by key.

On the page each figure is marked with its key (``<data data-accuracy="world.predicted">``), so that a test can hold all
of them against the one source.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup, escape

from tiegraph.report import formatting
from tiegraph.report.formatting import marked
from tiegraph.report.texts import said, t
from tiegraph.scene.accuracy import LAYERS, MEASURED, PREDICTED, Accuracy, Figure
from tiegraph.text import known_to

_MEANS = {
    "world": "how far a point may be from its true coordinates",
    "shape": "how far the cameras may be off each other, wherever the whole stands",
    "point": "how far a point may be off its neighbours",
}
_WITHOUT = {
    "world.check_points": "No check points: whether coordinates are right is the positions' word alone.",
    "world.held_out": "No positions held back from the fit: whether the model bends between them is not tested.",
    "shape.rig": "No rig of several cameras was tested: whether a camera moved is not known.",
    "point.reference_cloud": "No reference cloud: noise and ghosts of the cloud were not measured.",
}
_DISTANCES = (("10m", "over 10 m"), ("100m", "over 100 m"), ("whole", "over the whole"))
_PLACEMENT = {  # name -> (words, unit, factor, where nothing is known)
    "position_m": ("position", "m", 1.0, 0.0), "height_m": ("height", "m", 1.0, 0.0),
    "yaw_deg": ("heading", "°", 1.0, 90.0), "tilt_deg": ("tilt", "°", 1.0, 90.0),
    "scale": ("scale", " %", 100.0, 100.0),
}  # fmt: skip


def sentences(accuracy: Accuracy) -> list[str]:
    """The answer to the tolerance, then the three layers, one sentence each or two."""
    return [*_answer(accuracy), _world(accuracy), _shape(accuracy), _point(accuracy)]


def terminal_lines(metrics_file: Path) -> list[str]:
    """The same as plain lines, of a metrics.json; [] without one that can be read."""
    try:
        accuracy = Accuracy.from_dict(json.loads(metrics_file.read_text(encoding="utf-8"))["accuracy"])
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [str(escape(line).striptags()) for line in sentences(accuracy)]


@dataclass(frozen=True)
class Layer:
    """A row for one who has not read of layers: what it is of, predicted and measured of the same thing, by what;
    ``name`` of a layer in its first row."""

    name: str
    means: str
    predicted: str
    measured: str
    by: str


def layers(accuracy: Accuracy) -> list[Layer]:
    """The three layers in short. What was measured of another thing than stands for the layer has a row of its own."""
    out = []
    for key, means in _MEANS.items():
        best, head = _best(accuracy.of(key)), accuracy.head(key)
        rows = [head] if best is None or best.key == head.key else [head, best]
        for k, row in enumerate(rows):
            out.append(
                Layer(
                    name="" if k else t(LAYERS[key]),
                    means=said(row.of) if k else t(means),
                    predicted=_value(accuracy, row, PREDICTED),
                    measured=_value(accuracy, row, MEASURED),
                    by=said(row.by) if row is best or row.by else t("nothing independent"),
                )
            )
    return out


def holding(accuracy: Accuracy) -> str:
    """What holds the run in the world."""
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
        known = f"{f.key}.ratio" in accuracy.values()
        ratio = marked(f"{f.key}.ratio", formatting.number(f.ratio, 2)) if known else formatting.NONE
        by = said(f.by) if f.by else formatting.NONE
        rows.append((t(LAYERS[f.layer]), said(f.of), *values, ratio, by, said(f.proves_not)))
    columns = tuple(map(t, ("layer", "of", "predicted", "measured", "measured / predicted", "measured by")))
    numeric = (False, False, True, True, True, False, False)
    return formatting.Table((*columns, t("does not prove")), tuple(rows), numeric)


def without(accuracy: Accuracy) -> list[str]:
    """What could have measured the run and did not, and what therefore is not known."""
    keys = {f.key for f in accuracy.figures if formatting.is_number(f.measured)}
    return [t(text) for key, text in _WITHOUT.items() if key not in keys]


def placement(accuracy: Accuracy) -> str:
    """How the model as a whole is known to stand; "" where it is not placed."""
    parts = [part for name in _PLACEMENT if (part := placement_part(accuracy, name))]
    if not parts:
        return ""
    return t(
        "The model as a whole is placed, at its middle, with standard deviations of: {}.", Markup(t("; ")).join(parts)
    )


def placement_part(accuracy: Accuracy, name: str) -> str:
    """One of them in words: "tilt 1.4°"; "" if it is not known."""
    value, (words, unit, factor, most) = accuracy.placement.get(name), _PLACEMENT[name]
    if value is None or not formatting.is_number(value):
        return ""
    text = formatting.length(value) if unit == "m" else formatting.number(factor * value, 2) + unit
    if unit != "m" and known_to(factor * value, most, "") == "not known":
        return t("{} not known", t(words))
    return t("{} {}", t(words), marked(f"placement.{name}", text))


def answer(accuracy: Accuracy) -> dict[str, str] | None:
    """The answer to the tolerance in parts: asked, said, why, remedy; None where none was given."""
    given = accuracy.answer
    if given is None:
        return None
    asked = marked("tolerance", formatting.length(given.tolerance_m))
    return {"level": given.said, "asked": asked, "said": said(given.said), "why": said(given.why),
            "remedy": said(given.remedy) if given.remedy else ""}  # fmt: skip


def _answer(accuracy: Accuracy) -> Iterator[str]:
    found = answer(accuracy)
    if found is None:
        return
    remedy = t(" What would make it yes: {}.", found["remedy"]) if found["remedy"] else ""
    yield t("Tolerance of {} in the world: {}. Reason: {}.{}", found["asked"], found["said"], found["why"], remedy)


def _world(accuracy: Accuracy) -> str:
    first, most = accuracy.figure("world"), accuracy.figure("world.nine_in_ten")
    if not accuracy.of("world"):
        return t("In the world: not known, for nothing holds it there.")
    known = [_value(accuracy, f, PREDICTED) for f in (first, most)]
    text = "In the world: {} predicted of a point of the cloud (median), {} of nine in ten; held by {}.{}"
    return t(text, *known, said(accuracy.held_by), _measured(accuracy, accuracy.of("world")))


def _shape(accuracy: Accuracy) -> str:
    figures = {name: accuracy.figure(f"shape.{name}") for name, _ in _DISTANCES}
    parts: dict[str, Markup] = {}
    for what in (PREDICTED, MEASURED):
        keys = accuracy.values()
        found = [
            t("{} {}", _value(accuracy, figures[name], what), t(words))
            for name, words in _DISTANCES
            if f"shape.{name}.{what}" in keys
        ]
        parts[what] = Markup(t(", ")).join(found)
    by = said(figures["whole"].by)
    told = t(" Measured {} by {}.", parts[MEASURED], by) if parts[MEASURED] else t(" Nothing independent measured it.")
    return t("In shape (of the cameras): {} predicted.{}", parts[PREDICTED] or t("nothing"), told)


def _point(accuracy: Accuracy) -> str:
    text = "Of a point, against its neighbours: {} predicted (median).{}"
    return t(text, _value(accuracy, accuracy.figure("point"), PREDICTED), _measured(accuracy, accuracy.of("point")))


def _measured(accuracy: Accuracy, figures: Sequence[Figure]) -> str:
    """What the best evidence of a layer says."""
    best = _best(figures)
    if best is not None:
        measured, predicted = (_value(accuracy, best, what) for what in (MEASURED, PREDICTED))
        return t(" Measured {} ({}) by {}, predicted {}.", measured, said(best.of), said(best.by), predicted)
    held = accuracy.figure("world.held_out")
    if held in figures:
        text = " Nothing independent measured it; {} are met within {}, which an error of all does not show in."
        return t(text, said(held.by), _value(accuracy, held, MEASURED))
    return t(" Nothing independent measured it.")


def _best(figures: Sequence[Figure]) -> Figure | None:
    return next((f for f in figures if f.independent and formatting.is_number(f.measured)), None)


def _value(accuracy: Accuracy, figure: Figure, what: str) -> Markup:
    value = getattr(figure, what)
    if not formatting.is_number(value):
        return Markup(formatting.NONE)
    return marked(f"{figure.key}.{what}", formatting.length(value, accuracy.unit))
