"""Start models: results of COLMAP, OpenSfM (ODM), nerfstudio and Metashape for these images (``--start``).

Of each, the poses of images and their cameras are read, both by image name. Poses are world_from_camera with
cameras x right, y down, z forward; their world and its unit may be any. nerfstudio's conventions are in
``scene.namedposes``.

**OpenSfM** (``reconstruction.json``; ``opensfm/io.py``): a list of reconstructions, each with ``shots``: ``rotation``
(an angle-axis vector) and ``translation`` are those of camera_from_world, the camera x right, y down, z forward;
``camera`` names one of ``cameras``. Shots of rigs carry their own pose, too.

**Metashape** (Export Cameras, XML; manual, "Camera data"): ``transform`` of a camera is world_from_camera in the
coordinates of its chunk, 4 x 4 row by row, the camera x right, y down, z forward. The ``transform`` of chunk or
component (rotation, translation, scale) leads on to the Earth and is not needed: only poses of one component are used,
whose world may be any. Cameras have labels, which are file names, mostly without extension.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.camerafile import agisoft_camera, opensfm_cameras
from tiegraph.scan.rigfiles.cameraread import FoundCamera
from tiegraph.scan.rigfiles.rigfaults import is_number
from tiegraph.scene.cells import number
from tiegraph.scene.colmapmodel import is_model, read_model
from tiegraph.scene.namedposes import (
    ACCEPTED,
    called,
    check_poses,
    checked_pose,
    find_start,
    poses_of_model,
    poses_of_transforms,
    read_json,
)
from tiegraph.scene.textfile import Element, parse_xml, whole_file


@dataclass(frozen=True)
class StartModel:
    """A start model: its file and program, poses (4, 4) and cameras by image name, the number of
    its images without a pose, and notes."""

    path: Path
    poses: dict[str, np.ndarray]
    program: str = ""
    cameras: dict[str, FoundCamera] = field(default_factory=dict)
    unposed: int = 0
    notes: Sequence[str] = ()

    def cameras_of(self) -> str:
        """The source of its cameras, in words: cameras of a bag come without poses."""
        return "the start model" if self.poses else self.program


def read_start(path: Path) -> StartModel:
    """The model of ``--start``. Raises InputError for other or damaged files."""
    program, place = find_start(Path(path))
    found = _READERS[program](place)
    check_poses(found.poses, place)
    return replace(found, program=program, notes=tuple(f"{called(place)}: {note}" for note in found.notes))


def _colmap(folder: Path) -> StartModel:
    model = read_model(folder)
    cameras = {
        key: FoundCamera(
            model=c.model.name,
            params=tuple(map(float, c.params)),
            size=(int(c.width), int(c.height)),
            where=f"{folder}, camera {key}",
            name=str(key),
        )
        for key, c in model.cameras.items()
    }
    beside = [p for p in folder.parent.iterdir() if p != folder and p.name.isdigit() and is_model(p)]
    notes = [f"the largest of {len(beside) + 1} models there"] if beside and folder.name.isdigit() else []
    poses = poses_of_model(model)
    return StartModel(
        folder,
        poses,
        cameras={i.name: cameras[i.camera_id] for i in sorted(model.images.values(), key=lambda i: i.name)},
        unposed=len(model.images) - len(poses),
        notes=notes,
    )


def _transforms(path: Path) -> StartModel:
    data = read_json(path, ACCEPTED)
    poses = poses_of_transforms(data, path)
    cameras: dict[str, FoundCamera] = {}
    notes: list[str] = []
    for k, frame in enumerate(data["frames"]):
        try:
            camera = _nerf_camera({**data, **frame}, f"{path}" if _LENS.isdisjoint(frame) else f"{path}, frame {k}")
        except InputError as error:
            notes.append(f"no camera is taken from it: {error}")
            cameras.clear()
            break
        if camera is not None:
            cameras[frame["file_path"]] = camera
    return StartModel(path, poses, cameras=cameras, notes=notes)


_LENS = frozenset({"fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "camera_angle_x"})
_PINHOLE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE")


def _nerf_camera(row: dict[str, Any], where: str) -> FoundCamera | None:
    """The camera of one frame in COLMAP's pixel convention; None without values. Raises InputError."""
    wrong = next((k for k in (*_LENS, "k2", "k3", "k4", "p1", "p2") if k in row and not is_number(row[k])), None)
    if wrong is not None:
        raise InputError(f"{where}: {wrong} = {row[wrong]!r:.99}: expected a finite number")
    if not {"w", "h"} <= row.keys() or not {"fl_x", "camera_angle_x"} & row.keys():
        return None
    width, height = int(row["w"]), int(row["h"])
    fx = row["fl_x"] if "fl_x" in row else width / 2 / math.tan(row["camera_angle_x"] / 2)
    wide = (fx, row.get("fl_y", fx), row.get("cx", width / 2), row.get("cy", height / 2))
    k1, k2, k3, k4, p1, p2 = (float(row.get(n, 0.0)) for n in ("k1", "k2", "k3", "k4", "p1", "p2"))
    kind = str(row.get("camera_model", "OPENCV_FISHEYE" if row.get("is_fisheye") else "OPENCV"))
    if kind == "OPENCV_FISHEYE":
        model, rest = kind, [k1, k2, k3, k4]
    elif kind in _PINHOLE and not k4:
        model, rest = ("FULL_OPENCV", [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]) if k3 else ("OPENCV", [k1, k2, p1, p2])
    else:
        raise InputError(f"{where}: camera_model {kind} with k4 = {k4:g}; read are {', '.join(_PINHOLE)} without k4, "
                         "OPENCV_FISHEYE")  # fmt: skip
    return FoundCamera(model=model, params=tuple(map(float, (*wide, *rest))), size=(width, height), where=where)


