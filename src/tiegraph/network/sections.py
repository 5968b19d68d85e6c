"""Bridge and open-sky sections from the brightness of the up camera (paper 001, section b)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from tiegraph.network.passes import Pass
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

MIN_FRAMES = 8  # with an up camera, or nothing can be learnt
MIN_SEPARATION = 0.7  # share of the variance the two classes must explain (a normal distribution: 0.64 to 0.67)
MIN_RATIO = 1.25  # mean brightness of the open class over that of the bridge class
SMOOTH_FRAMES = 3  # median window
MIN_RUN = 2  # shorter runs belong to their neighbours


@dataclass(frozen=True)
class Section:
    """A run of frames of one pass under a bridge or under the open sky."""

    name: str
    kind: str  # "bridge" or "open"
    frames: tuple[int, ...]  # frame indices


@dataclass(frozen=True)
class SectionResult:
    """Sections, the section of every frame (F,) i4, the up camera's brightness by frame (F,) NaN = none, threshold."""

    sections: tuple[Section, ...]
    of_frame: np.ndarray
    brightness: np.ndarray
    threshold: float  # grey value; NaN = everything is one section
    notes: tuple[str, ...]


def find_sections(scene: Scene, passes: Sequence[Pass], brightness: np.ndarray) -> SectionResult:
    """Sections of a scene from the mean grey value (N,) of its images; one section, and why, where nothing tells."""
    by_frame = _up_brightness(scene, brightness)
    known = by_frame[np.isfinite(by_frame)]
    if len(known) < MIN_FRAMES:
        return _one(scene, by_frame, "no camera looks up" if not len(known) else "too few frames with an up camera")
    threshold, separation, ratio = otsu(known)
    if separation < MIN_SEPARATION or ratio < MIN_RATIO:
        return _one(scene, by_frame, "the up camera's brightness does not fall into two clear classes")
    of_frame = np.full(scene.frames, -1)
    sections: list[Section] = []
    for p in passes:
        for first, last, dark in _runs(by_frame[p.frames], threshold):
            kind = "bridge" if dark else "open"
            number = 1 + sum(s.kind == kind for s in sections)
            frames = p.frames[first:last]
            of_frame[frames] = len(sections)
            sections.append(Section(f"{kind} {number} ({p.name})", kind, tuple(int(f) for f in frames)))
    bridges = sum(s.kind == "bridge" for s in sections)
    text = f"up camera: {bridges} bridge and {len(sections) - bridges} open sections, threshold {threshold:.0f} of 255"
    return SectionResult(tuple(sections), of_frame, by_frame, threshold, (text,))


def _up_brightness(scene: Scene, brightness: np.ndarray) -> np.ndarray:
    out = np.full(scene.frames, np.nan)
    up = np.array([s.role == "up" for s in scene.all_sensors])[scene.sensor_key]
    out[scene.frame[up]] = np.asarray(brightness, float)[up]
    return out


def _one(scene: Scene, by_frame: np.ndarray, why: str) -> SectionResult:
    whole = Section("whole survey", "open", tuple(range(scene.frames)))
    return SectionResult((whole,), np.zeros(scene.frames, int), by_frame, float("nan"), (f"one section: {why}",))


def otsu(values: np.ndarray) -> tuple[float, float, float]:
    """Threshold that splits values best (Otsu 1979), the share of the variance it explains, and the ratio of means."""
    values = np.sort(np.asarray(values, float))
    n, total = len(values), values.sum()
    low_count = np.arange(1, n)
    low_sum = np.cumsum(values)[:-1]
    low_mean, high_mean = low_sum / low_count, (total - low_sum) / (n - low_count)
    between = low_count * (n - low_count) / n**2 * (high_mean - low_mean) ** 2
    k = int(np.argmax(between))
    variance = float(values.var())
    separation = float(between[k]) / variance if variance > 0 else 0.0
    return float(0.5 * (values[k] + values[k + 1])), separation, float(high_mean[k] / max(low_mean[k], 1e-6))


def _runs(values: np.ndarray, threshold: float) -> list[tuple[int, int, bool]]:
    """(first, end, dark) of the runs of a pass; NaN takes the class of the frame before."""
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return [(0, len(values), False)] if len(values) else []
    filled = values[known[np.clip(np.searchsorted(known, np.arange(len(values)), side="right") - 1, 0, None)]]
    dark = median_filter((filled < threshold).astype(np.uint8), SMOOTH_FRAMES, mode="nearest") > 0
    edges = np.r_[0, np.flatnonzero(np.diff(dark.astype(int))) + 1, len(dark)]
    runs: list[tuple[int, int, bool]] = []
    for first, end in zip(edges[:-1], edges[1:]):
        if runs and (end - first < MIN_RUN or bool(dark[first]) == runs[-1][2]):
            runs[-1] = (runs[-1][0], int(end), runs[-1][2])
        else:
            runs.append((int(first), int(end), bool(dark[first])))
    return runs


def join_places(result: SectionResult, scene: Scene, pairs: Pairs) -> SectionResult:
    """Sections of different passes that show one place (the same bridge, there and back) become one section.

    Two sections of one kind are one place when each is the other's densest partner in kept pairs.
    """
    count = len(result.sections)
    if count < 2:
        return result
    kept = pairs.kept()
    a, b = (result.of_frame[scene.frame[k]] for k in (kept.i, kept.j))
    there = (a >= 0) & (b >= 0)
    table = np.zeros((count, count))
    np.add.at(table, (a[there], b[there]), 1.0)
    size = np.array([len(s.frames) for s in result.sections], float)
    density = (table + table.T) / np.outer(size, size)
    passes = np.array([int(scene.track[s.frames[0]]) for s in result.sections])
    kinds = np.array([s.kind for s in result.sections])
    density[(passes[:, None] == passes[None]) | (kinds[:, None] != kinds[None])] = 0.0
    place = np.arange(count)
    for one in range(count):
        for track in np.unique(passes):
            there_ = np.where(passes == track, density[one], 0.0)
            other = int(np.argmax(there_))
            back = np.where(passes == passes[one], density[other], 0.0)
            if there_[other] > 0 and int(np.argmax(back)) == one:
                place[place == place[other]] = place[one]
    return _renamed(result, place)


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
    return SectionResult(
        tuple(sections), of_frame, result.brightness, result.threshold, (*result.notes, f"sections: {named}")
    )


def split(pairs: Pairs, scene: Scene) -> Pairs:
    """Pairs whose images lie in different sections dropped for ``section`` (paper 001: one list a section)."""
    of_image = scene.section[scene.frame]
    return pairs.drop(of_image[pairs.i] != of_image[pairs.j], "section")
