"""Cameras that write into one folder and mark their files by name: the bands of a multispectral rig.

IMG_180822_133949_0205_GRE.TIF, ..._NIR.TIF (Parrot Sequoia), IMG_0001_1.tif ... _5.tif (MicaSense), ..._MS_RE.TIF
(DJI). The part before the last mark is the shot, the mark is the camera; its folder is then written "*_GRE".
"""

import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePosixPath

import numpy as np

from tiegraph.geometry.transforms import rigid
from tiegraph.scan.folders import Layout, Order, Place, is_pattern, natural, pass_names
from tiegraph.scan.rigfiles.rigspec import RigSpec
from tiegraph.scan.tuning import FramesTuning
from tiegraph.scene.exif import Exif, relative_rotation

_BANDS = frozenset(
    "gre red reg nir rgb green blue blu rededge lwir thermal tir pan panchro ms_g ms_r ms_re ms_nir".split()
)
_MARK = re.compile(r"(?i)^(.+)_((?:MS_)?[a-z]+|\d{1,2})$")
_MICASENSE = re.compile(r"(?i)^IMG_\d{4}_\d{1,2}$")


def band_layout(names: Sequence[str], exif: Sequence[Exif], kind: str, tuning: FramesTuning) -> Layout | None:
    """The layout of images whose names end in marks of bands; None if they do not. ``kind`` is ScanSettings.layout.

    Marks are names of bands; or numbers, if the files or MicaSense's naming show that these are
    cameras: photographs numbered in rows and columns look alike.
    """
    if kind != "auto":
        return None
    stems = [PurePosixPath(n).stem for n in names]
    found = [_MARK.match(s) for s in stems]
    marks = [m[2].lower() if m else "" for m in found]
    cameras = {m for k, m in enumerate(marks) if m in _BANDS or _numbered(m, stems[k], names[k], exif[k])}
    shots: dict[tuple[str, str], set[str]] = defaultdict(set)
    for k, match in enumerate(found):
        if match and marks[k] in cameras:
            shots[str(PurePosixPath(names[k]).parent), match[1]].add(marks[k])
    held = sum(len(s) for s in shots.values())
    possible = max(len(names), len(shots) * len(cameras))
    if len(cameras) < 2 or len(shots) < 2 or held < tuning.whole * possible:
        return None
    spelt = {m: next(f[2] for f, mark in zip(found, marks) if f and mark == m) for m in cameras}
    passes = pass_names([PurePosixPath(n).parts[:-1] for n in names])
    places = tuple(Place(f"*_{spelt[m]}", p) if m in cameras else None for m, p in zip(marks, passes))
    folders = tuple(f"*_{spelt[m]}" for m in sorted(cameras, key=natural))
    note = f"{len(folders)} cameras that share folders, by the ends of the file names: {', '.join(folders)}"
    return Layout(places, folders, Order(False, note))


def _numbered(mark: str, stem: str, name: str, exif: Exif) -> bool:
    if not mark.isdigit():
        return False
    tiff = PurePosixPath(name).suffix.lower() in (".tif", ".tiff")
    return exif.rig.index >= 0 or bool(tiff and _MICASENSE.match(stem))


def with_rig_tags(spec: RigSpec, layout: Layout, exif: Sequence[Exif], notes: list[str]) -> RigSpec:
    """A guessed rig with the values of the files (XMP): which camera is the reference, their names and rotations.

    The bands of one camera head have the same view direction; if the files give the differences, these are used.
    Cameras in folders of their own get poses only if all files have them.
    """
    tags = {f: [e.rig for e, p in zip(exif, layout.places) if p and p.folder == f] for f in layout.folders}
    angles = {f: Counter(t.relatives_deg for t in found if t.relatives_deg) for f, found in tags.items()}
    told = [s for s in spec.sensors if angles.get(s.folder or "")]
    bands = all(is_pattern(f) for f in layout.folders)
    if len(spec.sensors) < 2 or not (bands or len(told) == len(spec.sensors)):
        return spec
    reference = next((t.reference for found in tags.values() for t in found if t.reference >= 0), -1)
    ordered = sorted(spec.sensors, key=lambda s: not any(t.index == reference >= 0 for t in tags[s.folder or ""]))
    turns = [
        relative_rotation(angles[s.folder or ""].most_common(1)[0][0]) if angles[s.folder or ""] else np.eye(3)
        for s in ordered
    ]
    poses = [rigid(turns[0].T @ turn, np.zeros(3)) for turn in turns]
    # The band name in the files, else the mark in their names.
    named = [Counter(t.band for t in tags[s.folder or ""] if t.band).most_common(1) for s in ordered]
    names = [found[0][0] for found in named if found]
    if len(set(names)) < len(ordered):
        marks = [s.name.lstrip("*_") for s in ordered]
        names = [f"band{m}" if m.isdigit() else m for m in marks]
    how = "their view directions are nominally the same"
    if told:
        how = f"the rotations of {len(told)} of them are taken from their XMP (RigRelatives)"
        how += f", in {names[0]}" if reference >= 0 else ""
    notes.append(f"the {len(ordered)} cameras are one head: {how}; their relative positions come from the images")
    sensors = tuple(replace(s, name=n, body_from_sensor=p) for s, n, p in zip(ordered, names, poses))
    return replace(spec, sensors=sensors, nominal=True)