def must_be_whole(start: StartModel, whole: bool) -> None:
    """Raises InputError if views of the images are mapped: a start model has whole images by their names."""
    if not whole:
        raise InputError(
            f"--start {start.path}: a model of whole images, of which views are mapped here (panoramas, fisheye "
            "lenses): omit it, or use whole fisheye images by --scan.fisheye whole"
        )


def _opensfm(path: Path) -> StartModel:
    data = read_json(path, "a reconstruction.json of OpenSfM or ODM")
    parts = [p for p in (data if isinstance(data, list) else [data]) if isinstance(p, dict)]
    parts = [p for p in parts if isinstance(p.get("shots"), dict) and p["shots"]]
    if not parts:
        raise InputError(f"{path}: no reconstruction with shots in it; give a finished one")
    part = max(parts, key=lambda p: len(p["shots"]))
    shots, others = part["shots"], sum(len(p["shots"]) for p in parts) - len(part["shots"])
    largest = f"the largest of {len(parts)} reconstructions is taken: {len(shots)} images; {others} are in others"
    notes = [largest] if len(parts) > 1 else []
    known: dict[str, FoundCamera] = {}
    try:
        known = {c.name: c for c in opensfm_cameras([part.get("cameras")], str(path))}
    except InputError as error:
        notes.append(f"no camera is taken from it: {error}")
    poses = {name: _shot(row, f"{path}, shot {name}") for name, row in shots.items()}
    cameras = {n: known[str(row.get("camera"))] for n, row in shots.items() if str(row.get("camera")) in known}
    return StartModel(path, poses, cameras=cameras, unposed=others, notes=notes)


def _shot(row: Any, where: str) -> np.ndarray:
    def vector(key: str) -> np.ndarray:
        found = transforms.finite_array(row.get(key) if isinstance(row, dict) else None, (3,))
        if found is None:
            raise InputError(f"{where}: {key} is no list of three numbers: remove that shot")
        return found

    turn = Rotation.from_rotvec(vector("rotation")).as_matrix()
    return transforms.invert(transforms.rigid(turn, vector("translation")))


def _metashape(path: Path) -> StartModel:
    chunks = [(c, list(c.all("camera"))) for c in parse_xml(path, whole_file(path, f"give {ACCEPTED}")).all("chunk")]
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
    lens_of, said = _sensors(chunks[number][0], path)
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
    return StartModel(path, poses, cameras=lenses, unposed=len(cameras) - len(poses), notes=[*notes, *said])


def _transform(camera: Element, where: str) -> np.ndarray:
    values = [number(word) for word in camera.said("transform").split()]
    if len(values) != 16 or not np.isfinite(values).all():
        raise InputError(f"{where} has not 16 numbers: export the cameras again")
    return checked_pose(np.array(values).reshape(4, 4), where)


def _sensors(chunk: Element, path: Path) -> tuple[dict[str, FoundCamera], list[str]]:
    """The calibrations of a chunk by the number of their sensor, and notes on unreadable ones."""
    out, said = {}, []
    for sensor in chunk.all("sensor"):
        try:
            found = agisoft_camera(sensor, str(path))
        except InputError as error:
            said.append(f"a camera is not taken from it: {error}")
            continue
        if found is not None:
            out[sensor.given.get("id", "")] = found
    return out, said


_READERS: dict[str, Callable[[Path], StartModel]] = {
    "COLMAP": _colmap,
    "OpenSfM": _opensfm,
    "nerfstudio": _transforms,
    "Metashape": _metashape,
}
