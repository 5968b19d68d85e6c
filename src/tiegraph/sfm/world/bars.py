"""Scale bars in the model: the scale from each, which are used, and their residuals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pycolmap

from tiegraph.scene.control import ScaleBars
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import MarkTuning
from tiegraph.sfm.world.marks import targets
from tiegraph.sfm.world.scale import BARS, RigScale


@dataclass(frozen=True)
class BarsFound:
    """Bars in a model: their length and its sigma there (B,), model units, NaN = an end has no place; why a bar is
    not used (B,), "" = it is; the scale from them, None = none can be used; contradictions between them."""

    bars: ScaleBars
    length: np.ndarray
    sigma: np.ndarray
    why_not: tuple[str, ...]
    scale: RigScale | None
    contradictions: tuple[str, ...] = ()

    @property
    def used(self) -> np.ndarray:
        """(B,) the bars that determine the scale."""
        return np.array([not why for why in self.why_not], bool) & ~self.bars.check

    def rows(self, metres_per_unit: float) -> tuple[dict[str, Any], ...]:
        """One row for each bar, for world.json: lengths as measured and in the model, their
        difference and its sigma."""
        out = []
        for k, (a, b) in enumerate(self.bars.ends):
            here, known = metres_per_unit * self.length[k], float(self.bars.length_m[k])
            there = bool(np.isfinite(here))
            sigma = float(np.hypot(self.bars.sigma_m[k], metres_per_unit * self.sigma[k]))
            out.append({
                "from": self.bars.names[a], "to": self.bars.names[b],
                "role": "check" if self.bars.check[k] else "bar",
                "length_m": known, "model_m": round(float(here), 6) if there else None,
                "off_mm": round(1000 * float(here - known), 3) if there else None,
                "sigma_mm": round(1000 * sigma, 3) if there else None,
                "why_not": self.why_not[k],
            })  # fmt: skip
        return tuple(out)

    def told(self, rows: Sequence[dict[str, Any]], scale_sigma: float) -> tuple[str, ...]:
        """The contradictions, and check bars whose error exceeds chance at this sigma of the scale."""
        out = list(self.contradictions)
        for k, row in enumerate(rows):
            if row["off_mm"] is None or not self.bars.check[k]:
                continue
            sigma_mm = float(np.hypot(row["sigma_mm"], 1000 * row["length_m"] * scale_sigma))
            if abs(row["off_mm"]) > LIMIT * sigma_mm:
                out.append(
                    f"check bar {_name(self.bars, k)} is {row['off_mm']:+.2f} mm long in the model against its "
                    f"{row['length_m']:g} m, where {sigma_mm:.2g} mm are expected: its length, or the scale, is wrong"
                )
        return tuple(out)


def bars_in(
    model: pycolmap.Reconstruction, scene: Scene, bars: ScaleBars | None, tuning: MarkTuning
) -> BarsFound | None:
    """The bars in a model, and the scale from them; None without any.

    Of three or more bars, one that contradicts the others is left out if these agree; then the next. If two bars
    contradict each other, both are used and the sigma of the scale covers them.
    """
    if bars is None:
        return None
    ends = targets(model, scene, bars.marks, len(bars.names), tuning)
    length, sigma = np.full(len(bars), np.nan), np.full(len(bars), np.nan)
    why = []
    for k, (a, b) in enumerate(bars.ends):
        lost = next((bars.names[e] for e in (a, b) if ends[e].why_not), "")
        why.append(f"end {lost!r}: {ends[bars.names.index(lost)].why_not}" if lost else "")
        if not lost:
            way = ends[a].place - ends[b].place
            length[k] = np.linalg.norm(way)
            unit = way / max(length[k], 1e-12)
            sigma[k] = np.sqrt(max(unit @ (ends[a].covariance + ends[b].covariance) @ unit, 0.0))
    found = BarsFound(bars=bars, length=length, sigma=sigma, why_not=tuple(why), scale=None)
    return _judged(found)


def _judged(found: BarsFound) -> BarsFound:
    bars, why, said = found.bars, list(found.why_not), []
    with np.errstate(invalid="ignore", divide="ignore"):
        log = np.log(bars.length_m / found.length)
        spread = np.hypot(bars.sigma_m / bars.length_m, found.sigma / found.length)
    use = np.flatnonzero(found.used & np.isfinite(log))
    while len(use) > 2:
        worst, others = _worst(log, spread, use)
        if worst is None:
            break
        text = (
            f"it would change the size of the model by {np.exp(log[worst] - others) - 1:+.2%} relative to the "
            f"{len(use) - 1} others"
        )
        why[worst] = text
        said.append(
            f"scale bar {_name(bars, worst)} is not used: {text}, which agree with each other; was it measured "
            "wrongly, or moved?"
        )
        use = use[use != worst]
    if not len(use):
        return found
    value, sigma = _mean(log[use], spread[use])
    apart = np.abs(log[use] - value) / spread[use]
    factor = float(np.sqrt(np.sum(apart**2) / max(len(use) - 1, 1))) if len(use) > 1 else 1.0
    pair = use[[np.argmin(log[use]), np.argmax(log[use])]]
    off = float(np.ptp(log[use]) / np.hypot(*spread[pair])) if len(use) > 1 else 0.0
    if off > LIMIT:
        a, b = (_name(bars, k) for k in pair)
        said.append(
            f"scale bars {a} and {b} contradict each other by {np.expm1(np.ptp(log[use])):.2%} of scale ({off:.1f} "
            "sigmas), and it is unknown which is wrong: both are used, and the sigma of the scale covers both"
        )
    sigma = max(sigma * max(factor, 1.0), float(np.ptp(log[use])) / 2 if off > LIMIT else 0.0)
    scale = RigScale(metres_per_unit=float(np.exp(value)), sigma=sigma, trusted=True, source=BARS)
    return replace(found, why_not=tuple(why), scale=scale, contradictions=tuple(said))


def _worst(log: np.ndarray, spread: np.ndarray, use: np.ndarray) -> tuple[int | None, float]:
    """The bar that contradicts the others while they agree with each other, and the logarithm of their scale."""
    for k in use[np.argsort(-np.abs(log[use] - np.median(log[use])) / spread[use])]:
        rest = use[use != k]
        value, sigma = _mean(log[rest], spread[rest])
        agree = np.all(np.abs(log[rest] - value) <= LIMIT * spread[rest])
        if agree and abs(log[k] - value) > LIMIT * np.hypot(spread[k], sigma):
            return int(k), value
    return None, 0.0


def _mean(log: np.ndarray, spread: np.ndarray) -> tuple[float, float]:
    """Weighted mean and its sigma."""
    weight = 1 / spread**2
    return float(np.sum(weight * log) / weight.sum()), float(1 / np.sqrt(weight.sum()))


def _name(bars: ScaleBars, bar: int) -> str:
    return f"{bars.names[bars.ends[bar, 0]]!r} to {bars.names[bars.ends[bar, 1]]!r}"
