"""The accuracy of a run in three layers: the one source of all accuracies in terminal, report, cloud and tables.

*In the world*: absolute, with the controlling observations. *In shape*: of the whole and of its parts relative to each
other, wherever it lies. *Of a point*: of a point of the cloud against its neighbours. Each is predicted (one standard
deviation) and, if a reference exists, measured (root mean square unless stated otherwise); the length of the
difference, not one axis. Only ``evaluate`` computes it; ``metrics.json`` contains it, under ``accuracy``.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from tiegraph.text import finite

NAN = float("nan")
LAYERS = {"world": "in the world", "shape": "in shape", "point": "of a point"}
"""Key of a layer -> its name, in the order of presentation."""
PREDICTED, MEASURED, RATIO = "predicted", "measured", "ratio"


@dataclass(frozen=True)
class Figure:
    """One accuracy, in the unit of its ``Accuracy``; NaN = not known.

    ``predicted``: a standard deviation of what ``measured`` is, so that their ratio is about 1. ``independent``: the
    reference was not used in the run.
    """

    key: str  # begins with its layer
    of: str
    predicted: float = NAN
    measured: float = NAN
    by: str = ""  # the reference it is measured by
    independent: bool = False
    proves_not: str = ""

    @property
    def layer(self) -> str:
        """Key of its layer."""
        return self.key.partition(".")[0]

    @property
    def ratio(self) -> float:
        """Measured / predicted; NaN without both."""
        return self.measured / self.predicted if self.predicted > 0 else NAN


@dataclass(frozen=True)
class Answer:
    """Whether a tolerance is held: ``said`` is "yes", "no" or "cannot be told"; why, and what would make it yes."""

    tolerance_m: float
    said: str
    why: str
    remedy: str = ""


@dataclass(frozen=True)
class Accuracy:
    """All of it. ``unit`` is m, or "units" if the scale is unknown; ``held_by``: its control in the world;
    ``placement``: sigmas of the model as a whole (position_m, height_m, yaw_deg, tilt_deg, scale), {} = none."""

    unit: str
    held_by: str
    figures: tuple[Figure, ...]
    placement: Mapping[str, float] = field(default_factory=dict)
    answer: Answer | None = None

    def of(self, layer: str) -> list[Figure]:
        """The figures of a layer."""
        return [f for f in self.figures if f.layer == layer]

    def head(self, layer: str) -> Figure:
        """The representative figure of a layer: of a point in the world, of the shape as a whole, of a point."""
        return self.figure("shape.whole" if layer == "shape" else layer)

    def figure(self, key: str) -> Figure:
        """A figure by its key; one without values if there is none."""
        return next((f for f in self.figures if f.key == key), Figure(key=key, of=""))

    def values(self) -> dict[str, float]:
        """All values for presentation, by full key: "world.check_points.measured", "placement.tilt_deg"."""
        out = {f"{f.key}.{what}": getattr(f, what) for f in self.figures for what in (PREDICTED, MEASURED, RATIO)}
        out |= {f"placement.{name}": value for name, value in self.placement.items()}
        if self.answer is not None:
            out["tolerance"] = self.answer.tolerance_m
        return {key: value for key, value in out.items() if math.isfinite(value)}

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; NaN as null. The ratio is beside the values."""
        figures = [finite({**asdict(f), RATIO: f.ratio}) for f in self.figures]
        out = {"unit": self.unit, "held_by": self.held_by, "figures": figures, "placement": dict(self.placement)}
        return {**out, "tolerance": None if self.answer is None else asdict(self.answer)}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Accuracy":
        """Inverse of ``to_dict``."""
        rows: list[dict[str, Any]]
        rows = [{k: NAN if v is None else v for k, v in row.items() if k != RATIO} for row in data["figures"]]
        answer = data.get("tolerance")
        return Accuracy(
            unit=data["unit"],
            held_by=data["held_by"],
            figures=tuple(Figure(**row) for row in rows),
            placement=data.get("placement") or {},
            answer=None if answer is None else Answer(**answer),
        )
