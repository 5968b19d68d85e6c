"""Which videos show the same: those of the cameras of one rig on one pass. Told as it is told of their pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from tiegraph.errors import InputError
from tiegraph.scan.assign import Report, Usable, assign
from tiegraph.scan.perspective import PRESET
from tiegraph.scan.settings import ScanSettings, video_offsets
from tiegraph.scan.tuning import Tuning
from tiegraph.scene.images import Probe


@dataclass(frozen=True)
class Film:
    """A video that can be decoded: the folder of its pictures, and their size."""

    folder: str
    width: int
    height: int


def films_together(
    films: Sequence[Film], rig: str | None, text: str | None, settings: ScanSettings, tuning: Tuning
) -> list[tuple[int, ...]]:
    """Numbers of the films that were recorded together, the rig's first camera first; most often one alone.

    ``rig`` and ``text`` as for ``assign``. Films of panoramas are no cameras of a rig. Raises InputError for a rig that
    does not fit.
    """
    around = sum(f.width == 2 * f.height for f in films) > tuning.panorama.most * len(films)
    if (rig or "").strip().lower() == PRESET or (rig is None and around):
        return [(k,) for k in range(len(films))]
    names = [f"{f.folder}/{PurePosixPath(f.folder).name}_{0:06d}.jpg" for f in films]
    probes = tuple(Probe(f.width, f.height) for f in films)
    usable = Usable(tuple(range(len(films))), tuple(names), probes, video=True)
    survey = assign(rig, usable, settings, Report(), tuning, text)
    groups: dict[tuple[int, str], dict[int, int]] = {}
    alone = set(range(len(films)))
    for shot in survey.shots:
        if shot.sequence:
            groups.setdefault((shot.rig, shot.sequence), {})[shot.sensor] = shot.image
    together = [tuple(g[s] for s in sorted(g)) for g in groups.values() if len(g) > 1]
    return sorted(together + [(k,) for k in alone.difference(*together)])


def offsets_given(folders: Sequence[str], settings: ScanSettings) -> dict[int, float]:
    """Seconds of ``scan.video_offset`` by the number of the video, named as its folder or the last part of it.

    Raises InputError for a name that none or several have.
    """
    found = {}
    for name, seconds in video_offsets(settings.video_offset).by_name.items():
        mine = [k for k, f in enumerate(folders) if f == name or (folders.count(name) == 0 and f.endswith(f"/{name}"))]
        if len(mine) != 1:
            word = "no video is" if not mine else "several videos are"
            raise InputError(f"--scan.video-offset {name}={seconds:g}: {word} called so; here are {', '.join(folders)}")
        found[mine[0]] = seconds
    return found
