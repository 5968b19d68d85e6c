"""Bridge and open-sky sections from the up camera (paper 001, section b)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiegraph.network.passes import Pass
from tiegraph.network.sections.light import Cue, UpLight, read_cues, two_states
from tiegraph.network.tuning import SectionsTuning
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Section:
    """A run of frames of one pass under a bridge or under the open sky."""

    name: str
    kind: str  # "bridge" or "open"
    frames: tuple[int, ...]  # frame indices


@dataclass(frozen=True)
class SectionResult:
    """Sections, the section of every frame (F,) i4, threshold."""

    sections: tuple[Section, ...]
    of_frame: np.ndarray
    threshold: float  # grey value, mean over the passes; NaN = brightness was not used
    notes: tuple[str, ...]
    cues: tuple[Cue, ...] = ()


def find_sections(
    scene: Scene, passes: Sequence[Pass], light: UpLight | np.ndarray, tuning: SectionsTuning
) -> SectionResult:
    """Sections of a scene from the cues of its up cameras, or from the mean grey value (N,) of its images alone.

    One section, with the figures that explain it, if nothing separates bridge from open sky.
    """
    light = light if isinstance(light, UpLight) else UpLight(np.asarray(light, float))
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
        for first, last, dark in _runs(two_states(evidence[p.frames], tuning)):
            kind = "bridge" if dark else "open"
            number = 1 + sum(s.kind == kind for s in sections)
            frames = p.frames[first:last]
            of_frame[frames] = len(sections)
            sections.append(Section(f"{kind} {number} ({p.name})", kind, tuple(int(f) for f in frames)))
    bridges = sum(s.kind == "bridge" for s in sections)
    if not bridges:
        return whole_survey(scene, cues, "no two frames in a row are under a bridge")
    text = f"up camera: {bridges} bridge and {len(sections) - bridges} open sections; {_thresholds(cues, passes)}"
    return SectionResult(tuple(sections), of_frame, _threshold(cues), notes=(text,), cues=cues)


def whole_survey(scene: Scene, cues: tuple[Cue, ...] = (), why: str = "") -> SectionResult:
    """One section with every frame, and why."""
    whole = Section("whole survey", "open", tuple(range(scene.frames)))
    notes = (f"one section: {why}",) if why else ()
    return SectionResult((whole,), np.zeros(scene.frames, int), float("nan"), notes=notes, cues=cues)


def _threshold(cues: Sequence[Cue]) -> float:
    decided = (c for c in cues if c.name == "brightness" and c.decided)
    return next((float(np.nanmean(c.threshold)) for c in decided), float("nan"))


def _thresholds(cues: Sequence[Cue], passes: Sequence[Pass]) -> str:
    parts = []
    for cue in cues:
        known = {p.name: float(cue.threshold[p.frames[0]]) for p in passes if np.isfinite(cue.threshold[p.frames[0]])}
        each = ", ".join(f"{value:.3g}{cue.unit} ({name})" for name, value in list(known.items())[:6])
        more = f" and {len(known) - 6} more passes" if len(known) > 6 else ""
        parts.append(f"{cue.name} below {each}{more}" if known else f"not used: {cue.figure}")
    return "; ".join(parts)


def _runs(dark: np.ndarray) -> list[tuple[int, int, bool]]:
    """(first, end, dark) of the runs of a pass."""
    edges = np.r_[0, np.flatnonzero(np.diff(dark.astype(int))) + 1, len(dark)] if len(dark) else np.zeros(0, int)
    return [(int(a), int(b), bool(dark[a])) for a, b in zip(edges[:-1], edges[1:])]


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
