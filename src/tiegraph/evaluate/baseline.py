"""Before and after, honestly: another method on a block of the same survey, and what it costs at equal registration.

A method that registers fewer images is quicker for that reason alone (paper 000: 222 of 500 images, 001: 937 of 4020),
and one that registers all of them at wrong places is worth nothing. So both methods are run by themselves on the same
images, a cost is that of an image registered, and a speed-up is never stated without the images that one of them lost.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tiegraph.geometry.transforms import robust_umeyama, umeyama
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Side:
    """What a method made of N images, in the order of the block.

    ``registered``: (N,) bool, in its largest model. ``centres``: (N, 3) there, model units, NaN = none. ``sigma``: (N,)
    of a position (root sum of squares), model units, NaN = not known. ``stages``: of each (CPU s, wall s). ``counts``:
    whatever else is laid side by side, by its name in the table.
    """

    name: str
    registered: np.ndarray
    centres: np.ndarray
    sigma: np.ndarray
    stages: Mapping[str, tuple[float, float]]
    counts: Mapping[str, float] = field(default_factory=dict)

    @property
    def cpu_s(self) -> float:
        """Of all stages."""
        return sum(cpu for cpu, _ in self.stages.values())

    @property
    def wall_s(self) -> float:
        """Of all stages."""
        return sum(wall for _, wall in self.stages.values())

    @property
    def count(self) -> int:
        """Registered images."""
        return int(self.registered.sum())


@dataclass(frozen=True)
class Reference:
    """Where the cameras truly stood, (N, 3) metres, NaN = not known; ``measured``: by a reference, not by one of the
    sides; ``right_m``: an image nearer than this, after a robust alignment, is at its place."""

    centres_m: np.ndarray
    measured: bool
    right_m: float


@dataclass(frozen=True)
class _Judged:
    """A side against the reference: error (N,) m after the least-squares similarity, NaN = not registered or not
    known; (N,) bool: at its place; metres a unit of its model."""

    side: Side
    error_m: np.ndarray
    right: np.ndarray
    scale: float

    def rmse_m(self, images: np.ndarray) -> float:
        """Over some images (N,) bool."""
        known = self.error_m[images & np.isfinite(self.error_m)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan

    def sigma_m(self, images: np.ndarray) -> float:
        """Median over some images (N,) bool."""
        known = self.side.sigma[images & np.isfinite(self.side.sigma)]
        return self.scale * float(np.median(known)) if len(known) else np.nan


def compare_sides(ours: Side, theirs: Side, reference: Reference, sections: Sequence[str]) -> dict[str, Any]:
    """Tables of both sides, whole and by ``sections`` (N, the name of each image's), and ``speed_up`` in words.

    Values are None where there is none.
    """
    both = [_judge(side, reference) for side in (ours, theirs)]
    lost = ours.registered & ~theirs.registered, theirs.registered & ~ours.registered
    names = {**ours.stages, **theirs.stages}
    rows = [[n, *ours.stages.get(n, (None, None)), *theirs.stages.get(n, (None, None))] for n in names]
    columns = ["stage", *(f"{s.name} {what}" for s in (ours, theirs) for what in ("CPU s", "wall s"))]
    return {
        "figures": {"columns": ["", ours.name, theirs.name, "ratio"], "rows": _figures(both, reference)},
        "stages": {"columns": columns, "rows": rows},
        "sections": _sections(both, np.array(sections)),
        "lost": {side.name: int(images.sum()) for side, images in zip((theirs, ours), lost)},
        "speed_up": _speed_up(both, lost, reference.measured),
    }


def _judge(side: Side, reference: Reference) -> _Judged:
    known = np.isfinite(side.centres).all(axis=1) & np.isfinite(reference.centres_m).all(axis=1) & side.registered
    error, right, scale = np.full(len(known), np.nan), np.zeros(len(known), bool), np.nan
    if known.sum() >= 3:  # for an alignment
        source, target = side.centres[known], reference.centres_m[known]
        plain, (robust, _) = umeyama(source, target), robust_umeyama(source, target, reference.right_m / 3)
        error[known], scale = np.linalg.norm(plain(source) - target, axis=1), plain.scale
        right[known] = np.linalg.norm(robust(source) - target, axis=1) < reference.right_m
    return _Judged(side=side, error_m=error, right=right, scale=scale)


def _figures(both: list[_Judged], reference: Reference) -> list[list[Any]]:
    """Rows: name, ours, theirs, theirs over ours where the row is a cost."""
    a, b = (j.side for j in both)
    every = np.ones(len(a.registered), bool)
    common = a.registered & b.registered
    told = reference.measured and np.isfinite(reference.centres_m).all()
    right = [int(j.right.sum()) if told else None for j in both]
    counted = list(dict.fromkeys([*a.counts, *b.counts]))
    return [
        ["images", len(every), len(every), None],
        ["registered, in the largest model", a.count, b.count, None],
        ["registered and at their place", *right, None],
        *([name, a.counts.get(name), b.counts.get(name), None] for name in counted),
        ["ATE, m", *(_number(j.rmse_m(every)) for j in both), None],
        ["ATE of the images that both registered, m", *(_number(j.rmse_m(common)) for j in both), None],
        ["sigma of a position, median, m", *(_number(j.sigma_m(every)) for j in both), None],
        _cost("CPU s", a.cpu_s, b.cpu_s),
        _cost("wall s", a.wall_s, b.wall_s),
        _cost("CPU s per registered image", _ratio(a.cpu_s, a.count), _ratio(b.cpu_s, b.count)),
        _cost("wall s per registered image", _ratio(a.wall_s, a.count), _ratio(b.wall_s, b.count)),
        _cost("CPU s per image at its place", _ratio(a.cpu_s, right[0]), _ratio(b.cpu_s, right[1])),
    ]


def _cost(name: str, ours: float | None, theirs: float | None) -> list[Any]:
    return [name, *(None if v is None else _number(v) for v in (ours, theirs)), _ratio(theirs, ours)]


def _sections(both: list[_Judged], section: np.ndarray) -> dict[str, Any]:
    """Cost is no row here: matching and adjusting serve all sections at once."""
    what = {
        "registered": lambda j, own: int((j.side.registered & own).sum()),
        "at their place": lambda j, own: int((j.right & own).sum()),
        "ATE m": lambda j, own: _number(j.rmse_m(own)),
        "sigma m": lambda j, own: _number(j.sigma_m(own)),
    }
    rows = []
    for name in sorted(set(section)):
        own = section == name
        rows.append([name, int(own.sum()), *(told(j, own) for told in what.values() for j in both)])
    return {"columns": ["section", "images", *(f"{w} {j.side.name}" for w in what for j in both)], "rows": rows}


def _speed_up(both: list[_Judged], lost: Sequence[np.ndarray], measured: bool) -> list[str]:
    a, b = (j.side for j in both)
    if not a.count or not b.count:
        none = " and ".join(s.name for s in (a, b) if not s.count)
        return [f"no speed-up can be stated: {none} registered no image"]
    factor = f"{_number((b.cpu_s / b.count) / (a.cpu_s / a.count)):g}"
    sides = zip((b, a), (a, b), (int(m.sum()) for m in lost))
    who = [f"{side.name} loses {n} images that {other.name} registers" for side, other, n in sides if n]
    said = [f"speed-up {factor} per registered image, not at equal registration: {'; '.join(who)}"]
    if not who:
        how = f"(CPU s per registered image; both register the same {a.count} images)"
        said = [f"speed-up at equal registration: {factor} {how}"]
    right = [int(j.right.sum()) for j in both]
    if measured and right != [a.count, b.count]:
        counts = ", ".join(f"{s.name} {n} of its {s.count}" for s, n in zip((a, b), right))
        more = f": speed-up {_number((b.cpu_s / right[1]) / (a.cpu_s / right[0])):g} per image at its place"
        said.append(f"registered images at their true place: {counts}{more if all(right) else ''}")
    return said


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else _number(a / b)


def _number(value: float) -> float | None:
    """Four digits; None for what is not known."""
    return float(f"{value:.4g}") if np.isfinite(value) else None


def stretch(scene: Scene, centres: np.ndarray, images: int) -> np.ndarray:
    """Numbers (K,), increasing, of the images of a block of about so many: whole frames, the nearest to the middle one.

    ``centres``: (F, 3) places of the frames, NaN = not known. A frame without a place stands where the next one with a
    place does in the order of its pass (loose photographs: of their names), so that what was not registered is in the
    block too. The middle is that of the longest pass. Raises ValueError if no frame has a place.
    """
    known = np.all(np.isfinite(centres), axis=1)
    if not known.any():
        raise ValueError("no frame has a place")
    placed = np.array(centres, float)
    for sequence in np.unique(scene.sequence):
        own = scene.in_order(scene.sequence == sequence)
        there = np.flatnonzero(known[own])
        near = np.abs(np.arange(len(own))[:, None] - there).argmin(axis=1) if len(there) else None
        placed[own] = centres[known][0] if near is None else centres[own[there[near]]]
    size = np.bincount(scene.frame, minlength=scene.frames)
    passes, frames = np.unique(scene.sequence, return_counts=True)
    longest = scene.in_order(scene.sequence == passes[np.argmax(frames)])
    away = np.linalg.norm(placed - placed[int(longest[len(longest) // 2])], axis=1)
    nearest = np.argsort(away, kind="stable")
    taken = nearest[: int(np.searchsorted(np.cumsum(size[nearest]), images)) + 1]
    return np.flatnonzero(np.isin(scene.frame, taken))
