"""Models of OpenSfM and Metashape: poses and cameras by image name.

**OpenSfM** (``reconstruction.json``; ``opensfm/io.py``): a list of reconstructions, each with ``shots``: ``rotation``
(an angle-axis vector) and ``translation`` are those of camera_from_world, the camera x right, y down, z forward;
``camera`` names one of ``cameras``. Shots of rigs carry their own pose, too.

**Metashape** (Export Cameras, XML; manual, "Camera data"): ``transform`` of a camera is world_from_camera in the
coordinates of its chunk, 4 x 4 row by row, the camera x right, y down, z forward. The ``transform`` of chunk or
component (rotation, translation, scale) leads on to the Earth and is not needed: only poses of one component are taken,
whose world may be any. Cameras are called by labels, which are file names, mostly without their ending.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.cameraforeign import agisoft, opensfm_cameras
from tiegraph.scan.rigfiles.cameraread import NUMBER, FoundCamera, numbers
from tiegraph.scene.namedposes import checked_pose, read_json
from tiegraph.scene.regular import regular
from tiegraph.scene.xmltree import Element, parse_xml


@dataclass(frozen=True)
class Found:
    """What a file has: poses (4, 4) world_from_camera and cameras by image, its images without pose, what to say."""

    poses: dict[str, np.ndarray]
    cameras: dict[str, FoundCamera]
    unposed: int = 0
    notes: list[str] = field(default_factory=list)


# --- OpenSfM --------------------------------------------------------------------------------------------------------


def opensfm_model(path: Path) -> Found:
    """The largest reconstruction of a reconstruction.json. Raises InputError, naming file and shot."""
    data = read_json(path, "a reconstruction.json of OpenSfM or ODM")
    parts = [p for p in (data if isinstance(data, list) else [data]) if isinstance(p, dict)]
    parts = [p for p in parts if isinstance(p.get("shots"), dict) and p["shots"]]
    if not parts:
        raise InputError(f"{path}: no reconstruction with shots in it; give a finished one")
    part = max(parts, key=lambda p: len(p["shots"]))
    shots, others = part["shots"], sum(len(p["shots"]) for p in parts) - len(part["shots"])
    notes = []
    if len(parts) > 1:
        notes.append(
            f"the largest of {len(parts)} reconstructions is taken: {len(shots)} images; {others} are in others"
        )
    known, said = _lenses(part.get("cameras"), path)
    poses = {name: _shot(row, f"{path}, shot {name}") for name, row in shots.items()}
    cameras = {n: known[str(row.get("camera"))] for n, row in shots.items() if str(row.get("camera")) in known}
    return Found(poses=poses, cameras=cameras, unposed=others, notes=[*notes, *said])


def _lenses(table: Any, path: Path) -> tuple[dict[str, FoundCamera], list[str]]:
    """Cameras by name, and why there are none."""
    try:
        return {c.name: c for c in opensfm_cameras([table], str(path))}, []
    except InputError as error:
        return {}, [f"no camera is taken from it: {error}"]


def _shot(row: Any, where: str) -> np.ndarray:
    """world_from_camera (4, 4)."""
    columns = []
    for key in ("rotation", "translation"):
        try:
            vector = np.array(row[key] if isinstance(row, dict) else None, float)
        except (KeyError, TypeError, ValueError):
            vector = np.zeros(0)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise InputError(f"{where}: {key} is no list of three numbers: remove that shot")
        columns.append(vector)
    turn, shift = columns
    return transforms.invert(transforms.rigid(Rotation.from_rotvec(turn).as_matrix(), shift))


# --- Metashape ------------------------------------------------------------------------------------------------------


def metashape(path: Path) -> Found:
    """The largest component of the largest chunk of a camera export. Raises InputError, naming file and line."""
    try:
        raw = regular(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    chunks = [(c, list(c.all("camera"))) for c in parse_xml(path, raw).all("chunk")]
    sizes = [sum(bool(c.said("transform")) for c in cameras) for _, cameras in chunks]
    if not sizes:
        raise InputError(
            f"{path}: no chunk with cameras in it; export the cameras again (File, Export, Export Cameras)"
        )
    number = int(np.argmax(sizes))
    cameras = chunks[number][1]
    posed = [c for c in cameras if c.said("transform")]
    component = Counter(c.given.get("component_id", "") for c in posed).most_common()
    notes = []
    if len(chunks) > 1:
        notes.append(f"the largest of {len(chunks)} chunks is taken: {len(posed)} cameras with a pose")
    if len(component) > 1:
        notes.append(f"the largest of {len(component)} components is taken: {component[0][1]} of {len(posed)} cameras")
    lens_of, said = _sensors(raw, number, path)
    poses: dict[str, np.ndarray] = {}
    lenses: dict[str, FoundCamera] = {}
    for camera in posed:
        label = camera.given.get("label", "")
        where = f"{path}, line {camera.line}"
        if not label or label in poses:
            why = f"two cameras are called {label!r}" if label else "a camera without a label"
            raise InputError(f"{where}: {why}, and images go by name: rename it, or leave it out of the export")
        if camera.given.get("component_id", "") == component[0][0]:
            poses[label] = _transform(camera, f"{where}: transform of {label!r:.80}")
            if camera.given.get("sensor_id") in lens_of:
                lenses[label] = lens_of[camera.given["sensor_id"]]
    return Found(poses=poses, cameras=lenses, unposed=len(cameras) - len(poses), notes=[*notes, *said])


def _transform(camera: Element, where: str) -> np.ndarray:
    text = camera.said("transform")
    values = numbers(text)
    rest = re.sub(NUMBER, "", text).strip()
    if len(values) != 16 or rest or not np.isfinite(values).all():
        raise InputError(f"{where} has not 16 numbers: export the cameras again")
    return checked_pose(np.array(values).reshape(4, 4), where)


def _sensors(raw: bytes, chunk: int, path: Path) -> tuple[dict[str, FoundCamera], list[str]]:
    """The calibrations of a chunk by the number of their sensor, and what could not be read of them."""
    text = re.split(r"<chunk\b", raw.decode("utf-8", "replace"))[1 + chunk]
    out, said = {}, []
    for head, body in re.findall(r"<sensor\b([^>]*[^/>])>(.*?)</sensor>", text, re.DOTALL):
        key = re.search(r'\bid="([^"]*)"', head)
        try:
            found = agisoft(f"<sensor{head}>{body}</sensor>", str(path))
        except InputError as error:
            said.append(f"a camera is not taken from it: {error}")
            continue
        if key and found:
            out[key[1]] = found[0]
    return out, said
