"""How well two passes of one survey agree, by M3C2 between the clouds of each: what tells without any reference."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.evaluate.clouds.m3c2 import Differences
from tiegraph.evaluate.clouds.nearest import Cameras
from tiegraph.evaluate.tuning import PassesTuning
from tiegraph.scene.results import Metric

TABLE = "one pass against the other, M3C2"
_WHOLE = "all"
_NAN = float("nan")


@dataclass(frozen=True)
class PassAgreement:
    """What M3C2 found between the clouds of two passes: the second minus the first.

    ``maps`` depth maps of either took part, of ``there``; ``found``: by section and of all, the summary of the
    differences (``Differences.summary``); ``why_not``: why nothing could be compared.
    """

    passes: tuple[str, str]
    maps: tuple[int, int]
    there: tuple[int, int]
    found: Mapping[str, Mapping[str, float]]
    why_not: str = ""

    @property
    def rms_m(self) -> float:
        """Root mean square of the differences without strays, of their median and spread; NaN = nothing compared."""
        whole = self.found.get(_WHOLE, {})
        return float(np.hypot(whole.get("median m", _NAN), whole.get("spread m", _NAN)))

    @property
    def detection_m(self) -> float:
        """Median level of detection; NaN = nothing compared."""
        return float(self.found.get(_WHOLE, {}).get("level of detection m", _NAN))

    @property
    def by(self) -> str:
        """What was compared, in words."""
        return f"pass {self.passes[1]} against pass {self.passes[0]}"

    def metrics(self) -> list[Metric]:
        """The figures of merit."""
        whole = self.found.get(_WHOLE, {})
        named = (("median", "median m", "m"), ("spread", "spread m", "m"), ("significant", "significant %", "%"))
        known = (row for row in named if row[1] in whole)
        return [Metric(name=f"passes_{n}", value=whole[of], unit=unit, better="low") for n, of, unit in known]

    def tables(self) -> dict[str, dict]:
        """The table for metrics.json: by section where there are several."""
        columns = list(self.found.get(_WHOLE, {}))
        shown = {n: v for n, v in self.found.items() if n == _WHOLE or len(self.found) > 2}
        rows = [[name, *(values.get(c) for c in columns)] for name, values in shown.items()]
        short = {"95 % of absolute m": "95 % within m", "level of detection m": "detection m"}
        return {TABLE: {"columns": ["section", *(short.get(c, c) for c in columns)], "rows": rows}} if columns else {}

    def note(self) -> str:
        """What was compared and what that does not tell."""
        if self.why_not:
            return f"Passes {' and '.join(self.passes)} were not compared with each other: {self.why_not}"
        few = self.maps != self.there
        sampled = ", near places along the way; `tiegraph compare --passes` takes all" if few else ""
        used = f"{self.maps[0]} of {self.there[0]} and {self.maps[1]} of {self.there[1]} depth maps{sampled}"
        return (
            f"{self.by[:1].upper()}{self.by[1:]} (M3C2 along the normal; {used}): it tells how well the passes agree "
            "in pose and depth. It does not tell what both share: place, scale, cameras, what matching got wrong in "
            "both; and a depth map of one pass may have been confirmed by images of the other."
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "PassAgreement":
        """Inverse of ``to_dict``."""
        pairs = {name: tuple(data[name]) for name in ("passes", "maps", "there")}
        return PassAgreement(**pairs, found=data["found"], why_not=data["why_not"])


def by_section(found: Differences, cameras: Cameras) -> dict[str, dict[str, float]]:
    """Summaries of differences, of all and by the section of the nearest camera."""
    nearest = cKDTree(cameras.centres).query(found.xyz)[1] if len(found) else np.zeros(0, int)
    section = np.array(cameras.section)[nearest]
    parts = {_WHOLE: found, **{name: found.where(section == name) for name in sorted(cameras.sections())}}
    return {n: {k: float(f"{v:.6g}") for k, v in part.summary().items()} for n, part in parts.items()}


def near_places(first: np.ndarray, second: np.ndarray, tuning: PassesTuning) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the cameras that take part, of the first pass (N, 3) in the order of its way and of the second (M, 3):
    all of few, else those nearest to places along the first."""
    if max(len(first), len(second)) <= tuning.maps:
        return np.arange(len(first)), np.arange(len(second))
    at = first[np.linspace(0, len(first) - 1, tuning.places + 2)[1:-1].round().astype(int)]
    each = max(1, tuning.maps // tuning.places)
    found = [cKDTree(c).query(at, k=np.arange(1, min(each, len(c)) + 1))[1] for c in (first, second)]
    return np.unique(found[0]), np.unique(found[1])
