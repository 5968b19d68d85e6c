"""Metres per model unit from known lengths: baselines of the rig, if they are known and long enough, and scale bars."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import matrix, sensor_id
from tiegraph.scene.control import ScaleBars
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import MarkTuning, ScaleTuning
from tiegraph.sfm.world.marks import targets

RIG, BARS = "rig as given", "scale bars"


@dataclass(frozen=True)
class LengthScale:
    """The scale from known lengths, its relative sigma, and why it is not reliable, "" if it is."""

    metres_per_unit: float
    sigma: float
    why_not: str = ""
    source: str = RIG

    @property
    def name(self) -> str:
        """The source of the scale in world.json."""
        return "rig baseline" if self.source == RIG else self.source


def rig_scale(
    model: pycolmap.Reconstruction,
    cam_from_world: np.ndarray,
    scene: Scene,
    tuning: ScaleTuning,
    inside: float = float("nan"),
) -> LengthScale | None:
    """Median ratio of given to mapped baselines over all frames; None without a rig of given lengths.

    The sigma includes the baseline's own (2 mm, or that of the rig file), a rotation error of 0.01 deg at the model's
    median depth, and ``inside``: the accuracy with which the images transfer the baselines to the length of the whole
    (relative sigma of the adjustment, NaN = unknown). Reliability is judged from the file alone, and nominal rigs are
    not reliable.
    """
    ratios, lengths, sigmas, given = [], [], [], True
    by_frame: dict[int, list[int]] = {}
    for k in np.flatnonzero(np.isfinite(cam_from_world).all(axis=(1, 2))):
        by_frame.setdefault(int(scene.frame[k]), []).append(int(k))
    for frame, members in by_frame.items():
        given &= not scene.rigs[scene.rig[frame]].nominal
        for pair in combinations(members, 2):
            length, mapped = _baseline(model, cam_from_world, scene, pair)
            if length > 0 and mapped > 0:
                ratios.append(length / mapped)
                lengths.append(length)
                own = [s for k in pair if (s := scene.sensor_of(k).sigma_m) is not None]  # of their places, in the file
                sigmas.append(float(np.linalg.norm(own)) if own else tuning.baseline_sigma_m)
    if not ratios:
        return None
    longest, length = np.array(lengths) > tuning.long_share * max(lengths), max(lengths)
    scale = float(np.median(np.array(ratios)[longest]))
    depth = scale * _median_depth(model, 20_000)  # approximate number of points whose distances are used
    sigma = float(np.hypot(np.median(np.array(sigmas)[longest]), tuning.angle_sigma_rad * depth)) / length
    why = ""
    if not given:
        why = "its extrinsics are nominal"
    elif sigma > tuning.max_sigma:
        why = f"a baseline of {length:.3f} m at a distance of {depth:.0f} m gives the scale only to {sigma:.1%}"
    return LengthScale(scale, float(np.hypot(sigma, np.nan_to_num(inside))), why)


def _baseline(
    model: pycolmap.Reconstruction, poses: np.ndarray, scene: Scene, pair: tuple[int, int]
) -> tuple[float, float]:
    """Distance of two images of a frame as given (m; 0 = unknown) and in the model. In the model it is that of its rig,
    because cameras that fire at different times are elsewhere; without a rig, that of the images (N, 4, 4)."""
    given, mapped = [], []
    key = int(scene.rig[scene.frame[pair[0]]]) + 1
    rig = model.rigs[key] if key in model.rigs else None
    for image in pair:
        pose = scene.sensor_of(image).sensor_from_rig
        if pose is None:
            return 0.0, 0.0
        given.append(transforms.centre(pose))
        identity = sensor_id(int(scene.sensor_key[image]) + 1)
        if rig is not None and rig.is_ref_sensor(identity):
            mapped.append(np.zeros(3))
        elif rig is not None and (own := rig.non_ref_sensors.get(identity)) is not None:
            mapped.append(transforms.centre(matrix(own)))
    there = mapped if len(mapped) == 2 else [transforms.centre(poses[k]) for k in pair]
    return float(np.linalg.norm(given[1] - given[0])), float(np.linalg.norm(there[1] - there[0]))


def _median_depth(model: pycolmap.Reconstruction, most: int) -> float:
    """Median distance of points from the first camera that sees them, model units."""
    ids = sorted(model.point3D_ids())
    points = [model.point3D(k) for k in ids[:: max(1, len(ids) // most)]]
    first = [model.image(p.track.elements[0].image_id).projection_center() for p in points]
    return float(np.median([np.linalg.norm(p.xyz - c) for p, c in zip(points, first)])) if points else 0.0


@dataclass(frozen=True)
class BarsFound:
    """Bars in a model: their length and its sigma there (B,), model units, NaN = an end has no place; why a bar is
    not used (B,), "" = it is; the scale from them, None = none can be used; contradictions between them."""

    bars: ScaleBars
    length: np.ndarray
    sigma: np.ndarray
    why_not: tuple[str, ...]
    scale: LengthScale | None
    contradictions: tuple[str, ...]

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
    why, said = [], []
    for k, (a, b) in enumerate(bars.ends):
        lost = next((e for e in (a, b) if ends[e].why_not), None)
        why.append("" if lost is None else f"end {bars.names[lost]!r}: {ends[lost].why_not}")
        if lost is None:
            way = ends[a].place - ends[b].place
            length[k] = np.linalg.norm(way)
            unit = way / max(length[k], 1e-12)
            sigma[k] = np.sqrt(max(unit @ (ends[a].covariance + ends[b].covariance) @ unit, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        log = np.log(bars.length_m / length)
        spread = np.hypot(bars.sigma_m / bars.length_m, sigma / length)
    use = np.flatnonzero(~bars.check & np.isfinite(log))
    while len(use) > 2 and (found := _worst(log, spread, use)) is not None:
        worst, others = found
        why[worst] = (
            f"it would change the size of the model by {np.exp(log[worst] - others) - 1:+.2%} relative to the "
            f"{len(use) - 1} others"
        )
        said.append(
            f"scale bar {_name(bars, worst)} is not used: {why[worst]}, which agree with each other; was it measured "
            "wrongly, or moved?"
        )
        use = use[use != worst]
    scale = None
    if len(use):
        scale, text = _scale_of(bars, log, spread, use)
        said += text
    return BarsFound(bars=bars, length=length, sigma=sigma, why_not=tuple(why), scale=scale, contradictions=tuple(said))


def _scale_of(bars: ScaleBars, log: np.ndarray, spread: np.ndarray, use: np.ndarray) -> tuple[LengthScale, list[str]]:
    """The scale from the bars ``use``, and their contradiction."""
    value, sigma = _mean(log[use], spread[use])
    apart = (log[use] - value) / spread[use]
    sigma *= max(1.0, float(np.sqrt(np.sum(apart**2) / max(len(use) - 1, 1))))
    ends = use[[np.argmin(log[use]), np.argmax(log[use])]]
    wide = float(np.ptp(log[use]))
    off, said = wide / float(np.hypot(*spread[ends])), []
    if off > LIMIT:
        sigma = max(sigma, wide / 2)
        a, b = (_name(bars, k) for k in ends)
        said.append(
            f"scale bars {a} and {b} contradict each other by {np.expm1(wide):.2%} of scale ({off:.1f} "
            "sigmas), and it is unknown which is wrong: both are used, and the sigma of the scale covers both"
        )
    return LengthScale(float(np.exp(value)), sigma, source=BARS), said


def _worst(log: np.ndarray, spread: np.ndarray, use: np.ndarray) -> tuple[int, float] | None:
    """The bar that contradicts the others while they agree with each other, and the logarithm of their scale."""
    for k in use[np.argsort(-np.abs(log[use] - np.median(log[use])) / spread[use])]:
        rest = use[use != k]
        value, sigma = _mean(log[rest], spread[rest])
        agree = np.all(np.abs(log[rest] - value) <= LIMIT * spread[rest])
        if agree and abs(log[k] - value) > LIMIT * np.hypot(spread[k], sigma):
            return int(k), value
    return None


def _mean(log: np.ndarray, spread: np.ndarray) -> tuple[float, float]:
    """Weighted mean and its sigma."""
    weight = 1 / spread**2
    return float(np.sum(weight * log) / weight.sum()), float(1 / np.sqrt(weight.sum()))


def _name(bars: ScaleBars, bar: int) -> str:
    return f"{bars.names[bars.ends[bar, 0]]!r} to {bars.names[bars.ends[bar, 1]]!r}"
