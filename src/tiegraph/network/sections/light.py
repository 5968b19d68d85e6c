"""Cues of the up camera for sky or bridge above, and the two states derived from them (paper 001, section b).

The paper thresholds the brightness of the up camera. An automatic exposure defeats that: under a bridge it increases
until the deck is as bright as the sky was. So all cues that do not depend on the exposure are used too. Each has a
threshold of its own in every pass, and a cue without a clear contrast is not used.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.network.passes import Pass
from tiegraph.network.tuning import SectionsTuning
from tiegraph.scene.scene import Scene

_GAMMA = 2.2  # of grey values, to make them proportional to light


@dataclass(frozen=True)
class UpLight:
    """Cues of each image (N,), NaN = unknown; only those of up cameras are read.

    brightness: mean grey value 0..255; sky_share: share of the picture that the masks leave out (sky and overexposed
    pixels, for an up camera), unless ``measure`` names another measure; exposure: exposure time in s x ISO /
    (f-number squared) from EXIF.
    """

    brightness: np.ndarray
    sky_share: np.ndarray | None = None
    exposure: np.ndarray | None = None
    measure: str = "open share of the masks"


LIGHTS: dict[str, Callable[[Scene, Path, Callable[..., list[Any]]], UpLight]] = {}
"""Named methods (of ``network.sections``) to measure the light in a folder of images, beside that of the previews."""


@dataclass(frozen=True)
class Cue:
    """One cue by frame and its decision.

    values (F,) NaN = none; threshold (F,) of the frame's pass, NaN = the cue is not used in this pass; evidence (F,)
    log likelihood ratio of bridge against open; figure: the finding in words.
    """

    name: str
    unit: str
    values: np.ndarray
    threshold: np.ndarray
    evidence: np.ndarray
    figure: str

    @property
    def decided(self) -> bool:
        """Whether the cue separates bridge from open in any pass."""
        return bool(np.isfinite(self.threshold).any())


@dataclass(frozen=True)
class _Kind:
    """How a cue is read: ``contrast`` by which its classes must differ (log2 where ``log``), and whether its scale is
    the same in all passes, whatever the exposure."""

    name: str
    unit: str
    contrast: float
    log: bool
    absolute: bool


def read_cues(scene: Scene, passes: Sequence[Pass], light: UpLight, tuning: SectionsTuning) -> tuple[Cue, ...]:
    """The cues of the up cameras of a scene; none if no camera looks up."""
    grey = by_up_frame(scene, light.brightness)
    cues = []
    if light.sky_share is not None:
        kind = _Kind(name=light.measure, unit="", contrast=tuning.sky_contrast, log=False, absolute=True)
        cues.append(_cue(kind, by_up_frame(scene, light.sky_share), passes, tuning))
    stop = None if light.exposure is None else by_up_frame(scene, light.exposure)
    known = np.isfinite(grey)
    if stop is not None and known.any() and np.mean(np.isfinite(stop[known]) & (stop[known] > 0)) >= 0.9:
        with np.errstate(invalid="ignore", divide="ignore"):
            luminance = np.where(stop > 0, (grey / 255) ** _GAMMA / stop, np.nan)
        contrast = float(np.log2(tuning.luminance_contrast))
        kind = _Kind(name="luminance by EXIF exposure", unit="", contrast=contrast, log=True, absolute=True)
        cues.append(_cue(kind, luminance, passes, tuning))
    else:
        contrast = float(np.log2(tuning.brightness_contrast))
        kind = _Kind(name="brightness", unit=" of 255", contrast=contrast, log=True, absolute=False)
        cues.append(_cue(kind, grey, passes, tuning))
    return tuple(c for c in cues if np.isfinite(c.values).any())


def by_up_frame(scene: Scene, values: np.ndarray) -> np.ndarray:
    """(F,) mean of the values (N,) of the up cameras of each frame; NaN = none."""
    up = scene.of_role("up")
    values = np.asarray(values, float)
    use = up & np.isfinite(values)
    count = np.bincount(scene.frame[use], minlength=scene.frames)
    total = np.bincount(scene.frame[use], values[use], minlength=scene.frames)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _cue(kind: _Kind, values: np.ndarray, passes: Sequence[Pass], tuning: SectionsTuning) -> Cue:
    scaled = np.log2(np.maximum(values, 1e-9)) if kind.log else values

    def clear(split: "Otsu | None") -> bool:
        contrast = -1.0 if split is None else split.high - split.low
        return split is not None and split.separation >= tuning.min_separation and contrast >= kind.contrast

    splits = [_split(scaled[p.frames], tuning.min_frames) for p in passes]
    good = sorted((s for s in splits if s is not None and clear(s)), key=lambda s: s.threshold)
    on_passes = np.concatenate([p.frames for p in passes]) if passes else np.zeros(0, int)
    whole = _split(scaled[on_passes], tuning.min_frames)
    if not good and kind.absolute and whole is not None and clear(whole):
        good = [whole]
    threshold, evidence = np.full(len(values), np.nan), np.zeros(len(values))
    for p, own in zip(passes, splits):
        if not clear(own):
            # A pass without a contrast of its own: another pass's threshold holds only where exposure has no
            # influence.
            own = good[len(good) // 2] if good and kind.absolute else None
        if own is not None:
            threshold[p.frames] = 2**own.threshold if kind.log else own.threshold
            # The scatter within a class is assumed at least a sixth of the contrast
            gain = (own.high - own.low) / max(own.scatter, (own.high - own.low) / 6) ** 2
            say = gain * (0.5 * (own.low + own.high) - scaled[p.frames])
            evidence[p.frames] = np.clip(np.nan_to_num(say), -tuning.frame_say, tuning.frame_say)
    shown = good or [s for s in (*splits, whole) if s is not None]
    best = max(shown, key=lambda s: s.separation, default=None)
    return Cue(
        name=kind.name,
        unit=kind.unit,
        values=values,
        threshold=threshold,
        evidence=evidence,
        figure=_figure(kind, best, tuning),
    )


def _figure(kind: _Kind, split: "Otsu | None", tuning: SectionsTuning) -> str:
    if split is None:
        return f"{kind.name}: too few frames"
    contrast, needed = split.high - split.low, kind.contrast
    apart = f"{2**contrast:.2f} times ({2**needed:.2f} needed)" if kind.log else f"{contrast:.2f} ({needed:.2f} needed)"
    return (
        f"{kind.name}: two classes {apart} apart, explaining {np.floor(100 * split.separation):.0f} % of the variance "
        f"({100 * tuning.min_separation:.0f} % needed)"
    )


def _split(values: np.ndarray, least: int) -> "Otsu | None":
    """The split of the known values, of at least this many frames; a class of one frame separates nothing."""
    known = values[np.isfinite(values)]
    if len(known) < least:
        return None
    split = otsu(known)
    below = int(np.sum(known < split.threshold))
    if min(below, len(known) - below) < 2:
        return replace(split, separation=0.0, scatter=float(known.std()))
    return split


@dataclass(frozen=True)
class Otsu:
    """Threshold that splits values best, the share of the variance it explains, the means of the two classes, and the
    scatter within them."""

    threshold: float
    separation: float
    low: float
    high: float
    scatter: float


def otsu(values: np.ndarray) -> Otsu:
    """The split of values (n,) with the largest variance between its classes (Otsu 1979)."""
    values = np.sort(np.asarray(values, float))
    n, total = len(values), values.sum()
    low_count = np.arange(1, n)
    low_sum = np.cumsum(values)[:-1]
    low_mean, high_mean = low_sum / low_count, (total - low_sum) / (n - low_count)
    between = low_count * (n - low_count) / n**2 * (high_mean - low_mean) ** 2
    k = int(np.argmax(between))
    variance = float(values.var())
    separation = float(between[k]) / variance if variance > 1e-12 else 0.0
    return Otsu(
        threshold=float(0.5 * (values[k] + values[k + 1])),
        separation=separation,
        low=float(low_mean[k]),
        high=float(high_mean[k]),
        scatter=float(np.sqrt(max(0.0, 1 - separation) * variance)),
    )


def two_states(evidence: np.ndarray, tuning: SectionsTuning) -> np.ndarray:
    """(n,) bool: the likeliest run of bridge (True) and open frames for log likelihood ratios (n,) along a pass.

    Two hidden states with a price for every change (Viterbi 1967): a single odd frame changes nothing.
    """
    say = np.clip(np.asarray(evidence, float), -tuning.frame_say, tuning.frame_say)
    n = len(say)
    cost, back = np.zeros(2), np.zeros((n, 2), int)
    for k in range(n):
        stay, move = cost, cost[::-1] + (2.5 if k else 0.0)  # against single odd frames
        back[k] = np.where(stay <= move, [0, 1], [1, 0])
        cost = np.minimum(stay, move) + np.array([0.5, -0.5]) * say[k]
    state = np.zeros(n, bool)
    at = int(np.argmin(cost))
    for k in range(n - 1, -1, -1):
        state[k] = at == 1
        at = int(back[k, at])
    return state
