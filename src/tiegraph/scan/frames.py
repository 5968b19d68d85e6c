"""Which images of a rig were taken together: frames, matched by file name, by the number in it, or by order."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tiegraph.scan.assign import Report, Shot, Survey
from tiegraph.scan.folders import natural
from tiegraph.scan.priors.times import time_in_name
from tiegraph.scan.tuning import FramesTuning


def into_frames(survey: Survey, files: Sequence[str], how: str, report: Report, tuning: FramesTuning) -> Survey:
    """The survey with the frame of each image; second images of a frame are dropped in the report."""
    groups: dict[tuple[int, str], list[Shot]] = {}
    for shot in survey.shots:
        groups.setdefault((shot.rig, shot.sequence), []).append(shot)
    out: list[Shot] = []
    for (_, sequence), shots in groups.items():
        if survey.loose:
            out += [replace(s, key=files[s.image]) for s in shots]
            continue
        sensors = sorted({s.sensor for s in shots})
        stems = {k: [s.stem for s in shots if s.sensor == k] for k in sensors}
        keys, by = match_frames(stems, how, tuning)
        _say_frames(sequence, by, stems, how, report)
        for sensor in sensors:
            mine = [s for s in shots if s.sensor == sensor]
            out += _without_twins([replace(s, key=key) for s, key in zip(mine, keys[sensor])], files, report)
    return replace(survey, shots=tuple(sorted(out, key=lambda s: s.image)))


def _say_frames(sequence: str, how: str, stems: dict[int, list[str]], asked: str, report: Report) -> None:
    if len(stems) < 2:
        return
    counts = sorted({len(s) for s in stems.values()})
    if how == "number" and asked == "auto":
        report.notes.append(f"pass {sequence}: images of one frame found by the last number in their names")
    if how == "time":
        report.notes.append(f"pass {sequence}: images of one frame found by the times in their names")
    if how == "order":
        text = f"pass {sequence}: file names do not show which images belong together; taken in the order of names"
        if len(counts) > 1:
            text += f", although the cameras have {counts[0]} to {counts[-1]} images: check, or rename them"
        report.notes.append(text)


def _without_twins(shots: list[Shot], names: Sequence[str], report: Report) -> list[Shot]:
    first: dict[str, Shot] = {}
    for shot in shots:
        if shot.key in first:
            used = names[first[shot.key].image]
            report.drop([names[shot.image]], f"a second image of frame {shot.key}; {used} is used")
        else:
            first[shot.key] = shot
    return list(first.values())


def match_frames(
    stems: Mapping[int, Sequence[str]], how: str, tuning: FramesTuning
) -> tuple[dict[int, list[str]], str]:
    """Frame label of each image of one pass, by sensor, from the file stems, and how: name, number, time or order.

    Auto: equal names if half of them agree; else equal last numbers in the names, which are frame numbers in the
    papers' data (paper 000 figure 8: image0up_168035.jpg); else names that are nearly equal times; else the place in
    the natural order of names.
    """
    if how in ("auto", "name"):
        by_name = {sensor: list(s) for sensor, s in stems.items()}
        if how == "name" or _shared(by_name) >= 0.5:
            return by_name, "name"
    if how in ("auto", "number"):
        by_number = {}
        for sensor, names in stems.items():
            numbers = [re.findall(r"\d+", s) for s in names]
            by_number[sensor] = [str(int(n[-1])) if n else s for n, s in zip(numbers, names)]
        once = [[c == 1 for c in Counter(k).values()] for k in by_number.values()]
        if how == "number" or (_shared(by_number) >= 0.5 and all(sum(c) >= tuning.unique * len(c) for c in once)):
            return by_number, "number"
    if how == "auto" and (by_time := _by_time(stems, tuning)) and _shared(by_time) >= 0.5:
        return by_time, "time"
    by_order = {}
    for sensor, names in stems.items():
        rank = {s: k for k, s in enumerate(sorted(set(names), key=natural))}
        by_order[sensor] = [f"{rank[s]:06d}" for s in names]
    return by_order, "order"


def _by_time(stems: Mapping[int, Sequence[str]], tuning: FramesTuning) -> dict[int, list[str]]:
    """By sensor the nearest name in time in the fullest sensor, or the image's own name if none is near."""
    seconds = {k: np.array([time_in_name(s) for s in names]) for k, names in stems.items()}
    fullest = max(stems, key=lambda k: len(stems[k]))
    order = np.argsort(seconds[fullest])
    ordered = seconds[fullest][order]
    if any(np.isnan(t).any() for t in seconds.values()) or len(ordered) < 2:
        return {}
    near, out = tuning.same_step * float(np.median(np.diff(ordered))), {}
    for sensor, own in seconds.items():
        nearest = np.array([int(np.argmin(np.abs(ordered - t))) for t in own])
        close = np.abs(ordered[nearest] - own) <= near
        labels = [stems[fullest][order[n]] for n in nearest]
        out[sensor] = [label if c else stem for label, c, stem in zip(labels, close, stems[sensor])]
    return out


def _shared(keys: dict[int, list[str]]) -> float:
    """Share of the images of the sensor with fewest partners that have a partner in the fullest one."""
    sets = [set(k) for k in keys.values()]
    fullest = max(sets, key=len)
    return min(len(s & fullest) / len(s) for s in sets)
