"""Bridge and open-sky sections of the passes by cues of the up camera (paper 001, section b).

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
from tiegraph.scene.evidence import ENOUGH
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

_GAMMA = 2.2  # of grey values, to make them proportional to light
_BRIGHTNESS = "brightness"


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


def read_cues(scene: Scene, passes: Sequence[Pass], light: UpLight, tuning: SectionsTuning) -> tuple[Cue, ...]:
    """The cues of the up cameras of a scene; none if no camera looks up."""
    grey = by_up_frame(scene, light.brightness)
    cues = []
    if light.sky_share is not None:
        share = by_up_frame(scene, light.sky_share)
        cues.append(_cue(light.measure, share, passes, tuning, tuning.sky_contrast, log=False))
    stop = None if light.exposure is None else by_up_frame(scene, light.exposure)
    known = np.isfinite(grey)
    if stop is not None and known.any() and np.mean(np.isfinite(stop[known]) & (stop[known] > 0)) >= 0.9:
        with np.errstate(invalid="ignore", divide="ignore"):
            luminance = np.where(stop > 0, (grey / 255) ** _GAMMA / stop, np.nan)
        contrast = float(np.log2(tuning.luminance_contrast))
        cues.append(_cue("luminance by EXIF exposure", luminance, passes, tuning, contrast))
    else:
        cues.append(_cue(_BRIGHTNESS, grey, passes, tuning, float(np.log2(tuning.brightness_contrast))))
    return tuple(c for c in cues if np.isfinite(c.values).any())


def by_up_frame(scene: Scene, values: np.ndarray) -> np.ndarray:
    """(F,) mean of the values (N,) of the up cameras of each frame; NaN = none."""
    up = scene.of_role("up")
    values = np.asarray(values, float)
    use = up & np.isfinite(values)
    count = np.bincount(scene.frame[use], minlength=scene.frames)
    total = np.bincount(scene.frame[use], values[use], minlength=scene.frames)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _cue(
    name: str, values: np.ndarray, passes: Sequence[Pass], tuning: SectionsTuning, needed: float, log: bool = True
) -> Cue:
    """A cue of values (F,), whose classes must differ by ``needed`` (log2 where ``log``). The scale of all but the
    brightness is the same in all passes, whatever the exposure."""
    scaled = np.log2(np.maximum(values, 1e-9)) if log else values
    absolute = name != _BRIGHTNESS

    def clear(split: "Otsu | None") -> bool:
        contrast = -1.0 if split is None else split.high - split.low
        return split is not None and split.separation >= tuning.min_separation and contrast >= needed

    splits = [_split(scaled[p.frames]) for p in passes]
    good = sorted((s for s in splits if s is not None and clear(s)), key=lambda s: s.threshold)
    on_passes = np.concatenate([p.frames for p in passes]) if passes else np.zeros(0, int)
    whole = _split(scaled[on_passes])
    if not good and absolute and whole is not None and clear(whole):
        good = [whole]
    threshold, evidence = np.full(len(values), np.nan), np.zeros(len(values))
    for p, own in zip(passes, splits):
        if not clear(own):
            # A pass without a contrast of its own: another pass's threshold holds only where exposure has no
            # influence.
            own = good[len(good) // 2] if good and absolute else None
        if own is not None:
            threshold[p.frames] = 2**own.threshold if log else own.threshold
            # The scatter within a class is assumed at least a sixth of the contrast
            gain = (own.high - own.low) / max(own.scatter, (own.high - own.low) / 6) ** 2
            say = gain * (0.5 * (own.low + own.high) - scaled[p.frames])
            evidence[p.frames] = np.clip(np.nan_to_num(say), -tuning.frame_say, tuning.frame_say)
    shown = good or [s for s in (*splits, whole) if s is not None]
    best = max(shown, key=lambda s: s.separation, default=None)
    figure = f"{name}: too few frames"
    if best is not None:
        contrast = best.high - best.low
        apart = f"{2**contrast:.2f} times ({2**needed:.2f} needed)" if log else f"{contrast:.2f} ({needed:.2f} needed)"
        figure = (
            f"{name}: two classes {apart} apart, explaining {np.floor(100 * best.separation):.0f} % of the variance "
            f"({100 * tuning.min_separation:.0f} % needed)"
        )
    unit = "" if absolute else " of 255"
    return Cue(name=name, unit=unit, values=values, threshold=threshold, evidence=evidence, figure=figure)


def _split(values: np.ndarray) -> "Otsu | None":
    """The split of the known values, None of too few; a class of one frame separates nothing."""
    known = values[np.isfinite(values)]
    if len(known) < ENOUGH:
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


@dataclass(frozen=True)
class Section:
    """A run of frames of one pass under a bridge or under the open sky."""

    name: str
    kind: str  # "bridge" or "open"
    frames: tuple[int, ...]  # frame indices


@dataclass(frozen=True)
class SectionResult:
    """Sections and the section of every frame (F,) i4."""

    sections: tuple[Section, ...]
    of_frame: np.ndarray
    notes: tuple[str, ...]
    cues: tuple[Cue, ...] = ()


def find_sections(scene: Scene, passes: Sequence[Pass], light: UpLight, tuning: SectionsTuning) -> SectionResult:
    """Sections of a scene from the cues of its up cameras.

    One section, with the figures that explain it, if nothing separates bridge from open sky.
    """
    cues = read_cues(scene, passes, light, tuning)
    if not cues:
        return whole_survey(scene, cues, "no camera looks up")
    if not any(c.decided for c in cues):
        figures = "; ".join(c.figure for c in cues)
        return whole_survey(scene, cues, f"the up camera shows no two clear classes ({figures})")
    of_frame = np.full(scene.frames, -1)
    sections: list[Section] = []
    evidence = np.sum([c.evidence for c in cues], axis=0)
    for p in passes:
        dark = two_states(evidence[p.frames], tuning)
        edges = np.flatnonzero(np.diff(dark)) + 1
        for first, last in zip(np.r_[0, edges], np.r_[edges, len(dark)]):
            kind = "bridge" if dark[first] else "open"
            number = 1 + sum(s.kind == kind for s in sections)
            frames = p.frames[first:last]
            of_frame[frames] = len(sections)
            sections.append(Section(f"{kind} {number} ({p.name})", kind, tuple(int(f) for f in frames)))
    bridges = sum(s.kind == "bridge" for s in sections)
    if not bridges:
        return whole_survey(scene, cues, "no two frames in a row are under a bridge")
    text = f"up camera: {bridges} bridge and {len(sections) - bridges} open sections; {_thresholds(cues, passes)}"
    return SectionResult(tuple(sections), of_frame, notes=(text,), cues=cues)


def whole_survey(scene: Scene, cues: tuple[Cue, ...], why: str = "") -> SectionResult:
    """One section with every frame, and why."""
    whole = Section("whole survey", "open", tuple(range(scene.frames)))
    notes = (f"one section: {why}",) if why else ()
    return SectionResult((whole,), np.zeros(scene.frames, int), notes=notes, cues=cues)


def _thresholds(cues: Sequence[Cue], passes: Sequence[Pass]) -> str:
    parts = []
    for cue in cues:
        known = {p.name: float(cue.threshold[p.frames[0]]) for p in passes if np.isfinite(cue.threshold[p.frames[0]])}
        each = ", ".join(f"{value:.3g}{cue.unit} ({name})" for name, value in list(known.items())[:6])
        more = f" and {len(known) - 6} more passes" if len(known) > 6 else ""
        parts.append(f"{cue.name} below {each}{more}" if known else f"not used: {cue.figure}")
    return "; ".join(parts)


def join_places(result: SectionResult, scene: Scene, pairs: Pairs, tuning: SectionsTuning) -> SectionResult:
    """Sections of different passes at one place (the same bridge, there and back) become one section.

    The sections of two passes are aligned in order, or in reversed order if that collects more kept pairs: on a short
    survey everything sees everything, and the most pairs alone would join the two banks of a bridge crosswise.
    """
    count = len(result.sections)
    if count < 2:
        return result
    kept = pairs.kept()
    a, b = (result.of_frame[scene.frame[k]] for k in (kept.i, kept.j))
    there = (a >= 0) & (b >= 0)
    known = np.isfinite(kept.overlap)
    weight = np.where(known, kept.overlap, np.median(kept.overlap[known]) if known.any() else 1.0)
    table = np.zeros((count, count))
    np.add.at(table, (a[there], b[there]), weight[there])
    size = np.array([len(s.frames) for s in result.sections], float)
    density = (table + table.T) / np.outer(size, size)
    own = np.sqrt(np.outer(density.diagonal(), density.diagonal()))
    kinds = np.array([s.kind for s in result.sections])
    density[(kinds[:, None] != kinds[None]) | (density < tuning.min_shared * own)] = 0.0
    passes = np.array([int(scene.sequence[s.frames[0]]) for s in result.sections])
    place = np.arange(count)
    for one, other in _aligned(density, passes):
        members = np.flatnonzero((place == place[one]) | (place == place[other]))
        if len(np.unique(passes[members])) == len(members):  # never two sections of one pass
            place[members] = place[members].min()
    return _renamed(result, place)


def _aligned(density: np.ndarray, passes: np.ndarray) -> list[tuple[int, int]]:
    """Sections (one, other) of two passes at the same place, those that share most first."""
    found: list[tuple[int, int]] = []
    tracks = np.unique(passes)
    for k, p in enumerate(tracks):
        for q in tracks[k + 1 :]:
            own, others = np.flatnonzero(passes == p), np.flatnonzero(passes == q)
            ways = [_best_order(density[np.ix_(own, o)], own, o) for o in (others, others[::-1])]
            found += max(ways, key=lambda way: sum(density[x, y] for x, y in way))
    return sorted(found, key=lambda pair: -density[pair])


def _best_order(gain: np.ndarray, own: np.ndarray, others: np.ndarray) -> list[tuple[int, int]]:
    """The alignment of two sequences, both in order, with the largest sum of gains (A, B) (Needleman, Wunsch 1970)."""
    rows, columns = gain.shape
    best = np.zeros((rows + 1, columns + 1))
    for x in range(rows):
        for y in range(columns):
            best[x + 1, y + 1] = max(best[x, y + 1], best[x + 1, y], best[x, y] + gain[x, y])
    out = []
    x, y = rows, columns
    while x and y:
        if gain[x - 1, y - 1] > 0 and best[x, y] == best[x - 1, y - 1] + gain[x - 1, y - 1]:
            out.append((int(own[x - 1]), int(others[y - 1])))
            x, y = x - 1, y - 1
        elif best[x, y] == best[x - 1, y]:
            x -= 1
        else:
            y -= 1
    return out


def _renamed(result: SectionResult, place: np.ndarray) -> SectionResult:
    sections: list[Section] = []
    of_frame = np.full(len(result.of_frame), -1)
    for p in dict.fromkeys(place.tolist()):
        members = [s for s, q in zip(result.sections, place) if q == p]
        frames = tuple(f for s in members for f in s.frames)
        kind = members[0].kind
        of_frame[list(frames)] = len(sections)
        sections.append(Section(f"{kind} {1 + sum(s.kind == kind for s in sections)}", kind, frames))
    named = ", ".join(f"{s.name} ({len(s.frames)} frames)" for s in sections)
    return replace(result, sections=tuple(sections), of_frame=of_frame, notes=(*result.notes, f"sections: {named}"))


def split(pairs: Pairs, scene: Scene) -> Pairs:
    """Pairs whose images lie in different sections dropped for ``section`` (paper 001: one list a section)."""
    of_image = scene.section[scene.frame]
    return pairs.drop(of_image[pairs.i] != of_image[pairs.j], "section")
